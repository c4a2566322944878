"""GeoTIFFs, read by rasterio in windows, with what lies beside them: an ENVI header, METADATA.XML, an item of STAC."""

from __future__ import annotations

import json
import re
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import rasterio
from affine import Affine
from rasterio.enums import MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from hyperval.envi_header import header_beside, read_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.description import (
    MAX_READ_BYTES,
    Description,
    Index,
    ListedBands,
    Raster,
    Scale,
    header_description,
    wavelengths_in_names,
)
from hyperval.imagery.envi import crs_of, transform_of
from hyperval.imagery.products import ProductLayout, layouts
from hyperval.paths import checked_file, read_xml
from hyperval.units import radiance_to_internal, wavelength_to_nm

MAX_BANDS = 20_000
MOST_COMPRESSED = 20_000  # times; a plain mask reaches a thousand
MAX_TILE_BYTES = 1 << 30
TIFF_SUFFIXES = (".tif", ".tiff", ".gtif", ".gtiff", ".geotiff")
TIFF_MARKS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_ROUNDED_NM = 0.51  # half of the last digit that GDAL writes into its own domain
_OPENING = threading.Lock()
MAX_XML_BYTES = 64 << 20
MAX_JSON_BYTES = 4 << 20
MAX_ITEMS = 20  # files of JSON that are looked at for one that names the image
NO_MAP = "in scanner geometry: a map position of the file is a fit to its corners and is left aside"
_UNRECTIFIED = "one detector in scanner geometry: the other sees a place some lines apart, as a cube of its own"


