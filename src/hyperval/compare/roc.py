"""ROC curves: predicted against measured detection probability at stated false-alarm probabilities."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hyperval.compare.difference import difference_interval
from hyperval.compare.roc_alarms import far_at_detection_rows, far_row, first_detection_rows, joint_rows
from hyperval.compare.roc_areas import area_rows, curve_area
from hyperval.compare.rows import RowMaker, scientific
from hyperval.errors import UsageError
from hyperval.processing.roc_areas import RocArea
from hyperval.processing.roc_reading import detection_at
from hyperval.products import RocCurve
from hyperval.results import Cause, Result

Array = npt.NDArray[np.float64]
ALWAYS = (1e-1, 1e-2, 1e-3)
IF_BACKGROUND_ALLOWS = (1e-4, 1e-5, 1e-6)
LEAST_END = 0.5  # a curve that stops below this P_FA has no area to speak of
# Below this many expected alarms the background sample does not fix the threshold.
LEAST_EXPECTED_ALARMS = 10.0
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
    With what a measured curve knows beyond its points come the areas (:mod:`hyperval.compare.roc_areas`), false
    alarms per km2 and joint regions (:mod:`hyperval.compare.roc_alarms`); ``auc_difference`` of bare curves is over
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
            levels += tuple(
                x for x in IF_BACKGROUND_ALLOWS if background and x * background >= LEAST_EXPECTED_ALARMS
            )
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
