"""One pass over a stored cube by segments of lines, regions as one label image, and their moments.

Segments and blocks depend on the size of the cube alone and results are joined in order, so that the number of
threads changes nothing.

Sums of pixels and of their products are taken in float64, block by block, about a point near the pixels: a whole
number where the stored numbers are whole, so that the differences, their products and the sums of these are exact
while they stay below 2^53.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from hyperval.data import SampleStatistics
from hyperval.errors import UsageError, refusal
from hyperval.executors import available_cores, single_blas_thread
from hyperval.pixels.sample import SCENE

if TYPE_CHECKING:
    from hyperval.imagery import Cube

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Counts = npt.NDArray[np.int64]
Result = TypeVar("Result")
Watch = Callable[[Iterator[Any]], Iterator[Any]]

# Smaller blocks stay nearer to the core, but each costs its calls; larger ones take more memory.
BLOCK_PIXELS = 1920
BLOCKS_PER_SEGMENT = 16
# NumPy asks for huge pages from 4 MiB on; with small ones the strided products wait for addresses.
HUGE_PAGES_FROM = 1 << 22
MAX_THREADS = 4  # more only wait for memory
_LINES_LABELLED = 256  # at a time
# Pixels are taken about the mean of at least so many of the first block.
CENTRED_ON = 64


class StoredBlock(NamedTuple):
    """Some lines of a cube.

    Attributes
    ----------
    rows : the lines
    stored : (F, N) numbers of the bands that are asked for, pixel by pixel, in memory that the next block takes
    usable : (lines, samples) which pixels hold data
    """

    rows: slice
    stored: Array
    usable: Mask


def _memory(size: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """A flat array of at least ``size``."""
    return np.empty(max(size, HUGE_PAGES_FROM // np.dtype(dtype).itemsize), dtype)


def _runs(bands: Mask) -> list[tuple[slice, slice]]:
    """Stretches of True as slices of the mask and of what is left when only they are kept."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bands, [False]]).astype(np.int8)))
    ends = np.cumsum(edges[1::2] - edges[::2]).tolist()
    return [
        (slice(start, stop), slice(end - (stop - start), end))
        for (start, stop), end in zip(edges.reshape(-1, 2).tolist(), ends, strict=True)
    ]


