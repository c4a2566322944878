"""Reflectance of collected sites by the line through the other sites of their flight line."""

from __future__ import annotations

import numpy as np
import pytest
from small_world import AXIS, BACKGROUND, BANDS, TARGET, World

from hyperval.collection import CollectionSection, PathRadiance
from hyperval.errors import UsageError
from hyperval.model import correlation
from hyperval.observe import path_estimate
from hyperval.products import SpectralEstimate
from hyperval.spectra import SpectralAxis
from small_campaign import stand_in_atmosphere

GAIN, PATH = np.linspace(60.0, 8.0, BANDS), np.linspace(3.0, 0.02, BANDS)
SURFACES = {"lawn": BACKGROUND, "turf": TARGET, "sand": np.linspace(0.35, 0.55, BANDS)}


def radiance_of(rho: np.ndarray) -> np.ndarray:
    return PATH + GAIN * rho


@pytest.fixture
def sites(tmp_path) -> World:
    """Three sites of one flight line and one of another, their radiances without an error."""
    made = World(tmp_path, np.empty(0))
    made.text("bands.txt", "".join(f"{w:.4f} 2.0\n" for w in AXIS.centre_nm))
    names = made.library("field.csv", *SURFACES.items(), ("lot", 0.3 * BACKGROUND + 0.05))
    spectra, panels = [], []
    for name in (*SURFACES, "lot"):
        rho = made.on_bands(names, name)
        rows = zip(AXIS.centre_nm, radiance_of(rho), strict=True)
        made.text(f"{name}.txt", "".join(f"{w} {v:.12g}\n" for w, v in rows))
        spectra.append({"subject": name, "path": f"{name}.txt", "pixels": 9, "line": "b" if name == "lot" else "a"})
        source = {"region": name, "spectrum": made.source(names, name), "relative_uncertainty": 0.02}
        panels.append({**source, "correlation_nm": 200})
    made.collection = {
        "spectra": spectra,
        "bands": {"path": "bands.txt", "wavelength_unit": "nm", "centre_column": 0, "fwhm_column": 1},
        "calibration": {"relative": 0.05, "uncorrelated": 0.01},
        "empirical_line": {"panels": panels, "path_radiance": []},
    }
    return made


def test_each_site_follows_from_the_others_of_its_flight_line(sites):
    seen = sites.observe().observation
    assert set(seen.reflectance) == set(SURFACES)
    for name in SURFACES:
        estimate, truth = seen.reflectance[name], sites.on_bands("field.csv", name)
        usable = np.isfinite(estimate.mean)
        assert usable.sum() >= 4  # two sites that reflect alike fix no line
        assert estimate.mean[usable] == pytest.approx(truth[usable], rel=1e-9)
        assert estimate.n == 9
    words = "\n".join(seen.notes)
    assert "sand: reflectance by the empirical line through lawn and turf" in words
    assert "lot: no reflectance by other sites of its flight line: no other site is known" in words


def test_the_interval_is_that_of_drawn_field_spectra(sites):
    # 4000 draws of the two panels' reflectances; the variance of each band is known to 2.2 %: 4 sigma are 9 %.
    rng = np.random.default_rng(4)
    estimate = sites.observe().observation.reflectance["sand"]
    root = np.linalg.cholesky(correlation(AXIS, 200.0) + 1e-12 * np.eye(BANDS))
    low, high = (
        sites.on_bands("field.csv", n) * (1.0 + 0.02 * rng.standard_normal((4000, BANDS)) @ root.T)
        for n in ("lawn", "turf")
    )
    a, b, c = (radiance_of(sites.on_bands("field.csv", n)) for n in ("lawn", "turf", "sand"))
    with np.errstate(all="ignore"):
        drawn = low + (c - a) * (high - low) / (b - a)
    use = np.isfinite(estimate.mean) & (np.abs(a - b) > 0.1 * GAIN)
    assert use.sum() >= 4
    spread = np.cov(drawn[:, use], rowvar=False)
    assert np.diag(estimate.error_covariance)[use] == pytest.approx(np.diag(spread), rel=0.09)
    # Sites share the calibration: no part of the budget is its.
    assert set(estimate.budget) == {"empirical line"}


