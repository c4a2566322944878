"""Readers of spectra: formats by content, units never guessed, detectors joined, bad files refused."""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import spectral
from hypothesis import given, settings
from hypothesis import strategies as st
from spectra_shells import specpr

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.spectra import read_records, read_spectrum
from hyperval.spectra.readers_record import MAX_BYTES, reflectance_factor

WAVE = np.array([400.0, 500.0, 600.0, 700.0])
RHO = np.array([0.05, 0.1, 0.2, 0.4])


def spectrum(tmp_path: Path, text: str | bytes, name: str = "s.txt", **options):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_spectrum(path, **options)


def read_all(tmp_path: Path, text: str, name: str):
    (tmp_path / name).write_text(text)
    return read_records(tmp_path / name)


def rows(*columns, sep: str = " ", end: str = "\n") -> str:
    return "".join(sep.join(f"{v:g}" for v in row) + end for row in zip(*columns, strict=True))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("blanks", "# Wavelength in nm, reflectance\n" + rows(WAVE, RHO)),
        ("comma", "wavelength_nm,reflectance\n" + rows(WAVE, RHO, sep=",")),
        ("crlf", "wavelength [nm]\treflectance\r\n" + rows(WAVE, RHO, sep="\t", end="\r\n")),
        ("bom", "\ufeffnm, value\n" + rows(WAVE, RHO, sep=", ")),
        ("decimal comma", "Wavelength (nm);rho\n" + rows(WAVE, RHO, sep="; ").replace(".", ",")),
        ("micrometres", "wavelength (um), rho\n" + rows(WAVE / 1000, RHO, sep=",")),
        ("micro sign", "wavelength [µm], rho\n" + rows(WAVE / 1000, RHO, sep=",")),
        ("percent", "nm,reflectance [%]\n" + rows(WAVE, RHO * 100, sep=",")),
        ("hundredths of percent", "nm,refl [%*100]\n" + rows(WAVE, RHO * 10000, sep=",")),
        ("quoted numbers", '"nm","rho"\n' + "".join(f'"{w:g}","{r:g}"\n' for w, r in zip(WAVE, RHO, strict=True))),
        ("falling", "nm,rho\n" + rows(WAVE[::-1], RHO[::-1], sep=",")),
        ("blank lines", "nm,rho\n\n" + rows(WAVE, RHO, sep=",", end="\n\n")),
        ("no value", "nm,rho\n" + rows(WAVE, RHO, sep=",") + "800,NaN\n900,-1.23e34\n"),
        (
            "ecostress",
            "Name: Paint\nX Units: Wavelength (micrometers)\nY Units: Reflectance (percentage)\n"
            "First X Value: 0.7\nAdditional Information: none\n\n"
            + rows(WAVE[::-1] / 1000, RHO[::-1] * 100, sep="\t"),
        ),
    ],
)  # fmt: skip
def test_text_files_give_the_same_spectrum(tmp_path: Path, name: str, text: str):
    found = spectrum(tmp_path, text)
    assert np.allclose(found.wavelength_nm, WAVE, rtol=1e-12)
    assert np.allclose(found.values, RHO, rtol=1e-12)
    assert found.standard_deviation is None
    assert found.name == ("Paint" if name == "ecostress" else "s")


def test_mean_with_standard_deviation_and_number(tmp_path: Path):
    text = "#Wavelength in nm, Average Reflectance, Standard Deviation: N = 68, Hours: ,17.5\n" + rows(
        WAVE, RHO, RHO / 10
    )
    found = spectrum(tmp_path, text)
    assert np.allclose(found.standard_deviation, RHO / 10)
    assert found.n == 68
    percent = spectrum(tmp_path, text.replace("Average", "Average [%]"), quantity="reflectance")
    assert np.allclose(percent.standard_deviation, RHO / 1000)  # converted with its mean


def test_columns_by_name_and_number(tmp_path: Path):
    text = "temp,nm,rho,err\n" + rows(WAVE * 0 + 20, WAVE, RHO, RHO / 5, sep=",")
    by_name = spectrum(tmp_path, text, columns=("nm", "rho", "err"))
    by_number = spectrum(tmp_path, text, columns=(1, 2, 3))
    assert np.array_equal(by_name.values, RHO)
    assert np.array_equal(by_name.standard_deviation, by_number.standard_deviation)
    for columns in (("nm", "x"), (1, 9), (1,)):
        with pytest.raises(UsageError, match="column"):
            spectrum(tmp_path, text, columns=columns)


