"""Score maps of a stored cube: all detectors and targets in one pass, with gain and empirical line folded in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.elm import EmpiricalLine
from hyperval.processing.passes import (
    StoredCube,
    Workspace,
    as_columns,
    by_segments,
    lines_per_block,
    runs,
)

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Quadratic = Literal["distance", "length"]


@dataclass(frozen=True, eq=False)
class PixelDetector:
    """A score made of affine functions of a spectrum and at most one quadratic one.

    Attributes
    ----------
    weights, constants : (K, B) and (K,): y = weights x + constants
    combine : score (N,) from y (K, N) and the quadratic (N,), which is None where none is asked for; None for
        a linear detector, whose score is y[0]
    quadratic : "distance", the squared Mahalanobis distance from the background mean; "length", |x|^2
    condition : condition number of the matrix that was inverted for it, NaN where none was
    """

    weights: Array
    constants: Array
    combine: Callable[[Array, Array | None], Array] | None = None
    quadratic: Quadratic | None = None
    condition: float = float("nan")

    def score(self, x: npt.ArrayLike, whitener: Whitener | None = None) -> Array:
        """(...) scores of spectra (..., B); ``whitener`` where the quadratic is the distance."""
        spectra = np.asarray(x, dtype=float)
        flat = spectra.reshape(-1, spectra.shape[-1]).T
        y = self.weights @ flat + self.constants[:, None]
        if self.combine is None:
            return np.asarray(y[0].reshape(spectra.shape[:-1]))
        value = None
        if self.quadratic == "length":
            value = np.einsum("ij,ij->j", flat, flat)
        elif self.quadratic == "distance":
            if whitener is None:
                raise UsageError("a detector that measures distance needs the whitener of the background")
            z = whitener.matrix @ (flat - whitener.mean[:, None])
            value = np.einsum("ij,ij->j", z, z)
        return np.asarray(self.combine(y, value).reshape(spectra.shape[:-1]))


@dataclass(frozen=True, eq=False)
class Whitener:
    """W (B, B) with W Sigma W^T = 1, and the mean (B,) of the background."""

    matrix: Array
    mean: Array


def score_cube(
    cube: StoredCube,
    detectors: Mapping[str, PixelDetector],
    elm: EmpiricalLine | None = None,
    bands: Mask | None = None,
    *,
    whitener: Whitener | None = None,
    needed: Mask | None = None,
    threads: int | None = None,
    block_lines: int | None = None,
    watch: Callable[[Iterator[Any]], Iterator[Any]] = iter,
) -> dict[str, Array]:
    """Score map (lines, samples) of every detector; no reflectance is written or kept.

    The score is NaN where the pixel holds no data in a needed band, or is itself not finite.

    Parameters
    ----------
    detectors : by name, for spectra of the selected bands
    elm : line over all bands of the cube; None when the detectors work on the cube's own values
    bands : (B,) bands that the detectors use, all by default
    whitener : of the selected bands, needed where a detector measures distance
    needed : (B,) bands that must hold data besides those used, all that are used by default
    threads, block_lines : None chooses them
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : no detector, or one that does not fit the bands.
    """
    used = np.ones(cube.bands, bool) if bands is None else np.asarray(bands, dtype=bool)
    must = used if needed is None else used | needed
    slope, level = stored_to_spectra(cube, elm, used)
    rows, constants, at = _stack(detectors, whitener, slope, level)
    with_length = any(d.quadratic == "length" for d in detectors.values())
    step = block_lines or lines_per_block(cube)
    stretches, workspace = runs(used), Workspace()
    maps = {name: np.full((cube.lines, cube.samples), np.nan) for name in detectors}

    def segment(firsts: range) -> None:
        for first in firsts:
            count = min(step, cube.lines - first)
            buffer = workspace.flat("stored", cube.bands * count * cube.samples, cube.dtype)
            stored, usable = cube.read_stored(first, count, must, buffer)
            pixels = workspace.columns("pixels", stored, slope.size, np.float64)
            for source, target in stretches:
                np.copyto(pixels[target], stored[source])
            columns = as_columns(pixels)
            with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
                y = rows @ columns
                y += constants[:, None]
                distance = np.einsum("ij,ij->j", y[at[-1] :], y[at[-1] :]) if at[-1] < len(y) else None
                length = None
                if with_length:
                    spectra = columns * slope[:, None] + level[:, None]
                    length = np.einsum("ij,ij->j", spectra, spectra)
                for (name, detector), a, b in zip(detectors.items(), at, at[1:], strict=False):
                    value = {None: None, "distance": distance, "length": length}[detector.quadratic]
                    score = y[a] if detector.combine is None else detector.combine(y[a:b], value)
                    score = np.where(usable.ravel() & np.isfinite(score), score, np.nan)
                    maps[name][first : first + count] = score.reshape(count, cube.samples)

    for _ in watch(by_segments(cube, step, segment, threads=threads)):
        pass
    return maps


def stored_to_spectra(cube: StoredCube, elm: EmpiricalLine | None, used: Mask) -> tuple[Array, Array]:
    """(F,) slope and level that make the detectors' spectra out of stored numbers s: slope s + level."""
    gain, offset = cube.gain[used], cube.offset[used]
    if elm is None:
        return gain, offset
    k, b = elm.gain, elm.offset
    if k.shape != used.shape:
        raise UsageError(f"an empirical line of {k.size} bands for a cube of {used.size}")
    if not np.all(np.isfinite(k[used])):
        raise UsageError(
            f"the empirical line has no gain in {int(np.sum(~np.isfinite(k[used])))} of the detectors' bands",
            mend="leave out the bands where EmpiricalLine.usable is False",
        )
    return gain / k[used], (offset - b[used]) / k[used]


def _stack(
    detectors: Mapping[str, PixelDetector], whitener: Whitener | None, slope: Array, level: Array
) -> tuple[Array, Array, list[int]]:
    """All rows for stored numbers, their constants, and where each detector's rows begin (the whitener's last)."""
    if not detectors:
        raise UsageError("no detector to score with")
    weights = [np.atleast_2d(d.weights) for d in detectors.values()]
    constants = [np.atleast_1d(d.constants) for d in detectors.values()]
    for name, w in zip(detectors, weights, strict=True):
        if w.shape[1] != slope.size:
            raise UsageError(f"detector {name!r} is made for {w.shape[1]} bands, {slope.size} are selected")
    at = np.concatenate([[0], np.cumsum([len(w) for w in weights])]).tolist()
    if any(d.quadratic == "distance" for d in detectors.values()):
        if whitener is None:
            raise UsageError("a detector that measures distance needs the whitener of the background")
        weights.append(whitener.matrix)
        constants.append(-whitener.matrix @ whitener.mean)
    w, c = np.concatenate(weights), np.concatenate(constants)
    # weights (slope s + level) + constant
    return w * slope, c + w @ level, at
