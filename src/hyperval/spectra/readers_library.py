"""Spectral libraries: of ENVI (.sli, .lib with .hdr), SPECPR, and those of SPy and xarray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hyperval.envi_header import EnviHeader, read_header
from hyperval.errors import InputError, UsageError
from hyperval.paths import checked_file
from hyperval.spectra.readers_record import MAX_BYTES, FieldSpectrum, Record

if TYPE_CHECKING:
    import xarray as xr
    from spectral.io.envi import SpectralLibrary

_SUFFIXES = (".sli", ".lib", ".img", "", ".SLI", ".LIB", ".IMG")
Array = npt.NDArray[np.float64]
MARK = b"SPECPR_MAGIC"
RECORD_BYTES = 1536
MAX_SPECPR_BYTES = 256 << 20
MAX_CHANNELS = 4852  # of the format
_CONTINUATION, _TEXT, _ERRORS = 1, 2, 8
_FIRST, _MORE = 256, 383


def records_at_hand(library: Any) -> list[Record]:
    """The spectra of a library of SPy, or of an array of xarray (spectrum, wavelength).

    Raises
    ------
    UsageError : another kind of object, or one without wavelengths.
    """
    if hasattr(library, "spectra") and hasattr(library, "bands") and library.bands.centers is not None:
        wavelength, rows, names = library.bands.centers, library.spectra, library.names
        unit = library.bands.band_unit
    elif hasattr(library, "coords") and "wavelength" in library.coords and library.ndim == 2:
        ordered = library.transpose(..., "wavelength")
        wavelength, rows = ordered["wavelength"].values, ordered.values
        named = ordered.dims[0] in ordered.coords
        names = ordered[ordered.dims[0]].values if named else [f"spectrum {i + 1}" for i in range(len(rows))]
        unit = ordered["wavelength"].attrs.get("units")
    else:
        raise UsageError(
            f"an object of type {type(library).__name__} without wavelengths",
            expected="a path, a library of SPy (spectral), or an array of xarray (spectrum, wavelength)",
        )
    unit = None if unit in (None, "", "<unspecified>") else str(unit)
    axis = np.asarray(wavelength, float)
    return [
        Record(str(name), axis, np.asarray(row, float), "library at hand", wavelength_unit=unit)
        for name, row in zip(names, rows, strict=True)
    ]


def library_records(path: Path, header: EnviHeader | None, root: Path | None = None) -> list[Record]:
    """Every spectrum of a library; ``path`` is the header when ``header`` is None, else the data file.

    Raises
    ------
    InputError : not a spectral library, a data file of the wrong size, or names or wavelengths that do not fit.
    """
    if header is None:
        header = read_header(path)
        files = [path.with_suffix(end) for end in _SUFFIXES if path.with_suffix(end).is_file()]
        if len(files) != 1:
            raise InputError(f"{len(files)} data files beside the header", where=str(path))
        path = files[0]
    path = checked_file(path, root=root, what="spectral library")
    checked_file(header.path, root=root, what="ENVI header")
    if header.file_type.lower() != "envi spectral library" or header.bands != 1:
        raise InputError(
            f"file type {header.file_type!r} with {header.bands} bands",
            where=header.where("file type"),
            expected="ENVI Spectral Library with one band",
        )
    size = path.stat().st_size
    if size != header.expected_bytes or size > MAX_BYTES:
        raise InputError(
            f"{size} bytes",
            where=str(path),
            expected=f"{header.expected_bytes} bytes ({header.lines} spectra of {header.samples} channels), "
            f"at most {MAX_BYTES}",
        )
    wavelength = header.numbers("wavelength")
    if wavelength is None or wavelength.size != header.samples:
        raise InputError(
            f"{0 if wavelength is None else wavelength.size} wavelengths for {header.samples} channels",
            where=header.where("wavelength"),
        )
    names = header.strings("spectra names") or tuple(f"spectrum {i + 1}" for i in range(header.lines))
    if len(names) != header.lines:
        raise InputError(f"{len(names)} names for {header.lines} spectra", where=header.where("spectra names"))
    stored = np.fromfile(path, header.dtype, offset=header.header_offset).reshape(header.lines, header.samples)
    values = stored.astype(float)
    # An ignore value and a list of bad bands both say that channels hold no value.
    ignore = header.number("data ignore value")
    if ignore is not None:
        values[stored == ignore] = np.nan
    flags = header.numbers("bbl", header.samples)
    if flags is not None:
        values[:, flags == 0.0] = np.nan
    factor = header.number("reflectance scale factor")
    if factor is not None and not (np.isfinite(factor) and factor > 0):
        raise InputError(f"'reflectance scale factor' is {factor:g}", where=header.where("reflectance scale factor"))
    unit = header.text("wavelength units")
    unit = None if unit is None or unit.lower() in ("unknown", "none") else unit
    return [
        Record(
            name=name,
            wavelength=wavelength,
            values=values[i],
            where=str(path),
            wavelength_unit=unit,
            # A factor of 1 is what ENVI writes when nobody told it: it states nothing.
            reflectance_unit=f"scaled:{factor!r}" if factor not in (None, 1.0) else None,
        )
        for i, name in enumerate(names)
    ]


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

    Records have 1536 bytes, big-endian, and begin with 32 bits of flags: bit 0 continuation, bit 1 text, bit 3
    errors in the records that follow.  The first record of a spectrum holds its title at 4, the number of
    channels at 80, the record of its wavelengths at 100 and of its band widths at 104, and 256 values from 512
    on; continuations hold 383 values each from 4 on.  Record 0 begins with a mark.  Wavelengths are in
    micrometres, deleted channels hold -1.23e34.  Source: R. N. Clark, SPECPR format, USGS Open-File Report
    93-595.

    Raises
    ------
    InputError : cut short, too large, records that contradict each other, or no spectrum.
    """
    where = str(path)
    size = path.stat().st_size
    if size % RECORD_BYTES or not RECORD_BYTES <= size <= MAX_SPECPR_BYTES:
        raise InputError(
            f"{size} bytes",
            where=where,
            expected=f"records of {RECORD_BYTES} bytes, at most {MAX_SPECPR_BYTES}",
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


def library_to_spy(spectra: Sequence[FieldSpectrum]) -> SpectralLibrary:
    """Spectra on one set of wavelengths as a library of SPy; :func:`read_records` takes it back.

    Raises
    ------
    UsageError : no spectrum, or different wavelengths.
    """
    from spectral.io.envi import SpectralLibrary  # with xarray 70 MB, which most runs need not

    _check(spectra)
    header = {
        "wavelength": spectra[0].wavelength_nm.tolist(),
        "wavelength units": "nm",
        "spectra names": [s.name for s in spectra],
    }
    return SpectralLibrary(np.stack([s.values for s in spectra]), header)


def library_to_xarray(spectra: Sequence[FieldSpectrum]) -> xr.DataArray:
    """Spectra on one set of wavelengths as an array (spectrum, wavelength); UsageError as for SPy."""
    import xarray as xr

    _check(spectra)
    return xr.DataArray(
        np.stack([s.values for s in spectra]),
        dims=("spectrum", "wavelength"),
        coords={
            "spectrum": [s.name for s in spectra],
            "wavelength": ("wavelength", spectra[0].wavelength_nm, {"units": "nm"}),
        },
        name=spectra[0].quantity,
    )


def _check(spectra: Sequence[FieldSpectrum]) -> None:
    if not spectra or any(not np.array_equal(s.wavelength_nm, spectra[0].wavelength_nm) for s in spectra):
        raise UsageError("a library needs spectra on one set of wavelengths", mend="resample them first")
