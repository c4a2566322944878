"""Accepted numbers: the file of a baseline, the numbers of a run that it keeps, and the check against it.

A baseline keeps every planned row of a campaign with its background; of a sensor signal, noise and what they make of
the standard scenarios.  A check has one row for each number of either side; accepting makes the numbers of a run those
that later runs must give.
"""

from __future__ import annotations

import datetime
import json
import math
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

import hyperval
from hyperval.campaign import Job, command_without_output, find_unchanged_run, load_jobs, package_versions, validate
from hyperval.compare import row
from hyperval.config import FILL_IN, Model, load_model
from hyperval.errors import HypervalError, as_typed, reader, refuse, worded
from hyperval.metrics import DIGITS, Of, Tolerance, default_tolerance, metric_of
from hyperval.model.roc import detection_at
from hyperval.progress import track
from hyperval.report import accepted_text, write_index, write_outputs
from hyperval.results import WORST_FIRST, Cause, Outcome, Result, ResultTable, Role, split_key
from hyperval.run import Run, file_stems, is_run, junit_xml
from hyperval.sensor import Sensor, library_names, load_sensor
from hyperval.sensor_check import SensorCheck, suite, sunlit_radiance
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import RECORD, scratch_folder, sha256_of, stated_time, whole_folder, write_text

# A tolerance of more than the number itself, or than its own 95 % interval, accepts anything.
LARGEST = {"value": 1.0, "interval": 1.0, "unit": 0.1}


def round_number(value: float) -> float | None:
    """The number as a baseline keeps it; None where there is none (NaN, infinity)."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


Kind = Literal["campaign", "sensor"]


class Accepted(Model):
    """One accepted number; ``accepted`` is null where the comparison could not be made."""

    accepted: float | None = Field(description="the number, null where the comparison could not be made")
    tolerance: float = Field(description="how far it may move")
    of: Of = Field(description="what the tolerance is a fraction of: the value, half its 95 % interval, or its unit")
    half_width: float | None = Field(None, gt=0, description="half of the 95 % interval when it was accepted")
    outcome: Literal["agrees", "disagrees", "undecided", "skipped", "none"] = Field(
        "none", description="what the comparison concluded"
    )
    why: str | None = Field(None, min_length=1, description="needed where the tolerance is above the default")

    @property
    def width(self) -> float:
        """Largest tolerated difference, in the metric's unit."""
        return Tolerance(self.tolerance, self.of).width(self.accepted or 0.0, self.half_width)

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of what is tolerated, in the metric's unit; NaN where the comparison could not be made."""
        middle = math.nan if self.accepted is None else self.accepted
        return middle - self.width, middle + self.width

    def objection(self, metric: str) -> str | None:
        """What is wrong with it for a metric: it is such that nothing can break it, or loosened without a word."""
        if not 0.0 <= self.tolerance <= LARGEST[self.of]:
            return f"a tolerance of {self.tolerance:g} of {self.of}: never above {LARGEST[self.of]:g}, never below 0"
        if self.of == "interval" and not self.half_width:
            return "a tolerance of the interval needs half_width"
        if self.accepted is None:
            return None
        low, high = metric_of(metric).low, metric_of(metric).high
        if math.isfinite(low) and self.limits[0] <= low and self.limits[1] >= high:
            return f"{metric} lies between {low:g} and {high:g}: a tolerance of {self.width:g} can never fail"
        limit = default_tolerance(metric, self.half_width).width(self.accepted, self.half_width)
        return "a tolerance above the default needs 'why'" if not self.why and self.width > limit * (1 + 1e-9) else None


