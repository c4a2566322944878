"""Text of instruments and programs: one meaning is read, units are never guessed, none or two are refused."""

import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from spectra_shells import RHO, SED, SVC, WAVE, asd, read, rows

from hyperval.errors import HypervalError, InputError, UsageError
from hyperval.spectra import read_records, read_spectrum

TEXTS = yaml.safe_load(Path(__file__).with_name("texts.yaml").read_text("utf-8"))
PLAIN = "nm,rho\n" + rows(WAVE, RHO)


@pytest.mark.parametrize("text", TEXTS["read"])
def test_text_with_one_meaning_is_read(tmp_path, text):
    found = read(tmp_path, text)
    np.testing.assert_allclose([found.wavelength_nm, found.values], [WAVE, RHO], rtol=1e-12)
    assert found.standard_deviation is None
    assert found.name == {"Name": "Paint", "///G": "lawn"}.get(text[:4], found.name)


LONG = [("more than 100000 rows", "1 2\n" * 100_001), (r"s.txt:2: not a CSV", "a,400,500,600,700\n" + "1" * 200_000)]


@pytest.mark.parametrize("case", [*TEXTS["refused"], *({"message": m, "text": t} for m, t in LONG)])
def test_damaged_and_unknown_text_is_refused_by_name(tmp_path, case):
    name = case.get("name", "s.txt")
    with pytest.raises(InputError, match=case["message"]) as caught:
        read(tmp_path, case["text"], name, quantity=case.get("quantity", "reflectance"))
    assert name in str(caught.value)


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
        ("SNRI 3", None), ("K-Mart lot", None), ("a.asd.rad", "radiance"), ("irrad_b.asd.rad", "irradiance"),
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
    with pytest.raises(UsageError, match="unit of the radiance"):
        read(tmp_path, PLAIN, quantity="radiance")
    assert np.allclose(read(tmp_path, PLAIN, quantity="radiance", unit="W m-2 sr-1 um-1").values, RHO / 10)
    # A spectrum cut out of an image of radiance is known by the name of its file, where its text says nothing.
    name = "ang20171108t184227_rdn_v2p11_lawn.txt"
    with pytest.raises(InputError, match="the file holds radiance, not reflectance"):
        read(tmp_path, rows(WAVE, RHO), name)
    assert read(tmp_path, "nm,reflectance\n" + rows(WAVE, RHO), name).values.tolist() == RHO.tolist()


def test_units_that_nobody_states_or_that_disagree(tmp_path):
    found = read(tmp_path, rows(WAVE / 1000, RHO))
    note = "the file states no wavelength unit: 0.4 to 0.7 can only be um"
    assert (found.wavelength_nm[0], *found.notes) == (pytest.approx(400.0), note)
    percent = read(tmp_path, rows(WAVE, (0.4 + RHO) * 100), reflectance_unit="percent")
    assert np.allclose(percent.values, 0.4 + RHO, rtol=1e-5)
    for text, options, message in (
        (rows([4.0, 500.0, 700.0], RHO[:3]), {}, "4 to 700 are wavelengths in neither"),
        (rows(WAVE / 1000, RHO), {"wavelength_unit": "nm"}, "cannot be in nm"),
        (rows([4000.0, 2000.0, 400.0], RHO[:3]), {}, "400 to 4000 may be nm, angstrom or wavenumbers"),
        (rows([3000.0, 5000.0, 9000.0], RHO[:3]), {}, "(?s)may be nm, angstrom.*1e7 over"),
        ("nm,r\n" + rows(WAVE, RHO), {"wavelength_unit": "um"}, "states wavelengths in nm, wavelength_unit says um"),
        ("nm,r [%]\n" + rows(WAVE, RHO), {"reflectance_unit": "fraction"}, "percent, the caller in fraction"),
        *((rows(WAVE, RHO), {"reflectance_unit": u}, "scaled:10000") for u in ("per mille", "scaled:0", "scaled:nan")),
        ("name,Measurement Units,400,500,600,700\na,Percent," + ",".join(map(str, RHO)), {}, "(?s)percent.*_unit"),
        *((f"nm,r,{u}\n" + rows(WAVE, RHO, RHO), {}, "coverage") for u in ("Expanded uncertainty", "Uncertainty 95%")),
    ):
        with pytest.raises((UsageError, InputError), match=message):
            read(tmp_path, text, **options)