def test_records_by_name_part_number_and_mean(tmp_path: Path):
    text = "nm,red cloth,blue cloth,blue paint\n" + rows(WAVE, RHO, 2 * RHO, 3 * RHO, sep=",")
    assert np.allclose(spectrum(tmp_path, text, record="blue paint").values, 3 * RHO)
    assert np.allclose(spectrum(tmp_path, text, record="RED").values, RHO)
    assert np.allclose(spectrum(tmp_path, text, record=1).values, 2 * RHO)
    mean = spectrum(tmp_path, text, record="mean")
    assert np.allclose(mean.values, 2 * RHO)
    assert np.allclose(mean.standard_deviation, RHO)  # of rho, 2 rho, 3 rho with n - 1
    assert mean.n == 3
    assert [r.name for r in read_records(tmp_path / "s.txt")] == ["red cloth", "blue cloth", "blue paint"]
    for record, message in ((None, "3 spectra"), ("blue", "2 records match"), ("green", "no record"), (3, "0 to 2")):
        with pytest.raises(UsageError, match=message):
            spectrum(tmp_path, text, record=record)


def test_repeated_wavelength_columns_are_replicates(tmp_path: Path):
    text = rows(WAVE, RHO, WAVE, RHO * 3, sep=",")
    mean = spectrum(tmp_path, text, record="mean", wavelength_unit="nm")
    assert np.allclose(mean.values, 2 * RHO)
    assert mean.n == 2


# Units ------------------------------------------------------------------------------------------


def test_unstated_wavelength_unit_is_noted_where_plain_and_asked_for_otherwise(tmp_path: Path):
    text = rows(WAVE / 1000, RHO)
    found = spectrum(tmp_path, text)
    assert found.wavelength_nm[0] == pytest.approx(400.0)
    assert found.notes == ("the file states no wavelength unit: 0.4 to 0.7 can only be um",)
    with pytest.raises(UsageError, match=r"nm, or um \(then they are 4000 to 700000 nm\)"):
        spectrum(tmp_path, rows([4.0, 500.0, 700.0], [0.1, 0.2, 0.3]))  # neither can be true
    with pytest.raises(InputError, match=r"(?s)wavenumbers.*convert"):
        spectrum(tmp_path, "Wavenumber (cm-1),rho\n" + rows([400.0, 500.0, 700.0], [0.1, 0.2, 0.3]))
    assert spectrum(tmp_path, text, wavelength_unit="um").wavelength_nm[0] == pytest.approx(400.0)
    with pytest.raises(UsageError, match="cannot be in nm"):
        spectrum(tmp_path, text, wavelength_unit="nm")
    with pytest.raises(UsageError, match="the file states wavelengths in nm, the caller in um"):
        spectrum(tmp_path, "nm,rho\n" + rows(WAVE, RHO), wavelength_unit="um")


@pytest.mark.parametrize(("factor", "unit"), [(100, "percent"), (10000, "scaled:10000")])
def test_reflectance_that_is_no_fraction_is_refused_until_stated(tmp_path: Path, factor: float, unit: str):
    text = "nm,rho\n" + rows(WAVE, (0.4 + RHO) * factor)
    with pytest.raises(InputError, match=f"looks like {unit}"):
        spectrum(tmp_path, text)
    assert np.allclose(spectrum(tmp_path, text, reflectance_unit=unit).values, 0.4 + RHO, rtol=1e-5)


def test_stated_units_that_disagree(tmp_path: Path):
    text = "nm,rho [%]\n" + rows(WAVE, RHO * 100)
    with pytest.raises(UsageError, match="percent, the caller in fraction"):
        spectrum(tmp_path, text, reflectance_unit="fraction")


@pytest.mark.parametrize("unit", ["per mille", "scaled", "scaled:0", "scaled:-1", "scaled:nan", "scaled:x"])
def test_unknown_reflectance_units(unit: str):
    with pytest.raises(UsageError, match="scaled:10000"):
        reflectance_factor(unit)


def test_radiance_needs_its_unit_and_is_converted(tmp_path: Path):
    text = "nm,L\n" + rows(WAVE, RHO * 100)
    with pytest.raises(UsageError, match="unit of the radiance"):
        spectrum(tmp_path, text, quantity="radiance")
    found = spectrum(tmp_path, text, quantity="radiance", unit="W m-2 sr-1 um-1")
    assert np.allclose(found.values, RHO * 10)
    assert found.quantity == "radiance"


# Instruments ------------------------------------------------------------------------------------


def overlapping() -> tuple[np.ndarray, np.ndarray]:
    wave = np.array([400.0, 700.0, 900.0, 1000.0, 1010.0, 970.0, 985.0, 995.0, 1500.0, 1900.0, 1890.0, 1895.0, 2500.0])
    return wave, np.linspace(0.1, 0.7, wave.size)


