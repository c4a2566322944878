"""Propagation of the budget: straight lines beside draws, where they must agree and where not; numbers once wrong."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri
from stand_in_atmosphere import blue_and_haze, smooth_terms, sunlight
from uncertain_scene import ATMOSPHERE, AXIS, ORIGINS, run, scenario

from hyperval import model
from hyperval.products import background_of
from hyperval.scenario import Scenario, Uncertainty
from hyperval.settings import with_settings
from hyperval.spectra import SpectralAxis

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
        if row["key"][0] == "score mean":
            assert both.scores[row["key"][1:]].mean_error == pytest.approx(row["drawn_sd"], rel=0.185, abs=1e-12)
    np.testing.assert_array_equal(both.roc[KEY].pd_lower, run(with_method("linear")).roc[KEY].pd_lower)
    assert any("300 draws of the budget (seed 0)" in n for n in both.notes)
    assert any("engine runs" in n for n in both.notes)


@pytest.mark.parametrize("form", ["corrected", "thesis"])
def test_the_budget_that_predict_adds_up_is_that_of_a_prediction_for_every_direction(form):
    # Among them asphalt, which all others have around them: by the derivatives of its own light alone it had 8 % less.
    s = with_method(
        "linear",
        f"formulation: {form}\n"
        + SMALL.replace("plank,", "asphalt, relative: 0.05}, {subject: plank,")
        + "  sensor_gain: {relative: 0.01, correlation: random}\n  elm_panels: {relative: 0.02}\n",
    )
    stated, plain = run(s), s.model_copy(update={"uncertainty": Uncertainty()})
    total = {(p, n): np.zeros(len(AXIS)) for p in ("radiance", "snr", "reflectance") for n in getattr(stated, p)}
    for item in model.uncertain_inputs(model.read_world(s, ORIGINS)):
        for k in range(item.size):
            up, down = (run(plain, truth=item.perturbation_along(k, z)) for z in (1.0, -1.0))
            for p, n in total:
                total[p, n] += (0.5 * (getattr(up, p)[n].mean - getattr(down, p)[n].mean)) ** 2
    for (p, n), variance in total.items():
        np.testing.assert_allclose(
            getattr(stated, p)[n].standard_uncertainty, np.sqrt(variance), rtol=2e-3, atol=1e-9, err_msg=f"{p} {n}"
        )
    brighter = run(s, truth={"surfaces.[asphalt].mean": 0.5}).reflectance["asphalt"].budget["field spectrum"]
    np.testing.assert_allclose(brighter, 0.05 * 0.5, rtol=0.1)  # a part of what is truly there


@pytest.mark.slow
def test_where_the_ways_differ_the_draws_give_the_interval_of_pd():
    # A class that may be twice as large: P_D has a tail that no straight line knows.
    text = SMALL.replace("aot550: 0.02", "fractions: [{subject: asphalt, absolute: 0.1}]")
    p, linear = run(with_method("both", text)), run(with_method("linear", text))
    assert any("P_D intervals from the draws" in n for n in p.notes)
    at = int(np.argmin(np.abs(p.roc[KEY].pfa - 1e-2)))
    assert p.roc[KEY].pd_lower[at] != linear.roc[KEY].pd_lower[at]
    assert np.all(p.roc[KEY].pd_lower <= p.roc[KEY].pd)
    assert np.all(p.roc[KEY].pd_upper >= p.roc[KEY].pd)


def test_the_emulator_is_the_engine_at_its_nodes_and_near_it_between():
    world = model.read_world(
        scenario(ATMOSPHERE + "uncertainty: {aot550: 0.05, water_vapour_g_cm2: 0.5, solar_zenith_deg: 2}\n"), ORIGINS
    )
    inputs = model.uncertain_inputs(world)
    there, (runs, greatest, median) = model.interpolated_world(world, inputs)
    assert runs == 8  # stated, two for each of three fields, one check
    assert 0.0 < median <= greatest < 0.01
    for item in inputs:
        for z in (-(3.0**0.5), 0.0, 3.0**0.5, 1.0):
            found, exact = (w.stated.atmosphere(item.perturbation_along(0, z), 1) for w in (there, world))
            np.testing.assert_allclose(found.direct, exact.direct, rtol=2e-3 if z == 1.0 else 1e-9)
            if z != 1.0:
                np.testing.assert_allclose(found.path_radiance, exact.path_radiance, rtol=1e-9)


def test_area_of_a_curve_and_tolerance_of_a_limit():
    p = run(scenario(ATMOSPHERE).model_copy(update={"uncertainty": Uncertainty()}))
    curve = p.roc[KEY]
    # P(score of a target above one of the background), from the tabulated densities of both.
    target, ground = p.scores["tenth", "cem"], p.scores["tenth background", "cem"]
    below = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(ground.grid) * (ground.density[1:] + ground.density[:-1]))])
    share = np.interp(target.grid, ground.grid, below, left=0.0, right=1.0)
    expected = np.trapezoid(share * target.density, target.grid)
    assert model.curve_area(curve, model.WHOLE) == pytest.approx(expected, abs=2e-3)
    assert model.product_values(p)["AUC", *KEY][0] == model.curve_area(curve, model.WHOLE)
    # u = 0.02: one digit, half a unit of it is 0.005; with infinitely many draws nothing is added.
    np.testing.assert_allclose(model.limit_tolerance(np.array([0.02, 0.9]), 10**12), [0.005, 0.05], rtol=1e-4)
    # Of 10,000 uniform draws the 250th is a beta number, and so is the probability of a normal one.
    error = np.std(stats.norm.isf(stats.beta(250, 9751).ppf((np.arange(4000) + 0.5) / 4000)))
    assert model.limit_tolerance(np.array([0.031]), 10_000) == pytest.approx([0.005 + 2.0 * 0.031 * error], rel=1e-3)


# Numbers that were wrong, by definitions and by truths that are moved one at a time, on thirty bands.
THIRTY = SpectralAxis(np.linspace(450.0, 2250.0, 30), np.full(30, 20.0))
SUN = sunlight()
BANDS = model.Origins(
    axis=THIRTY, engine=lambda s: smooth_terms(*blue_and_haze(s.aot550 or 0.2), SUN, 0.7 * SUN / np.pi)
)
CHANGES = {
    "fraction: 0.7": "fraction: 0.4",
    "fraction: 0.3": "fraction: 0.6",
    "{name: loose, fill: {mean: 0.15, sd: 0.05}}": "{name: full, fill: {fixed: 1.0}}",
    "drop_bad: false}": "drop_bad: false}, false_alarm_grid: {lowest: 1.0e-5, per_decade: 4}",
}


def coarse(extra: str = "", **replaced: str) -> Scenario:
    """The scene with more asphalt at few false-alarm rates."""
    return scenario(ATMOSPHERE + extra, **CHANGES, **replaced)


@pytest.mark.parametrize("form", ["corrected", "thesis"])
@pytest.mark.parametrize("elm", ["none", "{reflectances: [0.1, 0.6]}"])
def test_correlation_filter_is_that_of_the_correlation_matrix(elm, form):
    """w = R^-1 t / (t R^-1 t), R = Sigma + mu mu^T of what the line leaves (Harsanyi, 1993)."""
    s = coarse(**{"[cem]": f"[cem-correlation], elm: {elm}", "small": f"small\nformulation: {form}"})
    p = model.predict(s, BANDS)
    seen = p.radiance if elm == "none" else p.reflectance
    classes = [(c.fraction, seen[c.name]) for c in s.scene.classes]
    mean = sum(f * e.mean for f, e in classes)
    second = sum(f * (e.pixel_covariance + np.outer(e.mean, e.mean)) for f, e in classes)
    target = seen["full"].mean
    w = np.linalg.solve(second, target)
    w /= target @ w
    key = background_of("tenth"), "cem-correlation"
    assert p.scores[key].mean == pytest.approx(w @ mean, rel=1e-6)
    assert p.scores[key].sd == pytest.approx(np.sqrt(w @ second @ w - (w @ mean) ** 2), rel=1e-6)


ROUGH = SpectralAxis(np.linspace(450.0, 1240.0, 80), np.full(80, 10.0))
GRASS, NOISE = "surfaces.[grass].mean", "sensor.noise"


@pytest.mark.parametrize(
    ("entry", "path", "step", "axis", "lost"),
    [
        ("field_spectra: [{subject: grass, relative: 0.05, correlation: random}]", GRASS, 0.05, THIRTY, {}),
        ("noise: {relative: 0.3, correlation: random}", NOISE, 0.3, THIRTY, {}),
        (
            "field_spectra: [{subject: grass, relative: 0.001, correlation_nm: 10}]", GRASS, 0.001, ROUGH,
            {8: 0.99, 24: 0.7, 40: 0.3},
        ),
    ],
    ids=["random, of a class", "random, of noise", "10 nm, of a class"],
)  # fmt: skip
def test_interval_of_detection_follows_every_direction(entry, path, step, axis, lost):
    """Of independent bands, and of an error that is as rough as them: 8 directions of it hold 0.1 % of the variance.

    ``lost`` : greatest directions -> least part of the variance that they do not hold
    """
    s = coarse(f"uncertainty: {{{entry}}}\n", **{"[cem]": "[cem], elm: none"})
    origins = replace(BANDS, axis=axis)
    curve = model.predict(s, origins).roc["tenth", "cem", "pixel"]
    stated = model.value_at(model.read_world(s, origins), path)[0]
    inner, nominal = np.abs(ndtri(curve.pd)) < 2.0, np.broadcast_to(stated, len(axis))
    sd = step * nominal
    ends = np.concatenate([nominal + np.diag(sd), nominal - np.diag(sd)])
    moved = model.predictions(s, ({path: end} for end in ends), origins, object_curves=False)
    up, down = np.split(np.array([ndtri(p.roc["tenth", "cem", "pixel"].pd[inner]) for p in moved]), 2)
    gradient = 0.5 * (up - down) / sd[:, None]
    gap = (axis.centre_nm[:, None] - axis.centre_nm) / 10.0  # THIRTY has bands so far apart that they are independent
    covariance = np.exp(-0.5 * gap**2) * np.outer(sd, sd)
    variance = np.einsum("bk,bc,ck->k", gradient, covariance, gradient)
    values, vectors = np.linalg.eigh(covariance)
    along = values[::-1, None] * (vectors[:, ::-1].T @ gradient) ** 2
    for count, part in lost.items():
        assert np.all(along[count:].sum(axis=0) > part * variance)
    width = (ndtri(curve.pd_upper) - ndtri(curve.pd_lower))[inner] / (2.0 * 1.959964)
    assert inner.sum() > 4
    # 2,048 draws of the curves, whose even part belongs to the interval too.
    np.testing.assert_allclose(width, np.sqrt(variance), rtol=0.04)


@pytest.mark.parametrize(
    ("relative", "says"), [(0.01, None), (0.06, "shift the mean of P_D"), (0.3, "from 400 draws of the budget")]
)
def test_a_prediction_says_where_errors_shift_detection_by_much_of_their_spread(relative, says):
    s = coarse(f"uncertainty: {{field_spectra: [{{subject: grass, relative: {relative}, correlation: random}}]}}\n")
    notes = [note for note in model.predict(s, BANDS).notes if "shift the mean" in note]
    assert [says in note for note in notes] == ([] if says is None else [True])
    drawn = with_settings(s, {"uncertainty.method": "both", "uncertainty.samples": 40})
    assert not any("draw the budget for more" in note for note in model.predict(drawn, BANDS).notes)


@pytest.mark.slow
def test_an_interval_whose_directions_do_not_add_up_is_that_of_draws():
    """Even parts of 80 directions, each moved alone, add up to several times what all do at once."""
    entry = "field_spectra: [{{subject: grass, relative: 0.05, correlation_nm: 10}}], method: {}"
    by = {
        method: model.predict(coarse(f"uncertainty: {{{entry.format(method)}}}\n"), replace(BANDS, axis=ROUGH)).roc[KEY]
        for method in ("linear", "monte-carlo")
    }
    for end in ("pd_lower", "pd_upper"):
        np.testing.assert_array_equal(getattr(by["linear"], end), getattr(by["monte-carlo"], end))


def test_an_error_of_the_target_moves_ace_as_far_as_errors_of_its_bands_do():
    """ACE follows the direction that its filter looks along; the bands moved one at a time are the other route."""
    axis = SpectralAxis(np.linspace(450.0, 2250.0, 12), np.full(12, 20.0))
    s = coarse(
        "uncertainty: {field_spectra: [{subject: plank, relative: 0.1, correlation: random}]}\n",
        **{"[cem]": "[ace], samples: 400, elm: none"},
    )
    origins, key = replace(BANDS, axis=axis), ("tenth", "ace", "pixel")
    curve = model.predict(s, origins, object_curves=False).roc[key]
    inner, path = np.abs(ndtri(curve.pd)) < 1.0, "surfaces.[plank].mean"
    stated = model.value_at(model.read_world(s, origins), path)[0]
    moved = [{path: stated + sign * np.diag(0.1 * stated)[k]} for sign in (1, -1) for k in range(len(axis))]
    z = np.array([ndtri(p.roc[key].pd[inner]) for p in model.predictions(s, moved, origins, object_curves=False)])
    up, down = np.split(z, 2)
    width = (ndtri(curve.pd_upper) - ndtri(curve.pd_lower))[inner] / (2.0 * 1.959964)
    # The interval holds what is even in the errors too; along the weights of another scale it would be 0.44 of this.
    np.testing.assert_allclose(width / np.sqrt(((0.5 * (up - down)) ** 2).sum(axis=0)), 1.1, atol=0.2)
