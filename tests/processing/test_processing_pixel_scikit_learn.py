"""Agreement with scikit-learn, which is installed for development only."""

from __future__ import annotations

import numpy as np
import pytest
from exact_forms import roc_points

from hyperval.data import statistics_of
from hyperval.model import RocArea
from hyperval.processing import counts_of, roc_area


def peer(module):
    return pytest.importorskip(f"sklearn.{module}", reason="scikit-learn is not installed; pip install scikit-learn")


@pytest.mark.parametrize("decimals", [0, 1, 2, 9])
def test_curve_is_equal_to_the_last_bit(decimals):
    metrics = peer("metrics")
    rng = np.random.default_rng(decimals)
    for m, n in ((1, 1), (3, 700), (40, 2500), (77, 90)):
        t, b = np.round(rng.normal(1, 1, m), decimals), np.round(rng.normal(size=n), decimals)
        truth, scores = np.concatenate([np.ones(m), np.zeros(n)]), np.concatenate([t, b])
        theirs = metrics.roc_curve(truth, scores, drop_intermediate=False)
        for ours, other in zip(roc_points(t, b), theirs, strict=True):
            assert np.array_equal(ours, other)
        assert roc_area(counts_of(t, b)) == pytest.approx(metrics.roc_auc_score(truth, scores), rel=1e-13)
        # Theirs of a part is scaled to 1/2 for chance (McClish 1989): back to the mean P_D over the range.
        part = metrics.roc_auc_score(truth, scores, max_fpr=0.1)
        area = 0.1 * ((2 * part - 1) * (1 - 0.05) + 0.05)
        assert 0.1 * roc_area(counts_of(t, b), RocArea(0.0, 0.1)) == pytest.approx(area, rel=1e-12, abs=1e-15)


def test_shrinkage_of_ledoit_and_wolf():
    covariance = peer("covariance")
    rng = np.random.default_rng(1)
    for n, bands in ((12, 20), (60, 20), (4000, 5)):
        x = rng.normal(size=(n, bands)) @ rng.normal(size=(bands, bands)) + 7.0
        found, (matrix, intensity) = statistics_of(x), covariance.ledoit_wolf(x)
        assert found.shrinkage == pytest.approx(intensity, rel=1e-9)
        # Theirs has divisor n.
        assert found.shrunk_covariance * (n - 1) / n == pytest.approx(matrix, rel=1e-9, abs=1e-12)
