"""How far a number may move before it counts as another number.

Two machines, or two builds of the linear-algebra library, differ in the last digits; a change of the science moves
a number by more.  The defaults stand between the two (docs/regression.md has both as measured).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from hyperval.metrics import metric_of
from hyperval.metrics.metric import Of

# A tolerance of more than the number itself, or than its own 95 % interval, accepts anything.
LARGEST = {"value": 1.0, "interval": 1.0, "unit": 0.1}
DIGITS = 6  # significant digits that a baseline keeps
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


def objection(metric: str, tolerance: Tolerance, accepted: float | None, half_width: float | None) -> str | None:
    """What is wrong with a tolerance, None when nothing is."""
    limit = LARGEST[tolerance.of]
    if not 0.0 <= tolerance.tolerance <= limit:
        return f"a tolerance of {tolerance.tolerance:g} of {tolerance.of}: never above {limit:g}, never below 0"
    if tolerance.of == "interval" and not half_width:
        return "a tolerance of the interval needs half_width"
    if accepted is None:
        return None
    width = tolerance.width(accepted, half_width)
    low, high = metric_of(metric).low, metric_of(metric).high
    if math.isfinite(low) and accepted - width <= low and accepted + width >= high:
        return f"{metric} lies between {low:g} and {high:g}: a tolerance of {width:g} can never fail"
    return None


def looser_than_default(metric: str, tolerance: Tolerance, accepted: float, half_width: float | None) -> bool:
    """True where the tolerance lets the number move further than the default of its kind would."""
    usual = default_tolerance(metric, half_width).width(accepted, half_width)
    return tolerance.width(accepted, half_width) > usual * (1.0 + 1e-9)


def rounded(value: float) -> float | None:
    """The number as a baseline keeps it; None where there is none (NaN, infinity)."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
