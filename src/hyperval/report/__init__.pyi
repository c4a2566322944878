"""Figures, HTML, CSV, JSON, JUnit and NetCDF: views of one results table."""

from .html import MAX_BYTES, index_page, report_page, run_drawings
from .outputs import write_index, write_outputs
from .run import (
    Injected,
    PowerTable,
    RunReport,
    Sight,
    accepted_table,
    gate_values,
    own_files,
    write_power_table,
)
from .side_by_side import compare_runs
from .verdict import first_screen, interval_text, last_line, limits_text, number_text, value_text

__all__ = [
    "MAX_BYTES",
    "Injected",
    "PowerTable",
    "RunReport",
    "Sight",
    "accepted_table",
    "compare_runs",
    "first_screen",
    "gate_values",
    "index_page",
    "interval_text",
    "last_line",
    "limits_text",
    "number_text",
    "own_files",
    "report_page",
    "run_drawings",
    "value_text",
    "write_index",
    "write_outputs",
    "write_power_table",
]
