"""Figures of how pixels spread about the mean of their class: eigenvalues and tails."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from hyperval.report import style
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.style import COLLECTED, PREDICTED, Drawing

_NORMAL = "#444444"
_UNITS = {"radiance": "(µW cm⁻² sr⁻¹ nm⁻¹)²", "reflectance": "1"}


def sampled_eigenvalue_figures(
    spectra: Mapping[tuple[str, str], EigenvalueSpectrum], *, simulated: bool
) -> list[Drawing]:
    """Eigenvalues of both sides; below each, predicted over measured with the band that chance alone gives."""
    drawings = []
    for quantity, unit in _UNITS.items():
        own = {subject: s for (subject, q), s in spectra.items() if q == quantity}
        if not own:
            continue
        columns = style.column_count(len(own))
        rows = math.ceil(len(own) / columns)
        title = f"Eigenvalues of the {quantity} covariance"
        figure = style.new_figure(10.0, 0.9 + 3.4 * rows, title, simulated)
        grid = figure.add_gridspec(2 * rows, columns, height_ratios=[2, 1] * rows)
        words = []
        for at, (subject, s) in enumerate(own.items()):
            row, column = divmod(at, columns)
            top = figure.add_subplot(grid[2 * row, column])
            low = figure.add_subplot(grid[2 * row + 1, column], sharex=top)
            top.set_title(f"{style.plain(style.shortened(subject, 34))} (n = {_count(s.n)})", loc="left")
            _eigenvalue_panel(top, s)
            _eigenvalue_ratio(low, s)
            top.tick_params(labelbottom=False)
            if column == 0:
                top.set_ylabel(f"eigenvalue\n[{unit}]")
                low.set_ylabel("predicted /\nmeasured [1]")
            if at + columns >= len(own):
                low.set_xlabel("number of the eigenvalue [1]")
            inside = int(np.sum((s.measured >= s.lower) & (s.measured <= s.upper)))
            words.append(
                f"{subject}: first eigenvalue predicted {s.expected[0]:.3g}, measured {s.measured[0]:.3g}; "
                f"{inside} of {s.measured.size} inside"
            )
        figure.align_ylabels()
        style.add_legend(
            figure,
            [
                (
                    line_handle(PREDICTED.colour, PREDICTED.line, PREDICTED.marker, hollow=True),
                    "predicted, mean of samples",
                ),
                (style.interval_handle(PREDICTED.colour), "95 % of samples of the prediction"),
                (line_handle(COLLECTED.colour, COLLECTED.line, COLLECTED.marker), "measured"),
            ],
        )
        alt = (
            f"Leading eigenvalues of the pixel-to-pixel covariance of the {quantity}, logarithmic, predicted "
            "(hollow circles, with the 95 % band of samples of as many pixels) and measured (squares); below, "
            f"predicted over measured with that band. {'. '.join(words)}."
        )
        drawings.append(
            Drawing(
                f"{quantity}-eigenvalues",
                "covariance",
                f"{title} (band: 95 % of samples of as many independent pixels drawn from the prediction)",
                alt,
                style.vector_bytes(figure),
                "svg",
            )
        )
    return drawings


def tail_figures(tails: Mapping[str, TailCurve], *, simulated: bool) -> list[Drawing]:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best."""
    first = dict(list(tails.items())[: style.MAX_PANELS])
    if not first:
        return []
    columns = style.column_count(len(first))
    rows = math.ceil(len(first) / columns)
    figure = style.new_figure(10.0, 0.9 + 2.8 * rows, "Tails of the pixels about their mean", simulated)
    words = []
    for at, (subject, t) in enumerate(first.items()):
        axes = figure.add_subplot(rows, columns, at + 1)
        axes.set_title(
            f"{style.plain(style.shortened(subject, 28))}: {t.dimension} components, n = {_count(t.n)}", loc="left"
        )
        axes.fill_between(t.distance, t.lower, t.upper, color=COLLECTED.colour, alpha=0.2, linewidth=0)
        axes.plot(t.distance, t.normal, color=_NORMAL, linestyle=":", linewidth=1.2)
        axes.plot(t.distance, t.fitted, color=style.DIFFERENCE_COLOUR, linestyle="-.", linewidth=1.2)
        if t.predicted is not None:
            axes.plot(t.distance, t.predicted, color=PREDICTED.colour, linestyle=PREDICTED.line)
        axes.plot(t.distance, t.measured, color=COLLECTED.colour, linestyle=COLLECTED.line)
        axes.set_yscale("log")
        axes.set_ylim(0.3 / t.n, 1.5)
        axes.set_xlim(0.0, float(t.distance[-1]) * 1.03)
        style.log_ticks(axes.yaxis)
        if at % columns == 0:
            axes.set_ylabel("share of pixels\nfarther out [1]")
        if at + columns >= len(first):
            axes.set_xlabel("Mahalanobis distance [1]")
        predicted = "" if t.predicted_dof is None else f", {_dof(t.predicted_dof)} predicted"
        words.append(f"{subject}: {_dof(t.fitted_dof)} measured{predicted}")
    entries: list[tuple[Any, str]] = [
        (line_handle(COLLECTED.colour, COLLECTED.line), "measured"),
        (style.interval_handle(COLLECTED.colour), "95 % interval"),
        (line_handle(_NORMAL, ":"), "normal law"),
        (line_handle(style.DIFFERENCE_COLOUR, "-."), "fitted t"),
    ]
    if any(t.predicted is not None for t in first.values()):
        entries.insert(2, (line_handle(PREDICTED.colour, PREDICTED.line), "predicted law"))
    style.add_legend(figure, entries)
    alt = (
        "Share of a class's pixels beyond a Mahalanobis distance in the leading components, logarithmic: measured "
        f"with its 95 % interval, under the predicted law, the normal law, and the fitted t. {'; '.join(words)}."
    )
    return [
        Drawing(
            "pixel-tails",
            "covariance",
            "Tails of the pixels in the leading components (interval: binomial, pixels taken as independent)",
            alt,
            style.vector_bytes(figure),
            "svg",
        )
    ]


