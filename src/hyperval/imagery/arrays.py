"""Images in files of named arrays, read by blocks of lines like any other raster.

HDF5, NetCDF, Zarr and whatever else an engine of xarray opens, where the array with a wavelength coordinate is the
image; MATLAB and NumPy files; arrays of xarray and SPy that are at hand.
"""

from __future__ import annotations

import re
import tempfile
import threading
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt
import scipy
from affine import Affine
from rasterio.crs import CRS

from hyperval.data import Array
from hyperval.envi_header import EnviHeader
from hyperval.errors import reader, refusal, refuse
from hyperval.hdf5 import check_hdf5, trial
from hyperval.imagery.description import Description, ListedBands, Raster, Scale, crs_of_wkt, gdal_transform
from hyperval.imagery.envi import crs_of
from hyperval.spectra.text import title_words
from hyperval.units import in_nm, is_radiance, plausible

if TYPE_CHECKING:
    import xarray as xr

Selection = tuple[slice, ...]
Numbers = npt.NDArray[Any]
Position = tuple[Affine | None, CRS | None]
AXES = "bls"  # bands, lines, samples: the order in which values are handed out
MAX_CHUNK_BYTES = 256 << 20
CACHE_BYTES = 1 << 20  # of unpacked blocks that the library keeps: by itself 8 MB, though each is asked for once
SLAB_BYTES = 8 << 20  # of lines that are kept in memory, where they are stored in blocks
MAX_MATRIX_BYTES = 2 << 30  # of an array that is read whole
UNPACKED_BYTES = 4 << 30  # of lines that are unpacked into a file, which a folder in memory has room for
MAX_COMPRESSED = 2_000  # times; what deflate can do is a thousand
MATRICES = {b"MATLAB 7.3": "MATLAB 7.3", b"MATLAB": "MATLAB 5", b"\x93NUMPY": "NumPy"}
_FILLS = ("_FillValue", "Data_Ignore_Value", "missing_value")
_WAVE = re.compile(r"wave|wvl|(?<![a-z])wl(?![a-z])|lambda|band_?cent", re.IGNORECASE)
_WIDTH = re.compile(r"fwhm|band_?width", re.IGNORECASE)
_GOOD = re.compile(r"good|bbl", re.IGNORECASE)
_TRUTH = re.compile(r"map|truth|gt|mask|label", re.IGNORECASE)
_VALID = re.compile(r"valid", re.IGNORECASE)
_PICTURE = re.compile(r"rgb", re.IGNORECASE)
_NO_CENTRE = re.compile(f"{_WIDTH.pattern}|{_GOOD.pattern}", re.IGNORECASE)
_SAMPLE = re.compile(r"^(x|lon|longitude|easting|samples?|cross.?track|col(umn)?s?|ortho_x)$", re.IGNORECASE)
_LINE = re.compile(r"^(y|lat|latitude|northing|lines?|down.?track|along.?track|rows?|ortho_y)$", re.IGNORECASE)
# Vectors beside an image without labels, and the axis that they lie along.
_EASTING, _NORTHING = re.compile("easting", re.IGNORECASE), re.compile("northing", re.IGNORECASE)
_BESIDE = (_WAVE, "b"), (_WIDTH, "b"), (_EASTING, "s"), (_NORTHING, "l")
_FRACTIONS = {"%": "percent", "percent": "percent", "1": "1", "unitless": "1", "none": "1"}
_FRACTIONS |= dict.fromkeys(("sr-1", "sr^-1", "1/sr", "/sr"), "sr-1")


# What is opened: a mapping from names to arrays ---------------------------------------------------------------------


class ArrayFile:
    """A file that is opened for each read or, inside :meth:`kept_open`, once for all of them.

    ``opener`` (path, *arguments) gives what is opened; another process opens it for itself.
    """

    def __init__(self, path: Path, opener: Callable[..., Any], *arguments: Any) -> None:
        self.path, self.opener, self.arguments = path, opener, arguments
        self.lock = threading.Lock()
        self.held = threading.local()  # the lines that each thread read last
        self._opened: Any = None
        self._users = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self.opener, *self.arguments)

    @contextmanager
    def kept_open(self) -> Iterator[Any]:
        """What is opened, closed when the last of its users has left; arrays in memory stay."""
        with self.lock:
            if self._opened is None:
                self._opened = self.opener(self.path, *self.arguments)
            self._users += 1
        try:
            yield self._opened
        finally:
            with self.lock:
                self._users -= 1
                if not self._users and hasattr(self._opened, "close"):
                    self._opened.close()
                    self._opened = None

    def read(self, name: str, selection: Selection) -> Numbers:
        """A part of a named array; InputError where it cannot be read."""
        try:
            with self.kept_open() as opened:
                return np.asarray(opened[name][selection])
        except (OSError, KeyError, ValueError, RuntimeError, TypeError) as error:
            raise refusal("array.unreadable", self.path, name=name, why=error) from error


