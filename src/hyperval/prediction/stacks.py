"""Dataclasses of arrays over bands as one with a leading axis over settings: (B,) each becomes (U, 1, B)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval.sensor.noise import NoiseModel
from hyperval.sensor.recorded import RecordedNoise

T = TypeVar("T")
Index = npt.NDArray[np.intp]


def stacked(items: Sequence[T], bands: int) -> T:
    """U dataclasses as one whose arrays are (U, 1, B), so that levels (U, S, B) go through its formulas.

    What is the same in all stays as it is: numbers, words, arrays that are one object.
    """
    first: Any = items[0]
    changes: dict[str, Any] = {}
    for f in fields(first):
        values = [getattr(item, f.name) for item in items]
        if isinstance(values[0], tuple) and values[0] and isinstance(values[0][0], np.ndarray):
            changes[f.name] = tuple(_joined(list(parts), bands) for parts in zip(*values, strict=True))
        elif isinstance(values[0], np.ndarray | float | int) and not isinstance(values[0], bool):
            changes[f.name] = _joined(values, bands)
    result: T = replace(first, **changes)
    return result


def stacked_noise(models: Sequence[NoiseModel], bands: int) -> NoiseModel:
    """Noise models of U settings as one, those of recorded radiance (:class:`RecordedNoise`) among them."""
    if any(isinstance(m, RecordedNoise) for m in models):
        models = [m if isinstance(m, RecordedNoise) else RecordedNoise(**vars(m)) for m in models]
    return stacked(models, bands)


def _joined(values: list[Any], bands: int) -> Any:
    first = values[0]
    if all(v is first for v in values) or (
        np.ndim(first) == 0 and all(np.ndim(v) == 0 and v == first for v in values)
    ):
        return first
    return np.stack([np.broadcast_to(v, (bands,)) for v in values])[:, None, :]


def on_arrays(value: T, change: Callable[[Any], Any]) -> T:
    """A dataclass with every array in it changed, tuples of arrays included."""
    changes: dict[str, Any] = {}
    for f in fields(value):  # type: ignore[arg-type]
        item = getattr(value, f.name)
        if isinstance(item, tuple) and item and isinstance(item[0], np.ndarray):
            changes[f.name] = tuple(change(x) for x in item)
        elif isinstance(item, np.ndarray) and item.ndim:
            changes[f.name] = change(item)
    return replace(value, **changes)  # type: ignore[type-var]


def rows_of(index: Index | int, size: int) -> Callable[[Any], Any]:
    """What cuts arrays (U, ..., B) of ``size`` settings to some of them; one setting by its number: (B,)."""

    def cut(x: Any) -> Any:
        if x.ndim < 3:
            return x
        if isinstance(index, int | np.integer):
            return x[index if x.shape[0] == size else 0, 0]
        return x[index] if x.shape[0] == size and x.shape[0] > 1 else x

    return cut
