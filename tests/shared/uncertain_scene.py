"""A scene of ten bands under a stand-in atmosphere, for departures, budgets and their propagation."""

import numpy as np
from stand_in_atmosphere import blue_and_haze, line, smooth_terms, sunlight

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.config import parse_yaml, validate
from hyperval.model import Origins, predict
from hyperval.products import PredictedProducts
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.array([450.0, 550, 670, 750, 860, 1050, 1240, 1650, 2130, 2250]), np.full(10, 10.0))


def engine(state: AtmosphericState) -> AtmosphericTerms:
    """Rayleigh-like path, haze by optical depth, water at 940 nm, light by the cosine of the sun's zenith angle."""
    blue, haze = blue_and_haze(state.aerosol_optical_depth)
    water, ozone = (state.water_vapour_g_cm2 or 2.0) * line(940, 60), (state.ozone_atm_cm or 0.3) * line(600, 60)
    mu = np.cos(np.radians(state.sun[0]))
    gas = np.exp(-0.3 * water - 0.1 * ozone)
    direct = sunlight() * mu * np.exp(-0.5 * (haze + 0.1 * blue) / mu) * gas / np.pi
    return smooth_terms(blue, haze, sunlight() * mu, direct, gas)


ORIGINS = Origins(axis=AXIS, engine=engine)
SCENE = """
schema: 1
name: small
scene:
  classes:
    - {name: grass, fraction: 0.7, spectrum: {builtin: grass}}
    - {name: asphalt, fraction: 0.3, spectrum: {builtin: asphalt}}
  panels: [{name: panel, spectrum: {builtin: grey-panel-30}}]
  targets:
    - name: plank
      spectrum: {builtin: yellow-paint-plank}
      host: asphalt
      subjects:
        - {name: tenth, fill: {fixed: 0.1}}
        - {name: loose, fill: {mean: 0.15, sd: 0.05}}
processing: {detectors: [cem], bands: {drop_bad: false}}
"""
ATMOSPHERE = """
atmosphere: {aot550: 0.2, water_vapour_g_cm2: 2.0, ozone_atm_cm: 0.3, sensor_altitude_km: 1, solar_zenith_deg: 30,
             solar_azimuth_deg: 0, day_of_year: 200}
sensor: prospectir-vs
"""


def scenario(extra: str = ATMOSPHERE, scene: str = SCENE, **replaced: str) -> Scenario:
    """The scene with more YAML after it, and words of its text replaced."""
    text = scene + extra
    for old, new in replaced.items():
        text = text.replace(old, new)
    data, lines = parse_yaml(text)
    return validate(Scenario, data, lines, "text")


def run(s: Scenario, **kwargs) -> PredictedProducts:
    """The prediction on the ten bands."""
    return predict(s, ORIGINS, **kwargs)
