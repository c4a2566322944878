"""Stored numbers of a raster, by lines or by pixels, whatever the file format.

An ENVI file is read with plain reads into one buffer, so that memory does not grow with the file;
a GeoTIFF is read by rasterio in windows.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.enums import MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from hyperval.envi_header import EnviHeader, read_header
from hyperval.errors import InputError, UsageError
from hyperval.imagery.georeference import crs_of, transform_of
from hyperval.imagery.stored_file import StoredFile
from hyperval.paths import checked_file

Index = npt.NDArray[np.intp]
MAX_TILE_BYTES = 1 << 30
MAX_READ_BYTES = 16 << 20  # of single pixels' lines at once
TIFF_SUFFIXES = (".tif", ".tiff", ".gtif", ".gtiff", ".geotiff")
_CONTAINERS = {
    b"MATLAB 7.3": "MATLAB 7.3 (HDF5)",
    b"MATLAB": "MATLAB",
    b"\x89HDF\r\n\x1a\n": "HDF5 or NetCDF-4",
    b"CDF\x01": "NetCDF-3",
    b"CDF\x02": "NetCDF-3",
    b"\x0e\x03\x13\x01": "HDF4",
    b"\x93NUMPY": "NumPy",
}
_PER_UM = {"nanometers": 1e-3, "nanometer": 1e-3, "nm": 1e-3, "micrometers": 1.0, "micrometer": 1.0, "um": 1.0}
_OPENING = threading.Lock()
_PACKED = {
    b"\x1f\x8b": "gzip", b"PK\x03\x04": "zip", b"BZh": "bzip2", b"\xfd7zXZ\x00": "xz",
    b"(\xb5/\xfd": "zstandard", b"7z\xbc\xaf": "7-zip",
}  # fmt: skip
_DATA_SUFFIXES = ("", ".img", ".dat", ".raw", ".bil", ".bsq", ".bip", ".rad", ".cub", ".sli", ".lib")


@dataclass(frozen=True)
class EnviRaster:
    """An ENVI data file whose size is exactly what its header says."""

    path: Path
    header: EnviHeader

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
        return (self.path, self.header.path)

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


@dataclass(frozen=True)
class TiffRaster:
    """A GeoTIFF, opened by name of its driver and without the sidecar files that change its meaning."""

    path: Path
    lines: int
    samples: int
    bands: int
    dtype: np.dtype
    transform: Affine | None
    crs: CRS | None
    nodata: float | None = None
    gains: tuple[float, ...] = ()
    offsets: tuple[float, ...] = ()
    wavelength_um: tuple[float, ...] = ()
    fwhm_um: tuple[float, ...] = ()
    bad_bands: tuple[int, ...] = ()  # from 0, as we mark them ourselves
    header: EnviHeader | None = None

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path,) if self.header is None else (self.path, self.header.path)

    def kept_open(self) -> AbstractContextManager[object]:
        """Nothing: each read opens the file, since a data set of GDAL serves one thread only."""
        return nullcontext()

    def read_lines(self, first: int, count: int) -> npt.NDArray[Any]:
        """(count, samples, bands) stored numbers of consecutive lines."""
        return self.read_bands(first, count).transpose(1, 2, 0)

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) stored numbers of consecutive lines; ``buffer`` is not used."""
        if first < 0 or count < 1 or first + count > self.lines:
            raise UsageError(f"lines {first}-{first + count - 1} of a cube of {self.lines} lines")
        with _opened(self.path) as dataset:
            return dataset.read(window=Window(0, first, self.samples, count))

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels."""
        out = np.empty((rows.size, self.bands), self.dtype)
        if not rows.size:
            return out
        lines = np.unique(rows)
        # Each call costs some time for every band: lines that follow each other are read at once.
        most = max(1, MAX_READ_BYTES // (self.samples * self.bands * self.dtype.itemsize))
        run = np.cumsum(np.diff(lines, prepend=lines[0]) > 1)
        with _opened(self.path) as dataset:
            for together in np.split(lines, np.flatnonzero(np.diff(run)) + 1):
                for first in range(int(together[0]), int(together[-1]) + 1, most):
                    count = min(most, int(together[-1]) + 1 - first)
                    here = (rows >= first) & (rows < first + count)
                    left, right = int(cols[here].min()), int(cols[here].max()) + 1
                    stored = dataset.read(window=Window(left, first, right - left, count))
                    out[here] = stored[:, rows[here] - first, cols[here] - left].T
        return out


Raster = EnviRaster | TiffRaster


def open_raster(path: Path | str, *, header: Path | str | None = None, root: Path | None = None) -> Raster:
    """Open an ENVI file (data file or header may be named) or a GeoTIFF with or without a sidecar header.

    Raises
    ------
    InputError : a file is missing, truncated, too long, or contradicts its header.
    UsageError : a path that may not be opened, or two headers to choose from.
    """
    if Path(path).suffix.lower() in TIFF_SUFFIXES:
        return _open_tiff(checked_file(path, root=root, what="GeoTIFF"), header, root)
    data = Path(path)
    if header is None and data.suffix.lower() == ".hdr":
        header = checked_file(data, root=root, what="ENVI header")
        data = _data_beside(data)
    data = checked_file(data, root=root, what="ENVI data file")
    if data.suffix.lower() == ".hdr":
        raise UsageError("the cube is a header file", where=str(data), mend="name the data file")
    found = Path(header) if header is not None else header_beside(data)
    if found is None:
        container = container_of(data)
        if container is not None:
            raise InputError(
                f"a {container} file, which is not read as a cube",
                where=str(data),
                expected="an ENVI cube with its header, or a GeoTIFF",
                mend="save its array as an ENVI cube, wavelengths in the header (docs/formats.md, Other formats)",
            )
        raise InputError(
            "no header beside the data file",
            where=str(data),
            expected=f"{data.name}.hdr or {data.with_suffix('.hdr').name}",
        )
    parsed = read_header(checked_file(found, root=root, what="ENVI header"))
    check_size(data, parsed)
    return EnviRaster(data, parsed)


def header_beside(data: Path) -> Path | None:
    """The header of a data file: ``name.img.hdr`` or ``name.hdr``; None when there is none."""
    candidates = {data.with_name(data.name + end) for end in (".hdr", ".HDR")}
    candidates |= {data.with_suffix(end) for end in (".hdr", ".HDR")}
    found = sorted(p for p in candidates if p.is_file())
    # One file under two names on a file system that ignores case is one header.
    unique = {p.resolve().stat().st_ino: p for p in reversed(found)}
    if len(unique) > 1:
        raise UsageError(
            "two headers beside the data file: " + ", ".join(p.name for p in found),
            where=str(data),
            mend="state which one is meant (header:)",
        )
    return next(iter(unique.values()), None)


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


def container_of(path: Path) -> str | None:
    """What other kind of file of arrays this is, by its first bytes; None when it is none that is known."""
    with open(path, "rb") as stream:
        head = stream.read(16)
    return next((name for mark, name in _CONTAINERS.items() if head.startswith(mark)), None)


def packing_of(path: Path) -> str | None:
    """How a file is compressed, by its first bytes; None when it is not."""
    with open(path, "rb") as stream:
        head = stream.read(6)
    return next((name for mark, name in _PACKED.items() if head.startswith(mark)), None)


def _data_beside(header: Path) -> Path:
    stem = header.with_suffix("")
    found = [stem.with_name(stem.name + end) for end in _DATA_SUFFIXES]
    found = [p for p in found if p.is_file()]
    if len(found) != 1:
        names = ", ".join(p.name for p in found) or "none"
        raise InputError(
            f"data files beside the header: {names}", where=str(header), mend="name the data file instead"
        )
    return found[0]


def _open_tiff(path: Path, header: Path | str | None, root: Path | None) -> TiffRaster:
    with _opened(path) as dataset:
        names = set(dataset.dtypes)
        if len(names) != 1 or not np.issubdtype(np.dtype(names.pop()), np.number):
            raise InputError("bands of different or unknown types", where=str(path))
        dtype = np.dtype(dataset.dtypes[0])
        if dtype.kind == "c":
            raise InputError("complex values cannot be read", where=str(path))
        if any(MaskFlags.per_dataset in flags for flags in dataset.mask_flag_enums):
            raise InputError(
                "a mask or alpha band in the file, which would not be heeded", where=str(path),
                mend="rewrite it without, the masked pixels holding a no-data value",
            )  # fmt: skip
        rows, cols = dataset.block_shapes[0]
        if rows * cols * dtype.itemsize * dataset.count > MAX_TILE_BYTES:
            raise InputError(
                f"one block of the file needs more than {MAX_TILE_BYTES >> 20} MiB", where=str(path),
                mend="rewrite it with smaller strips or tiles",
            )  # fmt: skip
        waves, widths = _band_wavelengths_um(dataset, path)
        raster = TiffRaster(
            path=path,
            lines=dataset.height,
            samples=dataset.width,
            bands=dataset.count,
            dtype=dtype,
            transform=None if dataset.transform == Affine.identity() else dataset.transform,
            crs=dataset.crs,
            nodata=dataset.nodata,
            gains=tuple(dataset.scales),
            offsets=tuple(dataset.offsets),
            wavelength_um=waves,
            fwhm_um=widths,
            bad_bands=tuple(i - 1 for i in dataset.indexes if dataset.tags(i).get("GOOD_BAND") == "0"),
        )
    found = Path(header) if header is not None else header_beside(path)
    if found is None:
        return raster
    parsed = read_header(checked_file(found, root=root, what="ENVI header"), sidecar=True)
    shape, stated = (raster.lines, raster.samples, raster.bands), (parsed.lines, parsed.samples, parsed.bands)
    if shape != stated:
        raise InputError(
            f"the GeoTIFF has (lines, samples, bands) = {shape}, its header says {stated}", where=str(parsed.path)
        )
    transform, crs = raster.transform or transform_of(parsed), raster.crs or crs_of(parsed)
    return TiffRaster(**{**raster.__dict__, "header": parsed, "transform": transform, "crs": crs})


def _band_wavelengths_um(dataset: Any, path: Path) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Band centres and widths [um] in the tags of the bands; empty where a band has none, or where no unit stands.

    Either in GDAL's own domain for them (CENTRAL_WAVELENGTH_UM, FWHM_UM), or as its ENVI driver hands them to other
    formats: ``wavelength`` and ``wavelength_units``, at times with ``fwhm``.
    """
    imagery = [dataset.tags(i, ns="IMAGERY") for i in dataset.indexes]
    plain = [{key.lower(): value for key, value in dataset.tags(i).items()} for i in dataset.indexes]
    units = {tags.get("wavelength_units", "").strip().lower() for tags in plain}
    per_um = {_PER_UM.get(unit) for unit in units}
    factor = per_um.pop() if len(per_um) == 1 else None

    def listed(domain_key: str, key: str) -> tuple[float, ...]:
        own = [tags.get(domain_key) for tags in imagery]
        factors, texts = (1.0, own) if all(own) else (factor, [tags.get(key) for tags in plain])
        if factors is None or not all(texts):
            return ()
        try:
            numbers = tuple(factors * float(str(text)) for text in texts)
        except ValueError:
            numbers = (0.0,)
        if not all(0.0 < number < np.inf for number in numbers):  # NaN is none either
            raise InputError(f"tags {key!r} of the bands that are no positive numbers", where=str(path))
        return numbers

    return listed("CENTRAL_WAVELENGTH_UM", "wavelength"), listed("FWHM_UM", "fwhm")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    # No auxiliary files and no listing of the folder: neither .aux.xml, .msk nor .ovr can change what is read.
    options = {"GDAL_PAM_ENABLED": "NO", "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR"}
    try:
        with rasterio.Env(**options):
            # One at a time: the list of ignored warnings belongs to the process, and blocks are read by threads.
            with _OPENING, warnings.catch_warnings():
                warnings.simplefilter("ignore", NotGeoreferencedWarning)
                opened = rasterio.open(path, driver="GTiff")
            with opened as dataset:
                yield dataset
    except RasterioError as error:
        raise InputError(f"not a readable GeoTIFF: {error}", where=str(path)) from error
