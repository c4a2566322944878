"""Sensor files: the library, evaluation on other axes, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from hyperval import sensor as door
from hyperval.envi_header import read_header
from hyperval.errors import InputError, UsageError
from hyperval.sensor import NoiseModel, Sensor, SensorOperation, SensorSpecification, library_names, load_sensor
from hyperval.spectra import SpectralAxis

# Radiance of a 0.25 reflector under a 45 degree sun without atmosphere, 0.25 E0 cos 45 / pi.
WAVELENGTH = np.array([450.0, 550, 650, 850, 1050, 1250, 1650, 2200])
RADIANCE = np.array([11.21, 10.64, 8.92, 5.43, 3.71, 2.53, 1.28, 0.466])
SOURCE = "assumed: for tests"
Q = {"source": SOURCE}
ONE = {"value": 1.0, **Q}


@pytest.mark.parametrize("name", library_names())
def test_a_library_sensor_is_complete(name):
    sensor = load_sensor(name)
    noise = sensor.noise()
    level = np.interp(sensor.axis.centre_nm, WAVELENGTH, RADIANCE)
    snr = noise.snr(level)
    assert np.all((snr > 1) & (snr < 1000))
    assert np.all(snr <= 100 / noise.calibration_percent)  # C_R caps the SNR
    assert np.all(noise.snr(level, calibration=False) > snr)


def test_the_detectors_of_prospectir_are_told_by_width():
    """Narrow bands have the VNIR's noise in both sets, those of 939 to 985 nm in the set of 2012 too."""
    for name, narrow, last in (("prospectir-vs", 117, 935.78), ("prospectir-vs-2012", 126, 985.4)):
        sensor = load_sensor(name)
        vnir = sensor.axis.fwhm_nm < 5.5
        assert vnir.sum() == narrow
        assert sensor.axis.centre_nm[vnir].max() == last
        assert np.array_equal(sensor.noise().fixed_noise == 60.0, vnir)


def test_electrons_scale_with_the_width_of_another_axis():
    sensor, centre = load_sensor("prospectir-vs"), np.array([550.0, 1600.0])
    narrow, wide = (sensor.noise(SpectralAxis(centre, np.full(2, w))).electrons_per_radiance for w in (5.0, 10.0))
    assert wide == pytest.approx(2 * narrow)


def test_unknown_name_and_missing_file(tmp_path):
    with pytest.raises(UsageError, match="unknown sensor 'aviris'"):
        load_sensor("aviris")
    with pytest.raises(InputError, match="no such file"):
        load_sensor(tmp_path / "none.yaml")


def arm(**changes) -> dict:
    return {
        "name": "a", "range_nm": [400, 1000], "throughput": {"convention": "value", "cm2_sr": 1e-6, **Q},
        "optical_transmittance": {**Q, "value": 0.5}, "quantum_efficiency": {**Q, "value": 0.5},
        "integration_time_s": {**Q, "value": 0.01}, "fixed_noise_electrons": {**Q, "value": 20}, "bits": 12,
        "full_well_electrons": {**Q, "value": 1e5}, **changes,
    }  # fmt: skip


def sensor_of(**changes) -> Sensor:
    bands = {"regular": {"first_nm": 400, "step_nm": 10, "count": 5, "fwhm_nm": 10}, **Q}
    base = {"schema": 1, "name": "x", "title": "x", **Q, "bands": bands, "arms": [arm()]}
    return Sensor(SensorSpecification.model_validate({**base, "calibration_error_percent": ONE, **changes}))


def noise_of(**changes) -> NoiseModel:
    return sensor_of(arms=[arm(**changes)]).noise()


SENSELESS = ("integration_time_s", 0.0), ("bit_error_rate", -1.0), ("full_well_electrons", 1e308)


