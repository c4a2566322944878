"""Gaussian classification: closed forms, bounds, errors of pixels, and pixels that err together."""

import numpy as np
import pytest
from scipy import special, stats

from hyperval import model
from hyperval.errors import UsageError
from hyperval.products import ClassificationError


def law(mean, spread=1.0, dof=np.inf):
    return model.ClassLaw(np.asarray(mean, dtype=float), spread * np.eye(len(mean)), dof)


def test_equal_covariances_have_the_closed_form():
    # Two classes 2.5 standard deviations apart: error Phi(-1.25), which the estimate is for equal covariances.
    found = model.predicted_error([law([0.0, 0.0]), law([2.5, 0.0])], np.random.default_rng(1), 40_000)
    exact = special.ndtr(-1.25)
    assert found.approximation == pytest.approx(exact, rel=1e-12)
    assert found.distance == pytest.approx(2.5**2 / 8)
    # 80,000 pixels: four standard deviations.
    assert found.error == pytest.approx(exact, abs=4 * np.sqrt(exact / 80_000))
    assert found.lower < found.error < found.upper


def test_classifier_is_quadratic_discriminant_analysis():
    # Against the log density itself.
    laws = [law([0.0, 1.0], 2.0), law([1.0, 0.0], 0.5)]
    x = np.random.default_rng(6).normal(size=(200, 2))
    from scipy.stats import multivariate_normal

    density = [multivariate_normal.logpdf(x, one.mean, one.covariance) for one in laws]
    assert np.array_equal(model.GaussianClassifier(laws).classify(x), np.argmax(density, axis=0))


def test_pixels_that_err_together_count_once():
    # Blocks share their pixel: 25 pixels of each block are one. The interval must be that of the blocks.
    laws, rng = [law([0.0]), law([2.0])], np.random.default_rng(8)
    exact, inside, effective = special.ndtr(-1.0), 0, []
    for _ in range(150):
        x = [np.repeat(one.draw(60, rng), 25, axis=0) for one in laws]
        found = model.measured_error(laws, x, [np.repeat(np.arange(60), 25)] * 2)
        inside += found.lower <= exact <= found.upper
        effective.append(found.effective_n)
    # The spread between blocks is itself estimated, from 60 of each class: a little below 95 %.
    assert inside >= 130
    assert np.median(effective) == pytest.approx(120, rel=0.15)


def test_no_error_at_all_gives_the_one_sided_limit():
    laws = [law([0.0]), law([50.0])]
    x = [one.draw(100, np.random.default_rng(9)) for one in laws]
    found = model.measured_error(laws, x, [np.arange(100)] * 2)
    assert (found.error, found.lower, found.n) == (0.0, 0.0, 200)
    assert found.upper == pytest.approx(1 - 0.025 ** (1 / 200))


def test_features():
    centre = np.array([450.0, 550.0, 650.0, 800.0])
    usable = np.array([True, True, False, True])
    assert model.feature_bands(centre, usable, []).tolist() == [0, 1, 3]
    assert model.feature_bands(centre, usable, [640.0, 790.0]).tolist() == [1, 3]
    with pytest.raises(UsageError, match="share the band at 550 nm"):
        model.feature_bands(centre, usable, [560.0, 600.0])
    laws = [law([0.0, 0.0, 0.0], 0.01), law([3.0, 4.0, 0.0], 0.01)]
    assert model.class_features(laws, None) == pytest.approx(np.eye(3))
    # The classes differ along (3, 4, 0): that is the first component.
    assert model.class_features(laws, 1) == pytest.approx(np.array([[0.6, 0.8, 0.0]]), abs=1e-9)


def test_pixels_of_a_t_law_have_the_covariance_that_is_stated():
    # 200,000 pixels of 8 degrees of freedom: a variance is known to 0.5 %.
    covariance = np.array([[2.0, 0.6], [0.6, 1.0]])
    x = model.ClassLaw(np.zeros(2), covariance, 8.0).draw(200_000, np.random.default_rng(10))
    assert np.cov(x.T) == pytest.approx(covariance, rel=0.025)


def test_distances_of_three_classes_take_the_nearest_pair():
    laws = [model.ClassLaw(np.array([at]), np.eye(1)) for at in (0.0, 1.0, 4.0)]
    found = model.with_distances(ClassificationError(0.2, 0.1, 0.3, 100), laws)
    distance = [d**2 / 8 for d in (1.0, 4.0, 3.0)]
    assert found.distance == pytest.approx(min(distance))
    pair = [0.5 - 0.5 * np.sqrt(1 - np.exp(-2 * d)) for d in distance]
    assert found.bound_lower == pytest.approx(2 / 3 * max(pair))
    assert found.bound_upper == pytest.approx(min(sum(np.exp(-d) for d in distance) / 3, 2 / 3))
    assert found.approximation == pytest.approx(sum(2 / 3 * stats.norm.cdf(-d / 2) for d in (1.0, 4.0, 3.0)))
