"""Empirical ROC and AUC against brute force, exact limits and coverage."""

import numpy as np
import pytest
from exact_forms import auc, auc_estimate, roc_points
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from hyperval.errors import UsageError
from hyperval.model import mid_p_limits
from hyperval.processing import (
    empirical_roc,
    footprint,
    footprint_maxima,
    object_scores,
    placed_with_halo,
    preset_thresholds,
    values_on,
    with_halo,
)

few_values = st.lists(st.sampled_from([-np.inf, -1.0, 0.0, 0.5, 1.0, np.inf]), min_size=1, max_size=25)


@given(few_values, few_values)
def test_every_corner_by_brute_force_with_ties_and_infinities(target, background):
    pfa, pd, score = roc_points(target, background)
    for x, y, s in zip(pfa[1:], pd[1:], score[1:], strict=True):
        assert y == np.mean([t >= s for t in target])
        assert x == np.mean([b >= s for b in background])
    assert (pfa[0], pd[0], pfa[-1], pd[-1]) == (0.0, 0.0, 1.0, 1.0)


@given(few_values, few_values, st.sampled_from([0.01, 0.1, 0.29, 0.3, 0.5, 1.0]))
def test_preset_false_alarm_rate_by_brute_force(target, background, pfa):
    found = empirical_roc(target, background, pfa)
    allowed = [
        np.mean([t > s for t in target])
        for s in {*target, *background}
        if np.mean([b > s for b in background]) <= pfa + 1e-12
    ]
    best = 1.0 if pfa == 1.0 else max(allowed)
    assert found.pd[0] == pytest.approx(best, abs=1e-15)
    assert found.alarms[0] <= pfa * len(background) + 1e-9
    low = mid_p_limits(round(found.pd[0] * len(target)), len(target))[0]
    assert found.pd_lower[0] <= low or pfa == 1.0
    assert found.pd_lower[0] <= found.pd[0] <= found.pd_upper[0]


@given(few_values, few_values)
def test_auc_is_the_mann_whitney_count(target, background):
    wins = [(t > b) + 0.5 * (t == b) for t in target for b in background]
    estimate = auc_estimate(target, background)
    assert estimate.value == pytest.approx(np.mean(wins), abs=1e-14)
    assert 0.0 <= estimate.lower <= estimate.value + 1e-12
    assert estimate.value - 1e-12 <= estimate.upper <= 1.0


def test_separated_samples_keep_an_honest_limit():
    estimate = auc_estimate(np.arange(20) + 100.0, np.arange(500.0) / 500)
    assert (estimate.value, estimate.upper) == (1.0, 1.0)
    assert estimate.lower == pytest.approx(0.025 ** (1 / 20), rel=1e-9)
    assert auc_estimate([1.0], [0.0]).lower == pytest.approx(0.025)


@pytest.mark.simulation
@pytest.mark.parametrize(("pfa", "m", "n"), [(1e-1, 200, 3000), (1e-2, 25, 1000), (1e-3, 80, 10_000)])
def test_interval_of_pd_covers_with_the_threshold_estimated(pfa, m, n):
    # Normal scores: true P_D = Phi(d - z).  600 draws: the sd of the share is 0.8 %.  Stated coverage is 0.95 to
    # 0.99; the band 0.92 to 1 (not reached) is 4 sd below 0.95 (false failure below 1e-4).
    rng = np.random.default_rng(4)
    d = 2.2
    truth = stats.norm.sf(stats.norm.isf(pfa) - d)
    covered = 0
    for _ in range(600):
        found = empirical_roc(rng.normal(d, 1, m), rng.normal(0, 1, n), pfa)
        covered += found.pd_lower[0] <= truth <= found.pd_upper[0]
    assert 0.92 < covered / 600 < 0.999


@pytest.mark.parametrize(("n", "pfa"), [(1000, 0.01), (1000, 0.1), (500, 0.5), (4000, 0.003)])
def test_interval_against_the_definition_rank_by_rank(n, pfa):
    # Background 0 to n - 1 and one target above each: the count of targets above a score gives its rank.
    background, target = np.arange(float(n)), np.arange(float(n)) + 0.5
    found = empirical_roc(target, background, pfa)
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


def test_a_background_too_small_gives_no_lower_limit():
    found = empirical_roc(np.full(50, 10.0), np.arange(100.0) / 100, [1e-3, 1e-1])
    assert found.pd.tolist() == [1.0, 1.0]
    assert found.pd_lower[0] == 0.0
    assert found.pd_lower[1] > 0.9


@given(st.integers(0, 2**31))
@settings(max_examples=20)
def test_unchanged_by_a_monotone_transform(seed):
    rng = np.random.default_rng(seed)
    t, b = rng.normal(1, 1, 15), rng.normal(0, 1, 200)
    one, two = empirical_roc(t, b), empirical_roc(np.exp(t), np.exp(b))
    for name in ("pfa", "pd", "pd_lower", "pd_upper"):
        assert np.array_equal(getattr(one, name), getattr(two, name))


def test_thresholds_of_a_background_serve_all_its_targets():
    rng = np.random.default_rng(8)
    b = rng.integers(-30, 30, 500) / 10.0
    for chosen in (None, [0.01, 0.2, 1.0]):
        thresholds = preset_thresholds(b, chosen)
        for t in (rng.normal(1, 1, 20), [-np.inf, 2.9], [3.1]):
            shared, own = empirical_roc(t, thresholds), empirical_roc(t, b, chosen)
            for name in ("pfa", "pd", "pd_lower", "pd_upper", "threshold", "alarms", "n_background"):
                assert np.array_equal(getattr(shared, name), getattr(own, name))


