"""Scores of whole objects, with a halo, and the background scored by the same footprint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]
# First line and sample of a window of the image, and the mask of an object within it.
Placed = tuple[tuple[int, int], Mask]


def with_halo(mask: npt.NDArray[Any], halo: int) -> Mask:
    """The mask grown by ``halo`` pixels in line and sample (a square neighbourhood)."""
    grown = np.asarray(mask, dtype=bool)
    if halo < 0:
        raise UsageError(f"halo of {halo} pixels", expected="0 or more")
    return np.asarray(ndimage.maximum_filter(grown, 2 * halo + 1, mode="constant"))


def placed_with_halo(placed: Placed, halo: int, shape: tuple[int, ...]) -> Placed:
    """The object grown by ``halo`` pixels, in a window that is cut at the edges of an image of ``shape``."""
    (line, sample), part = placed
    grown = with_halo(np.pad(np.asarray(part, dtype=bool), max(halo, 0)), halo)
    line, sample = line - halo, sample - halo
    rows = slice(max(-line, 0), min(grown.shape[0], shape[0] - line))
    columns = slice(max(-sample, 0), min(grown.shape[1], shape[1] - sample))
    return (max(line, 0), max(sample, 0)), grown[rows, columns]


def values_on(image: npt.NDArray[Any], placed: Placed) -> npt.NDArray[Any]:
    """(n, ...) values of an image (lines, samples, ...) on the pixels of an object."""
    (line, sample), part = placed
    return np.asarray(image[line : line + part.shape[0], sample : sample + part.shape[1]][part])


def object_scores(score_map: npt.NDArray[Any], objects: Mapping[str, Placed], halo: int = 0) -> dict[str, float]:
    """Greatest score over each object's pixels and ``halo`` pixels around them.

    Parameters
    ----------
    score_map : (lines, samples), NaN where invalid
    objects : the pixels of each object: a window with its mask

    Returns
    -------
    score by object; NaN for an object without a valid pixel.  With a halo the background must be scored by
    :func:`footprint_maxima`, else noise alone looks like detection.
    """
    scores = np.asarray(score_map, dtype=float)
    greatest: dict[str, float] = {}
    for name, placed in objects.items():
        if not np.any(placed[1]):
            raise UsageError(f"the object {name!r} holds no pixel")
        pixels = values_on(scores, placed_with_halo(placed, halo, scores.shape))
        pixels = pixels[~np.isnan(pixels)]
        greatest[name] = float(pixels.max()) if pixels.size else float("nan")
    return greatest


def footprint(mask: npt.NDArray[Any], halo: int = 0) -> Mask:
    """The object's own shape with its halo, cut to its bounding box (halo not cut by the image's edge)."""
    padded = np.pad(np.asarray(mask, dtype=bool), halo)
    grown = with_halo(padded, halo)
    if not grown.any():
        raise UsageError("the object holds no pixel")
    rows, columns = np.flatnonzero(grown.any(axis=1)), np.flatnonzero(grown.any(axis=0))
    return grown[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def footprint_maxima(
    score_map: npt.NDArray[Any], shape: Mask, exclude: npt.NDArray[Any] | None = None
) -> tuple[Array, Indices, Indices]:
    """Greatest score of each placement of an object's footprint on the background.

    The image is tiled by the footprint's bounding box, without overlap, so that the maxima are separate
    draws; tiles that touch an invalid or an excluded pixel under the footprint are left out.

    Parameters
    ----------
    score_map : (lines, samples), NaN where invalid
    shape : (h, w) from :func:`footprint`
    exclude : (lines, samples) True on targets and their guard ring

    Returns
    -------
    maxima, lines, samples : (n,) the ``background_scores`` that belong with haloed object scores, of which one
        stands for a false alarm per footprint, not per pixel; and the first line and sample of each placement
    """
    values, lines, samples = _tiles(score_map, shape, exclude)
    return values.max(axis=1) if values.size else np.empty(0), lines, samples


def footprint_sums(score_map: npt.NDArray[Any], shape: Mask, exclude: npt.NDArray[Any] | None = None) -> Array:
    """Sum of scores over each placement of an object's footprint on the background.

    Their spread is the standard uncertainty of the same sum over the object, with the correlation between
    neighbouring pixels in it.  Parameters and placements as :func:`footprint_maxima`.
    """
    return np.asarray(_tiles(score_map, shape, exclude)[0].sum(axis=1))


def _tiles(
    score_map: npt.NDArray[Any], shape: Mask, exclude: npt.NDArray[Any] | None
) -> tuple[Array, Indices, Indices]:
    """(n, pixels of the footprint) scores of each placement without invalid or excluded pixels; line and sample."""
    scores = np.array(score_map, dtype=float)
    if exclude is not None:
        scores[np.asarray(exclude, dtype=bool)] = np.nan
    h, w = shape.shape
    rows, columns = scores.shape[0] // h, scores.shape[1] // w
    if rows * columns == 0:
        raise UsageError(f"a footprint of {h} x {w} pixels does not fit a score map of {scores.shape}")
    tiles = scores[: rows * h, : columns * w].reshape(rows, h, columns, w).transpose(0, 2, 1, 3)
    values = tiles.reshape(rows * columns, h * w)[:, shape.ravel()]
    free = np.flatnonzero(~np.isnan(values).any(axis=1))
    return np.asarray(values[free]), free // columns * h, free % columns * w
