"""Outcomes: an interval against the accepted range, or a test against its level and power, as a campaign plans them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np
import scipy
from pydantic import Field, model_validator

from hyperval.compare.rows import COMPARISON, said
from hyperval.config import Model
from hyperval.errors import UsageError, nearest, refuse
from hyperval.metrics import Kind, base_name, metric_of, product_words
from hyperval.model.intervals import Z95, clopper_pearson
from hyperval.results import EVERY, Cause, Effect, Outcome, Result, Role

_CHI2_SLIP = 100.0


class Gate(Model):
    """One planned comparison.

    Attributes
    ----------
    product : product of the rows
    metric : metric, ``*`` and ``?`` allowed; "pd_difference" also stands for "pd_difference@1e-2"
    subjects : subject patterns; each must be met by at least one row
    method : method pattern
    bands_nm : lowest and highest band centre, for per-band metrics [nm]
    at_most, at_least, within : the accepted range; exactly one, save that a pooled gate on a 0/1 metric needs none
    fraction_at_least : makes it a pooled gate: this share of all matching rows must meet the limit, and one
        row of its own tells the share
    gate : False for informational rows
    chosen_after, before : True where the range was set after its own data were seen, and what it was before
    reason : why this is, or is not, a gate
    """

    product: Literal[
        "radiance", "snr", "reflectance", "toa_reflectance", "covariance", "classification", "scores", "roc",
        "abundance",
    ]  # fmt: skip
    metric: str = Field(
        min_length=1,
        description="as in results.csv (hyperval metrics lists them); * and ? allowed; without @P: at every P",
    )
    subjects: tuple[str, ...] = Field(
        ("*",), min_length=1, description="names or patterns with * and ?; each must match a row"
    )
    method: str = Field("*", description="name or pattern, such as cem/object")
    bands_nm: tuple[float, float] | None = Field(None, description="for metrics by band: band centres from, to [nm]")
    at_most: float | None = Field(None, description="the accepted range: one of at_most, at_least, within")
    at_least: float | None = None
    within: tuple[float, float] | None = None
    fraction_at_least: float | None = Field(
        None, gt=0.0, le=1.0, description="share of all matching rows that must meet the limit, judged together"
    )
    gate: bool = Field(True, description="false: informational")
    chosen_after: bool = Field(
        False, description="true: set after the data of this campaign were seen; the report states it"
    )
    before: str = Field("", description="with chosen_after: the earlier range")
    reason: str = Field(min_length=1, description="why the range, or why it is informational")

    @model_validator(mode="after")
    def _check_can_fail(self) -> Gate:
        """Refuse gates without a limit, and limits that no value can break."""
        try:
            self._refuse_slips()
        except UsageError as error:
            raise ValueError(" ".join(str(error).split())) from error
        return self

    def _refuse_slips(self) -> None:
        stated = [name for name in ("at_most", "at_least", "within") if getattr(self, name) is not None]
        refuse(len(stated) > 1, "gate.limits", names=" and ".join(stated))
        refuse(not stated and self.fraction_at_least is None, "gate.none")
        for name in ("within", "bands_nm"):
            ends = getattr(self, name)
            refuse(ends is not None and not ends[0] < ends[1], "gate.empty", name=name, ends=ends)
        refuse(self.chosen_after != bool(self.before), "gate.before")
        metric, limit, (floor, ceiling) = metric_of(self.metric), self.limit_text, self.limits
        unlimited, bounded = floor <= metric.low and ceiling >= metric.high, math.isfinite(metric.low)
        ends = (metric.low, metric.high)
        refuse(unlimited, "gate.all" if bounded else "gate.ever", metric=self.metric, ends=ends, limit=limit)
        # A ratio to the collected value may be larger than 1, but a limit of 100 % or more is a slip of the pen.
        relative = (metric.agreement == 0.0 and "difference_ratio" in metric.name) or metric.name == "bias_ratio"
        refuse(relative and max(abs(x) for x in self.limits if math.isfinite(x)) >= 1.0, "gate.percent", limit=limit)
        slip = metric.name.startswith("chi2_reduced") and _CHI2_SLIP <= ceiling < math.inf
        refuse(slip, "gate.reduced", limit=limit)
        refuse(metric.kind is Kind.TEST and self.at_least is None, "gate.level", metric=self.metric)

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest accepted value; a pooled gate without a limit wants 1."""
        if self.within is not None:
            return self.within
        if self.at_most is not None:
            return -math.inf, self.at_most
        return (self.at_least if self.at_least is not None else 1.0), math.inf

    @property
    def limit_text(self) -> str:
        """The limit in words."""
        low, high = self.limits
        one_end = f"at least {low:g}" if math.isinf(high) else f"at most {high:g}"
        return one_end if self.within is None else f"within {low:g} to {high:g}"

    @property
    def role(self) -> Role:
        """Whether its rows decide."""
        return Role.GATE if self.gate else Role.INFORM

    def row_for(self, subject: str, outcome: Outcome, cause: Cause, reason: str) -> Result:
        """The row of a planned comparison that was not made."""
        names = "", self.product, subject, self.method, self.metric
        return Result(*names, outcome=outcome, role=self.role, cause=cause, reason=reason)

    def matches(self, row: Result) -> bool:
        """True for the rows this gate is about, and for skipped comparisons that would have held them.

        >>> row = Result("", "roc", "lawn", "cem/pixel", "pd_difference@1e-2")
        >>> def matches(metric, *names):
        ...     return Gate(product="roc", metric=metric, subjects=names, within=(-0.1, 0.1), reason="r").matches(row)
        >>> [matches(f"pd_difference{point}", "*") for point in ("", "@1e-2", "@1e-1")]
        [True, True, False]
        >>> matches("pd_difference", "court*"), matches("pd_difference", "court*", "la*")
        (False, True)
        """
        if row.product != self.product or not fnmatchcase(row.method, self.method):
            return False
        is_named = any(fnmatchcase(name, self.metric) for name in (row.metric, base_name(row.metric)))
        is_inside = self.bands_nm is None or self.bands_nm[0] <= row.band_nm <= self.bands_nm[1]
        is_compared = row.metric == COMPARISON or (is_named and is_inside)
        return is_compared and any(fnmatchcase(row.subject, pattern) for pattern in self.subjects)


