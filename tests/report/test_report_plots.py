"""Plots of spread and its consequences: stated, told in words, drawn for print with the same bytes again."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from test_report_charts import stated

from hyperval.figures import (
    EigenvalueSpectrum,
    TailCurve,
    class_error_figure,
    drawings_of,
    further_figures,
    sampled_eigenvalue_figures,
    statement,
    tail_figure,
    unmixing_figure,
)
from hyperval.products import Abundance, ClassificationError, ObservedProducts, PredictedProducts
from hyperval.results import Result, ResultTable
from hyperval.spectra import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0]), 10.0)


def eigenvalues():
    e = np.geomspace(10.0, 1e-4, 20)
    spectrum = EigenvalueSpectrum(1.02 * e, e, 0.95 * e, 1.05 * e, 5000)
    (figure,) = sampled_eigenvalue_figures({("grass $x$", "radiance"): spectrum})
    return figure


def tails():
    d = np.linspace(0.5, 9.0, 30)
    share = np.exp(-d)
    curve = TailCurve(d, share, 0.8 * share, 1.2 * share, None, share**2, share, None, 6.0, 4, 900)
    return tail_figure({"grass": curve})


def classes():
    found = ClassificationError(0.1, 0.08, 0.13, 400, 300.0, 1.0, 0.09, 0.03, 0.2)
    none = ClassificationError(0.0, 0.0, 0.01, 400, 400.0, 9.0, 1e-9, 1e-14, 1e-7)
    held = {("a / b", "2 bands"): found, ("a / c", "2 bands"): none}
    sides = PredictedProducts(AXIS, classification=held), ObservedProducts(AXIS, classification=held)
    return class_error_figure(sides)


def areas():
    held = {(f"t{i}", "fcls"): Abundance(a, 0.1 * a, 4, a) for i, a in enumerate((1.0, 1.0, 4.0, 4.0))}
    rows = [
        Result(
            "c", "abundance", f"all targets of {a} m2", "fcls", f"area_rmse_{side}", 0.2, "m2", lower=0.1, upper=0.5
        )
        for a in (1, 4) for side in ("predicted", "observed")
    ]  # fmt: skip
    return unmixing_figure((PredictedProducts(AXIS, abundance=held), ObservedProducts(AXIS, abundance=held)), rows)


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
    figure, same = draw(), draw()
    (drawing,), (again,) = (drawings_of([one], simulated=True) for one in (figure, same))
    assert drawing.section == section
    assert words in drawing.alt
    assert drawing.content.startswith(b"<?xml")
    assert len(drawing.content) > 5000
    assert drawing.content == again.content
    assert statement(figure) == statement(same)


def test_statements_hold_the_numbers_and_a_view_each():
    """The ratio below eigenvalues is that of the columns above; of classes without error the axis has an end."""
    above, below = stated(eigenvalues())["views"][0]["parts"]
    predicted, measured = (mark["columns"] for mark in above["marks"])
    ratio = below["marks"][0]["columns"]
    np.testing.assert_allclose(predicted["y"] / measured["y"], ratio["y"], rtol=1e-6)
    np.testing.assert_allclose(ratio["high"], 1.05 / 1.02, rtol=1e-6)
    figure = areas()
    two = dataclasses.replace(figure, views=figure.views * 2)
    assert len(stated(two)["columns"]) == len(stated(figure)["columns"])
    (view,) = classes().views
    assert view.ends("x")[0] > 0.0
    assert all((mark.columns["low"] > 0.0).all() for mark in view.parts[0].marks if "low" in mark.columns)


def test_more_subjects_than_have_room_are_on_further_sheets():
    figure = areas()
    many = dataclasses.replace(figure, views=figure.views * 30)
    drawings = drawings_of([many], simulated=False)
    assert [drawing.name for drawing in drawings] == ["unmixing-areas-1", "unmixing-areas-2"]
    assert all(drawing.title.endswith("; 24 of 30 are drawn, all are in products.nc") for drawing in drawings)


def test_nothing_to_draw():
    nothing = PredictedProducts(AXIS), ObservedProducts(AXIS)
    assert further_figures(nothing, ResultTable(), {}, {}, None) == []
