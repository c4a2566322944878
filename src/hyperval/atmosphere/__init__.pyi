"""From the state of the atmosphere to the terms of equation 3.7."""

from .between import AtmosphericTable, interpolated_terms, smooth_rule, spaced
from .engine import ENGINES, atmospheric_terms
from .modtran import (
    RADIANCE_COLUMNS,
    modtran6_json,
    read_channels,
    read_chn,
    read_modtran_json,
    read_modtran_runs,
    read_tape7,
    tape5,
    terms_from_runs,
)
from .physics import EngineRatio, engine_ratio, molecular_albedo, ways
from .sixs import sixs_terms
from .solar import (
    distance_on_day,
    earth_sun_distance_au,
    extraterrestrial_irradiance,
    parse_utc,
    solar_position,
)
from .state import (
    AerosolMix,
    AtmosphericState,
    aot550_from_range,
    fraction_below,
    pressure_at,
    range_from_aot550,
    standard_profile,
)
from .table import build_table, read_table, write_table
from .terms import AtmosphericTerms

__all__ = [
    "ENGINES", "RADIANCE_COLUMNS", "AerosolMix", "AtmosphericState", "AtmosphericTable", "AtmosphericTerms",
    "EngineRatio", "aot550_from_range", "atmospheric_terms", "build_table", "distance_on_day",
    "earth_sun_distance_au", "engine_ratio", "extraterrestrial_irradiance", "fraction_below", "interpolated_terms",
    "modtran6_json", "molecular_albedo", "parse_utc", "pressure_at", "range_from_aot550", "read_channels",
    "read_chn", "read_modtran_json", "read_modtran_runs", "read_table", "read_tape7", "sixs_terms", "smooth_rule",
    "solar_position", "spaced", "standard_profile", "tape5", "terms_from_runs", "ways", "write_table",
]  # fmt: skip