@dataclass(frozen=True, eq=False)
class TiffRaster(Raster):
    """A GeoTIFF, opened by name of its driver and without the sidecar files that change its meaning."""

    kind = "GeoTIFF"

    @cached_property
    def _pixels(self) -> npt.NDArray[Any] | None:
        """(lines, samples, bands) all stored numbers of a small image: every call costs some time for every band."""
        if self.lines * self.samples * self.bands * self.dtype.itemsize > MAX_READ_BYTES:
            return None
        with _opened(self.path) as dataset:
            return np.ascontiguousarray(dataset.read().transpose(1, 2, 0))

    def _read(self, first: int, count: int, buffer: npt.NDArray[Any] | None) -> npt.NDArray[Any]:
        if self._pixels is not None:
            return np.array(self._pixels[first : first + count].transpose(2, 0, 1), order="C")
        with _opened(self.path) as dataset:
            return np.asarray(dataset.read(window=Window(0, first, self.samples, count)))

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) stored numbers of single pixels."""
        return super().read_pixels(rows, cols) if self._pixels is None else np.asarray(self._pixels[rows, cols])

    def _window(self, lines: slice, samples: slice) -> Iterator[tuple[int, npt.NDArray[Any]]]:
        size = samples.stop - samples.start, lines.stop - lines.start
        with _opened(self.path) as dataset:
            yield 0, dataset.read(window=Window(samples.start, lines.start, *size))


@reader
def open_tiff(path: Path, header: Path | str | None, root: Path | None) -> TiffRaster:
    """Open a GeoTIFF with the header or the metadata that lie beside it.

    Raises
    ------
    InputError : not readable, mixed or complex types, a mask inside, blocks too large, or metadata that do not fit.
    """
    with _opened(path) as dataset:
        dtype = _checked_type(dataset, path)
        transform = None if dataset.transform == Affine.identity() else dataset.transform
        scale = Scale(np.array(dataset.scales), np.array(dataset.offsets), "scale and offset tags of the GeoTIFF")
        about = Description(bands=_bands_in_tags(dataset, path), scale=scale, ignore_value=dataset.nodata)
        size = dataset.height, dataset.width, dataset.count
        raster = TiffRaster(path, size, dtype, about, (transform, dataset.crs))
    sidecar = Path(header) if header is not None else header_beside(path)
    if sidecar is None:
        described = described_beside(path, raster.bands, about.ignore_value, root)
        if described is None:
            return raster
        found, metadata = described
        place = (None, None) if NO_MAP in found.notes else raster.position
        return replace(raster, position=place, description=found, other_files=(metadata,))
    parsed = read_header(checked_file(sidecar, root=root, what="ENVI header"), sidecar=True)
    stated = parsed.lines, parsed.samples, parsed.bands
    if size != stated:
        raise InputError(
            f"the GeoTIFF has (lines, samples, bands) = {size}, its header says {stated}", where=str(parsed.path)
        )
    place = raster.transform or transform_of(parsed), raster.crs or crs_of(parsed)
    return replace(raster, description=header_description(parsed, about), position=place, other_files=(parsed.path,))


def _checked_type(dataset: Any, path: Path) -> np.dtype:
    """The type of the values; InputError for what cannot be read by blocks of lines as plain numbers."""

    def refused(what: str, mend: str | None = None, expected: str | None = None) -> InputError:
        return InputError(what, where=str(path), expected=expected, mend=mend)

    if dataset.count > MAX_BANDS:
        raise refused(f"{dataset.count} bands", expected=f"at most {MAX_BANDS}")
    names = set(dataset.dtypes)
    if len(names) != 1 or not np.issubdtype(np.dtype(names.pop()), np.number):
        raise refused("bands of different or unknown types")
    dtype: np.dtype = np.dtype(dataset.dtypes[0])
    if dtype.kind == "c":
        raise refused("complex values cannot be read")
    if any(MaskFlags.per_dataset in flags for flags in dataset.mask_flag_enums):
        raise refused(
            "a mask or alpha band in the file, which would not be heeded",
            "rewrite it without, the masked pixels holding a no-data value",
        )
    stated, stored = dataset.height * dataset.width * dataset.count * dtype.itemsize, path.stat().st_size
    if stated > stored * (MOST_COMPRESSED if dataset.compression else 1):
        raise refused(
            f"{stored} bytes for {dataset.count} bands of {dataset.height} lines and {dataset.width} samples",
            "copy the file again: it is cut short",
            f"{stated} bytes of values",
        )
    rows, cols = dataset.block_shapes[0]
    if rows * cols * dtype.itemsize * dataset.count > MAX_TILE_BYTES:
        raise refused(
            f"one block of the file needs more than {MAX_TILE_BYTES >> 20} MiB",
            "rewrite it with smaller strips or tiles",
        )
    return dtype


def _bands_in_tags(dataset: Any, path: Path) -> ListedBands | None:
    """What the tags say of the bands, those of each band or lists of the data set; None where a band has none.

    ``wavelength`` and ``wavelength_units``, at times with ``fwhm``, as GDAL's ENVI driver hands them on, among the
    plain tags or in the domain ENVI; the domain that GDAL has for them (CENTRAL_WAVELENGTH_UM, FWHM_UM), which the
    same driver fills with whole nanometres; or the names of the bands.
    """
    texts: dict[str, Sequence[str]] = {}
    for domain in ("IMAGERY", "ENVI", None):  # the last has the last word
        each = [_lower(dataset.tags(i, ns=domain)) for i in dataset.indexes]
        whole = _lower(dataset.tags(ns=domain))
        for key in each[0].keys() | whole.keys():
            values = [str(tags.get(key, "")) for tags in each]
            if not all(values):
                values = [part.strip() for part in whole.get(key, "").strip("{} ").split(",")]
            if (len(values) == dataset.count and all(values)) or key == "wavelength units":
                texts[key] = values
    centre, rounded = _numbers(texts, "wavelength", path), _numbers(texts, "central_wavelength_um", path)
    width, rounded_width = _numbers(texts, "fwhm", path), _numbers(texts, "fwhm_um", path)
    units = set(texts.get("wavelength units", ())) - {""}
    if len(units) > 1 and any(_to_nm(unit) is not None for unit in units):  # others are no units at all
        centre = width = None
    unit, notes = units.pop() if len(units) == 1 else None, []
    to_nm = _to_nm(unit)
    if centre is None and rounded is None:
        named = wavelengths_in_names([name or "" for name in dataset.descriptions])
        if named is None or (to_nm := _to_nm(named[1])) is None:
            return None
        (centre, unit), width = named, None
        notes.append("no tag lists wavelengths: those in the names of the bands are taken")
    elif centre is None:
        centre, unit, to_nm = rounded, "um", 1e3
    elif rounded is not None and to_nm is not None and np.max(np.abs(centre * to_nm - rounded * 1e3)) > _ROUNDED_NM:
        raise InputError(
            "the bands have two wavelengths: 'wavelength' and CENTRAL_WAVELENGTH_UM of the domain IMAGERY differ",
            where=str(path),
            mend="name a table of the bands (collection.bands)",
        )
    if width is None and rounded_width is not None and to_nm is not None:
        width = rounded_width * (1e3 / to_nm)
        if np.all(np.abs(1e3 * rounded_width - np.round(1e3 * rounded_width)) < 1e-6):
            notes.append("the widths are whole nanometres, to which GDAL rounds them when it converts a file")
    flags = texts.get("good_band") or texts.get("bbl")
    assert centre is not None  # noqa: S101 - one of the three ways gave it
    return ListedBands(centre, width, unit, np.array([f != "0" for f in flags]) if flags else None, {}, tuple(notes))


def _lower(tags: Mapping[str, str]) -> dict[str, str]:
    return {key.lower().replace("wavelength_units", "wavelength units"): value for key, value in tags.items()}


def _numbers(texts: Mapping[str, Sequence[str]], key: str, path: Path) -> npt.NDArray[np.float64] | None:
    if key not in texts:
        return None
    try:
        values = np.array([float(text) for text in texts[key]])
    except ValueError:
        values = np.zeros(1)
    if not np.all((values > 0.0) & (values < np.inf)):  # NaN is none either
        raise InputError(f"tags {key!r} of the bands that are no positive numbers", where=str(path))
    return values


def _to_nm(unit: str | None) -> float | None:
    """Nanometres of one of a unit; None where it is none of wavelengths."""
    try:
        return wavelength_to_nm(unit or "")
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


def described_beside(
    image: Path, bands: int, nodata: float | None = None, root: Path | None = None
) -> tuple[Description, Path] | None:
    """What the metadata beside a GeoTIFF of ``bands`` bands say of it, and their file; None where there are none.

    ``nodata`` : as the GeoTIFF itself states it, where the metadata do not.

    Raises
    ------
    InputError : metadata that are too large, not understood, or of another number of bands.
    """
    for sidecar in layouts().sidecars:
        at = image.name.upper().find(sidecar.image.upper())
        for name in (sidecar.metadata, sidecar.metadata.lower(), sidecar.metadata.upper()) if at >= 0 else ():
            path = image.with_name(image.name[:at] + name)
            if path.is_file():
                made = _from_xml(sidecar, checked_file(path, root=root, what="metadata file"), image, bands)
                if made is not None:
                    fill = sidecar.fill if nodata is None else nodata
                    return (replace(made, ignore_value=fill) if made.ignore_value is None else made), path
    for path, item, asset in _stac_assets(image, root):
        described = _from_asset(item, asset, bands)
        if described is not None:
            return (replace(described, ignore_value=nodata) if described.ignore_value is None else described), path
    return None


def image_of(metadata: Path, detector: str | None = None) -> Path:
    """The GeoTIFF that a METADATA.XML belongs to; of level 1B of EnMAP that of ``detector``, VNIR or SWIR.

    The two detectors of level 1B are two cubes: each sees a place some lines before the other, neither is on a map,
    and no shift by whole pixels lays one on the other.

    Raises
    ------
    InputError : no image.
    UsageError : several, and none or another one is named.
    """
    sidecar = next((s for s in layouts().sidecars if metadata.name.upper().endswith(s.metadata.upper())), None)
    if sidecar is None:
        raise InputError("no metadata of a product that is known", where=str(metadata), expected="...-METADATA.XML")
    stem = metadata.name[: -len(sidecar.metadata)]
    start = (stem + sidecar.image).upper()
    tiffs = [p for p in sorted(metadata.parent.iterdir()) if p.suffix.upper() in (".TIF", ".TIFF")]
    fits = [p for p in tiffs if p.name.upper().startswith(start)]
    if not fits:
        raise InputError(f"no image {stem}{sidecar.image}... beside it", where=str(metadata))
    # The same image may lie there again, cut into tiles for the cloud.
    fits.sort(key=lambda p: not p.stem.upper().endswith("_COG"))
    of_detector = {p.stem[len(start) :].upper().removesuffix("_COG").strip("_"): p for p in fits}
    if detector is None and len(of_detector) == 1:
        return next(iter(of_detector.values()))
    if detector is not None and detector.upper() in of_detector:
        return of_detector[detector.upper()]
    names = ", ".join(p.name for p in of_detector.values())
    raise UsageError(
        f"{len(of_detector)} images could be meant: {names}",
        where=str(metadata),
        expected="variable: " + " or ".join(of_detector),
        mend="state the detector; those of level 1B see a place some lines apart and are no one cube, "
        "level 1C has them on one grid",
    )


def _from_xml(sidecar: ProductLayout, path: Path, image: Path, bands: int) -> Description | None:
    root = read_xml(path, MAX_XML_BYTES)
    items = root.findall(sidecar.bands)
    if not items:
        return None
    numbers = [_number(item.get("number"), "number of a band", path) for item in items if "number" in item.attrib]
    if numbers:  # of the band in the image, in whatever order the elements stand
        if sorted(numbers) != list(range(1, len(items) + 1)):
            raise InputError(
                f"{len(items)} bands whose numbers are not 1 to {len(items)}", where=str(path), mend="copy it again"
            )
        items = [item for _, item in sorted(zip(numbers, items, strict=True), key=lambda pair: pair[0])]
    tags = (sidecar.wavelength, sidecar.fwhm, sidecar.gain, sidecar.offset)
    table = np.array([[_number(item.findtext(tag), tag, path) for tag in tags] for item in items])
    detector = re.search(r"_(VNIR|SWIR)", image.name.upper())
    if len(table) != bands:
        if detector is None or len(table) < bands:
            raise InputError(
                f"{len(table)} bands in the metadata, {bands} in the image", where=str(path), mend="copy both again"
            )
        table = table[:bands] if detector[1] == "VNIR" else table[-bands:]
    wavelength, width, gain, offset = table.T
    levels = [root.findtext(sidecar.level), root.findtext("base/format"), path.name]
    level = next((found[0] for text in levels if (found := re.search(r"L[0-4][A-D]", (text or "").upper()))), None)
    quantity = None if level is None else "reflectance" if level.startswith("L2") else "radiance"
    ignore = root.findtext(sidecar.ignore) if sidecar.ignore is not None else None
    zenith, elevation = _angle(root, sidecar.sun_zenith), _angle(root, sidecar.sun_elevation)
    rectified = level is None or not level.startswith("L1") or level == "L1C"
    when = (root.findtext(sidecar.time) or "").strip() if sidecar.time is not None else ""
    product = f"{sidecar.sensor} {level or 'image'}"
    return Description(
        product=product,
        bands=ListedBands(np.where(wavelength > 0, wavelength, np.nan), width, sidecar.wavelength_unit),
        scale=Scale(gain, offset, f"scale of the {product}"),
        quantity=quantity,
        unit=sidecar.radiance_unit if quantity == "radiance" else "1" if quantity else None,
        ignore_value=_number(ignore, str(sidecar.ignore), path) if ignore else None,
        sensor=sidecar.sensor,
        sun_zenith_deg=90.0 - elevation if zenith is None and elevation is not None else zenith,
        sorts=True,
        entries={"sensor": sidecar.sensor} | ({"acquisition time": when} if when else {}),
        notes=(*([] if rectified else [NO_MAP]), *([_UNRECTIFIED] if detector else [])),
    )


def _angle(root: ElementTree.Element, tag: str | None) -> float | None:
    """An angle between 0 and 180 degrees; None where there is none."""
    try:
        angle = float((root.findtext(tag) if tag else None) or "nan")
    except ValueError:
        return None
    return angle if 0.0 <= angle <= 180.0 else None


def _number(text: str | None, what: str, path: Path) -> float:
    """The first number of a text, as DESIS lists one for each temperature."""
    try:
        number = float((text or "").split(",")[0])
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"{what}: {(text or '')[:40]!r} is no number", where=str(path))
    return number


def _stac_assets(image: Path, root: Path | None) -> Iterator[tuple[Path, dict[str, Any], dict[str, Any]]]:
    """Items of STAC beside an image whose assets name it: the file, the item, the asset."""
    own = image.with_suffix(".json")
    others = sorted(image.parent.glob("*.json"))[:MAX_ITEMS]
    for path in [own, *(p for p in others if p != own)]:
        if not path.is_file() or path.stat().st_size > MAX_JSON_BYTES:
            continue
        try:
            item = json.loads(checked_file(path, root=root, what="STAC item").read_text("utf-8"))
        except (ValueError, RecursionError):
            continue
        assets = item.get("assets") if isinstance(item, dict) and "stac_version" in item else None
        for asset in assets.values() if isinstance(assets, dict) else ():
            href = asset.get("href") if isinstance(asset, dict) else None
            if isinstance(href, str) and href.rsplit("/", 1)[-1] == image.name:
                yield path, item, asset


def _from_asset(item: dict[str, Any], asset: dict[str, Any], bands: int) -> Description | None:
    """What an item says of the bands of an asset (extensions eo and raster, STAC 1.0 and 1.1)."""
    given = item.get("properties")
    properties: dict[str, Any] = given if isinstance(given, dict) else {}
    of_asset = asset.get("bands") or asset.get("eo:bands")
    listed = of_asset or properties.get("bands") or properties.get("eo:bands")
    if not isinstance(listed, list) or len(listed) != bands or not all(isinstance(b, dict) for b in listed):
        return None
    raster = asset.get("raster:bands")
    details = [d if isinstance(d, dict) else {} for d in raster] if isinstance(raster, list) else []
    details = details if len(details) == bands else [{}] * bands

    def column(*names: str, default: float | None = None) -> list[float] | None:
        out = []
        for band, detail in zip(listed, details, strict=True):
            value = next((d[n] for n in names for d in (band, detail) if d.get(n) is not None), default)
            if not isinstance(value, int | float):
                return None
            out.append(float(value))
        return out

    centre = column("eo:center_wavelength", "center_wavelength")
    if centre is None:
        return None
    units = {str(d.get("unit")) for d in (*listed, *details) if d.get("unit")}
    unit = units.pop() if len(units) == 1 else None
    instruments = properties.get("instruments") or [properties.get("platform") or properties.get("constellation") or ""]
    sensor = str(instruments[0]) if isinstance(instruments, list) else str(instruments)
    width = column("eo:full_width_half_max", "full_width_half_max")
    quantity = _stac_quantity(unit, f"{asset.get('title', '')} {properties.get('processing:level', '')}")
    gain, offset = column("raster:scale", "scale", default=1.0), column("raster:offset", "offset", default=0.0)
    nodata = {d.get("nodata") for d in (*listed, *details, asset) if isinstance(d.get("nodata"), int | float)}
    return Description(
        product="STAC item",
        bands=ListedBands(np.array(centre), None if width is None else np.array(width), "um"),  # as eo defines it
        scale=Scale(1.0 if gain is None else np.array(gain), np.array(offset or 0.0), "scale of the STAC item"),
        quantity=quantity,
        unit=unit if quantity == "radiance" else None,
        sensor=sensor,
        entries={"sensor": sensor, "acquisition time": str(properties.get("datetime") or "")},
        ignore_value=float(nodata.pop()) if len(nodata) == 1 else None,
    )


def _stac_quantity(unit: str | None, text: str) -> str | None:
    try:
        radiance_to_internal(unit or "")
        return "radiance"
    except UsageError:
        return "reflectance" if re.search("reflectance", text, re.IGNORECASE) else None
