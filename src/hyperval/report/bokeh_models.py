"""Models of the interactive charts, which the script of a page fills: all that needs Bokeh to be imported.

Bokeh writes a chart as data in JSON.  It takes a second to import, and a hundred times as long to build the models
as a run's numbers take, so ``charts.chart_models`` keeps what :func:`models_json` gives.

What every kind of chart is built of: an empty plot in the house's look, its legend, bands of absorption.

Models of stated plots (:mod:`hyperval.report.plots`): without numbers, which the page's script fills in.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from bokeh.core.types import ID
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import (
    BoxSelectTool,
    BoxZoomTool,
    ColumnDataSource,
    DataRange1d,
    HoverTool,
    LayoutDOM,
    LinearColorMapper,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    TabPanel,
    Tabs,
    WheelZoomTool,
)
from bokeh.models.annotations import ColorBar, Span
from bokeh.models.tickers import FixedTicker
from bokeh.palettes import PuOr11, RdBu11
from bokeh.plotting import figure

from hyperval.report import style
from hyperval.report.charts_base import CURVE_COLOURS, FIRST_CURVES, LABELS, Curves, Labels
from hyperval.report.plots import GREY
from hyperval.report.style import COLLECTED, PREDICTED
from hyperval.spectra.axis import ABSORPTION_BANDS_NM

_ABSORPTION = "#9aa0a8"


def absorption_bands() -> ColumnDataSource:
    """Where a gas absorbs [nm]."""
    starts, ends, _ = zip(*ABSORPTION_BANDS_NM, strict=True)
    return ColumnDataSource({"start": np.array(starts, np.float32), "end": np.array(ends, np.float32)})


def empty_plot(height: int, span: Any, label: str, absorption: ColumnDataSource | None = None, **more: Any) -> Any:
    """An empty plot in the house's look, legible on white and on dark paper."""
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        x_range=span,
        y_axis_label=label,
        tools=[PanTool(), BoxZoomTool(), WheelZoomTool(), ResetTool(), SaveTool()],
        toolbar_location="above",
        background_fill_alpha=0.0,
        border_fill_alpha=0.0,
        outline_line_color=None,
        min_border_left=72,  # so that plots above each other have one wavelength axis
        **more,
    )
    plot.toolbar.logo = None
    if absorption is not None:
        plot.add_tools(BoxSelectTool(dimensions="width"))
        plot.vstrip("start", "end", source=absorption, fill_color=_ABSORPTION, fill_alpha=0.22, line_alpha=0.0)
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_color = axis.major_label_text_color = axis.axis_line_color = GREY
        axis.major_tick_line_color = axis.minor_tick_line_color = GREY
        axis.axis_label_text_font_style = "normal"
    plot.grid.grid_line_color = GREY
    plot.grid.grid_line_alpha = 0.25
    return plot


def clickable_legend(plot: Any) -> None:
    """Names that show or hide their line when they are clicked."""
    plot.legend.click_policy = "hide"
    plot.legend.background_fill_alpha = 0.0
    plot.legend.border_line_alpha = 0.0
    plot.legend.label_text_color = GREY


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
        drawn = [plot.rect("x", "y", 1, 1, fill_color={"field": "value", "transform": mapper}, line_width=0, **common)]
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


_LOOKS = {
    "predicted": (PREDICTED.colour, "dashed"),
    "collected": (COLLECTED.colour, "solid"),
    "difference": (style.DIFFERENCE_COLOUR, "solid"),
}


def models_json(kind: str, target: str, *arguments: Any) -> str:
    """The JSON of the models of a kind of chart, for the place ``target`` of a page."""
    return _numbered(_KINDS[kind](*arguments), target)


