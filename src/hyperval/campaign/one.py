"""One campaign: observe, predict, compare, judge."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace

from hyperval.campaign.collected import Collected, collected
from hyperval.campaign.job import Job, Waiting
from hyperval.campaign.pictures import quicklook, score_maps
from hyperval.campaign.provenance import record_of
from hyperval.campaign.references import missing_sets
from hyperval.campaign.scenario_notes import header_notes, truth_notes
from hyperval.campaign.schema import Outline
from hyperval.datasets import InputLog
from hyperval.errors import MissingDataError
from hyperval.observe import Observed
from hyperval.products import Prediction
from hyperval.progress import step
from hyperval.report import RunReport
from hyperval.report.power import accepted_table
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.results import Cause, Outcome, Result, ResultTable, of_campaign


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


def _report(side: Collected, predictions: Sequence[Prediction], show_progress: bool | None) -> RunReport:
    campaign, scenarios, observed = side.campaign, side.scenarios, side.observed
    prediction = None
    eigenvalues: dict[tuple[str, str], EigenvalueSpectrum] = {}
    tails: dict[str, TailCurve] = {}
    # What compares takes 30 MB: not before the imagery is done with.
    if predictions:
        from hyperval.campaign.curves import spread_curves
        from hyperval.campaign.predicted_side import predicted_side
        from hyperval.campaign.reasons import reasons

        prediction = predicted_side(side, predictions)
        rows = outcomes(side, prediction)
        rows += reasons(side, prediction, show_progress=show_progress)
        eigenvalues, tails = spread_curves(prediction, observed.observation)
    else:
        from hyperval.compare.one_side import product_rows

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


def outcomes(side: Collected, prediction: Prediction) -> list[Result]:
    """Every comparison of a campaign with its outcome.

    It needs no second look at the collection, so that it can be called for a prediction that was moved.

    Parameters
    ----------
    prediction : of :func:`hyperval.campaign.predicted_side.predicted_side`
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


def unfinished(job: Job | Waiting, outcome: Outcome, reason: str) -> RunReport:
    """The planned comparisons of a campaign that could not be made, each as a row."""
    campaign = job.campaign
    cause = Cause.NO_DATA if outcome is Outcome.SKIPPED else Cause.BROKEN
    rows = [
        gate.unmade(subject, outcome, cause, reason) for gate in campaign.comparisons for subject in gate.subjects
    ]
    return replace(
        report_of(campaign, rows),
        provenance=record_of(InputLog.of_file(job.path), [], None, {"campaign": campaign}, []),
        notes=[reason, *campaign.assumptions],
        references=campaign.references,
    )
