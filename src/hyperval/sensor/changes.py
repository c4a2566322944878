"""A sensor whose numbers differ from its file: for trade-offs and for the uncertainty of what a data sheet says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from hyperval.config import Model
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.recorded import with_signal


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
