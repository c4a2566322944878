"""Sensor files: the library, evaluation on other axes, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.envi_header import read_header
from hyperval.errors import InputError, UsageError
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import Sensor, SensorSpecification, library_names, load_sensor
from hyperval.spectra import SpectralAxis

# Radiance of a 0.25 reflector under a 45 degree sun without atmosphere, 0.25 E0 cos 45 / pi.
WAVELENGTH = np.array([450.0, 550, 650, 850, 1050, 1250, 1650, 2200])
RADIANCE = np.array([11.21, 10.64, 8.92, 5.43, 3.71, 2.53, 1.28, 0.466])


@pytest.mark.parametrize("name", library_names())
def test_a_library_sensor_is_complete(name):
    sensor = load_sensor(name)
    noise = sensor.noise()
    level = np.interp(sensor.axis.centre_nm, WAVELENGTH, RADIANCE)
    snr = noise.snr(level)
    assert np.all(np.isfinite(snr))
    assert np.all((snr > 1) & (snr < 1000))
    assert np.all(snr <= 100 / noise.calibration_percent)  # C_R caps the SNR
    assert np.all(noise.snr(level, calibration=False) > snr)


def test_prospectir_has_its_header_bands():
    axis = load_sensor("prospectir-vs").axis
    assert (len(axis), int(axis.good.sum())) == (360, 254)
    assert axis.centre_nm[[0, 116, 117, -1]] == pytest.approx([395.27, 935.78, 942.33, 2469.96])
    bad = np.flatnonzero(~axis.good) + 1
    expected = [*range(114, 124), *range(143, 154), *range(182, 198), *range(253, 281), *range(320, 361)]
    assert bad.tolist() == expected


def test_prospectir_noise_is_marked_assumed():
    words = " ".join(load_sensor("prospectir-vs").noise().assumed)
    for name in (
        "quantum_efficiency",
        "optical_transmittance",
        "fixed_noise_electrons",
        "calibration_error_percent",
    ):
        assert name in words


def test_aviris_ng_fixed_noise_is_flat():
    # The rows of the file were chosen within 3 % of the median of all published bands, 111.8 electrons.
    noise = load_sensor("aviris-ng").noise()
    assert np.median(noise.fixed_noise) == pytest.approx(111.8, rel=0.01)
    assert noise.fixed_noise == pytest.approx(np.full(425, 111.8), rel=0.03)


@pytest.mark.data
def test_aviris_ng_against_the_published_coefficients(data_dir):
    rows = np.loadtxt(data_dir("sensors/avirisng_noise.txt"))
    level = np.interp(rows[:, 0], WAVELENGTH, RADIANCE)
    published = level / np.abs(rows[:, 1] * np.sqrt(rows[:, 2] + level) + rows[:, 3])
    on = SpectralAxis(rows[:, 0], np.full(len(rows), 5.8))
    found = load_sensor("aviris-ng").noise(on).snr(level, calibration=False)
    clear = np.abs(np.sqrt(rows[:, 2]) / rows[:, 1] / 111.8 - 1) < 0.05
    assert np.sqrt(np.mean((found / published - 1)[clear] ** 2)) < 0.02


@pytest.mark.data
def test_prospectir_against_the_header_table(data_dir):
    rows = np.genfromtxt(data_dir("sensors/prospectir_vs_bands_2010.csv"), delimiter=",", skip_header=1)
    axis = load_sensor("prospectir-vs").axis
    assert axis.centre_nm == pytest.approx(rows[:, 1] * 1000, abs=1e-6)
    assert axis.fwhm_nm == pytest.approx(rows[:, 2] * 1000, abs=1e-3)
    assert np.array_equal(axis.good, rows[:, 3] > 0)


@pytest.mark.data
def test_prospectir_of_2012_against_the_header_of_avon(data_dir):
    header = read_header(data_dir("share2012-felt/images/avon_reflectance.hdr"))
    axis = load_sensor("prospectir-vs-2012").axis
    centre, width = header.numbers("wavelength"), header.numbers("fwhm")
    assert centre is not None
    assert width is not None
    assert len(axis) == 360
    assert axis.centre_nm[axis.good] == pytest.approx(centre * 1000, abs=1e-6)
    assert axis.fwhm_nm[axis.good] == pytest.approx(width * 1000, abs=1e-6)


def test_the_detectors_of_prospectir_are_told_by_width():
    """Narrow bands have the VNIR's noise in both sets, those of 939 to 985 nm in the set of 2012 too."""
    for name, narrow, last in (("prospectir-vs", 117, 935.78), ("prospectir-vs-2012", 126, 985.4)):
        sensor = load_sensor(name)
        vnir = sensor.axis.fwhm_nm < 5.5
        assert vnir.sum() == narrow
        assert sensor.axis.centre_nm[vnir].max() == last
        assert np.array_equal(sensor.noise().fixed_noise == 60.0, vnir)


