"""Arms, noise apart, full scale, spectral shift and smile, blur; measured sensors."""

from __future__ import annotations

import numpy as np
import pytest
from test_sensor_library import arm, noise_of, specification

from hyperval.errors import UsageError
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.response import psf_fwhm_from_mtf
from hyperval.sensor.specification import (
    Blur,
    Sensor,
    SensorOperation,
    SensorSpecification,
    binned_axis,
    binned_noise,
    load_sensor,
)
from hyperval.spectra import SpectralAxis

FILES = {
    "emit": ("sensors/emit_noise.txt", 298.0),
    "aviris-ng": ("sensors/avirisng_noise.txt", 112.0),
    "sbg": ("sensors/sbg_noise_coeffs.txt", 84.0),
    "tanager": ("sensors/tanager1_noise_20241016.txt", 146.0),
    "aviris-c": ("sensors/avirisc_noise.txt", 132.0),
}


def sensor(**changes) -> Sensor:
    return Sensor(SensorSpecification.model_validate(specification(**changes)))


def two_arms(**second) -> Sensor:
    bands = {"regular": {"first_nm": 500, "step_nm": 100, "count": 10, "fwhm_nm": 10}, "source": "assumed"}
    return sensor(bands=bands, arms=[arm(), arm(name="b", range_nm=[1000, 1500], **second)])


def test_noise_terms_apart_sum_to_the_total():
    rate = {"value": 1e-6, "source": "assumed"}
    m, level = noise_of(bit_error_rate=rate), np.linspace(0.5, 12.0, 5)
    b = m.breakdown(level)
    assert b.total == pytest.approx(m.variance(level), rel=1e-12)
    assert b.total - b.calibration == pytest.approx(m.variance(level, calibration=False), rel=1e-12)
    assert np.all(b.fit == 0)
    assert b.shot == pytest.approx(level / m.electrons_per_radiance)
    assert b.bit_errors / b.quantisation == pytest.approx(np.full(5, 12 * 1e-6 * (4.0**12 - 1) / 3))


def test_terms_of_measured_noise_with_c():
    m, level = load_sensor("aviris-c").noise(), np.full(219, 3.0)
    b = m.breakdown(level)
    assert b.total == pytest.approx(m.variance(level), rel=1e-9)
    assert np.any(b.fit != 0)
    assert np.all(b.quantisation == 0)


def test_arms_that_differ_in_bits_and_bit_errors():
    m = two_arms(bits=14, bit_error_rate={"value": 1e-6, "source": "assumed"}, bit_error_per="word").noise()
    lsb = m.lsb_electrons * m.electrons_per_radiance**0
    assert lsb[0] == pytest.approx(1e5 / 4096)
    assert lsb[-1] == pytest.approx(1e5 / 16384)
    b = m.breakdown(np.full(10, 5.0))
    assert b.bit_errors[0] == 0
    # Per word of 14 bits: LSB^2 B_e (4^14 - 1) / (3 * 14).
    expected = lsb[-1] ** 2 * 1e-6 * (4.0**14 - 1) / 42 / m.electrons_per_radiance[-1] ** 2
    assert b.bit_errors[-1] == pytest.approx(expected, rel=1e-12)


def test_full_scale_and_saturation():
    m = noise_of()
    assert m.full_scale == pytest.approx(1e5 / m.electrons_per_radiance)
    assert m.full_scale_fraction(1.5 * m.full_scale) == pytest.approx(np.full(5, 1.5))
    q = {"value": 30.0, "source": "assumed"}
    assert noise_of(full_well_electrons=None, saturation_radiance=q).full_scale == pytest.approx(np.full(5, 30.0))
    assert np.all(np.isnan(load_sensor("emit").noise().full_scale_fraction(np.ones(285))))


def test_shift_of_one_arm_moves_its_bands_alone():
    s = two_arms()
    true = s.true_axis(s.axis, SensorOperation(wavelength_shift_nm={"b": -1.5}))
    assert true.centre_nm - s.axis.centre_nm == pytest.approx(np.where(s.axis.centre_nm > 1000, -1.5, 0.0))
    assert s.true_axis(s.axis) is s.axis
    with pytest.raises(UsageError, match="has no arm 'c'"):
        s.true_axis(s.axis, SensorOperation(wavelength_shift_nm={"c": 1.0}))


