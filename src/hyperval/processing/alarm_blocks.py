"""Background scores with their places, and what that says of a false-alarm probability: alarms come in clusters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.intervals import beyond_jeffreys_limits, jeffreys_limits

if TYPE_CHECKING:
    from scipy import sparse

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]

# A roof or a shadow is one piece of luck, not as many as it has pixels. Blocks are the pieces: so many of them that
# their scatter is known, and so large that neighbours hardly share one.
BLOCKS = 64
SMALLEST_SIDE = 4
_RANKS = 160  # thresholds at which design effects are looked up
_DECADE = 10.0
_HALVES, _SEED = 400, 23  # ways in which the blocks are parted into two halves
_GREATEST = 0.75  # weight of the greatest design effect of a decade beside their mean


def block_side(pixels: int) -> int:
    """Side of square blocks of which ``pixels`` fill about 64 [pixels]."""
    return max(SMALLEST_SIDE, round(float(np.sqrt(pixels / BLOCKS))))


@dataclass(frozen=True, eq=False)
class AlarmBlocks:
    """Background scores (n,) by the block of the image that they lie in.

    Attributes
    ----------
    scores : (n,) finite
    block : (n,) number of the block of each
    neighbours : (M, M) weights 1 of a block with itself, 1/2 with one beside it, 1/4 across a corner
    """

    scores: Array
    block: Counts
    neighbours: sparse.csr_array

    @classmethod
    def of_map(cls, score_map: npt.ArrayLike, counted: npt.ArrayLike, side: int | None = None) -> AlarmBlocks:
        """Pixels of a score map (lines, samples) that count; NaN where invalid.  ``side`` None: about 64 blocks."""
        scores = np.asarray(score_map, dtype=float)
        lines, samples = np.nonzero(np.asarray(counted, dtype=bool) & np.isfinite(scores))
        return cls.of_places(scores[lines, samples], lines, samples, side)

    @classmethod
    def of_places(
        cls, scores: npt.ArrayLike, lines: npt.ArrayLike, samples: npt.ArrayLike, side: int | None = None
    ) -> AlarmBlocks:
        """Scores (n,) at lines and samples (n,) [pixels]."""
        values = np.asarray(scores, dtype=float)
        b = side or block_side(values.size)
        place = np.stack([np.asarray(lines) // b, np.asarray(samples) // b]).astype(np.int64) + 1
        width = int(place[1].max(initial=0)) + 2
        key, block = np.unique(place[0] * width + place[1], return_inverse=True)
        return cls(values, block.astype(np.int64), _bartlett(key, width))

    @cached_property
    def pixels(self) -> Counts:
        """(M,) pixels of each block."""
        return np.bincount(self.block, minlength=self.neighbours.shape[0])

    @cached_property
    def order(self) -> Counts:
        """(n,) places of the scores from the least to the greatest."""
        return np.argsort(self.scores)

    @cached_property
    def ascending(self) -> Array:
        """(n,) the scores in order."""
        return self.scores[self.order]

    def counts(self, threshold: Array) -> Counts:
        """(T, M) scores above each of the thresholds (T,), which fall."""
        blocks = self.pixels.size
        first = np.searchsorted(-threshold, -self.scores, side="right")  # the first threshold that lies below
        cell = np.bincount(first * blocks + self.block, minlength=(threshold.size + 1) * blocks)
        return np.cumsum(cell.reshape(-1, blocks)[: threshold.size], axis=0)

    def variance_of_sum(self, deviation: Array) -> Array:
        """(T,) variance of the sum over all blocks of quantities whose deviations (T, M) from their share sum to 0.

        sum_ij w_ij e_i e_j with the weights of Bartlett over neighbouring blocks, so that a cluster across the
        border of two blocks counts as one; times M/(M - sum w/M), as the deviations were taken from their own mean.
        Never less than that of blocks that know nothing of each other, times M/(M - 1) (Cochran, Sampling
        Techniques, 1977, 6.4).  Source: Conley, J. Econometrics 92, 1-45, 1999, the spatial form of Newey & West,
        Econometrica 55, 703-708, 1987.
        """
        m = self.pixels.size
        alone = np.sum(deviation**2, axis=1) * m / max(m - 1, 1)
        free = m - float(self.neighbours.sum()) / m
        if free <= 0.0:
            return np.asarray(alone)
        together = np.sum(deviation * (self.neighbours @ deviation.T).T, axis=1) * m / free
        return np.asarray(np.maximum(alone, together))

    @property
    def degrees_of_freedom(self) -> float:
        """Behind :meth:`variance_of_sum` of independent blocks: M / sum_j w_ij^2, less 1; 1 at least."""
        squares = float(self.neighbours.multiply(self.neighbours).sum())
        return max(self.pixels.size**2 / squares - 1.0, 1.0)

    def pfa_limits(self, threshold: Array) -> tuple[Counts, Array, Array]:
        """Alarms (T,) above thresholds (T,) that fall, and the 95 % limits (T,) of P_FA at each.

        Those by Jeffreys' prior (:func:`~hyperval.processing.intervals.jeffreys_limits`) for the alarms and the
        pixels over the design effect: how many times as large the variance of the number of alarms is as that of
        independent pixels (Kish, Survey Sampling, 1965, 8.2).  Few alarms know their own clusters badly, so the
        design effects of all thresholds count that let up to ten times as many pixels through: the greatest by
        three quarters, as rare alarms may cluster more than the mean says, the mean by one, as chance raises the
        greatest.
        """
        k, effect = self._design_effects(threshold)
        lower, upper = jeffreys_limits(k / effect, self.scores.size / effect)
        return k, lower, upper

    def half_image_factor(self, threshold: Array) -> Array:
        """(T,) factor by which P_FA of one half of the image misses that of the other, above thresholds that fall.

        The median over random halves of the blocks, of the greater of the two shares over the smaller; inf where
        one half has no alarm in half of them or more.  The pixels themselves tell no more of other pixels, so that
        no model can be asked for more.
        """
        rng = np.random.default_rng(_SEED)
        m = self.pixels.size
        if m < 2:
            return np.full(threshold.size, np.inf)
        half = np.zeros((m, _HALVES))
        for column in half.T:
            column[rng.permutation(m)[: m // 2]] = 1.0
        counts = self.counts(threshold)
        alarms, pixels = counts @ half, self.pixels @ half
        one, other = alarms / pixels, (counts.sum(axis=1)[:, None] - alarms) / (self.pixels.sum() - pixels)
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.maximum(one, other) / np.minimum(one, other)
        return np.asarray(np.median(np.where(np.isnan(factor), 1.0, factor), axis=1))

    def _design_effects(self, threshold: Array) -> tuple[Counts, Array]:
        """Alarms (T,) above thresholds (T,) that fall, and the design effect at each."""
        n = self.scores.size
        by_block = self.counts(threshold)
        k = by_block.sum(axis=1)
        p = k / n
        independent = n * p * (1.0 - p)
        variance = self.variance_of_sum(by_block - p[:, None] * self.pixels)
        effect = np.clip(np.where(independent > 0.0, variance / np.maximum(independent, 1e-300), 1.0), 1.0, n)
        last = np.searchsorted(k, _DECADE * np.maximum(k, 1), side="right")
        decades = (effect[i : max(j, i + 1)] for i, j in enumerate(last))
        return k, np.array([_GREATEST * near.max() + (1.0 - _GREATEST) * near.mean() for near in decades])

    @cached_property
    def _effects(self) -> tuple[Array, Array]:
        """log(1 + alarms) and the design effect, at ranks from 0 to n, evenly in their logarithm."""
        n = self.scores.size
        ranks = np.unique(np.append(0, np.geomspace(1, n, _RANKS).astype(np.int64)))
        k, effect = self._design_effects(np.append(self.ascending[n - 1 - ranks[ranks < n]], -np.inf))
        return np.log1p(k), effect

    def rank_limits(self, pfa: Array) -> tuple[Counts, Counts]:
        """Ranks r, s (K,) of the order statistics between which the threshold lies that truly gives ``pfa`` (K,).

        The thresholds whose interval of P_FA holds ``pfa``: those from the s-th to the r-th greatest score; r is 0
        where no score bounds it from above, s is n + 1 where none does from below.
        """
        n = self.scores.size

        def first(limit: int) -> Counts:
            """Least number of alarms whose lower (0) or upper (1) limit lies beyond; n + 1 where none does."""
            low, high = np.zeros(pfa.size, np.int64), np.full(pfa.size, n + 1)
            while np.any(low < high):
                middle = (low + high) // 2
                effect = np.interp(np.log1p(middle), *self._effects)
                below, above = beyond_jeffreys_limits(middle / effect, n / effect, pfa)
                there = ~above if limit else below
                open_ = low < high
                high = np.where(open_ & there, middle, high)
                low = np.where(open_ & ~there, middle + 1, low)
            return low

        return first(1), first(0)


def _bartlett(key: Counts, width: int) -> sparse.csr_array:
    """Weights between blocks, of which ``key`` (M,), increasing, is line times ``width`` plus sample."""
    m = key.size
    rows, columns, weights = [], [], []
    for down in (-1, 0, 1):
        for along in (-1, 0, 1):
            wanted = key + down * width + along
            at = np.minimum(np.searchsorted(key, wanted), m - 1)
            there = np.flatnonzero(key[at] == wanted)
            rows.append(there)
            columns.append(at[there])
            weights.append(np.full(there.size, (1.0 - abs(down) / 2.0) * (1.0 - abs(along) / 2.0)))
    where = np.concatenate(rows), np.concatenate(columns)
    from scipy import sparse  # what counts no alarms does without

    return sparse.csr_array((np.concatenate(weights), where), shape=(m, m))


def same_scores(blocks: AlarmBlocks | None, scores: Array) -> None:
    """Raise UsageError where the places of other scores than ``scores`` are given."""
    if blocks is not None and blocks.scores.size != scores.size:
        raise UsageError(f"{blocks.scores.size} places for {scores.size} background scores")
