"""Daily files of RadCalNet: what they say, what is refused."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from hyperval.errors import InputError, UsageError
from hyperval.spectra import read_radcalnet, read_records, read_spectrum

STATE = "P:\t900\t901\nT:\t290.5\t291.5\nWV:\t0.5\t0.6\nO3:\t280\t281\nAOD:\t0.1\t0.2\nAng:\t1.1\t9997\n"
GOOD = (
    "Site:\tXXXX01\nLat:\t40.5\nLon:\t-109.5\nAlt:\t1270\n\nYear:\t2020\t2020\t\nDOY(U):\t60\t60\t\n"
    "UTC:\t03:30\t04:00\nDOY(L):\t60\t60\t\nLocal:\t11:30\t12:00\n"
    + STATE
    + "Type:\tR\tR\n400\t0.10\t0.20\t\n410\t  9998\t0.21\n420\t0.12\t0.22\n\n"
    + STATE.replace("9997", "0.1")
    + "400\t0.01\t0.02\n410\t9998\t0.03\n420\t0.02\t0.02\n"
)


def written(tmp_path: Path, text: str = GOOD, name: str = "day.input") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def test_a_day_as_it_stands(tmp_path):
    day = read_radcalnet(written(tmp_path))
    assert (day.site, day.latitude_deg, day.longitude_deg, day.altitude_m) == ("XXXX01", 40.5, -109.5, 1270.0)
    assert day.quantity == "reflectance"
    assert day.times == (datetime(2020, 2, 29, 3, 30, tzinfo=UTC), datetime(2020, 2, 29, 4, 0, tzinfo=UTC))
    assert day.wavelength_nm.tolist() == [400.0, 410.0, 420.0]
    np.testing.assert_array_equal(day.values, [[0.10, np.nan, 0.12], [0.20, 0.21, 0.22]])
    np.testing.assert_array_equal(day.uncertainty, [[0.01, np.nan, 0.02], [0.02, 0.03, 0.02]])
    assert day.valid == ("03:30",)  # the Angstrom exponent of the other is no value
    at = day.at("03:30")
    assert (at["pressure_hpa"], at["ozone_atm_cm"], at["u_aot550"]) == (900.0, 0.28, 0.1)
    with pytest.raises(UsageError, match="04:00 holds no value"):
        day.at("04:00")
    with pytest.raises(UsageError, match="05:00 is none of the file"):
        day.at("05:00")


def test_it_is_a_file_of_spectra_like_others(tmp_path):
    path = written(tmp_path)
    (found,) = read_records(path)
    assert found.name == "03:30"
    assert found.wavelength_nm.tolist() == [400.0, 420.0]
    assert found.standard_deviation is not None
    assert found.standard_deviation.tolist() == [0.01, 0.02]
    with pytest.raises(InputError, match=r"holds top-of-atmosphere reflectance, not reflectance"):
        read_spectrum(written(tmp_path, name="day.output"), record="03:30")
    with pytest.raises(UsageError, match=r"\.input \(surface\)"):
        read_radcalnet(written(tmp_path, name="day.txt"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Lat:\t40.5", "Lat:\tforty", r":2: not a row of numbers"),
        ("Alt:", "Height:", r":4: 'Height:' where 'Alt' belongs"),
        ("UTC:\t03:30\t04:00", "UTC:\t03:30", r":8: 1 values of UTC"),
        ("UTC:\t03:30\t04:00", "UTC:\t04:00\t03:30", "do not follow each other"),
        ("UTC:\t03:30\t04:00", "UTC:\t03:30\t25:00", "not a time"),
        ("DOY(U):\t60\t60", "DOY(U):\t60\t600", "day 600"),
        ("400\t0.10\t0.20", "400\t0.10", r":18: 1 values"),
        ("400\t0.10\t0.20", "400\t0.10\t20", "neither a reflectance nor a mark"),
        ("400\t0.10\t0.20", "430\t0.10\t0.20", "no increasing wavelengths"),
        ("400\t0.01\t0.02", "400\t0.01\t-0.02", "uncertainties below 0"),
        ("400\t0.01\t0.02\n", "", "uncertainties at other wavelengths"),
        (
            STATE.replace("9997", "0.1") + "400\t0.01\t0.02\n410\t9998\t0.03\n420\t0.02\t0.02\n",
            "",
            "end of the file",
        ),
        ("0.10\t0.20", "0.10\tnan", "a number is missing"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, old, new, words):
    assert old in GOOD
    with pytest.raises(InputError, match=words):
        read_radcalnet(written(tmp_path, GOOD.replace(old, new, 1)))


@pytest.mark.data
def test_the_real_day(data_dir):
    name = "radcalnet/BTCN02_2018_148_v00.03.input"
    day = read_radcalnet(data_dir(name))
    assert day.valid == ("04:00", "04:30", "05:00", "05:30", "06:00", "06:30", "07:00")
    assert day.wavelength_nm.size == 211
    assert day.at("05:30")["angstrom_exponent"] == 0.196
    spectrum = read_spectrum(data_dir(name), record="05:30")
    assert spectrum.wavelength_nm.tolist() == list(range(400, 1001, 10))
    top = read_radcalnet(data_dir("radcalnet/BTCN02_2018_148_v02.03.output"))
    assert top.quantity == "top-of-atmosphere reflectance"
    assert top.values[top.column("05:30"), 0] == 0.1784
