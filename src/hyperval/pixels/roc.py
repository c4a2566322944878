"""Empirical ROC curves: exact with ties, by pixel or by object, with intervals of curve, areas and alarms.

A pixel is declared a target when its score lies strictly above the threshold.  The background is read from its scores
in ascending order.

Every area is the mean over targets of a function g of s, the share of the background that outscores the target:

    whole          g = 1 - s                                       P_FA from 0 to 1 (Mann-Whitney)
    partial        g = (b - clip(s, a, b))/(b - a)                 mean P_D over P_FA from a to b
    log-weighted   g = ln(b/clip(s, a, b))/ln(b/a)                 the same, evenly in log P_FA

so that one rule gives their variance: s^2(V_i)/m + s^2(W_j)/n with V_i = g(s_i) and W_j the mean over targets of
g'(s_i) [background j outscores target i].  For the whole area it is that of DeLong, DeLong & Clarke-Pearson
(Biometrics 44, 837-845, 1988); for the others its first-order form (Dodd & Pepe, Biometrics 59, 614-623, 2003, have
the restriction to a range of P_FA).  Along a tie g is averaged.

Alarms come in clusters, so the uncertainty of a false-alarm probability needs the places of background scores.  The
layout of classes is the scene's and would be the same in another image of it, so blocks are compared with the mean of
their class.

Whole objects are scored with a halo, and the background then by the same footprint.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage, special

from hyperval.data import Array, Counts, Index, Mask
from hyperval.errors import refuse
from hyperval.model import intervals
from hyperval.model.roc import AREAS, WHOLE, RocArea, detection_at
from hyperval.products import AlarmsAtDetection, AreaEstimate, ExceedanceCurve, Influence, RocCurve

if TYPE_CHECKING:
    from scipy import sparse

    from hyperval.imagery import TargetObject

# The alarms of a roof or a shadow are one event, not one per pixel. Blocks stand for events: enough of them to estimate
# their scatter, and large enough to be nearly independent.
BLOCKS = 64
MIN_SIDE = 4
_RANKS = 160  # thresholds at which design effects are looked up
_DECADE = 10.0
_HALF_DRAWS, _SEED = 400, 23  # random divisions of the blocks into two halves
_CONFINED = 0.5  # greatest part of its scatter that a class in few blocks may lose to its own mean
_GREATEST = 0.75  # weight of the greatest design effect of a decade beside their mean


def block_side(pixels: int) -> int:
    """Side of square blocks of which ``pixels`` fill about 64 [pixels]."""
    return max(MIN_SIDE, round(float(np.sqrt(pixels / BLOCKS))))


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
    def from_map(cls, score_map: Array, counted: Mask, classes: npt.NDArray[Any] | None = None) -> AlarmBlocks:
        """Pixels of a score map (lines, samples) that count, in about 64 blocks; NaN where invalid.

        ``classes`` (lines, samples): number of the class of each pixel, from 0 on; None where classes are not known,
        and their differences count as chance.
        """
        lines, samples = pixels = np.nonzero(counted & np.isfinite(score_map))
        return cls.from_pixels(score_map[pixels], lines, samples, None, None if classes is None else classes[pixels])

    @classmethod
    def from_pixels(
        cls, scores: Array, lines: Index, samples: Index, side: int | None = None, classes: npt.ArrayLike | None = None
    ) -> AlarmBlocks:
        """Scores (n,) at lines and samples (n,) [pixels], of ``classes`` (n,); ``side`` None: about 64 blocks."""
        b = side or block_side(scores.size)
        class_number = np.zeros(scores.size, np.int64) if classes is None else np.asarray(classes, np.int64)
        width, n_classes = int(samples.max(initial=0)) // b + 1, int(class_number.max(initial=0)) + 1
        key, block = np.unique((lines // b * width + samples // b) * n_classes + class_number, return_inverse=True)
        neighbours = _bartlett_weights(np.stack(np.divmod(key // n_classes, width), axis=1))
        return cls(scores, block.astype(np.int64), neighbours, _strata(np.bincount(block), key % n_classes, neighbours))

    @classmethod
    def from_scores(cls, scores: npt.ArrayLike) -> AlarmBlocks:
        """Scores of any shape whose places are not known, each taken by itself; UsageError where some are NaN."""
        from scipy import sparse

        values = sorted_scores(scores, "background")
        return cls(values, np.zeros(values.size, np.int64), sparse.eye_array(1, format="csr"), np.zeros(1, np.int64))

    @cached_property
    def block_sizes(self) -> Counts:
        """(M,) pixels of each block."""
        return np.bincount(self.block, minlength=self.neighbours.shape[0])

    @cached_property
    def sorted_scores(self) -> Array:
        """(n,) the scores in order."""
        return sorted_scores(self.scores, "background")

    def counts_above(self, threshold: Array) -> Counts:
        """(T, M) scores above each of the thresholds (T,), which fall."""
        blocks = self.block_sizes.size
        first_below = np.searchsorted(-threshold, -self.scores, side="right")  # the first threshold that lies below
        cell = np.bincount(first_below * blocks + self.block, minlength=(threshold.size + 1) * blocks)
        return np.cumsum(cell.reshape(-1, blocks)[: threshold.size], axis=0)

    def variance_of_sum(self, sums: Array) -> tuple[Array, Array]:
        """(T,) variance of sums over all pixels, from their parts (T, M) by block, and its degrees of freedom.

        sum_ij w_ij e_i e_j with the weights of Bartlett over neighbouring blocks, so that a cluster across the
        border of two blocks counts as one.  e is the departure of a block from the mean of its class (stratification:
        Cochran, Sampling Techniques, 1977, 5A.9).  As that mean is their own, independent blocks with parts q of their
        class retain 1 - sum_ij w_ij q_i q_j of their variance, by which it is divided.  Never less than the variance
        of independent blocks.  Source: Conley, J. Econometrics 92, 1-45, 1999, the spatial form of Newey & West,
        Econometrica 55, 703-708, 1987.

        The degrees of freedom are 2 V^2 / var(V), less 1, with V = sum e^2 and var(V) from the e themselves: few where
        alarms lie in a few blocks.  1 at least.
        """
        q, w = _class_shares(self.block_sizes, self.stratum), self.neighbours
        member = q > 0.0
        e = sums - (sums @ member) @ q.T
        square = e**2
        class_squares = square @ member
        v = np.maximum(class_squares.sum(axis=1), 1e-300)
        independent = (class_squares / np.maximum(1.0 - np.sum(q**2, axis=0), 0.5)).sum(axis=1)
        retained = 1.0 - (class_squares @ np.einsum("ic,ic->c", q, w @ q)) / v
        clustered = np.sum(e * (w @ e.T).T, axis=1) / np.where(retained > 0.0, retained, np.inf)
        scatter = 2.0 * np.sum(square * (w.multiply(w) @ square.T).T, axis=1) - np.sum(square**2, axis=1)
        scatter -= class_squares**2 @ np.sum(q**2, axis=0)
        dof = 2.0 * v**2 / np.maximum(scatter, 1e-300) - 1.0
        return np.maximum(independent, clustered), np.maximum(dof, 1.0)

    @property
    def moment_errors(self) -> tuple[float, float]:
        """Standard errors of the mean score, and of the standard deviation as a part of it.

        NaN in one block, or where all scores are equal.  By :meth:`variance_of_sum` of departures and of their squares,
        widened by (t/1.96)^2 as a design effect is.

        >>> AlarmBlocks.from_map(np.zeros((60, 60)), np.ones((60, 60), bool)).moment_errors
        (nan, nan)
        """
        departures = self.scores - (self.scores.mean() if self.scores.size else 0.0)
        square = float(np.mean(departures**2)) if self.stratum.size > 1 else 0.0
        if square == 0.0:
            return np.nan, np.nan
        sums = [np.bincount(self.block, x) for x in (departures, departures**2 - square)]
        variance, dof = self.variance_of_sum(np.array(sums))
        mean, second = (np.sqrt(variance) / departures.size * intervals.student_factor(dof)).tolist()
        return mean, 0.5 * second / square

    def pfa_limits(self, threshold: Array) -> tuple[Counts, Array, Array]:
        """Alarms (T,) above thresholds (T,) that fall, and the 95 % limits (T,) of P_FA at each.

        Those by Jeffreys' prior (:func:`~hyperval.model.intervals.jeffreys_limits`) for the alarms and the
        pixels over the :meth:`design_effect`.
        """
        k = self.scores.size - np.searchsorted(self.sorted_scores, threshold, side="right")
        effect = self.design_effect(k)
        return k, *intervals.jeffreys_limits(k / effect, self.scores.size / effect)

    def half_image_factor(self, threshold: Array) -> Array:
        """(T,) ratio of P_FA between halves of the image, above thresholds that fall.

        The median over random halves of the blocks of each class, of the greater of the two rates over the smaller;
        inf where one half has no alarm in half of them or more.  The pixels predict other pixels no better, so no
        model can be required to.
        """
        rng = np.random.default_rng(_SEED)
        m = self.block_sizes.size
        if m < 2:
            return np.full(threshold.size, np.inf)
        half = np.zeros((m, _HALF_DRAWS))
        for column in half.T:
            column[np.lexsort((rng.random(m), self.stratum))[::2]] = 1.0
        counts, q = self.counts_above(threshold), _class_shares(self.block_sizes, self.stratum)
        class_index = np.argmax(q > 0.0, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = [counts @ (mask / (q.T @ mask)[class_index]) for mask in (half, 1.0 - half)]
            factor = np.maximum(*rates) / np.minimum(*rates)
        return np.asarray(np.median(np.where(np.isnan(factor), 1.0, factor), axis=1))

    @cached_property
    def _effect_table(self) -> tuple[Array, Array]:
        """log(1 + alarms) and the design effect, at ranks from 0 to n, evenly in their logarithm."""
        n = self.scores.size
        if self.stratum.size < 2:
            return np.zeros(1), np.ones(1)
        ranks = np.unique(np.append(0, np.geomspace(1, n, _RANKS).astype(np.int64)))
        by_block = self.counts_above(np.append(self.sorted_scores[n - 1 - ranks[ranks < n]], -np.inf))
        k = by_block.sum(axis=1)
        p = k / n
        independent = n * p * (1.0 - p)
        variance, dof = self.variance_of_sum(by_block.astype(float))
        excess = np.where(independent > 0.0, variance / np.maximum(independent, 1e-300), 1.0) - 1.0
        effect = np.clip(1.0 + excess * intervals.student_factor(dof) ** 2, 1.0, n)
        ends = np.searchsorted(k, _DECADE * np.maximum(k, 1), side="right")
        decades = (effect[i : max(j, i + 1)] for i, j in enumerate(ends))
        return np.log1p(k), np.array([_GREATEST * x.max() + (1.0 - _GREATEST) * x.mean() for x in decades])

    def design_effect(self, alarms: npt.ArrayLike) -> Array:
        """Variance of a number of alarms over that of independent pixels.

        Few alarms estimate their clustering badly.  So the excess over 1 is widened by (t/1.96)^2 (JCGM 100:2008, G.3),
        and averaged over the thresholds that pass up to ten times as many pixels: the greatest has a weight of three
        quarters, as rare alarms may cluster more than the mean, the mean one quarter, as chance raises the greatest.
        1 where all lie in one block.  Source: Kish, Survey Sampling, 1965, 8.2.
        """
        return np.interp(np.log1p(alarms), *self._effect_table)

    def rank_limits(self, pfa: Array) -> tuple[Counts, Counts]:
        """Ranks r, s (K,) of the order statistics between which the threshold lies that truly gives ``pfa`` (K,).

        The thresholds whose interval of P_FA holds ``pfa``: those from the s-th to the r-th greatest score; r is 0
        where no score bounds it from above, s is n + 1 where none does from below.  Where there are fewer alarms
        than ``pfa`` expects, the image may lack one cluster of them: the design effect is that of the geometric mean
        of both numbers.  Of scores in one block the number above a threshold is binomial.
        """
        n = self.scores.size
        if self.stratum.size < 2:
            return _threshold_ranks(n, pfa, LEVEL)
        # Bisection for the least number of alarms whose upper (0), or lower (1), limit is beyond; n + 1 without one.
        low, high = np.zeros((2, pfa.size), np.int64), np.full((2, pfa.size), n + 1)
        while np.any(low < high):
            middle = (low + high) // 2
            expected = np.sqrt(np.maximum(middle, 1) * n * pfa)
            effect = self.design_effect(np.maximum(middle, expected))
            below, above = intervals.beyond_jeffreys_limits(middle / effect, n / effect, pfa)
            passed = np.stack([~above[0], below[1]])
            low, high = np.where(passed | (low == high), low, middle + 1), np.where(passed, middle, high)
        return low[0], low[1]


def _strata(pixels: Counts, class_number: Counts, neighbours: sparse.csr_array) -> Counts:
    """(M,) class of each block; classes confined to few blocks join the largest of the others."""
    names, stratum = np.unique(class_number, return_inverse=True)
    share = _class_shares(pixels, stratum)
    confined = np.einsum("ic,ic->c", share, neighbours @ share) > _CONFINED
    largest = int(np.argmax(np.where(confined, 0.0, np.bincount(stratum, pixels)))) if names.size else 0
    return np.asarray(np.where(confined, largest, np.arange(names.size))[stratum])


def _class_shares(pixels: Counts, stratum: Counts) -> Array:
    """(M, C) part of the pixels of each class that lies in each block."""
    part = pixels[:, None] * (stratum[:, None] == np.unique(stratum))
    return np.asarray(part / part.sum(axis=0))


def _bartlett_weights(squares: Counts) -> sparse.csr_array:
    """Bartlett's weights between blocks at (M, 2): product over both axes of 1 - distance/2, to neighbours alone."""
    from scipy import sparse, spatial  # slow to load, and needed for alarms alone

    pairs = spatial.KDTree(squares).query_pairs(1.0, np.inf, output_type="ndarray")
    weight = np.prod(1.0 - np.abs(squares[pairs[:, 0]] - squares[pairs[:, 1]]) / 2.0, axis=1)
    half = sparse.csr_array((weight, pairs.T), shape=(len(squares), len(squares)))
    return sparse.csr_array(half + half.T + sparse.eye_array(len(squares)))


