"""What whole objects score in many truths, each with all inputs certain (3.26, 3.28 for objects).

All truths see the same drawn numbers, so that their differences are free of scatter; and an object whose scores
follow from the same response in two truths has the same draws in both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

from hyperval.prediction.batch import Batch
from hyperval.prediction.input_draws import ROWS
from hyperval.prediction.object_scores import (
    COLUMNS,
    Key,
    Numbers,
    Objects,
    drawn_numbers,
    greatest_scores,
    neighbours_of,
    predicted_object_scores,
    response_nodes,
)
from hyperval.prediction.setup import Setup
from hyperval.processing.filters import LINEAR_DETECTORS
from hyperval.products import ObjectScores
from hyperval.scenario import Target, TargetSubject

Array = npt.NDArray[np.float64]


def object_scores_of_truths(
    batch: Batch, setups: Sequence[Setup], draws: int | None = None
) -> list[dict[Key, ObjectScores]]:
    """The draws of :func:`predicted_object_scores` for each evaluation of a batch; ``setups`` are its truths.

    Where replicates leave the spectrum of a target uncertain, each has draws of that too.
    """
    points: npt.NDArray[np.intp] = np.arange(len(setups))
    if any(target.name in batch.errors for target in batch.targets):
        each = enumerate(setups)
        return [predicted_object_scores(batch, np.array([p]), s.scenario.scene.targets, draws) for p, s in each]

    @cache
    def nodes(target: str, detector: str, holds: int) -> tuple[Array, Array]:
        return response_nodes(batch, points, target, detector, holds)

    numbers_of = {target.name: i for i, target in enumerate(batch.targets)}
    linear = [d for d in batch.scenario.processing.detectors if d in LINEAR_DETECTORS]
    dof = np.broadcast_to(batch.points.dof, (len(batch), len(batch.class_names)))
    out: list[dict[Key, ObjectScores]] = [{} for _ in setups]
    for number, target in enumerate(batch.targets):
        tails = dof[:, batch.class_names.index(target.host)]
        alike: dict[tuple[int, float], list[int]] = {}
        for point, setup in enumerate(setups):
            alike.setdefault((id(setup.room), float(tails[point])), []).append(point)
        for (_, tail), members in alike.items():
            setup = setups[members[0]]
            for population in setup.scenario.scene.targets[number].populations:
                beside = _beside(setup, setup.scenario.scene.targets[number], population)
                wanted = _objects(setup, population, beside, tail, len(linear), draws)
                numbers = _few_numbers(wanted) if draws else drawn_numbers(wanted, np.zeros(1))
                for name, more in zip(linear, numbers.more, strict=True):
                    own = nodes(target.name, name, number)
                    full = [nodes(target.name, name, numbers_of[t.name]) for t, _ in beside]
                    beside_them = [(m[members], v[members]) for m, v in full]
                    scores = _scores(own[0][members], own[1][members], beside_them, numbers, more)
                    for point, one in zip(members, scores, strict=True):
                        out[point][population.name, name] = one
    return out


def _scores(
    means: Array, variances: Array, beside: Sequence[tuple[Array, Array]], numbers: Numbers, more: Array | None
) -> Iterator[ObjectScores]:
    """Draws of an object in P truths, by (P, 9) moments of pixels with parts of itself, and of each neighbour."""
    rows, nodes = numbers.weights.reshape(-1, means.shape[1]), np.concatenate([means, variances])
    moments = (nodes @ rows.T).reshape(2, len(means), *numbers.fills.shape)
    made: dict[bytes, ObjectScores] = {}
    for p, (mean, variance) in enumerate(moments.swapaxes(0, 1)):
        full = np.array([(level[p, -1], spread[p, -1]) for level, spread in beside]).reshape(-1, 2)
        key = nodes[[p, len(means) + p]].tobytes() + full.tobytes()
        if key not in made:
            full_sd, host_sd = (np.sqrt(np.clip(v, 0.0, None)) for v in (full[:, 1], variances[p, 0]))
            mean = mean + numbers.others @ (full[:, 0] - means[p, 0])
            sd = numbers.shared_sd(np.clip(variance, 0.0, None), host_sd, full_sd)
            made[key] = greatest_scores(mean[numbers.places], sd, host_sd, numbers, more)
        yield made[key]


def _beside(setup: Setup, target: Target, population: TargetSubject) -> list[tuple[Target, TargetSubject]]:
    key, scenario = ("beside", population.name), setup.scenario
    if scenario.formulation == "thesis":
        return []
    if key not in setup.room:
        setup.room[key] = neighbours_of(target, population, scenario.scene.targets)
    beside: list[tuple[Target, TargetSubject]] = setup.room[key]
    return beside


def _objects(
    setup: Setup, population: TargetSubject, beside: Sequence[tuple[Target, TargetSubject]], tail: float,
    detectors: int, draws: int | None,
) -> Objects:  # fmt: skip
    scenario = setup.scenario
    return Objects(
        population, tuple(s for _, s in beside), 0.0, None, draws or ROWS * COLUMNS,
        scenario.formulation == "thesis", None if np.isinf(tail) else tail, detectors, scenario.processing.seed,
    )  # fmt: skip


@lru_cache(maxsize=64)  # populations; those of few draws, some 0.1 to 1 MB each
def _few_numbers(objects: Objects) -> Numbers:
    """The same numbers each time that a population is asked for."""
    return drawn_numbers(objects, np.zeros(1))
