"""Tables of cases, and one region, the square of samples 2 to 5 and lines 3 to 7, in every format of regions."""

import gzip
import json
import struct
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import yaml
from affine import Affine
from rasterio.crs import CRS
from rasterio.warp import transform as reproject

from hyperval.imagery import write_cube

SHAPE = (10, 12)  # lines, samples
SQUARE = [(2.0, 3.0), (6.0, 3.0), (6.0, 8.0), (2.0, 8.0)]  # samples 2-5, lines 3-7
HOLE = [(3.0, 4.0), (5.0, 4.0), (5.0, 6.0), (3.0, 6.0)]
TRANSFORM = Affine(2.0, 0, 300000.0, 0, -2.0, 4700000.0)
UTM18 = CRS.from_epsg(32618)
COLUMNS = {  # of an ASCII export
    "": (),
    "map": ("ID    X    Y      MapX      MapY    Lat    Lon   B1", "{0} {1} {2} 300001.5 4699999.5 42 -77 7"),
    "system": ("ID X Y Map X Map Y", "{0} {1} {2} 300001.5 4699999.5"),
    "bands": ("X Y B1 B2", "{1} {2} 12.5 13"),
}
PLACED = {"transform": TRANSFORM, "crs": UTM18}


@cache
def table(name: str) -> dict[str, Any]:
    """The tables of a file beside this one."""
    return yaml.safe_load((Path(__file__).parent / f"{name}.yaml").read_text("utf-8"))


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


def polygon(*rings) -> dict:
    return {"type": "Polygon", "coordinates": [[*ring, ring[0]] for ring in rings]}


def geojson(*geometries: dict, names: tuple[str, ...] = ("grass",), **properties) -> str:
    """A collection of features of some names."""
    features = [
        {"type": "Feature", "properties": {"name": name, **properties}, "geometry": geometry}
        for name, geometry in zip(names, geometries, strict=True)
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


def xml(*rings, system: str = "none") -> str:
    """ENVI 5's regions: a polygon and its holes."""
    body = ""
    for kind, ring in zip(("Exterior", *["Interior"] * len(rings)), rings, strict=False):
        text = " ".join(f"{x:.10g} {y:.10g}" for x, y in [*ring, ring[0]])
        body += f"<{kind}><LinearRing><Coordinates>{text}</Coordinates></LinearRing></{kind}>"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<RegionsOfInterest version="1.1"><Region name="grass" color="0,255,0">'
        f"<GeometryDef><CoordSysStr>{system}</CoordSysStr><Polygon>{body}</Polygon></GeometryDef></Region>"
        "</RegionsOfInterest>"
    )


def roi_ascii(mask: np.ndarray, columns: str = "ID    X    Y", row: str = "{0} {1} {2}") -> str:
    head = [
        "; ENVI Output of ROIs (4.8) [x]", "; Number of ROIs: 1", "; File Dimension: 12 x 10", ";", "; ROI name: grass",
        "; ROI rgb value: {0, 1, 2}", f"; ROI npts: {mask.sum()}", f";   {columns}",
    ]  # fmt: skip
    rows = [row.format(number, col + 1, line + 1) for number, (line, col) in enumerate(np.argwhere(mask), start=1)]
    return "\r\n".join([*head, *rows])


def roi_binary(*, points=(), polygons=(), size=(12, 10), count: int = 0) -> bytes:
    words = [0] * 45
    words[0], words[1], words[3] = size[0], size[1], len(points) or count
    words[42], words[44] = len(polygons), int(bool(points))
    out = b"JoeB" + struct.pack(">3i", 1, 5, 5) + b"grass\0\0\0" + struct.pack(">45i", *words)
    if points:
        out += struct.pack(f">{1 + len(points)}i", 3, *points)
    for vertices in polygons:
        x, y = zip(*vertices, strict=True)
        out += struct.pack(f">2i{2 * len(x)}f", len(x), 4, *x, *y)
    return out


def wkb(kind: int, *members: bytes) -> bytes:
    """Well-known binary of some parts."""
    return struct.pack("<BII", 1, kind, len(members)) + b"".join(members)


