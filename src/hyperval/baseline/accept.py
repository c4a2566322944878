"""Taking the numbers of a run as those that later runs must give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hyperval.baseline.runs import all_runs
from hyperval.baseline.schema import Accepted
from hyperval.baseline.store import (
    accepted_of,
    baseline_path,
    candidate_path,
    stored,
    today,
    versions,
    write_baseline,
)
from hyperval.errors import UsageError
from hyperval.sensor_check.noise import Engine


@dataclass(frozen=True)
class Change:
    """One number before and after; None where it was not or is no more."""

    owner: str
    key: str
    old: Accepted | None
    new: Accepted | None


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

    Parameters as for :func:`hyperval.baseline.check.check`.

    Raises
    ------
    UsageError : no reason, or a run that ended in an error.
    """
    words = " ".join(reason.split())
    if not words:
        raise UsageError("no reason", expected="why the new numbers are right", mend='give it: --reason "..."')
    runs = all_runs(campaigns, sensors, source=source, engine=engine, show_progress=show_progress)
    for run in runs:
        if run.broken:
            raise UsageError(
                f"the run of {run.owner} is no baseline: {run.broken[0]}",
                expected="a run without errors",
                mend="mend the code or the campaign",
            )
    plans = []
    for run in (run for run in runs if run.skipped is None):
        before = stored(baselines, run.kind, run.name)
        old = before.metrics if before else {}
        plans.append((run, old, accepted_of(run.metrics, old)))
    written, unchanged, changes = {}, [], []
    for run, old, new in plans:
        path, different = baseline_path(baselines, run.kind, run.name), _changes(run.owner, old, new)
        if not different:
            unchanged.append(run.owner)
            continue
        write_baseline(path, run.kind, run.name, words, run.versions or versions(), new)
        candidate_path(baselines, run.kind, run.name).unlink(missing_ok=True)
        written[run.owner] = path
        changes += different
    skipped = {run.owner: run.skipped for run in runs if run.skipped is not None}
    return Acceptance(written, unchanged, skipped, changes, today())


def _changes(owner: str, old: Mapping[str, Accepted], new: Mapping[str, Accepted]) -> list[Change]:
    keys = sorted({*old, *new})
    return [Change(owner, k, old.get(k), new.get(k)) for k in keys if old.get(k) != new.get(k)]
