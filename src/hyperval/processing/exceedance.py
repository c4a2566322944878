"""How often background scores lie above a threshold, with an interval that knows that alarms come in clusters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from hyperval.errors import UsageError
from hyperval.products import ExceedanceCurve

Array = npt.NDArray[np.float64]

# A roof or a shadow is one piece of luck, not as many as it has pixels. Blocks are the pieces: so many of them that
# their scatter is known, and so large that neighbours hardly share one.
BLOCKS = 64
_SMALLEST_SIDE = 4
_PER_DECADE = 10
_LEAST_ALARMS = 5
FEWEST_FOR_A_CURVE = 20
# With fewer alarms expected at a level nothing is said of it.
LEAST_EXPECTED_ALARMS = 10.0


@dataclass(frozen=True)
class FalseAlarmRatio:
    """P_FA predicted over measured at the threshold that was measured to give one level.

    Attributes
    ----------
    value, lower, upper : the ratio and its interval, which is that of the measured P_FA [1]
    at : which point of the measured curve it is
    predicted : P_FA of the model at that threshold
    """

    value: float
    lower: float
    upper: float
    at: int
    predicted: float


def exceedance_curve(score_map: npt.ArrayLike, counted: npt.ArrayLike, side: int | None = None) -> ExceedanceCurve:
    """P(score > threshold) of the pixels that count, at ten thresholds for each decade of it, down to 5 alarms.

    The interval is that of a ratio of block totals, sum k_i / sum n_i, with variance
    m/(m - 1) sum (k_i - p n_i)^2 / n^2 over m square blocks, symmetric in log P with Student's t; only blocks with
    an alarm count as its degrees of freedom.
    Source: Cochran, Sampling Techniques, 1977, section 6.4 (ratio estimate of clusters of unequal size).

    Parameters
    ----------
    score_map : (lines, samples), NaN where invalid
    counted : (lines, samples) True on background
    side : of the blocks [pixels]; None: about 64 of them

    Raises
    ------
    UsageError : fewer than 20 pixels count.
    """
    scores, mask = np.asarray(score_map, dtype=float), np.asarray(counted, dtype=bool)
    mask = mask & np.isfinite(scores)
    n = int(np.count_nonzero(mask))
    if n < FEWEST_FOR_A_CURVE:
        raise UsageError(
            f"{n} background pixels are too few for a curve of false alarms",
            expected=f"{FEWEST_FOR_A_CURVE} or more",
        )
    lines, samples = np.nonzero(mask)
    b = side or block_side(n)
    _, block = np.unique(lines // b * (mask.shape[1] // b + 1) + samples // b, return_inverse=True)
    held = np.bincount(block)
    values = scores[mask]
    decades = np.log10(n / _LEAST_ALARMS)
    level = 10.0 ** -(np.arange(int(decades * _PER_DECADE), -1, -1) / _PER_DECADE)
    level = level[level <= 0.5]
    ordered = np.sort(values)
    # The lowest threshold that lets at most n P of the scores through; equal scores pass together or not at all.
    threshold = np.unique(ordered[n - 1 - np.floor(n * level + 1e-9).astype(int)])
    counts = np.stack([np.bincount(block[values > t], minlength=held.size) for t in threshold])
    probability = counts.sum(axis=1) / n
    m = held.size
    scatter = np.sum((counts - probability[:, None] * held) ** 2, axis=1) * m / max(m - 1, 1)
    struck = np.count_nonzero(counts, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.sqrt(scatter) / (n * probability)
        factor = np.exp(stats.t.ppf(0.975, np.maximum(struck - 1, 1)) * relative)
        lower, upper = probability / factor, np.minimum(probability * factor, 1.0)
    known = (struck >= 2) & (m >= 2)
    return ExceedanceCurve(
        threshold, probability, np.where(known, lower, np.nan), np.where(known, upper, np.nan), n
    )


def block_side(pixels: int) -> int:
    """Side of square blocks of which ``pixels`` fill about 64 [pixels]."""
    return max(_SMALLEST_SIDE, round(float(np.sqrt(pixels / BLOCKS))))


def exceedance_at(curve: ExceedanceCurve, threshold: float) -> float:
    """P(score > threshold), linear in log P between the points of a curve; that of its ends beyond them."""
    keep = curve.probability > 0
    x, p = curve.threshold[keep], curve.probability[keep]
    return float(np.exp(np.interp(threshold, x, np.log(p))))


def false_alarm_ratio(predicted: ExceedanceCurve, measured: ExceedanceCurve, level: float) -> FalseAlarmRatio:
    """The ratio at the point of the measured curve whose P_FA is nearest to ``level`` in its logarithm."""
    at = int(np.argmin(np.abs(np.log(measured.probability.clip(1e-300)) - math.log(level))))
    p = exceedance_at(predicted, float(measured.threshold[at]))
    low, high = p / float(measured.upper[at]), p / float(measured.lower[at])
    return FalseAlarmRatio(p / float(measured.probability[at]), low, high, at, p)
