"""Rows of areas, false alarms per km2 and joint regions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import Gate, RowMaker, compare_roc, joint_rows, judged, product_rows
from hyperval.model import RocArea, clopper_pearson, curve_area, zero_count_upper_limit
from hyperval.pixels import empirical_roc, with_summary
from hyperval.products import ObservedProducts, PredictedProducts, RocCurve
from hyperval.results import Outcome
from hyperval.spectra import SpectralAxis

NAMES = {"subject": "planks", "method": "cem/object"}
KM2 = 0.08


def model_curve(separation, width=0.0):
    pfa = np.geomspace(1e-9, 0.999, 181)
    x = stats.norm.isf(pfa)
    pd = [stats.norm.sf(x - d) for d in (separation - width, separation, separation + width)]
    return RocCurve(pfa, pd[1], pd[0], pd[2], x, "object")


def measured_curve(separation, seed=1, targets=30, background=20_000, area=KM2):
    rng = np.random.default_rng(seed)
    t, b = rng.normal(separation, 1, targets), rng.normal(size=background)
    return with_summary(empirical_roc(t, b, unit="object", background_area_km2=area), t, b)


def by_metric(rows):
    return {r.metric: r for r in rows}


def test_areas_of_a_predicted_curve_are_those_of_the_formula():
    curve = model_curve(2.0)
    assert curve_area(curve, RocArea()) == pytest.approx(stats.norm.cdf(2 / np.sqrt(2)), abs=1e-5)
    u = np.linspace(np.log(1e-3), np.log(1e-1), 20_001)
    pd = stats.norm.sf(stats.norm.isf(np.exp(u)) - 2.0)
    log = np.trapezoid(pd, u) / np.log(100)
    assert curve_area(curve, RocArea(1e-3, 1e-1, logarithmic=True)) == pytest.approx(log, abs=1e-6)
    x = np.linspace(0, 0.1, 200_001)
    even = np.trapezoid(stats.norm.sf(stats.norm.isf(x) - 2.0), x) / 0.1
    assert curve_area(curve, RocArea(0, 0.1)) == pytest.approx(even, abs=1e-5)
    late = RocCurve(*(v[curve.pfa > 0.01] for v in (curve.pfa, curve.pd, curve.pd, curve.pd, curve.threshold)))
    assert np.isnan(curve_area(late, RocArea(0, 0.1)))


def test_every_row_of_a_true_prediction():
    rows = by_metric(compare_roc(model_curve(2.5, 0.1), measured_curve(2.5), **NAMES))
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
    wrong = by_metric(compare_roc(model_curve(4.5), measured_curve(2.5), **NAMES))
    assert wrong["pd_inside_joint_region@1e-2"].value == 0.0
    assert wrong["auc_difference"].lower > 0
    assert wrong["far_difference@pd0.5"].upper < 0


def test_alarms_and_joint_region_by_hand():
    curve = measured_curve(2.5)
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
    rows = by_metric(compare_roc(model_curve(2.5), measured_curve(2.5, area=None), **NAMES))
    assert rows["far_measured@1e-2"].outcome is Outcome.SKIPPED
    assert "ground area" in rows["far_measured@pd0.9"].reason
    small = by_metric(compare_roc(model_curve(2.5), measured_curve(2.5, background=900), **NAMES))
    row = small["log_auc_difference@1e-3..1e-1"]
    assert row.outcome is Outcome.SKIPPED
    assert "900 background samples expect 0.9 alarms" in row.reason
    assert "joint_pd@1e-3" not in small
    one = by_metric(compare_roc(model_curve(2.5), measured_curve(2.5, targets=1), **NAMES))
    assert one["pd_inside_joint_region@1e-2"].outcome is Outcome.SKIPPED
    flat = RocCurve(*(np.array(x) for x in ([1e-3, 1.0], [0.95, 1], [0.9, 1], [0.97, 1], [1, 0])), "object")
    unreached = by_metric(compare_roc(flat, measured_curve(2.5), **NAMES))["far_predicted@pd0.5"]
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
    seen = by_metric(product_rows(ObservedProducts(axis, roc={key: measured_curve(2.5)}), "observed"))
    assert {"auc_measured", "far_measured@1e-3", "far_measured@pd0.9", "joint_pd@1e-2"} <= set(seen)
    assert not any("predicted" in name or "difference" in name for name in seen)
    told = by_metric(product_rows(PredictedProducts(axis, roc={key: model_curve(2.5, 0.2)}), "predicted"))
    assert told["auc_predicted"].lower < told["auc_predicted"].value < told["auc_predicted"].upper
    assert not any(name.startswith(("far", "joint")) for name in told)
    bare = by_metric(product_rows(ObservedProducts(axis, roc={key: measured_curve(2.5, area=None)}), "observed"))
    assert not any(r.outcome is Outcome.SKIPPED for r in bare.values())


def test_a_limit_that_no_area_can_break_is_refused():
    for metric, limit in (("auc_measured", 1.0), ("joint_pd@1e-2", 1.0), ("log_auc_difference@1e-3..1e-1", 1.0)):
        with pytest.raises(ValueError, match="can never fail"):
            Gate(product="roc", metric=metric, at_most=limit, reason="why")
    rows = compare_roc(model_curve(4.5), measured_curve(2.5), **NAMES)
    found = judged(rows, [Gate(product="roc", metric="auc_difference", within=(-0.01, 0.01), reason="why")])
    assert by_metric(found)["auc_difference"].outcome is Outcome.DISAGREES


def test_no_area_exceeds_one_and_a_perfect_curve_has_one():
    pfa = np.geomspace(1e-9, 1.0, 200)
    perfect = np.ones(200)
    for area in (RocArea(), RocArea(0, 0.1), RocArea(1e-3, 1e-1, logarithmic=True)):
        found = curve_area(RocCurve(pfa, perfect, perfect, perfect, -pfa, "object"), area)
        assert found == pytest.approx(1.0, abs=1e-12)
        assert found <= 1.0 + 1e-14


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
