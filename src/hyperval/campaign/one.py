"""One campaign: observe, predict, compare, judge."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from hyperval.campaign.day_scenarios import scenarios_of
from hyperval.campaign.draft import Waiting, read_texts
from hyperval.campaign.header_check import scenario_notes
from hyperval.campaign.measured_fractions import with_measured_fractions
from hyperval.campaign.merge import merged, with_pools, without_circles
from hyperval.campaign.pictures import quicklook, score_maps
from hyperval.campaign.provenance import record_of
from hyperval.campaign.references import check_names, missing_sets
from hyperval.campaign.schema import Campaign, Outline
from hyperval.campaign.truth_check import truth_notes
from hyperval.campaign.truth_fills import with_fills_of_truth
from hyperval.datasets import InputLog
from hyperval.errors import MissingDataError, UsageError
from hyperval.files import scratch_folder
from hyperval.observe import Observed
from hyperval.observe import observe as observe_collection
from hyperval.observe.mixtures import RegionMixtures
from hyperval.prediction.departure import Departure
from hyperval.products import Abundance, Observation, Prediction
from hyperval.progress import step
from hyperval.report import RunReport
from hyperval.report.power import accepted_table
from hyperval.results import Cause, Outcome, Result, ResultTable, Role
from hyperval.scenario import Scenario

if TYPE_CHECKING:
    from hyperval.predict import Origins

SIMULATED = "simulated:"


@dataclass(frozen=True)
class Job:
    """A campaign that was read and checked, with the folder that its references are relative to."""

    campaign: Campaign
    path: Path

    @property
    def folder(self) -> Path:
        """Folder of the campaign file."""
        return self.path.resolve().parent


def jobs_of(path: Path, *, compares: bool = True) -> list[Job | Waiting]:
    """The campaigns of a file, one for each of its runs.

    ``compares``: there must be a scenario and a comparison, without which a collection can only be observed.

    A campaign with values that are still to be filled in waits where its collection is not public and no file of it
    is on this machine.

    Raises
    ------
    InputError : no such file.
    UsageError : mistakes, file names that no registry knows, or values still to be filled in of a campaign that
        could run.
    """
    out: list[Job | Waiting] = []
    for text in read_texts(path):
        check_names(Path(path), text.named.files)
        if compares:
            text.check_two_sides()
        if not text.named.to_fill_in:
            out.append(Job(text.campaign(), Path(path)))
            continue
        absent = text.absent()
        if absent is None:
            raise text.unfilled()
        out.append(Waiting(text.outline(), Path(path), *absent))
    return out


class Inputs:
    """Files of one campaign: resolved, recorded, simulated ones among them."""

    def __init__(self, folder: Path):
        self.log = InputLog(folder)
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


def run_campaign(
    job: Job | Waiting,
    *,
    predicts: bool = True,
    show_progress: bool | None = None,
    with_observed: Callable[[Observed], None] | None = None,
) -> RunReport:
    """Run one campaign; files it cannot find in a registered data set make it SKIPPED.

    ``with_observed`` is called while the files of the collection, simulated ones too, are still there.

    Raises
    ------
    HypervalError : anything else that the user can mend.
    """
    if isinstance(job, Waiting):
        return replace(unfinished(job, Outcome.SKIPPED, job.reason), remedy=job.remedy)
    try:
        with ExitStack() as stack:
            with step_of(job.campaign.name, "observe", predicts):
                side = stack.enter_context(collected(job, show_progress=show_progress))
                if with_observed is not None:
                    with_observed(side.observed)
            predictions = []
            if predicts:
                from hyperval.predict import predict

                with step_of(job.campaign.name, "predict"):
                    predictions = [
                        predict(scenario, side.origins(scenario, show_progress), objects=True)
                        for scenario in side.scenarios
                    ]
            with step_of(job.campaign.name, "compare" if predicts else "summarise", predicts):
                return _report(job, side, predictions, show_progress)
    except MissingDataError as error:
        if not predicts:  # nothing but the collection was asked for
            raise
        remedy = _every_set(job, error)
        reason = f"{error.where}: {error.what}\n  to mend it: {remedy}"
        return replace(unfinished(job, Outcome.SKIPPED, reason), remedy=remedy)


def step_of(campaign: str, what: str, predicts: bool = True) -> AbstractContextManager[None]:
    """Progress bars within say which campaign and which of its steps they belong to."""
    steps = ("observe", "predict", "compare", "report") if predicts else ("observe", "summarise", "report")
    return step(campaign, steps.index(what) + 1, len(steps), what)


@dataclass(frozen=True)
class Collected:
    """What a campaign's collection says, while its files, simulated ones too, are there."""

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
            observed.observation.axis, self._mixtures.statistics(scenario), self.resolver(scenario),
            show_progress=show_progress,
        )  # fmt: skip

    @cached_property
    def _mixtures(self) -> RegionMixtures:
        return RegionMixtures(self.observed)


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
    campaign, inputs = job.campaign, Inputs(job.folder)
    inputs.log.add(job.path.resolve(), job.path.name)
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
        yield Collected(inputs, scenarios, observed, seed)


def _every_set(job: Job, error: MissingDataError) -> str:
    """The command that fetches all sets the campaign lacks; of one that cannot be fetched how to get it."""
    files = next((t.named.files for t in read_texts(job.path) if t.outline().name == job.campaign.name), ())
    sets = missing_sets(files)
    return f"hyperval data fetch {' '.join(sets)}" if len(sets) > 1 else error.mend or ""


