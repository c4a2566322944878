"""Pictures of pixels: the scene with its regions, and score maps with their targets, as PNG with axes and scale.

A picture is drawn in indices of 256 colours from the start: its own, and the few of outlines and letters.
"""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont
from skimage.measure import block_reduce

from hyperval.data import Array, Mask
from hyperval.figures.spec import VIRIDIS, Drawing, palette_colours, shorten
from hyperval.run import Quicklook, ScoreMap

_MAX_PIXELS = 800  # along the longer side of a picture
_PER_CSS = 200 / 96  # points of the picture to a pixel of the page
_MAX_MAPS = 6
_MAX_NUMBERED = 40  # outlines; more are drawn without numbers, and counted
_LONGEST_STRIP = 2.5  # ratio of the sides beyond which an image is cut to its regions
_COLOURS = 240  # colours of the picture itself
_TONES = 120  # of them for scores: a page has room for 3 MB
_LINES = ("#FFFFFF", "#000000", "#444444", "#FFD700", "#00E5FF", "#FF4FD8", "#7CFC00", "#FF8C00")
_WHITE, _BLACK, _GREY = _COLOURS, _COLOURS + 1, _COLOURS + 2
_OUTLINES = (_COLOURS + 3, _COLOURS + 4, _COLOURS + 5, _COLOURS + 6, _COLOURS + 7, _WHITE)
_LETTER, _SMALL, _TITLE = 25, 21, 28  # heights
_LEFT, _TOP, _FOOT, _RIGHT, _BAR, _BAR_ROOM = 96, 80, 76, 40, 32, 190  # room about the picture
Indices = npt.NDArray[np.uint8]
Window = tuple[slice, slice]  # the lines and the samples of an image that are drawn


def draw_pictures(quicklook: Quicklook | None, maps: Mapping[str, ScoreMap], *, simulated: bool) -> list[Drawing]:
    """The scene, and the first score maps with what the model expects in their place."""
    scene = [] if quicklook is None else [quicklook_figure(quicklook, simulated=simulated)]
    first = enumerate(list(maps.items())[:_MAX_MAPS], start=1)
    return scene + [one for n, (name, map_) in first for one in _map_drawings(f"score-map-{n}", name, map_, simulated)]


def quicklook_figure(quicklook: Quicklook, *, simulated: bool) -> Drawing:
    """The scene in three bands, its regions outlined and numbered, with a scale."""
    rgb = np.asarray(quicklook.rgb)
    view = shown_window(rgb.shape[:2], quicklook.regions)
    step = max(1, math.ceil(max(_image_size(view)) / _MAX_PIXELS))
    whole = Image.fromarray(np.ascontiguousarray(rgb[view][::step, ::step]))
    few = whole.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    title = f"Scene with its regions of interest{f' (red, green, blue: {quicklook.bands})' if quicklook.bands else ''}"
    title += _window_text(rgb.shape, view)
    canvas = _Canvas("Scene", np.asarray(few), few.getpalette() or [], view, step, simulated=simulated)
    return canvas.drawing("scene", "scene", title, quicklook.regions, quicklook.pixel_size_m)


