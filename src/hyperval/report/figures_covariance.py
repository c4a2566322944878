"""Figures of how pixels spread about the mean of their class: eigenvalues and tails."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from hyperval.report import style
from hyperval.report.panels import GREY, Entries, line_handle, mark_entries, small_multiples
from hyperval.report.run import EigenvalueSpectrum, TailCurve
from hyperval.report.style import COLLECTED, PREDICTED, Drawing

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
        title = f"Eigenvalues of the {quantity} covariance"
        labels = ("number of the eigenvalue [1]", f"eigenvalue\n[{unit}]", "predicted /\nmeasured [1]")
        figure, panels = small_multiples(title, len(own), labels, simulated, row_in=3.4, more_in=0.9)
        words = []
        for (subject, s), (top, low) in zip(own.items(), panels, strict=True):
            top.set_title(f"{style.plain(style.shortened(subject, 34))} (n = {_count(s.n)})", loc="left")
            _eigenvalue_panel(top, s)
            _eigenvalue_ratio(low, s)
            inside = int(np.sum((s.measured >= s.lower) & (s.measured <= s.upper)))
            words.append(
                f"{subject}: first eigenvalue predicted {s.expected[0]:.3g}, measured {s.measured[0]:.3g}; "
                f"{inside} of {s.measured.size} inside"
            )
        figure.align_ylabels()
        (predicted, _), measured = mark_entries()
        band = style.interval_handle(PREDICTED.colour), "95 % of samples of the prediction"
        style.add_legend(figure, [(predicted, "predicted, mean of samples"), band, measured])
        alt = (
            f"Leading eigenvalues of the pixel-to-pixel covariance of the {quantity}, logarithmic, predicted "
            "(hollow circles, with the 95 % band of samples of as many pixels) and measured (squares); below, "
            f"predicted over measured with that band. {'. '.join(words)}."
        )
        title += " (band: 95 % of samples of as many independent pixels drawn from the prediction)"
        drawings.append(style.vector_drawing(figure, f"{quantity}-eigenvalues", "covariance", title, alt))
    return drawings


def tail_figures(tails: Mapping[str, TailCurve], *, simulated: bool) -> list[Drawing]:
    """Share of pixels beyond a Mahalanobis distance: measured, as predicted, normal, and the t that fits best."""
    first = dict(list(tails.items())[: style.MAX_PANELS])
    if not first:
        return []
    labels = ("Mahalanobis distance [1]", "share of pixels\nfarther out [1]")
    title = "Tails of the pixels about their mean"
    figure, panels = small_multiples(title, len(first), labels, simulated, row_in=2.8, more_in=0.9)
    words = []
    for (subject, t), (axes,) in zip(first.items(), panels, strict=True):
        axes.set_title(
            f"{style.plain(style.shortened(subject, 28))}: {t.dimension} components, n = {_count(t.n)}", loc="left"
        )
        axes.fill_between(t.distance, t.lower, t.upper, color=COLLECTED.colour, alpha=0.2, linewidth=0)
        axes.plot(t.distance, t.normal, color=GREY, linestyle=":", linewidth=1.2)
        axes.plot(t.distance, t.fitted, color=style.DIFFERENCE_COLOUR, linestyle="-.", linewidth=1.2)
        if t.predicted is not None:
            axes.plot(t.distance, t.predicted, color=PREDICTED.colour, linestyle=PREDICTED.line)
        axes.plot(t.distance, t.measured, color=COLLECTED.colour, linestyle=COLLECTED.line)
        axes.set_yscale("log")
        axes.set_ylim(0.3 / t.n, 1.5)
        axes.set_xlim(0.0, float(t.distance[-1]) * 1.03)
        style.log_ticks(axes.yaxis)
        predicted = "" if t.predicted_dof is None else f", {_dof(t.predicted_dof)} predicted"
        words.append(f"{subject}: {_dof(t.fitted_dof)} measured{predicted}")
    entries: Entries = [
        (line_handle(COLLECTED.colour, COLLECTED.line), "measured"),
        (style.interval_handle(COLLECTED.colour), "95 % interval"),
        (line_handle(GREY, ":"), "normal law"),
        (line_handle(style.DIFFERENCE_COLOUR, "-."), "fitted t"),
    ]
    if any(t.predicted is not None for t in first.values()):
        entries.insert(2, (line_handle(PREDICTED.colour, PREDICTED.line), "predicted law"))
    style.add_legend(figure, entries)
    alt = (
        "Share of a class's pixels beyond a Mahalanobis distance in the leading components, logarithmic: measured "
        f"with its 95 % interval, under the predicted law, the normal law, and the fitted t. {'; '.join(words)}."
    )
    title = "Tails of the pixels in the leading components (interval: binomial, pixels taken as independent)"
    return [style.vector_drawing(figure, "pixel-tails", "covariance", title, alt)]


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
    axes.axhline(1.0, color=GREY, linewidth=0.8)
    axes.fill_between(
        number, s.lower / s.measured, s.upper / s.measured, color=PREDICTED.colour, alpha=0.25, linewidth=0
    )
    axes.plot(number, s.expected / s.measured, color=style.DIFFERENCE_COLOUR, linewidth=1.2)


def _count(n: int) -> str:
    return f"{n:,}".replace(",", "\u202f")


def _dof(dof: float) -> str:
    return "normal" if math.isinf(dof) else f"{dof:.3g} degrees of freedom"
