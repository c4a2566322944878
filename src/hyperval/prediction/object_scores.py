"""What a whole object scores: draws of the greatest score over its pixels, the inputs' uncertainty included.

The score of a pixel follows from its fills by (3.26) and (3.28); which fills the pixels of an object have, from its
place on the pixel grid; and what all objects have in common, from draws of the uncertain inputs.
"""

from __future__ import annotations

import zlib
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from hyperval.prediction.detection import (
    Background,
    TargetResponse,
    Task,
    filter_base,
    filter_populations,
    target_response,
)
from hyperval.prediction.fills import fill_distribution, fills_of_objects, geometry_of, moments
from hyperval.prediction.inputs import correlation
from hyperval.processing.elm_model import retrieved_reflectance
from hyperval.processing.filters import LINEAR_DETECTORS, LinearFilter
from hyperval.products import ObjectScores
from hyperval.scenario import Target, TargetSubject
from hyperval.scenario_uncertainty import Uncertainty
from hyperval.scene.fill import PHASES, TargetGeometry
from hyperval.scene.neighbour_fill import Neighbour, shared_pixel_fills
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Key = tuple[str, str]

# Draws of the inputs, and of objects at each of them.
ROWS, COLUMNS = 1600, 24
# The blur's distribution stands on this many equally likely widths.
_WIDTHS = 5
# Other targets count up to this far beyond the corners of both [pixels]: four sigma of a blur of 1.5 pixels.
_REACH = 3.0


@dataclass(frozen=True)
class Evaluation:
    """For every target and linear detector the filter, and the response to it and to what lies beside it."""

    filters: Mapping[Key, LinearFilter]
    responses: Mapping[tuple[str, str, str], TargetResponse]


def evaluation(background: Background, task: Task, seen_with: Mapping[str, set[str]]) -> Evaluation:
    """Filters by (looked for, detector), responses by (looked for, detector, seen) (3.22-3.28).

    ``seen_with`` : target that is looked for -> targets whose response its filter is asked for, itself besides
    """
    base = filter_base(
        background,
        filter_populations(background, task),
        task.processing.filter_classes,
        task.processing.features,
    )
    filters, responses = {}, {}
    for target in task.targets:
        spectrum = retrieved_reflectance(
            background.view.library_line(), background.view.level(task.looked_for[target.name])
        )
        for name in (d for d in task.processing.detectors if d in LINEAR_DETECTORS):
            filters[target.name, name] = base.filter(name, spectrum)
            wanted = {target.name, *seen_with.get(target.name, ())}
            for seen in (t for t in task.targets if t.name in wanted):
                responses[target.name, name, seen.name] = target_response(
                    background, seen, filters[target.name, name]
                )
    return Evaluation(filters, responses)


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


def input_draws(
    background: Background, task: Task, uncertainty: Uncertainty, axis: SpectralAxis, steps: int
) -> InputDraws:
    """Draws of what the scenario calls uncertain; one row of zeros when nothing is.

    Rows come in pairs of opposite sign, so that means carry no sampling error to first order.

    Parameters
    ----------
    axis : the detector's bands
    steps : scalar inputs of the view
    """
    error = uncertainty.collected_reflectance
    uncertain = steps or task.spectrum_error or error or uncertainty.psf_fwhm_pixels or uncertainty.position_m
    if not uncertain:
        return InputDraws({}, {}, np.zeros((1, 0)), np.zeros(1))
    rng = np.random.default_rng([task.processing.seed, 7])
    spectra = {name: _normal(rng, covariance) for name, covariance in task.spectrum_error.items()}
    collected = {}
    if error is not None:
        shape = correlation(axis, error.correlation_nm)
        scaled, shifted = _normal(rng, shape), _normal(rng, shape)
        collected = {
            t.name: error.relative * scaled * background.surfaces[t.name].mean + error.absolute * shifted
            for t in task.targets
        }
    widths = ndtri((np.arange(_WIDTHS) + 0.5) / _WIDTHS)
    blur = rng.permutation(np.resize(widths / widths.std(), ROWS))
    if uncertainty.psf_fwhm_pixels is None:
        blur = np.zeros(ROWS)
    return InputDraws(spectra, collected, _pairs(rng, steps), blur)


