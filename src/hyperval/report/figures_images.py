"""Figures that are pictures: the scene with its regions, and score maps with their targets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from hyperval.report import style
from hyperval.report.run import Quicklook, ScoreMap
from hyperval.report.style import Drawing

_MOST_PIXELS = 1200  # along the longer side of a picture
_MOST_MAPS = 6
_MOST_NAMED = 40
_OUTLINE_COLOURS = ("#FFD700", "#00E5FF", "#FF4FD8", "#7CFC00", "#FF8C00", "#FFFFFF")


def quicklook_figure(quicklook: Quicklook, *, simulated: bool) -> Drawing:
    """The scene in three bands, its regions outlined and numbered, with a scale."""
    rgb = np.asarray(quicklook.rgb)
    step = _step(rgb.shape)
    lines, samples = rgb.shape[:2]
    tall = lines > samples
    names = list(quicklook.regions)[:_MOST_NAMED]
    width, height = _figure_size(lines, samples, with_names=bool(names))
    figure = style.new_figure(width, height, "Scene", simulated)
    axes = figure.add_subplot()
    shown = rgb[::step, ::step]
    axes.imshow(shown, extent=(0, step * shown.shape[1], step * shown.shape[0], 0), interpolation="nearest")
    axes.set(xlim=(0, samples), ylim=(lines, 0))
    _pixel_axes(axes)
    _outlines(axes, quicklook.regions)
    _scale_bar(axes, quicklook.pixel_size_m, samples, lines)
    if names:
        text = "\n".join(f"{i}  {style.plain(style.shortened(name, 30))}" for i, name in enumerate(names, 1))
        if len(quicklook.regions) > len(names):
            text += f"\nand {len(quicklook.regions) - len(names)} more"
        if tall or samples < 2 * lines:
            axes.annotate(text, (1.02, 1.0), xycoords="axes fraction", va="top", fontsize=8, linespacing=1.35)
        else:
            axes.annotate(
                text, (0.0, 0.0), (0, -34), xycoords="axes fraction", textcoords="offset points", va="top",
                fontsize=8, linespacing=1.35,
            )  # fmt: skip
    bands = ", ".join(f"{band:.0f}" for band in quicklook.band_nm)
    title = "Scene with its regions of interest" + (f" (red, green, blue: {bands} nm)" if bands else "")
    alt = (
        f"Picture of the scene, {lines} lines by {samples} samples; outlined regions: {', '.join(names) or 'none'}."
    )
    return Drawing("scene", "scene", title, alt, style.png_bytes(figure), "png", width_px=_css_width(figure))


def score_map_figures(maps: Mapping[str, ScoreMap], *, simulated: bool) -> list[Drawing]:
    """The first maps, one figure: scores as colours, targets outlined."""
    shown = list(maps.items())[:_MOST_MAPS]
    drawings = []
    for number, (name, score_map) in enumerate(shown, start=1):
        values, block = block_maximum(np.asarray(score_map.values, dtype=float), _MOST_PIXELS)
        lines, samples = np.asarray(score_map.values).shape
        width, height = _figure_size(lines, samples, with_names=False)
        figure = style.new_figure(width + 1.2, height, f"Score map {name}", simulated)
        axes = figure.add_subplot()
        low, high = _score_limits(score_map)
        image = axes.imshow(
            values, cmap="viridis", vmin=low, vmax=high,
            extent=(0, block * values.shape[1], block * values.shape[0], 0), interpolation="nearest",
        )  # fmt: skip
        figure.colorbar(image, ax=axes, shrink=0.8, extend="both", label="score [1]")
        _pixel_axes(axes)
        axes.set(xlim=(0, samples), ylim=(lines, 0))
        _outlines(axes, score_map.outlines)
        _scale_bar(axes, score_map.pixel_size_m, samples, lines)
        outlined = ", ".join(score_map.outlines) or "none"
        note = f"; each point is the largest score of {block} by {block} pixels" if block > 1 else ""
        alt = f"Map of the detector score {name}, {lines} lines by {samples} samples{note}; outlined: {outlined}."
        drawings.append(
            Drawing(
                f"score-map-{number}",
                "scores",
                f"Score map {name}{', targets outlined' if score_map.outlines else ''}{note}",
                alt,
                style.png_bytes(figure, dpi=110.0),
                "png",
                width_px=_css_width(figure),
                legend="; ".join(f"{i} {name}" for i, name in enumerate(score_map.outlines, 1)),
            )
        )
    return drawings


def _score_limits(score_map: ScoreMap) -> tuple[float, float]:
    """Ends of the colour scale: almost all of the image, and the better half of the targets' pixels."""
    values = np.asarray(score_map.values, dtype=float)
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(finite, [1.0, 99.9]))
    on_target = np.zeros(values.shape, bool)
    for mask in score_map.outlines.values():
        on_target |= np.asarray(mask, bool)
    scores = values[on_target & np.isfinite(values)]
    if scores.size:
        high = max(high, float(np.percentile(scores, 75.0)))
    return low, max(high, low + 1e-9)