class Baseline(Model):
    """The accepted numbers of one campaign or sensor."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: Kind
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    reason: str = Field(min_length=1, description="why these numbers were accepted")
    date: datetime.date = Field(description="when they were last accepted")
    versions: dict[str, str] = Field(description="versions they were computed with")
    metrics: dict[str, Accepted] = Field(min_length=1, description='"product | subject | method | metric": number')

    @model_validator(mode="after")
    def _check_tolerances(self) -> Baseline:
        """Refuse tolerances that mean nothing."""
        for key, item in self.metrics.items():
            if wrong := item.objection(split_key(key)[-1]):
                raise ValueError(f"{key}: {wrong}")
        return self

    def write(self, path: Path) -> None:
        """Write it: one number a line, so that a change reads as one."""
        items = sorted(self.metrics.items())
        held = {key: item.model_dump(mode="json", exclude_none=True, exclude_defaults=True) for key, item in items}
        text = partial(json.dumps, ensure_ascii=False)
        write_text(path, worded("baseline/words.yaml", "file")(baseline=self, metrics=held, text=text) + "\n")


@reader
def load_baseline(path: Path) -> Baseline:
    """Read and check a baseline.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its line: a tolerance above 1 or that can never fail, one above the default
        without a reason, a candidate whose reason is still to be given.
    """
    return load_model(Baseline, path)


def campaign_metrics(rows: Iterable[Result]) -> dict[str, Result]:
    """The numbers of one campaign that a baseline keeps, sorted by name.

    Every planned row that is not about a single band, whether it gates or informs, and for the subjects and
    methods of those what stands :attr:`~hyperval.metrics.Metric.behind` it, as what is planned is often an absolute
    value or a verdict.  Of a row that several gates cover the worst outcome counts.
    """
    summary_rows = [row for row in rows if not row.per_band]
    planned = [row for row in summary_rows if row.planned]
    names = {(r.product, s.strip(), r.method) for r in planned for s in (r.subject, *r.subject.split(","))}

    def is_named(row: Result) -> bool:
        names_of_row = row.product, row.subject, row.method
        return any(all(map(fnmatchcase, names_of_row, patterns)) for patterns in names)

    derived = [row for row in summary_rows if row.product in metric_of(row.metric).behind and is_named(row)]
    metrics: dict[str, Result] = {}
    for new in [*planned, *derived]:
        old = metrics.setdefault(new.key, new)
        metrics[new.key] = replace(old, outcome=min(old.outcome, new.outcome, key=WORST_FIRST.index))
    return dict(sorted(metrics.items()))


METHOD = "sensor"
# Lines of the sun (CH, Mg, H alpha) and of oxygen: a response of another width sees them deeper or less deep.
LINES_NM = (430.0, 517.0, 656.0, 762.0)
# Errors of transmission are zero in most sensor files; this rate shows what they would do.
BIT_ERROR_RATE = 1e-9


def sensor_metrics(sensor: Sensor, engine: suite.Engine | None = None) -> dict[str, Result]:
    """Every number of a sensor, sorted by name.

    Median SNR (without C_R) at the reference radiances, G, each noise term as a radiance, by spectral region; the
    reference radiance in bands at lines; P_D at P_FA 1e-3 and the radiance of the white panel at the oxygen band in
    the standard scenarios.

    Parameters
    ----------
    engine : stands in for the atmosphere engine
    """
    check = SensorCheck(sensor, engine=engine)
    rows = [*_bands(check.axis), *_noise(check), *_scenarios(check)]
    return dict(sorted({row.key: row for row in rows}.items()))


def _item(product: str, subject: str, metric: str, value: float, **more: Any) -> Result:
    return replace(row(metric, value, **more), product=product, subject=subject, method=METHOD)


def _bands(axis: SpectralAxis) -> Iterator[Result]:
    yield _item("bands", "all", "band_count", len(axis))
    yield _item("bands", "good", "band_count", int(axis.good.sum()))
    level = sunlit_radiance(axis, suite.MIDDLE)
    for line in LINES_NM:
        if (band := axis.nearest(line)) is not None:
            yield _item("bands", f"{line:g} nm", "reference_radiance", level[band])


def _noise(check: SensorCheck) -> Iterator[Result]:
    """Medians over each spectral region of signal, SNR and the terms of (3.15)-(3.19) that the sensor has."""
    noise, level = check.noise, sunlit_radiance(check.axis, suite.MIDDLE)
    parts = noise.breakdown(level)
    floor = 1e-9 * parts.total  # the others are zero, or what rounding leaves
    variances = {f"noise_{term}": part for term, part in vars(parts).items() if np.any(np.abs(part) > floor)}
    if noise.constant is None:
        wrong = replace(noise, bit_error_rate=BIT_ERROR_RATE).breakdown(level)
        variances[f"bit_error_noise_at_rate_{BIT_ERROR_RATE:g}"] = wrong.bit_errors  # (3.19)
    spectra = {name: np.sqrt(np.abs(variance)) for name, variance in variances.items()}
    spectra["electrons_per_radiance"] = noise.electrons_per_radiance  # (3.13)
    for region, bands in suite.summary_regions(check.axis).items():
        for metric, values in spectra.items():
            yield _item("noise", region, f"median_{metric}", np.median(values[bands]))
    for found in suite.median_snr(check):  # (3.20)
        yield _item("snr", found.subject, "median_snr", found.value)


def _scenarios(check: SensorCheck) -> Iterator[Result]:
    for name, run in check.runs.items():
        if isinstance(run, HypervalError):
            yield _item("scenario", name, "runs", np.nan, outcome=Outcome.SKIPPED, reason=str(run))
    for name, (subject, detector, _), curve in check.curves:
        pd = float(detection_at(curve, suite.FALSE_ALARM))
        yield _item("scenario", f"{name}, {subject}, {detector}", f"pd_at_pfa_{suite.FALSE_ALARM:g}", pd)
    oxygen = check.axis.nearest(LINES_NM[-1])
    for name, prediction in check.predictions.items():
        if "white panel" in prediction.radiance and oxygen is not None:
            subject, level = f"{name}, {LINES_NM[-1]:g} nm", prediction.radiance["white panel"].mean[oxygen]
            yield _item("scenario", subject, "white_panel_radiance", level)


DEFAULT_FOLDER = Path("validation/baselines")
SENSORS, CANDIDATE = "sensors", ".candidate.yaml"
# What a change of numbers may come from besides this project.
PACKAGES = ("numpy", "scipy")


def accepted_numbers(measured: Mapping[str, Result], before: Mapping[str, Accepted]) -> dict[str, Accepted]:
    """Measured numbers as a baseline keeps them; tolerances that stand in ``before`` are kept, not loosened."""
    return {key: _accept_number(new, before.get(key)) for key, new in sorted(measured.items())}


def _accept_number(new: Result, old: Accepted | None) -> Accepted:
    width = (new.upper - new.lower) / 2.0
    value, half = round_number(new.value), round_number(width) if width > 0 else None
    limit = Tolerance(old.tolerance, old.of) if old else default_tolerance(new.metric, half)
    if limit.of == "interval" and half is None:  # the interval is gone: its part of it means nothing any more
        limit = default_tolerance(new.metric)
    half = half if limit.of == "interval" else None
    more: dict[str, Any] = {"half_width": half, "outcome": new.outcome.value, "why": old.why if old else None}
    return Accepted(accepted=value, tolerance=limit.tolerance, of=limit.of, **more)


def today() -> datetime.date:
    """The date, of SOURCE_DATE_EPOCH where that is set."""
    return (stated_time() or datetime.datetime.now(datetime.UTC)).date()


def compare(owner: str, accepted: Mapping[str, Accepted], measured: Mapping[str, Result]) -> list[Result]:
    """One row for each number of either side, by name: its value now, and as limits the range that is tolerated.

    It disagrees: beyond the tolerance, no longer there, not accepted yet, a value where there was none or none
    where there was one, another outcome.  A number that was not accepted fails: until it is, nothing guards it.
    """
    rows = []
    for key in sorted({*accepted, *measured}):
        old, new = accepted.get(key), measured.get(key)
        low, high = old.limits if old is not None else (math.nan, math.nan)
        value, unit = (new.value, new.unit) if new is not None else (math.nan, "1")
        words = _objection(split_key(key)[-1], old, new)
        rows.append(Result(
            owner, *split_key(key), value, unit, limit_low=low, limit_high=high, role=Role.GATE,
            outcome=Outcome.DISAGREES if words else Outcome.AGREES, reason=words,
        ))  # fmt: skip
    return rows


def _objection(metric: str, old: Accepted | None, new: Result | None) -> str:
    """What is wrong with a number, in words; empty where it is as accepted."""
    before = math.nan if old is None or old.accepted is None else old.accepted
    now = new.value if new is not None and math.isfinite(new.value) else math.nan
    none = math.isnan(before) and math.isnan(now)
    moved = old is None or not (none or old.limits[0] <= now <= old.limits[1])
    turned = old is None or new is None or new.outcome != old.outcome
    if not (moved or turned):
        return ""
    numbers = {"before": before, "now": now, "moved": moved, "turned": turned}
    return worded("baseline/words.yaml", "objection")(metric=metric, old=old, new=new, **numbers)


ALL, RUNS = "all", "runs"


@dataclass(frozen=True)
class RunNumbers:
    """The numbers of one campaign or sensor, checked or accepted.

    Attributes
    ----------
    kind, run : what was run, with all its rows; of a sensor these are its numbers
    reference : what a command names it by: the campaign file, or the sensor
    metrics : its numbers by name
    rows : one for each number of either side once it is checked, or one that says why there are none
    before : what was accepted, where there was a run and a baseline
    after : what is accepted now
    """

    kind: Kind
    run: Run
    reference: str
    metrics: Mapping[str, Result]
    rows: ResultTable = field(default_factory=ResultTable)
    before: Baseline | None = None
    after: Baseline | None = None

    @property
    def versions(self) -> dict[str, str]:
        """What the numbers were computed with: by the run's record where it says so, else in this process."""
        record = self.run.provenance
        build = record.get("packages") or package_versions()
        used = {name: build[name] for name in PACKAGES if name in build}
        return {"hyperval": hyperval.__version__, "python": record.get("python") or platform.python_version(), **used}

    @property
    def skipped(self) -> str | None:
        """Why nothing was run, None otherwise."""
        made = any(row.outcome is not Outcome.SKIPPED for row in self.run.table)
        return None if made else next(row.reason for row in self.run.table)

    def path(self, folder: Path, end: str = ".yaml") -> Path:
        """The file of its baseline: ``folder``/NAME.yaml, of sensors in a folder of their own.

        With the ``end`` .candidate.yaml where the numbers of a run without a baseline are left.
        """
        return (folder if self.kind == "campaign" else folder / SENSORS) / f"{self.run.campaign}{end}"

    def load_accepted(self, folder: Path) -> Baseline | None:
        """Its baseline, None when there is none.

        Raises
        ------
        UsageError : mistakes in the file, or a file of something else.
        """
        path = self.path(folder)
        if not path.is_file():
            return None
        found = load_baseline(path)
        wanted, stated = (self.kind, self.run.campaign), f"{found.kind} {found.name!r}"
        refuse((found.kind, found.name) != wanted, "baseline.other", path, wanted=" ".join(wanted), stated=stated)
        return found

    @property
    def changes(self) -> list[tuple[str, Accepted | None, Accepted | None]]:
        """Name, before and after of each number that is accepted otherwise than before."""
        old, new = (side.metrics if side else {} for side in (self.before, self.after))
        return [(k, old.get(k), new.get(k)) for k in sorted({*old, *new}) if old.get(k) != new.get(k)]

    def accept_command(self, baselines: Path) -> str:
        """The command that takes the numbers of this run for accepted, in the folder ``baselines``."""
        named = [self.reference] if self.kind == "campaign" else ["--sensors", self.reference]
        where = [] if baselines == DEFAULT_FOLDER else ["--baselines", baselines]
        return as_typed("baseline", "accept", *named, *where) + ' --reason "..."'

    def baseline(self, reason: str, before: Mapping[str, Accepted]) -> Baseline:
        """Its numbers as accepted today; tolerances that stand in ``before`` are kept."""
        more: dict[str, Any] = {"versions": self.versions, "schema_version": 1}
        more["metrics"] = accepted_numbers(self.metrics, before)
        return Baseline.model_construct(kind=self.kind, name=self.run.campaign, reason=reason, date=today(), **more)

    @property
    def owner(self) -> str:
        """How the run is named among others: sensors may bear the name of a campaign."""
        return self.run.campaign if self.kind == "campaign" else f"sensor {self.run.campaign}"

    @property
    def errors(self) -> list[str]:
        """Numbers that ended in an error: a disagreement is a result, an error is none."""
        return [f"{key} ({m.outcome}: {m.reason})" for key, m in self.metrics.items() if m.outcome is Outcome.ERROR]


