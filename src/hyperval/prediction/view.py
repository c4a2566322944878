"""How the sensor sees a reflectance, in one setting or in many, in the radiance and in the reflectance domain.

Arrays of one setting are (B,).  Of U settings they are (U, 1, B), or (B,) where all settings share them, so that
the same lines serve both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.processing.elm_model import TwoPanelLine, darkest_level, two_panel_line
from hyperval.scenario import DarkestPixel, ElmPanels
from hyperval.scene.radiance import (
    Formulation,
    adjacency_slope,
    direct_slope,
    illumination_factor,
    mean_radiance,
    radiance_covariance,
)
from hyperval.sensor.noise import NoiseModel, RecordedNoise

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
T = TypeVar("T")


def stacked(items: Sequence[T], bands: int) -> T:
    """U dataclasses as one whose arrays are (U, 1, B), so that levels (U, S, B) go through its formulas.

    What is the same in all stays as it is: numbers, words, arrays that are one object.
    """
    first: Any = items[0]
    changes: dict[str, Any] = {}
    for f in fields(first):
        values = [getattr(item, f.name) for item in items]
        if isinstance(values[0], tuple) and values[0] and isinstance(values[0][0], np.ndarray):
            changes[f.name] = tuple(_joined(list(parts), bands) for parts in zip(*values, strict=True))
        elif isinstance(values[0], np.ndarray | float | int) and not isinstance(values[0], bool):
            changes[f.name] = _joined(values, bands)
    result: T = replace(first, **changes)
    return result


def stacked_noise(models: Sequence[NoiseModel], bands: int) -> NoiseModel:
    """Noise models of U settings as one, those of recorded radiance (:class:`RecordedNoise`) among them."""
    if any(isinstance(m, RecordedNoise) for m in models):
        models = [m if isinstance(m, RecordedNoise) else RecordedNoise(**vars(m)) for m in models]
    return stacked(models, bands)


def _joined(values: list[Any], bands: int) -> Any:
    first = values[0]
    if all(v is first for v in values) or (
        np.ndim(first) == 0 and all(np.ndim(v) == 0 and v == first for v in values)
    ):
        return first
    return np.stack([np.broadcast_to(v, (bands,)) for v in values])[:, None, :]


def on_arrays(value: T, change: Callable[[Any], Any]) -> T:
    """A dataclass with every array in it changed, tuples of arrays included."""
    changes: dict[str, Any] = {}
    for f in fields(value):  # type: ignore[arg-type]
        item = getattr(value, f.name)
        if isinstance(item, tuple) and item and isinstance(item[0], np.ndarray):
            changes[f.name] = tuple(change(x) for x in item)
        elif isinstance(item, np.ndarray) and item.ndim:
            changes[f.name] = change(item)
    return replace(value, **changes)  # type: ignore[type-var]


def rows_of(index: Index | int, size: int) -> Callable[[Any], Any]:
    """What cuts arrays (U, ..., B) of ``size`` settings to some of them; one setting by its number: (B,)."""

    def cut(x: Any) -> Any:
        if x.ndim < 3:
            return x
        if isinstance(index, int | np.integer):
            return x[index if x.shape[0] == size else 0, 0]
        return x[index] if x.shape[0] == size and x.shape[0] > 1 else x

    return cut


@dataclass(frozen=True)
class ClassLevels:
    """What the darkest pixel of a scene follows from.

    (..., M, 1) fractions and gains, (..., M, B) means and variances of reflectance, (..., 1, B) variance of the
    surroundings.
    """

    fractions: Array
    gains: Array
    means: Array
    variances: Array
    around: Array


@dataclass(frozen=True)
class View:
    """Atmosphere, surroundings, sensor and empirical line of one setting or of U.

    Attributes
    ----------
    terms : on the bands; None in the reflectance domain, where reflectance is seen as it is
    average : (..., B) reflectance of the surroundings
    noise : None in the reflectance domain
    kappa : 1/N_eff; (U, 1, 1) of U settings
    formulation : corrected or thesis
    elm : the empirical line or the darkest pixel; None for detection on radiance
    classes : for the darkest pixel
    retrieval : (..., B) each: the line gives gain rho + offset for a reflectance rho, its panels being off; None:
        rho
    """

    terms: AtmosphericTerms | None
    average: Array
    noise: NoiseModel | None
    kappa: float | Array
    formulation: Formulation
    elm: ElmPanels | DarkestPixel | None
    classes: ClassLevels | None = None
    retrieval: tuple[Array, Array] | None = None

    def at(self, bands: Index) -> View:
        """The view of some bands alone."""

        def cut(x: Array) -> Array:
            return x[..., bands] if x.shape[-1] > 1 else x

        return self._changed(cut)

    def arrays(self, size: int) -> list[Array]:
        """Those that have a row for each of ``size`` settings."""
        each: list[Array] = []

        def note(x: Array) -> Array:
            if x.ndim == 3 and x.shape[0] == size:
                each.append(x)
            return x

        self._changed(note)
        return each

    def rows(self, index: Index) -> View:
        """The settings that ``index`` names."""
        return self._changed(rows_of(index, self.average.shape[0]))

    def row(self, number: int) -> View:
        """One setting, its arrays (B,)."""
        cut, size = rows_of(number, self.average.shape[0]), self.average.shape[0]
        kappa = float(self.kappa.reshape(-1)[number]) if isinstance(self.kappa, np.ndarray) else self.kappa
        classes = self.classes
        if classes is not None:
            classes = on_arrays(classes, lambda x: x[number if x.shape[0] == size else 0] if x.ndim == 3 else x)
        return replace(replace(self, classes=None, kappa=kappa)._changed(cut), classes=classes)

    def _changed(self, cut: Callable[[Any], Any]) -> View:
        retrieval = self.retrieval
        return replace(
            self,
            terms=None if self.terms is None else on_arrays(self.terms, cut),
            average=cut(self.average),
            noise=None if self.noise is None else on_arrays(self.noise, cut),
            kappa=cut(self.kappa) if isinstance(self.kappa, np.ndarray) else self.kappa,
            classes=None if self.classes is None else on_arrays(self.classes, cut),
            retrieval=None if retrieval is None else (cut(retrieval[0]), cut(retrieval[1])),
        )

    def level(self, reflectance: npt.ArrayLike) -> Array:
        """Mean signal (..., B) of a reflectance (..., B): radiance (3.7), or the reflectance itself."""
        rho = np.asarray(reflectance, dtype=float)
        if self.terms is None:
            return rho
        return mean_radiance(self.terms, rho, self.average, self.formulation)

    def light(self, beam: float | Array, sky_view: float | Array) -> Array | float:
        """(..., B) light on a target over that in the open (ground term of 3.7); 1 where nothing shades it.

        Raises
        ------
        UsageError : shade in the reflectance domain, or an atmosphere that does not know sky light.
        """
        if np.all(np.asarray(beam) == 1.0) and np.all(np.asarray(sky_view) == 1.0):
            return 1.0
        if self.terms is None:
            raise UsageError(
                "illumination: shade needs the light of an atmosphere",
                mend="add an atmosphere and a sensor, or give the spectrum as it looks in the shade",
            )
        return illumination_factor(self.terms, self.average, beam, sky_view)

    def seen(
        self, level: Array, under_sky: Array, covariance: Array, around: Array, gain: float = 1.0,
        out: Array | None = None, scratch: Array | None = None,
    ) -> Array:  # fmt: skip
        """Pixel covariance (B, B) of the signal with sensor noise (3.11, 3.16-3.19), of one setting.

        ``under_sky`` (B,) enters D_B; ``around`` (B, B) is the covariance of the surroundings.
        """
        if self.terms is None:
            return covariance
        result = radiance_covariance(
            self.terms, under_sky, covariance, self.average, around, adjacency_gain=gain,
            kappa=self.kappa, formulation=self.formulation, out=out, scratch=scratch,  # type: ignore[arg-type]
        )  # fmt: skip
        if self.noise is not None:
            result.flat[:: level.size + 1] += self.noise.variance(level)
        return result

    def noise_variance(self, level: Array) -> Array:
        """Noise variance (..., B) at a signal level (3.16-3.19); zero in the reflectance domain."""
        return np.zeros_like(level) if self.noise is None else self.noise.variance(level)

    def slope(self) -> Array:
        """(..., B) change of the signal per change of the pixel's reflectance (D_A of 3.11)."""
        if self.terms is None:
            return np.ones_like(self.average)
        return direct_slope(self.terms, self.average, self.formulation)

    def through(self, covariance: Array) -> Array:
        """An error (B, B) of the pixel's reflectance as one of the signal, through D_A (3.11)."""
        return covariance if self.terms is None else covariance * np.outer(self.slope(), self.slope())

    def adjacency_slope(self, reflectance: Array) -> Array:
        """(..., B) change of the signal per change of the surroundings (D_B of 3.11)."""
        if self.terms is None:
            return np.zeros_like(reflectance)
        return adjacency_slope(self.terms, reflectance, self.average, self.formulation)

    def adjacency_weight(self) -> float | Array:
        """kappa of (3.11), 1 in the printed form."""
        return self.kappa if self.formulation == "corrected" else 1.0

    def lit(self) -> npt.NDArray[np.bool_]:
        """(..., B) True where light of the ground reaches the sensor."""
        if self.terms is None:
            return np.ones(self.average.shape, bool)
        direct = np.broadcast_to(self.terms.direct, self.average.shape)
        return np.asarray(direct > 1e-9 * direct.max(axis=-1, keepdims=True))

    def darkest(self) -> Array:
        """(..., B) radiance of the darkest of the scene's pixels, for darkest-pixel compensation (before 3.21)."""
        if self.classes is None or not isinstance(self.elm, DarkestPixel):
            raise ValueError("the view has no darkest pixel")
        c = self.classes
        level = self.level(c.means)
        variance = c.gains * c.variances * self.slope() ** 2 + self.noise_variance(level)
        variance = variance + c.gains * self.adjacency_weight() * c.around * self.adjacency_slope(c.means) ** 2
        dark = darkest_level(c.fractions[..., 0], level, np.sqrt(variance), self.elm.darkest_pixel)
        return dark[..., None, :] if self.average.ndim == 3 else dark

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
        shape = self.average.shape
        if self.terms is None or self.elm is None:
            return TwoPanelLine(np.ones(shape), np.zeros(shape))
        if isinstance(self.elm, DarkestPixel):
            low, high = self.elm.dark_reflectance, self.elm.panel
            dark = self.darkest()
        else:
            low, high = self.elm.reflectances
            dark = self.level(np.full(shape[-1], low))
        lit, bright = self.lit(), self.level(np.full(shape[-1], high))
        inner = two_panel_line(np.where(lit, dark, 0.0), np.where(lit, bright, 1.0), low, high)
        return TwoPanelLine(np.where(lit, inner.gain, np.nan), np.where(lit, inner.offset, np.nan))