def block_maximum(values: npt.NDArray[np.float64], most: int) -> tuple[npt.NDArray[np.float64], int]:
    """``values`` (lines, samples) reduced to at most ``most`` a side by the maximum of each square block,
    so that a target of one pixel is still seen; and the side of the block [pixels].
    """
    block = max(1, math.ceil(max(values.shape) / most))
    if block == 1:
        return values, 1
    lines, samples = (math.ceil(n / block) for n in values.shape)
    padded = np.full((lines * block, samples * block), -np.inf)
    padded[: values.shape[0], : values.shape[1]] = np.where(np.isfinite(values), values, -np.inf)
    reduced = padded.reshape(lines, block, samples, block).max(axis=(1, 3))
    return np.where(np.isfinite(reduced), reduced, np.nan), block


def outline_segments(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """(S, 2, 2) pixel edges, as (sample, line) pairs, that part the mask from what is not in it."""
    padded = np.pad(np.asarray(mask, bool), 1)
    row, column = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = np.stack([np.stack([column, row], -1), np.stack([column, row + 1], -1)], axis=1)
    row, column = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    level = np.stack([np.stack([column, row], -1), np.stack([column + 1, row], -1)], axis=1)
    return np.concatenate([upright, level]).astype(float)


def _outlines(axes: Axes, regions: Mapping[str, Any]) -> None:
    for number, mask in enumerate(regions.values()):
        segments = outline_segments(mask)
        if not len(segments):
            continue
        colour = _OUTLINE_COLOURS[number % len(_OUTLINE_COLOURS)]
        axes.add_collection(LineCollection(list(segments), colors="black", linewidths=2.0))
        axes.add_collection(LineCollection(list(segments), colors=colour, linewidths=1.1))
        if number < _MOST_NAMED:
            right, top = segments[..., 0].max(), segments[..., 1].min()
            axes.annotate(
                str(number + 1), (right, top), (2, 1), textcoords="offset points", fontsize=7.5, color="black",
                bbox={"facecolor": colour, "linewidth": 0, "pad": 0.8, "alpha": 0.9},
            )  # fmt: skip


def _scale_bar(axes: Axes, pixel_size_m: float | None, samples: int, lines: int) -> None:
    if not pixel_size_m or not math.isfinite(pixel_size_m):
        return
    length_m = _round_length(0.25 * samples * pixel_size_m)
    length = length_m / pixel_size_m
    x, y = 0.04 * samples, 0.96 * lines
    axes.plot([x, x + length], [y, y], color="black", linewidth=5, solid_capstyle="butt")
    axes.plot([x, x + length], [y, y], color="white", linewidth=3, solid_capstyle="butt")
    axes.annotate(
        f"{length_m:g} m", (x + length / 2, y), (0, 5), textcoords="offset points", ha="center", fontsize=8,
        bbox={"facecolor": "white", "alpha": 0.85, "linewidth": 0, "pad": 1.0},
    )  # fmt: skip


def _round_length(length: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``length``."""
    decade = 10.0 ** math.floor(math.log10(length))
    return next(step * decade for step in (5.0, 2.0, 1.0) if step * decade <= length * (1 + 1e-12))


def _pixel_axes(axes: Axes) -> None:
    axes.grid(visible=False)
    axes.set_xlabel("sample [pixel]")
    axes.set_ylabel("line [pixel]")


def _figure_size(lines: int, samples: int, *, with_names: bool) -> tuple[float, float]:
    """Width and height [in] that suit the shape of the picture."""
    aspect = min(max(lines / samples, 0.2), 3.0)
    width = 6.2 if aspect <= 1.2 else max(7.5 / aspect, 3.0)
    extra = 2.6 if with_names and samples < 2 * lines else 0.6
    below = 1.2 if with_names and samples >= 2 * lines else 0.0
    return width + extra, min(width * aspect, 9.0) + 1.0 + below


def _css_width(figure: Figure) -> int:
    return round(96 * float(figure.get_figwidth()))


def _step(shape: tuple[int, ...]) -> int:
    return max(1, math.ceil(max(shape[:2]) / _MOST_PIXELS))
