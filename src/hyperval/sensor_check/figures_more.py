"""Figures of a datasheet that compare: published ratios, detection in the standard scenes, the assumed numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from hyperval.products import Prediction
from hyperval.report import style
from hyperval.report.style import Drawing
from hyperval.sensor_check.published import TOLERANCE, SnrPoint
from hyperval.sensor_check.sensitivity import Probe, Swing

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
    return Drawing("published-snr", "published_snr", title, alt, style.svg_bytes(figure), "svg")


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
    return Drawing("detection", "scenario", title, alt, style.svg_bytes(figure), "svg")


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
    entries: list[tuple[Any, str]] = [
        (Patch(color=style.SOURCE_COLOURS[4]), "lower"),
        (Patch(color=style.SOURCE_COLOURS[5]), "higher"),
    ]
    style.add_legend(figure, entries)
    most = kept[0]
    alt = (
        f"Bars of what each of {len(swings)} assumed numbers does when it is {100 * vary:g} % lower or higher. "
        f"Most for the SNR: {most.number.name}, {100 * most.snr[0]:+.1f} % and {100 * most.snr[1]:+.1f} %."
    )
    more = f"; {len(kept)} of {len(swings)} are drawn" if len(kept) < len(swings) else ""
    title = f"What each assumed number does to the SNR (of the band it moves most) and to P_D{more}"
    return Drawing("sensitivity", "sensitivity", title, alt, style.svg_bytes(figure), "svg")


def _detection_axes(axes: Axes, name: str) -> None:
    axes.set_xscale("log")
    axes.set_xlim(_LOWEST_PFA, 1.0)
    style.log_ticks(axes.xaxis)
    axes.set_ylim(0.0, 1.32)  # room for the legend above the curves
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.set_xlabel("P_FA [1]")
    axes.set_title(style.plain(name), loc="left")
