"""False alarms per km2, and regions that hold P_FA and P_D together."""

from __future__ import annotations

import math

import numpy as np

from hyperval.compare.difference import difference_interval
from hyperval.compare.rows import RowMaker, scientific
from hyperval.processing.intervals import clopper_pearson, joint_region, zero_count_upper_limit
from hyperval.processing.roc_reading import detection_at
from hyperval.products import AlarmsAtDetection, RocCurve
from hyperval.results import Cause, Result

PER_AREA = "km-2"
AREA_UNKNOWN = "the ground area of the background is not known"


def samples_per_km2(curve: RocCurve) -> float:
    """Background samples on a square kilometre; NaN when the area is not known."""
    if not curve.background_area_km2 or not curve.n_background:
        return math.nan
    return curve.n_background / curve.background_area_km2


def alarms_on_grid(curve: RocCurve, pfa: float) -> int | None:
    """Alarms at a point of the curve, None where it has no such point or does not know."""
    at = np.flatnonzero(np.abs(curve.pfa - pfa) <= 1e-9 * pfa)
    return int(curve.alarms[at[-1]]) if curve.alarms is not None and at.size else None


def far_row(make: RowMaker, observed: RocCurve, pfa: float) -> list[Result]:
    """``far_measured@1e-2``: alarms per km2 at the threshold that the background sets for a P_FA.

    The interval is that of Clopper & Pearson on the alarms, times the samples per km2; for rare alarms it is the
    exact Poisson interval.  The share of the background above its own (k + 1)-th greatest score follows a beta
    distribution whose quantiles lie inside it, so it holds although the threshold was set by the same background.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> alarms = np.array([10, 100, 1000])
    >>> curve = RocCurve(pfa, pfa**0.2, pfa**0.3, pfa**0.1, -pfa, "pixel", 40, 10_000, 0.04, alarms)
    >>> [(r.metric, r.value) for r in far_row(RowMaker("roc", "panel", "cem/pixel"), curve, 1e-2)]
    [('far_measured@1e-2', 2500.0)]
    """
    name, alarms = f"far_measured@{scientific(pfa)}", alarms_on_grid(observed, pfa)
    density = samples_per_km2(observed)
    if alarms is None or observed.n_background is None:
        return []
    if math.isnan(density):
        return [make.skipped(Cause.NO_GROUND_AREA, AREA_UNKNOWN, name)]
    low, high = (float(x) * density for x in clopper_pearson(alarms, observed.n_background))
    reason = f"{alarms} alarms on {observed.background_area_km2:.4g} km2"
    rate = alarms / float(observed.background_area_km2 or math.nan)
    return [make.row(name, rate, interval=(low, high), unit=PER_AREA, n=observed.n_background, reason=reason)]


def far_at_detection_rows(make: RowMaker, predicted: RocCurve | None, observed: RocCurve) -> list[Result]:
    """``far_predicted``, ``far_measured`` and ``far_difference`` ``@pd0.5`` and the like.

    Alarms per km2 at the highest threshold that reaches the stated P_D.  The measured interval holds the sampling
    of targets and background (:func:`~hyperval.processing.alarms.alarms_at_detection`), the predicted one is where
    the band of the curve reaches that P_D.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from hyperval.products import AlarmsAtDetection
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> pd = np.array([0.3, 0.6, 0.9])
    >>> predicted = RocCurve(pfa, pd, pd - 0.1, pd + 0.1, -pfa)
    >>> point = AlarmsAtDetection(0.5, 0.7, 40, 4e-3, 1e-3, 1e-2, 3e-3, 5e-3)
    >>> counts = {"n_target": 40, "n_background": 10_000, "background_area_km2": 0.04}
    >>> observed = replace(predicted, **counts, at_detection=(point,))
    >>> rows = far_at_detection_rows(RowMaker("roc", "panel", "cem/pixel"), predicted, observed)
    >>> [(r.metric, round(r.value)) for r in rows]
    [('far_predicted@pd0.5', 1160), ('far_measured@pd0.5', 1000), ('far_difference@pd0.5', 160)]
    """
    density = samples_per_km2(observed)
    rows: list[Result] = []
    for point in observed.at_detection:
        names = {side: f"far_{side}@pd{point.pd:g}" for side in ("predicted", "measured", "difference")}
        if math.isnan(density):
            rows.append(make.skipped(Cause.NO_GROUND_AREA, AREA_UNKNOWN, names["measured"]))
            continue
        m_interval = (point.pfa_lower * density, point.pfa_upper * density)
        rate, n = point.pfa * density, observed.n_target
        reason = _in_words(point, observed, density)
        measured = make.row(names["measured"], rate, interval=m_interval, unit=PER_AREA, n=n, reason=reason)
        if predicted is None:
            rows.append(measured)
            continue
        p = _pfa_at(predicted, predicted.pd, point.pd)
        if math.isnan(p):
            why = f"the predicted curve does not pass P_D {point.pd:g} within its range of P_FA"
            rows += [
                make.skipped(Cause.BEYOND_CURVE, why, names["predicted"]),
                measured,
                make.skipped(Cause.BEYOND_CURVE, why, names["difference"]),
            ]
            continue
        low, high = (_pfa_at(predicted, limit, point.pd) for limit in (predicted.pd_upper, predicted.pd_lower))
        # Where a limit of the band lies wholly above or below that P_D, its end of the range bounds P_FA.
        low = 0.0 if math.isnan(low) else min(low, p)
        high = 1.0 if math.isnan(high) else max(high, p)
        if np.isnan(predicted.pd_lower).any():
            low = high = p
        p_interval = (low * density, high * density)
        interval = difference_interval(p * density, p_interval, rate, m_interval)
        rows += [
            make.row(names["predicted"], p * density, interval=p_interval, unit=PER_AREA),
            measured,
            make.row(names["difference"], p * density - rate, interval=interval, unit=PER_AREA, n=n),
        ]
    return rows


