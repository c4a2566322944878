"""How an error hangs together between bands: a part of each band's own and a smooth part, as measured at lags."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# Lengths that are tried, as parts of the least and of the greatest lag.
_SHORTEST, _LONGEST, _TRIED = 0.2, 20.0, 400


class LagKernel(NamedTuple):
    """rho(d) = nugget [d = 0] + (1 - nugget) exp(-(d / length)^2 / 2).

    Attributes
    ----------
    nugget : part of the variance that is each band's own [1]
    length_nm : over which the rest hangs together [nm]
    """

    nugget: float
    length_nm: float


def lag_kernel(lags: Sequence[tuple[float, float]]) -> LagKernel:
    """Nugget and length with the least squares over measured correlations at lags [nm], [1].

    For a length the best smooth part is sum rho e / sum e^2 with e = exp(-(d / length)^2 / 2), held to [0, 1];
    lengths are tried from a fifth of the least lag to twenty times the greatest.  Source: the variogram with
    nugget of Cressie, Statistics for Spatial Data, 1993, section 2.3.

    Examples
    --------
    >>> kernel = lag_kernel([(5.0, 0.6 * np.exp(-0.5 * (5 / 20) ** 2)), (20.0, 0.6 * np.exp(-0.5))])
    >>> round(kernel.nugget, 2), round(kernel.length_nm)
    (0.4, 20)
    """
    d, rho = np.array(sorted(lags), dtype=float).T
    lengths = np.geomspace(_SHORTEST * d[0], _LONGEST * d[-1], _TRIED)
    for _ in range(2):  # once around the best of the coarse ones
        e = np.exp(-0.5 * (d / lengths[:, None]) ** 2)
        with np.errstate(divide="ignore", invalid="ignore"):
            smooth = np.nan_to_num(np.clip(e @ rho / np.sum(e**2, axis=1), 0.0, 1.0))
        misfit = np.sum((rho - smooth[:, None] * e) ** 2, axis=1)
        best = int(np.argmin(misfit))
        low, high = lengths[max(best - 1, 0)], lengths[min(best + 1, _TRIED - 1)]
        kernel = LagKernel(float(1.0 - smooth[best]), float(lengths[best]))
        lengths = np.geomspace(low, high, _TRIED)
    return kernel
