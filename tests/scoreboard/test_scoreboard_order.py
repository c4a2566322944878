"""Ranks of detectors, and the shares of the background that they are drawn from."""

import numpy as np
import pytest
from scipy import sparse

from hyperval.model import AREAS
from hyperval.pixels import AlarmBlocks, alarms_at_detection, empirical_roc, rank_counts, roc_area
from hyperval.scoreboard import LOG_AREA, MEASURES, BlockCounts, counts_by_block, draw_metric, rank_detectors, rank_sets

# Ranks with their confidence sets: closed forms, limits, and coverage by Monte Carlo.


def background_of(scores: np.ndarray, block: np.ndarray) -> AlarmBlocks:
    blocks = int(block.max()) + 1
    return AlarmBlocks(scores, block, sparse.eye_array(blocks), np.zeros(blocks, dtype=np.int64))


def counts_of_detectors(shift: list[float], objects: int, rng, pixels: int = 2000) -> BlockCounts:
    """Detectors that see the same objects and pixels, each with noise of its own on top."""
    block = np.repeat(np.arange(20), pixels // 20)
    common_t, common_b = rng.normal(size=objects), rng.normal(size=pixels)
    pairs = []
    for s in shift:
        t = s + common_t + 0.5 * rng.normal(size=objects)
        pairs.append(counts_by_block(t, background_of(common_b + 0.5 * rng.normal(size=pixels), block)))
    over, tie = (np.stack([p[i] for p in pairs], axis=1) for i in (0, 1))
    names = tuple(f"d{i}" for i in range(len(shift)))
    return BlockCounts(names, over, tie, np.bincount(block), np.arange(objects), {})


def test_two_detectors_by_the_normal_law():
    """Of two, c is the normal 97.5 % point of the difference: told apart from 1.96 standard deviations on."""
    rng = np.random.default_rng(1)
    draws = np.stack([rng.normal(size=200_000), np.zeros(200_000)])
    for gap, upper in ((1.90, 2), (2.02, 1)):
        low, high = rank_sets(np.array([gap, 0.0]), draws + np.array([[gap], [0.0]]), 100_000)
        assert (low[0], high[0]) == (1, upper)


def test_pairing_tells_apart_what_separate_intervals_do_not():
    counts = counts_of_detectors([1.0, 1.2], 200, np.random.default_rng(5))
    found = rank_detectors(counts, list(range(200)), MEASURES["auc"], draws=400, rng=np.random.default_rng(0))
    assert found.lower[1] < found.upper[0]  # the intervals overlap
    assert found.rank.tolist() == [2, 1]
    assert found.rank_lower[0] == 2
    assert found.first[1] > 0.99


def test_few_objects_order_nothing():
    counts = counts_of_detectors([0.0, 4.0], 5, np.random.default_rng(2))
    found = rank_detectors(counts, list(range(5)), MEASURES["auc"], draws=200, rng=np.random.default_rng(0))
    assert not found.orders
    assert found.rank.tolist() == [2, 1]
    assert found.rank_lower.tolist() == [1, 1]
    assert found.rank_upper.tolist() == [2, 2]


def test_detectors_that_order_alike_share_their_rank():
    one = counts_of_detectors([1.0, 1.0], 30, np.random.default_rng(4))
    over, tie = (np.concatenate([x, x[:, :1]], axis=1) for x in (one.over, one.tie))
    counts = BlockCounts(("a", "b", "a again"), over, tie, one.pixels, one.item, {})
    found = rank_detectors(counts, list(range(30)), MEASURES["auc"], draws=200, rng=np.random.default_rng(0))
    assert found.distinct == 2
    assert found.rank[0] == found.rank[2]
    assert found.first[0] == found.first[2]
    assert (found.rank_lower[0], found.rank_upper[0]) == (found.rank_lower[2], found.rank_upper[2])


def test_false_alarms_keep_an_upper_limit_where_there_are_none():
    counts = counts_of_detectors([20.0, 20.0], 20, np.random.default_rng(4))
    found = rank_detectors(counts, list(range(20)), MEASURES["far@pd0.5"], draws=100, rng=np.random.default_rng(0))
    assert found.value.tolist() == [0.0, 0.0]
    assert np.all(found.upper >= 1.0 - 0.05 ** (1.0 / 2000.0))


def test_true_ranks_lie_in_their_sets_95_times_in_100():
    """Equal detectors: every rank from 1 to 3 is true of each, and a set that leaves any out is an error.

    400 collections of three equal detectors; errors at the nominal 5 % are binomial with mean 20, and more than 35
    come once in 1500 runs of a right rule.
    """
    wrong = 0
    for trial in range(400):
        counts = counts_of_detectors([1.0, 1.0, 1.0], 40, np.random.default_rng(100 + trial), pixels=1000)
        found = rank_detectors(counts, list(range(40)), MEASURES["auc"], draws=150, rng=np.random.default_rng(trial))
        wrong += int(found.rank_lower[0] > 1 or found.rank_upper[0] < 3)
    assert wrong <= 35


@pytest.mark.parametrize("name", ["auc", "pd@1e-2"])
def test_the_interval_holds_the_value_and_narrows_with_objects(name):
    widths = []
    for objects in (20, 320):
        counts = counts_of_detectors([1.5, 1.5], objects, np.random.default_rng(9))
        found = rank_detectors(counts, list(range(objects)), MEASURES[name], draws=200, rng=np.random.default_rng(0))
        assert np.all((found.lower <= found.value) & (found.value <= found.upper))
        widths.append(float(found.upper[0] - found.lower[0]))
    assert widths[1] < 0.5 * widths[0]


# Counts by block and the metrics that follow, against brute force and against the ROC room.


def one_detector(targets: np.ndarray, background: np.ndarray, block: np.ndarray) -> BlockCounts:
    over, tie = counts_by_block(targets, background_of(background, block))
    return BlockCounts(("a",), over[:, None], tie[:, None], np.bincount(block), np.arange(targets.size), {})


@pytest.fixture
def scores():
    rng = np.random.default_rng(3)
    background = np.round(rng.normal(size=3000), 2)  # rounded: many ties
    targets = np.round(rng.normal(1.5, 1.0, size=40), 2)
    return targets, background, rng.integers(7, size=3000)


def test_drawn_shares_are_those_of_a_background_made_of_the_drawn_blocks(scores):
    targets, background, block = scores
    counts = one_detector(targets, background, block)
    weights = np.array([0.0, 2, 1, 0, 3, 1, 0])
    over, tie = counts.shares(weights[:, None])
    made = np.concatenate([np.repeat(background[block == k], int(w)) for k, w in enumerate(weights)])
    assert over[:, 0, 0] == pytest.approx((made[None] > targets[:, None]).mean(axis=1), abs=1e-12)
    assert tie[:, 0, 0] == pytest.approx((made[None] == targets[:, None]).mean(axis=1), abs=1e-12)


@pytest.mark.parametrize("name", list(MEASURES))
def test_metrics_are_those_of_the_roc(scores, name):
    targets, background, block = scores
    shares = one_detector(targets, background, block).shares(np.ones((7, 1)))
    value = draw_metric(MEASURES[name], *shares, np.ones((targets.size, 1)))[0, 0]
    counts = rank_counts(targets, background)
    expected = {
        "auc": lambda: roc_area(counts),
        LOG_AREA: lambda: roc_area(counts, AREAS[LOG_AREA]),
        "pd@1e-2": lambda: empirical_roc(targets, background, 1e-2).pd[0],
        "pd@1e-3": lambda: empirical_roc(targets, background, 1e-3).pd[0],
        "far@pd0.5": lambda: next(a.pfa for a in alarms_at_detection(targets, background) if a.pd == 0.5),
    }[name]()
    assert value == pytest.approx(expected, abs=1e-12)


def test_blocks_are_squares_of_the_image():
    counted = np.ones((64, 64), bool)
    counted[:, 40:] = False
    block = AlarmBlocks.from_map(np.zeros((64, 64)), counted).block.reshape(64, 40)
    assert len(np.unique(block)) == pytest.approx(64, rel=0.3)
    side = int((block[0] == block[0, 0]).sum())
    assert np.all(block[:side, :side] == block[0, 0])
    assert block[side, 0] != block[0, 0]
    assert block[0, side] != block[0, 0]
