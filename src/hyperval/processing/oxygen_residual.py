"""Wavelengths of a reflectance, from which the atmosphere was taken out: what is left of the oxygen A band.

A band that is labelled at w and lies at w - s was divided by the transmittance at w and not by its own:

    rho'(w) / rho(w) = (1 - W' k(w - s)) / (1 - W k(w))

with the absorption k of the oxygen seen through the band (of area 1) and its equivalent widths, W' in the light and
W in the compensation.  Too much or too little absorption taken out leaves a bump; a shift leaves a slope across it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy
from scipy import special

from hyperval.spectra.response import SIGMA_PER_FWHM

Array = npt.NDArray[np.float64]

# The two branches of the band: share, centre and spread [nm]. Fitted to MODTRAN 6 in channels of 5.7 nm, rms 0.003
# of up to 0.47 absorbed.
_BRANCHES = ((0.48, 761.24, 0.80), (0.52, 764.38, 2.57))
# What the shape of two branches is worth [nm]: shifts of -5 to 5 nm planted line by line are found within 1.2.
_SHAPE = 1.0
# Equivalent width [nm], sun to sensor: 4.0 by MODTRAN 6 from 2.3 km under a sun at 31 degrees; as the root of the
# path, 3.6 to 6 from other heights and suns.
_WIDTH, _WIDTH_SPREAD = 4.5, 0.25
RANGE_NM = (742.0, 787.0)
_DEGREE = 3  # of the polynomial that the logarithm of the surface follows there
LEAST_BANDS = _DEGREE + 6  # three more than the fit has free numbers
MOST_SHIFT = 10.0  # [nm]
_STEP = 1.0  # of the shifts that are tried first [nm]
_LEAST_FIGURE = 1e-4  # relative: what four digits of a reflectance can tell
_ALPHA = 1e-4  # of so many shifts tried a few are independent: 1e-3 together


@dataclass(frozen=True)
class OxygenResidual:
    """Wavelengths as labelled less the true ones [nm], and its standard uncertainty by scatter and shape [nm]."""

    shift_nm: float
    uncertainty_nm: float


def oxygen_absorption(wavelength_nm: npt.ArrayLike, fwhm_nm: npt.ArrayLike) -> Array:
    """(B,) absorption of the oxygen A band through Gaussian bands, of area 1 over wavelength [nm-1]."""
    w = np.asarray(wavelength_nm, dtype=float)
    band = np.asarray(fwhm_nm, dtype=float) * SIGMA_PER_FWHM
    spread = [np.hypot(sd, band) for _, _, sd in _BRANCHES]
    return np.asarray(
        sum(
            a * np.exp(-(((w - c) / s) ** 2) / 2.0) / (np.sqrt(2.0 * np.pi) * s)
            for (a, c, _), s in zip(_BRANCHES, spread, strict=True)
        )
    )


def oxygen_residual(
    wavelength_nm: npt.ArrayLike, reflectance: npt.ArrayLike, fwhm_nm: npt.ArrayLike
) -> OxygenResidual | None:
    """The shift that explains what is left of the oxygen A band; None where nothing is left beyond the scatter.

    Least squares in the logarithm over 742 to 787 nm: the surface as a cubic, both equivalent widths and the shift.
    What the light went through is known to a quarter, and so is a shift.  Nothing is left, or was taken out by
    interpolation, where no shift improves on the cubic by more than chance (F test with two free numbers).

    Parameters
    ----------
    wavelength_nm, reflectance, fwhm_nm : (B,) finite
    """
    w, y, fwhm = (np.asarray(x, dtype=float) for x in (wavelength_nm, reflectance, fwhm_nm))
    use = (w > RANGE_NM[0]) & (w < RANGE_NM[1]) & (y > 0.0)
    if use.sum() < LEAST_BANDS:
        return None
    w, z, fwhm = w[use], np.log(y[use]), fwhm[use]
    centre = 0.5 * (RANGE_NM[0] + RANGE_NM[1])
    powers = np.vander((w - centre) / (RANGE_NM[1] - centre), _DEGREE + 1)
    compensated = oxygen_absorption(w, fwhm)

    def light(shift: float, width: float) -> Array:
        return _log_transmitted(width * oxygen_absorption(w - shift, fwhm))

    # First with the usual width, linear in what the compensation departs from it.
    start = _log_transmitted(_WIDTH * compensated)
    columns = np.column_stack([powers, compensated / np.exp(start)])
    shifts = np.arange(-MOST_SHIFT, MOST_SHIFT + _STEP, _STEP)
    rests = [_rest(columns, z - light(s, _WIDTH) + start) for s in shifts]
    at = float(shifts[int(np.argmin(rests))])
    surface = np.linalg.lstsq(powers, z - light(at, _WIDTH) + start)[0]
    free = w.size - columns.shape[1] - 1  # what the light went through is all but given

    def rest(p: Array) -> Array:
        return np.asarray(z - light(p[0], p[1]) + _log_transmitted(p[2] * compensated) - powers @ p[3:])

    def weighted(p: Array, scatter: float) -> Array:
        return np.append(rest(p) / scatter, (p[1] / _WIDTH - 1.0) / _WIDTH_SPREAD)

    p = np.array([at, _WIDTH, _WIDTH, *surface])
    for _ in range(2):
        scatter = max(float(np.sqrt(np.sum(rest(p) ** 2) / free)), _LEAST_FIGURE)
        best = scipy.optimize.least_squares(weighted, p, method="lm", args=(scatter,))
        p = best.x
    after = float(np.sum(rest(p) ** 2))
    gain = 0.5 * max(_rest(powers, z) - after, 0.0) / max(after / free, _LEAST_FIGURE**2)
    if special.fdtrc(2, free, gain) > _ALPHA or abs(p[0]) > MOST_SHIFT:
        return None
    covariance = np.linalg.pinv(best.jac.T @ best.jac)
    widened = special.stdtrit(free, 0.975) / special.ndtri(0.975)
    return OxygenResidual(float(p[0]), float(np.hypot(_SHAPE, widened * np.sqrt(covariance[0, 0]))))


def _log_transmitted(absorbed: Array) -> Array:
    return np.asarray(np.log1p(-np.minimum(absorbed, 0.99)))


def _rest(columns: Array, values: Array) -> float:
    """Sum of squares that columns (n, p) leave of values (n,)."""
    return float(np.sum((values - columns @ np.linalg.lstsq(columns, values)[0]) ** 2))
