"""ACE on statistics: beta law of its own background, pixels of a t law, stated error, stable differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.model import Exceedance, ace_exceedance, ace_space, ace_threshold, exceedance_at

BANDS = 7


def ace_score(space, pixels) -> np.ndarray:
    """ACE of pixels (N, F), 0-1, as it is defined: the squared cosine in whitened space."""
    y = space.background.whiten((np.asarray(pixels, dtype=float) - space.mean).T)
    return np.asarray((space.axis @ y) ** 2 / np.maximum((y**2).sum(axis=0), 1e-300))


@pytest.fixture(scope="module")
def space():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(BANDS, 3 * BANDS))
    covariance = a @ a.T / (3 * BANDS)
    mean = rng.normal(size=BANDS)
    return ace_space(mean + rng.normal(size=BANDS), mean, covariance), mean, covariance


@pytest.mark.parametrize("dof", [None, 6.0])
def test_background_of_its_own_filter_has_a_beta_law_whatever_its_tails(space, dof):
    # The squared cosine of a direction that is uniform on the sphere: Beta(1/2, (F - 1)/2).
    of, mean, covariance = space
    law = stats.beta(0.5, 0.5 * (BANDS - 1))
    scores = law.isf([0.5, 0.1, 1e-3, 1e-5])
    found = ace_exceedance(
        of, mean, covariance, 20_000, np.random.default_rng(1), dof, scores=scores, decades=(0.0, 3.0, 5.0)
    )
    # Within 4.5 of the stated errors: by chance fails in 3e-5 of runs.
    assert np.all(np.abs(found.probability - law.sf(scores)) < 4.5 * found.standard_error + 1e-8)
    assert np.all(found.standard_error < 0.1 * found.probability)


def test_pixels_of_a_heavy_tailed_target_are_scored_as_drawn(space):
    # 200,000 pixels: a probability near 0.5 is known to 0.0011, the model to 0.003; 4.5 of both together is 0.015.
    of, mean, covariance = space
    rng = np.random.default_rng(2)
    nu, away = 5.0, 2.0 * of.background.matrix @ np.linalg.solve(covariance, np.linspace(0.3, 1.0, BANDS))
    z = rng.multivariate_normal(np.zeros(BANDS), covariance, 200_000, method="cholesky")
    pixels = mean + away + z * np.sqrt((nu - 2.0) / rng.chisquare(nu, len(z)))[:, None]
    scores = np.array([0.05, 0.2, 0.5, 0.8])
    seen = (ace_score(of, pixels)[:, None] > scores).mean(axis=0)
    found = ace_exceedance(of, mean + away, covariance, 20_000, rng, nu, scores=scores)
    assert found.probability == pytest.approx(seen, abs=0.015)


def test_stated_error_is_the_scatter_of_repetition(space):
    # 60 repetitions know a standard deviation to 9 %; four of that are allowed.
    of, mean, covariance = space
    far = mean + np.linspace(0.5, 2.0, BANDS)
    runs = [ace_exceedance(of, far, covariance, 500, np.random.default_rng(k), scores=[0.2, 0.6]) for k in range(60)]
    scatter = np.std([r.probability for r in runs], axis=0, ddof=1)
    assert np.mean([r.standard_error for r in runs], axis=0) == pytest.approx(scatter, rel=0.37)


def test_threshold_and_exceedance_are_inverse():
    law = stats.beta(0.5, 3.0)
    scores = np.tanh(np.linspace(1e-3, 3.0, 400)) ** 2
    population = Exceedance(scores, law.sf(scores), np.zeros(scores.size))
    pfa = np.array([0.3, 1e-2, 1e-4])
    at = ace_threshold(pfa, [1.0], [population])
    assert at == pytest.approx(law.isf(pfa), rel=2e-3)
    assert exceedance_at(at, population) == pytest.approx(pfa, rel=1e-2)
    # Two classes of which one never alarms: the other's own P_FA is twice as large.
    silent = Exceedance(scores, np.full(scores.size, 1e-300), np.zeros(scores.size))
    assert ace_threshold(pfa / 2, [0.5, 0.5], [population, silent]) == pytest.approx(at, rel=1e-9)
