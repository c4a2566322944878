"""Every comparison with an outcome tells its effect; the outcome of a test follows from it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from hyperval.compare import ChiSquare, Gate, judged
from hyperval.metrics import Kind, metric_of, table
from hyperval.results import Cause, Outcome, Result, Role

NU = 60.0


def told(metric, value, *, product="radiance", limits=None, **more) -> Result:
    limits = limits or {"within": (-0.05, 0.05)}
    gate = Gate(product=product, metric=metric, reason="r", chosen_after=True, before="nothing", **limits)
    (row,) = judged([Result("", product, "s", "m", metric, value, **more)], [gate])
    return row


def of_test(statistic: float, dof: int, nu: float = math.inf) -> Result:
    found = ChiSquare(statistic, dof, nu)
    return told("p_value_full", found.p_value, limits={"at_least": 0.001}, detectable=0.01, about=found.effect)


def test_a_number_is_told_in_units_of_the_field():
    row = told("median_difference_ratio_vnir", 0.01, lower=-0.02, upper=0.04)
    assert (row.effect, row.effect_lower, row.effect_upper) == pytest.approx((1.0, -2.0, 4.0))
    assert (row.accepted_low, row.accepted_high, row.ideal) == pytest.approx((-5.0, 5.0, 0.0))
    reach = 5.0 + 3.0 * (1.0 + stats.norm.ppf(0.8) / stats.norm.ppf(0.975))
    assert (row.detectable_low, row.detectable_high) == pytest.approx((-reach, reach))
    assert (row.effect_unit, row.set_after) == ("% of radiance", True)
    ratio = told("area_ratio", 1.1, product="abundance", lower=0.9, upper=1.3, limits={"within": (0.75, 1.25)})
    assert (ratio.effect, ratio.effect_upper, ratio.accepted_low, ratio.ideal) == pytest.approx((10.0, 30.0, -25.0, 0))
    (unplanned,) = judged([Result("", "radiance", "s", "m", "bias_ratio", 0.1, lower=0.0, upper=0.2)], [])
    assert math.isnan(unplanned.effect)


def test_a_test_agrees_only_where_its_whole_interval_lies_in_the_range():
    """Of 11 bands a difference of 1.5 times its uncertainty may be one of 2.1, which chance alone does not give."""
    near, beyond, far = (of_test(size**2 * 11, 11) for size in (1.1, 1.5, 2.5))
    assert [r.outcome for r in (near, beyond, far)] == [Outcome.AGREES, Outcome.UNDECIDED, Outcome.DISAGREES]
    assert beyond.cause is Cause.WIDE_INTERVAL
    assert beyond.effect_upper > beyond.accepted_high > beyond.effect
    assert beyond.p_value > 0.001
    assert (
        far.effect > far.accepted_high == near.accepted_high == pytest.approx(math.sqrt(stats.chi2.isf(5e-4, 11) / 11))
    )
    assert of_test(0.01, 11).cause is Cause.TOO_WIDE
    assert of_test(0.01, 11).effect < of_test(0.01, 11).accepted_low
    assert {r.ideal for r in (near, far)} == {1.0}


@pytest.mark.parametrize("nu", [math.inf, NU])
def test_the_interval_of_an_effect_holds_its_size_in_95_of_100(nu):
    """Statistics of noncentrality lambda are drawn; their intervals hold sqrt(1 + lambda / p)."""
    rng, dof, size, draws = np.random.default_rng(7), 12, 1.7, 150
    drawn = rng.noncentral_chisquare(dof, (size**2 - 1.0) * dof, draws)
    if math.isfinite(nu):  # Hotelling's statistic
        drawn = drawn * nu / rng.chisquare(nu - dof + 1.0, draws)
    effects = [ChiSquare(float(x), dof, nu).effect for x in drawn]
    held = np.mean([e.lower <= size <= e.upper for e in effects])
    assert held == pytest.approx(0.95, abs=4.0 * math.sqrt(0.95 * 0.05 / draws))
    found = np.mean([e.value > e.accepted(0.001)[1] for e in effects])
    at_detectable = effects[0].detectable[1]
    assert (found > 0.8) == (size > at_detectable)


def test_every_test_and_every_number_that_agrees_somewhere_has_a_unit_of_the_field():
    for metric in table().values():
        judged_alone = metric.kind is Kind.TEST and metric.section in ("spectral", "detection")
        if judged_alone or (metric.effect is not None and metric.kind is Kind.QUANTITY):
            assert metric.effect is not None, metric.name
            assert metric.effect.unit not in ("", "1"), metric.name
            assert math.isfinite(metric.effect.ideal) or math.isnan(metric.agreement), metric.name
    assert metric_of("p_value_full").effect.ideal == 1.0
    assert told("bias_ratio", 0.0, lower=-0.01, upper=0.01).role is Role.GATE
