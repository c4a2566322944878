"""The points of a study, any stretch of them without those before it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from hyperval.study.schema import Grid, Input, Random, Study

Array = npt.NDArray[np.float64]
Column = npt.NDArray[Any]


def grid_values(grid: Grid) -> Array:
    """The values of a grid, both ends among them."""
    if grid.spacing == "log":
        return np.geomspace(grid.start, grid.stop, grid.count)
    return np.linspace(grid.start, grid.stop, grid.count)


def listed(item: Input) -> Column | None:
    """The values of an input in the order of the file; numbers as floats, anything else as objects."""
    if item.grid is not None:
        return grid_values(item.grid)
    if item.values is None:
        return None
    return column_of(item.values)


def column_of(values: Sequence[Any]) -> Column:
    """Values as a column: numbers as floats, anything else as objects."""
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return np.array(values, dtype=float)
    items = np.empty(len(values), dtype=object)
    for i, value in enumerate(values):  # one by one: lists of one length are not rows of a matrix
        items[i] = value
    return items


def plain(value: Any) -> Any:
    """A value as a model takes it: a whole number where it is one."""
    value = value.item() if hasattr(value, "item") else value
    return int(value) if isinstance(value, float) and value.is_integer() else value


def drawn(distribution: Random, u: Array) -> Array:
    """Values of a distribution at quantiles ``u`` in (0, 1)."""
    low, high = distribution.ends
    if distribution.uniform is not None:
        return low + u * (high - low)
    if distribution.log_uniform is not None:
        return np.asarray(np.exp(np.log(low) + u * (np.log(high) - np.log(low))))
    assert distribution.normal is not None  # noqa: S101 - the model's own check
    mean, sd = distribution.normal
    below, above = ndtr((low - mean) / sd), ndtr((high - mean) / sd)
    return np.asarray(np.clip(mean + sd * ndtri(below + u * (above - below)), low, high))


class Points:
    """The points of a study, numbered from 0: the last listed input moves fastest, the random draws slowest.

    A random design is Sobol's sequence, scrambled by its seed (Owen); the point of a number does not depend on how
    many are asked for at once.  Inputs that a one-at-a-time design leaves alone hold None.
    """

    def __init__(self, study: Study):
        self.study = study
        self.values = {i.name: listed(i) for i in study.inputs}
        self.random = [i for i in study.inputs if i.random is not None]
        self._sizes = [len(v) for v in self.values.values() if v is not None]
        self._alone = study.design.kind == "one-at-a-time"

    def __len__(self) -> int:
        if self._alone:
            return 1 + sum(self._sizes)
        return int(np.prod(self._sizes, dtype=np.int64)) * (self.study.design.count if self.random else 1)

    def stretch(self, start: int, stop: int) -> Mapping[str, Column]:
        """Input name -> its values at the points from ``start`` to before ``stop``."""
        return self._one_at_a_time(start, stop) if self._alone else self._crossed(start, stop)

    def _crossed(self, start: int, stop: int) -> dict[str, Column]:
        number = np.arange(start, stop)
        columns: dict[str, Column] = {}
        if self.random:
            listed_points = int(np.prod(self._sizes, dtype=np.int64))
            draw, number = number // listed_points, number % listed_points
            u = _sobol(len(self.random), self.study.design.seed, int(draw[0]), int(draw[-1]) + 1)[draw - draw[0]]
            for k, item in enumerate(self.random):
                assert item.random is not None  # noqa: S101 - so they were chosen
                columns[item.name] = drawn(item.random, u[:, k])
        for item in reversed(self.study.inputs):
            values = self.values[item.name]
            if values is not None:
                columns[item.name] = values[number % len(values)]
                number = number // len(values)
        return {i.name: columns[i.name] for i in self.study.inputs}

    def _one_at_a_time(self, start: int, stop: int) -> dict[str, Column]:
        columns: dict[str, Column] = {}
        first = 1
        for item in self.study.inputs:
            column = np.full(stop - start, None, dtype=object)
            values = self.values[item.name]
            assert values is not None  # noqa: S101 - the study's own check
            for k, value in enumerate(values):
                if start <= first + k < stop:
                    column[first + k - start] = value
            first += len(values)
            columns[item.name] = column
        return columns


def _sobol(dimensions: int, seed: int, start: int, stop: int) -> Array:
    """Points ``start`` to before ``stop`` of a scrambled Sobol sequence, strictly inside the unit cube."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=seed)
    with warnings.catch_warnings():  # a stretch of the sequence has no power of two points, and need not
        warnings.simplefilter("ignore", UserWarning)
        if start:
            sequence.fast_forward(start)
        return np.asarray(np.clip(sequence.random(stop - start), 1e-12, 1.0 - 1e-12))


def moved(inputs: Mapping[str, Input], columns: Mapping[str, Column]) -> dict[str, Column]:
    """Dotted path -> (n,) values at the points of ``columns``; None where an entry is left as it is."""
    out: dict[str, Column] = {}
    for name, column in columns.items():
        item = inputs[name]
        for k, move in enumerate(item.targets):
            if column.dtype != object:
                out[move.path] = move.offset + move.factor * column
                continue
            values = np.empty(column.size, dtype=object)
            for i, v in enumerate(column):
                values[i] = _one(v, move.factor, move.offset, k, len(item.moves))
            out[move.path] = values
    return out


def _one(value: Any, factor: float, offset: float, k: int, count: int) -> Any:
    if isinstance(value, list) and count > 1:
        value = value[k]
    if isinstance(value, int | float) and not isinstance(value, bool) and (factor != 1.0 or offset != 0.0):
        return offset + factor * value
    return value
