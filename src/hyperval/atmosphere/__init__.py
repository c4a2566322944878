"""From the state of the atmosphere to the terms of equation 3.7."""

from hyperval.atmosphere.engine import ENGINES, atmospheric_terms
from hyperval.atmosphere.modtran_read import read_tape7
from hyperval.atmosphere.modtran_solve import read_chn, read_modtran_runs
from hyperval.atmosphere.modtran_write import modtran6_json, tape5
from hyperval.atmosphere.state import AerosolMix, AtmosphericState
from hyperval.atmosphere.table import AtmosphericTable
from hyperval.atmosphere.table_build import build_table
from hyperval.atmosphere.table_files import read_table, write_table
from hyperval.atmosphere.terms import AtmosphericTerms

__all__ = [
    "ENGINES", "AerosolMix", "AtmosphericState", "AtmosphericTable", "AtmosphericTerms", "atmospheric_terms",
    "build_table", "modtran6_json", "read_chn", "read_modtran_runs", "read_table", "read_tape7", "tape5",
    "write_table",
]  # fmt: skip
