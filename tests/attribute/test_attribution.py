"""Errors injected into the model do what their names say; inputs falsified on purpose are named first."""

from dataclasses import replace
from functools import reduce
from operator import getitem
from pathlib import Path

import numpy as np
import pytest
import yaml
from uncertain_scene import AXIS, engine, run, scenario

from hyperval.attribute import NotInjectable, errors_of_file, further_candidates, injected_errors, injected_prediction
from hyperval.campaign import load_jobs, run_campaign
from hyperval.errors import UsageError
from hyperval.model import Origins, predict, read_world
from hyperval.results import Outcome
from hyperval.settings import with_settings

# Injected errors: each does what its name says, and is refused where there is nothing of the kind.


KEY = ("tenth", "cem", "pixel")
BY_NAME = injected_errors()
# In place of the scene's: an empirical line, tails, two targets, and a fill with blur.
GREEN = "{name: green, spectrum: {builtin: green-paint-plank}, host: grass, "
GREEN += "fill: {geometry: {side_m: 0.4, gsd_m: 1.0, psf_fwhm_pixels: 0.8}}}"
SCENE = scenario(
    **{"{name: grass, fraction": "{name: grass, tail_dof: 8, fraction", "processing:": f"    - {GREEN}\nprocessing:"}
)
BLUR = "scene.targets.green.fill.geometry.psf_fwhm_pixels"
BASE, ORIGINS = run(SCENE), Origins(axis=AXIS, engine=engine)


def test_noise_without_signal_is_a_cause_of_a_sensor_that_is_changed_nowhere():
    (noise,) = [c for c in further_candidates([read_world(SCENE, ORIGINS)]) if c.name == "noise without signal"]
    (truth,) = noise.truths(0, 20.0)
    there = predict(with_settings(SCENE, {"sensor_changes": {"fixed_noise_factor": 2.0}}), ORIGINS).snr["grass"].mean
    np.testing.assert_allclose(predict(SCENE, ORIGINS, truth=truth).snr["grass"].mean, there, rtol=1e-12)


def test_wider_bands_see_what_a_sensor_with_such_bands_sees():
    wide = replace(AXIS, fwhm_nm=2.0 * AXIS.fwhm_nm)
    there = predict(SCENE, Origins(axis=wide, engine=engine)).radiance["grass"].mean
    moved = predict(SCENE, ORIGINS, truth={"sensor.band_width": 2.0}).radiance["grass"].mean
    np.testing.assert_allclose(moved, there, rtol=1e-12)
    assert np.max(np.abs(moved / BASE.radiance["grass"].mean - 1.0)) > 1e-3


def injected(name: str, s=SCENE):
    return injected_prediction(s, BY_NAME[name], Origins(axis=AXIS, engine=engine))[0]


@pytest.mark.parametrize(
    ("name", "read", "factor", "added"),
    [
        ("sunlight x 0.95", lambda p: p.radiance["panel"].mean, 0.95, 0.0),
        ("noise x 1.5", lambda p: p.snr["panel"].mean, 1 / 1.5, 0.0),
        ("electrons x 1.05", lambda p: p.noise["panel"]["shot"], 1 / 1.05, 0.0),
        ("empirical line gain x 1.02", lambda p: p.reflectance["panel"].mean, 1.02, 0.0),
        ("empirical line gain x 1.02", lambda p: p.radiance["panel"].mean, 1.0, 0.0),
        ("empirical line offset + 0.005", lambda p: p.reflectance["panel"].mean, 1.0, 0.005),
        ("target spectra x 0.8", lambda p: p.reflectance["tenth"].mean - 0.9 * p.reflectance["asphalt"].mean, 0.8, 0.0),
        # The detector still looks for what was stated.
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
        ("fill fraction x 0.8", {"scene.targets.plank.subjects.tenth.fill.fixed": 0.08}, lambda p: p.roc[KEY].pd, 1e-9),
        ("PSF width x 1.5", {BLUR: 1.2}, lambda p: p.reflectance["green"].mean, 1e-12),
    ],
)  # fmt: skip
def test_an_error_gives_what_a_scenario_gives_that_states_it(name, stated, read, tolerance):
    np.testing.assert_allclose(read(injected(name)), read(run(with_settings(SCENE, stated))), rtol=tolerance)


