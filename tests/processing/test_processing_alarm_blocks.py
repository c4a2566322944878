"""Alarms in clusters: limits of P_FA and P_D beside those of independent pixels and closed forms."""

import numpy as np
import pytest
from scipy import stats
from scipy.stats import norm

from hyperval.model import AREAS, WHOLE, mid_p_limits
from hyperval.processing import AlarmBlocks, area_estimates, area_variance, clustered_variance, counts_of, empirical_roc


def clustered(rng: np.random.Generator, side: int, tile: int, correlation: float) -> np.ndarray:
    """Standard normal scores (side, side) in square clusters."""
    common = rng.standard_normal((-(-side // tile),) * 2).repeat(tile, 0).repeat(tile, 1)[:side, :side]
    return np.sqrt(correlation) * common + np.sqrt(1.0 - correlation) * rng.standard_normal((side, side))


def test_counts_by_block_are_those_of_the_pixels():
    rng = np.random.default_rng(1)
    scores = rng.standard_normal((20, 30))
    scores[3, 4] = np.nan
    counted = rng.random((20, 30)) < 0.8
    blocks = AlarmBlocks.of_map(scores, counted, side=5)
    threshold = np.array([1.0, 0.5, -np.inf])
    counts = blocks.counts(threshold)
    inside = counted & np.isfinite(scores)
    for t, row in zip(threshold, counts, strict=True):
        tiles = [(scores[a : a + 5, b : b + 5] > t)[inside[a : a + 5, b : b + 5]].sum()
                 for a in range(0, 20, 5) for b in range(0, 30, 5)]  # fmt: skip
        assert row.tolist() == tiles
    assert blocks.pixels.sum() == inside.sum() == blocks.scores.size


def test_the_weights_of_neighbours_are_those_of_overlapping_squares():
    # Bartlett's weights are those of all squares of 2 x 2 blocks: sum_ij w_ij e_i e_j = sum_s (e_s)^2 / 4.
    rng = np.random.default_rng(2)
    blocks = AlarmBlocks.of_map(np.zeros((12, 20)), np.ones((12, 20), bool), side=4)
    e = rng.standard_normal((3, 5))
    padded = np.pad(e, 1)
    squares = padded[:-1, :-1] + padded[1:, :-1] + padded[:-1, 1:] + padded[1:, 1:]
    assert e.ravel() @ (blocks.neighbours @ e.ravel()) == pytest.approx(np.sum(squares**2) / 4.0)


def test_degrees_of_freedom_are_those_of_the_scatter_of_the_variance():
    # A variance with f degrees of freedom scatters by sqrt(2/f); 2,000 draws know that to 3 %.  Each draw tells its
    # own f, of blocks with a normal scatter and of those of which one in ten has any.
    blocks = AlarmBlocks.of_map(np.zeros((80, 80)), np.ones((80, 80), bool), side=4)
    rng = np.random.default_rng(9)
    for struck, least in ((1.0, 150.0), (0.1, 20.0)):
        e = rng.standard_normal((2000, 400)) * (rng.random((2000, 400)) < struck)
        variance, dof = blocks.variance_of_sum(e)
        assert np.mean(variance) == pytest.approx(400.0 * struck, rel=0.1)
        together = np.sum(e * (blocks.neighbours @ e.T).T, axis=1)
        scatter = 2.0 / (np.std(together) / np.mean(together)) ** 2
        assert least < scatter < 1.4 * np.median(dof)
        assert np.median(dof) < 1.4 * scatter


def test_one_alarm_in_every_block_is_as_independent_pixels_are():
    # Alarms spread evenly have no scatter between blocks: the design effect is 1.
    scores = np.zeros((40, 40))
    scores[2::5, 2::5] = 1.0
    blocks = AlarmBlocks.of_map(scores, np.ones((40, 40), bool), side=5)
    k, low, high = blocks.pfa_limits(np.array([0.5]))
    assert k.tolist() == [64]
    assert (low[0], high[0]) == pytest.approx(stats.beta.ppf([0.025, 0.975], 64.5, 1536.5))


@pytest.mark.simulation
@pytest.mark.parametrize(
    ("side", "targets", "pfa"), [(105, 80, 1e-2), (105, 300, 1e-2), (210, 300, 1e-2), (105, 100, 1e-3)]
)
def test_pd_holds_the_truth_where_the_background_comes_in_clusters(side, targets, pfa):
    # Clusters of 49 pixels, correlation 0.9; 150 worlds.  True coverage 0.95 to 0.98: fewer than 134 covered less
    # than once in 400 runs at 0.94.  Taken as independent, 0.6 to 0.8 are.  At 1e-3 eleven alarms lie in some four
    # clusters; without what so few leave open of their own scatter 0.80 held.
    rng = np.random.default_rng([5, side, targets])
    separation = norm.isf(pfa) - norm.isf(1e-2) + 2.0
    truth = norm.sf(norm.isf(pfa) - separation)
    covered, independent = 0, 0
    for _ in range(150):
        scores = clustered(rng, side, 7, 0.9)
        t = rng.normal(separation, 1.0, targets)
        blocks = AlarmBlocks.of_map(scores, np.ones(scores.shape, bool))
        known = empirical_roc(t, blocks, pfa)
        unknown = empirical_roc(t, blocks.scores, pfa)
        covered += known.pd_lower[0] <= truth <= known.pd_upper[0]
        independent += unknown.pd_lower[0] <= truth <= unknown.pd_upper[0]
        assert known.pd_lower[0] <= unknown.pd_lower[0] <= unknown.pd_upper[0] <= known.pd_upper[0]
    assert covered >= 134
    assert independent < 130


def test_the_layout_of_classes_leaves_detection_its_interval():
    # Half of the image 2.5 standard deviations above the other: P_D of 100 targets at 1e-3.  The threshold adds a
    # tenth to the binomial's width, as in one class; blocks that take the layout for chance make it twice as wide.
    rng = np.random.default_rng(10)
    upper = np.indices((210, 210))[0] < 105
    with_classes, without = [], []
    for _ in range(6):
        scores = rng.standard_normal(upper.shape) + 2.5 * upper
        t = rng.normal(norm.isf(2e-3) + 2.5, 1.0, 100)
        for classes, widths in ((upper, with_classes), (None, without)):
            blocks = AlarmBlocks.of_map(scores, np.ones(scores.shape, bool), classes=classes)
            rate = empirical_roc(t, blocks, 1e-3)
            low, high = mid_p_limits(round(100 * rate.pd[0]), 100)
            widths.append((rate.pd_upper - rate.pd_lower)[0] / (high - low))
    assert np.median(with_classes) < 1.3
    assert np.median(without) > 1.6


def test_a_class_that_lies_in_one_block_counts_with_the_others():
    # Its blocks tell nothing of its own scatter: one roof is one piece of luck, known to be a roof or not.
    scores = np.random.default_rng(11).standard_normal((80, 80))
    roof = np.zeros((80, 80), int)
    roof[20:27, 20:27] = 1
    alone = AlarmBlocks.of_map(scores + 9.0 * roof, np.ones(roof.shape, bool), classes=roof)
    blind = AlarmBlocks.of_map(scores + 9.0 * roof, np.ones(roof.shape, bool))
    assert np.unique(alone.stratum).size == 1
    for limits in zip(alone.pfa_limits(np.array([6.0])), blind.pfa_limits(np.array([6.0])), strict=True):
        assert limits[0] == pytest.approx(limits[1], rel=0.05)  # the roof has cells of its own


def test_independent_pixels_keep_their_interval():
    rng = np.random.default_rng(6)
    ratio = []
    for _ in range(40):
        scores, t = rng.standard_normal((105, 105)), rng.normal(2.0, 1.0, 100)
        blocks = AlarmBlocks.of_map(scores, np.ones(scores.shape, bool))
        known, unknown = empirical_roc(t, blocks, 1e-2), empirical_roc(t, blocks.scores, 1e-2)
        ratio.append((known.pd_upper - known.pd_lower)[0] / (unknown.pd_upper - unknown.pd_lower)[0])
    assert 1.0 <= np.median(ratio) < 1.1


@pytest.mark.simulation
def test_areas_hold_the_truth_where_the_background_comes_in_clusters():
    # AUC of normal scores 1.5 apart: Phi(1.5/sqrt 2).  150 worlds, limits as above.
    rng = np.random.default_rng(7)
    truth = norm.cdf(1.5 / np.sqrt(2.0))
    covered, independent = 0, 0
    for _ in range(150):
        scores, t = clustered(rng, 105, 7, 0.9), rng.normal(1.5, 1.0, 1500)
        blocks = AlarmBlocks.of_map(scores, np.ones(scores.shape, bool))
        counts = counts_of(t, blocks.scores)
        known, unknown = (area_estimates(counts, {"auc": WHOLE}, "pixel", 0, rng, b)["auc"] for b in (blocks, None))
        covered += known.lower <= truth <= known.upper
        independent += unknown.lower <= truth <= unknown.upper
    assert covered >= 134
    assert independent < 115


def test_variance_of_an_area_is_that_of_its_parts_by_block():
    # Independent pixels: the blocks' estimate scatters about DeLong's, 64 blocks by 1/sqrt 32 each.
    rng = np.random.default_rng(8)
    area, ratio = AREAS["partial_auc@0..1e-1"], []
    for _ in range(60):
        scores = np.round(rng.standard_normal((80, 80)), 1)  # with ties
        blocks = AlarmBlocks.of_map(scores, np.ones(scores.shape, bool))
        counts = counts_of(np.round(rng.normal(1.0, 1.0, 60), 1), blocks.scores)
        ratio.append(clustered_variance(counts, area, blocks)[0] / area_variance(counts, area)[1])
    # The mean of the greater of two estimates lies above 1; 60 of them know it to 0.03.
    assert 1.0 < np.mean(ratio) < 1.3


def test_halves_of_an_image_differ_by_the_rates_of_their_own_pixels():
    # Of 1, 1, 3, 3 pixels 1, 0, 0, 2 are alarms, and half of every block of a class of 32 pixels, which adds 16 to
    # either half. Three ways to halve four blocks: 20 : 18 2/3, 20 : 18 and 22 : 16, each in a third of the draws.
    block = np.repeat(np.arange(8), [1, 1, 3, 3, 8, 8, 8, 8])
    scores = np.concatenate([[1.0, 0, 0, 0, 0, 1, 1, 0], np.tile([1.0, 0.0], 16)])
    blocks = AlarmBlocks.of_places(scores, 20 * block, 0 * block, 10, block > 3)
    assert blocks.half_image_factor(np.array([0.5])) == pytest.approx([20.0 / 18.0])
    single = AlarmBlocks.of_places(scores, 0 * block, 0 * block, 10)
    assert single.half_image_factor(np.array([0.5]))[0] == np.inf


def test_ranks_of_a_threshold_are_those_whose_interval_holds_the_probability():
    # 36 scores are few enough for the effect of each to be looked up: the limits themselves, one by one.
    scores = np.random.default_rng(12).normal(size=(3, 3)).repeat(2, 0).repeat(2, 1) + np.arange(36).reshape(6, 6) / 99
    blocks = AlarmBlocks.of_map(scores, np.ones((6, 6), bool), side=2)
    _, low, high = blocks.pfa_limits(np.append(blocks.ascending[::-1], -np.inf))
    pfa = np.array([0.1, 0.3, 0.85, 0.95])
    holds = (low <= pfa[:, None]) & (pfa[:, None] <= high)
    r, s = blocks.rank_limits(pfa)
    assert r.tolist() == holds.argmax(axis=1).tolist()
    assert s.tolist() == [37 - int(row[::-1].argmax()) for row in holds]


def test_a_threshold_that_no_background_score_bounds_from_below_leaves_every_target_open():
    """At 0.9 of ten scores the true threshold may lie below them all, and below targets that lie there too."""
    rate = empirical_roc([-5.0, -5.0, -5.0], np.arange(10.0), [0.5, 0.9])
    assert rate.pd.tolist() == [0.0, 0.0]
    assert rate.pd_upper[1] == 1.0
    assert rate.pd_upper[0] == mid_p_limits(0, 3)[1] < 1.0
