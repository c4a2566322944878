"""``report.html`` of a study: figures, answers, knees, and rows of the results table, none of which gates."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.interpolate import CubicSpline

from hyperval.figures.spec import SOURCES, VIRIDIS, Axis, ColourScale, Figure, Mark, Panels, Part, row_names, tones
from hyperval.report.html import page
from hyperval.report.verdict import number_text
from hyperval.results import Cause, Outcome, Result, ResultTable
from hyperval.study.evaluate import detector_of
from hyperval.study.plan import Plan
from hyperval.study.schema import Input, Knee, Output, Plot, Required, StudyFile
from hyperval.study.tables import StudyTable, listed, plain_value

Array = npt.NDArray[np.float64]
LEAST_POINTS = 5
MOST_LISTED = 500  # points that stand in results.csv one by one
_FINE = 2001
_FLAT = 1e-6  # of the output: below it nothing bends
_MOST_LINES = 9
_BINS = 24
_SPREAD = {"low": 0.1, "middle": 0.5, "high": 0.9}
_MARKERS = ("circle", "square", "diamond", "triangle", "inverted_triangle", "plus", "star", "x", "hex")
_CELL = ("left", "right", "bottom", "top", "value")
_MOST_REASONS = 12
_MOST_VALUES = 12
_MOST_KNEES = 24


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


_NO_VALUE: dict[str, Any] = {"outcome": Outcome.SKIPPED, "cause": Cause.NO_VALUE}


@dataclass(frozen=True)
class CurveKnee:
    """A knee of one curve: the question, the other inputs, the answer."""

    question: Knee
    others: dict[str, Any]
    point: KneePoint


def knees_of(study: StudyFile, table: StudyTable) -> list[CurveKnee]:
    """The knees that a study asks for, one for each combination of its other inputs."""
    found = []
    for wanted in study.knees:
        others = [i.name for i in study.inputs if i.name != wanted.along]
        frame = table.frame(*others, wanted.along, wanted.output)
        if study.design.kind == "one-at-a-time":
            frame, others = frame[frame[wanted.along].notna()], []
        for fixed, part in frame.groupby(others, sort=False) if others else [((), frame)]:
            x, y = part.sort_values(wanted.along, kind="stable")[[wanted.along, wanted.output]].to_numpy(float).T
            point = knee(x, y, logarithmic=wanted.scale == "log", bend=wanted.bend)
            found.append(CurveKnee(wanted, dict(zip(others, fixed, strict=True)), point))
    return found


def words_of(values: Mapping[str, Any]) -> str:
    """Inputs and their values in a line."""
    return ", ".join(f"{k} = {v:.4g}" if isinstance(v, float) else f"{k} = {v}" for k, v in values.items())


def extremes(values: Array) -> dict[str, float]:
    """Least, median and greatest of finite values (n,); nothing of none.

    Examples
    --------
    >>> extremes(np.array([3.0, 1.0, 2.0]))
    {'least': 1.0, 'median': 2.0, 'greatest': 3.0}
    """
    if not values.size:
        return {}
    return {"least": float(values.min()), "median": float(np.median(values)), "greatest": float(values.max())}


def _finite(table: StudyTable, name: str) -> Array:
    values = table.output(name)
    return values[np.isfinite(values)]


def result_rows(plan: Plan, table: StudyTable, knees: Sequence[CurveKnee]) -> ResultTable:
    """Least, median and greatest value of every output, answers, knees, and what the evaluation cost in exactness.

    A study of few points has a row for every point and output too.  An output without a single value is SKIPPED
    with the reason.
    """
    study, kinds = plan.study, {o.name: o for o in plan.study.outputs}
    rows, count = ResultTable(), len(table.values)

    def add(product: str, subject: str, method: str, metric: str, value: float, unit: str = "1", **more: Any) -> None:
        rows.add(Result(study.name, product, subject, method, metric, float(value), unit, **more))

    for f in table.outputs:
        output, finite = kinds.get(f.name), _finite(table, f.name)
        product = "study" if output is None else output.kind if output.kind in ("snr", "radiance") else "roc"
        names = product, f.name if output is None else output.subject, f.name
        if not finite.size:
            first = next(iter(table.reasons.values()), "no point has a value")
            add(*names, "median", np.nan, f.unit, reason=first, n=0, **_NO_VALUE)
        lacking = count - finite.size
        said = f"{lacking} of {count} points have no value; reasons stand in table.csv" if lacking else ""
        for metric, value in extremes(finite).items():
            add(*names, metric, value, f.unit, n=int(finite.size), reason=said)
    units = {i.name: i.unit for i in study.inputs}
    for item in knees:
        wanted, point = item.question, item.point
        reason = "; ".join(x for x in (words_of(item.others), point.reason) if x)
        add("study", wanted.output, f"knee along {wanted.along}", "knee", point.x, units[wanted.along],
            reason=reason, **(_NO_VALUE if point.reason else {}))  # fmt: skip
    for name, value in plan.sky_error.items():
        add("study", name, "interpolated atmosphere", "error_at_held_out_states", value, n=study.atmosphere.checked)
    if count <= MOST_LISTED:
        frame = next(table.stretches())
        for number, point in zip(frame.index, frame.to_dict("records"), strict=True):
            there = [n for n in units if point[n] is not None and point[n] == point[n]]
            said = words_of({n: point[n] for n in there})
            for f in table.outputs:
                why = point["reason"] if np.isnan(point[f.name]) else ""
                reason = "; ".join(x for x in (said, why) if x)
                add("study", f.name, f"point {number}", "output", point[f.name], f.unit, reason=reason)
    return rows


def stated_figures(study: StudyFile, table: StudyTable, knees: Sequence[CurveKnee]) -> list[Figure]:
    """All figures that a study asks for."""
    kinds = {"tornado": _tornado, "heat": _heat, "lines": _lines}
    return [
        kinds[plot.kind](study, table, plot, f"{number:02d}-{plot.kind}-{plot.output}", knees)
        for number, plot in enumerate(study.plots, 1)
    ]


def _named(study: StudyFile, name: str | None) -> Any:
    """An input, output or question by its name."""
    items: list[Input | Output | Required] = [*study.inputs, *study.outputs, *study.required]
    return next(item for item in items if item.name == name)


def _figure(
    study: StudyFile, plot: Plot, name: str, view: Panels, told: str, ways: tuple[str, str], notes: str, **more: Any
) -> Figure:  # fmt: skip
    """A figure under its own title, or under what it shows in full words and, on paper, in short ones."""
    of = _named(study, plot.output)
    full, short = plot.title or of.words + ways[0], plot.title or (of.label or of.name) + ways[1]
    return Figure(name, "study", full + notes, told, (view,), head=short, **more)


def _shown(study: StudyFile, table: StudyTable, plot: Plot) -> tuple[pd.DataFrame, dict[str, Any], str]:
    """Points that a figure shows, and where the listed inputs stand that it does not draw: at the middle one."""
    drawn, fixed = [n for n in (plot.x, plot.y, plot.family) if n], {}
    others = {n: v for n, v in table.points.listed.items() if n not in drawn and v is not None and len(v) > 1}
    frame = table.frame(*drawn, *others, plot.output)
    for name, values in others.items():
        fixed[name] = plain_value(values[len(values) // 2])
        frame = frame[frame[name] == fixed[name]]
    return frame, fixed, f"; at {words_of(fixed)}" if fixed else ""


def _lines(study: StudyFile, table: StudyTable, plot: Plot, name: str, knees: Sequence[CurveKnee]) -> Figure:
    item, family, log = _named(study, plot.x), plot.family, plot.scale == "log"
    frame, fixed, notes = _shown(study, table, plot)
    places, members = _different(frame[item.name]), _different(frame[family]) if family else [None]
    words = not all(isinstance(v, int | float) for v in places)
    spread = np.linspace(0, len(members) - 1, min(len(members), _MOST_LINES)).round().astype(int)
    shown = [members[i] for i in dict.fromkeys(spread.tolist())]
    finite = frame[np.isfinite(frame[plot.output])]
    marks, said, circles = [], [], []
    for k, member in enumerate(shown):
        part = finite[finite[family] == member] if family else finite
        line = _summarised(part[item.name], part[plot.output], log)
        columns = {"x": [places.index(v) for v in line.index] if words else line.index.to_numpy(float),
                   "y": line["middle"].to_numpy()}  # fmt: skip
        if "low" in line:
            columns |= {"low": line["low"].to_numpy(), "high": line["high"].to_numpy()}
        ordered = isinstance(member, float) and len(shown) > 1
        colour = tones(VIRIDIS[:16], len(shown))[k] if ordered else SOURCES[k % len(SOURCES)]
        marker = _MARKERS[k] if len(line) <= 40 else ""
        label = _text(member) if family else ""
        marks.append(Mark("line", columns, label, colour, marker=marker, alpha=0.15))
        here = {**fixed, **({family: member} if family else {})}
        circles += [
            (one.point.x, one.point.y) for one in knees
            if (one.question.output, one.question.along) == (plot.output, plot.x) and np.isfinite(one.point.x)
            and all(here[n] == v for n, v in one.others.items() if n in here)
        ]  # fmt: skip
        ends = [f"{_text(line['middle'].iloc[i])} at {_text(line.index[i])}" for i in (0, -1) if len(line)]
        said += [f"{label or plot.output}: {', '.join(ends)}"] if ends else []
    notes += f"; {len(shown)} of {len(members)} lines are drawn" if len(shown) < len(members) else ""
    if any(one.random for one in study.inputs):
        notes += "; line: median, band: 10 to 90 % of the points"
    if circles:
        at, height = np.array(circles).T
        columns = {"x": at, "y": height, "size": np.full(at.size, 10.0)}
        marks.append(Mark("dots", columns, "", "#222222", marker="circle", hollow=True))
        notes += "; circle: knee"
    share = getattr(_named(study, plot.output), "kind", "") in ("pd", "auc", "log-auc") and len(finite)
    across = Axis(item.words, "log" if log else "linear")
    if words:
        across = Axis(item.words, "names", tuple(map(str, places)))
    # The greatest first, as the lines mostly stand above each other.
    y = Axis(_named(study, plot.output).words, ends=(-0.03, 1.03) if share else None)
    return _figure(
        study, plot, name, Panels(across, (Part(y, tuple(marks[::-1])),)), f"Lines. {'; '.join(said)}.",
        (f" against {item.words}", f" against {item.label or item.name}"), notes,
        legend_title=_named(study, family).words if family else "", width_in=8.6,
    )  # fmt: skip


def _heat(study: StudyFile, table: StudyTable, plot: Plot, name: str, knees: Sequence[CurveKnee]) -> Figure:
    across, up = _named(study, plot.x), _named(study, plot.y)
    frame, _, notes = _shown(study, table, plot)
    edges = [_edges(table, item, frame[item.name].to_numpy(float)) for item in (across, up)]
    cell = [
        np.clip(np.searchsorted(e, frame[item.name].to_numpy(float), "right") - 1, 0, e.size - 2)
        for e, item in zip(edges, (across, up), strict=True)
    ]
    median = frame[plot.output].groupby(cell[::-1]).median().dropna()
    r, c = (median.index.get_level_values(level) for level in (0, 1))
    value = median.to_numpy()
    columns = dict(zip(_CELL, (edges[0][c], edges[0][c + 1], edges[1][r], edges[1][r + 1], value), strict=True))
    least, greatest = (float(value.min()), float(value.max())) if value.size else (0.0, 1.0)
    scale = ColourScale("rising", least, max(greatest, least + 1e-12), _named(study, plot.output).words)
    words = f"from {number_text(least)} to {number_text(greatest)}" if value.size else "empty"
    log = plot.scale == "log"
    ends = [(float(e[0]), float(e[-1])) for e in edges]
    x = Axis(across.words, "log" if log else "linear", ends=ends[0] if not log or ends[0][0] > 0 else None)
    return _figure(
        study, plot, name, Panels(x, (Part(Axis(up.words, ends=ends[1]), (Mark("cells", columns, scale=scale),)),)),
        f"Heat map, {words}.",
        (f" over {across.words} and {up.words}", f" over {across.label or across.name} and {up.label or up.name}"),
        notes, width_in=7.6,
    )  # fmt: skip


def _tornado(study: StudyFile, table: StudyTable, plot: Plot, name: str, knees: Sequence[CurveKnee]) -> Figure:
    frame = table.frame(*(i.name for i in study.inputs), plot.output)
    base, bars = float(frame[plot.output].iloc[0]), list[tuple[Input, tuple[float, Any], tuple[float, Any]]]()
    for item in study.inputs:
        own = frame[frame[item.name].notna() & np.isfinite(frame[plot.output])].sort_values(plot.output, kind="stable")
        if len(own):
            first, last = ((float(own[plot.output].iloc[i]), own[item.name].iloc[i]) for i in (0, -1))
            bars.append((item, first, last))
    bars.sort(key=lambda b: min(b[1][0], b[2][0], base) - max(b[1][0], b[2][0], base))
    # Of two ends on one side the nearer is drawn over the other, its label on the side where nothing stands.
    ends: dict[tuple[str, bool, str], list[tuple[float, float, float, float, str]]] = {}
    said = []
    for k, (item, (low, at_low), (high, at_high)) in enumerate(bars):
        inner = low if abs(low - base) < abs(high - base) else high
        for end, at, colour in ((low, at_low, SOURCES[0]), (high, at_high, SOURCES[1])):
            if end != base:
                crowded = end == inner and low != high and (low - base) * (high - base) > 0
                side = "left" if (end < base) != crowded else "right"
                bar = (min(end, base), max(end, base), k - 0.31, k + 0.31, _text(at))
                ends.setdefault((colour, crowded, side), []).append(bar)
        said.append(f"{item.words}: {number_text(low)} at {_text(at_low)} to {number_text(high)} at {_text(at_high)}")
    marks = []
    for (colour, _, side), texted in sorted(ends.items(), key=lambda e: e[0][1]):
        *numbers, texts = zip(*texted, strict=True)
        columns = dict(zip(_CELL, np.array(numbers, float), strict=False))
        marks.append(Mark("bars", columns, "", colour, alpha=1.0, words=texts, beside=side))  # type: ignore[arg-type]
    reach = [base, *(value for _, *both in bars for value, _ in both)]
    margin = 0.12 * (max(reach) - min(reach)) or 1.0
    x = Axis(_named(study, plot.output).words, ends=(min(reach) - margin, max(reach) + margin))
    part = Part(row_names([item.words for item, *_ in bars], 60), tuple(marks), (("x", base),))
    notes = f"; line: as the scenario stands, {number_text(base)}; at the ends the input's values, "
    notes += "blue where the output is lowest, orange where it is highest"
    return _figure(
        study, plot, name, Panels(x, (part,)), f"Tornado. {'; '.join(said)}.",
        (": each input alone over its values", ": each input alone"), notes, width_in=9.0,
    )  # fmt: skip


def _summarised(x: pd.Series, y: pd.Series, logarithmic: bool) -> pd.DataFrame:
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


def _edges(table: StudyTable, item: Input, seen: Array) -> Array:
    values = table.points.listed[item.name]
    if values is None:
        return np.linspace(seen.min(), seen.max(), _BINS + 1)
    at = np.unique(np.asarray(values, float))
    middle = 0.5 * (at[1:] + at[:-1])
    return np.concatenate([[at[0] - (middle[0] - at[0])], middle, [at[-1] + (at[-1] - middle[-1])]])


def _different(column: pd.Series) -> list[Any]:
    """The values of a column, once each: numbers rising, words in the order of the file."""
    distinct = list(dict.fromkeys(column.tolist()))
    return sorted(distinct) if all(isinstance(v, int | float) for v in distinct) else distinct


def _text(value: Any) -> str:
    return number_text(float(value)) if isinstance(value, int | float) else str(value)


def study_page(
    plan: Plan, table: StudyTable, figures: Sequence[Figure], record: Mapping[str, Any], names: Sequence[str],
    knees: Sequence[CurveKnee],
) -> str:  # fmt: skip
    """The page: figures first, then answers, knees, what moved, what was asked, and how it was evaluated."""
    study, count = plan.study, len(table.values)
    # Reasons without their numbers, and how many points each has.
    reasons = Counter(re.sub(r"; it comes to [^;]*", "", text) for text in table.reasons.values())
    return page(
        "study.html.j2", figures,
        study=study,
        scenario=plan.scenario,
        title=study.title or study.name,
        summary=f"{count:,} points were evaluated; nothing here passes or fails. Tables: {', '.join(names)}.",
        figures=figures,
        from_words=f"From {names[0]}; study {study.name}, scenario {plan.scenario.name}",
        answers=[_answer(table, question) for question in study.required],
        knees=[
            (k.question.output, k.question.along + (", in its logarithm" if k.question.scale == "log" else ""),
             words_of(k.others), *map(number_text, (k.point.x, k.point.y, k.point.curvature)), k.point.reason)
            for k in knees[:_MOST_KNEES]
        ],
        knees_left_out=max(0, len(knees) - _MOST_KNEES),
        inputs=[_input(i) for i in study.inputs],
        outputs=[
            {"name": o.name, "words": _meaning(plan, o), **_numbers(table, o.name),
             "error": f"{plan.sky_error[key]:.1e}" if (key := f"output {o.name}") in plan.sky_error else ""}
            for o in study.outputs
        ],
        has_error=bool(plan.sky_error),
        notes=plan.notes,
        reasons=reasons.most_common(_MOST_REASONS),
        record=record,
    )  # fmt: skip


def _numbers(table: StudyTable, name: str) -> dict[str, str]:
    """How many points have an output, and its least, median and greatest value, as a page prints them."""
    finite = _finite(table, name)
    known = dict.fromkeys(("least", "median", "greatest"), np.nan) | extremes(finite)
    return {"n": f"{finite.size} of {len(table.values)}", **{key: number_text(value) for key, value in known.items()}}


def _answer(table: StudyTable, question: Required) -> dict[str, str]:
    name = f"{question.name}: "
    words = [text.split(name, 1)[1].split("; ")[0] for text in table.reasons.values() if name in text]
    return {
        "words": f"{question.words} for {question.output} = {number_text(question.equals)}, "
        f"looked for from {number_text(question.between[0])} to {number_text(question.between[1])}",
        "why": f"{len(words)} points, such as: {Counter(words).most_common(1)[0][0]}" if words else "",
        **_numbers(table, question.name),
    }  # fmt: skip


def _input(item: Input) -> dict[str, str]:
    moves = [
        m.path + (f" = {m.offset:g} + {m.factor:g} x" if (m.factor, m.offset) != (1.0, 0.0) else "")
        for m in item.targets
    ]
    given = listed(item) if item.grid is None else None
    if given is not None:
        shown = [f"{v:g}" if isinstance(v, float) else str(v) for v in given.tolist()]
        values = ", ".join(shown[:_MOST_VALUES])
        values += f" and {len(shown) - _MOST_VALUES} more" if len(shown) > _MOST_VALUES else ""
    else:
        stated = (item.grid or item.random).model_dump(exclude_none=True)  # type: ignore[union-attr]
        values = ", ".join(f"{key.replace('_', ' ')} {_text(value)}" for key, value in stated.items())
    return {"words": item.words, "moves": "; ".join(moves), "taken": values}


def _meaning(plan: Plan, o: Output) -> str:
    at = f"P_FA {o.pfa:g}" if o.pfa is not None else "the P_FA of the input"
    where = "" if o.band_nm is None else f"at {o.band_nm:g} nm"
    where = where if o.range_nm is None else "mean of the windows in {:g}-{:g} nm".format(*o.range_nm)
    words = {
        "pd": f"P_D of {o.subject} at {at}, by {o.by}",
        "log10-pfa": f"log10 of P_FA at which P_D of {o.subject} is {o.pd:g}",
        "auc": f"area under the ROC of {o.subject}",
        "log-auc": "mean P_D of {} over P_FA {:g} to {:g}, evenly in its logarithm".format(o.subject, *o.pfa_range),
        "snr": f"SNR of {o.subject} {where}" + ("" if o.calibration_error else ", without calibration error"),
        "radiance": f"radiance of {o.subject} {where} [{o.unit}]",
    }[o.kind]
    return words if o.kind in ("snr", "radiance") else f"{words}, {detector_of(o, plan.scenario)}"
