"""How far a number may move before it counts as another number.

Two machines, or two builds of the linear-algebra library, differ in the last digits; a change of the science moves
a number by more.  The defaults stand between the two (docs/regression.md has both as measured).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from hyperval.compare.gates import range_of

Of = Literal["value", "interval", "unit"]

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


# Kind of metric (a pattern that the whole name matches) -> default.  The first that fits counts.
DEFAULTS: tuple[tuple[str, Tolerance], ...] = (
    # Sensors: closed forms, so that only rounding differs between machines.
    (r"band_count", Tolerance(0.0, "unit")),
    (r"median_(snr|noise_\w+|bit_error_noise\S*)", Tolerance(0.002, "value")),
    (r"median_electrons_per_radiance|reference_radiance|white_panel_radiance", Tolerance(0.001, "value")),
    (r"pd_at_pfa_\S+", Tolerance(0.005, "unit")),
    # Campaigns.
    (r"p_value.*|.*_p_value", Tolerance(0.05, "unit")),
    (r".*_fraction|fraction_.*|objects_inside.*", Tolerance(0.02, "unit")),
    (r".*(inside|equivalent).*", Tolerance(0.0, "unit")),  # a verdict, 0 or 1
    (r"chi2.*", Tolerance(0.02, "value")),
    (r".*difference_ratio.*|bias_ratio", Tolerance(0.002, "unit")),
    # Counts: rounding can carry a pixel over a threshold.  0.8 of half of an exact 95 % interval is more
    # than one count of 5 or more: where all are found it is about 3.7 / n wide.
    (r"pd_(measured|difference).*|pfa_.*|error_(observed|difference).*", Tolerance(0.8, "interval")),
    (r"pd_.*", Tolerance(0.005, "unit")),
    (r".*auc.*", Tolerance(0.002, "unit")),
    (r"(.*_)?z", Tolerance(0.1, "unit")),  # counts standard uncertainties itself
    (r"area_.*|score_sd_ratio|spectral_angle", Tolerance(0.01, "value")),
)


def default_tolerance(metric: str, half_width: float | None = None) -> Tolerance:
    """The tolerance of a metric whose baseline does not name one."""
    for pattern, tolerance in DEFAULTS:
        if re.fullmatch(pattern, metric) and (half_width or tolerance.of != "interval"):
            return tolerance
    return Tolerance(0.1, "interval") if half_width else Tolerance(0.01, "value")


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
    low, high = range_of(metric)
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
