"""Figures of ROC curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from hyperval.processing.roc_reading import detection_at
from hyperval.products import RocCurve
from hyperval.report import style
from hyperval.report.panels import (
    GREY,
    Entries,
    interval_entry,
    line_entries,
    small_multiples,
)
from hyperval.report.sides import Sides, best_counted, both_first, of_side
from hyperval.report.style import COLLECTED, PREDICTED, Drawing

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
