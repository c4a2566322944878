"""What a whole object scores: draws of the greatest score over its pixels, the inputs' uncertainty included.

The score of a pixel follows from its fills by (3.26) and (3.28); which fills the pixels of an object have, from its
place on the pixel grid; and what all objects have in common, from draws of the uncertain inputs.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hyperval.prediction.batch import Batch, Group
from hyperval.prediction.fills import fill_distribution, fills_of_objects, geometry_of, moments, pixels_of_object
from hyperval.prediction.input_draws import ROWS, InputDraws, input_draws
from hyperval.prediction.responses import FILL_NODES, Responses
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.products import ObjectScores
from hyperval.scenario import Geometry, Target, TargetSubject
from hyperval.scene.fill import PHASES, Neighbour, shared_pixel_fills

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Key = tuple[str, str]

COLUMNS = 24  # draws of objects at each of those of the inputs
_TOGETHER = 32  # draws of the inputs at once: what a cache holds
# Other targets count up to this far beyond the corners of both [pixels]: four sigma of a blur of 1.5 pixels.
_REACH = 3.0


@dataclass(frozen=True)
class Response:
    """Mean and variance of a score against the fill (3.26, 3.28), for one target and one filter."""

    mean: CubicSpline
    variance: CubicSpline

    @staticmethod
    def through(means: Array, variances: Array) -> Response:
        """The response that takes values (9,) at FILL_NODES."""
        from scipy.interpolate import CubicSpline  # a quarter of a second, which spectra alone do not need

        return Response(CubicSpline(FILL_NODES, means), CubicSpline(FILL_NODES, variances))

    def at(self, fill: npt.ArrayLike) -> tuple[Array, Array]:
        """Mean and standard deviation of the score at fills (...)."""
        f = np.asarray(fill, dtype=float)
        return np.asarray(self.mean(f)), np.sqrt(np.clip(self.variance(f), 0.0, None))


def response_nodes(batch: Batch, points: Index, target: str, detector: str, holds: int) -> tuple[Array, Array]:
    """(P, 9) means and variances at FILL_NODES of some evaluations (3.26, 3.28).

    By the filter that looks for ``target``, of pixels that hold target number ``holds``.
    """
    means, variances = np.empty((2, points.size, FILL_NODES.size))
    for g in batch.groups:
        here = np.flatnonzero(np.isin(batch.points.setting[points], g.numbers))
        if here.size:
            rows, r = batch.responses_to(g, holds, g.filters[target, detector][0], points[here])
            means[here] = r.means[rows]
            variances[here] = r.variances(batch.points.of(batch.points.gain, holds)[points[here]], rows)
    return means, variances


class Evaluations:
    """Filters and responses of some evaluations of a batch, of which the first is the scenario as it stands.

    After it come those with one scalar input up by its standard uncertainty, then as many with it down.
    """

    def __init__(self, batch: Batch, points: Index):
        self.batch, self.points = batch, points

    @cached_property
    def group(self) -> Group:
        """The group of the first evaluation."""
        return next(g for g in self.batch.groups if self.batch.points.setting[self.points[0]] in g.numbers)

    @cached_property
    def row(self) -> int:
        """Number of its setting in the group."""
        return int(np.searchsorted(self.group.numbers, self.batch.points.setting[self.points[0]]))

    def number(self, target: str) -> int:
        """Number of a target in the scene."""
        return next(i for i, t in enumerate(self.batch.targets) if t.name == target)

    def weights(self, target: str, detector: str) -> Array:
        """(F,) of the filter that looks for a target."""
        return np.asarray(self.group.filters[target, detector][0].weights[self.row])

    def slope(self, target: str) -> Array:
        """(F,) change of what the detector sees per change of a target's reflectance, under its own light."""
        t = self.batch.targets[self.number(target)]
        view, slope = self.group.at.view.row(self.row), self.group.seen.slope[self.row]
        light = t.illumination
        return np.asarray(slope * (view.light(light.beam, light.sky_view) if light else 1.0))

    def responses(self, target: str, detector: str, holds: str) -> list[Response]:
        """Of all evaluations, by the filter that looks for ``target``, for pixels that hold another or the same."""

        def made() -> list[Response]:
            points = self.points if target == holds else self.points[:1]
            nodes = response_nodes(self.batch, points, target, detector, self.number(holds))
            return [Response.through(*one) for one in zip(*nodes, strict=True)]

        return self.batch.once(("response", target, detector, holds, int(self.points[0])), made)


