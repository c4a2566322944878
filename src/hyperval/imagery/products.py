"""Products by their layout: trees of arrays (HDF5, NetCDF-4, HDF-EOS5), and what lies beside a GeoTIFF.

The layouts are those of ``products.yaml``; beside a GeoTIFF lie a METADATA.XML or an item of STAC.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
from affine import Affine
from rasterio.crs import CRS

from hyperval.data import Array
from hyperval.envi_header import EnviHeader
from hyperval.errors import WARNING, needed, package_table, reader, refusal, refuse
from hyperval.imagery import arrays
from hyperval.imagery.description import Description, ListedBands, Raster, Scale, crs_of_wkt, gdal_transform, some_lines
from hyperval.imagery.envi import crs_of, transform_of
from hyperval.paths import checked_file, read_xml
from hyperval.storage import number_of
from hyperval.units import is_radiance, to_internal

MAX_BANDS = 20_000
SAMPLED_LINES = 16
_HIGHEST = 65535.0  # of the 16 bits that a range of values is divided into
Position = tuple[Affine | None, CRS | None, tuple[str, ...]]


class ProductLayout(dict[str, Any]):
    """An entry of ``products.yaml``, whose head says what it may state; what it does not state is None."""

    def __getattr__(self, key: str) -> Any:
        return self.get(key)


@cache
def layouts() -> ProductLayout:
    """The layouts that come with the package: ``trees``, ``observations``, ``sidecars``."""
    text = json.dumps(package_table("imagery/products.yaml"))
    found: ProductLayout = json.loads(text, object_hook=ProductLayout)
    return found


@dataclass(frozen=True)
class ProductTree:
    """What the references of a layout mean in one opened file."""

    file: h5py.File
    path: Path
    layout: ProductLayout

    def item(self, reference: str) -> Any:
        """The array, group or attribute of a reference, None when there is none.

        "*" is the only group of the file, of which :func:`arrays.check_own_values` has made sure that no
        part lies elsewhere.
        """
        name, mark, attribute = reference.partition("@")
        if name.startswith("*"):
            groups = [key for key, found in self.file.items() if isinstance(found, h5py.Group)]
            name = name.replace("*", groups[0] if len(groups) == 1 else "", 1)
        found = self.file.get(name) if name else self.file
        return found.attrs.get(attribute) if mark and found is not None else found

    def raw(self, reference: str | None) -> Any:
        """The content of a small array or an attribute, None when the file has none."""
        found = None if reference is None else self.item(reference)
        if isinstance(found, h5py.Dataset):
            return found[()] if found.size <= MAX_BANDS * 100 else None
        return found if "@" in (reference or "") else None

    def texts(self, reference: str | None) -> tuple[str, ...]:
        """The texts or numbers of a small array or an attribute as text, none where the file has none."""
        return arrays.texts_of(self.raw(reference))

    def text(self, reference: str | None) -> str | None:
        """The same as one text; None when the file has none."""
        return " ".join(self.texts(reference)).strip() or None

    def number(self, reference: str) -> float:
        """A number; InputError when the file has none there, or not a finite one."""
        found = self.floats(reference)
        refuse(not np.isfinite(found[:1]).any(), "product.number", self.path, reference=reference)
        return float(found[0])

    def numbers(self, reference: str, count: int, what: str) -> Array:
        """(count,) numbers; InputError when the file does not have as many."""
        out = self.floats(reference)
        fields = {"what": what, "reference": reference, "count": count}
        refuse(out.size != count, "product.numbers", self.path, size=out.size, **fields)
        return out

    def floats(self, reference: str | None) -> Array:
        """The numbers of a small array or an attribute, none where the file has others or nothing."""
        value = self.raw(reference)
        try:
            return np.zeros(0) if value is None else np.asarray(value, dtype=float).ravel()
        except (TypeError, ValueError):
            return np.zeros(0)

    def image(self, reference: str, axes: int = 3) -> h5py.Dataset:
        """An array of so many axes; InputError where it is none or cannot be read by its blocks."""
        array = self.item(reference)
        refuse(not isinstance(array, h5py.Dataset), "product.image", self.path, name=reference)
        name = array.name.strip("/")
        if array.chunks is not None and int(np.prod(array.chunks)) * array.dtype.itemsize > arrays.MAX_CHUNK_BYTES:
            raise refusal("array.block", self.path, name=name, mib=arrays.MAX_CHUNK_BYTES >> 20)
        if array.dtype.kind not in "iuf" or array.ndim != axes or 0 in array.shape:
            raise refusal("product.image" if axes == 3 else "product.table", self.path, name=name)
        return array


def _tree(file: h5py.File, path: Path) -> ProductTree | None:
    """The file by the layout whose images and wavelengths, or names of bands, it holds; None: it is none of them."""
    for layout in (*layouts().trees, *layouts().observations):
        tree = ProductTree(file, path, layout)
        names = [layout.band_names, *(name for array in layout.arrays for name in (array.path, array.wavelength))]
        found = [(name, tree.item(name)) for name in names if isinstance(name, str)]
        if all(item is not None if "@" in name else isinstance(item, h5py.Dataset) for name, item in found):
            return tree
    return None


@reader
def open_product(path: Path) -> arrays.ArrayRaster | None:
    """The image of a product whose layout is known; None when the file has none of the layouts.

    Raises
    ------
    InputError : cut short, or contents that contradict the layout.
    """
    store = arrays.ArrayFile(path, arrays.hdf5)
    with store.kept_open() as file:
        tree = _tree(file, path)
        if tree is None:
            return None
        layout = tree.layout
        images = [tree.image(array.path, len(array.dimensions)) for array in layout.arrays]
        ignore = _ignore(tree, images[0])
        pieces = tuple(_piece(tree, a, image, ignore) for a, image in zip(layout.arrays, images, strict=True))
        transform, crs, notes = (None, None, ()) if layout.lookup_table else _position(tree, pieces[0])
        parts = [_columns(tree, a, i, p.size("b")) for a, i, p in zip(layout.arrays, images, pieces, strict=True)]
        wavelength, width, flags, gain, offset = np.concatenate(parts, axis=1)
        good = flags != 0
        for low, high in (np.sort(ends) for r in layout.bad_ranges_nm or () if (ends := tree.floats(r)).size == 2):
            good &= ~((wavelength >= low) & (wavelength <= high))
        sensor = (tree.text(layout.sensor) if layout.sensor.startswith("@") else layout.sensor) or ""
        stated = {"acquisition time": _time(tree), "sensor": sensor}
        unit, unit_notes = _unit(tree)
        centre, widths = np.where(wavelength > 0, wavelength, np.nan), None if np.isnan(width).all() else width
        about = Description(
            product=layout.product,
            bands=ListedBands(centre, widths, unit_nm, good) if (unit_nm := layout.wavelength_unit) else None,
            band_names=tuple(names) if isinstance(names := layout.band_names, list) else tree.texts(names),
            scale=Scale(gain, offset, f"scale of the {layout.product}"),
            quantity=layout.quantity,
            unit=unit,
            ignore_value=None if any(len(p.terms) > 1 for p in pieces) else ignore,  # of a sum no stored value means it
            ignored=ignore,
            sensor=sensor,
            sorts=bool(layout.sorts),
            entries={key: text for key, text in stated.items() if text},
            notes=(*unit_notes, *notes, *([layout.remark] if layout.remark else [])),
            sun_zenith_deg=_sun(tree),
        )
    return arrays.array_raster(store, pieces, about, (transform, crs))


def table_in(raster: Raster) -> arrays.ArrayRaster | None:
    """What places the pixels of a product in scanner geometry, an image of two bands; None without.

    Its geographic lookup table, of whole numbers on a map grid, else the longitude and latitude of every pixel.
    """
    if not isinstance(raster, arrays.ArrayRaster) or raster.store.opener is not arrays.hdf5:
        return None
    with raster.store.kept_open() as file:
        tree = _tree(file, raster.path)
        if tree is None:
            return None
        for key in ("lookup_table", "location", "other_location"):
            names, on_map = getattr(tree.layout, key) or (), key == "lookup_table"
            columns = [column for name in names if isinstance(column := tree.item(name), h5py.Dataset)]
            if len(columns) != 2 or not (on_map or columns[0].shape == columns[1].shape == raster.size[:2]):
                continue
            columns = [tree.image(name, axes=2) for name in names]
            dtype = np.dtype(np.int32 if on_map else np.float64)
            pieces = tuple(arrays.BandArrays((arrays.Term(c.name.strip("/")),), "ls", c.shape, dtype) for c in columns)
            position = _position(tree, pieces[0])[:2] if on_map else (None, CRS.from_epsg(4326))
            about = Description(ignore_value=arrays.stated(columns[0].attrs) if on_map else None)
            return arrays.array_raster(arrays.ArrayFile(raster.path, arrays.hdf5), pieces, about, position)
    return None


def _piece(tree: ProductTree, array: ProductLayout, image: h5py.Dataset, ignore: float | None) -> arrays.BandArrays:
    first = arrays.Term(image.name.strip("/"))
    if array.plus is None:
        return arrays.BandArrays((first,), array.dimensions, image.shape, image.dtype.newbyteorder("="))
    second = tree.image(array.plus[0])
    refuse(second.shape != image.shape, "product.shape", tree.path, name=second.name, other=image.name)
    weight = 1.0 / tree.number(array.plus[1])
    terms = first._replace(ignore=ignore), arrays.Term(second.name.strip("/"), weight)
    return arrays.BandArrays(terms, array.dimensions, image.shape, np.dtype(np.float32))


def _columns(tree: ProductTree, array: ProductLayout, image: h5py.Dataset, bands: int) -> Array:
    """(5, bands) wavelength, width (NaN without), flag (1 without), gain and offset of an array."""
    columns = [tree.numbers(array.wavelength, bands, "wavelengths") if array.wavelength else np.full(bands, np.nan)]
    low, width = np.array(array.widths or [(-np.inf, np.nan)], float).T
    published = width[np.searchsorted(low, columns[0], side="right") - 1]
    for reference, what, lacking in ((array.fwhm, "widths", published), (array.good, "flags", 1.0)):
        stated = tree.raw(reference) is not None
        columns.append(tree.numbers(reference, bands, what) if stated else np.broadcast_to(lacking, bands))
    return np.stack([*columns, *(np.full(bands, number) for number in _scale(tree, array, image))])


def _scale(tree: ProductTree, array: ProductLayout, image: h5py.Dataset) -> tuple[float, float]:
    """Gain and offset of an array by its layout, else by the attributes that the CF conventions have for them."""
    if array.range is not None:
        low, high = (tree.number(r) for r in array.range)
        return (high - low) / _HIGHEST, low
    if array.divisor is not None:
        divisor = tree.number(array.divisor)
        refuse(divisor == 0, "product.divisor", tree.path, name=array.divisor)
        return 1.0 / divisor, -tree.number(array.subtract) if array.subtract is not None else 0.0
    return arrays.packing(image.attrs)


def _unit(tree: ProductTree) -> tuple[str, tuple[str, ...]]:
    """The unit of the layout; a unit that the image itself states takes its place when it is another."""
    layout = tree.layout
    arrays_of_light = layout.arrays if layout.quantity == "radiance" else ()
    for array, name in product(arrays_of_light, ("units", "Units", "unit", "Unit")):
        text = tree.text(f"{array.path}@{name}")  # one whose spelling is not known leaves that of the layout
        if text and is_radiance(text) and to_internal(text, "radiance") != to_internal(layout.unit, "radiance"):
            return text, (f"radiance in {text} as the file states, where the layout has {layout.unit}",)
    return layout.unit, ()


def _ignore(tree: ProductTree, image: h5py.Dataset) -> float | None:
    stated, ignore = arrays.stated(image.attrs), tree.layout.ignore
    if isinstance(ignore, str):
        return next(iter(tree.floats(ignore).tolist()), stated)
    return ignore if stated is None else stated


def _position(tree: ProductTree, piece: arrays.BandArrays) -> Position:
    """Transform and system of the image, or of the lookup table of one in scanner geometry."""
    layout, crs = tree.layout, _crs(tree)
    lines, samples = piece.size("l"), piece.size("s")
    if (info := tree.text(layout.map_info)) is not None:
        header = EnviHeader(tree.path, samples, lines, 1, 0, "", 0, 0, entries={"map info": info})
        return transform_of(header), crs or crs_of(header), ()
    if layout.geotransform is not None:
        return gdal_transform(tree.text(layout.geotransform)), crs, ()
    if layout.corner_pixels is not None:
        return _from_corners(tree, lines, samples, crs)
    # The corner points of HDF-EOS5's StructMetadata are the outer edges of the corner pixels.
    number = r"\s*([-+0-9.eE]+)\s*"
    corner = rf"(?:UpperLeftPointMtrs|LowerRightMtrs)\s*=\s*\({number},{number}\)"
    corners = re.findall(corner, tree.text(layout.struct_metadata) or "")
    if len(corners) != 2:
        return None, crs, ()
    (west, north), (east, south) = np.array(corners, float).tolist()
    return Affine((east - west) / samples, 0.0, west, 0.0, (south - north) / lines, north), crs, ()


def _from_corners(tree: ProductTree, lines: int, samples: int, crs: CRS | None) -> Position:
    """From the box around the corners, which are centres or edges of pixels: whichever gives the pixel its size."""
    each = [np.concatenate([tree.floats(r)[:1] for r in references]) for references in tree.layout.corner_pixels]
    (west, east), (south, north) = ((np.min(v, initial=np.inf), np.max(v, initial=-np.inf)) for v in each)
    size = float(tree.layout.pixel_size)
    for inner, kind in ((1, "centres"), (0, "edges")):
        if samples > inner < lines and np.allclose(
            [(east - west) / (samples - inner), (north - south) / (lines - inner)], size, rtol=1e-3
        ):
            half = 0.5 * size * inner
            note = f"the corners of the product are taken as {kind} of pixels, which gives {size:g} m"
            return Affine(size, 0.0, west - half, 0.0, -size, north + half), crs, (note,)
    what = f"corners {east - west:g} x {north - south:g} m apart do not give pixels of {size:g} m"
    return None, None, (f"{WARNING}{what}: they place nothing",)


def _crs(tree: ProductTree) -> CRS | None:
    """The system of a product by its WKT, its code, or the UTM zone of HDF-EOS5's StructMetadata.

    >>> from types import SimpleNamespace as Of
    >>> def system(**texts):
    ...     return str(_crs(Of(text=texts.get, layout=ProductLayout(struct_metadata="grid", epsg="code"))))
    >>> [system(grid=f"Projection=HE5_GCTP_UTM\\n\\tZoneCode={zone}") for zone in (32, -33)], system(code="EPSG:32654")
    (['EPSG:32632', 'EPSG:32733'], 'EPSG:32654')
    """
    wkt, code = tree.text(tree.layout.crs), tree.text(tree.layout.epsg)
    if wkt is None and tree.layout.crs is not None:  # of the grid mapping of CF, which has both names for it
        wkt = tree.text(tree.layout.crs.replace("@spatial_ref", "@crs_wkt"))
    numbers = re.findall(r"[0-9]{4,6}", code or "")
    zone = re.search(r"HE5_GCTP_UTM.*?ZoneCode=(-?[0-9]+)", tree.text(tree.layout.struct_metadata) or "", re.DOTALL)
    if zone is not None and not numbers:  # south of the equator it is negative
        numbers = [str((32600 if int(zone[1]) > 0 else 32700) + abs(int(zone[1])))]
    return crs_of_wkt(f"EPSG:{numbers[-1]}" if numbers else wkt)


def _time(tree: ProductTree) -> str:
    """When the image was taken, as the file says it: in words, in seconds since 1970, or a day and a clock.

    >>> from types import SimpleNamespace as Of
    >>> def utc(**held):
    ...     layout = ProductLayout(seconds="s", time="t", day_and_clock=("day", "clock"))
    ...     return _time(Of(layout=layout, text=held.get, floats=lambda name: np.array(held.get(name, []))))
    >>> utc(s=[-9999.0, 1744134271.5]), utc(day="20120924", clock="131511"), utc(t="2024-06-15T10:57:42Z", day="x")
    ('2025-04-08T17:44:31.500000+00:00', '20120924T131511', '2024-06-15T10:57:42Z')
    """
    seconds = tree.floats(tree.layout.seconds)
    if np.any(valid := seconds > 0.0):
        return datetime.fromtimestamp(float(np.median(seconds[valid])), UTC).isoformat()
    return tree.text(tree.layout.time) or "T".join(filter(None, map(tree.text, tree.layout.day_and_clock or ())))


def _sun(tree: ProductTree) -> float | None:
    """The zenith angle of the sun [degrees] that a product states for the whole image; None without."""
    found = None if tree.layout.sun_zenith is None else tree.item(tree.layout.sun_zenith)
    if not isinstance(found, h5py.Dataset) or found.ndim != 2:
        return median_angle(tree.floats(tree.layout.sun_zenith))
    return median_angle(found[some_lines(found.shape[0], SAMPLED_LINES)].astype(float).ravel())


def median_angle(angles: Array) -> float | None:
    """Median of the angles between 0 and 180 degrees, None where there is none."""
    angles = angles[(angles >= 0.0) & (angles <= 180.0)]
    return float(np.median(angles)) if angles.size else None


MAX_XML_BYTES = 64 << 20
MAX_JSON_BYTES = 4 << 20
MAX_ITEMS = 20  # files of JSON that are looked at for one that names the image
NO_MAP = "in scanner geometry: a map position of the file is a fit to its corners and is ignored"
_UNRECTIFIED = "one detector in scanner geometry: the other sees a place some lines apart, as a cube of its own"


def described_beside(image: Path, bands: int, nodata: float | None = None) -> tuple[Description, Path] | None:
    """What the metadata beside a GeoTIFF of ``bands`` bands say of it, and their file; None where there are none.

    ``nodata`` : as the GeoTIFF itself states it, where the metadata do not.

    Raises
    ------
    InputError : metadata that are too large, not understood, or of another number of bands.
    """
    for sidecar in layouts().sidecars:
        start = image.name.upper().find(sidecar.image.upper())
        for name in (sidecar.metadata, sidecar.metadata.lower(), sidecar.metadata.upper()) if start >= 0 else ():
            path = image.with_name(image.name[:start] + name)
            if path.is_file() and (made := _from_xml(sidecar, checked_file(path), image, bands)) is not None:
                return _filled(made, nodata, sidecar.fill), path
    for path, item, asset in _stac_assets(image):
        if (made := _from_asset(item, asset, bands)) is not None:
            return _filled(made, nodata), path
    return None


def _filled(made: Description, *others: float | None) -> Description:
    """A description with the first no-data value that is stated."""
    return replace(made, ignore_value=next((v for v in (made.ignore_value, *others) if v is not None), None))


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
    sidecar = needed(sidecar, "sidecar.unknown", metadata)
    stem = metadata.name[: -len(sidecar.metadata)]
    start = (stem + sidecar.image).upper()
    tiffs = [p for p in sorted(metadata.parent.iterdir()) if p.suffix.upper() in (".TIF", ".TIFF")]
    fits = [p for p in tiffs if p.name.upper().startswith(start)]
    refuse(not fits, "sidecar.no_image", metadata, stem=stem + sidecar.image)
    # The same image may lie there again, cut into tiles for the cloud.
    fits.sort(key=lambda p: not p.stem.upper().endswith("_COG"))
    of_detector = {p.stem[len(start) :].upper().removesuffix("_COG").strip("_"): p for p in fits}
    chosen = [p for name, p in of_detector.items() if detector is None or name == detector.upper()]
    names = {"names": ", ".join(p.name for p in of_detector.values()), "detectors": " or ".join(of_detector)}
    refuse(len(chosen) != 1, "sidecar.images", metadata, count=len(of_detector), **names)
    return chosen[0]


def _from_xml(sidecar: ProductLayout, path: Path, image: Path, bands: int) -> Description | None:
    root = read_xml(path, MAX_XML_BYTES)
    items = root.findall(sidecar.bands)
    if not items:
        return None
    numbers = [_number(item.get("number"), "number of a band", path) for item in items if "number" in item.attrib]
    if numbers:  # of the band in the image, in whatever order the elements stand
        refuse(sorted(numbers) != list(range(1, len(items) + 1)), "sidecar.band_numbers", path, count=len(items))
        items = [item for _, item in sorted(zip(numbers, items, strict=True), key=lambda pair: pair[0])]
    tags = (sidecar.wavelength, sidecar.fwhm, sidecar.gain, sidecar.offset)
    table = np.array([[_number(item.findtext(tag), tag, path) for tag in tags] for item in items])
    detector = next((one for one in ("VNIR", "SWIR") if f"_{one}" in image.name.upper()), None)
    if len(table) != bands:
        refuse(detector is None or len(table) < bands, "sidecar.bands", path, stated=len(table), bands=bands)
        table = table[:bands] if detector == "VNIR" else table[-bands:]
    wavelength, width, gain, offset = table.T
    levels = [root.findtext(sidecar.level), root.findtext("base/format"), path.name]
    level = next((found[0] for text in levels if (found := re.search(r"L[0-4][A-D]", (text or "").upper()))), None)
    quantity = None if level is None else "reflectance" if level.startswith("L2") else "radiance"
    ignore = root.findtext(sidecar.ignore) if sidecar.ignore is not None else None
    zenith, elevation = _angle(root, sidecar.sun_zenith), _angle(root, sidecar.sun_elevation)
    rectified = level is None or not level.startswith("L1") or level == "L1C"
    acquired = (root.findtext(sidecar.time) or "").strip() if sidecar.time is not None else ""
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
        entries={"sensor": sidecar.sensor} | ({"acquisition time": acquired} if acquired else {}),
        notes=(*([] if rectified else [NO_MAP]), *([_UNRECTIFIED] if detector else [])),
    )


def _angle(root: ElementTree.Element, tag: str | None) -> float | None:
    """An angle between 0 and 180 degrees; None where there is none."""
    text = root.findtext(tag) if tag else None
    return median_angle(np.array(re.findall(r"^\s*[-+]?[0-9]+[.]?[0-9]*", text or ""), dtype=float))


def _number(text: str | None, what: str, path: Path) -> float:
    """The first number of a text, as DESIS lists one for each temperature."""
    number = number_of((text or "").split(",")[0])
    refuse(not np.isfinite(number), "sidecar.number", path, what=what, text=(text or "")[:40])
    return number


def _stac_assets(image: Path) -> Iterator[tuple[Path, dict[str, Any], dict[str, Any]]]:
    """Items of STAC beside an image whose assets name it: the file, the item, the asset."""
    named = image.with_suffix(".json")
    neighbours = sorted(image.parent.glob("*.json"))[:MAX_ITEMS]
    for path in [named, *(p for p in neighbours if p != named)]:
        if not path.is_file() or path.stat().st_size > MAX_JSON_BYTES:
            continue
        try:
            item = json.loads(checked_file(path, what="STAC item").read_bytes())
        except (ValueError, RecursionError):
            continue
        assets = item.get("assets") if isinstance(item, dict) and "stac_version" in item else None
        for asset in assets.values() if isinstance(assets, dict) else ():
            href = asset.get("href") if isinstance(asset, dict) else None
            if isinstance(href, str) and href.partition("?")[0].rsplit("/", 1)[-1] == image.name:
                yield path, item, asset


def _from_asset(item: dict[str, Any], asset: dict[str, Any], bands: int) -> Description | None:
    """What an item says of the bands of an asset (extensions eo and raster, STAC 1.0 and 1.1).

    >>> bands = [{"center_wavelength": 0.5, "raster:scale": 0.1}, {"center_wavelength": 0.6}]
    >>> _from_asset({}, {"bands": bands}, 2).notes
    ('warning: 1 bands have no number as raster:scale: taken as 1',)
    >>> whole = {"raster:scale": 0.01, "unit": "W m-2 sr-1 um-1", "bands": [{"center_wavelength": 0.5}] * 2}
    >>> of = _from_asset({}, whole, 2)
    >>> of.unit, of.scale.gain.tolist()
    ('W m-2 sr-1 um-1', [0.01, 0.01])
    """
    held = item.get("properties")
    properties: dict[str, Any] = held if isinstance(held, dict) else {}
    of_asset = asset.get("bands") or asset.get("eo:bands")
    listed = of_asset or properties.get("bands") or properties.get("eo:bands")
    if not isinstance(listed, list) or len(listed) != bands or not all(isinstance(b, dict) for b in listed):
        return None
    raster = asset.get("raster:bands")
    details = [d if isinstance(d, dict) else {} for d in raster] if isinstance(raster, list) else []
    details = [asset | of_band for of_band in (details if len(details) == bands else [{}] * bands)]

    notes: list[str] = []

    def column(*names: str, default: float | None = None) -> Array | None:
        each = zip(listed, details, strict=True)
        values = [next((d[n] for n in names for d in of_band if d.get(n) is not None), None) for of_band in each]
        valid = [isinstance(value, int | float) for value in values]
        if default is not None and not all(valid) and values != [None] * bands:
            notes.append(f"{WARNING}{bands - sum(valid)} bands have no number as {names[0]}: taken as {default:g}")
            return np.array([v if k else default for v, k in zip(values, valid, strict=True)], float)
        return np.array(values, float) if all(valid) else None

    centre = column("eo:center_wavelength", "center_wavelength")
    if centre is None:
        return None
    units = {str(d.get("unit")) for d in (*listed, *details) if d.get("unit")}
    unit = units.pop() if len(units) == 1 else None
    instruments = properties.get("instruments") or [properties.get("platform") or properties.get("constellation") or ""]
    sensor = str(instruments[0]) if isinstance(instruments, list) else str(instruments)
    width = column("eo:full_width_half_max", "full_width_half_max")
    acquired = properties.get("datetime") or properties.get("start_datetime")
    words = f"{asset.get('title', '')} {properties.get('processing:level', '')}".lower()
    quantity = "radiance" if is_radiance(unit) else "reflectance" if "reflectance" in words else None
    gain, offset = (column(f"raster:{n}", n, default=v) for n, v in (("scale", 1.0), ("offset", 0.0)))
    nodata = {d.get("nodata") for d in (*listed, *details, asset) if isinstance(d.get("nodata"), int | float)}
    return Description(
        product="STAC item",
        bands=ListedBands(centre, width, "um"),  # as eo defines it
        scale=Scale(1.0 if gain is None else gain, 0.0 if offset is None else offset, "scale of the STAC item"),
        quantity=quantity,
        unit=unit if quantity == "radiance" else None,
        sensor=sensor,
        entries={"sensor": sensor, "acquisition time": str(acquired or "")},
        ignore_value=float(nodata.pop()) if len(nodata) == 1 else None,
        notes=tuple(notes),
    )
