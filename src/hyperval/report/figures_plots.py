"""Stated plots drawn by matplotlib, for print: a panel for each subject."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hyperval.report import style
from hyperval.report.panels import Entries, name_rows, small_multiples
from hyperval.report.plots import GREY, Axis, Mark, Part, Plots, View
from hyperval.report.style import Drawing

_LINES: dict[str, Any] = {"solid": "-", "dashed": "--", "dotted": ":", "dashdot": "-."}
_MARKERS = {"circle": "o", "square": "s", "tick": "|", "left": "<", "right": ">", "": ""}
_ROW_IN = 0.3  # [in] of a named row


def drawing_of(plots: Plots, *, simulated: bool) -> Drawing:
    """The figure of plots, of at most so many subjects as have room."""
    views = dict(list(plots.views.items())[: style.MAX_PANELS])
    first = next(iter(views.values()))
    rows = len(first.parts[0].y.names)
    row_in = (
        (0.5 + _ROW_IN * rows + (1.0 if first.x.scale == "names" else 0.0))
        if rows
        else 1.3 + 1.2 * len(first.parts)
    )
    labels = (first.x.label, *(part.y.label.replace(" [", "\n[") for part in first.parts))
    figure, panels = small_multiples(plots.title, len(views), labels, simulated, row_in=row_in)
    for (subject, view), panel in zip(views.items(), panels, strict=True):
        if subject:
            panel[0].set_title(style.plain(style.shortened(subject, 44)), loc="left")
        for axes, part in zip(panel, view.parts, strict=True):
            _draw(figure, axes, view, part)
    entries: Entries = []
    for mark in plots.marks():
        if mark.label and mark.label not in (words for _, words in entries):
            entries.append((_handle(mark), mark.label))
    if first.x.label == style.WAVELENGTH_LABEL:
        entries.append((Patch(color=style.ABSORPTION_COLOUR), "absorption band"))
    if entries:
        style.add_legend(figure, entries, columns=4)
    title = plots.title + style.left_out([list(views)], list(plots.views))
    return style.vector_drawing(figure, plots.name, plots.section, title, plots.alt, plots.legend)


def _draw(figure: Any, axes: Axes, view: View, part: Part) -> None:
    for which, axis, ends in (("x", view.x, view.ends()), ("y", part.y, view.ends(part))):
        _scale(axes, which, axis, ends)
    if view.x.label == style.WAVELENGTH_LABEL:
        style.shade_absorption(axes, *view.ends())
    for mark in part.marks:
        _mark(figure, axes, mark)
    for which, place in part.rules:
        (axes.axvline if which == "x" else axes.axhline)(place, color=GREY, linewidth=0.9, linestyle=":")


def _scale(axes: Axes, which: str, axis: Axis, ends: tuple[float, float]) -> None:
    if axis.scale == "names" and which == "y":
        name_rows(axes, axis.names)
        return
    if axis.scale == "names":
        axes.set_xticks(range(len(axis.names)), [style.plain(n) for n in axis.names], rotation=35, ha="right")
        axes.grid(visible=False, axis="x")
    if axis.scale == "log":
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
        style.log_ticks(axes.xaxis if which == "x" else axes.yaxis)
    elif which == "x" and not axis.names:
        axes.xaxis.set_major_locator(MaxNLocator(5))
    (axes.set_xlim if which == "x" else axes.set_ylim)(*ends)


def _mark(figure: Any, axes: Axes, mark: Mark) -> None:
    columns: dict[str, Any] = {name: np.atleast_1d(np.asarray(v, float)) for name, v in mark.columns.items()}
    low, high, x, y = (columns.get(name, np.empty(0)) for name in ("low", "high", "x", "y"))
    interval, colour = "low" in columns, mark.colour
    steps: Any = {"step": "post"} if mark.kind == "steps" else {}
    if mark.kind in ("line", "steps", "area") and interval:
        axes.fill_between(x, low, high, color=colour, alpha=mark.alpha, linewidth=0, **steps)
    elif interval:
        (axes.hlines if mark.along == "x" else axes.vlines)(
            y if mark.along == "x" else x, low, high, color=colour, linewidth=1.3
        )
    if mark.kind in ("line", "steps"):
        axes.plot(x, y, color=colour, linestyle=_LINES[mark.dash], linewidth=1.2,
                  drawstyle="steps-post" if steps else "default")  # fmt: skip
    if mark.marker:
        face = "none" if mark.hollow else colour
        size = columns.get("size", np.full(x.shape, 9.0 if mark.marker == "tick" else 5.0))
        fill: Any = {"facecolors": face, "edgecolors": colour} if mark.marker != "tick" else {"color": colour}
        axes.scatter(x, y, s=np.square(size), marker=_MARKERS[mark.marker], zorder=3, **fill)
    if mark.kind == "bars":
        left, bottom = columns["left"], columns["bottom"]
        axes.bar(left, columns["top"] - bottom, columns["right"] - left, bottom, align="edge", color=colour,
                 alpha=mark.alpha, linewidth=0)  # fmt: skip
        x, y = columns["right"], 0.5 * (bottom + columns["top"])
    if mark.kind == "cells":
        _cells(figure, axes, columns, mark.reach)
    if mark.beside:
        centred = mark.kind == "cells"
        look: Any = (
            {"xytext": (0, 0), "ha": "center"} if centred else {"xytext": (9 if "size" in columns else 5, 0)}
        )
        shades = mark.shades if centred else ["black"] * len(mark.words)
        for a, b, words, shade in zip(x, y, mark.words, shades, strict=True):
            text = style.plain(words)
            axes.annotate(text, (a, b), textcoords="offset points", va="center", fontsize=7.0, color=shade, **look)


def _cells(figure: Any, axes: Axes, columns: dict[str, Any], size: float) -> None:
    x, y, value = columns["x"].astype(int), columns["y"].astype(int), columns["value"]
    grid = np.full((y.max() + 1, x.max() + 1), np.nan)
    grid[y, x] = value
    norm = TwoSlopeNorm(0.0, -size, size)
    image = axes.imshow(grid, cmap=matplotlib.colormaps["PuOr"], norm=norm, aspect="auto")
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label="change per unit [1]", shrink=0.8, extend="both")


def _handle(mark: Mark) -> Any:
    if mark.kind in ("bars", "area"):
        return Patch(color=mark.colour, alpha=mark.alpha)
    line: Any = _LINES[mark.dash] if mark.kind in ("line", "steps") else ""
    return Line2D([], [], color=mark.colour, linestyle=line, marker=_MARKERS[mark.marker] or None, markersize=5,
                  markerfacecolor="none" if mark.hollow else mark.colour)  # fmt: skip
