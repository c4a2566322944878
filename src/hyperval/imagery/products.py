"""Products in trees of arrays (HDF5, NetCDF-4, HDF-EOS5), opened by their layout.

Layouts are data (``products.yaml``): which array of a tree is the image, and what belongs to it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import yaml
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.envi_header import parse_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.arrays import ArrayRaster, Hdf5Store, Piece, Term, array_raster, check_own_values
from hyperval.imagery.description import Description, ListedBands, Raster, Scale, crs_of_wkt, gdal_transform
from hyperval.imagery.envi import crs_of, transform_of
from hyperval.units import radiance_to_internal

Array = npt.NDArray[np.float64]
MAX_BANDS = 20_000
SAMPLED_LINES = 16
SUN_ZENITH = re.compile(r"(sun|solar)\W+zenith", re.IGNORECASE)
_FILL_NAMES = ("_FillValue", "Data_Ignore_Value", "missing_value")
_HIGHEST = 65535.0  # of the 16 bits that a range of values is divided into
Reference = str | float


class ProductLayout(dict[str, Any]):
    """An entry of ``products.yaml``, whose head says what it may state; what it does not state is None."""

    def __getattr__(self, key: str) -> Any:
        return self.get(key)


@cache
def layouts() -> ProductLayout:
    """The layouts that come with the package: ``trees``, ``observations``, ``sidecars``."""
    text = Path(__file__).with_name("products.yaml").read_text("utf-8")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    found: ProductLayout = json.loads(json.dumps(yaml.load(text, loader)), object_hook=ProductLayout)  # noqa: S506
    return found


@dataclass(frozen=True)
class Values:
    """What the references of a layout mean in one opened file."""

    file: h5py.File
    path: Path

    def item(self, reference: str) -> Any:
        """The array, group or attribute of a reference, None when there is none.

        "*" is the only group of its level; links into other files are none.
        """
        name, at, attribute = reference.partition("@")
        found: Any = self.file
        for part in name.split("/") if name else ():
            if not isinstance(found, h5py.Group):
                return None
            if part == "*":
                groups = [key for key in found if isinstance(found.get(key, getlink=True), h5py.HardLink)]
                part = groups[0] if len(groups) == 1 else ""
            if part not in found or isinstance(found.get(part, getlink=True), h5py.ExternalLink):
                return None
            found = found[part]
        return found.attrs.get(attribute) if at else found

    def holds(self, array: ProductLayout) -> bool:
        """Whether the file has the image and the wavelengths of an array of a layout."""
        items = [(reference, self.item(reference)) for reference in (array.path, array.wavelength)]
        return all(found is not None if "@" in name else isinstance(found, h5py.Dataset) for name, found in items)

    def raw(self, reference: str) -> Any:
        """The content of a small array or an attribute, None when the file has none."""
        found = self.item(reference)
        if "@" in reference:
            return found
        return found[()] if isinstance(found, h5py.Dataset) and found.size <= MAX_BANDS * 100 else None

    def text(self, reference: str | None) -> str | None:
        """A text or number as text; None when the file has none."""
        value = None if reference is None else self.raw(reference)
        if isinstance(value, np.ndarray):
            value = value.ravel()[0] if value.size == 1 else " ".join(str(v) for v in value.ravel())
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        return None if value is None or not str(value).strip() else str(value).strip()

    def number(self, reference: Reference) -> float:
        """A number; InputError when the file has none there, or not a finite one."""
        if not isinstance(reference, str):
            return float(reference)
        try:
            number = float(np.asarray(self.raw(reference)).ravel()[0])
        except (TypeError, ValueError, IndexError):
            number = np.nan
        if not np.isfinite(number):
            raise InputError(
                f"no number {reference!r}", where=str(self.path), expected="as the product's layout has it"
            )
        return number

    def numbers(self, reference: str, count: int, what: str) -> Array:
        """(count,) numbers; InputError when the file does not have as many."""
        value = self.raw(reference)
        try:
            out = np.asarray(value, dtype=float).ravel()
        except (TypeError, ValueError):
            out = np.zeros(0)
        if value is None or out.size != count:
            raise InputError(
                f"{0 if value is None else out.size} {what} ({reference!r}) for {count} bands", where=str(self.path)
            )
        return out

    def image(self, store: Hdf5Store, reference: str) -> h5py.Dataset:
        """An array of three axes; InputError where it is none."""
        name = self.item(reference).name.strip("/")
        dataset = store.dataset(self.file, name)
        if dataset is None or dataset.dtype.kind not in "iuf" or dataset.ndim != 3 or 0 in dataset.shape:
            raise InputError(f"{name!r} is no image of three axes", where=str(self.path))
        return dataset


def tree_of(values: Values) -> ProductLayout | None:
    """The layout whose images and wavelengths the file holds, None when it is none of them."""
    return next((tree for tree in layouts().trees if all(map(values.holds, tree.arrays))), None)


def stated_number(attributes: Mapping[str, Any], names: Sequence[str]) -> float | None:
    """The number in the first of some attributes that holds a single one; None without any."""
    for name in names:
        value = attributes.get(name)
        if value is not None and np.size(value) == 1:
            return float(np.asarray(value).ravel()[0])
    return None


@reader
def open_product(path: Path) -> ArrayRaster | None:
    """The image of a product whose layout is known; None when the file has none of the layouts.

    Raises
    ------
    InputError : cut short, or contents that contradict the layout.
    """
    store = Hdf5Store(path)
    with store.kept_open() as file:
        values = Values(file, path)
        tree = tree_of(values)
        if tree is None:
            return None
        datasets = [values.image(store, array.path) for array in tree.arrays]
        ignore = _ignore(tree, values, datasets[0])
        pieces = tuple(_piece(a, d, store, values, ignore) for a, d in zip(tree.arrays, datasets, strict=True))
        transform, crs, notes = (None, None, ()) if tree.lookup_table else _position(tree, values, pieces[0])
        summed = any(len(p.terms) > 1 for p in pieces)
        about = _description(tree, values, datasets, pieces, None if summed else ignore, notes)
    return array_raster(path, store, pieces, about, (transform, crs))


@contextmanager
def _product_of(raster: Raster) -> Iterator[tuple[ProductLayout, Values, Hdf5Store] | None]:
    """The layout and the opened file of an image, None where it is no product."""
    if not isinstance(raster, ArrayRaster) or not isinstance(raster.store, Hdf5Store):
        yield None
        return
    with raster.store.kept_open() as file:
        values = Values(file, raster.path)
        tree = tree_of(values)
        yield None if tree is None else (tree, values, raster.store)


def lookup_raster(raster: Raster) -> ArrayRaster | None:
    """The geographic lookup table in a product in scanner geometry, as an image of two bands; None without."""
    with _product_of(raster) as product:
        if product is None or product[0].lookup_table is None:
            return None
        tree, values, store = product
        columns = [c for name in product[0].lookup_table if (c := store.dataset(values.file, name)) is not None]
        if len(columns) < 2:
            return None
        pieces = []
        for column in columns:
            if column.ndim != 2 or column.dtype.kind not in "iuf":
                raise InputError(f"{column.name!r} is no lookup table", where=str(raster.path))
            pieces.append(Piece((Term(column.name.strip("/")),), "ls", column.shape, np.dtype(np.int32)))
        fill = stated_number(columns[0].attrs, _FILL_NAMES)
        position = _position(tree, values, pieces[0])[:2]
    return array_raster(raster.path, store, tuple(pieces), position=position, zero_for=fill)


def location_raster(raster: Raster) -> ArrayRaster | None:
    """Longitude and latitude of every pixel of a product, as an image of two bands; None without."""
    with _product_of(raster) as product:
        if product is None or product[0].location is None:
            return None
        tree, values, store = product
        names, shape = tree.location or (), raster.size[:2]
        if any(getattr(values.item(name), "shape", None) != shape for name in names):
            return None
        pieces = tuple(Piece((Term(name),), "ls", shape, np.dtype(np.float64)) for name in names)
        return array_raster(raster.path, store, pieces)


def _piece(
    array: ProductLayout, dataset: h5py.Dataset, store: Hdf5Store, values: Values, ignore: float | None
) -> Piece:
    first = Term(dataset.name.strip("/"))
    if array.plus is None:
        return Piece((first,), array.dimensions, dataset.shape, dataset.dtype.newbyteorder("="))
    second = values.image(store, array.plus[0])
    if second.shape != dataset.shape:
        raise InputError(f"{second.name!r} is of another shape than {dataset.name!r}", where=str(store.path))
    weight = 1.0 / values.number(array.plus[1])
    terms = (
        Term(first.name, 1.0, ignore),
        Term(second.name.strip("/"), weight, stated_number(second.attrs, _FILL_NAMES)),
    )
    return Piece(terms, array.dimensions, dataset.shape, np.dtype(np.float32))


def _description(
    tree: ProductLayout,
    values: Values,
    datasets: list[h5py.Dataset],
    pieces: tuple[Piece, ...],
    ignore: float | None,
    notes: tuple[str, ...],
) -> Description:
    columns: dict[str, list[Array]] = {"wavelength": [], "fwhm": [], "good": [], "gain": [], "offset": []}
    for array, dataset, piece in zip(tree.arrays, datasets, pieces, strict=True):
        bands = piece.size("b")
        columns["wavelength"].append(values.numbers(array.wavelength, bands, "wavelengths"))
        for name, reference, what in (("fwhm", array.fwhm, "widths"), ("good", array.good, "flags")):
            if reference is not None and values.raw(reference) is not None:
                columns[name].append(values.numbers(reference, bands, what))
            elif name == "good":
                columns[name].append(np.ones(bands))
        for name, number in zip(("gain", "offset"), _scale(array, dataset, values), strict=True):
            columns[name].append(np.full(bands, number))
    wavelength = np.concatenate(columns["wavelength"])
    good = np.concatenate(columns["good"]) != 0
    for reference in tree.bad_ranges_nm or ():
        low_high = values.raw(reference)
        if low_high is not None and np.size(low_high) == 2:
            low, high = np.sort(np.asarray(low_high, float))
            good &= ~((wavelength >= low) & (wavelength <= high))
    sensor = (values.text(tree.sensor) if tree.sensor.startswith("@") else tree.sensor) or ""
    entries = {key: text for key, reference in (tree.entries or {}).items() if (text := values.text(reference))}
    unit, unit_notes = _unit(tree, datasets)
    width = np.concatenate(columns["fwhm"]) if len(columns["fwhm"]) == len(pieces) else None
    gain, offset = np.concatenate(columns["gain"]), np.concatenate(columns["offset"])
    return Description(
        product=tree.product,
        bands=ListedBands(np.where(wavelength > 0, wavelength, np.nan), width, tree.wavelength_unit, good),
        scale=Scale(gain, offset, f"scale of the {tree.product}"),
        quantity=tree.quantity,
        unit=unit,
        ignore_value=ignore,
        sensor=sensor,
        sorts=bool(tree.sorts),
        entries=entries | ({"sensor": sensor} if sensor else {}),
        notes=(*unit_notes, *notes, *([tree.remark] if tree.remark else [])),
        sun_zenith_deg=_sun(tree, values),
    )


def _scale(array: ProductLayout, dataset: h5py.Dataset, values: Values) -> tuple[float, float]:
    """Gain and offset of an array by its layout, else by the attributes that the CF conventions have for them."""
    if not {"scale", "divisor", "offset", "subtract", "range", "plus"} & array.keys():
        gain, offset = (stated_number(dataset.attrs, (name,)) for name in ("scale_factor", "add_offset"))
        return 1.0 if gain is None else gain, offset or 0.0
    if array.range is not None:
        low, high = (values.number(r) for r in array.range)
        return (high - low) / _HIGHEST, low
    divisor, scale, offset, subtract = (
        values.number(array.get(key, default))
        for key, default in (("divisor", 1.0), ("scale", 1.0), ("offset", 0.0), ("subtract", 0.0))
    )
    if divisor == 0:
        raise InputError(f"{array.divisor!r} is 0", where=str(values.path), expected="a number to divide by")
    return scale / divisor, offset - subtract


def _unit(tree: ProductLayout, datasets: list[h5py.Dataset]) -> tuple[str, tuple[str, ...]]:
    """The unit of the layout; a unit that the image itself states takes its place when it is another."""
    for dataset in datasets if tree.quantity == "radiance" else ():
        for name in ("units", "Units", "unit", "Unit"):
            stated = dataset.attrs.get(name)
            text = stated.decode("utf-8", "replace") if isinstance(stated, bytes) else stated
            try:
                if isinstance(text, str) and radiance_to_internal(text) != radiance_to_internal(tree.unit):
                    return text, (f"radiance in {text} as the file states, where the layout has {tree.unit}",)
            except UsageError:
                continue  # a spelling that is not known: that of the layout stands
    return tree.unit, ()


def _ignore(tree: ProductLayout, values: Values, dataset: h5py.Dataset) -> float | None:
    if isinstance(tree.ignore, str):
        try:
            return values.number(tree.ignore)
        except InputError:
            return stated_number(dataset.attrs, _FILL_NAMES)
    stated = stated_number(dataset.attrs, _FILL_NAMES)
    return tree.ignore if stated is None else stated


def _position(tree: ProductLayout, values: Values, piece: Piece) -> tuple[Affine | None, CRS | None, tuple[str, ...]]:
    """Transform and system of the image, or of the lookup table of one in scanner geometry."""
    crs = _crs(tree, values)
    if tree.map_info is not None:
        info = values.text(tree.map_info)
        if info is None:
            return None, crs, ()
        lines = [f"samples = {piece.size('s')}", f"lines = {piece.size('l')}", "bands = 1", "data type = 1"]
        header = parse_header("\n".join(["ENVI", *lines, f"map info = {{{info}}}"]), values.path)
        return transform_of(header), crs or crs_of(header), ()
    if tree.geotransform is not None:
        return gdal_transform(values.text(tree.geotransform)), crs, ()
    if tree.corner_pixels is not None and tree.pixel_size is not None:
        return _from_corners(tree, values, piece, crs)
    if tree.struct_metadata is not None:
        return _from_struct_metadata(values.text(tree.struct_metadata), piece), crs, ()
    return None, crs, ()


def _from_corners(
    tree: ProductLayout, values: Values, piece: Piece, crs: CRS | None
) -> tuple[Affine | None, CRS | None, tuple[str, ...]]:
    """From the corners of the product, which are centres or edges of pixels: whichever gives the pixel its size."""
    west, north, east, south = (values.number(r) for r in tree.corner_pixels or ())
    size, lines, samples = float(tree.pixel_size or 0.0), piece.size("l"), piece.size("s")
    for inner, kind in ((1, "centres"), (0, "edges")):
        if samples > inner < lines and np.allclose(
            [(east - west) / (samples - inner), (north - south) / (lines - inner)], size, rtol=1e-3
        ):
            half = 0.5 * size * inner
            note = f"the corners of the product are taken as {kind} of pixels, which gives {size:g} m"
            return Affine(size, 0.0, west - half, 0.0, -size, north + half), crs, (note,)
    raise InputError(
        f"corners {east - west:g} x {north - south:g} m apart do not give pixels of {size:g} m",
        where=str(values.path),
    )


def _from_struct_metadata(text: str | None, piece: Piece) -> Affine | None:
    """From the corner points of HDF-EOS5's StructMetadata, which are the outer edges of the corner pixels."""
    corners = [
        re.search(rf"{name}\s*=\s*\(\s*([-+0-9.eE]+)\s*,\s*([-+0-9.eE]+)\s*\)", text or "")
        for name in ("UpperLeftPointMtrs", "LowerRightMtrs")
    ]
    if any(corner is None for corner in corners):
        return None
    (west, north), (east, south) = ((float(c[1]), float(c[2])) for c in corners if c is not None)
    return Affine((east - west) / piece.size("s"), 0.0, west, 0.0, (south - north) / piece.size("l"), north)


