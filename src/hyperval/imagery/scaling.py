"""From stored numbers to physical values: one gain and one offset per band, applied once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.envi_header import EnviHeader
from hyperval.errors import InputError, UsageError, reader
from hyperval.paths import checked_file
from hyperval.units import RADIANCE_UNIT, radiance_to_internal

Array = npt.NDArray[np.float64]
_REFLECTANCE_UNITS = {"fraction": 1.0, "1": 1.0, "percent": 0.01, "%": 0.01}
_MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class Scaling:
    """value = gain * stored + offset, per stored band, in ``unit``.

    Attributes
    ----------
    gain, offset : (B,) in stored band order
    unit : unit of the values
    notes : where the numbers come from
    """

    gain: Array
    offset: Array
    unit: str
    notes: tuple[str, ...] = ()


def scaling_of(
    header: EnviHeader | None,
    bands: int,
    *,
    quantity: str,
    unit: str | None,
    scale: float | None,
    file_gains: Sequence[float] = (),
    file_offsets: Sequence[float] = (),
    file_note: str = "scale and offset tags of the GeoTIFF",
) -> Scaling:
    """Gain and offset of every band.

    ``scale`` replaces whatever the header says.  Without it, reflectance is divided by
    ``reflectance scale factor`` (or multiplied by ``data reflectance gain values``), everything else takes
    ``data gain values`` and ``data offset values``; gains that the file or one beside it has (``file_note`` says
    where) count as such.

    Raises
    ------
    InputError : the header gives a scale factor that is zero or two that exclude each other.
    UsageError : an unknown unit or quantity, a radiance without unit, or a scale that is no number.
    """
    gain, offset, note = np.ones(bands), np.zeros(bands), ""
    if scale is None:
        gain, offset, note = _from_header(header, bands, quantity)
        tagged = (
            np.array(file_gains if len(file_gains) else (1.0,) * bands),
            np.array(file_offsets if len(file_offsets) else (0.0,) * bands),
        )
        if np.any(tagged[0] != 1.0) or np.any(tagged[1] != 0.0):
            if note:
                raise InputError(
                    f"its header scales the values, and so do the {file_note}",
                    where=str(header.path) if header else None,
                    mend="state scale: in the campaign",
                )
            gain, offset, note = *tagged, file_note
    return scaled(gain, offset, note, quantity=quantity, unit=unit, scale=scale)


def scaled(
    gain: Array, offset: Array, note: str, *, quantity: str, unit: str | None, scale: float | None
) -> Scaling:
    """The gain and offset of a file in the internal unit; ``scale`` takes their place.

    Raises
    ------
    UsageError : as for :func:`scaling_of`.
    """
    to_internal, name = _unit_factor(quantity, unit)
    if scale is not None:
        if not np.isfinite(scale) or scale <= 0:
            raise UsageError(f"scale is {scale:g}", expected="a positive number that multiplies the stored values")
        gain, offset = np.full(gain.size, float(scale)), np.zeros(gain.size)
        note = f"stored values x {scale:g} (stated)"
    return Scaling(gain * to_internal, offset * to_internal, name, (note,) if note else ())


def _from_header(header: EnviHeader | None, bands: int, quantity: str) -> tuple[Array, Array, str]:
    one, zero = np.ones(bands), np.zeros(bands)
    if header is None:
        return one, zero, ""
    own = quantity == "reflectance" and "data reflectance gain values" in header.entries
    kind = "data reflectance" if own else "data"
    gain = header.numbers(f"{kind} gain values", bands)
    offset = header.numbers(f"{kind} offset values", bands)
    factor = header.number("reflectance scale factor")
    if gain is not None and np.any(gain == 0):
        raise InputError("a gain of 0 makes every value the same", where=header.where(f"{kind} gain values"))
    if factor is not None and not (np.isfinite(factor) and factor > 0):
        raise InputError(
            f"'reflectance scale factor' is {factor:g}",
            where=header.where("reflectance scale factor"),
            expected="a positive number",
        )
    scaled = gain is not None or offset is not None
    if factor not in (None, 1.0) and (scaled or quantity == "radiance"):
        other = f"'{kind} gain values'" if scaled else "a radiance"
        raise InputError(
            f"'reflectance scale factor' and {other} exclude each other",
            where=header.where("reflectance scale factor"),
            mend="state scale: (what multiplies the stored values) in the campaign",
        )
    if scaled:
        return (one if gain is None else gain), (zero if offset is None else offset), f"{kind} gain/offset values"
    if factor is not None and quantity == "reflectance":
        return one / factor, zero, f"stored values / {factor:g} (reflectance scale factor)"
    return one, zero, ""


def _unit_factor(quantity: str, unit: str | None) -> tuple[float, str]:
    if quantity == "radiance":
        if unit is None:
            raise UsageError(
                "the unit of the radiance is not stated",
                expected=f"for example unit: {RADIANCE_UNIT}",
                mend="state unit: in the campaign",
            )
        return radiance_to_internal(unit), RADIANCE_UNIT
    if quantity == "reflectance":
        if unit is not None and unit not in _REFLECTANCE_UNITS:
            raise UsageError(f"unknown reflectance unit {unit!r}", expected="fraction or percent")
        return _REFLECTANCE_UNITS[unit or "fraction"], "1"
    if quantity == "other":
        return 1.0, unit or ""
    raise UsageError(f"unknown quantity {quantity!r}", expected="radiance, reflectance or other")


def gain_file_beside(image: Path) -> Path | None:
    """The ``.gain`` file that the image's name begins with, as f130612t01p00r10rdn_e.gain; None without one."""
    name = image.name.lower()
    fits = [p for p in sorted(image.parent.glob("*.[gG][aA][iI][nN]")) if name.startswith(p.stem.lower())]
    return max(fits, key=lambda p: len(p.stem), default=None)


def divided(
    path: Path | None, bands: int, quantity: str, unit: str | None, scale: float | None
) -> tuple[npt.NDArray[np.float64] | None, str | None]:
    """(B,) gains of a radiance and its unit, by a file of divisors; None and the stated unit where it has no say.

    Source: JPL, AVIRIS Distribution Document 030217: two columns, factor and channel; spectra divided by the
    factors are radiances in micro-watts/cm^2/nm/sr.

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
