"""ROC curves: predicted against measured detection probability at stated false-alarm probabilities.

False alarms per km2, and regions that hold P_FA and P_D together.

Areas under the ROC: of the predicted curve, of the measured one, and their difference.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hyperval.compare.rows import RowMaker, difference_interval, scientific
from hyperval.errors import UsageError
from hyperval.processing.alarm_blocks import LEAST_EXPECTED_ALARMS
from hyperval.processing.intervals import clopper_pearson, joint_region, zero_count_upper_limit
from hyperval.processing.roc import AREAS, RocArea, curve_area
from hyperval.processing.roc_model import detection_at
from hyperval.products import AlarmsAtDetection, AreaEstimate, RocCurve
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
    of targets and background (:func:`~hyperval.processing.roc.alarms_at_detection`), the predicted one is where
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
    """``alarms_before_first`` (:func:`~hyperval.processing.roc.alarms_before_first`), where it was counted.

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


Array = npt.NDArray[np.float64]


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
    (predicted - measured) has the interval of :func:`~hyperval.compare.rows.difference_interval`.

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


ALWAYS = (1e-1, 1e-2, 1e-3)
IF_BACKGROUND_ALLOWS = (1e-4, 1e-5, 1e-6)
LEAST_END = 0.5  # a curve that stops below this P_FA has no area to speak of
# A measured interval wider than this accepts nearly any prediction: one target alone gives 0.975 or more.
WIDEST_INTERVAL = 0.9
METRICS = (
    "pd_predicted", "pd_measured", "pd_difference", "pd_inside_interval", "pd_inside_measured_interval",
)  # fmt: skip
VERDICTS = ("pd_equivalent", "pd_equivalence")
# The two readings of (3.30-3.33) are told apart where their P_D differ by more than this.
SAME_READING = 1e-3


def limits_at(curve: RocCurve, pfa: float) -> tuple[float, float]:
    """95 % limits of P_D at ``pfa``; NaN outside the curve."""
    return float(detection_at(curve, pfa, curve.pd_lower)), float(detection_at(curve, pfa, curve.pd_upper))


def equivalent(interval: tuple[float, float], margin: float) -> bool:
    """Two one-sided tests: the whole 95 % interval of the difference lies inside +-``margin``.

    That rejects "the difference is at least the margin" on both sides at the 2.5 % level.  No difference
    found is not equivalence: a wide interval fails.  Source: Schuirmann, J. Pharmacokinet. Biopharm. 15, 657, 1987.
    """
    if not 0.0 < margin < 1.0:
        raise UsageError(f"equivalence margin {margin:g}", expected="a difference of probability between 0 and 1")
    return -margin < interval[0] and interval[1] < margin


def equivalence(interval: tuple[float, float], margin: float) -> tuple[float, str]:
    """The three outcomes of a comparison with a margin: 1 equivalent, -1 different, 0 undecided, and the word.

    Different is a 95 % interval of the difference that lies wholly beyond 0: with many targets a difference may be
    certain and yet within the margin, which is then equivalent for the purpose, and the word says both.
    """
    apart = interval[0] > 0.0 or interval[1] < 0.0
    if equivalent(interval, margin):
        return 1.0, "equivalent, though not the same" if apart else "equivalent"
    return (-1.0, "different") if apart else (0.0, "undecided")


