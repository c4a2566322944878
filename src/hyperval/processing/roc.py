"""Empirical ROC curves: exact with ties, by pixel or by object, with honest intervals.

A pixel is declared a target when its score lies strictly above the threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.alarm_blocks import AlarmBlocks, same_scores
from hyperval.processing.alarms import alarms_at_detection
from hyperval.processing.intervals import mid_p_limits
from hyperval.processing.order_statistics import OrderStatistics
from hyperval.processing.rank_counts import counts_of
from hyperval.processing.roc_areas import area_estimates, areas_within, pooled_areas
from hyperval.products import RocCurve

Array = npt.NDArray[np.float64]
Nan = Literal["raise", "omit"]
POINTS_PER_DECADE = 20


@dataclass(frozen=True, eq=False)
class PresetThresholds:
    """Thresholds at preset false-alarm probabilities: what a curve takes from its background alone.  All (K,).

    Attributes
    ----------
    pfa : the probabilities
    threshold, alarms : lowest threshold whose empirical false-alarm rate is at most that, and the scores above it
    everything : True where no score is the threshold, and all is declared
    greatest : order statistic that bounds the true threshold from above; inf where none does
    least, unbounded : order statistic that bounds it from below, and True where none does
    n_background, level : scores of the background; confidence of the bounds
    """

    pfa: Array
    threshold: Array
    alarms: npt.NDArray[np.int64]
    everything: npt.NDArray[np.bool_]
    greatest: Array
    least: Array
    unbounded: npt.NDArray[np.bool_]
    n_background: int
    level: float


@dataclass(frozen=True)
class DetectionRate:
    """Detection probability at preset false-alarm probabilities.

    All arrays are (K,).  ``lower``/``upper`` hold the threshold's sampling error too; ``binomial_lower``/
    ``binomial_upper`` are mid-P limits for the threshold as it was drawn.
    """

    pfa: Array
    pd: Array
    lower: Array
    upper: Array
    binomial_lower: Array
    binomial_upper: Array
    threshold: Array
    alarms: npt.NDArray[np.int64]
    n_target: int
    n_background: int
    level: float


def preset_thresholds(
    background_scores: npt.ArrayLike,
    pfa: npt.ArrayLike | None = None,
    *,
    level: float = 0.95,
    nan: Nan = "raise",
    blocks: AlarmBlocks | None = None,
) -> PresetThresholds:
    """Thresholds of :func:`pd_at_pfa`; one set serves all targets that are looked for in the same scores.

    ``pfa`` defaults to a logarithmic grid from one alarm in the whole background to 1, which holds the decades.
    """
    b = _valid_scores(background_scores, "background", nan)
    if pfa is None:
        decades = int(np.ceil(np.log10(max(b.size, 10))))
        grid = 10.0 ** (np.arange(-decades * POINTS_PER_DECADE, 1) / POINTS_PER_DECADE)
        pfa = grid[grid * b.size * (1.0 + 1e-12) >= 1.0]
    p = np.atleast_1d(np.asarray(pfa, dtype=float))
    if not (np.all(p > 0) and np.all(p <= 1)):
        raise UsageError("a preset false-alarm probability must lie in (0, 1]")
    k = np.minimum(np.floor(p * b.size * (1.0 + 1e-12)).astype(np.int64), b.size)
    if blocks is None:
        from scipy import stats  # 25 MB with what it loads, which runs without detection do not need

        tail = (1.0 - level) / 2.0
        # The greatest r with P(fewer than r scores above the true threshold) <= tail: the r-th greatest bounds it
        # from above, and nothing does where r = 0.
        r = stats.binom.ppf(tail, b.size, p).astype(np.int64)
        # The least s with P(s scores or more above it) <= tail: the s-th greatest bounds it from below.
        s = stats.binom.isf(tail, b.size, p).astype(np.int64) + 1
    else:
        same_scores(blocks, b)
        r, s = blocks.rank_limits(p)
    ordered = OrderStatistics(b, np.concatenate([k + 1, r, s]))
    threshold, everything = ordered.greatest(k + 1), k >= b.size
    return PresetThresholds(
        p,
        threshold,
        np.where(everything, b.size, ordered.above(threshold)),
        everything,
        np.where(r >= 1, ordered.greatest(np.maximum(r, 1)), np.inf),
        ordered.greatest(s),
        s > b.size,
        int(b.size),
        level,
    )


def pd_at_pfa(
    target_scores: npt.ArrayLike,
    background_scores: npt.ArrayLike | PresetThresholds,
    pfa: npt.ArrayLike | None = None,
    *,
    level: float = 0.95,
    nan: Nan = "raise",
    blocks: AlarmBlocks | None = None,
) -> DetectionRate:
    """Detection probability at the lowest threshold whose empirical false-alarm rate is at most ``pfa``.

    The threshold is the (k+1)-th greatest of the n background scores with k = floor(n pfa), so that at most k
    background pixels lie above it, with ties or without.

    The interval joins two independent uncertainties.  (1) The share of targets above the threshold is binomial:
    mid-P limits (:func:`~hyperval.processing.intervals.mid_p_limits`), since a level that is to hold for every P_D
    is void beside the second part anyhow.  (2) The threshold x that truly gives ``pfa`` is known only through the
    background sample: the number of background scores above x is binomial, so x lies between two order
    statistics of the background, at which P_D is read again; where n pfa is too small, no score bounds x from above
    and the lower limit of P_D is 0.  Where the places of the background are known (``blocks``), alarms that come in
    clusters widen that range (:meth:`~hyperval.processing.alarm_blocks.AlarmBlocks.rank_limits`).  The distances of
    both from P_D are added in quadrature on each side (as in Newcombe, Stat. Med. 17, 873-890, 1998).  Simulated
    coverage at 95 % is 0.95 to 0.99, tables in docs/statistics.md, and 0.92 where 300 targets stand on 44 alarms
    that come in clusters; with the first part alone it falls below 0.4 for a small background and many targets.
    Targets must be independent of each other, so count objects, not the pixels of one object.

    Parameters
    ----------
    target_scores, background_scores : any shape; +-inf allowed; NaN raises, or is left out with ``nan="omit"``.
        The thresholds that :func:`preset_thresholds` took from a background may stand for it and all that follows
    pfa : preset false-alarm probabilities in (0, 1]
    blocks : the background scores with their places

    Raises
    ------
    UsageError : no targets, no background, NaN, or a ``pfa`` outside (0, 1].
    """
    t = _sorted_scores(target_scores, "target", nan)
    at = (
        background_scores
        if isinstance(background_scores, PresetThresholds)
        else preset_thresholds(background_scores, pfa, level=level, nan=nan, blocks=blocks)
    )
    detected = _above(t, at.threshold, at.everything)
    low, high = mid_p_limits(detected, t.size, at.level)
    few = t.size - np.searchsorted(t, at.greatest, side="right")
    many = _above(t, at.least, at.unbounded)
    pd = detected / t.size
    # Never inside the binomial limits: what could lie inside them is rounding.
    wide_low = np.clip(pd - np.hypot(pd - low, pd - few / t.size), 0.0, low)
    wide_high = np.clip(pd + np.hypot(high - pd, many / t.size - pd), high, 1.0)
    # A false-alarm probability of one declares everything, whatever the sample.
    certain = at.pfa >= 1.0
    return DetectionRate(
        pfa=at.pfa,
        pd=pd,
        lower=np.where(certain, 1.0, wide_low),
        upper=wide_high,
        binomial_lower=low,
        binomial_upper=high,
        threshold=at.threshold,
        alarms=at.alarms,
        n_target=int(t.size),
        n_background=at.n_background,
        level=at.level,
    )


def empirical_roc(
    target_scores: npt.ArrayLike,
    background_scores: npt.ArrayLike | PresetThresholds,
    pfa: npt.ArrayLike | None = None,
    unit: Literal["pixel", "object"] = "pixel",
    *,
    background_area_km2: float | None = None,
    level: float = 0.95,
    nan: Nan = "raise",
    blocks: AlarmBlocks | None = None,
) -> RocCurve:
    """Empirical ROC curve at preset false-alarm probabilities, with the interval of :func:`pd_at_pfa`.

    The true P_D rises with P_FA, so limits that do not are widened until they do.  ``pfa`` defaults to the grid of
    :func:`preset_thresholds`.
    """
    rising = None if pfa is None else np.sort(np.asarray(pfa, dtype=float))
    rates = pd_at_pfa(target_scores, background_scores, rising, level=level, nan=nan, blocks=blocks)
    lower, upper = _rising(rates.lower, rates.upper)
    return RocCurve(
        pfa=rates.pfa,
        pd=rates.pd,
        pd_lower=lower,
        pd_upper=upper,
        threshold=rates.threshold,
        unit=unit,
        n_target=rates.n_target,
        n_background=rates.n_background,
        background_area_km2=background_area_km2,
        alarms=rates.alarms,
    )


def with_summary(
    curve: RocCurve,
    target_scores: npt.ArrayLike,
    background_scores: npt.ArrayLike,
    *,
    draws: int = 1000,
    rng: np.random.Generator | None = None,
    blocks: AlarmBlocks | None = None,
) -> RocCurve:
    """The curve of these scores with its areas (:mod:`hyperval.processing.roc_areas`) and alarms at stated P_D.

    Parameters
    ----------
    draws, rng : of the bootstrap over objects; by default a generator of seed 0
    blocks : the background scores with their places
    """
    counts = counts_of(target_scores, background_scores)
    areas = areas_within(int(curve.n_background or 0))
    estimates = area_estimates(counts, areas, curve.unit, draws, rng or np.random.default_rng(0), blocks)
    return replace(curve, areas=estimates, at_detection=alarms_at_detection(counts))


def pooled_roc(curves: Sequence[RocCurve], *, level: float = 0.95) -> RocCurve:
    """One curve for several groups of targets, each with its own detector, at the same false-alarm probability.

    P_D is the share of all targets detected; its interval is the mid-P one of the pooled count and, in
    quadrature, what the sampling of the thresholds brings to each curve, added by the shares of the targets: the
    detectors share their background, and its errors may go together.

    Raises
    ------
    UsageError : no curve, curves that count different things, or that have no false-alarm probability in common.
    """
    if not curves:
        raise UsageError("no curve to pool")
    if len({c.unit for c in curves}) > 1 or any(not c.n_target for c in curves):
        raise UsageError("only measured curves that count the same thing can be pooled")
    grid = curves[0].pfa
    for curve in curves[1:]:
        grid = grid[np.any(np.abs(grid[:, None] / curve.pfa[None, :] - 1.0) < 1e-9, axis=1)]
    if grid.size == 0:
        raise UsageError("the curves have no false-alarm probability in common")
    at = [[int(np.argmin(np.abs(c.pfa / x - 1.0))) for x in grid] for c in curves]
    detected = sum(np.rint(c.pd[i] * int(c.n_target or 0)) for c, i in zip(curves, at, strict=True))
    total = sum(int(c.n_target or 0) for c in curves)
    low, high = mid_p_limits(np.asarray(detected, dtype=np.int64), total, level)
    pd = np.asarray(detected) / total
    below, above = np.zeros(grid.size), np.zeros(grid.size)
    for curve, i in zip(curves, at, strict=True):
        share = int(curve.n_target or 0) / total
        each = mid_p_limits(np.rint(curve.pd[i] * int(curve.n_target or 0)), int(curve.n_target or 0), level)
        below += share * _beyond(curve.pd[i] - curve.pd_lower[i], curve.pd[i] - each[0])
        above += share * _beyond(curve.pd_upper[i] - curve.pd[i], each[1] - curve.pd[i])
    backgrounds = [c.n_background for c in curves if c.n_background is not None]
    lower, upper = _rising(
        np.clip(pd - np.hypot(pd - low, below), 0.0, low), np.clip(pd + np.hypot(high - pd, above), high, 1.0)
    )
    return RocCurve(
        pfa=grid,
        pd=pd,
        pd_lower=lower,
        pd_upper=upper,
        threshold=np.full(grid.shape, np.nan),  # every curve has its own
        unit=curves[0].unit,
        n_target=total,
        n_background=min(backgrounds) if backgrounds else None,
        background_area_km2=curves[0].background_area_km2,
        areas=pooled_areas([c.areas for c in curves], min(backgrounds) if backgrounds else 0),
    )


def _rising(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Limits of a curve, widened until they rise with P_FA as the true P_D does."""
    return np.minimum.accumulate(lower[::-1])[::-1], np.maximum.accumulate(upper)


