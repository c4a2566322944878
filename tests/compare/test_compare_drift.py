"""Drift of a number from day to day: slope, interval, coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import drift
from hyperval.errors import UsageError
from hyperval.results import Outcome

YEARS = np.array([0.0, 0.1, 0.15, 0.4, 0.7, 1.1, 1.2, 2.0])


def test_the_slope_is_that_of_another_route():
    values = np.array([0.01, 0.012, 0.013, 0.011, 0.02, 0.022, 0.019, 0.033])
    found, peer = drift(YEARS, values), stats.linregress(YEARS, values)
    half = stats.t.ppf(0.975, YEARS.size - 2) * peer.stderr
    assert found.per_year == pytest.approx(peer.slope)
    assert (found.lower, found.upper) == pytest.approx((peer.slope - half, peer.slope + half))


def test_an_error_of_all_days_cancels():
    values = 0.01 * YEARS + np.sin(40.0 * YEARS) * 1e-3
    assert drift(YEARS, values + 0.3).per_year == pytest.approx(drift(YEARS, values).per_year)


def test_the_interval_holds_the_truth_as_often_as_it_says():
    """Seed 3; of 2000 draws 1900 hold it on average, with a standard deviation of 9.7: fails once in 10,000."""
    rng, inside = np.random.default_rng(3), 0
    for _ in range(2000):
        found = drift(YEARS, 0.02 * YEARS + 0.005 * rng.standard_normal(YEARS.size))
        inside += found.lower <= 0.02 <= found.upper
    assert abs(inside - 1900) < 38


def test_outcomes_by_interval_against_range():
    found = drift(YEARS, 0.02 * YEARS + 1e-3 * np.sin(40.0 * YEARS))
    assert found.outcome(-0.05, 0.05) is Outcome.AGREES
    assert found.outcome(-0.01, 0.01) is Outcome.DISAGREES
    assert found.outcome(-0.05, found.per_year) is Outcome.UNDECIDED


@pytest.mark.parametrize("years", [[0.0, 1.0], [1.0, 1.0, 1.0]])
def test_too_few_days_are_refused(years):
    with pytest.raises(UsageError, match="days or more"):
        drift(years, np.zeros(len(years)))
