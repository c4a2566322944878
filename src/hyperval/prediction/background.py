"""The background in U settings: what lies on the ground, and what the detector sees of its classes (3.8-3.21).

How the sensor sees a reflectance, in one setting or in many, in the radiance and in the reflectance domain.

Arrays of one setting are (B,).  Of U settings they are (U, 1, B), or (B,) where all settings share them, so that
the same lines serve both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.terms import AtmosphericTerms
from hyperval.errors import UsageError
from hyperval.prediction.inputs import SurfaceStatistics, cut, without_gaps
from hyperval.processing.elm import TwoPanelLine, darkest_level, retrieved_reflectance, two_panel_line
from hyperval.processing.packed import packed
from hyperval.scenario import DarkestPixel, ElmPanels
from hyperval.scene.radiance import (
    Formulation,
    adjacency_slope,
    average_reflectance,
    direct_slope,
    illumination_factor,
    mean_radiance,
    mixture_covariance,
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
    if all(v is first for v in values) or (np.ndim(first) == 0 and all(np.ndim(v) == 0 and v == first for v in values)):
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
    retrieval : (..., B) each: factors on the true reflectance of the dark and the bright panel of the line, gain
        and offset of what it gives; None: nothing is off
    """

    terms: AtmosphericTerms | None
    average: Array
    noise: NoiseModel | None
    kappa: float | Array
    formulation: Formulation
    elm: ElmPanels | DarkestPixel | None
    classes: ClassLevels | None = None
    retrieval: tuple[Array, ...] | None = None

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
            retrieval=None if retrieval is None else tuple(cut(x) for x in retrieval),
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
        *panels, gain, offset = self.retrieval  # (L - b) / k of the line of the panels is gain rho + offset
        line = self._line if np.all(np.array(panels) == 1.0) else self._line_of(*panels)
        k = line.gain / gain
        return TwoPanelLine(k, line.offset - k * offset)

    def library_line(self) -> TwoPanelLine:
        """The line of panels that are as stated: what puts the spectra of a library into the image's units."""
        return self._line

    @cached_property
    def _line(self) -> TwoPanelLine:
        if self.terms is None or self.elm is None:
            return TwoPanelLine(np.ones(self.average.shape), np.zeros(self.average.shape))
        return self._line_of(1.0, 1.0)

    def _line_of(self, dark_panel: float | Array, bright_panel: float | Array) -> TwoPanelLine:
        """The line where the panels truly reflect so many times what they are taken for."""
        shape = self.average.shape
        if self.elm is None:
            raise ValueError("there is no empirical line")
        if isinstance(self.elm, DarkestPixel):
            low, high = self.elm.dark_reflectance, self.elm.panel
            dark = self.darkest()
        else:
            low, high = self.elm.reflectances
            dark = self.level(np.full(shape[-1], low) * dark_panel)
        lit, bright = self.lit(), self.level(np.full(shape[-1], high) * bright_panel)
        inner = two_panel_line(np.where(lit, dark, 0.0), np.where(lit, bright, 1.0), low, high)
        return TwoPanelLine(np.where(lit, inner.gain, np.nan), np.where(lit, inner.offset, np.nan))


_MATRICES = 16  # more grounds than that do not get a Sigma_ave each


@dataclass(frozen=True, eq=False)
class Law:
    """A class of the background, or one component of it.

    Attributes
    ----------
    owner : number of the class
    weight : part of the class
    offset : (B,) of its mean from that of the class; None: the class itself
    covariance : (B, B)
    dof : degrees of freedom of a component; those of a class stand elsewhere
    """

    owner: int
    weight: float
    offset: Array | None
    covariance: Array
    dof: float = np.inf


