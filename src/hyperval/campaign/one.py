"""One campaign: observe, predict, compare, judge.

Why a campaign's two sides differ: its model asked again with inputs moved and what-ifs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from typing import Any

from hyperval.attribute import ScenarioModel, Truths, assumed_inputs, attribute, few_objects
from hyperval.campaign.job import Job, Waiting, missing_sets
from hyperval.campaign.pictures import quicklook, score_maps
from hyperval.campaign.provenance import record_of
from hyperval.campaign.schema import Outline
from hyperval.campaign.sides import Collected, collected, header_notes, joined, truth_notes
from hyperval.data import NUMERICAL_DETECTORS
from hyperval.datasets import InputLog
from hyperval.errors import MissingDataError
from hyperval.figures.sides import EigenvalueSpectrum, TailCurve
from hyperval.model import Truth, inputs_of, predictions, read
from hyperval.observe import Observed
from hyperval.observe import observe as observe_collection
from hyperval.products import PredictedProducts, Products
from hyperval.progress import step
from hyperval.report.run import RunReport, accepted_table
from hyperval.results import Cause, Outcome, Result, ResultTable, of_campaign
from hyperval.scenario import Scenario
from hyperval.settings import with_settings

# Draws of an object's score: the same numbers each time, so that differences are free of their scatter.
OBJECT_DRAWS = 1600


def reasons(side: Collected, prediction: PredictedProducts, *, show_progress: bool | None = None) -> list[Result]:
    """Rows of the reasons, none where the campaign does not ask for them; ``prediction`` as it was compared."""
    if side.campaign.attribution is None:
        return []
    observation = side.observed.observation
    # Where every object is one pixel, the scores of pixels say the same.
    whole = any(few_objects(observation, subject, name) for subject, name in observation.object_scores)
    draws = OBJECT_DRAWS if whole else False

    def of_truths(scenario: Scenario, truths: Sequence[Truth]) -> Iterator[PredictedProducts]:
        # Scores and false alarms of pixels and draws of objects are looked at, not curves of objects, and
        # not what takes draws of its own for each of a hundred truths.
        closed = [name for name in scenario.processing.detectors if name not in NUMERICAL_DETECTORS]
        processing = scenario.processing.model_copy(update={"detectors": closed})
        lighter = scenario.model_copy(update={"processing": processing}) if closed else scenario
        return predictions(lighter, truths, side.origins(scenario, show_progress), objects=draws, object_curves=False)

    as_stated: list[tuple[Scenario, PredictedProducts]] = []  # predicted once, however often nothing is moved in it

    def still(scenario: Scenario) -> PredictedProducts:
        known = next((p for s, p in as_stated if s is scenario), None)
        if known is None:
            known = next(of_truths(scenario, [{}]))
            as_stated.append((scenario, known))
        return known

    def moved_side(scenario: Scenario, truths: Sequence[Truth]) -> Iterator[PredictedProducts]:
        moved = of_truths(scenario, [truth for truth in truths if truth])
        for truth in truths:
            yield next(moved) if truth else still(scenario)

    def predicted(scenarios: Sequence[Scenario], truths: Sequence[Truths]) -> Iterator[Products]:
        sides = [moved_side(scenario, [truth[i] for truth in truths]) for i, scenario in enumerate(scenarios)]
        for parts in zip(*sides, strict=True):
            yield joined(side, scenarios, parts)

    def measured_again(changes: Mapping[str, Any]) -> Products:
        changed, detection = with_settings(side.campaign, changes), None
        if changed.detection is not None:  # no residual is an area
            detection = changed.detection.model_copy(update={"unmixing": None})
        before = side.observed.surfaces if changed.collection == side.campaign.collection else None
        return observe_collection(
            changed.collection, detection, side.inputs.resolve, before=before, show_progress=show_progress
        ).observation

    worlds = [read(scenario, side.origins(scenario, show_progress)) for scenario in side.scenarios]
    return attribute(
        ScenarioModel(side.scenarios, predicted, measured_again),
        observation,
        [inputs_of(world) for world in worlds],
        [assumed_inputs(world) for world in worlds],
        side.campaign.attribution,
        budgeted=prediction,
        show_progress=show_progress,
    )


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
                from hyperval.model import predict

                with step_of(job.campaign.name, "predict"):
                    predictions = [
                        predict(scenario, side.origins(scenario, show_progress), objects=True)
                        for scenario in side.scenarios
                    ]
            with step_of(job.campaign.name, "compare" if predicts else "summarise", predicts):
                return _report(side, predictions, show_progress)
    except MissingDataError as error:
        if not predicts:  # nothing but the collection was asked for
            raise
        sets = missing_sets(job.files)  # all that the campaign lacks, and not the first that was asked for
        remedy = f"hyperval data fetch {' '.join(sets)}" if len(sets) > 1 else error.mend or ""
        reason = f"{error.where}: {error.what}\n  to mend it: {remedy}"
        return replace(unfinished(job, Outcome.SKIPPED, reason), remedy=remedy)


def step_of(campaign: str, what: str, predicts: bool = True) -> AbstractContextManager[None]:
    """Progress bars within say which campaign and which of its steps they belong to."""
    steps = ("observe", "predict", "compare", "report") if predicts else ("observe", "summarise", "report")
    return step(campaign, steps.index(what) + 1, len(steps), what)


def _report(side: Collected, predictions: Sequence[PredictedProducts], show_progress: bool | None) -> RunReport:
    campaign, scenarios, observed = side.campaign, side.scenarios, side.observed
    prediction = None
    never: list[tuple[Result, str]] = []
    eigenvalues: dict[tuple[str, str], EigenvalueSpectrum] = {}
    tails: dict[str, TailCurve] = {}
    # What compares takes 30 MB: not before the imagery is done with.
    if predictions:
        from hyperval.campaign.sides import predicted_side, spread_curves

        prediction = predicted_side(side, predictions)
        rows = outcomes(side, prediction)
        never = never_met(rows, prediction, observed.observation)
        rows += reasons(side, prediction, show_progress=show_progress)
        eigenvalues, tails = spread_curves(prediction, observed.observation)
    else:
        from hyperval.compare.products import product_rows

        rows = product_rows(observed.observation, "observed")
    by_dirsig = ["the collection is imagery and truth that DIRSIG made"] if campaign.simulated == "dirsig" else []
    notes = [
        *by_dirsig,
        *campaign.assumptions,
        *observed.observation.notes,
        *header_notes(observed.place, scenarios),
        *truth_notes(observed.place, campaign.detection, scenarios),
    ]
    if prediction is not None:
        notes += prediction.notes
    return replace(
        report_of(campaign, rows),
        prediction=prediction,
        observation=observed.observation,
        score_maps=score_maps(observed, campaign.detection, prediction.expected_scores if prediction else {}),
        quicklook=quicklook(observed),
        provenance=record_of(
            side.inputs.log,
            scenarios,
            side.seed,
            {"campaign": campaign},
            [observed.observation, *predictions],
        ),
        notes=list(dict.fromkeys(notes)),
        references=campaign.references,
        eigenvalues=eigenvalues,
        tails=tails,
        chosen_after=campaign.every_choice(),
        never_met=never,
        power=accepted_table(campaign.name) if prediction else None,
        kind="Campaign" if prediction else "Collection of campaign",
    )


def report_of(campaign: Outline, rows: Iterable[Result]) -> RunReport:
    """What a campaign's file and its rows alone say."""
    return RunReport(
        campaign=campaign.name,
        title=campaign.title,
        description=campaign.description,
        simulated=bool(campaign.simulated),
        computed=campaign.computed,
        table=ResultTable(of_campaign(rows, campaign.name)),
    )


