"""U truths of one scenario as arrays, and the one table of what can be moved in them.

:func:`read` makes the world that a scenario states (U = 1); :func:`with_values` is the only way anything in it is
moved.  The scenario is what is believed: filters look for the spectra it names, products are labelled by its bands.
What is moved is what is there to be seen.

An array has U rows, or one where all truths share it, so that what nothing moves is computed once.  What several paths
move (:data:`PATHS`) composes: factors multiply, what is added adds up.
"""

from __future__ import annotations

import difflib
import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path as FilePath
from pathlib import PurePath
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState, atmospheric_terms
from hyperval.atmosphere.between import InterpolatedTerms, interpolated_terms, stacked_values
from hyperval.atmosphere.state import LONGEST_KM, MAX_SOLAR_ZENITH_DEG, SHORTEST_KM
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.data import ClassStatistics
from hyperval.errors import InputError, UsageError
from hyperval.model.fill import (
    Fills,
    fill_distribution,
    fills_of_population,
    pixels_of_object,
    stacked_fills,
    whole_object_fills,
    with_mean,
)
from hyperval.model.surfaces import Read, Resolve, Sources, SurfaceStatistics, class_tail, cut, without_gaps
from hyperval.progress import track
from hyperval.scenario import ElmPanels, Fill, Illumination, Scenario, Target, TargetSubject
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import (
    Sensor,
    SensorChanges,
    SensorOperation,
    binned_axis,
    binned_noise,
    changed_noise,
    library_names,
    load_sensor,
)
from hyperval.settings import item_number, numbers_of, path_parts, setting, with_settings
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Values = npt.NDArray[Any]
Truth = Mapping[str, Any]  # dotted path -> what stands there, of one truth; what is not named is as stated
Engine = Callable[[AtmosphericState], AtmosphericTerms]


class Path(NamedTuple):
    """Where a dotted path leads.

    Attributes
    ----------
    field : array of the world; empty: an entry of the scenario's file, after whose change it is read again
    of : what its star names: class, target or surface
    shape : of a value: a number, or a spectrum or list of numbers (vector)
    low, high : between which it can be
    """

    field: str
    of: str = ""
    unit: str = "1"
    shape: str = "number"
    low: float = -np.inf
    high: float = np.inf


_RADIANCE = "uW cm-2 sr-1 nm-1"
# Field of the state: lowest, highest value.
STATE_RANGES: dict[str, tuple[float, float]] = {
    "aot550": (0.0, 5.0),
    "meteorological_range_km": (SHORTEST_KM, LONGEST_KM),
    "water_vapour_g_cm2": (0.01, 10.0),
    "ozone_atm_cm": (0.01, 1.0),
    "angstrom_exponent": (-1.0, 3.0),
    "aerosol_share_below": (1e-3, 1.0),
    "solar_zenith_deg": (-MAX_SOLAR_ZENITH_DEG, MAX_SOLAR_ZENITH_DEG - 0.1),
    "solar_azimuth_deg": (-720.0, 720.0),
    "view_zenith_deg": (-70.0, 70.0),
    "view_azimuth_deg": (-720.0, 720.0),
    "sensor_altitude_km": (0.01, 100_000.0),
    "ground_altitude_km": (0.0, 5.0),
}
WIDEST_BLUR = 5.0  # [pixels]
# Pattern -> where it leads; a star stands for a name, two for the rest.  The first that fits is taken.
PATHS: Mapping[str, Path] = {
    # a number of the state of the atmosphere, sun and view
    **{f"atmosphere.{key}": Path("atmosphere", low=low, high=high) for key, (low, high) in STATE_RANGES.items()},
    "atmosphere.*": Path("atmosphere"),
    # factors on all light, the path radiance (and added to it), the light reflected by the ground, the spherical
    # albedo, and the reflectance of the surroundings
    "light.irradiance": Path("irradiance", shape="vector", low=0.01),
    "light.path": Path("path", shape="vector", low=0.0),
    "light.path_error": Path("path_error", unit=_RADIANCE, shape="vector"),
    "light.ground": Path("ground", shape="vector", low=0.0),
    "light.spherical_albedo": Path("albedo", shape="vector", low=0.0),
    "light.surroundings": Path("surroundings", shape="vector", low=0.01),
    # what is recorded is gain L + offset; where there is no atmosphere, the reflectance of all that was not measured
    # on the imagery.  Factors on the noise and on the electrons per radiance; added to the true band centres
    "sensor.gain": Path("gain", shape="vector"),
    "sensor.offset": Path("offset", unit=_RADIANCE, shape="vector"),
    "sensor.noise": Path("noise", shape="vector", low=1e-3),
    "sensor.electrons": Path("electrons", shape="vector", low=1e-3),
    "sensor.wavelength_shift_nm": Path("", unit="nm", shape="vector"),
    # for the detectors, as what the line says of collected reflectance is the collection's: factors on the true
    # reflectance of a panel, which the line takes for what is stated; it gives gain rho + offset for rho
    "line.dark": Path("dark", shape="vector", low=0.0),
    "line.bright": Path("bright", shape="vector", low=0.0),
    "line.gain": Path("line_gain", shape="vector"),
    "line.offset": Path("line_offset", shape="vector"),
    # mean reflectance, factor on its standard deviation, degrees of freedom of the tails of a class, part of a
    # target's covariance that goes by its fill, not the fill's square
    "surfaces.*.mean": Path("mean", "surface", shape="vector"),
    "surfaces.*.spread": Path("spread", "surface", low=0.0),
    "surfaces.*.tail_dof": Path("tail", "class", low=2.0),
    "surfaces.*.fine_texture": Path("fine_texture", "surface", low=0.0, high=1.0),
    # mean fills of all targets, of one or of its subject; area fraction, the others give way in proportion; widths of
    # the blur wherever a fill follows from geometry
    "fill": Path("fill", shape="vector", low=0.0, high=1.0),
    "fill.*": Path("fill", shape="vector", low=0.0, high=1.0),
    "fraction.*": Path("share", "class", low=0.0, high=1.0),
    "blur": Path("blur", unit="pixels", shape="vector", low=0.0, high=WIDEST_BLUR),
    # entries of the file
    "sensor_changes.*": Path("sensor"),
    "sensor_operation.frames_averaged": Path("sensor"),
    "sensor_operation.averaged": Path("sensor"),
    "sensor_operation.spatial_binning": Path("sensor"),
    "scene.adjacency.effective_neighbours": Path("neighbours", low=1.0),
    "scene.classes.*.fraction": Path("fraction", "class", low=0.0, high=1.0),
    "scene.classes.*.gain": Path("class_gain", "class", low=0.0),
    "scene.classes.*.tail_dof": Path("tail", "class", low=2.0),
    "scene.targets.*.gain": Path("target_gain", "target", low=0.0),
    "scene.targets.*.illumination.beam": Path("beam", "target", low=0.0, high=1.0),
    "scene.targets.*.illumination.sky_view": Path("sky_view", "target", low=0.0, high=1.0),
    "scene.targets.*.fill.**": Path("fill entry"),
    "scene.targets.*.subjects.*.fill.**": Path("fill entry"),
    "**": Path(""),
}
SHIFT = "sensor.wavelength_shift_nm"
# One number for all bands, or one for each, as it is where nothing is moved.
NEUTRAL = {
    **dict.fromkeys(
        ("irradiance", "path", "ground", "albedo", "surroundings", "gain", "noise", "electrons", "dark", "bright",
         "line_gain"), 1.0),
    **dict.fromkeys(("path_error", "offset", "line_offset"), 0.0),
}  # fmt: skip
_NOT_WITHOUT_LIGHT = ("light.*", "sensor.noise", "sensor.electrons", "atmosphere.*")
# What leaves light, sensor and classes alone, and with them the filters.
_OF_TARGETS = ("tail", "fill", "fill entry", "blur", "target_gain", "beam", "sky_view", "fine_texture")