def test_a_spectrum_may_end_before_a_shifted_band(tmp_path):
    w = np.arange(400.0, AXIS.centre_nm[-2] + 9.0, 2.0)
    (tmp_path / "panel.csv").write_text("wavelength_nm,reflectance\n" + "".join(f"{x:g},0.3\n" for x in w))
    options = Origins(axis=AXIS, engine=engine, resolve=lambda name: name)
    s = with_settings(SCENE, {"scene.panels.panel.spectrum": {"file": str(tmp_path / "panel.csv")}})
    predict(s, options)  # bands at the end may lack
    found, _ = injected_prediction(s, BY_NAME["wavelengths + 5 nm"], options)
    assert np.all(found.radiance["panel"].mean[:-2] > 0.0)
    assert np.all(found.radiance["grass"].mean > 0.0)


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("tails left out", {"scene.classes.grass.tail_dof": None}, "no class has tails"),
        ("PSF width x 1.5", {BLUR: 0.0}, "blur is 0"),
        ("empirical line gain x 1.02", {"processing.elm": "none"}, "no empirical line"),
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


def test_errors_of_a_users_own_are_named_or_move_a_path(tmp_path):
    (path := tmp_path / "own.yaml").write_text("noise x 1.6:\n")
    with pytest.raises(UsageError, match=r"'noise x 1\.6' is not a standard injected error"):
        errors_of_file(path)
    path.write_text("bright: {light.irradiance: 1.05}\nnoise x 1.5:\n")
    found = injected_prediction(SCENE, errors_of_file(path)["bright"], Origins(axis=AXIS, engine=engine))[0]
    np.testing.assert_allclose(found.radiance["panel"].mean, injected("sunlight x 1.05").radiance["panel"].mean)


def test_an_error_of_a_path_that_leads_nowhere_names_it():
    for path, kind, words in (("surfaces.nobody.mean", NotInjectable, ""), ("scene.clases.a.gain", UsageError, "mean")):
        with pytest.raises(kind, match=rf"{path}(?s:.*){words}"):
            injected_prediction(SCENE, lambda _, at=path: {at: 0.1}, Origins(axis=AXIS, engine=engine))


def test_an_input_of_the_budget_moves_from_where_it_was_injected():
    """Two values of one blur were refused, and with them every campaign that states its uncertainty."""
    stated = with_settings(SCENE, {"uncertainty": {"psf_fwhm_pixels": 0.1}})
    found, there = injected("PSF width x 1.5", stated).roc, run(with_settings(stated, {BLUR: 1.2})).roc
    key = next(k for k in there if k[0] == "green")
    for limit in ("pd_lower", "pd_upper"):
        np.testing.assert_allclose(getattr(found[key], limit), getattr(there[key], limit), rtol=1e-9)


# Twins with one input falsified on purpose: the falsified input must be the first reason named.


FALSIFIED = yaml.safe_load((Path(__file__).parent / "falsified.yaml").read_text())
LEFT_OUT = "a class that was left out"


def _falsify(small, kind):
    small.data["attribution"] = {"what_ifs": []}
    for path, value in FALSIFIED[kind].items():
        *keys, last = (int(key) if key.isdigit() else key for key in path.split("."))
        reduce(getitem, keys, small.data)[last] = value
    if "field" in kind or kind == LEFT_OUT:
        small.data["comparisons"] = [small.gate("radiance") | {"subjects": ["field"]}]


def _state_surroundings(small):
    """Panels and planks are part of the surroundings, of which the model is told the two fields alone.

    One panel is no sample of its SNR, so that is left out.
    """
    fractions = [{"subject": "field", "absolute": 0.1}]
    small.scenario["uncertainty"] = {"adjacency_reflectance_relative": 0.1, "fractions": fractions}
    small.data["collection"]["targets"]["guard_pixels"] = 1
    del small.data["collection"]["snr_regions"]
    small.data["comparisons"] = [g for g in small.data["comparisons"] if g["product"] != "snr"]


