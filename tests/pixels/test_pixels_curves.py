"""Measured curves: points, areas, intervals, pools, and false alarms."""

import numpy as np
import pytest
from exact_forms import roc_points
from hypothesis import given
from hypothesis import strategies as st
from scipy import special, stats
from scipy.special import logit
from scipy.stats import norm

from hyperval import model, pixels
from hyperval.model import WHOLE, RocArea, mid_p_limits
from hyperval.products import RocCurve

# Empirical ROC, its areas and alarms: brute force, definitions, closed forms and coverage.


few_values = st.lists(st.sampled_from([-np.inf, -1.0, 0.0, 0.5, 1.0, np.inf]), min_size=1, max_size=25)


@given(few_values, few_values, st.sampled_from([0.01, 0.1, 0.29, 0.3, 0.5, 1.0]))
def test_preset_false_alarm_rate_by_brute_force(target, background, pfa):
    found = pixels.empirical_roc(target, background, pfa)
    allowed = [
        np.mean([t > s for t in target])
        for s in {*target, *background}
        if np.mean([b > s for b in background]) <= pfa + 1e-12
    ]
    best = 1.0 if pfa == 1.0 else max(allowed)
    assert found.pd[0] == pytest.approx(best, abs=1e-15)
    assert found.alarms[0] <= pfa * len(background) + 1e-9
    assert found.pd_lower[0] <= mid_p_limits(round(found.pd[0] * len(target)), len(target))[0] or pfa == 1.0
    assert found.pd_lower[0] <= found.pd[0] <= found.pd_upper[0]


def test_a_target_that_ties_with_the_highest_of_the_background_has_no_area_above_one():
    background = np.concatenate([[9.0], np.full(2, 5.0), np.arange(9997) / 10000])
    curve = pixels.with_areas_and_alarms(pixels.empirical_roc([5.0], background, [0.1, 1.0]), [5.0], background)
    area = curve.areas["log_auc@1e-3..1e-1"]
    assert (area.value, area.upper) == (1.0, 1.0)


@pytest.mark.parametrize(("n", "pfa"), [(1000, 0.01), (1000, 0.1), (500, 0.5), (4000, 0.003)])
def test_interval_against_the_definition_rank_by_rank(n, pfa):
    # Background 0 to n - 1 and one target above each: the count of targets above a score gives its rank.
    background, target = np.arange(float(n)), np.arange(float(n)) + 0.5
    found = pixels.empirical_roc(target, background, pfa)
    # The greatest rank r with P(fewer than r scores above the threshold) <= 2.5 %, the least s with
    # P(s or more above it) <= 2.5 %: searched from the definition.
    r = max(k for k in range(n) if stats.binom.cdf(k - 1, n, pfa) <= 0.025)
    s = min(k for k in range(1, n + 1) if stats.binom.sf(k - 1, n, pfa) <= 0.025)
    # The k-th greatest background score is n - k; k of the targets lie above it.
    pd = (int(n * pfa) + 1) / n
    low, high = mid_p_limits(int(n * pfa) + 1, n)
    assert found.pd[0] == pd
    assert found.pd_lower[0] == pytest.approx(pd - np.hypot(pd - low, pd - r / n), rel=1e-12)
    assert found.pd_upper[0] == pytest.approx(pd + np.hypot(high - pd, s / n - pd), rel=1e-12)


PART, LOG = RocArea(0.05, 0.4), RocArea(0.05, 0.4, logarithmic=True)
RANGES = [WHOLE, PART, LOG, RocArea(0.0, 0.1), RocArea(1e-3, 1.0, logarithmic=True)]


def by_quadrature(t, b, area):
    """The area by Gauss-Legendre on every straight piece of the exact curve."""
    x, y, _ = roc_points(t, b)
    node, weight = np.polynomial.legendre.leggauss(60)
    total = 0.0
    for x1, x2, y1, y2 in zip(x[:-1], x[1:], y[:-1], y[1:], strict=True):
        a, b_ = max(x1, area.low), min(x2, area.high)
        if b_ <= a:
            continue
        at = 0.5 * (a + b_) + 0.5 * (b_ - a) * node
        pd = y1 + (y2 - y1) * (at - x1) / (x2 - x1)
        total += 0.5 * (b_ - a) * float(weight @ (pd / at if area.logarithmic else pd))
    return total / (np.log(area.high / area.low) if area.logarithmic else area.high - area.low)


