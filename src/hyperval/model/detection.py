"""Filters, scores and ROC curves of every target population, in U truths at once (3.21-3.33).

Truths that share light, sensor and classes share their filters: the background's covariance of each is assembled in
packed form, in memory that is reused, and factorised once; products with shared matrices are taken for all truths at
once.  ACE has no closed form: conditional Monte Carlo, one truth after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import scipy  # its parts are loaded where they are first named
from scipy.special import ndtr

from hyperval.data import LINEAR_DETECTORS, Array, Index, Mask
from hyperval.errors import UsageError, needed, refuse
from hyperval.model import roc
from hyperval.model.ace import Exceedance, ace_exceedance, ace_space, ace_threshold, exceedance_at
from hyperval.model.fill import FillDistribution
from hyperval.model.filters import LinearFilter, filter_base
from hyperval.model.radiance import (
    Background,
    Material,
    Retrieved,
    retrieve,
    scene_light,
    select_rows,
    submatrix,
    target_pixels,
    truth_row,
    usable_bands,
)
from hyperval.model.stated import Cached, unique
from hyperval.model.world import World, group_by_files
from hyperval.products import ExceedanceCurve, PredictedProducts, RocCurve, ScoreDistribution, background_of
from hyperval.scenario import Scenario, TargetSubject
from hyperval.spectra.axis import SpectralAxis

RocKey = tuple[str, str, str]


def tile(values: Array, truths: int) -> Array:
    """Values (U or 1, ...) with a row for each truth."""
    return np.broadcast_to(values, (truths, *values.shape[1:]))


def spread(vectors: Array, covariance: Array, stretch: Array | None = None) -> Array:
    """(U, K) v C v^T of vectors (U, K, F); ``stretch`` (U or 1, F or 1) on both sides of C."""
    v = vectors if stretch is None else vectors * stretch[:, None, :]
    product = (v.reshape(-1, v.shape[2]) @ covariance).reshape(v.shape)
    return np.asarray(np.einsum("ukf,ukf->uk", product, v))


def surroundings_variance(classes: Background, vectors: Array) -> Array:
    """(U, K) v Sigma_ave v^T of vectors (U, K, F) (3.11); by the classes where truths differ in them."""
    if not vectors.any():
        return np.zeros(vectors.shape[:2])
    if len(classes.fraction) == len(classes.between) == len(classes.stretch) == 1:
        return spread(vectors, classes.covariance())
    total = np.zeros(vectors.shape[:2])
    for m, covariance in enumerate(classes.covariances):
        between = np.broadcast_to(classes.between[:, m], (len(vectors), vectors.shape[2]))
        square = np.einsum("ukf,uf->uk", vectors, between) ** 2
        total += classes.fraction[:, m, None] * (spread(vectors, covariance, classes.stretch[:, m]) + square)  # (3.11)
    return total


def class_scores(view: Retrieved, filters: LinearFilter) -> tuple[Array, Array]:
    """theta_m and sigma_m (U, J) of the laws of the background's classes (3.27, 3.29).

    A component of a class has its own mean and covariance; noise and surroundings are those of the class.  A linear
    map keeps normal and t laws: the scores have a closed form.
    """
    w, classes, laws = filters.weights, view.classes, view.classes.laws
    owner, truths = np.array([law.owner for law in laws]), len(filters.weights)

    means = (np.einsum("uf,umf->um", w, tile(view.means, truths)) - filters.offset[:, None])[:, owner]  # (3.27)
    variances = np.einsum("uf,umf->um", w**2, tile(view.noise, truths))[:, owner]
    surface_weights = (w * view.slope)[:, None, :]
    for j, law in enumerate(laws):
        gain, stretch = classes.gain[:, law.owner], classes.stretch[:, law.owner]
        variances[:, j] += gain * spread(surface_weights, law.covariance, stretch)[:, 0]
        means[:, j] += np.sqrt(gain) * np.einsum("uf,uf->u", surface_weights[:, 0], tile(stretch * law.offset, truths))
    variances += surroundings_variance(classes, w[:, None, :] * view.adjacency)[:, owner]
    return means, np.sqrt(np.maximum(variances, 0.0))  # (3.29)


# Mean and variance of a score are at most quadratic in the fill, which a cubic spline carries exactly.
FILL_NODES = np.linspace(0.0, 1.0, 9)


@cache
def _fill_spline() -> scipy.interpolate.CubicSpline:
    """A quarter of a second, which spectra alone do not need."""
    return scipy.interpolate.CubicSpline(FILL_NODES, np.eye(FILL_NODES.size))


@dataclass(frozen=True)
class Responses:
    """Score moments against the fill, in R truths.

    Attributes
    ----------
    means : (R, 9) at FILL_NODES (3.26)
    target, host : (R,) score variance of a pixel full of target without its gain, and of host with it
    surroundings : (R, 9) variance by surroundings and noise (3.28)
    error : (R,) standard deviation of the score of a full pixel by the error of the target's spectrum
    fine : (R,) part of ``target`` whose texture is finer than the target's part of a pixel
    """

    means: Array
    target: Array
    host: Array
    surroundings: Array
    error: Array
    fine: Array

    @staticmethod
    def weights(fills: Array) -> Array:
        """(..., 9) weights of the values at FILL_NODES in the value at fills (...)."""
        return np.asarray(_fill_spline()(fills))

    def variances(self, target_gain: Array, rows: Index) -> Array:
        """(n, 9) at FILL_NODES, of n evaluations of given rows (3.28)."""
        f = FILL_NODES
        square = f**2 + self.fine[rows, None] * (f - f**2)
        target = square * (target_gain * self.target[rows])[:, None] + (1.0 - f) ** 2 * self.host[rows, None]
        return np.asarray(target + self.surroundings[rows])  # (3.28)

    def moments(self, fills: Array, target_gain: Array, rows: Index, shift: Array | float = 0.0) -> tuple[Array, Array]:
        """Means and standard deviations (n, K) at fills (n, K) or (1, K), for n evaluations of given rows.

        ``shift`` (n,) : departure of the true target from its spectrum, in standard deviations of the score
        """
        variance, weights = self.variances(target_gain, rows), self.weights(fills)  # (n, 9), (n or 1, K, 9)
        means = (weights * self.means[rows][:, None, :]).sum(axis=2)
        means = means + (np.asarray(shift) * self.error[rows])[:, None] * fills
        return means, np.sqrt(np.clip((weights * variance[:, None, :]).sum(axis=2), 0.0, None))


def target_scores(view: Retrieved, filters: LinearFilter, material: Material, rows: Index) -> Responses:
    """Score statistics of pixels of which the target fills f, at FILL_NODES (3.26, 3.28).

    Var(f) enters by the average over the fill.

    ``rows`` : number of the truth of the classes for each truth of ``material``
    """
    filters, view = filters.rows(rows), view.rows(rows)
    classes, number, w, g = view.classes, material.host, filters.weights, FILL_NODES
    truths, bands = w.shape
    reflectance, noise, adjacency, factor = target_pixels(view, material, g)
    means = np.einsum("uf,ukf->uk", w, tile(reflectance, truths)) - filters.offset[:, None]  # (3.26)
    var = np.einsum("ukf,uf->uk", tile(noise, truths), w**2)  # noise of (3.28)
    # D_B is linear in the reflectance, so that its part of the variance is a square in the fill.
    v = w[:, None, :] * np.concatenate([np.broadcast_to(x, (truths, 1, bands)) for x in adjacency], axis=1)
    parts = surroundings_variance(classes, np.concatenate([v, v[:, :1] + v[:, 1:]], axis=1))
    host, full, summed = parts[:, :1], parts[:, 1:2], parts[:, 2:]
    var = var + (1.0 - g) ** 2 * host + g**2 * full + g * (1.0 - g) * (summed - host - full)
    surface_weights = (w * view.slope)[:, None, :]
    lit_weights, error_sd = surface_weights * factor, np.zeros(truths)
    if material.error is not None:
        error_sd = np.linalg.norm(lit_weights[:, 0] @ material.error.T, axis=1)
    target_spread = spread(lit_weights, material.covariance, material.stretch)[:, 0]
    host_spread = spread(surface_weights, classes.covariances[number], classes.stretch[:, number])[:, 0]
    fine = np.broadcast_to(material.fine_texture, (truths,))
    return Responses(means, target_spread, classes.gain[:, number] * host_spread, var, error_sd, fine)


class Evaluation(Cached):
    """U truths of one scenario as read; quantities are computed at their first use.

    Parameters
    ----------
    world : truths that share the files read (:func:`hyperval.model.world.group_by_files`)
    errors : target -> (K, B) directions of the error of its spectrum
    shift : (U or 1,) departures of the targets from their spectra, in standard deviations of the score

    Attributes
    ----------
    scenario, axis, targets : common to all truths: names and processing, the labelled bands
    light_world, light_index : V truths of distinct light, sensor and classes; the number (U,) of that of each truth
    usable : (V or 1, B) bands that the detectors could use, of these V truths
    probits : of P_D, (U, K) of all truths at the false-alarm probabilities of the curves, filled by :func:`detect`
    problems : truth -> why its filter fails; filled with the filters
    """

    def __init__(self, world: World, errors: Mapping[str, Array] | None = None, shift: Array | float = 0.0):
        self.world, self.stated, self.errors = world, world.stated, errors or {}
        self.scenario, self.axis, self.targets = self.stated.scenario, self.stated.axis, self.stated.targets
        self.shift = np.broadcast_to(shift, (world.size,))
        self.light_world, self.light_index = world.by_light
        self.light = scene_light(self.light_world)
        self.usable = usable_bands(self.light_world, self.light)
        self.cache: dict[Any, Any] = {}
        self.probits: dict[RocKey, Array] = {}
        self.moments: dict[tuple[str, str], Array] = {}
        self.problems: dict[int, UsageError] = {}

    def __len__(self) -> int:
        return self.world.size

    # ---- spectra -------------------------------------------------------------------------------------------

    def radiance(self, subject: str) -> Array:
        """Mean radiance of a class, panel or site in each truth (U, B) (3.7) [uW cm-2 sr-1 nm-1]."""
        i = self.world.surface_number(subject)
        level = self.cached(("radiance", subject), lambda: self.light.signal(self.light_world.mean[:, i : i + 1])[:, 0])
        return self.for_all_truths(level)

    def snr(self, subject: str) -> Array:
        """SNR of a class, panel or site in each truth (U, B) (3.20) [1]."""
        noise, number = needed(self.light.noise, "scenario.noise"), self.world.surface_number(subject)
        level = self.light.signal(self.light_world.mean[:, number : number + 1])
        snr = self.cached(("snr", subject), lambda: noise.snr(level)[:, 0])
        return self.for_all_truths(snr)

    def for_all_truths(self, values: Array) -> Array:
        """(U, ...) of values (V or 1, ...) of the truths of distinct light."""
        return values[self.light_index] if len(values) > 1 else tile(values, len(self))

    # ---- detection -----------------------------------------------------------------------------------------

    @cached_property
    def pfa(self) -> Array:
        """(K,) false-alarm probabilities of the curves."""
        grid = self.scenario.processing.false_alarm_grid
        return roc.false_alarm_grid(grid.lowest, grid.per_decade)

    @cached_property
    def bands(self) -> Index:
        """(F,) of the detectors."""
        return detection_bands(self.scenario, self.axis, self.usable[0])

    @cached_property
    def retrieval(self) -> Retrieved:
        """The classes after the empirical line, in the detectors' bands."""
        return retrieve(self.light, self.light_world, self.bands)

    @cached_property
    def filters(self) -> Mapping[tuple[str, str], tuple[LinearFilter, Array, Array]]:
        """(target, linear detector) -> filters, theta_m, sigma_m (V, J) of the J laws of the classes."""
        view, linear, shape = self.retrieval, self.stated.linear_detectors, (self.light_world.size, self.bands.size)
        wanted = {(t.name, d): view.signatures[t.name] for t in self.targets for d in linear}
        filters = {key: LinearFilter(np.full(shape, np.nan), np.full(shape[0], np.nan)) for key in wanted}
        for v in range(self.light_world.size) if wanted else ():
            try:
                base = filter_base(self.stated, view, v, self.bands)
                designs = [base.design(detector, truth_row(x, v)) for (_, detector), x in wanted.items()]
            except UsageError as error:
                self.problems |= dict.fromkeys(np.flatnonzero(self.light_index == v).tolist(), error)
                continue
            for target, design in zip(filters.values(), designs, strict=True):
                target.weights[v], target.offset[v] = design
        return {key: (f, *class_scores(view, f)) for key, f in filters.items()}

    def material(self, target: int, world: World) -> Material:
        """A target with its host, its light and the error of its spectrum, in some truths."""
        t, bands = self.targets[target], self.bands
        number, stretch = world.surface_number(t.name), world.stretch[:, world.surface_number(t.name)]
        error = self.errors[t.name][:, bands] if t.name in self.errors else None
        covariance = self.stated.cached(
            ("cut", t.name, bands.tobytes()), lambda: submatrix(self.stated.surfaces[t.name].covariance, bands)
        )
        return Material(
            world.mean[:, number, bands], covariance, stretch[:, bands] if stretch.shape[1] > 1 else stretch,
            world.column("fine_texture")[:, number], self.stated.classes.index(t.host), world.column("beam")[:, target],
            world.column("sky_view")[:, target], error, bool(self.stated.of_pixels[number]),
        )  # fmt: skip

    def fills(self, number: int, objects: bool = False) -> FillDistribution:
        """Fills of the pixels of a population, or of the pixels of its objects."""
        if not objects:
            return self.world.pixel_fills[number]
        return self.cached(("fills", number), lambda: self.world.fills(number, True))

    def scores(self, population: str, detector: str, objects: bool = False) -> roc.RocScores | AceScores:
        """Score statistics of a target population in each truth (3.26-3.29), by pixel; ``objects``: by object, which is
        detected when one of its pixels is.

        Raises
        ------
        UsageError : no filter, as the background can not be inverted.
        """
        number, target, _ = self.population(population)
        fills = self.fills(number, objects)
        if objects and fills.shape is None:  # each is one pixel
            return self.scores(population, detector)
        make = self._linear_scores if detector in LINEAR_DETECTORS else self._ace_scores
        return self.cached(("scores", population, detector, objects), lambda: make(target, detector, fills))

    def _ace_scores(self, target: int, detector: str, fills: FillDistribution) -> AceScores:
        pixels = self.cached(("ace", target), lambda: [_ace_pixels(self, u, target) for u in range(len(self))])
        values = fills.values.reshape(len(fills.values), *(fills.shape or (-1, 1)))
        scored = [pixel.any_above(truth_row(values, u), truth_row(fills.weights, u)) for u, pixel in enumerate(pixels)]
        return AceScores(self.pfa, pixels, scored)

    def _linear_scores(self, target: int, detector: str, fills: FillDistribution) -> roc.RocScores:
        rows, response = self.responses(target, detector, target)
        gain = np.broadcast_to(self.world.column("target_gain")[:, target], len(self))
        values = np.nan_to_num(fills.values)
        means, sds = response.moments(values, gain, rows, self.shift)
        means[np.broadcast_to(np.isnan(fills.values), means.shape)] = -np.inf  # no pixel, which never passes
        bare = response.means[rows, 0], response.variances(gain, rows)[:, 0]
        host = self.host(target, detector, np.arange(len(self)), 1.0 - values, *bare)
        if fills.shape is not None:
            means, sds = (x.reshape(-1, *fills.shape) for x in (means, sds))
        return roc.RocScores(*self.classes(target, detector), means, sds, tile(fills.weights, len(self)), host)

    def host(
        self, target: int, detector: str, truths: Index, share: Array, mean: Array, variance: Array
    ) -> roc.Host | None:
        """The host of a target in some truths; None: one normal law in all."""
        laws, parts, _ = self.host_laws(target)
        classes, which = self.classes(target, detector)
        scores = classes.rows(which[truths]).select_laws(laws)
        host = roc.Host(share, mean, variance, replace(scores, fraction=np.broadcast_to(parts, scores.mean.shape)))
        return None if host.is_normal.all() else host

    def host_laws(self, target: int) -> tuple[Index, Array, Array]:
        """(C,) numbers of the background's laws in a target's host, their parts, and (U or 1, C) dof."""
        owner = self.stated.classes.index(self.targets[target].host)
        laws = [j for j, law in enumerate(self.stated.laws) if law.owner == owner]
        return np.array(laws), np.array([self.stated.laws[j].weight for j in laws]), self.world.law_dof[:, laws]

    def classes(self, target: int, detector: str) -> tuple[roc.ClassScores, Index]:
        """Scores of the background's laws for each distinct combination of light, classes and tails."""

        def distinct_scores() -> tuple[roc.ClassScores, Index]:
            _, means, sds = self.filters[self.targets[target].name, detector]
            dof, fraction = self.world.law_dof, self.light_world.law_fraction
            first, which = unique([self.light_index, *(dof.T if len(dof) > 1 else ())], len(self))
            light = self.light_index[first]
            tails, fractions = (tile(select_rows(x, rows), first.size) for x, rows in ((dof, first), (fraction, light)))
            return roc.ClassScores(fractions, means[light], sds[light], tails), which

        return self.cached(("classes", target, detector), distinct_scores)

    def responses(self, looks_for: int, detector: str, holds: int) -> tuple[Index, Responses]:
        """Row (U,) of each truth, and scores against the fill of pixels that hold a target, by the filter of the same
        or another target.
        """

        def filter_responses() -> tuple[Index, Responses]:
            first, rows = self.world.distinct_truths([self.targets[holds].name])
            filters = self.filters[self.targets[looks_for].name, detector][0]
            material = self.material(holds, self.world.rows(first))
            return rows, target_scores(self.retrieval, filters, material, self.light_index[first])

        return self.cached(("responses", looks_for, detector, holds), filter_responses)

    def population(self, name: str) -> tuple[int, int, TargetSubject]:
        """Number of the population of that name and of its target, and its entry in the scenario."""
        for number, (target, _, population) in enumerate(self.stated.populations):
            if population.name == name:
                return number, target, population
        raise UsageError(f"no target population {name!r}")


