"""ROC of the model: thresholds, areas and readings by other routes; the printed procedure; limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import integrate, stats
from scipy.optimize import brentq
from scipy.stats import norm, t
from score_classes import classes, roc_of, thresholds

from hyperval.compare import compare_roc
from hyperval.errors import UsageError
from hyperval.model import ClassScores, RocScores, detection_at, false_alarm_grid, log_false_alarm, thresholds_at
from hyperval.products import RocCurve


def curve(target: RocScores, pfa=None) -> np.ndarray:
    return target.detection(np.atleast_2d(false_alarm_grid() if pfa is None else np.asarray(pfa, dtype=float)))[0]


def test_a_target_like_its_background_is_on_the_diagonal():
    assert curve(roc_of(0.2, 0.3, 1.0, classes((1.0, 0.2, 0.3)))) == pytest.approx(false_alarm_grid(), rel=1e-6)


def test_no_background():
    with pytest.raises(UsageError, match="no background class"):
        thresholds([1e-3], classes((0.0, 0.0, 1.0)))


def binormal(pfa: np.ndarray, d: float = 2.5) -> RocCurve:
    """Two normal scores ``d`` standard deviations apart, in closed form."""
    pd = norm.sf(norm.isf(pfa) - d)
    return RocCurve(pfa, pd, pd - 0.01, pd + 0.01, norm.isf(pfa))


def test_a_coarse_grid_reads_as_a_fine_one():
    """Curves of normal scores are straight in probits, so that a grid of one point a decade loses nothing."""
    coarse, at = binormal(10.0 ** np.arange(-5.0, 0.0)), np.geomspace(1e-5, 0.1, 40)
    truth = norm.sf(norm.isf(at) - 2.5)
    assert detection_at(coarse, at) == pytest.approx(truth, abs=1e-12)
    straight = np.interp(np.log(at), np.log(coarse.pfa), coarse.pd)
    assert np.abs(straight - truth).max() > 0.01  # the reading in P_D itself is not right


def test_points_of_the_curve_are_read_as_they_stand():
    curve = binormal(np.logspace(-6, -1, 11))
    assert detection_at(curve, curve.pfa) == pytest.approx(curve.pd, abs=0, rel=0)
    assert detection_at(curve, 1e-3, curve.pd_lower) == curve.pd_lower[6]
    assert np.isnan(detection_at(curve, [1e-7, 0.2])).all()


def test_steps_of_a_measured_curve_that_have_no_probit():
    curve = RocCurve(np.array([1e-3, 1e-2, 1e-1]), np.array([0.0, 0.5, 1.0]), *(np.zeros(3),) * 3)
    assert detection_at(curve, np.sqrt([1e-5, 1e-3])) == pytest.approx([0.25, 0.75])
    one = RocCurve(np.array([1e-2]), np.array([0.5]), *(np.zeros(1),) * 3)
    assert detection_at(one, 1e-2) == 0.5
    assert np.isnan(detection_at(one, 1e-3))


def test_comparison_reads_the_curve_in_the_same_way():
    curve, fine = binormal(10.0 ** np.array([-4.0, -2.5, -1.0])), binormal(np.logspace(-4, -1, 31))
    rows = {r.metric: r.value for r in compare_roc(curve, fine, subject="s", method="m")}
    assert rows["pd_predicted@1e-2"] == pytest.approx(float(detection_at(curve, 1e-2)), abs=1e-12)


# Two classes, one with a tail, and targets of two fills.
FRACTION, MEAN, SD, DOF = (0.7, 0.3), (0.0, 0.1), (0.05, 0.08), (np.inf, 5.0)


MEANS, SDS, WEIGHTS = (0.15, 0.3), (0.04, 0.06), (0.4, 0.6)


def law(m):
    if np.isinf(DOF[m]):
        return stats.norm(MEAN[m], SD[m])
    return stats.t(DOF[m], MEAN[m], SD[m] * np.sqrt((DOF[m] - 2.0) / DOF[m]))


def scores(fills=slice(None), classes=slice(None)):
    background = ClassScores(*(np.array([np.array(a)[classes]]) for a in (FRACTION, MEAN, SD, DOF)))
    target = (np.array([np.array(a)[fills]]) for a in (MEANS, SDS, WEIGHTS))
    return RocScores(background, np.zeros(1, int), *target)


def test_the_area_of_two_gaussians_is_the_closed_form():
    one = scores(slice(1, 2), slice(0, 1))
    expected = FRACTION[0] * WEIGHTS[1] * stats.norm.cdf((0.3 - 0.0) / np.hypot(0.06, 0.05))
    assert one.auc() == pytest.approx([expected], rel=1e-12)


def test_the_area_is_the_integral_over_background_and_target():
    def outscored(x):
        return sum(w * stats.norm.sf(x, m, s) for m, s, w in zip(MEANS, SDS, WEIGHTS, strict=True))

    expected = sum(
        f * integrate.quad(lambda x, m=m: law(m).pdf(x) * outscored(x), -2.0, 2.0, points=[0.1, 0.3], epsabs=1e-10)[0]
        for m, f in enumerate(FRACTION)
    )
    assert scores().auc() == pytest.approx([expected], abs=2e-5)  # 64 nodes in the quantile of the tail
    whole = scores()
    pfa = np.geomspace(1e-7, 0.999, 4000)[None]
    assert np.trapezoid(whole.detection(pfa)[0], pfa[0]) == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("fills", [slice(0, 1), slice(None)])
@pytest.mark.parametrize("pd", [0.05, 0.5, 0.9])
def test_false_alarms_at_a_detection_are_those_of_the_threshold_that_gives_it(fills, pd):
    made = scores(fills)
    made = RocScores(made.classes, made.which, made.means, made.sds, made.weights / made.weights.sum())
    pfa = 10.0 ** made.log10_false_alarm(np.array([pd]))
    assert made.detection(pfa[:, None])[0, 0] == pytest.approx(pd, abs=1e-9)
    if made.means.size == 1:
        at = stats.norm.isf(pd, MEANS[0], SDS[0])
        assert pfa[0] == pytest.approx(sum(f * law(m).sf(at) for m, f in enumerate(FRACTION)), rel=1e-9)


def test_evaluations_without_scores_have_no_threshold():
    background = ClassScores(*(np.array([a, a]) for a in (FRACTION, MEAN, SD, DOF)))
    background.mean[1, 0] = np.nan
    target = [np.array([a, a]) for a in (MEANS, SDS, WEIGHTS)]
    made = RocScores(background, np.array([0, 1]), *target)
    threshold = made.thresholds(np.array([[1e-2, 1e-1]]))
    assert np.isfinite(threshold[0]).all()
    assert np.isnan(threshold[1]).all()
    assert np.isnan(made.thresholds(np.array([[0.0, 0.1], [0.1, 1.1]]))).all()


def random_scores(rng: np.random.Generator, rows: int, tails: bool) -> ClassScores:
    fraction = rng.dirichlet(np.ones(4), rows)
    fraction[::5, 2] = 0.0
    fraction /= fraction.sum(axis=1, keepdims=True)
    dof = np.where(rng.random((rows, 4)) < 0.5, rng.uniform(2.1, 40.0, (rows, 4)), np.inf)
    mean, sd = rng.normal(0.0, 0.02, (rows, 4)), rng.uniform(0.004, 0.05, (rows, 4))
    return ClassScores(fraction, mean, sd, dof if tails else np.full((rows, 4), np.inf))


@pytest.mark.parametrize("tails", [False, True])
def test_thresholds_by_a_root_finder_on_the_plain_sum(tails):
    scores = random_scores(np.random.default_rng(0), 12, tails)
    pfa = false_alarm_grid(1e-9, 4)
    found = thresholds_at(np.broadcast_to(pfa, (12, pfa.size)), scores)
    for r in range(12):
        laws = [
            (f, norm(m, s) if np.isinf(d) else t(d, m, s * np.sqrt((d - 2.0) / d)))
            for f, m, s, d in zip(*(a[r] for a in vars(scores).values()), strict=True)
        ]

        def excess(x: float, p: float, laws: list[tuple[float, Any]] = laws) -> float:
            return float(np.log(sum(f * law.sf(x) for f, law in laws) + 1e-300) - np.log(p))

        for p, x in zip(pfa[::6], found[r, ::6], strict=True):
            assert x == pytest.approx(brentq(excess, -2.0, x + 1.0, args=(p,), xtol=1e-13), abs=1e-9)


def test_thresholds_beside_a_class_that_hardly_varies():
    """A narrow class of a millionth of the area puts a small step into a smooth tail."""
    rows = [[1.0 - 1e-6, 1e-6], [0.0, 0.05], [0.02, 1e-9], [np.inf, np.inf]]
    scores = ClassScores(*np.array(rows)[:, None, :])
    step = float(np.exp(log_false_alarm(np.array([0.05]), scores)[0][0]))
    pfa = step + np.linspace(-0.7e-6, 0.7e-6, 41)
    x = thresholds_at(pfa[None], scores)[0]
    value, _ = log_false_alarm(x, scores.rows(np.zeros(x.size, int)))
    np.testing.assert_allclose(value, np.log(pfa), rtol=0, atol=1e-11)
