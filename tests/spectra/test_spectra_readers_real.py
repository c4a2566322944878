"""Readers of spectra on real files, against the instruments' own exports where there are any."""

from __future__ import annotations

import csv

import numpy as np
import pytest
import spectral

from hyperval.errors import InputError, UsageError
from hyperval.spectra import read_records, read_spectrum

pytestmark = pytest.mark.data


@pytest.mark.parametrize("name", ["spectra/asd/ribb00001", "formats/ribb00003", "formats/ribb00007"])
def test_asd_agrees_with_its_own_text_export(data_dir, name):
    binary = read_spectrum(data_dir(f"{name}.asd"))
    text = read_spectrum(data_dir(f"{name}.asd.txt"), wavelength_unit="nm")
    assert np.array_equal(binary.wavelength_nm, np.arange(350.0, 2501.0))
    assert np.array_equal(text.wavelength_nm, binary.wavelength_nm)
    assert np.allclose(binary.values, text.values, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["soil", "v6sample00000", "v8sample00001"])
def test_asd_raw_counts_over_reference_are_plausible(data_dir, name):
    found = read_spectrum(data_dir(f"spectra/asd/{name}.asd"))
    assert 0.0 < np.median(found.values) < 1.05
    assert found.wavelength_nm.size == 2151


def test_asd_radiance_is_refused(data_dir):
    with pytest.raises(InputError, match="holds radiance"):
        read_spectrum(data_dir("spectra/asd/v7sample00000.asd"))


@pytest.mark.parametrize(
    ("name", "channels"),
    [("BNL13001_000", 1024), ("BNL13001_000_moc", 982), ("gr070214_003", 991), ("ACPL_D2_P1_B_1_000_BAD", 1024)],
)
def test_svc(data_dir, name, channels):
    path = data_dir(f"spectra/svc_sig/{name}.sig")
    body = path.read_text(encoding="latin-1").split("data= ")[1].split()
    table = np.array(body, dtype=float).reshape(-1, 4)
    assert len(table) == channels
    found = read_spectrum(path)
    assert np.all(np.diff(found.wavelength_nm) > 0)
    rows = np.flatnonzero(np.isin(table[:, 0], found.wavelength_nm))
    assert found.wavelength_nm.size <= channels
    # Each value is one of the file's, in hundredths.
    pairs = {(w, r) for w, r in zip(table[rows, 0], table[rows, 3], strict=True)}
    assert all((w, round(100 * v, 2)) in pairs for w, v in zip(found.wavelength_nm, found.values, strict=True))
    # The reflectance column is target over reference.
    assert np.allclose(table[:, 3], 100 * table[:, 2] / table[:, 1], atol=0.02)


def test_svc_joined_here_is_close_to_the_makers_own_join(data_dir):
    raw = read_spectrum(data_dir("spectra/svc_sig/BNL13001_000.sig"))
    matched = read_spectrum(data_dir("spectra/svc_sig/BNL13001_000_moc.sig"))
    # The maker rescales the first two detectors and leaves the third as it is (factor 1.000): it must agree.
    third = raw.wavelength_nm > 1915.0
    assert np.array_equal(raw.wavelength_nm[third], matched.wavelength_nm[matched.wavelength_nm > 1915.0])
    assert np.allclose(raw.values[third], matched.values[matched.wavelength_nm > 1915.0], atol=2e-4)
    # Where the maker cut ("Remove @ 970,1901") this reader is within the overlap that it cut in the middle.
    assert any("994.2, 1905.2" in note for note in raw.notes)
    assert matched.notes == ("values x 0.01",)


def test_spectral_evolution(data_dir):
    percent = read_spectrum(data_dir("spectra/sed/1456045_00115.sed"))
    fraction = read_spectrum(data_dir("spectra/sed/cvars_grape_leaf1_lc_rg_01236.sed"))
    assert percent.values[0] == pytest.approx(0.11215)
    assert fraction.values[0] == pytest.approx(0.18909)
    assert fraction.wavelength_nm.size == 2151


@pytest.mark.parametrize("name", ["library_berlin", "earthlib_spectra-optimized"])
def test_libraries_equal_spy(data_dir, name):
    path = data_dir(f"spectra/sli/{name}.sli")
    own = read_records(path, reflectance_unit="scaled:10000" if name == "library_berlin" else None)
    spy = spectral.open_image(str(path.with_suffix(".hdr")))
    scale = 1e4 if name == "library_berlin" else 1.0
    assert [r.name for r in own] == [n.strip() for n in spy.names]
    assert np.allclose([r.values * scale for r in own], spy.spectra, rtol=1e-6)
    assert np.allclose(own[0].wavelength_nm, np.array(spy.bands.centers) * 1000)


@pytest.mark.parametrize(("name", "n"), [("BeckmanLawn", 68), ("AstroGreenBaseball", 25), ("DarkTarget_Trial1", 24)])
def test_field_means_with_spread(data_dir, name, n):
    path = data_dir(f"pasadena/insitu/{name}.txt")
    found = read_spectrum(path)
    table = np.loadtxt(path)
    assert found.n == n
    assert np.array_equal(found.values, table[:, 1])
    assert np.array_equal(found.standard_deviation, table[:, 2])


