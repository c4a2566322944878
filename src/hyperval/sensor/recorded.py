"""The noise of a sensor whose recorded radiance is off by a gain and an offset, or whose noise differs."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from hyperval.sensor.noise import NoiseBreakdown, NoiseModel

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RecordedNoise(NoiseModel):
    """Noise in the units of a recorded radiance L' = gain L + offset, as a function of L'.

    The detector knows only L: the variance of L' is (gain factor)^2 times the variance (3.16)-(3.19) at
    L = (L' - offset) / gain.

    Attributes
    ----------
    gain, offset : scalar or (B,) of the recorded radiance [1], [uW cm-2 sr-1 nm-1]
    factor : scalar or (B,) on the noise standard deviation [1]
    """

    gain: float | Array = 1.0
    offset: float | Array = 0.0
    factor: float | Array = 1.0

    def breakdown(self, radiance: npt.ArrayLike) -> NoiseBreakdown:
        """The terms of (3.16)-(3.19) at the recorded radiance (..., B)."""
        terms = super().breakdown(self._true(radiance))
        scale = (np.asarray(self.gain) * self.factor) ** 2
        return NoiseBreakdown(**{f.name: scale * getattr(terms, f.name) for f in fields(terms)})

    def variance(self, radiance: npt.ArrayLike, *, calibration: bool = True) -> Array:
        """Variance (..., B) of the recorded radiance (..., B) (3.16)-(3.19)."""
        inner = super().variance(self._true(radiance), calibration=calibration)
        return np.asarray((np.asarray(self.gain) * self.factor) ** 2 * inner)

    def full_scale_fraction(self, radiance: npt.ArrayLike) -> Array:
        """True signal (..., B) as a part of full scale [1] at the recorded radiance (..., B)."""
        return super().full_scale_fraction(self._true(radiance))

    def _true(self, radiance: npt.ArrayLike) -> Array:
        return np.asarray((np.asarray(radiance, dtype=float) - self.offset) / self.gain)


def recorded_noise(
    noise: NoiseModel,
    *,
    gain: float | Array = 1.0,
    offset: float | Array = 0.0,
    factor: float | Array = 1.0,
    signal_factor: float | Array = 1.0,
) -> NoiseModel:
    """The noise of a recorded radiance; ``signal_factor`` is on the electrons per radiance (3.13)."""
    if np.any(np.asarray(signal_factor) != 1.0):
        noise = with_signal(noise, np.asarray(signal_factor, dtype=float))
    if all(np.all(np.asarray(x) == y) for x, y in ((gain, 1.0), (offset, 0.0), (factor, 1.0))):
        return noise
    if isinstance(noise, RecordedNoise):  # recorded a second time
        offset = np.asarray(gain) * noise.offset + offset
        gain, factor = np.asarray(gain) * noise.gain, np.asarray(factor) * noise.factor
    inner = {f.name: getattr(noise, f.name) for f in fields(NoiseModel)}
    return RecordedNoise(**inner, gain=gain, offset=offset, factor=factor)


def with_signal(noise: NoiseModel, factor: float | Array) -> NoiseModel:
    """The noise with ``factor`` (scalar or (B,)) on the electrons per radiance; the well stays as large as it is.

    Measured noise |a sqrt(b + L) + c| follows from g = 1/a^2 electrons per radiance and b g electrons^2 of
    fixed noise.
    """
    model = replace(
        noise,
        electrons_per_radiance=noise.electrons_per_radiance * factor,  # (3.13)
        full_scale=None if noise.full_scale is None else noise.full_scale / factor,
    )
    if noise.measured is not None:
        a, b, c = noise.measured
        model = replace(model, measured=(a / np.sqrt(factor), b / factor, c / factor))
    return model
