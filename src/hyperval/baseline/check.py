"""Run, compare with what was accepted, write what moved."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from hyperval.baseline.differences import Difference, compare
from hyperval.baseline.runs import Run, all_runs
from hyperval.baseline.store import accepted_of, baseline_path, candidate_path, stored, write_baseline
from hyperval.campaign.provenance import command_without_output
from hyperval.files import sha256_of, write_text
from hyperval.folders import whole_folder
from hyperval.report import RunReport, write_index, write_outputs
from hyperval.report.outputs import campaign_folders
from hyperval.report.tables import junit_xml
from hyperval.report.verdict import accepted_words
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.sensor_check.noise import Engine

RUNS = "runs"


@dataclass(frozen=True)
class Checked:
    """One campaign or sensor against its baseline.

    Attributes
    ----------
    run : its numbers
    differences : one for each number of either side; empty without a baseline or without a run
    rows : the same as rows of results, or one row that says why there are none
    baseline, candidate : the file it was compared with, and the one that was left where there is none
    """

    run: Run
    differences: list[Difference]
    rows: ResultTable
    baseline: Path
    candidate: Path | None = None


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


def _against(run: Run, folder: Path) -> Checked:
    path = baseline_path(folder, run.kind, run.name)
    if run.skipped is not None:
        return Checked(run, [], ResultTable([_one(run, Outcome.SKIPPED, run.skipped)]), path)
    baseline = stored(folder, run.kind, run.name)
    if baseline is not None:
        differences = compare(run.owner, baseline.metrics, run.metrics)
        return Checked(run, differences, ResultTable(d.row() for d in differences), path)
    if run.broken:
        words = f"no baseline ({path}), and this run cannot become one: {run.broken[0]}"
        return Checked(run, [], ResultTable([_one(run, Outcome.DISAGREES, words)]), path)
    candidate = candidate_path(folder, run.kind, run.name)
    write_baseline(candidate, run.kind, run.name, "", run.versions, accepted_of(run.metrics, {}), candidate=True)
    words = (
        f"no baseline ({path}); the numbers of this run are in {candidate}; {run.acceptance(folder)} makes them one"
    )
    return Checked(run, [], ResultTable([_one(run, Outcome.DISAGREES, words)]), path, candidate)


def _one(run: Run, outcome: Outcome, reason: str) -> Result:
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.NONE
    return Result(
        run.owner, "baseline", run.name, run.kind, "baseline", role=Role.GATE, outcome=outcome, cause=cause,
        reason=reason,
    )  # fmt: skip


def _write(outcome: Checks, folder: Path) -> None:
    """A folder of results: one page for each campaign and sensor, and one that joins them."""
    reports = [
        RunReport(
            campaign=item.run.owner,
            title=f"{item.run.title}: against the accepted numbers",
            description="Each number of this run beside the one that was accepted; it fails beyond its tolerance.",
            simulated=item.run.simulated,
            kind="Accepted numbers of",
            sentence=accepted_words(item.rows) if item.differences else next(row.reason for row in item.rows),
            table=item.rows,
            provenance={
                "command": command_without_output(),
                "versions": dict(item.run.versions),
                "inputs": _inputs(item.baseline),
            },
        )
        for item in outcome.checked
    ]
    folders = campaign_folders(reports)
    for report in reports:
        inner = folder / folders[report.campaign]
        inner.mkdir(exist_ok=True)
        write_outputs(report, inner)
    write_index(reports, folder, "Accepted numbers")


def _inputs(path: Path) -> list[dict[str, str | None]]:
    if not path.is_file():
        return []
    return [{"reference": path.name, "sha256": sha256_of(path), "licence": None, "citation": None}]
