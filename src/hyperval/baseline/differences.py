"""Accepted against measured: one row for each number of either."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hyperval.baseline.metrics import Measured
from hyperval.baseline.schema import Accepted, split_key
from hyperval.baseline.tolerances import rounded
from hyperval.results import Outcome, Result, Role


@dataclass(frozen=True)
class Difference:
    """One number, accepted and now.

    Attributes
    ----------
    owner : campaign, or "sensor NAME"
    key : name of the number
    accepted, now : None where that side does not hold it
    outcome : agrees, disagrees
    words : what is wrong, empty when nothing is
    """

    owner: str
    key: str
    accepted: Accepted | None
    now: Measured | None
    outcome: Outcome
    words: str = ""

    @property
    def change(self) -> float:
        """Now minus accepted; NaN where a side has no value."""
        if self.accepted is None or self.accepted.accepted is None or self.now is None:
            return math.nan
        return self.now.value - self.accepted.accepted

    @property
    def moved(self) -> bool:
        """True where the number is not the same to the digits that a baseline keeps."""
        if self.accepted is None or self.now is None:
            return True
        return rounded(self.now.value) != self.accepted.accepted

    def row(self) -> Result:
        """As a row of results: the value now, the tolerated range as its limits, and in words."""
        product, subject, method, metric = split_key(self.key)
        value = self.now.value if self.now else math.nan
        unit = self.now.unit if self.now else "1"
        low = high = math.nan
        if self.accepted is not None and self.accepted.accepted is not None:
            low, high = (self.accepted.accepted + sign * self.accepted.width for sign in (-1.0, 1.0))
        return Result(
            self.owner, product, subject, method, metric, value, unit,
            limit_low=low, limit_high=high, role=Role.GATE, outcome=self.outcome, reason=self.words,
        )  # fmt: skip


def compare(owner: str, accepted: Mapping[str, Accepted], now: Mapping[str, Measured]) -> list[Difference]:
    """One difference for each number of either side, by name.

    It disagrees: beyond the tolerance, no longer there, not accepted yet, a value where there was none or none
    where there was one, another outcome.  A number that was not accepted fails: until it is, nothing guards it.
    """
    out = []
    for key in sorted({*accepted, *now}):
        words = _objection(key, accepted.get(key), now.get(key))
        outcome = Outcome.DISAGREES if words else Outcome.AGREES
        out.append(Difference(owner, key, accepted.get(key), now.get(key), outcome, words))
    return out


def _objection(key: str, old: Accepted | None, new: Measured | None) -> str:
    if old is None:
        return f"{split_key(key)[-1]} is not accepted: the baseline does not hold this number"
    if new is None:
        return (
            f"{split_key(key)[-1]} is missing: the run does not give this number (accepted {_text(old.accepted)})"
        )
    reason = f" ({new.reason})" if new.reason and new.outcome is not Outcome.NONE else ""
    value = new.value if math.isfinite(new.value) else None
    words = ""
    if (value is None) != (old.accepted is None):
        words = f"moved from {_text(old.accepted)} to {_text(value)}"
    elif value is not None and old.accepted is not None and not abs(value - old.accepted) <= old.width:
        words = (
            f"moved from {old.accepted:.6g} to {value:.6g}: {value - old.accepted:+.3g}, tolerance {old.width:.3g}"
        )
    if new.outcome.value != old.outcome:
        verdict = f"the outcome changed from {old.outcome} to {new.outcome}{reason}"
        words = f"{words}; {verdict}" if words else verdict
    return f"{split_key(key)[-1]} {words}" if words else ""


def _text(value: float | None) -> str:
    return "no value" if value is None else f"{value:.6g}"
