"""Files that belong to a cube: lookup table (GLT), places of its pixels (IGM, LOC), angles (OBS).

From map coordinates to the pixels of an image in scanner geometry: lookup tables (ENVI GLT), places of pixels.

A GLT is an image on a map grid whose two bands name, from 1, the sample and the line of the raw image that belongs
there.  Both are negative where the grid's cell was filled with its nearest neighbour, and 0 outside the line.

In ENVI IGM and location files, and in swath products, two bands or arrays hold the map coordinates (or longitude
and latitude) of the centre of every pixel.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import scipy
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import HypervalError, InputError, reader
from hyperval.imagery.arrays import ArrayRaster, Hdf5Store, Piece, Term, check_own_values
from hyperval.imagery.envi import EnviRaster, pixel_area_m2
from hyperval.imagery.products import Values, layouts, location_names, lookup_raster, member, tree_of
from hyperval.imagery.rasters import Raster, open_raster
from hyperval.imagery.tiff import TiffRaster

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

# Cells around a place whose raw pixels are fitted: 7 x 7 average out the rounding to whole pixels.
RADIUS = 3
_FEWEST = 6  # cells for the three unknowns of a coordinate
_BLOCK = 256  # lines of the table held at once
_SIDE_CELLS = 4.0  # a polygon's sides are divided, as a straight one is bent in the raw image
MAX_VERTICES = 1_000_000
_AREA_PLACES = 400
MOST_NODES = 160_000  # of the coarse grid that a place is first looked for in
_STEPS = 8  # of the search from the nearest node to the nearest pixel
_FARTHEST = 1.5  # [pixel] beyond the image that a place may lie
_EQUATOR_M, _FLATTENING_SQUARED = 6_378_137.0, 6.694379990141e-3  # WGS 84: radius, first eccentricity squared
_AREAS = 400


@dataclass(frozen=True, eq=False)
class LookupTable:
    """A GLT for a raw image; it takes the place of an affine transform.

    Attributes
    ----------
    raster : the table
    transform : continuous (sample, line) of the table to map coordinates
    crs : its coordinate system, None when unknown
    shape : (lines, samples) of the raw image
    swapped : the first band holds the lines
    """

    raster: Raster
    transform: Affine
    crs: CRS | None
    shape: tuple[int, int]
    swapped: bool = False

    def to_pixel(self, points: Array, *, where: str, ring: bool = False) -> Array:
        """(n, 2) continuous raw coordinates (sample, line) of map coordinates (x, y).

        A plane is fitted to the raw pixels of the 7 x 7 cells around each point; cells filled from their neighbours
        count only where the others are too few.

        Raises
        ------
        InputError : a point with no raw pixel near it.
        """
        cells = self._cells(np.asarray(points, dtype=float).reshape(-1, 2))
        if ring:
            cells = divided(cells, where)
        if not np.all(np.isfinite(cells)):
            raise InputError("coordinates that are not finite", where=where)
        out = np.empty_like(cells)
        blocks = np.clip(np.floor(cells[:, 1] / _BLOCK), -1, self.raster.lines // _BLOCK + 1).astype(int)
        for block in np.unique(blocks):
            here = np.flatnonzero(blocks == block)
            first = max(0, int(block) * _BLOCK - RADIUS)
            last = min(self.raster.lines, (int(block) + 1) * _BLOCK + RADIUS)
            sample, line = self._read(first, last - first) if last > first else (np.zeros((0, 0), int),) * 2
            for i in here:
                fit = _fitted(cells[i], sample, line, first)
                if fit is None:
                    x, y = self.transform @ cells[i]
                    raise InputError(
                        f"the place ({x:.2f}, {y:.2f}) has no pixel in the lookup table",
                        where=where,
                        expected="places that the flight line covers",
                        mend="check the coordinate system, and that table and cube belong to one line",
                    )
                out[i] = fit[0]
        return out

    @cached_property
    def pixel_area_m2(self) -> float | None:
        """Median ground area of a raw pixel [m2]: a cell's over the determinant of the fit; None when unknown."""
        cell = self._cell_area_m2
        if cell is None:
            return None
        rng = np.random.default_rng(0)  # places along the whole line, the same every time
        areas = []
        for top in np.unique(np.linspace(0, max(0, self.raster.lines - _BLOCK), 4).astype(int)):
            sample, line = self._read(int(top), min(_BLOCK, self.raster.lines - int(top)))
            rows, cols = np.nonzero(sample)
            for k in rng.permutation(rows.size)[: _AREA_PLACES // 4]:
                fit = _fitted(np.array([cols[k] + 0.5, top + rows[k] + 0.5]), sample, line, int(top))
                if fit is not None and fit[1] > 0:
                    areas.append(cell / fit[1])
        return float(np.median(areas)) if areas else None

    @property
    def middle(self) -> tuple[float, float]:
        """Map coordinates (x, y) of the middle of the map grid."""
        x, y = self.transform @ (self.raster.samples / 2.0, self.raster.lines / 2.0)
        return x, y

    @property
    def metres_per_unit(self) -> float:
        """Length of the unit of the map [m]; raises InputError where it is an angle or unknown."""
        cell = self._cell_area_m2
        if cell is None:
            raise InputError(
                "the map of the lookup table is not in a known unit of length", where=str(self.raster.path)
            )
        return math.sqrt(cell / abs(self.transform.determinant))

    @property
    def _cell_area_m2(self) -> float | None:
        return pixel_area_m2(self.transform, self.crs, self.raster.header)

    def _cells(self, points: Array) -> Array:
        return np.column_stack(~self.transform @ points.T)

    def _read(self, first: int, count: int) -> tuple[Index, Index]:
        """Stored sample and line (count, samples) of some lines of the table."""
        stored = self.raster.read_bands(first, count).astype(np.int64)
        return (stored[1], stored[0]) if self.swapped else (stored[0], stored[1])


@reader
def open_lookup_table(table: Path | str | Raster, shape: tuple[int, int]) -> LookupTable:
    """Open the GLT (a file, or its raster) of a raw image of ``shape`` (lines, samples); all of it is checked.

    Raises
    ------
    InputError : not two bands of whole numbers on a map grid, or pixels that the image does not have.
    """
    raster = open_raster(table) if isinstance(table, Path | str) else table
    where = str(raster.path)
    if raster.bands != 2 or raster.dtype.kind not in "iu":
        raise InputError(
            f"{raster.bands} bands of {raster.dtype}", where=where, expected="a lookup table: two bands of integers"
        )
    if raster.transform is None:
        raise InputError("the lookup table has no 'map info'", where=where)
    names = raster.header.band_names if raster.header is not None else ()
    swapped = len(names) == 2 and "line" in names[0].lower() and "sample" in names[1].lower()
    opened = LookupTable(raster, raster.transform, raster.crs, shape, swapped)
    cells = greatest_sample = greatest_line = 0
    for first in range(0, raster.lines, _BLOCK):
        sample, line = opened._read(first, min(_BLOCK, raster.lines - first))
        if np.any((sample == 0) != (line == 0)) or np.any((sample < 0) != (line < 0)):
            raise InputError(
                f"cells where one of sample and line is 0 or negative (in lines {first}-{first + len(sample) - 1})",
                where=where,
                expected="both 0 outside the flight line, both negative where filled",
            )
        cells += int(np.count_nonzero(sample))
        greatest_sample = max(greatest_sample, int(np.abs(sample).max()))
        greatest_line = max(greatest_line, int(np.abs(line).max()))
    if not cells:
        raise InputError("the lookup table names no pixel", where=where)
    if greatest_sample > shape[1] or greatest_line > shape[0]:
        raise InputError(
            f"the lookup table goes to line {greatest_line}, sample {greatest_sample} (from 1)",
            where=where,
            expected=f"{shape[0]} lines and {shape[1]} samples, as the cube",
            mend="give the lookup table of this flight line",
        )
    return opened


def divided(ring: Array, where: str) -> Array:
    """A ring (n, 2) in cells of the table with vertices at most 4 cells apart on every side."""
    if len(ring) > 1 and np.array_equal(ring[0], ring[-1]):
        ring = ring[:-1]
    ahead = np.roll(ring, -1, axis=0)
    length = np.hypot(*(ahead - ring).T)
    if not np.all(np.isfinite(length)) or length.sum() / _SIDE_CELLS > MAX_VERTICES:
        raise InputError("a polygon far larger than any lookup table", where=where)
    parts = np.maximum(1, np.ceil(length / _SIDE_CELLS)).astype(int)
    start = np.repeat(ring, parts, axis=0)
    step = np.repeat(ahead - ring, parts, axis=0)
    share = np.concatenate([np.arange(p) / p for p in parts])
    return np.asarray(start + share[:, None] * step)


def _fitted(cell: Array, sample: Index, line: Index, first: int) -> tuple[Array, float] | None:
    """Raw coordinates (sample, line) at a place of the table, and raw pixels per cell; None without cells near."""
    column, row = int(np.floor(cell[0])), int(np.floor(cell[1])) - first
    if not (-RADIUS <= column < sample.shape[1] + RADIUS and -RADIUS <= row < sample.shape[0] + RADIUS):
        return None
    rows = slice(max(0, row - RADIUS), row + RADIUS + 1)
    cols = slice(max(0, column - RADIUS), column + RADIUS + 1)
    s, ln = sample[rows, cols], line[rows, cols]
    for used in (s > 0, s != 0):
        at_row, at_col = np.nonzero(used)
        if at_row.size >= _FEWEST and np.ptp(at_row) > 0 and np.ptp(at_col) > 0:
            break
    else:
        return None
    x = at_col + cols.start + 0.5 - cell[0]
    y = at_row + rows.start + first + 0.5 - cell[1]
    design = np.column_stack([np.ones(x.size), x, y])
    raw = np.column_stack([np.abs(s[used]), np.abs(ln[used])]) - 0.5  # the centre of pixel 1 is at 0.5
    plane = np.linalg.lstsq(design, raw, rcond=None)[0]
    return plane[0], abs(float(np.linalg.det(plane[1:])))


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
        for line, sample in product(lines, samples):
            fit = self._fit(int(line), int(sample))
            if fit is not None:
                scale = metres(fit[0][1])
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
            near = tuple(int(v) for v in np.clip(np.floor(place[::-1]), 0, np.array(self.shape) - 1))
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


_TREES = (".nc", ".nc4", ".h5", ".hdf5", ".he5")

# Parts of names that tell the files of one line apart, such as ang20160217t083024_rdn_v1n2_img and ..._rdn_glt.
_KINDS = re.compile(
    r"^(img|dat|rdn|rad|pol|ref|rfl|refl|radiance|reflectance|ort|raw|data|corr|glt|igm|loc|obs|l[0-4][a-d]?|v[0-9]\w*)$"
)
SUN_ZENITH = re.compile(r"(sun|solar)\W+zenith", re.IGNORECASE)
SAMPLED_LINES = 16


def companion(image: Path, kind: str) -> Path | None:
    """The file of a kind ("glt", "igm", "loc", "obs") beside an image, by the names that producers give; None else.

    Their names are the same but for the words that say what a file is; of several that fit, the one that has the
    image's own such words (``x_rad_glt`` for ``x_rad``), and none where that leaves two.
    """
    own, kinds = _name(image)
    fits = []
    if image.suffix.lower() in _TREES:
        others = [p for p in sorted(image.parent.glob("*" + image.suffix)) if p != image]
        fits = [p for p in others if _name(p)[0] == own and kind in _name(p)[1]]
        return fits[0] if len(fits) == 1 else None
    for header in sorted(image.parent.glob("*.[hH][dD][rR]")):
        data = header.with_suffix("")
        if not data.is_file():
            data = next((p for p in (data.with_suffix(end) for end in (".img", ".dat")) if p.is_file()), data)
        name, words = _name(data)
        if data != image and data.is_file() and kind in words and name == own:
            fits.append(data)
    if len(fits) > 1:
        fits = [p for p in fits if kinds <= _name(p)[1]]
    return fits[0] if len(fits) == 1 else None


def table_of(raster: Raster) -> tuple[LookupTable | None, tuple[str, ...]]:
    """What places the pixels of an image without a map position, and notes: its own table, or one beside it."""
    if raster.transform is not None:
        return None, ()
    shape = (raster.lines, raster.samples)
    if isinstance(raster, ArrayRaster):
        own = lookup_raster(raster)
        if own is not None:
            return open_lookup_table(own, shape), ()
        names = location_names(raster)
        if names is None:
            return None, ()
        pieces = tuple(Piece((Term(name),), "ls", shape, np.dtype(np.float64)) for name in names)
        return location_table(ArrayRaster(raster.path, raster.store, pieces), shape), ()
    if not isinstance(raster, EnviRaster):
        return None, ()
    for kind in ("glt", "igm", "loc"):
        path = companion(raster.path, kind)
        if path is None:
            continue
        try:
            table = open_lookup_table(path, shape) if kind == "glt" else location_table(open_raster(path), shape)
        except HypervalError as error:
            return None, (f"warning: {path.name} lies beside the cube and is left aside: {error.what}",)
        return table, (f"{path.name} lies beside the cube and places its pixels",)
    return None, ()


def sun_zenith_deg(raster: Raster) -> tuple[float, str] | None:
    """Median zenith angle of the sun [degrees] as a product states it, or the observation file (OBS) beside a cube.

    Also the name of the file.  None where there is none of the cube's size, or none of its bands is called so.
    """
    if isinstance(raster, TiffRaster):
        about = raster.description
        stated = about.sun_zenith_deg if about is not None else None
        return None if stated is None else (stated, raster.other_files[0].name)
    own = sun_of_product(raster) if isinstance(raster, ArrayRaster) else None
    if own is not None:
        return own, raster.path.name
    path = companion(raster.path, "obs")
    if path is None:
        return None
    shape = (raster.lines, raster.samples)
    try:
        angles = _zenith_lines(path, shape) if isinstance(raster, EnviRaster) else sun_of_observation(path, shape)
    except HypervalError:
        return None
    if angles is None:
        return None
    zenith = angles[np.isfinite(angles) & (angles >= 0.0) & (angles <= 180.0)]
    return (float(np.median(zenith)), path.name) if zenith.size else None


def _zenith_lines(path: Path, shape: tuple[int, int]) -> Array | None:
    """Zenith angles of the sun in some lines of an ENVI file of observation geometry."""
    angles = open_raster(path)
    names = angles.header.band_names if angles.header is not None else ()
    bands = [i for i, name in enumerate(names) if SUN_ZENITH.search(name)]
    if len(bands) != 1 or (angles.lines, angles.samples) != shape:
        return None
    lines = np.unique(np.linspace(0, angles.lines - 1, SAMPLED_LINES).astype(int))
    return np.concatenate([angles.read_bands(int(line), 1)[bands[0]].ravel() for line in lines]).astype(float)


def _name(path: Path) -> tuple[tuple[str, ...], set[str]]:
    """The words of a file's name that name the line, and those that say what the file is."""
    words = re.split(r"[_.\-]", path.name.lower())
    return tuple(w for w in words if w and not _KINDS.match(w)), {w for w in words if _KINDS.match(w)}


def sun_of_product(raster: ArrayRaster) -> float | None:
    """The zenith angle of the sun [degrees] that a product states for the whole image; None without."""
    if not isinstance(raster.store, Hdf5Store):
        return None
    with raster.store.kept_open() as file:
        tree = tree_of(file)
        if tree is None or tree.sun_zenith is None:
            return None
        array = None if "@" in tree.sun_zenith else member(file, tree.sun_zenith)
        if isinstance(array, h5py.Dataset) and array.ndim == 2:
            angles = _some_lines(array, None)
            angles = angles[(angles >= 0.0) & (angles <= 180.0)]
            return float(np.median(angles)) if angles.size else None
        text = Values(file, raster.path).text(tree.sun_zenith)
    try:
        angle = float(text or "nan")
    except ValueError:
        return None
    return angle if 0.0 <= angle <= 180.0 else None


def sun_of_observation(path: Path, shape: tuple[int, int]) -> Array | None:
    """Zenith angles of the sun [degrees] in some lines of a file of angles for an image of ``shape``.

    None where its layout is not known or it is of another size.

    Raises
    ------
    InputError : no HDF5 file, or one whose values lie elsewhere.
    """
    check_own_values(path)
    with Hdf5Store(path).kept_open() as file:
        for layout in layouts().observations:
            if layout.sun_zenith is not None:
                array = member(file, layout.sun_zenith)
                if isinstance(array, h5py.Dataset) and array.shape == shape:
                    return _some_lines(array, None)
            if layout.image is not None and layout.names is not None:
                array, names = member(file, layout.image), member(file, layout.names)
                if isinstance(array, h5py.Dataset) and isinstance(names, h5py.Dataset):
                    words = [_text(name) for name in names[()].ravel()]
                    bands = [i for i, word in enumerate(words) if SUN_ZENITH.search(word)]
                    if len(bands) == 1 and array.shape == (*shape, len(words)):
                        return _some_lines(array, bands[0])
    return None


def _text(name: bytes | str) -> str:
    return name.decode("utf-8", "replace") if isinstance(name, bytes) else str(name)


def _some_lines(array: h5py.Dataset, band: int | None) -> Array:
    lines = np.unique(np.linspace(0, array.shape[0] - 1, SAMPLED_LINES).astype(int))
    rows = [array[int(line)] if band is None else array[int(line), :, band] for line in lines]
    return np.concatenate([np.asarray(row, dtype=np.float64).ravel() for row in rows])
