"""The one results table: every report, gate and export is a view of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from operator import attrgetter
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    import pandas as pd

from hyperval.errors import T
from hyperval.metrics import Evidence, Kind, metric_of


class Outcome(StrEnum):
    """What a comparison concludes; ``none`` where nothing was planned.

    Attributes
    ----------
    word, letter, of_one, of_several, element : how it is said: in a word, by a letter, of one criterion, of several,
        and as an element of JUnit
    """

    word: str
    letter: str
    of_one: str
    of_several: str
    element: str
    AGREES = "agrees", "met", "M", "is met", "are met", ""
    DISAGREES = "disagrees", "not met", "N", "is not met", "are not met", "failure"
    UNDECIDED = "undecided", "inconclusive", "I", "is inconclusive", "are inconclusive", "skipped"
    SKIPPED = "skipped", "not run", "S", "was not run", "were not run", "skipped"
    ERROR = "error", "error", "E", "ended in an error", "ended in an error", "error"
    NONE = "none", "without a range", "", "", "", ""

    def __new__(cls, value: str, *said: str) -> Outcome:
        """The member of a value, with how it is said."""
        member = str.__new__(cls, value)
        member._value_ = value
        member.word, member.letter, member.of_one, member.of_several, member.element = said
        return member


# The one order: where several rows or criteria are one entry, the first of these counts that one of them has.
WORST_FIRST = tuple(map(Outcome, ("error", "disagrees", "undecided", "skipped", "agrees", "none")))
SEPARATOR = " | "  # in the key of a row
EVERY = ("*", "all subjects", "all objects")  # subjects of rows about all of them


class Role(StrEnum):
    """Whether a row decides, or informs."""

    GATE = "gate"
    INFORM = "inform"


class Cause(StrEnum):
    """Why a row has its outcome: the one list, each in the words that a page shows."""

    NONE = ""
    # disagrees
    TOO_WIDE = "the stated uncertainty is too wide"
    # undecided
    WIDE_INTERVAL = "the interval reaches beyond the range"
    NEVER = "can never be met: the interval is wider than the range"
    NO_INTERVAL = "the value has no interval"
    NO_POWER = "can never be met: the test has too little power"
    COVERAGE = "inside an interval, which is coverage and not agreement"
    MULTIPLICITY = "not below its share of the campaign's level"
    NOT_JUDGED = "a statistic judged by its own test"
    # skipped
    NO_PREDICTION = "not predicted"
    NO_OBSERVATION = "not measured"
    NO_DATA = "data not on this machine"
    NO_BANDS = "no comparable band"
    TEXTURE = "texture of the region counts as noise"
    NO_UNCERTAINTY = "no stated uncertainty"
    CIRCULAR = "one side was derived from the other"
    FEW_PIXELS = "too few pixels"
    HEAVY_TAILS = "tails too heavy for a sampling interval"
    FEW_ALARMS = "background too small for that rate"
    BEYOND_CURVE = "a curve does not cover that range"
    VACUOUS = "the interval accepts nearly any value"
    NO_GROUND_AREA = "ground area unknown"
    NOT_POSITIVE = "a value is not positive"
    REFUSED = "a part of the campaign could not run"
    AFTER_FAILURE = "an earlier check failed"
    NO_VALUE = "no point has a value"
    ONE_RUN = "in one run only"
    # error
    ABSENT = "planned but absent"
    NOT_A_NUMBER = "not a number"
    BAD_INTERVAL = "the interval does not contain the value"
    BROKEN = "ended in an error"


@dataclass(frozen=True)
class Effect:
    """The size of what a row that is judged by other means is about: of a test, of 1 or 0 by an interval.

    Attributes
    ----------
    value, lower, upper : in the numbers of its own kind, with the 95 % interval
    accepted : level of the test -> range that chance alone stays in with it; None where no range is known
    detectable : sizes to either side that would have been rejected with 80 % probability
    decides : whether the row agrees only where the whole interval lies in the range; not where the two are of
        different laws, such as an interval for independent objects beside a range for objects that share errors
    """

    value: float
    lower: float = math.nan
    upper: float = math.nan
    accepted: Callable[[float], tuple[float, float]] | None = None
    detectable: tuple[float, float] = (math.nan, math.nan)
    decides: bool = True


@dataclass(frozen=True)
class Result:
    """One row.

    ``lower`` and ``upper`` bound ``value`` at 95 % unless the metric says otherwise.  ``limit_low`` and
    ``limit_high`` are the range that was planned, NaN on a side without one.  ``detectable`` is the smallest error
    of its kind that would have disagreed with 80 % probability.  ``evidence`` is that of the metric unless given.
    ``reason`` is for people: nothing reads it.  The columns from ``effect`` on tell a row with an outcome in units of
    the field (:attr:`hyperval.metrics.Metric.effect`): the size of what it is about with its 95 % interval, the range
    accepted for it, the sizes to either side that would have disagreed with 80 % probability, and the size where both
    sides are equal; NaN where a metric has no such size.  ``before`` is what a row that tells of a change starts from:
    its own number as the campaign states it, of a sensitivity the gap between the sides.  ``p_value`` is
    that of a test; ``set_after`` tells a range that was set after its own data were seen, ``subjects_seen`` whether
    budget and settings were "fitted" on the subject or it is "unseen" ("" where the campaign does not say); ``about``
    is what the effect of a test is made of, and no column.

    Raises
    ------
    UsageError : a metric that the table of metrics does not have.
    """

    campaign: str
    product: str
    subject: str
    method: str
    metric: str
    value: float = math.nan
    unit: str = "1"
    band_nm: float = math.nan
    lower: float = math.nan
    upper: float = math.nan
    n: int | None = None
    limit_low: float = math.nan
    limit_high: float = math.nan
    role: Role = Role.INFORM
    evidence: Evidence | None = None
    outcome: Outcome = Outcome.NONE
    cause: Cause = Cause.NONE
    detectable: float = math.nan
    reason: str = ""
    effect: float = math.nan
    effect_unit: str = ""
    effect_lower: float = math.nan
    effect_upper: float = math.nan
    accepted_low: float = math.nan
    accepted_high: float = math.nan
    detectable_low: float = math.nan
    detectable_high: float = math.nan
    ideal: float = math.nan
    p_value: float = math.nan
    set_after: bool = False
    subjects_seen: str = ""
    before: float = math.nan
    about: Effect | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        usual = metric_of(self.metric).evidence
        object.__setattr__(self, "evidence", self.evidence or usual)

    @property
    def key(self) -> str:
        """ "product | subject | method | metric", and the band where there is one: its name in files of numbers."""
        band = [f"{self.band_nm:g} nm"] if self.per_band else []
        return SEPARATOR.join([self.product, self.subject, self.method, self.metric, *band])

    @property
    def gates(self) -> bool:
        """Whether the row decides."""
        return self.role is Role.GATE

    @property
    def planned(self) -> bool:
        """Whether an outcome was asked for."""
        return self.outcome is not Outcome.NONE

    @property
    def shortfall(self) -> float:
        """How many times too uncertain the row is to agree ever; 1 and less where some value would agree.

        Of a quantity the width of its interval over that of its range, of logarithms where 1 is agreement; of a
        size, whose range begins at its least value, the upper half over the range; of a test what it could find
        over what it is asked to find.  NaN where there is no such question.

        Examples
        --------
        >>> limits = {"limit_low": -0.1, "limit_high": 0.1}
        >>> Result("", "radiance", "", "", "bias_ratio", 0.0, lower=-0.2, upper=0.2, **limits).shortfall
        2.0
        >>> name = "median_abs_difference_ratio_windows"
        >>> Result("", "radiance", "", "", name, 0.1, lower=0.05, upper=0.2, limit_high=0.0).shortfall
        inf
        """
        metric, low, high = metric_of(self.metric), self.limit_low, self.limit_high
        if metric.kind is Kind.TEST:
            return self.detectable / metric.alternative
        if metric.kind is not Kind.QUANTITY:
            return math.nan
        if not low > -math.inf and metric.low > -math.inf and metric.high == math.inf:
            return (self.upper - self.value) / (high - metric.low) if high > metric.low else math.inf
        if metric.agreement == 1.0 and low > 0.0 and self.lower > 0.0:
            return math.log(self.upper / self.lower) / math.log(high / low)
        return (self.upper - self.lower) / (high - low)

    @property
    def never_met(self) -> bool:
        """Whether it is a criterion that no value would have met, since what is known is too uncertain for it."""
        return self.gates and self.cause in (Cause.NEVER, Cause.NO_POWER)

    @property
    def per_band(self) -> bool:
        """Whether the row is about one band."""
        return math.isfinite(self.band_nm)


_NAMES = [f.name for f in fields(Result) if f.compare and f.name != "band_nm"]
COLUMNS = (*_NAMES[:4], "band_nm", *_NAMES[4:])
_KINDS = {"n": "Int64", "role": str, "evidence": str, "outcome": str, "cause": str}


def grouped(items: Iterable[T], key: Callable[[T], Any]) -> dict[Any, list[T]]:
    """Items in lists by a key, as they come."""
    groups: dict[Any, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def of_campaign(rows: Iterable[Result], campaign: str) -> list[Result]:
    """The rows as those of a campaign: what makes them does not know its name."""
    return [replace(row, campaign=campaign) for row in rows]


class ResultTable(list[Result]):
    """A list of results with the views that the writers need."""

    def where(self, **equal: Any) -> ResultTable:
        """The rows whose named fields equal the given values."""
        return ResultTable(r for r in self if all(getattr(r, k) == v for k, v in equal.items()))

    def frame(self) -> pd.DataFrame:
        """The table in the column order of the output contract."""
        import pandas as pd  # 70 MB, not wanted before the results are there

        return pd.DataFrame([attrgetter(*COLUMNS)(r) for r in self], columns=list(COLUMNS)).astype(_KINDS)

    def exit_code(self, *, strict: bool = False) -> int:
        """The exit code of the contract: 1 a gate disagrees or is in error, 5 no gate was decided, 0 otherwise.

        Parameters
        ----------
        strict : undecided and skipped gates give 1, too
        """
        outcomes = {r.outcome for r in self if r.gates}
        broken = any(r.outcome is Outcome.ERROR for r in self)
        if broken or Outcome.DISAGREES in outcomes or (strict and outcomes & {Outcome.UNDECIDED, Outcome.SKIPPED}):
            return 1
        return 0 if Outcome.AGREES in outcomes else 5


def split_key(key: str) -> tuple[str, str, str, str]:
    """Product, subject, method and metric of a row's key, without the band of a single one; ValueError when it is none.

    >>> split_key("radiance | a | b | 6S | bias_ratio"), split_key("radiance | a | 6S | z | 500 nm")
    (('radiance', 'a | b', '6S', 'bias_ratio'), ('radiance', 'a', '6S', 'z'))
    """
    product, first, rest = key.partition(SEPARATOR)
    parts = rest.rsplit(SEPARATOR, 2 + key.endswith(" nm"))
    if not first or len(parts) < 3:
        raise ValueError(f"{key!r} is not 'product | subject | method | metric'")
    return product, parts[0], parts[1], parts[2]


def row_name(row: Result) -> str:
    """Subject, method, metric and band in one line."""
    return " ".join(filter(None, row.key.split(SEPARATOR)[1:]))


_MIN_WIDTH = 1e-3  # half width of an interval, as a part of the value


@dataclass(frozen=True)
class Pair:
    """The same comparison in two runs; None where one has it not."""

    a: Result | None
    b: Result | None

    @property
    def either(self) -> Result:
        """The row of one of them, for its names."""
        return self.a or cast(Result, self.b)  # a pair is made from at least one row

    @property
    def name(self) -> str:
        """What is compared."""
        return f"{self.either.product} {row_name(self.either)}"

    @property
    def gates(self) -> bool:
        """Whether the row decides something in either run."""
        return any(r is not None and r.gates for r in (self.a, self.b))

    @property
    def difference(self) -> float:
        """B minus A; NaN where one has no value."""
        return self.b.value - self.a.value if self.a and self.b else math.nan

    @property
    def verdict_changed(self) -> bool:
        """Whether the outcome differs; a gating row that one run lacks has changed too."""
        return self.a.outcome != self.b.outcome if self.a and self.b else self.gates

    @property
    def is_same(self) -> bool:
        """Whether both runs have it with the same value and outcome."""
        return bool(self.a and self.b) and not self.size and not self.verdict_changed

    @property
    def half_width(self) -> float:
        """Of the wider interval; NaN where neither has one.

        An interval of next to no width counts as a thousandth of the value: rounding is no news.

        >>> a, b = (Result("c", "radiance", "s", "m", "p_value_full", value) for value in (0.84, 1.5e-4))
        >>> Pair(a, b).half_width, round(Pair(a, b).size, 4)  # sorted by size, which is no number of half intervals
        (nan, 0.9998)
        """
        halves = [(r.upper - r.lower) / 2 for r in (self.a, self.b) if r]
        return max((max(h, _MIN_WIDTH * self._value) for h in halves if 0 < h < math.inf), default=math.nan)

    @property
    def _value(self) -> float:
        return max(*(abs(r.value) for r in (self.a, self.b) if r), 1e-12)  # less is rounding

    @property
    def size(self) -> float:
        """Difference over the half width of the wider interval; over the value where there is none; 0 if equal.

        Infinite where one alone has a value, or a finite one.

        >>> key = "c", "covariance", "s", "m", "background_tail_dof"
        >>> def sizes(*values):
        ...     a, b = (Result(*key, x, lower=4.0, upper=math.inf) for x in values)
        ...     return Pair(a, b).size, Pair(b, a).size
        >>> sizes(8.0, 10.0), sizes(8.0, math.nan), sizes(8.0, math.inf)  # an open interval is no scale
        ((0.2, 0.2), (inf, inf), (inf, inf))
        >>> sizes(math.nan, math.nan), sizes(math.inf, math.inf)
        ((0.0, 0.0), (0.0, 0.0))
        """
        if not self.a or not self.b or repr(self.a.value) == repr(self.b.value):
            return 0.0
        scale = self._value if math.isnan(self.half_width) else self.half_width
        return abs(self.difference) / scale if math.isfinite(self.difference) else math.inf


def paired(a: ResultTable, b: ResultTable) -> list[Pair]:
    """Rows of two tables by what they compare, in the order of the first; of rows alike the n-th meets the n-th.

    Two single campaigns are compared whatever their names; folders of several by campaign.
    """
    single = all(len({row.campaign for row in table}) <= 1 for table in (a, b))
    first, second = _keyed(a, single), _keyed(b, single)
    return [Pair(first.get(key), second.get(key)) for key in dict.fromkeys([*first, *second])]


def _keyed(table: ResultTable, single: bool) -> dict[tuple[Any, ...], Result]:
    out, count = dict[tuple[Any, ...], Result](), Counter[tuple[Any, ...]]()
    for row in table:
        key = ("" if single else row.campaign, row.key)
        out[*key, count[key]] = row
        count[key] += 1
    return out
