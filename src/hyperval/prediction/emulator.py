"""The atmosphere between a few engine runs: many draws of its state for the price of two runs for each input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.prediction.budget_atmosphere import state_value
from hyperval.prediction.budget_input import BudgetInput
from hyperval.prediction.departure import departed_scenario
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]

# Three nodes 0 and +-sqrt(3) standard deviations: those of Gauss and Hermite, exact for moments of a cubic.
_NODE = float(np.sqrt(3.0))
_TINY = 1e-300


@dataclass(frozen=True)
class _Axis:
    """One field of the state: its values at the nodes, the stated one first, and what the terms change there."""

    name: str
    values: tuple[float, ...]
    changes: tuple[Array, ...]  # of the logarithm of the stack, at the nodes but the first

    def change(self, value: float) -> Array:
        """Change of the logarithms at a value, by the polynomial through the nodes."""
        if self.name.endswith("azimuth_deg"):
            value = self.values[0] + (value - self.values[0] + 180.0) % 360.0 - 180.0
        total = np.zeros_like(self.changes[0])
        for i, change in enumerate(self.changes, start=1):
            weight = 1.0
            for j, other in enumerate(self.values):
                if j != i:
                    weight *= (value - other) / (self.values[i] - other)
            total += weight * change
        return total


@dataclass(frozen=True)
class Emulator:
    """Stands in for an engine near one state: logarithms of terms, quadratic in each field, without cross terms.

    Attributes
    ----------
    runs : engine runs behind it
    error : greatest and median error of direct and path radiance against the engine, as a part of their sum, where
        all fields are one standard uncertainty off [1]; zeros where nothing is uncertain
    """

    terms: AtmosphericTerms
    axes: tuple[_Axis, ...]
    runs: int
    error: tuple[float, float]

    def __call__(self, state: AtmosphericState) -> AtmosphericTerms:
        """The terms of a state that differs from the stated one in the uncertain fields alone."""
        if not self.axes:
            return self.terms
        logs = _logs(self.terms)
        for axis in self.axes:
            logs = logs + axis.change(state_value(state, axis.name))
        names = _names(self.terms)
        values = dict(zip(names, np.exp(logs), strict=True))
        for name in ("gas_transmittance", "diffuse_fraction"):
            if name in values:
                values[name] = np.minimum(values[name], 1.0)
        return replace(self.terms, **values)


def emulator(
    scenario: Scenario, inputs: Sequence[BudgetInput], engine: Engine, axis: SpectralAxis | None
) -> Emulator:
    """Run the engine at the nodes of every uncertain field of the atmosphere.

    Parameters
    ----------
    axis : bands over which the terms are averaged before they are interpolated; None keeps the engine's own
        sampling, for bands that move
    """

    def run(at: Scenario) -> AtmosphericTerms:
        assert at.atmosphere is not None  # noqa: S101 - asked for where there is light
        terms = engine(at.atmosphere)
        return terms if axis is None else replace(terms.at_bands(axis), fwhm_nm=axis.fwhm_nm)

    stated = run(scenario)
    base, runs = _logs(stated), 1
    axes, moving = [], []
    for item in inputs:
        name = item.settings[0].removeprefix("atmosphere.") if item.settings else ""
        if item.kind != "atmosphere" or not name:
            continue
        assert scenario.atmosphere is not None  # noqa: S101 - inputs of the atmosphere
        values, changes = [state_value(scenario.atmosphere, name)], []
        for z in (-_NODE, _NODE):
            there = departed_scenario(scenario, item.moved(z))
            assert there.atmosphere is not None  # noqa: S101
            value = state_value(there.atmosphere, name)
            if all(
                abs(value - v) > 1e-12 for v in values
            ):  # a node at the end of the range may be the stated value
                values.append(value)
                changes.append(_logs(run(there)) - base)
                runs += 1
        if changes:
            axes.append(_Axis(name, tuple(values), tuple(changes)))
            moving.append(item)
    found = Emulator(stated, tuple(axes), runs, (0.0, 0.0))
    if not axes:
        return found
    off = scenario
    for item in moving:
        off = departed_scenario(off, item.moved(1.0)) if item.settings else off
    assert off.atmosphere is not None  # noqa: S101
    return replace(found, runs=runs + 1, error=_error(found(off.atmosphere), run(off)))


def _error(guess: AtmosphericTerms, truth: AtmosphericTerms) -> tuple[float, float]:
    """Greatest and median error of the radiance over a grey ground of reflectance 0.3, where there is light."""
    seen = [
        t.path_radiance + 0.3 * (t.direct + t.adjacency) / (1 - 0.3 * t.spherical_albedo) for t in (guess, truth)
    ]
    lit = truth.direct > 1e-3 * truth.direct.max()
    relative = np.abs(seen[0] / seen[1] - 1.0)[lit]
    return float(relative.max()), float(np.median(relative))


def _names(terms: AtmosphericTerms) -> list[str]:
    skipped = ("wavelength_nm", "provenance", "fwhm_nm")
    return [f.name for f in fields(terms) if f.name not in skipped and getattr(terms, f.name) is not None]


def _logs(terms: AtmosphericTerms) -> Array:
    return np.log(np.maximum(np.stack([getattr(terms, n) for n in _names(terms)]), _TINY))
