"""Where many background scores lie among few target scores, without sorting the many: curve, area, bootstrap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.order_statistics import bins_of

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

_BINS = 4096


@dataclass(frozen=True)
class RankCounts:
    """Background scores between and on the K different target scores.

    Attributes
    ----------
    value : (K,) target scores, increasing
    targets : (K,) targets with each of them
    ties : (K,) background scores equal to each
    between : (K + 1,) background scores below the first, between two, and above the last
    """

    value: Array
    targets: Counts
    ties: Counts
    between: Counts

    @property
    def below(self) -> Array:
        """(K,) share of the background below each target score, ties counted half."""
        under = np.cumsum(self.between[:-1]) + np.concatenate([[0], np.cumsum(self.ties)[:-1]])
        return np.asarray((under + 0.5 * self.ties) / (self.between.sum() + self.ties.sum()))


def rank_counts(target: Array, background: Array) -> RankCounts:
    """Counts of ``background`` (n,) among ``target`` (m,), both without NaN.

    Each score is first put into one of some thousand bins between the least and the greatest target by a
    function that never falls; only those that share a bin with a target are compared with it.
    """
    value, targets = np.unique(target, return_counts=True)
    finite = value[np.isfinite(value)]
    if finite.size == 0 or finite[-1] / 2 - finite[0] / 2 > 1e307:
        which = np.zeros(background.size, np.intp)
        bins, near = np.zeros(value.size, np.intp), np.ones(background.size, bool)
    else:
        low, width = finite[0], finite[-1] - finite[0]
        width = width if width > 1e-290 else 1.0  # any width is right, this one does not overflow
        which, bins = (bins_of(x, low, width, _BINS) for x in (background, value))
        held = np.zeros(_BINS + 2, bool)
        held[bins] = True
        near = held.take(which)
    close = background[near]
    left = np.searchsorted(value, close, side="left")
    tied = value[np.minimum(left, value.size - 1)] == close
    ties = np.bincount(left[tied], minlength=value.size)[: value.size]
    between = np.bincount(left[~tied], minlength=value.size + 1)
    # The others lie in bins without a target: all of a bin between the same two.
    count = np.bincount(which[~near], minlength=_BINS + 2)
    filled = np.flatnonzero(count)
    np.add.at(between, np.searchsorted(bins, filled, side="left"), count[filled])
    return RankCounts(value, targets.astype(np.int64), ties.astype(np.int64), between.astype(np.int64))


def roc_corners(target_scores: npt.ArrayLike, background_scores: npt.ArrayLike) -> tuple[Array, Array]:
    """Exact empirical ROC by its corners: ``pfa`` and ``pd``, both from 0 to 1.

    The curve of :func:`hyperval.processing.roc.roc_points` without the points that lie on straight parts of it.

    Raises
    ------
    UsageError : no scores on a side, or NaN.
    """
    counts = counts_of(target_scores, background_scores)
    # From the greatest target score down: background above it (level), then the target with its ties (a slope).
    steps_b = np.stack([counts.between[1:][::-1], counts.ties[::-1]], axis=1).ravel()
    steps_t = np.stack([np.zeros_like(counts.targets), counts.targets[::-1]], axis=1).ravel()
    b = np.concatenate([[0], np.cumsum(np.append(steps_b, counts.between[0]))])
    t = np.concatenate([[0], np.cumsum(np.append(steps_t, 0))])
    moved = np.concatenate([[True], (np.diff(b) > 0) | (np.diff(t) > 0)])
    b, t = b[moved], t[moved]
    turn = np.ones(b.size, bool)
    turn[1:-1] = np.diff(b)[:-1] * np.diff(t)[1:] != np.diff(b)[1:] * np.diff(t)[:-1]
    return b[turn] / b[-1], t[turn] / t[-1]


def counts_of(target_scores: npt.ArrayLike, background_scores: npt.ArrayLike) -> RankCounts:
    """:func:`rank_counts` of scores of any shape; UsageError where a side is empty or holds NaN."""
    sides = []
    for name, scores in (("target", target_scores), ("background", background_scores)):
        values = np.asarray(scores, dtype=float).ravel()
        if values.size == 0 or np.isnan(values).any():
            raise UsageError(f"{name} scores are missing or hold NaN", mend="leave invalid pixels out")
        sides.append(values)
    return rank_counts(*sides)


def bootstrap_pd(
    target_scores: npt.ArrayLike,
    background_scores: npt.ArrayLike,
    pfa: npt.ArrayLike,
    draws: int,
    rng: np.random.Generator,
) -> Array:
    """(draws, K) detection probability at preset false-alarm probabilities (K,) in resampled data.

    Targets are drawn anew.  Of the background only order statistics are needed: the j-th greatest of n draws with
    replacement from n ordered values is the value of rank ceil(n U_j), U_j the j-th least of n uniform numbers,
    and those are drawn directly: cumulated gamma variables over their sum (Renyi 1953).  For the spread of whole
    curves; intervals at one P_FA are those of :func:`hyperval.processing.roc.pd_at_pfa`, since percentiles of a
    bootstrap cover too little with few targets.
    """
    t = np.asarray(target_scores, dtype=float).ravel()
    b = np.asarray(background_scores, dtype=float).ravel()
    p = np.asarray(pfa, dtype=float)
    if t.size == 0 or b.size == 0 or np.isnan(t).any() or np.isnan(b).any():
        raise UsageError("a bootstrap needs scores without NaN on both sides")
    if p.ndim != 1 or np.any(np.diff(p) <= 0) or np.any(p <= 0) or np.any(p > 1):
        raise UsageError("preset false-alarm probabilities must rise within (0, 1]")
    n = b.size
    k = np.minimum(np.floor(p * n * (1.0 + 1e-12)).astype(np.int64), n)  # alarms allowed
    inner = k < n
    order = k[inner] + 1  # the threshold is the (k + 1)-th greatest
    steps = np.diff(order, prepend=0)
    parts = np.cumsum(rng.gamma(np.maximum(steps, 1e-300), size=(draws, order.size)), axis=1)
    uniform = parts / (parts[:, -1:] + rng.gamma(n + 1 - order[-1], size=(draws, 1))) if order.size else parts
    rank = np.minimum((uniform * n).astype(np.int64), n - 1)
    needed = int(rank.max(initial=0)) + 1
    greatest = -np.sort(-(b if needed > n // 2 else np.partition(b, n - needed)[n - needed :]))
    threshold = np.full((draws, p.size), -np.inf)
    threshold[:, inner] = greatest[rank]
    drawn = np.sort(rng.choice(np.sort(t), size=(draws, t.size)), axis=1)
    out = np.ones((draws, p.size))
    for i in range(draws):
        out[i, inner] = 1.0 - np.searchsorted(drawn[i], threshold[i, inner], side="right") / t.size
    return out
