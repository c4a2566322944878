"""Evaluating the points of a study: states of the atmosphere, and columns of numbers through batches of the model.

Between engine runs the logarithms of the terms are interpolated by a tensor product of cubic splines, on the
sensor's bands (:mod:`hyperval.atmosphere.terms`).

The numbers that a study asks for, from a batch of the model.

Columns of a study: which inputs move as columns of numbers, what each touches, and the batch they make.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState
from hyperval.atmosphere.terms import AtmosphericTerms, InterpolatedTerms, interpolated_terms, stacked_values
from hyperval.errors import UsageError
from hyperval.prediction.background import (
    Ground,
    Settings,
    View,
    ground_of,
    on_arrays,
    stacked_noise,
    with_class_levels,
)
from hyperval.prediction.batch import Batch, Points, distinct
from hyperval.prediction.cases import Case, Origins, Setup, points_of
from hyperval.prediction.departure import (
    PFA,
    BatchColumn,
    Departure,
    Fills,
    batch_column,
    object_fills_of,
    pixel_fills,
    stacked_fills,
)
from hyperval.prediction.detection import detect
from hyperval.prediction.filters import Designer
from hyperval.processing.ace_model import NUMERICAL_DETECTORS
from hyperval.processing.roc import WHOLE, RocArea, curve_area
from hyperval.processing.roc_model import detection_at, log10_false_alarm_at
from hyperval.progress import track
from hyperval.scenario import Adjacency, Fill, Scenario, TargetSubject
from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.specification import SensorChanges, SensorOperation, binned_noise, changed_noise
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis, in_window
from hyperval.study.schema import Output
from hyperval.study.tables import column_of, plain

Array = npt.NDArray[np.float64]
_PER_DECADE = 20


def detector_of(output: Output, scenario: Scenario) -> str:
    """The detector that an output reads: the one it names, or the scenario's first."""
    return output.detector or scenario.processing.detectors[0]


def check_outputs(outputs: list[Output], scenario: Scenario, axis: SpectralAxis) -> None:
    """Refuse outputs of subjects, detectors or bands that the scenario does not have.

    Raises
    ------
    UsageError : with the output's name.
    """
    scene = scenario.scene
    pure = [s.name for s in (*scene.classes, *scene.panels, *scene.sites)]
    populations = [p.name for t in scene.targets for p in t.populations]
    for o in outputs:
        spectral = o.kind in ("snr", "radiance")
        if spectral and scenario.atmosphere is None:
            raise UsageError(f"output {o.name!r}: the scenario has no atmosphere, so no {o.kind}")
        if not spectral and not scenario.processing.detectors:
            raise UsageError(f"output {o.name!r}: the scenario has no detectors", mend="add processing.detectors")
        among = pure if spectral else populations
        if o.subject not in among:
            raise UsageError(f"output {o.name!r}: no subject {o.subject!r}", expected="one of " + ", ".join(among))
        if o.detector is not None and o.detector not in scenario.processing.detectors:
            raise UsageError(
                f"output {o.name!r}: the scenario does not run {o.detector!r}",
                expected="one of " + ", ".join(scenario.processing.detectors),
            )
        if spectral:
            bands_of(o, axis)


def bands_of(output: Output, axis: SpectralAxis) -> npt.NDArray[np.intp]:
    """Numbers of the bands that a spectral output reads.

    Raises
    ------
    UsageError : no band there.
    """
    w = axis.centre_nm
    if output.band_nm is not None:
        at = int(np.argmin(np.abs(w - output.band_nm)))
        if abs(w[at] - output.band_nm) > 2.0 * axis.fwhm_nm[at]:
            raise UsageError(f"output {output.name!r}: no band at {output.band_nm:g} nm")
        return np.array([at])
    assert output.range_nm is not None  # noqa: S101 - the model's own check
    low, high = output.range_nm
    bands = np.flatnonzero((w >= low) & (w <= high) & axis.good & in_window(w))
    if not bands.size:
        raise UsageError(f"output {output.name!r}: no usable band from {low:g} to {high:g} nm")
    return bands


def log_range(output: Output) -> Array:
    """Probabilities over which ``log-auc`` averages, even in their logarithm."""
    low, high = output.pfa_range
    return np.geomspace(low, high, max(2, round(np.log10(high / low) * _PER_DECADE)) + 1)


