"""ENVI cubes and headers: written and read back, against SPy and rasterio, scaled once, and what is refused."""

import bz2
import gzip
import lzma
import os
import resource
import shutil
import warnings
import zipfile
from datetime import UTC, datetime, timedelta, timezone
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
from rasterio.warp import transform as reproject
from small_files import table

from hyperval.envi_header import DATA_TYPES, MAX_HEADER_BYTES, parse_header, read_header
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import (
    acquisition_notes,
    crs_of,
    envi_writer,
    open_cube,
    pixel_area_m2,
    time_notes,
    transform_of,
    write_cube,
)
from hyperval.spectra import SpectralAxis

# ENVI cubes: written and read back, against SPy and rasterio, scaled once, valid pixels, and what is refused.


UTM18 = CRS.from_epsg(32618)
NORTH_UP = Affine(1.5, 0, 300000.25, 0, -1.5, 4700000.5)


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("code", sorted(DATA_TYPES))
def test_own_reader_equals_spy_and_rasterio(tmp_path, axis, interleave, order, code):
    dtype = np.dtype(DATA_TYPES[code])
    high = 200 if code == 1 else 30000
    stored = np.random.default_rng(code).integers(1, high, (6, 5, 4)).astype(dtype)
    stored = stored + (dtype.type(0.25) if dtype.kind == "f" else dtype.type(0))
    layout = {"byte order": str(order), "header offset": "0" if order else "17"}
    path = write_cube(tmp_path / "c.img", stored, data_type=code, interleave=interleave, axis=axis, extra=layout)
    cube = open_cube(path, quantity="other")
    assert np.array_equal(np.concatenate([b.values for b in cube.blocks(4)]), stored)
    theirs = spectral.open_image(str(path.with_suffix(".hdr"))).open_memmap(interleave="bip")
    assert np.array_equal(np.array(theirs), stored)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, driver="ENVI") as dataset:
            assert np.array_equal(dataset.read().transpose(1, 2, 0), stored)
    rows, cols = np.array([0, 5, 2]), np.array([4, 0, 3])
    assert np.array_equal(cube.marked_pixels((rows, cols))[0], stored[rows, cols].astype(float))
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
    options = {"interleave": interleave, "axis": axis, "data_type": 5}
    options["extra"] = {"byte order": str(order), "header offset": str(offset)}
    with envi_writer(path, lines=lines, samples=samples, bands=bands, **options) as writer:
        for first in range(0, lines, step):
            writer.write(data[first : first + step])
    cube = open_cube(path, quantity="other")
    assert np.array_equal(cube.marked_pixels(np.ones((lines, samples), bool))[0].reshape(data.shape), data)
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


def test_percent_is_named_with_the_scale_that_mends_it(tmp_path, axis, values):
    path = write_cube(tmp_path / "pct.img", 100.0 * values, data_type=4, axis=axis)
    with pytest.raises(InputError) as caught:
        open_cube(path, quantity="reflectance")
    assert "0.01 where they are percent" in str(caught.value.mend)
    assert open_cube(path, quantity="reflectance", scale=0.01).read(0, 6).values == pytest.approx(values, rel=1e-6)


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
    assert cube.marked_pixels((np.array([0, lines - 1]), np.array([0, 4])))[0].shape == (2, 4)


def test_two_headers_must_be_chosen_from(cube_file):
    second = shutil.copy(cube_file.with_suffix(".hdr"), cube_file.with_name("cube.img.hdr"))
    with pytest.raises(UsageError, match="two headers"):
        open_cube(cube_file, quantity="reflectance")
    assert open_cube(cube_file, quantity="reflectance", header=second).lines == 6


def test_what_is_no_cube_and_pixels_outside_are_refused(tmp_path, cube_file):
    with pytest.raises(InputError, match=r"is a folder, not an image(?s:.*)gdalbuildvrt"):
        open_cube(tmp_path, quantity="reflectance")
    others = (7, "is not a cube"), (np.zeros((3, 4, 5)), "is not a cube"), ("GTIFF_DIR:1:a", "not a path of a l")
    for thing, message in others:
        with pytest.raises(UsageError, match=message):
            open_cube(thing, quantity="other")
    for where in ((np.array([6]), np.array([0])), (np.array([0]), np.array([-1])), np.ones((5, 6), bool)):
        with pytest.raises(UsageError):
            open_cube(cube_file, quantity="reflectance").marked_pixels(where)[0]