_PER_DECADE = 10
_MIN_ALARMS = 5
MIN_FOR_A_CURVE = 20
LEAST_EXPECTED_ALARMS = 10.0  # with fewer at a level no ratio or area is stated
ANOMALY_LEVELS = (1e-4, 1e-3, 1e-2)  # P_FA at which a threshold of anomalies is stated


class FalseAlarmRatio(NamedTuple):
    """P_FA predicted over measured at the threshold that was measured to give one level.

    Attributes
    ----------
    value, lower, upper : the ratio and its 95 % interval [1]
    predicted : P_FA of the model at that threshold
    law_factor : 95 % factor of the ratio by the sampling of the pixels that the model's law was fitted to; 1 where
        the law is stated
    correlation : of the errors of law and measured share
    """

    value: float
    lower: float
    upper: float
    predicted: float
    law_factor: float
    correlation: float


def exceedance_curve(background: AlarmBlocks) -> ExceedanceCurve:
    """P(score > threshold) of 20 background pixels or more, at ten thresholds for each decade of it, down to 5 alarms.

    The interval is :meth:`~hyperval.pixels.AlarmBlocks.pfa_limits`; there is none where all alarms
    lie in one block.

    Examples
    --------
    >>> scores = np.random.default_rng(1).normal(size=(100, 100))
    >>> curve = exceedance_curve(AlarmBlocks.from_map(scores, np.ones((100, 100), dtype=bool)))
    >>> bool(curve.half_image[np.argmin(np.abs(curve.probability - 1e-2))] < 1.5)
    True
    """
    n = background.scores.size
    decades = np.log10(n / _MIN_ALARMS)
    level = 10.0 ** -(np.arange(int(decades * _PER_DECADE), -1, -1) / _PER_DECADE)
    level = level[level <= 0.5]
    # The lowest threshold that at most n P of the scores exceed; equal scores exceed it all or none.
    falling = np.unique(background.sorted_scores[n - 1 - np.floor(n * level + 1e-9).astype(int)])[::-1]
    alarms, *limits = background.pfa_limits(falling)
    valid = np.count_nonzero(background.counts_above(falling), axis=1) >= 2
    low, high = (np.where(valid, limit, np.nan) for limit in limits)
    columns = (falling, alarms / n, low, high, background.half_image_factor(falling))
    threshold, probability, lower, upper, half = (column[::-1] for column in columns)
    return ExceedanceCurve(threshold, probability, lower, upper, n, half)


