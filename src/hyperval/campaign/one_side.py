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


def product_rows(campaign: str, products: Products, side: str) -> list[Result]:
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
    >>> [(r.metric, round(r.value, 3)) for r in product_rows("c", products, "predicted") if np.isfinite(r.value)]
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
            half = 1.96 * estimate.standard_uncertainty
            for b in np.flatnonzero(np.isfinite(estimate.mean)):
                rows.append(
                    Result(
                        campaign,
                        product,
                        subject,
                        side,
                        "mean",
                        float(estimate.mean[b]),
                        unit,
                        float(products.axis.centre_nm[b]),
                        float(estimate.mean[b] - half[b]),
                        float(estimate.mean[b] + half[b]),
                        estimate.n,
                    )
                )
    for (subject, detector), score in products.scores.items():
        for metric in ("mean", "sd"):
            rows.append(Result(campaign, "scores", subject, detector, metric, getattr(score, metric), n=score.n))
    for (subject, detector, unit), curve in products.roc.items():
        for decade in range(-9, 0):
            at = int(np.argmin(np.abs(np.log10(curve.pfa) - decade)))
            if abs(np.log10(curve.pfa[at]) - decade) > 1e-6:
                continue
            rows.append(
                Result(
                    campaign,
                    "roc",
                    subject,
                    f"{detector}/{unit}",
                    f"pd@1e{decade}",
                    float(curve.pd[at]),
                    "1",
                    lower=float(curve.pd_lower[at]),
                    upper=float(curve.pd_upper[at]),
                    n=curve.n_target,
                )
            )
        rows += _beyond_points(RowMaker(campaign, "roc", subject, f"{detector}/{unit}"), curve)
    rows += [row for key, curve in products.exceedance.items() for row in _thresholds(campaign, key, curve)]
    for (subject, detector), area in products.abundance.items():
        half_area = 1.96 * area.standard_uncertainty
        rows.append(
            Result(
                campaign,
                "abundance",
                subject,
                detector,
                "area",
                area.area_m2,
                "m2",
                lower=area.area_m2 - half_area,
                upper=area.area_m2 + half_area,
                n=area.n,
            )
        )
    for subject, distribution in products.distribution.items():
        rows += compare_distribution(None, distribution, campaign=campaign, subject=subject)
    for (classes, features), errors in products.classification.items():
        make = RowMaker(campaign, "classification", classes, features)
        rows.append(make.row("error", errors.error, interval=(errors.lower, errors.upper), n=errors.n))
        rows.append(make.row("distance", errors.distance, n=errors.n))
    return rows


def _thresholds(campaign: str, key: tuple[str, str], curve: ExceedanceCurve) -> list[Result]:
    """``anomaly_threshold@1e-3``: score that this part of the background exceeds, where no target is looked for."""
    if key[0] != ANOMALIES or curve.n is None:
        return []
    make, rows = RowMaker(campaign, "scores", *key), []
    for level in sorted(ANOMALY_LEVELS, reverse=True):
        if level * curve.n >= LEAST_EXPECTED_ALARMS:
            at = int(np.argmin(np.abs(np.log(curve.probability.clip(1e-300)) - np.log(level))))
            reason = f"{curve.probability[at]:.3g} of {curve.n} background pixels lie above"
            rows.append(
                make.row(
                    f"anomaly_threshold@{scientific(level)}", float(curve.threshold[at]), n=curve.n, reason=reason
                )
            )
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
