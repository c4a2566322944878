"""Areas under the ROC: of the predicted curve, of the measured one, and their difference."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hyperval.compare.difference import difference_interval
from hyperval.compare.rows import RowMaker
from hyperval.processing.roc_areas import AREAS, RocArea
from hyperval.products import AreaEstimate, RocCurve
from hyperval.results import Cause, Result

Array = npt.NDArray[np.float64]
_POINTS = 4001
_DECIMALS = 15  # of a P_D; what is below is rounding


def curve_area(curve: RocCurve, area: RocArea, values: Array | None = None) -> float:
    """Mean P_D of a curve over the range of ``area``; NaN where it does not reach the range.

    P_D is interpolated over log P_FA by a monotone cubic.  Every ROC ends at (1, 1), where everything is declared;
    a curve that stops before is joined to that point.  Below its first point P_D is taken as there, which counts
    only where the range begins at 0.

    Parameters
    ----------
    values : (K,) what stands for P_D, such as a limit of its band
    """
    pfa, pd = curve.pfa, curve.pd if values is None else values
    known = (pfa > 0) & np.isfinite(pd)
    pfa, pd = pfa[known], pd[known]
    if pfa.size < 2 or pfa[0] > max(area.low, 1e-2 * area.high):
        return math.nan
    if pfa[-1] < 1.0:
        pfa, pd = np.append(pfa, 1.0), np.append(pd, 1.0)
    from scipy.interpolate import PchipInterpolator  # a tenth of a second, which spectra alone do not need

    # A rise from 0 to 1e-300 has an inverse slope that overflows in the harmonic means of the cubic; it is no P_D.
    curve_of = PchipInterpolator(np.log(pfa), np.round(pd, _DECIMALS))
    low = max(area.low, float(pfa[0]))
    u = np.linspace(math.log(low), math.log(area.high), _POINTS)
    if area.logarithmic:
        return float(np.trapezoid(curve_of(u), u) / (u[-1] - u[0]))
    x = np.exp(u)
    # Over P_FA itself: the trapezoids of a P_D of 1 then add up to the range, and no area exceeds it.
    inside = float(np.trapezoid(curve_of(u), x)) + (low - area.low) * float(pd[0])
    return inside / (area.high - area.low)


def predicted_area(curve: RocCurve, area: RocArea) -> tuple[float, tuple[float, float]]:
    """Area of a predicted curve and of the limits of its band; without a band the interval is a point."""
    value = curve_area(curve, area)
    low, high = (curve_area(curve, area, limit) for limit in (curve.pd_lower, curve.pd_upper))
    if math.isnan(low) or math.isnan(high):
        return value, (value, value)
    return value, (min(low, value), max(high, value))


def area_rows(make: RowMaker, predicted: RocCurve | None, observed: RocCurve | None) -> list[Result]:
    """``auc_predicted``, ``auc_measured``, ``auc_difference`` and the same of the partial and log-weighted areas.

    The names of partial areas end in their range of P_FA.  The predicted interval is that of the curve's band, as
    if its errors went together over the whole curve; the measured one is explained in its reason.  The difference
    (predicted - measured) has the interval of :func:`~hyperval.compare.difference.difference_interval`.

    Examples
    --------
    >>> import numpy as np
    >>> from hyperval.processing.roc import empirical_roc, with_summary
    >>> rng = np.random.default_rng(0)
    >>> target, background = rng.normal(2.0, 1.0, 40), rng.normal(size=20_000)
    >>> measured = with_summary(empirical_roc(target, background), target, background, rng=rng)
    >>> rows = area_rows(RowMaker("roc", "panel", "cem/pixel"), measured, measured)
    >>> [(r.metric, round(r.value, 2)) for r in rows]
    [('auc_predicted', 0.94), ('auc_measured', 0.94), ('auc_difference', 0.0), ('partial_auc_predicted@0..1e-1',
    0.59), ('partial_auc_measured@0..1e-1', 0.59), ('partial_auc_difference@0..1e-1', -0.0),
    ('log_auc_predicted@1e-3..1e-1', 0.36), ('log_auc_measured@1e-3..1e-1', 0.36),
    ('log_auc_difference@1e-3..1e-1', 0.0)]
    """
    rows: list[Result] = []
    measured: Mapping[str, AreaEstimate] = observed.areas if observed is not None else {}
    for full, area in AREAS.items():
        name, _, span = full.partition("@")
        label = {side: f"{name}_{side}" + (f"@{span}" if span else "") for side in _SIDES}
        p, p_interval, reason = math.nan, (math.nan, math.nan), ""
        if predicted is not None:
            p, p_interval = predicted_area(predicted, area)
            if math.isfinite(p):
                rows.append(make.row(label["predicted"], p, interval=p_interval))
            else:
                reason = f"the predicted curve does not reach the range P_FA {span or '0..1'}"
                rows.append(make.skipped(Cause.BEYOND_CURVE, reason, label["predicted"]))
        if observed is None:
            continue
        estimate = measured.get(full)
        if estimate is None:
            cause, lacking = _why_not(observed, area, span)
            rows.append(make.skipped(cause, lacking, label["measured"]))
            if predicted is not None:
                rows.append(make.skipped(cause, lacking, label["difference"]))
            continue
        o_interval = (estimate.lower, estimate.upper)
        n = observed.n_target
        rows.append(make.row(label["measured"], estimate.value, interval=o_interval, n=n, reason=estimate.method))
        if predicted is None:
            continue
        if reason:
            rows.append(make.skipped(Cause.BEYOND_CURVE, reason, label["difference"]))
        else:
            interval = difference_interval(p, p_interval, estimate.value, o_interval)
            rows.append(make.row(label["difference"], p - estimate.value, interval=interval, n=n))
    return rows


_SIDES = ("predicted", "measured", "difference")


def _why_not(observed: RocCurve, area: RocArea, span: str) -> tuple[Cause, str]:
    n = observed.n_background
    if area.logarithmic and n is not None and observed.areas:
        words = f"{n} background samples expect {area.low * n:.3g} alarms at the low end of {span}; 10 are needed"
        return Cause.FEW_ALARMS, words
    return Cause.NO_SCORES, "the measured curve comes without its scores, so its area has no interval"
