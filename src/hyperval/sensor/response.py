"""Electrons per unit of radiance and throughput (3.13, 3.14); modulation transfer and blur of a pixel.

The response of a pixel to the ground in one direction is its aperture, one pixel wide, convolved with a Gaussian
for optics, motion and detector; that response gives the fill f of (3.10).  Frequencies are in cycles per pixel;
Nyquist is 0.5.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.spectra.axis import SIGMA_PER_FWHM

Array = npt.NDArray[np.float64]

PLANCK_J_S = 6.62607015e-34  # exact, SI 2019
LIGHT_M_S = 299792458.0  # exact
# With L in mW cm-2 sr-1 um-1 and lambda in um: 1e-3 W per mW and 1e-6 m per um.
UNIT_FACTOR = 1e-9
ELECTRONS_PER_UNIT = UNIT_FACTOR / (PLANCK_J_S * LIGHT_M_S)  # C_U / (h c) = 5.034e15


def electrons_per_radiance(
    wavelength_nm: npt.ArrayLike,
    width_nm: npt.ArrayLike,
    *,
    throughput_cm2_sr: npt.ArrayLike,
    optical_transmittance: npt.ArrayLike,
    quantum_efficiency: npt.ArrayLike,
    integration_time_s: npt.ArrayLike,
    degradation: npt.ArrayLike = 1.0,
) -> Array:
    """G = N / L of (3.13): electrons per uW cm-2 sr-1 nm-1.

    N = L O_d (A Omega) tau eta t dlambda C_U lambda / (h c).

    Parameters
    ----------
    wavelength_nm, width_nm : (B,) centre and width of each band [nm]
    throughput_cm2_sr : A Omega [cm2 sr]
    optical_transmittance, quantum_efficiency : tau, eta [1]
    integration_time_s : t [s]
    degradation : O_d, what is left of the signal besides tau [1]

    Returns
    -------
    (B,) electrons per radiance unit
    """
    lam_um = np.asarray(wavelength_nm, dtype=float) * 1e-3
    dlam_um = np.asarray(width_nm, dtype=float) * 1e-3
    optics = np.asarray(degradation) * np.asarray(throughput_cm2_sr) * np.asarray(optical_transmittance)
    detector = np.asarray(quantum_efficiency) * np.asarray(integration_time_s)
    return np.asarray(optics * detector * dlam_um * lam_um * ELECTRONS_PER_UNIT)  # (3.13)


def solid_angle(ifov_rad: float, convention: str = "square-ifov") -> float:
    """Omega of one pixel [sr] (3.14).

    "square-ifov" is theta^2, a square pixel; "cone" is 4 pi sin^2(theta/4), the printed form, a round
    field of full angle theta: pi/4 of the square for small angles.
    """
    if convention == "square-ifov":
        return ifov_rad**2
    if convention == "cone":
        return float(4.0 * np.pi * np.sin(ifov_rad / 4.0) ** 2)  # (3.14)
    raise UsageError(f"unknown convention {convention!r}", expected="square-ifov or cone")


def aperture_throughput(
    aperture_m: float, ifov_rad: float, *, obscuration: float = 0.0, convention: str = "square-ifov"
) -> float:
    """A Omega [cm2 sr] from the aperture's diameter and the field of one pixel (3.14).

    ``obscuration`` is the part of the aperture's area that is blocked [1].
    """
    area_cm2 = np.pi * (100.0 * aperture_m / 2.0) ** 2 * (1.0 - obscuration)
    return float(area_cm2 * solid_angle(ifov_rad, convention))  # (3.14)


def f_number_throughput(f_number: float, detector_area_um2: float) -> float:
    """A Omega [cm2 sr] from the F-number and the area of the detector element or slit piece (for 3.14).

    Area times pi / (4 F^2 + 1), the projected solid angle of the cone of light at the focus.
    """
    return float(detector_area_um2 * 1e-8 * np.pi / (4.0 * f_number**2 + 1.0))


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
