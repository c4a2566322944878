"""predict(): closure with simulated pixels, identities, domains, uncertainty and cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import uncertain_scene
from scipy.special import ndtri
from uncertain_scene import ATMOSPHERE, AXIS, engine

from hyperval.config import parse_yaml, validate
from hyperval.data import ClassStatistics
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
from hyperval.products import PredictedProducts, background_of
from hyperval.scenario import Scenario, SpectrumUncertainty, load_scenario
from hyperval.sensor.specification import load_sensor
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


def test_full_target_scores_one_and_mixed_pixels_follow_the_fill():
    p = run()
    assert p.scores["full", "cem"].mean == pytest.approx(1.0)
    grass, asphalt = builtin_class("grass", AXIS).mean, builtin_class("asphalt", AXIS).mean
    mean = average_reflectance([0.7, 0.3], [grass, asphalt])
    line = p.reflectance
    cov = mixture_covariance(
        [0.7, 0.3], [grass, asphalt], [line["grass"].pixel_covariance, line["asphalt"].pixel_covariance]
    )
    f = matched_filter_weights(builtin_class("yellow-paint-plank", AXIS).mean, mean, cov)
    host = float(f.score(asphalt))
    assert p.scores["tenth", "cem"].mean == pytest.approx(0.1 + 0.9 * host, abs=1e-10)
    assert p.scores[background_of("tenth"), "cem"].mean == pytest.approx(0.0, abs=1e-12)
    assert p.scores[background_of("tenth"), "cem"].sd == pytest.approx(np.sqrt(f.variance(cov)), rel=1e-9)
    # Moments of the loose planks: Var f (1 - theta_b)^2 and the rest of (3.28), from the pixel covariance.
    seen = line["loose"].pixel_covariance
    assert p.scores["loose", "cem"].sd == pytest.approx(np.sqrt(f.variance(seen)), rel=1e-3)


def test_closure_with_simulated_pixels():
    """4e5 background and 1e5 target pixels, drawn, seen, retrieved and scored one by one.

    z of P_FA and P_D at 4 thresholds and of mean scores, |z| < 5: false failure under 1e-5.  Neighbourhoods do not
    vary here; Poisson counts are drawn as normal numbers of the variance at the pixel's own radiance.
    """
    still = scenario(**{"scene:\n": "scene:\n  adjacency: {effective_neighbours: null}\n"})
    p = predict(still, Origins(axis=AXIS, engine=engine))
    rng = np.random.default_rng(2014)
    terms = engine(scenario().atmosphere).at_bands(AXIS)
    noise = load_sensor("prospectir-vs").noise(AXIS)
    grass, asphalt, plank = (builtin_class(n, AXIS) for n in ("grass", "asphalt", "yellow-paint-plank"))
    average = 0.7 * grass.mean + 0.3 * asphalt.mean
    trapping = 1 - terms.spherical_albedo * average

    def draw(c: ClassStatistics, n: int) -> np.ndarray:
        return rng.multivariate_normal(c.mean, c.covariance, n, method="cholesky")

    def retrieved(rho: np.ndarray) -> np.ndarray:
        level = terms.path_radiance + (terms.direct * rho + terms.adjacency * average) / trapping
        level = level + rng.standard_normal(level.shape) * np.sqrt(noise.variance(level))
        low, high = (
            terms.path_radiance + (terms.direct * r + terms.adjacency * average) / trapping for r in (0.1, 0.6)
        )
        return 0.1 + 0.5 * (level - low) / (high - low)

    n, m = 400_000, 100_000
    background = np.concatenate([retrieved(draw(grass, int(0.7 * n))), retrieved(draw(asphalt, int(0.3 * n)))])
    f = 0.1
    pixels = retrieved(f * draw(plank, m) + (1 - f) * draw(asphalt, m))
    line = p.reflectance
    cov = mixture_covariance(
        [0.7, 0.3], [grass.mean, asphalt.mean], [line["grass"].pixel_covariance, line["asphalt"].pixel_covariance]
    )
    detector = matched_filter_weights(plank.mean, average, cov)
    score_b, score_t = detector.score(background), detector.score(pixels)
    found = p.scores["tenth", "cem"]
    assert abs(score_t.mean() - found.mean) < 5 * found.sd / np.sqrt(m)
    assert abs(score_t.var() / found.sd**2 - 1) < 5 * np.sqrt(2 / m)
    curve = p.roc["tenth", "cem", "pixel"]
    for pfa in (1e-3, 1e-2, 1e-1, 0.3):
        k = int(np.argmin(np.abs(np.log(curve.pfa / pfa))))
        x, expected, pd = curve.threshold[k], curve.pfa[k], curve.pd[k]
        assert abs((score_b > x).mean() - expected) < 5 * np.sqrt(expected / n)
        assert abs((score_t > x).mean() - pd) < 5 * np.sqrt(max(pd * (1 - pd), 1e-6) / m)


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


def test_scores_hold_the_adjacency_term():
    """With neighbours that vary like one pixel, the variance of the score is that of the whole pixel covariance."""
    lively = scenario(**{"scene:\n": "scene:\n  adjacency: {effective_neighbours: 1}\n"})
    p, still = predict(lively, Origins(axis=AXIS, engine=engine)), run()
    f = detector_of(p)
    for name in ("tenth", "full"):
        assert p.scores[name, "cem"].sd ** 2 == pytest.approx(
            f.variance(p.reflectance[name].pixel_covariance), rel=1e-9
        )
    term = f.variance(p.reflectance["full"].pixel_covariance - still.reflectance["full"].pixel_covariance)
    assert term > 1e-3 * p.scores["full", "cem"].sd ** 2  # the term matters for this test


def test_gains_multiply_the_covariances():
    flat = scenario("", **{"name: asphalt, fraction: 0.3,": "name: asphalt, gain: 4, fraction: 0.3,",
                           "host: asphalt": "host: asphalt\n      gain: 9"})  # fmt: skip
    q = predict(flat, Origins(axis=AXIS))
    asphalt, plank = (builtin_class(n, AXIS).covariance for n in ("asphalt", "yellow-paint-plank"))
    assert q.reflectance["asphalt"].pixel_covariance == pytest.approx(4 * asphalt)
    assert q.reflectance["full"].pixel_covariance == pytest.approx(9 * plank)
    assert q.reflectance["tenth"].pixel_covariance == pytest.approx(0.01 * 9 * plank + 0.81 * 4 * asphalt)
    f = detector_of(q)
    for name in ("tenth", "full"):
        assert q.scores[name, "cem"].sd ** 2 == pytest.approx(f.variance(q.reflectance[name].pixel_covariance))
    mixture = mixture_covariance(
        [0.7, 0.3],
        [q.reflectance[n].mean for n in ("grass", "asphalt")],
        [q.reflectance[n].pixel_covariance for n in ("grass", "asphalt")],
    )
    assert q.scores[background_of("full"), "cem"].sd ** 2 == pytest.approx(f.variance(mixture))


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