@dataclass(frozen=True, eq=False)
class Ground:
    """Surfaces of the scene with the classes' area fractions.

    Attributes
    ----------
    surfaces : name -> statistics of every class, panel, site and target
    classes : names of the M classes
    fractions, average : (M,) f_m, (B,) rho_ave of (3.8)
    origin : a ground of the same classes and fractions, and those of its bands that these are; None: the first
    room : what grounds of the same surfaces share
    """

    surfaces: Mapping[str, SurfaceStatistics]
    classes: tuple[str, ...]
    fractions: Array
    average: Array
    origin: tuple[Ground, Index] | None = None
    room: dict[bytes, Any] = field(default_factory=dict)

    @cached_property
    def means(self) -> Array:
        """(M, B) of the classes."""
        return np.array([self.surfaces[n].mean for n in self.classes])

    @cached_property
    def covariances(self) -> tuple[Array, ...]:
        """M times (B, B)."""
        return tuple(self.surfaces[n].covariance for n in self.classes)

    @cached_property
    def laws(self) -> tuple[Law, ...]:
        """What the scores of the classes are distributed as: a class each, or the components of a mixture."""
        out = []
        for m, name in enumerate(self.classes):
            surface, parts = self.surfaces[name], self.surfaces[name].components
            if parts is None:
                out.append(Law(m, 1.0, None, surface.covariance))
                continue
            out += [
                Law(m, float(w), offset, covariance, parts.dof)
                for w, offset, covariance in zip(parts.weights, parts.offsets, parts.covariances, strict=True)
            ]
        return tuple(out)

    @property
    def stack(self) -> Array:
        """(M, P) the same, packed."""
        if self.origin is not None and self.origin[1].size == self.origin[0].average.size:
            return self.origin[0].stack
        if b"" not in self.room:
            self.room[b""] = np.array([packed(c) for c in self.covariances])
        stack: Array = self.room[b""]
        return stack

    @cached_property
    def covariance(self) -> Array:
        """(B, B) Sigma_ave of (3.11)."""
        if self.origin is not None:
            return cut(self.origin[0].covariance, self.origin[1])
        return mixture_covariance(self.fractions, [without_gaps(m) for m in self.means], self.covariances)

    @cached_property
    def between(self) -> Array:
        """(M, B) how far the classes are from their average."""
        return np.array([without_gaps(m) for m in self.means]) - self.average

    def variances(self) -> Array:
        """(B,) the diagonal of Sigma_ave."""
        return self.fractions @ (np.array([np.diag(c) for c in self.covariances]) + self.between**2)

    def at(self, bands: Index, needed: Sequence[str]) -> Ground:
        """The surfaces ``needed`` on some bands alone; for the latest set of bands they are kept in ``room``."""
        key = bands.tobytes()
        if key not in self.room:
            self.room.clear()
            of = {
                n: replace(
                    s,
                    mean=s.mean[bands],
                    covariance=cut(s.covariance, bands),
                    components=s.components and s.components.at(bands),
                )
                for n, s in self.surfaces.items()
                if n in needed
            }
            self.room[key] = of, {}
        of, room = self.room[key]
        return Ground(of, self.classes, self.fractions, self.average[bands], (self, bands), room)


def ground_of(
    surfaces: Mapping[str, SurfaceStatistics], classes: Sequence[str], fractions: Array, like: Sequence[Ground] = ()
) -> Ground:
    """Averages over the classes for area fractions (M,) (3.8, 3.11).

    ``like`` : grounds of the same fractions, whose averages are taken over where the classes are the same too

    Raises
    ------
    UsageError : fractions that do not sum to 1.
    """
    names = tuple(classes)
    for other in like:
        if all(other.surfaces[n].mean is surfaces[n].mean for n in names) and all(
            other.surfaces[n].covariance is surfaces[n].covariance for n in names
        ):
            return Ground(surfaces, names, fractions, other.average, (other, np.arange(other.average.size)))
    means = np.array([without_gaps(surfaces[n].mean) for n in names])
    return Ground(surfaces, names, fractions, average_reflectance(fractions, means))


