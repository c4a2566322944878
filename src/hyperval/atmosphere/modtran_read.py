"""What MODTRAN wrote: channel files (``.chn``), and spectral output (``tape7``, ``.tp7``) in its three modes.

Fields of ``tape7`` can be blank, so rows are cut at columns and never split at spaces.  Its radiance is per
wavenumber, W cm-2 sr-1 / cm-1, as in the file.
"""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError, reader
from hyperval.units import radiance_to_internal

Array = npt.NDArray[np.float64]
Mode = Literal["radiance", "irradiance", "transmittance"]

MAX_BYTES = 256 << 20
_COLUMNS = 26  # numeric columns, then the description
_RADIANCE = radiance_to_internal("W cm-2 sr-1 nm-1")
END_MARK = "-9999."
RADIANCE_COLUMNS = (
    "FREQ", "TOT_TRANS", "PTH_THRML", "THRML_SCT", "SURF_EMIS", "SOL_SCAT", "SING_SCAT", "GRND_RFLT", "DRCT_RFLT",
    "TOTAL_RAD", "REF_SOL", "SOL@OBS", "DEPTH", "DIR_EM", "TOA_SUN", "BBODY_T[K]",
)  # fmt: skip
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
# A channel's radiance [W cm-2 sr-1] is its mean radiance times its width, and the sum of its parts; printed are
# seven digits of radiances, four decimals of the width.
_CHANNEL, _MEAN, _WIDTH, _PARTS, _NUMBER = 6, 4, 8, slice(11, 17), 2
_CHANNEL_TOLERANCE, _WIDTH_STEP_NM = 1e-5, 1e-4
_LEAST_RADIANCE = 1e-28  # W cm-2 sr-1 / cm-1: below the range of the format's exponent digits nothing adds up
_LONGEST_HEAD = 2000  # lines of cards before the column names, with user profiles
_SURREF = slice(73, 80)


def text_lines(path: Path, expected: str, limit: int | None = None) -> list[str]:
    """Lines of a text file, or of a ``.gz`` of one, of at most ``limit`` bytes unpacked; default 256 MiB.

    Raises
    ------
    InputError : missing, unreadable or too large; ``expected`` says what the file should have been.
    """
    path, limit = Path(path), limit or MAX_BYTES
    try:
        if path.stat().st_size > limit:
            raise InputError(f"larger than {limit} bytes", where=str(path), expected=expected)
        with gzip.open(path, "rb") if path.suffix == ".gz" else open(path, "rb") as stream:
            raw = stream.read(limit + 1)
    except FileNotFoundError as error:
        raise InputError("no such file", where=str(path)) from error
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"cannot read: {error}", where=str(path)) from error
    if len(raw) > limit:
        raise InputError(f"unpacks to more than {limit} bytes", where=str(path))
    return raw.decode("ascii", "replace").splitlines()


def fixed_columns(line: str, ends: list[int], where: str, *, blank: float | None = None) -> list[float]:
    """The numbers of one row, cut at the given column ends; ``blank`` stands for an empty field.

    Raises
    ------
    InputError : a field that is no finite number, an empty field where ``blank`` is None, or text beyond the
        last column.
    """
    values = []
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        field = line[start:end].strip()
        if not field and blank is not None:
            values.append(blank)
            continue
        try:
            value = float(field)
        except ValueError as error:
            raise InputError(f"{field!r} in columns {start + 1}-{end}", where=where, expected="a number") from error
        if not np.isfinite(value):
            raise InputError(f"a value that is not finite in columns {start + 1}-{end}", where=where)
        values.append(value)
    return values


@dataclass(frozen=True)
class ChannelBlock:
    """One table of a channel file: one run over ground of one reflectance.

    Attributes
    ----------
    wavelength_nm : (n,) spectral moments [nm]
    width_nm : (n,) equivalent widths [nm]
    radiance : (n,) total radiance [uW cm-2 sr-1 nm-1]
    thermal : (n,) emitted part of it (path emission, path scatter, surface) [same]
    path : (n,) solar radiance scattered into the path, from ground of this block's reflectance too [same]
    ground : (n,) radiance of the viewed ground [same]
    ground_of_sun : (n,) part of it that the direct sun lights [same]
    unit_radiance : (n,) mu0 E0 / pi [same]
    direct, diffuse : (n,) reflectance coefficients A and B [1]
    spherical_albedo : (n,) [1]
    path_transmittance : (n,) ground to sensor, direct [1]
    """

    wavelength_nm: Array
    width_nm: Array
    radiance: Array
    thermal: Array
    path: Array
    ground: Array
    ground_of_sun: Array
    unit_radiance: Array
    direct: Array
    diffuse: Array
    spherical_albedo: Array
    path_transmittance: Array

    def reflectance(self) -> float:
        """Ground reflectance of the run, from ground = F A rho / (1 - S rho); the file does not state it."""
        full = self.unit_radiance * self.direct
        bright = full > 0.05 * full.max()
        if not np.any(bright):
            return 0.0
        ratio = self.ground[bright] / full[bright]
        return float(np.median(ratio / (1.0 + self.spherical_albedo[bright] * ratio)))

    def path_over_black(self) -> Array:
        """L_a [uW cm-2 sr-1 nm-1]: emission and path radiance less what uniform ground adds to it."""
        rho = self.reflectance()
        added = self.unit_radiance * self.diffuse * rho / (1.0 - self.spherical_albedo * rho)
        return self.thermal + self.path - added


