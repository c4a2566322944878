"""The table of a study's points, and the store of finished chunks that it is made from."""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import hyperval
from hyperval.errors import UsageError
from hyperval.files import write_text
from hyperval.progress import track
from hyperval.report.tables import harmless
from hyperval.study.design import Points

Array = npt.NDArray[np.float64]
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

    points: Points
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


def input_fields(points: Points) -> list[Field]:
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


class Store:
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
