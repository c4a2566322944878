"""Shares of background above each target, what a detector is ranked by, and ranks with their sets.

All detectors see the same pixels, so blocks of the background and objects are resampled for all of them at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import special, stats

from hyperval.model import AREAS, zero_count_upper_limit
from hyperval.pixels import LEAST_EXPECTED_ALARMS, AlarmBlocks, interval_of_mean

Array = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]


@dataclass(frozen=True)
class BlockCounts:
    """Background pixels above and level with each object's score, block by block.

    P looks (an object through the filter of one target spectrum), D detectors, K blocks.

    Attributes
    ----------
    detectors : names, in the order of the second dimension
    over, tie : (P, D, K) background pixels above the object's score, and equal to it
    pixels : (K,) background pixels of each block
    item : (P,) number of the object on the ground that is looked at
    group : name -> looks of a subject or of a pool
    density_km2 : background pixels on a square kilometre; NaN when the ground area is not known
    """

    detectors: tuple[str, ...]
    over: Counts
    tie: Counts
    pixels: Counts
    item: npt.NDArray[np.intp]
    group: Mapping[str, Sequence[int]]
    density_km2: float = float("nan")

    @property
    def n(self) -> int:
        """Background pixels."""
        return int(self.pixels.sum())

    @property
    def orders(self) -> list[int]:
        """(D,) number of the order in which each detector puts the pixels; those that order alike share it.

        Told by the counts of every look: two detectors that agree in all blocks about all objects.
        """
        seen: dict[bytes, int] = {}
        columns = [self.over[:, d].tobytes() + self.tie[:, d].tobytes() for d in range(len(self.detectors))]
        return [seen.setdefault(column, len(seen)) for column in columns]

    def shares(self, weights: Array | None = None) -> tuple[Array, Array]:
        """Share of the background above each look's score and level with it, each (P, D) or (P, D, R).

        Parameters
        ----------
        weights : (K, R) how often each block is drawn; None: once
        """
        if weights is None:
            return self.over.sum(axis=2) / self.n, self.tie.sum(axis=2) / self.n
        total = self.pixels @ weights
        flat = (-1, self.pixels.size)
        shape = (*self.over.shape[:2], weights.shape[1])
        return (
            (self.over.reshape(flat) @ weights / total).reshape(shape),
            (self.tie.reshape(flat) @ weights / total).reshape(shape),
        )


def counts_by_block(scores: Array, background: AlarmBlocks) -> tuple[Counts, Counts]:
    """(P, K) background scores above, and equal to, each of the scores (P,), in each block."""
    falling, place = np.unique(-scores, return_inverse=True)
    above, reached = (background.counts(x) for x in (-falling, np.nextafter(-falling, -np.inf)))
    return above[place], (reached - above)[place]


LOG_AREA = "log_auc@1e-3..1e-1"
PD_OF_FAR = 0.5


@dataclass(frozen=True)
class Measure:
    """One metric.

    Attributes
    ----------
    name, title : in the table, and on the page
    of_look : the part each look has in the metric, from (over, tie); the metric is their mean.  None: the quantile
        of false alarms at P_D = 0.5
    better : whether more or less of it is better
    least_pfa : P_FA that the background must resolve for it; 0: any
    observed : name of the metric in the rows of one observed side
    """

    name: str
    title: str
    of_look: Callable[[Array, Array], Array] | None
    better: Literal["high", "low"]
    least_pfa: float
    observed: str

    def known_from(self, n: int) -> bool:
        """Whether ``n`` background pixels resolve it (10 expected alarms)."""
        return self.least_pfa * n >= LEAST_EXPECTED_ALARMS or self.least_pfa == 0.0


def detected_at(pfa: float) -> Callable[[Array, Array], Array]:
    """1 where the object lies above the threshold that lets at most ``pfa`` of the background through."""
    return lambda over, tie: np.asarray(over + tie <= pfa * (1.0 + 1e-9), dtype=float)


MEASURES: Mapping[str, Measure] = {
    m.name: m
    for m in (
        Measure("auc", "AUC", AREAS["auc"].averaged, "high", 0.0, "auc_measured"),
        Measure(
            LOG_AREA, "log-weighted AUC, P_FA 1e-3 to 1e-1", AREAS[LOG_AREA].averaged, "high", 1e-3,
            "log_auc_measured@1e-3..1e-1",
        ),
        Measure("pd@1e-2", "P_D at P_FA 1e-2", detected_at(1e-2), "high", 1e-2, "pd@1e-2"),
        Measure("pd@1e-3", "P_D at P_FA 1e-3", detected_at(1e-3), "high", 1e-3, "pd@1e-3"),
        Measure("far@pd0.5", "false alarms per km2 at P_D 0.5", None, "low", 0.0, "far_measured@pd0.5"),
    )
}  # fmt: skip


def pfa_at_detection(over: Array, tie: Array, weight: Array, pd: float = PD_OF_FAR) -> Array:
    """(D, R) P_FA at the highest threshold that finds a part ``pd`` of the looks.

    Parameters
    ----------
    over, tie : (P, D, R) shares of the background
    weight : (P, R) how often each look is drawn

    Examples
    --------
    >>> over = np.array([[[0.1]], [[0.01]], [[0.2]]])  # share of the background above each of three objects
    >>> pfa_at_detection(over, np.zeros((3, 1, 1)), np.ones((3, 1))).item()
    0.1
    """
    s = over + tie
    order = np.argsort(s, axis=0, kind="stable")
    drawn = np.take_along_axis(np.broadcast_to(weight[:, None, :], s.shape), order, axis=0).cumsum(axis=0)
    reached = np.argmax(drawn >= pd * drawn[-1] * (1.0 - 1e-9), axis=0)
    return np.asarray(np.take_along_axis(np.take_along_axis(s, order, axis=0), reached[None], axis=0)[0])


def measured(measure: Measure, over: Array, tie: Array, weight: Array) -> Array:
    """(D, R) the metric in draws of looks and background; of false alarms the P_FA, not yet per km2."""
    if measure.of_look is None:
        return pfa_at_detection(over, tie, weight)
    return mean_of(measure.of_look(over, tie), weight)


def mean_of(parts: Array, weight: Array) -> Array:
    """(D, R) weighted mean over looks of their parts (P, D, R), the weights (P, R)."""
    return np.asarray(np.einsum("pdr,pr->dr", parts, weight) / weight.sum(axis=0))


def goodness(measure: Measure, values: Array, n: int) -> Array:
    """The metric so that more is better; of P_FA minus its logarithm, no less than half a pixel of ``n``."""
    if measure.better == "high":
        return values
    return np.asarray(-np.log10(np.maximum(values, 0.5 / n)))


LEVEL = 0.95
_CHUNK_VALUES = 4_000_000  # of the largest array of a pass over draws


@dataclass(frozen=True)
class RankedDetectors:
    """Detectors on one group of objects by one metric; arrays are (D,).

    Attributes
    ----------
    value, lower, upper : the metric and its 95 % interval
    rank : 1 for the best; equals share the best of their ranks, detectors that order alike count as one
    rank_lower, rank_upper : 95 % confidence set of the rank
    first : share of draws in which the detector is the best, equals counted alike
    objects : objects on the ground
    distinct : detectors that do not order the pixels alike
    orders : whether so few objects can order detectors at all
    """

    value: Array
    lower: Array
    upper: Array
    rank: npt.NDArray[np.int64]
    rank_lower: npt.NDArray[np.int64]
    rank_upper: npt.NDArray[np.int64]
    first: Array
    objects: int
    distinct: int
    orders: bool


def fewest_objects(detectors: int) -> int:
    """Objects from which on two of so many detectors can be told apart at all.

    Where one finds every object better than another, the exact sign test of m objects has the p-value 2^(1 - m); it
    must reach 5 % divided by the number of rivals (Bonferroni).
    """
    return int(np.ceil(1.0 - np.log2((1.0 - LEVEL) / max(detectors - 1, 1))))


def rank_sets(values: Array, draws: Array, objects: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Least and greatest rank (D,) of each detector that the draws do not refute, at 95 % for each.

    A detector has as many above it as are better than it by more than c standard deviations of the paired
    difference, and likewise below; c is the 95 % point of the greatest of these ratios over its rivals in the draws
    about their mean, widened as Student's t of ``objects`` - 1 is wider than the normal law.
    Source: Mogstad, Romano, Shaikh & Wilhelm, Rev. Econ. Stud. 91, 476-518, 2024 (marginal confidence sets).

    Parameters
    ----------
    values : (D,) goodness, more is better
    draws : (D, R) the same in paired resamples

    Examples
    --------
    >>> first, last = rank_sets(np.array([0.9, 0.5]), np.array([[0.9, 0.8, 0.95], [0.5, 0.4, 0.6]]), 20)
    >>> first, last
    (array([1, 2]), array([1, 2]))
    """
    count = values.size
    low, high = np.ones(count, np.int64), np.full(count, count, np.int64)
    if objects < 2:
        return low, high
    tail = 0.5 + LEVEL / 2.0
    wider = float(stats.t.ppf(tail, objects - 1) / special.ndtri(tail) * np.sqrt(objects / (objects - 1)))
    for j in range(count):
        rivals = np.delete(np.arange(count), j)
        gap = values[rivals] - values[j]
        drawn = draws[rivals] - draws[j]
        sd = drawn.std(axis=1, ddof=1)
        moving = sd > 1e-12
        ratio = np.abs(drawn[moving] - drawn[moving].mean(axis=1, keepdims=True)) / sd[moving, None]
        c = float(np.quantile(ratio.max(axis=0), LEVEL)) * wider if moving.any() else 0.0
        # Alike in all draws and yet apart: decided by the number of objects alone, which the caller has asked.
        limit = np.where(moving, c * sd, 1e-9)
        low[j] += int(np.sum(gap > limit))
        high[j] -= int(np.sum(-gap > limit))
    return low, high


