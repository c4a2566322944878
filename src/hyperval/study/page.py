"""``report.html`` of a study: figures, answers, knees, and rows of the results table, none of which gates."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.interpolate import CubicSpline

from hyperval.data import Array, Index
from hyperval.figures.spec import SOURCES, VIRIDIS, Axis, ColourScale, Figure, Mark, Panels, Part, palette_colours
from hyperval.model import is_reread
from hyperval.report.html import page
from hyperval.report.verdict import number_text
from hyperval.results import Cause, Outcome, Result, ResultTable
from hyperval.study.plan import GROUND, MIN_GAS, PFA, Plan, plain_value
from hyperval.study.schema import Input, Knee, Plot, StudyFile

MIN_POINTS = 5
MAX_LISTED = 500  # points that stand in results.csv one by one
_FINE = 2001
_FLAT = 1e-6  # of the output: below it nothing bends
_MAX_LINES, _BINS = 9, 24
_SPREAD = {"low": 0.1, "middle": 0.5, "high": 0.9}
_MARKERS = ("circle", "square", "diamond", "triangle", "inverted_triangle", "plus", "star", "x", "hex")
_MAX_REASONS, _MAX_VALUES, _MAX_KNEES = 12, 12, 24


class KneePoint(NamedTuple):
    """The knee of one curve: its place, the curve and its curvature there; NaN with a reason where none is."""

    x: float = np.nan
    y: float = np.nan
    curvature: float = np.nan
    reason: str = ""


def knee(
    x: npt.ArrayLike, y: npt.ArrayLike, *, logarithmic: bool = False, bend: Literal["any", "concave", "convex"] = "any"
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
    place, value = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    finite = np.isfinite(value)
    place, value = place[finite], value[finite]
    if place.size < MIN_POINTS:
        return KneePoint(reason=f"{place.size} points; a knee needs {MIN_POINTS}")
    span = float(np.ptp(value))
    if span <= _FLAT * max(1.0, float(np.abs(value).max())):
        return KneePoint(reason="the curve is flat")
    scaled = np.log(place) if logarithmic else place
    u = (scaled - scaled[0]) / (scaled[-1] - scaled[0])
    spline = CubicSpline(u, (value - value.min()) / span)
    fine = np.linspace(0.0, 1.0, _FINE)
    second = {"any": np.abs, "concave": np.negative, "convex": np.positive}[bend](spline(fine, 2)).clip(0.0)
    curvature = second / (1.0 + spline(fine, 1) ** 2) ** 1.5
    if not curvature.any():
        return KneePoint(reason=f"no part of the curve is {bend}")
    # A parabola through the three values around the greatest: between the points of the fine grid.
    k = int(np.argmax(curvature))
    if k in (0, _FINE - 1):
        return KneePoint(reason="the curve bends most at an end of the range")
    a, b, c = curvature[k - 1 : k + 2]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c < 0 else 0.0
    best = fine[k] + shift * (fine[1] - fine[0])
    where = scaled[0] + best * (scaled[-1] - scaled[0])
    return KneePoint(float(np.exp(where) if logarithmic else where), float(value.min() + span * spline(best)), float(b))


_NO_VALUE: dict[str, Any] = {"outcome": Outcome.SKIPPED, "cause": Cause.NO_VALUE}
CurveKnee = tuple[Knee, dict[str, Any], KneePoint]  # the question, where the other inputs stand, the answer


def find_knees(study: StudyFile, table: pd.DataFrame) -> list[CurveKnee]:
    """The knees that a study asks for, one for each combination of its other inputs."""
    found = []
    for wanted in study.knees:
        others = [i.name for i in study.inputs if i.name != wanted.along and study.design.kind == "grid"]
        frame = table if study.design.kind == "grid" else table[table[wanted.along].notna()]
        for fixed, part in frame.groupby(others, sort=False, dropna=False) if others else [((), frame)]:
            rising = part.sort_values(wanted.along, kind="stable").drop_duplicates(wanted.along)
            x, y = rising[[wanted.along, wanted.output]].to_numpy(float).T
            point = knee(x, y, logarithmic=wanted.scale == "log", bend=wanted.bend)
            found.append((wanted, {n: v if v == v else None for n, v in zip(others, fixed, strict=True)}, point))
    return found


def values_text(values: Mapping[str, Any], digits: int = 4) -> str:
    """Inputs and their values in a line; None: as the scenario states it.

    >>> values_text({"sun": 30.0, "sensor": "emit", "water": None})
    'sun = 30, sensor = emit, water = as stated'
    """
    texts = ("as stated" if v is None else f"{v:.{digits}g}" if isinstance(v, float) else v for v in values.values())
    return ", ".join(f"{k} = {v}" for k, v in zip(values, texts, strict=True))


def extremes(values: pd.Series) -> tuple[int, dict[str, float]]:
    """How many of the values are finite, and the least, median and greatest of these; NaN of none.

    Examples
    --------
    >>> extremes(pd.Series([3.0, 1.0, np.nan, 2.0]))
    (3, {'least': 1.0, 'median': 2.0, 'greatest': 3.0})
    """
    finite = values[np.isfinite(values)]
    return len(finite), finite.agg(least="min", median="median", greatest="max").to_dict()


def result_rows(plan: Plan, table: pd.DataFrame, knees: Sequence[CurveKnee]) -> ResultTable:
    """Least, median and greatest value of every output, answers, knees, and what the evaluation cost in exactness.

    A study of few points has a row for every point and output too.  An output without a single value is SKIPPED
    with the reason.
    """
    study, asked = plan.study, {o.name: o for o in plan.study.outputs}
    rows, count, inputs = ResultTable(), len(table), [i.name for i in study.inputs]
    numbers = {name: column.unit for name, column in study.columns.items() if name not in inputs}
    saturated = sum("SATURATION" in text for text in table["reason"])

    def add(product: str, subject: str, method: str, metric: str, value: float, unit: str = "1", **more: Any) -> None:
        rows.append(Result(study.name, product, subject, method, metric, float(value), unit, **more))

    for name, unit in numbers.items():
        output, (n, values) = asked.get(name), extremes(table[name])
        product = "study" if output is None else output.kind if output.is_spectral else "roc"
        names = product, name if output is None else output.subject, name
        counts, more = {"no value": count - n, "SATURATION": saturated}, dict[str, Any]()
        why_not = "; ".join(f"{k} of {count} points: {what}, see table.csv" for what, k in counts.items() if k)
        if not n:
            values, more = {"median": np.nan}, _NO_VALUE
            why_not = next(filter(None, table["reason"]), "no point has a value")
        for metric, value in values.items():
            add(*names, metric, value, unit, n=n, reason=why_not, **more)
    for curve, held_values, point in knees:
        reason = "; ".join(filter(None, (values_text(held_values), point.reason)))
        add("study", curve.output, f"knee along {curve.along}", "knee", point.x, study.columns[curve.along].unit,
            reason=reason, **(_NO_VALUE if point.reason else {}))  # fmt: skip
    for name, value in plan.atmosphere_error.items():
        add("study", name, "interpolated atmosphere", "error_at_held_out_states", value, n=study.atmosphere.checked)
    # A point goes by its inputs, as another study of the same may number it otherwise.
    for point in table.to_dict("records") if count <= MAX_LISTED else ():
        name_of = values_text({n: point[n] for n in inputs if point[n] is not None and point[n] == point[n]}, 12)
        for name, unit in numbers.items():
            why = point["reason"] if np.isnan(point[name]) or "SATURATION" in point["reason"] else ""
            add("study", name, name_of or "as stated", "output", point[name], unit, reason=why)
    return rows


def study_figures(study: StudyFile, table: pd.DataFrame, knees: Sequence[CurveKnee]) -> list[Figure]:
    """All figures that a study asks for, each under its own title or, in full or short words, under what it shows."""
    kinds, plots = {"tornado": _tornado_figure, "heat": _heat_figure, "lines": _lines_figure}, enumerate(study.plots, 1)
    made = {f"{n:02d}-{plot.kind}-{plot.output}": kinds[plot.kind](study, table, plot, knees) for n, plot in plots}
    return [replace(figure, name=name) for name, figure in made.items()]


def _figure(study: StudyFile, plot: Plot, view: Panels, against: tuple[str, str], notes: str, **more: Any) -> Figure:
    """The figure of a plot: its view, the ends of its full and its short title (``against``), and notes."""
    item = study.columns[plot.output]
    full, short = (plot.title or said for said in (item.title + against[0], (item.label or item.name) + against[1]))
    return Figure("", "study", full + notes, (view,), head=short, **more)


def _select_points(study: StudyFile, table: pd.DataFrame, plot: Plot) -> tuple[pd.DataFrame, dict[str, Any], str]:
    """Points that a figure shows, and where the listed inputs stand that it does not draw: at the middle one.

    >>> from types import SimpleNamespace as Of
    >>> one = Input(name="haze", path="atmosphere.aot550", values=[0.1, None])
    >>> table = pd.DataFrame({"haze": np.array([0.1, None], object), "pd": [0.2, 0.3]})
    >>> points, _, words = _select_points(Of(inputs=[one]), table, Plot(kind="lines", x="c", output="pd"))
    >>> points["pd"].tolist(), words
    ([0.3], '; at haze = as stated')
    """
    fixed = {}
    for item in study.inputs:
        values = None if item.name in (plot.x, plot.y, plot.family) else item.listed_values
        if values is not None and len(values) > 1:
            fixed[item.name] = plain_value(values[len(values) // 2])
            table = table[table[item.name].isin([fixed[item.name]])]
    return table, fixed, f"; at {values_text(fixed)}" if fixed else ""


def _lines_figure(study: StudyFile, table: pd.DataFrame, plot: Plot, knees: Sequence[CurveKnee]) -> Figure:
    item, output, family, log = study.columns[plot.x], study.columns[plot.output], plot.family, plot.scale == "log"
    frame, fixed, notes = _select_points(study, table, plot)
    places, members = _distinct(frame[item.name]), _distinct(frame[family]) if family else [None]
    words = not all(isinstance(v, int | float) for v in places)
    spread = np.linspace(0, len(members) - 1, min(len(members), _MAX_LINES)).round().astype(int)
    shown = [members[i] for i in dict.fromkeys(spread.tolist())]
    finite = frame[np.isfinite(frame[plot.output])]
    marks, texts, circles = [], [], []
    for k, member in enumerate(shown):
        part = finite[finite[family].isin([member])] if family else finite
        line = _summarise(part[item.name], part[plot.output], log)
        columns = {"y" if name == "middle" else name: line[name].to_numpy() for name in line}
        columns["x"] = [places.index(v) for v in line.index] if words else line.index.to_numpy(float)
        ordered = isinstance(member, float) and len(shown) > 1
        colour = palette_colours(VIRIDIS[:16], len(shown))[k] if ordered else SOURCES[k % len(SOURCES)]
        label = _text(member) if family else ""
        marks.append(Mark("line", columns, label, colour, marker=_MARKERS[k] if len(line) <= 40 else "", alpha=0.15))
        line_values = {**fixed, **({family: member} if family else {})}
        circles += [
            (point.x, point.y) for curve, held_values, point in knees
            if (curve.output, curve.along) == (plot.output, plot.x) and np.isfinite(point.x)
            and all(line_values[n] == v for n, v in held_values.items() if n in line_values)
        ]  # fmt: skip
        ends = [f"{_text(line['middle'].iloc[i])} at {_text(line.index[i])}" for i in (0, -1) if len(line)]
        texts += [f"{label or plot.output}: {', '.join(ends)}"] if ends else []
    notes += f"; {len(shown)} of {len(members)} lines are drawn" if len(shown) < len(members) else ""
    if any(one.random for one in study.inputs):
        notes += "; line: median, band: 10 to 90 % of the points"
    if circles:
        place, height = np.array(circles).T
        columns = {"x": place, "y": height, "size": np.full(place.size, 10.0)}
        marks.append(Mark("dots", columns, "", "#222222", marker="circle", hollow=True))
        notes += "; circle: knee"
    share = getattr(output, "kind", "") in ("pd", "auc", "log-auc") and len(finite)
    across = Axis(item.title, "names", tuple(map(str, places))) if words else Axis(item.title, plot.scale)
    # The last family member first: the lines mostly lie above each other in this order.
    y = Axis(output.title, ends=(-0.03, 1.03) if share else None)
    against = f" against {item.title}", f" against {item.label or item.name}"
    legend_title = study.columns[family].title if family else ""
    view = Panels(across, (Part(y, tuple(marks[::-1])),), words="; ".join(texts))
    return _figure(study, plot, view, against, notes, width_in=8.6, legend_title=legend_title)


def _heat_figure(study: StudyFile, table: pd.DataFrame, plot: Plot, knees: Sequence[CurveKnee]) -> Figure:
    across, up = study.columns[plot.x], study.columns[plot.y]
    frame, _, notes = _select_points(study, table, plot)
    edges, cell = list[Array](), list[Index]()
    for item, is_log in ((across, plot.scale == "log"), (up, False)):
        column = frame[item.name].to_numpy(float)
        bins = np.linspace(column.min(), column.max(), _BINS + 1)
        if item.listed_values is not None:
            bins = cell_edges(np.unique(np.asarray(item.listed_values, float)), is_log)
        edges.append(bins)
        cell.append(np.clip(np.searchsorted(bins, column, "right") - 1, 0, bins.size - 2))
    median = frame[plot.output].groupby(cell[::-1]).median().dropna()
    r, c = (median.index.get_level_values(level) for level in (0, 1))
    value = median.to_numpy()
    mark = heat_mark(edges, (c, r), value, study.columns[plot.output].title)
    part = Part(Axis(up.title, ends=(float(edges[1][0]), float(edges[1][-1]))), (mark,))
    words = f"from {number_text(value.min())} to {number_text(value.max())}" if value.size else "empty"
    against = f" over {across.title} and {up.title}", f" over {across.label or across.name} and {up.label or up.name}"
    axis = Axis(across.title, plot.scale, ends=(float(edges[0][0]), float(edges[0][-1])))
    return _figure(study, plot, Panels(axis, (part,), words=words), against, notes, width_in=7.6)


def _tornado_figure(study: StudyFile, table: pd.DataFrame, plot: Plot, knees: Sequence[CurveKnee]) -> Figure:
    output, bars = table[plot.output], list[tuple[Input, list[tuple[float, Any]]]]()
    stated = [x for x in output[:1].tolist() if np.isfinite(x)]
    for item in study.inputs:
        mark = output[table[item.name].notna() & np.isfinite(output)].sort_values(kind="stable")
        if len(mark):
            bars.append((item, [(float(mark.iloc[i]), table[item.name][mark.index[i]]) for i in (0, -1)]))
    bars.sort(key=lambda bar: min([bar[1][0][0], *stated]) - max([bar[1][1][0], *stated]))
    inner, outer, texts = list[Mark](), list[Mark](), []
    for k, (item, ends) in enumerate(bars):
        (low, at_low), (high, at_high) = ends
        base = stated[0] if stated else 0.5 * (low + high)
        nearer = low if abs(low - base) < abs(high - base) else high
        for (end, end_value), colour in zip(ends, SOURCES, strict=False):
            # Of two ends on one side the nearer is drawn over the other, its label on the side where nothing stands.
            crowded = end == nearer and low != high and (low - base) * (high - base) > 0
            columns = {"left": min(end, base), "right": max(end, base), "bottom": k - 0.31, "top": k + 0.31}
            side: Any = "left" if (end < base) != crowded else "right"
            if end != base:
                mark = Mark("bars", columns, "", colour, alpha=1.0, words=(_text(end_value),), beside=side)
                (inner if crowded else outer).append(mark)
        texts.append(f"{item.title}: {number_text(low)} at {_text(at_low)} to {number_text(high)} at {_text(at_high)}")
    reach = [*stated, *(value for _, ends in bars for value, _ in ends)] or [0.0]
    margin = 0.12 * (max(reach) - min(reach)) or 1.0
    x = Axis(study.columns[plot.output].title, ends=(min(reach) - margin, max(reach) + margin))
    part = Part(Axis.named([item.title for item, _ in bars], 60), (*outer, *inner), tuple(("x", x) for x in stated))
    notes = f"; line: as the scenario stands, {number_text(*stated)}" if stated else "; no value as the scenario stands"
    notes += "; at the ends the input's values, blue where the output is lowest, orange where it is highest"
    against = ": each input alone over its values", ": each input alone"
    return _figure(study, plot, Panels(x, (part,), words="; ".join(texts)), against, notes, width_in=9.0)


def _summarise(x: pd.Series, y: pd.Series, logarithmic: bool) -> pd.DataFrame:
    """The middle by x, and low and high where points share an x or x is drawn at random, over bins of it."""
    if x.nunique() == len(x) > 2 * _BINS and not x.is_monotonic_increasing:
        scaled = np.log(x) if logarithmic else x
        edges = np.linspace(scaled.min(), scaled.max(), _BINS + 1)
        centres = 0.5 * (edges[1:] + edges[:-1])
        centres = np.exp(centres) if logarithmic else centres
        x = pd.Series(centres[np.clip(np.searchsorted(edges, scaled, "right") - 1, 0, _BINS - 1)])
    groups = y.groupby(x.to_numpy(), sort=pd.api.types.is_numeric_dtype(x))
    line = pd.DataFrame({name: groups.quantile(q) for name, q in _SPREAD.items()})
    return line if (groups.size() > 1).any() else line[["middle"]]


def cell_edges(centre: Array, is_log: bool) -> Array:
    """(n + 1,) edges of the cells about some places (n,) of an axis: midway, the first and last cell as wide beyond.

    >>> cell_edges(np.array([1.0, 2.0, 4.0]), False), cell_edges(np.array([3.0]), False)
    (array([0.5, 1.5, 3. , 5. ]), array([2.5, 3.5]))
    """
    scaled = np.log(centre) if is_log else centre
    middle = 0.5 * (scaled[1:] + scaled[:-1]) if centre.size > 1 else scaled + 0.5
    edges = np.concatenate([2.0 * scaled[:1] - middle[:1], middle, 2.0 * scaled[-1:] - middle[-1:]])[: centre.size + 1]
    return np.asarray(np.exp(edges) if is_log else edges)


def heat_mark(edges: Sequence[Array], cells: Sequence[Index], value: Array, label: str) -> Mark:
    """Values (n,) as colours of cells, whose numbers along x and y are given, between edges along x and y."""
    (x_at, y_at), (i, k) = edges, cells
    columns = {"left": x_at[i], "right": x_at[i + 1], "bottom": y_at[k], "top": y_at[k + 1], "value": value}
    low, high = (float(value.min()), float(value.max())) if value.size else (0.0, 1.0)
    return Mark("cells", columns, scale=ColourScale("rising", low, max(high, low + 1e-12), label))


def _distinct(column: pd.Series) -> list[Any]:
    """The values of a column, once each: numbers rising, words in the order of the file."""
    distinct = list(dict.fromkeys(column.tolist()))
    return sorted(distinct) if all(isinstance(v, int | float) for v in distinct) else distinct


def _text(value: Any) -> str:
    return "as stated" if value is None else number_text(float(value)) if isinstance(value, int | float) else str(value)


def study_page(
    plan: Plan, table: pd.DataFrame, figures: Sequence[Figure], record: Mapping[str, Any], names: Sequence[str],
    knees: Sequence[CurveKnee],
) -> str:  # fmt: skip
    """The page: figures first, then answers, knees, what moved, what was asked, and how it was evaluated."""
    study = plan.study
    reasons_of = list(filter(None, table["reason"]))
    # Reasons without their numbers, and how many points each has; those of questions by what these are.
    reasons = Counter(re.sub(r"; the nearest is [^;]*", "", text) for text in reasons_of)
    parts = {q.name: [text.partition(f"{q.name}: ")[2] for text in reasons_of] for q in study.required}
    why = {name: Counter(part.split("; ")[0] for part in texts if part) for name, texts in parts.items()}
    moved = [move.path for item in study.all_inputs for move in item.entries if move.path != PFA]
    return page(
        "study.html.j2", figures, plan=plan, study=study, figures=figures, record=record, names=names, count=len(table),
        extremes={name: extremes(table[name]) for name in list(study.columns)[len(study.inputs) :]},
        knees=knees[:_MAX_KNEES], knees_left_out=max(0, len(knees) - _MAX_KNEES), why=why,
        listed={i.name: np.asarray(i.listed_values).tolist() for i in study.inputs if i.listed_values is not None},
        most_values=_MAX_VALUES, reasons=reasons.most_common(_MAX_REASONS), values=values_text, number=number_text,
        text=_text, anew=[path for path in moved if is_reread(plan.world.stated, path)], ground=GROUND, gas=MIN_GAS,
    )  # fmt: skip
