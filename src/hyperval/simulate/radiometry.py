"""From reflectance to stored integers: radiance, sampled detector noise, quantisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.simulate.inputs import SensorNumbers, SimulationInputs

Array = npt.NDArray[np.float32]

# Above this many electrons a Poisson count is drawn from the normal law of the same mean and
# variance: its skewness, 1/sqrt(N), is then under 0.032.
NORMAL_ABOVE_ELECTRONS = 1000.0
INT16_LIMITS = (-32768, 32767)


@dataclass(frozen=True)
class Detector:
    """The closed form of 3.7 per pixel and one realisation of every noise source.

    ``offset`` and ``slope`` (B,): radiance of a black pixel in this scene, and radiance per reflectance.
    """

    sensor: SensorNumbers
    offset: Array
    slope: Array
    counts_per_radiance: float

    def radiance(self, reflectance: Array) -> Array:
        """(samples, B) at-sensor radiance without noise [uW cm-2 sr-1 nm-1]."""
        out: Array = reflectance * self.slope
        out += self.offset
        return out

    def saturated(self, radiance: Array) -> int:
        """How many of the radiances lie beyond the full scale of the digital numbers."""
        s = self.sensor
        full = np.where(s.lsb_radiance > 0.0, s.lsb_radiance * (2**s.bits - 1), np.inf)
        return int(np.count_nonzero(radiance > full.astype(np.float32)))

    def measured(self, radiance: Array, rng: np.random.Generator) -> Array:
        """(samples, B) radiance as the sensor delivers it [uW cm-2 sr-1 nm-1].

        Photon noise is drawn on the electrons (3.13), fixed noise added (3.15), both taken through the noise
        factor g_d (3.16); the sum is rounded to digital numbers (3.18), bits are flipped at their error rate
        (3.19), and the calibration of every sample carries its own relative error (3.17).
        """
        s = self.sensor
        out = self._detected(radiance, rng)
        out *= np.float32(s.noise_factor)  # (3.16)
        out += radiance
        if np.any(s.lsb_radiance > 0.0):
            out = self._digitised(out, rng)
        if np.any(s.relative_calibration > 0.0):
            error = rng.standard_normal(out.shape, dtype=np.float32)
            error *= s.relative_calibration.astype(np.float32)
            error *= radiance
            out += error  # (3.17)
        return out

    def _detected(self, radiance: Array, rng: np.random.Generator) -> Array:
        """One draw of the detector's noise [radiance], before the noise factor."""
        s = self.sensor
        noise = rng.standard_normal(radiance.shape, dtype=np.float32)
        if s.measured is not None:  # a sensor known by its noise alone: no electrons to count
            a, b, c = (x.astype(np.float32) for x in s.measured)
            return np.asarray(noise * np.abs(a * np.sqrt(np.maximum(b + radiance, 0.0)) + c))
        gain = s.electrons_per_radiance.astype(np.float32)
        electrons = radiance * gain  # (3.13)
        np.maximum(electrons, 0.0, out=electrons)  # a dark draw emits no photons
        noise *= np.sqrt(electrons)
        few = electrons < NORMAL_ABOVE_ELECTRONS
        noise[few] = (rng.poisson(electrons[few].astype(np.float64)) - electrons[few]).astype(np.float32)
        fixed = rng.standard_normal(radiance.shape, dtype=np.float32)
        fixed *= s.fixed_noise_electrons.astype(np.float32)
        noise += fixed  # (3.15)
        noise /= gain  # back in radiance
        return noise

    def _digitised(self, radiance: Array, rng: np.random.Generator) -> Array:
        s = self.sensor
        lsb = np.where(s.lsb_radiance > 0.0, s.lsb_radiance, 1.0).astype(np.float32)
        number = np.rint(radiance / lsb)  # (3.18)
        np.minimum(number, np.float32(2**s.bits - 1), out=number)  # full scale
        if s.bit_error_rate > 0.0:
            flips = rng.binomial(number.size * s.bits, s.bit_error_rate)
            where = rng.integers(0, number.size, flips)
            weight = 1 << rng.integers(0, s.bits, flips)
            # The flip of a set bit lowers the number; a negative number stands on a dark level, taken as 0 here.
            words = np.clip(number, 0, 2**s.bits - 1).astype(np.int64).ravel()
            delta = np.zeros(words.size)
            np.add.at(delta, where, np.where(words[where] & weight, -weight, weight))
            number += delta.reshape(number.shape).astype(np.float32)  # (3.19)
        return np.where(s.lsb_radiance > 0.0, number * lsb, radiance).astype(np.float32)

    def stored(self, measured: Array) -> tuple[npt.NDArray[np.int16], int]:
        """(samples, B) integers of the file and how many of them had to be clipped."""
        counts = np.rint(measured * np.float32(self.counts_per_radiance))
        low, high = INT16_LIMITS
        clipped = int(np.count_nonzero((counts < low) | (counts > high)))
        if clipped:
            np.clip(counts, low, high, out=counts)
        return counts.astype("<i2"), clipped


def detector(
    inputs: SimulationInputs, average_reflectance: npt.NDArray[np.float64], counts_per_radiance: float
) -> Detector:
    """The detector over a scene of the given area-average reflectance (B,).

    L = L_a + (A rho + B rho_ave) / (1 - S rho_ave) (3.7), so the black pixel has L_a + B rho_ave / (1 - S rho_ave).
    """
    t = inputs.terms
    bounce = 1.0 - t.spherical_albedo * average_reflectance
    return Detector(
        inputs.sensor,
        (t.path_radiance + t.adjacency * average_reflectance / bounce).astype(np.float32),
        (t.direct / bounce).astype(np.float32),
        counts_per_radiance,
    )
