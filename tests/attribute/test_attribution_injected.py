"""Injected errors: each does what its name says, and is refused where there is nothing of the kind."""

from __future__ import annotations

import numpy as np
import pytest
from uncertain_scene import AXIS, engine, run, scenario

from hyperval.attribute import InjectedError, NotInjectable, injected_errors, injected_prediction
from hyperval.errors import UsageError
from hyperval.model import Origins, predict
from hyperval.settings import with_settings

KEY = ("tenth", "cem", "pixel")
BY_NAME = {e.name: e for e in injected_errors()}
# In place of the scene's: an empirical line, tails, two targets, and a fill with blur.
GEOMETRY = "fill: {geometry: {side_m: 0.4, gsd_m: 1.0, psf_fwhm_pixels: 0.8}}"
GREEN = "{name: green, spectrum: {builtin: green-paint-plank}, host: grass, " + GEOMETRY + "}"
SCENE = scenario(
    **{
        "{name: grass, fraction": "{name: grass, tail_dof: 8, fraction",
        "processing:": f"    - {GREEN}\nprocessing:",
    }
)
BASE = run(SCENE)


def injected(name: str, s=SCENE):
    return injected_prediction(s, BY_NAME[name], Origins(axis=AXIS, engine=engine))[0]


def ratio(name: str, product: str = "radiance", subject: str = "panel"):
    return getattr(injected(name), product)[subject].mean / getattr(BASE, product)[subject].mean


@pytest.mark.parametrize("name", BY_NAME)
def test_each_moves_something(name):
    found = injected(name)
    moved = [
        not np.allclose(getattr(found, product)[s].mean, e.mean, rtol=1e-9, equal_nan=True)
        for product in ("radiance", "snr", "reflectance")
        for s, e in getattr(BASE, product).items()
    ]
    moved += [not np.allclose(found.roc[k].pd, c.pd, rtol=1e-9) for k, c in BASE.roc.items()]
    moved += [
        not np.allclose(found.radiance[s].pixel_covariance, e.pixel_covariance, rtol=1e-9)
        for s, e in BASE.radiance.items()
    ]
    assert any(moved)


@pytest.mark.parametrize(("name", "factor"), [("sunlight x 0.95", 0.95), ("sunlight x 1.05", 1.05)])
def test_sunlight_scales_all_radiance(name, factor):
    np.testing.assert_allclose(ratio(name), factor, rtol=1e-12)


def test_path_radiance_and_spherical_albedo_act_where_they_stand_in_3_7():
    from hyperval.atmosphere import AtmosphericState

    terms = engine(AtmosphericState.model_validate(SCENE.atmosphere.model_dump())).at_bands(AXIS)
    path = injected("path radiance x 1.1").radiance["panel"].mean - BASE.radiance["panel"].mean
    np.testing.assert_allclose(path, 0.1 * terms.path_radiance, rtol=1e-9)
    # L - L_a = G / (1 - S rho_ave): with S 1.5 times as large by (1 - S rho_ave)/(1 - 1.5 S rho_ave).
    ground = BASE.radiance["panel"].mean - terms.path_radiance
    grown = injected("spherical albedo x 1.5").radiance["panel"].mean - terms.path_radiance
    average = sum(c.fraction * run(SCENE).reflectance[c.name].mean for c in SCENE.scene.classes)
    s = terms.spherical_albedo
    np.testing.assert_allclose(grown / ground, (1 - s * average) / (1 - 1.5 * s * average), rtol=1e-8)


def test_shifts_are_those_of_the_sensor_operation():
    for name, nm in (("wavelengths + 5 nm", 5.0), ("spectral shift of 0.5 band", 0.5 * AXIS.fwhm_nm[0])):
        there = run(with_settings(SCENE, {"sensor_operation": {"wavelength_shift_nm": nm}}))
        np.testing.assert_allclose(injected(name).radiance["grass"].mean, there.radiance["grass"].mean, rtol=1e-12)