def _map_drawings(file: str, name: str, score_map: ScoreMap, simulated: bool) -> Iterator[Drawing]:
    """A map, scores as colours and targets outlined; what the model expects, likewise; and what moves its alarms."""
    scores, outlines, metres = np.asarray(score_map.values), score_map.outlines, score_map.pixel_size_m
    view, limits = shown_window(scores.shape, outlines), _score_limits(score_map)
    values, block = block_maximum(scores[view].astype(float), _MAX_PIXELS)
    colours = [int(tone[k : k + 2], 16) for tone in palette_colours(VIRIDIS, _TONES) for k in (1, 3, 5)]
    canvas = functools.partial(_Canvas, colours=colours, view=view, block=block, simulated=simulated)
    note = _window_text(scores.shape, view)
    note += f"; each point is the largest score of {block} by {block} pixels" if block > 1 else ""
    title = f"Score map {name}{', targets outlined' if outlines else ''}{note}"
    drawn = canvas(f"Score map {name}", _colour_numbers(values, limits), limits=limits)
    yield drawn.drawing(file, "scores", title, outlines, metres)
    if score_map.expected is not None:
        expected, _ = block_maximum(score_map.expected.of(view).astype(float), _MAX_PIXELS)
        title = f"Model expectation of {name}, in the colours of the measured map: the mean score of each class of "
        title += "ground and kind of target; blank where the campaign does not state the ground"
        drawn = canvas(f"Expected score {name}", _colour_numbers(expected, limits), limits=limits)
        yield drawn.drawing(f"{file}-expected", "scores", title, outlines, metres)
    if score_map.influence is not None:
        ratio, threshold, words = score_map.influence
        limits = float(np.nanmin(ratio)), float(np.nanmax(ratio)) + 1e-9
        toned = _colour_numbers(ratio[view][::block, ::block], limits)
        toned[(values > threshold) & (toned != _WHITE)] = _BLACK
        title = f"False alarms of {name}, predicted over measured, without the part of the image that a pixel "
        title += f"lies in; black: pixels above the threshold{note}. {words[0].upper()}{words[1:]}"
        drawn = canvas(f"False alarms {name}", toned, limits=limits, what="ratio")
        yield drawn.drawing(f"{file}-influence", "scores", title, {}, metres)


def _colour_numbers(values: Array, limits: tuple[float, float]) -> Indices:
    """Scores as the number of their colour; white where there is none."""
    low, high = limits
    finite = np.isfinite(values)
    part = np.where(finite, (values - low) * (_TONES / (high - low)), 0.0)
    return np.where(finite, np.clip(part, 0, _TONES - 1), _WHITE).astype(np.uint8)


