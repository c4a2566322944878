"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .outputs import campaign_folders, write_index, write_outputs, write_tables
from .run import ExpectedScores, Quicklook, RunReport, ScoreMap

__all__ = [
    "ExpectedScores",
    "Quicklook",
    "RunReport",
    "ScoreMap",
    "campaign_folders",
    "write_index",
    "write_outputs",
    "write_tables",
]
