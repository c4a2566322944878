"""Sums of pixels and of their products about a reference, in batches.

Pixels are columns of arrays (B, N) of stored numbers.  They are taken about a point near them, a whole number where
the stored numbers are whole: the differences and, in float64, their products are then exact, and so is their sum
while it stays below 2^53.

In single precision the products are not those of z itself.  A few directions, the brightest of a first
estimate, hold nearly all of the variance; rounding is relative to them and would drown the quiet directions that
a detector works in.  So z is split into its coordinates y = P^T z along those directions and the rest
z - P y, and the products of the two side by side are summed: each is rounded relative to its own size.  Any y near
those coordinates will do, since z = (z - P y) + P y; where some bands tell them well, only those are asked.

A sum in single precision forgets what is small beside its greatest term.  A batch whose squares are far above those
of a typical pixel holds outliers that would swallow the others: its products are made again in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.passes import Workspace, as_columns, by_pixel

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# The coordinates come from every third band, unless that would magnify noise more than twice as much as it must.
EVERY = 3
CHI_SQUARED_MEDIAN = 0.4549
LEAST_SHARE = 0.5
# A batch whose mean squares are so many times those of a typical pixel is summed in float64.
MOST_OF_TYPICAL = 256.0
# Pixels are taken about the mean of at least so many of the first batch.
CENTRED_ON = 64


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions that are taken apart in single precision.

    Attributes
    ----------
    basis : (B, K) orthonormal directions P
    every : the coordinates are told from one band in so many
    forward : (K + 1, ceil(B / every)) coordinates from those bands; a last row of zeros, since eight rows are
        multiplied faster than seven
    typical : (B + K,) mean squares of the rest and the coordinates of a typical pixel; None where nothing is known
    """

    basis: npt.NDArray[np.float32]
    every: int
    forward: npt.NDArray[np.float32]
    typical: Array | None = None

    @classmethod
    def of(cls, basis: Array, sample: Array | None = None) -> Directions:
        """The least-squares coordinates of some bands, or P^T where they would magnify noise.

        Parameters
        ----------
        sample : (B, N) pixels about their centre, of which half or more are typical
        """
        some, every = basis[::EVERY], EVERY
        # P^T P = 1, so that the same share of every direction would be left in a third of the bands.
        if some.shape[0] < some.shape[1] or np.linalg.svd(some)[1][-1] < LEAST_SHARE / np.sqrt(EVERY):
            some, every = basis, 1
        forward = np.pad(np.linalg.pinv(some), ((0, 1), (0, 0)))
        made = cls(np.ascontiguousarray(basis, np.float32), every, np.ascontiguousarray(forward, np.float32))
        if sample is None or sample.shape[1] == 0:
            return made
        y = forward[:-1] @ sample[::every]
        # The median of the squares: a few pixels far out say nothing of the typical one.
        squares = np.median(np.concatenate([sample - basis @ y, y]) ** 2, axis=1) / CHI_SQUARED_MEDIAN
        return replace(made, typical=squares)

    @property
    def rows(self) -> int:
        """B + K + 1: the rest, the coordinates and the weight of a pixel."""
        return sum(self.basis.shape) + 1

    def split(self, pixels: npt.NDArray[Any], out: npt.NDArray[Any]) -> None:
        """Put the rest z - P y and the coordinates y of each column z (B, N) into ``out`` (B + K + 1, N).

        The last row is left undefined.
        """
        bands = pixels.shape[0]
        rest, y = out[:bands], out[bands:-1]
        if not pixels.flags.c_contiguous:  # stored by pixel: the same with lines for columns
            np.matmul(pixels.T, self.basis, out=y.T)
            np.matmul(y.T, self.basis.T, out=rest.T)
        else:
            np.matmul(self.forward, pixels[:: self.every], out=out[bands:])
            np.matmul(self.basis, y, out=rest)
        np.subtract(pixels, rest, out=rest)