def spectra(bands: tuple[str, ...], numbered: bool, label: str, ratio: bool, labels: Labels) -> LayoutDOM:
    """The plot of both sides, with that of their difference where ``bands`` has one; the script fills it."""
    columns = [f"{band}{end}" for band in bands for end in ("", "_low", "_high")]
    empty: dict[str, Any] = dict.fromkeys(("nm", *columns), np.empty(0, np.float32))
    source = ColumnDataSource(empty, name="spectra")
    absorption = absorption_bands()
    span = Range1d(name="nm")
    plots = []
    shown = {**dict(zip(LABELS, labels, strict=True)), "difference": "difference"}
    sides = [band for band in bands if band != "difference"]
    at = ("band", "@nm{0}") if numbered else ("nm", "@nm{0.0}")
    for height, range_name, axis_label, names in (
        (300, "level", label, sides),
        (190, "gap", "difference ratio [1]" if ratio else "difference [1]", ["difference"]),
    ):
        if names[0] not in bands:
            continue
        plot = empty_plot(height, span, axis_label, None if numbered else absorption)
        plot.y_range = Range1d(name=range_name)
        lines = []
        for band in names:
            colour, dash = _LOOKS[band]
            plot.varea("nm", f"{band}_low", f"{band}_high", source=source, fill_color=colour, fill_alpha=0.2)
            named = {} if band == "difference" else {"legend_label": shown[band]}
            lines.append(plot.line("nm", band, source=source, color=colour, line_dash=dash, line_width=1.6, **named))
            # Bands that are chosen in one plot stand out in both: their source is one.
            plot.scatter(
                "nm",
                band,
                source=source,
                size=5,
                color=colour,
                alpha=0.0,
                selection_alpha=1.0,
                nonselection_alpha=0.0,
            )
        tips = [(shown[band], f"@{band}{{0.0000}} (@{band}_low{{0.0000}} to @{band}_high{{0.0000}})") for band in names]
        plot.add_tools(HoverTool(tooltips=[at, *tips], mode="vline", renderers=lines[:1]))
        if range_name == "level":
            clickable_legend(plot)
        else:
            plot.add_layout(Span(location=0.0, dimension="width", line_color=GREY))
        plots.append(plot)
    plots[-1].xaxis.axis_label = "number of the band" if numbered else style.WAVELENGTH_LABEL
    return column(*plots, sizing_mode="stretch_width")


def curves(tabs: tuple[tuple[str, Curves], ...], labels: Labels) -> LayoutDOM:
    """Tabs of ROC curves; the first few are seen, the others when their name is clicked."""
    panels = [TabPanel(title=title, child=_curve_plot(i, own, labels)) for i, (title, own) in enumerate(tabs)]
    return Tabs(tabs=panels, sizing_mode="stretch_width")


def _curve_plot(tab: int, own: Curves, labels: Labels) -> Any:
    plot = empty_plot(420, Range1d(start=1e-3, end=1.0, name=f"pfa-{tab}"), "P_D [1]", x_axis_type="log")
    plot.y_range = Range1d(start=-0.02, end=1.04)
    lines = []
    plot.xaxis.axis_label = "P_FA per pixel [1]"
    second = "measured" if labels == LABELS else labels[1]
    for number, (subject, sides) in enumerate(own.subjects):
        colour, seen = CURVE_COLOURS[number % len(CURVE_COLOURS)], number < FIRST_CURVES
        name = style.shortened(subject, 30)
        for side in sides:
            words, dash = ((labels[0], "dashed"), (second, "solid"))[side]
            empty: dict[str, Any] = dict.fromkeys(("pfa", "pd", "low", "high"), np.empty(0, np.float32))
            source = ColumnDataSource(empty, name=f"curve-{tab}-{number}-{side}")
            common: dict[str, Any] = {"source": source, "legend_label": name, "visible": seen}
            plot.varea("pfa", "low", "high", fill_color=colour, fill_alpha=0.12, **common)
            drawn = plot.line if words != "measured" else plot.step
            more = {} if words != "measured" else {"mode": "after"}
            look = {"color": colour, "line_dash": dash, "line_width": 1.6, "name": f"{name}, {words}"}
            lines.append(drawn("pfa", "pd", **look, **more, **common))
            for curve in plot.renderers[-2:]:
                curve.tags = [subject, seen]
    tips = [("", "$name"), ("P_FA", "@pfa"), ("P_D", "@pd{0.000} (@low{0.000} to @high{0.000})")]
    plot.add_tools(HoverTool(tooltips=tips, renderers=lines, mode="mouse"))
    if own.is_counted:
        line = Span(location=1.0, dimension="height", line_color=GREY, line_dash="dotted", name=f"counted-{tab}")
        plot.add_layout(line)
    clickable_legend(plot)
    plot.add_layout(plot.legend[0], "right")
    return plot


def densities(tabs: tuple[tuple[str, tuple[tuple[str, int, str], ...]], ...]) -> LayoutDOM:
    """Tabs of densities, which the script fills."""
    panels = [
        TabPanel(title=detector, child=_density_plot(i, detector, curves)) for i, (detector, curves) in enumerate(tabs)
    ]
    return Tabs(tabs=panels, sizing_mode="stretch_width")


