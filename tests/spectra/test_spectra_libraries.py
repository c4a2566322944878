"""Libraries of spectra: ENVI, SPECPR, and files of one column with their wavelengths beside."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import spectral
from spectra_shells import read, rows, specpr

from hyperval.errors import InputError, UsageError
from hyperval.spectra import read_records, read_spectrum

WAVE = np.array([400.0, 500.0, 600.0, 700.0])
RHO = np.array([0.05, 0.1, 0.2, 0.4])


def library(folder: Path, *, data_type: int = 4, order: int = 0, factor: str = "") -> Path:
    values = np.stack([RHO, RHO * 2]) * (float(factor) if factor else 1.0)
    (folder / "lib.hdr").write_text(
        f"ENVI\nsamples = 4\nlines = 2\nbands = 1\nheader offset = 0\nfile type = ENVI Spectral Library\n"
        f"data type = {data_type}\ninterleave = bsq\nbyte order = {order}\nwavelength units = Micrometers\n"
        f"wavelength = {{0.4, 0.5, 0.6, 0.7}}\nspectra names = {{red tile, grey tile}}\n"
        + (f"reflectance scale factor = {factor}\n" if factor else "")
    )
    (folder / "lib.sli").write_bytes(values.astype("<>"[order] + {4: "f4", 5: "f8", 2: "i2"}[data_type]).tobytes())
    return folder / "lib.sli"


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize(("data_type", "factor"), [(4, ""), (5, ""), (2, "10000")])
def test_a_library_equals_spy_by_its_data_file_or_its_header(tmp_path, order, data_type, factor):
    path = library(tmp_path, data_type=data_type, order=order, factor=factor)
    found = read_records(path)
    assert [f.name for f in found] == ["red tile", "grey tile"]
    assert np.allclose(found[1].values, RHO * 2, rtol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        spy = spectral.open_image(str(tmp_path / "lib.hdr"))
    assert np.allclose([f.values * float(factor or 1) for f in found], spy.spectra, rtol=1e-6)
    assert np.allclose(found[0].wavelength_nm, np.array(spy.bands.centers) * 1000)
    path.rename(tmp_path / "LIB.SLI")
    path.with_suffix(".hdr").rename(tmp_path / "LIB.HDR")
    for name in ("LIB.SLI", "LIB.HDR"):
        assert np.array_equal([r.values for r in read_records(tmp_path / name)], [r.values for r in found])


def test_what_the_header_of_a_library_says(tmp_path):
    path = library(tmp_path)
    header, raw = path.with_suffix(".hdr"), path.read_bytes()
    good, plain = header.read_text(), read_records(path)
    for old, new, message in (
        ("lines = 2", "lines = 3", "expected: 48 bytes"), ("{red tile, grey tile}", "{red tile}", "1 names for 2 spec"),
        ("{0.4, 0.5, 0.6, 0.7}", "{0.4, 0.5}", "2 wavelengths for 4 channels"),
        ("Spectral Library", "Standard", "expected: ENVI Spectral Library"),
    ):  # fmt: skip
        header.write_text(good.replace(old, new))
        with pytest.raises(InputError, match=message):
            read_records(path)
    header.write_text(good.replace("Micrometers", "Unknown"))
    assert any("can only be um" in note for note in read_records(path)[0].notes)
    path.write_bytes(bytes(12) + raw)
    header.write_text("\ufeff" + good.replace("header offset = 0", "header offset = 12"), "utf-8")
    assert np.array_equal([s.values for s in read_records(path)], [s.values for s in plain])
    values = np.stack([RHO, RHO * 2]).astype("<f4")
    values[:, 1] = -9999
    path.write_bytes(values.tobytes())
    for entry in ("data ignore value = -9999", "bbl = {1, 0, 1, 1}"):
        header.write_text(f"{good}{entry}\n")
        for found, rho in zip(read_records(path), (RHO, RHO * 2), strict=True):
            assert found.wavelength_nm.tolist() == [400.0, 600.0, 700.0]
            assert np.allclose(found.values, rho[[0, 2, 3]])
            assert "1 channels without a value left out" in found.notes


def test_the_wavelengths_of_a_usgs_spectrum_are_named_or_those_beside_it(tmp_path):
    """As splib07 is distributed: folders of spectra, and above them the wavelengths of each spectrometer."""
    inner = tmp_path / "ChapterM_Minerals"
    inner.mkdir()
    text = " s07_AV14 Record=77: Actinolite HS116.1B ASDFRb AREF\n" + rows(RHO).replace("0.1\n", "-1.23e34\n")
    head = " s07_AV14 Record=1: Wavelengths AVIRIS 2014 in micrometers\n"
    (tmp_path / "s07_AV14_Wavelengths.txt").write_text(head + rows(WAVE / 1000))
    (tmp_path / "s07_other_Wavelengths.txt").write_text(head + rows(WAVE[:3] / 1000))
    for options in ({}, {"wavelengths": tmp_path / "s07_AV14_Wavelengths.txt"}):
        found = read(inner, text, "s07_AV14_Actinolite.txt", **options)
        assert found.name == "Actinolite HS116.1B ASDFRb AREF"
        assert np.allclose(found.wavelength_nm, WAVE[[0, 2, 3]])  # the deleted channel is left out
        assert np.allclose(found.values, RHO[[0, 2, 3]])
        noted = "wavelengths from s07_AV14_Wavelengths.txt, which lies beside it" in found.notes
        assert noted == (not options)
    with pytest.raises(InputError, match="one column of 3 rows"):
        read(inner, text, "s07_AV14_Actinolite.txt", wavelengths=tmp_path / "s07_other_Wavelengths.txt")
    (inner / "second_wavelengths.txt").write_text(head + rows(WAVE / 1000))  # two would fit: none is taken
    with pytest.raises(InputError, match="single column"):
        read_spectrum(inner / "s07_AV14_Actinolite.txt")


def test_specpr(tmp_path):
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
        (lambda raw: raw.pop(), "records of 1536 bytes"), (set_word(8, 100, 999), "has its wavelengths in record 999"),
        (set_word(1, 80, 699), "has its wavelengths in record 1, which holds none for 700"),
        (set_word(9, 0, 0), "(?s)expected: 2 continuations"),
        (lambda raw: raw.__delitem__(slice(1536, None)), "holds no spectrum"),
    ],
)  # fmt: skip
def test_specpr_files_that_are_damaged(tmp_path, harm, message):
    (tmp_path / "splib").write_bytes(specpr(harm))
    with pytest.raises(InputError, match=message):
        read_records(tmp_path / "splib")
