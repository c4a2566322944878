"""Regions from GeoJSON, CSV lists, class rasters; GeoPackage, Shapefile and KML by the extra ``vector``."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from rasterio.crs import CRS

from hyperval.errors import InputError, UsageError
from hyperval.imagery.drawing import Drawing, Grid, named_crs
from hyperval.imagery.rasters import raster_of_size, stated_ignore_value
from hyperval.imagery.text_files import head_of, read_table, read_text
from hyperval.imagery.validity import equals
from hyperval.paths import checked_file

Mask = npt.NDArray[np.bool_]
MAX_CLASSES = 1000
_MAX_DIGITS = 300  # more are no float
_COLUMNS = {("row0", "col0"): 0, ("line", "sample"): 0, ("row1", "col1"): 1}
REGION_COLUMNS = ("region", "name", "class", "class_name")  # the last is what ENVI writes
Array = npt.NDArray[np.float64]
MAX_BYTES = 256 << 20
MAX_FEATURES = 100_000
_SIDECARS = (".dbf", ".shx", ".prj", ".cpg")
_KINDS = ("Polygon", "MultiPolygon", "Point", "MultiPoint")


def geojson_drawings(path: Path, grid: Grid) -> dict[str, Drawing]:
    """Drawings by name of the polygons and points of a GeoJSON file; features of one name are united.

    Where neither the file nor ``grid`` says otherwise they are longitude and latitude on WGS 84, as RFC 7946
    has it.
    """
    try:
        data = json.loads(read_text(path), object_pairs_hook=_once, parse_constant=_refuse, parse_int=_whole_number)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid GeoJSON: {error}", where=str(path)) from error
    stated = _stated_crs(data, path)
    assumed = grid.coordinates is None and stated is None
    if assumed and grid.transform is None:
        raise UsageError(
            "a GeoJSON file holds longitude and latitude (RFC 7946), and the cube has no position",
            where=str(path),
            mend="state coordinates: pixel, map (the cube's own system) or lonlat",
        )
    in_pixels = grid.placing(stated, str(path))

    def place(points: Any, where: str, ring: bool) -> npt.NDArray[np.float64]:
        try:
            xy = np.array([p[:2] for p in points], dtype=float).reshape(-1, 2)
        except (TypeError, ValueError, IndexError):
            raise InputError("coordinates that are not pairs of numbers", where=where) from None
        if assumed and np.any(np.abs(xy) > (180.0, 90.0)):
            raise UsageError(
                f"{xy[0, 0]:.6g}, {xy[0, 1]:.6g} is no longitude and latitude, as GeoJSON holds (RFC 7946)",
                where=where,
                mend="state coordinates: pixel or map (the cube's own system)",
            )
        return in_pixels(xy, where, ring)

    drawings: dict[str, Drawing] = {}
    for number, (name, geometry) in enumerate(_features(data, path, grid.name_field), start=1):
        where = f"{path}: feature {number} ({name})"
        kind, parts = geometry.get("type"), geometry.get("coordinates")
        if kind in ("Point", "MultiPoint"):
            placed = place([parts] if kind == "Point" else parts, where, False)
            drawings.setdefault(name, Drawing(grid.shape)).add_points(placed, where=where)
        elif kind in ("Polygon", "MultiPolygon"):
            polygons = [parts] if kind == "Polygon" else parts
            for rings in polygons if isinstance(polygons, list) else [None]:
                if not isinstance(rings, list) or not rings:
                    raise InputError("a polygon without vertices", where=where)
                outer, *inner = [place(ring, where, True) for ring in rings]
                drawings.setdefault(name, Drawing(grid.shape)).add_polygon(outer, inner, where=where)
        else:
            raise InputError(f"geometry {kind!r}", where=where, expected="Polygon, MultiPolygon, Point, MultiPoint")
    return drawings


def csv_drawings(path: Path, shape: tuple[int, int]) -> dict[str, Drawing]:
    """Drawings by name of a CSV pixel list.

    Columns ``row0,col0`` or ``line,sample`` (0-based) or ``row1,col1`` (1-based), and ``region``,
    ``name`` or ``class`` where the file holds more than one region.
    """
    fields, rows = read_table(path, {*REGION_COLUMNS, *(name for p in _COLUMNS for name in p)})
    pair = next((p for p in _COLUMNS if p[0] in fields and p[1] in fields), None)
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
        place = int(row[pair[0]]) - _COLUMNS[pair], int(row[pair[1]]) - _COLUMNS[pair]
        name = row[column] if column else path.stem
        if not name:
            raise InputError(f"no name in column {column!r}", where=f"{path}:{number}")
        pixels.setdefault(name, []).append(place)
    drawings = {}
    for name, listed in pixels.items():
        places = np.array(listed, dtype=np.int64)
        drawings[name] = Drawing(shape)
        drawings[name].add_pixels(places[:, 0], places[:, 1], where=f"{path}: region {name!r}")
    return drawings


def raster_masks(
    path: Path, shape: tuple[int, int], *, by_value: bool = False, root: Path | None = None
) -> dict[str | int, Mask]:
    """Masks of the classes of a raster of one band, or of the bands of a raster of several.

    One band: a class for every whole number but 0 and the ignore value, under the class name of the
    header, else under the file's name (a single class) or ``name-value``; under the number itself with
    ``by_value``.  Several bands: a mask of what is not 0, nor NaN, nor the ignore value, under the band name.
    """
    raster = raster_of_size(path, shape, root=root)
    stored = raster.read_lines(0, raster.lines)
    header = raster.header
    ignore = stated_ignore_value(raster)
    valid = np.isfinite(stored) if ignore is None else np.isfinite(stored) & ~equals(stored, ignore)
    if raster.bands > 1:
        names = (header.strings("band names") if header else None) or ()
        if len(names) != raster.bands or len(set(names)) != len(names):
            names = tuple(f"band-{i + 1}" for i in range(raster.bands))
        return {name: (stored[:, :, i] != 0) & valid[:, :, i] for i, name in enumerate(names)}
    classes = stored[:, :, 0]
    values = np.unique(classes[valid[:, :, 0]])
    if np.any(values != np.round(values)) or values.size > MAX_CLASSES:
        raise InputError(
            "values that are no class numbers", where=str(path), expected=f"up to {MAX_CLASSES} classes"
        )
    numbers = [int(v) for v in values if v != 0]
    if by_value:
        return {value: classes == value for value in numbers}
    listed = (header.strings("class names") if header else None) or ()
    out: dict[str | int, Mask] = {}
    for value in numbers:
        # ENVI writes "Name [Red] 67 points" for a class image made from regions.
        name = listed[value] if 0 < value < len(listed) else ""
        name = re.sub(r"\s{0,9}\[[^\]]{0,99}\]\s{0,9}[0-9]{1,12} points$", "", name)
        name = name or (path.stem if len(numbers) == 1 else f"{path.stem}-{value}")
        if name in out:
            raise InputError(
                f"two classes are called {name!r}", where=str(path), mend="read them by value (names:)"
            )
        out[name] = classes == value
    return out


def _features(data: Any, path: Path, name_field: str | None) -> list[tuple[str, dict[str, Any]]]:
    kind = data.get("type") if isinstance(data, dict) else None
    items = data.get("features") if kind == "FeatureCollection" else [data]
    if kind is None or not isinstance(items, list):
        raise InputError("not a GeoJSON object", where=str(path))
    out = []
    for number, item in enumerate(items, start=1):
        feature = item if isinstance(item, dict) else {}
        geometry = feature.get("geometry") if feature.get("type") == "Feature" else feature
        if not isinstance(geometry, dict):
            raise InputError("a feature without geometry", where=f"{path}: feature {number}")
        properties = feature.get("properties")
        properties = {str(k).lower(): v for k, v in properties.items()} if isinstance(properties, dict) else {}
        columns = REGION_COLUMNS if name_field is None else (name_field.lower(),)
        if name_field is not None and properties.get(columns[0]) is None:
            raise UsageError(
                f"no property {name_field!r}",
                where=f"{path}: feature {number}",
                expected="one of " + (", ".join(properties) or "none"),
            )
        given = next((properties[c] for c in columns if properties.get(c) is not None), feature.get("id"))
        out.append((str(given) if given is not None else (path.stem if len(items) == 1 else str(number)), geometry))
    return out


def _stated_crs(data: Any, path: Path) -> CRS | None:
    crs = data.get("crs") if isinstance(data, dict) else None
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    return named_crs(name, str(path)) if isinstance(name, str) else None


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


def vector_drawings(path: Path, grid: Grid, root: Path | None = None) -> dict[str, Drawing]:
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
    drawings: dict[str, Drawing] = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
            for layer in layers:
                count = pyogrio.read_info(path, layer=layer, force_feature_count=True)["features"]
                if count > MAX_FEATURES:
                    raise InputError(f"{count} features", where=str(path), expected=f"at most {MAX_FEATURES}")
                meta, _, shapes, columns = pyogrio.raw.read(path, layer=layer, force_2d=True)
                inner = f"{path}: layer {layer!r}"
                place = _placing(grid, meta["crs"], inner)
                fields = dict(zip((str(f) for f in meta["fields"]), columns, strict=True))
                names = _names(layer, fields, len(shapes), grid.name_field, inner)
                for number, (name, wkb) in enumerate(zip(names, shapes, strict=True), start=1):
                    where = f"{inner}, feature {number} ({name})"
                    _draw(drawings.setdefault(name, Drawing(grid.shape)), wkb, place, where)
    except (DataLayerError, DataSourceError) as error:
        raise InputError(f"cannot be read: {error}", where=str(path)) from error
    return drawings


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
    size = sum(f.stat().st_size for f in files)
    if size > MAX_BYTES:
        raise InputError(f"larger than {MAX_BYTES >> 20} MiB", where=str(path))


def _placing(grid: Grid, stated: str | None, where: str) -> Callable[[Array, str, bool], Array]:
    """A function from the file's coordinates (n, 2) to continuous pixel coordinates."""
    own = named_crs(stated, where) if stated else None
    if own is None and grid.coordinates is None:
        raise UsageError(
            "the file states no coordinate system",
            where=where,
            mend="state coordinates: pixel, map (the cube's own system) or lonlat",
        )
    if own is not None and grid.coordinates == "pixel":
        raise InputError(
            f"the file is in {own}, not in pixel coordinates", where=where, mend="leave coordinates out"
        )
    return grid.placing(own, where)


