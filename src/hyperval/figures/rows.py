"""Figures of rows: the forest of acceptance criteria, each as its effect in units of the field; the reasons."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyperval.figures.spec import (
    ACCEPTED,
    DIFFERENCE,
    GREY,
    INCONCLUSIVE,
    MET,
    NOT_MET,
    NOT_RUN,
    WAVELENGTH,
    Axis,
    ColourScale,
    Figure,
    Mark,
    Panels,
    Part,
    left_out,
    of_rows,
    row_names,
)
from hyperval.metrics import Evidence, Kind, metric_of, plain_words, product_words
from hyperval.results import OUTCOMES, WORST_FIRST, Cause, Outcome, Result, ResultTable

_LOOKS = {
    Outcome.DISAGREES: (NOT_MET, "square"), Outcome.ERROR: (NOT_MET, "x"), Outcome.UNDECIDED: (INCONCLUSIVE, "diamond"),
    Outcome.AGREES: (MET, "circle"), Outcome.SKIPPED: (NOT_RUN, "triangle"),
}  # fmt: skip
_P_VALUE = "p-value"  # of a test, which has no size in units of the field
_LEAST_P = 1e-6
_MOST_ROWS = 11
_MOST_PARTS = 5
_HALF = 0.36  # of a row: what the accepted range fills to either side
_REGIONS = {
    "vnir": "400–1000 nm", "swir1": "1000–1800 nm", "swir2": "1800–2500 nm", "absorption": "absorption bands",
    "windows": "",
}  # fmt: skip
_SHORT = {"%": " %", "nm": " nm", "percentage points": " pp", "difference / stated": " ×", "standard dev": " sd"}


def told(row: Result) -> Result:
    """A row with an effect: its value against its limits where it has no size in units of the field."""
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
    """ "+14.5 % (−27 to 56)"; without an interval where none is stated."""
    if row.effect_unit == _P_VALUE:
        return f"p = {row.effect:.2g}" if row.effect >= _LEAST_P else f"p < {_LEAST_P:g}"
    if math.isnan(row.effect):
        return ""
    short = next((words for unit, words in _SHORT.items() if row.effect_unit.startswith(unit)), "")
    # Limits that no digit tells apart are no interval: nothing was stated.
    low, high = ("" if math.isnan(end) else short_text(end) for end in (row.effect_lower, row.effect_upper))
    interval = f" ({low} to {high})" if low != high and low and high else ""
    return f"{short_text(row.effect, _sign(row))}{short}{interval}"


def _sign(row: Result) -> str:
    return "+" if row.ideal == 0.0 else ""


def short_text(value: float, sign: str = "") -> str:
    """A number with two or three digits.

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
    digits = 0 if magnitude >= 20 else 1 if magnitude >= 2 else 2 if magnitude >= 0.02 else 3
    text = f"{value:{sign}.{digits}f}"
    return (text.rstrip("0").removesuffix(".") if digits else text).replace("-", "−")


def ranked(rows: Sequence[Result]) -> list[Result]:
    """Rows with their effects, the worst first."""
    return sorted(map(told, rows), key=lambda row: (WORST_FIRST.index(row.outcome), -excess(row)))


def criteria_of(rows: Sequence[Result]) -> list[Result]:
    """The acceptance criteria that the model moves; where there are none, informational rows with an effect."""
    model = [row for row in rows if row.planned and row.evidence is Evidence.MODEL]
    criteria = [row for row in model if row.gates]
    return criteria or [
        row for row in model
        if math.isfinite(row.effect) and row.outcome is not Outcome.SKIPPED
        and any(map(math.isfinite, (row.accepted_low, row.accepted_high)))
    ]  # fmt: skip


def _words(row: Result) -> str:
    return plain_words(row.metric, row.product).partition(" of the ")[0]


def row_label(row: Result, *, several: bool = False) -> str:
    """Subject, and where in the spectrum or on the curve."""
    subject = {"*": "all subjects", "all objects": ""}.get(row.subject, row.subject).replace("_", " ")
    base, _, at = row.metric.partition("@")
    ends = at.split("-")
    nm = len(ends) == 2 and all(end.isdecimal() for end in ends)
    region = f"P_FA {at}" if at.startswith("1e") else f"{'–'.join(ends)} nm" if nm else " ".join(ends)
    region = region or _REGIONS.get(base.rsplit("_", 1)[-1], "")
    unseen = "unseen" * (row.subjects_seen == "unseen")
    return ", ".join(word for word in (subject, unseen, region, _words(row) if several else "") if word) or _words(row)