def test_electrons_scale_with_the_width_of_another_axis():
    sensor = load_sensor("prospectir-vs")
    centre = np.array([550.0, 1600.0])
    narrow = sensor.noise(SpectralAxis(centre, np.array([5.0, 5.0])))
    wide = sensor.noise(SpectralAxis(centre, np.array([10.0, 10.0])))
    assert wide.electrons_per_radiance == pytest.approx(2 * narrow.electrons_per_radiance)


def test_an_axis_beyond_the_sensor():
    with pytest.raises(UsageError, match="no arm at 1600 nm"):
        load_sensor("hyspex-vnir-1600").noise(SpectralAxis(np.array([1600.0]), np.array([5.0])))


def test_unknown_name_and_missing_file(tmp_path):
    with pytest.raises(UsageError, match="unknown sensor 'aviris'"):
        load_sensor("aviris")
    with pytest.raises(InputError, match="no such file"):
        load_sensor(tmp_path / "none.yaml")


def arm(**changes) -> dict:
    q = {"value": 0.5, "source": "assumed"}
    return {
        "name": "a", "range_nm": [400, 1000],
        "throughput": {"convention": "value", "cm2_sr": 1e-6, "source": "assumed"},
        "optical_transmittance": q, "quantum_efficiency": q, "integration_time_s": {**q, "value": 0.01},
        "fixed_noise_electrons": {**q, "value": 20}, "bits": 12, "full_well_electrons": {**q, "value": 1e5},
        **changes,
    }  # fmt: skip


def specification(**changes) -> dict:
    base = {
        "schema": 1, "name": "x", "title": "x", "source": "assumed",
        "bands": {"regular": {"first_nm": 400, "step_nm": 10, "count": 5, "fwhm_nm": 10}, "source": "assumed"},
        "arms": [arm()], "calibration_error_percent": {"value": 1.0, "source": "assumed"},
    }  # fmt: skip
    return {**base, **changes}


def noise_of(**changes) -> NoiseModel:
    return Sensor(SensorSpecification.model_validate(specification(arms=[arm(**changes)]))).noise()


def test_three_ways_to_say_the_least_significant_bit():
    q = {"source": "assumed"}
    by_well = noise_of()
    assert by_well.lsb_electrons == pytest.approx(np.full(5, 1e5 / 4096))
    given = noise_of(full_well_electrons=None, lsb_electrons={**q, "value": 7.0})
    assert given.lsb_electrons == pytest.approx(np.full(5, 7.0))
    by_radiance = noise_of(full_well_electrons=None, saturation_radiance={**q, "value": 30.0})
    assert by_radiance.lsb_electrons == pytest.approx(30.0 * by_radiance.electrons_per_radiance / 4096)


def test_noise_is_the_sum_of_its_parts():
    q = {"source": "assumed"}
    m = noise_of(bit_error_rate={**q, "value": 1e-6})
    g, level = m.electrons_per_radiance[0], 5.0
    lsb = 1e5 / 4096
    expected = (g * level + 400 + lsb**2 / 12 + lsb**2 * 1e-6 * (4.0**12 - 1) / 3) / g**2 + (0.01 * level) ** 2
    assert m.variance(np.full(5, level))[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"arms": []}, "either arms or measured_noise"),
        ({"arms": [arm(lsb_electrons={"value": 1.0, "source": "assumed"})]}, "give one of full_well"),
        ({"arms": [arm(throughput={"convention": "slit", "f_number": 2.0, "source": "assumed"})]}, "slit_width_um"),
        ({"arms": [arm(optical_transmittance={"value": 0.5})]}, "source"),
        ({"calibration_error_percent": {"source": "assumed"}}, "either value or table"),
        ({"arms": [], "measured_noise": {"table": [[400, -1, 1, 0], [500, 1, 1, 0]], "source": "x y"}}, "positive"),
    ],
)
def test_incomplete_specifications(change, words):
    with pytest.raises(ValueError, match=words):
        SensorSpecification.model_validate(specification(**change))


def test_every_number_of_the_library_has_a_source():
    for name in library_names():
        spec = load_sensor(name).specification
        assert len(spec.bands.source) >= 3
        for each in spec.arms:
            for value in (each.throughput, each.optical_transmittance, each.quantum_efficiency):
                assert len(value.source) >= 3
