"""Polygons and points to masks.

Continuous pixel coordinates are (sample, line) with the upper left corner of the first pixel at
(0, 0), so its centre is at (0.5, 0.5).  A polygon holds a pixel when it holds its centre.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import NotGeoreferencedWarning
from rasterio.features import rasterize
from rasterio.warp import transform as reproject

from hyperval.errors import InputError, UsageError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Ring = npt.ArrayLike
MAX_VERTICES = 1_000_000
_EDGE = 1e-6  # [pixel] rounding allowed to a vertex on the border of the image


def polygon_mask(
    exterior: Ring, shape: tuple[int, int], holes: Sequence[Ring] = (), *, where: str, touched: bool = False
) -> Mask:
    """(lines, samples) mask of the pixels whose centre lies in a polygon.

    Parameters
    ----------
    exterior : (n, 2) vertices (sample, line) in continuous pixel coordinates, n >= 3
    shape : (lines, samples) of the image
    holes : rings that are left out
    where : what stands in messages
    touched : take every pixel that the polygon touches, for targets smaller than a pixel

    Raises
    ------
    InputError : fewer than three vertices, not finite, or a vertex outside the image.
    """
    rings = [ring_of(r, where) for r in (exterior, *holes)]
    for ring in rings:
        if not inside_image(ring, shape):
            raise outside_error(ring, shape, where)
    return burned(rings, shape, touched=touched)


def burned(rings: Sequence[Array], shape: tuple[int, int], *, touched: bool = False) -> Mask:
    """(lines, samples) mask of a polygon: its exterior, then its holes, each (n, 2); nothing is checked."""
    geometry = {"type": "Polygon", "coordinates": [np.vstack([r, r[:1]]).tolist() for r in rings]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        mask = rasterize([(geometry, 1)], out_shape=shape, fill=0, dtype="uint8", all_touched=touched)
    return np.asarray(mask.astype(bool))


def point_mask(points: npt.ArrayLike, shape: tuple[int, int], *, where: str) -> Mask:
    """(lines, samples) mask of the pixels that hold points (sample, line) in continuous coordinates."""
    xy = np.asarray(points, dtype=float).reshape(-1, 2)
    if not np.all(np.isfinite(xy)):
        raise InputError("coordinates that are not finite", where=where)
    if not inside_image(xy, shape):
        raise outside_error(xy, shape, where)
    mask = np.zeros(shape, bool)
    col = np.clip(np.floor(xy[:, 0]).astype(int), 0, shape[1] - 1)
    row = np.clip(np.floor(xy[:, 1]).astype(int), 0, shape[0] - 1)
    mask[row, col] = True
    return mask


def pixel_mask(rows: npt.ArrayLike, cols: npt.ArrayLike, shape: tuple[int, int], *, where: str) -> Mask:
    """(lines, samples) mask of pixels named by 0-based whole numbers."""
    r, c = np.asarray(rows, dtype=np.int64), np.asarray(cols, dtype=np.int64)
    out = (r < 0) | (r >= shape[0]) | (c < 0) | (c >= shape[1])
    if out.any():
        i = int(np.flatnonzero(out)[0])
        raise InputError(
            f"{int(out.sum())} of {r.size} pixels are outside the image, first (line {r[i]}, sample {c[i]})",
            where=where,
            expected=f"lines 0-{shape[0] - 1}, samples 0-{shape[1] - 1}",
        )
    mask = np.zeros(shape, bool)
    mask[r, c] = True
    return mask


class MapGrid(Protocol):
    """A position that is not an affine transform, such as a geographic lookup table."""

    def to_pixel(self, points: Array, *, where: str, ring: bool = False) -> Array:
        """(n, 2) continuous pixel coordinates (sample, line) of map coordinates (x, y)."""
        ...


Position = Affine | MapGrid | None


def map_to_pixel(points: npt.ArrayLike, transform: Position, *, where: str, ring: bool = False) -> Array:
    """(n, 2) continuous pixel coordinates (sample, line) of map coordinates (x, y).

    ``ring``: the points are the vertices of a polygon, whose straight sides may be bent in the image: more
    vertices may come back.
    """
    if transform is None:
        raise InputError("the cube has no position, so map coordinates cannot be placed", where=where)
    xy = np.asarray(points, dtype=float).reshape(-1, 2)
    if not isinstance(transform, Affine):
        return transform.to_pixel(xy, where=where, ring=ring)
    return np.column_stack(~transform @ xy.T)


def reprojected(points: npt.ArrayLike, source: CRS, target: CRS | None, *, where: str) -> Array:
    """(n, 2) map coordinates in ``target`` of points in ``source`` (longitude first)."""
    xy = np.asarray(points, dtype=float).reshape(-1, 2)
    if target is None:
        raise InputError(
            "the coordinate system of the cube is unknown",
            where=where,
            mend="give it in the header (coordinate system string), or the coordinates in pixels",
        )
    if source == target:
        return xy
    try:
        placed = reproject(source, target, xy[:, 0].tolist(), xy[:, 1].tolist())[:2]
    except Exception as error:  # such as a latitude beyond the pole; its class has no public name
        placed, why = None, f" ({error})"
    else:
        why = ""
    if placed is None or not np.all(np.isfinite(placed)):
        raise InputError(
            f"coordinates from {_pair(xy.min(axis=0))} to {_pair(xy.max(axis=0))} cannot be places in "
            f"{source}{why}",
            where=where,
            mend="check which coordinate system they are in",
        )
    return np.column_stack(placed)


def placing(
    coordinates: str | None, stated: CRS | None, transform: Position, crs: CRS | None, where: str
) -> Callable[[Array, str, bool], Array]:
    """A function from the coordinates (n, 2) of a file to continuous pixel coordinates.

    Parameters
    ----------
    coordinates : "pixel", "map" (the cube's own system) or "lonlat"; None: those of the system that the file
        states, longitude and latitude without one
    stated : the system that the file states
    transform, crs : position of the cube

    Raises
    ------
    InputError : the file states another system than ``coordinates``.
    """
    if coordinates == "map" and stated is not None and crs is not None and stated != crs:
        raise InputError(f"the file is in {stated}, the cube in {crs}", where=where, mend="leave coordinates out")
    if coordinates == "lonlat" and stated is not None and not stated.is_geographic:
        raise InputError(
            f"the file is in {stated}, not in longitude and latitude", where=where, mend="leave coordinates out"
        )

    def place(points: Array, where: str, ring: bool) -> Array:
        if coordinates == "pixel":
            return points
        if coordinates != "map":
            points = reprojected(points, stated or CRS.from_epsg(4326), crs, where=where)
        return map_to_pixel(points, transform, where=where, ring=ring)

    return place


def _pair(xy: Array) -> str:
    return f"({xy[0]:.6g}, {xy[1]:.6g})"


def ring_of(ring: Ring, where: str) -> Array:
    """(n, 2) vertices of a ring, the closing one left out.

    Raises
    ------
    InputError : fewer than three different vertices, too many, or coordinates that are not finite.
    """
    xy = np.asarray(ring, dtype=float)
    if xy.ndim != 2 or xy.shape[1] != 2:
        raise UsageError("a polygon is a list of (sample, line) pairs", where=where)
    if len(xy) > MAX_VERTICES:
        raise InputError(f"a polygon of more than {MAX_VERTICES} vertices", where=where)
    if len(xy) > 1 and np.array_equal(xy[0], xy[-1]):
        xy = xy[:-1]
    if len(np.unique(xy, axis=0)) < 3:
        raise InputError(f"a polygon of {len(np.unique(xy, axis=0))} different vertices", where=where)
    if not np.all(np.isfinite(xy)):
        raise InputError("coordinates that are not finite", where=where)
    return xy


def inside_image(xy: Array, shape: tuple[int, int]) -> bool:
    """Whether all of (n, 2) points (sample, line) lie in the image, to a millionth of a pixel."""
    lines, samples = shape
    if not xy.size:
        return True
    low, high = xy.min(axis=0), xy.max(axis=0)
    return bool(low.min() >= -_EDGE and high[0] <= samples + _EDGE and high[1] <= lines + _EDGE)


def outside_error(xy: Array, shape: tuple[int, int], where: str) -> InputError:
    """The error for points (n, 2) that the image does not hold."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    return InputError(
        f"the region leaves the image: samples {low[0]:.2f} to {high[0]:.2f}, lines {low[1]:.2f} to {high[1]:.2f}",
        where=where,
        expected=f"samples 0 to {shape[1]}, lines 0 to {shape[0]} (continuous pixel coordinates)",
        mend="check whether the coordinates are pixel, map or longitude/latitude, and belong to this cube",
    )
