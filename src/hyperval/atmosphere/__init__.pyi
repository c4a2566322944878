"""From the state of the atmosphere to the terms of equation 3.7."""

from .between import interpolated_terms, interpolation_nodes, smooth_rule
from .modtran import (
    RADIANCE_COLUMNS,
    Modtran,
    configured_modtran,
    modtran6_json,
    read_channels,
    read_chn,
    read_modtran_json,
    read_modtran_runs,
    read_tape7,
    run_modtran,
    solve_coefficients,
    stated_albedo,
    stated_fields,
    tape5,
    terms_from_runs,
)
from .physics import (
    MAX_WATER_G_CM2,
    OXYGEN,
    EngineRatio,
    amounts,
    binary_coefficient,
    collision_column,
    engine_ratio,
    low_share,
    molecular_albedo,
)
from .sixs import NODES_NM, aerosol_extinction, run_sixs, sixs_terms, terms_near
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
from .table import ENGINES, AtmosphericTable, atmospheric_terms, build_table, read_table, write_table
from .terms import AtmosphericTerms, cached

__all__ = [
    "ENGINES", "MAX_WATER_G_CM2", "NODES_NM", "OXYGEN", "RADIANCE_COLUMNS", "AerosolMix", "AtmosphericState",
    "AtmosphericTable", "AtmosphericTerms", "EngineRatio", "Modtran", "aerosol_extinction", "amounts",
    "aot550_from_range", "atmospheric_terms", "binary_coefficient", "build_table", "cached", "collision_column",
    "configured_modtran", "distance_on_day", "earth_sun_distance_au", "engine_ratio", "extraterrestrial_irradiance",
    "fraction_below", "interpolated_terms", "interpolation_nodes", "low_share", "modtran6_json", "molecular_albedo",
    "parse_utc", "pressure_at", "range_from_aot550", "read_channels", "read_chn", "read_modtran_json",
    "read_modtran_runs", "read_table", "read_tape7", "run_modtran", "run_sixs", "sixs_terms", "smooth_rule",
    "solar_position", "solve_coefficients", "standard_profile", "stated_albedo", "stated_fields", "tape5",
    "terms_from_runs", "terms_near", "write_table",
]  # fmt: skip