def _density_plot(tab: int, detector: str, curves: Sequence[tuple[str, int, str]]) -> Any:
    plot = empty_plot(360, Range1d(name=f"score-{tab}"), "density [1]", y_axis_type="log")
    plot.y_range = Range1d(start=1e-3, end=1.0, name=f"density-{tab}")
    plot.xaxis.axis_label = f"score of {detector} [1]"
    subjects = list(dict.fromkeys(subject for _, _, subject in curves))
    lines = []
    for place, (label, number, subject) in enumerate(curves):
        empty: dict[str, Any] = dict.fromkeys(("score", "density"), np.empty(0, np.float32))
        source = ColumnDataSource(empty, name=f"density-{tab}-{place}")
        name = style.shortened(subject, 30)
        lines.append(
            plot.line(
                "score", "density", source=source, legend_label=name, name=f"{name}, {label}",
                color=CURVE_COLOURS[subjects.index(subject) % len(CURVE_COLOURS)], line_width=1.6,
                line_dash="dashed" if number else "solid",
            )
        )  # fmt: skip
    plot.add_tools(HoverTool(tooltips=[("", "$name"), ("score", "@score"), ("density", "@density")], renderers=lines))
    clickable_legend(plot)
    if curves:
        plot.add_layout(plot.legend[0], "right")
    return plot


def objects(maps: tuple[str, ...]) -> LayoutDOM:
    """A map of objects above the histogram of their scores, a tab for each score map; both share what is chosen."""
    return Tabs(
        tabs=[TabPanel(title=name, child=_objects_of(tab)) for tab, name in enumerate(maps)],
        sizing_mode="stretch_width",
    )


def _objects_of(tab: int) -> LayoutDOM:
    columns = ("sample", "line", "measured", "predicted", "difference")
    empty: dict[str, Any] = dict.fromkeys(columns, np.empty(0, np.float32))
    source = ColumnDataSource({**empty, "name": []}, name=f"objects-{tab}")
    mapper = LinearColorMapper(palette=RdBu11, low=-1.0, high=1.0, name=f"difference-{tab}")
    place = empty_plot(380, DataRange1d(), "line [pixel]", match_aspect=True)
    place.y_range = DataRange1d(flipped=True)
    place.xaxis.axis_label = "sample [pixel]"
    chosen: dict[str, Any] = {"nonselection_alpha": 0.12}
    dots = place.scatter(
        "sample", "line", source=source, size=9, line_color=GREY,
        fill_color={"field": "difference", "transform": mapper}, **chosen,
    )  # fmt: skip
    bar = ColorBar(color_mapper=mapper, title="measured - predicted [1]", background_fill_alpha=0.0)
    bar.title_text_color = bar.major_label_text_color = GREY
    place.add_layout(bar, "right")
    tips = [("", "@name"), ("measured [1]", "@measured"), ("predicted median [1]", "@predicted")]
    place.add_tools(HoverTool(tooltips=tips, renderers=[dots]), BoxSelectTool())
    bins: dict[str, Any] = dict.fromkeys(("left", "right", "measured", "predicted"), np.empty(0, np.float32))
    counts = ColumnDataSource(bins, name=f"bins-{tab}")
    scores = empty_plot(240, Range1d(name=f"score-{tab}"), "number of objects [1]")
    scores.y_range = Range1d(name=f"count-{tab}")
    scores.xaxis.axis_label = "greatest score over the object's pixels [1]"
    edges: dict[str, Any] = {"left": "left", "right": "right", "bottom": 0, "source": counts}
    bars = [
        scores.quad(
            top="measured", legend_label="measured", fill_color=COLLECTED.colour, fill_alpha=0.35,
            line_color=COLLECTED.colour, **edges,
        ),
        scores.quad(
            top="predicted", legend_label="predicted", fill_alpha=0.0, line_color=PREDICTED.colour,
            line_dash="dashed", line_width=1.6, **edges,
        ),
    ]  # fmt: skip
    scores.scatter("measured", 0, source=source, size=7, color=COLLECTED.colour, **chosen)
    tips = [("score [1]", "@left to @right"), ("measured", "@measured"), ("predicted", "@predicted{0.0}")]
    scores.add_tools(HoverTool(tooltips=tips, renderers=bars[:1]), BoxSelectTool(dimensions="width"))
    clickable_legend(scores)
    return column(place, scores, sizing_mode="stretch_width")


def _numbered(model: LayoutDOM, target: str) -> str:
    """The JSON of a chart's models, numbered as they stand in it: the same chart gives the same bytes."""
    item: Any = json_item(model, ID(target))
    numbers: dict[str, str] = {}

    def named(value: Any) -> None:
        if isinstance(value, dict):
            if isinstance(value.get("id"), str):
                numbers.setdefault(value["id"], f"c{len(numbers)}")
            for part in value.values():
                named(part)
        elif isinstance(value, list):
            for part in value:
                named(part)

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: renamed(part) for key, part in value.items()}
        if isinstance(value, list):
            return [renamed(part) for part in value]
        return numbers.get(value, value) if isinstance(value, str) else value

    named(item["doc"])
    return json.dumps(renamed(item), separators=(",", ":"), ensure_ascii=False)


_KINDS: dict[str, Callable[..., LayoutDOM]] = {
    "spectra": spectra,
    "curves": curves,
    "densities": densities,
    "objects": objects,
    "plots": plots,
}
