"""Text of instruments and programs: one meaning is read, units are never guessed, none or two are refused."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spectra_shells import SED, SVC, asd, read, rows

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.spectra import read_records, read_spectrum

WAVE = np.array([400.0, 500.0, 600.0, 700.0])
RHO = np.array([0.05, 0.1, 0.2, 0.4])
SPLIB06 = (
    "USGS Digital Spectral Library splib06a\n\n      wavelength    reflectance    standard deviation\n\n"
    "(standard deviation of 0.000000 means not measured)\n-------\nOlivine GDS70.a Fo89 W1R1Bb AREF\n"
)
OCEAN = "SpectraSuite Data File\n++++++++++\nIntegration Time (usec): 100000 (USB2C)\n"
ECOSTRESS = (
    "Name: Paint\nX Units: Wavelength (micrometers)\nY Units: Reflectance (percentage)\n"
    "First X Value: 0.7\nLast X Value: 0.4\nNumber of X Values: 4\n\n"
)
FALLING = rows(WAVE[::-1] / 1000, RHO[::-1] * 100, sep="\t")


@pytest.mark.parametrize(
    "text",
    [
        "# Wavelength in nm, reflectance\n" + rows(WAVE, RHO, sep=" "),
        "wavelength [nm]\treflectance\r\n" + rows(WAVE, RHO, sep="\t", end="\r\n"),
        "\ufeffnm, value\n" + rows(WAVE, RHO, sep=", "),
        "Wavelength (nm);rho\n" + rows(WAVE, RHO, sep="; ").replace(".", ","),
        "Wavelength\tplot1.asd\n" + rows(WAVE, RHO, sep="\t").replace(".", ","),
        "wavelength [µm], rho\n" + rows(WAVE / 1000, RHO),
        "nm,reflectance [%]\n" + rows(WAVE, RHO * 100),
        "nm,refl [%*100]\n" + rows(WAVE, RHO * 10000),
        '"nm","rho"\n' + "".join(f'"{w:g}","{r:g}"\n' for w, r in zip(WAVE, RHO, strict=True)),
        "nm,rho\n\n" + rows(WAVE[::-1], RHO[::-1], end="\n\n"),
        "nm,rho\n" + rows(WAVE, RHO) + "800,NaN\n900,-1.23e34\n",
        SPLIB06 + rows(WAVE / 1000, RHO, ["0.000000"] * 4, sep="     "),
        f"{OCEAN}>>>>>Begin Processed Spectral Data<<<<<\n{rows(WAVE, RHO)}>>>>>End Processed Spectral Data<<<<<\n",
        '"","wavelength","reflectance"\n' + rows(["1", "2", "3", "4"], WAVE, RHO),
        ",wavelength,reflectance\n" + rows(range(4), WAVE, RHO),
        "4\n" + rows(WAVE, RHO, sep="\t"),
        "id;400;500;600;700\nA;" + ";".join(map(str, RHO)).replace(".", ",") + "\n",
        "id\t400\t500\t600\t700\nA\t" + "\t".join(map(str, RHO)) + "\n",
        "id,Wave_400,Wave_500,Wave_600,Wave_700\nA," + ",".join(map(str, RHO)) + "\n",
        "Wavelength,400,500,600,700\nleaf," + ",".join(map(str, RHO)) + "\n",
        b"a comment" + bytes(40) + b"\r\nnm rho\r\n" + rows(WAVE, RHO, sep=" ").encode(),  # as ViewSpec pads it
        ECOSTRESS + FALLING,
    ],
)
def test_text_with_one_meaning_is_read(tmp_path, text):
    found = read(tmp_path, text)
    np.testing.assert_allclose(found.wavelength_nm, WAVE, rtol=1e-12)
    np.testing.assert_allclose(found.values, RHO, rtol=1e-12)
    assert found.standard_deviation is None
    assert found.name == ("Paint" if str(text).startswith("Name") else found.name)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "empty"),
        ("words only\nmore words\n", "holds no numbers"),
        ("nm,rho\n400,0.1\n", "1 channels"),
        ("nm,rho\n400,0.1\n500,0.1,0.3\n", r"s\.txt:3: 3 columns"),
        ("nm,rho\n400,0.1\n500;x\n", r"s\.txt:3: not a row of numbers"),
        ("400\n500\n600\n", "single column"),
        ("nm,rho\n400,nan\n500,nan\n600,1\n", "fewer than two channels"),
        ("nm,rho\n400,1\n400,1\n500,1\n", "no detectors overlap"),
        ("nm,rho,standard deviation\n400,0.1,-1\n500,0.1,1\n", "deviations below 0"),
        (b"\x89PNG\r\n\x1a\n\0\0\0", "binary file of unknown format"),
        (b"a\x01b" + bytes(40) + rows(WAVE, RHO).encode(), "binary file of unknown format"),
        ("1 2\n" * 100_001, "more than 100000 rows"),
        ("5\n" + rows(WAVE, RHO, sep=" "), "4 rows(?s:.*)5, as it states"),
        (f"{rows(WAVE, RHO)}>>>>>End Spectral Data<<<<<\n800 0.4\n", "not a row of numbers: '800"),
        ("##TITLE= gypsum\n##XYDATA= (X++(Y..Y))\n400 0.1 0.2\n", "JCAMP-DX(?s:.*)save it as text"),
        ("PE UV       SUBTECH     SPECTRUM    ASCII\n#DATA\n400 0.1\n", "PerkinElmer"),
        ("id,Band_101,Band_102,Band_103,Band_104\nA,1,2,3,4\n", "no numbers(?s:.*)titles that are"),
        (ECOSTRESS + FALLING[: FALLING.rindex("\n", 0, -1) + 1], "3 rows\n  expected: 4"),
        (ECOSTRESS.replace("Value: 0.7", "Value: 2.5") + FALLING, "from 0.4 to 0.7\n  expected: 0.4 to 2.5"),
        ("nm,rho\n" + rows(WAVE, (0.4 + RHO) * 100), "looks like percent"),
        ("nm,rho\n" + rows(WAVE, (0.4 + RHO) * 10000), "looks like scaled:10000"),
        ("nm,rho\n400,0.1\n500,-9999\n600,0.3\n", "marks a missing value"),
        ("name,400,500,600,700\na,0.1,0.2,0.3\n", r"s\.txt:2: 4 cells"),
        ("name,400,500,600,700\na,0.1,x,0.3,0.4\n", r"s\.txt:2: the cell under '500' is no number"),
        ("name,400,500,600,700\n", "no spectrum"),
        ("X Units: Wavenumber (cm-1)\nY Units: Reflectance\n" + rows(WAVE, RHO), "(?s)wavenumbers.*1e7 over"),
        ("cm⁻¹\tR\n" + rows(WAVE, RHO, sep="\t"), "(?s)wavenumbers.*1e7 over"),
        ("# wavenumber [cm^-1] and a reflectance factor\n" + rows(WAVE, RHO), "(?s)wavenumbers.*1e7 over"),
        ("ENVI ASCII Plot File [x]\nColumn 1: Wavenumber\nColumn 2: a\n" + rows(WAVE, RHO), "wavenumbers"),
        ("ENVI ASCII Plot File [x]\nColumn 1: Wavelength\n" + rows(WAVE, RHO), "1 titles for 2 columns"),
        ("name,Wavelength Units,4000,5000,6000,7000\na,cm-1,0.1,0.2,0.3,0.4\n", "wavenumbers"),
    ],
)
def test_damaged_and_unknown_text_is_refused_by_name(tmp_path, content, message):
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, content)
    assert "s.txt" in str(caught.value)


@pytest.mark.parametrize(
    ("title", "quantity"),
    [
        ("Abs.", "absorbance"), ("Abs (a.u.)", "absorbance"), ("log(1/R)", "absorbance"), ("-log10(R)", "absorbance"),
        ("DN", "counts"), ("target [DN]", "counts"), ("Raw counts", "counts"), ("std", "a standard deviation"),
        ("grass_rdn", "radiance"), ("L (W/m2/sr/um)", "radiance"), ("E [W m-2 nm-1]", "irradiance"),
        ("Intensity (a.u.)", "intensity"), ("SNR", "snr"), ("K-M", "k-m"), ("1st derivative", "derivative"),
        ("Continuum removed", "continuum removed"), ("Transmittance (percent)", "transmittance"),
        ("Emissivity", "emissivity"), ("spectral irradiance", "irradiance"),
        ("ABS plastic", None), ("Abs. reflectance", None), ("grass_rfl", None), ("gradient", None), ("Edna", None),
        ("SNRI 3", None), ("K-Mart lot", None),
    ],
)  # fmt: skip
def test_a_title_says_the_quantity_and_a_name_of_a_sample_none(tmp_path, title, quantity):
    text = f"wavelength nm,{title}\n" + rows(WAVE, RHO)
    assert read(tmp_path, text, quantity="other").values.tolist() == RHO.tolist()
    if quantity is None:
        assert read(tmp_path, text).values.tolist() == RHO.tolist()
    else:
        with pytest.raises(InputError, match=f"the file holds {quantity}, not reflectance"):
            read(tmp_path, text)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("W/m^2/sr/nm", 100.0), ("mW/m2/sr/nm", 0.1), ("µW/cm²/nm/sr", 1.0), ("uW cm-2 sr-1 um-1", 1e-3),
        ("W/m^2/nm", 100.0),
    ],
)  # fmt: skip
def test_the_unit_of_a_radiance_stands_in_its_title(tmp_path, unit, factor):
    quantity = "radiance" if "sr" in unit else "irradiance"
    found = read(tmp_path, f"Wavelength (nm)\t{quantity} ({unit})\n" + rows(WAVE, RHO, sep="\t"), quantity=quantity)
    np.testing.assert_allclose(found.values, factor * RHO, rtol=1e-12)


def test_a_radiance_needs_its_unit(tmp_path):
    text = "nm,L\n" + rows(WAVE, RHO * 100)
    with pytest.raises(UsageError, match="unit of the radiance"):
        read(tmp_path, text, quantity="radiance")
    assert np.allclose(read(tmp_path, text, quantity="radiance", unit="W m-2 sr-1 um-1").values, RHO * 10)
    # A spectrum cut out of an image of radiance is known by the name of its file, where its text says nothing.
    name = "ang20171108t184227_rdn_v2p11_lawn.txt"
    with pytest.raises(InputError, match="the file holds radiance, not reflectance"):
        read(tmp_path, rows(WAVE, RHO), name)
    assert read(tmp_path, "nm,reflectance\n" + rows(WAVE, RHO), name).values.tolist() == RHO.tolist()


def test_units_that_nobody_states_or_that_disagree(tmp_path):
    found = read(tmp_path, rows(WAVE / 1000, RHO))
    assert found.wavelength_nm[0] == pytest.approx(400.0)
    assert found.notes == ("the file states no wavelength unit: 0.4 to 0.7 can only be um",)
    percent, stated = rows(WAVE, (0.4 + RHO) * 100), {"reflectance_unit": "percent"}
    assert np.allclose(read(tmp_path, percent, **stated).values, 0.4 + RHO, rtol=1e-5)
    for text, options, message in (
        (rows([4.0, 500.0, 700.0], RHO[:3]), {}, r"nm, or um \(then they are 4000 to 700000 nm\)"),
        (rows(WAVE / 1000, RHO), {"wavelength_unit": "nm"}, "cannot be in nm"),
        ("nm,r\n" + rows(WAVE, RHO), {"wavelength_unit": "um"}, "states wavelengths in nm, the caller in um"),
        ("nm,r [%]\n" + rows(WAVE, RHO), {"reflectance_unit": "fraction"}, "percent, the caller in fraction"),
        *((rows(WAVE, RHO), {"reflectance_unit": u}, "scaled:10000") for u in ("per mille", "scaled:0", "scaled:nan")),
        ("name,Measurement Units,400,500,600,700\na,Percent," + ",".join(map(str, RHO)), {}, "(?s)percent.*_unit"),
    ):
        with pytest.raises(UsageError, match=message):
            read(tmp_path, text, **options)


def test_a_mean_has_its_standard_deviation_and_number(tmp_path):
    text = "#Wavelength in nm, Average Reflectance, Standard Deviation: N = 68, Hours: ,17.5\n"
    found = read(tmp_path, text + rows(WAVE, RHO, RHO / 10))
    assert np.allclose(found.standard_deviation, RHO / 10)
    assert found.n == 68
    percent = read(tmp_path, text.replace("Average", "Average [%]") + rows(WAVE, RHO, RHO / 10))
    assert np.allclose(percent.standard_deviation, RHO / 1000)  # converted with its mean
    head = "Wavelength in microns   reflectance   standard deviation\n"
    part = read(tmp_path, head + "0.3 0.5 0.01\n0.4 0.6 -1.23e34\n0.5 0.7 0.02\n")
    assert part.wavelength_nm.tolist() == [300.0, 500.0]
    assert read(tmp_path, head + "0.3 0.5 -1.23e34\n0.4 0.6 -1.23e34\n").standard_deviation is None
    with pytest.raises(UsageError, match=r"(?s)holds 2 spectra.*wavelength, reflectance, sd"):
        read(tmp_path, rows(WAVE, RHO, 0.02 * RHO))


def test_columns_by_name_and_number(tmp_path):
    text = "temp,nm,rho,err\n" + rows(WAVE * 0 + 20, WAVE, RHO, RHO / 5)
    by_name = read(tmp_path, text, columns=("nm", "rho", "err"))
    by_number = read(tmp_path, text, columns=(1, 2, 3))
    assert np.array_equal(by_name.values, RHO)
    assert np.array_equal(by_name.standard_deviation, by_number.standard_deviation)
    for columns in (("nm", "x"), (1, 9), (1,)):
        with pytest.raises(UsageError, match="column"):
            read(tmp_path, text, columns=columns)
    units = "Wave;Dark;Reflectance\n[nm];[counts];[%]\n" + rows(WAVE, [10] * 4, 100 * RHO, sep=";")
    np.testing.assert_allclose(read(tmp_path, units, record="Reflectance [%]").values, RHO)


def test_records_by_name_part_number_and_mean(tmp_path):
    text = "nm,red cloth,blue cloth,blue paint\n" + rows(WAVE, RHO, 2 * RHO, 3 * RHO)
    for record, factor in (("blue paint", 3), ("RED", 1), (1, 2), ("mean", 2)):
        assert np.allclose(read(tmp_path, text, record=record).values, factor * RHO)
    mean = read(tmp_path, text, record="mean")
    assert np.allclose(mean.standard_deviation, RHO)  # of rho, 2 rho, 3 rho with n - 1
    assert mean.n == 3
    assert [r.name for r in read_records(tmp_path / "s.txt")] == ["red cloth", "blue cloth", "blue paint"]
    for record, message in ((None, "3 spectra"), ("blue", "2 records match"), ("green", "no record"), (3, "0 to 2")):
        with pytest.raises(UsageError, match=message):
            read(tmp_path, text, record=record)
    # A column that repeats the wavelengths is none of them; spectra that go by a number are no bands of a row.
    assert read(tmp_path, rows(WAVE, RHO, WAVE, RHO * 3), record="mean").n == 2
    numbered = "Wavelength,1001,1002,1003,1004\n" + rows(WAVE, *[RHO] * 4)
    assert read(tmp_path, numbered, record="1004").wavelength_nm.tolist() == WAVE.tolist()


def test_one_spectrum_a_row_with_metadata_before_it(tmp_path):
    text = 'site,name,Wavelength Units,400,500,600,700,\n"a, b",oak,Nanometers,0.1,0.2,0.3,0.4,\n'
    text += "c,elm,nm,0.2,NA,0.4,0.5,\n"
    assert read(tmp_path, text, "r.csv", record="elm").values.tolist() == [0.2, 0.4, 0.5]
    assert [s.name for s in read_records(tmp_path / "r.csv")] == ["oak", "elm"]
    assert read_records(tmp_path / "r.csv")[1].wavelength_nm.tolist() == [400, 600, 700]
    detectors = [*range(400, 700, 10), *range(655, 1000, 10)]  # whose ranges overlap, as in libraries of EMIT
    table = f"Class,{','.join(map(str, detectors))}\nSoil,{','.join(['0.3'] * len(detectors))}\n"
    found = read(tmp_path, table, "e.csv")
    assert "overlapping detectors joined at 672.5 nm" in found.notes
    assert found.wavelength_nm[[0, -1]].tolist() == [400.0, 995.0]


def test_an_envi_plot_names_its_columns(tmp_path):
    text = "ENVI ASCII Plot File [x]\r\nColumn 1: Wavelength\r\nColumn 2: Mean 'Tile'~~1\r\nColumn 3: Grass~~2\r\n"
    found = read(tmp_path, text + rows(WAVE / 1000, RHO, RHO * 2, sep=" ", end="\r\n"), record="Tile")
    assert np.allclose(found.values, RHO)


def test_paths_and_sizes_are_checked_before_memory_is_taken(tmp_path):
    (tmp_path / "root").mkdir()
    (tmp_path / "a.txt").write_text("nm,rho\n" + rows(WAVE, RHO))
    (tmp_path / "big.txt").touch()
    os.truncate(tmp_path / "big.txt", 50 * 10**9)  # 50 GB in name only
    for path, options, kind, message in (
        (tmp_path / "big.txt", {}, InputError, "at most 10000000 bytes"),
        (tmp_path / "no.txt", {}, InputError, "no such spectrum file"),
        (tmp_path, {}, InputError, "is a folder"),
        ("https://example.invalid/a.txt", {}, UsageError, "not a path of a local"),
        (tmp_path / "a.txt", {"root": tmp_path / "root"}, UsageError, "outside the data root"),
    ):
        with pytest.raises(kind, match=message):
            read_spectrum(path, **options)


@given(
    st.binary(max_size=300),
    st.sampled_from([b"", SVC.encode(), SED.format("Reflect. %").encode(), asd()[:500], b"nm,rho\n"]),
)
@settings(max_examples=200)
def test_any_bytes_give_spectra_or_a_clear_error(tmp_path_factory, data: bytes, head: bytes):
    path: Path = tmp_path_factory.mktemp("fuzz") / "f.txt"
    path.write_bytes(head + data)
    try:
        found = read_records(path, wavelength_unit="nm")
    except HypervalError:  # anything else fails the test
        found = []
    assert all(np.all(np.diff(f.wavelength_nm) > 0) for f in found)
