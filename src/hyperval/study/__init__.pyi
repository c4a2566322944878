"""Trade-off studies: many evaluations of the model over grids, lists and random designs."""

from .page import knee
from .plan import answers, output_values
from .run import study_to_folder
from .schema import Output, Required, StudyFile, load_study
from .trade import Trade, completed, live, piece, prepared

__all__ = [
    "Output", "Required", "StudyFile", "Trade", "answers", "completed", "knee", "live", "load_study",
    "output_values", "piece", "prepared", "study_to_folder",
]  # fmt: skip