def test_curve_carries_its_counts_and_rises():
    rng = np.random.default_rng(6)
    curve = empirical_roc(rng.normal(2, 1, 30), rng.normal(0, 1, 4000), unit="object", background_area_km2=0.5)
    assert (curve.unit, curve.n_target, curve.n_background, curve.background_area_km2) == ("object", 30, 4000, 0.5)
    assert np.all(np.diff(curve.pfa) > 0)
    for values in (curve.pd, curve.pd_lower, curve.pd_upper):
        assert np.all(np.diff(values) >= 0)
    assert curve.pfa[-1] == 1.0
    assert any(np.isclose(curve.pfa, 1e-2, rtol=1e-12))


def test_perfect_inverted_and_constant_scores():
    assert empirical_roc([5, 6], [1, 2, 3], 0.01).pd[0] == 1.0
    assert empirical_roc([0, 0], [1, 2, 3], 0.34).pd[0] == 0.0
    constant = empirical_roc([1, 1, 1], [1, 1], [0.5, 1.0])
    assert constant.pd.tolist() == [0.0, 1.0]  # all tied: nothing can be declared without everything
    assert auc([1, 1, 1], [1, 1]) == 0.5


def test_missing_scores_are_refused_by_name():
    with pytest.raises(UsageError, match="1 of 3 target scores are NaN"):
        empirical_roc([1, np.nan, 2], [0, 1])
    with pytest.raises(UsageError, match="no target scores"):
        empirical_roc([], [0.0])
    with pytest.raises(UsageError, match="no background scores"):
        empirical_roc([1.0], [])
    with pytest.raises(UsageError, match="must lie in"):
        empirical_roc([1.0], [0.0], 0.0)


def test_objects_score_their_greatest_pixel_with_a_halo():
    scores = np.zeros((8, 9))
    scores[3, 4], scores[3, 6], scores[0, 0] = 1.0, 5.0, np.nan
    mask = np.zeros((8, 9), bool)
    mask[3, 4] = True
    corner = np.zeros((8, 9), bool)
    corner[0, 0] = True
    assert object_scores(scores, {"a": mask})["a"] == 1.0
    assert object_scores(scores, {"a": mask}, halo=1)["a"] == 1.0
    assert object_scores(scores, {"a": mask}, halo=2)["a"] == 5.0
    assert np.isnan(object_scores(scores, {"c": corner})["c"])
    assert footprint(corner, 1).shape == (3, 3)  # not cut by the edge of the image
    with pytest.raises(UsageError, match="holds no pixel"):
        object_scores(scores, {"none": np.zeros((8, 9), bool)})
    with pytest.raises(UsageError, match="shape"):
        object_scores(scores, {"a": mask[:2]})


@pytest.mark.parametrize("halo", [0, 1, 4])
def test_an_object_in_its_window_scores_as_in_the_whole_image(halo):
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(9, 12))
    for line, sample, part in ((0, 0, [[1, 0], [1, 1]]), (7, 9, [[0, 1, 1], [1, 0, 0]]), (4, 5, [[1]])):
        part = np.array(part, bool)
        mask = np.zeros(scores.shape, bool)
        mask[line : line + part.shape[0], sample : sample + part.shape[1]] = part
        placed = ((line, sample), part)
        brute = scores[with_halo(mask, halo)]
        assert sorted(values_on(scores, placed_with_halo(placed, halo, scores.shape))) == sorted(brute)
        both = object_scores(scores, {"window": placed, "mask": mask}, halo)
        assert both == {"window": brute.max(), "mask": brute.max()}


def test_footprint_maxima_by_hand_and_without_the_excluded():
    scores = np.arange(24.0).reshape(4, 6)
    assert sorted(footprint_maxima(scores, np.ones((2, 3), bool))[0]) == [8.0, 11.0, 20.0, 23.0]
    cross = np.array([[True, False], [False, False]])
    assert sorted(footprint_maxima(scores, cross)[0]) == [0, 2, 4, 12, 14, 16]
    exclude = np.zeros((4, 6), bool)
    exclude[0, 0] = True
    maxima, lines, samples = footprint_maxima(scores, np.ones((2, 3), bool), exclude)
    assert sorted(maxima) == [11.0, 20.0, 23.0]
    assert all(scores[a : a + 2, b : b + 3].max() == m for m, a, b in zip(maxima, lines, samples, strict=True))
    assert footprint_maxima(np.full((4, 4), np.nan), np.ones((2, 2), bool))[0].size == 0
    with pytest.raises(UsageError, match="does not fit"):
        footprint_maxima(scores, np.ones((5, 5), bool))


def test_noise_scored_with_the_same_halo_on_both_sides_is_not_detection():
    # Pure noise: with the halo on the targets alone the AUC looks like detection, with it on both sides
    # it is 0.5.  3000 maxima against 60: sd of the AUC 0.038, band of 4 sd (false failure 6e-5).
    rng = np.random.default_rng(7)
    scores = rng.normal(size=(300, 300))
    masks = {}
    for i in range(60):
        mask = np.zeros(scores.shape, bool)
        mask[10 + 20 * (i // 10), 10 + 20 * (i % 10)] = True
        masks[str(i)] = mask
    target = list(object_scores(scores, masks, halo=2).values())
    every = np.any(list(masks.values()), axis=0)
    assert auc(target, scores[~every]) > 0.9
    background = footprint_maxima(scores, footprint(masks["0"], 2), exclude=every)[0]
    assert abs(auc(target, background) - 0.5) < 0.152
