"""Fewer pixels than bands: what they know, and that a test on them rejects what it should."""

import numpy as np
import pytest
from scipy import stats

from hyperval.compare.consistency import chi_square_full
from hyperval.errors import UsageError
from hyperval.processing.few_pixels import factor_covariance

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


@pytest.mark.parametrize("n", [12, 36])
@pytest.mark.parametrize("amplitude", [0.0, 1.0, 20.0])
def test_true_means_are_rejected_as_often_as_stated_at_most(n, amplitude):
    """Fails by chance once in a thousand runs where 5 % are rejected; the plain covariance of 12 rejects all."""
    rng = np.random.default_rng(3)
    rejected = plain = 0
    known = np.diag(1e-3 * SPREAD**2)
    for _ in range(100):
        x = drawn(rng, n, amplitude)
        sample = np.cov(x.T)
        covariance, dof = factor_covariance(sample, n)
        rejected += chi_square_full(x.mean(0), covariance / n + known, [(covariance / n, dof)]).p_value < 0.05
        plain += chi_square_full(x.mean(0), sample / n + known, [(sample / n, n - 1.0)]).p_value < 0.05
    assert rejected <= stats.binom.isf(1e-3, 100, 0.05)
    assert plain == 100 or n > 12


def test_a_shape_that_is_not_there_is_still_rejected():
    rng = np.random.default_rng(4)
    x = drawn(rng, 36, 0.0)
    covariance, dof = factor_covariance(np.cov(x.T), 36)
    off = x.mean(0) + 2.0 * SPREAD / 6.0 * np.cos(9 * W)  # two standard errors of the mean in amplitude
    assert chi_square_full(off, covariance / 36, [(covariance / 36, dof)]).p_value < 1e-3


def test_few_degrees_of_freedom_stay_few():
    rng = np.random.default_rng(5)
    _, dof = factor_covariance(np.cov(drawn(rng, 6, 0.0).T), 6)
    assert dof == 5


@pytest.mark.parametrize(("covariance", "n"), [(np.eye(3), 1), (np.diag([1.0, 0.0, 1.0]), 5)])
def test_what_has_no_factors_is_refused(covariance, n):
    with pytest.raises(UsageError, match="no factors"):
        factor_covariance(covariance, n)
