"""A metric: what it is, where it comes from, how it may be judged and how far it may move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from fnmatch import fnmatchcase
from typing import Literal


class Evidence(StrEnum):
    """What moves a value: the prediction, or the pipeline and the collection alone."""

    MODEL = "model"
    PIPELINE = "pipeline"


class Kind(StrEnum):
    """How a value is judged.

    quantity: its interval against a range; exact: it has no sampling error, so that the value decides; test: a
    p-value, against a level and with the power of the test; coverage: 1 or 0, a value inside or outside an
    interval, where 1 is no agreement of two numbers; equivalence: 1, 0 or -1, the outcome of an interval against a
    margin; statistic: a number whose distribution is judged by its own test.
    """

    QUANTITY = "quantity"
    EXACT = "exact"
    TEST = "test"
    COVERAGE = "coverage"
    EQUIVALENCE = "equivalence"
    STATISTIC = "statistic"


Of = Literal["value", "interval", "unit"]
Move = tuple[float, Of]
# A tolerance of an interval needs one; these are for rows without.
_USUAL: tuple[Move, Move] = ((0.1, "interval"), (0.01, "value"))


@dataclass(frozen=True)
class Metric:
    """One metric of the results table.

    Attributes
    ----------
    name : as in the table without what follows "@"; ``*`` stands for what varies (a region, another metric)
    words : what it is, for a reader of a page
    function : what computes it, within the package
    formula : in plain text
    unit : of its value; "" where that is another one's
    low, high : least and greatest value
    agreement : value where both sides are equal; NaN where that is no question
    better : direction of a better result, for metrics that rank
    kind : how it is judged
    interval : kind of its 95 % interval
    tolerance : how far an accepted number may move: of its value, of half its interval, or in its unit; and where
        the row has no interval
    evidence : what moves it
    reference : source of the formula
    example, gives : an expression with the function, and its value; or a command whose rows have it, without a
        value; empty where the example stands in the docstring of the function
    usual : range (of a test: level) by which a row is judged that no campaign plans; it informs
    alternative, departure : of a test, the departure against which it needs 80 % power before it agrees, in words
    short : a few plain words for a sentence, in which ``{product}`` and ``{part}`` (of the spectrum) are filled in
    two_sided : a p-value near 1 says that the uncertainty is too wide, and counts as one near 0 does
    """

    name: str
    words: str
    function: str
    formula: str = ""
    unit: str = "1"
    low: float = -math.inf
    high: float = math.inf
    agreement: float = math.nan
    better: Literal["", "high", "low"] = ""
    kind: Kind = Kind.QUANTITY
    interval: str = "none"
    tolerance: tuple[Move, Move] = _USUAL
    evidence: Evidence = Evidence.MODEL
    reference: str = ""
    example: str = ""
    gives: float = math.nan
    usual: tuple[float, float] | None = None
    alternative: float = math.nan
    departure: str = ""
    two_sided: bool = False
    short: str = ""

    def fits(self, base: str) -> bool:
        """Whether this row is about a metric of that name."""
        return fnmatchcase(base, self.name)


def of_unit(part: float) -> tuple[Move, Move]:
    """A tolerance in the metric's unit."""
    return (part, "unit"), (part, "unit")


def of_value(part: float) -> tuple[Move, Move]:
    """A tolerance as a part of the value."""
    return (part, "value"), (part, "value")
