"""Field spectra and library spectra, from the files of the usual instruments and programs.

The format is known from the content of a file.  Units are taken from the file or from the caller
and never guessed; where detectors overlap, each join is cut in its middle.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperval.envi_header import header_beside
from hyperval.errors import package_table, reader, refusal, refuse
from hyperval.paths import checked_file, refuse_own
from hyperval.spectra import binary, networks, text
from hyperval.spectra.record import FieldSpectrum, SpectraFile, finished, mean_of

if TYPE_CHECKING:
    import xarray as xr
    from spectral.io.envi import SpectralLibrary

# Beginnings of files that are known and not read.
_NOT_READ = {mark.encode("latin-1"): name for mark, name in package_table("spectra/words.yaml")["not_read"].items()}


@reader
def read_spectrum(
    path: Path | str,
    *,
    record: str | int | None = None,
    quantity: str = "reflectance",
    wavelength_unit: str | None = None,
    reflectance_unit: str | None = None,
    unit: str | None = None,
    unit_if_unstated: str | None = None,
    columns: tuple[str | int, ...] | None = None,
    wavelengths: Path | str | None = None,
) -> FieldSpectrum:
    """Read one spectrum.

    Parameters
    ----------
    path : text or CSV (a spectrum a column, or a row), ENVI ASCII plot, ECOSTRESS text, ENVI spectral library (data
        or header), SVC or GER .sig, Spectral Evolution .sed, ASD binary, SPECPR
    record : which spectrum of a file with several: its name, a part that only one name has, its number
        from 0, or "mean" for mean, standard deviation and number of all
    quantity : "reflectance" (values are handed out as fractions), "radiance" (uW cm-2 sr-1 nm-1), "irradiance"
        (uW cm-2 nm-1) or "other" (as in the file)
    wavelength_unit : nm or um where the file states none; must agree with the file otherwise
    reflectance_unit : "fraction", "percent" or "scaled:F" (divided by F) where the file states none
    unit : unit of a radiance or irradiance, where the file states none; must agree with the file otherwise
    unit_if_unstated : taken where neither the file nor ``unit`` states one
    columns : (wavelength, value) or (wavelength, value, standard deviation) of a text file, by name or
        by number from 0
    wavelengths : the file of wavelengths of a library that keeps one column per file (USGS); None: one of as many
        rows whose name says wavelength, in the same folder or the one above

    Raises
    ------
    InputError : missing, too large (10 MB, 100,000 rows), not understood, or implausible values.
    UsageError : a unit that nobody states, an unknown record, or one of several not chosen.
    """
    path = checked_file(path, what="spectrum file")
    chosen = _chosen(_records(SpectraFile(path, columns, quantity, wavelengths)), record, str(path))
    return finished(chosen, quantity, wavelength_unit, reflectance_unit, unit, unit_if_unstated)


@reader
def read_records(
    path: Path | str | Any,
    *,
    records: Sequence[str | int] | None = None,
    quantity: str = "reflectance",
    wavelength_unit: str | None = None,
    reflectance_unit: str | None = None,
    unit: str | None = None,
) -> list[FieldSpectrum]:
    """Read the spectra of a file, by the rules of :func:`read_spectrum`.

    ``records`` are the names, or numbers from 0, of those wanted; other names are passed over.  In place of a path
    stands a library of SPy, or an array of xarray (spectrum, wavelength).

    Raises
    ------
    InputError : as for :func:`read_spectrum`.
    UsageError : the same, and numbers that the file does not have.
    """
    if isinstance(path, Path | str):
        listed = _records(SpectraFile(checked_file(path, what="spectrum file"), None, quantity))
    else:
        listed = _at_hand(path)
    numbers = {w for w in records or () if isinstance(w, int)}
    for number in (number for number in numbers if not 0 <= number < len(listed)):
        raise refusal("record.number", listed[0].source if listed else "library", number=number, last=len(listed) - 1)
    wanted = listed if records is None else [r for i, r in enumerate(listed) if i in numbers or r.name in records]
    return [finished(record, quantity, wavelength_unit, reflectance_unit, unit) for record in wanted]


def _at_hand(library: Any) -> list[FieldSpectrum]:
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
    return binary.on_one_grid(names, wavelength, rows, "library at hand", None if unit is None else str(unit))


def _refused(file: SpectraFile) -> list[FieldSpectrum]:
    """Raise InputError for a format that is known and not read, with how to get at its numbers."""
    name = next(name for mark, name in _NOT_READ.items() if file.head.startswith(mark))
    raise refusal("record.format", file.path, name=name, known=file.formats)


def _begins(*marks: bytes) -> Callable[[SpectraFile], bool]:
    return lambda file: file.head.startswith(marks)


_HDF5 = _begins(b"\x89HDF\r\n\x1a\n")
# Formats of spectra: name, how a file of it is known, and what reads its records.  The first that knows a file reads
# it: marks before tables, and text that anything can be at the end.
FORMATS: tuple[tuple[str, Callable[[SpectraFile], object], Callable[[SpectraFile], list[FieldSpectrum]]], ...] = (
    ("SPECPR", lambda f: np.fromfile(f.path, "S12", 1).tolist() == [binary.MARK], binary.specpr_records),
    ("ASD", binary.is_asd, binary.asd_records),
    ("header of an ENVI spectral library", _begins(*binary.HEADERS), binary.library_records),
    ("SVC .sig, GER .sig", _begins(b"/*** Spectra Vista", b"///GER"), text.sig_records),
    ("", _begins(*_NOT_READ), _refused),
    ("HYPERNETS", lambda f: _HDF5(f) and b"hypernets_processor" in f.raw, networks.hypernets_records),
    ("RadCalNet", lambda f: re.match(rb"Site:(?s:.*)\nLat:", f.head), networks.radcalnet_records),
    ("Spectral Evolution .sed", lambda f: b"Instrument:" in f.head and b"Columns [" in f.head, text.sed_records),
    ("ENVI spectral library with its header", lambda f: header_beside(f.path), binary.library_records),
    ("USGS text of one column", lambda f: not f.columns and text.wavelengths_of(f), text.usgs_records),
    ("text, a spectrum a row", lambda f: not f.columns and text.is_row_table(f), text.row_records),
    ("text, a spectrum a column; ENVI ASCII plot", lambda f: True, text.text_records),
)


def _records(file: SpectraFile) -> list[FieldSpectrum]:
    file, path = replace(file, formats=", ".join(name for name, *_ in FORMATS if name)), file.path
    refuse_own(path)
    records = next(read for _, knows, read in FORMATS if knows(file))(file)
    # ..._rdn_... as the producers of images name what they cut out of them: it counts where the file says nothing.
    named = "radiance" if text.quantity_in(path.stem) == "radiance" else ""
    return [replace(r, source=r.source or str(path), quantity=r.quantity or named) for r in records]


def _chosen(records: list[FieldSpectrum], record: str | int | None, where: str) -> FieldSpectrum:
    """The one that is wanted, by name, part of a name or number."""
    names, count = ", ".join(repr(r.name) for r in records[:40]), len(records)
    if record is None:
        pair = count == 2 and all(r.name.startswith("column ") for r in records)
        refuse(count > 1, "record.pair" if pair else "record.several", where, count=count, names=names)
        return records[0]
    if isinstance(record, int):
        refuse(not 0 <= record < count, "record.number", where, number=record, last=count - 1)
        return records[record]
    exact = [r for r in records if r.name == record]
    if not exact and record == "mean":
        return mean_of(records)
    matches = exact or [r for r in records if record.lower() in r.name.lower()]
    refuse(len(matches) != 1, "record.unlike", where, count=len(matches) or "no", record=record, names=names)
    return matches[0]


def library_to_xarray(spectra: Sequence[FieldSpectrum]) -> xr.DataArray:
    """Spectra on one set of wavelengths as an array (spectrum, wavelength), which :func:`read_records` takes back.

    Raises
    ------
    UsageError : none, or different wavelengths.
    """
    import xarray as xr  # with SPy 70 MB, which most runs need not

    unlike = not spectra or any(not np.array_equal(s.wavelength_nm, spectra[0].wavelength_nm) for s in spectra)
    refuse(unlike, "library.unlike")
    nm, names = ("wavelength", spectra[0].wavelength_nm, {"units": "nm"}), [s.name for s in spectra]
    coords = {"spectrum": names, "wavelength": nm}
    return xr.DataArray([s.values for s in spectra], coords, ("spectrum", "wavelength"), spectra[0].quantity)


def library_to_spy(spectra: Sequence[FieldSpectrum]) -> SpectralLibrary:
    """The same as a library of SPy."""
    from spectral.io.envi import SpectralLibrary

    array = library_to_xarray(spectra)
    names, nm = (array[name].values.tolist() for name in ("spectrum", "wavelength"))
    return SpectralLibrary(array.values, {"wavelength": nm, "wavelength units": "nm", "spectra names": names})
