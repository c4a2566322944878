"""ASD files (counts over the white reference, or calibrated), libraries of ENVI and SPECPR, columns beside columns."""

import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import spectral
from spectra_shells import RHO, WAVE, asd, read, rows, specpr

from hyperval.errors import InputError, UsageError
from hyperval.spectra import read_records, read_spectrum

WHITE = 1000.0 * np.sin(np.linspace(0.1, 3.0, 400))


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
    behind += b"".join(v.astype("<f8").tobytes() for *_, v in listed)
    settings = (("<L", 390, (68,)), ("<h", 394, (optic,)), ("<2H", 436, gains), ("<2f", 444, (1000.0, 1200.0)))
    header = {"kind": kind, "version": version, "reference": False, "first": 800.0, "settings": settings}
    return asd(stored, np.ones(8), behind=behind, **header)


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
    unit = "uW cm-2 sr-1 nm-1" if quantity == "radiance" else "uW cm-2 nm-1"
    with pytest.raises(UsageError, match=f"states {quantity} in W m-2"):
        read(tmp_path, raw, "a.asd", quantity=quantity, unit=unit)


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


def library(folder: Path, *, data_type: int = 4, order: int = 0, factor: str = "") -> Path:
    """An ENVI library of two spectra; the header of what it says, and the data in that form."""
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
        ("{0.4, 0.5, 0.6, 0.7}", "{0.4, 0.5}", "'wavelength' has 2 values for 4 bands"),
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
    values[:, 1] = -9999.9
    path.write_bytes(values.tobytes())
    for entry in ("data ignore value = -9999.9", "bbl = {1, 0, 1, 1}"):
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
        assert np.allclose([found.values, read_records(inner / "s07_AV14_Actinolite.txt")[0].values], RHO[[0, 2, 3]])
        assert ("wavelengths from s07_AV14_Wavelengths.txt, which lies beside it" in found.notes) == (not options)
    with pytest.raises(InputError, match="holds error bars, not reflectance"):
        read(inner, text.replace("Actinolite HS116.1B", "error bars"), "s07_AV14_Actinolite_errors.txt")
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
    assert np.allclose(first.standard_deviation, 0.02)
    assert second.standard_deviation is None
    assert read_spectrum(tmp_path / "splib", record="Alunite").values[0] == pytest.approx(0.2)


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
