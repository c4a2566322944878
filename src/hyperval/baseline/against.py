"""Run, compare with what was accepted, write what moved.

Accepted against measured: one row for each number of either.

The runs that are compared or accepted: made now, or read from a finished folder.

Taking the numbers of a run as those that later runs must give.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hyperval.baseline.accepted import (
    DEFAULT_FOLDER,
    Accepted,
    Baseline,
    Kind,
    accepted_of,
    baseline_path,
    campaign_metrics,
    candidate_path,
    sensor_metrics,
    skipped_reason,
    split_key,
    stored,
    today,
    versions,
)
from hyperval.campaign import Job, jobs_of, validate
from hyperval.campaign.provenance import command_without_output
from hyperval.campaign.run import as_before
from hyperval.config import FILL_IN
from hyperval.errors import as_typed, refuse
from hyperval.progress import track
from hyperval.report import RunReport, write_index, write_outputs
from hyperval.report.verdict import accepted_words
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.run import Run, file_stems, is_run, junit_xml
from hyperval.sensor.specification import library_names, load_sensor
from hyperval.sensor_check.suite import Engine
from hyperval.storage import RECORD, scratch_folder, sha256_of, whole_folder, write_text


def compare(owner: str, accepted: Mapping[str, Accepted], now: Mapping[str, Result]) -> list[Result]:
    """One row for each number of either side, by name: its value now, and as limits the range that is tolerated.

    It disagrees: beyond the tolerance, no longer there, not accepted yet, a value where there was none or none
    where there was one, another outcome.  A number that was not accepted fails: until it is, nothing guards it.
    """
    rows = []
    for key in sorted({*accepted, *now}):
        old, new = accepted.get(key), now.get(key)
        low, high = old.range if old is not None else (math.nan, math.nan)
        value, unit = (new.value, new.unit) if new is not None else (math.nan, "1")
        words = _objection(split_key(key)[-1], old, new)
        rows.append(Result(
            owner, *split_key(key), value, unit, limit_low=low, limit_high=high, role=Role.GATE,
            outcome=Outcome.DISAGREES if words else Outcome.AGREES, reason=words,
        ))  # fmt: skip
    return rows


def _objection(metric: str, old: Accepted | None, new: Result | None) -> str:
    if old is None:
        return f"{metric} is not accepted: the baseline does not hold this number"
    before = math.nan if old.accepted is None else old.accepted
    if new is None:
        return f"{metric} is missing: the run does not give this number (accepted {_text(before)})"
    words, now = "", new.value if math.isfinite(new.value) else math.nan
    if math.isnan(before) != math.isnan(now):
        words = f"moved from {_text(before)} to {_text(now)}"
    elif not math.isnan(now) and not old.range[0] <= now <= old.range[1]:
        words = f"moved from {before:.6g} to {now:.6g}: {now - before:+.3g}, tolerance {old.width:.3g}"
    if new.outcome != old.outcome:
        reason = f" ({new.reason})" if new.reason and new.outcome is not Outcome.NONE else ""
        verdict = f"the outcome changed from {old.outcome} to {new.outcome}{reason}"
        words = f"{words}; {verdict}" if words else verdict
    return f"{metric} {words}" if words else ""


def _text(value: float) -> str:
    return "no value" if math.isnan(value) else f"{value:.6g}"


ALL, RUNS = "all", "runs"


@dataclass(frozen=True)
class RunNumbers:
    """The numbers of one campaign or sensor.

    Attributes
    ----------
    kind, name, title : what was run
    metrics : its numbers
    versions : what computed them
    skipped : why nothing was run, None otherwise
    simulated : True when the collection is simulated
    reference : what a command names it by: the campaign file, or the sensor
    """

    kind: Kind
    name: str
    title: str
    metrics: Mapping[str, Result] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    skipped: str | None = None
    simulated: bool = False
    reference: str = ""

    def acceptance(self, baselines: Path) -> str:
        """The command that takes the numbers of this run for accepted, in the folder ``baselines``."""
        named = [self.reference] if self.kind == "campaign" else ["--sensors", self.reference]
        where = [] if baselines == DEFAULT_FOLDER else ["--baselines", baselines]
        return as_typed("baseline", "accept", *named, *where) + ' --reason "..."'

    def baseline(self, reason: str, before: Mapping[str, Accepted]) -> Baseline:
        """Its numbers as accepted today; tolerances that stand in ``before`` are kept."""
        more: dict[str, Any] = {"versions": dict(self.versions or versions()), "schema_version": 1}
        more["metrics"] = accepted_of(self.metrics, before)
        return Baseline.model_construct(kind=self.kind, name=self.name, reason=reason, date=today(), **more)

    @property
    def owner(self) -> str:
        """How the run is named among others: sensors may bear the name of a campaign."""
        return self.name if self.kind == "campaign" else f"sensor {self.name}"

    @property
    def broken(self) -> list[str]:
        """Numbers that ended in an error: a disagreement is a result, an error is none."""
        wrong = [(key, m) for key, m in self.metrics.items() if m.outcome is Outcome.ERROR]
        return [f"{key} ({m.outcome}: {m.reason})" for key, m in wrong]


def all_runs(
    campaigns: Sequence[Path],
    sensors: Sequence[str],
    *,
    source: Path | None = None,
    keep: Path | None = None,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> list[RunNumbers]:
    """The numbers of campaigns and sensors.

    Parameters
    ----------
    campaigns : campaign files
    sensors : names of the library, sensor files, or "all"
    source : folder of a finished ``validate``, read instead of running the campaigns
    keep : folder for the results of the campaigns, thrown away without
    engine : stands in for the atmosphere engine of the sensors' scenarios

    Raises
    ------
    UsageError : nothing named, or a finished run that was made with other files or another source.
    InputError : a finished run that is not there.
    """
    refuse(not campaigns and not sensors, "baseline.nothing")
    given = [part for text in sensors for part in text.split(",") if part]
    names = dict.fromkeys(n for part in given for n in (library_names() if part == ALL else (part,)))
    chosen = {name: load_sensor(name) for name in names}
    with ExitStack() as stack:
        jobs = jobs_of(*campaigns) if campaigns else []
        folder = source or keep or stack.enter_context(scratch_folder("check")) / RUNS
        if jobs and source is None:
            validate(campaigns, folder, show_progress=show_progress)
        runs = [_read(job, folder, finished=source is not None) for job in jobs]
    for name, sensor in track(chosen.items(), "sensors", len(chosen), show=show_progress):
        title, numbers = sensor.specification.title, sensor_metrics(sensor, engine)
        runs.append(RunNumbers("sensor", sensor.name, title, numbers, versions(), reference=name))
    return runs


def _read(job: Job, source: Path, *, finished: bool) -> RunNumbers:
    name = job.outline.name
    folder = source / name if is_run(source / name) else source
    run = Run.open(folder)
    table = run.table.where(campaign=name)
    refuse(not len(table), "baseline.absent", source, name=name)
    stale = finished and (folder / RECORD).is_file() and as_before(job, folder) is None
    refuse(stale, "baseline.stale", folder, name=name)
    made_with = versions(run.provenance.get("packages"), run.provenance.get("python"))
    return RunNumbers(
        "campaign", name, job.outline.title, campaign_metrics(table), made_with, skipped_reason(table),
        bool(job.outline.simulated), str(job.path),
    )  # fmt: skip


@dataclass(frozen=True)
class Checked:
    """One campaign or sensor against its baseline.

    Attributes
    ----------
    run : its numbers
    rows : one for each number of either side, or one that says why there are none
    is_compared : whether there was a run, and a baseline
    baseline : the file it was compared with
    """

    run: RunNumbers
    rows: ResultTable
    baseline: Path
    is_compared: bool = False


@dataclass(frozen=True)
class Checks:
    """What a check found."""

    checked: list[Checked] = field(default_factory=list)

    @property
    def table(self) -> ResultTable:
        """All rows."""
        return ResultTable(row for item in self.checked for row in item.rows)

    @property
    def exit_code(self) -> int:
        """1 when a number moved, is missing, new, or was never accepted; 5 when nothing was checked."""
        return self.table.exit_code()


def check(
    campaigns: Sequence[Path],
    sensors: Sequence[str] = (),
    *,
    baselines: Path,
    source: Path | None = None,
    output: Path | None = None,
    junit: Path | None = None,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> Checks:
    """Compare campaigns and sensors with what was accepted.

    Parameters
    ----------
    campaigns : campaign files; one whose data are lacking is SKIPPED
    sensors : names of the library, sensor files, or "all"
    baselines : folder of the accepted numbers
    source : folder of a finished ``validate`` of these campaigns, read instead of running them
    output : folder for the differences as a results table and pages; the campaigns' own results in ``runs/``
    junit : file for the verdicts
    engine : stands in for the atmosphere engine of the sensors' scenarios

    Raises
    ------
    UsageError, InputError : of the campaigns, sensors, baselines or the finished run.
    """
    with whole_folder(output) if output is not None else nullcontext() as folder:
        keep = folder / RUNS if folder is not None else None
        runs = all_runs(campaigns, sensors, source=source, keep=keep, engine=engine, show_progress=show_progress)
        outcome = Checks([_against(run, baselines) for run in runs])
        if folder is not None:
            _write(outcome, folder)
    if junit is not None:
        write_text(junit, junit_xml(outcome.table))
    return outcome


def _against(run: RunNumbers, folder: Path) -> Checked:
    path = baseline_path(folder, run.kind, run.name)
    outcome, words = Outcome.DISAGREES, ""
    if run.skipped is not None:
        outcome, words = Outcome.SKIPPED, run.skipped
    elif (baseline := stored(folder, run.kind, run.name)) is not None:
        return Checked(run, ResultTable(compare(run.owner, baseline.metrics, run.metrics)), path, is_compared=True)
    elif run.broken:
        words = f"no baseline ({path}), and this run cannot become one: {run.broken[0]}"
    else:
        candidate = candidate_path(folder, run.kind, run.name)
        run.baseline(f"{FILL_IN}: why these numbers are right", {}).write(candidate)
        how = f"to make them one: {run.acceptance(folder)}"
        words = f"no baseline ({path}); the numbers of this run are in {candidate}; {how}"
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.NONE
    names = (run.owner, "baseline", run.name, run.kind, "baseline")
    row = Result(*names, role=Role.GATE, outcome=outcome, cause=cause, reason=words)
    return Checked(run, ResultTable([row]), path)


def _write(outcome: Checks, folder: Path) -> None:
    """A folder of results: one page for each campaign and sensor, and one that joins them."""
    reports = [
        RunReport(
            campaign=item.run.owner,
            title=f"{item.run.title}: against the accepted numbers",
            description="Each number of this run beside the accepted one; it fails beyond its tolerance.",
            simulated=item.run.simulated,
            kind="Accepted numbers of",
            sentence=accepted_words(item.rows) if item.is_compared else next(row.reason for row in item.rows),
            table=item.rows,
            provenance={
                "command": command_without_output(),
                "versions": dict(item.run.versions),
                "inputs": [{"reference": item.baseline.name, "sha256": sha256_of(item.baseline)}]
                if item.baseline.is_file()
                else [],
            },
        )
        for item in outcome.checked
    ]
    folders = file_stems(report.campaign for report in reports)
    for report in reports:
        inner = folder / folders[report.campaign]
        inner.mkdir(exist_ok=True)
        write_outputs(report, inner)
    write_index(reports, folder, "Accepted numbers")


Change = tuple[str, str, Accepted | None, Accepted | None]  # owner, name, before and after: None where there is none


@dataclass(frozen=True)
class Acceptance:
    """What was accepted.

    Attributes
    ----------
    written : the baselines that changed, by owner
    unchanged, skipped : owners whose numbers are those of the baseline; owner -> why there was no run
    changes : every number that changed
    date : of the baselines that were written
    """

    written: Mapping[str, Path]
    unchanged: Sequence[str]
    skipped: Mapping[str, str]
    changes: Sequence[Change]
    date: str

    @property
    def exit_code(self) -> int:
        """5 when there was no run to accept."""
        return 0 if self.written or self.unchanged else 5


def accept(
    campaigns: Sequence[Path],
    sensors: Sequence[str] = (),
    *,
    reason: str,
    baselines: Path,
    source: Path | None = None,
    engine: Engine | None = None,
    show_progress: bool | None = None,
) -> Acceptance:
    """Store the numbers of campaigns and sensors as accepted, with the reason.

    Tolerances that stand in a baseline are kept; new numbers get the default of their kind.  A baseline whose
    numbers are all the same is left as it is, with its reason and date.  Nothing is written unless every run is
    sound.

    Parameters as for :func:`check`.

    Raises
    ------
    UsageError : no reason, or a run that ended in an error.
    """
    words = " ".join(reason.split())
    refuse(not words, "baseline.reason")
    runs = all_runs(campaigns, sensors, source=source, engine=engine, show_progress=show_progress)
    for run in runs:
        refuse(run.broken, "baseline.broken", owner=run.owner, why="; ".join(run.broken[:1]))
    done = [run for run in runs if run.skipped is None]
    before = {run.owner: stored(baselines, run.kind, run.name) for run in done}  # all are read before one is written
    written, unchanged, changes = {}, [], list[Change]()
    for run in done:
        held = before[run.owner]
        old = held.metrics if held else {}
        new = run.baseline(words, old)
        keys = [key for key in sorted({*old, *new.metrics}) if old.get(key) != new.metrics.get(key)]
        if not keys:
            unchanged.append(run.owner)
            continue
        written[run.owner] = baseline_path(baselines, run.kind, run.name)
        new.write(written[run.owner])
        candidate_path(baselines, run.kind, run.name).unlink(missing_ok=True)
        changes += [(run.owner, key, old.get(key), new.metrics.get(key)) for key in keys]
    skipped = {run.owner: run.skipped for run in runs if run.skipped is not None}
    return Acceptance(written, unchanged, skipped, changes, today())
