"""Rows of one side alone, where there is nothing to compare with."""

from __future__ import annotations

import numpy as np

from hyperval.compare.covariance import compare_distribution
from hyperval.compare.roc import ALWAYS, IF_BACKGROUND_ALLOWS, LEAST_EXPECTED_ALARMS
from hyperval.compare.roc_alarms import far_at_detection_rows, far_row, first_detection_rows, joint_rows
from hyperval.compare.roc_areas import area_rows
from hyperval.compare.rows import RowMaker, scientific
from hyperval.processing.exceedance import ANOMALY_LEVELS
from hyperval.products import ANOMALIES, ExceedanceCurve, Products, RocCurve
from hyperval.results import Outcome, Result


def product_rows(products: Products, side: str) -> list[Result]:
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
    rows: list[Result] = []
    for product, unit in (
        ("radiance", "uW cm-2 sr-1 nm-1"),
        ("snr", "1"),
        ("reflectance", "1"),
        ("toa_reflectance", "1"),
    ):
        for subject, estimate in getattr(products, product).items():
            make, half = RowMaker(product, subject, side), 1.96 * estimate.standard_uncertainty
            for b in np.flatnonzero(np.isfinite(estimate.mean)):
                at = products.axis.centre_nm[b]
                rows.append(make.row("mean", estimate.mean[b], half=half[b], unit=unit, band_nm=at, n=estimate.n))
    for key, score in products.scores.items():
        make = RowMaker("scores", *key)
        rows += [make.row(metric, getattr(score, metric), n=score.n) for metric in ("mean", "sd")]
    for (subject, detector, by), curve in products.roc.items():
        make = RowMaker("roc", subject, f"{detector}/{by}")
        for decade in range(-9, 0):
            at = int(np.argmin(np.abs(np.log10(curve.pfa) - decade)))
            if abs(np.log10(curve.pfa[at]) - decade) <= 1e-6:
                limits = (curve.pd_lower[at], curve.pd_upper[at])
                rows.append(make.row(f"pd@1e{decade}", curve.pd[at], interval=limits, n=curve.n_target))
        rows += _beyond_points(make, curve)
    for key, exceedance in products.exceedance.items():
        rows += _thresholds(RowMaker("scores", *key), exceedance)
    for key, area in products.abundance.items():
        half = 1.96 * area.standard_uncertainty
        rows.append(RowMaker("abundance", *key).row("area", area.area_m2, half=half, unit="m2", n=area.n))
    for subject, distribution in products.distribution.items():
        rows += compare_distribution(None, distribution, subject=subject)
    for key, errors in products.classification.items():
        make = RowMaker("classification", *key)
        rows.append(make.row("error", errors.error, interval=(errors.lower, errors.upper), n=errors.n))
        rows.append(make.row("distance", errors.distance, n=errors.n))
    return rows


def _thresholds(make: RowMaker, curve: ExceedanceCurve) -> list[Result]:
    """``anomaly_threshold@1e-3``: score that this part of the background exceeds, where no target is looked for."""
    if make.subject != ANOMALIES or curve.n is None:
        return []
    rows = []
    for level in sorted(ANOMALY_LEVELS, reverse=True):
        if level * curve.n >= LEAST_EXPECTED_ALARMS:
            at = int(np.argmin(np.abs(np.log(curve.probability.clip(1e-300)) - np.log(level))))
            why = f"{curve.probability[at]:.3g} of {curve.n} background pixels lie above"
            name = f"anomaly_threshold@{scientific(level)}"
            rows.append(make.row(name, curve.threshold[at], n=curve.n, reason=why))
    return rows


def _beyond_points(make: RowMaker, curve: RocCurve) -> list[Result]:
    """Areas of a curve; of a measured one its false alarms per km2 and joint regions too."""
    if curve.n_target is None:
        return area_rows(make, curve, None)
    rows: list[Result] = []
    for pfa in (*ALWAYS, *IF_BACKGROUND_ALLOWS):
        if pfa * (curve.n_background or 0) >= LEAST_EXPECTED_ALARMS:
            rows += [*far_row(make, curve, pfa), *joint_rows(make, None, curve, pfa)]
    rows += first_detection_rows(make, curve)
    rows += [*far_at_detection_rows(make, None, curve), *area_rows(make, None, curve)]
    return [row for row in rows if row.outcome is Outcome.NONE]  # nothing is planned here, so nothing is skipped
