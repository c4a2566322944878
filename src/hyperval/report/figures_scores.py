"""Figures of verdicts on detection: objects and background against their predicted scores, P_D differences."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.special import betaincinv

from hyperval.processing.roc_reading import detection_at
from hyperval.products import ExceedanceCurve, RocCurve
from hyperval.report import style
from hyperval.report.panels import Entries, line_entries, name_rows, of_side, small_multiples
from hyperval.report.sides import Sides, both_first
from hyperval.report.style import COLLECTED, DIFFERENCE_COLOUR, PREDICTED, Drawing

Array = npt.NDArray[np.float64]

_MOST_OBJECTS = 40
_GREY = "#777777"


def object_score_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Single objects: predicted 95 % interval of the score and what was measured, a row each."""
    pairs = [(key, p, m) for key, p, m in _objects(sides) if m.size == 1]
    shown = pairs[:_MOST_OBJECTS]
    if not shown:
        return []
    figure = style.new_figure(10.0, 1.4 + 0.24 * len(shown), "Score of each object", simulated)
    axes = figure.add_subplot()
    words = []
    for at, ((subject, detector), draws, measured) in enumerate(shown):
        low, middle, high = np.quantile(draws, [0.025, 0.5, 0.975])
        inside = low <= measured[0] <= high
        axes.plot([low, high], [at, at], color=PREDICTED.colour, linewidth=5.0, alpha=0.3, solid_capstyle="butt")
        axes.plot(middle, at, "|", color=PREDICTED.colour, markersize=9)
        axes.plot(
            measured[0], at, COLLECTED.marker, color=COLLECTED.colour, markersize=5,
            markerfacecolor=COLLECTED.colour if inside else "white", markeredgewidth=1.4,
        )  # fmt: skip
        outside = "" if inside else ", outside"
        words.append(f"{subject} {detector}: {measured[0]:.3g}, predicted {low:.3g} to {high:.3g}{outside}")
    axes.axvline(0.0, color=_GREY, linewidth=0.8)
    name_rows(axes, [style.shortened(f"{s}, {d}") for (s, d), _, _ in shown], 0.4, 0.6)
    axes.set_xlabel("greatest score over the object's pixels [1]")
    style.add_legend(
        figure,
        [
            (style.interval_handle(PREDICTED.colour), "predicted 95 %"),
            (Line2D([], [], color=PREDICTED.colour, marker="|", linestyle=""), "predicted median"),
            (Line2D([], [], color=COLLECTED.colour, marker=COLLECTED.marker, linestyle=""), "measured"),
            (Line2D([], [], color=COLLECTED.colour, marker=COLLECTED.marker, linestyle="",
                    markerfacecolor="white"), "measured, outside"),
        ],
    )  # fmt: skip
    title = f"Score of each object: predicted interval and measured value{_part(len(shown), len(pairs))}"
    alt = f"Measured score of each object beside its predicted 95 % interval. {'; '.join(words)}."
    return [style.vector_drawing(figure, "object-scores", "scores", title, alt)]


