"""From a ranking and what-ifs to rows that a reader understands."""

import numpy as np
import pytest

from hyperval.errors import UsageError
from hyperval.scenario import load_scenario
from hyperval.uncertainty.attribution.ranking import (
    COMMON,
    DIFFERENT,
    Candidate,
    budget_covariance,
    common_and_own,
    ranking,
)
from hyperval.uncertainty.attribution.run import changed_scenarios
from hyperval.uncertainty.attribution.schema import AttributionOptions, WhatIf

N = 50
X = np.linspace(0.0, 1.0, N)
GAIN = Candidate("gain", "sensor", "1 %", False)
TILT = Candidate("tilt", "sensor", "1 %", True)
TWIN = Candidate("twin of gain", "sensor", "1 %", False)
COLUMNS = {GAIN: np.ones((N, 1)), TILT: (X - 0.5)[:, None]}


def _ranking(residual, columns=None):
    columns = columns or COLUMNS
    covariance = 0.1**2 * np.eye(N) + budget_covariance(columns, N)
    return ranking("all", residual, covariance, columns)


def test_a_small_residual_needs_no_reason():
    found = _ranking(0.1 * np.sin(40 * X))
    assert found.p_value > 0.05
    assert found.conclusion.startswith("nothing to explain")


def test_a_residual_far_below_its_uncertainty_says_so():
    found = _ranking(0.05 * np.sin(40 * X))
    assert found.too_wide
    assert found.conclusion.startswith("stated uncertainty at least 2 times too wide")


def test_the_reason_and_its_size_are_told():
    found = _ranking(np.full(N, 3.0))
    assert found.ranked[0].candidate is GAIN
    assert found.ranked[0].units == pytest.approx(3.0, rel=0.01)
    assert "gain (+3 times its step of 1 %) explains most, and is enough" in found.conclusion


def test_two_reasons_are_found_one_after_the_other():
    found = _ranking(6.0 + 9.5 * (X - 0.5) + 0.08 * np.sin(40 * X))
    assert [r.candidate.name for r in found.together] == ["gain", "tilt"]
    assert found.p_value < 1e-6
    assert found.together[-1].p_value > 0.05
    assert "gain and tilt together are enough" in found.conclusion


def test_it_is_said_when_none_is_enough():
    found = _ranking(3.0 + 2.0 * np.sin(40 * X))
    assert "none is enough" in found.conclusion


def test_inputs_alike_are_not_told_apart():
    found = _ranking(np.full(N, 3.0), COLUMNS | {TWIN: np.ones((N, 1))})
    assert "not told apart from twin of gain" in found.conclusion


def test_an_input_cannot_move_farther_than_it_may():
    near = Candidate("gain", "sensor", "1 %", False)
    found = _ranking(np.full(N, -14.0), {near: np.ones((N, 1))})
    assert found.ranked[0].units == pytest.approx(-10.0)
    assert found.ranked[0].chi_square == pytest.approx(N * (4.0 / 0.1) ** 2)  # what is left of 14 steps
    assert "gain (-10 times its step of 1 %, as far as it can) explains most, but none is enough" in found.conclusion


def _three_subjects():
    """Radiances (3 x 20) of three subjects, a gain that they share and one spectrum that is off by a slope."""
    level = np.stack([1.0 + 0.3 * np.sin(k + np.linspace(0, 3, 20)) for k in range(3)])
    common = np.concatenate([np.diag(row) for row in level])
    slope = np.zeros_like(level)
    slope[1] = 0.1 * level[1] * np.linspace(-1, 1, 20)
    spectrum = Candidate("spectrum", "surface", "10 %", False)
    return common, {GAIN: 0.01 * level.reshape(-1, 1), spectrum: slope.reshape(-1, 1)}


def test_what_all_subjects_share_is_told_apart_from_what_differs():
    common, columns = _three_subjects()
    rng = np.random.default_rng(6)
    covariance = 0.005**2 * np.eye(60)
    noise = 0.005 * rng.normal(size=60)
    parts = common_and_own(4 * columns[GAIN][:, 0] + noise, covariance, common, columns)
    shared, different = (ranking(name, *parts[name]) for name in (COMMON, DIFFERENT))
    assert (shared.dof, different.dof) == (20, 40)
    assert shared.ranked[0].candidate is GAIN
    assert shared.ranked[0].units == pytest.approx(4.0, abs=0.3)
    assert different.p_value > 0.001  # false failure 1e-3: the noise alone is there
    assert GAIN not in {r.candidate for r in different.ranked}
    spectrum = next(c for c in columns if c is not GAIN)
    parts = common_and_own(3 * columns[spectrum][:, 0] + noise, covariance, common, columns)
    different = ranking(DIFFERENT, *parts[DIFFERENT])
    assert different.ranked[0].candidate is spectrum
    assert different.ranked[0].units == pytest.approx(3.0, abs=0.3)


def test_the_two_parts_hold_all_of_the_residuals_and_do_not_correlate():
    common, columns = _three_subjects()
    rng = np.random.default_rng(8)
    a = rng.normal(size=(60, 60))
    covariance, r = a @ a.T / 60 + 0.1 * np.eye(60), rng.normal(size=60)
    parts = common_and_own(r, covariance, common, columns)
    whole = r @ np.linalg.solve(covariance, r)
    assert sum(x @ np.linalg.solve(c, x) for x, c, _ in parts.values()) == pytest.approx(whole, rel=1e-9)


def test_a_what_if_changes_the_scenarios_that_it_fits():
    scenarios = [load_scenario("yellow-planks-asphalt"), load_scenario("panels")]
    target = scenarios[0].scene.targets[0].name
    item = WhatIf(name="x", question="?", scenario={f"scene.targets.{target}.gain": 3.0})
    changed = changed_scenarios(scenarios, item)
    assert changed[0].scene.targets[0].gain == 3.0
    assert changed[1] is scenarios[1]
    nowhere = WhatIf(name="y", question="?", scenario={"scene.targets.nothing.gain": 3.0})
    with pytest.raises(UsageError, match="fits no scenario"):
        changed_scenarios(scenarios, nowhere)


@pytest.mark.parametrize(
    "data",
    [
        {"what_ifs": [{"name": "a", "question": "?"}]},
        {"what_ifs": [{"name": "a", "question": "?", "observe": {"name": "b"}}]},
        {"what_ifs": [{"name": "a", "question": "?", "scenario": {"name": "b"}}] * 2},
    ],
)
def test_what_ifs_that_say_nothing_are_refused(data):
    with pytest.raises(ValueError, match=r"changes something|neither collection|two what-ifs"):
        AttributionOptions.model_validate(data)
