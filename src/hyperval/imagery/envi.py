"""Writing ENVI cubes by blocks of lines: whole or not at all.

Position of an ENVI image: ``map info`` and ``coordinate system string`` to an affine transform and a CRS.

Stored numbers of an ENVI file, read with plain reads into one buffer: memory does not grow with the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.envi_header import BYTE_ORDERS, DATA_TYPES, INTERLEAVES, EnviHeader, parse_header
from hyperval.errors import InputError, UsageError
from hyperval.imagery.arrays import StoredFile
from hyperval.spectra.axis import SpectralAxis
from hyperval.storage import whole_file, write_text

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


Index = npt.NDArray[np.intp]
_PACKED = {
    b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz",
    b"(\xb5/\xfd": "zstandard", b"7z\xbc\xaf": "7-zip",
}  # fmt: skip


@dataclass(frozen=True)
class EnviRaster:
    """An ENVI data file whose size is exactly what its header says.

    Attributes
    ----------
    divisors_path : file of what its whole numbers are divided by to give radiance, where one lies beside it
    """

    path: Path
    header: EnviHeader
    divisors_path: Path | None = None
    description: None = None

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.header.lines

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.header.samples

    @property
    def bands(self) -> int:
        """Number of bands."""
        return self.header.bands

    @property
    def dtype(self) -> np.dtype:
        """Type of a stored value."""
        return self.header.dtype

    @cached_property
    def transform(self) -> Affine | None:
        """Pixel (sample, line) to map coordinates, from ``map info``."""
        return transform_of(self.header)

    @cached_property
    def crs(self) -> CRS | None:
        """Coordinate reference system, from the header."""
        return crs_of(self.header)

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path, self.header.path, *([self.divisors_path] if self.divisors_path else []))

    @cached_property
    def _file(self) -> StoredFile:
        return StoredFile(self.path)

    def kept_open(self) -> AbstractContextManager[object]:
        """Inside, the file is opened once for all reads."""
        return self._file.kept_open()

    def read_lines(self, first: int, count: int) -> npt.NDArray[Any]:
        """(count, samples, bands) stored numbers of consecutive lines."""
        return self.read_bands(first, count).transpose(1, 2, 0)

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) stored numbers of consecutive lines: a view in the order of the file.

        ``buffer`` is a flat array of ``dtype`` to read into, with room for the lines.
        """
        samples, bands, size = self.samples, self.bands, self.dtype.itemsize
        if first < 0 or count < 1 or first + count > self.lines:
            raise UsageError(f"lines {first}-{first + count - 1} of a cube of {self.lines} lines")
        wanted = count * samples * bands
        flat = np.empty(wanted, self.dtype) if buffer is None else buffer[:wanted]
        if self.header.interleave == "bsq":
            by_band = flat.reshape(bands, count, samples)
            with self._file.kept_open():
                for band in range(bands):
                    offset = self.header.header_offset + (band * self.lines + first) * samples * size
                    self._file.fill(by_band[band], offset)
            return by_band
        self._file.fill(flat, self.header.header_offset + first * samples * bands * size)
        if self.header.interleave == "bil":
            return flat.reshape(count, bands, samples).transpose(1, 0, 2)
        return flat.reshape(count, samples, bands).transpose(2, 0, 1)

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels."""
        samples, lines, bands = self.samples, self.lines, self.bands
        shape = {
            "bsq": (bands, lines, samples), "bil": (lines, bands, samples), "bip": (lines, samples, bands)
        }[self.header.interleave]  # fmt: skip
        stored = np.memmap(self.path, self.dtype, "r", self.header.header_offset, shape)
        if self.header.interleave == "bsq":
            return np.array(stored[:, rows, cols].T)
        if self.header.interleave == "bil":
            return np.array(stored[rows, :, cols])
        return np.array(stored[rows, cols])


def check_size(data: Path, header: EnviHeader) -> None:
    """Raise InputError unless the data file has exactly the size that its header describes."""
    size, expected = data.stat().st_size, header.expected_bytes
    if size == expected:
        return
    described = (
        f"{header.header_offset} + {header.samples} samples x {header.lines} lines x {header.bands} bands "
        f"x {header.dtype.itemsize} bytes = {expected} bytes ({header.path})"
    )
    packed = packing_of(data)
    if packed is not None:
        raise InputError(
            f"the data file is compressed ({packed})", where=str(data), expected=described, mend="decompress it"
        )
    if size < expected:
        missing = 100.0 * (expected - size) / expected
        what = f"the file is truncated: {size} bytes, {missing:.3g} % missing"
        mend = "copy the file again, or correct the header"
    else:
        what = f"the file is longer than its header says: {size} bytes, {size - expected} too many"
        mend = "correct the header (lines, bands, data type or header offset)"
    raise InputError(what, where=str(data), expected=described, mend=mend)


def packing_of(path: Path) -> str | None:
    """How a file is compressed, by its first bytes; None when it is not."""
    with open(path, "rb") as stream:
        head = stream.read(6)
    return next((name for mark, name in _PACKED.items() if head.startswith(mark)), None)


class EnviWriter:
    """Takes blocks of lines in order; made by :func:`envi_writer`."""

    def __init__(self, stream: Any, header: Mapping[str, Any], gain: npt.NDArray[np.float64]):
        self._stream, self._gain = stream, gain
        self.lines, self.samples, self.bands = header["lines"], header["samples"], header["bands"]
        self._interleave, self._start = header["interleave"], header["header offset"]
        self._dtype = np.dtype(BYTE_ORDERS[header["byte order"]] + DATA_TYPES[header["data type"]])
        self._ignore = header.get("data ignore value")
        self.lines_written = 0

    def write(self, block: npt.NDArray[Any]) -> None:
        """Append (lines, samples, bands) physical values.

        Raises
        ------
        UsageError : wrong shape, more lines than announced, values that do not fit the stored type.
        """
        block = np.asarray(block)
        count = block.shape[0]
        if block.ndim != 3 or block.shape[1:] != (self.samples, self.bands):
            raise UsageError(f"a block of {block.shape} for {self.samples} samples and {self.bands} bands")
        if self.lines_written + count > self.lines:
            raise UsageError(f"more than {self.lines} lines were written")
        stored = self._stored(block)
        size = self._dtype.itemsize
        if self._interleave == "bsq":
            for band in range(self.bands):
                at = self._start + (band * self.lines + self.lines_written) * self.samples * size
                self._stream.seek(at)
                self._stream.write(np.ascontiguousarray(stored[:, :, band]).tobytes())
        else:
            axes = (0, 2, 1) if self._interleave == "bil" else (0, 1, 2)
            self._stream.seek(self._start + self.lines_written * self.samples * self.bands * size)
            self._stream.write(np.ascontiguousarray(stored.transpose(axes)).tobytes())
        self.lines_written += count

    def _stored(self, block: npt.NDArray[Any]) -> npt.NDArray[Any]:
        values = block if np.all(self._gain == 1.0) else block / self._gain
        if self._dtype.kind == "f":
            return values.astype(self._dtype)
        if values.dtype.kind == "f":
            finite = np.isfinite(values)
            if not finite.all():
                if self._ignore is None:
                    raise UsageError("values that are not finite need an ignore value to be stored as integers")
                values = np.where(finite, values, self._ignore)
            values = np.rint(values)
        limits = np.iinfo(self._dtype)
        if values.size and (values.min() < limits.min or values.max() > limits.max):
            raise UsageError(
                f"values from {values.min():g} to {values.max():g} do not fit {self._dtype.name}",
                mend="choose a larger data type or another scale",
            )
        return values.astype(self._dtype)


@contextmanager
def envi_writer(
    path: Path,
    *,
    lines: int,
    samples: int,
    bands: int,
    data_type: int = 4,
    interleave: str = "bil",
    byte_order: int = 0,
    header_offset: int = 0,
    axis: SpectralAxis | None = None,
    description: str = "",
    file_type: str = "ENVI Standard",
    gain: npt.ArrayLike | None = None,
    reflectance_scale_factor: float | None = None,
    ignore_value: float | None = None,
    transform: Affine | None = None,
    crs: CRS | None = None,
    band_names: Sequence[str] | None = None,
    extra: Mapping[str, str] | None = None,
) -> Iterator[EnviWriter]:
    """Write an ENVI cube block by block; data file and header appear when the block ends well.

    Parameters
    ----------
    path : the data file; the header stands beside it with the suffix ``.hdr``
    data_type : ENVI code (1, 2, 3, 4, 5, 12, 13, 14, 15)
    axis : wavelengths [nm], widths and bad-band list for the header
    gain : scalar or (B,): values are stored divided by it, and it is written as ``data gain values``
    reflectance_scale_factor : values are stored multiplied by it, and it is written under this name
    ignore_value : stored value for no data
    transform : north-up affine transform, written as ``map info``
    extra : further header entries as text, in order

    Raises
    ------
    UsageError : an unknown type, interleave or byte order, both kinds of scale, too few lines.
    """
    path = Path(path)
    if path.suffix.lower() == ".hdr":
        raise UsageError("name the data file, not the header", where=str(path))
    if interleave not in INTERLEAVES or byte_order not in BYTE_ORDERS or data_type not in DATA_TYPES:
        raise UsageError(
            f"cannot write interleave {interleave!r}, byte order {byte_order}, data type {data_type}",
            expected=f"{INTERLEAVES}, {tuple(BYTE_ORDERS)}, {tuple(DATA_TYPES)}",
        )
    if gain is not None and reflectance_scale_factor is not None:
        raise UsageError("a cube has either a gain or a reflectance scale factor")
    factor = np.ones(bands)
    if gain is not None:
        factor = np.broadcast_to(np.asarray(gain, dtype=float), (bands,)).copy()
    elif reflectance_scale_factor is not None:
        factor = np.full(bands, 1.0 / reflectance_scale_factor)
    entries: dict[str, Any] = {
        "description": "{" + description + "}",
        "samples": samples,
        "lines": lines,
        "bands": bands,
        "header offset": header_offset,
        "file type": file_type,
        "data type": data_type,
        "interleave": interleave,
        "byte order": byte_order,
    }
    if gain is not None:
        entries["data gain values"] = _listed(factor, "{!r}")
        entries["data offset values"] = _listed(np.zeros(bands), "{:g}")
    if reflectance_scale_factor is not None:
        entries["reflectance scale factor"] = repr(float(reflectance_scale_factor))
    entries |= _georeference(transform, crs)
    if axis is not None:
        if len(axis) != bands:
            raise UsageError(f"an axis of {len(axis)} bands for a cube of {bands}")
        entries["wavelength units"] = "Nanometers"
        entries["wavelength"] = _listed(axis.centre_nm, "{!r}")
        entries["fwhm"] = _listed(axis.fwhm_nm, "{!r}")
        entries["bbl"] = _listed(axis.good.astype(int), "{:d}")
    if band_names is not None:
        entries["band names"] = "{" + ", ".join(band_names) + "}"
    entries |= dict(extra or {})
    if ignore_value is not None:
        entries["data ignore value"] = f"{ignore_value:.17g}"
    text = "ENVI\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
    header_path = path.with_suffix(".hdr")
    size = parse_header(text, header_path).expected_bytes  # what is written can be read
    entries["data ignore value"] = ignore_value
    with whole_file(path) as temporary:
        with open(temporary, "wb") as stream:
            stream.truncate(size)
            writer = EnviWriter(stream, entries, factor)
            yield writer
            if writer.lines_written != lines:
                raise UsageError(f"{writer.lines_written} of {lines} lines were written", where=str(path))
        # Without its header a cube cannot be read: an old header never describes new data.
        header_path.unlink(missing_ok=True)
    write_text(header_path, text)


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


def _georeference(transform: Affine | None, crs: CRS | None) -> dict[str, str]:
    if transform is None:
        return {}
    if transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        raise UsageError("only a north-up transform can be written as 'map info'")
    place = f"1, 1, {transform.c!r}, {transform.f!r}, {transform.a!r}, {-transform.e!r}"
    epsg = crs.to_epsg() if crs is not None else None
    if epsg is not None and (32601 <= epsg <= 32660 or 32701 <= epsg <= 32760):
        side = "North" if epsg < 32700 else "South"
        info = f"UTM, {place}, {epsg % 100}, {side}, WGS-84, units=Meters"
    else:
        info = f"Arbitrary, {place}" + (", units=Meters" if crs is None or crs.is_projected else ", units=Degrees")
    out = {"map info": "{" + info + "}"}
    if crs is not None:
        out["coordinate system string"] = "{" + crs.to_wkt(version="WKT1_ESRI") + "}"
    return out
