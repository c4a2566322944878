"""Evaluating the points of a study: states of the atmosphere, and columns of numbers through batches of the model.

Between engine runs the logarithms of the terms are interpolated by a tensor product of cubic splines, on the
sensor's bands (:mod:`hyperval.atmosphere.interpolation`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.interpolation import InterpolatedTerms, interpolated_terms, stacked_values
from hyperval.errors import UsageError
from hyperval.prediction.batch import Batch
from hyperval.prediction.cases import Origins
from hyperval.prediction.departure import Departure
from hyperval.prediction.input_paths import PFA, BatchColumn, batch_column
from hyperval.prediction.setup import Setup
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.study.columns import Stage, batch_of_columns
from hyperval.study.design import column_of, plain
from hyperval.study.metrics import of_batch
from hyperval.study.schema import Output

Array = npt.NDArray[np.float64]
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
        return replace(terms, **{n: getattr(terms, n)[:, None, :] for n in self.between.between.values})


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
        raise UsageError(
            f"{len(rows)} {what} of the atmosphere", expected=f"at most {MOST_RUNS} runs of its engine"
        )
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
        problems = (
            {u: " ".join(str(error).split()) for u, error in batch.problems.items()} if batch.has_filters else {}
        )
        setting = batch.points.setting.tolist()
        return values, {i: problems[u] for i, u in enumerate(setting) if u in problems}

    def batch(self, stage: Stage, columns: Columns, n: int) -> Batch:
        """The points as a batch of the model."""
        return batch_of_columns(stage, {self.column(p): c for p, c in columns.items()}, n)


def _tidy(column: Column) -> Column:
    """Numbers as floats, lists as tuples, which can be told apart and counted."""
    return column if column.dtype != object else column_of([tuple(v) if isinstance(v, list) else v for v in column])
