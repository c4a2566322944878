"""Atmospheric terms at many values of a study's inputs: engine runs, or interpolation between engine runs.

Interpolation is a tensor product of cubic splines in the logarithms of the terms, on the sensor's bands
(:mod:`hyperval.atmosphere.interpolation`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.interpolation import Columns, InterpolatedTerms, interpolated_terms, stacked_values
from hyperval.errors import UsageError
from hyperval.progress import track

Array = npt.NDArray[np.float64]
TermsOf = Callable[[AtmosphericState], AtmosphericTerms]
MOST_RUNS = 400  # of the engine, at about seven seconds each where nothing is cached


def changed_state(state: AtmosphericState, changes: Mapping[str, Any]) -> AtmosphericState:
    """A state in which some entries differ, checked as in a file.

    Raises
    ------
    UsageError : no valid state.
    """
    data = {**state.model_dump(exclude_unset=True), **changes}
    try:
        return AtmosphericState.model_validate(data)
    except ValueError as error:
        words = ", ".join(f"{k}: {v}" for k, v in changes.items())
        raise UsageError(f"atmosphere with {words}: {error}") from error


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
    if len(rows) > MOST_RUNS:
        raise UsageError(
            f"{len(rows)} states of the atmosphere", expected=f"at most {MOST_RUNS} runs of its engine"
        )
    values = tuple(tuple(sorted({r[i] for r in rows}, key=repr)) for i in range(len(names)))
    states = [
        terms_of(changed_state(base, {k: v for k, v in zip(names, row, strict=True) if v is not None}))
        for row in track(rows, "atmosphere", len(rows), show=show_progress)
    ]
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
    if len(rows) > MOST_RUNS:
        raise UsageError(f"{len(rows)} nodes of the atmosphere", expected=f"at most {MOST_RUNS} runs of its engine")
    states = [
        terms_of(changed_state(base, dict(zip(names, row, strict=True))))
        for row in track(rows, "atmosphere table", len(rows), show=show_progress)
    ]
    return Table(interpolated_terms(dict(zip(names, grid, strict=True)), states))


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
