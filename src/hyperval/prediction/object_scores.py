"""What a whole object scores: draws of the greatest score over its pixels, the inputs' uncertainty included.

The score of a pixel follows from its fills by (3.26) and (3.28); which fills the pixels of an object have, from its
place on the pixel grid; and what all objects have in common, from draws of the uncertain inputs.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from hyperval.prediction.batch import Batch, Group
from hyperval.prediction.fills import fill_distribution, fills_of_objects, geometry_of, moments, pixels_of_object
from hyperval.prediction.inputs import correlation, cut
from hyperval.prediction.responses import FILL_NODES
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.products import ObjectScores
from hyperval.scenario import Target, TargetSubject
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.scene.fill import PHASES, Neighbour, TargetGeometry, shared_pixel_fills

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Key = tuple[str, str]

# Draws of the inputs, and of objects at each of them.
ROWS, COLUMNS = 1600, 24
# The blur's distribution stands on this many equally likely widths.
_WIDTHS = 5
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


@dataclass(frozen=True)
class InputDraws:
    """Draws of the uncertain inputs that all objects share.

    Attributes
    ----------
    spectra : target -> (S, F) departure of its reflectance from the field spectrum
    collected : target -> (S, F) departure of its reflectance as the collection holds it
    steps : (S, K) scalar inputs of the view, in standard uncertainties
    blur : (S,) width, in standard uncertainties, one of few values
    """

    spectra: Mapping[str, Array]
    collected: Mapping[str, Array]
    steps: Array
    blur: Array

    @property
    def rows(self) -> int:
        """S."""
        return int(self.blur.size)


def input_draws(batch: Batch, uncertainty: Uncertainty, bands: Index, steps: int) -> InputDraws:
    """Draws of what the scenario calls uncertain; one row of zeros when nothing is.

    Rows come in pairs of opposite sign, so that means carry no sampling error to first order.

    Parameters
    ----------
    bands : of the detector
    steps : scalar inputs of light and sensor
    """
    error = uncertainty.collected_reflectance
    spectrum_error = {t.name: cut(batch.errors[t.name], bands) for t in batch.targets if t.name in batch.errors}
    uncertain = steps or spectrum_error or error or uncertainty.psf_fwhm_pixels or uncertainty.position_m
    if not uncertain:
        return InputDraws({}, {}, np.zeros((1, 0)), np.zeros(1))
    rng = np.random.default_rng([batch.scenario.processing.seed, 7])
    spectra = {name: _normal(rng, covariance) for name, covariance in spectrum_error.items()}
    collected = {}
    if error is not None:
        shape = correlation(batch.axis.select(bands), error.correlation_nm)
        scaled, shifted = _normal(rng, shape), _normal(rng, shape)
        surfaces = batch.settings.grounds[0].surfaces
        collected = {
            t.name: error.relative * scaled * surfaces[t.name].mean[bands] + error.absolute * shifted
            for t in batch.targets
        }
    widths = ndtri((np.arange(_WIDTHS) + 0.5) / _WIDTHS)
    blur = rng.permutation(np.resize(widths / widths.std(), ROWS))
    if uncertainty.psf_fwhm_pixels is None:
        blur = np.zeros(ROWS)
    return InputDraws(spectra, collected, _pairs(rng, steps), blur)


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

    ``fills``, ``others``: of :func:`_drawn_fills`; ``noise``, ``tails``: (S, R, n), the tails None where the host
    is normal; ``more``: for each detector the normal numbers of what is not of the host, None without tails.
    """

    fills: Array
    others: Array
    noise: Array
    tails: Array | None
    more: tuple[Array | None, ...]

    @cached_property
    def rest(self) -> Array:
        """(S, R, n) parts of the host."""
        return np.asarray(1.0 - self.fills - self.others.sum(axis=-1))

    @cached_property
    def squares(self) -> Array:
        """(S, R, n, J) squares of the neighbours' parts."""
        return self.others**2


def drawn_numbers(objects: Objects, blur: Array) -> Numbers:
    """The numbers of one population; ``blur`` (S,) departures of its width [standard uncertainties]."""
    rng = np.random.default_rng([objects.seed, 11, zlib.crc32(objects.population.name.encode())])
    fills, others = _drawn_fills(objects, blur, rng)
    noise = rng.standard_normal(fills.shape)
    # What turns normal departures of the host into those of a t of the same variance.
    dof = objects.dof
    tails = None if dof is None else np.asarray(np.sqrt((dof - 2.0) / rng.chisquare(dof, fills.shape)))
    more = [None if tails is None else rng.standard_normal(fills.shape) for _ in range(objects.detectors)]
    return Numbers(fills, others, noise, tails, tuple(more))


def neighbours_of(
    target: Target, population: TargetSubject, targets: Sequence[Target]
) -> list[tuple[Target, TargetSubject]]:
    """Targets with a position and a geometry that may share pixels with this one, itself left out."""
    geometry, here = population.fill.geometry, population.position_m
    if geometry is None or here is None:
        return []
    own = geometry_of(population.fill)
    out = []
    for other in targets:
        for subject in other.populations:
            if subject.name == population.name or subject.fill.geometry is None or subject.position_m is None:
                continue
            away = np.hypot(subject.position_m[0] - here[0], subject.position_m[1] - here[1]) / geometry.gsd_m
            if away < _half_diagonal(own) + _half_diagonal(geometry_of(subject.fill)) + _REACH:
                out.append((other, subject))
    return out


