"""What the commands call: validate, observe into a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from hyperval.campaign.job import AnyJob, Job, jobs_of
from hyperval.campaign.jobs import UNCHANGED, run_jobs
from hyperval.campaign.one import run_campaign, step_of
from hyperval.campaign.resume import Finished, taken_over, write_record
from hyperval.folders import partial_folder, whole_folder
from hyperval.progress import working
from hyperval.report import write_index, write_outputs
from hyperval.results import ResultTable


def validate(
    paths: Sequence[Path],
    output: Path,
    *,
    scheduler: str | None = None,
    strict: bool = False,
    again: bool = False,
    tell: Callable[[str], None] = lambda _: None,
    show_progress: bool | None = None,
) -> int:
    """Predict, observe and compare every campaign; write one folder, or one for each and an index.

    Parameters
    ----------
    scheduler : address of a Dask scheduler whose workers run the campaigns, where there are several; they see the
        output folder and the data under the same names
    strict : undecided and skipped gates give 1, too
    again : run also what stands in ``output`` and would come out the same
    tell : is given a line on what was not run again

    Returns
    -------
    The exit code of the contract.  A campaign whose data set is not at hand is SKIPPED in the table with the
    command that fetches it, or with who holds it.  An error in one of several campaigns becomes ERROR rows, the
    others are run, and the code is that of the first error; with a single campaign it is raised and nothing is
    written.  Of several, those that are finished stand in ``OUTPUT.partial`` until the results are whole: the same
    command goes on from there.
    """
    jobs = jobs_of(*paths)
    with whole_folder(output) as folder:
        if len(jobs) == 1:
            return _only(jobs[0], folder, None if again else output, tell, show_progress).exit_code(strict=strict)
        finished = Finished(partial_folder(output).resolve(), None if again else output.resolve())
        done = run_jobs(jobs, finished, tell=tell, scheduler=scheduler, show_progress=show_progress)
        write_index([run for run, _ in done], folder)
        finished.hand_over([job.campaign.name for job in jobs], folder)
    finished.remove()
    first_error = next((code for _, code in done if code is not None), None)
    return first_error or ResultTable(row for run, _ in done for row in run.table).exit_code(strict=strict)


def _only(
    job: AnyJob, folder: Path, earlier: Path | None, tell: Callable[[str], None], show_progress: bool | None
) -> ResultTable:
    """The table of a single campaign, whose files then stand in ``folder``."""
    if isinstance(job, Job) and earlier is not None and (run := taken_over(job, earlier, folder)):
        tell(UNCHANGED.format(run.campaign))
        return run.table
    run = run_campaign(job, show_progress=show_progress)
    with step_of(run.campaign, "report"), working("figures and page", show=show_progress):
        write_outputs(run, folder)
    if isinstance(job, Job):
        write_record(job, run, folder)
    return run.table
