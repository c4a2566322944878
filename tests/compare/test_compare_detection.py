"""Scores, objects, ROC curves, false alarms and areas; gates; and the drive over all products."""

import math

import numpy as np
import pytest
from scipy import stats
from scipy.stats import norm

from hyperval import compare, model
from hyperval.errors import UsageError
from hyperval.pixels import AlarmBlocks, empirical_roc, exceedance_curve, rank_counts, roc_area, with_areas_and_alarms
from hyperval.products import (
    Abundance,
    AlarmsAtDetection,
    ExceedanceCurve,
    Influence,
    ObjectScores,
    ObservedProducts,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.results import Cause, Outcome, Result, Role
from hyperval.spectra import SpectralAxis

# Scores, objects, ROC curves, false alarms and target areas; and the drive over all products.


KM2 = 0.08
PFA = np.geomspace(1e-4, 0.999, 81)


def by_metric(rows):
    return {row.metric: row for row in rows}


def roc(predicted, observed, **more):
    return by_metric(compare.compare_roc(predicted, observed, **more))


def curve(pfa, pd, half=0.0, unit="object", **more):
    """A curve with a band of +-``half`` about P_D."""
    pfa, pd = np.asarray(pfa, float), np.broadcast_to(np.asarray(pd, float), np.shape(pfa))
    return RocCurve(pfa, pd, np.clip(pd - half, 0, 1), np.clip(pd + half, 0, 1), norm.isf(pfa), unit, **more)


def model_curve(separation, width=0.0, unit="object"):
    pfa = np.geomspace(1e-9, 1.0, 400)
    threshold = norm.isf(pfa)
    pd = [norm.sf(threshold - d) for d in (separation - width, separation, separation + width)]
    return RocCurve(pfa, pd[1], pd[0], pd[2], threshold, unit)


def measured_curve(separation, seed=1, targets=30, background=20_000, area=KM2):
    rng = np.random.default_rng(seed)
    t, b = rng.normal(separation, 1, targets), rng.normal(size=background)
    return with_areas_and_alarms(empirical_roc(t, b, unit="object", background_area_km2=area), t, b)


def test_overlapping_intervals_are_not_enough():
    observed = curve([0.01, 1.0], [0.62, 1.0], 0.1)
    overlaps, nearer = (roc(curve([0.01, 1.0], [pd, 1.0], 0.1), observed) for pd in (0.8, 0.74))
    assert overlaps["pd_inside_interval@1e-2"].value == 0.0
    assert nearer["pd_inside_interval@1e-2"].value == 1.0
    assert nearer["pd_inside_measured_interval@1e-2"].value == 0.0  # the width of the prediction was needed


def test_difference_interval_covers_and_takes_the_sides_that_stretch_it():
    # Two binomial proportions with Clopper-Pearson limits: conservative, 1000 draws, above 93 %.
    rng = np.random.default_rng(2)
    hits = 0
    for a, b in zip(rng.binomial(40, 0.8, 1000), rng.binomial(25, 0.6, 1000), strict=True):
        one, two = (tuple(map(float, model.clopper_pearson(k, n))) for k, n in ((a, 40), (b, 25)))
        low, high = compare.difference_interval(a / 40, one, b / 25, two)
        hits += low <= 0.2 <= high
    assert hits / 1000 > 0.93
    # The upper side of a and the lower side of b stretch the upper limit; the other two the lower limit.
    assert compare.difference_interval(0.8, (0.76, 0.92), 0.5, (0.45, 0.53)) == pytest.approx((0.3 - 0.05, 0.3 + 0.13))


def test_points_that_the_background_or_a_curve_does_not_reach():
    small = roc(model_curve(3.0), measured_curve(3.0, background=2000))
    assert small["pd_difference@1e-3"].outcome is Outcome.SKIPPED
    assert "2000 background samples expect 2 alarms" in small["pd_difference@1e-3"].reason
    large = roc(model_curve(3.0), measured_curve(3.0, background=200_000))
    assert large["pd_difference@1e-4"].outcome is Outcome.NONE
    assert not {"pd_difference@1e-4"} & set(small) | {"pd_difference@1e-5"} & set(large)
    short = roc(model_curve(2.0), curve([0.05, 1.0], [0.5, 1.0], 0.1))
    assert short["pd_measured@1e-2"].reason == "the measured curve has no point at P_FA 1e-2"
    bare = curve([1e-3, 1.0], [0.5, 1.0], np.nan)
    assert np.isnan(roc(model_curve(2.0), bare)["pd_inside_interval@1e-2"].value)  # neither in nor out


def test_one_object_gives_values_but_no_verdict():
    # Measured 1 of 1: the interval is 0.05 to 1, so that a prediction of 1e-18 would be "inside".
    background = np.random.default_rng(1).normal(size=20000)
    rows = roc(model_curve(-9.0), empirical_roc([5.0], background, unit="object"), equivalence_margin=0.1)
    assert (rows["pd_measured@1e-2"].value, rows["pd_predicted@1e-2"].value < 1e-9) == (1.0, True)
    for metric in ("pd_inside_interval", "pd_inside_measured_interval", "pd_equivalence"):
        row = rows[f"{metric}@1e-2"]
        assert row.outcome is Outcome.SKIPPED
        assert row.reason == "the measured interval 0.05 to 1 from 1 object accepts nearly any prediction"
    several = roc(model_curve(-9.0), empirical_roc(np.full(5, 5.0), background, unit="object"))
    assert several["pd_inside_interval@1e-2"].value == 0.0


def test_areas_with_and_without_estimates():
    rng = np.random.default_rng(3)
    t, b = rng.normal(2, 1, 200), rng.normal(0, 1, 50000)
    whole, truth = model_curve(2.0), norm.cdf(2 / np.sqrt(2))
    assert model.curve_area(whole, model.WHOLE) == pytest.approx(truth, abs=1e-5)
    # A curve that stops early is joined to (1, 1); one that begins above P_FA 0.01 has no area.
    for kept, value in ((whole.pfa <= 0.6, 0.0), (whole.pfa <= 0.3, 0.0), (whole.pfa >= 0.02, np.nan)):
        row = roc(curve(whole.pfa[kept], whole.pd[kept]), whole)["auc_difference"]
        assert row.value == pytest.approx(value, abs=5e-3, nan_ok=True)
    row = roc(whole, with_areas_and_alarms(empirical_roc(t, b, unit="object"), t, b))["auc_difference"]
    assert row.lower < row.value < row.upper
    assert row.value == pytest.approx(truth - roc_area(rank_counts(t, b)), abs=1e-5)


def test_score_moments():
    predicted = ScoreDistribution(0.5, 0.2)

    def scores(observed):
        return by_metric(compare.compare_scores(predicted, observed))

    rows, t = scores(ScoreDistribution(0.4, 0.1, 26)), stats.t.ppf(0.975, 25)
    difference, ratio = rows["score_mean_difference"], rows["score_sd_ratio"]
    assert (difference.value, difference.upper) == pytest.approx((0.1, 0.1 + t * 0.1 / np.sqrt(26)))
    # 0 by construction of the filter: no chance is in it.
    assert np.isnan(scores(ScoreDistribution(1e-16, 0.1, 26))["score_mean_difference"].upper)
    own = scores(ScoreDistribution(0.4, 0.1, 26, mean_error=0.004, mean_bias=-0.01))["score_mean_difference"]
    assert (own.value, own.upper) == pytest.approx((0.09, 0.09 + t * 0.004))  # of pixels that the filter is made of
    assert scores(ScoreDistribution(0.4, 0.0, 1))["score_sd_ratio"].outcome is Outcome.SKIPPED
    predicted = ScoreDistribution(0.5, 0.2, 26)  # of the same pixels, whose clusters both sides have
    same = scores(ScoreDistribution(0.4, 0.1, 26, mean_error=0.9, sd_error=0.9)).values()
    assert [row.upper for row in same] == pytest.approx([row.upper for row in rows.values()], nan_ok=True)
    predicted = ScoreDistribution(0.5, 0.2, mean_error=0.03, sd_error=0.3)  # by its inputs
    wide, wider = (scores(ScoreDistribution(0.4, 0.1, 26))[m] for m in ("score_mean_difference", "score_sd_ratio"))
    assert wide.upper == pytest.approx(0.1 + np.hypot(t * 0.1 / np.sqrt(26), model.Z95 * 0.03))
    assert np.log(wider.upper / 2.0) == pytest.approx(np.hypot(np.log(ratio.upper / 2.0), model.Z95 * 0.3))


def clustered(rng):
    common = np.kron(rng.normal(size=(9, 9)), np.ones((8, 8)))
    return AlarmBlocks.from_map(0.3 + np.sqrt(0.5) * (common + rng.normal(size=(72, 72))), np.ones((72, 72), bool))


def test_intervals_of_score_moments_cover():
    # 1000 samples of 15 and 300 of clusters, which count as independent pixels hold 0.3 and 0.4: sd 0.7 and 1.3 %.
    # Half of their pixels that a prediction is measured on left 0.3 and 0.4 while they counted as all of them.
    rng, truth = np.random.default_rng(4), {"score_mean_difference": 0.0, "score_sd_ratio": 1.0}
    few, many = (lambda: AlarmBlocks.from_scores(rng.normal(0.3, 1.0, 15))), (lambda: clustered(rng))
    for seen, count, m in ((few, 1000, 0), (many, 300, 0), (many, 300, 2592)):
        hits = np.zeros(2)
        for blocks in (seen() for _ in range(count)):
            x, (mean, sd) = blocks.scores, blocks.moment_errors
            observed = ScoreDistribution(x.mean(), x.std(ddof=1), x.size, mean_error=mean, sd_error=sd)
            law = ScoreDistribution(x[:m].mean(), x[:m].std(ddof=1), m, shared=m) if m else ScoreDistribution(0.3, 1.0)
            rows = compare.compare_scores(law, observed)
            hits += [row.lower <= truth[row.metric] <= row.upper for row in rows if row.metric in truth]
        assert np.all(np.abs(hits / count - 0.95) < 0.065), hits / count


def test_every_subject_of_either_side_has_rows():
    axis = SpectralAxis(np.arange(450.0, 900.0, 10.0), 10.0)
    one, expected, measured = SpectralEstimate(np.ones(45), 1e-4 * np.eye(45)), model_curve(3.0), measured_curve(3.0)
    left = {"radiance": {"grass": one, "only model": one}, "reflectance": {"grass": one}}
    left["roc"] = {("t", "cem", "object"): expected, ("u", "cem", "object"): expected}
    right = {"radiance": {"grass": one, "only data": one}, "snr": {"grass": one}}
    right["roc"] = {("t", "cem", "object"): measured, ("t", "ace", "object"): measured}
    predicted, observed = PredictedProducts(axis, **left), ObservedProducts(axis, **right)
    rows = compare.compare_products(predicted, observed)
    absent = {(r.product, r.subject, r.method): r.reason for r in rows if r.metric == "comparison"}
    assert set(absent) == {
        ("radiance", "only model", "model"), ("radiance", "only data", "model"), ("snr", "grass", "model"),
        ("reflectance", "grass", "model"), ("roc", "t", "ace/object"), ("roc", "u", "cem/object"),
    }  # fmt: skip
    assert absent["radiance", "only data", "model"] == "no radiance of only data in the prediction"
    assert absent["roc", "t", "ace/object"] == "no roc of t in the prediction, which has it by cem"
    assert absent["roc", "u", "cem/object"] == "no roc of u in the observation, which has 't'"
    assert {r.product for r in rows if r.outcome is Outcome.NONE} == {"radiance", "roc"}
    (nothing,) = [r for r in compare.compare_products(predicted, ObservedProducts(axis)) if r.subject == "u"]
    assert nothing.reason.endswith("in the observation, which has no roc at all")
    with pytest.raises(UsageError, match="not on the same spectral axis"):
        compare.compare_products(predicted, ObservedProducts(SpectralAxis(axis.centre_nm + 1.0, 10.0)))


def test_alarms_in_clusters_widen_the_density_and_the_joint_region_as_they_do_at_a_stated_detection():
    # Clusters of 49 equal pixels: the interval is some seven times as wide as that of as many single ones.
    scores = np.random.default_rng(8).standard_normal((30, 30)).repeat(7, 0).repeat(7, 1)
    blocks = AlarmBlocks.from_map(scores, np.ones(scores.shape, bool))
    rows = by_metric(compare.alarm_rows(None, empirical_roc([2.0], blocks, [1e-1], background_area_km2=1.0), 1e-1))
    for found, unit in ((rows["far_measured@1e-1"], 44_100.0), (rows["joint_pfa@1e-1"], 1.0)):
        assert found.upper - found.lower > 3.0 * unit * np.diff(model.clopper_pearson(4410, 44_100))


def test_every_row_of_a_true_prediction_and_of_a_wrong_one():
    rows = roc(model_curve(2.5, 0.1), measured_curve(2.5))
    for name in ("auc_{}", "partial_auc_{}@0..1e-1", "log_auc_{}@1e-3..1e-1", "far_{}@pd0.5", "far_{}@pd0.9"):
        p, o, d = (rows[name.format(side)] for side in ("predicted", "measured", "difference"))
        assert d.value == pytest.approx(p.value - o.value)
        assert all(row.lower <= row.value <= row.upper and row.outcome is Outcome.NONE for row in (p, o, d))
        assert d.lower <= 0 <= d.upper
    assert rows["far_measured@pd0.5"].unit == "km-2"
    assert rows["auc_measured"].reason == "DeLong"
    assert rows["far_predicted@pd0.5"].value == pytest.approx(norm.sf(2.5) * 20_000 / KM2, rel=0.01)
    for level in ("1e-1", "1e-2", "1e-3"):
        assert rows[f"pd_inside_joint_region@{level}"].value == 1.0
        assert rows[f"far_measured@{level}"].value == pytest.approx(float(level) * 20_000 / KM2)
    # 200 alarms of 20,000, each of both counts by the root of 95 %.
    alarms, joint, found = rows["far_measured@1e-2"], rows["joint_pfa@1e-2"], rows["joint_pd@1e-2"]
    assert (alarms.lower, alarms.upper) == pytest.approx(np.array(model.clopper_pearson(200, 20_000)) * 20_000 / KM2)
    assert alarms.reason == "200 alarms in 0.08 km2"
    assert (joint.lower, joint.upper) == pytest.approx(np.array(model.clopper_pearson(200, 20_000, np.sqrt(0.95))))
    assert f"{round(found.value * 30)} of 30 objects and 200 of 20000 background samples" in joint.reason
    wrong = roc(model_curve(4.5), measured_curve(2.5))
    assert wrong["pd_inside_joint_region@1e-2"].value == 0.0
    assert wrong["auc_difference"].lower > 0 > wrong["far_difference@pd0.5"].upper


def test_no_alarm_at_all_still_has_an_upper_limit():
    t, b = np.arange(20) + 100.0, np.random.default_rng(0).normal(size=12_203)
    measured = with_areas_and_alarms(empirical_roc(t, b, unit="object", background_area_km2=KM2), t, b)
    row = roc(model_curve(9.0), measured)["far_measured@pd0.5"]
    one_sided = model.clopper_pearson(0, 12_203, 0.9)[1] * 12_203 / KM2
    assert (row.value, row.lower, row.upper >= one_sided) == (0.0, 0.0, True)
    assert f"at most {one_sided:.4g}" in row.reason


def test_what_is_not_known_is_skipped_with_its_reason():
    no_area = roc(model_curve(2.5), measured_curve(2.5, area=None))
    assert no_area["far_measured@1e-2"].outcome is Outcome.SKIPPED
    assert "ground area" in no_area["far_measured@pd0.9"].reason
    small = roc(model_curve(2.5), measured_curve(2.5, background=900))
    assert small["log_auc_difference@1e-3..1e-1"].outcome is Outcome.SKIPPED
    assert "900 background samples expect 0.9 alarms" in small["log_auc_difference@1e-3..1e-1"].reason
    assert "joint_pd@1e-3" not in small
    one = roc(model_curve(2.5), measured_curve(2.5, targets=1))
    assert one["pd_inside_joint_region@1e-2"].outcome is Outcome.SKIPPED
    unreached = roc(curve([1e-3, 1.0], [0.95, 1.0], 0.02), measured_curve(2.5))["far_predicted@pd0.5"]
    assert "does not reach P_D 0.5" in unreached.reason


def test_the_joint_region_holds_the_truth_though_the_background_sets_the_threshold():
    # 400 collections: conservative; at a true 0.95 fewer than 0.92 come in 0.4 % of runs (seed fixed).
    rng, truth, hits = np.random.default_rng(8), model_curve(2.0), 0
    for _ in range(400):
        measured = empirical_roc(rng.normal(2, 1, 25), rng.normal(size=1500), [0.02], unit="object")
        rows = by_metric(compare.alarm_rows(truth, measured, 0.02))
        x, pfa, pd = measured.threshold[0], rows["joint_pfa@2e-2"], rows["joint_pd@2e-2"]
        if pfa.lower <= norm.sf(x) <= pfa.upper and pd.lower <= norm.sf(x - 2.0) <= pd.upper:
            hits += 1  # the true curve passes through every region that holds the true point
            assert rows["pd_inside_joint_region@2e-2"].value == 1.0
    assert hits / 400 > 0.92


def test_one_side_alone_has_its_rows_too():
    axis, key = SpectralAxis(np.array([500.0, 600.0]), 5.0), ("planks", "cem", "object")
    bare, seen = (
        by_metric(compare.product_rows(ObservedProducts(axis, roc={key: measured_curve(2.5, area=area)}), "observed"))
        for area in (None, KM2)
    )
    assert {"auc_measured", "far_measured@1e-3", "far_measured@pd0.9", "joint_pd@1e-2"} <= set(seen)
    assert not any("predicted" in name or "difference" in name for name in seen)
    assert not any(r.outcome is Outcome.SKIPPED for r in bare.values())
    told = by_metric(compare.product_rows(PredictedProducts(axis, roc={key: model_curve(2.5, 0.2)}), "predicted"))
    assert told["auc_predicted"].lower < told["auc_predicted"].value < told["auc_predicted"].upper
    assert not any(name.startswith(("far", "joint")) for name in told)


def test_a_predicted_curve_that_ends_inside_the_rectangle_goes_on_to_nothing():
    # The rectangle of 0 of 200 targets at 100 of 10,000 alarms: P_FA 0.0077 to 0.0127, P_D 0 to 0.022.
    counts = {"n_target": 200, "n_background": 10_000, "alarms": np.array([10, 100, 1000])}
    measured = curve([1e-3, 1e-2, 1e-1], 0.0, np.nan, "pixel", **counts)
    # The first begins inside: below its first point nothing is detected.
    for start, pd, inside in ((9e-3, 0.5, 1.0), (1e-4, 0.5, 0.0), (1e-4, 0.01, 1.0)):
        for half, passes in ((np.nan, inside), (0.5, 1.0)):  # a band of its own reaches as far as it is wide
            rows = by_metric(compare.alarm_rows(curve([start, 1e-1], pd, half, "pixel"), measured, 1e-2))
            assert rows["pd_inside_joint_region@1e-2"].value == passes
        assert rows["joint_pd@1e-2"].upper < 0.03


def test_equivalent_different_or_undecided():
    for predicted, half, code, word in (
        (0.62, 0.05, 1.0, "equivalent"),
        (0.66, 0.02, 1.0, "equivalent, though significantly different"),
        (0.62, 0.2, 0.0, "undecided"),
        (0.9, 0.2, -1.0, "different"),
        (0.3, 0.2, -1.0, "different"),
    ):
        observed = curve(PFA, 0.6, half, n_target=80, n_background=100_000)
        told = roc(curve(PFA, predicted), observed, equivalence_margin=0.15)["pd_equivalence@1e-2"]
        assert (told.value, told.reason) == (code, f"{word} by a margin 0.15")


def test_both_readings_are_reported_where_they_differ():
    # Two classes; the rarer has the longer tail: its own P_FA is ten times that of the scene.
    for numbers, told in (([[0.9, 0.1]], [[0.0, 0.1]], [[0.1, 0.2]]), True), (([[1.0]], [[0.0]], [[0.1]]), False):
        share, mean, sd = map(np.array, numbers)
        classes = model.ClassScores(share, mean, sd, np.full(mean.shape, np.inf))
        x = model.thresholds_at(PFA[None], classes)[0]
        preset = model.greatest_class_false_alarm(x, classes.rows(np.zeros(x.size, int)))
        pd = norm.sf((x - 0.6) / 0.15)
        rows = roc(curve(PFA, pd, preset_pfa=preset), curve(PFA, pd, 0.05, n_target=300, n_background=100_000))
        assert any("preset" in metric for metric in rows) == told  # with one class both are the same
        if told:  # by hand: the longest tail is that of the second class, x = 0.1 + 0.2 Phi^-1(1 - P)
            by_hand = norm.sf((0.1 + 0.2 * norm.isf(1e-2) - 0.6) / 0.15)
            assert rows["pd_predicted_preset@1e-2"].value == pytest.approx(by_hand, abs=0.003)
            assert rows["pd_predicted@1e-2"].value > by_hand + 0.05
            assert rows["pd_inside_interval@1e-2"].value == 1.0
            assert rows["pd_inside_interval_preset@1e-2"].value == 0.0


def areas(predicted, observed):
    return by_metric(compare.compare_abundance(predicted, observed))


def test_errors_of_areas_by_hand():
    row = areas(Abundance(5.0, 0.3), Abundance(4.0, 0.4, 9, 2.5))
    half = {metric: (r.upper - r.lower) / 2.0 / model.Z95 for metric, r in row.items() if np.isfinite(r.upper)}
    # Of ratios half the distance of the roots r of (a - r b)^2 = 1.96^2 (ua^2 + r^2 ub^2), by numpy.roots.
    assert half == pytest.approx({
        "area_ratio": 0.0941213061, "area_nominal_ratio": 0.4 / 2.5,
        "area_difference_ratio": 0.1508246137,
        "area_predicted": 0.3, "area_error_predicted": 0.3, "area_observed": 0.4, "area_error_observed": 0.4,
    })  # fmt: skip
    assert (row["area_ratio"].value, row["area_difference_ratio"].value) == pytest.approx((4.0 / 5.0, 1.0 / 4.0))
    assert (row["area_observed"].unit, row["area_z"].value) == ("m2", pytest.approx(1.0 / 0.5))
    # 2.0 is beyond 1.96, and so is 1.0 of 0.3.
    assert (row["area_inside_95"].value, row["area_in_predicted_95"].value) == (0.0, 0.0)
    near = areas(Abundance(4.9, 0.6), Abundance(4.0, 0.1, 9, 10.5))
    assert (near["area_inside_95"].value, near["area_in_predicted_95"].value) == (1.0, 1.0)
    none = areas(Abundance(0.0, 0.0), Abundance(-1.0, 0.0, 9, 0.0))
    assert {none[f"area_{m}"].cause for m in ("ratio", "difference_ratio", "nominal_ratio")} == {Cause.NOT_POSITIVE}
    assert none["area_inside_95"].outcome is Outcome.SKIPPED


def test_intervals_of_the_errors_of_several_areas():
    error, spread = np.array([0.4, -0.1, 0.3]), np.array([0.2, 0.3, 0.6])
    observed = {(k, "fcls"): Abundance(2.0 + e, 0.1, 9, 2.0) for k, e in zip("abc", error, strict=True)}
    predicted = {(k, "fcls"): Abundance(2.05, s, 9, 2.0) for k, s in zip("abc", spread, strict=True)}
    observed["d", "fcls"] = predicted["d", "fcls"] = Abundance(9.0, 0.1, 9, 9.0)  # one of a size has no spread
    rows = by_metric(compare.compare_area_errors(predicted, observed))
    assert {r.subject for r in rows.values()} == {"all targets of 2 m2"}
    assert rows["area_rmse_predicted"].value == pytest.approx(np.sqrt(0.05**2 + np.mean(spread**2)))
    low, high = stats.t.interval(0.95, 2, loc=error.mean(), scale=stats.sem(error))
    bias, expected = (rows[f"area_{name}"] for name in ("bias_observed", "bias_predicted"))
    assert (bias.lower, bias.value, bias.upper) == pytest.approx((low, error.mean(), high))
    half = model.Z95 * np.sqrt(0.04 + 0.09 + 0.36) / 3
    assert (expected.upper - expected.value, expected.value - expected.lower) == pytest.approx((half, half))
    # Of 400 sets of five errors 365 to 395 are held, with a bias too (3.5 standard deviations); then it was all.
    rng = np.random.default_rng(6)
    for shift in (0.0, 3.0):
        held = 0
        for errors in rng.normal(shift, 1.0, (400, 5)):
            sides = ({(str(k), "fcls"): Abundance(9.0 + e, 1.0, 9, 9.0) for k, e in enumerate(x)} for x in 2 * [errors])
            row = by_metric(compare.compare_area_errors(*sides))["area_rmse_observed"]
            held += row.lower <= np.hypot(1.0, shift) <= row.upper
        assert 365 <= held <= 395


def test_predicted_alarms_lie_where_the_band_reaches_the_stated_detection():
    pfa, pd, density = [1e-4, 1e-3, 1e-2, 1e-1, 1.0], [0.2, 0.4, 0.6, 0.8, 1.0], 2000.0
    alarms = AlarmsAtDetection(0.5, 1.0, 10, 0.01, 0.004, 0.03, 0.005, 0.02)
    counts = {"n_target": 20, "n_background": 1000, "background_area_km2": 0.5, "at_detection": (alarms,)}
    measured = curve(pfa, [0.0, 0.2, 0.5, 0.8, 1.0], **counts)
    rows = by_metric(compare.far_at_detection_rows(curve(pfa, pd, 0.1), measured))
    row = rows["far_predicted@pd0.5"]
    assert (row.lower / density, row.upper / density) == pytest.approx((1e-3, 1e-2))
    assert model.detection_at(curve(pfa, pd), row.value / density) == pytest.approx(0.5)
    assert rows["far_measured@pd0.5"].value == pytest.approx(20.0)
    assert rows["far_difference@pd0.5"].value == pytest.approx(row.value - 20.0)
    # An upper limit that begins above that P_D bounds P_FA from below by nothing.
    wide = curve(pfa[:4], [0.2, 0.6, 0.9, 1.0], 0.4)
    row = by_metric(compare.far_at_detection_rows(wide, measured))["far_predicted@pd0.5"]
    assert (row.lower, row.upper / density) == pytest.approx((0.0, 1e-2))


def test_ratio_of_false_alarms():
    x = np.linspace(0.0, 5.0, 200)
    expected, true = norm.sf(x), 2.0 * norm.sf(x).clip(0, 0.5)

    def ratios(n, low=true, high=true):
        law, measured = ExceedanceCurve(x, expected, expected, expected), ExceedanceCurve(x, true, low, high, n)
        return by_metric(compare.compare_exceedance(law, measured))

    rows = ratios(20_000, true / 1.5, true * 1.5)
    assert set(rows) == {"pfa_ratio@1e-1", "pfa_ratio@1e-2", "pfa_ratio@1e-3"}
    for row in rows.values():
        assert (row.value, row.lower, row.upper) == pytest.approx((0.5, 0.5 / 1.5, 0.75))
    assert [r.outcome for r in ratios(500).values()] == [Outcome.NONE, Outcome.SKIPPED, Outcome.SKIPPED]
    # Scores that are all equal, and those of which many are: no threshold passes about as many as asked for.
    for values, share in ((np.ones((50, 50)), "0"), (np.arange(2500).reshape(50, 50) // 800, "0.04")):
        counted = exceedance_curve(AlarmBlocks.from_map(values.astype(float), np.ones((50, 50), bool)))
        found = by_metric(compare.compare_exceedance(ExceedanceCurve(x, *[expected] * 3), counted))
        assert found["pfa_ratio@1e-2"].cause is Cause.BEYOND_CURVE
        assert f"passes {share} of 2500" in found["pfa_ratio@1e-2"].reason
    # Without the second of two parts the ratio is nearer to 1.
    number, ratio = np.repeat([[0, 1]], [40, 60], axis=1), np.repeat([[0.5], [0.9]], 200, axis=1)
    parts = Influence(number, np.ones((2, 200)), x, ratio)
    law, measured = ExceedanceCurve(x, *[expected] * 3, influence=parts), ExceedanceCurve(x, *[true] * 3, 500)
    row = by_metric(compare.compare_exceedance(law, measured))["pfa_ratio_without@1e-1"]
    assert "without 60 of 100 pixels (lines 0 to 0, samples 40 to 99), which hold 50 % of the alarms" in row.reason
    assert (row.value, row.n) == (pytest.approx(0.9), 60)


# Objects of many kinds judged together.
UNIFORM, JOINT = "pit_uniformity", "joint_distance"
ROWS, COLUMNS = 200, 40


def drawn(common, own, rng, subjects=25):
    """Predictions of normal scores with an error that all subjects share, and one set of true scores."""
    shared = rng.standard_normal(ROWS // 2)
    shared = np.concatenate([shared, -shared])[:, None]
    means = np.linspace(0.1, 1.0, subjects)
    predicted = {
        f"t{i:02d}": ObjectScores(m + common * shared + own * rng.standard_normal((ROWS, COLUMNS)))
        for i, m in enumerate(means)
    }
    error = common * rng.standard_normal()
    truth = {name: m + error + own * rng.standard_normal(1) for name, m in zip(predicted, means, strict=True)}
    return predicted, truth


def test_transform_is_the_predicted_distribution_function():
    # 40,000 draws: the sd of a share is at most 0.0025, four of them 0.01.
    draws = np.random.default_rng(1).normal(0.3, 0.1, (400, 100))
    at = np.array([0.1, 0.25, 0.3, 0.45])
    assert compare.probability_integral_transform(at, draws) == pytest.approx(norm.cdf(at, 0.3, 0.1), abs=0.01)
    assert compare.probability_integral_transform([1.0, 2.0], [1.0, 1.0, 3.0, 3.0]).tolist() == [0.3, 0.5]


def test_distance_is_that_of_another_package():
    u = np.random.default_rng(2).uniform(size=(3, 30))
    assert compare.distance_from_uniform(u) == pytest.approx([stats.kstest(x, "uniform").statistic for x in u])


@pytest.mark.slow
def test_right_predictions_with_common_errors_are_rejected_at_the_stated_rate(monkeypatch):
    # 100 worlds whose common error is as large as the rest: a 5 % test rejects 5 of them (sd 2.2); limit at 4 sd.
    # The customary test, which takes objects for independent, rejects most.  1,000 sets of the model place a
    # p-value of 5 % to 0.7 %, which leaves the rate of rejection; how wide a departure is detectable is not asked.
    monkeypatch.setattr("hyperval.compare.detection.REPLICATES", 1000)
    monkeypatch.setattr("hyperval.compare.detection.POWER_DRAWS", 20)
    rng = np.random.default_rng(4)
    ours, customary, joint, drift = 0, 0, 0, 0
    for _ in range(100):
        shift = rng.uniform(0.2, 1.0, 25)
        base, truth = drawn(0.1, 0.1, rng)
        predicted = {k: ObjectScores(p.values + s) for (k, p), s in zip(base.items(), shift, strict=True)}
        moved = {k: v + s for (k, v), s in zip(truth.items(), shift, strict=True)}
        found = by_metric(compare.judged_together(predicted, moved))
        uniform, distance, trend = (found[f"{test}_p_value"].value for test in (UNIFORM, JOINT, "pit_trend"))
        u = [float(compare.probability_integral_transform(moved[k], predicted[k].values)[0]) for k in predicted]
        ours += uniform < 0.05
        customary += stats.kstest(u, "uniform").pvalue < 0.05
        joint += 2.0 * min(distance, 1.0 - distance) < 0.05
        drift += trend < 0.05
    assert customary > 30
    assert max(ours, joint, drift) <= 14


def test_falsified_scores_turn_the_verdict():
    predicted, truth = drawn(0.02, 0.1, np.random.default_rng(6))
    tests = [f"{test}_p_value" for test in ("objects_inside_95", UNIFORM, JOINT)]
    plan = {"product": "scores", "subjects": ("all objects",), "at_least": 0.01, "reason": "r"}

    def verdicts(change, predicted=predicted):
        measured = {name: ObjectScores(change(values), (name,)) for name, values in truth.items()}
        rows = compare.compare_object_scores(predicted, measured, method="cem")
        judgements = by_metric(
            r for r in compare.judge_rows(rows, [compare.Gate(metric=metric, **plan) for metric in tests]) if r.gates
        )
        return [judgements[metric].outcome for metric in tests]

    # 25 objects tell little of a width.
    assert set(verdicts(lambda x: x)) <= {Outcome.AGREES, Outcome.UNDECIDED}
    for falsify in (lambda x: x + 0.3, lambda x: 0.5 * x, lambda x: x + 0.4 * np.sign(x - 0.5)):
        assert verdicts(falsify)[:2] == [Outcome.DISAGREES] * 2
    # A prediction that is much too unsure holds every object and is found out by the transform values.
    unsure = {k: ObjectScores(p.values.mean() + 10.0 * (p.values - p.values.mean())) for k, p in predicted.items()}
    timid = verdicts(lambda x: x, unsure)
    assert timid[0] is not Outcome.DISAGREES
    assert timid[1:] == [Outcome.DISAGREES] * 2  # two-sided: too wide fails too


def test_rows_of_single_objects_and_of_groups():
    rng = np.random.default_rng(7)
    draws = rng.normal(0.5, 0.1, (1, 8000))
    predicted = {name: ObjectScores(draws) for name in ("one", "many", "lost")}
    measured = {
        "one": ObjectScores(np.array([0.9]), ("o",)),
        "many": ObjectScores(rng.normal(0.5, 0.1, 60), tuple(map(str, range(60)))),
        "lost": ObjectScores(np.array([np.nan]), ("x",)),
        "not predicted": ObjectScores(np.array([1.0]), ("y",)),
    }
    of = {(r.subject, r.metric): r for r in compare.compare_object_scores(predicted, measured, method="cem")}
    assert of["one", "object_score_inside_95"].value == 0.0
    assert of["one", "object_score_measured"].value == 0.9
    interval = of["one", "object_score_predicted"]
    # Of 8,000 draws the ends have a standard error of 0.003.
    assert (interval.lower, interval.upper) == pytest.approx((0.304, 0.696), abs=0.012)
    assert of["lost", "object_score_pit"].outcome is Outcome.SKIPPED
    together = of["all objects", "objects_inside_95"]
    assert (of["many", "objects_inside_95"].n, together.n) == (60, 61)
    assert "without lost" in together.reason
    assert "not predicted" not in {subject for subject, _ in of}
    none = compare.compare_object_scores(predicted, {}, method="cem")
    assert {r.outcome for r in none} == {Outcome.SKIPPED}


# Objects that are independent and predicted by a normal law have normal scores that are independent standard normal
# numbers, so that every null distribution drawn from the prediction is one of the textbook.  4,000 sets (2,000 for the
# joint test) are drawn with a fixed seed: a p-value is off by 0.008 at most, and a limit at 2.5 % of a normal law by
# 0.042 of its standard deviation.  Tolerances are four of these: were the seed another, 1 in 10,000 would fail.
OBJECTS = 9
LAW = norm.ppf((np.arange(4000) + 0.5) / 4000)[None, :]
MEANS = np.linspace(0.0, 4.0, OBJECTS)
PREDICTED = {f"t{i}": ObjectScores(m + LAW) for i, m in enumerate(MEANS)}
# Places of the expected scores, from weakest to strongest 1 apart.
PLACE = (np.arange(OBJECTS) - (OBJECTS - 1) / 2) / (OBJECTS - 1)
SD = 1.0 / np.sqrt(PLACE @ PLACE)  # of the least-squares slope of independent standard normal numbers


def together(z, predicted=PREDICTED):
    measured = {k: np.array([m + x]) for k, m, x in zip(PREDICTED, MEANS, z, strict=True)}
    return by_metric(compare.judged_together(predicted, measured))


@pytest.mark.parametrize("slope", [0.8, -1.2, 2.0])
def test_a_drift_is_that_of_a_least_squares_slope(slope):
    found = together(0.3 + slope * PLACE)
    trend, test = found["pit_trend"], found["pit_trend_p_value"]
    assert trend.value == pytest.approx(slope, rel=0.01)
    assert test.value == pytest.approx(2.0 * norm.sf(abs(slope) / SD), abs=0.032)
    ends = (slope - 1.959964 * SD, slope + 1.959964 * SD)
    assert (trend.lower, trend.upper) == pytest.approx(ends, abs=4.0 * 0.042 * SD)
    # Rejected at 1 % in both tails together, in four cases of five: the quantiles at 0.995 and at 0.8.
    assert test.detectable == pytest.approx((norm.isf(0.005) + norm.isf(0.2)) * SD, rel=0.06)


def test_a_joint_distance_is_chi_square_of_as_many_objects():
    for scale in (0.8, 1.0, 1.3):
        z = scale * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
        found = together(z)[f"{JOINT}_p_value"]
        # 2,000 sets make a p-value to 0.011, and the covariance of 2,000 others is itself off by a few per cent.
        assert found.value == pytest.approx(stats.chi2.sf(z @ z, OBJECTS), abs=0.06)
        # The limit at 0.005 of chi-square, over the squared width, is passed by 0.75 at twice and 0.98 at three times.
        assert found.detectable == 3.0


@pytest.mark.parametrize("common", [0.0, 3.0])
def test_a_spread_is_that_of_as_many_normal_numbers(common):
    # What all share moves their mean alone, and makes each of them vary more than about that mean.
    rows, own = (norm.ppf((np.arange(n) + 0.5) / n) for n in (200, 400))
    predicted = {k: ObjectScores(m + common * rows[:, None] + own) for k, m in zip(PREDICTED, MEANS, strict=True)}
    each = np.hypot(1.0, common)
    found, measured = together(each * (1.0 + 2.0 * PLACE), predicted), each * np.std(2.0 * PLACE, ddof=1)
    low, middle, high = np.sqrt(stats.chi2.ppf([0.025, 0.5, 0.975], OBJECTS - 1) / (OBJECTS - 1)) / measured
    spread = found["pit_spread_ratio"]
    assert (spread.lower, spread.value, spread.upper) == pytest.approx((low, middle, high), rel=0.06)


def test_the_number_inside_is_binomial():
    found = together(np.array([3.0, -3.0, *(OBJECTS - 2) * [0.5]]))
    share, test = found["objects_inside_95"], found["objects_inside_95_p_value"]
    assert share.value == pytest.approx((OBJECTS - 2) / OBJECTS)
    assert test.value == pytest.approx(stats.binom.cdf(OBJECTS - 2, OBJECTS, 0.95), abs=0.014)
    # At most 1 in 40 sets has fewer inside, and none more than all.
    assert f"expects {stats.binom.ppf(0.025, OBJECTS, 0.95) / OBJECTS:.3g} to 1;" in share.reason


# What a planned comparison may say, and what each kind of row concludes about a range.


RADIANCE = {"product": "radiance", "metric": "median_difference_ratio_windows", "reason": "r"}


def row(metric="median_difference_ratio_windows", value=0.0, lower=math.nan, upper=math.nan, **more):
    product = more.pop("product", "radiance")
    return Result("c", product, "field", "radiance", metric, value=value, lower=lower, upper=upper, **more)


def test_limits_and_their_words():
    limits = ({"at_most": 0.1}, {"at_least": -0.1}, {"within": [-0.1, 0.2]})
    told = [compare.Gate(**RADIANCE, **limit).limit_text for limit in limits]
    assert told == ["at most 0.1", "at least -0.1", "within -0.1 to 0.2"]


def test_the_rows_that_a_gate_is_about():
    gate = compare.Gate(**{**RADIANCE, "metric": "difference_ratio", "within": [-0.1, 0.1], "bands_nm": [500, 600]})
    bands = (499.9, 500.0, 600.0, 600.1)
    assert [gate.matches(row("difference_ratio", band_nm=band)) for band in bands] == [False, True, True, False]
    assert not gate.matches(row("difference_ratio", product="reflectance", band_nm=550.0))
    assert gate.matches(row(compare.COMPARISON))  # a skipped comparison has no band
    only = compare.Gate(**{**RADIANCE, "at_most": 0.1, "subjects": ["court*"], "method": "rad*"})
    assert not only.matches(row())
    at = compare.Gate(product="roc", metric="pd_difference", within=(-0.1, 0.1), reason="r")
    assert at.matches(row("pd_difference@1e-2", product="roc"))


def test_intervals_of_all_criteria_share_their_level():
    # On either side twenty intervals lie off equality by 2.5 standard errors, and one by 4: of 42 the worst has
    # 0.05/42 of the level (3.2 standard errors), so that one right campaign in twenty is called wrong.
    gate = compare.Gate(**RADIANCE, within=[-0.1, 0.1])
    beside = [row(value=k, lower=k - 1.96, upper=k + 1.96) for k in (*[2.5] * 20, 4.0)]
    beside += [row(value=-x.value, lower=-x.upper, upper=-x.lower) for x in beside]
    out = compare.judge_rows(beside, [gate])
    assert [r.outcome for r in out] == ([Outcome.UNDECIDED] * 20 + [Outcome.DISAGREES]) * 2
    assert {r.cause for r in out if r.outcome is Outcome.UNDECIDED} == {Cause.MULTIPLICITY}
    assert compare.judge_rows(beside[:1], [gate])[0].outcome is Outcome.DISAGREES  # alone it has the whole level
    assert compare.judge_rows(beside[:20], [gate.model_copy(update={"gate": False})])[0].outcome is Outcome.DISAGREES


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
    assert compare.tail_probability(row(metric, value, lower, upper, product="roc")) == pytest.approx(p, rel=0.1)


def test_departures_that_a_range_would_see():
    reach = 1.0 + 0.8416212335729143 / 1.959963984540054
    both = row(value=0.01, lower=-0.01, upper=0.02)  # 0.02 below, 0.01 above
    assert np.fmin(*compare.detectable_departures(both, -0.1, math.inf)) == pytest.approx(0.1 + 0.01 * reach)
    assert np.fmin(*compare.detectable_departures(both, -math.inf, 0.1)) == pytest.approx(0.1 + 0.02 * reach)
    assert np.fmin(*compare.detectable_departures(both, -0.1, 0.05)) == pytest.approx(0.05 + 0.02 * reach)
    assert math.isnan(np.fmin(*compare.detectable_departures(row(value=0.0), -0.1, 0.1)))
    # A size cut at 0 says nothing of its width: the upper half stands for it.
    size = row("median_abs_difference_ratio_windows", 0.01, 0.0, 0.05)
    assert np.fmin(*compare.detectable_departures(size, -math.inf, 0.1)) == pytest.approx(0.1 + 0.04 * reach)
    assert compare.judge_rows([row("p_value_full", 0.5, detectable=0.3)], [])[0].detectable == 0.3
    assert math.isnan(compare.detectable_share(5, 0.1))  # even none of five leaves the share of 0.1 possible


def test_a_pooled_gate_counts_what_cannot_tell_against_it_below_and_for_it_above():
    def pool(good, bad, unsure, least, **more):
        limits = {"metric": "difference_ratio", "within": (-0.1, 0.1), "fraction_at_least": least}
        ends = [(0.0, -0.01, 0.01)] * good + [(0.3, 0.29, 0.31)] * bad + [(0.0, -0.5, 0.5)] * unsure
        rows = [row("difference_ratio", *numbers, band_nm=500.0 + i) for i, numbers in enumerate(ends)]
        *rows, share = compare.judge_rows(rows, [compare.Gate(**RADIANCE | limits | more)])
        assert all(r.role is not Role.GATE for r in rows)
        return share

    share = pool(80, 6, 14, 0.5)
    assert (share.metric, share.value, share.n) == ("difference_ratio_fraction", 0.8, 100)
    # Clopper-Pearson: 80 of 100 has 0.7082 below, 94 of 100 has 0.9777 above.
    assert (share.lower, share.upper) == pytest.approx((0.7082, 0.9777), abs=1e-4)
    assert share.outcome is Outcome.AGREES
    assert "80 of 100 rows within -0.1 to 0.1, 14 without an outcome of their own; outside: field" in share.reason
    assert "580 nm" in share.reason
    assert "and 1 more" in share.reason
    assert (pool(20, 80, 0, 0.5).outcome, pool(50, 0, 50, 0.8).outcome) == (Outcome.DISAGREES, Outcome.UNDECIDED)
    assert pool(50, 5, 0, 0.8, gate=False).role is Role.INFORM
    assert pool(0, 0, 1, 0.5).cause is Cause.NEVER, "one row cannot put the share above a half"


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
    (row,) = [r for r in compare.judge_rows(rows, [compare.Gate(**given)]) if r.outcome is Outcome.ERROR]
    assert row.reason.startswith("planned but absent: no roc row")
    assert told is None or told in row.reason
    assert told is not None or "; " not in row.reason
