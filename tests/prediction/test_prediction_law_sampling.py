"""Errors of the background's laws that were fitted to pixels: as the delta method has them, and where they go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri
from scipy.stats import norm

from hyperval.data import ClassStatistics
from hyperval.model import Origins, predict, with_law_limits
from hyperval.pixels import moments_without_each
from hyperval.products import ExceedanceCurve, RocCurve
from hyperval.scenario import Scenario
from hyperval.spectra import SpectralAxis

BANDS, PIXELS = 6, 3200
AXIS = SpectralAxis(np.linspace(450.0, 850.0, BANDS), np.full(BANDS, 10.0))
WIDE = 2.131449545559323 / 1.959963984540054  # t of 15 degrees of freedom
KEY = ("panel", "cem")


def scenario(**changes):
    content = {
        "schema": 1,
        "name": "a",
        "scene": {
            "classes": [{"name": "field", "fraction": 1.0, "spectrum": {"measured": "field"}}],
            "adjacency": {"effective_neighbours": None},
            "targets": [
                {
                    "name": "panel", "spectrum": {"constant": 0.6}, "covariance": {"relative_sd": 0.02},
                    "host": "field", "fill": {"fixed": 0.5},
                }
            ],
        },
        "processing": {"elm": "none", "detectors": ["cem"], "false_alarm_grid": {"lowest": 1e-6}},
    }  # fmt: skip
    return Scenario.model_validate(content | changes)


@pytest.fixture(scope="module")
def origins():
    rng = np.random.default_rng(8)
    root = 0.03 * np.tril(np.ones((BANDS, BANDS))) * np.linspace(1.0, 0.4, BANDS)
    pixels = 0.3 + rng.normal(size=(PIXELS, BANDS)) @ root.T
    part = np.repeat(np.arange(16), PIXELS // 16)
    whole = ClassStatistics("field", AXIS, pixels.mean(axis=0), np.cov(pixels.T), PIXELS)
    without = [replace(whole, mean=m, covariance=c) for m, c in moments_without_each(pixels, part)]
    return Origins(AXIS, {"field": whole}, left_out=lambda: [("field", without)])


def test_independent_pixels_have_the_error_of_the_delta_method(origins):
    """ln P_FA of a normal law at z: (phi/P)^2 (1 + z^2/2)/n; 16 parts know a variance to 37 %."""
    curve = predict(scenario(), origins).exceedance[KEY]
    for level in (1e-1, 1e-2, 1e-3):
        at = int(np.argmin(np.abs(np.log(curve.probability / level))))
        z = norm.isf(curve.probability[at])
        expected = norm.pdf(z) / curve.probability[at] * np.sqrt((1.0 + z**2 / 2.0) / PIXELS)
        sd = np.log(curve.upper[at] / curve.lower[at]) / 2.0 / 1.96 / WIDE
        assert sd == pytest.approx(expected, rel=0.55)  # three standard errors of the root


def test_detection_at_a_false_alarm_rate_has_it_too(origins):
    """P_D at a P_FA moves by the change of ln P_FA at the threshold, times the slope of the curve over ln P_FA."""
    prediction = predict(scenario(), origins)
    curve, alarms = prediction.roc[("panel", "cem", "pixel")], prediction.exceedance[KEY]
    at = int(np.argmin(np.abs(curve.pd - 0.9)))
    assert alarms.probability[::-1] == pytest.approx(curve.pfa)
    error = np.log(alarms.upper / alarms.probability)[::-1][at]
    slope = np.gradient(curve.pd, np.log(curve.pfa))[at]
    assert 0.5 * (curve.pd_upper - curve.pd_lower)[at] == pytest.approx(error * slope, rel=0.15)
    stated = predict(scenario(), replace(origins, left_out=None))
    plain = stated.roc[("panel", "cem", "pixel")]
    np.testing.assert_array_equal(plain.pd, curve.pd)  # values stay
    np.testing.assert_array_equal(plain.pd_lower, plain.pd)
    np.testing.assert_array_equal(stated.exceedance[KEY].upper, stated.exceedance[KEY].probability)


def test_what_a_law_does_not_say_far_out_stays_there():
    """Where P_FA of 1e-6 is known to a factor of a million, P_D at 1e-2 has the limits of P_FA at 1e-2."""
    pfa = np.logspace(-6, -0.01, 60)
    pd = ndtr(2.0 + ndtri(pfa))
    curve = RocCurve(pfa, pd, pd, pd, -ndtri(pfa))
    half = np.log(1.1) * np.maximum(np.log(pfa) / np.log(1e-2), 0.1) ** 6
    alarms = ExceedanceCurve(-ndtri(pfa)[::-1], pfa[::-1], *((pfa * np.exp(s * half))[::-1] for s in (-1, 1)))
    limits = with_law_limits(curve, alarms)
    assert np.all(np.diff(limits.pd_lower) >= 0)
    assert np.all(np.diff(limits.pd_upper) >= 0)
    at = int(np.argmin(np.abs(pfa - 1e-2)))
    for limit, factor in ((limits.pd_lower, 1.0 / 1.1), (limits.pd_upper, 1.1)):
        expected = ndtr(2.0 + ndtri(pfa[at] * factor ** ((np.log(pfa[at]) / np.log(1e-2)) ** 6)))
        assert limit[at] == pytest.approx(expected, rel=0.02)
    own = replace(curve, pd_lower=ndtr(ndtri(pd) - 0.3), pd_upper=ndtr(ndtri(pd) + 0.4))
    both = with_law_limits(own, alarms)
    z = ndtri(pd[at])
    assert ndtri(both.pd_upper[at]) - z == pytest.approx(np.hypot(0.4, ndtri(limits.pd_upper[at]) - z), rel=1e-6)
    assert z - ndtri(both.pd_lower[at]) == pytest.approx(np.hypot(0.3, z - ndtri(limits.pd_lower[at])), rel=1e-6)
