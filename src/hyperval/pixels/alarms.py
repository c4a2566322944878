"""Background scores with their places, and what that says of a false-alarm probability: alarms come in clusters.

Which class lies where is the scene's and would be the same in another image of it, so that blocks are compared with
the mean of their class: the layout of classes is no chance.

How often background scores lie above a threshold, with an interval that knows that alarms come in clusters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.errors import refusal
from hyperval.model.intervals import Z95, beyond_jeffreys_limits, jeffreys_limits
from hyperval.products import ExceedanceCurve

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
_CONFINED = 0.5  # part of its scatter that a class in few blocks takes away with its own mean, at most
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
    stratum : (M,) number of the class that a block is of; where classes meet, each has a block of its own
    """

    scores: Array
    block: Counts
    neighbours: sparse.csr_array
    stratum: Counts

    @classmethod
    def of_map(
        cls,
        score_map: npt.ArrayLike,
        counted: npt.ArrayLike,
        side: int | None = None,
        classes: npt.ArrayLike | None = None,
    ) -> AlarmBlocks:
        """Pixels of a score map (lines, samples) that count; NaN where invalid.

        ``side`` None: about 64 blocks.  ``classes`` (lines, samples): number of the class of each pixel, from 0 on;
        None where classes are not known, and their differences count as chance.
        """
        scores = np.asarray(score_map, dtype=float)
        lines, samples = np.nonzero(np.asarray(counted, dtype=bool) & np.isfinite(scores))
        own = None if classes is None else np.asarray(classes)[lines, samples]
        return cls.of_places(scores[lines, samples], lines, samples, side, own)

    @classmethod
    def of_places(
        cls,
        scores: npt.ArrayLike,
        lines: npt.ArrayLike,
        samples: npt.ArrayLike,
        side: int | None = None,
        classes: npt.ArrayLike | None = None,
    ) -> AlarmBlocks:
        """Scores (n,) at lines and samples (n,) [pixels], of ``classes`` (n,)."""
        values = np.asarray(scores, dtype=float)
        b = side or block_side(values.size)
        own = np.zeros(values.size, np.int64) if classes is None else np.asarray(classes, np.int64)
        line, sample = (np.asarray(at, np.int64) // b for at in (lines, samples))
        width, many = int(sample.max(initial=0)) + 1, int(own.max(initial=0)) + 1
        key, block = np.unique((line * width + sample) * many + own, return_inverse=True)
        near = _bartlett(np.stack(np.divmod(key // many, width), axis=1))
        return cls(values, block.astype(np.int64), near, _strata(np.bincount(block), key % many, near))

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

    def variance_of_sum(self, sums: Array) -> tuple[Array, Array]:
        """(T,) variance of sums over all pixels, told from their parts (T, M) by block, and its degrees of freedom.

        sum_ij w_ij e_i e_j with the weights of Bartlett over neighbouring blocks, so that a cluster across the
        border of two blocks counts as one.  e is what a block has beyond the mean of its class: where the classes
        lie is the scene and no chance (Cochran, Sampling Techniques, 1977, 5A.9).  As that mean is theirs, what is
        left of independent blocks with parts q of their class is 1 - sum_ij w_ij q_i q_j, by which it is divided.
        Never less than the variance of blocks that know nothing of each other.  Source: Conley, J. Econometrics 92,
        1-45, 1999, the spatial form of Newey & West, Econometrica 55, 703-708, 1987.

        The degrees of freedom are 2 V^2 / var(V), less 1, with V = sum e^2 and var(V) from the e themselves: alarms
        that lie in a few blocks know their clusters badly.  1 at least.
        """
        q, w = _shares(self.pixels, self.stratum), self.neighbours
        inside = q > 0.0
        e = sums - (sums @ inside) @ q.T
        square = e**2
        of_class = square @ inside
        v = np.maximum(of_class.sum(axis=1), 1e-300)
        alone = (of_class / np.maximum(1.0 - np.sum(q**2, axis=0), 0.5)).sum(axis=1)
        kept = 1.0 - (of_class @ np.einsum("ic,ic->c", q, w @ q)) / v
        together = np.sum(e * (w @ e.T).T, axis=1) / np.where(kept > 0.0, kept, np.inf)
        scatter = 2.0 * np.sum(square * (w.multiply(w) @ square.T).T, axis=1) - np.sum(square**2, axis=1)
        scatter -= of_class**2 @ np.sum(q**2, axis=0)
        dof = 2.0 * v**2 / np.maximum(scatter, 1e-300) - 1.0
        return np.maximum(alone, together), np.maximum(dof, 1.0)

    def pfa_limits(self, threshold: Array) -> tuple[Counts, Array, Array]:
        """Alarms (T,) above thresholds (T,) that fall, and the 95 % limits (T,) of P_FA at each.

        Those by Jeffreys' prior (:func:`~hyperval.model.intervals.jeffreys_limits`) for the alarms and the
        pixels over the design effect: how many times as large the variance of the number of alarms is as that of
        independent pixels (Kish, Survey Sampling, 1965, 8.2).  Few alarms know their own clusters badly.  So what
        the effect has beyond 1 is widened by (t/1.96)^2 (JCGM 100:2008, G.3), and the effects of all thresholds
        count that let up to ten times as many pixels through: the greatest by three quarters, as rare alarms may
        cluster more than the mean says, the mean by one, as chance raises the greatest.
        """
        k, effect = self._design_effects(threshold)
        lower, upper = jeffreys_limits(k / effect, self.scores.size / effect)
        return k, lower, upper

    def half_image_factor(self, threshold: Array) -> Array:
        """(T,) factor by which P_FA of one half of the image misses that of the other, above thresholds that fall.

        The median over random halves of the blocks of each class, of the greater of the two rates over the smaller;
        inf where one half has no alarm in half of them or more.  The pixels themselves tell no more of others, so
        that no model can be asked for more.
        """
        rng = np.random.default_rng(_SEED)
        m = self.pixels.size
        if m < 2:
            return np.full(threshold.size, np.inf)
        half = np.zeros((m, _HALVES))
        for column in half.T:
            column[np.lexsort((rng.random(m), self.stratum))[::2]] = 1.0
        counts, rates = self.counts(threshold), []
        for part in (half, 1.0 - half):
            rate = np.zeros((threshold.size, _HALVES))
            for own in (self.stratum == c for c in np.unique(self.stratum)):
                pixels = self.pixels[own]
                rate += pixels.sum() * (counts[:, own] @ part[own]) / (pixels @ part[own])
            rates.append(rate)
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.maximum(*rates) / np.minimum(*rates)
        return np.asarray(np.median(np.where(np.isnan(factor), 1.0, factor), axis=1))

    def _design_effects(self, threshold: Array) -> tuple[Counts, Array]:
        """Alarms (T,) above thresholds (T,) that fall, and the design effect at each."""
        n = self.scores.size
        by_block = self.counts(threshold)
        k = by_block.sum(axis=1)
        p = k / n
        independent = n * p * (1.0 - p)
        variance, dof = self.variance_of_sum(by_block.astype(float))
        beyond = np.where(independent > 0.0, variance / np.maximum(independent, 1e-300), 1.0) - 1.0
        effect = np.clip(1.0 + beyond * (special.stdtrit(dof, 0.975) / Z95) ** 2, 1.0, n)
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

    def design_effect(self, alarms: npt.ArrayLike) -> Array:
        """How many times as large the variance of a number of alarms is as that of independent pixels."""
        return np.interp(np.log1p(alarms), *self._effects)

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
                effect = self.design_effect(middle)
                below, above = beyond_jeffreys_limits(middle / effect, n / effect, pfa)
                there = ~above if limit else below
                open_ = low < high
                high = np.where(open_ & there, middle, high)
                low = np.where(open_ & ~there, middle + 1, low)
            return low

        return first(1), first(0)


def _strata(pixels: Counts, of_class: Counts, neighbours: sparse.csr_array) -> Counts:
    """(M,) class of each block; classes confined to few blocks are taken with the greatest of the others."""
    names, stratum = np.unique(of_class, return_inverse=True)
    share = _shares(pixels, stratum)
    confined = np.einsum("ic,ic->c", share, neighbours @ share) > _CONFINED
    home = int(np.argmax(np.where(confined, 0.0, np.bincount(stratum, pixels)))) if names.size else 0
    return np.asarray(np.where(confined, home, np.arange(names.size))[stratum])


def _shares(pixels: Counts, stratum: Counts) -> Array:
    """(M, C) part of the pixels of each class that lies in each block."""
    own = pixels[:, None] * (stratum[:, None] == np.unique(stratum))
    return np.asarray(own / own.sum(axis=0))


def _bartlett(squares: Counts) -> sparse.csr_array:
    """Weights between blocks, by their places (M, 2): the part of two steps that is left, down and along."""
    from scipy import sparse, spatial  # what counts no alarms does without

    pairs = spatial.KDTree(squares).query_pairs(1.0, np.inf, output_type="ndarray")
    weight = np.prod(1.0 - np.abs(squares[pairs[:, 0]] - squares[pairs[:, 1]]) / 2.0, axis=1)
    half = sparse.csr_array((weight, pairs.T), shape=(len(squares), len(squares)))
    return sparse.csr_array(half + half.T + sparse.eye_array(len(squares)))


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

    The interval is :meth:`~hyperval.pixels.alarms.AlarmBlocks.pfa_limits`; there is none where all alarms
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
        raise refusal("alarms.few", n=n, least=FEWEST_FOR_A_CURVE)
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


def exceedance_at(curve: ExceedanceCurve, threshold: float, values: Array | None = None) -> float:
    """P(score > threshold), linear in log P between the points of a curve; that of its ends beyond them.

    ``values`` (T,) : what stands for P, such as a limit of it
    """
    keep = curve.probability > 0
    p = curve.probability if values is None else values
    return float(np.exp(np.interp(threshold, curve.threshold[keep], np.log(p[keep]))))


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
    law = [abs(math.log(exceedance_at(predicted, threshold, side) / p)) for side in (predicted.lower, predicted.upper)]
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = np.abs(np.log(np.array([measured.upper[at], measured.lower[at]]) / m))
    down, up = np.hypot(law, rate)
    ratio = p / m
    return FalseAlarmRatio(ratio, float(ratio * np.exp(-down)), float(ratio * np.exp(up)), at, p, math.exp(max(law)))
