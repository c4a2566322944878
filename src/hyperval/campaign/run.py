"""What the commands call: validate, observe into a folder.

Campaigns that need not run again: finished before a run was ended, or whole in the output of an earlier one.

A campaign's folder bears a record (``.hyperval-made-of.json``) of what it was made of and of its own files.

Several campaigns at once: each in a process of its own, each into a folder of its own.

The command ``observe``: the empirical pipeline alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import hyperval
from hyperval.campaign.job import SIMULATED, AnyJob, Job, job_of, jobs_of
from hyperval.campaign.one import report_of, run_campaign, step_of, unfinished
from hyperval.campaign.provenance import package_versions, source_revision
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError, UsageError, internal_error
from hyperval.executors import WorkersLostError, in_order, worker_count, workers
from hyperval.progress import track, working
from hyperval.report import RunReport, write_index, write_outputs
from hyperval.report.run import accepted_table
from hyperval.results import Outcome, ResultTable, judged_or_whole
from hyperval.run import read_rows
from hyperval.storage import RECORD, files_within, partial_folder, sha256_of, whole_folder, write_text

if TYPE_CHECKING:
    from hyperval.observe import Observed


class Finished:
    """The campaigns of a run that need not run again: finished before it was ended, or in an earlier run's output.

    Parameters
    ----------
    folder : holds a folder for each campaign until all of them are done
    earlier : output of an earlier run, with a folder for each campaign; None: nothing is taken from there
    """

    def __init__(self, folder: Path, earlier: Path | None = None):
        self.folder = folder / "campaigns"
        self.earlier = earlier

    def keep(self, job: Job, run: RunReport) -> None:
        """Remember that the folder of a campaign is whole; not where something was skipped or went wrong."""
        write_record(job, run, self.folder / job.campaign.name)

    def load(self, job: Job) -> RunReport | None:
        """The report of a campaign, without its arrays, where it is finished and would come out the same.

        What is left of one that is not, or that was made of other files, settings or programs, is removed.
        """
        own = self.folder / job.campaign.name
        run = as_before(job, own)
        if run is None:
            shutil.rmtree(own, ignore_errors=True)
            if self.earlier is not None:
                run = taken_over(job, self.earlier / job.campaign.name, own)
        return run

    def hand_over(self, names: Sequence[str], target: Path) -> None:
        """Move the folders of these campaigns into ``target``."""
        for name in names:
            os.rename(self.folder / name, target / name)

    def remove(self) -> None:
        """Remove what is kept: the output is whole."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            self.folder.parent.rmdir()


def write_record(job: Job, run: RunReport, folder: Path) -> None:
    """Write into a campaign's folder what it was made of; not where something was skipped or went wrong."""
    if any(row.outcome in (Outcome.SKIPPED, Outcome.ERROR) for row in run.table):
        return
    read = {i["reference"]: i["sha256"] for i in run.provenance["inputs"]}
    files = {name: digest for name, digest in read.items() if not name.startswith(SIMULATED)}
    with suppress(OSError, HypervalError):  # a file of elsewhere, which the provenance names without its folder
        record = {
            "made_of": made_of(job, files),
            "files": list(files),
            "outputs": {
                p.relative_to(folder).as_posix(): sha256_of(p) for p in files_within(folder) if p.name != RECORD
            },
        }
        write_text(folder / RECORD, json.dumps(record, indent=1, sort_keys=True) + "\n")


def as_before(job: Job, folder: Path) -> RunReport | None:
    """The report that stands whole in ``folder``, without its arrays, where it would come out the same."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, HypervalError):
        record, log = json.loads((folder / RECORD).read_bytes()), InputLog(job.folder)
        files = {name: sha256_of(log.resolve(name)) for name in record["files"]}
        is_whole = all(sha256_of(folder / name) == digest for name, digest in record["outputs"].items())
        if record["outputs"] and is_whole and record["made_of"] == made_of(job, files):
            return report_of(job.campaign, judged_or_whole(read_rows(folder)))
    return None


def taken_over(job: Job, source: Path, target: Path) -> RunReport | None:
    """Give ``target`` the files of the finished campaign in ``source`` where it would come out the same.

    Each file gets a second name; nothing is copied where the file system knows several names of a file.  What else
    stands in ``source`` stays there.
    """
    run = as_before(job, source)
    if run is None:
        return None
    for name in (*json.loads((source / RECORD).read_bytes())["outputs"], RECORD):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source / name, target / name)
        except OSError:
            shutil.copyfile(source / name, target / name)
    return run


def made_of(job: Job, files: Mapping[str, str]) -> str:
    """A digest of everything that a campaign's results follow from.

    What else stood on the command line is none of it, nor what the campaign's file says of other runs: a campaign or
    a flight line more does not make the others run again.

    Parameters
    ----------
    files : SHA-256 by the name of each file that it reads; those that are simulated follow from the others
    """
    log = InputLog(job.folder)
    digests = {log.resolve(name): digest for name, digest in files.items()}
    if job.campaign.run:  # one of several runs: what the file says of this one is below
        digests.pop(job.path.resolve(), None)
    inner: dict[str, Any] = {
        "campaign": job.campaign.model_dump(mode="json", by_alias=True),
        "words": dict(job.campaign.run),
        "files": sorted(digests.values()),
        "beside": _beside(job, list(digests)),
        "program": _program(),
        "revision": source_revision(),
        "packages": package_versions(),
        "python": platform.python_version(),
        "power": repr(accepted_table(job.campaign.name)),
    }
    return hashlib.sha256(json.dumps(inner, sort_keys=True, default=str).encode()).hexdigest()


@cache
def _program() -> str:
    """A digest of the package's own files: a checkout may change under one version."""
    digest, root = hashlib.sha256(), Path(hyperval.__file__).parent
    for path in (p for p in files_within(root) if p.suffix != ".pyc"):
        digest.update(f"{path.relative_to(root).as_posix()} {sha256_of(path)}\n".encode())
    return digest.hexdigest()