def test_a_mean_has_its_standard_deviation_and_number(tmp_path):
    text = "#Wavelength in nm, Average Reflectance, Standard Deviation: N = 68, Hours: ,17.5\n"
    found = read(tmp_path, text + rows(WAVE, RHO, RHO / 10))
    assert (found.n, found.standard_deviation.tolist()) == (68, pytest.approx(RHO / 10))
    percent = read(tmp_path, text.replace("Average", "Average [%]") + rows(WAVE, RHO, RHO / 10))
    assert np.allclose(percent.standard_deviation, RHO / 1000)  # converted with its mean
    for titles, k in (("Tile 95%,Tile 95% STDEV", 1), ("Factor,Expanded uncertainty U (k=2)", 2), ("a,2 sigma", 2)):
        found = read(tmp_path, f"nm,{titles}\n" + rows(WAVE, RHO, RHO / 10))
        assert np.allclose(found.standard_deviation, RHO / 10 / k)
    head = "Wavelength in microns   reflectance   standard deviation\n"
    assert read(tmp_path, head + "0.3 0.5 0.01\n0.4 0.6 -1.23e34\n0.5 0.7 0\n").wavelength_nm.tolist() == [300.0, 500.0]
    assert read(tmp_path, head + "0.3 0.5 -1.23e34\n0.4 0.6 -1.23e34\n").standard_deviation is None
    with pytest.raises(UsageError, match=r"(?s)holds 2 spectra.*wavelength, reflectance, sd"):
        read(tmp_path, rows(WAVE, RHO, 0.02 * RHO))


def test_columns_by_name_and_number(tmp_path):
    text = "temp,nm,rho,err\n" + rows(WAVE * 0 + 20, WAVE, RHO, RHO / 5)
    for columns in (("nm", "rho", "err"), (1, 2, 3)):
        found = read(tmp_path, text, columns=columns)
        assert np.array_equal([found.values, found.standard_deviation], [RHO, RHO / 5])
    for columns in (("nm", "x"), (1, 9), (1,)):
        with pytest.raises(UsageError, match="column"):
            read(tmp_path, text, columns=columns)
    units = "Wave;Dark;Reflectance\n[nm];[counts];[%]\n" + rows(WAVE, [10] * 4, 100 * RHO, sep=";")
    np.testing.assert_allclose(read(tmp_path, units, record="Reflectance [%]").values, RHO)
    plot = "ENVI ASCII Plot File [x]\r\nColumn 1: Wavelength\r\nColumn 2: Mean 'Tile'~~1\r\nColumn 3: Grass~~2\r\n"
    found = read(tmp_path, plot + rows(WAVE / 1000, RHO, RHO * 2, sep=" ", end="\r\n"), record="Tile")
    assert np.allclose(found.values, RHO)


def test_records_by_name_part_number_and_mean(tmp_path):
    text = "nm,red cloth,blue cloth,blue paint\n" + rows(WAVE, RHO, 2 * RHO, 3 * RHO)
    for record, factor in (("blue paint", 3), ("RED", 1), (1, 2), ("mean", 2)):
        assert np.allclose(read(tmp_path, text, record=record).values, factor * RHO)
    mean = read(tmp_path, text, record="mean")  # of rho, 2 rho, 3 rho with n - 1
    assert (mean.n, mean.standard_deviation.tolist()) == (3, pytest.approx(RHO))
    assert [r.name for r in read_records(tmp_path / "s.txt")] == ["red cloth", "blue cloth", "blue paint"]
    for record, message in ((None, "3 spectra"), ("blue", "2 records match"), ("green", "no record"), (3, "0 to 2")):
        with pytest.raises(UsageError, match=message):
            read(tmp_path, text, record=record)
    # What is empty between commas moves no other column; the names stand in the row that says so.
    assert read(tmp_path, "400,,2\n410,1,\n420,1,2\n430,1,2\n", record=1, quantity="other").values.tolist() == [2.0] * 3
    assert read(tmp_path, "File Name,a,b\nTime,34,34\n" + rows(WAVE, RHO, RHO), record="b").name == "b"
    pairs = "nm,a,nm,b\n400,0.1,401,0.5\n500,0.2,501,0.5\n600,0.3,,\n"
    assert read(tmp_path, pairs, record="b").wavelength_nm.tolist() == [401.0, 501.0]
    # A column that repeats the wavelengths is none of them; spectra that go by a number are no bands of a row.
    assert read(tmp_path, rows(WAVE, RHO, WAVE, RHO * 3), record="mean").n == 2
    numbered = "Wavelength,1001,1002,1003,1004\n" + rows(WAVE, *[RHO] * 4)
    assert read(tmp_path, numbered, record="1004").wavelength_nm.tolist() == WAVE.tolist()


def test_one_spectrum_a_row_with_metadata_before_it(tmp_path):
    text = 'site,name,Wavelength Units,400,500,600,700,\n"a, b",oak,Nanometers,0.1,0.2,0.3,0.4,\n'
    text += "c,elm,nm,0.2,NA,0.4,0.5,\n"
    assert read(tmp_path, text, "r.csv", record="elm").values.tolist() == [0.2, 0.4, 0.5]
    oak, elm = read_records(tmp_path / "r.csv")
    assert (oak.name, elm.name, elm.wavelength_nm.tolist()) == ("oak", "elm", [400, 600, 700])
    detectors = [*range(400, 700, 10), *range(655, 1000, 10)]  # whose ranges overlap, as in libraries of EMIT
    table = f"Class,{','.join(map(str, detectors))}\nSoil,{','.join(['0.3'] * len(detectors))}\n"
    found = read(tmp_path, table, "e.csv")
    assert "overlapping detectors joined at 672.5 nm" in found.notes
    assert found.wavelength_nm[[0, -1]].tolist() == [400.0, 995.0]


