"""Scores and ROC curves of every target population, from a batch of evaluations (3.26-3.33).

ACE scores and ROC curves of target populations, by conditional Monte Carlo, one evaluation after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.prediction.batch import Batch, Group
from hyperval.prediction.departure import Fills
from hyperval.prediction.filters import FilterBase, Population, noise_of
from hyperval.processing.ace_model import (
    AceSpace,
    Exceedance,
    ace_exceedance,
    ace_space,
    ace_threshold,
    exceedance_at,
)
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.processing.roc_model import RocScores, false_alarm_grid
from hyperval.products import ExceedanceCurve, ObjectScores, RocCurve, ScoreDistribution, background_of
from hyperval.scene.fill import fixed_fill

Array = npt.NDArray[np.float64]

# P_D in probit is smooth in the fill: Chebyshev nodes over the fills that occur.
_NODES = 7
# Most of a pixel's draws are plain; the others reach where it has the false alarms of its host alone.
_DECADES = (0.0, 0.0, 0.0, 0.0, 3.0, 6.0)


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
class _AceEvaluation:
    """One evaluation: its group and number in it, filter base, space, and the exceedance of the background.

    ``host`` : the laws of the target's host: part, pixels of host alone, degrees of freedom
    """

    group: Group
    u: int
    point: int
    target: int
    base: FilterBase
    space: AceSpace
    background: Exceedance
    threshold: Array
    host: Sequence[tuple[float, Population, float]]


def ace_scores(batch: Batch, population: str, pfa: Array, object_curves: bool = True) -> AceScores:
    """ACE of target pixels and background in every evaluation of a batch; the host of a pixel keeps its laws."""
    number, subject, _ = batch.population(population)
    target, background, thresholds, errors = [], [], [], []
    detection: dict[str, list[Array]] = {unit: [] for unit in (("pixel", "object") if object_curves else ("pixel",))}
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


def _at_nodes(batch: Batch, e: _AceEvaluation) -> tuple[Array, list[Exceedance]]:
    """Fills that span those of all populations of a target, and its exceedances there."""
    reach = []
    for k in range(len(batch.targets[e.target].populations)):
        # Those of whole objects too, even where their curve is not asked for.
        reach += [batch.fill_of(e.point, e.target, k).values, _objects(batch, e.point, e.target, k)[1].ravel()]
    every = np.concatenate(reach)
    nodes = _nodes(float(every.min()), float(every.max()))
    return nodes, [_at_fill(batch, e, float(f)) for f in nodes]


def _evaluation(batch: Batch, point: int, target: int, pfa: Array) -> _AceEvaluation:
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
    each = batch.points.law_dof
    dof = each[point if each.shape[0] > 1 else 0]
    decades = np.linspace(0.0, -float(np.log10(pfa[0])), 4).tolist()
    classes, pixels = [], []
    for j, law in enumerate(laws):
        m, gain = law.owner, at.gains[u, law.owner]
        mean = seen.means[u, m]
        if law.offset is not None:
            mean = mean + np.sqrt(gain) * seen.slope[u] * law.offset
        as_part = Population(gain * law.covariance, seen.around[u, m], mean, seen.noise[u, m])
        pixels.append(as_part)
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
    own, parts, _ = batch.host_laws(target)
    host = [(float(part), pixels[j], float(dof[j])) for j, part in zip(own, parts, strict=True)]
    return _AceEvaluation(group, u, point, target, base, space, mixture, threshold, host)


def _base(batch: Batch, group: Group, u: int) -> FilterBase:
    mixture = group.designer.mixture(group.at, group.seen, u)
    return group.designer.base(mixture, lambda reflectance: noise_of(group.at, group.seen, u, reflectance))


def covariance_of(part: Population, group: Group, u: int) -> Array:
    """(F, F) covariance of pixels as the detector of setting ``u`` sees them (3.11-3.21)."""
    slope, surroundings = group.seen.slope[u], group.at.grounds[group.at.which[u]].covariance
    covariance = part.covariance * np.outer(slope, slope) + surroundings * np.outer(part.around, part.around)
    return np.asarray(covariance + np.diag(part.noise))


def _at_fill(batch: Batch, e: _AceEvaluation, fill: float) -> Exceedance:
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
    whole, share = covariance_of(pixels, group, e.u), 1.0 - fill
    number = batch.class_names.index(batch.targets[e.target].host)
    class_mean, slope = group.seen.means[e.u, number], group.seen.slope[e.u]
    surface = group.at.grounds[group.at.which[e.u]].covariances[number] * group.at.gains[e.u, number]
    by_law = []
    for k, (part, law, dof) in enumerate(e.host):
        # A law of the host differs from its class in mean and spread; what has its tails is what it has alone.
        total = whole + share**2 * (law.covariance - surface) * np.outer(slope, slope)
        tailed = share**2 * covariance_of(law, group, e.u) if np.isfinite(dof) else total
        one = ace_exceedance(
            e.space, e.base.of(mean + share * (law.mean - class_mean)), e.base.spread(tailed), processing.samples,
            np.random.default_rng([processing.seed, 1_000_003, *([k] if k else [])]),
            float(dof) if np.isfinite(dof) else None,
            decades=_DECADES, normal=e.base.spread(total - tailed) if np.isfinite(dof) else None,
        )  # fmt: skip
        by_law.append((part, one))
    return Exceedance(
        by_law[0][1].scores,
        np.asarray(sum(part * one.probability for part, one in by_law)),
        np.sqrt(sum((part * one.standard_error) ** 2 for part, one in by_law)),
    )


def _alarm_error(e: _AceEvaluation) -> float:
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


RocKey = tuple[str, str, str]

# Score distributions are tabulated on this many points, over this many standard deviations either way.
_GRID, _REACH = 201, 6.0


@dataclass(frozen=True)
class PredictedDetection:
    """Scores and ROC curves of one evaluation, and what is to be said of them.

    Attributes
    ----------
    curves : P_D (n, K) of all evaluations of the batch, at the false-alarm probabilities of the curves
    expected_scores : (what lies there, target, detector) -> mean score of such a pixel [1]
    """

    scores: dict[tuple[str, str], ScoreDistribution] = field(default_factory=dict)
    roc: dict[RocKey, RocCurve] = field(default_factory=dict)
    exceedance: dict[tuple[str, str], ExceedanceCurve] = field(default_factory=dict)
    object_scores: dict[tuple[str, str], ObjectScores] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    curves: Mapping[RocKey, Array] = field(default_factory=dict)
    expected_scores: Mapping[tuple[str, str, str], float] = field(default_factory=dict)


def detect(batch: Batch, *, object_curves: bool = True, points: Sequence[int] = (0,)) -> list[PredictedDetection]:
    """Scores and ROC curves of all target populations (3.22-3.33) of some evaluations of a batch.

    Raises
    ------
    UsageError : no filter, as the background can not be inverted.
    """
    processing = batch.scenario.processing
    by_point = [PredictedDetection() for _ in points]
    notes: list[list[str]] = [[] for _ in points]
    if not batch.targets or not processing.detectors:
        return by_point
    for error in batch.problems.values():
        raise error
    grid = processing.false_alarm_grid
    pfa = false_alarm_grid(grid.lowest, grid.per_decade)
    for target in batch.targets:
        for name in processing.detectors:
            populations = [p.name for p in target.populations]
            if name in LINEAR_DETECTORS:
                for population in populations:
                    _add_linear(batch, by_point, points, target.name, population, name, pfa, object_curves)
                continue
            drawn = [ace_scores(batch, population, pfa, object_curves) for population in populations]
            for population, scores in zip(populations, drawn, strict=True):
                _add_numerical(by_point, points, population, name, pfa, scores)
            for note, point in zip(notes, points, strict=True):
                worst = max(s.error[point] for s in drawn)
                note.append(
                    f"{name} of {target.name}: {processing.samples} draws per class; standard error of P_D at most "
                    f"{worst:.2g}, of P_FA at {pfa[0]:.1g} {100 * drawn[0].alarm_error[point]:.2g} %"
                )
    return [
        PredictedDetection(d.scores, d.roc, d.exceedance, {}, tuple(n), d.curves)
        for d, n in zip(by_point, notes, strict=True)
    ]


def _add_linear(
    batch: Batch, by_point: Sequence[PredictedDetection], points: Sequence[int], target: str, population: str,
    name: str, pfa: Array, object_curves: bool,
) -> None:  # fmt: skip
    scores = batch.scores(population, name)
    behind = batch.once(("background", target, name), lambda: _Background.of_scores(scores, pfa, points))
    # Truths that move other things than this target's scores share what follows from them.
    first, which = scores.distinct() if not object_curves else 2 * (np.arange(len(batch)),)
    threshold = behind.threshold[first]
    pd = scores.rows(first).detection_above(threshold)
    by_unit = {"pixel": pd}
    if object_curves:
        objects = batch.object_scores(population, name)
        alone = objects.objects is None and objects.means.shape == scores.means.shape
        by_unit["object"] = pd if alone else objects.detection_above(threshold)
    wanted, row_of = np.unique(which[list(points)], return_inverse=True)
    some = scores.rows(first[wanted])
    distributions = _distributions(some.mean, some.sd, some.target_density)
    for into, point, row in zip(by_point, points, row_of.tolist(), strict=True):
        background, preset = behind.of[int(scores.which[point])]
        at, mine = behind.threshold[point], int(which[point])
        into.scores[population, name] = distributions[row]
        into.scores[background_of(population), name] = background
        for unit, curve in by_unit.items():
            into.roc[population, name, unit] = RocCurve(pfa, *(curve[mine],) * 3, at, unit, preset_pfa=preset)  # type: ignore[arg-type]
        into.exceedance[target, name] = ExceedanceCurve(at[::-1], *(pfa[::-1],) * 3)
        into.curves.update({(population, name, unit): curve[which] for unit, curve in by_unit.items()})  # type: ignore[attr-defined]


@dataclass(frozen=True)
class _Background:
    """What the background scores by one filter, which all populations of its target share.

    Attributes
    ----------
    threshold : (n, K) of all evaluations
    of : number of its laws -> distribution of their score and preset P_FA (K,), for the points that were asked for
    """

    threshold: Array
    of: Mapping[int, tuple[ScoreDistribution, Array]]

    @staticmethod
    def of_scores(scores: RocScores, pfa: Array, points: Sequence[int]) -> _Background:
        threshold, at = scores.thresholds(pfa[None]), np.array(points)
        rows, first = np.unique(scores.which[at], return_index=True)
        some, c = scores.rows(at[first]), scores.classes.rows(rows)
        mean = (c.fraction * c.mean).sum(axis=1)
        sd = np.sqrt((c.fraction * (c.sd**2 + (c.mean - mean[:, None]) ** 2)).sum(axis=1))
        distributions = _distributions(mean, sd, some.background_density)
        presets = some.preset(threshold[at[first]])
        return _Background(threshold, dict(zip(rows.tolist(), zip(distributions, presets, strict=True), strict=True)))


def _add_numerical(
    by_point: Sequence[PredictedDetection],
    points: Sequence[int],
    population: str,
    name: str,
    pfa: Array,
    scores: AceScores,
) -> None:
    for into, point in zip(by_point, points, strict=True):
        into.scores[population, name] = scores.target[point]
        into.scores[background_of(population), name] = scores.background[point]
        for unit, curve in scores.detection.items():
            p, threshold = curve[point], scores.threshold[point]
            into.roc[population, name, unit] = RocCurve(pfa, p, p, p, threshold, unit)  # type: ignore[arg-type]
            into.curves[population, name, unit] = curve  # type: ignore[index]


def _distributions(mean: Array, sd: Array, density: Callable[[Array], Array]) -> list[ScoreDistribution]:
    """Moments and density of a score in n evaluations."""
    grid = np.linspace(mean - _REACH * sd, mean + _REACH * sd, _GRID, axis=-1)
    rows = zip(mean.tolist(), sd.tolist(), grid, density(grid), strict=True)
    return [ScoreDistribution(m, s, None, g, d) for m, s, g, d in rows]
