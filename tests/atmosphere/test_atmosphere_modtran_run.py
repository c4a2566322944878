"""Running the user's MODTRAN: a stand-in executable that replays output, and every way it can go wrong."""

from __future__ import annotations

import gzip
import os
import sys

import numpy as np
import pytest
from modtran_samples import tape7
from processes import awaited, is_at_work

from hyperval.atmosphere import (
    AtmosphericState,
    Modtran,
    atmospheric_terms,
    configured_modtran,
    modtran6_json,
    read_channels,
    run_modtran,
    terms_from_runs,
)
from hyperval.errors import EngineError, InputError

STATE = {
    "engine": "modtran", "model": "midlatitude-summer", "water_vapour_g_cm2": 1.25, "ozone_atm_cm": 0.3,
    "aot550": 0.05, "ground_altitude_km": 0.401945, "sensor_altitude_km": 2.300449, "latitude_deg": 34.4533,
    "longitude_deg": -118.5969, "time_utc": "2018-09-11T18:57:00Z",
}  # fmt: skip


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


def replay(source, name):
    return f"open({name!r}, 'w').write(open({str(source)!r}).read())"


def test_without_a_modtran_the_message_says_how_to_configure_one(tmp_path, monkeypatch):
    monkeypatch.delenv("HYPERVAL_MODTRAN", raising=False)
    with pytest.raises(EngineError, match="no MODTRAN is configured") as caught:
        atmospheric_terms(AtmosphericState(**STATE), cache_dir=tmp_path)
    assert "set HYPERVAL_MODTRAN to your MODTRAN executable" in str(caught.value)
    assert "engine: sixs" in str(caught.value)
    monkeypatch.setenv("HYPERVAL_MODTRAN", str(tmp_path / "absent"))
    with pytest.raises(EngineError, match="not an executable file"):
        configured_modtran()


def test_version_and_data_folder_are_checked(stand_in, tmp_path, monkeypatch):
    path = stand_in("", version=7)
    with pytest.raises(EngineError, match="HYPERVAL_MODTRAN_VERSION=7"):
        configured_modtran()
    monkeypatch.setenv("HYPERVAL_MODTRAN_VERSION", "5")
    assert configured_modtran() == Modtran(path.resolve(), 5, None)
    monkeypatch.setenv("HYPERVAL_MODTRAN_DATA", str(tmp_path / "no"))
    with pytest.raises(EngineError, match="not a folder"):
        configured_modtran()
    (path.parent / "DATA").mkdir()
    monkeypatch.delenv("HYPERVAL_MODTRAN_DATA")
    assert configured_modtran().data == (path.parent / "DATA").resolve()


@pytest.mark.parametrize(
    ("version", "asks", "leaves"),
    [
        (6, "cases = json.load(open(sys.argv[1]))['MODTRAN']; assert len(cases) == 3", "hyperval.tp7"),
        (5, "assert len(open('tape5').read().splitlines()) == 24 and os.path.isdir('DATA')", "tape7"),
        (4, "assert len(open('tape5').read().splitlines()) == 24", "tape7"),
    ],
)
def test_each_version_gets_its_input_and_is_read(stand_in, tmp_path, version, asks, leaves):
    (tmp_path / "sample").write_text(tape7((0.0, 0.1, 0.5)))
    path = stand_in(f"{asks}\n{replay(tmp_path / 'sample', leaves)}", version)
    (path.parent / "DATA").mkdir()
    terms = atmospheric_terms(AtmosphericState(**STATE), cache_dir=tmp_path / "cache")
    assert terms.provenance["engine"] == f"MODTRAN {version}"
    assert terms.provenance["state"]["aot550"] == 0.05
    assert np.all(terms.direct > 0.0)


