"""Blur, co-adds and bins (around 3.10 and 3.13-3.20) against numbers by hand and simulated detectors."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.model import pixel_fills
from hyperval.scenario import Geometry
from hyperval.sensor import (
    NoiseModel,
    SensorChanges,
    SensorOperation,
    averaged_noise,
    binned_axis,
    binned_noise,
    changed_noise,
    modulation_transfer,
    mtf_at_nyquist,
    psf_fwhm_from_mtf,
)
from hyperval.spectra import SpectralAxis


def model(**changes: object) -> NoiseModel:
    values: dict[str, object] = {
        "electrons_per_radiance": np.array([1000.0, 2000.0, 1500.0, 500.0]), "fixed_noise": np.full(4, 40.0),
        "detector_gain": 1.0, "lsb_electrons": np.full(4, 60.0), "bits": 12, "bit_error_rate": 0.0,
        "calibration_percent": np.full(4, 0.5),
    }  # fmt: skip
    return NoiseModel(**{**values, **changes})  # type: ignore[arg-type]


def test_mtf_by_hand():
    # The aperture alone passes 2/pi at Nyquist; a Gaussian of FWHM 1 has sigma 0.424661 and passes
    # exp(-pi^2 0.180337 / 2) = 0.410699 of it.
    assert mtf_at_nyquist(0.0) == pytest.approx(2 / np.pi)
    assert mtf_at_nyquist(1.0) == pytest.approx(0.636620 * 0.410700, rel=1e-4)
    assert modulation_transfer([0.0, 1.0], 0.7) == pytest.approx([1.0, 0.0], abs=1e-15)
    assert psf_fwhm_from_mtf(mtf_at_nyquist([0.0, 0.4, 1.7])) == pytest.approx([0.0, 0.4, 1.7])


def test_mtf_is_the_fourier_transform_of_the_fill():
    # The response at an offset is the fill of a sliver; its transform at Nyquist is the MTF.
    x = np.arange(-3, 3, 1 / 32) + 1 / 64
    sliver = 1e-4
    long = Geometry(shape="rectangle", length_m=6.0, width_m=sliver, gsd_m=1.0, psf_fwhm_pixels=0.8)
    fills = pixel_fills(long, np.stack([x, np.zeros_like(x)], axis=1), np.zeros_like(x))
    response = fills[:, fills.shape[1] // 2, fills.shape[2] // 2] / sliver
    assert np.sum(response * np.cos(np.pi * x)) / 32 == pytest.approx(float(mtf_at_nyquist(0.8)), abs=2e-5)


def test_averaged_frames_by_a_simulated_detector():
    """1e6 numbers, each the mean of 4 readings: Poisson + normal + rounding; |z| < 5, false failure 6e-7.

    LSB 60 electrons are half a sigma, where rounding is uniform to far below the standard error.
    """
    rng = np.random.default_rng(3131)
    n, g, level = 1_000_000, 1000.0, 9.0
    raw = rng.poisson(g * level, (4, n)) + rng.normal(0, 40, (4, n)) + rng.uniform(-30, 30, n)
    for averaged, rounded in (
        ("after recording", (np.round(raw / 60) * 60).mean(axis=0)),
        ("before recording", np.round(raw.mean(axis=0) / 60) * 60),
    ):
        op = SensorOperation(frames_averaged=4, averaged=averaged)
        expected = averaged_noise(model(), op).variance(np.full(4, level), calibration=False)[0] * g**2
        # The uniform offset that all readings share smooths the rounding; its own variance is 60^2 / 12.
        found = rounded.var() - 60**2 / 12
        assert abs(found - expected) < 5 * (expected + 300) * np.sqrt(2 / n)


def test_averaged_calibration_error_by_hand():
    # C_R belongs to a detector element: 3 pixels across the track average it, 2 along and 5 frames do not.
    op = SensorOperation(frames_averaged=5, spatial_binning=(2, 3))
    one, many = model().breakdown(np.full(4, 5.0)), averaged_noise(model(), op).breakdown(np.full(4, 5.0))
    assert many.shot == pytest.approx(one.shot / 30)
    assert many.fixed == pytest.approx(one.fixed / 30)
    assert many.quantisation == pytest.approx(one.quantisation / 30)
    assert many.calibration == pytest.approx(one.calibration / 3)


def test_binned_bands_by_hand():
    axis = SpectralAxis(np.array([500.0, 510.0, 520.0, 530.0, 540.0]), np.full(5, 9.0), np.array([1, 1, 1, 0, 1]) > 0)
    found = binned_axis(axis, 2)
    # Two bands 10 nm apart: sigma^2 = (9 / 2.35482)^2 + 25 = 39.607, FWHM 14.820.
    assert found.centre_nm == pytest.approx([505.0, 525.0])
    assert found.fwhm_nm == pytest.approx([14.820, 14.820], rel=1e-4)
    assert list(found.good) == [True, False]
    # Electrons 3000 and 2000 per unit, two readings of 40 electrons each: variance 3200.
    noise = binned_noise(model(), 2)
    assert noise.electrons_per_radiance == pytest.approx([3000.0, 2000.0])
    assert noise.fixed_noise**2 == pytest.approx([3200.0, 3200.0])
    assert noise.lsb_electrons**2 == pytest.approx([7200.0, 7200.0])
    # C_R of independent bands: 0.5 % sqrt((1/3)^2 + (2/3)^2) = 0.37268 %.
    assert noise.calibration_percent[0] == pytest.approx(0.372678, rel=1e-5)


def test_other_numbers_than_the_files_by_hand():
    # Twice the light, half the fixed noise: 20^2 / 2000^2 of fixed noise. Two bits less: steps of 4 x 60 electrons.
    found = changed_noise(model(), SensorChanges(signal_factor=2, fixed_noise_factor=0.5, bits=10))
    assert found.breakdown(np.full(4, 8.0)).fixed[0] == pytest.approx(20**2 / 2000**2)
    assert found.breakdown(np.full(4, 8.0)).quantisation[0] == pytest.approx(240**2 / 12 / 2000**2)
    other = changed_noise(model(), SensorChanges(calibration_error_percent=2))
    assert other.breakdown(np.full(4, 8.0)).calibration == pytest.approx(np.full(4, 0.16**2))


def test_binned_measured_noise_is_the_mean_of_equal_bands():
    # Equal bands: the variance of a mean of three is a third, whatever c.
    one = model(  # a = 0.01, b = 1.2
        electrons_per_radiance=np.full(3, 1e4), fixed_noise=np.full(3, 100 * np.sqrt(1.2)), constant=np.full(3, 2e-3),
        lsb_electrons=np.zeros(3), calibration_percent=np.zeros(3),
    )  # fmt: skip
    found = binned_noise(one, 3).variance(np.full(1, 5.0))
    assert found == pytest.approx(one.variance(np.full(3, 5.0))[:1] / 3, rel=1e-12)
