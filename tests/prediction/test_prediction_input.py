"""Inputs by their dotted paths: what stands there, what truth has another value, and what leads nowhere."""

from __future__ import annotations

import numpy as np
import pytest
from uncertain_scene import ATMOSPHERE, AXIS, ORIGINS, run, scenario

from hyperval.errors import UsageError
from hyperval.model import Origins, drawn_truths, inputs_of, number_input, read, spectral_input, value_at
from hyperval.scenario import RelativeUncertainty
from hyperval.settings import with_settings
from hyperval.uncertainty.attribution.ranking import assumed_inputs

B = len(AXIS)
SCENE = scenario()
WORLD = read(SCENE, ORIGINS)
KEY = ("tenth", "cem", "pixel")


@pytest.mark.parametrize(
    ("path", "nominal"),
    [
        ("atmosphere.aot550", 0.2),
        ("atmosphere.solar_zenith_deg", 30.0),
        ("light.irradiance", 1.0),
        ("sensor.gain", 1.0),
        ("sensor.offset", 0.0),
        ("line.dark", 1.0),
        ("fraction.grass", 0.7),
        ("fill.tenth", 0.1),
        ("surfaces.plank.spread", 1.0),
        ("surfaces.grass.tail_dof", np.inf),
        ("scene.targets.plank.subjects.tenth.fill.fixed", 0.1),
    ],
)
def test_what_stands_at_a_path_and_that_nothing_moves_where_it_stays(path, nominal):
    at = value_at(WORLD, path)[0]
    np.testing.assert_allclose(np.ravel(at), np.ravel(nominal))
    if np.all(np.isfinite(at)):
        same = run(SCENE, truth={path: at})
        np.testing.assert_allclose(same.roc[KEY].pd, run(SCENE).roc[KEY].pd, rtol=1e-9)


@pytest.mark.parametrize(
    ("path", "value", "setting"),
    [
        ("atmosphere.aot550", 0.3, {"atmosphere.aot550": 0.3}),
        ("atmosphere.solar_zenith_deg", 35.0, {"atmosphere.solar_zenith_deg": 35.0}),
        ("fraction.grass", 0.6, {"scene.classes.grass.fraction": 0.6, "scene.classes.asphalt.fraction": 0.4}),
        ("fill.tenth", 0.12, {"scene.targets.plank.subjects.tenth.fill.fixed": 0.12}),
        ("surfaces.grass.tail_dof", 7.0, {"scene.classes.grass.tail_dof": 7.0}),
        ("processing.seed", 3.0, {"processing.seed": 3}),
    ],
)
def test_a_value_at_a_path_is_the_setting_of_the_scenario(path, value, setting):
    found = run(SCENE, truth={path: value})
    there = run(with_settings(SCENE, setting))
    np.testing.assert_allclose(found.roc[KEY].pd, there.roc[KEY].pd, rtol=1e-9)
    np.testing.assert_allclose(found.radiance["grass"].mean, there.radiance["grass"].mean, rtol=1e-12)


def test_numbers_stop_at_the_ends_of_their_range_and_reflectance_at_nothing():
    def far_below(path: str):
        item = number_input(WORLD, "x", "scene", path, 1.0)
        return item.moved(-1e6)[path]

    assert far_below("atmosphere.aot550") == 0.0
    assert far_below("sensor.noise") == pytest.approx(1e-3)
    np.testing.assert_array_equal(far_below("surfaces.asphalt.mean"), np.zeros(B))


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("surfaces.nobody.mean", "no such surface"),
        ("surfaces.plank.tail_dof", "no such class"),
        ("fraction.plank", "no such class"),
        ("fill.nobody", "fill.nobody"),
        ("blur", "geometry"),
        ("atmosphere.view", "no 'view'"),
        ("nothing.at.all", "no 'nothing'"),
    ],
)
def test_a_path_that_leads_nowhere_is_refused(path, words):
    with pytest.raises(UsageError, match=words):
        value_at(WORLD, path)


def test_a_path_that_is_nearly_one_is_told_which():
    with pytest.raises(UsageError, match=r"did you mean line\.dark"):
        value_at(WORLD, "line.darker")


def test_light_needs_an_atmosphere():
    with pytest.raises(UsageError, match="no atmosphere"):
        value_at(read(scenario(""), Origins(axis=AXIS)), "light.irradiance")


def test_a_factor_on_all_light_and_one_over_wavelength_have_the_spread_that_is_stated():
    item = number_input(WORLD, "light", "atmosphere", "light.irradiance", 0.3)
    draws = np.array([t["light.irradiance"] for t in drawn_truths([item], 4000, 2)])
    assert draws.std() == pytest.approx(0.3, rel=0.06)  # 4,000 draws: five standard errors
    form = RelativeUncertainty.model_validate({"relative": 0.02, "correlation_nm": 300})
    wide = spectral_input(WORLD, "gain", "sensor", "sensor.gain", 0.02, form)
    total = sum((wide.direction(k, 1.0)["sensor.gain"] - 1.0) ** 2 for k in range(wide.size))
    np.testing.assert_allclose(np.sqrt(total), 0.02, rtol=1e-5)
    assert wide.size > 1


def test_one_at_a_time_goes_up_and_down_along_the_leading_directions():
    form = RelativeUncertainty.model_validate({"relative": 0.02, "correlation": "random"})
    wide = spectral_input(WORLD, "gain", "sensor", "sensor.gain", 0.02, form)
    assert wide.size == B
    up, down = (wide.direction(1, z)["sensor.gain"] for z in (1.0, -1.0))
    np.testing.assert_allclose(up + down, 2.0)
    assert np.flatnonzero(up != 1.0).tolist() == [1]


def test_what_is_stated_is_not_assumed_again_and_every_class_mean_is_a_candidate():
    text = ATMOSPHERE + "uncertainty: {noise: {relative: 0.1}, fractions: [{subject: grass, absolute: 0.1}]}\n"
    world = read(scenario(text), ORIGINS)
    assumed = {i.path for i in assumed_inputs(world)}
    assert not assumed & {i.path for i in inputs_of(world)}
    assert {"sensor.gain", "surfaces.[grass].mean", "surfaces.[panel].mean"} <= assumed
    assert "surfaces.[plank].mean" not in assumed
    assert all(i.source == "usual" for i in assumed_inputs(world))