SVC = (
    "/*** Spectra Vista SIG Data ***/\r\nname= plank_1.sig\r\ninstrument= HI: 1 (HR-1024i)\r\n"
    "units= Radiance, Radiance\r\ncomm= \r\ndata= \r\n"
)


def test_svc_joins_three_detectors_and_converts_percent(tmp_path: Path):
    wave, rho = overlapping()
    found = spectrum(tmp_path, SVC + rows(wave, wave * 0 + 9, rho * 9, rho * 100, sep="  ", end="\r\n"), "a.sig")
    # Joined at (1010 + 970) / 2 = 990 and (1900 + 1890) / 2 = 1895.
    keep = [0, 1, 2, 7, 8, 12]
    assert found.wavelength_nm.tolist() == wave[keep].tolist()
    assert np.allclose(found.values, rho[keep], rtol=1e-4)
    assert found.name == "plank_1"
    assert any("990.0, 1895.0" in note for note in found.notes)


def test_svc_header_with_an_empty_line(tmp_path: Path):
    wave, rho = overlapping()
    body = rows(wave, wave * 0 + 9, rho * 9, rho * 100, sep="  ", end="\r\n")
    plain, gapped = (spectrum(tmp_path, head + body, "a.sig") for head in (SVC, SVC.replace("comm=", "\r\ncomm=")))
    assert np.array_equal(plain.values, gapped.values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SVC.replace("data= \r\n", ""), "no 'data=' line"),
        (SVC + "400 1 2\n500 1 2\n", "3 columns"),
        (SVC + "400 1 2 3\n500 1 2\n", ":8: 3 columns"),
        (SVC + "400 1 2 3\nx 1 2 3\n", ":8: not a row of numbers"),
        (SVC, "holds no numbers"),
        (SVC.replace("comm=", "comm") + rows(WAVE, RHO, RHO, RHO), ":5: not of the form"),
        (SVC + "400 1 1 1\n300 1 1 1\n350 1 1 1\n", "no detectors overlap"),
        (SVC + "".join(f"{w}00 1 1 1\n" for w in (4, 3, 5, 4, 6, 5, 7, 6, 8, 7, 9)), "jump back 5"),
    ],
)  # fmt: skip
def test_bad_svc_files(tmp_path: Path, text: str, message: str):
    with pytest.raises(InputError, match=message):
        spectrum(tmp_path, text, "a.sig")


SED = (
    "Comment:\r\nVersion: 2.0\r\nInstrument: PSR-3500\r\nMeasurement: REFLECTANCE\r\nColumns [4]:\r\nData:\r\n"
    "Wvl\tNorm. DN (Ref.)\tNorm. DN (Target)\t{}\r\n"
)


@pytest.mark.parametrize(("title", "factor"), [("Reflect. %", 100), ("Reflect. [1.0]", 1)])
def test_spectral_evolution(tmp_path: Path, title: str, factor: float):
    text = SED.format(title) + rows(WAVE, WAVE, WAVE, RHO * factor, sep="\t", end="\r\n")
    assert np.allclose(spectrum(tmp_path, text, "a.sed").values, RHO)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (SED.format("Rad. (Target)") + rows(WAVE, WAVE, WAVE, RHO), "no reflectance column"),
        (SED.format("Reflect.") + rows(WAVE, WAVE, WAVE, RHO), "unit of 'Reflect.'"),
        (SED.format("Reflect. %") + rows(WAVE, WAVE, RHO), "3 columns under 4 titles"),
        (SED.split("Data:")[0], "no 'Data:' line"),
    ],
)
def test_bad_sed_files(tmp_path: Path, text: str, message: str):
    with pytest.raises(InputError, match=message):
        spectrum(tmp_path, text, "a.sed")


def test_a_sed_file_is_as_long_as_it_says(tmp_path: Path):
    head = SED.format("Reflect. [1.0]").replace("Columns", "Wavelength Range: 400,700\r\nChannels: 4\r\nColumns")
    body = "".join(f"{w:6.1f}\t{w:E}\t{w:E}\t{r:.5f}\r\n" for w, r in zip(WAVE, RHO, strict=True))
    assert np.allclose(spectrum(tmp_path, head + body, "a.sed").values, RHO)
    assert np.allclose(spectrum(tmp_path, head + body[:-2], "a.sed").values, RHO)  # only the end of the line
    shorter = body[: body.rindex("\r\n", 0, -2) + 2]
    for text, message in (
        (head + shorter, "3 rows\n  expected: 4, as it states"),
        (head.replace("Channels: 4", "Channels: x4") + body, "4 rows\n  expected: x4"),
        (head.replace("[4]", "[5]") + body, "4 columns under 4 titles\n  expected: 5 of both"),
        (head + body[:-4], "the last line is cut: '700.0 7.0"),
        (head + body.replace("700.0", "600.5"), "wavelengths from 400 to 600.5\n  expected: 400 to 700"),
        (head + body.replace("400.0\t", "380.0\t"), "wavelengths from 380 to 700"),
    ):
        with pytest.raises(InputError, match=message):
            spectrum(tmp_path, text, "a.sed")


