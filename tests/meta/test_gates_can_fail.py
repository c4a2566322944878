"""Every kind of gate is broken on purpose and must turn red; only sound rows may pass."""

import math

import numpy as np
import pytest

from hyperval.compare import Gate, compare_products, judged
from hyperval.config import parse_yaml, validate
from hyperval.errors import UsageError
from hyperval.products import ObservedProducts, PredictedProducts, RocCurve, SpectralEstimate
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.spectra import SpectralAxis

METRIC = "median_difference_ratio_windows"
A, D, U, S, E, N = (
    Outcome.AGREES, Outcome.DISAGREES, Outcome.UNDECIDED, Outcome.SKIPPED, Outcome.ERROR, Outcome.NONE,
)  # fmt: skip


def row(value, half=0.005, metric=METRIC, subject="grass", product="radiance", **more):
    ends = {} if half is None else {"lower": value - half, "upper": value + half}
    return Result("camp", product, subject, "model", metric, value, **{**ends, **more})


def gate(**more):
    fields = {"product": "radiance", "metric": METRIC, "subjects": ["grass"], "at_most": 0.05, "reason": "why"}
    return Gate(**{k: v for k, v in {**fields, **more}.items() if v is not None})


def outcome(rows, *gates):
    found = judged(rows, gates)
    return {r.outcome for r in found}, ResultTable(found).exit_code()


def test_an_interval_inside_the_range_agrees_with_its_limits():
    (found,) = judged([row(0.03)], [gate()])
    assert (found.outcome, found.limit_high, found.role, found.value) == (A, 0.05, Role.GATE, 0.03)
    assert math.isnan(found.limit_low)
    assert ResultTable([found]).exit_code() == 0


@pytest.mark.parametrize(
    ("broken", "expected", "code"),
    [
        (row(0.061), D, 1),
        (row(0.048), U, 5),  # the value passes, its interval reaches beyond
        (row(0.052), U, 5),  # the value does not, its interval reaches inside
        (row(0.03, half=None), U, 5),  # a value alone
        (row(0.0, half=math.inf), U, 5),  # a vacuous interval
        (row(math.nan, half=None), E, 1),
        (row(0.03, lower=0.04, upper=0.02), E, 1),
        (row(0.03, lower=0.04, upper=0.06), E, 1),
        (row(math.nan, None, "comparison", outcome=S, cause=Cause.NO_PREDICTION), E, 1),
        (row(math.nan, None, outcome=S, cause=Cause.FEW_PIXELS), S, 5),
        (row(0.03, outcome=E, reason="it broke"), E, 1),
    ],
)
def test_only_an_interval_inside_the_range_agrees(broken, expected, code):
    assert outcome([broken], gate()) == ({expected}, code)


@pytest.mark.parametrize(
    ("broken", "why"),
    [
        (row(0.03, lower=0.04, upper=0.02), "the interval 0.04 to 0.02 is inverted"),
        (row(0.03, lower=0.04, upper=0.06), "the value lies outside its interval 0.04 to 0.06"),
        (row(math.nan, None, outcome=S, cause=Cause.FEW_PIXELS, reason="few pixels"), "few pixels"),
        (row(math.nan, half=None), "the value is not a number"),
    ],
)
def test_a_row_without_an_outcome_of_its_own_says_why(broken, why):
    (found,) = judged([broken], [gate(reason="the plan")])
    assert found.reason == f"{why}; the plan"
    assert found.cause is not Cause.NONE


@pytest.mark.parametrize(("value", "code"), [(0.0, 0), (0.06, 1), (-0.06, 1), (math.nan, 1)])
def test_within_turns_red_on_both_sides(value, code):
    w = gate(metric="bias_ratio", at_most=None, within=(-0.05, 0.05))
    half = None if math.isnan(value) else 0.005
    assert outcome([row(value, half, "bias_ratio")], w)[1] == code


def test_a_test_disagrees_below_its_level_and_agrees_only_with_power():
    p = gate(metric="p_value_full", at_most=None, at_least=0.05)
    for value, detectable, expected in (
        (0.4, 0.02, A), (0.4, 0.2, U), (0.4, math.nan, U), (0.01, 0.02, D), (1e-9, 0.2, D), (0.9999, 0.02, D),
    ):  # fmt: skip
        (found,) = judged([row(value, None, "p_value_full", detectable=detectable)], [p])
        assert found.outcome is expected, value
    (wide,) = judged([row(0.9999, None, "p_value_full", detectable=0.02)], [p])
    assert wide.cause is Cause.TOO_WIDE