@pytest.mark.parametrize("packing", ["gzip", "zip", "bzip2", "xz"])
def test_a_compressed_data_file_is_called_that(cube_file, packing):
    raw = cube_file.read_bytes()
    if packing == "zip":
        with zipfile.ZipFile(cube_file, "w") as archive:
            archive.writestr("cube.img", raw)
    else:
        cube_file.write_bytes({"gzip": gzip, "bzip2": bz2, "xz": lzma}[packing].compress(raw))
    with pytest.raises(InputError, match=rf"(?s)cube\.img: the data file is compressed \({packing}\).*decompress it"):
        open_cube(cube_file, quantity="reflectance")


def test_a_data_file_that_is_cut_while_it_is_read_or_is_gone(cube_file):
    cube = open_cube(cube_file, quantity="reflectance")
    os.truncate(cube_file, cube_file.stat().st_size // 2)
    for read in (cube.read, lambda line, sample: cube.marked_pixels((np.array([line]), np.array([sample])))[0]):
        with pytest.raises(InputError, match="became shorter while it was read"):
            read(0, 4)
    cube_file.unlink()
    for named in (cube_file, cube_file.with_suffix(".hdr")):
        with pytest.raises(InputError, match=r"no such|data files beside the header: none"):
            open_cube(named, quantity="reflectance")


def test_sidecars_of_an_envi_cube_are_not_read(cube_file, values):
    cube_file.with_name("cube.img.aux.xml").write_text(
        "<PAMDataset><PAMRasterBand band='1'><NoDataValue>5</NoDataValue><Scale>7</Scale></PAMRasterBand>"
        "<GeoTransform>0, 9, 0, 0, 0, -9</GeoTransform></PAMDataset>"
    )
    for name in ("cube.img.ovr", "cube.img.msk", "cube.enp", "cube.img.enp", "cube.sta", "cube.wld"):
        cube_file.with_name(name).write_bytes(b"\0" * 50)
    cube = open_cube(cube_file, quantity="reflectance")
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert (cube.ignore_value, cube.transform) == (None, None)
    assert {p.name for p in cube.raster.source_files} == {"cube.img", "cube.hdr"}


# Scale and no data ------------------------------------------------------------------------------


def test_a_scale_is_applied_once_and_a_stated_one_replaces_that_of_the_header(cube_file, values):
    cube = open_cube(cube_file, quantity="reflectance")
    assert np.allclose(cube.read(0, 6).values, values, atol=1e-15)
    assert np.allclose(cube.marked_pixels(np.ones((6, 5), bool))[0], values.reshape(-1, 4), atol=1e-15)
    loaded = spectral.open_image(str(cube_file.with_suffix(".hdr"))).load()  # SPy applies the factor when it loads
    assert np.allclose(np.asarray(loaded), values, atol=1e-7)
    cube = open_cube(cube_file, quantity="reflectance", scale=2e-5)
    assert np.allclose(cube.read(0, 6).values, values * 0.2, atol=1e-15)
    cube = open_cube(cube_file, quantity="reflectance", scale=2e-5, unit="percent")
    assert np.allclose(cube.read(0, 6).values, values * 0.002, atol=1e-15)
    cube = open_cube(cube_file, quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=0.001)
    assert cube.read(0, 1).values.max() < 10


def test_ignore_value_never_enters_a_mean_and_a_pixel_that_has_it_in_a_bad_band_counts(tmp_path, axis, values):
    axis, marked = SpectralAxis(axis.centre_nm, axis.fwhm_nm, np.arange(4) != 3), values * 10000.0
    marked[5, :, 3] = np.nan
    marked[2, 3] = np.nan
    marked[4, 1, 2] = np.nan  # one band is enough
    options = {"data_type": 2, "axis": axis, "extra": {"reflectance scale factor": "10000.0"}, "ignore_value": -9999}
    cube = open_cube(write_cube(tmp_path / "i.img", marked, **options), quantity="reflectance")
    block, expected = cube.read(0, 6), np.isfinite(marked[..., :3]).all(axis=2)
    assert np.array_equal(block.valid, expected)
    assert np.isnan(block.values[2, 3]).all()
    assert np.isnan(block.values[[4, 5], 1]).tolist() == [[False, False, True, False], [False, False, False, True]]
    assert cube.spectra(np.ones((6, 5), bool)).mean(0)[:3] == pytest.approx(values[expected].mean(0)[:3], abs=1e-12)
    assert np.array_equal(cube.marked_pixels(np.ones((6, 5), bool))[1], expected.ravel())


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
        ("{450, 950, 940, 930}", [0, 3, 2, 1], [10, 10, 10, 10]),  # a detector of one band has no spacing
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
    assert np.allclose(cube.marked_pixels((np.array([3]), np.array([2])))[0], values[3, 2, stored_band], atol=1e-15)
    listed = edit(fwhm="{1, 2, 3, 4}")
    assert open_cube(listed, quantity="other", sort_bands=True).axis.fwhm_nm.tolist() == [b + 1 for b in stored_band]
    with pytest.raises(InputError, match="two bands share a wavelength") as caught:
        open_cube(edit(wavelength="{450, 950, 950, 1050}"), quantity="reflectance", sort_bands=True)
    assert "state sort_bands" not in str(caught.value)


def test_position_and_further_entries_are_written_and_read_as_rasterio_reads_them(tmp_path, axis, values):
    extra = {"gain file": "line_0920.gain", "gps start time": "16:31:02.5", "co2 shift": "0.35"}
    more = {"extra": extra, "description": "flight line 3"}
    path = write_cube(tmp_path / "p.img", values, axis=axis, transform=NORTH_UP, crs=UTM18, **more)
    cube = open_cube(path, quantity="reflectance")
    assert cube.raster.description.entries.items() >= extra.items()
    assert cube.description == "flight line 3"
    assert [p.name for p in cube.raster.source_files] == ["p.img", "p.hdr"]
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
def test_gains_of_bands_fill_and_a_turned_grid(edit, values, rotation):
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


def test_interrupted_writing_leaves_the_old_cube(cube_file, axis, values):
    before = cube_file.read_bytes(), cube_file.with_suffix(".hdr").read_bytes()
    with (
        pytest.raises(UsageError, match="4 of 6 lines"),
        envi_writer(cube_file, lines=6, samples=5, bands=4, axis=axis) as writer,
    ):
        writer.write(values[:4])
    assert (cube_file.read_bytes(), cube_file.with_suffix(".hdr").read_bytes()) == before
    assert sorted(p.name for p in cube_file.parent.iterdir()) == ["cube.hdr", "cube.img"]


@pytest.mark.parametrize("case", table("refused")["written"], ids=str)
def test_what_cannot_be_stored_is_refused(tmp_path, case):
    options = case.get("options", {})
    with (
        pytest.raises(UsageError, match=case["says"]),
        envi_writer(tmp_path / "w.img", lines=6, samples=5, bands=4, **options) as writer,
    ):
        writer.write(np.full(case.get("shape", (1, 5, 4)), case["values"]))
    assert list(tmp_path.iterdir()) == []


# Headers: what the parser understands and notes, as other programs write them, and what they say of a flight line.


BASE = {"samples": "5", "lines": "6", "bands": "4", "header offset": "0", "data type": "2", "interleave": "bil",
        "byte order": "0"}  # fmt: skip
NAME = Path("a.hdr")
PROGRAMS, POSITIONS = table("headers")["programs"], table("headers")["positions"]


def header_text(**changes: str | None) -> str:
    entries = BASE | {k.replace("_", " "): v for k, v in changes.items()}
    return "ENVI\n" + "".join(f"{k} = {v}\n" for k, v in entries.items() if v is not None)


def test_fields_and_lines_are_read():
    header = parse_header(header_text(wavelength="{ 1.5,\n 2.5, 3,4 }", note="a = b = c"), NAME)
    assert (header.samples, header.lines, header.bands, header.interleave) == (5, 6, 4, "bil")
    assert header.dtype == np.dtype("<i2")
    assert header.numbers("wavelength", 4).tolist() == [1.5, 2.5, 3.0, 4.0]
    assert header.text("note") == "a = b = c"  # "=" inside a value belongs to the value
    assert header.where("wavelength") == "a.hdr:9"
    assert header.line_of["note"] == 11
    assert parse_header(header_text(bands="1", interleave=None), NAME).interleave == "bsq"
    sidecar = parse_header("ENVI\nsamples = 5\nlines = 6\nbands = 4\n", NAME, sidecar=True)
    assert (sidecar.samples, sidecar.lines, sidecar.bands, sidecar.interleave) == (5, 6, 4, "tif")
    beyond = parse_header(header_text(samples="999999937", lines="999999893", bands="7", header_offset="3"), NAME)
    assert beyond.expected_bytes == 3 + 999999937 * 999999893 * 7 * 2  # more than 64 bits of float


WIDE = ("the header is written in UTF-16",)


@pytest.mark.parametrize(
    ("encoding", "mark", "notes"),
    [
        ("utf-8", b"", ()), ("utf-8-sig", b"", ()), ("latin-1", b"", ()), ("utf-16", b"", WIDE),
        ("utf-16-le", b"", WIDE), ("utf-16-be", b"\xfe\xff", WIDE),
    ],
)  # fmt: skip
def test_encodings(tmp_path, encoding, mark, notes):
    (path := tmp_path / "a.hdr").write_bytes(mark + header_text(description="{Größe µm}").encode(encoding))
    header = read_header(path)
    assert (header.text("description"), header.notes) == ("Größe µm", notes)
    if notes:
        path.write_bytes(path.read_bytes()[:-1])  # half a character
        with pytest.raises(InputError, match="after the closing brace"):
            read_header(path)


@pytest.mark.parametrize(("words", "order"), table("headers")["byte orders"].items())
def test_a_byte_order_in_words_is_read_and_noted(words, order):
    header = parse_header(header_text(byte_order=words), NAME)
    note = f"byte order {words.split(' ;')[0]!r}: read as {order}, {('little', 'big')[order]}-endian"
    assert (header.byte_order, header.notes) == (order, () if len(words) == 1 else (note,))
    with pytest.raises(InputError, match="unknown byte order"):
        parse_header(header_text(byte_order="intel" * 100_000), NAME)


def test_a_key_that_stands_twice_and_says_the_same_is_noted():
    text = header_text(a="{x[ 1,2 ],  y}") + "a = {x[1, 2],\n y}\n"
    header = parse_header(text, NAME)
    assert header.text("a") == "x[ 1,2 ],  y"
    assert header.notes == ("header: 'a' occurs twice with the same value (lines 9 and 10)",)
    with pytest.raises(InputError, match=r"a\.hdr:10: .*'x\[1,2\],y' against 'x\[1,3\],y'"):
        parse_header(text.replace("[1, 2]", "[1, 3]"), NAME)


def test_larger_than_the_cap_is_refused_unread_and_a_header_of_400000_lines_is_read(tmp_path):
    path, text = tmp_path / "a.hdr", header_text() + "; "
    path.write_text(text + "x" * (MAX_HEADER_BYTES - len(text)))
    assert read_header(path).samples == 5  # exactly at the cap
    path.write_text(text + "x" * (MAX_HEADER_BYTES - len(text) + 1))
    with pytest.raises(InputError, match="larger than 1048576 bytes"):
        read_header(path)
    # Inside a brace and outside: a reader that is quadratic in the number of lines needs half a minute.
    for filler in ("description = {" + "x\n" * 400_000 + "}\n", ";\n" * 400_000):
        assert parse_header(header_text() + filler, NAME).samples == 5


@given(st.text(max_size=300))
@settings(max_examples=200)
def test_any_text_gives_a_header_or_a_clear_error(text):
    for body in (text, "ENVI\n" + text, header_text() + text):
        try:
            samples = parse_header(body, NAME).samples
        except HypervalError:  # anything else fails the test
            samples = 1
        assert samples >= 1


@pytest.mark.parametrize(
    ("changes", "interleave", "notes"),
    [
        ({"interleave": "Bil"}, "bil", ()),
        ({"interleave": "BSQ ; band sequential"}, "bsq", ()),
        ({"byte_order": None}, "bil", ("the header states no byte order: read as little-endian",)),
        ({"byte_order": None, "data_type": "1"}, "bil", ()),  # a byte has none
    ],
)
@pytest.mark.parametrize("end", ["", "\0" * 300, "\x1a", "; a comment = 1\n\n"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_case_comments_ends_of_lines_and_of_text(changes, interleave, notes, end, newline):
    text = (header_text(**changes).replace("samples", "SAMPLES ") + end).replace("\n", newline)
    header = parse_header(text, NAME)
    assert (header.samples, header.interleave, header.notes) == (5, interleave, notes)


@pytest.mark.parametrize("program", PROGRAMS)
def test_headers_as_other_programs_write_them(tmp_path, program):
    entries, first_nm = PROGRAMS[program]
    text = "ENVI\nsamples = 2\nlines   = 2\nbands   = 3\ninterleave = bil\n" + entries
    (tmp_path / "a.hdr").write_bytes(text.encode())
    header = read_header(tmp_path / "a.hdr")
    stored = np.arange(1, 13).reshape(2, 3, 2)
    (tmp_path / "a.img").write_bytes(bytes(header.header_offset) + stored.astype(header.dtype).tobytes())
    assert header.byte_order == (program in ("HyMap", "Hyperion", "HYDICE"))
    cube = open_cube(tmp_path / "a.img", quantity="other")
    assert cube.axis.centre_nm[0] == pytest.approx(first_nm)
    assert np.array_equal(cube.read(0, 2).values, stored.transpose(0, 2, 1))
    in_names = any("names of the bands" in note for note in cube.notes)
    assert in_names == (program in ("ITRES", "GDAL", "AVIRIS"))
    if program == "HYDICE":  # as another reader has it, to which the byte order is a number
        assert cube.axis.good.tolist() == [False, True, True]
        np.testing.assert_allclose(cube.axis.fwhm_nm, [3.01, 3.03, 3.05])
        (tmp_path / "a.hdr").write_text(text.replace("Network (IEEE)", "1"))
        theirs = spectral.open_image(str(tmp_path / "a.hdr"))
        np.testing.assert_allclose(cube.read(0, 2).values, np.asarray(theirs.load()))


# Systems of coordinates -------------------------------------------------------------------------

SIZES = "ENVI\nsamples = 2\nlines = 2\nbands = 1\ndata type = 1\ninterleave = bsq\nbyte order = 0\n"


def positioned(info: str) -> CRS | None:
    header = parse_header(SIZES + f"map info = {{{info}}}\n", NAME)
    if "meters" in info.lower():  # a pixel of one metre
        assert pixel_area_m2(transform_of(header), None, header.entries) == 1.0
    return crs_of(header)


@pytest.mark.parametrize("letter", "CDEFGHJKLMNPQRSTUVWX")
def test_latitude_bands_c_to_m_are_south_and_n_to_x_north(letter):
    south = letter < "N"
    assert (
        positioned(f"UTM, 1, 1, 4e5, 4e6, 1, 1, 15, {letter}, WGS-84, units  meters, rotation  0.0").to_epsg()
        == 32615 + 100 * south
    )


@pytest.mark.parametrize("info", POSITIONS)
def test_common_datums_are_those_of_gdal_and_others_are_not_guessed(tmp_path, info):
    own = positioned(info)
    assert (own and own.to_epsg()) == POSITIONS[info]
    if own is None:
        return
    known = info.replace("Map Grid of Australia (MGA 94) Zone 55", "UTM").replace("55, Geo", "55, South, Geo")
    (tmp_path / "a.img").write_bytes(b"\1" * 4)
    (tmp_path / "a.hdr").write_text(SIZES + f"map info = {{{known}}}\n")
    with warnings.catch_warnings(action="ignore"), rasterio.open(tmp_path / "a.img", driver="ENVI") as dataset:
        other = dataset.crs
    point = ([-118.2], [34.1]) if own.is_geographic else ([400_000.0], [4_000_000.0])
    ours, theirs = (reproject(c, CRS.from_epsg(4326), *point) for c in (own, other))
    assert np.allclose(ours, theirs, rtol=0, atol=1e-7)


# Divisors of bands in a file beside -------------------------------------------------------------

DIVISORS = "  300.0 1\n  300.0 2\n 600.0 3\n 600.0 4\n 1200.0 5\n"
OVERLAPPING = SpectralAxis([400.0, 500.0, 590.0, 600.0, 700.0], 9.0)


def aviris(folder: Path, stored: np.ndarray, name: str) -> Path:
    """A big-endian cube of five bands of two detectors that overlap."""
    path = write_cube(folder / name, stored, data_type=2, interleave="bip", axis=OVERLAPPING, extra={"byte order": "1"})
    header = path.with_suffix(".hdr")
    header.write_text(header.read_text().replace("590.0, 600.0", "600.0, 590.0"))
    return path


def test_aviris_classic_is_divided_by_its_gain_file(tmp_path):
    stored = np.arange(1, 41).reshape(2, 4, 5) * 100
    path = aviris(tmp_path, stored, "f130612t01p00r10rdn_e_sc01_ort_img")
    (tmp_path / "f130612t01p00r10rdn_e.gain").write_text(DIVISORS, "utf-8-sig")
    (tmp_path / "f130612t01p00r11rdn_e.gain").write_text("1 1\n")  # of another line
    cube = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", sort_bands=True)
    expected = (stored / [300.0, 300.0, 600.0, 600.0, 1200.0])[..., [0, 1, 3, 2, 4]]
    np.testing.assert_allclose(cube.read(0, 2).values, expected, rtol=1e-12)
    assert cube.raster.source_files[-1].name == "f130612t01p00r10rdn_e.gain"
    assert any("f130612t01p00r10rdn_e.gain" in note for note in cube.notes)
    stated = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=1e-3, sort_bands=True)
    np.testing.assert_allclose(stated.read(0, 2).values[..., 0], stored[..., 0] * 1e-3, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("300 1\n300 2\n", "2 rows for 5 bands"),
        (DIVISORS.replace("600.0 3", "0 3"), ":3: 0 3"),
        (DIVISORS.replace("600.0 3", "600 4"), "channel that counts from 1"),
    ],
)
def test_a_gain_file_that_is_none(tmp_path, text, words):
    path = aviris(tmp_path, np.ones((2, 4, 5)), "f1_img")
    (tmp_path / "f1.gain").write_text(text)
    with pytest.raises(InputError, match=words):
        open_cube(path, quantity="radiance", sort_bands=True)
    (tmp_path / "f1.gain").write_text(DIVISORS)
    with pytest.raises(UsageError, match=r"in uW.*those of f1.gain(?s:.*)or state scale:"):
        open_cube(path, quantity="radiance", unit="W m-2 sr-1 nm-1", sort_bands=True)


# What a header says of its flight line ----------------------------------------------------------

AXIS = SpectralAxis(np.array([500.0, 900.0, 2007.0, 2400.0]), np.array([4.0, 4.0, 8.0, 8.0]))
SCENARIO = datetime(2012, 9, 20, 16, 31, tzinfo=UTC)


@pytest.mark.parametrize(("entries", "said"), table("headers")["times"])
def test_times_that_are_not_those_of_the_scenario(entries, said):
    notes = time_notes(entries, SCENARIO, "line")
    assert len(notes) == len(said)
    assert all(note.startswith("warning: header: ") and part in note for note, part in zip(notes, said, strict=True))


def test_times_around_midnight_and_with_an_offset():
    late = datetime(2012, 9, 20, 23, 58, tzinfo=UTC)
    assert time_notes({"gps start time": "00:03:00"}, late, "line") == ()
    local = datetime(2012, 9, 20, 12, 31, tzinfo=timezone(timedelta(hours=-4)))
    assert time_notes({"acquisition time": "2012-09-20T16:31:00"}, local, "line") == ()


@pytest.mark.parametrize(("entries", "quantity", "words"), table("headers")["acquisition"])
def test_each_entry_makes_its_notes(entries, quantity, words):
    notes = acquisition_notes(entries, AXIS, quantity)
    assert all(part in note for note, part in zip(notes, words, strict=True))
