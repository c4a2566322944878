"""One pass over a stored cube, by segments of lines that threads take in turn.

Segments and blocks depend on the size of the cube alone and results are joined in order, so that the number of
threads changes nothing.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from threading import local
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval.executors import available_cores, single_blas_thread

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Result = TypeVar("Result")

# Smaller blocks stay nearer to the core, but each costs its calls; larger ones take more memory.
BLOCK_PIXELS = 1920
BLOCKS_PER_SEGMENT = 16
# NumPy asks for huge pages from 4 MiB on; with small ones the strided products wait for addresses.
HUGE_PAGES_FROM = 1 << 22
MAX_THREADS = 4  # more only wait for memory


class StoredCube(Protocol):
    """A cube on disk, as it is stored."""

    @property
    def lines(self) -> int:
        """Number of lines."""

    @property
    def samples(self) -> int:
        """Number of samples in a line."""

    @property
    def bands(self) -> int:
        """Number of bands."""

    @property
    def dtype(self) -> np.dtype:
        """Type of a stored number."""

    @property
    def gain(self) -> Array:
        """(B,) value of a stored 1."""

    @property
    def offset(self) -> Array:
        """(B,) value of a stored 0."""

    def kept_open(self) -> AbstractContextManager[object]:
        """Inside, the file may be opened once for all reads."""

    def read_stored(
        self, first_line: int, count: int, needed: Mask | None = None, buffer: npt.NDArray[Any] | None = None
    ) -> tuple[npt.NDArray[Any], Mask]:
        """Stored numbers (B, count, samples) and which pixels (count, samples) hold data in the needed bands."""


class Workspace(local):
    """Arrays of one thread, made when first asked for and used again."""

    def __init__(self) -> None:
        self._arrays: dict[str, npt.NDArray[Any]] = {}

    def flat(self, name: str, size: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """A flat array of at least ``size``, cut to it."""
        array = self._arrays.get(name)
        if array is None or array.size < size or array.dtype != np.dtype(dtype):
            least = HUGE_PAGES_FROM // np.dtype(dtype).itemsize
            array = self._arrays[name] = np.empty(max(size, least), dtype)
        return array[:size]

    def columns(self, name: str, like: npt.NDArray[Any], bands: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """An array (bands, lines, samples) with the order of memory of ``like``, an array of stored numbers."""
        _, lines, samples = like.shape
        flat = self.flat(name, bands * lines * samples, dtype)
        if by_pixel(like):
            return flat.reshape(lines, samples, bands).transpose(2, 0, 1)
        return flat.reshape(bands, lines, samples)


def by_pixel(stored: npt.NDArray[Any]) -> bool:
    """Whether the bands of a pixel lie side by side."""
    return stored.strides[0] < stored.strides[2]


def as_columns(cube: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(B, N) view of an array of :meth:`Workspace.columns`."""
    bands = cube.shape[0]
    if by_pixel(cube):
        return cube.transpose(1, 2, 0).reshape(-1, bands).T
    return cube.reshape(bands, -1)


def runs(bands: Mask) -> list[tuple[slice, slice]]:
    """Stretches of True as slices of the mask and of what is left when only they are kept."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bands, [False]]).astype(np.int8)))
    out, at = [], 0
    for start, stop in edges.reshape(-1, 2).tolist():
        out.append((slice(start, stop), slice(at, at + stop - start)))
        at += stop - start
    return out


def lines_per_block(cube: StoredCube) -> int:
    """Lines of a block."""
    return max(1, round(BLOCK_PIXELS / cube.samples))


def _segments(lines: int, block_lines: int) -> list[range]:
    """First lines of the blocks of each segment; as many segments for each thread, so that threads end together."""
    blocks = -(-lines // block_lines)
    count = -(-blocks // (BLOCKS_PER_SEGMENT * MAX_THREADS)) * MAX_THREADS
    count = min(count, blocks)
    edges = [block_lines * (blocks * i // count) for i in range(count)] + [lines]
    return [range(a, b, block_lines) for a, b in itertools.pairwise(edges)]


def by_segments(
    cube: StoredCube,
    block_lines: int,
    work: Callable[[range], Result],
    *,
    threads: int | None = None,
) -> Iterator[tuple[range, Result]]:
    """The result of ``work`` for each segment, in order; ``work`` gets the first lines of the segment's blocks.

    With ``threads`` None as many are used as the cube says, else as there are cores, at most four, and one where
    NumPy's BLAS cannot be kept to one thread.
    """
    segments = _segments(cube.lines, block_lines)
    threads = getattr(cube, "threads", None) if threads is None else threads
    with cube.kept_open(), single_blas_thread() as alone:
        count = threads if threads is not None else min(available_cores(), MAX_THREADS) if alone else 1
        if count <= 1:
            for segment in segments:
                yield segment, work(segment)
            return
        waiting: deque[tuple[range, Future[Result]]] = deque()
        with ThreadPoolExecutor(count) as pool:
            try:
                for segment in segments:
                    waiting.append((segment, pool.submit(work, segment)))
                    if len(waiting) > count:
                        done, future = waiting.popleft()
                        yield done, future.result()
                while waiting:
                    done, future = waiting.popleft()
                    yield done, future.result()
            finally:
                for _, future in waiting:
                    future.cancel()