def nearest_point(curve: ExceedanceCurve, level: float) -> int:
    """The point of a curve whose P_FA is nearest to ``level`` in its logarithm."""
    return int(np.argmin(np.abs(np.log(curve.probability.clip(1e-300)) - math.log(level))))


def exceedance_at(curve: ExceedanceCurve, threshold: float, values: Array | None = None) -> float:
    """P(score > threshold), linear in log P between the points of a curve, constant beyond its ends.

    ``values`` (T,) : in place of P, such as a limit of it
    """
    positive = curve.probability > 0
    p = curve.probability if values is None else values
    return float(np.exp(np.interp(threshold, curve.threshold[positive], np.log(p[positive]))))


def with_shared_pixels(law: ExceedanceCurve, score_map: npt.ArrayLike, number: npt.NDArray[Any]) -> ExceedanceCurve:
    """A predicted curve with the correlation between its error and that of the measured P_FA, and their influences.

    A law fitted to the pixels whose false alarms are counted shares their errors.  A joint jackknife leaves each part
    of the image out of both sides in turn; each region keeps its share of the image.

    Parameters
    ----------
    score_map : (lines, samples)
    number : (lines, samples) part of each counted pixel, region by region of ``law.left_out``, then of pixels that
        lie in none of them; -1 for others

    Examples
    --------
    >>> scores, number = np.random.default_rng(0).normal(size=(40, 40)), np.arange(1600).reshape(40, 40) // 100
    >>> x, each = np.array([0.0, 1.0]), [np.delete(scores.ravel(), np.s_[g * 100 : g * 100 + 100]) for g in range(16)]
    >>> own = {"all": np.log([[np.mean(s > t) for t in x] for s in each])}
    >>> law = ExceedanceCurve(x, *np.array([[np.mean(scores > t) for t in x]] * 3), left_out=own)
    >>> with_shared_pixels(law, scores, number).correlation.round(6).tolist()
    [1.0, 1.0]
    """
    size, left_out, start = law.threshold.size + 1, list(law.left_out.values()), 0
    fitted = sum(map(len, left_out))
    parts = max(int(number.max()) + 1, fitted)
    left_out.append(np.broadcast_to(np.log(law.probability), (parts - fitted, size - 1)))
    counted = number >= 0
    rank = np.searchsorted(law.threshold, np.asarray(score_map)[counted])  # thresholds below the score
    cells = np.bincount(number[counted] * size + rank, minlength=parts * size).reshape(parts, size)
    alarms, pixels = cells[:, ::-1].cumsum(axis=1)[:, -2::-1], cells.sum(axis=1)
    rate, least = alarms.sum(axis=0) / pixels.sum(), 0.5 / pixels.sum()  # half an alarm where none remains
    log_rate, sums = np.empty(alarms.shape), np.zeros((3, size - 1))
    for part_curves in left_out:
        rows = slice(start, start := start + len(part_curves))
        k, n = alarms[rows].sum(axis=0), max(int(pixels[rows].sum()), 1)
        remaining = (k - alarms[rows]) / np.maximum(n - pixels[rows], 1)[:, None]
        log_rate[rows] = np.log(np.maximum(rate + n / pixels.sum() * (remaining - k / n), least))
        if len(part_curves) > 1:
            a, b = intervals.jackknife_directions(part_curves), intervals.jackknife_directions(log_rate[rows])
            sums += np.sum([a * b, a * a, b * b], axis=1)
    influence = Influence(number, alarms, law.threshold, np.exp(np.concatenate(left_out) - log_rate))
    correlation = sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-300))
    return replace(law, correlation=correlation, influence=influence)


