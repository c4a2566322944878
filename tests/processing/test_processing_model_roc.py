"""ROC of the model: properties over many backgrounds, limits and the printed procedure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.processing.roc_model import (
    ClassScore,
    TargetScore,
    class_by_class_roc,
    false_alarm_grid,
    log_false_alarm,
    object_detection_probability,
    predicted_roc,
    threshold_at,
)
from hyperval.processing.roc_reading import detection_at
from hyperval.scene.fill import beta_fill

ONE = np.ones(1)


def backgrounds(seed: int) -> list[ClassScore]:
    rng = np.random.default_rng(seed)
    count = rng.integers(1, 6)
    fractions = rng.dirichlet(np.ones(count))
    dof = [None if rng.random() < 0.7 else float(rng.uniform(2.5, 30)) for _ in range(count)]
    return [
        ClassScore(float(f), float(rng.normal(0, 0.3)), float(rng.uniform(0.01, 0.5)), d)
        for f, d in zip(fractions, dof, strict=True)
    ]


@given(st.integers(0, 100_000))
@settings(max_examples=60, deadline=None)
def test_the_threshold_gives_the_false_alarms_it_was_asked_for(seed):
    classes = backgrounds(seed)
    grid = false_alarm_grid()
    x = threshold_at(grid, classes)
    assert np.all(np.diff(x) <= 0)
    assert log_false_alarm(x, classes) == pytest.approx(np.log(grid), abs=1e-6)


@given(st.integers(0, 100_000), st.floats(-1, 2), st.floats(0.01, 1))
@settings(max_examples=40, deadline=None)
def test_the_printed_procedure_lies_on_the_sweep(seed, mean, sd):
    classes = backgrounds(seed)
    steps = class_by_class_roc(mean, sd, classes, np.logspace(-10, -0.5, 60))
    sweep = predicted_roc(TargetScore(np.array([mean]), np.array([sd]), ONE), classes, steps.pfa)
    assert sweep.pd == pytest.approx(steps.pd, abs=1e-7)


def test_a_curve_rises():
    curve = predicted_roc(TargetScore(np.array([0.5]), np.array([0.2]), ONE), backgrounds(1))
    assert np.all(np.diff(curve.pd) >= 0)
    assert np.all((curve.pd >= 0) & (curve.pd <= 1))
    assert np.array_equal(curve.pd_lower, curve.pd)


def test_a_target_like_its_background_is_on_the_diagonal():
    c = ClassScore(1.0, 0.2, 0.3)
    curve = predicted_roc(TargetScore(np.array([0.2]), np.array([0.3]), ONE), [c])
    assert curve.pd == pytest.approx(curve.pfa, rel=1e-6)


def test_random_fill_is_not_its_mean():
    """With a spread of fills the tail of the fullest pixels decides at low false-alarm rates."""
    fill = beta_fill(0.3, 0.15)
    classes = [ClassScore(1.0, 0.0, 0.1)]
    spread = predicted_roc(TargetScore(fill.values, np.full(48, 0.1), fill.weights), classes)
    fixed = predicted_roc(TargetScore(np.array([0.3]), np.array([0.1]), ONE), classes)
    assert detection_at(spread, 1e-8) > 2 * detection_at(fixed, 1e-8)


def test_heavy_tails_cost_detection():
    target = TargetScore(np.array([0.6]), np.array([0.1]), ONE)
    gauss = predicted_roc(target, [ClassScore(1.0, 0.0, 0.1)])
    tail = predicted_roc(target, [ClassScore(1.0, 0.0, 0.1, tail_dof=4.0)])
    assert detection_at(tail, 1e-6) < 0.5 < detection_at(gauss, 1e-6)


def test_many_degrees_of_freedom_are_gaussian():
    a = log_false_alarm([0.3, 0.5], [ClassScore(1.0, 0.0, 0.1, tail_dof=1e7)])
    assert a == pytest.approx(log_false_alarm([0.3, 0.5], [ClassScore(1.0, 0.0, 0.1)]), rel=1e-4)


def test_an_object_is_found_at_least_as_often_as_its_best_pixel():
    means = np.array([[0.6, 0.3, 0.1], [0.5, 0.4, 0.0]])
    sds = np.full((2, 3), 0.1)
    x = np.linspace(-0.5, 1.0, 31)
    whole = object_detection_probability(x, means, sds)
    best = object_detection_probability(x, means[:, :1], sds[:, :1])
    assert np.all(whole >= best - 1e-15)


def test_curve_is_not_extrapolated():
    curve = predicted_roc(TargetScore(np.array([0.5]), np.array([0.2]), ONE), backgrounds(2), [1e-4, 1e-3])
    assert np.isnan(detection_at(curve, 1e-5))


def test_no_background():
    with pytest.raises(UsageError, match="no background class"):
        threshold_at([1e-3], [ClassScore(0.0, 0.0, 1.0)])
