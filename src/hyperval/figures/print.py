"""Stated figures on paper: matplotlib draws what ``charts.js`` draws in a page; the same bytes for the same figure."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullLocator

from hyperval.figures.spec import GREY, LOOKS, Axis, ColourScale, Drawing, Figure, Kind, Mark, Panels, Part, shorten

_ABSORPTION = "#e9e9e9"
_ROW_IN, _LABEL, _LABEL_BELOW = 0.3, 40, 16  # [in] of a named row; letters along an axis, and along a low one
_FEW_DECADES = 2.5  # below which an axis has plain numbers at 1, 2 and 5
_JOURNAL_SCALE = 0.72  # of 10 in: 183 mm, two columns


@contextmanager
def house_style(journal: bool = False) -> Iterator[None]:
    """The style sheets of this room, whatever the user's own matplotlib settings are."""
    sheets = ["default", "hyperval.figures.print", *["hyperval.figures.journal"] * journal]
    with matplotlib.style.context(sheets), warnings.catch_warnings():
        # A subject may be named in a script that the font lacks; the figure is still of use.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        yield


def drawings_of(
    figures: Sequence[Figure], *, simulated: bool, kind: Kind = "svg", journal: bool = False
) -> list[Drawing]:
    """The files of figures; one with more subjects than have room makes several.

    ``journal`` : as wide as two columns of a journal, in its letters, without a title: the caption has it
    """
    out = []
    with house_style(journal):
        for figure in figures:
            for number, views in enumerate(figure.pages, start=1):
                name = figure.name if len(figure.pages) == 1 else f"{figure.name}-{number}"
                content, canvas = io.BytesIO(), draw_views(figure, views, simulated=simulated, journal=journal)
                canvas.savefig(content, format=kind, metadata=LOOKS["metadata"][kind], dpi=300.0)
                content_of = figure.section, figure.title, figure.alt, content.getvalue(), kind
                out.append(Drawing(name, *content_of, legend=figure.legend))
    return out


def draw_views(figure: Figure, views: Sequence[Panels], *, simulated: bool, journal: bool = False) -> Canvas:
    """Panels of some views, named at the left and at the foot alone, with one legend."""
    columns = 1 if len(views) == 1 else 2 if len(views) <= 4 else 3
    rows, parts = math.ceil(len(views) / columns), max(len(view.parts) for view in views)
    scale = _JOURNAL_SCALE if journal else 1.0
    height_in = scale * (1.0 + rows * _height_in(views[0]))
    canvas = Canvas(figsize=(scale * figure.width_in, height_in), layout="constrained")
    FigureCanvasAgg(canvas)
    if not journal:
        words = escape(figure.head or figure.title) + (" (simulated collection)" if simulated else "")
        canvas.suptitle(words, fontsize=10.5)
    names = [len(part.y.names) for part in views[0].parts]
    ratios = [count + 1.5 for count in names] if any(names) else [2.0, *[1.0] * (parts - 1)]
    grid = canvas.add_gridspec(parts * rows, columns, height_ratios=ratios * rows)
    for k, view in enumerate(views):
        row, column = divmod(k, columns)
        above: Axes | None = None
        for number, part in enumerate(view.parts):
            axes = canvas.add_subplot(grid[parts * row + number, column], sharex=None if part.x else above)
            if above is None:
                name = (escape(shorten(line, 44)) for line in (view.name, view.note) if line)
                axes.set_title("\n".join(name), loc="left")
            draw_part(axes, view, part)
            last = number == len(view.parts) - 1
            words = fill(escape(part.y.label), _LABEL if number == 0 or part.x else _LABEL_BELOW).replace(" [", "\n[")
            axes.set_ylabel(words if column == 0 else "")
            axes.set_xlabel(escape((part.x or view.x).label) if part.x or (last and k + columns >= len(views)) else "")
            if not last and not part.x:
                axes.tick_params(labelbottom=False)
            above = axes
    handles, labels = legend_entries(*views)
    fit = int(figure.width_in / (0.08 * sum(map(len, labels)) / max(len(labels), 1) + 0.55))  # beside each other
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": min(max(fit, 1), 4)}
    if figure.legend_title:
        place = {"loc": "outside right center", "title": escape(figure.legend_title)}
    if labels:
        canvas.legend(handles, labels, **place)
    return canvas


def _height_in(view: Panels) -> float:
    """Height of a row of panels [in]."""
    rows = sum(len(part.y.names) for part in view.parts)
    named = 0.5 + _ROW_IN * (rows + 1.5 * (len(view.parts) - 1)) + (1.0 if view.x.scale == "names" else 0.0)
    return named if rows else 1.3 + 1.2 * len(view.parts)


def legend_entries(*views: Panels) -> tuple[list[Any], list[str]]:
    """Handles and labels of the legend of views."""
    marks = [mark for view in views for mark in view.marks]
    entries = {m.label: _handle(next(one for one in marks if one.label == m.label)) for m in marks if m.label}
    if any(view.has_interval for view in views):
        entries["95 % interval"] = Patch(color=GREY, alpha=0.3, linewidth=0)
    if views[0].x.absorption:
        entries["absorption band"] = Patch(color=_ABSORPTION)
    return list(entries.values()), [escape(label) for label in entries]