def fits(pattern: str, path: str) -> bool:
    """Whether a path is of a pattern of :data:`PATHS`."""
    of, parts = pattern.split("."), path_parts(path)
    if of[-1] == "**":
        of, parts = of[:-1], parts[: len(of) - 1]
    return len(of) == len(parts) and all(a in ("*", b) for a, b in zip(of, parts, strict=True))


def in_file(path: str) -> bool:
    """Whether a path is an entry of the scenario's file; others lead to an array of the world alone."""
    root = next(p for p in PATHS if fits(p, path)).partition(".")[0]
    return root in ("atmosphere", "sensor_changes", "sensor_operation", "scene", "**")


def column_of(values: Sequence[Any]) -> Values:
    """Values as a column: numbers as floats, anything else as objects."""
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return np.array(values, dtype=float)
    items = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):  # one by one: lists of one length are not rows of a matrix
        items[i] = value
    return items


def _numbers(values: Values) -> Array:
    """A column of numbers, NaN where an entry is as stated."""
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def plain(value: Any) -> Any:
    """A value as a model takes it: a whole number where it is one."""
    value = value.item() if hasattr(value, "item") else value
    return int(value) if isinstance(value, float) and value.is_integer() else value


def distinct(columns: Iterable[Values], n: int) -> tuple[Index, Index]:
    """First of the n rows of each different combination of the columns, and which (n,) of these each row has."""

    def bits(column: Values) -> list[Any]:
        if column.dtype == object:
            return [repr(v) for v in column]
        alone = column.ndim == 1
        return column.astype(float).view(np.int64).tolist() if alone else [row.tobytes() for row in column]

    keys = list(zip(*map(bits, columns), strict=True)) or [()] * n
    order = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    which = np.array([order[key] for key in keys], dtype=int)
    return np.unique(which, return_index=True)[1], which


# Sensor; bands of all products as they are labelled, and where they truly stand, one object where nothing is shifted;
# noise on them.
Instrument = tuple[Sensor | None, SpectralAxis, SpectralAxis, NoiseModel | None]


def _sensor(name: str, find: Resolve) -> Sensor:
    """A sensor of the library, or of a file beside the scenario."""
    if name in library_names():
        return load_sensor(name)
    try:
        path = find(name)
    except InputError:
        if PurePath(name).suffix or ":" in name:  # meant as a file
            raise
        raise UsageError(
            f"unknown sensor {name!r}", expected="a sensor file or one of " + ", ".join(library_names())
        ) from None
    return load_sensor(path)


def instrument(
    scenario: Scenario,
    axis: SpectralAxis | None,
    measured_axis: SpectralAxis | None,
    find: Resolve,
    given: Sensor | None = None,
) -> Instrument:
    """The sensor a scenario names, or the one given in its place, on the bands asked for or its own (3.13-3.20).

    Raises
    ------
    UsageError : no bands, or bins of bands that are handed in.
    """
    operation = scenario.sensor_operation
    sensor = given
    if sensor is None and scenario.sensor is not None:
        sensor = _sensor(scenario.sensor, find)
    on = axis or (sensor.axis if sensor else None) or measured_axis
    if on is None:
        raise UsageError(
            "the scenario has no bands",
            mend="name a sensor (sensor:), or run it from a campaign, whose image has bands (hyperval validate)",
        )
    if sensor is None:
        return None, on, on, None
    noise, true = noise_model(sensor, on, operation, scenario.sensor_changes, {}), sensor.true_axis(on, operation)
    count = operation.spectral_binning if operation else 1
    if count > 1:
        if axis is not None:
            raise UsageError(
                "sensor_operation.spectral_binning: the bands of a collection are what they are",
                mend="leave spectral_binning out: a binned cube has binned bands already",
            )
        if count > len(on):
            raise UsageError(f"sensor_operation.spectral_binning: bins of {count} of {len(on)} bands")
        shifted, on = true is not on, binned_axis(on, count)
        true = binned_axis(true, count) if shifted else on
    return sensor, on, true, noise


def noise_model(
    sensor: Sensor, axis: SpectralAxis | None, operation: SensorOperation | None, changes: SensorChanges | None,
    kept: dict[Any, Any],
) -> NoiseModel:  # fmt: skip
    """Noise of a sensor as it is run and changed (3.13)-(3.20); ``kept``: that of each way to run it."""
    key = "noise", repr(operation)
    if key not in kept:
        kept[key] = sensor.noise(axis, operation)
    model: NoiseModel = kept[key] if changes is None else changed_noise(kept[key], changes)
    count = operation.spectral_binning if operation else 1
    return binned_noise(model, min(count, len(sensor.axis))) if count > 1 else model


def with_sensor_blur(scenario: Scenario, sensor: Sensor | None) -> Scenario:
    """The scenario with the sensor's point spread function where a geometry states none."""
    psf, widths = sensor and sensor.specification.psf, {}
    for t, target in enumerate(scenario.scene.targets if psf else ()):
        for k, population in enumerate(target.populations):
            geometry = population.fill.geometry
            if psf and geometry is not None and geometry.psf_fwhm_pixels is None:
                where = f"subjects.{k}." if target.subjects else ""
                widths[f"scene.targets.{t}.{where}fill.geometry.psf_fwhm_pixels"] = psf.fwhm
    return with_settings(scenario, widths) if widths else scenario


