"""Simulated collections of one small scene whose inputs depart from what is stated by draws from the budget.

The truths are drawn here, with formulas of this file, and pixels are made by the simulator's detector: nothing of
the prediction's propagation is used to make what it is judged by.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "shared"))
from stand_in_atmosphere import blue_and_haze, line, smooth_terms, sunlight

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.config import parse_yaml, validate
from hyperval.scenario import Scenario
from hyperval.sensor import load_sensor
from hyperval.simulate import Detector, correlated_field
from hyperval.spectra import SpectralAxis, in_window
from hyperval.statistics_library import builtin_class

Array = npt.NDArray[np.float64]

FILL, TARGETS, BACKGROUND = 0.03, 150, 12_000
CLASSES = {"grass": 0.6, "asphalt": 0.4}
SITE, PANEL_SIDE = 28, 16  # [pixels]
TEXTURE_PIXELS = 3.0  # correlation length of the site's texture
LOW, HIGH = 0.1, 0.6  # reflectances of the panels of the empirical line

SCENARIO = """
schema: 1
name: coverage
atmosphere: {aot550: 0.2, water_vapour_g_cm2: 2.0, ozone_atm_cm: 0.3, sensor_altitude_km: 1, solar_zenith_deg: 30,
             solar_azimuth_deg: 0, day_of_year: 200}
sensor: prospectir-vs
scene:
  classes:
    - {name: grass, fraction: 0.6, spectrum: {builtin: grass}}
    - {name: asphalt, fraction: 0.4, spectrum: {builtin: asphalt}}
  panels: [{name: bright, spectrum: {constant: 0.6}}]
  sites: [{name: field, spectrum: {builtin: soil}}]
  targets:
    - {name: plank, spectrum: {builtin: yellow-paint-plank}, host: asphalt, fill: {fixed: FILL}}
  adjacency: {effective_neighbours: null}
processing: {elm: {reflectances: [0.1, 0.6]}, detectors: [cem], bands: {drop_bad: false}}
uncertainty:
  aot550: 0.01
  water_vapour_g_cm2: 0.23094  # uniform within 0.4
  solar_irradiance_relative: 0.01
  engine: {relative: 0.02}
  sensor_gain: {relative: 0.005, correlation: random}
  noise: {relative: 0.05}
  electrons: {relative: 0.05}
  elm_panels: {relative: 0.01, correlation_nm: 500}
  fills: [{subject: plank, absolute: 0.003}]
  field_spectra:
    - {subject: bright, relative: 0.005, correlation: random}
    - {subject: field, relative: 0.04, correlation_nm: 200}
    - {subject: plank, relative: 0.04, correlation_nm: 300}
    - {subject: asphalt, relative: 0.04, correlation_nm: 300}
    - {subject: grass, relative: 0.04, correlation_nm: 300}
