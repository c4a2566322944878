"""SPECPR files of the USGS spectral libraries: records of 1536 bytes, big-endian.

A record begins with 32 bits of flags: bit 0 continuation, bit 1 text, bit 3 errors in the records that follow.  The
first record of a spectrum holds its title at 4, the number of channels at 80, the record of its wavelengths at 100
and of its band widths at 104, and 256 values from 512 on; continuations hold 383 values each from 4 on.  Record 0
begins with a mark.  Wavelengths are in micrometres, deleted channels hold -1.23e34.
Source: R. N. Clark, SPECPR format, USGS Open-File Report 93-595.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError
from hyperval.spectra.readers_record import Record

Array = npt.NDArray[np.float64]

MARK = b"SPECPR_MAGIC"
RECORD_BYTES = 1536
MAX_BYTES = 256 << 20
MAX_CHANNELS = 4852  # of the format
_CONTINUATION, _TEXT, _ERRORS = 1, 2, 8
_FIRST, _MORE = 256, 383


@dataclass(frozen=True)
class _Spectrum:
    number: int
    title: str
    channels: int
    wavelength_record: int
    width_record: int
    errors_follow: bool


def is_specpr(head: bytes) -> bool:
    """Whether the content is that of a SPECPR file."""
    return head.startswith(MARK)


def specpr_records(path: Path) -> list[Record]:
    """Every spectrum of a SPECPR file but wavelengths, band widths and errors; the errors go with their spectrum.

    Raises
    ------
    InputError : cut short, too large, records that contradict each other, or no spectrum.
    """
    where = str(path)
    size = path.stat().st_size
    if size % RECORD_BYTES or not RECORD_BYTES <= size <= MAX_BYTES:
        raise InputError(
            f"{size} bytes",
            where=where,
            expected=f"records of {RECORD_BYTES} bytes, at most {MAX_BYTES}",
            mend="copy the file again",
        )
    raw = np.fromfile(path, np.uint8).reshape(-1, RECORD_BYTES)
    flags = raw[:, :4].copy().view(">u4").ravel()
    heads = [_head(raw[i], i) for i in range(1, len(raw)) if not flags[i] & (_CONTINUATION | _TEXT)]
    spectra = [h for h in heads if h.channels > 0]
    by_number = {s.number: s for s in spectra}
    auxiliary = {n for s in spectra for n in (s.wavelength_record, s.width_record) if n > 0}
    auxiliary |= {after.number for s in spectra if s.errors_follow and (after := _after(s, spectra)) is not None}
    out = []
    for spectrum in spectra:
        if spectrum.number in auxiliary or spectrum.wavelength_record <= 0:
            continue
        grid = by_number.get(spectrum.wavelength_record)
        if grid is None or grid.channels != spectrum.channels:
            raise InputError(
                f"record {spectrum.number} ({spectrum.title!r}) has its wavelengths in record "
                f"{spectrum.wavelength_record}, which holds none for {spectrum.channels} channels",
                where=where,
            )
        errors = _after(spectrum, spectra) if spectrum.errors_follow else None
        out.append(
            Record(
                name=spectrum.title,
                wavelength=_values(raw, flags, grid, where),
                values=_values(raw, flags, spectrum, where),
                where=where,
                standard_deviation=_values(raw, flags, errors, where) if errors is not None else None,
                wavelength_unit="um",
                reflectance_unit="fraction",
            )
        )
    if not out:
        raise InputError("the file holds no spectrum with wavelengths", where=where)
    return out


def _head(record: npt.NDArray[np.uint8], number: int) -> _Spectrum:
    title = record[4:44].tobytes().split(b"\0")[0].decode("latin-1").strip()
    words = record[:512].copy().view(">i4")
    return _Spectrum(number, title, int(words[20]), int(words[25]), int(words[26]), bool(int(words[0]) & _ERRORS))


def _after(spectrum: _Spectrum, spectra: list[_Spectrum]) -> _Spectrum | None:
    """The spectrum of as many channels that follows, which holds the errors."""
    follows = next((s for s in spectra if s.number > spectrum.number), None)
    return follows if follows is not None and follows.channels == spectrum.channels else None


def _values(raw: npt.NDArray[np.uint8], flags: npt.NDArray[np.uint32], spectrum: _Spectrum, where: str) -> Array:
    """The channels (n,) of a spectrum from its first record and the continuations behind it."""
    n, at = spectrum.channels, spectrum.number
    more = max(0, -(-(n - _FIRST) // _MORE))
    behind = flags[at + 1 : at + 1 + more]
    if n > MAX_CHANNELS or behind.size != more or not np.all((behind & (_CONTINUATION | _TEXT)) == _CONTINUATION):
        raise InputError(
            f"record {at} ({spectrum.title!r}): {n} channels, and {behind.size} records behind it",
            where=where,
            expected=f"{more} continuations",
            mend="the file is damaged: copy it again",
        )
    parts = [raw[at, 512:].tobytes(), *(raw[i, 4:].tobytes() for i in range(at + 1, at + 1 + more))]
    return np.frombuffer(b"".join(parts), ">f4")[:n].astype(float)
