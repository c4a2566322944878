"""Regions of interest: named masks on the grid of a cube, from any of the usual files.

ENVI regions (XML of 5.x, ASCII export, classic binary), GeoJSON, CSV lists, class rasters; GeoPackage, Shapefile and
KML by the extra ``vector``.  Each reader hands on drawings by name.
"""

from __future__ import annotations

import json
import re
import struct
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
from rasterio.crs import CRS
from scipy import ndimage
from skimage.measure import label

from hyperval.envi_header import header_beside
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.arrays import MATRICES
from hyperval.imagery.description import crs_of_wkt, equals
from hyperval.imagery.drawing import WARNING, ImageGrid, Placing, Position, RegionDrawing, named_crs
from hyperval.imagery.rasters import raster_of_size
from hyperval.imagery.tiff import TIFF_MARKS, TIFF_SUFFIXES
from hyperval.paths import checked_file, head_of, read_table, read_text, read_xml

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Drawings = dict[str, RegionDrawing]
MAX_XML_BYTES = 8 << 20
MAX_BINARY_BYTES = 64 << 20
MAX_BYTES = 256 << 20
MAX_FEATURES = 100_000
MAX_CLASSES = 1000
_MAX_DIGITS = 300  # more are no float
_COLUMNS = {("row0", "col0"): 0, ("line", "sample"): 0, ("row1", "col1"): 1}
REGION_COLUMNS = ("region", "name", "class", "class_name")  # the last is what ENVI writes
_SIDECARS = (".dbf", ".shx", ".prj", ".cpg")
_STATE = "state coordinates: pixel, map (the cube's own system) or lonlat"


def xml_drawings(path: Path, grid: ImageGrid) -> Drawings:
    """Drawings by name of an ENVI 5 ROI file.

    ``CoordSysStr`` "none" means continuous pixel coordinates, a WKT means map coordinates, which
    are projected to the cube's system where it differs.

    Raises
    ------
    InputError : larger than 8 MiB, with a DOCTYPE or ENTITY, not such a file, or a region that cannot be placed.
    """
    root = read_xml(path, MAX_XML_BYTES)
    if root.tag != "RegionsOfInterest":
        raise InputError(f"the root element is {root.tag!r}", where=str(path), expected="RegionsOfInterest")
    drawings: Drawings = {}
    for number, region in enumerate(root.iter("Region"), start=1):
        name = region.get("name") or str(number)
        where = f"{path}: region {name!r}"
        drawing = _new(drawings, name, grid.shape, where)
        definitions = list(region.iter("GeometryDef"))
        if not definitions:
            raise InputError(
                "a region without geometry",
                where=where,
                expected="polygons or points; a threshold is not evaluated here",
                mend="turn it into pixels before it is exported, or take it out of the file",
            )
        for definition in definitions:
            place = _in_system(" ".join((definition.findtext("CoordSysStr") or "none").split()), grid, where)
            for child in definition:
                for geometry in _xml_geometries(child, where):
                    drawing.add(geometry, place, where)
    return drawings


def _in_system(system: str, grid: ImageGrid, where: str) -> Placing:
    """How coordinates in a system of a region file come to pixels."""
    if system.lower() == "none":
        return lambda points, where, ring: points
    source = crs_of_wkt(system)
    if source is None:
        raise InputError(f"unknown coordinate system {system[:60]!r}", where=where)
    return replace(grid, coordinates=None).placing(source, where)


def _xml_geometries(element: ElementTree.Element, where: str) -> Iterator[dict[str, Any]]:
    """The polygons or points of an element of ENVI's, as GeoJSON has them."""
    if element.tag in ("Point", "MultiPoint"):
        yield {"type": "MultiPoint", "coordinates": _xml_pairs(element, where)}
    elif element.tag in ("Polygon", "MultiPolygon"):
        for polygon in element.iter("Polygon"):
            outer, inner = polygon.findall("Exterior/LinearRing"), polygon.findall("Interior/LinearRing")
            if len(outer) != 1:
                raise InputError(f"a polygon with {len(outer)} exterior rings", where=where)
            yield {"type": "Polygon", "coordinates": [_xml_pairs(ring, where) for ring in (*outer, *inner)]}
    elif element.tag != "CoordSysStr":
        yield {"type": element.tag}


