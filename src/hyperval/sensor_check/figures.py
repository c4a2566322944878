"""Figures of a datasheet: response, SNR, noise, saturation, detection, sensitivity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hyperval.products import Prediction
from hyperval.report import style
from hyperval.report.style import Drawing
from hyperval.sensor_check.bands import neighbour_ratio
from hyperval.sensor_check.noise import LEVELS, MIDDLE, TOLERANCE, SnrPoint, sunlit_radiance
from hyperval.sensor_check.sensitivity import Probe, Swing
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
    return style.vector_drawing(figure, "response", "response", "Bands: width, spacing and response", alt)


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
    return style.vector_drawing(figure, "snr", "snr", title, alt)


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
        if len(axis) < 30:
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
    return style.vector_drawing(figure, "noise", "noise", "Sources of noise, dark and bright ground", alt)


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
    return style.vector_drawing(figure, "saturation", "saturation", "Signal as a part of full scale", alt)


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


_MOST_SWINGS = 20
_LOWEST_PFA = 1e-6


def published_figure(points: Sequence[SnrPoint]) -> Drawing:
    """Computed over published ratio by wavelength."""
    figure = style.new_figure(10.0, 3.0, "Computed over published signal-to-noise ratio", False)
    axes = figure.subplots()
    looks = {
        "value": ("o", style.SOURCE_COLOURS[0], "published value"),
        "at least": ("^", style.SOURCE_COLOURS[2], "published lower bound"),
        "unstated": ("x", style.SOURCE_COLOURS[7], "no radiance stated: not judged"),
    }
    used = []
    for point in points:
        kind = point.item.says if point.judged else "unstated"
        used.append(kind)
        marker, colour, _ = looks[kind]
        ratio = point.computed / point.published
        axes.plot(point.wavelength_nm, ratio, marker=marker, color=colour, markersize=6, linestyle="")
        axes.annotate(
            f"{point.computed:.0f} / {point.published:g}", (point.wavelength_nm, ratio), fontsize=8,
            xytext=(6, 4), textcoords="offset points",
        )  # fmt: skip
    axes.axhline(1.0, color="#444444", linewidth=0.9)
    entries: list[tuple[Any, str]] = [
        (Line2D([], [], marker=m, color=c, linestyle=""), text) for k, (m, c, text) in looks.items() if k in used
    ]
    if "value" in used:
        axes.axhspan(1 - TOLERANCE, 1 + TOLERANCE, color=style.ABSORPTION_COLOUR, linewidth=0, zorder=0)
        entries.append((Patch(color=style.ABSORPTION_COLOUR), f"within {100 * TOLERANCE:g} %"))
    ratios = [p.computed / p.published for p in points]
    axes.set_ylim(min(0.6, 0.9 * min(ratios)), max(1.4, 1.15 * max(ratios)))
    span = max(p.wavelength_nm for p in points) - min(p.wavelength_nm for p in points)
    margin = max(0.12 * span, 60.0)
    axes.set_xlim(
        min(p.wavelength_nm for p in points) - margin, max(p.wavelength_nm for p in points) + 1.3 * margin
    )
    axes.set_xlabel(style.WAVELENGTH_LABEL)
    axes.set_ylabel("computed / published [1]")
    style.add_legend(figure, entries)
    listed = "; ".join(f"{p.wavelength_nm:g} nm {p.computed:.0f} to {p.published:g}" for p in points)
    title = "Computed over published signal-to-noise ratio (numbers: computed / published)"
    alt = f"Computed against published ratios: {listed}."
    return style.vector_drawing(figure, "published-snr", "published_snr", title, alt)


def detection_figure(predictions: Mapping[str, Prediction]) -> Drawing | None:
    """Receiver operating characteristic of every target of the standard scenes."""
    scenes = {name: prediction for name, prediction in predictions.items() if prediction.roc}
    if not scenes:
        return None
    figure = style.new_figure(10.0, 3.6, "Detection in the standard scenes", False)
    panels = np.atleast_1d(figure.subplots(1, len(scenes), sharey=True))
    detectors = sorted({key[1] for prediction in scenes.values() for key in prediction.roc})
    lines: dict[str, Any] = dict(zip(detectors, ("-", "--", ":", "-."), strict=False))
    for axes, (name, prediction) in zip(panels, scenes.items(), strict=True):
        subjects = list(dict.fromkeys(key[0] for key in prediction.roc))
        for (subject, detector, unit), curve in prediction.roc.items():
            if unit != "pixel" or detector not in lines:
                continue
            colour = style.SOURCE_COLOURS[subjects.index(subject) % len(style.SOURCE_COLOURS)]
            keep = curve.pfa >= _LOWEST_PFA
            axes.plot(curve.pfa[keep], curve.pd[keep], color=colour, linestyle=lines[detector], linewidth=1.2)
        _detection_axes(axes, name)
        axes.legend(
            [Line2D([], [], color=style.SOURCE_COLOURS[i % 8]) for i in range(len(subjects))],
            [style.plain(style.shortened(s, 24)) for s in subjects], loc="upper left", fontsize=8,
            ncols=2,
        )  # fmt: skip
    panels[0].set_ylabel("P_D [1]")
    style.add_legend(figure, [(Line2D([], [], color="#444444", linestyle=lines[d]), d) for d in lines])
    alt = f"Probability of detection against that of false alarm in {', '.join(scenes)}, by target and detector."
    title = "Detection in the standard scenes with this sensor"
    return style.vector_drawing(figure, "detection", "scenario", title, alt)


def sensitivity_figure(swings: Sequence[Swing], probe: Probe | None, vary: float) -> Drawing | None:
    """Tornado: what each assumed number does to the SNR and to P_D."""
    if not swings:
        return None
    kept = list(swings[:_MOST_SWINGS])
    figure = style.new_figure(
        10.0, 1.3 + 0.24 * len(kept), f"Assumed numbers, {100 * vary:g} % lower and higher", False
    )
    left, right = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(kept))[::-1]
    for axes, pick, factor in ((left, "snr", 100.0), (right, "detection", 1.0)):
        for k, colour in ((0, style.SOURCE_COLOURS[4]), (1, style.SOURCE_COLOURS[5])):
            axes.barh(rows, [factor * getattr(s, pick)[k] for s in kept], color=colour, height=0.62)
        axes.axvline(0.0, color="#444444", linewidth=0.8)
        axes.grid(axis="y", visible=False)
    left.set_yticks(rows, [style.plain(s.number.name) for s in kept])
    left.tick_params(axis="y", labelsize=8)
    left.set_xlabel("change of the SNR at reflectance 0.25 [%]")
    right.xaxis.set_major_locator(MaxNLocator(5))
    what = f"change of P_D: {probe.key[0]}, {probe.key[1]}" if probe else "change of P_D [1]"
    right.set_xlabel(style.plain(f"{what} [1]" if probe else what))
    shades = ((style.SOURCE_COLOURS[4], "lower"), (style.SOURCE_COLOURS[5], "higher"))
    style.add_legend(figure, [(Patch(color=colour), words) for colour, words in shades])
    most = kept[0]
    alt = (
        f"Bars of what each of {len(swings)} assumed numbers does when it is {100 * vary:g} % lower or higher. "
        f"Most for the SNR: {most.number.name}, {100 * most.snr[0]:+.1f} % and {100 * most.snr[1]:+.1f} %."
    )
    more = f"; {len(kept)} of {len(swings)} are drawn" if len(kept) < len(swings) else ""
    title = f"What each assumed number does to the SNR (of the band it moves most) and to P_D{more}"
    return style.vector_drawing(figure, "sensitivity", "sensitivity", title, alt)


def _detection_axes(axes: Axes, name: str) -> None:
    axes.set_xscale("log")
    axes.set_xlim(_LOWEST_PFA, 1.0)
    style.log_ticks(axes.xaxis)
    axes.set_ylim(0.0, 1.32)  # room for the legend above the curves
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.set_xlabel("P_FA [1]")
    axes.set_title(style.plain(name), loc="left")
