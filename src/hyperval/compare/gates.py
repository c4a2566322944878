"""What a campaign plans for rows: the range it would accept, whether that decides, and why."""

from __future__ import annotations

import math
from fnmatch import fnmatchcase
from typing import Literal

from pydantic import Field, model_validator

from hyperval.compare.rows import COMPARISON
from hyperval.config import Model
from hyperval.errors import UsageError
from hyperval.metrics import Kind, metric_of
from hyperval.results import Cause, Outcome, Result, Role

_CHI2_SLIP = 100.0


class Gate(Model):
    """One planned comparison.

    Attributes
    ----------
    product : product of the rows
    metric : metric, ``*`` and ``?`` allowed; "pd_difference" also stands for "pd_difference@1e-2"
    subjects : subject patterns; each must be met by at least one row
    method : method pattern
    bands_nm : lowest and highest band centre, for per-band metrics [nm]
    at_most, at_least, within : the accepted range; exactly one, save that a pooled gate on a 0/1 metric needs none
    fraction_at_least : makes it a pooled gate: this share of all matching rows must meet the limit, and one
        row of its own tells the share
    gate : False for rows that inform but do not decide
    chosen_after, before : True where the range was chosen after its own data were seen, and what it was before
    reason : why this is, or is not, a gate
    """

    product: Literal[
        "radiance", "snr", "reflectance", "toa_reflectance", "covariance", "classification", "scores", "roc",
        "abundance",
    ]  # fmt: skip
    metric: str = Field(
        min_length=1,
        description="as in results.csv (hyperval metrics lists them); * and ? allowed; without @P for every P",
    )
    subjects: tuple[str, ...] = Field(
        default=("*",), min_length=1, description="names or patterns with * and ?; each must be met by a row"
    )
    method: str = Field("*", description="name or pattern, such as cem/object")
    bands_nm: tuple[float, float] | None = Field(
        None, description="for metrics by band: band centres from, to [nm]"
    )
    at_most: float | None = Field(None, description="the accepted range: one of at_most, at_least, within")
    at_least: float | None = None
    within: tuple[float, float] | None = None
    fraction_at_least: float | None = Field(
        default=None,
        gt=0.0,
        le=1.0,
        description="share of all matching rows that must meet the limit, judged together",
    )
    gate: bool = Field(True, description="false: shown, and does not decide")
    chosen_after: bool = Field(
        False, description="true: chosen after the data of this campaign were seen; the report says so"
    )
    before: str = Field("", description="with chosen_after: what it was before")
    reason: str = Field(min_length=1, description="why the range, or why it does not decide")

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
        if self.chosen_after != bool(self.before):
            raise ValueError("chosen_after: true and 'before', what it was before, stand together")
        try:
            known = metric_of(self.metric)
        except UsageError as error:
            raise ValueError(" ".join(str(error).split())) from error
        low, high = known.low, known.high
        floor, ceiling = self.limits
        if floor <= low and ceiling >= high:
            raise ValueError(
                f"{self.metric} lies between {low:g} and {high:g}: {self.limit_text} can never fail"
                if math.isfinite(low)
                else f"{self.limit_text} can never fail"
            )
        # A ratio to the collected value may be larger than 1, but a limit of 100 % or more is a slip of the pen.
        relative = (known.agreement == 0.0 and "difference_ratio" in known.name) or known.name == "bias_ratio"
        if relative and max(abs(x) for x in (floor, ceiling) if math.isfinite(x)) >= 1.0:
            raise ValueError(f"{self.limit_text} on a ratio is 100 % or more: write 5 % as 0.05")
        if known.name.startswith("chi2_reduced") and _CHI2_SLIP <= ceiling < math.inf:
            raise ValueError(f"{self.limit_text} on a reduced chi-square accepts anything: expected about 1")
        if known.kind is Kind.TEST and self.at_least is None:
            raise ValueError(f"{self.metric} is a p-value: its level is 'at_least'")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest accepted value; a pooled gate without a limit wants 1."""
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

    @property
    def role(self) -> Role:
        """Whether its rows decide."""
        return Role.GATE if self.gate else Role.INFORM

    def unmade(self, subject: str, outcome: Outcome, cause: Cause, reason: str) -> Result:
        """The row of a planned comparison that was not made."""
        return Result(
            "", self.product, subject, self.method, self.metric, outcome=outcome, role=self.role, cause=cause,
            reason=reason,
        )  # fmt: skip

    def covers(self, row: Result) -> bool:
        """True for the rows this gate is about, and for skipped comparisons that would have held them."""
        return row.product == self.product and self.covers_band(row) and self.names(row)

    def covers_band(self, row: Result) -> bool:
        """Whether the band of a row, if it has one, is among those that the gate is about."""
        if self.bands_nm is None or row.metric == COMPARISON:
            return True
        return self.bands_nm[0] <= row.band_nm <= self.bands_nm[1]

    def names(self, row: Result) -> bool:
        """Whether product, subject, method and metric of a row are those that the gate names."""
        if row.product != self.product or not fnmatchcase(row.method, self.method):
            return False
        if not any(fnmatchcase(row.subject, pattern) for pattern in self.subjects):
            return False
        return row.metric == COMPARISON or any(
            fnmatchcase(name, self.metric) for name in (row.metric, row.metric.partition("@")[0])
        )
