"""predict(): closure with simulated pixels, identities, domains, uncertainty and cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import uncertain_scene
from scipy.special import ndtri
from uncertain_scene import ATMOSPHERE, AXIS, engine

from hyperval.config import parse_yaml, validate
from hyperval.errors import InputError, UsageError
from hyperval.model import (
    LinearFilter,
    Origins,
    SurfaceStatistics,
    average_reflectance,
    detection_bands,
    matched_filter_weights,
    mixture_covariance,
    predict,
    spectrum_error_sd,
)
from hyperval.products import PredictedProducts
from hyperval.scenario import Scenario, SpectrumUncertainty, load_scenario
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class

# One population that is full, and a second detector.
SCENE = uncertain_scene.SCENE.replace(
    "        - {name: loose", "        - {name: full, fill: {fixed: 1}}\n        - {name: loose"
).replace("detectors: [cem]", "detectors: [cem, cem-correlation]")


def scenario(extra: str = ATMOSPHERE, **replaced: str) -> Scenario:
    return uncertain_scene.scenario(extra, SCENE, **replaced)


def run(extra: str = ATMOSPHERE, **kwargs) -> PredictedProducts:
    return predict(scenario(extra), Origins(axis=AXIS, engine=engine), **kwargs)


UNCERTAIN = (
    ATMOSPHERE
    + """
uncertainty:
  aot550: 0.05
  water_vapour_g_cm2: 0.3
  solar_irradiance_relative: 0.02
  engine: {relative: 0.01, per_optical_depth: 0.2, correlation_nm: 50}
  field_spectra: [{subject: plank, relative: 0.05, correlation_nm: 200}, {subject: panel, absolute: 0.01}]
