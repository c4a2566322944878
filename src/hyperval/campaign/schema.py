"""What a campaign file says: the collection, the model of it, and what is to be compared."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from pydantic import Field, PrivateAttr, model_validator

from hyperval.campaign.day_scenarios import ScenarioSource
from hyperval.campaign.template import campaign_runs
from hyperval.collection import Classification, Collection, Detection
from hyperval.compare.gates import Gate
from hyperval.config import Model, load_yaml, validate
from hyperval.errors import UsageError, reader
from hyperval.uncertainty.attribution.schema import AttributionOptions


class Choice(Model):
    """A budget, a fit or a range that was chosen after the data of its own campaign were seen."""

    what: str = Field(min_length=1, description="what was chosen, and what it gave")
    before: str = Field(min_length=1, description="what it was before, and what that gave")


class Outline(Model):
    """What a campaign says of itself: enough to list what it would compare."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9-]*$")
    title: str
    description: str
    simulated: bool | Literal["dirsig"] = Field(
        False,
        description="true: by the scene that collection.simulate names; dirsig: by DIRSIG, whose files it reads",
    )
    references: list[str] = Field(default_factory=list)
    assumptions: list[str] = Field(default_factory=list, description="stated in the report")
    chosen_after: list[Choice] = Field(
        default_factory=list,
        description="choices made after the data were seen, save those of comparisons, which say so themselves",
    )
    comparisons: list[Gate] = Field(
        default_factory=list, description="what validate judges; observe alone needs none"
    )

    @property
    def computed(self) -> bool:
        """Whether the reference is what another program computed, and no imagery."""
        return False

    def every_choice(self) -> list[tuple[str, str]]:
        """What was chosen after the campaign's own data were seen, each with what it was before."""
        stated = [(choice.what, choice.before) for choice in self.chosen_after]
        return stated + [
            (f"{g.product} {g.metric} of {', '.join(g.subjects)}: {g.limit_text}", g.before)
            for g in self.comparisons
            if g.chosen_after
        ]


class Campaign(Outline):
    """One campaign: a collection, a model of it, the comparisons."""

    collection: Collection
    detection: Detection | None = None
    classification: Classification | None = None
    equivalence_margin: float | None = Field(
        None,
        gt=0,
        lt=1,
        description="difference of P_D that is no difference for the purpose; adds pd_equivalence rows",
    )
    scenarios: list[ScenarioSource] = Field(
        default_factory=list,
        description="scenario files, built-in names, scenarios written out, or those of a network's day; observe "
        "alone needs none",
    )

    attribution: AttributionOptions | None = Field(None, description="look for the reasons where the sides differ")

    _run: Mapping[str, str] = PrivateAttr(default_factory=dict)

    @property
    def run(self) -> Mapping[str, str]:
        """The words of this run that stand in braces in the campaign and its scenario files; often none."""
        return self._run

    @property
    def computed(self) -> bool:
        """Whether the reference is what a network computed from its own measurements."""
        return self.collection.radcalnet is not None

    @model_validator(mode="after")
    def _consistent(self) -> Campaign:
        if self.simulated == "dirsig" and (self.collection.simulate or not self.collection.cube):
            raise ValueError("simulated: dirsig reads DIRSIG's files: give collection.cube, and no simulate")
        if self.collection.simulate and not self.simulated:
            raise ValueError("a campaign with a simulated collection says 'simulated: true'")
        if self.detection and not self.collection.cube:
            raise ValueError("detection needs a cube")
        if self.collection.cube and self.collection.cube.by_number:
            if self.scenarios:
                raise ValueError("a prediction needs wavelengths: by_number is for a campaign without scenarios")
            if self.classification or (self.detection and self.detection.bands == "windows"):
                raise ValueError("by_number knows no windows of the atmosphere: detection.bands is good or all")
        if self.classification and not self.collection.cube:
            raise ValueError("classification needs a cube")
        return self


@reader
def load_campaigns(path: Path) -> list[Campaign]:
    """Read and check a campaign file; one campaign for each of its ``runs``, or one.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line, or every value that is still to be filled in.
    """
    data, lines = load_yaml(path)
    out = []
    for words, content in campaign_runs(data, lines, str(path)):
        campaign = validate(Campaign, content, lines, str(path))
        campaign._run = words
        out.append(campaign)
    return out


@reader
def load_campaign(path: Path) -> Campaign:
    """Read and check a campaign file of one run.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line; a file of several runs.
    """
    campaigns = load_campaigns(path)
    if len(campaigns) > 1:
        raise UsageError(
            f"the file holds {len(campaigns)} runs",
            where=str(path),
            expected="a campaign of one run",
            mend="copy it with one entry under 'runs'; hyperval validate takes all of them",
        )
    return campaigns[0]
