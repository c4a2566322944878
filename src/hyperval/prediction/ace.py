"""ACE scores and ROC curves of target populations, by conditional Monte Carlo."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.prediction.detection import (
    Background,
    Detection,
    FilterBase,
    Task,
    seen_population,
)
from hyperval.prediction.fills import fills_of_objects, moments
from hyperval.processing.ace_model import (
    AceSpace,
    Exceedance,
    ace_exceedance,
    ace_space,
    ace_threshold,
    exceedance_at,
)
from hyperval.products import RocCurve, ScoreDistribution, background_of
from hyperval.scenario import Target
from hyperval.scene.fill import fixed_fill

Array = npt.NDArray[np.float64]

# P_D in probit is smooth in the fill: Chebyshev nodes over the fills that occur.
_NODES = 7


def add_ace(
    found: Detection,
    background: Background,
    target: Target,
    base: FilterBase,
    spectrum: Array,
    task: Task,
    shift: float,
    thesis: bool,
) -> str:
    """Add the scores and curves of one target to ``found``; the note says how exact they are.

    ``spectrum`` (F,) is what the detector looks for.  Target pixels are Gaussian with the moments of their fill.
    """
    draws, seed = task.processing.samples, task.processing.seed
    space = ace_space(base.of(spectrum), base.of(base.mean), base.factor)
    classes = [
        ace_exceedance(
            space,
            base.of(background.means[i]),
            base.spread(background.covariances[i]),
            draws,
            np.random.default_rng([seed, i]),
            background.tail_of(c),
            decades=np.linspace(0.0, -float(np.log10(task.pfa[0])), 4).tolist(),
        )
        for i, c in enumerate(background.classes)
    ]
    fractions = background.fractions
    threshold = ace_threshold(task.pfa, list(fractions), classes)
    mixture = Exceedance(
        classes[0].scores,
        np.asarray(sum(f * c.probability for f, c in zip(fractions, classes, strict=True))),
        np.sqrt(sum((f * c.standard_error) ** 2 for f, c in zip(fractions, classes, strict=True))),
    )
    worst = 0.0
    for population in target.populations:
        fill = moments(population, thesis)
        # The fills of whole objects are in the reach of the nodes even where their curve is not asked for.
        objects = np.array([[fill.mean]]) if thesis else fills_of_objects(population.fill)
        reach = np.concatenate([fill.values, objects.ravel()])
        nodes = _nodes(float(reach.min()), float(reach.max()))
        at_nodes = [_at_fill(space, base, background, target, float(f), task, shift, draws) for f in nodes]
        worst = max(worst, *(float(e.standard_error.max()) for e in at_nodes))
        pixel = _averaged(at_nodes, nodes, fill.values[:, None], fill.weights)
        found.scores[population.name, "ace"] = _distribution(pixel)
        found.scores[background_of(population.name), "ace"] = _distribution(mixture)
        pd = exceedance_at(threshold, pixel)
        found.roc[population.name, "ace", "pixel"] = RocCurve(task.pfa, pd, pd, pd, threshold, "pixel")
        if not task.object_curves:
            continue
        if objects.shape[1] > 1 or fill.values.size < objects.shape[0]:
            weights = np.full(objects.shape[0], 1.0 / objects.shape[0])
            pd = exceedance_at(threshold, _averaged(at_nodes, nodes, objects, weights))
        found.roc[population.name, "ace", "object"] = RocCurve(task.pfa, pd, pd, pd, threshold, "object")
    at = np.searchsorted(mixture.scores, threshold[[0, -1]]).clip(0, mixture.scores.size - 1)
    relative = mixture.standard_error[at[0]] / max(mixture.probability[at[0]], 1e-300)
    return (
        f"ace of {target.name}: {draws} draws per class; standard error of P_D at most {worst:.2g}, "
        f"of P_FA at {task.pfa[0]:.1g} {100 * relative:.2g} %"
    )


def _at_fill(
    space: AceSpace, base: FilterBase, background: Background, target: Target, fill: float, task: Task,
    shift: float, draws: int,
) -> Exceedance:  # fmt: skip
    mean, covariance = seen_population(background, target, fixed_fill(fill))
    error = task.spectrum_error.get(target.name)
    if error is not None and shift:
        # The true target departs along the filter's own direction, by standard deviations of its score.
        line, view = background.view.line(), background.view
        w = base.filter("matched-filter", task_spectrum(background, task, target))
        u = w.weights / line.gain * view.slope()
        moved = error @ u / np.sqrt(float(u @ error @ u))
        mean = mean + shift * fill * moved * view.slope() / line.gain
    rng = np.random.default_rng([task.processing.seed, 1_000_003])
    return ace_exceedance(space, base.of(mean), base.spread(covariance), draws, rng)


def task_spectrum(background: Background, task: Task, target: Target) -> Array:
    """(F,) what the detector looks for, as it sees it."""
    line, level = background.view.library_line(), background.view.level(task.looked_for[target.name])
    return np.asarray((level - line.offset) / line.gain)


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
