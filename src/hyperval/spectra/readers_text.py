"""Spectra in text: columns by commas, blanks, tabs or semicolons under any header; ENVI plots; ECOSTRESS."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError
from hyperval.spectra.readers_record import MAX_ROWS, Record

Array = npt.NDArray[np.float64]
MAX_HEADER_LINES = 1000
MAX_COLUMNS = 2000
MAX_TITLE = 1000
_ENDS = 0.02  # of a wavelength: detectors begin and end beside the round numbers that are stated for them

# No part of a pattern may begin in more than one place of what the part before it takes: a line of a million digits
# or blanks would take hours.
_NUMBER = re.compile(r"^[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eEdD][-+]?[0-9]+)?$|^[-+]?(nan|inf)$", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"^[-+]?[0-9]+,[0-9]+$")
_WHOLE = re.compile(r"^[-+]?[0-9]+$")
_END = re.compile(r"^>+\s*End\b")  # of the numbers, in files of Ocean Optics
_UNIT_TITLE = re.compile(r"^(\[.*\]|\(.*\)|nm|[uµμ]m|%|1)?$")
_SPREAD = re.compile(r"stand\w*[ _.]*dev|std|(?<![a-z])sd(?![a-z])|sigma|uncertainty", re.IGNORECASE)
_WAVE = re.compile(r"wave|wvl|lambda", re.IGNORECASE)
_WAVENUMBER = re.compile(r"wave\s*number|cm\s*(\^\s*)?-1", re.IGNORECASE)
_NM = re.compile(r"(?<![a-z])nm(?![a-z])|nanomet", re.IGNORECASE)
_UM = re.compile(r"(?<![a-z])[uµμ]m(?![a-z])|micron|micromet", re.IGNORECASE)


def text_records(text: str, path: Path, columns: tuple[str | int, ...] | None = None) -> list[Record]:
    """Spectra of a text file: the first column is the wavelength, the others values.

    A column whose title says standard deviation belongs to the one before it; a column that repeats the
    wavelengths is left out.  The header may state ``nm`` or ``um``, ``%`` and ``N = 25``.
    """
    header, table, first_line = number_table(text, path)
    titles = _titles(header, table.shape[1])
    where = str(path)
    if columns is None and _is_index(table, titles):
        table, titles = table[:, 1:], titles[1:]
    if columns is not None:
        picked = [_column(c, titles, where) for c in columns]
        if len(picked) not in (2, 3):
            raise UsageError(
                "columns are (wavelength, value) or (wavelength, value, standard deviation)", where=where
            )
        table, titles = table[:, picked], [titles[i] for i in picked]
        spread = {1: 2} if len(picked) == 3 else {}
    else:
        spread = {}
        for i in range(2, len(titles)):
            if _SPREAD.search(titles[i]) and i - 1 not in spread.values():
                spread[i - 1] = i
    unmeasured = {i for i in spread.values() if not table[:, i].any()}
    if table.shape[1] < 2:
        raise InputError(
            "a single column",
            where=f"{path}:{first_line}",
            expected="a wavelength and a value in every row",
            mend="where the wavelengths have a file of their own, name it (wavelengths)",
        )
    whole = "\n".join(header)
    unit = _stated(titles[0], whole)
    if unit is None and _WAVENUMBER.search(titles[0]):
        raise InputError(
            f"wavenumbers: {titles[0]!r}",
            where=where,
            expected="wavelengths in nm or um",
            mend="convert them: a wavelength in nm is 1e7 over the wavenumber in cm-1",
        )
    count = re.search(r"\bN\s*=\s*([0-9]{1,9})\b", whole)
    wavelength = table[:, 0]
    ends = [float(e) for key in ("First", "Last") if _NUMBER.match(e := _entry(whole, f"{key} X Value") or "")]
    count_stated = _entry(whole, "Number of X Values")
    check_stated(wavelength, where, count=count_stated, ends=(ends[0], ends[1]) if len(ends) == 2 else None)
    records = []
    for i in range(1, table.shape[1]):
        if i in spread.values() or (i > 1 and np.array_equal(table[:, i], wavelength)):
            continue
        y_units, name = _entry(whole, "Y Units?"), _entry(whole, "Name")
        records.append(
            Record(
                name=titles[i] or (name or ""),
                wavelength=wavelength,
                values=table[:, i],
                where=where,
                standard_deviation=table[:, spread[i]] if spread.get(i, i) not in {i, *unmeasured} else None,
                notes=("a standard deviation of 0 everywhere is none",) if spread.get(i) in unmeasured else (),
                n=int(count.group(1)) if count else None,
                wavelength_unit=unit,
                reflectance_unit=reflectance_unit_in(y_units or titles[i]),
                quantity=quantity_in(y_units or titles[i]),
                unit=power_unit_in(y_units or titles[i]),
            )
        )
    if len(records) == 1:
        only = records[0]
        records[0] = Record(**{**only.__dict__, "name": path.stem if only.name in ("", *titles) else only.name})
        return records
    return [Record(**{**r.__dict__, "name": r.name or f"column {k + 1}"}) for k, r in enumerate(records)]


def column_record(text: str, path: Path, grid_text: str, grid: Path) -> Record:
    """A spectrum of a library that keeps values and wavelengths in files of one column each."""
    header, values, _ = number_table(text, path)
    grid_header, wavelength, _ = number_table(grid_text, grid)
    if values.shape[1] != 1 or wavelength.shape != values.shape:
        raise InputError(
            f"{values.shape[0]} rows of {values.shape[1]} columns",
            where=str(path),
            expected=f"one column of {len(wavelength)} rows, as in {grid}",
        )
    name = re.search(r"Record\s*=\s*[0-9]+\s*:\s*(\S.*)", "\n".join(header))
    return Record(
        name=name.group(1).strip() if name else path.stem,
        wavelength=wavelength[:, 0],
        values=values[:, 0],
        where=str(path),
        wavelength_unit=_stated(" ".join(grid_header), ""),
    )


def usgs_rows(text: str) -> int | None:
    """How many numbers a USGS file of one column holds below "Record=NUMBER: TITLE"; None for another file."""
    lines = text.split("\n")
    if not re.search(r"\bRecord\s*=\s*[0-9]+\s*:", lines[0]):
        return None
    rows = [line for line in lines[1:] if line.strip()]
    return len(rows) if rows and all(_only_number(line) for line in rows) else None


def plot_records(text: str, path: Path) -> list[Record]:
    """Spectra of an ENVI ASCII plot file; it states no unit of the wavelengths unless the title does."""
    header, table, _ = number_table(text, path)
    titles = {}
    for line in header:
        match = re.match(r"^Column ([0-9]{1,6}):\s*(.*?)(~~[0-9]+)?$", line[:MAX_TITLE])
        if match:
            titles[int(match.group(1)) - 1] = match.group(2)
    if sorted(titles) != list(range(table.shape[1])) or table.shape[1] < 2:
        raise InputError(f"{len(titles)} titles for {table.shape[1]} columns", where=str(path))
    return [
        Record(
            name=titles[i],
            wavelength=table[:, 0],
            values=table[:, i],
            where=str(path),
            wavelength_unit=_stated(titles[0], ""),
            reflectance_unit=reflectance_unit_in(titles[i]),
        )
        for i in range(1, table.shape[1])
    ]


def number_table(text: str, path: Path, first: int = 1) -> tuple[list[str], Array, int]:
    """Header lines, the (rows, columns) numbers below them, and the line where the numbers begin.

    A whole number alone above the rows is their count.

    Raises
    ------
    InputError : no numbers, rows of different length, text among the numbers, too many rows, or not as many as the
        file says.
    """
    header: list[str] = []
    rows: list[list[float]] = []
    start, stated, ended = 0, None, False
    for number, line in enumerate(text.splitlines(), start=first):
        if not line.strip():
            continue
        cells = _cells(line)
        numbers = len(cells) > 0 and all(_NUMBER.match(c) for c in cells)
        if not rows and not (numbers and (len(cells) > 1 or not header or _only_number(line))):
            header.append(line.strip())
            if len(header) > MAX_HEADER_LINES:
                raise InputError(f"no numbers in the first {MAX_HEADER_LINES} lines", where=str(path))
            continue
        if rows and _END.match(line) and not ended:
            ended = True
            continue
        if not numbers or ended:
            raise InputError(
                f"not a row of numbers: {line.strip()[:60]!r}",
                where=f"{path}:{number}",
                expected="one row of numbers per channel",
            )
        if len(rows) == 1 and len(rows[0]) == 1 < len(cells) and rows[0][0].is_integer():
            stated, rows, start = str(int(rows[0][0])), [], 0
        if rows and len(cells) != len(rows[0]):
            raise InputError(
                f"{len(cells)} columns", where=f"{path}:{number}", expected=f"{len(rows[0])}, as above"
            )
        if len(rows) >= MAX_ROWS or len(cells) > MAX_COLUMNS:
            raise InputError(f"more than {MAX_ROWS} rows or {MAX_COLUMNS} columns", where=f"{path}:{number}")
        start = start or number
        rows.append([float(c.replace("d", "e").replace("D", "e")) for c in cells])
    if not rows:
        raise InputError(
            "the file holds no numbers",
            where=str(path),
            expected="a wavelength and a value in every row, or a spectrum a row under titles that are wavelengths",
        )
    table = np.array(rows)
    check_stated(table[:, 0], str(path), count=stated, ends=None)
    return header, table, start


def check_stated(wavelength: Array, where: str, *, count: str | None, ends: tuple[float, float] | None) -> None:
    """Refuse a table that has not as many rows, or not the first and last wavelength, that the file states.

    Parameters
    ----------
    count : number of rows as it stands in the file
    ends : the two ends in either order, each with a fiftieth of itself to spare

    Raises
    ------
    InputError : another number of rows or other ends.
    """
    mend = "copy the file again: it is damaged or cut short"
    if count is not None and not (count.strip().isdecimal() and int(count[:9]) == wavelength.size):
        raise InputError(
            f"{wavelength.size} rows", where=where, expected=f"{count.strip()[:20]}, as it states", mend=mend
        )
    if ends is not None:
        stated, ends_nm = np.array(sorted(ends)), np.array([wavelength.min(), wavelength.max()])
        if not np.all(np.abs(ends_nm - stated) <= _ENDS * np.abs(stated)):
            raise InputError(
                f"wavelengths from {ends_nm[0]:g} to {ends_nm[1]:g}",
                where=where,
                expected=f"{stated[0]:g} to {stated[1]:g}, as it states",
                mend=mend,
            )


def check_last_line(text: str, where: str) -> None:
    """Refuse a table of one format whose last line has no end and fewer digits than the one above: it was cut."""
    if not text or text[-1] in "\r\n":
        return
    above, last = (line.split() for line in text.splitlines()[-2:])
    digits = [len(cells[-1].partition(".")[2]) for cells in (above, last) if cells]
    if len(above) != len(last) or digits[-1] < digits[0]:
        raise InputError(
            f"the last line is cut: {' '.join(last)[:60]!r}",
            where=where,
            mend="copy the file again: it is cut short",
        )


def reflectance_unit_in(title: str) -> str | None:
    """The reflectance unit that a column title states, None when it states none."""
    if re.search(r"%\s*\*\s*100", title):
        return "scaled:10000"
    if "%" in title or re.search(r"percent", title, re.IGNORECASE):
        return "percent"
    if re.search(r"\[1(\.0)?\]|fraction", title, re.IGNORECASE):
        return "fraction"
    return None


def quantity_in(title: str) -> str | None:
    """Radiance, irradiance or another quantity than reflectance where a column title says so, else None."""
    if re.search("reflect", title, re.IGNORECASE):
        return None
    other = r"transmittance|transmission|absorbance|absorption|emissivity|emittance"
    match = re.search(rf"(?<![a-z])((ir)?radiance|{other})", title, re.IGNORECASE)
    return None if match is None else match.group().lower()


def power_unit_in(text: str) -> str | None:
    """The unit of a radiance or irradiance, such as W/m^2/sr/nm or uW cm-2 sr-1 nm-1, in the project's words.

    None where the text holds none that is known.
    """
    match = re.search(r"(?<![a-z])(m|u|µ|μ)?W(?![a-z])[^()\[\]]*", text, re.IGNORECASE)
    if match is None:
        return None
    words = match.group()
    # Below the fraction bar stand an area, perhaps a solid angle, and a wavelength.
    area = re.search(r"(?<![a-z])(c?)m(?:\^|\*\*)?-?[2²]", words, re.IGNORECASE)
    per = re.search(r"(?<![a-z])([nuµμ])m(?!\w*[2²])", words[1:], re.IGNORECASE)
    if area is None or per is None:
        return None
    watt = {"": "W", "m": "mW"}.get((match.group(1) or "").lower(), "uW")
    angle = "sr-1 " if re.search(r"(?<![a-z])sr(?![a-z])", words, re.IGNORECASE) else ""
    return f"{watt} {'cm' if area.group(1) else 'm'}-2 {angle}{'nm' if per.group(1).lower() == 'n' else 'um'}-1"


def _entry(header: str, key: str) -> str | None:
    """What a header line says behind ``key:``; None where it says nothing."""
    line = re.search(rf"^[^\w\n]*{key}[ \t]*:[ \t]*(\S.*)$", header, re.IGNORECASE | re.MULTILINE)
    return line[1].strip() if line else None


def _cells(line: str) -> list[str]:
    text = line.strip()
    if '"' in text and not any(set(part) & set(",;\t") for part in text.split('"')[1::2]):
        text = text.replace('"', "")  # as some spreadsheets export numbers
    if ";" in text:  # as spreadsheets export where the comma is the decimal sign
        cells = [c.strip() for c in text.rstrip(";").split(";")]
        return [c.replace(",", ".") if _DECIMAL_COMMA.match(c) else c for c in cells]
    blanks = text.split()
    commas = [c for c in blanks if _DECIMAL_COMMA.match(c)]
    if len(blanks) > 1 and commas and all(c in commas or _WHOLE.match(c) for c in blanks):
        return [c.replace(",", ".") for c in blanks]
    return [c for c in re.split(r"[,\s]+", text) if c]


def _only_number(line: str) -> bool:
    return bool(_NUMBER.match(line.strip()))


def _titles(header: list[str], count: int) -> list[str]:
    """Titles of the columns from the last header line, its units behind those of the line above; "" without any.

    Where the last line does not fit, one further up does that begins with a title of wavelengths.
    """
    if not header:
        return [""] * count
    titles = _split_titles(header[-1], count)
    if any(titles):
        above = _split_titles(header[-2], count) if len(header) > 1 and _are_units(titles) else []
        return [f"{a} {t}".strip() for a, t in zip(above, titles, strict=True)] if any(above) else titles
    for line in reversed(header[:-1]):
        further = _split_titles(line, count)
        if _WAVE.match(further[0]):
            return further
    return titles


def _are_units(titles: list[str]) -> bool:
    return all(_UNIT_TITLE.match(t) for t in titles)


def _is_index(table: Array, titles: list[str]) -> bool:
    """Whether the first column counts the rows, and the second has the title of wavelengths."""
    if table.shape[1] < 3 or _WAVE.search(titles[0]) or not _WAVE.search(titles[1]):
        return False
    return bool(table[0, 0] in (0.0, 1.0) and np.all(np.diff(table[:, 0]) == 1.0))


def _split_titles(line: str, count: int) -> list[str]:
    line = line.lstrip("#;%/ \t")
    best: list[str] = []
    for pattern in (";", "\t", ",", r"\s{2,}", r"\s+"):
        parts = [p.strip().strip('"') for p in re.split(pattern, line)]
        if len(parts) == count:
            return parts
        if len(parts) > count and pattern in (";", "\t", ",") and not best and _WAVE.search(parts[0]):
            best = parts[:count]
    return best or [""] * count


def _stated(title: str, header: str) -> str | None:
    """Wavelength unit in the title of the first column, else in an "X Units" or "Wavelength" header line."""
    lines = [title] + [
        line
        for line in header.splitlines()
        if re.match(r"^\W*(X Units?|Wavelength units?)\s*[:=]", line, re.IGNORECASE)
    ]
    for line in lines:
        nm, um = bool(_NM.search(line)), bool(_UM.search(line))
        if nm != um:
            return "nm" if nm else "um"
    return None


def _column(wanted: str | int, titles: list[str], where: str) -> int:
    if isinstance(wanted, int):
        if not 0 <= wanted < len(titles):
            raise UsageError(f"no column {wanted}", where=where, expected=f"0 to {len(titles) - 1}")
        return wanted
    if titles.count(wanted) != 1:
        raise UsageError(
            f"no column {wanted!r}", where=where, expected="one of " + ", ".join(t or "?" for t in titles)
        )
    return titles.index(wanted)