def transform_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Probability integral transforms of all objects: in order, with a band, and as a histogram, by detector."""
    by_detector: dict[str, list[Array]] = {}
    for (_, detector), draws, measured in _objects(sides):
        by_detector.setdefault(detector, []).append(_transform(measured, draws))
    if not by_detector:
        return []
    figure = style.new_figure(10.0, 0.9 + 2.6 * len(by_detector), "All objects together", simulated)
    words = []
    for at, (detector, parts) in enumerate(by_detector.items()):
        u = np.sort(np.concatenate(parts))
        inside = float(np.mean((u >= 0.025) & (u <= 0.975)))
        words.append(f"{detector}: {u.size} objects, {inside:.0%} in the central 95 %")
        _ordered(figure.add_subplot(len(by_detector), 2, 2 * at + 1), u, f"{detector}: in order")
        _histogram(figure.add_subplot(len(by_detector), 2, 2 * at + 2), u, f"{detector}: histogram")
    style.add_legend(
        figure,
        [
            (Line2D([], [], color=COLLECTED.colour, marker=".", linestyle="-"), "objects"),
            (style.interval_handle(PREDICTED.colour), "95 % of independent objects"),
            (Line2D([], [], color=_GREY, linestyle=":"), "uniform"),
        ],
    )
    title = "Predicted probability of a lower score than measured, all objects: uniform where predictions are right"
    alt = (
        "Probability integral transforms of the objects' scores in order against the uniform distribution with its "
        "95 % band for independent objects, and their histogram with that of a uniform sample. Objects share "
        f"errors of the inputs, which the band leaves out. {'; '.join(words)}."
    )
    return [style.vector_drawing(figure, "object-transforms", "scores", title, alt)]


def exceedance_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Share of background pixels above a score, predicted and measured, on a logarithmic axis."""
    predicted, measured = (of_side(side, "exceedance") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted]
    pages = style.pages(every, 1)
    drawings = []
    for keys in pages:
        labels = ("score [1]", "part of the background\nabove the score [1]")
        figure, panels = small_multiples("Background above a score", len(keys), labels, simulated, row_in=2.5)
        words = []
        for key, (axes,) in zip(keys, panels, strict=True):
            words.append(_tail_panel(axes, key, predicted[key], measured.get(key)))
            axes.set_title(style.plain(f"{key[0]}, {key[1]}"), loc="left", fontsize=8.5)
        band = style.interval_handle(COLLECTED.colour), "95 % interval, by blocks of the image"
        fitted = any(np.any(predicted[key].upper > predicted[key].probability) for key in keys)
        law = [(style.interval_handle(PREDICTED.colour), "95 % interval of its fitted law")] if fitted else []
        style.add_legend(figure, [*line_entries(True, True), band, *law])
        alt = f"Part of the background above each score, predicted (dashed) and measured. {' '.join(words)}"
        title = f"False-alarm probability against the threshold{_part(len(keys), len(every))}"
        drawings.append(style.vector_drawing(figure, "exceedance", "scores", title, alt))
    return drawings


def roc_difference_figures(sides: Sides, margin: float | None, *, simulated: bool) -> list[Drawing]:
    """Predicted minus measured P_D against P_FA with its 95 % interval, for the curves with the most targets."""
    predicted, measured = (of_side(side, "roc") for side in sides)
    every = [key for key in both_first(predicted, measured) if key in predicted and key in measured]
    # Objects are independent and pixels of one object are not: curves by object first, where there are several.
    every.sort(
        key=lambda key: (key[2] != "object" or (measured[key].n_target or 0) < 2, -(measured[key].n_target or 0))
    )
    pages = style.pages(every, 1)
    drawings = []
    for keys in pages:
        labels = ("$P_{FA}$ per pixel [1]", "$P_D$ predicted\nminus measured [1]")
        figure, panels = small_multiples("Difference of P_D", len(keys), labels, simulated, row_in=2.3)
        words = []
        for key, (axes,) in zip(keys, panels, strict=True):
            words.append(f"{', '.join(key)}: {_difference_panel(axes, predicted[key], measured[key], margin)}.")
            name = f"{style.shortened(key[0], 24)}, {style.shortened(key[1], 12)}, by {key[2]}"
            axes.set_title(style.plain(name), loc="left", fontsize=8.5)
        entries: Entries = [
            (Line2D([], [], color=DIFFERENCE_COLOUR), "difference"),
            (style.interval_handle(DIFFERENCE_COLOUR), "95 % interval"),
        ]
        if margin is not None:
            entries.append((Line2D([], [], color=_GREY, linestyle="--"), f"equivalence margin {margin:g}"))
        style.add_legend(figure, entries)
        alt = f"Predicted minus measured probability of detection. {' '.join(words)}"
        title = f"ROC: predicted minus measured P_D{style.left_out(pages, every)}"
        drawings.append(style.vector_drawing(figure, "roc-difference", "roc", title, alt))
    return drawings


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


def _ordered(axes: Axes, u: Array, title: str) -> None:
    n = u.size
    rank = np.arange(1, n + 1)
    at = (rank - 0.5) / n
    low, high = (betaincinv(rank, n + 1 - rank, q) for q in (0.025, 0.975))
    axes.fill_between(at, low, high, color=PREDICTED.colour, alpha=0.25, linewidth=0)
    axes.plot([0, 1], [0, 1], color=_GREY, linestyle=":")
    axes.plot(at, u, color=COLLECTED.colour, marker="." if n <= 60 else None)
    axes.set_title(style.plain(title), loc="left", fontsize=8.5)
    axes.set_xlabel("expected of a uniform sample [1]")
    axes.set_ylabel("transform value [1]")