"""


def scenario(method: str = "linear", samples: int = 400) -> Scenario:
    """What is stated."""
    text = SCENARIO.replace("FILL", str(FILL)) + f"  method: {method}\n  samples: {samples}\n"
    data, lines = parse_yaml(text)
    return validate(Scenario, data, lines, "coverage scenario")


def engine(state: AtmosphericState) -> AtmosphericTerms:
    """A smooth stand-in for the radiative-transfer engine, shared by both sides as an input."""
    blue, haze = blue_and_haze(state.aerosol_optical_depth)
    gas = np.exp(-0.3 * (state.water_vapour_g_cm2 or 2.0) * line(940, 60))
    direct = sunlight() * np.exp(-0.5 * (haze + 0.1 * blue)) * gas / np.pi
    return smooth_terms(blue, haze, sunlight(), direct, gas)


def _bands_in_windows() -> SpectralAxis:
    """40 of the bands of the sensor, all in windows of the atmosphere."""
    whole = load_sensor("prospectir-vs").axis
    usable = np.flatnonzero(in_window(whole.centre_nm) & (whole.centre_nm > 430.0))
    return whole.select(usable[np.linspace(0, usable.size - 1, 40).astype(int)])


AXIS = _bands_in_windows()
NOISE = load_sensor("prospectir-vs").noise(AXIS)
B = len(AXIS)
_W = AXIS.centre_nm


def _shape(length_nm: float) -> Array:
    gap = np.subtract.outer(_W, _W) / length_nm
    return np.linalg.cholesky(np.exp(-0.5 * gap**2) + 1e-9 * np.eye(B))


_SHAPES = {length: _shape(length) for length in (200.0, 300.0, 500.0)}


def tilt(part: float) -> Array:
    """(B,) factor from 1 - part at the short end to 1 + part at the long one."""
    return np.asarray(1.0 + part * (2.0 * (_W - _W[0]) / (_W[-1] - _W[0]) - 1.0))


@dataclass(frozen=True)
class Truth:
    """One truth drawn from the budget: terms on the bands, spectra, and what the sensor makes of them."""

    terms: AtmosphericTerms
    light: Array  # factor on all radiance, and
    ground: float  # on what the ground reflects
    recorded: Array
    noise: float
    electrons: float
    fill: float
    spectra: dict[str, Array]
    panel_errors: tuple[Array, Array]


def truth(rng: np.random.Generator) -> Truth:
    """Draw a truth from the budget that the scenario states."""

    def smooth(sd: float, length_nm: float) -> Array:
        return np.asarray(sd * (_SHAPES[length_nm] @ rng.standard_normal(B)))

    state = {
        "aot550": max(0.2 + 0.01 * rng.standard_normal(), 0.0),
        "water_vapour_g_cm2": 2.0 + rng.uniform(-0.4, 0.4),
    }
    stated = scenario().atmosphere
    assert stated is not None
    terms = engine(stated.model_copy(update=state)).at_bands(AXIS)
    means = {n: builtin_class(s, AXIS).mean for n, s in SURFACES.items()}
    spectra = {
        "bright": HIGH * (1.0 + 0.005 * rng.standard_normal(B)),
        "field": means["field"] * (1.0 + smooth(0.04, 200.0)),
        **{n: means[n] * (1.0 + smooth(0.04, 300.0)) for n in ("plank", "asphalt", "grass")},
    }
    return Truth(
        terms,
        np.full(B, 1.0 + 0.01 * rng.standard_normal()),
        1.0 + 0.02 * rng.standard_normal(),
        1.0 + 0.005 * rng.standard_normal(B),
        1.0 + 0.05 * rng.standard_normal(),
        1.0 + 0.05 * rng.standard_normal(),
        float(np.clip(FILL + 0.003 * rng.standard_normal(), 0.0, 1.0)),
        spectra,
        (smooth(0.01, 500.0), smooth(0.01, 500.0)),
    )


SURFACES = {"grass": "grass", "asphalt": "asphalt", "plank": "yellow-paint-plank", "field": "soil"}
_ROOTS = {n: np.linalg.cholesky(builtin_class(s, AXIS).covariance + 1e-12 * np.eye(B)) for n, s in SURFACES.items()}


# Of the field's spread two broad patterns lie in patches on the ground; the rest differs from pixel to pixel.
_VALUES, _VECTORS = np.linalg.eigh(builtin_class("soil", AXIS).covariance)
_PATTERNS = (np.sqrt(_VALUES[-2:]) * _VECTORS[:, -2:]).T
_FINE = _VECTORS[:, :-2] * np.sqrt(np.clip(_VALUES[:-2], 0.0, None))


@dataclass(frozen=True)
class Collection:
    """Recorded radiance of pixels, (..., B)."""

    low: Array  # the dark panel of the empirical line, (n, B)
    high: Array  # its bright one
    bright: Array
    field: Array  # (lines, samples, B)
    background: Array
    targets: Array


def collect(t: Truth, rng: np.random.Generator, *, detection: bool = True, extra: Array | float = 1.0) -> Collection:
    """Make the pixels of one collection.

    ``extra`` (B,) is a factor on all recorded radiance that no budget knows.  Pixels are drawn class by class; the
    texture of the field is correlated on the ground, that of the rest is not.
    """
    average = sum(f * t.spectra[n] for n, f in CLASSES.items())
    bounce = 1.0 - t.terms.spherical_albedo * average
    path = t.light * (t.terms.path_radiance + t.ground * t.terms.adjacency * average / bounce)
    slope = t.light * t.ground * t.terms.direct / bounce
    noise = replace(NOISE, electrons_per_radiance=NOISE.electrons_per_radiance * t.electrons)
    detector = Detector(noise, path.astype(np.float32), slope.astype(np.float32), 1.0)

    def seen(reflectance: Array) -> Array:
        flat = reflectance.reshape(-1, B).astype(np.float32)
        level = detector.radiance(flat)
        measured = detector.measure(level, rng).astype(float)
        level = level.astype(float)
        return (t.recorded * extra * (level + t.noise * (measured - level))).reshape(reflectance.shape)

    def pixels(name: str, count: int) -> Array:
        return t.spectra[name] + rng.standard_normal((count, B)) @ _ROOTS[name].T

    field = t.spectra["field"] + rng.standard_normal((SITE, SITE, B - 2)) @ _FINE.T
    for pattern in _PATTERNS:
        wide = correlated_field((SITE + 40, SITE + 40), TEXTURE_PIXELS, rng)[20:-20, 20:-20]
        field = field + wide.astype(float)[..., None] * pattern
    flat = np.ones((PANEL_SIDE**2, B))
    low, high = (seen(rho / (1.0 + e) * flat) for rho, e in zip((LOW, HIGH), t.panel_errors, strict=True))
    bright = seen(t.spectra["bright"] * flat)
    none = np.zeros((0, B))
    if not detection:
        return Collection(low, high, bright, seen(field), none, none)
    counts = rng.multinomial(BACKGROUND, list(CLASSES.values()))
    background = np.concatenate([pixels(n, int(k)) for n, k in zip(CLASSES, counts, strict=True)])
    mixed = t.fill * pixels("plank", TARGETS) + (1.0 - t.fill) * pixels("asphalt", TARGETS)
    return Collection(low, high, bright, seen(field), seen(background), seen(mixed))
