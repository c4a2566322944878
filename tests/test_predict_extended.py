"""predict(): shade, libraries, shifted bands, saturation, bins, features, detectors; and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.model import Origins, detection_at, fill_distribution, predict
from hyperval.scenario import load_scenario
from hyperval.spectra import SpectralAxis
from hyperval.statistics_library import builtin_class, write_statistics_library
from test_predict import ATMOSPHERE, AXIS, SCENE, engine, run, scenario

SHADE = {"host: asphalt": "host: asphalt\n      illumination: {beam: 0.1, sky_view: 0.8}"}


def sky(state: AtmosphericState) -> AtmosphericTerms:
    terms = engine(state)
    return replace(terms, diffuse_fraction=0.6 * (terms.wavelength_nm / 400) ** -1.5)


def of(extra: str = ATMOSPHERE, use=sky, axis: SpectralAxis | None = AXIS, **replaced: str):
    return predict(scenario(extra, **replaced), Origins(axis=axis, engine=use))


# shade


def test_a_shaded_target_is_darker_and_harder_to_find():
    shaded, lit = of(**SHADE), of()
    terms = sky(scenario().atmosphere).at_bands(AXIS)
    ground = lit.radiance["full"].mean - terms.path_radiance
    assert np.all(shaded.radiance["full"].mean < lit.radiance["full"].mean)
    assert np.all(shaded.radiance["full"].mean > terms.path_radiance)
    assert np.all(ground > 0)
    # Blue sky light: the shade takes less of the blue than of the infrared.
    part = shaded.reflectance["full"].mean / lit.reflectance["full"].mean
    assert part[0] > 1.5 * part[-1]
    assert shaded.reflectance["asphalt"].mean == pytest.approx(lit.reflectance["asphalt"].mean)
    at = [1e-6, 1e-4, 1e-2]
    found = [detection_at(p.roc["tenth", "cem", "pixel"], at) for p in (shaded, lit)]
    assert np.all(found[0] < found[1])


def test_shade_needs_sky_light():
    with pytest.raises(UsageError, match="how much of the light on the ground comes from the sky"):
        of(use=engine, **SHADE)
    with pytest.raises(UsageError, match="illumination: shade needs the light of an atmosphere"):
        of("", **SHADE)


# statistics libraries


def library(tmp_path, axis: SpectralAxis = AXIS, **changes):
    path = tmp_path / "statistics.nc"
    write_statistics_library(path, [replace(builtin_class(n, axis), n=500, **changes) for n in ("grass", "asphalt")])
    return path


FROM_LIBRARY = {"{builtin: grass}": "{library: statistics.nc, record: grass}"}


def in_folder(tmp_path, **replaced: str):
    s = scenario(**replaced)
    s._folder = tmp_path
    return s


def test_a_class_from_a_library_is_that_class(tmp_path):
    library(tmp_path)
    p = predict(in_folder(tmp_path, **FROM_LIBRARY), Origins(axis=AXIS, engine=engine))
    q = run()
    assert p.reflectance["grass"].pixel_covariance == pytest.approx(q.reflectance["grass"].pixel_covariance)
    assert p.roc["tenth", "cem", "pixel"].pd == pytest.approx(q.roc["tenth", "cem", "pixel"].pd)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda c: c + np.triu(np.full_like(c, 1e-3), 1), "not symmetric"),
        (lambda c: c - 2 * np.diag(np.diag(c)), "not positive semi-definite"),
        (lambda c: np.where(np.eye(10) > 0, np.nan, c), "must be finite"),
    ],
)
def test_a_bad_covariance_of_a_library_is_refused_by_field(tmp_path, spoil, words):
    import xarray as xr

    path = library(tmp_path)
    with xr.open_dataset(path, engine="h5netcdf") as data:
        held = data.load()
    held["covariance"][0] = spoil(held["covariance"].values[0])
    path.unlink()
    held.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(UsageError, match=f"spectrum.library of 'grass': .*statistics.nc: .*{words}"):
        predict(in_folder(tmp_path, **FROM_LIBRARY), Origins(axis=AXIS, engine=engine))


def test_a_library_that_does_not_cover_the_bands(tmp_path):
    library(tmp_path, SpectralAxis(np.linspace(450.0, 1700.0, 30), np.full(30, 10.0)))
    with pytest.raises(UsageError, match=r"spectrum.library of 'grass'.*2 bands lie outside it \(first 2130 nm\)"):
        predict(in_folder(tmp_path, **FROM_LIBRARY), Origins(axis=AXIS, engine=engine))


# sensor

FINE = SpectralAxis(np.arange(680.0, 780.0, 5.0), np.full(20, 6.0))


def test_shifted_bands_see_the_red_edge_elsewhere():
    nominal = of(use=engine, axis=FINE)
    shifted = of(ATMOSPHERE + "sensor_operation: {wavelength_shift_nm: 5}\n", use=engine, axis=FINE)
    assert np.array_equal(shifted.axis.centre_nm, FINE.centre_nm)  # the labels stay
    # A shift by one band: every band holds what the next one held.
    assert shifted.radiance["grass"].mean[:-1] == pytest.approx(nominal.radiance["grass"].mean[1:], rel=1e-9)
    assert any("+5 to +5 nm off their labels" in n for n in shifted.notes)
    # The detector looks for the spectrum at the labels: the response to the full target is no longer 1.
    assert nominal.scores["full", "cem"].mean == pytest.approx(1.0, abs=1e-6)
    assert abs(shifted.scores["full", "cem"].mean - 1.0) > 1e-4


def test_saturation_is_said():
    dim, bright = (of(use=lambda st, k=k: replace(engine(st), direct=k * engine(st).direct)) for k in (0.1, 60))
    assert not any("SATURATION" in n for n in dim.notes)
    assert max(part.max() for part in dim.full_scale.values()) < 1
    assert bright.full_scale["full"].max() > 1
    assert any(n.startswith("SATURATION: full passes full scale in") for n in bright.notes)


def test_blur_of_the_sensor_serves_where_a_geometry_states_none(tmp_path):
    from hyperval.model import with_sensor_blur
    from hyperval.sensor import load_sensor

    fill = "fill: {geometry: {side_m: 1, gsd_m: 1%s}}}"
    s = scenario(**{"fill: {fixed: 0.1}}": fill % ""})
    sensor = load_sensor("prospectir-vs")
    psf = {"fwhm_pixels": (1.2, 0.4), "source": "assumed"}
    blurred = type(sensor)(
        sensor.specification.model_validate({**sensor.specification.model_dump(by_alias=True), "psf": psf})
    )
    found = fill_distribution(with_sensor_blur(s, blurred).scene.targets[0].subjects[0].fill)
    stated = scenario(**{"fill: {fixed: 0.1}}": fill % ", psf_fwhm_pixels: [1.2, 0.4]"})
    expected = fill_distribution(stated.scene.targets[0].subjects[0].fill)
    assert found.mean == pytest.approx(expected.mean, rel=1e-12)
    assert found.mean < fill_distribution(s.scene.targets[0].subjects[0].fill).mean
    assert with_sensor_blur(s, sensor) is s


# processing


def test_features_that_cannot_be():
    with pytest.raises(UsageError, match="11 principal components of 10 bands"):
        of(use=engine, **{"processing: {": "processing: {features: {pca: 11}, "})
    with pytest.raises(UsageError, match="minimum noise fractions need noise"):
        of("", **{"processing: {": "processing: {features: {mnf: 3}, "})
    with pytest.raises(UsageError, match="exactly one of pca, mnf"):
        scenario(**{"processing: {": "processing: {features: {}, "})


def test_channels_by_list_and_bad_list():
    p = of(use=engine, **{"bands: {drop_bad: false}": "bands: {channels: [0, 2, 4, 6], bad_channels: [4]}"})
    assert "detectors use 3 of 10 bands" in p.notes
    with pytest.raises(UsageError, match=r"processing\.bands\.bad_channels: band 10 of 10"):
        of(use=engine, **{"bands: {drop_bad: false}": "bands: {bad_channels: [10]}"})


# bad states are refused by the name of their field


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("solar_zenith_deg: 30", "solar_zenith_deg: 95", "solar_zenith_deg"),
        ("sensor_altitude_km: 1", "sensor_altitude_km: 1, ground_altitude_km: 2", "sensor_altitude_km"),
        ("fraction: 0.7", "fraction: 0.8", "fractions of the classes sum to 1.1, not 1"),
        ("fill: {fixed: 0.1}", "fill: {fixed: 1.1}", r"fill\.fixed"),
        ("fill: {mean: 0.15", "fill: {mean: -0.1", r"fill\.mean"),
        ("host: asphalt", "host: asphalt\n      illumination: {beam: 1.5}", r"illumination\.beam"),
        ("[cem, cem-correlation]", "[cem], elm: {reflectances: [0.6, 0.1]}", "the first panel is the darker one"),
    ],
)
def test_bad_states_are_refused_by_field(tmp_path, old, new, words):
    path = tmp_path / "bad.yaml"
    text = SCENE + ATMOSPHERE
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(UsageError, match=rf"bad\.yaml:\d+: .*{words}"):
        load_scenario(path)


def test_a_spectrum_that_does_not_cover_the_bands_is_refused_by_field(tmp_path):
    w = np.arange(400.0, 1301.0, 5.0)
    (tmp_path / "short.csv").write_text("wavelength_nm,reflectance\n" + "".join(f"{a:g},{0.3:g}\n" for a in w))
    text = {"{builtin: grass}": "{file: short.csv, reflectance_unit: fraction, wavelength_unit: nm}"}
    with pytest.raises(
        UsageError, match=r"scene\.classes\.0\.spectrum of 'grass' does not cover 2 usable bands \(first 2130"
    ):
        predict(in_folder(tmp_path, **text), Origins(axis=AXIS, engine=engine))
    text = {k: v.replace("}", ", gaps: allowed}") for k, v in text.items()}
    p = predict(in_folder(tmp_path, **text), Origins(axis=AXIS, engine=engine))
    assert np.isnan(p.reflectance["grass"].mean[-1])
    assert "detectors use 7 of 10 bands" in p.notes