def test_the_levels_of_a_campaign_are_shared_out():
    """Five tests at 0.05: only what is below a fifth of it, then a quarter, disagrees."""
    p = gate(metric="p_value_shape", at_most=None, at_least=0.05, subjects=["*"])
    values = (0.002, 0.012, 0.4, 0.5, 0.6)
    rows = [row(v, None, "p_value_shape", f"s{i}", detectable=0.01) for i, v in enumerate(values)]
    found = judged(rows, [p])
    assert [r.outcome for r in found] == [D, U, A, A, A]  # two-sided: 0.004 and 0.024 against 0.01 and 0.0125
    assert found[1].cause is Cause.MULTIPLICITY
    (alone,) = judged([rows[1]], [p])
    assert alone.outcome is D


@pytest.mark.parametrize(("value", "expected"), [(1.0, U), (0.0, D)])
def test_inside_an_interval_is_coverage_and_not_agreement(value, expected):
    inside = gate(product="roc", metric="pd_inside_interval", at_most=None, at_least=1.0)
    (found,) = judged([row(value, None, "pd_inside_interval@1e-2", product="roc")], [inside])
    assert found.outcome is expected
    assert (found.cause is Cause.COVERAGE) == (expected is U)


@pytest.mark.parametrize(("value", "expected"), [(1.0, A), (0.0, U), (-1.0, D)])
def test_equivalence_has_three_outcomes(value, expected):
    equal = gate(product="roc", metric="pd_equivalence", at_most=None, at_least=1.0)
    (found,) = judged([row(value, None, "pd_equivalence@1e-2", product="roc")], [equal])
    assert found.outcome is expected


@pytest.mark.parametrize("change", [{"subjects": ["gras"]}, {"product": "snr"}])
def test_a_gate_that_meets_no_row_turns_red(change):
    outcomes, code = outcome([row(0.03)], gate(**change))
    assert E in outcomes
    assert code == 1
    assert outcome([], gate())[1] == 1


def test_every_subject_pattern_must_be_met():
    found = judged([row(0.03)], [gate(subjects=["grass", "asphalt*"])])
    absent = [r for r in found if r.outcome is E]
    assert [(r.subject, r.cause) for r in absent] == [("asphalt*", Cause.ABSENT)]
    assert "planned but absent" in absent[0].reason
    also_informing = judged([row(0.03)], [gate(subjects=["asphalt"], gate=False)])
    assert E in {r.outcome for r in also_informing}


def test_nothing_decided_is_no_agreement():
    for gates in ([], [gate(gate=False)]):
        assert ResultTable(judged([row(0.03)], gates)).exit_code() == 5
    assert ResultTable(judged([], [])).exit_code() == 5


def test_strict_counts_what_could_not_be_told():
    found = ResultTable(judged([row(0.03), row(0.048, subject="lawn")], [gate(subjects=["*"])]))
    assert (found.exit_code(), found.exit_code(strict=True)) == (0, 1)
    assert ResultTable(judged([row(0.03)], [gate()])).exit_code(strict=True) == 0


def test_a_comparison_that_informs_has_its_outcome_and_decides_nothing():
    found = judged([row(0.5), row(0.01)], [gate(gate=False, reason="not found by any detector")])
    assert [r.outcome for r in found] == [D, A]
    assert {r.role for r in found} == {Role.INFORM}
    assert ResultTable(found).exit_code() == 5
    lost = row(math.nan, None, outcome=S, cause=Cause.NO_PREDICTION, reason="no data")
    assert judged([lost], [gate(gate=False)])[0].outcome is S


def test_two_gates_on_one_row_both_count():
    found = judged([row(0.03)], [gate(), gate(at_most=0.02)])
    assert [r.outcome for r in found] == [A, D]
    assert [r.limit_high for r in found] == [0.05, 0.02]


def test_rows_outside_the_gate_are_untouched():
    other = row(9.0, subject="asphalt")
    assert judged([other, row(0.01)], [gate()])[0] == other


