"""How the sensor sees a reflectance: one object for the radiance and the reflectance domain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.processing.elm_model import TwoPanelLine, two_panel_line
from hyperval.scene.radiance import Formulation, adjacency_slope, direct_slope, mean_radiance, radiance_covariance
from hyperval.sensor.noise import NoiseModel

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """Atmosphere, surroundings, sensor and empirical line of one evaluation.

    Attributes
    ----------
    terms : on the bands; None in the reflectance domain, where reflectance is seen as it is
    average, average_covariance : (B,), (B, B) of the surroundings
    noise : None in the reflectance domain
    kappa : 1/N_eff
    formulation : corrected or thesis
    panels : reflectances of the empirical line, None for detection on radiance
    """

    terms: AtmosphericTerms | None
    average: Array
    average_covariance: Array
    noise: NoiseModel | None
    kappa: float
    formulation: Formulation
    panels: tuple[float, float] | None

    def level(self, reflectance: npt.ArrayLike) -> Array:
        """Mean signal (..., B) of a reflectance (..., B): radiance (3.7), or the reflectance itself."""
        rho = np.asarray(reflectance, dtype=float)
        if self.terms is None:
            return rho
        return mean_radiance(self.terms, rho, self.average, self.formulation)

    def covariance(self, reflectance: Array, covariance: Array, gain: float = 1.0) -> Array:
        """Pixel covariance (B, B) of the signal without sensor noise (3.11)."""
        if self.terms is None:
            return covariance
        return radiance_covariance(
            self.terms,
            reflectance,
            covariance,
            self.average,
            self.average_covariance,
            adjacency_gain=gain,
            kappa=self.kappa,
            formulation=self.formulation,
        )

    def noise_variance(self, level: Array) -> Array:
        """Noise variance (..., B) at a signal level (3.16-3.19); zero in the reflectance domain."""
        return np.zeros_like(level) if self.noise is None else self.noise.variance(level)

    def slope(self) -> Array:
        """(B,) change of the signal per change of the pixel's reflectance (D_A of 3.11)."""
        if self.terms is None:
            return np.ones_like(self.average)
        return direct_slope(self.terms, self.average, self.formulation)

    def adjacency_slope(self, reflectance: Array) -> Array:
        """(..., B) change of the signal per change of the surroundings (D_B of 3.11)."""
        if self.terms is None:
            return np.zeros_like(reflectance)
        return adjacency_slope(self.terms, reflectance, self.average, self.formulation)

    def adjacency_weight(self) -> float:
        """kappa of (3.11), 1 in the printed form."""
        return self.kappa if self.formulation == "corrected" else 1.0

    def lit(self) -> npt.NDArray[np.bool_]:
        """(B,) True where light of the ground reaches the sensor."""
        if self.terms is None:
            return np.ones(self.average.shape, bool)
        return np.asarray(self.terms.direct > 1e-9 * float(self.terms.direct.max()))

    def line(self) -> TwoPanelLine:
        """The empirical line (before 3.21); gain 1 and offset 0 where detection runs on the signal itself.

        Bands without light have NaN.
        """
        bands = self.average.size
        if self.terms is None or self.panels is None:
            return TwoPanelLine(np.ones(bands), np.zeros(bands))
        low, high = self.panels
        lit = self.lit()
        inner = two_panel_line(
            self.level(np.full(bands, low))[lit], self.level(np.full(bands, high))[lit], low, high
        )
        gain, offset = np.full((2, bands), np.nan)
        gain[lit], offset[lit] = inner.gain, inner.offset
        return TwoPanelLine(gain, offset)
