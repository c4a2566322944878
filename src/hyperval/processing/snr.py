"""Signal-to-noise ratio of a homogeneous region of an image."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.products import SpectralEstimate

Array = npt.NDArray[np.float64]


def snr_decorrelated(pixels: npt.ArrayLike) -> SpectralEstimate:
    """Mean over the noise that neighbouring bands do not explain.

    Texture is common to neighbouring bands and noise is not.  Each band is regressed on the bands below and
    above (at the ends, on the two next), x_b = c_0 + c_1 x_(b-1) + c_2 x_(b+1) + e.  The residual carries the
    neighbours' noise too, var e = s_b^2 + c_1^2 s_(b-1)^2 + c_2^2 s_(b+1)^2; noise that changes little from band
    to band gives s_b^2 = var e/(1 + c_1^2 + c_2^2), with n - 3 degrees of freedom.  Where texture and noise
    are alike the regression explains only a part of the texture and the SNR is low, by 5 % where they are equal.
    Few pixels raise it, as errors of the coefficients count as noise of the neighbours: 36 by 2 to 4 %, 100 by 1 %.
    This is the spectral part of Roger & Arnold, Int. J. Remote Sens. 17, 1951-1962, 1996.

    Parameters
    ----------
    pixels : (n, B) of one region, n >= 5, B >= 3, finite
    """
    x = _checked(pixels, 5)
    n, bands = x.shape
    if bands < 3:
        raise UsageError(f"{bands} bands: a band needs two neighbours to be told from noise", expected="3 or more")
    mean = x.mean(axis=0)
    z = x - mean
    return _estimate(mean, np.sqrt(_noise_variance(z.T @ z / (n - 3))), n, n - 3)


def snr_from_moments(mean: npt.ArrayLike, covariance: npt.ArrayLike) -> Array:
    """SNR (B,) of :func:`snr_decorrelated` from the mean (B,) and covariance (B, B) of many pixels, B >= 3.

    A band that is much noisier than its neighbours is given up to root 1.5 times its SNR; one that does not vary
    has none (NaN).
    """
    variance = _noise_variance(np.asarray(covariance, dtype=float))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(variance > 0, np.asarray(mean, dtype=float) / np.sqrt(variance), np.nan)


def _noise_variance(covariance: Array) -> Array:
    """(B,) var e/(1 + c_1^2 + c_2^2) with c = S_nn^-1 S_nb and var e = S_bb - c^T S_nb."""
    bands = len(covariance)
    noise = np.empty(bands)
    for b in range(bands):
        near = [1, 2] if b == 0 else [bands - 3, bands - 2] if b == bands - 1 else [b - 1, b + 1]
        common = covariance[near, b]
        c = np.linalg.lstsq(covariance[np.ix_(near, near)], common, rcond=None)[0]
        noise[b] = max(covariance[b, b] - c @ common, 0.0) / (1.0 + c @ c)
    return noise


def _estimate(mean: Array, sd: Array, n: int, dof: int) -> SpectralEstimate:
    with np.errstate(divide="ignore", invalid="ignore"):
        snr = np.where(sd > 0, mean / sd, np.nan)
    # First order: var(mean/s) = 1/n + snr^2/(2 dof); the two parts are independent for normal noise.
    budget = {"mean": np.full(snr.shape, n**-0.5), "noise estimate": np.abs(snr) / np.sqrt(2.0 * dof)}
    variance = sum((u**2 for u in budget.values()), np.zeros(snr.shape))
    return SpectralEstimate(snr, np.diag(variance), None, n, budget)


def _checked(pixels: npt.ArrayLike, least: int) -> Array:
    x = np.asarray(pixels, dtype=float)
    if x.ndim != 2 or len(x) < least:
        raise UsageError(f"pixels of shape {x.shape} for an SNR", expected=f"(n, B) with n at least {least}")
    if not np.all(np.isfinite(x)):
        raise UsageError("the region holds NaN or infinity", mend="leave invalid pixels out")
    return x
