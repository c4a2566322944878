"""The image of a file that holds several arrays, read by blocks of lines like any other raster.

Files that are opened once for many reads, parts of the arrays in them, lines that are kept for the next read.
"""

from __future__ import annotations

import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import h5py
import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import InputError, UsageError
from hyperval.hdf5 import check_hdf5
from hyperval.imagery.description import Description

Selection = tuple[slice, ...]
MAX_CHUNK_BYTES = 256 << 20
SMALL_BYTES = 1 << 20
CACHE_BYTES = 1 << 20  # of unpacked blocks that the library keeps: by itself 8 MB, though each is asked for once


class Store(Protocol):
    """A file of named arrays."""

    path: Path

    def read(self, name: str, selection: Selection) -> npt.NDArray[Any]:
        """A part of an array."""

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Size of the blocks that an array is stored in, None when it is stored as one."""

    def kept_open(self) -> Any:
        """Inside, the file is opened once for all reads."""


class OpenedFile:
    """A file that is opened for each read or, inside :meth:`kept_open`, once for all of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._opened: Any = None
        self._users = 0

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens it for itself."""
        return type(self), (self.path,)

    def open(self) -> Any:
        """The opened file."""
        raise NotImplementedError

    @contextmanager
    def kept_open(self) -> Iterator[Any]:
        """The opened file, closed when the last of its users has left."""
        with self._lock:
            if self._opened is None:
                self._opened = self.open()
            self._users += 1
        try:
            yield self._opened
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    self._opened.close()
                    self._opened = None


class Hdf5Store(OpenedFile):
    """An HDF5 file, NetCDF-4 and HDF-EOS5 among them."""

    def open(self) -> h5py.File:
        """The file; InputError when it is none, cut short, or one that the library does not come back from."""
        check_hdf5(self.path)
        try:
            return h5py.File(self.path, "r", rdcc_nbytes=CACHE_BYTES)
        except OSError as error:
            raise InputError(
                f"not a readable HDF5 file: {error}", where=str(self.path), mend="copy the file again"
            ) from error

    def dataset(self, file: h5py.File, name: str) -> h5py.Dataset | None:
        """An array of the opened file, None when there is none of that name.

        Raises
        ------
        InputError : blocks that are too large to be read one by one.
        """
        at = file.get(name)
        if not isinstance(at, h5py.Dataset):
            return None
        if at.chunks is not None and int(np.prod(at.chunks)) * at.dtype.itemsize > MAX_CHUNK_BYTES:
            raise InputError(
                f"one block of {name!r} needs more than {MAX_CHUNK_BYTES >> 20} MiB",
                where=str(self.path),
                mend="rewrite it with smaller chunks (h5repack)",
            )
        return at

    def read(self, name: str, selection: Selection) -> npt.NDArray[Any]:
        """A part of an array."""
        with self.kept_open() as file:
            try:
                dataset = file[name]
                shape = tuple(len(range(*s.indices(n))) for s, n in zip(selection, dataset.shape, strict=True))
                out = page_array(shape, dataset.dtype)
                dataset.read_direct(out, selection)
                return out
            except (OSError, KeyError, ValueError) as error:
                raise InputError(f"{name!r} cannot be read: {error}", where=str(self.path)) from error

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """Size of the blocks that an array is stored in."""
        with self.kept_open() as file:
            size: tuple[int, ...] | None = file[name].chunks
            return size


def page_array(shape: tuple[int, ...], dtype: np.dtype) -> npt.NDArray[Any]:
    """An array in pages of its own, which go back to the system with it.

    After the first few large arrays the C library serves the next ones from memory that it keeps, and a pass over
    an image would end with several times what it needs at once.
    """
    size = int(np.prod(shape)) * dtype.itemsize
    if size < SMALL_BYTES:
        return np.empty(shape, dtype)
    return np.frombuffer(mmap.mmap(-1, size), dtype).reshape(shape)


def check_own_values(path: Path) -> None:
    """Raise InputError where an HDF5 file leads to others: external links, external or virtual arrays."""

    foreign: list[str] = []  # an error raised by a visitor would be lost in the library

    def visit_link(name: str, link: Any) -> None:
        if isinstance(link, h5py.ExternalLink):
            foreign.append(name)

    def visit_item(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and (item.external or item.is_virtual):
            foreign.append(name)

    with Hdf5Store(path).kept_open() as file:
        file.visititems_links(visit_link)
        file.visititems(visit_item)
    if foreign:
        raise InputError(
            f"the values of {foreign[0]!r} lie in another file", where=str(path), mend="copy them into one file"
        )


class MemoryStore:
    """An array that is at hand, such as one of xarray or SPy; it is read by parts as well."""

    def __init__(self, array: Any, path: Path) -> None:
        self.array, self.path = array, path

    @contextmanager
    def kept_open(self) -> Iterator[Any]:
        """Nothing to open."""
        yield self.array

    def read(self, name: str, selection: Selection) -> npt.NDArray[Any]:
        """A part of the array."""
        return np.asarray(self.array[selection])

    def chunks(self, name: str) -> tuple[int, ...] | None:
        """None: it is stored as one."""
        return None


class StoredFile(OpenedFile):
    """A file that several threads read at stated places."""

    def open(self) -> BinaryIO:
        """The file without a buffer of its own."""
        stream = open(self.path, "rb", buffering=0)  # noqa: SIM115 - closed when its last user leaves
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(stream.fileno(), 0, 0, os.POSIX_FADV_SEQUENTIAL)
        return stream

    def fill(self, out: npt.NDArray[Any], offset: int) -> None:
        """Read a contiguous array from a place in the file.

        Raises
        ------
        InputError : the file ends before.
        """
        view = memoryview(out.reshape(-1).view("u1").data)  # contiguous, so this is no copy
        done = 0
        with self.kept_open() as stream:
            while done < len(view):
                step = self._read(stream, view[done:], offset + done)
                if not step:
                    raise InputError("the file became shorter while it was read", where=str(self.path))
                done += step

    def _read(self, stream: BinaryIO, view: memoryview, offset: int) -> int:
        if hasattr(os, "preadv"):
            return os.preadv(stream.fileno(), [view], offset)
        with self._lock:
            stream.seek(offset)
            return stream.readinto(view) or 0  # type: ignore[attr-defined]


@dataclass(frozen=True, eq=False)
class InMemory:
    """Lines in memory, as values (bands, lines, samples)."""

    first: int
    lines: int
    values: npt.NDArray[Any]

    def read(self, start: int, count: int) -> npt.NDArray[Any]:
        """(bands, count, samples) values from line ``start`` of the slab on."""
        return self.values[:, start : start + count]


@dataclass(frozen=True, eq=False)
class Unpacked:
    """Lines in a file without a name, one after the other with all their bands; it goes when it is closed."""

    first: int
    lines: int
    bands: int
    samples: int
    dtype: np.dtype
    file: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - open for as long as the slab is there
        weakref.finalize(self, file.close)
        object.__setattr__(self, "file", file)

    def write(self, band: int, values: npt.NDArray[Any]) -> None:
        """Put some bands (n, lines, samples) in their places, ``band`` the first of them."""
        row = self.samples * self.dtype.itemsize
        for line in range(self.lines):
            self.file.seek((line * self.bands + band) * row)
            self.file.write(np.ascontiguousarray(values[:, line], self.dtype).data)

    def read(self, start: int, count: int) -> npt.NDArray[Any]:
        """(bands, count, samples) values from line ``start`` of the slab on."""
        out = page_array((count, self.bands, self.samples), self.dtype)
        self.file.seek(start * self.bands * self.samples * self.dtype.itemsize)
        self.file.readinto(out.data.cast("B"))
        return out.transpose(1, 0, 2)


Slab = InMemory | Unpacked


Index = npt.NDArray[np.intp]
AXES = "lsb"  # lines, samples, bands
SLAB_BYTES = 8 << 20  # of lines that are kept in memory, where they are stored in blocks
UNPACKED_BYTES = 4 << 30  # of lines that are unpacked into a file, where they are stored in larger ones


@dataclass(frozen=True)
class Term:
    """One array of a sum: weight * stored, NaN where the stored value is ``ignore``."""

    name: str
    weight: float = 1.0
    ignore: float | None = None


@dataclass(frozen=True)
class Piece:
    """Arrays that give some bands of the image.

    Attributes
    ----------
    terms : one array, taken as stored; or several of one shape, whose weighted sum is taken as float32
    axes : order of the axes in the file, such as "bls" for (band, line, sample); "ls" for a single band
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
class ArrayRaster:
    """An image of one or several arrays of a file, their bands one after the other.

    Attributes
    ----------
    path : the file
    store : reads parts of its arrays
    pieces : the arrays, in the order of the bands
    transform, crs : position on a map, where the file tells
    description : what the file says of the image, None for a lookup table
    zero_for : a value that is handed out as 0, as the fill of a lookup table is
    other_files : files beside it that were read
    """

    path: Path
    store: Store
    pieces: tuple[Piece, ...]
    transform: Affine | None = None
    crs: CRS | None = None
    description: Description | None = None
    zero_for: float | None = None
    other_files: tuple[Path, ...] = ()
    header: None = None
    _slabs: threading.local = field(default_factory=threading.local, repr=False)
    _unpacking: threading.Lock = field(default_factory=threading.Lock, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Without the lines that were read last."""
        values = (self.path, self.store, self.pieces, self.transform, self.crs, self.description, self.zero_for)
        return type(self), (*values, self.other_files)

    @property
    def lines(self) -> int:
        """Number of lines."""
        return self.pieces[0].size("l")

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.pieces[0].size("s")

    @property
    def bands(self) -> int:
        """Number of bands."""
        return sum(piece.size("b") for piece in self.pieces)

    @property
    def dtype(self) -> np.dtype:
        """Type of a value."""
        return np.result_type(*(piece.dtype for piece in self.pieces))

    @property
    def source_files(self) -> tuple[Path, ...]:
        """The files that were read."""
        return (self.path, *self.other_files)

    @contextmanager
    def kept_open(self) -> Iterator[object]:
        """Inside, the file is opened once for all reads; the lines that this thread holds are given back after."""
        with self.store.kept_open() as opened:
            yield opened
        self._slabs.last = None

    def read_lines(self, first: int, count: int) -> npt.NDArray[Any]:
        """(count, samples, bands) values of consecutive lines."""
        return self.read_bands(first, count).transpose(1, 2, 0)

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) values of consecutive lines; ``buffer`` is not used.

        Arrays that are stored in blocks are read by as many lines as their blocks have, and these are kept for the
        next call of the same thread: in memory where they fit into ``SLAB_BYTES``, else unpacked into a file, so
        that no block is unpacked twice and few are in memory.  Lines far from those before are read alone.
        """
        if first < 0 or count < 1 or first + count > self.lines:
            raise UsageError(f"lines {first}-{first + count - 1} of a cube of {self.lines} lines")
        slab: Slab | None = getattr(self._slabs, "last", None)
        if slab is None or first < slab.first or first + count > slab.first + slab.lines:
            self._slabs.last = slab = None  # the memory of the one before is given back first
            block = max(1, *(self._block(piece)["l"] for piece in self.pieces))
            lines = count
            if first == 0 or 0 <= first - getattr(self._slabs, "end", -block) <= block:  # one after the other
                lines = max(count, min((first // block + 1) * block - first, self.lines - first))
            self._slabs.last = slab = self._slab(first, count, lines)
        self._slabs.end = first + count
        return slab.read(first - slab.first, count)

    def _slab(self, first: int, count: int, lines: int) -> Slab:
        """At least ``count`` lines, ``lines`` of them where they fit."""
        size = self.samples * self.bands * self.dtype.itemsize
        fit = max(count, SLAB_BYTES // size)
        if fit < lines <= UNPACKED_BYTES // size:
            try:
                return self._unpacked(first, lines)
            except OSError:
                pass  # no room for the file: each block is unpacked several times, which only takes longer
        values = self._part(slice(first, first + min(lines, fit)), slice(0, self.samples))
        return InMemory(first, values.shape[1], values)

    def _unpacked(self, first: int, lines: int) -> Unpacked:
        """Lines in a file; the bands of one block are in memory at once."""
        slab = Unpacked(first, lines, self.bands, self.samples, self.dtype)
        for at, piece in self._places():
            ranges = {"l": slice(first, first + lines), "s": slice(0, self.samples)}
            for bands in self._some_bands(piece):
                with self._unpacking:  # one thread at a time reads a file of arrays: no other holds what it is to read
                    values = self._values(piece, ranges | {"b": bands})
                    if self.zero_for is not None:
                        values[values == self.zero_for] = 0
                    slab.write(at + bands.start, values)
                    del values
        return slab

    def read_some_bands(self, first: int, count: int, bands: Sequence[int]) -> npt.NDArray[Any]:
        """(n, count, samples) values of consecutive lines in a few bands, which alone are read."""
        out = np.empty((len(bands), count, self.samples), self.dtype)
        ranges = {"l": slice(first, first + count), "s": slice(0, self.samples)}
        with self.kept_open():
            for at, piece in self._places():
                for i, band in enumerate(bands):
                    if at <= band < at + piece.size("b"):
                        out[i] = self._values(piece, ranges | {"b": slice(band - at, band - at + 1)})[0]
        return out

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) values of single pixels; each block that the file is stored in is read once."""
        out = np.empty((rows.size, self.bands), self.dtype)
        with self.kept_open():
            for at, piece in self._places():
                for here in self._by_block(piece, rows, cols):
                    first, left = int(rows[here].min()), int(cols[here].min())
                    ranges = {
                        "l": slice(first, int(rows[here].max()) + 1),
                        "s": slice(left, int(cols[here].max()) + 1),
                    }
                    for bands in self._some_bands(piece):
                        values = self._values(piece, ranges | {"b": bands})
                        into = slice(at + bands.start, at + bands.stop)
                        out[here, into] = values[:, rows[here] - first, cols[here] - left].T
        if self.zero_for is not None:
            out[out == self.zero_for] = 0
        return out

    def _places(self) -> Iterator[tuple[int, Piece]]:
        """Each piece and the number of its first band."""
        at = 0
        for piece in self.pieces:
            yield at, piece
            at += piece.size("b")

    def _block(self, piece: Piece) -> dict[str, int]:
        """Size of the blocks that a piece is stored in along each axis; a line where it is not stored in blocks."""
        chunks = self.store.chunks(piece.terms[0].name)
        if chunks is None:
            return {"l": 1, "s": self.samples, "b": piece.size("b")}
        return {axis: chunks[piece.axes.index(axis)] if axis in piece.axes else 1 for axis in AXES}

    def _some_bands(self, piece: Piece) -> Iterator[slice]:
        """The bands of a piece, those of one block together."""
        step = self._block(piece)["b"]
        for start in range(0, piece.size("b"), step):
            yield slice(start, min(start + step, piece.size("b")))

    def _by_block(self, piece: Piece, rows: Index, cols: Index) -> list[Index]:
        """Which pixels are read together: those of a block, or of lines that follow each other."""
        block = self._block(piece)
        order = np.argsort(rows, kind="stable")
        if block["l"] == 1:
            ordered = rows[order]
            run = np.cumsum(np.diff(ordered, prepend=ordered[:1]) > 1)
            most = max(1, SLAB_BYTES // (self.samples * self.bands * self.dtype.itemsize))
            where = np.stack([run, (ordered - ordered[np.searchsorted(run, run)]) // most])
        else:
            where = np.stack([rows // block["l"], cols // block["s"]])
            order = np.lexsort(where)
            where = where[:, order]
        edges = np.flatnonzero(np.any(np.diff(where), axis=0)) + 1
        return [part for part in np.split(order, edges) if part.size]

    def _part(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """(bands, lines, samples) of a window."""
        if len(self.pieces) == 1 and self.zero_for is None:
            ranges = {"l": lines, "s": samples, "b": slice(0, self.bands)}
            return np.asarray(self._values(self.pieces[0], ranges), self.dtype)
        out = np.empty((self.bands, lines.stop - lines.start, samples.stop - samples.start), self.dtype)
        for at, piece in self._places():
            bands = piece.size("b")
            out[at : at + bands] = self._values(piece, {"l": lines, "s": samples, "b": slice(0, bands)})
        if self.zero_for is not None:
            out[out == self.zero_for] = 0
        return out

    def _values(self, piece: Piece, ranges: Mapping[str, slice]) -> npt.NDArray[Any]:
        """(bands, lines, samples) of a part of a piece."""
        selection = tuple(ranges[axis] for axis in piece.axes)
        order = [piece.axes.index(axis) for axis in "bls" if axis in piece.axes]
        size = [ranges[axis].stop - ranges[axis].start for axis in "bls"]
        total: npt.NDArray[Any] | None = None
        for term in piece.terms:
            stored = self.store.read(term.name, selection).transpose(order).reshape(size)
            if len(piece.terms) == 1:
                return stored
            value = np.float32(term.weight) * stored.astype(np.float32)
            if term.ignore is not None:
                value[stored == term.ignore] = np.nan
            total = value if total is None else total + value
        assert total is not None  # noqa: S101 - a piece has terms
        return total