def first_detection_rows(make: RowMaker, observed: RocCurve) -> list[Result]:
    """``alarms_before_first`` (:func:`~hyperval.processing.alarms.alarms_before_first`), where it was counted.

    Examples
    --------
    >>> pfa = np.array([1e-2, 1e-1])
    >>> curve = RocCurve(pfa, pfa, pfa, pfa, -pfa, "object", 7, 10_000, alarms_before_first=3)
    >>> [(r.metric, r.value) for r in first_detection_rows(RowMaker("roc", "panel", "cem/object"), curve)]
    [('alarms_before_first', 3.0)]
    """
    if observed.alarms_before_first is None:
        return []
    reason = f"of {observed.n_background} background pixels, up to the best pixel of {observed.n_target} objects; "
    reason += "favours targets of many pixels or pieces"
    count = observed.alarms_before_first
    return [make.row("alarms_before_first", float(count), n=observed.n_target, reason=reason)]


def joint_rows(make: RowMaker, predicted: RocCurve | None, observed: RocCurve, pfa: float) -> list[Result]:
    """``joint_pfa``, ``joint_pd`` and ``pd_inside_joint_region`` ``@1e-2``.

    The rectangle of the first two intervals holds the true (P_FA, P_D) of the measured threshold with 95 %
    probability: two independent statements at level sqrt(0.95) each.  That the background set the threshold does no
    harm, since its own share above it has a beta distribution that the exact interval holds, and the targets had no
    part in it.  The last row is 1 where the predicted curve (without its band) passes through the rectangle.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> pd, alarms = np.array([0.3, 0.6, 0.9]), np.array([10, 100, 1000])
    >>> curve = RocCurve(pfa, pd, pfa, pfa, -pfa, "pixel", 40, 10_000, None, alarms)
    >>> rows = joint_rows(RowMaker("roc", "panel", "cem/pixel"), curve, curve, 1e-2)
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('joint_pfa@1e-2', 0.01), ('joint_pd@1e-2', 0.6), ('pd_inside_joint_region@1e-2', 1.0)]
    """
    alarms, at = alarms_on_grid(observed, pfa), np.flatnonzero(np.abs(observed.pfa - pfa) <= 1e-9 * pfa)
    if alarms is None or not observed.n_target or not observed.n_background:
        return []
    label, n, m = scientific(pfa), observed.n_background, observed.n_target
    detected = round(float(observed.pd[at[-1]]) * m)
    region = joint_region(detected, m, alarms, n)
    reason = f"{detected} of {m} {observed.unit}s and {alarms} of {n} background samples; both at 95 % together"
    pfa_interval, pd_interval = (region.pfa_lower, region.pfa_upper), (region.pd_lower, region.pd_upper)
    rows = [
        make.row(f"joint_pfa@{label}", region.pfa, interval=pfa_interval, n=n, reason=reason),
        make.row(f"joint_pd@{label}", region.pd, interval=pd_interval, n=m, reason=reason),
    ]
    if predicted is None:
        return rows
    first, last = float(predicted.pfa[0]), float(predicted.pfa[-1])
    ends = [0.0 if x < first else 1.0 if x > last else float(detection_at(predicted, x)) for x in pfa_interval]
    name = f"pd_inside_joint_region@{label}"
    if region.pd_upper - region.pd_lower > 0.9:
        why = f"the region of {m} {observed.unit}{'' if m == 1 else 's'} accepts nearly any prediction"
        return [*rows, make.skipped(Cause.VACUOUS, why, name)]
    # A curve that rises passes the rectangle unless it is below it at its right end or above it at its left.
    inside = ends[1] >= region.pd_lower and ends[0] <= region.pd_upper
    return [*rows, make.row(name, float(inside), n=m)]


def _in_words(point: AlarmsAtDetection, observed: RocCurve, density: float) -> str:
    text = f"{point.alarms} alarms on {observed.background_area_km2:.4g} km2; at this threshold as it stands "
    text += f"{point.fixed_lower * density:.4g} to {point.fixed_upper * density:.4g}"
    if point.alarms == 0 and observed.n_background:
        text += f" (at most {zero_count_upper_limit(observed.n_background) * density:.4g}, one-sided)"
    return text


def _pfa_at(curve: RocCurve, values: np.ndarray, pd: float) -> float:
    """P_FA at which a rising curve reaches ``pd``, NaN where it does not on its range."""
    known = np.isfinite(values)
    pfa, value = np.append(curve.pfa[known], 1.0), np.append(values[known], 1.0)
    value = np.maximum.accumulate(value)
    reached = np.flatnonzero(value >= pd)
    if known.sum() == 0 or reached[0] == 0:
        return math.nan
    i = int(reached[0])
    step = value[i] - value[i - 1]
    part = (pd - value[i - 1]) / step
    return float(np.exp(np.log(pfa[i - 1]) + part * (np.log(pfa[i]) - np.log(pfa[i - 1]))))
