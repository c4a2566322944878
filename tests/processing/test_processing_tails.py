"""Degrees of freedom of tails: recovered from t and normal pixels, with the coverage that the limits promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.errors import UsageError
from hyperval.processing import (
    exceedance_of_distance,
    fit_tail_dof,
    left_out_distances,
    squared_mahalanobis,
    tail_log_likelihood,
)


def pixels(n, p, dof, rng):
    z = rng.standard_normal((n, p)) * np.geomspace(3.0, 0.1, p)
    return z if np.isinf(dof) else z * np.sqrt((dof - 2) / rng.chisquare(dof, n))[:, None]


def distances(x):
    values, vectors = np.linalg.eigh(np.cov(x.T))
    return squared_mahalanobis(x, x.mean(axis=0), vectors, values)


@pytest.mark.simulation
@pytest.mark.parametrize(("dof", "p", "n"), [(4.5, 4, 2000), (6.0, 30, 1500), (20.0, 30, 1500)])
def test_degrees_of_freedom_are_recovered_with_the_stated_coverage(dof, p, n):
    # 40 samples: inside is binomial(40, 0.95); fewer than 32 has probability 2e-4. The estimate's median is known
    # to about 1.25 sd/sqrt(40), sd at most 12 % here: 10 % is four of these.
    rng = np.random.default_rng(3)
    fits = [fit_tail_dof(distances(pixels(n, p, dof, rng)), p, estimated_on=n) for _ in range(40)]
    assert sum(f.lower <= dof <= f.upper for f in fits) >= 32
    assert np.median([f.dof for f in fits]) == pytest.approx(dof, rel=0.1)
    assert all(f.normality_p_value < 1e-4 for f in fits)


def test_normal_pixels_have_no_tail():
    # The normal law is inside in 97.5 % (one-sided): of 40 fewer than 34 has probability 3e-4; the test of
    # normality at 1 % rejects more than 4 of 40 with probability 3e-5.
    rng = np.random.default_rng(4)
    fits = [fit_tail_dof(distances(pixels(1500, 20, np.inf, rng)), 20, estimated_on=1500) for _ in range(40)]
    assert sum(np.isinf(f.upper) for f in fits) >= 34
    assert sum(f.normality_p_value < 0.01 for f in fits) <= 4
    assert min(f.lower for f in fits) > 100.0


def test_without_taking_a_pixel_out_the_fit_is_too_light():
    # What the correction is for: 60 bands, 2000 pixels, nu = 4.5 comes out near 4.9.
    rng = np.random.default_rng(1)
    d = distances(pixels(2000, 60, 4.5, rng))
    plain, right = fit_tail_dof(d, 60), fit_tail_dof(d, 60, estimated_on=2000)
    assert plain.dof > 1.05 * right.dof


def test_left_out_distances_equal_those_by_the_other_pixels():
    x = pixels(40, 3, 8.0, np.random.default_rng(2))
    found = left_out_distances(distances(x), 40)
    for i in (0, 17, 39):
        rest = np.delete(x, i, axis=0)
        z = x[i] - rest.mean(axis=0)
        assert found[i] == pytest.approx(z @ np.linalg.solve(np.cov(rest.T), z), rel=1e-9)


def test_likelihood_is_that_of_scaled_f_and_chi_square():
    d, p = np.random.default_rng(5).chisquare(7, 300), 7
    scale = d.mean() / p
    assert tail_log_likelihood(0.0, d, p) == pytest.approx(stats.chi2.logpdf(d, p, scale=scale).sum())
    # For a t the scale is the best one: no other is more likely.
    nu = 9.0
    best = max(
        stats.f.logpdf(d * nu / (nu - 2) / p / s, p, nu).sum() + d.size * np.log(nu / (nu - 2) / p / s)
        for s in np.geomspace(0.5, 2.0, 4001)
    )
    assert tail_log_likelihood(1 / nu, d, p) == pytest.approx(best, abs=1e-4)


def test_dependent_pixels_widen_the_limits():
    rng = np.random.default_rng(6)
    d = distances(pixels(3000, 5, 8.0, rng))
    every, few = fit_tail_dof(d, 5, estimated_on=3000), fit_tail_dof(d, 5, estimated_on=3000, independent=300)
    assert few.dof == pytest.approx(every.dof, rel=1e-3)
    assert few.upper - few.lower > 2.5 * (every.upper - every.lower)


def test_no_distance_counts_more_than_once():
    d = distances(pixels(500, 5, 8.0, np.random.default_rng(31)))
    assert fit_tail_dof(d, 5, independent=5000) == fit_tail_dof(d, 5)


def test_exceedance_is_that_of_pixels():
    rng = np.random.default_rng(7)
    z = pixels(200_000, 4, 6.0, rng) / np.geomspace(3.0, 0.1, 4)
    far = np.sum(z**2, axis=1)
    at = np.array([2.0, 10.0, 40.0])
    share = (far[:, None] > at).mean(axis=0)
    expected = exceedance_of_distance(at, 4, 6.0)
    # Binomial: four standard deviations of each share.
    assert np.all(np.abs(share - expected) < 4 * np.sqrt(expected / far.size))
    assert exceedance_of_distance(at, 4, np.inf) == pytest.approx(stats.chi2.sf(at, 4))


def test_refusals():
    with pytest.raises(UsageError, match="say nothing of tails"):
        fit_tail_dof(np.ones(5), 2)
    with pytest.raises(UsageError, match="20 pixels for distances in 20 bands"):
        fit_tail_dof(np.ones(20), 20, estimated_on=20)
