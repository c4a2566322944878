"""Files of field spectrometers: detectors joined, counts over the white reference or calibrated, damage refused."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from spectra_shells import SED, SVC, asd, read, rows

from hyperval.errors import InputError, UsageError
from hyperval.spectra import read_spectrum

WAVE = np.array([400.0, 500.0, 600.0, 700.0])
RHO = np.array([0.05, 0.1, 0.2, 0.4])
GER = "///GER SIGNATUR FILE///\nname= lawn\ninstrument= 3700: 1234\naveraging= 1, 1\ncomm= \ndata= \n"


def test_svc_joins_three_detectors_and_converts_percent(tmp_path):
    wave = np.array([400, 700, 900, 1000, 1010, 970, 985, 995, 1500, 1900, 1890, 1895, 2500.0])
    rho = np.linspace(0.1, 0.7, wave.size)
    body = rows(wave, wave * 0 + 9, rho * 9, rho * 100, sep="  ", end="\r\n")
    for head in (SVC, SVC.replace("comm=", "\r\ncomm=")):  # an empty line in it is none
        found = read(tmp_path, head + body, "a.sig")
        keep = [0, 1, 2, 7, 8, 12]  # joined at (1010 + 970) / 2 = 990 and (1900 + 1890) / 2 = 1895
        assert found.wavelength_nm.tolist() == wave[keep].tolist()
        assert np.allclose(found.values, rho[keep], rtol=1e-4)
        assert found.name == "plank_1"
        assert any("990.0, 1895.0" in note for note in found.notes)


@pytest.mark.parametrize("percent", [True, False])
def test_ger_is_percent_or_target_over_reference(tmp_path, percent):
    columns = [WAVE, 5000 * RHO, [5000.0] * 4] + ([100 * RHO] if percent else [])
    found = read(tmp_path, GER + rows(*columns, sep="  "), "gr070601.001")
    assert found.name == "lawn"
    np.testing.assert_allclose(found.values, RHO)


@pytest.mark.parametrize(("title", "factor"), [("Reflect. %", 100), ("Reflect. [1.0]", 1)])
def test_spectral_evolution_is_as_long_as_it_says(tmp_path, title, factor):
    head = SED.format(title).replace("Columns", "Wavelength Range: 400,700\r\nChannels: 4\r\nColumns")
    table = zip(WAVE, factor * RHO, strict=True)
    body = "".join(f"{w:6.1f}\t{w:E}\t{w:E}\t{r:.5f}\r\n" for w, r in table)
    assert np.allclose(read(tmp_path, head + body, "a.sed").values, RHO)
    assert np.allclose(read(tmp_path, head + body[:-2], "a.sed").values, RHO)  # only the end of the line
    for text, message in (
        (head + body[: body.rindex("\r\n", 0, -2) + 2], "3 rows\n  expected: 4, as it states"),
        (head.replace("Channels: 4", "Channels: x4") + body, "4 rows\n  expected: x4"),
        (head.replace("[4]", "[5]") + body, "4 columns under 4 titles\n  expected: 5 of both"),
        (head + body[:-4], "the last line is cut: '700.0 7.0"),
        (head + body.replace("700.0", "600.5"), "wavelengths from 400 to 600.5\n  expected: 400 to 700"),
    ):
        with pytest.raises(InputError, match=message):
            read(tmp_path, text, "a.sed")


POWER = (
    "Comment:\nInstrument: PSR\nMeasurement: RADIANCE\nUnits: W/m^2/sr/nm\nColumns [2]:\nData:\nWvl\tRad. (Target)\n"
)
TARGETS = "400 30000 15000 {0}\n500 40000 10000 {0}\n600 50000 5000 {0}\n"


def test_radiance_of_the_target(tmp_path):
    # 15000e-10 W cm-2 sr-1 nm-1 = 1.5 uW cm-2 sr-1 nm-1, the unit that the maker says.
    text = SVC + TARGETS.format("50")
    found = read(tmp_path, text, "a.sig", quantity="radiance")
    assert np.allclose(found.values, [1.5, 1.0, 0.5])
    assert any("maker's unit" in note for note in found.notes)
    assert np.allclose(read(tmp_path, text, "a.sig").values, 0.5)
    text = SVC.replace(", Radiance", ", Irradiance") + TARGETS.format("0")
    assert np.allclose(read(tmp_path, text, "a.sig", quantity="irradiance").values, [1.5, 1.0, 0.5])
    found = read(tmp_path, POWER + "400\t0.1\n500\t0.2\n", "a.sed", quantity="radiance")
    assert np.allclose(found.values, [10.0, 20.0])
    with pytest.raises(UsageError, match="unit of the radiance is not stated"):
        read(tmp_path, POWER.replace("W/m^2/sr/nm", "None") + "400\t0.1\n500\t0.2\n", "a.sed", quantity="radiance")


@pytest.mark.parametrize(
    ("name", "text", "quantity", "message"),
    [
        ("a.sig", SVC.replace("data= \r\n", ""), "reflectance", "no 'data=' line"),
        ("a.sig", SVC + "400 1 2\n500 1 2\n", "reflectance", "3 columns"),
        ("a.sig", SVC + "400 1 2 3\n500 1 2\n", "reflectance", ":8: 3 columns"),
        ("a.sig", SVC + "400 1 2 3\nx 1 2 3\n", "reflectance", ":8: not a row of numbers"),
        ("a.sig", SVC, "reflectance", "holds no numbers"),
        ("a.sig", SVC.replace("comm=", "comm") + rows(WAVE, RHO, RHO, RHO), "reflectance", ":5: not of the form"),
        ("a.sig", SVC + "400 1 1 1\n300 1 1 1\n350 1 1 1\n", "reflectance", "no detectors overlap"),
        ("a.sig", SVC + "".join(f"{w}00 1 1 1\n" for w in (4, 3, 5, 4, 6, 5, 7, 6, 8, 7, 9)), "reflectance", "back 5"),
        ("a.sig", SVC + TARGETS.format("0"), "reflectance", "no reflectance: a single scan of radiance"),
        ("a.sig", SVC.replace(", Rad", ", Irrad") + TARGETS.format("0"), "radiance", "holds irradiance, not radiance"),
        ("a.sig", SVC.replace(", Radiance", ", Counts") + TARGETS.format("0"), "radiance", "target is in counts"),
        ("a.sig", GER + rows(WAVE, RHO, RHO, sep=" "), "radiance", "(?s)radiance in a GER file.*state its unit"),
        ("a.sed", SED.format("Rad. (Target)") + rows(WAVE, WAVE, WAVE, RHO), "reflectance", "no reflectance column"),
        ("a.sed", SED.format("Reflect.") + rows(WAVE, WAVE, WAVE, RHO), "reflectance", "unit of 'Reflect.'"),
        ("a.sed", SED.format("Reflect. %") + rows(WAVE, WAVE, RHO), "reflectance", "3 columns under 4 titles"),
        ("a.sed", SED.split("Data:")[0], "reflectance", "no 'Data:' line"),
    ],
)
def test_signature_files_that_are_damaged_or_hold_something_else(tmp_path, name, text, quantity, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, text, name, quantity=quantity)


@pytest.mark.parametrize("version", [b"as2", b"as5", b"as8"])
@pytest.mark.parametrize("code", [0, 1, 2])
@pytest.mark.parametrize(("kind", "words"), [(0, b""), (1, b"white panel")])
def test_asd_is_spectrum_over_reference(tmp_path, version, code, kind, words):
    found = read(tmp_path, asd(kind=kind, code=code, words=words, version=version), "a.asd")
    assert found.wavelength_nm.tolist() == WAVE.tolist()
    assert np.allclose(found.values, RHO, rtol=1e-6)


def test_asd_version_1_stores_the_reflectance_itself(tmp_path):
    raw = asd(RHO, version=b"ASD")[: 484 + RHO.nbytes]
    assert read(tmp_path, raw, "a.asd").values.tolist() == RHO.tolist()


WHITE = 1000.0 * np.sin(np.linspace(0.1, 3.0, 400))


def long_asd(which: int = 0, channels: slice = slice(0), value: float = 0.0, first: float = 400.0) -> bytes:
    """A file of 400 channels of 5 nm, some of whose spectrum (0) or reference (1) are changed."""
    spectra = [0.5 * WHITE, WHITE.copy()]
    spectra[which][channels] = value
    return asd(*spectra, first=first, step=5.0)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (asd(kind=2), "holds radiance, not reflectance\n.*white panel"), (asd(kind=4), "holds irradiance"),
        (asd(reference=False), "no white reference"), (asd()[:560], "cut short"), (asd()[:500], "cut short"),
        (asd(settings=(("<B", 199, (9,)),)), "header is not valid"),
        (asd(settings=(("<H", 204, (65535,)),)), "header is not valid"),
        (asd(kind=0, version=b"ASD"), "without a white reference"),
        (long_asd(0, slice(200, 240)), "channel 201 holds 0, as do the 7 after it"),
        (long_asd(1, slice(200, 201)), "channel 201 holds 0\n"), (long_asd(0, slice(392, 400)), "channel 393 holds 0"),
        (long_asd(0, slice(7, 8), np.nan), "channel 8 holds nan"),
        (long_asd(1, slice(50, 51), 1e300), r"channel 51 holds 1e\+300"),
        (long_asd(0, slice(50, 51), 1e-9), "channel 51 holds 1e-09"),
        (long_asd(1, slice(50, 51), -700.0), "channel 51 holds -700"),
        (long_asd(first=800.0), "wavelengths from 800 to 2795 nm"), (long_asd(first=4.0), "from 4 to 1999 nm"),
    ],
)  # fmt: skip
def test_asd_files_that_are_damaged_or_hold_something_else(tmp_path, raw, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, raw, "a.asd")


def test_noise_about_zero_and_a_step_between_detectors_are_no_damage_of_an_asd_file(tmp_path):
    spectra = [0.5 * WHITE, WHITE.copy()]
    for values, noise in zip(spectra, np.random.default_rng(3).standard_normal((2, 50)), strict=True):
        values[100:] *= 0.02  # the next detector has another gain
        values[250:300] = 0.01 * values.max() * noise  # water vapour takes the light
    found = read(tmp_path, asd(*spectra, step=5.0), "a.asd")
    assert np.array_equal(found.values, spectra[0] / spectra[1])
    assert found.values.min() < 0.0


NM = 800.0 + 100.0 * np.arange(8)  # detectors join at 1000 and 1200 nm
VNIR, SWIR1 = NM <= 1000, (NM > 1000) & (NM <= 1200)
TRUE = np.array([0.30, 0.28, 0.26, 0.25, 0.22, 0.21, 0.20, 0.19])  # W m-2 sr-1 nm-1
LAMP, BASE, RESPONSE = np.linspace(0.20, 0.05, 8), np.full(8, 0.98), np.linspace(30000.0, 9000.0, 8)


def counts(*, kind=2, version=b"as7", stored=None, optic=25, entries=3, gains=(60, 40), constituents=0) -> bytes:
    """A file of counts that an instrument of the stated settings would have stored for TRUE."""
    if stored is None:
        irradiance = np.pi * TRUE / BASE if optic < 180 else TRUE
        # Twice the time: twice the counts.  Twice the gain number: half the counts.
        setting = np.where(VNIR, 68 / 136, np.where(SWIR1, 30 / gains[0], 20 / gains[1]))
        stored = irradiance / LAMP * RESPONSE * setting
    listed = [(1, 0, 0, 0, BASE), (2, 0, 0, 0, LAMP), (3, 136, 30, 20, RESPONSE)][:entries]
    behind = b"\0\0" * 21 + struct.pack("<hhhhhh", constituents, 0, 0, 0, 0, 0) + struct.pack("<b", len(listed))
    behind += b"".join(struct.pack("<b20sihh", k, b"name", it, a, b) for k, it, a, b, _ in listed)
    settings = (("<L", 390, (68,)), ("<h", 394, (optic,)), ("<2H", 436, gains), ("<2f", 444, (1000.0, 1200.0)))
    behind += b"".join(v.astype("<f8").tobytes() for *_, v in listed)
    return asd(
        stored, np.ones(8), kind=kind, version=version, reference=False, first=800.0, settings=settings, behind=behind
    )


@pytest.mark.parametrize(
    ("raw", "quantity", "note"),
    [
        (counts(), "radiance", "calibration in the file"), (counts(stored=TRUE), "radiance", ""),
        (counts(stored=TRUE, version=b"as3"), "radiance", ""),
        (counts(optic=180, kind=4), "irradiance", "calibration in the file"),
    ],
)  # fmt: skip
def test_radiance_and_irradiance_as_stored_or_by_the_calibration_in_the_file(tmp_path, raw, quantity, note):
    found = read(tmp_path, raw, "a.asd", quantity=quantity)
    assert np.allclose(found.values, 100.0 * TRUE, rtol=1e-12)  # 1 W m-2 is 100 uW cm-2
    assert found.quantity == quantity
    assert note in " ".join(found.notes)
    with pytest.raises(UsageError, match=f"states {quantity} in W m-2"):
        read(
            tmp_path,
            raw,
            "a.asd",
            quantity=quantity,
            unit="uW cm-2 " + ("sr-1 " if quantity[0] == "r" else "") + "nm-1",
        )


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (counts(version=b"as6"), "holds counts up to .*and no calibration"),
        (counts(entries=2), "holds counts, and no calibration"),
        (counts(constituents=1), "calibration in the file is not understood"),
        (counts()[:-8], r"not understood \(cut short\)"),
        (counts(gains=(0, 40), stored=1000.0 * np.ones(8)), "settings of the calibration that are 0"),
        (counts(stored=np.array([1e4, 1e4, 1e4, 1e4, 1e4, 4e4, 4e4, 4e4])), r"steps by \d+ % at 1200 nm"),
    ],
)
def test_counts_that_cannot_be_calibrated(tmp_path, raw, message):
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, raw, "a.asd", quantity="radiance")
    assert "export the calibrated spectrum as text" in str(caught.value)


@pytest.mark.data
def test_counts_calibrated_as_another_reader_calibrates_them(data_dir, monkeypatch):
    """Radiance of a version 7 file by pyASDReader 1.2.3 [W m-2 sr-1 nm-1]; it steps at 1800 nm there too."""
    path = data_dir("spectra/asd/v7sample00000.asd")
    with pytest.raises(InputError, match="steps by 161 % at 1800 nm"):
        read_spectrum(path, quantity="radiance")
    monkeypatch.setattr("hyperval.spectra.binary.MAX_STEP", np.inf)
    found = read_spectrum(path, quantity="radiance")
    at = np.searchsorted(found.wavelength_nm, [450, 1050, 1799, 1801, 1850])
    want = [0.008198067382416185, 0.2938367126044839, 0.09511210086517422, 0.24821675621412348, 0.1777754349768502]
    assert np.allclose(found.values[at], 100.0 * np.array(want), rtol=1e-12)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "want"),
    [
        ("ribb00001", [0.979131, 0.963540, -0.512200]), ("soil", [0.147966, 0.478984, 0.502737]),
        ("v6sample00000", [0.818046, 0.889339, 0.793535]), ("v8sample00001", [0.871210, 0.892763, 0.774959]),
    ],
)  # fmt: skip
def test_white_reference_as_another_reader_finds_it(data_dir, name, want):
    """Stored spectrum over stored white reference, both by pyASDReader 1.2.3, at 450, 1050 and 1850 nm."""
    found = read_spectrum(data_dir(f"spectra/asd/{name}.asd"))
    at = np.searchsorted(found.wavelength_nm, [450, 1050, 1850])
    assert np.allclose(found.values[at], want, rtol=0, atol=5e-7)
