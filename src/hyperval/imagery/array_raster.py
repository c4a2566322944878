"""The image of a file that holds several arrays, read by blocks of lines like any other raster."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from affine import Affine
from rasterio.crs import CRS

from hyperval.errors import UsageError
from hyperval.imagery.description import Description
from hyperval.imagery.stores import InMemory, Slab, Store, Unpacked

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
                with (
                    self._unpacking
                ):  # one thread at a time reads a file of arrays: no other holds what it is to read
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
