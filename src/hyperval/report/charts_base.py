"""What every interactive chart of a page is made of: an empty plot in the house's look, its legend, its JSON.

Bokeh writes a chart as data in JSON; the page has its script once, from the installed package, without a network.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt
from bokeh.core.types import ID
from bokeh.embed import json_item
from bokeh.models import (
    BoxSelectTool,
    BoxZoomTool,
    ColumnDataSource,
    LayoutDOM,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    WheelZoomTool,
)
from bokeh.plotting import figure

GREY = "#7a7f87"  # legible on white and on dark paper
_ABSORPTION = "#9aa0a8"
CURVE_COLOURS = ("#0072B2", "#C2410C", "#009E73", "#B4548F", "#5B3A8C", "#B58900")


@dataclass(frozen=True)
class Chart:
    """An interactive chart as the page holds it.

    Attributes
    ----------
    name, section, title, alt : as of a :class:`Drawing`
    content : JSON that the script draws
    subjects : those that a reader may choose among, the one that is shown at first before the others; maybe none
    """

    name: str
    section: str
    title: str
    alt: str
    content: str
    subjects: tuple[str, ...] = ()


def empty_plot(
    height: int, span: Range1d, label: str, absorption: ColumnDataSource | None = None, **more: Any
) -> Any:
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


def chart_legend(plot: Any) -> None:
    """Names that show or hide their line when they are clicked."""
    plot.legend.click_policy = "hide"
    plot.legend.background_fill_alpha = 0.0
    plot.legend.border_line_alpha = 0.0
    plot.legend.label_text_color = GREY


def column_text(values: npt.NDArray[Any]) -> str:
    """Little-endian float32 as base64."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


@dataclass
class Fill:
    """What the script sets in the models of a chart, which are drawn without numbers, by their names.

    Attributes
    ----------
    sources : of a source of columns: column -> its place in ``arrays``, which holds each array once
    ranges : start and end of a range
    spans : place of a line
    """

    sources: dict[str, dict[str, int]] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    spans: dict[str, float] = field(default_factory=dict)
    arrays: dict[str, int] = field(default_factory=dict)

    def add(self, source: str, columns: Mapping[str, npt.NDArray[Any]]) -> None:
        """Columns of a source."""
        self.sources[source] = {
            name: self.arrays.setdefault(column_text(values), len(self.arrays)) for name, values in columns.items()
        }

    def packed(self) -> dict[str, Any]:
        """As the script reads it."""
        return {
            "sources": self.sources,
            "ranges": self.ranges,
            "spans": self.spans,
            "arrays": list(self.arrays),
        }


def chart_content(models: str, fill: Fill, subjects: Sequence[Mapping[str, Any]] = ()) -> str:
    """The JSON of a chart: its models, and what the script fills them with."""
    rest = json.dumps({"fill": fill.packed(), "subjects": subjects}, separators=(",", ":"), ensure_ascii=False)
    # "<" cannot end the script that holds it.
    return f'{{"item":{models},{rest[1:]}'.replace("<", "\\u003c")


def chart_models(model: LayoutDOM, target: str) -> str:
    """The JSON of a chart's models, numbered as they stand in it: the same chart gives the same bytes.

    It takes long beside the numbers of a run, so callers keep it for every run whose charts are built alike.
    """
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
