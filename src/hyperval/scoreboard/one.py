"""The benchmark: all detectors on each campaign, and the folder with the results.

Detectors of the user's own: Python files that register them.
"""

from __future__ import annotations

import runpy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from hyperval.campaign.job import AnyJob, Job, Waiting, jobs_of
from hyperval.campaign.provenance import command_without_output, record_of
from hyperval.campaign.schema import Campaign
from hyperval.campaign.sides import Inputs, collected
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError, InputError, MissingDataError, UsageError, internal_error
from hyperval.executors import in_order, worker_count, workers
from hyperval.observe.place import open_place
from hyperval.progress import step, track
from hyperval.report.benchmark import BenchmarkReport, CampaignWords, write_benchmark
from hyperval.results import Cause, Outcome, Result, ResultTable, of_campaign
from hyperval.scenario import Scenario
from hyperval.scoreboard.looks import (
    EVERY_OBJECT,
    PRODUCT,
    Question,
    classes_with_regions,
    detector_rows,
    peer_rows,
    with_every_detector,
    with_own_detectors,
)
from hyperval.scoreboard.ranks import MEASURES
from hyperval.storage import sha256_of, whole_folder

_LOADED: set[Path] = set()


def load_extensions(paths: Iterable[Path]) -> None:
    """Run each file once in this process; what it registers has rows from then on.

    The files are programs: run only what you trust.

    Raises
    ------
    InputError : no such file.
    UsageError : a file that fails.
    """
    for path in paths:
        place = Path(path).resolve()
        if place in _LOADED:
            continue
        if not place.is_file():
            raise InputError("no such file", where=str(path), expected="a Python file that registers detectors")
        try:
            runpy.run_path(str(place))
        except HypervalError:
            raise
        except ModuleNotFoundError as error:
            if error.name != "hyperval.scoreboard.engines":
                raise
            raise UsageError(
                "engines are no rows of the benchmark any more",
                where=str(path),
                mend="name the engine in a scenario (atmosphere.engine), validate with each, and set the two runs "
                "side by side: hyperval compare A B -o DIR",
            ) from error
        except Exception as error:
            raise UsageError(
                f"the extension fails: {type(error).__name__}: {error}",
                where=str(path),
                expected="a Python file that calls register_detector",
            ) from error
        _LOADED.add(place)


INTERNAL_ERROR = 4


@dataclass(frozen=True)
class Entry:
    """One campaign to be run, as it is handed to a worker."""

    job: AnyJob
    seed: int
    extensions: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Benchmarked:
    """What one campaign gives to the page.

    Attributes
    ----------
    exit_code : of the error that stopped it; None when nothing did
    """

    name: str
    title: str
    simulated: bool
    rows: list[Result]
    notes: list[str] = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    exit_code: int | None = None


def benchmark_campaign(entry: Entry, *, show_progress: bool | None = False) -> Benchmarked:
    """Every row of one campaign; what stops it becomes its one row, SKIPPED or ERROR."""
    job = entry.job
    if isinstance(job, Waiting):
        return _stopped(entry, Outcome.SKIPPED, job.reason)
    try:
        load_extensions(entry.extensions)
        return _run(entry, job, show_progress)
    except MissingDataError as error:
        return _stopped(entry, Outcome.SKIPPED, str(error))
    except HypervalError as error:
        return _stopped(entry, Outcome.ERROR, str(error), error.exit_code)
    except Exception as error:  # one broken campaign must not hide what the others say
        return _stopped(entry, Outcome.ERROR, internal_error(error), INTERNAL_ERROR)


def _run(entry: Entry, job: Job, show_progress: bool | None) -> Benchmarked:
    own = job.campaign.detection
    try:
        return _with(entry, job, None, show_progress)
    except UsageError as error:
        if own is None or isinstance(error, MissingDataError):
            raise
        # A detector that this collection cannot take (a target among the undesired, a singular background) must not
        # take the others with it: the campaign's own detectors are known to run.
        return _with(entry, job, str(error), show_progress)