def refuse_gaps(scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], axis: SpectralAxis) -> None:
    """Refuse a spectrum that does not cover the band set: usable bands beyond one of its ends.

    Bands on the bad-band list may lack, and one band at each end; so may bands within
    the spectrum that its file marks as unknown.

    Raises
    ------
    UsageError : with the field of the scenario.
    """
    scene = scenario.scene
    for key in ("classes", "panels", "sites", "targets"):
        for i, surface in enumerate(getattr(scene, key)):
            if surface.spectrum.measured is not None or surface.spectrum.gaps == "allowed":
                continue
            known = np.flatnonzero(np.isfinite(surfaces[surface.name].mean))
            beyond = axis.good.copy()
            # One band at each end may lack: its centre is covered where its response reaches a little further.
            beyond[max(known[0] - 1, 0) : known[-1] + 2] = False
            if beyond.any():
                w = axis.centre_nm[beyond]
                raise UsageError(
                    f"scene.{key}.{i}.spectrum of {surface.name!r} does not cover {int(beyond.sum())} usable bands "
                    f"(first {w[0]:g} nm, last {w[-1]:g} nm)",
                    expected=f"a spectrum over {axis.centre_nm[0]:g}-{axis.centre_nm[-1]:g} nm",
                    mend="give a longer spectrum, mark those bands bad, or allow it: spectrum: {gaps: allowed}",
                )


def surfaces_of(
    scenario: Scenario, sources: Sources, labelled: Sources
) -> tuple[dict[str, SurfaceStatistics], dict[str, Array]]:
    """Statistics where the bands truly stand; what detectors look for where they are labelled."""
    scene = scenario.scene
    surfaces = {s.name: sources.surface(s) for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}
    refuse_gaps(scenario, surfaces, sources.axis)
    signatures = {t.name: labelled.spectrum(t.filter_spectrum or t.spectrum, t.name).mean for t in scene.targets}
    return surfaces, signatures


# What decides which files an engine finds.
_ENVIRONMENT = (
    "HYPERVAL_CACHE", "HYPERVAL_DATA", "HYPERVAL_MODTRAN", "HYPERVAL_MODTRAN_VERSION", "HYPERVAL_MODTRAN_DATA"
)  # fmt: skip


@lru_cache(maxsize=32)
def _terms_in_memory(
    engine: Callable[..., AtmosphericTerms], state: AtmosphericState, centre_nm: bytes, fwhm_nm: bytes,
    environment: tuple[str | None, ...], cache_dir: FilePath | None, show_progress: bool | None,
) -> AtmosphericTerms:  # fmt: skip
    """Terms at bands: engines are deterministic, and give the same to the same state, files and bands."""
    axis = SpectralAxis(np.frombuffer(centre_nm), np.frombuffer(fwhm_nm))
    return engine(state, cache_dir=cache_dir, show_progress=show_progress).at_bands(axis)


@dataclass(frozen=True)
class Origins:
    """Where the numbers of a scenario come from, besides what it says itself.

    Attributes
    ----------
    axis : bands of all products; None: the sensor's own, or those of the measured statistics
    measured : region -> reflectance statistics on ``axis``, for surfaces with ``measured:``
    resolve : turns a file reference of the scenario into a path; None: relative to the scenario's file, or
        ``data:`` for a registered data set
    cache_dir, show_progress : of the atmosphere engine
    engine : stands in for the atmosphere engine
    sensor : stands in for the sensor that the scenario names
    left_out : (region, its measured statistics without each of the parts of the image that it lies in), of the
        regions whose law is known from their pixels alone
    read : spectra of the scenario's files, once they were read
    """

    axis: SpectralAxis | None = None
    measured: Mapping[str, ClassStatistics] | None = None
    resolve: Resolve | None = None
    cache_dir: FilePath | None = None
    show_progress: bool | None = None
    engine: Engine | None = None
    sensor: Sensor | None = None
    left_out: Callable[[], Iterable[tuple[str, Sequence[ClassStatistics]]]] | None = None
    read: Read = field(default_factory=dict, repr=False, compare=False)

    def find(self, scenario: Scenario) -> Resolve:
        """Turns the file references of a scenario into paths."""
        return self.resolve or (lambda reference: datasets.resolve(reference, scenario.folder))

    def terms(self, scenario: Scenario, state: AtmosphericState, axis: SpectralAxis) -> AtmosphericTerms:
        """Terms of a state of the atmosphere on the true bands.

        Raises
        ------
        EngineError : the atmosphere engine failed.
        """
        if self.engine is not None or state.engine == "table":  # a file of the scenario, read again when it changes
            return self.whole_terms(scenario, state).at_bands(axis)
        environment = tuple(os.environ.get(name) for name in _ENVIRONMENT)
        bands = axis.centre_nm.tobytes(), axis.fwhm_nm.tobytes()
        return _terms_in_memory(atmospheric_terms, state, *bands, environment, self.cache_dir, self.show_progress)

    def whole_terms(self, scenario: Scenario, state: AtmosphericState) -> AtmosphericTerms:
        """The same on the engine's own sampling."""
        if self.engine is not None:
            return self.engine(state)
        if state.engine == "table":
            return atmospheric_terms(state, resolve=self.find(scenario))
        return atmospheric_terms(state, cache_dir=self.cache_dir, show_progress=self.show_progress)


