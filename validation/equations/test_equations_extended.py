"""Shade, darkest pixel, noise-adjusted features, SMF, ACE, densities, separability: by hand and simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from hyperval.atmosphere import AtmosphericTerms
from hyperval.model import (
    ClassScores,
    Host,
    RocScores,
    ace_exceedance,
    ace_space,
    ace_threshold,
    bhattacharyya_distance,
    chi_square_mixing,
    classification_error,
    darkest_level,
    detection_probability,
    exceedance_at,
    host_part,
    illumination_factor,
    log_false_alarm,
    matched_filter_weights,
    mean_radiance,
    score_density,
    spectral_matched_filter,
)

TERMS = AtmosphericTerms(
    wavelength_nm=np.array([550.0, 860.0]),
    path_radiance=np.array([1.0, 0.4]),
    direct=np.array([10.0, 8.0]),
    adjacency=np.array([2.0, 1.0]),
    spherical_albedo=np.array([0.1, 0.05]),
    ground_irradiance=np.array([40.0, 30.0]),
    gas_transmittance=np.ones(2),
    diffuse_fraction=np.array([0.3, 0.15]),
)
AVERAGE = np.array([0.2, 0.4])


def ace_score(space, pixels) -> np.ndarray:
    """ACE of pixels (N, F), 0-1, as it is defined: the squared cosine in whitened space."""
    y = space.background.whiten((np.asarray(pixels, dtype=float) - space.mean).T)
    return np.asarray((space.axis @ y) ** 2 / np.maximum((y**2).sum(axis=0), 1e-300))


def test_3_7_shade_by_hand():
    # S rho_ave = 0.02. Full shade under an open sky: 0.98 * 0.3 + 0.02 = 0.314 and 0.98 * 0.15 + 0.02 = 0.167.
    assert illumination_factor(TERMS, AVERAGE, 0.0, 1.0) == pytest.approx([0.314, 0.167])
    # Half of the beam, a quarter of the sky hidden: 0.98 (0.7 * 0.5 + 0.3 * 0.75) + 0.02 * 0.75 = 0.5785.
    assert illumination_factor(TERMS, AVERAGE, 0.5, 0.75)[0] == pytest.approx(0.5785)


def test_3_7_shade_limits():
    assert illumination_factor(TERMS, AVERAGE, 1.0, 1.0) == pytest.approx([1.0, 1.0])  # the open
    assert illumination_factor(TERMS, AVERAGE, 0.0, 0.0) == pytest.approx([0.0, 0.0])  # a closed box
    # Black surroundings send nothing back to the sky: the parts are those of the light on a black ground.
    assert illumination_factor(TERMS, np.zeros(2), 0.0, 1.0) == pytest.approx(TERMS.diffuse_fraction)
    # A ground that the sky mirrors for ever (S rho -> 1) is lit by the sky alone.
    assert illumination_factor(TERMS, np.array([9.999999, 19.999998]), 0.0, 1.0) == pytest.approx([1, 1], abs=1e-6)


def test_3_7_shade_is_the_sum_of_all_bounces():
    # Light on the target: beam, sky, and what ground and sky hand back and forth, which arrives from the sky.
    q, s, a = TERMS.diffuse_fraction, TERMS.spherical_albedo, TERMS.direct
    beam, sky, rho = 0.3, 0.6, 0.5
    light = (1 - q) * beam + q * sky + sky * sum((s * AVERAGE) ** n for n in range(1, 60))
    shaded = rho * illumination_factor(TERMS, AVERAGE, beam, sky)
    dark = mean_radiance(TERMS, np.zeros(2), AVERAGE)
    assert mean_radiance(TERMS, shaded, AVERAGE) - dark == pytest.approx(a * rho * light, rel=1e-12)


def test_darkest_pixel_by_hand():
    # One class, one pixel: the median is the mean. Two: F = 1 - 2^-1/2 = 0.292893, Phi^-1 = -0.544952.
    assert darkest_level([1.0], [[5.0]], [[2.0]], 1) == pytest.approx([5.0])
    assert darkest_level([1.0], [[5.0]], [[2.0]], 2) == pytest.approx([5.0 - 2 * 0.544952], rel=1e-6)


def test_darkest_pixel_by_monte_carlo():
    """1e6 pixels in 1000 scenes of 1000: half of the minima lie below; |z| < 5, failure 6e-7."""
    rng = np.random.default_rng(320)
    which = rng.random((1000, 1000)) < 0.3
    pixels = np.where(which, rng.normal(3.0, 0.5, which.shape), rng.normal(4.0, 0.9, which.shape))
    median = darkest_level([0.3, 0.7], [[3.0], [4.0]], [[0.5], [0.9]], 1000)
    assert abs((pixels.min(axis=1) < median).mean() - 0.5) < 5 * 0.5 / np.sqrt(1000)


def test_smf_by_hand():
    # d^T Sigma^-1 d = 2: SMF = sqrt(2) times the filter of unit response; variance 1 over the background.
    cov = np.diag([1.0, 4.0])
    smf = spectral_matched_filter([2.0, 3.0], [1.0, 1.0], cov)
    assert smf.weights == pytest.approx(np.sqrt(2) * matched_filter_weights([2.0, 3.0], [1.0, 1.0], cov).weights)
    assert smf.weights @ cov @ smf.weights == pytest.approx(1.0)
    assert float(smf.score([2.0, 3.0])) == pytest.approx(np.sqrt(2))


def test_ace_by_hand():
    # Whitened with Sigma = diag(1, 4): target (1, 1), pixel (2, 0): cos^2 = 4 / (2 * 4) = 0.5; the target itself 1.
    space = ace_space([2.0, 3.0], [1.0, 1.0], np.diag([1.0, 4.0]))
    assert ace_score(space, [[3.0, 1.0], [2.0, 3.0], [1.5, 0.0]]) == pytest.approx([0.5, 1.0, 0.0])


def test_ace_of_the_background_is_a_beta_distribution():
    """Closed form: cos^2 of a normal vector in F dimensions is Beta(1/2, (F - 1)/2).

    4000 draws, |z| < 5 at 6 scores (false failure 4e-6); at 1e-9 counting would need 1e11 draws for the same error.
    """
    rng = np.random.default_rng(322)
    a = rng.standard_normal((20, 20))
    cov, mean, target = a @ a.T + 20 * np.eye(20), rng.random(20), rng.random(20) + 1
    space = ace_space(target, mean, cov)
    law = stats.beta(0.5, 9.5)
    scores = law.isf([0.5, 0.1, 1e-2, 1e-4, 1e-6, 1e-9])
    found = ace_exceedance(space, mean, cov, 4000, rng, scores=scores, decades=(0, 3, 6, 9))
    z = (found.probability - law.sf(scores)) / found.standard_error
    assert np.abs(z).max() < 5
    assert found.standard_error[-1] / found.probability[-1] < 0.1
    whole = ace_exceedance(space, mean, cov, 4000, rng, decades=(0, 3, 6, 9))
    at = ace_threshold([1e-6, 1e-3, 0.1], [1.0], [whole])
    # Between the tabulated scores and with the error of the draws: 20 % of P_FA.
    assert law.sf(at) == pytest.approx([1e-6, 1e-3, 0.1], rel=0.2)
    assert exceedance_at(at, whole) == pytest.approx([1e-6, 1e-3, 0.1], rel=1e-3)
    assert whole.moments[0] == pytest.approx(law.mean(), rel=0.01)


def test_densities_are_the_derivatives():
    one = ClassScores(*np.array([[[0.6, 0.4]], [[0.0, 0.3]], [[0.2, 0.5]], [[np.inf, 4.0]]]))
    x, h = np.linspace(-1, 2, 13), 1e-5
    rows = one.rows(np.zeros(13, int))
    slope = (np.exp(log_false_alarm(x - h, rows)[0]) - np.exp(log_false_alarm(x + h, rows)[0])) / (2 * h)
    assert score_density(x[:, None], rows)[:, 0] == pytest.approx(slope, rel=1e-6)
    whole = integrate.quad(lambda v: float(score_density(np.array([[v]]), one)[0, 0]), -60, 60, points=[0, 0.3])[0]
    assert whole == pytest.approx(1.0, abs=1e-5)
    means, sds, weights = np.array([[0.2, 0.8]]), np.array([[0.1, 0.2]]), np.array([[0.3, 0.7]])
    above, below = (detection_probability(x[None] + s * h, means, sds, weights)[0] for s in (-1, 1))
    target = RocScores(one, np.zeros(1, int), means, sds, weights)
    assert target.target_density(x[None])[0] == pytest.approx((above - below) / (2 * h), rel=1e-5, abs=1e-9)


def test_mixed_pixel_of_a_t_host_by_hand():
    # f = 0.2 of a target, host of variance 4 (its class 3): total 2 + 0.64 (4 - 3), of it 0.64 * 4 with tails.
    assert host_part(2.0, 0.8, 4.0, 3.0) == pytest.approx((2.64, 2.56))
    # w of 4 degrees of freedom has density w exp(-w/2) / 4: E[(nu - 2) / w] = 1, E[2 / w > 2] = P(w < 1) = 0.0902.
    factor, probability = (a[0] for a in chi_square_mixing(np.array([4.0])))
    assert probability.sum() == pytest.approx(1.0)
    assert factor @ probability == pytest.approx(1.0, rel=1e-7)
    assert factor**-1 @ probability == pytest.approx(2.0, rel=1e-7)  # E[w] / 2
    # By the integral over w: host sd 0.9 of 5 degrees of freedom, normal variance 0.25, mean 0.1, x = 3.
    law = stats.chi2(5.0)
    expected = integrate.quad(
        lambda w: law.pdf(w) * stats.norm.sf(3.0, 0.1, np.sqrt(0.25 + 0.81 * 3.0 / w)), 0.0, np.inf, epsrel=1e-10
    )[0]
    laws = ClassScores(*np.array([[[1.0]], [[0.0]], [[1.0]], [[5.0]]]))
    host = Host(np.array([[0.9]]), np.zeros(1), np.ones(1), laws)
    found = detection_probability(np.array([[3.0]]), np.array([[0.1]]), np.sqrt([[1.06]]), np.ones((1, 1)), host)
    assert found[0, 0] == pytest.approx(expected, rel=1e-7)


def test_bhattacharyya_by_hand():
    # Equal unit covariances two apart: B = 4/8 = 0.5, error Phi(-1) = 0.158655.
    eye = np.eye(2)
    assert bhattacharyya_distance([0.0, 0.0], eye, [2.0, 0.0], eye) == pytest.approx(0.5)
    assert classification_error(0.5)[0] == pytest.approx(0.158655, rel=1e-5)
    # Equal means, variances 1 and 4 in one band: 1/2 ln(2.5 / 2) = 0.111572.
    assert bhattacharyya_distance([0.0], [[1.0]], [0.0], [[4.0]]) == pytest.approx(0.5 * np.log(1.25))


def test_classification_error_by_monte_carlo():
    """1e6 pixels of two classes, the better likelihood decides: within the bounds, |z| < 5 (false failure 6e-7)."""
    rng = np.random.default_rng(324)
    n = 500_000
    m, c1, c2 = np.array([1.2, 0.4]), np.array([[1.0, 0.3], [0.3, 0.6]]), np.array([[0.5, -0.1], [-0.1, 1.4]])
    laws = stats.multivariate_normal(np.zeros(2), c1), stats.multivariate_normal(m, c2)
    wrong = sum(
        np.count_nonzero(laws[1 - k].pdf(x) > laws[k].pdf(x))
        for k in (0, 1)
        for x in [laws[k].rvs(n, random_state=rng)]
    )
    error, se = wrong / (2 * n), np.sqrt(0.25 / (2 * n))
    estimate, lower, upper = classification_error(bhattacharyya_distance(np.zeros(2), c1, m, c2))
    assert lower - 5 * se < error < upper + 5 * se
    assert lower <= estimate <= upper
    # Equal covariances: the estimate is exact.
    x = rng.multivariate_normal(np.zeros(2), c1, 2 * n)
    d = np.linalg.solve(c1, m)
    missed = (x @ d > 0.5 * m @ d).mean()
    expected = classification_error(bhattacharyya_distance(np.zeros(2), c1, m, c1))[0]
    assert abs(missed - expected) < 5 * np.sqrt(expected / (2 * n))