def evaluations(
    world: World, errors: Mapping[str, Array] | None = None, shift: Array | float = 0.0
) -> list[tuple[Index, Evaluation]]:
    """All truths, grouped by files read and detectors' bands, with the numbers (n,) of those in each group."""
    groups: list[tuple[Index, Evaluation]] = []
    shifts = np.broadcast_to(shift, (world.size,))
    for index, part in group_by_files(world):
        evaluation = Evaluation(part, errors, shifts[index])
        first, group = unique([evaluation.usable], len(evaluation.usable))
        if first.size == 1:
            groups.append((index, evaluation))
            continue
        for i in range(first.size):
            rows = np.flatnonzero(group[evaluation.light_index] == i)
            groups.append((index[rows], Evaluation(part.rows(rows), errors, shifts[index[rows]])))
    return sorted(groups, key=lambda numbered: int(numbered[0][0]))


def detection_bands(scenario: Scenario, axis: SpectralAxis, usable: Mask) -> Index:
    """Indices of the bands that the detectors use (Psi of unit rows, 3.21).

    ``usable`` (B,) is False in bands without light or without a spectrum.  Raises UsageError when no band remains.

    >>> from hyperval.scenario import load_scenario
    >>> clear = load_scenario("panels").with_values({"processing.bands.windows_only": True})
    >>> detection_bands(clear, SpectralAxis([500.0, 1400.0, 1650.0], 10.0), np.ones(3, bool))
    array([0, 2])
    >>> detection_bands(clear, SpectralAxis(np.arange(1.0, 601.0), 1.0), np.ones(600, bool))  # numbers are no nm
    Traceback (most recent call last):
    ...
    hyperval.errors.UsageError: ...
    """
    choice = scenario.processing.bands
    keep = usable.copy()
    if choice.drop_bad:
        keep &= axis.good
    if choice.windows_only:
        keep &= axis.in_windows
    if choice.ranges:
        keep &= np.any([(axis.centre_nm >= a) & (axis.centre_nm <= b) for a, b in choice.ranges], axis=0)
    for name, listed in (("channels", choice.channels), ("bad_channels", choice.bad_channels)):
        top = max(listed or [0])
        refuse(listed and top >= keep.size, "bands.number", name=name, most=top, size=keep.size, last=keep.size - 1)
        if listed:
            in_list = np.isin(np.arange(keep.size), listed)
            keep &= in_list if name == "channels" else ~in_list
    refuse(not keep.any(), "bands.none_left")
    return np.flatnonzero(keep)