@pytest.mark.parametrize(("name", "value"), SENSELESS)
def test_a_sensor_without_signal_or_with_boundless_noise_is_not_predicted_with(name, value):
    bands, asked = {"table": [[400, 10, 0], [410, 10, 1]], **Q}, (None, None, None, {})
    with pytest.raises(UsageError, match=r"no signal, or noise beyond any number, at 410 nm"):  # 400 nm is a bad band
        sensor_of(arms=[arm(**{name: {"value": value, **Q}})], bands=bands).operated_noise(*asked)


def two_arms(**second) -> Sensor:
    bands = {"regular": {"first_nm": 500, "step_nm": 100, "count": 10, "fwhm_nm": 10}, **Q}
    return sensor_of(bands=bands, arms=[arm(), arm(name="b", range_nm=[1000, 1500], **second)])


def test_two_ways_to_say_the_least_significant_bit_and_the_full_scale():
    by_well = noise_of()
    assert by_well.lsb_electrons == pytest.approx(np.full(5, 1e5 / 4096))
    assert by_well.full_scale == pytest.approx(1e5 / by_well.electrons_per_radiance)
    assert by_well.full_scale_fraction(1.5 * by_well.full_scale) == pytest.approx(np.full(5, 1.5))
    by_radiance = noise_of(full_well_electrons=None, saturation_radiance={**Q, "value": 30.0})
    assert by_radiance.lsb_electrons == pytest.approx(30.0 * by_radiance.electrons_per_radiance / 4096)
    assert by_radiance.full_scale == pytest.approx(np.full(5, 30.0))
    assert np.all(np.isnan(load_sensor("emit").noise().full_scale_fraction(np.ones(285))))


def test_noise_terms_of_a_file():
    m, level = noise_of(bit_error_rate={**Q, "value": 1e-6}), np.linspace(0.5, 12.0, 5)
    b = m.breakdown(level)
    assert np.all(b.fit == 0)
    assert b.shot == pytest.approx(level / m.electrons_per_radiance)
    assert b.bit_errors / b.quantisation == pytest.approx(np.full(5, 12 * 1e-6 * (4.0**12 - 1) / 3))
    b = load_sensor("aviris-c").noise().breakdown(np.full(219, 3.0))  # whose c is not 0
    assert (b.fit.any(), b.quantisation.any()) == (True, False)


def test_arms_that_differ_in_bits_and_bit_errors():
    m = two_arms(bits=14, bit_error_rate={**Q, "value": 1e-6}).noise()
    assert m.lsb_electrons[[0, -1]] == pytest.approx([1e5 / 4096, 1e5 / 16384])
    b = m.breakdown(np.full(10, 5.0))
    assert b.bit_errors[0] == 0
    expected = (1e5 / 16384) ** 2 * 1e-6 * (4.0**14 - 1) / 3 / m.electrons_per_radiance[-1] ** 2
    assert b.bit_errors[-1] == pytest.approx(expected, rel=1e-12)


def test_shift_of_one_arm_moves_its_bands_alone():
    s = two_arms()
    true = s.true_axis(s.axis, SensorOperation(wavelength_shift_nm={"b": -1.5}))
    assert true.centre_nm - s.axis.centre_nm == pytest.approx(np.where(s.axis.centre_nm > 1000, -1.5, 0.0))
    assert s.true_axis(s.axis) is s.axis
    with pytest.raises(UsageError, match="has no arm 'c'"):
        s.true_axis(s.axis, SensorOperation(wavelength_shift_nm={"c": 1.0}))


def test_smile_is_a_polynomial_across_the_track():
    s = load_sensor(Path(__file__).with_name("smile.yaml"))

    def shift(column: float | None) -> float:
        moved = s.true_axis(s.axis, SensorOperation(column=column)).centre_nm - s.axis.centre_nm
        assert not moved[s.axis.centre_nm > 1000].any()
        return float(moved[0])

    # At the ends x = -1 and 1: 0.2 -+ 0.1 + 0.4; in the middle 0.2; at 3/4 x = 0.5: 0.2 + 0.05 + 0.1.
    assert [shift(c) for c in (0, 100, 50, 75, None)] == pytest.approx([0.5, 0.7, 0.2, 0.35, 0.2])
    with pytest.raises(UsageError, match=r"sensor_operation\.column: column 101 lies outside 0-100"):
        shift(101)


