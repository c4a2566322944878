"""Scores, ROC, areas and the drive over all products."""

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import (
    Gate,
    compare_products,
    compare_roc,
    compare_scores,
    difference_interval,
    equivalent,
    judged,
    scientific,
)
from hyperval.errors import UsageError
from hyperval.model import WHOLE, RocArea, curve_area
from hyperval.pixels import counts_of, empirical_roc, roc_area, with_summary
from hyperval.products import (
    Abundance,
    ObservedProducts,
    PredictedProducts,
    RocCurve,
    ScoreDistribution,
    SpectralEstimate,
)
from hyperval.results import Outcome
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


def by_metric(rows):
    return {r.metric: r for r in rows}


def test_a_true_prediction_is_inside_and_a_false_one_outside():
    good = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0), **NAMES))
    bad = by_metric(compare_roc(model_curve(5.5), measured_curve(3.0), **NAMES))
    for level in ("1e-1", "1e-2", "1e-3"):
        assert good[f"pd_inside_interval@{level}"].value == 1.0
    assert bad["pd_inside_interval@1e-3"].value == 0.0
    assert bad["pd_inside_measured_interval@1e-3"].value == 0.0
    assert bad["pd_difference@1e-3"].lower > 0
    assert bad["auc_difference"].value > good["auc_difference"].value


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
    from hyperval.model import clopper_pearson

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


def test_equivalence_needs_a_narrow_interval_not_a_missing_difference():
    assert equivalent((-0.04, 0.05), 0.1)
    assert not equivalent((-0.3, 0.3), 0.1)
    assert not equivalent((-0.3, 0.05), 0.1)
    assert not equivalent((-0.05, 0.3), 0.1)
    assert not equivalent((0.06, 0.12), 0.1)
    with pytest.raises(UsageError, match="margin"):
        equivalent((0.0, 0.1), 1.0)
    few = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0), equivalence_margin=0.1, **NAMES))
    assert few["pd_inside_interval@1e-1"].value == 1.0
    assert few["pd_equivalent@1e-2"].value == 0.0
    many = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0, targets=3000), equivalence_margin=0.1, **NAMES))
    assert many["pd_equivalent@1e-2"].value == 1.0
    assert many["pd_equivalent@1e-2"].reason == "margin 0.1"


def test_lower_false_alarm_rates_only_where_the_background_allows():
    small = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0, background=2000), **NAMES))
    assert small["pd_difference@1e-3"].outcome is Outcome.SKIPPED
    assert "2000 background samples expect 2 alarms" in small["pd_difference@1e-3"].reason
    assert "pd_difference@1e-4" not in small
    large = by_metric(compare_roc(model_curve(3.0), measured_curve(3.0, background=200_000), **NAMES))
    assert large["pd_difference@1e-4"].outcome is Outcome.NONE
    assert "pd_difference@1e-5" not in large


def test_a_curve_that_ends_early_or_has_no_interval():
    short = RocCurve(*(np.array(x) for x in ([0.05, 1.0], [0.5, 1.0], [0.4, 1], [0.6, 1], [1, 0])), "object")
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
    truth = stats.norm.cdf(2 / np.sqrt(2))
    assert curve_area(model_curve(2.0), WHOLE) == pytest.approx(truth, abs=1e-5)
    assert curve_area(empirical_roc(t, b), RocArea(1e-4, 1.0)) == pytest.approx(roc_area(counts_of(t, b)), abs=2e-3)
    # A curve that stops at P_FA 0.6 is joined to (1, 1); one that stops at 0.3 has no area.
    whole = model_curve(2.0)

    def cut(end):
        kept = whole.pfa <= end
        return RocCurve(*(x[kept] for x in (whole.pfa, whole.pd, whole.pd_lower, whole.pd_upper, whole.threshold)))

    assert curve_area(cut(0.6), WHOLE) == pytest.approx(truth, abs=5e-3)
    pixel = model_curve(2.0, unit="pixel")
    assert by_metric(compare_roc(cut(0.6), pixel, **NAMES))["auc_difference"].value == pytest.approx(0, abs=5e-3)
    assert by_metric(compare_roc(cut(0.3), pixel, **NAMES))["auc_difference"].outcome is Outcome.SKIPPED
    curve = with_summary(empirical_roc(t, b, unit="object"), t, b)
    rows = by_metric(compare_roc(model_curve(2.0), curve, **NAMES))
    assert rows["auc_difference"].lower < rows["auc_difference"].value < rows["auc_difference"].upper
    assert rows["auc_difference"].value == pytest.approx(truth - roc_area(counts_of(t, b)), abs=1e-5)


def test_labels():
    assert [scientific(x) for x in (0.1, 0.01, 1e-3, 2.5e-4, 1.0)] == ["1e-1", "1e-2", "1e-3", "2.5e-4", "1e0"]


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
    one = SpectralEstimate(np.ones(len(axis)), 1e-4 * np.eye(len(axis)))
    predicted = PredictedProducts(
        axis,
        radiance={"grass": one, "only model": one},
        reflectance={"grass": one},
        roc={("t", "cem", "object"): model_curve(3.0)},
        scores={("t", "cem"): ScoreDistribution(1, 0.1)},
        abundance={("t", "cem"): Abundance(1.0, 0.1)},
    )
    observed = ObservedProducts(
        axis,
        radiance={"grass": one, "only data": one},
        snr={"grass": one},
        roc={("t", "cem", "object"): measured_curve(3.0), ("t", "ace", "object"): measured_curve(3.0)},
        scores={("t", "cem"): ScoreDistribution(1, 0.1, 20)},
        abundance={("t", "cem"): Abundance(1.0, 0.1)},
    )
    rows = compare_products(predicted, observed)
    skipped = {
        (r.product, r.subject, r.method) for r in rows if r.outcome is Outcome.SKIPPED and r.metric == "comparison"
    }
    assert skipped == {
        ("radiance", "only model", "model"),
        ("radiance", "only data", "model"),
        ("snr", "grass", "model"),
        ("reflectance", "grass", "model"),
        ("roc", "t", "ace/object"),
    }
    assert {r.product for r in rows} == {"radiance", "snr", "reflectance", "scores", "roc", "abundance"}
    other = ObservedProducts(SpectralAxis(np.arange(451.0, 901.0, 10.0), 10.0))
    with pytest.raises(UsageError, match="not on the same spectral axis"):
        compare_products(predicted, other)


@pytest.mark.parametrize("exponent", [-322.0, -308.0, -300.0, -200.0])
def test_area_of_a_curve_that_rises_from_next_to_nothing_does_not_overflow(exponent):
    # Warnings are errors here.  By hand: P_D = c P_FA^k up to its last point, and a line from there to (1, 1).
    pfa = np.logspace(-6.0, -0.001, 120)
    pd = 10.0 ** np.linspace(exponent, -2.0, 120)
    k = (-2.0 - exponent) / (6.0 - 0.001)
    by_hand = pd[-1] * pfa[-1] / (k + 1.0) + (1.0 - pfa[-1]) * 0.5 * (pd[-1] + 1.0)
    with np.errstate(all="raise", under="ignore"):
        found = curve_area(RocCurve(pfa, pd, pd, pd, -pfa, "object"), WHOLE)
    assert found == pytest.approx(by_hand, abs=1e-3)  # a third of a step of the integration
