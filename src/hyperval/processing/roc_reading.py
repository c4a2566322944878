"""P_D of a ROC curve at a P_FA, and P_FA at a P_D: the one reading of curves, predicted and measured (3.33)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.products import RocCurve

Array = npt.NDArray[np.float64]
_SAME = 1e-9  # relative: a point of the curve itself


def detection_at(curve: RocCurve, pfa: npt.ArrayLike, values: Array | None = None) -> Array:
    """P_D at false-alarm probabilities ``pfa`` (...,); NaN outside the curve (3.33) [1].

    At a point of the curve its value; between two points linear in the probit of P_D against that of P_FA, as
    curves of normal scores are.  Where one of them is 0 or 1, which has no probit, P_D is linear in log P_FA.

    Parameters
    ----------
    curve : with ``pfa`` in rising order
    values : (K,) what is read in place of P_D, such as a limit of it [1]

    Examples
    --------
    >>> curve = RocCurve(ndtr([-3.0, -1.0]), ndtr([-1.0, 1.0]), np.zeros(2), np.ones(2), np.zeros(2))
    >>> round(float(detection_at(curve, float(ndtr(-2.0)))), 9)
    0.5
    """
    grid, known = (
        np.asarray(curve.pfa, dtype=float),
        np.asarray(curve.pd if values is None else values, dtype=float),
    )
    at = np.asarray(pfa, dtype=float)
    if not grid.size:
        return np.full(at.shape, np.nan)
    upper = np.clip(np.searchsorted(grid, at, side="left"), 1, max(grid.size - 1, 1))
    upper = np.minimum(upper, grid.size - 1)
    lower = np.maximum(upper - 1, 0)
    inside = (at >= grid[0] * (1.0 - _SAME)) & (at <= grid[-1] * (1.0 + _SAME))
    pd, between = np.full(at.shape, np.nan), inside
    for index in (lower, upper):  # of equal points the last, which declares the most
        same = np.abs(grid[index] - at) <= _SAME * at
        pd, between = np.where(same & inside, known[index], pd), between & ~same
    if between.any():
        pd = np.where(between, _between(at, (grid[lower], grid[upper]), (known[lower], known[upper])), pd)
    return np.asarray(pd)


def _between(at: Array, pfa: tuple[Array, Array], known: tuple[Array, Array]) -> Array:
    """P_D between two points of a curve."""
    low, high = known
    with np.errstate(divide="ignore", invalid="ignore"):
        straight = low + _share(np.log, at, *pfa) * (high - low)
        share = _share(ndtri, at, *pfa)
        bent = ndtr((1.0 - share) * ndtri(low) + share * ndtri(high))
    ends = np.stack([*known, *pfa])
    return np.where(np.all((ends > 0.0) & (ends < 1.0), axis=0), bent, straight)


def _share(scale: Callable[[Array], Array], at: Array, low: Array, high: Array) -> Array:
    """Where ``at`` lies between two points on a scale, 0 to 1."""
    return np.clip((scale(at) - scale(low)) / (scale(high) - scale(low)), 0.0, 1.0)


def log10_false_alarm_at(curve: RocCurve, pd: float) -> float:
    """log10 P_FA at which a curve reaches the detection probability ``pd``, by the same reading; NaN outside it."""
    known = np.clip(curve.pd, 1e-300, 1.0 - 1e-16)
    return float(np.log10(ndtr(np.interp(ndtri(pd), ndtri(known), ndtri(curve.pfa), np.nan, np.nan))))