def test_an_arm_serves_fifty_nanometres_beyond_its_range_and_no_more():
    sensor = load_sensor("hydice")
    low = min(arm.range_nm[0] for arm in sensor.specification.arms)
    assert sensor.arm_index(np.array([low - 50.0])).size == 1
    with pytest.raises(UsageError, match="has no arm at"):
        sensor.arm_index(np.array([low - 50.1]))


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "file", "electrons"),
    [
        ("emit", "emit_noise", 298.0), ("aviris-ng", "avirisng_noise", 112.0), ("sbg", "sbg_noise_coeffs", 84.0),
        ("tanager", "tanager1_noise_20241016", 146.0), ("aviris-c", "avirisc_noise", 132.0),
    ],
)  # fmt: skip
def test_library_follows_the_published_file(name, file, electrons, data_dir):
    rows = np.loadtxt(data_dir(f"sensors/{file}.txt"))[:, :4]
    w, a, b, c = rows[np.argsort(rows[:, 0])].T
    fixed = np.sqrt(b) / a
    assert round(float(np.median(fixed))) == electrons
    # Through electrons it is the noise formula where c is 0: no (a, b, c) in it.
    clear, zero = c == 0, np.zeros(np.sum(c == 0))
    assert (name == "aviris-c") == (clear.sum() < 18)
    through = NoiseModel(1 / a[clear] ** 2, fixed[clear], 1.0, zero, 1, 0.0, zero)
    for level in (0.01, 1.0, 20.0):
        snr = level / np.abs(a * np.sqrt(b + level))[clear]
        assert through.snr(np.full(zero.size, level)) == pytest.approx(snr, rel=1e-6)
    flat = np.abs(fixed / np.median(fixed) - 1) < 0.25
    apart = np.diff(w, prepend=0) > (7 if name == "aviris-c" else 4)  # outside the overlap of its spectrometers
    keep = flat & apart & (np.roll(apart, -1)) & (w < 2500)
    found = load_sensor(name).noise(SpectralAxis(w[keep], np.full(int(keep.sum()), 5.0)))
    nedl = np.abs(a * np.sqrt(b + 2.0) + c)[keep]
    error = np.abs(np.sqrt(found.variance(np.full(keep.sum(), 2.0), calibration=False)) / nedl - 1)
    assert np.quantile(error, 0.95) < 0.06
    assert np.median(error) < 0.03


@pytest.mark.data
def test_bands_of_prospectir_against_the_published_ones(data_dir):
    rows = np.genfromtxt(data_dir("sensors/prospectir_vs_bands_2010.csv"), delimiter=",", skip_header=1)
    axis = load_sensor("prospectir-vs").axis
    assert axis.centre_nm == pytest.approx(rows[:, 1] * 1000, abs=1e-6)
    assert axis.fwhm_nm == pytest.approx(rows[:, 2] * 1000, abs=1e-3)
    assert np.array_equal(axis.good, rows[:, 3] > 0)
    header = read_header(data_dir("share2012-felt/images/avon_reflectance.hdr"))
    axis = load_sensor("prospectir-vs-2012").axis
    assert len(axis) == 360
    for own, stated in ((axis.centre_nm, header.numbers("wavelength")), (axis.fwhm_nm, header.numbers("fwhm"))):
        assert own[axis.good] == pytest.approx(stated * 1000, abs=1e-6)


REFUSED = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text("utf-8"))


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case["words"])
def test_entries_that_contradict_themselves_are_refused(case):
    with pytest.raises(ValidationError, match=case["words"]):
        getattr(door, case["kind"])(**case["entries"], source=SOURCE)
