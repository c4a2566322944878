"""From a ranking and what-ifs to rows that a reader understands."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import optimize, stats

from hyperval import attribute
from hyperval.errors import UsageError
from hyperval.model import Origins, read
from hyperval.scenario import Scenario, load_scenario
from hyperval.spectra import SpectralAxis
from small_campaign import stand_in_atmosphere

N = 50
X = np.linspace(0.0, 1.0, N)
FREE, STATED = (attribute.Candidate("input", "", "", budgeted) for budgeted in (False, True))
GAIN = attribute.Candidate("gain", "sensor", "1 %", False)
TILT = attribute.Candidate("tilt", "sensor", "1 %", True)
TWIN = attribute.Candidate("twin of gain", "sensor", "1 %", False)
COLUMNS = {GAIN: np.ones((N, 1)), TILT: (X - 0.5)[:, None]}


def _ranking(residual, columns=None):
    columns = columns or COLUMNS
    covariance = 0.1**2 * np.eye(N) + attribute.budget_covariance(columns, N)
    return attribute.ranking("all", residual, covariance, columns)


@pytest.mark.parametrize(
    ("residual", "conclusion"),
    [
        (0.1 * np.sin(40 * X), "nothing to explain"),
        (0.05 * np.sin(40 * X), "stated uncertainty at least 2 times too wide"),
        (np.full(N, 3.0), "gain (+3 times its step of 1 %) explains most, and is enough"),
        (3.0 + 2.0 * np.sin(40 * X), "but none is enough"),
        (6.0 + 9.5 * (X - 0.5) + 0.08 * np.sin(40 * X), "gain and tilt together are enough"),
    ],
)
def test_a_residual_and_what_is_said_of_it(residual, conclusion):
    assert conclusion in _ranking(residual).conclusion


def test_inputs_alike_are_not_told_apart_and_move_no_farther_than_they_may():
    found = _ranking(np.full(N, 3.0), COLUMNS | {TWIN: np.ones((N, 1))})
    assert found.ranked[0].units == pytest.approx(3.0, rel=0.01)
    assert "not told apart from twin of gain" in found.conclusion
    found = _ranking(np.full(N, -14.0), {GAIN: np.ones((N, 1))})
    assert found.ranked[0].chi_square == pytest.approx(N * (4.0 / 0.1) ** 2)  # what is left of 14 steps
    assert "gain (-10 times its step of 1 %, as far as it can) explains most, but none is enough" in found.conclusion


def _three_subjects():
    """Radiances (3 x 20) of three subjects, a gain that they share and one spectrum that is off by a slope."""
    level = np.stack([1.0 + 0.3 * np.sin(k + np.linspace(0, 3, 20)) for k in range(3)])
    common = np.concatenate([np.diag(row) for row in level])
    slope = np.zeros_like(level)
    slope[1] = 0.1 * level[1] * np.linspace(-1, 1, 20)
    spectrum = attribute.Candidate("spectrum", "surface", "10 %", False)
    return common, {GAIN: 0.01 * level.reshape(-1, 1), spectrum: slope.reshape(-1, 1)}


def test_what_all_subjects_share_is_told_apart_from_what_differs():
    common, columns = _three_subjects()
    rng = np.random.default_rng(6)
    covariance = 0.005**2 * np.eye(60)
    noise = 0.005 * rng.normal(size=60)
    parts = attribute.common_and_own(4 * columns[GAIN][:, 0] + noise, covariance, common, columns)
    shared, different = (attribute.ranking(name, *parts[name]) for name in (attribute.COMMON, attribute.DIFFERENT))
    assert (shared.dof, different.dof) == (20, 40)
    assert shared.ranked[0].candidate is GAIN
    assert shared.ranked[0].units == pytest.approx(4.0, abs=0.3)
    assert different.p_value > 0.001  # false failure 1e-3: the noise alone is there
    assert GAIN not in {r.candidate for r in different.ranked}
    spectrum = next(c for c in columns if c is not GAIN)
    parts = attribute.common_and_own(3 * columns[spectrum][:, 0] + noise, covariance, common, columns)
    different = attribute.ranking(attribute.DIFFERENT, *parts[attribute.DIFFERENT])
    assert different.ranked[0].candidate is spectrum
    assert different.ranked[0].units == pytest.approx(3.0, abs=0.3)


def test_the_two_parts_hold_all_of_the_residuals_and_do_not_correlate():
    common, columns = _three_subjects()
    rng = np.random.default_rng(8)
    a = rng.normal(size=(60, 60))
    covariance, r = a @ a.T / 60 + 0.1 * np.eye(60), rng.normal(size=60)
    parts = attribute.common_and_own(r, covariance, common, columns)
    whole = r @ np.linalg.solve(covariance, r)
    assert sum(x @ np.linalg.solve(c, x) for x, c, _ in parts.values()) == pytest.approx(whole, rel=1e-9)


def test_a_what_if_changes_the_scenarios_that_it_fits():
    scenarios = [load_scenario("yellow-planks-asphalt"), load_scenario("panels")]
    target = scenarios[0].scene.targets[0].name
    item = attribute.WhatIf(name="x", question="?", scenario={f"scene.targets.{target}.gain": 3.0})
    changed = attribute.changed_scenarios(scenarios, item)
    assert changed[0].scene.targets[0].gain == 3.0
    assert changed[1] is scenarios[1]
    nowhere = attribute.WhatIf(name="y", question="?", scenario={"scene.targets.nothing.gain": 3.0})
    with pytest.raises(UsageError, match="fits no scenario"):
        attribute.changed_scenarios(scenarios, nowhere)


@pytest.mark.parametrize(
    "changes", [{}, {"observe": {"name": "b"}}, {"scenario": {"name": "b"}}], ids=["nothing", "elsewhere", "twice"]
)
def test_what_ifs_that_say_nothing_are_refused(changes):
    item = {"name": "a", "question": "?", **changes}
    with pytest.raises(ValueError, match=r"changes something|neither collection|two what-ifs"):
        attribute.AttributionOptions.model_validate({"what_ifs": [item, item]})


@pytest.mark.parametrize("k", [1, 3])
def test_gain_is_the_likelihood_ratio_of_the_normal_density(k):
    rng = np.random.default_rng(1)
    a, g = rng.normal(size=(40, 40)), rng.normal(size=(40, k))
    c = a @ a.T / 40 + 0.1 * np.eye(40)
    r = g @ rng.normal(size=k) * 4 + np.linalg.cholesky(c) @ rng.normal(size=len(c))

    def loglik(log_t2):
        return stats.multivariate_normal.logpdf(r, cov=c + np.exp(log_t2) * g @ g.T)

    best = optimize.minimize_scalar(lambda x: -loglik(x), bounds=(-6, 8), method="bounded", options={"xatol": 1e-9})
    found = attribute.explanation(attribute.Whitened(r, c), g, FREE)
    base = stats.multivariate_normal.logpdf(r, cov=c)
    assert found.gain == pytest.approx(2 * (-best.fun - base), rel=1e-6)
    assert found.tau == pytest.approx(np.exp(best.x / 2), rel=1e-3)
    wide = c + found.tau**2 * g @ g.T
    assert found.chi_square == pytest.approx(r @ np.linalg.solve(wide, r), rel=1e-8)
    np.testing.assert_allclose(found.amplitudes, found.tau**2 * g.T @ np.linalg.solve(wide, r), rtol=1e-7)


def test_the_budgeted_amplitude_with_nothing_to_gain_is_that_of_the_stated_uncertainty():
    c, g = np.eye(4), np.eye(4)[:, :1]
    r = np.array([1.0, 0.5, -0.5, 0.2])
    total = c + g @ g.T
    found = attribute.explanation(attribute.Whitened(r, total), g, STATED)
    assert found.gain == 0.0
    assert found.amplitudes[0] == pytest.approx(0.5)  # N(0, 1) prior and unit noise share a residual of 1


def test_a_direction_that_would_go_too_far_stops_there_and_the_others_go_where_they_must():
    g, r = np.eye(6)[:, :2], np.array([30.0, 3.0, 0.1, -0.2, 0.1, 0.0])
    found = attribute.explanation(attribute.Whitened(r, 0.01**2 * np.eye(6)), g, FREE, 10.0)
    assert found.limited
    np.testing.assert_allclose(found.amplitudes, [10.0, 3.0], rtol=1e-3)
    assert found.chi_square == pytest.approx((20.0 / 0.01) ** 2 + 6 * 100, rel=1e-3)
    assert not attribute.explanation(attribute.Whitened(r, 0.01**2 * np.eye(6)), g, FREE).limited


def test_refuses_what_has_no_uncertainty():
    with pytest.raises(UsageError, match="uncertainty"):
        attribute.Whitened([1.0, 2.0], np.diag([1.0, 0.0]))
    with pytest.raises(UsageError, match="finite"):
        attribute.Whitened([np.nan], [[1.0]])


@pytest.mark.parametrize("name", ["a", "z"])
def test_rounding_neither_orders_what_explains_the_same_nor_counts_as_an_effect(name):
    blocks = [
        attribute.ResidualBlock("scores", s, "cem", np.zeros(1), np.eye(1), lambda p: np.zeros(1))
        for s in ("near", "far")
    ]
    columns = {
        attribute.Candidate(name, "", "", False): np.array([[0.3], [0.0]]),
        attribute.Candidate("m", "", "", False): np.array([[0.3 * (1.0 + 4e-16)], [0.0]]),
        attribute.Candidate("far alone", "", "", False): np.array([[1e-17], [1.0]]),
    }
    _, near = attribute.rankings(attribute.Stack(tuple(blocks)), np.array([5.0, 0.0]), np.eye(2), columns, ["near"])
    assert [r.candidate.name for r in near.ranked] == sorted([name, "m"])


def test_a_polynomial_of_degree_two_is_met_exactly():
    def f(*z):
        return np.array([2.0 + 3.0 * z[0] + z[1] ** 2 + 2.0 * z[0] * z[2], 0.7])

    unit = np.eye(3)
    ends = [(f(*e), f(*-e)) for e in unit]
    alone, every = attribute.sensitivity_indices(
        f(0, 0, 0), ends, {(0, 2): f(*unit[0] + unit[2]), (0, 1): f(*unit[0] + unit[1])}
    )
    # Variances by hand: 9, 2 (of z^2), 4; what does not move has no shares.
    np.testing.assert_allclose(alone[:, 0], np.array([9, 2, 0]) / 15, atol=1e-10)
    np.testing.assert_allclose(every[:, 0], np.array([13, 2, 4]) / 15, atol=1e-10)
    assert np.isnan(every[:, 1]).all()


AXIS = SpectralAxis(np.array([500.0, 600.0, 800.0]), np.full(3, 10.0))
USUAL = yaml.safe_load((Path(__file__).parent / "usual_inputs.yaml").read_text())


@pytest.mark.parametrize("case", USUAL.values(), ids=USUAL)
def test_usual_inputs_are_those_that_a_scenario_has_and_does_not_state(case):
    shares = case.get("shares", [1.0])
    classes = [{"name": f"c{i}", "fraction": f, "spectrum": {"constant": 0.2}} for i, f in enumerate(shares)]
    scene = {"classes": classes, "targets": case.get("targets", [])}
    data = {"name": "s", "scene": scene, "processing": {"elm": "none", "detectors": []}, **case.get("more", {})}
    origins = Origins(axis=AXIS, engine=stand_in_atmosphere)
    found = {i.name for i in attribute.assumed_inputs(read(Scenario.model_validate(data), origins))}
    assert {*case["among"]} <= found
    assert not {*case["absent"]} & found
