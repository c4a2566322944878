"""Predicted over measured false alarms before and after an experiment, filter by filter."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from hyperval.compare.rows import scientific
from hyperval.processing.exceedance import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import Products, background_of

LEVELS = (1e-2, 1e-3)
FACTOR = 2.0  # a ratio within it is good


@dataclass(frozen=True)
class AlarmRatio:
    """P_FA predicted over measured at the threshold that was measured to give ``level``.

    Attributes
    ----------
    subject, detector, metric : as the rows of the comparison have them
    value : the ratio [1]
    lower, upper : its interval, that of the measured P_FA [1]
    """

    subject: str
    detector: str
    metric: str
    value: float
    lower: float
    upper: float

    @property
    def off(self) -> float:
        """|ln ratio|: by how much it is wrong, either way."""
        return abs(math.log(self.value)) if self.value > 0.0 else math.inf

    @property
    def good(self) -> bool:
        """Within a factor of two."""
        return self.off <= math.log(FACTOR)


def alarm_ratios(predicted: Products, observed: Products) -> dict[tuple[str, str, str], AlarmRatio]:
    """By (background, detector, metric), at P_FA 1e-2 and 1e-3 where ten alarms are expected."""
    ratios = {}
    for (name, detector), measured in observed.exceedance.items():
        model = predicted.exceedance.get((name, detector))
        for level in LEVELS if model is not None and (measured.n or 0) > 0 else ():
            if level * (measured.n or 0) >= LEAST_EXPECTED_ALARMS and model is not None:
                key = (background_of(name), detector, f"pfa_ratio@{scientific(level)}")
                ratio = false_alarm_ratio(model, measured, level)
                ratios[key] = AlarmRatio(*key, ratio.value, ratio.lower, ratio.upper)
    return ratios


def reason_for(before: AlarmRatio, tried: Iterable[tuple[str, AlarmRatio]]) -> str:
    """In words, which experiment explains a ratio that is off by more than a factor of two, or that none does.

    Examples
    --------
    >>> r = [AlarmRatio("b", "cem", "m", v, v / 2, v * 2) for v in (6.0, 1.5, 4.0)]
    >>> reason_for(r[0], [("local", r[1]), ("tails", r[2])])
    "off by a factor of 6; 'local' leaves 1.5: it would explain it"
    >>> reason_for(r[1], [("tails", r[2])])
    'within a factor of two'
    """
    if before.good:
        return "within a factor of two"
    size = f"off by a factor of {math.exp(before.off):.2g}"
    if before.lower <= FACTOR and before.upper >= 1.0 / FACTOR:
        size += ", within what the measured interval allows"
    best = min(tried, key=lambda item: item[1].off, default=None)
    if best is None or best[1].off >= before.off:
        return f"{size}; no what-if brings it nearer"
    end = "it would explain it" if best[1].good else "the nearest, and not enough"
    return f"{size}; {best[0]!r} leaves {best[1].value:.2g}: {end}"
