"""Stated plots as interactive charts: a subject at a time where there are several."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyperval.report.charts_base import Chart, Fill, chart_content
from hyperval.report.plots import Axis, Plots, View
from hyperval.report.text_cache import chart_models


def chart_of(plots: Plots) -> Chart:
    """The chart of plots; its models are kept for plots that look alike."""
    name, views = f"chart-{plots.name}", list(plots.views.values())
    looks = [
        (_axis(view.x), tuple((_axis(p.y), tuple(m.look for m in p.marks), p.rules) for p in view.parts))
        for view in views
    ]
    models = chart_models("plots", name, *looks[0])
    fills = [_fill(view) for view in views]
    subjects = tuple(plots.views) if len(views) > 1 else ()
    rest = [fill.packed() for fill in fills] if subjects else ()
    content = chart_content(models, Fill() if subjects else fills[0], rest)
    title = plots.title + (f". {plots.legend[0].upper()}{plots.legend[1:]}" if plots.legend else "")
    return Chart(name, plots.section, title, plots.alt, content, subjects)


def _axis(axis: Axis) -> tuple[str, str, int]:
    return axis.label, axis.scale, len(axis.names)


def _fill(view: View) -> Fill:
    fill = Fill()
    fill.ranges["x"] = view.ends()
    for number, part in enumerate(view.parts):
        low, high = view.ends(part)
        fill.ranges[f"y-{number}"] = (high, low) if part.y.scale == "names" else (low, high)
        for which, axis in (("x", view.x), ("y", part.y)):
            if axis.scale == "names":
                fill.names[f"names-{which}-{number}"] = axis.names
        for at, mark in enumerate(part.marks):
            source = f"m-{number}-{at}"
            columns: dict[str, Any] = {k: np.atleast_1d(v) for k, v in mark.columns.items()}
            fill.add(source, columns)
            if mark.words:
                fill.texts[source] = {"words": list(mark.words)}
            if mark.kind == "cells":
                reach = mark.reach
                fill.colours[f"{source}-colours"] = -reach, reach
                fill.texts[source]["shade"] = mark.shades
    return fill
