"""Equations 3.13-3.20 against numbers worked out by hand and simulated detectors."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.sensor import (
    ELECTRONS_PER_UNIT,
    NoiseModel,
    aperture_throughput,
    bit_error_variance,
    calibration_variance,
    electrons_per_radiance,
    f_number_throughput,
    measured_noise_variance,
    quantisation_variance,
    shot_variance,
    signal_to_noise,
    solid_angle,
    with_signal,
)


def test_3_13_electrons_through_the_energy_of_a_photon():
    # L = 6 mW cm-2 sr-1 um-1 = 60 W m-2 sr-1 um-1; A Omega = 9.4e-7 cm2 sr = 9.4e-11 m2 sr; 4.66 nm.
    power = 60 * 9.4e-11 * 4.66e-3  # W
    energy = power * 0.25 * 3e-3  # J after optics and detector in 3 ms
    photon = 6.62607015e-34 * 299792458.0 / 550e-9  # J, 3.612e-19
    g = electrons_per_radiance(
        [550.0],
        [4.66],
        throughput_cm2_sr=9.4e-7,
        optical_transmittance=0.5,
        quantum_efficiency=0.5,
        integration_time_s=3e-3,
    )
    assert 6 * g == pytest.approx([energy / photon], rel=1e-12)
    assert 6 * g[0] == pytest.approx(5.457e4, rel=1e-3)
    assert pytest.approx(5.034e15, rel=1e-4) == ELECTRONS_PER_UNIT


def test_3_14_throughput():
    # 0.1 m aperture: 78.5398 cm2; 1 mrad square: 1e-6 sr.
    assert aperture_throughput(0.1, 1e-3) == pytest.approx(78.53982e-6, rel=1e-6)
    assert aperture_throughput(0.1, 1e-3, obscuration=0.2) == pytest.approx(0.8 * 78.53982e-6, rel=1e-6)
    # The printed cone is pi/4 of the square for a small angle, and 2 pi (1 - cos(theta/2)) for any.
    assert solid_angle(1e-3, "cone") / solid_angle(1e-3) == pytest.approx(np.pi / 4, rel=1e-6)
    assert solid_angle(1.0, "cone") == pytest.approx(2 * np.pi * (1 - np.cos(0.5)), rel=1e-12)
    # F/2.4 behind a 30 um x 24 um slit piece: 7.2e-6 cm2 * pi / 24.04 = 9.409e-7.
    assert f_number_throughput(2.4, 30 * 24) == pytest.approx(9.409e-7, rel=1e-3)


def test_3_15_3_16_by_hand():
    assert shot_variance(5.0, 1000.0) == pytest.approx(5000.0)
    # g_d = 1.5: 2.25 * (5000 + 3600) / 1e6
    parts = physical().breakdown([5.0])
    assert parts.shot + parts.fixed == pytest.approx([0.01935])


def test_3_17_by_hand_and_its_cap_on_snr():
    assert calibration_variance(4.0, 0.5) == pytest.approx(0.0004)
    # With the calibration error alone the SNR is 100 / C_R = 200 at any level.
    assert signal_to_noise([4.0, 9.0], calibration_variance([4.0, 9.0], 0.5)) == pytest.approx([200.0, 200.0])


def test_3_18_by_rounding():
    """1e6 rounded values; s.e. of a uniform law's variance: LSB^2/12 sqrt(0.8/n); |z| < 5, false failure 6e-7."""
    rng = np.random.default_rng(318)
    x = rng.uniform(0, 4095 * 3.0, 1_000_000)
    error = np.round(x / 3.0) * 3.0 - x
    expected = float(quantisation_variance(3.0))
    assert expected == 0.75
    assert abs(error.var() - expected) < 5 * expected * np.sqrt(0.8 / x.size)


def test_3_19_by_flipping_bits():
    """4e6 words of 8 bits, each bit wrong with 1e-3: z from 200 batches, |z| < 5, false failure 1e-6."""
    rng = np.random.default_rng(319)
    n, bits, rate = 4_000_000, 8, 1e-3
    words = rng.integers(0, 2**bits, n, dtype=np.int64)
    flips = np.zeros(n, np.int64)
    for b in range(bits):
        flips |= (rng.random(n) < rate).astype(np.int64) << b
    square = (2.0 * ((words ^ flips) - words)) ** 2  # LSB = 2
    batch = square.reshape(200, -1).mean(axis=1)
    expected = float(bit_error_variance(2.0, bits, rate))
    assert expected == pytest.approx(4 * 1e-3 * 65535 / 3)
    assert abs(batch.mean() - expected) < 5 * batch.std(ddof=1) / np.sqrt(200)


