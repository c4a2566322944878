"""The rows of one acceptance: gates, information, what was left out, and known discrepancies."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hyperval.results import Result, ResultTable, Status
from hyperval.sensor.published import KnownDiscrepancy


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
        threshold: float = math.nan,
        unit: str = "1",
        subject: str = "",
        band_nm: float = math.nan,
        n: int | None = None,
        reason: str = "",
        remark: str = "",
    ) -> bool:
        """One check; returns whether it passed.

        ``reason`` says what is wrong and is kept when it fails; ``remark`` stands in its place when it passes.
        """
        status = Status.PASS if passes else Status.FAIL
        text = remark if passes else reason
        known = next(
            (k for k in (f"{product}/{metric}/{subject}", f"{product}/{metric}") if k in self._known), None
        )
        if not passes and known is not None:
            self._used.add(known)
            status, text = Status.INFO, f"disagrees, as known: {self._known[known]} ({reason})"
        self._add(product, metric, value, unit, subject, status, text, threshold, band_nm, n)
        return passes

    def info(
        self,
        product: str,
        metric: str,
        value: float = math.nan,
        *,
        unit: str = "1",
        subject: str = "",
        band_nm: float = math.nan,
        reason: str = "",
    ) -> None:
        """A figure that decides nothing."""
        self._add(product, metric, value, unit, subject, Status.INFO, reason, math.nan, band_nm, None)

    def skipped(self, product: str, metric: str, reason: str) -> None:
        """A check that could not be made because another failed."""
        self._add(product, metric, math.nan, "1", "", Status.SKIPPED, reason, math.nan, math.nan, None)

    def error(self, product: str, metric: str, reason: str) -> None:
        """A check that ended in an error."""
        self._add(product, metric, math.nan, "1", "", Status.ERROR, reason, math.nan, math.nan, None)

    def close(self) -> None:
        """A known discrepancy that no check shows any more fails: the file says something that is not so."""
        for check in self._known:
            if check not in self._used:
                self.gate(
                    "file", "known_discrepancy", 0.0, False, threshold=1.0, subject=check,
                    reason="stands in known_discrepancies, but no check of that name fails: take it out",
                )  # fmt: skip

    def failed(self) -> bool:
        """True when a check failed or ended in an error so far."""
        return any(row.status in (Status.FAIL, Status.ERROR) for row in self.table)

    def _add(
        self,
        product: str,
        metric: str,
        value: float,
        unit: str,
        subject: str,
        status: Status,
        reason: str,
        threshold: float,
        band_nm: float,
        n: int | None,
    ) -> None:
        self.table.add(
            Result(
                self._campaign, product, subject, "sensor check", metric, float(value), unit, float(band_nm),
                n=n, threshold=threshold, status=status, reason=reason,
            )
        )  # fmt: skip
