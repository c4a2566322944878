"""The variance of budget terms from band to band beside the data they came from."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.collection import CalibrationUncertainty
from hyperval.observe import calibration_covariance, detector_covariance
from hyperval.sensor import load_sensor
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.arange(400.0, 2400.0, 5.0), np.full(400, 5.5))


def roughness(values: np.ndarray) -> np.ndarray:
    """(..., B - 2) second differences over sqrt 6, along the last axis."""
    return np.diff(values, 2, axis=-1) / np.sqrt(6.0)


def band_scale_variance(covariance: np.ndarray) -> float:
    """Mean variance of (x_i-1 - 2 x_i + x_i+1) / sqrt 6 of an error with a covariance (B, B)."""
    rows = roughness(np.eye(covariance.shape[0])).T
    return float(np.mean(np.einsum("ib,bc,ic->i", rows, covariance, rows)))


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
