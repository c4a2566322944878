"""Variance-based sensitivities."""

from types import SimpleNamespace

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.model import UncertainInput
from hyperval.uncertainty.attribution import run
from hyperval.uncertainty.attribution.ranking import Candidate
from hyperval.uncertainty.attribution.run import quadratic_design, sensitivity_indices


def test_a_polynomial_of_degree_two_is_met_exactly():
    def f(z):
        return 2.0 + 3.0 * z[:, 0] + 1.0 * z[:, 1] ** 2 + 2.0 * z[:, 0] * z[:, 2]

    z, other = quadratic_design(3), np.random.default_rng(1).normal(size=(9, 3))
    found = sensitivity_indices(z, f(z), (other, f(other)))
    # variances by hand: 9, 2 (of z^2), 4
    np.testing.assert_allclose(found.first[0], np.array([9, 2, 0]) / 15, atol=1e-10)
    np.testing.assert_allclose(found.total[0], np.array([13, 2, 4]) / 15, atol=1e-10)
    assert found.standard_deviation[0] == pytest.approx(np.sqrt(15))
    assert found.misfit[0] == pytest.approx(0.0, abs=1e-10)


def test_agrees_with_the_estimator_of_jansen():
    # Jansen 1999: total = E[(f(A) - f(A with column i of B))^2] / (2 V); with 2e5 pairs its error is below 0.01.
    def f(z):
        return np.exp(0.3 * z[:, 0]) + 0.1 * z[:, 1] + 0.1 * z[:, 1] * np.tanh(z[:, 0])

    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 200_000, 2))
    variance = np.var(f(a))
    total = []
    for i in range(2):
        mixed = a.copy()
        mixed[:, i] = b[:, i]
        total.append(np.mean((f(a) - f(mixed)) ** 2) / (2 * variance))
    z = quadratic_design(2)
    found = sensitivity_indices(z, f(z))
    np.testing.assert_allclose(found.total[0], total, atol=0.03)
    assert found.standard_deviation[0] == pytest.approx(np.sqrt(variance), rel=0.05)


def test_says_how_far_the_polynomial_misses():
    z, other = quadratic_design(2), np.random.default_rng(3).normal(size=(20, 2))

    def f(z):
        return np.sin(9.0 * z[:, 0])

    assert sensitivity_indices(z, f(z), (other, f(other))).misfit[0] > 1.0


def test_a_quantity_that_does_not_move_has_no_shares():
    z = quadratic_design(2)
    found = sensitivity_indices(z, np.full((len(z), 1), 0.7))
    assert np.isnan(found.total).all()
    assert found.standard_deviation[0] == pytest.approx(0.0, abs=1e-12)


def test_too_few_evaluations_are_refused():
    with pytest.raises(UsageError, match="66 and more"):
        sensitivity_indices(np.eye(10), np.ones(10))


def test_inputs_are_checked_together_with_both_signs_of_each():
    """The seed of the checks is the code's own."""
    names = ("ground", "path")

    def reason(name):
        item = UncertainInput(name, "sensor", f"light.{name}", np.ones(1), np.full((1, 1), 0.01))
        return SimpleNamespace(candidate=Candidate(name, "sensor", None, True), members=(item,))

    reasons, seen = [reason(name) for name in names], []

    def evaluate(truths, words, show_progress):
        seen.extend((float(t["light.ground"][0]), float(t["light.path"][0])) for (t,) in truths)
        return [(None, np.array([g + p])) for g, p in seen]

    single = {(r.candidate, sign): np.array([2.0 + 0.01 * sign]) for r in reasons for sign in (1, -1)}
    run._indices(reasons, evaluate, np.array([2.0]), single, False)
    checks = np.array(seen[1:])  # after the one pair
    assert len(checks) == run._CHECKS
    assert (checks.min(axis=0) < 1.0).all()
    assert (checks.max(axis=0) > 1.0).all()
