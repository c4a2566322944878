"""Libraries of spectra: ENVI (.sli, .lib with .hdr), USGS in files of one column, SPy's and xarray's at hand."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperval.envi_header import EnviHeader, data_beside, read_header
from hyperval.errors import refusal, refuse
from hyperval.paths import checked_file
from hyperval.spectra.record import MAX_BYTES, FieldSpectrum
from hyperval.spectra.text import is_number, number_table, wavelength_unit_in
from hyperval.storage import decoded

if TYPE_CHECKING:
    import xarray as xr
    from spectral.io.envi import SpectralLibrary

MAX_WAVELENGTH_FILES = 40  # that are looked into


def envi_library(path: Path, header: EnviHeader | None, root: Path | None = None) -> list[FieldSpectrum]:
    """Every spectrum of a library; ``path`` is the header when ``header`` is None, else the data file.

    Raises
    ------
    InputError : not a spectral library, a data file of the wrong size, or names or wavelengths that do not fit.
    """
    if header is None:
        header, path = read_header(path), data_beside(path)
    path = checked_file(path, root=root, what="spectral library")
    checked_file(header.path, root=root, what="ENVI header")
    lines, channels, size = header.lines, header.samples, path.stat().st_size
    other = header.file_type.lower() != "envi spectral library" or header.bands != 1
    refuse(other, "library.type", header.where("file type"), type=header.file_type, bands=header.bands)
    whole, most = header.expected_bytes, MAX_BYTES
    wrong = size != whole or size > most
    refuse(wrong, "library.size", path, size=size, lines=lines, channels=channels, whole=whole, most=most)
    listed = header.numbers("wavelength")
    wavelength = np.array([]) if listed is None else listed
    unlike = wavelength.size != channels
    refuse(unlike, "library.wavelengths", header.where("wavelength"), count=wavelength.size, channels=channels)
    names = header.strings("spectra names") or tuple(f"spectrum {i + 1}" for i in range(lines))
    refuse(len(names) != lines, "library.names", header.where("spectra names"), count=len(names), lines=lines)
    values = np.fromfile(path, header.dtype, offset=header.header_offset).reshape(lines, channels).astype(float)
    # An ignore value and a list of bad bands both say that channels hold no value.
    ignore, flags = header.number("data ignore value"), header.numbers("bbl", channels)
    empty = np.zeros(values.shape, bool) if ignore is None else values == ignore
    if flags is not None:
        empty |= flags == 0.0
    key, factor = "reflectance scale factor", header.number("reflectance scale factor")
    absurd = factor is not None and not (np.isfinite(factor) and factor > 0)
    refuse(absurd, "library.scale", header.where(key), key=key, factor=factor or 0.0)
    # A factor of 1 is what ENVI writes when nobody told it: it states nothing.
    scale = f"scaled:{factor!r}" if factor not in (None, 1.0) else None
    return _records(names, wavelength, np.where(empty, np.nan, values), path, header.text("wavelength units"), scale)


def library_at_hand(library: Any) -> list[FieldSpectrum]:
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
        raise refusal("library.object", type=type(library).__name__)
    return _records(names, wavelength, rows, "library at hand", None if unit is None else str(unit))


def _records(
    names: Iterable[Any], wavelength: Any, rows: Any, where: object, unit: str | None, scale: str | None = None
) -> list[FieldSpectrum]:
    """Spectra (spectrum, channel) on one set of wavelengths."""
    named = zip(names, np.asarray(rows, float), strict=True)
    record = FieldSpectrum(
        "", np.asarray(wavelength, float), np.array([]), source=str(where), wavelength_unit=unit, unit=scale
    )
    return [replace(record, name=str(name), values=row) for name, row in named]


def usgs_record(path: Path, grid: Path, beside: bool) -> FieldSpectrum:
    """A spectrum of a library that keeps values and wavelengths in files of one column each.

    ``beside`` says that the wavelengths were found in the folder, and not named.
    """
    header, values, _ = number_table(decoded(path.read_bytes()), path)
    grid_header, wavelength, _ = number_table(decoded(grid.read_bytes()), grid)
    unlike, (rows, columns) = values.shape[1] != 1 or wavelength.shape != values.shape, values.shape
    refuse(unlike, "library.rows", path, rows=rows, columns=columns, wanted=len(wavelength), grid=grid)
    name = re.search(r"Record\s*=\s*[0-9]+\s*:\s*(\S.*)", "\n".join(header))
    unit = wavelength_unit_in(" ".join(grid_header), "", str(grid))
    note = (f"wavelengths from {grid.name}, which lies beside it",) if beside else ()
    record = FieldSpectrum(name[1].strip() if name else path.stem, wavelength[:, 0], values[:, 0], source=str(path))
    return replace(record, wavelength_unit=unit, notes=note)


def wavelengths_beside(path: Path) -> Path | None:
    """The file of wavelengths of a USGS spectrum of one column, in its folder or the one above."""
    rows, fits = _usgs_rows(path), list[Path]()
    for folder in (path.parent, path.parent.parent) if rows else ():
        named = [p for p in sorted(folder.glob("*.txt")) if "wavelength" in p.name.lower() and p != path]
        fits += [p for p in named[:MAX_WAVELENGTH_FILES] if _usgs_rows(p) == rows]
    return fits[0] if len(fits) == 1 else None


def _usgs_rows(path: Path) -> int | None:
    """How many numbers a USGS file of one column holds below "Record=NUMBER: TITLE"; None for another file."""
    if path.suffix.lower() != ".txt" or path.stat().st_size > MAX_BYTES:
        return None
    first, *rest = decoded(path.read_bytes()).split("\n")
    rows = [line.strip() for line in rest if line.strip()]
    titled = re.search(r"\bRecord\s*=\s*[0-9]+\s*:", first)
    return len(rows) if titled and rows and all(map(is_number, rows)) else None


def library_to_spy(spectra: Sequence[FieldSpectrum]) -> SpectralLibrary:
    """Spectra on one set of wavelengths as a library of SPy; :func:`hyperval.spectra.read_records` takes it back.

    Raises
    ------
    UsageError : no spectrum, or different wavelengths.
    """
    from spectral.io.envi import SpectralLibrary  # with xarray 70 MB, which most runs need not

    nm, names, values = _on_one_set(spectra)
    return SpectralLibrary(values, {"wavelength": nm.tolist(), "wavelength units": "nm", "spectra names": names})


def library_to_xarray(spectra: Sequence[FieldSpectrum]) -> xr.DataArray:
    """Spectra on one set of wavelengths as an array (spectrum, wavelength); UsageError as for SPy."""
    import xarray as xr

    nm, names, values = _on_one_set(spectra)
    coords = {"spectrum": names, "wavelength": ("wavelength", nm, {"units": "nm"})}
    return xr.DataArray(values, dims=("spectrum", "wavelength"), coords=coords, name=spectra[0].quantity)


def _on_one_set(spectra: Sequence[FieldSpectrum]) -> tuple[np.ndarray, list[str], np.ndarray]:
    unlike = not spectra or any(not np.array_equal(s.wavelength_nm, spectra[0].wavelength_nm) for s in spectra)
    refuse(unlike, "library.unlike")
    return spectra[0].wavelength_nm, [s.name for s in spectra], np.stack([s.values for s in spectra])
