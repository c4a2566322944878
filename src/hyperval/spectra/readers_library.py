"""ENVI spectral libraries (.sli, .lib with .hdr)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hyperval.envi_header import EnviHeader, read_header
from hyperval.errors import InputError, UsageError
from hyperval.paths import checked_file
from hyperval.spectra.readers_record import MAX_BYTES, Record

_SUFFIXES = (".sli", ".lib", ".img", "", ".SLI", ".LIB", ".IMG")


def library_header(path: Path) -> EnviHeader | None:
    """The header beside a library data file, None when there is none."""
    ends = (".hdr", ".HDR")
    for candidate in (*(path.with_name(path.name + end) for end in ends), *(path.with_suffix(end) for end in ends)):
        if candidate.is_file() and candidate != path:
            return read_header(candidate)
    return None


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
        raise InputError(
            f"'reflectance scale factor' is {factor:g}", where=header.where("reflectance scale factor")
        )
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
