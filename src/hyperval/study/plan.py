"""From a study file to what its chunks need: evaluator, columns, and what the interpolated atmosphere costs.

Inverse questions: at which value of an input does an output take a value?
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize.elementwise import find_root

from hyperval.atmosphere.between import spaced
from hyperval.datasets import InputLog
from hyperval.errors import UsageError
from hyperval.model import Origins, World, column_of, find, in_file, plain, read, reads_again
from hyperval.model.radiance import mean_radiance
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.settings import with_settings
from hyperval.study.evaluate import PFA, Columns, Evaluator, check_outputs
from hyperval.study.schema import Input, Output, Required, StudyFile
from hyperval.study.tables import Column, StudyPoints, moved

Array = npt.NDArray[np.float64]
_MOST_TRIED = 200  # values of an input that are tried one by one before anything runs
GROUND = 0.3  # reflectance over which the error of the atmosphere is stated
LEAST_GAS = 0.1  # and the two-way gas transmittance above which


@dataclass(frozen=True)
class Plan:
    """A study ready to run.

    Attributes
    ----------
    notes : what is to be said of how it is evaluated
    sky_error : what the interpolation of the atmosphere costs, name -> value; empty where it is not interpolated
    log : files that were read
    """

    study: StudyFile
    scenario: Scenario
    points: StudyPoints
    evaluator: Evaluator
    notes: tuple[str, ...]
    sky_error: Mapping[str, float]
    log: InputLog

    def columns(self, start: int, stop: int) -> dict[str, Column]:
        """Dotted path -> values at the points from ``start`` to before ``stop``."""
        return moved(self.study.inputs, self.points.stretch(start, stop))


def plan_study(study: StudyFile, *, show_progress: bool | None = None) -> Plan:
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
    points = StudyPoints(study)
    states, nodes = _states(study, scenario)
    world = read(scenario, Origins(resolve=log.resolve, show_progress=False), nodes=nodes)
    try_values(study, world)
    world.stated.atmosphere.prepare(states, show_progress)
    check_outputs(study.outputs, scenario, world.stated.axis)
    plan = Plan(study, scenario, points, Evaluator(world), (), {}, log)
    plan = replace(plan, sky_error=_sky_error(plan) if nodes else {})
    return replace(plan, notes=tuple(_notes(plan)))


def _scenario(study: StudyFile) -> Scenario:
    if study.scenario in builtin_scenarios() or study.folder is None:
        scenario = load_scenario(study.scenario)
    else:
        scenario = load_scenario(study.folder / study.scenario)
    return with_settings(scenario, study.settings) if study.settings else scenario


def try_values(study: StudyFile, world: World) -> None:
    """Refuse values that the scenario does not take, and those beyond the limits of a path of the model (``PATHS``).

    Tried is every listed one, or the ends where there are many: limits of numbers are intervals, so that the ends
    speak for what lies between.
    """
    for item in study.moving:
        for value in _values_to_try(item):
            point = moved([item], {item.name: column_of([value])})
            changes = {path: plain(column[0]) for path, column in point.items()}
            try:
                if (at := changes.pop(PFA, None)) is not None and not 0.0 < at < 1.0:
                    raise UsageError(f"a false-alarm probability of {at:g}", expected="0 to 1")
                for path in [path for path in changes if not in_file(path)]:
                    entry, number = find(world.stated, path), changes.pop(path)
                    if not entry.low <= number <= entry.high:
                        expected = f"a number from {entry.low:g} to {entry.high:g}"
                        raise UsageError(f"{path} at {value!r}", expected=expected)
                if changes:
                    with_settings(world.stated.scenario, changes)
            except UsageError as error:
                raise UsageError(f"input {item.name!r} at {value!r}: {error}") from error


def _values_to_try(item: Input | Required) -> list[Any]:
    if isinstance(item, Required):
        return list(item.between)
    if item.listed is None:
        return list(item.random.ends) if item.random is not None else []
    tries = item.listed.tolist()
    return tries if len(tries) <= _MOST_TRIED or item.listed.dtype == object else [min(tries), max(tries)]


def _states(study: StudyFile, scenario: Scenario) -> tuple[list[Mapping[str, Any]], dict[str, tuple[float, ...]]]:
    """States of the atmosphere that the study needs, entries that differ in each; or nodes of entries to go between."""
    if scenario.atmosphere is None:
        return [], {}
    moving = [
        (item, move, key) for item in study.moving for move in item.targets
        for room, _, key in [move.path.partition(".")] if room == "atmosphere" and key not in ("engine", "table")
    ]  # fmt: skip
    items = list({item.name: item for item, _, _ in moving}.values())
    listed = [item for item in items if isinstance(item, Input) and not item.random]
    points = StudyPoints(study.model_copy(update={"inputs": listed}))
    few = study.design.kind == "one-at-a-time" or len(points) <= study.atmosphere.above
    if len(listed) == len(items) and few:
        columns = moved(items, points.stretch(0, len(points)))
        keys, each = [key for _, _, key in moving], [columns[move.path].tolist() for _, move, _ in moving]
        rows = [dict(zip(keys, row, strict=True)) for row in zip(*each, strict=True)] or [{}]
        rows = [{key: plain(v) for key, v in row.items() if v is not None} for row in rows]
        return list({repr(sorted(row.items())): row for row in rows}.values()), {}
    nodes = {}
    for item, move, key in moving:
        own = item.listed if isinstance(item, Input) else None
        if own is None or own.dtype != object:  # words are read again for each
            ends = np.unique([move.offset + move.factor * float(v) for v in _values_to_try(item)])
            few = own is not None and ends.size <= study.atmosphere.nodes
            between = ends if few else spaced(key, float(ends[0]), float(ends[-1]), study.atmosphere.nodes)
            nodes[key] = tuple(between.tolist())
    return [], nodes


def _notes(plan: Plan) -> list[str]:
    notes = []
    paths = [m.path for i in plan.study.moving for m in i.targets]
    stated = plan.evaluator.world.stated
    anew = [p for p in paths if p != PFA and reads_again(stated, p)]
    if anew:
        notes.append(f"read anew for each value, as in predict: {', '.join(anew)}")
    for key, nodes in stated.atmosphere.nodes.items():
        notes.append(f"atmosphere.{key} is interpolated between engine runs at " + ", ".join(f"{x:.4g}" for x in nodes))
    notes += [
        f"interpolated atmosphere at {plan.study.atmosphere.checked} held-out states: {name} relative error "
        f"{error:.1e} (ground of {GROUND:g}, two-way gas transmittance above {LEAST_GAS:g})"
        for name, error in plan.sky_error.items() if name.startswith("radiance")
    ]  # fmt: skip
    if any(i.random for i in plan.study.inputs):
        notes.append(f"random inputs: Sobol sequence, scrambled, seed {plan.study.design.seed}")
    return notes


def _sky_error(plan: Plan) -> dict[str, float]:
    """What the interpolation of the atmosphere costs at held-out states, drawn between the nodes (seeded).

    Relative error of the radiance over ground of 0.3 where the two-way gas transmittance is above 0.1 (worst and
    rms), and the absolute error of every output, the other inputs as at the first points of the design.
    """
    study, stated = plan.study, plan.evaluator.world.stated
    between, count = stated.atmosphere, study.atmosphere.checked
    rng = np.random.default_rng([study.design.seed, 6])
    states = {f"atmosphere.{k}": _between(np.array(n), rng.random(count)) for k, n in between.nodes.items()}
    exact = replace(between, nodes={}, kept={})
    ours, theirs = between(states, count), exact(states, count)

    seen = theirs.gas_transmittance > LEAST_GAS
    radiance, expected = (mean_radiance(terms, GROUND, GROUND)[seen] for terms in (ours, theirs))
    error = radiance / expected - 1.0
    errors = {"radiance, worst": float(np.abs(error).max()), "radiance, rms": float(np.sqrt(np.mean(error**2)))}
    columns = plan.columns(0, min(count, len(plan.points)))
    short = len(next(iter(columns.values())))
    columns = {p: c[np.arange(count) % short] for p, c in columns.items()}
    columns |= states
    for question in study.required:
        middle = 0.5 * sum(question.between)
        for m in question.targets:
            if m.path not in states:
                columns[m.path] = np.full(count, m.offset + m.factor * middle)
    a, _ = plan.evaluator.values(columns, study.outputs)
    b, _ = Evaluator(World(replace(stated, atmosphere=exact, kept={}))).values(columns, study.outputs)
    for k, output in enumerate(study.outputs):
        errors[f"output {output.name}"] = float(np.max(np.abs(a[:, k] - b[:, k])))
    return errors


def _between(nodes: Array, u: Array) -> Array:
    """Points in the middle halves of the intervals between nodes, where an interpolation is worst."""
    k = np.minimum((u * (nodes.size - 1)).astype(int), nodes.size - 2)
    part = 0.25 + 0.5 * (u * (nodes.size - 1) - k)
    return np.asarray(nodes[k] + part * np.diff(nodes)[k])


_MOST_AT_ONCE = 4096  # evaluations in one batch


class Answers(NamedTuple):
    """Answers at n points.

    Attributes
    ----------
    solutions : (n,) values of the input; NaN where there is none
    reports : (n, R) outputs told at the answer
    reasons : number of the point -> why there is none, or what else is to be said
    """

    solutions: Array
    reports: Array
    reasons: Mapping[int, str]


def answers(evaluator: Evaluator, columns: Columns, question: Required, outputs: Sequence[Output]) -> Answers:
    """Solve output(x) = value for x at every point of ``columns`` (dotted path -> (n,)).

    The output is looked at over the range; a change of sign between neighbours is a bracket, in which the root is
    found by Chandrupatla's method (Adv. Eng. Softw. 28, 145, 1997: inverse quadratic steps inside a bracket, as
    Brent's), for all points together.  Without a bracket there is no solution, and the reason says how far the
    output reaches.  With several the lowest is told, and that there are more.
    """

    def at(x: Array, rows: npt.NDArray[Any], *names: str) -> Array:
        """Outputs (k, O) at points ``rows`` with the question's input at ``x`` (k,)."""
        wanted, index, parts = [named[name] for name in names], np.asarray(rows, int), []
        for start in range(0, x.size, _MOST_AT_ONCE):
            some = slice(start, start + _MOST_AT_ONCE)
            own = {path: column[index[some]] for path, column in columns.items()}
            own |= {m.path: m.offset + m.factor * x[some] for m in question.targets}
            parts.append(evaluator.values(own, wanted)[0])
        return np.concatenate(parts)

    def miss(x: Array, row: Array) -> Array:
        return at(x.ravel(), row.ravel(), question.output).reshape(x.shape) - question.equals

    named = {o.name: o for o in outputs}
    n = len(next(iter(columns.values())))
    x = (np.geomspace if question.spacing == "log" else np.linspace)(*question.between, question.scan)
    gap = miss(np.tile(x, n), np.repeat(np.arange(n), x.size)).reshape(n, x.size)
    bracket, said = zip(*(_bracket(x, own, question) for own in gap), strict=True)
    reasons = {i: why for i, why in enumerate(said) if why}
    first, values = np.array(bracket), np.full(n, np.nan)
    solved = np.flatnonzero(first >= 0)
    if solved.size:
        ends = x[first[solved]], x[first[solved] + 1]
        root = find_root(miss, ends, args=(solved.astype(float),), tolerances={"xrtol": 1e-10}, maxiter=100)
        values[solved] = np.where(root.success, root.x, np.nan)
        reasons |= {int(i): "the root was not found" for i in solved[~root.success]}
    reports = np.full((n, len(question.report)), np.nan)
    good = np.flatnonzero(np.isfinite(values))
    if reports.size and good.size:
        reports[good] = at(values[good], good, *question.report)
    return Answers(values, reports, reasons)


def _bracket(x: Array, gap: Array, question: Required) -> tuple[int, str]:
    """Number of the interval that holds the lowest root, -1 without, and what is to be said of it."""
    if not np.all(np.isfinite(gap)):
        return -1, f"{question.output} can not be evaluated over the whole range"
    signs = np.sign(gap)
    change = np.flatnonzero(signs[:-1] * signs[1:] <= 0)
    # A scan value that is itself a root belongs to two intervals.
    change = change[~(np.isin(change - 1, change) & (signs[change] == 0))]
    if not change.size:
        side, best = ("below", int(np.argmax(gap))) if gap[0] < 0 else ("above", int(np.argmin(gap)))
        reached = f"{gap[best] + question.equals:.4g} at {x[best]:.4g}"
        return -1, f"no solution: {question.output} stays {side} {question.equals:g}; it comes to {reached}"
    steps = np.diff(gap)
    monotone = bool(np.all(steps >= -1e-12) or np.all(steps <= 1e-12))
    if change.size > 1:
        return int(change[0]), f"not monotone: {change.size} solutions; the lowest is told"
    return int(change[0]), "" if monotone else "not monotone over the range, one solution all the same"
