"""Which pixels of a cube hold data."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

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