def polygon_wkb(*rings) -> bytes:
    """Well-known binary of a polygon, the rings closed."""
    parts = [np.array([*ring, ring[0]], "<f8") for ring in rings]
    return wkb(3, *(struct.pack("<I", len(part)) + part.tobytes() for part in parts))


def write_vector(path: Path, shapes, *, kind="Polygon", crs: str | None = "EPSG:32618", fields=None, **options) -> Path:
    """A GeoPackage or Shapefile of shapes in well-known binary, with the values of their attributes."""
    pyogrio = pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
    fields = {key: np.array(values, dtype=object) for key, values in (fields or {}).items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no coordinate system: meant here
        pyogrio.raw.write(path, np.array(shapes, dtype=object), field_data=list(fields.values()), fields=list(fields),
                          geometry_type=kind, crs=crs, **options)  # fmt: skip
    return path


def write_raster(path: Path, bands: np.ndarray, **options) -> Path:
    """A GeoTIFF (bands, lines, samples)."""
    size = {"count": bands.shape[0], "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", **size, **options) as out:
            out.write(bands)
    return path


def written(folder: Path, kind: str) -> tuple[Path, dict]:
    """The square in a format and a system of coordinates, with the arguments that reading it needs."""
    end, _, system = kind.partition("-")
    path = folder / f"r.{end}"
    pixels = np.argwhere(expected())
    points = {"map": on_map, "lonlat": lonlat}.get(system, list)(SQUARE)
    placed = PLACED if end == "kml" or (end != "txt" and system in ("map", "lonlat")) else {}
    if end == "geojson":
        shape = {"type": "MultiPoint", "coordinates": (pixels[:, ::-1] + 0.5).tolist()}
        text = geojson(shape if system == "points" else polygon(points))
        placed = placed | {"coordinates": system.replace("points", "pixel")}
    elif end == "xml":
        text = xml(points, system=UTM18.to_wkt(version="WKT1_ESRI") if system == "map" else "none")
    elif end == "csv":
        head, form = {
            "0": ("region,row0,col0\n", "grass,{0},{1}\n"),
            "1": ("col1, row1, class\r\n", "{3},{2}, grass\r\n"),
            "semicolon": ("Region;Row0;Col0\n", "grass;{0};{1}\n"),
        }[system]
        text = head + "".join(form.format(r, c, r + 1, c + 1) for r, c in pixels)
    elif end == "kml":
        pytest.importorskip("pyogrio", reason="the extra 'vector' (pyogrio) is not installed")
        place = " ".join(f"{x:.9f},{y:.9f},0" for x, y in lonlat([*SQUARE, SQUARE[0]]))
        text = (
            '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
            f"<name>grass</name><Polygon><outerBoundaryIs><LinearRing><coordinates>{place}</coordinates></LinearRing>"
            "</outerBoundaryIs></Polygon></Placemark></Document></kml>"
        )
    elif end == "roi":
        addresses = {"points": (pixels @ [12, 1]).tolist()} if system == "points" else {"polygons": [SQUARE]}
        text = roi_binary(**addresses)
    elif end in ("gpkg", "shp"):
        crs = {"map": "EPSG:32618", "lonlat": "EPSG:4326"}.get(system)
        write_vector(path, [polygon_wkb(points)], crs=crs, fields={"name": ["grass"]})
        return path, PLACED | ({"coordinates": "pixel"} if system == "pixel" else {})
    elif end == "img":
        extra = {"classes": "2", "class names": "{\n Unclassified, grass [Green] 20 points}", "data ignore value": "60"}
        image = (expected() + 60 * ~np.indices(SHAPE).any(axis=0)).astype("u1")  # begins as XML does, with "<"
        return write_cube(path, image[:, :, None], data_type=1, interleave="bsq", extra=extra), {}
    elif end == "tif":
        return write_raster(folder / "grass.tif", expected()[None].astype("u1") * 7, transform=TRANSFORM), {}
    else:
        text = roi_ascii(expected(), *COLUMNS[system])
    data = text if isinstance(text, bytes) else text.encode("utf-16" if "map" in kind or "points" in kind else "utf-8")
    path.write_bytes(gzip.compress(data) if end == "gz" else data)
    return path, placed
