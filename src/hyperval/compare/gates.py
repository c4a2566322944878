"""Gates: which rows decide pass or fail, and at what value."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Literal

from pydantic import Field, model_validator

from hyperval.compare.rows import COMPARISON
from hyperval.config import Model
from hyperval.processing.intervals import clopper_pearson
from hyperval.results import Result, Status

# Metrics that cannot leave a range: a limit on or beyond its end can never fail.
_UNIT_RANGE = (
    "p_value", "pd_", "fraction_inside_95", "objects_inside_95", "object_score_pit", "object_score_inside",
    "pit_uniformity", "area_inside",
    "area_in_predicted", "eigenvalues_inside", "subspace_inside", "normality_p_value", "error_predicted",
    "error_observed", "error_inside", "error_approximation", "error_bounds", "auc_", "partial_auc_", "log_auc_",
    "joint_",
)  # fmt: skip
_SIGNED_UNIT_RANGE = (
    "pd_difference",
    "pd_equivalence",
    "auc_difference",
    "partial_auc_difference",
    "log_auc_difference",
    "error_difference",
)
_POSITIVE = (
    "eigenvalue_ratio", "total_variance_ratio", "bhattacharyya_distance", "distance_", "background_tail_dof",
    "area_rmse", "effective_pixels",
)  # fmt: skip
# A ratio may be larger than 1, but a limit of 1 (100 %) or more is a slip of the pen.
_RATIO = ("difference_ratio", "bias_ratio")
_CHI2_SLIP = 100.0
_NAMED = 6  # rows that a message lists


class Gate(Model):
    """One planned verdict.

    Attributes
    ----------
    product : product of the rows
    metric : metric, ``*`` and ``?`` allowed; "pd_inside_interval" also stands for "pd_inside_interval@1e-2"
    subjects : subject patterns; each must be met by at least one row
    method : method pattern
    bands_nm : lowest and highest band centre, for per-band metrics [nm]
    at_most, at_least, within : the limit on the value; exactly one, save that a pooled gate on a 0/1 metric
        needs none
    fraction_at_least : makes it a pooled gate: this share of all matching rows must meet the limit, and one
        row of its own tells the share
    gate : False for rows that inform but do not decide
    reason : why this is, or is not, a gate
    """

    product: Literal["radiance", "snr", "reflectance", "covariance", "classification", "scores", "roc", "abundance"]
    metric: str = Field(
        min_length=1,
        description="as in results.csv (docs/campaigns.md lists them); * and ? allowed; without @P for every P",
    )
    subjects: tuple[str, ...] = Field(
        default=("*",), min_length=1, description="names or patterns with * and ?; each must be met by a row"
    )
    method: str = Field("*", description="name or pattern, such as cem/object")
    bands_nm: tuple[float, float] | None = Field(
        None, description="for metrics by band: band centres from, to [nm]"
    )
    at_most: float | None = Field(None, description="the limit: one of at_most, at_least, within")
    at_least: float | None = None
    within: tuple[float, float] | None = None
    fraction_at_least: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="share of all matching rows that must meet the limit, judged together",
    )
    gate: bool = Field(True, description="false: informs, and does not decide")
    reason: str = Field(min_length=1, description="why the limit, or why it does not decide")

    @model_validator(mode="after")
    def _can_fail(self) -> Gate:
        """Refuse gates without a limit, and limits that no value can break."""
        given = [name for name in ("at_most", "at_least", "within") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"one limit only, got {' and '.join(given)}")
        if not given and self.fraction_at_least is None:
            raise ValueError("a limit is missing: at_most, at_least or within")
        if self.within is not None and not self.within[0] < self.within[1]:
            raise ValueError(f"within [{self.within[0]:g}, {self.within[1]:g}] holds no range")
        if self.bands_nm is not None and not self.bands_nm[0] < self.bands_nm[1]:
            raise ValueError(f"bands_nm [{self.bands_nm[0]:g}, {self.bands_nm[1]:g}] holds no range")
        low, high = range_of(self.metric)
        floor, ceiling = self.limits
        if floor <= low and ceiling >= high:
            raise ValueError(
                f"{self.metric} lies between {low:g} and {high:g}: {self.limit_text} can never fail"
                if math.isfinite(low)
                else f"{self.limit_text} can never fail"
            )
        if _starts(self.metric, _RATIO) and max(abs(x) for x in (floor, ceiling) if math.isfinite(x)) >= 1.0:
            raise ValueError(f"{self.limit_text} on a ratio is 100 % or more: write 5 % as 0.05")
        if (
            self.metric.startswith("chi2_reduced")
            and self.limits[1] >= _CHI2_SLIP
            and math.isfinite(self.limits[1])
        ):
            raise ValueError(f"{self.limit_text} on a reduced chi-square accepts anything: expected about 1")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest value that passes; a pooled gate without a limit wants 1."""
        if self.within is not None:
            return self.within
        if self.at_most is not None:
            return -math.inf, self.at_most
        return (self.at_least if self.at_least is not None else 1.0), math.inf

    @property
    def limit_text(self) -> str:
        """The limit in words."""
        low, high = self.limits
        if self.within is not None:
            return f"within {low:g} to {high:g}"
        return f"at most {high:g}" if self.at_most is not None else f"at least {low:g}"

    def covers(self, row: Result) -> bool:
        """True for the rows this gate is about, and for SKIPPED comparisons that would have held them."""
        if row.product != self.product or not fnmatchcase(row.method, self.method):
            return False
        if not any(fnmatchcase(row.subject, pattern) for pattern in self.subjects):
            return False
        if row.metric == COMPARISON:
            return True
        if self.bands_nm is not None and not self.bands_nm[0] <= row.band_nm <= self.bands_nm[1]:
            return False
        return any(fnmatchcase(name, self.metric) for name in (row.metric, row.metric.partition("@")[0]))