def _names(layer: str, fields: dict[str, Any], count: int, name_field: str | None, where: str) -> list[str]:
    """Name of each feature: its attribute, else the layer's (numbered when it holds several)."""
    lower = {name.lower(): values for name, values in fields.items()}
    wanted = REGION_COLUMNS if name_field is None else (name_field.lower(),)
    column = next((lower[c] for c in wanted if c in lower), None)
    texts = [name for name, values in fields.items() if np.asarray(values).dtype.kind == "O"]
    if column is None and (name_field is not None or (count > 1 and texts)):
        raise UsageError(
            f"no attribute {name_field!r}" if name_field is not None else "no attribute that names the regions",
            where=where,
            expected="one of " + (", ".join(fields) or "none"),
            mend="state name_field: which of the attributes names them",
        )
    out = []
    for i in range(count):
        value = None if column is None else column[i]
        text = "" if value is None or value != value else str(value).strip()
        out.append(text or (layer if count == 1 else f"{layer}-{i + 1}"))
    return out


def _draw(drawing: Drawing, wkb: bytes | None, place: Any, where: str) -> None:
    if wkb is None:
        raise InputError("a feature without geometry", where=where)
    try:
        geometry = shapely.from_wkb(bytes(wkb), on_invalid="fix")  # a ring that is not closed is
    except shapely.errors.ShapelyError:
        geometry = None
    if geometry is None:
        raise InputError("a geometry that is not understood", where=where)
    if geometry.geom_type not in _KINDS or geometry.is_empty:
        what = "an empty geometry" if geometry.geom_type in _KINDS else f"geometry {geometry.geom_type!r}"
        raise InputError(what, where=where, expected=", ".join(_KINDS))
    if geometry.geom_type.endswith("Point"):
        drawing.add_points(place(shapely.get_coordinates(geometry), where, False), where=where)
        return
    for polygon in shapely.get_parts(geometry):
        rings = [shapely.get_coordinates(ring) for ring in (polygon.exterior, *polygon.interiors)]
        outer, *inner = [place(ring, where, True) for ring in rings]
        drawing.add_polygon(outer, inner, where=where)
