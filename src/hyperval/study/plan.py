"""A study's points, the outputs of many truths at once, inverse questions, and the error of its atmosphere."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import stats
from scipy.optimize.elementwise import find_root
from scipy.stats import qmc

from hyperval.atmosphere.between import interpolation_nodes
from hyperval.data import Array, Index
from hyperval.datasets import InputLog
from hyperval.errors import UsageError, needed, refuse
from hyperval.executors import Parcel, opened
from hyperval.model import Evaluation, Origins, World, evaluations, read_world, with_truths
from hyperval.model.forward import reflectances
from hyperval.model.radiance import Light, mean_radiance
from hyperval.model.roc import WHOLE, RocArea
from hyperval.model.stated import scalar, state_entries
from hyperval.model.world import as_column, check_numbers, is_in_file
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis
from hyperval.study.schema import Input, Moving, Output, Random, Required, StudyFile

Column = npt.NDArray[Any]
Columns = Mapping[str, Column]
Chunk = tuple[Array, dict[int, str]]  # outputs and answers of its points, and what is to be said of a point
PFA = "pfa"  # beside the paths of the scenario: the false-alarm probability at which P_D is read
_MAX_AT_ONCE = 512  # evaluations in one batch
MAX_TRIED = 200  # values of an input that are tried one by one before anything runs
GROUND = 0.3  # reflectance over which the error of the atmosphere is stated
MIN_GAS = 0.1  # and the two-way gas transmittance above which


def quantiles(distribution: Random, u: Array) -> Array:
    """Values of a distribution at quantiles ``u`` in (0, 1)."""
    low, high = distribution.limits
    if distribution.normal is not None:
        mean, sd = distribution.normal
        return np.asarray(stats.truncnorm.ppf(u, (low - mean) / sd, (high - mean) / sd, mean, sd))
    log = distribution.log_uniform is not None
    return np.asarray(stats.loguniform.ppf(u, low, high) if log else stats.uniform.ppf(u, low, high - low))


def input_values(study: StudyFile, start: int = 0, stop: int | None = None) -> Mapping[str, Column]:
    """Input name -> its values at the points of a study from ``start`` to before ``stop``, or to the last.

    The last listed input moves fastest, the random draws slowest.  A random design is Sobol's sequence, scrambled by
    its seed (Owen); the point of a number does not depend on how many are asked for at once.  Inputs that a
    one-at-a-time design leaves alone hold None.
    """
    number, columns, first = np.arange(start, study.count if stop is None else stop), dict[str, Column](), 1
    listed = {i.name: values for i in study.inputs if (values := i.listed_values) is not None}
    random = {i.name: i.random for i in study.inputs if i.random is not None}
    if study.design.kind == "one-at-a-time":
        for name, values in listed.items():
            inside = (number >= first) & (number < first + len(values))
            columns[name] = np.full(number.size, None, dtype=object)
            columns[name][inside] = values[number[inside] - first]
            first += len(values)
        return columns
    for name, values in reversed(listed.items()):
        number, index = np.divmod(number, len(values))
        columns[name] = values[index]
    if random:  # what is left is the number of the draw
        u = _sobol(len(random), study.design.seed, int(number[0]), int(number[-1]) + 1)[number - number[0]]
        columns |= {name: quantiles(law, u[:, k]) for k, (name, law) in enumerate(random.items())}
    return {i.name: columns[i.name] for i in study.inputs}


def _sobol(dimensions: int, seed: int, start: int, stop: int) -> Array:
    """Points ``start`` to before ``stop`` of a scrambled Sobol sequence, strictly inside the unit cube."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=seed)
    with warnings.catch_warnings():  # a stretch of the sequence has no power of two points, and need not
        warnings.simplefilter("ignore", UserWarning)
        if start:
            sequence.fast_forward(start)
        return np.asarray(np.clip(sequence.random(stop - start), 1e-12, 1.0 - 1e-12))


def path_values(inputs: Sequence[Moving], columns: Mapping[str, Column]) -> dict[str, Column]:
    """Dotted path -> (n,) values at the points of ``columns``; None where an entry is left as it is."""
    out: dict[str, Column] = {}
    for item in inputs:
        column, moves = columns[item.name], item.entries
        for k, move in enumerate(moves):
            single = (v[k] if isinstance(v, list) and len(moves) > 1 else v for v in column)
            out[move.path] = move.apply(column) if column.dtype != object else as_column(list(map(move.apply, single)))
    return out


