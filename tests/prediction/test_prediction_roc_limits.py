"""Limits of predicted ROC curves: drawn, rising, and as wide as the inputs make them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr, ndtri

from hyperval.model import with_bands
from hyperval.products import RocCurve

KEY = ("s", "cem", "pixel")
PFA = np.logspace(-9, -0.01, 60)


def curve(d: float = 3.0) -> RocCurve:
    pd = ndtr(d + ndtri(PFA))
    return RocCurve(PFA, pd, pd, pd, -ndtri(PFA))


def limits(base: RocCurve, changes) -> tuple[np.ndarray, np.ndarray]:
    up, down = (np.array([pair[i] for pair in changes]) for i in (0, 1))
    found = with_bands({KEY: base}, {KEY: (up, down)})[KEY]
    return found.pd_lower, found.pd_upper


def test_one_input_that_shifts_the_curve_gives_its_own_interval():
    """2048 evenly spread draws of one number: limits to 1 % of the half width."""
    low, high = limits(curve(), [(np.full(60, 0.3), np.full(60, -0.3))])
    z = 3.0 + ndtri(PFA)
    assert ndtri(high) - z == pytest.approx(1.96 * 0.3, rel=0.01)
    assert z - ndtri(low) == pytest.approx(1.96 * 0.3, rel=0.01)


def test_limits_do_not_fall_where_an_input_tilts_the_curve():
    """What one input does at low P_FA is large against the slope of the curve: limits point by point fall."""
    tilt = np.linspace(4.0, 0.1, 60)
    changes = [(tilt, -tilt), (np.full(60, 0.1), np.full(60, -0.1))]
    z, spread = ndtri(curve(1.0).pd), np.sqrt(tilt**2 + 0.01)
    plain = ndtr(z + 1.96 * spread)
    assert (np.maximum.accumulate(plain) - plain).max() > 0.05  # limits point by point
    low, high = limits(curve(1.0), changes)
    assert np.all(np.diff(low) >= 0)
    assert np.all(np.diff(high) >= 0)


def test_a_change_that_one_side_alone_makes_widens_that_side_alone():
    """An input that can only hurt; 2048 draws know its limits to half a per cent."""
    low, high = limits(curve(), [(np.zeros(60), np.full(60, -0.5))])
    z = 3.0 + ndtri(PFA)
    assert ndtri(high) == pytest.approx(z, abs=0.005)
    assert z - ndtri(low) == pytest.approx(1.96 * 0.5, abs=0.005)


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_limits_rise_and_hold_the_curve(seed):
    rng = np.random.default_rng(seed)
    base = curve(float(rng.uniform(0, 6)))
    changes = [tuple(rng.normal(0, 2, 2)[:, None] * rng.normal(0, 1, 60).cumsum() / 8) for _ in range(3)]
    low, high = limits(base, changes)
    assert np.all(np.diff(low) >= 0)
    assert np.all(np.diff(high) >= 0)
    assert np.all(low <= base.pd)
    assert np.all(high >= base.pd)
