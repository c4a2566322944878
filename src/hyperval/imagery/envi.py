"""ENVI images: position on a map by the header, stored numbers by plain reads, whatever the size of the file.

Files are written by blocks of lines: whole or not at all.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.data import Index
from hyperval.envi_header import EnviHeader, parse_header, read_header
from hyperval.errors import package_table, refusal, refuse
from hyperval.imagery.description import Description, Raster, crs_of_wkt
from hyperval.paths import checked_file
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import number_of, whole_file, write_text

_NAMES = package_table("imagery/names.yaml")
_HEMISPHERES = {"NORTH": "north", "SOUTH": "south"} | dict.fromkeys("NPQRSTUVWX", "north")
_HEMISPHERES |= dict.fromkeys("CDEFGHJKLM", "south")
_ORDERS = {"bsq": (2, 0, 1), "bil": (0, 2, 1), "bip": (0, 1, 2)}  # of lines, samples and bands in a file


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
        rotation = float(_options(parts).get("rotation", 0.0))
    except (ValueError, IndexError):
        raise refusal("image.map_info", header.where("map info")) from None
    if not all(map(math.isfinite, (x_ref, y_ref, east, north, dx, dy, rotation))) or dx <= 0 or dy <= 0:
        raise refusal("image.map_sizes", header.where("map info"))
    of_pixels = dx == dy == 1.0 and (east, north) in ((x_ref, y_ref), (0.0, 0.0)) and _metres(parts) is None
    if parts[0].strip().lower() in ("arbitrary", "none") and of_pixels:
        return None  # ENVI writes this for an image in pixel coordinates
    on_map = Affine.translation(east, north) @ Affine.rotation(rotation) @ Affine.scale(dx, -dy)
    return on_map @ Affine.translation(1.0 - x_ref, 1.0 - y_ref)


def crs_of(header: EnviHeader) -> CRS | None:
    """Coordinate reference system from the WKT string, or from ``map info``; None when unknown.

    ``map info`` tells it for UTM or MGA 94 in metres and Geographic Lat/Lon in degrees on a common datum.  The
    hemisphere stands as a word ("South") or as the letter of a latitude band: C to M lie south, N to X north.
    """
    stated = crs_of_wkt((header.text("coordinate system string") or "").replace("\n", ""))
    parts = header.strings("map info") or ()
    if stated is not None or not parts:
        return stated
    projection, units = parts[0].strip().lower(), _options(parts).get("units")
    degrees = projection.startswith("geographic")
    if units is not None and not (units.lower() in _NAMES["degrees"] if degrees else _metres(parts) == 1.0):
        return None  # a grid in feet is in no system of metres
    if projection.startswith("geographic lat"):
        datum = _datum(parts[7]) if len(parts) > 7 else {}
        return CRS.from_epsg(datum["geographic"]) if datum else None
    if grid := re.fullmatch(r"map grid of australia \(mga 94\) zone (4[89]|5[0-8])", projection):
        return CRS.from_epsg(28300 + int(grid[1]))
    if projection != "utm" or len(parts) < 10 or not re.fullmatch(r"[0-9]{1,2}", parts[7]):
        return None
    datum, zone, side = _datum(parts[9]), int(parts[7]), _HEMISPHERES.get(parts[8].strip().upper())
    first, last = datum.get("zones", (1, 0))
    return CRS.from_epsg(datum[side] + zone) if side in datum and first <= zone <= last else None


def _datum(name: str) -> dict[str, Any]:
    """Codes and zones of a datum, none where it is not known."""
    found: dict[str, Any] = _NAMES["datums"].get(re.sub(r"[^A-Z0-9]", "", name.upper()), {})
    return found


def _options(parts: Sequence[str]) -> dict[str, str]:
    """The entries 'name=value' (or, as some programs write, 'name  value') behind the numbers of ``map info``."""
    pairs = [re.split(r"\s*=\s*|\s+", p.strip(), maxsplit=1) for p in parts]
    return {pair[0].lower(): pair[1] for pair in pairs if len(pair) == 2}


def _metres(parts: Sequence[str]) -> float | None:
    """Metres of the unit that ``map info`` or ``pixel size`` states, which for UTM is the metre; None where unknown."""
    unit = _options(parts).get("units", "m" if parts[0].strip().lower() == "utm" else "")
    metres: float | None = _NAMES["metres"].get(unit.lower())
    return metres


def pixel_sides_m(transform: Affine | None, area_m2: float) -> tuple[float, float]:
    """Distances between the centres of neighbouring lines and samples [m], for pixels of a known area.

    Square pixels where the transform does not tell their shape.
    """
    if transform is None:
        return math.sqrt(area_m2), math.sqrt(area_m2)
    unit = math.sqrt(area_m2 / abs(transform.determinant))
    return unit * math.hypot(transform.b, transform.e), unit * math.hypot(transform.a, transform.d)


def pixel_area_m2(transform: Affine | None, crs: CRS | None, entries: Mapping[str, str]) -> float | None:
    """Ground area of a pixel [m2]; None when the map unit is unknown or an angle.

    ``entries`` of a header, whose ``map info`` states the unit where no system is known, and whose ``pixel size``
    counts where there is no position.

    >>> header, placed = {"pixel size": "2.0, 2.0, units=Meters"}, Affine.scale(2.0, -2.0)
    >>> infos = [f"{projection}, 1, 1, 5, 5, 2, 2" for projection in ("Arbitrary", "UTM", "Custom, units=Feet")]
    >>> pixel_area_m2(None, None, header), *(pixel_area_m2(placed, None, header | {"map info": i}) for i in infos)
    (4.0, None, 4.0, 0.37161216)
    """
    if transform is not None and crs is not None:
        return abs(transform.determinant) * float(crs.linear_units_factor[1]) ** 2 if crs.is_projected else None
    parts = entries.get("pixel size" if transform is None else "map info", "").split(",")
    area = math.prod(map(number_of, parts[:2])) if transform is None else abs(transform.determinant)
    unit = _metres(parts)
    return area * unit**2 if unit is not None and area > 0 else None


@dataclass(frozen=True, eq=False)
class EnviRaster(Raster):
    """An ENVI data file whose size is exactly what its ``header`` says."""

    header = property(attrgetter("description.header"))
    kind = "ENVI image"

    def _read(self, first: int, count: int, buffer: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
        shape, order = (count, self.samples, self.bands), _ORDERS[self.header.interleave]
        flat = np.empty(math.prod(shape), self.dtype) if buffer is None else buffer[: math.prod(shape)]
        parts = self.bands if self.header.interleave == "bsq" else 1  # the lines of each band, or all at once
        with open(self.path, "rb") as stream:
            for number, part in enumerate(flat.reshape(parts, -1)):
                start = number * self.lines * self.samples + first * self.samples * self.bands // parts
                stream.seek(self.header.header_offset + start * self.dtype.itemsize)
                refuse(stream.readinto(part.view("u1").data) < part.nbytes, "image.shrunk", self.path)
        return flat.reshape([shape[axis] for axis in order]).transpose([order.index(axis) for axis in (2, 0, 1)])

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels."""
        refuse(self.path.stat().st_size < self.header.expected_bytes, "image.shrunk", self.path)
        order = _ORDERS[self.header.interleave]
        values = np.memmap(self.path, self.dtype, "r", self.header.header_offset, tuple(self.size[a] for a in order))
        return np.array(values.transpose(np.argsort(order))[rows, cols])


