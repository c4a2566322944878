"""All figures of a run, in the order of the report."""

from __future__ import annotations

from dataclasses import replace

from hyperval.products import SPECTRA
from hyperval.report.charts_objects import map_objects
from hyperval.report.figures_attribution import attribution_figures
from hyperval.report.figures_covariance import sampled_eigenvalue_figures, tail_figures
from hyperval.report.figures_detection import abundance_figures, roc_figures, score_figures
from hyperval.report.figures_errors import class_error_figures, unmixing_figures
from hyperval.report.figures_images import quicklook_figure, score_map_figures
from hyperval.report.figures_scores import (
    exceedance_figures,
    object_score_figures,
    roc_difference_figures,
    transform_figures,
)
from hyperval.report.figures_spectra import budget_figures, eigenvalue_figures, pair_figures
from hyperval.report.run import RunReport
from hyperval.report.sides import Sides
from hyperval.report.style import Drawing, Print, house_style


def draw_figures(run: RunReport) -> list[Drawing]:
    """The figures of a run's page; the number is bounded whatever its size.

    Spectra, ROC curves and what has eigenvalues without a band of chance are charts there (``charts``);
    :func:`print_figures` draws them.
    """
    sides = (run.prediction, run.observation)
    simulated = run.simulated
    with house_style():
        drawings: list[Drawing] = []
        if run.quicklook is not None:
            drawings.append(quicklook_figure(run.quicklook, simulated=simulated))
        drawings += budget_figures(sides, simulated=simulated)
        drawings += sampled_eigenvalue_figures(run.eigenvalues, simulated=simulated)
        drawings += tail_figures(run.tails, simulated=simulated)
        drawings += class_error_figures(sides, simulated=simulated)
        drawings += score_figures(sides, simulated=simulated)
        if not any(
            map_objects(name, one, sides) for name, one in run.score_maps.items()
        ):  # else a map and a histogram
            drawings += object_score_figures(sides, simulated=simulated)
        drawings += transform_figures(sides, simulated=simulated)
        drawings += exceedance_figures(sides, simulated=simulated)
        drawings += score_map_figures(run.score_maps, simulated=simulated)
        drawings += roc_difference_figures(sides, _equivalence_margin(run), simulated=simulated)
        drawings += abundance_figures(sides, simulated=simulated)
        drawings += unmixing_figures(sides, list(run.table.where(product="abundance")), simulated=simulated)
        drawings += attribution_figures(run.table, simulated=simulated)
    return drawings


def print_figures(sides: Sides, *, simulated: bool, print_as: Print) -> list[Drawing]:
    """Every figure that products allow, spectra and ROC curves first."""
    with house_style(print_as):
        drawings: list[Drawing] = []
        for product in SPECTRA:
            drawings += pair_figures(sides, product, simulated=simulated)
        drawings += roc_figures(sides, simulated=simulated)
        drawings += budget_figures(sides, simulated=simulated)
        drawings += eigenvalue_figures(sides, simulated=simulated)
        drawings += class_error_figures(sides, simulated=simulated)
        drawings += score_figures(sides, simulated=simulated)
        drawings += exceedance_figures(sides, simulated=simulated)
        drawings += roc_difference_figures(sides, None, simulated=simulated)
        drawings += abundance_figures(sides, simulated=simulated)
    return [replace(drawing, kind=print_as.format) for drawing in drawings]


def _equivalence_margin(run: RunReport) -> float | None:
    """The margin that the campaign of a run states, as its provenance records it."""
    campaign = (run.provenance.get("configuration") or {}).get("campaign") or {}
    margin = campaign.get("equivalence_margin")
    return float(margin) if isinstance(margin, int | float) else None
