"""Predictions of a campaign's scenarios as one side of its comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from hyperval.collection import Detection
from hyperval.errors import UsageError
from hyperval.observe.place import Place
from hyperval.processing.roc import average_roc
from hyperval.products import Observation, Prediction, Products, RocCurve
from hyperval.scenario import Scenario


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
