"""The cards of tape5 by columns, from the lists of the user's manuals: what decks are read with."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

# The cards by version: fields name:format in Fortran's terms, A text, I integer, F fixed point (F10.3: ten columns,
# three decimals), L logical, X blank.
_CARD_1 = (
    "MODEL:I1 T_BEST:A1 ITYPE:I4 IEMSCT:I5 IMULT:I5 M1:I5 M2:I5 M3:I5 M4:I5 M5:I5 M6:I5 MDEF:I5 I_RD2C:I5 "
    "NOPRNT:I5 TPTEMP:F8.3 SURREF:A7"
)
_COMMON = {
    "2": (
        "APLUS:A2 IHAZE:I3 CNOVAM:A1 ISEASN:I4 ARUSS:A3 IVULCN:I2 ICSTL:I5 ICLD:I5 IVSA:I5 VIS:F10.4 WSS:F10.3 "
        "WHH:F10.3 RAINRT:F10.3 GNDALT:F10.4"
    ),
    "3A1": "IPARM:I5 IPH:I5 IDAY:I5 ISOURC:I5",
    "3A2": "PARM1:F10.4 PARM2:F10.4 PARM3:F10.3 PARM4:F10.3 TIME:F10.4 PSIPO:F10.3 ANGLEM:F10.3 G:F10.3",
    "5": "IRPT:I5",
}
CARDS: Final[dict[int, dict[str, str]]] = {
    4: {
        "1": "MODTRN:A1 SPEED:A1 _:X2 " + _CARD_1,
        "1A": (
            "DIS:L1 DISAZM:L1 NSTR:I3 LSUN:L1 ISUN:I4 CO2MX:F10.3 H2OSTR:A10 O3STR:A10 _:X1 LSUNFL:L1 _:X1 "
            "LBMNAM:L1 _:X1 LFLTNM:L1 _:X1 H2OAER:L1 _:X2 SOLCON:F10.3"
        ),
        "3": "H1:F10.3 H2:F10.3 ANGLE:F10.3 RANGE:F10.3 BETA:F10.3 RO:F10.3 LENN:I5 _:X5 PHI:F10.3",
        "4": "V1:F10.3 V2:F10.3 DV:F10.3 FWHM:F10.3 YFLAG:A1 XFLAG:A1 DLIMIT:A8 FLAGS:A7",
        **_COMMON,
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
        **_COMMON,
    },
}


@dataclass(frozen=True)
class Field:
    """One field of a card: columns start+1 to start+width."""

    name: str
    kind: str
    start: int
    width: int
    decimals: int


def card_fields(version: int, card: str) -> list[Field]:
    """The fields of a card, blanks left out."""
    fields, start = [], 0
    for item in CARDS[version][card].split():
        name, form = item.split(":")
        kind, width, decimals = re.findall(r"[A-Z]|\d+", f"{form}.0")[:3]
        if kind != "X":
            fields.append(Field(name, kind, start, int(width), int(decimals)))
        start += int(width)
    return fields