def _crs(tree: ProductLayout, values: Values) -> CRS | None:
    wkt, code = values.text(tree.crs), values.text(tree.epsg)
    if wkt is None and tree.crs is not None:  # of the grid mapping of CF, which has both names for it
        wkt = values.text(tree.crs.replace("@spatial_ref", "@crs_wkt"))
    try:
        if code is not None and re.search(r"[0-9]{4,6}", code):
            return CRS.from_epsg(int(re.findall(r"[0-9]{4,6}", code)[-1]))
    except CRSError:
        return None
    return crs_of_wkt(wkt)


def _sun(tree: ProductLayout, values: Values) -> float | None:
    """The zenith angle of the sun [degrees] that a product states for the whole image; None without."""
    found = None if tree.sun_zenith is None else values.item(tree.sun_zenith)
    try:
        if isinstance(found, h5py.Dataset) and found.ndim == 2:
            return median_angle(_some_lines(found))
        return median_angle(np.array([float(values.text(tree.sun_zenith) or "nan")]))
    except (ValueError, OSError):
        return None


def median_angle(angles: Array) -> float | None:
    """Median of the angles between 0 and 180 degrees, None where there is none."""
    angles = angles[(angles >= 0.0) & (angles <= 180.0)]
    return float(np.median(angles)) if angles.size else None