_NAMED = 6  # rows that a message lists
_SLACK = 1e-9  # of a value: rounding is no breach of its own interval
INTERVALS = 0.05  # level of the intervals of all criteria together
# A comparison that lacks one side altogether was planned for something that is not there: under a gate an error.
_NOT_THERE = (Cause.NO_PREDICTION, Cause.NO_OBSERVATION, Cause.NO_BANDS)
Judgement = tuple[Outcome, Cause]


def judge_rows(rows: Iterable[Result], gates: Sequence[Gate]) -> list[Result]:
    """The rows with every planned comparison judged.

    Call it once, on all rows of a campaign: the levels of its tests are shared out among them.  A row that several
    gates cover stands once for each.  A row that no gate covers and whose metric has a usual range is judged by
    that, and informs.  A subject pattern that no row meets gives an ERROR row, for ``gate: false`` too: nothing
    planned goes missing.  A pooled gate adds a row METRIC_fraction with the share and its Clopper-Pearson interval.

    >>> rows = [Result("", "radiance", "lawn", "", "p_value_full", 1e-9)]
    >>> together = Gate(product="radiance", metric="p_value_full", at_least=0.01, fraction_at_least=0.5, reason="r")
    >>> [str(judge_rows(rows, gates)[0].outcome) for gates in ([], [together])]  # usual level, or all rows together
    ['disagrees', 'none']
    """
    rows = list(rows)
    covering = [[gate for gate in gates if gate.matches(row)] for row in rows]
    out: list[Result] = []
    for row, about in zip(rows, covering, strict=True):
        alone = [_judge_by_gate(row, gate) for gate in about if gate.fraction_at_least is None]
        out += alone or [row if about else _judge_by_usual_range(row)]
    for gate in gates:
        covered = [row for row, about in zip(rows, covering, strict=True) if any(g is gate for g in about)]
        out += _unmatched_rows(rows, {row.subject for row in covered}, gate)
        out += _pooled_row(covered, gate)
    return share_levels(out)