# Most of a pixel's draws are plain; the others sample its host's false alarms.
_DECADES = (0.0, 0.0, 0.0, 0.0, 3.0, 6.0)


class AcePixels(NamedTuple):
    """ACE of one target in one truth: exceedance of the background, and of target pixels at some fills."""

    background: Exceedance
    nodes: Array
    at_nodes: list[Exceedance]

    def any_above(self, fills: Array, weights: Array) -> Exceedance:
        """Probability that any of the pixels with ``fills`` (K, n), NaN: none, passes, averaged with ``weights`` (K,).

        >>> pixel = Exceedance(np.array([0.5]), np.array([0.4]), np.zeros(1))
        >>> of_two = AcePixels(pixel, np.array([0.1, 0.2]), [pixel, pixel])
        >>> fills = np.array([[0.1, 0.2], [0.1, np.nan]])
        >>> [of_two.any_above(fills, weights).probability.round(9).tolist() for weights in np.eye(2)]
        [[0.64], [0.4]]
        """
        error = np.max([e.standard_error for e in self.at_nodes], axis=0)
        z = roc.probit([e.probability for e in self.at_nodes])  # (nodes, S)
        distinct, inverse = np.unique(np.nan_to_num(fills).round(6), return_inverse=True)
        table = ndtr(np.stack([np.interp(distinct, self.nodes, row) for row in z.T], axis=1))  # (fills, S)
        missed = np.where(np.isnan(fills)[..., None], 1.0, (1.0 - table)[inverse.reshape(fills.shape)]).prod(axis=1)
        return Exceedance(self.background.scores, 1.0 - weights @ missed, error)