"""
)


def test_budget_adds_up_to_the_error_covariance():
    p = run(UNCERTAIN)
    for name in ("grass", "panel", "full"):
        estimate = p.radiance[name]
        total = sum(v**2 for v in estimate.budget.values())
        assert total == pytest.approx(np.diag(estimate.error_covariance), rel=1e-10)
        assert np.linalg.eigvalsh(estimate.error_covariance)[0] > -1e-12
    assert "field spectrum" in p.radiance["panel"].budget
    assert "field spectrum" not in p.radiance["grass"].budget


@pytest.mark.parametrize("mean", ["{builtin: asphalt}", "{constant: 0.2}"], ids=["builtin", "constant"])
def test_measured_tails_come_with_the_measured_covariance(mean):
    """The class mean from elsewhere: `tail_dof: measured` is that of the region whose covariance the class has."""
    text = "".join(SCENE).replace(
        "spectrum: {builtin: asphalt}", f"spectrum: {mean}, covariance: {{measured: court}}, tail_dof: measured"
    )
    court = replace(builtin_class("soil", AXIS), tail_dof=4.5)

    def dof(text):
        data, lines = parse_yaml(text)
        p = predict(
            validate(Scenario, data, lines, "text"), Origins(measured={"court": court}, axis=AXIS, engine=engine)
        )
        return p.distribution["asphalt"].tail_dof

    assert dof(text) == 4.5
    assert dof(text.replace(", tail_dof: measured", "")) == np.inf  # fitted tails count where they are asked for


def test_spectrum_from_a_file_is_relative_to_the_scenario(tmp_path):
    w = np.arange(340.0, 2601.0, 5.0)
    rows = "\n".join(f"{a:.1f},{0.1 + a / 10000:.5f}" for a in w)
    (tmp_path / "plank.csv").write_text("wavelength_nm,reflectance\n" + rows + "\n")
    text = SCENE.replace("{builtin: yellow-paint-plank}", "{file: plank.csv, reflectance_unit: fraction}")
    (tmp_path / "s.yaml").write_text(text)
    p = predict(load_scenario(tmp_path / "s.yaml"), Origins(axis=AXIS))
    assert p.reflectance["full"].mean == pytest.approx(0.1 + AXIS.centre_nm / 10000, abs=1e-5)


def test_bands_of_the_detectors():
    axis = SpectralAxis(np.array([450.0, 940, 1400, 1650]), np.full(4, 10.0), np.array([True, True, False, True]))
    everything = np.ones(4, bool)
    s = scenario(**{"{drop_bad: false}": "{windows_only: true, ranges: [[400, 1000], [1600, 1700]]}"})
    # 1650 nm lies in a window; 940 nm is a water band; 1400 nm is bad.
    assert detection_bands(s, axis, everything).tolist() == [0, 3]
    with pytest.raises(UsageError, match="no band is left"):
        detection_bands(scenario(**{"{drop_bad: false}": "{ranges: [[3000, 4000]]}"}), axis, everything)


def test_a_sensor_that_there_is_not_is_a_missing_file_where_it_is_meant_as_one():
    with pytest.raises(UsageError, match=r"unknown sensor 'hydyce'(?s:.*)hydice"):
        run(ATMOSPHERE.replace("prospectir-vs", "hydyce"))
    with pytest.raises(InputError, match="no such file"):
        run(ATMOSPHERE.replace("prospectir-vs", "mine.yaml"))


def test_no_bands_at_all():
    with pytest.raises(UsageError, match="the scenario has no bands"):
        predict(scenario(""))


def detector_of(p: PredictedProducts) -> LinearFilter:
    """The filter for the plank, designed anew from the reflectance products of the two classes."""
    seen = [p.reflectance[n] for n in ("grass", "asphalt")]
    means = [e.mean for e in seen]
    cov = mixture_covariance([0.7, 0.3], means, [e.pixel_covariance for e in seen])
    return matched_filter_weights(p.reflectance["full"].mean, average_reflectance([0.7, 0.3], means), cov)


def test_error_of_the_target_spectrum_moves_the_score_by_the_fill():
    """The half width of the ROC interval in probit is 1.96 f sqrt(w C w) / sigma_T."""
    p = run(ATMOSPHERE + "uncertainty: {field_spectra: [{subject: plank, relative: 0.05, correlation_nm: 200}]}\n")
    plank = builtin_class("yellow-paint-plank", AXIS).mean
    gap = AXIS.centre_nm[:, None] - AXIS.centre_nm[None, :]
    error = np.outer(0.05 * plank, 0.05 * plank) * np.exp(-0.5 * (gap / 200) ** 2)
    shift = 0.1 * np.sqrt(detector_of(p).variance(error)) / p.scores["tenth", "cem"].sd
    curve = p.roc["tenth", "cem", "pixel"]
    middle = (curve.pd > 0.05) & (curve.pd < 0.95)
    half = 0.5 * (ndtri(curve.pd_upper[middle]) - ndtri(curve.pd_lower[middle]))
    assert half == pytest.approx(np.full(half.size, 1.959964 * shift), rel=1e-5)
    budget = {n: p.radiance[n].budget["field spectrum"] for n in ("tenth", "full")}
    assert budget["tenth"] == pytest.approx(0.1 * budget["full"], rel=1e-12)


def test_engine_error_grows_with_gas_absorption():
    p = run(ATMOSPHERE + "uncertainty: {engine: {relative: 0.01, per_optical_depth: 0.2, path_relative: 0.1}}\n")
    terms = engine(scenario().atmosphere).at_bands(AXIS)
    estimate = p.radiance["grass"]
    expected = (0.01 - 0.2 * np.log(terms.gas_transmittance)) * (estimate.mean - terms.path_radiance)
    assert estimate.budget["radiative-transfer engine"] == pytest.approx(expected, rel=1e-9)
    assert estimate.budget["engine's path radiance"] == pytest.approx(0.1 * terms.path_radiance, rel=1e-9)


def test_field_spectrum_error_from_its_file():
    surface = SurfaceStatistics(
        "x", np.full(10, 0.3), np.zeros((10, 10)), "file", standard_deviation=np.full(10, 0.02), n=16
    )
    spread = SpectrumUncertainty(subject="x", from_file=True)
    error = SpectrumUncertainty(subject="x", from_file=True, divisor="standard_error")
    assert spectrum_error_sd(spread, surface, AXIS) == pytest.approx(np.full(10, 0.02))
    assert spectrum_error_sd(error, surface, AXIS) == pytest.approx(np.full(10, 0.02 / 4))
    with pytest.raises(UsageError, match="how many spectra"):
        spectrum_error_sd(error, replace(surface, n=None), AXIS)
    with pytest.raises(UsageError, match="no standard deviation"):
        spectrum_error_sd(error, replace(surface, standard_deviation=None), AXIS)


def test_relative_covariance():
    source = "spectrum: {constant: 0.2}, covariance: {relative_sd: 0.1, band_sd: 0.01, correlation_nm: 100}"
    s = scenario("", **{"spectrum: {builtin: asphalt}": source})
    gap = AXIS.centre_nm[:, None] - AXIS.centre_nm[None, :]
    expected = 4e-4 * np.exp(-0.5 * (gap / 100) ** 2) + 1e-4 * np.eye(10)
    assert predict(s, Origins(axis=AXIS)).reflectance["asphalt"].pixel_covariance == pytest.approx(expected)