def _histogram(axes: Axes, u: Array, title: str) -> None:
    bins = 10 if u.size >= 50 else 5
    counts, edges = np.histogram(u, bins, (0.0, 1.0))
    expected = u.size / bins
    half = 1.96 * math.sqrt(expected * (1.0 - 1.0 / bins))
    axes.axhspan(max(expected - half, 0.0), expected + half, color=PREDICTED.colour, alpha=0.25, linewidth=0)
    axes.axhline(expected, color=_GREY, linestyle=":")
    axes.stairs(counts, edges, color=COLLECTED.colour, linewidth=1.4)
    axes.set_title(style.plain(title), loc="left", fontsize=8.5)
    axes.set_xlabel("transform value [1]")
    axes.set_ylabel("objects")
    axes.set_ylim(0.0, max(float(counts.max()), expected + half) * 1.1)


def _tail_panel(
    axes: Axes, key: tuple[str, str], predicted: ExceedanceCurve, measured: ExceedanceCurve | None
) -> str:
    floor, words = 1e-6, f"{key[0]} {key[1]}: "
    if measured is not None:
        keep = measured.probability > 0
        x, p = measured.threshold[keep], measured.probability[keep]
        low, high = np.nan_to_num(measured.lower[keep], nan=1e-9), np.nan_to_num(measured.upper[keep], nan=1.0)
        axes.fill_between(x, np.maximum(low, 1e-9), high, color=COLLECTED.colour, alpha=0.2, linewidth=0)
        axes.plot(x, p, color=COLLECTED.colour, linestyle=COLLECTED.line)
        floor = 0.3 * float(p.min())
        axes.set_xlim(x[0] - 0.05 * (x[-1] - x[0]), x[-1] + 0.35 * (x[-1] - x[0]))
        at = int(np.argmin(np.abs(np.log(p) - math.log(1e-2))))
        model = float(np.exp(np.interp(x[at], predicted.threshold, np.log(predicted.probability))))
        words += f"at score {x[at]:.3g} measured {p[at]:.2g}, predicted {model:.2g}."
    x, low, high = predicted.threshold, predicted.lower, predicted.upper
    axes.fill_between(x, low, high, color=PREDICTED.colour, alpha=0.2, linewidth=0)
    axes.plot(predicted.threshold, predicted.probability, color=PREDICTED.colour, linestyle=PREDICTED.line)
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_yscale("log")
    axes.set_ylim(floor, 1.0)
    style.log_ticks(axes.yaxis)
    return words


def _difference_panel(axes: Axes, predicted: RocCurve, measured: RocCurve, margin: float | None) -> str:
    low = max(float(predicted.pfa[0]), float(measured.pfa[measured.pfa > 0].min()), 1e-9)
    if measured.n_background:
        low = max(low, 3.0 / measured.n_background)
    x = np.geomspace(low, min(float(predicted.pfa[-1]), float(measured.pfa[-1])), 120)
    p, p_low, p_high = _at(predicted, x)
    o, o_low, o_high = _at(measured, x)
    difference = p - o
    below = difference - np.hypot(p - p_low, o_high - o)
    above = difference + np.hypot(p_high - p, o - o_low)
    axes.fill_between(x, below, above, color=DIFFERENCE_COLOUR, alpha=0.2, linewidth=0)
    axes.plot(x, difference, color=DIFFERENCE_COLOUR)
    axes.axhline(0.0, color=_GREY, linewidth=0.8)
    if margin is not None:
        for side in (-margin, margin):
            axes.axhline(side, color=_GREY, linewidth=0.8, linestyle="--")
    axes.set_xscale("log")
    axes.set_ylim(-1.05, 1.05)
    style.log_ticks(axes.xaxis)
    at = int(np.argmin(np.abs(np.log(x) - math.log(1e-2))))
    return f"{difference[at]:+.2f} ({below[at]:+.2f} to {above[at]:+.2f}) at P_FA {x[at]:.1e}"


def _at(curve: RocCurve, pfa: Array) -> tuple[Array, ...]:
    inside = np.clip(pfa, curve.pfa[0], curve.pfa[-1])
    return tuple(detection_at(curve, inside, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))
