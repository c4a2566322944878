"""Decks and JSON input for MODTRAN: fixed columns, the real decks field by field, and the runs of the model."""

from __future__ import annotations

import gzip
import json
from itertools import pairwise

import numpy as np
import pytest
from modtran_cards import CARDS, card_fields

from hyperval.atmosphere import AtmosphericState, distance_on_day, modtran6_json, read_modtran_json, tape5
from hyperval.atmosphere.modtran import stated_albedo, stated_fields
from hyperval.errors import InputError, UsageError

ORDER = ("1", "1A", "2", "3", "3A1", "3A2", "4")


def state(**changes):
    fields = {
        "model": "midlatitude-summer", "water_vapour_g_cm2": 1.5, "ozone_atm_cm": 0.3, "aerosol": "rural",
        "aot550": 0.1, "ground_altitude_km": 0.35, "sensor_altitude_km": 2.3, "solar_zenith_deg": 52.44,
        "solar_azimuth_deg": 163.7, "day_of_year": 312, "view_zenith_deg": 20.0, "view_azimuth_deg": 90.0,
    }  # fmt: skip
    return AtmosphericState(**{**fields, **changes})


def parse_card(version, card, line):
    """The fields of one line; blank numbers are 0 and blank logicals False, as Fortran reads them."""
    kinds = {
        "L": lambda t: {"T": True, "F": False, "": False}[t],
        "I": lambda t: int(t or 0),
        "F": lambda t: float(t or 0),
    }
    found = {}
    for f in card_fields(version, card):
        text = line[f.start : f.start + f.width]
        if f.kind == "A":
            found[f.name] = text.rstrip() if f.width > 1 else text.strip()
        else:
            found[f.name] = kinds[f.kind](text.strip().upper())
    return found


def cards(deck, version):
    """The parsed cards of each case of a deck."""
    lines = deck.splitlines()
    found, i = [], 0
    while i < len(lines):
        case = {name: parse_card(version, name, lines[i + n]) for n, name in enumerate(ORDER)}
        i += len(ORDER)
        case["5"] = parse_card(version, "5", lines[i])
        i += 1
        found.append(case)
    return found


def test_deck_says_what_the_state_says_field_by_field():
    for version in (4, 5):
        (case,) = cards(tape5(state(), [0.1], version), version)
        assert (case["1"]["MODEL"], case["1"]["ITYPE"], case["1"]["IEMSCT"], case["1"]["IMULT"]) == (2, 2, 2, -1)
        assert float(case["1"]["SURREF"]) == 0.1
        assert (case["1A"]["DIS"], case["1A"]["NSTR"], case["1A"]["CO2MX"]) == (True, 8, 400.0)
        assert (case["1A"]["H2OSTR"], case["1A"]["O3STR"]) == ("  g1.50000", "  a0.30000")
        assert (case["2"]["IHAZE"], case["2"]["GNDALT"]) == (1, 0.35)
        assert (case["3"]["H1"], case["3"]["H2"]) == (2.3, 0.35)
        # 20 degrees at the ground is a little less at the sensor, over a round Earth.
        assert 160.0 < case["3"]["ANGLE"] < 160.02
        assert case["3A1"] == {"IPARM": 12, "IPH": 2, "IDAY": 312, "ISOURC": 0}
        assert (case["3A2"]["PARM1"], case["3A2"]["PARM2"]) == (73.7, 52.44)
        assert (case["4"]["V1"], case["4"]["V2"], case["4"]["DV"]) == (3800.0, 29500.0, 5.0)
        assert case["5"]["IRPT"] == 0


def test_aerosol_is_a_depth_for_version_5_and_a_range_for_version_4():
    (five,) = cards(tape5(state(), [0.0], 5), 5)
    (four,) = cards(tape5(state(), [0.0], 4), 4)
    assert five["2"]["VIS"] == -0.1
    # What MODTRAN 6 prints as the range of optical depth 0.1 over ground at 0.35 km: 82.72642 km.
    assert four["2"]["VIS"] == pytest.approx(82.73, rel=0.005)
    for none in (state(aerosol="none", aot550=None), state(aot550=0.0)):
        (clear,) = cards(tape5(none, [0.0], 5), 5)
        assert (clear["2"]["IHAZE"], clear["2"]["VIS"]) == (0, 0.0)


def test_what_is_left_to_the_model_is_blank():
    (case,) = cards(tape5(state(water_vapour_g_cm2=None, ozone_atm_cm=None), [0.0]), 5)
    assert case["1A"]["H2OSTR"].strip() == case["1A"]["O3STR"].strip() == ""