def test_an_ecostress_file_is_as_long_as_it_says(tmp_path: Path):
    head = (
        "Name: Paint\nX Units: Wavelength (micrometers)\nY Units: Reflectance (percentage)\n"
        "First X Value: 0.7\nLast X Value: 0.4\nNumber of X Values: 4\n\n"
    )
    body = rows(WAVE[::-1] / 1000, RHO[::-1] * 100, sep="\t")
    assert np.allclose(spectrum(tmp_path, head + body).values, RHO)
    with pytest.raises(InputError, match="3 rows\n  expected: 4"):
        spectrum(tmp_path, head + body[: body.rindex("\n", 0, -1) + 1])
    with pytest.raises(InputError, match=r"wavelengths from 0.4 to 0.7\n  expected: 0.4 to 2.5"):
        spectrum(tmp_path, (head + body).replace("First X Value: 0.7", "First X Value: 2.5"))


def asd(
    kind: int = 1, version: bytes = b"as7", reference: bool = True, code: int = 2, description: bytes = b""
) -> bytes:
    head = bytearray(484)
    head[:3] = version
    head[186], head[199] = kind, code
    struct.pack_into("<2f", head, 191, 400.0, 100.0)
    struct.pack_into("<H", head, 204, 4)
    dtype = {0: "<f4", 1: "<i4", 2: "<f8"}[code]
    white = np.array([1000.0, 2000, 3000, 4000])
    block = (
        struct.pack("<H", 0xFFFF if reference else 0) + b"\0" * 16 + struct.pack("<H", len(description)) + description
    )
    return bytes(head) + (RHO * white).astype(dtype).tobytes() + block + white.astype(dtype).tobytes()


@pytest.mark.parametrize("code", [0, 1, 2])
@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("description", [b"", b"white panel"])
def test_asd_is_spectrum_over_reference(tmp_path: Path, code: int, kind: int, description: bytes):
    found = spectrum(tmp_path, asd(kind, code=code, description=description), "a.asd")
    assert found.wavelength_nm.tolist() == WAVE.tolist()
    assert np.allclose(found.values, RHO, rtol=1e-6)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (asd(kind=2), "holds radiance"),
        (asd(reference=False), "no white reference"),
        (asd()[:560], "cut short"),
        (asd()[:500], "cut short"),
        (asd()[:199] + b"\x09" + asd()[200:], "header is not valid"),
        (asd()[:204] + b"\xff\xff" + asd()[206:], "header is not valid"),
        (asd(kind=0, version=b"ASD"), "without a white reference"),
    ],
)
def test_bad_asd_files(tmp_path: Path, raw: bytes, message: str):
    with pytest.raises(InputError, match=message):
        spectrum(tmp_path, raw, "a.asd")


def long_asd(harm) -> bytes:
    """A file of 400 channels of 5 nm, whose spectrum and reference ``harm`` may change."""
    head = bytearray(484)
    head[:3], head[186], head[199] = b"as7", 1, 2
    struct.pack_into("<2f", head, 191, 400.0, 5.0)
    struct.pack_into("<H", head, 204, 400)
    white = 1000.0 * np.sin(np.linspace(0.1, 3.0, 400))
    spectra = [0.5 * white, white]
    harm(spectra, head)
    return bytes(head) + spectra[0].tobytes() + struct.pack("<H", 65535) + b"\0" * 18 + spectra[1].tobytes()


def changed(which: int, channels: slice, value: float):
    def harm(spectra, _):
        spectra[which][channels] = value

    return harm