def criteria_figure(rows: Sequence[Result]) -> Figure | None:
    """Criteria as effects: a plot for each product and unit, the worst first; what is alike is folded into one row."""
    every = [row for row in ranked(criteria_of(rows)) if row.outcome is not Outcome.SKIPPED]
    groups: dict[tuple[str, str], list[Result]] = {}
    for row in every:
        groups.setdefault((row.product, row.effect_unit or _words(row)), []).append(row)
    if not groups:
        return None
    apart = [own for own in groups.values() if own[0].outcome is not Outcome.AGREES] or list(groups.values())
    shown = apart[:_MOST_PARTS]
    room = [1 + sum(row.outcome is not Outcome.AGREES for row in own) for own in shown]
    room = [min(most, len(own)) for most, own in zip(room, shown, strict=True)]
    while sum(room) > _MOST_ROWS - len(shown) and max(room) > 1:
        room[room.index(max(room))] -= 1
    parts = [_part(own, most) for own, most in zip(shown, room, strict=True)]
    # One legend for all: marks of the first plot without a number.
    names = {mark.label: mark for part in parts for mark in part.marks}
    nothing = np.array([np.nan])
    legend = [replace(mark, columns=dict.fromkeys(mark.columns, nothing), words=()) for mark in names.values()]
    parts = [replace(part, marks=tuple(replace(mark, label="") for mark in part.marks)) for part in parts]
    parts[0] = replace(parts[0], marks=(*legend, *parts[0].marks))
    words = "; ".join(
        f"{row.product} {row_label(row)}: {OUTCOMES[row.outcome].word}, {effect_text(row)}" for row in every
    )
    kind = "Acceptance criteria" if any(row.gates for row in every) else "Informational comparisons"
    return Figure(
        "criteria", "criteria", f"{kind} as effects with their 95 % intervals, the worst first",
        f"{kind} as effects in units of the field. {words}.", (Panels(Axis(), tuple(parts)),),
    )  # fmt: skip


def _part(own: Sequence[Result], most: int) -> Part:
    """The plot of one product and unit: ``most`` rows by themselves, the others in one."""
    most = len(own) if len(own) <= most + 1 else most
    several = len({_words(row) for row in own}) > 1
    names = [row_label(row, several=several) + " †" * row.set_after for row in own[:most]]
    methods = [f", {row.method.partition('/')[0]}" for row in own[:most]]
    names = [n + m * (names.count(n) > 1 and len(set(methods)) > 1) for n, m in zip(names, methods, strict=True)]
    notes = [effect_text(row) for row in own[:most]]
    rest, first = own[most:], own[0]
    if rest:
        counts = Counter(OUTCOMES[row.outcome].word for row in rest)
        names.append(
            f"{len(rest)} more, {', '.join(counts if len(counts) == 1 else (f'{n} {w}' for w, n in counts.items()))}"
        )
        values = [row.effect for row in rest if math.isfinite(row.effect)]
        notes.append(" to ".join(short_text(v, _sign(first)) for v in (min(values), max(values))) if values else "")
    low, high = _ends(own, False)
    log = first.effect_unit == _P_VALUE or (first.ideal == 1.0 and all(row.effect > 0 for row in own) and high > 3.0)
    ends = _ends(own, True) if log else (low, high)
    title = ": ".join(word for word in (product_words(first.product), "" if several else _words(first)) if word)
    label = f"{title[:1].upper()}{title[1:]}" + (f" [{first.effect_unit}]" if first.effect_unit else "")
    # What could be detected is another for each of those that are folded.
    folded = (replace(row, detectable_low=math.nan, detectable_high=math.nan) for row in rest)
    at = [*((float(i), row) for i, row in enumerate(own[:most])), *((float(most), row) for row in folded)]
    ideal = (("x", first.ideal),) if math.isfinite(first.ideal) else ()
    y = replace(row_names(names), notes=tuple(notes))
    return Part(y, _marks(at, ends), ideal, Axis(label, "log" if log else "linear", ends=ends))  # type: ignore[arg-type]


