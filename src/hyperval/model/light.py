"""From reflectance to what is recorded, and back by the empirical line, of U truths at once (3.7-3.21).

Arrays are (U or 1, S, B): truths, subjects, bands.  Those of one truth alone are (B,): the same lines serve both.
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
from hyperval.model.surfaces import cut, without_gaps
from hyperval.model.world import Law, World
from hyperval.processing.elm import TwoPanelLine, darkest_level, retrieved_reflectance, two_panel_line
from hyperval.processing.packed import add_products, packed
from hyperval.scenario import DarkestPixel, ElmPanels
from hyperval.scene.radiance import (
    Formulation,
    adjacency_slope,
    direct_slope,
    illumination_factor,
    mean_radiance,
    mixture_covariance,
    radiance_covariance,
)
from hyperval.sensor.noise import NoiseModel, RecordedNoise, recorded_noise

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
T = TypeVar("T")


def at_rows(values: Array, index: Index) -> Array:
    """Rows of values (U or 1, ...); what is shared stays."""
    return np.asarray(values[index]) if len(values) > 1 else values


def of_truth(values: Array, u: int) -> Array:
    """The row of one truth, of values (U or 1, ...)."""
    return np.asarray(values[u if len(values) > 1 else 0])


def wide(values: Array, truths: int) -> Array:
    """Values (U or 1, ...) with a row for each truth."""
    return np.broadcast_to(values, (truths, *values.shape[1:]))


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
    if all(v is first for v in values) or (np.ndim(first) == 0 and all(np.ndim(v) == 0 and v == first for v in values)):
        return first
    return np.stack([np.broadcast_to(v, (bands,)) for v in values])[:, None, :]


def _on_arrays(value: T, change: Callable[[Any], Any]) -> T:
    """A dataclass with every array in it changed, tuples of arrays included."""
    changes: dict[str, Any] = {}
    for f in fields(value):  # type: ignore[arg-type]
        item = getattr(value, f.name)
        if isinstance(item, tuple) and item and isinstance(item[0], np.ndarray):
            changes[f.name] = tuple(change(x) for x in item)
        elif isinstance(item, np.ndarray) and item.ndim:
            changes[f.name] = change(item)
        elif isinstance(item, AtmosphericTerms | NoiseModel | ClassLevels):
            changes[f.name] = _on_arrays(item, change)
    return replace(value, **changes)  # type: ignore[type-var]


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
class Light:
    """Atmosphere, surroundings, sensor and empirical line of U truths.

    Attributes
    ----------
    terms : of what is recorded, on the bands
    average : (U or 1, 1, B) reflectance of the surroundings
    noise : None where there is none
    kappa : (U or 1, 1, 1) of (3.11), 1 in the printed form
    formulation : corrected or thesis
    radiant : whether radiance is recorded, and not reflectance itself
    elm : the empirical line or the darkest pixel; None for detection on what is recorded
    classes : for the darkest pixel
    panels : (U or 1, 1, B or 1) factors on the true reflectance of the dark and the bright panel of the line
    retrieval : likewise, gain and offset of what it gives
    """

    terms: AtmosphericTerms
    average: Array
    noise: NoiseModel | None
    kappa: Array
    formulation: Formulation = "corrected"
    radiant: bool = True
    elm: ElmPanels | DarkestPixel | None = None
    classes: ClassLevels | None = None
    panels: tuple[Array, Array] | None = None
    retrieval: tuple[Array, Array] | None = None

    def at(self, bands: Index) -> Light:
        """On some bands alone."""
        return _on_arrays(self, lambda x: x[..., bands] if x.shape[-1] > 1 else x)

    def rows(self, index: Index) -> Light:
        """Of some truths."""
        return _on_arrays(self, lambda x: at_rows(x, index) if x.ndim == 3 else x)

    def row(self, number: int) -> Light:
        """Of one truth, its arrays (B,)."""
        classes = self.classes and _on_arrays(self.classes, lambda x: of_truth(x, number))
        one = _on_arrays(replace(self, classes=None), lambda x: of_truth(x, number)[0] if x.ndim == 3 else x)
        return replace(one, classes=classes)

    def level(self, reflectance: npt.ArrayLike) -> Array:
        """Mean signal (..., B) of a reflectance (..., B) (3.7)."""
        return mean_radiance(self.terms, np.asarray(reflectance, dtype=float), self.average, self.formulation)

    def shade(self, beam: float | Array, sky_view: float | Array) -> Array | float:
        """(..., B) light on a target over that in the open (ground term of 3.7); 1 where nothing shades it.

        Raises
        ------
        UsageError : shade in the reflectance domain, or an atmosphere that does not know sky light.
        """
        if np.all(np.asarray(beam) == 1.0) and np.all(np.asarray(sky_view) == 1.0):
            return 1.0
        if not self.radiant:
            raise UsageError(
                "illumination: shade needs the light of an atmosphere",
                mend="add an atmosphere and a sensor, or give the spectrum as it looks in the shade",
            )
        return illumination_factor(self.terms, self.average, beam, sky_view)

    def pixel_covariance(
        self, level: Array, under_sky: Array, covariance: Array, around: Array, gain: float = 1.0,
        out: Array | None = None, scratch: Array | None = None,
    ) -> Array:  # fmt: skip
        """Pixel covariance (B, B) of the signal with sensor noise (3.11, 3.16-3.19), of one truth.

        ``under_sky`` (B,) enters D_B; ``around`` (B, B) is the covariance of the surroundings.
        """
        if not self.radiant:
            return covariance
        result = radiance_covariance(
            self.terms, under_sky, covariance, self.average, around, adjacency_gain=gain,
            kappa=float(self.kappa.reshape(-1)[0]), formulation=self.formulation, out=out, scratch=scratch,
        )  # fmt: skip
        if self.noise is not None:
            result.flat[:: level.size + 1] += self.noise.variance(level)
        return result

    def noise_variance(self, level: Array) -> Array:
        """Noise variance (..., B) at a signal level (3.16-3.19)."""
        return np.zeros_like(level) if self.noise is None else self.noise.variance(level)

    def slope(self) -> Array:
        """(..., B) change of the signal per change of the pixel's reflectance (D_A of 3.11)."""
        return direct_slope(self.terms, self.average, self.formulation)

    def through(self, covariance: Array) -> Array:
        """An error (B, B) of the pixel's reflectance as one of the signal, through D_A (3.11)."""
        return covariance * np.outer(self.slope(), self.slope()) if self.radiant else covariance

    def adjacency_slope(self, reflectance: Array) -> Array:
        """(..., B) change of the signal per change of the surroundings (D_B of 3.11)."""
        return adjacency_slope(self.terms, reflectance, self.average, self.formulation)

    def lit(self) -> npt.NDArray[np.bool_]:
        """(..., B) True where light of the ground reaches the sensor."""
        return np.asarray(self.terms.direct > 1e-9 * self.terms.direct.max(axis=-1, keepdims=True))

    def darkest(self) -> Array:
        """(..., B) radiance of the darkest of the scene's pixels, for darkest-pixel compensation (before 3.21)."""
        if self.classes is None or not isinstance(self.elm, DarkestPixel):
            raise ValueError("there is no darkest pixel")
        c = self.classes
        level = self.level(c.means)
        variance = c.gains * c.variances * self.slope() ** 2 + self.noise_variance(level)
        variance = variance + c.gains * self.kappa * c.around * self.adjacency_slope(c.means) ** 2
        sds = np.sqrt(variance)
        dark = darkest_level(np.broadcast_to(c.fractions[..., 0], sds.shape[:-1]), level, sds, self.elm.darkest_pixel)
        return dark[..., None, :] if self.average.ndim == 3 else dark

    def line(self) -> TwoPanelLine:
        """The empirical line (before 3.21); gain 1 and offset 0 where detection runs on the signal itself.

        Bands without light have NaN.
        """
        line = self.library_line if self.panels is None else self._line_of(*self.panels)
        if self.retrieval is None:
            return line
        gain, offset = self.retrieval  # (L - b) / k of the line of the panels is gain rho + offset
        k = line.gain / gain
        return TwoPanelLine(k, line.offset - k * offset)

    @cached_property
    def library_line(self) -> TwoPanelLine:
        """The line of panels that are as stated: what puts the spectra of a library into the image's units."""
        if self.elm is None or not self.radiant:
            return TwoPanelLine(np.ones(self.average.shape), np.zeros(self.average.shape))
        return self._line_of(1.0, 1.0)

    def _line_of(self, dark_panel: float | Array, bright_panel: float | Array) -> TwoPanelLine:
        """The line where the panels truly reflect so many times what they are taken for."""
        if self.elm is None:
            raise ValueError("there is no empirical line")
        bands = self.average.shape[-1]
        if isinstance(self.elm, DarkestPixel):
            low, high = self.elm.dark_reflectance, self.elm.panel
            dark = self.darkest()
        else:
            low, high = self.elm.reflectances
            dark = self.level(np.full(bands, low) * dark_panel)
        lit, bright = self.lit(), self.level(np.full(bands, high) * bright_panel)
        inner = two_panel_line(np.where(lit, dark, 0.0), np.where(lit, bright, 1.0), low, high)
        return TwoPanelLine(np.where(lit, inner.gain, np.nan), np.where(lit, inner.offset, np.nan))


