"""Scores of whole objects and of pixels of known content, and the mean spectrum of an object's pixels.

The score of a pixel follows from its fills by (3.26) and (3.28), the fills of an object's pixels from its place on the
pixel grid; an object's score is the greatest of its pixels.  Errors common to all objects are draws of the uncertain
inputs.  All truths share the random numbers, so that their differences are free of scatter; an object with the same
response in two truths has the same draws in both.

A subject with a place is one object among others.  Its n pixels hold shares f_j of its own surface and of those beside
it, and of its host the rest (f of 3.10).  Over places on the pixel grid, and the stated error of positions, the shares
have a mean and a covariance: the mean gives the mean spectrum, the covariance an error of it.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np

from hyperval.data import Array, Index, Mask
from hyperval.model.detection import FILL_NODES, Evaluation, Responses
from hyperval.model.fill import (
    PHASES,
    fill_distribution,
    fills_of_objects,
    object_pixel_count,
    population_fill,
    shared_pixel_fills,
)
from hyperval.model.radiance import retrieved_reflectance, target_light, target_pixel_reflectance, truth_row
from hyperval.model.roc import Host
from hyperval.model.world import Populations, World
from hyperval.products import ObjectScores
from hyperval.scenario import Geometry, TargetSubject

ROWS = 1600


@dataclass(frozen=True)
class InputDraws:
    """Draws of the uncertain inputs that all objects share.

    Attributes
    ----------
    spectra : target -> (S, F) departure of its reflectance from the field spectrum
    steps : (S, K) of all other inputs along each of their directions, in standard uncertainties
    """

    spectra: Mapping[str, Array]
    steps: Array


def input_draws(e: Evaluation, steps: int) -> InputDraws:
    """Draws of the scenario's uncertain inputs; one row of zeros without any.

    Rows come in pairs of opposite sign, so that means carry no sampling error to first order.

    Parameters
    ----------
    steps : directions of inputs besides the spectra of targets
    """
    rows = {t.name: e.errors[t.name][:, e.bands] for t in e.targets if t.name in e.errors}
    if not (steps or rows):
        return InputDraws({}, np.zeros((1, 0)))
    rng = np.random.default_rng([e.scenario.processing.seed, 7])
    spectra = {name: _normal_draws(rng, error_rows.T @ error_rows) for name, error_rows in rows.items()}
    return InputDraws(spectra, _antithetic_normals(rng, steps))


def _antithetic_normals(rng: np.random.Generator, columns: int) -> Array:
    """(ROWS, columns) standard normal numbers in pairs of opposite sign."""
    half = rng.standard_normal((ROWS // 2, columns))
    return np.concatenate([half, -half])


def _normal_draws(rng: np.random.Generator, covariance: Array) -> Array:
    """(ROWS, F) draws of a normal vector."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(_antithetic_normals(rng, values.size) @ (vectors * np.sqrt(np.clip(values, 0.0, None))).T)


Key = tuple[str, str]
Subjects = tuple[TargetSubject, ...]  # a population and its neighbours
Laws = tuple[tuple[float, float], ...]

COLUMNS = 24  # draws of objects at each of those of the inputs
_CHUNK = 32  # draws of the inputs at once, for the processor's cache
# Neighbours count up to this far beyond the corners of both [pixels]: four sigma of a blur of 1.5 pixels.
_MARGIN = 3.0


Parts = Sequence[tuple[Index, Evaluation]]  # of all truths, with the numbers of those in each


def response_nodes(parts: Parts, target: int, detector: str, holds: int) -> Array:
    """(2, U, 9) means and variances at FILL_NODES in all truths (3.26, 3.28).

    By the filter of target number ``target``, of pixels that hold number ``holds``.
    """
    moments = np.empty((2, sum(index.size for index, _ in parts), FILL_NODES.size))
    for index, part in parts:
        rows, response = part.responses(target, detector, holds)
        gain = part.world.target_column("target_gain", holds)
        moments[:, index] = response.means[rows], response.variances(gain, rows)
    return moments


