"""A finished run read back from its folder.

One row of each of several finished runs, in the order of the times that they predict.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hyperval.errors import InputError, UsageError, reader
from hyperval.metrics import Evidence
from hyperval.report.tables import SCHEMA_VERSION
from hyperval.results import Cause, Outcome, Result, ResultTable, Role

MAX_BYTES = 500_000_000
_READABLE = (2, SCHEMA_VERSION)  # the second version repeated the names of the columns in each row
_WORDS = {"inf": math.inf, "-inf": -math.inf}
_NUMBERS = ("value", "band_nm", "lower", "upper", "limit_low", "limit_high", "detectable")
_KNOWN = {f.name for f in fields(Result)}
_TYPES = {"role": Role, "evidence": Evidence, "outcome": Outcome, "cause": Cause}


@dataclass(frozen=True)
class StoredRun:
    """What a folder of results holds.

    Attributes
    ----------
    folder : where it stands
    table : every row
    provenance : of one campaign; empty for the page of several
    figures : name of a file in ``figures/`` -> its path
    """

    folder: Path
    table: ResultTable
    provenance: Mapping[str, Any]
    figures: Mapping[str, Path]


@reader
def read_run(folder: Path) -> StoredRun:
    """Read a folder that ``validate``, ``observe``, ``predict`` or another command wrote.

    Raises
    ------
    InputError : no results.json, or one that is not of this kind.
    """
    folder = Path(folder)
    provenance = folder / "provenance.json"
    figures = sorted((folder / "figures").glob("*.*")) if (folder / "figures").is_dir() else []
    return StoredRun(
        folder,
        read_results(folder / "results.json"),
        _json(provenance) if provenance.is_file() else {},
        {p.name: p for p in figures if p.suffix in (".svg", ".png")},
    )


@reader
def read_results(path: Path) -> ResultTable:
    """The rows of a results.json.

    Raises
    ------
    InputError : no such file, not JSON, or not a results table of this version.
    """
    document = _json(path)
    columns = document.get("columns")
    if (
        document.get("schema_version") not in _READABLE
        or not isinstance(document.get("rows"), list)
        or not isinstance(columns, list)
    ):
        raise InputError(
            "not a results table", where=str(path), expected=f"results.json of schema version {SCHEMA_VERSION}"
        )
    return ResultTable(_row(item, columns, f"{path}, row {i}") for i, item in enumerate(document["rows"], start=1))


def _row(item: Any, columns: list[Any], where: str) -> Result:
    if isinstance(item, list) and len(item) == len(columns):
        item = dict(zip(map(str, columns), item, strict=True))
    if not isinstance(item, dict) or item.keys() != _KNOWN:
        raise InputError("not a row of results", where=where, expected="the columns " + ", ".join(sorted(_KNOWN)))
    values = dict(item)
    try:
        for name in _NUMBERS:
            value = values[name]
            values[name] = math.nan if value is None else float(_WORDS.get(value, value))
        for name, kind in _TYPES.items():
            values[name] = kind(values[name])
        return Result(**values)
    except (TypeError, ValueError, UsageError) as error:
        raise InputError(f"not a row of results: {error}", where=where) from error


def _json(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"larger than {MAX_BYTES} bytes", where=str(path))
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError("no such file", where=str(path), mend="name a folder of results") from error
    except OSError as error:
        raise InputError(f"cannot read: {error.strerror}", where=str(path)) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {error}", where=str(path)) from error
    if not isinstance(content, dict):
        raise InputError("not a JSON object", where=str(path))
    return content


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
            raise UsageError(f"{len(times)} times in one run", where=str(folder), expected="scenarios of one time_utc")
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
