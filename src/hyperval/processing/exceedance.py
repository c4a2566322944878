"""How often background scores lie above a threshold, with an interval that knows that alarms come in clusters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.alarm_blocks import AlarmBlocks
from hyperval.products import ExceedanceCurve

Array = npt.NDArray[np.float64]

_PER_DECADE = 10
_LEAST_ALARMS = 5
FEWEST_FOR_A_CURVE = 20
# With fewer alarms expected at a level nothing is said of it.
LEAST_EXPECTED_ALARMS = 10.0
ANOMALY_LEVELS = (1e-4, 1e-3, 1e-2)  # rates of the background at which a threshold of anomalies is stated


@dataclass(frozen=True)
class FalseAlarmRatio:
    """P_FA predicted over measured at the threshold that was measured to give one level.

    Attributes
    ----------
    value, lower, upper : the ratio and its 95 % interval [1]
    at : which point of the measured curve it is
    predicted : P_FA of the model at that threshold
    law_factor : factor by which the pixels that the model's law was fitted to leave that open at 95 %; 1 where the
        law is stated
    """

    value: float
    lower: float
    upper: float
    at: int
    predicted: float
    law_factor: float


def exceedance_curve(background: AlarmBlocks) -> ExceedanceCurve:
    """P(score > threshold) of background pixels, at ten thresholds for each decade of it, down to 5 alarms.

    The interval is :meth:`~hyperval.processing.alarm_blocks.AlarmBlocks.pfa_limits`; there is none where all alarms
    lie in one block.

    Examples
    --------
    >>> scores = np.random.default_rng(1).normal(size=(100, 100))
    >>> curve = exceedance_curve(AlarmBlocks.of_map(scores, np.ones((100, 100), dtype=bool)))
    >>> bool(curve.half_image[np.argmin(np.abs(curve.probability - 1e-2))] < 1.5)
    True

    Raises
    ------
    UsageError : fewer than 20 pixels count.
    """
    n = background.scores.size
    if n < FEWEST_FOR_A_CURVE:
        raise UsageError(
            f"{n} background pixels are too few for a curve of false alarms",
            expected=f"{FEWEST_FOR_A_CURVE} or more",
        )
    decades = np.log10(n / _LEAST_ALARMS)
    level = 10.0 ** -(np.arange(int(decades * _PER_DECADE), -1, -1) / _PER_DECADE)
    level = level[level <= 0.5]
    ordered = background.ascending
    # The lowest threshold that lets at most n P of the scores through; equal scores pass together or not at all.
    threshold = np.unique(ordered[n - 1 - np.floor(n * level + 1e-9).astype(int)])
    alarms, lower, upper = (x[::-1] for x in background.pfa_limits(threshold[::-1]))
    struck = np.count_nonzero(background.counts(threshold[::-1]), axis=1)[::-1]
    known = struck >= 2
    return ExceedanceCurve(
        threshold, alarms / n, np.where(known, lower, np.nan), np.where(known, upper, np.nan), n,
        background.half_image_factor(threshold[::-1])[::-1],
    )  # fmt: skip


def exceedance_at(curve: ExceedanceCurve, threshold: float) -> float:
    """P(score > threshold), linear in log P between the points of a curve; that of its ends beyond them."""
    return _read(curve, curve.probability, threshold)


def _read(curve: ExceedanceCurve, values: Array, threshold: float) -> float:
    keep = curve.probability > 0
    return float(np.exp(np.interp(threshold, curve.threshold[keep], np.log(values[keep]))))


def false_alarm_ratio(predicted: ExceedanceCurve, measured: ExceedanceCurve, level: float) -> FalseAlarmRatio:
    """The ratio at the point of the measured curve whose P_FA is nearest to ``level`` in its logarithm.

    The limits of both sides go together in quadrature, in the logarithm (Zou & Donner, Stat. Med. 27, 1693-1702,
    2008), as of sides that do not know of each other.

    Examples
    --------
    >>> x = np.linspace(0.0, 8.0, 81)
    >>> predicted = ExceedanceCurve(x, np.exp(-x), np.exp(-x) / 1.3, np.exp(-x) * 1.3)
    >>> measured = ExceedanceCurve(x, np.exp(-1.1 * x), np.exp(-1.1 * x) / 1.4, np.exp(-1.1 * x) * 1.4, 100_000)
    >>> ratio = false_alarm_ratio(predicted, measured, 1e-2)
    >>> [round(v, 2) for v in (ratio.value, ratio.upper / ratio.value, ratio.law_factor)]
    [1.52, 1.53, 1.3]
    """
    at = int(np.argmin(np.abs(np.log(measured.probability.clip(1e-300)) - math.log(level))))
    threshold, m = float(measured.threshold[at]), float(measured.probability[at])
    p = exceedance_at(predicted, threshold)
    law = [abs(math.log(_read(predicted, side, threshold) / p)) for side in (predicted.lower, predicted.upper)]
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.abs(np.log(np.array([measured.upper[at], measured.lower[at]]) / m))
    down, up = np.hypot(law, rate)
    ratio = p / m
    return FalseAlarmRatio(
        ratio, float(ratio * np.exp(-down)), float(ratio * np.exp(up)), at, p, math.exp(max(law))
    )
