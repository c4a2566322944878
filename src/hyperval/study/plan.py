"""From a study file to what its chunks need: evaluator, columns, and what the interpolated atmosphere costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.interpolation import spaced
from hyperval.datasets import InputLog
from hyperval.errors import UsageError
from hyperval.prediction.input_paths import PFA, batch_column
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.scene.radiance import mean_radiance
from hyperval.settings import with_settings
from hyperval.study.design import Column, Points, column_of, listed, moved, plain
from hyperval.study.evaluate import Evaluator, Sky, engine_on, few_states, make_ready
from hyperval.study.metrics import check_outputs
from hyperval.study.schema import Input, Move, Required, Study

Array = npt.NDArray[np.float64]
_MOST_TRIED = 200  # values of an input that are tried one by one before anything runs
_GROUND = 0.3  # reflectance over which the error of the atmosphere is stated
_LEAST_GAS = 0.1  # and the two-way gas transmittance above which


@dataclass(frozen=True)
class Plan:
    """A study ready to run.

    Attributes
    ----------
    notes : what is to be said of how it is evaluated
    sky_error : what the interpolation of the atmosphere costs, name -> value; empty where it is not interpolated
    log : files that were read
    """

    study: Study
    scenario: Scenario
    points: Points
    evaluator: Evaluator
    notes: tuple[str, ...]
    sky_error: Mapping[str, float]
    log: InputLog

    def columns(self, start: int, stop: int) -> dict[str, Column]:
        """Dotted path -> values at the points from ``start`` to before ``stop``."""
        return moved({i.name: i for i in self.study.inputs}, self.points.stretch(start, stop))


def plan_study(study: Study, *, show_progress: bool | None = None) -> Plan:
    """Check a study against its scenario and run its atmosphere.

    Raises
    ------
    UsageError : inputs or outputs that the scenario does not have, or values that it does not take.
    InputError, EngineError : as ``predict``.
    """
    scenario = _scenario(study)
    log = InputLog(scenario.folder or study.folder)
    if study.folder is not None and study.scenario not in builtin_scenarios():
        log.add((study.folder / study.scenario).resolve(), study.scenario)
    points = Points(study)
    try_values(study, scenario)
    sky, anew = _sky(study, scenario)
    base = make_ready(scenario, sky, show_progress=show_progress)
    check_outputs(study.outputs, scenario, base.setup.used.axis)
    for reference in _references(scenario):
        log.resolve(reference)
    evaluator = Evaluator(base, sky, anew)
    plan = Plan(study, scenario, points, evaluator, (), {}, log)
    plan = replace(plan, notes=tuple(_notes(plan)))
    return replace(plan, sky_error=_sky_error(plan) if sky.nodes else {})


def _scenario(study: Study) -> Scenario:
    if study.scenario in builtin_scenarios() or study.folder is None:
        scenario = load_scenario(study.scenario)
    else:
        scenario = load_scenario(study.folder / study.scenario)
    return with_settings(scenario, study.settings) if study.settings else scenario


def try_values(study: Study, scenario: Scenario) -> None:
    """Refuse values that the scenario does not take: every listed one, or the ends where there are many.

    Limits of numbers are intervals, so that the ends speak for what lies between.
    """
    items: list[Input | Required] = [*study.inputs, *study.required]
    for item in items:
        for value in _values_to_try(item):
            point = moved({item.name: _as_input(item)}, {item.name: column_of([value])})
            changes = {p: plain(c[0]) for p, c in point.items()}
            at = changes.pop(PFA, None)
            if at is not None and not 0.0 < at < 1.0:
                raise UsageError(f"input {item.name!r}: a false-alarm probability of {at:g}", expected="0 to 1")
            try:
                if changes:
                    with_settings(scenario, changes)
            except UsageError as error:
                raise UsageError(f"input {item.name!r} at {value!r}: {error}") from error


def _as_input(item: Input | Required) -> Input:
    if isinstance(item, Input):
        return item
    return Input(name=item.name, path=item.path, moves=item.moves, values=[item.between[0]])


def _values_to_try(item: Input | Required) -> list[Any]:
    if isinstance(item, Required):
        return list(item.between)
    if item.random is not None:
        return list(item.random.ends)
    values = listed(item)
    assert values is not None  # noqa: S101 - the model's own check
    tries = values.tolist()
    return tries if len(tries) <= _MOST_TRIED or values.dtype == object else [min(tries), max(tries)]


def _sky(study: Study, scenario: Scenario) -> tuple[Sky, frozenset[str]]:
    """States of the atmosphere that the study needs, and entries that have to be read anew for each value."""
    if scenario.atmosphere is None:
        return Sky(), frozenset()
    moving: list[tuple[Input | Required, Move, str]] = []
    items: list[Input | Required] = [*study.inputs, *study.required]
    for item in items:
        for move in item.targets:
            column = batch_column(scenario, move.path)
            if column.kind == "atmosphere":
                moving.append((item, move, column.key))
    if not moving:
        return Sky(), frozenset()
    alone = study.design.kind == "one-at-a-time"
    values = {}
    for item, _, _ in moving:
        states = listed(item) if isinstance(item, Input) else None
        values[item.name] = None if states is None else [*([None] if alone else []), *states.tolist()]
    if all(v is not None for v in values.values()):
        count = int(np.prod([len(v or ()) for v in values.values()]))
        if alone or count <= study.atmosphere.above:
            return _listed_states(values, moving, alone), frozenset()
    anew = frozenset(m.path for i, m, _ in moving if isinstance(i, Input) and _words(i))
    nodes = {}
    for item, move, key in moving:
        if move.path in anew:
            continue
        ends = np.sort(move.offset + move.factor * np.array([float(v) for v in _values_to_try(item)]))
        different = np.unique(ends)
        few = isinstance(item, Input) and item.random is None and different.size <= study.atmosphere.nodes
        low, high = float(different[0]), float(different[-1])
        nodes[key] = tuple((different if few else spaced(key, low, high, study.atmosphere.nodes)).tolist())
    return Sky(nodes=nodes), anew


def _words(item: Input) -> bool:
    values = listed(item)
    return values is not None and values.dtype == object


def _listed_states(
    values: Mapping[str, list[Any] | None], moving: list[tuple[Input | Required, Move, str]], alone: bool
) -> Sky:
    combinations = [
        c for c in product(*(v or [] for v in values.values())) if not alone or sum(x is not None for x in c) <= 1
    ]
    columns = {name: column_of(of) for name, of in zip(values, zip(*combinations, strict=True), strict=True)}
    states = moved({item.name: _as_input(item) for item, _, _ in moving}, columns)
    return Sky(states={key: states[move.path] for _, move, key in moving})


def _notes(plan: Plan) -> list[str]:
    notes = []
    items: list[Input | Required] = [*plan.study.inputs, *plan.study.required]
    paths = [m.path for i in items for m in i.targets]
    anew = [p for p in paths if plan.evaluator.column(p).kind == "anew"]
    if anew:
        notes.append(f"read anew for each value, as in predict: {', '.join(anew)}")
    for key, nodes in plan.evaluator.sky.nodes.items():
        notes.append(
            f"atmosphere.{key} is interpolated between engine runs at " + ", ".join(f"{x:.4g}" for x in nodes)
        )
    return notes


def _references(scenario: Scenario) -> list[str]:
    """Files that a scenario names."""
    from hyperval.sensor.specification import library_names

    scene = scenario.scene
    surfaces = (*scene.classes, *scene.panels, *scene.sites, *scene.targets)
    named = [s.spectrum.file or s.spectrum.library for s in surfaces]
    named += [s.covariance.library for s in surfaces if s.covariance is not None]
    named += [t.filter_spectrum.file for t in scene.targets if t.filter_spectrum is not None]
    if scenario.sensor is not None and scenario.sensor not in library_names():
        named.append(scenario.sensor)
    if scenario.atmosphere is not None:
        named.append(scenario.atmosphere.table)
    return sorted({n for n in named if n is not None})


def _sky_error(plan: Plan) -> dict[str, float]:
    """What the interpolation of the atmosphere costs at held-out states, drawn between the nodes (seeded).

    Relative error of the radiance over ground of 0.3 where the two-way gas transmittance is above 0.1 (worst and
    rms), and the absolute error of every output, the other inputs as at the first points of the design.
    """
    study, evaluator = plan.study, plan.evaluator
    base, nodes = evaluator.base, evaluator.sky.nodes
    count = study.atmosphere.checked
    rng = np.random.default_rng([study.design.seed, 6])
    states = {k: _between(np.array(n), rng.random(count)) for k, n in nodes.items()}
    assert plan.scenario.atmosphere is not None  # noqa: S101 - there is a table
    assert base.terms is not None  # noqa: S101
    engine = engine_on(base.setup)
    exact = few_states(plan.scenario.atmosphere, engine, states)
    ours, theirs = base.terms(states, count), exact(states, count)

    seen = theirs.gas_transmittance > _LEAST_GAS
    radiance, expected = (mean_radiance(terms, _GROUND, _GROUND)[seen] for terms in (ours, theirs))
    error = radiance / expected - 1.0
    errors = {"radiance, worst": float(np.abs(error).max()), "radiance, rms": float(np.sqrt(np.mean(error**2)))}
    columns = plan.columns(0, min(count, len(plan.points)))
    short = len(next(iter(columns.values())))
    columns = {p: c[np.arange(count) % short] for p, c in columns.items()}
    columns |= {f"atmosphere.{k}": v for k, v in states.items()}
    for question in study.required:
        middle = 0.5 * sum(question.between)
        for m in question.targets:
            if evaluator.column(m.path).kind != "atmosphere":
                columns[m.path] = np.full(count, m.offset + m.factor * middle)
    a, _ = evaluator.values(columns, study.outputs)
    b, _ = replace(evaluator, base=replace(base, terms=exact)).values(columns, study.outputs)
    for k, output in enumerate(study.outputs):
        errors[f"output {output.name}"] = float(np.max(np.abs(a[:, k] - b[:, k])))
    return errors


def _between(nodes: Array, u: Array) -> Array:
    """Points in the middle halves of the intervals between nodes, where an interpolation is worst."""
    k = np.minimum((u * (nodes.size - 1)).astype(int), nodes.size - 2)
    part = 0.25 + 0.5 * (u * (nodes.size - 1) - k)
    return np.asarray(nodes[k] + part * np.diff(nodes)[k])