def first_wavelength(nm: float):
    return lambda _, head: struct.pack_into("<f", head, 191, nm)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (changed(0, slice(200, 240), 0.0), "channel 201 holds 0, as do the 7 after it"),
        (changed(1, slice(200, 201), 0.0), "channel 201 holds 0\n"),
        (changed(0, slice(392, 400), 0.0), "channel 393 holds 0"),
        (changed(0, slice(0, 400), 0.0), "channel 1 holds 0, as do the 7 after it"),
        (changed(0, slice(7, 8), np.nan), "channel 8 holds nan"),
        (changed(1, slice(50, 51), 1e300), r"channel 51 holds 1e\+300"),
        (changed(0, slice(50, 51), 1e-9), "channel 51 holds 1e-09"),
        (changed(1, slice(50, 51), -700.0), "channel 51 holds -700"),
        (first_wavelength(800.0), "wavelengths from 800 to 2795 nm"),
        (first_wavelength(4.0), "wavelengths from 4 to 1999 nm"),
    ],
)
def test_emptied_and_absurd_channels_of_an_asd_file_are_refused(tmp_path: Path, harm, message: str):
    assert np.allclose(spectrum(tmp_path, long_asd(changed(0, slice(0, 0), 0.0)), "a.asd").values, 0.5)
    with pytest.raises(InputError, match=message):
        spectrum(tmp_path, long_asd(harm), "b.asd")


def test_noise_about_zero_and_a_step_between_detectors_are_no_damage_of_an_asd_file(tmp_path: Path):
    def harm(spectra, _):
        for values, noise in zip(spectra, np.random.default_rng(3).standard_normal((2, 50)), strict=True):
            values[100:] *= 0.02  # the next detector has another gain
            values[250:300] = 0.01 * values.max() * noise  # water vapour takes the light
        expected.append(spectra[0] / spectra[1])

    expected: list[np.ndarray] = []
    found = spectrum(tmp_path, long_asd(harm), "a.asd")
    assert np.array_equal(found.values, expected[0])
    assert found.values.min() < 0.0


# Libraries --------------------------------------------------------------------------------------