@dataclass(frozen=True, eq=False)
class Settings:
    """U settings of light, sensor and ground.

    Attributes
    ----------
    view : of arrays (U, 1, B), or that go with it
    fractions, gains : (U, M) f_m, g_m
    grounds : the different ones;  which (U,) of them each setting has
    """

    view: View
    fractions: Array
    gains: Array
    grounds: tuple[Ground, ...]
    which: Index

    def __len__(self) -> int:
        return self.which.size

    def levels(self, reflectances: Array) -> Array:
        """Mean signal (U, S, B) of reflectances (S, B) or (U, S, B) (3.7)."""
        return np.broadcast_to(self.view.level(reflectances), (len(self), *reflectances.shape[-2:]))

    def means(self, names: Sequence[str]) -> Array:
        """(U or 1, S, B) mean reflectances of S surfaces."""
        each = [np.array([g.surfaces[n].mean for n in names]) for g in self.grounds]
        return each[0][None] if len(each) == 1 else np.array(each)[self.which]

    def class_means(self) -> Array:
        """(U or 1, M, B) mean reflectances of the classes."""
        grounds = self.grounds
        return grounds[0].means[None] if len(grounds) == 1 else np.array([g.means for g in grounds])[self.which]

    def law_fractions(self) -> Array:
        """(U, J) area fractions of the laws that the classes are made of (3.33)."""
        laws = self.grounds[0].laws
        owner, part = np.array([law.owner for law in laws]), np.array([law.weight for law in laws])
        return np.asarray(self.fractions[:, owner] * part)

    def alike(self, names: Sequence[str] = ()) -> Index:
        """(U,) the same number for settings of one light, sensor, fractions, classes and surfaces ``names``."""
        parts = [self.fractions, self.gains, *self.view.arrays(len(self))]
        each = [
            (*(id(g.surfaces[n]) for n in (*g.classes, *names)), g.average.tobytes()) for g in self.grounds
        ]  # surfaces that did not move are the same objects
        codes: dict[Any, int] = {}
        keys = [(each[w], *(p[u].tobytes() for p in parts)) for u, w in enumerate(self.which)]
        return np.array([codes.setdefault(key, len(codes)) for key in keys])

    def rows(self, index: Index) -> Settings:
        """The settings that ``index`` names."""
        if index.size == len(self) and np.array_equal(index, np.arange(len(self))):
            return self
        return replace(
            self,
            view=self.view.rows(index),
            fractions=self.fractions[index],
            gains=self.gains[index],
            which=self.which[index],
        )

    def at(self, bands: Index, needed: Sequence[str]) -> Settings:
        """The settings on some bands alone, with the surfaces ``needed``."""
        return replace(self, view=self.view.at(bands), grounds=tuple(g.at(bands, needed) for g in self.grounds))

    def spread(self, vectors: Array, covariance: Callable[[Ground], Array]) -> Array:
        """v C v^T (U, K) of vectors (U, K, B), each setting with the covariance C of its own ground."""
        parts = np.zeros(vectors.shape[:2])
        if not vectors.any():
            return parts
        matrices = [covariance(g) for g in self.grounds]
        first: dict[int, int] = {}
        codes = np.array([first.setdefault(id(c), i) for i, c in enumerate(matrices)])[self.which]
        order = np.argsort(codes, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(codes[order])) + 1):
            v = vectors[rows]
            product = (v.reshape(-1, v.shape[2]) @ matrices[codes[rows[0]]]).reshape(v.shape)
            parts[rows] = np.einsum("ukf,ukf->uk", product, v)
        return parts

    def surroundings(self, vectors: Array) -> Array:
        """v Sigma_ave v^T (U, K) of vectors (U, K, B), by the classes where no ground has a matrix of its own."""
        if len(self.grounds) <= _MATRICES:
            return self.spread(vectors, lambda g: g.covariance)
        parts = np.zeros(vectors.shape[:2])
        fractions = np.array([g.fractions for g in self.grounds])[self.which]
        for m in range(fractions.shape[1]):

            def covariance(ground: Ground, number: int = m) -> Array:
                return ground.covariances[number]

            away = np.array([g.between[m] for g in self.grounds])[self.which]
            within = self.spread(vectors, covariance)
            parts += fractions[:, m, None] * (within + np.einsum("ukf,uf->uk", vectors, away) ** 2)  # (3.11)
        return parts


def with_class_levels(settings: Settings) -> Settings:
    """The settings whose view knows what the darkest pixel of the scene follows from, where it is asked for."""
    view = settings.view
    if not isinstance(view.elm, DarkestPixel):
        return settings
    variances = np.array([[np.diag(c) for c in g.covariances] for g in settings.grounds])[settings.which]
    around = np.array([g.variances() for g in settings.grounds])[settings.which][:, None, :]
    fractions, gains = settings.fractions[:, :, None], settings.gains[:, :, None]
    means = np.broadcast_to(settings.class_means(), variances.shape)
    return replace(settings, view=replace(view, classes=ClassLevels(fractions, gains, means, variances, around)))


@dataclass(frozen=True)
class Seen:
    """The classes after the empirical line, on the detector's bands, in U settings.

    Attributes
    ----------
    gain, offset : (U, 1, F) of the empirical line
    slope : (U, F) D_A / k of (3.11)
    around : (U, M, F) D_B / k times the root of g_m kappa, of (3.11)
    means : (U, M, F) retrieved reflectances
    noise : (U, M, F) noise variances of the retrieved reflectances
    """

    gain: Array
    offset: Array
    slope: Array
    around: Array
    means: Array
    noise: Array

    def rows(self, index: Index) -> Seen:
        """The settings that ``index`` names."""
        return Seen(*(getattr(self, n)[index] for n in ("gain", "offset", "slope", "around", "means", "noise")))


def seen_classes(at: Settings) -> Seen:
    """What the detector sees of the classes (3.7-3.21); ``at`` on its bands."""
    view, line = at.view, at.view.line()
    reflectance = at.class_means()
    level = at.levels(reflectance)
    shape = (len(at), level.shape[2])
    slope = np.broadcast_to(view.slope() / line.gain, (shape[0], 1, shape[1]))[:, 0]
    weight = at.gains[:, :, None] * view.adjacency_weight()
    around = view.adjacency_slope(np.broadcast_to(reflectance, level.shape)) / line.gain * np.sqrt(weight)
    noise = view.noise_variance(level) / line.gain**2
    return Seen(
        np.broadcast_to(line.gain, (shape[0], 1, shape[1])),
        np.broadcast_to(line.offset, (shape[0], 1, shape[1])),
        np.ascontiguousarray(slope),
        around,
        retrieved_reflectance(line, level),
        noise,
    )
