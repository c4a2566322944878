"""Equations 3.21-3.33 against numbers worked out by hand, identities and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.processing.elm_model import retrieved_covariance, retrieved_reflectance, two_panel_line
from hyperval.processing.features import feature_covariance, features, principal_components
from hyperval.processing.filters import (
    cem_correlation_weights,
    correlation_filter,
    design_filter,
    matched_filter_weights,
    solve_positive_definite,
)
from hyperval.processing.roc_model import (
    ClassScore,
    TargetScore,
    class_by_class_roc,
    class_threshold,
    detection_probability,
    false_alarm_grid,
    greatest_class_false_alarm,
    log_false_alarm,
    object_detection_probability,
    predicted_roc,
    score_mean,
    score_sd,
    target_score_moments,
    threshold_at,
)
from hyperval.processing.roc_reading import detection_at
from hyperval.scene.fill import beta_fill

# The worked filter: mean (1, 1), target (2, 3), covariance diag(1, 4); d = (1, 2).
MEAN, TARGET, COVARIANCE = [1.0, 1.0], [2.0, 3.0], [[1.0, 0.0], [0.0, 4.0]]


def test_elm_by_hand():
    # L(0.1) = 3, L(0.6) = 8: k = 10, b = 2; L = 5 is rho 0.3; a variance of 4 becomes 0.04.
    line = two_panel_line([3.0], [8.0])
    assert (line.gain[0], line.offset[0]) == pytest.approx((10.0, 2.0))
    assert retrieved_reflectance(line, [5.0]) == pytest.approx([0.3])
    assert retrieved_covariance(line, [[4.0]]) == pytest.approx(np.array([[0.04]]))


def test_3_21_features_by_hand():
    psi = np.eye(3)[[0, 2]]
    assert features(psi, [[1.0, 2.0, 3.0]]) == pytest.approx(np.array([[1.0, 3.0]]))
    assert feature_covariance(psi, np.diag([1.0, 2.0, 3.0])) == pytest.approx(np.diag([1.0, 3.0]))
    # [[2, 1], [1, 2]] has eigenvalues 3 and 1 along (1, 1) and (1, -1).
    cov = np.array([[2.0, 1.0], [1.0, 2.0]])
    assert np.abs(principal_components(cov, 1)) == pytest.approx(np.array([[1, 1]]) / np.sqrt(2))
    assert feature_covariance(principal_components(cov, 2), cov) == pytest.approx(np.diag([3.0, 1.0]), abs=1e-12)


def test_3_22_to_3_25_matched_filter_by_hand():
    # Sigma^-1 d = (1, 0.5); d^T Sigma^-1 d = 2; w = (0.5, 0.25); offset w.mean = 0.75.
    f = matched_filter_weights(TARGET, MEAN, COVARIANCE)
    assert f.weights == pytest.approx([0.5, 0.25])
    assert f.offset == pytest.approx(0.75)
    assert f.score([TARGET, MEAN]) == pytest.approx([1.0, 0.0])
    assert f.variance(COVARIANCE) == pytest.approx(1 / 2)  # 1 / (d^T Sigma^-1 d)
    assert design_filter("cem", TARGET, MEAN, COVARIANCE).weights == pytest.approx(f.weights)


def test_cem_with_the_correlation_matrix_by_hand():
    # R = [[2, 1], [1, 5]], R^-1 = [[5, -1], [-1, 2]] / 9, R^-1 t = (7, 4) / 9, t^T R^-1 t = 26 / 9.
    f = cem_correlation_weights(TARGET, MEAN, COVARIANCE)
    assert f.weights == pytest.approx([7 / 26, 4 / 26])
    assert (f.offset, float(f.score(TARGET))) == pytest.approx((0.0, 1.0))
    assert correlation_filter(TARGET, [[2.0, 1.0], [1.0, 5.0]]).weights == pytest.approx(f.weights)


def test_solve_by_hand():
    x, condition = solve_positive_definite(np.diag([1.0, 4.0]), np.array([1.0, 2.0]))
    assert x == pytest.approx([1.0, 0.5])
    assert condition == pytest.approx(1.0)  # a diagonal matrix scales to the unit matrix


def test_3_26_to_3_29_scores_by_hand():
    f = matched_filter_weights(TARGET, MEAN, COVARIANCE)
    assert score_mean(f, [1.0, 3.0]) == pytest.approx(0.5)
    assert score_sd(f, np.diag([4.0, 16.0])) == pytest.approx(np.sqrt(0.25 * 4 + 0.0625 * 16))
    # Mixed pixel of a class at score 0.5: f + (1 - f) 0.5 = 0.7 at f = 0.4; Var f = 0.01:
    # 0.17 * 0.02 + 0.37 * 0.5 + 0.001 + 0.01 * 0.25 = 0.1919
    mean, sd = target_score_moments(beta_fill(0.4, 0.1), 0.5, 0.02, 0.5, 0.001)
    assert mean == pytest.approx(0.7)
    assert sd**2 == pytest.approx(0.1919)


def test_3_28_random_fill_by_monte_carlo():
    """1e6 mixed pixels; z from 200 batches, |z| < 5, false failure 1e-6."""
    rng = np.random.default_rng(328)
    n, fill = 1_000_000, beta_fill(0.3, 0.1)
    f = rng.choice(fill.values, n, p=fill.weights)
    score = f * rng.normal(1, 0.2, n) + (1 - f) * rng.normal(0.1, 0.3, n) + rng.normal(0, 0.05, n)
    mean, sd = target_score_moments(fill, 0.1, 0.04, 0.09, 0.0025)
    batch = score.reshape(200, -1)
    for found, expected in ((batch.mean(axis=1), mean), (batch.var(axis=1, ddof=1), sd**2)):
        assert abs(found.mean() - expected) < 5 * found.std(ddof=1) / np.sqrt(200)


def test_3_30_threshold_by_hand():
    # Phi(-2) = 0.0227501319 and Phi(-5.99780702) = 1e-9.
    c = ClassScore(1.0, 0.5, 0.1)
    assert class_threshold(np.log([0.0227501319481792, 1e-9]), c) == pytest.approx([0.7, 1.099780702], rel=1e-8)
    # The printed sign would put the threshold at 0.3, where the false-alarm probability is 0.977.
    assert np.exp(log_false_alarm(0.3, [c])) == pytest.approx(0.977249868)


def test_3_32_preset_of_the_worst_class_by_hand():
    # At 0.7 the first class has Phi(-2), the second Phi(-1) = 0.158655254; a class of no area does not count.
    classes = [ClassScore(0.9, 0.5, 0.1), ClassScore(0.1, 0.5, 0.2), ClassScore(0.0, 9.0, 1.0)]
    assert greatest_class_false_alarm([0.7], classes) == pytest.approx([0.158655254], rel=1e-8)


def test_3_31_detection_by_hand():
    target = TargetScore(np.array([3.0]), np.array([0.5]), np.ones(1))
    assert detection_probability([2.0], target) == pytest.approx([0.977249868])  # Phi(2)
    two = TargetScore(np.array([0.0, 4.0]), np.array([1.0, 1.0]), np.array([0.5, 0.5]))
    assert detection_probability([2.0], two) == pytest.approx([0.5])
    # Two pixels that each miss with 1/2: an object is found with 3/4.
    assert object_detection_probability(np.array([2.0]), np.array([[2.0, 2.0]]), np.ones((1, 2))) == pytest.approx(
        [0.75]
    )


CLASSES = [ClassScore(0.6, 0.0, 0.2), ClassScore(0.3, 0.1, 0.3), ClassScore(0.1, -0.2, 0.1, tail_dof=5.0)]


def test_3_33_false_alarms_by_hand_and_heavy_tail():
    # 0.7 * Phi(-1) + 0.3 * Phi(-2) at x = 1
    two = [ClassScore(0.7, 0.0, 1.0), ClassScore(0.3, 0.0, 0.5)]
    assert np.exp(log_false_alarm(1.0, two)) == pytest.approx(0.7 * 0.158655254 + 0.3 * 0.022750132, rel=1e-8)
    # t with 3 degrees of freedom and sd 1 has scale 1/sqrt(3): at x = 2, z = 2 sqrt(3), z/sqrt(3) = 2;
    # the closed form is 1/2 - (2/5 + atan 2)/pi = 0.0202561...
    tail = 0.5 - (0.4 + np.arctan(2.0)) / np.pi
    assert np.exp(log_false_alarm(2.0, [ClassScore(1.0, 0.0, 1.0, 3.0)])) == pytest.approx(tail, rel=1e-10)


def test_threshold_inverts_the_false_alarms_down_to_1e_9():
    grid = false_alarm_grid()
    assert grid[0] == pytest.approx(1e-9)
    assert log_false_alarm(threshold_at(grid, CLASSES), CLASSES) == pytest.approx(np.log(grid), abs=1e-9)


def test_3_30_to_3_33_the_printed_procedure_gives_the_same_curve():
    sweep = predicted_roc(TargetScore(np.array([0.8]), np.array([0.25]), np.ones(1)), CLASSES)
    steps = class_by_class_roc(0.8, 0.25, CLASSES, np.logspace(-11, -0.001, 600))
    # The points of the procedure lie on the curve: P_FA and threshold agree exactly.
    assert log_false_alarm(steps.threshold, CLASSES) == pytest.approx(np.log(steps.pfa), abs=1e-12)
    assert threshold_at(steps.pfa[steps.pfa < 0.9], CLASSES) == pytest.approx(
        steps.threshold[steps.pfa < 0.9], abs=1e-9
    )
    inside = (sweep.pfa > steps.pfa[0]) & (sweep.pfa < steps.pfa[-1])
    assert inside.sum() > 150
    assert detection_at(steps, sweep.pfa[inside]) == pytest.approx(sweep.pd[inside], abs=2e-5)  # interpolation


def test_roc_by_monte_carlo():
    """1e6 background and 1e6 target scores; z of P_FA and P_D at 5 thresholds, |z| < 5, false failure 6e-6."""
    rng = np.random.default_rng(333)
    n = 1_000_000
    which = rng.choice(3, n, p=[c.fraction for c in CLASSES])
    z = rng.standard_normal(n)
    t = stats.t.rvs(5, size=n, random_state=rng) * np.sqrt(3 / 5)
    mean, sd = np.array([c.mean for c in CLASSES]), np.array([c.sd for c in CLASSES])
    score = mean[which] + sd[which] * np.where(which == 2, t, z)
    fill = beta_fill(0.6, 0.15)
    target = TargetScore(fill.values, np.full(fill.values.size, 0.2), fill.weights)
    hits = rng.choice(fill.values, n, p=fill.weights) + 0.2 * rng.standard_normal(n)
    curve = predicted_roc(target, CLASSES, [1e-4, 1e-3, 1e-2, 1e-1, 0.3])
    for pfa, pd, x in zip(curve.pfa, curve.pd, curve.threshold, strict=True):
        assert abs((score > x).mean() - pfa) < 5 * np.sqrt(pfa * (1 - pfa) / n)
        assert abs((hits > x).mean() - pd) < 5 * np.sqrt(pd * (1 - pd) / n)
