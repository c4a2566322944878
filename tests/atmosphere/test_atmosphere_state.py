"""The state: what is accepted, what is refused and under which name."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from hyperval.atmosphere import AtmosphericState
from hyperval.config import parse_yaml, validate
from hyperval.errors import UsageError

GOOD = {
    "aot550": 0.1,
    "sensor_altitude_km": 2.0,
    "solar_zenith_deg": 40.0,
    "solar_azimuth_deg": 150.0,
    "day_of_year": 200,
}
PLACE = {
    "aot550": 0.1,
    "sensor_altitude_km": 2.0,
    "latitude_deg": 34.139247,
    "longitude_deg": -118.127521,
    "time_utc": "2017-11-08T18:42:27Z",
}


def without(base, *names, **changes):
    return {k: v for k, v in {**base, **changes}.items() if k not in names}


@pytest.mark.parametrize(
    ("data", "named"),
    [
        (without(GOOD, "aot550"), "aot550 and meteorological_range_km: neither"),
        (without(GOOD, meteorological_range_km=23.0), "aot550 and meteorological_range_km: both"),
        (without(GOOD, "aot550", meteorological_range_km=1.0), "meteorological_range_km"),
        (without(GOOD, aerosol="none"), "aot550"), (without(GOOD, aot550=-0.1), "aot550"),
        (without(GOOD, solar_zenith_deg=90.0), "solar_zenith_deg: the sun is below the horizon"),
        (without(GOOD, solar_zenith_deg=85.0), "solar_zenith_deg: the sun is too low"),
        (without(GOOD, "solar_azimuth_deg"), "solar_azimuth_deg is missing"),
        (without(GOOD, "day_of_year"), "day_of_year and earth_sun_distance_au"),
        (without(GOOD, earth_sun_distance_au=1.0), "day_of_year and earth_sun_distance_au"),
        (without(GOOD, latitude_deg=10.0), "latitude_deg"), (without(PLACE, "longitude_deg"), "longitude_deg is miss"),
        (without(PLACE, time_utc="2017-11-08T06:00:00Z"), "time_utc: the sun is below the horizon"),
        (without(PLACE, time_utc="yesterday"), "time_utc"),
        (without(GOOD, "solar_zenith_deg", "solar_azimuth_deg", "day_of_year"), "latitude_deg is missing"),
        (without(GOOD, ground_altitude_km=2.0), "sensor_altitude_km"), (without(GOOD, aerosol="smoke"), "aerosol"),
        (without(GOOD, aerosol={"dust": 0.5, "soot": 0.4}), "must be 1, not 0.9"),
        (without(GOOD, angstrom_exponent=0.2, engine="modtran"), "sixs alone"),
        (without(GOOD, "aot550", angstrom_exponent=0.2, meteorological_range_km=20.0), "needs aot550"),
        (without(GOOD, aerosol_share_below=0.5, sensor_altitude_km=700.0), "within the air"),
        (without(GOOD, "aot550", aerosol_share_below=0.5, aerosol="none"), "over aerosol"),
        (without(GOOD, aerosol_share_below=0.5, engine="modtran"), "sixs alone"),
    ],
)  # fmt: skip
def test_refused_by_the_name_of_the_field(data, named):
    with pytest.raises(ValidationError, match=named):
        AtmosphericState.model_validate(data)


def test_read_from_strict_yaml_with_the_time_as_text():
    text = "\n".join(f"{k}: {v}" for k, v in PLACE.items())
    data, lines = parse_yaml(text, "state.yaml")
    state = validate(AtmosphericState, data, lines, "state.yaml")
    assert state.time_utc == "2017-11-08T18:42:27Z"
    data["sensor_altitude_km"] = -1.0
    with pytest.raises(UsageError, match=r"state\.yaml:2: sensor_altitude_km"):
        validate(AtmosphericState, data, lines, "state.yaml")


def test_sun_of_the_published_spa_example():
    # Reda & Andreas, NREL/TP-560-34302 (2008), appendix 5: 39.872046 deg elevation before refraction.
    state = AtmosphericState(
        aot550=0.1,
        sensor_altitude_km=10.0,
        latitude_deg=39.742476,
        longitude_deg=-105.1786,
        time_utc="2003-10-17T12:30:30-07:00",
    )
    zenith, azimuth = state.sun
    assert zenith == pytest.approx(90.0 - 39.872046, abs=2e-3)  # the example stands at 1830 m
    assert azimuth == pytest.approx(194.340241, abs=2e-3)
    assert state.distance_au == pytest.approx(0.9965422974, abs=1e-6)


def test_distance_of_the_earth_over_the_year():
    at = {d: AtmosphericState(**without(GOOD, day_of_year=d)).distance_au for d in (3, 94, 186, 277)}
    assert at[3] == pytest.approx(0.9833, abs=2e-4)
    assert at[186] == pytest.approx(1.0167, abs=2e-4)
    assert at[94] == pytest.approx(1.0, abs=1e-3)


def test_aerosol_depth_and_share_below():
    assert AtmosphericState(**without(GOOD, sensor_altitude_km=705.0)).aerosol_fraction_below == 1.0
    assert 0.3 < AtmosphericState(**GOOD).aerosol_fraction_below < 0.9
    assert AtmosphericState(**without(GOOD, aerosol_share_below=0.75)).aerosol_fraction_below == 0.75
    hazy = AtmosphericState(**without(GOOD, "aot550", meteorological_range_km=23.0))
    assert hazy.aerosol_optical_depth == pytest.approx(0.3248, rel=0.01)