def of_batch(batch: Batch, output: Output, pfa: Array | None) -> Array:
    """An output at every point of a batch (n,); ``pfa`` (n,) where an input moves it."""
    scenario = batch.scenario
    if output.kind in ("snr", "radiance"):
        bands = bands_of(output, batch.axis)
        if output.kind == "snr":
            values = batch.snr(output.subject, output.calibration_error)
        else:
            values = batch.radiance(output.subject)
        return np.asarray(values[:, bands].mean(axis=1)[batch.points.setting])
    detector = detector_of(output, scenario)
    if detector in NUMERICAL_DETECTORS:
        return _of_curves(batch, detector, output, pfa)
    if output.kind == "pd" and output.by == "object":
        scores = batch.object_scores(output.subject, detector)
    else:
        scores = batch.scores(output.subject, detector)
    if output.kind == "pd":
        at = np.array([[output.pfa]]) if pfa is None else np.asarray(pfa, float)[:, None]
        return np.asarray(scores.detection(at)[:, 0])
    if output.kind == "log10-pfa":
        return scores.log10_false_alarm(np.full(len(batch), output.pd))
    if output.kind == "auc":
        return scores.auc()
    x = log_range(output)
    return np.asarray(np.trapezoid(scores.detection(x[None, :]), np.log(x), axis=1) / np.log(x[-1] / x[0]))


def _of_curves(batch: Batch, detector: str, output: Output, pfa: Array | None) -> Array:
    """An output of a detector whose curves are drawn: between their points they are read as all curves are."""
    values = np.empty(len(batch))
    for i, detection in enumerate(detect(batch, points=range(len(batch)))):
        curve = detection.roc[output.subject, detector, output.by]
        if output.kind == "pd":
            at = output.pfa if pfa is None else float(pfa[i])
            assert at is not None  # noqa: S101 - the schema asks for it
            values[i] = detection_at(curve, at)
        elif output.kind == "log10-pfa":
            values[i] = log10_false_alarm_at(curve, output.pd)
        else:
            area = WHOLE if output.kind == "auc" else RocArea(*output.pfa_range, logarithmic=True)
            values[i] = curve_area(curve, area)
    return values


BatchColumns = Mapping[BatchColumn, npt.NDArray[Any]]
# The terms (U, 1, B) at U values of the inputs of the atmosphere; one row where nothing of it moves.
TermsAt = Callable[[Mapping[str, npt.NDArray[Any]], int], AtmosphericTerms]
_OF_A_SETTING = ("atmosphere", "changes", "operation", "fraction", "gain", "kappa")
# Where target pixels are part of the filter's statistics, what moves them moves the filter.