@pytest.mark.parametrize("area", RANGES)
@pytest.mark.parametrize("decimals", [0, 1, 6])
def test_areas_equal_the_exact_curve_with_ties(area, decimals):
    rng = np.random.default_rng(decimals)
    t, b = np.round(rng.normal(1.0, 1.0, 23), decimals), np.round(rng.normal(size=57), decimals)
    assert pixels.roc_area(pixels.rank_counts(t, b), area) == pytest.approx(by_quadrature(t, b, area), abs=1e-10)


@pytest.mark.simulation
def test_variance_of_areas_is_that_of_plain_resampling():
    # 4,000 draws know their spread to 1.1 %; the formula is of first order, with divisor m - 1 in place of m.
    rng = np.random.default_rng(1)
    t, b = np.round(rng.normal(1.5, 1.0, 30), 1), np.round(rng.normal(size=400), 1)
    areas = [WHOLE, PART, LOG]
    resampled = [pixels.rank_counts(rng.choice(t, 30), rng.choice(b, 400)) for _ in range(4000)]
    plain = np.array([[pixels.roc_area(c, a) for a in areas] for c in resampled])
    parts = np.array([pixels.area_variance(pixels.rank_counts(t, b), a) for a in areas])
    assert plain.var(axis=0) == pytest.approx(parts @ [29 / 30, 1.0], rel=0.19)


def test_one_score_on_a_side_has_the_bound_of_birnbaum_and_klose():
    # Targets' part by the bound; background's by the definition: V = 1 three times and 0 once.
    of_targets, of_background = pixels.area_variance(pixels.rank_counts([2.5], [0.0, 1.0, 2.0, 3.0]))
    assert (of_targets, of_background) == pytest.approx((0.75 * 0.25, 0.25 / 4))


def test_average_of_predicted_curves_is_by_weight():
    pfa = np.array([1e-3, 1e-2])
    parts = [RocCurve(pfa, *([np.array(v)] * 3), np.zeros(2), "pixel") for v in ([0.2, 0.4], [0.6, 1.0])]
    assert pixels.average_roc(parts, [3, 1]).pd == pytest.approx([0.3, 0.55])
    assert pixels.average_roc(parts, [3, 1]).pd_lower == pytest.approx([0.3, 0.55])


def test_pool_of_unequal_groups_by_hand():
    rng = np.random.default_rng(3)
    groups = [(rng.normal(1.0, 1.0, 40), rng.normal(size=900)), (rng.normal(0.5, 1.0, 10), rng.normal(size=400))]
    curves = [pixels.with_areas_and_alarms(pixels.empirical_roc(t, b, [0.1, 1.0]), t, b) for t, b in groups]
    pool = pixels.pooled_roc(curves)
    assert (pool.n_target, pool.n_background) == (50, 400)  # what the smaller background cannot say, the pool cannot
    assert pool.pd == pytest.approx(0.8 * curves[0].pd + 0.2 * curves[1].pd)
    # No narrower than the binomial interval of all targets.  The true P_D rises, and so do the limits.
    low, high = mid_p_limits(np.rint(50 * pool.pd).astype(int), 50)
    assert np.all((pool.pd_lower <= low) & (high <= pool.pd_upper))
    assert np.all(np.diff([pool.pd_lower, pool.pd_upper]) >= 0.0)
    each = [c.areas["auc"] for c in curves]
    # What the background brings goes together: standard deviations are added by the share of the targets.
    background = (0.8 * np.sqrt(each[0].background_variance) + 0.2 * np.sqrt(each[1].background_variance)) ** 2
    assert pool.areas["auc"].background_variance == pytest.approx(background, rel=1e-12)
    placed = np.concatenate([e.placements for e in each])
    assert min(placed.sum(), (1 - placed).sum()) > 8  # the logit interval alone
    limits = pixels.logit_interval(placed.mean(), placed.var(ddof=1) / 50 + background, 50, 400)
    assert (pool.areas["auc"].lower, pool.areas["auc"].upper) == pytest.approx(limits, rel=1e-12)


def test_logit_interval_has_student_s_quantile_of_the_smaller_sample():
    low, high = pixels.logit_interval(0.8, 0.01, 5, 2000)
    half = stats.t.ppf(0.975, 4) * 0.1 / 0.16
    assert np.log(high / (1 - high)) - np.log(4.0) == pytest.approx(half, rel=1e-9)
    assert np.log(4.0) - np.log(low / (1 - low)) == pytest.approx(half, rel=1e-9)