def library(
    tmp_path: Path, *, data_type: int = 4, order: int = 0, factor: str = "", units: str = "Micrometers"
) -> Path:
    values = np.stack([RHO, RHO * 2]) * (float(factor) if factor else 1.0)
    (tmp_path / "lib.hdr").write_text(
        f"ENVI\nsamples = 4\nlines = 2\nbands = 1\nheader offset = 0\nfile type = ENVI Spectral Library\n"
        f"data type = {data_type}\ninterleave = bsq\nbyte order = {order}\nwavelength units = {units}\n"
        f"wavelength = {{0.4, 0.5, 0.6, 0.7}}\nspectra names = {{red tile, grey tile}}\n"
        + (f"reflectance scale factor = {factor}\n" if factor else "")
    )
    kind = {4: "f4", 5: "f8", 2: "i2"}[data_type]
    path = tmp_path / "lib.sli"
    path.write_bytes(values.astype("<>"[order] + kind).tobytes())
    return path


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize(("data_type", "factor"), [(4, ""), (5, ""), (2, "10000")])
@pytest.mark.parametrize("named", ["lib.sli", "lib.hdr"])
def test_library_equals_spy(tmp_path: Path, order: int, data_type: int, factor: str, named: str):
    library(tmp_path, data_type=data_type, order=order, factor=factor)
    found = read_records(tmp_path / named)
    assert [f.name for f in found] == ["red tile", "grey tile"]
    assert np.allclose(found[1].values, RHO * 2, rtol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        spy = spectral.open_image(str(tmp_path / "lib.hdr"))
    scale = float(factor) if factor else 1.0
    assert np.allclose([f.values * scale for f in found], spy.spectra, rtol=1e-6)
    assert np.allclose(found[0].wavelength_nm, np.array(spy.bands.centers) * 1000)


def test_bad_libraries(tmp_path: Path):
    path = library(tmp_path)
    header = path.with_suffix(".hdr")
    good = header.read_text()
    for old, new, message in (
        ("lines = 2", "lines = 3", "expected: 48 bytes"),
        ("{red tile, grey tile}", "{red tile}", "1 names for 2 spectra"),
        ("{0.4, 0.5, 0.6, 0.7}", "{0.4, 0.5}", "2 wavelengths for 4 channels"),
        ("Spectral Library", "Standard", "expected: ENVI Spectral Library"),
    ):
        header.write_text(good.replace(old, new))
        with pytest.raises(InputError, match=message):
            read_records(path)
    header.write_text(good.replace("Micrometers", "Unknown"))
    assert any("can only be um" in note for note in read_records(path)[0].notes)
    assert read_records(path, wavelength_unit="um")[0].wavelength_nm[0] == pytest.approx(400)


def test_envi_plot_names_its_columns(tmp_path: Path):
    text = "ENVI ASCII Plot File [x]\r\nColumn 1: Wavelength\r\nColumn 2: Mean 'Tile'~~1\r\nColumn 3: Grass~~2\r\n"
    text += rows(WAVE / 1000, RHO, RHO * 2, end="\r\n")
    assert np.allclose(spectrum(tmp_path, text, record="Tile", wavelength_unit="um").values, RHO)
    with pytest.raises(InputError, match="3 titles for 2 columns"):
        spectrum(tmp_path, text.split("0.4")[0] + rows(WAVE, RHO))


def test_values_and_wavelengths_in_files_of_their_own(tmp_path: Path):
    grid = tmp_path / "wavelengths.txt"
    grid.write_text(" splib Record=1: Wavelengths ASD 0.35-2.5 microns\n" + rows(WAVE / 1000))
    text = " splib Record=77: Painted_Wood ASDFRa AREF\n" + rows(RHO).replace("0.1\n", "-1.23e34\n")
    found = spectrum(tmp_path, text, wavelengths=grid)
    assert found.name == "Painted_Wood ASDFRa AREF"
    assert np.allclose(found.wavelength_nm, WAVE[[0, 2, 3]])  # the deleted channel is left out
    assert np.allclose(found.values, RHO[[0, 2, 3]])
    grid.write_text(rows(WAVE[:3]))
    with pytest.raises(InputError, match="one column of 3 rows"):
        spectrum(tmp_path, text, wavelengths=grid)


def test_the_wavelengths_of_a_usgs_spectrum_are_those_beside_it(tmp_path: Path):
    """As splib07 is distributed: folders of spectra, and above them the wavelengths of each spectrometer."""
    inner = tmp_path / "ChapterM_Minerals"
    inner.mkdir()
    path = inner / "s07_AV14_Actinolite.txt"
    path.write_text(" s07_AV14 Record=77: Actinolite HS116.1B ASDFRb AREF\n" + rows(RHO))
    head = " s07_AV14 Record=1: Wavelengths AVIRIS 2014 in micrometers\n"
    (tmp_path / "s07_AV14_Wavelengths.txt").write_text(head + rows(WAVE / 1000))
    (tmp_path / "s07_other_Wavelengths.txt").write_text(head + rows(WAVE[:3] / 1000))
    found = read_spectrum(path)
    assert found.name == "Actinolite HS116.1B ASDFRb AREF"
    assert np.allclose(found.wavelength_nm, WAVE)
    assert np.allclose(found.values, RHO)
    assert "wavelengths from s07_AV14_Wavelengths.txt, which lies beside it" in found.notes
    (inner / "second_wavelengths.txt").write_text(head + rows(WAVE / 1000))  # two would fit: none is taken
    with pytest.raises(InputError, match="single column"):
        read_spectrum(path)


def test_specpr(tmp_path: Path):
    (tmp_path / "splib").write_bytes(specpr())
    first, second = read_records(tmp_path / "splib")
    assert (first.name, second.name) == ("Actinolite HS22.3B", "Alunite GDS84")
    keep = np.arange(700) != 5
    assert np.allclose(first.wavelength_nm, np.linspace(350, 2500, 700)[keep], rtol=1e-6)
    assert np.allclose(first.values, np.linspace(0.1, 0.6, 700)[keep], rtol=1e-6)
    assert first.standard_deviation is not None
    assert np.allclose(first.standard_deviation, 0.02)
    assert second.standard_deviation is None
    assert read_spectrum(tmp_path / "splib", record="Alunite").values[0] == pytest.approx(0.2)
    with pytest.raises(UsageError, match="holds 2 spectra"):
        read_spectrum(tmp_path / "splib")


def set_word(record: int, at: int, value: int) -> Callable[[bytearray], None]:
    return lambda raw: struct.pack_into(">i", raw, record * 1536 + at, value)


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (lambda raw: raw.pop(), "records of 1536 bytes"),
        (set_word(8, 100, 999), "has its wavelengths in record 999"),
        (set_word(1, 80, 699), "has its wavelengths in record 1, which holds none for 700"),
        (set_word(9, 0, 0), "expected: 2 continuations"),
        (lambda raw: raw.__delitem__(slice(1536, None)), "holds no spectrum"),
    ],
)
def test_specpr_files_that_are_damaged(tmp_path: Path, harm, message: str):
    (tmp_path / "splib").write_bytes(specpr(harm))
    with pytest.raises(InputError, match=f"(?s){message}"):
        read_records(tmp_path / "splib")


