"""Intervals of proportions, and of alarms that come in clusters."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.stats import norm

from hyperval import model, pixels
from hyperval.products import ExceedanceCurve


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_limits_solve_the_binomial_tails(case):
    k, n = case
    low, high = (float(x) for x in model.clopper_pearson(k, n))
    assert low <= k / n <= high
    if k > 0:
        assert stats.binom.sf(k - 1, n, low) == pytest.approx(0.025, rel=1e-7)
    else:
        assert low == 0.0
    if k < n:
        assert stats.binom.cdf(k, n, high) == pytest.approx(0.025, rel=1e-7)
    else:
        assert high == 1.0


def test_jeffreys_limits_hold_at_their_level_on_average():
    """Summed over the binomial law, for P_FA of 3e-4 to 3e-3 in 44,100 pixels: no draws."""
    n = 44_100
    k = np.arange(0, 400)
    low, high = model.jeffreys_limits(k, n)
    covered = [stats.binom.pmf(k, n, p) @ ((low <= p) & (p <= high)) for p in np.geomspace(3e-4, 3e-3, 200)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.002)
    assert model.jeffreys_limits(0, n)[0] == 0.0
    assert model.jeffreys_limits(n, n)[1] == 1.0
    counts, p = np.array([0.0, 0.4, 2.5, 40.0, 79.6, 80.0])[:, None], np.linspace(0.0, 1.0, 99)
    lower, upper = model.jeffreys_limits(counts, 80.0)
    assert np.array_equal(model.beyond_jeffreys_limits(counts, 80.0, p), [p < lower, p > upper])
    assert model.jeffreys_limits(2.5, 80.0) == pytest.approx(tuple(stats.beta.ppf([0.025, 0.975], 3.0, 78.0)))


@pytest.mark.parametrize(("n", "mean"), [(5, 0.977), (25, 0.958), (80, 0.952)])
def test_mid_p_limits_solve_their_tails_and_hold_on_average_and_nowhere_far_below(n, mean):
    """Summed over the binomial law: no draws. Exact limits of 25 hold in 0.974 on average."""
    k = np.arange(n + 1)
    low, high = model.mid_p_limits(k, n)
    inner, half = k[1:], lambda k, p: stats.binom.pmf(k, n, p) / 2
    assert stats.binom.sf(inner, n, low[inner]) + half(inner, low[inner]) == pytest.approx(np.full(n, 0.025))
    inner = k[:-1]
    assert stats.binom.cdf(inner - 1, n, high[inner]) + half(inner, high[inner]) == pytest.approx(np.full(n, 0.025))
    assert (low[0], high[-1]) == (0.0, 1.0)
    p = np.linspace(0.02, 0.96, 1000)[:, None]
    covered = np.sum(stats.binom.pmf(k, n, p) * ((low <= p) & (p <= high)), axis=1)
    assert covered.mean() == pytest.approx(mean, abs=0.002)
    assert covered.min() > 0.92


@pytest.mark.simulation
def test_alarms_at_a_detection_hold_the_truth_where_they_come_in_clusters():
    # 150 worlds of clusters of 49 pixels, correlation 0.9, and 1,500 targets 2 standard deviations above: at a true
    # coverage of 0.95 fewer than 134 come in 0.2 % of runs (seed fixed).  Taken as independent 0.66 hold.
    rng, truth = np.random.default_rng(5), norm.sf(2.0)
    held = np.zeros(2)
    for _ in range(150):
        common = rng.standard_normal((15, 15)).repeat(7, 0).repeat(7, 1)
        scores = np.sqrt(0.9) * common + np.sqrt(0.1) * rng.standard_normal(common.shape)
        blocks, t = pixels.AlarmBlocks.of_map(scores, np.ones(scores.shape, bool)), rng.normal(2.0, 1.0, 1500)
        for i, background in enumerate((blocks, scores)):
            (found,) = pixels.alarms_at_detection(t, background, [0.5])
            held[i] += found.pfa_lower <= truth <= found.pfa_upper
    assert held[0] >= 134, held
    assert held[1] < 115, held


def test_a_class_that_lies_in_one_block_counts_with_the_others():
    # Its blocks tell nothing of its own scatter: one roof is one piece of luck, known to be a roof or not.
    scores = np.random.default_rng(11).standard_normal((80, 80))
    roof = np.zeros((80, 80), int)
    roof[20:27, 20:27] = 1
    alone = pixels.AlarmBlocks.of_map(scores + 9.0 * roof, np.ones(roof.shape, bool), classes=roof)
    blind = pixels.AlarmBlocks.of_map(scores + 9.0 * roof, np.ones(roof.shape, bool))
    assert np.unique(alone.stratum).size == 1
    for limits in zip(alone.pfa_limits(np.array([6.0])), blind.pfa_limits(np.array([6.0])), strict=True):
        assert limits[0] == pytest.approx(limits[1], rel=0.05)  # the roof has cells of its own


def test_halves_of_an_image_differ_by_the_rates_of_their_own_pixels():
    # Of 1, 1, 3, 3 pixels 1, 0, 0, 2 are alarms, and half of every block of a class of 32 pixels, which adds 16 to
    # either half. Three ways to halve four blocks: 20 : 18 2/3, 20 : 18 and 22 : 16, each in a third of the draws.
    block = np.repeat(np.arange(8), [1, 1, 3, 3, 8, 8, 8, 8])
    scores = np.concatenate([[1.0, 0, 0, 0, 0, 1, 1, 0], np.tile([1.0, 0.0], 16)])
    blocks = pixels.AlarmBlocks.of_places(scores, 20 * block, 0 * block, 10, block > 3)
    assert blocks.half_image_factor(np.array([0.5])) == pytest.approx([20.0 / 18.0])
    single = pixels.AlarmBlocks.of_places(scores, 0 * block, 0 * block, 10)
    assert single.half_image_factor(np.array([0.5]))[0] == np.inf


def test_ranks_of_a_threshold_are_those_whose_interval_holds_the_probability():
    # 36 scores are few enough for the effect of each to be looked up: the limits themselves, one by one.
    scores = np.random.default_rng(12).normal(size=(3, 3)).repeat(2, 0).repeat(2, 1) + np.arange(36).reshape(6, 6) / 99
    blocks = pixels.AlarmBlocks.of_map(scores, np.ones((6, 6), bool), side=2)
    _, low, high = blocks.pfa_limits(np.append(blocks.ascending[::-1], -np.inf))
    pfa = np.array([0.1, 0.3, 0.85, 0.95])
    holds = (low <= pfa[:, None]) & (pfa[:, None] <= high)
    r, s = blocks.rank_limits(pfa)
    assert r.tolist() == holds.argmax(axis=1).tolist()
    assert s.tolist() == [37 - int(row[::-1].argmax()) for row in holds]


def test_a_threshold_that_no_background_score_bounds_from_below_leaves_every_target_open():
    """At 0.9 of ten scores the true threshold may lie below them all, and below targets that lie there too."""
    rate = pixels.empirical_roc([-5.0, -5.0, -5.0], np.arange(10.0), [0.5, 0.9])
    assert rate.pd.tolist() == [0.0, 0.0]
    assert rate.pd_upper[1] == 1.0
    assert rate.pd_upper[0] == model.mid_p_limits(0, 3)[1] < 1.0


def test_log_linear_between_points():
    curve = pixels.exceedance_curve(
        pixels.AlarmBlocks.of_map(np.random.default_rng(2).exponential(size=(60, 60)), np.ones((60, 60)))
    )
    x, p = curve.threshold, curve.probability
    assert pixels.exceedance_at(curve, float(x[3])) == pytest.approx(p[3])
    assert pixels.exceedance_at(curve, 0.5 * (x[3] + x[4])) == pytest.approx(np.sqrt(p[3] * p[4]))
    assert pixels.exceedance_at(curve, 1e3) == pytest.approx(p[p > 0][-1])


def test_the_point_of_a_level_is_the_nearest_by_ratio():
    grid = np.arange(3.0)
    measured = ExceedanceCurve(grid, np.array([0.5, 0.017, 0.004]), *np.full((2, 3), 0.01), 1000)
    found = pixels.false_alarm_ratio(measured, measured, 1e-2)
    assert (found.at, found.value) == (1, pytest.approx(1.0))
