"""From the state of the atmosphere to the terms of equation 3.7."""

from .engine import ENGINES, atmospheric_terms
from .modtran import modtran6_json, read_chn, read_modtran_runs, read_tape7, tape5
from .state import AerosolMix, AtmosphericState
from .table import AtmosphericTable, build_table, read_table, write_table
from .terms import AtmosphericTerms

__all__ = [
    "ENGINES", "AerosolMix", "AtmosphericState", "AtmosphericTable", "AtmosphericTerms", "atmospheric_terms",
    "build_table", "modtran6_json", "read_chn", "read_modtran_runs", "read_table", "read_tape7", "tape5",
    "write_table",
]  # fmt: skip
