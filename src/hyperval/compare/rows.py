"""Making rows of the results table."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from hyperval.metrics import Evidence
from hyperval.results import Cause, Outcome, Result

# The metric of a row that stands for a whole comparison which could not be made.
COMPARISON = "comparison"

T = TypeVar("T")


@dataclass(frozen=True)
class RowMaker:
    """Fills in what the rows of one comparison share; their campaign is named when all of them are there."""

    product: str
    subject: str
    method: str

    def row(
        self,
        metric: str,
        value: float,
        *,
        interval: tuple[float, float] | None = None,
        half: float = math.nan,
        unit: str = "1",
        band_nm: float = math.nan,
        n: int | None = None,
        detectable: float = math.nan,
        evidence: Evidence | None = None,
        reason: str = "",
    ) -> Result:
        """A row without an outcome; what is planned gives it one later.  ``half``: half of its interval's width."""
        low, high = interval or (value - half, value + half)
        return Result(
            "", self.product, self.subject, self.method, metric, float(value), unit, float(band_nm),
            float(low), float(high), n, evidence=evidence, detectable=float(detectable),
            reason=reason,
        )  # fmt: skip

    def skipped(self, cause: Cause, reason: str, metric: str = COMPARISON) -> Result:
        """A planned row that has no value, with the cause and words."""
        return Result(
            "", self.product, self.subject, self.method, metric, outcome=Outcome.SKIPPED, cause=cause,
            reason=reason,
        )  # fmt: skip

    def compared(
        self, predicted: T | None, observed: T | None, rows: Callable[[T, T], list[Result]]
    ) -> list[Result]:
        """The rows, or one skipped row that says which side has no such product."""
        if predicted is not None and observed is not None:
            return rows(predicted, observed)
        missing = [name for name, side in (("prediction", predicted), ("observation", observed)) if side is None]
        cause = Cause.NO_PREDICTION if predicted is None else Cause.NO_OBSERVATION
        return [self.skipped(cause, f"no {self.product} of {self.subject} in the {' and in the '.join(missing)}")]


def scientific(value: float) -> str:
    """A short label of a probability: 0.01 is 1e-2.

    Examples
    --------
    >>> scientific(0.01), scientific(2.5e-4)
    ('1e-2', '2.5e-4')
    """
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value / 10.0**exponent:.3g}e{exponent}"