@dataclass(frozen=True, eq=False)
class Stage:
    """A scenario with everything read that the columns of a study leave alone, kept from batch to batch.

    Attributes
    ----------
    terms : the atmosphere, run; None in the reflectance domain
    """

    setup: Setup
    terms: TermsAt | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What goes to other processes: no memory of earlier batches, and no covariance that nothing asks for."""
        scene = self.setup.scenario.scene
        needed = {s.name for s in (*scene.classes, *scene.targets)}
        surfaces = {
            n: s if n in needed else replace(s, covariance=np.empty((0, 0))) for n, s in self.setup.surfaces.items()
        }
        return {"setup": replace(self.setup, surfaces=surfaces), "terms": self.terms}

    @cached_property
    def designers(self) -> dict[bytes, Designer]:
        """Matrices that serve one batch after the other."""
        return {}

    @cached_property
    def _grounds(self) -> dict[bytes, Ground]:
        return {}

    @cached_property
    def _noises(self) -> dict[tuple[Any, ...], NoiseModel]:
        return {}

    def ground(self, fractions: Array) -> Ground:
        """The surfaces under area fractions (M,); UsageError where they do not sum to 1."""
        key = fractions.tobytes()
        if key not in self._grounds:
            self._grounds.clear()  # those of one batch at most: each holds a matrix
            ground = ground_of(self.setup.surfaces, self.setup.classes, fractions)
            self._grounds[key] = replace(ground, room=self._room)
        return self._grounds[key]

    @cached_property
    def _room(self) -> dict[bytes, Any]:
        return {}

    def noise(self, changes: Mapping[str, Any], operation: Mapping[str, Any]) -> NoiseModel:
        """The noise (3.13)-(3.20) with other numbers of the sensor or of how it is run.

        ``changes`` and ``operation`` are entries of ``sensor_changes`` and ``sensor_operation`` that differ from
        the scenario's.
        """
        scenario, run = self.setup.scenario, self.setup.scenario.sensor_operation
        if operation:
            stated = run.model_dump(exclude_unset=True) if run else {}
            run = SensorOperation.model_validate({**stated, **operation})
        key = tuple(sorted(operation.items()))
        if key not in self._noises:
            sensor = self.setup.used.sensor
            assert sensor is not None  # noqa: S101 - asked for with an atmosphere alone
            if len(self._noises) > 64:
                self._noises.clear()
            self._noises[key] = sensor.noise(None, run)
        model, differ = self._noises[key], scenario.sensor_changes
        if changes:
            stated = differ.model_dump(exclude_unset=True) if differ else {}
            differ = SensorChanges.model_validate({**stated, **changes})
        if differ is not None:
            model = changed_noise(model, differ)
        return binned_noise(model, run.spectral_binning) if run and run.spectral_binning > 1 else model


def batch_of_columns(stage: Stage, columns: BatchColumns, n: int) -> Batch:
    """n points of a study as evaluations of the model.

    Parameters
    ----------
    columns : what moves -> (n,) values
    """
    setup = stage.setup
    shared = [column for column in columns if column.kind in _OF_A_SETTING]
    first, setting = distinct([columns[column] for column in shared], n)
    settings = _settings(stage, {column: columns[column][first] for column in shared}, first.size)
    points = _points(setup, columns, setting)
    return Batch(setup.scenario, setup.used.axis, setup.signatures, settings, points, designers=stage.designers)


def _settings(stage: Stage, columns: BatchColumns, count: int) -> Settings:
    scenario = stage.setup.scenario
    scene = scenario.scene
    fractions = np.tile([c.fraction for c in scene.classes], (count, 1))
    gains = np.tile([c.gain for c in scene.classes], (count, 1))
    kappa = np.full(count, scene.adjacency.kappa)
    of: dict[str, dict[str, npt.NDArray[Any]]] = {"atmosphere": {}, "changes": {}, "operation": {}}
    for column, values in columns.items():
        if column.kind == "fraction":
            fractions[:, column.item] = values
        elif column.kind == "gain":
            gains[:, column.item] = values
        elif column.kind == "kappa":
            kappa = np.array([Adjacency(effective_neighbours=v).kappa for v in values.tolist()])
        elif column.kind in of:
            of[column.kind][column.key] = values
    terms, noise = None, None
    if scenario.atmosphere is not None:
        assert stage.terms is not None  # noqa: S101 - run with every atmosphere
        terms, noise = stage.terms(of["atmosphere"], count), _noise(stage, of["changes"], of["operation"], count)
    different, which = np.unique(fractions, axis=0, return_inverse=True)
    grounds = tuple(stage.ground(f) for f in different)
    which = which.reshape(-1)
    elm = scenario.processing.elm
    view = View(
        terms,
        np.array([stage.setup.average(g.average) for g in grounds])[which][:, None, :],
        noise,
        kappa[:, None, None],
        scenario.formulation,
        None if elm == "none" else elm,
    )
    return with_class_levels(Settings(view, fractions, gains, grounds, which))


def _noise(stage: Stage, changes: Mapping[str, Any], operation: Mapping[str, Any], count: int) -> NoiseModel:
    first, index = distinct([*changes.values(), *operation.values()], count)
    models = [
        stage.noise({k: plain(v[i]) for k, v in changes.items()}, {k: plain(v[i]) for k, v in operation.items()})
        for i in first
    ]
    stack = stacked_noise(models, len(stage.setup.used.axis))
    return stack if len(models) == 1 else on_arrays(stack, lambda x: x[index] if x.ndim == 3 else x)


def _points(setup: Setup, columns: BatchColumns, setting: npt.NDArray[np.intp]) -> Points:
    n, scene = setting.size, setup.scenario.scene
    base = points_of([Case(setup, None, None)], np.zeros(1, int))
    changed: dict[str, Array] = {"dof": base.dof, "gain": base.gain, "beam": base.beam, "sky": base.sky}
    names = {"tail": "dof", "target_gain": "gain", "beam": "beam", "sky": "sky"}
    for column, values in columns.items():
        if column.kind in names:
            name = names[column.kind]
            whole = np.array(np.broadcast_to(changed[name], (n, changed[name].shape[1])))
            whole[:, column.item] = values
            changed[name] = whole

    def fills(target: int, population: int, objects: bool) -> Fills | None:
        of = {x.key: v for x, v in columns.items() if (x.kind, x.item, x.subject) == ("fill", target, population)}
        base_fill = scene.targets[target].populations[population].fill
        return _moved_fills(base_fill, of, n, setup.scenario.formulation == "thesis", objects) if of else None

    return Points(setting, changed["dof"], changed["gain"], changed["beam"], changed["sky"], fills, laws=base.laws)


def _moved_fills(base: Fill, columns: Mapping[str, npt.NDArray[Any]], n: int, thesis: bool, objects: bool) -> Fills:
    """Fills of n points of which some entries of the scenario's fill move."""
    if list(columns) == ["fixed"] and base.fixed is not None:
        values = np.asarray(columns["fixed"], float)[:, None]
        if not np.all((values >= 0.0) & (values <= 1.0)):
            raise UsageError(f"fill {values.min():g} to {values.max():g}", expected="0 to 1")
        return Fills(values, np.ones((1, 1)))
    first, which = distinct(list(columns.values()), n)
    make = object_fills_of if objects else pixel_fills
    subjects = [
        TargetSubject(name="fill", fill=_changed_fill(base, {k: plain(v[i]) for k, v in columns.items()}))
        for i in first
    ]
    return stacked_fills([make(s, thesis) for s in subjects], which)


