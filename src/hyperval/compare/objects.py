"""Every object's measured score against its predicted distribution, and all objects together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from hyperval.compare.rows import RowMaker
from hyperval.errors import UsageError
from hyperval.processing.intervals import clopper_pearson
from hyperval.products import ObjectScores
from hyperval.results import Result

Array = npt.NDArray[np.float64]

EVERY_OBJECT = "all objects"
OF_ONE = ("object_score_pit", "object_score_inside_95")
OF_ALL = ("objects_inside_95", "objects_inside_95_p_value", "pit_uniformity_p_value")
# Sets of objects drawn from the prediction, for what the model itself expects of them together.
REPLICATES = 4000
_SEED = 17


def probability_integral_transform(score: npt.ArrayLike, draws: npt.ArrayLike) -> Array:
    """(n,) share of the predicted draws (N,) below each measured score (n,), equal ones counted half.

    Over many objects, each with its own prediction, the values are uniform on (0, 1) when the predictions are
    right, so objects of different kinds are judged together.  Source: Rosenblatt, Ann. Math. Stat. 23, 470, 1952.
    The share is (below + 1/2) / (N + 1), so that no score is impossible to a finite number of draws.
    """
    ordered = np.sort(np.asarray(draws, dtype=float), axis=None)
    at = np.asarray(score, dtype=float)
    below = 0.5 * (np.searchsorted(ordered, at, "left") + np.searchsorted(ordered, at, "right"))
    return np.asarray((below + 0.5) / (ordered.size + 1.0))


def distance_from_uniform(values: npt.ArrayLike) -> Array:
    """(...) Kolmogorov-Smirnov distance of values (..., n) from the uniform distribution on (0, 1)."""
    u = np.sort(np.asarray(values, dtype=float), axis=-1)
    n = u.shape[-1]
    if n == 0 or not np.all((u >= 0) & (u <= 1)):
        raise UsageError("the uniformity test needs values between 0 and 1")
    step = np.arange(n + 1) / n
    return np.asarray(np.maximum((step[1:] - u).max(axis=-1), (u - step[:-1]).max(axis=-1)))


@dataclass(frozen=True)
class Together:
    """Objects judged together.

    Attributes
    ----------
    inside : part of the objects in their predicted 95 % intervals
    interval : exact 95 % interval of that part if the objects were independent
    expected : 95 % range of it that the model expects, with what its objects have in common
    inside_p_value : probability of so few (or fewer) inside, by the model
    uniformity_p_value : probability of so large a distance of the transform values from uniformity, by the model
    """

    inside: float
    interval: tuple[float, float]
    expected: tuple[float, float]
    inside_p_value: float
    uniformity_p_value: float


def judged_together(predicted: Mapping[str, ObjectScores], measured: Mapping[str, Array]) -> Together:
    """Transform values of all objects against what the model expects of them.

    Objects of one material share the error of its spectrum and all share the blur, so their values are not
    independent and the customary tests would reject right models.  The reference is therefore drawn from the
    prediction: one row of it (one draw of the inputs) for all objects, then each object within that row.

    Parameters
    ----------
    predicted, measured : by subject; (n,) scores of its objects
    """
    rng = np.random.default_rng(_SEED)
    rows = {predicted[s].values.shape[0] for s in measured}
    if len(rows) > 1:
        raise UsageError("the predicted scores of the subjects do not share their draws of the inputs")
    row = rng.integers(rows.pop(), size=REPLICATES)
    values, drawn = [], []
    for subject, scores in measured.items():
        draws = predicted[subject].values
        values.append(probability_integral_transform(scores, draws))
        rank = stats.rankdata(draws, method="average").reshape(draws.shape) / (draws.size + 1.0)
        column = rng.integers(draws.shape[1], size=(REPLICATES, scores.size))
        drawn.append(rank[row[:, None], column])
    u, reference = np.concatenate(values), np.concatenate(drawn, axis=1)
    count, n = int(np.sum(central(u))), u.size
    expected = central(reference).sum(axis=1)
    distances = distance_from_uniform(reference)
    low, high = clopper_pearson(count, n)
    span = np.quantile(expected, [0.025, 0.975], method="nearest") / n
    return Together(
        count / n,
        (float(low), float(high)),
        (float(span[0]), float(span[1])),
        float((1 + np.sum(expected <= count)) / (1 + REPLICATES)),
        float((1 + np.sum(distances >= distance_from_uniform(u))) / (1 + REPLICATES)),
    )


def central(values: Array) -> npt.NDArray[np.bool_]:
    """True for transform values in the central 95 %."""
    return np.asarray((values >= 0.025) & (values <= 0.975))


def compare_object_scores(
    predicted: Mapping[str, ObjectScores],
    measured: Mapping[str, ObjectScores],
    *,
    campaign: str,
    method: str,
    subject: str = EVERY_OBJECT,
) -> list[Result]:
    """Every object's measured score against its predicted distribution, then all of them together.

    A subject of one object gives ``object_score_measured``, ``object_score_predicted`` (median and 95 % interval),
    ``object_score_pit`` and ``object_score_inside_95`` (1 or 0); a subject of several gives the summary below for
    itself.  All together (``subject``): ``objects_inside_95`` the share inside with its Clopper-Pearson interval,
    ``objects_inside_95_p_value`` and ``pit_uniformity_p_value``, both by :func:`judged_together`.  Subjects that
    were measured and not predicted are left out; one that was predicted and has no valid score gives SKIPPED rows
    and is named in the reason of the summary.
    """
    out: list[Result] = []
    held: dict[str, Array] = {}
    lost: list[str] = []
    for name, model in predicted.items():
        make = RowMaker(campaign, "scores", name, method)
        scores = measured[name].values if name in measured else np.empty(0)
        scores = scores[np.isfinite(scores)]
        if scores.size == 0:
            out += [make.skipped("no measured score", metric) for metric in OF_ONE]
            lost.append(name)
            continue
        held[name] = scores
        if scores.size > 1:
            out += _together_rows(make, {name: model}, {name: scores}, "")
            continue
        low, middle, high = (float(x) for x in np.quantile(model.values, [0.025, 0.5, 0.975]))
        u = float(probability_integral_transform(scores, model.values)[0])
        out += [
            make.row("object_score_measured", float(scores[0]), n=1),
            make.row("object_score_predicted", middle, interval=(low, high)),
            make.row("object_score_pit", u, n=1),
            make.row(
                "object_score_inside_95",
                float(central(np.array([u]))[0]),
                n=1,
                reason=f"measured {scores[0]:.4g}, predicted {low:.4g} to {high:.4g}",
            ),
        ]
    make = RowMaker(campaign, "scores", subject, method)
    if not held:
        return [*out, *(make.skipped("no object has both sides", metric) for metric in OF_ALL)]
    return [*out, *_together_rows(make, predicted, held, f"; without {', '.join(lost)}" if lost else "")]


def _together_rows(
    make: RowMaker, predicted: Mapping[str, ObjectScores], held: Mapping[str, Array], lost: str
) -> list[Result]:
    found, n = judged_together(predicted, held), sum(x.size for x in held.values())
    low, high = found.expected
    return [
        make.row(
            OF_ALL[0],
            found.inside,
            interval=found.interval,
            n=n,
            reason=f"the model expects {low:.3g} to {high:.3g}; the interval takes objects for independent{lost}",
        ),
        make.row(OF_ALL[1], found.inside_p_value, n=n, reason=f"that so few lie inside, by the model{lost}"),
        make.row(
            OF_ALL[2],
            found.uniformity_p_value,
            n=n,
            reason=f"Kolmogorov-Smirnov distance, against sets of objects drawn from the model{lost}",
        ),
    ]
