"""Fewer pixels than bands: what they know, and that a test on them rejects what it should."""

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import chi_square_full
from hyperval.errors import UsageError
from hyperval.processing import factor_covariance
from hyperval.products import EstimatedPart
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

BANDS = 80
W = np.linspace(0.0, 1.0, BANDS)
SHAPES = np.stack([np.sin(3 * W), np.cos(7 * W)])
SPREAD = 0.5 + W


def drawn(rng, n, amplitude):
    return rng.normal(size=(n, BANDS)) * SPREAD + amplitude * rng.normal(size=(n, 2)) @ SHAPES


def test_pure_noise_has_no_factors():
    rng = np.random.default_rng(1)
    found, dof = factor_covariance(np.cov(drawn(rng, 30, 0.0).T), 30)
    assert np.count_nonzero(found - np.diag(np.diag(found))) == 0
    # 2 tr(D^2)/m against {tr(C^2) + tr(C)^2}/nu, all variances alike.
    assert dof == pytest.approx(29 * (1 + BANDS) / 2)


def test_factors_that_stand_out_are_found_and_the_rest_is_diagonal():
    rng = np.random.default_rng(2)
    x = drawn(rng, 40, 20.0)
    found, dof = factor_covariance(np.cov(x.T), 40)
    sd = np.sqrt(np.diag(np.cov(x.T)))
    off = found / np.outer(sd, sd)
    values = np.linalg.eigvalsh(off)
    assert np.sum(values > 1.0) == 2
    assert values[0] > 0
    assert 39 <= dof < 60
    # The diagonal is the sample's, but for what the factors took along (m/(m - 2) of a small part).
    assert np.allclose(np.diag(found), sd**2, rtol=0.06)
    # Noise of the bands to 3.3 standard errors of a variance from 37 degrees of freedom, all bands together.
    own = np.linalg.eigvalsh(found)[: BANDS - 2].sum() / (SPREAD**2).sum()
    assert abs(own - 1.0) < 3.3 * np.sqrt(2.0 / 37 / BANDS) + 2 / BANDS


def test_bands_keep_their_own_variance_though_factors_are_fitted_to_it():
    # 14 pixels and two factors: without the correction 2 in 13 of it would be lost.  100 draws of 80 bands know the
    # mean to 0.5 %; the two directions of the factors hold a little of the noise, here up to 4 %.
    rng = np.random.default_rng(6)
    own = []
    for _ in range(100):
        found, _ = factor_covariance(np.cov(drawn(rng, 14, 20.0).T), 14)
        own.append(np.linalg.eigvalsh(found)[: BANDS - 2].sum() / (SPREAD**2).sum())
    assert np.mean(own) == pytest.approx(1.0, abs=0.06)


@pytest.mark.simulation
@pytest.mark.parametrize("n", [12, 36])
@pytest.mark.parametrize("amplitude", [0.0, 1.0, 20.0])
def test_true_means_are_rejected_as_often_as_stated_at_most(n, amplitude):
    """Fails by chance once in a thousand runs where 5 % are rejected; taken as known, the plain covariance of 12
    pixels rejects all."""
    rng = np.random.default_rng(3)
    rejected = plain = 0
    known = np.diag(1e-3 * SPREAD**2)
    for _ in range(100):
        x = drawn(rng, n, amplitude)
        sample = np.cov(x.T)
        covariance, dof = factor_covariance(sample, n)
        part = EstimatedPart(covariance / n, dof, sample=sample / n, sample_dof=n - 1.0)
        rejected += chi_square_full(x.mean(0), covariance / n + known, [part]).p_value < 0.05
        plain += chi_square_full(x.mean(0), sample / n + known).p_value < 0.05
    assert rejected <= stats.binom.isf(1e-3, 100, 0.05)
    assert plain == 100 or n > 12


@pytest.mark.slow
@pytest.mark.parametrize("n", [16, 40, 200])
def test_p_values_of_true_means_are_uniform_where_bands_hang_together(n):
    """Pixels of asphalt in 163 bands with noise, 300 means each: what a scene's small regions are.

    Along the samples' own leading directions the mean p-value was 0.87 to 0.90 and 42 % lay above 0.95.  Standard
    errors: 0.017 of the mean, 0.0126 of a share of 5 %; limits at 3.5: one false failure in 700 for the nine.
    """
    axis = SpectralAxis(np.linspace(420.0, 2400.0, 163), np.full(163, 6.0))
    asphalt = builtin_class("asphalt", axis).covariance + 0.002**2 * np.eye(163)
    values, vectors = np.linalg.eigh(asphalt)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    rng, found = np.random.default_rng(17), []
    for _ in range(300):
        x = rng.standard_normal((n, 163)) @ root.T
        sample = np.cov(x.T)
        covariance, dof = factor_covariance(sample, n) if n < 163 else (sample, n - 1.0)
        part = EstimatedPart(covariance / n, dof, sample=sample / n, sample_dof=n - 1.0)
        found.append(chi_square_full(x.mean(0), covariance / n, [part]).p_value)
    p = np.array(found)
    assert abs(p.mean() - 0.5) < 0.058
    assert abs(np.mean(p < 0.05) - 0.05) < 0.045
    assert abs(np.mean(p > 0.95) - 0.05) < 0.045


def test_a_shape_that_is_not_there_is_still_rejected():
    rng = np.random.default_rng(4)
    x = drawn(rng, 36, 0.0)
    covariance, dof = factor_covariance(np.cov(x.T), 36)
    off = x.mean(0) + 2.0 * SPREAD / 6.0 * np.cos(9 * W)  # two standard errors of the mean in amplitude
    part = EstimatedPart(covariance / 36, dof)
    assert chi_square_full(off, covariance / 36, [part]).p_value < 1e-3


def test_few_degrees_of_freedom_stay_few():
    rng = np.random.default_rng(5)
    _, dof = factor_covariance(np.cov(drawn(rng, 6, 0.0).T), 6)
    assert dof == 5


@pytest.mark.parametrize(("covariance", "n"), [(np.eye(3), 1), (np.diag([1.0, 0.0, 1.0]), 5)])
def test_what_has_no_factors_is_refused(covariance, n):
    with pytest.raises(UsageError, match="no factors"):
        factor_covariance(covariance, n)
