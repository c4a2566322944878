"""Counts without a sort, and the areas from them, against the long way round."""

from __future__ import annotations

import numpy as np
import pytest
from exact_forms import auc, roc_points
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.processing import counts_of

SCORES = st.lists(
    st.one_of(st.integers(-3, 3).map(float), st.floats(allow_nan=False), st.sampled_from([1e-310, 1e300, -1e300])),
    min_size=1, max_size=30,
)  # fmt: skip


@given(SCORES, SCORES)
@settings(max_examples=300)
def test_counts_and_area_equal_sorting(target, background):
    t, b = np.array(target), np.array(background)
    pfa, pd, _ = roc_points(t, b)
    assert auc(t, b) == pytest.approx(np.trapezoid(pd, pfa), abs=1e-12)
    counts = counts_of(t, b)
    assert counts.ties.tolist() == [int(np.sum(b == v)) for v in counts.value]
    assert counts.between.sum() + counts.ties.sum() == b.size
    assert counts.below == pytest.approx([np.mean(b < v) + 0.5 * np.mean(b == v) for v in counts.value])


def test_bad_scores_are_refused():
    for bad in ([], [np.nan]):
        with pytest.raises(UsageError, match=r"scores are NaN|no target scores"):
            counts_of(bad, [1.0])
