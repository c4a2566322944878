"""Headers: what the parser understands and notes, as other programs write them, and what they say of a flight line."""

import warnings
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
import rasterio
import spectral
from hypothesis import given, settings
from hypothesis import strategies as st
from rasterio.crs import CRS
from rasterio.warp import transform as reproject
from small_files import table

from hyperval.envi_header import MAX_HEADER_BYTES, parse_header, read_header
from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.imagery import acquisition_notes, crs_of, open_cube, pixel_area_m2, time_notes, transform_of, write_cube
from hyperval.spectra import SpectralAxis

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
    assert set(header.extras) == {"wavelength", "note"}
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
def test_encodings(tmp_path: Path, encoding: str, mark: bytes, notes: tuple[str, ...]):
    path = tmp_path / "a.hdr"
    path.write_bytes(mark + header_text(description="{Größe µm}").encode(encoding))
    header = read_header(path)
    assert (header.text("description"), header.notes) == ("Größe µm", notes)
    if notes:
        path.write_bytes(path.read_bytes()[:-1])  # half a character
        with pytest.raises(InputError, match="after the closing brace"):
            read_header(path)


@pytest.mark.parametrize(("words", "order"), table("headers")["byte orders"].items())
def test_a_byte_order_in_words_is_read_and_noted(words: str, order: int):
    header = parse_header(header_text(byte_order=words), NAME)
    note = f"byte order {words.split(' ;')[0]!r}: read as {order}, {('little', 'big')[order]}-endian"
    assert (header.byte_order, header.notes) == (order, () if len(words) == 1 else (note,))
    with pytest.raises(InputError, match="unknown byte order"):
        parse_header(header_text(byte_order="intel" * 100_000), NAME)


def test_a_key_that_stands_twice_and_says_the_same_is_noted():
    text = header_text(a="{x[ 1,2 ],  y}") + "a = {x[1, 2],\n y}\n"
    header = parse_header(text, NAME)
    assert header.text("a") == "x[ 1,2 ],  y"
    assert header.notes == ("header: 'a' stands twice and says the same (lines 9 and 10)",)
    with pytest.raises(InputError, match=r"a\.hdr:10: .*'x\[1,2\],y' against 'x\[1,3\],y'"):
        parse_header(text.replace("[1, 2]", "[1, 3]"), NAME)


def test_larger_than_the_cap_is_refused_unread_and_a_header_of_400000_lines_is_read(tmp_path: Path):
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
def test_any_text_gives_a_header_or_a_clear_error(text: str):
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
def test_headers_as_other_programs_write_them(tmp_path: Path, program: str):
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
    in_names = any("names of its bands" in note for note in cube.notes)
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
def test_latitude_bands_c_to_m_are_south_and_n_to_x_north(letter: str):
    south = letter < "N"
    assert (
        positioned(f"UTM, 1, 1, 4e5, 4e6, 1, 1, 15, {letter}, WGS-84, units  meters, rotation  0.0").to_epsg()
        == 32615 + 100 * south
    )


