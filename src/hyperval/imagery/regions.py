"""Regions of interest: named masks on the grid of a cube, read from files, drawn, or made of other regions.

Files are ENVI regions (XML of 5.x, ASCII export, classic binary), GeoJSON, CSV lists and class rasters; GeoPackage,
Shapefile and KML by the extra ``vector``.

Continuous pixel coordinates are (sample, line) with the upper left corner of the first pixel at (0, 0), so its centre
is at (0.5, 0.5).  A polygon holds a pixel when it holds its centre.
"""

from __future__ import annotations

import json
import re
import struct
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import partial
from itertools import chain, combinations
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import shapely
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError
from rasterio.features import rasterize
from rasterio.warp import transform as reproject
from scipy import ndimage
from shapely.geometry import shape as shape_of
from shapely.geometry.base import BaseGeometry

from hyperval.data import Array, Mask, equals
from hyperval.envi_header import DATA_SUFFIXES, header_beside
from hyperval.errors import WARNING, HypervalError, InputError, needed, reader, refusal, refuse
from hyperval.imagery import arrays
from hyperval.imagery.cube import HDF5, MATRICES, TIFF, Cube, kind_of, open_raster
from hyperval.imagery.description import Raster, crs_of_wkt
from hyperval.imagery.placing import MAX_VERTICES, LocationTable, table_of
from hyperval.paths import checked_file, head_of, read_table, read_text, read_xml
from hyperval.storage import decoded, number_of

_EDGE = 1e-6  # [pixel] rounding allowed to a vertex on the border of the image
_OFF_GRID = 0.25  # [pixel] that a raster may lie off the image; half of one puts a pixel on another
FARTHEST = 1e9  # [pixel] from the image: no drawing, but numbers in another unit
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
    kinds, kind = (*_POINTS, *_AREAS), stated.get("type") if isinstance(stated, dict) else "of WKB"
    try:
        if kind in (*kinds, "of WKB"):
            made = shape_of(stated) if isinstance(stated, dict) else shapely.from_wkb(stated, on_invalid="fix")
            kind = made.geom_type
    except Exception as error:  # whatever damage makes of it
        what = f"geometry {kind!r} cannot be interpreted ({str(error)[:60]})"
        raise refusal("region.geometry", where, what=what) from error
    refuse(kind not in kinds, "region.geometry", where, what=f"geometry {kind!r} has no area")
    xy = shapely.get_coordinates(made)
    refuse(not np.all(np.isfinite(xy)), "region.not_finite", where)
    refuse(len(xy) > MAX_VERTICES, "region.vertices", where, count=f"more than {MAX_VERTICES}")
    lacks = "place" if not len(xy) else "area" if kind in _AREAS and made.convex_hull.area == 0.0 else ""
    refuse(lacks, "region.geometry", where, what=f"geometry {kind!r} has no {lacks}")
    return shapely.force_2d(made)


def polygon_mask(exterior: npt.ArrayLike, shape: tuple[int, int], *, where: str, touched: bool = False) -> Mask:
    """(lines, samples) mask of the pixels whose centre lies in a polygon.

    Parameters
    ----------
    exterior : (n, 2) vertices (sample, line) in continuous pixel coordinates, n >= 3
    shape : (lines, samples) of the image
    where : what stands in messages
    touched : take every pixel that the polygon touches, for targets smaller than a pixel

    Raises
    ------
    InputError : fewer than three vertices, not finite, or a vertex outside the image.
    """
    polygon = geometry_of({"type": "Polygon", "coordinates": [np.asarray(exterior, float).tolist()]}, where)
    if not inside_image(vertices := shapely.get_coordinates(polygon), shape).all():
        raise outside_error(vertices, shape, where)
    return _burned([polygon], shape, touched=touched)


def _burned(polygons: Sequence[BaseGeometry], shape: tuple[int, int], *, touched: bool = False) -> Mask:
    """(lines, samples) mask of the pixels whose centre lies in polygons, or which these touch."""
    if not polygons:
        return np.zeros(shape, bool)
    return np.asarray(rasterize(polygons, out_shape=shape, fill=0, dtype="uint8", all_touched=touched), bool)


def point_mask(points: npt.ArrayLike, shape: tuple[int, int]) -> Mask:
    """(lines, samples) mask of the pixels that hold points (sample, line) of the image in continuous coordinates."""
    xy = np.asarray(points, float).reshape(-1, 2)
    col, row = np.clip(np.floor(xy).astype(int), 0, np.array(shape[::-1]) - 1).T
    mask = np.zeros(shape, bool)
    mask[row, col] = True
    return mask


Position = Affine | LocationTable | None


def map_to_pixel(points: npt.ArrayLike, transform: Position, *, where: str, beyond: bool = False) -> Array:
    """(n, 2) continuous pixel coordinates (sample, line) of map coordinates (x, y), some ``beyond`` the image."""
    if transform is None:
        raise refusal("region.no_position", where)
    xy = np.asarray(points, dtype=float).reshape(-1, 2)
    if not isinstance(transform, Affine):
        return transform.to_pixel(xy, where=where, beyond=beyond)
    return np.column_stack(~transform @ xy.T)


