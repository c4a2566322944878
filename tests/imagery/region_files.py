"""One region, the square of samples 2 to 5 and lines 3 to 7, as every format of regions has it."""

from __future__ import annotations

import gzip
import json
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.warp import transform as reproject

from hyperval.imagery import write_cube

SHAPE = (10, 12)  # lines, samples
SQUARE = [(2.0, 3.0), (6.0, 3.0), (6.0, 8.0), (2.0, 8.0)]  # samples 2-5, lines 3-7
TRANSFORM = Affine(2.0, 0, 300000.0, 0, -2.0, 4700000.0)
UTM18 = CRS.from_epsg(32618)
PLACED = {"transform": TRANSFORM, "crs": UTM18}


def expected(hole: bool = False) -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[3:8, 2:6] = True
    if hole:
        mask[4:6, 3:5] = False
    return mask


def on_map(points) -> list[tuple[float, float]]:
    return [(300000.0 + 2 * x, 4700000.0 - 2 * y) for x, y in points]


def lonlat(points) -> list[tuple[float, float]]:
    return list(zip(*reproject(UTM18, CRS.from_epsg(4326), *zip(*on_map(points), strict=True)), strict=True))


def feature(geometry: dict, **properties) -> dict:
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def polygon(points) -> dict:
    return {"type": "Polygon", "coordinates": [[*points, points[0]]]}


def collection(*features) -> str:
    return json.dumps({"type": "FeatureCollection", "features": list(features)})


def xml(body: str, system: str = "none", name: str = "grass") -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<RegionsOfInterest version="1.1">'
        f'<Region name="{name}" color="0,255,0">'
        f"<GeometryDef><CoordSysStr>{system}</CoordSysStr>{body}</GeometryDef></Region></RegionsOfInterest>"
    )


def ring(points, kind: str = "Exterior") -> str:
    text = " ".join(f"{x:.10g} {y:.10g}" for x, y in [*points, points[0]])
    return f"<{kind}><LinearRing><Coordinates>{text}</Coordinates></LinearRing></{kind}>"


def roi_ascii(mask: np.ndarray, name: str = "grass", dimension: str = "12 x 10") -> str:
    rows, cols = np.nonzero(mask)
    head = [
        "; ENVI Output of ROIs (4.8) [x]", "; Number of ROIs: 1", f"; File Dimension: {dimension}", ";",
        f"; ROI name: {name}", "; ROI rgb value: {0, 1, 2}", f"; ROI npts: {rows.size}", ";   ID    X    Y",
    ]  # fmt: skip
    return "\r\n".join([*head, *(f"{i + 1} {c + 1} {r + 1}" for i, (r, c) in enumerate(zip(rows, cols, strict=True)))])


def roi_binary(name: str, *, points=(), polygons=(), size=(12, 10), count: int = 0) -> bytes:
    table = [0] * 45
    table[0], table[1], table[3] = size[0], size[1], len(points) or count
    table[42], table[44] = len(polygons), int(bool(points))
    padded = name.encode() + b"\0" * (-len(name) % 4)
    out = b"JoeB" + struct.pack(">3i", 1, len(name), len(name)) + padded + struct.pack(">45i", *table)
    if points:
        out += struct.pack(f">{1 + len(points)}i", 3, *points)
    for vertices in polygons:
        x, y = zip(*vertices, strict=True)
        out += struct.pack(f">2i{2 * len(x)}f", len(x), 4, *x, *y)
    return out


def polygon_wkb(*rings) -> bytes:
    """Well-known binary of a polygon, the rings closed."""
    out = struct.pack("<BII", 1, 3, len(rings))
    for ring in rings:
        closed = [*ring, ring[0]]
        out += struct.pack("<I", len(closed)) + b"".join(struct.pack("<2d", *p) for p in closed)
    return out


def write_vector(path: Path, shapes, names=None, *, kind="Polygon", crs: str | None = "EPSG:32618", **options):
    pyogrio = pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no coordinate system: meant here
        pyogrio.raw.write(
            path,
            np.array(shapes, dtype=object),
            field_data=[] if names is None else [np.array(names, dtype=object)],
            fields=[] if names is None else ["name"],
            geometry_type=kind,
            crs=crs,
            **options,
        )
    return path


def written(tmp_path: Path, kind: str) -> tuple[Path, dict]:
    """The square in one of the formats, with the arguments that reading it needs."""
    path = tmp_path / f"r.{kind.split('-')[0]}"
    rows, cols = np.nonzero(expected())
    pixels = list(zip(rows.tolist(), cols.tolist(), strict=True))
    system = kind.rpartition("-")[2]
    points = {"map": on_map, "lonlat": lonlat}.get(system, list)(SQUARE)
    centres = {"type": "MultiPoint", "coordinates": [[c + 0.5, r + 0.5] for r, c in pixels]}
    place = " ".join(f"{x:.9f},{y:.9f},0" for x, y in lonlat([*SQUARE, SQUARE[0]]))
    texts = {
        "geojson": collection(feature(polygon(points), name="grass")),
        "geojson-points": collection(feature(centres, region="grass")),
        "xml": xml(
            f"<Polygon>{ring(points)}</Polygon>", UTM18.to_wkt(version="WKT1_ESRI") if system == "map" else "none"
        ),
        "txt": roi_ascii(expected()),
        "csv-0": "region,row0,col0\n" + "".join(f"grass,{r},{c}\n" for r, c in pixels),
        "csv-1": "col1, row1, class\r\n" + "".join(f"{c + 1},{r + 1}, grass\r\n" for r, c in pixels),
        "csv-semicolon": "Region;Row0;Col0\n" + "".join(f"grass;{r};{c}\n" for r, c in pixels),
        "kml": '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
        "<name>grass</name><Polygon><outerBoundaryIs><LinearRing><coordinates>"
        f"{place}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></Document></kml>",
    }
    raw = {
        "gz": gzip.compress(roi_ascii(expected()).encode()),
        "roi-points": roi_binary("grass", points=[r * 12 + c for r, c in pixels]),
        "roi-polygon": roi_binary("grass", polygons=[SQUARE]),
    }
    if kind == "img":
        extra = {"classes": "2", "class names": "{\n Unclassified, grass [Green] 20 points}"}
        write_cube(path, expected().astype("u1")[:, :, None], data_type=1, interleave="bsq", extra=extra)
    elif kind == "tif":
        options = {"driver": "GTiff", "height": 10, "width": 12, "count": 1, "dtype": "uint8", "transform": TRANSFORM}
        with rasterio.open(path, "w", **options) as out:
            out.write(expected().astype("u1") * 7, 1)
        return path, {"names": {7: "grass"}}
    elif kind.startswith(("gpkg", "shp")):
        crs = {"map": "EPSG:32618", "lonlat": "EPSG:4326"}.get(system)
        write_vector(path, [polygon_wkb(points)], ["grass"], crs=crs)
        return path, PLACED | ({"coordinates": "pixel"} if system == "pixel" else {})
    else:
        if kind == "kml":
            pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
        text = texts.get(kind) or texts.get(kind.split("-")[0], "")
        path.write_bytes(raw.get(kind) or text.encode())
    stated = {"pixel": "pixel", "points": "pixel", "map": "map", "lonlat": "lonlat"}.get(system)
    options = {"coordinates": stated} if kind.startswith("geojson") else {}
    return path, options | (PLACED if system in ("map", "lonlat", "kml") else {})