def test_every_run_of_the_model():
    found = cards(tape5(state()), 5)
    assert [float(c["1"]["SURREF"]) for c in found] == [0.0, 0.1, 0.5]
    assert [c["5"]["IRPT"] for c in found] == [1, 1, 0]


def test_aerosol_that_modtran_does_not_have_is_refused():
    for aerosol in ("continental", {"dust": 0.5, "soot": 0.5}):
        with pytest.raises(UsageError, match="aerosol"):
            tape5(state(aerosol=aerosol))
    for albedos in ([], [0.0, 1.2]):
        for deck in (tape5, modtran6_json):
            with pytest.raises(UsageError, match="runs over ground"):
                deck(state(), albedos)
    with pytest.raises(UsageError, match="MODTRAN 3"):
        tape5(state(), [0.0], 3)


def test_distance_alone_becomes_a_day_with_that_distance():
    (case,) = cards(tape5(state(day_of_year=None, earth_sun_distance_au=1.0), [0.0]), 5)
    assert distance_on_day(case["3A1"]["IDAY"]) == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("version", [4, 5])
def test_every_value_fits_its_columns(version):
    far = {"sensor_altitude_km": 99_999.0, "ground_altitude_km": 4.9, "aot550": 5.0, "solar_zenith_deg": 80.0}
    near = {"sensor_altitude_km": 0.4, "aot550": 0.003, "solar_azimuth_deg": 89.99, "day_of_year": 1}
    for changes in (far, near):
        lines = tape5(state(**changes), [1.0], version).splitlines()
        for name, line in zip(ORDER, lines, strict=False):
            last = card_fields(version, name)[-1]
            assert len(line) <= last.start + last.width
        (case,) = cards("\n".join(lines), version)
        assert case["3"]["H1"] == changes["sensor_altitude_km"]
        assert case["2"]["GNDALT"] == changes.get("ground_altitude_km", 0.35)


@pytest.mark.parametrize("version", [4, 5])
def test_columns_of_a_card_do_not_overlap(version):
    for card in CARDS[version]:
        fields = card_fields(version, card)
        for a, b in pairwise(fields):
            assert a.start + a.width <= b.start


REAL_DECKS = [
    ("modtran4_5/tape5.VIS", (0, 1, 2, 3, 4, 5, 6)),
    ("modtran5_decks/data_path100/tape5.gz", (0, 1, 2, 3, 4, 5, 6)),
    ("modtran5_decks/OMAA_userprofile/tape5.tp5", (0, 1, 2, 36, 37, 38, 39)),
    ("wagl_modtran5_6/TL_alb_0.tp5", (0, 1, 3, 4, 5, 6, 7)),
    ("wagl_modtran5_6/TL_alb_t.tp5", (0, 1, 3, 4, 5, 6, 7)),
]


@pytest.mark.data
@pytest.mark.parametrize(("relative", "at"), REAL_DECKS)
def test_real_decks_fit_the_same_columns(data_dir, relative, at):
    path = data_dir(f"modtran/{relative}")
    raw = path.read_bytes()
    lines = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode().splitlines()
    for name, number in zip(ORDER, at, strict=True):
        line = lines[number]
        parse_card(5, name, line)  # numbers are numbers, logicals T or F
        last = card_fields(5, name)[-1]
        assert not line[last.start + last.width :].strip()  # nothing beyond our last column
        for field in card_fields(5, name):
            # A field cut in the wrong place would hold the ends of two numbers.
            text = line[field.start : field.start + field.width]
            if field.kind in "IF" and text.strip():
                assert " " not in text.strip()


