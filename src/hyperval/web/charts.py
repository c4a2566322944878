"""The charts of the reports for one prediction, or for two beside each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hyperval.products import Prediction
from hyperval.report.charts import draw_charts
from hyperval.report.charts_base import Chart
from hyperval.report.charts_plots import chart_of
from hyperval.report.charts_scores import scores_chart
from hyperval.report.plots_scores import exceedance_plots


def charts_of(sides: Mapping[str, Prediction]) -> list[dict[str, Any]]:
    """Charts of a prediction, and of an earlier one where there are two."""
    now, *earlier = sides.values()
    both = now, earlier[0] if earlier else None
    labels = ("this run", "earlier run")
    scores = scores_chart([(label, side) for label, side in zip(labels, both, strict=True) if side is not None])
    false_alarms = [chart_of(plots) for plots in exceedance_plots((now, None))]
    charts = (*draw_charts(both, [], labels=labels), scores, *false_alarms)
    return [plain(chart) for chart in charts if chart is not None]


def plain(chart: Chart) -> dict[str, Any]:
    """A chart as a page fetches it."""
    return {
        "name": chart.name,
        "section": chart.section,
        "title": chart.title,
        "alt": chart.alt,
        "content": chart.content,
        "subjects": list(chart.subjects),
    }
