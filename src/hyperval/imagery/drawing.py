"""What a region file draws: the pixels inside the image, and how much of the drawing lies outside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import shapely

from hyperval.errors import InputError
from hyperval.imagery.polygons import Ring, burned, inside_image, outside_error, pixel_mask, point_mask, ring_of

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
FARTHEST = 1e9  # [pixel] from the image: no drawing, but numbers in another unit
WARNING = "warning: "
_SMALL = 0.01  # a part outside that is said without a warning


@dataclass(eq=False)
class Drawing:
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
    _bounds: list[Array] = field(default_factory=list)
    _polygons: list[list[Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.mask = np.zeros(self.shape, bool)

    def add_polygon(self, exterior: Ring, holes: Sequence[Ring] = (), *, where: str) -> None:
        """Add the pixels whose centre lies in a polygon; what leaves the image is cut off and counted.

        Raises
        ------
        InputError : fewer than three different vertices, or coordinates that are none.
        """
        rings = [ring_of(r, where) for r in (exterior, *holes)]
        for ring in rings:
            if np.abs(ring).max() > FARTHEST:
                raise outside_error(ring, self.shape, where)
        whole = polygon_of(rings)
        self.area += whole.area
        self.area_inside += area_inside(whole, self.shape)
        self.mask |= burned(rings, self.shape)
        self._polygons.append(rings)
        if not all(inside_image(r, self.shape) for r in rings):
            self._bounds.append(rings[0])

    def add_points(self, points: npt.ArrayLike, *, where: str) -> None:
        """Add the pixels that hold points (sample, line) in continuous coordinates."""
        xy = np.asarray(points, dtype=float).reshape(-1, 2)
        if not np.all(np.isfinite(xy)):
            raise InputError("coordinates that are not finite", where=where)
        inside = np.array([inside_image(p[None, :], self.shape) for p in xy], dtype=bool)
        self.points += len(xy)
        self.points_outside += int((~inside).sum())
        if inside.any():
            self.mask |= point_mask(xy[inside], self.shape, where=where)
        if not inside.all():
            self._bounds.append(xy)

    def add_pixels(self, rows: npt.ArrayLike, cols: npt.ArrayLike, *, where: str) -> None:
        """Add pixels named by 0-based whole numbers, which must be in the image."""
        self.mask |= pixel_mask(rows, cols, self.shape, where=where)

    @property
    def touched(self) -> Mask:
        """(lines, samples) the pixels of the region and all others that its polygons touch."""
        out = self.mask.copy()
        for rings in self._polygons:
            out |= burned(rings, self.shape, touched=True)
        return out

    def notes(self) -> tuple[str, ...]:
        """What is to be said, after the region's name, of the part outside the image; empty without one."""
        left = f"{int(self.mask.sum())} pixels are left"
        out = []
        # To the millionth of a pixel of the border, see ``inside_image``.
        part = 1.0 - self.area_inside / self.area if self._bounds and self.area > 0.0 else 0.0
        if part > 0.0:
            sign = "" if part < _SMALL else WARNING
            out.append(f"{sign}leaves the image: {_percent(part)} of its area is outside, {left}")
        if self.points_outside:
            out.append(
                f"{WARNING}leaves the image: {self.points_outside} of {self.points} points are outside, {left}"
            )
        drawn = int(self.mask.sum())
        if self.stated_pixels not in (None, drawn):
            out.append(f"has {self.stated_pixels} pixels as its file says; {drawn} have their centre inside")
        return tuple(out)

    def check(self, where: str) -> None:
        """Raise InputError where all of the drawing lies outside the image."""
        if self._bounds and not self.mask.any():
            raise outside_error(np.vstack(self._bounds), self.shape, where)


def polygon_of(rings: Sequence[Array]) -> shapely.Geometry:
    """The exterior less the holes; where sides cross, the parts that are enclosed an odd number of times."""
    return shapely.make_valid(shapely.Polygon(rings[0], rings[1:]))


def area_inside(polygon: shapely.Geometry, shape: tuple[int, int]) -> float:
    """Area of what an image (lines, samples) holds of a polygon [pixels]."""
    return float(polygon.intersection(shapely.box(0, 0, shape[1], shape[0])).area)


def _percent(part: float) -> str:
    return f"{100.0 * part:.1f} %" if part >= 0.001 else "less than 0.1 %"