def test_far_limit_of_an_area_of_few_targets_holds_without_assumptions():
    # Seven of eight found before all alarms, the last before 0.9 of them: Stringer's bound, of Clopper & Pearson's
    # limits at 0.70 for 0 and 1 of 8, and beside it in quadrature what the background leaves open.
    none, one = stats.beta.ppf(0.85, [1, 2], [8, 7])
    least, value = 1.0 - none - 0.1 * (one - none), 1.0 - 0.1 / 8
    for background in (0.0, 1e-4):
        low = pixels.area_interval(np.array([0.9, *7 * [1.0]]), 1e-6, background, 1000)[0]
        assert low == pytest.approx(value - np.hypot(value - least, 1.959964 * np.sqrt(background)), rel=1e-6)


def test_an_area_whose_background_is_few_blocks_is_known_by_their_part_of_the_variance():
    rng = np.random.default_rng(4)
    scores = rng.standard_normal((4, 4)).repeat(20, 0).repeat(20, 1)
    blocks = pixels.AlarmBlocks.from_map(scores, np.ones(scores.shape, bool))
    counts = pixels.rank_counts(rng.normal(0, 1, 60), scores)
    found = pixels.area_estimates(counts, {"a": WHOLE}, "pixel", blocks)["a"]
    background, dof = pixels.clustered_variance(counts, WHOLE, blocks)
    whole = background + pixels.area_variance(counts)[0]
    # Satterthwaite: V^2 over the sum of squares over degrees of freedom, those of the targets being many.
    half = stats.t.ppf(0.975, whole**2 / (background**2 / dof)) * np.sqrt(whole) / (found.value * (1 - found.value))
    assert logit(found.upper) - logit(found.value) == pytest.approx(half, rel=1e-6)


def test_a_share_that_is_a_whole_number_of_targets_is_not_rounded_up():
    # 0.07 * 100 is 7.000000000000001 in floating point: the 7th target and not the 8th.
    (found,) = pixels.alarms_at_detection(np.arange(100.0), [-1.0, 50.0], [0.07])
    assert found.threshold == 93.0


@pytest.mark.parametrize("decimals", [0, 2, 9])
def test_areas_are_those_of_scikit_learn(decimals):
    metrics = pytest.importorskip("sklearn.metrics", reason="scikit-learn is not installed; pip install scikit-learn")
    rng = np.random.default_rng(decimals)
    for m, n in ((1, 1), (3, 700), (77, 90)):
        t, b = np.round(rng.normal(1, 1, m), decimals), np.round(rng.normal(size=n), decimals)
        y, scores = np.concatenate([np.ones(m), np.zeros(n)]), np.concatenate([t, b])
        assert pixels.roc_area(pixels.rank_counts(t, b)) == pytest.approx(metrics.roc_auc_score(y, scores), rel=1e-13)
        # Theirs of a part is scaled to 1/2 for chance (McClish 1989): back to the mean P_D over the range.
        part = metrics.roc_auc_score(y, scores, max_fpr=0.1)
        area, ours = (2 * part - 1) * (1 - 0.05) + 0.05, pixels.roc_area(pixels.rank_counts(t, b), RocArea(0.0, 0.1))
        assert 0.1 * ours == pytest.approx(0.1 * area, rel=1e-12, abs=1e-15)


# Intervals of proportions, and of alarms that come in clusters.


