"""Empirical ROC curves: exact with ties, by pixel or by object, with honest intervals.

A pixel is declared a target when its score lies strictly above the threshold.

A few order statistics of many scores without sorting them all.

Where many background scores lie among few target scores, without sorting the many: curve, area, bootstrap.

False alarms at a stated detection probability, with everything that is uncertain about them.

Areas under the ROC from rank counts: whole, partial and log-weighted, with their sampling error.

Every area is the mean over targets of a function g of s, the share of the background that outscores the target:

    whole          g = 1 - s                                       P_FA from 0 to 1 (Mann-Whitney)
    partial        g = (b - clip(s, a, b))/(b - a)                 mean P_D over P_FA from a to b
    log-weighted   g = ln(b/clip(s, a, b))/ln(b/a)                 the same, evenly in log P_FA

so that one rule gives their variance: s^2(V_i)/m + s^2(W_j)/n with V_i = g(s_i) and W_j the mean over targets of
g'(s_i) [background j outscores target i].  For the whole area it is that of DeLong, DeLong & Clarke-Pearson
(Biometrics 44, 837-845, 1988); for the others its first-order form (Dodd & Pepe, Biometrics 59, 614-623, 2003, have
the restriction to a range of P_FA).  Along a tie g is averaged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.errors import UsageError
from hyperval.model.intervals import bounded_mean_limits, clopper_pearson, mid_p_limits
from hyperval.model.roc import AREAS, WHOLE, RocArea
from hyperval.pixels.alarms import LEAST_EXPECTED_ALARMS, AlarmBlocks
from hyperval.products import AlarmsAtDetection, AreaEstimate, RocCurve

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
Scores = npt.ArrayLike | AlarmBlocks  # the latter know their places, and come in clusters

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


_RANK_BINS = 4096


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
        which, bins = (bins_of(x, low, width, _RANK_BINS) for x in (background, value))
        occupied = np.zeros(_RANK_BINS + 2, bool)
        occupied[bins] = True
        near = occupied.take(which)
    close = background[near]
    left = np.searchsorted(value, close, side="left")
    tied = value[np.minimum(left, value.size - 1)] == close
    ties = np.bincount(left[tied], minlength=value.size)[: value.size]
    between = np.bincount(left[~tied], minlength=value.size + 1)
    # The others lie in bins without a target: all of a bin between the same two.
    count = np.bincount(which[~near], minlength=_RANK_BINS + 2)
    cells = np.flatnonzero(count)
    np.add.at(between, np.searchsorted(bins, cells, side="left"), count[cells])
    return RankCounts(value, targets.astype(np.int64), ties.astype(np.int64), between.astype(np.int64))


def counts_of(target_scores: npt.ArrayLike, background_scores: Scores) -> RankCounts:
    """:func:`rank_counts` of scores of any shape; UsageError where a side is empty or holds NaN."""
    return rank_counts(valid_scores(target_scores, "target"), valid_scores(background_scores, "background"))


def valid_scores(scores: Scores, side: str) -> Array:
    """(n,) scores of any shape; UsageError where there are none or some are NaN."""
    values = scores.scores if isinstance(scores, AlarmBlocks) else np.asarray(scores, dtype=float).ravel()
    missing = int(np.count_nonzero(np.isnan(values)))
    if missing:
        raise UsageError(f"{missing} of {values.size} {side} scores are NaN", mend="leave invalid pixels out")
    if values.size == 0:
        raise UsageError(f"there are no {side} scores", expected="at least one valid score on each side of a ROC")
    return values


STATED_PD = (0.5, 0.9)


def alarms_before_first(target_scores: npt.ArrayLike, background_scores: npt.ArrayLike) -> int:
    """Background pixels that are declared before, or together with, the first pixel of any target.

    The rule of RIT's target detection self-test: the pixels by falling score are read until they meet the target.
    It favours targets of many pixels or pieces, since the luckiest stands for all, and says nothing of the others.
    Source: Snyder et al., IGARSS 2008, II-915.

    Examples
    --------
    >>> alarms_before_first([0.2, 0.7], [0.1, 0.7, 0.9, 0.6])
    2
    """
    best = np.nanmax(np.asarray(target_scores, dtype=float))
    return int(np.count_nonzero(np.asarray(background_scores, dtype=float) >= best))


def alarms_at_detection(
    counts: RankCounts, pd: Sequence[float] = STATED_PD, level: float = 0.95
) -> tuple[AlarmsAtDetection, ...]:
    """Alarms at the highest threshold that declares at least a share ``pd`` of the targets.

    At that threshold as it stands the number of alarms is binomial, and the exact interval of P_FA is that of
    Clopper & Pearson; no alarm at all gives an upper limit like any other number.  The threshold that truly detects
    ``pd`` is known only through the targets: the number of them above it is binomial, so it lies between two of
    their order statistics.  The alarms at these, with the outer limits of Clopper & Pearson, bound the true P_FA;
    both statements at level sqrt(``level``), so that together they hold at ``level`` or more whatever the
    distributions.

    Raises
    ------
    UsageError : a ``pd`` outside (0, 1].
    """
    m = int(counts.targets.sum())
    n = int(counts.ties.sum() + counts.between.sum())
    # Targets, and background scores, at or above each target score; background scores above it.
    reached = np.cumsum(counts.targets[::-1])[::-1]
    at_or_above = np.cumsum((counts.ties + counts.between[1:])[::-1])[::-1]
    above = at_or_above - counts.ties
    each = float(np.sqrt(level))
    tail = (1.0 - each) / 2.0

    def greatest(rank: int) -> int:
        """Place of the ``rank``-th greatest target among the different target scores."""
        return int(np.flatnonzero(reached >= rank)[-1])

    from scipy import stats  # 25 MB with what it loads, which runs without detection do not need

    out = []
    for q in pd:
        if not 0.0 < q <= 1.0:
            raise UsageError(f"a detection probability of {q:g}", expected="above 0, at most 1")
        at = greatest(int(np.ceil(q * m * (1.0 - 1e-12))))
        alarms = int(at_or_above[at])
        fixed = [float(x) for x in clopper_pearson(alarms, n, level)]
        # As for the background in empirical_roc, with the sides exchanged.
        r, s = int(stats.binom.ppf(tail, m, q)), int(stats.binom.isf(tail, m, q)) + 1
        low = float(clopper_pearson(int(above[greatest(r)]), n, each)[0]) if r >= 1 else 0.0
        high = float(clopper_pearson(int(at_or_above[greatest(s)]), n, each)[1]) if s <= m else 1.0
        out.append(
            AlarmsAtDetection(
                q, float(counts.value[at]), alarms, alarms / n, min(low, fixed[0]), max(high, fixed[1]), *fixed
            )
        )
    return tuple(out)


_SAFE = 6.0  # how many times as often the limit without assumptions may be told to miss
_LOST_ENOUGH = 8.0  # targets' worth of area that a variance can be estimated from
# Values of the largest array of a bootstrap.
_CHUNK = 2_000_000


def areas_within(n: int) -> dict[str, RocArea]:
    """The areas of :data:`AREAS` whose range ``n`` background scores reach: the low end expects alarms enough."""
    return {k: a for k, a in AREAS.items() if not a.logarithmic or a.low * n >= LEAST_EXPECTED_ALARMS}


def placements(counts: RankCounts, area: RocArea = WHOLE) -> Array:
    """(K,) V of each different target score."""
    over, tie = _shares(counts)
    return area.averaged(over, tie)


def roc_area(counts: RankCounts, area: RocArea = WHOLE) -> float:
    """The area of the empirical curve, exact with ties.

    Examples
    --------
    >>> from hyperval.pixels.roc import counts_of
    >>> roc_area(counts_of([2.0, 3.0], [0.0, 1.0, 2.5, -1.0]))
    0.875
    """
    return float(counts.targets @ placements(counts, area) / counts.targets.sum())


def area_variance(counts: RankCounts, area: RocArea = WHOLE) -> tuple[float, float]:
    """Sampling variance of the area: the part of the targets and the part of the background.

    With one target or one background score, whose spread nothing tells, the bound A (1 - A) of Birnbaum & Klose
    (Ann. Math. Stat. 28, 933-945, 1957) stands in for that part.
    """
    v, weight = placements(counts, area), counts.targets
    m, n = int(weight.sum()), int(counts.ties.sum() + counts.between.sum())
    value = roc_area(counts, area)
    bound = value * (1.0 - value)
    of_targets = float(weight @ (v - value) ** 2 / (m - 1)) if m > 1 else bound
    if n < 2:
        return of_targets / m, bound
    w, times = np.concatenate(_background_parts(counts, area)), np.concatenate([counts.between, counts.ties])
    mean = float(times @ w / n)
    return of_targets / m, float(times @ (w - mean) ** 2 / (n - 1)) / n


def clustered_variance(counts: RankCounts, area: RocArea, blocks: AlarmBlocks) -> tuple[float, float]:
    """The part of the background in :func:`area_variance` where it comes in clusters, and its degrees of freedom.

    The W_j are summed by block of the image, and the blocks' sums have the variance of
    :meth:`~hyperval.pixels.alarms.AlarmBlocks.variance_of_sum`.  Source of the form: Obuchowski,
    Biometrics 53, 567-578, 1997 (clustered ROC data).
    """
    between, on = _background_parts(counts, area)
    # Between, on, between, on, ..., between: in the order of the scores.
    w = np.repeat(
        np.insert(between, np.arange(1, between.size), on),
        np.insert(counts.between, np.arange(1, between.size), counts.ties),
    )
    sums = np.asarray(np.bincount(blocks.block[blocks.order], w, minlength=blocks.pixels.size), dtype=float)
    variance, dof = blocks.variance_of_sum(sums[None, :])
    return float(variance[0]) / w.size**2, float(dof[0])


def _background_parts(counts: RankCounts, area: RocArea) -> tuple[Array, Array]:
    """W (K + 1,) of background scores between the targets, and (K,) on them."""
    over, tie = _shares(counts)
    weight, m = counts.targets, int(counts.targets.sum())
    # Slope of g across the tie: what one more background score above the target, or level with it, takes away.
    above = _slope(area, over, tie, 1.0)
    level = _slope(area, over, tie, 0.5)
    # Between targets k - 1 and k: above targets 0 .. k - 1; on target k: its half too.
    cumulated = np.concatenate([[0.0], np.cumsum(weight * above)]) / m
    return cumulated, cumulated[:-1] + weight * level / m


def _slope(area: RocArea, over: Array, tie: Array, part: float) -> Array:
    """First-order change of the averaged g when the share above, or (``part`` 1/2) level with, a target grows."""
    flat = tie <= 0.0
    a, b = area.low, area.high
    width = np.log(b / a) if area.logarithmic else b - a
    with np.errstate(divide="ignore"):
        steep = 1.0 / np.maximum(over, 1e-300) if area.logarithmic else np.ones_like(over)
    inside = (over >= a) & (over < b)
    single = np.where(inside, -steep / width, 0.0)
    step = np.where(flat, 1.0, tie)
    ends, mean = area.share(over + tie), area.averaged(over, tie)
    # d/dover and d/dtie of the mean over [over, over + tie]
    slanted = (ends - (area.share(over) if part == 1.0 else mean)) / step
    return np.where(flat, single, slanted)


def logit_interval(
    value: float, variance: float, m: int, n: float, level: float = 0.95, quantile: float | None = None
) -> tuple[float, float]:
    """Interval of an area, symmetric in its logit, with Student's t of the smaller sample or another quantile.

    Where the estimate has no spread, or stands at 0 or 1, the limit is the exact binomial one of min(m, n) trials.
    """
    trials = min(m, n)
    if value <= 0.0 or value >= 1.0 or variance <= 0.0:
        low, high = (float(x) for x in clopper_pearson(round(value * trials), trials, level))
        return min(low, value), max(high, value)
    tail = 0.5 + level / 2.0
    if quantile is None:
        quantile = float(special.stdtrit(trials - 1, tail)) if trials > 1 else float(special.ndtri(tail))
    half = quantile * np.sqrt(variance) / (value * (1.0 - value))
    centre = special.logit(value)
    return float(special.expit(centre - half)), float(special.expit(centre + half))


def interval_of_mean(
    placed: Array, target_variance: float, background_variance: float, n: float, level: float = 0.95
) -> tuple[float, float]:
    """Interval of an area from the placements (m,) of its targets and the two parts of its variance.

    The logit interval; where fewer than 8 targets' worth is lost (won, for a value below 1/2), towards the far end
    at least the limit that the placements give without any assumption: few targets, all found, cannot show the one
    in ten that is not.  That limit is far on the safe side: at a sixth of the confidence (0.70 for 0.95) the truth
    lies beyond it in at most 0.022 of draws (5 to 40 targets, normal and two-mode scores, 1,000 draws each), at
    0.95 in none.  From 8 on the logit interval holds the truth in 0.94 to 0.96 of draws by itself.
    """
    value = float(np.clip(placed.mean(), 0.0, 1.0))
    low, high = logit_interval(value, target_variance + background_variance, placed.size, n, level)
    if min(float(np.sum(1.0 - placed)), float(np.sum(placed))) >= _LOST_ENOUGH:
        return low, high
    least, greatest = bounded_mean_limits(np.clip(placed, 0.0, 1.0), 1.0 - _SAFE * (1.0 - level))
    normal = float(special.ndtri(0.5 + level / 2.0))
    half = normal * np.sqrt(background_variance)
    near = logit_interval(value, target_variance + background_variance, placed.size, np.inf, level, quantile=normal)
    if value > 0.5:
        return max(min(low, value - np.hypot(value - least, half)), 0.0), near[1]
    return near[0], min(max(high, value + np.hypot(greatest - value, half)), 1.0)


def area_estimates(
    counts: RankCounts,
    areas: Mapping[str, RocArea],
    unit: str,
    draws: int,
    rng: np.random.Generator,
    blocks: AlarmBlocks | None = None,
) -> dict[str, AreaEstimate]:
    """Areas by name with 95 % intervals: DeLong's variance by pixel, that of a bootstrap by object.

    ``blocks``: the background with its places, which may come in clusters.
    """
    m, n = int(counts.targets.sum()), int(counts.ties.sum() + counts.between.sum())
    drawn = None
    if unit == "object" and m > 1 and n > 1:
        drawn = bootstrap_areas(counts, list(areas.values()), draws, rng).var(axis=0, ddof=1) * m / (m - 1)
    out = {}
    for i, (name, area) in enumerate(areas.items()):
        placed = np.repeat(placements(counts, area), counts.targets)
        of_targets, of_background = area_variance(counts, area)
        method = "DeLong" if m > 1 else f"one {unit}: the greatest variance there can be"
        if drawn is not None:
            method = f"bootstrap of {m} objects, {draws} draws"
            of_targets = max(float(drawn[i]) - of_background, 0.0)
        known_by = float(n)
        if blocks is not None:
            clustered, dof = clustered_variance(counts, area, blocks)
            of_background = max(of_background, clustered)
            # Few blocks know their scatter badly; by the part of the background in the whole (Satterthwaite).
            share = of_background / max(of_targets + of_background, 1e-300)
            known_by = min(known_by, 1.0 + dof / max(share, 1e-6) ** 2)
        low, high = interval_of_mean(placed, of_targets, of_background, known_by)
        out[name] = AreaEstimate(float(placed.mean()), low, high, method, placed, of_background)
    return out


def pooled_areas(parts: Sequence[Mapping[str, AreaEstimate]], n: int) -> dict[str, AreaEstimate]:
    """Areas of several groups of targets together, each with its own detector, at equal P_FA.

    The pooled curve is the average of the groups' by their numbers of targets, and so are its areas.  The groups
    may share their background, so the standard deviations that it brings are added.
    """
    out = {}
    for name in parts[0] if parts else ():
        if not all(name in p and p[name].placements is not None for p in parts):
            continue
        each = [np.asarray(p[name].placements) for p in parts]
        placed = np.concatenate(each)
        share = np.array([e.size for e in each]) / placed.size
        background = float(share @ np.sqrt([p[name].background_variance for p in parts])) ** 2
        of_targets = float(placed.var(ddof=1)) / placed.size if placed.size > 1 else 0.25
        low, high = interval_of_mean(placed, of_targets, background, n)
        method = f"{placed.size} targets of {len(each)} groups"
        out[name] = AreaEstimate(float(placed.mean()), low, high, method, placed, background)
    return out


def bootstrap_areas(counts: RankCounts, areas: list[RocArea], draws: int, rng: np.random.Generator) -> Array:
    """(draws, A) areas of resampled data: targets and background drawn anew, with replacement.

    The curve depends on the background through its counts between and on the target scores alone, and those of a
    resample are multinomial; the n background scores themselves need not be drawn.
    """
    m, n = int(counts.targets.sum()), int(counts.ties.sum() + counts.between.sum())
    k = counts.value.size
    cells = np.empty(2 * k + 1)
    cells[0::2], cells[1::2] = counts.between / n, counts.ties / n
    out = np.empty((draws, len(areas)))
    step = max(1, _CHUNK // cells.size)
    for first in range(0, draws, step):
        count = min(step, draws - first)
        background = rng.multinomial(n, cells / cells.sum(), size=count) / n
        weight = rng.multinomial(m, counts.targets / m, size=count) / m
        # Share above each target score: everything in later cells.
        later = np.cumsum(background[:, ::-1], axis=1)[:, ::-1]
        over, tie = np.clip(later[:, 2::2], 0.0, 1.0), background[:, 1::2]
        for i, area in enumerate(areas):
            out[first : first + count, i] = np.einsum("dk,dk->d", weight, area.averaged(over, tie))
    return out


def _shares(counts: RankCounts) -> tuple[Array, Array]:
    """(K,) share of the background above each target score, and on it."""
    n = counts.ties.sum() + counts.between.sum()
    above = np.cumsum(counts.between[::-1])[::-1][1:] + np.append(np.cumsum(counts.ties[::-1])[::-1][1:], 0)
    return above / n, counts.ties / n


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
    alarms: Counts
    everything: npt.NDArray[np.bool_]
    greatest: Array
    least: Array
    unbounded: npt.NDArray[np.bool_]
    n_background: int
    level: float


def preset_thresholds(
    background_scores: Scores, pfa: npt.ArrayLike | None = None, *, level: float = 0.95
) -> PresetThresholds:
    """Thresholds of :func:`empirical_roc`; one set serves all targets that are looked for in the same scores.

    ``pfa`` defaults to a logarithmic grid from one alarm in the whole background to 1, which holds the decades.
    """
    blocks = background_scores if isinstance(background_scores, AlarmBlocks) else None
    b = valid_scores(background_scores, "background")
    if pfa is None:
        decades = int(np.ceil(np.log10(max(b.size, 10))))
        grid = 10.0 ** (np.arange(-decades * POINTS_PER_DECADE, 1) / POINTS_PER_DECADE)
        pfa = grid[grid * b.size * (1.0 + 1e-12) >= 1.0]
    p = np.sort(np.atleast_1d(np.asarray(pfa, dtype=float)))
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
        r, s = blocks.rank_limits(p)
    ordered = OrderStatistics(b, np.concatenate([k + 1, r, s]))
    threshold, everything = ordered.greatest(k + 1), k >= b.size
    alarms = np.where(everything, b.size, ordered.above(threshold))
    greatest = np.where(r >= 1, ordered.greatest(np.maximum(r, 1)), np.inf)
    return PresetThresholds(
        p, threshold, alarms, everything, greatest, ordered.greatest(s), s > b.size, int(b.size), level
    )


def empirical_roc(
    target_scores: npt.ArrayLike,
    background_scores: Scores | PresetThresholds,
    pfa: npt.ArrayLike | None = None,
    unit: Literal["pixel", "object"] = "pixel",
    *,
    background_area_km2: float | None = None,
    level: float = 0.95,
) -> RocCurve:
    """Detection probability at the lowest threshold whose empirical false-alarm rate is at most ``pfa``.

    The threshold is the (k+1)-th greatest of the n background scores with k = floor(n pfa), so that at most k
    background pixels lie above it, with ties or without.

    The interval joins two independent uncertainties.  (1) The share of targets above the threshold is binomial:
    mid-P limits (:func:`~hyperval.model.intervals.mid_p_limits`), since a level that is to hold for every P_D
    is void beside the second part anyhow.  (2) The threshold x that truly gives ``pfa`` is known only through the
    background sample: the number of background scores above x is binomial, so x lies between two order
    statistics of the background, at which P_D is read again; where n pfa is too small, no score bounds x from above
    and the lower limit of P_D is 0.  Where the places of the background are known, alarms that come in clusters
    widen that range (:meth:`~hyperval.pixels.alarms.AlarmBlocks.rank_limits`).  The distances of
    both from P_D are added in quadrature on each side (as in Newcombe, Stat. Med. 17, 873-890, 1998).  The true P_D
    rises with P_FA, so limits that do not are widened until they do.  Simulated coverage at 95 % is 0.95 to 0.99,
    tables in docs/statistics.md, and 0.92 where 300 targets stand on 44 alarms that come in clusters; with the first
    part alone it falls below 0.4 for a small background and many targets.  Targets must be independent of each
    other, so count objects, not the pixels of one object.

    Parameters
    ----------
    target_scores, background_scores : any shape; +-inf allowed.  The background may come with its places, or as the
        thresholds that :func:`preset_thresholds` took from it, with all that follows
    pfa : preset false-alarm probabilities in (0, 1]; by default the grid of :func:`preset_thresholds`

    Raises
    ------
    UsageError : no targets, no background, NaN, or a ``pfa`` outside (0, 1].
    """
    t = np.sort(valid_scores(target_scores, "target"))
    at = background_scores
    if not isinstance(at, PresetThresholds):
        at = preset_thresholds(at, pfa, level=level)

    def above(threshold: Array, everything: npt.NDArray[np.bool_]) -> Counts:
        """How many targets lie above the threshold; all of them where ``everything`` is declared, -inf included."""
        return np.where(everything, t.size, t.size - np.searchsorted(t, threshold, side="right"))

    detected = above(at.threshold, at.everything)
    low, high = mid_p_limits(detected, t.size, at.level)
    few, many = above(at.greatest, np.zeros_like(at.everything)), above(at.least, at.unbounded)
    pd = detected / t.size
    # Never inside the binomial limits: what could lie inside them is rounding.
    wide_low = np.clip(pd - np.hypot(pd - low, pd - few / t.size), 0.0, low)
    wide_high = np.clip(pd + np.hypot(high - pd, many / t.size - pd), high, 1.0)
    # A false-alarm probability of one declares everything, whatever the sample.
    lower, upper = _rising(np.where(at.pfa >= 1.0, 1.0, wide_low), wide_high)
    return RocCurve(
        at.pfa, pd, lower, upper, at.threshold, unit, int(t.size), at.n_background, background_area_km2, at.alarms
    )


def with_summary(
    curve: RocCurve,
    target_scores: npt.ArrayLike,
    background_scores: Scores,
    *,
    draws: int = 1000,
    rng: np.random.Generator | None = None,
) -> RocCurve:
    """The curve of these scores with its areas and alarms at stated P_D.

    Parameters
    ----------
    draws, rng : of the bootstrap over objects; by default a generator of seed 0
    """
    blocks = background_scores if isinstance(background_scores, AlarmBlocks) else None
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