def _reasons(small):
    """Rows of why the sides differ alone, and causes by their gain; whether criteria are met is not looked at."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hyperval.campaign.products.outcomes", lambda *_: [])
        table = run_campaign(load_jobs(small.write())[0]).table
    gains = {r.method: r.value for r in table.where(subject="all", metric="likelihood_gain")}
    return table, sorted(gains, key=lambda n: -gains[n])


@pytest.mark.parametrize("kind", [pytest.param(k, marks=[pytest.mark.slow] * (i > 0)) for i, k in enumerate(FALSIFIED)])
def test_the_falsified_input_is_named_first(small, kind):
    _falsify(small, kind)
    if kind != LEFT_OUT:  # one class has no fraction that could be off
        _state_surroundings(small)  # else they are wrong too: they alone have a reduced chi-square of 6
    table, ranked = _reasons(small)
    (chi,) = [r for r in table.where(product="attribution", subject="all") if r.metric == "reduced_chi_square"]
    assert ranked[0] == kind if kind == LEFT_OUT else f"check the {kind}" in chi.reason, chi.reason
    assert chi.value > 3.0
    assert chi.outcome is Outcome.DISAGREES


def test_nothing_is_blamed_where_nothing_was_falsified(small):
    small.data["attribution"] = {}
    _state_surroundings(small)
    table, _ = _reasons(small)
    (chi,) = [r for r in table.where(product="attribution", subject="all") if r.metric == "reduced_chi_square"]
    # 100 and more residuals: 1.5 is far outside of what a true model gives.
    assert chi.value < 1.5
    sure = {r.method: r.value for r in table.where(product="attribution", subject="all") if r.metric == "probability"}
    assert max(sure, key=sure.__getitem__) == "nothing to explain"


def test_a_collection_that_is_measured_again_and_shares_of_the_variance(small):
    """The change found is the one that was made; read with the right scale it meets its model."""
    _falsify(small, "sensor gain")
    _state_surroundings(small)
    right = {"name": "the header's scale", "question": "was it read wrongly?",
             "observe": {"collection.cube.scale": 1e-3}}  # fmt: skip
    small.data["attribution"] = {"what_ifs": [right], "each": ["field"]}
    table, _ = _reasons(small)
    (row,) = table.where(product="attribution", subject="all", method="sensor gain", metric="needed_uncertainty")
    assert np.isclose(row.value, 4.0, atol=0.3), "4 % in steps of 1 %"
    by_metric = {r.metric: r for r in table.where(product="what-if", method=right["name"])}
    (before,) = [r for r in table.where(product="attribution", subject="all") if r.metric == "reduced_chi_square"]
    assert by_metric["reduced_chi_square"].value < 1.5 < 3.0 < before.value
    assert by_metric["reduced_chi_square"].reason.startswith(f"{before.value:.4g} before")
    (alone,) = [r for r in table.where(product="attribution", subject="field") if r.metric == "reduced_chi_square"]
    assert alone.value > 3.0
    stated = [r for r in table.where(product="sensitivity") if "share of the variance" in r.reason]
    shares = [float(r.reason.split("variance ")[1]) for r in stated]
    assert len({r.method for r in stated}) >= 2
    # No stated input moves what is observed alone, as an SNR: it has no shares, and none is said to be no number.
    assert not [r for r in table.where(product="sensitivity") if "nan" in r.reason]
    assert all(0.0 <= share <= 1.0 for share in shares)


@pytest.mark.parametrize("changes", [{"observe": {"collection.snr_regions": []}}, {"scenario": {"scene.panels": []}}])
def test_an_experiment_that_compares_other_things_is_refused(small, changes):
    small.data["attribution"] = {"what_ifs": [{"name": "fewer", "question": "?", **changes}]}
    with pytest.raises(UsageError, match="'fewer' compares other things than the campaign does"):
        _reasons(small)
