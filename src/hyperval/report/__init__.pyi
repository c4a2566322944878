"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .html import figures_to_folder, index_page, report_page
from .outputs import write_index, write_outputs
from .side_by_side import compare_runs
from .verdict import (
    accepted_words,
    first_screen,
    gate_fails,
    interval_text,
    last_line,
    limits_text,
    number_text,
    value_text,
)

__all__ = [
    "accepted_words", "compare_runs", "figures_to_folder", "first_screen", "gate_fails", "index_page", "interval_text",
    "last_line", "limits_text", "number_text", "report_page", "value_text", "write_index", "write_outputs",
]  # fmt: skip
