"""Filters: identities that hold for any data, and matrices that cannot be inverted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.processing.classification import principal_components
from hyperval.processing.elm import two_panel_line
from hyperval.processing.filters import LINEAR_DETECTORS, design_filter, matched_filter_weights


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


def test_no_unit_response_filter_has_less_variance():
    target, mean, cov = random_problem(3)
    f = matched_filter_weights(target, mean, cov)
    rng = np.random.default_rng(4)
    for _ in range(50):
        w = f.weights + 0.1 * rng.standard_normal(12)
        w = w / (w @ (target - mean))
        assert w @ cov @ w >= f.variance(cov) - 1e-15


def test_both_readings_of_cem_agree_on_zero_mean_data():
    target, _, cov = random_problem(5)
    zero = np.zeros(12)
    assert design_filter("cem", target, zero, cov).weights == pytest.approx(
        design_filter("cem-correlation", target, zero, cov).weights
    )


def test_cem_and_matched_filter_are_one():
    assert LINEAR_DETECTORS["cem"] is LINEAR_DETECTORS["matched-filter"]


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


def test_principal_components_refuse_more_than_there_are():
    with pytest.raises(UsageError, match="5 principal components of 3 bands"):
        principal_components(np.eye(3), 5)


@pytest.mark.parametrize(("low", "high", "words"), [(0.6, 0.1, "brighter"), (0.1, 0.6, "no slope in 1 of 2")])
def test_elm_refusals(low, high, words):
    with pytest.raises(UsageError, match=words):
        two_panel_line([1.0, 1.0], [2.0, 1.0], low, high)