def reprojected(xy: Array, source: CRS, target: CRS | None, where: str) -> Array:
    """(n, 2) map coordinates in ``target`` of points in ``source`` (longitude first)."""
    target = needed(target, "region.no_system", where)
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

    def place(self, geometry: BaseGeometry, stated: CRS | None, where: str) -> BaseGeometry:
        """A geometry of a file in a stated system, in continuous pixel coordinates.

        Lines below 0 are those of a GIS, which shows an image without a place upside down: the first from 0 to -1.

        >>> drawn = geometry_of({"type": "MultiPoint", "coordinates": [[1.5, 0.0], [1.5, -2.5]]}, "a drawing of QGIS")
        >>> ImageGrid((9, 9), coordinates="pixel").place(drawn, None, "a drawing of QGIS").wkt
        'MULTIPOINT ((1.5 0), (1.5 2.5))'

        Raises
        ------
        InputError : the file states another system than ``coordinates``, or it cannot be placed.
        """
        means, crs = self.coordinates, self.crs
        if means == "map" and stated is not None and crs is not None and stated != crs:
            raise refusal("region.other_system", where, stated=stated, told=f"the cube in {crs}")
        if means == "lonlat" and stated is not None and not stated.is_geographic:
            raise refusal("region.other_system", where, stated=stated, told="not in longitude and latitude")
        if means == "pixel":
            return shapely.transform(geometry, lambda xy: xy * (1.0, -1.0)) if geometry.bounds[3] <= 0.0 else geometry
        if means is None and stated is None:  # degrees are assumed
            xy = shapely.get_coordinates(geometry)
            for x, y in xy[np.any(np.abs(xy) > (180.0, 90.0), axis=1)]:
                raise refusal("geojson.degrees", where, x=x, y=y)
        if means != "map":
            system = stated or CRS.from_epsg(4326)
            geometry = shapely.transform(geometry, lambda xy: reprojected(xy, system, crs, where))
        if self.transform is not None and not isinstance(self.transform, Affine):
            geometry = self.transform.divided(geometry, where)
        of_area = geometry.area > 0.0  # of which a part may lie beyond the image
        return shapely.transform(geometry, lambda xy: map_to_pixel(xy, self.transform, where=where, beyond=of_area))


def raster_of_size(path: Path, image: Cube | ImageGrid, variable: str | None = None) -> Raster:
    """Open a raster that lies on an image, pixel on pixel.

    ``variable`` : which map of a MATLAB or NumPy file, where it holds several

    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import open_lookup_table, write_cube
    >>> at, xy = Affine(1, 0, 500, 0, -1, 900), np.meshgrid(np.arange(500.5, 508), np.arange(899.5, 891, -1))
    >>> with TemporaryDirectory() as folder:
    ...     table = open_lookup_table(write_cube(f"{folder}/igm", np.stack(xy, -1), data_type=5), (9, 8))
    ...     of, maps = np.ones((9, 8, 1)), [Path(f"{folder}/{moved}") for moved in (0, 7)]
    ...     for path in maps:
    ...         write_cube(path, of, data_type=1, transform=at @ Affine.translation(int(path.name), 0)).name
    ...     raster_of_size(maps[0], ImageGrid((9, 8), table)).size
    ...     with suppress(InputError):
    ...         raster_of_size(maps[1], ImageGrid((9, 8), table)).size
    ...     shown = write_cube(Path(f"{folder}/gis"), of, data_type=1, transform=Affine.scale(1.0, -1.0))
    ...     raster_of_size(shown, ImageGrid((9, 8), table)).size
    '0'
    '7'
    (9, 8, 1)
    (9, 8, 1)

    Raises
    ------
    InputError : one of another size, or one that says that it lies elsewhere.
    """
    path, shape, position, crs = checked_file(path, what="image file"), image.shape, image.transform, image.crs
    kind = kind_of(path)
    raster: Raster | None = None
    if kind in MATRICES:
        # It may hold an image of three axes alone, or what a header describes.
        with suppress(*([InputError] if kind == HDF5 or header_beside(path) is not None else [])):
            raster = arrays.open_matrix(path, str(kind), variable, shape)
    raster = raster or open_raster(path)
    if raster.transform is not None and isinstance(image, Cube) and (table := table_of(image.raster)[0]) is not None:
        position, crs = table, table.crs
    in_pixels = raster.crs is None and raster.transform == Affine.scale(1.0, -1.0)  # as a GIS shows what has no place
    on_map = None not in (raster.transform, position) and not in_pixels and (raster.crs is None) == (crs is None)
    raw = on_map and not isinstance(position, Affine)
    facts = {"name": path.name, "lines": raster.lines, "samples": raster.samples, "shape": shape, "own": raster.crs}
    refuse(raster.size[:2] != shape, "image.on_map" if raw else "image.size", path, **facts)
    off = _pixels_off(raster, position, crs) if on_map else 0.0
    refuse(off > _OFF_GRID, "image.on_map" if raw else "image.elsewhere", path, off=off, crs=crs, **facts)
    return raster


def _pixels_off(raster: Raster, transform: Position, crs: CRS | None) -> float:
    """How many pixels of an image of its size a corner of a raster lies at most off that of the image.

    >>> at, utm, size = Affine(2.0, 0.0, 5e5, 0.0, -2.0, 4e6), CRS.from_epsg(32618), (60, 60, 1, np.dtype("u1"))
    >>> moved = [Raster(Path(), *size, transform=at @ Affine.translation(0, n), crs=utm) for n in (0.0, -10.0)]
    >>> [_pixels_off(raster, at, utm) for raster in moved], _pixels_off(moved[0], at, CRS.from_epsg(32719)) > 1e5
    ([0.0, 10.0], True)
    """
    corners = np.array([(x, y) for x in (0.0, raster.samples) for y in (0.0, raster.lines)])
    xy = np.column_stack(needed(raster.transform, "region.no_position") @ corners.T)
    xy = xy if raster.crs is None else reprojected(xy, raster.crs, crs, str(raster.path))
    return float(np.abs(map_to_pixel(xy, transform, where=str(raster.path), beyond=True) - corners).max())


def named_crs(name: str, where: str) -> CRS:
    """The coordinate system of a name; InputError for one that is not known."""
    try:
        return CRS.from_user_input(name)
    except (CRSError, ValueError):
        raise refusal("region.system", where, name=name) from None