def false_alarm_ratio(predicted: ExceedanceCurve, measured: ExceedanceCurve, k: int) -> FalseAlarmRatio:
    """The ratio at a point of the measured curve.

    The limits of both sides are added in quadrature, in the logarithm, less twice their product times the correlation
    where both are of the same pixels (Zou & Donner, Stat. Med. 27, 1693-1702, 2008; Zou, Psychol. Methods 12, 399-413,
    2007).

    Examples
    --------
    >>> x = np.linspace(0.0, 8.0, 81)
    >>> predicted = ExceedanceCurve(x, np.exp(-x), np.exp(-x) / 1.3, np.exp(-x) * 1.3)
    >>> measured = ExceedanceCurve(x, np.exp(-1.1 * x), np.exp(-1.1 * x) / 1.4, np.exp(-1.1 * x) * 1.4, 100_000)
    >>> ratio = false_alarm_ratio(predicted, measured, nearest_point(measured, 1e-2))
    >>> [round(v, 2) for v in (ratio.value, ratio.upper / ratio.value, ratio.law_factor)]
    [1.52, 1.53, 1.3]
    """
    threshold, m = float(measured.threshold[k]), float(measured.probability[k])
    p, correlation = exceedance_at(predicted, threshold), 0.0
    if predicted.correlation is not None:
        correlation = float(np.interp(threshold, predicted.threshold, predicted.correlation))
    limits = predicted.lower, predicted.upper
    law_width = np.array([abs(math.log(exceedance_at(predicted, threshold, side) / p)) for side in limits])
    with np.errstate(divide="ignore", invalid="ignore"):
        rate_width = np.abs(np.log(np.array([measured.upper[k], measured.lower[k]]) / m))
    lower_width, upper_width = np.sqrt(law_width**2 + rate_width**2 - 2.0 * correlation * law_width * rate_width)
    ends = float(p / m * np.exp(-lower_width)), float(p / m * np.exp(upper_width))
    return FalseAlarmRatio(p / m, *ends, p, math.exp(max(law_width)), correlation)


Scores = npt.ArrayLike | AlarmBlocks  # the latter with their places, for clustered errors

POINTS_PER_DECADE = 20
STATED_PD = (0.5, 0.9)
LEVEL = 0.95  # of every interval here
_SAFETY = 6.0  # nominal error rate of the distribution-free limit over that of the interval
_MIN_LOST = 8.0  # missed targets, as a sum of lost area, from which a variance can be estimated
_ROUNDING = 1.0 + 1e-12  # keeps a share that is a whole number of scores from rounding up to the next


def _threshold_ranks(n: int, p: npt.ArrayLike, level: float) -> tuple[Counts, Counts]:
    """Ranks r, s of the greatest scores of n between which the threshold lies that a true share ``p`` exceeds.

    r is the greatest with P(fewer than r of n above it) <= (1 - level)/2: the r-th greatest score bounds it from above,
    and nothing does where r = 0.  s is the least with P(s or more above it) <= (1 - level)/2: the s-th greatest bounds
    it from below, and nothing does where s > n.
    """
    from scipy import stats  # 25 MB, which runs without detection do not need

    tail = (1.0 - level) / 2.0
    return stats.binom.ppf(tail, n, p).astype(np.int64), stats.binom.isf(tail, n, p).astype(np.int64) + 1