@dataclass(eq=False)
class Atmosphere:
    """The atmosphere over a scenario, at its bands: terms of (3.7) in any of its states.

    Attributes
    ----------
    nodes : entry -> nodes between which terms are interpolated; empty: a run of the engine for each state
    runs : terms by the entries that differ from the stated state
    """

    scenario: Scenario
    origins: Origins
    axis: SpectralAxis
    nodes: Mapping[str, Sequence[float]] = field(default_factory=dict)
    runs: dict[str, AtmosphericTerms] = field(default_factory=dict)

    def run(self, changes: Truth) -> AtmosphericTerms:
        """The engine, where some entries of the state differ; once for each state."""
        key = repr(sorted(changes.items()))
        if key not in self.runs:
            assert self.scenario.atmosphere is not None  # noqa: S101 - there is light
            state = self.scenario.atmosphere
            state = with_settings(state, state_entries(state, changes)) if changes else state
            self.runs[key] = self.origins.terms(self.scenario, state, self.axis)
        return self.runs[key]

    def run_all(self, rows: Sequence[Truth], what: str, show_progress: bool | None) -> list[AtmosphericTerms]:
        """The engine in many states."""
        if len(rows) > MOST_RUNS:
            raise UsageError(
                f"{len(rows)} {what} of the atmosphere", expected=f"at most {MOST_RUNS} runs of its engine"
            )
        return [self.run(row) for row in track(rows, f"atmosphere, {what}", len(rows), show=show_progress)]

    def at_nodes(self, show_progress: bool | None = False) -> InterpolatedTerms:
        """Runs at every combination of the nodes.

        Raises
        ------
        UsageError : too many nodes, fewer than two of an entry, or a node that is no valid state.
        """
        grid = {n: np.asarray(v, dtype=float) for n, v in self.nodes.items()}
        for name, values in grid.items():
            if values.size < 2 or np.any(np.diff(values) <= 0):
                raise UsageError(f"nodes of atmosphere.{name}: {values.tolist()}", expected="two or more, rising")
        rows = [dict(zip(grid, row, strict=True)) for row in product(*(v.tolist() for v in grid.values()))]
        return interpolated_terms(grid, self.run_all(rows, "nodes", show_progress))

    def prepare(self, states: Sequence[Truth], show_progress: bool | None) -> None:
        """Run the engine, before truths go to other processes: in some states, or at the nodes."""
        if self.nodes:
            self.__dict__["between"] = self.at_nodes(show_progress)
        elif self.scenario.atmosphere is not None:
            self.run_all(states, "states", show_progress)

    @cached_property
    def between(self) -> InterpolatedTerms:
        """The same, kept."""
        return self.at_nodes()

    def __call__(self, moved: Mapping[str, Values], size: int) -> AtmosphericTerms:
        """Terms (U or 1, 1, B) where entries (U or 1,) of the state are moved; None leaves one as it is.

        Without an atmosphere reflectance is seen as it is: A = 1, L_a = B = S = 0.

        Raises
        ------
        UsageError : a state outside the nodes; a table is never extrapolated.
        """
        state = self.scenario.atmosphere
        if state is None:
            zero = np.zeros((1, 1, len(self.axis)))
            return AtmosphericTerms(self.axis.centre_nm, zero, zero + 1.0, zero, zero, zero, zero + 1.0)
        if self.nodes and moved:
            columns = {
                n: np.broadcast_to(moved.get(f"atmosphere.{n}", np.array([np.nan])), (size,)).astype(float)
                for n in self.nodes
            }
            columns = {n: np.where(np.isnan(c), state_value(state, n), c) for n, c in columns.items() if n in columns}
            terms = self.between(columns)
            return replace(terms, **{n: getattr(terms, n)[:, None, :] for n in self.between.values})
        first, which = distinct((np.broadcast_to(v, (size,)) for v in moved.values()), size)
        names = [path.partition(".")[2] for path in moved]
        rows = [[v[u if len(v) > 1 else 0] for v in moved.values()] for u in first]
        states = [{n: plain(v) for n, v in zip(names, row, strict=True) if v is not None} for row in rows]
        runs = [self.run(changes) for changes in states]
        every: Any = which if len(runs) > 1 else slice(None)
        return replace(runs[0], **{n: v[:, None, :][every] for n, v in stacked_values(runs).items()})


def state_entries(state: AtmosphericState, changes: Truth) -> dict[str, Any]:
    """Entries of a state in which some stand at other values, and those that give way to them.

    A sun that follows from place and time is stated by its angles; one that passes the zenith comes down on the
    other side.
    """
    out = dict(changes)
    if "aot550" in out:
        out.setdefault("meteorological_range_km", None)
    if "view_zenith_deg" in out:
        out["view_zenith_deg"] = abs(out["view_zenith_deg"])
    if "view_azimuth_deg" in out:
        out["view_azimuth_deg"] = out["view_azimuth_deg"] % 360.0
    if not {"solar_zenith_deg", "solar_azimuth_deg"} & set(out):
        return out
    zenith, azimuth = (out.get(f"solar_{k}_deg", at) for k, at in zip(("zenith", "azimuth"), state.sun, strict=True))
    if zenith < 0.0:
        zenith, azimuth = -zenith, azimuth + 180.0
    out |= {"solar_zenith_deg": min(zenith, MAX_SOLAR_ZENITH_DEG - 0.1), "solar_azimuth_deg": azimuth % 360.0}
    if state.time_utc is not None:
        out["earth_sun_distance_au"] = state.distance_au
        out |= dict.fromkeys(("latitude_deg", "longitude_deg", "time_utc"))
    return out


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


Made = TypeVar("Made")


class Keeps:
    """What keeps what follows from it, once it was asked for."""

    kept: dict[Any, Any]

    def once(self, key: Any, make: Callable[[], Made]) -> Made:
        """What ``make`` gives, made the first time that ``key`` is asked for."""
        if key not in self.kept:
            self.kept[key] = make()
        made: Made = self.kept[key]
        return made


@dataclass(frozen=True, eq=False)
class Stated(Keeps):
    """What a scenario and its files say on its bands: read once, shared by all truths.

    Attributes
    ----------
    scenario : with the sensor's blur where it states none
    sensor : None where it has none
    axis, true_axis : the bands as they are labelled, and where they truly stand; the same where nothing is shifted
    noise : (3.13)-(3.20) as stated; None without a sensor
    surfaces : name -> statistics of every class, panel, site and target, where the bands truly stand
    signatures : target -> (B,) reflectance that its filter looks for, where the bands are labelled
    surroundings : (B,) their reflectance where the scenario states it; None: the average of the classes
    before : what the values of paths refer to, where this was read again after the change of some; None: this
    kept : what follows from it alone, once it was asked for
    """

    scenario: Scenario
    origins: Origins
    sensor: Sensor | None
    axis: SpectralAxis
    true_axis: SpectralAxis
    noise: NoiseModel | None
    surfaces: Mapping[str, SurfaceStatistics]
    signatures: Mapping[str, Array]
    surroundings: Array | None
    atmosphere: Atmosphere
    before: Stated | None = None
    kept: dict[Any, Any] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        return {**{k: v for k, v in vars(self).items() if k in self.__dataclass_fields__}, "kept": {}}

    @property
    def nominal(self) -> Stated:
        """What the values of paths refer to."""
        return self.before or self

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """What the star of a path names."""
        scene = self.scenario.scene
        return {
            "class": [c.name for c in scene.classes], "surface": list(self.surfaces),
            "target": [t.name for t in scene.targets],
        }  # fmt: skip

    @property
    def classes(self) -> list[str]:
        """Names of the M background classes."""
        return self.names["class"]

    @property
    def targets(self) -> list[Target]:
        """The targets of the scene."""
        return self.scenario.scene.targets

    @cached_property
    def populations(self) -> list[tuple[int, int, TargetSubject]]:
        """Number of the target, number in it, and population of target pixels."""
        return [(t, k, p) for t, target in enumerate(self.targets) for k, p in enumerate(target.populations)]

    @cached_property
    def mean(self) -> Array:
        """(S, B) mean reflectance of the surfaces."""
        return np.array([s.mean for s in self.surfaces.values()])

    @cached_property
    def columns(self) -> dict[str, Array]:
        """Field -> (1, items) as stated."""
        scene, lights = self.scenario.scene, [t.illumination or Illumination() for t in self.targets]
        tails = [class_tail(c, self.surfaces[c.name]) for c in scene.classes]
        of: dict[str, list[float]] = {
            "fraction": [c.fraction for c in scene.classes],
            "class_gain": [c.gain for c in scene.classes],
            "tail": [np.inf if t is None else float(t) for t in tails],
            "neighbours": [scene.adjacency.effective_neighbours or np.inf],
            "target_gain": [t.gain for t in self.targets],
            "beam": [light.beam for light in lights],
            "sky_view": [light.sky_view for light in lights],
            "spread": [1.0] * len(self.surfaces),
            "fine_texture": [s.fine_texture for s in self.surfaces.values()],
        }
        return {name: np.array([values], dtype=float) for name, values in of.items()} | {
            name: np.array([[value]]) for name, value in NEUTRAL.items()
        }

    @cached_property
    def laws(self) -> tuple[Law, ...]:
        """What the scores of the classes are distributed as: a class each, or the components of a mixture."""
        out = []
        for m, c in enumerate(self.scenario.scene.classes):
            surface = self.surfaces[c.name]
            parts = surface.components
            if parts is None:
                out.append(Law(m, 1.0, None, surface.covariance, None))
                continue
            dof = None if isinstance(c.tail_dof, float) else parts.dof
            laws = zip(parts.weights.tolist(), parts.offsets, parts.covariances, strict=True)
            out += [Law(m, w, offset, covariance, dof) for w, offset, covariance in laws]
        return tuple(out)