def light_of(world: World) -> Light:
    """L' = g [p e L_a + q e (A rho + B rho_ave) / (1 - S rho_ave)] + o of all truths, rho_ave by (3.8).

    Factors p of the path, q of the ground, e of the irradiance and the recorded gain g and offset o go into L_a, A, B.

    Raises
    ------
    EngineError : the atmosphere engine failed.
    """
    stated, processing = world.stated, world.stated.scenario.processing
    classes, bands, radiant = len(stated.classes), len(stated.axis), stated.scenario.atmosphere is not None

    def factor(name: str) -> Array:
        return np.asarray(world.column(name)[:, None, :])

    terms = stated.atmosphere({p: v for p, _, v in world.fields("atmosphere")}, world.size)
    e, g, offset = factor("irradiance"), factor("gain"), factor("offset")
    if radiant:
        seen, white = g * e * factor("ground"), terms.diffuser_radiance
        terms = replace(
            terms,
            path_radiance=g * (e * factor("path") * terms.path_radiance + factor("path_error")) + offset,
            direct=seen * terms.direct,
            adjacency=seen * terms.adjacency,
            spherical_albedo=factor("albedo") * terms.spherical_albedo,
            ground_irradiance=e * terms.ground_irradiance,
            diffuser_radiance=None if white is None else e * white,
        )
    means = np.apply_along_axis(without_gaps, -1, world.mean[:, :classes])
    average = np.matmul(world.fraction[:, None, :], means)  # (3.8)
    if stated.surroundings is not None:
        average = stated.surroundings[None, None, :]
    models, which = world.sensor_noise()
    noise = None
    if models:
        noise = models[0]
        if len(models) > 1:
            noise = _on_arrays(stacked_noise(models, bands), lambda x: x[which] if x.ndim == 3 else x)
        noise = recorded_noise(noise, gain=g, offset=offset, factor=factor("noise"), signal_factor=factor("electrons"))
    panels, retrieval = (factor("dark"), factor("bright")), (factor("line_gain"), factor("line_offset"))
    elm, levels = None if processing.elm == "none" else processing.elm, None
    if isinstance(elm, DarkestPixel) and radiant:
        on_ground = Background.of(world, np.arange(bands))
        levels = ClassLevels(
            on_ground.fraction[:, :, None], on_ground.gain[:, :, None], on_ground.means, on_ground.variances(),
            on_ground.around()[:, None, :],
        )  # fmt: skip
    return Light(
        terms,
        average * factor("surroundings"),
        noise,
        world.kappa,
        stated.scenario.formulation,
        radiant,
        elm,
        levels,
        panels if any(np.any(x != 1.0) for x in panels) else None,
        retrieval if np.any(retrieval[0] != 1.0) or np.any(retrieval[1]) else None,
    )