def plain_value(value: Any) -> Any:
    """A value of an input that can be compared and told: lists and mappings as their text."""
    return str(value) if isinstance(value, list | dict) else value.item() if hasattr(value, "item") else value


def check_outputs(outputs: list[Output], scenario: Scenario, axis: SpectralAxis) -> None:
    """Refuse outputs of subjects, detectors or bands that the scenario does not have.

    Raises
    ------
    UsageError : with the output's name.
    """
    scene, detectors = scenario.scene, scenario.processing.detectors
    pure = [s.name for s in (*scene.classes, *scene.panels, *scene.sites)]
    populations = [p.name for t in scene.targets for p in t.populations]
    for o in outputs:
        where = f"output {o.name!r}"
        among = pure if o.is_spectral else populations
        refuse(o.is_spectral and scenario.atmosphere is None, "study.atmosphere", at=where, kind=o.kind)
        refuse(not o.is_spectral and not detectors, "study.detectors", at=where)
        refuse(o.subject not in among, "study.subject", at=where, subject=o.subject, names=", ".join(among))
        unknown = o.detector not in (None, *detectors)
        refuse(unknown, "study.detector", at=where, detector=o.detector, names=", ".join(detectors))
        if o.is_spectral:
            output_bands(o, axis)


def output_bands(output: Output, axis: SpectralAxis) -> Index:
    """Numbers of the bands that a spectral output reads.

    Raises
    ------
    UsageError : no band there.
    """
    w = axis.centre_nm
    if output.band_nm is not None:
        band = axis.nearest(output.band_nm, widths=2.0)
        return np.array([needed(band, "study.band", name=output.name, nm=output.band_nm)])
    low, high = output.range_nm or (0.0, np.inf)
    bands = np.flatnonzero((w >= low) & (w <= high) & axis.clear)
    refuse(not bands.size, "study.range", name=output.name, low=low, high=high)
    return bands


def evaluate_output(e: Evaluation, output: Output, pfa: Array | None) -> Array:
    """An output in every truth of an evaluation (n,); ``pfa`` (n,) where an input moves it."""
    if output.is_spectral:
        bands = output_bands(output, e.axis)
        values = (e.snr if output.kind == "snr" else e.radiance)(output.subject)
        return np.asarray(values[:, bands].mean(axis=1))
    detector = output.detector or e.scenario.processing.detectors[0]
    scores = e.scores(output.subject, detector, output.kind == "pd" and output.by == "object")
    if output.kind == "pd":
        level = np.array([[output.pfa]]) if pfa is None else np.asarray(pfa, float)[:, None]
        return np.asarray(scores.detection(level)[:, 0])
    if output.kind == "log10-pfa":
        return scores.log10_false_alarm(np.full(len(e), output.pd))
    return scores.auc(WHOLE if output.kind == "auc" else RocArea(*output.pfa_range, logarithmic=True))


def saturation(e: Evaluation) -> dict[int, str]:
    """Truth -> which subjects pass full scale there, in some band of their mean radiance."""

    def saturates(light: Light, rho: Array) -> Array:
        part = needed(light.noise, "scenario.noise").full_scale_fraction(light.signal(rho))
        return np.asarray(np.any(part > 1.0, axis=(1, 2)))

    noise, brightest = e.light.noise, np.fmax.reduce(e.light_world.mean, axis=1, keepdims=True)  # surfaces, mixtures
    if noise is None or noise.full_scale is None or not saturates(e.light, brightest).any():
        return {}
    light, each = e.light.rows(e.light_index), reflectances(e).items()
    passed = {name: np.broadcast_to(saturates(light, rho), (len(e),)) for name, (rho, _) in each}
    by_truth = {u: [name for name, where in passed.items() if where[u]] for u in range(len(e))}
    return {u: f"SATURATION: full scale is passed by {', '.join(names)}" for u, names in by_truth.items() if names}


