"""Every kind of gate is broken on purpose and must turn red; only sound rows may pass."""

import math

import numpy as np
import pytest

from hyperval.compare import Gate, compare_products, judge_rows
from hyperval.products import ObservedProducts, PredictedProducts, RocCurve, SpectralEstimate
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.spectra import SpectralAxis

METRIC = "median_difference_ratio_windows"
A, D, U, S, E, N = map(Outcome, ("agrees", "disagrees", "undecided", "skipped", "error", "none"))


def row(value, half=0.005, metric=METRIC, subject="grass", product="radiance", **more):
    ends = {} if half is None else {"lower": value - half, "upper": value + half}
    return Result("camp", product, subject, "model", metric, value, **{**ends, **more})


def gate(**more):
    fields = {"product": "radiance", "metric": METRIC, "subjects": ["grass"], "at_most": 0.05, "reason": "why"}
    return Gate(**{k: v for k, v in {**fields, **more}.items() if v is not None})


def p_value(value, detectable, subject="grass"):
    return row(value, None, "p_value_full", subject, detectable=detectable)


def share(value, metric, **more):
    return row(value, None, f"{metric}@1e-2", product="roc", **more)


def lost(cause, **more):
    return row(math.nan, None, outcome=S, cause=cause, reason="few pixels", **more)


def exit_code(rows, gates):
    return ResultTable(judge_rows(rows, gates)).exit_code()


BOTH = gate(metric="bias_ratio", at_most=None, within=(-0.05, 0.05))
TEST = gate(metric="p_value_full", at_most=None, at_least=0.05, subjects=["*"])
INSIDE = gate(product="roc", metric="pd_inside_interval", at_most=None, at_least=1.0)
EQUAL = gate(product="roc", metric="pd_equivalence", at_most=None, at_least=1.0)
# The row, its gate, the outcome and exit code that follow, and what the reason says first.
JUDGED = [
    (row(0.03), gate(), A, 0, ""),
    (row(0.061), gate(), D, 1, ""),
    (row(0.048), gate(), U, 5, ""),  # the value passes, its interval reaches beyond
    (row(0.052), gate(), U, 5, ""),  # the value does not, its interval reaches inside
    (row(0.03, half=None), gate(), U, 5, ""),  # a value alone
    (row(0.0, half=math.inf), gate(), U, 5, ""),  # a vacuous interval
    (row(math.nan, half=None), gate(), E, 1, "the value is not a number; why"),
    (row(0.03, lower=0.04, upper=0.02), gate(), E, 1, "the interval 0.04 to 0.02 is inverted; why"),
    (row(0.03, lower=0.04, upper=0.06), gate(), E, 1, "the value lies outside its interval 0.04 to 0.06; why"),
    (lost(Cause.NO_PREDICTION, metric="comparison"), gate(), E, 1, "few pixels"),
    (lost(Cause.FEW_PIXELS), gate(), S, 5, "few pixels; why"),
    (row(0.03, outcome=E, reason="it broke"), gate(), E, 1, "it broke"),
    (row(0.0, metric="bias_ratio"), BOTH, A, 0, ""),
    (row(0.06, metric="bias_ratio"), BOTH, D, 1, ""),
    (row(-0.06, metric="bias_ratio"), BOTH, D, 1, ""),
    # A test disagrees below its level, and agrees with power alone.
    (p_value(0.4, 0.02), TEST, A, 0, ""),
    (p_value(0.4, 0.2), TEST, U, 5, ""),
    (p_value(0.4, math.nan), TEST, U, 5, ""),
    (p_value(0.01, 0.02), TEST, D, 1, ""),
    (p_value(1e-9, 0.2), TEST, D, 1, ""),
    (p_value(0.9999, 0.02), TEST, D, 1, ""),  # and where the errors are stated too wide
    # Inside an interval is coverage and no agreement; equivalence has three outcomes.
    (share(1.0, "pd_inside_interval"), INSIDE, U, 5, ""),
    (share(0.0, "pd_inside_interval"), INSIDE, D, 1, ""),
    (share(1.0, "pd_equivalence"), EQUAL, A, 0, ""),
    (share(0.0, "pd_equivalence"), EQUAL, U, 5, ""),
    (share(-1.0, "pd_equivalence"), EQUAL, D, 1, ""),
    # What informs has its outcome and decides nothing.
    (row(0.5), gate(gate=False), D, 5, ""),
    (row(0.01), gate(gate=False), A, 5, ""),
    (lost(Cause.NO_PREDICTION), gate(gate=False), S, 5, ""),
]


@pytest.mark.parametrize(("broken", "by", "expected", "code", "why"), JUDGED)
def test_only_an_interval_inside_the_range_agrees(broken, by, expected, code, why):
    (found,) = judge_rows([broken], [by])
    assert (found.outcome, found.role) == (expected, Role.GATE if by.gate else Role.INFORM)
    assert found.value == broken.value or math.isnan(broken.value)
    limits = [None if math.isnan(limit) else limit for limit in (found.limit_low, found.limit_high)]
    assert limits == [*(by.within or (by.at_least, by.at_most))]
    assert found.reason.startswith(why)
    assert not why.endswith("; why") or found.cause is not Cause.NONE
    assert ResultTable([found]).exit_code() == code
    assert (ResultTable([found]).exit_code(strict=True) == 0) is (expected is A and by.gate)


