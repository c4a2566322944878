"""Band responses and resampling onto a sensor's bands."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.spectra.axis import SpectralAxis

# A Gaussian of FWHM w has sigma = w / (2 sqrt(2 ln 2)).
SIGMA_PER_FWHM = 1.0 / (2.0 * np.sqrt(2.0 * np.log(2.0)))
CUT_SIGMA = 3.0
_STEPS_PER_FWHM = 12


def band_average(
    wavelength_nm: npt.ArrayLike, values: npt.ArrayLike, axis: SpectralAxis, *, outside: str = "raise"
) -> npt.NDArray[np.float64]:
    """Average of a sampled spectrum over Gaussian band responses.

    The response of a band is exp(-(l - c)^2 / 2 sigma^2) cut at +-3 sigma and normalised to unit
    area; the spectrum between its samples is taken as linear, so that bands narrower than the
    sampling are handled without aliasing.

    Parameters
    ----------
    wavelength_nm : (n,) increasing sample positions [nm]
    values : (..., n) spectrum or stack of spectra, any unit
    axis : the bands
    outside : "raise" (default) when a response reaches beyond the samples by more than half a
        FWHM, or "nan" to give NaN for those bands

    Returns
    -------
    (..., B) band averages in the unit of ``values``.

    Raises
    ------
    UsageError : the spectrum does not cover the bands.
    """
    grid = np.asarray(wavelength_nm, dtype=float)
    y = np.asarray(values, dtype=float)
    if grid.ndim != 1 or y.shape[-1] != grid.size:
        raise UsageError(f"{y.shape[-1]} values for {grid.size} wavelengths")
    if np.any(np.diff(grid) <= 0):
        raise UsageError("sample wavelengths must increase")
    matrix, short = band_weights(grid, axis)
    if np.any(short) and outside == "raise":
        bad = axis.centre_nm[short]
        raise UsageError(
            f"the spectrum covers {grid[0]:g}-{grid[-1]:g} nm and {bad.size} bands lie outside it "
            f"(first {bad[0]:g} nm)",
            expected="samples over the whole band set",
            mend="give a longer spectrum or select fewer bands",
        )
    result = y @ matrix.T
    if np.any(short):
        result[..., short] = np.nan
    return result


def band_weights(
    grid: npt.NDArray[np.float64], axis: SpectralAxis
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """(B, n) weights of samples at ``grid`` (n,) [nm] in :func:`band_average`, and (B,) bands that reach beyond."""
    sigma = axis.fwhm_nm * SIGMA_PER_FWHM
    short = (axis.centre_nm - 0.5 * axis.fwhm_nm < grid[0]) | (axis.centre_nm + 0.5 * axis.fwhm_nm > grid[-1])
    # One common set of normalised offsets serves all bands.
    offsets = np.linspace(-CUT_SIGMA, CUT_SIGMA, int(2 * CUT_SIGMA * SIGMA_PER_FWHM * _STEPS_PER_FWHM * 2) + 1)
    weight = np.exp(-0.5 * offsets**2)
    weight[[0, -1]] *= 0.5  # trapezoidal rule
    position = axis.centre_nm[:, None] + offsets[None, :] * sigma[:, None]
    inside = (position >= grid[0]) & (position <= grid[-1])
    w = np.where(inside, weight[None, :], 0.0)
    with np.errstate(invalid="ignore"):
        w /= w.sum(axis=1, keepdims=True)
    index = np.clip(np.searchsorted(grid, position) - 1, 0, grid.size - 2)
    frac = np.clip((position - grid[index]) / (grid[index + 1] - grid[index]), 0.0, 1.0)
    # Scatter the weights back to the samples they interpolate: a (B, n) matrix, applied at once.
    matrix = np.zeros((len(axis), grid.size))
    rows = np.broadcast_to(np.arange(len(axis))[:, None], index.shape)
    np.add.at(matrix, (rows, index), w * (1.0 - frac))
    np.add.at(matrix, (rows, index + 1), w * frac)
    return matrix, short