def output_values(world: World, columns: Columns, outputs: Sequence[Output]) -> tuple[Array, dict[int, str]]:
    """Outputs (n, O) of a world at n points, NaN where there is none; the reason, or what saturates, by point.

    ``columns``: dotted path -> (n,) values, None where an entry is left as it is.  Where points cannot be evaluated
    together, they are bisected to find those that cannot at all.

    Examples
    --------
    >>> world = read_world(with_settings(load_scenario("panels"), {"atmosphere.engine": "emulator"}))
    >>> snr = Output(name="snr", kind="snr", subject="grass", band_nm=550.0)
    >>> values, _ = output_values(world, {"sensor.noise": as_column([None, 2.0])}, [snr])
    >>> round(float(values[0, 0] / values[1, 0]), 6)
    2.0
    >>> output_values(world, {"sensor_changes.signal_factor": as_column([1.0, 2.0])}, [snr])[1]
    {1: 'SATURATION: full scale is passed by grass, white panel, grey panel 48'}
    """
    n = len(next(iter(columns.values())))
    values, problems = np.full((n, len(outputs)), np.nan), dict[int, str]()
    pieces = [np.arange(start, min(start + _MAX_AT_ONCE, n)) for start in range(0, n, _MAX_AT_ONCE)]
    while pieces:
        rows = pieces.pop()
        moved = {p: c[rows] for p, c in columns.items()}
        pfa = moved.pop(PFA, None)
        truths = [{p: c[i] for p, c in moved.items() if c[i] is not None} for i in range(rows.size)]
        try:
            for index, e in evaluations(with_truths(world, truths)):
                points, rates = rows[index], None if pfa is None else pfa[index]
                values[points] = np.stack([evaluate_output(e, o, rates) for o in outputs], axis=1)
                remarks = saturation(e) | {u: " ".join(str(error).split()) for u, error in e.problems.items()}
                problems |= {int(points[u]): words for u, words in remarks.items()}
        except UsageError as error:
            if rows.size > 1:
                pieces += np.array_split(rows, 2)
            else:
                problems[int(rows[0])] = " ".join(str(error).split())
    return values, problems


@dataclass(frozen=True)
class Plan:
    """A study ready to run.

    Attributes
    ----------
    atmosphere_error : what the interpolation of the atmosphere costs, name -> value; empty where it is not interpolated
    log : files that were read
    """

    study: StudyFile
    scenario: Scenario
    world: World
    atmosphere_error: Mapping[str, float]
    log: InputLog


def plan_study(study: StudyFile) -> Plan:
    """Check a study against its scenario and run its atmosphere.

    Raises
    ------
    UsageError : inputs or outputs that the scenario does not have, or values that it does not take.
    InputError, EngineError : as ``predict``.

    >>> sun, water = ({"name": n, "path": f"atmosphere.{n}"} for n in ("solar_zenith_deg", "water_vapour_g_cm2"))
    >>> inputs, snr = [sun | {"values": [50]}, water | {"random": {"uniform": [1, 2]}}], {"name": "s", "kind": "snr"}
    >>> study = StudyFile(name="a", scenario="panels", settings={"atmosphere.engine": "emulator"}, inputs=inputs,
    ...                   outputs=[snr | {"subject": "grass", "band_nm": 550}], atmosphere={"checked": 1})
    >>> plan_study(study).scenario.atmosphere.solar_zenith_deg, list(plan_study(study).world.stated.atmosphere.nodes)
    (50.0, ['water_vapour_g_cm2'])
    """
    file = study.folder / study.scenario if study.folder and study.scenario not in builtin_scenarios() else None
    scenario = load_scenario(file or study.scenario)
    if file is None:  # a built-in one has no files of its own: what the settings name lies beside the study
        scenario._folder = study.folder
    scenario = with_settings(scenario, study.settings) if study.settings else scenario
    log = InputLog(scenario.folder)
    if file is not None:
        log.add(file.resolve(), study.scenario)
    states, nodes = plan_states(study, scenario)
    # What has one value beside others that are interpolated is set.
    alone = {key: nodes.pop(key)[0] for key in [key for key, values in nodes.items() if len(values) == 1]}
    if alone:
        scenario = with_settings(scenario, file_entries(scenario, {f"atmosphere.{k}": v for k, v in alone.items()}))
    world = read_world(scenario, Origins(resolve=log.resolve), nodes=nodes)
    check_values(study, world)
    world.stated.atmosphere.prepare(states)
    check_outputs(study.outputs, scenario, world.stated.axis)
    return Plan(study, scenario, world, _atmosphere_error(study, world) if nodes else {}, log)


