"""Inverse questions: at which value of an input does an output take a value?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize.elementwise import find_root

from hyperval.study.evaluate import Columns, Evaluator
from hyperval.study.schema import Output, Required

Array = npt.NDArray[np.float64]
_MOST_AT_ONCE = 4096  # evaluations in one batch


@dataclass(frozen=True)
class Answers:
    """Answers at n points.

    Attributes
    ----------
    values : (n,) of the input; NaN where there is none
    reports : (n, R) outputs told at the answer
    reasons : number of the point -> why there is none, or what else is to be said
    """

    values: Array
    reports: Array
    reasons: Mapping[int, str]


def scan_values(question: Required) -> Array:
    """Where the output is looked at first, both ends among them."""
    low, high = question.between
    return (
        np.geomspace(low, high, question.scan)
        if question.spacing == "log"
        else np.linspace(low, high, question.scan)
    )


def answers(evaluator: Evaluator, columns: Columns, question: Required, outputs: Sequence[Output]) -> Answers:
    """Solve output(x) = value for x at every point of ``columns`` (dotted path -> (n,)).

    The output is looked at over the range; a change of sign between neighbours is a bracket, in which the root is
    found by Chandrupatla's method (Adv. Eng. Softw. 28, 145, 1997: inverse quadratic steps inside a bracket, as
    Brent's), for all points together.  Without a bracket there is no solution, and the reason says how far the
    output reaches.  With several the lowest is told, and that there are more.
    """
    output = next(o for o in outputs if o.name == question.output)
    n = len(next(iter(columns.values())))
    x = scan_values(question)
    seen = _at(evaluator, columns, question, np.repeat(np.arange(n), x.size), np.tile(x, n), [output])
    gap = seen.reshape(n, x.size) - question.equals
    reasons: dict[int, str] = {}
    bracket = np.full(n, -1)
    for i in range(n):
        bracket[i], why = _bracket(x, gap[i], question)
        if why:
            reasons[i] = why
    solved = np.flatnonzero(bracket >= 0)
    values = np.full(n, np.nan)
    if solved.size:
        low, high = x[bracket[solved]], x[bracket[solved] + 1]

        def miss(at: Array, row: Array) -> Array:
            output_at = _at(evaluator, columns, question, row.astype(int).ravel(), np.asarray(at).ravel(), [output])
            return output_at.reshape(np.shape(at)) - question.equals

        root = find_root(miss, (low, high), args=(solved.astype(float),), tolerances={"xrtol": 1e-10}, maxiter=100)
        values[solved] = np.where(root.success, root.x, np.nan)
        reasons |= {int(i): "the root was not found" for i in solved[~root.success]}
    reported = [next(o for o in outputs if o.name == name) for name in question.report]
    reports = np.full((n, len(reported)), np.nan)
    good = np.flatnonzero(np.isfinite(values))
    if reported and good.size:
        reports[good] = _at(evaluator, columns, question, good, values[good], reported).reshape(good.size, -1)
    return Answers(values, reports, reasons)


def _at(
    evaluator: Evaluator, columns: Columns, question: Required, rows: npt.NDArray[np.intp], x: Array,
    outputs: Sequence[Output],
) -> Array:  # fmt: skip
    """Outputs at points ``rows`` with the question's input at ``x``; (k,) of one output, (k, O) of several."""
    parts = []
    for start in range(0, rows.size, _MOST_AT_ONCE):
        some = slice(start, start + _MOST_AT_ONCE)
        moved = {m.path: m.offset + m.factor * x[some] for m in question.targets}
        parts.append(evaluator.values({**{p: c[rows[some]] for p, c in columns.items()}, **moved}, outputs)[0])
    values = np.concatenate(parts) if parts else np.empty((0, len(outputs)))
    return values[:, 0] if len(outputs) == 1 else values


def _bracket(x: Array, gap: Array, question: Required) -> tuple[int, str]:
    """Number of the interval that holds the lowest root, -1 without, and what is to be said of it."""
    if not np.all(np.isfinite(gap)):
        return -1, f"{question.output} can not be evaluated over the whole range"
    signs = np.sign(gap)
    change = np.flatnonzero(signs[:-1] * signs[1:] <= 0)
    # A scan value that is itself a root belongs to two intervals.
    change = change[~(np.isin(change - 1, change) & (signs[change] == 0))]
    if not change.size:
        side, best = ("below", int(np.argmax(gap))) if gap[0] < 0 else ("above", int(np.argmin(gap)))
        reached = f"{gap[best] + question.equals:.4g} at {x[best]:.4g}"
        return -1, f"no solution: {question.output} stays {side} {question.equals:g}; it comes to {reached}"
    steps = np.diff(gap)
    monotone = bool(np.all(steps >= -1e-12) or np.all(steps <= 1e-12))
    if change.size > 1:
        return int(change[0]), f"not monotone: {change.size} solutions; the lowest is told"
    return int(change[0]), "" if monotone else "not monotone over the range, one solution all the same"
