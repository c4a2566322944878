"""What a tolerance of a baseline may not be."""

from __future__ import annotations

import math

from hyperval.metrics import metric_of
from hyperval.metrics.tolerances import DIGITS, Tolerance, default_tolerance

# A tolerance of more than the number itself, or than its own 95 % interval, accepts anything.
LARGEST = {"value": 1.0, "interval": 1.0, "unit": 0.1}


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
