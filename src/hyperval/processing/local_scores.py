"""Detectors against the mean of each pixel's own surroundings: a moving window, with the global covariance.

The mean of a pixel is that of the background pixels in an outer square around it, less an inner square that keeps
the target out of it.  In coordinates y = W (x - mu), W Sigma W^T = 1, it is a moving average m of y, and with
z = y - m and d = W (t - mu) - m the detectors are those of :mod:`hyperval.processing.detectors`:

    cem, matched-filter   d z / |d|^2
    smf                   d z / |d|
    ace                   (d z)^2 / (|d|^2 |z|^2)
    rx                    |z|^2
    cem-correlation       t R^-1 x / (t R^-1 t), R = Sigma + mu_l mu_l^T inverted by Sherman & Morrison

The image is scored in strips with as much around them as the window reaches, so that memory does not grow with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.passes import StoredCube, Workspace, by_segments, runs
from hyperval.processing.pixel_scores import Whitener, stored_to_spectra

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LOCAL_DETECTORS = ("cem", "matched-filter", "smf", "ace", "rx", "cem-correlation")
# Fewer pixels make no mean to speak of; the global one stands in.
LEAST_PIXELS = 10
# Values that are held for the lines of a window.
_VALUES_AT_ONCE = 4_000_000
_LINES_AT_ONCE = 8


@dataclass(frozen=True)
class LocalWindow:
    """Sides of the two squares [pixels], odd, the inner one less than the outer."""

    outer: int
    inner: int

    def __post_init__(self) -> None:
        if not (1 <= self.inner < self.outer and self.inner % 2 == self.outer % 2 == 1):
            raise UsageError(
                f"a local window of {self.outer} pixels outside and {self.inner} inside",
                expected="odd numbers, the inner one less than the outer",
            )
        if self.outer**2 - self.inner**2 < LEAST_PIXELS:
            raise UsageError(f"a local window of less than {LEAST_PIXELS} pixels", mend="make the outer one larger")


@dataclass(frozen=True, eq=False)
class LocalScores:
    """Score maps (lines, samples) by name, and how many pixels fell back on the global mean."""

    maps: dict[str, Array]
    without_surroundings: int


def score_cube_locally(
    cube: StoredCube,
    detectors: Mapping[str, tuple[str, npt.ArrayLike | None]],
    whitener: Whitener,
    window: LocalWindow,
    counted: Mask,
    elm: EmpiricalLine | None = None,
    bands: Mask | None = None,
    *,
    needed: Mask | None = None,
    threads: int | None = None,
    watch: Callable[[Iterator[Any]], Iterator[Any]] = iter,
) -> LocalScores:
    """Score map of every detector with the mean of each pixel's surroundings.

    Parameters
    ----------
    detectors : name of the map -> name of the detector and its target (F,) in the selected bands
    whitener : of the background in the selected bands
    counted : (lines, samples) pixels that may count for a mean; those without data never do
    elm, bands, needed, threads, watch : as for :func:`hyperval.processing.pixel_scores.score_cube`

    Raises
    ------
    UsageError : a detector that has no local form, a target that does not fit, a mask of another shape.
    """
    used = np.ones(cube.bands, bool) if bands is None else np.asarray(bands, dtype=bool)
    must = used if needed is None else used | needed
    if counted.shape != (cube.lines, cube.samples):
        raise UsageError(
            f"the mask of the surroundings has shape {counted.shape}, the cube {cube.lines, cube.samples}"
        )
    for name, _ in detectors.values():
        if name not in LOCAL_DETECTORS:
            raise UsageError(f"{name!r} has no local form", expected="one of " + ", ".join(LOCAL_DETECTORS))
    slope, level = stored_to_spectra(cube, elm, used)
    spectra = [
        whitener.mean if target is None else np.asarray(target, dtype=float) for _, target in detectors.values()
    ]
    if any(t.shape != slope.shape for t in spectra):
        raise UsageError(f"a target does not have the {slope.size} bands that are selected")
    targets = np.stack([whitener.matrix @ (t - whitener.mean) for t in spectra])
    origin = whitener.matrix @ whitener.mean
    rows = whitener.matrix * slope
    constant = whitener.matrix @ (level - whitener.mean)
    around = window.outer // 2
    width = max(16, _VALUES_AT_ONCE // (window.outer * (slope.size + 1)) - 2 * around)
    stretches, workspace = runs(used), Workspace()
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}
    kinds = [name for name, _ in detectors.values()]

    def whitened(first: int, count: int, columns: slice) -> tuple[Array, Mask]:
        """(count, F + 1, w): y of the lines, 0 without data, and a last row of 1; which pixels have data."""
        stored, usable = cube.read_stored(first, count, must)
        stored, usable = stored[:, :, columns], usable[:, columns]
        pixels = workspace.flat("pixels", slope.size * usable.size, np.float64).reshape(slope.size, *usable.shape)
        for source, goal in stretches:
            np.copyto(pixels[goal], stored[source])
        with np.errstate(invalid="ignore", over="ignore"):
            y = rows @ pixels.reshape(slope.size, -1)
            y += constant[:, None]
        known = usable & np.isfinite(y).all(axis=0).reshape(usable.shape)
        y[:, ~known.ravel()] = 0.0
        out = np.ones((count, slope.size + 1, usable.shape[1]))
        out[:, :-1] = y.reshape(slope.size, *usable.shape).transpose(1, 0, 2)
        return out, known

    def strip(first: int, end: int, start: int, stop: int) -> int:
        """Score lines ``first`` to ``end`` of samples ``start`` to ``stop``; how many pixels lack surroundings."""
        left, right = max(start - around, 0), min(stop + around, cube.samples)
        inner, lonely = slice(start - left, stop - left), 0
        means = _MovingMeans(window, slope.size + 1, right - left)
        top, bottom = max(first - around, 0), min(end + around, cube.lines)
        for batch in range(top, bottom, _LINES_AT_ONCE):
            count = min(_LINES_AT_ONCE, bottom - batch)
            for k, (y, has) in enumerate(zip(*whitened(batch, count, slice(left, right)), strict=True)):
                means.add(batch + k, y, has, has & counted[batch + k, left:right])
                last = bottom - 1 if batch + k == bottom - 1 else batch + k - around
                for line in range(max(first, batch + k - around), min(end, last + 1)):
                    middle, known, mean, number = means.at(line)
                    scores = _scores(kinds, middle[:, inner], mean[:, inner], targets, origin)
                    known = known[inner]
                    lonely += int(np.count_nonzero((number[inner] < LEAST_PIXELS) & known))
                    for name, score in zip(detectors, scores, strict=True):
                        maps[name][line, start:stop] = np.where(known & np.isfinite(score), score, np.nan)
        return lonely

    def segment(firsts: range) -> int:
        end = min(firsts[-1] + _LINES_AT_ONCE, cube.lines)
        cuts = range(0, cube.samples, width)
        return sum(strip(firsts[0], end, start, min(start + width, cube.samples)) for start in cuts)

    lonely = sum(count for _, count in watch(by_segments(cube, _LINES_AT_ONCE, segment, threads=threads)))
    return LocalScores(maps, lonely)


class _MovingMeans:
    """Means over the window of each pixel of a line, while lines come in one after the other.

    Sums over the lines of the two squares move along; sums over samples are differences of cumulative sums.
    """

    def __init__(self, window: LocalWindow, rows: int, samples: int):
        self._window = window
        self._ring = np.zeros((window.outer, rows, samples))
        self._known = np.zeros((window.outer, samples), bool)
        self._weight = np.zeros((window.outer, samples))
        self._sums = {side: np.zeros((rows, samples)) for side in (window.outer, window.inner)}
        self._lines = {side: range(0) for side in (window.outer, window.inner)}
        self._first = self._next = -1

    def add(self, line: int, y: Array, known: Mask, counted: Mask) -> None:
        """The next line (F + 1, samples), which pixels of it have data, and which count for a mean."""
        if self._first < 0:
            self._first = line
        dropped = line - self._window.outer
        if dropped in self._lines[self._window.outer]:  # its place is needed
            self._move(self._window.outer, range(dropped + 1, self._lines[self._window.outer].stop))
        at = line % self._window.outer
        self._ring[at], self._known[at], self._weight[at] = y, known, counted
        self._next = line + 1

    def at(self, line: int) -> tuple[Array, Mask, Array, Array]:
        """y (F, samples) of a line, which of its pixels have data, the means (F, samples), pixels behind these."""
        outer, inner = self._window.outer, self._window.inner
        for side in (outer, inner):
            half = side // 2
            self._move(side, range(max(line - half, self._first), min(line + half + 1, self._next)))
        total = _along(self._sums[outer], outer) - _along(self._sums[inner], inner)
        number = np.rint(total[-1])
        mean = total[:-1]
        mean *= np.where(number >= LEAST_PIXELS, 1.0 / np.maximum(number, 1.0), 0.0)
        at = line % outer
        return self._ring[at, :-1], self._known[at], mean, number

    def _move(self, side: int, lines: range) -> None:
        """Make the sum of a square that of ``lines``."""
        window, total = self._lines[side], self._sums[side]
        for line in window:
            if line not in lines:
                total -= self._weighted(line)
        for line in lines:
            if line not in window:
                total += self._weighted(line)
        if not lines:
            total[:] = 0.0
        self._lines[side] = lines

    def _weighted(self, line: int) -> Array:
        at = line % self._window.outer
        weight = self._weight[at]
        return np.asarray(self._ring[at] if weight.all() else self._ring[at] * weight)


def _along(values: Array, side: int) -> Array:
    """Sums (F, samples) over ``side`` samples around each, cut at the ends."""
    half, size = side // 2, values.shape[1]
    summed = np.zeros((values.shape[0], size + 2 * half + 1))
    np.cumsum(values, axis=1, out=summed[:, half + 1 : half + 1 + size])
    summed[:, half + 1 + size :] = summed[:, half + size : half + size + 1]
    return summed[:, 2 * half + 1 :] - summed[:, :size]


def _scores(names: list[str], y: Array, m: Array, targets: Array, origin: Array) -> Array:
    """(K, N) scores of columns y (F, N) with local means m (F, N), both from the global mean."""
    z = y - m
    zz, mz, mm = (np.einsum("fn,fn->n", a, b) for a, b in ((z, z), (m, z), (m, m)))
    tz, tm = targets @ z, targets @ m
    out = np.empty((len(names), y.shape[1]))
    for i, name in enumerate(names):
        dz = tz[i] - mz  # d z with d = t - m
        dd = float(targets[i] @ targets[i]) - 2.0 * tm[i] + mm
        if name == "rx":
            out[i] = zz
        elif name == "ace":
            out[i] = _ratio(dz**2, dd * zz)
        elif name == "smf":
            out[i] = _ratio(dz, np.sqrt(dd))
        elif name == "cem-correlation":
            # All from the origin; R^-1 = 1 - mu mu^T/(1 + mu^2) in whitened coordinates.
            t, mu = targets[i] + origin, m + origin[:, None]
            x = y + origin[:, None]
            size, tmu = 1.0 + np.einsum("fn,fn->n", mu, mu), t @ mu
            out[i] = _ratio(t @ x - tmu * np.einsum("fn,fn->n", mu, x) / size, float(t @ t) - tmu**2 / size)
        else:
            out[i] = _ratio(dz, dd)
    return out


def _ratio(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.full_like(a, np.nan), where=b > 0)
