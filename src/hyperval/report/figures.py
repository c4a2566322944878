"""All figures of a run, in the order of the report."""

from __future__ import annotations

from hyperval.report.figures_attribution import attribution_figures
from hyperval.report.figures_detection import abundance_figures, roc_figures, score_figures
from hyperval.report.figures_images import quicklook_figure, score_map_figures
from hyperval.report.figures_spectra import budget_figures, eigenvalue_figures, pair_figures
from hyperval.report.run import RunReport
from hyperval.report.style import Drawing, house_style


def draw_figures(run: RunReport) -> list[Drawing]:
    """Every figure that the products of ``run`` allow; the number is bounded whatever their size."""
    sides = (run.prediction, run.observation)
    simulated = run.simulated
    with house_style():
        drawings: list[Drawing] = []
        if run.quicklook is not None:
            drawings.append(quicklook_figure(run.quicklook, simulated=simulated))
        drawings += pair_figures(sides, "radiance", simulated=simulated)
        drawings += budget_figures(sides, simulated=simulated)
        drawings += pair_figures(sides, "snr", simulated=simulated)
        drawings += pair_figures(sides, "reflectance", simulated=simulated)
        drawings += eigenvalue_figures(sides, simulated=simulated)
        drawings += score_figures(sides, simulated=simulated)
        drawings += score_map_figures(run.score_maps, simulated=simulated)
        drawings += roc_figures(sides, simulated=simulated)
        drawings += abundance_figures(sides, simulated=simulated)
        drawings += attribution_figures(run.table, simulated=simulated)
    return drawings
