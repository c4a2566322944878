"""Which rows of a run a baseline keeps: every planned one, and what stands behind it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

from hyperval.baseline.schema import key_of
from hyperval.results import Outcome, Result

# A planned row is often an absolute value or a verdict; these say which way and how far the two sides moved.
BEHIND: Mapping[str, tuple[str, ...]] = {
    "radiance": ("median_difference_ratio_*", "spectral_angle"),
    "toa_reflectance": ("median_difference_ratio_*", "spectral_angle", "fraction_inside_stated*"),
    "snr": ("median_difference_ratio_*",),
    "reflectance": ("median_difference_ratio_*", "spectral_angle"),
    "scores": ("score_mean_predicted", "score_mean_observed", "score_sd_ratio"),
    "roc": ("pd_predicted@*", "pd_measured@*"),
    "abundance": ("area_predicted", "area_observed", "area_ratio"),
}
_ORDER = (Outcome.ERROR, Outcome.DISAGREES, Outcome.SKIPPED, Outcome.UNDECIDED, Outcome.AGREES, Outcome.NONE)


@dataclass(frozen=True)
class Measured:
    """One number of a run: its value (NaN without one), half its 95 % interval, its outcome, and a reason."""

    value: float
    half_width: float | None = None
    outcome: Outcome = Outcome.NONE
    unit: str = "1"
    reason: str = ""


def campaign_metrics(rows: Iterable[Result]) -> dict[str, Measured]:
    """The numbers of one campaign that a baseline keeps, sorted by name.

    Every planned row that is not about a single band, whether it gates or informs, and for the subjects and
    methods of those the rows of :data:`BEHIND`.  Of a row that several gates cover the worst outcome counts.
    """
    whole = [row for row in rows if not row.per_band]
    planned = [row for row in whole if row.planned]
    subjects = {
        (r.product, pattern.strip(), r.method) for r in planned for pattern in (r.subject, *r.subject.split(","))
    }
    named = {row.product: BEHIND[row.product] for row in planned if row.product in BEHIND}
    behind = [
        row
        for row in whole
        if any(fnmatchcase(row.metric, m) for m in named.get(row.product, ()))
        and any(
            row.product == product and fnmatchcase(row.subject, subject) and fnmatchcase(row.method, method)
            for product, subject, method in subjects
        )
    ]
    metrics: dict[str, Measured] = {}
    for row in [*planned, *behind]:
        key = key_of(row.product, row.subject, row.method, row.metric)
        new = _measured(row)
        old = metrics.get(key)
        metrics[key] = new if old is None else replace(old, outcome=min(old.outcome, new.outcome, key=_ORDER.index))
    return dict(sorted(metrics.items()))


def skipped_reason(rows: Iterable[Result]) -> str | None:
    """Why a campaign as a whole was skipped, None when any of its rows was made."""
    rows = list(rows)
    if rows and all(row.outcome is Outcome.SKIPPED for row in rows):
        return rows[0].reason
    return None


def _measured(row: Result) -> Measured:
    half = (row.upper - row.lower) / 2.0
    known = math.isfinite(half) and half > 0
    return Measured(row.value, half if known else None, row.outcome, row.unit, row.reason)
