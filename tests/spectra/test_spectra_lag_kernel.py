"""Kernels from measured lags, and the variance of budget terms from band to band beside the data they came from."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from hyperval.collection import CalibrationUncertainty
from hyperval.observe.site_spectra import calibration_covariance, detector_covariance
from hyperval.prediction.input import form_covariance
from hyperval.scenario import SpectralForm
from hyperval.sensor.specification import load_sensor
from hyperval.spectra.axis import SpectralAxis, lag_kernel

AXIS = SpectralAxis(np.arange(400.0, 2400.0, 5.0), np.full(400, 5.5))


def roughness(values: np.ndarray) -> np.ndarray:
    """(..., B - 2) second differences over sqrt 6, along the last axis."""
    return np.diff(values, 2, axis=-1) / np.sqrt(6.0)


def band_scale_variance(covariance: np.ndarray) -> float:
    """Mean variance of (x_i-1 - 2 x_i + x_i+1) / sqrt 6 of an error with a covariance (B, B)."""
    rows = roughness(np.eye(covariance.shape[0])).T
    return float(np.mean(np.einsum("ib,bc,ic->i", rows, covariance, rows)))


@pytest.mark.parametrize(("nugget", "length"), [(0.0, 30.0), (0.6, 8.0), (0.9, 200.0)])
def test_planted_lags_give_their_kernel_back(nugget, length):
    d = np.array([5.0, 10.0, 15.0, 20.0, 40.0])
    kernel = lag_kernel(list(zip(d, (1.0 - nugget) * np.exp(-0.5 * (d / length) ** 2), strict=True)))
    assert kernel.nugget == pytest.approx(nugget, abs=2e-3)
    assert kernel.length_nm == pytest.approx(length, rel=5e-3)


def test_no_correlation_at_any_lag_is_all_nugget():
    assert lag_kernel([(5.0, 0.0), (10.0, -0.1)]).nugget == pytest.approx(1.0)


def test_lags_of_drawn_errors_give_their_variance_from_band_to_band():
    # 600 spectra of 400 bands; the variance from band to band is known to 0.5 %, its lags to 0.003.
    truth = SpectralForm(correlation_nm=25, nugget=0.4)
    covariance = form_covariance(np.full(len(AXIS), 0.02), truth, AXIS)
    drawn = np.random.default_rng(8).multivariate_normal(np.zeros(len(AXIS)), covariance, 600, method="cholesky")
    level = np.mean(drawn**2)
    lags = [(5.0 * k, float(np.mean(drawn[:, :-k] * drawn[:, k:]) / level)) for k in (1, 2, 3, 4, 8, 16)]
    form = SpectralForm(lags=lags)
    modelled = form_covariance(np.full(len(AXIS), np.sqrt(level)), form, AXIS)
    measured = np.mean(roughness(drawn) ** 2)
    assert band_scale_variance(modelled) == pytest.approx(measured, rel=0.05)
    # The same lags by a squared exponential alone leave next to nothing from band to band.
    smooth = form_covariance(np.full(len(AXIS), np.sqrt(level)), SpectralForm(correlation_nm=25), AXIS)
    assert band_scale_variance(smooth) < 0.01 * measured


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"lags": [[5, 0.4], [10, 0.2]], "correlation_nm": 20}, "correlation_nm or lags, not both"),
        ({"nugget": 0.5}, "nugget goes with correlation_nm"),
        ({"lags": [[5, 0.4]]}, "two or more pairs"),
        ({"lags": [[5, 0.4], [0, 1.0]]}, "a lag above 0 nm"),
        ({"lags": [[5, 0.4], [10, 0.3]], "distribution": "uniform"}, "is normal or log-normal"),
    ],
)
def test_forms_that_contradict_themselves(entries, words):
    with pytest.raises(ValidationError, match=words):
        SpectralForm.model_validate(entries)


def test_calibration_of_single_bands_varies_from_band_to_band_as_its_source_says(tmp_path):
    # Each band of the table is off by itself: the variance from band to band is that of the table's values.
    values = 0.01 + 0.005 * np.cos(AXIS.centre_nm / 300.0)
    rows = [f"{w} {v:.6f}" for w, v in zip(AXIS.centre_nm, values, strict=True)]
    (tmp_path / "error.txt").write_text("\n".join(["# wavelength, 1-sigma error", *rows, ""]))
    stated = CalibrationUncertainty(file="error.txt", uncorrelated=0.01)
    budget = calibration_covariance(np.full(len(AXIS), 5.0), AXIS, stated, lambda name: tmp_path / name)
    inner = 25.0 * (values**2 + 0.01**2)
    expected = np.mean((inner[:-2] + 4.0 * inner[1:-1] + inner[2:]) / 6.0)
    assert band_scale_variance(budget) == pytest.approx(expected, rel=1e-4)


def test_noise_of_a_mean_varies_from_band_to_band_as_the_detector_does():
    sensor = load_sensor("aviris-ng")
    level, pixels = np.full(len(AXIS), 3.0), 10
    one = sensor.noise(AXIS).variance(level, calibration=False)
    # 500 means of 10 drawn pixels; the mean over 398 correlated second differences is known to 0.5 %.
    drawn = np.random.default_rng(2).standard_normal((500, pixels, len(AXIS))) * np.sqrt(one)
    measured = np.mean(roughness(drawn.mean(axis=1)) ** 2)
    assert band_scale_variance(detector_covariance(level, AXIS, sensor, pixels)) == pytest.approx(measured, rel=0.03)