def test_smile_is_a_polynomial_across_the_track():
    smile = {"shift_nm": 0.2, "smile_nm": [0.1, 0.4], "columns": 101, "source": "assumed"}
    s = sensor(spectral_calibration=[smile])

    def shift(column: float | None) -> float:
        return float(s.true_axis(s.axis, SensorOperation(column=column)).centre_nm[0] - 400.0)

    # At the ends x = -1 and 1: 0.2 -+ 0.1 + 0.4; in the middle 0.2; at 3/4 x = 0.5: 0.2 + 0.05 + 0.1.
    assert [shift(c) for c in (0, 100, 50, 75, None)] == pytest.approx([0.5, 0.7, 0.2, 0.35, 0.2])
    with pytest.raises(UsageError, match=r"sensor_operation\.column: column 101 lies outside 0-100"):
        shift(101)
    with pytest.raises(ValueError, match="smile_nm and columns go together"):
        sensor(spectral_calibration=[{"smile_nm": [0.1], "source": "assumed"}])


def test_blur_by_width_or_by_mtf():
    by_mtf = Blur(mtf_at_nyquist=(0.3, 0.5), source="assumed")
    assert by_mtf.fwhm == pytest.approx(tuple(psf_fwhm_from_mtf([0.3, 0.5])))
    for bad in ({"fwhm_pixels": (1, 1), "mtf_at_nyquist": (0.3, 0.3)}, {}, {"mtf_at_nyquist": (0.7, 0.3)}):
        with pytest.raises(ValueError, match="mtf_at_nyquist"):
            Blur(**bad, source="assumed")
    with pytest.raises(UsageError, match="aperture alone"):
        psf_fwhm_from_mtf(0.7)


def test_bins_of_one_change_nothing_and_a_remainder_is_dropped():
    m = noise_of()
    assert binned_noise(m, 1) is m
    axis = SpectralAxis(np.arange(400.0, 450, 10), np.full(5, 10.0))
    assert len(binned_axis(axis, 2)) == len(binned_noise(m, 2).fixed_noise) == 2


def published(path) -> tuple[np.ndarray, ...]:
    return tuple(np.loadtxt(path)[:, :4].T)


@pytest.mark.data
@pytest.mark.parametrize("name", list(FILES))
def test_fixed_noise_in_electrons_comes_out_of_the_published_file(name, data_dir):
    _, a, b, _ = published(data_dir(FILES[name][0]))
    assert round(float(np.median(np.sqrt(b) / a))) == FILES[name][1]


@pytest.mark.data
@pytest.mark.parametrize("name", ["emit", "aviris-ng", "sbg", "tanager"])
def test_snr_through_electrons_is_the_noise_formula_where_c_is_0(name, data_dir):
    _, a, b, c = published(data_dir(FILES[name][0]))
    a, b = a[c == 0], b[c == 0]
    assert a.size >= 18
    zero = np.zeros(a.size)
    electrons = NoiseModel(1 / a**2, np.sqrt(b) / a, 1.0, zero, 1, 0.0, "bit", zero)  # no (a, b, c) in it
    for level in (0.01, 1.0, 20.0):
        snr = level / np.abs(a * np.sqrt(b + level))
        assert electrons.snr(np.full(a.size, level)) == pytest.approx(snr, rel=1e-6)


@pytest.mark.data
@pytest.mark.parametrize("name", list(FILES))
def test_library_follows_the_published_file(name, data_dir):
    w, a, b, c = published(data_dir(FILES[name][0]))
    order = np.argsort(w)
    w, a, b, c = w[order], a[order], b[order], c[order]
    flat = np.abs(np.sqrt(b) / a / np.median(np.sqrt(b) / a) - 1) < 0.25
    apart = np.diff(w, prepend=0) > (7 if name == "aviris-c" else 4)  # outside the overlap of its spectrometers
    keep = flat & apart & (np.roll(apart, -1)) & (w < 2500)
    found = load_sensor(name).noise(SpectralAxis(w[keep], np.full(int(keep.sum()), 5.0)))
    nedl = np.abs(a * np.sqrt(b + 2.0) + c)[keep]
    error = np.abs(np.sqrt(found.variance(np.full(keep.sum(), 2.0), calibration=False)) / nedl - 1)
    assert np.quantile(error, 0.95) < 0.06
    assert np.median(error) < 0.03