def compare_roc(
    predicted: RocCurve | None,
    observed: RocCurve | None,
    *,
    subject: str,
    method: str,
    pfa: Sequence[float] | None = None,
    equivalence_margin: float | None = None,
) -> list[Result]:
    """Rows at each false-alarm probability, named METRIC@1e-2 and the like.

    ``pd_predicted`` and ``pd_measured`` with their intervals, ``pd_difference`` (predicted - measured) with its
    interval, and 1 or 0 for

    - ``pd_inside_interval``: 0 lies in the 95 % interval of the difference, i.e. the predicted P_D lies in the
      measured interval widened by the predicted half-width *in quadrature*.  That the two intervals
      overlap (widths added) is not enough.  Where the predicted curve has no width it is the next rule;
    - ``pd_inside_measured_interval``: the predicted P_D lies in the measured interval as it stands;
    - ``pd_equivalent`` (with ``equivalence_margin``): two one-sided tests, :func:`equivalent`; and
      ``pd_equivalence``: 1 equivalent, -1 different, 0 undecided, :func:`equivalence`.

    ``pd_predicted_preset`` and ``pd_inside_interval_preset`` read the predicted curve at the preset P_FA of (3.30),
    that of the worst class alone, where that differs from the P_FA of the whole background (3.33).

    Default probabilities: 1e-1, 1e-2, 1e-3 always, and 1e-4 to 1e-6 where the background is large enough to
    expect 10 alarms.  A probability that the background or a curve does not reach gives SKIPPED rows.
    The verdicts (but not the values) are SKIPPED too where the measured interval is wider than 0.9, as with a
    single target object: a test that nothing can fail is no test.
    With what a measured curve knows beyond its points come the areas (:mod:`hyperval.compare.roc`), false
    alarms per km2 and joint regions (:mod:`hyperval.compare.roc`); ``auc_difference`` of bare curves is over
    their common range of P_FA and has no interval.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1, 1.0])
    >>> predicted = RocCurve(pfa, pfa**0.2, pfa**0.25, pfa**0.15, -pfa, preset_pfa=pfa / 2.0)
    >>> observed = RocCurve(pfa, pfa**0.3, pfa**0.4, pfa**0.25, -pfa, "pixel", 40, 10_000)
    >>> rows = compare_roc(predicted, observed, subject="panel", method="cem/pixel", pfa=[1e-2])
    >>> [(r.metric, round(r.value, 3)) for r in rows if r.metric.startswith("pd")]
    [('pd_predicted@1e-2', 0.398), ('pd_measured@1e-2', 0.251), ('pd_difference@1e-2', 0.147),
    ('pd_inside_interval@1e-2', 0.0), ('pd_inside_measured_interval@1e-2', 0.0), ('pd_predicted_preset@1e-2',
    0.46), ('pd_inside_interval_preset@1e-2', 0.0)]
    """
    make = RowMaker("roc", subject, method)

    def rows(predicted: RocCurve, observed: RocCurve) -> list[Result]:
        if predicted.unit != observed.unit:
            raise UsageError(
                f"{subject}: the predicted curve counts by {predicted.unit}, the measured by {observed.unit}"
            )
        background = observed.n_background
        levels = tuple(pfa) if pfa is not None else ALWAYS
        if pfa is None:
            levels += tuple(x for x in IF_BACKGROUND_ALLOWS if background and x * background >= LEAST_EXPECTED_ALARMS)
        out: list[Result] = []
        for level in levels:
            out += _at(make, predicted, observed, level, equivalence_margin)
            if not background or level * background >= LEAST_EXPECTED_ALARMS:
                out += [*far_row(make, observed, level), *joint_rows(make, predicted, observed, level)]
        out += [*far_at_detection_rows(make, predicted, observed), *first_detection_rows(make, observed)]
        if not observed.areas:
            return [*out, _bare(make, predicted, observed)]
        return [*out, *area_rows(make, predicted, observed)]

    return make.compared(predicted, observed, rows)


