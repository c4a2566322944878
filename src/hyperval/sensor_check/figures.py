"""Figures of a datasheet: response, SNR, noise, saturation, detection, sensitivity."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hyperval.report import style
from hyperval.report.style import Drawing
from hyperval.sensor_check.bands import neighbour_ratio
from hyperval.sensor_check.figures_more import detection_figure, published_figure, sensitivity_figure
from hyperval.sensor_check.reference import LEVELS, MIDDLE, sunlit_radiance
from hyperval.sensor_check.suite import SensorCheck
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import SIGMA_PER_FWHM
from hyperval.spectra.windows import in_window

Array = npt.NDArray[np.float64]

_MOST_RESPONSES = 12
_SOURCES = {
    "shot": "photons",
    "fixed": "fixed",
    "quantisation": "quantisation",
    "bit_errors": "bit errors",
    "calibration": "C_R (calibration error)",
    "fit": "rest of the fit",
}


def draw_datasheet(check: SensorCheck) -> list[Drawing]:
    """Every figure that the checks allow, in the order of the page."""
    if not check.usable:
        return []
    with style.house_style():
        figures = [
            response_figure(check),
            snr_figure(check),
            published_figure(check.points) if check.points else None,
            noise_figure(check),
            saturation_figure(check),
            detection_figure(check.predictions),
            sensitivity_figure(check.swings, check.probe, check.vary),
        ]
    return [drawing for drawing in figures if drawing is not None]


def response_figure(check: SensorCheck) -> Drawing:
    """Widths against spacing, and the responses of a few bands."""
    axis = check.sensor.axis
    figure = style.new_figure(10.0, 3.2, "Bands", False)
    left, right = figure.subplots(1, 2)
    left.plot(axis.centre_nm, axis.fwhm_nm, color=style.SOURCE_COLOURS[0], marker=".", markersize=3, linewidth=0.8)
    if len(axis) > 1:
        middle = 0.5 * (axis.centre_nm[:-1] + axis.centre_nm[1:])
        spacing = np.diff(axis.centre_nm)
        together = check.sensor.specification.bands.spacing == "contiguous"
        if together:  # what is left out between spectrometers is no spacing
            spacing = np.where(spacing > 3.0 * np.median(spacing), np.nan, spacing)
        left.plot(middle, spacing, color=style.SOURCE_COLOURS[5], linewidth=0.9, linestyle="--")
    left.set_xlabel(style.WAVELENGTH_LABEL)
    left.set_ylabel("width, spacing [nm]")
    left.set_title("Full width at half maximum, and spacing", loc="left")
    shown = _few_bands(axis)
    for k in shown:
        sigma = axis.fwhm_nm[k] * SIGMA_PER_FWHM
        w = axis.centre_nm[k] + np.linspace(-3 * sigma, 3 * sigma, 61)
        colour = style.SOURCE_COLOURS[int(k) % 2 * 5]
        right.plot(w, np.exp(-0.5 * ((w - axis.centre_nm[k]) / sigma) ** 2), color=colour, linewidth=1.0)
    right.set_xlabel(style.WAVELENGTH_LABEL)
    right.set_ylabel("relative response [1]")
    right.set_title(f"Responses of {shown.size} bands", loc="left")
    style.add_legend(
        figure,
        [
            (Line2D([], [], color=style.SOURCE_COLOURS[0], marker=".", markersize=4), "FWHM"),
            (Line2D([], [], color=style.SOURCE_COLOURS[5], linestyle="--"), "spacing"),
        ],
    )
    ratio = f"; the median width is {np.median(neighbour_ratio(axis)):.2f} spacings" if len(axis) > 1 else ""
    alt = f"Width and spacing of the {len(axis)} bands against wavelength, and the responses of a few{ratio}."
    return Drawing(
        "response", "response", "Bands: width, spacing and response", alt, style.svg_bytes(figure), "svg"
    )


def snr_figure(check: SensorCheck) -> Drawing:
    """SNR against wavelength at the reference radiances, with and without C_R."""
    axis, noise = check.sensor.axis, check.sensor.noise()
    figure = style.new_figure(10.0, 3.6, "Signal-to-noise ratio, sun at 45° and no atmosphere", False)
    axes = figure.subplots()
    entries: list[tuple[Any, str]] = []
    highest = []
    for level, colour in zip(LEVELS, style.SOURCE_COLOURS, strict=False):
        radiance = sunlit_radiance(axis, level)
        free, calibrated = noise.snr(radiance, calibration=False), noise.snr(radiance)
        _curve(axes, axis, free, colour, "-")
        _curve(axes, axis, calibrated, colour, "--")
        highest.append(free[_shown(axis) if len(axis) >= 30 else axis.good])
        entries.append((Line2D([], [], color=colour, marker=_marker(axis)), f"reflectance {level:g}"))
    entries.append((Line2D([], [], color="#444444"), "without calibration error C_R"))
    entries.append((Line2D([], [], color="#444444", linestyle="--"), "with C_R"))
    _wavelength_axis(axes, axis, style.robust_limits(highest, zero=True))
    axes.set_ylabel("signal-to-noise ratio [1]")
    style.add_legend(figure, entries)
    middle = noise.snr(sunlit_radiance(axis, MIDDLE), calibration=False)[_shown(axis)]
    alt = (
        "Signal-to-noise ratio against wavelength for ground of 0.05, 0.25 and 0.6, with and without the "
        f"calibration error. At 0.25 without it: median {np.median(middle):.0f}, {middle.min():.0f} to "
        f"{middle.max():.0f}."
    )
    title = "Signal-to-noise ratio at the reference radiances (solid: without C_R; dashed: with it)"
    return Drawing("snr", "snr", title, alt, style.svg_bytes(figure), "svg")


def noise_figure(check: SensorCheck) -> Drawing:
    """Share of each source in the noise variance."""
    axis = check.sensor.axis
    figure = style.new_figure(10.0, 3.4, "Sources of noise", False)
    panels = figure.subplots(1, 2, sharey=True)
    shown: dict[str, str] = {}
    for axes, level in zip(panels, (LEVELS[0], LEVELS[-1]), strict=True):
        parts = check.sensor.noise().breakdown(sunlit_radiance(axis, level))
        rows = {words: getattr(parts, name) for name, words in _SOURCES.items()}
        total = sum(np.abs(v) for v in rows.values())
        kept = {words: 100.0 * np.abs(v) / total for words, v in rows.items() if np.max(np.abs(v) / total) > 1e-4}
        for words in kept:
            shown.setdefault(words, style.SOURCE_COLOURS[list(_SOURCES.values()).index(words)])
        step = len(axis) < 30
        if step:
            base = np.zeros(len(axis))
            for words, share in kept.items():
                axes.bar(axis.centre_nm, share, axis.fwhm_nm, bottom=base, color=shown[words], linewidth=0)
                base = base + share
        else:
            axes.stackplot(axis.centre_nm, list(kept.values()), colors=[shown[w] for w in kept], linewidth=0)
        _wavelength_axis(axes, axis, (0.0, 100.0))
        axes.set_title(f"reflectance {level:g}", loc="left")
    panels[0].set_ylabel("share of the variance [%]")
    style.add_legend(figure, [(Patch(color=colour), words) for words, colour in shown.items()])
    alt = f"Share of each source in the variance of the noise, dark and bright ground: {', '.join(shown)}."
    return Drawing(
        "noise", "noise", "Sources of noise, dark and bright ground", alt, style.svg_bytes(figure), "svg"
    )


def saturation_figure(check: SensorCheck) -> Drawing | None:
    """Signal as a part of full scale; None where the file does not say where that is."""
    axis, noise = check.sensor.axis, check.sensor.noise()
    if noise.full_scale is None:
        return None
    figure = style.new_figure(10.0, 3.0, "Signal as a part of full scale, sun at 45° and no atmosphere", False)
    axes = figure.subplots()
    entries: list[tuple[Any, str]] = []
    highest = 1.0
    for level, colour in zip((*LEVELS[1:], 1.0), style.SOURCE_COLOURS, strict=False):
        part = noise.full_scale_fraction(sunlit_radiance(axis, level))
        _curve(axes, axis, part, colour, "-")
        highest = max(highest, float(np.max(part)))
        entries.append((Line2D([], [], color=colour, marker=_marker(axis)), f"reflectance {level:g}"))
    axes.axhline(1.0, color="#9b1c1c", linewidth=1.0, linestyle=":")
    entries.append((Line2D([], [], color="#9b1c1c", linestyle=":"), "full scale"))
    _wavelength_axis(axes, axis, (0.0, 1.08 * highest))
    axes.set_ylabel("part of full scale [1]")
    style.add_legend(figure, entries)
    alt = f"Signal as a part of full scale against wavelength; the highest, at reflectance 1, is {highest:.2f}."
    return Drawing(
        "saturation", "saturation", "Signal as a part of full scale", alt, style.svg_bytes(figure), "svg"
    )


def _few_bands(axis: SpectralAxis) -> npt.NDArray[np.intp]:
    if len(axis) <= _MOST_RESPONSES:
        return np.arange(len(axis))
    first = int(np.clip(np.argmin(np.abs(axis.centre_nm - 550.0)) - 5, 0, len(axis) - _MOST_RESPONSES))
    return np.arange(first, first + _MOST_RESPONSES)


def _shown(axis: SpectralAxis) -> npt.NDArray[np.bool_]:
    keep = axis.good & in_window(axis.centre_nm)
    return keep if keep.any() else np.ones(len(axis), bool)


def _marker(axis: SpectralAxis) -> str:
    return "o" if len(axis) < 30 else ""


def _curve(axes: Axes, axis: SpectralAxis, values: Array, colour: str, line: str) -> None:
    """A line over the good bands; gaps where bands are bad or left out."""
    y = np.where(axis.good, values, np.nan)
    w = axis.centre_nm
    if len(axis) >= 30:
        wide = np.flatnonzero(np.diff(w) > 40.0) + 1
        w, y = np.insert(w, wide, w[wide] - 1.0), np.insert(y, wide, np.nan)
    axes.plot(w, y, color=colour, linestyle=line, linewidth=1.1, marker=_marker(axis), markersize=3)


def _wavelength_axis(axes: Axes, axis: SpectralAxis, limits: tuple[float, float] | None) -> None:
    low = float(axis.centre_nm[0] - axis.fwhm_nm[0])
    high = float(axis.centre_nm[-1] + axis.fwhm_nm[-1])
    style.shade_absorption(axes, low, high)
    axes.set_xlim(low, high)
    axes.set_xlabel(style.WAVELENGTH_LABEL)
    if limits is not None:
        axes.set_ylim(*limits)
