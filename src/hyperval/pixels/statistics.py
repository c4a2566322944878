"""One pass over a stored cube by segments of lines, the moments of regions of one label image, and their errors.

Segments and blocks depend on the size of the cube alone and results are joined in order, so that the number of threads
changes nothing.  Sums of pixels and of their products are taken in float64, block by block, about a point near the
pixels: a whole number where the stored numbers are whole, so that the differences, their products and the sums of these
are exact while they stay below 2^53.

Neighbouring pixels are correlated: a region is worth fewer independent pixels than it has.  A sample covariance of
n < B pixels has no variance at all in B - n + 1 directions; an error taken from it is 0 there, and a test that divides
by it finds a difference in every spectrum.  So few pixels do determine the variance of each band and the few common
factors significant against chance; the rest is taken as independent from band to band, as the noise of a sensor is.

Sample eigenvalues are biased (the great ones too great, the small ones too small) where n is not far above the number
of bands.  A prediction is therefore not compared with a measured eigenvalue itself, but with what n pixels drawn from
the predicted covariance would show.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from scipy import fft, special

from hyperval.data import Array, Index, Mask, SampleStatistics
from hyperval.errors import UsageError, refuse
from hyperval.executors import available_cores, single_blas_thread
from hyperval.model.intervals import drawn_factors, student_factor

if TYPE_CHECKING:
    from hyperval.imagery import Cube

Result = TypeVar("Result")
Watch = Callable[[Iterator[Any]], Iterator[Any]]

SCENE = "scene"
# Smaller blocks fit the processor's cache, but each costs its calls; larger ones take more memory.
BLOCK_PIXELS = 1920
BLOCKS_PER_SEGMENT = 16
MAX_THREADS = 4  # more only wait for memory
_LABEL_LINES = 256  # at a time
# Sums are about the mean of at least so many pixels of the first block.
CENTRED_ON = 64


# A block of lines: their slice; (F, N) stored numbers of the chosen bands, pixel by pixel, in memory that the next
# block reuses; and the mask (lines, samples) of pixels that hold data.
StoredBlock = tuple[slice, Array, Mask]


def _segment_starts(lines: int, block_lines: int) -> list[range]:
    """First lines of the blocks of each segment; as many segments for each thread, so that threads end together."""
    blocks = -(-lines // block_lines)
    count = min(-(-blocks // (BLOCKS_PER_SEGMENT * MAX_THREADS)) * MAX_THREADS, blocks)
    edges = [block_lines * (blocks * i // count) for i in range(count)] + [lines]
    return [range(a, b, block_lines) for a, b in itertools.pairwise(edges)]


def by_segments(cube: Cube, block_lines: int, work: Callable[[range], Result], watch: Watch = iter) -> Iterator[Result]:
    """The result of ``work`` for each segment, in order; ``work`` gets the first lines of the segment's blocks.

    As many threads are used as there are cores, at most four, and one where arrays of a file are read, which goes one
    by one, or NumPy's BLAS cannot be kept to one thread.  ``watch`` wraps the iterator over the segments, for a
    progress bar.
    """
    segments = _segment_starts(cube.lines, block_lines)

    def results() -> Iterator[tuple[range, Result]]:
        with cube.raster.kept_open(), single_blas_thread() as one_thread:
            count = min(available_cores(), MAX_THREADS) if one_thread and not cube.raster.in_blocks else 1
            if count <= 1:
                yield from zip(segments, map(work, segments), strict=True)
                return
            pool = ThreadPoolExecutor(count)
            try:
                yield from zip(segments, pool.map(work, segments), strict=True)
            finally:
                pool.shutdown(cancel_futures=True)

    return (result for _, result in watch(results()))


def stream_blocks(
    cube: Cube,
    work: Callable[[Iterator[StoredBlock]], Result],
    bands: Mask | None = None,
    needed: Mask | None = None,
    watch: Watch = iter,
) -> Iterator[Result]:
    """The result of ``work`` on the blocks of each segment of a cube, in order: one pass over the image.

    Parameters
    ----------
    bands : (B,) that are read, all by default
    needed : (B,) that must hold data in a usable pixel, all by default; others are NaN where they hold none
    watch : wraps the iterator over the parts of the pass, for a progress bar

    >>> from tempfile import TemporaryDirectory
    >>> from hyperval.imagery import open_cube, write_cube
    >>> from hyperval.spectra.axis import SpectralAxis
    >>> values, axis = np.random.default_rng(0).integers(1, 9, (32, 16, 5)), SpectralAxis(np.arange(500.0, 505.0), 1.0)
    >>> values[..., 4] = 0  # a band that holds no data is left out
    >>> with TemporaryDirectory() as folder:
    ...     cube = open_cube(write_cube(f"{folder}/x.img", values, axis=axis, ignore_value=0), quantity="counts")
    ...     means = list(stream_blocks(cube, lambda blocks: [np.array(x).mean(axis=1) for _, x, _ in blocks]))
    >>> np.allclose(np.mean(np.concatenate(means), axis=0), values[..., :4].mean(axis=(0, 1)))
    True
    """
    step = min(max(1, round(BLOCK_PIXELS / cube.samples)), cube.lines)
    chosen = np.flatnonzero(np.ones(cube.bands, bool) if bands is None else bands)
    # Ends of runs of adjacent bands among the chosen.
    ends = np.flatnonzero(np.diff(chosen, append=cube.bands + 1) > 1) + 1
    count, block_pixels = chosen.size, step * cube.samples
    optional = [] if needed is None else np.flatnonzero(~needed[chosen]).tolist()

    def blocks(first_lines: range) -> Iterator[StoredBlock]:
        buffer, memory = np.empty(cube.raster.bands * block_pixels, cube.dtype), np.empty(count * block_pixels)
        for first_line in first_lines:
            lines = min(step, cube.lines - first_line)
            pixels = lines * cube.samples
            stored, usable = cube.read_stored(first_line, lines, needed, buffer)
            # In the order of the file: by pixel where the bands of a pixel lie side by side.
            by_pixel = stored.strides[0] < stored.strides[2]
            flat = memory[: count * pixels]
            numbers = flat.reshape(pixels, count).T if by_pixel else flat.reshape(count, pixels)
            image = numbers.reshape(count, lines, cube.samples)
            for start, end in zip([0, *ends[:-1]], ends, strict=False):
                image[start:end] = stored[chosen[start] : chosen[end - 1] + 1]
            for band in optional:
                image[band][cube.lacking(stored[chosen[band]])] = np.nan
            del stored  # a view of lines that a raster may hold: they would stay while it reads the next
            yield slice(first_line, first_line + lines), numbers, usable

    return by_segments(cube, step, lambda first_lines: work(blocks(first_lines)), watch)


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
    >>> labels = Labels.from_masks((2, 2), {"left": left, "top": top})
    >>> labels.number.tolist(), labels["top"].tolist()
    ([[3, 1], [2, 0]], [[True, True], [False, False]])
    >>> labels.mask(labels.members["left"] & ~labels.members["top"]).tolist()
    [[False, False], [True, False]]
    """

    number: npt.NDArray[Any]
    members: Mapping[str, Mask] = field(default_factory=dict)

    @classmethod
    def from_masks(cls, shape: tuple[int, int], masks: Mapping[str, Mask] | None = None) -> Labels:
        """The label image of masks (lines, samples) by name."""
        return cls(np.zeros(shape, np.uint8), {}).with_masks((masks or {}).items())

    def with_masks(self, masks: Iterable[tuple[str, Mask]]) -> Labels:
        """The same with more regions."""
        number, members = self.number, dict(self.members)
        count = len(next(iter(members.values()))) if members else int(number.max(initial=0)) + 1
        for name, mask in masks:
            strips = [slice(i, i + _LABEL_LINES) for i in range(0, len(number), _LABEL_LINES)]
            occurs = np.zeros(2 * count, bool)
            for rows in strips:
                occurs[2 * number[rows].astype(np.intp) + mask[rows]] = True
            present = np.flatnonzero(occurs)
            relabelled = np.empty(number.shape, np.min_scalar_type(max(present.size - 1, 0)))
            lookup = np.cumsum(occurs) - 1
            for rows in strips:
                relabelled[rows] = lookup[2 * number[rows].astype(np.intp) + mask[rows]]
            number, count = relabelled, present.size
            members = {key: bits[present // 2] for key, bits in members.items()} | {name: present % 2 == 1}
        return Labels(number, members)

    def displaced(self, names: Sequence[str], by: tuple[int, int], first: int = 0) -> Labels:
        """Some of the regions so many lines and samples away, from a first line on; what leaves the image comes in on
        the other side.

        >>> left, top = np.array([[True, False], [True, False]]), np.array([[True, True], [False, False]])
        >>> labels = Labels.from_masks((2, 2), {"left": left, "top": top})
        >>> [labels.displaced(names, (1, 0))["top"].tolist() for names in (["top"], ["left", "top"], ["left"])]
        [[[False, False], [True, True]], [[False, False], [True, True]], [[True, True], [False, False]]]
        >>> labels.displaced(["top"], (1, 0), 1)["top"].tolist()
        [[True, True], [True, True]]
        """

        def rolled(x: npt.NDArray[Any]) -> npt.NDArray[Any]:
            return np.concatenate([x[:first], np.roll(x, by, (0, 1))[first:]])

        if len(names) == len(self):
            return Labels(rolled(self.number), self.members)
        return Labels.from_masks(self.number.shape, {k: rolled(m) if k in names else m for k, m in self.items()})

    def mask(self, chosen: Mask) -> Mask:
        """(lines, samples) pixels of some of the labels (K,)."""
        return np.asarray(chosen[self.number])

    def __getitem__(self, name: str) -> Mask:
        return self.mask(self.members[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self.members)

    def __len__(self) -> int:
        return len(self.members)


class Sums(NamedTuple):
    """Sums over one set of pixels.

    Attributes
    ----------
    reference : (B,) point that the sums are about, near the pixels: the mean of some of the first block, so that
        a set of equal pixels has no variance, not even one of rounding
    n : pixels
    total, products : (B,) and (B, B) sums of x - reference and of its products
    """

    reference: Array
    n: int
    total: Array
    products: Array

    @classmethod
    def accumulate(cls, pixels: Array, previous: Sums | None, *, integers: bool) -> Sums:
        """Sums with pixels (B, n) added to ``previous``, both overwritten; ``integers``: pixels are whole numbers."""
        if previous is None:
            centre, bands = pixels[:, :: max(1, pixels.shape[1] // CENTRED_ON)].mean(axis=1), len(pixels)
            previous = cls(np.rint(centre) if integers else centre, 0, np.zeros(bands), np.zeros((bands, bands)))
        reference, n, total, products = previous
        pixels -= reference[:, None]
        # In place, as each block adds to many regions.  NumPy makes the product of an array and its transpose a
        # symmetric rank-k update: half the work.
        products += pixels @ pixels.T
        total += pixels @ np.ones(pixels.shape[1])
        return cls(reference, n + pixels.shape[1], total, products)

    def merged(self, other: Sums) -> Sums:
        """Sums over these pixels and another set."""
        offset = other.reference - self.reference
        cross = np.outer(offset, other.total + 0.5 * other.n * offset)
        total = self.total + (other.total + other.n * offset)
        return Sums(self.reference, self.n + other.n, total, self.products + (other.products + cross + cross.T))

    def mean_and_covariance(self) -> tuple[Array, Array]:
        """Mean (B,) and unbiased covariance (B, B) of the pixels; 0 for a single one."""
        # The centre moves to a whole number c near the mean, exactly for whole numbers, then by e to the mean.
        c = np.rint(self.total / self.n)
        mixed = np.outer(c, self.total - 0.5 * self.n * c)
        e = (self.total - self.n * c) / self.n
        central = self.products - (mixed + mixed.T) - self.n * np.outer(e, e)
        covariance = central / max(self.n - 1, 1)  # a single pixel lies at the reference
        return self.reference + c + e, (covariance + covariance.T) / 2.0


def region_statistics(cube: Cube, labels: Labels, needed: Mask, *, watch: Watch = iter) -> dict[str, SampleStatistics]:
    """Mean and covariance of every region.

    Pixels of one label, which lie in the same regions, are summed once and the sums added, so that regions which
    overlap cost little more than the scene alone.  All sums are float64: those of numbers stored as 16-bit integers
    have no rounding error at all, and do not depend on the cut into blocks.  The unit is that of the values; the
    shrinkage intensity is not known (``fourth`` is NaN).  The covariance of a single pixel is zero.

    Parameters
    ----------
    needed : (B,) bands that must hold data; another is NaN where one of the pixels holds none in it
    watch : wraps the iterator over the parts of the pass, for a progress bar

    Raises
    ------
    UsageError : a region without a valid pixel.
    """
    members, number, sums = labels.members, labels.number, dict[int, Sums]()
    wanted = np.asarray(np.any(list(members.values()), axis=0))

    def segment(blocks: Iterator[StoredBlock]) -> dict[int, Sums]:
        """Sums by label."""
        sums_by_label: dict[int, Sums] = {}
        for rows, pixels, usable in blocks:
            label, valid = number[rows].ravel(), usable.ravel()
            if not valid.all():
                pixels, label = pixels[:, valid], label[valid]
            for key in np.flatnonzero(np.bincount(label, minlength=wanted.size) * wanted).tolist():
                selected = pixels if label.size == np.count_nonzero(label == key) else pixels[:, label == key]
                sums_by_label[key] = Sums.accumulate(selected, sums_by_label.get(key), integers=cube.dtype.kind in "iu")
        return sums_by_label

    # One BLAS thread to the end: a second, started for the small products there, would spin into the next pass.
    with single_blas_thread():
        for sums_by_label in stream_blocks(cube, segment, needed=needed, watch=watch):
            while sums_by_label:  # freed one by one: 2 MB for each label
                key, addition = sums_by_label.popitem()
                sums[key] = sums[key].merged(addition) if key in sums else addition
        return {name: _sample_statistics(cube, name, labels, sums) for name in members}


def _sample_statistics(cube: Cube, name: str, labels: Labels, sums: Mapping[int, Sums]) -> SampleStatistics:
    """Statistics of a region from the sums of its labels, in the unit of the cube's values."""
    parts = [sums[key] for key in sorted(sums) if labels.members[name][key]]
    if not parts:
        missing = np.count_nonzero(labels[name])
        raise UsageError(f"region {name!r} has no valid pixel ({missing} empty or saturated)", expected="one or more")
    joined, gain = reduce(Sums.merged, parts), cube.gain
    mean, covariance = joined.mean_and_covariance()
    return SampleStatistics(gain * mean + cube.offset, covariance * np.outer(gain, gain), joined.n, float("nan"))


def darkest_values(cube: Cube) -> Array:
    """The least value (B,) of each band over the pixels that hold data in every good band.

    It is NaN in a bad band that lacks data in one of them.

    Raises
    ------
    UsageError : no pixel holds data.
    """
    parts = (block.values[block.valid] for block in cube.blocks())
    lowest = np.min([part.min(axis=0, initial=np.inf) for part in parts], axis=0)
    refuse(not np.all(np.isfinite(lowest[cube.axis.good])), "cube.no_pixel")
    return np.asarray(lowest)


def lag_correlation(windows: Iterable[tuple[Array, Mask]], reach: int) -> tuple[Array, Array]:
    """Correlation by lag of centred quantities, pooled over windows of an image.

    Parameters
    ----------
    windows : values (K, lines, samples), of mean 0 over the region, with the mask of the pixels that count
    reach : greatest lag R [pixels]

    Returns
    -------
    correlation (K, 2R + 1, 2R + 1) at lags of -R to R lines and samples, and the pairs of pixels behind it
    """
    lags, products = np.ix_(*2 * [np.arange(-reach, reach + 1)]), 0.0
    for values, mask in windows:
        # The autocorrelation of the mask counts the pairs.
        quantities = np.concatenate([np.where(mask, values, 0.0), mask[None].astype(float)])
        # Zero padding, so that no lag wraps around the window.
        size = tuple(fft.next_fast_len(n + reach, real=True) for n in mask.shape)
        products = products + fft.irfft2(np.abs(fft.rfft2(quantities, size)) ** 2, size)[:, *lags]
    total, pairs = np.asarray(products)[:-1], np.round(np.asarray(products)[-1])
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = np.where(pairs > 0, total / pairs, 0.0)
        value = covariance / covariance[:, reach, reach][:, None, None]
    return np.nan_to_num(value), pairs


def neighbour_shares(mask: Mask, reach: int, rng: np.random.Generator, most: int = 2000) -> Array:
    """(2R + 1, 2R + 1) share of the pixels of a region whose neighbour at each lag belongs to it as well."""
    pixels, counts = np.transpose(drawn_pixels(mask, most, rng)), np.zeros((2 * reach + 1,) * 2)
    for line, sample in pixels:
        window = mask[max(line - reach, 0) : line + reach + 1, max(sample - reach, 0) : sample + reach + 1]
        row, column = max(reach - line, 0), max(reach - sample, 0)
        counts[row : row + window.shape[0], column : column + window.shape[1]] += window
    return counts / len(pixels)


def drawn_pixels(mask: Mask, most: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """Lines and samples of the pixels of a mask, of ``most`` drawn at random where there are more.

    Line by line: the places of all pixels of a large image would take 16 bytes for each.
    """
    cumulative = np.cumsum(np.count_nonzero(mask, axis=1))
    count = int(cumulative[-1]) if cumulative.size else 0
    return nth_pixels(mask, rng.choice(count, most, replace=False) if count > most else np.arange(count), cumulative)


def nth_pixels(mask: Mask, numbers: Index, until: Index | None = None) -> tuple[Index, Index]:
    """Lines and samples of the pixels of a mask that bear these numbers, counted line by line from 0.

    ``until`` : pixels of the mask up to the end of each line, where they are counted already
    """
    until = np.cumsum(np.count_nonzero(mask, axis=1)) if until is None else until
    lines = np.searchsorted(until, numbers, side="right")
    samples = np.empty(lines.size, np.intp)
    order = np.argsort(lines, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(lines[order])) + 1) if lines.size else ():
        line = int(lines[members[0]])
        earlier = int(until[line - 1]) if line else 0
        samples[members] = np.flatnonzero(mask[line])[numbers[members] - earlier]
    return lines, samples


COMPONENTS = 24  # leading ones whose correlation on the ground is measured one by one
_RING_NOISE = 2.0  # standard errors
MAX_REMOVED = 0.5  # part of the correlation removed by the region's own mean; more cannot be restored
MIXTURES = 4  # random combinations of all the other components


@dataclass(frozen=True)
class PrincipalComponents:
    """Principal components of a region's pixels.

    Attributes
    ----------
    vectors, values : (B, K), (K,) the leading ones
    rest : (B, M) mixtures of all the others, each of variance 1; M = 0 where there are no others
    """

    vectors: Array
    values: Array
    mixtures: Array

    def scores(self, centred: Array) -> Array:
        """(K + M, ...) quantities of variance 1 of pixels (..., B) with their mean removed."""
        return np.moveaxis(centred @ np.hstack([self.vectors / np.sqrt(self.values), self.mixtures]), -1, 0)


def covariance_components(covariance: Array, rng: np.random.Generator, count: int = COMPONENTS) -> PrincipalComponents:
    """Components of a covariance (B, B); directions without variance are left out."""
    eigen = EigenDirections.from_covariance(covariance)
    values, vectors = eigen.values, eigen.vectors
    minor = vectors[:, count:] / np.sqrt(values[count:])
    mix = rng.standard_normal((minor.shape[1], MIXTURES))
    mixtures = minor @ (mix / np.linalg.norm(mix, axis=0)) if minor.shape[1] else np.zeros((covariance.shape[0], 0))
    return PrincipalComponents(vectors[:, :count], values[:count], mixtures)


def independent_pixels(windows: Iterable[tuple[Array, Mask]], shares: Array, n: int, reach: int) -> tuple[Array, Array]:
    """(K,) independent pixels for the mean, and for the variance, of K quantities over a region of ``n`` pixels.

    n / sum_h rho(h) share(h), and the same with rho^2, as cov(x^2, y^2) = 2 rho^2 sigma^4 of normal values takes
    the place of cov(x, y) = rho sigma^2 (Cressie, Statistics for Spatial Data, 1993, 1.3).  The correlation is
    summed ring by ring outwards and stops at the first ring whose mean is not above two standard errors of
    uncorrelated pixels: beyond it there is noise (the initial positive sequence of Geyer, Stat. Sci. 7, 473-483,
    1992, is the same on a line).  The mean of a correlated region takes a part of its own variance away, 1 of so
    many independent pixels: the number for the mean is less by it.  It takes the same part from the correlation at
    every lag, rho = (1 - q) rho_found + q with q = total/n, which is put back: with S the sum found, S2 that of its
    squares and M the sum of shares, total = S + (total/n) (M - S), and (1 - q)^2 S2 + 2 q (1 - q) S + q^2 M for rho^2.

    Parameters
    ----------
    windows : values (K, lines, samples) of mean 0 over the region, and the pixels that count
    shares : (2R + 1, 2R + 1) share of the region's pixels whose neighbour at each lag belongs to it
    reach : R [pixels]
    """
    correlation, counted = lag_correlation(windows, reach)
    steps = np.arange(-reach, reach + 1)
    ring = np.rint(np.hypot(steps[:, None], steps)).astype(int).ravel()

    def by_ring(values: Array) -> Array:
        return np.asarray(np.bincount(ring, values.ravel()), dtype=float)[: reach + 1]

    pairs, region_share = np.maximum(by_ring(counted), 1e-12), by_ring(shares)
    mean = np.array([by_ring(counted * rho) for rho in correlation]) / pairs
    noise = mean <= _RING_NOISE / np.sqrt(0.5 * pairs)  # every pair of pixels stands there twice
    noise[:, 0] = False
    weights = np.where(np.logical_or.accumulate(noise, axis=1), 0.0, region_share)
    total, squares, share_sum = (np.sum(weights * part, axis=1) for part in (mean, mean**2, 1.0))
    observed = np.maximum(total, 1.0)
    total = observed / (1.0 - np.minimum(np.maximum(share_sum - observed, 0.0) / n, MAX_REMOVED))
    removed = total / n
    squares = (1.0 - removed) ** 2 * squares + 2.0 * removed * (1.0 - removed) * observed + removed**2 * share_sum
    total, squares = (np.clip(part, 1.0, 0.5 * n) for part in (total, squares))
    # E[s^2] = sigma^2 (1 - total/n) n/(n - 1) of s^2 with divisor n - 1, var(mean) = sigma^2 total/n.
    return np.maximum((n / total - 1.0) * n / (n - 1.0), 1.0), n / squares


def small_sample_factor(independent: npt.ArrayLike) -> Array:
    """(t/1.96)^2, at least 1: widens the variance of a mean so that +-1.96 u is its 95 % interval [1].

    Few independent pixels know neither their spread nor their correlation well.  t is the 97.5 % point of Student's
    t with half of them, less 1, as degrees of freedom, 1 at least; that half is what simulated regions of 8 to 60
    pixels ask for (docs/statistics.md).  Source of the form: JCGM 100:2008 (GUM), G.3.
    """
    return np.asarray(student_factor(np.maximum(0.5 * np.asarray(independent, dtype=float) - 1.0, 1.0)) ** 2)


def mean_error_covariance(covariance: Array, components: PrincipalComponents, independent: Array) -> Array:
    """(B, B) error covariance of a mean: lambda_k / n_k along the leading components.

    The rest has the average 1/n_r of its mixtures; ``independent`` (K + M,) are those of :meth:`Components.scores`.
    D C D / n_r with D = 1 + sum_k (sqrt(n_r/n_k) - 1) v_k v_k^T, which stays a covariance where C is another one
    than that whose components they are.
    """
    k = components.values.size
    n_rest = 1.0 / float(np.mean(1.0 / independent[k:])) if independent.size > k else float(independent[k - 1])
    v = components.vectors
    scaled = v * (np.sqrt(n_rest / independent[:k]) - 1.0)
    scaled_rows = covariance + scaled @ (v.T @ covariance)  # D C, by products of K columns
    return np.asarray((scaled_rows + (scaled_rows @ v) @ scaled.T) / n_rest)


# With fewer the variance of a single band is hardly known, however many bands there are.
MIN_DOF = 10


def factor_covariance(covariance: npt.ArrayLike, n: int) -> tuple[Array, Array, float]:
    """Covariance (B, B) of few factors and independent bands, the factors' part, and the degrees of freedom behind it.

    In units of the bands' standard deviations, eigenvectors of the sample covariance count as factors as long as
    their eigenvalue is above the edge of pure noise of the same total, s^2 (1 + sqrt(B/m))^2 with m = n - 1 less
    the factors already found and s^2 the rest of the trace over B.  Source: Marchenko & Pastur, Math. USSR Sb. 1,
    457-483, 1967, as a rule for the number of factors Johnstone, Ann. Stat. 29, 295-327, 2001.

    Of the factors F a Wishart matrix of n - 1 degrees of freedom is assumed, of the bands D independent variances:
    the sum of the variances of all elements is {tr(F^2) + tr(F)^2 + 2 tr(D^2)}/(n - 1), and the degrees of freedom
    are those of a Wishart matrix with the same.  Where n - 1 is below ten they are that, and all counts as factors.

    Parameters
    ----------
    covariance : (B, B) unbiased sample covariance with positive diagonal
    n : pixels behind it, two or more
    """
    s = np.asarray(covariance, dtype=float)
    sd, m, bands = np.sqrt(np.diag(s)), n - 1, s.shape[0]
    values, vectors = np.linalg.eigh(s / np.outer(sd, sd))
    values, vectors = np.clip(values[::-1], 0.0, None), vectors[:, ::-1]
    counts = np.arange(min(m - 1, bands))
    edges = values[::-1].cumsum()[::-1][counts] / bands * (1.0 + np.sqrt(bands / (m - counts))) ** 2
    count = int(np.append(values[counts] <= edges, True).argmax())
    factors = (vectors[:, :count] * values[:count]) @ vectors[:, :count].T
    # Each fitted factor absorbs part of the bands' independent variance.
    unique = np.clip(1.0 - np.diag(factors), 0.0, None) * (m / (m - count))
    model = factors + np.diag(unique)
    scatter = np.sum(factors**2) + np.trace(factors) ** 2 + 2.0 * np.sum(unique**2)
    dof = m * (np.sum(model**2) + np.trace(model) ** 2) / scatter
    factors, dof = (factors, dof) if m >= MIN_DOF else (model, m)
    return model * np.outer(sd, sd), factors * np.outer(sd, sd), float(dof)


# A texture of less than this part of the noise's variance has no factor of its own.
_MIN_TEXTURE = 1e-6


def noise_part(
    measured: npt.ArrayLike,
    expected: npt.ArrayLike,
    noise: npt.ArrayLike,
    dof: npt.ArrayLike,
    kurtosis: float = 0.0,
    *,
    calibration: npt.ArrayLike = 0.0,
    samples: int = 2,
    errors: Array | None = None,
) -> tuple[float, float]:
    """Factor a on the noise in S = a N + g T and its standard uncertainty [1].

    By quadratic estimation of variance components.

    With W = Sigma^-1, Sigma = N + T, the two traces tr(W N W S) and tr(W T W S) are equated to what they are
    expected to be (MINQUE: Rao, J. Multivariate Anal. 1, 257-275, 1971).  That is right on average whatever a and g
    are, and for normal pixels and a = g = 1 no estimate that is linear in S has less variance.  The texture's
    factor is free, so that an error in the spread of the class is not taken for one of the noise.

    Parameters
    ----------
    measured : (B, B) S, sample covariance
    expected : (B, B) Sigma, of the model, noise included
    noise : (B,) variances that N has on its diagonal
    dof : degrees of freedom behind S, or (P,) along the eigenvectors of Sigma, the greatest first: noise is independent
        from pixel to pixel where the texture is not, and of S_jk they are the geometric mean of both, or more
    kurtosis : kappa of the texture's law (:func:`hyperval.pixels.kurtosis_parameter`); noise is normal
    calibration : (B,) part of the noise that the detector elements' own errors of calibration make: all pixels of a
        column share them, so that it is known by as many as there are columns
    samples : columns of the image
    errors : (2, K, B) of the model (:class:`hyperval.products.SpectralEstimate`)

    Examples
    --------
    >>> noise, texture = np.array([1.0, 2.0, 1.0]), np.full((3, 3), 4.0)
    >>> factor, uncertainty = noise_part(1.21 * np.diag(noise) + 0.9 * texture, np.diag(noise) + texture, noise, 1000.0)
    >>> round(factor, 12), round(uncertainty, 3)
    (1.21, 0.038)
    """
    s, sigma, n = (np.asarray(x, dtype=float) for x in (measured, expected, noise))
    texture = sigma - np.diag(n)
    parts = [np.diag(n), texture] if np.trace(texture) > _MIN_TEXTURE * n.sum() else [np.diag(n)]
    w = np.linalg.pinv(sigma, hermitian=True)
    whitened = [w @ part @ w for part in parts]
    expectation = np.array([[np.sum(m * part) for part in parts] for m in whitened])
    inverse = np.linalg.pinv(expectation)
    factors = inverse @ [np.sum(m * s) for m in whitened]
    vectors, dofs = EigenDirections.from_covariance(sigma).vectors, np.atleast_1d(dof).astype(float)
    root = (vectors * dofs[np.minimum(np.arange(vectors.shape[1]), dofs.size - 1)] ** -0.25) @ vectors.T
    fitted = [root @ (max(float(f), 0.0) * part) @ root for f, part in zip(factors, parts, strict=True)]
    # Muirhead 1982, 1.6: cov(S_ij, S_kl) of normal pixels, and what an elliptical law of the texture adds.
    total, elliptical = ([m @ part for m in whitened] for part in (sum(fitted), sum(fitted[1:], np.zeros_like(sigma))))
    traces = np.array([np.trace(x) for x in elliptical])
    normal, tails = (2.0 * np.array([[np.sum(x * y.T) for y in terms] for x in terms]) for terms in (total, elliptical))
    covariance = normal + kurtosis * (tails + np.outer(traces, traces))
    variance = (inverse @ covariance @ inverse.T)[0, 0]
    weights = np.tensordot(inverse[0], whitened, 1)
    columns = 2.0 / (samples - 1.0) * np.sum((np.diag(weights) * calibration) ** 2)
    if errors is not None:  # to second order in the scale: much texture that is off a little looks like noise
        first = errors[0] @ (2.0 * np.sum(weights * sigma, axis=1)) + errors[1] @ np.diag(weights)
        second = errors[0] @ (weights * sigma) @ errors[0].T
        variance += first @ first + np.trace(second) ** 2 + 2.0 * np.sum(second**2)
    return float(factors[0]), float(np.sqrt(variance + columns))


# With m draws the r-th least and r-th greatest, r = 0.025 (m + 1), bound a further draw with probability 0.95,
# exactly.  Draws of one seed are the same in every campaign, and so is the error of their ranks: 1,999 leave 0.06
# standard deviations of it, 119 would 0.25.
DRAWS = 1999
MIN_DRAWS = 119
_MAX_WORK = 5e8  # draws times directions cubed; beyond it there are fewer draws
_DISTANCE_DRAWS = 399  # whose mean and spread are used
_BLOCK = 500_000  # numbers of roots that are drawn together
_MIN_SHIFT = 0.05  # standard deviations of an eigenvalue by which directions that are not drawn would move it
# Directions with less than this part of the greatest eigenvalue are rounding error.
MIN_PART = 1e-12
# Fewer independent pixels for each direction than this: the determinant of the sample says little.
PIXELS_PER_DIRECTION = 3.0


@dataclass(frozen=True)
class EigenDirections:
    """Eigenvectors (B, P) and eigenvalues (P,) of a covariance, largest first, above rounding error."""

    vectors: Array
    values: Array

    @classmethod
    def from_covariance(cls, covariance: npt.ArrayLike) -> EigenDirections:
        """Eigenvectors of a symmetric (B, B) with some variance."""
        values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float))
        values, vectors = values[::-1], vectors[:, ::-1]
        keep = values > MIN_PART * max(float(values[0]), 0.0)
        return cls(np.ascontiguousarray(vectors[:, keep]), values[keep])

    def whitened_factor(self, covariance: npt.ArrayLike) -> Array:
        """F (P, m) with F F^T another covariance (B, B) in these directions, the identity where it is the same."""
        other = EigenDirections.from_covariance(covariance)
        return np.asarray((self.vectors / np.sqrt(self.values)).T @ (other.vectors * np.sqrt(other.values)))


class CovarianceStatistics(NamedTuple):
    """Statistics of a covariance S compared with those of Sigma, the predicted; for draws with a leading axis of draws.

    Attributes
    ----------
    eigenvalues : (K,) leading eigenvalues of S
    total : trace of S
    angles_deg : (A,) largest principal angle of the first eigenvectors of Sigma and S, in spaces of growing size
    """

    eigenvalues: Array
    total: Array
    angles_deg: Array


def covariance_statistics(
    directions: EigenDirections, factor: Array, count: int, spaces: tuple[int, ...]
) -> CovarianceStatistics:
    """The statistics of S = V D^1/2 F F^T D^1/2 V^T with F (P, m) in the predicted ``directions``.

    ``count`` leading eigenvalues, and the angles of ``spaces``, by the Gram matrix (m, m) of D^1/2 F.
    """
    scaled = np.sqrt(directions.values)[:, None] * factor
    eigenvalues, angles = _eigen_angles(scaled.T @ scaled, scaled[: max(spaces, default=0)], count, spaces, 0.0)
    return CovarianceStatistics(eigenvalues, np.asarray(np.sum(scaled**2)), angles)


def _eigen_angles(gram: Array, rows: Array, count: int, spaces: tuple[int, ...], tail: float) -> tuple[Array, Array]:
    """(..., K) eigenvalues and (..., A) angles [deg] of S = F F^T by F^T F (..., m, m) and the ``rows`` (..., k, m) of
    F along the leading predicted directions; ``tail`` is added to every eigenvalue.
    """
    # Without angles no vectors are needed.
    rising, vectors = np.linalg.eigh(gram) if spaces else (np.linalg.eigvalsh(gram), gram)
    values, size = np.asarray(rising[..., ::-1][..., :count]) + tail, rows.shape[-2]
    overlap = rows @ vectors[..., ::-1][..., :size] / np.sqrt(np.maximum(values[..., None, :size], 1e-300))
    return values, principal_angles_deg(overlap, spaces)


def covariance_distance(whitened: npt.ArrayLike) -> float:
    """Covariance part of the Bhattacharyya distance from W = Sigma^-1/2 S Sigma^-1/2 (P, P).

    (1/2) ln(|(Sigma + S)/2| / sqrt(|Sigma| |S|)) = (1/2) sum ln((1 + w)/(2 sqrt(w))), w the eigenvalues of W
    (Fukunaga 1990, section 3.4).  The determinants are those of Cholesky factors.
    """
    w = np.asarray(whitened, dtype=float)
    try:
        half_sum, root = (np.diag(np.linalg.cholesky(m)) for m in (np.eye(len(w)) + w, w))
    except np.linalg.LinAlgError:
        return float("inf")
    return float(np.sum(np.log(half_sum) - 0.5 * np.log(root)) - 0.5 * len(w) * np.log(2.0))


def principal_angles_deg(overlap: npt.ArrayLike, spaces: tuple[int, ...]) -> Array:
    """(..., S) largest principal angle [deg] between the spaces of the first k of two orthonormal bases, by k.

    Its cosine is the least singular value of the bases' overlap A^T B, here (..., K, K) (Bjorck & Golub 1973).
    """
    m = np.asarray(overlap, dtype=float)
    cosines = [np.linalg.svd(m[..., :k, :k], compute_uv=False)[..., -1] for k in spaces]
    return np.degrees(np.arccos(np.minimum(np.reshape(cosines, (len(spaces), *m.shape[:-2])), 1.0))).T


def kurtosis_parameter(tail_dof: float) -> float:
    """kappa of an elliptical law: 2/(nu - 4) of a multivariate t, 0 of the normal; inf up to nu = 4.

    Source: Muirhead, Aspects of Multivariate Statistical Theory, 1982, section 1.6.
    """
    return 2.0 / (tail_dof - 4.0) if tail_dof > 4.0 else float("inf")


def band_limits(drawn: Array) -> tuple[Array, Array]:
    """Limits that a further draw lies between with probability 0.95.

    >>> tuple(float(end) for end in band_limits(np.arange(119.0) + 1.0))  # below 3 of 120 places, or above: 6/120
    (3.0, 117.0)
    """
    ordered, rank = np.sort(drawn, axis=0), round(0.025 * (len(drawn) + 1))
    return ordered[rank - 1], ordered[-rank]


def _perturbed_draws(
    directions: EigenDirections, errors: Array, draws: int, n: Array, kurtosis: float, rng: np.random.Generator
) -> Iterator[tuple[Array, Array]]:
    """Blocks of roots (n or 1, B, P) of drawn covariances e^r (Sigma + diag q) e^r, to first order in q, with factors.

    ``errors`` (2, K, B) : what r and q are by a standard normal number along each direction; ``n`` (P,) degrees of
    freedom
    """
    vectors, sd, of_errors = directions.vectors, np.sqrt(directions.values), rng.spawn(1)[0]
    most = max(_BLOCK // vectors.size, 1)
    for count in (min(most, draws - start) for start in range(0, draws, most)):
        r, q = of_errors.standard_normal((count if errors.size else 1, errors.shape[1])) @ errors
        roots = np.exp(r)[..., None] * (vectors * sd + q[..., None] * (vectors / (2.0 * sd)))
        yield roots, drawn_factors(count, n, rng, kurtosis)


def sampling_band(
    directions: EigenDirections,
    independent: npt.ArrayLike,
    count: int,
    spaces: tuple[int, ...],
    rng: np.random.Generator,
    *,
    kurtosis: float = 0.0,
    draws: int = DRAWS,
    errors: Array | None = None,
) -> CovarianceStatistics:
    """Sampling distributions of the statistics under the predicted covariance; each statistic by draws of its own.

    The trace is drawn as a sum of chi-squares.  Eigenvalues and angles are those of the leading directions, to
    which the others add their mean, lambda_j/n_j each, and to second order lambda_j^2/(n lambda_K): as many are
    drawn as keep that below a twentieth of a standard deviation.

    Parameters
    ----------
    independent : degrees of freedom, one number or (P,) by direction
    count : leading eigenvalues K
    spaces : the k of the principal angles
    draws : at most; fewer where many directions are drawn
    errors : (2, K, B) of the prediction (:class:`hyperval.products.SpectralEstimate`), of which each sample has a draw

    Examples
    --------
    The total of 30 equal variances known from 400 pixels has the standard deviation sqrt(2/(30 * 400)):

    >>> flat = EigenDirections(np.eye(30), np.ones(30))
    >>> band = sampling_band(flat, 400.0, 2, (1,), np.random.default_rng(1))
    >>> [round(float((x - 30.0) / 30.0 / np.sqrt(2.0 / 12000.0)), 1) for x in band_limits(band.total)]
    [-2.1, 1.9]

    A leading eigenvalue that stands alone has sqrt(2/n), however few directions are drawn:

    >>> falling = EigenDirections(np.eye(30), 4.0 ** -np.arange(30.0))
    >>> ends = band_limits(sampling_band(falling, 2000.0, 1, (1,), np.random.default_rng(1)).eigenvalues[:, 0])
    >>> [round(float((x - 1.0) / np.sqrt(2.0 / 2000.0)), 1) for x in ends]
    [-1.9, 2.0]

    A variance of 4 whose prediction is off by 0.4 has a tenth more for its standard deviation, whatever the pixels:

    >>> one, errors = EigenDirections(np.eye(1), np.array([4.0])), np.array([[[0.0]], [[0.4]]])
    >>> drawn = sampling_band(one, 1e9, 1, (), np.random.default_rng(1), draws=4000, errors=errors)
    >>> [round(float(np.std(x) / 4.0), 2) for x in (drawn.total, drawn.eigenvalues)]
    [0.1, 0.1]
    """
    values, size = directions.values, directions.values.size
    n = np.broadcast_to(np.asarray(independent, dtype=float), (size,))
    dof = n / (1.0 + kurtosis)
    tail_squares = np.append(np.cumsum(values[::-1] ** 2)[::-1], 0.0)
    negligible = tail_squares <= _MIN_SHIFT * values[count - 1] ** 2 * np.sqrt(2.0 * dof.min())
    drawn_size = max(int(negligible.argmax()), count)
    affordable = round(0.025 * _MAX_WORK / drawn_size**3) * 40 - 1
    draws = min(draws, max(affordable, MIN_DRAWS))
    leading, trace, parts = EigenDirections(directions.vectors[:, :drawn_size], values[:drawn_size]), [], []
    if errors is None or not errors.size:  # along the directions themselves
        leading, errors = replace(leading, vectors=np.eye(drawn_size)), np.zeros((2, 0, drawn_size))
    rows = leading.vectors[:, : max(spaces, default=0)].T
    tail = float(np.sum(values[drawn_size:] / dof[drawn_size:]))
    with single_blas_thread():
        for roots, block in _perturbed_draws(leading, errors, draws, n[:drawn_size], kurtosis, rng):
            drawn = roots @ np.pad(block, [(0, 0), (0, 0), (0, max(count - block.shape[-1], 0))])
            parts.append(_eigen_angles(np.swapaxes(drawn, -1, -2) @ drawn, rows @ drawn, count, spaces, tail))
            trace.append(np.full(len(block), np.sum(roots**2, axis=(1, 2)) / leading.values.sum()))
    eigenvalues, angles = (np.concatenate(part) for part in zip(*parts, strict=True))
    scale_factor = np.exp(rng.normal(0.0, np.sqrt(kurtosis / n.min()), draws))
    total = np.concatenate(trace) * scale_factor * ((rng.chisquare(dof, (draws, size)) / dof) @ values)
    return CovarianceStatistics(eigenvalues, total, angles)


def distance_band(
    directions: EigenDirections, independent: Array, rng: np.random.Generator, kurtosis: float, errors: Array
) -> tuple[float, float, float]:
    """The mean of :func:`covariance_distance` of samples by chance alone, and the 95 % limits of a draw.

    Limits are those of a chi-square with the mean and the variance of 399 draws, which the sum of (w - 1)^2/16 over
    all pairs of directions is in many pixels.

    ``errors`` : (2, K, B) of the prediction, which limits have besides
    """
    whiten = (directions.vectors / np.sqrt(directions.values)).T
    chance, perturbed = [], []
    with single_blas_thread():
        for roots, block in _perturbed_draws(directions, errors, _DISTANCE_DRAWS, independent, kurtosis, rng):
            chance += [covariance_distance(f @ f.T) for f in block]
            perturbed += [covariance_distance(f @ f.T) for f in whiten @ roots @ block] if errors.size else []
    distances = np.array(perturbed or chance)
    mean, shape = float(distances.mean()), float(distances.mean() ** 2 / distances.var())
    low, high = mean / shape * special.gammaincinv(shape, [0.025, 0.975])
    return float(np.mean(chance)), float(low), float(high)


def is_full_rank(independent: npt.ArrayLike, size: int) -> bool:
    """Whether the sample is large enough for its determinant to be compared."""
    return bool(np.min(independent) >= PIXELS_PER_DIRECTION * size)
