"""The points of a study, any stretch of them without those before it; its table, and the store of finished chunks."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

import hyperval
from hyperval.errors import UsageError
from hyperval.model.world import column_of
from hyperval.progress import track
from hyperval.run import harmless
from hyperval.storage import write_text
from hyperval.study.schema import Input, Moving, Random, StudyFile

Array = npt.NDArray[np.float64]
Column = npt.NDArray[Any]
STRETCH = 20_000  # rows in memory at once
_IDENTITY, _VALUES, _REASONS = "study.txt", "values.f64", "reasons.jsonl"


def listed(item: Input) -> Column | None:
    """The values of an input in the order of the file; numbers as floats, anything else as objects."""
    if item.grid is not None:
        spaced = np.geomspace if item.grid.spacing == "log" else np.linspace
        return spaced(item.grid.start, item.grid.stop, item.grid.count)
    return column_of(item.values) if item.values is not None else None  # noqa: PD011


def drawn(distribution: Random, u: Array) -> Array:
    """Values of a distribution at quantiles ``u`` in (0, 1)."""
    low, high = distribution.ends
    if distribution.uniform is not None:
        return low + u * (high - low)
    if distribution.normal is None:
        return np.asarray(np.exp(np.log(low) + u * (np.log(high) - np.log(low))))
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
        self.listed = {i.name: listed(i) for i in study.inputs}
        self.random = [i for i in study.inputs if i.random is not None]
        self._sizes = [len(v) for v in self.listed.values() if v is not None]
        self._alone = study.design.kind == "one-at-a-time"

    def __len__(self) -> int:
        if self._alone:
            return 1 + sum(self._sizes)
        return int(np.prod(self._sizes, dtype=np.int64)) * (self.study.design.count if self.random else 1)

    def stretch(self, start: int, stop: int) -> Mapping[str, Column]:
        """Input name -> its values at the points from ``start`` to before ``stop``."""
        number = np.arange(start, stop)
        if self._alone:
            return self._one_at_a_time(number)
        columns: dict[str, Column] = {}
        if self.random:
            draw, number = np.divmod(number, int(np.prod(self._sizes, dtype=np.int64)))
            u = _sobol(len(self.random), self.study.design.seed, int(draw[0]), int(draw[-1]) + 1)[draw - draw[0]]
            columns |= {i.name: drawn(i.random, u[:, k]) for k, i in enumerate(self.random) if i.random is not None}
        for item in reversed(self.study.inputs):
            values = self.listed[item.name]
            if values is not None:
                number, at = np.divmod(number, len(values))
                columns[item.name] = values[at]
        return {i.name: columns[i.name] for i in self.study.inputs}

    def _one_at_a_time(self, number: npt.NDArray[np.intp]) -> dict[str, Column]:
        columns, first = {}, 1
        for name, values in self.listed.items():
            assert values is not None  # noqa: S101 - the study's own check
            own = (number >= first) & (number < first + len(values))
            columns[name] = np.full(number.size, None, dtype=object)
            columns[name][own] = values[number[own] - first]
            first += len(values)
        return columns


def _sobol(dimensions: int, seed: int, start: int, stop: int) -> Array:
    """Points ``start`` to before ``stop`` of a scrambled Sobol sequence, strictly inside the unit cube."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=seed)
    with warnings.catch_warnings():  # a stretch of the sequence has no power of two points, and need not
        warnings.simplefilter("ignore", UserWarning)
        if start:
            sequence.fast_forward(start)
        return np.asarray(np.clip(sequence.random(stop - start), 1e-12, 1.0 - 1e-12))


def moved(inputs: Mapping[str, Moving], columns: Mapping[str, Column]) -> dict[str, Column]:
    """Dotted path -> (n,) values at the points of ``columns``; None where an entry is left as it is."""
    out: dict[str, Column] = {}
    for name, column in columns.items():
        moves = inputs[name].targets
        for k, move in enumerate(moves):
            if column.dtype != object:
                out[move.path] = move.offset + move.factor * column
                continue
            out[move.path] = np.empty(column.size, dtype=object)
            for i, v in enumerate(column):  # one by one: lists of one length are not rows of a matrix
                one = v[k] if isinstance(v, list) and len(moves) > 1 else v
                plain = not isinstance(one, int | float) or isinstance(one, bool)
                out[move.path][i] = one if plain else move.offset + move.factor * one
    return out


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

    def stretches(self) -> Iterator[pd.DataFrame]:
        """One stretch of points after another: inputs, outputs and the reason, by the number of the point."""
        for start in range(0, len(self.values), STRETCH):
            stop = min(start + STRETCH, len(self.values))
            inputs = self.points.stretch(start, stop)
            # A number that is left alone is NaN.
            columns: dict[str, Any] = {
                f.name: inputs[f.name] if f.text else np.asarray(inputs[f.name], float) for f in self.inputs
            }
            columns |= {f.name: self.values[start:stop, k] for k, f in enumerate(self.outputs)}
            columns["reason"] = [self.reasons.get(point, "") for point in range(start, stop)]
            yield pd.DataFrame(columns, index=pd.RangeIndex(start, stop, name="point"))

    def frame(self, *names: str) -> pd.DataFrame:
        """Some columns of all points; entries that are lists or mappings as their text."""
        parts = [stretch[list(dict.fromkeys(names))] for stretch in self.stretches()]
        whole = pd.concat(parts) if len(parts) > 1 else parts[0].copy()
        for f in self.inputs:
            if f.text and f.name in whole:
                whole[f.name] = pd.Series(list(map(plain_value, whole[f.name])), whole.index, dtype=object)
        return whole

    def output(self, name: str) -> Array:
        """(n,) of one output."""
        return np.asarray(self.values[:, [f.name for f in self.outputs].index(name)], float)