def _as_blocks(background: Scores) -> AlarmBlocks:
    return background if isinstance(background, AlarmBlocks) else AlarmBlocks.from_scores(background)


def sorted_scores(scores: npt.ArrayLike, side: str) -> Array:
    """(n,) scores of any shape in order; UsageError where there are none or some are NaN."""
    values = np.ravel(np.asarray(scores, dtype=float))
    values = values if np.all(values[:-1] <= values[1:]) else np.sort(values)  # NaN last
    missing = values.size - int(np.searchsorted(values, np.nan))
    refuse(missing, "roc.missing", missing=missing, size=values.size, side=side)
    refuse(values.size == 0, "roc.empty", side=side)
    return values


@dataclass(frozen=True)
class RankCounts:
    """Background scores between and on the K different target scores.

    Attributes
    ----------
    targets : (K,) targets with each of the scores, which increase
    ties : (K,) background scores equal to each
    between : (K + 1,) background scores below the first, between two, and above the last
    """

    targets: Counts
    ties: Counts
    between: Counts

    @cached_property
    def n_target(self) -> int:
        """Targets."""
        return int(self.targets.sum())

    @cached_property
    def n_background(self) -> int:
        """Background scores."""
        return int(self.ties.sum() + self.between.sum())

    @cached_property
    def shares(self) -> tuple[Array, Array]:
        """(K,) share of the background above each target score, and on it."""
        higher = np.cumsum((self.between[1:] + np.append(self.ties[1:], 0))[::-1])[::-1]
        return higher / self.n_background, self.ties / self.n_background


def rank_counts(target_scores: npt.ArrayLike, background_scores: Scores) -> RankCounts:
    """Counts of the background among the targets, scores of any shape; UsageError where a side is empty or has NaN."""
    value, targets = np.unique(sorted_scores(target_scores, "target"), return_counts=True)
    background = _as_blocks(background_scores).sorted_scores
    lower, upper = (np.searchsorted(background, value, side) for side in ("left", "right"))
    between = np.append(lower, background.size) - np.insert(upper, 0, 0)
    return RankCounts(targets, upper - lower, between)


def alarms_before_first(target_scores: npt.ArrayLike, background_scores: npt.ArrayLike) -> int:
    """Background pixels that are declared before, or together with, the first pixel of any target.

    The rule of RIT's target detection self-test: pixels are read by falling score until the first of the target.
    It favours targets of many pixels or pieces, as the best stands for all, and says nothing of the others.
    Source: Snyder et al., IGARSS 2008, II-915.

    Examples
    --------
    >>> alarms_before_first([0.2, 0.7], [0.1, 0.7, 0.9, 0.6])
    2
    """
    best = np.nanmax(np.asarray(target_scores, dtype=float))
    return int(np.count_nonzero(np.asarray(background_scores, dtype=float) >= best))


def alarms_at_detection(
    target_scores: npt.ArrayLike, background_scores: Scores, pd: Sequence[float] = STATED_PD
) -> tuple[AlarmsAtDetection, ...]:
    """Alarms at the highest threshold that declares at least a share ``pd`` of the targets.

    At that threshold as it stands the number of alarms is binomial, and the exact interval of P_FA is that of
    Clopper & Pearson; no alarm at all gives an upper limit like any other number.  The threshold that truly detects
    ``pd`` is known only through the targets: the number of them above it is binomial, so it lies between two of
    their order statistics.  The distances of the alarms there, and of the limits of
    :func:`~hyperval.model.jeffreys_limits`, from those at the threshold are added in quadrature, in the logarithm
    (Zou & Donner, Stat. Med. 27, 1693-1702, 2008): coverage 0.96 to 0.98 for 20 to 300 targets.  Where the places of
    the background are known, alarms and pixels are divided by the design effect
    (:meth:`~hyperval.pixels.AlarmBlocks.design_effect`), as clustered alarms count as fewer.
    """
    t, background = sorted_scores(target_scores, "target"), _as_blocks(background_scores)
    b, m, n = background.sorted_scores, t.size, background.scores.size

    def alarms(rank: int, side: Literal["left", "right"] = "left") -> int:
        """Background scores that reach, or (``right``) exceed, the ``rank``-th greatest target."""
        return n - int(np.searchsorted(b, t[m - rank], side))

    results = []
    for q in pd:
        rank = int(np.ceil(q * m / _ROUNDING))
        r, s = (int(x) for x in _threshold_ranks(m, q, LEVEL))
        count, effect = alarms(rank), background.design_effect(alarms(rank))
        exact, rate_limits = (
            [float(x) for x in limits(count / effect, n / effect)]
            for limits in (intervals.clopper_pearson, intervals.jeffreys_limits)
        )
        low, high = alarms(r, "right") if r >= 1 else 0.0, alarms(s) if s <= m else n
        rank_limits = max(low, 0.5 * (r >= 1)) / n, max(high, 0.5) / n
        share = max(count, 0.5) / n
        with np.errstate(divide="ignore"):
            low, high = share * np.exp([-1.0, 1.0] * np.hypot(*np.log(np.array([rate_limits, rank_limits]) / share)))
        joint = min(float(low), exact[0]), max(min(float(high), 1.0), exact[1])
        results.append(AlarmsAtDetection(q, float(t[m - rank]), count, count / n, *joint, *exact))
    return tuple(results)


def roc_area(counts: RankCounts, area: RocArea = WHOLE) -> float:
    """The area of the empirical curve, exact with ties.

    Examples
    --------
    >>> roc_area(rank_counts([2.0, 3.0], [0.0, 1.0, 2.5, -1.0]))
    0.875
    """
    return float(counts.targets @ area.averaged(*counts.shares) / counts.n_target)


