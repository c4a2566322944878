"""Surroundings that a scenario states: their reflectance as a spectrum."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericState
from hyperval.config import load_model
from hyperval.errors import UsageError
from hyperval.model import Origins, mean_radiance, predict
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis
from small_campaign import stand_in_atmosphere

STATE = {
    "aot550": 0.2, "sensor_altitude_km": 2.3, "ground_altitude_km": 0.35, "solar_zenith_deg": 50.0,
    "solar_azimuth_deg": 0.0, "day_of_year": 312,
}  # fmt: skip
AXIS = SpectralAxis(np.array([450.0, 550.0, 860.0, 1650.0]), np.full(4, 5.0))


def scenario(uncertainty=None, **adjacency) -> Scenario:
    dark = {"name": "dark", "fraction": 1.0, "spectrum": {"constant": 0.05}, "covariance": {"relative_sd": 0.1}}
    content = {
        "schema": 1, "name": "one", "atmosphere": STATE, "sensor": "aviris-ng", "processing": {"detectors": []},
        "scene": {
            "classes": [dark], "sites": [{"name": "lawn", "spectrum": {"constant": 0.3}}], "adjacency": adjacency
        },
        "uncertainty": uncertainty or {},
    }  # fmt: skip
    return Scenario.model_validate(content)


def lawn(one: Scenario, **origins):
    return predict(one, Origins(AXIS, engine=stand_in_atmosphere, **origins)).radiance["lawn"]


def test_a_stated_spectrum_takes_the_place_of_the_classes_average():
    terms = stand_in_atmosphere(AtmosphericState(**STATE)).at_bands(AXIS)
    assert lawn(scenario()).mean == pytest.approx(mean_radiance(terms, 0.3, 0.05), rel=1e-12)
    bright = lawn(scenario(spectrum={"constant": 0.4}))
    assert bright.mean == pytest.approx(mean_radiance(terms, 0.3, 0.4), rel=1e-12)


def test_its_uncertainty_is_that_of_the_surroundings():
    one = scenario({"adjacency_reflectance_relative": 0.2}, spectrum={"constant": 0.4})
    terms = stand_in_atmosphere(AtmosphericState(**STATE)).at_bands(AXIS)
    high, low = (mean_radiance(terms, 0.3, 0.4 * f) for f in (1.2, 0.8))
    assert lawn(one).budget["surroundings"] == pytest.approx(0.5 * (high - low), rel=1e-3)


def test_the_key_of_a_height_of_their_own_is_gone_and_says_so(tmp_path):
    (tmp_path / "atmosphere.yaml").write_text("sensor_altitude_km: 2.3\nsurroundings_altitude_km: 0.0\n")
    with pytest.raises(UsageError, match=r"atmosphere\.yaml:2: .*this key is gone; .*ground_altitude_km"):
        load_model(AtmosphericState, tmp_path / "atmosphere.yaml")
