"""Pooled curves and sums over footprints."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import mid_p_limits
from hyperval.processing import empirical_roc, footprint_sums, pooled_roc


def test_a_pool_counts_the_targets_of_all_curves_at_one_false_alarm_rate():
    rng = np.random.default_rng(6)
    background = rng.standard_normal(1000)
    a = empirical_roc(rng.standard_normal(7) + 3.0, background, unit="object")
    b = empirical_roc(rng.standard_normal(13) + 1.0, background, unit="object")
    pool = pooled_roc([a, b])
    assert pool.n_target == 20
    assert np.allclose(pool.pd, (7 * a.pd + 13 * b.pd) / 20)
    low, high = mid_p_limits(np.rint(20 * pool.pd).astype(int), 20)
    # Each curve's own interval is the binomial one and what its threshold adds in quadrature.
    parts = []
    for curve, n in ((a, 7), (b, 13)):
        own = mid_p_limits(np.rint(n * curve.pd), n)
        sides = ((curve.pd - curve.pd_lower, curve.pd - own[0]), (curve.pd_upper - curve.pd, own[1] - curve.pd))
        parts.append([n / 20 * np.sqrt(np.maximum(w**2 - p**2, 0)) for w, p in sides])
    below, above = np.sum(parts, axis=0)
    assert below.max() > 0.02
    lower = np.maximum(pool.pd - np.hypot(pool.pd - low, below), 0.0)
    upper = np.minimum(pool.pd + np.hypot(high - pool.pd, above), 1.0)
    # The true P_D rises, and so do the limits: each is the widest one from there on.
    assert np.diff(lower).min() < -0.005
    assert np.allclose(pool.pd_lower, [lower[i:].min() for i in range(lower.size)])
    assert np.allclose(pool.pd_upper, [upper[: i + 1].max() for i in range(upper.size)])


def test_a_pool_of_different_counts_is_refused():
    background = np.arange(100.0)
    pixel = empirical_roc([1.0], background, unit="pixel")
    by_object = empirical_roc([1.0], background, unit="object")
    with pytest.raises(UsageError, match="same thing"):
        pooled_roc([pixel, by_object])
    with pytest.raises(UsageError, match="no curve"):
        pooled_roc([])


def test_footprint_sums_tile_the_background_and_leave_out_what_is_excluded():
    scores = np.arange(36.0).reshape(6, 6)
    shape = np.array([[True, True], [True, False]])
    exclude = np.zeros((6, 6), bool)
    exclude[0, 0] = True
    sums = footprint_sums(scores, shape, exclude)
    every = [scores[r, c] + scores[r, c + 1] + scores[r + 1, c] for r in (0, 2, 4) for c in (0, 2, 4)]
    assert sums.tolist() == every[1:]


def test_the_spread_of_footprint_sums_is_that_of_independent_noise():
    # 2,500 sums of 4 unit normals: their variance is 4; six standard errors are a false failure in 5e8.
    sums = footprint_sums(np.random.default_rng(5).standard_normal((100, 100)), np.ones((2, 2), bool))
    assert sums.size == 2500
    assert abs(np.var(sums, ddof=1) - 4.0) < 6 * 4.0 * np.sqrt(2 / 2499)
