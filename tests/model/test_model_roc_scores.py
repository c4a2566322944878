"""Areas and false alarms of the model's scores against closed forms and plain integrals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from hyperval.model import ClassScores, RocScores

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
