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
_DEGREES = ("degrees", "degree", "deg")
# Names of datums, without blanks and signs: EPSG code of longitude and latitude, of UTM zone 0 north and south, and
# the zones that EPSG lists.
_DATUMS: dict[str, tuple[int, int, int | None, range]] = {
    "WGS84": (4326, 32600, 32700, range(1, 61)),
    "WGS72": (4322, 32200, 32300, range(1, 61)),
    "NORTHAMERICA1983": (4269, 26900, None, range(1, 24)),
    "NORTHAMERICA1927": (4267, 26700, None, range(1, 23)),
    "EUROPEAN1950": (4230, 23000, None, range(28, 39)),
    "ETRS1989": (4258, 25800, None, range(28, 39)),
}
_ALIASES = {"NAD83": "NORTHAMERICA1983", "NAD27": "NORTHAMERICA1927", "ED50": "EUROPEAN1950", "ETRS89": "ETRS1989"}
_SOUTHERN_BANDS = "CDEFGHJKLM"
_NORTHERN_BANDS = "NPQRSTUVWX"


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
        rotation = math.radians(float(_options(parts).get("rotation", 0.0)))
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
    """Coordinate reference system from the WKT string, or from ``map info``; None when unknown.

    ``map info`` tells it for UTM in metres and Geographic Lat/Lon in degrees on a common datum.  The hemisphere
    stands as a word ("South") or as the letter of a latitude band: C to M lie south of the equator, N to X north.
    """
    stated = crs_of_wkt((header.text("coordinate system string") or "").replace("\n", ""))
    if stated is not None:
        return stated
    parts = header.strings("map info") or ()
    projection = parts[0].strip().lower() if parts else ""
    units = _options(parts).get("units")
    if units is not None and units.lower() not in (_DEGREES if projection.startswith("geographic") else _METRES):
        return None  # a grid in feet is in no system of metres
    if projection.startswith("geographic lat"):
        codes = _datum(parts[7]) if len(parts) > 7 else None
        return CRS.from_epsg(codes[0]) if codes is not None else None
    if projection != "utm" or len(parts) < 10 or not re.fullmatch(r"[0-9]{1,2}", parts[7]):
        return None
    codes, zone, south = _datum(parts[9]), int(parts[7]), _south(parts[8])
    if codes is None or south is None or zone not in codes[3] or (south and codes[2] is None):
        return None
    return CRS.from_epsg((codes[2] if south and codes[2] is not None else codes[1]) + zone)


def crs_of_wkt(wkt: str | None) -> CRS | None:
    """The system of a WKT, ESRI's among them; None where there is none that is understood."""
    try:
        return CRS.from_wkt(wkt, morph_from_esri_dialect=True) if wkt else None
    except CRSError:
        return None


def gdal_transform(text: str | None) -> Affine | None:
    """The transform of six numbers in the order of GDAL's GeoTransform; None where a text has others."""
    numbers = re.findall(r"[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?", text or "")
    return Affine.from_gdal(*(float(n) for n in numbers)) if len(numbers) == 6 else None


def _datum(name: str) -> tuple[int, int, int | None, range] | None:
    short = re.sub(r"[^A-Z0-9]", "", name.upper())
    return _DATUMS.get(_ALIASES.get(short, short))


def _south(text: str) -> bool | None:
    """Whether a zone lies south of the equator; None where the text is no hemisphere and no latitude band."""
    word = text.strip().upper()
    if len(word) == 1:
        return True if word in _SOUTHERN_BANDS else False if word in _NORTHERN_BANDS else None
    return {"NORTH": False, "SOUTH": True}.get(word)


def _options(parts: tuple[str, ...]) -> dict[str, str]:
    """The entries 'name=value' (or, as some programs write, 'name  value') behind the numbers of ``map info``."""
    pairs = [re.split(r"\s*=\s*|\s+", p.strip(), maxsplit=1) for p in parts[7:]]
    return {pair[0].lower(): pair[1] for pair in pairs if len(pair) == 2}


def pixel_sides_m(transform: Affine | None, area_m2: float) -> tuple[float, float]:
    """Distances between the centres of neighbouring lines and samples [m], for pixels of a known area.

    Square pixels where the transform does not tell their shape.
    """
    if transform is None:
        return math.sqrt(area_m2), math.sqrt(area_m2)
    unit = math.sqrt(area_m2 / abs(transform.determinant))
    return unit * math.hypot(transform.b, transform.e), unit * math.hypot(transform.a, transform.d)


def pixel_area_m2(transform: Affine | None, crs: CRS | None, header: EnviHeader | None = None) -> float | None:
    """Ground area of a pixel [m2]; None when the map unit is unknown or an angle."""
    if transform is None:
        return None
    area = abs(transform.determinant)
    if crs is not None:
        if not crs.is_projected:
            return None
        return area * float(crs.linear_units_factor[1]) ** 2
    parts = (header.strings("map info") or ()) if header is not None else ()
    return area if _options(parts).get("units", "").lower() in _METRES else None
