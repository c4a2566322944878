"""Fully constrained unmixing: against a general solver, every support in turn, and its error against samples."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from exact_forms import abundance_covariance, sum_to_one_gain
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.model import PositiveDefinite, fully_constrained

B = 12


def endmembers(m, rng):
    return np.abs(rng.normal(0.3, 0.15, (m, B)))


def noise_matrix(rng):
    a = rng.normal(size=(B, B))
    return 1e-4 * (a @ a.T + B * np.eye(B))


def by_every_support(x, e, weight):
    """The best of all supports: least squares with sum 1 on each, kept where no abundance is negative."""
    best, at = np.inf, np.zeros(len(e))
    for size in range(1, len(e) + 1):
        for chosen in combinations(range(len(e)), size):
            part = e[list(chosen)]
            normal = np.block([[part @ weight @ part.T, np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
            a = np.linalg.solve(normal, np.append(part @ weight @ x, 1.0))[:-1]
            rest = x - a @ part
            value = rest @ weight @ rest
            if a.min() > -1e-12 and value < best:
                best, at = value, np.zeros(len(e))
                at[list(chosen)] = a
    return at


@given(st.integers(2, 4), st.integers(0, 10_000), st.booleans())
@settings(max_examples=60)
def test_equals_the_best_of_all_supports(m, seed, weighted):
    rng = np.random.default_rng(seed)
    e, x = endmembers(m, rng), rng.normal(0.3, 0.2, B)
    cov = noise_matrix(rng)
    weight = np.linalg.inv(cov) if weighted else np.eye(B)
    found = fully_constrained(x, e, PositiveDefinite(cov) if weighted else None)
    assert found.sum() == pytest.approx(1.0, abs=1e-12)
    assert found.min() >= 0.0
    assert found == pytest.approx(by_every_support(x, e, weight), abs=1e-8)


def test_each_spectrum_may_have_endmembers_of_its_own():
    rng = np.random.default_rng(6)
    e, x = np.stack([endmembers(2, rng) for _ in range(5)]), rng.normal(0.3, 0.2, (5, B))
    one_by_one = [fully_constrained(pixel, own) for pixel, own in zip(x, e, strict=True)]
    assert fully_constrained(x, e) == pytest.approx(np.array(one_by_one), abs=1e-12)
    noise = PositiveDefinite(noise_matrix(rng))
    many = fully_constrained(np.stack([x, x]), e[None], noise)
    assert many[1] == pytest.approx(fully_constrained(x, e, noise), abs=1e-12)


@pytest.mark.parametrize("weighted", [False, True])
def test_error_covariance_is_that_of_pixels(weighted):
    rng = np.random.default_rng(7)
    e, cov = endmembers(3, rng), 0.05 * noise_matrix(rng)
    noise = PositiveDefinite(cov) if weighted else None
    truth = np.array([0.4, 0.35, 0.25])
    x = truth @ e + rng.multivariate_normal(np.zeros(B), cov, 20_000)
    a = fully_constrained(x[:4000], e, noise)
    assert a.min() > 0.01  # no constraint but the sum binds
    expected = abundance_covariance(e, cov, noise)
    # A variance of 4000 pixels is known to 2.2 %: four of these.
    assert np.cov(a.T) == pytest.approx(expected, abs=0.09 * np.abs(expected).max())
    assert expected.sum() == pytest.approx(0.0, abs=1e-12)  # the sum has no error
    linear = truth @ np.eye(3) + (x - truth @ e) @ sum_to_one_gain(e, noise).T
    assert linear[:4000] == pytest.approx(a, abs=1e-7)


def test_weighted_error_is_the_constrained_information_matrix():
    # (E C^-1 E^T)^-1 with the sum held: F^-1 - F^-1 1 1^T F^-1 / (1^T F^-1 1); no other weights do better.
    rng = np.random.default_rng(8)
    e, cov = endmembers(3, rng), noise_matrix(rng)
    f = np.linalg.inv(e @ np.linalg.inv(cov) @ e.T)
    expected = f - np.outer(f.sum(axis=1), f.sum(axis=0)) / f.sum()
    best = abundance_covariance(e, cov, PositiveDefinite(cov))
    assert best == pytest.approx(expected, rel=1e-8)
    assert np.all(np.diag(abundance_covariance(e, cov)) >= np.diag(best) * (1 - 1e-12))


def test_refusals():
    with pytest.raises(UsageError, match="same bands"):
        fully_constrained(np.ones(3), np.ones((2, 4)))
    with pytest.raises(UsageError, match="finite"):
        fully_constrained(np.array([1.0, np.nan]), np.eye(2))
