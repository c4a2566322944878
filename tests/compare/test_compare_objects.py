"""Objects of many kinds judged together, and the background's tail."""

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import (
    Gate,
    compare_exceedance,
    compare_object_scores,
    detection,
    distance_from_uniform,
    judged,
    judged_together,
    probability_integral_transform,
)
from hyperval.errors import UsageError
from hyperval.products import ExceedanceCurve, ObjectScores
from hyperval.results import Outcome, ResultTable

ROWS, COLUMNS = 200, 40


def drawn(common, own, rng, subjects=25):
    """Predictions of normal scores with an error that all subjects share, and one set of true scores."""
    shared = np.concatenate([rng.standard_normal(ROWS // 2), [0.0]])[: ROWS // 2]
    shared = np.concatenate([shared, -shared])[:, None]
    means = np.linspace(0.1, 1.0, subjects)
    predicted = {
        f"t{i:02d}": ObjectScores(m + common * shared + own * rng.standard_normal((ROWS, COLUMNS)))
        for i, m in enumerate(means)
    }
    error = common * rng.standard_normal()
    truth = {name: m + error + own * rng.standard_normal(1) for name, m in zip(predicted, means, strict=True)}
    return predicted, truth


def rows_of(predicted, truth):
    measured = {name: ObjectScores(values, (name,)) for name, values in truth.items()}
    return compare_object_scores(predicted, measured, method="cem")


def of(rows, metric, subject="all objects"):
    return next(r for r in rows if (r.metric, r.subject) == (metric, subject))


def test_transform_is_the_predicted_distribution_function():
    # 40,000 draws: the sd of a share is at most 0.0025, four of them 0.01.
    draws = np.random.default_rng(1).normal(0.3, 0.1, (400, 100))
    at = np.array([0.1, 0.25, 0.3, 0.45])
    assert probability_integral_transform(at, draws) == pytest.approx(stats.norm.cdf(at, 0.3, 0.1), abs=0.01)
    assert probability_integral_transform([5.0], draws)[0] == pytest.approx(1.0, abs=1e-4)
    assert probability_integral_transform([1.0, 2.0], [1.0, 1.0, 3.0, 3.0]).tolist() == [0.3, 0.5]


def test_distance_is_that_of_another_package():
    u = np.random.default_rng(2).uniform(size=(3, 30))
    assert distance_from_uniform(u) == pytest.approx([stats.kstest(x, "uniform").statistic for x in u])
    with pytest.raises(UsageError, match="between 0 and 1"):
        distance_from_uniform([0.5, np.nan])


@pytest.mark.slow
def test_right_predictions_with_common_errors_are_rejected_at_the_stated_rate(monkeypatch):
    # 100 worlds whose common error is as large as the rest: a 5 % test rejects 5 of them (sd 2.2); limit at 4 sd.
    # The customary test, which takes objects for independent, rejects most.  1,000 sets of the model place a
    # p-value of 5 % to 0.7 %, which leaves the rate of rejection; how wide a departure is detectable is not asked.
    monkeypatch.setattr(detection, "REPLICATES", 1000)
    monkeypatch.setattr(detection, "POWER_DRAWS", 20)
    rng = np.random.default_rng(4)
    ours, customary, joint, drift = 0, 0, 0, 0
    for _ in range(100):
        shift = rng.uniform(0.2, 1.0, 25)
        base, truth = drawn(0.1, 0.1, rng)
        predicted = {k: ObjectScores(p.values + s) for (k, p), s in zip(base.items(), shift, strict=True)}
        moved = {k: v + s for (k, v), s in zip(truth.items(), shift, strict=True)}
        found = judged_together(predicted, moved)
        u = [float(probability_integral_transform(moved[k], predicted[k].values)[0]) for k in predicted]
        assert found.joint is not None
        assert found.drift is not None
        ours += found.uniformity.p_value < 0.05
        customary += stats.kstest(u, "uniform").pvalue < 0.05
        joint += 2.0 * min(found.joint.p_value, 1.0 - found.joint.p_value) < 0.05
        drift += found.drift.p_value < 0.05
    assert ours <= 14
    assert customary > 30
    assert joint <= 14
    assert drift <= 14


def test_falsified_scores_turn_the_verdict():
    predicted, truth = drawn(0.02, 0.1, np.random.default_rng(6))
    tests = ("objects_inside_95_p_value", "pit_uniformity_p_value", "joint_distance_p_value")
    plan = {"product": "scores", "subjects": ("all objects",), "at_least": 0.01, "reason": "r"}
    gates = [Gate(metric=metric, **plan) for metric in tests]

    def verdicts(rows):
        return {r.metric: r.outcome for r in ResultTable(judged(rows, gates)).gates()}

    right = verdicts(rows_of(predicted, truth))
    assert set(right.values()) <= {Outcome.AGREES, Outcome.UNDECIDED}  # 25 objects tell little of a width
    for falsify in (lambda x: x + 0.3, lambda x: 0.5 * x, lambda x: x + 0.4 * np.sign(x - 0.5)):
        wrong = verdicts(rows_of(predicted, {k: falsify(v) for k, v in truth.items()}))
        assert wrong["pit_uniformity_p_value"] is Outcome.DISAGREES
        assert wrong["objects_inside_95_p_value"] is Outcome.DISAGREES
    # A prediction that is much too unsure holds every object and is found out by the transform values.
    unsure = {k: ObjectScores(p.values.mean() + 10.0 * (p.values - p.values.mean())) for k, p in predicted.items()}
    timid = verdicts(rows_of(unsure, truth))
    assert timid["objects_inside_95_p_value"] is not Outcome.DISAGREES
    assert timid["pit_uniformity_p_value"] is Outcome.DISAGREES
    assert timid["joint_distance_p_value"] is Outcome.DISAGREES  # two-sided: too wide fails too


def test_rows_of_single_objects_and_of_groups():
    rng = np.random.default_rng(7)
    draws = rng.normal(0.5, 0.1, (1, 8000))
    predicted = {"one": ObjectScores(draws), "many": ObjectScores(draws), "lost": ObjectScores(draws)}
    measured = {
        "one": ObjectScores(np.array([0.9]), ("o",)),
        "many": ObjectScores(rng.normal(0.5, 0.1, 60), tuple(map(str, range(60)))),
        "lost": ObjectScores(np.array([np.nan]), ("x",)),
        "not predicted": ObjectScores(np.array([1.0]), ("y",)),
    }
    rows = compare_object_scores(predicted, measured, method="cem")
    assert of(rows, "object_score_inside_95", "one").value == 0.0
    assert of(rows, "object_score_measured", "one").value == 0.9
    interval = of(rows, "object_score_predicted", "one")
    # Of 8,000 draws the ends have a standard error of 0.003.
    assert (interval.lower, interval.upper) == pytest.approx((0.304, 0.696), abs=0.012)
    assert of(rows, "objects_inside_95", "many").n == 60
    assert of(rows, "object_score_pit", "lost").outcome is Outcome.SKIPPED
    assert of(rows, "objects_inside_95").n == 61
    assert "without lost" in of(rows, "objects_inside_95").reason
    assert not [r for r in rows if r.subject == "not predicted"]
    none = compare_object_scores(predicted, {}, method="cem")
    assert {r.outcome for r in none} == {Outcome.SKIPPED}


def test_ratio_of_false_alarms():
    x = np.linspace(0.0, 5.0, 200)
    model = ExceedanceCurve(x, stats.norm.sf(x), stats.norm.sf(x), stats.norm.sf(x))
    true = 2.0 * stats.norm.sf(x).clip(0, 0.5)
    measured = ExceedanceCurve(x, true, true / 1.5, true * 1.5, 20_000)
    rows = compare_exceedance(model, measured, subject="t background", method="cem")
    assert {r.metric for r in rows} == {"pfa_ratio@1e-1", "pfa_ratio@1e-2", "pfa_ratio@1e-3"}
    for row in rows:
        assert row.subject == "t background"
        assert row.value == pytest.approx(0.5, rel=1e-6)
        assert (row.lower, row.upper) == pytest.approx((0.5 / 1.5, 0.75))
    few = compare_exceedance(model, ExceedanceCurve(x, true, true, true, 500), subject="t background", method="cem")
    assert [r.outcome for r in few] == [Outcome.NONE, Outcome.SKIPPED, Outcome.SKIPPED]
    assert compare_exceedance(model, None, subject="t background", method="cem")[0].outcome is Outcome.SKIPPED


# Objects that are independent and predicted by a normal law have normal scores that are independent standard normal
# numbers, so that every null distribution drawn from the prediction is one of the textbook.  4,000 sets (2,000 for the
# joint test) are drawn with a fixed seed: a p-value is off by 0.008 at most, and a limit at 2.5 % of a normal law by
# 0.042 of its standard deviation.  Tolerances are four of these: were the seed another, 1 in 10,000 would fail.
OBJECTS = 9
LAW = stats.norm.ppf((np.arange(4000) + 0.5) / 4000)[None, :]
MEANS = np.linspace(0.0, 4.0, OBJECTS)
PREDICTED = {f"t{i}": ObjectScores(m + LAW) for i, m in enumerate(MEANS)}
# Places of the expected scores, from weakest to strongest 1 apart.
PLACE = (np.arange(OBJECTS) - (OBJECTS - 1) / 2) / (OBJECTS - 1)
SD = 1.0 / np.sqrt(PLACE @ PLACE)  # of the least-squares slope of independent standard normal numbers


def together(z):
    return judged_together(PREDICTED, {k: np.array([m + x]) for k, m, x in zip(PREDICTED, MEANS, z, strict=True)})


@pytest.mark.parametrize("slope", [0.8, -1.2, 2.0])
def test_a_drift_is_that_of_a_least_squares_slope(slope):
    found = together(0.3 + slope * PLACE)
    assert found.drift is not None
    assert found.drift.effect.value == pytest.approx(slope, rel=0.01)
    assert found.drift.p_value == pytest.approx(2.0 * stats.norm.sf(abs(slope) / SD), abs=0.032)
    ends = (slope - 1.959964 * SD, slope + 1.959964 * SD)
    assert (found.drift.effect.lower, found.drift.effect.upper) == pytest.approx(ends, abs=4.0 * 0.042 * SD)
    # Rejected at 1 % in both tails together, in four cases of five: the quantiles at 0.995 and at 0.8.
    assert found.drift.detectable == pytest.approx((stats.norm.isf(0.005) + stats.norm.isf(0.2)) * SD, rel=0.06)


def test_a_joint_distance_is_chi_square_of_as_many_objects():
    for scale in (0.8, 1.0, 1.3):
        z = scale * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0])
        found = together(z)
        assert found.joint is not None
        # 2,000 sets make a p-value to 0.011, and the covariance of 2,000 others is itself off by a few per cent.
        assert found.joint.p_value == pytest.approx(stats.chi2.sf(z @ z, OBJECTS), abs=0.06)
        # The limit at 0.005 of chi-square, over the squared width, is passed by 0.75 at twice and 0.98 at three times.
        assert found.joint.detectable == 3.0


@pytest.mark.parametrize("common", [0.0, 3.0])
def test_a_spread_is_that_of_as_many_normal_numbers(common):
    # What all share moves their mean alone, and makes each of them vary more than about that mean.
    rows, own = (stats.norm.ppf((np.arange(n) + 0.5) / n) for n in (200, 400))
    predicted = {k: ObjectScores(m + common * rows[:, None] + own) for k, m in zip(PREDICTED, MEANS, strict=True)}
    each = np.hypot(1.0, common)
    scores = {k: np.array([m + each * (1.0 + 2.0 * x)]) for k, m, x in zip(PREDICTED, MEANS, PLACE, strict=True)}
    found, measured = judged_together(predicted, scores), each * np.std(2.0 * PLACE, ddof=1)
    low, middle, high = np.sqrt(stats.chi2.ppf([0.025, 0.5, 0.975], OBJECTS - 1) / (OBJECTS - 1)) / measured
    assert (found.spread.lower, found.spread.value, found.spread.upper) == pytest.approx((low, middle, high), rel=0.06)


def test_the_number_inside_is_binomial():
    found = together(np.array([3.0, -3.0, *(OBJECTS - 2) * [0.5]]))
    assert found.count.effect.value == pytest.approx((OBJECTS - 2) / OBJECTS)
    assert found.count.p_value == pytest.approx(stats.binom.cdf(OBJECTS - 2, OBJECTS, 0.95), abs=0.014)
    # At most 1 in 40 sets has fewer inside, and none more than all.
    assert found.expected == pytest.approx((stats.binom.ppf(0.025, OBJECTS, 0.95) / OBJECTS, 1.0))
