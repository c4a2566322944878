"""Figures of objects, transforms, exceedance and differences of P_D."""

from __future__ import annotations

import tracemalloc
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from scipy.stats import norm

from hyperval.products import ExceedanceCurve, ObjectScores, Observation, Prediction, RocCurve
from hyperval.report import Quicklook, ScoreMap
from hyperval.report.charts_plots import chart_of
from hyperval.report.figures_plots import drawing_of
from hyperval.report.pictures import quicklook_figure, score_map_figures
from hyperval.report.plots_scores import (
    exceedance_plots,
    object_score_plots,
    roc_difference_plots,
    transform_plots,
)
from hyperval.report.style import house_style
from hyperval.spectra.axis import SpectralAxis

AXIS = SpectralAxis(np.linspace(400.0, 900.0, 5), np.full(5, 5.0))


def sides(objects=1):
    rng = np.random.default_rng(1)
    names = [f"target {i} & $x$" for i in range(6)]
    predicted = {(n, "cem"): ObjectScores(rng.normal(0.5, 0.1, (20, 50))) for n in names}
    measured = {
        (n, "cem"): ObjectScores(rng.normal(0.5, 0.1, objects), tuple(map(str, range(objects)))) for n in names
    }
    measured[names[0], "cem"] = ObjectScores(np.full(objects, 0.95), ("far",) * objects)
    x = np.linspace(0.0, 4.0, 50)
    p = norm.sf(x)
    pfa = np.geomspace(1e-4, 0.999, 40)
    pd = np.linspace(0.3, 1.0, 40)
    curves = [RocCurve(pfa, y, y - 0.1, np.minimum(y + 0.1, 1.0), norm.isf(pfa), "object", n, b) for y, n, b in (
        (pd, None, None), (np.clip(pd - 0.05, 0, 1), 40, 10_000))]  # fmt: skip
    key = (names[1], "cem", "object")
    return (
        Prediction(AXIS, object_scores=predicted, exceedance={(names[1], "cem"): ExceedanceCurve(x, p, p, p)},
                   roc={key: curves[0]}),
        Observation(AXIS, object_scores=measured, roc={key: curves[1]},
                    exceedance={(names[1], "cem"): ExceedanceCurve(
                        x[:30], p[:30], p[:30] / 2, np.full(30, np.nan), 9999)}),
    )  # fmt: skip


def drawn(function, *arguments):
    with house_style():
        return function(*arguments, simulated=True)


def printed(function, *arguments):
    with house_style():
        return [drawing_of(plots, simulated=True) for plots in function(*arguments)]


@pytest.mark.parametrize(
    ("function", "arguments", "name"),
    [
        (object_score_plots, (), "object-scores"),
        (transform_plots, (), "object-transforms"),
        (exceedance_plots, (), "exceedance"),
        (roc_difference_plots, (0.1,), "roc-difference"),
    ],
)
def test_each_figure_is_drawn_the_same_twice(function, arguments, name):
    first, again = (printed(function, sides(), *arguments) for _ in range(2))
    assert [d.name for d in first] == [name]
    assert first[0].content == again[0].content
    ElementTree.fromstring(first[0].content)  # noqa: S314 - our own
    assert len(first[0].alt) > 60
    (chart,) = map(chart_of, function(sides(), *arguments))
    assert (chart.alt, chart.name) == (first[0].alt, f"chart-{name}")


def test_texts_say_what_is_drawn():
    (figure,) = object_score_plots(sides())
    assert "target 0 & $x$ cem: 0.95, predicted 0." in figure.alt
    assert ", outside" in figure.alt
    (figure,) = transform_plots(sides())
    assert "6 objects" in figure.alt
    (figure,) = roc_difference_plots(sides(), None)
    assert "+0.05" in figure.alt


def test_groups_are_judged_together_alone():
    assert object_score_plots(sides(objects=12)) == []
    (figure,) = transform_plots(sides(objects=12))
    assert "72 objects" in figure.alt


def test_pictures_are_drawn_in_little_memory():
    # 44 and 32 MB; float64 in four colours took 75 and 72
    shape = (600, 900)
    scene = Quicklook(np.full((*shape, 3), 100, np.uint8))
    scores = {"a": ScoreMap(np.linspace(0.0, 1.0, 600 * 900).reshape(shape))}
    drawn(score_map_figures, {"a": ScoreMap(np.eye(3))})  # what is loaded with the first
    tracemalloc.start()
    drawn(quicklook_figure, scene)
    scene_peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    drawn(score_map_figures, scores)
    map_peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert scene_peak < 55e6
    assert map_peak < 55e6
