"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .outputs import write_index, write_outputs
from .run import ExpectedScores, Quicklook, RunReport, ScoreMap

__all__ = [
    "ExpectedScores",
    "Quicklook",
    "RunReport",
    "ScoreMap",
    "write_index",
    "write_outputs",
]