def check_values(study: StudyFile, world: World) -> None:
    """Refuse values that the scenario does not take, and those beyond the limits of a path of the model (``PATHS``).

    Tried is every listed one, or the ends where there are many: limits of numbers are intervals, so that the ends
    speak for what lies between.
    """
    for item in study.all_inputs:
        for value in values_to_try(item):
            try:
                check_changes(world, point_values(item, value))
            except UsageError as error:
                raise UsageError(f"input {item.name!r} at {value!r:.80}: {error}") from error


def check_changes(world: World, changes: dict[str, Any]) -> None:
    """Refuse values at dotted paths that the scenario or the model does not take; None: an entry that is left alone."""
    pfa = changes.get(PFA, 0.5)
    refuse(not (isinstance(pfa, Real) and 0.0 < float(pfa) < 1.0), "study.pfa", at=pfa)
    changes = {path: value for path, value in changes.items() if value is not None and path != PFA}
    check_numbers(world, changes)
    entries = file_entries(world.stated.scenario, {path: v for path, v in changes.items() if isinstance(v, Real)})
    entries |= {path: v for path, v in changes.items() if not path.endswith("_zenith_deg")}
    with_settings(world.stated.scenario, {path: v for path, v in (changes | entries).items() if is_in_file(path)})


def file_entries(scenario: Scenario, values: Mapping[str, Any]) -> dict[str, Any]:
    """Values at paths as entries of a scenario's file: with what gives way to them, as time and place do to the sun.

    >>> stated, values = load_scenario("panels"), {"atmosphere.solar_zenith_deg": -5.0, "scene.classes.grass.gain": 2.0}
    >>> file_entries(stated, values)
    {'scene.classes.grass.gain': 2.0, 'atmosphere.solar_zenith_deg': 5.0, 'atmosphere.solar_azimuth_deg': 0.0}
    >>> file_entries(stated.model_copy(update={"atmosphere": None}), values)
    {'scene.classes.grass.gain': 2.0}
    """
    state, sky = scenario.atmosphere, {p.partition(".")[2]: v for p, v in values.items() if p.startswith("atmosphere.")}
    entries = state_entries(state, sky) if state is not None else {}
    out = {path: v for path, v in values.items() if not path.startswith("atmosphere.")}
    return out | {f"atmosphere.{key}": value for key, value in entries.items()}


def point_values(item: Moving, value: Any) -> dict[str, Any]:
    """Dotted path -> what stands there where an input has a value; None where an entry is left as it is."""
    return {path: scalar(column[0]) for path, column in path_values([item], {item.name: as_column([value])}).items()}


def values_to_try(item: Input | Required) -> list[Any]:
    """Values that are checked for all of an input: every listed one, or the ends of many numbers."""
    if isinstance(item, Required):
        return list(item.between)
    if item.listed_values is None:
        return list(item.random.limits) if item.random is not None else []
    tries = item.listed_values.tolist()
    return tries if len(tries) <= MAX_TRIED or item.listed_values.dtype == object else [min(tries), max(tries)]


