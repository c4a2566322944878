"""Scores, ROC, areas and the drive over all products."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from scipy import stats
from scipy.stats import norm

from hyperval.compare import (
    Gate,
    RowMaker,
    compare_abundance,
    compare_area_errors,
    compare_products,
    compare_roc,
    compare_scores,
    difference_interval,
    far_at_detection_rows,
    joint_rows,
    judged,
    predicted_area,
    product_rows,
)
from hyperval.errors import UsageError
from hyperval.model import (
    AREAS,
    WHOLE,
    Z95,
    ClassScores,
    clopper_pearson,
    curve_area,
    greatest_class_false_alarm,
    thresholds_at,
    zero_count_upper_limit,
)
from hyperval.pixels import counts_of, empirical_roc, roc_area, with_summary
from hyperval.products import (
    Abundance,
    AlarmsAtDetection,
    ObservedProducts,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.results import Cause, Outcome
from hyperval.spectra import SpectralAxis

NAMES = {"subject": "planks", "method": "cem/object"}


def model_curve(separation, width=0.0, unit="object"):
    pfa = np.geomspace(1e-9, 1.0, 400)
    threshold = stats.norm.isf(pfa)
    pd = [stats.norm.sf(threshold - d) for d in (separation - width, separation, separation + width)]
    return RocCurve(pfa, pd[1], pd[0], pd[2], threshold, unit)


def measured_curve(separation, seed=1, targets=30, background=20000):
    rng = np.random.default_rng(seed)
    return empirical_roc(rng.normal(separation, 1, targets), rng.normal(0, 1, background), unit="object")


@pytest.mark.slow
def test_true_predictions_are_inside_95_times_of_100():
    # 300 collections: the rule is conservative; at exactly 95 % the sd is 1.3 %, so above 92 % (2.4 sd, 1 %).
    inside = [
        by_metric(compare_roc(model_curve(2.5), measured_curve(2.5, seed, 25, 5000), pfa=[1e-2], **NAMES))[
            "pd_inside_interval@1e-2"
        ].value
        for seed in range(300)
    ]
    assert np.mean(inside) > 0.92


def test_overlapping_intervals_are_not_enough():
    curve = lambda pd, low, high: RocCurve(  # noqa: E731
        np.array([0.01, 1.0]), np.array([pd, 1.0]), np.array([low, 1.0]), np.array([high, 1.0]), np.zeros(2)
    )
    predicted, observed = curve(0.80, 0.70, 0.90), curve(0.62, 0.52, 0.72)
    assert predicted.pd_lower[0] < observed.pd_upper[0]  # they overlap
    rows = by_metric(compare_roc(predicted, observed, pfa=[0.01], **NAMES))
    assert rows["pd_inside_interval@1e-2"].value == 0.0
    nearer = by_metric(compare_roc(curve(0.74, 0.64, 0.84), observed, pfa=[0.01], **NAMES))
    assert nearer["pd_inside_interval@1e-2"].value == 1.0
    assert nearer["pd_inside_measured_interval@1e-2"].value == 0.0  # the width of the prediction was needed


def test_difference_interval_covers():
    # Two binomial proportions with Clopper-Pearson limits: conservative, 1000 draws, above 93 %.
    rng = np.random.default_rng(2)
    hits = 0
    for a, b in zip(rng.binomial(40, 0.8, 1000), rng.binomial(25, 0.6, 1000), strict=True):
        one, two = (float(x) for x in clopper_pearson(a, 40)), (float(x) for x in clopper_pearson(b, 25))
        low, high = difference_interval(a / 40, tuple(one), b / 25, tuple(two))
        hits += low <= 0.2 <= high
    assert hits / 1000 > 0.93


def test_difference_interval_by_hand_with_uneven_sides():
    # The upper side of a and the lower side of b stretch the upper limit; the other two the lower limit.
    low, high = difference_interval(0.8, (0.76, 0.92), 0.5, (0.45, 0.53))
    assert low == pytest.approx(0.3 - 0.05)
    assert high == pytest.approx(0.3 + 0.13)


def test_lower_false_alarm_rates_only_where_the_background_allows():
    small = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0, background=2000), **NAMES))
    assert small["pd_difference@1e-3"].outcome is Outcome.SKIPPED
    assert "2000 background samples expect 2 alarms" in small["pd_difference@1e-3"].reason
    assert "pd_difference@1e-4" not in small
    large = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0, background=200_000), **NAMES))
    assert large["pd_difference@1e-4"].outcome is Outcome.NONE
    assert "pd_difference@1e-5" not in large


def test_a_curve_that_ends_early_or_has_no_interval():
    short = RocCurve(*np.array([[0.05, 1.0], [0.5, 1.0], [0.4, 1], [0.6, 1], [1, 0]]), "object")
    rows = by_metric(compare_roc(model_curve(2.0), short, pfa=[1e-2], **NAMES))
    assert rows["pd_measured@1e-2"].reason == "the measured curve has no point at P_FA 1e-2"
    nan = np.full(2, np.nan)
    bare = RocCurve(np.array([1e-3, 1.0]), np.array([0.5, 1.0]), nan, nan, nan, "object")
    rows = by_metric(compare_roc(model_curve(2.0), bare, pfa=[1e-2], **NAMES))
    assert np.isnan(rows["pd_inside_interval@1e-2"].value)  # unknown is neither inside nor outside
    rows = by_metric(compare_roc(bare, measured_curve(2.0), pfa=[1e-2], **NAMES))
    assert rows["pd_predicted@1e-2"].lower == rows["pd_predicted@1e-2"].value


def test_one_object_gives_values_but_no_verdict():
    # Measured 1 of 1: the interval is 0.05 to 1, so that a prediction of 1e-18 would be "inside".
    single = empirical_roc([5.0], np.random.default_rng(1).normal(size=20000), unit="object")
    rows = by_metric(compare_roc(model_curve(-9.0), single, equivalence_margin=0.1, **NAMES))
    assert rows["pd_measured@1e-2"].value == 1.0
    assert rows["pd_predicted@1e-2"].value < 1e-9
    for metric in ("pd_inside_interval", "pd_inside_measured_interval", "pd_equivalent"):
        row = rows[f"{metric}@1e-2"]
        assert row.outcome is Outcome.SKIPPED
        assert row.reason == "the measured interval 0.05 to 1 from 1 object accepts nearly any prediction"
    # A gate on it is skipped. A pool of this row alone knows nothing of the share: counted as amiss it is 0 of 1,
    # with 0 as the lower limit; counted as met 1 of 1, with 1 as the upper one; 0 to 1 lies neither in nor out.
    plan = {"product": "roc", "metric": "pd_inside_interval@1e-2", "reason": "why"}
    gated = judged(rows.values(), [Gate(**plan, at_least=1.0)])
    assert {r.outcome for r in gated if r.metric == "pd_inside_interval@1e-2"} == {Outcome.SKIPPED}
    pooled = judged(rows.values(), [Gate(**plan, fraction_at_least=0.5)])[-1]
    assert (pooled.outcome, pooled.value) == (Outcome.UNDECIDED, 0.0)
    assert (pooled.lower, pooled.upper) == (0.0, 1.0)
    assert "0 of 1 rows at least 1, 1 without an outcome of their own" in pooled.reason
    several = empirical_roc(np.full(5, 5.0), np.random.default_rng(1).normal(size=20000), unit="object")
    assert by_metric(compare_roc(model_curve(-9.0), several, **NAMES))["pd_inside_interval@1e-2"].value == 0.0


def test_units_of_the_curves_must_agree():
    with pytest.raises(UsageError, match="by pixel, the measured by object"):
        compare_roc(model_curve(2.0, unit="pixel"), measured_curve(2.0), **NAMES)


def test_auc_with_and_without_estimates():
    rng = np.random.default_rng(3)
    t, b = rng.normal(2, 1, 200), rng.normal(0, 1, 50000)
    whole, truth = model_curve(2.0, unit="pixel"), stats.norm.cdf(2 / np.sqrt(2))
    assert curve_area(whole, WHOLE) == pytest.approx(truth, abs=1e-5)

    def cut(end):
        kept = whole.pfa <= end
        return RocCurve(*(x[kept] for x in (whole.pfa, whole.pd, whole.pd_lower, whole.pd_upper, whole.threshold)))

    # A curve that stops at P_FA 0.6 is joined to (1, 1); one that stops at 0.3 has no area.
    assert by_metric(compare_roc(cut(0.6), whole, **NAMES))["auc_difference"].value == pytest.approx(0, abs=5e-3)
    assert by_metric(compare_roc(cut(0.3), whole, **NAMES))["auc_difference"].outcome is Outcome.SKIPPED
    curve = with_summary(empirical_roc(t, b, unit="object"), t, b)
    row = by_metric(compare_roc(model_curve(2.0), curve, **NAMES))["auc_difference"]
    assert row.lower < row.value < row.upper
    assert row.value == pytest.approx(truth - roc_area(counts_of(t, b)), abs=1e-5)


def test_score_moments():
    predicted, observed = ScoreDistribution(0.5, 0.2), ScoreDistribution(0.4, 0.1, 26)
    rows = by_metric(compare_scores(predicted, observed, **NAMES))
    half = stats.t.ppf(0.975, 25) * 0.1 / np.sqrt(26)
    assert rows["score_mean_difference"].value == pytest.approx(0.1)
    assert rows["score_mean_difference"].upper == pytest.approx(0.1 + half)
    assert rows["score_sd_ratio"].value == pytest.approx(2.0)
    assert rows["score_sd_ratio"].lower < 2.0 < rows["score_sd_ratio"].upper
    own = by_metric(compare_scores(predicted, ScoreDistribution(1e-16, 0.1, 26), **NAMES))
    assert np.isnan(own["score_mean_difference"].upper)  # 0 by construction of the filter: no chance is in it
    same = ScoreDistribution(0.4, 0.1, 26, mean_error=0.004, mean_bias=-0.01)  # of pixels that the filter is made of
    row = by_metric(compare_scores(predicted, same, **NAMES))["score_mean_difference"]
    assert row.value == pytest.approx(0.09)
    assert row.upper == pytest.approx(0.09 + stats.t.ppf(0.975, 25) * 0.004)
    single = by_metric(compare_scores(predicted, ScoreDistribution(0.4, 0.0, 1), **NAMES))
    assert single["score_sd_ratio"].outcome is Outcome.SKIPPED
    (row,) = compare_scores(predicted, None, **NAMES)
    assert (row.outcome, row.reason) == (Outcome.SKIPPED, "no scores of planks in the observation")


def test_sd_ratio_interval_covers():
    # 1000 samples of 15: sd of the share 0.7 %, band 4 sd.
    rng = np.random.default_rng(4)
    hits = 0
    for _ in range(1000):
        x = rng.normal(0, 0.1, 15)
        observed = ScoreDistribution(x.mean(), x.std(ddof=1), 15)
        row = by_metric(compare_scores(ScoreDistribution(0.0, 0.2), observed, **NAMES))["score_sd_ratio"]
        hits += row.lower <= 2.0 <= row.upper
    assert 0.92 < hits / 1000 < 0.98


def test_every_subject_of_either_side_has_rows():
    axis = SpectralAxis(np.arange(450.0, 900.0, 10.0), 10.0)
    one, model, measured = SpectralEstimate(np.ones(45), 1e-4 * np.eye(45)), model_curve(3.0), measured_curve(3.0)
    predicted = PredictedProducts(
        axis,
        radiance={"grass": one, "only model": one},
        reflectance={"grass": one},
        roc={("t", "cem", "object"): model},
    )
    observed = ObservedProducts(
        axis, radiance={"grass": one, "only data": one}, snr={"grass": one},
        roc={("t", "cem", "object"): measured, ("t", "ace", "object"): measured},
    )  # fmt: skip
    rows = compare_products(predicted, observed)
    assert {(r.product, r.subject, r.method) for r in rows if r.metric == "comparison"} == {
        ("radiance", "only model", "model"),
        ("radiance", "only data", "model"),
        ("snr", "grass", "model"),
        ("reflectance", "grass", "model"),
        ("roc", "t", "ace/object"),
    }
    assert {r.product for r in rows if r.outcome is Outcome.NONE} == {"radiance", "roc"}
    other = ObservedProducts(SpectralAxis(np.arange(451.0, 901.0, 10.0), 10.0))
    with pytest.raises(UsageError, match="not on the same spectral axis"):
        compare_products(predicted, other)


KM2 = 0.08


def whole_curve(separation, seed=1, targets=30, background=20_000, area=KM2):
    rng = np.random.default_rng(seed)
    t, b = rng.normal(separation, 1, targets), rng.normal(size=background)
    return with_summary(empirical_roc(t, b, unit="object", background_area_km2=area), t, b)


def by_metric(rows):
    return {r.metric: r for r in rows}


def test_every_row_of_a_true_prediction():
    rows = by_metric(compare_roc(model_curve(2.5, 0.1), whole_curve(2.5), **NAMES))
    for name in ("auc_{}", "partial_auc_{}@0..1e-1", "log_auc_{}@1e-3..1e-1", "far_{}@pd0.5", "far_{}@pd0.9"):
        p, o, d = (rows[name.format(side)] for side in ("predicted", "measured", "difference"))
        assert d.value == pytest.approx(p.value - o.value)
        for row in (p, o, d):
            assert row.lower <= row.value <= row.upper
            assert row.outcome is Outcome.NONE
        assert d.lower <= 0 <= d.upper
    assert rows["far_measured@pd0.5"].unit == "km-2"
    assert rows["auc_measured"].reason == "bootstrap of 30 objects, 1000 draws"
    assert rows["far_predicted@pd0.5"].value == pytest.approx(stats.norm.sf(2.5) * 20_000 / KM2, rel=0.01)
    for level in ("1e-1", "1e-2", "1e-3"):
        assert rows[f"pd_inside_joint_region@{level}"].value == 1.0
        assert rows[f"far_measured@{level}"].value == pytest.approx(float(level) * 20_000 / KM2)
    wrong = by_metric(compare_roc(model_curve(4.5), whole_curve(2.5), **NAMES))
    assert wrong["pd_inside_joint_region@1e-2"].value == 0.0
    assert wrong["auc_difference"].lower > 0
    assert wrong["far_difference@pd0.5"].upper < 0


def test_alarms_and_joint_region_by_hand():
    curve = whole_curve(2.5)
    rows = by_metric(compare_roc(model_curve(2.5), curve, **NAMES))
    low, high = (float(x) * 20_000 / KM2 for x in clopper_pearson(200, 20_000))
    assert (rows["far_measured@1e-2"].lower, rows["far_measured@1e-2"].upper) == pytest.approx((low, high))
    assert rows["far_measured@1e-2"].reason == "200 alarms on 0.08 km2"
    each = np.sqrt(0.95)
    joint = rows["joint_pfa@1e-2"]
    assert (joint.lower, joint.upper) == pytest.approx([float(x) for x in clopper_pearson(200, 20_000, each)])
    found = round(rows["joint_pd@1e-2"].value * 30)
    assert f"{found} of 30 objects and 200 of 20000 background samples" in joint.reason


def test_no_alarm_at_all_still_has_an_upper_limit():
    t, b = np.arange(20) + 100.0, np.random.default_rng(0).normal(size=12_203)
    curve = with_summary(empirical_roc(t, b, unit="object", background_area_km2=KM2), t, b)
    row = by_metric(compare_roc(model_curve(9.0), curve, **NAMES))["far_measured@pd0.5"]
    assert (row.value, row.lower) == (0.0, 0.0)
    one_sided = zero_count_upper_limit(12_203) * 12_203 / KM2
    assert "one-sided) " in row.reason + " "
    assert f"at most {one_sided:.4g}" in row.reason
    assert row.upper >= one_sided


def test_what_is_not_known_is_skipped_with_its_reason():
    rows = by_metric(compare_roc(model_curve(2.5), whole_curve(2.5, area=None), **NAMES))
    assert rows["far_measured@1e-2"].outcome is Outcome.SKIPPED
    assert "ground area" in rows["far_measured@pd0.9"].reason
    small = by_metric(compare_roc(model_curve(2.5), whole_curve(2.5, background=900), **NAMES))
    row = small["log_auc_difference@1e-3..1e-1"]
    assert row.outcome is Outcome.SKIPPED
    assert "900 background samples expect 0.9 alarms" in row.reason
    assert "joint_pd@1e-3" not in small
    one = by_metric(compare_roc(model_curve(2.5), whole_curve(2.5, targets=1), **NAMES))
    assert one["pd_inside_joint_region@1e-2"].outcome is Outcome.SKIPPED
    flat = RocCurve(*(np.array(x) for x in ([1e-3, 1.0], [0.95, 1], [0.9, 1], [0.97, 1], [1, 0])), "object")
    unreached = by_metric(compare_roc(flat, whole_curve(2.5), **NAMES))["far_predicted@pd0.5"]
    assert "does not pass P_D 0.5" in unreached.reason


def test_the_joint_region_holds_the_truth_though_the_background_sets_the_threshold():
    # 400 collections: conservative; at a true 0.95 fewer than 0.92 come in 0.4 % of runs (seed fixed).
    truth, make = model_curve(2.0), RowMaker("roc", "s", "m")
    rng = np.random.default_rng(8)
    hits = 0
    for _ in range(400):
        curve = empirical_roc(rng.normal(2, 1, 25), rng.normal(size=1500), [0.02], unit="object")
        rows = by_metric(joint_rows(make, truth, curve, 0.02))
        x = curve.threshold[0]
        pfa, pd = rows["joint_pfa@2e-2"], rows["joint_pd@2e-2"]
        inside = pfa.lower <= stats.norm.sf(x) <= pfa.upper and pd.lower <= stats.norm.sf(x - 2.0) <= pd.upper
        hits += inside
        if inside:  # the true curve passes through every region that holds the true point
            assert rows["pd_inside_joint_region@2e-2"].value == 1.0
    assert hits / 400 > 0.92


def test_one_side_alone_has_its_rows_too():
    axis, key = SpectralAxis(np.array([500.0, 600.0]), 5.0), ("planks", "cem", "object")
    seen = by_metric(product_rows(ObservedProducts(axis, roc={key: whole_curve(2.5)}), "observed"))
    assert {"auc_measured", "far_measured@1e-3", "far_measured@pd0.9", "joint_pd@1e-2"} <= set(seen)
    assert not any("predicted" in name or "difference" in name for name in seen)
    told = by_metric(product_rows(PredictedProducts(axis, roc={key: model_curve(2.5, 0.2)}), "predicted"))
    assert told["auc_predicted"].lower < told["auc_predicted"].value < told["auc_predicted"].upper
    assert not any(name.startswith(("far", "joint")) for name in told)
    bare = by_metric(product_rows(ObservedProducts(axis, roc={key: whole_curve(2.5, area=None)}), "observed"))
    assert not any(r.outcome is Outcome.SKIPPED for r in bare.values())


@pytest.mark.parametrize(
    ("start", "end", "pd", "inside"),
    [
        # The rectangle of 0 of 200 targets at 100 of 10,000 alarms: P_FA 0.0077 to 0.0127, P_D 0 to 0.022.
        (9e-3, 1e-1, 0.5, 1.0),  # begins inside: below its first point nothing is detected
        (1e-4, 1e-1, 0.5, 0.0),
        (1e-4, 1e-1, 0.01, 1.0),
    ],
)
def test_a_predicted_curve_that_ends_inside_the_rectangle_goes_on_to_nothing(start, end, pd, inside):
    pfa = np.array([1e-3, 1e-2, 1e-1])
    nothing = np.full(3, np.nan)
    measured = RocCurve(pfa, np.zeros(3), nothing, nothing, -pfa, "pixel", 200, 10_000, None, np.array([10, 100, 1000]))
    at = np.array([start, end])
    predicted = RocCurve(at, np.full(2, pd), nothing[:2], nothing[:2], -at, "pixel")
    rows = joint_rows(RowMaker("roc", "panel", "cem/pixel"), predicted, measured, 1e-2)
    assert rows[-1].metric == "pd_inside_joint_region@1e-2"
    assert rows[-1].value == inside
    assert (rows[1].value, rows[1].upper < 0.03) == (0.0, True)


PFA = np.geomspace(1e-4, 0.999, 81)


def flat_curve(pd, half=0.0, n=None, preset=None):
    level = np.full(PFA.size, pd)
    return RocCurve(
        PFA, level, level - half, level + half, norm.isf(PFA), "object", n, None if n is None else 100_000, None,
        preset_pfa=preset,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("predicted", "half", "code", "word"),
    [
        (0.62, 0.05, 1.0, "equivalent"),
        (0.66, 0.02, 1.0, "equivalent, though not the same"),
        (0.62, 0.2, 0.0, "undecided"),
        (0.9, 0.2, -1.0, "different"),
        (0.3, 0.2, -1.0, "different"),
    ],
)
def test_equivalent_different_or_undecided(predicted, half, code, word):
    rows = compare_roc(
        flat_curve(predicted), flat_curve(0.6, half, 80), subject="s", method="m", equivalence_margin=0.15
    )
    row = next(r for r in rows if r.metric == "pd_equivalence@1e-2")
    assert row.value == code
    assert row.reason == f"{word} by a margin 0.15"
    equal = next(r for r in rows if r.metric == "pd_equivalent@1e-2")
    assert equal.value == float(code == 1.0)


def presets(x: np.ndarray, classes: ClassScores) -> np.ndarray:
    return greatest_class_false_alarm(x, classes.rows(np.zeros(x.size, int)))


def test_both_readings_are_reported_where_they_differ():
    # Two classes; the rarer has the longer tail: its own P_FA is ten times that of the scene.
    classes = ClassScores(*np.array([[[0.9, 0.1]], [[0.0, 0.1]], [[0.1, 0.2]], [[np.inf, np.inf]]]))
    x = thresholds_at(PFA[None], classes)[0]
    pd = norm.sf((x - 0.6) / 0.15)
    swept = RocCurve(PFA, pd, pd, pd, x, "object", preset_pfa=presets(x, classes))
    measured = RocCurve(PFA, pd, pd - 0.05, pd + 0.05, x, "object", 300, 100_000)
    rows = {r.metric: r for r in compare_roc(swept, measured, subject="s", method="m")}
    # By hand: the longest tail is that of the second class, x = 0.1 + 0.2 Phi^-1(1 - P).
    by_hand = norm.sf((0.1 + 0.2 * norm.isf(1e-2) - 0.6) / 0.15)
    assert rows["pd_predicted_preset@1e-2"].value == pytest.approx(by_hand, abs=0.003)
    assert rows["pd_predicted@1e-2"].value > by_hand + 0.05
    assert rows["pd_inside_interval@1e-2"].value == 1.0
    assert rows["pd_inside_interval_preset@1e-2"].value == 0.0
    # With one class both are the same, and one row is enough.
    alone = ClassScores(*np.array([[[1.0]], [[0.0]], [[0.1]], [[np.inf]]]))
    x = thresholds_at(PFA[None], alone)[0]
    single = RocCurve(PFA, pd, pd, pd, x, "object", preset_pfa=presets(x, alone))
    rows = compare_roc(single, measured, subject="s", method="m")
    assert not [r for r in rows if "preset" in r.metric]


def test_a_preset_at_the_end_of_what_is_known_is_reported():
    measured = flat_curve(0.6, 0.05, 300)
    pd = np.linspace(0.2, 0.9, PFA.size)
    for end, there in ((1e-2, True), (0.99e-2, False)):
        known = np.append((PFA * end / PFA[-1])[:-1], end)  # the last preset is the one asked for, or lies below
        swept = RocCurve(PFA, pd, pd, pd, norm.isf(PFA), "object", preset_pfa=known)
        rows = compare_roc(swept, measured, subject="s", method="m")
        assert any(r.metric == "pd_predicted_preset@1e-2" for r in rows) == there


MAKE = RowMaker("product", "planks", "cem/object")


def test_errors_of_areas_by_hand():
    rows = compare_abundance(Abundance(5.0, 0.3), Abundance(4.0, 0.4, 9, 2.5), **NAMES)
    row = by_metric(rows)
    half = {metric: (r.upper - r.lower) / 2.0 / Z95 for metric, r in row.items() if np.isfinite(r.upper)}
    # d(o/p) = do/p - o dp/p^2; d(p/o - 1) = dp/o - p do/o^2.
    assert half["area_ratio"] == pytest.approx(np.hypot(0.4 / 5.0, 4.0 * 0.3 / 25.0))
    assert half["area_difference_ratio"] == pytest.approx(np.hypot(0.3 / 4.0, 5.0 * 0.4 / 16.0))
    for side, u in (("predicted", 0.3), ("observed", 0.4)):
        assert (half[f"area_{side}"], half[f"area_error_{side}"]) == pytest.approx((u, u))
    assert half["area_nominal_ratio"] == pytest.approx(0.4 / 2.5)
    assert (row["area_ratio"].value, row["area_difference_ratio"].value) == pytest.approx((4.0 / 5.0, 1.0 / 4.0))
    assert row["area_observed"].unit == "m2"
    none = by_metric(compare_abundance(Abundance(11.0, 0.0), Abundance(-1.0, 0.0), **NAMES))
    assert {none[m].outcome for m in ("area_difference_ratio", "area_inside_95")} == {Outcome.SKIPPED}
    assert row["area_z"].value == pytest.approx(1.0 / 0.5)
    assert row["area_inside_95"].value == 0.0  # 2.0 is beyond 1.96
    assert row["area_in_predicted_95"].value == 0.0  # 1.0 is beyond 1.96 of 0.3
    near = by_metric(compare_abundance(Abundance(4.9, 0.6), Abundance(4.0, 0.1, 9, 10.5), **NAMES))
    assert (near["area_inside_95"].value, near["area_in_predicted_95"].value) == (1.0, 1.0)
    (ratio,) = [
        r for r in compare_abundance(Abundance(0.0, 0.1), Abundance(3.0, 0.2, 9), **NAMES) if r.metric == "area_ratio"
    ]
    assert (ratio.outcome, ratio.cause) == (Outcome.SKIPPED, Cause.NOT_POSITIVE)


def test_intervals_of_the_errors_of_several_areas():
    error, spread = np.array([0.4, -0.1, 0.3]), np.array([0.2, 0.3, 0.6])
    observed = {(k, "fcls"): Abundance(2.0 + e, 0.1, 9, 2.0) for k, e in zip("abc", error, strict=True)}
    predicted = {(k, "fcls"): Abundance(2.05, s, 9, 2.0) for k, s in zip("abc", spread, strict=True)}
    observed["d", "fcls"] = predicted["d", "fcls"] = Abundance(9.0, 0.1, 9, 9.0)  # one of a size has no spread
    rows = by_metric(compare_area_errors(predicted, observed))
    assert rows["area_rmse_predicted"].value == pytest.approx(np.sqrt(0.05**2 + np.mean(spread**2)))
    assert {r.subject for r in rows.values()} == {"all targets of 2 m2"}
    low, high = stats.t.interval(0.95, 2, loc=error.mean(), scale=stats.sem(error))
    bias = rows["area_bias_observed"]
    assert (bias.lower, bias.value, bias.upper) == pytest.approx((low, error.mean(), high))
    model = rows["area_bias_predicted"]
    assert (model.upper - model.value, model.value - model.lower) == pytest.approx(
        [Z95 * np.sqrt(0.04 + 0.09 + 0.36) / 3] * 2
    )
    square = np.sum(error**2)  # over chi-square of three: the mean square of errors of mean 0
    rmse = rows["area_rmse_observed"]
    ends = np.sqrt(square / stats.chi2.ppf([0.975, 0.025], 3))
    assert (rmse.lower, rmse.value, rmse.upper) == pytest.approx((ends[0], np.sqrt(square / 3), ends[1]))


def curve(pd, half=0.0, **more):
    pfa = np.array([1e-4, 1e-3, 1e-2, 1e-1, 1.0])
    pd = np.asarray(pd, float)
    return RocCurve(pfa, pd, np.clip(pd - half, 0, 1), np.clip(pd + half, 0, 1), np.zeros(5), "object", **more)


def test_predicted_alarms_lie_where_the_band_reaches_the_stated_detection():
    # Straight in log P_FA, 0.2 a decade, a band of 0.1: half a decade on either side.
    measured = curve(
        [0.0, 0.2, 0.5, 0.8, 1.0], n_target=20, n_background=1000, background_area_km2=0.5,
        at_detection=(AlarmsAtDetection(0.5, 1.0, 10, 0.01, 0.004, 0.03, 0.005, 0.02),),
    )  # fmt: skip
    density = 2000.0
    predicted = curve([0.2, 0.4, 0.6, 0.8, 1.0], 0.1)
    rows = by_metric(far_at_detection_rows(MAKE, predicted, measured))
    row = rows["far_predicted@pd0.5"]
    assert np.array([row.lower, row.value, row.upper]) / density == pytest.approx([1e-3, 10**-2.5, 1e-2])
    assert rows["far_measured@pd0.5"].value == pytest.approx(20.0)
    assert rows["far_difference@pd0.5"].value == pytest.approx(density * 10**-2.5 - 20.0)
    # An upper limit that begins above that P_D bounds P_FA from below by nothing.
    wide = by_metric(far_at_detection_rows(MAKE, curve([0.2, 0.4, 0.6, 0.8, 1.0], 0.4), measured))
    row = wide["far_predicted@pd0.5"]
    assert (row.lower, row.upper / density) == pytest.approx((0.0, 10**-0.5))


def test_the_area_of_a_curve_without_a_band_is_a_point():
    pfa, lacking = np.array([1e-3, 1e-2, 0.1, 1.0]), np.full(4, np.nan)
    bare = RocCurve(pfa, np.sqrt(pfa), lacking, lacking, np.array([3.0, 2.0, 1.0, -9.0]))
    value, interval = predicted_area(bare, AREAS["partial_auc@0..1e-1"])
    assert interval == (value, value)
    assert 0.0 < value < 1.0


def test_a_comparison_shows_both_sides_and_what_names_them():
    shown = list(inspect.signature(compare_roc).parameters)
    assert shown == ["predicted", "observed", "subject", "method", "pfa", "equivalence_margin"]
