"""Field spectra and library spectra, from the files of the usual instruments and programs.

The format is known from the content of a file.  Units are taken from the file or from the caller
and never guessed; where detectors overlap, each join is cut in its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from hyperval.errors import InputError, UsageError, reader
from hyperval.paths import checked_file
from hyperval.spectra import (
    hypernets,
    radcalnet,
    readers_asd,
    readers_instruments,
    readers_library,
    readers_rows,
    readers_specpr,
    readers_text,
)
from hyperval.spectra.readers_record import MAX_BYTES, FieldSpectrum, Record, finished, mean_of

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

__all__ = ["FieldSpectrum", "read_records", "read_spectrum"]


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
        chosen = readers_text.column_record(decoded(_read(path)), path, decoded(_read(grid)), grid)
        if beside is not None:
            chosen = replace(chosen, notes=(*chosen.notes, f"wavelengths from {beside.name}, which lies beside it"))
    return finished(
        chosen,
        quantity=quantity,
        wavelength_unit=wavelength_unit,
        reflectance_unit=reflectance_unit,
        unit=unit,
        unit_if_unstated=unit_if_unstated,
    )


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
        listed = readers_library.records_at_hand(path)
    return [
        finished(
            record,
            quantity=quantity,
            wavelength_unit=wavelength_unit,
            reflectance_unit=reflectance_unit,
            unit=unit,
        )
        for record in _wanted(listed, records, listed[0].where if listed else "library")
    ]


def _wavelengths_beside(path: Path) -> Path | None:
    """The file of wavelengths of a USGS spectrum of one column, in its folder or the one above."""
    if path.suffix.lower() != ".txt" or path.stat().st_size > MAX_BYTES:
        return None
    rows = readers_text.usgs_rows(decoded(path.read_bytes()))
    if rows is None:
        return None
    fits = []
    for folder in (path.parent, path.parent.parent):
        named = [p for p in sorted(folder.glob("*.txt")) if "wavelength" in p.name.lower() and p != path]
        fits += [
            p
            for p in named[:MAX_WAVELENGTH_FILES]
            if p.stat().st_size <= MAX_BYTES and readers_text.usgs_rows(decoded(p.read_bytes())) == rows
        ]
    return fits[0] if len(fits) == 1 else None


def _wanted(candidates: list[Record], wanted: Sequence[str | int] | None, where: str) -> list[Record]:
    if wanted is None:
        return candidates
    numbers = {w for w in wanted if isinstance(w, int)}
    if any(not 0 <= w < len(candidates) for w in numbers):
        raise UsageError(f"no record {max(numbers)}", where=where, expected=f"0 to {len(candidates) - 1}")
    return [r for i, r in enumerate(candidates) if i in numbers or r.name in wanted]


def _records(path: Path, columns: tuple[str | int, ...] | None, root: Path | None, quantity: str) -> list[Record]:
    with open(path, "rb") as stream:
        if readers_specpr.is_specpr(stream.read(len(readers_specpr.MARK))):
            return readers_specpr.specpr_records(path)
    raw = _read(path)
    head = raw[:4096].lstrip(b"\xef\xbb\xbf")
    if readers_asd.is_asd(raw):
        return [readers_asd.asd_record(raw, path, quantity)]
    if head.startswith(b"ENVI ASCII Plot File"):
        return readers_text.plot_records(decoded(raw), path)
    if head.startswith(b"ENVI") and head[4:5] in (b"\r", b"\n", b" "):
        return readers_library.library_records(path, None, root)
    if head.startswith(b"/*** Spectra Vista"):
        return [readers_instruments.svc_record(decoded(raw), path, quantity)]
    if head.startswith(b"///GER"):
        return [readers_instruments.ger_record(decoded(raw), path, quantity)]
    _refuse_others(head, str(path))
    if hypernets.is_hypernets(raw):
        return hypernets.hypernets_records(path)
    if radcalnet.is_radcalnet(head):
        return radcalnet.radcalnet_records(decoded(raw), path)
    if b"Instrument:" in head and b"Columns [" in head:
        return [readers_instruments.sed_record(decoded(raw), path, quantity)]
    # A table may lie beside a cube of the same name, whose header is not its own.
    header = None if path.suffix.lower() in (".txt", ".csv") else readers_library.library_header(path)
    if header is not None:
        return readers_library.library_records(path, header, root)
    if b"\0" in head:
        raw = without_padding(raw)
    if b"\0" in raw[:4096]:
        raise InputError(
            "a binary file of unknown format",
            where=str(path),
            expected="text, ENVI spectral library with its header, ASD, SVC .sig, .sed or HYPERNETS",
        )
    text = decoded(raw)
    if columns is None and readers_rows.is_row_table(text):
        return readers_rows.row_records(text, path)
    return readers_text.text_records(text, path, columns)


def _refuse_others(head: bytes, where: str) -> None:
    """Raise InputError for formats that are known and not read, with how to get at their numbers."""
    other = next((name for mark, name in _NOT_READ.items() if head.startswith(mark)), None)
    if other is not None:
        raise InputError(
            f"{other}, which is not read",
            where=where,
            expected="text, ENVI spectral library with its header, SPECPR, ASD, SVC or GER .sig, .sed or HYPERNETS",
            mend="save it as text: a wavelength and a value in every row",
        )


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


def decoded(raw: bytes) -> str:
    """Text in UTF-8 (with or without mark) or else Latin-1."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _chosen(records: list[Record], record: str | int | None, where: str) -> Record:
    names = ", ".join(repr(r.name) for r in records[:40])
    if record is None:
        if len(records) > 1:
            pair = len(records) == 2 and all(r.name.startswith("column ") for r in records)
            raise UsageError(
                f"the file holds {len(records)} spectra",
                where=where,
                expected=f"record: one of {names}, or 'mean'",
                mend="where the third column is the standard deviation of the second, state columns: [0, 1, 2]"
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