def plan_states(study: StudyFile, scenario: Scenario) -> tuple[list[Mapping[str, Any]], dict[str, tuple[float, ...]]]:
    """States of the atmosphere that the study needs, entries that differ in each; or nodes of entries to go between."""
    if scenario.atmosphere is None:
        return [], {}
    moving = [
        (item, move, key) for item in study.all_inputs for move in item.entries
        for room, _, key in [move.path.partition(".")] if room == "atmosphere" and key not in ("engine", "table")
    ]  # fmt: skip
    items = list({item.name: item for item, _, _ in moving}.values())
    listed = [item for item in items if isinstance(item, Input) and not item.random]
    alone = study.model_copy(update={"inputs": listed})
    few = study.design.kind == "one-at-a-time" or alone.count <= study.atmosphere.above
    # What is looked for along a sky that is emulated needs no states beforehand.
    asked = [item for item in items if isinstance(item, Required) and scenario.atmosphere.engine == "emulator"]
    if len(listed) + len(asked) == len(items) and few:
        columns, keys = path_values(listed, input_values(alone)), {m.path: key for i, m, key in moving if i in listed}
        each = zip(*(columns[path].tolist() for path in keys), strict=True)
        rows = [{key: scalar(v) for key, v in zip(keys.values(), row, strict=True) if v is not None} for row in each]
        return list({repr(sorted(row.items())): row for row in rows or [{}]}.values()), {}
    nodes = dict[str, tuple[float, ...]]()
    for item, move, key in moving:
        column = item.listed_values if isinstance(item, Input) else None
        if column is None or column.dtype != object:  # words are read again for each
            ends = np.unique([*nodes.get(key, ()), *(move.apply(float(v)) for v in values_to_try(item))])
            few = column is not None and ends.size <= study.atmosphere.nodes
            between = ends if few else interpolation_nodes(key, float(ends[0]), float(ends[-1]), study.atmosphere.nodes)
            nodes[key] = tuple(between.tolist())
    return [], nodes


def _atmosphere_error(study: StudyFile, world: World) -> dict[str, float]:
    """What the interpolation of the atmosphere costs at held-out states, drawn between the nodes (seeded).

    Relative error of the radiance over ground of 0.3 where the two-way gas transmittance is above 0.1 (worst and
    rms), and the absolute error of every output, the other inputs as at the first points of the design.
    """
    stated, between, count = world.stated, world.stated.atmosphere, study.atmosphere.checked
    rng = np.random.default_rng([study.design.seed, 6])
    states = {f"atmosphere.{k}": _held_out_values(np.array(n), rng.random(count)) for k, n in between.nodes.items()}
    exact = replace(between, nodes={}, cache={})
    ours, theirs = between(states, count), exact(states, count)

    clear = theirs.gas_transmittance > MIN_GAS
    radiance, expected = (mean_radiance(terms, GROUND, GROUND)[clear] for terms in (ours, theirs))
    error = radiance / expected - 1.0
    errors = {"radiance, worst": float(np.abs(error).max()), "radiance, rms": float(np.sqrt(np.mean(error**2)))}
    first = path_values(study.inputs, input_values(study, 0, min(count, study.count)))
    columns = {path: np.resize(column, count) for path, column in first.items()}
    columns |= {m.path: np.full(count, m.apply(0.5 * sum(q.between))) for q in study.required for m in q.entries}
    columns |= states
    a, _ = output_values(world, columns, study.outputs)
    b, _ = output_values(World(replace(stated, atmosphere=exact, cache={})), columns, study.outputs)
    worst = np.abs(a - b).max(axis=0).tolist()
    return errors | {f"output {output.name}": one for output, one in zip(study.outputs, worst, strict=True)}


def _held_out_values(nodes: Array, u: Array) -> Array:
    """Points in the middle halves of the intervals between nodes, where an interpolation is worst."""
    k = np.minimum((u * (nodes.size - 1)).astype(int), nodes.size - 2)
    part = 0.25 + 0.5 * (u * (nodes.size - 1) - k)
    return np.asarray(nodes[k] + part * np.diff(nodes)[k])


class RequiredValues(NamedTuple):
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