@dataclass(frozen=True)
class _Verdict:
    status: Status
    threshold: float
    why: str


def apply_gates(rows: Iterable[Result], gates: Sequence[Gate], campaign: str = "") -> list[Result]:
    """The rows with every gate applied: each gated row gets its threshold and PASS, FAIL or ERROR.

    Call it once, on all rows of a campaign.  A row that several gates cover stands once for each.
    A value of NaN, a SKIPPED row, or a value outside its own interval is an ERROR under a gate, never a PASS.
    ``gate: false`` leaves rows INFO (or SKIPPED) with a note whether they would pass.  A subject pattern that no
    row meets gives an ERROR row, for ``gate: false`` too: nothing planned goes missing.
    A pooled gate adds a row METRIC_fraction with the share, its Clopper-Pearson interval and the verdict;
    rows without a value count as outside.

    Parameters
    ----------
    campaign : name for rows that stand for no comparison; taken from the first row when empty
    """
    rows = list(rows)
    campaign = campaign or (rows[0].campaign if rows else "")
    single = [g for g in gates if g.fraction_at_least is None]
    out: list[Result] = []
    for row in rows:
        covering = [g for g in single if g.covers(row)]
        out += [_judged(row, g) for g in covering] if covering else [row]
    for gate in gates:
        out += _unmet(rows, gate, campaign)
        if gate.fraction_at_least is not None:
            out += _pooled(rows, gate, campaign)
    return out


def _verdict(row: Result, gate: Gate) -> _Verdict:
    """Judge one value against one limit."""
    low, high = gate.limits
    threshold = high if abs(row.value - high) <= abs(row.value - low) else low
    if not math.isfinite(threshold):
        threshold = low if math.isfinite(low) else high
    if row.status is Status.SKIPPED:
        return _Verdict(Status.ERROR, threshold, f"a gated comparison was skipped: {row.reason}")
    if row.status is Status.ERROR:
        return _Verdict(Status.ERROR, threshold, row.reason)
    if math.isnan(row.value):
        return _Verdict(Status.ERROR, threshold, "the value is not a number")
    if row.lower > row.upper:
        return _Verdict(Status.ERROR, threshold, f"the interval {row.lower:g} to {row.upper:g} is inverted")
    slack = 1e-9 * max(1.0, abs(row.value))
    if row.value < row.lower - slack or row.value > row.upper + slack:
        return _Verdict(
            Status.ERROR, threshold, f"the value lies outside its interval {row.lower:g} to {row.upper:g}"
        )
    if low <= row.value <= high:
        return _Verdict(Status.PASS, threshold, "")
    return _Verdict(Status.FAIL, threshold, f"{row.value:.4g} is not {gate.limit_text}")


def _judged(row: Result, gate: Gate) -> Result:
    verdict = _verdict(row, gate)
    if gate.gate:
        return replace(
            row,
            status=verdict.status,
            threshold=verdict.threshold,
            reason=_joined(verdict.why, row.reason if row.reason not in verdict.why else "", gate.reason),
        )
    if row.status is Status.SKIPPED:
        return replace(row, reason=_joined(row.reason, f"informs only: {gate.reason}"))
    would = {
        Status.PASS: f"would pass {gate.limit_text}",
        Status.FAIL: f"would not pass {gate.limit_text}",
    }.get(verdict.status, f"would be an error: {verdict.why}")
    return replace(
        row, threshold=verdict.threshold, reason=_joined(would, row.reason, f"informs only: {gate.reason}")
    )