def plain_value(value: Any) -> Any:
    """A value of an input that can be compared and told: lists and mappings as their text."""
    return str(value) if isinstance(value, list | dict) else value.item() if hasattr(value, "item") else value


def input_fields(points: StudyPoints) -> list[Field]:
    """The columns of the inputs; words and lists are text."""
    text = {name for name, column in points.listed.items() if column is not None and column.dtype == object}
    return [Field(i.name, i.label or i.name, i.unit, i.name in text) for i in points.study.inputs]


def write_tables(table: StudyTable, folder: Path, *, show_progress: bool | None = None) -> list[str]:
    """Write table.csv, table.nc and, with the extra parquet, table.parquet; the names of what was written."""
    names = ["table.csv", "table.nc"] + ["table.parquet"] * (find_spec("pyarrow") is not None)
    fields = (*table.inputs, *table.outputs)
    texts = [*(f.name for f in fields if f.text), "reason"]
    with ExitStack() as stack:
        csv = stack.enter_context(open(folder / names[0], "w", encoding="utf-8", newline=""))
        variables = _variables(stack, table, folder / names[1])
        parquet = _parquet(stack, fields, folder / names[2]) if len(names) > 2 else None
        total = -(-len(table.values) // STRETCH)
        for frame in track(table.stretches(), "table", total, show=show_progress):
            first, last = int(frame.index[0]), int(frame.index[-1]) + 1
            said = {name: ["" if v is None else str(v) for v in frame[name]] for name in texts}
            for f in fields:
                variables[f.name][first:last] = said[f.name] if f.text else frame[f.name].to_numpy()
            if parquet is not None:
                parquet(frame.assign(**said).reset_index())
            cells = frame.assign(**{name: list(map(harmless, own)) for name, own in said.items()})
            cells.to_csv(csv, header=first == 0, lineterminator="\n")
    return names


def _variables(stack: ExitStack, table: StudyTable, path: Path) -> Mapping[str, Any]:
    """The variables of a new NetCDF file, to be filled."""
    import h5netcdf

    count, file = len(table.values), stack.enter_context(h5netcdf.File(path, "w"))
    study = table.points.study
    about = {"title": study.title or study.name, "source": f"hyperval {hyperval.__version__}"}
    file.attrs.update({"Conventions": "CF-1.11", **about})
    file.dimensions = {"point": count}
    packed = {"chunks": (min(count, STRETCH),), "compression": "gzip", "shuffle": True}
    variables = {}
    for f in (*table.inputs, *table.outputs):
        kind: Any = h5netcdf.core.h5py.string_dtype() if f.text else "f8"
        variables[f.name] = file.create_variable(f.name, ("point",), kind, **({} if f.text else packed))
        variables[f.name].attrs.update({"long_name": f.words, "units": f.unit})
    return variables


def _parquet(stack: ExitStack, fields: Sequence[Field], path: Path) -> Any:
    """What adds a stretch to a new file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = [(f.name, pa.string() if f.text else pa.float64()) for f in fields]
    schema = pa.schema([("point", pa.int64()), *kinds, ("reason", pa.string())])
    writer = stack.enter_context(pq.ParquetWriter(path, schema))
    # A number that is not there is NaN, as in the other files.
    return lambda frame: writer.write_table(
        pa.Table.from_arrays([pa.array(frame[name].to_numpy(), kind, from_pandas=False)
                              for name, kind in zip(schema.names, schema.types, strict=True)], schema=schema)
    )  # fmt: skip


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
        self.folder, self.columns = Path(folder), columns
        said, values, reasons = (self.folder / name for name in (_IDENTITY, _VALUES, _REASONS))
        if self.folder.exists() and any(self.folder.iterdir()) and not said.is_file():
            raise UsageError("holds files that are not of a study's run", where=str(self.folder), mend="remove it")
        if not said.is_file() or said.read_text("utf-8") != identity:
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder.mkdir(parents=True)
            values.touch()
            reasons.touch()
            write_text(said, identity)
        # What counts is whole chunks, of which both files have everything.
        lines = [line for line in reasons.read_text("utf-8").splitlines(keepends=True) if line.endswith("]\n")]
        chunks = min(values.stat().st_size // (8 * columns * chunk), len(lines))
        self.finished = chunks * chunk
        os.truncate(values, self.finished * 8 * columns)
        write_text(reasons, "".join(lines[:chunks]))

    def append(self, values: Array, reasons: Mapping[int, str]) -> None:
        """Add the rows (n, columns) that follow, and the reasons by the number of the point."""
        said = json.dumps(sorted(reasons.items()), ensure_ascii=False) + "\n"
        for name, content in ((_REASONS, said.encode()), (_VALUES, np.ascontiguousarray(values, "<f8").tobytes())):
            with open(self.folder / name, "ab") as stream:
                stream.write(content)
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
        return {point: text for line in lines for point, text in json.loads(line)}

    def remove(self) -> None:
        """Throw everything away."""
        shutil.rmtree(self.folder, ignore_errors=True)
