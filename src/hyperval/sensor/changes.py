"""A sensor whose numbers differ from its file: for trade-offs and for the uncertainty of what a data sheet says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from hyperval.config import Model
from hyperval.sensor.noise import NoiseModel


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

    Measured noise |a sqrt(b + L) + c| changes through its electrons: with g = 1/a^2 electrons per radiance the
    shot term is sqrt(L / g), and b g is the variance of the fixed noise [electrons^2].  A changed word length
    moves the step of quantisation at the same full scale.
    """
    s, f = changes.signal_factor, changes.fixed_noise_factor
    found = replace(
        noise,
        electrons_per_radiance=noise.electrons_per_radiance * s,
        fixed_noise=noise.fixed_noise * f,
        full_scale=None if noise.full_scale is None else noise.full_scale / s,  # the well stays as large as it is
    )
    if noise.measured is not None:
        a, b, c = noise.measured
        found = replace(found, measured=(a / np.sqrt(s), b * f**2 / s, c / s))
    if changes.calibration_error_percent is not None:
        c_r = np.full_like(noise.calibration_percent, changes.calibration_error_percent)
        found = replace(found, calibration_percent=c_r)
    if changes.bits is not None:
        step = noise.lsb_electrons * 2.0 ** (np.asarray(noise.bits, dtype=float) - changes.bits)
        found = replace(found, lsb_electrons=step, bits=changes.bits)
    return found
