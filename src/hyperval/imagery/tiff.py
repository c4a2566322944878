"""Stored numbers of a GeoTIFF, read by rasterio in windows.

Metadata beside a GeoTIFF: METADATA.XML of EnMAP and DESIS, and items of STAC.
"""

from __future__ import annotations

import json
import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.enums import MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.windows import Window

from hyperval.envi_header import EnviHeader, header_beside, read_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.description import Description, wavelengths_in_names
from hyperval.imagery.envi import crs_of, transform_of
from hyperval.imagery.products import Sidecar, layouts, level_of
from hyperval.imagery.text_files import read_xml
from hyperval.paths import checked_file
from hyperval.units import radiance_to_internal, wavelength_to_nm

MAX_XML_BYTES = 64 << 20
MAX_JSON_BYTES = 4 << 20
_NO_MAP = "in scanner geometry: a map position of the file is a fit to its corners and is left aside"
_UNRECTIFIED = "one detector in scanner geometry: the other sees a place some lines apart, as a cube of its own"
MAX_ITEMS = 20  # files of JSON that are looked at for one that names the image


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
        if at < 0:
            continue
        for name in (sidecar.metadata, sidecar.metadata.lower(), sidecar.metadata.upper()):
            candidate = image.with_name(image.name[:at] + name)
            if candidate.is_file():
                made = _from_xml(sidecar, checked_file(candidate, root=root, what="metadata file"), image, bands)
                if made is not None:
                    lacks = made.ignore_value is None and nodata is None
                    return (replace(made, ignore_value=sidecar.fill) if lacks else made), candidate
    return _from_stac(image, bands, root)


def image_of(metadata: Path, detector: str | None = None) -> Path:
    """The GeoTIFF that a METADATA.XML belongs to; of level 1B of EnMAP that of ``detector``, VNIR or SWIR.

    The two detectors of level 1B are two cubes: each sees a place some lines before the other, neither is on a map,
    and no shift by whole pixels lays one on the other.

    Raises
    ------
    InputError : no image.
    UsageError : several, and none or another one is named.
    """
    for sidecar in layouts().sidecars:
        if metadata.name.upper().endswith(sidecar.metadata.upper()):
            stem = metadata.name[: -len(sidecar.metadata)]
            start = (stem + sidecar.image).upper()
            tiffs = [p for p in sorted(metadata.parent.iterdir()) if p.suffix.upper() in (".TIF", ".TIFF")]
            fits = [p for p in tiffs if p.name.upper().startswith(start)]
            if not fits:
                raise InputError(f"no image {stem}{sidecar.image}... beside it", where=str(metadata))
            # The same image may lie there again, cut into tiles for the cloud.
            fits.sort(key=lambda p: not p.stem.upper().endswith("_COG"))
            of_detector = {p.stem[len(start) :].upper().removesuffix("_COG").strip("_"): p for p in fits}
            if detector is not None and detector.upper() in of_detector:
                return of_detector[detector.upper()]
            if detector is not None or len(of_detector) > 1:
                names = ", ".join(p.name for p in of_detector.values())
                raise UsageError(
                    f"{len(of_detector)} images could be meant: {names}",
                    where=str(metadata),
                    expected="variable: " + " or ".join(of_detector),
                    mend="state the detector; those of level 1B see a place some lines apart and are no one cube, "
                    "level 1C has them on one grid",
                )
            return next(iter(of_detector.values()))
    raise InputError("no metadata of a product that is known", where=str(metadata), expected="...-METADATA.XML")


