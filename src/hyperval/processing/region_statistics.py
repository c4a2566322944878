"""Mean and covariance of regions of a stored cube, all in one pass.

Masks of large images at one bit a pixel.

Sums of pixels and of their products are taken in float64, block by block, about a point near the pixels: a whole
number where the stored numbers are whole, so that the differences, their products and the sums of these are exact
while they stay below 2^53.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.executors import single_blas_thread
from hyperval.processing.passes import (
    StoredCube,
    Workspace,
    as_columns,
    by_segments,
    lines_per_block,
)
from hyperval.processing.sample import SCENE, SampleStatistics

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class MaskBits:
    """A mask (lines, samples) at one bit a pixel, which is read by lines.

    Attributes
    ----------
    bits : (lines, bytes of a line) eight samples in a byte, the first in its highest bit
    samples : of a line
    """

    bits: npt.NDArray[np.uint8]
    samples: int

    @classmethod
    def of(cls, mask: Mask) -> MaskBits:
        """The mask, packed.

        Examples
        --------
        >>> packed = MaskBits.of(np.array([[True, False, True], [False, False, True]]))
        >>> packed.bits.ravel().tolist(), packed[1:2].tolist()
        ([160, 32], [[False, False, True]])
        """
        return cls(np.packbits(mask, axis=1), mask.shape[1])

    def __getitem__(self, lines: slice) -> Mask:
        """Some lines."""
        return np.unpackbits(self.bits[lines], axis=1, count=self.samples).view(bool)


class PackedMasks(Mapping[str, Mask]):
    """Masks by name: kept packed, each handed out whole as an array of its own."""

    def __init__(self, masks: Iterable[tuple[str, Mask]] = ()) -> None:
        self._bits: dict[str, MaskBits] = {}
        for name, mask in masks:
            self.add(name, mask)

    def add(self, name: str, mask: Mask) -> None:
        """Pack one more mask, or another one of that name."""
        self._bits[name] = MaskBits.of(mask)

    def same(self, others: PackedMasks) -> set[str]:
        """Names under which both have the same pixels.

        Examples
        --------
        >>> mask = np.array([[True, False, True]])
        >>> PackedMasks([("a", mask), ("b", mask)]).same(PackedMasks([("a", mask), ("b", ~mask), ("c", mask)]))
        {'a'}
        """
        both = self._bits.keys() & others._bits.keys()
        return {name for name in both if np.array_equal(self._bits[name].bits, others._bits[name].bits)}

    def __getitem__(self, name: str) -> Mask:
        return self._bits[name][:]

    def __iter__(self) -> Iterator[str]:
        return iter(self._bits)

    def __len__(self) -> int:
        return len(self._bits)


Array = npt.NDArray[np.float64]


# Pixels are taken about the mean of at least so many of the first block.
CENTRED_ON = 64
# Fewer pixels of one kind wait until there are so many: products of few columns cost as much as of many.
WAITING_PIXELS = 256
_BITS = 62


@dataclass
class Sums:
    """Sums over one set of pixels.

    Attributes
    ----------
    bands : B
    whole : the stored numbers are whole
    reference : (B,) point that the sums are about, near the pixels: the mean of some of the first block, so that
        a set of equal pixels has no variance, not even one of rounding
    n : pixels
    first, second : (B,) and (B, B) sums of x - reference and of its products
    """

    bands: int
    whole: bool
    reference: Array | None = None
    n: int = 0
    first: Array = field(init=False)
    second: Array = field(init=False)

    def __post_init__(self) -> None:
        self.first, self.second = np.zeros(self.bands), np.zeros((self.bands, self.bands))

    def add(self, stored: npt.NDArray[Any], keep: Mask | None = None, space: Workspace | None = None) -> None:
        """Add stored numbers (B, lines, samples).

        ``keep`` (lines, samples) says which pixels count, all with None; ``space`` is used for the arrays.
        """
        count = stored[0].size if keep is None else int(np.count_nonzero(keep))
        if count == 0:
            return
        if self.reference is None:
            lines, samples = np.nonzero(np.ones(stored.shape[1:], bool) if keep is None else keep)
            some = slice(None, None, max(1, count // CENTRED_ON))
            centre = stored[:, lines[some], samples[some]].mean(axis=1, dtype=np.float64)
            self.reference = np.asarray(np.rint(centre)) if self.whole else centre
        self.n += count
        pixels = (space or Workspace()).columns("pixels", stored, self.bands, np.float64)
        np.copyto(pixels, stored, casting="same_kind")
        pixels -= self.reference[:, None, None]
        if keep is not None:
            pixels[:, ~keep] = 0.0
        columns = as_columns(pixels)
        # NumPy makes the product of an array and its transpose a symmetric rank-k update: half the work.
        self.second += columns @ columns.T
        self.first += columns @ np.ones(columns.shape[1])

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
        """Mean (B,) and unbiased covariance (B, B) of the pixels, n >= 2."""
        if self.reference is None or self.n < 2:
            raise UsageError(f"{self.n} pixels have no covariance", expected="two or more")
        # First to a whole number c beside the mean, which is exact for whole numbers, then the rest of the way.
        c = np.rint(self.first / self.n)
        mixed = np.outer(c, self.first - 0.5 * self.n * c)
        e = (self.first - self.n * c) / self.n
        central = self.second - (mixed + mixed.T) - self.n * np.outer(e, e)
        covariance = central / (self.n - 1)
        return self.reference + c + e, (covariance + covariance.T) / 2.0


def region_statistics(
    cube: StoredCube,
    masks: Mapping[str, Mask] | None = None,
    exclude: Mask | None = None,
    *,
    threads: int | None = None,
    block_lines: int | None = None,
    watch: Callable[[Iterator[Any]], Iterator[Any]] = iter,
) -> dict[str, SampleStatistics]:
    """Mean and covariance of every region and of the whole scene.

    Pixels that belong to the same regions are summed once and the sums added, so that regions which overlap
    cost little more than the scene alone.  All sums are float64: those of numbers stored as 16-bit integers have no
    rounding error at all, and do not depend on the cut into blocks.  The unit is that of the values; the shrinkage
    intensity is not known (``fourth`` is NaN).  The covariance of a single pixel is zero: nothing is known of it.

    Parameters
    ----------
    masks : (lines, samples) True on the pixels of each region; the name "scene" is kept for the whole
    exclude : (lines, samples) True on pixels left out of the scene
    threads, block_lines : None chooses them
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : a mask that does not fit the cube, or a region without a valid pixel.
    """
    regions = _Regions.of(cube, masks or {}, exclude)
    whole = cube.dtype.kind in "iu"
    step = block_lines or lines_per_block(cube)
    workspace = Workspace()

    def segment(firsts: range) -> tuple[dict[bytes, Sums], npt.NDArray[np.int64]]:
        part = _Part(cube.bands, whole)
        left_out = np.zeros(len(regions.names), np.int64)
        for first in firsts:
            count = min(step, cube.lines - first)
            buffer = workspace.flat("stored", cube.bands * count * cube.samples, cube.dtype)
            stored, usable = cube.read_stored(first, count, None, buffer)
            kinds, missing = regions.kinds(slice(first, first + count), usable)
            left_out += missing
            part.add(stored, kinds, workspace)
            del stored  # a view of lines that a raster may hold: they would stay while it reads the next
        part.finish()
        return part.sums, left_out

    # One BLAS thread to the end: a second one, woken for the small products there, would spin into the next pass.
    with single_blas_thread():
        total: dict[bytes, Sums] = {}
        left_out = np.zeros(len(regions.names), np.int64)
        for _, (sums, missing) in watch(by_segments(cube, step, segment, threads=threads)):
            left_out += missing
            for key, value in sums.items():
                if key in total:
                    total[key].merge(value)
                else:
                    total[key] = value
            del sums  # 2 MB for each kind of pixels: not beside those of the next segment
        out = {}
        for i, name in enumerate(regions.names):
            joined = Sums(cube.bands, whole)
            for key, value in total.items():
                if key[i]:
                    joined.merge(value)
            out[name] = _statistics(cube, name, joined, int(left_out[i]))
        return out


def _statistics(cube: StoredCube, name: str, sums: Sums, left_out: int) -> SampleStatistics:
    """In the unit of the cube's values."""
    if sums.n == 0 or sums.reference is None:
        raise UsageError(f"region {name!r} has no valid pixel ({left_out} left out as invalid)", expected="one or more")
    if sums.n == 1:  # a spectrum; nothing is known of its spread
        mean, covariance = sums.reference + sums.first, np.zeros((cube.bands, cube.bands))
    else:
        mean, covariance = sums.mean_and_covariance()
    gain = cube.gain
    return SampleStatistics(
        gain * mean + cube.offset, covariance * np.outer(gain, gain), sums.n, left_out, float("nan")
    )


