"""Variance-based sensitivities."""

import numpy as np
import pytest

from hyperval.attribution.sensitivity import normal_design, sensitivity_indices
from hyperval.errors import UsageError


def test_a_polynomial_of_degree_two_is_met_exactly():
    z = normal_design(3, 64, seed=1)
    y = 2.0 + 3.0 * z[:, 0] + 1.0 * z[:, 1] ** 2 + 2.0 * z[:, 0] * z[:, 2]
    # variances by hand: 9, 2 (of z^2), 4
    found = sensitivity_indices(z, y)
    np.testing.assert_allclose(found.first[0], np.array([9, 2, 0]) / 15, atol=1e-10)
    np.testing.assert_allclose(found.total[0], np.array([13, 2, 4]) / 15, atol=1e-10)
    assert found.standard_deviation[0] == pytest.approx(np.sqrt(15))
    assert found.predictivity[0] == pytest.approx(1.0)


def test_agrees_with_the_estimator_of_jansen():
    # Jansen 1999: total = E[(f(A) - f(A with column i of B))^2] / (2 V), 2e5 pairs: its error is below 0.01.
    def f(z):
        return np.exp(0.3 * z[:, 0]) + 0.5 * z[:, 1] * np.tanh(z[:, 0])

    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 200_000, 2))
    variance = np.var(f(a))
    total = []
    for i in range(2):
        mixed = a.copy()
        mixed[:, i] = b[:, i]
        total.append(np.mean((f(a) - f(mixed)) ** 2) / (2 * variance))
    z = normal_design(2, 512, seed=3)
    found = sensitivity_indices(z, f(z))
    np.testing.assert_allclose(found.total[0], total, atol=0.05)
    assert 0.9 < found.predictivity[0] < 1.0


def test_says_when_the_fit_is_worth_nothing():
    z = normal_design(2, 256, seed=4)
    found = sensitivity_indices(z, np.sin(9.0 * z[:, 0]))
    assert found.predictivity[0] < 0.3


def test_a_quantity_that_does_not_move_has_no_shares():
    z = normal_design(2, 32, seed=5)
    assert np.isnan(sensitivity_indices(z, np.full(32, 0.7)).total).all()


def test_too_few_samples_are_refused():
    with pytest.raises(UsageError, match="at least 132"):
        normal_design(10, 100, seed=0)