def test_a_spectrum_may_end_before_a_shifted_band(tmp_path):
    w = np.arange(400.0, AXIS.centre_nm[-2] + 9.0, 2.0)
    (tmp_path / "panel.csv").write_text("wavelength_nm,reflectance\n" + "".join(f"{x:g},0.3\n" for x in w))
    options = Origins(axis=AXIS, engine=engine, resolve=lambda name: name)
    s = with_settings(SCENE, {"scene.panels.panel.spectrum": {"file": str(tmp_path / "panel.csv")}})
    predict(s, options)  # one band at the end may lack
    with pytest.raises(UsageError, match="does not cover"):
        predict(s, options, truth={"sensor.wavelength_shift_nm": 5.0})
    found, _ = injected_prediction(s, BY_NAME["wavelengths + 5 nm"], options)
    assert np.all(found.radiance["panel"].mean[:-2] > 0.0)
    assert np.all(found.radiance["grass"].mean > 0.0)


def test_noise_and_electrons():
    np.testing.assert_allclose(ratio("noise x 1.5", "snr"), 1 / 1.5, rtol=1e-12)
    shot = injected("electrons x 1.05").noise["panel"]["shot"] / BASE.noise["panel"]["shot"]
    np.testing.assert_allclose(shot, 1 / 1.05, rtol=1e-12)


def test_spread_is_a_factor_on_the_standard_deviation_of_every_class():
    for name, factor in (("class spread x 0.8", 0.8), ("class spread x 1.25", 1.25)):
        plain = {f"scene.classes.{c.name}.gain": factor**2 for c in SCENE.scene.classes}
        there = run(with_settings(SCENE, plain))
        np.testing.assert_allclose(
            np.diag(injected(name).reflectance["grass"].pixel_covariance),
            np.diag(there.reflectance["grass"].pixel_covariance), rtol=0.02,
        )  # fmt: skip


def test_tails_left_out_are_those_of_a_scene_without():
    there = run(with_settings(SCENE, {"scene.classes.grass.tail_dof": None}))
    np.testing.assert_allclose(injected("tails left out").roc[KEY].threshold, there.roc[KEY].threshold, rtol=2e-4)


def test_class_means_and_target_spectra():
    exchanged = injected("class means exchanged").reflectance
    np.testing.assert_allclose(exchanged["grass"].mean, BASE.reflectance["asphalt"].mean, atol=1e-12)
    np.testing.assert_allclose(exchanged["asphalt"].mean, BASE.reflectance["grass"].mean, atol=1e-12)
    host, whole = BASE.reflectance["asphalt"].mean, BASE.reflectance["tenth"].mean
    target = (whole - 0.9 * host) / 0.1
    dark = injected("target spectra x 0.8").reflectance["tenth"].mean
    np.testing.assert_allclose(dark, 0.1 * 0.8 * target + 0.9 * host, atol=1e-12)
    other = injected("target spectra exchanged").reflectance["tenth"].mean
    green = run(with_settings(SCENE, {"scene.targets.plank.spectrum": {"builtin": "green-paint-plank"}}))
    np.testing.assert_allclose(other, green.reflectance["tenth"].mean, atol=1e-12)
    assert np.max(np.abs(injected("target spectra of another material").reflectance["tenth"].mean - whole)) > 0.01


def test_the_detector_still_looks_for_what_was_stated():
    for name in ("target spectra x 0.8", "target spectra exchanged"):
        assert injected(name).roc[KEY].threshold == pytest.approx(BASE.roc[KEY].threshold, rel=1e-12)


def test_a_target_covariance_by_its_fill_is_that_of_a_greater_one_at_each_fill():
    found = injected("target covariance by f, not f squared")
    # At a fill of a tenth f is ten times its square.
    there = run(with_settings(SCENE, {"scene.targets.plank.gain": 10.0}))
    expected = there.radiance["tenth"].pixel_covariance
    np.testing.assert_allclose(found.radiance["tenth"].pixel_covariance, expected, rtol=1e-9)
    np.testing.assert_allclose(found.roc[KEY].pd, there.roc[KEY].pd, rtol=1e-9)
    assert found.scores["tenth", "cem"].sd == pytest.approx(there.scores["tenth", "cem"].sd, rel=1e-9)
    np.testing.assert_allclose(found.radiance["tenth"].mean, BASE.radiance["tenth"].mean, rtol=1e-12)


