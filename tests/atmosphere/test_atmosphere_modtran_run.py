"""Input for MODTRAN, what the input of others states, and running the user's own: a stand-in replays output."""

import gzip
import json
import os
import sys

import numpy as np
import pytest
from modtran_samples import tape7
from processes import awaited, is_at_work
from stored_cases import CASES

from hyperval import atmosphere as air
from hyperval.atmosphere import AtmosphericState
from hyperval.errors import EngineError, HypervalError, InputError, UsageError

STATE = {
    "engine": "modtran", "model": "midlatitude-summer", "water_vapour_g_cm2": 1.25, "ozone_atm_cm": 0.3,
    "aot550": 0.05, "ground_altitude_km": 0.401945, "sensor_altitude_km": 2.300449, "latitude_deg": 34.4533,
    "longitude_deg": -118.5969, "time_utc": "2018-09-11T18:57:00Z",
}  # fmt: skip


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
    for part in CASES["cards"][number].split(", "):
        name, *places = part.replace("|", "").split()
        start, end = map(int, places[-2:] if version == 5 else places[:2])
        text = lines[number][start:end].strip()
        found[name] = float(text) if text[-1:].isdigit() and text[:1] not in "ag" else text
    return found


def deck(version=5, **changes):
    lines = air.tape5(state(**changes), [0.1], version).splitlines()
    return {name: value for number in range(8) for name, value in card(lines, number, version).items()}


@pytest.mark.parametrize("version", [4, 5])
def test_deck_says_what_the_state_says_column_by_column(version):
    found = deck(version)
    assert 160.0 < found.pop("ANGLE") < 160.02  # 20 degrees at the ground is a little less at the sensor
    # The depth for version 5; for version 4 the range that MODTRAN 6 prints of optical depth 0.1 over 0.35 km.
    assert found.pop("VIS") == (-0.1 if version == 5 else pytest.approx(82.73, rel=0.005))
    assert found == CASES["deck"]
    blank = deck(version, water_vapour_g_cm2=None, ozone_atm_cm=None, aot550=0.0)  # left to the model
    assert (blank["H2OSTR"], blank["O3STR"], blank["IHAZE"], blank["VIS"]) == ("", "", 0, 0.0)
    distance = {"day_of_year": None, "earth_sun_distance_au": 1.0}
    far = deck(version, sensor_altitude_km=99_999.0, ground_altitude_km=4.9, aot550=5.0, **distance)
    assert (far["H1"], far["GNDALT"]) == (99_999.0, 4.9)
    assert air.distance_on_day(int(far["IDAY"])) == pytest.approx(1.0, abs=2e-4)


def test_every_run_of_the_model_and_what_modtran_does_not_have():
    lines = air.tape5(state()).splitlines()
    assert [float(line[73:80]) for line in lines[::8]] == [0.0, 0.1, 0.5]
    assert [int(line) for line in lines[7::8]] == [1, 1, 0]
    for aerosol in ("continental", {"dust": 0.5, "soot": 0.5}):
        with pytest.raises(UsageError, match="aerosol"):
            air.tape5(state(aerosol=aerosol))
    for albedos in ([], [0.0, 1.2]):
        for write in (air.tape5, air.modtran6_json):
            with pytest.raises(UsageError, match="runs over ground"):
                write(state(), albedos)
    with pytest.raises(UsageError, match="MODTRAN 3"):
        air.tape5(state(), [0.0], 3)


@pytest.mark.data
@pytest.mark.parametrize(("relative", "at", "values"), CASES["real_decks"])
def test_real_decks_have_the_same_columns(data_dir, relative, at, values):
    path = data_dir(f"modtran/{relative}")
    raw = path.read_bytes()
    lines = (gzip.decompress(raw) if path.suffix == ".gz" else raw).decode().splitlines()
    found = {k: v for i in range(7) for k, v in card([lines[n] for n in at], i, 5).items()}
    assert {name: found[name] for name in values} == values
    for name, value in found.items():  # a field cut in the wrong place would hold the ends of two numbers
        assert " " not in str(value), name


def test_json_input_states_the_state(tmp_path):
    (tmp_path / "input.json").write_text(air.modtran6_json(state(view_zenith_deg=0.0), name="NAME"))
    cases = air.read_modtran_json(tmp_path / "input.json")
    assert [(c["NAME"], c["CASE"], air.stated_albedo(c)) for c in cases] == [
        ("NAME", i, a) for i, a in enumerate((0, 0.1, 0.5))
    ]
    found, given = air.stated_fields(cases[0], "input.json"), state(view_zenith_deg=0.0).model_dump()
    assert {name: found[name] for name in found} == {name: given[name] for name in found}
    assert {"model", "aerosol", "aot550", "water_vapour_g_cm2", "solar_zenith_deg", "day_of_year"} <= set(found)