def area_variance(counts: RankCounts, area: RocArea = WHOLE) -> tuple[float, float]:
    """Sampling variance of the area: the part of the targets and the part of the background.

    With one target or one background score, whose spread is unknown, that part is the bound A (1 - A) of Birnbaum &
    Klose (Ann. Math. Stat. 28, 933-945, 1957).
    """
    m, n, value = counts.n_target, counts.n_background, roc_area(counts, area)
    bound = value * (1.0 - value)
    target_part = float(counts.targets @ (area.averaged(*counts.shares) - value) ** 2 / (m - 1)) if m > 1 else bound
    if n < 2:
        return target_part / m, bound
    w, times = _influence_values(counts, area)
    return target_part / m, float(times @ (w - times @ w / n) ** 2 / (n - 1)) / n


def clustered_variance(counts: RankCounts, area: RocArea, blocks: AlarmBlocks) -> tuple[float, float]:
    """The part of the background in :func:`area_variance` where it comes in clusters, and its degrees of freedom.

    The W_j are summed by block of the image, and the blocks' sums have the variance of
    :meth:`~hyperval.pixels.AlarmBlocks.variance_of_sum`.  Source of the form: Obuchowski, Biometrics 53,
    567-578, 1997 (clustered ROC data).
    """
    w = np.repeat(*_influence_values(counts, area))  # in the order of the scores
    order = np.argsort(blocks.scores)
    sums = np.asarray(np.bincount(blocks.block[order], w, minlength=blocks.block_sizes.size), dtype=float)
    variance, dof = blocks.variance_of_sum(sums[None, :])
    return float(variance[0]) / w.size**2, float(dof[0])


def _influence_values(counts: RankCounts, area: RocArea) -> tuple[Array, Counts]:
    """W of the background scores and their numbers: below the targets, on the first, between it and the second, ..."""
    s, tie = counts.shares
    a, b, untied = area.low, area.high, tie <= 0.0
    with np.errstate(divide="ignore"):
        slope = 1.0 / (np.maximum(s, 1e-300) * np.log(b / a)) if area.logarithmic else 1.0 / (b - a)
    width, ends = np.where(untied, 1.0, tie), area.weight(s + tie)
    # Decrease of the mean of g along the tie by one more score above the target, or level with it.
    above = np.where(untied, np.where((s >= a) & (s < b), -slope, 0.0), (ends - area.weight(s)) / width)
    level = (ends - area.averaged(s, tie)) / width
    # A score between targets k - 1 and k lies above targets 0 .. k - 1; one equal to target k is level with it too.
    between = np.concatenate([[0.0], np.cumsum(counts.targets * above)]) / counts.n_target
    tied = between[:-1] + counts.targets * level / counts.n_target
    places = np.arange(1, between.size)
    return np.insert(between, places, tied), np.insert(counts.between, places, counts.ties)


def logit_interval(
    value: float, variance: float, m: int, n: float, quantile: float | None = None
) -> tuple[float, float]:
    """Interval of an area, symmetric in its logit, with Student's t of the smaller sample or another quantile.

    Where the estimate has no spread, or stands at 0 or 1, the limit is the exact binomial one of min(m, n) trials.
    """
    trials = min(m, n)
    if value <= 0.0 or value >= 1.0 or variance <= 0.0:
        low, high = (float(x) for x in intervals.clopper_pearson(round(value * trials), trials))
        return min(low, value), max(high, value)
    tail = 0.5 + LEVEL / 2.0
    if quantile is None:
        quantile = float(special.stdtrit(trials - 1, tail)) if trials > 1 else float(special.ndtri(tail))
    half = quantile * np.sqrt(variance) / (value * (1.0 - value))
    low, high = special.expit(special.logit(value) + np.array([-half, half])).tolist()
    return low, high


def area_interval(placed: Array, target_variance: float, background_variance: float, n: float) -> tuple[float, float]:
    """Interval of an area from the placements (m,) of its targets and the two parts of its variance.

    The logit interval; where the lost area (the area itself, for a value below 1/2) sums to fewer than 8 targets, its
    far limit is at least the distribution-free one of the placements: few targets, all found, cannot show the one in
    ten that is not.  That limit is conservative: with six times the error rate (0.70 for 0.95) the truth lies beyond it
    in at most 0.022 of draws (5 to 40 targets, normal and two-mode scores, 1,000 draws each), at 0.95 in none.  From
    8 on the coverage of the logit interval by itself is 0.94 to 0.96.
    """
    value = float(np.clip(placed.mean(), 0.0, 1.0))
    variance, m = target_variance + background_variance, placed.size
    low, high = logit_interval(value, variance, m, n)
    if min(float(np.sum(1.0 - placed)), float(np.sum(placed))) >= _MIN_LOST:
        return low, high
    least, greatest = intervals.bounded_mean_limits(np.clip(placed, 0.0, 1.0), 1.0 - _SAFETY * (1.0 - LEVEL))
    normal = float(special.ndtri(0.5 + LEVEL / 2.0))
    background_half = normal * np.sqrt(background_variance)
    normal_limits = logit_interval(value, variance, m, np.inf, quantile=normal)
    if value > 0.5:
        return max(min(low, value - np.hypot(value - least, background_half)), 0.0), normal_limits[1]
    return normal_limits[0], min(max(high, value + np.hypot(greatest - value, background_half)), 1.0)


def area_estimates(
    counts: RankCounts, areas: Mapping[str, RocArea], unit: str, blocks: AlarmBlocks
) -> dict[str, AreaEstimate]:
    """Areas by name with 95 % intervals, by DeLong's variance, of a background that may come in clusters."""
    method = "DeLong" if counts.n_target > 1 else f"one {unit}: the greatest variance there can be"
    estimates = {}
    for name, area in areas.items():
        placed = np.repeat(area.averaged(*counts.shares), counts.targets)
        target_part, background_part = area_variance(counts, area)
        clustered, dof = clustered_variance(counts, area, blocks)
        background_part = max(background_part, clustered)
        # Few blocks estimate their scatter badly; by the background's part of the variance (Satterthwaite).
        share = clustered / max(target_part + background_part, 1e-300)
        effective_n = min(float(counts.n_background), 1.0 + dof / max(share, 1e-6) ** 2)
        low, high = area_interval(placed, target_part, background_part, effective_n)
        estimates[name] = AreaEstimate(float(placed.mean()), low, high, method, placed, background_part)
    return estimates


