"""How the sensor sees a reflectance: one object for the radiance and the reflectance domain."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.inputs import cut
from hyperval.processing.elm_model import TwoPanelLine, darkest_level, two_panel_line
from hyperval.scenario import DarkestPixel, ElmPanels, Illumination
from hyperval.scene.radiance import (
    Formulation,
    adjacency_slope,
    direct_slope,
    illumination_factor,
    mean_radiance,
    radiance_covariance,
)
from hyperval.sensor.noise import NoiseModel

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ClassLevels:
    """What the darkest pixel of a scene follows from: (M,) fractions and gains, (M, B) means and variances."""

    fractions: Array
    gains: Array
    means: Array
    variances: Array


@dataclass(frozen=True)
class LitSurface:
    """A target under its own light, as a surface in the open would have to be to look like it.

    Attributes
    ----------
    mean, covariance : (B,), (B, B) of that surface
    under_sky : (B,) reflectance times sky view: what the light from the surroundings meets (D_B of 3.11)
    factor : (B,) light over that in the open
    """

    mean: Array
    covariance: Array
    under_sky: Array
    factor: Array | float


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
    elm : the empirical line or the darkest pixel; None for detection on radiance
    classes : for the darkest pixel
    retrieval : (B,), (B,) the line gives gain rho + offset for a reflectance rho, its panels being off; None: rho
    """

    terms: AtmosphericTerms | None
    average: Array
    average_covariance: Array
    noise: NoiseModel | None
    kappa: float
    formulation: Formulation
    elm: ElmPanels | DarkestPixel | None
    classes: ClassLevels | None = None
    retrieval: tuple[Array, Array] | None = None

    def at(self, bands: npt.NDArray[np.intp]) -> View:
        """The view of some bands alone, of which all have light."""
        terms = self.terms
        if terms is not None:
            values: dict[str, Any] = {f.name: getattr(terms, f.name) for f in fields(terms)}
            inside: dict[str, Any] = {n: v[bands] for n, v in values.items() if isinstance(v, np.ndarray)}
            terms = replace(terms, **inside)
        classes = self.classes
        if classes is not None:
            classes = replace(classes, means=classes.means[:, bands], variances=classes.variances[:, bands])
        return View(
            terms,
            self.average[bands],
            cut(self.average_covariance, bands),
            None if self.noise is None else self.noise.select(bands),
            self.kappa,
            self.formulation,
            self.elm,
            classes,
            None if self.retrieval is None else (self.retrieval[0][bands], self.retrieval[1][bands]),
        )

    def level(self, reflectance: npt.ArrayLike) -> Array:
        """Mean signal (..., B) of a reflectance (..., B): radiance (3.7), or the reflectance itself."""
        rho = np.asarray(reflectance, dtype=float)
        if self.terms is None:
            return rho
        return mean_radiance(self.terms, rho, self.average, self.formulation)

    def lit_surface(self, mean: Array, covariance: Array, illumination: Illumination | None) -> LitSurface:
        """A target under its own light (ground term of 3.7).

        Raises
        ------
        UsageError : shade in the reflectance domain, or an atmosphere that does not know sky light.
        """
        if illumination is None or (illumination.beam == 1.0 and illumination.sky_view == 1.0):
            return LitSurface(mean, covariance, mean, 1.0)
        if self.terms is None:
            raise UsageError(
                "illumination: shade needs the light of an atmosphere",
                mend="add an atmosphere and a sensor, or give the spectrum as it looks in the shade",
            )
        factor = illumination_factor(self.terms, self.average, illumination.beam, illumination.sky_view)
        shaded = covariance * factor[:, None]
        shaded *= factor
        return LitSurface(mean * factor, shaded, mean * illumination.sky_view, factor)

    def covariance(self, under_sky: Array, covariance: Array, gain: float = 1.0) -> Array:
        """Pixel covariance (B, B) of the signal without sensor noise (3.11); ``under_sky`` (B,) enters D_B."""
        if self.terms is None:
            return covariance
        return radiance_covariance(
            self.terms,
            under_sky,
            covariance,
            self.average,
            self.average_covariance,
            adjacency_gain=gain,
            kappa=self.kappa,
            formulation=self.formulation,
            scratch=self._scratch,
        )

    @cached_property
    def _scratch(self) -> Array:
        return np.empty_like(self.average_covariance)

    def seen(self, level: Array, under_sky: Array, covariance: Array, gain: float = 1.0) -> Array:
        """Pixel covariance (B, B) of the signal with sensor noise (3.11, 3.16-3.19)."""
        result = self.covariance(under_sky, covariance, gain)
        if self.terms is None or self.noise is None:
            return result  # the covariance that was given: nothing is written into it
        result.flat[:: level.size + 1] += self.noise.variance(level)
        return result

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

    def darkest(self) -> Array:
        """(B,) radiance of the darkest of the scene's pixels, for darkest-pixel compensation (before 3.21)."""
        if self.classes is None or not isinstance(self.elm, DarkestPixel):
            raise ValueError("the view has no darkest pixel")
        c, gains = self.classes, self.classes.gains[:, None]
        level = self.level(c.means)
        variance = gains * c.variances * self.slope() ** 2 + self.noise_variance(level)
        around = self.adjacency_weight() * np.diag(self.average_covariance)
        variance = variance + gains * around * self.adjacency_slope(c.means) ** 2
        return darkest_level(c.fractions, level, np.sqrt(variance), self.elm.darkest_pixel)

    def line(self) -> TwoPanelLine:
        """The empirical line (before 3.21); gain 1 and offset 0 where detection runs on the signal itself.

        Bands without light have NaN.
        """
        if self.retrieval is None:
            return self._line
        gain, offset = self.retrieval  # (L - b) / k of the line below is gain rho + offset
        k = self._line.gain / gain
        return TwoPanelLine(k, self._line.offset - k * offset)

    def library_line(self) -> TwoPanelLine:
        """The line of panels that are as stated: what puts the spectra of a library into the image's units."""
        return self._line

    @cached_property
    def _line(self) -> TwoPanelLine:
        bands = self.average.size
        if self.terms is None or self.elm is None:
            return TwoPanelLine(np.ones(bands), np.zeros(bands))
        if isinstance(self.elm, DarkestPixel):
            low, high = self.elm.dark_reflectance, self.elm.panel
            dark = self.darkest()
        else:
            low, high = self.elm.reflectances
            dark = self.level(np.full(bands, low))
        lit = self.lit()
        inner = two_panel_line(dark[lit], self.level(np.full(bands, high))[lit], low, high)
        gain, offset = np.full((2, bands), np.nan)
        gain[lit], offset[lit] = inner.gain, inner.offset
        return TwoPanelLine(gain, offset)
