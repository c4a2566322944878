"""All products of one comparison: every subject that either side names."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from hyperval.compare.abundance import compare_abundance, compare_area_errors
from hyperval.compare.classification import compare_classification
from hyperval.compare.covariance import compare_covariance, compare_distribution
from hyperval.compare.objects import compare_object_scores
from hyperval.compare.roc import compare_roc
from hyperval.compare.scores import compare_exceedance, compare_scores
from hyperval.compare.spectral import compare_spectra
from hyperval.errors import UsageError
from hyperval.products import SPECTRA, Prediction, Products
from hyperval.results import Result

# Quantities in which pixels of a class spread.
SPREAD = ("radiance", "reflectance")
MOST_NAMED = 6

K = TypeVar("K")


def compare_products(
    predicted: Products,
    observed: Products,
    *,
    method: str = "model",
    equivalence_margin: float | None = None,
) -> list[Result]:
    """Rows of every product and subject that at least one side holds, in a fixed order.

    A subject that one side lacks gives a SKIPPED row, so that nothing planned is missing.  ``method`` names
    the way of the spectral products; for covariances it is the quantity, for classification the features, for
    scores and abundance the detector, for ROC "detector/unit".

    Raises
    ------
    UsageError : the two sides are not on the same bands.
    """
    if not predicted.axis.matches(observed.axis):
        raise UsageError(
            f"prediction ({len(predicted.axis)} bands) and observation ({len(observed.axis)} bands) "
            "are not on the same spectral axis",
            mend="predict on the axis of the collection",
        )
    rows: list[Result] = []
    for product in SPECTRA:
        for subject, left, right in _pairs(getattr(predicted, product), getattr(observed, product)):
            rows += compare_spectra(
                left, right, product=product, subject=subject, method=method, axis=observed.axis
            )  # fmt: skip
    rows += _covariance_rows(predicted, observed)
    for (subject, features), left, right in _pairs(predicted.classification, observed.classification):
        rows += compare_classification(left, right, subject=subject, method=features)
    for (subject, detector), left, right in _pairs(predicted.scores, observed.scores):
        rows += compare_scores(left, right, subject=subject, method=detector)
    for detector in dict.fromkeys(detector for _, detector in predicted.object_scores):
        left, right = (
            {s: v for (s, d), v in p.object_scores.items() if d == detector} for p in (predicted, observed)
        )
        rows += compare_object_scores(left, right, method=detector)
    for (subject, detector), curve in predicted.exceedance.items():
        measured = observed.exceedance.get((subject, detector))
        rows += compare_exceedance(curve, measured, subject=subject, method=detector)
    for (subject, detector, unit), left, right in _pairs(predicted.roc, observed.roc):
        made = compare_roc(
            left, right, subject=subject, method=f"{detector}/{unit}", equivalence_margin=equivalence_margin
        )  # fmt: skip
        lacking = predicted if left is None else observed if right is None else None
        if lacking is not None:
            made = [replace(row, reason=f"{row.reason}{_alternatives(lacking, subject)}") for row in made]
        rows += made
    for (subject, detector), left, right in _pairs(predicted.abundance, observed.abundance):
        rows += compare_abundance(left, right, subject=subject, method=detector)
    return rows + compare_area_errors(predicted.abundance, observed.abundance)


def _alternatives(side: Products, subject: str) -> str:
    """What a side has that lacks a curve: other detectors of the subject, else other subjects."""
    detectors = list(dict.fromkeys(d for s, d, _ in side.roc if s == subject))
    if detectors:
        return ", which has it by " + ", ".join(detectors)
    subjects = list(dict.fromkeys(s for s, _, _ in side.roc))
    if not subjects:
        return ", which has no roc at all"
    more = f" and {len(subjects) - MOST_NAMED} more" if len(subjects) > MOST_NAMED else ""
    return ", which has " + ", ".join(repr(s) for s in subjects[:MOST_NAMED]) + more


def _covariance_rows(predicted: Products, observed: Products) -> list[Result]:
    """Covariances that both sides hold, in each quantity, and the tails of the classes."""
    rows: list[Result] = []
    noise = predicted.noise if isinstance(predicted, Prediction) else {}
    for quantity in SPREAD:
        for subject, left, right in _pairs(getattr(predicted, quantity), getattr(observed, quantity)):
            rows += compare_covariance(
                left,
                right,
                subject=subject,
                method=quantity,
                axis=observed.axis,
                predicted_distribution=predicted.distribution.get(subject),
                observed_distribution=observed.distribution.get(subject),
                predicted_noise=noise.get(subject) if quantity == "radiance" else None,
            )
    for subject, left, right in _pairs(predicted.distribution, observed.distribution):
        rows += compare_distribution(left, right, subject=subject)
    return rows


def _pairs(left: Mapping[K, Any], right: Mapping[K, Any]) -> Iterator[tuple[K, Any, Any]]:
    """What either side has under each key, those of the observation first and in its order."""
    for key in dict.fromkeys([*right, *left]):
        yield key, left.get(key), right.get(key)
