"""Meteorological range to optical depth."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperval.atmosphere import aot550_from_range, fraction_below, range_from_aot550
from hyperval.errors import UsageError


@pytest.mark.data
def test_reproduces_lowtran_table_to_one_percent(data_dir):
    path = data_dir("atmosphere/vis_aot_lowtran_rural.csv")
    checked = split = 0
    with open(path, newline="") as stream:
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


def test_surface_extinction_is_koschmieder_less_molecules():
    # Between ground and 1 km at 5-10 km range the extinction is constant: 3.912 / V less the molecular 0.012 km-1.
    for range_km in (5.0, 6.0, 8.0, 10.0):
        assert aot550_from_range(range_km, 0.0, 1.0) == pytest.approx(3.912 / range_km - 0.0122, rel=2e-3)


def test_agrees_with_a_modtran_6_run():
    # MODTRAN 6 states 214.25 km for an optical depth of 0.05 above ground at 0.40194 km.
    assert range_from_aot550(0.05, 0.40194) == pytest.approx(214.25, rel=0.01)


def test_differs_from_the_rule_of_6s():
    # 6S would take 0.235 for 23 km; LOWTRAN takes 0.325.
    assert aot550_from_range(23.0) == pytest.approx(0.325, rel=0.005)


@given(st.floats(2.0, 290.0), st.floats(0.0, 5.0))
def test_clearer_air_is_thinner_and_the_inverse_returns(range_km, ground_km):
    thick, thin = aot550_from_range(range_km, ground_km), aot550_from_range(range_km + 5.0, ground_km)
    assert thin < thick
    assert range_from_aot550(thick, ground_km) == pytest.approx(range_km, rel=1e-6)


@given(st.floats(0.0, 1.0), st.floats(0.0, 3.0))
def test_share_below_the_sensor_grows_with_its_altitude(aot, ground_km):
    heights = ground_km + np.array([0.1, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 40.0, 100.0])
    shares = [fraction_below(aot, ground_km, h) for h in heights]
    assert np.all(np.diff(shares) > 0.0)
    assert 0.0 < shares[0] < shares[-1] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("aot", "ground_km"), [(0.05, 0.0), (0.3, 0.0), (0.1, 0.35), (0.8, 2.0)])
def test_share_below_the_sensor_has_no_step(aot, ground_km):
    heights = np.arange(ground_km + 0.02, 12.0, 0.02)
    steps = np.diff([fraction_below(aot, ground_km, h) for h in heights])
    assert np.all(steps > 0.0)
    # Extinction is continuous but where it starts to fall, so that a step resembles the one before it.
    assert np.all(steps[1:] < 1.5 * steps[:-1] + 1e-6)


def test_share_below_an_aircraft_is_that_of_a_modtran_6_run():
    # tp6 of the run over Pasadena: 0.04431222 of 0.09999746 at 550 nm lie below 2.3 km.
    assert fraction_below(0.1, 0.35, 2.3) == pytest.approx(0.04431222 / 0.09999746, abs=2e-3)


@pytest.mark.parametrize("range_km", [1.0, 301.0, float("nan")])
def test_range_outside_the_rule_is_refused(range_km):
    with pytest.raises(UsageError, match="meteorological range"):
        aot550_from_range(range_km)
