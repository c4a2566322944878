"""Order statistics without a sort, against the sort."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.processing import OrderStatistics, empirical_roc

KINDS = {
    "normal": lambda rng, n: rng.normal(size=n),
    "heavy tails": lambda rng, n: rng.standard_cauchy(size=n),
    "ties": lambda rng, n: np.round(rng.normal(size=n), 1),
    "one value": lambda rng, n: np.full(n, 0.25),
    "two far values": lambda rng, n: np.where(rng.random(n) < 0.9, 0.0, 1e300),
    "infinities": lambda rng, n: np.where(rng.random(n) < 0.2, rng.choice([-np.inf, np.inf], n), rng.normal(size=n)),
    "all infinite": lambda rng, n: rng.choice([-np.inf, np.inf], n),
    "tiny": lambda rng, n: 1e-310 * rng.normal(size=n),
    "sorted": lambda rng, n: np.sort(rng.exponential(size=n)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("n", [1, 57, 30_011])
def test_equal_to_the_sort(kind, n):
    rng = np.random.default_rng(n)
    x = KINDS[kind](rng, n)
    ranks = np.unique(np.concatenate([[1, n], rng.integers(1, n + 1, 200)]))
    found = OrderStatistics(x, ranks)
    greatest = np.sort(x)[::-1][ranks - 1]
    assert np.array_equal(found.greatest(ranks), greatest)
    assert np.array_equal(found.above(greatest), [np.sum(x > value) for value in greatest])
    assert found.greatest(n + 1) == -np.inf


@pytest.mark.parametrize("kind", ["normal", "heavy tails", "ties", "infinities"])
def test_the_curve_of_a_large_background_is_that_of_its_sort(kind):
    rng = np.random.default_rng(7)
    b, t = KINDS[kind](rng, 25_000), KINDS[kind](rng, 40)
    pfa = np.array([1e-5, 4e-5, 1e-3, 0.02, 0.3, 0.999, 1.0])
    found = empirical_roc(t, b, pfa)
    down = np.sort(b)[::-1]
    for p, threshold, pd, alarms in zip(pfa, found.threshold, found.pd, found.alarms, strict=True):
        if p == 1.0:
            assert (threshold, pd, alarms) == (-np.inf, 1.0, b.size)
            continue
        assert threshold == down[int(np.floor(p * b.size * (1 + 1e-12)))]
        assert (pd, alarms) == (np.mean(t > threshold), np.sum(b > threshold))