def test_3_20_by_hand():
    assert signal_to_noise(6.0, 0.01935 + 0.0009) == pytest.approx(6 / np.sqrt(0.02025))


def physical(**changes):
    """One band: 1000 electrons per radiance, 60 electrons fixed, LSB of 30 electrons, 12 bits, C_R 0.5 %."""
    values = {
        "electrons_per_radiance": np.array([1000.0]), "detector_gain": 1.5, "fixed_noise": np.array([60.0]),
        "lsb_electrons": np.array([30.0]), "bits": np.array([12]), "bit_error_rate": np.array([1e-9]),
        "calibration_percent": np.array([0.5]),
    }  # fmt: skip
    return NoiseModel(**{**values, **changes})


def by_its_noise(a, b, c):
    """One band of a sensor known by NEdL = |a sqrt(b + L) + c| alone."""
    electrons = {"electrons_per_radiance": np.array([1 / a**2]), "fixed_noise": np.sqrt([b]) / a, "detector_gain": 1.0}
    return physical(constant=np.array([c]), lsb_electrons=np.zeros(1), **electrons)


def test_3_13_to_3_19_every_term_of_a_sensor_by_hand():
    parts = physical().breakdown([5.0])
    assert parts.shot == pytest.approx([2.25 * 5000 / 1e6])
    assert parts.fixed == pytest.approx([2.25 * 3600 / 1e6])
    assert parts.quantisation == pytest.approx([900 / 12 / 1e6])
    assert parts.bit_errors == pytest.approx([900e-9 * (4**12 - 1) / 3 / 1e6])
    assert parts.calibration == pytest.approx([0.025**2])
    assert physical().variance([5.0]) == pytest.approx(parts.total)


def test_3_13_to_3_18_a_sensor_by_a_simulated_detector():
    """1e6 readings of one pixel: Poisson, normal, rounded; |z| < 5, false failure 6e-7."""
    rng = np.random.default_rng(316)
    n = 1_000_000
    electrons = rng.poisson(5000, n) + rng.normal(0, 60, n)
    radiance = np.round(electrons / 30) * 30 / 1000
    steady = physical(detector_gain=1.0, bit_error_rate=np.zeros(1))
    expected = float(steady.variance([5.0], calibration=False)[0])
    assert abs(radiance.var() - expected) < 5 * expected * np.sqrt(2 / n)


def test_3_13_more_signal_by_hand():
    # Twice the electrons: L/g of the photons halves, (sigma_f/g)^2 and the rest of the word go down fourfold.
    before, after = physical().breakdown([5.0]), with_signal(physical(), 2.0).breakdown([5.0])
    for name, factor in (("shot", 2), ("fixed", 4), ("quantisation", 4), ("bit_errors", 4), ("calibration", 1)):
        assert getattr(after, name) * factor == pytest.approx(getattr(before, name))
    # A measured sensor |a sqrt(b + L)| has g = 1/a^2: the photons' part a^2 L halves, a^2 b goes down fourfold.
    for c in (0.0, 0.01):  # a constant goes as the fixed noise: half of it
        found = with_signal(by_its_noise(0.02, 3.0, c), 2.0).variance([5.0], calibration=False)[0]
        assert found == pytest.approx((0.02 * np.sqrt(5 / 2 + 3 / 4) + c / 2) ** 2)


def test_3_16_recorded_with_a_gain_and_an_offset_by_hand():
    # L' = 1.1 L + 0.5 = 6: L = 5, whose variance is multiplied by 1.21; half of the noise, a quarter of that.
    off = physical(gain=1.1, offset=0.5, factor=0.5)
    assert off.variance([6.0]) == pytest.approx(1.21 * 0.25 * physical().variance([5.0]), rel=1e-12)
    assert off.breakdown([6.0]).shot == pytest.approx([1.21 * 0.25 * 2.25 * 5000 / 1e6])


def test_measured_noise_is_the_physical_model():
    # a = 0.01, b = 1.2: G = 1e4, sigma_f = sqrt(1.2)/0.01 = 109.54 electrons.
    assert measured_noise_variance(5.0, 0.01, 1.2, 0.0) == pytest.approx(1e-4 * 6.2)
    for c in (0.0, 0.002):
        found = by_its_noise(0.01, 1.2, c).variance([5.0], calibration=False)
        assert found == pytest.approx((1e-2 * np.sqrt([6.2]) + c) ** 2, rel=1e-12)
