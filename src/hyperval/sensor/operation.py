"""How a sensor is run (frames, bins, where its bands truly stand), and numbers that differ from its file."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from hyperval.config import Model
from hyperval.sensor.noise import NoiseModel, with_signal
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import SIGMA_PER_FWHM


class SensorChanges(Model):
    """What differs from the sensor file; each term is that of (3.13)-(3.19)."""

    calibration_error_percent: float | None = Field(None, ge=0, lt=100, description="C_R in every band [%]")
    signal_factor: float = Field(
        1.0, gt=0, le=1000, description="on the electrons per radiance: throughput, aperture, integration time"
    )
    fixed_noise_factor: float = Field(1.0, ge=0, le=1000, description="on the fixed noise electrons")
    bits: int | None = Field(None, ge=1, le=32, description="bits of a word, at the same full scale")


def changed_noise(noise: NoiseModel, changes: SensorChanges) -> NoiseModel:
    """The noise (3.13)-(3.19) of a sensor with other numbers.

    The light acts by :func:`with_signal`; b g of measured noise is the variance of its fixed part [electrons^2].
    A changed word length moves the step of quantisation at the same full scale.
    """
    changed = with_signal(noise, changes.signal_factor)
    f = changes.fixed_noise_factor
    changed = replace(changed, fixed_noise=changed.fixed_noise * f)
    if changed.measured is not None:
        a, b, c = changed.measured
        changed = replace(changed, measured=(a, b * f**2, c))
    if changes.calibration_error_percent is not None:
        c_r = np.full_like(noise.calibration_percent, changes.calibration_error_percent)
        changed = replace(changed, calibration_percent=c_r)
    if changes.bits is not None:
        step = noise.lsb_electrons * 2.0 ** (np.asarray(noise.bits, dtype=float) - changes.bits)
        changed = replace(changed, lsb_electrons=step, bits=changes.bits)
    return changed


Array = npt.NDArray[np.float64]
Count = Annotated[int, Field(ge=1, le=10_000)]


class SensorOperation(Model):
    """Settings of one flight; the sensor file holds what belongs to the instrument."""

    frames_averaged: Count = Field(1, description="frames averaged into one line (co-adds)")
    averaged: Literal["before recording", "after recording"] = Field(
        "after recording", description="whether each frame is digitised and sent by itself"
    )
    spatial_binning: tuple[Count, Count] = Field(
        (1, 1), description="pixels averaged into one, (along, across); class statistics are those of the bin"
    )
    spectral_binning: Count = Field(1, description="neighbouring bands added into one, each read by itself")
    wavelength_shift_nm: float | dict[str, float] = Field(
        0.0, description="true minus nominal band centres [nm], for all bands or by arm"
    )
    column: float | None = Field(None, description="sample, from 0, at which the smile is taken; None: the middle")


def averaged_noise(noise: NoiseModel, operation: SensorOperation) -> NoiseModel:
    """The noise of co-added frames and spatial bins (3.15)-(3.19).

    Independent readings divide the variances of photons and detector by their number.  Frames averaged before
    recording share one digital word.  C_R belongs to a detector element, so that only bins across the track
    average it.
    """
    along, across = operation.spatial_binning
    bins, frames = along * across, operation.frames_averaged
    after = operation.averaged == "after recording"
    return replace(
        noise,
        readings=noise.readings * bins * frames,
        digital_readings=noise.digital_readings * bins * (frames if after else 1),
        calibration_readings=noise.calibration_readings * across,
    )


def binned_axis(axis: SpectralAxis, count: int) -> SpectralAxis:
    """The axis of sums of ``count`` neighbouring bands (dlambda of 3.13); bands left over at the end are dropped.

    The response of a sum has the mean of the centres and the variance of the parts plus that of their
    centres; the FWHM is that of the Gaussian of this variance.  A bin is good when all its bands are.
    """
    groups = _groups(axis.centre_nm, count)
    variance = (_groups(axis.fwhm_nm, count) * SIGMA_PER_FWHM) ** 2
    sigma = np.sqrt(variance.mean(axis=1) + groups.var(axis=1))
    good = _groups(axis.good, count).all(axis=1)
    return SpectralAxis(groups.mean(axis=1), sigma / SIGMA_PER_FWHM, np.asarray(good, dtype=bool))


def binned_noise(noise: NoiseModel, count: int) -> NoiseModel:
    """The noise of sums of ``count`` neighbouring bands (3.13)-(3.19).

    Electrons add up, and so do the variances of fixed noise, rounding and bit errors, each band being read by
    itself; C_R is independent between bands.  Measured noise is binned through its electrons; c adds in
    quadrature, exact where a and c do not change within a bin.
    """
    if count == 1:
        return noise

    def root_sum(x: Array) -> Array:
        return np.asarray(np.sqrt((_groups(x, count) ** 2).sum(axis=1)))

    g_parts = _groups(noise.electrons_per_radiance, count)
    g = g_parts.sum(axis=1)  # (3.13)
    fixed = root_sum(noise.fixed_noise)
    weights = g_parts / g[:, None]
    calibration = np.sqrt(((weights * _groups(noise.calibration_percent, count)) ** 2).sum(axis=1))  # (3.17)
    measured = None
    if noise.measured is not None:
        a, _, c = noise.measured
        sign = np.sign(_groups(c, count).sum(axis=1))
        measured = (1.0 / np.sqrt(g), fixed**2 / g, sign * root_sum(c / a**2) / g)
    full = None if noise.full_scale is None else _groups(noise.full_scale, count).min(axis=1)

    def whole(x: npt.ArrayLike) -> Array:
        return _groups(np.broadcast_to(x, noise.fixed_noise.shape), count)[:, 0]

    return replace(
        noise,
        electrons_per_radiance=g,
        fixed_noise=fixed,
        lsb_electrons=root_sum(noise.lsb_electrons),
        bits=whole(noise.bits).astype(int) if np.ndim(noise.bits) else noise.bits,
        bit_error_rate=whole(noise.bit_error_rate) if np.ndim(noise.bit_error_rate) else noise.bit_error_rate,
        calibration_percent=calibration,
        measured=measured,
        full_scale=full,
    )


def _groups(values: npt.ArrayLike, count: int) -> Array:
    x = np.asarray(values)
    whole = x.size // count * count
    return np.asarray(x[:whole].reshape(-1, count))
