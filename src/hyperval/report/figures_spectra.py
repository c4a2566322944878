"""Figures of spectra: radiance, reflectance and SNR over wavelength."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hyperval.products import SpectralEstimate
from hyperval.report import style
from hyperval.report.panels import COVERAGE, Entries, interval_entry, line_entries, small_multiples
from hyperval.report.sides import Sides, both_first, difference, of_side
from hyperval.report.style import COLLECTED, PREDICTED, Drawing
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]


def pair_figures(sides: Sides, product: str, *, simulated: bool) -> list[Drawing]:
    """Overlay of both sides with, below each, their difference; ``product`` names a field of Products."""
    label, title, ratio = {
        "radiance": (style.RADIANCE_LABEL, "Radiance at the sensor", True),
        "reflectance": ("reflectance [1]", "Reflectance", False),
        "toa_reflectance": ("reflectance [1]", "Reflectance at the top of the atmosphere", True),
        "snr": ("signal-to-noise\nratio [1]", "Signal-to-noise ratio", True),
    }[product]
    predicted, collected = of_side(sides[0], product), of_side(sides[1], product)
    drawings = []
    every = both_first(predicted, collected)
    # Where anything can be compared, what only one side holds is left to products.nc.
    pairs = [subject for subject in every if subject in predicted and subject in collected]
    if not pairs and None not in sides:
        return []  # a comparison that has none of this product
    paired = bool(pairs)
    pages = style.pages(pairs or every)
    for number, subjects in enumerate(pages, start=1):
        axis = next(side.axis for side in sides if side is not None)
        below_label = "difference\nratio [1]" if ratio else "difference\n[1]"
        labels = (style.band_label(axis), label, *((below_label,) if paired else ()))
        figure, panels = small_multiples(
            title, len(subjects), labels, simulated, row_in=3.1 if paired else 2.3, more_in=0.9
        )
        medians = []
        for subject, (top, *below) in zip(subjects, panels, strict=True):
            top.set_title(style.plain(style.shortened(subject, 44)), loc="left")
            _overlay(top, sides, predicted.get(subject), collected.get(subject))
            if below:
                median = _difference(below[0], sides, predicted.get(subject), collected.get(subject), ratio)
                if median is not None:
                    medians.append(f"{subject} {median:.2%}" if ratio else f"{subject} {median:.4f}")
        figure.align_ylabels()
        style.add_legend(figure, _legend(predicted, collected, difference=paired, absorption=not axis.numbered))
        alt = (
            f"{title} against {style.band_label(axis)} for {', '.join(subjects)}: predicted (dashed) and "
            "collected (solid) with 95 % intervals"
            + (f"; below each, predicted minus collected{' over collected' if ratio else ''}." if paired else ".")
        )
        if medians:
            alt += f" Median absolute difference in the windows: {'; '.join(medians)}."
        name = f"{product}-pair" if len(pages) == 1 else f"{product}-pair-{number}"
        caption = f"{title}: predicted and collected{style.left_out(pages, every)}"
        drawings.append(style.vector_drawing(figure, name, product, caption, alt))
    return drawings


def _overlay(
    axes: Axes, sides: Sides, predicted: SpectralEstimate | None, collected: SpectralEstimate | None
) -> None:
    inside: list[Array] = []
    w = np.empty(0)
    for side, estimate, look in ((sides[0], predicted, PREDICTED), (sides[1], collected, COLLECTED)):
        if side is None or estimate is None:
            continue
        w = side.axis.centre_nm
        half = COVERAGE * estimate.standard_uncertainty
        axes.fill_between(w, estimate.mean - half, estimate.mean + half, color=look.colour, alpha=0.2, linewidth=0)
        # Dashes on top of the solid line, so that neither hides the other where they agree.
        axes.plot(w, estimate.mean, color=look.colour, linestyle=look.line, zorder=3 if look is PREDICTED else 2)
        keep = _keep(w)
        inside += [estimate.mean[keep], (estimate.mean - half)[keep], (estimate.mean + half)[keep]]
    _wavelength_axis(axes, w, style.robust_limits(inside, zero=True))


def _difference(
    axes: Axes,
    sides: Sides,
    predicted: SpectralEstimate | None,
    collected: SpectralEstimate | None,
    ratio: bool,
) -> float | None:
    """Draw the difference; its median absolute value in the windows, None when there is none."""
    axes.axhline(0.0, color="#444444", linewidth=0.8)
    if predicted is None or collected is None or sides[0] is None or sides[1] is None:
        return None
    w = sides[0].axis.centre_nm
    if not sides[0].axis.matches(sides[1].axis):
        axes.text(0.5, 0.6, "the two sides have different bands", ha="center", transform=axes.transAxes)
        return None
    value, u = difference(predicted, collected, ratio)
    half = COVERAGE * u
    axes.fill_between(w, value - half, value + half, color=style.DIFFERENCE_COLOUR, alpha=0.25, linewidth=0)
    axes.plot(w, value, color=style.DIFFERENCE_COLOUR, linewidth=1.2)
    keep = _keep(w)
    _wavelength_axis(
        axes, w, style.robust_limits([value[keep], (value - half)[keep], (value + half)[keep]], zero=True, trim=3.0)
    )
    inside = np.abs(value[keep])
    inside = inside[np.isfinite(inside)]
    return float(np.median(inside)) if inside.size else None


def _wavelength_axis(axes: Axes, w: Array, limits: tuple[float, float] | None) -> None:
    if w.size:
        low, high = float(w[0]), float(w[-1])
        style.shade_absorption(axes, low, high)
        axes.set_xlim(low, high if high > low else low + 1.0)
    if limits is not None:
        axes.set_ylim(*limits)


def _keep(w: Array) -> npt.NDArray[np.bool_]:
    keep = in_window(w)
    return keep if keep.any() else np.ones(w.shape, bool)


def _legend(
    predicted: Mapping[Any, Any], collected: Mapping[Any, Any], *, difference: bool, absorption: bool
) -> Entries:
    entries = line_entries(predicted, collected, "collected")
    patches, words = interval_entry(predicted, collected)
    if difference:
        entries.append((Line2D([], [], color=style.DIFFERENCE_COLOUR), "difference"))
        patches += style.interval_handle(style.DIFFERENCE_COLOUR)
    entries.append((patches, words))
    if absorption:
        entries.append((Patch(color=style.ABSORPTION_COLOUR), "absorption band"))
    return entries
