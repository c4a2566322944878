"""The table of metrics (``metrics.toml``), which comparisons, criteria, baselines, reports, benchmark and pages read.

It also has the tolerance of each accepted number, between what two machines or two builds of the linear-algebra library
differ by and what a change of the science makes (docs/regression.md has both as measured).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Literal, NamedTuple

from pydantic import Field
from pydantic.dataclasses import dataclass

from hyperval.errors import nearest, needed, package_table, worded


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
_USUAL: Mapping[Of, float] = {"interval": 0.1, "value": 0.01}


@dataclass(frozen=True)
class FieldUnit:
    """How a number of a metric is effect in units of the field: factor (number - origin) [unit].

    ``ideal`` : the number where both sides are equal; the metric's agreement where it is None
    """

    unit: str
    factor: float = 1.0
    origin: float = 0.0
    ideal: float | None = None

    def __call__(self, number: float) -> float:
        """The effect [unit]."""
        return self.factor * (number - self.origin)


@dataclass(frozen=True)
class Metric:
    """One metric of the results table: a row of metrics.toml.

    Attributes
    ----------
    section : of the table: spectral, detection, other, sensors
    name : as in the table without what follows "@"; ``*`` stands for what varies (a region, another metric)
    products : of a comparison that have it; none where it is no metric of one, or of any
    behind : products of which it tells, beside what is planned, which way and how far the two sides moved
    words : what it is, for a reader of a page
    function : what computes it, within the package
    formula : in plain text
    unit : of its value; "" where that is another one's
    low, high : least and greatest value
    agreement : value where both sides are equal; NaN where that is no question
    better : direction of a better result, for metrics that rank
    kind : how it is judged
    interval : kind of its 95 % interval
    tolerance : how far an accepted number may move: of its value, of half its interval, or in its unit; what stands
        last is for rows without an interval
    evidence : what moves it
    reference : source of the formula
    example, gives : an expression with the function, and its value; or a command whose rows have it, without a
        value; empty where the example stands in the docstring of the function
    usual : range (of a test: level) by which a row is judged that no campaign plans; it informs
    alternative, departure : of a test, the departure against which it needs 80 % power before it agrees, in words
    effect : how its value, or the size of what a test tests, is told in units of the field
    short : a few plain words for a sentence, in which ``{product}`` and ``{part}`` (of the spectrum) are filled in
    two_sided : a p-value near 1 says that the uncertainty is too wide, and counts as one near 0 does
    """

    section: str
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
    tolerance: Mapping[Of, float] = Field(default_factory=lambda: _USUAL)
    evidence: Evidence = Evidence.MODEL
    reference: str = ""
    example: str = ""
    gives: float = math.nan
    usual: tuple[float, float] | None = None
    alternative: float = math.nan
    departure: str = ""
    two_sided: bool = False
    effect: FieldUnit | None = None
    short: str = ""
    products: Sequence[str] = ()
    behind: Sequence[str] = ()

    @property
    def is_bare(self) -> bool:
        """Whether no range decides it: a statistic, or a quantity without an interval."""
        return self.kind is Kind.STATISTIC or (self.kind is Kind.QUANTITY and self.interval == "none")


def base_name(metric: str) -> str:
    """A metric's name without the point it is taken at."""
    return metric.partition("@")[0]


@cache
def table() -> Mapping[str, Metric]:
    """Every metric by name; plain names before patterns."""
    sections = tomllib.loads((resources.files(__package__) / "metrics.toml").read_text("utf-8"))
    rows = [Metric(section=section, **entries) for section, listed in sections.items() for entries in listed]
    rows.sort(key=lambda m: "*" in m.name)
    if len({m.name for m in rows}) != len(rows):
        raise AssertionError("two metrics of one name")
    return {m.name: m for m in rows}


@cache
def metric_of(name: str) -> Metric:
    """The row of a metric; a name with ``*`` or ``?`` of its own gets the first that it could mean.

    Raises
    ------
    UsageError : the table has no such metric.

    Examples
    --------
    >>> metric_of("pd_difference@1e-2").agreement
    0.0
    """
    base, metrics = base_name(name), table()
    if name.endswith("_fraction") and name not in metrics:  # of a pooled gate
        return metrics["*_fraction"]
    if name.endswith("_change") and base != name:  # of a number at a point
        return metrics["*_change"]
    if base in metrics:
        return metrics[base]
    row = next((m for m in metrics.values() if fnmatchcase(base, m.name)), None)
    if row is None and set(base) & set("*?"):
        row = next((m for m in metrics.values() if fnmatchcase(m.name, base)), None)
    near = "" if row else "".join(nearest(base, metrics))
    return needed(row, "metric.near" if near else "metric.unknown", name=name, near=near)