def darkest_values(cube: StoredCube, *, threads: int | None = None) -> Array:
    """The least value (B,) of each band over the pixels that hold data in every band.

    Raises
    ------
    UsageError : no pixel holds data.
    """
    step = lines_per_block(cube)

    def segment(firsts: range) -> Array:
        least = np.full(cube.bands, np.inf)
        for first in firsts:
            stored, usable = cube.read_stored(first, min(step, cube.lines - first))
            values = stored[:, usable]
            if values.shape[1]:
                # A negative gain would turn the order round; values are compared, not numbers.
                ends = np.stack([values.min(axis=1), values.max(axis=1)]).astype(np.float64)
                least = np.minimum(least, (cube.gain * ends + cube.offset).min(axis=0))
        return least

    lowest = np.stack([part for _, part in by_segments(cube, step, segment, threads=threads)]).min(axis=0)
    if not np.all(np.isfinite(lowest)):
        raise UsageError("no pixel of the cube holds data in every band")
    return np.asarray(lowest)


@dataclass(frozen=True)
class _Regions:
    """Names and masks; the first is the scene, whose mask says what is left out of it.

    ``plain`` (lines,) is True where a line lies in the scene and in no other region.
    """

    names: tuple[str, ...]
    masks: tuple[MaskBits | None, ...]
    plain: Mask

    @classmethod
    def of(cls, cube: StoredCube, masks: Mapping[str, Mask], exclude: Mask | None) -> _Regions:
        if SCENE in masks:
            raise UsageError(f"the region name {SCENE!r} is kept for the whole image")
        shape, plain = (cube.lines, cube.samples), np.ones(cube.lines, bool)

        def packed(name: str, mask: Mask) -> MaskBits:
            if np.shape(mask) != shape or np.asarray(mask).dtype != bool:
                raise UsageError(
                    f"the mask of {name!r} has shape {np.shape(mask)} of {np.asarray(mask).dtype}",
                    expected=f"{shape} of bool",
                )
            np.logical_and(plain, ~mask.any(axis=1), out=plain)
            return MaskBits.of(mask)

        scene = None if exclude is None else packed(SCENE, exclude)
        return cls((SCENE, *masks), (scene, *(packed(*item) for item in masks.items())), plain)

    def kinds(self, rows: slice, usable: Mask) -> tuple[list[tuple[bytes, Mask]], npt.NDArray[np.int64]]:
        """The usable pixels (lines, samples) by the regions they lie in, and how many others each region holds.

        The regions are one byte each.
        """
        left_out = np.zeros(len(self.names), np.int64)
        if self.plain[rows].all():
            left_out[0] = usable.size - np.count_nonzero(usable)
            return [(bytes([1] + [0] * (len(self.names) - 1)), usable)], left_out
        inside = np.zeros((len(self.names), usable.size), bool)
        for row, mask in zip(inside, self.masks, strict=True):
            if mask is not None:
                row[:] = mask[rows].ravel()
        np.logical_not(inside[0], out=inside[0])
        left_out += np.count_nonzero(inside & ~usable.ravel(), axis=1)
        inside &= usable.ravel()
        return [(key, members.reshape(usable.shape)) for key, members in _kinds(inside)], left_out


