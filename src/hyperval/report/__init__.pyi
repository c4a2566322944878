"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .html import MAX_BYTES, index_page, report_page
from .outputs import write_index, write_outputs
from .side_by_side import compare_runs
from .verdict import first_screen, interval_text, last_line, limits_text, number_text, value_text

__all__ = [
    "MAX_BYTES",
    "compare_runs",
    "first_screen",
    "index_page",
    "interval_text",
    "last_line",
    "limits_text",
    "number_text",
    "report_page",
    "value_text",
    "write_index",
    "write_outputs",
]