def _segments(lines: int, block_lines: int) -> list[range]:
    """First lines of the blocks of each segment; as many segments for each thread, so that threads end together."""
    blocks = -(-lines // block_lines)
    count = -(-blocks // (BLOCKS_PER_SEGMENT * MAX_THREADS)) * MAX_THREADS
    count = min(count, blocks)
    edges = [block_lines * (blocks * i // count) for i in range(count)] + [lines]
    return [range(a, b, block_lines) for a, b in itertools.pairwise(edges)]


def by_segments(
    cube: Cube, block_lines: int, work: Callable[[range], Result], *, threads: int | None = None, watch: Watch = iter
) -> Iterator[Result]:
    """The result of ``work`` for each segment, in order; ``work`` gets the first lines of the segment's blocks.

    With ``threads`` None as many are used as the cube says, else as there are cores, at most four, and one where
    NumPy's BLAS cannot be kept to one thread.  ``watch`` wraps the iterator over the segments, for a progress bar.
    """
    segments = _segments(cube.lines, block_lines)
    threads = cube.threads if threads is None else threads

    def results() -> Iterator[tuple[range, Result]]:
        with cube.kept_open(), single_blas_thread() as alone:
            count = threads if threads is not None else min(available_cores(), MAX_THREADS) if alone else 1
            if count <= 1:
                yield from zip(segments, map(work, segments), strict=True)
                return
            pool = ThreadPoolExecutor(count)
            try:
                yield from zip(segments, pool.map(work, segments), strict=True)
            finally:
                pool.shutdown(cancel_futures=True)

    return (result for _, result in watch(results()))


def stream(
    cube: Cube,
    work: Callable[[Iterator[StoredBlock]], Result],
    bands: Mask | None = None,
    needed: Mask | None = None,
    *,
    threads: int | None = None,
    block_lines: int | None = None,
    watch: Watch = iter,
) -> Iterator[Result]:
    """What ``work`` makes of the blocks of each segment of a cube, in order: the whole image once.

    Parameters
    ----------
    bands : (B,) that are handed out, all by default
    needed : (B,) that must hold data in a usable pixel, all by default
    threads, block_lines : None chooses them
    watch : wraps the iterator over the parts of the pass, for a progress bar
    """
    step = min(block_lines or max(1, round(BLOCK_PIXELS / cube.samples)), cube.lines)
    stretches = _runs(np.ones(cube.bands, bool) if bands is None else bands)
    count, most = stretches[-1][1].stop if stretches else 0, step * cube.samples

    def blocks(firsts: range) -> Iterator[StoredBlock]:
        buffer, memory = _memory(cube.bands * most, cube.dtype), _memory(count * most, np.float64)
        for first in firsts:
            shape = (min(step, cube.lines - first), cube.samples)
            pixels = shape[0] * shape[1]
            stored, usable = cube.read_stored(first, shape[0], needed, buffer[: cube.bands * pixels])
            flat = memory[: count * pixels]
            # In the order of the file: by pixel where the bands of a pixel lie side by side.
            by_pixel = stored.strides[0] < stored.strides[2]
            numbers = flat.reshape(pixels, count).T if by_pixel else flat.reshape(count, pixels)
            image = flat.reshape(*shape, count).transpose(2, 0, 1) if by_pixel else flat.reshape(count, *shape)
            for source, target in stretches:
                np.copyto(image[target], stored[source], casting="same_kind")
            del stored  # a view of lines that a raster may hold: they would stay while it reads the next
            yield StoredBlock(slice(first, first + shape[0]), numbers, usable)

    return by_segments(cube, step, lambda firsts: work(blocks(firsts)), threads=threads, watch=watch)


@dataclass(frozen=True, eq=False)
class Labels(Mapping[str, Mask]):
    """Regions of an image as one label image: pixels that lie in the same regions bear the same number.

    A mapping from the name of a region to its mask, which is made when it is asked for.

    Attributes
    ----------
    number : (lines, samples) label of each pixel, from 0 on
    members : region -> (K,) which of the labels lie in it

    Examples
    --------
    >>> left, top = np.array([[True, False], [True, False]]), np.array([[True, True], [False, False]])
    >>> labels = Labels.of((2, 2), {"left": left, "top": top})
    >>> labels.number.tolist(), labels["top"].tolist()
    ([[3, 1], [2, 0]], [[True, True], [False, False]])
    >>> labels.mask(labels.members["left"] & ~labels.members["top"]).tolist()
    [[False, False], [True, False]]
    """

    number: npt.NDArray[Any]
    members: Mapping[str, Mask] = field(default_factory=dict)

    @classmethod
    def of(cls, shape: tuple[int, int], masks: Mapping[str, Mask] | None = None) -> Labels:
        """Of masks (lines, samples) by name.

        Raises
        ------
        UsageError : a mask that does not fit the shape.
        """
        return cls(np.zeros(shape, np.uint8), {}).with_masks((masks or {}).items())

    def with_masks(self, masks: Iterable[tuple[str, Mask]]) -> Labels:
        """The same with more regions."""
        number, members = self.number, dict(self.members)
        count = len(next(iter(members.values()))) if members else int(number.max(initial=0)) + 1
        for name, mask in masks:
            if np.shape(mask) != number.shape or np.asarray(mask).dtype != bool:
                kind = np.asarray(mask).dtype
                raise refusal("mask.shape", name=name, shape=np.shape(mask), kind=kind, expected=number.shape)
            some = [slice(i, i + _LINES_LABELLED) for i in range(0, len(number), _LINES_LABELLED)]
            used = np.zeros(2 * count, bool)
            for rows in some:
                used[2 * number[rows].astype(np.intp) + mask[rows]] = True
            kept = np.flatnonzero(used)
            finer = np.empty(number.shape, np.min_scalar_type(max(kept.size - 1, 0)))
            table = np.cumsum(used) - 1
            for rows in some:
                finer[rows] = table[2 * number[rows].astype(np.intp) + mask[rows]]
            number, count = finer, kept.size
            members = {key: own[kept // 2] for key, own in members.items()} | {name: kept % 2 == 1}
        return Labels(number, members)

    def mask(self, chosen: Mask) -> Mask:
        """(lines, samples) pixels of some of the labels (K,)."""
        return np.asarray(chosen[self.number])

    def __getitem__(self, name: str) -> Mask:
        return self.mask(self.members[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self.members)

    def __len__(self) -> int:
        return len(self.members)


class Sums:
    """Sums over one set of pixels.

    Attributes
    ----------
    reference : (B,) point that the sums are about, near the pixels: the mean of some of the first block, so that
        a set of equal pixels has no variance, not even one of rounding; None without pixels
    n : pixels
    first, second : (B,) and (B, B) sums of x - reference and of its products
    """

    def __init__(self, bands: int) -> None:
        self.reference: Array | None = None
        self.n = 0
        self.first, self.second = np.zeros(bands), np.zeros((bands, bands))

    def add(self, pixels: Array, *, whole: bool) -> None:
        """Add pixels (B, n), whose memory is taken; ``whole``: they are whole numbers."""
        if self.reference is None:
            centre = pixels[:, :: max(1, pixels.shape[1] // CENTRED_ON)].mean(axis=1)
            self.reference = np.asarray(np.rint(centre)) if whole else centre
        self.n += pixels.shape[1]
        pixels -= self.reference[:, None]
        # NumPy makes the product of an array and its transpose a symmetric rank-k update: half the work.
        self.second += pixels @ pixels.T
        self.first += pixels @ np.ones(pixels.shape[1])

    def merge(self, other: Sums) -> None:
        """Add the sums of another set of pixels."""
        if other.reference is None:
            return
        if self.reference is None:
            self.reference = other.reference
        e = other.reference - self.reference
        half = np.outer(e, other.first + 0.5 * other.n * e)
        self.second += other.second + half + half.T
        self.first += other.first + other.n * e
        self.n += other.n

    def mean_and_covariance(self) -> tuple[Array, Array]:
        """Mean (B,) and unbiased covariance (B, B) of the pixels; 0 of a single one, as nothing is known of it."""
        assert self.reference is not None  # noqa: S101 - it has pixels
        if self.n == 1:
            return self.reference + self.first, np.zeros_like(self.second)
        # First to a whole number c beside the mean, which is exact for whole numbers, then the rest of the way.
        c = np.rint(self.first / self.n)
        mixed = np.outer(c, self.first - 0.5 * self.n * c)
        e = (self.first - self.n * c) / self.n
        central = self.second - (mixed + mixed.T) - self.n * np.outer(e, e)
        covariance = central / (self.n - 1)
        return self.reference + c + e, (covariance + covariance.T) / 2.0


def region_statistics(
    cube: Cube,
    regions: Mapping[str, Mask] | None = None,
    *,
    threads: int | None = None,
    block_lines: int | None = None,
    watch: Watch = iter,
) -> dict[str, SampleStatistics]:
    """Mean and covariance of every region and of the whole scene.

    Pixels of one label, which lie in the same regions, are summed once and the sums added, so that regions which
    overlap cost little more than the scene alone.  All sums are float64: those of numbers stored as 16-bit integers
    have no rounding error at all, and do not depend on the cut into blocks.  The unit is that of the values; the
    shrinkage intensity is not known (``fourth`` is NaN).  The covariance of a single pixel is zero.

    Parameters
    ----------
    regions : masks (lines, samples) by name, of which "scene" is kept for the whole; or labels, the scene among them
    threads, block_lines : None chooses them
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : a mask that does not fit the cube, or a region without a valid pixel.
    """
    labels = regions
    if not isinstance(labels, Labels):
        if SCENE in (regions or {}):
            raise UsageError(f"the region name {SCENE!r} is kept for the whole image")
        scene = np.broadcast_to(np.True_, (cube.lines, cube.samples))
        labels = Labels.of(scene.shape, {SCENE: scene} | dict(regions or {}))
    members, number = labels.members, labels.number
    count = len(members[SCENE])
    wanted = np.asarray(np.any(list(members.values()), axis=0))

    whole = cube.dtype.kind in "iu"

    def segment(blocks: Iterator[StoredBlock]) -> tuple[dict[int, Sums], Counts]:
        """Sums by label, and how many pixels of each label (K,) hold no data."""
        sums: defaultdict[int, Sums] = defaultdict(lambda: Sums(cube.bands))
        left_out = np.zeros(count, np.int64)
        for rows, pixels, usable in blocks:
            label, known = number[rows].ravel(), usable.ravel()
            if not known.all():
                left_out += np.bincount(label[~known], minlength=count)
                pixels, label = pixels[:, known], label[known]
            present = np.flatnonzero(np.bincount(label, minlength=count) * wanted)
            for key in present.tolist():
                own = pixels if label.size == np.count_nonzero(label == key) else pixels[:, label == key]
                sums[key].add(own, whole=whole)
        return sums, left_out

    # One BLAS thread to the end: a second one, woken for the small products there, would spin into the next pass.
    with single_blas_thread():
        total: defaultdict[int, Sums] = defaultdict(lambda: Sums(cube.bands))
        left_out = np.zeros(count, np.int64)
        for sums, missing in stream(cube, segment, threads=threads, block_lines=block_lines, watch=watch):
            left_out += missing
            while sums:  # taken from there: 2 MB for each label
                key, value = sums.popitem()
                total[key].merge(value)
        return {name: _statistics(cube, name, own, total, left_out) for name, own in members.items()}


def _statistics(cube: Cube, name: str, own: Mask, sums: Mapping[int, Sums], left_out: Counts) -> SampleStatistics:
    """Of the labels (K,) of a region, in the unit of the cube's values."""
    joined = Sums(cube.bands)
    for key in sorted(sums):
        if own[key]:
            joined.merge(sums[key])
    missing = int(own @ left_out)
    if joined.n == 0:
        raise UsageError(f"region {name!r} has no valid pixel ({missing} left out as invalid)", expected="one or more")
    mean, covariance = joined.mean_and_covariance()
    gain = cube.gain
    return SampleStatistics(
        gain * mean + cube.offset, covariance * np.outer(gain, gain), joined.n, missing, float("nan")
    )


def darkest_values(cube: Cube, *, threads: int | None = None) -> Array:
    """The least value (B,) of each band over the pixels that hold data in every band.

    Raises
    ------
    UsageError : no pixel holds data.
    """

    def segment(blocks: Iterator[StoredBlock]) -> Array:
        # A negative gain would turn the order round; values are compared, not numbers.
        parts = (stored[:, usable.ravel()] for _, stored, usable in blocks)
        ends = [[part.min(axis=1), part.max(axis=1)] for part in parts if part.size]
        return np.asarray(np.min(cube.gain * np.array(ends) + cube.offset, axis=(0, 1)) if ends else np.inf)

    none = np.full(cube.bands, np.inf)
    lowest = np.min(np.broadcast_arrays(none, *stream(cube, segment, threads=threads)), axis=0)
    if not np.all(np.isfinite(lowest)):
        raise UsageError("no pixel of the cube holds data in every band")
    return np.asarray(lowest)