def test_one_other_site_needs_the_path_radiance(sites, monkeypatch):
    sites.collection["spectra"] = [s for s in sites.collection["spectra"] if s["subject"] in ("lawn", "turf")]
    line = sites.collection["empirical_line"]
    line["panels"] = [p for p in line["panels"] if p["region"] in ("lawn", "turf")]
    seen = sites.observe().observation
    assert seen.reflectance == {}
    assert any("lawn: no reflectance by other sites" in n and "path_radiance" in n for n in seen.notes)

    error = np.outer(0.1 * PATH, 0.1 * PATH)
    monkeypatch.setattr("hyperval.observe.site_spectra.path_estimate", lambda *_: SpectralEstimate(PATH.copy(), error))
    line["path_radiance"] = [{"line": "a", "scenario": "air.yaml"}]
    seen = sites.observe().observation
    lawn, rho = seen.reflectance["lawn"], {n: sites.on_bands("field.csv", n) for n in ("lawn", "turf")}
    assert lawn.mean == pytest.approx(rho["lawn"], rel=1e-9)
    assert any("lawn: reflectance by the one-point empirical line through turf" in n for n in seen.notes)
    # rho = r (L - P) / (l - P): d rho / d ln r = rho, d rho / d P = r (L - l) / (l - P)^2; a gain g of all sites
    # leaves rho as it is, but for P, which is then P / g.
    a, b = radiance_of(rho["lawn"]), radiance_of(rho["turf"])
    by_path = PATH * rho["turf"] * (a - b) / (b - PATH) ** 2
    expected = 0.02**2 * rho["lawn"] ** 2 + by_path**2 * (0.1**2 + 0.05**2 + 0.01**2)
    assert np.diag(lawn.error_covariance) == pytest.approx(expected, rel=1e-5)


def test_path_radiance_is_what_a_scenario_sees_of_black_ground(tmp_path, monkeypatch):
    monkeypatch.setattr("hyperval.model.world.atmospheric_terms", stand_in_atmosphere)
    text = """
schema: 1
name: air
atmosphere: {aerosol: rural, aot550: 0.1, sensor_altitude_km: 2.3, solar_zenith_deg: 40, solar_azimuth_deg: 150,
  day_of_year: 312}
sensor: aviris-ng
scene: {classes: [{name: ground, fraction: 1.0, spectrum: {constant: 0.25}, covariance: {relative_sd: 0.0}}]}
processing: {detectors: []}
uncertainty: {engine: {relative: 0.01, path_relative: 0.05}}
"""
    (tmp_path / "air.yaml").write_text(text)
    axis = SpectralAxis(np.array([550.0, 850.0, 1240.0]), np.full(3, 5.0))
    source = PathRadiance(scenario="air.yaml")
    estimate = path_estimate(source, axis, lambda reference: tmp_path / reference)
    from hyperval.scenario import load_scenario

    state = load_scenario(tmp_path / "air.yaml").atmosphere
    t = stand_in_atmosphere(state).at_bands(axis)
    assert estimate.mean == pytest.approx(
        t.path_radiance + 0.25 * t.adjacency / (1.0 - 0.25 * t.spherical_albedo), rel=1e-12
    )
    assert np.all(estimate.standard_uncertainty >= 0.0499 * t.path_radiance)
    (tmp_path / "air.yaml").write_text(text[: text.index("uncertainty")])
    with pytest.raises(UsageError, match="the scenario states no uncertainty"):
        path_estimate(source, axis, lambda reference: tmp_path / reference)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"panels": [{"region": "roof", "spectrum": {"constant": 0.1}}], "intercept": False}, "no site 'roof'"),
        ({"path_radiance": [{"line": "c", "scenario": "air.yaml"}]}, "no site of flight line 'c'"),
    ],
)
def test_names_that_the_collection_does_not_have(sites, change, message):
    sites.collection["empirical_line"].update(change)
    with pytest.raises(UsageError, match=message):
        sites.observe()


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ({"saturation": 50.0}, "spectra show no darkest_pixel and no saturation"),
        ({"darkest_pixel": {}}, "spectra show no darkest_pixel and no saturation"),
        ({"path_radiance": [{"scenario": "a"}, {"scenario": "b"}]}, "a flight line stands twice"),
        ({"intercept": False, "path_radiance": [{"scenario": "a"}]}, "which intercept: false says is none"),
    ],
)
def test_lines_that_contradict_themselves(sites, line, message):
    sites.collection["empirical_line"].update(line)
    with pytest.raises(ValueError, match=message):
        CollectionSection.model_validate(sites.collection)
