"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .outputs import write_index, write_outputs
from .run import RunReport

__all__ = [
    "RunReport",
    "write_index",
    "write_outputs",
]