def hdf5(path: Path) -> h5py.File:
    """An HDF5 file, NetCDF-4 and HDF-EOS5 among them.

    Raises
    ------
    InputError : it is none, is cut short, or one that the library does not come back from.
    """
    check_hdf5(path)
    try:
        return h5py.File(path, "r", rdcc_nbytes=CACHE_BYTES)
    except OSError as error:
        raise refusal("array.hdf5", path, why=error) from error


def _tree(path: Path, engine: str | None) -> xr.DataTree:
    """The groups of a file as an engine of xarray opens it; packed values are unpacked by the CF conventions.

    Times are left alone, and HDF5 files may name no dimensions.
    """
    import xarray as xr

    if path.is_file():  # whatever the engine, HDF5 is read by the one library
        check_hdf5(path)
    options: dict[str, Any] = {"engine": engine, "cache": False, "decode_times": False}
    options |= {"phony_dims": "sort"} if engine == "h5netcdf" else {}
    try:
        with warnings.catch_warnings(action="ignore", category=xr.SerializationWarning):  # of two no-data values
            try:
                return xr.open_datatree(path, **options)
            except (NotImplementedError, TypeError, ValueError):  # an engine without groups
                return xr.DataTree(xr.open_dataset(path, **options))
    except Exception as error:  # each engine has errors of its own
        engines = ", ".join(sorted(xr.backends.list_engines()))
        raise refusal("array.no_engine", path, why=str(error).split("\n", 1)[0], known=engines) from error


@reader
def _matrix(path: Path, kind: str, *names: str) -> dict[str, Numbers]:
    """The arrays of variables of a MATLAB 5 file, read whole, or the one of a NumPy file, which is mapped.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "x.mat", {"map": scipy.sparse.csc_array([[0.0, 2.0]])})
    ...     _shapes(path, "MATLAB 5"), _matrix(path, "MATLAB 5", "map")["map"].tolist()
    ({'map': (1, 2)}, [[0.0, 2.0]])
    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "x.mat", {"a": np.arange(999.0)}, do_compression=True)
    ...     _ = path.write_bytes(path.read_bytes()[:-4])
    ...     ArrayFile(path, _matrix, "MATLAB 5", "a").read("a", ())
    Traceback (most recent call last):
    hyperval.errors.InputError: ...: damaged, or not of the kind that its name says (...
      to fix it: correct it there, or copy the file again
    """
    if kind == "NumPy":
        return {path.stem: np.load(path, mmap_mode="r", allow_pickle=False)}
    variables = {name.split("/")[0] for name in names}
    held = scipy.io.loadmat(path, variable_names=variables)
    return {name: array for variable in variables for name, array in _fields(variable, held[variable])}


def _fields(name: str, value: Any) -> Iterator[tuple[str, Numbers]]:
    """The arrays of numbers or text of a variable of MATLAB by name: itself, or field b of struct a as "a/b"."""
    value = value.toarray() if scipy.sparse.issparse(value) else value
    if value.dtype.names and value.size == 1:
        for field_name in value.dtype.names:
            yield from _fields(f"{name}/{field_name}", np.asarray(value[field_name].flat[0]))
    elif value.dtype.kind == "O" and all(np.asarray(v).dtype.kind == "U" for v in value.flat):  # a cell of texts
        yield name, np.array(["".join(np.ravel(v)).replace(",", ";") for v in value.flat], str)  # commas part them
    elif value.dtype.kind in "iufbcU":
        yield name, value


def at_hand(path: Path, name: str, array: Any) -> dict[str, Any]:
    """An array of xarray or SPy; it is read by parts as well."""
    return {name: array}


def check_own_values(path: Path) -> None:
    """Raise InputError where an HDF5 file leads to others: external links, external or virtual arrays."""

    def foreign(name: str, item: Any) -> str | None:  # an error that it raises would be lost in the library
        elsewhere = isinstance(item, h5py.Dataset) and (item.external or item.is_virtual)
        return name if elsewhere or isinstance(item, h5py.ExternalLink) else None

    with ArrayFile(path, hdf5).kept_open() as file:
        found = file.visititems_links(foreign) or file.visititems(foreign)
    refuse(found, "array.foreign", path, name=found)


# The image in its arrays --------------------------------------------------------------------------------------------


class Term(NamedTuple):
    """One array of a sum: weight * stored, NaN where the stored value is ``ignore``."""

    name: str
    weight: float = 1.0
    ignore: float | None = None


class BandArrays(NamedTuple):
    """Arrays that give some bands of the image.

    Attributes
    ----------
    terms : one array, taken as stored; or several of one shape, whose weighted sum is taken as float32
    axes : order of the axes in the file, such as "bls" for (band, line, sample); "ls" for a single band; "-" for one
        of length 1 that is none of them
    shape : of the arrays in the file
    dtype : of the values handed out
    """

    terms: tuple[Term, ...]
    axes: str
    shape: tuple[int, ...]
    dtype: np.dtype

    def size(self, axis: str) -> int:
        """Length of an axis: "l" lines, "s" samples, "b" bands."""
        return self.shape[self.axes.index(axis)] if axis in self.axes else 1