def predicted_object_scores(
    background: Background,
    task: Task,
    uncertainty: Uncertainty,
    axis: SpectralAxis,
    steps: Sequence[tuple[Background, Background]] = (),
    draws: int | None = None,
) -> dict[Key, ObjectScores]:
    """(subject, detector) -> draws of the greatest score over the pixels of an object (3.26, 3.28 for objects).

    Linear detectors alone.  The pixels of an object are independent given their fills and the inputs.

    Parameters
    ----------
    axis : the detector's bands
    steps : backgrounds with one scalar input up and down by its standard uncertainty
    draws : of each object where no input is uncertain; default: as many as there would be with uncertain inputs
    """
    drawn = input_draws(background, task, uncertainty, axis, len(steps))
    thesis = background.view.formulation == "thesis"
    near = {
        t.name: {other.name for p in t.populations for other, _ in neighbours_of(t, p, task.targets)}
        for t in ([] if thesis else task.targets)
    }
    here = evaluation(background, task, near)
    moved = [(evaluation(plus, task, {}), evaluation(minus, task, {})) for plus, minus in steps]
    found: dict[Key, ObjectScores] = {}
    for target in task.targets:
        for population in target.populations:
            beside = [] if thesis else neighbours_of(target, population, task.targets)
            columns = COLUMNS if drawn.rows > 1 else draws or ROWS * COLUMNS
            dof = background.tail_of(next(c for c in background.classes if c.name == target.host))
            linear = [d for d in task.processing.detectors if d in LINEAR_DETECTORS]
            subjects = [s for _, s in beside]
            asked = (population, subjects, uncertainty, columns, thesis, dof, len(linear), task.processing.seed)
            again = draws is not None and drawn.rows == 1
            numbers = _kept_numbers(drawn, *asked) if again else _numbers(drawn, *asked)
            fills, others = numbers.fills, numbers.others
            for name, more in zip(linear, numbers.more, strict=True):
                mean, sd = _pixel_scores(
                    background, target, [t for t, _ in beside], here, moved, name, drawn, fills, others
                )
                host = (1.0 - fills - others.sum(axis=-1)) * _host_sd(here, target, name)
                scores = _with_tails(mean, sd, host, numbers.noise, numbers.tails, more)
                found[population.name, name] = ObjectScores(scores.max(axis=2))
    return found


@dataclass(frozen=True)
class _Numbers:
    """What is drawn for the objects of one population, whatever their scores.

    ``fills``, ``others``: of :func:`_drawn_fills`; ``noise``, ``tails``: (S, R, n), the tails None where the host
    is normal; ``more``: for each detector the normal numbers of what is not of the host, None without tails.
    """

    fills: Array
    others: Array
    noise: Array
    tails: Array | None
    more: tuple[Array | None, ...]


def _numbers(
    drawn: InputDraws,
    population: TargetSubject,
    beside: Sequence[TargetSubject],
    uncertainty: Uncertainty,
    columns: int,
    thesis: bool,
    dof: float | None,
    detectors: int,
    seed: int,
) -> _Numbers:
    rng = np.random.default_rng([seed, 11, zlib.crc32(population.name.encode())])
    fills, others = _drawn_fills(population, beside, uncertainty, drawn, columns, thesis, rng)
    noise = rng.standard_normal(fills.shape)
    # What turns normal departures of the host into those of a t of the same variance.
    tails = None if dof is None else np.asarray(np.sqrt((dof - 2.0) / rng.chisquare(dof, fills.shape)))
    more = [None if tails is None else rng.standard_normal(fills.shape) for _ in range(detectors)]
    return _Numbers(fills, others, noise, tails, tuple(more))


_KEPT: OrderedDict[tuple[object, ...], _Numbers] = OrderedDict()
_MOST_KEPT = 64  # populations; those of few draws, some 0.1 to 1 MB each


def _kept_numbers(
    drawn: InputDraws,
    population: TargetSubject,
    beside: Sequence[TargetSubject],
    uncertainty: Uncertainty,
    *rest: Any,
) -> _Numbers:
    """The same numbers each time that a population is asked for with all inputs certain."""
    key = (
        population.model_dump_json(),
        *(s.model_dump_json() for s in beside),
        uncertainty.model_dump_json(),
        *rest,
    )
    found = _KEPT.get(key)
    if found is None:
        found = _KEPT[key] = _numbers(drawn, population, beside, uncertainty, *rest)
        if len(_KEPT) > _MOST_KEPT:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(key)
    return found


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


