"""Monte Carlo beside linearisation: where they must agree, where they must not, and what stands for the engine."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import polygamma
from uncertain_scene import ATMOSPHERE, AXIS, ORIGINS, engine, run, scenario

from hyperval.model import (
    WHOLE,
    Origins,
    curve_area,
    drawn_covariance,
    emulator,
    inputs_of,
    quantities,
    read,
    tolerance,
)
from hyperval.scenario import Scenario, Uncertainty
from hyperval.settings import with_settings

KEY = ("tenth", "cem", "pixel")
SMALL = """
uncertainty:
  method: both
  samples: 300
  aot550: 0.02
  solar_irradiance_relative: 0.01
  engine: {relative: 0.01, correlation_nm: 300}
  field_spectra: [{subject: plank, relative: 0.02, correlation_nm: 300}]
"""


def with_method(method: str, text: str = SMALL) -> Scenario:
    return scenario(ATMOSPHERE + text.replace("method: both", f"method: {method}"))


@pytest.fixture(scope="module")
def both():
    return run(with_method("both"))


def test_small_errors_agree_both_ways_and_keep_the_linear_intervals(both):
    # 300 draws: the standard error of a standard deviation is 4.1 %; 4.5 of them, false failure below 1e-4 in all.
    table = both.provenance["propagation"]["agreements"]
    assert {row["key"][0] for row in table} == {
        "radiance", "reflectance", "snr", "score mean", "score sd", "P_D", "AUC",
    }  # fmt: skip
    for row in table:
        if row["key"][0] != "score sd":  # of second order in a change of the light
            assert row["sd_ratio"] == pytest.approx(1.0, abs=0.185), row
    linear = run(with_method("linear"))
    np.testing.assert_array_equal(both.roc[KEY].pd_lower, linear.roc[KEY].pd_lower)
    assert any("300 draws of the budget (seed 0)" in n for n in both.notes)
    assert any("engine runs" in n for n in both.notes)


def test_the_budget_that_predict_adds_up_is_that_of_a_prediction_for_every_direction():
    s = with_method("linear", SMALL + "  sensor_gain: {relative: 0.01, correlation: random}\n")
    stated, plain = run(s), s.model_copy(update={"uncertainty": Uncertainty()})
    total = {(p, n): np.zeros(len(AXIS)) for p in ("radiance", "snr", "reflectance") for n in getattr(stated, p)}
    for item in inputs_of(read(s, ORIGINS)):
        for k in range(item.size):
            up, down = (run(plain, truth=item.direction(k, z)) for z in (1.0, -1.0))
            for p, n in total:
                total[p, n] += (0.5 * (getattr(up, p)[n].mean - getattr(down, p)[n].mean)) ** 2
    for (p, n), variance in total.items():
        np.testing.assert_allclose(
            getattr(stated, p)[n].standard_uncertainty, np.sqrt(variance), rtol=2e-3, atol=1e-9, err_msg=f"{p} {n}"
        )


@pytest.mark.slow
def test_where_the_ways_differ_the_draws_give_the_interval_of_pd():
    # A covariance of 10 bands from 60 samples: P_D has a tail that no straight line knows.
    text = SMALL.replace("aot550: 0.02", "sampled_statistics: [{subject: asphalt, effective_n: 60}]")
    p, linear = run(with_method("both", text)), run(with_method("linear", text))
    assert any("P_D intervals from the draws" in n for n in p.notes)
    at = int(np.argmin(np.abs(p.roc[KEY].pfa - 1e-2)))
    assert p.roc[KEY].pd_lower[at] != linear.roc[KEY].pd_lower[at]
    assert np.all(p.roc[KEY].pd_lower <= p.roc[KEY].pd)
    assert np.all(p.roc[KEY].pd_upper >= p.roc[KEY].pd)


@pytest.mark.slow
def test_monte_carlo_alone_scales_spectra_and_takes_every_curve():
    p, linear = run(with_method("monte-carlo")), run(with_method("linear"))
    ratio = p.radiance["grass"].standard_uncertainty / linear.radiance["grass"].standard_uncertainty
    assert np.ptp(ratio) < 1e-12
    assert ratio[0] == pytest.approx(1.0, abs=0.185)
    assert np.any(p.roc[KEY].pd_lower != linear.roc[KEY].pd_lower)


def moved(item, z: float) -> dict[str, float]:
    return {path: float(value[0]) for path, value in item.moved(z).items()}


def test_the_emulator_is_the_engine_at_its_nodes_and_near_it_between():
    s = scenario(ATMOSPHERE + "uncertainty: {aot550: 0.05, water_vapour_g_cm2: 0.5, solar_zenith_deg: 2}\n")
    inputs = inputs_of(read(s, ORIGINS))
    made = emulator(s, inputs, engine, AXIS)
    assert made.runs == 8  # stated, two for each of three fields, one check
    assert 0.0 < made.error[1] <= made.error[0] < 0.01
    for item in inputs:
        for z in (-(3.0**0.5), 0.0, 3.0**0.5):
            state = with_settings(s, moved(item, z)).atmosphere
            exact = engine(state).at_bands(AXIS)
            np.testing.assert_allclose(made.engine(state).direct, exact.direct, rtol=1e-9)
            np.testing.assert_allclose(made.engine(state).at_bands(AXIS).path_radiance, exact.path_radiance, rtol=1e-9)
        state = with_settings(s, moved(item, 1.0)).atmosphere
        np.testing.assert_allclose(made.engine(state).direct, engine(state).at_bands(AXIS).direct, rtol=2e-3)


def test_separation_of_a_drawn_covariance_follows_its_pivot():
    # (n - 1) d^T Sigma^-1 d / d^T S^-1 d is chi-square(n - B): mean n - B, variance 2 (n - B).  3,000 draws; 4.5
    # standard errors, false failure below 1e-5 each.
    rng = np.random.default_rng(2)
    bands, n = 8, 24
    root = np.tril(rng.standard_normal((bands, bands))) + 3.0 * np.eye(bands)
    s = root @ root.T
    d = rng.standard_normal(bands)
    stated = d @ np.linalg.solve(s, d)
    path = "surfaces.[a].covariance"
    x = np.array(
        [d @ np.linalg.solve(drawn_covariance("a", s, n, rng)[path], d) / stated * (n - 1) for _ in range(3000)]
    )
    assert x.mean() == pytest.approx(n - bands, abs=4.5 * np.sqrt(2 * (n - bands) / 3000))
    assert x.var() == pytest.approx(2 * (n - bands), rel=4.5 * np.sqrt(2.3 / 3000))
    # The logarithm of one standard deviation scatters by half of what that of chi-square does.
    world = read(scenario("uncertainty: {sampled_statistics: [{subject: asphalt, effective_n: 200}]}"), Origins(AXIS))
    (spread,) = (item for item in inputs_of(world) if item.path.endswith("spread"))
    assert spread.rows[0, 0] == pytest.approx(0.5 * np.sqrt(polygamma(1, 99.5)), rel=0.01)
    few = drawn_covariance("a", s, 12, rng)  # too few for a matrix: one factor
    assert list(few) == ["surfaces.[a].spread"]
    assert few["surfaces.[a].spread"] > 0


def test_area_of_a_curve_and_tolerance_of_a_limit():
    p = run(scenario(ATMOSPHERE).model_copy(update={"uncertainty": Uncertainty()}))
    curve = p.roc[KEY]
    # P(score of a target above one of the background), from the tabulated densities of both.
    target, ground = p.scores["tenth", "cem"], p.scores["tenth background", "cem"]
    below = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(ground.grid) * (ground.density[1:] + ground.density[:-1]))])
    share = np.interp(target.grid, ground.grid, below, left=0.0, right=1.0)
    assert curve_area(curve, WHOLE) == pytest.approx(np.trapezoid(share * target.density, target.grid), abs=2e-3)
    assert quantities(p)["AUC", *KEY][0] == curve_area(curve, WHOLE)
    # u = 0.02: one digit, half a unit of it is 0.005; with infinitely many draws nothing is added.
    np.testing.assert_allclose(tolerance(np.array([0.02, 0.9]), 10**12), [0.005, 0.05], rtol=1e-4)
    # Of 10,000 uniform draws the 250th is a beta number, and so is the probability of a normal one.
    error = np.std(stats.norm.isf(stats.beta(250, 9751).ppf((np.arange(4000) + 0.5) / 4000)))
    assert tolerance(np.array([0.031]), 10_000) == pytest.approx([0.005 + 2.0 * 0.031 * error], rel=1e-3)