def open_envi(data: Path, header: Path) -> EnviRaster:
    """Open an ENVI data file with its header, and the file of gains that may lie beside it.

    Raises
    ------
    InputError : a header that is not understood, or a data file of another size than it says.
    """
    parsed = read_header(checked_file(header, what="ENVI header"))
    size, expected = data.stat().st_size, parsed.expected_bytes
    if size != expected:
        with open(data, "rb") as stream:
            head = stream.read(6).decode("latin-1")
        packed = next((name for mark, name in _NAMES["packed"].items() if head.startswith(mark)), None)
        sizes: dict[str, object] = {"header": parsed, "packed": packed, "size": size, "more": size - expected}
        sizes["missing"] = 100.0 * (1.0 - size / expected)
        raise refusal("image.packed" if packed else "image.short" if size < expected else "image.long", data, **sizes)
    scaled = {"data gain values", "reflectance scale factor"} & parsed.entries.keys()
    # The .gain file that the image's name begins with, as f130612t01p00r10rdn_e.gain.
    files = [] if scaled or parsed.dtype.kind == "f" else sorted(data.parent.glob("*.[gG][aA][iI][nN]"))
    named = [p for p in files if data.name.lower().startswith(p.stem.lower())]
    gains = max(named, key=lambda p: len(p.stem), default=None)
    companions = (parsed.path,) if gains is None else (parsed.path, checked_file(gains, what="gain file"))
    about = Description(
        entries=parsed.entries, notes=parsed.notes, header=parsed, gains=gains, band_names=parsed.band_names
    )
    image_size, place = (parsed.lines, parsed.samples, parsed.bands), (transform_of(parsed), crs_of(parsed))
    return EnviRaster(data, *image_size, parsed.dtype, about, *place, companions)