def mark_fitted(
    rows: Sequence[Result], fitted_on: Sequence[str], pools: Mapping[str, Sequence[str]] = {}
) -> list[Result]:
    """The rows with whether budget and settings were fitted on their subjects: names, or patterns with * and ?.

    What is about several subjects is unseen where all of them are; ``pools`` : subjects of those that have a name.

    Raises
    ------
    UsageError : a name that no row has.

    Examples
    --------
    >>> rows = [Result("c", "roc", name, "cem/object", "pd_difference@1e-2") for name in ("a", "b", "both")]
    >>> [row.subjects_seen for row in mark_fitted(rows, ["a"], {"both": ["a", "b"]})]
    ['fitted', 'unseen', 'fitted']
    """
    subjects = dict.fromkeys(row.subject for row in rows)
    for name in fitted_on:
        unknown = not any(fnmatchcase(subject, name) for subject in subjects)
        refuse(unknown, "gate.fitted", name=name, known=", ".join(list(subjects)[:_NAMED]))

    def fitted(subject: str) -> bool:
        named = subject, *subject.split(", "), *pools.get(subject, ())
        return subject in EVERY or any(fnmatchcase(s, name) for name in fitted_on for s in named)

    kinds = {subject: "fitted" if fitted(subject) else "unseen" for subject in subjects}
    return [replace(row, subjects_seen=kinds[row.subject]) for row in rows] if fitted_on else list(rows)


def compare_with_range(lower: float, upper: float, low: float, high: float) -> Outcome:
    """An interval inside a range agrees, outside of it disagrees, else the comparison is undecided."""
    if low <= lower and upper <= high:
        return Outcome.AGREES
    return Outcome.DISAGREES if upper < low or lower > high else Outcome.UNDECIDED


def outcome_of(row: Result, low: float, high: float) -> Judgement:
    """What a row concludes about the range ``low`` to ``high``, with the cause.

    An interval inside the range agrees, outside it disagrees, else the comparison is undecided; a value without an
    interval is undecided, unless its metric has no sampling error.  A test disagrees below its level ``low`` and
    agrees above it where it had 80 % power against the departure of its metric.
    """
    metric = metric_of(row.metric)
    if row.outcome in (Outcome.SKIPPED, Outcome.ERROR):
        return row.outcome, row.cause
    if math.isnan(row.value):
        return Outcome.ERROR, Cause.NOT_A_NUMBER
    slack = _SLACK * max(1.0, abs(row.value))
    if row.lower > row.upper or row.value < row.lower - slack or row.value > row.upper + slack:
        return Outcome.ERROR, Cause.BAD_INTERVAL
    if metric.kind is Kind.TEST:
        return _test_outcome(row, low)
    if metric.is_bare:
        return Outcome.UNDECIDED, Cause.NOT_JUDGED if metric.kind is Kind.STATISTIC else Cause.NO_INTERVAL
    if metric.kind is Kind.EQUIVALENCE:
        return {1.0: Outcome.AGREES, -1.0: Outcome.DISAGREES}.get(row.value, Outcome.UNDECIDED), Cause.NONE
    ends = (row.lower, row.upper) if metric.kind is Kind.QUANTITY else (row.value, row.value)
    if any(map(math.isnan, ends)):
        return Outcome.UNDECIDED, Cause.NO_INTERVAL
    outcome = compare_with_range(*ends, low, high)
    if metric.kind is Kind.COVERAGE and outcome is Outcome.AGREES:
        return Outcome.UNDECIDED, Cause.COVERAGE
    if outcome is not Outcome.UNDECIDED:
        return outcome, Cause.NONE
    never = replace(row, limit_low=low, limit_high=high).shortfall > 1.0
    return Outcome.UNDECIDED, Cause.NEVER if never else Cause.WIDE_INTERVAL