def _changed_fill(fill: Fill, changes: Mapping[str, Any]) -> Fill:
    data = fill.model_dump(exclude_unset=True)
    for key, value in changes.items():
        parts, at = key.split("."), data
        for part in parts[:-1]:
            at = at.setdefault(part, {})
        at[parts[-1]] = value
    try:
        return Fill.model_validate(data)
    except ValueError as error:
        raise UsageError(f"fill with {dict(changes)}: {error}") from error


TermsOf = Callable[[AtmosphericState], AtmosphericTerms]
MOST_RUNS = 400  # of the engine, at about seven seconds each where nothing is cached


@dataclass(frozen=True)
class FewStates:
    """Engine runs at every combination of values that occurs.

    Attributes
    ----------
    names : inputs of the atmosphere that move
    values : of each input; None stands for what the scenario has
    terms : value numbers -> number of the run;  stacked : (runs, 1, B) each
    """

    names: tuple[str, ...]
    values: tuple[tuple[Any, ...], ...]
    runs: Mapping[tuple[int, ...], int]
    stacked: AtmosphericTerms

    def __call__(self, columns: Columns, count: int) -> AtmosphericTerms:
        """Terms (count, 1, B) at the values of ``columns``; (1, 1, B) where no input moves."""
        if not self.names:
            return self.stacked
        given = [columns[n].tolist() if n in columns else [None] * count for n in self.names]
        numbers = [[v.index(x) for x in g] for g, v in zip(given, self.values, strict=True)]
        return _each(self.stacked, lambda a: a[[self.runs[key] for key in zip(*numbers, strict=True)]])


@dataclass(frozen=True)
class Table:
    """Interpolation between engine runs on a grid."""

    between: InterpolatedTerms

    def __call__(self, columns: Columns, count: int) -> AtmosphericTerms:
        """Terms (count, 1, B) at the values of ``columns``.

        Raises
        ------
        UsageError : a value outside the nodes: a table is never extrapolated.
        """
        terms = self.between(columns)
        return replace(terms, **{n: getattr(terms, n)[:, None, :] for n in self.between.values})


