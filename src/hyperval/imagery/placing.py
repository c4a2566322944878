"""Files that place a cube (lookup table, positions and angles of pixels), and the record of an image.

A lookup table (GLT) is an image on a map grid whose two bands name, from 1, the sample and the line of the raw image
that belongs there.  Both are negative where the grid's cell was filled with its nearest neighbour, and 0 outside the
line.  In ENVI IGM and location files, and in swath products, two bands or arrays hold the map coordinates (or longitude
and latitude) of the centre of every pixel.
"""

from __future__ import annotations

import math
import re
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import shapely
from affine import Affine
from rasterio.crs import CRS
from shapely.geometry.base import BaseGeometry

from hyperval.data import Array, Index, Mask
from hyperval.errors import HypervalError, needed, reader, refusal, refuse
from hyperval.imagery import arrays
from hyperval.imagery.cube import open_raster
from hyperval.imagery.description import Description, Raster, Scale, some_lines
from hyperval.imagery.envi import EnviRaster, pixel_area_m2
from hyperval.imagery.products import SAMPLED_LINES, median_angle, table_in
from hyperval.spectra.axis import wavelengths_in_nm
from hyperval.spectra.record import reflectance_factor
from hyperval.units import is_radiance

# Pixels around a place that are fitted: 7 x 7 average out the rounding to whole cells of a lookup table, of which one
# coarser than the image names few.
_RADII = (3, 6, 12)
_FEWEST = 6  # pixels for the three unknowns of a coordinate
_BLOCK = 256  # lines of the table held at once
_FILLED = 1e-6  # weight of a cell that was filled from its neighbours
_SIDE_PIXELS = 4.0  # a polygon's sides are divided, as a straight one is bent in the raw image
MAX_VERTICES = 1_000_000
_AREA_PLACES = 400  # at which the area of a pixel is looked at
MAX_NODES = 160_000  # of the coarse grid that a place is first looked for in
_STEPS = 8  # of the search from the nearest node to the nearest pixel
_FARTHEST = 1.5  # [pixel] beyond the image that a place may lie
_SUN_ZENITH = re.compile(r"(sun|solar)\W+zenith", re.IGNORECASE)
_EQUATOR_M, _FLATTENING_SQUARED = 6_378_137.0, 6.694379990141e-3  # WGS 84: radius, first eccentricity squared


