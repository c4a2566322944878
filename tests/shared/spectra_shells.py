"""Small files of spectra in the layouts of their providers: SPECPR and HYPERNETS."""

import struct
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from hyperval.spectra import FieldSpectrum, read_spectrum

WAVE = np.array([400.0, 500.0, 600.0, 700.0])
RHO = np.array([0.05, 0.1, 0.2, 0.4])
NM = np.arange(400.0, 461.0, 2.0)
# Eight channels correlated by 0.9, the rest by 0.3: to two decimals it has no negative eigenvalue.
CORRELATION = np.where(np.equal.outer(NM < 416.0, NM < 416.0), 0.9, 0.3) + 0.1 * np.eye(NM.size)


def specpr_record(flags: int, title: str, values: np.ndarray, **words: int) -> bytes:
    """The first record of a SPECPR spectrum and its continuations, as the format's description has them."""
    raw = bytearray(1536)
    raw[:4] = struct.pack(">i", flags)
    raw[4:44] = title.encode().ljust(40)
    places = {"itchan": 80, "irwav": 100, "irespt": 104}
    for name, word in (("itchan", values.size), *words.items()):
        struct.pack_into(">i", raw, places[name], word)
    data = values.astype(">f4").tobytes()
    raw[512:1536] = data[:1024].ljust(1024, b"\0")
    out = bytes(raw)
    for at in range(1024, len(data), 1532):
        out += struct.pack(">i", flags | 1) + data[at : at + 1532].ljust(1532, b"\0")
    return out


def specpr(harm: Callable[[bytearray], None] = lambda raw: None) -> bytes:
    """Wavelengths (3 records), widths, a text, a spectrum with errors, one without: records 1, 4, 7, 8, 11, 14."""
    grid = np.linspace(0.35, 2.5, 700)
    text = struct.pack(">i", 2) + b"A description".ljust(1532)
    rho = np.linspace(0.1, 0.6, 700)
    rho[5] = -1.23e34
    parts = [b"SPECPR_MAGIC".ljust(1536, b"\0"), specpr_record(0, "Wavelengths in microns", grid)]
    parts += [specpr_record(0, "Bandpass (FWHM)", np.full(700, 0.01)), text]
    parts += [specpr_record(8, "Actinolite HS22.3B", rho, irwav=1, irespt=4)]
    parts += [specpr_record(0, "errors to previous data", np.full(700, 0.02), irwav=1)]
    parts += [specpr_record(0, "Alunite GDS84", rho + 0.1, irwav=1, irespt=4)]
    raw = bytearray(b"".join(parts))
    harm(raw)
    return bytes(raw)


def hypernets(path: Path, **changes: np.ndarray | None) -> Path:
    """A file of two series with the layout of the network."""
    values = {
        "wavelength": NM,
        "reflectance": np.stack([np.full(NM.size, 0.2), np.linspace(0.2, 0.4, NM.size)], axis=1),
        "std_reflectance": np.full((NM.size, 2), 0.003),
        "u_rel_random_reflectance": np.full((NM.size, 2), 1.0),
        "u_rel_systematic_reflectance": np.full((NM.size, 2), 3.0),
        "err_corr_systematic_reflectance": CORRELATION,
        "viewing_zenith_angle": np.array([30.0, 0.0]),
        "viewing_azimuth_angle": np.array([263.0, 98.0]),
        "quality_flag": np.array([0, 16]),
        "n_valid_scans": np.array([10, 12]),
        **changes,
    }
    with h5py.File(path, "w") as file:
        file.attrs["processor_name"] = "hypernets_processor"
        for name, array in values.items():
            if array is not None:
                file[name] = array
        file["wavelength"].make_scale("wavelength")
        series = file.create_dataset("series", data=np.arange(2.0))
        series.make_scale("series")
        for name, array in values.items():
            if name == "wavelength" or array is None:
                continue
            for i, size in enumerate(array.shape):
                file[name].dims[i].attach_scale(file["wavelength"] if size == NM.size else series)
    return path


STATE = "P:\t900\t901\nT:\t290.5\t291.5\nWV:\t0.5\t0.6\nO3:\t280\t281\nAOD:\t0.1\t0.2\nAng:\t1.1\t9997\n"
RADCALNET_ERRORS = STATE.replace("9997", "0.1") + "400\t0.01\t0.02\n410\t9998\t0.03\n420\t0.02\t0.02\n"
# A day of two half hours, of which the second lacks its Angstrom exponent.
RADCALNET = (
    "Site:\tXXXX01\nLat:\t40.5\nLon:\t-109.5\nAlt:\t1270\n\nYear:\t2020\t2020\t\nDOY(U):\t60\t60\t\n"
    "UTC:\t03:30\t04:00\nDOY(L):\t60\t60\t\nLocal:\t11:30\t12:00\n"
    f"{STATE}Type:\tR\tR\n400\t0.10\t0.20\t\n410\t  9998\t0.21\n420\t0.12\t0.22\n\n{RADCALNET_ERRORS}"
)


def rows(*columns, sep: str = ",", end: str = "\n") -> str:
    """Columns of numbers or words as lines of text."""
    text = lambda v: v if isinstance(v, str) else f"{v:g}"  # noqa: E731
    return "".join(sep.join(map(text, row)) + end for row in zip(*columns, strict=True))


def read(folder: Path, content: str | bytes, name: str = "s.txt", **options) -> FieldSpectrum:
    """The spectrum of a file of this content."""
    (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return read_spectrum(folder / name, **options)


SVC = (
    "/*** Spectra Vista SIG Data ***/\r\nname= plank_1.sig\r\ninstrument= HI: 1 (HR-1024i)\r\n"
    "units= Radiance, Radiance\r\ncomm= \r\ndata= \r\n"
)
SED = (
    "Comment:\r\nVersion: 2.0\r\nInstrument: PSR-3500\r\nMeasurement: REFLECTANCE\r\nColumns [4]:\r\nData:\r\n"
    "Wvl\tNorm. DN (Ref.)\tNorm. DN (Target)\t{}\r\n"
)


def asd(
    stored: np.ndarray | None = None,
    white: np.ndarray | None = None,
    *,
    kind: int = 1,
    version: bytes = b"as7",
    reference: bool = True,
    code: int = 2,
    first: float = 400.0,
    step: float = 100.0,
    words: bytes = b"",
    settings: tuple[tuple[str, int, tuple[float, ...]], ...] = (),
    behind: bytes = b"",
) -> bytes:
    """An ASD file: a header with these settings, the stored spectrum, its white reference, and what stands behind."""
    white = np.array([1000.0, 2000, 3000, 4000]) if white is None else white
    stored = np.array([0.05, 0.1, 0.2, 0.4]) * white if stored is None else stored
    head = bytearray(484)
    head[:3] = version
    head[186], head[199] = kind, code
    for form, at, values in (("<2f", 191, (first, step)), ("<H", 204, (stored.size,)), *settings):
        struct.pack_into(form, head, at, *values)
    dtype = {0: "<f4", 1: "<i4", 2: "<f8"}[code]
    block = struct.pack("<H", 0xFFFF if reference else 0) + b"\0" * 16 + struct.pack("<H", len(words)) + words
    return bytes(head) + stored.astype(dtype).tobytes() + block + white.astype(dtype).tobytes() + behind
