"""Detectors against the mean of each pixel's own surroundings: a moving window, with the global covariance.

The mean of a pixel is that of the background pixels in an outer square around it, less an inner square that keeps
the target out of it.  In coordinates y = W (x - mu), W Sigma W^T = 1, it is a moving average m of y, and with
z = y - m and d = W (t - mu) - m the detectors are those of :mod:`hyperval.processing.detectors`:

    cem, matched-filter   d z / |d|^2
    smf                   d z / |d|
    ace                   (d z)^2 / (|d|^2 |z|^2)
    rx                    |z|^2
    cem-correlation       t R^-1 x / (t R^-1 t), R = Sigma + mu_l mu_l^T inverted by Sherman & Morrison

The image is scored in tiles with as much around them as the window reaches, so that memory does not grow with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.passes import StoredCube, Workspace, as_columns, by_segments, runs
from hyperval.processing.pixel_scores import Whitener, stored_to_spectra

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

LOCAL_DETECTORS = ("cem", "matched-filter", "smf", "ace", "rx", "cem-correlation")
# Fewer pixels make no mean to speak of; the global one stands in.
LEAST_PIXELS = 10
# Values of a tile with its surroundings.
_TILE_VALUES = 1_200_000


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


def local_mean(y: Array, counted: Mask, window: LocalWindow) -> tuple[Array, npt.NDArray[np.int64]]:
    """Mean (F, lines, samples) of ``y`` over the counted pixels of each pixel's window, and their number.

    Windows are cut at the edges of the arrays.  Where fewer than :data:`LEAST_PIXELS` are counted the mean is 0.
    """
    weight = counted.astype(np.float64)
    stack = np.concatenate([y * weight, weight[None]])
    total = _box(stack, window.outer)
    total -= _box(stack, window.inner)
    number = np.rint(total[-1]).astype(np.int64)
    enough = number >= LEAST_PIXELS
    mean = total[:-1]
    mean /= np.where(enough, number, 1)
    mean *= enough
    return mean, number


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
    reach = window.outer // 2
    side = max(8, int(np.sqrt(_TILE_VALUES / (slope.size + 1))) - 2 * reach)
    stretches, workspace = runs(used), Workspace()
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}

    def tile(
        stored: npt.NDArray[Any], usable: Mask, may: Mask, inner: tuple[slice, slice]
    ) -> tuple[Array, Mask, int]:
        pixels = workspace.columns("pixels", stored, slope.size, np.float64)
        for source, goal in stretches:
            np.copyto(pixels[goal], stored[source])
        with np.errstate(invalid="ignore", over="ignore"):
            y = rows @ as_columns(pixels)
            y += constant[:, None]
        known = usable.ravel() & np.isfinite(y).all(axis=0)
        y[:, ~known] = 0.0
        y = y.reshape(-1, *usable.shape)
        known = known.reshape(usable.shape)
        mean, number = local_mean(y, known & may, window)
        m, x = (a[:, *inner].reshape(slope.size, -1) for a in (mean, y))
        found = _scores([name for name, _ in detectors.values()], x, m, targets, origin)
        lonely = int(np.count_nonzero((number < LEAST_PIXELS)[inner] & known[inner]))
        return found, known[inner], lonely

    def segment(firsts: range) -> int:
        lonely = 0
        for first in firsts:
            end = min(first + side, cube.lines)
            top, bottom = max(first - reach, 0), min(end + reach, cube.lines)
            stored, usable = cube.read_stored(top, bottom - top, must)
            for start in range(0, cube.samples, side):
                stop = min(start + side, cube.samples)
                left, right = max(start - reach, 0), min(stop + reach, cube.samples)
                part = np.ascontiguousarray(stored[:, :, left:right])
                inner = slice(first - top, end - top), slice(start - left, stop - left)
                found, known, missing = tile(part, usable[:, left:right], counted[top:bottom, left:right], inner)
                lonely += missing
                for name, score in zip(detectors, found, strict=True):
                    shaped = score.reshape(known.shape)
                    maps[name][first:end, start:stop] = np.where(known & np.isfinite(shaped), shaped, np.nan)
        return lonely

    lonely = sum(count for _, count in watch(by_segments(cube, side, segment, threads=threads)))
    return LocalScores(maps, lonely)


def _box(stack: Array, side: int) -> Array:
    """Sums over a square around each pixel, cut at the edges, by differences of cumulative sums."""
    out = stack
    for axis in (1, 2):
        size, half = out.shape[axis], side // 2
        summed = np.zeros((*out.shape[:axis], size + 1, *out.shape[axis + 1 :]))
        np.cumsum(out, axis=axis, out=summed[(slice(None),) * axis + (slice(1, None),)])
        at = np.arange(size)
        out = summed.take(np.minimum(at + half + 1, size), axis=axis)
        out -= summed.take(np.maximum(at - half, 0), axis=axis)
    return out


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
