"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .html import figures_to_folder, index_page, report_page
from .outputs import write_index, write_outputs
from .side_by_side import compare_runs
from .verdict import (
    accepted_text,
    first_screen,
    interval_text,
    is_failed_gate,
    last_line,
    limits_text,
    number_text,
    value_text,
)

__all__ = [
    "accepted_text", "compare_runs", "figures_to_folder", "first_screen", "index_page", "interval_text",
    "is_failed_gate", "last_line", "limits_text", "number_text", "report_page", "value_text", "write_index",
    "write_outputs",
]  # fmt: skip
