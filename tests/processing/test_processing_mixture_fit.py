"""Mixtures: likelihood that never falls, one component, another package, tails, numbers by blocks, moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from sklearn.mixture import GaussianMixture

from hyperval.errors import UsageError
from hyperval.processing import MixtureFit, chosen_count, chosen_dof, class_mixture, fit_mixture, shrunk_covariances


def clusters(n: int, seed: int, centres=((-1.5, 0.0), (1.0, 1.5), (0.5, -1.5))):
    """Values (n, 2) of three unequal clusters, standardised, and the cluster of each."""
    rng = np.random.default_rng(seed)
    which = rng.choice(3, size=n, p=[0.5, 0.3, 0.2])
    x = np.array(centres)[which] + rng.standard_normal((n, 2)) * np.array([0.3, 0.15, 0.25])[which][:, None]
    x -= x.mean(axis=0)
    return x @ np.linalg.inv(np.linalg.cholesky(np.cov(x.T, bias=True))).T, which


@pytest.mark.parametrize("dof", [np.inf, 4.0, None])
@pytest.mark.parametrize("seed", range(4))
def test_the_penalised_likelihood_never_falls(dof, seed):
    x, _ = clusters(400, seed)
    for count in (1, 2, 5):
        steps = np.diff(fit_mixture(x, count, np.random.default_rng(seed), dof=dof).history)
        assert np.all(steps > -1e-10)


def test_one_normal_component_is_the_sample():
    x, _ = clusters(300, 0)
    fit = fit_mixture(x, 1, np.random.default_rng(0))
    assert fit.means[0] == pytest.approx(np.zeros(2), abs=1e-12)
    assert fit.scales[0] == pytest.approx(np.eye(2), abs=1e-12)
    assert fit.log_density(x) == pytest.approx(stats.multivariate_normal(np.zeros(2), np.eye(2)).logpdf(x), rel=1e-12)


def test_three_clusters_as_another_package_finds_them():
    x, _ = clusters(2000, 1)
    peer = GaussianMixture(3, reg_covar=0.0, tol=1e-9, max_iter=500, n_init=3, random_state=0).fit(x)
    ours = fit_mixture(x, 3, np.random.default_rng(0), prior_pixels=0.0)
    assert float(ours.log_density(x).mean()) == pytest.approx(peer.score(x), abs=1e-4)
    mine, theirs = np.argsort(ours.weights), np.argsort(peer.weights_)
    assert ours.weights[mine] == pytest.approx(peer.weights_[theirs], abs=1e-3)
    assert ours.means[mine] == pytest.approx(peer.means_[theirs], abs=1e-3)
    assert ours.scales[mine] == pytest.approx(peer.covariances_[theirs], abs=1e-3)
    assert ours.shares(x)[0].T[:, mine] == pytest.approx(peer.predict_proba(x)[:, theirs], abs=1e-2)


def test_density_of_a_t_law_is_the_published_one():
    scale = np.array([[1.0, 0.3], [0.3, 0.5]])
    x = np.random.default_rng(2).standard_normal((20, 2))
    fit = MixtureFit(np.ones(1), np.array([[0.2, -0.1]]), scale[None], 5.0)
    assert fit.log_density(x) == pytest.approx(stats.multivariate_t([0.2, -0.1], scale, df=5.0).logpdf(x), rel=1e-12)


def test_degrees_of_freedom_are_recovered():
    # 4000 pixels know 1/nu = 0.2 to 0.015: beyond 4 to 6.7 by chance in 1e-3 of runs; the seed is fixed.
    x = stats.multivariate_t(np.zeros(3), 0.6 * np.eye(3), df=5.0, seed=3).rvs(4000)
    assert 4.0 < fit_mixture(x, 1, np.random.default_rng(0), dof=None).dof < 6.7
    normal = np.random.default_rng(4).standard_normal((2000, 3))
    assert fit_mixture(normal, 1, np.random.default_rng(0), dof=None).dof > 15.0  # a step that gains 1e-4 is the last


def test_blocks_choose_as_many_components_as_there_are():
    block = np.arange(1200) // 60
    x, _ = clusters(1200, 5)
    assert chosen_count(x, block, (1, 2, 3, 4, 6), np.random.default_rng(0))[0] == 3
    one = np.random.default_rng(6).standard_normal((1200, 2))
    count, score = chosen_count(one, block, (1, 2, 4), np.random.default_rng(0))
    assert count == 1
    assert score[0] > score[1]
    heavy = stats.multivariate_t(np.zeros(2), 0.5 * np.eye(2), df=4.0, seed=7).rvs(1200)
    assert chosen_dof(heavy, block, 1, np.random.default_rng(0)) in (None, 4.0, 8.0)


def test_what_cannot_be_fitted_is_refused():
    x, _ = clusters(30, 0)
    with pytest.raises(UsageError, match="40 components of 30 pixels"):
        fit_mixture(x, 40, np.random.default_rng(0))
    with pytest.raises(UsageError, match="one block of the image"):
        chosen_count(x, np.zeros(30), (1, 2), np.random.default_rng(0))


@pytest.mark.simulation
@pytest.mark.parametrize("tails", [False, True])
def test_components_in_all_bands_have_the_moments_of_their_clusters(tails):
    # 3000 pixels in 12 bands: means are known to 2 % of the spread of a cluster, variances to 5 %; the bounds are
    # five of these.
    values, which = clusters(3000, 8)
    rng = np.random.default_rng(8)
    into = rng.normal(size=(2, 12))
    pixels = 0.3 + 0.05 * values @ into + rng.normal(scale=0.002, size=(3000, 12))
    mixture = class_mixture(pixels, np.arange(3000) // 100, "auto", tails=tails)
    assert mixture is not None
    parts = mixture.components(pixels)
    assert parts is not None
    assert len(parts) == 3
    for k, own in zip(np.argsort(-parts.weights), range(3), strict=True):
        mine = pixels[which == own]
        assert parts.weights[k] == pytest.approx(np.mean(which == own), abs=0.01)
        sd = np.sqrt(np.diag(np.cov(mine.T)))
        assert np.all(np.abs(pixels.mean(axis=0) + parts.offsets[k] - mine.mean(axis=0)) < 0.1 * sd)
        assert np.sqrt(np.diag(parts.covariances[k])) == pytest.approx(sd, rel=0.13)
    assert np.diag(parts.covariance) == pytest.approx(np.var(pixels, axis=0, ddof=1), rel=0.02)


def test_one_law_has_no_components():
    pixels = np.random.default_rng(9).standard_normal((600, 5))
    block = np.arange(600) // 30
    assert class_mixture(pixels, block, "auto", tails=False) is None
    assert class_mixture(pixels, block, 1, tails=False) is None
    assert class_mixture(pixels[:100], block[:100], "auto", tails=False) is None  # too few to tell


def test_few_pixels_are_shrunk_and_many_keep_what_is_theirs():
    rng = np.random.default_rng(10)
    wide, narrow = np.cov(4.0 * rng.standard_normal((6, 5000))), np.cov(rng.standard_normal((6, 5000)))
    few = np.cov(rng.standard_normal((6, 4)))
    out = shrunk_covariances(np.array([wide, narrow, few]), np.array([5000.0, 5000.0, 4.0]))
    assert out[0] == pytest.approx(wide, abs=0.05 * wide.max())
    assert np.linalg.eigvalsh(few)[0] < 1e-9 < 1e-3 < np.linalg.eigvalsh(out[2])[0]
