"""The state: what is accepted, what is refused and under which name; range, depth and share."""

import csv

import numpy as np
import pytest
from pydantic import ValidationError
from stored_cases import CASES

from hyperval.atmosphere import AtmosphericState, aot550_from_range, fraction_below, range_from_aot550
from hyperval.config import load_model, parse_yaml, validate
from hyperval.errors import UsageError

AIR = {"aot550": 0.1, "sensor_altitude_km": 2.0}
GOOD = {**AIR, "solar_zenith_deg": 40.0, "solar_azimuth_deg": 150.0, "day_of_year": 200}
PLACE = {**AIR, "latitude_deg": 34.139247, "longitude_deg": -118.127521, "time_utc": "2017-11-08T18:42:27Z"}


def state(base=GOOD, **changes):
    return AtmosphericState(**{k: v for k, v in {**base, **changes}.items() if v is not None})


@pytest.mark.parametrize(("changes", "named"), CASES["refused_states"])
def test_refused_by_the_name_of_the_field(changes, named):
    base = PLACE if changes.pop("by_place", False) else GOOD
    with pytest.raises(ValidationError, match=named):
        state(base, **changes)


def test_read_from_strict_yaml_with_the_time_as_text_and_without_keys_that_are_gone(tmp_path):
    data, lines = parse_yaml("\n".join(f"{k}: {v}" for k, v in PLACE.items()), "state.yaml")
    assert validate(AtmosphericState, data, lines, "state.yaml").time_utc == "2017-11-08T18:42:27Z"
    data["sensor_altitude_km"] = -1.0
    with pytest.raises(UsageError, match=r"state\.yaml:2: sensor_altitude_km"):
        validate(AtmosphericState, data, lines, "state.yaml")
    (tmp_path / "atmosphere.yaml").write_text("sensor_altitude_km: 2.3\nsurroundings_altitude_km: 0.0\n")
    with pytest.raises(UsageError, match=r"atmosphere\.yaml:2: .*this key is gone; .*ground_altitude_km"):
        load_model(AtmosphericState, tmp_path / "atmosphere.yaml")


def test_sun_of_the_published_spa_example_and_its_distance_over_the_year():
    # Reda & Andreas, NREL/TP-560-34302 (2008), appendix 5: 39.872046 deg elevation before refraction.
    example = {"latitude_deg": 39.742476, "longitude_deg": -105.1786, "time_utc": "2003-10-17T12:30:30-07:00"}
    found = state(PLACE, **example)
    assert found.sun[0] == pytest.approx(90.0 - 39.872046, abs=2e-3)  # the example stands at 1830 m
    assert found.sun[1] == pytest.approx(194.340241, abs=2e-3)
    assert found.distance_au == pytest.approx(0.9965422974, abs=1e-6)
    for day, distance in ((3, 0.9833), (186, 1.0167), (94, 1.0)):
        assert state(day_of_year=day).distance_au == pytest.approx(distance, abs=1e-3 if day == 94 else 2e-4)


def test_aerosol_depth_and_share_below():
    assert state(sensor_altitude_km=705.0).aerosol_fraction_below == 1.0
    assert 0.3 < state().aerosol_fraction_below < 0.9
    assert state(aerosol_share_below=0.75).aerosol_fraction_below == 0.75
    # 6S would take 0.235 for 23 km; LOWTRAN takes 0.325.
    assert state(aot550=None, meteorological_range_km=23.0).aerosol_optical_depth == pytest.approx(0.325, rel=0.005)


@pytest.mark.data
def test_reproduces_lowtran_table_to_one_percent(data_dir):
    checked = split = 0
    with open(data_dir("atmosphere/vis_aot_lowtran_rural.csv"), newline="") as stream:
        for row in csv.DictReader(stream):
            ground, whole = float(row["ground_km"]), float(row["aot550_below_100km_above_sea"])
            for name, text in row.items():
                if name.startswith("aot550_below_") and text:
                    top = float(name.removeprefix("aot550_below_").split("km")[0])
                    ours = aot550_from_range(float(row["vis_km"]), ground, top)
                    if ground == 0.5 and top == 3.0:
                        # Inside the layer over the boundary layer, which LOWTRAN splits and integrates otherwise:
                        # ours is the greater, and what is given up is 0.011 of the share.
                        assert 0.0 < (ours - float(text)) / whole < 0.011
                        split += 1
                        continue
                    # half a unit of the last printed digit, and 1 %
                    assert ours == pytest.approx(float(text), rel=0.01, abs=5e-5), (row["ground_km"], name)
                    checked += 1
    assert checked > 300
    assert split == 12


def test_range_and_depth_are_those_of_koschmieder_and_of_modtran_6():
    # Between ground and 1 km at 5-10 km range the extinction is constant: 3.912 / V less the molecular 0.012 km-1.
    for range_km in (5.0, 6.0, 8.0, 10.0):
        assert aot550_from_range(range_km, 0.0, 1.0) == pytest.approx(3.912 / range_km - 0.0122, rel=2e-3)
    # MODTRAN 6 states 214.25 km for an optical depth of 0.05 above ground at 0.40194 km.
    assert range_from_aot550(0.05, 0.40194) == pytest.approx(214.25, rel=0.01)
    # tp6 of the run over Pasadena: 0.04431222 of 0.09999746 at 550 nm lie below 2.3 km.
    assert fraction_below(0.1, 0.35, 2.3) == pytest.approx(0.04431222 / 0.09999746, abs=2e-3)
    for outside in (1.0, 301.0, float("nan")):
        with pytest.raises(UsageError, match="meteorological range"):
            aot550_from_range(outside)


@pytest.mark.parametrize("ground_km", [0.0, 0.35, 2.0, 5.0])
def test_clearer_air_is_thinner_the_inverse_returns_and_the_share_rises_without_a_step(ground_km):
    ranges = np.geomspace(2.0, 295.0, 12)
    depths = [aot550_from_range(v, ground_km) for v in ranges]
    assert np.all(np.diff(depths) < 0.0)
    assert [range_from_aot550(depth, ground_km) for depth in depths] == pytest.approx(ranges, rel=1e-6)
    for aot in (0.0, 0.05, 0.3, 0.8):
        heights = np.arange(ground_km + 0.02, 12.0, 0.02)
        steps = np.diff([fraction_below(aot, ground_km, h) for h in heights])
        assert np.all(steps > 0.0)
        # Extinction is continuous but where it starts to fall, so that a step resembles the one before it.
        assert np.all(steps[1:] < 1.5 * steps[:-1] + 1e-6)
        assert 0.0 < fraction_below(aot, ground_km, ground_km + 0.1) < fraction_below(aot, ground_km, 40.0) < 1.0
        assert fraction_below(aot, ground_km, 100.0) == pytest.approx(1.0, abs=1e-12)
