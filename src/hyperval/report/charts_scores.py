"""The interactive chart of detector scores: density of each population over the score, a tab for each detector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from bokeh.models import ColumnDataSource, HoverTool, Range1d, TabPanel, Tabs

from hyperval.products import Products, ScoreDistribution
from hyperval.report import style
from hyperval.report.charts_base import CURVE_COLOURS, Chart, chart_content, chart_legend, empty_plot

Array = npt.NDArray[np.float64]
_MOST = 12  # populations of a detector
_SPAN = 5.0  # standard deviations about the mean, where the density is not stated
_DEEPEST = 1e-8  # part of the greatest density


def scores_chart(sides: Sequence[tuple[str, Products]]) -> Chart | None:
    """Densities of the detectors' scores; None without any.

    A density that the product does not state is that of the normal law with its moments.  Sides after the first are
    dashed.
    """
    detectors = list(dict.fromkeys(detector for _, side in sides for _, detector in side.scores))
    if not detectors:
        return None
    tabs = [TabPanel(title=detector, child=_densities(sides, detector)) for detector in detectors]
    names = list(dict.fromkeys(subject for _, side in sides for subject, _ in side.scores))
    return Chart(
        "chart-scores",
        "scores",
        "Scores: probability density of each population and of the background; a click on a name shows or hides it",
        f"Probability density (logarithmic) of the detector's score, a tab for each detector. "
        f"Populations: {', '.join(names[:_MOST])}.",
        chart_content(Tabs(tabs=tabs, sizing_mode="stretch_width"), "chart-scores"),
    )


def density_of(score: ScoreDistribution) -> tuple[Array, Array]:
    """Scores (G,) [1] and the probability density (G,) at each [per unit of score].

    Examples
    --------
    >>> score, density = density_of(ScoreDistribution(0.5, 0.1))
    >>> round(float(np.trapezoid(density, score)), 5)
    1.0
    """
    if score.grid is not None and score.density is not None:
        return score.grid, score.density
    z = np.linspace(-_SPAN, _SPAN, 201)
    return score.mean + score.sd * z, np.exp(-0.5 * z**2) / (score.sd * np.sqrt(2.0 * np.pi))


def _densities(sides: Sequence[tuple[str, Products]], detector: str) -> Any:
    curves = [
        (label, number, subject, *density_of(score))
        for number, (label, side) in enumerate(sides)
        for subject, score in [(s, v) for (s, d), v in side.scores.items() if d == detector and v.sd > 0][:_MOST]
    ]
    low = min((float(x[0]) for *_, x, _ in curves), default=0.0)
    high = max((float(x[-1]) for *_, x, _ in curves), default=1.0)
    top = max((float(np.nanmax(y)) for *_, y in curves), default=1.0)
    plot = empty_plot(360, Range1d(start=low, end=high), "density [1]", y_axis_type="log")
    plot.y_range = Range1d(start=top * _DEEPEST, end=2.0 * top)
    plot.xaxis.axis_label = f"score of {detector} [1]"
    subjects = list(dict.fromkeys(subject for _, _, subject, *_ in curves))
    lines = []
    for label, number, subject, x, y in curves:
        data = {"score": x.astype(np.float32), "density": np.maximum(y, top * _DEEPEST / 10).astype(np.float32)}
        name = style.shortened(subject, 30)
        lines.append(
            plot.line(
                "score", "density", source=ColumnDataSource(data), legend_label=name, name=f"{name}, {label}",
                color=CURVE_COLOURS[subjects.index(subject) % len(CURVE_COLOURS)], line_width=1.6,
                line_dash="dashed" if number else "solid",
            )
        )  # fmt: skip
    plot.add_tools(
        HoverTool(tooltips=[("", "$name"), ("score", "@score"), ("density", "@density")], renderers=lines)
    )
    chart_legend(plot)
    if curves:
        plot.add_layout(plot.legend[0], "right")
    return plot
