"""The one interpolator: exact where a rule holds, at nodes, on grids and stars, and refusing what lies outside."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericTerms, interpolated_terms, smooth_rule, spaced
from hyperval.errors import UsageError

NM = np.array([500.0, 600.0, 700.0])
RNG = np.random.default_rng(11)


def terms(transmittance, albedo=0.1):
    """Terms that are all proportional to one transmittance, but for the albedo."""
    t = np.broadcast_to(np.asarray(transmittance, float), NM.shape)
    return AtmosphericTerms(NM, 0.1 * t, t, 0.2 * t, np.full(3, albedo), 3.0 * t, t)


def test_a_grid_is_exact_where_absorption_goes_with_the_root_of_the_column_and_haze_with_one_over_the_range():
    axes = {"water_vapour_g_cm2": np.array([0.5, 1.0, 2.0]), "meteorological_range_km": np.array([5.0, 10.0, 40.0])}

    def truth(w, r):
        return np.exp(-0.3 * np.sqrt(w) - 2.0 / r)

    runs = [terms(truth(w, r)) for w in axes["water_vapour_g_cm2"] for r in axes["meteorological_range_km"]]
    w, r = np.array([0.7, 1.9]), np.array([6.0, 33.0])
    found = interpolated_terms(axes, runs)({"water_vapour_g_cm2": w, "meteorological_range_km": r})
    np.testing.assert_allclose(found.direct[:, 0], truth(w, r), rtol=1e-12)
    np.testing.assert_allclose(found.spherical_albedo, 0.1, rtol=1e-12)


def test_a_star_adds_the_changes_of_several_inputs_and_needs_no_corner():
    axes = {"aot550": np.array([0.1, 0.05, 0.2]), "ozone_atm_cm": np.array([0.3, 0.25])}

    def truth(a, o):
        return np.exp(-0.8 * a - 0.5 * a**2 - 0.4 * o)

    runs = [terms(truth(*x)) for x in ((0.1, 0.3), (0.05, 0.3), (0.2, 0.3), (0.1, 0.25))]
    star = interpolated_terms(axes, runs, star=True, bounded=False)
    for a, o in ((0.1, 0.3), (0.13, 0.28), (0.25, 0.33)):  # the last one beyond the nodes
        found = star({"aot550": np.array([a]), "ozone_atm_cm": np.array([o])})
        np.testing.assert_allclose(found.direct[0], truth(a, o), rtol=1e-12)


def test_where_there_is_no_light_there_is_none_and_a_transmittance_stays_below_one():
    axes = {"aot550": np.array([0.0, 0.1, 0.2])}
    dark = [terms(np.array([0.0, 0.5, t])) for t in (0.999, 0.9999, 0.9999)]
    found = interpolated_terms(axes, dark)({"aot550": np.array([0.12, 0.15])})
    assert np.all(found.direct[:, 0] == 0.0)
    assert found.gas_transmittance.max() <= 1.0


def test_a_state_outside_a_bounded_table_is_refused_with_its_range():
    axes = {"aot550": np.array([0.1, 0.2])}
    made = interpolated_terms(axes, [terms(0.9), terms(0.8)])
    with pytest.raises(UsageError, match=r"atmosphere\.aot550 0\.15 to 0\.25 lies outside the table"):
        made({"aot550": np.array([0.15, 0.25])})


def test_it_travels_to_other_processes():
    axes = {name: np.array([10.0, 20.0]) for name in ("meteorological_range_km", "solar_zenith_deg")}
    made = interpolated_terms(axes, [terms(t) for t in (0.9, 0.8, 0.7, 0.6)])
    at = {name: np.array([15.0]) for name in axes}
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(made))(at).direct, made(at).direct)  # noqa: S301


def test_nodes_are_even_in_the_scale_of_their_input_but_for_the_sun():
    np.testing.assert_allclose(spaced("solar_zenith_deg", 0.0, 80.0, 5), [0.0, 20.0, 40.0, 60.0, 80.0])
    rule = smooth_rule("meteorological_range_km")
    steps = np.diff(rule.scale(spaced("meteorological_range_km", 5.0, 80.0, 6)))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    assert np.ptp(np.diff(spaced("meteorological_range_km", 5.0, 80.0, 6))) > 1.0
