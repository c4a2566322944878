"""The collection of a campaign: its files resolved, simulated where it is, and observed once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from hyperval.campaign.day_scenarios import scenarios_of
from hyperval.campaign.job import Job
from hyperval.campaign.measured_scenes import with_fills_of_truth, with_measured_fractions
from hyperval.campaign.references import SIMULATED
from hyperval.campaign.schema import Campaign
from hyperval.datasets import InputLog
from hyperval.errors import UsageError
from hyperval.files import scratch_folder
from hyperval.observe import Observed
from hyperval.observe import observe as observe_collection
from hyperval.observe.mixtures import RegionLaws
from hyperval.scenario import Scenario

if TYPE_CHECKING:
    from hyperval.predict import Origins
    from hyperval.prediction.inputs import Read


class Inputs:
    """Files of one campaign: resolved, recorded, simulated ones among them."""

    def __init__(self, path: Path):
        self.log = InputLog.of_file(path)
        self.simulated: Path | None = None
        self._seen: set[Path] = set()

    def resolve(self, reference: str) -> Path:
        """The path of a reference; ``simulated:NAME`` is a file of the simulated collection."""
        if reference.startswith(SIMULATED):
            if self.simulated is None:
                raise UsageError(f"{reference!r}: this campaign simulates nothing", mend="set collection.simulate")
            path = self.log.add(self.simulated / Path(reference.removeprefix(SIMULATED)).name, reference)
        else:
            path = self.log.resolve(reference)
        self._seen.add(path.resolve())
        return path

    def record_beside(self, paths: Sequence[Path]) -> None:
        """Record files that were read beside those that were named, such as a cube's header."""
        for path in paths:
            if path.resolve() in self._seen:
                continue
            simulated = self.simulated is not None and path.is_relative_to(self.simulated)
            self.log.add(path, f"{SIMULATED}{path.name}" if simulated else None)


@dataclass(frozen=True)
class Collected:
    """A campaign and what its collection says, while the files, simulated ones too, are there."""

    campaign: Campaign
    inputs: Inputs
    scenarios: Sequence[Scenario]
    observed: Observed
    seed: int | None

    def resolver(self, scenario: Scenario) -> Callable[[str], Path]:
        """Finds the files that a scenario names, and records them with the campaign's.

        References of a scenario are relative to its own file.
        """
        folder, inputs = scenario.folder, self.inputs

        def resolve(reference: str) -> Path:
            if reference.startswith((SIMULATED, "data:")) or folder is None or folder == inputs.log.base:
                return inputs.resolve(reference)
            return inputs.log.add(InputLog(folder).resolve(reference))

        return resolve

    def origins(self, scenario: Scenario, show_progress: bool | None) -> Origins:
        """What the prediction of a scenario takes from the collection: bands, measured statistics, files."""
        observed = self.observed
        from hyperval.predict import Origins

        return Origins(
            observed.observation.axis, self._laws.statistics(scenario), self.resolver(scenario),
            show_progress=show_progress, left_out=lambda: self._laws.left_out(scenario), read=self._read,
        )  # fmt: skip

    @cached_property
    def _read(self) -> Read:
        return {}

    @cached_property
    def _laws(self) -> RegionLaws:
        return RegionLaws(self.observed)


@contextmanager
def collected(
    job: Job,
    *,
    question: Callable[[Sequence[Scenario], Inputs], Campaign] | None = None,
    show_progress: bool | None = None,
) -> Iterator[Collected]:
    """Read the scenarios of a campaign, simulate its collection where it is simulated, and observe it once.

    Parameters
    ----------
    question : the campaign to observe in place of the job's, once its files are there

    Raises
    ------
    MissingDataError : files of a registered data set that are not on this machine.
    HypervalError : anything else that the user can mend.
    """
    campaign, inputs = job.campaign, Inputs(job.path)
    with ExitStack() as stack:
        scenarios = [
            one
            for s in campaign.scenarios
            for one in scenarios_of(s, inputs.resolve, inputs.log.base, campaign.run)
        ]
        seed = None
        if campaign.collection.simulate:
            scratch = stack.enter_context(scratch_folder("simulated"))
            seed = _simulate(campaign.collection.simulate, inputs, scratch, show_progress)
        if question is not None:
            campaign = question(scenarios, inputs)
        observed = observe_collection(
            campaign.collection,
            campaign.detection,
            inputs.resolve,
            classification=campaign.classification,
            show_progress=show_progress,
        )
        if observed.place is not None:
            inputs.record_beside(observed.place.source_files)
        scenarios = [with_measured_fractions(scenario, observed.place) for scenario in scenarios]
        scenarios = with_fills_of_truth(scenarios, observed.place, campaign.detection)
        yield Collected(campaign, inputs, scenarios, observed, seed)


def _simulate(reference: str, inputs: Inputs, scratch: Path, show_progress: bool | None) -> int:
    from hyperval.simulate import load_scene, simulate
    from hyperval.simulate.inputs import load_inputs

    path = inputs.resolve(reference)
    scene = load_scene(path)
    simulate(scene, scratch, inputs=load_inputs(scene, path.parent), show_progress=show_progress)
    inputs.simulated = scratch
    return scene.seed
