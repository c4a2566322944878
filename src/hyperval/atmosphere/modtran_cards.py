"""Layouts of the tape5 cards of MODTRAN 4 and 5 that the model's runs need, and their fixed columns.

A layout is a list of fields, name:format, in Fortran's terms: A text, I integer, F fixed point (F10.3: ten columns,
three decimals), L logical, X blank.  Columns follow the lists of cards in the user's manuals (MODTRAN4 v3r1,
MODTRAN 5.2.2); column 51 of card 1A belongs to SOLCON there, and real decks have a flag in it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from hyperval.errors import InputError, UsageError

Value = str | int | float | bool

_CARD_1 = (
    "MODEL:I1 T_BEST:A1 ITYPE:I4 IEMSCT:I5 IMULT:I5 M1:I5 M2:I5 M3:I5 M4:I5 M5:I5 M6:I5 MDEF:I5 I_RD2C:I5 "
    "NOPRNT:I5 TPTEMP:F8.3 SURREF:A7"
)
LAYOUTS: Final[dict[int, dict[str, str]]] = {
    4: {
        "1": "MODTRN:A1 SPEED:A1 _:X2 " + _CARD_1,
        "1A": (
            "DIS:L1 DISAZM:L1 NSTR:I3 LSUN:L1 ISUN:I4 CO2MX:F10.3 H2OSTR:A10 O3STR:A10 _:X1 LSUNFL:L1 _:X1 "
            "LBMNAM:L1 _:X1 LFLTNM:L1 _:X1 H2OAER:L1 _:X2 SOLCON:F10.3"
        ),
        "3": "H1:F10.3 H2:F10.3 ANGLE:F10.3 RANGE:F10.3 BETA:F10.3 RO:F10.3 LENN:I5 _:X5 PHI:F10.3",
        "4": "V1:F10.3 V2:F10.3 DV:F10.3 FWHM:F10.3 YFLAG:A1 XFLAG:A1 DLIMIT:A8 FLAGS:A7",
        "4A": "NSURF:I1 AATEMP:F9.3",
    },
    5: {
        "1": "MODTRN:A1 SPEED:A1 BINARY:L1 LYMOLC:A1 " + _CARD_1,
        "1A": (
            "DIS:L1 DISAZM:L1 DISALB:L1 NSTR:I3 SFWHM:F4.0 CO2MX:F10.3 H2OSTR:A10 O3STR:A10 C_PROF:A1 LSUNFL:L1 "
            "_:X1 LBMNAM:L1 _:X1 LFLTNM:L1 _:X1 H2OAER:L1 _:X1 CDTDIR:L1 FLAG51:A1 SOLCON:F9.6 CDASTM:A1 "
            "ASTMC:F9.3 ASTMX:F10.3 ASTMO:F10.3 AERRH:F10.3 NSSALB:I10"
        ),
        "3": "H1:F10.3 H2:F10.3 ANGLE:F10.3 RANGE:F10.3 BETA:F10.3 RO:F10.3 LENN:I5 _:X5 PHI:F10.3 CKRANG:F10.3",
        "4": "V1:F10.3 V2:F10.3 DV:F10.3 FWHM:F10.3 YFLAG:A1 XFLAG:A1 DLIMIT:A8 FLAGS:A7 MLFLX:I3 VRFRAC:F10.3",
        "4A": "NSURF:I1 AATEMP:F9.3",
    },
}
for _cards in LAYOUTS.values():
    _cards["2"] = (
        "APLUS:A2 IHAZE:I3 CNOVAM:A1 ISEASN:I4 ARUSS:A3 IVULCN:I2 ICSTL:I5 ICLD:I5 IVSA:I5 VIS:F10.4 WSS:F10.3 "
        "WHH:F10.3 RAINRT:F10.3 GNDALT:F10.4"
    )
    _cards["3A1"] = "IPARM:I5 IPH:I5 IDAY:I5 ISOURC:I5"
    _cards["3A2"] = "PARM1:F10.4 PARM2:F10.4 PARM3:F10.3 PARM4:F10.3 TIME:F10.4 PSIPO:F10.3 ANGLEM:F10.3 G:F10.3"
    _cards["4L1"] = "SALBFL:A80"
    _cards["4L2"] = "CSALB:A80"
    _cards["5"] = "IRPT:I5"


@dataclass(frozen=True)
class Field:
    """One field of a card: columns start+1 to start+width."""

    name: str
    kind: str
    start: int
    width: int
    decimals: int


def card_fields(version: int, card: str) -> list[Field]:
    """The fields of a card, blanks left out.

    Raises
    ------
    UsageError : a version other than 4 and 5, or a card the model's runs do not use.
    """
    if version not in LAYOUTS or card not in LAYOUTS[version]:
        raise UsageError(
            f"no layout of card {card} of MODTRAN {version}", expected="MODTRAN 4 or 5: " + ", ".join(LAYOUTS[5])
        )
    found, start = [], 0
    for item in LAYOUTS[version][card].split():
        name, form = item.split(":")
        kind, width, decimals = re.fullmatch(r"([AILFX])(\d+)(?:\.(\d+))?", form).groups()  # type: ignore[union-attr]
        if kind != "X":
            found.append(Field(name, kind, start, int(width), int(decimals or 0)))
        start += int(width)
    return found


def format_card(version: int, card: str, values: Mapping[str, Value]) -> str:
    """One line of a deck; fields that are not given stay blank.

    Raises
    ------
    UsageError : an unknown field, or a value that does not fit its columns.
    """
    fields = card_fields(version, card)
    unknown = set(values) - {f.name for f in fields}
    if unknown:
        raise UsageError(f"card {card} of MODTRAN {version} has no {', '.join(sorted(unknown))}")
    line = [" "] * max(f.start + f.width for f in fields)
    for f in fields:
        if f.name not in values:
            continue
        text = _text(f, values[f.name])
        if len(text) != f.width:
            raise UsageError(f"{f.name} = {values[f.name]!r} does not fit {f.width} columns of card {card}")
        line[f.start : f.start + f.width] = text
    return "".join(line).rstrip()


def _text(f: Field, value: Value) -> str:
    if f.kind == "A":
        return str(value).ljust(f.width)
    if f.kind == "L":
        return ("T" if value else "F").rjust(f.width)
    if f.kind == "I":
        return f"{int(value):{f.width}d}"
    return f"{float(value):{f.width}.{f.decimals}f}" if f.decimals else f"{float(value):{f.width - 1}.0f}."


def parse_card(version: int, card: str, line: str, where: str) -> dict[str, Value]:
    """The fields of one line of a deck; blank numbers are 0 and blank logicals False, as Fortran reads them.

    Raises
    ------
    InputError : a field that is not what its columns should hold.
    """
    found: dict[str, Value] = {}
    for f in card_fields(version, card):
        text = line[f.start : f.start + f.width]
        try:
            found[f.name] = _value(f, text)
        except ValueError as error:
            raise InputError(
                f"{f.name} is {text.strip()!r}",
                where=f"{where}, columns {f.start + 1}-{f.start + f.width}",
                expected={"I": "an integer", "L": "T or F"}.get(f.kind, "a number"),
            ) from error
    return found


def _value(f: Field, text: str) -> Value:
    bare = text.strip()
    if f.kind == "A":
        return text.rstrip() if f.width > 1 else bare
    if f.kind == "L":
        if bare.upper() not in ("T", "F", ""):
            raise ValueError
        return bare.upper() == "T"
    if f.kind == "I":
        return int(bare or 0)
    return float(bare or 0.0)
