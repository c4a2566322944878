"""Field spectra and library spectra, from the files of the usual instruments and programs.

The format is known from the content of a file.  Units are taken from the file or from the caller
and never guessed; where detectors overlap, each join is cut in its middle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from hyperval.envi_header import EnviHeader, header_beside, read_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.paths import checked_file
from hyperval.spectra import binary, networks, text
from hyperval.spectra.readers_record import MAX_BYTES, Asked, FieldSpectrum, Record, finished, mean_of
from hyperval.storage import decoded

# Printable characters of any 8-bit code, tabulators, ends of lines and pages.
_TEXT = bytes([9, 10, 11, 12, 13, *range(32, 127), *range(128, 256)])

# Beginnings of files that are known and not read.
_NOT_READ = {
    b"##TITLE": "JCAMP-DX", b"PE UV": "a PerkinElmer file", b"PE IR": "a PerkinElmer file",
    b"PEPE": "a PerkinElmer file", b"PK\x03\x04": "a spreadsheet or zip file",
    b"\xd0\xcf\x11\xe0": "an old spreadsheet", b"MATLAB": "a MATLAB file", b"\x93NUMPY": "a NumPy file",
    b"{": "JSON", b"<": "XML",
}  # fmt: skip
MAX_WAVELENGTH_FILES = 40  # that are looked into


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
    root: Path | None = None,
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
    root : folder that the files must lie in

    Raises
    ------
    InputError : missing, too large (10 MB, 100,000 rows), not understood, or implausible values.
    UsageError : a unit that nobody states, an unknown record, or one of several not chosen.
    """
    path = checked_file(path, root=root, what="spectrum file")
    beside = _wavelengths_beside(path) if wavelengths is None and columns is None else None
    if wavelengths is None and beside is None:
        chosen = _chosen(_records(path, columns, root, quantity), record, str(path))
    else:
        grid = checked_file(beside or str(wavelengths), root=root, what="wavelength file")
        chosen = text.column_record(decoded(_read(path)), path, decoded(_read(grid)), grid)
        if beside is not None:
            chosen = replace(chosen, notes=(*chosen.notes, f"wavelengths from {beside.name}, which lies beside it"))
    return finished(chosen, Asked(quantity, wavelength_unit, reflectance_unit, unit, unit_if_unstated))