def spread(vectors: Array, covariance: Array, stretch: Array | None = None) -> Array:
    """(U, K) v C v^T of vectors (U, K, F); ``stretch`` (U or 1, F or 1) on both sides of C."""
    v = vectors if stretch is None else vectors * stretch[:, None, :]
    product = (v.reshape(-1, v.shape[2]) @ covariance).reshape(v.shape)
    return np.asarray(np.einsum("ukf,ukf->uk", product, v))


@dataclass(frozen=True, eq=False)
class Background:
    """The classes of U truths, on some bands.

    Attributes
    ----------
    fraction, gain : (U or 1, M) f_m, g_m
    means, between : (U or 1, M, F) rho_m, and how far they are from their average
    covariances : M times (F, F);  stretch : (U or 1, M, F or 1) factors on both sides of them
    laws : what the classes are distributed as;  law_fraction : (U or 1, J) of them
    kept : what follows from the covariances alone
    """

    fraction: Array
    gain: Array
    means: Array
    between: Array
    covariances: tuple[Array, ...]
    stretch: Array
    laws: tuple[Law, ...]
    law_fraction: Array
    kept: dict[Any, Any]

    @staticmethod
    def of(world: World, bands: Index) -> Background:
        """Of a world."""
        stated, classes = world.stated, len(world.stated.classes)
        key = "background", bands.tobytes()
        if key not in stated.kept:
            covariances = tuple(cut(stated.surfaces[n].covariance, bands) for n in stated.classes)
            laws = tuple(
                law._replace(
                    offset=None if law.offset is None else law.offset[bands], covariance=cut(law.covariance, bands)
                )
                for law in stated.laws
            )
            stated.kept[key] = covariances, laws, {}
        covariances, laws, kept = stated.kept[key]
        means = np.apply_along_axis(without_gaps, -1, world.mean[:, :classes])
        between = means - np.matmul(world.fraction[:, None, :], means)
        stretch = world.stretch[:, :classes]
        return Background(
            world.fraction, world.column("class_gain"), world.mean[:, :classes, bands], between[..., bands],
            covariances, stretch[..., bands] if stretch.shape[-1] > 1 else stretch, laws, world.law_fraction, kept,
        )  # fmt: skip

    def rows(self, index: Index) -> Background:
        """Of some truths."""
        of_truths = ("fraction", "gain", "means", "between", "stretch", "law_fraction")
        changes: dict[str, Any] = {n: at_rows(getattr(self, n), index) for n in of_truths}
        return replace(self, **changes)

    def _alike(self) -> bool:
        return len(self.fraction) == len(self.between) == len(self.stretch) == 1

    def covariance(self, u: int = 0) -> Array:
        """(F, F) Sigma_ave of (3.11)."""
        key = "covariance", self._key(u)
        if self.kept.get("covariance", ("",))[0] != key:
            f, between, stretch = (of_truth(x, u) for x in (self.fraction, self.between, self.stretch))
            pairs = zip(stretch, self.covariances, strict=True)
            own = [c * (g[0] ** 2 if g.size == 1 else np.outer(g, g)) for g, c in pairs]
            total = mixture_covariance(f, between, own)
            self.kept["covariance"] = key, total
        matrix: Array = self.kept["covariance"][1]
        return matrix

    def _key(self, u: int) -> bytes:
        return b"".join(of_truth(x, u).tobytes() for x in (self.fraction, self.between, self.stretch))

    def surroundings(self, vectors: Array) -> Array:
        """v Sigma_ave v^T (U, K) of vectors (U, K, F) (3.11); by the classes where truths differ in them."""
        if not vectors.any():
            return np.zeros(vectors.shape[:2])
        if self._alike():
            return spread(vectors, self.covariance())
        total = np.zeros(vectors.shape[:2])
        for m, covariance in enumerate(self.covariances):
            between = np.broadcast_to(self.between[:, m], (len(vectors), vectors.shape[2]))
            away = np.einsum("ukf,uf->uk", vectors, between) ** 2
            total += self.fraction[:, m, None] * (spread(vectors, covariance, self.stretch[:, m]) + away)  # (3.11)
        return total

    def variances(self) -> Array:
        """(U or 1, M, F) diagonals of the covariances of the classes."""
        return np.asarray(np.array([np.diag(c) for c in self.covariances]) * self.stretch**2)

    def around(self) -> Array:
        """(U or 1, F) the diagonal of Sigma_ave."""
        return np.asarray(np.matmul(self.fraction[:, None, :], self.variances() + self.between**2)[:, 0])

    def packed(self, weights: Array, u: int) -> Array:
        """(P,) sum over classes of w_m Sigma_m of one truth, packed; kept while it stays."""
        stretch = of_truth(self.stretch, u)
        key = weights.tobytes() + stretch.tobytes()
        if self.kept.get("packed", ("",))[0] != key:
            if "stack" not in self.kept:
                self.kept["stack"] = np.array([packed(c) for c in self.covariances])
            stack = self.kept["stack"]
            if stretch.shape[1] == 1:
                total = (weights * stretch[:, 0] ** 2) @ stack
            else:
                total = sum(w * packed(np.outer(g, g)) * c for w, g, c in zip(weights, stretch, stack, strict=True))
            self.kept["packed"] = key, total
        values: Array = self.kept["packed"][1]
        return values

    def packed_surroundings(self, u: int) -> Array:
        """(P,) Sigma_ave of (3.11) of one truth, packed; kept while it stays."""
        key = self._key(u)
        if self.kept.get("around", ("",))[0] != key:
            f, between = (of_truth(x, u) for x in (self.fraction, self.between))
            within = self.packed(f, u).copy()
            self.kept["around"] = key, add_products(within, np.sqrt(f)[:, None] * between)
        values: Array = self.kept["around"][1]
        return values


