"""Injected errors: each does what its name says, and is refused where there is nothing of the kind."""

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
GREEN = "{name: green, spectrum: {builtin: green-paint-plank}, host: grass, "
GREEN += "fill: {geometry: {side_m: 0.4, gsd_m: 1.0, psf_fwhm_pixels: 0.8}}}"
SCENE = scenario(
    **{
        "{name: grass, fraction": "{name: grass, tail_dof: 8, fraction",
        "processing:": f"    - {GREEN}\nprocessing:",
    }
)
BLUR = "scene.targets.green.fill.geometry.psf_fwhm_pixels"
BASE = run(SCENE)


def injected(name: str, s=SCENE):
    return injected_prediction(s, BY_NAME[name], Origins(axis=AXIS, engine=engine))[0]


@pytest.mark.parametrize(
    ("name", "read", "factor", "added"),
    [
        ("sunlight x 0.95", lambda p: p.radiance["panel"].mean, 0.95, 0.0),
        ("sunlight x 1.05", lambda p: p.radiance["panel"].mean, 1.05, 0.0),
        ("noise x 1.5", lambda p: p.snr["panel"].mean, 1 / 1.5, 0.0),
        ("electrons x 1.05", lambda p: p.noise["panel"]["shot"], 1 / 1.05, 0.0),
        ("empirical line gain x 1.02", lambda p: p.reflectance["panel"].mean, 1.02, 0.0),
        ("empirical line gain x 1.02", lambda p: p.radiance["panel"].mean, 1.0, 0.0),
        ("empirical line offset + 0.005", lambda p: p.reflectance["panel"].mean, 1.0, 0.005),
        ("target spectra x 0.8", lambda p: p.reflectance["tenth"].mean - 0.9 * p.reflectance["asphalt"].mean, 0.8, 0.0),
        # The detector still looks for what was stated.
        ("target spectra x 0.8", lambda p: p.roc[KEY].threshold, 1.0, 0.0),
        ("target spectra exchanged", lambda p: p.roc[KEY].threshold, 1.0, 0.0),
    ],
)
def test_factors_act_on_what_they_name(name, read, factor, added):
    np.testing.assert_allclose(read(injected(name)), factor * read(BASE) + added, rtol=1e-9)


def test_path_radiance_and_spherical_albedo_act_where_they_stand_in_3_7():
    terms = engine(SCENE.atmosphere).at_bands(AXIS)
    path = injected("path radiance x 1.1").radiance["panel"].mean - BASE.radiance["panel"].mean
    np.testing.assert_allclose(path, 0.1 * terms.path_radiance, rtol=1e-9)
    # L - L_a = G / (1 - S rho_ave): with S 1.5 times as large by (1 - S rho_ave)/(1 - 1.5 S rho_ave).
    ground = BASE.radiance["panel"].mean - terms.path_radiance
    grown = injected("spherical albedo x 1.5").radiance["panel"].mean - terms.path_radiance
    seen = terms.spherical_albedo * sum(c.fraction * BASE.reflectance[c.name].mean for c in SCENE.scene.classes)
    np.testing.assert_allclose(grown / ground, (1 - seen) / (1 - 1.5 * seen), rtol=1e-8)


def shifted(nm):
    return {"sensor_operation": {"wavelength_shift_nm": nm}}


def gains(factor):
    return {f"scene.classes.{c.name}.gain": factor**2 for c in SCENE.scene.classes}


@pytest.mark.parametrize(
    ("name", "stated", "read", "tolerance"),
    [
        ("wavelengths + 5 nm", shifted(5.0), lambda p: p.radiance["grass"].mean, 1e-12),
        ("spectral shift of 0.5 band", shifted(0.5 * AXIS.fwhm_nm[0]), lambda p: p.radiance["grass"].mean, 1e-12),
        ("class spread x 0.8", gains(0.8), lambda p: np.diag(p.reflectance["grass"].pixel_covariance), 0.02),
        ("class spread x 1.25", gains(1.25), lambda p: np.diag(p.reflectance["grass"].pixel_covariance), 0.02),
        ("tails left out", {"scene.classes.grass.tail_dof": None}, lambda p: p.roc[KEY].threshold, 2e-4),
        ("class means exchanged", {"scene.classes.grass.spectrum.builtin": "asphalt",
                                   "scene.classes.asphalt.spectrum.builtin": "grass"},
         lambda p: [p.reflectance[name].mean for name in ("grass", "asphalt")], 1e-12),
        ("target spectra exchanged", {"scene.targets.plank.spectrum": {"builtin": "green-paint-plank"}},
         lambda p: p.reflectance["tenth"].mean, 1e-12),
        ("target spectra of another material", {"scene.targets.plank.spectrum": {"builtin": "black-panel"}},
         lambda p: p.reflectance["tenth"].mean, 1e-12),
        # At a fill of a tenth f is ten times its square.
        ("target covariance by f, not f squared", {"scene.targets.plank.gain": 10.0},
         lambda p: p.radiance["tenth"].pixel_covariance, 1e-9),
        ("target covariance by f, not f squared", {"scene.targets.plank.gain": 10.0}, lambda p: p.roc[KEY].pd, 1e-9),
        ("fill x 0.8", {"scene.targets.plank.subjects.tenth.fill.fixed": 0.08}, lambda p: p.roc[KEY].pd, 1e-9),
        ("blur x 1.5", {BLUR: 1.2}, lambda p: p.reflectance["green"].mean, 1e-12),
    ],
)  # fmt: skip
def test_an_error_gives_what_a_scenario_gives_that_states_it(name, stated, read, tolerance):
    np.testing.assert_allclose(read(injected(name)), read(run(with_settings(SCENE, stated))), rtol=tolerance)


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


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("tails left out", {"scene.classes.grass.tail_dof": None}, "no class has tails"),
        ("blur x 1.5", {BLUR: 0.0}, "blur is 0"),
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
    for name in ("sunlight x 0.95", "noise x 1.5"):
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
    found, there = injected("blur x 1.5", stated).roc, run(with_settings(stated, {BLUR: 1.2})).roc
    key = next(k for k in there if k[0] == "green")
    for limit in ("pd_lower", "pd_upper"):
        np.testing.assert_allclose(getattr(found[key], limit), getattr(there[key], limit), rtol=1e-9)
