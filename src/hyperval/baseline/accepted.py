"""Where baselines stand, and how they are written: one number a line, so that a change reads as one.

What a tolerance of a baseline may not be.

The file of one baseline: what was accepted, how far it may move, why, when, with what.

Which rows of a run a baseline keeps: every planned one, and what stands behind it.

The numbers of one sensor that a baseline keeps: signal, noise, and what the standard scenarios make of it.
"""

from __future__ import annotations

import json
import math
import os
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

import hyperval
from hyperval.config import Model, load_model
from hyperval.errors import HypervalError, reader, refuse
from hyperval.metrics import DIGITS, Of, Tolerance, default_tolerance, metric_of
from hyperval.model.roc import detection_at
from hyperval.results import WORST_FIRST, Outcome, Result, ResultTable
from hyperval.sensor.noise import NoiseBreakdown, NoiseModel
from hyperval.sensor.specification import Sensor
from hyperval.sensor_check.suite import (
    FALSE_ALARM,
    LEVELS,
    MIDDLE,
    Engine,
    SensorCheck,
    summary_regions,
    sunlit_radiance,
)
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import write_text

# A tolerance of more than the number itself, or than its own 95 % interval, accepts anything.
LARGEST = {"value": 1.0, "interval": 1.0, "unit": 0.1}


def rounded(value: float) -> float | None:
    """The number as a baseline keeps it; None where there is none (NaN, infinity)."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None


Kind = Literal["campaign", "sensor"]
SEPARATOR = " | "


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
    def limit(self) -> Tolerance:
        """The tolerance with what it is a part of."""
        return Tolerance(self.tolerance, self.of)

    @property
    def width(self) -> float:
        """Largest tolerated difference, in the metric's unit."""
        return self.limit.width(self.accepted or 0.0, self.half_width)

    @property
    def range(self) -> tuple[float, float]:
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
        if math.isfinite(low) and self.range[0] <= low and self.range[1] >= high:
            return f"{metric} lies between {low:g} and {high:g}: a tolerance of {self.width:g} can never fail"
        usual = default_tolerance(metric, self.half_width).width(self.accepted, self.half_width)
        return "a tolerance above the default needs 'why'" if not self.why and self.width > usual * (1 + 1e-9) else None


