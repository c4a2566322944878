"""The share of aerosol below an aircraft, stated in place of the rule."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, sixs_terms
from hyperval.model import Origins, predict
from hyperval.scenario import Scenario

STATE = {
    "aot550": 0.2, "sensor_altitude_km": 2.3, "ground_altitude_km": 0.35, "solar_zenith_deg": 50.0,
    "solar_azimuth_deg": 0.0, "day_of_year": 312, "water_vapour_g_cm2": 1.2,
}  # fmt: skip
GRID = np.arange(350.0, 2601.0, 10.0)


def terms(state) -> AtmosphericTerms:
    """A path that is the share, and half of it the exponent, seen over nothing else."""
    one = np.ones(GRID.size)
    path = state.aerosol_fraction_below + 0.5 * (state.angstrom_exponent or 0.0)
    return AtmosphericTerms(GRID, path * one, one, 0.1 * one, 0.1 * one, one, one)


def test_both_are_inputs_of_the_budget():
    scenario = Scenario.model_validate({
        "name": "s", "sensor": "aviris-ng",
        "atmosphere": {**STATE, "aerosol_share_below": 0.5, "angstrom_exponent": 1.0},
        "scene": {"classes": [{"name": "a", "fraction": 1.0, "spectrum": {"constant": 0.2}}]},
        "processing": {"elm": "none", "detectors": []},
        "uncertainty": {"aerosol_share_below": 0.1, "angstrom_exponent": 0.2},
    })  # fmt: skip
    found = predict(scenario, Origins(engine=terms)).radiance["a"]
    assert set(found.budget) == {"share of aerosol below the sensor", "Angstrom exponent"}
    assert found.standard_uncertainty == pytest.approx(np.hypot(0.1, 0.1))
    with pytest.raises(ValidationError, match="aerosol_share_below is given, but atmosphere"):
        Scenario.model_validate(
            {**scenario.model_dump(by_alias=True, mode="json"), "atmosphere": {**STATE, "angstrom_exponent": 1.0}}
        )


@pytest.mark.slow
def test_more_below_is_a_brighter_path_and_the_same_sunlight(engine_cache, solver_at):
    solver_at(550.0, 860.0)
    few, many = (sixs_terms(AtmosphericState(**STATE, aerosol_share_below=s), engine_cache, False) for s in (0.4, 0.8))
    green = few.wavelength_nm == 550.0
    assert 1.1 < many.path_radiance[green] / few.path_radiance[green] < 2.0
    assert many.ground_irradiance[green] == pytest.approx(few.ground_irradiance[green], rel=5e-3)
    # Light from the ground crosses 0.08 more of optical depth: less of it comes straight.
    assert many.direct[green] / few.direct[green] == pytest.approx(np.exp(-0.08), rel=5e-3)
