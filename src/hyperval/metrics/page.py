"""The table of metrics as lines: for the terminal, and for docs/metrics.md."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hyperval.metrics.metric import Metric, Move
from hyperval.metrics.table import table

HEADER = ("metric", "unit", "range", "agreement", "judged as", "interval", "evidence", "tolerance", "words")


def range_text(metric: Metric) -> str:
    """The values that a metric can take.

    Examples
    --------
    >>> from hyperval.metrics import metric_of
    >>> range_text(metric_of("pd_difference")), range_text(metric_of("z"))
    ('-1 to 1', '')
    """
    if math.isinf(metric.low) and math.isinf(metric.high):
        return ""
    if math.isinf(metric.high):
        return f"{metric.low:g} and more"
    return f"{metric.low:g} to {metric.high:g}"


def tolerance_text(metric: Metric) -> str:
    """How far an accepted number may move."""
    first, other = metric.tolerance
    return _move(first) if first == other else f"{_move(first)}, without one {_move(other)}"


def _move(move: Move) -> str:
    size, of = move
    return {"value": f"{size:g} of the value", "interval": f"{size:g} of half the interval", "unit": f"{size:g}"}[
        of
    ]


def listed() -> Iterator[tuple[str, ...]]:
    """A line for each metric, in the columns of :data:`HEADER`."""
    for m in table().values():
        agreement = "" if math.isnan(m.agreement) else f"{m.agreement:g}"
        yield (
            m.name, m.unit, range_text(m), agreement, m.kind, "" if m.interval == "none" else m.interval,
            m.evidence, tolerance_text(m), m.words,
        )  # fmt: skip


def entry(m: Metric) -> list[str]:
    """The paragraph of one metric for the page of the documentation."""
    lines = [f"### `{m.name}`", "", f"{m.words[0].upper()}{m.words[1:]}.", ""]
    facts = [
        ("formula", f"`{m.formula}`" if m.formula else ""),
        ("computed by", f"`hyperval.{m.function}`"),
        ("unit", m.unit),
        ("range", range_text(m)),
        ("when both sides are equal", "" if math.isnan(m.agreement) else f"{m.agreement:g}"),
        ("better", m.better),
        ("judged as", m.kind),
        ("95 % interval", "" if m.interval == "none" else m.interval),
        ("judged unasked by", _usual(m)),
        ("power wanted against", m.departure),
        ("moves with", "the prediction" if m.evidence == "model" else "the pipeline alone"),
        ("accepted numbers may move by", tolerance_text(m)),
        ("reference", m.reference),
        ("example", _example(m)),
    ]
    return [*lines, *(f"- {name}: {text}" for name, text in facts if text), ""]


def _usual(m: Metric) -> str:
    if m.usual is None:
        return ""
    low, high = m.usual
    return f"at least {low:g}" if math.isinf(high) else f"{low:g} to {high:g}"


def _example(m: Metric) -> str:
    """What gives the row: an expression, a command, or the example in the function's docstring."""
    if not m.example:
        return f"in the docstring of `hyperval.{m.function}`"
    return f"`{m.example}`" if math.isnan(m.gives) else f"`{m.example}` is {m.gives:.6g}"