def _at(make: RowMaker, predicted: RocCurve, observed: RocCurve, pfa: float, margin: float | None) -> list[Result]:
    label = scientific(pfa)
    names = [f"{m}@{label}" for m in (*METRICS, *(VERDICTS if margin is not None else ()))]
    n, background = observed.n_target, observed.n_background
    if background is not None and pfa * background < LEAST_EXPECTED_ALARMS:
        reason = f"{background} background samples expect {pfa * background:.3g} alarms at P_FA {label}; "
        reason += f"{LEAST_EXPECTED_ALARMS:g} are needed to place the threshold"
        return [make.skipped(Cause.FEW_ALARMS, reason, name) for name in names]
    p, o = float(detection_at(predicted, pfa)), float(detection_at(observed, pfa))
    if math.isnan(p) or math.isnan(o):
        side = "predicted" if math.isnan(p) else "measured"
        why = f"the {side} curve has no point at P_FA {label}"
        return [make.skipped(Cause.BEYOND_CURVE, why, name) for name in names]
    p_interval = limits_at(predicted, pfa)
    o_interval = limits_at(observed, pfa)
    if any(math.isnan(x) for x in p_interval):  # a curve without a band is a curve without width
        p_interval = (p, p)
    low, high = difference_interval(p, p_interval, o, o_interval)
    # An unknown measured interval must not read as "outside": the verdict itself is unknown.
    known = not any(math.isnan(x) for x in o_interval)
    inside = float(low <= 0.0 <= high) if known else math.nan
    inside_measured = float(o_interval[0] <= p <= o_interval[1]) if known else math.nan
    out = [
        make.row(names[0], p, interval=p_interval),
        make.row(names[1], o, interval=o_interval, n=n),
        make.row(names[2], p - o, interval=(low, high), n=n),
    ]
    if o_interval[1] - o_interval[0] > WIDEST_INTERVAL:
        reason = f"the measured interval {o_interval[0]:.2g} to {o_interval[1]:.2g}"
        reason += f" from {n} {observed.unit}{'' if n == 1 else 's'}" if n is not None else ""
        why = f"{reason} accepts nearly any prediction"
        return out + [make.skipped(Cause.VACUOUS, why, name) for name in names[3:]]
    out += [make.row(names[3], inside, n=n), make.row(names[4], inside_measured, n=n)]
    if margin is not None:
        yes, (code, word) = equivalent((low, high), margin), equivalence((low, high), margin)
        words = f"margin {margin:g}"
        out.append(make.row(names[5], float(yes) if known else math.nan, n=n, reason=words))
        out.append(make.row(names[6], code if known else math.nan, n=n, reason=f"{word} by a {words}"))
    return [*out, *_preset_rows(make, predicted, pfa, (p, p_interval), (o, o_interval), n)]


def _preset_rows(
    make: RowMaker,
    predicted: RocCurve,
    pfa: float,
    swept: tuple[float, tuple[float, float]],
    measured: tuple[float, tuple[float, float]],
    n: int | None,
) -> list[Result]:
    """P_D of (3.32) at the preset of (3.30) without (3.33), where that is another P_D.

    A class that gives ``pfa`` alone, at its part of the scene, gives less in all: the preset lies at a higher
    threshold and the P_D is lower.
    """
    if predicted.preset_pfa is None:
        return []
    order = np.argsort(predicted.preset_pfa, kind="stable")
    axis = np.maximum(predicted.preset_pfa[order], 1e-300)
    if not axis[0] <= pfa <= axis[-1]:
        return []
    preset = replace(predicted, pfa=axis, pd=predicted.pd[order])
    limits = predicted.pd_lower[order], predicted.pd_upper[order]
    value, low, high = (float(detection_at(preset, pfa, y)) for y in (None, *limits))
    if abs(value - swept[0]) < SAME_READING:
        return []
    ends = difference_interval(value, (low, high), *measured)
    label = scientific(pfa)
    known = not any(math.isnan(x) for x in measured[1])
    inside = float(ends[0] <= 0.0 <= ends[1]) if known else math.nan
    words = f"(3.32) at the preset, without (3.33): {swept[0]:.3g} with it, measured {measured[0]:.3g}"
    return [
        make.row(f"pd_predicted_preset@{label}", value, interval=(low, high), reason=words),
        make.row(f"pd_inside_interval_preset@{label}", inside, n=n, reason=words),
    ]


def _bare(make: RowMaker, predicted: RocCurve, observed: RocCurve) -> Result:
    """The difference of areas of curves without scores."""
    low = max(float(predicted.pfa[0]), float(observed.pfa[0]))
    if low >= 0.1 or min(float(predicted.pfa[-1]), float(observed.pfa[-1])) < LEAST_END:
        why = f"the curves do not both reach from P_FA below 0.1 to {LEAST_END:g}"
        return make.skipped(Cause.BEYOND_CURVE, why, "auc_difference")
    area = RocArea(low, 1.0)
    gap = curve_area(predicted, area) - curve_area(observed, area)
    why = f"area of both curves over P_FA {low:.2g} to 1; no interval from curves alone"
    return make.row("auc_difference", gap, n=observed.n_target, reason=why)
