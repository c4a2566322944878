"""Surroundings that a scenario states: their reflectance as a spectrum, their height."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.atmosphere import AtmosphericState, engine
from hyperval.predict import Origins, predict
from hyperval.scenario import Scenario
from hyperval.scene.radiance import mean_radiance
from hyperval.spectra.axis import SpectralAxis
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


def test_it_is_read_from_a_file(tmp_path):
    (tmp_path / "around.txt").write_text("wavelength_nm reflectance\n400 0.1\n2500 0.5\n")
    source = {"file": "around.txt", "wavelength_unit": "nm", "reflectance_unit": "fraction"}
    seen = lawn(scenario(spectrum=source), resolve=lambda name: tmp_path / name)
    around = 0.1 + 0.4 * (AXIS.centre_nm - 400.0) / 2100.0
    terms = stand_in_atmosphere(AtmosphericState(**STATE)).at_bands(AXIS)
    assert seen.mean == pytest.approx(mean_radiance(terms, 0.3, around), rel=1e-6)


def test_a_height_of_their_own_gives_what_they_scatter_and_send_back(monkeypatch):
    heights = []

    def higher_is_clearer(state, _):
        heights.append(state.ground_altitude_km)
        return stand_in_atmosphere(state.model_copy(update={"aot550": 0.3 - 0.2 * state.ground_altitude_km}))

    monkeypatch.setitem(engine.ENGINES, "sixs", higher_is_clearer)
    same, low, own = (
        engine.atmospheric_terms(AtmosphericState(**STATE, **more))
        for more in ({"surroundings_altitude_km": 0.35}, {"surroundings_altitude_km": 0.0}, {})
    )
    assert heights == [0.35, 0.35, 0.0, 0.35]
    assert np.array_equal(same.adjacency, own.adjacency)
    assert np.array_equal(low.path_radiance, own.path_radiance)
    assert np.array_equal(low.direct, own.direct)
    there = higher_is_clearer(AtmosphericState(**{**STATE, "ground_altitude_km": 0.0}), None)
    assert np.array_equal(low.adjacency, there.adjacency)
    assert np.array_equal(low.spherical_albedo, there.spherical_albedo)
    assert not np.array_equal(low.adjacency, own.adjacency)
    assert low.provenance["surroundings_altitude_km"] == 0.0


def test_surroundings_above_the_sensor_are_refused():
    with pytest.raises(ValidationError, match="must lie below sensor_altitude_km"):
        AtmosphericState(**STATE, surroundings_altitude_km=2.5)
    with pytest.raises(ValidationError, match=r"atmosphere\.surroundings_altitude_km is not: state it there"):
        scenario({"surroundings_altitude_km": 0.05})
