"""Tables with one spectrum a row: metadata, then a column for each wavelength (EcoSIS, spectrolab, EMIT)."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError
from hyperval.spectra.readers_record import MAX_ROWS, Record
from hyperval.units import only_wavelength_unit

Array = npt.NDArray[np.float64]
FEWEST_BANDS = 4
MAX_CELLS = 2_000_000
_BEFORE = r"(?:(?:x|r|wl|wvl|wave|wavelength|lambda|refl|reflectance|nm)[_. ]?)?"  # no b: that counts bands
_WAVELENGTH = re.compile(rf"^{_BEFORE}([0-9]+(?:\.[0-9]+)?)[_ ]?(nm|um)?$", re.IGNORECASE)
_FIRST_TITLE = re.compile(r"^\W*(wave|wvl|wl\b|lambda|nm\b)(?!.*units)", re.IGNORECASE)
_NAMES = (
    "name", "sample_name", "sample name", "spectrum", "spectra", "sample", "sample_id", "id", "fname", "names",
)  # fmt: skip


def is_row_table(text: str) -> bool:
    """Whether the first line has wavelengths as titles of its last columns, behind others or at once."""
    first, _, rest = text.partition("\n")
    delimiter = _delimiter(first)
    titles = next(csv.reader(io.StringIO(first, newline=""), delimiter=delimiter), [])
    if _first_band(titles) is None:
        return False
    # Numbers under "wavelength" are wavelengths, and the other columns spectra that go by a number.
    return not (_FIRST_TITLE.match(titles[0]) and _is_number(rest.split(delimiter, 1)[0].strip(' "')))


def _delimiter(line: str) -> str:
    """What divides the cells of a line: of tabulator, semicolon and comma the most frequent."""
    return max("\t;,", key=line.count)


def row_records(text: str, path: Path) -> list[Record]:
    """The spectra of a table with one in each row.

    A name comes from the first column of an obvious title whose values differ, else the spectra are numbered.  The
    columns ``Wavelength Units`` and ``Measurement Units`` are read where they stand; a percent that the values
    contradict is not believed, and the unit must be stated.

    Raises
    ------
    InputError : rows of another length than the first, cells that are no numbers, or more than can be a table.
    """
    delimiter = _delimiter(text.split("\n", 1)[0])
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    try:
        titles = _without_end([t.strip() for t in next(reader)])
        first = _first_band(titles) or 0
        rows: list[tuple[int, list[str]]] = []
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            where = f"{path}:{reader.line_num}"
            cells = _without_end([cell.strip() for cell in cells], len(titles))
            if delimiter != ",":
                cells[first:] = [cell.replace(",", ".") for cell in cells[first:]]
            if len(cells) != len(titles):
                raise InputError(
                    f"{len(cells)} cells", where=where, expected=f"{len(titles)}, as in the first line"
                )
            rows.append((reader.line_num, cells))
            if len(rows) > MAX_ROWS or len(rows) * len(titles) > MAX_CELLS:
                raise InputError(f"more than {MAX_ROWS} rows or {MAX_CELLS} cells", where=where)
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}", where=f"{path}:{reader.line_num}") from error
    if not rows:
        raise InputError("the table has titles and no spectrum", where=str(path))
    lower = [t.lower() for t in titles[:first]]
    column = next((c for n in _NAMES if n in lower and _differ(rows, c := lower.index(n))), None)
    return [
        replace(
            _record(dict(zip(lower, cells, strict=False)), titles[first:], cells[first:], f"{path}:{number}"),
            name=cells[column] if column is not None else f"row {i}",
        )
        for i, (number, cells) in enumerate(rows, start=1)
    ]


def _record(about: dict[str, str], titles: list[str], cells: list[str], where: str) -> Record:
    """The spectrum of a row by the titles of its bands, and what the columns before them say of it."""
    try:
        values = np.array([float(c) if c and c.lower() not in ("na", "nan") else np.nan for c in cells])
    except ValueError:
        bad = next(t for t, c in zip(titles, cells, strict=True) if not _is_number(c))
        raise InputError(f"the cell under {bad!r} is no number", where=where) from None
    suffix = _WAVELENGTH.match(titles[0])
    unit = (suffix[2] if suffix else None) or _wavelength_unit(about.get("wavelength units", "").lower())
    percent, doubt = "percent" in about.get("measurement units", "").lower(), None
    if percent and np.nanmax(values, initial=0.0) <= 1.5:
        percent = False
        doubt = f"the file says percent, and the values reach {np.nanmax(values):.3g}"
    return Record(
        "", _wavelengths(titles), values, where,
        wavelength_unit=unit, reflectance_unit="percent" if percent else None, doubt=doubt,
    )  # fmt: skip


def _wavelengths(titles: list[str]) -> Array:
    """The numbers in titles that are wavelengths."""
    return np.array([float(_WAVELENGTH.match(t.strip())[1]) for t in titles])  # type: ignore[index]


def _first_band(titles: list[str]) -> int | None:
    """Where the titles become wavelengths that increase or fall to the end; None where they do not."""
    titles = _without_end(titles)
    first = len(titles)
    while first and _WAVELENGTH.match(titles[first - 1].strip()):
        first -= 1
    numbers = _wavelengths(titles[first:])
    if numbers.size < FEWEST_BANDS or only_wavelength_unit(numbers) is None:
        return None
    step = np.diff(numbers)
    return first if np.all(step > 0) or np.all(step < 0) else None


def _without_end(cells: list[str], least: int = 0) -> list[str]:
    """The cells without empty ones at the end, which a comma before the end of a line leaves."""
    while len(cells) > least and not cells[-1].strip():
        cells = cells[:-1]
    return cells


def _differ(rows: list[tuple[int, list[str]]], column: int) -> bool:
    values = [cells[column] for _, cells in rows]
    return all(values) and len(set(values)) == len(values)


def _wavelength_unit(text: str) -> str | None:
    if text.startswith("nano") or text == "nm":
        return "nm"
    return "um" if text.startswith("micro") or text in ("um", "µm") else None


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return cell.lower() == "na"
    return True
