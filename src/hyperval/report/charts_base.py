"""What every interactive chart of a page is made of: an empty plot in the house's look, its legend, its JSON.

Bokeh writes a chart as data in JSON; the page has its script once, from the installed package, without a network.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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


def chart_content(model: LayoutDOM, target: str, subjects: Sequence[Mapping[str, Any]] = ()) -> str:
    """The JSON of a chart, its models numbered as they stand in it: the same run gives the same bytes."""
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
    content = {"item": renamed(item), "subjects": subjects}
    # "<" cannot end the script that holds it.
    return json.dumps(content, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
