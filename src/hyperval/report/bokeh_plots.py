"""Models of stated plots (:mod:`hyperval.report.plots`): without numbers, which the page's script fills in."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, HoverTool, LayoutDOM, LinearColorMapper, Range1d
from bokeh.models.annotations import Span
from bokeh.models.tickers import FixedTicker
from bokeh.palettes import PuOr11

from hyperval.report import style
from hyperval.report.bokeh_base import absorption_bands, clickable_legend, empty_plot
from hyperval.report.plots import GREY

Axes = tuple[str, str, int]  # label, scale, number of names
_LEGEND_ROW = 22  # [px]
_PHONE = 52  # letters of a legend that a phone has room for
_ROW = 24  # [px] of a named row
_MARKERS = {  # and how far each is turned
    "circle": ("circle", 0.0), "square": ("square", 0.0), "tick": ("dash", 0.5 * np.pi),
    "left": ("triangle", 0.5 * np.pi), "right": ("triangle", -0.5 * np.pi),
}  # fmt: skip


def plots(x: Axes, parts: tuple[tuple[Axes, tuple[Any, ...], tuple[tuple[str, float], ...]], ...]) -> LayoutDOM:
    """Plots above each other over one x, as :mod:`hyperval.report.plots` states them; the script fills them."""
    span, drawn = Range1d(name="x"), []
    absorption = absorption_bands() if x[0] == style.WAVELENGTH_LABEL else None
    for number, (y, looks, rules) in enumerate(parts):
        named = x[1] == "names" or y[1] == "names"
        labels = {look[2] for look in looks} - {""}
        columns = max(_PHONE // (max(map(len, labels), default=0) + 5), 1)
        height = 90 + _ROW * y[2] + (100 if x[1] == "names" else 0) if named else (270, 190)[min(number, 1)]
        height += _LEGEND_ROW * -(-len(labels) // columns)
        scales: dict[str, Any] = {f"{k}_axis_type": "log" for k, (_, s, _) in (("x", x), ("y", y)) if s == "log"}
        plot = empty_plot(height, span, y[0], absorption, **scales)
        plot.y_range = Range1d(name=f"y-{number}")
        for which, axis, (_, scale, _) in (("x", plot.xaxis[0], x), ("y", plot.yaxis[0], y)):
            if scale == "names":
                axis.name, axis.ticker = f"names-{which}-{number}", FixedTicker(ticks=[])
                plot.grid[0 if which == "x" else 1].visible = False
                axis.major_label_orientation = 0.7 if which == "x" else "horizontal"
        if x[1] == "names":
            plot.min_width = 320 + 36 * x[2]  # a phone scrolls
        for at, look in enumerate(looks):
            _mark(plot, f"m-{number}-{at}", look, x, y)
        for which, place in rules:
            across: Any = "height" if which == "x" else "width"
            plot.add_layout(Span(location=place, dimension=across, line_color=GREY, line_dash="dotted"))
        if labels:
            clickable_legend(plot)
            plot.add_layout(plot.legend[0], "above")
            plot.legend.ncols, plot.legend.margin, plot.legend.padding = columns, 0, 2
            plot.legend.label_text_font_size = "11px"
        drawn.append(plot)
    drawn[-1].xaxis.axis_label = x[0]
    return column(*drawn, sizing_mode="stretch_width")


def _mark(plot: Any, name: str, look: tuple[Any, ...], x: Axes, y: Axes) -> None:
    """One series with what hovering over it tells."""
    kind, columns, label, colour, dash, marker, hollow, along, words, beside, alpha = look
    empty: dict[str, Any] = dict.fromkeys(columns, np.empty(0, np.float32)) | ({"words": []} if words else {})
    source = ColumnDataSource(empty, name=name)
    common: dict[str, Any] = {"source": source} | ({"legend_label": label} if label else {})
    interval = {"low", "high"} <= set(columns)
    drawn = []
    if kind == "area" or (interval and kind in ("line", "steps")):
        drawn.append(plot.varea("x", "low", "high", fill_color=colour, fill_alpha=alpha, **common))
    elif interval and along == "x":
        plot.segment("low", "y", "high", "y", color=colour, line_width=1.6, **common)
    elif interval:
        plot.segment("x", "low", "x", "high", color=colour, line_width=1.6, **common)
    if kind == "line":
        drawn = [plot.line("x", "y", color=colour, line_dash=dash, line_width=1.6, **common)]
    if kind == "steps":
        drawn = [plot.step("x", "y", color=colour, line_dash=dash, line_width=1.6, mode="after", **common)]
    if marker:
        shape, angle = _MARKERS[marker]
        fill = {"fill_color": colour, "fill_alpha": 0.0 if hollow else 1.0, "line_color": colour}
        size = "size" if "size" in columns else {"tick": 14}.get(marker, 7)
        drawn = [plot.scatter("x", "y", marker=shape, angle=angle, size=size, line_width=1.4, **fill, **common)]
    if kind == "bars":
        edges = {side: side for side in ("left", "right", "bottom", "top")}
        fill = {"fill_alpha": alpha, "line_alpha": min(2 * alpha, 1.0)}
        drawn = [plot.quad(color=colour, **edges, **fill, **common)]
    if kind == "cells":
        mapper = LinearColorMapper(palette=PuOr11[::-1], low=-1.0, high=1.0, name=f"{name}-colours")
        drawn = [
            plot.rect("x", "y", 1, 1, fill_color={"field": "value", "transform": mapper}, line_width=0, **common)
        ]
    drawn[-1].name = label or f"{name}-drawn"
    at = {"bars": ("right", "y"), "cells": ("x", "y")}.get(kind, ("x", "y"))
    if beside:
        place: Any = {"x_offset": 10 if "size" in columns else 6, "text_color": GREY}
        if kind == "cells":
            source.data["shade"], place = [], {"text_align": "center", "text_color": "shade"}
        plot.text(*at, text="words", source=source, text_font_size="10px", text_baseline="middle", **place)
    value = "@low to @high" if kind == "area" else "@y" + (" (@low to @high)" if interval and along == "y" else "")
    across = "@x" + (" (@low to @high)" if interval and along == "x" else "")
    tips = [("", "$name")] * bool(label) + [("", "@words")] * words
    if kind == "bars":
        tips += [(x[0], "@left to @right")]
    elif kind == "cells":
        tips += [("", "@value")]
    else:
        tips += [(axis[0], text) for axis, text in ((x, across), (y, value)) if axis[1] != "names"]
    plot.add_tools(HoverTool(tooltips=tips, renderers=drawn[-1:]))
