"""The atmosphere between a few engine runs: many draws of its state for the price of two runs for each input."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.interpolation import InterpolatedTerms, interpolated_terms
from hyperval.prediction.departure import true_scenario
from hyperval.prediction.input import Input
from hyperval.prediction.input_paths import state_value
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]

# Three nodes 0 and +-sqrt(3) standard deviations: those of Gauss and Hermite, exact for moments of a cubic.
_NODE = float(np.sqrt(3.0))


@dataclass(frozen=True)
class Emulator:
    """Stands in for an engine near one state: quadratic in each uncertain field, without cross terms.

    Attributes
    ----------
    between : the runs, a star about the stated one; None where nothing of the atmosphere is uncertain
    stated : terms of the stated state
    runs : engine runs behind it
    error : greatest and median error of direct and path radiance against the engine, as a part of their sum, where
        all fields are one standard uncertainty off [1]; zeros where nothing is uncertain
    """

    between: InterpolatedTerms | None
    stated: AtmosphericTerms
    runs: int
    error: tuple[float, float]

    @property
    def axes(self) -> Mapping[str, Array]:
        """Field -> its values at the nodes, the stated one first."""
        return {} if self.between is None else self.between.between.axes

    def __call__(self, state: AtmosphericState) -> AtmosphericTerms:
        """The terms of a state that differs from the stated one in the uncertain fields alone."""
        if self.between is None:
            return self.stated
        at = {n: np.array([_beside(n, nodes[0], state_value(state, n))]) for n, nodes in self.axes.items()}
        terms = self.between(at)
        return replace(terms, **{n: getattr(terms, n)[0] for n in self.between.between.values})


def _beside(name: str, stated: float, value: float) -> float:
    """The value; an azimuth on the same turn as the stated one."""
    return stated + (value - stated + 180.0) % 360.0 - 180.0 if name.endswith("azimuth_deg") else value


def emulator(scenario: Scenario, inputs: Sequence[Input], engine: Engine, axis: SpectralAxis | None) -> Emulator:
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
    axes: dict[str, Array] = {}
    runs, moving = [stated], []
    for item in inputs:
        room, _, name = item.path.partition(".")
        if room != "atmosphere":
            continue
        assert scenario.atmosphere is not None  # noqa: S101 - inputs of the atmosphere
        values = [state_value(scenario.atmosphere, name)]
        for z in (-_NODE, _NODE):
            there = true_scenario(scenario, item.moved(z))
            assert there.atmosphere is not None  # noqa: S101
            value = _beside(name, values[0], state_value(there.atmosphere, name))
            # A node at the end of the range may be the stated value.
            if all(abs(value - v) > 1e-12 for v in values):
                values.append(value)
                runs.append(run(there))
        if len(values) > 1:
            axes[name] = np.array(values)
            moving.append(item)
    if not axes:
        return Emulator(None, stated, 1, (0.0, 0.0))
    fast = Emulator(interpolated_terms(axes, runs, star=True, bounded=False), stated, len(runs) + 1, (0.0, 0.0))
    off = scenario
    for item in moving:
        off = true_scenario(off, item.moved(1.0))
    assert off.atmosphere is not None  # noqa: S101
    return replace(fast, error=_error(fast(off.atmosphere), run(off)))


def _error(guess: AtmosphericTerms, truth: AtmosphericTerms) -> tuple[float, float]:
    """Greatest and median error of the radiance over a grey ground of reflectance 0.3, where there is light."""
    seen = [
        t.path_radiance + 0.3 * (t.direct + t.adjacency) / (1 - 0.3 * t.spherical_albedo) for t in (guess, truth)
    ]
    lit = truth.direct > 1e-3 * truth.direct.max()
    relative = np.abs(seen[0] / seen[1] - 1.0)[lit]
    return float(relative.max()), float(np.median(relative))
