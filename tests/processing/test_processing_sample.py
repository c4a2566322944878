"""Rank, condition and shrinkage of a sample of pixels."""

import numpy as np
import pytest

from hyperval.data import statistics_of
from hyperval.errors import UsageError


def test_equal_to_numpy_and_exact_on_a_bright_flat_scene():
    x = np.random.default_rng(0).integers(-3, 4, size=(500, 6)).astype(float)
    found = statistics_of(x + 1e8, left_out=3)
    assert found.mean - 1e8 == pytest.approx(x.mean(axis=0), abs=1e-7)  # what 1e8 leaves of the digits
    assert found.covariance == pytest.approx(np.cov(x.T), rel=1e-12, abs=1e-12)
    assert (found.n, found.n_left_out) == (500, 3)
    for bad in (x[:1], x[0], np.full((4, 2), np.nan)):
        with pytest.raises(UsageError, match="two or more finite pixels"):
            statistics_of(bad)


def test_rank_of_few_and_of_many_pixels():
    rng = np.random.default_rng(2)
    few = statistics_of(rng.normal(size=(5, 12)))
    assert few.rank == 4
    assert np.linalg.eigvalsh(few.shrunk_covariance)[0] > 0
    many = statistics_of(rng.normal(size=(4000, 3)) * [1.0, 2.0, 10.0])
    assert many.rank == 3


def test_shrinkage_equals_the_definition():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(60, 10)) * np.linspace(1, 3, 10) + 50.0
    z = x - x.mean(axis=0)
    s = z.T @ z / 60
    mu = np.trace(s) / 10
    d2 = np.sum((s - mu * np.eye(10)) ** 2)
    b2 = min(d2, sum(np.sum((np.outer(v, v) - s) ** 2) for v in z) / 60**2)
    assert statistics_of(x).shrinkage == pytest.approx(b2 / d2, rel=1e-10)


def test_shrinkage_is_near_the_best_possible():
    # Monte Carlo: the mean squared error of the shrunk covariance against every fixed intensity. 300 draws of
    # n = 40, B = 20; the loss of not knowing the best intensity is stated as vanishing, here below 5 %.
    rng = np.random.default_rng(4)
    truth = np.diag(np.linspace(0.5, 2.0, 20))
    grid = np.linspace(0, 1, 21)
    ours, plain, fixed = 0.0, 0.0, np.zeros(21)
    for _ in range(300):
        found = statistics_of(rng.normal(size=(40, 20)) @ np.sqrt(truth))
        s = found.covariance
        target = np.trace(s) / 20 * np.eye(20)
        ours += np.sum((found.shrunk_covariance - truth) ** 2)
        plain += np.sum((s - truth) ** 2)
        fixed += [np.sum(((1 - a) * s + a * target - truth) ** 2) for a in grid]
    assert ours < 1.05 * fixed.min()
    assert ours < 0.5 * plain


def test_many_pixels_are_hardly_shrunk():
    rng = np.random.default_rng(5)
    assert statistics_of(rng.normal(size=(20000, 4)) * [1, 2, 3, 4]).shrinkage < 0.01
