"""Shares of intervals that hold, with their own intervals, and whether a share is where it is to lie."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np

from hyperval.model import clopper_pearson

Key = tuple[str, str, str, str]  # product, subject, what, method


@dataclass
class Counts:
    """Intervals that hold and intervals at all, summed over worlds, with the squares and products of the two.

    Intervals of one world move together (bands of a spectrum, objects of one material), so that the sums of squares
    are needed to say how well the share is known.
    """

    inside: float = 0.0
    count: float = 0.0
    inside_squared: float = 0.0
    product: float = 0.0
    count_squared: float = 0.0
    worlds: int = 0

    def add(self, values: Iterable[float]) -> None:
        """The intervals of one world: 1 where it holds, 0 where not, NaN where there is none."""
        finite = [v for v in values if np.isfinite(v)]
        if finite:
            k, n = sum(finite), float(len(finite))
            self += Counts(k, n, k * k, k * n, n * n, 1)

    def __iadd__(self, other: Counts) -> Counts:
        for name, value in asdict(other).items():
            setattr(self, name, getattr(self, name) + value)
        return self

    @property
    def share(self) -> float:
        """Part of the intervals that hold."""
        return self.inside / self.count

    def limits(self) -> tuple[float, float]:
        """Limits of the share at 95 %: exact ones of as many independent intervals as have its variance.

        The variance is that of a ratio over worlds (Cochran, 1977, section 6.4).
        """
        s, n = self.share, self.count
        plain = s * (1.0 - s) / n
        ratio = (self.inside_squared - 2.0 * s * self.product + s * s * self.count_squared) / n**2
        independent = n * min(plain / ratio, 1.0) if ratio > 0.0 else float(self.worlds)
        low, high = clopper_pearson(s * independent, independent)
        return float(low), float(high)


Tally = dict[Key, Counts]
COVERED, REJECTED, FOUND = (0.92, 0.98), (0.03, 0.07), (0.90, 1.0)
# At most one right campaign in twenty finds its model wrong; an interval lies on either side of the truth in 2.5 %.
NOT_MET = ONE_SIDE = (0.0, 0.05)


@dataclass(frozen=True)
class Outcome:
    """Share of comparisons in which something held, with its 95 % interval.

    ``wanted`` is the range in which the share is to lie.
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

    @property
    def outcome(self) -> str:
        """Whether the interval of the share lies inside the range that is wanted, outside, or across an end."""
        low, high = self.wanted
        if low <= self.lower and self.upper <= high:
            return "inside"
        return "outside" if self.upper < low or self.lower > high else "undecided"


def outcomes(tallies: Iterable[Tally]) -> list[Outcome]:
    """Shares over all batches."""
    total: Tally = {}
    for tally in tallies:
        for key, counts in tally.items():
            total.setdefault(key, Counts())
            total[key] += counts
    return [_outcome(key, counts) for key, counts in total.items()]


def _outcome(key: Key, counts: Counts) -> Outcome:
    what = key[2]
    wanted = FOUND if "tilt" in what else REJECTED if "rejects" in what else COVERED
    wanted = NOT_MET if "not met" in what else ONE_SIDE if "its truth" in what else wanted
    return Outcome(*key, counts.share, *counts.limits(), int(counts.count), counts.worlds, wanted)
