"""Trade-off studies: many evaluations of the model over grids, lists and random designs."""

from .page import knee
from .plan import output_values, required_values
from .run import study_to_folder
from .schema import Output, Required, StudyFile, load_study
from .trade import Trade, complete, live_figure, next_piece, prepare

__all__ = [
    "Output", "Required", "StudyFile", "Trade", "complete", "knee", "live_figure", "load_study", "next_piece",
    "output_values", "prepare", "required_values", "study_to_folder",
]  # fmt: skip
