"""What a table says where the names of prediction, truth and comparisons do not meet."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.compare import Gate, compare_products, judged
from hyperval.products import ObservedProducts, PredictedProducts, RocCurve
from hyperval.results import Outcome, Result
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0]), np.array([5.0, 5.0]))


def test_a_side_that_lacks_a_curve_is_told_with_what_it_has():
    def curve(unit="pixel"):
        pfa = np.geomspace(1e-4, 1.0, 20)
        return RocCurve(pfa, pfa**0.2, pfa**0.2, pfa**0.2, -pfa, unit)

    predicted = PredictedProducts(AXIS, roc={("planks", "cem", "pixel"): curve(), ("planks", "ace", "pixel"): curve()})
    observed = ObservedProducts(AXIS, roc={("planks", "rx", "pixel"): curve(), ("mask 1", "cem", "pixel"): curve()})
    rows = compare_products(predicted, observed)
    told = {(r.subject, r.method): r.reason for r in rows if r.product == "roc" and r.outcome is Outcome.SKIPPED}
    assert told["planks", "rx/pixel"] == "no roc of planks in the prediction, which has it by cem, ace"
    assert told["mask 1", "cem/pixel"] == "no roc of mask 1 in the prediction, which has 'planks'"
    assert told["planks", "cem/pixel"] == "no roc of planks in the observation, which has it by rx"
    (nothing,) = [r for r in compare_products(predicted, ObservedProducts(AXIS)) if r.method == "ace/pixel"]
    assert nothing.reason.endswith("in the observation, which has no roc at all")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"metric": "pd_inside_interval_preset"}, "did you mean 'pd_inside_interval@1e-"),
        ({"subjects": ("blau",)}, "rows with it: 'planks' (cem/pixel)"),
        ({"method": "ace/*"}, "rows with it: 'planks' (cem/pixel)"),
        ({"metric": "chi2_reduced_full"}, None),
    ],
)
def test_a_gate_that_meets_no_row_is_told_what_comes_near(change, told):
    rows = [Result("c", "roc", "planks", "cem/pixel", f"pd_inside_interval@{p}", 1.0) for p in ("1e-2", "1e-3")]
    given = {"product": "roc", "metric": "pd_inside_interval", "at_least": 1, "reason": "r", **change}
    (row,) = [r for r in judged(rows, [Gate(**given)]) if r.outcome is Outcome.ERROR]
    assert row.reason.startswith("planned but absent: no roc row")
    assert told is None or told in row.reason
    assert told is not None or "; " not in row.reason
