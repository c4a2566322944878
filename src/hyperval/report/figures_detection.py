"""Figures of detection: ROC curves, score distributions, target areas."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from hyperval.processing.roc_reading import detection_at
from hyperval.products import Products, RocCurve
from hyperval.report import style
from hyperval.report.sides import Sides, best_counted, both_first
from hyperval.report.style import COLLECTED, PREDICTED, Drawing, Look

_COVERAGE = 1.96
_MOST_ROWS = 30
_LOWEST_PFA = 1e-9
_MOST_CURVES = 2 * style.MAX_PANELS
_Key = tuple[str, str]
_Estimates = Mapping[Any, Any]
_Dot = tuple[float, float]


def roc_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """P_D against P_FA on a logarithmic axis, a panel for each subject, detector and unit."""
    predicted, measured = _of_side(sides[0], "roc"), _of_side(sides[1], "roc")
    every = both_first(predicted, measured)
    # Where anything can be compared, what only one side holds is left to products.nc.
    pairs = [key for key in every if key in predicted and key in measured]
    pages = style.pages(best_counted(pairs or every, measured, _MOST_CURVES))
    drawings = []
    for number, keys in enumerate(pages, start=1):
        columns = style.column_count(len(keys))
        rows = math.ceil(len(keys) / columns)
        figure = style.new_figure(10.0, 1.0 + 2.7 * rows, "Detection against false alarms", simulated)
        words = []
        low = _lowest_pfa([h[k] for h in (predicted, measured) for k in keys if k in h])
        for at, key in enumerate(keys):
            axes = figure.add_subplot(rows, columns, at + 1)
            _roc_panel(axes, predicted.get(key), measured.get(key), low)
            axes.set_title(
                style.plain(_roc_title(key)) + "\n" + _counted(measured.get(key)), loc="left", fontsize=8.5
            )
            words.append(_roc_words(key, predicted.get(key), measured.get(key)))
            if at % columns == 0:
                axes.set_ylabel("$P_D$ [1]")
            if at + columns >= len(keys):
                axes.set_xlabel("$P_{FA}$ per pixel [1]")
        style.add_legend(figure, _roc_legend(predicted, measured))
        name = "roc" if len(pages) == 1 else f"roc-{number}"
        alt = (
            "Probability of detection against probability of false alarm (logarithmic), predicted (dashed) and "
            f"measured (steps), with 95 % intervals. {' '.join(words)}"
        )
        drawings.append(
            Drawing(
                name,
                "roc",
                f"ROC: predicted and measured{style.left_out(pages, every)}",
                alt,
                style.vector_bytes(figure),
                "svg",
            ),
        )
    return drawings


def score_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Mean and 95 % range of each population's score."""
    predicted, measured = _of_side(sides[0], "scores"), _of_side(sides[1], "scores")
    every = both_first(predicted, measured)
    keys = every[:_MOST_ROWS]
    if not keys:
        return []
    figure = style.new_figure(10.0, 1.6 + 0.34 * len(keys), "Detector scores", simulated)
    axes = figure.add_subplot()
    _dots_of(axes, keys, predicted, measured, lambda score: (score.mean, _COVERAGE * score.sd))
    axes.axvline(0.0, color="#777777", linewidth=0.8)
    axes.axvline(1.0, color="#777777", linewidth=0.8, linestyle=":")
    _row_labels(axes, keys, {k: measured[k].n for k in keys if k in measured})
    axes.set_xlabel("score [1] (dot: mean; bar: mean ± 1.96 standard deviations)")
    style.add_legend(figure, _dot_legend(predicted, measured))
    words = _in_words(keys, predicted, measured, lambda score: f"{score.mean:.3g} ± {score.sd:.2g}")
    title = f"Score distributions: predicted and measured{style.left_out([keys], every)}"
    alt = f"Mean and standard deviation of the detector scores. {words}."
    return [Drawing("scores", "scores", title, alt, style.vector_bytes(figure), "svg")]


def abundance_figures(sides: Sides, *, simulated: bool) -> list[Drawing]:
    """Area of each target from its abundance, predicted and measured."""
    # Areas that both sides estimate against a nominal one have a figure of their own.
    predicted, measured = (
        {k: a for k, a in _of_side(side, "abundance").items() if a.nominal_m2 is None} for side in sides
    )
    every = both_first(predicted, measured)
    keys = every[:_MOST_ROWS]
    if not keys:
        return []
    figure = style.new_figure(10.0, 1.6 + 0.34 * len(keys), "Target area from abundance", simulated)
    axes = figure.add_subplot()
    _dots_of(axes, keys, predicted, measured, lambda area: (area.area_m2, _COVERAGE * area.standard_uncertainty))
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
    style.add_legend(figure, _dot_legend(predicted, measured))
    words = _in_words(keys, predicted, measured, lambda area: f"{area.area_m2:.3g} m²")
    title = f"Target area from the sum of abundances: predicted and measured{style.left_out([keys], every)}"
    return [Drawing("abundance", "abundance", title, f"Target areas. {words}.", style.vector_bytes(figure), "svg")]


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
            axes.axvline(1.0 / measured.n_background, color="#444444", linewidth=1.0, linestyle=":")
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


def _roc_legend(predicted: Mapping[Any, Any], measured: Mapping[Any, RocCurve]) -> list[tuple[Any, str]]:
    entries: list[tuple[Any, str]] = []
    colours = []
    for side, look, name in ((predicted, PREDICTED, "predicted"), (measured, COLLECTED, "measured")):
        if side:
            entries.append((Line2D([], [], color=look.colour, linestyle=look.line), name))
            colours.append(look.colour)
    entries.append((style.interval_handle(*colours), "95 % interval"))
    if any(curve.n_background for curve in measured.values()):
        entries.append((Line2D([], [], color="#444444", linestyle=":"), "resolution: 1 / background pixels"))
    return entries


def _dots(axes: Axes, rows: list[tuple[float, float, float]], look: Look) -> None:
    if rows:
        y, x, half = (np.array(column) for column in zip(*rows, strict=True))
        face = "white" if look is PREDICTED else look.colour
        axes.errorbar(
            x, y, xerr=np.nan_to_num(half), fmt=look.marker, color=look.colour,
            markerfacecolor=face, markersize=5, linewidth=1.3, capsize=2.5,
        )  # fmt: skip


def _row_labels(axes: Axes, keys: list[tuple[str, str]], counts: Mapping[Any, int | None]) -> None:
    labels = []
    for subject, detector in keys:
        n = counts.get((subject, detector))
        tail = "" if n is None else f"  (n = {n:,})".replace(",", "\u202f")
        labels.append(style.plain(f"{style.shortened(subject)}, {detector}{tail}"))
    axes.set_yticks(range(len(keys)), labels)
    axes.set_ylim(len(keys) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def _dot_legend(predicted: Mapping[Any, Any], measured: Mapping[Any, Any]) -> list[tuple[Any, str]]:
    entries: list[tuple[Any, str]] = []
    for side, look, name in ((predicted, PREDICTED, "predicted"), (measured, COLLECTED, "measured")):
        if side:
            face = "white" if look is PREDICTED else look.colour
            entries.append((Line2D([], [], color=look.colour, marker=look.marker, markerfacecolor=face), name))
    return entries


def _of_side(side: Products | None, product: str) -> Mapping[Any, Any]:
    return {} if side is None else getattr(side, product)
