"""Cubes: written and read back, against SPy and rasterio, scaled once, valid pixels, position."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
import spectral
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rasterio.crs import CRS

from hyperval.envi_header import DATA_TYPES
from hyperval.errors import InputError, UsageError
from hyperval.imagery import envi_writer, open_cube, open_raster, transform_of, write_cube
from hyperval.spectra import SpectralAxis

UTM18 = CRS.from_epsg(32618)
NORTH_UP = Affine(1.5, 0, 300000.25, 0, -1.5, 4700000.5)


def by_rasterio(path: Path) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, driver="ENVI") as dataset:
            return dataset.read().transpose(1, 2, 0)


def by_spy(path: Path) -> np.ndarray:
    image = spectral.open_image(str(path.with_suffix(".hdr")))
    return np.array(image.open_memmap(interleave="bip"))


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("code", sorted(DATA_TYPES))
def test_own_reader_equals_spy_and_rasterio(tmp_path: Path, axis: SpectralAxis, interleave: str, order: int, code: int):
    dtype = np.dtype(DATA_TYPES[code])
    rng = np.random.default_rng(code)
    high = 200 if code == 1 else 30000
    stored = rng.integers(1, high, (6, 5, 4)).astype(dtype) + (dtype.type(0.25) if dtype.kind == "f" else 0)
    path = write_cube(
        tmp_path / "c.img", stored.astype(dtype), data_type=code, interleave=interleave, byte_order=order,
        axis=axis, header_offset=0 if order else 17,
    )  # fmt: skip
    cube = open_cube(path, quantity="other")
    own = np.concatenate([b.values for b in cube.blocks(4)])
    assert np.array_equal(own, stored)
    assert np.array_equal(by_spy(path), stored)
    assert np.array_equal(by_rasterio(path), stored)
    rows, cols = np.array([0, 5, 2]), np.array([4, 0, 3])
    assert np.array_equal(cube.pixels((rows, cols)), stored[rows, cols].astype(float))
    assert cube.raster.dtype == dtype.newbyteorder("<>"[order])


@given(
    data=arrays(np.float64, st.tuples(*[st.integers(1, 5)] * 3), elements=st.floats(-1e6, 1e6, allow_subnormal=False)),
    interleave=st.sampled_from(["bsq", "bil", "bip"]),
    order=st.sampled_from([0, 1]),
    offset=st.integers(0, 9),
    step=st.integers(1, 5),
)
@settings(max_examples=60)
def test_round_trip(tmp_path_factory, data, interleave, order, offset, step):
    lines, samples, bands = data.shape
    path = tmp_path_factory.mktemp("trip") / "c.dat"
    axis = SpectralAxis(400.0 + 10.0 * np.arange(bands), np.full(bands, 8.0))
    options = {"interleave": interleave, "byte_order": order, "header_offset": offset, "axis": axis, "data_type": 5}
    with envi_writer(path, lines=lines, samples=samples, bands=bands, **options) as writer:
        for first in range(0, lines, step):
            writer.write(data[first : first + step])
    cube = open_cube(path, quantity="other")
    assert np.array_equal(cube.pixels(np.ones((lines, samples), bool)).reshape(data.shape), data)
    assert np.array_equal(np.concatenate([b.values for b in cube.blocks(step)]), data)
    assert np.array_equal(cube.axis.centre_nm, axis.centre_nm)
    assert np.array_equal(cube.axis.fwhm_nm, axis.fwhm_nm)


# Scale ------------------------------------------------------------------------------------------


def test_header_scale_factor_divides_once(cube_file: Path, values: np.ndarray):
    cube = open_cube(cube_file, quantity="reflectance")
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert np.allclose(cube.pixels(np.ones((6, 5), bool)), values.reshape(-1, 4), atol=1e-15)
    # SPy applies the factor when it loads; the values agree with that.
    loaded = spectral.open_image(str(cube_file.with_suffix(".hdr"))).load()
    assert np.allclose(np.asarray(loaded), values, atol=1e-7)


def test_a_stated_scale_replaces_that_of_the_header_and_percent_is_a_unit(cube_file: Path, values: np.ndarray):
    cube = open_cube(cube_file, quantity="reflectance", scale=2e-5)
    assert np.allclose(cube.read(0, 6).values, values * 0.2, atol=1e-15)
    cube = open_cube(cube_file, quantity="reflectance", scale=2e-5, unit="percent")
    assert np.allclose(cube.read(0, 6).values, values * 0.002, atol=1e-15)
    cube = open_cube(cube_file, quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=0.001)
    assert cube.read(0, 1).values.max() < 10


@pytest.mark.parametrize(
    ("changes", "options", "error", "message"),
    [
        ({"data_gain_values": "{1, 1, 1, 1}"}, {"quantity": "reflectance"}, InputError, "exclude each other"),
        ({}, {"quantity": "radiance", "unit": "uW cm-2 sr-1 nm-1"}, InputError, "exclude each other"),
        ({"reflectance_scale_factor": None}, {"quantity": "radiance"}, UsageError, "unit of the radiance"),
        ({}, {"quantity": "reflectance", "scale": 0.01}, InputError, "state scale"),
        ({}, {"quantity": "reflectance", "scale": -1.0}, UsageError, "scale is -1"),
        ({}, {"quantity": "reflectance", "unit": "permille"}, UsageError, "unknown reflectance unit"),
        ({}, {"quantity": "albedo"}, UsageError, "unknown quantity"),
        ({"data_gain_values": "{0, 1, 1, 1}"}, {"quantity": "reflectance"}, InputError, "a gain of 0"),
        ({"map_info": "{UTM, 1, 1, 5, 6, 0, 2, 18, North, WGS-84}"}, {"quantity": "other"}, InputError, "not positive"),
        ({}, {"quantity": "reflectance", "scale": 1.0, "unit": "percent"}, InputError, "state scale"),
        ({}, {"quantity": "radiance", "scale": 1.0, "unit": "uW cm-2 sr-1 nm-1"}, InputError, "state scale"),
    ],
)
def test_scales_and_units_that_are_refused(edit, changes, options, error, message):
    with pytest.raises(error, match=message):
        open_cube(edit(**changes), **options)


# Valid pixels -----------------------------------------------------------------------------------


def test_ignore_value_never_enters_a_mean(tmp_path: Path, axis: SpectralAxis, values: np.ndarray):
    marked = values.copy()
    marked[2, 3] = np.nan
    marked[4, 1, 2] = np.nan  # one band is enough
    path = write_cube(
        tmp_path / "i.img", marked, data_type=2, axis=axis, reflectance_scale_factor=10000.0, ignore_value=-9999
    )
    cube = open_cube(path, quantity="reflectance")
    assert cube.ignore_value == -9999
    block = cube.read(0, 6)
    expected = np.ones((6, 5), bool)
    expected[2, 3] = expected[4, 1] = False
    assert np.array_equal(block.valid, expected)
    assert np.isnan(block.values[2, 3]).all()
    assert np.isnan(block.values[4, 1]).tolist() == [False, False, True, False]
    assert np.allclose(cube.spectra(np.ones((6, 5), bool)).mean(0), values[expected].mean(0), atol=1e-12)
    assert np.array_equal(cube.marked_pixels(np.ones((6, 5), bool))[1], expected.ravel())


def test_ignore_value_in_a_bad_band_keeps_the_pixel(tmp_path: Path, values: np.ndarray):
    axis = SpectralAxis([450.0, 550.0, 650.0, 850.0], 9.0, np.array([True, True, True, False]))
    marked = values.copy()
    marked[:, :, 3] = 0.0
    path = write_cube(
        tmp_path / "i.img", marked, data_type=4, axis=axis, ignore_value=0
    )  # a dead band filled with the ignore value
    cube = open_cube(path, quantity="reflectance")
    assert cube.axis.good.tolist() == [True, True, True, False]
    assert cube.read(0, 6).valid.all()
    assert np.isnan(cube.read(0, 6).values[..., 3]).all()


# Bands ------------------------------------------------------------------------------------------


def test_a_missing_unit_is_taken_and_noted_where_only_one_can_be_meant(edit):
    cube = open_cube(edit(wavelength_units="Unknown"), quantity="reflectance")
    assert cube.axis.centre_nm[0] == 450.0
    assert "the file states no wavelength unit: 450 to 850 can only be nm" in cube.notes
    cube = open_cube(edit(wavelength="{0.45, 0.55, 0.65, 0.85}", fwhm=None), quantity="reflectance")
    assert np.allclose(cube.axis.centre_nm, [450, 550, 650, 850])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wavelength": "{450, 550}"}, "2 values for 4 bands"),
        ({"wavelength": "{450, nan, 650, 850}"}, "not finite"),
        ({"wavelength": "{450, x, 650, 850}"}, "not a number"),
        ({"wavelength": "{450, 650, 550, 850}"}, r"band 3 \(550 nm\) follows band 2"),
        ({"wavelength": "{450, 550, 550, 850}"}, "share a wavelength"),
        ({"wavelength": None}, "lists no wavelengths"),
        ({"fwhm": "{9, -1, 9, 9}"}, "band 2 has a width"),
        ({"fwhm": "{9, 9}"}, "2 values for 4 bands"),
        ({"bbl": "{1, 1, 1}"}, "3 values for 4 bands"),
        ({"bbl": "{1, 2, 1, 1}"}, "other values than 0"),
        ({"bbl": "{0, 0, 0, 0}"}, "every band as bad"),
        ({"wavelength_units": "Wavenumber"}, "cannot be used"),
        ({"reflectance_scale_factor": "0"}, "scale factor' is 0"),
        ({"reflectance_scale_factor": "nan"}, "scale factor' is nan"),
        ({"data_ignore_value": "none"}, "not a number"),
        ({"map_info": "{UTM, 1, 1, x}"}, "'map info' is not understood"),
        ({"fwhm": "{0.01, 0.01, 0.01, 0.01}"}, "in the unit of the wavelengths"),
        ({"wavelength_units": "um", "wavelength": "{0.4, 0.5, 0.6, 0.7}"}, "in the unit of the wavelengths"),
    ],
)
def test_bad_band_tables_are_input_errors_with_the_header_named(edit, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        open_cube(edit(**changes), quantity="reflectance")
    assert "cube." in str(caught.value)


def test_extra_entries_are_kept(tmp_path: Path, axis: SpectralAxis, values: np.ndarray):
    extra = {"gain file": "line_0920.gain", "gps start time": "16:31:02.5", "co2 shift": "0.35"}
    path = write_cube(tmp_path / "s.img", values, axis=axis, extra=extra, description="flight line 3")
    cube = open_cube(path, quantity="reflectance")
    assert {k: cube.extras[k] for k in extra} == extra
    assert cube.description == "flight line 3"
    assert [p.name for p in cube.source_files] == ["s.img", "s.hdr"]


# Position ---------------------------------------------------------------------------------------


def test_position_is_written_and_read_as_rasterio_reads_it(tmp_path: Path, axis: SpectralAxis, values: np.ndarray):
    path = write_cube(tmp_path / "p.img", values, axis=axis, transform=NORTH_UP, crs=UTM18)
    cube = open_cube(path, quantity="reflectance")
    assert cube.transform == NORTH_UP
    assert cube.crs == UTM18
    assert cube.pixel_area_m2 == pytest.approx(2.25)
    with rasterio.open(path, driver="ENVI") as dataset:
        assert dataset.transform == NORTH_UP
        assert dataset.crs == UTM18


def test_rotated_map_info_keeps_right_angles_and_pixel_sizes(edit):
    info = "{UTM, 2.5, 3.0, 300000.0, 4700000.0, 1.5, 1.25, 18, North, WGS-84, units=Meters, rotation=30}"
    t = transform_of(open_raster(edit(map_info=info)).header)
    assert np.hypot(t.a, t.d) == pytest.approx(1.5)  # one sample on
    assert np.hypot(t.b, t.e) == pytest.approx(1.25)  # one line on
    assert t.a * t.b + t.d * t.e == pytest.approx(0.0, abs=1e-12)
    # The reference pixel (2.5, 3.0), counted from 1, lies at the stated place whatever the rotation.
    assert t.a * 1.5 + t.b * 2.0 + t.c == pytest.approx(300000.0)
    assert t.d * 1.5 + t.e * 2.0 + t.f == pytest.approx(4700000.0)


# Pixels -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "where", [(np.array([6]), np.array([0])), (np.array([0]), np.array([-1])), np.ones((5, 6), bool)]
)
def test_pixels_outside_are_refused(cube_file: Path, where):
    with pytest.raises(UsageError):
        open_cube(cube_file, quantity="reflectance").pixels(where)


# Writing ----------------------------------------------------------------------------------------


def test_interrupted_writing_leaves_the_old_cube(cube_file: Path, axis: SpectralAxis, values: np.ndarray):
    before = cube_file.read_bytes(), cube_file.with_suffix(".hdr").read_bytes()
    with (
        pytest.raises(UsageError, match="4 of 6 lines"),
        envi_writer(cube_file, lines=6, samples=5, bands=4, axis=axis) as writer,
    ):
        writer.write(values[:4])
    assert (cube_file.read_bytes(), cube_file.with_suffix(".hdr").read_bytes()) == before
    assert sorted(p.name for p in cube_file.parent.iterdir()) == ["cube.hdr", "cube.img"]


@pytest.mark.parametrize(
    ("block", "options", "message"),
    [
        (np.full((1, 5, 4), 40000.0), {"data_type": 2}, "do not fit int16"),
        (np.full((1, 5, 4), -1.0), {"data_type": 12}, "do not fit uint16"),
        (np.full((1, 5, 4), np.nan), {"data_type": 2}, "need an ignore value"),
        (np.zeros((7, 5, 4)), {}, "more than 6 lines"),
        (np.zeros((1, 4, 5)), {}, "for 5 samples and 4 bands"),
        (np.zeros((1, 5, 4)), {"interleave": "xyz"}, "cannot write"),
        (np.zeros((1, 5, 4)), {"gain": 1.0, "reflectance_scale_factor": 1.0}, "either a gain"),
        (np.zeros((1, 5, 4)), {"transform": Affine.rotation(30)}, "north-up"),
    ],
)
def test_what_cannot_be_stored_is_refused(tmp_path: Path, block, options, message):
    with (
        pytest.raises(UsageError, match=message),
        envi_writer(tmp_path / "w.img", lines=6, samples=5, bands=4, **options) as writer,
    ):
        writer.write(block)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("code", [14, 15])
def test_the_largest_64_bit_number_as_ignore_value(tmp_path: Path, axis: SpectralAxis, code: int):
    largest = int(np.iinfo(DATA_TYPES[code]).max)  # no float holds it
    stored = np.ones((2, 2, 4), DATA_TYPES[code])
    stored[0, 1, 2] = largest
    extra = {"data ignore value": str(largest)}
    path = write_cube(tmp_path / "c.img", stored, data_type=code, axis=axis, extra=extra)
    block = open_cube(path, quantity="other").read(0, 2)
    assert block.valid.tolist() == [[True, False], [True, True]]
    assert np.isnan(block.values[0, 1, 2])


@pytest.mark.parametrize(
    ("code", "ignore"), [("12", "-9999.0"), ("12", "1.5"), ("12", "1e30"), ("4", "1e39"), ("4", "-1.79769313486e+308")]
)
def test_an_ignore_value_that_the_type_cannot_hold_marks_nothing(edit, code: str, ignore: str):
    path = edit(data_type=code, data_ignore_value=ignore)
    if code == "4":
        path.write_bytes(np.arange(path.stat().st_size // 2, dtype="<f4").tobytes())
    assert open_cube(path, quantity="other").read(0, 6).valid.all()


@pytest.mark.parametrize(
    ("listed", "stored_band", "widths"),
    [
        ("{450, 950, 945, 1045}", [0, 2, 1, 3], [500, 100, 500, 100]),  # two detectors of two bands each
        ("{1050, 950, 700, 450}", [3, 2, 1, 0], [250, 250, 175, 100]),  # falling: one detector
        ("{450, 950, 940, 930}", [0, 3, 2, 1], [480, 245, 10, 10]),  # a detector of one band has no spacing
    ],
)
def test_detectors_are_sorted_on_request_with_the_spacing_of_each(edit, values, listed, stored_band, widths):
    path = edit(wavelength=listed, fwhm=None, bbl="{1, 0, 1, 1}")
    with pytest.raises(InputError, match="sort_bands"):
        open_cube(path, quantity="reflectance")
    cube = open_cube(path, quantity="reflectance", sort_bands=True)
    assert cube.stored_band.tolist() == stored_band
    assert cube.axis.fwhm_nm.tolist() == pytest.approx(widths)
    assert any("no fwhm" in note for note in cube.notes)
    assert "bad-band list: 1 of 4 bands are bad" in cube.notes
    assert cube.axis.good.tolist() == [band != 1 for band in stored_band]
    assert np.allclose(cube.read(0, 6).values, values[:, :, stored_band], atol=1e-15)
    assert np.allclose(cube.pixels((np.array([3]), np.array([2]))), values[3, 2, stored_band], atol=1e-15)
    listed = edit(fwhm="{1, 2, 3, 4}")
    assert open_cube(listed, quantity="other", sort_bands=True).axis.fwhm_nm.tolist() == [b + 1 for b in stored_band]
    with pytest.raises(InputError, match="two bands share a wavelength") as caught:
        open_cube(edit(wavelength="{450, 950, 950, 1050}"), quantity="reflectance", sort_bands=True)
    assert "state sort_bands" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "unit", "message"),
    [
        ({"wavelength": "{0.45, 0.55, 0.65, 0.85}"}, None, "cannot be in Nanometers"),
        ({"wavelength": "{0.45, 0.55, 0.65, 0.85}"}, "um", "the campaign in um"),
        ({"wavelength_units": "Unknown"}, "um", "cannot be in um"),
        (
            {"wavelength_units": "Unknown", "wavelength": "{45, 550, 650, 850}"},
            None,
            r"(?s)45 to 850 do not tell it.*state wavelength_unit",
        ),
    ],
)
def test_wavelength_units_that_cannot_be(edit, changes, unit, message):
    with pytest.raises(UsageError, match=message):
        open_cube(edit(**changes), quantity="reflectance", wavelength_unit=unit)


@pytest.mark.parametrize("rotation", [0.0, -40.0])
def test_gains_of_bands_fill_and_a_turned_grid(edit, values: np.ndarray, rotation: float):
    info = f"{{Custom, 1, 1, 300000.0, 4700000.0, 1.5, 1.5, 18, North, units=Meters, rotation={rotation}}}"
    path = edit(
        reflectance_scale_factor=None,
        data_gain_values="{1e-3, 2e-3, 3e-3, 4e-3}",
        data_offset_values="{0, 0.5, -0.25, 1}",
        map_info=info,
    )
    stored = np.rint(values * 10000).astype("<i2")
    stored[0, 0] = 0
    path.write_bytes(stored.transpose(0, 2, 1).tobytes())
    cube = open_cube(path, quantity="radiance", unit="W m-2 sr-1 um-1")
    want = 0.1 * (stored * [1e-3, 2e-3, 3e-3, 4e-3] + [0, 0.5, -0.25, 1])
    assert np.allclose(cube.read(0, 6).values, want, rtol=1e-12)
    assert cube.read(0, 6, np.float32).values.dtype == np.float32
    assert cube.unit == "uW cm-2 sr-1 nm-1"
    assert np.argwhere(~cube.read(0, 6).valid).tolist() == [[0, 0]]  # 0 in every band
    assert open_cube(path, quantity="other").read(0, 6).valid.all()
    with rasterio.open(path, driver="ENVI") as dataset:
        assert np.allclose(cube.transform[:6], dataset.transform[:6], rtol=1e-12, atol=1e-7)
    assert (cube.crs, cube.pixel_area_m2) == (None, pytest.approx(2.25))
    assert any("coordinate system is not known" in note for note in cube.notes)
