"""The predictions of a campaign's scenarios as the one side of its comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from hyperval.campaign.collected import Collected
from hyperval.collection import Detection
from hyperval.errors import UsageError
from hyperval.observe.classification import class_sets
from hyperval.observe.place import Place
from hyperval.prediction.departure import Departure
from hyperval.prediction.inputs import Sources
from hyperval.prediction.unmixing import predicted_areas, predicted_classification
from hyperval.processing.roc import average_roc
from hyperval.products import Abundance, ClassificationError, Observation, Prediction, Products, RocCurve
from hyperval.scenario import Scenario


def predicted_side(
    side: Collected, predictions: Sequence[Prediction], truths: Sequence[Departure] | None = None
) -> Prediction:
    """What is compared: the predictions, and those that need to know how the campaign looks at its collection.

    These are the errors of its classifier and the areas by its unmixing.

    Parameters
    ----------
    truths : how the truth departs from each scenario, that of the predictions; None: not at all
    """
    detected = side.observed.detected
    nominal = detected.nominal_area_m2 if detected is not None else {}
    stated = {k: Abundance(v, 0.0, modelled=False) for k, v in nominal.items()}
    return replace(
        joined(side, side.scenarios, predictions),
        classification=_classification(side, merged(predictions)),
        abundance={**stated, **_areas(side, predictions, truths)},
    )


def joined(side: Collected, scenarios: Sequence[Scenario], predictions: Sequence[Prediction]) -> Prediction:
    """The predictions of scenarios in one, with the campaign's pools and without what came from its collection."""
    whole = without_circles(merged(predictions), scenarios, side.observed.place)
    if side.campaign.detection is None:
        return whole
    return replace(whole, roc=with_pools(whole.roc, side.observed.observation, side.campaign.detection))


def merged(predictions: Sequence[Prediction]) -> Prediction:
    """One prediction out of several scenarios on the same axis; no subject may stand in two of them."""
    first, *rest = predictions
    if not rest:
        return first
    parts: dict[str, Any] = {}
    for field in fields(Products):
        values = [getattr(p, field.name) for p in predictions]
        if not isinstance(values[0], Mapping) or field.name == "provenance":
            continue
        joined: dict[Any, Any] = {}
        for value in values:
            twice = sorted(str(k) for k in set(joined) & set(value))
            if twice:
                raise UsageError(f"two scenarios predict the {field.name} of {twice[0]}")
            joined.update(value)
        parts[field.name] = joined
    notes = tuple(dict.fromkeys(n for p in predictions for n in p.notes))
    return Prediction(
        axis=first.axis,
        **parts,
        notes=notes,
        provenance={"scenarios": [dict(p.provenance) for p in predictions]},
        expected_scores={key: score for p in predictions for key, score in p.expected_scores.items()},
    )


def without_circles(
    prediction: Prediction, scenarios: Sequence[Scenario], place: Place | None = None
) -> Prediction:
    """The prediction without what was taken from the collection it is compared with: that agrees whatever is wrong.

    A covariance that was measured on other pixels than those of its subject stays: one part of the scene predicts
    the other.  ``place`` tells the pixels; without it every measured covariance counts as the subject's own.
    """
    surfaces = [s for x in scenarios for s in (*x.scene.classes, *x.scene.panels, *x.scene.sites)]
    taken = {s.name for s in surfaces if s.spectrum.measured is not None}
    spread = {
        s.name
        for s in surfaces
        if s.covariance is not None
        and s.covariance.measured is not None
        and _shares_pixels(place, s.name, s.covariance.measured)
    }
    radiance, reflectance = (
        {k: replace(v, pixel_covariance=None) if k in spread else v for k, v in spectra.items() if k not in taken}
        for spectra in (prediction.radiance, prediction.reflectance)
    )
    fitted = {c.name for x in scenarios for c in x.scene.classes if c.tail_dof == "measured"}
    tails = {k: v for k, v in prediction.distribution.items() if k not in fitted}
    prediction = replace(prediction, radiance=radiance, reflectance=reflectance, distribution=tails)
    if not taken:
        return prediction
    note = f"not compared, as their statistics come from the collection itself: {', '.join(sorted(taken))}"
    return replace(prediction, notes=(*prediction.notes, note))


def _shares_pixels(place: Place | None, subject: str, region: str) -> bool:
    """Whether a subject's region has pixels of another one; taken to be so where it is not known."""
    if place is None or subject not in place.regions or region not in place.regions:
        return True
    return bool(np.any(place.regions[subject] & place.regions[region]))


def with_pools(
    predicted: Mapping[tuple[str, str, str], RocCurve], observation: Observation, detection: Detection
) -> dict[tuple[str, str, str], RocCurve]:
    """The predicted curves with those of the campaign's pools, averaged as the collection counts its targets."""
    out = dict(predicted)
    for pool in detection.pools:
        for name, detector, unit in observation.roc:
            keys = [(subject, detector, unit) for subject in pool.subjects]
            if name != pool.name or not all(key in predicted for key in keys):
                continue
            counts = [observation.roc[key].n_target or 0 for key in keys]
            out[name, detector, unit] = average_roc([predicted[key] for key in keys], counts)
    return out


def _classification(side: Collected, prediction: Prediction) -> Mapping[tuple[str, str], ClassificationError]:
    """The errors of the campaign's classifier, in the quantity of its image."""
    task = side.campaign.classification
    if task is None:
        return prediction.classification
    quantity = str(side.observed.observation.provenance.get("quantity", "radiance"))
    return predicted_classification(prediction, class_sets(task), task.features, quantity, task.seed)


def _areas(
    side: Collected, predictions: Sequence[Prediction], truths: Sequence[Departure] | None
) -> dict[tuple[str, str], Abundance]:
    """The areas that unmixing would find, by (subject, method); empty where the campaign does not unmix."""
    out: dict[tuple[str, str], Abundance] = {}
    unmixed, detection = side.observed.unmixed, side.campaign.detection
    if unmixed is None or detection is None or detection.unmixing is None:
        return out
    truths = truths or [Departure() for _ in side.scenarios]
    for scenario, prediction, truth in zip(side.scenarios, predictions, truths, strict=True):
        out |= predicted_areas(
            scenario,
            prediction,
            unmixed.subjects,
            unmixed.bands,
            unmixed.covariances,
            unmixed.pixel_area_m2,
            Sources(prediction.axis, side.observed.statistics, side.resolver(scenario)),
            draws=detection.unmixing.draws,
            seed=detection.unmixing.seed,
            departure=truth,
        )
    return out
