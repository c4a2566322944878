"""What a campaign says of the search for reasons."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from hyperval.config import Model


class WhatIf(Model):
    """A named experiment: the same comparison with something assumed otherwise."""

    name: str = Field(min_length=1)
    question: str = Field(min_length=1, description="the question that the experiment answers, for the report")
    scenario: dict[str, Any] = Field(
        default_factory=dict, description="dotted path -> value, in every scenario that has this path"
    )
    observe: dict[str, Any] = Field(
        default_factory=dict,
        description="dotted path -> value below 'collection' or 'detection': the collection is measured again",
    )

    @model_validator(mode="after")
    def _changes_something(self) -> WhatIf:
        if not self.scenario and not self.observe:
            raise ValueError("give scenario or observe: a what-if changes something")
        for path in self.observe:
            if path.split(".")[0] not in ("collection", "detection"):
                raise ValueError(f"observe: {path!r} is in neither collection nor detection")
        return self


class AttributionOptions(Model):
    """Which reasons are looked for where prediction and data disagree."""

    each: list[str] = Field(default_factory=list, description="subjects also ranked by themselves; * and ? allowed")
    what_ifs: list[WhatIf] = Field(default_factory=list)

    @model_validator(mode="after")
    def _names_differ(self) -> AttributionOptions:
        names = [w.name for w in self.what_ifs]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise ValueError(f"two what-ifs are named {twice[0]!r}")
        return self
