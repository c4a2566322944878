"""Text files of field spectrometers: SVC .sig and Spectral Evolution .sed."""

from __future__ import annotations

import re
from pathlib import Path

from hyperval.errors import InputError
from hyperval.spectra.readers_record import Record
from hyperval.spectra.readers_text import number_table, reflectance_unit_in


def svc_record(text: str, path: Path) -> Record:
    """Reflectance of an SVC .sig file: columns wavelength [nm], reference, target, reflectance [percent].

    The three detectors follow one another and overlap unless the file was matched.
    """
    lines = text.splitlines()
    entries: dict[str, str] = {}
    for number, line in enumerate(lines[1:], start=2):
        key, equals, value = line.partition("=")
        if not equals:
            raise InputError(f"not of the form 'key= value': {line[:60]!r}", where=f"{path}:{number}")
        entries[key.strip().lower()] = value.strip()
        if key.strip().lower() == "data":
            break
    else:
        raise InputError("no 'data=' line", where=str(path))
    header, table, start = number_table("\n".join(lines[number:]), path, first=number + 1)
    if header or table.shape[1] != 4:
        raise InputError(
            f"{table.shape[1]} columns",
            where=f"{path}:{start}",
            expected="wavelength, reference, target, reflectance in percent",
        )
    return Record(
        name=entries.get("name", "").removesuffix(".sig") or path.stem,
        wavelength=table[:, 0],
        values=table[:, 3],
        where=str(path),
        wavelength_unit="nm",
        reflectance_unit="percent",
        quantity="reflectance",
    )


def sed_record(text: str, path: Path) -> Record:
    """Reflectance of a Spectral Evolution .sed file: the column "Reflect. %" or "Reflect. [1.0]"."""
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip().lower() == "data:"), None)
    if begin is None or begin + 1 >= len(lines):
        raise InputError("no 'Data:' line", where=str(path))
    titles = [t.strip() for t in lines[begin + 1].split("\t")]
    found = [i for i, title in enumerate(titles) if re.match(r"reflect", title, re.IGNORECASE)]
    if len(found) != 1 or not re.match(r"wvl|wavelength", titles[0], re.IGNORECASE):
        raise InputError(
            "no reflectance column: " + ", ".join(titles),
            where=f"{path}:{begin + 2}",
            expected="Wvl and one column 'Reflect. %' or 'Reflect. [1.0]'",
        )
    unit = reflectance_unit_in(titles[found[0]])
    if unit is None:
        raise InputError(f"the unit of {titles[found[0]]!r} is not known", where=f"{path}:{begin + 2}")
    header, table, _ = number_table("\n".join(lines[begin + 2 :]), path, first=begin + 3)
    if header or table.shape[1] != len(titles):
        raise InputError(f"{table.shape[1]} columns under {len(titles)} titles", where=f"{path}:{begin + 3}")
    return Record(
        name=path.stem,
        wavelength=table[:, 0],
        values=table[:, found[0]],
        where=str(path),
        wavelength_unit="nm",
        reflectance_unit=unit,
        quantity="reflectance",
    )
