"""Intervals of proportions against published values, closed forms and their own coverage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hyperval.errors import UsageError
from hyperval.model import (
    beyond_jeffreys_limits,
    clopper_pearson,
    jeffreys_limits,
    joint_region,
    mid_p_limits,
    zero_count_upper_limit,
)


def test_fifteen_of_twenty():
    low, high = clopper_pearson(15, 20)
    assert round(float(low), 3) == 0.509
    assert round(float(high), 3) == 0.913


def test_no_alarm_in_12203_pixels():
    limit = zero_count_upper_limit(12203)
    assert 2.4e-4 < limit < 2.5e-4
    assert limit == pytest.approx(float(clopper_pearson(0, 12203, 0.9)[1]), rel=1e-9)
    assert (1.0 - limit) ** 12203 == pytest.approx(0.05, rel=1e-9)  # the definition


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_limits_solve_the_binomial_tails(case):
    k, n = case
    low, high = (float(x) for x in clopper_pearson(k, n))
    assert low <= k / n <= high
    if k > 0:
        assert stats.binom.sf(k - 1, n, low) == pytest.approx(0.025, rel=1e-7)
    else:
        assert low == 0.0
    if k < n:
        assert stats.binom.cdf(k, n, high) == pytest.approx(0.025, rel=1e-7)
    else:
        assert high == 1.0


@pytest.mark.parametrize("p", [0.02, 0.3, 0.75, 0.99])
def test_coverage_is_exact_or_more(p):
    # Exact sum over all outcomes: no random numbers.
    n = 20
    k = np.arange(n + 1)
    low, high = clopper_pearson(k, n)
    covered = stats.binom.pmf(k, n, p)[(low <= p) & (p <= high)].sum()
    assert covered >= 0.95


def test_joint_region_covers_both_at_once():
    # Exact sum over both binomials at one true point.
    m, n, pd, pfa = 20, 200, 0.8, 0.03
    total = 0.0
    k = np.arange(n + 1)
    weights = stats.binom.pmf(k, n, pfa)
    for d in range(m + 1):
        for a in k[weights > 1e-9]:
            region = joint_region(d, m, int(a), n)
            if region.pd_lower <= pd <= region.pd_upper and region.pfa_lower <= pfa <= region.pfa_upper:
                total += stats.binom.pmf(d, m, pd) * weights[a]
    assert 0.95 <= total < 0.995


@pytest.mark.parametrize(
    ("k", "n", "level"), [(1, 0, 0.95), (3, 2, 0.95), (-1, 2, 0.95), (1, 2, 1.0), (np.nan, 2, 0.9)]
)
@pytest.mark.parametrize("limits", [clopper_pearson, mid_p_limits])
def test_impossible_counts_are_refused(limits, k, n, level):
    with pytest.raises(UsageError):
        limits(k, n, level)


def test_jeffreys_limits_hold_at_their_level_on_average_and_clopper_pearson_s_above_it():
    """Summed over the binomial law, for P_FA of 3e-4 to 3e-3 in 44,100 pixels: no draws."""
    n = 44_100
    k = np.arange(0, 400)
    share = {}
    for name, limits in (("jeffreys", jeffreys_limits), ("exact", clopper_pearson)):
        low, high = limits(k, n)
        covered = [float(stats.binom.pmf(k, n, p) @ ((low <= p) & (p <= high))) for p in np.geomspace(3e-4, 3e-3, 200)]
        share[name] = float(np.mean(covered))
    assert share["jeffreys"] == pytest.approx(0.95, abs=0.002)
    assert share["exact"] > 0.958
    assert jeffreys_limits(0, n)[0] == 0.0
    assert jeffreys_limits(n, n)[1] == 1.0
    counts, p = np.array([0.0, 0.4, 2.5, 40.0, 79.6, 80.0])[:, None], np.linspace(0.0, 1.0, 99)
    lower, upper = jeffreys_limits(counts, 80.0)
    assert np.array_equal(beyond_jeffreys_limits(counts, 80.0, p), [p < lower, p > upper])
    assert jeffreys_limits(2.5, 80.0) == pytest.approx(tuple(stats.beta.ppf([0.025, 0.975], 3.0, 78.0)))


@pytest.mark.parametrize(("n", "mean"), [(5, 0.977), (25, 0.958), (80, 0.952)])
def test_mid_p_limits_solve_their_tails_and_hold_on_average_and_nowhere_far_below(n, mean):
    """Summed over the binomial law: no draws. Exact limits of 25 hold in 0.974 on average."""
    k = np.arange(n + 1)
    low, high = mid_p_limits(k, n)
    inner, half = k[1:], lambda k, p: stats.binom.pmf(k, n, p) / 2
    assert stats.binom.sf(inner, n, low[inner]) + half(inner, low[inner]) == pytest.approx(np.full(n, 0.025))
    inner = k[:-1]
    assert stats.binom.cdf(inner - 1, n, high[inner]) + half(inner, high[inner]) == pytest.approx(np.full(n, 0.025))
    assert (low[0], high[-1]) == (0.0, 1.0)
    p = np.linspace(0.02, 0.96, 1000)[:, None]
    covered = np.sum(stats.binom.pmf(k, n, p) * ((low <= p) & (p <= high)), axis=1)
    assert covered.mean() == pytest.approx(mean, abs=0.002)
    assert covered.min() > 0.92