class AceScores(NamedTuple):
    """Scores of one population by ACE in n truths, like :class:`RocScores` of linear detectors.

    Attributes
    ----------
    pfa : (K,) false-alarm probabilities of its curves
    pixels : of each truth;  scored : of the pixels of the population, or of its objects
    """

    pfa: Array
    pixels: Sequence[AcePixels]
    scored: Sequence[Exceedance]

    def thresholds(self, pfa: Array) -> Array:
        """(n, K) thresholds at ``pfa`` (n, K) or (1, K)."""
        pairs = zip(tile(pfa, len(self.pixels)), self.pixels, strict=True)
        return np.array([ace_threshold(p, [1.0], [pixel.background]) for p, pixel in pairs])

    def detection_above(self, thresholds: Array) -> Array:
        """P_D (n, K) above ``thresholds`` (n, K)."""
        return np.array([exceedance_at(x, one) for x, one in zip(thresholds, self.scored, strict=True)])

    def detection(self, pfa: Array) -> Array:
        """P_D (n, K) at ``pfa`` (n, K) or (1, K)."""
        return self.detection_above(self.thresholds(pfa))

    @property
    def curves(self) -> list[RocCurve]:
        """ROC curve of each truth."""
        return [RocCurve(self.pfa, *(pd,) * 4) for pd in self.detection(self.pfa[None])]

    def log10_false_alarm(self, pd: Array) -> Array:
        """log10 P_FA (n,) at which P_D is ``pd`` (n,)."""
        return np.array([roc.log10_false_alarm_at(c, float(p), c.pd) for c, p in zip(self.curves, pd, strict=True)])

    def auc(self, area: roc.RocArea = roc.WHOLE) -> Array:
        """Area under the ROC (n,), or another."""
        return np.array([roc.curve_area(curve, area) for curve in self.curves])

    @property
    def moments(self) -> Array:
        """(2, n, 2) mean and standard deviation of the scores of target pixels, and of the background."""
        return np.array([[x.moments for x in group] for group in (self.scored, [p.background for p in self.pixels])])

    def background(self, at: Index, thresholds: Array, *, densities: bool) -> list[tuple[ScoreDistribution, None]]:
        """Score distributions of the background in some truths, by draws; without the preset P_FA of (3.30)."""
        return [(_score_distribution(self.pixels[u].background), None) for u in at]

    def target(self, at: Index, *, densities: bool) -> list[ScoreDistribution]:
        """Score distributions of the population in some truths."""
        return [_score_distribution(self.scored[u]) for u in at]

    def error_note(self, u: int) -> str:
        """Standard errors of the draws of one truth, in words."""
        host, drawn = self.pixels[u].background, max(float(x.standard_error.max()) for x in self.pixels[u].at_nodes)
        lowest = ace_threshold(self.pfa[0], [1.0], [host])
        index = int(np.searchsorted(host.scores, lowest).clip(0, host.scores.size - 1))
        error = host.standard_error[index] / max(host.probability[index], 1e-300)
        return f"standard error of P_D at most {drawn:.2g}, of P_FA at {self.pfa[0]:.1g} {100 * error:.2g} %"


