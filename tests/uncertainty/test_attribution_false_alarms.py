"""Ratios of false alarms before and after an experiment, and the reason that is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import compare_exceedance
from hyperval.products import (
    ExceedanceCurve,
    ObjectScores,
    ObservedProducts,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
)
from hyperval.results import Result
from hyperval.spectra import SpectralAxis
from hyperval.uncertainty.attribution.residuals import RATE_FLOOR, SCORE_FLOOR, stacked
from hyperval.uncertainty.attribution.run import AlarmRatio, alarm_ratios, reason_for

AXIS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
P = np.geomspace(0.5, 1e-5, 200)


def curve(threshold, p, n=None, width=2.0):
    return ExceedanceCurve(threshold, p, p / width, np.minimum(p * width, 1.0), n)


def sides(dof=10.0, n=50_000):
    """Measured scores with the tails of a t, predicted ones normal."""
    measured = curve(stats.t.isf(P, dof), P, n)
    told = curve(stats.norm.isf(P), P)
    return (
        PredictedProducts(axis=AXIS, exceedance={("roof", "cem"): told}),
        ObservedProducts(axis=AXIS, exceedance={("roof", "cem"): measured}),
    )


def test_ratios_are_those_of_the_comparison_and_of_the_two_laws():
    predicted, observed = sides()
    found = alarm_ratios(predicted, observed)
    rows: list[Result] = compare_exceedance(
        predicted.exceedance["roof", "cem"], observed.exceedance["roof", "cem"],
        subject="roof", method="cem",
    )  # fmt: skip
    for row in rows:
        key = (row.subject, row.method, row.metric)
        if key in found:
            assert (found[key].value, found[key].lower, found[key].upper) == (row.value, row.lower, row.upper)
    assert len(found) == 2
    here = found["roof background", "cem", "pfa_ratio@1e-3"]
    # By the two laws: the normal's exceedance at the t's threshold; the nearest point of the grid is 3 % off.
    assert here.value == pytest.approx(stats.norm.sf(stats.t.isf(1e-3, 10.0)) / 1e-3, rel=0.3)
    assert not here.good


def test_too_few_alarms_give_no_ratio():
    predicted, observed = sides(n=5_000)
    assert [m for _, _, m in alarm_ratios(predicted, observed)] == ["pfa_ratio@1e-2"]
    assert alarm_ratios(PredictedProducts(axis=AXIS), observed) == {}


def test_objects_and_alarms_that_come_in_clusters_count_as_what_they_are():
    """Pixels of one object are one, and a rate is known as well as blocks of the image say, not as its count."""
    key, n = ("roof planks", "cem"), 50_000
    draws = np.array([[0.8, 1.0], [1.2, 1.4]])
    thresholds = {"predicted": stats.norm.isf(P[::-1]), "observed": stats.t.isf(P[::-1], 10.0)}
    roc = {
        side: {(*key, "pixel"): RocCurve(P[::-1], P[::-1], P[::-1], P[::-1], t, n_background=n)}
        for side, t in thresholds.items()
    }
    predicted = PredictedProducts(
        AXIS,
        scores={key: ScoreDistribution(1.0, 0.3)},
        object_scores={key: ObjectScores(draws)},
        roc=roc["predicted"],
    )
    observed = ObservedProducts(
        AXIS,
        scores={key: ScoreDistribution(0.9, 0.3, 40)},
        object_scores={key: ObjectScores(np.array([0.7, 0.9, np.nan]))},
        roc=roc["observed"],
        exceedance={("roof", "cem"): curve(stats.t.isf(P, 10.0), P, n)},
    )
    objects, alarms = stacked(predicted, observed).blocks
    assert objects.observed == pytest.approx([0.8])
    assert objects.read(predicted) == pytest.approx([1.1])
    assert objects.covariance == pytest.approx(np.array([[np.var(draws) / 2 + SCORE_FLOOR**2]]))
    assert np.exp(alarms.observed) == pytest.approx([1e-2, 1e-3])
    blocks = (np.log(2.0) / stats.norm.ppf(0.975)) ** 2  # limits at half and twice the rate
    assert np.diag(alarms.covariance) == pytest.approx([blocks, blocks], rel=1e-6)
    assert np.exp(alarms.read(predicted)) == pytest.approx(stats.norm.sf(stats.t.isf([1e-2, 1e-3], 10.0)), rel=0.02)
    bare = stacked(predicted, replace(observed, exceedance={})).blocks[1]
    assert np.diag(bare.covariance) == pytest.approx([1 / (p * n) + RATE_FLOOR**2 for p in (1e-2, 1e-3)])


def ratio(value, spread=1.2):
    return AlarmRatio("roof background", "cem", "pfa_ratio@1e-3", value, value / spread, value * spread)


def test_the_reason_is_the_experiment_that_leaves_least():
    tried = [("tails", ratio(0.4)), ("local", ratio(1.3)), ("classes", ratio(9.0))]
    assert "'local' leaves 1.3: it would explain it" in reason_for(ratio(6.0), tried)
    assert "'tails' leaves 0.4: the nearest, and not enough" in reason_for(ratio(6.0), [tried[0], tried[2]])
    assert reason_for(ratio(6.0), [tried[2]]).endswith("no what-if brings it nearer")
    assert reason_for(ratio(1.9), tried) == "within a factor of two"
    assert "within what its interval allows" in reason_for(ratio(4.0, spread=5.0), tried)
    for off in (6.0, 1 / 6.0):  # an interval that ends before the factor, above it or below
        assert "within what its interval allows" not in reason_for(ratio(off), tried)
