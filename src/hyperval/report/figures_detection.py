"""Figures of detection: ROC curves, score distributions, target areas."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from hyperval.processing.roc_reading import detection_at
from hyperval.products import RocCurve
from hyperval.report import style
from hyperval.report.panels import (
    COVERAGE,
    GREY,
    Entries,
    dot_entries,
    interval_entry,
    line_entries,
    name_rows,
    of_side,
    small_multiples,
)
from hyperval.report.sides import Sides, best_counted, both_first
from hyperval.report.style import COLLECTED, PREDICTED, Drawing, Look

_MOST_ROWS = 30
_LOWEST_PFA = 1e-9
_MOST_CURVES = 2 * style.MAX_PANELS
_Key = tuple[str, str]
_Estimates = Mapping[Any, Any]
_Dot = tuple[float, float]


def roc_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """P_D against P_FA on a logarithmic axis, a panel for each subject, detector and unit."""
    predicted, measured = of_side(sides[0], "roc"), of_side(sides[1], "roc")
    every = both_first(predicted, measured)
    # Where anything can be compared, what only one side holds is left to products.nc.
    pairs = [key for key in every if key in predicted and key in measured]
    pages = style.pages(best_counted(pairs or every, measured, _MOST_CURVES))
    drawings = []
    for number, keys in enumerate(pages, start=1):
        labels = ("$P_{FA}$ per pixel [1]", "$P_D$ [1]")
        figure, panels = small_multiples("Detection against false alarms", len(keys), labels, simulated, row_in=2.7)
        words = []
        low = _lowest_pfa([h[k] for h in (predicted, measured) for k in keys if k in h])
        for key, (axes,) in zip(keys, panels, strict=True):
            _roc_panel(axes, predicted.get(key), measured.get(key), low)
            axes.set_title(
                style.plain(_roc_title(key)) + "\n" + _counted(measured.get(key)), loc="left", fontsize=8.5
            )
            words.append(_roc_words(key, predicted.get(key), measured.get(key)))
        style.add_legend(figure, _roc_legend(predicted, measured))
        name = "roc" if len(pages) == 1 else f"roc-{number}"
        alt = (
            "Probability of detection against probability of false alarm (logarithmic), predicted (dashed) and "
            f"measured (steps), with 95 % intervals. {' '.join(words)}"
        )
        title = f"ROC: predicted and measured{style.left_out(pages, every)}"
        drawings.append(style.vector_drawing(figure, name, "roc", title, alt))
    return drawings


def score_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Mean and 95 % range of each population's score."""
    predicted, measured = of_side(sides[0], "scores"), of_side(sides[1], "scores")
    every = both_first(predicted, measured)
    keys = every[:_MOST_ROWS]
    if not keys:
        return []
    figure = style.new_figure(10.0, 1.6 + 0.34 * len(keys), "Detector scores", simulated)
    axes = figure.add_subplot()
    _dots_of(axes, keys, predicted, measured, lambda score: (score.mean, COVERAGE * score.sd))
    axes.axvline(0.0, color="#777777", linewidth=0.8)
    axes.axvline(1.0, color="#777777", linewidth=0.8, linestyle=":")
    _row_labels(axes, keys, {k: measured[k].n for k in keys if k in measured})
    axes.set_xlabel("score [1] (dot: mean; bar: mean ± 1.96 standard deviations)")
    style.add_legend(figure, dot_entries(predicted, measured))
    words = _in_words(keys, predicted, measured, lambda score: f"{score.mean:.3g} ± {score.sd:.2g}")
    title = f"Score distributions: predicted and measured{style.left_out([keys], every)}"
    alt = f"Mean and standard deviation of the detector scores. {words}."
    return [style.vector_drawing(figure, "scores", "scores", title, alt)]


