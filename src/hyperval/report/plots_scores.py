"""Plots of verdicts on detection: objects and background against their predicted scores, P_D differences."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import betaincinv

from hyperval.processing.roc_reading import detection_at
from hyperval.products import ExceedanceCurve, RocCurve
from hyperval.report.plots import (
    COVERAGE,
    GREY,
    Axis,
    Mark,
    Part,
    Plots,
    View,
    measured_mark,
    predicted_mark,
    rows_axis,
)
from hyperval.report.sides import Sides, both_first, of_side
from hyperval.report.style import COLLECTED, DIFFERENCE_COLOUR, MAX_PANELS, PREDICTED, left_out

Array = npt.NDArray[np.float64]

_MOST_OBJECTS = 40
_MOST_POINTS = 200


def object_score_plots(sides: Sides) -> list[Plots]:
    """Single objects: predicted 95 % interval of the score and what was measured, a row each."""
    pairs = [(key, p, float(m[0])) for key, p, m in _objects(sides) if m.size == 1]
    shown = pairs[:_MOST_OBJECTS]
    if not shown:
        return []
    names = [", ".join(key) for key, *_ in shown]
    at, measured = np.arange(float(len(shown))), np.array([m for *_, m in shown])
    low, middle, high = np.array([np.quantile(draws, [0.025, 0.5, 0.975]) for _, draws, _ in shown]).T
    inside = (low <= measured) & (measured <= high)
    words = [
        f"{name.replace(',', '')}: {m:.3g}, predicted {a:.3g} to {b:.3g}{'' if within else ', outside'}"
        for name, m, a, b, within in zip(names, measured, low, high, inside, strict=True)
    ]
    interval = {"left": low, "right": high, "bottom": at - 0.2, "top": at + 0.2, "y": at}
    marks = [
        Mark("bars", interval, "predicted 95 %", PREDICTED.colour, alpha=0.3, words=tuple(words)),
        Mark("dots", {"x": middle, "y": at}, "predicted median", PREDICTED.colour, marker="tick"),
    ]
    for own, label in ((inside, "measured"), (~inside, "measured, outside")):
        if own.any():
            own_words = tuple(text for text, one in zip(words, own, strict=True) if one)
            columns = {"x": measured[own], "y": at[own]}
            marks.append(
                measured_mark("dots", columns, label, marker="square", hollow=own is not inside, words=own_words)
            )
    view = View(Axis("greatest score of the object [1]"), (Part(rows_axis(names), tuple(marks), (("x", 0.0),)),))
    title = f"Score of each object: predicted interval and measured value{_part(len(shown), len(pairs))}"
    alt = f"Measured score of each object beside its predicted 95 % interval. {'; '.join(words)}."
    return [Plots("object-scores", "scores", title, alt, {"": view})]


def transform_plots(sides: Sides) -> list[Plots]:
    """Probability integral transforms of all objects: in order, with a band, and as a histogram, by detector."""
    by_detector: dict[str, list[Array]] = {}
    for (_, detector), draws, measured in _objects(sides):
        by_detector.setdefault(detector, []).append(_transform(measured, draws))
    views, words = {}, []
    for detector, parts in by_detector.items():
        u = np.sort(np.concatenate(parts))
        inside = float(np.mean((u >= 0.025) & (u <= 0.975)))
        words.append(f"{detector}: {u.size} objects, {inside:.0%} in the central 95 %")
        views[detector] = View(
            Axis("probability of a lower score [1]", ends=(0.0, 1.0)), (_ordered(u), _histogram(u))
        )
    if not views:
        return []
    return [Plots(
        "object-transforms", "scores",
        "Predicted probability of a lower score than measured, all objects: uniform where predictions are right",
        "Probability integral transforms of the objects' scores in order against the uniform distribution with its "
        "95 % band for independent objects, and their histogram with that of a uniform sample. Objects share "
        f"errors of the inputs, which the band leaves out. {'; '.join(words)}.", views,
    )]  # fmt: skip


def exceedance_plots(sides: Sides) -> list[Plots]:
    """Share of background pixels above a score, predicted and measured, on a logarithmic axis."""
    predicted, measured = (of_side(side, "exceedance") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted]
    views, words = {}, []
    for key in every[:MAX_PANELS]:
        views[", ".join(key)], text = _tail(predicted[key], measured.get(key), bool(measured))
        words.append(f"{' '.join(key)}: {text}")
    if not views:
        return []
    title = f"False-alarm probability against the threshold{_part(len(views), len(every))}"
    alt = f"Part of the background above each score, predicted (dashed) and measured. {' '.join(words)}"
    legend = "measured with its 95 % interval, by blocks of the image; predicted with that of its fitted law"
    return [Plots("exceedance", "scores", title, alt, views, legend if measured else "")]


def roc_difference_plots(sides: Sides, margin: float | None) -> list[Plots]:
    """Predicted minus measured P_D against P_FA with its 95 % interval, for the curves with the most targets."""
    predicted, measured = (of_side(side, "roc") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted and key in measured]
    # Objects are independent and pixels of one object are not: curves by object first, where there are several.
    every.sort(
        key=lambda key: (key[2] != "object" or (measured[key].n_target or 0) < 2, -(measured[key].n_target or 0))
    )
    views, words = {}, []
    for key in every[:MAX_PANELS]:
        name = f"{key[0]}, {key[1]}, by {key[2]}"
        views[name], text = _difference(predicted[key], measured[key], margin)
        words.append(f"{', '.join(key)}: {text}.")
    if not views:
        return []
    title = f"ROC: predicted minus measured P_D{left_out([list(views)], every)}"
    alt = f"Predicted minus measured probability of detection. {' '.join(words)}"
    legend = "" if margin is None else f"dotted: equivalence margin {margin:g}"
    return [Plots("roc-difference", "roc", title, alt, views, legend)]


def _objects(sides: Sides) -> list[tuple[tuple[str, str], Array, Array]]:
    """(subject, detector), predicted draws and measured scores of what both sides hold."""
    predicted, measured = (of_side(side, "object_scores") for side in sides)
    out = []
    for key, scores in predicted.items():
        if key in measured:
            values = measured[key].values[np.isfinite(measured[key].values)]
            if values.size:
                out.append((key, scores.values.ravel(), values))
    return out


def _part(shown: int, every: int) -> str:
    """What a caption adds when not all is drawn; the rows of all stand in the results table."""
    return "" if shown == every else f"; {shown} of {every} are drawn, all have rows in results.csv"


def _transform(measured: Array, draws: Array) -> Array:
    return np.asarray((np.searchsorted(np.sort(draws), measured) + 0.5) / (draws.size + 1.0))


def _ordered(u: Array) -> Part:
    n = u.size
    rank = np.arange(1, n + 1)
    at = (rank - 0.5) / n
    low, high = (betaincinv(rank, n + 1 - rank, q) for q in (0.025, 0.975))
    band = Mark("area", {"x": at, "low": low, "high": high}, "95 % of independent objects", PREDICTED.colour)
    uniform = Mark("line", {"x": np.array([0.0, 1.0]), "y": np.array([0.0, 1.0])}, "uniform", GREY, "dotted")
    objects = measured_mark("line", {"x": at, "y": u}, "objects, in order")
    return Part(Axis("transform value [1]", ends=(0.0, 1.0)), (band, uniform, objects))


def _histogram(u: Array) -> Part:
    bins = 10 if u.size >= 50 else 5
    counts, edges = np.histogram(u, bins, (0.0, 1.0))
    expected = u.size / bins
    half = COVERAGE * math.sqrt(expected * (1.0 - 1.0 / bins))
    ends = np.array([0.0, 1.0])
    band = {"x": ends, "low": np.full(2, max(expected - half, 0.0)), "high": np.full(2, expected + half)}
    bars = {
        "left": edges[:-1],
        "right": edges[1:],
        "bottom": np.zeros(bins),
        "top": counts.astype(float),
        "y": counts.astype(float),
    }
    marks = (
        Mark("bars", bars, colour=COLLECTED.colour, words=tuple(f"{n} objects" for n in counts)),
        Mark("area", band, colour=PREDICTED.colour),
        Mark("line", {"x": ends, "y": np.full(2, expected)}, colour=GREY, dash="dotted"),
    )
    return Part(Axis("objects [1]", ends=(0.0, max(float(counts.max()), expected + half) * 1.1)), marks)


def _tail(predicted: ExceedanceCurve, measured: ExceedanceCurve | None, paired: bool) -> tuple[View, str]:
    floor, words, span = 1e-6, "", None
    marks = []
    if paired:
        columns = dict.fromkeys(("x", "y", "low", "high"), np.empty(0))
        if measured is not None:
            keep = measured.probability > 0
            x, p = measured.threshold[keep], measured.probability[keep]
            low, high = np.nan_to_num(measured.lower[keep], nan=1e-9), np.nan_to_num(measured.upper[keep], nan=1.0)
            columns = {"x": x, "y": p, "low": np.maximum(low, 1e-9), "high": high}
            floor = 0.3 * float(p.min())
            span = x[0] - 0.05 * (x[-1] - x[0]), x[-1] + 0.35 * (x[-1] - x[0])
            at = int(np.argmin(np.abs(np.log(p) - math.log(1e-2))))
            model = float(np.exp(np.interp(x[at], predicted.threshold, np.log(predicted.probability))))
            words = f"at score {x[at]:.3g} measured {p[at]:.2g}, predicted {model:.2g}."
        marks.append(measured_mark("line", _thinned(columns)))
    law = {"x": predicted.threshold, "y": predicted.probability, "low": predicted.lower, "high": predicted.upper}
    marks.append(predicted_mark("line", _thinned(law)))
    y = Axis("part of the background above [1]", "log", ends=(floor, 1.0))
    return View(Axis("score [1]", ends=span), (Part(y, tuple(marks)),)), words


def _thinned(columns: dict[str, Any]) -> dict[str, Any]:
    """A curve of at most so many points, its ends among them."""
    size = columns["x"].size
    keep = (
        np.unique(np.linspace(0, size - 1, _MOST_POINTS).round().astype(int))
        if size > _MOST_POINTS
        else slice(None)
    )
    return {name: values[keep] for name, values in columns.items()}


def _difference(predicted: RocCurve, measured: RocCurve, margin: float | None) -> tuple[View, str]:
    low = max(float(predicted.pfa[0]), float(measured.pfa[measured.pfa > 0].min()), 1e-9)
    if measured.n_background:
        low = max(low, 3.0 / measured.n_background)
    x = np.geomspace(low, min(float(predicted.pfa[-1]), float(measured.pfa[-1])), 120)
    p, p_low, p_high = _at(predicted, x)
    o, o_low, o_high = _at(measured, x)
    difference = p - o
    below = difference - np.hypot(p - p_low, o_high - o)
    above = difference + np.hypot(p_high - p, o - o_low)
    at = int(np.argmin(np.abs(np.log(x) - math.log(1e-2))))
    words = f"{difference[at]:+.2f} ({below[at]:+.2f} to {above[at]:+.2f}) at P_FA {x[at]:.1e}"
    columns = {"x": x, "y": difference, "low": below, "high": above}
    line = Mark("line", columns, "predicted minus measured, 95 % interval", DIFFERENCE_COLOUR)
    places = (0.0,) if margin is None else (0.0, -margin, margin)
    part = Part(Axis("difference of P_D [1]", ends=(-1.05, 1.05)), (line,), tuple(("y", place) for place in places))
    return View(Axis("P_FA per pixel [1]", "log", ends=(float(x[0]), float(x[-1]))), (part,)), words


def _at(curve: RocCurve, pfa: Array) -> tuple[Array, ...]:
    inside = np.clip(pfa, curve.pfa[0], curve.pfa[-1])
    return tuple(detection_at(curve, inside, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))
