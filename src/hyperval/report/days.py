"""One row of each of several finished runs, in the order of the times that they predict."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hyperval.errors import InputError, UsageError
from hyperval.report.stored import read_run
from hyperval.results import Result

SECONDS_PER_YEAR = 365.2425 * 86400.0


@dataclass(frozen=True)
class Day:
    """A row of one run and the time of its scenario."""

    when: datetime
    row: Result

    @property
    def year(self) -> float:
        """Time in years from an arbitrary start."""
        return self.when.timestamp() / SECONDS_PER_YEAR


def days_of(folders: Sequence[Path], product: str, subject: str, metric: str) -> list[Day]:
    """A row of every run in the folders, those in pages of several campaigns too; skipped ones are left out.

    Raises
    ------
    InputError : a folder without results.
    UsageError : a run with several times, or none of the runs has such a row.
    """
    days: list[Day] = []
    for folder in _runs(folders):
        run = read_run(folder)
        rows = [r for r in run.table if (r.product, r.subject, r.metric) == (product, subject, metric)]
        rows = [r for r in rows if r.value == r.value]
        if not rows:
            continue
        times = set(_times(run.provenance.get("engines") or {}))
        if len(times) != 1:
            raise UsageError(
                f"{len(times)} times in one run", where=str(folder), expected="scenarios of one time_utc"
            )
        days.append(Day(times.pop(), rows[0]))
    if not days:
        raise UsageError(
            f"no run has the row {product}, {subject}, {metric}",
            expected="names as in results.csv",
            mend="hyperval drift FOLDER --product P --subject S --metric M",
        )
    return sorted(days, key=lambda day: day.when)


def _runs(folders: Iterable[Path]) -> list[Path]:
    out: list[Path] = []
    for folder in folders:
        inside = sorted(path.parent for path in Path(folder).glob("*/provenance.json"))
        if not inside and not (Path(folder) / "results.json").is_file():
            raise InputError("no results", where=str(folder), mend="name a folder that hyperval validate wrote")
        out += inside or [Path(folder)]
    return out


def _times(engines: dict[str, Any]) -> Iterable[datetime]:
    for record in engines.values():
        text = record.get("time_utc") if isinstance(record, dict) else None
        if text:
            when = datetime.fromisoformat(str(text))
            yield when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)
