"""The empirical line method on statistics: two panels, without noise (processing step before 3.21).

The source gives no number to these formulas: k_i = (L_i(high) - L_i(low)) / (rho_high - rho_low),
b_i = L_i(low) - k_i rho_low, rho^ = (L - b) / k, Sigma^_ij = Sigma_L,ij / (k_i k_j), with panels of
reflectance 0.1 and 0.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TwoPanelLine:
    """L = offset + gain rho per band.

    Attributes
    ----------
    gain : (B,) k [uW cm-2 sr-1 nm-1 per unit reflectance]
    offset : (B,) b [uW cm-2 sr-1 nm-1]
    """

    gain: Array
    offset: Array


def two_panel_line(
    radiance_low: npt.ArrayLike,
    radiance_high: npt.ArrayLike,
    reflectance_low: npt.ArrayLike = 0.1,
    reflectance_high: npt.ArrayLike = 0.6,
) -> TwoPanelLine:
    """The line through two panels (before 3.21).

    Parameters
    ----------
    radiance_low, radiance_high : (B,) mean radiance of the panels
    reflectance_low, reflectance_high : scalar or (B,) their reflectances [1]

    Raises
    ------
    UsageError : the panels do not differ in reflectance, or the brighter one is not brighter.
    """
    low, high = np.asarray(radiance_low, dtype=float), np.asarray(radiance_high, dtype=float)
    r_low, r_high = np.asarray(reflectance_low, dtype=float), np.asarray(reflectance_high, dtype=float)
    step = r_high - r_low
    if np.any(step <= 0):
        raise UsageError("the high panel of the empirical line must be brighter than the low one in every band")
    gain = (high - low) / step
    dark = int(np.sum(~(gain > 0)))
    if dark:
        raise UsageError(
            f"the empirical line has no slope in {dark} of {gain.size} bands: no light reaches the sensor there",
            mend="drop those bands (processing: bands: windows_only: true, or ranges)",
        )
    return TwoPanelLine(gain, low - r_low * gain)


def retrieved_reflectance(line: TwoPanelLine, radiance: npt.ArrayLike) -> Array:
    """rho^ = (L - b) / k, (..., B) [1] (before 3.21)."""
    return np.asarray((np.asarray(radiance, dtype=float) - line.offset) / line.gain)


def retrieved_covariance(line: TwoPanelLine, covariance: npt.ArrayLike, out: Array | None = None) -> Array:
    """Sigma^_ij = Sigma_L,ij / (k_i k_j), (B, B) [1] (before 3.21); the offset does not enter.

    ``out`` : (B, B) memory for the result
    """
    slope = 1.0 / line.gain
    result: Array = np.multiply(np.asarray(covariance, dtype=float), slope[:, None], out=out)
    result *= slope
    return result


def darkest_level(fractions: npt.ArrayLike, means: npt.ArrayLike, sds: npt.ArrayLike, pixels: int) -> Array:
    """Radiance of the darkest of ``pixels`` pixels of the scene, band by band: its median (before 3.21).

    All of n independent pixels exceed x with probability (1 - F(x))^n, F = sum f_m Phi((x - L_m) / sigma_m); the
    median of their least is F(x) = 1 - 2^(-1/n).  Darkest-pixel compensation takes it for that of a
    dark surface.

    Parameters
    ----------
    fractions : (..., M) area fractions, sum 1
    means, sds : (..., M, B) of the classes' radiance

    Returns
    -------
    (..., B)

    Raises
    ------
    UsageError : no pixel.
    """
    f, mu, sd = (np.asarray(a, dtype=float) for a in (fractions, means, sds))
    if pixels < 1:
        raise UsageError(f"the darkest of {pixels} pixels", expected="at least one pixel")
    f, sd = f[..., None], np.maximum(sd, 1e-300)
    p = -np.expm1(-np.log(2.0) / pixels)
    alone = mu + sd * ndtri(p)
    high = np.where(f > 0, alone, -np.inf).max(axis=-2)  # there every class is below x with at least p
    low = np.where(f > 0, alone, np.inf).min(axis=-2)  # there none is with more
    for _ in range(60):
        middle = 0.5 * (low + high)
        below = (f * ndtr((middle[..., None, :] - mu) / sd)).sum(axis=-2) < p
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(0.5 * (low + high))