def test_radiance_text(data_dir):
    path = data_dir("pasadena/remote/ang20171108t184227_rdn_v2p11_BeckmanLawn.txt")
    found = read_spectrum(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1", wavelength_unit="nm")
    assert np.array_equal(found.values, np.loadtxt(path)[:, 1])
    unstated = read_spectrum(path, quantity="radiance", unit="uW cm-2 sr-1 nm-1")
    assert np.array_equal(unstated.wavelength_nm, found.wavelength_nm)
    assert any("can only be nm" in note for note in unstated.notes)


def test_panel_in_percent_is_found_out(data_dir):
    path = data_dir("spectra/panel_reflectance/R55_SiSu.txt")
    with pytest.raises(InputError, match="looks like percent"):
        read_spectrum(path, wavelength_unit="nm")
    assert 0.4 < np.median(read_spectrum(path, wavelength_unit="nm", reflectance_unit="percent").values) < 0.6


def test_hysu_plot_library_and_table_agree(data_dir):
    options = {"reflectance_unit": "scaled:10000"}
    plot = read_records(data_dir("hysu/published/svc/DLR_HySU_SVC_ASCII.txt"), wavelength_unit="um", **options)
    library = read_records(data_dir("hysu/published/svc/DLR_HySU_SVC.lib"), **options)
    table = read_records(data_dir("hysu/field_spectra_svc_135bands.csv"))
    assert len(plot) == len(library) == len(table) == 6
    for a, b, c in zip(plot, library, table, strict=True):
        assert a.name == b.name
        assert np.allclose(a.wavelength_nm, c.wavelength_nm, atol=1e-6)
        assert np.allclose(a.values, b.values, atol=1e-9)
        assert np.allclose(a.values, c.values, rtol=0, atol=5.1e-7)  # the table has six decimals
    # The library says "reflectance scale factor = 1" of values that are 10,000 times too large.
    with pytest.raises(InputError, match="looks like scaled:10000"):
        read_spectrum(data_dir("hysu/published/svc/DLR_HySU_SVC.lib"), record="Bitumen")


def test_hysu_single_measurement_with_three_detectors(data_dir):
    path = data_dir("hysu/field_measurements_svc_raw.csv")
    found = read_spectrum(path, record="m12")
    with open(path, newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert found.wavelength_nm.size < len(rows)
    assert {round(v, 5) for v in found.values} <= {float(r["m12"]) for r in rows}
    assert 0.9 < np.median(found.values) < 1.05  # a white panel


def test_columns_in_pairs_are_replicates(data_dir):
    path = data_dir("spectra/asd_txt_multicolumn/GrassByBuilding01_10.txt")
    mean = read_spectrum(path, record="mean", wavelength_unit="nm")
    table = np.array(path.read_text().replace(",", " ").split(), float).reshape(-1, 20)[:, 1::2]
    assert mean.n == 10
    assert np.allclose(mean.values, table.mean(axis=1))
    assert np.allclose(mean.standard_deviation, table.std(axis=1, ddof=1))


def test_spectral_evolution_radiance_file_holds_a_reflectance(data_dir):
    path = data_dir("formats/darwin.sed")
    table = np.genfromtxt(path, skip_header=27)
    found = read_spectrum(path)
    assert np.allclose(found.values, table[:, 3] / 100.0, rtol=0, atol=1e-12)
    power = read_spectrum(path, quantity="radiance")
    assert np.allclose(power.values, 100.0 * table[:, 2], rtol=1e-12)  # W m-2 sr-1 nm-1 in uW cm-2
    assert np.nanmedian(np.abs(found.values / (table[:, 2] / table[:, 1]) - 1.0)) < 1e-3


def test_viewspec_text_padded_with_nul(data_dir):
    path = data_dir("formats/tree100001.asd.ref.txt")
    lines = path.read_bytes().replace(b"\0", b"").decode("latin-1").splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("Wavelength"))
    table = np.loadtxt(lines[start + 1 :])
    found = read_spectrum(path)
    assert np.array_equal(found.wavelength_nm, table[:, 0])
    assert np.array_equal(found.values, table[:, 1])


def test_ecosis_has_one_spectrum_a_row(data_dir):
    path = data_dir("formats/ecosis_one_spectrum_a_row.csv")
    with pytest.raises(UsageError, match=r"(?s)the file says percent.*reflectance_unit: fraction"):
        read_records(path)
    found = read_records(path, reflectance_unit="fraction")
    with open(path, newline="") as stream:
        table = list(csv.DictReader(stream))
    assert [s.name for s in found] == [row["sample name"] for row in table]
    for spectrum, row in zip(found, table, strict=True):
        assert spectrum.values.tolist() == [float(row[f"{nm:g}"]) for nm in spectrum.wavelength_nm]
    assert found[0].wavelength_nm.size == 2151
