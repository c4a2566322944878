"""Every figure of a finished run for print: what its page has as charts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hyperval.products import SPECTRA
from hyperval.report.figures_detection import roc_figures
from hyperval.report.figures_plots import drawing_of
from hyperval.report.figures_spectra import pair_figures
from hyperval.report.plots import Plots
from hyperval.report.sides import Sides
from hyperval.report.style import Drawing, Print, house_style


def print_figures(sides: Sides, plots: Sequence[Plots], *, simulated: bool, print_as: Print) -> list[Drawing]:
    """Spectra and ROC curves, and every stated plot."""
    with house_style(print_as):
        drawings: list[Drawing] = []
        for product in SPECTRA:
            drawings += pair_figures(sides, product, simulated=simulated)
        drawings += roc_figures(sides, simulated=simulated)
        drawings += [drawing_of(one, simulated=simulated) for one in plots]
    return [replace(drawing, kind=print_as.format) for drawing in drawings]
