"""What stands at a dotted path of an input, and the truth in which something else stands there.

    atmosphere.FIELD             a number of the state of the atmosphere, sun and view
    light.irradiance             factor on all light [1]; likewise path, ground (the light reflected by the ground),
                                 spherical_albedo and surroundings (their reflectance)
    sensor.gain                  factor on the recorded radiance [1]; likewise noise and electrons
    sensor.offset                added to the recorded radiance [uW cm-2 sr-1 nm-1]
    sensor.wavelength_shift_nm   added to the true band centres [nm]
    line.gain, line.offset       the empirical line gives gain rho + offset for a reflectance rho, for the detectors
    line.dark, line.bright       factor on the true reflectance of a panel of the line [1]
    surfaces.NAME.mean           mean reflectance [1]; surfaces.NAME.spread: factor on its standard deviation [1]
    surfaces.NAME.tail_dof       degrees of freedom of the tails of a class
    surfaces.NAME.fine_texture   part of a target's covariance that goes by its fill, not the fill's square [1]
    fill, fill.NAME              mean fills of all targets, or of one or its subject [1]
    fraction.NAME                area fraction of a class; the others give way in proportion [1]
    blur                         widths of the blur wherever a fill follows from geometry [pixels]

Any other path is that of an entry of the scenario's file.  Those that a batch has numbers for are columns of it:
:func:`batch_column`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState
from hyperval.atmosphere.state import MAX_SOLAR_ZENITH_DEG
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.atmosphere.visibility import LONGEST_KM, SHORTEST_KM
from hyperval.errors import UsageError
from hyperval.prediction.departure import Departure, StatisticsDeparture
from hyperval.prediction.fills import fill_distribution
from hyperval.prediction.inputs import SurfaceStatistics, class_tail
from hyperval.scenario import ElmPanels, Scenario
from hyperval.sensor.specification import Sensor
from hyperval.settings import item_number, path_parts, setting
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]

# Field of the state: lowest, highest value.
STATE_RANGES: dict[str, tuple[float, float]] = {
    "aot550": (0.0, 5.0),
    "meteorological_range_km": (SHORTEST_KM, LONGEST_KM),
    "water_vapour_g_cm2": (0.01, 10.0),
    "ozone_atm_cm": (0.01, 1.0),
    "angstrom_exponent": (-1.0, 3.0),
    "aerosol_share_below": (1e-3, 1.0),
    "solar_zenith_deg": (0.0, MAX_SOLAR_ZENITH_DEG - 0.1),
    "solar_azimuth_deg": (-360.0, 360.0),
    "view_zenith_deg": (0.0, 70.0),
    "view_azimuth_deg": (-360.0, 360.0),
    "sensor_altitude_km": (0.0, 100_000.0),
    "ground_altitude_km": (0.0, 5.0),
}
# Factor: (field of the departure, least value).
_LIGHT = {
    "irradiance": ("irradiance", 0.01), "path": ("path", 0.0), "ground": ("ground", 0.0),
    "spherical_albedo": ("spherical_albedo", 0.0), "surroundings": ("surroundings", 0.01),
}  # fmt: skip
_SENSOR = {
    "gain": ("recorded_gain", -np.inf),
    "noise": ("noise_factor", 1e-3),
    "electrons": ("signal_factor", 1e-3),
}
_ADDED = {
    ("sensor", "offset"): "recorded_offset", ("sensor", "wavelength_shift_nm"): "wavelength_shift_nm",
    ("line", "offset"): "retrieval_offset",
}  # fmt: skip
_OF_LIGHT = ("sensor.noise", "sensor.electrons")  # of the sensor, but not without light
_WIDEST_BLUR = 5.0  # [pixels]


@dataclass(frozen=True)
class Given:
    """What inputs are made of.

    Attributes
    ----------
    axis : the bands of the products
    surfaces : as stated
    terms : gives the atmospheric terms as stated, on the bands
    """

    scenario: Scenario
    axis: SpectralAxis
    sensor: Sensor | None
    surfaces: Mapping[str, SurfaceStatistics]
    terms: Callable[[], AtmosphericTerms]


@dataclass(frozen=True, eq=False)
class InputPath:
    """What stands at a path: ``nominal``, a number or (n,), and ``to``, value -> the truth that has it there."""

    nominal: Any
    to: Callable[[Array], Departure]


def input_path(given: Given, path: str) -> InputPath:
    """What a dotted path leads to.

    Raises
    ------
    UsageError : it leads nowhere, or to something that the scenario does not state.
    """
    scenario, parts = given.scenario, path_parts(path)
    if scenario.atmosphere is None and (parts[0] == "light" or path in _OF_LIGHT):
        raise UsageError(f"{path}: the scenario has no atmosphere")
    match parts:
        case ["atmosphere", field] if field in STATE_RANGES and scenario.atmosphere is not None:
            return _state(scenario.atmosphere, field)
        case ["light", key] if key in _LIGHT:
            return _factor(*_LIGHT[key])
        case ["sensor", key] if key in _SENSOR:
            return _factor(*_SENSOR[key])
        case [room, key] if (room, key) in _ADDED:
            name = _ADDED[room, key]
            return InputPath(0.0, lambda v: Departure(**{name: _plain(v)}))
        case ["line", "gain"]:
            return _factor("retrieval_gain", -np.inf)
        case ["line", "dark" | "bright" as panel]:
            return _panel(scenario, panel)
        case ["surfaces", name, key] if key in ("mean", "spread", "tail_dof", "fine_texture"):
            return _surface(given, name, key)
        case ["fill", *names]:
            return _fill(scenario, names[0] if names else None)
        case ["fraction", name]:
            return _fraction(scenario, name)
        case ["blur"]:
            return _blur(scenario)
    return InputPath(setting(scenario, path), lambda v: Departure(settings={path: np.asarray(v).ravel()[0].item()}))


PFA = "pfa"  # of studies alone: the false-alarm probability at which P_D is read
_OPERATION = ("frames_averaged", "averaged", "spatial_binning")
_OF_A_TARGET = {"gain": "target_gain", "illumination.beam": "beam", "illumination.sky_view": "sky"}


@dataclass(frozen=True)
class BatchColumn:
    """Where an entry of a scenario stands in a batch of the model, which may have other numbers in each evaluation.

    Attributes
    ----------
    kind : atmosphere, changes, operation, fraction, gain, tail, kappa, target_gain, beam, sky, fill, pfa; or
        anew, for entries after whose change everything is read anew
    item : number of the class or target that it belongs to
    subject : number of the target's population
    key : the entry, for atmosphere, changes, operation and fill
    """

    kind: str
    item: int = 0
    subject: int = 0
    key: str = ""


def batch_column(scenario: Scenario, path: str) -> BatchColumn:
    """What the entry at ``path`` is in a batch.

    Raises
    ------
    UsageError : no dotted path.
    """
    if path == PFA:
        return BatchColumn("pfa")
    lit, scene = scenario.atmosphere is not None, scenario.scene
    match path_parts(path):
        case ["atmosphere", key] if lit and key not in ("engine", "table"):
            return BatchColumn("atmosphere", key=key)
        case ["sensor_changes", key] if lit:
            return BatchColumn("changes", key=key)
        case ["sensor_operation", key] if lit and key in _OPERATION:
            return BatchColumn("operation", key=key)
        case ["scene", "adjacency", "effective_neighbours"]:
            return BatchColumn("kappa")
        case ["scene", "classes", name, key] if key in ("fraction", "gain", "tail_dof"):
            item = item_number([c.name for c in scene.classes], name, path)
            if key == "tail_dof" and scene.classes[item].has_mixture:
                return BatchColumn("anew", key=path)  # of its components
            return BatchColumn("tail" if key == "tail_dof" else key, item)
        case ["scene", "targets", name, *rest]:
            item = item_number([t.name for t in scene.targets], name, path)
            subjects = [s.name for s in scene.targets[item].subjects]
            if ".".join(rest) in _OF_A_TARGET:
                return BatchColumn(_OF_A_TARGET[".".join(rest)], item)
            if len(rest) > 1 and rest[0] == "fill" and not subjects:
                return BatchColumn("fill", item, 0, ".".join(rest[1:]))
            if len(rest) > 3 and (rest[0], rest[2]) == ("subjects", "fill") and subjects:
                return BatchColumn("fill", item, item_number(subjects, rest[1], path), ".".join(rest[3:]))
    return BatchColumn("anew", key=path)


def state_value(state: AtmosphericState, name: str) -> float:
    """The number that a state has for a field, also where it follows from others.

    Raises
    ------
    UsageError : the state leaves it to the engine.
    """
    derived: dict[str, Callable[[], float]] = {
        "aot550": lambda: state.aerosol_optical_depth,
        "solar_zenith_deg": lambda: state.sun[0],
        "solar_azimuth_deg": lambda: state.sun[1],
    }
    value = derived[name]() if name in derived else getattr(state, name)
    if value is None:
        raise UsageError(f"uncertainty: {name} is given, but the atmosphere's {name} is not", mend=f"state {name}")
    return float(value)


def _state(state: AtmosphericState, name: str) -> InputPath:
    value = state_value(state, name)
    low, high = STATE_RANGES[name]
    if name == "sensor_altitude_km":
        low = state.ground_altitude_km + 0.01
    if name == "ground_altitude_km":
        high = min(high, state.sensor_altitude_km - 0.01)

    def to(v: Array) -> Departure:
        moved = _number(v)
        if name in ("solar_zenith_deg", "solar_azimuth_deg"):
            return Departure(**{name: moved - value})  # type: ignore[arg-type]
        if name == "view_zenith_deg":
            moved = abs(moved)  # over the zenith and down on the other side
        elif name == "view_azimuth_deg":
            moved = moved % 360.0
        changes: dict[str, Any] = {f"atmosphere.{name}": float(np.clip(moved, low, high))}
        if name == "aot550":
            changes["atmosphere.meteorological_range_km"] = None
        return Departure(settings=changes)

    return InputPath(value, to)


def _factor(name: str, least: float) -> InputPath:
    return InputPath(1.0, lambda v: Departure(**{name: _plain(np.maximum(v, least))}))


def _panel(scenario: Scenario, panel: str) -> InputPath:
    """Factor 1 + e on the true reflectance of a panel.

    The line through (rho_1 (1 + e_1), L_1) and (rho_2 (1 + e_2), L_2) gives, where L is linear in rho,
    rho + rho_1 e_1 (rho_2 - rho)/(rho_2 - rho_1) + rho_2 e_2 (rho - rho_1)/(rho_2 - rho_1).
    """
    elm = scenario.processing.elm
    if not isinstance(elm, ElmPanels):
        raise UsageError("uncertainty: elm_panels needs an empirical line of two panels")
    low, high = elm.reflectances

    def to(v: Array) -> Departure:
        e = _plain(v) - 1.0
        slope = (-low if panel == "dark" else high) * e / (high - low)
        offset = -(high if panel == "dark" else low) * slope
        return Departure(retrieval_gain=1.0 + slope, retrieval_offset=offset)

    return InputPath(1.0, to)


def _surface(given: Given, name: str, key: str) -> InputPath:
    if name not in given.surfaces:
        raise UsageError(f"surfaces.{name}: no such surface", expected="one of " + ", ".join(given.surfaces))
    surface = given.surfaces[name]
    mean = np.nan_to_num(surface.mean)

    def with_mean(v: Array) -> Departure:
        return Departure(spectra={name: np.maximum(v, np.minimum(mean, 0.0)) - mean})  # no reflectance below 0

    def with_spread(v: Array) -> Departure:
        return Departure(statistics={name: StatisticsDeparture(factor=_number(v) ** 2)})

    def with_fine_texture(v: Array) -> Departure:
        return Departure(statistics={name: StatisticsDeparture(fine_texture=_number(v) - surface.fine_texture)})

    if key == "mean":
        return InputPath(mean, with_mean)
    if key == "fine_texture":
        if name not in [t.name for t in given.scenario.scene.targets]:
            raise UsageError(f"surfaces.{name}.fine_texture: {name!r} is no target")
        return InputPath(surface.fine_texture, with_fine_texture)
    return InputPath(1.0, with_spread) if key == "spread" else _tails(given, name)


def _tails(given: Given, name: str) -> InputPath:
    c = next((c for c in given.scenario.scene.classes if c.name == name), None)
    if c is None:
        raise UsageError(f"surfaces.{name}.tail_dof: no class {name!r}")
    path = f"scene.classes.[{name}].tail_dof"
    stated = class_tail(c, given.surfaces[name]) or np.inf
    return InputPath(stated, lambda v: Departure(settings={path: _number(v)}))


def _fill(scenario: Scenario, name: str | None) -> InputPath:
    fills = {
        p.name: fill_distribution(p.fill).mean
        for t in scenario.scene.targets
        for p in t.populations
        if name in (None, t.name, p.name)
    }
    if not fills:
        raise UsageError(
            "fill: no target of the scene has one" if name is None else f"fill.{name}",
            expected="a target of the scene",
        )
    stated = np.array(list(fills.values()))

    def to(v: Array) -> Departure:
        moved = np.clip(v, 0.0, 1.0) - stated
        return Departure(fill=dict(zip(fills, moved.tolist(), strict=True)))

    return InputPath(stated, to)


def _fraction(scenario: Scenario, name: str) -> InputPath:
    stated = {c.name: c.fraction for c in scenario.scene.classes}
    if name not in stated:
        raise UsageError(f"fraction.{name}: no such class", expected="one of " + ", ".join(stated))
    own = stated[name]
    if len(stated) < 2 or own >= 1.0:
        raise UsageError(f"uncertainty: fractions: {name!r} is the only class with an area")
    return InputPath(own, lambda v: Departure(fractions={name: _number(v) - own}))


def _blur(scenario: Scenario) -> InputPath:
    """One blur for all targets whose fill follows from geometry."""
    places = []
    for t in scenario.scene.targets:
        fills = [
            (f"scene.targets.[{t.name}].subjects.{i}.fill", population.fill)
            for i, population in enumerate(t.subjects)
        ]
        fills += [(f"scene.targets.[{t.name}].fill", t.fill)] if t.fill is not None else []
        for path, fill in fills:
            if fill.geometry is not None:
                width = np.atleast_1d(fill.geometry.psf_fwhm_pixels or 0.0)
                places.append((f"{path}.geometry.psf_fwhm_pixels", width))
    if not places:
        raise UsageError("blur: no fill of the scene follows from geometry")
    ends = np.cumsum([width.size for _, width in places])[:-1]

    def to(v: Array) -> Departure:
        moved = np.split(np.clip(v, 0.0, _WIDEST_BLUR), ends)
        settings: dict[str, Any] = {
            path: float(w[0]) if w.size == 1 else w.tolist() for (path, _), w in zip(places, moved, strict=True)
        }
        return Departure(settings=settings)

    return InputPath(np.concatenate([width for _, width in places]), to)


def _plain(v: npt.ArrayLike) -> Any:
    """A number where one is given, else the array."""
    return _number(v) if np.size(v) == 1 else np.asarray(v, dtype=float)


def _number(v: npt.ArrayLike) -> float:
    return float(np.asarray(v).reshape(-1)[0])
