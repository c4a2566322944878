"""How the truth departs from what a scenario says: one object for errors drawn, steps taken and what-ifs.

The scenario is what is believed: filters look for the spectra it names, products are labelled by its bands.
A departure changes what is there to be seen; ``predict(scenario, departure=...)`` gives the products of that truth.
It is the model's own record of what the values of inputs become: nobody outside this room writes one by hand, but
takes it from a path and a value (:func:`hyperval.prediction.input_paths.input_path`) or from an ``Input``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.state import MAX_SOLAR_ZENITH_DEG
from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.fills import fill_distribution
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.scenario import Fill, Geometry, Scenario
from hyperval.sensor.noise import NoiseModel, recorded_noise
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Number = float | Array

_FACTORS = (
    "ground", "path", "irradiance", "spherical_albedo", "surroundings", "recorded_gain", "noise_factor",
    "signal_factor", "retrieval_gain",
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
    retrieval_gain, retrieval_offset : the empirical line gives gain rho + offset for a reflectance rho, its panels
        being off; seen by the detectors alone, as what the line says of collected reflectance is the collection's
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
