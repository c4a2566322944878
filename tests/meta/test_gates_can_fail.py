"""Every kind of gate is broken on purpose and must turn red; only sound rows may pass."""

import math

import numpy as np
import pytest

from hyperval.compare import Gate, apply_gates, compare_products
from hyperval.config import parse_yaml, validate
from hyperval.errors import UsageError
from hyperval.products import Observation, Prediction, RocCurve, SpectralEstimate
from hyperval.results import Result, ResultTable, Status
from hyperval.spectra.axis import SpectralAxis

METRIC = "median_abs_difference_ratio_windows"


def row(value, metric=METRIC, subject="grass", product="radiance", **more):
    return Result("camp", product, subject, "model", metric, value, **more)


def gate(**more):
    fields = {"product": "radiance", "metric": METRIC, "subjects": ["grass"], "at_most": 0.05, "reason": "why"}
    return Gate(**{k: v for k, v in {**fields, **more}.items() if v is not None})


def outcome(rows, *gates):
    judged = apply_gates(rows, gates)
    return {r.status for r in judged}, ResultTable(judged).exit_code()


def test_a_good_row_passes_with_its_threshold():
    (judged,) = apply_gates([row(0.03)], [gate()])
    assert (judged.status, judged.threshold, judged.value) == (Status.PASS, 0.05, 0.03)
    assert ResultTable([judged]).exit_code() == 0


@pytest.mark.parametrize(
    ("broken", "status"),
    [
        (row(0.051), Status.FAIL),
        (row(math.inf), Status.FAIL),
        (row(math.nan), Status.ERROR),
        (row(0.03, lower=0.04, upper=0.02), Status.ERROR),
        (row(0.03, lower=0.04, upper=0.06), Status.ERROR),
        (row(math.nan, metric="comparison", status=Status.SKIPPED, reason="no radiance"), Status.ERROR),
        (row(math.nan, status=Status.SKIPPED, reason="no comparable band"), Status.ERROR),
        (row(0.03, status=Status.ERROR, reason="it broke"), Status.ERROR),
    ],
)
def test_at_most_turns_red(broken, status):
    assert outcome([broken], gate()) == ({status}, 1)


@pytest.mark.parametrize(
    ("broken", "why"),
    [
        (row(0.03, lower=0.04, upper=0.02), "the interval 0.04 to 0.02 is inverted"),
        (row(0.03, lower=0.04, upper=0.06), "the value lies outside its interval 0.04 to 0.06"),
        (row(math.nan, status=Status.SKIPPED, reason="no band"), "a gated comparison was skipped: no band"),
        (row(math.nan), "the value is not a number"),
        (row(0.07), "0.07 is not at most 0.05"),
    ],
)
def test_a_red_row_says_why(broken, why):
    (judged,) = apply_gates([broken], [gate(reason="the plan")])
    assert judged.reason == f"{why}; the plan"


@pytest.mark.parametrize("value", [0.049, -1.0, math.nan, -math.inf])
def test_at_least_turns_red(value):
    p = gate(metric="p_value_full", at_most=None, at_least=0.05)
    assert outcome([row(0.05, metric="p_value_full")], p) == ({Status.PASS}, 0)
    assert outcome([row(value, metric="p_value_full")], p)[1] == 1


@pytest.mark.parametrize(("value", "threshold"), [(0.06, 0.05), (-0.06, -0.05), (math.nan, -0.05)])
def test_within_turns_red_on_both_sides(value, threshold):
    w = gate(metric="bias_ratio", at_most=None, within=(-0.05, 0.05))
    assert outcome([row(-0.05, metric="bias_ratio")], w) == ({Status.PASS}, 0)
    (judged,) = apply_gates([row(value, metric="bias_ratio")], [w])
    assert judged.status in {Status.FAIL, Status.ERROR}
    assert judged.threshold == threshold


@pytest.mark.parametrize(
    "change", [{"subjects": ["gras"]}, {"metric": "median_abs_diference_ratio_windows"}, {"product": "snr"}]
)
def test_a_gate_that_meets_no_row_turns_red(change):
    statuses, code = outcome([row(0.03)], gate(**change))
    assert Status.ERROR in statuses
    assert code == 1
    assert outcome([], gate())[1] == 1


def test_every_subject_pattern_must_be_met():
    judged = apply_gates([row(0.03)], [gate(subjects=["grass", "asphalt*"])])
    absent = [r for r in judged if r.status is Status.ERROR]
    assert [r.subject for r in absent] == ["asphalt*"]
    assert "planned but absent" in absent[0].reason
    also_informing = apply_gates([row(0.03)], [gate(subjects=["asphalt"], gate=False)])
    assert Status.ERROR in {r.status for r in also_informing}


def test_nothing_gated_is_not_a_pass():
    assert ResultTable(apply_gates([row(0.03)], [])).exit_code() == 5
    assert ResultTable(apply_gates([row(0.03)], [gate(gate=False)])).exit_code() == 5
    assert ResultTable(apply_gates([], [])).exit_code() == 5


def test_an_informing_gate_never_decides_but_says_what_it_saw():
    bad, good = apply_gates([row(0.5), row(0.01)], [gate(gate=False, reason="not found by any detector")])
    assert (bad.status, good.status) == (Status.INFO, Status.INFO)
    assert bad.reason.startswith("would not pass at most 0.05")
    assert good.reason.startswith("would pass at most 0.05")
    assert "informs only: not found by any detector" in bad.reason
    (unknown,) = apply_gates([row(math.nan)], [gate(gate=False)])
    assert unknown.reason.startswith("would be an error")
    skipped = row(math.nan, status=Status.SKIPPED, reason="no data")
    assert apply_gates([skipped], [gate(gate=False)])[0].status is Status.SKIPPED


