"""ENVI cubes: written and read back, against SPy and rasterio, scaled once, valid pixels, and what is refused."""

import bz2
import gzip
import lzma
import os
import resource
import shutil
import warnings
import zipfile
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
from small_files import table

from hyperval.envi_header import DATA_TYPES
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import envi_writer, open_cube, write_cube
from hyperval.spectra import SpectralAxis

UTM18 = CRS.from_epsg(32618)
NORTH_UP = Affine(1.5, 0, 300000.25, 0, -1.5, 4700000.5)


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("code", sorted(DATA_TYPES))
def test_own_reader_equals_spy_and_rasterio(tmp_path: Path, axis: SpectralAxis, interleave: str, order: int, code: int):
    dtype = np.dtype(DATA_TYPES[code])
    high = 200 if code == 1 else 30000
    stored = np.random.default_rng(code).integers(1, high, (6, 5, 4)).astype(dtype)
    stored = stored + (dtype.type(0.25) if dtype.kind == "f" else dtype.type(0))
    path = write_cube(
        tmp_path / "c.img", stored, data_type=code, interleave=interleave, byte_order=order, axis=axis,
        header_offset=0 if order else 17,
    )  # fmt: skip
    cube = open_cube(path, quantity="other")
    assert np.array_equal(np.concatenate([b.values for b in cube.blocks(4)]), stored)
    theirs = spectral.open_image(str(path.with_suffix(".hdr"))).open_memmap(interleave="bip")
    assert np.array_equal(np.array(theirs), stored)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, driver="ENVI") as dataset:
            assert np.array_equal(dataset.read().transpose(1, 2, 0), stored)
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


# What is refused --------------------------------------------------------------------------------


@pytest.mark.parametrize("case", table("refused")["cubes"], ids=str)
def test_cubes_that_are_refused(edit, case):
    path = edit(**case.get("header", {}))
    if "text" in case:
        path.with_suffix(".hdr").write_text(case["text"])
    os.truncate(path, case.get("size", path.stat().st_size))
    with pytest.raises(HypervalError, match=case["says"]) as caught:
        open_cube(path, **({"quantity": "reflectance"} | case.get("options", {})))
    assert caught.value.exit_code == case.get("exit", 3)


def test_percent_is_named_with_the_scale_that_mends_it(tmp_path: Path, axis, values):
    path = write_cube(tmp_path / "pct.img", 100.0 * values, data_type=4, axis=axis)
    with pytest.raises(InputError) as caught:
        open_cube(path, quantity="reflectance")
    assert "0.01 where they are percent" in str(caught.value.mend)
    read = open_cube(path, quantity="reflectance", scale=0.01).pixels(np.ones((6, 5), bool))
    assert read == pytest.approx(values.reshape(-1, 4), rel=1e-6)


def test_sparse_120_gb_file_is_read_by_blocks(edit):
    # Apparent size as the header says, no block on disk: opening must not touch it all.
    lines = 3_000_000_000
    path = edit(lines=str(lines))
    os.truncate(path, lines * 5 * 4 * 2)
    cube = open_cube(path, quantity="reflectance")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    block = next(cube.blocks())
    grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    assert block.values.nbytes <= 8 << 20
    assert grown_mb < 100
    assert cube.pixels((np.array([0, lines - 1]), np.array([0, 4]))).shape == (2, 4)


def test_two_headers_must_be_chosen_from(cube_file: Path):
    second = cube_file.with_name("cube.img.hdr")
    shutil.copy(cube_file.with_suffix(".hdr"), second)
    with pytest.raises(UsageError, match="two headers"):
        open_cube(cube_file, quantity="reflectance")
    assert open_cube(cube_file, quantity="reflectance", header=second).lines == 6


def test_symlink_out_of_the_root(cube_file: Path, tmp_path: Path):
    root = tmp_path / "root"
    root.mkdir()
    for suffix in (".img", ".hdr"):
        (root / f"link{suffix}").symlink_to(cube_file.with_suffix(suffix))
    for path in (root / "link.img", root / ".." / "cube.img"):
        with pytest.raises(UsageError, match="outside the data root"):
            open_cube(path, quantity="reflectance", root=root)
    assert open_cube(root / "link.img", quantity="reflectance", root=tmp_path).lines == 6


