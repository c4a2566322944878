"""predict(): sources of spectra, bands, shifted bands, saturation, engine errors; and what it says it was not told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from uncertain_scene import ATMOSPHERE, AXIS, ORIGINS, SCENE, engine, scenario

from hyperval import model
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.products import PredictedProducts
from hyperval.scenario import Scenario, SpectrumUncertainty, load_scenario
from hyperval.sensor import load_sensor
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class, write_statistics_library


def of(extra: str = ATMOSPHERE, origins: model.Origins = ORIGINS, **replaced: str) -> PredictedProducts:
    return model.predict(scenario(extra, **replaced), origins)


def beside(folder: Path, spectrum: str) -> Scenario:
    """The scene whose grass has its spectrum from a file of a folder."""
    s = scenario(**{"{builtin: grass}": spectrum})
    s._folder = folder
    return s


@pytest.mark.parametrize("mean", ["{builtin: asphalt}", "{constant: 0.2}"], ids=["builtin", "constant"])
def test_measured_tails_come_with_the_measured_covariance(mean):
    """The class mean from elsewhere: `tail_dof: measured` is that of the region whose covariance the class has.

    Fitted tails count where they are asked for, whatever the spread.
    """
    court = replace(builtin_class("soil", AXIS), tail_dof=4.5)

    def dof(words):
        text = SCENE.replace("spectrum: {builtin: asphalt}", f"spectrum: {words}")
        p = model.predict(scenario(scene=text), replace(ORIGINS, measured={"court": court}))
        return p.distribution["asphalt"].tail_dof

    assert dof(f"{mean}, covariance: {{measured: court}}, tail_dof: measured") == 4.5
    for unasked in (f"{mean}, covariance: {{measured: court}}", "{measured: court}, covariance: {relative_sd: 0.1}"):
        assert dof(unasked) == np.inf


def test_spectrum_from_a_file_is_relative_to_the_scenario(tmp_path):
    w = np.arange(340.0, 2601.0, 5.0)
    rows = "\n".join(f"{a:.1f},{0.1 + a / 10000:.5f}" for a in w)
    (tmp_path / "panel.csv").write_text("wavelength_nm,reflectance\n" + rows + "\n")
    text = SCENE.replace("{builtin: grey-panel-30}", "{file: panel.csv, reflectance_unit: fraction}")
    (tmp_path / "s.yaml").write_text(text)
    p = model.predict(load_scenario(tmp_path / "s.yaml"), model.Origins(axis=AXIS))
    assert p.reflectance["panel"].mean == pytest.approx(0.1 + AXIS.centre_nm / 10000, abs=1e-5)


def test_bands_of_the_detectors():
    axis = SpectralAxis(np.array([450.0, 940, 1400, 1650]), np.full(4, 10.0), np.array([True, True, False, True]))
    everything = np.ones(4, bool)
    s = scenario(**{"{drop_bad: false}": "{windows_only: true, ranges: [[400, 1000], [1600, 1700]]}"})
    # 1650 nm lies in a window; 940 nm is a water band; 1400 nm is bad.
    assert model.detection_bands(s, axis, everything).tolist() == [0, 3]


def test_engine_error_grows_with_gas_absorption():
    p = of(ATMOSPHERE + "uncertainty: {engine: {relative: 0.01, per_optical_depth: 0.2, path_relative: 0.1}}\n")
    terms = engine(scenario().atmosphere).at_bands(AXIS)
    estimate = p.radiance["grass"]
    expected = (0.01 - 0.2 * np.log(terms.gas_transmittance)) * (estimate.mean - terms.path_radiance)
    assert estimate.budget["radiative-transfer engine"] == pytest.approx(expected, rel=1e-9)
    assert estimate.budget["engine's path radiance"] == pytest.approx(0.1 * terms.path_radiance, rel=1e-9)


def test_field_spectrum_error_from_its_file():
    surface = model.SurfaceStatistics(
        "x", AXIS, np.full(10, 0.3), np.zeros((10, 10)), 16, "file", standard_deviation=np.full(10, 0.02),
        sampled_deviation=(AXIS.centre_nm, np.full(10, 0.02)),
    )  # fmt: skip
    spread = SpectrumUncertainty(subject="x", from_file=True)
    error = SpectrumUncertainty(subject="x", from_file=True, divisor="standard_error")
    assert model.spectrum_error_rows(spread, surface)[0] == pytest.approx(np.full(10, 0.02))
    assert model.spectrum_error_rows(error, surface)[0] == pytest.approx(np.full(10, 0.02 / 4 * 2.1314495 / 1.9599640))
    with pytest.raises(UsageError, match="how many spectra"):
        model.spectrum_error_rows(error, replace(surface, n=None))


def test_relative_covariance():
    source = "spectrum: {constant: 0.2}, covariance: {relative_sd: 0.1, band_sd: 0.01, correlation_nm: 100}"
    s = scenario("", **{"spectrum: {builtin: asphalt}": source})
    gap = AXIS.centre_nm[:, None] - AXIS.centre_nm[None, :]
    expected = 4e-4 * np.exp(-0.5 * (gap / 100) ** 2) + 1e-4 * np.eye(10)
    assert model.predict(s, model.Origins(axis=AXIS)).reflectance["asphalt"].pixel_covariance == pytest.approx(expected)


@pytest.mark.parametrize("axis", [AXIS, SpectralAxis(np.linspace(450.0, 1700.0, 30), np.full(30, 10.0))])
def test_a_class_from_a_library_is_that_class(tmp_path, axis):
    write_statistics_library(tmp_path / "s.nc", [replace(builtin_class(n, axis), n=500) for n in ("grass", "asphalt")])
    s = beside(tmp_path, "{library: s.nc, record: grass}")
    if axis is not AXIS:
        with pytest.raises(UsageError, match=r"spectrum.library of 'grass'.*2 bands lie outside it \(first 2130 nm\)"):
            model.predict(s, ORIGINS)
        return
    p, q = model.predict(s, ORIGINS), of()
    assert {score.n for score in p.scores.values()} == {None}  # of samples elsewhere, not pixels of the image
    assert p.reflectance["grass"].pixel_covariance == pytest.approx(q.reflectance["grass"].pixel_covariance)
    assert p.roc["tenth", "cem", "pixel"].pd == pytest.approx(q.roc["tenth", "cem", "pixel"].pd)


FINE = SpectralAxis(np.arange(680.0, 780.0, 5.0), np.full(20, 6.0))


def test_shifted_bands_see_the_red_edge_elsewhere():
    full, fine = {"fixed: 0.1": "fixed: 1"}, replace(ORIGINS, axis=FINE)
    nominal = of(origins=fine, **full)
    shifted = of(ATMOSPHERE + "sensor_operation: {wavelength_shift_nm: 5}\n", fine, **full)
    assert np.array_equal(shifted.axis.centre_nm, FINE.centre_nm)  # the labels stay
    # A shift by one band: every band holds what the next one held.
    assert shifted.radiance["grass"].mean[:-1] == pytest.approx(nominal.radiance["grass"].mean[1:], rel=1e-9)
    assert any("+5 to +5 nm off their labels" in n for n in shifted.notes)
    # The detector looks for the spectrum at the labels: the response to the full target is no longer 1.
    assert nominal.scores["tenth", "cem"].mean == pytest.approx(1.0, abs=1e-6)
    assert abs(shifted.scores["tenth", "cem"].mean - 1.0) > 1e-4


def test_saturation_is_said():
    def under(factor: float) -> PredictedProducts:
        origins = replace(ORIGINS, engine=lambda state: replace(engine(state), direct=factor * engine(state).direct))
        return of(origins=origins, **{"fixed: 0.1": "fixed: 1"})

    dim, bright = under(0.1), under(60.0)
    assert not any("SATURATION" in n for n in dim.notes)
    assert max(part.max() for part in dim.full_scale.values()) < 1
    assert bright.full_scale["tenth"].max() > 1
    assert any(n.startswith("warning: SATURATION: tenth passes full scale in") for n in bright.notes)


def test_blur_of_the_sensor_serves_where_a_geometry_states_none():
    fill = "fill: {geometry: {side_m: 1, gsd_m: 1%s}}}"
    s = scenario(**{"fill: {fixed: 0.1}}": fill % ""})
    sensor = load_sensor("prospectir-vs")
    psf = {"fwhm_pixels": (1.2, 0.4), "source": "assumed"}
    blurred = type(sensor)(
        sensor.specification.model_validate({**sensor.specification.model_dump(by_alias=True), "psf": psf})
    )
    found = model.fill_distribution(model.with_sensor_blur(s, blurred).scene.targets[0].subjects[0].fill)
    stated = scenario(**{"fill: {fixed: 0.1}}": fill % ", psf_fwhm_pixels: [1.2, 0.4]"})
    expected = model.fill_distribution(stated.scene.targets[0].subjects[0].fill)
    assert found.mean == pytest.approx(expected.mean, rel=1e-12)
    assert found.mean < model.fill_distribution(s.scene.targets[0].subjects[0].fill).mean


def test_channels_by_list_and_bad_list():
    p = of(**{"bands: {drop_bad: false}": "bands: {channels: [0, 2, 4, 6], bad_channels: [4]}"})
    assert "detectors use 3 of 10 bands" in p.notes


def test_a_spectrum_that_does_not_cover_the_bands_is_refused_by_field_but_for_a_tenth_of_them(tmp_path):
    def notes(last, more=""):
        rows = "".join(f"{w},0.3\n" for w in range(400, last + 1, 5))
        (tmp_path / f"{last}.csv").write_text("wavelength_nm,reflectance\n" + rows)
        short = f"{{file: {last}.csv, reflectance_unit: fraction, wavelength_unit: nm{more}}}"
        return model.predict(beside(tmp_path, short), ORIGINS).notes

    with pytest.raises(UsageError, match=r"scene\.classes\.0\.spectrum of 'grass' does not cover 2 usable bands \("):
        notes(1300)
    assert "detectors use 7 of 10 bands" in notes(1300, ", gaps: allowed")
    assert any("'grass' does not reach 1 usable band (first 2250 nm" in note for note in notes(1700))


def state(**stated: object) -> AtmosphericState:
    given = {"aot550": 0.1, "sensor_altitude_km": 3.0, "solar_zenith_deg": 30.0, "solar_azimuth_deg": 0.0}
    return AtmosphericState.model_validate(given | {"day_of_year": 180} | stated)


@pytest.mark.parametrize(
    # Columns above sea level that the manual of 6S lists for these atmospheres (McClatchey et al. 1972), to 5 %.
    ("standard", "water", "ozone"),
    [("midlatitude-summer", 2.93, 0.319), ("midlatitude-winter", 0.853, 0.395), ("tropical", 4.12, 0.247)],
)
def test_gases_that_are_not_stated_are_named_with_their_columns(standard, water, ozone):
    of_water, of_ozone = model.unstated_notes(state(model=standard))
    assert of_water.startswith(f"water vapour is not stated: that of the standard atmosphere {standard} is used, ")
    assert float(of_water.split()[-3]) == pytest.approx(water, rel=0.05)
    assert of_water.endswith(" g cm-2")
    assert float(of_ozone.split()[-3]) == pytest.approx(ozone, rel=0.05)


def terms(**provenance: object) -> AtmosphericTerms:
    one = np.ones(2)
    return AtmosphericTerms(np.array([500.0, 600.0]), one, one, one, one, one, one, dict(provenance))


def test_a_table_that_replaces_the_stated_sun_says_so():
    own = terms(solar_spectrum="of the table")
    (said,) = model.engine_notes(state(engine="table", table="lut.nc", solar_spectrum="tsis-1"), own)
    assert "solar_spectrum tsis-1, which the scenario states, is not used" in said
    assert model.engine_notes(state(engine="table", table="lut.nc"), own) == []
    assert model.engine_notes(state(solar_spectrum="tsis-1"), terms(solar_spectrum="tsis-1")) == []


def test_bands_beyond_the_solar_spectrum_are_said():
    far = replace(terms(solar_spectrum="tsis-1"), wavelength_nm=np.array([2499.0, 2501.0]))
    (said,) = model.engine_notes(state(), far)
    assert "covers 350-2500 nm: in 1 of 2 bands" in said
    assert "the shape of astm-g173" in said
    assert model.engine_notes(state(), replace(far, provenance={"solar_spectrum": "astm-g173"})) == []


def test_more_air_and_water_than_the_engine_was_compared_with_is_said():
    far = state(sensor_altitude_km=700.0, water_vapour_g_cm2=5.0, solar_zenith_deg=60.0)
    air, water = model.engine_notes(far, terms(engine_ratio=True))
    assert air.startswith("the light path crosses 3 atm of air")
    assert water.startswith("the light path crosses 15 g cm-2 of water vapour")
    assert model.engine_notes(far, terms(engine_ratio=False)) == []
    assert model.engine_notes(state(water_vapour_g_cm2=1.0), terms(engine_ratio=True)) == []