def all_runs(
    campaigns: Sequence[Path], sensors: Sequence[str], *, source: Path | None = None, keep: Path | None = None
) -> list[RunNumbers]:
    """The numbers of campaigns and sensors.

    Parameters
    ----------
    campaigns : campaign files
    sensors : names of the library, sensor files, or "all"
    source : folder of a finished ``validate``, read instead of running the campaigns
    keep : folder for the results of the campaigns, thrown away without

    Raises
    ------
    UsageError : nothing named, or a finished run that was made with other files or another source.
    InputError : a finished run that is not there.
    """
    refuse(not campaigns and not sensors, "baseline.nothing")
    named = [part for text in sensors for part in text.split(",") if part]
    chosen = {n: load_sensor(n) for part in named for n in (library_names() if part == ALL else (part,))}
    jobs = load_jobs(*campaigns) if campaigns else []
    with scratch_folder("check") as scratch:
        folder = source or keep or scratch / RUNS
        if jobs and source is None:
            validate(campaigns, folder)
        runs = [_read(job, folder, finished=source is not None) for job in jobs]
    for name, sensor in track(chosen.items(), "sensors", len(chosen)):
        numbers = sensor_metrics(sensor)
        run = Run(ResultTable(numbers.values()), campaign=sensor.name, title=sensor.specification.title)
        runs.append(RunNumbers("sensor", run, name, numbers))
    return runs


