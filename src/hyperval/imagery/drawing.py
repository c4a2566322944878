"""Polygons and points to masks.

Continuous pixel coordinates are (sample, line) with the upper left corner of the first pixel at
(0, 0), so its centre is at (0.5, 0.5).  A polygon holds a pixel when it holds its centre.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError, NotGeoreferencedWarning
from rasterio.features import rasterize
from rasterio.warp import transform as reproject

from hyperval.errors import InputError, UsageError

if TYPE_CHECKING:
    import shapely

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Placing = Callable[[Array, str, bool], Array]
MAX_VERTICES = 1_000_000
_EDGE = 1e-6  # [pixel] rounding allowed to a vertex on the border of the image
FARTHEST = 1e9  # [pixel] from the image: no drawing, but numbers in another unit
WARNING = "warning: "
_CHECK = "check whether the coordinates are pixel, map or longitude/latitude, and belong to this cube"
_SMALL = 0.01  # a part outside that is said without a warning


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
    rings = [_ring(r, where) for r in (exterior, *holes)]
    for ring in rings:
        if not inside_image(ring, shape):
            raise outside_error(ring, shape, where)
    return _burned(rings, shape, touched=touched)


def _burned(rings: Sequence[Array], shape: tuple[int, int], *, touched: bool = False) -> Mask:
    """(lines, samples) mask of a polygon: its exterior, then its holes, each (n, 2)."""
    geometry = {"type": "Polygon", "coordinates": [np.vstack([r, r[:1]]).tolist() for r in rings]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        mask = rasterize([(geometry, 1)], out_shape=shape, fill=0, dtype="uint8", all_touched=touched)
    return np.asarray(mask.astype(bool))


def point_mask(points: npt.ArrayLike, shape: tuple[int, int], *, where: str) -> Mask:
    """(lines, samples) mask of the pixels that hold points (sample, line) in continuous coordinates."""
    xy = _points(points, where)
    if not inside_image(xy, shape):
        raise outside_error(xy, shape, where)
    col, row = np.clip(np.floor(xy).astype(int), 0, np.array(shape[::-1]) - 1).T
    mask = np.zeros(shape, bool)
    mask[row, col] = True
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


def reprojected(xy: Array, source: CRS, target: CRS | None, *, where: str) -> Array:
    """(n, 2) map coordinates in ``target`` of points in ``source`` (longitude first)."""
    if target is None:
        raise InputError(
            "the coordinate system of the cube is unknown",
            where=where,
            mend="give it in the header (coordinate system string), or the coordinates in pixels",
        )
    if source == target:
        return xy
    try:
        placed, why = np.column_stack(reproject(source, target, xy[:, 0].tolist(), xy[:, 1].tolist())[:2]), ""
    except Exception as error:  # such as a latitude beyond the pole; its class has no public name
        placed, why = np.full((1, 2), np.nan), f" ({error})"
    if not np.all(np.isfinite(placed)):
        low, high = (f"({corner[0]:.6g}, {corner[1]:.6g})" for corner in (xy.min(axis=0), xy.max(axis=0)))
        raise InputError(
            f"coordinates from {low} to {high} cannot be places in {source}{why}",
            where=where,
            mend="check which coordinate system they are in",
        )
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
        """A function from the coordinates (n, 2) of a file in a stated system to continuous pixel coordinates.

        Raises
        ------
        InputError : the file states another system than ``coordinates``.
        """
        means, crs = self.coordinates, self.crs
        if means == "map" and stated is not None and crs is not None and stated != crs:
            raise InputError(f"the file is in {stated}, the cube in {crs}", where=where, mend="leave coordinates out")
        if means == "lonlat" and stated is not None and not stated.is_geographic:
            raise InputError(
                f"the file is in {stated}, not in longitude and latitude", where=where, mend="leave coordinates out"
            )

        def place(points: Array, where: str, ring: bool) -> Array:
            if means == "pixel":
                return points
            if means != "map":
                points = reprojected(points, stated or CRS.from_epsg(4326), crs, where=where)
            return map_to_pixel(points, self.transform, where=where, ring=ring)

        return place


def named_crs(name: str, where: str) -> CRS:
    """The coordinate system of a name; InputError for one that is not known."""
    try:
        return CRS.from_user_input(name)
    except (CRSError, ValueError):
        raise InputError(f"unknown coordinate system {name!r}", where=where) from None


def _points(points: npt.ArrayLike, where: str) -> Array:
    xy = np.asarray(points, dtype=float)
    if xy.size and (xy.ndim != 2 or xy.shape[1] != 2):
        raise UsageError("coordinates are a list of (sample, line) pairs", where=where)
    if not np.all(np.isfinite(xy)):
        raise InputError("coordinates that are not finite", where=where)
    return xy.reshape(-1, 2)


def _ring(ring: npt.ArrayLike, where: str) -> Array:
    """(n, 2) vertices of a ring, the closing one left out."""
    if np.shape(ring)[:1] > (MAX_VERTICES,):
        raise InputError(f"a polygon of more than {MAX_VERTICES} vertices", where=where)
    xy = _points(ring, where)
    if len(xy) > 1 and np.array_equal(xy[0], xy[-1]):
        xy = xy[:-1]
    if len(np.unique(xy, axis=0)) < 3:
        raise InputError(f"a polygon of {len(np.unique(xy, axis=0))} different vertices", where=where)
    return xy


def inside_image(xy: Array, shape: tuple[int, int]) -> bool:
    """Whether all of (n, 2) points (sample, line) lie in the image, to a millionth of a pixel."""
    return bool(np.all((xy >= -_EDGE) & (xy <= np.array(shape[::-1]) + _EDGE)))


def outside_error(
    xy: Array, shape: tuple[int, int], where: str, what: str = "the region", mend: str = _CHECK
) -> InputError:
    """The error for points (n, 2) that the image does not hold."""
    low, high = xy.min(axis=0), xy.max(axis=0)
    return InputError(
        f"{what} leaves the image: samples {low[0]:.2f} to {high[0]:.2f}, lines {low[1]:.2f} to {high[1]:.2f}",
        where=where,
        expected=f"samples 0 to {shape[1]}, lines 0 to {shape[0]} (continuous pixel coordinates)",
        mend=mend,
    )


@dataclass(eq=False)
class RegionDrawing:
    """The polygons, points and pixels of one region on the grid of an image.

    Attributes
    ----------
    shape : (lines, samples) of the image
    mask : (lines, samples) the pixels of the region
    area, area_inside : of its polygons, and of what the image holds of them [pixels]
    stated_pixels : number of pixels as the file states it, None when it does not
    points, points_outside : single points, and those that the image does not hold
    """

    shape: tuple[int, int]
    mask: Mask = field(init=False)
    area: float = 0.0
    area_inside: float = 0.0
    stated_pixels: int | None = None
    points: int = 0
    points_outside: int = 0
    _outside: list[Array] = field(default_factory=list)
    _polygons: list[list[Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.mask = np.zeros(self.shape, bool)

    def add(self, geometry: dict[str, Any], place: Placing, where: str) -> None:
        """Add a polygon or points as GeoJSON has them, their coordinates placed on the image.

        Raises
        ------
        InputError : another kind of geometry, or coordinates that are none.
        """
        kind, parts = geometry.get("type"), geometry.get("coordinates")
        if kind in ("Point", "MultiPoint"):
            self.add_points(place(_pairs([parts] if kind == "Point" else parts, where), where, False), where=where)
            return
        if kind not in ("Polygon", "MultiPolygon"):
            raise InputError(
                f"geometry {kind!r} has no area", where=where, expected="Polygon, MultiPolygon, Point, MultiPoint"
            )
        polygons = [parts] if kind == "Polygon" else parts
        for rings in polygons if isinstance(polygons, list | tuple) and polygons else [None]:
            if not isinstance(rings, list | tuple) or not rings:
                raise InputError("a polygon without vertices", where=where)
            outer, *inner = [place(_pairs(ring, where), where, True) for ring in rings]
            self.add_polygon(outer, inner, where=where)

    def add_polygon(self, exterior: npt.ArrayLike, holes: Sequence[npt.ArrayLike] = (), *, where: str) -> None:
        """Add the pixels whose centre lies in a polygon; what leaves the image is cut off and counted.

        Raises
        ------
        InputError : fewer than three different vertices, or coordinates that are none.
        """
        rings = [_ring(r, where) for r in (exterior, *holes)]
        for ring in rings:
            if np.abs(ring).max() > FARTHEST:
                raise outside_error(ring, self.shape, where)
        whole = polygon_of(rings)
        self.area += whole.area
        self.area_inside += area_inside(whole, self.shape)
        self.mask |= _burned(rings, self.shape)
        self._polygons.append(rings)
        if not all(inside_image(r, self.shape) for r in rings):
            self._outside.append(rings[0])

    def add_points(self, points: npt.ArrayLike, *, where: str) -> None:
        """Add the pixels that hold points (sample, line) in continuous coordinates."""
        xy = _points(points, where)
        inside = np.array([inside_image(p, self.shape) for p in xy], dtype=bool)
        self.points += len(xy)
        self.points_outside += int((~inside).sum())
        self.mask |= point_mask(xy[inside], self.shape, where=where)
        if not inside.all():
            self._outside.append(xy)

    def add_pixels(self, rows: npt.ArrayLike, cols: npt.ArrayLike, *, where: str) -> None:
        """Add pixels named by 0-based whole numbers, which must be in the image."""
        r, c = np.asarray(rows, dtype=np.int64), np.asarray(cols, dtype=np.int64)
        out = (r < 0) | (r >= self.shape[0]) | (c < 0) | (c >= self.shape[1])
        if out.any():
            i = int(np.flatnonzero(out)[0])
            raise InputError(
                f"{int(out.sum())} of {r.size} pixels are outside the image, first (line {r[i]}, sample {c[i]})",
                where=where,
                expected=f"lines 0-{self.shape[0] - 1}, samples 0-{self.shape[1] - 1}",
            )
        self.mask[r, c] = True

    @property
    def touched(self) -> Mask:
        """(lines, samples) the pixels of the region and all others that its polygons touch."""
        out = self.mask.copy()
        for rings in self._polygons:
            out |= _burned(rings, self.shape, touched=True)
        return out

    def notes(self) -> tuple[str, ...]:
        """What is to be said, after the region's name, of the part outside the image; empty without one."""
        drawn = int(self.mask.sum())
        out = []
        # To the millionth of a pixel of the border, see ``inside_image``.
        part = 1.0 - self.area_inside / self.area if self._outside and self.area > 0.0 else 0.0
        if part > 0.0:
            sign = "" if part < _SMALL else WARNING
            percent = f"{100.0 * part:.1f} %" if part >= 0.001 else "less than 0.1 %"
            out.append(f"{sign}leaves the image: {percent} of its area is outside, {drawn} pixels are left")
        if self.points_outside:
            out.append(
                f"{WARNING}leaves the image: {self.points_outside} of {self.points} points are outside, "
                f"{drawn} pixels are left"
            )
        if self.stated_pixels not in (None, drawn):
            out.append(f"has {self.stated_pixels} pixels as its file says; {drawn} have their centre inside")
        return tuple(out)

    def check(self, where: str) -> None:
        """Raise InputError where all of the drawing lies outside the image."""
        if self._outside and not self.mask.any():
            raise outside_error(np.vstack(self._outside), self.shape, where)


def _pairs(points: Any, where: str) -> Array:
    """(n, 2) coordinates of a list of positions, of which the height is left aside."""
    try:
        return np.array([p[:2] for p in points], dtype=float).reshape(-1, 2)
    except (TypeError, ValueError, IndexError):
        raise InputError("coordinates that are not pairs of numbers", where=where) from None


def polygon_of(rings: Sequence[Array]) -> shapely.Geometry:
    """The exterior less the holes; where sides cross, the parts that are enclosed an odd number of times."""
    import shapely

    return shapely.make_valid(shapely.Polygon(rings[0], rings[1:]))


def area_inside(polygon: shapely.Geometry, shape: tuple[int, int]) -> float:
    """Area of what an image (lines, samples) holds of a polygon [pixels]."""
    import shapely

    return float(polygon.intersection(shapely.box(0, 0, shape[1], shape[0])).area)