# Bad files --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("words only\nmore words\n", "holds no numbers"),
        ("nm,rho\n400,0.1\n", "1 channels"),
        ("nm,rho\n400,0.1\n500,0.1,0.3\n", ":3: 3 columns"),
        ("nm,rho\n400,0.1\n500;x\n", ":3: not a row of numbers"),
        ("400\n500\n600\n", "single column"),
        ("nm,rho\n400,nan\n500,nan\n600,1\n", "fewer than two channels"),
        ("nm,rho\n400,1\n400,1\n500,1\n", "no detectors overlap"),
        ("nm,rho,standard deviation\n400,0.1,-1\n500,0.1,1\n", "deviations below 0"),
        (b"\x89PNG\r\n\x1a\n\0\0\0", "binary file of unknown format"),
    ],
)
def test_bad_text_files(tmp_path: Path, text: str | bytes, message: str):
    with pytest.raises(InputError, match=message) as caught:
        spectrum(tmp_path, text)
    assert "s.txt" in str(caught.value)


def test_sizes_are_checked_before_memory_is_taken(tmp_path: Path):
    path = tmp_path / "big.txt"
    path.touch()
    os.truncate(path, 50 * 10**9)  # 50 GB in name only
    with pytest.raises(InputError, match=f"at most {MAX_BYTES} bytes"):
        read_spectrum(path)
    path.unlink()
    path.write_text("1 2\n" * 100_001)
    with pytest.raises(InputError, match="more than 100000 rows"):
        read_spectrum(path)


def test_paths_are_checked(tmp_path: Path):
    with pytest.raises(InputError, match="no such spectrum file"):
        read_spectrum(tmp_path / "no.txt")
    with pytest.raises(InputError, match="is a folder"):
        read_spectrum(tmp_path)
    with pytest.raises(UsageError, match="not a path of a local"):
        read_spectrum("https://example.invalid/a.txt")
    (tmp_path / "a.txt").write_text("nm,rho\n" + rows(WAVE, RHO))
    (tmp_path / "root").mkdir()
    with pytest.raises(UsageError, match="outside the data root"):
        read_spectrum(tmp_path / "a.txt", root=tmp_path / "root")


@given(
    st.binary(max_size=300),
    st.sampled_from([b"", SVC.encode(), SED.format("Reflect. %").encode(), asd()[:500], b"nm,rho\n"]),
)
@settings(max_examples=200)
def test_any_bytes_give_spectra_or_a_clear_error(tmp_path_factory, data: bytes, head: bytes):
    path = tmp_path_factory.mktemp("fuzz") / "f.txt"
    path.write_bytes(head + data)
    try:
        found = read_records(path, wavelength_unit="nm")
    except HypervalError:  # anything else fails the test
        found = []
    assert all(np.all(np.diff(f.wavelength_nm) > 0) for f in found)


@pytest.mark.parametrize("version", [b"as2", b"as3", b"as4", b"as5", b"as6", b"as7", b"as8"])
@pytest.mark.parametrize("kind", [0, 1])
def test_asd_of_every_version_with_a_reference(tmp_path: Path, version: bytes, kind: int):
    assert np.allclose(spectrum(tmp_path, asd(kind, version=version), "a.asd").values, RHO, rtol=1e-6)


def test_asd_version_1_stores_the_reflectance_itself(tmp_path: Path):
    raw = bytearray(asd(kind=1, version=b"ASD", code=2)[:484])
    raw += RHO.astype("<f8").tobytes()
    assert spectrum(tmp_path, bytes(raw), "a.asd").values.tolist() == RHO.tolist()


@pytest.mark.parametrize("entry", ["data ignore value = -9999", "bbl = {1, 0, 1, 1}"])
def test_channels_of_a_library_without_a_value_are_left_out(tmp_path: Path, entry: str):
    path = library(tmp_path)
    values = np.stack([RHO, RHO * 2]).astype("<f4")
    values[:, 1] = -9999
    path.write_bytes(values.tobytes())
    header = path.with_suffix(".hdr")
    header.write_text(header.read_text() + entry + "\n")
    for found, rho in zip(read_records(path), (RHO, RHO * 2), strict=True):
        assert found.wavelength_nm.tolist() == [400.0, 600.0, 700.0]
        assert np.allclose(found.values, rho[[0, 2, 3]])
        assert "1 channels without a value left out" in found.notes


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_a_library_is_read_behind_its_header_offset_and_a_byte_order_mark(tmp_path: Path, mark: str):
    path = library(tmp_path)
    plain = [s.values for s in read_records(path)]
    path.write_bytes(bytes(12) + path.read_bytes())
    header = path.with_suffix(".hdr")
    header.write_text(mark + header.read_text().replace("header offset = 0", "header offset = 12"), "utf-8")
    assert np.array_equal([s.values for s in read_records(path)], plain)


