"""The table of a study's points, and the store of finished chunks that it is made from.

The points of a study, any stretch of them without those before it.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

import hyperval
from hyperval.errors import UsageError
from hyperval.model.world import column_of
from hyperval.progress import track
from hyperval.run import harmless
from hyperval.storage import write_text
from hyperval.study.schema import Grid, Input, Random, StudyFile

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


class StudyPoints:
    """The points of a study, numbered from 0: the last listed input moves fastest, the random draws slowest.

    A random design is Sobol's sequence, scrambled by its seed (Owen); the point of a number does not depend on how
    many are asked for at once.  Inputs that a one-at-a-time design leaves alone hold None.
    """

    def __init__(self, study: StudyFile):
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


STRETCH = 20_000  # rows in memory at once


@dataclass(frozen=True)
class Field:
    """One column: its name, what it holds, its unit."""

    name: str
    words: str
    unit: str
    text: bool = False


@dataclass(frozen=True)
class StudyTable:
    """Points, their inputs and their numbers.

    Attributes
    ----------
    inputs, outputs : the columns in the order of the file
    values : (n, outputs);  reasons : number of the point -> what is to be said of it
    """

    points: StudyPoints
    inputs: Sequence[Field]
    outputs: Sequence[Field]
    values: Array
    reasons: Mapping[int, str]

    def stretches(self) -> Iterator[tuple[int, dict[str, npt.NDArray[Any]]]]:
        """First point and the columns of one stretch after another."""
        for start in range(0, len(self.values), STRETCH):
            stop = min(start + STRETCH, len(self.values))
            columns = dict(self.points.stretch(start, stop))
            columns |= {f.name: np.asarray(self.values[start:stop, k]) for k, f in enumerate(self.outputs)}
            yield start, columns

    def column(self, name: str) -> npt.NDArray[Any]:
        """All values of one column."""
        for k, f in enumerate(self.outputs):
            if f.name == name:
                return np.asarray(self.values[:, k])
        return np.concatenate([c[name] for _, c in self.stretches()])


def input_fields(points: StudyPoints) -> list[Field]:
    """The columns of the inputs; words and lists are text."""
    fields = []
    for item in points.study.inputs:
        values = points.values[item.name]
        text = values is not None and values.dtype == object
        fields.append(Field(item.name, item.label or item.name, item.unit, text))
    return fields


def write_tables(table: StudyTable, folder: Path, *, show_progress: bool | None = None) -> list[str]:
    """Write table.csv, table.nc and, with the extra parquet, table.parquet; the names of what was written."""
    names = ["table.csv", "table.nc"]
    _write_csv(table, folder / names[0], show_progress)
    _write_netcdf(table, folder / names[1])
    if find_spec("pyarrow") is not None:
        names.append("table.parquet")
        _write_parquet(table, folder / names[2])
    return names


def _write_csv(table: StudyTable, path: Path, show_progress: bool | None) -> None:
    with open(path, "w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["point", *(f.name for f in (*table.inputs, *table.outputs)), "reason"])
        total = -(-len(table.values) // STRETCH)
        for start, columns in track(table.stretches(), "table", total, show=show_progress):
            cells = [_cells(columns[f.name]) for f in (*table.inputs, *table.outputs)]
            for i, row in enumerate(zip(*cells, strict=True)):
                writer.writerow([start + i, *row, harmless(table.reasons.get(start + i, ""))])


def _cells(column: npt.NDArray[Any]) -> list[str]:
    """Numbers as the shortest text that gives them back; nothing for NaN and None."""
    listed = ("" if v is None or v != v else v for v in column.tolist())
    return [harmless(v) if isinstance(v, str) else repr(v) if isinstance(v, float) else str(v) for v in listed]


def _write_netcdf(table: StudyTable, path: Path) -> None:
    import h5netcdf

    count = len(table.values)
    with h5netcdf.File(path, "w") as file:
        file.attrs["Conventions"] = "CF-1.11"
        file.attrs["title"] = table.points.study.title or table.points.study.name
        file.attrs["source"] = f"hyperval {hyperval.__version__}"
        file.dimensions = {"point": count}
        variables = {}
        for f in (*table.inputs, *table.outputs):
            dtype: Any = h5netcdf.core.h5py.string_dtype() if f.text else "f8"
            packed = {} if f.text else {"chunks": (min(count, STRETCH),), "compression": "gzip", "shuffle": True}
            variables[f.name] = file.create_variable(f.name, ("point",), dtype, **packed)
            variables[f.name].attrs["long_name"] = f.words
            variables[f.name].attrs["units"] = f.unit
        for start, columns in table.stretches():
            for f in (*table.inputs, *table.outputs):
                column = columns[f.name]
                values: Any = _texts(column) if f.text else _numbers(column)
                variables[f.name][start : start + len(column)] = values


def _texts(column: npt.NDArray[Any]) -> list[str]:
    return ["" if v is None else str(v) for v in column]


def _numbers(column: npt.NDArray[Any]) -> Array:
    return np.array([np.nan if v is None else v for v in column], float) if column.dtype == object else column


def _write_parquet(table: StudyTable, path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = [pa.field(f.name, pa.string() if f.text else pa.float64()) for f in (*table.inputs, *table.outputs)]
    schema = pa.schema([pa.field("point", pa.int64()), *fields, pa.field("reason", pa.string())])
    with pq.ParquetWriter(path, schema) as writer:
        for start, columns in table.stretches():
            count = len(next(iter(columns.values())))
            arrays = [pa.array(np.arange(start, start + count))]
            for f in (*table.inputs, *table.outputs):
                column = columns[f.name]
                arrays.append(pa.array(_texts(column) if f.text else _numbers(column)))
            arrays.append(pa.array([table.reasons.get(start + i, "") for i in range(count)]))
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))


_IDENTITY, _VALUES, _REASONS = "study.txt", "values.f64", "reasons.jsonl"


class PointStore:
    """Rows of numbers in the order of the points, in a folder of its own.

    Parameters
    ----------
    folder : made where it is not there
    identity : what the numbers follow from; rows of another identity are thrown away
    columns : numbers in a row
    chunk : rows that are appended at once; a part of a chunk at the end is thrown away

    Raises
    ------
    UsageError : the folder holds something else.
    """

    def __init__(self, folder: Path, identity: str, columns: int, chunk: int):
        self.folder, self.columns, self.chunk = Path(folder), columns, chunk
        identity_file = self.folder / _IDENTITY
        if self.folder.exists() and any(self.folder.iterdir()) and not identity_file.is_file():
            raise UsageError("holds files that are not of a study's run", where=str(self.folder), mend="remove it")
        if not identity_file.is_file() or identity_file.read_text("utf-8") != identity:
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder.mkdir(parents=True)
            (self.folder / _VALUES).touch()
            (self.folder / _REASONS).touch()
            write_text(identity_file, identity)
        self.finished = self._whole_chunks()

    @property
    def _row(self) -> int:
        return 8 * self.columns

    def _whole_chunks(self) -> int:
        """Rows of the whole chunks that are there; anything after them is cut off."""
        values, reasons = self.folder / _VALUES, self.folder / _REASONS
        size = values.stat().st_size
        rows = size // self._row // self.chunk * self.chunk
        os.truncate(values, rows * self._row)
        kept = []
        for line in reasons.read_text("utf-8").splitlines():
            try:
                point, _ = json.loads(line)
            except ValueError:
                break
            if point < rows:
                kept.append(line)
        write_text(reasons, "".join(f"{line}\n" for line in kept))
        return int(rows)

    def append(self, values: Array, reasons: Mapping[int, str]) -> None:
        """Add the rows (n, columns) that follow, and the reasons by the number of the point."""
        # Reasons first: rows without their reasons would count as finished.
        with open(self.folder / _REASONS, "a", encoding="utf-8") as stream:
            stream.writelines(
                json.dumps([point, reasons[point]], ensure_ascii=False) + "\n" for point in sorted(reasons)
            )
            stream.flush()
            os.fsync(stream.fileno())
        with open(self.folder / _VALUES, "ab") as stream:
            stream.write(np.ascontiguousarray(values, dtype="<f8").tobytes())
            stream.flush()
            os.fsync(stream.fileno())
        self.finished += len(values)

    def values(self) -> Array:
        """(n, columns) all rows, mapped from the file."""
        if self.finished == 0:
            return np.empty((0, self.columns))
        return np.memmap(self.folder / _VALUES, dtype="<f8", mode="r", shape=(self.finished, self.columns))

    def reasons(self) -> dict[int, str]:
        """Number of the point -> what is to be said of it."""
        lines = (self.folder / _REASONS).read_text("utf-8").splitlines()
        return {int(point): text for point, text in map(json.loads, lines)}

    def remove(self) -> None:
        """Throw everything away."""
        shutil.rmtree(self.folder, ignore_errors=True)
