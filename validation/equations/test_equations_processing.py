"""Equations 3.21-3.33 against numbers worked out by hand, identities and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr
from score_classes import classes, log_alarms, roc_of, thresholds

from hyperval.model import (
    PositiveDefinite,
    beta_fill,
    cem_correlation_weights,
    class_threshold,
    design_filter,
    detection_at,
    detection_probability,
    false_alarm_grid,
    feature_covariance,
    features,
    greatest_class_false_alarm,
    log_false_alarm,
    matched_filter_weights,
    principal_components,
    retrieved_covariance,
    retrieved_reflectance,
    thresholds_at,
    two_panel_line,
)
from hyperval.products import RocCurve

# The worked filter: mean (1, 1), target (2, 3), covariance diag(1, 4); d = (1, 2).
MEAN, TARGET, COVARIANCE = [1.0, 1.0], [2.0, 3.0], [[1.0, 0.0], [0.0, 4.0]]


def test_elm_by_hand():
    # L(0.1) = 3, L(0.6) = 8: k = 10, b = 2; L = 5 is rho 0.3; a variance of 4 becomes 0.04.
    line = two_panel_line([3.0], [8.0])
    assert (line.gain[0], line.offset[0]) == pytest.approx((10.0, 2.0))
    assert retrieved_reflectance(line, [5.0]) == pytest.approx([0.3])
    assert retrieved_covariance(line, [[4.0]]) == pytest.approx(np.array([[0.04]]))


def test_3_21_features_by_hand():
    psi = np.eye(3)[[0, 2]]  # unit rows pick channels
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
    assert f.weights @ COVARIANCE @ f.weights == pytest.approx(1 / 2)  # 1 / (d^T Sigma^-1 d)
    assert design_filter("cem", TARGET, MEAN, COVARIANCE).weights == pytest.approx(f.weights)
    assert design_filter("smf", TARGET, MEAN, COVARIANCE).weights == pytest.approx(np.array([1.0, 0.5]) / np.sqrt(2))


def test_cem_with_the_correlation_matrix_by_hand():
    # R = [[2, 1], [1, 5]], R^-1 = [[5, -1], [-1, 2]] / 9, R^-1 t = (7, 4) / 9, t^T R^-1 t = 26 / 9.
    f = cem_correlation_weights(TARGET, MEAN, COVARIANCE)
    assert f.weights == pytest.approx([7 / 26, 4 / 26])
    assert (f.offset, float(f.score(TARGET))) == pytest.approx((0.0, 1.0))


def test_solve_by_hand():
    inverted = PositiveDefinite(np.diag([1.0, 4.0]))
    assert inverted.solve(np.array([1.0, 2.0])) == pytest.approx([1.0, 0.5])
    assert inverted.condition == pytest.approx(1.0)  # a diagonal matrix scales to the unit matrix


def test_3_30_threshold_by_hand():
    # Phi(-2) = 0.0227501319 and Phi(-5.99780702) = 1e-9.
    c = classes((1.0, 0.5, 0.1))
    found = class_threshold(np.log([[0.0227501319481792, 1e-9]]), c, 0)
    assert found[0] == pytest.approx([0.7, 1.099780702], rel=1e-8)
    # The printed sign would put the threshold at 0.3, where the false-alarm probability is 0.977.
    assert np.exp(log_alarms(0.3, c)) == pytest.approx([0.977249868])


def test_3_32_preset_of_the_worst_class_by_hand():
    # At 0.7 the first class has Phi(-2), the second Phi(-1) = 0.158655254; a class of no area does not count.
    scores = classes((0.9, 0.5, 0.1), (0.1, 0.5, 0.2), (0.0, 9.0, 1.0))
    assert greatest_class_false_alarm(np.array([0.7]), scores) == pytest.approx([0.158655254], rel=1e-8)


def test_3_31_detection_by_hand():
    x, one = np.array([[2.0]]), np.ones((1, 1))
    assert detection_probability(x, 3.0 * one, 0.5 * one, one) == pytest.approx(np.array([[0.977249868]]))  # Phi(2)
    two = detection_probability(x, np.array([[0.0, 4.0]]), np.ones((1, 2)), np.array([[0.5, 0.5]]))
    assert two == pytest.approx(np.array([[0.5]]))
    # Two pixels that each miss with 1/2: an object is found with 3/4.
    found = detection_probability(x, np.full((1, 1, 2), 2.0), np.ones((1, 1, 2)), np.ones((1, 1)))
    assert found == pytest.approx(np.array([[0.75]]))


CLASSES = classes((0.6, 0.0, 0.2), (0.3, 0.1, 0.3), (0.1, -0.2, 0.1, 5.0))


def test_3_33_false_alarms_by_hand_and_heavy_tail():
    # 0.7 * Phi(-1) + 0.3 * Phi(-2) at x = 1
    two = classes((0.7, 0.0, 1.0), (0.3, 0.0, 0.5))
    value, _ = log_false_alarm(np.array([1.0]), two)
    assert np.exp(value) == pytest.approx([0.7 * 0.158655254 + 0.3 * 0.022750132], rel=1e-8)
    # t with 3 degrees of freedom and sd 1 has scale 1/sqrt(3): at x = 2, z = 2 sqrt(3), z/sqrt(3) = 2;
    # the closed form is 1/2 - (2/5 + atan 2)/pi = 0.0202561...
    tail = 0.5 - (0.4 + np.arctan(2.0)) / np.pi
    assert np.exp(log_alarms(2.0, classes((1.0, 0.0, 1.0, 3.0)))) == pytest.approx([tail], rel=1e-10)


def test_threshold_inverts_the_false_alarms_down_to_1e_9():
    grid = false_alarm_grid()
    assert grid[0] == pytest.approx(1e-9)
    x = thresholds_at(grid[None], CLASSES)[0]
    assert log_alarms(x, CLASSES) == pytest.approx(np.log(grid), abs=1e-9)


def test_3_30_to_3_33_the_printed_procedure_gives_the_same_curve():
    sweep = roc_of(0.8, 0.25, 1.0, CLASSES)
    preset = np.log(np.logspace(-11, -0.001, 600))[None]
    x_m = np.concatenate([class_threshold(preset, CLASSES, m) for m in np.flatnonzero(CLASSES.fraction[0])])
    x = x_m.max(axis=0)  # (3.30)
    pd = ndtr((0.8 - x_m) / 0.25).min(axis=0)  # (3.31), (3.32)
    pfa = np.exp(log_alarms(x, CLASSES))  # (3.33)
    # The points of the procedure lie on the curve: P_FA and threshold agree exactly.
    assert thresholds(pfa[pfa < 0.9], CLASSES) == pytest.approx(x[pfa < 0.9], abs=1e-9)
    grid = false_alarm_grid()
    inside = grid[(grid > pfa[0]) & (grid < pfa[-1])]
    assert inside.size > 150
    steps = RocCurve(pfa, pd, pd, pd, x)
    assert detection_at(steps, inside) == pytest.approx(sweep.detection(inside[None])[0], abs=2e-5)  # interpolation


def test_roc_by_monte_carlo():
    """1e6 background and 1e6 target scores; z of P_FA and P_D at 5 thresholds, |z| < 5, false failure 6e-6."""
    rng = np.random.default_rng(333)
    n = 1_000_000
    which = rng.choice(3, n, p=CLASSES.fraction[0])
    z = rng.standard_normal(n)
    t = stats.t.rvs(5, size=n, random_state=rng) * np.sqrt(3 / 5)
    mean, sd = CLASSES.mean[0], CLASSES.sd[0]
    score = mean[which] + sd[which] * np.where(which == 2, t, z)
    fill = beta_fill(0.6, 0.15)
    target = roc_of(fill.values, np.full(fill.values.size, 0.2), fill.weights, CLASSES)
    hits = rng.choice(fill.values, n, p=fill.weights) + 0.2 * rng.standard_normal(n)
    grid = np.array([[1e-4, 1e-3, 1e-2, 1e-1, 0.3]])
    for pfa, pd, x in zip(grid[0], target.detection(grid)[0], target.thresholds(grid)[0], strict=True):
        assert abs((score > x).mean() - pfa) < 5 * np.sqrt(pfa * (1 - pfa) / n)
        assert abs((hits > x).mean() - pd) < 5 * np.sqrt(pd * (1 - pd) / n)