@pytest.mark.data
def test_real_json_input_has_our_keys_and_kinds_and_its_fields_are_read(data_dir):
    template = air.read_modtran_json(data_dir("modtran/modtran6_airborne_lut/modtran_template.json"))[0]
    ours = json.loads(air.modtran6_json(state()))["MODTRAN"][0]["MODTRANINPUT"]
    assert set(ours) == set(template)
    for section in ("RTOPTIONS", "ATMOSPHERE", "GEOMETRY", "SPECTRAL", "FILEOPTIONS"):
        assert set(ours[section]) - {"OBSZEN"} <= set(template[section])
        for name in set(ours[section]) & set(template[section]):
            assert isinstance(ours[section][name], str) == isinstance(template[section][name], str), name
    for name in ("MODTRN", "IEMSCT", "IMULT", "NSTR"):
        assert ours["RTOPTIONS"][name] == template["RTOPTIONS"][name]
    lawn = air.read_modtran_json(data_dir("pasadena/lut_multi/LUT_AOT550-0.1000_H2OSTR-1.5000.json"))
    assert [air.stated_albedo(c) for c in lawn] == [0.0, 0.1, 0.5]
    found = air.stated_fields(lawn[0], "lawn")
    assert (found["aot550"], found["water_vapour_g_cm2"], found["sensor_altitude_km"]) == (0.1, 1.5, 2.3)
    # The run's own tp6 prints a solar zenith angle of 52.5 degrees for it.
    assert found["solar_zenith_deg"] == pytest.approx(52.5, abs=0.15)
    thermal = air.read_modtran_json(data_dir("modtran/wagl_modtran5_6/thermal_channel.json"))
    assert "solar_zenith_deg" not in air.stated_fields(thermal[0], "thermal")


def test_sun_by_place_and_time_counts_longitude_to_the_west():
    geometry = {"IPARM": 11, "PARM1": 34.139247, "PARM2": 118.127521, "IDAY": 312, "GMTIME": 18.708}
    found = air.stated_fields({"GEOMETRY": geometry}, "case")
    place = {"latitude_deg": 34.139247, "longitude_deg": -118.127521, "time_utc": "2018-11-08T18:42:29Z"}
    same = AtmosphericState(**{**STATE, **place}).sun
    np.testing.assert_allclose((found["solar_zenith_deg"], found["solar_azimuth_deg"]), same, atol=0.01)