def pooled_areas(parts: Sequence[Mapping[str, AreaEstimate]], n: int) -> dict[str, AreaEstimate]:
    """Areas of several groups of targets together, each with its own detector, at equal P_FA.

    The pooled curve is the average of the groups' by their numbers of targets, and so are its areas.  The groups
    may share their background, so the standard deviations that it brings are added.
    """
    estimates = {}
    for name in parts[0]:
        if not all(name in p and p[name].placements is not None for p in parts):
            continue
        groups = [np.asarray(p[name].placements) for p in parts]
        placed = np.concatenate(groups)
        share = np.array([e.size for e in groups]) / placed.size
        background = float(share @ np.sqrt([p[name].background_variance for p in parts])) ** 2
        target_part = float(placed.var(ddof=1)) / placed.size if placed.size > 1 else 0.25
        low, high = area_interval(placed, target_part, background, n)
        method = f"{placed.size} targets of {len(groups)} groups"
        estimates[name] = AreaEstimate(float(placed.mean()), low, high, method, placed, background)
    return estimates


def empirical_roc(
    target_scores: npt.ArrayLike,
    background_scores: Scores,
    pfa: npt.ArrayLike | None = None,
    unit: Literal["pixel", "object"] = "pixel",
    *,
    background_area_km2: float | None = None,
) -> RocCurve:
    """Detection probability at the lowest threshold whose empirical false-alarm rate is at most ``pfa``.

    The threshold is the (k+1)-th greatest of the n background scores with k = floor(n pfa), so that at most k
    background pixels lie above it, with ties or without.

    The interval joins two independent uncertainties.  (1) The share of targets above the threshold is binomial:
    mid-P limits (:func:`~hyperval.model.intervals.mid_p_limits`), since a level that is to hold for every P_D
    is void beside the second part anyhow.  (2) The threshold x that truly gives ``pfa`` is known only through the
    background sample: x lies between two order statistics of the background
    (:meth:`~hyperval.pixels.AlarmBlocks.rank_limits`), at which P_D is read again; where n pfa is too small, no score
    bounds x from above and the lower limit of P_D is 0.  Where the places of the background are known, alarms that come
    in clusters widen that range.  The distances of
    both from P_D are added in quadrature on each side (as in Newcombe, Stat. Med. 17, 873-890, 1998).  The true P_D
    rises with P_FA, so limits that do not are widened until they do.  Simulated coverage at 95 % is 0.95 to 0.99
    (tables in validation/coverage/README.md), and 0.92 where 300 targets stand on 44 alarms that come in clusters;
    with the first part alone it falls below 0.4 for a small background and many targets.  Targets must be
    independent of each other, so count objects, not the pixels of one object.

    Parameters
    ----------
    target_scores, background_scores : any shape; +-inf allowed.  The background may come with its places, with all
        that follows
    pfa : preset false-alarm probabilities in (0, 1]; by default a logarithmic grid from one alarm in the whole
        background to 1, which holds the decades

    Raises
    ------
    UsageError : no targets, no background, NaN, or a ``pfa`` outside (0, 1].
    """
    t, background = sorted_scores(target_scores, "target"), _as_blocks(background_scores)
    b, m, n = background.sorted_scores, t.size, int(background.scores.size)
    if pfa is None:
        decades = int(np.ceil(np.log10(max(n, 10))))
        grid = 10.0 ** (np.arange(-decades * POINTS_PER_DECADE, 1) / POINTS_PER_DECADE)
        pfa = grid[grid * n * _ROUNDING >= 1.0]
    p = np.sort(np.atleast_1d(np.asarray(pfa, dtype=float)))
    refuse(not (np.all(p > 0) and np.all(p <= 1)), "roc.preset")
    r, s = background.rank_limits(p)
    k = np.minimum(np.floor(p * n * _ROUNDING).astype(np.int64), n)
    # The scores of these ranks, from the greatest on; inf for rank 0, -inf beyond the last.
    threshold, greatest, least = (
        np.where(rank > n, -np.inf, np.where(rank < 1, np.inf, b[np.clip(n - rank, 0, n - 1)]))
        for rank in (k + 1, r, s)
    )
    alarms = np.where(k >= n, n, n - np.searchsorted(b, threshold, side="right"))

    def above(thresholds: Array, everything: Mask) -> Counts:
        """How many targets lie above the threshold; all of them where ``everything`` is declared, -inf included."""
        return np.where(everything, m, m - np.searchsorted(t, thresholds, side="right"))

    detected = above(threshold, alarms == n)
    whole_image = p >= 1.0  # declares everything, whatever the sample
    few, many = above(greatest, whole_image), above(least, np.isneginf(least))
    pd, (low, high) = detected / m, intervals.mid_p_limits(detected, m)
    lower, upper = _widened_limits(pd, (np.where(whole_image, 1.0, low), high), pd - few / m, many / m - pd)
    effect = background.design_effect(alarms)
    return RocCurve(p, pd, lower, upper, threshold, unit, int(m), n, background_area_km2, alarms, effect)


def _widened_limits(pd: Array, limits: tuple[Array, Array], below: Array, above: Array) -> tuple[Array, Array]:
    """Limits of a curve with more uncertainty to either side, in quadrature; they rise as the true P_D does."""
    low, high = limits
    # Rounding must not bring them inside the binomial limits.
    lower = np.clip(pd - np.hypot(pd - low, below), 0.0, low)
    upper = np.clip(pd + np.hypot(high - pd, above), high, 1.0)
    return np.minimum.accumulate(lower[::-1])[::-1], np.maximum.accumulate(upper)