@dataclass(frozen=True, eq=False)
class LocationTable:
    """The place of every pixel of an image on a map; it takes the place of an affine transform.

    Attributes
    ----------
    raster : its bands are x and y of the centres of the pixels; neither is finite, or both are 0, where one has none
    crs : their coordinate system, None when unknown
    meridian : longitude of one of the pixels, around which those of others are counted on; None on another map

    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import open_lookup_table, write_cube
    >>> rng, (line, sample) = np.random.default_rng(1), np.indices((20, 20)) + 0.5
    >>> uneven = np.stack([sample, -line], -1) + 500.0 + rng.normal(0.0, 0.2, (20, 20, 2))
    >>> with TemporaryDirectory() as folder:
    ...     table = open_lookup_table(write_cube(f"{folder}/igm", uneven, data_type=5), (20, 20))
    ...     offsets = rng.uniform(3.0, 16.0, (400, 2))
    ...     found = table.to_pixel([500.0, 500.0] + offsets * [1, -1], where="")
    ...     outside = table.to_pixel([[480.0, 490.0]], where="", beyond=True)
    >>> bool(np.abs(found - offsets).max() < 0.5), bool(np.abs(outside - [-20.0, 10.0]).max() < 3.0)
    (True, True)
    >>> line, sample = np.indices((60, 30)) + 0.5
    >>> turning = (40.0 + sample + 6.0 * np.sin(line / 2.0)) * np.exp(1j * line / 40.0)
    >>> with TemporaryDirectory() as folder:
    ...     igm = write_cube(f"{folder}/igm", np.stack([500.0 - turning.real, 500.0 + turning.imag], -1), data_type=5)
    ...     table = open_lookup_table(igm, (60, 30))
    ...     bool(np.abs(table.to_pixel([[-94.0, 585.0]], where="", beyond=True)).max() > 300.0)
    True
    >>> across = np.stack([(179.99 + 0.002 * sample + 180.0) % 360.0 - 180.0, -0.002 * line], -1)  # the date line
    >>> with TemporaryDirectory() as folder:
    ...     table = open_lookup_table(write_cube(f"{folder}/igm", across, data_type=5), (60, 30))
    ...     table.to_pixel([[179.994, -0.002], [-179.994, -0.1]], where="").round(6).tolist()
    ...     round(table.middle[0], 6), table.divided(shapely.box(-179.996, -0.1, 179.994, -0.01), "").bounds[::2]
    ...     bool(table.to_pixel([[1979.994, -0.002]], where="", beyond=True)[0, 0] > 1e5)  # metres are no longitude
    [[2.0, 1.0], [8.0, 50.0]]
    (-179.979, (179.994, 180.004))
    True
    """

    raster: Raster
    crs: CRS | None
    meridian: float | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(lines, samples) of the image."""
        return self.raster.size[:2]

    def to_pixel(self, points: Array, *, where: str, beyond: bool = False) -> Array:
        """(n, 2) continuous pixel coordinates (sample, line) of map coordinates (x, y).

        A place is found by the plane through the coordinates of the 7 x 7 pixels around the nearest one, of more where
        few of these have any; ``beyond`` the image by the plane of its edge.

        Raises
        ------
        InputError : a point with no pixel near it.
        """
        xy = np.asarray(points, dtype=float).reshape(-1, 2)
        refuse(not np.all(np.isfinite(xy)), "region.not_finite", where)
        return np.array([self._place(place, where, beyond) for place in xy]).reshape(-1, 2)

    def divided(self, geometry: BaseGeometry, where: str) -> BaseGeometry:
        """A geometry on the map with vertices at most 4 pixels apart on every side."""
        near = shapely.transform(geometry, self._near)
        side = _SIDE_PIXELS * math.sqrt(needed(self._area, "place.same", self.raster.path))
        refuse(not near.length / side <= MAX_VERTICES, "place.large", where)
        return shapely.segmentize(near, side)

    @cached_property
    def pixel_area_m2(self) -> float | None:
        """Median ground area of a pixel [m2] over places along the image; None when the map unit is unknown."""
        unit, area = self.metres_per_unit, self._area
        return None if unit is None or area is None else math.prod(unit) * area

    @property
    def middle(self) -> tuple[float, float]:
        """Map coordinates (x, y) of the pixel with a place that is nearest to the middle of the image."""
        tree, nodes, scale = self._coarse
        x, y = (tree.data / scale)[np.argmin(np.hypot(*(nodes - np.array(self.shape) / 2.0).T))].tolist()
        return x - 360.0 * (self.meridian is not None and round(x / 360.0)), y

    @property
    def metres_per_unit(self) -> tuple[float, float] | None:
        """Lengths of the unit of the map along x and y [m], of a degree in the middle; None where it is not known."""
        if self.meridian is not None:
            return metres_per_degree(self.middle[1])
        area = pixel_area_m2(Affine.identity(), self.crs, self.raster.description.entries)
        return None if area is None else (math.sqrt(area),) * 2

    @cached_property
    def _coarse(self) -> tuple[Any, Index, Array]:
        """Every n-th pixel with a place: their tree, their (line, sample), and the scale of x and y in it."""
        fewest, found = math.ceil(math.prod(self.shape) / MAX_NODES), []
        step = next(n for n in count(fewest) if math.gcd(n, self.shape[1]) == 1)  # not the same columns of all lines
        for first in range(0, self.shape[0], _BLOCK):
            x, y = self._xy(first, min(_BLOCK, self.shape[0] - first))
            rows, columns = (part[::step] for part in np.nonzero(self._valid(x, y)))
            found.append([rows + first, columns, x[rows, columns], y[rows, columns]])
        places = np.concatenate(found, axis=1).T
        refuse(not len(places), "place.none", self.raster.path)
        nodes, place = places[:, :2].astype(int), places[:, 2:]
        scale = np.array([1.0 if self.meridian is None else math.cos(math.radians(float(place[:, 1].mean()))), 1.0])
        return scipy.spatial.cKDTree(place * scale), nodes, scale

    @cached_property
    def _area(self) -> float | None:
        """Median area of a pixel over places along the image in square units of the map; None where none has any."""
        nodes = self._coarse[1]
        fits = [self._fit(*nodes[n].tolist()) for n in some_lines(len(nodes), _AREA_PLACES)]
        areas = [abs(float(np.linalg.det(fit[1]))) for fit in fits if fit is not None]
        return float(np.median(areas)) if areas else None

    def _near(self, xy: Array) -> Array:
        """Places (..., 2) by longitudes that are counted on across the date line from those of the image."""
        turns = 0.0 if self.meridian is None else np.clip(np.round((xy - (self.meridian, 0.0)) / 360.0), -1.0, 1.0)
        return np.asarray(xy - 360.0 * turns)

    def _place(self, xy: Array, where: str, beyond: bool) -> Array:
        (tree, nodes, scale), point = self._coarse, self._near(xy)
        pixel = nearest = nodes[tree.query(point * scale)[1]]
        for _ in range(_STEPS):
            place = self._by_plane(point, pixel)
            if place is None:
                break
            before, pixel = pixel, np.clip(np.floor(place[::-1]).astype(int), 0, np.array(self.shape) - 1)
            if np.abs(pixel - before).max() <= 1:  # at an edge each of two may say that it lies in the other
                outside = max(place[0] - self.shape[1], place[1] - self.shape[0], -place[0], -place[1])
                if beyond or outside <= _FARTHEST:
                    return place
                break
        place = self._by_plane(point, nearest) if beyond else None  # the planes of a line that turns lead nowhere
        if place is not None:
            return place
        raise refusal("place.nowhere", where, xy=xy, crs=self.crs or "an unknown system")

    def _by_plane(self, point: Array, pixel: Index) -> Array | None:
        """(sample, line) of map coordinates by the plane around a pixel (line, sample); None where there is none."""
        fit = self._fit(*pixel.tolist())
        return None if fit is None else np.asarray(pixel[::-1] + 0.5 + np.linalg.solve(fit[1], point - fit[0]))

    def _fit(self, line: int, sample: int) -> tuple[Array, Array] | None:
        """Map coordinates of a pixel's centre, and (2, 2) their change with sample and line; None without any."""
        for radius in _RADII:
            top, first = max(0, line - radius), max(0, sample - radius)
            x, y = self._xy(top, min(self.shape[0], line + radius + 1) - top)
            x, y = (v[:, first : sample + radius + 1] for v in (x, y))
            used = self._valid(x, y)
            rows, columns = np.nonzero(used)
            if rows.size >= _FEWEST and np.ptp(rows) and np.ptp(columns):
                break
        else:
            return None
        values: Array = np.column_stack([x[used], y[used]])
        around = np.column_stack([np.ones(rows.size), columns + (first - sample), rows + (top - line)])
        fit = np.linalg.lstsq(around, values - values[0], rcond=None)[0]  # small numbers keep their digits
        return (np.asarray(fit[0] + values[0]), np.asarray(fit[1:].T)) if np.linalg.det(fit[1:]) else None

    def _xy(self, first: int, count: int) -> tuple[Array, Array]:
        x, y = self.raster.read_bands(first, count)[:2].astype(float)
        if self.meridian is not None:
            x = np.where((np.abs(x) <= 360.0) & (np.abs(y) <= 90.0), self._near(np.stack([x, y], -1))[..., 0], np.nan)
        return x, y

    def _valid(self, x: Array, y: Array) -> Mask:
        """Where the coordinates are numbers and no fill."""
        return np.asarray(np.isfinite(x) & np.isfinite(y) & ((x > -9990.0) | (x != y)) & ((x != 0) | (y != 0)))


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Metres of a degree of longitude and of latitude on WGS 84 (radii of the prime vertical and the meridian)."""
    phi = math.radians(latitude)
    w = 1.0 - _FLATTENING_SQUARED * math.sin(phi) ** 2
    prime, meridian = _EQUATOR_M / math.sqrt(w), _EQUATOR_M * (1.0 - _FLATTENING_SQUARED) / w**1.5
    return math.radians(prime * math.cos(phi)), math.radians(meridian)


@reader
def open_lookup_table(table: Path | str | Raster, shape: tuple[int, int]) -> LocationTable:
    """The places of the pixels of an image of ``shape`` (lines, samples) by a file, or its raster; all is checked.

    Whole numbers are a GLT, in the system of its header; so are floats that are whole, of an image on a map.  Others
    are x and y of every pixel: longitude and latitude, on WGS 84 unless the header names another datum, where they all
    lie within 180 and 90 and a pixel is smaller than a hundredth; else in the system of the header, perhaps unknown.

    A GLT of cells five pixels wide, on a map near its origin in a system that is not known:

    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import write_cube
    >>> line, sample = np.indices((20, 20)) * 5 + 3
    >>> with TemporaryDirectory() as folder:
    ...     glt = write_cube(
    ...         f"{folder}/glt", np.stack([sample, line], -1), data_type=3, transform=Affine(5, 0, 10, 0, -5, 60))
    ...     table = open_lookup_table(glt, (100, 100))
    ...     table.crs, table.to_pixel([[40.0, 20.0]], where="").round(6).tolist()
    (None, [[30.0, 40.0]])

    Raises
    ------
    InputError : no two bands of whole numbers on a map grid, or pixels that the image does not have; another size than
        the image, fewer than two bands, or no pixel with a place.
    """
    raster = open_raster(table) if isinstance(table, Path | str) else table
    values = np.nan_to_num(raster.some_pixels()) if raster.dtype.kind == "f" and raster.transform is not None else 0.5
    if is_table := raster.dtype.kind in "iu" or not np.any((values % 1.0 > 0.0) | (values > max(shape))):
        raster = _places_of_cells(raster, shape)
    refuse(raster.size[:2] != shape or raster.bands < 2, "place.size", raster.path, size=raster.size, shape=shape)
    places = LocationTable(raster, None)
    x, y = places._coarse[0].data.T
    within = np.all(np.abs([x, y]).max(axis=1) <= (180.0, 90.0)) and (places._area or 0.0) < 1e-3  # 3 km wide
    named = raster.crs is not None and raster.crs.is_geographic
    crs = CRS.from_epsg(4326) if within and not is_table and not named else raster.crs
    return LocationTable(raster, crs, float(x[0]) if crs is not None and crs.is_geographic else None)


def _places_of_cells(table: Raster, shape: tuple[int, int]) -> Raster:
    """The places of the pixels of an image: the mean of those cells of a GLT that name a pixel.

    Cells that were filled from their neighbours count where no others name it.

    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import write_cube
    >>> line, sample = np.indices((20, 20)) + 1
    >>> at = Affine(2, 0, 500, 0, -2, 900)
    >>> with TemporaryDirectory() as folder:
    ...     for kind in (3, 4):  # whole numbers, and floats as some producers write them
    ...         glt = write_cube(f"{folder}/glt", np.stack([sample, line], -1), data_type=kind, transform=at)
    ...         open_lookup_table(glt, (20, 20)).to_pixel([[480.0, 890.0]], where="", beyond=True).round(6).tolist()
    [[-10.0, 5.0]]
    [[-10.0, 5.0]]
    """
    where, names = str(table.path), table.description.band_names
    refuse(table.bands != 2, "place.table", where, bands=table.bands, dtype=table.dtype)
    transform, fill = needed(table.transform, "place.no_map", where), table.description.no_data()
    swapped = len(names) == 2 and "line" in names[0].lower() and "sample" in names[1].lower()
    total = np.zeros((3, math.prod(shape)))  # weights, and the coordinates times these
    greatest = np.zeros(2, np.int64)
    for first in range(0, table.lines, _BLOCK):
        stored = np.nan_to_num(table.read_bands(first, min(_BLOCK, table.lines - first))).astype(np.int64)
        stored[stored == fill] = 0
        sample, line = stored[::-1] if swapped else stored
        if np.any((sample == 0) != (line == 0)) or np.any((sample < 0) != (line < 0)):
            raise refusal("place.signs", where, first=first, last=first + len(sample) - 1)
        rows, columns = np.nonzero(sample)
        lines, samples = pixels = np.abs([line[rows, columns], sample[rows, columns]])
        greatest = np.maximum(greatest, pixels.max(axis=1, initial=0))
        refuse(np.any(greatest > shape), "place.beyond", where, greatest=greatest, shape=shape)
        weight = np.where(sample[rows, columns] > 0, 1.0, _FILLED)
        x, y = transform @ np.array([columns + 0.5, first + rows + 0.5])
        for part, values in zip(total, (weight, weight * x, weight * y), strict=True):
            np.add.at(part, (lines - 1) * shape[1] + samples - 1, values)
    refuse(not greatest.any(), "place.empty", where)
    with np.errstate(invalid="ignore"):
        places = (total[1:] / total[0]).reshape(2, *shape)
    piece = arrays.BandArrays((arrays.Term("places"),), "bls", places.shape, places.dtype)
    store = arrays.ArrayFile(table.path, arrays.at_hand, "places", places)
    about = Description("lookup table", entries=table.description.entries)
    return arrays.array_raster(store, (piece,), about, (None, table.crs))


# Parts of names that tell the files of one line apart, such as ang20160217t083024_rdn_v1n2_img and ..._rdn_glt.
_KINDS = re.compile(
    r"^(img|dat|rdn|rad|pol|ref|rfl|refl|radiance|reflectance|ort|raw|data|corr|glt|igm|loc|obs|l[0-4][a-d]?|v[0-9]\w*)$"
)


COMPANIONS = "glt", "igm", "loc", "obs"


def companion_file(image: Path, kind: str) -> Path | None:
    """The file of a kind of :data:`COMPANIONS` beside an image, by the names that producers give; None else.

    Their names are the same but for the words that say what a file is; of several that fit, the one that has the
    image's own such words (``x_rad_glt`` for ``x_rad``), and none where that leaves two.
    """
    stem, kinds = _name(image)
    others = (p for p in image.parent.iterdir() if p != image and p.is_file())
    fits = [p for p in others if kind in _name(p)[1] and _name(p)[0] == stem]
    if len(fits) > 1:
        fits = [p for p in fits if kinds <= _name(p)[1]]
    return fits[0] if len(fits) == 1 else None


def _name(path: Path) -> tuple[tuple[str, ...], set[str]]:
    """The words of a file's name that name the line, and those that say what the file is."""
    words = re.split(r"[_.\-]", path.name.lower())
    return tuple(w for w in words if w and not _KINDS.match(w)), {w for w in words if _KINDS.match(w)}


