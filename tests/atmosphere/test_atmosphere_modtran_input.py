"""Decks and JSON input for MODTRAN: fixed columns as in real decks, and what the input of others states."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest

from hyperval.atmosphere import (
    AtmosphericState,
    distance_on_day,
    modtran6_json,
    read_modtran_json,
    stated_albedo,
    stated_fields,
    tape5,
)
from hyperval.errors import InputError, UsageError

# Lines of a case of versions 4 and 5 and their columns, from the lists of cards in the user's manuals: name, first
# column - 1, last; where the versions differ, those of each.
COLUMNS = {
    0: "MODEL 4 5, ITYPE 6 10, IEMSCT 11 15, IMULT 16 20, SURREF 73 80",
    1: "DIS 0 1, NSTR 2 5 | 3 6, CO2MX 10 20, H2OSTR 20 30, O3STR 30 40",
    2: "IHAZE 2 5, VIS 30 40, GNDALT 70 80",
    3: "H1 0 10, H2 10 20, ANGLE 20 30, LENN 60 65",
    4: "IPARM 0 5, IPH 5 10, IDAY 10 15",
    5: "PARM1 0 10, PARM2 10 20",
    6: "V1 0 10, V2 10 20, DV 20 30, FWHM 30 40, YFLAG 40 41, XFLAG 41 42",
    7: "IRPT 0 5",
}


def state(**changes):
    fields = {
        "model": "midlatitude-summer", "water_vapour_g_cm2": 1.5, "ozone_atm_cm": 0.3, "aerosol": "rural",
        "aot550": 0.1, "ground_altitude_km": 0.35, "sensor_altitude_km": 2.3, "solar_zenith_deg": 52.44,
        "solar_azimuth_deg": 163.7, "day_of_year": 312, "view_zenith_deg": 20.0, "view_azimuth_deg": 90.0,
    }  # fmt: skip
    return AtmosphericState(**{**fields, **changes})


def card(lines, number, version):
    """The fields of one line, numbers where they are numbers."""
    found = {}
    for part in COLUMNS[number].split(", "):
        name, *places = part.replace("|", "").split()
        start, end = map(int, places[-2:] if version == 5 else places[:2])
        text = lines[number][start:end].strip()
        found[name] = float(text) if text[-1:].isdigit() and text[:1] not in "ag" else text
    return found


def deck(version=5, **changes):
    lines = tape5(state(**changes), [0.1], version).splitlines()
    return {name: value for number in COLUMNS for name, value in card(lines, number, version).items()}


@pytest.mark.parametrize("version", [4, 5])
def test_deck_says_what_the_state_says_column_by_column(version):
    found = deck(version)
    assert 160.0 < found.pop("ANGLE") < 160.02  # 20 degrees at the ground is a little less at the sensor
    # The depth for version 5; for version 4 the range that MODTRAN 6 prints of optical depth 0.1 over 0.35 km.
    assert found.pop("VIS") == (-0.1 if version == 5 else pytest.approx(82.73, rel=0.005))
    assert found == {
        "MODEL": 2, "ITYPE": 2, "IEMSCT": 2, "IMULT": -1, "SURREF": 0.1, "DIS": "T", "NSTR": 8, "CO2MX": 400,
        "H2OSTR": "g1.50000", "O3STR": "a0.30000", "IHAZE": 1, "GNDALT": 0.35, "H1": 2.3, "H2": 0.35, "LENN": 0,
        "IPARM": 12, "IPH": 2, "IDAY": 312, "PARM1": 73.7, "PARM2": 52.44, "V1": 3800, "V2": 29500, "DV": 5, "FWHM": 5,
        "YFLAG": "R", "XFLAG": "W", "IRPT": 0,
    }  # fmt: skip
    blank = deck(version, water_vapour_g_cm2=None, ozone_atm_cm=None)  # left to the model
    assert blank["H2OSTR"] == blank["O3STR"] == ""
    for none in ({"aerosol": "none", "aot550": None}, {"aot550": 0.0}):
        assert (deck(version, **none)["IHAZE"], deck(version, **none)["VIS"]) == (0, 0.0)
    far = deck(version, sensor_altitude_km=99_999.0, ground_altitude_km=4.9, aot550=5.0, solar_zenith_deg=80.0)
    assert (far["H1"], far["GNDALT"], far["PARM2"]) == (99_999.0, 4.9, 80.0)
    distance = deck(version, day_of_year=None, earth_sun_distance_au=1.0)
    assert distance_on_day(int(distance["IDAY"])) == pytest.approx(1.0, abs=2e-4)


def test_every_run_of_the_model_and_what_modtran_does_not_have():
    lines = tape5(state()).splitlines()
    assert [float(line[73:80]) for line in lines[::8]] == [0.0, 0.1, 0.5]
    assert [int(line) for line in lines[7::8]] == [1, 1, 0]
    for aerosol in ("continental", {"dust": 0.5, "soot": 0.5}):
        with pytest.raises(UsageError, match="aerosol"):
            tape5(state(aerosol=aerosol))
    for albedos in ([], [0.0, 1.2]):
        for write in (tape5, modtran6_json):
            with pytest.raises(UsageError, match="runs over ground"):
                write(state(), albedos)
    with pytest.raises(UsageError, match="MODTRAN 3"):
        tape5(state(), [0.0], 3)


@pytest.mark.data
@pytest.mark.parametrize(
    ("relative", "version", "at", "values"),
    [
        ("modtran5_decks/data_path100/tape5.gz", 5, range(7), {}),
        ("wagl_modtran5_6/TL_alb_t.tp5", 5, (0, 1, 3, 4, 5, 6, 7), {}),
        (
            "wagl_modtran5_6/TL_alb_0.tp5", 5, (0, 1, 3, 4, 5, 6, 7),
            {"MODEL": 2, "SURREF": 0, "NSTR": 8, "CO2MX": 375, "H2OSTR": "g1.07000", "O3STR": "a0.285", "IHAZE": 1,
             "VIS": -0.023, "GNDALT": 0.709, "H1": 705, "H2": 0.709, "ANGLE": 171.001, "V1": 350, "FWHM": 1,
             "YFLAG": "R", "XFLAG": "N"},
        ),
        ("modtran5_decks/OMAA_userprofile/tape5.tp5", 5, (0, 1, 2, 36, 37, 38, 39), {"SURREF": -4, "IDAY": 195}),
    ],
)  # fmt: skip
def test_real_decks_have_the_same_columns(data_dir, relative, version, at, values):
    path = data_dir(f"modtran/{relative}")
    raw = path.read_bytes()
    lines = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode().splitlines()
    found = {k: v for i in range(7) for k, v in card([lines[n] for n in at], i, version).items()}
    assert {name: found[name] for name in values} == values
    for name, value in found.items():  # a field cut in the wrong place would hold the ends of two numbers
        assert " " not in str(value), name


def test_json_input_states_the_state(tmp_path):
    (tmp_path / "input.json").write_text(modtran6_json(state(view_zenith_deg=0.0), name="NAME"))
    cases = read_modtran_json(tmp_path / "input.json")
    assert [(c["NAME"], c["CASE"], stated_albedo(c)) for c in cases] == [
        ("NAME", i, a) for i, a in enumerate((0, 0.1, 0.5))
    ]
    found, given = stated_fields(cases[0], "input.json"), state(view_zenith_deg=0.0).model_dump()
    assert {name: found[name] for name in found} == {name: given[name] for name in found}
    assert {"model", "aerosol", "aot550", "water_vapour_g_cm2", "solar_zenith_deg", "day_of_year"} <= set(found)


@pytest.mark.data
def test_json_has_the_keys_and_kinds_of_the_real_template(data_dir):
    template = read_modtran_json(data_dir("modtran/modtran6_airborne_lut/modtran_template.json"))[0]
    ours = json.loads(modtran6_json(state()))["MODTRAN"][0]["MODTRANINPUT"]
    assert set(ours) == set(template)
    for section in ("RTOPTIONS", "ATMOSPHERE", "GEOMETRY", "SPECTRAL", "FILEOPTIONS"):
        assert set(ours[section]) - {"OBSZEN"} <= set(template[section])
        for name in set(ours[section]) & set(template[section]):
            assert isinstance(ours[section][name], str) == isinstance(template[section][name], str), name
    for name in ("MODTRN", "IEMSCT", "IMULT", "NSTR"):
        assert ours["RTOPTIONS"][name] == template["RTOPTIONS"][name]
    assert len(ours["SPECTRAL"]["FLAGS"]) == len(template["SPECTRAL"]["FLAGS"]) == 7


@pytest.mark.data
def test_fields_of_real_json_input(data_dir):
    lawn = read_modtran_json(data_dir("pasadena/lut_multi/LUT_AOT550-0.1000_H2OSTR-1.5000.json"))
    assert [stated_albedo(c) for c in lawn] == [0.0, 0.1, 0.5]
    found = stated_fields(lawn[0], "lawn")
    assert (found["aot550"], found["water_vapour_g_cm2"], found["sensor_altitude_km"]) == (0.1, 1.5, 2.3)
    # The run's own tp6 prints a solar zenith angle of 52.5 degrees for it.
    assert found["solar_zenith_deg"] == pytest.approx(52.5, abs=0.15)
    thermal = read_modtran_json(data_dir("modtran/wagl_modtran5_6/thermal_channel.json"))
    assert "solar_zenith_deg" not in stated_fields(thermal[0], "thermal")


def test_sun_by_place_and_time_counts_longitude_to_the_west():
    geometry = {"IPARM": 11, "PARM1": 34.139247, "PARM2": 118.127521, "IDAY": 312, "GMTIME": 18.708}
    found = stated_fields({"GEOMETRY": geometry}, "case")
    same = AtmosphericState(
        aot550=0.1, sensor_altitude_km=2.3, latitude_deg=34.139247, longitude_deg=-118.127521,
        time_utc="2018-11-08T18:42:29Z",
    ).sun  # fmt: skip
    np.testing.assert_allclose((found["solar_zenith_deg"], found["solar_azimuth_deg"]), same, atol=0.01)


def test_json_that_is_no_input_is_refused(tmp_path):
    for text, said in (
        ("{", r"input\.json:1: not JSON"), ("[]", "no list MODTRAN"), ('{"MODTRAN": []}', "no list MODTRAN"),
        ('{"MODTRAN": [3]}', "case 0: no MODTRANINPUT"),
    ):  # fmt: skip
        (tmp_path / "input.json").write_text(text)
        with pytest.raises(InputError, match=said):
            read_modtran_json(tmp_path / "input.json")
    with pytest.raises(InputError, match="wrong kind"):
        stated_fields({"GEOMETRY": {"H1ALT": "high"}}, "case")
