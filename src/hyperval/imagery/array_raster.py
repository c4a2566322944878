"""The image of a file that holds several arrays, read by blocks of lines like any other raster."""

from __future__ import annotations

import threading
from collections.abc import Iterator
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
from hyperval.imagery.stores import Store

Index = npt.NDArray[np.intp]
AXES = "lsb"  # lines, samples, bands
SLAB_BYTES = 16 << 20  # of lines that are read together, where they are stored in blocks


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
        self._slabs.last = (0, None)

    def read_lines(self, first: int, count: int) -> npt.NDArray[Any]:
        """(count, samples, bands) values of consecutive lines."""
        return self.read_bands(first, count).transpose(1, 2, 0)

    def read_bands(self, first: int, count: int, buffer: npt.NDArray[Any] | None = None) -> npt.NDArray[Any]:
        """(bands, count, samples) values of consecutive lines; ``buffer`` is not used.

        Arrays that are stored in blocks are read by as many lines as their blocks have, or as fit into
        ``SLAB_BYTES``, and these are kept for the next call of the same thread; lines far from those of the last
        call are read alone.
        """
        if first < 0 or count < 1 or first + count > self.lines:
            raise UsageError(f"lines {first}-{first + count - 1} of a cube of {self.lines} lines")
        begin, slab = getattr(self._slabs, "last", (0, None))
        if slab is None or first < begin or first + count > begin + slab.shape[1]:
            block, fit = self._block_lines
            lines = count
            if first == 0 or 0 <= first - getattr(self._slabs, "end", -block) <= block:  # one after the other
                lines = max(count, min((first // block + 1) * block - first, fit, self.lines - first))
            begin = first
            slab = None
            self._slabs.last = (0, None)  # the memory of the one before is given back first
            slab = self._part(slice(begin, begin + lines), slice(0, self.samples))
            self._slabs.last = (begin, slab)
        self._slabs.end = first + count
        return slab[:, first - begin : first - begin + count]

    def read_pixels(self, rows: Index, cols: Index) -> npt.NDArray[Any]:
        """(n, bands) values of single pixels."""
        out = np.empty((rows.size, self.bands), self.dtype)
        if not rows.size:
            return out
        lines = np.unique(rows)
        most = max(1, SLAB_BYTES // (self.samples * self.bands * self.dtype.itemsize))
        run = np.cumsum(np.diff(lines, prepend=lines[0]) > 1)
        with self.kept_open():
            for together in np.split(lines, np.flatnonzero(np.diff(run)) + 1):
                for first in range(int(together[0]), int(together[-1]) + 1, most):
                    last = min(first + most, int(together[-1]) + 1)
                    here = (rows >= first) & (rows < last)
                    left, right = int(cols[here].min()), int(cols[here].max()) + 1
                    part = self._part(slice(first, last), slice(left, right))
                    out[here] = part[:, rows[here] - first, cols[here] - left].T
        return out

    @property
    def _block_lines(self) -> tuple[int, int]:
        """Lines of a block of the file, and lines that fit into ``SLAB_BYTES``."""
        blocks = [
            chunks[piece.axes.index("l")]
            for piece in self.pieces
            for term in piece.terms
            if (chunks := self.store.chunks(term.name)) is not None
        ]
        return max(blocks, default=1), SLAB_BYTES // (self.samples * self.bands * self.dtype.itemsize)

    def _part(self, lines: slice, samples: slice) -> npt.NDArray[Any]:
        """(bands, lines, samples) of a window."""
        only = self.pieces[0]
        if len(self.pieces) == len(only.terms) == 1 and "b" in only.axes and self.zero_for is None:
            ranges = {"l": lines, "s": samples, "b": slice(0, only.size("b"))}
            stored = self.store.read(only.terms[0].name, tuple(ranges[axis] for axis in only.axes))
            return np.asarray(stored.transpose([only.axes.index(axis) for axis in "bls"]), self.dtype)
        size = (self.bands, lines.stop - lines.start, samples.stop - samples.start)
        out, at = np.empty(size, self.dtype), 0
        for piece in self.pieces:
            bands = piece.size("b")
            ranges = {"l": lines, "s": samples, "b": slice(0, bands)}
            selection = tuple(ranges[axis] for axis in piece.axes)
            into = out[at : at + bands]
            for number, term in enumerate(piece.terms):
                stored = self.store.read(term.name, selection)
                stored = stored.transpose([piece.axes.index(axis) for axis in "bls" if axis in piece.axes])
                stored = stored.reshape(into.shape)
                if len(piece.terms) == 1:
                    into[:] = stored
                    break
                value = np.float32(term.weight) * stored.astype(np.float32)
                if term.ignore is not None:
                    value[stored == term.ignore] = np.nan
                into[:] = value if number == 0 else into + value
            at += bands
        if self.zero_for is not None:
            out[out == self.zero_for] = 0
        return out
