"""The exact curve without a sort, and the bootstrap by order statistics, against the long way round."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.processing.auc import auc_with_interval
from hyperval.processing.rank_counts import bootstrap_pd, counts_of, roc_corners
from hyperval.processing.roc import pd_at_pfa, roc_points

SCORES = st.lists(
    st.one_of(st.integers(-3, 3).map(float), st.floats(allow_nan=False), st.sampled_from([1e-310, 1e300, -1e300])),
    min_size=1, max_size=30,
)  # fmt: skip


@given(SCORES, SCORES)
@settings(max_examples=300, deadline=None)
def test_corners_and_counts_equal_sorting(target, background):
    t, b = np.array(target), np.array(background)
    pfa, pd = roc_corners(t, b)
    every = roc_points(t, b)
    assert set(zip(pfa, pd, strict=True)) <= set(zip(every[0], every[1], strict=True))
    assert (pfa[0], pd[0], pfa[-1], pd[-1]) == (0, 0, 1, 1)
    assert np.trapezoid(pd, pfa) == pytest.approx(np.trapezoid(every[1], every[0]), abs=1e-12)
    counts = counts_of(t, b)
    assert counts.ties.tolist() == [int(np.sum(b == v)) for v in counts.value]
    assert counts.between.sum() + counts.ties.sum() == b.size
    assert counts.below == pytest.approx([np.mean(b < v) + 0.5 * np.mean(b == v) for v in counts.value])


def test_auc_and_delong_equal_the_definition():
    rng = np.random.default_rng(0)
    t, b = np.round(rng.normal(1.0, 1.0, 40), 1), np.round(rng.normal(size=300), 1)
    wins = (t[:, None] > b) + 0.5 * (t[:, None] == b)
    found = auc_with_interval(t, b)
    assert found.auc == pytest.approx(wins.mean(), rel=1e-14)
    expected = wins.mean(axis=1).var(ddof=1) / 40 + wins.mean(axis=0).var(ddof=1) / 300
    assert found.variance == pytest.approx(expected, rel=1e-12)


def test_bootstrap_has_the_moments_of_plain_resampling():
    # 20,000 draws against 4,000; five standard errors are allowed for mean, sd and correlation,
    # so that less than one run in a million fails by chance (the seed is fixed).
    rng = np.random.default_rng(1)
    t, b = rng.normal(1.5, 1.0, 30), rng.normal(size=400)
    grid = np.array([0.01, 0.1, 0.5, 1.0])
    fast = bootstrap_pd(t, b, grid, 20_000, rng)
    plain = np.array([pd_at_pfa(rng.choice(t, 30), rng.choice(b, 400), grid).pd for _ in range(4000)])
    assert fast.shape == (20_000, 4)
    assert np.all(fast[:, 3] == 1)
    error = plain.std(axis=0) * np.sqrt(1 / 4000 + 1 / 20_000)
    assert np.all(np.abs(fast.mean(axis=0) - plain.mean(axis=0)) <= 5 * error)
    assert fast[:, :3].std(axis=0) == pytest.approx(plain[:, :3].std(axis=0), rel=5 * np.sqrt(0.5 / 4000))
    assert np.corrcoef(fast[:, 0], fast[:, 1])[0, 1] == pytest.approx(
        np.corrcoef(plain[:, 0], plain[:, 1])[0, 1], abs=5 / np.sqrt(4000)
    )


def test_bad_scores_are_refused():
    rng = np.random.default_rng(2)
    for bad in ([], [np.nan]):
        with pytest.raises(UsageError, match="missing or hold NaN"):
            roc_corners(bad, [1.0])
        with pytest.raises(UsageError, match="without NaN"):
            bootstrap_pd([1.0], bad, [0.1], 10, rng)
    with pytest.raises(UsageError, match="must rise"):
        bootstrap_pd([1.0], [1.0], [0.1, 0.1], 10, rng)