def required_values(
    values_of: Callable[[Columns, Sequence[Output]], tuple[Array, Any]],
    columns: Columns,
    question: Required,
    outputs: Sequence[Output],
) -> RequiredValues:
    """Solve output(x) = value for x at every point of ``columns`` (dotted path -> (n,)).

    The output is looked at over the range; a change of sign between neighbours is a bracket, in which the root is
    found by Chandrupatla's method (Adv. Eng. Softw. 28, 145, 1997: inverse quadratic steps inside a bracket, as
    Brent's), for all points together.  Without a bracket there is no solution, and the reason says how far the
    output reaches.  Of several the lowest is given, with a remark that there are more.

    ``values_of`` : :func:`output_values` of a world
    """

    def outputs_at(x: Array, rows: npt.NDArray[Any], *names: str) -> tuple[Array, Mapping[int, str]]:
        """Outputs (k, O) at points ``rows`` with the required input at ``x`` (k,), and remarks by point."""
        part = {path: column[rows.astype(int)] for path, column in columns.items()}
        part |= {m.path: m.apply(x) for m in question.entries}
        return values_of(part, [named[name] for name in names])

    def residual(x: Array, row: Array) -> Array:
        return outputs_at(x.ravel(), row.ravel(), question.output)[0].reshape(x.shape) - question.equals

    named = {o.name: o for o in outputs}
    n = len(next(iter(columns.values())))
    x = (np.geomspace if question.spacing == "log" else np.linspace)(*question.between, question.scan)
    gap = residual(np.tile(x, n), np.repeat(np.arange(n), x.size)).reshape(n, x.size)
    bracket, remarks = zip(*(_bracket(x, part, question) for part in gap), strict=True)
    reasons = {i: why for i, why in enumerate(remarks) if why}
    first, values = np.array(bracket), np.full(n, np.nan)
    solved = np.flatnonzero(first >= 0)
    if solved.size:
        ends = x[first[solved]], x[first[solved] + 1]
        root = find_root(residual, ends, args=(solved.astype(float),), tolerances={"xrtol": 1e-10}, maxiter=100)
        values[solved] = np.where(root.success, root.x, np.nan)
        reasons |= {int(i): "the root was not found" for i in solved[~root.success]}
    reports = np.full((n, len(question.report)), np.nan)
    good = np.flatnonzero(np.isfinite(values))
    if good.size:
        reported, problems = outputs_at(values[good], good, question.output, *question.report)
        reports[good] = reported[:, 1:]
        for k, words in problems.items():
            reasons[int(good[k])] = "; ".join(filter(None, (reasons.get(int(good[k])), words)))
    return RequiredValues(values, reports, reasons)


def _bracket(x: Array, gap: Array, question: Required) -> tuple[int, str]:
    """Number of the interval that holds the lowest root, -1 without, and what is to be said of it.

    >>> _bracket(np.arange(4.0), 1e-13 * np.array([-2.0, 3.0, 1.0, 4.0]), Required.model_construct())
    (0, 'not monotone over the range, one solution nevertheless')
    """
    if not np.all(np.isfinite(gap)):
        return -1, f"{question.output} cannot be evaluated over the whole range"
    signs = np.sign(gap)
    change = np.flatnonzero(signs[:-1] * signs[1:] <= 0)
    # A scan value that is itself a root belongs to two intervals.
    change = change[~(np.isin(change - 1, change) & (signs[change] == 0))]
    if not change.size:
        side, best = ("below", int(np.argmax(gap))) if gap[0] < 0 else ("above", int(np.argmin(gap)))
        reached = f"{gap[best] + question.equals:.4g} at {x[best]:.4g}"
        return -1, f"no solution: {question.output} stays {side} {question.equals:g}; the nearest is {reached}"
    steps = np.diff(gap) / (np.ptp(gap) or 1.0)
    monotone = bool(np.all(steps >= -1e-12) or np.all(steps <= 1e-12))
    if change.size > 1:
        return int(change[0]), f"not monotone: {change.size} solutions; the lowest is reported"
    return int(change[0]), "" if monotone else "not monotone over the range, one solution nevertheless"


def run_chunk(piece: tuple[Parcel, int, int]) -> Chunk:
    """Outputs and answers of the points of one chunk, and what is to be said of them by the number of the point."""
    packed, start, stop = piece
    plan: Plan = opened(packed)
    study, values_of = plan.study, partial(output_values, plan.world)
    columns = path_values(study.inputs, input_values(study, start, stop))
    values, problems = values_of(columns, study.outputs)
    parts, remarks = [values], [problems]
    for question in study.required:
        answers = required_values(values_of, columns, question, study.outputs)
        parts += [answers.solutions[:, None], answers.reports]
        remarks.append({i: f"{question.name}: {text}" for i, text in answers.reasons.items()})
    reasons = {start + i: "; ".join(texts[i] for texts in remarks if i in texts) for i in set().union(*remarks)}
    return np.concatenate(parts, axis=1), reasons
