"""From radiance to electrons, and their noise, each source one function (3.13-3.20); blur of a pixel.

Variances are in electrons^2 or in radiance^2 as each name says; G is electrons per radiance unit.  The response of a
pixel to the ground in one direction is its aperture, one pixel wide, convolved with a Gaussian for optics, motion and
detector; that response gives the fill f of (3.10).  Frequencies are in cycles per pixel; Nyquist is 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import constants

from hyperval.data import Array
from hyperval.errors import UsageError, refusal
from hyperval.spectra.axis import SIGMA_PER_FWHM

# With L in mW cm-2 sr-1 um-1 and lambda in um: 1e-3 W per mW and 1e-6 m per um.
UNIT_FACTOR = 1e-9
ELECTRONS_PER_UNIT = UNIT_FACTOR / (constants.h * constants.c)  # C_U / (h c) = 5.034e15


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
        raise refusal("sensor.mtf", mtf=np.array2string(mtf, precision=3), most=APERTURE_AT_NYQUIST)
    sigma = np.sqrt(-2.0 * np.log(mtf / APERTURE_AT_NYQUIST)) / np.pi
    return np.asarray(sigma / SIGMA_PER_FWHM)


def shot_variance(radiance: npt.ArrayLike, electrons_per_radiance: npt.ArrayLike) -> Array:
    """Photon noise variance N = G L [electrons^2] (3.13): Poisson, variance equal to the mean."""
    return np.asarray(np.maximum(np.asarray(radiance, dtype=float) * np.asarray(electrons_per_radiance), 0.0))


def calibration_variance(radiance: npt.ArrayLike, error_percent: npt.ArrayLike) -> Array:
    """(c L)^2 [radiance^2] with c = C_R / 100 (3.17).

    C_R is the part that varies from pixel to pixel: an error common to a band cancels in the ELM.
    """
    return np.asarray((np.asarray(error_percent) / 100.0 * np.asarray(radiance, dtype=float)) ** 2)


def quantisation_variance(lsb: npt.ArrayLike) -> Array:
    """LSB^2 / 12 (3.18), in the square of the unit of ``lsb`` (the source has electrons)."""
    return np.asarray(np.asarray(lsb, dtype=float) ** 2 / 12.0)


def bit_error_variance(lsb: npt.ArrayLike, bits: npt.ArrayLike, error_rate: npt.ArrayLike) -> Array:
    """Variance by bits received wrong (3.19), in the square of the unit of ``lsb``.

    A flipped bit n moves the value by 2^n LSB, so that with the rate B_e per bit the mean square is
    LSB^2 B_e (4^N - 1) / 3.  The printed form divides by N: its B_e is the probability that a word has one wrong bit.
    """
    n = np.asarray(bits, dtype=float)
    return np.asarray(np.asarray(lsb, dtype=float) ** 2 * np.asarray(error_rate) * (4.0**n - 1.0) / 3.0)  # (3.19)


def measured_noise_variance(radiance: npt.ArrayLike, a: npt.ArrayLike, b: npt.ArrayLike, c: npt.ArrayLike) -> Array:
    """NEdL^2 [radiance^2] of a measured sensor, NEdL = |a sqrt(b + L) + c| (stands in for 3.15, 3.16).

    With c = 0 this is (3.16) with G = 1/a^2 and sigma_f = sqrt(b)/a; a b + L below zero is taken as 0.
    """
    inside = np.clip(np.asarray(b, dtype=float) + np.asarray(radiance, dtype=float), 0.0, None)
    return np.asarray((np.asarray(a) * np.sqrt(inside) + np.asarray(c)) ** 2)


@dataclass(frozen=True)
class NoiseBreakdown:
    """Noise variances [radiance^2] of (3.15)-(3.19), (..., B) or (B,) each; they sum to the total of (3.20).

    Attributes
    ----------
    shot : photon noise
    fixed : sigma_f: readout, dark current and whatever else does not follow the signal
    quantisation, bit_errors : of the digital word
    calibration : C_R
    fit : of measured noise with c != 0 alone: what is left of |a sqrt(b + L) + c|^2; may be negative
    """

    shot: Array
    fixed: Array
    quantisation: Array
    bit_errors: Array
    calibration: Array
    fit: Array

    @property
    def detector(self) -> Array:
        """Sum of all terms but the calibration."""
        return np.asarray(self.shot + (self.fixed + self.quantisation + self.bit_errors + self.fit))

    @property
    def total(self) -> Array:
        """Sum of all terms."""
        return np.asarray(self.detector + self.calibration)


@dataclass(frozen=True)
class NoiseModel:
    """The noise of one sensor on one band set: everything (3.15)-(3.20) needs.

    Attributes
    ----------
    electrons_per_radiance : (B,) G
    fixed_noise : (B,) sigma_f [electrons]
    detector_gain : g_d [1]
    lsb_electrons : (B,) size of the least significant bit [electrons]; 0 = no quantisation
    bits : word length; (B,) where the arms differ
    bit_error_rate : B_e of each bit; (B,) where the arms differ
    calibration_percent : (B,) C_R [%]
    constant : (B,) c [radiance] where NEdL = |a sqrt(b + L) + c| is what is known of the noise, whose G is then 1/a^2
        and sigma_f sqrt(b)/a; None of a sensor that counts electrons
    full_scale : (B,) radiance at full scale, None where the sensor file does not say
    readings : readings averaged per number before it is used (co-adds, binning): they divide every variance
        but that of the calibration, and those of the digital word where they are averaged before recording
    digital_readings, calibration_readings : the same for the digital word and for C_R
    gain, offset, factor : scalar or (B,).  Radiances are as recorded, L' = gain L + offset, and factor is on the noise
        standard deviation [1].  The detector knows only L: the variance of L' is (gain factor)^2 times the variance
        (3.16)-(3.19) at L = (L' - offset) / gain.
    """

    electrons_per_radiance: Array
    fixed_noise: Array
    detector_gain: float
    lsb_electrons: Array
    bits: int | npt.NDArray[np.int_]
    bit_error_rate: float | Array
    calibration_percent: Array
    constant: Array | None = None
    full_scale: Array | None = None
    readings: float = 1.0
    digital_readings: float = 1.0
    calibration_readings: float = 1.0
    gain: float | Array = 1.0
    offset: float | Array = 0.0
    factor: float | Array = 1.0

    def _true(self, radiance: npt.ArrayLike) -> Array:
        level = np.asarray(radiance, dtype=float)
        # Large arrays are not divided by 1.
        return level if np.all(self.gain == 1.0) and np.all(self.offset == 0.0) else (level - self.offset) / self.gain

    def breakdown(self, radiance: npt.ArrayLike) -> NoiseBreakdown:
        """The terms of (3.16)-(3.19) at ``radiance`` (..., B), apart from each other; (B,) where it is all the same."""
        level, scale = self._true(radiance), (np.asarray(self.gain) * self.factor) ** 2
        g, gd2 = self.electrons_per_radiance, self.detector_gain**2
        analogue, digital = scale / self.readings, scale / self.digital_readings
        unit = analogue * gd2 / g**2  # of the electrons of the detector (3.16)
        shot, fixed = shot_variance(level, g) * unit, self.fixed_noise**2 * unit  # (3.13), (3.15)
        fit, lsb = np.zeros_like(g), self.lsb_electrons / g
        if self.constant is not None and np.any(self.constant):
            a, b = 1.0 / np.sqrt(g), self.fixed_noise**2 / g
            fit = analogue * gd2 * measured_noise_variance(level, a, b, self.constant) - shot - fixed
        flipped = bit_error_variance(lsb, self.bits, self.bit_error_rate)  # (3.19)
        calibration = calibration_variance(level, self.calibration_percent)  # (3.17)
        return NoiseBreakdown(
            shot, fixed, digital * quantisation_variance(lsb), digital * flipped,  # (3.18)
            scale / self.calibration_readings * calibration, fit,
        )  # fmt: skip

    def variance(self, radiance: npt.ArrayLike, *, calibration: bool = True) -> Array:
        """Noise variance (..., B) [radiance^2] at ``radiance`` (..., B): the sum of (3.16)-(3.19)."""
        parts = self.breakdown(radiance)
        return parts.total if calibration else parts.detector

    def snr(self, radiance: npt.ArrayLike, *, calibration: bool = True) -> Array:
        """SNR (..., B) (3.20); with the calibration error it cannot exceed 100 / C_R."""
        return signal_to_noise(radiance, self.variance(radiance, calibration=calibration))

    def full_scale_fraction(self, radiance: npt.ArrayLike) -> Array:
        """Signal (..., B) as a part of full scale [1]; above 1 the band saturates; NaN where that is not known."""
        level = self._true(radiance)
        return np.full_like(level, np.nan) if self.full_scale is None else np.asarray(level / self.full_scale)


def signal_to_noise(radiance: npt.ArrayLike, variance: npt.ArrayLike) -> Array:
    """L over the root of all noise variances, in one unit (3.20) [1]."""
    return np.asarray(np.asarray(radiance, dtype=float) / np.sqrt(np.asarray(variance, dtype=float)))


def with_signal(noise: NoiseModel, factor: float | Array) -> NoiseModel:
    """The noise with ``factor`` (scalar or (B,)) on the electrons per radiance (3.13); the well stays as it is.

    Measured noise |a sqrt(b + L) + c| follows from g = 1/a^2 electrons per radiance and b g electrons^2 of
    fixed noise; c goes as the fixed noise.
    """
    return replace(
        noise,
        electrons_per_radiance=noise.electrons_per_radiance * factor,  # (3.13)
        full_scale=None if noise.full_scale is None else noise.full_scale / factor,
        constant=None if noise.constant is None else noise.constant / factor,
    )
