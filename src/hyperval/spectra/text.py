"""Text files of spectra.

Columns by commas, blanks, tabs or semicolons under any header; ENVI plots; ECOSTRESS.  Tables with one spectrum a row:
metadata, then a column for each wavelength (EcoSIS, spectrolab, EMIT).  Files of field spectrometers: SVC and GER .sig,
Spectral Evolution .sed.  Libraries of the USGS in files of one column.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from hyperval.data import Array
from hyperval.errors import package_table, refusal, refuse
from hyperval.paths import DECIMAL_COMMA, checked_file, csv_rows
from hyperval.spectra.record import MAX_BYTES, MAX_JOINS, MAX_ROWS, FieldSpectrum, SpectraFile
from hyperval.storage import decoded
from hyperval.units import only_wavelength_unit, power_unit, wavelength_unit_named

_WORDS = package_table("spectra/words.yaml")
MAX_TITLE = 1000
_PLOT = "ENVI ASCII Plot File"  # whose titles stand one a line
_REMARK = "#;%/ \t"  # what a line of titles may begin with
_ENDS = 0.02  # of a wavelength: detectors begin and end beside the round numbers that are stated for them

# No part of a pattern may begin in more than one place of what the part before it takes: a line of a million digits
# or blanks would take hours.
_NUMBER = re.compile(r"^[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eEdD][-+]?[0-9]+)?$|^[-+]?(nan|inf)$", re.IGNORECASE)
is_number = _NUMBER.match  # a text, and nothing else
_MISSING = ("", "na", "n/a", "#n/a", "#div/0!", "null")
_WHOLE = re.compile(r"^[-+]?[0-9]+$")
_OF_UNIT = re.compile(r"^(\s*[0-9]+(?:\.[0-9]+)?) ?[nuµ]m(?=[\t,;])")  # a wavelength with its unit, as of LI-COR
_END = re.compile(r"^>+\s*End\b|^\[END\]")  # of the numbers, in files of Ocean Optics and TriOS
_PER_SR = r"(?<![a-z])rrs(?![a-z])|[\[(] *(1 */ *sr|sr *\^? *[-−]1) *[\])]", "sr-1"
_UNIT_TITLE = re.compile(r"^(\[.*\]|\(.*\)|nm|[uµμ]m|%|1|[-−–]|a\.?u\.?|unitless|none)?$", re.IGNORECASE)
# Of the words of a title: those that say standard deviation, and those that name nothing of their own.
_SPREAD = re.compile(_WORDS["deviation_in_titles"])
_SUM = re.compile(rf"(\w\s*\+|\b(mean|av\w*)\s*[-−–])\s*[0-9]?\s*{_SPREAD.pattern}", re.IGNORECASE)  # of a mean and it
_NOTHING = re.compile(r"\b((n|of) \d+|mean|average|avg|refl|rfl|(reflect|radi|irradi)ance|values?|of|in|the|percent)\b")
# How many standard uncertainties a stated one is, as in U (k=2).
_EXPANDED = re.compile(r"(?i)expanded|\b9[059] ?(%|percent) ?(conf|uncert)|uncertaint\w+\W+(at )?9[059] ?(%|percent)")
_COVERAGE = re.compile(r"\b(?:u\W{1,2})?k ?= ?([1-9][0-9.]*)|\b([1-9])[- ]?(?=sigma\b)", re.IGNORECASE)
_WAVE = re.compile(r"wave|wvl|(?<![a-z])wl(?![a-z])|lambda", re.IGNORECASE)
_WAVENUMBER = re.compile(r"wave\s*number|raman|^wn$|cm[\s^({]*[-−⁻][1¹]|(?<!\w)1\s*/\s*cm(?!\w)|kayser", re.IGNORECASE)
# What titles say of values that are no reflectance; the first that a title fits.
_QUANTITIES: dict[str, str] = _WORDS["quantities_of_titles"]
# A line above a table that says what it holds, and the titles of the edges of its steps.
_ABOVE = re.compile(r"(?im)^\W*(measurement type\W+\w+|ppfd\b|(spectral )?(ir)?radiance\s*[(\[].*[)\]]\W*$)")
_EDGES = re.compile(r"(?i)[^\t]*(lower|low|start|min)(?![a-z])[^\t]*\t[^\t]*(upper|end|max)(?![a-z]).*\t")
_POWER = re.compile(r"(?<![a-z])[mnuµμ]?W(?![a-z])[^()\[\],;]*(\([^()]*\))?", re.IGNORECASE)


def text_records(file: SpectraFile, text: str | None = None) -> list[FieldSpectrum]:
    """Spectra of a text file: the first column is the wavelength, the others values.

    A column that is the standard deviation of another belongs to it; one that is called n and holds one whole number
    says how many replicates there are.  Other wavelengths may begin a column of their own; one that repeats them is
    left out.  The header may state ``nm`` or ``um``, ``%`` and ``N = 25``.  A standard deviation is in the unit of
    its mean: one that says another is refused.

    >>> file = SpectraFile(Path("a.csv"))
    >>> vars(file)["text"] = "wl_a,mean,sd,n,wl_b,tile\\n400,0.1,0.01,25,401,0.5\\n500,0.2,0.01,25,501,0.5\\n"
    >>> [(r.name, r.n, r.wavelength_nm.tolist(), r.values.tolist()) for r in text_records(file)]
    [('mean', 25, [400.0, 500.0], [0.1, 0.2]), ('tile', 25, [401.0, 501.0], [0.5, 0.5])]
    >>> vars(file)["text"] = "nm,refl,std (%)\\n400,0.1,1\\n500,0.2,2\\n"
    >>> text_records(file)
    Traceback (most recent call last):
    hyperval.errors.InputError: a.csv: 'std (%)' states another unit than the mean that it belongs to...
    """
    path, columns, middles = file.path, file.columns, tuple[str, ...]()
    header, table, first_line = number_table(text or file.text, path)
    where, header_text = str(path), "\n".join(header)
    titles = _titles(header, table.shape[1], where)
    if columns is not None:
        picked = [_column(c, titles, where) for c in columns]
        refuse(len(picked) not in (2, 3), "text.columns", where)
        table, titles = table[:, picked], [titles[i] for i in picked]
        spread = {1: 2} if len(picked) == 3 else {}
    else:
        # Where the title of the second column is that of wavelengths the first may count the rows.
        counts = len(titles) > 2 and bool(_WAVE.search(titles[1]) and not _WAVE.search(titles[0]))
        counts = counts and bool(table[0, 0] in (0.0, 1.0) and np.all(np.diff(table[:, 0]) == 1.0))
        holds = np.flatnonzero(~np.isnan(table).all(axis=0))[1 if counts else 0 :]  # a column may be empty
        table, titles = table[:, holds], [titles[i] for i in holds]
        if _WAVE.search(titles[0]) and _EDGES.match("\t".join(titles)) and (table[:, 1] > table[:, 0]).all():
            table, titles = np.column_stack([table[:, :2].mean(axis=1), table[:, 2:]]), [titles[0], *titles[2:]]
            middles = ("wavelengths are the middles of the steps that the file states",)
        spread = _deviations(titles)
    refuse(table.shape[1] < 2, "text.single", f"{path}:{first_line}")
    nm = table[:, 0]
    ends = [float(e) for key in ("First", "Last") if is_number(e := _entry(header_text, f"{key} X Value") or "")]
    check_stated(nm, where, _entry(header_text, "Number of X Values"), ends)
    replicates, of_header = re.search(r"\bN\s*=\s*([0-9]{1,9})\b", header_text), _entry(header_text, "Name") or ""
    unit, y_units = wavelength_unit_in(titles[0], header_text, where), _entry(header_text, "Y Units?")
    above = match.group() if (match := _ABOVE.search(header_text)) else ""
    counted = [i for i in range(2, len(titles)) if title_words(titles[i])[0] in ("n", "count", "number", "replicates")]
    counted = [i for i in counted if np.all(table[:, i] == np.maximum(1.0, np.round(table[0, i])))]
    n = int(table[0, counted[0]]) if counted else int(replicates[1]) if replicates else None
    records, skipped = list[FieldSpectrum](), {*spread.values(), *counted}
    zero = ("a standard deviation of 0 everywhere is none",)
    for i in range(1, table.shape[1]):
        steps = np.diff(table[np.isfinite(table[:, i]), i])
        is_again = titles[i] == titles[0] != "" and _UNIT_TITLE.match(titles[i])
        if i > 1 and (is_again or _WAVE.search(titles[i])) and abs(np.sign(steps).sum()) == steps.size:
            nm, unit = table[:, i], wavelength_unit_in(titles[i], header_text, where)
        if i in skipped or (i > 1 and np.array_equal(table[:, i], nm, equal_nan=True)):
            continue
        has, times = np.isfinite(nm), _COVERAGE.search(titles[spread.get(i, 0)])
        refuse(not times and _EXPANDED.search(titles[spread.get(i, 0)]), "text.coverage", where)
        spread_values = table[has, spread[i]] / float((times[1] or times[2]) if times else 1.0) if i in spread else None
        unmeasured = spread_values is not None and not spread_values.any()
        says = y_units or (titles[i] if quantity_in(titles[i]) or percent_in(titles[i]) else above or titles[i])
        factor, value_unit = percent_in(titles[spread.get(i, 0)]), power_unit_in(says) or percent_in(says)
        unlike = i in spread and factor not in (None, value_unit or "fraction")
        refuse(unlike, "text.spread", where, title=titles[spread.get(i, 0)])
        alone = columns is None and (words := title_words(titles[i]))[1] and (not words[0] or len(titles) == 2)
        quantity = "a standard deviation" if alone else quantity_in(says)
        fields: dict[str, Any] = {"quantity": quantity, "wavelength_unit": unit, "unit": value_unit, "n": n}
        fields |= {"notes": middles + zero * unmeasured, "standard_deviation": None if unmeasured else spread_values}
        records.append(FieldSpectrum(titles[i], nm[has], table[has, i], **fields))
    if len(records) == 1:
        return [replace(records[0], name=of_header or (titles[1] if header_text.startswith(_PLOT) else path.stem))]
    return [replace(r, name=r.name or f"column {k}") for k, r in enumerate(records, start=1)]


def title_words(title: str) -> tuple[str, bool]:
    """What a title names beside what any column might be called, and whether it says standard deviation.

    >>> [title_words(t) for t in ("Mean + Stdev", "mean-sd", "grass, +/- SD", "grass, mean of 9", "soil k=3")]
    [('mean + stdev', False), ('mean-sd', False), ('grass', True), ('grass', False), ('soil', False)]
    >>> [title_words(t) for t in ("Uncertainty (k=2)", "U(k=2)", "2-sigma", "Uncertainty (95 % confidence)")]
    [('', True), ('', True), ('', True), ('', True)]
    >>> [title_words(t) for t in ("soil, 95% uncertainty", "95 % confidence uncertainty", "Tile 95% STDEV")]
    [('soil', True), ('', True), ('tile 95', True)]
    >>> [_EXPANDED.search(t) is not None for t in ("95 % uncertainty", "95% confidence", "Tile 95%, uncertainty (k=1)")]
    [True, True, False]
    """
    if _SUM.search(title):
        return title.lower(), False
    title = _COVERAGE.sub(lambda m: "sigma" * (m.group()[0] in "uU"), title)
    bare = _POWER.sub(lambda m: "" if power_unit(m.group().strip()) else m.group(), title)
    words = " ".join(re.findall(r"[^\W\d_]+|\d+", re.sub("(?<=[a-z])(?=[A-Z])", " ", bare))).lower()
    return " ".join(_NOTHING.sub("", _SPREAD.sub("", words)).split()), _SPREAD.search(words) is not None


def _deviations(titles: list[str]) -> dict[int, int]:
    """Column of a mean -> that of its standard deviation, which names the same, or nothing and stands behind it.

    >>> _deviations(["nm", "grass", "soil", "SD_grass", "Soil (std)"]), _deviations(["nm", "tile", "StdDev: N = 68"])
    ({1: 3, 2: 4}, {1: 2})
    >>> others = ("NY_grass", "SD_grass"), ("train", "testdata"), ("a", "Westdale"), ("turf", "turf+sd", "turf-sd")
    >>> [_deviations(["nm", *each]) for each in others]
    [{}, {}, {}, {}]
    """
    found, means, is_spread = dict[int, int](), dict[str, int](), True
    for i, title in enumerate(titles[1:], start=1):
        limit = re.sub("[-−–]", "+", title)  # "grass-sd" beside "grass+sd" is no deviation
        before, (name, is_spread) = 0 if is_spread else i - 1, title_words(limit if limit in titles else title)
        if not is_spread:
            means[name] = i
        elif mean := means.pop(name, before * (not name)):
            found.setdefault(mean, i)
    return found


def number_table(text: str, path: Path, first: int = 1) -> tuple[list[str], Array, int]:
    """Header lines, the (rows, columns) numbers below them, and the line where the numbers begin.

    A whole number alone above the rows is their count.

    Raises
    ------
    InputError : no numbers, rows of different length, text among the numbers, too many rows, or not as many as the
        file says.
    """
    header, rows = list[str](), list[list[float]]()
    start, stated, ended, filled, width = 0, None, False, 0, MAX_ROWS
    for number, line in enumerate(text.splitlines(), start=first):
        if not line.strip().strip(" \t,;"):
            continue
        cells, where = _cells(_OF_UNIT.sub(r"\1", line)), f"{path}:{number}"
        numbers = cells[0] and all(_NUMBER.match(c) for c in cells if c.lower() not in _MISSING)
        if not rows and not (numbers and (len(cells) > 1 or not header or is_number(line.strip()))):
            header.append(line.strip())
            continue
        if rows and _END.match(line):
            ended = True
            continue
        refuse(not numbers or ended, "text.row", where, text=line.strip()[:60])
        if len(rows) == 1 and len(rows[0]) == 1 < len(cells) and rows[0][0].is_integer():
            stated, rows, start, filled, width = str(int(rows[0][0])), [], 0, 0, MAX_ROWS
        wanted = sorted((filled, len(cells), width))[1]
        filled, width = max(filled, len(_without_end(cells))), min(width, len(cells))
        refuse(filled > width, "text.width", where, found=len(cells), wanted=wanted)
        refuse(len(rows) >= MAX_ROWS, "text.large", where, rows=MAX_ROWS)
        start = start or number
        rows.append([float("nan" if c in _MISSING else c.replace("d", "e")) for c in map(str.lower, cells)])
    if not rows and any(line[0] in ",;" for line in header):  # an empty first column
        return number_table(re.sub("(?m)^[ \t,;]+", "", text), path, first)
    refuse(not rows, "text.empty", path)
    width = max(filled, min(width, _titled(header)))  # empty cells at the end of a row are columns where titles say so
    table = np.array([row[:width] for row in rows])
    check_stated(table[:, 0], str(path), stated)
    return header, table, start


def check_stated(wavelength: Array, where: str, count: str | None, ends: Sequence[float] = ()) -> None:
    """Refuse a table that has not as many rows, or not the first and last wavelength, that the file states.

    Parameters
    ----------
    count : number of rows as it stands in the file
    ends : the two ends in either order, each with a fiftieth of itself to spare; others than two are not looked at

    Raises
    ------
    InputError : another number of rows or other ends.
    """
    if count is not None:
        as_many = count.strip().isdecimal() and int(count[:9]) == wavelength.size
        refuse(not as_many, "text.rows", where, found=wavelength.size, stated=count.strip()[:20])
    if len(ends) == 2:
        stated, found = np.array(sorted(ends)), np.array([wavelength.min(), wavelength.max()])
        beyond = np.abs(found - stated) > _ENDS * np.abs(stated)
        refuse(beyond.any(), "text.ends", where, found=found, stated=stated)


def check_last_line(text: str, where: str) -> None:
    """Refuse a table of one format whose last line has no end and fewer digits than the one above: it was cut."""
    if text and text[-1] not in "\r\n":
        above, last = (line.split() for line in text.splitlines()[-2:])
        digits = [len(cells[-1].partition(".")[2]) for cells in (above, last) if cells]
        refuse(len(above) != len(last) or digits[-1] < digits[0], "text.cut", where, text=" ".join(last)[:60])


def percent_in(title: str) -> str | None:
    """The unit of a reflectance that a column title states, None when it states none.

    A percent behind a number is part of a name; a remote-sensing reflectance, Rrs, is one per steradian.

    >>> [percent_in(t) for t in ("reflectance (%)", "% reflectance", "plot 99% [%]", "plot 99%", "5 % grey", "Rrs_sd")]
    ['percent', 'percent', 'percent', None, None, 'sr-1']
    """
    percent = r"(?:^|[^0-9\s])\s*(?:%|percent)"
    units = (r"%\s*\*\s*100", "scaled:10000"), (percent, "percent"), (r"\[1(\.0)?\]|fraction", "fraction"), _PER_SR
    return next((unit for pattern, unit in units if re.search(pattern, title, re.IGNORECASE)), None)


def quantity_in(title: str) -> str:
    """Reflectance, radiance, irradiance or another quantity where a column title says so, else nothing."""
    if re.search(r"reflect|(?<![a-z])rfl(?![a-z])", title, re.IGNORECASE):
        return "" if re.search("radiance", title, re.IGNORECASE) else "reflectance"
    for quantity, pattern in _QUANTITIES.items():
        if match := re.search(pattern, title.strip(), re.IGNORECASE):
            return quantity or match.group().lower()
    power = power_unit_in(title)
    return "" if power is None else "radiance" if " sr-1" in power else "irradiance"


def wavelength_unit_in(title: str, header: str, where: str) -> str | None:
    """Wavelength unit in the title of the first column, else in an "X Units" or "Wavelength" header line.

    >>> [wavelength_unit_in(t, "", "a.csv") for t in ("Wavelength (Angstrom)", "wvl [A]", "wavelength nm", "wave")]
    ['angstrom', 'angstrom', 'nm', None]

    Raises
    ------
    InputError : they say wavenumbers.
    """
    states = r"^\W*(X Units?|X ?Axis mode|Wave(length|number) units?)\s*[:=]|^\W*(wave\s*number|cm\W*1\b)"
    lines = [title, *(line for line in header.splitlines() if re.match(states, line, re.IGNORECASE))]
    for line in lines:
        if unit := wavelength_unit_named(line):
            return unit
        refuse(_WAVENUMBER.search(line), "text.wavenumbers", where, text=line[:60])
    return None


def power_unit_in(text: str) -> str | None:
    """The unit of a radiance or irradiance, such as W/m^2/sr/nm or uW cm-2 sr-1 nm-1, in the project's words.

    None where the text holds none that is known.
    """
    return power_unit(match.group().strip()) if (match := _POWER.search(text)) else None


def _entry(header: str, key: str) -> str | None:
    """What a header line says behind ``key:``; None where it says nothing."""
    line = re.search(rf"^[^\w\n]*{key}[ \t]*:[ \t]*(\S.*)$", header, re.IGNORECASE | re.MULTILINE)
    return line[1].strip() if line else None


def _cells(line: str) -> list[str]:
    """What a line holds between its separators; between commas or semicolons that may be nothing."""
    text = line.strip()
    if '"' in text and not any(set(part) & set(",;\t") for part in text.split('"')[1::2]):
        text = text.replace('"', "")  # as some spreadsheets export numbers
    if ";" in text:  # as spreadsheets export where the comma is the decimal sign
        cells = [c.strip() for c in text.split(";")]
        return [c.replace(",", ".") if DECIMAL_COMMA.match(c) else c for c in cells]
    blanks, parts = text.split(), [c.strip() for c in text.split(",")]
    commas = [c for c in blanks if DECIMAL_COMMA.match(c)]
    if len(blanks) > 1 and commas and all(c in commas or _WHOLE.match(c) for c in blanks):
        return [c.replace(",", ".") for c in blanks]
    if len(parts) > 1 and not any(c.split()[1:] for c in parts):
        return parts
    return [c for c in re.split(r"[,\s]+", text) if c] or [""]


def _titles(header: list[str], count: int, where: str) -> list[str]:
    """Titles of the columns from the last header line, its units behind those of the line above; "" without any.

    Where the last line does not fit, one further up does that begins with a title of wavelengths.

    >>> [_titles([t], 3, "a.csv")[1:] for t in ('nm,"grass, dry",soil', 'nm;"a; b";c;;', "# wl, a, b, UT: , 18.3")]
    [['grass, dry', 'soil'], ['a; b', 'c'], ['a', 'b']]
    >>> _titles(["wavelength (nm),grass, dry,soil"], 3, "a.csv")
    Traceback (most recent call last):
    hyperval.errors.InputError: a.csv: 4 titles for 3 columns...
    """
    if not header:
        return [""] * count
    if is_plot := header[0].startswith(_PLOT):
        listed = [m[1] for line in header if (m := re.match(r"^Column [0-9]+:\s*(.*?)(~~[0-9]+)?$", line[:MAX_TITLE]))]
        refuse(len(listed) != count, "text.titles", where, titles=len(listed), count=count)
    split = [listed] if is_plot else [_split_titles(line, count) for line in header]
    titles = split[-1]
    if any(titles):
        above = split[-2] if len(split) > 1 and all(map(_UNIT_TITLE.match, titles)) else []
        units = [f"[{t}]" if t[:1] not in "[(" else t for t in titles]
        if any(above):
            return [f"{a} {u}".strip() for a, u in zip(above, units, strict=True)]
        by_name = next((t for t in split if t[0].lower().removeprefix("file ") in _NAMES), titles)
        of_axis = _WAVE.search(titles[0]) or wavelength_unit_named(titles[0])
        is_title = of_axis or any(quantity_in(t) or percent_in(t) or title_words(t)[1] for t in titles[1:])
        return titles if is_title else by_name  # rows of metadata above a table may end with any
    if waves := [t for t in split if _WAVE.match(t[0])]:
        return waves[-1]
    found = _titled(header)
    unlike = found > count or (found > 1 and header[-1][0] not in _REMARK)
    refuse(unlike and _FIRST_TITLE.match(header[-1]), "text.titles", where, titles=found, count=count)
    return titles


def _titled(header: list[str]) -> int:
    """How many parts the last line above a table has."""
    return len(_without_end(_parts_of(header[-1], _delimiter(header[-1])))) if header else 0


def _split_titles(line: str, count: int) -> list[str]:
    """The parts of a line that are as many as there are columns; others may follow behind an entry, "UT: , 18.3"."""
    line = line.removeprefix("/fields=").lstrip(_REMARK)
    two, one, best = re.sub(r"\s{2,}", "\t", line), " ".join(line.split()), list[str]()
    unit = re.sub(r"^([^,]*),(?=\s*([nuµμ]m|nanomet\w*|micro\w*)\s*,)", r"\1", line, flags=re.IGNORECASE)
    for delimiter, text in ((";", line), ("\t", line), (",", line), (",", unit), ("\t", two), (" ", one)):
        parts = _without_end(_parts_of(text, delimiter), count)
        if len(parts) == count and not (best and delimiter == " "):
            return parts
        if len(parts) > count and not best and _WAVE.search(parts[0]):
            best = parts
    return best[:count] if best and best[count].endswith(":") else [""] * count


def _parts_of(line: str, delimiter: str) -> list[str]:
    """What stands between the delimiters of a line, those in quotes left."""
    return [part.strip() for part in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]


def _column(wanted: str | int, titles: list[str], where: str) -> int:
    found = range(len(titles)).count(wanted) if isinstance(wanted, int) else titles.count(wanted)
    choices = f"0 to {len(titles) - 1}, or one of {', '.join(t or '?' for t in titles)}"
    refuse(found != 1, "text.column", where, wanted=wanted, known=choices)
    return wanted if isinstance(wanted, int) else titles.index(wanted)


MIN_BANDS, MIN_BANDS_OF_A_DETECTOR = 4, 25
# What stands before a wavelength in a title, and behind it; no b: that counts bands.
_BEFORE = r"(?:(?:[xrw]|wl|wvl|wav|wave|wavelength|lambda|spc|spec|rfl|rrs|refl|reflectance|nm|scan_visnir)[_. ]?)?"
_WAVELENGTH = re.compile(rf"^{_BEFORE}([0-9]+(?:\.[0-9]+)?)[_ ]?[(\[]?(nm|um)?[)\]]?(?:_ref)?$", re.IGNORECASE)
_COUNTED = re.compile(r"^(w|spc|spec|rfl|rrs)[_. ]?[0-9]+$", re.IGNORECASE)  # bands, or spectra by their number
_FIRST_TITLE = re.compile(r"^\W*(wave|wvl|wl\b|lambda|nm\b)(?!.*units)", re.IGNORECASE)
_NAMES = ("name", "sample_name", "sample name", "spectrum", "spectra", "sample", "sample_id", "id", "fname", "names")


def is_row_table(file: SpectraFile) -> bool:
    """Whether the first line has wavelengths as titles of its last columns, behind others or at once.

    >>> file, names = SpectraFile(Path("a.csv")), ",".join(f"spec{number}" for number in range(401, 431))
    >>> for title, first in ("sample", "oak"), ("sample", "400"), ("band", "400"):  # the last: spectra by their number
    ...     vars(file)["text"] = f"{title},{names}\\n{first}{30 * ',0.3'}"
    ...     print(is_row_table(file), end=" ")
    True True False
    """
    first, _, rest = file.text.partition("\n")
    delimiter = _delimiter(first)
    titles = next(csv_rows(first, file.path, delimiter), (1, []))[1]
    if _first_band(titles) is None:
        return False
    # Numbers under "wavelength" are wavelengths, and the other columns spectra that go by a number.
    cell, by_number = _value(rest.split(delimiter, 1)[0].strip(' "')), _COUNTED.match(titles[-1].strip())
    by_number = by_number if titles[0].lower() not in _NAMES and (cell or 0.0) >= 100.0 else None
    return not (by_number or (cell is not None and _FIRST_TITLE.match(titles[0])))


def _delimiter(line: str) -> str:
    """What divides the cells of a line: of tabulator, semicolon and comma the most frequent."""
    return max("\t;,", key=line.count)


def row_records(file: SpectraFile) -> list[FieldSpectrum]:
    """The spectra of a table with one in each row.

    A name comes from the first column of an obvious title whose values differ, or the first whose values differ and
    are no numbers; else the spectra are numbered.  The columns ``Wavelength Units`` and ``Measurement Units`` are read
    where they stand; a percent that the values contradict is not believed, and the unit must be stated.

    >>> file = SpectraFile(Path("a.csv"))
    >>> vars(file)["text"] = "No,Cover,400,500,600,700\\n7,grass,0.1,0.1,0.1,0.1\\n8,soil,0.2,0.2,0.2,NA"
    >>> [record.name for record in row_records(file)]
    ['grass', 'soil']

    Raises
    ------
    InputError : rows of another length than the first, cells that are no numbers, or more than can be a table.
    """
    text, path = file.text, file.path
    delimiter = _delimiter(text.split("\n", 1)[0])
    table, rows = csv_rows(text, path, delimiter), list[tuple[str, list[str]]]()
    titles = _without_end([t.strip() for t in next(table)[1]])
    first = _first_band(titles) or 0
    for number, cells in table:
        where, cells = f"{path}:{number}", _without_end([c.strip() for c in cells], len(titles))
        if any(cells):
            refuse(len(cells) != len(titles), "text.cells", where, found=len(cells), wanted=len(titles))
            rows.append((where, cells))
            refuse(len(rows) > MAX_ROWS, "text.large", where, rows=MAX_ROWS)
    refuse(not rows, "text.no_spectrum", path)
    lower, columns = [t.lower() for t in titles[:first]], list(zip(*(cells for _, cells in rows), strict=True))
    differ = [i for i, values in enumerate(columns[:first]) if all(values) and len(set(values)) == len(values)]
    of_words = next((i for i in differ if all(_value(cell) is None for cell in columns[i])), None)
    named = next((lower.index(n) for n in _NAMES if n in lower and lower.index(n) in differ), of_words)
    names = columns[named] if named is not None else [f"row {i}" for i in range(1, len(rows) + 1)]
    records, of_axis = [], titles[0] if first and (_WAVE.search(titles[0]) or _WAVENUMBER.search(titles[0])) else ""
    for name, (where, cells) in zip(names, rows, strict=True):
        about = {"wavelength units": of_axis} | dict(zip(lower, cells, strict=False))
        numbers = [_value(cell, delimiter) for cell in cells[first:]]
        records.append(_of_row(name, about, titles[first:], numbers, where))
    return records


def _of_row(name: str, about: dict[str, str], titles: list[str], numbers: list[Any], where: str) -> FieldSpectrum:
    """The spectrum of a row by the titles of its bands, with the facts of the columns before them."""
    if None in numbers:
        raise refusal("text.cell", where, title=titles[numbers.index(None)])
    values, suffix = np.array(numbers, dtype=float), _WAVELENGTH.match(titles[0])
    unit = (suffix[2] if suffix else None) or wavelength_unit_in(about.get("wavelength units", ""), "", where)
    said = "percent" if "percent" in about.get("measurement units", "").lower() else percent_in(titles[0])
    doubtful = said == "percent" and (most := np.nanmax(values, initial=0.0)) <= 1.5
    doubt = f"the file says percent, and the values reach {most:.3g}" if doubtful else None
    fields: dict[str, Any] = {"wavelength_unit": unit, "unit": None if doubt else said, "source": where, "doubt": doubt}
    quantity = quantity_in(about.get("measurement quantity", about.get("measurement", "ppfd" * ("ppfd" in about))))
    return FieldSpectrum(name, _wavelengths(titles), values, quantity=quantity, **fields)


def _wavelengths(titles: list[str]) -> Array:
    """The numbers in titles that are wavelengths."""
    return np.array([float(_WAVELENGTH.match(t.strip())[1]) for t in titles])  # type: ignore[index]


def _first_band(titles: list[str]) -> int | None:
    """Where the titles become wavelengths that increase or fall to the end; None where they do not.

    They may begin anew with each of a few detectors that overlap.
    """
    titles = _without_end(titles)
    first = len(titles) - len([*takewhile(_WAVELENGTH.match, map(str.strip, reversed(titles)))])
    numbers = _wavelengths(titles[first:])
    if numbers.size < MIN_BANDS or only_wavelength_unit(numbers) is None:
        return None
    step = np.diff(numbers)
    detectors = min(MAX_JOINS, numbers.size // MIN_BANDS_OF_A_DETECTOR)
    return first if np.sum(step <= 0) <= detectors or np.all(step < 0) else None


def _without_end(cells: list[str], least: int = 0) -> list[str]:
    """The cells without empty ones at the end, which a comma before the end of a line leaves."""
    while len(cells) > least and not cells[-1].strip():
        cells = cells[:-1]
    return cells


def _value(cell: str, delimiter: str = ",") -> float | None:
    """The number in a cell, NaN where it is empty or says so; None where it holds no number."""
    text = "nan" if cell.lower() in _MISSING else cell.strip() if delimiter == "," else cell.strip().replace(",", ".")
    return float(text.lower().replace("d", "e")) if is_number(text) else None


# What the maker says that the numbers of a .sig file, times 1e-10, are in; the file names the quantity alone.
SVC_UNITS = {"radiance": "W cm-2 sr-1 nm-1", "irradiance": "W cm-2 nm-1"}
SVC_SCALE = 1e-10


def _below(file: SpectraFile, mark: str, sign: str, titles: int = 0) -> tuple[dict[str, str], list[str], Array, int]:
    """What lines above a mark state by key, the lines of titles below it, the numbers, and the line of the first."""
    lines, path = file.text.splitlines(), file.path
    begin = next((i for i, line in enumerate(lines) if "".join(line.split()).lower() == mark.lower()), -1)
    refuse(begin < 0, "instrument.data", path, mark=mark)
    odd = next((i for i, line in enumerate(lines[1:begin], start=2) if line.strip() and sign not in line), 0)
    refuse(odd and sign == "=", "sig.form", f"{path}:{odd}", text=lines[odd - 1][:60])
    parts, first = (line.partition(sign) for line in lines[:begin]), begin + 1 + titles
    header, table, start = number_table("\n".join(lines[first:]), path, first=first + 1)
    refuse(header, "text.row", f"{path}:{first + 1}", text=" ".join(header)[:60])
    check_last_line(file.text, str(path))
    return {key.strip().lower(): value.strip() for key, _, value in parts}, lines[begin + 1 : first], table, start


def sig_records(file: SpectraFile) -> list[FieldSpectrum]:
    """A spectrum of a .sig file of SVC or GER.

    SVC: columns wavelength [nm], reference, target, reflectance [percent].  The quantity "radiance" or "irradiance"
    takes the target's column where ``units=`` says so; otherwise the reflectance.  The three detectors follow one
    another and overlap unless the file was matched.

    GER: wavelength [nm], target, reference, and perhaps reflectance [percent].  Where the fourth column is missing,
    target over reference is the reflectance.

    Raises
    ------
    InputError : not such a file, a target in counts where radiance is asked for, or another quantity than a
        reflectance of GER.
    """
    path, of_ger = file.path, file.head.startswith(b"///GER")
    entries, _, table, start = _below(file, "data=", "=")
    count, units = table.shape[1], entries.get("units", "").split(",")[-1].strip().lower()
    expected = ("target, reference, perhaps" if of_ger else "reference, target,") + " reflectance in percent"
    unlike = count != 4 and (count != 3 or not of_ger)
    refuse(unlike, "sig.columns", f"{path}:{start}", count=count, wanted=f"wavelength, {expected}")
    name = entries.get("name", "").removesuffix(".sig") or path.stem
    nm, percent = table[:, 0], table[:, -1]
    if count == 3:
        with np.errstate(divide="ignore", invalid="ignore"):
            percent = np.where(table[:, 2] > 0, 100.0 * (table[:, 1] / table[:, 2]), np.nan)
    record = FieldSpectrum(name, nm, percent, quantity="reflectance", wavelength_unit="nm", unit="percent")
    if file.quantity in SVC_UNITS:
        refuse(of_ger, "ger.unit", path, quantity=file.quantity)
        refuse(units not in SVC_UNITS, "svc.unit", path, unit=units or "an unknown unit", quantity=file.quantity)
        notes = (f"{units} taken as {SVC_SCALE:g} {SVC_UNITS[units]}, the maker's unit",)
        return [replace(record, values=SVC_SCALE * table[:, 2], quantity=units, unit=SVC_UNITS[units], notes=notes)]
    refuse(not (of_ger or table[:, 3].any()), "svc.single", path, unit=units or "an unknown quantity")
    return [record]


def sed_records(file: SpectraFile) -> list[FieldSpectrum]:
    """A spectrum of a Spectral Evolution .sed file: the column "Reflect. %", "Reflect. [1.0]" or "Tgt./Ref. %".

    The quantity "radiance" or "irradiance" takes the column "Rad. (Target)" or "Irr. (Target)", whose unit stands
    in the line ``Units:``.  It has as many rows and columns as it says, over the range that it says.

    >>> file = SpectraFile(Path("a.sed"))
    >>> vars(file)["text"] = "Columns [3]:\\nData:\\nChan.#\\tWvl\\tReflect. %\\n1\\t350.0\\t4.0\\n2\\t351.0\\t5.0\\n"
    >>> [(r.wavelength_nm.tolist(), r.values.tolist(), r.unit) for r in sed_records(file)]
    [([350.0, 351.0], [4.0, 5.0], 'percent')]
    """
    path, where = file.path, str(file.path)
    stated, below, table, start = _below(file, "Data:", ":", titles=1)
    titles, where_titles = [t.strip() for t in below[0].split("\t")], f"{path}:{start - 1}"
    quantity = file.quantity if file.quantity in SVC_UNITS else "reflectance"
    pattern = r"reflect|tgt\.?\s*/\s*ref" if quantity == "reflectance" else rf"{quantity[:3]}\w*\.?\s*\(target"
    # Behind a column of wavelengths, which numbers of channels may precede.
    waves, columns = (
        [i for i, title in enumerate(titles) if re.match(words, title, re.IGNORECASE)]
        for words in ("wvl|wavelength", pattern)
    )
    refuse((len(waves), len(columns)) != (1, 1), "sed.column", where_titles, wanted=quantity, titles=", ".join(titles))
    title = titles[columns[0]]
    unit = percent_in(title) if quantity == "reflectance" else power_unit_in(stated.get("units", ""))
    refuse(unit is None and quantity == "reflectance", "sed.unit", where_titles, title=title)
    named = [int(m[1]) for key in stated if (m := re.fullmatch(r"columns \[([0-9]{1,3})\]", key))] or [len(titles)]
    count, unlike = table.shape[1], len({table.shape[1], len(titles), named[0]}) > 1
    refuse(unlike, "sed.titles", f"{path}:{start}", count=count, titles=len(titles), stated=named[0])
    ends = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?)\s*,\s*([0-9]+(?:\.[0-9]*)?)", stated.get("wavelength range", ""))
    nm, values = table[:, waves[0]], table[:, columns[0]]
    check_stated(nm, where, stated.get("channels"), [float(e) for e in ends.groups()] if ends else ())
    return [FieldSpectrum(path.stem, nm, values, quantity=quantity, wavelength_unit="nm", unit=unit)]


MAX_WAVELENGTH_FILES = 40  # that are looked into


def usgs_records(file: SpectraFile) -> list[FieldSpectrum]:
    """The spectrum of a file of one column, at the wavelengths of another one, stated or beside it."""
    path, grid = file.path, checked_file(wavelengths_of(file) or "", what="wavelength file")
    (header, values), (above, wavelength) = (number_table(decoded(p.read_bytes()), p)[:2] for p in (path, grid))
    unlike, (rows, columns) = values.shape[1] != 1 or wavelength.shape != values.shape, values.shape
    refuse(unlike, "library.rows", path, rows=rows, columns=columns, wanted=len(wavelength), grid=grid)
    title = re.search(r"Record\s*=\s*[0-9]+\s*:\s*(\S.*)", "\n".join(header))
    name, unit = title[1].strip() if title else path.stem, wavelength_unit_in(" ".join(above), "", str(grid))
    fields: dict[str, Any] = {"quantity": quantity_in(name), "wavelength_unit": unit}
    notes = () if file.wavelengths else (f"wavelengths from {grid.name}, which lies beside it",)
    return [FieldSpectrum(name, wavelength[:, 0], values[:, 0], notes=notes, **fields)]


def wavelengths_of(file: SpectraFile) -> Path | str | None:
    """The file of wavelengths of a USGS spectrum of one column: as stated, or in its folder or the one above."""
    path, rows = file.path, None if file.wavelengths else _usgs_rows(file.path)
    near = (p for folder in (path.parent, path.parent.parent) if rows for p in sorted(folder.glob("*.txt")))
    named = (p for p in near if "wavelength" in p.name.lower() and p != path)
    fits = [p for p in islice(named, MAX_WAVELENGTH_FILES) if _usgs_rows(p) == rows]
    return fits[0] if len(fits) == 1 else file.wavelengths


def _usgs_rows(path: Path) -> int | None:
    """How many numbers a USGS file of one column holds below "Record=NUMBER: TITLE"; None for another file."""
    if path.suffix.lower() != ".txt" or path.stat().st_size > MAX_BYTES:
        return None
    first, *rest = decoded(path.read_bytes()).split("\n")
    rows = [line.strip() for line in rest if line.strip()]
    titled = re.search(r"\bRecord\s*=\s*[0-9]+\s*:", first)
    return len(rows) if titled and rows and all(map(is_number, rows)) else None