class Law(NamedTuple):
    """A class of the background, or one component of it.

    Attributes
    ----------
    owner : number of the class
    weight : part of the class
    offset : (B,) of its mean from that of the class; None: the class itself
    covariance : (B, B)
    dof : degrees of freedom of a component; None: those of the class
    """

    owner: int
    weight: float
    offset: Array | None
    covariance: Array
    dof: float | None

    def at(self, bands: Index) -> Law:
        """The law on some bands."""
        offset = None if self.offset is None else self.offset[bands]
        return self._replace(offset=offset, covariance=cut(self.covariance, bands))


def find(stated: Stated, path: str) -> tuple[Path, int]:
    """Where a path leads, and the number of its item.

    Raises
    ------
    UsageError : to something that the scenario does not have.
    """
    return stated.once(("path", path), lambda: _found(stated, path))


def _found(stated: Stated, path: str) -> tuple[Path, int]:
    pattern = next(p for p in PATHS if fits(p, path))
    entry, parts, scenario = PATHS[pattern], path_parts(path), stated.scenario
    if scenario.atmosphere is None:
        if any(fits(p, path) for p in _NOT_WITHOUT_LIGHT[:3]):
            raise UsageError(f"{path}: the scenario has no atmosphere")
        if entry.field in ("atmosphere", "sensor"):
            return PATHS["**"], 0
    if entry.field in ("dark", "bright") and not isinstance(scenario.processing.elm, ElmPanels):
        raise UsageError("uncertainty: elm_panels needs an empirical line of two panels")
    if entry.field == "atmosphere":
        nodes = stated.atmosphere.nodes
        again = parts[1] in ("engine", "table") or (nodes and parts[1] not in nodes)
        return (PATHS["**"] if again else entry), 0
    if entry.field == "fill entry":
        return _of_fill(stated, entry, parts, path)
    if entry.field == "fill" and not _filled(stated, path):
        what = "fill: no target of the scene has one" if len(parts) == 1 else path
        raise UsageError(what, expected="a target of the scene")
    if entry.field == "blur" and not _blurred(stated):
        raise UsageError("blur: no fill of the scene follows from geometry")
    if not entry.of:
        return entry, 0
    name, names = parts[pattern.split(".").index("*")], stated.names[entry.of]
    if parts[0] == "scene":
        return entry, item_number(names, name, path)
    if name not in names:
        raise UsageError(f"{path}: no such {entry.of}", expected="one of " + ", ".join(names))
    if entry.field == "fine_texture" and name not in stated.names["target"]:
        raise UsageError(f"{path}: {name!r} is no target")
    return entry, names.index(name)


def _of_fill(stated: Stated, entry: Path, parts: Sequence[str], path: str) -> tuple[Path, int]:
    """An entry of the fill of a population, whose number is that among all of the scene."""
    number = item_number(stated.names["target"], parts[2], path)
    subjects = [s.name for s in stated.targets[number].subjects]
    if (parts[3] == "subjects") != bool(subjects):
        return PATHS["**"], 0  # it is read again, and refused
    within = item_number(subjects, parts[4], path) if subjects else 0
    return entry, next(i for i, (t, k, _) in enumerate(stated.populations) if (t, k) == (number, within))


def _filled(stated: Stated, path: str) -> list[int]:
    """Numbers of the populations whose mean fill a path moves."""
    name = path_parts(path)[1] if path != "fill" else None
    return [
        i for i, (t, _, p) in enumerate(stated.populations) if name in (None, p.name, stated.targets[t].name)
    ]  # fmt: skip


def _blurred(stated: Stated) -> dict[int, slice]:
    """Number of a population whose fill follows from geometry -> its part of the widths of the blur."""
    out, end = {}, 0
    for i, (_, _, p) in enumerate(stated.populations):
        if p.fill.geometry is not None:
            width = np.size(p.fill.geometry.psf_fwhm_pixels or 0.0)
            out[i], end = slice(end, end + width), end + width
    return out


def value_at(world: World, path: str) -> Any:
    """What stands at a path: (U or 1, ...), or of one truth as stated.

    Raises
    ------
    UsageError : it leads nowhere, or to something that the scenario does not state.
    """
    if path in world.moved:
        return world.moved[path]
    stated, parts = world.stated, path_parts(path)
    entry, item = find(stated, path)
    if entry.field in stated.columns:
        columns = stated.columns[entry.field]
        return columns[:, item] if entry.of else columns[:, 0]
    if entry.field == "mean":
        return np.nan_to_num(stated.mean[item : item + 1])
    if entry.field == "share":
        fractions = stated.columns["fraction"][0]
        if fractions.size < 2 or fractions[item] >= 1.0:
            raise UsageError(f"uncertainty: fractions: {parts[1]!r} is the only class with an area")
        return fractions[item : item + 1]
    if entry.field == "fill":
        return np.array([[fill_distribution(stated.populations[i][2].fill).mean for i in _filled(stated, path)]])
    if entry.field == "blur":
        fills = (stated.populations[i][2].fill.geometry for i in _blurred(stated))
        return np.concatenate([np.atleast_1d((g and g.psf_fwhm_pixels) or 0.0) for g in fills])[None].astype(float)
    if path == SHIFT:
        return np.zeros(1)
    if parts[0] == "atmosphere" and len(parts) == 2 and parts[1] in STATE_RANGES and stated.scenario.atmosphere:
        return np.array([state_value(stated.scenario.atmosphere, parts[1])])
    return _entry(world, path)