def ranked(
    counts: BlockCounts, looks: list[int], measure: Measure, *, draws: int, rng: np.random.Generator
) -> RankedDetectors:
    """Detectors on the objects of some looks: objects and blocks of the background drawn anew, for all at once.

    Detectors that order all pixels alike count as one, and share rank and set.

    Examples
    --------
    >>> from hyperval.scoreboard.ranks import MEASURES
    >>> over = np.tile(np.array([[[0], [30]]]), (9, 1, 1))  # 9 objects, 2 detectors, 1 block of background
    >>> counts = BlockCounts(("a", "b"), over, 0 * over, np.array([100]), np.arange(9), {})
    >>> r = ranked(counts, list(range(9)), MEASURES["auc"], draws=50, rng=np.random.default_rng(0))
    >>> r.rank, r.first
    (array([1, 2]), array([1., 0.]))
    """
    order = np.array(counts.orders)
    one_of = np.array([int(np.argmax(order == k)) for k in range(int(order.max()) + 1)])
    item = np.unique(counts.item[looks], return_inverse=True)[1]
    m, n = int(item.max()) + 1, counts.n
    cells = np.ix_(np.array(looks), one_of)
    part = BlockCounts(
        tuple(counts.detectors[d] for d in one_of), counts.over[cells],
        counts.tie[cells], counts.pixels, item, {}, counts.density_km2,
    )  # fmt: skip
    over, tie = part.shares()
    value = measured(measure, over[..., None], tie[..., None], np.ones((len(looks), 1)))[:, 0]
    both, still = _drawn(part, measure, m, draws, rng)
    best, drawn = goodness(measure, value, n), goodness(measure, both, n)
    enough = m >= fewest_objects(value.size)
    low, high = rank_sets(best, drawn, m) if enough else (np.ones(value.size, int), np.full(value.size, value.size))
    lower, upper = _limits(part, measure, value, both, still, m)
    rank = np.array([1 + np.sum(best > x + 1e-12) for x in best], dtype=np.int64)
    first = np.mean(drawn >= drawn.max(axis=0) - 1e-12, axis=1)
    return RankedDetectors(
        value[order], lower[order], upper[order], rank[order], np.minimum(low, rank)[order],
        np.maximum(high, rank)[order], first[order], m, value.size, enough,
    )  # fmt: skip


