"""The interactive chart of detector scores: density of each population over the score, a tab for each detector."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from bokeh.models import ColumnDataSource, HoverTool, Range1d, TabPanel, Tabs

from hyperval.products import Products, ScoreDistribution
from hyperval.report import style
from hyperval.report.charts_base import (
    CURVE_COLOURS,
    Chart,
    Fill,
    chart_content,
    chart_legend,
    chart_models,
    empty_plot,
)

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
    fill = Fill()
    tabs = tuple((detector, _fill_densities(fill, i, sides, detector)) for i, detector in enumerate(detectors))
    names = list(dict.fromkeys(subject for _, side in sides for subject, _ in side.scores))
    return Chart(
        "chart-scores",
        "scores",
        "Scores: probability density of each population and of the background; a click on a name shows or hides it",
        f"Probability density (logarithmic) of the detector's score, a tab for each detector. "
        f"Populations: {', '.join(names[:_MOST])}.",
        chart_content(_density_models(tabs), fill),
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


def _fill_densities(
    fill: Fill, tab: int, sides: Sequence[tuple[str, Products]], detector: str
) -> tuple[tuple[str, int, str], ...]:
    """Note the numbers of one detector's curves; label and number of the side, and subject, of each."""
    curves = [
        (label, number, subject, *density_of(score))
        for number, (label, side) in enumerate(sides)
        for subject, score in [(s, v) for (s, d), v in side.scores.items() if d == detector and v.sd > 0][:_MOST]
    ]
    low = min((float(x[0]) for *_, x, _ in curves), default=0.0)
    high = max((float(x[-1]) for *_, x, _ in curves), default=1.0)
    top = max((float(np.nanmax(y)) for *_, y in curves), default=1.0)
    fill.ranges[f"score-{tab}"], fill.ranges[f"density-{tab}"] = (low, high), (top * _DEEPEST, 2.0 * top)
    for place, (*_, x, y) in enumerate(curves):
        fill.add(f"density-{tab}-{place}", {"score": x, "density": np.maximum(y, top * _DEEPEST / 10)})
    return tuple((label, number, subject) for label, number, subject, *_ in curves)


@lru_cache(maxsize=64)
def _density_models(tabs: tuple[tuple[str, tuple[tuple[str, int, str], ...]], ...]) -> str:
    """Tabs of densities, which the script fills."""
    panels = [
        TabPanel(title=detector, child=_plot(i, detector, curves)) for i, (detector, curves) in enumerate(tabs)
    ]
    return chart_models(Tabs(tabs=panels, sizing_mode="stretch_width"), "chart-scores")


def _plot(tab: int, detector: str, curves: Sequence[tuple[str, int, str]]) -> Any:
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
    chart_legend(plot)
    if curves:
        plot.add_layout(plot.legend[0], "right")
    return plot
