"""Models of the interactive charts, which the script of a page fills: all that needs Bokeh to be imported.

Bokeh writes a chart as data in JSON.  It takes a second to import, and a hundred times as long to build the models
as a run's numbers take, so ``text_cache.chart_models`` keeps what :func:`models_json` gives.
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
    ColumnDataSource,
    DataRange1d,
    HoverTool,
    LayoutDOM,
    LinearColorMapper,
    Range1d,
    TabPanel,
    Tabs,
)
from bokeh.models.annotations import ColorBar, Span
from bokeh.palettes import RdBu11

from hyperval.report import style
from hyperval.report.bokeh_base import absorption_bands, clickable_legend, empty_plot
from hyperval.report.bokeh_plots import plots
from hyperval.report.charts_base import CURVE_COLOURS, FIRST_CURVES, LABELS, Curves, Labels
from hyperval.report.plots import GREY
from hyperval.report.style import COLLECTED, PREDICTED

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
            lines.append(
                plot.line("nm", band, source=source, color=colour, line_dash=dash, line_width=1.6, **named)
            )
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
        tips = [
            (shown[band], f"@{band}{{0.0000}} (@{band}_low{{0.0000}} to @{band}_high{{0.0000}})") for band in names
        ]
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
        TabPanel(title=detector, child=_density_plot(i, detector, curves))
        for i, (detector, curves) in enumerate(tabs)
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
    plot.add_tools(
        HoverTool(tooltips=[("", "$name"), ("score", "@score"), ("density", "@density")], renderers=lines)
    )
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
