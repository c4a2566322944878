"""Figures of a study, in the style of the reports: line families, heat maps, tornado."""

from __future__ import annotations

import textwrap
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from hyperval.report import style
from hyperval.report.style import Drawing
from hyperval.report.verdict import number_text
from hyperval.study.schema import Input, Output, Plot, Required, Study
from hyperval.study.summary import CurveKnee, words_of
from hyperval.study.tables import StudyTable

Array = npt.NDArray[np.float64]
_MOST_LINES = 9
_BINS = 24
_SPREAD = (10.0, 90.0)
_MARKERS = "osD^vP*Xh"


def draw(study: Study, table: StudyTable, knees: list[CurveKnee]) -> list[Drawing]:
    """All figures that a study asks for."""
    figures = []
    for number, plot in enumerate(study.plots, 1):
        name = f"{number:02d}-{plot.kind}-{plot.output}"
        with style.house_style():
            if plot.kind == "tornado":
                figures.append(_tornado(study, table, plot, name))
            elif plot.kind == "heat":
                figures.append(_heat(study, table, plot, name))
            else:
                figures.append(_lines(study, table, plot, name, knees))
    return figures


def _input(study: Study, name: str | None) -> Input:
    return next(i for i in study.inputs if i.name == name)


def _output_words(study: Study, name: str) -> str:
    outputs: list[Output | Required] = [*study.outputs, *study.required]
    return next(x.words for x in outputs if x.name == name)


def _label(study: Study, name: str) -> str:
    outputs: list[Output | Required] = [*study.outputs, *study.required]
    return next(x.label or x.name for x in outputs if x.name == name)


def _folded(text: str) -> str:
    """Text in short lines, for the title of a legend."""
    return "\n".join(style.plain(line) for line in textwrap.wrap(text, 22))


def _kept(study: Study, table: StudyTable, drawn: list[str]) -> tuple[npt.NDArray[np.bool_], dict[str, Any]]:
    """Points that a figure shows: listed inputs that it does not draw stand at the middle one of their values."""
    keep, fixed = np.ones(len(table.values), bool), {}
    for item in study.inputs:
        values = table.points.values[item.name]
        if item.name in drawn or values is None or len(values) == 1:
            continue
        fixed[item.name] = values[len(values) // 2]
        keep &= np.array([v == fixed[item.name] for v in table.column(item.name)])
    return keep, {k: v.item() if hasattr(v, "item") else v for k, v in fixed.items()}


def _lines(study: Study, table: StudyTable, plot: Plot, name: str, knees: list[CurveKnee]) -> Drawing:
    item = _input(study, plot.x)
    keep, fixed = _kept(study, table, [n for n in (plot.x, plot.family) if n])
    x, y = table.column(item.name)[keep], np.asarray(table.column(plot.output), float)[keep]
    family = table.column(plot.family)[keep] if plot.family else np.zeros(x.size)
    members = _different(family)
    shown = [members[i] for i in _spread_out(len(members))]
    figure = style.new_figure(
        8.6, 4.8, plot.title or f"{_label(study, plot.output)} against {item.label or item.name}", False
    )
    axes = figure.add_subplot()
    words, entries = [], []
    for k, member in enumerate(shown):
        here = np.array([v == member for v in family]) & np.isfinite(y)
        colour = _colour(k, len(shown), isinstance(member, float))
        label = _text(member) if plot.family else plot.output
        at, middle, low, high = _summarised(x[here], y[here], plot.scale == "log")
        line = axes.plot(
            at, middle, color=colour, marker=_MARKERS[k] if len(at) <= 40 else None, markersize=4, zorder=3
        )[0]
        if low is not None and high is not None:
            axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0)
        for knee in knees:
            if _is_knee_of(knee, plot, member, fixed) and np.isfinite(knee.point.x):
                axes.plot(knee.point.x, knee.point.y, marker="o", markersize=10, markerfacecolor="none",
                          markeredgecolor="#222222", markeredgewidth=1.4, zorder=5)  # fmt: skip
        entries.append((line, label))
        if len(at):
            words.append(
                f"{label}: {_text(float(middle[0]))} at {_text(at[0])}, {_text(float(middle[-1]))} at "
                f"{_text(at[-1])}"
            )
    if plot.scale == "log":
        axes.set_xscale("log")
        _log_ticks(axes.xaxis, x)
    axes.set_xlabel(style.plain(item.words))
    axes.set_ylabel(style.plain(_output_words(study, plot.output)))
    if y.size and np.nanmin(y) >= 0 and np.nanmax(y) <= 1.0 and _is_probability(study, plot.output):
        axes.set_ylim(-0.03, 1.03)
    if plot.family:
        # The greatest first, as the lines mostly stand above each other.
        handles, labels = zip(*reversed(entries), strict=True)
        figure.legend(handles, [style.plain(t) for t in labels], loc="outside right center",
                      title=_folded(_input(study, plot.family).words))  # fmt: skip
    notes = _notes(fixed, len(members), len(shown))
    if any(item.random for item in study.inputs):
        notes += "; line: median, band: 10 to 90 % of the points"
    if any(_is_knee_of(f, plot, m, fixed) and np.isfinite(f.point.x) for f in knees for m in shown):
        notes += "; circle: knee"
    title = (plot.title or f"{_output_words(study, plot.output)} against {item.words}") + notes
    return style.vector_drawing(figure, name, "study", title, f"Lines. {'; '.join(words)}.")