def _beside(job: Job, read: Sequence[Path]) -> list[list[str]]:
    """The names of the files in the folders that were read from: a header or a grid may come later.

    Left out are the files that other runs of the campaign's file name, and those named after them.
    """
    own = tuple(path.stem for path in read)
    others = tuple(path.stem for one in job.of_others if (path := one.path) is not None)
    folders = {path.parent for path in (*read, job.path.resolve())}
    names = [[e.name for e in os.scandir(folder) if e.is_file()] for folder in folders]
    return sorted(sorted(n for n in some if n.startswith(own) or not n.startswith(others)) for some in names)


INTERNAL_ERROR = 4
UNCHANGED = "{}: nothing changed since the earlier run, taken from it (--again runs it)"
Done = tuple[RunReport, int | None]


def run_jobs(
    jobs: Sequence[AnyJob],
    finished: Finished,
    *,
    scheduler: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
    show_progress: bool | None = None,
) -> list[Done]:
    """Run every campaign into a folder of its name; the result does not depend on how many run at once, or where.

    Parameters
    ----------
    finished : where the folders are made, and stay until the output is whole; those that an earlier run finished
        are not run again
    scheduler : address of a Dask scheduler, whose workers see that folder and the data under the same names;
        default: one process for each processor
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
    new = iter(_run_left(left, finished, scheduler, show_progress) if left else [])
    return [ready[i] if i in ready else next(new) for i in range(len(jobs))]


def _run_left(
    jobs: Sequence[AnyJob], finished: Finished, scheduler: str | None, show_progress: bool | None
) -> list[Done]:
    done: list[Done] = []
    with workers(worker_count(len(jobs)), scheduler) as where:
        here = where.executor is None  # one after the other, each with its own bars
        pieces = [(job, finished, show_progress if here else False) for job in jobs]
        results = in_order(where, _run_into, pieces, ahead=len(jobs))
        try:
            done.extend(track(results, "campaigns", len(jobs), show=False if here else show_progress))
        except WorkersLostError as error:  # the campaigns whose results are not there yet
            done += [_written(job, finished, *_failed(job, error), False) for job in jobs[len(done) :]]
    return done


def _run_into(piece: tuple[AnyJob, Finished, bool | None]) -> Done:
    job, finished, show_progress = piece
    try:
        run, code = run_campaign(job, show_progress=show_progress), None
    except Exception as error:  # one broken campaign must not hide what the others say
        run, code = _failed(job, error)
    return _written(job, finished, run, code, show_progress)


def _failed(job: AnyJob, error: Exception) -> Done:
    if isinstance(error, HypervalError):
        return unfinished(job, Outcome.ERROR, str(error)), error.exit_code
    return unfinished(job, Outcome.ERROR, internal_error(error)), INTERNAL_ERROR


def _written(job: AnyJob, finished: Finished, run: RunReport, code: int | None, show_progress: bool | None) -> Done:
    folder = finished.folder / job.campaign.name
    folder.mkdir(exist_ok=True)
    with step_of(run.campaign, "report"), working("figures and page", show=show_progress):
        write_outputs(run, folder)
    if isinstance(job, Job):
        finished.keep(job, run)
    table = judged_or_whole(run.table)
    return replace(run, table=table, prediction=None, observation=None, score_maps={}, quicklook=None), code


Form = Literal["envi", "cog"]


def observe(
    path: Path, output: Path, *, write_reflectance: Form | None = None, show_progress: bool | None = None
) -> int:
    """Run the empirical pipeline alone and write what the collection says.

    Parameters
    ----------
    write_reflectance : write the cube after the empirical line as well, to ``reflectance/`` in the folder

    Raises
    ------
    UsageError : a reflectance cube is asked for and the collection has no empirical line.
    """
    with whole_folder(output) as folder:
        job, notes = job_of(Path(path)), list[str]()
        if write_reflectance and job.campaign.collection.empirical_line is None:
            raise UsageError(
                "there is no empirical line that would make a reflectance cube",
                where=str(path),
                mend="add collection.empirical_line, or leave --write-reflectance out",
            )

        def cube(observed: Observed) -> None:
            from hyperval.observe.reflectance_cube import write_reflectance as reflectance_cube

            if observed.place is not None and write_reflectance:
                written = reflectance_cube(
                    folder / "reflectance", "reflectance", observed.place.cube, observed.elm, write_reflectance,
                    show_progress=show_progress,
                )  # fmt: skip
                notes.append(written[1])

        run = run_campaign(job, predicts=False, show_progress=show_progress, with_observed=cube)
        with step_of(run.campaign, "report", predicts=False), working("figures and page", show=show_progress):
            write_outputs(replace(run, notes=[*run.notes, *notes]), folder)
    return 0


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
    written.  Of several, those that are finished stand in ``OUTPUT/.hyperval-partial`` until the results are whole:
    the same command goes on from there.
    """
    jobs = jobs_of(*paths)
    with whole_folder(output) as folder:
        if len(jobs) == 1:
            return _only(jobs[0], folder, None if again else output, tell, show_progress).exit_code(strict=strict)
        finished = Finished(partial_folder(output).resolve(), None if again else output.resolve())
        done = run_jobs(jobs, finished, tell=tell, scheduler=scheduler, show_progress=show_progress)
        write_index([run for run, _ in done], folder, parts=finished.folder)
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
