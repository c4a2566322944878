"""The rows of one acceptance: gates, information, what was left out, and known discrepancies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.sensor.published import KnownDiscrepancy

METHOD = "sensor check"


class Ledger:
    """Collects the rows of one sensor; a check that the file lists as a known discrepancy informs when it fails."""

    def __init__(self, sensor: str, known: Sequence[KnownDiscrepancy] = ()):
        self.table = ResultTable()
        self._campaign = f"sensor {sensor}"
        self._known = {item.check: item.reason for item in known}
        self._used: set[str] = set()

    def gate(
        self,
        product: str,
        metric: str,
        value: float,
        passes: bool,
        *,
        at_least: float = math.nan,
        at_most: float = math.nan,
        unit: str = "1",
        subject: str = "",
        n: int | None = None,
        reason: str = "",
        remark: str = "",
    ) -> bool:
        """One check; returns whether it passed.

        ``reason`` says what is wrong and is kept when it fails; ``remark`` stands in its place when it passes.
        """
        outcome, role = (Outcome.AGREES if passes else Outcome.DISAGREES), Role.GATE
        text = remark if passes else reason
        known = next(
            (k for k in (f"{product}/{metric}/{subject}", f"{product}/{metric}") if k in self._known), None
        )
        if not passes and known is not None:
            self._used.add(known)
            role, text = Role.INFORM, f"as known: {self._known[known]} ({reason})"
        self.table.add(
            Result(
                self._campaign, product, subject, METHOD, metric, float(value), unit, n=n,
                limit_low=float(at_least), limit_high=float(at_most), role=role, outcome=outcome, reason=text,
            )
        )  # fmt: skip
        return passes

    def info(
        self,
        product: str,
        metric: str,
        value: float = math.nan,
        *,
        unit: str = "1",
        subject: str = "",
        reason: str = "",
    ) -> None:
        """A figure that decides nothing."""
        self.table.add(Result(self._campaign, product, subject, METHOD, metric, float(value), unit, reason=reason))

    def skipped(self, product: str, metric: str, reason: str) -> None:
        """A check that could not be made because another failed."""
        self._without_value(product, metric, Outcome.SKIPPED, Cause.AFTER_FAILURE, reason)

    def error(self, product: str, metric: str, reason: str) -> None:
        """A check that ended in an error."""
        self._without_value(product, metric, Outcome.ERROR, Cause.BROKEN, reason)

    def close(self) -> None:
        """A known discrepancy that no check shows any more fails: the file says something that is not so."""
        for check in self._known:
            if check not in self._used:
                self.gate(
                    "file", "known_discrepancy", 0.0, False, at_least=1.0, subject=check,
                    reason="stands in known_discrepancies, but no check of that name fails: take it out",
                )  # fmt: skip

    def failed(self) -> bool:
        """True when a check failed or ended in an error so far."""
        return any(row.gates and row.outcome in (Outcome.DISAGREES, Outcome.ERROR) for row in self.table)

    def _without_value(self, product: str, metric: str, outcome: Outcome, cause: Cause, reason: str) -> None:
        row = Result(self._campaign, product, "", METHOD, metric, role=Role.GATE)
        self.table.add(replace(row, outcome=outcome, cause=cause, reason=reason))
