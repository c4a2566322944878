"""Whether the values of a cube can be what they are said to be: a scale that was not stated shows soon."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError

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
