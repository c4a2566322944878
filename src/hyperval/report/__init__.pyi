"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .html import MAX_BYTES, index_page, report_page, run_drawings
from .outputs import write_index, write_outputs
from .run import Injected, PowerTable, RunReport
from .side_by_side import compare_runs
from .verdict import first_screen, last_line, number_text

__all__ = [
    "MAX_BYTES",
    "Injected",
    "PowerTable",
    "RunReport",
    "compare_runs",
    "first_screen",
    "index_page",
    "last_line",
    "number_text",
    "report_page",
    "run_drawings",
    "write_index",
    "write_outputs",
]