def _detectable(row: Result) -> tuple[float, ...]:
    return tuple(d for d in (row.detectable_low, row.detectable_high) if math.isfinite(d))


def _ends(rows: Sequence[Result], log: bool) -> tuple[float, float]:
    """Ends that hold intervals, ranges and the ideal; sizes that could be detected where they are not far out."""
    names = ("effect", "effect_lower", "effect_upper", "accepted_low", "accepted_high", "ideal")
    values = [getattr(row, name) for row in rows for name in names]
    values = [v for v in values if math.isfinite(v) and (v > 0 or not log)] or [0.1 if log else 0.0, 1.0]
    low, high = min(values), max(values)
    if rows and rows[0].effect_unit == _P_VALUE:
        return max(0.5 * low, 0.5 * _LEAST_P), 1.0
    if log:
        return low / 1.15, max(high, low * 1.1) * 1.15
    room = 0.6 * (high - low)
    near = [d for row in rows for d in _detectable(row) if low - room <= d <= high + room]
    low, high = min([low, *near]), max([high, *near])
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _marks(at: Sequence[tuple[float, Result]], ends: tuple[float, float]) -> tuple[Mark, ...]:
    ranges = dict.fromkeys((y, row.accepted_low, row.accepted_high) for y, row in at)
    ranges = {one: None for one in ranges if any(map(math.isfinite, one[1:]))}
    marks = []
    if ranges:
        y, low, high = np.array(list(ranges), float).T
        edges = {"left": np.where(np.isfinite(low), low, ends[0]), "right": np.where(np.isfinite(high), high, ends[1])}
        columns = edges | {"bottom": y - _HALF, "top": y + _HALF}
        marks.append(Mark("bars", columns, "accepted range", ACCEPTED, alpha=1.0))
    for outcome, (colour, marker) in _LOOKS.items():
        own = [(y, row) for y, row in at if row.outcome is outcome and math.isfinite(row.effect)]
        if own:
            numbers = np.array([(row.effect, row.effect_lower, row.effect_upper, y) for y, row in own], float).T
            columns = dict(zip(("x", "low", "high", "y"), numbers, strict=True))
            columns["x"] = np.maximum(columns["x"], ends[0])  # a p-value may be as small as it likes
            said = tuple(f"{row_label(row)}: {effect_text(row)}" for _, row in own)
            hollow = outcome is Outcome.UNDECIDED
            look: Any = {"colour": colour, "marker": marker, "hollow": hollow}
            marks.append(Mark("dots", columns, OUTCOMES[outcome].word, along="x", words=said, **look))
    found = [(d, y) for y, row in at for d in _detectable(row) if ends[0] <= d <= ends[1]]
    if found:
        x, y = np.array(found).T
        marks.append(Mark("dots", {"x": x, "y": y}, "smallest detectable error", GREY, marker="tick", along="x"))
    return tuple(marks)


def campaigns_figure(tables: Mapping[str, Sequence[Result]]) -> Figure | None:
    """Share of each campaign's acceptance criteria by outcome, the worst campaigns first; None without any criteria."""
    model = {name: [row.outcome for row in rows if row.gates and row.evidence is Evidence.MODEL]
             for name, rows in tables.items()}  # fmt: skip
    run = {name: own for name, own in model.items() if set(own) - {Outcome.SKIPPED}}
    counts = {name: Counter(own) for name, own in sorted(
        run.items(), key=lambda one: [-one[1].count(outcome) / len(one[1]) for outcome in WORST_FIRST]
    )}  # fmt: skip
    if not counts:
        return None
    y, start, marks = np.arange(float(len(counts))), np.zeros(len(counts)), []
    for outcome, (colour, _) in _LOOKS.items():
        share = np.array([100.0 * own[outcome] / own.total() for own in counts.values()])
        if share.any():
            edges = {"left": start, "right": start + share, "bottom": y - 0.3, "top": y + 0.3}
            marks.append(Mark("bars", edges, OUTCOMES[outcome].word, colour, alpha=1.0))
            start = start + share
    notes = tuple(", ".join(f"{own[o]} {OUTCOMES[o].word}" for o in WORST_FIRST if own[o]) for own in counts.values())
    x = Axis("share of acceptance criteria [%]", ends=(0.0, 100.0))
    words = "; ".join(f"{name}: {note}" for name, note in zip(counts, notes, strict=True))
    title = "Acceptance criteria of the model by campaign, the worst first"
    alt = f"Share of acceptance criteria by outcome. {words}."
    return of_rows("campaigns", "criteria", title, alt, x, replace(row_names(list(counts)), notes=notes), marks)