def draw_part(axes: Axes, view: Panels, part: Part) -> None:
    """One plot into axes."""
    x = part.x or view.x
    for way, axis in (("x", x), ("y", part.y)):
        _scale(axes, way, axis, view.limits(way, part))  # type: ignore[arg-type]
    for start, end in x.absorption:
        axes.axvspan(start, end, color=_ABSORPTION, linewidth=0, zorder=0)
    for mark in part.marks:
        _mark(axes, mark)
    for way, place in part.rules:
        (axes.axvline if way == "x" else axes.axhline)(place, color=GREY, linewidth=0.9, linestyle=":")
    for height, note in enumerate(part.y.notes):
        axes.annotate(escape(note), (1.0, height), xycoords=("axes fraction", "data"), xytext=(4, 0),
                      textcoords="offset points", va="center", annotation_clip=False)  # fmt: skip


def _scale(axes: Axes, way: str, axis: Axis, ends: tuple[float, float]) -> None:
    ruler = axes.xaxis if way == "x" else axes.yaxis
    if axis.scale == "names":
        turned: dict[str, Any] = {"rotation": 35, "ha": "right"} if way == "x" else {}
        ruler.set_ticks(range(len(axis.names)), [escape(name) for name in axis.names], **turned)
        axes.grid(visible=False, axis=way)  # type: ignore[arg-type]
        ends = ends if way == "x" else ends[::-1]
    elif axis.scale == "log":
        (axes.set_xscale if way == "x" else axes.set_yscale)("log")
        few = math.log10(ends[1] / ends[0]) <= _FEW_DECADES
        ruler.set_major_locator(LogLocator(base=10, subs=(1.0, 2.0, 5.0)) if few else LogLocator(base=10, numticks=7))
        ruler.set_major_formatter((lambda v, _: f"{v:g}") if few else LogFormatterSciNotation(base=10))
        ruler.set_minor_locator(NullLocator())
    elif way == "x":
        ruler.set_major_locator(MaxNLocator(5))
    (axes.set_xlim if way == "x" else axes.set_ylim)(*ends)


def _mark(axes: Axes, mark: Mark) -> None:
    columns = mark.numbers
    low, high, x, y = (columns.get(name, np.empty(0)) for name in ("low", "high", "x", "y"))
    interval, colour = "low" in columns, mark.colour
    steps: Any = {"step": "post"} if mark.kind == "steps" else {}
    if mark.kind in ("line", "steps", "area") and interval:
        axes.fill_between(x, low, high, color=colour, alpha=mark.alpha, linewidth=0, **steps)
    elif interval:
        lines, places = (axes.hlines, y) if mark.along == "x" else (axes.vlines, x)
        lines(places, low, high, color=colour, linewidth=1.3)
    if mark.kind in ("line", "steps"):
        axes.plot(x, y, color=colour, linestyle=mark.dash, linewidth=1.2,
                  drawstyle="steps-post" if steps else "default")  # fmt: skip
    if mark.marker:
        ticks = mark.marker == "tick"
        size = columns.get("size", np.full(x.shape, 9.0 if ticks else 5.0))
        face = "none" if mark.hollow else colour
        fill: Any = {"color": colour} if ticks else {"facecolors": face, "edgecolors": colour}
        if mark.scale is not None:
            fill = {"facecolors": _colours(axes, mark.scale, columns["value"]), "edgecolors": GREY}
        shape = "_" if ticks and mark.along == "y" else LOOKS["markers"][mark.marker]
        axes.scatter(x, y, s=np.square(size), marker=shape, zorder=3, **fill)
    if mark.kind in ("bars", "cells"):
        left, right, bottom, top = (columns[name] for name in ("left", "right", "bottom", "top"))
        fill = {"color": colour, "alpha": mark.alpha}
        if mark.scale is not None:
            fill = {"color": _colours(axes, mark.scale, columns["value"])}
            axes.grid(visible=False)
        axes.bar(left, top - bottom, right - left, bottom, align="edge", linewidth=0, **fill)
        x = {"left": left, "centre": 0.5 * (left + right)}.get(mark.beside, right)
        y = 0.5 * (bottom + top)
    if mark.beside:
        _words(axes, mark, x, y)


def _words(axes: Axes, mark: Mark, x: Any, y: Any) -> None:
    distance = 9 if "size" in mark.columns else 5
    shift, side = {"left": (-distance, "right"), "right": (distance, "left"), "centre": (0, "center")}[mark.beside]
    shades = mark.text_colours if mark.scale is not None else ["black"] * len(mark.words)
    for a, b, words, shade in zip(x, y, mark.words, shades, strict=True):
        axes.annotate(escape(words), (a, b), xytext=(shift, 0), textcoords="offset points", ha=side, va="center",
                      fontsize=7.0, color=shade)  # fmt: skip


def _colours(axes: Axes, scale: ColourScale, values: Any) -> Any:
    """Values as colours of a scale, with its bar beside the plot."""
    cmap = LinearSegmentedColormap.from_list(scale.kind, scale.palette)
    mapper = ScalarMappable(Normalize(scale.low, scale.high), cmap)
    if scale.label:
        axes.figure.colorbar(mapper, ax=axes, label=escape(scale.label), shrink=0.8)
    return mapper.to_rgba(values)


def _handle(mark: Mark) -> Any:
    if mark.kind in ("bars", "area", "cells"):
        return Patch(color=mark.colour, alpha=mark.alpha)
    line: Any = mark.dash if mark.kind in ("line", "steps") else ""
    return Line2D([], [], color=mark.colour, linestyle=line, marker=LOOKS["markers"].get(mark.marker), markersize=5,
                  markerfacecolor="none" if mark.hollow else mark.colour)  # fmt: skip


def escape(text: str) -> str:
    """Text that matplotlib takes as it stands: no mathematics between dollar signs, no hidden label."""
    text = " ".join(text.split()).replace("$", r"\$")
    return f" {text}" if text.startswith("_") else text
