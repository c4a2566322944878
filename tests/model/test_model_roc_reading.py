"""P_D at a P_FA: one reading of a curve, whoever asks."""

import numpy as np
import pytest
from scipy.stats import norm

from hyperval.compare import compare_roc
from hyperval.model import detection_at
from hyperval.products import RocCurve


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
