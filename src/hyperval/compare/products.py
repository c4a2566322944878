"""All rows of one comparison, for every subject of either side; of a single side where nothing is compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyperval.compare import covariance, detection, spectra
from hyperval.compare.rows import named, row, said, short_label, skip_as, skip_rows
from hyperval.errors import refuse
from hyperval.model.intervals import Z95
from hyperval.pixels import ANOMALY_LEVELS, LEAST_EXPECTED_ALARMS, nearest_point
from hyperval.products import ANOMALIES, SPECTRA, ExceedanceCurve, Products, RocCurve, background_of
from hyperval.results import Cause, Outcome, Result

# Quantities in which pixels of a class spread.
SPREAD = ("radiance", "reflectance")


def product_rows(products: Products, side: str) -> Iterator[Result]:
    """Rows of one side alone: spectra by band, score moments, P_D at decades of P_FA, areas.

    Examples
    --------
    >>> from hyperval.products import Abundance, RocCurve, ScoreDistribution
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> scores = {("panel", "cem"): ScoreDistribution(0.9, 0.25, 50)}
    >>> areas = {("panel", "cem"): Abundance(3.8, 0.3)}
    >>> pfa = np.array([1e-2, 1e-1])
    >>> roc = {("panel", "cem", "pixel"): RocCurve(pfa, pfa**0.2, pfa**0.3, pfa**0.1, -pfa)}
    >>> products = Products(SpectralAxis(np.array([550.0]), 10.0), scores=scores, abundance=areas, roc=roc)
    >>> [(r.metric, round(r.value, 3)) for r in product_rows(products, "predicted") if np.isfinite(r.value)]
    [('mean', 0.9), ('sd', 0.25), ('pd@1e-2', 0.398), ('pd@1e-1', 0.631), ('auc_predicted', 0.836), ('area',
    3.8)]
    """
    for product in SPECTRA:
        unit = "uW cm-2 sr-1 nm-1" if product == "radiance" else "1"
        for subject, estimate in getattr(products, product).items():
            u = estimate.standard_uncertainty
            half = Z95 * np.where(u > 0.0, u, np.nan)  # none is stated
            rows = (
                row("mean", estimate.mean[b], half=half[b], unit=unit, band_nm=float(nm), n=estimate.n)
                for b, nm in enumerate(products.axis.centre_nm)
                if np.isfinite(estimate.mean[b])
            )
            yield from named(rows, product, subject, side)
    for key, score in products.scores.items():
        yield from named([row(metric, getattr(score, metric), n=score.n) for metric in ("mean", "sd")], "scores", *key)
    for (subject, detector, counted), curve in products.roc.items():
        yield from named(_curve_rows(curve), "roc", subject, f"{detector}/{counted}")
    for (subject, detector), exceedance in products.exceedance.items():
        if subject == ANOMALIES and exceedance.n is not None:  # detectors without a target spectrum
            yield from named(_thresholds(exceedance, exceedance.n), "scores", subject, detector)
    for key, area in products.abundance.items():
        yield from named([row("area", area.area_m2, half=Z95 * area.standard_uncertainty, n=area.n)], "abundance", *key)
    for subject, distribution in products.distribution.items():
        yield from named(covariance.compare_distribution(None, distribution), "covariance", subject, "pixels")
    for key, errors in products.classification.items():
        error = row("error", errors.error, (errors.lower, errors.upper), n=errors.n)
        yield from named([error, row("distance", errors.distance, n=errors.n)], "classification", *key)


def _thresholds(curve: ExceedanceCurve, n: int) -> Iterator[Result]:
    """``anomaly_threshold@1e-3``: score that this part of the background exceeds."""
    for level in sorted(ANOMALY_LEVELS, reverse=True):
        if level * n >= LEAST_EXPECTED_ALARMS:
            k = nearest_point(curve, level)
            why = f"{curve.probability[k]:.3g} of {n} background pixels lie above"
            yield row(f"anomaly_threshold@{short_label(level)}", curve.threshold[k], n=n, reason=why)


def _curve_rows(curve: RocCurve) -> Iterator[Result]:
    """P_D at decades of P_FA and areas of a curve; of a measured one its false alarms per km2 and joint regions too."""
    for decade in range(-9, 0):
        k = int(np.argmin(np.abs(np.log10(curve.pfa) - decade)))
        if abs(np.log10(curve.pfa[k]) - decade) <= 1e-6:
            limits = (curve.pd_lower[k], curve.pd_upper[k]) if curve.has_limits else None
            yield row(f"pd@1e{decade}", curve.pd[k], limits, n=curve.n_target)
    if curve.n_target is None:
        unknown: dict[str, Any] = {} if curve.has_limits else {"lower": math.nan, "upper": math.nan}
        yield from (replace(item, **unknown) for item in detection.area_rows(curve, None))
        return
    levels = (*detection.ALWAYS, *detection.IF_BACKGROUND_ALLOWS)
    rows = [item for pfa in levels for item in detection.alarm_rows(None, curve, pfa)]
    rows += detection.whole_curve_rows(None, curve)
    yield from (item for item in rows if item.outcome is Outcome.NONE)  # nothing is planned, so nothing is skipped


def compare_products(
    predicted: Products,
    observed: Products,
    *,
    method: str = "model",
    equivalence_margin: float | None = None,
    fitted_on: Sequence[str] = (),
) -> list[Result]:
    """Rows of every product and subject that at least one side holds, in a fixed order.

    A subject that one side lacks gives a SKIPPED row, so that nothing planned is missing.  ``method`` names
    the way of the spectral products; for covariances it is the quantity, for classification the features, for
    scores and abundance the detector, for ROC "detector/unit".  Subjects that are not among those which budget and
    settings were ``fitted_on`` are compared jointly as "unseen subjects", too.

    Raises
    ------
    UsageError : the two sides are not on the same bands.

    Examples
    --------
    A signal-to-noise ratio of 20 that is expected where the sensor has 100, as of texture, is not judged.

    >>> from hyperval.products import SpectralEstimate
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> axis, flat = SpectralAxis(np.arange(500.0, 900.0, 100.0), 10.0), np.full(4, 100.0)
    >>> snr = {s: SpectralEstimate(flat, np.eye(4), n=50) for s in ("field", "panel")}
    >>> spread = {s: SpectralEstimate(flat, np.eye(4), c * np.eye(4), 50) for s, c in (("field", 26.0), ("panel", 1.0))}
    >>> side = Products(axis, radiance=spread, snr=snr)
    >>> rows = [row for row in compare_products(side, side) if row.product == "snr"]
    >>> [row.subject for row in rows if row.cause is Cause.TEXTURE]
    ['field']
    """
    axis = observed.axis
    refuse(not predicted.axis.matches(axis), "compare.axes", predicted=len(predicted.axis), observed=len(axis))

    def rows_of(compare: Callable[..., Iterable[Result]], field: str, **options: Any) -> Iterator[Result]:
        """Rows of every key of one field: a subject, or a subject with a method and the unit that it counts."""
        for key, p, o in _paired(getattr(predicted, field), getattr(observed, field)):
            subject, name = (key, method) if isinstance(key, str) else (key[0], "/".join(key[1:]))
            part = 1.0
            if field == "snr" and o is not None:
                noise_part = spectra.snr_beside_texture(predicted, subject)
                # The part of the estimate that is texture, by the model, is common to all bands.
                part, taken = float(np.median(noise_part)), (1.0 - noise_part) * np.nan_to_num(o.mean)
                o = replace(o, error_covariance=o.error_covariance + np.outer(taken, taken))
            rows = compare(p, o, **options) if p is not None and o is not None else absent(field, subject, p, o)
            textured = part < spectra.MIN_OF_NOISE
            yield from named(skip_as("texture.snr", part=part) if textured else rows, field, subject, name)

    def absent(product: str, subject: str, p: Any, o: Any) -> list[Result]:
        """The row of what a side lacks; for a curve with the detectors, else the subjects, that this side has."""
        curves = (predicted if p is None else observed).roc
        detectors = list(dict.fromkeys(detector for s, detector, _ in curves if s == subject))
        subjects = list(dict.fromkeys(repr(s) for s, *_ in curves))
        sides = {"missing": [n for n, side in (("prediction", p), ("observation", o)) if side is None]}
        why = said("absent", product=product, subject=subject, detectors=detectors, others=subjects, **sides)
        return skip_rows(Cause.NO_PREDICTION if p is None else Cause.NO_OBSERVATION, why)

    rows: list[Result] = []
    for product in SPECTRA:
        rows += rows_of(spectra.compare_spectra, product, product=product, axis=axis)
    for subject, side in spectra.subject_groups(observed, fitted_on).items():
        rows += named(spectra.compare_jointly(predicted, side), "radiance", subject, method)
    shown = "radiance" if observed.radiance else "reflectance"
    rows += named(spectra.shifted_rows(predicted, observed), shown, spectra.ALL_SUBJECTS, method)
    for quantity in SPREAD:
        for subject, *_ in _paired(getattr(predicted, quantity), getattr(observed, quantity)):
            spread = covariance.compare_covariance(predicted, observed, subject, quantity)
            rows += named(spread, "covariance", subject, quantity)
    for subject, p, o in _paired(predicted.distribution, observed.distribution):
        rows += named(covariance.compare_distribution(p, o), "covariance", subject, "pixels")
    rows += rows_of(detection.compare_classification, "classification")
    rows += rows_of(detection.compare_scores, "scores")
    for detector in dict.fromkeys(detector for _, detector in predicted.object_scores):
        sides = ({s: v for (s, d), v in p.object_scores.items() if d == detector} for p in (predicted, observed))
        rows += detection.compare_object_scores(*sides, method=detector)
    for (name, detector), p in predicted.exceedance.items():
        subject, o = background_of(name), observed.exceedance.get((name, detector))
        found = absent("scores", subject, p, o) if o is None else detection.compare_exceedance(p, o)
        rows += named(found, "scores", subject, detector)
    rows += rows_of(detection.compare_roc, "roc", equivalence_margin=equivalence_margin)
    rows += rows_of(detection.compare_abundance, "abundance")
    return [*rows, *detection.compare_area_errors(predicted.abundance, observed.abundance)]


def _paired(predicted: Mapping[Any, Any], measured: Mapping[Any, Any]) -> Iterator[tuple[Any, Any, Any]]:
    """What either side has under each key, those of the observation first and in its order."""
    for key in dict.fromkeys([*measured, *predicted]):
        yield key, predicted.get(key), measured.get(key)