def test_what_is_no_cube_and_pixels_outside_are_refused(tmp_path: Path, cube_file: Path):
    with pytest.raises(InputError, match="is a folder"):
        open_cube(tmp_path, quantity="reflectance")
    for thing, message in (
        (7, "is no cube"),
        (np.zeros((3, 4, 5)), "is no cube"),
        ("GTIFF_DIR:1:a", "not a path of a l"),
    ):
        with pytest.raises(UsageError, match=message):
            open_cube(thing, quantity="other")
    for where in ((np.array([6]), np.array([0])), (np.array([0]), np.array([-1])), np.ones((5, 6), bool)):
        with pytest.raises(UsageError):
            open_cube(cube_file, quantity="reflectance").pixels(where)


@pytest.mark.parametrize("packing", ["gzip", "zip", "bzip2", "xz"])
def test_a_compressed_data_file_is_called_that(cube_file: Path, packing: str):
    raw = cube_file.read_bytes()
    if packing == "zip":
        with zipfile.ZipFile(cube_file, "w") as archive:
            archive.writestr("cube.img", raw)
    else:
        cube_file.write_bytes({"gzip": gzip, "bzip2": bz2, "xz": lzma}[packing].compress(raw))
    with pytest.raises(InputError, match=rf"(?s)cube\.img: the data file is compressed \({packing}\).*decompress it"):
        open_cube(cube_file, quantity="reflectance")


