"""What a prediction says it was not told."""

from __future__ import annotations

import pytest

from hyperval.atmosphere import AtmosphericState
from hyperval.prediction.setup import unstated_notes
from hyperval.scenario_uncertainty import Uncertainty


def state(**stated: object) -> AtmosphericState:
    given = {"aot550": 0.1, "sensor_altitude_km": 3.0, "solar_zenith_deg": 30.0, "solar_azimuth_deg": 0.0}
    return AtmosphericState.model_validate(given | {"day_of_year": 180} | stated)


@pytest.mark.parametrize(
    # Columns above sea level that the manual of 6S lists for these atmospheres (McClatchey et al. 1972), to 5 %.
    ("model", "water", "ozone"),
    [("midlatitude-summer", 2.93, 0.319), ("midlatitude-winter", 0.853, 0.395), ("tropical", 4.12, 0.247)],
)
def test_gases_that_are_not_stated_are_named_with_their_columns(model: str, water: float, ozone: float):
    of_water, of_ozone = unstated_notes(state(model=model), Uncertainty(aot550=0.02))
    assert of_water.startswith(f"water vapour is not stated: that of the standard atmosphere {model} is taken, ")
    assert float(of_water.split()[-3]) == pytest.approx(water, rel=0.05)
    assert of_water.endswith(" g cm-2")
    assert float(of_ozone.split()[-3]) == pytest.approx(ozone, rel=0.05)


def test_what_is_stated_needs_no_note():
    stated = state(water_vapour_g_cm2=1.2, ozone_atm_cm=0.3)
    assert unstated_notes(stated, Uncertainty(aot550=0.02)) == []
    assert unstated_notes(None, Uncertainty(aot550=0.02)) == []
    (only,) = unstated_notes(stated, Uncertainty())
    assert only.startswith("the scenario states no uncertainty")
