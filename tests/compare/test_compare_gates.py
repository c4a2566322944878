"""What a planned comparison may say, and what each kind of row concludes about a range."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from hyperval.compare import (
    COMPARISON,
    Gate,
    detectable_departure,
    detectable_share,
    judged,
    outcome_of,
    tail_probability,
)
from hyperval.results import Cause, Outcome, Result, Role

RADIANCE = {"product": "radiance", "metric": "median_difference_ratio_windows", "reason": "r"}


def row(metric="median_difference_ratio_windows", value=0.0, lower=math.nan, upper=math.nan, **more):
    product = more.pop("product", "radiance")
    return Result("c", product, "field", "radiance", metric, value=value, lower=lower, upper=upper, **more)


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"at_most": 0.1, "at_least": 0.0}, "one limit only, got at_most and at_least"),
        ({}, "a limit is missing"),
        ({"within": [0.1, 0.1]}, "within [0.1, 0.1] holds no range"),
        ({"within": [-0.1, 0.1], "bands_nm": [900, 800]}, "bands_nm [900, 800] holds no range"),
        ({"within": [-0.1, 0.1], "chosen_after": True}, "stand together"),
        ({"within": [-0.1, 0.1], "before": "0.05"}, "stand together"),
        ({"metric": "no_such_metric", "at_most": 0.1}, "no_such_metric"),
        ({"metric": "fraction_inside_95", "at_least": 0.0}, "lies between 0 and 1: at least 0 can never fail"),
        ({"metric": "fraction_inside_95", "at_most": 1.0}, "at most 1 can never fail"),
        ({"at_most": math.inf}, "finite"),
        ({"within": [-0.1, 1.0]}, "on a ratio is 100 % or more"),
        ({"metric": "bias_ratio", "within": [-5.0, 5.0]}, "on a ratio is 100 % or more"),
        ({"metric": "chi2_reduced_full", "at_most": 100.0}, "on a reduced chi-square accepts anything"),
        ({"metric": "p_value_full", "at_most": 0.05}, "is a p-value: its level is 'at_least'"),
    ],
)
def test_a_range_that_cannot_fail_or_says_nothing_is_refused(entries, words):
    with pytest.raises(ValidationError) as caught:
        Gate(**{**RADIANCE, **entries})
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("entries", "limits", "text"),
    [
        ({"at_most": 0.1}, (-math.inf, 0.1), "at most 0.1"),
        ({"at_least": -0.1}, (-0.1, math.inf), "at least -0.1"),
        ({"within": [-0.1, 0.2]}, (-0.1, 0.2), "within -0.1 to 0.2"),
        ({"metric": "fraction_inside_95", "at_least": 0.9}, (0.9, math.inf), "at least 0.9"),
        ({"metric": "chi2_reduced_full", "at_most": 99.0}, (-math.inf, 99.0), "at most 99"),
        ({"product": "roc", "metric": "pd_inside_interval@1e-2", "fraction_at_least": 0.9}, (1.0, math.inf),
         "at least 1"),
    ],
)  # fmt: skip
def test_limits_and_their_words(entries, limits, text):
    gate = Gate(**{**RADIANCE, **entries})
    assert (gate.limits, gate.limit_text) == (limits, text)


def test_the_rows_that_a_gate_is_about():
    gate = Gate(**{**RADIANCE, "metric": "difference_ratio", "within": [-0.1, 0.1], "bands_nm": [500, 600]})
    assert gate.covers(row("difference_ratio", band_nm=500.0))
    assert gate.covers(row("difference_ratio", band_nm=600.0))
    assert not gate.covers(row("difference_ratio", band_nm=600.1))
    assert not gate.covers(row("difference_ratio", band_nm=499.9))
    assert not gate.covers(row("difference_ratio", product="reflectance", band_nm=550.0))
    assert gate.covers(row(COMPARISON))  # a skipped comparison has no band
    only = Gate(**{**RADIANCE, "at_most": 0.1, "subjects": ["court*"], "method": "rad*"})
    assert not only.covers(row())
    at = Gate(product="roc", metric="pd_difference", within=(-0.1, 0.1), reason="r")
    assert at.covers(row("pd_difference@1e-2", product="roc"))


@pytest.mark.parametrize(
    ("row_", "outcome", "cause"),
    [
        (row(value=0.0, lower=-0.1, upper=0.1), Outcome.AGREES, Cause.NONE),  # the ends belong to the range
        (row(value=0.05, lower=-0.0, upper=0.11), Outcome.UNDECIDED, Cause.WIDE_INTERVAL),
        (row(value=0.2, lower=0.1, upper=0.3), Outcome.UNDECIDED, Cause.WIDE_INTERVAL),
        (row(value=0.2, lower=0.11, upper=0.3), Outcome.DISAGREES, Cause.NONE),
        (row(value=-0.2, lower=-0.3, upper=-0.11), Outcome.DISAGREES, Cause.NONE),
        (row(value=0.0), Outcome.UNDECIDED, Cause.NO_INTERVAL),
        (row(value=0.0, lower=-0.1), Outcome.UNDECIDED, Cause.NO_INTERVAL),
        (row(value=math.nan), Outcome.ERROR, Cause.NOT_A_NUMBER),
        (row(value=0.0, lower=0.1, upper=-0.1), Outcome.ERROR, Cause.BAD_INTERVAL),
        (row(value=0.2, lower=-0.1, upper=0.1), Outcome.ERROR, Cause.BAD_INTERVAL),
        (row(value=-0.2, lower=-0.1, upper=0.1), Outcome.ERROR, Cause.BAD_INTERVAL),
        (row(outcome=Outcome.SKIPPED, cause=Cause.NO_BANDS, reason="s"), Outcome.SKIPPED, Cause.NO_BANDS),
        (row(outcome=Outcome.ERROR, cause=Cause.ABSENT, reason="s"), Outcome.ERROR, Cause.ABSENT),
    ],
)
def test_an_interval_against_a_range(row_, outcome, cause):
    assert outcome_of(row_, -0.1, 0.1)[:2] == (outcome, cause)


@pytest.mark.parametrize(
    ("value", "detectable", "outcome", "cause", "words"),
    [
        (0.2, 0.0, Outcome.AGREES, Cause.NONE, ""),
        (0.2, math.inf, Outcome.UNDECIDED, Cause.NO_POWER, "no 80 % power"),
        (0.001, 0.0, Outcome.DISAGREES, Cause.NONE, ""),
        (0.9999, 0.0, Outcome.DISAGREES, Cause.TOO_WIDE, ""),
    ],
)
def test_a_test_of_both_tails_against_its_level(value, detectable, outcome, cause, words):
    judgement = outcome_of(row("p_value_full", value, detectable=detectable), 0.01, math.inf)
    assert judgement[:2] == (outcome, cause)
    assert words in judgement[2]
    assert (words == "") == (judgement[2] == "")
    assert tail_probability(row("p_value_full", value)) == pytest.approx(2 * min(value, 1 - value))


def test_the_smallest_p_value_alone_has_the_whole_part_of_holm():
    # Three tests at 3 %: parts of 1, 1.5 and 3 %.  Two-sided values of 0.9, 2 and 2.5 %: the second stops the rest.
    gate = Gate(product="radiance", metric="p_value_full", at_least=0.03, reason="r")
    rows = [row("p_value_full", p / 2, detectable=0.0) for p in (0.025, 0.009, 0.02)]
    out = judged(rows, [gate])
    assert [r.outcome for r in out] == [Outcome.UNDECIDED, Outcome.DISAGREES, Outcome.UNDECIDED]
    assert [r.cause for r in out] == [Cause.MULTIPLICITY, Cause.NONE, Cause.MULTIPLICITY]
    assert "its part of the level is 0.015, one of 3 criteria" in out[2].reason
    assert [r.role for r in out] == [Role.GATE] * 3


def test_intervals_of_all_criteria_share_their_level():
    # On either side twenty intervals lie off equality by 2.5 standard errors, and one by 4: of 42 the worst has
    # 0.05/42 of the level (3.2 standard errors), so that one right campaign in twenty is called wrong.
    gate = Gate(product="radiance", metric="median_difference_ratio_windows", within=[-0.1, 0.1], reason="r")
    beside = [row(value=k, lower=k - 1.96, upper=k + 1.96) for k in (*[2.5] * 20, 4.0)]
    beside += [row(value=-x.value, lower=-x.upper, upper=-x.lower) for x in beside]
    out = judged(beside, [gate])
    assert [r.outcome for r in out] == ([Outcome.UNDECIDED] * 20 + [Outcome.DISAGREES]) * 2
    assert {r.cause for r in out if r.outcome is Outcome.UNDECIDED} == {Cause.MULTIPLICITY}
    assert judged(beside[:1], [gate])[0].outcome is Outcome.DISAGREES  # alone it has the whole level
    assert judged(beside[:20], [gate.model_copy(update={"gate": False})])[0].outcome is Outcome.DISAGREES


@pytest.mark.parametrize(
    ("metric", "value", "lower", "upper", "p"),
    [
        ("pd_difference@1e-2", 0.2, 0.0, 0.6, 0.05),  # the end on the side of equality counts
        ("pd_difference@1e-2", -0.2, -0.6, 0.0, 0.05),
        ("pd_difference@1e-2", 0.0, -0.1, 0.3, 1.0),
        ("pfa_ratio@1e-2", 4.0, 1.0, 9.0, 0.05),  # of a ratio in the logarithm
        ("pfa_ratio@1e-2", 4.0, 2.0, 8.0, 8.862e-5),  # twice as far: 3.92 standard errors
        ("pfa_ratio@1e-2", 0.25, 0.125, 1.0, 0.05),
        ("pfa_ratio@1e-2", 0.0, 0.0, 0.5, 8.862e-5),  # nothing was predicted
        ("pfa_ratio@1e-2", 3.0, 3.0, 3.0, 0.0),
        ("pd_inside_interval@1e-2_fraction", 0.0, 0.0, 0.25, 4.1e-15),
    ],
)
def test_the_level_at_which_an_interval_would_reach_equality(metric, value, lower, upper, p):
    assert tail_probability(row(metric, value, lower, upper, product="roc")) == pytest.approx(p, rel=0.1)


def test_departures_that_a_range_would_see():
    reach = 1.0 + 0.8416212335729143 / 1.959963984540054
    both = row(value=0.01, lower=-0.01, upper=0.02)  # 0.02 below, 0.01 above
    assert detectable_departure(both, -0.1, math.inf) == pytest.approx(0.1 + 0.01 * reach)
    assert detectable_departure(both, -math.inf, 0.1) == pytest.approx(0.1 + 0.02 * reach)
    assert detectable_departure(both, -0.1, 0.05) == pytest.approx(0.05 + 0.02 * reach)
    assert math.isnan(detectable_departure(row(value=0.0), -0.1, 0.1))
    # A size cut at 0 says nothing of its width: the upper half stands for it.
    size = row("median_abs_difference_ratio_windows", 0.01, 0.0, 0.05)
    assert detectable_departure(size, -math.inf, 0.1) == pytest.approx(0.1 + 0.04 * reach)
    assert detectable_departure(row("p_value_full", 0.5, detectable=0.3), 0.01, math.inf) == 0.3
    assert math.isnan(detectable_share(5, 0.1))  # even none of five leaves the share of 0.1 possible


def test_what_is_planned_and_not_there_is_an_error_with_what_comes_near():
    gate = Gate(**{**RADIANCE, "within": (-0.1, 0.1), "subjects": ("court",), "method": "radiance"})
    (_, absent) = judged([row()], [gate])
    assert (absent.outcome, absent.cause, absent.role) == (Outcome.ERROR, Cause.ABSENT, Role.GATE)
    assert "no radiance row of subject 'court'" in absent.reason
    assert "and method 'radiance'; rows with it: 'field' (radiance)" in absent.reason
    near = Gate(product="radiance", metric="median_difference_ratio_vnir", within=(-0.1, 0.1), reason="r", gate=False)
    (_, absent) = judged([row()], [near])
    assert absent.role is Role.INFORM
    assert "did you mean 'median_difference_ratio_windows'?" in absent.reason
    (alone,) = judged([], [near])
    assert alone.outcome is Outcome.ERROR


@pytest.mark.parametrize("cause", [Cause.NO_PREDICTION, Cause.NO_OBSERVATION, Cause.NO_BANDS])
@pytest.mark.parametrize(("decides", "outcome"), [(True, Outcome.ERROR), (False, Outcome.SKIPPED)])
def test_a_comparison_without_a_side_is_an_error_under_a_gate_alone(cause, decides, outcome):
    gate = Gate(**RADIANCE, within=(-0.1, 0.1), gate=decides)
    (judgement,) = judged([row(value=math.nan, outcome=Outcome.SKIPPED, cause=cause, reason="s")], [gate])
    assert judgement.outcome is outcome
    (usual,) = judged([row(value=math.nan, outcome=Outcome.SKIPPED, cause=cause, reason="s")], [])
    assert (usual.outcome, usual.reason) == (Outcome.NONE, "not compared: s")


def pooled(least, **entries):
    return Gate(
        **{**RADIANCE, "metric": "difference_ratio", "within": (-0.1, 0.1), "fraction_at_least": least, **entries}
    )


def bands(good, bad, unsure):
    interval = {"lower": -0.01, "upper": 0.01}
    return [
        *(row("difference_ratio", 0.0, band_nm=500.0 + i, **interval) for i in range(good)),
        *(row("difference_ratio", 0.3, 0.29, 0.31, band_nm=600.0 + i) for i in range(bad)),
        *(row("difference_ratio", 0.0, -0.5, 0.5, band_nm=700.0 + i) for i in range(unsure)),
    ]


def test_a_pooled_gate_counts_what_cannot_tell_against_it_below_and_for_it_above():
    *rows, share = judged(bands(80, 6, 14), [pooled(0.5)])
    assert all(r.role is not Role.GATE for r in rows)
    assert (share.metric, share.value, share.n) == ("difference_ratio_fraction", 0.8, 100)
    # Clopper-Pearson: 80 of 100 has 0.7082 below, 94 of 100 has 0.9777 above.
    assert (share.lower, share.upper) == pytest.approx((0.7082, 0.9777), abs=1e-4)
    assert share.outcome is Outcome.AGREES
    assert "80 of 100 rows within -0.1 to 0.1, 14 without an outcome of their own; outside: field" in share.reason
    assert share.reason.count("600 nm") == 1
    assert "and 1 more" in share.reason
    assert judged(bands(20, 80, 0), [pooled(0.5)])[-1].outcome is Outcome.DISAGREES
    assert judged(bands(50, 0, 50), [pooled(0.8)])[-1].outcome is Outcome.UNDECIDED
    assert judged(bands(50, 5, 0), [pooled(0.8, gate=False)])[-1].role is Role.INFORM


def test_pooled_without_a_row_is_one_error():
    (alone,) = judged([], [pooled(0.5)])
    assert (alone.outcome, alone.cause) == (Outcome.ERROR, Cause.ABSENT)


@pytest.mark.parametrize(
    ("metric", "value", "outcome", "cause"),
    [
        ("pd_inside_interval@1e-2", 1.0, Outcome.UNDECIDED, Cause.COVERAGE),  # one case says nothing of a share
        ("pd_inside_interval@1e-2", 0.0, Outcome.DISAGREES, Cause.NONE),
        ("pd_equivalence@1e-2", 1.0, Outcome.AGREES, Cause.NONE),
        ("pd_equivalence@1e-2", 0.0, Outcome.UNDECIDED, Cause.NONE),
        ("pd_equivalence@1e-2", -1.0, Outcome.DISAGREES, Cause.NONE),
        ("chi2_reduced_full", 1.0, Outcome.UNDECIDED, Cause.NOT_JUDGED),
    ],
)
def test_metrics_that_are_judged_by_no_interval(metric, value, outcome, cause):
    assert outcome_of(row(metric, value), 1.0, math.inf) == (outcome, cause, "")
