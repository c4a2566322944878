"""Thresholds and P_FA of many evaluations against plain sums."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm, t

from hyperval.model import ClassScores, false_alarm_grid, log_false_alarm, thresholds_at


def random_scores(rng: np.random.Generator, rows: int, tails: bool) -> ClassScores:
    fraction = rng.dirichlet(np.ones(4), rows)
    fraction[::5, 2] = 0.0
    fraction /= fraction.sum(axis=1, keepdims=True)
    dof = np.where(rng.random((rows, 4)) < 0.5, rng.uniform(2.1, 40.0, (rows, 4)), np.inf)
    mean, sd = rng.normal(0.0, 0.02, (rows, 4)), rng.uniform(0.004, 0.05, (rows, 4))
    return ClassScores(fraction, mean, sd, dof if tails else np.full((rows, 4), np.inf))


@pytest.mark.parametrize("tails", [False, True])
def test_thresholds_by_a_root_finder_on_the_plain_sum(tails):
    scores = random_scores(np.random.default_rng(0), 12, tails)
    pfa = false_alarm_grid(1e-9, 4)
    found = thresholds_at(np.broadcast_to(pfa, (12, pfa.size)), scores)
    for r in range(12):
        laws = [
            (f, norm(m, s) if np.isinf(d) else t(d, m, s * np.sqrt((d - 2.0) / d)))
            for f, m, s, d in zip(*(a[r] for a in vars(scores).values()), strict=True)
        ]

        def excess(x: float, p: float, laws: list[tuple[float, Any]] = laws) -> float:
            return float(np.log(sum(f * law.sf(x) for f, law in laws) + 1e-300) - np.log(p))

        for p, x in zip(pfa[::6], found[r, ::6], strict=True):
            assert x == pytest.approx(brentq(excess, -2.0, x + 1.0, args=(p,), xtol=1e-13), abs=1e-9)


def test_thresholds_beside_a_class_that_hardly_varies():
    """A narrow class of a millionth of the area puts a small step into a smooth tail."""
    rows = [[1.0 - 1e-6, 1e-6], [0.0, 0.05], [0.02, 1e-9], [np.inf, np.inf]]
    scores = ClassScores(*np.array(rows)[:, None, :])
    step = float(np.exp(log_false_alarm(np.array([0.05]), scores)[0][0]))
    pfa = step + np.linspace(-0.7e-6, 0.7e-6, 41)
    x = thresholds_at(pfa[None], scores)[0]
    value, _ = log_false_alarm(x, scores.rows(np.zeros(x.size, int)))
    np.testing.assert_allclose(value, np.log(pfa), rtol=0, atol=1e-11)