@dataclass(eq=False)
class EnviWriter:
    """Takes blocks of lines in order; made by :func:`envi_writer`."""

    stream: Any
    header: EnviHeader
    ignore: float | None
    lines_written: int = 0

    def write(self, block: npt.NDArray[Any]) -> None:
        """Append (lines, samples, bands) stored numbers; those of a whole type are rounded.

        Raises
        ------
        UsageError : wrong shape, more lines than announced, values that do not fit the stored type.
        """
        header, values = self.header, np.asarray(block)
        if header.dtype.kind != "f":
            if values.dtype.kind == "f":
                refuse(self.ignore is None and not np.isfinite(values).all(), "write.not_finite")
                values = np.rint(np.where(np.isfinite(values), values, self.ignore or 0.0))
            limits = np.iinfo(header.dtype)
            if values.size and (values.min() < limits.min or values.max() > limits.max):
                raise refusal("write.range", least=values.min(), most=values.max(), dtype=header.dtype.name)
        stored = values.astype(header.dtype)
        if stored.ndim != 3 or stored.shape[1:] != (header.samples, header.bands):
            raise refusal("write.shape", shape=stored.shape, samples=header.samples, bands=header.bands)
        refuse(self.lines_written + len(stored) > header.lines, "write.many", lines=header.lines)
        planes = stored.transpose(_ORDERS[header.interleave])
        planes = planes if header.interleave == "bsq" else planes[None]  # the lines of each band, or all at once
        for number, plane in enumerate(planes):
            row = number * header.lines + self.lines_written * header.bands // len(planes)
            self.stream.seek(header.header_offset + row * header.samples * header.dtype.itemsize)
            self.stream.write(np.ascontiguousarray(plane).tobytes())
        self.lines_written += len(stored)


def described_by(raster: Raster, header: Path) -> Raster:
    """An image of another format, as an ENVI header beside it describes its bands and its place.

    Raises
    ------
    InputError : a header of an image of another size.
    """
    parsed = read_header(checked_file(header, what="ENVI header"), sidecar=True)
    stated = (parsed.lines, parsed.samples, parsed.bands)
    refuse(raster.size != stated, "image.described", parsed.path, size=raster.size, stated=stated)
    transform, crs = raster.transform or transform_of(parsed), raster.crs or crs_of(parsed)
    about, notes = raster.description, (*raster.description.notes, *parsed.notes)
    about = replace(about, header=parsed, entries=parsed.entries, notes=notes, band_names=parsed.band_names)
    return replace(raster, description=about, transform=transform, crs=crs, other_files=(parsed.path,))