@dataclass(frozen=True, eq=False)
class ArrayRaster(Raster):
    """An image of one or several arrays of a file, their bands one after the other.

    Attributes
    ----------
    store : reads parts of its arrays
    pieces : the arrays, in the order of the bands
    """

    store: ArrayFile = field(kw_only=True)
    pieces: tuple[BandArrays, ...] = field(kw_only=True)

    kind = "arrays of a file"
    in_blocks = True

    @contextmanager
    def kept_open(self) -> Iterator[object]:
        """Inside, the file is opened once for all reads; the lines that this thread holds are given back after."""
        with self.store.kept_open() as opened:
            yield opened
        self.store.held.slab = None

    def _read(self, first: int, count: int, buffer: Numbers | None) -> Numbers:
        """Consecutive lines, of those that this thread holds or that take their place.

        Arrays that are stored in blocks are read by as many lines as their blocks have, and these are kept for the
        next call of the same thread: in memory where they fit into ``SLAB_BYTES``, else unpacked into a file, so
        that no block is unpacked twice and few are in memory.  Lines far from those before are read alone.
        """
        cache = self.store.held
        held = getattr(cache, "slab", None)
        if held is None or first < held[0] or first + count > held[0] + held[1]:
            cache.slab = held = None  # the memory of the one before is given back first
            block = max(self._block(piece, "l", 1) for piece in self.pieces)
            lines = count
            if first == 0 or 0 <= first - getattr(cache, "end", -block) <= block:  # one after the other
                lines = max(count, min((first // block + 1) * block - first, self.lines - first))
            cache.slab = held = self._slab(first, count, lines)
        cache.end = first + count
        return held[2](first - held[0], count)

    def _slab(self, first: int, count: int, lines: int) -> tuple[int, int, Callable[[int, int], Numbers]]:
        """First line, number of lines and reader of at least ``count`` lines, ``lines`` of them where they fit."""
        size = self.samples * self.bands * self.dtype.itemsize
        fit = max(count, SLAB_BYTES // size)
        if fit < lines <= UNPACKED_BYTES // size:
            with suppress(OSError):  # no room for the file: each block is unpacked several times, only slower
                return first, lines, self._unpacked(first, lines)
        lines = min(lines, fit)
        values = self._box(slice(0, self.bands), slice(first, first + lines), slice(0, self.samples))
        return first, lines, lambda start, count: values[:, start : start + count]

    def _unpacked(self, first: int, lines: int) -> Callable[[int, int], Numbers]:
        """Reader of lines in a file, one after the other with all their bands; those of one block are in memory."""
        file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open for as long as its reader is there
        row = self.samples * self.dtype.itemsize

        def read(start: int, count: int) -> Numbers:
            out = np.empty((count, self.bands, self.samples), self.dtype)
            file.seek(start * self.bands * row)
            file.readinto(out.data.cast("B"))
            return out.transpose(1, 0, 2)

        weakref.finalize(read, file.close)
        step = min(self._block(piece, "b", piece.size("b")) for piece in self.pieces)
        for band in range(0, self.bands, step):
            bands = slice(band, min(band + step, self.bands))
            values = self._box(bands, slice(first, first + lines), slice(0, self.samples))
            for line in range(lines):
                file.seek((line * self.bands + band) * row)
                file.write(np.ascontiguousarray(values[:, line], self.dtype).data)
            del values
        return read

    def read_some_bands(self, first: int, count: int, bands: Sequence[int]) -> Numbers:
        """(n, count, samples) values of consecutive lines in a few bands, which alone are read."""
        part = slice(first, first + count), slice(0, self.samples)
        with self.kept_open():
            return np.concatenate([self._box(slice(band, band + 1), *part) for band in bands])

    def _block(self, piece: BandArrays, axis: str, whole: int) -> int:
        """Size along an axis of the blocks that a piece is stored in; ``whole`` where it is not stored in blocks."""
        with self.store.kept_open() as opened:
            array = opened[piece.terms[0].name]
            of_tree = getattr(array, "encoding", {}).get("chunksizes")
            chunks = array.chunks if isinstance(array, h5py.Dataset) else of_tree
        return int(chunks[piece.axes.index(axis)]) if chunks and axis in piece.axes else whole

    def _box(self, bands: slice, lines: slice, samples: slice) -> Numbers:
        parts, first = [], 0
        for piece in self.pieces:
            part = slice(max(bands.start - first, 0), min(bands.stop - first, piece.size("b")))
            if part.start < part.stop:
                parts.append(self._values(piece, {"b": part, "l": lines, "s": samples}))
            first += piece.size("b")
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _values(self, piece: BandArrays, ranges: Mapping[str, slice]) -> Numbers:
        """(bands, lines, samples) of a part of a piece."""
        selection = tuple(ranges.get(axis, slice(0, 1)) for axis in piece.axes)
        order = sorted(range(len(piece.axes)), key=lambda axis: f"{AXES}-".index(piece.axes[axis]))
        size = [ranges[axis].stop - ranges[axis].start for axis in AXES]
        parts = [self.store.read(term.name, selection).transpose(order).reshape(size) for term in piece.terms]
        total = parts[0]
        if len(parts) > 1:
            total = np.zeros(size, np.float32)
            for term, stored in zip(piece.terms, parts, strict=True):
                total += np.float32(term.weight) * stored.astype(np.float32)
                if term.ignore is not None:
                    total[stored == term.ignore] = np.nan
        return np.asarray(total, piece.dtype)


def array_raster(
    store: ArrayFile, pieces: tuple[BandArrays, ...], description: Description, position: Position = (None, None)
) -> ArrayRaster:
    """The image of some arrays of one size.

    Raises
    ------
    InputError : lines and samples differ.
    """
    lines, samples = pieces[0].size("l"), pieces[0].size("s")
    unlike = any((p.size("l"), p.size("s")) != (lines, samples) for p in pieces)
    refuse(unlike, "array.sizes", store.path, shapes=", ".join(str(p.shape) for p in pieces))
    size, dtype = (lines, samples, sum(p.size("b") for p in pieces)), np.result_type(*(p.dtype for p in pieces))
    return ArrayRaster(store.path, *size, dtype, description, *position, store=store, pieces=pieces)


def packing(attributes: Mapping[str, Any]) -> tuple[float, float]:
    """Gain and offset of packed numbers by the attributes that the CF conventions have for them.

    >>> packing({"scale_factor": np.array([2e-4])}), packing({"add_offset": 0.5})
    ((0.0002, 0.0), (1.0, 0.5))
    """
    gain, offset = (stated(attributes, name) for name in ("scale_factor", "add_offset"))
    return 1.0 if gain is None else gain, offset or 0.0


def texts_of(value: Any) -> tuple[str, ...]:
    """The texts or numbers of an attribute or a small array as texts, none of what is empty.

    >>> texts_of(h5py.Empty("S1")), texts_of(b"nm"), stated({"_FillValue": h5py.Empty("f4")})
    ((), ('nm',), None)
    """
    return tuple(v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in _listed(value))


def _listed(value: Any) -> Sequence[Any]:
    return () if value is None or isinstance(value, h5py.Empty) else list(np.ravel(value))


def stated(attributes: Mapping[str, Any], *names: str) -> float | None:
    """The number in the first of some attributes that holds a single one, a no-data value by default; None without."""
    found = (_listed(attributes.get(name)) for name in names or _FILLS)
    return next((float(each[0]) for each in found if len(each) == 1), None)


# Arrays with labels: xarray -----------------------------------------------------------------------------------------


class LabelledArray(NamedTuple):
    """An array of three axes in a file: its name with that of its groups, and the data beside it.

    ``bands`` : the data with wavelengths along one of its axes, and these; None without
    """

    path: str
    array: xr.DataArray
    data: xr.Dataset
    bands: tuple[xr.Dataset, xr.DataArray] | None


@reader
def open_labelled(path: Path, variable: str | None = None, engine: str | None = None) -> ArrayRaster:
    """The image of a file that xarray opens: the only array with a wavelength coordinate, or ``variable``.

    ``engine`` is one of xarray's; None takes the one that says it can open the file.

    Raises
    ------
    InputError : no installed engine opens it, or no array has three axes and wavelengths.
    UsageError : several arrays could be meant, or ``variable`` is none of them.
    """
    store = ArrayFile(path, _tree, engine)
    with store.kept_open() as tree:
        return _labelled_raster(_chosen([(n.path, n.to_dataset()) for n in tree.subtree], variable, path), store)


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
    with warnings.catch_warnings(action="ignore", category=xr.SerializationWarning):
        data = xr.decode_cf(array, decode_times=False)
    chosen = _chosen([("/", data)], variable, path)
    return _labelled_raster(chosen, ArrayFile(path, at_hand, chosen.path, chosen.array.variable))


def _wavelengths(array: xr.DataArray, data: xr.Dataset) -> xr.DataArray | None:
    """The coordinate of one axis that holds wavelengths, by its name, its standard name or its unit."""
    named, in_unit = list[Any](), list[Any]()
    for name, v in data.variables.items():
        standard = v.attrs.get("standard_name") == "radiation_wavelength"
        other = _NO_CENTRE.search(str(name)) and not standard
        if other or v.ndim != 1 or v.dims[0] not in array.dims or v.dtype.kind not in "iuf":
            continue
        if standard or _WAVE.search(str(name)):
            named.append(name)
        if (factor := in_nm(str(v.attrs.get("units", "")))) and plausible(v.values[v.values > 0] * factor):
            in_unit.append(name)
    return next((data[fits[0]] for fits in (named, in_unit) if len(fits) == 1), None)


def _chosen(groups: list[tuple[str, xr.Dataset]], variable: str | None, where: Path) -> LabelledArray:
    """The array that is named, else the only one with wavelengths: in its group, or where none has any in another."""

    def candidates(others: Sequence[xr.Dataset]) -> list[LabelledArray]:
        return [
            LabelledArray(f"{group}/{array.name}".strip("/"), array, data, _bands(array, (data, *others)))
            for group, data in groups
            for array in data.data_vars.values()
            if 3 in (array.ndim, sum(n > 1 for n in array.shape)) and array.dtype.kind in "iuf" and 0 not in array.shape
        ]

    def labels(arrays: list[LabelledArray]) -> str:
        axes = [", ".join(f"{axis} {size}" for axis, size in one.array.sizes.items()) for one in arrays]
        return "; ".join(f"{o.path} ({a}; {o.array.dtype})" for o, a in zip(arrays, axes, strict=True))

    found = candidates(())
    if all(one.bands is None for one in found):
        found = candidates([data for _, data in groups])
    listed = labels(found)
    if variable is not None:
        named = [one for one in found if variable.strip("/") in (one.array.name, one.path)]
        refuse(len(named) != 1, "array.unknown", where, count=len(named), variable=variable, listed=listed or "none")
        refuse(named[0].bands is None, "array.no_coordinate", where, label=labels(named))
        return named[0]
    cubes = [one for one in found if one.bands is not None]
    refuse(not cubes, "array.no_coordinates", where, listed=listed or "none of three axes")
    refuse(len(cubes) > 1, "array.several", where, count=len(cubes), labels=labels(cubes))
    return cubes[0]


def _bands(array: xr.DataArray, sources: Iterable[xr.Dataset]) -> tuple[xr.Dataset, xr.DataArray] | None:
    """The first data that have wavelengths along an axis of an array, and these; None without."""
    pairs = ((data, _wavelengths(array, data)) for data in sources)
    return next(((d, w) for d, w in pairs if w is not None and w.size == array.sizes[w.dims[0]]), None)


def _labelled_raster(chosen: LabelledArray, store: ArrayFile) -> ArrayRaster:
    array, data = chosen.array, chosen.data
    assert chosen.bands is not None  # noqa: S101 - chosen by them
    dataset, wave = chosen.bands
    axes = _axes(array, str(wave.dims[0]))
    piece = BandArrays((Term(chosen.path),), axes, array.shape, array.dtype.newbyteorder("="))
    quantity, unit, notes = quantity_of(_stated_unit(array), str(array.name), str(array.attrs.get("long_name", "")))
    good, width = (_along_bands(dataset, wave, name) for name in (_GOOD, _WIDTH))
    centre, flags = np.asarray(wave.values, float), None if good is None else good != 0
    about = Description(
        product=f"array {str(array.name)!r}",
        bands=ListedBands(np.where(centre > 0, centre, np.nan), width, _stated_unit(wave), flags),
        packing=packing(array.encoding),
        quantity=quantity,
        unit=unit,
        sensor=str(data.attrs.get("instrument", data.attrs.get("sensor", ""))),
        entries={str(k): str(v) for k, v in data.attrs.items() if isinstance(v, str | int | float)},
        notes=notes,
        ignored=stated(array.encoding),
    )
    return array_raster(store, (piece,), about, _labelled_position(data, array, axes))


def _stated_unit(array: xr.DataArray | xr.Variable) -> str | None:
    return str(array.attrs.get("units", array.attrs.get("unit", ""))) or None


def _axes(array: xr.DataArray, band_axis: str) -> str:
    """Which axis is lines, samples, bands: by name, else lines before samples; others have a length of 1.

    Axes that a file does not name are named by their size, so that those of one size bear the first one's name.

    >>> import xarray as xr
    >>> phony = [f"phony_dim_{i}" for i in range(3)]
    >>> [_axes(xr.DataArray(np.ones(size), dims=phony), "phony_dim_0") for size in ((4, 6, 4), (4, 6, 5))]
    ['lsb', 'bls']
    """
    if band_axis.startswith("phony_dim") and array.shape[-1] == array.sizes[band_axis]:  # named by its size alone
        band_axis = str(array.dims[-1])
    others = [str(d) for d, size in array.sizes.items() if d != band_axis and (size > 1 or array.ndim == 3)]
    swapped = bool(_SAMPLE.match(others[0]) or _LINE.match(others[1]))
    letters = {band_axis: "b", others[0]: "s" if swapped else "l", others[1]: "l" if swapped else "s"}
    return "".join(letters.get(str(d), "-") for d in array.dims)


def quantity_of(unit: str | None, name: str, title: str) -> tuple[str | None, str | None, tuple[str, ...]]:
    """Radiance where the unit is one, reflectance where the name or another unit says so; None: nothing says.

    Deviations where the name or the title says so.

    >>> quantity_of("sr^-1", "sea", ""), quantity_of("%", "", ""), quantity_of("", "u", "Reflectance Uncertainty")
    (('reflectance', 'sr-1', ()), ('reflectance', 'percent', ()), ('deviations', None, ()))
    """
    if any(title_words(words)[1] for words in (name, title)):
        return "deviations", None, ()
    if is_radiance(unit):
        return "radiance", unit, ()
    factor = _FRACTIONS.get((unit or "1").lower())
    if factor is None:
        return None, None, (f"the array states its unit as {unit!r}, which is not known",)
    says = factor != "1" or re.search("reflectance|rfl|(?<![a-z])rrs", name, re.IGNORECASE)
    return ("reflectance", factor, ()) if says else (None, None, ())


def _along_bands(data: xr.Dataset, wave: xr.DataArray, name: re.Pattern[str]) -> Array | None:
    """Another array along the axis of the wavelengths, by its name; lengths in the unit of those.

    >>> import xarray as xr
    >>> wave = xr.DataArray([0.5, 0.6], dims="band", attrs={"units": "um"})
    >>> width = xr.DataArray([6.0, 7.0], dims="band", attrs={"units": "nm"})
    >>> _along_bands(xr.Dataset({"wavelength": wave, "fwhm": width}), wave, _WIDTH).round(9).tolist()
    [0.006, 0.007]
    """
    fits = [v for n, v in data.variables.items() if v.dims == wave.dims and name.search(str(n))]
    fits = [v for v in fits if v.dtype.kind in "iufb"]
    if len(fits) != 1:
        return None
    unit, wave_unit = (in_nm(_stated_unit(x)) for x in (fits[0], wave))
    return np.asarray(fits[0].values, float) * (unit / wave_unit if unit and wave_unit else 1.0)


def _labelled_position(data: xr.Dataset, array: xr.DataArray, axes: str) -> Position:
    """From the grid mapping (CF, GDAL), else from evenly spaced coordinates of lines and samples."""
    mapping = str(array.attrs.get("grid_mapping", array.encoding.get("grid_mapping", "spatial_ref")))
    attrs = data[mapping].attrs if mapping in data.variables else {}
    wkt = attrs.get("crs_wkt", attrs.get("spatial_ref"))
    crs = crs_of_wkt(wkt) if isinstance(wkt, str) else None
    transform = gdal_transform(str(attrs.get("GeoTransform", "")))
    if transform is not None or crs is None:
        return transform, crs
    lines, samples = (
        np.asarray(data[dim].values, float) if dim in data.variables and data[dim].ndim == 1 else np.empty(0)
        for dim in (array.dims[axes.index(letter)] for letter in "ls")
    )
    return _even_grid(samples, lines), crs


def _even_grid(x: Array, y: Array) -> Affine | None:
    """The transform of a grid by the coordinates of its centres along samples and lines; None where they are uneven."""
    for c in (x, y):
        step = np.diff(c)
        if not step.size or not np.all(np.isfinite(c)) or not step[0] or not np.allclose(step, step[0], rtol=1e-3):
            return None
    dx, dy = ((c[-1] - c[0]) / (c.size - 1) for c in (x, y))
    return Affine(dx, 0.0, x[0] - 0.5 * dx, 0.0, dy, y[0] - 0.5 * dy)


# Arrays without labels: MATLAB, NumPy -------------------------------------------------------------------------------


def _shapes(path: Path, kind: str) -> dict[str, tuple[int, ...]]:
    """The numeric arrays of a file without labels and their shapes; "a/b" is in the struct or group a."""
    shapes: dict[str, tuple[int, ...]] = {}
    if kind == "NumPy":
        shapes[path.stem] = _matrix(path, kind)[path.stem].shape
    elif kind == "MATLAB 5":
        for name, shape, what in scipy.io.whosmat(path):
            if re.match("u?int|single|double|logical|sparse", what):
                shapes[name] = shape
            elif what == "struct":  # whose size is known when it is read
                if why := trial(partial(scipy.io.loadmat, path, variable_names=[name])):
                    raise ValueError(why)
                shapes |= {n: v.shape for n, v in _matrix(path, kind, name).items() if v.dtype.kind != "U"}
    else:
        check_own_values(path)

        def visit(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset) and item.dtype.kind in "iufb" and not name.startswith("#"):
                shapes[name] = item.shape[:: -1 if kind == "MATLAB 7.3" else 1]

        with ArrayFile(path, hdf5).kept_open() as file:
            file.visititems(visit)
    return shapes


def _matrix_axes(shape: tuple[int, ...], waves: set[int], beside: set[tuple[int, ...]]) -> str:
    """Which axis of an image is lines, samples, bands.

    Bands lie along the only axis that wavelengths beside it fit, by their numbers; else along the first where a map
    beside it is as large as the last two axes and not the first two; else along the last.

    >>> _matrix_axes((30, 24, 20), {30}, set()), _matrix_axes((24, 20, 30), {30, 200}, {(20, 30)})
    ('bls', 'lsb')
    >>> _matrix_axes((30, 24, 20), set(), {(24, 20)}), _matrix_axes((30, 30, 20), {30}, set())
    ('bls', 'lsb')
    """
    fits = [axis for axis, size in enumerate(shape) if size in waves]
    bands_first = shape[1:] in beside and shape[:2] not in beside
    bands_at = fits[0] if len(fits) == 1 else 0 if bands_first else 2
    return "ls"[:bands_at] + "b" + "ls"[bands_at:]


def _likely(names: list[str], shapes: Mapping[str, tuple[int, ...]], is_map: bool) -> list[str]:
    """Those of some arrays of a fitting shape that their names let stand for the map, or else the image.

    Beside others no map is that of the coordinates or of what is valid, and no image a picture of three bands; of
    several maps that is taken which alone is named as one.

    >>> _likely(["hsi/Lat", "hsi/Lon", "hsi/valid_mask", "hsi/sceneLabels/labels"], {}, True)
    ['hsi/sceneLabels/labels']
    >>> _likely(["Data", "RGB"], {"Data": (40, 60, 64), "RGB": (40, 60, 3)}, False)
    ['Data']
    """
    if not is_map:
        return [n for n in names if not (_PICTURE.search(n) and 3 in shapes[n])] or names
    short = {n: n.rpartition("/")[2] for n in names}
    names = [n for n in names if not (_SAMPLE.match(short[n]) or _LINE.match(short[n]))] or names
    names = [n for n in names if not _VALID.search(n)] or names
    named = [n for n in names if _TRUTH.search(n)]
    return named if len(named) == 1 else names


def _entries_of(arrays: Mapping[str, Numbers], name: str) -> dict[str, str]:
    """The entries of an ENVI header as readers in MATLAB keep them, in a struct ``info`` beside the image.

    The only list of texts in the struct of a map, if ``name`` is one, has the names of its classes from 1 on.
    """
    entries, group = dict[str, str](), name.rpartition("/")[0]
    for other, value in arrays.items():
        if key := other.partition("/info/")[2].split("/")[0].replace("_", " "):
            texts = [str(v) if value.dtype.kind == "U" else f"{v:.15g}" for v in value.flat]
            entries[key] = ", ".join([*([entries[key]] if key in entries else []), *texts])
    lists = [v for n, v in arrays.items() if v.dtype.kind == "U" and v.size > 1 and n.rpartition("/")[0] == group]
    return entries | ({"class names": ", ".join(["unclassified", *lists[0].flat])} if len(lists) == 1 else {})


@reader
def open_matrix(
    path: Path, kind: str, variable: str | None = None, plane: tuple[int, int] | None = None
) -> ArrayRaster:
    """The image (lines, samples, bands) of a MATLAB, NumPy or bare HDF5 file, or its map of the shape ``plane``.

    Unit, scale and no data are those of attributes of HDF5 that the CF conventions have for them; wavelengths those
    of an array of as many numbers that is named so; its place that of evenly spaced eastings and northings.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder, h5py.File(path := Path(folder) / "a.h5", "w") as file:
    ...     file["dn"] = np.full((2, 3, 4), 5, np.int16)
    ...     file["dn"].attrs.update(scale_factor=2e-4, add_offset=0.1, _FillValue=np.int16(-9999))
    ...     file.close()
    ...     about = open_matrix(path, "HDF5").description
    >>> about.scale.gain, about.scale.offset, about.ignore_value, *about.notes
    (0.0002, 0.1, -9999.0, 'axes are taken as lines, samples, bands: neither wavelengths nor a map tell them')
    >>> held = {"Data": np.ones((2, 3, 4)), "Easting": [7.5, 8.5, 9.5], "Northing": [11.5, 10.5]}  # MUUFL Gulfport
    >>> info = dict(p="UTM", image=[1, 1], x=7.0, y=12.0, dx=1.0, dy=1.0, zone=16.0, hemi="North", datum="WGS-84")
    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "hsi.mat", {"hsi": held | {"info": {"map_info": info}}})
    ...     (opened := open_matrix(path, "MATLAB 5")).transform.to_gdal(), opened.crs.to_epsg()
    ((7.0, 1.0, 0.0, 12.0, 0.0, -1.0), 32616)

    >>> names, held["flown"] = np.array(["oak", "lot, car", "sea"], "O"), np.array(["by day", "at noon"], "O")
    >>> held["sceneLabels"] = {"labels": [[-1, 1, 2], [1, 1, 3]], "Names": names}
    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "hsi.mat", {"hsi": held})
    ...     open_matrix(path, "MATLAB 5", plane=(2, 3)).description.entries
    {'class names': 'unclassified, oak, lot; car, sea'}

    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "cube.mat", {"data": np.ones((2, 3, 4)), "map": np.ones((2, 3))})
    ...     open_matrix(path, "MATLAB 5").description.notes
    ()
    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "fft.mat", {"data": np.full((2, 3, 4), 1j)})
    ...     open_matrix(path, "MATLAB 5")
    Traceback (most recent call last):
    hyperval.errors.InputError: ...fft.mat: 'data' holds complex128...
    >>> with TemporaryDirectory() as folder:
    ...     scipy.io.savemat(path := Path(folder) / "gt.mat", dict.fromkeys(("TRLabel", "TSLabel"), np.ones((2, 3))))
    ...     open_matrix(path, "MATLAB 5", plane=(2, 3))
    Traceback (most recent call last):
    hyperval.errors.UsageError: ...2 arrays could be meant: TRLabel, TSLabel...init takes a file of that map alone

    Raises
    ------
    InputError : none that fits, one that is too large to be read whole, or a damaged file.
    UsageError : several that could be meant, or ``variable`` is none of them.
    """
    shapes = _shapes(path, kind)
    called = {n: n.replace("/", ".") for n in shapes}
    named = {n: s for n, s in shapes.items() if variable in (None, n, called[n])}
    fits = [n for n, s in named.items() if (s == plane if plane else len(s) == 3 and 0 not in s)]
    fits = fits or [n for n, s in named.items() if plane and s in ((*plane, 1), (1, *plane))]  # a map all the same
    fits = _likely(fits, shapes, bool(plane))
    if not fits:
        listed = ", ".join(f"{called[n]} {' x '.join(map(str, shape))}" for n, shape in shapes.items()) or "no numbers"
        named_so = f" named {variable}" * bool(variable)
        raise refusal("array.no_map" if plane else "array.none", path, listed=listed, plane=plane, named=named_so)
    names = ", ".join(called[n] for n in fits)
    refuse(len(fits) > 1, "array.maps" if plane else "array.images", path, count=len(fits), names=names)
    name = fits[0]
    size = 8 * int(np.prod(shapes[name]))
    if kind == "MATLAB 5" and (size > MAX_MATRIX_BYTES or size > MAX_COMPRESSED * path.stat().st_size):
        raise refusal("array.memory", path, name=name, mib=size >> 20)
    tree, turn = kind not in ("MATLAB 5", "NumPy"), -1 if kind == "MATLAB 7.3" else 1
    vectors = {n: max(s) for n, s in shapes.items() if s and max(s) == int(np.prod(s)) > 1 and not _GOOD.search(n)}
    waves = {size for n, size in vectors.items() if _WAVE.search(n)}
    axes = "ls" if shapes[name] == plane else "ls-" if shapes[name][:2] == plane else "-ls"
    axes = axes if plane else _matrix_axes(shapes[name], waves, set(shapes.values()))
    axes, shape = axes[::turn], shapes[name][::turn]
    sizes = dict(zip(axes, shape, strict=True))
    axis_arrays = [[n for n, size in vectors.items() if p.search(n) and size == sizes.get(axis)] for p, axis in _BESIDE]
    store = ArrayFile(path, hdf5) if tree else ArrayFile(path, _matrix, kind, name, *chain(*axis_arrays))
    dtype = store.read(name, (slice(0, 1),) * len(shape)).dtype
    refuse(dtype.kind not in "iufb", "array.type", path, name=name, dtype=dtype)
    piece = BandArrays((Term(name),), axes, shape, dtype.newbyteorder("="))

    wave, width, east, north = (
        store.read(names[0], (slice(None),)).astype(float).ravel() if len(names) == 1 else None for names in axis_arrays
    )
    keys = (*_FILLS, "scale_factor", "add_offset", "units", "long_name") if tree else ()
    with store.kept_open() as file:
        held = {key: file[name].attrs.get(key) for key in keys}
        entries = {} if tree else _entries_of(file, name)
    header = EnviHeader(path, sizes["s"], sizes["l"], sizes.get("b", 1), 0, "", 0, 0, entries=entries)
    bands = None if wave is None else ListedBands(wave, width, header.text("wavelength units"))
    unit, title = (" ".join(texts_of(held.get(key))) for key in ("units", "long_name"))
    quantity, scaled, notes = quantity_of(unit, name.rpartition("/")[2], title)
    maps = [part in shapes.values() for part in (shapes[name][:2], shapes[name][1:])]
    certain = plane or waves & {*shape} or maps[0] != maps[1]
    notes += () if certain else ("axes are taken as lines, samples, bands: neither wavelengths nor a map tell them",)
    scale = Scale(*packing(held), f"scale of the array {name!r}")
    about = Description(f"array {name!r} of a {kind} file", bands, scale, quantity, scaled, stated(held), notes=notes)
    about = replace(about, entries=entries) if plane else about
    place = None if east is None or north is None else _even_grid(east, north), crs_of(header)
    return array_raster(store, (piece,), about, place)
