"""Figures: each stated once as data, drawn in a page by ``charts.js`` and on paper by ``print``."""

from .catalogue import first_figures, further_figures, reason_figures
from .criteria import campaigns_figure, criteria_figure
from .detection import (
    best_counted,
    densities_figure,
    exceedance_figure,
    many_objects_figure,
    object_score_figure,
    roc_difference_figure,
    roc_figure,
    transform_figure,
    unmixing_figure,
)
from .pictures import draw_pictures, quicklook_figure, score_map_figures
from .print import Print, canvas_of, drawings_of, house_style
from .sides import EigenvalueSpectrum, ExpectedScores, Quicklook, ScoreMap, TailCurve, difference
from .spec import Axis, ColourScale, Drawing, Figure, Mark, Panels, Part, statement
from .spectra import (
    MOST_SUBJECTS,
    budget_figure,
    class_error_figure,
    eigenvalue_figures,
    eigenvalues,
    sampled_eigenvalue_figures,
    spectra_figure,
    tail_figure,
)

__all__ = [
    "MOST_SUBJECTS",
    "Axis",
    "ColourScale",
    "Drawing",
    "EigenvalueSpectrum",
    "ExpectedScores",
    "Figure",
    "Mark",
    "Panels",
    "Part",
    "Print",
    "Quicklook",
    "ScoreMap",
    "TailCurve",
    "best_counted",
    "budget_figure",
    "campaigns_figure",
    "canvas_of",
    "class_error_figure",
    "criteria_figure",
    "densities_figure",
    "difference",
    "draw_pictures",
    "drawings_of",
    "eigenvalue_figures",
    "eigenvalues",
    "exceedance_figure",
    "first_figures",
    "further_figures",
    "house_style",
    "many_objects_figure",
    "object_score_figure",
    "quicklook_figure",
    "reason_figures",
    "roc_difference_figure",
    "roc_figure",
    "sampled_eigenvalue_figures",
    "score_map_figures",
    "spectra_figure",
    "statement",
    "tail_figure",
    "transform_figure",
    "unmixing_figure",
]
