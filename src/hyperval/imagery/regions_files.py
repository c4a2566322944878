"""Regions from GeoJSON, CSV pixel lists and class rasters."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.errors import InputError, UsageError
from hyperval.imagery.drawing import Drawing
from hyperval.imagery.polygons import Position, placing
from hyperval.imagery.rasters import open_raster
from hyperval.imagery.text_files import read_table, read_text
from hyperval.imagery.tiff_raster import TiffRaster
from hyperval.imagery.validity import equals

Mask = npt.NDArray[np.bool_]
MAX_CLASSES = 1000
_MAX_DIGITS = 300  # more are no float
_COLUMNS = {("row0", "col0"): 0, ("line", "sample"): 0, ("row1", "col1"): 1}
REGION_COLUMNS = ("region", "name", "class", "class_name")  # the last is what ENVI writes


def geojson_drawings(
    path: Path,
    shape: tuple[int, int],
    *,
    coordinates: str | None,
    transform: Position,
    crs: CRS | None,
    name_field: str | None = None,
) -> dict[str, Drawing]:
    """Drawings by name of the polygons and points of a GeoJSON file; features of one name are united.

    Where neither the file nor ``coordinates`` says otherwise they are longitude and latitude on WGS 84, as RFC 7946
    has it.
    """
    try:
        data = json.loads(read_text(path), object_pairs_hook=_once, parse_constant=_refuse, parse_int=_whole_number)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid GeoJSON: {error}", where=str(path)) from error
    stated = _stated_crs(data, path)
    assumed = coordinates is None and stated is None
    if assumed and transform is None:
        raise UsageError(
            "a GeoJSON file holds longitude and latitude (RFC 7946), and the cube has no position",
            where=str(path),
            mend="state coordinates: pixel, map (the cube's own system) or lonlat",
        )
    in_pixels = placing(coordinates, stated, transform, crs, str(path))

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
    for number, (name, geometry) in enumerate(_features(data, path, name_field), start=1):
        where = f"{path}: feature {number} ({name})"
        kind, parts = geometry.get("type"), geometry.get("coordinates")
        if kind in ("Point", "MultiPoint"):
            placed = place([parts] if kind == "Point" else parts, where, False)
            drawings.setdefault(name, Drawing(shape)).add_points(placed, where=where)
        elif kind in ("Polygon", "MultiPolygon"):
            polygons = [parts] if kind == "Polygon" else parts
            for rings in polygons if isinstance(polygons, list) else [None]:
                if not isinstance(rings, list) or not rings:
                    raise InputError("a polygon without vertices", where=where)
                outer, *inner = [place(ring, where, True) for ring in rings]
                drawings.setdefault(name, Drawing(shape)).add_polygon(outer, inner, where=where)
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
    raster = open_raster(path, root=root)
    if (raster.lines, raster.samples) != shape:
        raise InputError(
            f"the raster has {raster.lines} lines and {raster.samples} samples",
            where=str(path),
            expected=f"{shape[0]} lines and {shape[1]} samples, as the cube",
        )
    stored = raster.read_lines(0, raster.lines)
    header = raster.header
    ignore = header.number("data ignore value") if header else None
    if ignore is None and isinstance(raster, TiffRaster):
        ignore = raster.nodata
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
    if not isinstance(name, str):
        return None
    try:
        return CRS.from_user_input(name)
    except (CRSError, ValueError):
        raise InputError(f"unknown coordinate system {name!r}", where=str(path)) from None


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