def _xml_pairs(element: ElementTree.Element, where: str) -> Array:
    text = " ".join(part.text or "" for part in element.iter("Coordinates"))
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        raise InputError("coordinates that are no numbers", where=where) from None
    if values.size == 0 or values.size % 2:
        raise InputError(f"{values.size} coordinates", where=where, expected="pairs x y")
    return values.reshape(-1, 2)


def ascii_drawings(path: Path, shape: tuple[int, int]) -> Drawings:
    """Drawings by name of an ENVI "Output of ROIs" text file, whose pixel numbers X, Y start at 1.

    Raises
    ------
    InputError : the file was made for an image of another size, or its counts do not add up.
    """
    names: list[str] = []
    counts: list[int] = []
    rows: list[tuple[int, int]] = []
    made_for = announced = None
    columns = (1, 2)
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        where = f"{path}:{number}"
        text, comment = line.strip("; \t\r\0"), line.strip().startswith(";")
        if not text:
            continue
        if not comment:
            parts = text.split()
            if len(parts) <= max(columns):
                raise InputError(f"{len(parts)} columns", where=where, expected="ID X Y ...")
            rows.append((_whole(parts[columns[1]], where) - 1, _whole(parts[columns[0]], where) - 1))
            continue
        key, _, value = (part.strip() for part in text.partition(":"))
        titles = text.lower().split()
        if key.lower() == "file dimension":
            made_for = _dimension(value, shape, where)
        elif key.lower() == "number of rois":
            announced = _whole(value, where)
        elif key.lower() == "roi name":
            names.append(value)
        elif key.lower() == "roi npts":
            counts.append(_whole(value, where))
        elif not value and {"x", "y"} <= set(titles):
            columns = titles.index("x"), titles.index("y")
        elif not value and re.search(r"(?i)\b(map\s?[xy]|lat|lon)\b", text):
            raise InputError(
                f"no pixel numbers among the columns: {text[:60]!r}",
                where=where,
                expected="ID X Y ...",
                mend="export it again with the pixel location (X, Y)",
            )
    if made_for is None:
        raise InputError("no 'File Dimension' line", where=str(path))
    if len(names) != len(counts) or announced not in (None, len(names)) or sum(counts) != len(rows):
        raise InputError(
            f"{announced} regions announced, {len(names)} named with {sum(counts)} points; {len(rows)} follow",
            where=str(path),
            mend="the file is cut short or was edited: export it again",
        )
    if len(set(names)) < len(names):
        raise InputError("two regions have the same name", where=str(path))
    starts = np.cumsum([0, *counts])
    return _pixel_drawings({name: rows[starts[i] : starts[i + 1]] for i, name in enumerate(names)}, shape, path)


def _dimension(value: str, shape: tuple[int, int], where: str) -> str:
    """The size that a region file was made for, which has to be that of the cube."""
    sizes = re.fullmatch(r"([0-9]+)\s*x\s*([0-9]+)", value)
    if sizes is None:
        raise InputError(f"file dimension {value!r}", where=where, expected="samples x lines")
    if (int(sizes[2]), int(sizes[1])) != shape:
        raise InputError(
            f"the regions were made for {sizes[2]} lines x {sizes[1]} samples",
            where=where,
            expected=f"{shape[0]} lines x {shape[1]} samples, as the cube",
        )
    return value


def _pixel_drawings(pixels: Mapping[str, Sequence[tuple[int, int]]], shape: tuple[int, int], path: Path) -> Drawings:
    """Drawings of pixels (line, sample) from 0 by name."""
    drawings: Drawings = {}
    for name, listed in pixels.items():
        lines, samples = np.array(listed, dtype=np.int64).reshape(-1, 2).T
        where = f"{path}: region {name!r}"
        _new(drawings, name, shape, where).add_pixels(lines, samples, where=where)
    return drawings