def _ace_pixels(e: Evaluation, u: int, target: int) -> AcePixels:
    """One truth: exceedance of the background, and of target pixels at nodes over all fills of its populations."""
    processing, named = e.scenario.processing, e.targets[target]
    v, view = int(e.light_index[u]), e.retrieval.rows(e.light_index[u : u + 1])
    base, classes = filter_base(e.stated, e.retrieval, v, e.bands), view.classes
    space = ace_space(base.project(view.signatures[named.name][0]), base.project(base.mean), base.factor)
    slope, surroundings = view.slope[0], e.retrieval.classes.covariance(v)

    def spread_of(surface: Array, d_b: Array, noise: Array) -> Array:
        """(F, F) of pixels of a surface, from that of its reflectance, D_B / k and its noise (3.11-3.21)."""
        return surface * np.outer(slope, slope) + surroundings * np.outer(d_b, d_b) + np.diag(noise)

    def p_above(
        mean: Array, covariance: Array, dof: float, stream: Sequence[int], decades: Sequence[float],
        normal: Array | None = None,
    ) -> Exceedance:  # fmt: skip
        """P(ACE > eta) of pixels with a mean, a covariance with tails, and a normal part."""
        normal = None if normal is None else base.project_covariance(normal)
        return ace_exceedance(
            space, base.project(mean), base.project_covariance(covariance), processing.samples,
            np.random.default_rng([processing.seed, *stream]), None if np.isinf(dof) else dof, decades=decades,
            normal=normal,
        )  # fmt: skip

    fractions, dof = classes.law_fraction[0], truth_row(e.world.law_dof, u)
    decades = np.linspace(0.0, -float(np.log10(e.pfa[0])), 4).tolist()
    exceedances, laws = [], []
    for j, law in enumerate(classes.laws):
        m = law.owner
        gain, stretch = float(classes.gain[0, m]), classes.stretch[0, m] * np.ones(e.bands.size)
        mean = view.means[0, m] + np.sqrt(gain) * slope * stretch * law.offset
        surface = gain * law.covariance * np.outer(stretch, stretch)
        covariance = spread_of(surface, view.adjacency[0, m], view.noise[0, m])
        laws.append((mean, surface, covariance))
        exceedances.append(p_above(mean, covariance, float(dof[j]), [j], decades))
    background = _mixture_exceedance(fractions, exceedances)
    numbers, parts, _ = e.host_laws(target)
    world, number = e.world.rows(np.array([u])), e.stated.classes.index(named.host)
    material = e.material(target, world)
    stretch = classes.stretch[0, number] * np.ones(e.bands.size)
    host = classes.gain[0, number] * classes.covariances[number] * np.outer(stretch, stretch)
    square, shift = np.outer(slope, slope), float(e.shift[u])

    def at_fill(fill: float) -> Exceedance:
        share, (means, noise, (host_db, full_db), lit) = 1.0 - fill, target_pixels(view, material, np.array([fill]))
        mean = means[0, 0]
        if shift and material.error is not None:
            # The true target departs along the filter's own direction, by standard deviations of its score.
            w = base.design("matched-filter", view.signatures[named.name][0]).weights * slope
            gradient = material.error @ w
            mean = mean + shift * fill * (gradient @ material.error / np.linalg.norm(gradient)) * slope
        factor = material.stretch[0] * np.ravel(lit) * np.ones(e.bands.size)
        spread = material.covariance * np.outer(factor, factor) * float(world.target_column("target_gain", target)[0])
        f2 = fill**2 + float(material.fine_texture[0]) * (fill - fill**2)
        d_b = share * host_db[0, 0] + fill * full_db[0, 0]
        covariance = spread_of(f2 * spread + share**2 * host, d_b, noise[0, 0])
        by_law = []
        for k, j in enumerate(numbers):
            # A law of the host differs from its class in mean and spread; its tails are in its own covariance alone.
            law_mean, surface, law_covariance = laws[j]
            total, tailed = covariance + share**2 * (surface - host) * square, np.isfinite(dof[j])
            part = share**2 * law_covariance if tailed else total
            centre = mean + share * (law_mean - view.means[0, number])
            stream = [1_000_003, *([k] if k else [])]
            by_law.append(p_above(centre, part, float(dof[j]), stream, _DECADES, total - part if tailed else None))
        return _mixture_exceedance(parts, by_law)

    # Fills of objects too, even without their curves.
    spread = [i for i, (t, _, _) in enumerate(e.stated.populations) if t == target]
    fill_sets = [truth_row(e.fills(i, objects).values, u) for i in spread for objects in (False, True)]
    fill_sets = [fills[np.isfinite(fills)] for fills in fill_sets]
    ends = sorted({float(end) for fills in fill_sets for end in (fills.min(), fills.max())})
    nodes, asked = {fill: at_fill(fill) for fill in ends}, background.probability >= e.pfa[0]
    gaps = [(a, b) for a, b in pairwise(ends) if any(fills.min() <= a and b <= fills.max() for fills in fill_sets)]
    while gaps:
        low, high = gaps.pop()
        middle = 0.5 * (low + high)
        nodes[middle] = at_fill(middle)
        if high - low > 1e-3 and not _is_linear_in_probit(*(nodes[f].probability[asked] for f in (low, middle, high))):
            gaps += [(low, middle), (middle, high)]
    return AcePixels(background, np.array(sorted(nodes)), [nodes[fill] for fill in sorted(nodes)])


