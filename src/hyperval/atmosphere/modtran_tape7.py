"""MODTRAN 4 and 5 spectral output: ``tape7``, ``.tp7``, in its three modes, read by fixed width.

A file holds one or more cases, each with a head of the input cards, a line of column names, rows by
wavenumber, and the mark -9999.  Fields can be blank, so rows are cut at columns and never split at spaces.
Radiance is per wavenumber, W cm-2 sr-1 / cm-1, as in the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.modtran_text import fixed_columns, text_lines
from hyperval.errors import InputError, UsageError

Array = npt.NDArray[np.float64]
Mode = Literal["radiance", "irradiance", "transmittance"]

END_MARK = "-9999."
RADIANCE_COLUMNS = (
    "FREQ", "TOT_TRANS", "PTH_THRML", "THRML_SCT", "SURF_EMIS", "SOL_SCAT", "SING_SCAT", "GRND_RFLT", "DRCT_RFLT",
    "TOTAL_RAD", "REF_SOL", "SOL@OBS", "DEPTH", "DIR_EM", "TOA_SUN", "BBODY_T[K]",
)  # fmt: skip
RADIANCE_WIDTHS = (8, *([11] * 9), 9, 9, 8, 7, 11, 11)
IRRADIANCE_COLUMNS = ("FREQ", "TRANS", "SOL_TR", "SOLAR", "DEPTH")
IRRADIANCE_WIDTHS = (8, 8, 9, 9, 71)
TRANSMITTANCE_COLUMNS = (
    "FREQ", "COMBIN", "H2O", "UMIX", "O3", "TRACE", "N2 CONT", "H2O CONT", "MOLEC SCAT", "AER+CLD", "HNO3",
    "AER+CLD abTRNS", "-LOG COMBIN", "CO2", "CO", "CH4", "N2O", "O2", "NH3", "NO", "NO2", "SO2", "CLOUD", "CFC11",
    "CFC12", "CFC13", "CFC14", "CFC22", "CFC113", "CFC114", "CFC115",
)  # fmt: skip
TRANSMITTANCE_WIDTHS = (8, *([7] * 11), 8, *([7] * 18))
_TRANSMITTANCE_HEADS = [name.split()[0] for name in TRANSMITTANCE_COLUMNS]

# TOTAL_RAD is the sum of these; five digits are printed of each.
TOTAL_PARTS = ("PTH_THRML", "SURF_EMIS", "SOL_SCAT", "GRND_RFLT")
SUM_TOLERANCE = 9e-5
_LEAST_RADIANCE = 1e-28  # W cm-2 sr-1 / cm-1: below the range of the format's exponent digits nothing adds up
_LONGEST_HEAD = 2000  # lines of cards before the column names, with user profiles
_SURREF = slice(73, 80)


@dataclass(frozen=True)
class Tape7Case:
    """One case of a tape7 file.

    Attributes
    ----------
    mode : what the run computed
    head : the echoed input cards, as lines
    columns : name -> (n,) values, NaN where blank; ``FREQ`` is the wavenumber [cm-1]
    where : file and line of the column names
    """

    mode: Mode
    head: tuple[str, ...]
    columns: dict[str, Array]
    where: str

    @property
    def wavenumber_cm(self) -> Array:
        """(n,) [cm-1], increasing."""
        return self.columns["FREQ"]

    def column(self, name: str) -> Array:
        """A column with 0 where the file is blank: a term that the run did not compute.

        Raises
        ------
        UsageError : the mode has no such column.
        """
        if name not in self.columns:
            raise UsageError(
                f"no column {name} in {self.mode} mode", where=self.where, expected=", ".join(self.columns)
            )
        return np.nan_to_num(self.columns[name], nan=0.0)

    def albedo(self) -> float | None:
        """Ground reflectance of the run: SURREF of the first card, else 1 - DIR_EM where it is constant."""
        text = self.head[0][_SURREF] if self.head else ""
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if 0.0 <= value <= 1.0:
            return value
        emissivity = self.columns.get("DIR_EM")
        if emissivity is None or not np.all(np.isfinite(emissivity)) or np.ptp(emissivity) > 1e-4:
            return None
        return round(float(1.0 - np.median(emissivity)), 4)


def read_tape7(path: Path) -> list[Tape7Case]:
    """All cases of a ``tape7`` or ``.tp7`` file, packed or not.

    Raises
    ------
    InputError : missing, too large, not a tape7, a row that does not fit its columns, radiances that do not
        sum up to TOTAL_RAD, or no end mark (with file:line).
    """
    lines = text_lines(Path(path), "MODTRAN tape7 output")
    cases: list[Tape7Case] = []
    number = start = 0
    while number < len(lines):
        if not lines[number].lstrip().startswith("FREQ"):
            number += 1
            if number - start > _LONGEST_HEAD:
                raise InputError(
                    "no column names", where=f"{path}:{number}", expected="a line that begins with FREQ"
                )
            continue
        case, number = _case(lines, start, number, str(path))
        cases.append(case)
        start = number
    if not cases:
        raise InputError("no table", where=str(path), expected="MODTRAN tape7 output")
    if any(line.strip() for line in lines[start:]):
        raise InputError("a case without a table", where=f"{path}:{start + 1}", expected="a whole tape7 file")
    return cases


def _case(lines: list[str], start: int, number: int, path: str) -> tuple[Tape7Case, int]:
    """The case whose cards begin at ``start`` and whose column names stand at ``number``; and what follows."""
    where = f"{path}:{number + 1}"
    mode, names, ends = _layout(lines[number], where)
    first = number + (2 if mode == "transmittance" else 1)
    rows: list[list[float]] = []
    for i in range(first, len(lines)):
        line = lines[i]
        if line.strip().startswith("-9999"):
            break
        row = f"{path}:{i + 1}"
        if line[ends[-1] :].strip():
            raise InputError(f"text beyond column {ends[-1]}", where=row, expected=f"{len(names)} columns")
        values = fixed_columns(line, ends, row, blank=np.nan)
        if not np.isfinite(values[0]) or (rows and values[0] <= rows[-1][0]):
            raise InputError(f"wavenumber {values[0]:g}", where=row, expected="wavenumbers that increase")
        rows.append(values)
    else:
        raise InputError("the table has no end", where=where, expected=f"a last line {END_MARK}")
    if not rows:
        raise InputError("a table without rows", where=where)
    columns = dict(zip(names, np.array(rows).T, strict=True))
    head = tuple(line.rstrip() for line in lines[start:number])
    case = Tape7Case(mode, head, columns, where)
    if mode == "radiance":
        _check_total(case, path, first)
    return case, i + 1


def _layout(heading: str, where: str) -> tuple[Mode, tuple[str, ...], list[int]]:
    names = heading.split()
    if tuple(names) == RADIANCE_COLUMNS:
        # Every name ends where its column does, so the widths of another release show in the heading.
        ends, at = [], 0
        for name in names:
            at = heading.index(name, at) + len(name)
            ends.append(at)
        return "radiance", RADIANCE_COLUMNS, ends
    if names == ["FREQ", "TRANS", "SOL", "TR", "SOLAR"]:
        return "irradiance", IRRADIANCE_COLUMNS, list(accumulate(IRRADIANCE_WIDTHS))
    ends = list(accumulate(TRANSMITTANCE_WIDTHS))
    known, more = heading[: ends[-1]], heading[ends[-1] :].rstrip()
    if known.split() == _TRANSMITTANCE_HEADS and len(more) % 7 == 0:
        # Later releases add gases at the end; their names may touch.
        extra = tuple(more[i : i + 7].strip() for i in range(0, len(more), 7))
        ends += [ends[-1] + 7 * (i + 1) for i in range(len(extra))]
        return "transmittance", TRANSMITTANCE_COLUMNS + extra, ends
    raise InputError(
        f"unknown columns: {' '.join(names[:6])} ...",
        where=where,
        expected="tape7 of MODTRAN 4 or 5 in radiance, irradiance or transmittance mode",
    )


def _check_total(case: Tape7Case, path: str, first: int) -> None:
    total = case.column("TOTAL_RAD")
    parts = sum((case.column(name) for name in TOTAL_PARTS), np.zeros_like(total))
    wrong = np.flatnonzero(np.abs(total - parts) > SUM_TOLERANCE * np.abs(total) + _LEAST_RADIANCE)
    if wrong.size:
        i = int(wrong[0])
        raise InputError(
            f"TOTAL_RAD {total[i]:.4E} is not the sum of its parts {parts[i]:.4E}",
            where=f"{path}:{first + i + 1}",
            expected=" + ".join(TOTAL_PARTS) + f" within {SUM_TOLERANCE:g}",
        )