def _new(drawings: Drawings, name: str, shape: tuple[int, int], where: str) -> RegionDrawing:
    """A drawing under a name that none has yet."""
    if name in drawings:
        raise InputError("the name stands twice", where=where)
    drawings[name] = RegionDrawing(shape)
    return drawings[name]


def binary_drawings(path: Path, shape: tuple[int, int]) -> Drawings:
    """Drawings by name of a classic ENVI ``.roi`` file (big-endian; pixel addresses and polygons from 0).

    Raises
    ------
    InputError : larger than 64 MiB, cut short, made for an image of another size, or with polylines.
    """
    raw, at = checked_file(path, what="region file", most=MAX_BINARY_BYTES).read_bytes(), 4

    def words(count: int, kind: str = "i") -> tuple[int, ...]:
        nonlocal at
        if count < 0 or at + 4 * count > len(raw):
            raise InputError("the region file is cut short", where=str(path))
        at += 4 * count
        return struct.unpack_from(f">{count}{kind}", raw, at - 4 * count)

    drawings: Drawings = {}
    for _ in range(words(1)[0]):
        length = words(2)[1]
        if not 0 <= length <= 4096 or at + length > len(raw):
            raise InputError("a region name of impossible length", where=str(path))
        name = raw[at : at + length].split(b"\0")[0].decode("latin-1").strip()
        at += -(-length // 4) * 4
        table, where = words(45), f"{path}: region {name!r}"
        if (table[1], table[0]) != shape:
            raise InputError(f"made for {table[1]} lines x {table[0]} samples", where=where, expected=f"{shape}")
        if table[43]:
            raise InputError("polylines have no area", where=where)
        drawing = _new(drawings, name, shape, where)
        if table[44]:
            words(1)
            addresses = np.array(words(table[3]), dtype=np.int64)
            drawing.add_pixels(addresses // shape[1], addresses % shape[1], where=where)
        elif table[3] > 0:
            drawing.stated_pixels = table[3]
        for _ in range(table[42]):
            vertices = words(2)[0]
            drawing.add_polygon(np.column_stack([words(vertices, "f"), words(vertices, "f")]), where=where)
    return drawings


def _whole(text: str, where: str) -> int:
    if not re.fullmatch(r"[0-9]{1,12}", text.strip()):
        raise InputError(f"{text[:40]!r} is not a whole number", where=where)
    return int(text)


def csv_drawings(path: Path, shape: tuple[int, int]) -> Drawings:
    """Drawings by name of a CSV pixel list.

    Columns ``row0,col0`` or ``line,sample`` (0-based) or ``row1,col1`` (1-based), and ``region``,
    ``name`` or ``class`` where the file holds more than one region.
    """
    fields, rows = read_table(path, {*REGION_COLUMNS, *(name for p in _COLUMNS for name in p)})
    pair = next((p for p in _COLUMNS if set(p) <= set(fields)), None)
    if pair is None:
        raise InputError(
            f"columns {', '.join(fields) or 'none'}",
            where=f"{path}:1",
            expected="row0,col0 or line,sample (0-based) or row1,col1 (1-based)",
        )
    column = next((c for c in REGION_COLUMNS if c in fields), None)
    pixels: dict[str, list[tuple[int, int]]] = {}
    for number, row in rows:
        if not all(re.fullmatch(r"[+-]?[0-9]{1,12}", row[key]) for key in pair):
            raise InputError(
                f"no whole numbers in {pair[0]}, {pair[1]}: {row[pair[0]]!r}, {row[pair[1]]!r}",
                where=f"{path}:{number}",
            )
        name = row[column] if column else path.stem
        if not name:
            raise InputError(f"no name in column {column!r}", where=f"{path}:{number}")
        pixels.setdefault(name, []).append((int(row[pair[0]]) - _COLUMNS[pair], int(row[pair[1]]) - _COLUMNS[pair]))
    return _pixel_drawings(pixels, shape, path)


def raster_masks(
    path: Path,
    shape: tuple[int, int],
    *,
    by_value: bool = False,
    root: Path | None = None,
    variable: str | None = None,
) -> dict[str | int, Mask]:
    """Masks of the classes of a raster of one band, or of the bands of a raster of several.

    One band: a class for every whole number but 0 and the ignore value, under the class name of the
    header, else under the file's name (a single class) or ``name-value``; under the number itself with
    ``by_value``.  Several bands: a mask of what is not 0, nor NaN, nor the ignore value, under the band name.
    """
    raster = raster_of_size(path, shape, root, variable)
    stored, about = raster.read_lines(0, raster.lines), raster.description
    ignore = about.no_data()
    valid = np.isfinite(stored) if ignore is None else np.isfinite(stored) & ~equals(stored, ignore)
    if raster.bands > 1:
        names = about.band_names
        if not names or len(set(names)) != len(names):
            names = tuple(f"band-{i + 1}" for i in range(raster.bands))
        return {name: (stored[:, :, i] != 0) & valid[:, :, i] for i, name in enumerate(names)}
    classes = stored[:, :, 0]
    values = np.unique(classes[valid[:, :, 0]])
    if np.any(values != np.round(values)) or values.size > MAX_CLASSES:
        raise InputError("values that are no class numbers", where=str(path), expected=f"up to {MAX_CLASSES} classes")
    numbers = [int(v) for v in values if v != 0]
    if by_value:
        return {value: classes == value for value in numbers}
    listed = [name.strip() for name in about.entries.get("class names", "").split(",")]
    out: dict[str | int, Mask] = {}
    for value in numbers:
        # ENVI writes "Name [Red] 67 points" for a class image made from regions.
        name = listed[value] if 0 < value < len(listed) else ""
        name = re.sub(r"\s{0,9}\[[^\]]{0,99}\]\s{0,9}[0-9]{1,12} points$", "", name)
        name = name or (path.stem if len(numbers) == 1 else f"{path.stem}-{value}")
        if name in out:
            raise InputError(f"two classes are called {name!r}", where=str(path), mend="read them by value (names:)")
        out[name] = classes == value
    return out


def geojson_drawings(path: Path, grid: ImageGrid) -> Drawings:
    """Drawings by name of the polygons and points of a GeoJSON file; features of one name are united.

    Where neither the file nor ``grid`` says otherwise they are longitude and latitude on WGS 84, as RFC 7946
    has it.
    """
    try:
        data = json.loads(read_text(path), object_pairs_hook=_once, parse_constant=_refuse, parse_int=_whole_number)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid GeoJSON: {error}", where=str(path)) from error
    kind = data.get("type") if isinstance(data, dict) else None
    items = data.get("features") if kind == "FeatureCollection" else [data]
    if kind is None or not isinstance(items, list):
        raise InputError("not a GeoJSON object", where=str(path))
    name = _within(data, "crs", "properties", "name")
    stated = named_crs(name, str(path)) if isinstance(name, str) else None
    assumed = grid.coordinates is None and stated is None
    if assumed and grid.transform is None:
        raise UsageError(
            "a GeoJSON file holds longitude and latitude (RFC 7946), and the cube has no position",
            where=str(path),
            mend=_STATE,
        )
    in_pixels = grid.placing(stated, str(path))

    def place(xy: Array, where: str, ring: bool) -> Array:
        if assumed and np.any(np.abs(xy) > (180.0, 90.0)):
            raise UsageError(
                f"{xy[0, 0]:.6g}, {xy[0, 1]:.6g} is no longitude and latitude, as GeoJSON holds (RFC 7946)",
                where=where,
                mend="state coordinates: pixel or map (the cube's own system)",
            )
        return in_pixels(xy, where, ring)

    drawings: Drawings = {}
    for number, feature in enumerate(items, start=1):
        geometry = _within(feature, "geometry") if _within(feature, "type") == "Feature" else feature
        if not isinstance(geometry, dict):
            raise InputError("a feature without geometry", where=f"{path}: feature {number}")
        properties, own = _within(feature, "properties"), _within(feature, "id")
        fallback = str(own) if own is not None else path.stem if len(items) == 1 else str(number)
        known = properties if isinstance(properties, dict) else {}
        name = _feature_name(known, grid.name_field, fallback, f"{path}: feature {number}")
        drawing = drawings.setdefault(name, RegionDrawing(grid.shape))
        drawing.add(geometry, place, f"{path}: feature {number} ({name})")
    return drawings


def _within(data: Any, *keys: str) -> Any:
    """What stands under keys in objects within each other, None where one is no object."""
    for key in keys:
        data = data.get(key) if isinstance(data, dict) else None
    return data


def _feature_name(properties: Mapping[str, Any], name_field: str | None, fallback: str, where: str) -> str:
    """Name of a feature: that of its attribute, else the fallback.

    Raises
    ------
    UsageError : the attribute that is to name it is not there.
    """
    lower = {str(key).lower(): value for key, value in properties.items()}
    columns = REGION_COLUMNS if name_field is None else (name_field.lower(),)
    named = next((lower[c] for c in columns if lower.get(c) is not None), None)
    if name_field is not None and named is None:
        raise UsageError(
            f"no property {name_field!r}", where=where, expected="one of " + (", ".join(properties) or "none")
        )
    text = "" if named is None or named != named else str(named).strip()
    return text or fallback


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        raise ValueError("a key stands twice in one object")
    return out


def _whole_number(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"a number of {len(text)} digits")
    return int(text)


def _refuse(text: str) -> Any:
    raise ValueError(f"{text} is no JSON number")


def is_vector(head: bytes) -> bool:
    """True for the first bytes of a GeoPackage (an SQLite file), a Shapefile or a KML file."""
    return head.startswith(b"SQLite format 3\0") or head[:4] == b"\x00\x00\x27\x0a" or is_kml(head)


def is_kml(head: bytes) -> bool:
    """True for the first bytes of a KML file."""
    return re.search(rb"<\s*(\w+:)?kml[\s>]", head) is not None


def vector_drawings(path: Path, grid: ImageGrid, root: Path | None = None) -> Drawings:
    """Drawings by name of the polygons and points of every layer; features of one name are united.

    A name comes from the attribute ``name_field``, or else from ``region``, ``name``, ``class`` or ``class_name``;
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
        from pyogrio.errors import DataLayerError, DataSourceError
    except ImportError:
        raise UsageError(
            "a GeoPackage, Shapefile or KML file needs the package pyogrio",
            where=str(path),
            mend="pip install hyperval[vector], or export the regions as GeoJSON",
        ) from None
    _check_files(path, root)
    drawings: Drawings = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
            for layer in layers:
                count = pyogrio.read_info(path, layer=layer, force_feature_count=True)["features"]
                if count > MAX_FEATURES:
                    raise InputError(f"{count} features", where=str(path), expected=f"at most {MAX_FEATURES}")
                meta, _, shapes, columns = pyogrio.raw.read(path, layer=layer, force_2d=True)
                fields = dict(zip((str(f) for f in meta["fields"]), columns, strict=True))
                _layer_drawings(drawings, f"{path}: layer {layer!r}", layer, meta["crs"], shapes, fields, grid)
    except (DataLayerError, DataSourceError) as error:
        raise InputError(f"cannot be read: {error}", where=str(path)) from error
    return drawings


def _layer_drawings(
    drawings: Drawings,
    where: str,
    layer: str,
    stated: str | None,
    shapes: Sequence[bytes | None],
    fields: Mapping[str, Any],
    grid: ImageGrid,
) -> None:
    """Add the features of a layer, whose attributes stand in columns."""
    own = named_crs(stated, where) if stated else None
    if own is None and grid.coordinates is None:
        raise UsageError("the file states no coordinate system", where=where, mend=_STATE)
    if own is not None and grid.coordinates == "pixel":
        raise InputError(f"the file is in {own}, not in pixel coordinates", where=where, mend="leave coordinates out")
    wanted = REGION_COLUMNS if grid.name_field is None else (grid.name_field.lower(),)
    texts = any(np.asarray(values).dtype.kind == "O" for values in fields.values())
    if not {f.lower() for f in fields} & set(wanted) and (grid.name_field or (len(shapes) > 1 and texts)):
        raise UsageError(
            f"no attribute {grid.name_field!r}" if grid.name_field else "no attribute that names the regions",
            where=where,
            expected="one of " + (", ".join(fields) or "none"),
            mend="state name_field: which of the attributes names them",
        )
    place = grid.placing(own, where)
    column = next((f for w in wanted for f in fields if f.lower() == w), None)
    for i, wkb in enumerate(shapes):
        fallback = layer if len(shapes) == 1 else f"{layer}-{i + 1}"
        known = {"name": fields[column][i]} if column is not None else {}
        name = _feature_name(known, None, fallback, where)
        at = f"{where}, feature {i + 1} ({name})"
        drawings.setdefault(name, RegionDrawing(grid.shape)).add(_wkb_geometry(wkb, at), place, at)


def _check_files(path: Path, root: Path | None) -> None:
    files = [path]
    if is_kml(head_of(path)) and re.search(rb"<!\s*(DOCTYPE|ENTITY)", path.read_bytes()[:MAX_BYTES], re.IGNORECASE):
        raise InputError("a DOCTYPE or ENTITY is not allowed in a region file", where=str(path))
    if path.suffix.lower() == ".shp":
        parts = {p.suffix.lower(): p for p in path.parent.glob(f"{path.stem}.*")}
        for end in (".dbf", ".shx"):
            if end not in parts:
                raise InputError(
                    f"the {end} file of the Shapefile is missing",
                    where=str(path),
                    expected="the files .shp, .shx, .dbf (and .prj) side by side",
                )
        files += [checked_file(parts[end], root=root, what="region file") for end in _SIDECARS if end in parts]
    if sum(f.stat().st_size for f in files) > MAX_BYTES:
        raise InputError(f"larger than {MAX_BYTES >> 20} MiB", where=str(path))


def _wkb_geometry(wkb: bytes | None, where: str) -> dict[str, Any]:
    """A geometry as GeoJSON has it."""
    if wkb is None:
        raise InputError("a feature without geometry", where=where)
    import shapely

    try:
        geometry = shapely.from_wkb(bytes(wkb), on_invalid="fix")  # a ring that is not closed is
    except shapely.errors.ShapelyError:
        geometry = None
    if geometry is None:
        raise InputError("a geometry that is not understood", where=where)
    if geometry.is_empty:
        raise InputError("an empty geometry", where=where, expected="polygons or points")
    return dict(shapely.geometry.mapping(geometry))


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
        if self.mask.dtype != bool or self.mask.ndim != 2:
            raise UsageError(f"region {self.name!r}: the mask is not a (lines, samples) array of booleans")
        if not self.mask.any():
            raise InputError(
                f"the region {self.name!r} holds no pixel",
                where=self.source,
                mend="a polygon holds a pixel by its centre; an empty region is taken out of its file",
            )

    @property
    def n(self) -> int:
        """Number of pixels."""
        return int(self.mask.sum())

    @property
    def remarks(self) -> list[str]:
        """The notes as sentences with the name of the region."""
        return [
            f"{WARNING * note.startswith(WARNING)}the region {self.name!r} {note.removeprefix(WARNING)}"
            for note in self.notes
        ]


@reader
def read_regions(
    path: Path | str,
    cube_shape: tuple[int, int],
    *,
    transform: Position = None,
    crs: CRS | None = None,
    names: Mapping[str | int, str] | Sequence[str] | None = None,
    coordinates: str | None = None,
    patterns: Sequence[str] = (),
    touched: bool = False,
    root: Path | None = None,
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
    names : the regions to read: a list of names in the file, or a mapping from name (or value of a
        class raster) in the file to the name wanted; None reads all
    coordinates : "pixel", "map" (the cube's own system) or "lonlat", for GeoJSON (which is "lonlat" otherwise), and
        for a GeoPackage or Shapefile without a coordinate system
    patterns : where names of the file match one of them (* and ? stand for any characters), only those are read;
        a region that is not wanted may then lie outside the image
    touched : take every pixel that a polygon touches, for targets smaller than a pixel
    root : folder that the file must lie in
    name_field : attribute of a vector file that names the regions

    Raises
    ------
    InputError : missing, unreadable, empty, wholly outside the image, or made for an image of another size.
    UsageError : unknown format, unknown names, or ``coordinates`` not stated.
    """
    path = checked_file(path, root=root, what="region file")
    head = head_of(path)
    stripped = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    grid = ImageGrid(cube_shape, transform, crs, coordinates, name_field)
    drawn: Mapping[Any, Mask | RegionDrawing]
    if path.suffix.lower() in TIFF_SUFFIXES or head[:4] in TIFF_MARKS:
        drawn = raster_masks(path, cube_shape, by_value=_by_value(names), root=root)
    elif stripped.startswith(b"<") and not is_kml(head):
        drawn = xml_drawings(path, grid)
    elif b"ENVI Output of ROIs" in head[:200]:
        drawn = ascii_drawings(path, cube_shape)
    elif head.startswith(b"JoeB"):
        drawn = binary_drawings(path, cube_shape)
    elif is_vector(head):
        drawn = vector_drawings(path, grid, root)
    elif stripped.startswith(b"{"):
        drawn = geojson_drawings(path, grid)
    elif path.suffix.lower() == ".hdr" or head.startswith(tuple(MATRICES)) or header_beside(path) is not None:
        drawn = raster_masks(path, cube_shape, by_value=_by_value(names), root=root, variable=name_field)
    elif path.suffix.lower() in (".csv", ".txt"):
        drawn = csv_drawings(path, cube_shape)
    else:
        raise UsageError(
            "the format of the region file is not known",
            where=str(path),
            expected="GeoJSON, GeoPackage, Shapefile, KML, ENVI ROI (XML, ASCII, binary), CSV list, class raster",
        )
    named = _named(drawn, names, str(path))
    wanted = {n: made for n, made in named.items() if any(n == p or fnmatchcase(n, p) for p in patterns)}
    named = wanted or named
    return {name: _region(name, made, str(path), touched) for name, made in named.items()}


def _region(name: str, made: Mask | RegionDrawing, source: str, touched: bool) -> Region:
    if not isinstance(made, RegionDrawing):
        return Region(name, made, source)
    made.check(f"{source}: region {name!r}")
    return Region(name, made.touched if touched else made.mask, source, made.notes())


def rectangle_region(name: str, lines: tuple[int, int], samples: tuple[int, int], shape: tuple[int, int]) -> Region:
    """Region of the pixels from the first to the last line and sample, 0-based, both included."""
    (top, bottom), (left, right) = lines, samples
    if not (0 <= top <= bottom < shape[0] and 0 <= left <= right < shape[1]):
        raise InputError(
            f"lines {top}-{bottom}, samples {left}-{right} are not in the image",
            where=f"region {name!r}",
            expected=f"lines 0-{shape[0] - 1}, samples 0-{shape[1] - 1}, first before last",
        )
    mask = np.zeros(shape, bool)
    mask[top : bottom + 1, left : right + 1] = True
    return Region(name, mask, "inline")


def half_region(name: str, region: Region, *, first: bool) -> Region:
    """The half of a region with the lower line numbers, or the other; by samples where it is wider than long.

    The cut lies where half of the pixels are on either side, up to those of one line.
    """
    lines, samples = np.nonzero(region.mask)
    along = lines if np.ptp(lines) >= np.ptp(samples) else samples
    before = along < np.sort(along)[along.size // 2]
    chosen = before if first else ~before
    if not chosen.any():
        raise InputError(f"the region {region.name!r} is too small to be halved", where=f"region {name!r}")
    mask = np.zeros(region.mask.shape, bool)
    mask[lines[chosen], samples[chosen]] = True
    return Region(name, mask, f"half of {region.name}")


def ring_region(
    name: str, region: Region, inner: float, outer: float, pixel: tuple[float, float] = (1.0, 1.0)
) -> Region:
    """The pixels whose centres lie more than ``inner`` and at most ``outer`` from the nearest of a region.

    ``pixel`` : distance between lines and between samples, in the unit of the other two
    """
    lines, samples = (np.flatnonzero(region.mask.any(axis=axis)) for axis in (1, 0))
    mask = np.zeros(region.mask.shape, bool)
    if lines.size:
        margin = [int(min(outer / step, max(mask.shape))) + 1 for step in pixel]
        part = np.s_[
            max(lines[0] - margin[0], 0) : lines[-1] + 1 + margin[0],
            max(samples[0] - margin[1], 0) : samples[-1] + 1 + margin[1],
        ]
        distance = ndimage.distance_transform_edt(~region.mask[part], sampling=pixel)
        mask[part] = (distance > inner) & (distance <= outer)
    if not mask.any():
        raise InputError(
            f"no pixel of the image lies in the ring around {region.name!r}",
            where=f"region {name!r}",
            expected="an outer distance of at least a pixel beyond the inner one, within the image",
        )
    return Region(name, mask, f"ring around {region.name}")


def overlaps(regions: Iterable[Region]) -> list[tuple[str, str, int]]:
    """Pairs of regions that share pixels, with the number of shared pixels."""
    listed = list(regions)
    pairs = []
    for i, a in enumerate(listed):
        for b in listed[i + 1 :]:
            shared = int(np.count_nonzero(a.mask & b.mask))
            if shared:
                pairs.append((a.name, b.name, shared))
    return pairs


def holes(mask: Mask) -> tuple[int, int]:
    """Number of holes in a mask, and their pixels: groups (of 4 neighbours) that it encloses."""
    if not mask.any():
        return 0, 0
    lines, samples = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    part = mask[lines[0] : lines[-1] + 1, samples[0] : samples[-1] + 1]
    if part.all():
        return 0, 0
    labels, count = label(~np.pad(part, 1), connectivity=1, return_num=True)
    return int(count) - 1, int(np.count_nonzero(labels > 1))  # the first label is that of the surroundings


def objects(mask: Mask) -> tuple[npt.NDArray[np.int32], int]:
    """Connected groups of pixels (8 neighbours): labels (lines, samples), 0 outside, and their number."""
    labels, count = label(mask, connectivity=2, return_num=True)
    return labels.astype(np.int32), int(count)


def patches(mask: Mask, name: str, *, whole: bool = False) -> Iterator[tuple[str, tuple[slice, slice], Mask]]:
    """Name, window and mask within it of each group of touching pixels (8 neighbours), of all where ``whole``.

    A number stands after the name where there are several, lines first.
    """
    labels, count = (mask.astype(np.int32), 1) if whole else objects(mask)
    for number, window in enumerate(ndimage.find_objects(labels), start=1):
        yield name if count == 1 else f"{name} {number}", window, labels[window] == number


def guard(mask: Mask, radius_pixels: float) -> Mask:
    """The mask grown by a disc: every pixel whose centre is within the radius of a centre in the mask."""
    if not radius_pixels >= 0:
        raise UsageError(f"a guard radius of {radius_pixels} pixels", expected="0 or more")
    if not mask.any():
        return mask.copy()
    out, reach = np.zeros(mask.shape, bool), int(radius_pixels)
    lines, samples = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    near = tuple(slice(max(int(at[0]) - reach, 0), int(at[-1]) + reach + 1) for at in (lines, samples))
    out[near] = ndimage.distance_transform_edt(~mask[near]) <= radius_pixels  # of all pixels: 16 bytes for each
    return out


def _by_value(names: Mapping[str | int, str] | Sequence[str] | None) -> bool:
    return isinstance(names, Mapping) and any(isinstance(key, int) for key in names)


def _named(
    masks: Mapping[Any, Mask | RegionDrawing], names: Mapping[str | int, str] | Sequence[str] | None, where: str
) -> dict[str, Mask | RegionDrawing]:
    if not masks:
        raise InputError("the file holds no region", where=where)
    if names is None:
        return {str(key): mask for key, mask in masks.items()}
    wanted: dict[Any, str] = dict(names) if isinstance(names, Mapping) else {name: name for name in names}
    missing = [key for key in wanted if key not in masks]
    if missing:
        raise UsageError(
            "no region " + ", ".join(repr(key) for key in missing),
            where=where,
            expected="one of " + ", ".join(str(key) for key in masks),
        )
    if len(set(wanted.values())) < len(wanted):
        raise UsageError("two regions would get the same name", where=where)
    return {wanted[key]: masks[key] for key in wanted}
