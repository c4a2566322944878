"""The background in U settings: what lies on the ground, and what the detector sees of its classes (3.8-3.21)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.prediction.inputs import SurfaceStatistics, cut, without_gaps
from hyperval.prediction.view import ClassLevels, View
from hyperval.processing.elm_model import retrieved_reflectance
from hyperval.processing.packed import packed
from hyperval.scenario import DarkestPixel
from hyperval.scene.mixture import average_reflectance, mixture_covariance

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
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