@dataclass
class Sums:
    """Sums over one set of pixels.

    Attributes
    ----------
    bands : B
    whole : the stored numbers are whole
    directions : of the split; with None the products are summed in float64
    reference : (B,) point that the sums are about, near the pixels: the mean of some of the first batch, so that
        a set of equal pixels has no variance, not even one of rounding
    n : pixels
    first : (B,) sum of x - reference, without what ``split`` holds
    second : (B, B) sum of products about the reference, without what ``split`` holds; None where that is all
    split : (B + K + 1, B + K + 1) sum of products of (z - P y, y, 1), with directions
    n_split : pixels in ``split``
    above_typical : how far the mean squares of a batch in ``split`` are above those of a typical pixel, at most
    """

    bands: int
    whole: bool
    directions: Directions | None = None
    reference: Array | None = None
    n: int = 0
    n_split: int = 0
    above_typical: float = 0.0
    first: Array = field(init=False)
    second: Array | None = None
    split: Array = field(init=False)
    _product: npt.NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 0), np.float32), repr=False)

    def __post_init__(self) -> None:
        bands = self.bands
        both = 0 if self.directions is None else self.directions.rows
        self.first, self.split = np.zeros(bands), np.zeros((both, both))

    def add(self, stored: npt.NDArray[Any], keep: Mask | None = None, space: Workspace | None = None) -> None:
        """Add stored numbers (B, lines, samples), whose content is lost.

        ``keep`` (lines, samples) says which pixels count, all with None; ``space`` is used for the arrays.
        """
        count = stored[0].size if keep is None else int(np.count_nonzero(keep))
        if count == 0:
            return
        if self.reference is None:
            self.reference = self._near(stored, keep, count)
        self.n += count
        space = space or Workspace()
        pixels = self._about_reference(stored, space)
        if keep is not None:
            pixels[:, ~keep] = 0
        columns = as_columns(pixels)
        # NumPy makes the product of an array and its transpose a symmetric rank-k update: half the work.
        if self.directions is None:
            self._add_exactly(columns)
        else:
            both = as_columns(space.columns("both", stored, self.directions.rows, np.float32))
            self.directions.split(columns, both)
            both[-1] = 1.0 if keep is None else keep.ravel()
            if self._product.shape != self.split.shape:
                self._product = np.empty(self.split.shape, np.float32)
            with np.errstate(over="ignore", invalid="ignore"):
                np.matmul(both, both.T, out=self._product)
            above = self._above_typical(count)
            if above <= MOST_OF_TYPICAL:
                self.split += self._product
                self.n_split += count
                self.above_typical = max(self.above_typical, above)
            else:
                self._add_exactly(as_columns(self._in_double(stored, pixels, keep)))

    def _above_typical(self, count: int) -> float:
        """How far the mean squares of a batch of ``count`` pixels are above those of a typical pixel, at most."""
        assert self.directions is not None  # noqa: S101 - asked of single precision alone
        squares = np.diagonal(self._product)[:-1].astype(np.float64) / count
        if not np.all(np.isfinite(squares)):
            return float("inf")
        typical = self.directions.typical
        if typical is None:
            return 1.0
        with np.errstate(over="ignore"):  # beside a constant scene anything stands out without bound
            return float(np.max(squares / np.maximum(typical, np.finfo(float).tiny)))

    def _in_double(self, stored: npt.NDArray[Any], pixels: npt.NDArray[Any], keep: Mask | None) -> Array:
        """The differences from the reference: those of whole numbers are exact already."""
        if self.whole:
            return pixels.astype(np.float64)
        assert self.reference is not None  # noqa: S101 - add has set it
        exact = stored.astype(np.float64) - self.reference[:, None, None]
        if keep is not None:
            exact[:, ~keep] = 0.0
        return np.asarray(exact)

    def _add_exactly(self, columns: Array) -> None:
        self._add_products(columns @ columns.T)
        self.first += columns @ np.ones(columns.shape[1])

    def _near(self, stored: npt.NDArray[Any], keep: Mask | None, count: int) -> Array:
        """A point (B,) near the pixels, exact in the type that it is subtracted in."""
        lines, samples = np.nonzero(np.ones(stored.shape[1:], bool) if keep is None else keep)
        some = slice(None, None, max(1, count // CENTRED_ON))
        centre = stored[:, lines[some], samples[some]].mean(axis=1, dtype=np.float64)
        if self.whole:
            return np.asarray(np.rint(centre))
        return np.asarray(centre if self.directions is None else centre.astype(np.float32).astype(np.float64))

    def _about_reference(self, stored: npt.NDArray[Any], space: Workspace) -> npt.NDArray[Any]:
        """(B, lines, samples) differences from the reference."""
        assert self.reference is not None  # noqa: S101 - add has set it
        reference = self.reference[:, None, None]
        pixels = space.columns("pixels", stored, self.bands, np.float64 if self.directions is None else np.float32)
        if stored.dtype == np.int16 and _differences_fit(stored, self.reference):
            # In 16 bits, which halves the bytes; a row as long as those of the numbers is subtracted faster.
            row = np.broadcast_to(reference.astype(np.int16), (self.bands, 1, stored.shape[2]))
            stored -= row if by_pixel(stored) else np.ascontiguousarray(row)
            np.copyto(pixels, stored)
        else:
            np.copyto(pixels, stored, casting="same_kind")
            pixels -= reference.astype(pixels.dtype)
        return pixels

    @property
    def total(self) -> Array:
        """(B,) sum of x - reference."""
        if self.directions is None:
            return self.first
        return self.first + self.split[-1, : self.bands] + self.directions.basis @ self.split[-1, self.bands : -1]

    def merge(self, other: Sums) -> None:
        """Add the sums of another set of pixels."""
        if other.reference is None:
            return
        if self.reference is None:
            self.reference = other.reference
        e = other.reference - self.reference
        if e.any():
            half = other.total + 0.5 * other.n * e
            self._add_products(np.column_stack([e, half]) @ np.stack([half, e]))  # and its transpose
        self.n += other.n
        self.n_split += other.n_split
        self.above_typical = max(self.above_typical, other.above_typical)
        self.first += other.first + other.n * e
        self.split += other.split
        if other.second is not None:
            self._add_products(other.second)

    def _add_products(self, products: Array) -> None:
        if self.second is None:
            self.second = products.copy()
        else:
            self.second += products

    def mean_and_covariance(self) -> tuple[Array, Array]:
        """Mean (B,) and unbiased covariance (B, B) of the pixels, n >= 2."""
        if self.reference is None or self.n < 2:
            raise UsageError(f"{self.n} pixels have no covariance", expected="two or more")
        # First to a whole number c beside the mean, which is exact for whole numbers, then the rest of the way.
        first = self.total
        c = np.rint(first / self.n)
        mixed = np.outer(c, first - 0.5 * self.n * c)
        e = (first - self.n * c) / self.n
        central = -(mixed + mixed.T)
        if self.second is not None:
            central += self.second
        central -= self.n * np.outer(e, e)
        if self.directions is not None:
            # z = (z - P y) + P y, first on one side and then on the other
            basis, b = self.directions.basis.astype(np.float64), self.bands
            half = self.split[:b, :-1] + basis @ self.split[b:-1, :-1]
            central += half[:, :b] + half[:, b:] @ basis.T
        covariance = central / (self.n - 1)
        return self.reference + c + e, (covariance + covariance.T) / 2.0


def _differences_fit(stored: npt.NDArray[Any], reference: Array) -> bool:
    """Whether numbers of 16 bits less a reference need no more than 16."""
    least, most = reference.min(), reference.max()
    return bool(
        (most <= 0 or int(stored.min()) - most >= -(1 << 15))
        and (least >= 0 or int(stored.max()) - least < 1 << 15)
    )