def _entry(world: World, path: str) -> Any:
    """The entry of the scenario's file."""
    try:
        return column_of([setting(world.stated.scenario, path)])
    except UsageError as error:
        near = difflib.get_close_matches(path, every_path(world), n=1)
        if error.mend or not near:
            raise
        mend = f"did you mean {near[0]}?"
        raise UsageError(error.what, where=error.where, expected=error.expected, mend=mend) from error


def every_path(world: World) -> list[str]:
    """Every path of a scenario that leads to a number, or to numbers over wavelength: what can be moved."""
    stated = world.stated
    fills = [n for t in stated.targets for n in (t.name, *(p.name for p in t.populations))]
    names = {**stated.names, "fill": list(dict.fromkeys(fills))}
    out = []
    for pattern, entry in PATHS.items():
        of_file = pattern.startswith(("scene.", "sensor_")) or pattern in ("atmosphere.*", "**")
        dark = pattern.startswith("atmosphere.") and stated.scenario.atmosphere is None
        if of_file or dark:
            continue
        for name in names[entry.of or "fill"] if "*" in pattern else [""]:
            path = pattern.replace("*", f"[{name}]")
            try:
                value_at(world, path)
            except UsageError:  # not in this scenario
                continue
            out.append(path)
    return list(dict.fromkeys([*out, *numbers_of(stated.scenario)]))