@dataclass(frozen=True)
class Seen:
    """The classes after the empirical line, on the detector's bands, (U or 1, ...) each.

    Attributes
    ----------
    gain, offset : (U or 1, 1, F) of the empirical line
    slope : (U or 1, F) D_A / k of (3.11)
    around : (U or 1, M, F) D_B / k times the root of g_m kappa, of (3.11)
    means : (U or 1, M, F) retrieved reflectances
    noise : (U or 1, M, F) noise variances of the retrieved reflectances
    """

    gain: Array
    offset: Array
    slope: Array
    around: Array
    means: Array
    noise: Array

    def rows(self, index: Index) -> Seen:
        """Of some truths."""
        return Seen(*(at_rows(x, index) for x in vars(self).values()))


def seen_classes(light: Light, background: Background) -> Seen:
    """What the detector sees of the classes (3.7-3.21), both on its bands."""
    line, reflectance = light.line(), background.means
    level = light.level(reflectance)
    weight = np.sqrt(background.gain[:, :, None] * light.kappa)
    around = light.adjacency_slope(reflectance) / line.gain * weight
    noise = light.noise_variance(level) / line.gain**2
    slope = np.ascontiguousarray((light.slope() / line.gain)[:, 0])
    return Seen(line.gain, line.offset, slope, around, retrieved_reflectance(line, level), noise)