def test_a_data_file_that_is_cut_while_it_is_read_or_is_gone(cube_file: Path):
    cube = open_cube(cube_file, quantity="reflectance")
    os.truncate(cube_file, cube_file.stat().st_size // 2)
    with pytest.raises(InputError, match="became shorter while it was read"):
        cube.read(0, 6)
    cube_file.unlink()
    for named in (cube_file, cube_file.with_suffix(".hdr")):
        with pytest.raises(InputError, match=r"no such|data files beside the header: none"):
            open_cube(named, quantity="reflectance")


def test_sidecars_of_an_envi_cube_are_not_read(cube_file: Path, values: np.ndarray):
    cube_file.with_name("cube.img.aux.xml").write_text(
        "<PAMDataset><PAMRasterBand band='1'><NoDataValue>5</NoDataValue><Scale>7</Scale></PAMRasterBand>"
        "<GeoTransform>0, 9, 0, 0, 0, -9</GeoTransform></PAMDataset>"
    )
    for name in ("cube.img.ovr", "cube.img.msk", "cube.enp", "cube.img.enp", "cube.sta", "cube.wld"):
        cube_file.with_name(name).write_bytes(b"\0" * 50)
    cube = open_cube(cube_file, quantity="reflectance")
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert (cube.ignore_value, cube.transform) == (None, None)
    assert {p.name for p in cube.source_files} == {"cube.img", "cube.hdr"}


# Scale and no data ------------------------------------------------------------------------------


def test_a_scale_is_applied_once_and_a_stated_one_replaces_that_of_the_header(cube_file: Path, values: np.ndarray):
    cube = open_cube(cube_file, quantity="reflectance")
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert np.allclose(cube.pixels(np.ones((6, 5), bool)), values.reshape(-1, 4), atol=1e-15)
    loaded = spectral.open_image(str(cube_file.with_suffix(".hdr"))).load()  # SPy applies the factor when it loads
    assert np.allclose(np.asarray(loaded), values, atol=1e-7)
    cube = open_cube(cube_file, quantity="reflectance", scale=2e-5)
    assert np.allclose(cube.read(0, 6).values, values * 0.2, atol=1e-15)
    cube = open_cube(cube_file, quantity="reflectance", scale=2e-5, unit="percent")
    assert np.allclose(cube.read(0, 6).values, values * 0.002, atol=1e-15)
    cube = open_cube(cube_file, quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=0.001)
    assert cube.read(0, 1).values.max() < 10


def test_ignore_value_never_enters_a_mean(tmp_path: Path, axis: SpectralAxis, values: np.ndarray):
    marked = values.copy()
    marked[2, 3] = np.nan
    marked[4, 1, 2] = np.nan  # one band is enough
    options = {"data_type": 2, "axis": axis, "reflectance_scale_factor": 10000.0, "ignore_value": -9999}
    cube = open_cube(write_cube(tmp_path / "i.img", marked, **options), quantity="reflectance")
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
    values[:, :, 3] = 0.0  # a dead band filled with the ignore value
    path = write_cube(tmp_path / "i.img", values, data_type=4, axis=axis, ignore_value=0)
    cube = open_cube(path, quantity="reflectance")
    assert cube.axis.good.tolist() == [True, True, True, False]
    assert cube.read(0, 6).valid.all()
    assert np.isnan(cube.read(0, 6).values[..., 3]).all()


@pytest.mark.parametrize("code", [14, 15])
def test_the_largest_64_bit_number_as_ignore_value(tmp_path: Path, axis: SpectralAxis, code: int):
    largest = int(np.iinfo(DATA_TYPES[code]).max)  # no float holds it
    stored = np.ones((2, 2, 4), DATA_TYPES[code])
    stored[0, 1, 2] = largest
    path = write_cube(tmp_path / "c.img", stored, data_type=code, axis=axis, extra={"data ignore value": str(largest)})
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


# Bands, place, other entries --------------------------------------------------------------------


def test_a_missing_unit_is_taken_and_noted_where_only_one_can_be_meant(edit):
    cube = open_cube(edit(wavelength_units="Unknown"), quantity="reflectance")
    assert cube.axis.centre_nm[0] == 450.0
    assert "the file states no wavelength unit: 450 to 850 can only be nm" in cube.notes
    cube = open_cube(edit(wavelength="{0.45, 0.55, 0.65, 0.85}", fwhm=None), quantity="reflectance")
    assert np.allclose(cube.axis.centre_nm, [450, 550, 650, 850])


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


def test_position_and_further_entries_are_written_and_read_as_rasterio_reads_them(tmp_path: Path, axis, values):
    extra = {"gain file": "line_0920.gain", "gps start time": "16:31:02.5", "co2 shift": "0.35"}
    more = {"extra": extra, "description": "flight line 3"}
    path = write_cube(tmp_path / "p.img", values, axis=axis, transform=NORTH_UP, crs=UTM18, **more)
    cube = open_cube(path, quantity="reflectance")
    assert {k: cube.extras[k] for k in extra} == extra
    assert cube.description == "flight line 3"
    assert [p.name for p in cube.source_files] == ["p.img", "p.hdr"]
    with pytest.raises(UsageError, match="north-up"):
        write_cube(tmp_path / "turned.img", values, transform=Affine.rotation(30))
    assert (cube.transform, cube.crs, cube.pixel_area_m2) == (NORTH_UP, UTM18, pytest.approx(2.25))
    with rasterio.open(path, driver="ENVI") as dataset:
        assert (dataset.transform, dataset.crs) == (NORTH_UP, UTM18)


def test_rotated_map_info_keeps_right_angles_and_pixel_sizes(edit):
    info = "{UTM, 2.5, 3.0, 300000.0, 4700000.0, 1.5, 1.25, 18, North, WGS-84, units=Meters, rotation=30}"
    t = open_cube(edit(map_info=info), quantity="reflectance").transform
    assert np.hypot(t.a, t.d) == pytest.approx(1.5)  # one sample on
    assert np.hypot(t.b, t.e) == pytest.approx(1.25)  # one line on
    assert t.a * t.b + t.d * t.e == pytest.approx(0.0, abs=1e-12)
    # The reference pixel (2.5, 3.0), counted from 1, lies at the stated place whatever the rotation.
    assert t @ (1.5, 2.0) == pytest.approx((300000.0, 4700000.0))


@pytest.mark.parametrize("rotation", [0.0, -40.0])
def test_gains_of_bands_fill_and_a_turned_grid(edit, values: np.ndarray, rotation: float):
    path = edit(
        reflectance_scale_factor=None,
        data_gain_values="{1e-3, 2e-3, 3e-3, 4e-3}",
        data_offset_values="{0, 0.5, -0.25, 1}",
        map_info=f"{{Custom, 1, 1, 300000.0, 4700000.0, 1.5, 1.5, 18, North, units=Meters, rotation={rotation}}}",
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


@pytest.mark.parametrize("case", table("refused")["written"], ids=str)
def test_what_cannot_be_stored_is_refused(tmp_path: Path, case):
    options = case.get("options", {})
    with (
        pytest.raises(UsageError, match=case["says"]),
        envi_writer(tmp_path / "w.img", lines=6, samples=5, bands=4, **options) as writer,
    ):
        writer.write(np.full(case.get("shape", (1, 5, 4)), case["values"]))
    assert list(tmp_path.iterdir()) == []
