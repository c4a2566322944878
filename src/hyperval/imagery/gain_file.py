"""Divisors of an image of whole numbers in a file of their own (AVIRIS-Classic, ``.gain``).

Source: JPL, AVIRIS Distribution Document 030217: two columns, factor and channel; spectra divided by the factors
are radiances in micro-watts/cm^2/nm/sr.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError, UsageError, reader
from hyperval.paths import checked_file
from hyperval.units import RADIANCE_UNIT, radiance_to_internal

_MAX_BYTES = 1 << 20


def gain_file_beside(image: Path) -> Path | None:
    """The ``.gain`` file that the image's name begins with, as f130612t01p00r10rdn_e.gain; None without one."""
    name = image.name.lower()
    fits = [p for p in sorted(image.parent.glob("*.[gG][aA][iI][nN]")) if name.startswith(p.stem.lower())]
    return max(fits, key=lambda p: len(p.stem), default=None)


def divided(
    path: Path | None, bands: int, quantity: str, unit: str | None, scale: float | None
) -> tuple[npt.NDArray[np.float64] | None, str | None]:
    """(B,) gains of a radiance and its unit, by a file of divisors; None and the stated unit where it has no say.

    Raises
    ------
    UsageError : a stated unit that is not the file's.
    """
    if path is None or quantity != "radiance" or scale is not None:
        return None, unit
    if unit is not None and radiance_to_internal(unit) != 1.0:
        raise UsageError(
            f"{path.name} beside the cube gives {RADIANCE_UNIT}, the campaign states {unit}",
            where=str(path),
            mend=f"state unit: {RADIANCE_UNIT}, or scale: and its unit",
        )
    return 1.0 / _divisors(path, bands), RADIANCE_UNIT


@reader
def _divisors(path: Path, bands: int) -> npt.NDArray[np.float64]:
    """(B,) what the stored numbers of each band are divided by.

    Raises
    ------
    InputError : not one positive number for each band, or channels that do not count from 1.
    """
    expected = f"{bands} rows of a factor and a channel that counts from 1"
    text = checked_file(path, what="gain file", most=_MAX_BYTES).read_text("latin-1")
    out = np.empty(bands)
    rows = [(n, r.split()) for n, r in enumerate(text.splitlines(), start=1) if r.strip()]
    if len(rows) != bands:
        raise InputError(f"{len(rows)} rows for {bands} bands", where=str(path), expected=expected)
    for band, (number, cells) in enumerate(rows):
        try:
            out[band], channel = float(cells[0]), int(cells[1]) if len(cells) > 1 else band + 1
        except ValueError:
            out[band], channel = np.nan, 0
        if not (np.isfinite(out[band]) and out[band] > 0 and channel == band + 1):
            raise InputError(f"{' '.join(cells)[:40]!r}", where=f"{path}:{number}", expected=expected)
    return out
