"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from hyperval.report.outputs import campaign_folders, write_index, write_outputs, write_tables
from hyperval.report.run import Quicklook, RunReport, ScoreMap

__all__ = [
    "Quicklook",
    "RunReport",
    "ScoreMap",
    "campaign_folders",
    "write_index",
    "write_outputs",
    "write_tables",
]
