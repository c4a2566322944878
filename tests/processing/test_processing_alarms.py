"""Alarms at a stated P_D: the interval against its definition, rank by rank with plain sums."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from hyperval.processing import alarms_at_detection, counts_of


def limit(count, n, tail, side):
    """End of the exact interval: the p at which the binomial tail beyond ``count`` is ``tail``, by root finding."""
    if (side == "low" and count == 0) or (side == "high" and count == n):
        return float(side == "high")
    beyond = (lambda p: stats.binom.sf(count - 1, n, p)) if side == "low" else lambda p: stats.binom.cdf(count, n, p)
    return optimize.brentq(lambda p: beyond(p) - tail, 1e-15, 1 - 1e-12, xtol=1e-15)


@pytest.mark.parametrize("decimals", [0, 6])
@pytest.mark.parametrize(("m", "n", "q"), [(24, 90, 0.5), (40, 300, 0.9), (7, 50, 0.5), (60, 40, 0.3)])
def test_interval_against_its_definition(m, n, q, decimals):
    rng = np.random.default_rng(m)
    t, b = np.round(rng.normal(1, 1, m), decimals), np.round(rng.normal(size=n), decimals)
    (found,) = alarms_at_detection(counts_of(t, b), [q])
    each = np.sqrt(0.95)
    tail = (1 - each) / 2
    greatest = np.sort(t)[::-1]
    # The true threshold has X of m targets above it, X binomial with q.
    weight = stats.binom.pmf(np.arange(m + 1), m, q)
    r = max((k for k in range(1, m + 1) if weight[:k].sum() <= tail), default=0)
    s = min((k for k in range(1, m + 1) if weight[k:].sum() <= tail), default=m + 1)
    low = limit(int(np.sum(b > greatest[r - 1])), n, tail, "low") if r else 0.0
    high = limit(int(np.sum(b >= greatest[s - 1])), n, tail, "high") if s <= m else 1.0
    at = greatest[int(np.ceil(q * m - 1e-9)) - 1]
    alarms = int(np.sum(b >= at))
    fixed = limit(alarms, n, 0.025, "low"), limit(alarms, n, 0.025, "high")
    assert (found.threshold, found.alarms, found.pfa) == (at, alarms, alarms / n)
    assert (found.fixed_lower, found.fixed_upper) == pytest.approx(fixed, abs=1e-9)
    assert found.pfa_lower == pytest.approx(min(low, fixed[0]), abs=1e-9)
    assert found.pfa_upper == pytest.approx(max(high, fixed[1]), abs=1e-9)


def test_a_share_that_is_a_whole_number_of_targets_is_not_rounded_up():
    # 0.07 * 100 is 7.000000000000001 in floating point: the 7th target and not the 8th.
    t = np.arange(100.0)
    (found,) = alarms_at_detection(counts_of(t, np.array([-1.0, 50.0])), [0.07])
    assert found.threshold == 93.0
