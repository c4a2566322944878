"""Radiance and irradiance of field spectrometers: recognised, unit read, never taken for a reflectance."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from hyperval.errors import InputError, UsageError
from hyperval.spectra import read_spectrum
from hyperval.spectra.text import power_unit_in, quantity_in
from hyperval.units import irradiance_to_internal, radiance_to_internal

WAVE = 800.0 + 100.0 * np.arange(8)  # detectors join at 1000 and 1200 nm
VNIR, SWIR1 = WAVE <= 1000, (WAVE > 1000) & (WAVE <= 1200)
TRUE = np.array([0.30, 0.28, 0.26, 0.25, 0.22, 0.21, 0.20, 0.19])  # W m-2 sr-1 nm-1
LAMP = np.linspace(0.20, 0.05, WAVE.size)
BASE = np.full(WAVE.size, 0.98)
RESPONSE = np.linspace(30000.0, 9000.0, WAVE.size)


def asd(
    *, kind: int = 2, version: bytes = b"as7", stored: np.ndarray | None = None, optic: int = 25, entries: int = 3,
    gains: tuple[int, int] = (60, 40), constituents: int = 0,
) -> bytes:  # fmt: skip
    """A file of counts that an instrument of the stated settings would have stored for TRUE."""
    if stored is None:
        irradiance = np.pi * TRUE / BASE if optic < 180 else TRUE
        counts = irradiance / LAMP * RESPONSE
        # Twice the time: twice the counts.  Twice the gain number: half the counts.
        stored = counts * np.where(VNIR, 68 / 136, np.where(SWIR1, 30 / gains[0], 20 / gains[1]))
    head = bytearray(484)
    head[:3] = version
    head[186], head[199] = kind, 2
    struct.pack_into("<2f", head, 191, 800.0, 100.0)
    struct.pack_into("<H", head, 204, WAVE.size)
    struct.pack_into("<L", head, 390, 68)
    struct.pack_into("<h", head, 394, optic)
    struct.pack_into("<2H", head, 436, *gains)
    struct.pack_into("<2f", head, 444, 1000.0, 1200.0)
    body = bytes(head) + stored.astype("<f8").tobytes()
    body += struct.pack("<H", 0) + b"\0" * 16 + struct.pack("<H", 0) + np.ones(WAVE.size).tobytes()
    body += b"\0\0" + b"\0\0" * 20 + struct.pack("<hhhhhh", constituents, 0, 0, 0, 0, 0)
    listed = [(1, 0, 0, 0, BASE), (2, 0, 0, 0, LAMP), (3, 136, 30, 20, RESPONSE)][:entries]
    body += struct.pack("<b", len(listed))
    body += b"".join(struct.pack("<b20sihh", k, b"name", it, a, b) for k, it, a, b, _ in listed)
    return body + b"".join(v.astype("<f8").tobytes() for *_, v in listed)


def read(tmp_path: Path, raw: bytes | str, name: str, **options):
    path = tmp_path / name
    if isinstance(raw, str):
        path.write_text(raw)
    else:
        path.write_bytes(raw)
    return read_spectrum(path, **options)


def test_counts_are_calibrated_by_what_the_file_carries(tmp_path):
    found = read(tmp_path, asd(), "a.asd", quantity="radiance")
    assert np.allclose(found.values, 100.0 * TRUE, rtol=1e-12)  # 1 W m-2 is 100 uW cm-2
    assert found.quantity == "radiance"
    assert any("calibration in the file" in note for note in found.notes)


def test_a_cosine_receptor_sees_irradiance(tmp_path):
    raw = asd(optic=180, kind=4)
    assert np.allclose(read(tmp_path, raw, "a.asd", quantity="irradiance").values, 100.0 * TRUE, rtol=1e-12)
    with pytest.raises(InputError, match="holds irradiance, not radiance"):
        read(tmp_path, raw, "a.asd", quantity="radiance")


@pytest.mark.parametrize("version", [b"as3", b"as7"])
def test_stored_radiance_is_taken_as_it_stands(tmp_path, version):
    raw = asd(version=version, stored=TRUE)
    found = read(tmp_path, raw, "a.asd", quantity="radiance")
    assert np.allclose(found.values, 100.0 * TRUE)
    assert np.allclose(read(tmp_path, raw, "a.asd", quantity="radiance", unit="W m-2 sr-1 nm-1").values, 100 * TRUE)
    with pytest.raises(UsageError, match="states radiance in W m-2 sr-1 nm-1, the caller in uW cm-2 sr-1 nm-1"):
        read(tmp_path, raw, "a.asd", quantity="radiance", unit="uW cm-2 sr-1 nm-1")


@pytest.mark.parametrize(("kind", "what"), [(2, "radiance"), (4, "irradiance")])
def test_neither_is_a_reflectance(tmp_path, kind, what):
    with pytest.raises(InputError, match=rf"a\.asd: the file holds {what}, not reflectance\n.*white panel"):
        read(tmp_path, asd(kind=kind), "a.asd")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"version": b"as6"}, "holds counts up to .*and no calibration"),
        ({"entries": 2}, "holds counts, and no calibration"),
        ({"constituents": 1}, "calibration in the file is not understood"),
        ({"gains": (0, 40), "stored": 1000.0 * np.ones(8)}, "settings of the calibration that are 0"),
        ({"stored": np.array([1e4, 1e4, 1e4, 1e4, 1e4, 4e4, 4e4, 4e4])}, r"steps by \d+ % at 1200 nm"),
    ],
)
def test_counts_that_cannot_be_calibrated(tmp_path, options, message):
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, asd(**options), "a.asd", quantity="radiance")
    assert "export the calibrated spectrum as text" in str(caught.value)


def test_a_calibration_that_is_cut_short(tmp_path):
    with pytest.raises(InputError, match=r"not understood \(cut short\)"):
        read(tmp_path, asd()[:-8], "a.asd", quantity="radiance")


SVC = "/*** Spectra Vista SIG Data ***/\nname= a\nunits= Radiance, {}\ndata= \n"
ROWS = "400 30000 15000 {0}\n500 40000 10000 {0}\n600 50000 5000 {0}\n"


def test_svc_target_in_the_makers_unit(tmp_path):
    text = SVC.format("Radiance") + ROWS.format("50")
    found = read(tmp_path, text, "a.sig", quantity="radiance")
    # 15000e-10 W cm-2 sr-1 nm-1 = 1.5 uW cm-2 sr-1 nm-1.
    assert np.allclose(found.values, [1.5, 1.0, 0.5])
    assert any("maker's unit" in note for note in found.notes)
    assert np.allclose(read(tmp_path, text, "a.sig").values, 0.5)
    single = SVC.format("Radiance") + ROWS.format("0")
    with pytest.raises(InputError, match="no reflectance: a single scan of radiance"):
        read(tmp_path, single, "a.sig")


def test_svc_irradiance_and_counts(tmp_path):
    text = SVC.format("Irradiance") + ROWS.format("0")
    assert np.allclose(read(tmp_path, text, "a.sig", quantity="irradiance").values, [1.5, 1.0, 0.5])
    with pytest.raises(InputError, match="holds irradiance, not radiance"):
        read(tmp_path, text, "a.sig", quantity="radiance")
    with pytest.raises(InputError, match="target is in counts, not in radiance"):
        read(tmp_path, SVC.format("Counts") + ROWS.format("0"), "a.sig", quantity="radiance")


def test_spectral_evolution_radiance_has_its_unit_in_the_header(tmp_path):
    text = (
        "Comment:\nInstrument: PSR\nMeasurement: RADIANCE\nUnits: W/m^2/sr/nm\nColumns [2]:\nData:\n"
        "Wvl\tRad. (Target)\n400\t0.1\n500\t0.2\n"
    )
    assert np.allclose(read(tmp_path, text, "a.sed", quantity="radiance").values, [10.0, 20.0])
    with pytest.raises(UsageError, match="unit of the radiance is not stated"):
        read(tmp_path, text.replace("W/m^2/sr/nm", "None"), "a.sed", quantity="radiance")
    with pytest.raises(InputError, match="no reflectance column"):
        read(tmp_path, text, "a.sed")


def test_text_with_a_title_of_radiance(tmp_path):
    text = "Wavelength (nm)\tRadiance(W/sr/m2/nm)\n400\t0.1\n500\t0.2\n"
    assert np.allclose(read(tmp_path, text, "a.txt", quantity="radiance").values, [10.0, 20.0])
    with pytest.raises(InputError, match="holds radiance, not reflectance"):
        read(tmp_path, text, "a.txt")


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("W/m^2/sr/nm", "W m-2 sr-1 nm-1"), ("mW/m2/sr/nm", "mW m-2 sr-1 nm-1"),
        ("µW/cm²/nm/sr", "uW cm-2 sr-1 nm-1"),
        ("Radiance [uW cm-2 sr-1 um-1]", "uW cm-2 sr-1 um-1"), ("W/m^2/nm", "W m-2 nm-1"), ("None", None),
        ("DN", None), ("wavelength (nm)", None),
    ],
)  # fmt: skip
def test_units_in_words(text, unit):
    assert power_unit_in(text) == unit
    if unit is not None:  # known to the conversions, and by the dimensions that it names
        factor = (radiance_to_internal if "sr" in unit else irradiance_to_internal)(unit)
        watt = {"W": 1e6, "mW": 1e3, "uW": 1.0}[unit.split()[0]]
        assert factor == pytest.approx(watt * (1e-4 if " m-2" in unit else 1) * (1e-3 if "um-1" in unit else 1))


def test_quantities_in_titles():
    assert [quantity_in(t) for t in ("Radiance", "spectral irradiance", "Reflectance", "")] == [
        "radiance", "irradiance", "reflectance", None,
    ]  # fmt: skip


@pytest.mark.data
def test_real_files(data_dir):
    # The detectors of this file do not join under its own calibration (0.095 to 0.248 at 1800 nm): refused.
    with pytest.raises(InputError, match="steps by 161 % at 1800 nm"):
        read_spectrum(data_dir("spectra/asd/v7sample00000.asd"), quantity="radiance")
    path = data_dir("spectra/svc_sig/gr070214_003.sig")
    radiance = read_spectrum(path, quantity="radiance")
    assert 0.1 < np.max(radiance.values) < 10.0
    reflectance = read_spectrum(path)
    assert np.array_equal(radiance.wavelength_nm, reflectance.wavelength_nm)


@pytest.mark.data
def test_counts_calibrated_as_another_reader_calibrates_them(data_dir, monkeypatch):
    """Radiance of a version 7 file by pyASDReader 1.2.3 [W m-2 sr-1 nm-1]; it steps at 1800 nm there too."""
    monkeypatch.setattr("hyperval.spectra.binary.MAX_STEP", np.inf)
    found = read_spectrum(data_dir("spectra/asd/v7sample00000.asd"), quantity="radiance")
    at = np.searchsorted(found.wavelength_nm, [450, 1050, 1799, 1801, 1850])
    want = [0.008198067382416185, 0.2938367126044839, 0.09511210086517422, 0.24821675621412348, 0.1777754349768502]
    assert np.allclose(found.values[at], 100.0 * np.array(want), rtol=1e-12)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "want"),
    [
        ("ribb00001", [0.979131, 0.963540, -0.512200]),
        ("soil", [0.147966, 0.478984, 0.502737]),
        ("v6sample00000", [0.818046, 0.889339, 0.793535]),
        ("v8sample00001", [0.871210, 0.892763, 0.774959]),
    ],
)
def test_white_reference_as_another_reader_finds_it(data_dir, name, want):
    """Stored spectrum over stored white reference, both by pyASDReader 1.2.3, at 450, 1050 and 1850 nm."""
    found = read_spectrum(data_dir(f"spectra/asd/{name}.asd"))
    at = np.searchsorted(found.wavelength_nm, [450, 1050, 1850])
    assert np.allclose(found.values[at], want, rtol=0, atol=5e-7)
