"""What the command calls: campaigns into one table, one page and its folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from hyperval.campaign.one import jobs_of
from hyperval.campaign.provenance import command_without_output
from hyperval.errors import UsageError
from hyperval.executors import in_order, worker_count, workers
from hyperval.files import sha256_of, write_text
from hyperval.folders import whole_folder
from hyperval.progress import track
from hyperval.report.benchmark import BenchmarkReport, CampaignWords, benchmark_page, draw_benchmark
from hyperval.report.outputs import write_tables
from hyperval.report.tables import json_value
from hyperval.results import ResultTable
from hyperval.scoreboard.engines import ENGINES
from hyperval.scoreboard.extend import load_extensions
from hyperval.scoreboard.measures import MEASURES
from hyperval.scoreboard.one import Benchmarked, Entry, benchmark_campaign


def benchmark(
    paths: Sequence[Path],
    output: Path,
    *,
    extensions: Sequence[Path] = (),
    seed: int = 0,
    executor: Executor | None = None,
    scheduler: str | None = None,
    show_progress: bool | None = None,
) -> int:
    """Run every campaign with all detectors, engines and formulations, and write one table and its page.

    Parameters
    ----------
    extensions : Python files that register detectors or engines
    seed : of the resampling
    executor, scheduler : what runs the campaigns; default: one process for each processor (HYPERVAL_WORKERS)

    Returns
    -------
    The exit code of the first campaign that ended in an error, else 0: a benchmark judges nothing.

    Raises
    ------
    UsageError, InputError : campaign files or extensions that are not right; nothing is written.
    """
    load_extensions(extensions)
    jobs = [job for path in paths for job in jobs_of(path)]
    names = [job.campaign.name for job in jobs]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two campaigns are named {name!r}")
    entries = [Entry(job, seed, tuple(Path(p).resolve() for p in extensions)) for job in jobs]
    with whole_folder(output) as folder:
        done = _done(entries, executor, scheduler, show_progress)
        _write(done, extensions, seed, folder)
    return next((d.exit_code for d in done if d.exit_code is not None), 0)


def _done(
    entries: Sequence[Entry], executor: Executor | None, scheduler: str | None, show_progress: bool | None
) -> list[Benchmarked]:
    count = worker_count(len(entries))
    if executor is None and scheduler is None and count == 1:
        return [benchmark_campaign(entry, show_progress=show_progress) for entry in entries]
    with ExitStack() as stack:
        where = executor or stack.enter_context(workers(count, scheduler))
        results = in_order(where, partial(benchmark_campaign, show_progress=False), entries, ahead=len(entries))
        return list(track(results, "campaigns", len(entries), show=show_progress))


def _write(done: Sequence[Benchmarked], extensions: Sequence[Path], seed: int, folder: Path) -> None:
    report = BenchmarkReport(
        ResultTable(row for d in done for row in d.rows),
        [CampaignWords(d.name, d.title, d.simulated, tuple(d.notes)) for d in done],
        {m.name: m.title for m in MEASURES.values()},
        {e.name: e.title for e in ENGINES.values()},
    )
    write_tables(report.table, folder)
    record: dict[str, Any] = {
        "command": command_without_output(),
        "seed": seed,
        "extensions": {Path(p).name: sha256_of(Path(p)) for p in extensions},
        "campaigns": {d.name: d.provenance for d in done},
    }
    write_text(folder / "provenance.json", json.dumps(json_value(record), indent=1, ensure_ascii=False) + "\n")
    drawings = draw_benchmark(report)
    (folder / "figures").mkdir()
    for drawing in drawings:
        (folder / "figures" / drawing.file_name).write_bytes(drawing.content)
    write_text(folder / "report.html", benchmark_page(report, drawings))
