"""The file of one baseline: what was accepted, how far it may move, why, when, with what."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from hyperval.baseline.tolerances import looser_than_default, objection
from hyperval.config import Model, load_model
from hyperval.errors import reader
from hyperval.metrics.metric import Of
from hyperval.metrics.tolerances import Tolerance

Kind = Literal["campaign", "sensor"]
SEPARATOR = " | "


class Accepted(Model):
    """One accepted number; ``accepted`` is null where the comparison could not be made."""

    accepted: float | None = Field(description="the number, null where the comparison could not be made")
    tolerance: float = Field(description="how far it may move")
    of: Of = Field(description="what the tolerance is a part of: the value, half its 95 % interval, or its unit")
    half_width: float | None = Field(None, gt=0, description="half of the 95 % interval when it was accepted")
    outcome: Literal["agrees", "disagrees", "undecided", "skipped", "none"] = Field(
        "none", description="what the comparison concluded"
    )
    why: str | None = Field(None, min_length=1, description="needed where the tolerance is above the default")

    @property
    def limit(self) -> Tolerance:
        """The tolerance with what it is a part of."""
        return Tolerance(self.tolerance, self.of)

    @property
    def width(self) -> float:
        """Largest tolerated difference, in the metric's unit."""
        return self.limit.width(self.accepted or 0.0, self.half_width)


class Baseline(Model):
    """The accepted numbers of one campaign or sensor."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: Kind
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    reason: str = Field(min_length=1, description="why these numbers were accepted")
    date: str = Field(pattern=r"^\d{4}-\d{2}-\d{2}$", description="when they were last accepted")
    versions: dict[str, str] = Field(description="versions they were computed with")
    metrics: dict[str, Accepted] = Field(min_length=1, description='"product | subject | method | metric": number')

    @model_validator(mode="after")
    def _sound(self) -> Baseline:
        """Refuse tolerances that nothing can break, and those loosened without a word."""
        for key, item in self.metrics.items():
            metric = split_key(key)[-1]
            wrong = objection(metric, item.limit, item.accepted, item.half_width)
            if wrong:
                raise ValueError(f"{key}: {wrong}")
            if item.accepted is None or item.why is not None:
                continue
            if looser_than_default(metric, item.limit, item.accepted, item.half_width):
                raise ValueError(f"{key}: a tolerance above the default needs 'why'")
        return self


def key_of(product: str, subject: str, method: str, metric: str) -> str:
    """The name of a number in a baseline."""
    return SEPARATOR.join((product, subject, method, metric))


def split_key(key: str) -> tuple[str, str, str, str]:
    """Product, subject, method, metric of a name; ValueError when it is none."""
    product, first, rest = key.partition(SEPARATOR)
    parts = rest.rsplit(SEPARATOR, 2)
    if not first or len(parts) != 3:
        raise ValueError(f"{key!r} is not 'product | subject | method | metric'")
    return product, parts[0], parts[1], parts[2]


@reader
def load_baseline(path: Path) -> Baseline:
    """Read and check a baseline.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its line: a tolerance above 1 or that can never fail, one above the default
        without a reason, a candidate whose reason is still to be given.
    """
    return load_model(Baseline, path)