def sun_of_observation(path: Path, shape: tuple[int, int]) -> Array | None:
    """Zenith angles of the sun [degrees] in some lines of a file of angles for an image of ``shape``.

    None where its layout is not known or it is of another size.

    Raises
    ------
    InputError : no HDF5 file, or one whose values lie elsewhere.
    """
    check_own_values(path)
    with Hdf5Store(path).kept_open() as file:
        values = Values(file, path)
        for layout in layouts().observations:
            array = values.item(layout.sun_zenith or layout.image or "")
            names = values.item(layout.names) if layout.names is not None else None
            if not isinstance(array, h5py.Dataset):
                continue
            if layout.sun_zenith is not None and array.shape == shape:
                return _some_lines(array)
            if isinstance(names, h5py.Dataset):
                words = [n.decode("utf-8", "replace") if isinstance(n, bytes) else str(n) for n in names[()].ravel()]
                bands = [i for i, word in enumerate(words) if SUN_ZENITH.search(word)]
                if len(bands) == 1 and array.shape == (*shape, len(words)):
                    return _some_lines(array, bands[0])
    return None


def _some_lines(array: h5py.Dataset, band: int | None = None) -> Array:
    lines = np.unique(np.linspace(0, array.shape[0] - 1, SAMPLED_LINES).astype(int))
    rows = [array[int(line)] if band is None else array[int(line), :, band] for line in lines]
    return np.concatenate([np.asarray(row, dtype=np.float64).ravel() for row in rows])
