"""Sampling of covariances: against samples of pixels, closed forms, and the coverage that the bands promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.model import bhattacharyya_distance
from hyperval.processing import (
    EigenDirections,
    SamplingBand,
    covariance_distance,
    drawn_factor,
    full_rank,
    kurtosis_parameter,
    principal_angles_deg,
    sampling_band,
    statistics_of_covariance,
    statistics_of_factor,
)

P = 8
VALUES = np.geomspace(4.0, 0.02, P)


def sigma():
    q = np.linalg.qr(np.random.default_rng(2).normal(size=(P, P)))[0]
    return q @ np.diag(VALUES) @ q.T


def pixels(n, rng, dof=np.inf):
    z = rng.standard_normal((n, P)) @ np.linalg.cholesky(sigma()).T
    return z if np.isinf(dof) else z * np.sqrt((dof - 2) / rng.chisquare(dof, n))[:, None]


def sample_eigenvalues(n, draws, dof=np.inf):
    rng = np.random.default_rng(7)
    return np.array([np.linalg.eigvalsh(np.cov(pixels(n, rng, dof).T))[::-1] for _ in range(draws)])


@pytest.mark.parametrize("n", [6, 15, 400])
def test_drawn_eigenvalues_are_those_of_samples_of_pixels(n):
    # n = 6 is of less than full rank; 15 is strongly biased. Two-sample Kolmogorov-Smirnov on the first and third
    # eigenvalue; at p > 1e-3 each of the 6 comparisons rejects a right sampler once in a thousand.
    truth = sample_eigenvalues(n, 600)
    band = sampling_band(EigenDirections.of(sigma()), n - 1.0, 3, (1,), np.random.default_rng(3), draws=600)
    for k in (0, 2):
        assert stats.ks_2samp(band.eigenvalues[:, k], truth[:, k]).pvalue > 1e-3


def test_bias_of_the_first_eigenvalue_is_in_the_band_and_not_in_the_naive_comparison():
    truth = sample_eigenvalues(12, 400)[:, 0].mean()
    band = sampling_band(EigenDirections.of(sigma()), 11.0, 1, (), np.random.default_rng(1), draws=400)
    # The mean of 400 draws of relative spread 0.4 is known to 2 %, the difference of two to 2.8 %: four of these.
    assert band.eigenvalues.mean() == pytest.approx(truth, rel=0.12)
    assert truth > 1.1 * VALUES[0]


@pytest.mark.parametrize("dof", [12.0, 30.0])
def test_heavy_tails_widen_the_band_as_pixels_do(dof):
    n = 2000
    truth = sample_eigenvalues(n, 400, dof)[:, 0]
    kappa = kurtosis_parameter(dof)
    band = sampling_band(
        EigenDirections.of(sigma()), n - 1.0, 1, (), np.random.default_rng(4), kurtosis=kappa, draws=400
    )
    # A standard deviation of 400 draws is known to 3.5 %; of heavy-tailed ones to perhaps 6 %: four of these.
    drawn = band.eigenvalues[:, 0]
    assert drawn.std() == pytest.approx(truth.std(), rel=0.25)
    assert drawn.std() / VALUES[0] == pytest.approx(np.sqrt((2 + 3 * kappa) / n), rel=0.2)  # Waternaux 1976


def test_fewer_independent_pixels_along_one_direction_widen_it_alone():
    n = np.full(P, 10_000.0)
    n[0] = 400.0
    rng = np.random.default_rng(5)
    draws = np.array([np.sum(drawn_factor(P, n, rng) ** 2, axis=1) for _ in range(800)])
    # Relative sd sqrt(2/n); a standard deviation of 800 draws is known to 2.5 %: four of these.
    assert draws.std(axis=0) == pytest.approx(np.sqrt(2.0 / n), rel=0.1)
    assert draws.mean(axis=0) == pytest.approx(np.ones(P), abs=0.02)


@pytest.mark.simulation
def test_the_band_holds_a_further_sample_as_often_as_promised():
    # 120 samples, each with a band of its own: the count inside is binomial(120, 0.95) for every eigenvalue and the
    # trace. Fewer than 104 has probability 1e-4 each; more than 119 would be too wide a band (2e-3 each).
    directions, rng, n = EigenDirections.of(sigma()), np.random.default_rng(11), 60
    inside = np.zeros(4)
    for _ in range(120):
        whitened = directions.of_other(np.cov(pixels(n, rng).T))
        found = statistics_of_covariance(directions, whitened, 3, 0)
        band = sampling_band(directions, n - 1.0, 3, (), rng)
        low, high = SamplingBand.limits(np.column_stack([band.eigenvalues, band.total]))
        value = np.append(found.eigenvalues, found.total)
        inside += (value >= low) & (value <= high)
    assert np.all((inside >= 104) & (inside <= 119))


def test_distance_of_the_same_covariance_is_the_bias_of_sampling_alone():
    # To second order p (p + 1)/(16 n): the mean of sum e^2/16 over the entries of a Wishart matrix.
    n = 5000
    band = sampling_band(EigenDirections.of(sigma()), float(n), 1, (), np.random.default_rng(6), draws=400)
    assert band.distance.mean() == pytest.approx(P * (P + 1) / (16 * n), rel=0.06)  # sd of the mean 1 %


def test_covariance_distance_is_bhattacharyya_without_a_difference_of_means():
    other = np.cov(pixels(40, np.random.default_rng(9)).T)
    directions = EigenDirections.of(sigma())
    expected = bhattacharyya_distance(np.zeros(P), sigma(), np.zeros(P), other)
    assert covariance_distance(directions.of_other(other)) == pytest.approx(expected, rel=1e-9)
    assert covariance_distance(np.eye(P)) == pytest.approx(0.0, abs=1e-15)
    assert covariance_distance(np.diag([1.0, 0.0])) == np.inf


def test_principal_angle_of_a_turned_plane():
    a = np.radians(25.0)
    turned = np.array([[np.cos(a), 0.0], [0.0, 1.0]])
    assert principal_angles_deg([turned, np.eye(2)], (1, 2)) == pytest.approx(np.array([[25.0, 25.0], [0.0, 0.0]]))


def test_statistics_of_a_turned_covariance():
    # Turn the first two eigenvectors by 20 degrees within their plane: the line turns, the plane does not.
    directions, a = EigenDirections.of(sigma()), np.radians(20.0)
    vectors = directions.vectors.copy()
    vectors[:, 0] = np.cos(a) * directions.vectors[:, 0] + np.sin(a) * directions.vectors[:, 1]
    vectors[:, 1] = np.cos(a) * directions.vectors[:, 1] - np.sin(a) * directions.vectors[:, 0]
    other = vectors @ np.diag(VALUES) @ vectors.T
    found = statistics_of_covariance(directions, directions.of_other(other), 3, 2)
    assert principal_angles_deg(found.overlap, (1, 2)) == pytest.approx([20.0, 0.0], abs=1e-4)
    assert found.eigenvalues == pytest.approx(VALUES[:3])
    assert found.total == pytest.approx(VALUES.sum())
    assert found.distance > 0.0


@pytest.mark.parametrize("n", [5.0, 40.0])
def test_statistics_of_a_factor_are_those_of_its_covariance(n):
    directions = EigenDirections.of(sigma())
    factor = drawn_factor(P, n, np.random.default_rng(12))
    found = statistics_of_factor(directions, factor, 4, 3, full_rank=n > P)
    covariance = np.diag(np.sqrt(VALUES)) @ factor @ factor.T @ np.diag(np.sqrt(VALUES))
    values, vectors = np.linalg.eigh(covariance)
    assert found.eigenvalues == pytest.approx(values[::-1][:4], rel=1e-10)
    assert found.total == pytest.approx(np.trace(covariance), rel=1e-12)
    assert np.abs(found.overlap) == pytest.approx(np.abs(vectors[:3, :-4:-1]), abs=1e-10)
    wanted = bhattacharyya_distance(np.zeros(P), np.diag(VALUES), np.zeros(P), covariance) if n > P else np.nan
    assert found.distance == pytest.approx(wanted, rel=1e-9, nan_ok=True)


def test_directions_leave_out_what_is_rounding():
    singular = sigma() - VALUES[-1] * np.outer(*[np.linalg.eigh(sigma())[1][:, 0]] * 2)
    assert EigenDirections.of(singular).values.size == P - 1


def test_kurtosis_and_rank():
    assert kurtosis_parameter(np.inf) == 0.0
    assert kurtosis_parameter(6.0) == 1.0
    assert kurtosis_parameter(4.0) == np.inf
    assert full_rank(24.0, 8)
    assert not full_rank(np.array([100.0, 23.0]), 8)