def predicted_object_scores(
    batch: Batch, points: Index, targets: Sequence[Target], draws: int | None = None
) -> dict[Key, ObjectScores]:
    """(subject, detector) -> draws of the greatest score over the pixels of an object (3.26, 3.28 for objects).

    Linear detectors alone.  The pixels of an object are independent given their fills and the inputs.

    Parameters
    ----------
    points : of the batch: the scenario as it stands, then evaluations with one scalar input up by its standard
        uncertainty, then as many with it down
    targets : of the scenario as it stands
    draws : of each object where no input is uncertain; default: as many as there would be with uncertain inputs
    """
    here, uncertainty = Evaluations(batch, points), batch.scenario.uncertainty
    drawn = input_draws(batch, uncertainty, here.group.bands, (points.size - 1) // 2)
    thesis, seed = batch.scenario.formulation == "thesis", batch.scenario.processing.seed
    linear = [d for d in batch.scenario.processing.detectors if d in LINEAR_DETECTORS]
    dof = np.broadcast_to(batch.points.dof, (len(batch), len(batch.class_names)))[points[0]]
    out: dict[Key, ObjectScores] = {}
    for target in targets:
        tail = float(dof[batch.class_names.index(target.host)])
        for population in target.populations:
            beside = [] if thesis else neighbours_of(target, population, targets)
            wanted = Objects(
                population, tuple(s for _, s in beside), uncertainty.psf_fwhm_pixels or 0.0, uncertainty.position_m,
                COLUMNS if drawn.rows > 1 else draws or ROWS * COLUMNS, thesis, None if np.isinf(tail) else tail,
                len(linear), seed,
            )  # fmt: skip
            numbers = drawn_numbers(wanted, drawn.blur)
            for name, more in zip(linear, numbers.more, strict=True):
                mean, sd = _pixel_scores(here, target.name, [t.name for t, _ in beside], name, drawn, numbers)
                host_sd = here.responses(target.name, name, target.name)[0].at(0.0)[1]
                out[population.name, name] = greatest_scores(mean, sd, host_sd, numbers, more)
    return out


@dataclass(frozen=True)
class Objects:
    """What the drawn numbers of the objects of one population follow from, besides the widths of the blur."""

    population: TargetSubject
    beside: tuple[TargetSubject, ...]
    psf_fwhm_pixels: float
    position_m: float | None
    columns: int
    thesis: bool
    dof: float | None
    detectors: int
    seed: int


@dataclass(frozen=True)
class Numbers:
    """What is drawn for the objects of one population, whatever their scores.

    Attributes
    ----------
    fills, others : (L, n) fills of an object's pixels at each of L places, and (L, n, J) those by its neighbours
    places : (S, R) which of them a draw has
    host : (S, R, n) departures of the host in a pixel, of variance 1
    more : for each detector the normal numbers of what is not of the host, None where all of it is normal
    """

    fills: Array
    others: Array
    places: Index
    host: Array
    more: tuple[Array | None, ...]

    @cached_property
    def weights(self) -> Array:
        """(L, n, 9) of the values at FILL_NODES."""
        return Responses.weights(self.fills)

    @cached_property
    def rest(self) -> Array:
        """(L, n) parts of the host."""
        return np.asarray(1.0 - self.fills - self.others.sum(axis=-1))

    def shared_sd(self, variance: Array, host_sd: Array, spread: Array) -> Array:
        """(L, n) standard deviation of pixels with parts of neighbours in place of the host (3.28).

        ``variance`` (L, n) without them;  ``spread`` (J,) : of pixels full of each neighbour
        """
        host = (self.rest**2 - (1.0 - self.fills) ** 2) * host_sd**2
        return np.asarray(np.sqrt(np.clip(variance + self.others**2 @ spread**2 + host, 0.0, None)))


def drawn_numbers(objects: Objects, blur: Array) -> Numbers:
    """The numbers of one population; ``blur`` (S,) departures of its width [standard uncertainties]."""
    rng = np.random.default_rng([objects.seed, 11, zlib.crc32(objects.population.name.encode())])
    fills, others, places = _drawn_fills(objects, blur, rng)
    shape = (*places.shape, fills.shape[1])
    host, dof = rng.standard_normal(shape), objects.dof
    if dof is not None:  # normal departures of the host become those of a t of the same variance
        host *= np.sqrt((dof - 2.0) / rng.chisquare(dof, shape))
    more = [None if dof is None else rng.standard_normal(shape) for _ in range(objects.detectors)]
    return Numbers(fills, others, places, host, tuple(more))


def neighbours_of(
    target: Target, population: TargetSubject, targets: Sequence[Target]
) -> list[tuple[Target, TargetSubject]]:
    """Targets with a position and a geometry that may share pixels with this one, itself left out."""
    geometry, here = population.fill.geometry, population.position_m
    if geometry is None or here is None:
        return []
    reach, out = _half_diagonal(geometry) + _REACH, []
    for other in targets:
        for subject in other.populations:
            if subject.name == population.name or subject.fill.geometry is None or subject.position_m is None:
                continue
            away = math.dist(subject.position_m, here) / geometry.gsd_m
            if away < reach + _half_diagonal(subject.fill.geometry):
                out.append((other, subject))
    return out


def _drawn_fills(objects: Objects, blur: Array, rng: np.random.Generator) -> tuple[Array, Array, Index]:
    """``fills``, ``others`` and ``places`` of :class:`Numbers`."""
    population, beside, thesis = objects.population, objects.beside, objects.thesis
    shape = (blur.size, objects.columns)
    geometry = population.fill.geometry
    if thesis or (geometry is None and population.fill.listed is None):
        fill = moments(population, thesis) if thesis else fill_distribution(population.fill)
        alone = fill.values[:, None]
        return alone, np.zeros((*alone.shape, 0)), rng.choice(fill.values.size, shape, p=fill.weights)
    n = pixels_of_object(population.fill)
    own, others, places, count = [], [], np.empty(shape, int), 0
    for width in np.unique(blur):
        rows = np.flatnonzero(blur == width)
        change = width * objects.psf_fwhm_pixels
        if population.position_m is None or geometry is None:
            fills = fills_of_objects(population.fill, change)
            beside_fills = np.zeros((*fills.shape, len(beside)))
        else:
            placed = [placed_beside(population, subject, change) for subject in beside]
            shifts = None
            if objects.position_m is not None:
                phases = PHASES if geometry.phase == "random" else 1
                shifts = rng.normal(0.0, objects.position_m / geometry.gsd_m, (phases, len(placed), 2))
            fills, beside_fills = shared_pixel_fills(geometry_of(population.fill, change), n, placed, shifts)
        places[rows] = count + rng.integers(len(fills), size=(rows.size, objects.columns))
        own.append(fills)
        others.append(beside_fills)
        count += len(fills)
    return np.concatenate(own), np.concatenate(others), places


def placed_beside(population: TargetSubject, subject: TargetSubject, change: float = 0.0) -> Neighbour:
    """A neighbour as an object's pixels see it; ``change`` is added to the width of the blur [pixels]."""
    here, there, geometry = population.position_m, subject.position_m, population.fill.geometry
    if here is None or there is None or geometry is None:
        raise ValueError("a neighbour without a place")
    away = (there[0] - here[0]) / geometry.gsd_m, (there[1] - here[1]) / geometry.gsd_m
    return Neighbour(geometry_of(subject.fill, change), away)


def _half_diagonal(geometry: Geometry) -> float:
    """[pixels]."""
    length, width = geometry.side_m or geometry.length_m or 0.0, geometry.side_m or geometry.width_m or 0.0
    return 0.5 * math.hypot(length, width) / geometry.gsd_m


def _pixel_scores(
    here: Evaluations, target: str, beside: Sequence[str], name: str, drawn: InputDraws, numbers: Numbers
) -> tuple[Array, Array]:
    """(S, R, n) mean score of each pixel, and (L, n) its standard deviation at each place (3.26, 3.28)."""
    fills = numbers.fills
    own, *moved = here.responses(target, name, target)
    mean, sd = own.at(fills)
    steps, weights = len(moved) // 2, here.weights(target, name)
    # What the inputs and the neighbours add to the mean is linear in what they are by.
    parts = [
        0.5 * (up.at(fills)[0] - down.at(fills)[0]) for up, down in zip(moved[:steps], moved[steps:], strict=True)
    ]
    by = [*drawn.steps.T, _departure(here, weights, target, drawn)]
    parts.append(fills)
    if beside:
        host_mean, host_sd = own.at(0.0)
        full = [here.responses(target, name, other)[0].at(1.0) for other in beside]
        by += [m + _departure(here, weights, o, drawn) - host_mean for (m, _), o in zip(full, beside, strict=True)]
        parts += list(np.moveaxis(numbers.others, -1, 0))
        sd = numbers.shared_sd(sd**2, host_sd, np.array([s for _, s in full]))
    return _mean_draws(mean, np.stack(parts, axis=-1), np.stack(by, axis=-1), numbers.places), sd


def _mean_draws(mean: Array, parts: Array, by: Array, places: Index) -> Array:
    """(S, R, n) mean + sum_f parts_f by_f at drawn places, of (L, n), (L, n, F) and (S, F)."""
    if len(by) == 1:
        return np.asarray((mean + parts @ by[0])[places])
    out = mean[places]
    for start in range(0, len(by), _TOGETHER):
        rows = slice(start, start + _TOGETHER)
        some = parts[places[rows]]  # (s, R, n, F)
        out[rows] += np.matmul(some.reshape(len(some), -1, some.shape[-1]), by[rows, :, None]).reshape(
            some.shape[:-1]
        )
    return out


def greatest_scores(mean: Array, sd: Array, host_sd: Array, numbers: Numbers, more: Array | None) -> ObjectScores:
    """Draws (S, R) of the greatest score over the pixels of an object, from their moments (S, R, n) and (L, n)."""
    if more is None:
        return ObjectScores((mean + sd[numbers.places] * numbers.host).max(axis=2))
    part = np.minimum(np.abs(numbers.rest * host_sd), sd)
    left = np.sqrt(sd**2 - part**2)
    return ObjectScores((mean + part[numbers.places] * numbers.host + left[numbers.places] * more).max(axis=2))


def _departure(here: Evaluations, weights: Array, target: str, drawn: InputDraws) -> Array:
    """(S,) change of the score of a pixel full of the target, by the errors of its spectrum."""
    out = np.zeros(drawn.rows)
    if target in drawn.spectra:
        out = out + drawn.spectra[target] @ (weights * here.slope(target))
    if target in drawn.collected:
        out = out + drawn.collected[target] @ weights
    return out
