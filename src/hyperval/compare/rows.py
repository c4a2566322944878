"""Rows of one comparison, without its names: a value with its interval, the difference of two, why one was not made.

A comparison is a function of both sides that yields such rows; :func:`named` adds what they are about.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from hyperval.errors import worded
from hyperval.metrics import metric_of
from hyperval.results import Cause, Outcome, Result

Interval = tuple[float, float]
# The metric of a row that stands for a whole comparison which could not be made.
COMPARISON = "comparison"


def row(metric: str, value: float, ends: Sequence[float] | None = None, half: float = math.nan, **more: Any) -> Result:
    """A row without an outcome; what is planned gives it one later.

    Parameters
    ----------
    ends : of its 95 % interval; ``half`` of its width in their place
    more : other fields of :class:`hyperval.results.Result`, such as ``n``, ``reason``, ``about``, and ``unit`` where
        the table of metrics leaves it open
    """
    low, high = ends or (value - half, value + half)
    more = {"unit": metric_of(metric).unit or "1"} | more
    return Result("", "", "", "", metric, float(value), lower=float(low), upper=float(high), **more)


def skip_rows(cause: Cause, reason: str, *metrics: str) -> list[Result]:
    """Planned rows that have no value, with the cause and words; without metrics the whole comparison."""
    names = metrics or (COMPARISON,)
    return [Result("", "", "", "", name, outcome=Outcome.SKIPPED, cause=cause, reason=reason) for name in names]


def said(name: str, /, **values: Any) -> str:
    """What a row says of its value, or of why it has none: the words of a name in ``words.yaml``.

    >>> from hyperval.errors import package_table
    >>> all(worded("compare/words.yaml", name) for name in package_table("compare/words.yaml"))
    True
    """
    return worded("compare/words.yaml", name)(**values)


def skip_as(name: str, /, *metrics: str, **values: Any) -> list[Result]:
    """Rows :func:`skip_rows` for a cause and in words: those of a name in ``words.yaml`` that begins with the cause."""
    return skip_rows(Cause[name.partition(".")[0].upper()], said(name, **values), *metrics)


def with_difference(name: Callable[[str], str], predicted: Result | None, measured: Result | None) -> list[Result]:
    """Rows of the sides there are and, of both, of predicted less measured, whose ``name`` is that of "difference".

    That one is SKIPPED where a side is, with the words of the measured one first.
    """
    if predicted is None or measured is None:
        return [side for side in (predicted, measured) if side is not None]
    for side in (measured, predicted):
        if side.outcome is Outcome.SKIPPED:
            return [predicted, measured, replace(side, metric=name("difference"), evidence=None)]
    (a, *ends), (b, *others) = ((side.value, side.lower, side.upper) for side in (predicted, measured))
    difference = row(name("difference"), a - b, difference_interval(a, ends, b, others), n=measured.n)
    return [predicted, measured, difference]


def named(rows: Iterable[Result], product: str, subject: str, method: str) -> Iterator[Result]:
    """The rows as those of a subject; their campaign is named when all of them are there."""
    return (replace(item, product=product, subject=subject, method=method) for item in rows)


def short_label(value: float) -> str:
    """A short label of a probability: 0.01 is 1e-2.

    Examples
    --------
    >>> short_label(0.01), short_label(2.5e-4)
    ('1e-2', '2.5e-4')
    """
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value / 10.0**exponent:.3g}e{exponent}"


def difference_interval(a: float, a_interval: Sequence[float], b: float, b_interval: Sequence[float]) -> Interval:
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