def _read(job: Job, source: Path, *, finished: bool) -> RunNumbers:
    # Of a check, whose tables compare with what was accepted, the campaign's own results count.
    name, top = job.outline.name, source / RUNS if (source / RUNS).is_dir() else source
    folder = inside if is_run(inside := top / file_stems([name])[name]) else top
    run, title = Run.open(folder), job.outline.title
    table = run.table.where(campaign=name)
    refuse(not len(table), "baseline.absent", source, name=name)
    stale = finished and (folder / RECORD).is_file() and find_unchanged_run(job, folder) is None
    refuse(stale, "baseline.stale", folder, name=name)
    run = replace(run, table=table, campaign=name, title=title, simulated=bool(job.outline.simulated))
    return RunNumbers("campaign", run, str(job.path), campaign_metrics(table))


def joined_rows(runs: Iterable[RunNumbers]) -> ResultTable:
    """All rows; their exit code is 1 when a number moved, is missing, new, or was never accepted, 5 without any."""
    return ResultTable(row for run in runs for row in run.rows)


def check(
    campaigns: Sequence[Path],
    sensors: Sequence[str] = (),
    *,
    baselines: Path,
    source: Path | None = None,
    output: Path | None = None,
    junit: Path | None = None,
) -> list[RunNumbers]:
    """Compare campaigns and sensors with what was accepted.

    Parameters
    ----------
    campaigns : campaign files; one whose data are lacking is SKIPPED
    sensors : names of the library, sensor files, or "all"
    baselines : folder of the accepted numbers
    source : folder of a finished ``validate`` of these campaigns, read instead of running them
    output : folder for the differences as a results table and pages; the campaigns' own results in ``runs/``
    junit : file for the verdicts

    Raises
    ------
    UsageError, InputError : of the campaigns, sensors, baselines or the finished run.
    """
    read = (one.path for job in (load_jobs(*campaigns) if campaigns else []) for one in job.files)
    with whole_folder(output, beside=[source, *read]) if output is not None else nullcontext() as folder:
        runs = all_runs(campaigns, sensors, source=source, keep=folder and folder / RUNS)
        runs = [_compare_run(run, baselines) for run in runs]
        if folder is not None:
            _write(runs, baselines, folder)
    if junit is not None:
        write_text(junit, junit_xml(joined_rows(runs)))
    return runs


