"""What a SpecTIR header says of its flight line, in words; keys as a header of 2010 writes them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from hyperval.envi_header import parse_header
from hyperval.imagery.acquisition import acquisition_notes
from hyperval.imagery.cube import open_cube
from hyperval.spectra.axis import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 900.0, 2007.0, 2400.0]), np.array([4.0, 4.0, 8.0, 8.0]))
LINE = {
    "calculated co2 shift": "3.65",
    "cal file": "sn110002_5nm.cal",
    "gps start time": "16:31:02.5",
    "gps stop time": "16:33:40.0",
    "fps": "67.00",
    "tint1": "3.0000",
    "tint2": "5.0000",
    "binning": "4, 2",
    "himg1": "1, 320",
    "himg2": "1, 320",
    "vimg1": "1,117",
    "vimg2": "118,360",
    "sensor type": "AISA",
}


def test_every_entry_is_reported_once():
    shift, calibration, times, settings, windows = acquisition_notes(LINE, AXIS, 320, 360)
    assert shift.startswith("warning: header: CO2 shift 3.65 nm found ('calculated co2 shift'")
    assert "0.46 of a band width at 2007 nm" in shift  # 3.65 / 8
    assert "wavelength_shift_nm" in shift
    assert calibration == "header: calibration from cal file sn110002_5nm.cal"
    assert "gps start time 16:31:02.5, gps stop time 16:33:40.0" in times
    assert "fps 67.00, tint1 3.0000, tint2 5.0000, binning 4, 2" in settings
    assert windows == "header: 2 detectors, bands 1-117 and 118-360 (from 1)"


def test_a_header_without_them_gives_no_note():
    assert acquisition_notes({"sensor type": "x", "band names": "a, b", "data gain values": "1"}, AXIS, 1, 4) == ()


def test_windows_that_are_not_those_of_the_cube():
    notes = acquisition_notes({"vimg1": "1,117", "vimg2": "118,360", "himg1": "1,320"}, AXIS, 655, 254)
    assert notes[0] == "warning: header: detectors hold bands 1-117 and 118-360 (from 1), the cube 254"
    assert "320 samples across the track, 655 in the cube" in notes[1]


@pytest.mark.parametrize(
    ("text", "begin"),
    [
        ("0.00", "header: calculated co2 shift is 0"),
        ("none", "warning: header: 'calculated co2 shift = none' is not understood"),
        ("-1.2 nm", "warning: header: CO2 shift -1.2 nm found"),
        ("1e999", "warning: header: 'calculated co2 shift = 1e999' is not understood"),
    ],
)
def test_shifts(text, begin):
    (note,) = acquisition_notes({"calculated co2 shift": text}, AXIS, 1, 4)
    assert note.startswith(begin)


def test_a_sensor_without_the_co2_bands_gets_no_width():
    visible = SpectralAxis(np.array([500.0, 900.0]), np.array([4.0, 4.0]))
    (note,) = acquisition_notes({"co2 shift": "0.35"}, visible, 1, 2)
    assert "band width" not in note


def test_a_hand_built_header_is_read_through_the_parser():
    text = "ENVI\nsamples = 2\nlines = 1\nbands = 4\ndata type = 2\ninterleave = bil\nbyte order = 0\n"
    text += "Calculated CO2 Shift = 3.65\nvimg1 = {1,2}\nvimg2 = {3,4}\nbinning = {\n 4, 2}\n"
    notes = acquisition_notes(parse_header(text, Path("x.hdr")).extras, AXIS, 2, 4)
    assert [n.split(" found")[0] for n in notes] == [
        "warning: header: CO2 shift 3.65 nm",
        "header: binning 4, 2 (integration times without a unit; milliseconds are usual)",
        "header: 2 detectors, bands 1-2 and 3-4 (from 1)",
    ]


@pytest.mark.data
def test_a_cube_with_the_bands_and_bad_bands_of_a_real_line(data_dir, tmp_path):
    """A cube written by hand under the 360 bands that a real ProSpecTIR-VS header lists."""
    with open(data_dir("sensors/prospectir_vs_bands_2010.csv"), newline="") as stream:
        table = list(csv.DictReader(stream))
    keys = {"wavelength": "center_um", "fwhm": "fwhm_um", "bbl": "bbl"}
    listed = {key: ", ".join(row[column] for row in table) for key, column in keys.items()}
    text = "ENVI\nsamples = 2\nlines = 1\nbands = 360\ndata type = 2\ninterleave = bil\nbyte order = 0\n"
    text += "wavelength units = Micrometers\ncalculated co2 shift = 3.65\nvimg1 = {1,117}\nvimg2 = {118,360}\n"
    text += "".join(f"{k} = {{{v}}}\n" for k, v in listed.items())
    (tmp_path / "l.hdr").write_text(text)
    np.full((1, 360, 2), 500, "<i2").tofile(tmp_path / "l.img")
    cube = open_cube(tmp_path / "l.img", quantity="radiance", unit="uW cm-2 sr-1 nm-1", scale=0.001)
    assert "bad-band list: 106 of 360 bands are bad" in cube.notes
    notes = acquisition_notes(cube.extras, cube.axis, cube.samples, 360)
    assert "of a band width at 20" in notes[0]
    assert notes[1] == "header: 2 detectors, bands 1-117 and 118-360 (from 1)"
