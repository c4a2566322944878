"""The runs that are compared or accepted: made now, or read from a finished folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hyperval.baseline.metrics import Measured, campaign_metrics, skipped_reason
from hyperval.baseline.schema import Kind
from hyperval.baseline.sensors import sensor_metrics
from hyperval.baseline.store import DEFAULT_FOLDER, versions
from hyperval.campaign.job import AnyJob, jobs_of
from hyperval.campaign.provenance import source_revision
from hyperval.campaign.run import validate
from hyperval.errors import InputError, UsageError
from hyperval.files import scratch_folder, sha256_of
from hyperval.progress import track
from hyperval.report.stored import read_run
from hyperval.results import Outcome
from hyperval.sensor.specification import Sensor, library_names, load_sensor
from hyperval.sensor_check.noise import Engine

ALL = "all"


@dataclass(frozen=True)
class Run:
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
    metrics: Mapping[str, Measured] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    skipped: str | None = None
    simulated: bool = False
    reference: str = ""

    def acceptance(self, baselines: Path) -> str:
        """The command that takes the numbers of this run for accepted, in the folder ``baselines``."""
        named = self.reference if self.kind == "campaign" else f"--sensors {self.reference}"
        where = "" if baselines == DEFAULT_FOLDER else f" --baselines {baselines}"
        return f'hyperval baseline accept {named}{where} --reason "..."'

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
) -> list[Run]:
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
    if not campaigns and not sensors:
        raise UsageError("nothing to run", expected="campaign files, or sensors")
    chosen = [load_sensor(name) for name in _names(sensors)]
    runs = _campaign_runs(campaigns, source, keep, show_progress) if campaigns else []
    return [*runs, *(_sensor_run(s, engine) for s in track(chosen, "sensors", len(chosen), show=show_progress))]


def _names(sensors: Sequence[str]) -> list[str]:
    given = [part for text in sensors for part in text.split(",") if part]
    return list(dict.fromkeys(n for part in given for n in (library_names() if part == ALL else (part,))))


def _sensor_run(sensor: Sensor, engine: Engine | None) -> Run:
    title = sensor.specification.title
    return Run("sensor", sensor.name, title, sensor_metrics(sensor, engine), versions(), reference=sensor.name)


def _campaign_runs(
    paths: Sequence[Path], source: Path | None, keep: Path | None, show_progress: bool | None
) -> list[Run]:
    jobs = jobs_of(*paths)
    if source is not None:
        return [_read(job, source, finished=True) for job in jobs]
    with _folder(keep) as folder:
        validate(paths, folder, show_progress=show_progress)
        return [_read(job, folder, finished=False) for job in jobs]


@contextmanager
def _folder(keep: Path | None) -> Iterator[Path]:
    if keep is not None:
        yield keep
        return
    with scratch_folder("check") as scratch:
        yield scratch / "runs"


def _read(job: AnyJob, source: Path, *, finished: bool) -> Run:
    name = job.campaign.name
    inner = source / name
    run = read_run(inner if (inner / "results.json").is_file() else source)
    table = run.table.where(campaign=name)
    if not len(table):
        raise InputError(
            f"holds no run of campaign {name!r}", where=str(source), mend="run it with hyperval validate"
        )
    if finished and (why := _stale(job, run.provenance)):
        raise UsageError(f"the run of {name!r} {why}", where=str(run.folder), mend="run hyperval validate again")
    packages = run.provenance.get("packages")
    return Run(
        "campaign",
        name,
        job.campaign.title,
        campaign_metrics(table),
        versions(packages if isinstance(packages, dict) else None, run.provenance.get("python")),
        skipped_reason(table),
        bool(job.campaign.simulated),
        str(job.path),
    )


def _stale(job: AnyJob, provenance: Mapping[str, Any]) -> str | None:
    """Why a finished run does not tell what the files and the source of now would give; None when it may."""
    then, now = provenance.get("source_revision"), source_revision()
    if then and now and then.get("commit") != now["commit"]:
        return f"was made by commit {str(then.get('commit'))[:12]}, the source is at {now['commit'][:12]}"
    for item in provenance.get("inputs", ()):
        reference = str(item.get("reference"))
        path = job.path.parent / reference
        if ":" in reference or not path.is_file():  # of a data set, or simulated
            continue
        if sha256_of(path) != item.get("sha256"):
            return f"was made with another {reference}"
    return None
