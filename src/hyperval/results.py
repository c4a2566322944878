"""The one results table: every report, gate and export is a view of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import astuple, dataclass, fields
from enum import StrEnum
from typing import Any

import pandas as pd


class Status(StrEnum):
    """What became of one planned comparison."""

    PASS = "PASS"  # noqa: S105
    FAIL = "FAIL"
    ERROR = "ERROR"
    SKIPPED = "SKIPPED"
    INFO = "INFO"


@dataclass(frozen=True)
class Result:
    """One row.

    ``lower`` and ``upper`` bound ``value`` at 95 % unless the metric says otherwise; ``threshold`` is
    what a gate compares with; ``reason`` says why a row was skipped, failed or is not a gate.
    """

    campaign: str
    product: str
    subject: str
    method: str
    metric: str
    value: float = math.nan
    unit: str = "1"
    band_nm: float = math.nan
    lower: float = math.nan
    upper: float = math.nan
    n: int | None = None
    threshold: float = math.nan
    status: Status = Status.INFO
    reason: str = ""


COLUMNS = (
    "campaign", "product", "subject", "method", "band_nm", "metric", "value", "unit",
    "lower", "upper", "n", "threshold", "status", "reason",
)  # fmt: skip


class ResultTable:
    """An append-only list of results with the views that the writers need."""

    def __init__(self, rows: Iterable[Result] = ()):
        self._rows: list[Result] = list(rows)

    def __iter__(self) -> Iterator[Result]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, *rows: Result) -> None:
        """Append rows."""
        self._rows.extend(rows)

    def where(self, **equal: Any) -> ResultTable:
        """The rows whose named fields equal the given values."""
        return ResultTable(r for r in self._rows if all(getattr(r, k) == v for k, v in equal.items()))

    def gates(self) -> ResultTable:
        """The rows that decide pass or fail: everything that is not INFO."""
        return ResultTable(r for r in self._rows if r.status is not Status.INFO)

    def frame(self) -> pd.DataFrame:
        """The table in the column order of the output contract."""
        names = [f.name for f in fields(Result)]
        frame = pd.DataFrame([astuple(r) for r in self._rows], columns=names)
        frame["n"] = frame["n"].astype("Int64")
        frame["status"] = frame["status"].astype(str)
        return frame[list(COLUMNS)]

    def exit_code(self) -> int:
        """The exit code of the contract: 1 failed, 3 input error, 5 nothing checked, 0 otherwise.

        An ERROR row counts as a failed comparison unless the caller knows a better code.
        """
        counts = [r.status for r in self._rows]
        if Status.FAIL in counts or Status.ERROR in counts:
            return 1
        if Status.PASS not in counts:
            return 5
        return 0