def tail_probability(row: Result) -> float:
    """The p-value of a test, of both tails where its metric counts both; of an interval that of both sides equal.

    The end of the interval on the side of equality is taken for the 97.5 % point of a normal law, of ratios in the
    logarithm; of Student's with n - 1 degrees of freedom where the interval is by that.

    Examples
    --------
    >>> round(tail_probability(Result("", "radiance", "", "", "p_value_full", 0.9999)), 6)
    0.0002
    >>> round(tail_probability(Result("", "covariance", "", "", "noise_ratio", 1.2, lower=1.0, upper=1.5)), 6)
    0.05
    >>> of_five = Result("", "abundance", "", "", "area_bias_observed", 2.0, lower=1.0, upper=3.0, n=5)
    >>> round(tail_probability(of_five), 4)  # P(|t| > 2 x 2.776)
    0.0051
    """
    metric, value = metric_of(row.metric), row.value
    if metric.kind is Kind.TEST:
        return min(2.0 * min(value, 1.0 - value), 1.0) if metric.two_sided else value
    equal, end = metric.agreement, row.lower if value > metric.agreement else row.upper
    if math.isinf(metric.high) and equal == 1.0 and min(value, end) > 0.0:
        equal, value, end = 0.0, math.log(value), math.log(end)
    if value == end:
        return float(value == equal)
    dof = (row.n or 0) - 1 if "Student" in metric.interval else 0
    law = scipy.stats.t(dof) if dof > 0 else scipy.stats.norm
    return 2.0 * float(law.sf(law.isf(0.025) * abs(value - equal) / abs(end - value)))


def _test_outcome(row: Result, level: float) -> Judgement:
    metric = metric_of(row.metric)
    if tail_probability(row) < level:
        return Outcome.DISAGREES, Cause.TOO_WIDE if metric.two_sided and row.value > 0.5 else Cause.NONE
    if not row.detectable <= metric.alternative:
        return Outcome.UNDECIDED, Cause.NO_POWER
    return Outcome.AGREES, Cause.NONE


def share_levels(rows: Sequence[Result]) -> list[Result]:
    """The rows told as effects, with the levels of tests of one role and of intervals of criteria shared out (Holm).

    Of m tests at level a, the k-th smallest p-value is compared with a/(m - k + 1), and once one is not below, the
    larger ones are not either; then all are right together with probability 1 - a where the model is right.
    An interval outside its range has to be off equality by as much besides, which a wide range asks for anyway.
    Source: Holm, Scand. J. Stat. 6, 65-70, 1979.
    """
    out, shares = list(rows), {}
    families: dict[tuple[Role, float], list[int]] = {}
    for i, row in enumerate(out):
        metric = metric_of(row.metric)
        distance = math.isfinite(row.lower + row.upper + metric.agreement)
        if metric.kind is Kind.TEST and math.isfinite(row.value) and math.isfinite(row.limit_low):
            families.setdefault((row.role, row.limit_low), []).append(i)
        elif metric.kind is Kind.QUANTITY and row.role is Role.GATE and distance:
            families.setdefault((row.role, INTERVALS), []).append(i)
    for (_, level), members in families.items():
        order = sorted(members, key=lambda i: tail_probability(out[i]))
        kept, share = False, level
        for place, i in enumerate(order):
            part = level / (len(order) - place)
            share = share if kept else part
            kept = kept or tail_probability(out[i]) >= part
            shares[i] = share
            if kept and out[i].outcome is Outcome.DISAGREES:
                why = _join_words(f"its share of the level is {part:.2g}, among {len(order)} criteria", out[i].reason)
                out[i] = replace(out[i], outcome=Outcome.UNDECIDED, cause=Cause.MULTIPLICITY, reason=why)
    return [with_effect(row, shares.get(i, math.nan)) for i, row in enumerate(out)]