_MOST_INPUTS = 14
_MOST_GROUPS = 26
_MOST_QUANTITIES = 26
_STATED, _UNSTATED = "#0072B2", "#E69F00"
_BEST, _OTHER = "#C2410C", "#8aa4b8"
_ALL = "all"
_LONGEST = 34  # characters of an input's name
# Twice a log-likelihood of 10.8 has one chance in a thousand by luck, for one direction.
_TELLING = 10.8


def reason_figures(table: ResultTable) -> list[Figure]:
    """Bars of all residuals together, a matrix of single subjects, effects of inputs, what-ifs."""
    gains = [r for r in table.where(product="attribution") if r.metric == "likelihood_gain"]
    whole = sorted((r for r in gains if r.subject == _ALL), key=lambda r: -r.value)
    others = [r for r in gains if r.subject != _ALL]
    told = [r for r in table if math.isfinite(r.before)]  # older tables say it in words alone
    moves = [r for r in told if r.product == "sensitivity"]
    tests = [r for r in told if r.metric == "reduced_chi_square"]
    outcomes, left = ([r for r in tests if r.product == name] for name in ("what-if", "attribution"))
    left = sorted(left, key=lambda r: -r.before)[:_MOST_QUANTITIES]
    first = next((f"Residuals before and after: {r.method}" for r in left), "")
    made = (
        _before_and_after("residuals", "attribution", left, [r.subject for r in left], first),
        _inputs(whole[:_MOST_INPUTS], table) if whole else None,
        _gain(table),
        _by_subject(others) if others else None,
        _effects(moves) if moves else None,
        _before_and_after("what-ifs", "what-if", outcomes, [r.method for r in outcomes], "What-ifs: before and after"),
    )
    return [figure for figure in made if figure is not None]


def _inputs(rows: Sequence[Result], table: ResultTable) -> Figure:
    needed = [r for r in table.where(product="attribution") if r.metric == "needed_uncertainty"]
    stated, names = {r.method for r in needed if r.cause is not Cause.NO_UNCERTAINTY}, [r.method for r in rows]
    looks = {True: (_STATED, "uncertainty stated"), False: (_UNSTATED, "none stated: standard step")}
    marks = []
    for is_stated, (colour, label) in looks.items():
        if own := [i for i, name in enumerate(names) if (name in stated) is is_stated]:
            at, ends = np.array(own, float), np.array([max(rows[i].value, 0.1) for i in own])
            columns = {"left": np.full(at.size, 0.1), "right": ends, "bottom": at - 0.35, "top": at + 0.35}
            # An input that explains nothing has nothing to say, however far it moves.
            words = [rows[i].reason.partition("; ")[0].partition(": ")[2] if rows[i].value >= 1.0 else "" for i in own]
            words = [text.replace("-", "−") for text in words]
            marks.append(Mark("bars", columns, label, colour, words=tuple(words), beside="right", alpha=0.85))
    best = rows[0]
    alt = f"Bars of the likelihood gained by freeing each input, all residuals together: {best.method} gains most"
    alt += f" ({best.value:.3g}); then " + ", ".join(f"{r.method} ({r.value:.3g})" for r in rows[1:4]) + "."
    numbered = any(name.endswith(")") and name.rpartition("(")[2][:-1].isdigit() for name in names)
    legend = "twice the gain in log-likelihood (2 Δ ln L) with that input free; dotted: by chance once in 1000"
    legend += "; a number in brackets: one of several independent shapes of an error" if numbered else ""
    x = Axis("improvement of the fit to the differences", "log", ends=(0.1, max(best.value * 100.0, 30.0)))
    title = "Inputs that would explain the differences if they were less certain"
    y = row_names(names, _LONGEST)
    return of_rows("attribution-inputs", "attribution", title, alt, x, y, marks, legend, (_TELLING,))


