"""Mean and covariance of regions of a stored cube, all in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.executors import single_blas_thread
from hyperval.processing.gram import Directions, Sums
from hyperval.processing.mask_bits import MaskBits
from hyperval.processing.passes import (
    StoredCube,
    Workspace,
    by_segments,
    lines_per_block,
)
from hyperval.processing.sample import SCENE, SampleStatistics

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Precision = Literal["auto", "exact", "fast"]

# Up to so many stored numbers "auto" is exact.
EXACT_VALUES = 100_000_000
# Fewer pixels of one kind wait until there are so many: products of few columns cost as much as of many.
WAITING_PIXELS = 256
# Lines, and pixels in all of them, of the first estimate.
SAMPLED_LINES = 16
SAMPLED_PIXELS = 1024
# Directions that are taken apart in single precision; scenes seldom have more that stand out.
DIRECTIONS = 7
# What single precision may do to a variance before all is summed again in double; batches it is measured on.
MOST_ROUNDING = 1e-3
CHECKED_BLOCKS = 8
MARGIN = 4.0  # other batches may be worse than the worst of these
# Mean squares of stored numbers that single precision can hold with room on both sides.
REPRESENTABLE = (1e-20, 1e20)
# Directions with less than this part of the greatest variance are rounding error of the sums themselves.
LEAST_VARIANCE = 1e-10
_BITS = 62


def region_statistics(
    cube: StoredCube,
    masks: Mapping[str, Mask] | None = None,
    exclude: Mask | None = None,
    *,
    precision: Precision = "auto",
    threads: int | None = None,
    block_lines: int | None = None,
    watch: Callable[[Iterator[Any]], Iterator[Any]] = iter,
) -> dict[str, SampleStatistics]:
    """Mean and covariance of every region and of the whole scene.

    Pixels that belong to the same regions are summed once and the sums added, so that regions which overlap
    cost little more than the scene alone.  The unit is that of the cube's values; the shrinkage intensity is not
    known (``fourth`` is NaN).  The covariance of a single pixel is zero: nothing is known of it.

    Parameters
    ----------
    masks : (lines, samples) True on the pixels of each region; the name "scene" is kept for the whole
    exclude : (lines, samples) True on pixels left out of the scene
    precision : "auto" is exact where that takes about a second at most, and fast above.  "fast" multiplies in
        float32 and sums in float64, in a way that keeps the quiet directions (see
        :mod:`hyperval.processing.gram`), and is checked: some batches are summed both ways at the end, and
        what they differ by, times MARGIN and how far any batch stands out, bounds the error (``rounding`` of the
        statistics).
        Where it exceeds MOST_ROUNDING all is summed again in float64.  "exact" does all in float64: for numbers
        stored as 16-bit integers the sums then have no rounding error at all and nothing depends on the cut into
        blocks.  Numbers stored in more than 32 bits, or as 32-bit integers, are always summed in float64.
    threads, block_lines : None chooses them
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : a mask that does not fit the cube, or a region without a valid pixel.
    """
    once = partial(_statistics_once, cube, masks or {}, exclude, threads, block_lines, watch)
    out = once(precision)
    if out is None:  # and what the first pass took is free before the second
        out = once("exact")
    assert out is not None  # noqa: S101 - exact sums have no rounding to show
    return out


def _statistics_once(
    cube: StoredCube,
    masks: Mapping[str, Mask],
    exclude: Mask | None,
    threads: int | None,
    block_lines: int | None,
    watch: Callable[[Iterator[Any]], Iterator[Any]],
    precision: Precision,
) -> dict[str, SampleStatistics] | None:
    """By one pass; None where its rounding shows, and all is to be summed exactly."""
    regions = _Regions.of(cube, masks, exclude)
    whole = cube.dtype.kind in "iu"
    large = cube.lines * cube.samples * cube.bands > EXACT_VALUES
    wanted = precision == "fast" or (precision == "auto" and large)
    single = wanted and (cube.dtype.itemsize <= 2 or cube.dtype == np.float32)
    directions = _brightest_directions(cube) if single else None
    step = block_lines or lines_per_block(cube)
    workspace = Workspace()

    def segment(firsts: range) -> tuple[dict[bytes, Sums], npt.NDArray[np.int64]]:
        part = _Part(cube.bands, whole, directions)
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
        errors = _rounding_errors(cube, directions, step) if directions is not None else []
        for i, name in enumerate(regions.names):
            joined = Sums(cube.bands, whole, directions)
            for key, value in total.items():
                if key[i]:
                    joined.merge(value)
            statistics = _statistics(cube, name, joined, int(left_out[i]))
            if joined.n_split:
                # A sampled batch in which nothing stands out says nothing of the others: no bound, exact sums.
                parts = [
                    max(1.0, joined.above_typical / above)
                    * _part(error, statistics.covariance, cube.gain, rank=min(joined.n - 1, cube.bands))
                    if above > 0.0
                    else np.inf
                    for above, error in errors
                ]
                bound = MARGIN * max(parts, default=np.inf) * joined.n_split / joined.n
                statistics = replace(statistics, rounding=bound)
            if not statistics.rounding <= MOST_ROUNDING:  # NaN too
                return None
            out[name] = statistics
        return out


def _rounding_errors(cube: StoredCube, directions: Directions, step: int) -> list[tuple[float, Array]]:
    """Of some batches: how far they stand out, and what single precision changes in their covariance (B, B)."""
    errors, whole = [], cube.dtype.kind in "iu"
    last = (cube.lines - 1) // step
    for at in np.unique(np.linspace(0, last, CHECKED_BLOCKS).astype(int)).tolist():
        count = min(step, cube.lines - at * step)
        pair = []
        for chosen in (directions, None):
            sums = Sums(cube.bands, whole, chosen)
            stored, usable = cube.read_stored(at * step, count)
            sums.add(stored, usable)
            pair.append(sums)
        if pair[0].n_split >= 2:
            error = pair[0].mean_and_covariance()[1] - pair[1].mean_and_covariance()[1]
            errors.append((pair[0].above_typical, error))
    return errors


def _part(error: Array, covariance: Array, gain: Array, *, rank: int) -> float:
    """The greatest part of a variance, in any direction that has one, that the error of stored numbers is.

    A covariance that should be definite and is not has no such part.  One of few pixels has variance in ``rank``
    leading directions alone; the rest is zero, on whichever side rounding puts it.
    """
    if not np.all(np.isfinite(covariance)):
        return float("inf")
    values, vectors = np.linalg.eigh(covariance)
    if rank == values.size and values[0] < -LEAST_VARIANCE * values[-1]:
        return float("inf")
    keep = values > LEAST_VARIANCE * values[-1]
    keep[: values.size - rank] = False
    if not keep.any():
        return 0.0
    white = (vectors[:, keep] / np.sqrt(values[keep])).T * gain
    return float(np.linalg.norm(white @ error @ white.T, 2))


def _statistics(cube: StoredCube, name: str, sums: Sums, left_out: int) -> SampleStatistics:
    """In the unit of the cube's values."""
    if sums.n == 0 or sums.reference is None:
        raise UsageError(
            f"region {name!r} has no valid pixel ({left_out} left out as invalid)", expected="one or more"
        )
    if sums.n == 1:  # a spectrum; nothing is known of its spread
        mean, covariance = sums.reference + sums.total, np.zeros((cube.bands, cube.bands))
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
    directions: Directions | None
    sums: dict[bytes, Sums] = field(default_factory=dict)
    waiting: dict[bytes, list[npt.NDArray[Any]]] = field(default_factory=dict)

    def add(self, stored: npt.NDArray[Any], kinds: list[tuple[bytes, Mask]], space: Workspace) -> None:
        """Add stored numbers (B, lines, samples), whose content is lost, by the regions that they lie in."""
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
            self.sums[key] = Sums(self.bands, self.whole, self.directions)
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


def _brightest_directions(cube: StoredCube) -> Directions | None:
    """Directions of the greatest variance of some lines; None where single precision does not hold the squares."""
    out = []
    for line in np.unique(np.linspace(0, cube.lines - 1, SAMPLED_LINES).astype(int)).tolist():
        stored, usable = cube.read_stored(line, 1)
        rows, columns = np.nonzero(usable)
        some = slice(None, None, -(-rows.size // (SAMPLED_PIXELS // SAMPLED_LINES)) or 1)
        out.append(stored[:, rows[some], columns[some]].astype(np.float64))
    pixels = np.concatenate(out, axis=1)
    pixels -= np.median(pixels, axis=1, keepdims=True) if pixels.shape[1] else 0.0
    size = float(np.mean(pixels**2)) if pixels.size else 0.0
    if size and not REPRESENTABLE[0] < size < REPRESENTABLE[1]:
        return None
    # Subspace iteration: these need not be the very eigenvectors, only span what stands out.
    directions = np.random.default_rng(0).normal(size=(cube.bands, min(DIRECTIONS, cube.bands)))
    with single_blas_thread():
        for _ in range(4):
            directions = np.linalg.qr(pixels @ (pixels.T @ directions))[0]
        return Directions.of(directions, pixels)