def table_of(raster: Raster) -> tuple[LocationTable | None, tuple[str, ...]]:
    """What places the pixels of an image without a map position, and notes: its own table, or one beside it."""
    shape = raster.size[:2]
    if raster.transform is not None:
        return None, ()
    if (inner := table_in(raster)) is not None:
        return open_lookup_table(inner, shape), ()
    for kind in COMPANIONS[:3] if isinstance(raster, EnviRaster) else ():
        path = companion_file(raster.path, kind)
        if path is None:
            continue
        try:
            table = open_lookup_table(path, shape)
        except HypervalError as error:
            return None, (f"warning: {path.name} lies beside the cube and is ignored: {error.what}",)
        return table, (f"{path.name} lies beside the cube and places its pixels",)
    return None, ()


def image_record(raster: Raster) -> list[tuple[str, str, str]]:
    """What is known of an image: property, value, and the source of the value, or how to state it.

    The sources are those of the reader: a file and line of a header, an entry of a product, a convention, a guess.

    >>> import xarray as xr
    >>> from hyperval.imagery.arrays import labelled_array
    >>> packed = {"units": "percent", "scale_factor": 0.1, "_FillValue": -9}
    >>> nm = {"wavelength": ("b", [500.0, 600.0], {"units": "nm"})}
    >>> array = xr.DataArray(np.ones((1, 1, 2), "i2"), nm, ("y", "x", "b"), "reflectance", packed)
    >>> record = {what: (value, origin) for what, value, origin in image_record(labelled_array(array))}
    >>> record["scale of reflectance"], record["no data"][0]
    (('x 0.1; x 0.01', "array 'reflectance': as it is packed; array 'reflectance': unit percent"), '-9')
    >>> from hyperval.imagery.description import Description
    >>> of_map = Description("ENVI", None, entries={"class names": "none, lawn, lot"})
    >>> [row[:2] for row in image_record(Raster(Path("map"), 1, 1, 1, np.dtype("u1"), description=of_map))][3:5]
    [('quantity', 'classes: none, lawn, lot'), ('no data', 'none')]
    """
    about, where, files = raster.description, str(raster.path), ", ".join(p.name for p in raster.other_files)
    product, header = about.product or raster.kind, about.header
    rows: list[tuple[str, str, str]] = []
    notes = list(about.notes)

    def origin(*keys: str) -> str:
        stated = [key for key in keys if header is not None and key in header.entries]
        return f"{header.where(stated[0])} '{stated[0]}'" if header is not None and stated else product

    def row(what: str, value: str | None, stated: str = product, lacking: str = "") -> None:
        rows.append((what, value, stated) if value is not None else (what, "not known", lacking))

    lines, samples, bands = raster.size
    row("is", product, "its first bytes" + (f", and {files} beside it" if files else ""))
    row("size", f"{lines} lines, {samples} samples, {bands} bands of {raster.dtype}", origin("samples"))
    try:
        (axis, _, more), listed = about.band_table(None, where, sort_bands=True), needed(about.listed(), "bands.none")
        centre, width = axis.centre_nm, axis.fwhm_nm
        stated = listed.where.get("wavelength", product)
        row("wavelengths", f"{len(centre)}, {centre[0]:g} to {centre[-1]:g} nm", stated)
        listed_nm = listed.wavelength[np.isfinite(listed.wavelength)]
        _, unit, guessed = wavelengths_in_nm(listed_nm, listed.unit, None, where)
        row("wavelength unit", unit, "guess: by the values" if guessed else stated)
        by_width = "convention: the spacing of the bands" if listed.fwhm is None else origin("fwhm")
        row("widths", f"{_span(width)} nm", by_width)
        notes += more
    except HypervalError as error:
        row("wavelengths", f"not known: {error.what}", error.mend or str(error.expected))
    names = about.entries.get("class names")  # of a map, whose numbers are no measurement
    row("quantity", about.quantity or (names and f"classes: {names}"), lacking="state quantity: (init: --quantity)")
    if about.quantity != "reflectance" and names is None:
        key, written = about.unit_in_entries()
        known_unit = about.unit if is_radiance(about.unit) else None
        by_init = product if known_unit else f"{origin(key)}: init takes it; a campaign states unit:"
        row("unit of radiance", known_unit or written, by_init, "state unit: (init: --unit)")
    for quantity in [about.quantity] if about.quantity else ["radiance", "reflectance"] if names is None else []:
        try:
            stages = [*about.scales(quantity), Scale(*about.packing, f"{product}: as it is packed")]
            if quantity == "reflectance":
                stages.append(Scale(reflectance_factor(about.unit or "fraction"), 0.0, f"{product}: unit {about.unit}"))
            stages = [stage for stage in stages if stage.changes]
            value = "; ".join(f"x {_span(s.gain)}" + f", + {_span(s.offset)}" * bool(np.any(s.offset)) for s in stages)
            none = "nothing states another; state scale: where the numbers are scaled"
            row(f"scale of {quantity}", value or "x 1", "; ".join(stage.source for stage in stages) or none)
        except HypervalError as error:
            row(f"scale of {quantity}", f"not known: {error.what}", error.mend or "")
    ignore, a = about.no_data(), raster.transform
    ignore = about.ignored if ignore is None else ignore
    row("no data", "none" if ignore is None else f"{ignore:g}",
        "nothing states one" if ignore is None else origin("data ignore value"))  # fmt: skip
    try:
        places, more = table_of(raster)
    except HypervalError as error:
        places, more = None, (f"warning: what should place its pixels cannot be used: {error.what}",)
    notes += more
    if places is not None:
        what, path = places.raster.description.product or "coordinates", places.raster.path
        row("position", f"of every pixel, by its {what}", product if path == raster.path else path.name)
        row("coordinate system", str(places.crs or "not known"), product if path == raster.path else path.name)
    elif a is None:
        row("position", "none", "targets.pixel_size_m states the size of a pixel; cube.glt places them")
        if (area := pixel_area_m2(None, None, about.entries)) is not None:
            row("pixel", f"{math.sqrt(area):.4g} m", origin("pixel size"))
    else:
        place = f"x = {a.c:.10g}, y = {a.f:.10g} at the corner; steps {_steps(a)}"
        row("position", place, origin("map info"))
        row("coordinate system", str(raster.crs or "not known"), origin("coordinate system string", "map info"))
    if acquired := about.entries.get("acquisition time"):
        row("acquisition time", acquired, origin("acquisition time"))
    if (sun := sun_zenith_deg(raster)) is not None:
        row("zenith angle of the sun", f"{sun[0]:.4g} deg", sun[1])
    return rows + [("assumed", note, "reader") for note in notes]


