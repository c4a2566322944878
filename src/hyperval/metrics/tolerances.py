"""How far a number may move before it counts as another number.

Two machines, or two builds of the linear-algebra library, differ in the last digits; a change of the science moves
a number by more.  The defaults stand between the two (docs/regression.md has both as measured).
"""

from __future__ import annotations

from dataclasses import dataclass

from hyperval.metrics.metric import Of
from hyperval.metrics.table import metric_of

DIGITS = 6  # significant digits that are kept
_ROUNDING = 0.51 * 10.0 ** (1 - DIGITS)
_SMALLEST = 1e-9  # below this a difference of numbers of order 1 is rounding


@dataclass(frozen=True)
class Tolerance:
    """A tolerance: of the accepted value, of the half width of its 95 % interval, or in the metric's own unit."""

    tolerance: float
    of: Of

    def width(self, accepted: float, half_width: float | None = None) -> float:
        """Largest difference from ``accepted`` that is tolerated, in the metric's unit."""
        scale = {"value": abs(accepted), "interval": half_width or 0.0, "unit": 1.0}[self.of]
        return max(self.tolerance * scale, _ROUNDING * abs(accepted), _SMALLEST)


def default_tolerance(metric: str, half_width: float | None = None) -> Tolerance:
    """The tolerance of a metric whose baseline does not name one, as the table of metrics has it."""
    with_interval, without = metric_of(metric).tolerance
    return Tolerance(*(with_interval if half_width or with_interval[1] != "interval" else without))
