"""Images in scanner geometry whose pixels are placed one by one: ENVI IGM and location files, and swath products.

Two bands, or two arrays, hold the map coordinates (or longitude and latitude) of the centre of every pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import InputError
from hyperval.imagery.lookup_table import RADIUS, LookupTable, divided
from hyperval.imagery.rasters import Raster

Array = npt.NDArray[np.float64]
MOST_NODES = 160_000  # of the coarse grid that a place is first looked for in
_STEPS = 8  # of the search from the nearest node to the nearest pixel
_FARTHEST = 1.5  # [pixel] beyond the image that a place may lie
_EQUATOR_M, _FLATTENING_SQUARED = 6_378_137.0, 6.694379990141e-3  # WGS 84: radius, first eccentricity squared
_AREAS = 400


@dataclass(frozen=True, eq=False)
class LocationTable(LookupTable):
    """The place of every pixel of an image; used like a lookup table.

    A place is found by a plane through the coordinates of the 7 x 7 pixels around the nearest one.
    """

    def to_pixel(self, points: Array, *, where: str, ring: bool = False) -> Array:
        """(n, 2) continuous raw coordinates (sample, line) of map coordinates (x, y).

        Raises
        ------
        InputError : a point that no pixel lies near.
        """
        xy = np.asarray(points, dtype=float).reshape(-1, 2)
        if ring:
            xy = divided(xy / self._pixel, where) * self._pixel
        if not np.all(np.isfinite(xy)):
            raise InputError("coordinates that are not finite", where=where)
        return np.array([self._place(place, where) for place in xy]).reshape(-1, 2)

    @cached_property
    def pixel_area_m2(self) -> float | None:
        """Median ground area of a pixel [m2] over places along the image; None when the map unit is unknown."""
        metres = self._metres
        if metres is None:
            return None
        lines = np.unique(np.linspace(0, self.shape[0] - 1, 20).astype(int))
        samples = np.unique(np.linspace(0, self.shape[1] - 1, _AREAS // 20).astype(int))
        areas = []
        for line in lines:
            for sample in samples:
                fit = self._fit(int(line), int(sample))
                if fit is not None:
                    latitude = fit[0][1]
                    scale = metres(latitude)
                    areas.append(abs(np.linalg.det(fit[1])) * scale[0] * scale[1])
        return float(np.median(areas)) if areas else None

    @property
    def middle(self) -> tuple[float, float]:
        """Map coordinates (x, y) of the pixel with a place that is nearest to the middle of the image."""
        _, nodes, _ = self._coarse
        line, sample = nodes[np.argmin(np.hypot(*(nodes - np.array(self.shape) / 2.0).T))]
        x, y = self._xy(int(line), 1)
        return float(x[0, sample]), float(y[0, sample])

    @property
    def metres_per_unit(self) -> float:
        """Length of the unit of the map [m]; raises InputError where it is an angle or unknown."""
        if self.crs is None or not self.crs.is_projected:
            raise InputError("the places of the pixels are not in a unit of length", where=str(self.raster.path))
        return float(self.crs.linear_units_factor[1])

    @property
    def _metres(self) -> Callable[[float], tuple[float, float]] | None:
        """A function of latitude that gives the metres of a unit of x and of y; None when unknown."""
        if self.crs is None:
            return None
        if self.crs.is_projected:
            factor = float(self.crs.linear_units_factor[1])
            return lambda latitude: (factor, factor)
        return metres_per_degree

    @cached_property
    def _coarse(self) -> tuple[Any, npt.NDArray[np.intp], Array]:
        """Every n-th pixel with a place: their tree, their (line, sample), and the scale of x and y in it."""
        step = max(1, math.ceil(math.sqrt(self.shape[0] * self.shape[1] / MOST_NODES)))
        nodes, places = [], []
        cols = np.arange(0, self.shape[1], step)
        for line in range(0, self.shape[0], step):
            x, y = self._xy(line, 1)
            good = self._valid(x[0, cols], y[0, cols])
            nodes.append(np.column_stack([np.full(int(good.sum()), line), cols[good]]))
            places.append(np.column_stack([x[0, cols][good], y[0, cols][good]]))
        place = np.concatenate(places)
        if not len(place):
            raise InputError("no pixel has a place", where=str(self.raster.path))
        geographic = self.crs is not None and self.crs.is_geographic
        scale = np.array([math.cos(math.radians(float(place[:, 1].mean()))) if geographic else 1.0, 1.0])
        return scipy.spatial.cKDTree(place * scale), np.concatenate(nodes), scale

    @cached_property
    def _pixel(self) -> float:
        """Ground step of a pixel in units of the map, in the middle of the image."""
        nodes = self._coarse[1]
        line, sample = nodes[len(nodes) // 2]
        fit = self._fit(int(line), int(sample))
        if fit is None:
            raise InputError("the places of the pixels do not change", where=str(self.raster.path))
        return math.sqrt(abs(float(np.linalg.det(fit[1]))))

    def _place(self, xy: Array, where: str) -> Array:
        tree, nodes, scale = self._coarse
        line, sample = (int(v) for v in nodes[tree.query(xy * scale)[1]])
        for _ in range(_STEPS):
            fit = self._fit(line, sample)
            if fit is None:
                break
            place = np.array([sample + 0.5, line + 0.5]) + np.linalg.solve(fit[1], xy - fit[0])
            near = (
                int(np.clip(math.floor(place[1]), 0, self.shape[0] - 1)),
                int(np.clip(math.floor(place[0]), 0, self.shape[1] - 1)),
            )
            if near == (line, sample):
                beyond = max(place[0] - self.shape[1], place[1] - self.shape[0], -place[0], -place[1])
                if beyond <= _FARTHEST:
                    return np.asarray(place)
                break
            line, sample = near
        raise InputError(
            f"the place ({xy[0]:.6g}, {xy[1]:.6g}) has no pixel in the image",
            where=where,
            expected="places that the flight line covers",
            mend="check the coordinate system, and that the location file belongs to this image",
        )

    def _fit(self, line: int, sample: int) -> tuple[Array, Array] | None:
        """Map coordinates of a pixel's centre, and (2, 2) their change with sample and line; None without any."""
        top, left = max(0, line - RADIUS), max(0, sample - RADIUS)
        x, y = self._xy(top, min(self.shape[0], line + RADIUS + 1) - top)
        x, y = (v[:, left : sample + RADIUS + 1] for v in (x, y))
        good = self._valid(x, y)
        rows, cols = np.nonzero(good)
        if rows.size < 3 or np.ptp(rows) == 0 or np.ptp(cols) == 0:
            return None
        design = np.column_stack([np.ones(rows.size), cols + left - sample, rows + top - line])
        origin: Array = np.array([x[good][0], y[good][0]])  # small numbers keep their digits
        wanted = np.column_stack([x[good], y[good]]) - origin
        plane = np.asarray(np.linalg.lstsq(design, wanted, rcond=None)[0], dtype=np.float64)
        change = plane[1:].T
        return (plane[0] + origin, change) if abs(np.linalg.det(change)) > 0 else None

    def _xy(self, first: int, count: int) -> tuple[Array, Array]:
        stored = self.raster.read_bands(first, count).astype(float)
        return stored[0], stored[1]

    def _valid(self, x: Array, y: Array) -> npt.NDArray[np.bool_]:
        """Where the coordinates are numbers and no fill."""
        good = np.isfinite(x) & np.isfinite(y) & (x > -9990.0) & ((x != 0) | (y != 0))
        if self.crs is not None and self.crs.is_geographic:
            good &= (np.abs(x) <= 180.0) & (np.abs(y) <= 90.0)
        return np.asarray(good)


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Metres of a degree of longitude and of latitude on WGS 84 (radii of the prime vertical and the meridian)."""
    phi = math.radians(latitude)
    w = 1.0 - _FLATTENING_SQUARED * math.sin(phi) ** 2
    prime, meridian = _EQUATOR_M / math.sqrt(w), _EQUATOR_M * (1.0 - _FLATTENING_SQUARED) / w**1.5
    return math.radians(prime * math.cos(phi)), math.radians(meridian)


def location_table(raster: Raster, shape: tuple[int, int]) -> LocationTable:
    """The places of the pixels of an image of ``shape`` (lines, samples) from a raster whose bands are x, y, ...

    Numbers that all lie within 180 and 90 are longitude and latitude on WGS 84; others are in the system that the
    header names, which may be unknown.

    Raises
    ------
    InputError : another size than the image, fewer than two bands, or no pixel with a place.
    """
    if (raster.lines, raster.samples) != shape or raster.bands < 2:
        raise InputError(
            f"{raster.lines} lines, {raster.samples} samples and {raster.bands} bands",
            where=str(raster.path),
            expected=f"{shape[0]} lines and {shape[1]} samples, as the image, and two bands: x and y",
        )
    table = LocationTable(raster, Affine.identity(), None, shape)
    lines = np.unique(np.linspace(0, shape[0] - 1, 16).astype(int))
    rows = [table._xy(int(line), 1) for line in lines]
    x, y = (np.concatenate([row[i].ravel() for row in rows]) for i in (0, 1))
    good = table._valid(x, y)
    if not good.any():
        raise InputError("no pixel has a place", where=str(raster.path))
    degrees = bool(np.all(np.abs(x[good]) <= 180.0) and np.all(np.abs(y[good]) <= 90.0))
    return LocationTable(raster, Affine.identity(), CRS.from_epsg(4326) if degrees else raster.crs, shape)
