"""Figures: each stated once as data, drawn in a page by ``charts.js`` and on paper by ``print``."""

from .catalogue import (
    MAX_SUBJECTS,
    densities_figure,
    exceedance_figure,
    first_figures,
    further_figures,
    many_objects_figure,
    spectra_figure,
)
from .pictures import draw_pictures
from .print import draw_views, drawings_of, house_style
from .rows import campaigns_figure, criteria_figure, outcome_words
from .spec import (
    Axis,
    ColourScale,
    Drawing,
    Figure,
    Mark,
    Panels,
    Part,
    figure_json,
)

__all__ = [
    "MAX_SUBJECTS", "Axis", "ColourScale", "Drawing", "Figure", "Mark", "Panels", "Part", "campaigns_figure",
    "criteria_figure", "densities_figure", "draw_pictures", "draw_views", "drawings_of", "exceedance_figure",
    "figure_json", "first_figures", "further_figures", "house_style", "many_objects_figure", "outcome_words",
    "spectra_figure",
]  # fmt: skip