def test_a_metric_with_a_usual_range_is_judged_unasked_and_informs():
    ratio, untold = judged([row(20.0, 5.0, "pfa_ratio@1e-3", product="scores"), row(0.5, metric="z")], [])
    assert (ratio.outcome, ratio.role, ratio.limit_low, ratio.limit_high) == (D, Role.INFORM, 0.5, 2.0)
    assert untold.outcome is N


def test_what_a_comparison_could_have_seen_stands_beside_it():
    """0.05 + 0.005 (1 + 0.842/1.960): of such errors four in five leave the interval beyond the limit."""
    (found,) = judged([row(0.03)], [gate(at_most=None, within=(-0.05, 0.05))])
    assert found.detectable == pytest.approx(0.0571470, rel=1e-6)
    rng = np.random.default_rng(5)
    seen = found.detectable + 0.005 / 1.959964 * rng.standard_normal(2000)
    share = np.mean([judged([row(v)], [gate(at_most=None, within=(-0.05, 0.05))])[0].outcome is D for v in seen[:2000]])
    assert abs(share - 0.8) < 0.036  # four standard errors: one failure in 16000


def test_a_choice_after_the_data_says_what_it_was_before():
    with pytest.raises(ValueError, match="stand together"):
        gate(chosen_after=True)
    with pytest.raises(ValueError, match="stand together"):
        gate(before="at most 0.05")
    assert gate(chosen_after=True, before="at most 0.05", at_most=0.06).before == "at most 0.05"


def pooled(fraction=0.9, **more):
    fields = {"product": "roc", "metric": "pd_inside_interval", "subjects": ["*"], "at_most": None}
    return gate(**{**fields, "fraction_at_least": fraction, **more})


def verdicts(values):
    return [
        row(v, None, metric="pd_inside_interval@1e-2", product="roc", subject=f"t{i}") for i, v in enumerate(values)
    ]


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
    assert outcome(verdicts(values), pooled())[1] == code


def test_a_skipped_comparison_counts_as_open_in_a_pool():
    lost = [row(math.nan, None, "comparison", s, "roc", outcome=S, cause=Cause.NO_PREDICTION) for s in "ab"]
    found = judged([*verdicts([1.0] * 8), *lost], [pooled()])
    last = found[-1]
    assert (last.outcome, last.value, last.n) == (U, 0.8, 10)
    assert last.upper == 1.0
    assert "2 without an outcome of their own" in last.reason
    assert last.metric == "pd_inside_interval_fraction"
    assert {r.outcome for r in found[:-1]} == {N, S}  # members do not decide alone


def test_pooled_gate_with_a_limit_over_bands():
    values = [0.01] * 60 + [0.2, -0.2]
    bands = [row(v, metric="difference_ratio", band_nm=500.0 + i) for i, v in enumerate(values)]
    limit = gate(metric="difference_ratio", at_most=None, within=(-0.05, 0.05), fraction_at_least=0.8)
    assert outcome(bands, limit)[1] == 0
    narrowed = limit.model_copy(update={"bands_nm": (559.5, 600.0)})
    (last,) = judged(bands, [narrowed])[-1:]
    assert (last.value, last.n) == (0.0, 2)  # only the two bad bands are left
    assert "outside: grass difference_ratio 560 nm" in last.reason


def test_a_pooled_gate_that_informs_decides_nothing():
    found = judged(verdicts([0.0] * 8), [pooled(gate=False)])
    assert (found[-1].outcome, found[-1].role) == (D, Role.INFORM)


