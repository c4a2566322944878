"""Acceptance criteria as effects in units of the field: in words, as a forest, and by campaign."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hyperval.figures.spec import LOOKS, Axis, Figure, Mark, Panels, Part, compose, omissions, row_figure, to_columns
from hyperval.metrics import Evidence, Kind, metric_of, plain_words, product_words
from hyperval.results import WORST_FIRST, Outcome, Result, grouped
from hyperval.spectra.axis import SPECTRAL_REGIONS_NM

_ACCEPTED = "#d8eaf5"  # ranges
_LOOKS = {Outcome(name): {"label": Outcome(name).word, **look} for name, look in LOOKS["outcomes"].items()}
_MAX_ROWS, _MAX_PARTS = 11, 5
_HALF = 0.36  # of a row: what the accepted range fills to either side
_P_VALUE = "p-value"  # of a test, which has no size in units of the field
_MIN_P = 1e-6
_REGIONS = {name.lower(): f"{low:g}–{high:g} nm" for name, (low, high) in SPECTRAL_REGIONS_NM.items()}
_REGIONS["absorption"] = "absorption bands"
_SHORT = {"%": " %", "nm": " nm", "percentage points": " pp", "difference / stated": " ×", "standard dev": " sd"}


def with_effect(row: Result) -> Result:
    """A row with an effect: its value against its limits where it has no physical unit."""
    if math.isfinite(row.effect):
        return row
    unit = _P_VALUE if metric_of(row.metric).kind is Kind.TEST else "" if row.unit == "1" else row.unit
    return replace(
        row, effect=row.value, effect_unit=unit, effect_lower=row.lower, effect_upper=row.upper,
        accepted_low=row.limit_low, accepted_high=row.limit_high, ideal=math.nan,
    )  # fmt: skip


def excess(row: Result) -> float:
    """How far the interval reaches out of the accepted range, in half ranges: 0 at its end, negative inside."""
    low, high = row.accepted_low, row.accepted_high
    ends = [end for end in (low, high) if math.isfinite(end)]
    if not ends or math.isnan(row.effect):
        return math.inf
    middle = row.ideal if len(ends) == 1 and math.isfinite(row.ideal) else 0.5 * (ends[0] + ends[-1])
    half = max(abs(ends[-1] - middle), 1e-300)
    lower, upper = (end if math.isfinite(end) else row.effect for end in (row.effect_lower, row.effect_upper))
    return max(beyond / half for beyond in (upper - high, low - lower) if not math.isnan(beyond))


def effect_text(row: Result) -> str:
    """ "+14.5 % (−27 to 56)"; without an interval where none is stated, and with p where that alone decided.

    No number reads as an end of the accepted range that it does not lie at.

    >>> row = Result("", "radiance", "", "", "bias_ratio", effect=5.8, effect_lower=-8.9, effect_upper=20.3,
    ...              effect_unit="% of radiance", accepted_low=-20.0, accepted_high=20.0)
    >>> [effect_text(replace(row, accepted_high=end)) for end in (20.0, 20.3)]
    ['5.8 % (−8.9 to 20.3)', '5.8 % (−8.9 to 20)']
    >>> row = Result("", "scores", "*", "", "joint_distance_p_value", effect=1.69, effect_lower=1.29, effect_upper=2.2,
    ...              effect_unit="difference / stated", accepted_low=0.54, accepted_high=1.52, p_value=0.002)
    >>> [effect_text(replace(row, outcome=outcome)) for outcome in (Outcome.DISAGREES, Outcome.UNDECIDED)]
    ['1.69 × (1.29 to 2.2), p = 0.002', '1.69 × (1.29 to 2.2)']
    """
    is_p, limits = row.effect_unit == _P_VALUE, (row.accepted_low, row.accepted_high)
    p = row.effect if is_p else row.p_value
    told_p = f"p = {p:.2g}" if p >= _MIN_P else f"p < {_MIN_P:g}"
    if is_p or math.isnan(row.effect):
        return told_p * is_p
    short = next((words for unit, words in _SHORT.items() if row.effect_unit.startswith(unit)), "")
    # Limits that no digit tells apart are no interval: nothing was stated.
    low, high = ("" if math.isnan(end) else short_text(end, "", limits) for end in (row.effect_lower, row.effect_upper))
    interval = f" ({low} to {high})" if low != high and low and high else ""
    reaches_in = not (row.effect_lower > row.accepted_high or row.effect_upper < row.accepted_low)
    by_p = row.outcome is Outcome.DISAGREES and reaches_in and not math.isnan(row.p_value)
    return f"{short_text(row.effect, _sign(row), limits)}{short}{interval}{f', {told_p}' * by_p}"


def _sign(row: Result) -> str:
    """
    >>> names = "median_difference_ratio_windows", "median_abs_difference_ratio_windows"
    >>> [_sign(Result("", "radiance", "lawn", "", name, ideal=0.0)) for name in names]
    ['+', '']
    """
    return "+" if row.ideal == 0.0 and metric_of(row.metric).low < 0.0 else ""  # a size has no side


def decimals(x: float, few: int, ends: Iterable[float]) -> int:
    """Digits behind the point, ``few`` or some more, with which ``x`` reads as no end of a range that it is not.

    >>> [decimals(x, 0, (20.0,)) for x in (20.3, 20.02, 20.0, 27.4)]
    [1, 2, 0, 0]
    """
    return next((n for n in range(few, few + 4) if all(f"{e:.{n}f}" != f"{x:.{n}f}" for e in ends if e != x)), few)


def short_text(value: float, sign: str = "", limits: Iterable[float] = ()) -> str:
    """A number with two or three digits, more where it would read as one of the limits.

    Examples
    --------
    >>> short_text(-27.3), short_text(0.0141, "+")
    ('−27', '+0.014')
    """
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    magnitude = abs(value)
    if magnitude < 5e-4:
        return "0"
    if magnitude >= 1e4:
        return f"{value:{sign}.2g}".replace("-", "−")
    digits = decimals(value, sum(magnitude < step for step in (20.0, 2.0, 0.02)), limits)
    text = f"{value:{sign}.{digits}f}"
    return (text.rstrip("0").removesuffix(".") if digits else text).replace("-", "−")


def sort_rows(rows: Sequence[Result]) -> list[Result]:
    """Rows with their effects, the worst first."""
    return sorted(map(with_effect, rows), key=lambda row: (WORST_FIRST.index(row.outcome), -excess(row)))


def find_criteria(rows: Sequence[Result]) -> list[Result]:
    """The acceptance criteria that the model moves; where there are none, informational rows with an effect."""
    model = [row for row in rows if row.planned and row.evidence is Evidence.MODEL]
    criteria = [row for row in model if row.gates]
    return criteria or [
        row for row in model
        if math.isfinite(row.effect) and row.outcome is not Outcome.SKIPPED
        and any(map(math.isfinite, (row.accepted_low, row.accepted_high)))
    ]  # fmt: skip


def _title(row: Result) -> str:
    return plain_words(row.metric, row.product).partition(" of the ")[0]


def row_label(row: Result, *, several: bool = False) -> str:
    """Subject, and where in the spectrum or on the curve."""
    subject = {"*": "all subjects", "all objects": ""}.get(row.subject, row.subject).replace("_", " ")
    base, _, place = row.metric.partition("@")
    ends = place.split("-")
    nm = len(ends) == 2 and all(end.isdecimal() for end in ends)
    region = f"P_FA {place}" if place.startswith("1e") else f"{'–'.join(ends)} nm" if nm else " ".join(ends)
    region = region or _REGIONS.get(base.rsplit("_", 1)[-1], "")
    unseen = "unseen" * (row.subjects_seen == "unseen")
    return ", ".join(word for word in (subject, unseen, region, _title(row) if several else "") if word) or _title(row)


def outcome_words(rows: Iterable[Result]) -> str:
    """Number of rows by outcome: "3 met, 1 not met, 40 without a range"."""
    count = Counter(row.outcome for row in rows)
    return ", ".join(f"{count[key]} {key.word}" for key in WORST_FIRST if count[key]) or "no rows"


def criteria_figure(rows: Sequence[Result]) -> Figure | None:
    """Criteria as effects: a plot for each product and unit, the worst first; similar ones are folded into one row."""
    criteria_rows = [row for row in sort_rows(find_criteria(rows)) if row.outcome is not Outcome.SKIPPED]
    groups = grouped(criteria_rows, lambda row: (row.product, row.effect_unit or _title(row)))
    if not groups:
        return None
    unmet = [group for group in groups.values() if group[0].outcome is not Outcome.AGREES] or list(groups.values())
    shown = unmet[:_MAX_PARTS]
    room = [min(1 + sum(row.outcome is not Outcome.AGREES for row in group), len(group)) for group in shown]
    while sum(room) > _MAX_ROWS - len(shown) and max(room) > 1:
        room[room.index(max(room))] -= 1
    parts = [_criteria_part(group, most) for group, most in zip(shown, room, strict=True)]
    # One legend for all: marks of the first plot without a number.
    names = {mark.label: mark for part in parts for mark in part.marks}
    legend = [replace(mark, columns=dict.fromkeys(mark.columns, (math.nan,)), words=()) for mark in names.values()]
    parts = [replace(part, marks=tuple(replace(mark, label="") for mark in part.marks)) for part in parts]
    parts[0] = replace(parts[0], marks=(*legend, *parts[0].marks))
    criteria = "Acceptance criteria" if any(row.gates for row in criteria_rows) else "Informational comparisons"
    more = omissions(sum(map(len, shown)), len(criteria_rows), "summary.csv")
    return compose("criteria", [Panels(Axis(), tuple(parts))], more, criteria=criteria)


def _criteria_part(rows: Sequence[Result], most: int) -> Part:
    """The plot of one product and unit: ``most`` rows by themselves, the others in one."""
    most = len(rows) if len(rows) <= most + 1 else most
    several = len({_title(row) for row in rows}) > 1
    names = [row_label(row, several=several) + " †" * row.set_after for row in rows[:most]]
    methods = [f", {row.method.partition('/')[0]}" for row in rows[:most]]
    names = [n + m * (names.count(n) > 1 and len(set(methods)) > 1) for n, m in zip(names, methods, strict=True)]
    notes = [effect_text(row) for row in rows[:most]]
    rest, first = rows[most:], rows[0]
    if rest:
        names.append(f"more: {outcome_words(rest)}")
        values = [row.effect for row in rest if math.isfinite(row.effect)]
        notes.append(" to ".join(short_text(v, _sign(first)) for v in (min(values), max(values))) if values else "")
    low, high = _limits(rows, False)
    log = first.effect_unit == _P_VALUE or (first.ideal == 1.0 and all(row.effect > 0 for row in rows) and high > 3.0)
    ends = _limits(rows, True) if log else (low, high)
    title = ": ".join(dict.fromkeys([product_words(first.product), *([] if several else [_title(first)])]))
    label = f"{title[:1].upper()}{title[1:]}" + (f" [{first.effect_unit}]" if first.effect_unit else "")
    # What could be detected is another for each of those that are folded.
    folded = (replace(row, detectable_low=math.nan, detectable_high=math.nan) for row in rest)
    placed = [*((float(i), row) for i, row in enumerate(rows[:most])), *((float(most), row) for row in folded)]
    ideal = (("x", first.ideal),) if math.isfinite(first.ideal) else ()
    y = replace(Axis.named(names), notes=tuple(notes))
    return Part(y, _criteria_marks(placed, ends), ideal, Axis(label, "log" if log else "linear", ends=ends))  # type: ignore[arg-type]


def _detectable(row: Result) -> tuple[float, ...]:
    return tuple(d for d in (row.detectable_low, row.detectable_high) if math.isfinite(d))


def _limits(rows: Sequence[Result], log: bool) -> tuple[float, float]:
    """Ends that hold intervals, ranges and the ideal; sizes that could be detected where they are not far out."""
    names = ("effect", "effect_lower", "effect_upper", "accepted_low", "accepted_high", "ideal")
    values = [getattr(row, name) for row in rows for name in names]
    values = [v for v in values if math.isfinite(v) and (v > 0 or not log)] or [0.1 if log else 0.0, 1.0]
    low, high = min(values), max(values)
    if rows[0].effect_unit == _P_VALUE:
        return max(0.5 * low, 0.5 * _MIN_P), 1.0
    if log:
        return low / 1.15, max(high, low * 1.1) * 1.15
    room = 0.6 * (high - low)
    near = [d for row in rows for d in _detectable(row) if low - room <= d <= high + room]
    low, high = min([low, *near]), max([high, *near])
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _criteria_marks(rows: Sequence[tuple[float, Result]], ends: tuple[float, float]) -> tuple[Mark, ...]:
    accepted = dict.fromkeys((y, row.accepted_low, row.accepted_high) for y, row in rows)
    ranges, marks = [one for one in accepted if any(map(math.isfinite, one[1:]))], []
    if ranges:
        y, low, high = np.array(ranges, float).T
        edges = {"left": np.where(np.isfinite(low), low, ends[0]), "right": np.where(np.isfinite(high), high, ends[1])}
        columns = edges | {"bottom": y - _HALF, "top": y + _HALF}
        marks.append(Mark("bars", columns, "accepted range", _ACCEPTED, alpha=1.0))
    sized = [(y, row) for y, row in rows if math.isfinite(row.effect)]
    numbers = [(row.effect, row.effect_lower, row.effect_upper, y) for y, row in sized]
    columns = to_columns(numbers, ("x", "low", "high", "y"))
    columns["x"] = np.maximum(columns["x"], ends[0])  # a p-value may be as small as it likes
    words = (f"{row.product}, {row_label(row)}: {row.outcome.word}, {effect_text(row)}" for _, row in sized)
    marks += Mark("dots", columns, along="x", words=tuple(words)).split([row.outcome for _, row in sized], _LOOKS)
    found = [(d, y) for y, row in rows for d in _detectable(row) if ends[0] <= d <= ends[1]]
    if found:
        x, y = np.array(found).T
        marks.append(Mark("dots", {"x": x, "y": y}, "smallest detectable error", marker="tick", along="x"))
    return tuple(marks)


def campaigns_figure(tables: Mapping[str, Sequence[Result]]) -> Figure | None:
    """Share of each campaign's acceptance criteria by outcome, the worst campaigns first; None without any criteria."""
    criteria = {name: [row for row in rows if row.gates and row.evidence is Evidence.MODEL]
                for name, rows in tables.items()}  # fmt: skip
    counts = {name: Counter(row.outcome for row in rows) for name, rows in criteria.items()}
    names = [name for name, count in counts.items() if count.total() > count[Outcome.SKIPPED]]
    if not names:
        return None
    names.sort(key=lambda name: [-counts[name][outcome] / counts[name].total() for outcome in WORST_FIRST])
    shares = np.array([[100.0 * counts[n][outcome] / counts[n].total() for n in names] for outcome in _LOOKS])
    y, ends, marks = np.arange(float(len(names))), np.cumsum(shares, axis=0), []
    for look, share, end in zip(_LOOKS.values(), shares, ends, strict=True):
        if share.any():
            edges = {"left": end - share, "right": end, "bottom": y - 0.3, "top": y + 0.3}
            marks.append(Mark("bars", edges, look["label"], look["colour"], alpha=1.0))
    notes = tuple(outcome_words(criteria[name]) for name in names)
    words = "; ".join(f"{name}: {note}" for name, note in zip(names, notes, strict=True))
    axes = Axis("share of acceptance criteria [%]", ends=(0.0, 100.0)), replace(Axis.named(names), notes=notes)
    return row_figure("campaigns", *axes, marks, words)
