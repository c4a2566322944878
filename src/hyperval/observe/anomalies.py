"""Anomalies: pixels that stand out of the background, whatever they are, where no target is looked for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.imagery.regions import objects
from hyperval.observe.place import Place
from hyperval.processing.alarm_blocks import AlarmBlocks
from hyperval.processing.exceedance import (
    ANOMALY_LEVELS,
    FEWEST_FOR_A_CURVE,
    LEAST_EXPECTED_ALARMS,
    exceedance_curve,
)
from hyperval.products import ANOMALIES, ExceedanceCurve, ScoreDistribution, background_of

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MOST_NAMED = 10


def anomaly_products(
    detector: str, scores: Array, background: Mask
) -> tuple[dict[tuple[str, str], ScoreDistribution], dict[tuple[str, str], ExceedanceCurve]]:
    """Moments of the background's score and how often it lies above a threshold, by their keys of the products.

    Parameters
    ----------
    scores : (lines, samples), NaN where invalid
    background : (lines, samples) True where pixels count for false alarms
    """
    noise = AlarmBlocks.of_map(scores, background)
    sd = float(np.std(noise.scores, ddof=1)) if noise.scores.size > 1 else float("nan")
    moments = ScoreDistribution(float(np.mean(noise.scores)), sd, int(noise.scores.size))
    curves = {}
    if noise.scores.size >= FEWEST_FOR_A_CURVE:
        curves[ANOMALIES, detector] = exceedance_curve(noise)
    return {(background_of(ANOMALIES), detector): moments}, curves


def anomaly_note(place: Place, detector: str, scores: Array, background: Mask) -> str:
    """The strongest groups of touching pixels above the threshold that the background passes at a low rate.

    The rate is the lowest of 1e-4, 1e-3 and 1e-2 at which the background leaves ten pixels or more: they fix the
    threshold, and belong to the groups themselves where the background is the whole scene.
    """
    noise = scores[background & np.isfinite(scores)]
    level = next((p for p in ANOMALY_LEVELS if p * noise.size >= LEAST_EXPECTED_ALARMS), None)
    if level is None:
        return f"{detector}: {noise.size} background pixels are too few for a threshold of anomalies"
    threshold = float(np.sort(noise)[noise.size - 1 - int(level * noise.size)])
    labels, count = objects(np.nan_to_num(scores, nan=-np.inf) > threshold)
    if not count:
        return f"{detector}: no pixel beyond {threshold:.4g}, which {level:g} of the background exceeds"
    inside = labels > 0
    best = np.full(count + 1, -np.inf)
    np.maximum.at(best, labels[inside], scores[inside])
    sizes = np.bincount(labels[inside], minlength=count + 1)
    strongest = np.argsort(-best[1:], kind="stable")[:MOST_NAMED] + 1
    words = [_in_words(place, scores, labels == number, int(sizes[number])) for number in strongest]
    more = f"; and {count - MOST_NAMED} weaker" if count > MOST_NAMED else ""
    return (
        f"{detector}: {count} anomalies, groups of touching pixels beyond {threshold:.4g}, which {level:g} of the "
        f"background exceeds: {'; '.join(words)}{more}"
    )


def _in_words(place: Place, scores: Array, group: Mask, size: int) -> str:
    line, sample = (int(i) for i in np.unravel_index(np.argmax(np.where(group, scores, -np.inf)), scores.shape))
    where = f"line {line}, sample {sample}"
    transform = place.cube.transform
    if transform is not None:
        x, y = transform @ (sample + 0.5, line + 0.5)
        where += f" ({x:.2f}, {y:.2f})"
    return f"{where}: {scores[line, sample]:.4g}, {size} pixel{'' if size == 1 else 's'}"
