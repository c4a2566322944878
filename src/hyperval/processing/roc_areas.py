"""Areas under the ROC from rank counts: whole, partial and log-weighted, with their sampling error.

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
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.errors import UsageError
from hyperval.processing.alarm_blocks import AlarmBlocks
from hyperval.processing.intervals import bounded_mean_limits, clopper_pearson
from hyperval.processing.rank_counts import RankCounts
from hyperval.products import AreaEstimate

Array = npt.NDArray[np.float64]

_SAFE = 6.0  # how many times as often the limit without assumptions may be told to miss
_LOST_ENOUGH = 8.0  # targets' worth of area that a variance can be estimated from
# Values of the largest array of a bootstrap.
_CHUNK = 2_000_000


@dataclass(frozen=True)
class RocArea:
    """Which area: P_FA from ``low`` to ``high``, evenly in P_FA or, ``logarithmic``, in its logarithm."""

    low: float = 0.0
    high: float = 1.0
    logarithmic: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.low < self.high <= 1.0 or (self.logarithmic and self.low <= 0.0):
            raise UsageError(f"no range of false-alarm probabilities: {self.low:g} to {self.high:g}")

    def share(self, s: Array) -> Array:
        """g(s): the part of the range in which a target is declared that a share ``s`` of the background tops."""
        x = np.clip(s, self.low, self.high)
        if self.logarithmic:
            return np.asarray(np.log(self.high / x) / np.log(self.high / self.low))
        return np.asarray((self.high - x) / (self.high - self.low))

    def integral(self, s: Array) -> Array:
        """Integral of g from 0 to s."""
        a, b = self.low, self.high
        x = np.clip(s, a, b)
        if self.logarithmic:
            inside = (x * (np.log(b / x) + 1.0) - a * (np.log(b / a) + 1.0)) / np.log(b / a)
        else:
            inside = (b * (x - a) - (x**2 - a**2) / 2.0) / (b - a)
        return np.asarray(np.minimum(s, a) + inside)

    def averaged(self, over: Array, tie: Array) -> Array:
        """Mean of g along a tie that goes from ``over`` to ``over + tie``."""
        flat = tie <= 0.0
        step = np.where(flat, 1.0, tie)
        slanted = (self.integral(over + tie) - self.integral(over)) / step
        return np.where(flat, self.share(over), slanted)


WHOLE = RocArea()
# The areas of the results table; each name states its range.
AREAS = {
    "auc": WHOLE,
    "partial_auc@0..1e-1": RocArea(0.0, 0.1),
    "log_auc@1e-3..1e-1": RocArea(1e-3, 0.1, logarithmic=True),
}
# A background that expects fewer alarms at the low end of a range says nothing of it.
LEAST_EXPECTED_ALARMS = 10.0


def areas_within(n: int) -> dict[str, RocArea]:
    """The areas of :data:`AREAS` whose range ``n`` background scores reach."""
    return {k: a for k, a in AREAS.items() if not a.logarithmic or a.low * n >= LEAST_EXPECTED_ALARMS}


def placements(counts: RankCounts, area: RocArea = WHOLE) -> Array:
    """(K,) V of each different target score."""
    over, tie = _shares(counts)
    return area.averaged(over, tie)


def roc_area(counts: RankCounts, area: RocArea = WHOLE) -> float:
    """The area of the empirical curve, exact with ties.

    Examples
    --------
    >>> from hyperval.processing.rank_counts import counts_of
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
    value = float(weight @ v / m)
    bound = value * (1.0 - value)
    of_targets = float(weight @ (v - value) ** 2 / (m - 1)) if m > 1 else bound
    if n < 2:
        return of_targets / m, bound
    w, times = np.concatenate(_background_parts(counts, area)), np.concatenate([counts.between, counts.ties])
    mean = float(times @ w / n)
    return of_targets / m, float(times @ (w - mean) ** 2 / (n - 1)) / n


def clustered_variance(counts: RankCounts, area: RocArea, blocks: AlarmBlocks) -> float:
    """The part of the background in :func:`area_variance` where it comes in clusters.

    The W_j are summed by block of the image, and the blocks' sums have the variance of
    :meth:`~hyperval.processing.alarm_blocks.AlarmBlocks.variance_of_sum`.  Source of the form: Obuchowski,
    Biometrics 53, 567-578, 1997 (clustered ROC data).
    """
    between, on = _background_parts(counts, area)
    # Between, on, between, on, ..., between: in the order of the scores.
    w = np.repeat(
        np.insert(between, np.arange(1, between.size), on),
        np.insert(counts.between, np.arange(1, between.size), counts.ties),
    )
    n = w.size
    block = blocks.block[blocks.order]
    sums = np.asarray(np.bincount(block, w - w.mean(), minlength=blocks.pixels.size), dtype=float)
    return float(blocks.variance_of_sum(sums[None, :])[0]) / n**2


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
    return np.where(flat, part * single, slanted)


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
    n = int(counts.ties.sum() + counts.between.sum())
    m = int(counts.targets.sum())
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
            of_background = max(of_background, clustered_variance(counts, area, blocks))
            # Few blocks know their scatter badly; by the part of the background in the whole (Satterthwaite).
            share = of_background / max(of_targets + of_background, 1e-300)
            known_by = min(known_by, 1.0 + blocks.degrees_of_freedom / max(share, 1e-6) ** 2)
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
