"""Change of a number over time, from one value a day."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from hyperval.errors import UsageError
from hyperval.results import Outcome

FEWEST = 3


@dataclass(frozen=True)
class Drift:
    """Change in a year.

    Attributes
    ----------
    per_year, lower, upper : least-squares slope and its 95 % interval [unit of the values per year]
    scatter : standard deviation of the days about the line
    n : days
    """

    per_year: float
    lower: float
    upper: float
    scatter: float
    n: int

    def outcome(self, low: float, high: float) -> Outcome:
        """The interval against an accepted range."""
        if low <= self.lower and self.upper <= high:
            return Outcome.AGREES
        return Outcome.DISAGREES if self.upper < low or self.lower > high else Outcome.UNDECIDED


def drift(years: npt.ArrayLike, values: npt.ArrayLike) -> Drift:
    """Slope of values (n,) over times (n,) [years] with Student's interval from their scatter about the line.

    Errors that all days share, such as that of the calibration, cancel in it; those of single days show as scatter,
    whatever was stated of them.  Source: Draper & Smith, Applied Regression Analysis, 1998, 1.4.

    Raises
    ------
    UsageError : fewer than three days, or all at one time.

    Examples
    --------
    >>> found = drift([0.0, 1.0, 2.0], [0.0, 0.01, 0.02])
    >>> round(found.per_year, 6), round(found.upper - found.lower, 6)
    (0.01, 0.0)
    """
    t, y = np.asarray(years, dtype=float), np.asarray(values, dtype=float)
    if t.size < FEWEST or np.ptp(t) == 0.0:
        raise UsageError(f"a drift of {t.size} days", expected=f"{FEWEST} days or more, at different times")
    centred = t - t.mean()
    slope = float(centred @ y / (centred @ centred))
    residual = y - y.mean() - slope * centred
    scatter = math.sqrt(float(residual @ residual) / (t.size - 2))
    half = float(stats.t.ppf(0.975, t.size - 2)) * scatter / math.sqrt(float(centred @ centred))
    return Drift(slope, slope - half, slope + half, scatter, int(t.size))
