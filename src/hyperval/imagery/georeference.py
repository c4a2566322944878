"""Position of an ENVI image: ``map info`` and ``coordinate system string`` to an affine transform and a CRS."""

from __future__ import annotations

import math
import re

from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.envi_header import EnviHeader
from hyperval.errors import InputError

_METRES = ("meters", "metres", "meter", "metre", "m")


def transform_of(header: EnviHeader) -> Affine | None:
    """Affine transform from (sample, line) in continuous pixel coordinates to map coordinates.

    ``map info = {projection, x, y, easting, northing, dx, dy, ...}`` ties the 1-based reference pixel
    (x, y), whose (1, 1) is the upper left corner of the first pixel, to the map; ``rotation=`` turns
    the grid counter-clockwise in degrees about that pixel.  None when the header has no ``map info``.

    GDAL agrees for square pixels whose reference is the first pixel; for others it shears the grid.
    """
    parts = header.strings("map info")
    if parts is None:
        return None
    try:
        x_ref, y_ref, east, north, dx, dy = (float(p) for p in parts[1:7])
        options = dict(p.split("=", 1) for p in parts[7:] if "=" in p)
        rotation = math.radians(float({k.strip().lower(): v for k, v in options.items()}.get("rotation", 0.0)))
    except (ValueError, IndexError):
        raise InputError(
            "'map info' is not understood",
            where=header.where("map info"),
            expected="{projection, x, y, easting, northing, x size, y size, ...}",
        ) from None
    if not all(math.isfinite(v) for v in (x_ref, y_ref, east, north, dx, dy, rotation)) or dx <= 0 or dy <= 0:
        raise InputError("'map info' has sizes that are not positive or finite", where=header.where("map info"))
    if parts[0].strip().lower() in ("arbitrary", "none") and (east, north, dx, dy) == (x_ref, y_ref, 1.0, 1.0):
        return None  # ENVI writes this for an image in pixel coordinates
    cos, sin = math.cos(rotation), math.sin(rotation)
    a, b, d, e = cos * dx, sin * dy, sin * dx, -cos * dy
    x, y = x_ref - 1.0, y_ref - 1.0
    return Affine(a, b, east - a * x - b * y, d, e, north - d * x - e * y)


def crs_of(header: EnviHeader) -> CRS | None:
    """Coordinate reference system from the WKT string, or from a UTM ``map info``; None when unknown."""
    wkt = header.text("coordinate system string")
    if wkt is not None:
        try:
            return CRS.from_wkt(wkt.replace("\n", ""), morph_from_esri_dialect=True)
        except CRSError:
            pass
    parts = header.strings("map info") or ()
    if len(parts) >= 10 and parts[0].upper() == "UTM" and re.fullmatch(r"[0-9]{1,2}", parts[7]):
        datum = re.sub(r"[^A-Z0-9]", "", parts[9].upper())
        zone, south = int(parts[7]), parts[8].strip().lower().startswith("s")
        if datum == "WGS84" and 1 <= zone <= 60:
            return CRS.from_epsg((32700 if south else 32600) + zone)
    return None


def pixel_area_m2(transform: Affine | None, crs: CRS | None, header: EnviHeader | None = None) -> float | None:
    """Ground area of a pixel [m2]; None when the map unit is unknown or an angle."""
    if transform is None:
        return None
    area = abs(transform.determinant)
    if crs is not None:
        if not crs.is_projected:
            return None
        return area * float(crs.linear_units_factor[1]) ** 2
    text = (header.text("map info") or "").lower() if header is not None else ""
    unit = re.search(r"units\s*=\s*([a-z]+)", text)
    return area if unit is not None and unit.group(1) in _METRES else None