def _is_linear_in_probit(low: Array, middle: Array, high: Array) -> bool:
    """Whether P_D over the fill is linear in probit: the middle of a gap between nodes against its ends.

    Near 0 and 1 the probit saturates, so both the probability and its probit within 3 are compared.  The error of the
    mean over fills of felts of 0.5 to 3 m at 1 m is then 0.002.

    >>> _is_linear_in_probit(*ndtr([[-1.0], [0.0], [1.0]]))
    True
    >>> _is_linear_in_probit(*ndtr([[-3.0], [9.0], [9.0]])), _is_linear_in_probit(*ndtr([[1.0], [9.0], [9.0]]))
    (False, False)
    >>> _is_linear_in_probit(*ndtr([[-2.0], [0.9], [2.0]]))
    False
    """
    ends, clipped = roc.probit([low, high]), roc.probit([low, middle, high]).clip(-3.0, 3.0)
    curvature = np.abs(clipped[[0, 2]].mean(axis=0) - clipped[1])
    return bool(np.all((np.abs(ndtr(ends.mean(axis=0)) - middle) < 0.05) & (curvature < 1.0)))


def _mixture_exceedance(parts: Array, laws: Sequence[Exceedance]) -> Exceedance:
    """Exceedance of a mixture of laws."""
    pairs = list(zip(parts, laws, strict=True))
    error = np.sqrt(sum((part * law.standard_error) ** 2 for part, law in pairs))
    return Exceedance(laws[0].scores, np.asarray(sum(part * law.probability for part, law in pairs)), error)


