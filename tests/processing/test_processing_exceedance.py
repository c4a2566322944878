"""Exceedance curves of the background and their intervals by blocks."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import norm

from hyperval.errors import UsageError
from hyperval.processing import AlarmBlocks, block_side, exceedance_curve
from hyperval.processing.alarm_blocks import exceedance_at


def test_counts_are_those_of_the_pixels():
    rng = np.random.default_rng(1)
    scores = rng.standard_normal((40, 50))
    scores[0, :5] = np.nan
    counted = np.ones((40, 50), bool)
    counted[:, 45:] = False
    curve = exceedance_curve(AlarmBlocks.of_map(scores, counted))
    values = scores[counted & np.isfinite(scores)]
    assert curve.n == values.size == 1795
    for t, p in zip(curve.threshold, curve.probability, strict=True):
        assert p == np.mean(values > t)
    assert np.all(np.diff(curve.probability) < 0)
    assert curve.probability[-1] * curve.n <= 5
    # A tenth: the order statistic that lets 179 through.
    at = np.argmin(np.abs(curve.probability - 0.1))
    assert curve.probability[at] * curve.n == 179


def test_equal_scores_pass_together():
    scores = np.repeat([[0.0, 1.0]], 30, axis=0)
    curve = exceedance_curve(AlarmBlocks.of_map(scores, np.ones((30, 2), bool)))
    assert curve.threshold.tolist() == [0.0, 1.0] or curve.threshold.tolist() == [1.0]
    assert set(curve.probability.tolist()) <= {0.5, 0.0}


def test_log_linear_between_points():
    curve = exceedance_curve(AlarmBlocks.of_map(np.random.default_rng(2).exponential(size=(60, 60)), np.ones((60, 60))))
    x, p = curve.threshold, curve.probability
    assert exceedance_at(curve, float(x[3])) == pytest.approx(p[3])
    assert exceedance_at(curve, 0.5 * (x[3] + x[4])) == pytest.approx(np.sqrt(p[3] * p[4]))
    assert exceedance_at(curve, 1e3) == pytest.approx(p[p > 0][-1])


@pytest.mark.simulation
@pytest.mark.parametrize(("blur", "level", "least"), [(0.0, 1e-1, 0.9), (2.0, 1e-1, 0.85), (2.0, 1e-2, 0.85)])
def test_the_interval_covers_clustered_alarms(blur, level, least):
    # 150 images: the sd of a coverage of 0.93 is 0.02; limits 4 sd below it.
    rng = np.random.default_rng(3)
    hits, binomial = 0, 0
    kernel = gaussian_filter(np.pad(np.ones((1, 1)), 20), blur) if blur else np.ones((1, 1))
    for _ in range(150):
        image = rng.standard_normal((90, 120))
        if blur:
            image = gaussian_filter(image, blur, mode="wrap") / np.sqrt((kernel**2).sum())
        curve = exceedance_curve(AlarmBlocks.of_map(image, np.ones(image.shape, bool)))
        at = int(np.argmin(np.abs(np.log(np.maximum(curve.probability, 1e-9) / level))))
        true, p = norm.sf(curve.threshold[at]), curve.probability[at]
        hits += curve.lower[at] <= true <= curve.upper[at]
        binomial += abs(p - true) <= 1.96 * np.sqrt(p * (1 - p) / curve.n)
    assert least <= hits / 150
    if blur:  # counted as independent pixels the interval misses more often than it should
        assert binomial / 150 < 0.75


def test_blocks():
    assert block_side(64 * 100) == 10
    assert block_side(30) == 4
    with pytest.raises(UsageError, match="too few"):
        exceedance_curve(AlarmBlocks.of_map(np.zeros((4, 4)), np.ones((4, 4), bool)))
