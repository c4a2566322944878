"""Several campaigns at once: each in a process of its own, each into a folder of its own."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

from hyperval.campaign.draft import Waiting
from hyperval.campaign.one import Job, run_campaign, unfinished
from hyperval.errors import HypervalError, UsageError
from hyperval.progress import track
from hyperval.report import RunReport, write_outputs
from hyperval.results import Status

INTERNAL_ERROR = 4
Done = tuple[RunReport, int | None]
AnyJob = Job | Waiting


def worker_count(jobs: int) -> int:
    """Processes for so many campaigns: HYPERVAL_WORKERS, or one per processor; never more than campaigns."""
    text = os.environ.get("HYPERVAL_WORKERS", "")
    if text and (not text.isdigit() or int(text) < 1):
        raise UsageError(f"HYPERVAL_WORKERS is {text!r}", expected="a whole number of 1 or more")
    return max(1, min(jobs, int(text) if text else len(os.sched_getaffinity(0))))


def run_jobs(jobs: Sequence[AnyJob], folder: Path, *, show_progress: bool | None = None) -> list[Done]:
    """Run every campaign into ``folder``/NAME; the result does not depend on how many run at once.

    Returns
    -------
    For each campaign, in the order given, its report without the arrays (they are written), and the exit code of
    the error that stopped it (None when nothing did).  What stops one campaign becomes its ERROR rows.
    """
    workers = worker_count(len(jobs))
    if workers == 1:
        return [_run_into(job, folder / job.campaign.name, show_progress) for job in jobs]
    # Spawned, not forked: the parent may hold threads of the linear-algebra library.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        futures = [pool.submit(_run_into, job, folder / job.campaign.name, False) for job in jobs]
        try:
            return list(track(_results(jobs, futures, folder), "campaigns", len(jobs), show=show_progress))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _results(jobs: Sequence[AnyJob], futures: Sequence[Future[Done]], folder: Path) -> Iterator[Done]:
    for job, future in zip(jobs, futures, strict=True):
        try:
            yield future.result()
        except Exception as error:  # a process that died takes the unfinished ones of the pool with it
            yield _stopped(job, folder / job.campaign.name, error)


def _run_into(job: AnyJob, folder: Path, show_progress: bool | None) -> Done:
    try:
        run = run_campaign(job, show_progress=show_progress)
    except Exception as error:  # one broken campaign must not hide what the others say
        return _stopped(job, folder, error)
    folder.mkdir(exist_ok=True)
    write_outputs(run, folder)
    return _without_arrays(run), None


def _stopped(job: AnyJob, folder: Path, error: Exception) -> Done:
    known = isinstance(error, HypervalError)
    words = str(error) if known else f"internal error: {type(error).__name__}: {error}"
    run = unfinished(job, Status.ERROR, words)
    folder.mkdir(exist_ok=True)
    write_outputs(run, folder)
    return run, error.exit_code if isinstance(error, HypervalError) else INTERNAL_ERROR


def _without_arrays(run: RunReport) -> RunReport:
    return replace(run, prediction=None, observation=None, score_maps={}, quicklook=None)