def test_fill_and_blur():
    there = run(with_settings(SCENE, {"scene.targets.plank.subjects.tenth.fill.fixed": 0.08}))
    np.testing.assert_allclose(injected("fill x 0.8").roc[KEY].pd, there.roc[KEY].pd, rtol=1e-9)
    path = "scene.targets.green.fill.geometry.psf_fwhm_pixels"
    blurred = run(with_settings(SCENE, {path: 1.2}))
    found = injected("blur x 1.5").reflectance["green"].mean
    np.testing.assert_allclose(found, blurred.reflectance["green"].mean, rtol=1e-12)


def test_an_empirical_line_that_is_off_shows_in_reflectance_and_in_scores():
    gain, offset = injected("empirical line gain x 1.02"), injected("empirical line offset + 0.005")
    mean = BASE.reflectance["panel"].mean
    np.testing.assert_allclose(gain.reflectance["panel"].mean, 1.02 * mean, rtol=1e-9)
    np.testing.assert_allclose(offset.reflectance["panel"].mean, mean + 0.005, rtol=1e-9)
    np.testing.assert_allclose(gain.radiance["panel"].mean, BASE.radiance["panel"].mean, rtol=1e-12)
    assert offset.scores["tenth", "cem"].mean != pytest.approx(BASE.scores["tenth", "cem"].mean, rel=1e-6)


def test_the_budget_stays_that_of_the_scenario():
    s = with_settings(SCENE, {"uncertainty": {"solar_irradiance_relative": 0.02}})
    found = injected("noise x 1.5", s).radiance["grass"]
    np.testing.assert_allclose(found.budget["solar irradiance"], 0.02 * found.mean, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("tails left out", {"scene.classes.grass.tail_dof": None}, "no class has tails"),
        ("blur x 1.5", {"scene.targets.green.fill.geometry.psf_fwhm_pixels": 0.0}, "blur is 0"),
        ("empirical line gain x 1.02", {"processing.elm": "none"}, "no empirical line"),
        ("fill x 0.8", {"scene.targets": []}, "fill"),
        ("target spectra x 0.8", {"scene.targets": []}, "no target"),
    ],
)
def test_what_a_scenario_does_not_have_is_not_injected(name, changes, words):
    with pytest.raises(NotInjectable, match=words):
        injected(name, with_settings(SCENE, changes))


def test_without_an_atmosphere_light_is_not_injected_and_the_line_is_that_of_the_collection():
    s = scenario("")
    for name in ("sunlight x 0.95", "noise x 1.5", "spherical albedo x 1.5"):
        with pytest.raises(NotInjectable, match="no atmosphere"):
            injected(name, s)
    found = injected("empirical line gain x 1.02", s).reflectance["grass"].mean
    np.testing.assert_allclose(found, 1.02 * run(s).reflectance["grass"].mean, rtol=1e-12)


def test_an_error_of_a_path_that_leads_nowhere_names_it():
    lost = InjectedError("nothing", lambda world: {"surfaces.nobody.mean": 0.1})
    with pytest.raises(NotInjectable, match=r"surfaces\.nobody"):
        injected_prediction(SCENE, lost, Origins(axis=AXIS, engine=engine))


def test_an_input_of_the_budget_moves_from_where_it_was_injected():
    """Two values of one blur were refused, and with them every campaign that states its uncertainty."""
    stated = with_settings(SCENE, {"uncertainty": {"psf_fwhm_pixels": 0.1}})
    wide = with_settings(stated, {"scene.targets.green.fill.geometry.psf_fwhm_pixels": 1.2})
    found, there = injected("blur x 1.5", stated).roc, run(wide).roc
    key = next(k for k in there if k[0] == "green")
    for limit in ("pd_lower", "pd_upper"):
        np.testing.assert_allclose(getattr(found[key], limit), getattr(there[key], limit), rtol=1e-9)
