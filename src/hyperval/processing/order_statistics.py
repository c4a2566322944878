"""A few order statistics of many scores without sorting them all."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

_BINS = 16384
_SAMPLE = 2048
# Up to so many scores sorting is as fast.
_FEW = 20_000


def bins_of(x: Array, low: float, width: float, bins: int) -> npt.NDArray[np.intp]:
    """Bin 1 to ``bins`` + 1 of each score from ``low`` to ``low + width``, 0 below, ``bins`` + 1 above.

    A function that never falls, so that equal scores share a bin and bins keep the order of the scores.
    """
    with np.errstate(over="ignore"):  # what overflows lies in the last or first bin
        scaled = np.subtract(x, low)
        scaled *= bins / width
    np.maximum(scaled, -1.0, out=scaled)
    np.minimum(scaled, float(bins), out=scaled)
    scaled += 1.0
    return scaled.astype(np.int32).astype(np.intp)


class OrderStatistics:
    """Order statistics of scores (n,) without NaN, at ranks that are named beforehand.

    Scores are put into bins between the ends of a sample; only bins that hold a wanted rank are sorted.
    """

    def __init__(self, scores: Array, ranks: npt.ArrayLike):
        """``ranks``: from the greatest score, 1, to the least, n; others are taken for the nearer end."""
        self.n = int(scores.size)
        self._low, self._width, bins = 0.0, 1.0, 1
        if self.n > _FEW:
            sample = scores[:: self.n // _SAMPLE]
            sample = sample[np.abs(sample) < 1e300]
            low, high = np.percentile(sample, [0.5, 99.9]) if sample.size else (0.0, 0.0)
            if high - low > 1e-290:
                self._low, self._width, bins = float(low), float(high - low), _BINS
        self._bins = bins
        wanted = np.unique(np.clip(np.asarray(ranks, dtype=np.int64), 1, self.n))
        if bins == 1:
            self._sorted = np.sort(scores)
            self._before = self._before_kept = np.zeros(bins + 3, np.int64)
            return
        which = bins_of(scores, self._low, self._width, bins)
        count = np.bincount(which, minlength=bins + 2)
        self._before = np.concatenate([[0], np.cumsum(count)])
        keep = np.zeros(bins + 2, bool)
        keep[self._bin_of_position(self.n - wanted)] = True
        self._before_kept = np.concatenate([[0], np.cumsum(np.where(keep, count, 0))])
        self._sorted = np.sort(scores[keep.take(which)])

    def _bin_of_position(self, position: Counts) -> npt.NDArray[np.intp]:
        """Bin of the score at a 0-based place in increasing order."""
        return np.asarray(np.searchsorted(self._before, position, side="right") - 1)

    def greatest(self, rank: npt.ArrayLike) -> Array:
        """The ``rank``-th greatest score (from 1), one of the ranks named; -inf beyond the last."""
        r = np.asarray(rank, dtype=np.int64)
        position = np.clip(self.n - r, 0, self.n - 1)
        if self._bins > 1:
            at = self._bin_of_position(position)
            position = position - self._before[at] + self._before_kept[at]
        return np.where(r <= self.n, self._sorted[position], -np.inf)

    def above(self, threshold: npt.ArrayLike) -> Counts:
        """How many scores lie above a threshold that is one of the order statistics named."""
        x = np.asarray(threshold, dtype=float)
        inside = np.searchsorted(self._sorted, x, side="right")
        if self._bins > 1:
            at = bins_of(x, self._low, self._width, self._bins)
            inside = inside - self._before_kept[at] + self._before[at]
        return np.asarray(self.n - inside, dtype=np.int64)
