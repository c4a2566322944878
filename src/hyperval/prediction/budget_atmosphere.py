"""Uncertain inputs of atmosphere, sun and view, and of the radiative-transfer engine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState
from hyperval.atmosphere.state import MAX_SOLAR_ZENITH_DEG
from hyperval.atmosphere.visibility import LONGEST_KM, SHORTEST_KM
from hyperval.errors import UsageError
from hyperval.prediction.budget_input import BudgetInput, Given, factor_input, scalar_input
from hyperval.prediction.departure import Departure
from hyperval.prediction.forms import directions, value_at
from hyperval.scenario_uncertainty import EngineUncertainty, Spread

Array = npt.NDArray[np.float64]

AEROSOL, WATER, OZONE, SUN, SURROUNDINGS = (
    "aerosol optical depth", "water vapour", "ozone", "solar irradiance", "surroundings"
)  # fmt: skip
ENGINE, ENGINE_PATH = "radiative-transfer engine", "engine's path radiance"
ENGINE_LINES = "engine's fine structure"
_HIGHEST_SUN_DEG = MAX_SOLAR_ZENITH_DEG - 0.1

# Field of the state: (name for users, lowest, highest value).
_FIELDS: dict[str, tuple[str, float, float]] = {
    "aot550": (AEROSOL, 0.0, 5.0),
    "meteorological_range_km": ("meteorological range", SHORTEST_KM, LONGEST_KM),
    "water_vapour_g_cm2": (WATER, 0.01, 10.0),
    "ozone_atm_cm": (OZONE, 0.01, 1.0),
    "solar_zenith_deg": ("solar zenith angle", 0.0, _HIGHEST_SUN_DEG),
    "solar_azimuth_deg": ("solar azimuth", -360.0, 360.0),
    "view_zenith_deg": ("view zenith angle", 0.0, 70.0),
    "view_azimuth_deg": ("view azimuth", -360.0, 360.0),
    "sensor_altitude_km": ("sensor altitude", 0.0, 100_000.0),
    "ground_altitude_km": ("ground height", 0.0, 5.0),
}


def atmosphere_inputs(given: Given, shapes: bool = True) -> list[BudgetInput]:
    """The inputs of the light, in the order in which budgets list them.

    Raises
    ------
    UsageError : an uncertainty of a number that the atmosphere does not state.
    """
    u, state = given.scenario.uncertainty, given.scenario.atmosphere
    if state is None:
        return []
    found = []
    for name, (title, low, high) in _FIELDS.items():
        spread = getattr(u, name)
        if spread is not None:
            found.append(_state_input(title, name, spread, state, low, high))
    for title, spread, key in (
        (SUN, u.solar_irradiance_relative, "irradiance"),
        (SURROUNDINGS, u.adjacency_reflectance_relative, "surroundings"),
    ):
        if spread is not None:
            found.append(scalar_input(title, "atmosphere" if key == "irradiance" else "scene", spread,
                                      _factor(key, spread)))  # fmt: skip
    if u.engine is not None and shapes:
        found += _engine_inputs(u.engine, given)
    return found


def state_value(state: AtmosphericState, name: str) -> float:
    """The number that a state has for a field, also where it follows from others.

    Raises
    ------
    UsageError : the state leaves it to the engine.
    """
    derived: dict[str, Callable[[], float]] = {
        "aot550": lambda: state.aerosol_optical_depth,
        "solar_zenith_deg": lambda: state.sun[0],
        "solar_azimuth_deg": lambda: state.sun[1],
    }
    value = derived[name]() if name in derived else getattr(state, name)
    if value is None:
        raise UsageError(f"uncertainty: {name} is given, but the atmosphere's {name} is not", mend=f"state {name}")
    return float(value)


def state_settings(state: AtmosphericState, name: str, value: float) -> dict[str, Any]:
    """The settings that give a field of the atmosphere another value, the rest of it the same."""
    changes: dict[str, Any] = {f"atmosphere.{name}": value}
    if name == "aot550":
        changes["atmosphere.meteorological_range_km"] = None
    return changes


def _state_input(
    title: str, name: str, spread: Spread, state: AtmosphericState, low: float, high: float
) -> BudgetInput:
    value = state_value(state, name)
    if name == "sensor_altitude_km":
        low = state.ground_altitude_km + 0.01
    if name == "ground_altitude_km":
        high = min(high, state.sensor_altitude_km - 0.01)

    def at(z: float) -> Departure:
        moved = value_at(value, spread, z)
        if name in ("solar_zenith_deg", "solar_azimuth_deg"):
            return Departure(**{name: moved - value})  # type: ignore[arg-type]
        if name == "view_zenith_deg":
            moved = abs(moved)  # over the zenith and down on the other side
        elif name.endswith("azimuth_deg"):
            moved = moved % 360.0
        return Departure(settings=state_settings(state, name, float(np.clip(moved, low, high))))

    return scalar_input(title, "atmosphere", spread, at, (f"atmosphere.{name}",))


def _factor(key: str, spread: Spread) -> Callable[[float], Departure]:
    return lambda z: Departure(**{key: max(value_at(1.0, spread, z), 0.01)})  # type: ignore[arg-type]


def _engine_inputs(engine: EngineUncertainty, given: Given) -> list[BudgetInput]:
    """The engine's errors: on the ground-reflected radiance, greater where gases absorb, and on the path."""
    found = []
    for name, part in ((ENGINE, engine), (ENGINE_LINES, engine.fine_structure)):
        if part is None or not (part.relative > 0 or part.per_optical_depth > 0):
            continue
        sd = np.full(len(given.axis), part.relative)
        if part.per_optical_depth > 0:
            sd = sd + part.per_optical_depth * gas_depth(given.terms().gas_transmittance)
        rows = directions(sd, part, given.axis, given.sensor)
        found.append(factor_input(name, "engine", rows, part, lambda f: Departure(ground=np.maximum(f, 0.0))))
    if engine.path_relative > 0:
        rows = directions(np.full(len(given.axis), engine.path_relative), engine, given.axis, given.sensor)
        found.append(
            factor_input(ENGINE_PATH, "engine", rows, engine, lambda f: Departure(path=np.maximum(f, 0.0)))
        )
    return found


def gas_depth(gas_transmittance: Array) -> Array:
    """-ln T_gas, at most that of a transmittance of 1e-6 [1]."""
    return np.asarray(-np.log(np.clip(gas_transmittance, 1e-6, 1.0)))
