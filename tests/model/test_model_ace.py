"""ACE on statistics: beta law of its own background, pixels of a t law, stated error, stable differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.model import Exceedance, ace_exceedance, ace_space, ace_threshold, exceedance_at

BANDS = 7


@pytest.fixture(scope="module")
def space():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(BANDS, 3 * BANDS))
    covariance = a @ a.T / (3 * BANDS)
    mean = rng.normal(size=BANDS)
    return ace_space(mean + rng.normal(size=BANDS), mean, covariance), mean, covariance


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
