"""Counts by block and the metrics that follow, against brute force and against the ROC room."""

import numpy as np
import pytest
from scipy import sparse

from hyperval.model import AREAS
from hyperval.pixels import AlarmBlocks, alarms_at_detection, counts_of, empirical_roc, roc_area
from hyperval.scoreboard import LOG_AREA, MEASURES, BlockCounts, counts_by_block, measured


def one_detector(targets: np.ndarray, background: np.ndarray, block: np.ndarray) -> BlockCounts:
    blocks = int(block.max()) + 1
    alike = np.zeros(blocks, dtype=np.int64)
    over, tie = counts_by_block(targets, AlarmBlocks(background, block, sparse.eye_array(blocks), alike))
    number = np.arange(targets.size)
    return BlockCounts(("a",), over[:, None], tie[:, None], np.bincount(block), number, {"all": number})


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
    over, tie = one_detector(targets, background, block).shares()
    value = measured(MEASURES[name], over[..., None], tie[..., None], np.ones((targets.size, 1)))[0, 0]
    counts = counts_of(targets, background)
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
    block = AlarmBlocks.of_map(np.zeros((64, 64)), counted).block.reshape(64, 40)
    assert len(np.unique(block)) == pytest.approx(64, rel=0.3)
    side = int((block[0] == block[0, 0]).sum())
    assert np.all(block[:side, :side] == block[0, 0])
    assert block[side, 0] != block[0, 0]
    assert block[0, side] != block[0, 0]
