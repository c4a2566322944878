"""Inputs whose uncertainty a scenario does not state, each with a usual one: they too may be the reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyperval.atmosphere.visibility import aot550_from_range
from hyperval.prediction.departure import Departure, StatisticsDeparture
from hyperval.prediction.fills import fill_distribution
from hyperval.scenario import Scenario

# Usual sizes, as a part of the input unless a unit is given.
AEROSOL = 0.10
WATER_VAPOUR = 0.10
GAIN = 0.01
SHIFT_NM = 0.1
NOISE = 0.05
SURROUNDINGS = 0.10
SPECTRUM = 0.02
SPREAD = 0.10
FILL = 0.05
FRACTION = 0.10
BLUR = 0.10


@dataclass(frozen=True, eq=False)
class AssumedInput:
    """One input of one scenario.

    Attributes
    ----------
    name, kind : for people; the kind as in the budget (atmosphere, sensor, surface, scene)
    step : what one unit is, in words
    moved : z units -> departure
    most : units that it may be off at most
    """

    name: str
    kind: str
    step: str
    moved: Callable[[float], Departure]
    most: float = 30.0


def assumed_inputs(scenario: Scenario) -> list[AssumedInput]:
    """Every input of a scenario that may be off, with a usual standard uncertainty."""
    found = [*_atmosphere(scenario), *_sensor(scenario), *_surfaces(scenario), *_scene(scenario)]
    return found


def _atmosphere(scenario: Scenario) -> list[AssumedInput]:
    state = scenario.atmosphere
    if state is None:
        return []
    out = [
        _input("surroundings", "scene", SURROUNDINGS, lambda z: Departure(surroundings=_factor(SURROUNDINGS, z)))
    ]
    if state.engine == "table":
        return out
    aot = state.aot550
    if aot is None and state.meteorological_range_km is not None:
        aot = aot550_from_range(state.meteorological_range_km, state.ground_altitude_km)
    if aot:
        out.append(
            _input(
                "aerosol optical depth", "atmosphere", AEROSOL,
                _setting("atmosphere.aot550", aot, AEROSOL, {"atmosphere.meteorological_range_km": None}),
            )
        )  # fmt: skip
    if state.water_vapour_g_cm2:
        path = "atmosphere.water_vapour_g_cm2"
        moved = _setting(path, state.water_vapour_g_cm2, WATER_VAPOUR)
        out.append(_input("water vapour", "atmosphere", WATER_VAPOUR, moved))
    return out


def _sensor(scenario: Scenario) -> list[AssumedInput]:
    gain = _input("sensor gain", "sensor", GAIN, lambda z: Departure(recorded_gain=_factor(GAIN, z)))
    if scenario.atmosphere is None:
        return [gain]
    return [
        gain,
        AssumedInput(
            "wavelength shift", "sensor", f"{SHIFT_NM:g} nm", lambda z: Departure(wavelength_shift_nm=SHIFT_NM * z)
        ),
        _input("sensor noise", "sensor", NOISE, lambda z: Departure(noise_factor=_factor(NOISE, z))),
    ]


def _surfaces(scenario: Scenario) -> list[AssumedInput]:
    """Spread of the classes; spectra come from the budget or from ``spectrum_inputs``."""
    out = []
    for c in scenario.scene.classes:

        def moved(z: float, name: str = c.name) -> Departure:
            return Departure(statistics={name: StatisticsDeparture(factor=_factor(SPREAD, z) ** 2)})

        out.append(_input(f"spread of {c.name}", "surface", SPREAD, moved))
    return out


def _scene(scenario: Scenario) -> list[AssumedInput]:
    out = []
    if scenario.scene.targets:
        fills = {p.name: fill_distribution(p.fill).mean for t in scenario.scene.targets for p in t.populations}

        def filled(z: float) -> Departure:
            return Departure(fill={name: FILL * z * mean for name, mean in fills.items()})

        out.append(_input("fill of the targets", "scene", FILL, filled))
    blur = _blurs(scenario)
    if blur:
        out.append(
            _input(
                "blur of the image",
                "scene",
                BLUR,
                lambda z: Departure(
                    settings={path: min(width * _factor(BLUR, z), 5.0) for path, width in blur.items()}
                ),
                most=10.0,
            )
        )
    classes = scenario.scene.classes
    for c in classes:
        if len(classes) > 1 and 0 < c.fraction < 1:
            moved = _fraction(scenario, c.name, c.fraction)
            out.append(_input(f"fraction of {c.name}", "scene", FRACTION, moved, most=1.0 / FRACTION))
            if len(classes) == 2:
                break  # the other one's is the same input
    return out


def _blurs(scenario: Scenario) -> dict[str, float]:
    """Path -> width of the blur, wherever a fill follows from geometry and states one."""
    out: dict[str, float] = {}
    for t in scenario.scene.targets:
        fills = [(f"scene.targets.[{t.name}].fill", t.fill)] if t.fill is not None else []
        fills += [(f"scene.targets.[{t.name}].subjects.[{s.name}].fill", s.fill) for s in t.subjects]
        for path, fill in fills:
            width = fill.geometry.psf_fwhm_pixels if fill.geometry is not None else None
            if isinstance(width, float | int) and width > 0:
                out[f"{path}.geometry.psf_fwhm_pixels"] = float(width)
    return out


def _fraction(scenario: Scenario, name: str, fraction: float) -> Callable[[float], Departure]:
    """More of one class and less of all others."""

    def moved(z: float) -> Departure:
        new = float(np.clip(fraction * (1.0 + FRACTION * z), 1e-6, 1.0 - 1e-6))
        rest = (1.0 - new) / (1.0 - fraction)
        return Departure(
            settings={
                f"scene.classes.[{c.name}].fraction": new if c.name == name else c.fraction * rest
                for c in scenario.scene.classes
            }
        )

    return moved


def _setting(
    path: str, value: float, part: float, others: Mapping[str, Any] | None = None
) -> Callable[[float], Departure]:
    return lambda z: Departure(settings={path: value * _factor(part, z), **(others or {})})


def _factor(part: float, z: float) -> float:
    """1 + part z, kept positive where z is far out."""
    return float(1.0 + part * z if part * z > -0.9 else 0.1 * np.exp((part * z + 0.9) / 0.1))


def _input(
    name: str, kind: str, part: float, moved: Callable[[float], Departure], most: float = 30.0
) -> AssumedInput:
    return AssumedInput(name, kind, f"{100 * part:g} %", moved, most)
