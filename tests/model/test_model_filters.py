"""Filters and unmixing: identities for any data, solutions by another route, matrices that cannot be inverted."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from exact_forms import abundance_covariance, sum_to_one_gain
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from hyperval.errors import UsageError
from hyperval.model import (
    PositiveDefinite,
    cem_correlation_weights,
    condition_number,
    design_filter,
    factor,
    fully_constrained,
    matched_filter_weights,
    near_singular,
    own_mean_sampling,
    packed,
    solved,
    spectral_matched_filter,
    two_panel_line,
)


def random_problem(seed: int, bands: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((bands, bands))
    return rng.random(bands), rng.random(bands), a @ a.T / bands + 0.05 * np.eye(bands)


@given(st.integers(0, 10_000), st.floats(0.0, 1.0))
@settings(max_examples=50)
def test_unit_response_and_linearity(seed, fill):
    target, mean, cov = random_problem(seed)
    f = matched_filter_weights(target, mean, cov)
    assert f.score(target) == pytest.approx(1.0)
    assert f.score(fill * target + (1 - fill) * mean) == pytest.approx(fill, abs=1e-9)
    d = target - mean
    assert f.variance(cov) == pytest.approx(1 / (d @ np.linalg.inv(cov) @ d), rel=1e-8)


@given(st.integers(0, 10_000))
@settings(max_examples=30)
def test_scores_do_not_depend_on_units_or_linear_features(seed):
    target, mean, cov = random_problem(seed)
    a = np.random.default_rng(seed + 1).standard_normal((12, 12)) + 3 * np.eye(12)
    f = matched_filter_weights(target, mean, cov)
    g = matched_filter_weights(a @ target, a @ mean, a @ cov @ a.T)
    assume(g.condition < 1e8)  # an unlucky map leaves fewer digits than are asked for
    x = np.random.default_rng(seed + 2).random((5, 12))
    assert g.score(x @ a.T) == pytest.approx(f.score(x), rel=1e-5, abs=1e-7)


def test_singular_covariance_names_rank_and_condition():
    rng = np.random.default_rng(6)
    x = rng.standard_normal((6, 12))  # six pixels of twelve bands
    with pytest.raises(UsageError, match=r"rank 5 of 12 bands, condition number"):
        matched_filter_weights(rng.random(12), rng.random(12), np.cov(x.T))


def test_dead_band_is_named():
    target, mean, cov = random_problem(7)
    cov[3, :] = cov[:, 3] = 0.0
    with pytest.raises(UsageError, match=r"1 of 12 bands have no variance \(first: band 4\)"):
        matched_filter_weights(target, mean, cov)


def test_bands_of_very_different_scale_are_no_obstacle():
    target, mean, cov = random_problem(8)
    s = np.logspace(-6, 6, 12)
    f = matched_filter_weights(target, mean, cov)
    g = matched_filter_weights(target * s, mean * s, cov * np.outer(s, s))
    assert g.weights * s == pytest.approx(f.weights, rel=1e-8)


@pytest.mark.parametrize("bad", ["nan", "target", "size", "name"])
def test_refusals(bad):
    target, mean, cov = random_problem(9)
    if bad == "nan":
        cov[2, 3] = cov[3, 2] = np.nan
    if bad == "target":
        target = mean
    if bad == "size":
        mean = mean[:-1]
    with pytest.raises(UsageError):
        design_filter("ace" if bad == "name" else "cem", target, mean, cov)


@pytest.mark.parametrize(("low", "high", "words"), [(0.6, 0.1, "brighter"), (0.1, 0.6, "no slope in 1 of 2")])
def test_elm_refusals(low, high, words):
    with pytest.raises(UsageError, match=words):
        two_panel_line([1.0, 1.0], [2.0, 1.0], low, high)


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
        mean, factored = pixels.mean(axis=0), PositiveDefinite(np.cov(pixels.T))
        filtered = cem_correlation_weights(TARGET, mean, factored.matrix)
        error, bias = own_mean_sampling(filtered.weights, mean, factored, pixels, stratum, len(pixels))
        yield float(filtered.weights @ mean), error, bias, float(np.std(pixels @ filtered.weights)) / len(pixels) ** 0.5


def test_closed_form_of_normal_pixels():
    (mean, sd), rng = CLASSES[0], np.random.default_rng(2)
    n = 60_000
    pixels = mean + rng.standard_normal((n, BANDS)) @ np.linalg.cholesky(spread(sd)).T
    own, factored = pixels.mean(axis=0), PositiveDefinite(np.cov(pixels.T))
    w = cem_correlation_weights(TARGET, own, factored.matrix).weights
    error, bias = own_mean_sampling(w, own, factored, pixels, np.zeros(n, np.int32), n)
    t, m = factored.solve(TARGET), factored.solve(own)
    s, a = TARGET @ t, own @ t / (TARGET @ t)
    p = own @ m - a**2 * s
    assert w @ own == pytest.approx(a / (1 + p), rel=1e-9)
    assert n * error**2 == pytest.approx(1 / (s * (1 + p)) + a**2 * (2 * p**2 + 4 * p) / (1 + p) ** 4, rel=0.03)
    assert n * bias == pytest.approx(-(w @ own) * (BANDS - 1 - 2 * p / (1 + p) ** 2), rel=0.03)


@pytest.mark.simulation
@pytest.mark.parametrize(("classes", "tail_dof"), [(CLASSES[:1], 0), (CLASSES, 0), (CLASSES, 6)])
def test_intervals_hold_the_mean_of_endless_pixels(classes, tail_dof):
    """440 images each; a true rate of 5 % (2.5 % on a side) fails in one of 1,000 runs, in 300 for the three."""
    mean, whole = moments(classes)
    truth = cem_correlation_weights(TARGET, mean, whole).weights @ mean
    found, error, bias, plain = np.array(list(images(classes, 440, tail_dof))).T
    z = (found - bias - truth) / error
    assert np.sum(np.abs(z) > 1.96) <= stats.binom.isf(4e-4, 440, 0.05)
    assert max(np.sum(z > 1.96), np.sum(z < -1.96)) <= stats.binom.isf(2e-4, 440, 0.025)
    assert np.mean(z) == pytest.approx(0.0, abs=3.9 / 440**0.5)
    assert np.std(found) < 0.7 * np.mean(plain)  # as if the filter were not made of them


SIZES = [1, 2, 3, 8, 9, 60]  # odd and even ones are laid out differently


def positive(size: int, seed: int = 0) -> np.ndarray:
    a = np.random.default_rng(seed).normal(size=(size, size + 4))
    return a @ a.T


@pytest.mark.parametrize("size", SIZES)
def test_solutions_and_condition_number(size):
    matrix = positive(size) * np.outer(*[np.geomspace(1.0, 1e4, size)] * 2)
    values, right = packed(matrix), np.random.default_rng(2).normal(size=(size, 2))
    cholesky = factor(values.copy(), size)
    assert cholesky is not None
    assert solved(cholesky, right) == pytest.approx(np.linalg.solve(matrix, right), rel=1e-6)
    scale = 1.0 / np.sqrt(np.diag(matrix))
    # LAPACK's estimate is a lower bound, nearly always within a factor of three.
    ratio = condition_number(values, cholesky, size) / np.linalg.cond(matrix * np.outer(scale, scale), 1)
    assert 0.33 < ratio < 1 + 1e-9


@pytest.mark.parametrize(("correlation", "suspect"), [(0.5, False), (1 - 1e-10, True)])
def test_pivots_tell_matrices_that_may_be_near_singular(correlation, suspect):
    matrix = np.array([[1.0, correlation], [correlation, 1.0]]) * np.outer([1.0, 1e6], [1.0, 1e6])
    values = packed(matrix)
    cholesky = factor(values.copy(), 2)
    assert near_singular(np.diag(matrix), cholesky) is suspect
    expected = (1 + correlation) / (1 - correlation)
    assert condition_number(values, cholesky, 2) == pytest.approx(expected, rel=1e-5)


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


@given(st.integers(2, 4), st.integers(0, 10_000), st.booleans())
@settings(max_examples=60)
def test_equals_the_best_of_all_supports(m, seed, weighted):
    rng = np.random.default_rng(seed)
    e, x = endmembers(m, rng), rng.normal(0.3, 0.2, B)
    cov = noise_matrix(rng)
    weight = np.linalg.inv(cov) if weighted else np.eye(B)
    found = fully_constrained(x, e, PositiveDefinite(cov) if weighted else None)
    assert found.sum() == pytest.approx(1.0, abs=1e-12)
    assert found.min() >= 0.0
    assert found == pytest.approx(by_every_support(x, e, weight), abs=1e-8)


def test_each_spectrum_may_have_endmembers_of_its_own():
    rng = np.random.default_rng(6)
    e, x = np.stack([endmembers(2, rng) for _ in range(5)]), rng.normal(0.3, 0.2, (5, B))
    one_by_one = [fully_constrained(pixel, own) for pixel, own in zip(x, e, strict=True)]
    assert fully_constrained(x, e) == pytest.approx(np.array(one_by_one), abs=1e-12)
    noise = PositiveDefinite(noise_matrix(rng))
    many = fully_constrained(np.stack([x, x]), e[None], noise)
    assert many[1] == pytest.approx(fully_constrained(x, e, noise), abs=1e-12)


@pytest.mark.parametrize("weighted", [False, True])
def test_error_covariance_is_that_of_pixels(weighted):
    rng = np.random.default_rng(7)
    e, cov = endmembers(3, rng), 0.05 * noise_matrix(rng)
    noise = PositiveDefinite(cov) if weighted else None
    truth = np.array([0.4, 0.35, 0.25])
    x = truth @ e + rng.multivariate_normal(np.zeros(B), cov, 20_000)
    a = fully_constrained(x[:4000], e, noise)
    assert a.min() > 0.01  # no constraint but the sum binds
    expected = abundance_covariance(e, cov, noise)
    # A variance of 4000 pixels is known to 2.2 %: four of these.
    assert np.cov(a.T) == pytest.approx(expected, abs=0.09 * np.abs(expected).max())
    assert expected.sum() == pytest.approx(0.0, abs=1e-12)  # the sum has no error
    linear = truth @ np.eye(3) + (x - truth @ e) @ sum_to_one_gain(e, noise).T
    assert linear[:4000] == pytest.approx(a, abs=1e-7)


def test_weighted_error_is_the_constrained_information_matrix():
    # (E C^-1 E^T)^-1 with the sum held: F^-1 - F^-1 1 1^T F^-1 / (1^T F^-1 1); no other weights do better.
    rng = np.random.default_rng(8)
    e, cov = endmembers(3, rng), noise_matrix(rng)
    f = np.linalg.inv(e @ np.linalg.inv(cov) @ e.T)
    expected = f - np.outer(f.sum(axis=1), f.sum(axis=0)) / f.sum()
    best = abundance_covariance(e, cov, PositiveDefinite(cov))
    assert best == pytest.approx(expected, rel=1e-8)
    assert np.all(np.diag(abundance_covariance(e, cov)) >= np.diag(best) * (1 - 1e-12))


def test_refusals_unmixing():
    with pytest.raises(UsageError, match="same bands"):
        fully_constrained(np.ones(3), np.ones((2, 4)))
    with pytest.raises(UsageError, match="finite"):
        fully_constrained(np.array([1.0, np.nan]), np.eye(2))


SCALES = st.integers(-30, 30).map(lambda k: 10.0**k)


FEW = settings(max_examples=40, derandomize=True)


@FEW
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
    for make in (matched_filter_weights, spectral_matched_filter, cem_correlation_weights):
        try:
            found = make(target, mean, covariance)
        except UsageError:
            assert kind != "full"
            continue
        assert kind not in ("zero", "nan", "singular") or make is cem_correlation_weights
        assert np.all(np.isfinite(found.weights))
        slack = 1e-12 * max(found.condition, 1.0) + 1e-9
        if make is matched_filter_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
            assert found.score(mean) == pytest.approx(0.0, abs=slack)
        elif make is cem_correlation_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
    with pytest.raises(UsageError):
        matched_filter_weights(mean, mean, root @ root.T * scale**2)


def with_eigenvalues(values):
    """A correlation-like matrix with these eigenvalues along orthonormal directions."""
    n = len(values)
    q = np.linalg.qr(np.random.default_rng(1).normal(size=(n, n)))[0]
    return q @ np.diag(values) @ q.T


def test_condition_is_that_of_the_matrix_at_unit_diagonal():
    covariance = with_eigenvalues(np.geomspace(1.0, 1e-6, 9)) * np.outer(np.arange(1, 10), np.arange(1, 10))
    sd = np.sqrt(np.diag(covariance))
    assert PositiveDefinite(covariance).condition == pytest.approx(
        np.linalg.cond(covariance / np.outer(sd, sd), 1), rel=0.3
    )


def test_a_small_eigenvalue_counts_for_the_rank_and_a_lost_one_does_not():
    values = np.ones(12)
    values[0], values[1] = 1e-10, 0.0
    with pytest.raises(UsageError, match="rank 11 of 12"):
        PositiveDefinite(with_eigenvalues(values))