def _with(entry: Entry, job: Job, refused: str | None, show_progress: bool | None) -> Benchmarked:
    """The rows with every detector, or with the campaign's own where the others were ``refused``."""
    name, chosen = job.campaign.name, Question(job.campaign, {})

    def ask(scenarios: Sequence[Scenario], inputs: Inputs) -> Campaign:
        nonlocal chosen
        regions: list[str] = []
        if job.campaign.detection is not None and not job.campaign.detection.undesired:
            place = open_place(job.campaign.collection, inputs.resolve, show_progress=show_progress)
            regions = classes_with_regions(scenarios, place.regions)
        chosen = with_every_detector(job.campaign, regions)
        if refused is not None and job.campaign.detection is not None:
            chosen = with_own_detectors(chosen, job.campaign.detection, refused)
        return chosen.campaign

    with step(name, 1, 1, "benchmark"), collected(job, question=ask, show_progress=show_progress) as collection:
        rows = detector_rows(collection.observed, chosen, seed=entry.seed, show_progress=show_progress)
        rows += peer_rows(collection.observed, chosen.campaign.detection, collection.inputs.resolve)
        record = record_of(
            collection.inputs.log,
            collection.scenarios,
            collection.seed,
            {"campaign": chosen.campaign},
            [collection.observed.observation],
        )
        notes = list(dict.fromkeys([*chosen.notes, *_halo(chosen), *collection.observed.observation.notes]))
    return Benchmarked(name, job.campaign.title, bool(job.campaign.simulated), of_campaign(rows, name), notes, record)


def _halo(question: Question) -> list[str]:
    if question.campaign.detection is None or not question.campaign.detection.halo_pixels:
        return []
    return ["ranks count the pixels of an object alone; the values by subject count the campaign's halo too"]


def _stopped(entry: Entry, outcome: Outcome, reason: str, code: int | None = None) -> Benchmarked:
    campaign = entry.job.campaign
    log = InputLog.of_file(entry.job.path)
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    row = Result(campaign.name, PRODUCT, EVERY_OBJECT, "all", "benchmark", outcome=outcome, cause=cause, reason=reason)
    record = record_of(log, [], None, {"campaign": campaign}, [])
    return Benchmarked(campaign.name, campaign.title, bool(campaign.simulated), [row], [], record, code)


def benchmark(
    paths: Sequence[Path],
    output: Path,
    *,
    extensions: Sequence[Path] = (),
    seed: int = 0,
    scheduler: str | None = None,
    show_progress: bool | None = None,
) -> int:
    """Run every campaign with all detectors, and write one table and its page.

    Parameters
    ----------
    extensions : Python files that register detectors
    seed : of the resampling
    scheduler : address of what runs the campaigns; default: one process for each processor (HYPERVAL_WORKERS)

    Returns
    -------
    The exit code of the first campaign that ended in an error, else 0: a benchmark judges nothing.

    Raises
    ------
    UsageError, InputError : campaign files or extensions that are not right; nothing is written.
    """
    load_extensions(extensions)
    entries = [Entry(job, seed, tuple(Path(p).resolve() for p in extensions)) for job in jobs_of(*paths)]
    with whole_folder(output) as folder:
        done = _done(entries, scheduler, show_progress)
        _write(done, extensions, seed, folder)
    return next((d.exit_code for d in done if d.exit_code is not None), 0)


def _done(entries: Sequence[Entry], scheduler: str | None, show_progress: bool | None) -> list[Benchmarked]:
    count = worker_count(len(entries))
    if scheduler is None and count == 1:
        return [benchmark_campaign(entry, show_progress=show_progress) for entry in entries]
    with workers(count, scheduler) as where:
        results = in_order(where, partial(benchmark_campaign, show_progress=False), entries, ahead=len(entries))
        return list(track(results, "campaigns", len(entries), show=show_progress))


def _write(done: Sequence[Benchmarked], extensions: Sequence[Path], seed: int, folder: Path) -> None:
    report = BenchmarkReport(
        ResultTable(row for d in done for row in d.rows),
        [CampaignWords(d.name, d.title, d.simulated, tuple(d.notes)) for d in done],
        {m.name: m.title for m in MEASURES.values()},
    )
    record: dict[str, Any] = {
        "command": command_without_output(),
        "seed": seed,
        "extensions": {Path(p).name: sha256_of(Path(p)) for p in extensions},
        "campaigns": {d.name: d.provenance for d in done},
    }
    write_benchmark(folder, report, record)
