"""Text files of field spectrometers: SVC and GER .sig, Spectral Evolution .sed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError
from hyperval.spectra.readers_record import Record
from hyperval.spectra.readers_text import (
    check_last_line,
    check_stated,
    number_table,
    power_unit_in,
    reflectance_unit_in,
)

Array = npt.NDArray[np.float64]

# What the maker says that the numbers of a .sig file, times 1e-10, are in; the file names the quantity alone.
SVC_UNITS = {"radiance": "W cm-2 sr-1 nm-1", "irradiance": "W cm-2 nm-1"}
SVC_SCALE = 1e-10
# How the title of a column of a .sed file begins, and its usual forms.
_SED_COLUMNS = {
    "reflectance": (r"reflect|tgt\.?\s*/\s*ref", "'Reflect. %', 'Reflect. [1.0]' or 'Tgt./Ref. %'"),
    "radiance": (r"rad\w*\.?\s*\(target", "'Rad. (Target)'"),
    "irradiance": (r"irr\w*\.?\s*\(target", "'Irr. (Target)'"),
}


def svc_record(text: str, path: Path, quantity: str = "reflectance") -> Record:
    """A spectrum of an SVC .sig file: columns wavelength [nm], reference, target, reflectance [percent].

    ``quantity`` "radiance" or "irradiance" takes the target's column where ``units=`` says so; otherwise the
    reflectance.  The three detectors follow one another and overlap unless the file was matched.

    Raises
    ------
    InputError : not such a file, or a target in counts where radiance is asked for.
    """
    entries, table = _signature(text, path, (4,), "wavelength, reference, target, reflectance in percent")
    name = entries.get("name", "").removesuffix(".sig") or path.stem
    units = entries.get("units", "").split(",")[-1].strip().lower()
    if quantity in SVC_UNITS:
        if units not in SVC_UNITS:
            raise InputError(f"the target is in {units or 'an unknown unit'}, not in {quantity}", where=str(path))
        return Record(
            name, table[:, 0], SVC_SCALE * table[:, 2], str(path),
            wavelength_unit="nm", quantity=units, unit=SVC_UNITS[units],
            notes=(f"{units} taken as {SVC_SCALE:g} {SVC_UNITS[units]}, the maker's unit",),
        )  # fmt: skip
    if not table[:, 3].any():
        raise InputError(
            f"no reflectance: a single scan of {units or 'an unknown quantity'}",
            where=str(path),
            expected="target over white reference in the fourth column",
        )
    return Record(
        name=name,
        wavelength=table[:, 0],
        values=table[:, 3],
        where=str(path),
        wavelength_unit="nm",
        reflectance_unit="percent",
        quantity="reflectance",
    )


def ger_record(text: str, path: Path, quantity: str = "reflectance") -> Record:
    """A spectrum of a GER .sig file: wavelength [nm], target, reference, and perhaps reflectance [percent].

    Where the fourth column is missing, target over reference is the reflectance.

    Raises
    ------
    InputError : not such a file, or another quantity than a reflectance.
    """
    if quantity in SVC_UNITS:
        raise InputError(
            f"the unit of the {quantity} in a GER file is not known",
            where=str(path),
            mend="convert the target's column to a table of wavelength and value, and state its unit",
        )
    entries, table = _signature(text, path, (3, 4), "wavelength, target, reference, perhaps reflectance in percent")
    target, reference = table[:, 1], table[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(reference > 0, target / reference, np.nan)
    values = table[:, 3] if table.shape[1] == 4 else ratio
    return Record(
        entries.get("name", "").removesuffix(".sig") or path.stem, table[:, 0], values, str(path),
        wavelength_unit="nm", reflectance_unit="percent" if table.shape[1] == 4 else "fraction",
        quantity="reflectance",
    )  # fmt: skip


def _signature(text: str, path: Path, columns: tuple[int, ...], expected: str) -> tuple[dict[str, str], Array]:
    """The entries ``key= value`` above the line ``data=`` of a .sig file, and the numbers below it."""
    lines = text.splitlines()
    entries: dict[str, str] = {}
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        key, equals, value = line.partition("=")
        if not equals:
            raise InputError(f"not of the form 'key= value': {line[:60]!r}", where=f"{path}:{number}")
        entries[key.strip().lower()] = value.strip()
        if key.strip().lower() == "data":
            break
    else:
        raise InputError("no 'data=' line", where=str(path))
    header, table, start = number_table("\n".join(lines[number:]), path, first=number + 1)
    if header or table.shape[1] not in columns:
        raise InputError(f"{table.shape[1]} columns", where=f"{path}:{start}", expected=expected)
    check_last_line(text, str(path))
    return entries, table


def sed_record(text: str, path: Path, quantity: str = "reflectance") -> Record:
    """A spectrum of a Spectral Evolution .sed file: the column "Reflect. %", "Reflect. [1.0]" or "Tgt./Ref. %".

    ``quantity`` "radiance" or "irradiance" takes the column "Rad. (Target)" or "Irr. (Target)", whose unit stands
    in the line ``Units:``.
    """
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip().lower() == "data:"), None)
    if begin is None or begin + 1 >= len(lines):
        raise InputError("no 'Data:' line", where=str(path))
    titles = [t.strip() for t in lines[begin + 1].split("\t")]
    power = quantity in ("radiance", "irradiance")
    wanted = quantity if power else "reflectance"
    pattern, forms = _SED_COLUMNS[wanted]
    columns = [i for i, title in enumerate(titles) if re.match(pattern, title, re.IGNORECASE)]
    if len(columns) != 1 or not re.match(r"wvl|wavelength", titles[0], re.IGNORECASE):
        raise InputError(
            f"no {wanted} column: " + ", ".join(titles),
            where=f"{path}:{begin + 2}",
            expected=f"Wvl and one column {forms}",
        )
    unit = None if power else reflectance_unit_in(titles[columns[0]])
    if unit is None and not power:
        raise InputError(f"the unit of {titles[columns[0]]!r} is not known", where=f"{path}:{begin + 2}")
    stated = next((x.partition(":")[2] for x in lines[:begin] if x.lower().startswith("units:")), "")
    table = _sed_table(text, lines, begin, len(titles), path)
    return Record(
        path.stem, table[:, 0], table[:, columns[0]], str(path), wavelength_unit="nm", reflectance_unit=unit,
        quantity=wanted, unit=power_unit_in(stated) if power else None,
    )  # fmt: skip


def _sed_table(text: str, lines: list[str], begin: int, columns: int, path: Path) -> Array:
    """The numbers below the titles, as many rows and columns as the file says and over the range that it says."""
    header, table, start = number_table("\n".join(lines[begin + 2 :]), path, first=begin + 3)
    stated = {key.strip().lower(): value.strip() for key, _, value in (x.partition(":") for x in lines[:begin])}
    named = next((int(m[1]) for key in stated if (m := re.fullmatch(r"columns \[([0-9]{1,3})\]", key))), columns)
    if header or table.shape[1] != columns or named != columns:
        what = f"{table.shape[1]} columns under {columns} titles"
        raise InputError(what, where=f"{path}:{start}", expected=f"{named} of both, as it states")
    ends = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?)\s*,\s*([0-9]+(?:\.[0-9]*)?)", stated.get("wavelength range", ""))
    check_stated(
        table[:, 0], str(path), count=stated.get("channels"),
        ends=(float(ends[1]), float(ends[2])) if ends else None,
    )  # fmt: skip
    check_last_line(text, str(path))
    return table