def inside_image(xy: Array, shape: tuple[int, int]) -> Mask:
    """(n,) which of (n, 2) points (sample, line) lie in the image, to a millionth of a pixel."""
    return np.asarray(np.all((xy >= -_EDGE) & (xy <= np.array(shape[::-1]) + _EDGE), axis=-1))


def outside_error(
    xy: Array, shape: tuple[int, int], where: str, what: str = "the region", mend: str = _CHECK
) -> HypervalError:
    """The error for points (n, 2) that the image does not hold."""
    return refusal("region.outside", where, what=what, low=xy.min(axis=0), high=xy.max(axis=0), shape=shape, mend=mend)


def _checked_part(part: Part, shape: tuple[int, int], where: str) -> Part:
    """A part of a region of an image (lines, samples); pixels (line, sample) as their places among all of the image.

    Of a geometry that leaves the image only the numbers are looked at.
    """
    if isinstance(part, BaseGeometry):
        xy = shapely.get_coordinates(part)
        if not np.abs(xy).max() <= FARTHEST:
            raise outside_error(xy, shape, where)
    elif isinstance(part, np.ndarray) and part.ndim == 2:
        lines, samples = part.T
        out = np.flatnonzero((lines < 0) | (lines >= shape[0]) | (samples < 0) | (samples >= shape[1]))
        if out.size:
            raise refusal("region.pixels", where, out=out, all=lines, first=part[out[0]], last=np.subtract(shape, 1))
        return np.asarray(lines * shape[1] + samples)
    return part


def _drawn(name: str, parts: Iterable[Part], shape: tuple[int, int], path: Path, *, touched: bool) -> Region:
    """The region of the pixels whose centres its parts hold, and what is to be said of it.

    ``touched`` : of all pixels that its polygons touch.  What leaves the image (lines, samples) is cut off and counted.
    """
    where = f"{path}: region {name!r}"
    parts = [_checked_part(part, shape, where) for part in parts]
    drawings = [p for p in parts if isinstance(p, BaseGeometry)]
    polygons = [p for p in drawings if p.geom_type in _AREAS]
    points = shapely.get_coordinates([p for p in drawings if p.geom_type in _POINTS])
    in_image = inside_image(points, shape)
    mask = _burned(polygons, shape) | point_mask(points[in_image], shape)
    mask.flat[np.concatenate([*(p for p in parts if isinstance(p, np.ndarray)), np.zeros(0, np.int64)])] = True
    outside = [p for p in polygons if not inside_image(shapely.get_coordinates(p), shape).all()]
    if (outside or not in_image.all()) and not mask.any():
        raise outside_error(np.vstack([shapely.get_coordinates(outside), points]), shape, where)
    notes, pixels = [p for p in parts if isinstance(p, str)], int(mask.sum())
    part = _share_outside(polygons, shape) if outside else 0.0  # to the millionth of a pixel of the border
    if part > 0.0:
        percent = f"{100.0 * part:.1f} %" if part >= 0.001 else "less than 0.1 %"
        sign = "" if part < _SMALL else WARNING
        notes.append(f"{sign}leaves the image: {percent} of its area is outside, {pixels} pixels are left")
    if not in_image.all():
        gone = f"{np.sum(~in_image)} of {in_image.size} points are outside"
        notes.append(f"{WARNING}leaves the image: {gone}, {pixels} pixels are left")
    for stated in (p for p in parts if isinstance(p, int) and p != pixels):
        notes.append(f"has {stated} pixels as its file says; {pixels} have their centre inside")
    return Region(name, mask | _burned(polygons, shape, touched=True) if touched else mask, str(path), tuple(notes))


def _share_outside(polygons: Sequence[BaseGeometry], shape: tuple[int, int]) -> float:
    """Part of the area of polygons that an image (lines, samples) does not hold.

    Each is its exterior less its holes; where sides cross, the parts that are enclosed an odd number of times.
    """
    drawn = shapely.make_valid(polygons)
    inside = shapely.intersection(drawn, shapely.box(0, 0, shape[1], shape[0]))
    area = float(np.sum(shapely.area(drawn)))
    return 1.0 - float(np.sum(shapely.area(inside))) / area if area > 0.0 else 0.0


# A geometry in pixel coordinates, (n, 2) numbers of pixels (line, sample) from 0, (n,) their places among all of the
# image, how many pixels the region has as its file says, or what else is to be said of it.
Part: TypeAlias = BaseGeometry | npt.NDArray[Any] | int | str
Drawn = Iterator[tuple[str, Iterable[Part]]]  # what a file draws: a name and the parts, placed when they are asked for
Feature = tuple[Any, Mapping[str, Any], str]  # geometry of GeoJSON or WKB, attributes, name where none of them gives it
MAX_XML_BYTES = 8 << 20
MAX_BINARY_BYTES = 64 << 20
MAX_BYTES = 256 << 20
MAX_FEATURES = 100_000
MAX_CLASSES = 1000
_NO_NAME = re.compile(r"(band|b)?[ _-]?[0-9]+$|(red|green|blue|alpha)$", re.IGNORECASE)  # of a band that is a mask
# What programs call the pixels of no class.
_NO_CLASS = re.compile(
    r"un[ck]?la[sb]|un(def|known|assign|spec|ident|used)|no[nt]?[ _-]?(data|class|label|value|assign)"
    r"|back ?ground|bg\b|hintergrund|(no(n|ne|t|thing)?|mask(ed)?|ignored?|fill([ _-]?value)?|null|void|nan|0|)$",
    re.IGNORECASE,
)
_COLUMNS = {("row0", "col0"): 0, ("line", "sample"): 0, ("row1", "col1"): 1}
REGION_COLUMNS = ("region", "name", "class", "class_name", "material", "label")  # the fourth is what ENVI writes
_SIDECARS = (".dbf", ".shx", ".prj", ".cpg")


