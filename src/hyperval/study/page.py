"""``report.html`` of a study.

What a study found: knees, and rows of the results table, none of which gates.

Figures of a study, in the style of the reports: line families, heat maps, tornado.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hyperval.figures.spec import (
    SOURCES,
    VIRIDIS,
    Axis,
    ColourScale,
    Figure,
    Mark,
    Panels,
    Part,
    row_names,
    single,
    tones,
)
from hyperval.report.html import page
from hyperval.report.verdict import number_text
from hyperval.results import Cause, Outcome, Result, ResultTable
from hyperval.study.plan import Plan
from hyperval.study.schema import Input, Knee, Output, Plot, Required, StudyFile
from hyperval.study.tables import StudyTable, listed

Array = npt.NDArray[np.float64]
LEAST_POINTS = 5
_FINE = 2001
_FLAT = 1e-6  # of the output: below it nothing bends


@dataclass(frozen=True)
class KneePoint:
    """The knee of one curve: its place, the curve and its curvature there; NaN with a reason where none is."""

    x: float
    y: float
    curvature: float
    reason: str = ""


def knee(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    logarithmic: bool = False,
    bend: Literal["any", "concave", "convex"] = "any",
) -> KneePoint:
    """The point of greatest curvature of y(x) once both axes run from 0 to 1.

    kappa = |v''| / (1 + v'^2)^(3/2) of v(u), u = (x - x_0)/(x_1 - x_0) (of log x where ``logarithmic``) and
    v = (y - y_min)/(y_max - y_min), along the cubic spline through the points.  That is the knee in the sense of
    Satopaa et al., "Finding a kneedle in a haystack", ICDCS Workshops 2011, section II: the curvature is made
    independent of the units by the normalisation, and so depends on the ends of the range, which are stated with
    it.

    Parameters
    ----------
    x, y : (n,), n of 5 or more, x rising
    bend : "concave" looks at v'' < 0 alone (a rising curve levels off), "convex" at v'' > 0

    Examples
    --------
    >>> x = np.linspace(0.1, 10.0, 50)
    >>> round(knee(x, 1.0 - np.exp(-x), bend="concave").x, 1)
    2.8
    """
    at, value = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    finite = np.isfinite(value)
    at, value = at[finite], value[finite]
    nothing = np.nan, np.nan, np.nan
    if at.size < LEAST_POINTS:
        return KneePoint(*nothing, f"{at.size} points; a knee needs {LEAST_POINTS}")
    span = float(np.ptp(value))
    if span <= _FLAT * max(1.0, float(np.abs(value).max())):
        return KneePoint(*nothing, "the curve is flat")
    scaled = np.log(at) if logarithmic else at
    u = (scaled - scaled[0]) / (scaled[-1] - scaled[0])
    spline = CubicSpline(u, (value - value.min()) / span)
    fine = np.linspace(0.0, 1.0, _FINE)
    sign = {"any": 0.0, "concave": -1.0, "convex": 1.0}[bend]
    second = spline(fine, 2)
    second = np.abs(second) if sign == 0.0 else np.maximum(sign * second, 0.0)
    curvature = second / (1.0 + spline(fine, 1) ** 2) ** 1.5
    if not curvature.any():
        return KneePoint(*nothing, f"no part of the curve is {bend}")
    # A parabola through the three values around the greatest: between the points of the fine grid.
    k = int(np.argmax(curvature))
    if k in (0, _FINE - 1):
        return KneePoint(*nothing, "the curve bends most at an end of the range")
    a, b, c = curvature[k - 1 : k + 2]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c < 0 else 0.0
    best = fine[k] + shift * (fine[1] - fine[0])
    where = scaled[0] + best * (scaled[-1] - scaled[0])
    return KneePoint(float(np.exp(where) if logarithmic else where), float(value.min() + span * spline(best)), float(b))


MOST_LISTED = 500  # points that stand in results.csv one by one
_NO_VALUE = {"outcome": Outcome.SKIPPED, "cause": Cause.NO_VALUE}
_PRODUCT = {"snr": "snr", "radiance": "radiance"}


@dataclass(frozen=True)
class CurveKnee:
    """A knee of one curve: the question, the other inputs, the answer."""

    question: Knee
    others: dict[str, Any]
    point: KneePoint


def knees_of(study: StudyFile, table: StudyTable) -> list[CurveKnee]:
    """The knees that a study asks for, one for each combination of its other inputs."""
    return [item for wanted in study.knees for item in _knees(study, table, wanted)]


def _knees(study: StudyFile, table: StudyTable, wanted: Knee) -> Iterator[CurveKnee]:
    values = np.asarray(table.column(wanted.output), float)
    if study.design.kind == "one-at-a-time":
        column = table.column(wanted.along)
        rows = np.array([i for i, v in enumerate(column) if v is not None])
        yield CurveKnee(wanted, {}, _knee_point(wanted, column[rows].astype(float), values[rows]))
        return
    shape = tuple(len(listed(i)) for i in study.inputs)  # type: ignore[arg-type]
    names = [i.name for i in study.inputs]
    along = names.index(wanted.along)
    each = {i.name: listed(i) for i in study.inputs}
    curves = np.moveaxis(values.reshape(shape), along, -1)
    x = np.asarray(each[wanted.along], float)
    others = [n for n in names if n != wanted.along]
    for index in product(*(range(len(each[n])) for n in others)):  # type: ignore[arg-type]
        fixed = {n: each[n][k] for n, k in zip(others, index, strict=True)}  # type: ignore[index]
        yield CurveKnee(wanted, fixed, _knee_point(wanted, x, curves[index]))


def _knee_point(wanted: Knee, x: Array, y: Array) -> KneePoint:
    order = np.argsort(x, kind="stable")
    return knee(x[order], y[order], logarithmic=wanted.scale == "log", bend=wanted.bend)


def words_of(values: dict[str, Any]) -> str:
    """Inputs and their values in a line."""
    return ", ".join(f"{k} = {v:.4g}" if isinstance(v, float) else f"{k} = {v}" for k, v in values.items())


def extremes(values: npt.NDArray[np.float64]) -> dict[str, float]:
    """Least, median and greatest of finite values (n,).

    Examples
    --------
    >>> extremes(np.array([3.0, 1.0, 2.0]))
    {'least': 1.0, 'median': 2.0, 'greatest': 3.0}
    """
    return {"least": float(values.min()), "median": float(np.median(values)), "greatest": float(values.max())}


def result_rows(plan: Plan, table: StudyTable, knees: list[CurveKnee]) -> ResultTable:
    """Least, median and greatest value of every output, answers, knees, and what the evaluation cost in exactness.

    A study of few points has a row for every point and output too.  An output without a single value is SKIPPED
    with the reason.
    """
    study, rows = plan.study, ResultTable()
    kinds = {o.name: o for o in study.outputs}

    def add(product: str, subject: str, method: str, metric: str, value: float, unit: str = "1", **more: Any) -> None:
        rows.add(Result(study.name, product, subject, method, metric, float(value), unit, **more))

    for f in table.outputs:
        column = np.asarray(table.column(f.name), float)
        finite = column[np.isfinite(column)]
        output = kinds.get(f.name)
        where = _PRODUCT.get(output.kind, "roc") if output else "study"
        subject = output.subject if output else f.name
        if not finite.size:
            first = next(iter(table.reasons.values()), "no point has a value")
            add(
                where,
                subject,
                f.name,
                "median",
                np.nan,
                f.unit,
                outcome=Outcome.SKIPPED,
                cause=Cause.NO_VALUE,
                reason=first,
                n=0,
            )
            continue
        lacking = column.size - finite.size
        said = f"{lacking} of {column.size} points have no value; reasons stand in table.csv" if lacking else ""
        for metric, value in extremes(finite).items():
            add(where, subject, f.name, metric, value, f.unit, n=int(finite.size), reason=said)
    units = {i.name: i.unit for i in study.inputs}
    for item in knees:
        wanted, point = item.question, item.point
        reason = "; ".join(x for x in (words_of(item.others), point.reason) if x)
        lacking_knee = _NO_VALUE if point.reason else {}
        add("study", wanted.output, f"knee along {wanted.along}", "knee", point.x, units[wanted.along],
            reason=reason, **lacking_knee)  # fmt: skip
    for name, value in plan.sky_error.items():
        unit = "1"
        add("study", name, "interpolated atmosphere", "error_at_held_out_states", value, unit,
            n=study.atmosphere.checked)  # fmt: skip
    if len(table.values) <= MOST_LISTED:
        _add_points(rows, study, table)
    return rows


def _add_points(rows: ResultTable, study: StudyFile, table: StudyTable) -> None:
    for start, columns in table.stretches():
        for i in range(len(next(iter(columns.values())))):
            point = {x.name: columns[x.name][i] for x in study.inputs}
            said = words_of({k: v.item() if hasattr(v, "item") else v for k, v in point.items() if v is not None})
            why = table.reasons.get(start + i, "")
            for f in table.outputs:
                value = float(columns[f.name][i])
                rows.add(
                    Result(study.name, "study", f.name, f"point {start + i}", "output", value, f.unit,
                           reason="; ".join(x for x in (said, why if np.isnan(value) else "") if x))
                )  # fmt: skip


_MOST_LINES = 9
_BINS = 24
_SPREAD = (10.0, 90.0)
_MARKERS = ("circle", "square", "diamond", "triangle", "inverted_triangle", "plus", "star", "x", "hex")
_CELL = ("left", "right", "bottom", "top", "value")


def stated_figures(study: StudyFile, table: StudyTable, knees: list[CurveKnee]) -> list[Figure]:
    """All figures that a study asks for."""
    kinds: dict[str, Any] = {"tornado": _tornado, "heat": _heat, "lines": partial(_lines, knees=knees)}
    return [
        kinds[plot.kind](study, table, plot, f"{number:02d}-{plot.kind}-{plot.output}")
        for number, plot in enumerate(study.plots, 1)
    ]


def _input_named(study: StudyFile, name: str | None) -> Input:
    return next(i for i in study.inputs if i.name == name)


def _output_words(study: StudyFile, name: str) -> str:
    outputs: list[Output | Required] = [*study.outputs, *study.required]
    return next(x.words for x in outputs if x.name == name)


def _label(study: StudyFile, name: str) -> str:
    outputs: list[Output | Required] = [*study.outputs, *study.required]
    return next(x.label or x.name for x in outputs if x.name == name)


def _kept(study: StudyFile, table: StudyTable, drawn: list[str]) -> tuple[npt.NDArray[np.bool_], dict[str, Any]]:
    """Points that a figure shows: listed inputs that it does not draw stand at the middle one of their values."""
    keep, fixed = np.ones(len(table.values), bool), {}
    for item in study.inputs:
        values = table.points.values[item.name]
        if item.name in drawn or values is None or len(values) == 1:
            continue
        fixed[item.name] = values[len(values) // 2]
        keep &= np.array([v == fixed[item.name] for v in table.column(item.name)])
    return keep, {k: v.item() if hasattr(v, "item") else v for k, v in fixed.items()}


def _lines(study: StudyFile, table: StudyTable, plot: Plot, name: str, knees: list[CurveKnee]) -> Figure:
    item = _input_named(study, plot.x)
    keep, fixed = _kept(study, table, [n for n in (plot.x, plot.family) if n])
    x, y = table.column(item.name)[keep], np.asarray(table.column(plot.output), float)[keep]
    family = table.column(plot.family)[keep] if plot.family else np.zeros(x.size)
    members = _different(family)
    shown = [members[i] for i in _spread_out(len(members))]
    places = _different(x)
    words = not all(isinstance(v, int | float) for v in places)
    marks, said, circles = [], [], []
    for k, member in enumerate(shown):
        here = np.array([v == member for v in family]) & np.isfinite(y)
        label = _text(member) if plot.family else plot.output
        at, middle, low, high = _summarised(x[here], y[here], plot.scale == "log")
        columns = {"x": np.array([places.index(v) for v in at] if words else at, float), "y": middle}
        if low is not None and high is not None:
            columns |= {"low": low, "high": high}
        colour = _colour(k, len(shown), isinstance(member, float))
        marker = _MARKERS[k] if len(at) <= 40 else ""
        marks.append(Mark("line", columns, label if plot.family else "", colour, marker=marker, alpha=0.15))
        circles += [
            (f.point.x, f.point.y) for f in knees if _is_knee_of(f, plot, member, fixed) and np.isfinite(f.point.x)
        ]
        if len(at):
            said.append(
                f"{label}: {_text(float(middle[0]))} at {_text(at[0])}, {_text(float(middle[-1]))} at {_text(at[-1])}"
            )
    notes = _figure_notes(fixed, len(members), len(shown))
    if any(one.random for one in study.inputs):
        notes += "; line: median, band: 10 to 90 % of the points"
    if circles:
        at, height = np.array(circles).T
        columns = {"x": at, "y": height, "size": np.full(at.size, 10.0)}
        marks.append(Mark("dots", columns, "", "#222222", marker="circle", hollow=True))
        notes += "; circle: knee"
    inside = y.size and np.nanmin(y) >= 0 and np.nanmax(y) <= 1.0 and _is_probability(study, plot.output)
    across = Axis(item.words, "log" if plot.scale == "log" else "linear")
    if words:
        across = Axis(item.words, "names", tuple(map(str, places)))
    # The greatest first, as the lines mostly stand above each other.
    part = Part(Axis(_output_words(study, plot.output), ends=(-0.03, 1.03) if inside else None), tuple(marks[::-1]))
    return Figure(
        name, "study", (plot.title or f"{_output_words(study, plot.output)} against {item.words}") + notes,
        f"Lines. {'; '.join(said)}.", (Panels(across, (part,)),),
        head=plot.title or f"{_label(study, plot.output)} against {item.label or item.name}",
        legend_title=_input_named(study, plot.family).words if plot.family else "", width_in=8.6,
    )  # fmt: skip


def _heat(study: StudyFile, table: StudyTable, plot: Plot, name: str) -> Figure:
    across, up = _input_named(study, plot.x), _input_named(study, plot.y)
    keep, fixed = _kept(study, table, [across.name, up.name])
    x, y = (np.asarray(table.column(i.name)[keep], float) for i in (across, up))
    z = np.asarray(table.column(plot.output), float)[keep]
    edges = [_edges(table, i, v) for i, v in ((across, x), (up, y))]
    column, row = (
        np.clip(np.searchsorted(e, v, "right") - 1, 0, e.size - 2) for e, v in zip(edges, (x, y), strict=True)
    )
    cells = []
    for r, c in sorted(set(zip(row.tolist(), column.tolist(), strict=True))):
        inside = z[(row == r) & (column == c)]
        if np.isfinite(inside).any():
            cells.append((edges[0][c], edges[0][c + 1], edges[1][r], edges[1][r + 1], np.nanmedian(inside)))
    columns = dict(zip(_CELL, np.array(cells, float).reshape(-1, 5).T, strict=True))
    value = columns["value"]
    least, greatest = (float(value.min()), float(value.max())) if value.size else (0.0, 1.0)
    scale = ColourScale("rising", least, max(greatest, least + 1e-12), _output_words(study, plot.output))
    words = f"from {number_text(least)} to {number_text(greatest)}" if value.size else "empty"
    log = plot.scale == "log"
    ends = [(float(e[0]), float(e[-1])) for e in edges]
    view = single(
        Axis(across.words, "log" if log else "linear", ends=ends[0] if not log or ends[0][0] > 0 else None), up.words,
        [Mark("cells", columns, scale=scale)], ends=ends[1],
    )  # fmt: skip
    return Figure(
        name, "study",
        (plot.title or f"{_output_words(study, plot.output)} over {across.words} and {up.words}")
        + _figure_notes(fixed, 0, 0),
        f"Heat map, {words}.", (view,),
        head=plot.title or f"{_label(study, plot.output)} over {across.label or across.name} and {up.label or up.name}",
        width_in=7.6,
    )  # fmt: skip


def _tornado(study: StudyFile, table: StudyTable, plot: Plot, name: str) -> Figure:
    values = np.asarray(table.column(plot.output), float)
    base, bars = values[0], []
    for item in study.inputs:
        column = table.column(item.name)
        rows = [i for i, v in enumerate(column) if v is not None and np.isfinite(values[i])]
        if rows:
            low, high = min(rows, key=lambda i: values[i]), max(rows, key=lambda i: values[i])
            bars.append((item, values[low], column[low], values[high], column[high]))
    bars.sort(key=lambda b: min(b[1], b[3], base) - max(b[1], b[3], base))
    # Of two ends on one side the nearer is drawn over the other, its label on the side where nothing stands.
    ends: dict[tuple[str, bool, str], list[tuple[float, float, float, float, str]]] = {}
    said = []
    for k, (item, low, at_low, high, at_high) in enumerate(bars):
        inner = low if abs(low - base) < abs(high - base) else high
        for end, at, colour in ((low, at_low, SOURCES[0]), (high, at_high, SOURCES[1])):
            if end != base:
                crowded = end == inner and low != high and (low - base) * (high - base) > 0
                side = "left" if (end < base) != crowded else "right"
                bar = (min(end, base), max(end, base), k - 0.31, k + 0.31, _text(at))
                ends.setdefault((colour, crowded, side), []).append(bar)
        said.append(f"{item.words}: {number_text(low)} at {_text(at_low)} to {number_text(high)} at {_text(at_high)}")
    marks = []
    for (colour, _, side), own in sorted(ends.items(), key=lambda e: e[0][1]):
        *numbers, texts = zip(*own, strict=True)
        columns = dict(zip(_CELL, np.array(numbers, float), strict=False))
        marks.append(Mark("bars", columns, "", colour, alpha=1.0, words=texts, beside=side))  # type: ignore[arg-type]
    reach = [v for _, low, _, high, _ in bars for v in (low, high)] + [base]
    margin = 0.12 * (max(reach) - min(reach)) or 1.0
    x = Axis(_output_words(study, plot.output), ends=(float(min(reach) - margin), float(max(reach) + margin)))
    part = Part(row_names([b[0].words for b in bars], 60), tuple(marks), (("x", float(base)),))
    title = plot.title or f"{_output_words(study, plot.output)}: each input alone over its values"
    title += f"; line: as the scenario stands, {number_text(float(base))}; at the ends the input's values, "
    title += "blue where the output is lowest, orange where it is highest"
    return Figure(
        name, "study", title, f"Tornado. {'; '.join(said)}.", (Panels(x, (part,)),),
        head=plot.title or f"{_label(study, plot.output)}: each input alone", width_in=9.0,
    )  # fmt: skip


def _summarised(
    x: npt.NDArray[Any], y: Array, logarithmic: bool
) -> tuple[list[Any], Array, Array | None, Array | None]:
    """x and y of a line: as they are, or median and spread where points share an x or x is drawn at random."""
    different = _different(x)
    if len(different) > 2 * _BINS and len(different) == x.size and not np.all(np.diff(x.astype(float)) > 0):
        at = x.astype(float)
        scaled = np.log(at) if logarithmic else at
        edges = np.linspace(scaled.min(), scaled.max(), _BINS + 1)
        cell = np.clip(np.searchsorted(edges, scaled, "right") - 1, 0, _BINS - 1)
        centres = 0.5 * (edges[1:] + edges[:-1])
        groups = [(float(np.exp(c) if logarithmic else c), y[cell == k]) for k, c in enumerate(centres)]
    else:
        groups = [(v, y[np.array([w == v for w in x])]) for v in different]
    groups = [(v, part) for v, part in groups if part.size]
    middle = np.array([np.median(part) for _, part in groups])
    if all(part.size == 1 for _, part in groups):
        return [v for v, _ in groups], middle, None, None
    low, high = (np.array([np.percentile(part, q) for _, part in groups]) for q in _SPREAD)
    return [v for v, _ in groups], middle, low, high


def _edges(table: StudyTable, item: Input, seen: Array) -> Array:
    values = table.points.values[item.name]
    if values is None:
        return np.linspace(seen.min(), seen.max(), _BINS + 1)
    at = np.unique(np.asarray(values, float))
    middle = 0.5 * (at[1:] + at[:-1])
    return np.concatenate([[at[0] - (middle[0] - at[0])], middle, [at[-1] + (at[-1] - middle[-1])]])


def _different(column: npt.NDArray[Any]) -> list[Any]:
    """The values of a column, once each: numbers rising, words in the order of the file."""
    distinct = list(dict.fromkeys(column.tolist()))
    return sorted(distinct) if all(isinstance(v, int | float) for v in distinct) else distinct


def _spread_out(count: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, min(count, _MOST_LINES)).round().astype(int).tolist()))


def _colour(k: int, count: int, ordered: bool) -> str:
    return tones(VIRIDIS[:16], count)[k] if ordered and count > 1 else SOURCES[k % len(SOURCES)]


def _is_probability(study: StudyFile, name: str) -> bool:
    return any(o.name == name and o.kind in ("pd", "auc", "log-auc") for o in study.outputs)


def _is_knee_of(knee: CurveKnee, plot: Plot, member: Any, fixed: dict[str, Any]) -> bool:
    if knee.question.output != plot.output or knee.question.along != plot.x:
        return False
    others = {**fixed, **({plot.family: member} if plot.family else {})}
    return all(others.get(k) == v for k, v in knee.others.items() if k in others)


def _figure_notes(fixed: dict[str, Any], members: int, shown: int) -> str:
    notes = f"; at {words_of(fixed)}" if fixed else ""
    return notes + (f"; {shown} of {members} lines are drawn" if shown < members else "")


def _text(value: Any) -> str:
    return number_text(float(value)) if isinstance(value, int | float) else str(value)


_MOST_REASONS = _MOST_VALUES = 12
_MOST_KNEES = 24


def study_page(
    plan: Plan,
    table: StudyTable,
    figures: Sequence[Figure],
    record: Mapping[str, Any],
    names: Sequence[str],
    knees: Sequence[CurveKnee],
) -> str:
    """The page: figures first, then answers, knees, what moved, what was asked, and how it was evaluated."""
    study = plan.study
    questions = {q.name: q for q in study.required}
    return page(
        "study.html.j2", figures,
        study=study,
        scenario=plan.scenario,
        title=study.title or study.name,
        summary=f"{len(table.values):,} points were evaluated; nothing here passes or fails. "
        f"Tables: {', '.join(names)}.",
        figures=figures,
        from_words=f"From {names[0]}; study {study.name}, scenario {plan.scenario.name}",
        answers=[_answer(table, f.name, questions[f.name]) for f in table.outputs if f.name in questions],
        knees=[_knee(k) for k in knees[:_MOST_KNEES]],
        knees_left_out=max(0, len(knees) - _MOST_KNEES),
        inputs=[_input(i) for i in study.inputs],
        outputs=[_output(plan, table, o) for o in study.outputs],
        has_error=bool(plan.sky_error),
        notes=_notes(plan),
        reasons=_reasons(table),
        record=record,
    )  # fmt: skip


def _answer(table: StudyTable, name: str, question: Any) -> dict[str, Any]:
    values = np.asarray(table.column(name), float)
    finite = values[np.isfinite(values)]
    words = [t.split(f"{name}: ", 1)[1].split("; ")[0] for t in table.reasons.values() if f"{name}: " in t]
    common = Counter(words).most_common(1)
    kinds = {k: number_text(float(f(finite))) if finite.size else "–" for k, f in _THREE.items()}
    return {
        "words": f"{question.words} for {question.output} = {number_text(question.equals)}, "
        f"looked for from {number_text(question.between[0])} to {number_text(question.between[1])}",
        "solved": finite.size, "n": values.size,
        "why": f"{len(words)} points, such as: {common[0][0]}" if common else "", **kinds,
    }  # fmt: skip


_THREE: dict[str, Any] = {"least": np.min, "median": np.median, "greatest": np.max}


def _knee(item: CurveKnee) -> dict[str, str]:
    point = item.point
    return {
        "output": item.question.output,
        "along": item.question.along + (", in its logarithm" if item.question.scale == "log" else ""),
        "others": words_of({k: v.item() if hasattr(v, "item") else v for k, v in item.others.items()}),
        "x": number_text(point.x),
        "y": number_text(point.y),
        "curvature": number_text(point.curvature),
        "reason": point.reason,
    }


def _input(item: Input) -> dict[str, str]:
    moves = [
        m.path + (f" = {m.offset:g} + {m.factor:g} x" if (m.factor, m.offset) != (1.0, 0.0) else "")
        for m in item.targets
    ]
    if item.grid is not None:
        g = item.grid
        values = f"{g.count} from {g.start:g} to {g.stop:g}, {g.spacing}"
    elif item.values is not None:
        shown = [f"{v:g}" if isinstance(v, float) else str(v) for v in item.values]
        values = ", ".join(shown[:_MOST_VALUES]) + (
            f" and {len(shown) - _MOST_VALUES} more" if len(shown) > _MOST_VALUES else ""
        )
    else:
        assert item.random is not None  # noqa: S101 - the model's own check
        kind = next(n for n in ("uniform", "log_uniform", "normal") if getattr(item.random, n) is not None)
        values = f"{kind.replace('_', '-')} from {item.random.ends[0]:g} to {item.random.ends[1]:g}"
        if item.random.normal:
            values = f"normal, {item.random.normal[0]:g} ± {item.random.normal[1]:g}, cut at {item.random.ends}"
    return {"words": item.words, "moves": "; ".join(moves), "taken": values}


def _output(plan: Plan, table: StudyTable, output: Output) -> dict[str, str]:
    values = np.asarray(table.column(output.name), float)
    finite = values[np.isfinite(values)]
    error = plan.sky_error.get(f"output {output.name}")
    return {
        "name": output.name,
        "words": _meaning(plan, output),
        "n": f"{finite.size} of {values.size}",
        "error": "" if error is None else f"{error:.1e}",
        **{k: number_text(float(f(finite))) if finite.size else "–" for k, f in _THREE.items()},
    }


def _meaning(plan: Plan, o: Output) -> str:
    detector = o.detector or next(iter(plan.scenario.processing.detectors), "")
    if o.kind == "pd":
        at = f"P_FA {o.pfa:g}" if o.pfa is not None else "the P_FA of the input"
        return f"P_D of {o.subject} at {at}, {detector}, by {o.by}"
    if o.kind == "log10-pfa":
        return f"log10 of P_FA at which P_D of {o.subject} is {o.pd:g}, {detector}"
    if o.kind == "auc":
        return f"area under the ROC of {o.subject}, {detector}"
    if o.kind == "log-auc":
        return (
            f"mean P_D of {o.subject} over P_FA {o.pfa_range[0]:g} to {o.pfa_range[1]:g}, "
            f"evenly in its logarithm, {detector}"
        )
    where = (
        f"at {o.band_nm:g} nm"
        if o.range_nm is None
        else f"mean of the windows in {o.range_nm[0]:g}-{o.range_nm[1]:g} nm"
    )
    if o.kind == "snr":
        return f"SNR of {o.subject} {where}" + ("" if o.calibration_error else ", without calibration error")
    return f"radiance of {o.subject} {where} [{o.unit}]"


def _notes(plan: Plan) -> list[str]:
    notes = list(plan.notes)
    for name in ("radiance, worst", "radiance, rms"):
        if name in plan.sky_error:
            notes.append(
                f"interpolated atmosphere at {plan.study.atmosphere.checked} held-out states: {name} "
                f"relative error {plan.sky_error[name]:.1e} (ground of 0.3, two-way gas transmittance above 0.1)"
            )
    if any(i.random for i in plan.study.inputs):
        notes.append(f"random inputs: Sobol sequence, scrambled, seed {plan.study.design.seed}")
    return notes


def _reasons(table: StudyTable) -> list[tuple[str, int]]:
    """The reasons without their numbers, and how many points each has."""
    plain = [re.sub(r"; it comes to [^;]*", "", text) for text in table.reasons.values()]
    return Counter(plain).most_common(_MOST_REASONS)
