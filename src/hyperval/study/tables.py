"""The points of a study, any stretch of them without those before it; the store of finished chunks, and the table."""

from __future__ import annotations

import hashlib
import json
import shutil
import warnings
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr
from scipy import stats
from scipy.stats import qmc

import hyperval
from hyperval.errors import UsageError
from hyperval.model import column_of
from hyperval.run import harmless
from hyperval.storage import write_text
from hyperval.study.schema import Moving, Random, StudyFile

Array = npt.NDArray[np.float64]
Column = npt.NDArray[Any]
_CHUNK = "chunk"


def drawn(distribution: Random, u: Array) -> Array:
    """Values of a distribution at quantiles ``u`` in (0, 1)."""
    low, high = distribution.ends
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
    listed = {i.name: values for i in study.inputs if (values := i.listed) is not None}
    random = {i.name: i.random for i in study.inputs if i.random is not None}
    if study.design.kind == "one-at-a-time":
        for name, values in listed.items():
            own = (number >= first) & (number < first + len(values))
            columns[name] = np.full(number.size, None, dtype=object)
            columns[name][own] = values[number[own] - first]
            first += len(values)
        return columns
    if random:
        draw, number = np.divmod(number, study.count // study.design.count)
        u = _sobol(len(random), study.design.seed, int(draw[0]), int(draw[-1]) + 1)[draw - draw[0]]
        columns = {name: drawn(law, u[:, k]) for k, (name, law) in enumerate(random.items())}
    for name, values in reversed(listed.items()):
        number, at = np.divmod(number, len(values))
        columns[name] = values[at]
    return {i.name: columns[i.name] for i in study.inputs}


def _sobol(dimensions: int, seed: int, start: int, stop: int) -> Array:
    """Points ``start`` to before ``stop`` of a scrambled Sobol sequence, strictly inside the unit cube."""
    sequence = qmc.Sobol(dimensions, scramble=True, rng=seed)
    with warnings.catch_warnings():  # a stretch of the sequence has no power of two points, and need not
        warnings.simplefilter("ignore", UserWarning)
        if start:
            sequence.fast_forward(start)
        return np.asarray(np.clip(sequence.random(stop - start), 1e-12, 1.0 - 1e-12))


def moved(inputs: Sequence[Moving], columns: Mapping[str, Column]) -> dict[str, Column]:
    """Dotted path -> (n,) values at the points of ``columns``; None where an entry is left as it is."""
    out: dict[str, Column] = {}
    for item in inputs:
        column, moves = columns[item.name], item.targets
        for k, move in enumerate(moves):
            own = (v[k] if isinstance(v, list) and len(moves) > 1 else v for v in column)
            out[move.path] = move.of(column) if column.dtype != object else column_of([move.of(v) for v in own])
    return out


class Field(NamedTuple):
    """One column of the table: its name, what it holds, its unit; whether its values are words."""

    name: str
    words: str
    unit: str
    text: bool = False


def fields_of(study: StudyFile) -> list[Field]:
    """The columns of a study's table: inputs, outputs, answers, and outputs told at the answers."""
    outputs, fields = {o.name: o for o in study.outputs}, list[Field]()
    for i in study.inputs:
        fields.append(Field(i.name, i.label or i.name, i.unit, i.listed is not None and i.listed.dtype == object))
    fields += [Field(o.name, o.label or o.name, o.unit) for o in study.outputs]
    for q in study.required:
        fields.append(Field(q.name, q.label or q.name, q.unit))
        for name in q.report:
            o = outputs[name]
            fields.append(Field(f"{q.name}.{name}", f"{o.label or name} at {q.label or q.name}", o.unit))
    return fields


def plain_value(value: Any) -> Any:
    """A value of an input that can be compared and told: lists and mappings as their text."""
    return str(value) if isinstance(value, list | dict) else value.item() if hasattr(value, "item") else value


def table_of(study: StudyFile, values: Array, reasons: Mapping[int, str]) -> pd.DataFrame:
    """Inputs, numbers (n, K) and what is to be said of each point; a number that is left alone is NaN."""
    columns, fields = input_values(study), fields_of(study)
    table = pd.DataFrame(index=pd.RangeIndex(study.count, name="point"))
    for f in fields[: len(columns)]:
        own = columns[f.name]
        table[f.name] = pd.Series(list(map(plain_value, own)), dtype=object) if f.text else np.asarray(own, float)
    table[[f.name for f in fields[len(columns) :]]] = values
    table["reason"] = pd.Series([reasons.get(point, "") for point in range(study.count)], dtype=object)
    return table


def write_tables(study: StudyFile, table: pd.DataFrame, folder: Path) -> list[str]:
    """Write table.csv, table.nc and, with the extra parquet, table.parquet; the names of what was written."""
    fields = fields_of(study)
    texts = [*(f.name for f in fields if f.text), "reason"]
    said = {name: pd.Series(["" if v is None else str(v) for v in table[name]], dtype=object) for name in texts}
    table = table.assign(**said)
    cells = {name: list(map(harmless, own)) for name, own in said.items()}
    table.assign(**cells).to_csv(folder / "table.csv", lineterminator="\n")
    about = {"Conventions": "CF-1.11", "title": study.title or study.name, "source": f"hyperval {hyperval.__version__}"}
    data = xr.Dataset(attrs=about)
    for f in fields:
        data[f.name] = ("point", table[f.name].to_numpy(), {"long_name": f.words, "units": f.unit})
        if not f.text:
            data[f.name].encoding = {"zlib": True, "shuffle": True, "_FillValue": None}
    data.to_netcdf(folder / "table.nc", engine="h5netcdf")
    names = ["table.csv", "table.nc"]
    if find_spec("pyarrow") is not None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = table.reset_index().items()
        # A number that is not there is NaN, as in the other files.
        parts = {name: pa.array(own.to_numpy(), from_pandas=False) for name, own in columns}
        pq.write_table(pa.table(parts), folder / "table.parquet")
        names.append("table.parquet")
    return names


class PointStore:
    """Finished chunks in the order of the points, a file each, in a folder of its own.

    Parameters
    ----------
    folder : made with the first chunk
    identity : what the numbers follow from; chunks of another identity are not seen

    Raises
    ------
    UsageError : the folder holds something else.
    """

    def __init__(self, folder: Path, identity: str):
        if any(not p.name.lstrip(".").startswith(_CHUNK) for p in folder.glob("*")):
            raise UsageError("holds files that are not of a study's run", where=str(folder), mend="remove it")
        self.folder, self.digest = folder, hashlib.sha256(identity.encode()).hexdigest()[:16]
        self.chunks: list[tuple[Array, dict[int, str]]] = []
        while (path := self._next).is_file():
            values, reasons = json.loads(path.read_text("utf-8"))
            self.chunks.append((np.array(values, float), dict(reasons)))

    def __len__(self) -> int:
        """Number of finished points."""
        return sum(len(values) for values, _ in self.chunks)

    @property
    def _next(self) -> Path:
        return self.folder / f"{_CHUNK}-{self.digest}-{len(self.chunks)}.json"

    def append(self, values: Array, reasons: Mapping[int, str]) -> None:
        """Add the rows (n, columns) that follow, and the reasons by the number of the point."""
        write_text(self._next, json.dumps([values.tolist(), sorted(reasons.items())]))
        self.chunks.append((values, dict(reasons)))

    def remove(self) -> None:
        """Throw everything away."""
        shutil.rmtree(self.folder, ignore_errors=True)
