"""Any file that an installed engine of xarray opens: an array with a wavelength coordinate is a cube.

Layouts of products as data (``layouts.yaml``): which array of a tree is the image, and what belongs to it.

Products in trees of arrays (HDF5, NetCDF-4, HDF-EOS5), opened by their layout.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import numpy.typing as npt
from affine import Affine
from pydantic import Field
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.config import Model, load_model
from hyperval.envi_header import parse_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.hdf5 import check_hdf5
from hyperval.imagery.arrays import ArrayRaster, Hdf5Store, MemoryStore, OpenedFile, Piece, Selection, Store, Term
from hyperval.imagery.description import Description
from hyperval.imagery.envi import crs_of, crs_of_wkt, gdal_transform, transform_of
from hyperval.units import RADIANCE_UNIT, radiance_to_internal, wavelength_to_nm

if TYPE_CHECKING:
    import xarray as xr

Array = npt.NDArray[np.float64]
MAX_BANDS = 20_000
Reference = str | float


class Addend(Model):
    """A second array of the same shape that is added to the first."""

    path: str
    divisor: Reference = 1.0


class ImageArray(Model):
    """An array that holds some bands of the image."""

    path: str
    dimensions: str = Field(pattern="^[lsb]{3}$")
    wavelength: str
    fwhm: str | None = None
    good: str | None = None
    plus: Addend | None = None
    scale: Reference = 1.0
    divisor: Reference = 1.0
    offset: Reference = 0.0
    subtract: Reference = 0.0
    range: tuple[Reference, Reference] | None = None


class Tree(Model):
    """A product whose image lies in a tree of arrays."""

    product: str
    sensor: str
    quantity: str
    unit: str
    arrays: list[ImageArray] = Field(min_length=1)
    wavelength_unit: str
    source: str
    remark: str | None = None
    sorts: bool = False
    ignore: Reference | None = None
    bad_ranges_nm: list[str] = Field(default_factory=list)
    lookup_table: tuple[str, str] | None = None
    location: tuple[str, str] | None = None
    geotransform: str | None = None
    map_info: str | None = None
    crs: str | None = None
    epsg: str | None = None
    corner_pixels: tuple[str, str, str, str] | None = None
    pixel_size: float | None = None
    struct_metadata: str | None = None
    sun_zenith: str | None = None
    entries: dict[str, str] = Field(default_factory=dict)


class AnglesFile(Model):
    """A file of the angles of every pixel beside an image: one array for each, or one whose bands have names."""

    product: str
    sun_zenith: str | None = None
    image: str | None = None
    names: str | None = None
    source: str


class Sidecar(Model):
    """A product of a GeoTIFF with XML beside it."""

    sensor: str
    image: str
    metadata: str
    bands: str
    wavelength: str
    fwhm: str
    gain: str
    offset: str
    wavelength_unit: str
    radiance_unit: str
    level: str
    source: str
    ignore: str | None = None
    fill: float | None = None
    time: str | None = None
    sun_zenith: str | None = None
    sun_elevation: str | None = None


class Layouts(Model):
    """All layouts."""

    trees: list[Tree]
    observations: list[AnglesFile]
    sidecars: list[Sidecar]


@cache
def layouts() -> Layouts:
    """The layouts that come with the package."""
    return load_model(Layouts, Path(__file__).with_name("layouts.yaml"))


def tree_of(file: h5py.File) -> Tree | None:
    """The layout whose images and wavelengths the file holds, None when it is none of them."""
    for tree in layouts().trees:
        if all(_present(file, array.path) and _present(file, array.wavelength) for array in tree.arrays):
            return tree
    return None


def _present(file: h5py.File, reference: str) -> bool:
    """Whether a file has the array or the attribute of a reference."""
    name, at, attribute = reference.partition("@")
    item = member(file, name) if name else file
    return item is not None and attribute in item.attrs if at else isinstance(item, h5py.Dataset)


@dataclass(frozen=True)
class Values:
    """What the references of a layout mean in one opened file."""

    file: h5py.File
    path: Path

    def raw(self, reference: str) -> Any:
        """The content of an array or attribute, None when the file has none."""
        name, at, attribute = reference.partition("@")
        item = member(self.file, name) if name else self.file
        if item is None:
            return None
        if at:
            return item.attrs.get(attribute)
        if not isinstance(item, h5py.Dataset) or item.size > MAX_BANDS * 100:
            return None
        return item[()]

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
            return reference
        value = self.raw(reference)
        try:
            number = float(np.asarray(value).ravel()[0])
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


def member(file: h5py.File, name: str) -> Any:
    """The group or array of a name, in which "*" is the only group of its level; None when there is none."""
    at: Any = file
    for part in name.split("/"):
        if not isinstance(at, h5py.Group):
            return None
        if part == "*":
            groups = [key for key in at if isinstance(at.get(key, getlink=True), h5py.HardLink)]
            if len(groups) != 1:
                return None
            part = groups[0]
        if part not in at or isinstance(at.get(part, getlink=True), h5py.ExternalLink):
            return None
        at = at[part]
    return at


def stated_number(attributes: Mapping[str, Any], names: Sequence[str]) -> float | None:
    """The number in the first of some attributes that holds a single one; None without any."""
    for name in names:
        value = attributes.get(name)
        if value is not None and np.size(value) == 1:
            return float(np.asarray(value).ravel()[0])
    return None


def level_of(texts: Sequence[str | None]) -> str | None:
    """Processing level (L1A, L1B, L1C, L2A ...) that one of the texts names, None when none does."""
    for text in texts:
        level = re.search(r"L[0-4][A-D]", (text or "").upper())
        if level is not None:
            return level.group()
    return None


_FILL_NAMES = ("_FillValue", "Data_Ignore_Value", "missing_value")
_HIGHEST = 65535.0  # of the 16 bits that a range of values is divided into


@reader
def open_tree(path: Path) -> ArrayRaster | None:
    """The image of a product whose layout is known; None when the file has none of the layouts.

    Raises
    ------
    InputError : cut short, or contents that contradict the layout.
    """
    store = Hdf5Store(path)
    with store.kept_open() as file:
        tree = tree_of(file)
        if tree is None:
            return None
        values = Values(file, path)
        datasets = [_dataset(store, file, array.path) for array in tree.arrays]
        ignore = _ignore(tree, values, datasets)
        pieces = tuple(
            _piece(array, dataset, store, values, ignore) for array, dataset in zip(tree.arrays, datasets, strict=True)
        )
        if len({(p.size("l"), p.size("s")) for p in pieces}) > 1:
            raise InputError(
                "arrays of different lines or samples: " + ", ".join(str(p.shape) for p in pieces), where=str(path)
            )
        transform, crs, notes = _position_in_tree(tree, values, pieces[0])
        summed = any(len(p.terms) > 1 for p in pieces)
        description = _description(tree, values, datasets, pieces, None if summed else ignore, notes)
        return ArrayRaster(path, store, pieces, transform, crs, description)


def lookup_raster(raster: ArrayRaster) -> ArrayRaster | None:
    """The geographic lookup table in a product in scanner geometry, as an image of two bands; None without."""
    if not isinstance(raster.store, Hdf5Store):
        return None
    store = raster.store
    with store.kept_open() as file:
        tree = tree_of(file)
        if tree is None or tree.lookup_table is None:
            return None
        columns = [c for name in tree.lookup_table if (c := store.dataset(file, name)) is not None]
        if len(columns) < 2:
            return None
        pieces = []
        for column in columns:
            if column.ndim != 2 or column.dtype.kind not in "iuf":
                raise InputError(f"{column.name!r} is no lookup table", where=str(raster.path))
            pieces.append(Piece((Term(column.name.strip("/")),), "ls", column.shape, np.dtype(np.int32)))
        fill = _fill(columns[0])
        transform, crs, _ = _position_in_tree(tree, Values(file, raster.path), pieces[0], grid=True)
    return ArrayRaster(raster.path, store, tuple(pieces), transform, crs, zero_for=fill)


def location_names(raster: ArrayRaster) -> tuple[str, str] | None:
    """Names of the arrays of longitude and latitude of every pixel, None where the product has none."""
    if not isinstance(raster.store, Hdf5Store):
        return None
    with raster.store.kept_open() as file:
        tree = tree_of(file)
        if tree is None or tree.location is None:
            return None
        arrays = [raster.store.dataset(file, name) for name in tree.location]
        fits = all(a is not None and a.shape == (raster.lines, raster.samples) for a in arrays)
    return tree.location if fits else None


def _dataset(store: Hdf5Store, file: h5py.File, name: str) -> h5py.Dataset:
    resolved = member(file, name).name.strip("/")
    dataset = store.dataset(file, resolved)
    if dataset is None or dataset.dtype.kind not in "iuf" or dataset.ndim != 3 or 0 in dataset.shape:
        raise InputError(f"{resolved!r} is no image of three axes", where=str(store.path))
    return dataset


def _piece(array: ImageArray, dataset: h5py.Dataset, store: Hdf5Store, values: Values, ignore: float | None) -> Piece:
    first = Term(dataset.name.strip("/"))
    if array.plus is None:
        return Piece((first,), array.dimensions, dataset.shape, dataset.dtype.newbyteorder("="))
    second = _dataset(store, values.file, array.plus.path)
    if second.shape != dataset.shape:
        raise InputError(f"{second.name!r} is of another shape than {dataset.name!r}", where=str(store.path))
    terms = (
        Term(first.name, 1.0, ignore),
        Term(second.name.strip("/"), 1.0 / values.number(array.plus.divisor), _fill(second)),
    )
    return Piece(terms, array.dimensions, dataset.shape, np.dtype(np.float32))


def _description(
    tree: Tree,
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
        if array.fwhm is not None and values.raw(array.fwhm) is not None:
            columns["fwhm"].append(values.numbers(array.fwhm, bands, "widths"))
        has_flags = array.good is not None and values.raw(array.good) is not None
        flags = values.numbers(str(array.good), bands, "flags") if has_flags else np.ones(bands)
        columns["good"].append(flags != 0)
        gain, offset = _scale(array, dataset, values)
        columns["gain"].append(np.full(bands, gain))
        columns["offset"].append(np.full(bands, offset))
    wavelength = np.concatenate(columns["wavelength"])
    good = np.concatenate(columns["good"]).astype(bool)
    for reference in tree.bad_ranges_nm:
        low_high = values.raw(reference)
        if low_high is not None and np.size(low_high) == 2:
            low, high = np.sort(np.asarray(low_high, float))
            good &= ~((wavelength >= low) & (wavelength <= high))
    sensor = values.text(tree.sensor) if tree.sensor.startswith("@") else tree.sensor
    entries = {key: text for key, reference in tree.entries.items() if (text := values.text(reference))}
    if sensor:
        entries["sensor"] = sensor
    unit, unit_notes = _unit(tree, datasets, values.path)
    return Description(
        tree.product,
        wavelength,
        np.concatenate(columns["fwhm"]) if len(columns["fwhm"]) == len(pieces) else None,
        tree.wavelength_unit,
        good,
        np.concatenate(columns["gain"]),
        np.concatenate(columns["offset"]),
        tree.quantity,
        unit,
        ignore,
        sensor or "",
        tree.sorts,
        entries,
        (*unit_notes, *notes, *([tree.remark] if tree.remark else [])),
    )


def _scale(array: ImageArray, dataset: h5py.Dataset, values: Values) -> tuple[float, float]:
    """Gain and offset of an array by its layout, else by the attributes that the CF conventions have for them."""
    if not {"scale", "divisor", "offset", "subtract", "range", "plus"} & array.model_fields_set:
        gain, offset = (stated_number(dataset.attrs, (name,)) for name in ("scale_factor", "add_offset"))
        return 1.0 if gain is None else gain, offset or 0.0
    if array.range is not None:
        low, high = (values.number(r) for r in array.range)
        return (high - low) / _HIGHEST, low
    divisor = values.number(array.divisor)
    if divisor == 0:
        raise InputError(f"{array.divisor!r} is 0", where=str(values.path), expected="a number to divide by")
    return values.number(array.scale) / divisor, values.number(array.offset) - values.number(array.subtract)


def _unit(tree: Tree, datasets: list[h5py.Dataset], path: Path) -> tuple[str, tuple[str, ...]]:
    """The unit of the layout; a unit that the image itself states takes its place when it is another."""
    if tree.quantity != "radiance":
        return tree.unit, ()
    for dataset in datasets:
        for name in ("units", "Units", "unit", "Unit"):
            stated = dataset.attrs.get(name)
            text = stated.decode("utf-8", "replace") if isinstance(stated, bytes) else stated
            try:
                if isinstance(text, str) and radiance_to_internal(text) != radiance_to_internal(tree.unit):
                    note = f"radiance in {text} as the file states, where the layout has {tree.unit or RADIANCE_UNIT}"
                    return text, (note,)
            except UsageError:
                continue  # a spelling that is not known: that of the layout stands
    return tree.unit, ()


def _ignore(tree: Tree, values: Values, datasets: list[h5py.Dataset]) -> float | None:
    if isinstance(tree.ignore, str):
        try:
            return values.number(tree.ignore)
        except InputError:
            pass
    stated = _fill(datasets[0])
    return stated if stated is not None or isinstance(tree.ignore, str) else tree.ignore


def _fill(dataset: h5py.Dataset) -> float | None:
    """The value that an array states for no data."""
    return stated_number(dataset.attrs, _FILL_NAMES)


def _position_in_tree(
    tree: Tree, values: Values, piece: Piece, *, grid: bool = False
) -> tuple[Affine | None, CRS | None, tuple[str, ...]]:
    """Transform and system of the image, or of the lookup table of one in scanner geometry (``grid``)."""
    crs = _crs(tree, values)
    if tree.lookup_table is not None and not grid:
        return None, None, ()
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
    tree: Tree, values: Values, piece: Piece, crs: CRS | None
) -> tuple[Affine | None, CRS | None, tuple[str, ...]]:
    """From the corners of the product, which are centres or edges of pixels: whichever gives the pixel its size."""
    west, north, east, south = (values.number(r) for r in tree.corner_pixels or ())
    size, lines, samples = float(tree.pixel_size or 0.0), piece.size("l"), piece.size("s")
    for inner, kind in ((1, "centres"), (0, "edges")):
        steps = (east - west) / (samples - inner), (north - south) / (lines - inner)
        if np.allclose(steps, size, rtol=1e-3):
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


def _crs(tree: Tree, values: Values) -> CRS | None:
    wkt, code = values.text(tree.crs), values.text(tree.epsg)
    if wkt is None and tree.crs is not None:  # of the grid mapping of CF, which has both names for it
        wkt = values.text(tree.crs.replace("@spatial_ref", "@crs_wkt"))
    try:
        if code is not None and re.search(r"[0-9]{4,6}", code):
            return CRS.from_epsg(int(re.findall(r"[0-9]{4,6}", code)[-1]))
    except CRSError:
        return None
    return crs_of_wkt(wkt)


_WAVE = re.compile(r"wave|wvl|lambda|band_?cent", re.IGNORECASE)
_WIDTH = re.compile(r"fwhm|band_?width", re.IGNORECASE)
_GOOD = re.compile(r"good|bbl", re.IGNORECASE)
_SAMPLE = re.compile(r"^(x|lon|longitude|easting|samples?|cross.?track|col(umn)?s?|ortho_x)$", re.IGNORECASE)
_LINE = re.compile(r"^(y|lat|latitude|northing|lines?|down.?track|along.?track|rows?|ortho_y)$", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class CandidateArray:
    """An array of three axes, and the coordinate that may tell its wavelengths."""

    group: str
    name: str
    array: xr.DataArray
    data: xr.Dataset
    wave: xr.DataArray | None

    @property
    def label(self) -> str:
        """Its path, axes and type, for messages."""
        axes = ", ".join(f"{axis} {size}" for axis, size in self.array.sizes.items())
        return f"{self.group.strip('/')}/{self.name}".strip("/") + f" ({axes}; {self.array.dtype})"


@reader
def open_labelled(path: Path, variable: str | None = None, engine: str | None = None) -> ArrayRaster:
    """The image of a file that xarray opens: the only array with a wavelength coordinate, or ``variable``.

    ``engine`` is one of xarray's; None takes the one that says it can open the file.

    Raises
    ------
    InputError : no installed engine opens it, or no array has three axes and wavelengths.
    UsageError : several arrays could be meant, or ``variable`` is none of them.
    """
    groups = _groups(path, engine)
    chosen = _chosen(list(_candidates(groups)), variable, str(path))
    group = None if chosen.group == "/" else chosen.group
    return _raster(chosen, XarrayStore(path, engine, group), path)


def _groups(path: Path, engine: str | None) -> list[tuple[str, xr.Dataset]]:
    """The groups of a file, their arrays not yet read."""
    import xarray as xr

    if path.is_file():  # whatever the engine, HDF5 is read by the one library
        check_hdf5(path)
    try:
        with unpacking():
            try:
                tree = xr.open_datatree(path, engine=engine, cache=False, **options(engine))
            except (NotImplementedError, TypeError, ValueError):  # an engine without groups
                with xr.open_dataset(path, engine=engine, cache=False, **options(engine)) as data:
                    return [("/", data)]
        with tree:
            return [(node.path, node.to_dataset()) for node in tree.subtree]
    except Exception as error:  # each engine has errors of its own
        raise InputError(
            "no installed engine of xarray opens it: " + str(error).split("\n", 1)[0],
            where=str(path),
            expected="a file of " + ", ".join(sorted(xr.backends.list_engines())),
            mend="install the engine of its kind, or save the array as an ENVI cube with its wavelengths",
        ) from error


def labelled_array(array: xr.DataArray | xr.Dataset, variable: str | None = None) -> ArrayRaster:
    """The image of an array of xarray that is at hand, read by parts when it is lazy.

    Raises
    ------
    InputError, UsageError : as for :func:`open_labelled`.
    """
    import xarray as xr

    path = Path(str(array.encoding.get("source") or "xarray"))
    if isinstance(array, xr.DataArray):
        array = array.to_dataset(name=array.name or "array")
    with unpacking():
        data = xr.decode_cf(array, decode_times=False)
    chosen = _chosen(list(_candidates([("/", data)])), variable, str(path))
    return _raster(chosen, MemoryStore(chosen.array.variable, path), path)


def _candidates(groups: list[tuple[str, xr.Dataset]]) -> Iterator[CandidateArray]:
    for group, data in groups:
        for name, array in data.data_vars.items():
            if array.ndim == 3 and array.dtype.kind in "iuf" and 0 not in array.shape:
                yield CandidateArray(group, str(name), array, data, _wavelengths(array, data))


def _wavelengths(array: xr.DataArray, data: xr.Dataset) -> xr.DataArray | None:
    """The coordinate of one axis that holds wavelengths, by its name, its standard name or its unit."""
    listed = [v for v in data.variables if data[v].ndim == 1 and data[v].dims[0] in array.dims]
    for test in (_is_wavelength, _has_wavelength_unit):
        fits = [v for v in listed if data[v].dtype.kind in "iuf" and test(str(v), data[v])]
        if len(fits) == 1:
            return data[fits[0]]
    return None


def _is_wavelength(name: str, array: xr.DataArray) -> bool:
    standard = array.attrs.get("standard_name", "")
    return standard == "radiation_wavelength" or (_WAVE.search(name) is not None and not _WIDTH.search(name))


def _has_wavelength_unit(name: str, array: xr.DataArray) -> bool:
    try:
        wavelength_to_nm(str(array.attrs.get("units", "")))
    except UsageError:
        return False
    return not _WIDTH.search(name)


def _chosen(candidates: list[CandidateArray], variable: str | None, where: str) -> CandidateArray:
    if variable is not None:
        wanted = variable.strip("/")
        named = [c for c in candidates if wanted in (c.name, f"{c.group.strip('/')}/{c.name}".strip("/"))]
        if len(named) != 1:
            listed = "; ".join(c.label for c in candidates) or "none"
            raise UsageError(f"{len(named)} arrays {variable!r}", where=where, expected=f"one of {listed}")
        if named[0].wave is None:
            raise InputError(
                f"{named[0].label} has no wavelength coordinate",
                where=where,
                mend="give a table of the bands, and save the array as an ENVI cube (docs/formats.md)",
            )
        return named[0]
    cubes = [c for c in candidates if c.wave is not None]
    if len(cubes) == 1:
        return cubes[0]
    if not cubes:
        listed = "; ".join(c.label for c in candidates) or "none of three axes"
        raise InputError(
            "no array of the file has a wavelength coordinate",
            where=where,
            expected=f"one of its arrays with wavelengths along an axis; it has {listed}",
            mend="save the array as an ENVI cube, wavelengths in the header (docs/formats.md, Cubes)",
        )
    raise UsageError(
        f"{len(cubes)} arrays could be meant",
        where=where,
        expected="; ".join(c.label for c in cubes),
        mend="state variable: which of them is the image",
    )


def _raster(chosen: CandidateArray, store: Store, path: Path) -> ArrayRaster:
    array, data, wave = chosen.array, chosen.data, chosen.wave
    assert wave is not None  # noqa: S101 - chosen by it
    axes = _axes(array, str(wave.dims[0]))
    along = {str(d): letter for d, letter in zip(array.dims, axes, strict=True)}
    piece = Piece((Term(chosen.name),), axes, array.shape, array.dtype.newbyteorder("="))
    stated = str(array.attrs.get("units", array.attrs.get("unit", ""))) or None
    quantity, unit, notes = _quantity(stated, chosen.name)
    packing = array.encoding.get("scale_factor", 1.0), array.encoding.get("add_offset", 0.0)
    description = Description(
        product=f"array {chosen.name!r}",
        wavelength=np.asarray(wave.values, float),
        fwhm=_beside(data, wave, _WIDTH),
        wavelength_unit=str(wave.attrs.get("units", wave.attrs.get("unit", ""))) or None,
        good=None if (flags := _beside(data, wave, _GOOD)) is None else flags != 0,
        packing=(float(packing[0]), float(packing[1])),
        quantity=quantity,
        unit=unit,
        sensor=str(data.attrs.get("instrument", data.attrs.get("sensor", ""))),
        entries={str(k): str(v) for k, v in data.attrs.items() if isinstance(v, str | int | float)},
        notes=notes,
    )
    transform, crs = _array_position(data, array, along)
    return ArrayRaster(path, store, (piece,), transform, crs, description)


def _axes(array: xr.DataArray, band_axis: str) -> str:
    """Which axis is lines, samples, bands: by name, else lines before samples."""
    others = [str(d) for d in array.dims if d != band_axis]
    swapped = bool(_SAMPLE.match(others[0]) or _LINE.match(others[1]))
    letters = {band_axis: "b", others[0]: "s" if swapped else "l", others[1]: "l" if swapped else "s"}
    return "".join(letters[str(d)] for d in array.dims)


def _quantity(unit: str | None, name: str) -> tuple[str | None, str | None, tuple[str, ...]]:
    """Radiance where the unit is one, reflectance where the name says so, with its unit; None: nothing says."""
    try:
        radiance_to_internal(unit or "")
        return "radiance", unit, ()
    except UsageError:
        pass
    known = {"%": "percent", "percent": "percent", "1": "1", "unitless": "1", "none": "1"}.get((unit or "1").lower())
    if known is None:
        return None, None, (f"the array states its unit as {unit!r}, which is not known",)
    named = re.search("reflectance|rfl|rrs", name, re.IGNORECASE)
    return "reflectance" if named else None, known if named or known == "percent" else None, ()


def _beside(data: xr.Dataset, wave: xr.DataArray, name: re.Pattern[str]) -> Array | None:
    """Another array along the axis of the wavelengths, by its name."""
    fits = [v for v in data.variables if data[v].dims == wave.dims and name.search(str(v))]
    fits = [v for v in fits if data[v].dtype.kind in "iufb"]
    return np.asarray(data[fits[0]].values, float) if len(fits) == 1 else None


def _array_position(data: xr.Dataset, array: xr.DataArray, along: dict[str, str]) -> tuple[Affine | None, CRS | None]:
    """From the grid mapping (CF, GDAL), else from evenly spaced coordinates of lines and samples."""
    mapping = str(array.attrs.get("grid_mapping", array.encoding.get("grid_mapping", "spatial_ref")))
    attrs = data[mapping].attrs if mapping in data.variables else {}
    wkt = attrs.get("crs_wkt", attrs.get("spatial_ref"))
    crs = crs_of_wkt(wkt) if isinstance(wkt, str) else None
    transform = gdal_transform(str(attrs.get("GeoTransform", "")))
    if transform is not None:
        return transform, crs
    steps = {}
    for dim, letter in along.items():
        if letter == "b" or dim not in data.variables or data[dim].ndim != 1 or data[dim].size < 2:
            continue
        at = np.asarray(data[dim].values, float)
        step = np.diff(at)
        if np.all(np.isfinite(at)) and step[0] != 0 and np.allclose(step, step[0], rtol=1e-3):
            steps[letter] = (at[0], (at[-1] - at[0]) / (at.size - 1))
    if set(steps) != {"l", "s"} or crs is None:
        return None, crs
    (y, dy), (x, dx) = steps["l"], steps["s"]
    return Affine(dx, 0.0, x - 0.5 * dx, 0.0, dy, y - 0.5 * dy), crs


class XarrayStore(OpenedFile):
    """A group of a file as an engine of xarray opens it; packed values are unpacked by the CF conventions."""

    def __init__(self, path: Path, engine: str | None = None, group: str | None = None) -> None:
        super().__init__(path)
        self.engine, self.group = engine, group

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens it for itself."""
        return type(self), (self.path, self.engine, self.group)

    def open(self) -> xr.Dataset:
        """The group; InputError when no installed engine opens it."""
        import xarray as xr

        try:
            with unpacking():
                return xr.open_dataset(
                    self.path, engine=self.engine, group=self.group, cache=False, **options(self.engine)
                )
        except Exception as error:  # each engine has errors of its own
            raise InputError(f"no engine of xarray opens it: {error}", where=str(self.path)) from error

    def read(self, name: str, selection: Selection) -> npt.NDArray[Any]:
        """A part of an array."""
        with self.kept_open() as data:
            return np.asarray(data[name][selection].values)

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Size of the blocks that an array is stored in."""
        with self.kept_open() as data:
            size: tuple[int, ...] | None = data[name].encoding.get("chunksizes")
            return size


def unpacking() -> AbstractContextManager[Any]:
    """Without the warning that an array has two no-data values: both are taken as such."""
    import xarray as xr

    return warnings.catch_warnings(action="ignore", category=xr.SerializationWarning)


def options(engine: str | None) -> dict[str, Any]:
    """Options of xarray that leave times alone, and let HDF5 files be read that name no dimensions."""
    plain: dict[str, Any] = {"decode_times": False}
    return plain | {"phony_dims": "sort"} if engine == "h5netcdf" else plain