class Baseline(Model):
    """The accepted numbers of one campaign or sensor."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: Kind
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    reason: str = Field(min_length=1, description="why these numbers were accepted")
    date: str = Field(pattern=r"^\d{4}-\d{2}-\d{2}$", description="when they were last accepted")
    versions: dict[str, str] = Field(description="versions they were computed with")
    metrics: dict[str, Accepted] = Field(min_length=1, description='"product | subject | method | metric": number')

    @model_validator(mode="after")
    def _sound(self) -> Baseline:
        """Refuse tolerances that mean nothing."""
        for key, item in self.metrics.items():
            if wrong := item.objection(split_key(key)[-1]):
                raise ValueError(f"{key}: {wrong}")
        return self

    def write(self, path: Path) -> None:
        """Write it: one number a line, so that a change reads as one."""
        lines = [
            f"# Accepted numbers of the {self.kind} {self.name}.  "
            "`hyperval baseline accept` renews them; tolerances are set by hand.",
            "schema: 1",
            f"kind: {self.kind}",
            *(f"{key}: {_text(getattr(self, key))}" for key in ("name", "reason", "date")),
            f"versions: {{{', '.join(f'{key}: {_text(value)}' for key, value in self.versions.items())}}}",
            "metrics:",
            *(f"  {_text(key)}: {_line(item)}" for key, item in sorted(self.metrics.items())),
        ]
        write_text(path, "\n".join(lines) + "\n")


def _line(item: Accepted) -> str:
    entries = item.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    entries = {"accepted": item.accepted, **{k: v for k, v in entries.items() if k != "accepted"}}
    return "{" + ", ".join(f"{key}: {_scalar(value)}" for key, value in entries.items()) + "}"


def _scalar(value: object) -> str:
    if value is None:
        return "null"
    if isinstance(value, str):
        return value if value.isalpha() else _text(value)
    return repr(value)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


def key_of(row: Result) -> str:
    """The name of a number in a baseline."""
    return SEPARATOR.join((row.product, row.subject, row.method, row.metric))


def split_key(key: str) -> tuple[str, str, str, str]:
    """Product, subject, method, metric of a name; ValueError when it is none."""
    product, first, rest = key.partition(SEPARATOR)
    parts = rest.rsplit(SEPARATOR, 2)
    if not first or len(parts) != 3:
        raise ValueError(f"{key!r} is not 'product | subject | method | metric'")
    return product, parts[0], parts[1], parts[2]


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


# A planned row is often an absolute value or a verdict; these say which way and how far the two sides moved.
BEHIND: Mapping[str, tuple[str, ...]] = {
    "radiance": ("median_difference_ratio_*", "spectral_angle"),
    "toa_reflectance": ("median_difference_ratio_*", "spectral_angle", "fraction_inside_stated*"),
    "snr": ("median_difference_ratio_*",),
    "reflectance": ("median_difference_ratio_*", "spectral_angle"),
    "scores": ("score_mean_predicted", "score_mean_observed", "score_sd_ratio"),
    "roc": ("pd_predicted@*", "pd_measured@*"),
    "abundance": ("area_predicted", "area_observed", "area_ratio"),
}


def campaign_metrics(rows: Iterable[Result]) -> dict[str, Result]:
    """The numbers of one campaign that a baseline keeps, sorted by name.

    Every planned row that is not about a single band, whether it gates or informs, and for the subjects and
    methods of those the rows of :data:`BEHIND`.  Of a row that several gates cover the worst outcome counts.
    """
    whole = [row for row in rows if not row.per_band]
    planned = [row for row in whole if row.planned]
    subjects = {(r.product, s.strip(), r.method) for r in planned for s in (r.subject, *r.subject.split(","))}

    def is_behind(row: Result) -> bool:
        planned_here = [named[1:] for named in subjects if named[0] == row.product]
        return any(fnmatchcase(row.metric, metric) for metric in BEHIND.get(row.product, ())) and any(
            fnmatchcase(row.subject, subject) and fnmatchcase(row.method, method) for subject, method in planned_here
        )

    metrics: dict[str, Result] = {}
    for row in [*planned, *filter(is_behind, whole)]:
        old = metrics.setdefault(key_of(row), row)
        metrics[key_of(row)] = replace(old, outcome=min(old.outcome, row.outcome, key=WORST_FIRST.index))
    return dict(sorted(metrics.items()))


def skipped_reason(rows: Sequence[Result] | ResultTable) -> str | None:
    """Why a campaign as a whole was skipped, None when any of its rows was made."""
    reasons = [row.reason for row in rows if row.outcome is Outcome.SKIPPED]
    return reasons[0] if reasons and len(reasons) == len(rows) else None


METHOD = "sensor"
# Lines of the sun (CH, Mg, H alpha) and of oxygen: a response of another width sees them deeper or less deep.
LINES_NM = (430.0, 517.0, 656.0, 762.0)
# Errors of transmission are zero in most sensor files; this rate shows what they would do.
BIT_ERROR_RATE = 1e-9


def sensor_metrics(sensor: Sensor, engine: Engine | None = None) -> dict[str, Result]:
    """Every number of a sensor, sorted by name.

    Median SNR (without C_R) at the reference radiances, G, each noise term as a radiance, by spectral region; the
    reference radiance in bands at lines; P_D at P_FA 1e-3 and the radiance of the white panel at the oxygen band in
    the standard scenarios.

    Parameters
    ----------
    engine : stands in for the atmosphere engine
    """
    check = SensorCheck(sensor, engine=engine)
    rows = [*_bands(check.axis), *_noise(check.axis, check.noise), *_scenarios(check)]
    return {key_of(row): row for row in sorted(rows, key=key_of)}


def _item(product: str, subject: str, metric: str, value: float, unit: str = "1") -> Result:
    return Result("", product, subject, METHOD, metric, float(value), unit)


def _bands(axis: SpectralAxis) -> Iterator[Result]:
    yield _item("bands", "all", "band_count", len(axis))
    yield _item("bands", "good", "band_count", int(axis.good.sum()))
    level = sunlit_radiance(axis, MIDDLE)
    for line in LINES_NM:
        at = _band_at(axis, line)
        if at is not None:
            yield _item("bands", f"{line:g} nm", "reference_radiance", level[at], "uW cm-2 sr-1 nm-1")


def _band_at(axis: SpectralAxis, wavelength_nm: float) -> int | None:
    """The band nearest a wavelength, None where it is further off than its width."""
    at = int(np.argmin(np.abs(axis.centre_nm - wavelength_nm)))
    return at if abs(axis.centre_nm[at] - wavelength_nm) <= axis.fwhm_nm[at] else None


def _noise(axis: SpectralAxis, noise: NoiseModel) -> Iterator[Result]:
    for region, here in summary_regions(axis).items():
        gain = np.median(noise.electrons_per_radiance[here])  # (3.13)
        yield _item("noise", region, "median_electrons_per_radiance", gain, "electrons per uW cm-2 sr-1 nm-1")
        for level in LEVELS:
            snr = noise.snr(sunlit_radiance(axis, level), calibration=False)[here]  # (3.20)
            yield _item("snr", f"reflectance {level:g}, {region}", "median_snr", np.median(snr))
        parts = noise.breakdown(sunlit_radiance(axis, MIDDLE))
        for term in _terms(parts):
            value = np.median(np.sqrt(np.abs(getattr(parts, term)[here])))
            yield _item("noise", region, f"median_noise_{term}", value, "uW cm-2 sr-1 nm-1")
        if noise.measured is None:
            wrong = replace(noise, bit_error_rate=BIT_ERROR_RATE, bit_error_per="bit")
            variance = wrong.breakdown(sunlit_radiance(axis, MIDDLE)).bit_errors  # (3.19)
            value = np.median(np.sqrt(variance[here]))
            metric = f"median_bit_error_noise_at_rate_{BIT_ERROR_RATE:g}"
            yield _item("noise", region, metric, value, "uW cm-2 sr-1 nm-1")


def _terms(parts: NoiseBreakdown) -> list[str]:
    """The terms of (3.15)-(3.19) that the sensor has; the others are zero, or what rounding leaves."""
    floor = 1e-9 * parts.total
    return [f.name for f in fields(parts) if np.any(np.abs(getattr(parts, f.name)) > floor)]


def _scenarios(check: SensorCheck) -> Iterator[Result]:
    for name, run in check.runs.items():
        if isinstance(run, HypervalError):
            yield replace(_item("scenario", name, "runs", np.nan), outcome=Outcome.SKIPPED, reason=str(run))
    for name, (subject, detector, _), curve in check.curves:
        pd = float(detection_at(curve, FALSE_ALARM))
        yield _item("scenario", f"{name}, {subject}, {detector}", f"pd_at_pfa_{FALSE_ALARM:g}", pd)
    oxygen = _band_at(check.axis, LINES_NM[-1])
    for name, prediction in check.predictions.items():
        if "white panel" in prediction.radiance and oxygen is not None:
            subject, level = f"{name}, {LINES_NM[-1]:g} nm", prediction.radiance["white panel"].mean[oxygen]
            yield _item("scenario", subject, "white_panel_radiance", level, "uW cm-2 sr-1 nm-1")


DEFAULT_FOLDER = Path("validation/baselines")
SENSORS = "sensors"
# What a change of numbers may come from besides this project.
PACKAGES = ("numpy", "scipy")


def baseline_path(folder: Path, kind: Kind, name: str) -> Path:
    """The file of a baseline: ``folder``/NAME.yaml, sensors in a folder of their own."""
    return folder / (f"{name}.yaml" if kind == "campaign" else f"{SENSORS}/{name}.yaml")


def candidate_path(folder: Path, kind: Kind, name: str) -> Path:
    """Where the numbers of a run without a baseline are left, beside where they would be accepted."""
    return baseline_path(folder, kind, name).with_suffix(".candidate.yaml")


def stored(folder: Path, kind: Kind, name: str) -> Baseline | None:
    """The baseline of a campaign or sensor, None when there is none.

    Raises
    ------
    UsageError : mistakes in the file, or a file of something else.
    """
    path = baseline_path(folder, kind, name)
    if not path.is_file():
        return None
    baseline = load_baseline(path)
    other = (baseline.kind, baseline.name) != (kind, name)
    refuse(other, "baseline.other", path, wanted=f"{kind} {name}", of=f"{baseline.kind} {baseline.name!r}")
    return baseline


def accepted_of(measured: Mapping[str, Result], before: Mapping[str, Accepted]) -> dict[str, Accepted]:
    """Measured numbers as a baseline keeps them; tolerances that stand in ``before`` are kept, not loosened."""
    return {key: _accepted(new, before.get(key)) for key, new in sorted(measured.items())}


def _accepted(new: Result, old: Accepted | None) -> Accepted:
    width = (new.upper - new.lower) / 2.0
    value, half = rounded(new.value), rounded(width) if width > 0 else None
    limit = old.limit if old else default_tolerance(new.metric, half)
    if limit.of == "interval" and half is None:  # the interval is gone: its part of it means nothing any more
        limit = default_tolerance(new.metric)
    half = half if limit.of == "interval" else None
    more: dict[str, Any] = {"half_width": half, "outcome": new.outcome.value, "why": old.why if old else None}
    return Accepted(accepted=value, tolerance=limit.tolerance, of=limit.of, **more)


def versions(packages: Mapping[str, str] | None = None, python: str | None = None) -> dict[str, str]:
    """What the numbers were computed with: of a run's record where it is given, of this process otherwise."""
    there = packages if packages is not None else {name: metadata.version(name) for name in PACKAGES}
    known = {name: there[name] for name in PACKAGES if name in there}
    return {"hyperval": hyperval.__version__, "python": python or platform.python_version(), **known}


def today() -> str:
    """The date, of SOURCE_DATE_EPOCH where that is set."""
    text = os.environ.get("SOURCE_DATE_EPOCH", "")
    refuse(text and not text.isdigit(), "baseline.date", text=text)
    now = datetime.fromtimestamp(int(text), UTC) if text else datetime.now(UTC)
    return now.date().isoformat()