def _compare_run(run: RunNumbers, folder: Path) -> RunNumbers:
    path, outcome, cause = run.path(folder), Outcome.DISAGREES, Cause.NONE
    if run.skipped is not None:
        outcome, cause, words = Outcome.SKIPPED, Cause.NO_DATA, run.skipped
    elif (before := run.load_accepted(folder)) is not None:
        return replace(run, rows=ResultTable(compare(run.owner, before.metrics, run.metrics)), before=before)
    elif run.errors:
        words = f"no baseline ({path}), and this run cannot become one: {run.errors[0]}"
    else:
        candidate = run.path(folder, CANDIDATE)
        run.baseline(f"{FILL_IN}: why these numbers are right", {}).write(candidate)
        instruction = f"to make them one: {run.accept_command(folder)}"
        words = f"no baseline ({path}); the numbers of this run are in {candidate}; {instruction}"
    names = (run.owner, "baseline", run.run.campaign, run.kind, "baseline")
    return replace(run, rows=ResultTable([Result(*names, role=Role.GATE, outcome=outcome, cause=cause, reason=words)]))


def _write(runs: Sequence[RunNumbers], baselines: Path, folder: Path) -> None:
    """A folder of results: one page for each campaign and sensor, and one that joins them."""
    reports, folders = [], file_stems(run.owner for run in runs)
    for run in runs:
        path = run.path(baselines)
        inputs = [{"reference": path.name, "sha256": sha256_of(path)}] if path.is_file() else []
        reports.append(Run(
            run.rows, {"command": command_without_output(), "versions": run.versions, "inputs": inputs},
            campaign=run.owner, title=f"{run.run.title}: against the accepted numbers", simulated=run.run.simulated,
            description="Each number of this run beside the accepted one; it fails beyond its tolerance.",
            kind="Accepted numbers of", group=f"{run.kind.capitalize()}s",
            sentence=accepted_text(run.rows) if run.before else next(row.reason for row in run.rows),
        ))  # fmt: skip
        inner = folder / folders[run.owner]
        inner.mkdir(exist_ok=True)
        write_outputs(reports[-1], inner)
    write_index(reports, folder, "Accepted numbers")


