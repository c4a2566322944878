"""What a campaign says of the search for reasons."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from hyperval.config import Model, Refusal, twice


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

    refused: ClassVar[Refusal] = {
        "give scenario or observe: a what-if changes something": lambda w: not w.scenario and not w.observe,
        "observe: {0!r} is in neither collection nor detection": lambda w: [
            path for path in w.observe if path.partition(".")[0] not in ("collection", "detection")
        ],
    }


class AttributionOptions(Model):
    """Which reasons are looked for where prediction and data disagree."""

    each: list[str] = Field(default_factory=list, description="subjects also ranked by themselves; * and ? allowed")
    what_ifs: list[WhatIf] = Field(default_factory=list)

    refused: ClassVar[Refusal] = {"two what-ifs are named {0!r}": lambda o: twice(w.name for w in o.what_ifs)}
