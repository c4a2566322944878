"""The uncertain inputs of a prediction.

An input has K independent directions with factors of mean 0 and variance 1; a departure of the truth follows from
any set of factors.  Monte Carlo, linearisation, sensitivities and what-ifs all go through it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hyperval import datasets
from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.prediction.budget_atmosphere import atmosphere_inputs
from hyperval.prediction.budget_input import BudgetInput, Given
from hyperval.prediction.budget_scene import scene_inputs
from hyperval.prediction.budget_sensor import sensor_inputs
from hyperval.prediction.departure import Departure, combined
from hyperval.prediction.inputs import Resolve, Sources
from hyperval.prediction.setup import instrument, with_sensor_blur
from hyperval.prediction.terms import remembered
from hyperval.scenario import Scenario
from hyperval.scene.statistics import ClassStatistics
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

__all__ = ["BudgetInput", "Given", "budget_inputs", "drawn_truth", "inputs_of"]


def inputs_of(given: Given, *, shapes: bool = True) -> list[BudgetInput]:
    """The uncertain inputs in the order in which budgets list them: light, surfaces, sensor.

    ``shapes=False`` leaves out the errors of engine and field spectra, whose covariances a prediction uses as they
    stand.

    Raises
    ------
    UsageError : an uncertainty of what the scenario does not have.
    """
    return [*atmosphere_inputs(given, shapes), *scene_inputs(given, shapes), *sensor_inputs(given)]


def budget_inputs(
    scenario: Scenario,
    *,
    axis: SpectralAxis | None = None,
    measured: Mapping[str, ClassStatistics] | None = None,
    resolve: Resolve | None = None,
    cache_dir: Path | None = None,
    show_progress: bool | None = None,
    engine: Callable[[AtmosphericState], AtmosphericTerms] | None = None,
    sensor: Sensor | None = None,
) -> list[BudgetInput]:
    """The uncertain inputs that a scenario states (``uncertainty:``); parameters as those of ``predict``.

    The engine is run only where the error of the engine depends on the absorption of gases.

    Raises
    ------
    UsageError : an uncertainty of what the scenario does not have.
    """
    find = resolve or (lambda reference: datasets.resolve(reference, scenario.folder))
    known = measured or {}
    used = instrument(scenario, axis, next((s.axis for s in known.values()), None), find, sensor)
    scenario = with_sensor_blur(scenario, used.sensor)
    sources = Sources(used.true_axis, known, find, used.axis)
    scene = scenario.scene
    surfaces = {s.name: sources.surface(s) for s in (*scene.classes, *scene.panels, *scene.sites, *scene.targets)}

    def terms() -> AtmosphericTerms:
        state = scenario.atmosphere
        assert state is not None  # noqa: S101 - asked for by inputs of the light alone
        if engine is not None:
            return engine(state).at_bands(used.true_axis)
        if state.engine == "table":
            return atmospheric_terms(state, resolve=find).at_bands(used.true_axis)
        call = atmospheric_terms
        return remembered(call, state, used.true_axis, cache_dir=cache_dir, show_progress=show_progress)

    return inputs_of(Given(scenario, used.axis, used.sensor, surfaces, terms))


def drawn_truth(inputs: list[BudgetInput], rng: np.random.Generator) -> Departure:
    """One truth with every input drawn from its distribution, independently of the others."""
    return combined(*(item.drawn(rng) for item in inputs))
