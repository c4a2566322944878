"""A scene of ten bands under a stand-in atmosphere, for departures, budgets and their propagation."""

from pathlib import Path

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
SCENE, ATMOSPHERE = Path(__file__).with_suffix(".yaml").read_text("utf-8").split("# ---\n")


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
