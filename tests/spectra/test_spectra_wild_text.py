"""Text that instruments and programs write, each in its maker's layout: one answer is taken, two are asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.spectra import read_records, read_spectrum

WAVE = np.array([400, 500, 600, 700])
RHO = np.array([0.05, 0.1, 0.2, 0.4])


def read(tmp_path: Path, text: str, name: str = "s.txt", **options):
    (tmp_path / name).write_text(text)
    return read_spectrum(tmp_path / name, **options)


def rows(*columns, sep: str = "\t", end: str = "\n") -> str:
    return "".join(sep.join(str(v) for v in row) + end for row in zip(*columns, strict=True))


SPLIB06 = (
    "USGS Digital Spectral Library splib06a\n\n      wavelength    reflectance    standard deviation\n\n"
    "(standard deviation of 0.000000 means not measured)\n-------\nOlivine GDS70.a Fo89 W1R1Bb AREF\n"
)
OCEAN = "SpectraSuite Data File\n++++++++++\nIntegration Time (usec): 100000 (USB2C)\n"
INDEX = '"","wavelength","reflectance"\n'


@pytest.mark.parametrize(
    "text",
    [
        SPLIB06 + rows(WAVE / 1000, RHO, ["0.000000"] * 4, sep="     "),
        "Wavelength\tplot1.asd\n" + rows(WAVE, RHO).replace(".", ","),
        f"{OCEAN}>>>>>Begin Processed Spectral Data<<<<<\n{rows(WAVE, RHO)}>>>>>End Processed Spectral Data<<<<<\n",
        INDEX + rows([f'"{i}"' for i in (1, 2, 3, 4)], WAVE, RHO, sep=","),
        ",wavelength,reflectance\n" + rows(range(4), WAVE, RHO, sep=","),
        "4\n" + rows(WAVE, RHO),
        "id;400;500;600;700\nA;" + ";".join(map(str, RHO)).replace(".", ",") + "\n",
        "id\t400\t500\t600\t700\nA\t" + "\t".join(map(str, RHO)) + "\n",
        "id,Wave_400,Wave_500,Wave_600,Wave_700\nA," + ",".join(map(str, RHO)) + "\n",
        "Wavelength,400,500,600,700\nleaf," + ",".join(map(str, RHO)) + "\n",
    ],
    ids=[
        "splib06",
        "tab and comma",
        "ocean",
        "row names",
        "index",
        "count",
        "semicolons",
        "tabs",
        "prefix",
        "rows",
    ],
)
def test_text_with_one_meaning_is_read(tmp_path: Path, text: str):
    got = read(tmp_path, text)
    np.testing.assert_allclose(got.wavelength_nm, WAVE)
    np.testing.assert_allclose(got.values, RHO)
    assert got.standard_deviation is None


SIG = "///GER SIGNATUR FILE///\nname= lawn\ninstrument= 3700: 1234\naveraging= 1, 1\ncomm= \ndata= \n"


@pytest.mark.parametrize("percent", [True, False])
def test_ger_is_percent_or_target_over_reference(tmp_path: Path, percent: bool):
    columns = [WAVE, 5000 * RHO, [5000.0] * 4] + ([100 * RHO] if percent else [])
    got = read(tmp_path, SIG + rows(*columns, sep="  "), "gr070601.001")
    assert got.name == "lawn"
    np.testing.assert_allclose(got.values, RHO)


def test_ger_states_no_unit_of_its_radiance(tmp_path: Path):
    with pytest.raises(InputError, match=r"unit of the radiance in a GER file is not known(?s:.*)state its unit"):
        read(tmp_path, SIG + rows(WAVE, RHO, RHO, sep="  "), quantity="radiance")


def test_numbers_under_the_title_of_wavelengths_make_columns(tmp_path: Path):
    """Spectra that go by a number are not read as bands of their first row."""
    (tmp_path / "s.csv").write_text("Wavelength,1001,1002,1003,1004\n" + rows(WAVE, *[RHO] * 4, sep=","))
    got = read_records(tmp_path / "s.csv")
    assert [s.name for s in got] == ["1001", "1002", "1003", "1004"]
    np.testing.assert_allclose(got[3].wavelength_nm, WAVE)


def test_units_in_a_line_of_their_own_stand_behind_the_titles(tmp_path: Path):
    text = "Wave;Dark;Reflectance\n[nm];[counts];[%]\n" + rows(WAVE, [10] * 4, 100 * RHO, sep=";")
    np.testing.assert_allclose(read(tmp_path, text, record="Reflectance [%]").values, RHO)


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("5\n" + rows(WAVE, RHO), InputError, "4 rows(?s:.*)5, as it states"),
        (f"{rows(WAVE, RHO)}>>>>>End Spectral Data<<<<<\n800 0.4\n", InputError, "not a row of numbers: '800"),
        ("##TITLE= gypsum\n##XYDATA= (X++(Y..Y))\n400 0.1 0.2\n", InputError, "JCAMP-DX(?s:.*)save it as text"),
        ("PE UV       SUBTECH     SPECTRUM    ASCII\n#DATA\n400 0.1\n", InputError, "PerkinElmer"),
        (rows(WAVE, RHO, [0.01] * 4), UsageError, r"wavelength, reflectance, sd"),
        (
            "id,Band_101,Band_102,Band_103,Band_104\nA,1,2,3,4\n",
            HypervalError,
            "no numbers(?s:.*)titles that are",
        ),
    ],
)
def test_text_with_none_or_two_is_refused(tmp_path: Path, text: str, kind: type[Exception], words: str):
    with pytest.raises(kind, match=words):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("title", "quantity"),
    [
        ("Abs.", "absorbance"),
        ("Abs (a.u.)", "absorbance"),
        ("log(1/R)", "absorbance"),
        ("-log10(R)", "absorbance"),
        ("DN", "counts"),
        ("target [DN]", "counts"),
        ("Raw counts", "counts"),
        ("std", "a standard deviation"),
        ("grass_rdn", "radiance"),
        ("L (W/m2/sr/um)", "radiance"), ("E [W m-2 nm-1]", "irradiance"), ("Intensity (a.u.)", "intensity"),
        ("SNR", "snr"), ("K-M", "k-m"), ("1st derivative", "derivative"), ("Continuum removed", "continuum removed"),
    ],
)  # fmt: skip
def test_a_column_that_is_titled_otherwise_is_no_reflectance(tmp_path: Path, title: str, quantity: str):
    text = f"wavelength nm,{title}\n" + rows(WAVE, RHO, sep=",")
    with pytest.raises(InputError, match=f"the file holds {quantity}, not reflectance"):
        read(tmp_path, text)
    assert read(tmp_path, text, quantity="other").values.tolist() == RHO.tolist()


@pytest.mark.parametrize(
    "title", ["ABS plastic", "Abs. reflectance", "grass_rfl", "gradient", "Edna", "SNRI 3", "K-Mart lot"]
)
def test_names_of_samples_say_no_quantity(tmp_path: Path, title: str):
    assert read(tmp_path, f"wavelength nm,{title}\n" + rows(WAVE, RHO, sep=",")).values.tolist() == RHO.tolist()


def test_a_spectrum_cut_out_of_a_radiance_image_is_known_by_the_name_of_its_file(tmp_path: Path):
    name = "ang20171108t184227_rdn_v2p11_lawn.txt"
    with pytest.raises(InputError, match="the file holds radiance, not reflectance"):
        read(tmp_path, rows(WAVE, RHO), name)
    found = read(tmp_path, rows(WAVE, RHO), name, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    assert found.values.tolist() == RHO.tolist()
    titled = "wavelength nm,reflectance\n" + rows(WAVE, RHO, sep=",")
    assert read(tmp_path, titled, name).values.tolist() == RHO.tolist()


@pytest.mark.parametrize(
    "text",
    [
        "X Units: Wavenumber (cm-1)\nY Units: Reflectance\n" + rows(WAVE, RHO),
        "cm⁻¹\tR\n" + rows(WAVE, RHO),
        "1/cm;R\n" + rows(WAVE, RHO, sep=";"),
        "# wavenumber [cm^-1] and a reflectance factor\n" + rows(WAVE, RHO),
        "ENVI ASCII Plot File [Thu Apr 26 2018]\nColumn 1: Wavenumber\nColumn 2: a~~1\n" + rows(WAVE, RHO),
        "name,Wavelength Units,4000,5000,6000,7000\na,cm-1,0.1,0.2,0.3,0.4\n",
    ],
)
def test_wavenumbers_are_not_taken_for_nanometres(tmp_path: Path, text: str):
    with pytest.raises(InputError, match=r"(?s)wavenumbers.*1e7 over"):
        read(tmp_path, text)
