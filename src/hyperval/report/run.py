"""What a report is made from: one results table, the two sides, and where everything came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from hyperval.figures.spec import Quicklook, ScoreMap
from hyperval.products import ObservedProducts, PredictedProducts
from hyperval.results import Result, ResultTable

WARNING = "warning: "  # what a note that warns begins with


class PowerWords(NamedTuple):
    """Which injected errors a campaign's criteria detect, in words.

    Attributes
    ----------
    sentence : what a reader has to know before all
    errors : (error, what detects it, by name)
    version : of the program that injected them
    stale : why this is not of the present run; empty where it is
    reasons : how often the right cause of a drawn error is named, a line for each kind
    """

    sentence: str
    errors: Sequence[tuple[str, str, str]]
    version: str
    stale: str = ""
    reasons: Sequence[str] = ()


@dataclass(frozen=True)
class RunReport:
    """One campaign's run, ready to be written.

    Attributes
    ----------
    campaign, title, description : name (also of the output folder), heading, a sentence or two
    simulated : True when the collection is simulated; every page and figure then says so
    computed : True when the reference is what another program computed, and no imagery
    table : every planned comparison, one row each
    prediction, observation : the two sides, None where a side was not run
    score_maps : "TARGET-DETECTOR" -> map
    quicklook : picture of the scene
    provenance : ``inputs`` is a list of mappings with the keys reference, sha256, licence, citation; the other keys
        (versions, command, seed, formulation, ...) are shown as they are
    notes : assumptions made, what was left out
    references : literature
    chosen_after : (what, as it was before) of each range that was set after its data were seen
    deciding : inconclusive criteria, and what would decide each
    power : which standard errors the campaign would detect, None where that was not worked out
    remedy : how to get the collection of a run that was skipped for lack of it
    kind : what the page is: "Campaign" for both sides compared, else what it shows
    sentence : what the page says first where it compares something else than a model with a collection
    """

    campaign: str
    title: str
    description: str
    simulated: bool
    table: ResultTable
    prediction: PredictedProducts | None = None
    observation: ObservedProducts | None = None
    score_maps: Mapping[str, ScoreMap] = field(default_factory=dict)
    quicklook: Quicklook | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[str] = ()
    references: Sequence[str] = ()
    chosen_after: Sequence[tuple[str, str]] = ()
    deciding: Sequence[tuple[Result, str]] = ()
    power: PowerWords | None = None
    kind: str = "Campaign"
    sentence: str = ""
    computed: bool = False
    remedy: str = ""

    @property
    def warnings(self) -> list[str]:
        """Those of the notes that warn."""
        return [note for note in self.notes if note.startswith(WARNING)]
