"""All products of one comparison: every subject that either side names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
from hyperval.products import Prediction, Products
from hyperval.results import Result

SPECTRAL = ("radiance", "snr", "reflectance", "toa_reflectance")
# Quantities in which pixels of a class spread.
SPREAD = ("radiance", "reflectance")
MOST_NAMED = 6

K = TypeVar("K")


def compare_products(
    predicted: Products,
    observed: Products,
    *,
    campaign: str,
    method: str = "model",
    pfa: Sequence[float] | None = None,
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
    for product in SPECTRAL:
        left, right = getattr(predicted, product), getattr(observed, product)
        for subject in _keys(left, right):
            rows += compare_spectra(
                left.get(subject),
                right.get(subject),
                campaign=campaign,
                product=product,
                subject=subject,
                method=method,
                axis=observed.axis,
            )
    rows += _covariance_rows(predicted, observed, campaign)
    rows += _paired(compare_classification, predicted.classification, observed.classification, campaign)
    rows += _paired(compare_scores, predicted.scores, observed.scores, campaign)
    for detector in dict.fromkeys(detector for _, detector in predicted.object_scores):
        rows += compare_object_scores(
            {s: scores for (s, d), scores in predicted.object_scores.items() if d == detector},
            {s: scores for (s, d), scores in observed.object_scores.items() if d == detector},
            campaign=campaign,
            method=detector,
        )
    for (subject, detector), curve in predicted.exceedance.items():
        measured = observed.exceedance.get((subject, detector))
        rows += compare_exceedance(curve, measured, campaign=campaign, subject=subject, method=detector)
    for subject, detector, unit in _keys(predicted.roc, observed.roc):
        key_of_curve = (subject, detector, unit)
        made = compare_roc(
            predicted.roc.get(key_of_curve),
            observed.roc.get(key_of_curve),
            campaign=campaign,
            subject=subject,
            method=f"{detector}/{unit}",
            pfa=pfa,
            equivalence_margin=equivalence_margin,
        )
        lacking = next((side for side in (predicted, observed) if key_of_curve not in side.roc), None)
        if lacking is not None:
            made = [replace(row, reason=f"{row.reason}{_alternatives(lacking, subject)}") for row in made]
        rows += made
    rows += _paired(compare_abundance, predicted.abundance, observed.abundance, campaign)
    return rows + compare_area_errors(predicted.abundance, observed.abundance, campaign=campaign)


def _paired(
    compare: Callable[..., list[Result]],
    left: Mapping[tuple[str, str], Any],
    right: Mapping[tuple[str, str], Any],
    campaign: str,
) -> list[Result]:
    """Rows of a product that goes by subject and method."""
    return [
        row
        for subject, method in _keys(left, right)
        for row in compare(
            left.get((subject, method)),
            right.get((subject, method)),
            campaign=campaign,
            subject=subject,
            method=method,
        )
    ]


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


def _covariance_rows(predicted: Products, observed: Products, campaign: str) -> list[Result]:
    """Covariances that both sides hold, in each quantity, and the tails of the classes."""
    rows: list[Result] = []
    noise = predicted.noise if isinstance(predicted, Prediction) else {}
    for quantity in SPREAD:
        left, right = getattr(predicted, quantity), getattr(observed, quantity)
        for subject in _keys(left, right):
            rows += compare_covariance(
                left.get(subject),
                right.get(subject),
                campaign=campaign,
                subject=subject,
                method=quantity,
                axis=observed.axis,
                predicted_distribution=predicted.distribution.get(subject),
                observed_distribution=observed.distribution.get(subject),
                predicted_noise=noise.get(subject) if quantity == "radiance" else None,
            )
    for subject in _keys(predicted.distribution, observed.distribution):
        rows += compare_distribution(
            predicted.distribution.get(subject),
            observed.distribution.get(subject),
            campaign=campaign,
            subject=subject,
        )
    return rows


def _keys(left: Mapping[K, Any], right: Mapping[K, Any]) -> list[K]:
    """Keys of both, those of the observation first and in its order."""
    return list(dict.fromkeys([*right, *left]))
