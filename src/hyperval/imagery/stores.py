"""Files that are opened once for many reads, parts of the arrays in them, lines that are kept for the next read."""

from __future__ import annotations

import mmap
import os
import tempfile
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import h5py
import numpy as np
import numpy.typing as npt

from hyperval.errors import InputError
from hyperval.hdf5 import check_hdf5

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