def detectable_departures(row: Result, low: float, high: float) -> tuple[float, float]:
    """Smallest departures from agreement, below and above it, whose interval would lie outside the range.

    With 80 % probability: of a value that agrees at a (0 of a difference, 1 of a ratio) with an interval of half
    width h on the side of the limit L: |L - a| + h (1 + 0.842/1.960).  An end cut by the range of the metric,
    such as that of a size at 0, says nothing of the width: the other half stands for it.  NaN where no interval or
    no limit is known.
    """
    metric = metric_of(row.metric)
    if metric.kind is not Kind.QUANTITY or math.isnan(metric.agreement) or math.isnan(row.upper - row.lower):
        return math.nan, math.nan
    reach = 1.0 + float(scipy.special.ndtri(0.8)) / Z95
    below, above = row.value - row.lower, row.upper - row.value
    if row.lower <= metric.low:
        below = max(below, above)
    elif row.upper >= metric.high:
        above = max(below, above)
    return (
        max(metric.agreement - low, 0.0) + above * reach if math.isfinite(low) else math.nan,
        max(high - metric.agreement, 0.0) + below * reach if math.isfinite(high) else math.nan,
    )


def with_effect(row: Result, level: float = math.nan) -> Result:
    """A row with an outcome in units of the field: its effect, the range and the detectable sizes.

    The range of a test is what chance alone stays in at its level, so that its size itself stands against the range
    where it disagrees; it agrees only where the whole interval of that size, if that is of the same law, lies in it.

    Parameters
    ----------
    level : of a test, its part of the campaign's level

    >>> with_effect(Result("", "radiance", "lawn", "", "p_value_full", 0.03)).p_value
    0.03
    """
    metric, unit, about = metric_of(row.metric), metric_of(row.metric).effect, row.about
    row = replace(row, about=None, p_value=row.value if metric.kind is Kind.TEST else math.nan)
    if unit is None or not row.planned or math.isnan(row.value):
        return row
    about = about or (_quantity_effect(row) if metric.kind is Kind.QUANTITY else None)
    if about is None:
        return row
    tested = metric.kind is not Kind.TEST or math.isfinite(level)
    low, high = about.accepted(level) if about.accepted and tested else (math.nan, math.nan)
    outside = about.decides and (about.lower < low or about.upper > high)
    if outside and row.outcome is Outcome.AGREES:
        row = replace(row, outcome=Outcome.UNDECIDED, cause=Cause.WIDE_INTERVAL)
    effect, lower, upper, below, above = map(unit, (about.value, about.lower, about.upper, *about.detectable))
    ideal = metric.agreement if unit.ideal is None else unit.ideal
    return replace(
        row, effect=effect, effect_lower=lower, effect_upper=upper, ideal=unit(ideal),
        effect_unit=unit.unit.format(product=product_words(row.product)),
        accepted_low=unit(low), accepted_high=unit(high), detectable_low=below, detectable_high=above,
    )  # fmt: skip


def _quantity_effect(row: Result) -> Effect:
    """A quantity as its own effect, which the range of its row has decided already."""
    metric, limits = metric_of(row.metric), (row.limit_low, row.limit_high)
    below, above = detectable_departures(row, *limits)
    below = math.nan if metric.agreement - below < metric.low else metric.agreement - below  # no value is that small
    return Effect(row.value, row.lower, row.upper, lambda _: limits, (below, metric.agreement + above), decides=False)


def detectable_share(n: int, least: float) -> float:
    """Least part of ``n`` rows amiss that puts the exact interval of their share below ``least`` in 80 % of cases.

    NaN where none would do.

    Examples
    --------
    >>> round(detectable_share(100, 0.9), 3)
    0.199
    """
    count = int(np.count_nonzero(clopper_pearson(np.arange(n + 1), n)[1] < least))  # the fewest good that would do
    if count in (0, n + 1):
        return 1.0 if count else math.nan
    return 1.0 - float(scipy.stats.beta.ppf(0.2, count, n - count + 1))


def _judge_by_gate(row: Result, gate: Gate) -> Result:
    out = _with_outcome(replace(row, role=gate.role, set_after=gate.chosen_after), gate.limits, gate.reason)
    lost = gate.gate and out.outcome is Outcome.SKIPPED and out.cause in _NOT_THERE
    return replace(out, outcome=Outcome.ERROR) if lost else out