@dataclass(frozen=True, eq=False)
class World:
    """U truths of one scenario.

    Attributes
    ----------
    moved : path -> values (U or 1, ...) of all that was moved; what follows from them is made when it is asked for
    """

    stated: Stated
    moved: Mapping[str, Values] = field(default_factory=dict)

    @cached_property
    def size(self) -> int:
        """U."""
        return max((len(v) for v in self.moved.values()), default=1)

    def rows(self, index: Index) -> World:
        """Some of the truths."""
        if index.size == self.size and np.array_equal(index, np.arange(self.size)):
            return self
        if self.size == 1 and index.size > 1:
            return self
        return World(self.stated, {p: v[index] if len(v) > 1 else v for p, v in self.moved.items()})

    def fields(self, *names: str) -> Iterable[tuple[str, int, Values]]:
        """Path, number of the item and values of what was moved of some fields, in the order in which it was."""
        for path, values in self.moved.items():
            entry, item = find(self.stated, path)
            if entry.field in names:
                yield path, item, values

    def distinct(self, targets: Sequence[str] = ()) -> tuple[Index, Index]:
        """First of all truths with other light, sensor and classes, and which (U,) of these each truth has.

        ``targets`` : surfaces of targets that are told apart too, with the light on them
        """
        alone = ("tail", "fill", "fill entry", "blur", "target_gain") if targets else _OF_TARGETS
        others = set(self.stated.names["target"]) - set(targets) - set(self.stated.classes)
        columns = []
        for path, values in self.moved.items():
            entry, item = find(self.stated, path)
            of_other = entry.of == "surface" and self.stated.names["surface"][item] in others
            if len(values) > 1 and entry.field not in alone and not of_other:
                columns.append(values)
        return distinct(columns, self.size)

    def column(self, name: str) -> Array:
        """(U or 1, items) of a field, or (U or 1, B or 1) where it is one for all items."""
        out = self.stated.columns[name]
        for _, item, values in self.fields(name):
            if name in NEUTRAL:
                new = values if values.ndim > 1 else values[:, None]
                out = out * new if NEUTRAL[name] else out + new
                continue
            new = _numbers(values)
            new = np.where(np.isnan(new), out[:, item], new)
            out = np.array(np.broadcast_to(out, (max(len(out), len(new)), out.shape[1])))
            out[:, item] = new
        return out

    @cached_property
    def fraction(self) -> Array:
        """(U or 1, M) f_m; where some are moved by their share, the others give way in proportion.

        Raises
        ------
        UsageError : they do not sum to 1.
        """
        stated = self.column("fraction")
        named = np.full((self.size, stated.shape[1]), np.nan)
        for _, item, values in self.fields("share"):  # NaN: gives way
            named[:, item] = np.clip(values, 0.0, 1.0)
        moved = np.isfinite(named)
        if moved.any():
            out = np.array(np.broadcast_to(stated, named.shape))
            rest, total = np.where(moved, 0.0, out).sum(axis=1), np.nansum(named, axis=1)
            gives_way = (rest > 0.0) & (total < 1.0)
            scale = np.where(gives_way, (1.0 - total) / np.where(rest > 0.0, rest, 1.0), 1.0)
            out = np.where(moved, named, out * scale[:, None])
            if np.any(out.sum(axis=1) <= 0.0):
                raise UsageError("fraction: no class is left with an area")
            return np.asarray(np.where(moved.any(axis=1)[:, None], out / out.sum(axis=1, keepdims=True), stated))
        total = stated.sum(axis=1)
        if np.any(np.abs(total - 1.0) > 1e-6) or np.any(stated < 0.0):
            words = f"the area fractions are no partition: they sum to {total.min():.6g} to {total.max():.6g}"
            raise UsageError(words, expected="1")
        return stated

    @cached_property
    def law_fraction(self) -> Array:
        """(U or 1, J) area fractions of the laws that the classes are made of (3.33)."""
        laws = self.stated.laws
        return np.asarray(self.fraction[:, [law.owner for law in laws]] * [law.weight for law in laws])

    @cached_property
    def law_dof(self) -> Array:
        """(U or 1, J) degrees of freedom of the laws; infinity: Gaussian."""
        laws, tail = self.stated.laws, self.stated.columns["tail"]
        own = [tail[0, law.owner] if law.dof is None else law.dof for law in laws]
        out = np.array([own], dtype=float)
        for _, item, values in self.fields("tail"):
            moved = _numbers(values)[:, None]
            of_class = np.array([law.owner == item for law in laws])
            out = np.where(of_class & ~np.isnan(moved), moved, out)
        return out

    @cached_property
    def kappa(self) -> Array:
        """(U or 1, 1, 1) 1 / N_eff of (3.11); 1 as printed."""
        if self.stated.scenario.formulation == "thesis":
            return np.ones((1, 1, 1))
        return np.asarray(1.0 / self.column("neighbours")[:, :, None])

    @cached_property
    def _recorded(self) -> tuple[Array, Array]:
        """(U or 1, S, B or 1) gain and offset on the reflectance of surfaces, where it is what is recorded."""
        stated, scene = self.stated, self.stated.scenario.scene
        named = (*scene.classes, *scene.panels, *scene.sites, *scene.targets)
        free = np.array([s.spectrum.measured is None for s in named])[None, :, None]
        if stated.scenario.atmosphere is not None:
            free = np.zeros_like(free)
        gain, offset = self.column("gain")[:, None, :], self.column("offset")[:, None, :]
        return np.where(free, gain, 1.0), np.where(free, offset, 0.0)

    @cached_property
    def mean(self) -> Array:
        """(U or 1, S, B) mean reflectance of the surfaces."""
        out, before = self.stated.mean[None], self.stated.nominal.mean
        for _, item, values in self.fields("mean"):
            out = np.array(np.broadcast_to(out, (max(len(out), len(values)), *out.shape[1:])))
            out[:, item] += values.reshape(len(values), -1) - np.nan_to_num(before[item])
        gain, offset = self._recorded
        return out if np.all(gain == 1.0) and not np.any(offset) else gain * out + offset

    @cached_property
    def stretch(self) -> Array:
        """(U or 1, S, B or 1) factor on the departures of the surfaces from their means."""
        return np.asarray(self.column("spread")[:, :, None] * self._recorded[0])

    def surface(self, name: str) -> int:
        """Number of a surface."""
        return self.stated.names["surface"].index(name)

    def of_target(self, name: str, target: int) -> Array:
        """(U,) of a field of targets."""
        return np.broadcast_to(self.column(name)[:, target], (self.size,))

    # ---- fills ---------------------------------------------------------------------------------------------

    def fill_models(self, number: int) -> tuple[list[Fill], Index]:
        """The different fills of a population, and which (U,) of them each truth has."""
        stated, columns = self.stated, {}
        for path, item, values in self.fields("fill", "fill entry", "blur"):
            entry, _ = find(stated, path)
            if item == number if entry.field == "fill entry" else number in _touched(stated, path):
                columns[path] = np.broadcast_to(values, (self.size, *values.shape[1:]))
        first, which = distinct(columns.values(), self.size)
        return [self._fill(number, {p: v[u] for p, v in columns.items()}) for u in first], which

    def _fill(self, number: int, values: Truth) -> Fill:
        stated, nominal = self.stated, self.stated.nominal
        fill, change = stated.populations[number][2].fill, 0.0
        entries = {
            ".".join(path_parts(p)[6 if path_parts(p)[3] == "subjects" else 4 :]): plain(v)
            for p, v in values.items()
            if find(stated, p)[0].field == "fill entry" and v is not None
        }
        if "blur" in values:
            width = np.atleast_1d(values["blur"])
            width = width[_blurred(stated)[number]] if width.size > 1 else width
            entries["geometry.psf_fwhm_pixels"] = float(width[0]) if width.size == 1 else width.tolist()
        if entries:
            fill = with_settings(fill, entries)
        for path, value in values.items():
            if find(stated, path)[0].field == "fill":
                filled, each = _filled(stated, path), np.atleast_1d(value)
                own = fill_distribution(nominal.populations[number][2].fill).mean
                change += float(each[filled.index(number)] if each.size > 1 else each[0]) - own
        return with_mean(fill, change)

    def object_sizes(self) -> Index:
        """(U or 1, P) number of pixels of an object of each population."""
        each = []
        for number in range(len(self.stated.populations)):
            geometry = any(
                item == number and not path.endswith(("fill.fixed", "fill.mean", "fill.sd"))
                for path, item, _ in self.fields("fill entry")
            )
            if geometry:
                models, which = self.fill_models(number)
                each.append(np.array([pixels_of_object(fill) for fill in models])[which])
        return np.array(each).T if each else np.zeros((1, 1), int)

    def targets_at(self, u: int) -> list[Target]:
        """The targets of the scene with the fills of one truth."""
        out, moved = [], list(self.fields("fill", "fill entry", "blur"))
        for t, target in enumerate(self.stated.targets):
            fills = []
            for number, (owner, _, _) in enumerate(self.stated.populations):
                if moved and owner == t:
                    models, which = self.fill_models(number)
                    fills.append(models[which[u if which.size > 1 else 0]])
            if not fills:
                out.append(target)
                continue
            subjects = [s.model_copy(update={"fill": f}) for s, f in zip(target.subjects, fills, strict=False)]
            whole = target.fill if subjects else fills[0]
            out.append(target.model_copy(update={"fill": whole, "subjects": subjects}))
        return out

    def fills(self, number: int, objects: bool = False) -> Fills:
        """Fills of the pixels of a population (f of 3.10) in each truth, or of the pixels of its objects.

        Raises
        ------
        UsageError : objects of different numbers of pixels.
        """
        thesis = self.stated.scenario.formulation == "thesis"
        moved = [(p, v) for p, item, v in self.fields("fill entry") if item == number]
        others = any(number in _touched(self.stated, p) for p, *_ in self.fields("fill", "blur"))
        stated = self.stated.populations[number][2].fill
        if len(moved) == 1 and not others and moved[0][0].endswith("fill.fixed") and stated.fixed is not None:
            values = np.nan_to_num(_numbers(moved[0][1]), nan=stated.fixed)[:, None]
            if not np.all((values >= 0.0) & (values <= 1.0)):
                raise UsageError(f"fill {values.min():g} to {values.max():g}", expected="0 to 1")
            return Fills(values, np.ones((1, 1)))
        make = whole_object_fills if objects else fills_of_population
        if not moved and not others:
            return self.stated.once(("fills", number, objects), lambda: make(stated, thesis))
        models, which = self.fill_models(number)
        return stacked_fills([make(fill, thesis) for fill in models], which)

    # ---- light and sensor ----------------------------------------------------------------------------------

    def sensor_noise(self) -> tuple[list[NoiseModel], Index]:
        """The different noise models (3.13)-(3.20), none without a sensor, and which (U,) of them each truth has."""
        stated = self.stated
        if stated.noise is None or stated.scenario.atmosphere is None:
            return [], np.zeros(self.size, int)
        columns = {p: np.broadcast_to(v, (self.size,)) for p, _, v in self.fields("sensor")}
        first, which = distinct(columns.values(), self.size)
        each = [{p: plain(v[u]) for p, v in columns.items() if v[u] is not None} for u in first]
        return [_noise(stated, moved) if moved else stated.noise for moved in each], which


def _touched(stated: Stated, path: str) -> Iterable[int]:
    """Populations that a path of fills or blur moves."""
    return _blurred(stated) if path == "blur" else _filled(stated, path)


def _noise(stated: Stated, moved: Truth) -> NoiseModel:
    """The noise with other numbers of the sensor or of how it is run."""
    scenario, sensor = stated.scenario, stated.sensor
    run, changes = scenario.sensor_operation, scenario.sensor_changes
    rooms: dict[str, dict[str, Any]] = {"sensor_operation": {}, "sensor_changes": {}}
    for path, value in moved.items():
        room, _, entry = path.partition(".")
        rooms[room][entry] = value
    if rooms["sensor_operation"]:
        run = with_settings(run or SensorOperation(), rooms["sensor_operation"])
    if rooms["sensor_changes"]:
        changes = with_settings(changes or SensorChanges(), rooms["sensor_changes"])
    assert sensor is not None  # noqa: S101 - asked for where there is noise
    whole = run is None or run.spectral_binning == 1
    return noise_model(sensor, stated.axis if whole else None, run, changes, stated.kept)