def _names(kind: str) -> dict[str, str]:
    return dict(package_table("metrics/names.yaml")[kind])


def product_words(product: str) -> str:
    """A product in a sentence.

    Examples
    --------
    >>> product_words("toa_reflectance")
    'top-of-atmosphere reflectance'
    """
    return _names("products").get(product, product)


def plain_words(metric: str, product: str) -> str:
    """What a metric of a product is about, for a sentence: "level of the radiance in the VNIR".

    Examples
    --------
    >>> plain_words("p_value_shape", "radiance")
    'shape of the radiance'
    """
    base, product = base_name(metric), product_words(product)
    part = _names("parts").get(base.rpartition("_")[2], "")
    return metric_of(metric).short.format(product=product, part=part) or f"{product} {base}"


def foreign(name: str, product: str) -> str:
    """Why a product of a comparison has no metric of that name, in words; empty where it may have.

    A name with ``*`` or ``?`` may mean several and is not looked at.

    Examples
    --------
    >>> foreign("median_difference_ratio_window", "radiance")
    "no part of the spectrum is 'window'; one of windows, vnir, swir1, swir2, absorption"
    """
    base = base_name(name)
    if set(base) & set("*?"):
        return ""
    row = metric_of(name)
    if row.products and product not in row.products:
        return f"{base!r} is a metric of {' or '.join(row.products)}, not of {product}"
    parts, part = _names("parts"), base.removeprefix(row.name.removesuffix("*"))
    fits = part in parts or not row.name.endswith("_ratio_*")
    return "" if fits else f"no part of the spectrum is {part!r}; one of {', '.join(parts)}"


def explained(names: Iterable[str]) -> list[tuple[str, str]]:
    """(metric, what it is), each once, by name.

    Examples
    --------
    >>> explained(["sensor_gain@550", "sensor_gain@800"])[0][1][:33]
    'measured over predicted radiance,'
    >>> [name for name, words in explained(table()) if "{" in words]
    []
    """
    return [(base, metric_of(base).words) for base in sorted({base_name(name) for name in names})]


def facts(m: Metric) -> dict[str, str]:
    """What the table says of a metric, in the words of ``facts.yaml``; empty where it says nothing.

    Examples
    --------
    >>> facts(metric_of("pd_difference"))["range"], facts(metric_of("z"))["range"]
    ('-1 to 1', '')
    >>> facts(metric_of("bias_ratio"))["effect in"]
    '% of the product'
    """
    return {name: worded("metrics/facts.yaml", name)(m=m, span=_span) for name in package_table("metrics/facts.yaml")}


_LISTED = ("unit", "range", "when both sides are equal", "judged as", "95 % interval", "moves with", "tolerance")
HEADER = ("metric", *_LISTED, "words")


def listed() -> Iterator[tuple[str, ...]]:
    """A line for each metric, in the columns of :data:`HEADER`."""
    return ((m.name, *(facts(m)[column] for column in _LISTED), m.words) for m in table().values())


def _span(low: float, high: float) -> str:
    if math.isinf(high):
        return "" if math.isinf(low) else f"{low:g} and more"
    return f"{low:g} to {high:g}"


def entry(m: Metric) -> list[str]:
    """The paragraph of one metric for the page of the documentation."""
    lines = [f"### `{m.name}`", "", f"{m.words[0].upper()}{m.words[1:]}.", ""]
    return [*lines, *(f"- {name}: {text}" for name, text in facts(m).items() if text), ""]


DIGITS = 6  # significant digits that are kept
_ROUNDING = 0.51 * 10.0 ** (1 - DIGITS)
_SMALLEST = 1e-9  # below this a difference of numbers of order 1 is rounding


class Tolerance(NamedTuple):
    """A tolerance: of the accepted value, of the half width of its 95 % interval, or in the metric's own unit."""

    tolerance: float
    of: Of

    def width(self, accepted: float, half_width: float | None = None) -> float:
        """Largest difference from ``accepted`` that is tolerated, in the metric's unit."""
        scale = {"value": abs(accepted), "interval": half_width or 0.0, "unit": 1.0}[self.of]
        return max(self.tolerance * scale, _ROUNDING * abs(accepted), _SMALLEST)


def default_tolerance(metric: str, half_width: float | None = None) -> Tolerance:
    """The tolerance of a metric whose baseline does not name one, as the table of metrics has it."""
    moves = [Tolerance(size, reference) for reference, size in metric_of(metric).tolerance.items()]
    return moves[0] if half_width or moves[0].of != "interval" else moves[-1]
