"""What a study found: knees, and rows of the results table, none of which gates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from hyperval.results import Cause, Outcome, Result, ResultTable
from hyperval.study.design import listed
from hyperval.study.plan import Plan
from hyperval.study.schema import Knee, Study
from hyperval.study.tables import StudyTable

Array = npt.NDArray[np.float64]
LEAST_POINTS = 5
_FINE = 2001
_FLAT = 1e-6  # of the output: below it nothing bends


@dataclass(frozen=True)
class KneePoint:
    """The knee of one curve: its place, the curve and its curvature there; NaN with a reason where none is."""

    x: float
    y: float
    curvature: float
    reason: str = ""


def knee(
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    logarithmic: bool = False,
    bend: Literal["any", "concave", "convex"] = "any",
) -> KneePoint:
    """The point of greatest curvature of y(x) once both axes run from 0 to 1.

    kappa = |v''| / (1 + v'^2)^(3/2) of v(u), u = (x - x_0)/(x_1 - x_0) (of log x where ``logarithmic``) and
    v = (y - y_min)/(y_max - y_min), along the cubic spline through the points.  That is the knee in the sense of
    Satopaa et al., "Finding a kneedle in a haystack", ICDCS Workshops 2011, section II: the curvature is made
    independent of the units by the normalisation, and so depends on the ends of the range, which are stated with
    it.

    Parameters
    ----------
    x, y : (n,), n of 5 or more, x rising
    bend : "concave" looks at v'' < 0 alone (a rising curve levels off), "convex" at v'' > 0

    Examples
    --------
    >>> x = np.linspace(0.1, 10.0, 50)
    >>> round(knee(x, 1.0 - np.exp(-x), bend="concave").x, 1)
    2.8
    """
    at, value = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    finite = np.isfinite(value)
    at, value = at[finite], value[finite]
    nothing = np.nan, np.nan, np.nan
    if at.size < LEAST_POINTS:
        return KneePoint(*nothing, f"{at.size} points; a knee needs {LEAST_POINTS}")
    span = float(np.ptp(value))
    if span <= _FLAT * max(1.0, float(np.abs(value).max())):
        return KneePoint(*nothing, "the curve is flat")
    scaled = np.log(at) if logarithmic else at
    u = (scaled - scaled[0]) / (scaled[-1] - scaled[0])
    spline = CubicSpline(u, (value - value.min()) / span)
    fine = np.linspace(0.0, 1.0, _FINE)
    sign = {"any": 0.0, "concave": -1.0, "convex": 1.0}[bend]
    second = spline(fine, 2)
    second = np.abs(second) if sign == 0.0 else np.maximum(sign * second, 0.0)
    curvature = second / (1.0 + spline(fine, 1) ** 2) ** 1.5
    if not curvature.any():
        return KneePoint(*nothing, f"no part of the curve is {bend}")
    # A parabola through the three values around the greatest: between the points of the fine grid.
    k = int(np.argmax(curvature))
    if k in (0, _FINE - 1):
        return KneePoint(*nothing, "the curve bends most at an end of the range")
    a, b, c = curvature[k - 1 : k + 2]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c) if a - 2.0 * b + c < 0 else 0.0
    best = fine[k] + shift * (fine[1] - fine[0])
    where = scaled[0] + best * (scaled[-1] - scaled[0])
    return KneePoint(
        float(np.exp(where) if logarithmic else where), float(value.min() + span * spline(best)), float(b)
    )


MOST_LISTED = 500  # points that stand in results.csv one by one
_NO_VALUE = {"outcome": Outcome.SKIPPED, "cause": Cause.NO_VALUE}
_PRODUCT = {"snr": "snr", "radiance": "radiance"}


@dataclass(frozen=True)
class CurveKnee:
    """A knee of one curve: the question, the other inputs, the answer."""

    question: Knee
    others: dict[str, Any]
    point: KneePoint


def knees_of(study: Study, table: StudyTable) -> list[CurveKnee]:
    """The knees that a study asks for, one for each combination of its other inputs."""
    return [item for wanted in study.knees for item in _knees(study, table, wanted)]


def _knees(study: Study, table: StudyTable, wanted: Knee) -> Iterator[CurveKnee]:
    values = np.asarray(table.column(wanted.output), float)
    if study.design.kind == "one-at-a-time":
        column = table.column(wanted.along)
        rows = np.array([i for i, v in enumerate(column) if v is not None])
        yield CurveKnee(wanted, {}, _knee(wanted, column[rows].astype(float), values[rows]))
        return
    shape = tuple(len(listed(i)) for i in study.inputs)  # type: ignore[arg-type]
    names = [i.name for i in study.inputs]
    along = names.index(wanted.along)
    each = {i.name: listed(i) for i in study.inputs}
    curves = np.moveaxis(values.reshape(shape), along, -1)
    x = np.asarray(each[wanted.along], float)
    others = [n for n in names if n != wanted.along]
    for index in product(*(range(len(each[n])) for n in others)):  # type: ignore[arg-type]
        fixed = {n: each[n][k] for n, k in zip(others, index, strict=True)}  # type: ignore[index]
        yield CurveKnee(wanted, fixed, _knee(wanted, x, curves[index]))


def _knee(wanted: Knee, x: Array, y: Array) -> KneePoint:
    order = np.argsort(x, kind="stable")
    return knee(x[order], y[order], logarithmic=wanted.scale == "log", bend=wanted.bend)


def words_of(values: dict[str, Any]) -> str:
    """Inputs and their values in a line."""
    return ", ".join(f"{k} = {v:.4g}" if isinstance(v, float) else f"{k} = {v}" for k, v in values.items())


def extremes(values: npt.NDArray[np.float64]) -> dict[str, float]:
    """Least, median and greatest of finite values (n,).

    Examples
    --------
    >>> extremes(np.array([3.0, 1.0, 2.0]))
    {'least': 1.0, 'median': 2.0, 'greatest': 3.0}
    """
    return {"least": float(values.min()), "median": float(np.median(values)), "greatest": float(values.max())}


def result_rows(plan: Plan, table: StudyTable, knees: list[CurveKnee]) -> ResultTable:
    """Least, median and greatest value of every output, answers, knees, and what the evaluation cost in exactness.

    A study of few points has a row for every point and output too.  An output without a single value is SKIPPED
    with the reason.
    """
    study, rows = plan.study, ResultTable()
    kinds = {o.name: o for o in study.outputs}

    def add(
        product: str, subject: str, method: str, metric: str, value: float, unit: str = "1", **more: Any
    ) -> None:
        rows.add(Result(study.name, product, subject, method, metric, float(value), unit, **more))

    for f in table.outputs:
        column = np.asarray(table.column(f.name), float)
        finite = column[np.isfinite(column)]
        output = kinds.get(f.name)
        where = _PRODUCT.get(output.kind, "roc") if output else "study"
        subject = output.subject if output else f.name
        if not finite.size:
            first = next(iter(table.reasons.values()), "no point has a value")
            add(
                where,
                subject,
                f.name,
                "median",
                np.nan,
                f.unit,
                outcome=Outcome.SKIPPED,
                cause=Cause.NO_VALUE,
                reason=first,
                n=0,
            )
            continue
        lacking = column.size - finite.size
        said = f"{lacking} of {column.size} points have no value; reasons stand in table.csv" if lacking else ""
        for metric, value in extremes(finite).items():
            add(where, subject, f.name, metric, value, f.unit, n=int(finite.size), reason=said)
    units = {i.name: i.unit for i in study.inputs}
    for item in knees:
        wanted, point = item.question, item.point
        reason = "; ".join(x for x in (words_of(item.others), point.reason) if x)
        lacking_knee = _NO_VALUE if point.reason else {}
        add("study", wanted.output, f"knee along {wanted.along}", "knee", point.x, units[wanted.along],
            reason=reason, **lacking_knee)  # fmt: skip
    for name, value in plan.sky_error.items():
        unit = "1"
        add("study", name, "interpolated atmosphere", "error_at_held_out_states", value, unit,
            n=study.atmosphere.checked)  # fmt: skip
    if len(table.values) <= MOST_LISTED:
        _add_points(rows, study, table)
    return rows


def _add_points(rows: ResultTable, study: Study, table: StudyTable) -> None:
    for start, columns in table.stretches():
        for i in range(len(next(iter(columns.values())))):
            point = {x.name: columns[x.name][i] for x in study.inputs}
            said = words_of({k: v.item() if hasattr(v, "item") else v for k, v in point.items() if v is not None})
            why = table.reasons.get(start + i, "")
            for f in table.outputs:
                value = float(columns[f.name][i])
                rows.add(
                    Result(study.name, "study", f.name, f"point {start + i}", "output", value, f.unit,
                           reason="; ".join(x for x in (said, why if np.isnan(value) else "") if x))
                )  # fmt: skip