def few_states(
    base: AtmosphericState, terms_of: TermsOf, columns: Columns, *, show_progress: bool | None = None
) -> FewStates:
    """Run the engine at every combination of values in ``columns`` (those that occur, once each)."""
    names = tuple(columns)
    if not names:
        return FewStates((), (), {}, _stacked([terms_of(base)]))
    rows = sorted(set(zip(*(columns[n].tolist() for n in names), strict=True)), key=repr)
    values = tuple(tuple(sorted({r[i] for r in rows}, key=repr)) for i in range(len(names)))
    states = _runs(base, terms_of, names, rows, "states", show_progress)
    keys = [tuple(v.index(x) for x, v in zip(row, values, strict=True)) for row in rows]
    return FewStates(names, values, {key: i for i, key in enumerate(keys)}, _stacked(states))


def table(
    base: AtmosphericState,
    terms_of: TermsOf,
    nodes: Mapping[str, Sequence[float]],
    *,
    show_progress: bool | None = None,
) -> Table:
    """Run the engine at every node of a grid of inputs.

    Raises
    ------
    UsageError : too many nodes, fewer than two of an input, or a node that is no valid state.
    """
    names = tuple(nodes)
    grid = tuple(np.asarray(nodes[n], dtype=float) for n in names)
    for name, values in zip(names, grid, strict=True):
        if values.size < 2 or np.any(np.diff(values) <= 0):
            raise UsageError(f"nodes of atmosphere.{name}: {values.tolist()}", expected="two or more, rising")
    rows = list(product(*(values.tolist() for values in grid)))
    states = _runs(base, terms_of, names, rows, "nodes", show_progress)
    return Table(interpolated_terms(dict(zip(names, grid, strict=True)), states))


def _runs(
    base: AtmosphericState, terms_of: TermsOf, names: Sequence[str], rows: Sequence[tuple[Any, ...]], what: str,
    show_progress: bool | None,
) -> list[AtmosphericTerms]:  # fmt: skip
    """The engine at every row of values of the inputs ``names``; None leaves one as it is."""
    if len(rows) > MOST_RUNS:
        raise UsageError(f"{len(rows)} {what} of the atmosphere", expected=f"at most {MOST_RUNS} runs of its engine")
    states = ({k: v for k, v in zip(names, row, strict=True) if v is not None} for row in rows)
    runs = track(states, f"atmosphere, {what}", len(rows), show=show_progress)
    return [terms_of(with_settings(base, state)) for state in runs]


def _stacked(runs: Sequence[AtmosphericTerms]) -> AtmosphericTerms:
    joined: dict[str, Any] = {n: v[:, None, :] for n, v in stacked_values(runs).items()}
    return replace(runs[0], **joined)


def _each(terms: AtmosphericTerms, change: Callable[[Array], Array]) -> AtmosphericTerms:
    out: dict[str, Any] = {}
    for f in fields(terms):
        value = getattr(terms, f.name)
        if isinstance(value, np.ndarray) and value.ndim == 3:
            out[f.name] = change(value)
    return replace(terms, **out)


Column = npt.NDArray[Any]
Columns = Mapping[str, Column]
_KEPT = 16  # prepared scenarios in memory


@dataclass(frozen=True)
class Sky:
    """Which states of the atmosphere a study needs.

    Attributes
    ----------
    states : entry -> values (runs,), a run of the engine for each;  nodes : entry -> nodes of a table
    """

    states: Mapping[str, Column] = field(default_factory=dict)
    nodes: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def build(self, setup: Setup, *, show_progress: bool | None = False) -> FewStates | Table | None:
        """Run the engine on the bands of a scenario; None in the reflectance domain."""
        scenario, engine = setup.scenario, engine_on(setup)
        if scenario.atmosphere is None:
            return None
        if self.nodes:
            return table(scenario.atmosphere, engine, self.nodes, show_progress=show_progress)
        return few_states(scenario.atmosphere, engine, self.states, show_progress=show_progress)


def engine_on(setup: Setup) -> TermsOf:
    """The engine of a scenario on its true bands."""
    return partial(Origins(show_progress=False).terms, setup)


def make_ready(scenario: Scenario, sky: Sky, *, show_progress: bool | None = False) -> Stage:
    """Read and check what a scenario names, and run its atmosphere.

    Raises
    ------
    UsageError, InputError : as :func:`hyperval.predict.predict`.
    """
    setup = Origins().setup(scenario, Departure())
    return Stage(setup, sky.build(setup, show_progress=show_progress))