def test_paths_and_sizes_are_checked_before_memory_is_taken(tmp_path):
    (tmp_path / "big.txt").touch()
    os.truncate(tmp_path / "big.txt", 50 * 10**9)  # 50 GB in name only
    for path, kind, message in (
        (tmp_path / "big.txt", InputError, "at most 10000000 bytes"),
        (tmp_path / "no.txt", InputError, "no such spectrum file"),
        (tmp_path, InputError, "is a folder"),
        ("https://example.invalid/a.txt", UsageError, "not a path of a local"),
    ):
        with pytest.raises(kind, match=message):
            read_spectrum(path)


@given(
    st.binary(max_size=300),
    st.sampled_from([b"", SVC.encode(), SED.format("Reflect. %").encode(), asd()[:500], b"nm,rho\n"]),
)
@settings(max_examples=200)
def test_any_bytes_give_spectra_or_a_clear_error(tmp_path_factory, data, head):
    path: Path = tmp_path_factory.mktemp("fuzz") / "f.txt"
    path.write_bytes(head + data)
    try:
        found = read_records(path, wavelength_unit="nm")
    except HypervalError:  # anything else fails the test
        found = []
    assert all(np.all(np.diff(f.wavelength_nm) > 0) for f in found)


def test_svc_joins_three_detectors_and_converts_percent(tmp_path):
    wave = np.array([400, 700, 900, 1000, 1010, 970, 985, 995, 1500, 1900, 1890, 1895, 2500.0])
    rho = np.linspace(0.1, 0.7, wave.size)
    body = rows(wave, wave * 0 + 9, rho * 9, rho * 100, sep="  ", end="\r\n")
    keep = [0, 1, 2, 7, 8, 12]  # joined at (1010 + 970) / 2 = 990 and (1900 + 1890) / 2 = 1895
    for head in (SVC, SVC.replace("comm=", "\r\ncomm=")):  # an empty line in it is none
        found = read(tmp_path, head + body, "a.sig")
        assert (found.name, found.wavelength_nm.tolist()) == ("plank_1", wave[keep].tolist())
        assert np.allclose(found.values, rho[keep], rtol=1e-4)
        assert any("990.0, 1895.0" in note for note in found.notes)


@pytest.mark.parametrize(("title", "factor"), [("Reflect. %", 100), ("Reflect. [1.0]", 1)])
def test_spectral_evolution_is_as_long_as_it_says(tmp_path, title, factor):
    head = SED.format(title).replace("Columns", "Wavelength Range: 400,700\r\nChannels: 4\r\nColumns")
    body = "".join(f"{w:6.1f}\t{w:E}\t{w:E}\t{r:.5f}\r\n" for w, r in zip(WAVE, factor * RHO, strict=True))
    for end in (len(body), -2):  # only the end of the line lacks
        assert np.allclose(read(tmp_path, head + body[:end], "a.sed").values, RHO)
    for text, message in (
        (head + body[: body.rindex("\r\n", 0, -2) + 2], "3 rows\n  expected: 4, as stated in the file"),
        (head.replace("Channels: 4", "Channels: x4") + body, "4 rows\n  expected: x4"),
        (head.replace("[4]", "[5]") + body, "4 columns under 4 titles\n  expected: 5 of both"),
        (head + body[:-4], "the last line is cut: '700.0 7.0"),
        (head + body.replace("700.0", "600.5"), "wavelengths from 400 to 600.5\n  expected: 400 to 700"),
    ):
        with pytest.raises(InputError, match=message):
            read(tmp_path, text, "a.sed")


def test_radiance_of_the_target(tmp_path):
    # 15000e-10 W cm-2 sr-1 nm-1 = 1.5 uW cm-2 sr-1 nm-1, the unit that the maker says.
    targets = "400 30000 15000 {0}\n500 40000 10000 {0}\n600 50000 5000 {0}\n"
    for quantity, percent in (("radiance", "50"), ("irradiance", "0")):
        text = SVC.replace(", Radiance", f", {quantity.title()}") + targets.format(percent)
        found = read(tmp_path, text, "a.sig", quantity=quantity)
        assert np.allclose(found.values, [1.5, 1.0, 0.5])
        assert any("maker's unit" in note for note in found.notes)
    assert np.allclose(read(tmp_path, SVC + targets.format("50"), "a.sig").values, 0.5)
    head = "Comment:\nInstrument: PSR\nMeasurement: RADIANCE\nUnits: {}\nColumns [2]:\nData:\nWvl\tRad. (Target)\n"
    text = head + "400\t0.1\n500\t0.2\n"
    found = read(tmp_path, text.format("W/m^2/sr/nm"), "a.sed", quantity="radiance")
    assert np.allclose(found.values, [10.0, 20.0])
    with pytest.raises(UsageError, match="unit of the radiance is not stated"):
        read(tmp_path, text.format("None"), "a.sed", quantity="radiance")
