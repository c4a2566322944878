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
        occupied = np.zeros(_BINS + 2, bool)
        occupied[bins] = True
        near = occupied.take(which)
    close = background[near]
    left = np.searchsorted(value, close, side="left")
    tied = value[np.minimum(left, value.size - 1)] == close
    ties = np.bincount(left[tied], minlength=value.size)[: value.size]
    between = np.bincount(left[~tied], minlength=value.size + 1)
    # The others lie in bins without a target: all of a bin between the same two.
    count = np.bincount(which[~near], minlength=_BINS + 2)
    cells = np.flatnonzero(count)
    np.add.at(between, np.searchsorted(bins, cells, side="left"), count[cells])
    return RankCounts(value, targets.astype(np.int64), ties.astype(np.int64), between.astype(np.int64))


def counts_of(target_scores: npt.ArrayLike, background_scores: npt.ArrayLike) -> RankCounts:
    """:func:`rank_counts` of scores of any shape; UsageError where a side is empty or holds NaN."""
    sides = []
    for name, scores in (("target", target_scores), ("background", background_scores)):
        values = np.asarray(scores, dtype=float).ravel()
        if values.size == 0 or np.isnan(values).any():
            raise UsageError(f"{name} scores are missing or hold NaN", mend="leave invalid pixels out")
        sides.append(values)
    return rank_counts(*sides)