def _drawn(
    part: BlockCounts, measure: Measure, objects: int, draws: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """(D, R) the metric with objects and blocks drawn anew, and with blocks alone."""
    blocks, looks = part.pixels.size, part.item.size
    step = max(1, _CHUNK_VALUES // (looks * len(part.detectors)))
    both: list[Array] = []
    still: list[Array] = []
    for first in range(0, draws, step):
        size = min(step, draws - first)
        weights = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=size).T.astype(float)
        taken = rng.multinomial(objects, np.full(objects, 1.0 / objects), size=size).T[part.item].astype(float)
        over, tie = part.shares(weights)
        parts = None if measure.of_look is None else measure.of_look(over, tie)
        for out, weight in ((both, taken), (still, np.ones_like(taken))):
            out.append(pfa_at_detection(over, tie, weight) if parts is None else mean_of(parts, weight))
    return np.concatenate(both, axis=1), np.concatenate(still, axis=1)


def _limits(
    part: BlockCounts, measure: Measure, value: Array, both: Array, still: Array, objects: int
) -> tuple[Array, Array]:
    """95 % interval of each detector's metric.

    Means of parts between 0 and 1: the logit interval with both variances, no narrower than what is known of a
    bounded mean.  False alarms: percentiles of the draws, and above no alarm at all the exact limit.
    """
    if measure.of_look is None:
        low, high = np.quantile(both, [0.025, 0.975], axis=1)
        return np.minimum(low, value), np.maximum(np.maximum(high, value), zero_count_upper_limit(part.n))
    over, tie = part.shares()
    parts = measure.of_look(over, tie)
    lows, highs = [], []
    for d in range(value.size):
        of_object = np.bincount(part.item, parts[:, d]) / np.bincount(part.item)
        spread = float(of_object.var(ddof=1)) / objects if objects > 1 else 0.25
        low, high = interval_of_mean(of_object, spread, float(still[d].var(ddof=1)), part.n)
        lows.append(min(low, float(value[d])))
        highs.append(max(high, float(value[d])))
    return np.array(lows), np.array(highs)