@dataclass(frozen=True)
class Evaluator:
    """A scenario and everything that its evaluation needs; goes to other processes as it is.

    Attributes
    ----------
    base : the scenario with the study's settings
    sky : states of the atmosphere, for variants whose bands differ
    anew : entries after whose change everything is read anew, besides those that :func:`batch_column` knows
    """

    base: Stage
    sky: Sky
    anew: frozenset[str] = frozenset()

    @cached_property
    def _variants(self) -> dict[str, Stage]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if k != "_variants"}

    def column(self, path: str) -> BatchColumn:
        """What a path moves in this scenario."""
        return BatchColumn("anew", key=path) if path in self.anew else batch_column(self.base.setup.scenario, path)

    def values(self, columns: Columns, outputs: Sequence[Output]) -> tuple[Array, dict[int, str]]:
        """Outputs (n, O) at n points, NaN where there is none, and why, by the number of the point.

        ``columns``: dotted path -> (n,) values, None where an entry is left as it is.
        """
        n = len(next(iter(columns.values())))
        values = np.full((n, len(outputs)), np.nan)
        problems: dict[int, str] = {}
        for rows, changes, moved in self._groups(columns, n):
            self._fill(values, problems, rows, changes, {p: _tidy(columns[p][rows]) for p in moved}, outputs)
        return values, problems

    def variant(self, changes: Mapping[str, Any]) -> Stage:
        """The scenario with some entries changed, read anew; the latest 16 are kept."""
        if not changes:
            return self.base
        key = repr(sorted(changes.items()))
        if key not in self._variants:
            if len(self._variants) >= _KEPT:
                self._variants.pop(next(iter(self._variants)))
            self._variants[key] = make_ready(with_settings(self.base.setup.scenario, changes), self.sky)
        return self._variants[key]

    def _groups(self, columns: Columns, n: int) -> list[tuple[Column, dict[str, Any], list[str]]]:
        """Points that share what is read anew, and of which the same entries move: rows, changes, moving paths."""
        anew = [p for p in columns if self.column(p).kind == "anew"]
        if not anew and all(c.dtype != object for c in columns.values()):
            return [(np.arange(n), {}, list(columns))]
        groups: dict[str, tuple[list[int], dict[str, Any], list[str]]] = {}
        for i in range(n):
            changes = {p: plain(columns[p][i]) for p in anew if columns[p][i] is not None}
            moved = [p for p in columns if p not in anew and columns[p][i] is not None]
            groups.setdefault(repr((changes, moved)), ([], changes, moved))[0].append(i)
        return [(np.array(rows), changes, moved) for rows, changes, moved in groups.values()]

    def _fill(
        self, values: Array, problems: dict[int, str], rows: Column, changes: Mapping[str, Any], columns: Columns,
        outputs: Sequence[Output],
    ) -> None:  # fmt: skip
        """Evaluate some points; where they can not be evaluated together, those that can not at all are found."""
        try:
            values[rows], lacking = self._together(self.variant(changes), columns, rows.size, outputs)
            problems |= {int(rows[i]): why for i, why in lacking.items()}
        except UsageError as error:
            if rows.size == 1:
                problems[int(rows[0])] = " ".join(str(error).split())
                return
            for half in np.array_split(np.arange(rows.size), 2):
                part = {p: c[half] for p, c in columns.items()}
                self._fill(values, problems, rows[half], changes, part, outputs)

    def _together(
        self, stage: Stage, columns: Columns, n: int, outputs: Sequence[Output]
    ) -> tuple[Array, dict[int, str]]:
        batch = self.batch(stage, columns, n)
        values = np.stack([of_batch(batch, o, columns.get(PFA)) for o in outputs], axis=1)
        problems = {u: " ".join(str(error).split()) for u, error in batch.problems.items()} if batch.has_filters else {}
        setting = batch.points.setting.tolist()
        return values, {i: problems[u] for i, u in enumerate(setting) if u in problems}

    def batch(self, stage: Stage, columns: Columns, n: int) -> Batch:
        """The points as a batch of the model."""
        return batch_of_columns(stage, {self.column(p): c for p, c in columns.items()}, n)


def _tidy(column: Column) -> Column:
    """Numbers as floats, lists as tuples, which can be told apart and counted."""
    return column if column.dtype != object else column_of([tuple(v) if isinstance(v, list) else v for v in column])
