"""Figures: each stated once as data, drawn in a page by ``charts.js`` and on paper by ``print``."""

from .catalogue import first_figures, further_figures, reason_figures
from .criteria import campaigns_figure, criteria_figure
from .detection import densities_figure, exceedance_figure, many_objects_figure
from .pictures import draw_pictures
from .print import canvas_of, drawings_of, house_style
from .spec import (
    Axis,
    ColourScale,
    Drawing,
    EigenvalueSpectrum,
    ExpectedScores,
    Figure,
    Mark,
    Panels,
    Part,
    Quicklook,
    ScoreMap,
    statement,
)
from .spectra import MOST_SUBJECTS, spectra_figure

__all__ = [
    "MOST_SUBJECTS", "Axis", "ColourScale", "Drawing", "EigenvalueSpectrum", "ExpectedScores", "Figure", "Mark",
    "Panels", "Part", "Quicklook", "ScoreMap", "campaigns_figure", "canvas_of", "criteria_figure",
    "densities_figure", "draw_pictures", "drawings_of", "exceedance_figure", "first_figures", "further_figures",
    "house_style", "many_objects_figure", "reason_figures", "spectra_figure", "statement",
]  # fmt: skip
