"""Blur of the image: modulation transfer of a pixel, and the width of its point spread function.

The response of a pixel in one direction is its aperture, one pixel wide, convolved with a Gaussian
for optics, motion and detector; that response gives the fill f of (3.10).  Frequencies are in
cycles per pixel; Nyquist is 0.5.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.spectra.response import SIGMA_PER_FWHM

Array = npt.NDArray[np.float64]

NYQUIST = 0.5
# The aperture alone passes sin(pi/2) / (pi/2) = 2/pi at Nyquist.
APERTURE_AT_NYQUIST = 2.0 / np.pi


def modulation_transfer(frequency: npt.ArrayLike, psf_fwhm_pixels: npt.ArrayLike) -> Array:
    """MTF of the pixel's response that makes f of (3.10): sinc(nu) exp(-2 pi^2 sigma^2 nu^2) [1].

    Parameters
    ----------
    frequency : nu [cycles per pixel]
    psf_fwhm_pixels : FWHM of the Gaussian besides the aperture [pixels]
    """
    nu = np.asarray(frequency, dtype=float)
    sigma = np.asarray(psf_fwhm_pixels, dtype=float) * SIGMA_PER_FWHM
    return np.asarray(np.sinc(nu) * np.exp(-2.0 * (np.pi * sigma * nu) ** 2))


def mtf_at_nyquist(psf_fwhm_pixels: npt.ArrayLike) -> Array:
    """MTF at 0.5 cycles per pixel, aperture included, for f of (3.10) [1]."""
    return modulation_transfer(NYQUIST, psf_fwhm_pixels)


def psf_fwhm_from_mtf(at_nyquist: npt.ArrayLike) -> Array:
    """FWHM of the Gaussian [pixels] for f of (3.10) from the MTF at Nyquist: inverse of :func:`mtf_at_nyquist`.

    Raises
    ------
    UsageError : not above 0, or above 2/pi, which no blur reaches: the aperture alone passes 2/pi.
    """
    mtf = np.asarray(at_nyquist, dtype=float)
    if np.any(~((mtf > 0) & (mtf <= APERTURE_AT_NYQUIST))):
        raise UsageError(
            f"an MTF at Nyquist of {np.array2string(mtf, precision=3)}",
            expected=f"above 0 and at most {APERTURE_AT_NYQUIST:.4f}, which the aperture alone passes",
        )
    sigma = np.sqrt(-2.0 * np.log(mtf / APERTURE_AT_NYQUIST)) / np.pi
    return np.asarray(sigma / SIGMA_PER_FWHM)