@reader
def read_chn_blocks(path: Path) -> list[ChannelBlock]:
    """All tables of a channel file, in their order.

    Raises
    ------
    InputError : missing, too large, not such a file, a row that contradicts itself, channels missing between the
        first and the last, tables of different length, or a last line that is cut off.
    """
    lines = text_lines(Path(path), "a MODTRAN .chn file")
    blocks: list[ChannelBlock] = []
    number = 0
    while number < len(lines):
        if not _is_rule(lines[number]):
            number += 1
            continue
        ends = _column_ends(lines[number], f"{path}:{number + 1}")
        rows: list[list[float]] = []
        number += 1
        while number < len(lines) and lines[number].strip():
            rows.append(_row(lines[number], ends, f"{path}:{number + 1}", len(rows) + 1))
            number += 1
        if not rows:
            raise InputError("a table without rows", where=f"{path}:{number + 1}")
        if blocks and len(rows) != blocks[0].wavelength_nm.size:
            raise InputError(
                f"a table of {len(rows)} channels",
                where=f"{path}:{number}",
                expected=f"{blocks[0].wavelength_nm.size}, as in the first table",
                mend="copy the file again: it is cut short",
            )
        # Sensors with overlapping spectrometers list their channels out of order.
        blocks.append(_block(np.array(sorted(rows, key=lambda row: row[0]))))
    if not blocks:
        raise InputError("no channel table", where=str(path), expected="a MODTRAN .chn file")
    return blocks


def _block(t: Array) -> ChannelBlock:
    width = t[:, 8]

    def density(column: Array) -> Array:
        """Channel radiance [W cm-2 sr-1] to average spectral radiance."""
        return np.asarray(column / width * _RADIANCE)

    return ChannelBlock(
        wavelength_nm=t[:, 0],
        width_nm=width,
        radiance=t[:, 4] * _RADIANCE,
        thermal=density(t[:, 11] + t[:, 12] + t[:, 13]),
        path=density(t[:, 14] + t[:, 15]),
        ground=density(t[:, 16]),
        ground_of_sun=density(t[:, 17]),
        unit_radiance=density(t[:, 18]),
        direct=t[:, 21],
        diffuse=t[:, 22],
        spherical_albedo=t[:, 23],
        path_transmittance=t[:, 24],
    )


def _is_rule(line: str) -> bool:
    return line.startswith("----") and not line.strip("- ")


def _column_ends(rule: str, where: str) -> list[int]:
    """Where each column ends, from the line of dashes under the heads."""
    ends = [i + 1 for i, c in enumerate(rule) if c == "-" and (i + 1 == len(rule) or rule[i + 1] != "-")]
    if len(ends) != _COLUMNS + 1:
        raise InputError(
            f"{len(ends)} columns", where=where, expected=f"the {_COLUMNS} columns of MODTRAN 5.3 or 6"
        )
    return ends[:_COLUMNS]


def _row(line: str, ends: list[int], where: str, channel: int) -> list[float]:
    if len(line) < ends[-1]:
        raise InputError(f"a line of {len(line)} characters", where=where, expected=f"{ends[-1]} or more")
    values = fixed_columns(line, ends, where)
    if values[_WIDTH] <= 0.0:
        raise InputError(f"equivalent width {values[_WIDTH]:g} nm", where=where, expected="a positive width")
    if values[_NUMBER] != channel:
        raise InputError(f"channel {values[_NUMBER]:g}", where=where, expected=f"channel {channel}, the next one")
    whole, product, parts = values[_CHANNEL], values[_MEAN] * values[_WIDTH], sum(values[_PARTS])
    rounding = _CHANNEL_TOLERANCE * abs(whole)
    if abs(product - whole) > rounding + abs(values[_MEAN]) * _WIDTH_STEP_NM or abs(parts - whole) > rounding:
        raise InputError(
            f"channel radiance {whole:.6E}, mean radiance times width {product:.6E}, sum of its parts {parts:.6E}",
            where=where, expected="the same three times", mend="copy the file again: it is damaged",
        )  # fmt: skip
    return values


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


@reader
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
