"""What a campaign file says: the collection, the model of it, and what is to be compared."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from hyperval.collection import Collection, Detection
from hyperval.compare.gates import Gate
from hyperval.config import Model, load_model
from hyperval.scenario import Scenario


class Campaign(Model):
    """One campaign: a collection, a model of it, the comparisons."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9-]*$")
    title: str
    description: str
    simulated: bool = False
    references: list[str] = Field(default_factory=list)
    assumptions: list[str] = Field(default_factory=list, description="stated in the report")
    collection: Collection
    detection: Detection | None = None
    scenarios: list[Scenario | str] = Field(
        min_length=1, description="scenario files, built-in names or scenarios written out"
    )
    comparisons: list[Gate] = Field(min_length=1)

    @model_validator(mode="after")
    def _consistent(self) -> Campaign:
        if self.collection.simulate and not self.simulated:
            raise ValueError("a campaign with a simulated collection says 'simulated: true'")
        if self.detection and not self.collection.cube:
            raise ValueError("detection needs a cube")
        return self


def load_campaign(path: Path) -> Campaign:
    """Read and check a campaign file.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line.
    """
    return load_model(Campaign, path)
