"""Where a comparison has nothing to say it says so: no number, and no row that agrees."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hyperval.compare import chi_square_shape, compare_abundance, detectable_tilts, predicted_area
from hyperval.compare.spectra import _detectable, _mean_ratio
from hyperval.model import AREAS
from hyperval.products import Abundance, RocCurve
from hyperval.results import Cause, Outcome


def test_nothing_is_said_of_one_wavelength_or_of_a_spectrum_that_is_zero():
    assert all(math.isnan(t) for t in detectable_tilts([1.0, 1.0], [500.0, 500.0], np.eye(2)))
    dark = chi_square_shape([0.1, -0.2], [0.0, 0.0], np.eye(2))
    assert (dark.value, dark.dof) == (pytest.approx(0.05), 2)
    ratio = np.array([1.0, np.nan])
    assert np.isnan(_mean_ratio(ratio, np.eye(2), np.array([False, True]))).all()


@pytest.mark.parametrize(("unit", "dof", "nu"), [(1.0, 0, math.inf), (1.0, 5, 5.0), (0.0, 3, math.inf)])
def test_what_no_test_can_reject_has_no_detectable_size(unit, dof, nu):
    assert math.isnan(_detectable(unit, dof, nu))


def test_an_area_of_nothing_has_no_ratio():
    rows = compare_abundance(Abundance(0.0, 0.1), Abundance(3.0, 0.2, 9), subject="p", method="fcls")
    (row,) = [r for r in rows if r.metric == "area_ratio"]
    assert (row.outcome, row.cause) == (Outcome.SKIPPED, Cause.NOT_POSITIVE)


def test_the_area_of_a_curve_without_a_band_is_a_point():
    pfa = np.array([1e-3, 1e-2, 0.1, 1.0])
    lacking = np.full(4, np.nan)
    curve = RocCurve(pfa, np.sqrt(pfa), lacking, lacking, np.array([3.0, 2.0, 1.0, -9.0]))
    value, interval = predicted_area(curve, AREAS["partial_auc@0..1e-1"])
    assert math.isfinite(value)
    assert interval == (value, value)
