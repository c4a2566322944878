"""Which pixels of a cube hold data, and whether their values can be what they are said to be."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError

Mask = npt.NDArray[np.bool_]


def equals(stored: npt.NDArray[Any], ignore: float) -> Mask:
    """Where the stored values are the ignore value, compared in the stored type."""
    kept = ignore_in_type(stored.dtype, ignore)
    if kept is None:
        return np.zeros(stored.shape, bool)
    return np.asarray(np.isnan(stored) if np.isnan(ignore) else stored == kept)


def ignore_in_type(dtype: np.dtype, ignore: float) -> Any | None:
    """The ignore value as a stored value, None where the type cannot hold it."""
    if dtype.kind == "f":
        beyond = np.isfinite(ignore) and abs(ignore) > 1.0000001 * float(np.finfo(dtype).max)
        return None if beyond else dtype.type(ignore)
    if not float(ignore).is_integer():
        return None
    limits = np.iinfo(dtype)
    if float(ignore) == float(limits.max):  # as a float, the largest 64-bit number is the next power of two
        return dtype.type(limits.max)
    if not limits.min <= int(ignore) <= limits.max:
        return None
    return dtype.type(int(ignore))


def usable_pixels(
    stored: npt.NDArray[Any], *, ignore: float | None, zero_is_fill: bool, needed: Mask | None = None
) -> Mask:
    """Pixels (lines, samples) of stored values (B, lines, samples) that can be used.

    A pixel is not usable where a needed band holds the ignore value or is not finite, or where every band is
    stored as 0 and ``zero_is_fill``.

    Parameters
    ----------
    needed : (B,) bands that must hold data; all by default
    """
    usable = np.ones(stored.shape[1:], bool)
    some = slice(None) if needed is None or needed.all() else needed
    if ignore is not None and ignore_in_type(stored.dtype, ignore) is not None:
        usable &= ~equals(stored[some], ignore).any(axis=0)
    if stored.dtype.kind == "f":
        usable &= np.isfinite(stored[some]).all(axis=0)
    if zero_is_fill:
        # Few pixels hold a 0 in each of three bands; only those are looked at in full.
        dark = stored[-1] == 0
        for band in (0, stored.shape[0] // 2):
            if not dark.any():
                return usable
            dark &= stored[band] == 0
        usable[dark] &= stored[:, dark].any(axis=0)
    return usable


# Above these the 95th percentile of a cube says that its scale was not stated.
CHECKED_SAMPLES = 64  # in each of 16 lines
PLAUSIBLE_REFLECTANCE = 1.5
PLAUSIBLE_RADIANCE = 200.0  # [uW cm-2 sr-1 nm-1]; a white surface under the zenith sun gives about 65


def _some_values(cube: Any, line: int) -> npt.NDArray[Any]:
    """(n,) values of valid pixels of a line, spread over its samples, in the good bands."""
    rows = np.full(min(cube.samples, CHECKED_SAMPLES), line)
    cols = np.linspace(0, cube.samples - 1, rows.size).astype(int)
    return np.asarray(cube.spectra((rows, cols))[:, cube.axis.good].ravel())


def check_values_of(cube: Any) -> None:
    """Raise InputError when the values are too large for the quantity: a scale that was not stated."""
    limit = {"reflectance": PLAUSIBLE_REFLECTANCE, "radiance": PLAUSIBLE_RADIANCE}.get(cube.quantity)
    if limit is None:
        return
    lines = np.unique(np.linspace(0, cube.lines - 1, 16).astype(int))
    sample = np.concatenate([_some_values(cube, int(line)) for line in lines])
    if sample.size == 0:
        return
    high = float(np.percentile(sample, 95))
    if high > limit:
        raise InputError(
            f"95 % of the {cube.quantity} values reach up to {high:.4g} {cube.unit}".removesuffix(" 1"),
            where=str(cube.raster.path),
            expected=f"at most {limit:g}",
            mend="state scale: (what multiplies the stored values) or unit:"
            if cube.quantity == "radiance"
            else "state scale: what multiplies the stored values (0.01 where they are percent, 0.0001 where they "
            "are reflectance times 10000)",
        )