@reader
def read_records(
    path: Path | str | Any,
    *,
    records: Sequence[str | int] | None = None,
    quantity: str = "reflectance",
    wavelength_unit: str | None = None,
    reflectance_unit: str | None = None,
    unit: str | None = None,
    root: Path | None = None,
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
        path = checked_file(path, root=root, what="spectrum file")
        listed = _records(path, None, root, quantity)
    else:
        listed = binary.records_at_hand(path)
    asked = Asked(quantity, wavelength_unit, reflectance_unit, unit)
    return [finished(record, asked) for record in _wanted(listed, records, listed[0].where if listed else "library")]


def _wavelengths_beside(path: Path) -> Path | None:
    """The file of wavelengths of a USGS spectrum of one column, in its folder or the one above."""
    rows = _usgs_rows(path)
    if rows is None:
        return None
    fits = []
    for folder in (path.parent, path.parent.parent):
        named = [p for p in sorted(folder.glob("*.txt")) if "wavelength" in p.name.lower() and p != path]
        fits += [p for p in named[:MAX_WAVELENGTH_FILES] if _usgs_rows(p) == rows]
    return fits[0] if len(fits) == 1 else None


def _usgs_rows(path: Path) -> int | None:
    """Numbers in a file of one column as USGS writes it; None for any other file."""
    if path.suffix.lower() != ".txt" or path.stat().st_size > MAX_BYTES:
        return None
    return text.usgs_rows(decoded(path.read_bytes()))


def _wanted(candidates: list[Record], wanted: Sequence[str | int] | None, where: str) -> list[Record]:
    if wanted is None:
        return candidates
    numbers = {w for w in wanted if isinstance(w, int)}
    if any(not 0 <= w < len(candidates) for w in numbers):
        raise UsageError(f"no record {max(numbers)}", where=where, expected=f"0 to {len(candidates) - 1}")
    return [r for i, r in enumerate(candidates) if i in numbers or r.name in wanted]


@dataclass(frozen=True)
class _File:
    """A file of spectra whose format its content tells.

    ``columns`` and ``quantity`` are what the caller says of it, ``root`` the folder it must lie in.
    """

    path: Path
    columns: tuple[str | int, ...] | None
    root: Path | None
    quantity: str

    @cached_property
    def mark(self) -> bytes:
        """The first bytes of a file of any size."""
        with open(self.path, "rb") as stream:
            return stream.read(len(binary.MARK))

    @cached_property
    def raw(self) -> bytes:
        """The whole file (InputError where it is too large, or empty)."""
        return _read(self.path)

    @cached_property
    def head(self) -> bytes:
        """The beginning of the file, without a byte-order mark."""
        return self.raw[:4096].lstrip(b"\xef\xbb\xbf")

    @cached_property
    def not_read(self) -> str | None:
        """The name of its format where that is known and not read."""
        return next((name for mark, name in _NOT_READ.items() if self.head.startswith(mark)), None)

    @cached_property
    def text(self) -> str:
        """The file as text (InputError where it is none)."""
        raw = without_padding(self.raw) if b"\0" in self.head else self.raw
        if b"\0" in raw[:4096]:
            raise InputError("a binary file of unknown format", where=str(self.path), expected=_expected())
        return decoded(raw)

    @cached_property
    def header(self) -> EnviHeader | None:
        """The ENVI header beside it."""
        beside = header_beside(self.path)
        return None if beside is None else read_header(beside)


@dataclass(frozen=True)
class Format:
    """A format of spectra: how a file of it is known, and how its records are read."""

    name: str
    knows: Callable[[_File], bool]
    records: Callable[[_File], list[Record]]


def _expected() -> str:
    return ", ".join(form.name for form in FORMATS if form.name)


def _refused(file: _File) -> list[Record]:
    """Raise InputError for a format that is known and not read, with how to get at its numbers."""
    raise InputError(
        f"{file.not_read}, which is not read",
        where=str(file.path),
        expected=_expected(),
        mend="save it as text: a wavelength and a value in every row",
    )


def _begins(*marks: bytes) -> Callable[[_File], bool]:
    return lambda file: file.head.startswith(marks)


# The first that knows a file reads it: marks before tables, and text that anything can be at the end.
FORMATS = (
    Format("SPECPR", lambda f: binary.is_specpr(f.mark), lambda f: binary.specpr_records(f.path)),
    Format("ASD", lambda f: binary.is_asd(f.raw), lambda f: [binary.asd_record(f.raw, f.path, f.quantity)]),
    Format("ENVI ASCII plot", _begins(b"ENVI ASCII Plot File"), lambda f: text.plot_records(f.text, f.path)),
    Format(
        "header of an ENVI spectral library", _begins(b"ENVI\r", b"ENVI\n", b"ENVI "),
        lambda f: binary.library_records(f.path, None, f.root),
    ),
    Format("SVC .sig", _begins(b"/*** Spectra Vista"), lambda f: [text.svc_record(f.text, f.path, f.quantity)]),
    Format("GER .sig", _begins(b"///GER"), lambda f: [text.ger_record(f.text, f.path, f.quantity)]),
    Format("", lambda f: f.not_read is not None, _refused),
    Format("HYPERNETS", lambda f: networks.is_hypernets(f.raw), lambda f: networks.hypernets_records(f.path)),
    Format("RadCalNet", lambda f: networks.is_radcalnet(f.head), lambda f: networks.radcalnet_records(f.text, f.path)),
    Format(
        "Spectral Evolution .sed", lambda f: b"Instrument:" in f.head and b"Columns [" in f.head,
        lambda f: [text.sed_record(f.text, f.path, f.quantity)],
    ),
    Format(
        "ENVI spectral library with its header", lambda f: f.header is not None,
        lambda f: binary.library_records(f.path, f.header, f.root),
    ),
    Format(
        "text, a spectrum a row", lambda f: f.columns is None and text.is_row_table(f.text),
        lambda f: text.row_records(f.text, f.path),
    ),
    Format("text, a spectrum a column", lambda f: True, lambda f: text.text_records(f.text, f.path, f.columns)),
)  # fmt: skip


def _records(path: Path, columns: tuple[str | int, ...] | None, root: Path | None, quantity: str) -> list[Record]:
    file = _File(path, columns, root, quantity)
    records = next(form for form in FORMATS if form.knows(file)).records(file)
    if text.quantity_in(path.stem) != "radiance":
        return records
    # ..._rdn_... as the producers of images name what they cut out of them: it counts where the file says nothing.
    return [replace(r, quantity=r.quantity or "radiance") for r in records]


def _read(path: Path) -> bytes:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise InputError(f"{size} bytes", where=str(path), expected=f"a spectrum file of at most {MAX_BYTES} bytes")
    raw = path.read_bytes()
    if not raw.strip():
        raise InputError("the file is empty", where=str(path))
    return raw


def without_padding(raw: bytes) -> bytes:
    """Text without the NUL that ViewSpec pads a comment with; unchanged where other signs tell a binary file."""
    text = raw.replace(b"\0", b"")
    return raw if text.translate(None, _TEXT) or len(text) < 0.5 * len(raw) else text


def _chosen(records: list[Record], record: str | int | None, where: str) -> Record:
    names = ", ".join(repr(r.name) for r in records[:40])
    if record is None:
        if len(records) > 1:
            pair = len(records) == 2 and all(r.name.startswith("column ") for r in records)
            raise UsageError(
                f"the file holds {len(records)} spectra",
                where=where,
                expected=f"record: one of {names}, or 'mean'",
                mend="where the third column is the standard deviation of the second, write above them what "
                "they are: wavelength, reflectance, sd"
                if pair
                else None,
            )
        return records[0]
    if isinstance(record, int):
        if not 0 <= record < len(records):
            raise UsageError(f"no record {record}", where=where, expected=f"0 to {len(records) - 1}")
        return records[record]
    exact = [r for r in records if r.name == record]
    if not exact and record == "mean":
        return mean_of(records)
    matches = exact or [r for r in records if record.lower() in r.name.lower()]
    if len(matches) != 1:
        what = f"{len(matches)} records match {record!r}" if matches else f"no record {record!r}"
        raise UsageError(what, where=where, expected=f"one of {names}")
    return matches[0]
