"""Files that other programs wrote: headers, sidecars, positions and shapefiles as they are met outside."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS

from hyperval.envi_header import parse_header, read_header
from hyperval.errors import InputError, UsageError
from hyperval.imagery import crs_of, open_cube, pixel_area_m2, transform_of

SIZES = "ENVI\nsamples = 2\nlines = 2\nbands = 1\ndata type = 1\ninterleave = bsq\nbyte order = 0\n"


def positioned(info: str) -> CRS | None:
    return crs_of(parse_header(SIZES + f"map info = {{{info}}}\n", Path("a.hdr")))


def by_gdal(tmp_path: Path, info: str) -> CRS:
    (tmp_path / "a.img").write_bytes(b"\1" * 4)
    (tmp_path / "a.hdr").write_text(SIZES + f"map info = {{{info}}}\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(tmp_path / "a.img", driver="ENVI") as dataset:
            return dataset.crs


@pytest.mark.parametrize("letter", "CDEFGHJKLMNPQRSTUVWX")
def test_latitude_bands_c_to_m_are_south_and_n_to_x_north(letter: str):
    south = letter < "N"
    assert positioned(f"UTM, 1, 1, 4e5, 4e6, 1, 1, 15, {letter}, WGS-84").to_epsg() == 32615 + 100 * south


@pytest.mark.parametrize(
    ("info", "epsg"),
    [
        ("UTM, 1, 1, 4e5, 4e6, 1, 1, 11, North, North America 1983, units=Meters", 26911),
        ("UTM, 1, 1, 4e5, 4e6, 1, 1, 11, North, North America 1927, units=Meters", 26711),
        ("UTM, 1, 1, 4e5, 4e6, 1, 1, 32, North, European 1950, units=Meters", 23032),
        ("UTM, 1, 1, 4e5, 4e6, 1, 1, 32, North, WGS-72, units=Meters", 32232),
        ("UTM, 1, 1, 4e5, 4e6, 1, 1, 32, South, WGS-84, units=Meters", 32732),
        ("Geographic Lat/Lon, 1, 1, -118.2, 34.1, 0.001, 0.001, WGS-84, units=Degrees", 4326),
        ("Geographic Lat/Lon, 1, 1, -118.2, 34.1, 0.001, 0.001, North America 1983, units=Degrees", 4269),
        ("Geographic Lat/Lon, 1, 1, -118.2, 34.1, 0.001, 0.001, North America 1927, units=Degrees", 4267),
        ("Geographic Lat/Lon, 1, 1, 10.2, 44.1, 0.001, 0.001, European 1950, units=Degrees", 4230),
    ],
)
def test_common_datums_are_those_of_gdal(tmp_path: Path, info: str, epsg: int):
    own = positioned(info)
    assert own.to_epsg() == epsg
    other = by_gdal(tmp_path, info)
    point = ([-118.2], [34.1]) if own.is_geographic else ([400_000.0], [4_000_000.0])
    from rasterio.warp import transform

    ours, theirs = (transform(c, CRS.from_epsg(4326), *point) for c in (own, other))
    assert np.allclose(ours, theirs, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    "info",
    [
        "UTM, 1, 1, 4e5, 4e6, 1, 1, 11, North, Some Datum",
        "UTM, 1, 1, 4e5, 4e6, 1, 1, 45, North, North America 1983",  # no such zone
        "UTM, 1, 1, 4e5, 4e6, 1, 1, 11, South, North America 1983",
        "Geographic Lat/Lon, 1, 1, -118.2, 34.1, 0.001, 0.001",
        "Lambert, 1, 1, 4e5, 4e6, 1, 1, WGS-84",
        "UTM, 1, 1, 4e5, 4e6, 1, 1, 33, Sideways, WGS-84",
        "UTM, 1, 1, 4e5, 4e6, 1, 1, 15, North, WGS-84, units=Feet",
        "Geographic Lat/Lon, 1, 1, -425520, 122760, 1, 1, WGS-84, units=Seconds",
    ],
)
def test_other_systems_are_unknown_and_not_guessed(info: str):
    assert positioned(info) is None


@pytest.mark.data
def test_resonon_writes_a_latitude_band_and_units_without_equals_sign(data_dir):
    header = read_header(data_dir("formats/resonon_pika_utm_band_letter.bip.hdr"))
    assert crs_of(header).to_epsg() == 32615
    assert transform_of(header).almost_equals(
        Affine(0.04, 0, 441371.00707299996, 0, -0.04, 4855941.7317699995), precision=1e-9
    )
    assert pixel_area_m2(transform_of(header), None, header.entries) == pytest.approx(0.0016)


def small_cube(tmp_path: Path, entries: str, values: np.ndarray, name: str = "a.img") -> Path:
    """A BIP file of ``values`` (lines, samples, bands), big-endian 16-bit, with its header."""
    lines, samples, bands = values.shape
    values.astype(">i2").tofile(tmp_path / name)
    (tmp_path / (name + ".hdr")).write_text(
        f"ENVI\nsamples = {samples}\nlines = {lines}\nbands = {bands}\ndata type = 2\ninterleave = bip\n"
        f"byte order = 1\n{entries}"
    )
    return tmp_path / name


AVIRIS = "wavelength units = Nanometers\nwavelength = {400, 500, 600, 590, 700}\nfwhm = {9, 9, 9, 9, 9}\n"
DIVISORS = "  300.0 1\n  300.0 2\n 600.0 3\n 600.0 4\n 1200.0 5\n"


def test_aviris_classic_is_divided_by_its_gain_file(tmp_path: Path):
    stored = np.arange(1, 41).reshape(2, 4, 5) * 100
    path = small_cube(tmp_path, AVIRIS, stored, "f130612t01p00r10rdn_e_sc01_ort_img")
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
    path = small_cube(tmp_path, AVIRIS, np.ones((2, 4, 5)), "f1_img")
    (tmp_path / "f1.gain").write_text(text)
    with pytest.raises(InputError, match=words):
        open_cube(path, quantity="radiance", sort_bands=True)
    (tmp_path / "f1.gain").write_text(DIVISORS)
    with pytest.raises(UsageError, match=r"in uW.*those of f1.gain(?s:.*)or state scale:"):
        open_cube(path, quantity="radiance", unit="W m-2 sr-1 nm-1", sort_bands=True)


@pytest.mark.parametrize(
    ("entries", "note"),
    [
        ("band names = {Band 1 (0.400000), Band 2 (0.500000), Band 3 (0.600000)}\n", "names of its bands"),
        ("band names = {400.0 nm, 500.0 nm, 600.0 nm}\n", "names of its bands"),
        ("band names = {B 1 : 400.0 +/- 2.4 nm, B 2 : 500.0 +/- 2.4 nm, B 3 : 600.0 ± 2.4 nm}\n", "names of its bands"),
        ("wavelength =\n{\n400,\n500,\n600\n}\n", "can only be nm"),
        ("wavelength = {400 500\n600}\n", "can only be nm"),
        ('wavelength = {0.4, 0.5, 0.6}\nwavelength units = "Micrometers"\n', "no fwhm"),
    ],
)
def test_wavelengths_in_names_and_on_the_line_below(tmp_path: Path, entries: str, note: str):
    cube = open_cube(small_cube(tmp_path, entries, np.ones((2, 2, 3))), quantity="other")
    np.testing.assert_allclose(cube.axis.centre_nm, [400, 500, 600])
    assert any(note in n for n in cube.notes)


@pytest.mark.parametrize(
    "names", ["MNF 1 (12.345), MNF 2 (3.210), MNF 3 (1.100)", "Band 1, Band 2, Band 3", "400 nm, 0.5 um, 600 nm"]
)
def test_other_numbers_in_names_are_no_wavelengths(tmp_path: Path, names: str):
    path = small_cube(tmp_path, f"band names = {{{names}}}\n", np.ones((2, 2, 3)))
    with pytest.raises(InputError, match="lists no wavelengths"):
        open_cube(path, quantity="other")


# As HYDICE scenes were distributed: big-endian, bands below 400 nm, two lists that begin on the line of their key.
HYDICE = """ENVI
description = {
  HYDICE radiance, run 7}