def test_two_gates_on_one_row_both_count():
    judged = apply_gates([row(0.03)], [gate(), gate(at_most=0.02)])
    assert [r.status for r in judged] == [Status.PASS, Status.FAIL]
    assert [r.threshold for r in judged] == [0.05, 0.02]


def test_rows_outside_the_gate_are_untouched():
    other = row(9.0, subject="asphalt")
    assert apply_gates([other, row(0.01)], [gate()])[0] == other


def pooled(fraction=0.9, **more):
    fields = {"product": "roc", "metric": "pd_inside_interval", "subjects": ["*"], "at_most": None}
    return gate(**{**fields, "fraction_at_least": fraction, **more})


def verdicts(values):
    return [row(v, metric="pd_inside_interval@1e-2", product="roc", subject=f"t{i}") for i, v in enumerate(values)]


@pytest.mark.parametrize(
    ("values", "code"),
    [
        ([1.0] * 9 + [0.0], 0),
        ([1.0] * 8 + [0.0] * 2, 1),
        ([1.0] * 8 + [0.0, math.nan], 1),
        ([math.nan] * 10, 1),
        ([], 1),
    ],
)
def test_pooled_gate(values, code):
    assert outcome(verdicts(values), pooled())[1] == code


def test_a_skipped_comparison_counts_as_outside_a_pool():
    lost = [row(math.nan, metric="comparison", product="roc", subject=s, status=Status.SKIPPED) for s in "ab"]
    judged = apply_gates([*verdicts([1.0] * 8), *lost], [pooled()])
    assert (judged[-1].status, judged[-1].value, judged[-1].n) == (Status.FAIL, 0.8, 10)
    assert "outside: a, b" in judged[-1].reason
    assert judged[-1].metric == "pd_inside_interval_fraction"
    assert {r.status for r in judged[:-1]} == {Status.INFO, Status.SKIPPED}  # members do not decide alone


def test_pooled_gate_with_a_limit_over_bands():
    bands = [row(v, metric="difference_ratio", band_nm=500.0 + i) for i, v in enumerate([0.01] * 18 + [0.2, -0.2])]
    limit = gate(metric="difference_ratio", at_most=None, within=(-0.05, 0.05), fraction_at_least=0.9)
    assert outcome(bands, limit)[1] == 0
    assert outcome([*bands, row(0.3, metric="difference_ratio", band_nm=600.0)], limit)[1] == 1
    narrowed = limit.model_copy(update={"bands_nm": (517.5, 600.0)})
    assert outcome(bands, narrowed)[1] == 1  # only the two bad bands are left


def test_a_pooled_gate_that_informs_stays_info():
    judged = apply_gates(verdicts([0.0] * 4), [pooled(gate=False)])
    assert judged[-1].status is Status.INFO
    assert "would not pass at least 0.9" in judged[-1].reason


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
        ({"at_most": None, "at_least": 0.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": None, "at_least": 0.0}, "can never fail"),
        ({"metric": "p_value_full", "at_most": 1.0}, "can never fail"),
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
    pooled(1.0, method="cem/*"),
]


def sides(mean=1.001, pd=0.7, observed_mean=1.0, width=0.15):  # equal sides would be no evidence
    spectrum = lambda m: SpectralEstimate(np.full(len(AXIS), m), 1e-4 * np.eye(len(AXIS)), n=50)  # noqa: E731
    pfa = np.array([1e-3, 1e-2, 1e-1, 1.0])

    def curve(p, half, n):
        middle = np.full(4, p)
        middle[-1] = 1.0
        low, high = np.clip(middle - half, 0, 1), np.clip(middle + half, 0, 1)
        return RocCurve(pfa, middle, low, high, -pfa, "object", n, None if n is None else 50_000)

    return (
        Prediction(AXIS, radiance={"grass": spectrum(mean)}, roc={("t", "cem", "object"): curve(pd, 0.0, None)}),
        Observation(
            AXIS, radiance={"grass": spectrum(observed_mean)}, roc={("t", "cem", "object"): curve(0.7, width, 20)}
        ),
    )


def code_of(predicted, observed):
    rows = compare_products(predicted, observed, campaign="camp", pfa=[1e-2, 1e-3])
    return ResultTable(apply_gates(rows, GATES)).exit_code()


def test_a_sound_comparison_is_green_from_end_to_end():
    assert code_of(*sides()) == 0


@pytest.mark.parametrize(
    "falsified",
    [{"mean": 1.07}, {"mean": 0.9}, {"observed_mean": 1.2}, {"pd": 0.95}, {"pd": 0.3}, {"mean": math.nan},
     {"pd": math.nan}, {"width": math.nan}, {"observed_mean": 0.0}, {"observed_mean": -1.0}],
)  # fmt: skip
def test_each_falsified_product_turns_the_verdict(falsified):
    assert code_of(*sides(**falsified)) == 1


def test_a_missing_product_turns_the_verdict():
    predicted, observed = sides()
    assert code_of(Prediction(AXIS, roc=predicted.roc), observed) == 1
    assert code_of(predicted, Observation(AXIS, radiance=observed.radiance)) == 1
    assert code_of(Prediction(AXIS), Observation(AXIS)) == 1
