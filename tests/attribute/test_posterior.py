"""From a ranking and what-ifs to rows that a reader understands."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats

from hyperval import attribute
from hyperval.errors import UsageError
from hyperval.model import Origins, read_world
from hyperval.scenario import Scenario, load_scenario
from hyperval.spectra import SpectralAxis
from small_campaign import stand_in_atmosphere

N = 50
X = np.linspace(0.0, 1.0, N)
GAIN = attribute.Candidate("gain", "sensor", "1 %", False, sizes=(-20.0, 25.0))
TILT = attribute.Candidate("tilt", "sensor", "1 %", True)
COLUMNS = {GAIN: np.outer(np.ones(N), GAIN.sizes), TILT: (X - 0.5)[:, None]}
WIDE = np.transpose([np.interp(X, np.linspace(0, 1, 9), one) for one in np.eye(9)])
WAVE = 0.1 * np.sin(40 * X)


def _posterior(residual, columns=COLUMNS, covariance=None):
    covariance = 0.1**2 * np.eye(N) if covariance is None else covariance
    return attribute.Residuals(residual, covariance, columns, WIDE).posterior("all")


@pytest.mark.parametrize(
    ("residual", "conclusion"),
    [
        (WAVE, "nothing to explain"),
        (0.5 * WAVE, "stated uncertainty at least 2 times too wide"),
        (3.0 + WAVE, "check the gain (x 1.03 explains 100 % of the difference); sufficient"),
        (6.0 + 9.5 * (X - 0.5) + WAVE, "then the tilt (+9.5 times the stated uncertainty); together sufficient"),
        (3.0 + 20 * WAVE, "not sufficient: the remainder has none of the causes"),
        (10.0 * np.sin(9.0 * X) * np.exp(-3.0 * X) + WAVE, "none of the causes tried"),
    ],
)
def test_a_residual_and_what_is_said_of_it(residual, conclusion):
    found = _posterior(residual)
    assert conclusion in found.conclusion
    assert ("sufficient" in conclusion and "not" not in conclusion) == found.is_sufficient


def test_a_noise_that_is_wrong_is_named_where_the_sum_of_all_residuals_passes():
    """A cause of one direction, far above chance, hides in a sum of two thousand that is well within its own."""
    rng, n = np.random.default_rng(3), 2000
    electrons = np.where(np.arange(n) < 100, 0.2, 0.0)
    cause = attribute.Candidate("electrons", "sensor", "5 %", False, sizes=(-9.0, 9.0))
    residual = 0.93 * rng.normal(size=n) + 4.0 * electrons
    columns = {cause: np.outer(electrons, cause.sizes)}
    found = attribute.Residuals(residual, np.eye(n), columns, np.zeros((n, 1)) + 0.1).posterior("all")
    assert found.p_value > 0.05
    assert found.first_cause == "electrons"


def test_what_befalls_all_subjects_comes_before_what_befalls_one():
    """Of two causes together; not where the shared one explains next to nothing."""
    one = attribute.Candidate("region", "scene", "0.01 of the area", False, sizes=(-50.0, 50.0))
    columns = {GAIN: COLUMNS[GAIN], one: np.outer(np.where(X > 0.9, 1.0, 0.0), one.sizes)}
    for gain, first in ((2.0, ["gain", "region"]), (0.1, ["region", "gain"])):
        found = _posterior(gain + 9.0 * (X > 0.9) + WAVE, columns)
        assert [c.name for c in found.best.causes] == first


def test_a_change_is_not_bounded_by_what_is_stated():
    bounded, free = (_posterior(30.0 * (X - 0.5), {replace(TILT, unbounded=u): COLUMNS[TILT]}) for u in (False, True))
    assert bounded.fits[0].limited
    assert (free.first_cause, free.fits[0].units) == ("tilt", pytest.approx(30.0, rel=0.01))


def test_evidence_is_the_likelihood_averaged_over_the_prior():
    """Of sizes by quadrature on a grid of its own, of directions by the normal density with each spread."""
    residual = 0.12 * np.ones(N) + WAVE
    size = np.linspace(*GAIN.size_limits, 400_001)
    prior = 1.0 / (1.0 + (size / 2.0) ** 2)
    logs = size * (100.0 * residual.sum()) - 0.5 * size**2 * 100.0 * N
    expected = np.log(np.trapezoid(np.exp(logs) * prior, size) / np.trapezoid(prior, size))
    found = {f.name: f for f in _posterior(residual).fits}
    assert found["gain"].evidence == pytest.approx(expected, abs=0.02)
    tau, c, g = np.geomspace(0.02, 10.0, 41), 0.01 * np.eye(N), np.outer(X - 0.5, X - 0.5)
    each = [stats.multivariate_normal.logpdf(residual, cov=c + t**2 * g) for t in (0.0, *tau)]
    expected = np.log(np.average(np.exp(np.array(each[1:]) - each[0]), weights=tau / (4.0 + tau**2)))
    assert found["tilt"].evidence == pytest.approx(expected, rel=1e-6)


def test_worlds_that_hold_nothing_are_rarely_blamed_and_what_is_large_is_named():
    """Rates of drawn worlds: of nothing 5 % are blamed at most, of causes from half to five times the least seen."""
    rng = np.random.default_rng(11)
    prior = attribute.CausePrior({c: g / 0.1 for c, g in COLUMNS.items()}, WIDE / 0.1)
    blamed = [prior.posterior("", rng.normal(size=N)).first_cause != attribute.NOTHING for _ in range(200)]
    assert np.mean(blamed) < 0.05
    drawn = [(kind, found.first_cause) for kind, found in prior.simulate(rng, 60)]
    assert np.mean([kind == first for kind, first in drawn if first != attribute.NOTHING]) > 0.8
    assert np.mean([first == kind for kind, first in drawn if kind == attribute.NOTHING]) > 0.9
    faint = attribute.CausePrior({TILT: 0.05 * COLUMNS[TILT]}, WIDE)  # within its bounds it cannot be seen
    assert {kind for kind, _ in faint.simulate(rng, 3)} == {attribute.NONE, attribute.NOTHING}


def _three_subjects():
    """Radiances (3 x 20) of three subjects, a gain that they share and one spectrum that is off by a slope."""
    level = np.stack([1.0 + 0.3 * np.sin(k + np.linspace(0, 3, 20)) for k in range(3)])
    common = np.concatenate([np.diag(row) for row in level])
    slope = np.zeros_like(level)
    slope[1] = 0.1 * level[1] * np.linspace(-1, 1, 20)
    spectrum = attribute.Candidate("spectrum", "surface", "10 %", False)
    return common, {TILT: 0.01 * level.reshape(-1, 1), spectrum: slope.reshape(-1, 1)}


def test_what_all_subjects_share_is_told_apart_from_what_differs():
    common, columns = _three_subjects()
    rng = np.random.default_rng(6)
    covariance, wide = 0.005**2 * np.eye(60), 0.1 * np.eye(60)
    noise = 0.005 * rng.normal(size=60)
    for candidate, group in zip(columns, (attribute.COMMON, attribute.DIFFERENT), strict=True):
        residual = 3 * columns[candidate][:, 0] + noise
        parts = attribute.common_and_individual(common, attribute.Residuals(residual, covariance, columns, wide))
        found = {name: data.posterior(name) for name, data in parts.items()}
        assert TILT not in parts[attribute.DIFFERENT].columns  # what all share
        assert [found[name].dof for name in (attribute.COMMON, attribute.DIFFERENT)] == [20, 40]
        assert found[group].first_cause == candidate.name
        assert found[group].fits[0].units == pytest.approx(3.0, abs=0.3)


def test_the_two_parts_hold_all_of_the_residuals_and_do_not_correlate():
    common, columns = _three_subjects()
    rng = np.random.default_rng(8)
    a = rng.normal(size=(60, 60))
    covariance, r = a @ a.T / 60 + 0.1 * np.eye(60), rng.normal(size=60)
    parts = attribute.common_and_individual(common, attribute.Residuals(r, covariance, columns, np.eye(60)))
    whole = sum(x @ np.linalg.solve(c, x) for x, c, *_ in parts.values())
    assert whole == pytest.approx(r @ np.linalg.solve(covariance, r), rel=1e-9)


def test_a_what_if_changes_the_scenarios_that_it_fits():
    scenarios = [load_scenario("yellow-planks-asphalt"), load_scenario("panels")]
    target = scenarios[0].scene.targets[0].name
    item = attribute.WhatIf(name="x", question="?", scenario={f"scene.targets.{target}.gain": 3.0})
    changed = attribute.changed_scenarios(scenarios, item)
    assert changed[0].scene.targets[0].gain == 3.0
    assert changed[1] is scenarios[1]
    with pytest.raises(UsageError, match="fits no scenario"):
        attribute.changed_scenarios(scenarios, item.model_copy(update={"scenario": {"scene.targets.none.gain": 3.0}}))


@pytest.mark.parametrize(
    "changes", [{}, {"observe": {"name": "b"}}, {"scenario": {"name": "b"}}], ids=["nothing", "elsewhere", "twice"]
)
def test_what_ifs_that_say_nothing_are_refused(changes):
    item = {"name": "a", "question": "?", **changes}
    with pytest.raises(ValueError, match=r"changes something|neither collection|two what-ifs"):
        attribute.AttributionOptions.model_validate({"what_ifs": [item, item]})


def test_refuses_what_has_no_uncertainty():
    with pytest.raises(UsageError, match="uncertainty"):
        attribute.Whitened([1.0, 2.0], np.diag([1.0, 0.0]))
    with pytest.raises(UsageError, match="finite"):
        attribute.Whitened([np.nan], [[1.0]])


@pytest.mark.parametrize("name", ["a", "z"])
def test_rounding_neither_orders_what_explains_the_same_nor_counts_as_an_effect(name):
    zero = np.zeros(1), np.eye(1), lambda p: np.zeros(1)
    stack = attribute.Stack(tuple(attribute.ResidualBlock("scores", s, "cem", *zero) for s in ("near", "far")))
    columns = {
        attribute.Candidate(name, "", "", False): np.array([[0.3], [0.0]]),
        attribute.Candidate("m", "", "", False): np.array([[0.3 * (1.0 + 4e-16)], [0.0]]),
        attribute.Candidate("far alone", "", "", False): np.array([[1e-17], [1.0]]),
    }
    _, near = attribute.Residuals(np.array([5.0, 0.0]), np.eye(2), columns, 0.1 * np.eye(2)).posteriors(stack, ["near"])
    assert [f.name for f in near.fits] == sorted([name, "m"])


AXIS = SpectralAxis(np.array([500.0, 600.0, 800.0]), np.full(3, 10.0))
USUAL = yaml.safe_load((Path(__file__).parent / "usual_inputs.yaml").read_text())


@pytest.mark.parametrize("case", USUAL.values(), ids=USUAL)
def test_usual_inputs_are_those_that_a_scenario_has_and_does_not_state(case):
    shares = case.get("shares", [1.0])
    classes = [{"name": f"c{i}", "fraction": f, "spectrum": {"constant": 0.2}} for i, f in enumerate(shares)]
    scene = {"classes": classes, "targets": case.get("targets", [])}
    data = {"name": "s", "scene": scene, "processing": {"elm": "none", "detectors": []}, **case.get("more", {})}
    world = read_world(Scenario.model_validate(data), Origins(axis=AXIS, engine=stand_in_atmosphere))
    further = attribute.further_candidates([world])
    found = {i.name for i in attribute.every_input([world], further) if not i.budgeted}
    assert {*case["among"]} <= found
    assert not {*case["absent"]} & found
    level = next(c for c in further if c.name == "level of the spectrum of c0")
    np.testing.assert_allclose(level.truths(0, -4.0)[0]["surfaces.[c0].mean"], 0.16)  # 4 steps of 5 % less than 0.2


def test_files_of_two_scenarios_in_each_others_place_are_a_cause(tmp_path):
    worlds = []
    for name, level in (("a", 0.1), ("b", 0.3)):
        (tmp_path / name).write_text(f"400 {level}\n900 {level}\n")
        spectrum = {"file": str(tmp_path / name), "wavelength_unit": "nm", "reflectance_unit": "fraction"}
        scene = {"classes": [{"name": name, "fraction": 1.0, "spectrum": spectrum}]}
        data = {"name": name, "scene": scene, "processing": {"elm": "none", "detectors": []}}
        worlds.append(read_world(Scenario.model_validate(data), Origins(axis=AXIS, engine=stand_in_atmosphere)))
    entry = next(c for c in attribute.rarer_candidates(worlds) if c.name == "entry of a surface")
    (exchanged,) = [entry.truths(0, i) for i, label in enumerate(entry.labels) if "exchanged" in label]
    assert [{path: mean.tolist() for path, mean in truth.items()} for truth in exchanged] == [
        {"surfaces.[a].mean": pytest.approx([0.3] * 3)}, {"surfaces.[b].mean": pytest.approx([0.1] * 3)}
    ]  # fmt: skip