def _score_distribution(population: Exceedance) -> ScoreDistribution:
    mean, sd = population.moments
    density = np.clip(-np.gradient(population.probability, population.scores), 0.0, None)
    return ScoreDistribution(mean, sd, None, population.scores, density)


def detect(
    e: Evaluation, *, object_curves: bool = True, densities: bool = True, points: Sequence[int] = (0,),
    spectra: Sequence[PredictedProducts] = (),
) -> list[PredictedProducts]:  # fmt: skip
    """Scores and ROC curves of all target populations (3.22-3.33) of some truths; the P_D of all into ``e.probits``,
    mean and spread of their scores into ``e.moments``.

    ``densities`` : also those of the scores;  ``spectra`` : predictions of these truths to which the results are added

    Raises
    ------
    UsageError : no filter, as the background can not be inverted.
    """
    processing, index = e.scenario.processing, np.array(points)
    from_image = (c.spectrum.measured and (not c.covariance or c.covariance.measured) for c in e.scenario.scene.classes)
    n = sum(e.stated.surfaces[c].n or 0 for c in e.stated.classes) or None if all(from_image) else None
    results: list[dict[str, Any]] = [{"scores": {}, "roc": {}, "exceedance": {}, "notes": []} for _ in points]
    for target in e.targets:
        for name in processing.detectors:
            pixels = [e.scores(population.name, name) for population in target.populations]
            for error in e.problems.values():
                raise error
            objects = [e.scores(p.name, name, True) for p in target.populations] if object_curves else pixels
            # All populations of a target share the background's scores.
            pfa, thresholds = e.pfa, pixels[0].thresholds(e.pfa[None])
            backgrounds = pixels[0].background(index, thresholds[index], densities=densities)
            for population, scores, grouped in zip([p.name for p in target.populations], pixels, objects, strict=True):
                pd: dict[Literal["pixel", "object"], Array] = {"pixel": scores.detection_above(thresholds)}
                if object_curves:
                    pd["object"] = pd["pixel"] if grouped is scores else grouped.detection_above(thresholds)
                for unit, curves in pd.items():
                    key, e.probits[population, name, unit] = (population, name, unit), roc.probit(curves)
                    for products, u, (_, preset) in zip(results, points, backgrounds, strict=True):
                        products["roc"][key] = RocCurve(pfa, *(curves[u],) * 3, thresholds[u], unit, preset_pfa=preset)
                e.moments[population, name], e.moments[background_of(population), name] = scores.moments
                rows = zip(results, scores.target(index, densities=densities), backgrounds, strict=True)
                for products, scored, (background, _) in rows:
                    products["scores"][population, name] = scored
                    products["scores"][background_of(population), name] = replace(background, n=n)
            for products, u in zip(results, points, strict=True):
                if isinstance(scores, AceScores):
                    text = f"{name} of {target.name}: {processing.samples} draws per class; {scores.error_note(u)}"
                    products["notes"].append(text)
                else:
                    products["exceedance"][target.name, name] = ExceedanceCurve(thresholds[u, ::-1], *(pfa[::-1],) * 3)
    used = [f"detectors use {e.bands.size} of {len(e.axis)} bands"] if e.targets and processing.detectors else []
    pairs = zip(spectra or [PredictedProducts(e.axis) for _ in points], results, strict=True)
    return [replace(p, **{**new, "notes": (*p.notes, *used, *new["notes"])}) for p, new in pairs]