def _eigenvalue_panel(axes: Axes, s: EigenvalueSpectrum) -> None:
    number = np.arange(1, s.measured.size + 1)
    axes.fill_between(number, s.lower, s.upper, color=PREDICTED.colour, alpha=0.2, linewidth=0)
    axes.plot(
        number, s.expected, color=PREDICTED.colour, linestyle=PREDICTED.line, marker=PREDICTED.marker,
        markersize=6, markerfacecolor="none", linewidth=1.0, zorder=3,
    )  # fmt: skip
    axes.plot(
        number, s.measured, color=COLLECTED.colour, linestyle=COLLECTED.line, marker=COLLECTED.marker,
        markersize=3, linewidth=1.0,
    )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xlim(left=0.0)
    style.log_ticks(axes.yaxis)


def _eigenvalue_ratio(axes: Axes, s: EigenvalueSpectrum) -> None:
    number = np.arange(1, s.measured.size + 1)
    axes.axhline(1.0, color=_NORMAL, linewidth=0.8)
    axes.fill_between(
        number, s.lower / s.measured, s.upper / s.measured, color=PREDICTED.colour, alpha=0.25, linewidth=0
    )
    axes.plot(number, s.expected / s.measured, color=style.DIFFERENCE_COLOUR, linewidth=1.2)


def line_handle(colour: str, line: Any, marker: str | None = None, *, hollow: bool = False) -> Line2D:
    """A legend entry."""
    return Line2D(
        [], [], color=colour, linestyle=line, marker=marker, markersize=6 if hollow else 4,
        markerfacecolor="none" if hollow else colour,
    )  # fmt: skip


def _count(n: int) -> str:
    return f"{n:,}".replace(",", "\u202f")


def _dof(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"
