"""Predictions that need to know how the campaign looks at its collection: classes told apart, areas by unmixing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from hyperval.collection import Classification, Detection
from hyperval.observe import Observed
from hyperval.observe.classification import class_sets
from hyperval.prediction.departure import Departure
from hyperval.prediction.inputs import Sources
from hyperval.prediction.unmixing import predicted_areas, predicted_classification
from hyperval.products import Abundance, Observation, Prediction
from hyperval.scenario import Scenario


def with_errors_of_classes(
    prediction: Prediction, task: Classification | None, observation: Observation
) -> Prediction:
    """The prediction with the classification errors that the campaign asks for, in the quantity of its image."""
    if task is None:
        return prediction
    quantity = str(observation.provenance.get("quantity", "radiance"))
    errors = predicted_classification(prediction, class_sets(task), task.features, quantity, task.seed)
    return replace(prediction, classification=errors)


def predicted_unmixing(
    scenarios: Sequence[Scenario],
    predictions: Sequence[Prediction],
    resolvers: Sequence[Callable[[str], Path]],
    detection: Detection | None,
    observed: Observed,
    truths: Sequence[Departure] | None = None,
) -> dict[tuple[str, str], Abundance]:
    """The areas that unmixing would find, by (subject, method); empty where the campaign does not unmix.

    ``truths`` : how the truth departs from each scenario, that of the predictions; None: not at all.
    """
    out: dict[tuple[str, str], Abundance] = {}
    unmixed = observed.unmixed
    if unmixed is None or detection is None or detection.unmixing is None:
        return out
    truths = truths or [Departure() for _ in scenarios]
    for scenario, prediction, resolve, truth in zip(scenarios, predictions, resolvers, truths, strict=True):
        out |= predicted_areas(
            scenario,
            prediction,
            unmixed.subjects,
            unmixed.bands,
            unmixed.covariances,
            unmixed.pixel_area_m2,
            Sources(prediction.axis, observed.statistics, resolve),
            draws=detection.unmixing.draws,
            seed=detection.unmixing.seed,
            departure=truth,
        )
    return out
