"""Regions from GeoPackage, Shapefile and KML, read through pyogrio (the extra ``vector``)."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import shapely
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.errors import InputError, UsageError
from hyperval.imagery.drawing import Drawing
from hyperval.imagery.polygons import Position, placing
from hyperval.imagery.regions_files import REGION_COLUMNS
from hyperval.imagery.text_files import head_of
from hyperval.paths import checked_file

Array = npt.NDArray[np.float64]
MAX_BYTES = 256 << 20
MAX_FEATURES = 100_000
_SIDECARS = (".dbf", ".shx", ".prj", ".cpg")
_KINDS = ("Polygon", "MultiPolygon", "Point", "MultiPoint")


def is_vector(head: bytes) -> bool:
    """True for the first bytes of a GeoPackage (an SQLite file), a Shapefile or a KML file."""
    return head.startswith(b"SQLite format 3\0") or head[:4] == b"\x00\x00\x27\x0a" or is_kml(head)


def is_kml(head: bytes) -> bool:
    """True for the first bytes of a KML file."""
    return re.search(rb"<\s*(\w+:)?kml[\s>]", head) is not None


def vector_drawings(
    path: Path,
    shape: tuple[int, int],
    *,
    coordinates: str | None = None,
    transform: Position = None,
    crs: CRS | None = None,
    root: Path | None = None,
    name_field: str | None = None,
) -> dict[str, Drawing]:
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
                place = _placing(coordinates, meta["crs"], transform, crs, f"{path}: layer {layer!r}")
                fields = dict(zip((str(f) for f in meta["fields"]), columns, strict=True))
                names = _names(layer, fields, len(shapes), name_field, f"{path}: layer {layer!r}")
                for number, (name, wkb) in enumerate(zip(names, shapes, strict=True), start=1):
                    where = f"{path}: layer {layer!r}, feature {number} ({name})"
                    _draw(drawings.setdefault(name, Drawing(shape)), wkb, place, where)
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


def _placing(coordinates: str | None, stated: str | None, transform: Position, crs: CRS | None, where: str) -> Any:
    """A function from the file's coordinates (n, 2) to continuous pixel coordinates."""
    try:
        own = CRS.from_user_input(stated) if stated else None
    except CRSError:
        raise InputError(f"unknown coordinate system {stated!r}", where=where) from None
    if own is None and coordinates is None:
        raise UsageError(
            "the file states no coordinate system",
            where=where,
            mend="state coordinates: pixel, map (the cube's own system) or lonlat",
        )
    if own is not None and coordinates == "pixel":
        raise InputError(
            f"the file is in {own}, not in pixel coordinates", where=where, mend="leave coordinates out"
        )
    return placing(coordinates, own, transform, crs, where)


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