def with_areas_and_alarms(curve: RocCurve, target_scores: npt.ArrayLike, background_scores: Scores) -> RocCurve:
    """The curve of these scores with its areas and alarms at stated P_D."""
    background, n = _as_blocks(background_scores), int(curve.n_background or 0)
    # Areas whose lowest P_FA the background can resolve.
    areas = {k: a for k, a in AREAS.items() if not a.logarithmic or a.low * n >= LEAST_EXPECTED_ALARMS}
    estimates = area_estimates(rank_counts(target_scores, background), areas, curve.unit, background)
    return replace(curve, areas=estimates, at_detection=alarms_at_detection(target_scores, background))


def pooled_roc(curves: Sequence[RocCurve]) -> RocCurve:
    """One curve for several groups of targets, each with its own detector, at the same false-alarm probability.

    P_D is the share of all targets detected; its interval is the mid-P one of the pooled count and, in
    quadrature, what the sampling of the thresholds brings to each curve, added by the shares of the targets: the
    detectors share their background, and its errors may go together.  All grids are the one of
    :func:`empirical_roc`, from where each background begins.
    """
    size = min(curve.pfa.size for curve in curves)
    grid = curves[0].pfa[-size:]
    total = sum(int(c.n_target or 0) for c in curves)
    detected, below, above = np.zeros((3, grid.size))
    for curve in curves:
        n = int(curve.n_target or 0)
        pd, low, high = (values[-size:] for values in (curve.pd, curve.pd_lower, curve.pd_upper))
        binomial = intervals.mid_p_limits(np.rint(pd * n), n)
        detected += np.rint(pd * n)
        # The sampling of the threshold, in quadrature beside the binomial limits.
        below += n / total * np.sqrt(np.maximum((pd - low) ** 2 - (pd - binomial[0]) ** 2, 0.0))
        above += n / total * np.sqrt(np.maximum((high - pd) ** 2 - (binomial[1] - pd) ** 2, 0.0))
    pd = detected / total
    lower, upper = _widened_limits(pd, intervals.mid_p_limits(detected, total), below, above)
    n_background = min((c.n_background for c in curves if c.n_background is not None), default=None)
    areas = pooled_areas([c.areas for c in curves], n_background or 0)
    first_alarms = min((c.alarms_before_first for c in curves if c.alarms_before_first is not None), default=None)
    # Each curve has thresholds of its own.
    rest = np.full(grid.shape, np.nan), curves[0].unit, total, n_background, curves[0].background_area_km2
    return RocCurve(grid, pd, lower, upper, *rest, areas=areas, alarms_before_first=first_alarms)


def average_roc(curves: Sequence[RocCurve], weights: npt.ArrayLike) -> RocCurve:
    """The predicted curve of several groups of targets at the same false-alarm probability.

    P_D is the average of the groups by ``weights`` (how many targets each has); the limits are averaged as if the
    errors of all groups were fully correlated, which is the widest case.  Its points are those of the first curve that
    lie on all the others too, between whose points P_D is :func:`hyperval.model.detection_at`.
    """
    first, share = curves[0], np.asarray(weights, dtype=float) / np.sum(weights)
    pfa = first.pfa[first.pfa >= max(c.pfa[0] for c in curves)]
    levels = ([detection_at(c, pfa, getattr(c, k)) for c in curves] for k in ("pd", "pd_lower", "pd_upper"))
    pd, low, high = (share @ np.stack(each) for each in levels)
    return RocCurve(pfa, pd, low, high, np.full(pfa.shape, np.nan), first.unit)


def mask_with_halo(mask: Mask, halo: int) -> Mask:
    """The mask grown by ``halo`` pixels in line and sample (a square neighbourhood)."""
    return np.asarray(ndimage.maximum_filter(mask, 2 * halo + 1, mode="constant"))


def object_scores(score_map: Array, objects: Iterable[TargetObject], halo: int = 0) -> dict[str, float]:
    """Greatest score over each object's pixels and ``halo`` pixels around them.

    Parameters
    ----------
    score_map : (lines, samples), NaN where invalid

    Returns
    -------
    score by object; NaN for an object without a valid pixel.  With a halo the background must be scored by
    :func:`footprint_tiles`, else noise alone looks like detection.
    """
    scores = np.where(np.isnan(score_map), -np.inf, score_map)
    if halo:
        scores = ndimage.maximum_filter(scores, 2 * halo + 1, mode="constant", cval=-np.inf)
    greatest = {o.name: float(scores[o.window][o.part].max(initial=-np.inf)) for o in objects}
    return {name: math.nan if math.isinf(score) else score for name, score in greatest.items()}


def footprint_tiles(score_map: Array, shape: Mask, exclude: Mask | None = None) -> tuple[Array, Index, Index]:
    """Scores under each placement of an object's footprint on the background.

    The image is tiled by the footprint's bounding box, without overlap, so that the placements are separate
    draws; tiles that touch an invalid or an excluded pixel under the footprint are left out.  The greatest score of
    each stands for a false alarm per footprint, not per pixel, beside objects with a halo; the spread of their sums is
    the standard uncertainty of the same sum over the object, with the correlation between neighbouring pixels in it.

    Parameters
    ----------
    score_map : (lines, samples), NaN where invalid
    shape : (h, w) footprint of the object with its halo, cut to its bounding box
    exclude : (lines, samples) True on targets and their guard ring

    Returns
    -------
    scores (n, pixels of the footprint); and the first lines and samples (n,) of the placements
    """
    scores, (h, w) = score_map if exclude is None else np.where(exclude, np.nan, score_map), shape.shape
    refuse(np.any(np.greater(shape.shape, scores.shape)), "roc.footprint", h=h, w=w, shape=scores.shape)
    values = np.lib.stride_tricks.sliding_window_view(scores, shape.shape)[::h, ::w][..., shape]
    rows, columns = np.nonzero(~np.isnan(values).any(axis=-1))
    return values[rows, columns], rows * h, columns * w
