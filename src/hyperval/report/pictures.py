"""Figures that are pictures: the scene with its regions, and score maps with their targets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from hyperval.report import style
from hyperval.report.run import Quicklook, RunReport, ScoreMap
from hyperval.report.style import Drawing
from hyperval.units import PLAUSIBLE_NM

_MOST_PIXELS = 800  # along the longer side of a picture
_DPI = 200.0  # at which all of these are drawn
_MOST_MAPS = 6
_MOST_NUMBERED = 40  # outlines; more are drawn without numbers, and counted
_LONGEST_STRIP = 2.5  # ratio of the sides beyond which an image is cut to its regions
_OUTLINE_COLOURS = ("#FFD700", "#00E5FF", "#FF4FD8", "#7CFC00", "#FF8C00", "#FFFFFF")


def draw_pictures(run: RunReport) -> list[Drawing]:
    """The scene, and the first score maps with what the model expects in their place."""
    with style.house_style():
        scene = [] if run.quicklook is None else [quicklook_figure(run.quicklook, simulated=run.simulated)]
        return scene + score_map_figures(run.score_maps, simulated=run.simulated)


def quicklook_figure(quicklook: Quicklook, *, simulated: bool) -> Drawing:
    """The scene in three bands, its regions outlined and numbered, with a scale."""
    rgb = np.asarray(quicklook.rgb)
    view = shown_window(rgb.shape[:2], quicklook.regions)
    step = max(1, math.ceil(max(view.lines, view.samples) / _MOST_PIXELS))
    picture = rgb[view.first_line : view.end_line : step, view.first_sample : view.end_sample : step]
    figure = style.new_figure(*_figure_size(view), "Scene", simulated)
    axes = figure.add_subplot()
    # Opaque from the start: matplotlib would add that as float64, and resample the picture in it.
    opaque = np.concatenate([picture, np.full((*picture.shape[:2], 1), 255, np.uint8)], axis=2)
    axes.imshow(opaque, extent=_extent(view, picture.shape, step), interpolation="nearest")
    _finish(axes, view, quicklook.regions, quicklook.pixel_size_m)
    bands = ", ".join(f"{band:.0f}" for band in quicklook.band_nm)
    bands = f"bands {bands}" if min(quicklook.band_nm, default=PLAUSIBLE_NM[0]) < PLAUSIBLE_NM[0] else f"{bands} nm"
    title = "Scene with its regions of interest" + (f" (red, green, blue: {bands})" if quicklook.band_nm else "")
    cut = _cut(rgb.shape, view)
    title += f"; {cut}" if cut else ""
    alt = f"Picture of the scene, {_where(rgb.shape, view)}; outlined: {', '.join(quicklook.regions) or 'nothing'}."
    return Drawing(
        "scene", "scene", title, alt, style.png_bytes(figure, dpi=_DPI), "png",
        width_px=_css_width(figure), legend=_numbered_names(quicklook.regions),
    )  # fmt: skip


def score_map_figures(maps: Mapping[str, ScoreMap], *, simulated: bool) -> list[Drawing]:
    """The first maps, each a figure: scores as colours, targets outlined; and what the model expects, likewise."""
    drawings = []
    for number, (name, score_map) in enumerate(list(maps.items())[:_MOST_MAPS], start=1):
        scores = np.asarray(score_map.values, dtype=float)
        view = shown_window(scores.shape, score_map.outlines)
        limits = _score_limits(score_map)
        outlined = f"; outlined: {_words_of(score_map.outlines) or 'nothing'}."
        values, block = block_maximum(scores[view.part], _MOST_PIXELS)
        cut = _cut(scores.shape, view)
        note = f"; {cut}" if cut else ""
        note += f"; each point is the largest score of {block} by {block} pixels" if block > 1 else ""
        title = f"Score map {name}{', targets outlined' if score_map.outlines else ''}{note}"
        size = f"{scores.shape[0]} lines by {scores.shape[1]} samples"
        alt = f"Map of the detector score {name}, {size}{note}{outlined}"
        content = _map_bytes(f"Score map {name}", values, block, view, limits, score_map, simulated)
        drawings.append(_map_drawing(f"score-map-{number}", title, alt, content, score_map))
        if score_map.expected is not None:
            values, block = block_maximum(score_map.expected.of(view.part).astype(float), _MOST_PIXELS)
            title = (
                f"What the model expects of {name}, in the colours of the measured map: the mean score of each "
                "class of ground and kind of target; blank where the campaign does not say what lies there"
            )
            alt = f"Map of the score {name} that the model expects, of the same pixels{note}{outlined}"
            content = _map_bytes(f"Expected score {name}", values, block, view, limits, score_map, simulated)
            drawings.append(_map_drawing(f"score-map-{number}-expected", title, alt, content, score_map))
    return drawings


def _map_drawing(name: str, title: str, alt: str, content: tuple[bytes, int], score_map: ScoreMap) -> Drawing:
    picture, width = content
    return Drawing(
        name, "scores", title, alt, picture, "png", width_px=width, legend=_numbered_names(score_map.outlines)
    )


def _map_bytes(
    title: str, values: npt.NDArray[np.float64], block: int, view: Window, limits: tuple[float, float],
    score_map: ScoreMap, simulated: bool,
) -> tuple[bytes, int]:  # fmt: skip
    """A map as PNG, and its width on the page [CSS pixels]."""
    width, height = _figure_size(view)
    figure = style.new_figure(width + 1.2, height, title, simulated)
    axes = figure.add_subplot()
    image = axes.imshow(
        values, cmap="viridis", vmin=limits[0], vmax=limits[1], extent=_extent(view, values.shape, block),
        interpolation="nearest", interpolation_stage="data",  # one number for a pixel is resampled, not four
    )  # fmt: skip
    figure.colorbar(image, ax=axes, shrink=0.8, extend="both", label="score [1]")
    _finish(axes, view, score_map.outlines, score_map.pixel_size_m)
    return style.png_bytes(figure, dpi=_DPI), _css_width(figure)


@dataclass(frozen=True)
class Window:
    """The part of an image that is drawn: lines and samples from the first to before the end."""

    first_line: int
    end_line: int
    first_sample: int
    end_sample: int

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.end_line - self.first_line

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.end_sample - self.first_sample

    @property
    def part(self) -> tuple[slice, slice]:
        """Lines and samples."""
        return slice(self.first_line, self.end_line), slice(self.first_sample, self.end_sample)


def shown_window(shape: tuple[int, ...], regions: Mapping[str, Any]) -> Window:
    """The whole image; of a long strip only the part around its regions, where it has any."""
    lines, samples = shape[:2]
    whole = Window(0, lines, 0, samples)
    if max(lines, samples) <= _LONGEST_STRIP * min(lines, samples):
        return whole
    inside = np.zeros((lines, samples), bool)
    for mask in regions.values():
        inside |= np.asarray(mask, bool)
    if not inside.any():
        return whole
    line, sample = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    margin = max(10, min(lines, samples) // 10)
    if lines > samples:
        return Window(max(int(line[0]) - margin, 0), min(int(line[-1]) + 1 + margin, lines), 0, samples)
    return Window(0, lines, max(int(sample[0]) - margin, 0), min(int(sample[-1]) + 1 + margin, samples))


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
    mask = np.asarray(mask, bool)
    lines, samples = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not lines.size:
        return np.empty((0, 2, 2))
    corner = samples[0], lines[0]
    padded = np.pad(mask[lines[0] : lines[-1] + 1, samples[0] : samples[-1] + 1], 1)
    row, column = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = np.stack([np.stack([column, row], -1), np.stack([column, row + 1], -1)], axis=1)
    row, column = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    level = np.stack([np.stack([column, row], -1), np.stack([column + 1, row], -1)], axis=1)
    return np.asarray(np.concatenate([upright, level]) + corner, dtype=float)


def _outlines(axes: Axes, regions: Mapping[str, Any]) -> None:
    drawn = [(n, s) for n, mask in enumerate(regions.values()) if len(s := outline_segments(mask))]
    if not drawn:
        return
    colours = [_OUTLINE_COLOURS[n % len(_OUTLINE_COLOURS)] for n, _ in drawn]
    every = np.concatenate([segments for _, segments in drawn])
    each = [colour for colour, (_, segments) in zip(colours, drawn, strict=True) for _ in segments]
    axes.add_collection(LineCollection(list(every), colors="black", linewidths=2.0), autolim=False)
    axes.add_collection(LineCollection(list(every), colors=each, linewidths=1.1), autolim=False)
    if len(drawn) > _MOST_NUMBERED:
        return  # numbers would hide what they stand beside
    for colour, (number, segments) in zip(colours, drawn, strict=True):
        right, top = segments[..., 0].max(), segments[..., 1].min()
        axes.annotate(
            str(number + 1), (right, top), (2, 1), textcoords="offset points", fontsize=7.5, color="black",
            bbox={"facecolor": colour, "linewidth": 0, "pad": 0.8, "alpha": 0.9},
        )  # fmt: skip


def _scale_bar(axes: Axes, pixel_size_m: float | None, view: Window) -> None:
    if not pixel_size_m or not math.isfinite(pixel_size_m):
        return
    length_m = _round_length(0.25 * view.samples * pixel_size_m)
    length = length_m / pixel_size_m
    x, y = view.first_sample + 0.04 * view.samples, view.first_line + 0.96 * view.lines
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


def _finish(axes: Axes, view: Window, regions: Mapping[str, Any], pixel_size_m: float | None) -> None:
    axes.grid(visible=False)
    axes.set_xlabel("sample [pixel]")
    axes.set_ylabel("line [pixel]")
    axes.set(xlim=(view.first_sample, view.end_sample), ylim=(view.end_line, view.first_line))
    _outlines(axes, regions)
    _scale_bar(axes, pixel_size_m, view)


def _extent(view: Window, shape: tuple[int, ...], block: int) -> tuple[float, float, float, float]:
    """Left, right, bottom, top of a picture of which each point is ``block`` pixels wide."""
    right, bottom = view.first_sample + block * shape[1], view.first_line + block * shape[0]
    return (view.first_sample, right, bottom, view.first_line)


def _where(shape: tuple[int, ...], view: Window) -> str:
    text = f"{shape[0]} lines by {shape[1]} samples"
    cut = _cut(shape, view)
    return f"{text}, of which {cut} are shown" if cut else text


def _cut(shape: tuple[int, ...], view: Window) -> str:
    """The lines and samples of a window that is not the whole image; empty when it is."""
    if (view.lines, view.samples) == tuple(shape[:2]):
        return ""
    lines = f"lines {view.first_line} to {view.end_line - 1}"
    return f"{lines}, samples {view.first_sample} to {view.end_sample - 1}"


def _numbered_names(regions: Mapping[str, Any]) -> str:
    if len(regions) > _MOST_NUMBERED:
        return f"{len(regions)} outlines"
    return "; ".join(f"{number} {name}" for number, name in enumerate(regions, start=1))


def _words_of(regions: Mapping[str, Any]) -> str:
    return f"{len(regions)} objects" if len(regions) > _MOST_NUMBERED else ", ".join(regions)


def _figure_size(view: Window) -> tuple[float, float]:
    """Width and height [in] that suit the shape of the picture; small, as three stand beside each other."""
    aspect = min(max(view.lines / view.samples, 0.15), 4.0)
    width = min(4.6, 4.2 / aspect) if aspect < 2.0 else max(5.2 / aspect, 2.0)
    return width + 0.9, width * aspect + 0.9


def _css_width(figure: Figure) -> int:
    return round(96 * float(figure.get_figwidth()))
