"""Replicate field spectra as the source of a class: mean, covariance, number, standard error."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from sklearn.covariance import ledoit_wolf

from hyperval import model
from hyperval.config import validate
from hyperval.errors import InputError, UsageError
from hyperval.model import Origins, Sources, band_error_covariance, error_of_mean, predict, replicate_statistics
from hyperval.scenario import Replicates, Scenario, SpectrumSource, SpectrumUncertainty, Surface
from hyperval.spectra import SpectralAxis, band_average

AXIS = SpectralAxis(np.array([450.0, 550, 670, 750, 860]), np.full(5, 10.0))
GRID = np.arange(400.0, 901.0, 5.0)


def lawn(n: int, seed: int = 1) -> np.ndarray:
    """(n, grid) spectra that differ in brightness and slope."""
    rng = np.random.default_rng(seed)
    base = 0.05 + 0.4 / (1 + np.exp(-(GRID - 710) / 15))
    level, slope = rng.normal(1, 0.1, (n, 1)), rng.normal(0, 0.02, (n, 1))
    return level * base + slope * (GRID - 650) / 250


def write(folder: Path, spectra: np.ndarray, stem: str = "grass") -> Path:
    for i, values in enumerate(spectra):
        rows = "".join(f"{w:g},{v:.9f}\n" for w, v in zip(GRID, values, strict=True))
        (folder / f"{stem}{i:02d}.csv").write_text("wavelength_nm,reflectance\n" + rows)
    return folder


def found(folder: Path, files: Any, **options: Any):
    source = Replicates.model_validate({"files": files, "wavelength_unit": "nm", **options})
    return replicate_statistics(source, AXIS, lambda reference: folder / reference)


def test_mean_and_covariance_of_the_files_of_a_pattern(tmp_path):
    spectra = lawn(20)
    write(tmp_path, spectra)
    write(tmp_path, lawn(3, 2), "sand")
    got = found(tmp_path, "grass*.csv")
    values = band_average(GRID, np.round(spectra, 9), AXIS)
    assert got.n == 20
    assert np.allclose(got.mean, values.mean(axis=0), rtol=0, atol=1e-12)
    assert np.allclose(got.covariance, np.cov(values.T), rtol=1e-9)  # 20 are enough for 5 bands
    assert got.source == "20 replicate spectra"
    assert np.allclose(got.standard_deviation, values.std(axis=0, ddof=1))
    listed = found(tmp_path, [f"grass{i:02d}.csv" for i in reversed(range(20))])
    assert np.allclose(listed.covariance, got.covariance, rtol=1e-12)
    assert found(tmp_path, ["grass*.csv", "sand*.csv"]).n == 23


def test_few_spectra_shrink_the_covariance(tmp_path):
    spectra = lawn(4)
    write(tmp_path, spectra)
    got = found(tmp_path, "*.csv")
    values = band_average(GRID, np.round(spectra, 9), AXIS)
    covariance, share = ledoit_wolf(values)
    assert 0 < share < 1
    assert np.allclose(got.covariance, covariance * 4 / 3, rtol=1e-9)
    assert np.linalg.matrix_rank(got.covariance) == 5
    assert np.allclose(got.standard_deviation, values.std(axis=0, ddof=1))
    assert got.source == f"4 replicate spectra, covariance shrunk by {share:.3g}"


def test_the_error_of_the_mean_covers_the_truth_as_often_as_said():
    """95 % intervals from three spectra: t / 1.96 makes them hold where the plain standard error covers 0.81.

    4000 trials: the coverage has a standard deviation of 0.0034, so 0.0137 (4 sigma) fails once in 16,000 seeds.
    """
    rng = np.random.default_rng(6)
    inside = plain = 0
    for _ in range(4000):
        x = rng.normal(0.3, 0.02, 3)
        s = np.array([[x.var(ddof=1)]])
        u = float(np.sqrt(error_of_mean(s, 3)[0, 0]))
        inside += abs(x.mean() - 0.3) <= 1.96 * u
        plain += abs(x.mean() - 0.3) <= 1.96 * np.sqrt(s[0, 0] / 3)
    assert abs(inside / 4000 - 0.95) < 0.0137
    assert plain / 4000 < 0.85
    assert error_of_mean(s, 2)[0, 0] == pytest.approx((stats.t.ppf(0.975, 1) / 1.959964) ** 2 * s[0, 0] / 2)
    assert error_of_mean(s, 10**6)[0, 0] == pytest.approx(s[0, 0] / 1e6, rel=1e-5)


def test_records_of_one_file(tmp_path):
    spectra = lawn(6)
    rows = "".join(",".join(f"{v:.9f}" for v in (w, *column)) + "\n" for w, column in zip(GRID, spectra.T, strict=True))
    (tmp_path / "all.csv").write_text("wavelength_nm,m1,m2,m3,m4,m5,m6\n" + rows)
    values = band_average(GRID, np.round(spectra, 9), AXIS)
    assert np.allclose(found(tmp_path, "all.csv").mean, values.mean(axis=0))
    some = found(tmp_path, "all.csv", records=["m2", 4])
    assert some.n == 2
    assert np.allclose(some.mean, values[[1, 4]].mean(axis=0))
    with pytest.raises(UsageError, match="no spectrum 'm9'"):
        found(tmp_path, "all.csv", records=["m2", "m9"])
    with pytest.raises(UsageError, match=r"no record 6\n.*0 to 5"):
        found(tmp_path, "all.csv", records=[1, 6])


def test_what_is_refused(tmp_path):
    write(tmp_path, lawn(1))
    with pytest.raises(UsageError, match="a single spectrum has no spread"):
        found(tmp_path, "grass*.csv")
    with pytest.raises(InputError, match="no such spectrum file"):
        found(tmp_path, "sand*.csv")
    write(tmp_path, lawn(2))
    far, source = SpectralAxis(np.array([1500.0, 1600.0]), 10.0), {"files": "grass*.csv", "wavelength_unit": "nm"}
    with pytest.raises(UsageError, match="share none of the bands"):
        replicate_statistics(Replicates.model_validate(source), far, lambda r: tmp_path / r)


def test_a_surface_takes_spectrum_and_covariance_from_replicates(tmp_path):
    write(tmp_path, lawn(20))
    sources = Sources(AXIS, {}, lambda reference: tmp_path / reference)
    replicates = {"files": "grass*.csv", "wavelength_unit": "nm"}
    direct = sources.surface(Surface.model_validate({"name": "lawn", "spectrum": {"replicates": replicates}}))
    both = {"name": "lawn", "spectrum": {"constant": 0.2}, "covariance": {"replicates": replicates}}
    mixed = sources.surface(Surface.model_validate(both))
    assert np.array_equal(direct.covariance, mixed.covariance)
    assert (direct.n, direct.source, mixed.mean_error) == (20, "20 replicate spectra", None)
    assert direct.mean_error is not None
    with pytest.raises(UsageError, match="replicates of 'lawn'"):
        sources.spectrum(SpectrumSource.model_validate({"replicates": {**replicates, "files": "grass00.csv"}}), "lawn")


def scenario(folder: Path, stated: list[dict[str, Any]]) -> Scenario:
    replicates = {"files": str(folder / "grass*.csv"), "wavelength_unit": "nm"}
    data = {
        "schema": 1,
        "name": "t",
        "scene": {
            "classes": [
                {"name": "lawn", "fraction": 0.5, "spectrum": {"replicates": replicates}},
                {"name": "road", "fraction": 0.5, "spectrum": {"builtin": "asphalt"}},
            ]
        },
        "uncertainty": {"field_spectra": stated},
    }
    return validate(Scenario, data, {}, "t.yaml")


def test_the_standard_error_is_the_uncertainty_unless_the_scenario_states_one(tmp_path):
    write(tmp_path, lawn(4))
    values = band_average(GRID, np.round(lawn(4), 9), AXIS)
    expected = stats.t.ppf(0.975, 3) / 1.959964 * values.std(axis=0, ddof=1) / 2.0
    product = predict(scenario(tmp_path, []), Origins(axis=AXIS)).reflectance
    assert np.allclose(product["lawn"].standard_uncertainty, expected, rtol=1e-6)
    assert np.all(product["road"].standard_uncertainty == 0.0)
    longer = SpectralAxis(np.arange(690.0, 901.0, 10.0), np.full(22, 10.0))  # than the spectra, by half a band
    made = predict(scenario(tmp_path, []), Origins(axis=longer)).reflectance["lawn"]
    assert (np.isnan(made.mean).sum(), np.isnan(made.pixel_covariance).any()) == (1, False)
    stated = predict(scenario(tmp_path, [{"subject": "lawn", "absolute": 0.01}]), Origins(axis=AXIS)).reflectance
    assert np.allclose(stated["lawn"].standard_uncertainty, 0.01)
    spread = predict(scenario(tmp_path, [{"subject": "lawn", "from_file": True}]), Origins(axis=AXIS)).reflectance
    assert np.allclose(spread["lawn"].standard_uncertainty, values.std(axis=0, ddof=1))


def test_errors_of_single_samples_partly_cancel_in_a_band():
    """4,000 draws of errors that are each nanometre's own, and of errors over 40 nm, averaged over bands of 6 nm.

    Of a band's variance a draw of 4,000 has a standard error of 2.2 %; five of them over 20 bands: one false
    failure in 10,000.  Bands 4 nm apart share samples, which the diagonal alone would miss.
    """
    at = np.arange(400.0, 901.0)
    axis = SpectralAxis(np.arange(500.0, 580.0, 4.0), np.full(20, 6.0))
    u = 0.001 + 0.00001 * (at - 400.0)
    rng, nothing = np.random.default_rng(12), (np.zeros(20), np.zeros((20, 20)))
    for length in (1e-3, 40.0):
        c = np.outer(u, u) * np.exp(-0.5 * ((at[:, None] - at) / length) ** 2)
        values, vectors = np.linalg.eigh(c)
        drawn = rng.standard_normal((4000, at.size)) * np.sqrt(np.clip(values, 0, None)) @ vectors.T
        found = np.cov(band_average(at, drawn, axis), rowvar=False)
        own = SpectrumUncertainty(subject="x", from_file=True, correlation_nm=length)
        rows = model.spectrum_error_rows(own, model.SurfaceStatistics("x", axis, *nothing, sampled_deviation=(at, u)))
        stated = rows.T @ rows
        assert np.diag(stated) == pytest.approx(np.diag(found), rel=0.11)
        assert np.max(np.abs(stated - found) / np.sqrt(np.outer(np.diag(stated), np.diag(stated)))) < 0.11
    wide = band_error_covariance(at, u, None, axis)
    assert np.sqrt(np.diag(wide)) == pytest.approx(band_average(at, u, axis), rel=1e-9)