def outcomes(side: Collected, prediction: PredictedProducts) -> list[Result]:
    """Every comparison of a campaign with its outcome.

    It needs no second look at the collection, so that it can be called for a prediction that was moved.

    Parameters
    ----------
    prediction : of :func:`hyperval.campaign.sides.predicted_side`
    """
    from hyperval.compare import compare_products, judged

    engines = {s.atmosphere.engine for s in side.scenarios if s.atmosphere}
    rows = compare_products(
        prediction,
        side.observed.observation,
        method="+".join(sorted(engines)) or "statistics",
        equivalence_margin=side.campaign.equivalence_margin,
    )
    return judged(rows, side.campaign.comparisons)


def never_met(rows: Iterable[Result], prediction: Products, observation: Products) -> list[tuple[Result, str]]:
    """The criteria that can never be met, each with what would have to be known better for it."""
    from hyperval.compare.spectra import would_take

    return [(row, would_take(row, prediction, observation)) for row in rows if row.never_met]


def unfinished(job: Job | Waiting, outcome: Outcome, reason: str) -> RunReport:
    """The planned comparisons of a campaign that could not be made, each as a row."""
    campaign = job.campaign
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    rows = [gate.unmade(subject, outcome, cause, reason) for gate in campaign.comparisons for subject in gate.subjects]
    return replace(
        report_of(campaign, rows),
        provenance=record_of(InputLog.of_file(job.path), [], None, {"campaign": campaign}, []),
        notes=[reason, *campaign.assumptions],
        references=campaign.references,
    )
