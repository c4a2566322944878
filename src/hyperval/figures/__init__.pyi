"""Figures: each stated once as data, drawn in a page by ``charts.js`` and on paper by ``print``."""

from .catalogue import (
    MOST_SUBJECTS,
    densities_figure,
    exceedance_figure,
    first_figures,
    further_figures,
    many_objects_figure,
    spectra_figure,
)
from .pictures import draw_pictures
from .print import canvas_of, drawings_of, house_style
from .rows import campaigns_figure, criteria_figure, outcome_words
from .spec import (
    Axis,
    ColourScale,
    Drawing,
    Figure,
    Mark,
    Panels,
    Part,
    statement,
)

__all__ = [
    "MOST_SUBJECTS", "Axis", "ColourScale", "Drawing", "Figure", "Mark", "Panels", "Part", "campaigns_figure",
    "canvas_of", "criteria_figure", "densities_figure", "draw_pictures", "drawings_of", "exceedance_figure",
    "first_figures", "further_figures", "house_style", "many_objects_figure", "outcome_words", "spectra_figure",
    "statement",
]  # fmt: skip