def accept(
    campaigns: Sequence[Path],
    sensors: Sequence[str] = (),
    *,
    reason: str,
    baselines: Path,
    source: Path | None = None,
) -> list[RunNumbers]:
    """Store the numbers of campaigns and sensors as accepted, with the reason.

    Tolerances that stand in a baseline are kept; new numbers get the default of their kind.  A baseline whose
    numbers are all the same is left as it is, with its reason and date.  Nothing is written unless every run is
    sound.

    Parameters as for :func:`check`.  What was run and has changes was written; what was skipped was not run.

    Raises
    ------
    UsageError : no reason, or a run that ended in an error.
    """
    words = " ".join(reason.split())
    refuse(not any(map(str.isalnum, words)), "baseline.reason")  # the dots of the printed command are none
    runs = all_runs(campaigns, sensors, source=source)
    for run in runs:
        refuse(run.errors, "baseline.broken", owner=run.owner, why="; ".join(run.errors[:1]))
    before = {run.owner: run.load_accepted(baselines) for run in runs}  # all are read before one is written
    for i, run in enumerate(runs):
        if run.skipped is None:
            held = before[run.owner]
            new = run.baseline(words, held.metrics if held else {})
            runs[i] = replace(run, before=held, after=new)
            if runs[i].changes:
                new.write(run.path(baselines))
                run.path(baselines, CANDIDATE).unlink(missing_ok=True)
    return runs
