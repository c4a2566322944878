"""Filters and unmixing: identities for any data, solutions by another route, matrices that cannot be inverted."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from hyperval import model
from hyperval.errors import UsageError

# Mean score of the pixels that a filter was made of: its chance and its bias, over simulated images.
BANDS, EACH = 24, 900
X = np.linspace(0.0, 1.0, BANDS)
TARGET = 0.4 - 0.2 * X
CLASSES = ((0.1 + 0.3 * X, 0.06), (0.25 + 0.05 * np.sin(5.0 * X), 0.015))  # mean, standard deviation


def spread(sd):
    return sd**2 * (np.exp(-0.5 * (np.subtract.outer(X, X) / 0.3) ** 2) + 0.04 * np.eye(BANDS))


def moments(classes):
    """Of a scene with as much of each class."""
    mean = np.mean([m for m, _ in classes], axis=0)
    return mean, np.mean([spread(sd) + np.outer(m - mean, m - mean) for m, sd in classes], axis=0)


def images(classes, count, tail_dof):
    rng = np.random.default_rng(11)
    roots = [np.linalg.cholesky(spread(sd)) for _, sd in classes]
    stratum = np.repeat(np.arange(len(classes), dtype=np.int32), EACH)
    for _ in range(count):
        parts = [m + rng.standard_normal((EACH, BANDS)) @ r.T for (m, _), r in zip(classes, roots, strict=True)]
        if tail_dof:
            widths = np.sqrt((tail_dof - 2.0) / rng.chisquare(tail_dof, (len(classes), EACH, 1)))
            parts = [m + w * (p - m) for (m, _), w, p in zip(classes, widths, parts, strict=True)]
        pixels = np.concatenate(parts)
        mean, factored = pixels.mean(axis=0), model.PositiveDefinite(np.cov(pixels.T))
        filtered = model.cem_correlation_weights(TARGET, mean, factored.matrix)
        error, bias = model.own_mean_sampling(filtered.weights, mean, factored, pixels, stratum, len(pixels))
        yield float(filtered.weights @ mean), error, bias, float(np.std(pixels @ filtered.weights)) / len(pixels) ** 0.5


@pytest.mark.simulation
@pytest.mark.parametrize(("classes", "tail_dof"), [(CLASSES[:1], 0), (CLASSES, 0), (CLASSES, 6)])
def test_intervals_hold_the_mean_of_endless_pixels(classes, tail_dof):
    """440 images each; a true rate of 5 % (2.5 % on a side) fails in one of 1,000 runs, in 300 for the three."""
    mean, whole = moments(classes)
    truth = model.cem_correlation_weights(TARGET, mean, whole).weights @ mean
    found, error, bias, plain = np.array(list(images(classes, 440, tail_dof))).T
    z = (found - bias - truth) / error
    assert np.sum(np.abs(z) > 1.96) <= stats.binom.isf(4e-4, 440, 0.05)
    assert max(np.sum(z > 1.96), np.sum(z < -1.96)) <= stats.binom.isf(2e-4, 440, 0.025)
    assert np.mean(z) == pytest.approx(0.0, abs=3.9 / 440**0.5)
    assert np.std(found) < 0.7 * np.mean(plain)  # as if the filter were not made of them


@pytest.mark.parametrize("size", [1, 2, 3, 8, 9, 60])  # odd and even ones are laid out differently
def test_solutions_and_condition_number(size):
    a = np.random.default_rng(0).normal(size=(size, size + 4))
    matrix = a @ a.T * np.outer(*[np.geomspace(1.0, 1e4, size)] * 2)
    right, factored = np.random.default_rng(2).normal(size=(size, 2)), model.PositiveDefinite(matrix)
    assert factored.solve(right) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6)
    assert factored.matrix == pytest.approx(matrix, rel=1e-12)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    # LAPACK's estimate is a lower bound, nearly always within a factor of three.
    ratio = factored.condition / np.linalg.cond(matrix * np.outer(scale, scale), 1)
    assert 0.33 < ratio < 1 + 1e-9


@pytest.mark.parametrize(("correlation", "refused"), [(0.5, False), (1 - 1e-10, False), (1 - 1e-14, True)])
def test_bands_that_are_nearly_copies_of_each_other_are_refused(correlation, refused):
    matrix = np.array([[1.0, correlation], [correlation, 1.0]]) * np.outer([1.0, 1e6], [1.0, 1e6])
    if refused:
        with pytest.raises(UsageError, match="singular to working precision"):
            model.PositiveDefinite(matrix)
        return
    expected = (1 + correlation) / (1 - correlation)
    assert model.PositiveDefinite(matrix).condition == pytest.approx(expected, rel=1e-5)


B = 12


def endmembers(m, rng):
    return np.abs(rng.normal(0.3, 0.15, (m, B)))


def noise_matrix(rng):
    a = rng.normal(size=(B, B))
    return 1e-4 * (a @ a.T + B * np.eye(B))


def by_every_support(x, e, weight):
    """The best of all supports: least squares with sum 1 on each, kept where no abundance is negative."""
    best, at = np.inf, np.zeros(len(e))
    for size in range(1, len(e) + 1):
        for chosen in combinations(range(len(e)), size):
            part = e[list(chosen)]
            normal = np.block([[part @ weight @ part.T, np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
            a = np.linalg.solve(normal, np.append(part @ weight @ x, 1.0))[:-1]
            rest = x - a @ part
            value = rest @ weight @ rest
            if a.min() > -1e-12 and value < best:
                best, at = value, np.zeros(len(e))
                at[list(chosen)] = a
    return at


@given(st.integers(0, 10_000), st.booleans())
@settings(max_examples=60)
def test_equals_the_best_of_all_supports(seed, weighted):
    rng = np.random.default_rng(seed)
    e, x = endmembers(2, rng), rng.normal(0.3, 0.2, B)
    cov = noise_matrix(rng)
    weight = np.linalg.inv(cov) if weighted else np.eye(B)
    found = model.fully_constrained(x, e, model.PositiveDefinite(cov) if weighted else None)
    assert found.sum() == pytest.approx(1.0, abs=1e-12)
    assert found.min() >= 0.0
    assert found == pytest.approx(by_every_support(x, e, weight), abs=1e-8)


def test_each_spectrum_may_have_endmembers_of_its_own():
    rng = np.random.default_rng(6)
    e, x = np.stack([endmembers(2, rng) for _ in range(5)]), rng.normal(0.3, 0.2, (5, B))
    one_by_one = [model.fully_constrained(pixel, own) for pixel, own in zip(x, e, strict=True)]
    assert model.fully_constrained(x, e) == pytest.approx(np.array(one_by_one), abs=1e-12)


SCALES = st.integers(-30, 30).map(lambda k: 10.0**k)


@settings(max_examples=40, derandomize=True)
@given(st.integers(0, 10_000), SCALES, st.sampled_from(["full", "singular", "nearly singular", "zero", "nan"]))
def test_a_filter_meets_its_two_conditions_or_is_refused(seed, scale, kind):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T * scale**2
    if kind == "singular":
        covariance[:, 0] = covariance[0] = 0.0
    elif kind == "nearly singular":
        covariance = np.outer(root[0], root[0]) * scale**2 + 1e-13 * scale**2 * np.eye(6)
    elif kind == "zero":
        covariance[:] = 0.0
    elif kind == "nan":
        covariance[2, 2] = np.nan
    mean, target = scale * rng.uniform(1, 2, 6), scale * rng.uniform(3, 4, 6)
    for make in (model.matched_filter_weights, model.spectral_matched_filter, model.cem_correlation_weights):
        try:
            found = make(target, mean, covariance)
        except UsageError:
            assert kind != "full"
            continue
        assert kind not in ("zero", "nan", "singular")
        assert np.all(np.isfinite(found.weights))
        slack = 1e-12 * model.PositiveDefinite(covariance).condition + 1e-9
        if make is model.matched_filter_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
            assert found.score(mean) == pytest.approx(0.0, abs=slack)
        elif make is model.cem_correlation_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
    with pytest.raises(UsageError):
        model.matched_filter_weights(mean, mean, root @ root.T * scale**2)
