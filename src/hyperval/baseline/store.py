"""Where baselines stand, and how they are written: one number a line, so that a change reads as one."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

import hyperval
from hyperval.baseline.metrics import Measured
from hyperval.baseline.schema import Accepted, Baseline, Kind, load_baseline, split_key
from hyperval.baseline.tolerances import rounded
from hyperval.config import FILL_IN
from hyperval.errors import UsageError
from hyperval.files import write_text
from hyperval.metrics.tolerances import default_tolerance

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
    if (baseline.kind, baseline.name) != (kind, name):
        raise UsageError(
            f"is the baseline of {baseline.kind} {baseline.name!r}", where=str(path), expected=f"{kind} {name}"
        )
    return baseline


def accepted_of(measured: Mapping[str, Measured], before: Mapping[str, Accepted]) -> dict[str, Accepted]:
    """Measured numbers as a baseline keeps them; tolerances that stand in ``before`` are kept, not loosened."""
    return {key: _accepted(key, new, before.get(key)) for key, new in sorted(measured.items())}


def _accepted(key: str, new: Measured, old: Accepted | None) -> Accepted:
    value, half = rounded(new.value), rounded(new.half_width) if new.half_width else None
    limit = old.limit if old else default_tolerance(split_key(key)[-1], half)
    if limit.of == "interval" and half is None:  # the interval is gone: its part of it means nothing any more
        limit = default_tolerance(split_key(key)[-1])
    return Accepted.model_validate(
        {
            "accepted": value,
            "tolerance": limit.tolerance,
            "of": limit.of,
            "half_width": half if limit.of == "interval" else None,
            "outcome": new.outcome.value,
            "why": old.why if old else None,
        }
    )


def versions(packages: Mapping[str, str] | None = None, python: str | None = None) -> dict[str, str]:
    """What the numbers were computed with: of a run's record where it is given, of this process otherwise."""
    there = packages if packages is not None else {name: metadata.version(name) for name in PACKAGES}
    known = {name: there[name] for name in PACKAGES if name in there}
    return {"hyperval": hyperval.__version__, "python": python or platform.python_version(), **known}


def today() -> str:
    """The date, of SOURCE_DATE_EPOCH where that is set."""
    text = os.environ.get("SOURCE_DATE_EPOCH", "")
    if text and not text.isdigit():
        raise UsageError(f"SOURCE_DATE_EPOCH is {text!r}", expected="seconds since 1970")
    now = datetime.fromtimestamp(int(text), UTC) if text else datetime.now(UTC)
    return now.date().isoformat()


def write_baseline(
    path: Path,
    kind: Kind,
    name: str,
    reason: str,
    used: Mapping[str, str],
    metrics: Mapping[str, Accepted],
    *,
    candidate: bool = False,
) -> None:
    """Write one baseline, or a candidate whose reason and date are still to be given."""
    what = f"{FILL_IN}: why these numbers are right" if candidate else reason
    lines = [
        f"# Accepted numbers of the {kind} {name}.  "
        "`hyperval baseline accept` renews them; tolerances are set by hand.",
        "schema: 1",
        f"kind: {kind}",
        f"name: {json.dumps(name)}",
        f"reason: {_text(what)}",
        f"date: {_text(today())}",
        f"versions: {{{', '.join(f'{key}: {_text(value)}' for key, value in used.items())}}}",
        "metrics:",
        *(f"  {_text(key)}: {_line(item)}" for key, item in sorted(metrics.items())),
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
