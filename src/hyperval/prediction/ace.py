"""ACE scores and ROC curves of target populations, by conditional Monte Carlo, one evaluation after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.prediction.batch import Batch, Group
from hyperval.prediction.fills import Fills
from hyperval.prediction.filters import FilterBase, Population, noise_of
from hyperval.processing.ace_model import (
    AceSpace,
    Exceedance,
    ace_exceedance,
    ace_space,
    ace_threshold,
    exceedance_at,
)
from hyperval.products import ScoreDistribution
from hyperval.scene.fill import fixed_fill

Array = npt.NDArray[np.float64]

# P_D in probit is smooth in the fill: Chebyshev nodes over the fills that occur.
_NODES = 7


@dataclass(frozen=True)
class AceScores:
    """Scores of one population in n evaluations.

    Attributes
    ----------
    target, background : score distributions
    threshold : (n, K)
    detection : unit -> (n, K) P_D
    error : (n,) greatest standard error of P_D, of the draws
    alarm_error : (n,) standard error of P_FA at the least of its values, as a part of it
    """

    target: Sequence[ScoreDistribution]
    background: Sequence[ScoreDistribution]
    threshold: Array
    detection: dict[str, Array]
    error: Array
    alarm_error: Array


@dataclass(frozen=True)
class _Evaluation:
    """One evaluation: its group and number in it, filter base, space, and the exceedance of the background."""

    group: Group
    u: int
    point: int
    target: int
    base: FilterBase
    space: AceSpace
    background: Exceedance
    threshold: Array


def ace_scores(batch: Batch, population: str, pfa: Array, object_curves: bool = True) -> AceScores:
    """ACE of target pixels and background in every evaluation of a batch.

    Target pixels are Gaussian with the moments of their fill.
    """
    number, subject, _ = batch.population(population)
    target, background, thresholds, errors = [], [], [], []
    detection: dict[str, list[Array]] = {
        unit: [] for unit in (("pixel", "object") if object_curves else ("pixel",))
    }
    for point in range(len(batch)):
        e = batch.once(("ace", point, number), lambda p=point: _evaluation(batch, p, number, pfa))  # type: ignore[misc]
        fill = batch.fill_of(point, number, subject)
        nodes, at_nodes = batch.once(("ace nodes", point, number), lambda e=e: _at_nodes(batch, e))  # type: ignore[misc]
        whole, objects = _objects(batch, point, number, subject)
        pixel = _averaged(at_nodes, nodes, fill.values[:, None], fill.weights)
        target.append(_distribution(pixel))
        background.append(_distribution(e.background))
        thresholds.append(e.threshold)
        detection["pixel"].append(exceedance_at(e.threshold, pixel))
        if object_curves:
            pd = detection["pixel"][-1]
            if whole.shape is not None:
                weights = np.full(objects.shape[0], 1.0 / objects.shape[0])
                pd = exceedance_at(e.threshold, _averaged(at_nodes, nodes, objects, weights))
            detection["object"].append(pd)
        errors.append((max(float(x.standard_error.max()) for x in at_nodes), _alarm_error(e)))
    each = {unit: np.array(curves) for unit, curves in detection.items()}
    error, alarm_error = np.array(errors).T
    return AceScores(target, background, np.array(thresholds), each, error, alarm_error)


def _objects(batch: Batch, point: int, target: int, population: int) -> tuple[Fills, Array]:
    """Fills of the pixels of whole objects in one evaluation, and the same as (places, pixels)."""
    whole = batch.fills(target, population, True)
    row = whole.values[point if whole.values.shape[0] > 1 else 0]
    return whole, row.reshape(whole.shape or (-1, 1))


def _at_nodes(batch: Batch, e: _Evaluation) -> tuple[Array, list[Exceedance]]:
    """Fills that span those of all populations of a target, and its exceedances there."""
    reach = []
    for k in range(len(batch.targets[e.target].populations)):
        # Those of whole objects too, even where their curve is not asked for.
        reach += [batch.fill_of(e.point, e.target, k).values, _objects(batch, e.point, e.target, k)[1].ravel()]
    every = np.concatenate(reach)
    nodes = _nodes(float(every.min()), float(every.max()))
    return nodes, [_at_fill(batch, e, float(f)) for f in nodes]


def _evaluation(batch: Batch, point: int, target: int, pfa: Array) -> _Evaluation:
    processing, setting = batch.scenario.processing, int(batch.points.setting[point])
    group = next(g for g in batch.groups if setting in g.numbers)
    u = int(np.searchsorted(group.numbers, setting))
    at, seen = group.at, group.seen
    base = _base(batch, group, u)
    space = ace_space(
        base.of(batch.spectrum_as_seen(group, batch.targets[target].name)[u]), base.of(base.mean), base.factor
    )
    laws = at.grounds[at.which[u]].laws
    fractions = [at.fractions[u, law.owner] * law.weight for law in laws]
    each = batch.points.dof if batch.points.law_dof is None else batch.points.law_dof
    dof = each[point if each.shape[0] > 1 else 0]
    decades = np.linspace(0.0, -float(np.log10(pfa[0])), 4).tolist()
    classes = []
    for j, law in enumerate(laws):
        m, gain = law.owner, at.gains[u, law.owner]
        mean = seen.means[u, m]
        if law.offset is not None:
            mean = mean + np.sqrt(gain) * seen.slope[u] * law.offset
        as_part = Population(0.0, gain * law.covariance, seen.around[u, m], mean, seen.noise[u, m])
        classes.append(
            ace_exceedance(
                space, base.of(as_part.mean), base.spread(covariance_of(as_part, group, u)), processing.samples,
                np.random.default_rng([processing.seed, j]), None if np.isinf(dof[j]) else float(dof[j]),
                decades=decades,
            )
        )  # fmt: skip
    mixture = Exceedance(
        classes[0].scores,
        np.asarray(sum(f * c.probability for f, c in zip(fractions, classes, strict=True))),
        np.sqrt(sum((f * c.standard_error) ** 2 for f, c in zip(fractions, classes, strict=True))),
    )
    threshold = ace_threshold(pfa, fractions, classes)
    return _Evaluation(group, u, point, target, base, space, mixture, threshold)


def _base(batch: Batch, group: Group, u: int) -> FilterBase:
    populations = batch.filter_populations(group, u)
    mixture = group.designer.mixture(group.at, group.seen, u, populations)
    return group.designer.base(mixture, lambda reflectance: noise_of(group.at, group.seen, u, reflectance))


def covariance_of(part: Population, group: Group, u: int) -> Array:
    """(F, F) covariance of pixels as the detector of setting ``u`` sees them (3.11-3.21)."""
    slope, surroundings = group.seen.slope[u], group.at.grounds[group.at.which[u]].covariance
    covariance = part.covariance * np.outer(slope, slope) + surroundings * np.outer(part.around, part.around)
    return np.asarray(covariance + np.diag(part.noise))


def _at_fill(batch: Batch, e: _Evaluation, fill: float) -> Exceedance:
    processing, group = batch.scenario.processing, e.group
    pixels = batch.population_at(group, e.u, e.point, e.target, fixed_fill(fill))
    mean, shift = pixels.mean, float(np.broadcast_to(batch.points.shift, (len(batch),))[e.point])
    name = batch.targets[e.target].name
    if shift and name in batch.errors:
        # The true target departs along the filter's own direction, by standard deviations of its score.
        error = batch.errors[name][np.ix_(group.bands, group.bands)]
        slope = group.seen.slope[e.u]
        u = e.base.filter("matched-filter", batch.spectrum_as_seen(group, name)[e.u]).weights * slope
        mean = mean + shift * fill * (error @ u / np.sqrt(float(u @ error @ u))) * slope
    rng = np.random.default_rng([processing.seed, 1_000_003])
    spread = e.base.spread(covariance_of(pixels, group, e.u))
    return ace_exceedance(e.space, e.base.of(mean), spread, processing.samples, rng)


def _alarm_error(e: _Evaluation) -> float:
    first = int(np.searchsorted(e.background.scores, e.threshold[0]).clip(0, e.background.scores.size - 1))
    return float(e.background.standard_error[first] / max(e.background.probability[first], 1e-300))


def _nodes(low: float, high: float) -> Array:
    if high - low < 1e-9:
        return np.array([low])
    return 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * np.arange(_NODES) / (_NODES - 1))


def _averaged(at_nodes: list[Exceedance], nodes: Array, fills: Array, weights: Array) -> Exceedance:
    """Probability that any of the pixels with ``fills`` (K, n) passes, averaged with ``weights`` (K,)."""
    scores, error = at_nodes[0].scores, np.max([e.standard_error for e in at_nodes], axis=0)
    z = ndtri(np.clip([e.probability for e in at_nodes], 1e-300, 1.0 - 1e-16))  # (nodes, S)
    if nodes.size == 1:
        missed = (1.0 - ndtr(z[0])) ** fills.shape[1]
        return Exceedance(scores, 1.0 - missed, error)
    distinct, inverse = np.unique(fills.round(6), return_inverse=True)
    table = ndtr(np.stack([np.interp(distinct, nodes, row) for row in z.T], axis=1))  # (fills, S)
    log_missed = np.log(np.clip(1.0 - table, 1e-300, 1.0))
    missed = np.exp(log_missed[inverse.reshape(fills.shape)].sum(axis=1))
    return Exceedance(scores, 1.0 - weights @ missed, error)


def _distribution(population: Exceedance) -> ScoreDistribution:
    mean, sd = population.moments
    density = np.clip(-np.gradient(population.probability, population.scores), 0.0, None)
    return ScoreDistribution(mean, sd, None, population.scores, density)
