"""Plots of spread and its consequences: stated, told in words, drawn for print with the same bytes again."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from test_report_charts import numbers

from hyperval.products import Abundance, ClassificationError, ObservedProducts, PredictedProducts
from hyperval.report.charts import chart_of
from hyperval.report.figures import drawing_of
from hyperval.report.plots_run import (
    class_error_plots,
    every_plot,
    sampled_eigenvalue_plots,
    tail_plots,
    unmixing_plots,
)
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.style import house_style
from hyperval.results import Result, ResultTable
from hyperval.spectra.axis import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0]), 10.0)


def eigenvalues():
    e = np.geomspace(10.0, 1e-4, 20)
    spectrum = EigenvalueSpectrum(1.02 * e, e, 0.95 * e, 1.05 * e, 5000)
    return sampled_eigenvalue_plots({("grass $x$", "radiance"): spectrum})


def tails():
    d = np.linspace(0.5, 9.0, 30)
    share = np.exp(-d)
    curve = TailCurve(d, share, 0.8 * share, 1.2 * share, None, share**2, share, None, 6.0, 4, 900)
    return tail_plots({"grass": curve})


def classes():
    found = ClassificationError(0.1, 0.08, 0.13, 400, 300.0, 1.0, 0.09, 0.03, 0.2)
    none = ClassificationError(0.0, 0.0, 0.01, 400, 400.0, 9.0, 1e-9, 1e-14, 1e-7)
    held = {("a / b", "2 bands"): found, ("a / c", "2 bands"): none}
    sides = PredictedProducts(AXIS, classification=held), ObservedProducts(AXIS, classification=held)
    return class_error_plots(sides)


def areas():
    held = {(f"t{i}", "fcls"): Abundance(a, 0.1 * a, 4, a) for i, a in enumerate((1.0, 1.0, 4.0, 4.0))}
    rows = [
        Result(
            "c", "abundance", f"all targets of {a} m2", "fcls", f"area_rmse_{side}", 0.2, "m2", lower=0.1, upper=0.5
        )
        for a in (1, 4) for side in ("predicted", "observed")
    ]  # fmt: skip
    return unmixing_plots((PredictedProducts(AXIS, abundance=held), ObservedProducts(AXIS, abundance=held)), rows)


@pytest.mark.parametrize(
    ("draw", "section", "words"),
    [
        (eigenvalues, "covariance", "20 of 20 inside"),
        (tails, "covariance", "6 degrees of freedom measured"),
        (classes, "classification", "a / b, 2 bands: predicted 0.1 (0.08 to 0.1)"),
        (areas, "abundance", "predicted: 0.2 m² at 1 m², 0.2 m² at 4 m²"),
    ],
)
def test_drawn_and_told(draw, section, words):
    (plots,), (same,) = draw(), draw()
    with house_style():
        drawing, again = (drawing_of(one, simulated=True) for one in (plots, same))
    assert drawing.section == section
    assert words in drawing.alt
    assert drawing.content.startswith(b"<?xml")
    assert len(drawing.content) > 5000
    assert drawing.content == again.content
    chart = chart_of(plots)
    assert (chart.alt, chart.section) == (drawing.alt, section)
    assert chart.content == chart_of(same).content


def test_charts_hold_the_numbers_and_a_subject_each():
    """The ratio below eigenvalues is that of the columns above; of classes without error the axis has an end."""
    (chart,) = map(chart_of, eigenvalues())
    fill = json.loads(chart.content)["fill"]
    above, measured, below = (
        {name: numbers(fill["arrays"][i]) for name, i in fill["sources"][source].items()}
        for source in ("m-0-0", "m-0-1", "m-1-0")
    )
    np.testing.assert_allclose(above["y"] / measured["y"], below["y"], rtol=1e-6)
    np.testing.assert_allclose(below["high"], 1.05 / 1.02, rtol=1e-6)
    (plots,) = areas()
    two = dataclasses.replace(plots, views={"a": plots.views["fcls"], "b": plots.views["fcls"]})
    content = json.loads(chart_of(two).content)
    assert (chart_of(two).subjects, len(content["subjects"])) == (("a", "b"), 2)
    assert content["fill"]["sources"] == {}
    (plots,) = classes()
    view = plots.views[""]
    assert view.ends()[0] > 0.0
    assert all((mark.columns["low"] > 0.0).all() for mark in view.parts[0].marks if "low" in mark.columns)


def test_nothing_to_draw():
    nothing = PredictedProducts(AXIS), ObservedProducts(AXIS)
    assert every_plot(nothing, ResultTable(), {}, {}, None) == []
