"""Figures of spread and its consequences: drawn, told in words, the same bytes again."""

from __future__ import annotations

import numpy as np
import pytest

from hyperval.products import Abundance, ClassificationError, Observation, Prediction
from hyperval.report.figures_covariance import sampled_eigenvalue_figures, tail_figures
from hyperval.report.figures_errors import class_error_figures, unmixing_figures
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.style import house_style
from hyperval.results import Result
from hyperval.spectra.axis import SpectralAxis

AXIS = SpectralAxis(np.array([500.0, 600.0]), 10.0)


def eigenvalues():
    e = np.geomspace(10.0, 1e-4, 20)
    spectrum = EigenvalueSpectrum(1.02 * e, e, 0.95 * e, 1.05 * e, 5000)
    return sampled_eigenvalue_figures({("grass $x$", "radiance"): spectrum}, simulated=True)


def tails():
    d = np.linspace(0.5, 9.0, 30)
    share = np.exp(-d)
    curve = TailCurve(d, share, 0.8 * share, 1.2 * share, None, share**2, share, None, 6.0, 4, 900)
    return tail_figures({"grass": curve}, simulated=False)


def classes():
    found = ClassificationError(0.1, 0.08, 0.13, 400, 300.0, 1.0, 0.09, 0.03, 0.2)
    none = ClassificationError(0.0, 0.0, 0.01, 400, 400.0, 9.0, 1e-9, 1e-14, 1e-7)
    held = {("a / b", "2 bands"): found, ("a / c", "2 bands"): none}
    sides = Prediction(AXIS, classification=held), Observation(AXIS, classification=held)
    return class_error_figures(sides, simulated=False)


def areas():
    held = {(f"t{i}", "fcls"): Abundance(a, 0.1 * a, 4, a) for i, a in enumerate((1.0, 1.0, 4.0, 4.0))}
    rows = [
        Result(
            "c", "abundance", f"all targets of {a} m2", "fcls", f"area_rmse_{side}", 0.2, "m2", lower=0.1, upper=0.5
        )
        for a in (1, 4) for side in ("predicted", "observed")
    ]  # fmt: skip
    return unmixing_figures(
        (Prediction(AXIS, abundance=held), Observation(AXIS, abundance=held)), rows, simulated=False
    )


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
    with house_style():
        (drawing,), (again,) = draw(), draw()
    assert drawing.section == section
    assert words in drawing.alt
    assert drawing.content.startswith(b"<?xml")
    assert len(drawing.content) > 5000
    assert drawing.content == again.content


def test_nothing_to_draw():
    nothing = Prediction(AXIS), Observation(AXIS)
    with house_style():
        assert sampled_eigenvalue_figures({}, simulated=False) == []
        assert tail_figures({}, simulated=False) == []
        assert class_error_figures(nothing, simulated=False) == []
        assert unmixing_figures(nothing, [], simulated=False) == []
