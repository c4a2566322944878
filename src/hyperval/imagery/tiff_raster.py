"""Stored numbers of a GeoTIFF, read by rasterio in windows."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
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
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.band_table import wavelengths_in_names
from hyperval.imagery.description import Description
from hyperval.imagery.envi_raster import header_beside
from hyperval.imagery.georeference import crs_of, transform_of
from hyperval.imagery.sidecars import described_beside
from hyperval.paths import checked_file
from hyperval.units import wavelength_to_nm

Index = npt.NDArray[np.intp]
MAX_BANDS = 20_000
MOST_COMPRESSED = 20_000  # times; a plain mask reaches a thousand
MAX_TILE_BYTES = 1 << 30
MAX_READ_BYTES = 16 << 20  # of single pixels' lines at once, and of an image that is held
TIFF_SUFFIXES = (".tif", ".tiff", ".gtif", ".gtiff", ".geotiff")
_ROUNDED_UM = 0.00051  # half of the last digit that GDAL writes into its own domain
_OPENING = threading.Lock()


@dataclass(frozen=True)
class _Bands:
    """Centres and widths [um] of the bands as the file itself states them, and what was taken for them."""

    wavelength_um: tuple[float, ...] = ()
    fwhm_um: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()


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
    tagged: _Bands = _Bands()
    bad_bands: tuple[int, ...] = ()  # from 0, as we mark them ourselves
    header: EnviHeader | None = None
    description: Description | None = None
    other_files: tuple[Path, ...] = ()

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path, *self.other_files) if self.header is None else (self.path, self.header.path)

    @cached_property
    def _pixels(self) -> npt.NDArray[Any]:
        """(lines, samples, bands) all stored numbers, of a small image."""
        with _opened(self.path) as dataset:
            return np.ascontiguousarray(dataset.read().transpose(1, 2, 0))

    @property
    def _small(self) -> bool:
        return self.lines * self.samples * self.bands * self.dtype.itemsize <= MAX_READ_BYTES

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
        if self._small:
            return np.array(self._pixels[first : first + count].transpose(2, 0, 1), order="C")
        with _opened(self.path) as dataset:
            return np.asarray(dataset.read(window=Window(0, first, self.samples, count)))

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels."""
        if self._small:  # decoded once: every call costs some time for every band
            return np.asarray(self._pixels[rows, cols])
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


@reader
def open_tiff(path: Path, header: Path | str | None, root: Path | None) -> TiffRaster:
    """Open a GeoTIFF with the header or the metadata that lie beside it.

    Raises
    ------
    InputError : not readable, mixed or complex types, a mask inside, blocks too large, or metadata that do not fit.
    """
    with _opened(path) as dataset:
        if dataset.count > MAX_BANDS:
            raise InputError(f"{dataset.count} bands", where=str(path), expected=f"at most {MAX_BANDS}")
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
        stated, stored = dataset.height * dataset.width * dataset.count * dtype.itemsize, path.stat().st_size
        if stated > stored * (MOST_COMPRESSED if dataset.compression else 1):
            raise InputError(
                f"{stored} bytes for {dataset.count} bands of {dataset.height} lines and {dataset.width} samples",
                where=str(path), expected=f"{stated} bytes of values", mend="copy the file again: it is cut short",
            )  # fmt: skip
        rows, cols = dataset.block_shapes[0]
        if rows * cols * dtype.itemsize * dataset.count > MAX_TILE_BYTES:
            raise InputError(
                f"one block of the file needs more than {MAX_TILE_BYTES >> 20} MiB", where=str(path),
                mend="rewrite it with smaller strips or tiles",
            )  # fmt: skip
        bands = _bands_in_tags(dataset, path)
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
            tagged=bands,
            bad_bands=tuple(i - 1 for i in dataset.indexes if dataset.tags(i).get("GOOD_BAND") == "0"),
        )
    sidecar = Path(header) if header is not None else header_beside(path)
    if sidecar is None:
        described = described_beside(path, raster.bands, raster.nodata, root)
        if described is None:
            return raster
        about, metadata = described
        place = (raster.transform, raster.crs) if about.rectified else (None, None)
        return replace(raster, transform=place[0], crs=place[1], description=about, other_files=(metadata,))
    parsed = read_header(checked_file(sidecar, root=root, what="ENVI header"), sidecar=True)
    shape, stated = (raster.lines, raster.samples, raster.bands), (parsed.lines, parsed.samples, parsed.bands)
    if shape != stated:
        raise InputError(
            f"the GeoTIFF has (lines, samples, bands) = {shape}, its header says {stated}", where=str(parsed.path)
        )
    transform, crs = raster.transform or transform_of(parsed), raster.crs or crs_of(parsed)
    return replace(raster, header=parsed, transform=transform, crs=crs)


def _bands_in_tags(dataset: Any, path: Path) -> _Bands:
    """What the tags of the bands say of their places; empty where a band has none, or where no unit stands.

    ``wavelength`` and ``wavelength_units``, at times with ``fwhm``, as GDAL's ENVI driver hands them on; the domain
    that GDAL has for them (CENTRAL_WAVELENGTH_UM, FWHM_UM), which the same driver fills with whole nanometres; or
    the names of the bands.
    """
    imagery = [dataset.tags(i, ns="IMAGERY") for i in dataset.indexes]
    plain = [{key.lower(): value for key, value in dataset.tags(i).items()} for i in dataset.indexes]
    units = {tags.get("wavelength_units", "").strip().lower() for tags in plain}
    per_um = {_per_um(unit) for unit in units}
    factor = per_um.pop() if len(per_um) == 1 else None

    def numbers(tags: list[dict[str, str]], key: str, factor: float | None) -> tuple[float, ...]:
        texts = [entry.get(key) for entry in tags]
        if factor is None or not all(texts):
            return ()
        try:
            values = tuple(factor * float(str(text)) for text in texts)
        except ValueError:
            values = (0.0,)
        if not all(0.0 < value < np.inf for value in values):  # NaN is none either
            raise InputError(f"tags {key!r} of the bands that are no positive numbers", where=str(path))
        return values

    centres, rounded = numbers(plain, "wavelength", factor), numbers(imagery, "CENTRAL_WAVELENGTH_UM", 1.0)
    if centres and rounded and max(abs(a - b) for a, b in zip(centres, rounded, strict=True)) > _ROUNDED_UM:
        raise InputError(
            "the bands have two wavelengths: 'wavelength' and CENTRAL_WAVELENGTH_UM of the domain IMAGERY differ",
            where=str(path), mend="name a table of the bands (collection.bands)",
        )  # fmt: skip
    widths, notes = numbers(plain, "fwhm", factor), []
    if not widths:
        widths = numbers(imagery, "FWHM_UM", 1.0)
        if widths and all(abs(1e3 * value - round(1e3 * value)) < 1e-6 for value in widths):
            notes.append("the widths are whole nanometres, to which GDAL rounds them when it converts a file")
    named = None if centres or rounded else wavelengths_in_names([name or "" for name in dataset.descriptions])
    if named is not None and (factor := _per_um(named[1] or "")) is not None:
        centres = tuple(float(factor * value) for value in named[0])
        notes.append("no tag lists wavelengths: those in the names of the bands are taken")
    return _Bands(centres or rounded, widths, tuple(notes))


def _per_um(unit: str) -> float | None:
    """Micrometres of one of a unit; None where it is none of wavelengths."""
    try:
        return wavelength_to_nm(unit) / 1e3
    except UsageError:
        return None


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
