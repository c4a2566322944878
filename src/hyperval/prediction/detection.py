"""Scores and ROC curves of every target population, from a batch of evaluations (3.26-3.33)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hyperval.prediction.ace import AceScores, ace_scores
from hyperval.prediction.batch import Batch
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.processing.roc_model import RocScores
from hyperval.processing.thresholds import false_alarm_grid
from hyperval.products import ExceedanceCurve, ObjectScores, RocCurve, ScoreDistribution, background_of

Array = npt.NDArray[np.float64]
RocKey = tuple[str, str, str]

# Score distributions are tabulated on this many points, over this many standard deviations either way.
_GRID, _REACH = 201, 6.0


@dataclass(frozen=True)
class Detection:
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


def detect(batch: Batch, *, object_curves: bool = True, points: Sequence[int] = (0,)) -> list[Detection]:
    """Scores and ROC curves of all target populations (3.22-3.33) of some evaluations of a batch.

    Raises
    ------
    UsageError : no filter, as the background can not be inverted.
    """
    processing = batch.scenario.processing
    by_point = [Detection() for _ in points]
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
        Detection(d.scores, d.roc, d.exceedance, {}, tuple(n), d.curves)
        for d, n in zip(by_point, notes, strict=True)
    ]


def _add_linear(
    batch: Batch, by_point: Sequence[Detection], points: Sequence[int], target: str, population: str, name: str,
    pfa: Array, object_curves: bool,
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
        return _Background(
            threshold, dict(zip(rows.tolist(), zip(distributions, presets, strict=True), strict=True))
        )


def _add_numerical(
    by_point: Sequence[Detection],
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
