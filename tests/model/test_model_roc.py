"""ROC of the model: properties over many backgrounds, limits and the printed procedure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from score_classes import classes, log_alarms, printed_procedure, roc_of, thresholds

from hyperval.errors import UsageError
from hyperval.model import ClassScores, RocScores, beta_fill, false_alarm_grid, object_detection_probability


def backgrounds(seed: int) -> ClassScores:
    rng = np.random.default_rng(seed)
    count = rng.integers(1, 6)
    fractions = rng.dirichlet(np.ones(count))
    dof = [np.inf if rng.random() < 0.7 else float(rng.uniform(2.5, 30)) for _ in range(count)]
    return classes(
        *((float(f), float(rng.normal(0, 0.3)), float(rng.uniform(0.01, 0.5)), d)
          for f, d in zip(fractions, dof, strict=True))
    )  # fmt: skip


def curve(target: RocScores, pfa=None) -> np.ndarray:
    return target.detection(np.atleast_2d(false_alarm_grid() if pfa is None else np.asarray(pfa, dtype=float)))[0]


@given(st.integers(0, 100_000))
@settings(max_examples=60)
def test_the_threshold_gives_the_false_alarms_it_was_asked_for(seed):
    scores, grid = backgrounds(seed), false_alarm_grid()
    x = thresholds(grid, scores)
    assert np.all(np.diff(x) <= 0)
    assert log_alarms(x, scores) == pytest.approx(np.log(grid), abs=1e-6)


@given(st.integers(0, 100_000), st.floats(-1, 2), st.floats(0.01, 1))
@settings(max_examples=40)
def test_the_printed_procedure_lies_on_the_sweep(seed, mean, sd):
    scores = backgrounds(seed)
    pfa, pd, _ = printed_procedure(mean, sd, scores, np.logspace(-10, -0.5, 60))
    assert curve(roc_of(mean, sd, 1.0, scores), pfa) == pytest.approx(pd, abs=1e-7)


def test_a_curve_rises():
    pd = curve(roc_of(0.5, 0.2, 1.0, backgrounds(1)))
    assert np.all(np.diff(pd) >= 0)
    assert np.all((pd >= 0) & (pd <= 1))


def test_a_target_like_its_background_is_on_the_diagonal():
    assert curve(roc_of(0.2, 0.3, 1.0, classes((1.0, 0.2, 0.3)))) == pytest.approx(false_alarm_grid(), rel=1e-6)


def test_random_fill_is_not_its_mean():
    """With a spread of fills the tail of the fullest pixels decides at low false-alarm rates."""
    fill, background = beta_fill(0.3, 0.15), classes((1.0, 0.0, 0.1))
    spread = roc_of(fill.values, np.full(48, 0.1), fill.weights, background)
    assert curve(spread, 1e-8) > 2 * curve(roc_of(0.3, 0.1, 1.0, background), 1e-8)


def test_heavy_tails_cost_detection():
    gauss, tail = (roc_of(0.6, 0.1, 1.0, classes((1.0, 0.0, 0.1, dof))) for dof in (np.inf, 4.0))
    assert curve(tail, 1e-6) < 0.5 < curve(gauss, 1e-6)


def test_many_degrees_of_freedom_are_gaussian():
    a, b = (log_alarms([0.3, 0.5], classes((1.0, 0.0, 0.1, dof))) for dof in (1e7, np.inf))
    assert a == pytest.approx(b, rel=1e-4)


def test_an_object_is_found_at_least_as_often_as_its_best_pixel():
    means = np.array([[[0.6, 0.3, 0.1], [0.5, 0.4, 0.0]]])
    sds = np.full((1, 2, 3), 0.1)
    x = np.linspace(-0.5, 1.0, 31)[None]
    whole = object_detection_probability(x, means, sds)
    best = object_detection_probability(x, means[..., :1], sds[..., :1])
    assert np.all(whole >= best - 1e-15)


def test_no_background():
    with pytest.raises(UsageError, match="no background class"):
        thresholds([1e-3], classes((0.0, 0.0, 1.0)))