@pytest.mark.data
def test_values_of_real_decks(data_dir):
    lines = data_dir("modtran/wagl_modtran5_6/TL_alb_0.tp5").read_text().splitlines()
    first, second = parse_card(5, "1", lines[0]), parse_card(5, "1A", lines[1])
    assert (first["MODTRN"], first["SPEED"], first["MODEL"], first["TPTEMP"]) == ("T", "M", 2, 10.0)
    assert float(first["SURREF"]) == 0.0
    assert (second["NSTR"], second["CO2MX"], second["LFLTNM"]) == (8, 375.0, True)
    assert (second["H2OSTR"], second["O3STR"]) == ("  g1.07000", "    a0.285")
    assert (second["CDASTM"], second["ASTMC"], second["ASTMO"]) == ("t", 0.3, 0.7)
    aerosol, path = parse_card(5, "2", lines[3]), parse_card(5, "3", lines[4])
    assert (aerosol["IHAZE"], aerosol["VIS"], aerosol["GNDALT"]) == (1, -0.023, 0.709)
    assert (path["H1"], path["H2"], path["ANGLE"]) == (705.0, 0.709, 171.001)
    spectral = parse_card(5, "4", lines[7])
    assert (spectral["V1"], spectral["FWHM"], spectral["YFLAG"], spectral["XFLAG"]) == (350.0, 1.0, "R", "N")
    deck = data_dir("modtran/modtran5_decks/OMAA_userprofile/tape5.tp5").read_text().splitlines()
    assert parse_card(5, "1", deck[0])["SURREF"].strip() == "-4"
    assert parse_card(5, "3A1", deck[37])["IDAY"] == 195


def test_json_input_states_the_state(tmp_path):
    text = modtran6_json(state(view_zenith_deg=0.0), name="NAME")
    (tmp_path / "input.json").write_text(text)
    cases = read_modtran_json(tmp_path / "input.json")
    assert [c["NAME"] for c in cases] == ["NAME"] * 3
    assert [c["CASE"] for c in cases] == [0, 1, 2]
    assert [stated_albedo(c) for c in cases] == [0.0, 0.1, 0.5]
    found = stated_fields(cases[0], "input.json")
    given = state(view_zenith_deg=0.0).model_dump()
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
            mine, theirs = ours[section][name], template[section][name]
            assert isinstance(mine, str) == isinstance(theirs, str), name
    for name in ("MODTRN", "IEMSCT", "IMULT", "NSTR"):
        assert ours["RTOPTIONS"][name] == template["RTOPTIONS"][name]
    assert ours["ATMOSPHERE"]["MODEL"] == template["ATMOSPHERE"]["MODEL"]
    assert len(ours["SPECTRAL"]["FLAGS"]) == len(template["SPECTRAL"]["FLAGS"]) == 7


@pytest.mark.data
def test_fields_of_real_json_input(data_dir):
    lawn = read_modtran_json(data_dir("pasadena/lut_multi/LUT_AOT550-0.1000_H2OSTR-1.5000.json"))
    assert [stated_albedo(c) for c in lawn] == [0.0, 0.1, 0.5]
    found = stated_fields(lawn[0], "lawn")
    assert (found["aot550"], found["water_vapour_g_cm2"], found["sensor_altitude_km"]) == (0.1, 1.5, 2.3)
    # The run's own tp6 prints a solar zenith angle of 52.5 degrees for it.
    assert found["solar_zenith_deg"] == pytest.approx(52.5, abs=0.15)
    wagl = stated_fields(read_modtran_json(data_dir("modtran/wagl_modtran5_6/TL_alb_0.json"))[0], "wagl")
    assert wagl["aot550"] == pytest.approx(0.032)
    thermal = read_modtran_json(data_dir("modtran/wagl_modtran5_6/thermal_channel.json"))
    assert "solar_zenith_deg" not in stated_fields(thermal[0], "thermal")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", r"input\.json:1: not JSON"),
        ("[]", "no list MODTRAN"),
        ('{"MODTRAN": []}', "no list MODTRAN"),
        ('{"MODTRAN": [3]}', "case 0: no MODTRANINPUT"),
    ],
)
def test_json_that_is_no_input_is_refused(tmp_path, text, said):
    (tmp_path / "input.json").write_text(text)
    with pytest.raises(InputError, match=said):
        read_modtran_json(tmp_path / "input.json")
    with pytest.raises(InputError, match="wrong kind"):
        stated_fields({"GEOMETRY": {"H1ALT": "high"}}, "case")
    with pytest.raises(InputError, match="no such file"):
        read_modtran_json(tmp_path / "absent.json")


def test_sun_by_place_and_time_counts_longitude_to_the_west():
    geometry = {"IPARM": 11, "PARM1": 34.139247, "PARM2": 118.127521, "IDAY": 312, "GMTIME": 18.708}
    found = stated_fields({"GEOMETRY": geometry}, "case")
    same = AtmosphericState(
        aot550=0.1, sensor_altitude_km=2.3, latitude_deg=34.139247, longitude_deg=-118.127521,
        time_utc="2018-11-08T18:42:29Z",
    ).sun  # fmt: skip
    np.testing.assert_allclose((found["solar_zenith_deg"], found["solar_azimuth_deg"]), same, atol=0.01)