@given(st.integers(1, 400).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_limits_solve_the_binomial_tails(case):
    k, n = case
    low, high = (float(x) for x in model.clopper_pearson(k, n))
    assert low <= k / n <= high
    assert stats.binom.sf(k - 1, n, low) == pytest.approx(0.025, rel=1e-7) if k > 0 else low == 0.0
    assert stats.binom.cdf(k, n, high) == pytest.approx(0.025, rel=1e-7) if k < n else high == 1.0


def test_limits_of_less_than_one_independent_alarm_are_no_narrower_than_those_of_one():
    low, _ = model.clopper_pearson([0.4, 1.0], 1000)
    assert special.betainc(0.4, 1000.6, low[0]) == pytest.approx(0.025, rel=1e-7)
    assert low[0] < low[1] / 100.0


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
    held, ends = np.zeros(2), []
    for _ in range(150):
        common = rng.standard_normal((15, 15)).repeat(7, 0).repeat(7, 1)
        scores = np.sqrt(0.9) * common + np.sqrt(0.1) * rng.standard_normal(common.shape)
        blocks, t = pixels.AlarmBlocks.from_map(scores, np.ones(scores.shape, bool)), rng.normal(2.0, 1.0, 1500)
        for i, background in enumerate((blocks, scores)):
            (found,) = pixels.alarms_at_detection(t, background, [0.5])
            held[i] += found.pfa_lower <= truth <= found.pfa_upper
            ends += [np.log([found.pfa_lower, found.pfa, found.pfa_upper])] * (i == 0)
    assert held[0] >= 134, held
    assert np.mean(np.diff(ends)) * 2.0 / 3.92 < 1.3 * np.std(ends, axis=0)[1], "they are as wide as what they hold"
    assert held[1] < 115, held


def test_a_class_that_lies_in_one_block_counts_with_the_others():
    # Its blocks tell nothing of its own scatter: one roof is one piece of luck, known to be a roof or not.
    scores = np.random.default_rng(11).standard_normal((80, 80))
    roof = np.zeros((80, 80), int)
    roof[20:27, 20:27] = 1
    alone = pixels.AlarmBlocks.from_map(scores + 9.0 * roof, np.ones(roof.shape, bool), classes=roof)
    blind = pixels.AlarmBlocks.from_map(scores + 9.0 * roof, np.ones(roof.shape, bool))
    assert np.unique(alone.stratum).size == 1
    for limits in zip(alone.pfa_limits(np.array([6.0])), blind.pfa_limits(np.array([6.0])), strict=True):
        assert limits[0] == pytest.approx(limits[1], rel=0.05)  # the roof has cells of its own


def test_halves_of_an_image_differ_by_the_rates_of_their_own_pixels():
    # Of 1, 1, 3, 3 pixels 1, 0, 0, 2 are alarms, and half of every block of a class of 32 pixels, which adds 16 to
    # either half. Three ways to halve four blocks: 20 : 18 2/3, 20 : 18 and 22 : 16, each in a third of the draws.
    block = np.repeat(np.arange(8), [1, 1, 3, 3, 8, 8, 8, 8])
    scores = np.concatenate([[1.0, 0, 0, 0, 0, 1, 1, 0], np.tile([1.0, 0.0], 16)])
    blocks = pixels.AlarmBlocks.from_pixels(scores, 20 * block, 0 * block, 10, block > 3)
    assert blocks.half_image_factor(np.array([0.5])) == pytest.approx([20.0 / 18.0])
    single = pixels.AlarmBlocks.from_pixels(scores, 0 * block, 0 * block, 10)
    assert single.half_image_factor(np.array([0.5]))[0] == np.inf


def test_ranks_of_a_threshold_are_those_whose_interval_holds_the_probability():
    # 36 scores are few enough for the effect of each to be looked up: the limits themselves, one by one.
    scores = np.random.default_rng(12).normal(size=(3, 3)).repeat(2, 0).repeat(2, 1) + np.arange(36).reshape(6, 6) / 99
    blocks = pixels.AlarmBlocks.from_pixels(scores.ravel(), *np.indices((6, 6)).reshape(2, -1), 2)
    _, low, high = blocks.pfa_limits(np.append(blocks.sorted_scores[::-1], -np.inf))
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


@pytest.mark.simulation
def test_limits_of_detection_hold_the_truth_before_clusters_as_large_as_blocks():
    # 400 images of 225 clusters of 400 pixels, correlation 0.9: some 90 alarms at 1e-3 are those of two or three
    # clusters, which an image may lack.  Wanted are 0.92 or more; fewer than 352 come in 0.2 % of runs at 0.92.
    held = np.zeros(3)
    for seed in range(400):
        rng = np.random.default_rng([81, seed])
        common = rng.standard_normal((15, 15)).repeat(20, 0).repeat(20, 1)
        scores = np.sqrt(0.9) * common + np.sqrt(0.1) * rng.standard_normal(common.shape)
        blocks = pixels.AlarmBlocks.from_map(scores, np.ones(scores.shape, bool))
        for i, count in enumerate((25, 100, 300)):
            rate = pixels.empirical_roc(rng.normal(norm.isf(1e-3), 1.0, count), blocks, 1e-3)
            held[i] += rate.pd_lower[0] <= 0.5 <= rate.pd_upper[0]
    assert held.min() >= 352, held
