"""Ratios of false alarms before and after an experiment, and the reason that is named."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.compare.scores import compare_exceedance
from hyperval.products import ExceedanceCurve, Observation, Prediction
from hyperval.results import Result
from hyperval.spectra.axis import SpectralAxis
from hyperval.uncertainty.attribution.what_ifs import AlarmRatio, alarm_ratios, reason_for

AXIS = SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
P = np.geomspace(0.5, 1e-5, 200)


def curve(threshold, p, n=None, width=2.0):
    return ExceedanceCurve(threshold, p, p / width, np.minimum(p * width, 1.0), n)


def sides(dof=10.0, n=50_000):
    """Measured scores with the tails of a t, predicted ones normal."""
    measured = curve(stats.t.isf(P, dof), P, n)
    told = curve(stats.norm.isf(P), P)
    return (
        Prediction(axis=AXIS, exceedance={("roof", "cem"): told}),
        Observation(axis=AXIS, exceedance={("roof", "cem"): measured}),
    )


def test_ratios_are_those_of_the_comparison_and_of_the_two_laws():
    predicted, observed = sides()
    found = alarm_ratios(predicted, observed)
    rows: list[Result] = compare_exceedance(
        predicted.exceedance["roof", "cem"], observed.exceedance["roof", "cem"],
        campaign="c", subject="roof", method="cem",
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
    assert alarm_ratios(Prediction(axis=AXIS), observed) == {}


def ratio(value, spread=1.2):
    return AlarmRatio("roof background", "cem", "pfa_ratio@1e-3", value, value / spread, value * spread)


def test_the_reason_is_the_experiment_that_leaves_least():
    tried = [("tails", ratio(0.4)), ("local", ratio(1.3)), ("classes", ratio(9.0))]
    assert "'local' leaves 1.3: it would explain it" in reason_for(ratio(6.0), tried)
    assert "'tails' leaves 0.4: the nearest, and not enough" in reason_for(ratio(6.0), [tried[0], tried[2]])
    assert reason_for(ratio(6.0), [tried[2]]).endswith("no what-if brings it nearer")
    assert reason_for(ratio(1.9), tried) == "within a factor of two"
    assert "within what the measured interval allows" in reason_for(ratio(4.0, spread=5.0), tried)
    for off in (6.0, 1 / 6.0):  # an interval that ends before the factor, above it or below
        assert "within what the measured interval allows" not in reason_for(ratio(off), tried)
