"""What every kind of chart is built of: an empty plot in the house's look, its legend, bands of absorption."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.models import BoxSelectTool, BoxZoomTool, ColumnDataSource, PanTool, ResetTool, SaveTool, WheelZoomTool
from bokeh.plotting import figure

from hyperval.report.plots import GREY
from hyperval.spectra.windows import ABSORPTION_BANDS_NM

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
