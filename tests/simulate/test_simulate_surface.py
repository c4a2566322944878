"""Drawn reflectance against the statistics it is drawn from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kurtosis
from small_scene import area, planks, small_scene

from hyperval.data import ClassStatistics
from hyperval.simulate import SurfaceRenderer, lay_out, sampler

# Each statistical test below fails by chance with this probability per assertion.
ALPHA = 1e-5


def whitened(values: np.ndarray, statistics: ClassStatistics) -> np.ndarray:
    lower = np.linalg.cholesky(statistics.covariance)
    return np.linalg.solve(lower, (values.astype(float) - statistics.mean).T).T


def assert_drawn_from(values: np.ndarray, statistics: ClassStatistics) -> None:
    """Mean and covariance of the sample against the definition, in whitened coordinates."""
    z = whitened(values, statistics)
    n, bands = z.shape
    assert n * np.sum(z.mean(axis=0) ** 2) < chi2.isf(ALPHA, bands)
    total = np.sum(z**2)
    assert chi2.isf(1 - ALPHA, n * bands) < total < chi2.isf(ALPHA, n * bands)
    # Products of different whitened bands are uncorrelated with mean 0 and variance 1.
    products = (z.T @ z)[np.triu_indices(bands, 1)]
    assert np.sum(products**2) / n < chi2.isf(ALPHA, products.size) * 1.05  # 5 %: products have heavier tails


def test_rendered_pixels_have_the_statistics_of_their_class(classes):
    scene = small_scene(targets=[], panels=[])
    renderer = SurfaceRenderer(scene, lay_out(scene), classes)
    for name, lines in (("grass", range(30)), ("asphalt", range(30, 60))):
        assert_drawn_from(np.concatenate([renderer.reflectance(line) for line in lines]), classes[name])


def test_draws_have_the_mean_and_covariance_of_the_class(classes):
    values = sampler(classes["grass"]).draw(40_000, np.random.default_rng(1))
    assert_drawn_from(values, classes["grass"])
    with pytest.raises(AssertionError):
        assert_drawn_from(values * np.float32(1.01), classes["grass"])


def test_a_covariance_of_rank_one_is_drawn(classes):
    mode = np.linspace(0.01, 0.03, 12)
    line = ClassStatistics("line", classes["grass"].axis, np.full(12, 0.3), np.outer(mode, mode))
    values = sampler(line).draw(2000, np.random.default_rng(2)).astype(float) - 0.3
    score = values @ mode / (mode @ mode)
    assert np.max(np.abs(values - score[:, None] * mode)) < 2e-6
    assert np.sum(score**2) == pytest.approx(2000, abs=5 * np.sqrt(2 * 2000))  # 5 sigma of chi-square


def test_a_multivariate_t_keeps_the_covariance_and_gains_tails(classes):
    values = sampler(classes["grass"], dof=12.0).draw(200_000, np.random.default_rng(5))
    z = whitened(values, classes["grass"])
    # The kurtosis of a t with 12 degrees of freedom is 3 + 6/8; standard errors at n = 2e5 and 12 bands,
    # from the eighth moment: 0.04 per band; 6 of them.
    assert np.var(z, axis=0).mean() == pytest.approx(1.0, abs=0.02)
    assert kurtosis(z, axis=0).mean() == pytest.approx(0.75, abs=0.24)


def test_a_plank_pixel_is_the_mixture_of_its_plank_and_its_host(scene, classes):
    still = {name: ClassStatistics(name, c.axis, c.mean, 1e-16 * np.eye(len(c.axis))) for name, c in classes.items()}
    ground = lay_out(scene)
    renderer = SurfaceRenderer(scene, ground, still)
    host, target = still["asphalt"].mean, still["yellow-paint-plank"].mean
    seen = 0
    for line in range(35, 52):
        f = ground.fill[line].astype(float)[:, None]
        assert np.max(np.abs(renderer.reflectance(line) - (f * target + (1 - f) * host))) < 1e-6
        seen += int(np.count_nonzero(f))
    assert seen == np.count_nonzero(ground.fill) > 0


def test_every_plank_has_its_own_spectrum(classes):
    group = planks(count=400, area={"lines": [5, 155], "samples": [5, 395]})
    ground = {"lines": 400, "samples": 400, "layout": [area("asphalt", [0, 400], [0, 400])]}
    big = small_scene(**ground, panels=[], regions=[], targets=[group])
    spectra = SurfaceRenderer(big, lay_out(big), classes).target_spectra
    assert spectra.shape[0] == 400
    assert_drawn_from(spectra, classes["yellow-paint-plank"])


def test_a_line_is_the_same_however_often_and_in_whatever_order_it_is_drawn(scene, classes):
    ground = lay_out(scene)
    first, second = SurfaceRenderer(scene, ground, classes), SurfaceRenderer(scene, ground, classes)
    once = [first.reflectance(line) for line in (3, 40)]
    again = [second.reflectance(line) for line in (40, 3)]
    assert np.array_equal(once[0], again[1])
    assert np.array_equal(once[1], again[0])
    assert not np.array_equal(first.reflectance(3), first.reflectance(4))


def test_streams_of_lines_and_seeds_are_independent(classes):
    def drawn(seed, line):
        scene = small_scene(seed=seed, samples=1000, targets=[], panels=[], layout=[area("grass", [0, 60], [0, 1000])],
                            regions=[])  # fmt: skip
        return whitened(SurfaceRenderer(scene, lay_out(scene), classes).reflectance(line), classes["grass"]).ravel()

    for other in ((1, 1), (2, 0)):
        # 5 sigma of a correlation of 12,000 pairs.
        assert abs(np.corrcoef(drawn(1, 0), drawn(*other))[0, 1]) < 5 / np.sqrt(12_000)