def test_why_a_row_does_not_agree_has_its_cause():
    found = judge_rows([p_value(0.9999, 0.02), share(1.0, "pd_inside_interval")], [TEST, INSIDE])
    assert [r.cause for r in found] == [Cause.TOO_WIDE, Cause.COVERAGE]


def test_the_levels_of_a_campaign_are_shared_out():
    """Five tests at 0.05: only what is below a fifth of it, then a quarter, disagrees."""
    rows = [p_value(v, 0.01, f"s{i}") for i, v in enumerate((0.002, 0.012, 0.4, 0.5, 0.6))]
    found = judge_rows(rows, [TEST])
    assert [r.outcome for r in found] == [D, U, A, A, A]  # two-sided: 0.004 and 0.024 against 0.01 and 0.0125
    assert found[1].cause is Cause.MULTIPLICITY
    assert judge_rows([rows[1]], [TEST])[0].outcome is D


@pytest.mark.parametrize(
    ("change", "absent"),
    [
        ({"subjects": ["gras"]}, "gras"),
        ({"subjects": ["grass", "asphalt*"]}, "asphalt*"),
        ({"subjects": ["asphalt"], "gate": False}, "asphalt"),
        ({"product": "snr"}, "grass"),
        ({"metric": "median_difference_ratio_window"}, "grass"),
        ({"method": "modtran"}, "grass"),
    ],
)
def test_a_gate_that_meets_no_row_turns_red(change, absent):
    found = judge_rows([row(0.03)], [gate(**change)])
    assert [(r.subject, r.cause) for r in found if r.outcome is E] == [(absent, Cause.ABSENT)]
    assert "planned but absent" in next(r.reason for r in found if r.outcome is E)
    assert change.get("gate") is False or ResultTable(found).exit_code() == 1
    assert exit_code([], [gate(**change)]) == 1


def test_rows_and_gates_count_each_by_itself():
    other = row(9.0, subject="asphalt")
    found = judge_rows([other, row(0.03)], [gate(), gate(at_most=0.02)])
    assert found[0] == other
    assert [exit_code(rows, []) for rows in ([], [other])] == [5, 5]  # nothing decided is no agreement
    assert [(r.outcome, r.limit_high) for r in found[1:]] == [(A, 0.05), (D, 0.02)]
    mixed = ResultTable(judge_rows([row(0.03), row(0.048, subject="lawn")], [gate(subjects=["*"])]))
    assert (mixed.exit_code(), mixed.exit_code(strict=True)) == (0, 1)  # strict counts what could not be told


def test_a_metric_with_a_usual_range_is_judged_unasked_and_informs():
    ratio, untold = judge_rows([row(20.0, 5.0, "pfa_ratio@1e-3", product="scores"), row(0.5, metric="z")], [])
    assert (ratio.outcome, ratio.role, ratio.limit_low, ratio.limit_high) == (D, Role.INFORM, 0.5, 2.0)
    assert untold.outcome is N


def test_what_a_comparison_could_have_seen_stands_beside_it():
    """0.05 + 0.005 (1 + 0.842/1.960): of such errors four in five leave the interval beyond the limit."""
    within = gate(at_most=None, within=(-0.05, 0.05))
    (found,) = judge_rows([row(0.03)], [within])
    assert found.detectable == pytest.approx(0.0571470, rel=1e-6)
    values = found.detectable + 0.005 / 1.959964 * np.random.default_rng(5).standard_normal(2000)
    told = np.mean([judge_rows([row(v)], [within])[0].outcome is D for v in values])
    assert abs(told - 0.8) < 0.036  # four standard errors: one failure in 16000


def test_a_choice_after_the_data_says_what_it_was_before():
    for half in ({"chosen_after": True}, {"before": "at most 0.05"}):
        with pytest.raises(ValueError, match="need each other"):
            gate(**half)
    assert gate(chosen_after=True, before="at most 0.05", at_most=0.06).before == "at most 0.05"


def pooled(fraction=0.9, **more):
    fields = {"product": "roc", "metric": "pd_inside_interval", "subjects": ["*"], "at_most": None}
    return gate(**{**fields, "fraction_at_least": fraction, **more})


def verdicts(values):
    return [share(v, "pd_inside_interval", subject=f"t{i}") for i, v in enumerate(values)]


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ([1.0] * 40, 0),
        ([1.0] * 9 + [0.0], 5),  # ten curves do not tell 0.9 from less
        ([1.0] * 2 + [0.0] * 8, 1),
        ([1.0] * 2 + [math.nan] * 8, 1),
        ([math.nan] * 10, 1),
        ([], 1),
    ],
)
def test_pooled_gate(values, code):
    assert exit_code(verdicts(values), [pooled()]) == code


