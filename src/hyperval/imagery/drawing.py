"""Polygons and points to masks.

Continuous pixel coordinates are (sample, line) with the upper left corner of the first pixel at
(0, 0), so its centre is at (0.5, 0.5).  A polygon holds a pixel when it holds its centre.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError, NotGeoreferencedWarning
from rasterio.features import rasterize
from rasterio.warp import transform as reproject
from shapely.geometry import shape as shape_of
from shapely.geometry.base import BaseGeometry

from hyperval.errors import HypervalError, refusal, refuse
from hyperval.imagery.placing import LookupTable

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Placing = Callable[[BaseGeometry, str], BaseGeometry]
MAX_VERTICES = 1_000_000
_EDGE = 1e-6  # [pixel] rounding allowed to a vertex on the border of the image
FARTHEST = 1e9  # [pixel] from the image: no drawing, but numbers in another unit
WARNING = "warning: "
_CHECK = "check whether the coordinates are pixel, map or longitude/latitude, and belong to this cube"
_POINTS, _AREAS = ("Point", "MultiPoint"), ("Polygon", "MultiPolygon")
_SMALL = 0.01  # a part outside that is said without a warning


def geometry_of(stated: Any, where: str) -> BaseGeometry:
    """A polygon or points, of an object of GeoJSON or of WKB; heights are left aside.

    Raises
    ------
    InputError : another kind of geometry, one that is empty, or coordinates that are none.
    """
    refuse(not isinstance(stated, dict | bytes), "region.no_geometry", where)
    known, kind = (*_POINTS, *_AREAS), stated.get("type") if isinstance(stated, dict) else "of WKB"
    try:
        if kind in (*known, "of WKB"):
            made = shape_of(stated) if isinstance(stated, dict) else shapely.from_wkb(stated, on_invalid="fix")
            kind = made.geom_type
    except Exception as error:  # whatever damage makes of it
        what = f"geometry {kind!r} cannot be interpreted ({str(error)[:60]})"
        raise refusal("region.geometry", where, what=what) from error
    refuse(kind not in known, "region.geometry", where, what=f"geometry {kind!r} has no area")
    xy = shapely.get_coordinates(made)
    refuse(not np.all(np.isfinite(xy)), "region.not_finite", where)
    refuse(len(xy) > MAX_VERTICES, "region.vertices", where, count=f"more than {MAX_VERTICES}")
    lacks = "place" if not len(xy) else "area" if kind in _AREAS and made.convex_hull.area == 0.0 else ""
    refuse(lacks, "region.geometry", where, what=f"geometry {kind!r} has no {lacks}")
    return shapely.force_2d(made)


def polygon_mask(
    exterior: npt.ArrayLike,
    shape: tuple[int, int],
    holes: Sequence[npt.ArrayLike] = (),
    *,
    where: str,
    touched: bool = False,
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
    rings = [np.asarray(ring, float).tolist() for ring in (exterior, *holes)]
    polygon = geometry_of({"type": "Polygon", "coordinates": rings}, where)
    if not inside_image(vertices := shapely.get_coordinates(polygon), shape):
        raise outside_error(vertices, shape, where)
    return _burned([polygon], shape, touched=touched)


def _burned(polygons: Sequence[BaseGeometry], shape: tuple[int, int], *, touched: bool = False) -> Mask:
    """(lines, samples) mask of polygons."""
    if not polygons:
        return np.zeros(shape, bool)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        mask = rasterize(polygons, out_shape=shape, fill=0, dtype="uint8", all_touched=touched)
    return np.asarray(mask.astype(bool))


def point_mask(points: npt.ArrayLike, shape: tuple[int, int], *, where: str) -> Mask:
    """(lines, samples) mask of the pixels that hold points (sample, line) in continuous coordinates."""
    xy = np.asarray(points, float).reshape(-1, 2)
    if not inside_image(xy, shape):
        raise outside_error(xy, shape, where)
    col, row = np.clip(np.floor(xy).astype(int), 0, np.array(shape[::-1]) - 1).T
    mask = np.zeros(shape, bool)
    mask[row, col] = True
    return mask


Position = Affine | LookupTable | None


def map_to_pixel(points: npt.ArrayLike, transform: Position, *, where: str) -> Array:
    """(n, 2) continuous pixel coordinates (sample, line) of map coordinates (x, y)."""
    if transform is None:
        raise refusal("region.no_position", where)
    xy = np.asarray(points, dtype=float).reshape(-1, 2)
    if not isinstance(transform, Affine):
        return transform.to_pixel(xy, where=where)
    return np.column_stack(~transform @ xy.T)


def _reprojected(xy: Array, source: CRS, target: CRS | None, where: str) -> Array:
    """(n, 2) map coordinates in ``target`` of points in ``source`` (longitude first)."""
    if target is None:
        raise refusal("region.no_system", where)
    if source == target:
        return xy
    try:
        placed, why = np.column_stack(reproject(source, target, xy[:, 0].tolist(), xy[:, 1].tolist())[:2]), ""
    except Exception as error:  # such as a latitude beyond the pole; its class has no public name
        placed, why = np.full((1, 2), np.nan), f" ({error})"
    if not np.all(np.isfinite(placed)):
        raise refusal("region.no_place", where, low=xy.min(axis=0), high=xy.max(axis=0), source=source, why=why)
    return placed


@dataclass(frozen=True)
class ImageGrid:
    """The image that the drawings of a file lie on, and what is said of their coordinates and names.

    Attributes
    ----------
    shape : (lines, samples) of the image
    transform, crs : its position
    coordinates : "pixel", "map" (the image's own system) or "lonlat"; None: those of the system that the file
        states, longitude and latitude without one
    name_field : attribute that names the drawings, None for the usual ones
    """

    shape: tuple[int, int]
    transform: Position = None
    crs: CRS | None = None
    coordinates: str | None = None
    name_field: str | None = None

    def placing(self, stated: CRS | None, where: str) -> Placing:
        """A function from a geometry of a file in a stated system to continuous pixel coordinates.

        Raises
        ------
        InputError : the file states another system than ``coordinates``.
        """
        means, crs = self.coordinates, self.crs
        if means == "map" and stated is not None and crs is not None and stated != crs:
            raise refusal("region.other_system", where, stated=stated, told=f"the cube in {crs}")
        if means == "lonlat" and stated is not None and not stated.is_geographic:
            raise refusal("region.other_system", where, stated=stated, told="not in longitude and latitude")

        def place(geometry: BaseGeometry, where: str) -> BaseGeometry:
            if means == "pixel":
                return geometry
            if means != "map":
                system = stated or CRS.from_epsg(4326)
                geometry = shapely.transform(geometry, lambda xy: _reprojected(xy, system, crs, where))
            if self.transform is not None and not isinstance(self.transform, Affine):
                geometry = self.transform.divided(geometry, where)
            return shapely.transform(geometry, lambda xy: map_to_pixel(xy, self.transform, where=where))

        return place


def named_crs(name: str, where: str) -> CRS:
    """The coordinate system of a name; InputError for one that is not known."""
    try:
        return CRS.from_user_input(name)
    except (CRSError, ValueError):
        raise refusal("region.system", where, name=name) from None


def inside_image(xy: Array, shape: tuple[int, int]) -> bool:
    """Whether all of (n, 2) points (sample, line) lie in the image, to a millionth of a pixel."""
    return bool(np.all((xy >= -_EDGE) & (xy <= np.array(shape[::-1]) + _EDGE)))


def outside_error(
    xy: Array, shape: tuple[int, int], where: str, what: str = "the region", mend: str = _CHECK
) -> HypervalError:
    """The error for points (n, 2) that the image does not hold."""
    return refusal("region.outside", where, what=what, low=xy.min(axis=0), high=xy.max(axis=0), shape=shape, mend=mend)


@dataclass(eq=False)
class RegionDrawing:
    """The polygons, points and pixels of one region on the grid of an image.

    Attributes
    ----------
    shape : (lines, samples) of the image
    marked : mask of pixels that are named by their numbers, None without
    polygons, points : in pixel coordinates
    stated_pixels : number of pixels as the file states it, None when it does not
    """

    shape: tuple[int, int]
    marked: Mask | None = None
    polygons: list[BaseGeometry] = field(default_factory=list)
    points: list[BaseGeometry] = field(default_factory=list)
    stated_pixels: int | None = None

    def add(self, geometry: BaseGeometry, where: str) -> None:
        """Add a polygon or points in pixel coordinates; of what leaves the image only the numbers are looked at.

        Raises
        ------
        InputError : coordinates that are none.
        """
        xy = shapely.get_coordinates(geometry)
        if not np.abs(xy).max() <= FARTHEST:
            raise outside_error(xy, self.shape, where)
        (self.points if geometry.geom_type in _POINTS else self.polygons).append(geometry)

    def add_pixels(self, rows: npt.ArrayLike, cols: npt.ArrayLike, where: str) -> None:
        """Add pixels named by 0-based whole numbers, which must be in the image."""
        r, c = np.asarray(rows, dtype=np.int64), np.asarray(cols, dtype=np.int64)
        out = np.flatnonzero((r < 0) | (r >= self.shape[0]) | (c < 0) | (c >= self.shape[1]))
        if out.size:
            counts = {"outside": out.size, "count": r.size, "line": r[out[0]], "sample": c[out[0]]}
            raise refusal("region.pixels", where, last=(self.shape[0] - 1, self.shape[1] - 1), **counts)
        self.marked = np.zeros(self.shape, bool) if self.marked is None else self.marked
        self.marked[r, c] = True

    def drawn(self, where: str, *, touched: bool = False) -> tuple[Mask, tuple[str, ...]]:
        """(lines, samples) mask of the pixels whose centres the region holds, and what is to be said of it.

        ``touched`` : of all pixels that its polygons touch.  What leaves the image is cut off and counted.

        Raises
        ------
        InputError : nothing of it lies in the image.
        """
        points = shapely.get_coordinates(self.points)
        inside = np.array([inside_image(p, self.shape) for p in points], dtype=bool)
        mask = _burned(self.polygons, self.shape) | point_mask(points[inside], self.shape, where=where)
        if self.marked is not None:
            mask |= self.marked
        left = [p for p in self.polygons if not inside_image(shapely.get_coordinates(p), self.shape)]
        if (left or not inside.all()) and not mask.any():
            raise outside_error(np.vstack([shapely.get_coordinates(left), points]), self.shape, where)
        notes, pixels = [], int(mask.sum())
        part = _share_outside(self.polygons, self.shape) if left else 0.0  # to the millionth of a pixel of the border
        if part > 0.0:
            percent = f"{100.0 * part:.1f} %" if part >= 0.001 else "less than 0.1 %"
            sign = "" if part < _SMALL else WARNING
            notes.append(f"{sign}leaves the image: {percent} of its area is outside, {pixels} pixels are left")
        if not inside.all():
            gone = f"{np.sum(~inside)} of {inside.size} points are outside"
            notes.append(f"{WARNING}leaves the image: {gone}, {pixels} pixels are left")
        if self.stated_pixels not in (None, pixels):
            notes.append(f"has {self.stated_pixels} pixels as its file says; {pixels} have their centre inside")
        return mask | _burned(self.polygons, self.shape, touched=True) if touched else mask, tuple(notes)


def _share_outside(polygons: Sequence[BaseGeometry], shape: tuple[int, int]) -> float:
    """Part of the area of polygons that an image (lines, samples) does not hold.

    Each is its exterior less its holes; where sides cross, the parts that are enclosed an odd number of times.
    """
    drawn = shapely.make_valid(polygons)
    inside = shapely.intersection(drawn, shapely.box(0, 0, shape[1], shape[0]))
    area = float(np.sum(shapely.area(drawn)))
    return 1.0 - float(np.sum(shapely.area(inside))) / area if area > 0.0 else 0.0