@pytest.mark.parametrize("info", POSITIONS)
def test_common_datums_are_those_of_gdal_and_others_are_not_guessed(tmp_path: Path, info: str):
    own = positioned(info)
    assert (own and own.to_epsg()) == POSITIONS[info]
    if own is None:
        return
    (tmp_path / "a.img").write_bytes(b"\1" * 4)
    (tmp_path / "a.hdr").write_text(SIZES + f"map info = {{{info}}}\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(tmp_path / "a.img", driver="ENVI") as dataset:
            other = dataset.crs
    point = ([-118.2], [34.1]) if own.is_geographic else ([400_000.0], [4_000_000.0])
    ours, theirs = (reproject(c, CRS.from_epsg(4326), *point) for c in (own, other))
    assert np.allclose(ours, theirs, rtol=0, atol=1e-7)


# Divisors of bands in a file beside -------------------------------------------------------------

DIVISORS = "  300.0 1\n  300.0 2\n 600.0 3\n 600.0 4\n 1200.0 5\n"
OVERLAPPING = SpectralAxis([400.0, 500.0, 590.0, 600.0, 700.0], 9.0)


def aviris(folder: Path, stored: np.ndarray, name: str) -> Path:
    """A big-endian cube of five bands of two detectors that overlap."""
    path = write_cube(folder / name, stored, data_type=2, interleave="bip", byte_order=1, axis=OVERLAPPING)
    header = path.with_suffix(".hdr")
    header.write_text(header.read_text().replace("590.0, 600.0", "600.0, 590.0"))
    return path


def test_aviris_classic_is_divided_by_its_gain_file(tmp_path: Path):
    stored = np.arange(1, 41).reshape(2, 4, 5) * 100
    path = aviris(tmp_path, stored, "f130612t01p00r10rdn_e_sc01_ort_img")
    (tmp_path / "f130612t01p00r10rdn_e.gain").write_text(DIVISORS)
    (tmp_path / "f130612t01p00r11rdn_e.gain").write_text("1 1\n")  # of another line
    cube = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", sort_bands=True)
    expected = (stored / [300.0, 300.0, 600.0, 600.0, 1200.0])[..., [0, 1, 3, 2, 4]]
    np.testing.assert_allclose(cube.read(0, 2).values, expected, rtol=1e-12)
    assert cube.source_files[-1].name == "f130612t01p00r10rdn_e.gain"
    assert any("f130612t01p00r10rdn_e.gain" in note for note in cube.notes)
    stated = open_cube(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=1e-3, sort_bands=True)
    np.testing.assert_allclose(stated.read(0, 2).values[..., 0], stored[..., 0] * 1e-3, rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("300 1\n300 2\n", "2 rows for 5 bands"),
        (DIVISORS.replace("600.0 3", "0 3"), ":3: '0 3'"),
        (DIVISORS.replace("600.0 3", "600 4"), "channel that counts from 1"),
    ],
)
def test_a_gain_file_that_is_none(tmp_path: Path, text: str, words: str):
    path = aviris(tmp_path, np.ones((2, 4, 5)), "f1_img")
    (tmp_path / "f1.gain").write_text(text)
    with pytest.raises(InputError, match=words):
        open_cube(path, quantity="radiance", sort_bands=True)
    (tmp_path / "f1.gain").write_text(DIVISORS)
    with pytest.raises(UsageError, match=r"in uW.*those of f1.gain(?s:.*)or state scale:"):
        open_cube(path, quantity="radiance", unit="W m-2 sr-1 nm-1", sort_bands=True)


# What a header says of its flight line ----------------------------------------------------------

AXIS = SpectralAxis(np.array([500.0, 900.0, 2007.0, 2400.0]), np.array([4.0, 4.0, 8.0, 8.0]))
LINE = {
    "calculated co2 shift": "3.65", "cal file": "sn110002_5nm.cal", "gps start time": "16:31:02.5",
    "gps stop time": "16:33:40.0", "fps": "67.00", "tint1": "3.0000", "tint2": "5.0000", "binning": "4, 2",
    "himg1": "1, 320", "himg2": "1, 320", "vimg1": "1,117", "vimg2": "118,360", "sensor type": "AISA",
}  # fmt: skip
SCENARIO = datetime(2012, 9, 20, 16, 31, tzinfo=UTC)


def test_every_entry_is_reported_once():
    sensor, shift, calibration, times, settings, windows = acquisition_notes(LINE, AXIS, 320, 360)
    assert sensor == "header: sensor type AISA"
    assert shift.startswith("warning: header: CO2 shift 3.65 nm found ('calculated co2 shift'")
    assert "0.46 of a band width at 2007 nm" in shift  # 3.65 / 8
    assert "wavelength_shift_nm" in shift
    assert calibration == "header: calibration from cal file sn110002_5nm.cal"
    assert "gps start time 16:31:02.5, gps stop time 16:33:40.0" in times
    assert "fps 67.00, tint1 3.0000, tint2 5.0000, binning 4, 2" in settings
    assert windows == "header: 2 detectors, bands 1-117 and 118-360 (from 1)"


@pytest.mark.parametrize(("lines", "said"), [(10_500, False), (11_300, False), (4000, True), (None, False)])
def test_lines_by_the_frame_rate_and_by_the_clock(lines, said):
    # 16:31:02.5 to 16:33:40.0 are 157.5 s, or 10,552 lines at 67 a second.
    notes = acquisition_notes(LINE, AXIS, 320, 360, lines=lines)
    assert any("take 59.7 s, the GPS times are 157.5 s apart" in n for n in notes) == said


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


@pytest.mark.parametrize(("entries", "quantity", "begin"), table("headers")["acquisition"])
def test_each_entry_makes_its_notes(entries, quantity, begin):
    notes = acquisition_notes(entries, AXIS, 1, 4, quantity=quantity)
    assert [note[: len(start)] for note, start in zip(notes, begin, strict=True)] == begin
