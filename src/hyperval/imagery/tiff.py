"""GeoTIFFs, read by rasterio in windows, with the ENVI header or the metadata that lie beside them."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from affine import Affine
from rasterio.enums import MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from hyperval.envi_header import EnviHeader, header_beside
from hyperval.errors import reader, refusal, refuse
from hyperval.imagery.arrays import quantity_of
from hyperval.imagery.description import MAX_READ_BYTES, Description, ListedBands, Raster, Scale
from hyperval.imagery.envi import described_by
from hyperval.imagery.products import NO_MAP, described_beside
from hyperval.units import in_nm

MAX_BANDS = 20_000
MAX_COMPRESSED = 20_000  # times; a plain mask reaches a thousand
MAX_TILE_BYTES = 1 << 30
TIFF_SUFFIXES = (".tif", ".tiff", ".gtif", ".gtiff", ".geotiff")
TIFF_MARKS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_FACTOR = "reflectance_scale_factor"  # in the domain ENVI
_ROUNDED_NM = 0.51  # half of the last digit that GDAL writes into its own domain
_OPENING = threading.Lock()


@dataclass(frozen=True, eq=False)
class TiffRaster(Raster):
    """A GeoTIFF, opened by name of its driver and without the sidecar files that change its meaning."""

    kind = "GeoTIFF"

    @cached_property
    def _pixels(self) -> npt.NDArray[Any] | None:
        """(bands, lines, samples) all stored numbers of a small image: every call costs some time for every band."""
        if self.lines * self.samples * self.bands * self.dtype.itemsize > MAX_READ_BYTES:
            return None
        with _opened(self.path) as dataset:
            return np.asarray(dataset.read())

    def _box(self, bands: slice, lines: slice, samples: slice) -> npt.NDArray[Any]:
        if self._pixels is not None:
            return self._pixels[bands, lines, samples]
        with _opened(self.path) as dataset:
            return np.asarray(dataset.read(dataset.indexes[bands], window=Window.from_slices(lines, samples)))


@reader
def open_tiff(path: Path, header: Path | str | None) -> Raster:
    """Open a GeoTIFF with the header or the metadata that lie beside it.

    >>> from tempfile import TemporaryDirectory
    >>> made = {"driver": "GTiff", "height": 9, "width": 9, "count": 1, "dtype": "int16", "transform": Affine.scale(2)}
    >>> with TemporaryDirectory() as folder, rasterio.open(f"{folder}/x.tif", "w", **made) as x:
    ...     x.update_tags(ns="ENVI", reflectance_scale_factor="10000")
    ...     x.close()
    ...     open_tiff(Path(x.name), None).description.scales("reflectance")[0].gain
    0.0001

    Raises
    ------
    InputError : not readable, mixed or complex types, a mask inside, blocks too large, or metadata that do not fit.
    """
    with _opened(path) as dataset:
        dtype = _checked_type(dataset, path)
        transform = None if dataset.transform == Affine.identity() else dataset.transform
        scale = Scale(np.array(dataset.scales), np.array(dataset.offsets), "scale and offset tags of the GeoTIFF")
        units = set(dataset.units)
        quantity, unit, notes = quantity_of(units.pop() if len(units) == 1 else None, "", "")
        size, factor = (dataset.height, dataset.width, dataset.count), dataset.tags(ns="ENVI").get(_FACTOR)
        entries = {_FACTOR.replace("_", " "): factor} if factor and not scale.changes else {}  # and no more than that
        tagged = EnviHeader(path, dataset.width, dataset.height, dataset.count, 0, "tif", 0, 0, entries=entries)
        bands = _bands_in_tags(dataset, tagged)
        about = Description("", bands, scale, quantity, unit, dataset.nodata, notes=notes, header=tagged)
        raster = TiffRaster(path, *size, dtype, about, transform, dataset.crs)
    sidecar = Path(header) if header is not None else header_beside(path)
    described = described_beside(path, raster.bands, about.ignore_value) if header is None else None
    if described is not None and (sidecar is None or described[1].suffix.lower() == ".xml"):  # of a product it knows
        found, metadata = described
        raster = replace(raster, description=found, other_files=(metadata,))
        return replace(raster, transform=None, crs=None) if NO_MAP in found.notes else raster
    return raster if sidecar is None else described_by(raster, sidecar)


def _checked_type(dataset: Any, path: Path) -> np.dtype:
    """The type of the values; InputError for what cannot be read by blocks of lines as plain numbers.

    >>> from types import SimpleNamespace
    >>> _checked_type(SimpleNamespace(height=9, width=9, count=1, subdatasets=["page"] * 40), Path("x.tif"))
    Traceback (most recent call last):
    hyperval.errors.InputError: x.tif: 40 pages of one band each
      expected: an image of which every band is one of the same page
      to fix it: make bands of its pages, in Python: np.save('x.npy', np.moveaxis(tifffile.imread('x.tif'), 0, -1))
    """
    lines, samples, count = dataset.height, dataset.width, dataset.count
    refuse(count == 1 and dataset.subdatasets, "tiff.pages", path, pages=len(dataset.subdatasets), name=path.name)
    refuse(count > MAX_BANDS, "tiff.bands", path, count=count, most=MAX_BANDS)
    names = set(dataset.dtypes)
    refuse(len(names) != 1 or not np.issubdtype(np.dtype(names.pop()), np.number), "tiff.types", path)
    dtype: np.dtype = np.dtype(dataset.dtypes[0])
    refuse(dtype.kind == "c", "tiff.complex", path)
    refuse(any(MaskFlags.per_dataset in flags for flags in dataset.mask_flag_enums), "tiff.mask", path)
    stated, stored = lines * samples * count * dtype.itemsize, path.stat().st_size
    if stated > stored * (MAX_COMPRESSED if dataset.compression else 1):
        raise refusal("tiff.short", path, stored=stored, stated=stated, count=count, lines=lines, samples=samples)
    rows, cols = dataset.block_shapes[0]
    refuse(rows * cols * dtype.itemsize * count > MAX_TILE_BYTES, "tiff.block", path, mib=MAX_TILE_BYTES >> 20)
    return dtype


def _bands_in_tags(dataset: Any, header: EnviHeader) -> ListedBands | None:
    """What the tags say of the bands, as the entries of an ENVI header; those of each band, or lists of the data set.

    ``wavelength`` and ``wavelength_units``, at times with ``fwhm``, as GDAL's ENVI driver hands them on, among the
    plain tags or in the domain ENVI; else the domain that GDAL has for them (CENTRAL_WAVELENGTH_UM, FWHM_UM), which the
    same driver fills with whole nanometres; else the names of the bands.
    """
    texts: dict[str, Sequence[str]] = {}
    for domain in ("IMAGERY", "ENVI", None):  # the last overrides
        each = [_lower(dataset.tags(i, ns=domain)) for i in dataset.indexes]
        common = _lower(dataset.tags(ns=domain))
        for key in each[0].keys() | common.keys():
            values = [str(tags.get(key, "")) for tags in each]
            if not all(values):
                values = [part.strip() for part in common.get(key, "").strip("{} ").split(",")]
            if (len(values) == dataset.count and all(values)) or key == "wavelength units":
                texts[key] = values
    units = set(texts.get("wavelength units", ())) - {""}
    if sum(in_nm(unit) is not None for unit in units) > 1:  # others are no units at all
        texts.pop("wavelength", None)
    if "wavelength" not in texts:
        texts.pop("fwhm", None)
        if "central_wavelength_um" in texts:
            texts["wavelength"], units = texts["central_wavelength_um"], {"um"}
    texts["wavelength units"] = [*units] if len(units) == 1 else []
    texts["band names"] = [name or "" for name in dataset.descriptions]
    texts["bbl"] = texts.get("good_band") or texts.get("bbl", ())
    header = replace(header, entries={key: ", ".join(values) for key, values in texts.items()})
    listed, to_nm = Description(header=header).listed(), in_nm(header.text("wavelength units"))
    rounded, width = (header.numbers(key) for key in ("central_wavelength_um", "fwhm_um"))
    if listed is None or to_nm is None:
        return listed
    difference_nm = 0.0 if rounded is None else np.max(np.abs(listed.wavelength * to_nm - rounded * 1e3))
    refuse(difference_nm > _ROUNDED_NM, "tiff.two_wavelengths", header.path)
    if listed.fwhm is not None or width is None:
        return listed
    is_whole = np.all(np.abs(1e3 * width - np.round(1e3 * width)) < 1e-6)
    note = "the widths are whole nanometres, to which GDAL rounds them when it converts a file"
    return listed._replace(fwhm=width * (1e3 / to_nm), notes=(*listed.notes, *([note] if is_whole else [])))


def _lower(tags: Mapping[str, str]) -> dict[str, str]:
    return {key.lower().replace("wavelength_units", "wavelength units"): value for key, value in tags.items()}


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
        raise refusal("tiff.unreadable", path, why=error) from error