def xml_regions(path: Path, grid: ImageGrid) -> Drawn:
    """Regions of an ENVI 5 ROI file.

    ``CoordSysStr`` "none" means continuous pixel coordinates, a WKT means map coordinates, which
    are projected to the cube's system where it differs.

    Raises
    ------
    InputError : larger than 8 MiB, with a DOCTYPE or ENTITY, not such a file, or a region that cannot be placed.
    """
    root = read_xml(path, MAX_XML_BYTES)
    refuse(root.tag != "RegionsOfInterest", "roi.root", path, tag=root.tag)
    for number, region in enumerate(root.iter("Region"), start=1):
        name = region.get("name") or str(number)
        where, definitions = f"{path}: region {name!r}", list(region.iter("GeometryDef"))
        refuse(not definitions, "roi.no_geometry", where)
        yield name, _xml_parts(definitions, grid, where)


def _xml_parts(definitions: list[ElementTree.Element], grid: ImageGrid, where: str) -> Iterator[BaseGeometry]:
    """The polygons and points of definitions, each of which states its coordinate system, in pixel coordinates."""
    for definition in definitions:
        system = " ".join((definition.findtext("CoordSysStr") or "none").split())
        in_pixels = system.lower() == "none"
        source = None if in_pixels else crs_of_wkt(system)
        refuse(source is None and not in_pixels, "region.system", where, name=system[:60])
        grid = replace(grid, coordinates="pixel" if in_pixels else None)
        for child in (child for child in definition if child.tag != "CoordSysStr"):
            made: list[dict[str, Any]] = [] if child.tag in _AREAS else [{"type": child.tag}]
            if child.tag in _POINTS:
                made = [{"type": "MultiPoint", "coordinates": _xml_pairs(child, where)}]
            for polygon in child.iter("Polygon"):
                outer, inner = polygon.findall("Exterior/LinearRing"), polygon.findall("Interior/LinearRing")
                refuse(len(outer) != 1, "roi.rings", where, count=len(outer))
                made.append({"type": "Polygon", "coordinates": [_xml_pairs(r, where) for r in (*outer, *inner)]})
            yield from (grid.place(geometry_of(one, where), source, where) for one in made)


def _xml_pairs(element: ElementTree.Element, where: str) -> Array:
    text = " ".join(part.text or "" for part in element.iter("Coordinates"))
    values = np.array([number_of(v) for v in text.split()])
    refuse(np.isnan(values).any(), "roi.coordinates", where)
    refuse(values.size == 0 or values.size % 2, "roi.pairs", where, count=values.size)
    return values.reshape(-1, 2)


def ascii_regions(path: Path, grid: ImageGrid) -> Drawn:
    """Regions of an ENVI "Output of ROIs" text file, whose pixel numbers X, Y start at 1.

    Raises
    ------
    InputError : the file was made for an image of another size, or its counts do not add up.
    """
    comments: dict[str, list[tuple[str, str]]] = {}  # what the comments say, by key, with its place
    rows: list[tuple[int, int]] = []
    columns = (1, 2)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        where, text = f"{path}:{number}", line.strip("; \t\r\0")
        titles = text.lower().split()
        if text and not line.strip().startswith(";"):
            refuse(len(titles) <= max(columns), "roi.columns", where, count=len(titles))
            rows.append((_whole_number(titles[columns[1]], where) - 1, _whole_number(titles[columns[0]], where) - 1))
        elif ":" in text:
            key, _, value = text.partition(":")
            comments.setdefault(key.strip().lower(), []).append((value.strip(), where))
        elif {"x", "y"} <= set(titles):
            columns = titles.index("x"), titles.index("y")
        else:
            refuse(re.search(r"(?i)\b(map\s?[xy]|lat|lon)\b", text), "roi.no_pixels", where, text=text[:60])
    refuse("file dimension" not in comments, "roi.no_dimension", path)
    for value, where in comments["file dimension"]:
        made_for = needed(re.fullmatch(r"([0-9]+)\s*x\s*([0-9]+)", value), "roi.dimension", where, value=value)
        size = int(made_for[2]), int(made_for[1])
        refuse(size != grid.shape, "roi.size", where, size=size, shape=grid.shape)
    names = [name for name, _ in comments.get("roi name", [])]
    counts = [_whole_number(*count) for count in comments.get("roi npts", [])]
    announced = [_whole_number(*count) for count in comments.get("number of rois", [(str(len(names)), "")])][-1]
    if len(names) != len(counts) or announced != len(names) or sum(counts) != len(rows):
        raise refusal("roi.counts", path, said=announced, names=len(names), points=sum(counts), rows=len(rows))
    parts = np.split(np.array(rows, np.int64).reshape(-1, 2), np.cumsum(counts[:-1], dtype=int))
    yield from ((name, [part]) for name, part in zip(names, parts, strict=False))