def _heat(study: Study, table: StudyTable, plot: Plot, name: str) -> Drawing:
    across, up = _input(study, plot.x), _input(study, plot.y)
    keep, fixed = _kept(study, table, [across.name, up.name])
    x, y = (np.asarray(table.column(i.name)[keep], float) for i in (across, up))
    z = np.asarray(table.column(plot.output), float)[keep]
    edges = [_edges(table, i, v) for i, v in ((across, x), (up, y))]
    cells = np.full((edges[1].size - 1, edges[0].size - 1), np.nan)
    column, row = (
        np.clip(np.searchsorted(e, v, "right") - 1, 0, e.size - 2) for e, v in zip(edges, (x, y), strict=True)
    )
    for r, c in sorted(set(zip(row.tolist(), column.tolist(), strict=True))):
        inside = z[(row == r) & (column == c)]
        cells[r, c] = np.nanmedian(inside) if np.isfinite(inside).any() else np.nan
    figure = style.new_figure(
        7.6,
        5.4,
        plot.title or f"{_label(study, plot.output)} over {across.label or across.name} and {up.label or up.name}",
        False,
    )
    axes = figure.add_subplot()
    mesh = axes.pcolormesh(edges[0], edges[1], cells, cmap="cividis", rasterized=True, edgecolors="none")
    figure.colorbar(mesh, ax=axes, label=style.plain(_output_words(study, plot.output)))
    axes.grid(False)
    if plot.scale == "log":
        axes.set_xscale("log")
        _log_ticks(axes.xaxis, x)
    axes.set_xlabel(style.plain(across.words))
    axes.set_ylabel(style.plain(up.words))
    finite = cells[np.isfinite(cells)]
    words = (
        f"from {number_text(float(finite.min()))} to {number_text(float(finite.max()))}" if finite.size else "empty"
    )
    title = (plot.title or f"{_output_words(study, plot.output)} over {across.words} and {up.words}") + _notes(
        fixed, 0, 0
    )
    return style.vector_drawing(figure, name, "study", title, f"Heat map, {words}.")


def _tornado(study: Study, table: StudyTable, plot: Plot, name: str) -> Drawing:
    values = np.asarray(table.column(plot.output), float)
    base, bars = values[0], []
    for item in study.inputs:
        column = table.column(item.name)
        rows = [i for i, v in enumerate(column) if v is not None and np.isfinite(values[i])]
        if rows:
            low, high = min(rows, key=lambda i: values[i]), max(rows, key=lambda i: values[i])
            bars.append((item, values[low], column[low], values[high], column[high]))
    bars.sort(key=lambda b: max(b[1], b[3], base) - min(b[1], b[3], base))
    figure = style.new_figure(
        9.0, 1.7 + 0.45 * len(bars), plot.title or f"{_label(study, plot.output)}: each input alone", False
    )
    axes = figure.add_subplot()
    words = []
    for k, (item, low, at_low, high, at_high) in enumerate(bars):
        inner = low if abs(low - base) < abs(high - base) else high
        for end, at, colour in sorted(
            ((low, at_low, "#0072B2"), (high, at_high, "#E69F00")), key=lambda e: e[0] == inner
        ):
            if end == base:
                continue
            axes.barh(k, end - base, left=base, height=0.62, color=colour)
            # Where both ends lie on one side the label of the nearer one stands on the other.
            crowded = end == inner and low != high and (low - base) * (high - base) > 0
            left = (end < base) != crowded
            axes.annotate(
                _text(at),
                (base if crowded else end, k),
                xytext=(-4 if left else 4, 0),
                textcoords="offset points",
                va="center",
                ha="right" if left else "left",
                fontsize=8.5,
            )
        words.append(
            f"{item.words}: {number_text(low)} at {_text(at_low)} to {number_text(high)} at {_text(at_high)}"
        )
    axes.axvline(base, color="#222222", linewidth=1.0)
    axes.margins(x=0.12)
    axes.set_yticks(range(len(bars)), [style.plain(b[0].words) for b in bars])
    axes.grid(axis="y", visible=False)
    axes.set_xlabel(style.plain(_output_words(study, plot.output)))
    title = plot.title or f"{_output_words(study, plot.output)}: each input alone over its values"
    title += f"; line: as the scenario stands, {number_text(float(base))}; at the ends the input's values, "
    title += "blue where the output is lowest, orange where it is highest"
    return style.vector_drawing(figure, name, "study", title, f"Tornado. {'; '.join(reversed(words))}.")


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


def _colour(k: int, count: int, ordered: bool) -> Any:
    if ordered and count > 1:
        return mpl.colormaps["viridis"](0.88 * k / (count - 1))
    return style.SOURCE_COLOURS[k % len(style.SOURCE_COLOURS)]


def _is_probability(study: Study, name: str) -> bool:
    return any(o.name == name and o.kind in ("pd", "auc", "log-auc") for o in study.outputs)


def _is_knee_of(knee: CurveKnee, plot: Plot, member: Any, fixed: dict[str, Any]) -> bool:
    if knee.question.output != plot.output or knee.question.along != plot.x:
        return False
    others = {**fixed, **({plot.family: member} if plot.family else {})}
    return all(others.get(k) == v for k, v in knee.others.items() if k in others)


def _notes(fixed: dict[str, Any], members: int, shown: int) -> str:
    notes = f"; at {words_of(fixed)}" if fixed else ""
    return notes + (f"; {shown} of {members} lines are drawn" if shown < members else "")


def _log_ticks(axis: Any, x: npt.NDArray[Any]) -> None:
    """Plain numbers at 1, 2, 5 of each decade where there are few decades; powers of ten where there are many."""
    if _decades(x) > 2.5:
        style.log_ticks(axis)
        return
    axis.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_locator(NullLocator())


def _decades(x: npt.NDArray[Any]) -> float:
    at = x.astype(float)
    return float(np.log10(at.max() / at.min())) if at.size and at.min() > 0 else 0.0


def _text(value: Any) -> str:
    return number_text(float(value)) if isinstance(value, int | float) else str(value)