def _gain(table: ResultTable) -> Figure | None:
    """The gain of the sensor that would explain the radiance of all subjects, over wavelength."""
    marks: dict[str, Mark] = {}
    for name, label, colour in (
        ("sensor_gain", "gain without an offset", DIFFERENCE), ("sensor_offset", "offset beside that gain", GREY),
        ("sensor_gain_beside_offset", "gain beside the offset below", GREY),
    ):  # fmt: skip
        every = [r for r in table.where(product="radiance") if r.metric.startswith(f"{name}@")]
        if every:
            numbers = np.array([(float(r.metric.partition("@")[2]), r.value, r.lower, r.upper) for r in every])
            columns, hollow = dict(zip(("x", "y", "low", "high"), numbers.T, strict=True)), colour == GREY
            marks[name] = Mark("dots", columns, f"{label}, 95 % interval", colour, marker="circle", hollow=hollow)
    if not marks:
        return None
    nm, gain, low, high = marks["sensor_gain"].columns.values()
    far = int(np.argmax(np.abs(gain - 1.0)))
    title = "Gain and offset of the sensor that would explain the radiance of all subjects"
    alt = f"{title}; gain farthest from 1: {gain[far]:.2f} ({low[far]:.2f} to {high[far]:.2f}) at "
    alt += f"{nm[far]:.0f} nm."
    offset = [marks.pop("sensor_offset")] if "sensor_offset" in marks else []
    parts = [Part(Axis("measured / predicted radiance"), tuple(marks.values()), (("y", 1.0),))]
    parts += [Part(Axis("offset [µW cm⁻² sr⁻¹ nm⁻¹]"), (mark,), (("y", 0.0),)) for mark in offset]
    return Figure("sensor-gain", "attribution", title, alt, (Panels(Axis(WAVELENGTH), tuple(parts)),))


def _by_subject(rows: Sequence[Result]) -> Figure | None:
    """A matrix of subjects by inputs: the area of a dot is the part of the greatest gain of its row."""
    by = {(r.subject, r.method): r.value for r in rows}
    # A gain below 1 explains nothing; subjects without any greater one have nothing to explain.
    telling, asked = {r.subject for r in rows if r.value >= 1.0}, list(dict.fromkeys(r.subject for r in rows))
    every = [s for s in asked if s in telling]
    if not every:
        return None
    subjects = every[:_MOST_GROUPS]
    best = {n: max(r.value for r in rows if r.method == n) for n in dict.fromkeys(r.method for r in rows)}
    inputs = sorted((n for n in best if best[n] > 0.0), key=lambda n: -best[n])[:_MOST_INPUTS]
    gains = np.array([[by.get((s, n), 0.0) for n in inputs] for s in subjects])
    part = gains / np.maximum(gains.max(axis=1, keepdims=True), 1e-300)
    marks = []
    for first, label, colour in ((False, "part of it", _OTHER), (True, "greatest gain of a subject", _BEST)):
        own = (gains > 0.0) & ((part >= 0.999) == first)
        if own.any():
            y, x = np.nonzero(own)
            columns = {"x": x.astype(float), "y": y.astype(float), "size": 14.0 * np.sqrt(part[own])}
            words = tuple(f"{gain:.0f}" if gain >= 10.0 else f"{gain:.2g}" for gain in gains[own])
            beside: Any = "right" if first else ""
            marks.append(Mark("dots", columns, label, colour, marker="circle", words=words, beside=beside))
    legend = "the area of a dot is the gain (2 Δ ln L) as a part of the greatest of its subject"
    quiet = len(asked) - len(every)
    legend += f"; {quiet} subjects have nothing to explain" if quiet else ""
    legend += left_out(len(subjects), len(every), "results.csv")
    tops = "; ".join(f"{s}: {inputs[at]}" for s, at in zip(subjects, gains.argmax(axis=1), strict=True))
    title, alt = "The same for each subject", f"For each subject the input that gains most: {tops}."
    names = row_names(inputs, _LONGEST), row_names(subjects, _LONGEST)
    return of_rows("attribution-subjects", "attribution", title, alt, *names, marks, legend)


