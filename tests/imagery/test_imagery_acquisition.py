"""What a SpecTIR header says of its flight line, in words; keys as a header of 2010 writes them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest

from hyperval.imagery import acquisition_notes, time_notes
from hyperval.spectra import SpectralAxis

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


SCENARIO = datetime(2012, 9, 20, 16, 31, tzinfo=UTC)


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"gps start time": "16:31:02.5", "gps stop time": "16:33:40.0"}, []),
        ({"acquisition time": "2012-09-20T16:31:00Z"}, []),
        ({"gps start time": "12:31:02"}, ["240 minutes before the time of scenario 'line', 16:31:00 UTC"]),
        ({"gps start time": "16:42:00"}, ["11 minutes after"]),
        ({"acquisition date": "2012/09/21"}, ["is not the day of scenario 'line', 2012-09-20"]),
        ({"acquisition date": "20/09/2012", "gps start time": "unknown", "start time": "99:99"}, []),
        ({"acquisition date": "2012-13-41"}, []),
        ({"sensor type": "16:00"}, []),
    ],
)
def test_times_that_are_not_those_of_the_scenario(entries, said):
    notes = time_notes(entries, SCENARIO, "line")
    assert len(notes) == len(said)
    assert all(note.startswith("warning: header: ") and part in note for note, part in zip(notes, said, strict=True))


def test_times_around_midnight_and_with_an_offset():
    late = datetime(2012, 9, 20, 23, 58, tzinfo=UTC)
    assert time_notes({"gps start time": "00:03:00"}, late, "line") == ()
    local = datetime(2012, 9, 20, 12, 31, tzinfo=timezone(timedelta(hours=-4)))
    assert time_notes({"acquisition time": "2012-09-20T16:31:00"}, local, "line") == ()


@pytest.mark.parametrize(
    ("entries", "options", "begin"),
    [
        ({"band names": "a, b", "data gain values": "1", "file type": "ENVI"}, {}, []),
        ({"vimg1": "1,117", "vimg2": "118,360"}, {}, ["warning: header: detectors hold bands 1-117 and 118-360"]),
        ({"himg1": "1,320"}, {}, ["header: 320 samples across the track, 1 in the cube"]),
        ({"calculated co2 shift": "0.00"}, {}, ["header: calculated co2 shift is 0"]),
        ({"co2 shift": "none"}, {}, ["warning: header: 'co2 shift = none' is not understood"]),
        ({"co2 shift": "-1.2 nm"}, {}, ["warning: header: CO2 shift -1.2 nm found"]),
        ({"co2 shift": "1e999"}, {}, ["warning: header: 'co2 shift = 1e999' is not understood"]),
        ({"wavelength shift": "-0.8 nm"}, {}, ["warning: header: wavelength shift -0.8 nm found ('wavelength shift'"]),
        ({"sensor name": "VS", "instrument id": "sn 7"}, {}, ["header: sensor name VS, instrument id sn 7"]),
        ({"dark file name": "d"}, {}, ["header: calibration from dark file name d"]),
        ({"fps": "67", "tint2": "20.0"}, {}, ["header: fps", "warning: header: tint2 20 is longer than a frame at 67"]),
        ({"data units": "Reflectance x 10000"}, {"quantity": "radiance"}, ["header: data", "warning: header: 'data"]),
        ({"data units": "Reflectance x 10000"}, {"quantity": "reflectance"}, ["header: data units"]),
        ({"processing level": "at-sensor radiance"}, {"quantity": "reflectance"}, ["header: pro", "warning: header"]),
        ({"z plot titles": "Wavelength (nm), Radiance"}, {"quantity": "radiance"}, ["header: z plot titles"]),
        ({"data units": "irradiance"}, {"quantity": "reflectance"}, ["header: data units irradiance"]),
    ],
)
def test_each_entry_makes_its_notes(entries, options, begin):
    notes = acquisition_notes(entries, AXIS, 1, 4, **options)
    assert [note[: len(start)] for note, start in zip(notes, begin, strict=True)] == begin
