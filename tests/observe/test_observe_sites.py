"""Collected spectra of sites, and the top-of-atmosphere reflectance of a network's day."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from pydantic import ValidationError
from small_world import AXIS, BANDS

from hyperval import api
from hyperval.atmosphere import AtmosphericTerms
from hyperval.campaign import dry_run, summary
from hyperval.collection import RadCalNetSource
from hyperval.compare import compare_spectra
from hyperval.errors import InputError, UsageError
from hyperval.model import Origins, predict
from hyperval.observe import detector_covariance, observe_radcalnet
from hyperval.products import SpectralEstimate
from hyperval.scenario import Scenario
from hyperval.sensor import load_sensor
from hyperval.spectra import SpectralAxis


def test_collected_spectra_become_radiance(lawn):
    observation = lawn.observe().observation
    found = observation.radiance["lawn"]
    assert observation.axis.centre_nm == pytest.approx(AXIS.centre_nm)
    assert observation.axis.fwhm_nm == pytest.approx(2.0)
    assert (found.mean, found.n) == (pytest.approx(np.linspace(12.0, 1.0, BANDS)), 9)
    assert found.standard_uncertainty == pytest.approx(0.02 * found.mean)
    assert found.pixel_covariance is None
    lawn.collection["spectra"][0]["unit"] = "W m-2 sr-1 um-1"
    assert lawn.observe().observation.radiance["lawn"].mean[0] == pytest.approx(1.2)


def test_noise_of_the_detector_goes_with_the_pixels_averaged(lawn):
    sensor, level = load_sensor("aviris-ng"), np.full(BANDS, 5.0)
    one, many = (detector_covariance(level, AXIS, sensor, n) for n in (1, 100))
    assert many * 100 == pytest.approx(one)
    g, fixed, c = (getattr(sensor.noise(AXIS), k)[3] for k in ("electrons_per_radiance", "fixed_noise", "constant"))
    assert np.sqrt(one[3, 3]) == pytest.approx(abs(np.sqrt(5.0 / g + (fixed / g) ** 2) + c))
    lawn.collection["detector"] = "aviris-ng"
    found = lawn.observe().observation
    noise = np.diag(detector_covariance(found.radiance["lawn"].mean, found.axis, sensor, 9))
    assert found.radiance["lawn"].budget["detector noise"] ** 2 == pytest.approx(noise)


def test_a_field_spectrometers_radiance_is_averaged_over_the_bands(lawn):
    heading = "Wavelength (nm)\tRadiance (W/m^2/sr/nm)\n"
    rows = [f"{w:g}\t{0.1 - 2e-5 * (w - 400):.8f}\n" for w in np.arange(400.0, 1701.0, 1.0)]
    lawn.text("lawn.txt", heading + "".join(rows))
    observation = lawn.observe().observation
    # A straight line keeps its value at the centre of a symmetric band; 1 W m-2 is 100 uW cm-2.
    assert observation.radiance["lawn"].mean == pytest.approx(10.0 - 2e-3 * (AXIS.centre_nm - 400), rel=1e-6)
    assert "lawn: 1301 samples averaged over the 8 bands" in observation.notes
    for part, message in ((rows[60:], r"lawn\.txt: 1241 wavelengths that are not those of the band table"),
                          (rows[50:], "the spectrum does not cover 1 bands, first 450 nm")):  # fmt: skip
        lawn.text("lawn.txt", heading + "".join(part))
        with pytest.raises(InputError, match=message):
            lawn.observe()
    lawn.collection["spectra"][0]["unit"] = "uW cm-2 sr-1 nm-1"
    with pytest.raises(UsageError, match="the file states radiance in W m-2 sr-1 nm-1"):
        lawn.observe()


def test_bands_without_widths_take_the_spacing(lawn):
    del lawn.collection["bands"]["fwhm_column"]
    assert any("band widths are taken as the band spacing" in note for note in lawn.observe().observation.notes)


THREE = SpectralAxis(np.array([500.0, 600.0, 700.0]), np.full(3, 10.0))
STATE = {
    "sensor_altitude_km": 800.0, "solar_zenith_deg": 40.0, "solar_azimuth_deg": 0.0, "day_of_year": 100,
    "aerosol": "none",
}  # fmt: skip


def terms(state) -> AtmosphericTerms:
    """Sunlight of 100, of which the air sends back 0.1, and 0.9 reach the ground and 0.8 of that come back."""
    grid = np.arange(400.0, 801.0, 5.0)
    one = np.ones(grid.size)
    white = 100.0 * one * (0.5 if state.sun[0] > 50.0 else 1.0)
    return AtmosphericTerms(
        grid, 0.1 * white, 0.6 * white, 0.12 * white, 0.2 * one, white, one, diffuser_radiance=white
    )


def predicted(truth=None, **changes):
    """What is predicted for sand of 0.25 at the top of the atmosphere."""
    plain = {
        "schema": 1, "name": "s", "atmosphere": STATE, "processing": {"elm": "none", "detectors": []},
        "scene": {"classes": [{"name": "sand", "fraction": 1.0, "spectrum": {"constant": 0.25}}]},
    }  # fmt: skip
    return predict(Scenario.model_validate(plain | changes), Origins(axis=THREE, engine=terms), truth=truth or {})


def test_top_of_atmosphere_reflectance_is_what_comes_back_of_the_light_outside():
    plain = predicted()
    found = plain.toa_reflectance["sand"].mean
    assert found == pytest.approx(0.1 + 0.72 * 0.25 / (1.0 - 0.2 * 0.25))
    assert plain.radiance["sand"].mean == pytest.approx(100.0 * found)
    low = predicted(atmosphere={**STATE, "solar_zenith_deg": 60.0})
    assert low.toa_reflectance["sand"].mean == pytest.approx(found)
    # The level of the sunlight cancels and the path does not.
    for truth, gain in (({"light.irradiance": 1.05}, 0.0), ({"light.path": 1.1}, 0.01)):
        assert predicted(truth).toa_reflectance["sand"].mean - found == pytest.approx(gain, abs=1e-12)
    budget = {"solar_irradiance_relative": 0.05, "engine": {"relative": 0.0, "path_relative": 0.1}}
    sure = predicted(uncertainty=budget)
    assert sure.toa_reflectance["sand"].standard_uncertainty == pytest.approx(0.01)
    expected = np.hypot(1.0, 0.05 * sure.radiance["sand"].mean)
    assert sure.radiance["sand"].standard_uncertainty == pytest.approx(expected)
    airborne = {**STATE, "sensor_altitude_km": 5.0}  # only from above the atmosphere
    assert predicted(atmosphere=airborne, sensor="aviris-ng").toa_reflectance == {}
    with pytest.raises(ValidationError, match="needs a sensor"):
        predicted(atmosphere=airborne)


def test_bands_inside_the_stated_uncertainty_are_counted():
    seen = SpectralEstimate(np.array([0.2, 0.2, 0.2]), 1e-8 * np.eye(3), stated=np.array([0.01, 0.01, 0.001]))
    made = SpectralEstimate(np.array([0.215, 0.225, 0.2015]), np.zeros((3, 3)))
    rows = compare_spectra(made, seen, THREE, "toa_reflectance")
    assert {r.metric: r.value for r in rows}["fraction_inside_stated"] == pytest.approx(2.0 / 3.0)


@pytest.fixture
def day(tmp_path) -> Path:
    """A day of two half hours, the second without values."""
    state = "P:\t869\t869\nT:\t290\t291\nWV:\t0.5\t0.6\nO3:\t280\t281\nAOD:\t0.1\t0.2\nAng:\t0.5\t9997\n"
    for name, level in (("day.input", 0.25), ("day.output", 0.29)):
        (tmp_path / name).write_text(
            "Site:\tXXXX01\nLat:\t40.5\nLon:\t-109.5\nAlt:\t1270\n\nYear:\t2020\t2020\nDOY(U):\t160\t160\n"
            "UTC:\t18:30\t19:00\nDOY(L):\t160\t160\nLocal:\t11:30\t12:00\n" + state + "Type:\tR\tR\n"
            + "".join(f"{nm}\t{level}\t9998\n" for nm in (500, 600, 700)) + "\n"
            + state.replace("869", "26").replace("9997", "0.1")
            + "".join(f"{nm}\t0.02\t9998\n" for nm in (500, 600, 700))
        )  # fmt: skip
    return tmp_path


def test_half_hours_are_subjects(day):
    found = observe_radcalnet(RadCalNetSource(path="day.output", fwhm_nm=20.0), day.joinpath)
    assert list(found.toa_reflectance) == ["XXXX01 18:30"]
    estimate = found.toa_reflectance["XXXX01 18:30"]
    assert (estimate.mean.tolist(), found.axis.fwhm_nm.tolist()) == ([0.29] * 3, [20.0] * 3)
    # The stated error is common to all bands; four decimals round each by itself.
    assert estimate.error_covariance == pytest.approx(4e-4 + np.eye(3) * 1e-8 / 12.0)
    shared = observe_radcalnet(RadCalNetSource(path="day.output", shared_inputs=True), day.joinpath)
    (estimate,) = shared.toa_reflectance.values()
    assert estimate.error_covariance == pytest.approx(np.eye(3) * 1e-8 / 12.0)
    assert estimate.stated.tolist() == [0.02, 0.02, 0.02]
    with pytest.raises(InputError, match="reflectance of the surface"):
        observe_radcalnet(RadCalNetSource(path="day.input"), day.joinpath)
    with pytest.raises(UsageError, match="19:00 holds no value"):
        observe_radcalnet(RadCalNetSource(path="day.output", times=["19:00"]), day.joinpath)


TEMPLATE = (Path(__file__).parent / "half-hour.yaml").read_text("utf-8")


def test_a_campaign_over_a_day(day, monkeypatch):
    (day / "half-hour.yaml").write_text(TEMPLATE)
    campaign = yaml.safe_load(Path(__file__).with_name("day.yaml").read_text("utf-8"))
    (hours,) = campaign["scenarios"]
    path, states = day / "campaign.yaml", []
    path.write_text(yaml.safe_dump(campaign))
    assert summary(dry_run([path])) == ["day: ready"]
    monkeypatch.setattr("hyperval.model.stated.atmospheric_terms", lambda s, **_: states.append(s) or terms(s))
    table = api.validate(path, show_progress=False).to_dataframe()
    (row,) = table[table["accepted_high"].notna() & (table["metric"] == "bias_ratio")].to_dict("records")
    # The words of the scenario take what the day says.
    state = states[0]
    assert (state.aot550, state.angstrom_exponent, state.time_utc) == (0.1, 0.5, "2020-06-08T18:30:00Z")
    # The state's aerosol is uncertain, and the stand-in does not know it: rounding alone is left.
    assert row["value"] == pytest.approx((0.1 + 0.72 * 0.25 / (1.0 - 0.2 * 0.25)) / 0.29 - 1.0)
    for other, template, error, message in (
        ({"radcalnet": "day.output"}, TEMPLATE, InputError, "top-of-atmosphere"),
        ({"times": ["19:00"]}, TEMPLATE, UsageError, "19:00 holds no value"),
        ({}, TEMPLATE.replace("us-standard-1962", "polar"), UsageError, r"half-hour\.yaml: atmosphere\.model"),
    ):
        (day / "half-hour.yaml").write_text(template)
        path.write_text(yaml.safe_dump(campaign | {"scenarios": [hours | other]}))
        with pytest.raises(error, match=message):
            api.validate(path, show_progress=False)
