"""Standard atmospheres, and their water vapour and ozone scaled to the columns of a state.

Source of the table: McClatchey et al., AFCRL-72-0497 (1972), table 1.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

_GRAVITY = 9.81  # m s-2
_AIR_DENSITY_STP = 1.2928  # kg m-3 at 273.15 K and 1013.25 hPa
_STP_K, _STP_HPA = 273.15, 1013.25
OZONE_G_CM2_PER_ATM_CM = 2.1415e-3  # 48.0 g mol-1 / 22414 cm3 mol-1


@dataclass(frozen=True)
class Profile:
    """One column of air, 33 levels from the sea to 100 km.

    Attributes
    ----------
    altitude_km, pressure_hpa, temperature_k : (33,) level, pressure, temperature
    water_g_m3, ozone_g_m3 : (33,) densities
    """

    altitude_km: Array
    pressure_hpa: Array
    temperature_k: Array
    water_g_m3: Array
    ozone_g_m3: Array


def standard_profile(model: str) -> Profile:
    """The standard atmosphere named ``model``; raises UsageError for an unknown name."""
    tables = _tables()
    if model not in tables:
        raise UsageError(f"unknown standard atmosphere {model!r}", expected="one of " + ", ".join(tables))
    return tables[model]


def column_g_cm2(profile: Profile, density_g_m3: Array, above_km: float) -> float:
    """Mass of a gas above an altitude [g cm-2]: (1/g) integral of its mixing ratio over pressure.

    The hydrostatic form is used, not the integral of the density over altitude, because the solver
    integrates absorption over pressure; the rounded table makes the two differ by about 1 %.
    """
    air = _AIR_DENSITY_STP * (profile.pressure_hpa / _STP_HPA) * (_STP_K / profile.temperature_k)  # kg m-3
    mixing = density_g_m3 * 1e-3 / air
    bottom_hpa = pressure_at(profile, above_km)
    inside = profile.altitude_km > above_km
    pressure = np.concatenate([[bottom_hpa], profile.pressure_hpa[inside]])
    ratio = np.concatenate([[np.interp(above_km, profile.altitude_km, mixing)], mixing[inside]])
    kg_m2 = -np.trapezoid(ratio, pressure) * 100.0 / _GRAVITY
    return float(kg_m2 * 0.1)


def scaled_profile(model: str, ground_km: float, water_g_cm2: float | None, ozone_atm_cm: float | None) -> Profile:
    """The standard atmosphere with the columns above the ground scaled to the given amounts.

    None keeps the model's own density at each altitude, so that high ground has less above it.
    """
    profile = standard_profile(model)
    if water_g_cm2 is not None:
        own = column_g_cm2(profile, profile.water_g_m3, ground_km)
        profile = replace(profile, water_g_m3=profile.water_g_m3 * (water_g_cm2 / own))
    if ozone_atm_cm is not None:
        own = column_g_cm2(profile, profile.ozone_g_m3, ground_km) / OZONE_G_CM2_PER_ATM_CM
        profile = replace(profile, ozone_g_m3=profile.ozone_g_m3 * (ozone_atm_cm / own))
    return profile


def pressures_at(profile: Profile, altitude_km: Array) -> Array:
    """Pressures at altitudes [hPa], logarithmic between levels."""
    return np.asarray(np.exp(np.interp(altitude_km, profile.altitude_km, np.log(profile.pressure_hpa))))


def pressure_at(profile: Profile, altitude_km: float) -> float:
    """The same at one altitude [hPa]."""
    return float(pressures_at(profile, np.array(altitude_km)))


def air_column(profile: Profile, above_km: float) -> float:
    """Column of molecules above an altitude, as the integral of pressure / temperature [hPa K-1 km].

    The Rayleigh optical depth is proportional to it.
    """
    inside = profile.altitude_km > above_km
    z = np.concatenate([[above_km], profile.altitude_km[inside]])
    temperature = np.interp(z, profile.altitude_km, profile.temperature_k)
    return float(np.trapezoid(pressures_at(profile, z) / temperature, z))


def altitude_of_air_column(profile: Profile, column: float) -> float:
    """Altitude above which the profile has a column of molecules [km]; not below 0."""
    if column >= air_column(profile, 0.0):
        return 0.0
    return root_between(lambda z: air_column(profile, z) - column, 0.0, float(profile.altitude_km[-1]))


def root_between(falling: Callable[[float], float], low: float, high: float) -> float:
    """Where a falling function passes zero, to the last bit.

    Halving takes fifty calls, a hundredth of the time that SciPy's searches take to import.

    Examples
    --------
    >>> root_between(lambda x: 2.0 - x * x, 0.0, 2.0) ** 2
    2.0000000000000004
    """
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if falling(middle) > 0.0 else (low, middle)
    return middle


@cache
def _tables() -> dict[str, Profile]:
    text = resources.files("hyperval.atmosphere").joinpath("standard_atmospheres.csv").read_text("utf-8")
    rows = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    tables: dict[str, list[list[float]]] = {}
    for row in rows:
        model = row.pop("model")
        tables.setdefault(model, []).append([float(v) for v in row.values()])
    return {model: Profile(*np.array(levels).T) for model, levels in tables.items()}
