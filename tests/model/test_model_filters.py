"""Filters: identities that hold for any data, and matrices that cannot be inverted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from hyperval.errors import UsageError
from hyperval.model import (
    PositiveDefinite,
    cem_correlation_weights,
    design_filter,
    matched_filter_weights,
    own_mean_sampling,
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