def binary_regions(path: Path, grid: ImageGrid) -> Drawn:
    """Regions of a classic ENVI ``.roi`` file (big-endian; pixel addresses and polygons from 0).

    Raises
    ------
    InputError : larger than 64 MiB, cut short, made for an image of another size, or with polylines.
    """
    raw, start, shape = checked_file(path, what="region file", most=MAX_BINARY_BYTES).read_bytes(), 4, grid.shape

    def words(count: int, kind: str = "i") -> tuple[int, ...]:
        nonlocal start
        refuse(count < 0 or start + 4 * count > len(raw), "roi.short", path)
        start += 4 * count
        return struct.unpack_from(f">{count}{kind}", raw, start - 4 * count)

    for _ in range(words(1)[0]):
        length = words(2)[1]
        refuse(not 0 <= length <= 4096 or start + length > len(raw), "roi.name", path)
        name = raw[start : start + length].split(b"\0")[0].decode("latin-1").strip()
        start += -(-length // 4) * 4
        table, where = words(45), f"{path}: region {name!r}"
        refuse(table[1::-1] != shape, "roi.size", where, size=table[1::-1], shape=shape)
        refuse(table[43], "roi.polylines", where)
        parts: list[Part] = []
        if table[44]:
            words(1)
            parts.append(np.column_stack(np.divmod(np.array(words(table[3]), np.int64), shape[1])))
        elif table[3] > 0:
            parts.append(table[3])
        for _ in range(table[42]):
            vertices = words(2)[0]
            ring = list(zip(words(vertices, "f"), words(vertices, "f"), strict=True))
            parts.append(geometry_of({"type": "Polygon", "coordinates": [ring]}, where))
        yield name, parts


def _whole_number(text: str, where: str) -> int:
    refuse(not re.fullmatch(r"[0-9]{1,12}", text.strip()), "roi.whole", where, text=text[:40])
    return int(text)


def csv_regions(path: Path, grid: ImageGrid) -> Drawn:
    """Regions of a CSV pixel list.

    Columns ``row0,col0`` or ``line,sample`` (0-based) or ``row1,col1`` (1-based), and ``region``,
    ``name`` or ``class`` where the file holds more than one region; ``grid.name_field`` names another column.
    """
    fields, rows = read_table(path, {*REGION_COLUMNS, *(name for p in _COLUMNS for name in p)})
    pair = next((p for p in _COLUMNS if set(p) <= set(fields)), None)
    pair = needed(pair, "region.columns", f"{path}:1", columns=", ".join(fields) or "none")
    column = grid.name_field or next((c for c in REGION_COLUMNS if c in fields), None)
    refuse(column not in (None, *fields), "region.property", f"{path}:1", name=column, known=", ".join(fields))
    pixels: dict[str, list[list[int]]] = {}
    for number, row in rows:
        wrong = not all(re.fullmatch(r"[+-]?[0-9]{1,12}", row[key]) for key in pair)
        refuse(wrong, "region.row", f"{path}:{number}", pair=pair, first=row[pair[0]], second=row[pair[1]])
        name = row[column] if column else path.stem
        refuse(not name, "region.no_name", f"{path}:{number}", column=column)
        pixels.setdefault(name, []).append([int(row[key]) - _COLUMNS[pair] for key in pair])
    yield from ((name, [np.array(listed, np.int64)]) for name, listed in pixels.items())


def raster_regions(path: Path, grid: ImageGrid) -> Drawn:
    """The classes of a raster of one band, or the bands of a raster of several; of the array ``grid.name_field``.

    One band: a class for every whole number but the ignore value, -1 beside others, and 0 where no class has that name,
    under the class name of the header, else under the file's name (a single class) or ``name-value``.  Several bands:
    what is not 0, nor NaN, nor the ignore value, under the band name; without names each holds one value beside 0.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/gt.npy", [[-1, -1, 1], [2, 0, 1]])
    ...     drawn = list(raster_regions(Path(folder) / "gt.npy", ImageGrid((2, 3))))
    >>> [(name, parts[0].size) for name, parts in drawn]
    [('gt-1', 2), ('gt-2', 1)]
    """
    raster = raster_of_size(path, grid, grid.name_field)
    stored, about = raster.read_bands(0, raster.lines), raster.description
    ignore = about.no_data()
    valid = np.isfinite(stored) if ignore is None else np.isfinite(stored) & ~equals(stored, ignore)
    if raster.bands > 1:
        names, masks = about.band_names, (stored != 0) & valid
        names = names if len(set(names)) == raster.bands else tuple(f"band-{i + 1}" for i in range(raster.bands))
        if all(map(_NO_NAME.match, names)):
            several = any(np.unique(band[mask]).size > 1 for band, mask in zip(stored, masks, strict=True))
            refuse(several, "region.colours", path, bands=raster.bands, name=path.name)
        yield from ((name, [np.flatnonzero(mask)]) for name, mask in zip(names, masks, strict=True))
        return
    values = np.unique(stored[valid])
    refuse(np.any(values != np.round(values)) or values.size > MAX_CLASSES, "region.classes", path, most=MAX_CLASSES)
    listed = [name.strip() for name in about.entries.get("class names", "").rstrip(", \n").split(",")]
    classes = about.header.number("classes") if about.header is not None and listed != [""] else None
    facts = {"count": len(listed), "classes": classes, "names": ", ".join(listed)}
    refuse(classes not in (None, len(listed)), "region.class_names", path, **facts)
    numbers, is_named = _classes(values, listed), 0 in values and not _NO_CLASS.match(listed[0])
    taken = "a class as the others" if 0 in numbers else "taken as of no class: the map has higher numbers than names"
    note = [f"is of a map whose class 0, {listed[0]!r}, is {taken}"] if is_named else []
    for value in numbers:
        # ENVI writes "Name [Red] 67 points" for a class image made from regions.
        name = listed[value] if 0 <= value < len(listed) else ""
        name = re.sub(r"\s{0,9}\[[^\]]{0,99}\]\s{0,9}[0-9]{1,12} points$", "", name)
        name = name or (path.stem if len(numbers) == 1 else f"{path.stem}-{value}")
        yield name, [np.flatnonzero(stored[0] == value), *note]


def _classes(values: Array, names: Sequence[str]) -> list[int]:
    """The numbers of a map that are classes: 0 where a class bears that name, and the names reach to the highest; -1
    where nothing is above 0, beside which it is what has no label.

    >>> each = [""], ["Grass", "Soil", "Roof"], ["Unlabelled", "Soil", "Roof"], ["Grass", "Soil"]
    >>> [_classes(np.array([0.0, 1.0, 2.0]), names) for names in each]
    [[1, 2], [0, 1, 2], [1, 2], [1, 2]]
    """
    has_0 = not _NO_CLASS.match(names[0]) and values.max(initial=0) < len(names)
    return [int(v) for v in values if (v != 0 or has_0) and (v != -1 or values.max() <= 0)]


def geojson_regions(path: Path, grid: ImageGrid) -> Drawn:
    """The polygons and points of a GeoJSON file.

    Where neither the file nor ``grid`` says otherwise they are longitude and latitude on WGS 84, as RFC 7946
    has it.
    """
    data = json.loads(read_text(path), object_pairs_hook=partial(_once, path))
    kind = data.get("type") if isinstance(data, dict) else None
    items = data.get("features") if kind == "FeatureCollection" else [data]
    refuse(kind is None or not isinstance(items, list), "geojson.object", path)
    name = _within(data, "crs", "properties", "name")
    stated = named_crs(name, str(path)) if isinstance(name, str) else None
    assumed = grid.coordinates is None and stated is None
    refuse(assumed and grid.transform is None, "geojson.no_position", path)
    features = []
    for number, feature in enumerate(items, start=1):
        geometry = _within(feature, "geometry") if _within(feature, "type") == "Feature" else feature
        number_of, properties = _within(feature, "id"), _within(feature, "properties")
        fallback = str(number_of) if number_of is not None else path.stem if len(items) == 1 else str(number)
        features.append((geometry, properties if isinstance(properties, dict) else {}, fallback))
    return _named(features, stated, grid, f"{path}: ")


def _within(data: Any, *keys: str) -> Any:
    """What stands under keys in objects within each other, None where one is no object."""
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data


def _named(features: Iterable[Feature], stated: CRS | None, grid: ImageGrid, where: str) -> Drawn:
    """Features under the names that an attribute gives them, else their own; those without geometry are left out.

    >>> half = {"type": "Polygon", "coordinates": [[[0, 0], [2, 0], [2, 2], [0, 0]]]}
    >>> grid = ImageGrid((3, 3), coordinates="pixel")
    >>> drawn = _named([(None, {}, "a"), (half, {}, "b")], None, grid, "")
    >>> [(name, list(parts)[1:]) for name, parts in drawn]
    [('b', ['warning: is of a file of 2 features, of which 1 have no geometry'])]
    """
    columns = REGION_COLUMNS if grid.name_field is None else (grid.name_field.lower(),)
    listed = list(features)
    lacking = sum(geometry is None for geometry, *_ in listed)
    note = [f"{WARNING}is of a file of {len(listed)} features, of which {lacking} have no geometry"] * bool(lacking)
    for number, (geometry, properties, fallback) in enumerate(listed, start=1):
        place = f"{where}feature {number}"
        if geometry is None and lacking < len(listed):
            continue
        lower = {str(key).lower(): value for key, value in properties.items()}
        if grid.name_field is not None and columns[0] not in lower:
            raise refusal("region.property", place, name=grid.name_field, known=", ".join(properties) or "none")
        named = next((lower[c] for c in columns if lower.get(c) is not None), None)
        name = ("" if named is None or named != named else str(named).strip()) or fallback
        yield name, _placed(geometry, stated, grid, f"{place} ({name})", note)
        note = []


def _placed(geometry: Any, stated: CRS | None, grid: ImageGrid, where: str, note: list[str]) -> Iterator[Part]:
    yield from (grid.place(geometry_of(geometry, where), stated, where), *note)


def _once(path: Path, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out, keys = dict(pairs), [key for key, _ in pairs]
    refuse(len(out) < len(pairs), "geojson.twice", path, key=max(keys, key=keys.count, default=""))
    return out


def is_kml(words: str) -> bool:
    """True for the first words of a KML file."""
    return re.search(r"<\s*(\w+:)?kml[\s>]", words) is not None


def vector_regions(path: Path, grid: ImageGrid) -> Drawn:
    """The polygons and points of every layer of a file that GDAL reads.

    A name comes from the attribute ``name_field``, or else from the first of ``REGION_COLUMNS``;
    a layer without attributes of text gives its own.  The file's coordinate system places them; where it has none,
    ``coordinates`` must say "pixel", "map" or "lonlat".

    Raises
    ------
    InputError : too large, not readable, lines instead of areas, or another coordinate system than stated.
    UsageError : the extra ``vector`` is not installed, nobody says what the coordinates are, or which of several
        attributes names the regions.
    """
    try:
        import pyogrio
    except ImportError:
        raise refusal("vector.package", path) from None
    _check_files(path)
    with warnings.catch_warnings(action="ignore"):
        for layer in [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]:
            where = f"{path}: layer {layer!r}"
            count = pyogrio.read_info(path, layer=layer, force_feature_count=True)["features"]
            refuse(count > MAX_FEATURES, "vector.features", path, count=count, most=MAX_FEATURES)
            meta, _, shapes, columns = pyogrio.raw.read(path, layer=layer, force_2d=True)
            crs = named_crs(meta["crs"], where) if meta["crs"] else None
            refuse(crs is None and grid.coordinates is None, "vector.no_system", where)
            if crs is not None and grid.coordinates == "pixel":
                raise refusal("region.other_system", where, stated=crs, told="not in pixel coordinates")
            fields = [str(f) for f in meta["fields"]]
            texts = any(np.asarray(values).dtype.kind == "O" for values in columns)
            nameless = grid.name_field is None and not {f.lower() for f in fields} & {*REGION_COLUMNS}
            refuse(nameless and texts and len(shapes) > 1, "vector.attribute", where, known=", ".join(fields))
            rows = [dict(zip(fields, row, strict=True)) for row in zip(*columns, strict=True)] or [{}] * len(shapes)
            names = [layer] if len(shapes) == 1 else [f"{layer}-{i + 1}" for i in range(len(shapes))]
            features = zip(shapes, rows, names, strict=True)
            yield from _named(features, crs, grid, f"{where}, ")


def _check_files(path: Path) -> None:
    files = [path]
    if is_kml(decoded(head_of(path))) and re.search(r"(?i)<!\s*(DOCTYPE|ENTITY)", read_text(path, MAX_BYTES)):
        raise refusal("vector.entity", path)
    if path.suffix.lower() == ".shp":
        parts = {p.suffix.lower(): p for p in path.parent.iterdir() if p.stem == path.stem}
        for end in (".dbf", ".shx"):
            refuse(end not in parts, "vector.part", path, end=end)
        files += [checked_file(parts[end], what="region file") for end in _SIDECARS if end in parts]
    refuse(sum(f.stat().st_size for f in files) > MAX_BYTES, "vector.large", path, mib=MAX_BYTES >> 20)


def _reader_of(path: Path) -> Callable[[Path, ImageGrid], Drawn]:
    """What reads a file of regions, whose format is known from its content; UsageError for one that is not known."""
    words, ending = decoded(head_of(path)).lstrip("\ufeff \t\r\n"), path.suffix.lower()
    is_image = ending in DATA_SUFFIXES and header_beside(path) is not None  # whatever letters its first pixels are
    for fits, regions in (
        (is_image or kind_of(path) in (TIFF, *MATRICES), raster_regions),
        (words.startswith("<") and not is_kml(words), xml_regions),
        ("ENVI Output of ROIs" in words[:200], ascii_regions),
        (words.startswith("JoeB"), binary_regions),
        (words.startswith(("SQLite format 3\0", "\x00\x00\x27\x0a")) or is_kml(words), vector_regions),
        (words.startswith("{"), geojson_regions),
    ):
        if fits:
            return regions
    if ending == ".hdr" or header_beside(path) is not None:
        return raster_regions
    refuse(ending not in (".csv", ".txt"), "region.format", path)
    return csv_regions


@dataclass(frozen=True, eq=False)
class Region:
    """A named set of pixels.

    Attributes
    ----------
    name : as in the file, or as the campaign calls it
    mask : (lines, samples) True inside
    source : file, or "inline"
    notes : what was found in drawing it, such as a part outside the image, to stand after its name
    """

    name: str
    mask: Mask
    source: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        refuse(self.mask.dtype != bool or self.mask.ndim != 2, "region.mask", name=self.name)
        refuse(not self.mask.any(), "region.empty", self.source, name=self.name)

    @property
    def n(self) -> int:
        """Number of pixels."""
        return int(self.mask.sum())

    @property
    def remarks(self) -> list[str]:
        """The notes as sentences with the name of the region."""
        said = f"the region {self.name!r} "
        return [WARNING * note.startswith(WARNING) + said + note.removeprefix(WARNING) for note in self.notes]


@reader
def read_regions(
    path: Path | str,
    cube_shape: tuple[int, int],
    *,
    transform: Position = None,
    crs: CRS | None = None,
    coordinates: str | None = None,
    patterns: Sequence[str] = (),
    touched: bool = False,
    name_field: str | None = None,
) -> dict[str, Region]:
    """Read the regions of a file, whatever its format.

    The format is known from the content: ENVI ROI XML, ENVI ROI ASCII export (also gzipped), classic
    binary ENVI ROI, GeoJSON, GeoPackage, Shapefile and KML (with the extra ``vector``), CSV pixel list, ENVI or
    GeoTIFF class raster.

    Parameters
    ----------
    cube_shape : (lines, samples) of the cube that the regions belong to
    transform, crs : position of the cube, for regions in map coordinates: an affine transform, or a geographic
        lookup table
    coordinates : "pixel", "map" (the cube's own system) or "lonlat", for GeoJSON (which is "lonlat" otherwise), and
        for a GeoPackage or Shapefile without a coordinate system
    patterns : where names of the file match one of them (* and ? stand for any characters), only those are read;
        a region that is not wanted may then lie outside the image
    touched : take every pixel that a polygon touches, for targets smaller than a pixel
    name_field : attribute of a vector file that names the regions

    >>> from tempfile import TemporaryDirectory
    >>> features = [
    ...     {"type": "Feature", "id": kind, "geometry": {"type": kind, "coordinates": at}}
    ...     for kind, at in (("Point", [3, 3]), ("LineString", [[1, 1], [2, 2]]))]
    >>> collection = {"type": "FeatureCollection", "features": features}
    >>> texts = "region,line,sample\\nPoint,1,1\\nb,50,50\\n", json.dumps(collection)
    >>> with TemporaryDirectory() as folder:
    ...     for name, text in zip(("a.csv", "a.json"), texts):
    ...         _ = Path(path := f"{folder}/{name}").write_text(text)
    ...         list(read_regions(path, (9, 9), patterns=["Point"], coordinates="pixel"))
    ['Point']
    ['Point']
    >>> with TemporaryDirectory() as folder:
    ...     _ = Path(path := f"{folder}/a.json").write_text(json.dumps(collection))
    ...     read_regions(path, (9, 9))
    Traceback (most recent call last):
    hyperval.errors.UsageError: ...init --targets takes a list of pixels (region,line,sample)

    Raises
    ------
    InputError : missing, unreadable, empty, wholly outside the image, or made for an image of another size.
    UsageError : unknown format, or ``coordinates`` not stated.
    """
    path, drawn = checked_file(path, what="region file"), dict[str, list[Iterable[Part]]]()
    regions = _reader_of(path)
    for name, parts in regions(path, ImageGrid(cube_shape, transform, crs, coordinates, name_field)):
        twice = name in drawn and regions not in (geojson_regions, vector_regions)  # whose features may share a name
        refuse(twice, "roi.twice", f"{path}: region {name!r}", name=name)
        drawn.setdefault(name, []).append(parts)
    refuse(not drawn, "region.none", path)
    wanted = {n: made for n, made in drawn.items() if any(n == p or fnmatchcase(n, p) for p in patterns)} or drawn
    return {name: _drawn(name, chain(*parts), cube_shape, path, touched=touched) for name, parts in wanted.items()}


def rectangle_region(name: str, lines: tuple[int, int], samples: tuple[int, int], shape: tuple[int, int]) -> Region:
    """Region of the pixels from the first to the last line and sample, 0-based, both included."""
    (top, bottom), (first, last) = lines, samples
    if not (0 <= top <= bottom < shape[0] and 0 <= first <= last < shape[1]):
        raise refusal("region.rectangle", f"region {name!r}", lines=lines, samples=samples, last=np.subtract(shape, 1))
    mask = np.zeros(shape, bool)
    mask[top : bottom + 1, first : last + 1] = True
    return Region(name, mask, "inline")


def half_region(name: str, region: Region, *, first: bool) -> Region:
    """The half of a region with the lower line numbers, or the other; by samples where it is wider than long.

    The cut lies where half of the pixels are on either side, up to those of one line.
    """
    lines, samples = np.nonzero(region.mask)
    along = lines if np.ptp(lines) >= np.ptp(samples) else samples
    mask = region.mask.copy()
    mask[lines, samples] = (along < np.sort(along)[along.size // 2]) == first
    refuse(not mask.any(), "region.half", f"region {name!r}", of=region.name)
    return Region(name, mask, f"half of {region.name}")


def ring_region(
    name: str, region: Region, inner: float, outer: float, pixel: tuple[float, float] = (1.0, 1.0)
) -> Region:
    """The pixels whose centres lie more than ``inner`` and at most ``outer`` from the nearest of a region.

    ``pixel`` : distance between lines and between samples, in the unit of the other two
    """
    mask = _ring_of(region.mask, inner, outer, pixel)
    refuse(not mask.any(), "region.ring", f"region {name!r}", of=region.name)
    return Region(name, mask, f"ring around {region.name}")


def _ring_of(mask: Mask, inner: float, outer: float, pixel: tuple[float, float] = (1.0, 1.0)) -> Mask:
    """The pixels at a distance above ``inner`` and at most ``outer`` from a mask, which is not empty."""
    out = np.zeros(mask.shape, bool)
    above, beside = (int(min(outer / step, max(mask.shape))) + 1 for step in pixel)
    part = window_of(mask, (above, beside))
    distance = ndimage.distance_transform_edt(~mask[part], sampling=pixel)  # of all pixels: 16 bytes for each
    out[part] = (distance > inner) & (distance <= outer)
    return out


def window_of(mask: Mask, margin: tuple[int, int] = (0, 0)) -> tuple[slice, slice]:
    """Lines and samples of the bounding box of a mask, with a margin."""
    held = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    ends = zip(held, margin, strict=True)
    lines, samples = (slice(max(int(places[0]) - more, 0), int(places[-1]) + more + 1) for places, more in ends)
    return lines, samples


def overlaps(regions: Iterable[Region]) -> list[tuple[str, str, int]]:
    """Pairs of regions that share pixels, with the number of shared pixels."""
    pairs = ((a.name, b.name, int(np.count_nonzero(a.mask & b.mask))) for a, b in combinations(regions, 2))
    return [pair for pair in pairs if pair[2]]


def holes(mask: Mask) -> tuple[int, int]:
    """Number of holes in a mask, and their pixels: groups (of 4 neighbours) that it encloses."""
    if not mask.any() or mask[window := window_of(mask)].all():  # labels of a whole image take 4 bytes a pixel
        return 0, 0
    labels, count = ndimage.label(~np.pad(mask[window], 1))
    return int(count) - 1, int(np.count_nonzero(labels > 1))  # the first label is that of the surroundings


def objects(mask: Mask) -> tuple[npt.NDArray[np.int32], int]:
    """Connected groups of pixels (8 neighbours): labels (lines, samples), 0 outside, and their number."""
    labels, count = ndimage.label(mask, np.ones((3, 3)))
    return labels, int(count)


def groups_by_size(mask: Mask) -> tuple[list[Mask], str]:
    """The masks of the groups of touching pixels of a mask, the largest first, and what they are in words.

    A single group of several pixels is cut into its halves; none where the mask holds more than half of the image.
    """
    if mask.mean() > 0.5:
        return [], f"the map marks {mask.mean():.0%} of the image: no objects before a background"
    labels, count = objects(mask)
    if count == 1 and mask.sum() > 1:
        one = Region("object", mask, "map")
        return [half_region("half", one, first=first).mask for first in (True, False)], "2 halves of one group"
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return [labels == 1 + i for i in np.argsort(-sizes, kind="stable")], f"{count} touching groups"


def connected_patches(mask: Mask, name: str, *, whole: bool = False) -> Iterator[tuple[str, tuple[slice, slice], Mask]]:
    """Name, window and mask within it of each group of touching pixels (8 neighbours), of all where ``whole``.

    A number stands after the name where there are several, lines first.
    """
    labels, count = (mask.astype(np.int32), 1) if whole else objects(mask)
    for number, window in enumerate(ndimage.find_objects(labels), start=1):
        yield name if count == 1 else f"{name} {number}", window, labels[window] == number


def guard(mask: Mask, radius_pixels: float) -> Mask:
    """The mask grown by a disc: every pixel whose centre is within the radius of a centre in the mask."""
    refuse(not radius_pixels >= 0, "region.guard", radius=radius_pixels)
    return _ring_of(mask, -1.0, radius_pixels) if mask.any() else mask.copy()