def test_a_state_is_computed_once_and_nothing_is_left_behind(stand_in, tmp_path, monkeypatch):
    (tmp_path / "sample").write_text(tape7((0.0, 0.1, 0.5)))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", None)
    count = tmp_path / "count"
    stand_in(f"open({str(count)!r}, 'a').write(os.getcwd() + chr(10))\n" + replay(tmp_path / "sample", "hyperval.tp7"))
    first = atmospheric_terms(AtmosphericState(**STATE), cache_dir=tmp_path / "cache")
    again = atmospheric_terms(AtmosphericState(**STATE), cache_dir=tmp_path / "cache")
    np.testing.assert_array_equal(first.ground_irradiance, again.ground_irradiance)
    folders = count.read_text().splitlines()
    assert len(folders) == 1
    assert folders[0].startswith(str(tmp_path / "scratch"))
    assert not os.listdir(tmp_path / "scratch")
    atmospheric_terms(AtmosphericState(**{**STATE, "aot550": 0.06}), cache_dir=tmp_path / "cache")
    assert len(count.read_text().splitlines()) == 2


def test_failures_name_the_cause(stand_in, tmp_path):
    state = AtmosphericState(**STATE)
    for body, error, said in (
        ("print('licence expired'); sys.exit(3)", EngineError, "ended with code 3: licence expired"),
        ("print('all well')", EngineError, r"left none of hyperval\.tp7, hyperval\.chn: all well"),
        ("open('hyperval.tp7', 'w').write('rubbish')", InputError, "no table"),
        (replay(tmp_path / "two", "hyperval.tp7"), Exception, "3 albedos for 2 runs"),
    ):
        (tmp_path / "two").write_text(tape7((0.0, 0.1)))
        stand_in(body)
        with pytest.raises(error, match=said):
            atmospheric_terms(state, cache_dir=tmp_path / "cache")
    (tmp_path / "bin" / "modtran").write_bytes(b"not a program\0")
    with pytest.raises(EngineError, match="cannot be started"):
        atmospheric_terms(state, cache_dir=tmp_path / "cache")


def test_one_that_hangs_is_ended_with_its_children(stand_in, tmp_path):
    child = tmp_path / "child"
    # A shell, since it starts at once: what has not begun within the second has no child.
    stand_in("").write_text(f"#!/bin/sh\nsleep 60 &\necho $! > {child}\nwait\n")
    with pytest.raises(EngineError, match="longer than 1 s"):
        run_modtran(modtran6_json(AtmosphericState(**STATE)), configured_modtran(), tmp_path, timeout_s=1.0)
    assert awaited(lambda: not is_at_work(int(child.read_text())))


@pytest.mark.data
def test_replayed_real_runs_give_their_terms(stand_in, tmp_path, data_dir):
    path = data_dir("modtran/modtran6_airborne_lut/AOT550-0.0500_H2OSTR-1.2500.chn.gz")
    (tmp_path / "sample").write_bytes(gzip.decompress(path.read_bytes()))
    # It answers for the state it was computed for, and for no other.
    asked = "case = json.load(open(sys.argv[1]))['MODTRAN'][0]['MODTRANINPUT']\n"
    asked += "assert case['ATMOSPHERE']['H2OSTR'] == 1.25 and case['AEROSOLS']['VIS'] == -0.05\n"
    stand_in(asked + replay(tmp_path / "sample", "hyperval.chn"))
    terms = atmospheric_terms(AtmosphericState(**STATE), cache_dir=tmp_path / "cache")
    direct = terms_from_runs(read_channels(path), [0.0, 0.1, 0.5])
    np.testing.assert_allclose(terms.direct, direct.direct, rtol=1e-14)
    np.testing.assert_array_equal(np.isnan(terms.ground_irradiance), np.isnan(direct.ground_irradiance))
    np.testing.assert_array_equal(terms.fwhm_nm, direct.fwhm_nm)
    with pytest.raises(EngineError, match="ended with code 1"):
        atmospheric_terms(AtmosphericState(**{**STATE, "aot550": 0.2}), cache_dir=tmp_path / "cache")