def _drawn_fills(
    population: TargetSubject,
    beside: Sequence[TargetSubject],
    uncertainty: Uncertainty,
    drawn: InputDraws,
    columns: int,
    thesis: bool,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """(S, R, n) fills of an object's pixels and (S, R, n, J) those by its neighbours."""
    shape = (drawn.rows, columns)
    geometry = population.fill.geometry
    if thesis or geometry is None:
        fill = moments(population, thesis) if thesis else fill_distribution(population.fill)
        own = rng.choice(fill.values, shape, p=fill.weights)[..., None]
        return own, np.zeros((*own.shape, 0))
    n = geometry.n or 1
    own, others = np.empty((*shape, n)), np.zeros((*shape, n, len(beside)))
    for width in np.unique(drawn.blur):
        rows = np.flatnonzero(drawn.blur == width)
        change = width * (uncertainty.psf_fwhm_pixels or 0.0)
        if population.position_m is None:
            fills = fills_of_objects(population.fill, change)
            beside_fills = np.zeros((*fills.shape, 0))
        else:
            placed = [placed_beside(population, subject, change) for subject in beside]
            shifts = None
            if uncertainty.position_m is not None:
                count = PHASES if geometry.phase == "random" else 1
                shifts = rng.normal(0.0, uncertainty.position_m / geometry.gsd_m, (count, len(placed), 2))
            fills, beside_fills = shared_pixel_fills(geometry_of(population.fill, change), n, placed, shifts)
        chosen = rng.integers(len(fills), size=(rows.size, columns))
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
    background: Background,
    target: Target,
    beside: Sequence[Target],
    here: Evaluation,
    moved: Sequence[tuple[Evaluation, Evaluation]],
    name: str,
    drawn: InputDraws,
    fills: Array,
    others: Array,
) -> tuple[Array, Array]:
    """(S, R, n) mean and standard deviation of the score of each pixel (3.26, 3.28)."""
    key = (target.name, name)
    own = here.responses[(*key, target.name)]
    mean, sd = own.at(fills)
    for k, (plus, minus) in enumerate(moved):
        up, down = plus.responses[(*key, target.name)], minus.responses[(*key, target.name)]
        mean = mean + 0.5 * (up.at(fills)[0] - down.at(fills)[0]) * drawn.steps[:, k, None, None]
    mean = mean + fills * _departure(background, here.filters[key], target, drawn)[:, None, None]
    if not beside:
        return mean, sd
    host_mean, host_sd = own.at(0.0)
    variance = sd**2
    for j, other in enumerate(beside):
        full, spread = here.responses[(*key, other.name)].at(1.0)
        full = full + _departure(background, here.filters[key], other, drawn)
        mean = mean + others[..., j] * (full[:, None, None] - host_mean)
        variance = variance + others[..., j] ** 2 * spread**2
    rest, alone = 1.0 - fills - others.sum(axis=-1), 1.0 - fills
    variance = variance + (rest**2 - alone**2) * host_sd**2
    return mean, np.sqrt(np.clip(variance, 0.0, None))


def _departure(background: Background, detector: LinearFilter, target: Target, drawn: InputDraws) -> Array:
    """(S,) change of the score of a pixel full of the target, by the errors of its spectrum."""
    view, line = background.view, background.view.line()
    out = np.zeros(drawn.rows)
    own = background.surfaces[target.name]
    if target.name in drawn.spectra:
        factor = view.lit_surface(own.mean, own.covariance, target.illumination).factor
        out = out + drawn.spectra[target.name] @ (detector.weights / line.gain * view.slope() * factor)
    if target.name in drawn.collected:
        out = out + drawn.collected[target.name] @ detector.weights
    return out


def _host_sd(here: Evaluation, target: Target, name: str) -> float:
    return float(here.responses[target.name, name, target.name].at(0.0)[1])


def _with_tails(
    mean: Array, sd: Array, host: Array, noise: Array, tails: Array | None, more: Array | None
) -> Array:
    if tails is None or more is None:
        return mean + sd * noise
    part = np.minimum(np.abs(host), sd)
    return np.asarray(mean + part * noise * tails + np.sqrt(sd**2 - part**2) * more)


def _pairs(rng: np.random.Generator, columns: int) -> Array:
    """(ROWS, columns) standard normal numbers in pairs of opposite sign."""
    half = rng.standard_normal((ROWS // 2, columns))
    return np.concatenate([half, -half])


def _normal(rng: np.random.Generator, covariance: Array) -> Array:
    """(ROWS, F) draws of a normal vector."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(_pairs(rng, values.size) @ (vectors * np.sqrt(np.clip(values, 0.0, None))).T)