@pytest.mark.parametrize("mark", [-9999, -999, -32768])
def test_a_mark_of_a_missing_value_is_no_reflectance(tmp_path: Path, mark: int):
    text = f"wavelength nm,r\n400,0.1\n500,{mark}\n600,0.3\n"
    with pytest.raises(InputError, match="marks a missing value"):
        spectrum(tmp_path, text, "a.csv")


def test_deleted_standard_deviations(tmp_path: Path):
    head = "Wavelength in microns   reflectance   standard deviation\n"
    part = spectrum(tmp_path, head + "0.3 0.5 0.01\n0.4 0.6 -1.23e34\n0.5 0.7 0.02\n", "a.txt", wavelength_unit="um")
    assert part.wavelength_nm.tolist() == [300.0, 500.0]
    assert part.standard_deviation.tolist() == [0.01, 0.02]
    none = spectrum(tmp_path, head + "0.3 0.5 -1.23e34\n0.4 0.6 -1.23e34\n", "b.txt", wavelength_unit="um")
    assert none.values.tolist() == [0.5, 0.6]
    assert none.standard_deviation is None


@pytest.mark.parametrize("quantity", ["Transmittance (percent)", "Emissivity", "Absorbance"])
def test_another_quantity_in_a_library_file_is_no_reflectance(tmp_path: Path, quantity: str):
    text = f"Name: x\nX Units: Wavelength (micrometers)\nY Units: {quantity}\n\n0.6\t0.2\n0.5\t0.1\n"
    with pytest.raises(InputError, match=f"the file holds {quantity.split()[0].lower()}, not reflectance"):
        spectrum(tmp_path, text, "a.txt")
    assert spectrum(tmp_path, text, "a.txt", quantity="other").wavelength_nm.tolist() == [500.0, 600.0]


def test_a_library_with_capital_endings(tmp_path: Path):
    path = library(tmp_path)
    path.rename(tmp_path / "LIB.SLI")
    path.with_suffix(".hdr").rename(tmp_path / "LIB.HDR")
    for name in ("LIB.SLI", "LIB.HDR"):
        assert [r.name for r in read_records(tmp_path / name)] == ["red tile", "grey tile"]


# One spectrum a row -----------------------------------------------------------------------------


def test_one_spectrum_a_row_with_metadata_before_it(tmp_path: Path):
    text = (
        'site,name,Wavelength Units,400,500,600,700,\n"a, b",oak,Nanometers,0.1,0.2,0.3,0.4,\n'
        "c,elm,nm,0.2,NA,0.4,0.5,\n"
    )
    found = {s.name: s for s in read_all(tmp_path, text, "r.csv")}
    assert list(found) == ["oak", "elm"]
    assert found["oak"].wavelength_nm.tolist() == [400, 500, 600, 700]
    assert found["elm"].wavelength_nm.tolist() == [400, 600, 700]
    assert spectrum(tmp_path, text, "r.csv", record="elm").values.tolist() == [0.2, 0.4, 0.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,400,500,600,700\na,0.1,0.2,0.3\n", r"r\.csv:2: 4 cells"),
        ("name,400,500,600,700\na,0.1,x,0.3,0.4\n", r"r\.csv:2: the cell under '500' is no number"),
        ("name,400,500,600,700\n", "no spectrum"),
        (
            "name,Measurement Units,400,500,600,700\na,Percent,0.1,0.2,0.3,0.4\n",
            r"(?s)says percent.*reflectance_unit",
        ),
    ],
)
def test_row_tables_that_contradict_themselves(tmp_path: Path, text: str, message: str):
    with pytest.raises((InputError, UsageError), match=message):
        read_all(tmp_path, text, "r.csv")


def test_two_columns_without_a_header_are_asked_for_by_the_right_key(tmp_path: Path):
    text = rows(WAVE, RHO, 0.02 * RHO)
    with pytest.raises(UsageError, match=r"(?s)holds 2 spectra.*wavelength, reflectance, sd"):
        spectrum(tmp_path, text)
    found = spectrum(tmp_path, text, columns=(0, 1, 2))
    assert np.allclose(found.standard_deviation, 0.02 * RHO)


def test_text_padded_with_nul_is_text_and_other_binaries_are_not(tmp_path: Path):
    path = tmp_path / "p.txt"
    path.write_bytes(b"a comment" + bytes(40) + b"\r\nnm rho\r\n" + rows(WAVE, RHO).encode())
    assert np.allclose(read_spectrum(path).values, RHO)
    path.write_bytes(b"a\x01b" + bytes(40) + rows(WAVE, RHO).encode())
    with pytest.raises(InputError, match="binary file of unknown format"):
        read_spectrum(path)
