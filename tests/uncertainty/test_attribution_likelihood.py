"""Freeing one input of a residual."""

import numpy as np
import pytest
from scipy import optimize, stats

from hyperval.errors import UsageError
from hyperval.uncertainty.attribution.ranking import Candidate, Whitened, closing_change, explanation, rankings
from hyperval.uncertainty.attribution.residuals import ResidualBlock, Stack


def _world(rng, n=40, k=3):
    a = rng.normal(size=(n, n))
    c = a @ a.T / n + 0.1 * np.eye(n)
    return c, rng.normal(size=(n, k))


@pytest.mark.parametrize("k", [1, 3])
def test_gain_is_the_likelihood_ratio_of_the_normal_density(k):
    rng = np.random.default_rng(1)
    c, g = _world(rng, k=k)
    r = g @ rng.normal(size=k) * 4 + np.linalg.cholesky(c) @ rng.normal(size=len(c))

    def loglik(log_t2):
        return stats.multivariate_normal.logpdf(r, cov=c + np.exp(log_t2) * g @ g.T)

    best = optimize.minimize_scalar(lambda x: -loglik(x), bounds=(-6, 8), method="bounded", options={"xatol": 1e-9})
    found = explanation(Whitened(r, c), g, budgeted=False)
    base = stats.multivariate_normal.logpdf(r, cov=c)
    assert found.gain == pytest.approx(2 * (-best.fun - base), rel=1e-6)
    assert found.tau == pytest.approx(np.exp(best.x / 2), rel=1e-3)
    wide = c + found.tau**2 * g @ g.T
    assert found.chi_square == pytest.approx(r @ np.linalg.solve(wide, r), rel=1e-8)
    np.testing.assert_allclose(found.amplitudes, found.tau**2 * g.T @ np.linalg.solve(wide, r), rtol=1e-7)


def test_one_direction_gains_by_its_pull():
    rng = np.random.default_rng(2)
    c, g = _world(rng, k=1)
    r = 6.0 * g[:, 0]
    pull2 = float(g[:, 0] @ np.linalg.solve(c, r)) ** 2 / float(g[:, 0] @ np.linalg.solve(c, g[:, 0]))
    found = explanation(Whitened(r, c), g[:, 0], budgeted=False)
    assert found.gain == pytest.approx(pull2 - 1 - np.log(pull2), rel=1e-9)


def test_the_budgeted_amplitude_with_nothing_to_gain_is_that_of_the_stated_uncertainty():
    c, g = np.eye(4), np.array([1.0, 0, 0, 0])
    r = np.array([1.0, 0.5, -0.5, 0.2])
    total = c + np.outer(g, g)
    found = explanation(Whitened(r, total), g, budgeted=True)
    assert found.gain == 0.0
    assert found.amplitudes[0] == pytest.approx(0.5)  # N(0, 1) prior and unit noise share a residual of 1


def test_the_falsified_input_is_ranked_first():
    # 200 collections, one of five inputs at 4 standard uncertainties.  At a true rate of 0.97 fewer than 180 right
    # answers have a probability of 2e-6 (binomial).
    rng = np.random.default_rng(3)
    n = 60
    x = np.linspace(0, 1, n)
    patterns = np.stack([np.ones(n), x, x**2, np.sin(6 * x), np.exp(-5 * x)], axis=1)
    c = 0.2**2 * np.eye(n) + patterns @ patterns.T
    right = 0
    for i in range(200):
        truth = i % 5
        z = rng.normal(size=5)
        z[truth] = 4.0 * rng.choice([-1, 1])
        data = Whitened(patterns @ z + 0.2 * rng.normal(size=n), c)
        gains = [explanation(data, patterns[:, [j]], budgeted=True).gain for j in range(5)]
        right += int(np.argmax(gains)) == truth
    assert right >= 180


def test_under_a_true_budget_nothing_gains_much():
    # chi-square of one degree of freedom exceeds 10.8 once in 1000: of 300 draws more than 4 would be a failure of
    # 4e-5 probability.  The gain is below the squared pull.
    rng = np.random.default_rng(4)
    c, g = _world(rng, k=1)
    total = c + g @ g.T
    lower = np.linalg.cholesky(total)
    gains = [explanation(Whitened(lower @ rng.normal(size=40), total), g, budgeted=True).gain for _ in range(300)]
    assert sum(x > 10.8 for x in gains) <= 4
    assert np.median(gains) < 1.0


def test_a_direction_that_would_go_too_far_stops_there_and_the_others_go_where_they_must():
    g, r = np.eye(6)[:, :2], np.array([30.0, 3.0, 0.1, -0.2, 0.1, 0.0])
    found = explanation(Whitened(r, 0.01**2 * np.eye(6)), g, budgeted=False, most=10.0)
    assert found.limited
    np.testing.assert_allclose(found.amplitudes, [10.0, 3.0], rtol=1e-3)
    assert found.chi_square == pytest.approx((20.0 / 0.01) ** 2 + 6 * 100, rel=1e-3)
    assert not explanation(Whitened(r, 0.01**2 * np.eye(6)), g, budgeted=False).limited


def test_refuses_what_has_no_uncertainty():
    with pytest.raises(UsageError, match="uncertainty"):
        Whitened([1.0, 2.0], np.diag([1.0, 0.0]))
    with pytest.raises(UsageError, match="finite"):
        Whitened([np.nan], [[1.0]])


def test_closing_change_of_an_input_that_moves_nothing_is_infinite():
    assert closing_change(0.1, 0.0) == float("inf")


@pytest.mark.parametrize("name", ["a", "z"])
def test_rounding_neither_orders_what_explains_the_same_nor_counts_as_an_effect(name):
    blocks = [ResidualBlock("scores", s, "cem", np.zeros(1), np.eye(1), lambda p: np.zeros(1)) for s in ("near", "far")]
    columns = {
        Candidate(name, "", "", False): np.array([[0.3], [0.0]]),
        Candidate("m", "", "", False): np.array([[0.3 * (1.0 + 4e-16)], [0.0]]),
        Candidate("far alone", "", "", False): np.array([[1e-17], [1.0]]),
    }
    _, near = rankings(Stack(tuple(blocks)), np.array([5.0, 0.0]), np.eye(2), columns, ["near"])
    assert [r.candidate.name for r in near.ranked] == sorted([name, "m"])
