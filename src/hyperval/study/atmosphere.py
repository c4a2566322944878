"""Atmospheric terms at many values of a study's inputs: engine runs, or interpolation between engine runs.

Interpolation is a tensor product of cubic splines in the logarithms of the terms (the spherical albedo and the
share of
sky light as they are), on the sensor's bands.  A spline is linear in the values at its nodes, so that a batch of
points is one product of matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.terms import AtmosphericTerms as Terms
from hyperval.errors import UsageError
from hyperval.progress import track

Array = npt.NDArray[np.float64]
Columns = Mapping[str, npt.NDArray[Any]]
TermsOf = Callable[[AtmosphericState], AtmosphericTerms]
MOST_RUNS = 400  # of the engine, at about seven seconds each where nothing is cached
_AS_THEY_ARE = ("spherical_albedo", "diffuse_fraction")
_LEAST = 1e-300
# What a value is taken as between nodes: the optical depth goes like 1/range, absorption like the root of the
# column.
_SCALES: dict[str, Callable[[Array], Array]] = {
    "meteorological_range_km": lambda x: 1.0 / x,
    "water_vapour_g_cm2": np.sqrt,
    "sensor_altitude_km": np.log,
    "solar_zenith_deg": lambda x: 1.0 / np.cos(np.deg2rad(x)),
}


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
    """Interpolation between engine runs on a grid.

    Attributes
    ----------
    names, nodes : inputs of the atmosphere and where the engine was run
    tabulated : quantity -> (runs, B), logarithms but for those taken as they are
    pattern : terms (1, 1, B) that everything not tabulated is taken from
    """

    names: tuple[str, ...]
    nodes: tuple[Array, ...]
    tabulated: Mapping[str, Array]
    pattern: AtmosphericTerms

    def __call__(self, columns: Columns, count: int) -> AtmosphericTerms:
        """Terms (count, 1, B) at the values of ``columns``.

        Raises
        ------
        UsageError : a value outside the nodes: a table is never extrapolated.
        """
        weights = [_weights(n, columns[n], nodes) for n, nodes in zip(self.names, self.nodes, strict=True)]
        joint = reduce(lambda a, b: (a[:, :, None] * b[:, None, :]).reshape(a.shape[0], -1), weights)
        found: dict[str, Any] = {}
        for name, values in self.tabulated.items():
            x = joint @ values
            found[name] = (x if name in _AS_THEY_ARE else np.exp(x))[:, None, :]
        return replace(self.pattern, **found)


def _weights(name: str, x: npt.NDArray[Any], nodes: Array) -> Array:
    """Weight (n, K) of each node at the points ``x`` (n,)."""
    x = np.asarray(x, dtype=float)
    slack = 1e-9 * float(np.ptp(nodes))
    if not np.all((x >= nodes[0] - slack) & (x <= nodes[-1] + slack)):
        raise UsageError(
            f"atmosphere.{name}: {x.min():g} to {x.max():g} lies outside the table",
            expected=f"{nodes[0]:g} to {nodes[-1]:g}",
        )
    scale = _SCALES.get(name, np.asarray)
    at, points = scale(nodes), scale(np.clip(x, nodes[0], nodes[-1]))
    order = np.argsort(at)
    weights = np.empty((x.size, nodes.size))
    weights[:, order] = CubicSpline(at[order], np.eye(nodes.size))(points)
    return weights


def spaced(name: str, low: float, high: float, count: int) -> Array:
    """``count`` nodes from ``low`` to ``high``, evenly in the scale in which the input is interpolated."""
    scale = _SCALES.get(name)
    if name in ("meteorological_range_km",):
        return np.asarray(1.0 / np.linspace(1.0 / low, 1.0 / high, count))
    if name == "water_vapour_g_cm2":
        return np.asarray(np.linspace(np.sqrt(low), np.sqrt(high), count) ** 2)
    if scale is np.log:
        return np.geomspace(low, high, count)
    return np.linspace(low, high, count)


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
    found = [
        terms_of(changed_state(base, {k: v for k, v in zip(names, row, strict=True) if v is not None}))
        for row in track(rows, "atmosphere", len(rows), show=show_progress)
    ]
    keys = [tuple(v.index(x) for x, v in zip(row, values, strict=True)) for row in rows]
    return FewStates(names, values, {key: i for i, key in enumerate(keys)}, _stacked(found))


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
    found = [
        terms_of(changed_state(base, dict(zip(names, row, strict=True))))
        for row in track(rows, "atmosphere table", len(rows), show=show_progress)
    ]
    stacked = _stacked(found)
    tabulated = {}
    for f in fields(stacked):
        value = getattr(stacked, f.name)
        if isinstance(value, np.ndarray) and value.ndim == 3:
            flat = value[:, 0]
            tabulated[f.name] = flat if f.name in _AS_THEY_ARE else np.log(np.maximum(flat, _LEAST))
    return Table(names, grid, tabulated, _each(stacked, lambda a: a[:1]))


def _stacked(terms: Sequence[AtmosphericTerms]) -> AtmosphericTerms:
    names = [f.name for f in fields(Terms) if f.name not in ("wavelength_nm", "fwhm_nm")]
    arrays: dict[str, Any] = {
        n: [getattr(t, n) for t in terms] for n in names if isinstance(getattr(terms[0], n), np.ndarray)
    }
    joined: dict[str, Any] = {n: np.stack(v)[:, None, :] for n, v in arrays.items()}
    return replace(terms[0], **joined)


def _each(terms: AtmosphericTerms, change: Callable[[Array], Array]) -> AtmosphericTerms:
    found: dict[str, Any] = {}
    for f in fields(terms):
        value = getattr(terms, f.name)
        if isinstance(value, np.ndarray) and value.ndim == 3:
            found[f.name] = change(value)
    return replace(terms, **found)