@pytest.mark.parametrize(
    ("slip", "message"),
    [
        ({"at_most": None}, "a limit is missing"),
        ({"at_least": 0.1}, "one limit only"),
        ({"at_most": 1e9}, "100 % or more"),
        ({"at_most": 1.0}, "100 % or more"),
        ({"at_most": math.nan}, "finite number"),
        ({"at_most": math.inf}, "finite number"),
        ({"at_most": None, "within": (0.1, 0.1)}, "holds no range"),
        ({"at_most": None, "within": (0.1, -0.1)}, "holds no range"),
        ({"at_most": None, "within": (math.nan, 0.1)}, "finite number"),
        ({"metric": "median_abs_difference_ratio_vnir", "at_most": None, "at_least": 0.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": None, "at_least": 0.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": 1.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": 0.5}, "its level is 'at_least'"),
        ({"metric": "median_abs_diference_ratio_windows"}, "is not a metric"),
        ({"metric": "pd_difference@1e-2", "at_most": 1.0}, "can never fail"),
        ({"metric": "chi2_reduced_full", "at_most": 1e12}, "accepts anything"),
        ({"metric": "spectral_angle", "at_most": 90.0}, "can never fail"),
        ({"fraction_at_least": 0.0}, "greater than 0"),
        ({"fraction_at_least": 1.1}, "less than or equal to 1"),
        ({"bands_nm": (900.0, 400.0)}, "holds no range"),
        ({"reason": ""}, "at least 1 character"),
        ({"subjects": []}, "at least 1 item"),
        ({"metric": ""}, "at least 1 character"),
        ({"product": "radiances"}, "Input should be 'radiance'"),
        ({"at_mots": 0.1}, "Extra inputs"),
    ],
)
def test_gates_that_could_never_fail_or_mean_nothing_are_refused(slip, message):
    with pytest.raises(ValueError, match=message):
        gate(**slip)


def test_a_slip_in_yaml_is_named_with_its_line():
    text = "product: radiance\nmetric: median_abs_difference_ratio_windows\nat_mots: 0.01\nreason: x\n"
    data, lines = parse_yaml(text, "campaign.yaml")
    with pytest.raises(UsageError, match=r"campaign\.yaml:3: at_mots: unknown key; did you mean 'at_most'"):
        validate(Gate, data, lines, "campaign.yaml")


AXIS = SpectralAxis(np.arange(450.0, 900.0, 10.0), 10.0)
GATES = [
    gate(subjects=["*"]),
    gate(metric="p_value_full", at_most=None, at_least=0.01, subjects=["*"]),
    gate(product="roc", metric="pd_difference", at_most=None, within=(-0.05, 0.05), method="cem/*", subjects=["*"]),
]


NOISE = 0.01 * np.random.default_rng(3).standard_normal((2, len(AXIS)))


def sides(mean=1.0, pd=0.7, observed_mean=1.0, width=0.15):
    def spectrum(m, noise):
        return SpectralEstimate(m + noise, 1e-4 * np.eye(len(AXIS)), n=50)

    pfa = np.array([1e-3, 1e-2, 1e-1, 1.0])

    def curve(p, half, n):
        middle = np.full(4, p)
        middle[-1] = 1.0
        low, high = np.clip(middle - half, 0, 1), np.clip(middle + half, 0, 1)
        return RocCurve(pfa, middle, low, high, -pfa, "object", n, None if n is None else 50_000)

    return (
        PredictedProducts(
            AXIS, radiance={"grass": spectrum(mean, NOISE[0])}, roc={("t", "cem", "object"): curve(pd, 0.0, None)}
        ),
        ObservedProducts(
            AXIS,
            radiance={"grass": spectrum(observed_mean, NOISE[1])},
            roc={("t", "cem", "object"): curve(0.7, width, 20)},
        ),
    )


def code_of(predicted, observed):
    rows = compare_products(predicted, observed)
    return ResultTable(judged(rows, GATES)).exit_code()


def test_a_sound_comparison_is_green_from_end_to_end():
    assert code_of(*sides()) == 0


@pytest.mark.parametrize(
    "falsified",
    [{"mean": 1.07}, {"mean": 0.9}, {"observed_mean": 1.2}, {"pd": 0.95}, {"pd": 0.3}, {"mean": math.nan},
         {"observed_mean": 0.0}, {"observed_mean": -1.0}],
)  # fmt: skip
def test_each_falsified_product_turns_the_verdict(falsified):
    assert code_of(*sides(**falsified)) == 1


@pytest.mark.parametrize("falsified", [{"pd": math.nan}, {"width": math.nan}])
def test_a_curve_that_says_nothing_is_no_agreement(falsified):
    rows = compare_products(*sides(**falsified))
    found = [r for r in judged(rows, GATES) if r.gates and r.product == "roc"]
    assert found
    assert {r.outcome for r in found} <= {S, U, E}
    assert ResultTable(judged(rows, GATES)).exit_code(strict=True) == 1


def test_a_missing_product_turns_the_verdict():
    predicted, observed = sides()
    assert code_of(PredictedProducts(AXIS, roc=predicted.roc), observed) == 1
    assert code_of(predicted, ObservedProducts(AXIS, radiance=observed.radiance)) == 1
    assert code_of(PredictedProducts(AXIS), ObservedProducts(AXIS)) == 1