def object_scores(world: World, parts: Parts, truths: Index, draws: int | None = None) -> dict[Key, ObjectScores]:
    """(subject, detector) -> draws of the greatest score over the pixels of an object (3.26, 3.28 for objects).

    Linear detectors alone.  The pixels of an object are independent given their fills and the inputs.

    >>> from hyperval.api import load_scenario
    >>> from hyperval.model import predict
    >>> unlit = load_scenario("green-planks-grass").model_copy(update={"atmosphere": None})
    >>> wide = unlit.with_values({"uncertainty.fills": [{"subject": "green plank 0.1", "absolute": 0.1}]})
    >>> least = predict(wide, objects=True).object_scores["green plank 0.1", "cem"].values.mean(axis=1).min()
    >>> bool(least > -0.1)  # of no fill below 0, which would make it -0.24
    True

    Parameters
    ----------
    world, parts : all truths, and their evaluations
    truths : that of the objects, in the first of the parts, then those with one direction of an input up by its
        standard uncertainty, then as many with it down
    draws : of each object where no input is uncertain; default: as many as there would be with uncertain inputs
    """
    e, u, position_m = parts[0][1], int(truths[0]), world.stated.scenario.uncertainty.position_m
    drawn, (by_truth, which) = input_draws(e, (truths.size - 1) // 2), world.populations
    certain, thesis, seed = len(drawn.steps) == 1, e.scenario.formulation == "thesis", e.scenario.processing.seed
    linear = e.scenario.processing.linear_detectors
    names = [t.name for t in e.targets]
    stated, (plus, minus) = by_truth[which[u]], np.split(which[truths[1:]], 2)
    scores: dict[Key, ObjectScores] = {}
    for i, (owner, population) in enumerate(stated):
        number = names.index(owner)
        adjacent = [] if thesis else neighbours_of(population, stated)
        neighbour_names = [subject.name for _, subject in adjacent]
        subjects = [(truth[i][1], *(s for _, s in truth if s.name in neighbour_names)) for truth in by_truth]
        stated_subjects = subjects[which[u]]
        _, shares, dof = e.host_laws(number)
        laws = tuple(zip(shares.tolist(), truth_row(dof, u).tolist(), strict=True))
        laws = () if laws == ((1.0, math.inf),) else laws  # one normal law
        count = (draws or ROWS * COLUMNS) if certain else COLUMNS
        arguments = stated_subjects, position_m, thesis, seed, count, laws, len(linear)
        numbers = _cached_numbers(*arguments) if certain and draws else drawn_numbers(*arguments, len(drawn.steps))
        fills = {
            w: tuple(map(np.nan_to_num, _fills_at_places(population, subjects[w], position_m, thesis, seed)))
            for w in {*plus, *minus} if subjects[w] != stated_subjects
        }  # fmt: skip
        moved = {
            k: [fills.get(w, (numbers.fills, numbers.neighbours)) for w in ends]
            for k, ends in enumerate(zip(plus, minus, strict=True)) if not fills.keys().isdisjoint(ends)
        }  # fmt: skip
        neighbours = [names.index(name) for name, _ in adjacent]
        for name, noise in zip(linear, numbers.noise, strict=True):
            response = response_nodes(parts, number, name, number)[:, truths]
            full = [response_nodes(parts, number, name, o)[:, truths, -1] for o in neighbours]
            host = e.host(number, name, truths[:1], numbers.host_share.reshape(1, -1), *response[:, :1, 0])
            # The same scores in two truths have the same draws.
            sources = [response, *full, *(() if host is None else vars(host.laws).values())]
            key = repr((arguments, [subjects[w] for w in fills])), name, b"".join(a.tobytes() for a in sources)
            change = [_spectrum_change(e, u, number, name, o, drawn) for o in (number, *neighbours)]
            make = partial(_greatest_scores, response, full, change, moved, host, drawn, numbers, noise)
            scores[population.name, name] = e.cached(key, make)
    return scores


@dataclass(frozen=True)
class ObjectDraws:
    """Random draws for the objects of one population, independent of their scores.

    Attributes
    ----------
    fills, neighbours : (L, n) fills of an object's pixels at each of L places, and (L, n, J) those by its neighbours
    absent : (L, n) True behind the last pixel of an object that has fewer
    places : (S, R) number of the place of each draw
    host : (S, R, n) departures of the host in a pixel, of variance 1
    noise : for each detector the normal numbers of all but the host, None where the host is normal too
    law : (S, R, n) number of the host's law in a pixel, None where it has one
    """

    fills: Array
    neighbours: Array
    absent: Mask
    places: Index
    host: Array
    noise: tuple[Array | None, ...]
    law: Index | None = None

    @cached_property
    def weights(self) -> Array:
        """(L, n, 9) of the values at FILL_NODES."""
        return Responses.weights(self.fills)

    @cached_property
    def host_share(self) -> Array:
        """(L, n) parts of the pixels that are host."""
        return np.asarray(1.0 - self.fills - self.neighbours.sum(axis=-1))


def drawn_numbers(
    subjects: Subjects, position_m: float | None, thesis: bool, seed: int, columns: int, laws: Laws, detectors: int,
    rows: int = 1,
) -> ObjectDraws:  # fmt: skip
    """Random draws of the objects of one population.

    Parameters
    ----------
    subjects : the population and its neighbours
    position_m : standard uncertainty of the neighbours' places
    thesis : whether an object is one pixel of its mean fill
    columns : draws of objects at each of ``rows`` of the inputs
    laws : of the host; none: one normal law

    >>> population = TargetSubject(name="plank", fill={"listed": [[0.5, 0.2], [0.4]]})
    >>> numbers = drawn_numbers((population,), None, False, 1, 3, (), 1)
    >>> numbers.fills.tolist(), numbers.absent.tolist()
    ([[0.5, 0.2], [0.4, 0.0]], [[False, False], [False, True]])
    """
    rng, population = np.random.default_rng([seed, 11, zlib.crc32(subjects[0].name.encode())]), subjects[0]
    (fills, shared), weights = _fills_at_places(population, subjects, position_m, thesis, seed), None
    if _is_one_pixel(population, thesis):
        weights = population_fill(population.fill, thesis).weights
    places = rng.choice(len(fills), (rows, columns), p=weights)
    shape = (*places.shape, fills.shape[1])
    host, law = rng.standard_normal(shape), None
    if laws:
        parts, dof = np.array(laws).T
        law = rng.choice(dof.size, shape, p=parts) if dof.size > 1 else None
        nu = np.broadcast_to(dof if law is None else dof[law], shape)
        # Normal departures of the host become those of a t of the same variance.
        tailed = np.isfinite(nu)
        host[tailed] *= np.sqrt((nu[tailed] - 2.0) / rng.chisquare(nu[tailed]))
    noise = [rng.standard_normal(shape) if laws else None for _ in range(detectors)]
    return ObjectDraws(np.nan_to_num(fills), np.nan_to_num(shared), np.isnan(fills), places, host, tuple(noise), law)


_cached_numbers = lru_cache(maxsize=64)(drawn_numbers)  # populations; those of few draws, some 0.1 to 1 MB each


def neighbours_of(population: TargetSubject, populations: Populations) -> list[tuple[str, TargetSubject]]:
    """Other populations with a position and a geometry that may share pixels with this one."""
    geometry, position = population.fill.geometry, population.position_m
    if geometry is None or position is None:
        return []
    reach, neighbours = _half_diagonal(geometry) + _MARGIN, []
    for owner, subject in populations:
        if subject.name == population.name or subject.fill.geometry is None or subject.position_m is None:
            continue
        distance = math.dist(subject.position_m, position) / geometry.gsd_m
        if distance < reach + _half_diagonal(subject.fill.geometry):
            neighbours.append((owner, subject))
    return neighbours


def _is_one_pixel(population: TargetSubject, thesis: bool) -> bool:
    """Whether a population is of single pixels, with a distribution of fills and no places."""
    return thesis or (population.fill.geometry is None and population.fill.listed is None)


def _fills_at_places(
    stated: TargetSubject, subjects: Subjects, position_m: float | None, thesis: bool, seed: int
) -> tuple[Array, Array]:
    """(L, n) fills of the pixels of an object at each of its places, NaN where it has fewer, and (L, n, J) those by its
    neighbours.

    Parameters
    ----------
    stated : the population with its stated fill, which determines places and number of pixels
    subjects, position_m : the population and its neighbours, and the standard uncertainty of their places
    """
    (population, *neighbours), geometry = subjects, subjects[0].fill.geometry
    if _is_one_pixel(population, thesis):
        step = fill_distribution(population.fill).mean - fill_distribution(stated.fill).mean
        fills = population_fill(stated.fill, thesis).values[:, None] + step
        return fills, np.zeros((*fills.shape, 0))
    if geometry is None or population.position_m is None:
        fills = fills_of_objects(population.fill, object_pixel_count(stated.fill))
        return fills, np.zeros((*fills.shape, 0))
    shifts, phases = None, 1 if geometry.phase == "centred" else PHASES
    if position_m is not None:  # the same in all truths
        rng = np.random.default_rng([seed, 13, zlib.crc32(population.name.encode())])
        shifts = rng.normal(0.0, position_m / geometry.gsd_m, (phases, len(neighbours), 2))
    offsets = []
    for subject in neighbours:
        neighbour, position = subject.fill.geometry, subject.position_m or ()
        assert neighbour is not None  # noqa: S101 - as neighbours_of has chosen them
        offsets.append((neighbour, np.subtract(position, population.position_m) / geometry.gsd_m))
    return shared_pixel_fills(geometry, object_pixel_count(stated.fill), offsets, shifts if offsets else None)


def _half_diagonal(geometry: Geometry) -> float:
    """[pixels]."""
    return 0.5 * math.hypot(*geometry.sides_pixels)


def _greatest_scores(
    moments: Array, full: Sequence[Array], change: Sequence[Array], moved: Mapping[int, Sequence[tuple[Array, ...]]],
    host: Host | None, drawn: InputDraws, numbers: ObjectDraws, noise: Array | None,
) -> ObjectScores:  # fmt: skip
    """Draws of an object by the moments of its pixels at FILL_NODES, (2, P, 9) (3.26, 3.28).

    ``full`` : mean and variance of pixels full of each neighbour, (2, P);  ``change`` : (S,) of the mean score of
    pixels full of the target and of each neighbour;  ``moved`` : fills with an input up and down
    """
    (means, variances), neighbour_moments = moments, np.reshape(full, (-1, *moments.shape[:2]))
    # The mean score is linear in the parts of host, target and neighbours; each input's effect on them is the drawn
    # multiple of the change by one standard uncertainty up or down.
    ends, signs = np.array([means[:, 0], means[:, -1], *neighbour_moments[:, 0]]), (drawn.steps, -drawn.steps)
    changes = zip(signs, np.split((ends[:, 1:] - ends[:, :1]).T, 2), strict=True)
    effect = sum(np.maximum(c, 0.0) @ d for c, d in changes) + np.stack([np.zeros(len(drawn.steps)), *change], axis=1)
    shares, active = np.concatenate([numbers.fills[..., None], numbers.neighbours], axis=2), effect.any(axis=0)
    stated = numbers.weights @ means[0] + numbers.neighbours @ (neighbour_moments[:, 0, 0] - means[0, 0])  # (3.26)
    parts = np.concatenate([numbers.host_share[..., None], shares], axis=2)[..., active]
    mean = _mean_draws(np.where(numbers.absent, -np.inf, stated), parts, effect[:, active], numbers.places)
    contrast = ends[1:, 0] - ends[0, 0] + effect[:, 1:] - effect[:, :1]
    steps = np.reshape([np.maximum(c[:, k], 0.0) for k in moved for c in signs], (-1, len(effect))).T
    at_ends = [np.concatenate([f[..., None], o], axis=2) for of_input in moved.values() for f, o in of_input]
    for j, share in enumerate(np.moveaxis(shares, -1, 0)):
        if at_ends:  # fills stay within 0 and 1 for all draws of the inputs
            f_moved = _mean_draws(share, np.stack([f[..., j] - share for f in at_ends], axis=-1), steps, numbers.places)
            mean += (np.clip(f_moved, 0.0, 1.0) - share[numbers.places]) * contrast[:, j, None, None]
    # Parts of neighbours replace the host, as the target does in equation 3.28.
    neighbour_variance = numbers.neighbours**2 @ np.clip(neighbour_moments[:, 1, 0], 0.0, None)
    neighbour_variance += (numbers.host_share**2 - (1.0 - numbers.fills) ** 2) * max(variances[0, 0], 0.0)
    sd = np.sqrt(np.clip(np.clip(numbers.weights @ variances[0], 0.0, None) + neighbour_variance, 0.0, None))
    if noise is None or host is None:
        return ObjectScores((mean + sd[numbers.places] * numbers.host).max(axis=2))
    flat, places, laws = sd.reshape(1, -1), numbers.places, []
    for _, shift, normal, tailed, _ in host.components(np.zeros(flat.shape), flat):
        laws.append([a.reshape(sd.shape) for a in (shift, np.sqrt(tailed), np.sqrt(normal))])
    which = 0 if numbers.law is None else numbers.law
    shift, tailed, normal = (np.array(a)[which, places[..., None], range(sd.shape[1])] for a in zip(*laws, strict=True))
    return ObjectScores((mean + shift + tailed * numbers.host + normal * noise).max(axis=2))


def _mean_draws(mean: Array, parts: Array, effect: Array, places: Index) -> Array:
    """(S, R, n) mean + sum_f parts_f effect_f at drawn places, of (L, n), (L, n, F) and (S, F)."""
    if len(effect) == 1 or not effect.size:
        return np.asarray((mean + parts @ effect[0])[places])
    draws = mean[places]
    for start in range(0, len(effect), _CHUNK):
        rows = slice(start, start + _CHUNK)
        f = parts[places[rows]]  # (s, R, n, F)
        draws[rows] += np.matmul(f.reshape(len(f), -1, f.shape[-1]), effect[rows, :, None]).reshape(f.shape[:-1])
    return draws


def _spectrum_change(e: Evaluation, u: int, looks_for: int, detector: str, holds: int, drawn: InputDraws) -> Array:
    """(S,) change of the score of a pixel full of a target, by the errors of its spectrum under its own light."""
    name, v, of_target = e.targets[holds].name, int(e.light_index[u]), e.world.target_column
    if name not in drawn.spectra:
        return np.zeros(len(drawn.steps))
    shade = e.retrieval.light.row(v).shading(float(of_target("beam", holds)[u]), float(of_target("sky_view", holds)[u]))
    weights = e.filters[e.targets[looks_for].name, detector][0].weights[v]
    return np.asarray(drawn.spectra[name] @ (weights * truth_row(e.retrieval.slope, v) * shade))


def expected_scores(e: Evaluation) -> dict[tuple[str, str, str], float]:
    """(subject, target, detector) -> expected score [1], of linear detectors in the first truth.

    The subject is a class, a panel, a site or a population of any target, whichever target the filter looks for.  The
    score is linear in the reflectance: the mean score of a population is that of its mean fill.  A surface whose
    spectrum lacks bands of the detector has none.
    """
    v, truth, scene = int(e.light_index[0]), e.world.rows(np.array([0])), e.scenario.scene
    pure = (*scene.classes, *scene.panels, *scene.sites)
    means = {s.name: truth.mean[0, truth.surface_number(s.name), e.bands] for s in pure}
    view, light = e.retrieval.light.row(v), e.light.rows(np.array([v]))
    for number, (t, _, population) in enumerate(e.stated.populations):
        lit, fill = target_light(truth, light, t)[0][0, 0, e.bands], truth.pixel_fills[number].mean
        means[population.name] = target_pixel_reflectance(fill, lit, means[e.targets[t].host])
    reflectance = retrieved_reflectance(view.empirical_line(), view.signal(np.array(list(means.values()))))
    table: dict[tuple[str, str, str], float] = {}
    for (looks_for, detector), (filters, _, _) in e.filters.items():
        scores = reflectance @ filters.weights[v] - filters.offset[v]
        expected = zip(means, scores.tolist(), strict=True)
        table |= {(name, looks_for, detector): score for name, score in expected if np.isfinite(score)}
    return table


# Names of the sources in the budget.
PLACE = "place of the targets on the pixel grid"
HOST = "background at the target's place"


@dataclass(frozen=True, eq=False)
class Shares:
    """Shares of the surfaces in an object's pixels, averaged over these.

    Attributes
    ----------
    names : (J,) targets of the surfaces, the object's own first; a target may occur more than once
    mean : (J,) expected shares
    covariance : (J, J) over places on the pixel grid and the errors of positions
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array

    def expected_share(self, target: str) -> float:
        """Expected share of the surface of a target."""
        return float(sum(self.mean[j] for j, name in enumerate(self.names) if name == target))

    def errors(self, full: Mapping[str, Array], host: Array, spread: Array) -> dict[str, Array]:
        """(B, B) errors of the mean spectrum of the pixels, by source.

        By the shares: D^T cov(f) D with the contrasts D (J, B) to the host.  By the ground at the place:
        (1 - sum f_j)^2 of the host's own spread.  The pixels of one object are near each other, so the host in them
        counts as one draw of its class and not as n: an upper limit, which overstates errors independent from pixel
        to pixel, noise above all.

        ``full`` : target -> (B,) reflectance;  ``host``, ``spread`` : (B,) and (B, B) of the class, its gain included
        """
        contrast = np.array([full[name] - host for name in self.names])
        host_share = 1.0 - self.mean.sum()
        return {PLACE: contrast.T @ self.covariance @ contrast, HOST: host_share**2 * spread}


@lru_cache(maxsize=512)  # a few numbers each
def shares_of(
    owner: str, population: TargetSubject, populations: Populations, position_m: float | None, seed: int
) -> Shares:
    """Shares of the pixels of one object of a target that has a geometry and a place.

    Parameters
    ----------
    position_m : standard uncertainty of the places of neighbours in line and sample [m], None: known

    >>> geometry = {"side_m": 0.25, "gsd_m": 1.0, "psf_fwhm_pixels": 1.0, "pixels": "touched"}  # 1, 2 or 4 pixels
    >>> plank = TargetSubject(name="plank", position_m=(0.0, 0.0), fill={"geometry": geometry})
    >>> expected = np.nanmean(fills_of_objects(plank.fill), axis=1).mean()
    >>> bool(abs(shares_of("plank", plank, (), None, 0).expected_share("plank") - expected) < 1e-4)
    True
    """
    adjacent = neighbours_of(population, populations)
    target, neighbours = _fills_at_places(population, (population, *(s for _, s in adjacent)), position_m, False, seed)
    shares = np.concatenate([np.nanmean(target, axis=1)[:, None], np.nanmean(neighbours, axis=1)], axis=1)  # (K, J)
    mean = shares.mean(axis=0)
    departures = shares - mean
    return Shares((owner, *(name for name, _ in adjacent)), mean, departures.T @ departures / len(shares))