def _span(values: npt.ArrayLike) -> str:
    least, most = np.min(values), np.max(values)
    return f"{least:g}" if least == most else f"{least:g} to {most:g}"


def _steps(a: Affine) -> str:
    """Steps of a pixel along sample and line on the map, and how far they are turned counter-clockwise.

    >>> _steps(Affine.scale(2.0, -2.0)), _steps(Affine.rotation(75.0) @ Affine.scale(1.1, -1.1))
    ('2, -2', '1.1, -1.1, turned by 75 degrees')
    """
    if not (a.b or a.d):
        return f"{a.a:g}, {a.e:g}"
    width, height = math.hypot(a.a, a.d), math.copysign(math.hypot(a.b, a.e), a.determinant)
    return f"{width:g}, {height:g}, turned by {math.degrees(math.atan2(a.d, a.a)):.6g} degrees"


def sun_zenith_deg(raster: Raster) -> tuple[float, str] | None:
    """Median zenith angle of the sun [degrees] as a product states it, or the observation file (OBS) beside a cube.

    Also the name of the file.  None where there is none of the cube's size, or none of its bands is called so.
    """
    stated = raster.description.sun_zenith_deg
    if stated is not None:
        return stated, (*raster.other_files, raster.path)[0].name
    path = companion_file(raster.path, COMPANIONS[3])
    if path is None:
        return None
    with suppress(HypervalError):
        angles = open_raster(path)
        bands = [i for i, name in enumerate(angles.description.band_names) if _SUN_ZENITH.search(name)]
        if len(bands) == 1 and angles.size[:2] == raster.size[:2]:
            lines = [angles.read_some_bands(int(n), 1, bands).ravel() for n in some_lines(angles.lines, SAMPLED_LINES)]
            zenith = median_angle(np.concatenate(lines).astype(float))
            return None if zenith is None else (zenith, path.name)
    return None