samples = 2
lines   = 2
bands   = 3
header offset = 0
file type = ENVI Standard
data type = 2
interleave = bil
sensor type = HYDICE
byte order = 1
default bands = {3, 2, 1}
wavelength units = Micrometers
z plot titles = {Wavelength, Radiance}
wavelength = {
 0.39900,  0.40250,
 0.40610}
fwhm = {
 0.00301,  0.00303,
 0.00305}
bbl = {
 0, 1, 1}
"""


@pytest.mark.parametrize("order", ["1", "Network (IEEE)", "0", "Host (Intel)"])
def test_a_header_of_hydice_with_its_byte_order_in_numbers_or_words(tmp_path: Path, order: str):
    import spectral

    stored = np.arange(1, 13, dtype="i2").reshape(2, 3, 2)
    stored.astype("<i2" if order in ("0", "Host (Intel)") else ">i2").tofile(tmp_path / "a.img")
    text = HYDICE.replace("byte order = 1", f"byte order = {order}")
    (tmp_path / "a.hdr").write_text(text)
    cube = open_cube(tmp_path / "a.img", quantity="radiance", unit="W m-2 sr-1 um-1", scale=1.0)
    np.testing.assert_allclose(cube.axis.centre_nm, [399.0, 402.5, 406.1])
    np.testing.assert_allclose(cube.axis.fwhm_nm, [3.01, 3.03, 3.05])
    assert cube.axis.good.tolist() == [False, True, True]
    number = {"Network (IEEE)": "1", "Host (Intel)": "0"}.get(order, order)
    (tmp_path / "a.hdr").write_text(text.replace(f"byte order = {order}", f"byte order = {number}"))
    theirs = spectral.open_image(str(tmp_path / "a.hdr"))
    np.testing.assert_allclose(cube.read(0, 2).values, 0.1 * np.asarray(theirs.load()), rtol=1e-6)


# What comes after the sizes, as each program writes it, and the first wavelength [nm].
PROGRAMS = {
    "HySpex": (
        "data type = 12\nheader offset = 32\nID = VNIR\nComment = a = b\nwavelength = {400.0 ,500.0 ,600.0}\n", 400),
    "Headwall": (
        "data type=12\nrotation={{1, 2}, {3, 4}}\nlabel= VNIR\ntimestamp=;\nwavelength = {400\n,500\n,600\n}\n", 400),
    "Specim FX": (
        "data type = 12\nfile type = ENVI\n\nStart Time = UTC TIME: 08:18:33\n\nerrors = {none}\ntemperature = {\n"
        "28.65\n}\nwavelength = {\n400.0,\n500.0,\n600.0\n}\nfwhm = {\n5.0,\n5.0,\n5.0\n}\n", 400),
    "Resonon": (
        "data type = 12\nrotation = {0,0}\nflip radiometric calibration = False\nlabel = {}\nceiling = 4095\n"
        "wavelength = {400.0, 500.0, 600.0}\n", 400),
    "ITRES": (
        "data type = 2\nwavelength units = nanometers\nband names = {\n Band 1 : 400.0 +/- 2.4 nm,\n"
        " Band 2 : 500.0 +/- 2.4 nm,\n Band 3 : 600.0 +/- 2.4 nm}\n", 400),
    "HyMap": (
        "data type = 2\nbyte order = 1\nwavelength units = Micrometers\nwavelength = {\n 0.4361,0.4503,\n0.4652}\n"
        "fwhm = {0.0155,0.0152,0.015}\n", 436.1),
    "Hyperion": (
        "data type = 2\nbyte order = 1\nbbl = {0,1,1}\nwavelength units = Nanometers\n"
        "wavelength={355.59,365.76,375.94}\nfwhm={11.39,11.39,11.39}\n", 355.59),
    "IDL": ("data type = 4\nz plot range = {0.00, 1.00}\nwavelength = {\n 4.0e-001, 5.0e-001,\n 6.0e-001}\n", 400),
    "MATLAB": (
        "data type = 4\nbyte order = ieee-le\ndescription = {}\nwavelength units = Unknown\n"
        "wavelength = {400 500 600}\n", 400),
    "R": ("data type = 4\nwavelength units = \"Nanometers\"\nwavelength = {400, 500, 600,}\n", 400),
    "GDAL": ("data type = 4\nband names = {\n400 Nanometers,\n500 Nanometers,\n600 Nanometers}\n"
             "data ignore value = 0\n", 400),
    "DOS": ("data type = 4\nWavelength\t=\t{ .4,.5,.6 }\r\nwavelength units = Micrometer\r\n\x1a\x00\x00", 400),
}  # fmt: skip


@pytest.mark.parametrize("program", PROGRAMS)
def test_headers_as_other_programs_write_them(tmp_path: Path, program: str):
    entries, first_nm = PROGRAMS[program]
    text = "ENVI\nsamples = 2\nlines   = 2\nbands   = 3\ninterleave = bil\n" + entries
    (tmp_path / "a.hdr").write_bytes(text.encode())
    header = read_header(tmp_path / "a.hdr")
    stored = np.arange(1, 13).reshape(2, 3, 2)
    (tmp_path / "a.img").write_bytes(bytes(header.header_offset) + stored.astype(header.dtype).tobytes())
    assert header.byte_order == (program in ("HyMap", "Hyperion"))
    cube = open_cube(tmp_path / "a.img", quantity="other")
    assert cube.axis.centre_nm[0] == pytest.approx(first_nm)
    assert np.array_equal(cube.read(0, 2).values, stored.transpose(0, 2, 1))