class _Canvas:
    """A picture with its axes, title and, where it has limits, scale of colours."""

    def __init__(
        self, title: str, picture: Indices, colours: Sequence[int], view: Window, block: int,
        limits: tuple[float, float] | None = None, what: str = "score", *, simulated: bool,
    ) -> None:  # fmt: skip
        self._view = view
        lines, samples = picture.shape
        self._zoom = max(1, round(_PER_CSS * _css_width(view) / samples))
        width, height = self._zoom * samples, self._zoom * lines
        self._per_pixel = self._zoom / block
        self._end = _LEFT + width, _TOP + height
        right = _BAR_ROOM if limits else _RIGHT
        self._image = Image.new("P", (self._end[0] + right, max(self._end[1] + _FOOT, 330)), _WHITE)
        palette = [*colours, *[0] * (3 * _COLOURS - len(colours))][: 3 * _COLOURS]  # of the picture, lines and letters
        self._image.putpalette(palette + [int(colour[k : k + 2], 16) for colour in _LINES for k in (1, 3, 5)])
        self._image.paste(Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST), (_LEFT, _TOP))
        self._pen = ImageDraw.Draw(self._image)
        words, room = title + (" (simulated collection)" if simulated else ""), self._image.width - 16
        while _font(_TITLE).getlength(words) > room and len(words) > 8:
            words = shorten(words, len(words) - 2)
        self._pen.text((self._image.width // 2, 6), words, _BLACK, _font(_TITLE), anchor="ma")
        self._axes()
        if limits:
            self._scale_of_colours(limits, what)

    def drawing(
        self, name: str, section: str, title: str, regions: Mapping[str, Any], pixel_size_m: float | None
    ) -> Drawing:
        """The finished picture with the outlines of regions, their numbers, and a scale."""
        labels = []
        for number, (mask, colour) in enumerate(zip(regions.values(), cycle(_OUTLINES)), start=1):
            ends = self._to_picture(outline_segments(mask)).reshape(-1, 4)
            for tone, width in ((_BLACK, 5), (colour, 3)):
                for one in ends.tolist():
                    self._pen.line(one, tone, width)
            if len(ends):
                labels.append((ends[:, ::2].max() + 4, ends[:, 1::2].min() - 3, str(number), colour, "lb"))
        for label in labels if len(labels) <= _MAX_NUMBERED else ():  # more would hide what they name
            self._label(*label)
        if pixel_size_m and math.isfinite(pixel_size_m):
            length_m = _round_length(0.25 * _image_size(self._view)[1] * pixel_size_m)
            start, y = _LEFT + 0.04 * (self._end[0] - _LEFT), self._end[1] - 0.04 * (self._end[1] - _TOP)
            right = start + length_m / pixel_size_m * self._per_pixel
            for colour, width, more in ((_BLACK, 12, 2), (_WHITE, 7, 0)):
                self._pen.line((start - more, y, right + more, y), colour, width)
            self._label((start + right) / 2, y - 12, f"{length_m:g} m", _WHITE, "mb")
        out = io.BytesIO()
        self._image.save(out, format="png")
        named = "; ".join(f"{number}: {one}" for number, one in enumerate(regions, start=1))
        named = f"{len(regions)} outlines" if len(regions) > _MAX_NUMBERED else named
        width_px, (lines, samples) = round(self._image.width / _PER_CSS), _image_size(self._view)
        alt = f"{title}: {lines} lines by {samples} samples; outlined: {named or 'nothing'}."
        return Drawing(name, section, title, alt, out.getvalue(), "png", width_px, named)

    def _to_picture(self, places: npt.ArrayLike) -> Array:
        """Where (..., 2) samples and lines of the image lie in the picture."""
        lines, samples = self._view
        return np.asarray((np.asarray(places) - (samples.start, lines.start)) * self._per_pixel + (_LEFT, _TOP))

    def _axes(self) -> None:
        right, bottom = self._end
        self._pen.rectangle((_LEFT - 2, _TOP - 2, right + 1, bottom + 1), outline=_GREY, width=2)
        self._pen.text((8, _TOP - 8), "line [pixel]", _BLACK, _font(_LETTER), anchor="lb")
        self._pen.text(((_LEFT + right) / 2, bottom + 44), "sample [pixel]", _BLACK, _font(_LETTER), anchor="ma")
        lines, samples = self._view
        for sample in _ticks(samples):
            x, _ = self._to_picture((sample, 0.0))
            self._pen.line((x, bottom, x, bottom + 9), _GREY, 2)
            self._pen.text((x, bottom + 14), f"{sample:g}", _BLACK, _font(_SMALL), anchor="ma")
        for line in _ticks(lines):
            _, y = self._to_picture((0.0, line))
            self._pen.line((_LEFT - 11, y, _LEFT - 2, y), _GREY, 2)
            self._pen.text((_LEFT - 16, y), f"{line:g}", _BLACK, _font(_SMALL), anchor="rm")

    def _scale_of_colours(self, limits: tuple[float, float], what: str) -> None:
        x, height = self._end[0] + 28, max(self._end[1] - _TOP, 200)
        tones = np.repeat(np.linspace(_TONES - 1, 0, height).round().astype(np.uint8)[:, None], _BAR, axis=1)
        self._image.paste(Image.fromarray(tones), (x, _TOP))
        self._pen.text((x, _TOP - 8), what, _BLACK, _font(_LETTER), anchor="lb")
        for part in (0.0, 0.25, 0.5, 0.75, 1.0):
            y = _TOP + (1.0 - part) * height
            sign = {0.0: "< ", 1.0: "> "}.get(part, "")
            words = f"{sign}{limits[0] + part * (limits[1] - limits[0]):.3g}"
            self._pen.line((x + _BAR, y, x + _BAR + 8, y), _GREY, 2)
            self._pen.text((x + _BAR + 12, y), words, _BLACK, _font(_SMALL), anchor="lm")

    def _label(self, x: float, y: float, words: str, colour: int, anchor: str) -> None:
        box = self._pen.textbbox((x, y), words, _font(_SMALL), anchor=anchor)
        self._pen.rectangle((box[0] - 3, box[1] - 3, box[2] + 3, box[3] + 3), fill=colour)
        self._pen.text((x, y), words, _BLACK, _font(_SMALL), anchor=anchor)


@functools.cache
def _font(height: int) -> Any:
    return ImageFont.load_default(height)


def _ticks(along: slice) -> list[float]:
    """Round places within an axis."""
    step = max(_round_length((along.stop - along.start) / 3), 1.0)
    return [float(tick) for tick in np.arange(math.ceil(along.start / step) * step, along.stop + 1e-9, step)]


def shown_window(shape: tuple[int, ...], regions: Mapping[str, Any]) -> Window:
    """The whole image; of a long strip only the part around its regions, where it has any."""
    sides = shape[:2]
    window = [slice(0, side) for side in sides]
    masks = regions.values() if max(sides) > _LONGEST_STRIP * min(sides) else ()
    inside = functools.reduce(np.logical_or, masks, np.zeros(sides, bool))
    if inside.any():
        along = int(np.argmax(sides))
        inside_at, margin = np.flatnonzero(inside.any(axis=1 - along)), max(10, min(sides) // 10)
        window[along] = slice(max(int(inside_at[0]) - margin, 0), min(int(inside_at[-1]) + 1 + margin, sides[along]))
    return window[0], window[1]


def _image_size(view: Window) -> tuple[int, int]:
    """Numbers of lines and samples."""
    return view[0].stop - view[0].start, view[1].stop - view[1].start


def _score_limits(score_map: ScoreMap) -> tuple[float, float]:
    """Ends of the colour scale: almost all of the image, and the better half of the targets' pixels."""
    values = np.asarray(score_map.values, dtype=float)
    finite = np.isfinite(values)
    if not finite.any():
        return 0.0, 1.0
    low, high = map(float, np.percentile(values[finite], [1.0, 99.9]))
    on_target = functools.reduce(np.logical_or, score_map.outlines.values(), np.zeros(values.shape, bool)) & finite
    better = float(np.percentile(values[on_target], 75.0)) if on_target.any() else high
    return low, max(high, better, low + 1e-9)


def block_maximum(values: Array, most: int) -> tuple[Array, int]:
    """``values`` (lines, samples) reduced to at most ``most`` a side by the maximum of each square block,
    so that a target of one pixel is still seen; and the side of the block [pixels].
    """
    block = max(1, math.ceil(max(values.shape) / most))
    finite = np.where(np.isfinite(values), values, -np.inf)
    reduced = finite if block == 1 else block_reduce(finite, block, np.max, cval=-np.inf)
    return np.where(np.isfinite(reduced), reduced, np.nan), block


def outline_segments(mask: Mask) -> Array:
    """(S, 2, 2) pixel edges, as (sample, line) pairs, that part the mask from what is not in it."""
    mask = np.asarray(mask, bool)
    lines, samples = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not lines.size:
        return np.empty((0, 2, 2))
    padded, edges = np.pad(mask[lines[0] : lines[-1] + 1, samples[0] : samples[-1] + 1], 1), []
    for along, back in ((1, (0, 1)), (0, (1, 0))):  # neighbours beside each other differ, then those above each other
        ends = np.argwhere(np.diff(padded, axis=along))[:, ::-1]
        edges.append(np.stack([ends - back, ends], axis=1))
    return np.asarray(np.add(np.concatenate(edges), (samples[0], lines[0])), float)


def _round_length(length: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is not above ``length``."""
    decade = 10.0 ** math.floor(math.log10(length))
    return next(step * decade for step in (5.0, 2.0, 1.0) if step * decade <= length * (1 + 1e-12))


def _window_text(shape: tuple[int, ...], view: Window) -> str:
    """Of a window that is not the whole image "; ", and its lines and samples; empty when it is."""
    lines, samples = (f"{part.start} to {part.stop - 1} of {size}" for part, size in zip(view, shape, strict=False))
    return "" if _image_size(view) == tuple(shape[:2]) else f"; lines {lines}, samples {samples}"


def _css_width(view: Window) -> float:
    """Width [CSS pixels] that suits the shape of the picture; small, as three stand beside each other."""
    lines, samples = _image_size(view)
    aspect = min(max(lines / samples, 0.15), 4.0)
    return 96 * (min(4.6, 4.2 / aspect) if aspect < 2.0 else max(5.2 / aspect, 2.0))
