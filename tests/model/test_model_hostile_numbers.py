"""Numbers that no instrument should give: what comes back is right, or one clear error; never a silent NaN."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.errors import UsageError
from hyperval.model import cem_correlation_weights, matched_filter_weights, spectral_matched_filter

SCALES = st.integers(-30, 30).map(lambda k: 10.0**k)


FEW = settings(max_examples=40, derandomize=True)


@FEW
@given(st.integers(0, 10_000), SCALES, st.sampled_from(["full", "singular", "nearly singular", "zero", "nan"]))
def test_a_filter_meets_its_two_conditions_or_is_refused(seed, scale, kind):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6))
    covariance = root @ root.T * scale**2
    if kind == "singular":
        covariance[:, 0] = covariance[0] = 0.0
    elif kind == "nearly singular":
        covariance = np.outer(root[0], root[0]) * scale**2 + 1e-13 * scale**2 * np.eye(6)
    elif kind == "zero":
        covariance[:] = 0.0
    elif kind == "nan":
        covariance[2, 2] = np.nan
    mean, target = scale * rng.uniform(1, 2, 6), scale * rng.uniform(3, 4, 6)
    for make in (matched_filter_weights, spectral_matched_filter, cem_correlation_weights):
        try:
            found = make(target, mean, covariance)
        except UsageError:
            assert kind != "full"
            continue
        assert kind not in ("zero", "nan", "singular") or make is cem_correlation_weights
        assert np.all(np.isfinite(found.weights))
        slack = 1e-12 * max(found.condition, 1.0) + 1e-9
        if make is matched_filter_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
            assert found.score(mean) == pytest.approx(0.0, abs=slack)
        elif make is cem_correlation_weights:
            assert found.score(target) == pytest.approx(1.0, abs=slack)
    with pytest.raises(UsageError):
        matched_filter_weights(mean, mean, root @ root.T * scale**2)