def _unmet(rows: Sequence[Result], gate: Gate, campaign: str) -> list[Result]:
    """An ERROR row for every subject pattern of the gate that no row meets."""
    out = []
    for pattern in gate.subjects:
        alone = gate.model_copy(update={"subjects": (pattern,)})
        if not any(alone.covers(row) for row in rows):
            reason = f"planned but absent: no {gate.product} row of subject {pattern!r} has metric {gate.metric!r}"
            if gate.method != "*":
                reason += f" and method {gate.method!r}"
            reason += _nearest(rows, alone)
            out.append(
                Result(
                    campaign, gate.product, pattern, gate.method, gate.metric, status=Status.ERROR, reason=reason
                )
            )
    return out


def _nearest(rows: Sequence[Result], gate: Gate) -> str:
    """What comes near to what a gate names: subjects with that metric, else metrics of that name."""
    own = [row for row in rows if row.product == gate.product and row.metric != COMPARISON]
    anywhere = gate.model_copy(update={"subjects": ("*",), "method": "*", "bands_nm": None})
    held = list(dict.fromkeys(f"{row.subject!r} ({row.method})" for row in own if anywhere.covers(row)))
    if held:
        return "; rows with it: " + ", ".join(held[:_NAMED]) + (", ..." if len(held) > _NAMED else "")
    near = difflib.get_close_matches(gate.metric, sorted({row.metric for row in own}), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _pooled(rows: Sequence[Result], gate: Gate, campaign: str) -> list[Result]:
    """The row of a pooled gate; none when no row matches, as :func:`_unmet` reports that."""
    matched = [row for row in rows if gate.covers(row)]
    if not matched or gate.fraction_at_least is None:
        return []
    verdicts = [_verdict(row, gate) for row in matched]
    outside = [row for row, v in zip(matched, verdicts, strict=True) if v.status is not Status.PASS]
    n, good = len(matched), len(matched) - len(outside)
    lower, upper = clopper_pearson(good, n)
    passed = good / n >= gate.fraction_at_least - 1e-12
    shown = ", ".join(_named(row) for row in outside[:5]) + (
        f" and {len(outside) - 5} more" if len(outside) > 5 else ""
    )
    blank = sum(v.status is Status.ERROR for v in verdicts)
    what = f"{good} of {n} rows {gate.limit_text}" + (f", {blank} without a verdict of their own" if blank else "")
    what += f"; outside: {shown}" if outside else ""
    would = "" if gate.gate else f"would {'' if passed else 'not '}pass at least {gate.fraction_at_least:g}"
    return [
        Result(
            campaign=campaign,
            product=gate.product,
            subject=", ".join(gate.subjects),
            method=gate.method,
            metric=f"{gate.metric}_fraction",
            value=good / n,
            lower=float(lower),
            upper=float(upper),
            n=n,
            threshold=gate.fraction_at_least,
            status=(Status.PASS if passed else Status.FAIL) if gate.gate else Status.INFO,
            reason=_joined(what, would, gate.reason if gate.gate else f"informs only: {gate.reason}"),
        )
    ]


def _named(row: Result) -> str:
    name = row.subject if row.metric == COMPARISON else f"{row.subject} {row.metric}"
    return f"{name} {row.band_nm:g} nm" if math.isfinite(row.band_nm) else name


def _joined(*parts: str) -> str:
    return "; ".join(dict.fromkeys(p for p in parts if p))


def _starts(metric: str, names: Sequence[str]) -> bool:
    return any(name in metric for name in names)


def range_of(metric: str) -> tuple[float, float]:
    """The least and greatest value that a metric can take; infinite where it has no such end."""
    if any(metric.startswith(name) for name in _SIGNED_UNIT_RANGE):
        return -1.0, 1.0
    if any(metric.startswith(name) for name in _UNIT_RANGE):
        return 0.0, 1.0
    if metric.startswith(("spectral_angle", "subspace_angle")):
        return 0.0, 90.0  # spectra are not negative, and spaces have no sign
    if metric.startswith(("median_abs", "max_abs", "chi2_reduced", *_POSITIVE)):
        return 0.0, math.inf
    return -math.inf, math.inf
