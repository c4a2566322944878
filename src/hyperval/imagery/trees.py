"""Products in trees of arrays (HDF5, NetCDF-4, HDF-EOS5), opened by their layout."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS
from rasterio.errors import CRSError

from hyperval.envi_header import parse_header
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery.array_raster import ArrayRaster, Piece, Term
from hyperval.imagery.description import Description
from hyperval.imagery.georeference import crs_of, crs_of_wkt, gdal_transform, transform_of
from hyperval.imagery.layouts import ImageArray, Tree, Values, member, stated_number, tree_of
from hyperval.imagery.stores import Hdf5Store
from hyperval.units import RADIANCE_UNIT, radiance_to_internal

Array = npt.NDArray[np.float64]
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
            _piece(array, dataset, store, values, ignore)
            for array, dataset in zip(tree.arrays, datasets, strict=True)
        )
        if len({(p.size("l"), p.size("s")) for p in pieces}) > 1:
            raise InputError(
                "arrays of different lines or samples: " + ", ".join(str(p.shape) for p in pieces), where=str(path)
            )
        transform, crs, notes = _position(tree, values, pieces[0])
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
        transform, crs, _ = _position(tree, Values(file, raster.path), pieces[0], grid=True)
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


def _piece(
    array: ImageArray, dataset: h5py.Dataset, store: Hdf5Store, values: Values, ignore: float | None
) -> Piece:
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
    for array, piece in zip(tree.arrays, pieces, strict=True):
        bands = piece.size("b")
        columns["wavelength"].append(values.numbers(array.wavelength, bands, "wavelengths"))
        if array.fwhm is not None and values.raw(array.fwhm) is not None:
            columns["fwhm"].append(values.numbers(array.fwhm, bands, "widths"))
        has_flags = array.good is not None and values.raw(array.good) is not None
        flags = values.numbers(str(array.good), bands, "flags") if has_flags else np.ones(bands)
        columns["good"].append(flags != 0)
        gain, offset = _scale(array, values)
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


def _scale(array: ImageArray, values: Values) -> tuple[float, float]:
    """Gain and offset of an array."""
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
                    note = (
                        f"radiance in {text} as the file states, where the layout has {tree.unit or RADIANCE_UNIT}"
                    )
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


def _position(
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