def test_a_skipped_comparison_counts_as_open_in_a_pool():
    skipped = [lost(Cause.NO_PREDICTION, metric="comparison", subject=s, product="roc") for s in "ab"]
    *members, last = judge_rows([*verdicts([1.0] * 8), *skipped], [pooled()])
    assert (last.outcome, last.value, last.n, last.upper) == (U, 0.8, 10, 1.0)
    assert "2 without an outcome of their own" in last.reason
    assert last.metric == "pd_inside_interval_fraction"
    assert {r.outcome for r in members} == {N, S}  # members do not decide alone


@pytest.mark.parametrize(
    ("slip", "message"),
    [
        ({"at_most": None}, "a limit is missing"),
        ({"at_least": 0.1}, "more than one limit"),
        ({"at_most": 1.0}, "100 % or more"),
        ({"at_most": math.nan}, "finite number"),
        ({"at_most": None, "within": (0.1, 0.1)}, "is an empty range"),
        ({"at_most": None, "within": (0.1, -0.1)}, "is an empty range"),
        ({"at_most": None, "within": (math.nan, 0.1)}, "finite number"),
        ({"metric": "median_abs_difference_ratio_vnir", "at_most": None, "at_least": 0.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": None, "at_least": 0.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": 1.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": 0.5}, "state its level as 'at_least'"),
        ({"metric": "median_abs_diference_ratio_windows"}, "is not a metric"),
        ({"metric": "pd_difference@1e-2", "at_most": 1.0}, "can never fail"),
        ({"metric": "chi2_reduced_full", "at_most": 1e12}, "accepts anything"),
        ({"metric": "spectral_angle", "at_most": 90.0}, "can never fail"),
        ({"fraction_at_least": 0.0}, "greater than 0"),
        ({"fraction_at_least": 1.1}, "less than or equal to 1"),
        ({"bands_nm": (900.0, 400.0)}, "is an empty range"),
        ({"reason": ""}, "at least 1 character"),
        ({"subjects": []}, "at least 1 item"),
        ({"product": "radiances"}, "Input should be 'radiance'"),
        ({"at_mots": 0.1}, "Extra inputs"),
    ],
)
def test_gates_that_could_never_fail_or_mean_nothing_are_refused(slip, message):
    with pytest.raises(ValueError, match=message):
        gate(**slip)


AXIS = SpectralAxis(np.arange(450.0, 900.0, 10.0), 10.0)
NOISE = 0.01 * np.random.default_rng(3).standard_normal((2, len(AXIS)))
GATES = [
    gate(subjects=["*"]),
    gate(metric="p_value_full", at_most=None, at_least=0.01, subjects=["*"]),
    gate(product="roc", metric="pd_difference", at_most=None, within=(-0.05, 0.05), method="cem/*", subjects=["*"]),
]


def sides(mean=1.0, pd=0.7, observed_mean=1.0, width=0.15, lacking=None):
    """Prediction and observation of one class and one curve; ``lacking`` leaves a product out of one of them."""

    def curve(middle, half, *counts):
        pfa, pd = np.array([1e-3, 1e-2, 1e-1, 1.0]), np.array([middle, middle, middle, 1.0])
        return RocCurve(pfa, pd, np.clip(pd - half, 0, 1), np.clip(pd + half, 0, 1), -pfa, "object", *counts)

    def products(side, name, level, noise, roc):
        spectrum = SpectralEstimate(level + noise, 1e-4 * np.eye(len(AXIS)), n=50)
        held = {"radiance": {"grass": spectrum}, "roc": {("t", "cem", "object"): roc}}
        return side(AXIS, **{key: value for key, value in held.items() if (name, key) != lacking})

    return (
        products(PredictedProducts, "predicted", mean, NOISE[0], curve(pd, 0.0)),
        products(ObservedProducts, "observed", observed_mean, NOISE[1], curve(0.7, width, 20, 50_000)),
    )


@pytest.mark.parametrize(
    ("falsified", "code"),
    [
        ({}, 0), ({"mean": 1.07}, 1), ({"mean": 0.9}, 1), ({"observed_mean": 1.2}, 1), ({"pd": 0.95}, 1),
        ({"pd": 0.3}, 1), ({"mean": math.nan}, 1), ({"observed_mean": 0.0}, 1), ({"observed_mean": -1.0}, 1),
        ({"lacking": ("predicted", "radiance")}, 1), ({"lacking": ("observed", "roc")}, 1),
    ],
)  # fmt: skip
def test_each_falsified_product_turns_the_verdict(falsified, code):
    assert exit_code(compare_products(*sides(**falsified)), GATES) == code


@pytest.mark.parametrize("falsified", [{"pd": math.nan}, {"width": math.nan}])
def test_a_curve_that_says_nothing_is_no_agreement(falsified):
    found = judge_rows(compare_products(*sides(**falsified)), GATES)
    curves = [r.outcome for r in found if r.gates and r.product == "roc"]
    assert curves
    assert set(curves) <= {S, U, E}
    assert ResultTable(found).exit_code(strict=True) == 1
