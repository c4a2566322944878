"""What a prediction says it was not told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.model import engine_notes, unstated_notes
from hyperval.scenario import Uncertainty


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


def terms(**provenance: object) -> AtmosphericTerms:
    one = np.ones(2)
    return AtmosphericTerms(np.array([500.0, 600.0]), one, one, one, one, one, one, dict(provenance))


def test_a_table_that_replaces_the_stated_sun_says_so():
    own = terms(solar_spectrum="of the table")
    (said,) = engine_notes(state(engine="table", table="lut.nc", solar_spectrum="tsis-1"), own)
    assert "solar_spectrum tsis-1, which the scenario states, is not used" in said
    assert engine_notes(state(engine="table", table="lut.nc"), own) == []
    assert engine_notes(state(solar_spectrum="tsis-1"), terms(solar_spectrum="tsis-1")) == []


def test_bands_beyond_the_solar_spectrum_are_said():
    far = replace(terms(solar_spectrum="tsis-1"), wavelength_nm=np.array([2499.0, 2501.0]))
    (said,) = engine_notes(state(), far)
    assert "covers 350-2500 nm: in 1 of 2 bands" in said
    assert "the shape of astm-g173" in said
    assert engine_notes(state(), replace(far, provenance={"solar_spectrum": "astm-g173"})) == []


def test_more_air_and_water_than_the_engine_was_compared_with_is_said():
    far = state(sensor_altitude_km=700.0, water_vapour_g_cm2=5.0, solar_zenith_deg=60.0)
    air, water = engine_notes(far, terms(engine_ratio=True))
    assert air.startswith("the light goes through 3 atm of air")
    assert water.startswith("the light goes through 15 g cm-2 of water vapour")
    assert engine_notes(far, terms(engine_ratio=False)) == []
    assert engine_notes(state(water_vapour_g_cm2=1.0), terms(engine_ratio=True)) == []
