"""Shares of intervals that hold, with their own intervals, and whether a share is where it is to lie."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from hyperval.model import clopper_pearson

Key = tuple[str, str, str, str]  # product, subject, what, method
Worlds = Sequence[tuple[float, int]]  # of each world: how many of its intervals hold, and how many it has
Tally = dict[Key, Worlds]
COVERED, REJECTED, FOUND = (0.92, 0.98), (0.03, 0.07), (0.90, 1.0)
# At most one right campaign in twenty finds its model wrong; an interval lies on either side of the truth in 2.5 %.
NOT_MET = ONE_SIDE = (0.0, 0.05)


class Outcome(NamedTuple):
    """Share of comparisons in which something held, with its 95 % interval.

    ``wanted`` is the range in which the share is to lie; ``outcome`` whether its interval lies inside that, outside,
    or across an end of it (undecided).
    """

    product: str
    subject: str
    what: str
    method: str
    share: float
    lower: float
    upper: float
    comparisons: int
    worlds: int
    wanted: tuple[float, float]
    outcome: str


def share_of(worlds: Worlds) -> tuple[float, float, float]:
    """Part of the intervals that hold, and its limits at 95 %: exact ones of as many independent intervals as have
    its variance.

    Intervals of one world move together (bands of a spectrum, objects of one material): the variance is that of a
    ratio over worlds (Cochran, 1977, section 6.4).
    """
    inside, count = np.array(worlds, dtype=float).T
    n = count.sum()
    share = inside.sum() / n
    ratio = ((inside - share * count) ** 2).sum() / n**2
    independent = n * min(share * (1.0 - share) / n / ratio, 1.0) if ratio > 0.0 else float(len(worlds))
    low, high = clopper_pearson(share * independent, independent)
    return float(share), float(low), float(high)


def outcomes(tallies: Iterable[Tally]) -> list[Outcome]:
    """Shares over all batches."""
    total: dict[Key, list[tuple[float, int]]] = defaultdict(list)
    for tally in tallies:
        for key, worlds in tally.items():
            total[key] += worlds
    found = []
    for key, worlds in total.items():
        what = key[2]
        wanted = FOUND if "tilt" in what else REJECTED if "rejects" in what else COVERED
        wanted = NOT_MET if "not met" in what else ONE_SIDE if "its truth" in what else wanted
        share, lower, upper = share_of(worlds)
        inside, outside = wanted[0] <= lower and upper <= wanted[1], upper < wanted[0] or lower > wanted[1]
        outcome = "inside" if inside else "outside" if outside else "undecided"
        comparisons = sum(n for _, n in worlds)
        found.append(Outcome(*key, share, lower, upper, comparisons, len(worlds), wanted, outcome))
    return found
