"""From the state of the atmosphere to the terms of equation 3.7."""

from .engine import ENGINES, atmospheric_terms
from .modtran_read import read_tape7
from .modtran_solve import read_chn, read_modtran_runs
from .modtran_write import modtran6_json, tape5
from .state import AerosolMix, AtmosphericState
from .table import AtmosphericTable
from .table_build import build_table
from .table_files import read_table, write_table
from .terms import AtmosphericTerms

__all__ = [
    "ENGINES", "AerosolMix", "AtmosphericState", "AtmosphericTable", "AtmosphericTerms", "atmospheric_terms",
    "build_table", "modtran6_json", "read_chn", "read_modtran_runs", "read_table", "read_tape7", "tape5",
    "write_table",
]  # fmt: skip
