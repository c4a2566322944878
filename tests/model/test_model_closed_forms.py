"""Numbers that the other tests leave free: each against a closed form, a definition in plain loops, or draws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.errors import UsageError
from hyperval.model import (
    PositiveDefinite,
    darkest_level,
    object_detection_probability,
)


def test_the_darkest_of_many_pixels_is_a_median():
    # 4,001 scenes of 50 pixels: a share of one half is known to 0.008, 4.5 of which are allowed.
    rng = np.random.default_rng(0)
    level = darkest_level([0.3, 0.7], [[1.0], [2.0]], [[0.2], [0.5]], 50)[0]
    dark = rng.random((4001, 50)) < 0.3
    least = np.where(dark, rng.normal(1.0, 0.2, dark.shape), rng.normal(2.0, 0.5, dark.shape)).min(axis=1)
    assert np.mean(least < level) == pytest.approx(0.5, abs=0.036)
    alone = darkest_level([1.0], [[3.0]], [[0.4]], 9)[0]
    assert alone == pytest.approx(3.0 + 0.4 * stats.norm.ppf(1 - 0.5 ** (1 / 9)), abs=1e-12)


def with_eigenvalues(values):
    """A correlation-like matrix with these eigenvalues along orthonormal directions."""
    n = len(values)
    q = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))[0]
    return q @ np.diag(values) @ q.T


def test_condition_is_that_of_the_matrix_at_unit_diagonal():
    covariance = with_eigenvalues(np.geomspace(1.0, 1e-6, 9)) * np.outer(np.arange(1, 10), np.arange(1, 10))
    sd = np.sqrt(np.diag(covariance))
    assert PositiveDefinite(covariance).condition == pytest.approx(
        np.linalg.cond(covariance / np.outer(sd, sd), 1), rel=0.3
    )


def test_a_small_eigenvalue_counts_for_the_rank_and_a_lost_one_does_not():
    values = np.ones(12)
    values[0], values[1] = 1e-10, 0.0
    with pytest.raises(UsageError, match="rank 11 of 12"):
        PositiveDefinite(with_eigenvalues(values))


def test_an_object_is_missed_where_all_its_pixels_are():
    means, sds = np.array([[0.5, 0.2, -0.1], [0.3, 0.3, 0.3]]), np.array([[0.2, 0.4, 0.3], [0.1, 0.1, 0.1]])
    x = 0.35
    missed = [
        np.prod([stats.norm.cdf(x, m, s) for m, s in zip(at, spread, strict=True)])
        for at, spread in zip(means, sds, strict=True)
    ]
    assert object_detection_probability(np.array([[x]]), means[None], sds[None])[0, 0] == pytest.approx(
        1 - np.mean(missed), rel=1e-12
    )