def test_json_that_is_no_input_is_refused(tmp_path):
    for text, said in (
        ("{", r"input\.json:1: not JSON"), ("[]", "no list MODTRAN"), ('{"MODTRAN": []}', "no list MODTRAN"),
        ('{"MODTRAN": [3]}', "case 0: no MODTRANINPUT"),
    ):  # fmt: skip
        (tmp_path / "input.json").write_text(text)
        with pytest.raises(InputError, match=said):
            air.read_modtran_json(tmp_path / "input.json")
    with pytest.raises(InputError, match="wrong kind"):
        air.stated_fields({"GEOMETRY": {"H1ALT": "high"}}, "case")


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Write an executable with the given Python body and configure it."""

    def make(body, version=6):
        path = tmp_path / "bin" / "modtran"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!{sys.executable}\nimport json, os, sys, time\n{body}\n")
        path.chmod(0o755)
        monkeypatch.setenv("HYPERVAL_MODTRAN", str(path))
        monkeypatch.setenv("HYPERVAL_MODTRAN_VERSION", str(version))
        return path

    return make


@pytest.fixture
def terms(tmp_path):
    """Terms of the state by the configured MODTRAN."""
    asked = lambda changes: AtmosphericState(**{**STATE, **changes})  # noqa: E731
    return lambda **changes: air.atmospheric_terms(asked(changes), cache_dir=tmp_path / "cache")


def replay(source, name):
    return f"open({name!r}, 'w').write(open({str(source)!r}).read())"


def test_what_is_configured_is_checked_and_the_message_says_how_to(stand_in, terms, tmp_path, monkeypatch):
    monkeypatch.delenv("HYPERVAL_MODTRAN", raising=False)
    with pytest.raises(EngineError, match="no MODTRAN is configured") as caught:
        terms()
    assert "set HYPERVAL_MODTRAN to your MODTRAN executable" in str(caught.value)
    assert "engine: sixs" in str(caught.value)
    path = stand_in("", version=5)
    assert air.configured_modtran() == air.Modtran(path.resolve(), 5, None)
    (path.parent / "DATA").mkdir()
    assert air.configured_modtran().data == (path.parent / "DATA").resolve()
    for name, value, said in (
        ("_DATA", tmp_path / "no", "not a folder"), ("_VERSION", 7, "HYPERVAL_MODTRAN_VERSION=7"),
        ("", tmp_path / "absent", "not an executable file"),
    ):  # fmt: skip
        monkeypatch.setenv(f"HYPERVAL_MODTRAN{name}", str(value))
        with pytest.raises(EngineError, match=said):
            air.configured_modtran()


@pytest.mark.parametrize(
    ("version", "asks", "leaves"),
    [
        (6, "cases = json.load(open(sys.argv[1]))['MODTRAN']; assert len(cases) == 3", "hyperval.tp7"),
        (5, "assert len(open('tape5').read().splitlines()) == 24 and os.path.isdir('DATA')", "tape7"),
        (4, "assert len(open('tape5').read().splitlines()) == 24", "tape7"),
    ],
)
def test_each_version_gets_its_input_and_is_read_once_and_leaves_nothing_behind(
    stand_in, terms, tmp_path, monkeypatch, version, asks, leaves
):
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "scratch").mkdir()
    (tmp_path / "sample").write_text(tape7((0.0, 0.1, 0.5)))
    count = tmp_path / "count"
    counted = f"open({str(count)!r}, 'a').write(os.getcwd() + chr(10))"
    path = stand_in(f"{counted}\n{asks}\n{replay(tmp_path / 'sample', leaves)}", version)
    (path.parent / "DATA").mkdir()
    first, again = terms(), terms()
    np.testing.assert_array_equal(first.ground_irradiance, again.ground_irradiance)
    assert (first.provenance["engine"], first.provenance["state"]["aot550"]) == (f"MODTRAN {version}", 0.05)
    assert np.all(first.direct > 0.0)
    (folder,) = count.read_text().splitlines()
    assert folder.startswith(str(tmp_path / "scratch"))
    assert not os.listdir(tmp_path / "scratch")
    terms(aot550=0.06)
    assert len(count.read_text().splitlines()) == 2


def test_failures_name_the_cause(stand_in, terms, tmp_path):
    (tmp_path / "two").write_text(tape7((0.0, 0.1)))
    for body, said in (
        ("print('licence expired'); sys.exit(3)", "ended with code 3: licence expired"),
        ("print('all well')", r"left none of hyperval\.tp7, hyperval\.chn: all well"),
        ("open('hyperval.tp7', 'w').write('rubbish')", "no table"),
        (replay(tmp_path / "two", "hyperval.tp7"), "3 albedos for 2 runs"),
    ):
        stand_in(body)
        with pytest.raises(HypervalError, match=said):
            terms()
    (tmp_path / "bin" / "modtran").write_bytes(b"not a program\0")
    with pytest.raises(EngineError, match="cannot be started"):
        terms()


def test_one_that_hangs_is_ended_with_its_children(stand_in, tmp_path):
    child = tmp_path / "child"
    # A shell, since it starts at once: what has not begun within the second has no child.
    stand_in("").write_text(f"#!/bin/sh\nsleep 60 &\necho $! > {child}\nwait\n")
    with pytest.raises(EngineError, match="longer than 1 s"):
        air.run_modtran(air.modtran6_json(AtmosphericState(**STATE)), air.configured_modtran(), tmp_path, timeout_s=1.0)
    assert awaited(lambda: not is_at_work(int(child.read_text())))


@pytest.mark.data
def test_replayed_real_runs_give_their_terms(stand_in, terms, tmp_path, data_dir):
    path = data_dir("modtran/modtran6_airborne_lut/AOT550-0.0500_H2OSTR-1.2500.chn.gz")
    (tmp_path / "sample").write_bytes(gzip.decompress(path.read_bytes()))
    # It answers for the state it was computed for, and for no other.
    asked = "case = json.load(open(sys.argv[1]))['MODTRAN'][0]['MODTRANINPUT']\n"
    asked += "assert case['ATMOSPHERE']['H2OSTR'] == 1.25 and case['AEROSOLS']['VIS'] == -0.05\n"
    stand_in(asked + replay(tmp_path / "sample", "hyperval.chn"))
    found, direct = terms(), air.terms_from_runs(air.read_channels(path), [0.0, 0.1, 0.5])
    np.testing.assert_allclose(found.direct, direct.direct, rtol=1e-14)
    for name in ("ground_irradiance", "fwhm_nm"):
        np.testing.assert_array_equal(np.isnan(getattr(found, name)), np.isnan(getattr(direct, name)))
    with pytest.raises(EngineError, match="ended with code 1"):
        terms(aot550=0.2)
