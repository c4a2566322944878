"""How the truth departs from what a scenario says: one object for errors drawn, steps taken and what-ifs.

The scenario is what is believed: filters look for the spectra it names, products are labelled by its bands.
A departure changes what is there to be seen; ``predict(scenario, departure=...)`` gives the products of that truth.
It is the model's own record of what the values of inputs become: nobody outside this room writes one by hand, but
takes it from a path and a value (:func:`hyperval.prediction.departure.input_path`) or from an ``Input``.

Fills of target populations from what a scenario says of them (f of 3.10).

What stands at a dotted path of an input, and the truth in which something else stands there.

    atmosphere.FIELD             a number of the state of the atmosphere, sun and view
    light.irradiance             factor on all light [1]; likewise path, ground (the light reflected by the ground),
                                 spherical_albedo and surroundings (their reflectance)
    sensor.gain                  factor on the recorded radiance [1]; likewise noise and electrons
    sensor.offset                added to the recorded radiance [uW cm-2 sr-1 nm-1]
    sensor.wavelength_shift_nm   added to the true band centres [nm]
    line.gain, line.offset       the empirical line gives gain rho + offset for a reflectance rho, for the detectors
    line.dark, line.bright       factor on the true reflectance of a panel of the line, which takes it for what is
                                 stated [1]
    surfaces.NAME.mean           mean reflectance [1]; surfaces.NAME.spread: factor on its standard deviation [1]
    surfaces.NAME.tail_dof       degrees of freedom of the tails of a class
    surfaces.NAME.fine_texture   part of a target's covariance that goes by its fill, not the fill's square [1]
    fill, fill.NAME              mean fills of all targets, or of one or its subject [1]
    fraction.NAME                area fraction of a class; the others give way in proportion [1]
    blur                         widths of the blur wherever a fill follows from geometry [pixels]

These are :data:`PATHS`; any other path is that of an entry of the scenario's file.  Those that a batch has numbers
for are columns of it: :func:`batch_column`.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState
from hyperval.atmosphere.state import LONGEST_KM, MAX_SOLAR_ZENITH_DEG, SHORTEST_KM
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.inputs import SurfaceStatistics, class_tail
from hyperval.scenario import ElmPanels, Fill, Geometry, Scenario, TargetSubject
from hyperval.scene.fill import (
    FillDistribution,
    TargetGeometry,
    beta_fill,
    fixed_fill,
    object_fills,
    ranked_pixel_fill,
    touched_counts,
    touched_pixel_fill,
)
from hyperval.sensor.noise import NoiseModel, recorded_noise
from hyperval.sensor.specification import Sensor
from hyperval.settings import item_number, numbers_of, path_parts, setting, with_settings
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


def fill_distribution(fill: Fill) -> FillDistribution:
    """Fill fractions of the pixels of one population (f of 3.10)."""
    if fill.fixed is not None:
        return fixed_fill(fill.fixed)
    if fill.geometry is not None:
        return _of_geometry(geometry_of(fill), 0 if fill.geometry.pixels == "touched" else fill.geometry.n or 1)
    if fill.listed is not None:
        values = np.concatenate([np.asarray(row, float) for row in fill.listed])
        return FillDistribution(values, np.full(values.size, 1.0 / values.size)).binned()
    if fill.truth is not None:
        raise UsageError(
            "the fills are those of a collection's truth",
            expected="a campaign whose targets come from a finer image or from abundances",
            mend="run it within that campaign, or state fill.mean and fill.sd",
        )
    return beta_fill(fill.mean or 0.0, fill.sd or 0.0)


@lru_cache(maxsize=256)
def _of_geometry(geometry: TargetGeometry, n: int) -> FillDistribution:
    """For one geometry, however often it is asked for; not to be written to.  ``n`` = 0: all pixels it touches."""
    fill = (ranked_pixel_fill(geometry, n) if n else touched_pixel_fill(geometry)).binned()
    for part in (fill.values, fill.weights):
        part.setflags(write=False)
    return fill


def fills_of_objects(fill: Fill, wider: float = 0.0) -> Array:
    """(K, n) fills of the pixels of one object (f of 3.10); one pixel unless the geometry says more.

    ``wider`` : added to the width of the blur [pixels]
    """
    if fill.geometry is not None:
        return object_fills(geometry_of(fill, wider), pixels_of_object(fill))
    if fill.listed is not None:
        size = pixels_of_object(fill)
        rows = [sorted(row, reverse=True) + [0.0] * (size - len(row)) for row in fill.listed]
        return np.array(rows)
    return fill_distribution(fill).values[:, None]


def pixels_of_object(fill: Fill) -> int:
    """Pixels of one object: its fullest, as many as it may touch where those that it touches count."""
    if fill.listed is not None:
        return max(len(row) for row in fill.listed)
    if fill.geometry is None:
        return 1
    return int(touched_counts(geometry_of(fill)).max()) if fill.geometry.pixels == "touched" else fill.geometry.n or 1


def geometry_of(fill: Fill, wider: float = 0.0) -> TargetGeometry:
    """The geometry of a fill that has one, its blur ``wider`` by so much, but not below 0 [pixels]."""
    g = fill.geometry
    assert g is not None  # noqa: S101 - all callers have asked
    blur = g.psf_fwhm_pixels or 0.0
    if wider:
        along, across = blur if isinstance(blur, tuple) else (blur, blur)
        blur = max(along + wider, 0.0), max(across + wider, 0.0)
    return TargetGeometry(
        g.side_m or g.length_m or 0.0,
        g.side_m or g.width_m or 0.0,
        g.gsd_m,
        None if g.heading_deg == "random" else float(g.heading_deg),
        blur,
        g.phase,
    )


def moments(population: TargetSubject, thesis: bool) -> FillDistribution:
    """The fill of a population; the printed form knows its mean alone."""
    fill = fill_distribution(population.fill)
    return fixed_fill(fill.mean) if thesis else fill


@dataclass(frozen=True)
class Fills:
    """Fills of the pixels of one population in n evaluations, or in all of them.

    Attributes
    ----------
    values, weights : (n or 1, K) fills and their probabilities
    shape : (places, pixels) of objects, whose pixels lie along K without weights; None where a pixel is an object
    """

    values: Array
    weights: Array
    shape: tuple[int, int] | None = None


def pixel_fills(population: TargetSubject, thesis: bool) -> Fills:
    """Fills of the pixels of a population."""
    fill = moments(population, thesis)
    return Fills(fill.values[None], fill.weights[None])


def object_fills_of(population: TargetSubject, thesis: bool) -> Fills:
    """Fills of the pixels of its objects, one after the other; those of its pixels where an object is one pixel."""
    alone = pixel_fills(population, thesis)
    places = np.array([[float(alone.weights[0] @ alone.values[0])]]) if thesis else fills_of_objects(population.fill)
    if places.shape[1] == 1 and alone.values.size >= places.shape[0]:
        return alone
    return Fills(places.reshape(1, -1), np.zeros((1, places.size)), (places.shape[0], places.shape[1]))


def stacked_fills(each: Sequence[Fills], which: npt.NDArray[np.intp]) -> Fills:
    """The fills of several evaluations, of which (n,) ``which`` names those of each.

    Raises
    ------
    UsageError : objects of different numbers of pixels.
    """
    if len(each) == 1:
        return each[0]
    if any(e.shape != each[0].shape for e in each):
        raise UsageError("the number of pixels of an object moves", mend="study one number at a time")
    width = max(e.values.size for e in each)
    values, weights = (
        np.array([np.pad(getattr(e, n)[0], (0, width - e.values.size)) for e in each]) for n in ("values", "weights")
    )
    return Fills(values[which], weights[which], each[0].shape)


Number = float | Array

_FACTORS = (
    "ground", "path", "irradiance", "spherical_albedo", "surroundings", "recorded_gain", "noise_factor",
    "signal_factor", "retrieval_gain", "dark_panel", "bright_panel",
)  # fmt: skip
_SUMS = ("recorded_offset", "retrieval_offset", "wavelength_shift_nm", "solar_zenith_deg", "solar_azimuth_deg")
_OF_RADIANCE = (
    "ground", "path", "irradiance", "spherical_albedo", "surroundings", "noise_factor", "signal_factor"
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class StatisticsDeparture:
    """How the statistics of one surface depart.

    Attributes
    ----------
    mean : scalar or (B,) added to the mean reflectance [1]
    factor : on the covariance [1]
    covariance : (B, B) that stands in for it, before the factor; None: its own
    tail_dof : degrees of freedom that stand in for its own; None: its own
    fine_texture : added to the part of a target's covariance that goes by f in place of f^2 (3.12) [1]
    """

    mean: Number = 0.0
    factor: float = 1.0
    covariance: Array | None = None
    tail_dof: float | None = None
    fine_texture: float = 0.0


@dataclass(frozen=True, eq=False)
class Departure:
    """A truth that differs from the scenario; what is left at its default does not differ.

    A number may be a scalar or (B,) on the bands of the products.

    Attributes
    ----------
    settings : dotted path -> value, applied first (:func:`hyperval.settings.with_settings`)
    spectra : surface -> added to its mean reflectance [1]; what the detectors look for stays
    statistics : surface -> change of its statistics; what the detectors look for stays
    fill : target or subject -> added to the mean fill of its pixels [1]
    fractions : class -> added to its area fraction [1]; classes that are not named give way in proportion
    solar_zenith_deg, solar_azimuth_deg : added to the angles of the sun [deg]
    ground, path, irradiance : factors on the radiance that was reflected by the ground, on the path
        radiance, and on both [1]
    spherical_albedo : factor on the spherical albedo of the atmosphere [1]
    surroundings : factor on the reflectance of the surroundings [1]
    recorded_gain, recorded_offset : the recorded radiance is gain L + offset [1], [uW cm-2 sr-1 nm-1]; noise
        goes along.  Where the scenario has no atmosphere it is the reflectance of all surfaces that were not
        measured on the imagery
    dark_panel, bright_panel : factors on the true reflectance of the panels of the empirical line, which takes them
        for what the scenario states [1]; seen by the detectors alone, as what the line says of collected
        reflectance is the collection's
    retrieval_gain, retrieval_offset : likewise, the line gives gain rho + offset where it would give rho
    wavelength_shift_nm : added to the true band centres [nm]; the labels stay
    noise_factor : on the noise standard deviation [1]
    signal_factor : on the electrons per radiance [1]
    """

    settings: Mapping[str, Any] = field(default_factory=dict)
    spectra: Mapping[str, Number] = field(default_factory=dict)
    statistics: Mapping[str, StatisticsDeparture] = field(default_factory=dict)
    fill: Mapping[str, float] = field(default_factory=dict)
    fractions: Mapping[str, float] = field(default_factory=dict)
    ground: Number = 1.0
    path: Number = 1.0
    irradiance: Number = 1.0
    spherical_albedo: Number = 1.0
    surroundings: Number = 1.0
    recorded_gain: Number = 1.0
    recorded_offset: Number = 0.0
    wavelength_shift_nm: Number = 0.0
    noise_factor: Number = 1.0
    signal_factor: Number = 1.0
    dark_panel: Number = 1.0
    bright_panel: Number = 1.0
    retrieval_gain: Number = 1.0
    retrieval_offset: Number = 0.0
    solar_zenith_deg: float = 0.0
    solar_azimuth_deg: float = 0.0


def combined(*departures: Departure) -> Departure:
    """All departures at once: factors multiply, what is added adds up.

    Raises
    ------
    UsageError : two of them give different values to one setting, or two covariances to one surface.
    """
    settings: dict[str, Any] = {}
    statistics: dict[str, StatisticsDeparture] = {}
    spectra: dict[str, Number] = {}
    fill: dict[str, float] = {}
    fractions: dict[str, float] = {}
    numbers: dict[str, Number] = {**dict.fromkeys(_FACTORS, 1.0), **dict.fromkeys(_SUMS, 0.0)}
    for d in departures:
        for path, value in d.settings.items():
            if path in settings and settings[path] != value:
                raise UsageError(f"two departures give different values to {path}")
            settings[path] = value
        for name, added in d.spectra.items():
            spectra[name] = spectra[name] + added if name in spectra else added
        for name, offset in d.fill.items():
            fill[name] = fill.get(name, 0.0) + offset
        for name, offset in d.fractions.items():
            fractions[name] = fractions.get(name, 0.0) + offset
        for name, change in d.statistics.items():
            statistics[name] = _both(name, statistics[name], change) if name in statistics else change
        for name in _FACTORS:
            numbers[name] = numbers[name] * getattr(d, name)
        for name in _SUMS:
            numbers[name] = numbers[name] + getattr(d, name)
    return Departure(settings, spectra, statistics, fill, fractions, **numbers)  # type: ignore[arg-type]


def moved_on(truth: Departure, move: Departure) -> Departure:
    """The truth moved further; settings of the move, which start from those of the truth, stand in their place."""
    kept = {path: value for path, value in truth.settings.items() if path not in move.settings}
    return combined(replace(truth, settings=kept), move)


def _both(name: str, a: StatisticsDeparture, b: StatisticsDeparture) -> StatisticsDeparture:
    for what in ("covariance", "tail_dof"):
        if getattr(a, what) is not None and getattr(b, what) is not None:
            raise UsageError(f"two departures give a {what} to {name!r}")
    covariance = a.covariance if b.covariance is None else b.covariance
    tail = a.tail_dof if b.tail_dof is None else b.tail_dof
    fine = a.fine_texture + b.fine_texture
    return StatisticsDeparture(a.mean + b.mean, a.factor * b.factor, covariance, tail, fine)


def true_scenario(scenario: Scenario, departure: Departure) -> Scenario:
    """The scenario with the settings and fills of the truth.

    Raises
    ------
    UsageError : paths or names that lead nowhere, values out of range.
    """
    if departure.settings:
        scenario = with_settings(scenario, departure.settings)
    if scenario.atmosphere is None:
        for name in _OF_RADIANCE:
            if np.any(np.asarray(getattr(departure, name)) != 1.0):
                raise UsageError(f"departure in {name.replace('_', ' ')}: the scenario has no atmosphere")
    if departure.fill:
        scenario = _with_fills(scenario, departure.fill)
    changes = _sun_settings(scenario, departure) | _fraction_settings(scenario, departure.fractions)
    return with_settings(scenario, changes) if changes else scenario


def _sun_settings(scenario: Scenario, departure: Departure) -> dict[str, Any]:
    """Settings of a sun at other angles; one that follows from place and time is stated by its angles then."""
    state = scenario.atmosphere
    if not (departure.solar_zenith_deg or departure.solar_azimuth_deg):
        return {}
    if state is None:
        raise UsageError("departure in solar angles: the scenario has no atmosphere")
    zenith, azimuth = state.sun[0] + departure.solar_zenith_deg, state.sun[1] + departure.solar_azimuth_deg
    if zenith < 0.0:  # over the zenith and down on the other side
        zenith, azimuth = -zenith, azimuth + 180.0
    changes: dict[str, Any] = {
        "atmosphere.solar_zenith_deg": min(zenith, MAX_SOLAR_ZENITH_DEG - 0.1),
        "atmosphere.solar_azimuth_deg": azimuth % 360.0,
    }
    if state.time_utc is not None:
        changes["atmosphere.earth_sun_distance_au"] = state.distance_au
        changes |= {f"atmosphere.{k}": None for k in ("latitude_deg", "longitude_deg", "time_utc")}
    return changes


def _fraction_settings(scenario: Scenario, offsets: Mapping[str, float]) -> dict[str, Any]:
    """Settings of area fractions, which sum to 1 again."""
    if not offsets:
        return {}
    stated = {c.name: c.fraction for c in scenario.scene.classes}
    for name in offsets:
        if name not in stated:
            raise UsageError(f"departure in fractions: no class {name!r}", expected=", ".join(stated))
    new = {n: float(np.clip(f + offsets.get(n, 0.0), 0.0, 1.0)) for n, f in stated.items()}
    named, rest = sum(new[n] for n in offsets), sum(f for n, f in stated.items() if n not in offsets)
    if rest > 0.0 and named < 1.0:
        new = {n: f if n in offsets else f * (1.0 - named) / rest for n, f in new.items()}
    total = sum(new.values())
    if total <= 0.0:
        raise UsageError("departure in fractions: no class is left with an area")
    return {f"scene.classes.[{n}].fraction": f / total for n, f in new.items()}


def _with_fills(scenario: Scenario, offsets: Mapping[str, float]) -> Scenario:
    left = set(offsets)
    targets = []
    for t in scenario.scene.targets:
        own = offsets.get(t.name, 0.0)
        left.discard(t.name)
        subjects = []
        for s in t.subjects:
            change = own + (offsets.get(s.name, 0.0) if s.name != t.name else 0.0)
            left.discard(s.name)
            subjects.append(s.model_copy(update={"fill": true_fill(s.fill, change)}))
        fill = true_fill(t.fill, own) if t.fill is not None else None
        targets.append(t.model_copy(update={"fill": fill, "subjects": subjects}))
    if left:
        known = [t.name for t in scenario.scene.targets]
        known += [s.name for t in scenario.scene.targets for s in t.subjects]
        raise UsageError(f"no target {min(left)!r} to change the fill of", expected="one of " + ", ".join(known))
    scene = scenario.scene.model_copy(update={"targets": targets})
    return scenario.model_copy(update={"scene": scene})


def true_fill(fill: Fill, offset: float) -> Fill:
    """The fill with another mean, at most 1 and at least 0.

    Where the geometry gives the fill, the sides of the target are scaled by the root of new over old mean: its
    area changes, its place among the pixels does not.
    """
    if offset == 0.0:
        return fill
    if fill.fixed is not None:
        return fill.model_copy(update={"fixed": float(np.clip(fill.fixed + offset, 0.0, 1.0))})
    if fill.listed is not None:
        mean = fill_distribution(fill).mean
        factor = max(mean + offset, 1e-6) / max(mean, 1e-6)
        return fill.model_copy(update={"listed": [[min(factor * f, 1.0) for f in row] for row in fill.listed]})
    if fill.geometry is None:
        mean = float(np.clip((fill.mean or 0.0) + offset, 1e-6, 1.0 - 1e-6))
        # A beta distribution of this mean has a variance below mean (1 - mean).
        sd = min(fill.sd or 0.0, 0.99 * float(np.sqrt(mean * (1.0 - mean))))
        return fill.model_copy(update={"mean": mean, "sd": sd})
    mean = fill_distribution(fill).mean
    scale = float(np.sqrt(max(mean + offset, 1e-4) / mean))
    g = fill.geometry
    sides = {n: scale * v for n in ("side_m", "length_m", "width_m") if (v := getattr(g, n)) is not None}
    return fill.model_copy(update={"geometry": Geometry.model_validate(g.model_dump() | sides)})


def true_axis(axis: SpectralAxis, departure: Departure) -> SpectralAxis:
    """Where the bands truly stand; the same object where nothing is shifted."""
    shift = np.asarray(departure.wavelength_shift_nm, dtype=float)
    if not np.any(shift):
        return axis
    return SpectralAxis(axis.centre_nm + shift, axis.fwhm_nm, axis.good)


def true_surfaces(
    scenario: Scenario, surfaces: Mapping[str, SurfaceStatistics], departure: Departure
) -> dict[str, SurfaceStatistics]:
    """The surfaces as they truly are.

    Raises
    ------
    UsageError : a name that the scene does not have.
    """
    out = dict(surfaces)
    for name in (*departure.spectra, *departure.statistics):
        if name not in out:
            raise UsageError(f"departure of {name!r}: no such surface", expected="one of " + ", ".join(out))
    for name, added in departure.spectra.items():
        out[name] = replace(out[name], mean=out[name].mean + added)
    for name, change in departure.statistics.items():
        s = out[name]
        covariance = s.covariance if change.covariance is None else change.covariance
        components = s.components
        if change.factor != 1.0:
            covariance = change.factor * covariance
            components = components and components.stretched(float(np.sqrt(change.factor)))
        tail = s.tail_dof if change.tail_dof is None else change.tail_dof
        mean, fine = s.mean + change.mean, s.fine_texture + change.fine_texture
        out[name] = replace(
            s, mean=mean, covariance=covariance, tail_dof=tail, components=components, fine_texture=fine
        )
    gain, offset = np.asarray(departure.recorded_gain), np.asarray(departure.recorded_offset)
    if scenario.atmosphere is None and (np.any(gain != 1.0) or np.any(offset != 0.0)):
        scene = scenario.scene
        named = (*scene.classes, *scene.panels, *scene.sites, *scene.targets)
        measured = {x.name for x in named if x.spectrum.measured is not None}
        for name, s in out.items():
            if name not in measured:
                g = np.broadcast_to(gain, s.mean.shape)
                covariance, components = s.covariance * np.outer(g, g), s.components and s.components.stretched(g)
                out[name] = replace(s, mean=g * s.mean + offset, covariance=covariance, components=components)
    return out


def true_terms(terms: AtmosphericTerms, departure: Departure) -> AtmosphericTerms:
    """Terms of (3.7) on the bands, such that they give the recorded radiance.

    L' = g [p e L_a + q e (A rho + B rho_ave) / (1 - S rho_ave)] + o with the factors p of the path, q of the
    ground, e of the irradiance and the recorded gain g and offset o: all of them go into L_a, A and B.
    """
    e, g = departure.irradiance, departure.recorded_gain
    seen = np.asarray(g) * e * departure.ground
    return replace(
        terms,
        path_radiance=np.asarray(g * (e * departure.path * terms.path_radiance) + departure.recorded_offset),
        direct=np.asarray(seen * terms.direct),
        adjacency=np.asarray(seen * terms.adjacency),
        spherical_albedo=np.asarray(departure.spherical_albedo * terms.spherical_albedo),
        ground_irradiance=np.asarray(e * terms.ground_irradiance),
        diffuser_radiance=None if terms.diffuser_radiance is None else np.asarray(e * terms.diffuser_radiance),
    )


def true_noise(noise: NoiseModel | None, departure: Departure) -> NoiseModel | None:
    """The noise of the recorded radiance (3.13)-(3.19)."""
    if noise is None:
        return None
    return recorded_noise(
        noise,
        gain=departure.recorded_gain,
        offset=departure.recorded_offset,
        factor=departure.noise_factor,
        signal_factor=departure.signal_factor,
    )


def keeps_surfaces(departure: Departure) -> bool:
    """True where light and sensor alone depart: surfaces, fills, fractions and bands are as stated."""
    d = departure
    if d.spectra or d.statistics or d.fill or d.fractions or np.any(np.asarray(d.wavelength_shift_nm) != 0.0):
        return False
    return all(path.startswith("atmosphere.") for path in d.settings)


def departs(departure: Departure) -> bool:
    """True where anything differs from the scenario."""
    plain = Departure()
    for f in fields(Departure):
        a, b = getattr(departure, f.name), getattr(plain, f.name)
        if isinstance(b, Mapping):
            if a:
                return True
        elif np.any(np.asarray(a) != b):
            return True
    return False


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
    try:
        return _input_path(given, path)
    except UsageError as error:
        near = difflib.get_close_matches(path, every_path(given), n=1)
        if error.mend or not near:
            raise
        mend = f"did you mean {near[0]}?"
        raise UsageError(error.what, where=error.where, expected=error.expected, mend=mend) from error


def _input_path(given: Given, path: str) -> InputPath:
    scenario, parts = given.scenario, path_parts(path)
    if scenario.atmosphere is None and (parts[0] == "light" or path in _OF_LIGHT):
        raise UsageError(f"{path}: the scenario has no atmosphere")
    for pattern, to in PATHS.items():
        names = _stars(pattern, parts)
        if names is not None and (parts[0] != "atmosphere" or scenario.atmosphere is not None):
            return to(given, *names)
    return InputPath(setting(scenario, path), lambda v: Departure(settings={path: np.asarray(v).ravel()[0].item()}))


def _stars(pattern: str, parts: Sequence[str]) -> list[str] | None:
    """What stands for the stars of a pattern of :data:`PATHS`; None where a path is not of it."""
    of = pattern.split(".")
    if len(of) != len(parts) or any(a not in ("*", b) for a, b in zip(of, parts, strict=True)):
        return None
    return [b for a, b in zip(of, parts, strict=True) if a == "*"]


def every_path(given: Given) -> list[str]:
    """Every path of a scenario that leads to a number, or to numbers over wavelength: what can be moved."""
    targets = given.scenario.scene.targets
    names = {
        "surfaces": list(given.surfaces),
        "fill": list(dict.fromkeys(n for t in targets for n in (t.name, *(p.name for p in t.populations)))),
        "fraction": [c.name for c in given.scenario.scene.classes],
    }
    out = []
    for pattern in PATHS:
        room = pattern.partition(".")[0]
        for name in names[room] if "*" in pattern else [""]:
            path = pattern.replace("*", f"[{name}]")
            try:
                _input_path(given, path)
            except UsageError:  # not in this scenario
                continue
            out.append(path)
    return list(dict.fromkeys([*out, *numbers_of(given.scenario)]))


PFA = "pfa"  # of studies alone: the false-alarm probability at which P_D is read
_OPERATION = ("frames_averaged", "averaged", "spatial_binning")
ColumnKind = Literal[
    "atmosphere", "changes", "operation", "fraction", "gain", "tail", "kappa", "target_gain", "beam", "sky", "fill",
    "pfa", "anew",
]  # fmt: skip
_OF_A_CLASS: dict[str, ColumnKind] = {"fraction": "fraction", "gain": "gain", "tail_dof": "tail"}
_OF_A_TARGET: dict[str, ColumnKind] = {
    "gain": "target_gain", "illumination.beam": "beam", "illumination.sky_view": "sky"
}  # fmt: skip


@dataclass(frozen=True)
class BatchColumn:
    """Where an entry of a scenario stands in a batch of the model, which may have other numbers in each evaluation.

    Attributes
    ----------
    kind : what it is; anew, for entries after whose change everything is read anew
    item : number of the class or target that it belongs to
    subject : number of the target's population
    key : the entry, for atmosphere, changes, operation and fill
    """

    kind: ColumnKind
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
        case ["scene", "classes", name, key] if key in _OF_A_CLASS:
            item = item_number([c.name for c in scene.classes], name, path)
            if key == "tail_dof" and scene.classes[item].has_mixture:
                return BatchColumn("anew", key=path)  # of its components
            return BatchColumn(_OF_A_CLASS[key], item)
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


def _state(name: str, given: Given) -> InputPath:
    state = given.scenario.atmosphere
    assert state is not None  # noqa: S101 - asked for where there is light
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


def _factor(name: str, least: float, given: Given) -> InputPath:
    return InputPath(1.0, lambda v: Departure(**{name: _plain(np.maximum(v, least))}))


def _added(name: str, given: Given) -> InputPath:
    return InputPath(0.0, lambda v: Departure(**{name: _plain(v)}))


def _panel(panel: str, given: Given) -> InputPath:
    if not isinstance(given.scenario.processing.elm, ElmPanels):
        raise UsageError("uncertainty: elm_panels needs an empirical line of two panels")
    return _factor(f"{panel}_panel", 0.0, given)


def _surface(key: str, given: Given, name: str) -> InputPath:
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


def _fill(given: Given, name: str | None = None) -> InputPath:
    fills = {
        p.name: fill_distribution(p.fill).mean
        for t in given.scenario.scene.targets
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


def _fraction(given: Given, name: str) -> InputPath:
    stated = {c.name: c.fraction for c in given.scenario.scene.classes}
    if name not in stated:
        raise UsageError(f"fraction.{name}: no such class", expected="one of " + ", ".join(stated))
    own = stated[name]
    if len(stated) < 2 or own >= 1.0:
        raise UsageError(f"uncertainty: fractions: {name!r} is the only class with an area")
    return InputPath(own, lambda v: Departure(fractions={name: _number(v) - own}))


def _blur(given: Given) -> InputPath:
    """One blur for all targets whose fill follows from geometry."""
    places = []
    for t in given.scenario.scene.targets:
        fills = [
            (f"scene.targets.[{t.name}].subjects.{i}.fill", population.fill) for i, population in enumerate(t.subjects)
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


# Pattern -> what gives its :class:`InputPath` for a scenario and the names that stand for its stars.
PATHS: Mapping[str, Callable[..., InputPath]] = {
    **{f"atmosphere.{key}": partial(_state, key) for key in STATE_RANGES},
    "light.irradiance": partial(_factor, "irradiance", 0.01),
    "light.path": partial(_factor, "path", 0.0),
    "light.ground": partial(_factor, "ground", 0.0),
    "light.spherical_albedo": partial(_factor, "spherical_albedo", 0.0),
    "light.surroundings": partial(_factor, "surroundings", 0.01),
    "sensor.gain": partial(_factor, "recorded_gain", -np.inf),
    "sensor.offset": partial(_added, "recorded_offset"),
    "sensor.noise": partial(_factor, "noise_factor", 1e-3),
    "sensor.electrons": partial(_factor, "signal_factor", 1e-3),
    "sensor.wavelength_shift_nm": partial(_added, "wavelength_shift_nm"),
    "line.dark": partial(_panel, "dark"),
    "line.bright": partial(_panel, "bright"),
    "line.gain": partial(_factor, "retrieval_gain", -np.inf),
    "line.offset": partial(_added, "retrieval_offset"),
    **{f"surfaces.*.{key}": partial(_surface, key) for key in ("mean", "spread", "tail_dof", "fine_texture")},
    "fill": _fill,
    "fill.*": _fill,
    "fraction.*": _fraction,
    "blur": _blur,
}
