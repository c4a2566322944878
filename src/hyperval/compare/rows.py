"""Rows of one comparison: what they share, both sides next to each other, and why one is not made."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.metrics import Evidence, metric_of
from hyperval.results import Cause, Effect, Outcome, Result

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Interval = tuple[float, float]
# The metric of a row that stands for a whole comparison which could not be made.
COMPARISON = "comparison"


class Valued(NamedTuple):
    """A value and its 95 % interval."""

    value: float
    interval: Interval


class Lack(NamedTuple):
    """Why a side has no value."""

    cause: Cause
    reason: str


@dataclass(frozen=True)
class RowMaker:
    """Fills in what the rows of one comparison share; their campaign is named when all of them are there."""

    product: str
    subject: str
    method: str

    def row(
        self,
        metric: str,
        value: float,
        interval: Interval | None = None,
        *,
        half: float = math.nan,
        unit: str = "",
        band_nm: float = math.nan,
        n: int | None = None,
        detectable: float = math.nan,
        evidence: Evidence | None = None,
        reason: str = "",
        about: Effect | None = None,
    ) -> Result:
        """A row without an outcome; what is planned gives it one later.

        Parameters
        ----------
        half : half of its interval's width, in place of the interval
        unit : where the table of metrics leaves it open
        """
        low, high = interval or (value - half, value + half)
        return Result(
            "", self.product, self.subject, self.method, metric, float(value), unit or metric_of(metric).unit or "1",
            float(band_nm), float(low), float(high), n, evidence=evidence, detectable=float(detectable),
            reason=reason, about=about,
        )  # fmt: skip

    def skipped(self, cause: Cause, reason: str, *metrics: str) -> list[Result]:
        """Planned rows that have no value, with the cause and words; without metrics the whole comparison."""
        row = Result("", self.product, self.subject, self.method, COMPARISON, outcome=Outcome.SKIPPED, cause=cause,
                     reason=reason)  # fmt: skip
        return [replace(row, metric=metric, evidence=None) for metric in metrics or (COMPARISON,)]

    def side_by_side(
        self,
        names: Sequence[str],
        predicted: Valued | Lack | None,
        measured: Valued | Lack | None,
        n: int | None = None,
        reason: str = "",
    ) -> list[Result]:
        """Rows of both sides and of their difference.

        SKIPPED where a side lacks its value, the difference with the words of the measured side first; none of a
        side that is None.
        """
        rows: list[Result] = []
        for name, side, count, words in ((names[0], predicted, None, ""), (names[1], measured, n, reason)):
            if isinstance(side, Lack):
                rows += self.skipped(*side, name)
            elif side is not None:
                rows.append(self.row(name, *side, n=count, reason=words))
        if isinstance(predicted, Valued) and isinstance(measured, Valued):
            interval = difference_interval(*predicted, *measured)
            return [*rows, self.row(names[2], predicted.value - measured.value, interval, n=n)]
        if predicted is None or measured is None:
            return rows
        lack = next(side for side in (measured, predicted) if isinstance(side, Lack))
        return rows + self.skipped(*lack, names[2])


def comparison(product: str) -> Callable[[Callable[..., Iterator[Result]]], Callable[..., list[Result]]]:
    """Makes a comparison of a function that yields the rows of two sides.

    ``rows(make, predicted, observed, ...)`` becomes ``compare(predicted, observed, *, subject, method, ...)``: the
    rows, or one SKIPPED row that says which of the sides is None.
    """

    def of(rows: Callable[..., Iterator[Result]]) -> Callable[..., list[Result]]:
        @wraps(rows)
        def compare(
            predicted: Any, observed: Any, *, subject: str, method: str, product: str = product, **options: Any
        ) -> list[Result]:
            make = RowMaker(product, subject, method)
            if predicted is not None and observed is not None:
                return list(rows(make, predicted, observed, **options))
            missing = [name for name, side in (("prediction", predicted), ("observation", observed)) if side is None]
            cause = Cause.NO_PREDICTION if predicted is None else Cause.NO_OBSERVATION
            return make.skipped(cause, f"no {product} of {subject} in the {' and in the '.join(missing)}")

        # What help shows: the two sides, then names; the maker of rows is made here.
        own = inspect.signature(compare, follow_wrapped=False)
        _, *sides = inspect.signature(rows).parameters.values()
        options = [p.replace(kind=p.KEYWORD_ONLY) for p in sides[2:]]
        shown = [*sides[:2], own.parameters["subject"], own.parameters["method"], *options]
        setattr(compare, "__signature__", own.replace(parameters=shown))  # noqa: B010
        return compare

    return of


def scientific(value: float) -> str:
    """A short label of a probability: 0.01 is 1e-2.

    Examples
    --------
    >>> scientific(0.01), scientific(2.5e-4)
    ('1e-2', '2.5e-4')
    """
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value / 10.0**exponent:.3g}e{exponent}"


def difference_interval(a: float, a_interval: Interval, b: float, b_interval: Interval) -> Interval:
    """Interval of a - b from the separate intervals of two independent estimates.

    L = a - b - sqrt((a - l_a)^2 + (u_b - b)^2), U = a - b + sqrt((u_a - a)^2 + (b - l_b)^2).
    Source: Newcombe, Stat. Med. 17, 873-890, 1998, method 10; Zou & Donner, Stat. Med. 27, 1693-1702, 2008.

    Examples
    --------
    >>> low, high = difference_interval(0.8, (0.7, 0.9), 0.5, (0.5, 0.5))
    >>> round(low, 6), round(high, 6)
    (0.2, 0.4)
    """
    low = a - b - math.hypot(a - a_interval[0], b_interval[1] - b)
    high = a - b + math.hypot(a_interval[1] - a, b - b_interval[0])
    return low, high