def _effects(rows: Sequence[Result]) -> Figure:
    """Change of each number of the comparison per unit of each input, as a matrix of colours."""

    def label(r: Result) -> str:
        what = r.metric.removesuffix("_change").replace("roc_pd@", "P_D ").removesuffix("_ratio_windows")
        way = r.method.partition(" / ")[2].removesuffix("/pixel")
        return f"{r.subject}, {what}" + (f" {way}" if way else "")

    every = list(dict.fromkeys(label(r) for r in rows))
    gaps = {label(r): r.before for r in rows}
    shown = sorted(every, key=lambda q: -abs(gaps[q]))[:_MOST_QUANTITIES]
    by = {(label(r), r.method.partition(" / ")[0]): r.value for r in rows}
    names = list(dict.fromkeys(r.method.partition(" / ")[0] for r in rows))
    names = sorted(names, key=lambda n: -max(abs(by.get((q, n), 0.0)) for q in shown))[:_MOST_INPUTS]
    y, x = (place.ravel().astype(float) for place in np.mgrid[: len(shown), : len(names)])
    values = np.array([by.get((q, n), math.nan) for q in shown for n in names])
    words = tuple(f"{v:+.{1 + (abs(v) >= 0.001)}g}" if abs(v) >= 0.0005 else "" for v in values)
    # Colours end where nearly all values lie: one that is far out takes them from all others.
    finite = np.abs(values[np.isfinite(values)])
    reach = max(float(np.percentile(finite, 97)) if finite.size else 0.0, 1e-6)
    columns = {"left": x - 0.5, "right": x + 0.5, "bottom": y - 0.5, "top": y + 0.5, "value": values}
    scale = ColourScale("signed", -reach, reach, "change per unit")
    cells = Mark("cells", columns, words=words, beside="centre", scale=scale)
    largest = max(((abs(v), q, n) for (q, n), v in by.items() if q in shown), default=(0.0, "", ""))
    alt = f"Change of {len(shown)} numbers of the comparison per unit of {len(names)} inputs; the largest, "
    alt += f"{largest[0]:.2g}, is that of {largest[1]} by {largest[2]}."
    legend = "one unit: the stated standard uncertainty of an input, or a standard step where none is stated; "
    legend += "gap: measured minus predicted; spectra relative to the measured mean, P_D as a difference; "
    legend += "the largest gaps are shown"
    quantities = [f"{q} (gap {gaps[q]:+.2g})" for q in shown]
    ways = row_names(names, _LONGEST), row_names(quantities, 56)
    title = "Change by one unit of each input"
    return of_rows("attribution-effects", "sensitivity", title, alt, *ways, [cells], legend)


def _before_and_after(name: str, product: str, rows: Sequence[Result], names: list[str], title: str) -> Figure | None:
    """Reduced chi-square of each row, and what it was before."""
    if not rows:
        return None
    (before, after), at = np.array([(r.before, r.value) for r in rows]).T, np.arange(float(len(rows)))
    marks = [Mark("dots", {"x": before, "y": at}, "as in the campaign", marker="circle", hollow=True)]
    for own, label, colour, marker in (
        (after < before, "after, closer", MET, "left"), (~(after < before), "after, farther", NOT_MET, "right")
    ):  # fmt: skip
        if own.any():
            ends = {"low": np.minimum(before, after)[own], "high": np.maximum(before, after)[own]}
            words = tuple(f"{value:.3g}" for value in after[own])
            marks.append(Mark("dots", {"x": after[own], "y": at[own], **ends}, label, colour, marker=marker,
                              along="x", words=words, beside="right"))  # fmt: skip
    both = [v for v in (*before, *after) if v > 0]
    scattered = bool(both) and max(both) > 20.0 * min(both)
    x = Axis("reduced chi-square", "log" if scattered else "linear")
    each = (f"{one} from {b:.3g} to {r.value:.3g}" for one, r, b in zip(names, rows, before, strict=True))
    alt, legend = f"{title}. Reduced chi-square: {'; '.join(each)}.", "dotted: 1, as expected from the uncertainties"
    return of_rows(name, product, title, alt, x, row_names(names, _LONGEST), marks, legend, (1.0,))