def _with_outcome(row: Result, limits: tuple[float, float], *reasons: str) -> Result:
    """The row with its outcome by a range; of a test ``detectable`` is the departure that it was asked about."""
    (outcome, cause), metric = outcome_of(row, *limits), metric_of(row.metric)
    words = said("concluded", row=row, cause=cause.name, departure=metric.departure)
    low, high = (limit if math.isfinite(limit) else math.nan for limit in limits)
    found = row.detectable if metric.kind is Kind.TEST else float(np.fmin(*detectable_departures(row, *limits)))
    return replace(
        row, outcome=outcome, cause=cause, limit_low=low, limit_high=high, detectable=found,
        reason=_join_words(words, row.reason, *reasons),
    )  # fmt: skip


def _judge_by_usual_range(row: Result) -> Result:
    """A row that no campaign plans: judged by the usual range of its metric, where it has one and a value."""
    usual = metric_of(row.metric).usual
    if row.outcome in (Outcome.SKIPPED, Outcome.ERROR):
        return replace(row, outcome=Outcome.NONE, reason=f"not compared: {row.reason}")
    if usual is None or math.isnan(row.value):
        return row
    return _with_outcome(row, usual)


def _unmatched_rows(rows: Sequence[Result], met: Collection[str], gate: Gate) -> Iterator[Result]:
    """An ERROR row for every subject pattern of a gate that none of the subjects is of which it covers rows."""
    for pattern in gate.subjects:
        if not any(fnmatchcase(subject, pattern) for subject in met):
            why = said("absent.planned", gate=gate, pattern=pattern, **_near_names(rows, gate))
            yield gate.row_for(pattern, Outcome.ERROR, Cause.ABSENT, why)


def _near_names(rows: Sequence[Result], gate: Gate) -> dict[str, list[str]]:
    """What comes near to what a gate names: subjects with that metric, else metrics of that name."""
    same = [row for row in rows if row.product == gate.product and row.metric != COMPARISON]
    anywhere = gate.model_copy(update={"subjects": ("*",), "method": "*", "bands_nm": None})
    near = list(dict.fromkeys(f"{r.subject!r} ({r.method})" for r in same if anywhere.matches(r)))
    return {"near": near, "close": nearest(gate.metric, sorted({row.metric for row in same}))}


def _pooled_row(matched: Sequence[Result], gate: Gate) -> list[Result]:
    """The row of a pooled gate of the rows it covers; none without any, as :func:`_unmatched_rows` reports that.

    Inconclusive rows widen the interval: they count as not met at its lower end, as met at its upper end.
    """
    if not matched or gate.fraction_at_least is None:
        return []
    judgements = [outcome_of(row, *gate.limits) for row in matched]
    # Of rows that are 1 or 0 by an interval the value counts: their fraction is the coverage of the intervals.
    good = sum(outcome is Outcome.AGREES or cause is Cause.COVERAGE for outcome, cause in judgements)
    amiss = (Outcome.DISAGREES, Outcome.ERROR)
    bad = [row for row, (outcome, _) in zip(matched, judgements, strict=True) if outcome in amiss]
    n, undecided = len(matched), len(matched) - good - len(bad)
    lower, upper = float(clopper_pearson(good, n)[0]), float(clopper_pearson(n - len(bad), n)[1])
    what = said("pooled", good=good, n=n, limit=gate.limit_text, undecided=undecided, bad=bad, whole=COMPARISON)
    names = "", gate.product, ", ".join(gate.subjects), gate.method, f"{gate.metric}_fraction"
    more: dict[str, Any] = {"evidence": metric_of(gate.metric).evidence, "set_after": gate.chosen_after, "reason": what}
    row, least = Result(*names, good / n, lower=lower, upper=upper, n=n, role=gate.role, **more), gate.fraction_at_least
    out = _with_outcome(row, (least, math.inf), gate.reason)
    if out.outcome is Outcome.UNDECIDED and float(clopper_pearson(n, n)[0]) < least:
        out = replace(out, cause=Cause.NEVER)
    return [replace(out, detectable=detectable_share(n, least))]


def _join_words(*parts: str) -> str:
    return "; ".join(dict.fromkeys(p for p in parts if p))