def _beyond(whole: Array, part: Array) -> Array:
    """What was added in quadrature to ``part`` to give ``whole``."""
    return np.sqrt(np.maximum(whole**2 - part**2, 0.0))


def average_roc(curves: Sequence[RocCurve], weights: npt.ArrayLike) -> RocCurve:
    """The predicted curve of several groups of targets at the same false-alarm probability.

    P_D is the average of the groups by ``weights`` (how many targets each has); the bands are averaged as if
    the errors of all groups went together, which is the widest they can be.

    Raises
    ------
    UsageError : no curve, or curves on different false-alarm probabilities.
    """
    share = np.asarray(weights, dtype=float)
    if not curves or share.shape != (len(curves),) or not share.sum() > 0:
        raise UsageError("no curve to average, or weights that do not fit")
    first = curves[0]
    if any(c.pfa.shape != first.pfa.shape or not np.allclose(c.pfa, first.pfa, rtol=1e-9) for c in curves):
        raise UsageError("predicted curves on different false-alarm probabilities cannot be averaged")
    share = share / share.sum()
    pd, low, high = (share @ np.stack([getattr(c, k) for c in curves]) for k in ("pd", "pd_lower", "pd_upper"))
    return RocCurve(first.pfa, pd, low, high, np.full(first.pfa.shape, np.nan), first.unit)


def _sorted_scores(scores: npt.ArrayLike, name: str, nan: Nan) -> Array:
    return np.sort(_valid_scores(scores, name, nan))


def _valid_scores(scores: npt.ArrayLike, name: str, nan: Nan) -> Array:
    values = np.asarray(scores, dtype=float).ravel()
    missing = np.isnan(values)
    if np.any(missing):
        if nan != "omit":
            raise UsageError(
                f"{int(missing.sum())} of {values.size} {name} scores are NaN",
                mend='leave invalid pixels out, or pass nan="omit" to have them left out here',
            )
        values = values[~missing]
    if values.size == 0:
        raise UsageError(f"there are no {name} scores", expected="at least one valid score on each side of a ROC")
    return values


def _above(ascending: Array, threshold: Array, everything: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """How many scores lie above the threshold; all of them where ``everything`` is declared, -inf included."""
    count = ascending.size - np.searchsorted(ascending, threshold, side="right")
    return np.where(everything, ascending.size, count).astype(np.int64)