def abundance_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Area of each target from its abundance, predicted and measured."""
    # Areas that both sides estimate against a nominal one have a figure of their own.
    predicted, measured = (
        {k: a for k, a in of_side(side, "abundance").items() if a.nominal_m2 is None} for side in sides
    )
    every = both_first(predicted, measured)
    keys = every[:_MOST_ROWS]
    if not keys:
        return []
    figure = style.new_figure(10.0, 1.6 + 0.34 * len(keys), "Target area from abundance", simulated)
    axes = figure.add_subplot()
    _dots_of(axes, keys, predicted, measured, lambda area: (area.area_m2, COVERAGE * area.standard_uncertainty))
    areas = np.array([h[k].area_m2 for h in (predicted, measured) for k in keys if k in h])
    areas = areas[np.isfinite(areas)]
    if areas.size and areas.min() > 0 and areas.max() > 30 * areas.min():
        axes.set_xscale("log")
        axes.set_xlim(areas.min() / 4, areas.max() * 2.5)
        style.log_ticks(axes.xaxis)
    else:
        axes.axvline(0.0, color="#777777", linewidth=0.8)
    _row_labels(axes, keys, {})
    axes.set_xlabel("area [m²] (bar: 95 % interval)")
    style.add_legend(figure, dot_entries(predicted, measured))
    words = _in_words(keys, predicted, measured, lambda area: f"{area.area_m2:.3g} m²")
    title = f"Target area from the sum of abundances: predicted and measured{style.left_out([keys], every)}"
    return [style.vector_drawing(figure, "abundance", "abundance", title, f"Target areas. {words}.")]


def _dots_of(
    axes: Axes, keys: Sequence[_Key], predicted: _Estimates, measured: _Estimates, dot: Callable[[Any], _Dot]
) -> None:
    """A row for each key: the dot with its bar of either side that has one."""
    for estimates, look, shift in ((predicted, PREDICTED, -0.15), (measured, COLLECTED, 0.15)):
        _dots(axes, [(at + shift, *dot(estimates[key])) for at, key in enumerate(keys) if key in estimates], look)


def _in_words(keys: Sequence[_Key], predicted: _Estimates, measured: _Estimates, text: Callable[[Any], str]) -> str:
    sides = (("predicted", predicted), ("measured", measured))
    return "; ".join(
        f"{subject} {detector}: "
        + ", ".join(
            f"{name} {text(side[subject, detector])}" for name, side in sides if (subject, detector) in side
        )
        for subject, detector in keys
    )


def _roc_panel(axes: Axes, predicted: RocCurve | None, measured: RocCurve | None, low: float) -> None:
    if predicted is not None:
        keep = predicted.pfa > 0
        x = predicted.pfa[keep]
        axes.fill_between(
            x, predicted.pd_lower[keep], predicted.pd_upper[keep], color=PREDICTED.colour, alpha=0.2, linewidth=0
        )
        axes.plot(x, predicted.pd[keep], color=PREDICTED.colour, linestyle=PREDICTED.line)
    if measured is not None:
        keep = measured.pfa > 0
        x = measured.pfa[keep]
        axes.fill_between(
            x, measured.pd_lower[keep], measured.pd_upper[keep],
            step="post", color=COLLECTED.colour, alpha=0.2, linewidth=0,
        )  # fmt: skip
        axes.plot(x, measured.pd[keep], color=COLLECTED.colour, linestyle=COLLECTED.line, drawstyle="steps-post")
        if measured.n_background:
            axes.axvline(1.0 / measured.n_background, color=GREY, linewidth=1.0, linestyle=":")
    axes.set_xscale("log")
    axes.set_xlim(low, 1.0)
    axes.set_ylim(-0.02, 1.04)
    style.log_ticks(axes.xaxis)


def _lowest_pfa(curves: list[RocCurve]) -> float:
    """A decade below which no panel of the figure has anything to show."""
    lowest = [float(c.pfa[c.pfa > 0].min()) for c in curves if (c.pfa > 0).any()]
    limits = [0.3 / c.n_background for c in curves if c.n_background]
    # Where something was measured, two decades past what the background can resolve is enough.
    floor = min(limits) / 100 if limits else _LOWEST_PFA
    return max(min([*lowest, *limits], default=1e-3), floor, _LOWEST_PFA)


def _counted(curve: RocCurve | None) -> str:
    """What a measured curve rests on, in a line; empty for no curve."""
    if curve is None:
        return "not measured"
    parts = []
    if curve.n_target is not None:
        parts.append(f"{curve.n_target:,} {curve.unit}{'s' if curve.n_target != 1 else ''}")
    if curve.n_background is not None:
        parts.append(f"{curve.n_background:,} background px")
    return ", ".join(part.replace(",", "\u202f") for part in parts) or "counts unknown"


def _roc_title(key: tuple[str, str, str]) -> str:
    subject, detector, unit = key
    return f"{style.shortened(subject, 24)}, {style.shortened(detector, 12)}, by {unit}"


def _roc_words(key: tuple[str, str, str], predicted: RocCurve | None, measured: RocCurve | None) -> str:
    words = []
    for name, curve in (("predicted", predicted), ("measured", measured)):
        if curve is not None and curve.pfa.size:
            at = float(np.clip(1e-3, curve.pfa[0], curve.pfa[-1]))
            pd, low, high = (detection_at(curve, at, y) for y in (curve.pd, curve.pd_lower, curve.pd_upper))
            words.append(f"{name} P_D {pd:.2f} ({low:.2f} to {high:.2f}) at P_FA {at:.1e}")
    return f"{', '.join(key)}: {'; '.join(words) or 'no points'}."


def _roc_legend(predicted: Mapping[Any, Any], measured: Mapping[Any, RocCurve]) -> Entries:
    entries = [*line_entries(predicted, measured), interval_entry(predicted, measured)]
    if any(curve.n_background for curve in measured.values()):
        entries.append((Line2D([], [], color=GREY, linestyle=":"), "resolution: 1 / background pixels"))
    return entries


def _dots(axes: Axes, rows: list[tuple[float, float, float]], look: Look) -> None:
    if rows:
        y, x, half = (np.array(column) for column in zip(*rows, strict=True))
        axes.errorbar(
            x, y, xerr=np.nan_to_num(half), fmt=look.marker, color=look.colour,
            markerfacecolor=look.face, markersize=5, linewidth=1.3, capsize=2.5,
        )  # fmt: skip


def _row_labels(axes: Axes, keys: list[tuple[str, str]], counts: Mapping[Any, int | None]) -> None:
    labels = []
    for subject, detector in keys:
        n = counts.get((subject, detector))
        tail = "" if n is None else f"  (n = {n:,})".replace(",", "\u202f")
        labels.append(f"{style.shortened(subject)}, {detector}{tail}")
    name_rows(axes, labels)
