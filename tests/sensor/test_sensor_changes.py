"""Sensors whose numbers differ from their file."""

import numpy as np
import pytest

from hyperval.sensor.specification import SensorChanges, changed_noise, load_sensor

NAMES = ["prospectir-vs", "emit"]  # one by its parts, one by its measured noise


@pytest.mark.parametrize("name", NAMES)
def test_no_change_changes_nothing(name):
    noise = load_sensor(name).noise()
    level = np.full(noise.fixed_noise.size, 3.0)
    np.testing.assert_allclose(changed_noise(noise, SensorChanges()).variance(level), noise.variance(level), rtol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_each_term_follows_its_own_number(name):
    noise = load_sensor(name).noise()
    level = np.full(noise.fixed_noise.size, 3.0)
    before = noise.breakdown(level)
    after = changed_noise(noise, SensorChanges(signal_factor=4.0, fixed_noise_factor=3.0)).breakdown(level)
    np.testing.assert_allclose(after.shot, before.shot / 4.0, rtol=1e-12)  # Poisson: variance over mean squared
    np.testing.assert_allclose(after.fixed, before.fixed * 9.0 / 16.0, rtol=1e-12)
    np.testing.assert_allclose(after.calibration, before.calibration, rtol=1e-12)


def test_more_light_fills_the_well_sooner():
    noise = load_sensor("prospectir-vs").noise()
    found = changed_noise(noise, SensorChanges(signal_factor=2.0))
    np.testing.assert_allclose(found.full_scale, noise.full_scale / 2.0)


def test_a_bit_less_doubles_the_step():
    noise = load_sensor("prospectir-vs").noise()
    level = np.full(noise.fixed_noise.size, 3.0)
    fewer = changed_noise(noise, SensorChanges(bits=int(np.max(noise.bits)) - 1))
    ratio = fewer.breakdown(level).quantisation / noise.breakdown(level).quantisation
    np.testing.assert_allclose(ratio, 4.0)
    np.testing.assert_allclose(fewer.lsb_electrons * 2.0**fewer.bits, noise.lsb_electrons * 2.0**noise.bits)


def test_calibration_error_bounds_the_snr():
    noise = changed_noise(load_sensor("emit").noise(), SensorChanges(calibration_error_percent=2.0))
    snr = noise.snr(np.full(noise.fixed_noise.size, 1e6))  # (3.20) at endless light
    np.testing.assert_allclose(snr, 50.0, rtol=1e-3)
