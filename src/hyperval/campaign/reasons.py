"""Why a campaign's two sides differ: its model asked again with inputs moved and what-ifs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from hyperval.campaign.collected import Collected
from hyperval.campaign.predicted_side import joined
from hyperval.observe import observe as observe_collection
from hyperval.predict import predictions
from hyperval.prediction.budget import given_of, inputs_of
from hyperval.prediction.departure import Departure, departs
from hyperval.processing.ace_model import NUMERICAL_DETECTORS
from hyperval.products import Prediction, Products
from hyperval.results import Result
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.uncertainty.attribution.assumed import assumed_inputs
from hyperval.uncertainty.attribution.residuals import few_objects
from hyperval.uncertainty.attribution.rows import attribution_rows
from hyperval.uncertainty.attribution.run import attribute
from hyperval.uncertainty.attribution.what_ifs import Model, Truth

# Draws of an object's score: the same numbers each time, so that differences are free of their scatter.
OBJECT_DRAWS = 1600


def reasons(side: Collected, prediction: Prediction, *, show_progress: bool | None = None) -> list[Result]:
    """Rows of the reasons, none where the campaign does not ask for them; ``prediction`` as it was compared."""
    if side.campaign.attribution is None:
        return []
    observation = side.observed.observation
    # Where every object is one pixel, the scores of pixels say the same.
    whole = any(few_objects(observation, subject, name) for subject, name in observation.object_scores)
    draws = OBJECT_DRAWS if whole else False

    def of_truths(scenario: Scenario, truths: Sequence[Departure]) -> Iterator[Prediction]:
        # Scores and false alarms of pixels and draws of objects are looked at, not curves of objects, and
        # not what takes draws of its own for each of a hundred truths.
        closed = [name for name in scenario.processing.detectors if name not in NUMERICAL_DETECTORS]
        processing = scenario.processing.model_copy(update={"detectors": closed})
        lighter = scenario.model_copy(update={"processing": processing}) if closed else scenario
        return predictions(
            lighter, truths, side.origins(scenario, show_progress), objects=draws, object_curves=False
        )

    as_stated: list[tuple[Scenario, Prediction]] = []  # predicted once, however often nothing is moved in it

    def still(scenario: Scenario) -> Prediction:
        known = next((p for s, p in as_stated if s is scenario), None)
        if known is None:
            known = next(of_truths(scenario, [Departure()]))
            as_stated.append((scenario, known))
        return known

    def moved_side(scenario: Scenario, truths: Sequence[Departure]) -> Iterator[Prediction]:
        moved = of_truths(scenario, [truth for truth in truths if departs(truth)])
        for truth in truths:
            yield next(moved) if departs(truth) else still(scenario)

    def predicted(scenarios: Sequence[Scenario], truths: Sequence[Truth]) -> Iterator[Products]:
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

    given = [given_of(scenario, side.origins(scenario, show_progress)) for scenario in side.scenarios]
    attribution = attribute(
        Model(side.scenarios, predicted, measured_again),
        observation,
        [inputs_of(g) for g in given],
        [assumed_inputs(g) for g in given],
        side.campaign.attribution,
        budgeted=prediction,
        show_progress=show_progress,
    )
    return attribution_rows(attribution)