@dataclass
class _Part:
    """Sums of one segment by the set of regions that the pixels belong to (one byte for each region)."""

    bands: int
    whole: bool
    sums: dict[bytes, Sums] = field(default_factory=dict)
    waiting: dict[bytes, list[npt.NDArray[Any]]] = field(default_factory=dict)

    def add(self, stored: npt.NDArray[Any], kinds: list[tuple[bytes, Mask]], space: Workspace) -> None:
        """Add stored numbers (B, lines, samples) by the regions that they lie in."""
        sizes = [int(np.count_nonzero(members)) if any(key) else 0 for key, members in kinds]
        most = max(range(len(sizes)), key=sizes.__getitem__)
        # The most frequent kind stays where it is, unless it is rare itself; the others are copied out.
        few = sizes[most] < min(WAITING_PIXELS, stored[0].size)
        for i, (key, members) in enumerate(kinds):
            if sizes[i] and (few or i != most):
                waiting = self.waiting.setdefault(key, [])
                waiting.append(stored[:, members])
                if sum(h.shape[1] for h in waiting) >= WAITING_PIXELS:
                    self._release(key)
        if not few:
            key, keep = kinds[most]
            self._of(key).add(stored, None if sizes[most] == keep.size else keep, space)

    def finish(self) -> None:
        """Sum what still waits."""
        for key in list(self.waiting):
            self._release(key)

    def _release(self, key: bytes) -> None:
        waiting = self.waiting.pop(key)
        self._of(key).add(np.concatenate(waiting, axis=1)[:, None])

    def _of(self, key: bytes) -> Sums:
        if key not in self.sums:
            self.sums[key] = Sums(self.bands, self.whole)
        return self.sums[key]


def _kinds(inside: Mask) -> list[tuple[bytes, Mask]]:
    """The different columns of (R, N) as bytes, and where each stands."""
    if np.array_equal(inside.all(axis=1), inside.any(axis=1)):
        return [(inside[:, 0].tobytes(), np.ones(inside.shape[1], bool))]
    if inside.shape[0] <= _BITS:
        codes: npt.NDArray[Any] = (1 << np.arange(inside.shape[0], dtype=np.int64)) @ inside
    else:
        packed = np.ascontiguousarray(np.packbits(inside, axis=0).T)
        codes = packed.view(np.dtype((np.void, packed.shape[1]))).ravel()
    _, at, which = np.unique(codes, return_index=True, return_inverse=True)
    return [(inside[:, i].tobytes(), which == k) for k, i in enumerate(at.tolist())]