def with_values(world: World, values: Mapping[str, npt.ArrayLike]) -> World:
    """The world with other values at some paths (:data:`PATHS`).

    Parameters
    ----------
    values : path -> (U,) numbers or entries, one for each truth, (U, n) where they are spectra or lists of numbers;
        None leaves an entry of the file as it is

    Raises
    ------
    UsageError : a path that leads nowhere, or numbers of truths that differ.
    """
    moved = dict(world.moved)
    for path, given in values.items():
        find(world.stated, path)
        moved.pop(path, None)  # what is moved last stands last
        value = np.asarray(given) if not isinstance(given, list) else column_of(given)
        moved[path] = value.astype(float) if value.dtype.kind in "iu" else value
    sizes = {len(v) for v in moved.values()} - {1}
    if len(sizes) > 1:
        raise UsageError(f"values of {sorted(sizes)} truths", expected="as many for each path, or one")
    return World(world.stated, moved)


def with_truths(world: World, truths: Sequence[Truth]) -> World:
    """The world of several truths, each of which moves what it names of the stated one."""
    values: dict[str, Values] = {}
    for path in dict.fromkeys(p for truth in truths for p in truth):
        entry, _ = find(world.stated, path)
        if entry.shape == "number":
            as_stated = value_at(world, path)[0] if entry.field in world.stated.columns else None
            if entry.field in ("share", "tail") and path not in world.moved:
                as_stated = np.nan  # what the others leave, or of the components of the class
            values[path] = column_of([_one(truth[path]) if path in truth else as_stated for truth in truths])
            continue
        here = value_at(world, path)[0]
        each = [np.asarray(truth.get(path, here), dtype=float) for truth in truths]
        shape = np.broadcast_shapes(*(v.shape for v in each))
        values[path] = np.array([np.broadcast_to(v, shape) for v in each])
    moved = with_values(world, values)
    return moved if values or len(truths) == 1 else World(world.stated, {"line.offset": np.zeros(len(truths))})


def _one(value: Any) -> Any:
    """A number or an entry, from what may be an array of one number."""
    return value.reshape(-1)[0].item() if isinstance(value, np.ndarray) and value.size == 1 else value


_AGAIN = 16  # of the latest scenarios that were read again
MOST_RUNS = 400  # of the engine, at about seven seconds each where nothing is cached


def reads_again(stated: Stated, path: str, values: Values | None = None) -> bool:
    """Whether the scenario is read again for each different value of a path."""
    field_ = find(stated, path)[0].field
    if not field_:
        return True
    if values is None or values.dtype != object or field_ not in stated.columns:
        return False
    return any(v is not None and not isinstance(v, int | float) for v in values)


def settled(world: World) -> list[tuple[Index, World]]:
    """Truths that share what is read, and the number of pixels of objects: what is read again is so for each value."""
    stated = world.stated
    again = {
        p: np.broadcast_to(v, (world.size, *v.shape[1:])) for p, v in world.moved.items() if reads_again(stated, p, v)
    }
    sizes = world.object_sizes()
    if not again and len(sizes) == 1:
        return [(np.arange(world.size), world)]
    first, which = distinct([*again.values(), *(sizes.T if len(sizes) > 1 else ())], world.size)
    out = []
    for i, u in enumerate(first):
        index = np.flatnonzero(which == i)
        rest = {p: v[index] if len(v) > 1 else v for p, v in world.moved.items() if p not in again}
        if not any(len(v) == index.size for v in rest.values()):  # the same truth so many times
            rest["line.offset"] = np.zeros(index.size) + rest.get("line.offset", 0.0)
        out.append((index, World(_read_with(stated, {p: v[u] for p, v in again.items()}), rest)))
    return out


def _read_with(stated: Stated, values: Truth) -> Stated:
    """What a scenario says where some paths of it stand at other values."""
    if not values:
        return stated
    kept: OrderedDict[str, Stated] = stated.kept.setdefault("again", OrderedDict())
    key = repr([(p, v.tobytes() if isinstance(v, np.ndarray) else v) for p, v in values.items() if v is not None])
    if key not in kept:
        settings = {p: plain(v) for p, v in values.items() if v is not None and p != SHIFT}
        scenario = with_settings(stated.scenario, settings) if settings else stated.scenario
        there = read(scenario, stated.origins, values.get(SHIFT, 0.0), stated.atmosphere.nodes).stated
        kept[key] = replace(there, before=stated.nominal)
        if len(kept) > _AGAIN:
            kept.popitem(last=False)
    return kept[key]


def read(
    scenario: Scenario, origins: Origins | None = None, shift_nm: float | Array = 0.0,
    nodes: Mapping[str, Sequence[float]] | None = None,
) -> World:  # fmt: skip
    """The world that a scenario states (U = 1), all its files read (3.7-3.20).

    Parameters
    ----------
    shift_nm : added to the true band centres; the labels stay
    nodes : of the atmosphere, between which its terms are interpolated

    Raises
    ------
    UsageError, InputError : a scenario that contradicts itself, a file that is missing or corrupt.
    """
    source = origins or Origins()
    find_file, measured = source.find(scenario), source.measured or {}
    measured_axis = next((s.axis for s in measured.values()), None)
    sensor, axis, true, noise = instrument(scenario, source.axis, measured_axis, find_file, source.sensor)
    if np.any(shift_nm):
        true = SpectralAxis(true.centre_nm + shift_nm, true.fwhm_nm, true.good)
    scenario = with_sensor_blur(scenario, sensor)
    sources = Sources(true, measured, find_file, axis, source.read)
    surfaces, signatures = surfaces_of(scenario, sources, replace(sources, axis=axis, nominal=None))
    around, surroundings = scenario.scene.adjacency.spectrum, None
    if around is not None:
        surroundings = without_gaps(sources.spectrum(around, "surroundings").mean)
    return World(
        Stated(
            scenario, source, sensor, axis, true, noise, surfaces, signatures, surroundings,
            Atmosphere(scenario, source, true, nodes or {}),
        )
    )  # fmt: skip


def under(world: World, engine: Engine) -> World:
    """The world under another engine of the atmosphere."""
    stated = world.stated
    origins = replace(stated.origins, engine=engine)
    return World(
        replace(stated, origins=origins, atmosphere=replace(stated.atmosphere, origins=origins, runs={}), kept={}),
        world.moved,
    )
