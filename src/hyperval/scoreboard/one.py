"""The benchmark of one campaign: observed once with every detector, predicted once by every variant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hyperval.campaign.draft import Waiting
from hyperval.campaign.one import Inputs, Job, collected, record_of
from hyperval.campaign.schema import Campaign
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError, MissingDataError, UsageError, internal_error
from hyperval.observe.place import open_place
from hyperval.results import Cause, Outcome, Result
from hyperval.scenario import Scenario
from hyperval.scoreboard.extend import load_extensions
from hyperval.scoreboard.looks import (
    EVERY_OBJECT,
    PRODUCT,
    Question,
    classes_with_regions,
    detector_rows,
    with_every_detector,
    with_own_detectors,
)
from hyperval.scoreboard.peers import peer_rows
from hyperval.scoreboard.variants import variant_rows

INTERNAL_ERROR = 4


@dataclass(frozen=True)
class Entry:
    """One campaign to be run, as it is handed to a worker."""

    job: Job | Waiting
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

    with collected(job, question=ask, show_progress=show_progress) as collection:
        rows = detector_rows(name, collection.observed, chosen, seed=entry.seed, show_progress=show_progress)
        rows += peer_rows(name, collection.observed, chosen.campaign.detection, collection.inputs.resolve)
        variants, predictions = variant_rows(name, collection, seed=entry.seed, show_progress=show_progress)
        record = record_of(
            collection.inputs.log,
            collection.scenarios,
            collection.seed,
            {"campaign": chosen.campaign.model_dump(mode="json", by_alias=True)},
            [collection.observed.observation, *predictions],
        )
        notes = list(dict.fromkeys([*chosen.notes, *_halo(chosen), *collection.observed.observation.notes]))
    return Benchmarked(name, job.campaign.title, job.campaign.simulated, rows + variants, notes, record)


def _halo(question: Question) -> list[str]:
    if question.campaign.detection is None or not question.campaign.detection.halo_pixels:
        return []
    return ["ranks count the pixels of an object alone; the values by subject count the campaign's halo too"]


def _stopped(entry: Entry, outcome: Outcome, reason: str, code: int | None = None) -> Benchmarked:
    campaign = entry.job.campaign
    log = InputLog(entry.job.folder)
    log.add(entry.job.path.resolve(), entry.job.path.name)
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    row = Result(
        campaign.name, PRODUCT, EVERY_OBJECT, "all", "benchmark", outcome=outcome, cause=cause, reason=reason
    )
    record = record_of(log, [], None, {"campaign": campaign.model_dump(mode="json", by_alias=True)}, [])
    return Benchmarked(campaign.name, campaign.title, campaign.simulated, [row], [], record, code)