def _drawn_fills(objects: Objects, blur: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(S, R, n) fills of an object's pixels and (S, R, n, J) those by its neighbours."""
    population, beside, thesis = objects.population, objects.beside, objects.thesis
    shape = (blur.size, objects.columns)
    geometry = population.fill.geometry
    if thesis or (geometry is None and population.fill.listed is None):
        fill = moments(population, thesis) if thesis else fill_distribution(population.fill)
        own = rng.choice(fill.values, shape, p=fill.weights)[..., None]
        return own, np.zeros((*own.shape, 0))
    n = pixels_of_object(population.fill)
    own, others = np.empty((*shape, n)), np.zeros((*shape, n, len(beside)))
    for width in np.unique(blur):
        rows = np.flatnonzero(blur == width)
        change = width * objects.psf_fwhm_pixels
        if population.position_m is None or geometry is None:
            fills = fills_of_objects(population.fill, change)
            beside_fills = np.zeros((*fills.shape, 0))
        else:
            placed = [placed_beside(population, subject, change) for subject in beside]
            shifts = None
            if objects.position_m is not None:
                count = PHASES if geometry.phase == "random" else 1
                shifts = rng.normal(0.0, objects.position_m / geometry.gsd_m, (count, len(placed), 2))
            fills, beside_fills = shared_pixel_fills(geometry_of(population.fill, change), n, placed, shifts)
        chosen = rng.integers(len(fills), size=(rows.size, objects.columns))
        own[rows], others[rows] = fills[chosen], beside_fills[chosen]
    return own, others


def placed_beside(population: TargetSubject, subject: TargetSubject, change: float = 0.0) -> Neighbour:
    """A neighbour as an object's pixels see it; ``change`` is added to the width of the blur [pixels]."""
    here, there, geometry = population.position_m, subject.position_m, population.fill.geometry
    if here is None or there is None or geometry is None:
        raise ValueError("a neighbour without a place")
    away = (there[0] - here[0]) / geometry.gsd_m, (there[1] - here[1]) / geometry.gsd_m
    return Neighbour(geometry_of(subject.fill, change), away)


def _half_diagonal(geometry: TargetGeometry) -> float:
    """[pixels]."""
    return float(0.5 * np.hypot(geometry.length_m, geometry.width_m) / geometry.gsd_m)


def _pixel_scores(
    here: Evaluations, target: str, beside: Sequence[str], name: str, drawn: InputDraws, numbers: Numbers
) -> tuple[Array, Array]:
    """(S, R, n) mean and standard deviation of the score of each pixel (3.26, 3.28)."""
    fills = numbers.fills
    own, *moved = here.responses(target, name, target)
    mean, sd = own.at(fills)
    steps = len(moved) // 2
    for k, (up, down) in enumerate(zip(moved[:steps], moved[steps:], strict=True)):
        mean = mean + 0.5 * (up.at(fills)[0] - down.at(fills)[0]) * drawn.steps[:, k, None, None]
    weights = here.weights(target, name)
    mean = mean + fills * _departure(here, weights, target, drawn)[:, None, None]
    if not beside:
        return mean, sd
    full = [here.responses(target, name, other)[0].at(1.0) for other in beside]
    level = np.stack(
        [m + _departure(here, weights, other, drawn) for (m, _), other in zip(full, beside, strict=True)], axis=1
    )
    return with_neighbours(mean, sd, own.at(0.0), level, np.array([s for _, s in full]), numbers)


def with_neighbours(
    mean: Array, sd: Array, host: tuple[Array, Array], level: Array, spread: Array, numbers: Numbers
) -> tuple[Array, Array]:
    """(S, R, n) mean and standard deviation of pixels with parts of neighbours in place of the host (3.26, 3.28).

    ``host`` : of a pixel of the host;  ``level`` (S, J), ``spread`` (J,) : of pixels full of each neighbour
    """
    host_mean, host_sd = host
    others = numbers.others.reshape(len(numbers.others), -1, numbers.others.shape[-1])
    mean = mean + np.matmul(others, (level - host_mean)[:, :, None]).reshape(mean.shape)
    variance = sd**2 + numbers.squares @ spread**2 + (numbers.rest**2 - (1.0 - numbers.fills) ** 2) * host_sd**2
    return mean, np.sqrt(np.clip(variance, 0.0, None))


def greatest_scores(mean: Array, sd: Array, host_sd: Array, numbers: Numbers, more: Array | None) -> ObjectScores:
    """Draws (S, R) of the greatest score over the pixels of an object, from their moments (S, R, n)."""
    if numbers.tails is None or more is None:
        return ObjectScores((mean + sd * numbers.noise).max(axis=2))
    part = np.minimum(np.abs(numbers.rest * host_sd), sd)
    scores = mean + part * numbers.noise * numbers.tails + np.sqrt(sd**2 - part**2) * more
    return ObjectScores(scores.max(axis=2))


def _departure(here: Evaluations, weights: Array, target: str, drawn: InputDraws) -> Array:
    """(S,) change of the score of a pixel full of the target, by the errors of its spectrum."""
    out = np.zeros(drawn.rows)
    if target in drawn.spectra:
        out = out + drawn.spectra[target] @ (weights * here.slope(target))
    if target in drawn.collected:
        out = out + drawn.collected[target] @ weights
    return out


def _pairs(rng: np.random.Generator, columns: int) -> Array:
    """(ROWS, columns) standard normal numbers in pairs of opposite sign."""
    half = rng.standard_normal((ROWS // 2, columns))
    return np.concatenate([half, -half])


def _normal(rng: np.random.Generator, covariance: Array) -> Array:
    """(ROWS, F) draws of a normal vector."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(_pairs(rng, values.size) @ (vectors * np.sqrt(np.clip(values, 0.0, None))).T)