@contextmanager
def envi_writer(
    path: Path,
    *,
    lines: int,
    samples: int,
    bands: int,
    data_type: int = 4,
    interleave: str = "bil",
    axis: SpectralAxis | None = None,
    description: str = "",
    ignore_value: float | None = None,
    transform: Affine | None = None,
    crs: CRS | None = None,
    extra: Mapping[str, str] | None = None,
) -> Iterator[EnviWriter]:
    """Write an ENVI cube block by block; data file and header appear when the block ends well.

    Parameters
    ----------
    path : the data file; the header stands beside it with the suffix ``.hdr``
    data_type : ENVI code (1, 2, 3, 4, 5, 12, 13, 14, 15)
    axis : wavelengths [nm], widths and bad-band list for the header
    ignore_value : stored value for no data
    transform : north-up affine transform, written as ``map info``
    extra : further header entries as text, in order, or in place of those above

    Raises
    ------
    UsageError : too few lines, or the name of a header.
    InputError : entries that cannot be read again.
    """
    path = Path(path)
    refuse(path.suffix.lower() == ".hdr", "write.header", path)
    entries: dict[str, Any] = {
        "description": "{" + description + "}", "samples": samples, "lines": lines, "bands": bands,
        "header offset": 0, "file type": "ENVI Standard", "data type": data_type, "interleave": interleave,
        "byte order": 0,
    }  # fmt: skip
    if transform is not None:
        refuse(transform.b or transform.d or transform.a <= 0 or transform.e >= 0, "write.north_up")
        place = f"1, 1, {transform.c!r}, {transform.f!r}, {transform.a!r}, {-transform.e!r}"
        epsg = crs.to_epsg() if crs is not None else None
        if epsg is not None and (32601 <= epsg <= 32660 or 32701 <= epsg <= 32760):
            side = "North" if epsg < 32700 else "South"
            info = f"UTM, {place}, {epsg % 100}, {side}, WGS-84, units=Meters"
        else:
            info = f"Arbitrary, {place}" + (", units=Meters" if crs is None or crs.is_projected else ", units=Degrees")
        entries["map info"] = "{" + info + "}"
        if crs is not None:
            entries["coordinate system string"] = "{" + crs.to_wkt(version="WKT1_ESRI") + "}"
    if axis is not None:
        entries["wavelength units"] = "Nanometers"
        entries["wavelength"] = _listed(axis.centre_nm, "{!r}")
        entries["fwhm"] = _listed(axis.fwhm_nm, "{!r}")
        entries["bbl"] = _listed(axis.good.astype(int), "{:d}")
    entries |= extra or {}
    if ignore_value is not None:
        entries["data ignore value"] = f"{ignore_value:.17g}"
    text = "ENVI\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    header = parse_header(text, path.with_suffix(".hdr"))  # what is written can be read
    with whole_file(path) as temporary:
        with open(temporary, "wb") as stream:
            stream.truncate(header.expected_bytes)
            writer = EnviWriter(stream, header, ignore_value)
            yield writer
            refuse(writer.lines_written != lines, "write.few", path, written=writer.lines_written, lines=lines)
        # Without its header a cube cannot be read: an old header never describes new data.
        header.path.unlink(missing_ok=True)
    write_text(header.path, text)


def write_cube(path: Path, values: npt.NDArray[Any], **options: Any) -> Path:
    """Write a whole array (lines, samples, bands) with the options of :func:`envi_writer`; returns ``path``."""
    lines, samples, bands = values.shape
    with envi_writer(path, lines=lines, samples=samples, bands=bands, **options) as writer:
        writer.write(values)
    return Path(path)


def _listed(values: npt.NDArray[Any], form: str) -> str:
    parts = [form.format(v) for v in values.tolist()]
    rows = [", ".join(parts[i : i + 8]) for i in range(0, len(parts), 8)]
    return "{\n " + ",\n ".join(rows) + "}"