def _report(job: Job, side: Collected, predictions: Sequence[Prediction], show_progress: bool | None) -> RunReport:
    campaign, inputs, scenarios, observed = job.campaign, side.inputs, side.scenarios, side.observed
    prediction = None
    # What compares takes 30 MB: not before the imagery is done with.
    if predictions:
        from hyperval.campaign.curves import eigenvalue_spectra, tail_curves
        from hyperval.campaign.reasons import reasons

        prediction = predicted_side(job, side, predictions)
        rows = outcomes(prediction, observed.observation, campaign, scenarios)
        rows += reasons(
            campaign, scenarios, lambda s: side.origins(s, show_progress), observed, prediction, inputs.resolve,
            show_progress=show_progress,
        )  # fmt: skip
        table = ResultTable(rows)
    else:
        from hyperval.campaign.one_side import product_rows

        table = ResultTable(product_rows(campaign.name, observed.observation, "observed"))
    by_dirsig = ["the collection is imagery and truth that DIRSIG made"] if campaign.simulated == "dirsig" else []
    notes = [
        *by_dirsig,
        *campaign.assumptions,
        *observed.observation.notes,
        *scenario_notes(observed.place, scenarios),
    ]
    notes += truth_notes(observed.place, campaign.detection, scenarios)
    if prediction is not None:
        notes += prediction.notes
    return replace(
        report_of(campaign, table),
        prediction=prediction,
        observation=observed.observation,
        score_maps=score_maps(observed, campaign.detection, prediction.expected_scores if prediction else {}),
        quicklook=quicklook(observed),
        provenance=record_of(
            inputs.log,
            scenarios,
            side.seed,
            {"campaign": campaign.model_dump(mode="json", by_alias=True)},
            [observed.observation, *predictions],
        ),
        notes=list(dict.fromkeys(notes)),
        references=campaign.references,
        eigenvalues=eigenvalue_spectra(prediction, observed.observation) if prediction else {},
        tails=tail_curves(prediction, observed.observation) if prediction else {},
        chosen_after=campaign.every_choice(),
        power=accepted_table(campaign.name) if prediction else None,
        kind="Campaign" if prediction else "Collection of campaign",
    )


def report_of(campaign: Outline, table: ResultTable) -> RunReport:
    """What a campaign's file and its table alone say."""
    return RunReport(
        campaign=campaign.name,
        title=campaign.title,
        description=campaign.description,
        simulated=bool(campaign.simulated),
        computed=campaign.computed,
        table=table,
    )


def predicted_side(
    job: Job, side: Collected, predictions: Sequence[Prediction], truths: Sequence[Departure] | None = None
) -> Prediction:
    """The predictions of a campaign's scenarios as the one side that is compared.

    ``truths`` : how the truth departs from each scenario, that of the predictions; None: not at all.
    """
    from hyperval.campaign.derived import predicted_unmixing, with_errors_of_classes

    campaign, scenarios, observed = job.campaign, side.scenarios, side.observed
    whole = with_errors_of_classes(merged(predictions), campaign.classification, observed.observation)
    finders = [side.resolver(scenario) for scenario in scenarios]
    areas = predicted_unmixing(scenarios, predictions, finders, campaign.detection, observed, truths)
    nominal = observed.detected.nominal_area_m2 if observed.detected is not None else {}
    stated = {k: Abundance(v, 0.0, modelled=False) for k, v in nominal.items()}
    prediction = replace(without_circles(whole, scenarios, observed.place), abundance={**stated, **areas})
    if campaign.detection is None:
        return prediction
    return replace(prediction, roc=with_pools(prediction.roc, observed.observation, campaign.detection))


def outcomes(
    prediction: Prediction, observation: Observation, campaign: Campaign, scenarios: Sequence[Scenario] = ()
) -> list[Result]:
    """Every comparison of a campaign with its outcome.

    It needs no file and no second look at the collection, so that it can be called for a prediction that was moved.

    Parameters
    ----------
    prediction : of :func:`predicted_side`
    scenarios : name the engine in the rows
    """
    from hyperval.compare import compare_products, judged

    engine = "+".join(sorted({s.atmosphere.engine for s in scenarios if s.atmosphere})) or "statistics"
    rows = compare_products(
        prediction,
        observation,
        campaign=campaign.name,
        method=engine,
        equivalence_margin=campaign.equivalence_margin,
    )
    return judged(rows, campaign.comparisons, campaign.name)


def unfinished(job: Job | Waiting, outcome: Outcome, reason: str) -> RunReport:
    """The planned comparisons of a campaign that could not be made, each as a row."""
    campaign = job.campaign
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    rows = [
        Result(
            campaign.name, g.product, subject, g.method, g.metric, outcome=outcome,
            role=Role.GATE if g.gate else Role.INFORM, cause=cause, reason=reason,
        )
        for g in campaign.comparisons
        for subject in g.subjects
    ]  # fmt: skip
    log = InputLog(job.folder)
    log.add(job.path.resolve(), job.path.name)
    return replace(
        report_of(campaign, ResultTable(rows)),
        provenance=record_of(log, [], None, {"campaign": campaign.model_dump(mode="json", by_alias=True)}, []),
        notes=[reason, *campaign.assumptions],
        references=campaign.references,
    )


def _simulate(reference: str, inputs: Inputs, scratch: Path, show_progress: bool | None) -> int:
    from hyperval.simulate import load_scene, simulate
    from hyperval.simulate.inputs import load_inputs

    path = inputs.resolve(reference)
    scene = load_scene(path)
    simulate(scene, scratch, inputs=load_inputs(scene, path.parent), show_progress=show_progress)
    inputs.simulated = scratch
    return scene.seed
