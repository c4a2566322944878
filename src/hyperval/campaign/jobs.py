"""Several campaigns at once: each in a process of its own, each into a folder of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from hyperval.campaign.job import AnyJob, Job
from hyperval.campaign.one import run_campaign, step_of, unfinished
from hyperval.campaign.resume import Finished
from hyperval.errors import HypervalError, internal_error
from hyperval.executors import WorkersLostError, in_order, worker_count, workers
from hyperval.progress import track, working
from hyperval.report import RunReport, write_outputs
from hyperval.results import Outcome

INTERNAL_ERROR = 4
UNCHANGED = "{}: nothing changed since the earlier run, taken from it (--again runs it)"
Done = tuple[RunReport, int | None]


def run_jobs(
    jobs: Sequence[AnyJob],
    finished: Finished,
    *,
    executor: Executor | None = None,
    scheduler: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
    show_progress: bool | None = None,
) -> list[Done]:
    """Run every campaign into a folder of its name; the result does not depend on how many run at once, or where.

    Parameters
    ----------
    finished : where the folders are made, and stay until the output is whole; those that an earlier run finished
        are not run again
    executor : what runs them; default: the workers of ``scheduler``, or one process for each processor
    scheduler : address of a Dask scheduler, whose workers see that folder and the data under the same names
    tell : is given a line on each campaign that is not run again

    Returns
    -------
    For each campaign, in the order given, its report without the arrays (they are written), and the exit code of
    the error that stopped it (None when nothing did).  What stops one campaign becomes its ERROR rows.
    """
    finished.folder.mkdir(parents=True, exist_ok=True)
    ready = {i: (run, None) for i, job in enumerate(jobs) if isinstance(job, Job) and (run := finished.load(job))}
    for run, _ in ready.values():
        tell(UNCHANGED.format(run.campaign))
    left = [job for i, job in enumerate(jobs) if i not in ready]
    new = iter(_run_left(left, finished, executor, scheduler, show_progress) if left else [])
    return [ready[i] if i in ready else next(new) for i in range(len(jobs))]


def _run_left(
    jobs: Sequence[AnyJob],
    finished: Finished,
    executor: Executor | None,
    scheduler: str | None,
    show_progress: bool | None,
) -> list[Done]:
    count = worker_count(len(jobs))
    if executor is None and scheduler is None and count == 1:
        return [_run_into(job, finished, show_progress) for job in jobs]
    with ExitStack() as stack:
        where = executor or stack.enter_context(workers(count, scheduler))
        pieces = [(job, finished) for job in jobs]
        done: list[Done] = []
        try:
            results = in_order(where, _piece, pieces, ahead=len(jobs))
            done.extend(track(results, "campaigns", len(jobs), show=show_progress))
        except WorkersLostError as error:  # the campaigns whose results are not there yet
            done += [_stopped(job, finished.folder / job.campaign.name, error) for job in jobs[len(done) :]]
        return done


def _piece(piece: tuple[AnyJob, Finished]) -> Done:
    return _run_into(*piece, False)


def _run_into(job: AnyJob, finished: Finished, show_progress: bool | None) -> Done:
    folder = finished.folder / job.campaign.name
    try:
        run = run_campaign(job, show_progress=show_progress)
    except Exception as error:  # one broken campaign must not hide what the others say
        return _stopped(job, folder, error)
    folder.mkdir(exist_ok=True)
    with step_of(run.campaign, "report"), working("figures and page", show=show_progress):
        write_outputs(run, folder)
    if isinstance(job, Job):
        finished.keep(job, run)
    return replace(run, prediction=None, observation=None, score_maps={}, quicklook=None), None


def _stopped(job: AnyJob, folder: Path, error: Exception) -> Done:
    known = isinstance(error, HypervalError)
    words = str(error) if known else internal_error(error)
    run = unfinished(job, Outcome.ERROR, words)
    folder.mkdir(exist_ok=True)
    write_outputs(run, folder)
    return run, error.exit_code if isinstance(error, HypervalError) else INTERNAL_ERROR