def _from_xml(sidecar: Sidecar, path: Path, image: Path, bands: int) -> Description | None:
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
    named = re.search(r"_(VNIR|SWIR)", image.name.upper())
    detector = named[1] if named else None
    if len(table) != bands:
        if detector is None or len(table) < bands:
            raise InputError(
                f"{len(table)} bands in the metadata, {bands} in the image", where=str(path), mend="copy both again"
            )
        table = table[:bands] if detector == "VNIR" else table[-bands:]
    wavelength, width, gain, offset = table.T
    level = level_of([root.findtext(sidecar.level), root.findtext("base/format"), path.name])
    quantity = None if level is None else "reflectance" if level.startswith("L2") else "radiance"
    ignore = root.findtext(sidecar.ignore) if sidecar.ignore is not None else None
    entries = {"sensor": sidecar.sensor}
    zenith = _angle(root, sidecar.sun_zenith)
    if zenith is None and (elevation := _angle(root, sidecar.sun_elevation)) is not None:
        zenith = 90.0 - elevation
    rectified = level is None or not level.startswith("L1") or level == "L1C"
    notes = [] if rectified else [_NO_MAP]
    notes += [_UNRECTIFIED] if detector is not None else []
    when = root.findtext(sidecar.time) if sidecar.time is not None else None
    if when:
        entries["acquisition time"] = when.strip()
    return Description(
        product=f"{sidecar.sensor} {level or 'image'}",
        wavelength=wavelength,
        fwhm=width,
        wavelength_unit=sidecar.wavelength_unit,
        gain=gain,
        offset=offset,
        quantity=quantity,
        unit=sidecar.radiance_unit if quantity == "radiance" else "1" if quantity else None,
        ignore_value=_number(ignore, str(sidecar.ignore), path) if ignore else None,
        sensor=sidecar.sensor,
        rectified=rectified,
        sun_zenith_deg=zenith,
        sorts=True,
        entries=entries,
        notes=tuple(notes),
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


def _from_stac(image: Path, bands: int, root: Path | None) -> tuple[Description, Path] | None:
    """What an item of STAC beside the image says of its bands (extensions eo and raster, STAC 1.0 and 1.1)."""
    own = image.with_suffix(".json")
    others = sorted(image.parent.glob("*.json"))[:MAX_ITEMS]
    for path in [own, *(p for p in others if p != own)]:
        if not path.is_file() or path.stat().st_size > MAX_JSON_BYTES:
            continue
        try:
            item = json.loads(checked_file(path, root=root, what="STAC item").read_text("utf-8"))
        except (ValueError, RecursionError):
            continue
        if not isinstance(item, dict) or "stac_version" not in item:
            continue
        assets = item.get("assets")
        for asset in assets.values() if isinstance(assets, dict) else ():
            href = asset.get("href") if isinstance(asset, dict) else None
            if isinstance(href, str) and href.rsplit("/", 1)[-1] == image.name:
                made = _from_asset(item, asset, bands, path)
                if made is not None:
                    return made, path
    return None


def _from_asset(item: dict[str, Any], asset: dict[str, Any], bands: int, path: Path) -> Description | None:
    listed = asset.get("bands") or asset.get("eo:bands")
    if not isinstance(listed, list) or len(listed) != bands or not all(isinstance(b, dict) for b in listed):
        return None
    raster = asset.get("raster:bands")
    details = raster if isinstance(raster, list) and len(raster) == bands else [{}] * bands

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
    given = item.get("properties")
    properties: dict[str, Any] = given if isinstance(given, dict) else {}
    instruments = properties.get("instruments") or [properties.get("platform") or properties.get("constellation") or ""]
    width = column("eo:full_width_half_max", "full_width_half_max")
    quantity = _stac_quantity(unit, str(asset.get("title", "")) + " " + str(properties.get("processing:level", "")))
    made = Description(
        product="STAC item",
        wavelength=np.array(centre),
        fwhm=None if width is None else np.array(width),
        wavelength_unit="um",  # as the extension eo defines it
        gain=np.array(column("raster:scale", "scale", default=1.0)),
        offset=np.array(column("raster:offset", "offset", default=0.0)),
        quantity=quantity,
        unit=unit if quantity == "radiance" else None,
        sensor=str(instruments[0]),
        entries={"sensor": str(instruments[0]), "acquisition time": str(properties.get("datetime") or "")},
    )
    nodata = {d.get("nodata") for d in (*listed, *details, asset) if isinstance(d.get("nodata"), int | float)}
    return replace(made, ignore_value=float(nodata.pop())) if len(nodata) == 1 else made


def _stac_quantity(unit: str | None, text: str) -> str | None:
    try:
        radiance_to_internal(unit or "")
        return "radiance"
    except UsageError:
        return "reflectance" if re.search("reflectance", text, re.IGNORECASE) else None


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
