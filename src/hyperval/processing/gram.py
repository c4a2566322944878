"""Sums of pixels and of their products about a reference, in batches.

Pixels are columns of arrays (B, N) of stored numbers.  They are taken about a point near them, a whole number where
the stored numbers are whole: the differences and, in float64, their products are then exact, and so is their sum
while it stays below 2^53.

In single precision the products are not those of z itself.  A few directions, the brightest of a first
estimate, hold nearly all of the variance; rounding is relative to them and would drown the quiet directions that
a detector works in.  So z is split into its coordinates y = P^T z along those directions and the rest
z - P y, and the products of the two side by side are summed: each is rounded relative to its own size.  Any y near
those coordinates will do, since z = (z - P y) + P y; where some bands tell them well, only those are asked.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# The coordinates come from every third band, unless that would magnify noise more than twice as much as it must.
EVERY = 3
LEAST_SHARE = 0.5
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
    """

    basis: npt.NDArray[np.float32]
    every: int
    forward: npt.NDArray[np.float32]

    @classmethod
    def of(cls, basis: Array) -> Directions:
        """The least-squares coordinates of some bands, or P^T where they would magnify noise."""
        some, every = basis[::EVERY], EVERY
        # P^T P = 1, so that the same share of every direction would be left in a third of the bands.
        if some.shape[0] < some.shape[1] or np.linalg.svd(some)[1][-1] < LEAST_SHARE / np.sqrt(EVERY):
            some, every = basis, 1
        forward = np.pad(np.linalg.pinv(some), ((0, 1), (0, 0)))
        return cls(np.ascontiguousarray(basis, np.float32), every, np.ascontiguousarray(forward, np.float32))

    @property
    def rows(self) -> int:
        """B + K + 1: the rest, the coordinates and the weight of a pixel."""
        return sum(self.basis.shape) + 1


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
    first : (B,) sum of x - reference
    second : (B, B) sum of products about the reference, without what ``split`` holds
    split : (B + K + 1, B + K + 1) sum of products of (z - P y, y, 1), with directions
    """

    bands: int
    whole: bool
    directions: Directions | None = None
    reference: Array | None = None
    n: int = 0
    first: Array = field(init=False)
    second: Array = field(init=False)
    split: Array = field(init=False)
    _product: npt.NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 0), np.float32), repr=False)

    def __post_init__(self) -> None:
        bands = self.bands
        both = 0 if self.directions is None else self.directions.rows
        self.first, self.second, self.split = np.zeros(bands), np.zeros((bands, bands)), np.zeros((both, both))

    def add(self, pixels: npt.NDArray[Any], keep: Mask | None = None, work: npt.NDArray[Any] | None = None) -> None:
        """Add a batch (B, N), float32 with directions else float64; its content is lost.

        ``keep`` (N,) says which columns count; the others must be finite.  ``work`` (B + K + 1, N), used with
        directions, has the order of memory of ``pixels``.
        """
        weight = np.ones(pixels.shape[1], pixels.dtype) if keep is None else keep.astype(pixels.dtype)
        count = pixels.shape[1] if keep is None else int(np.count_nonzero(keep))
        if count == 0:
            return
        if self.reference is None:
            step = max(1, count // CENTRED_ON)
            some = slice(None, None, step) if keep is None else np.flatnonzero(keep)[::step]
            centre = pixels[:, some].mean(axis=1)
            # In the type of the pixels, so that what is subtracted is what is recorded.
            self.reference = (np.rint(centre) if self.whole else centre).astype(np.float64)
        pixels -= self.reference.astype(pixels.dtype)[:, None]
        if count < pixels.shape[1]:
            pixels[:, weight == 0] = 0
        self.n += count
        # NumPy makes the product of an array and its transpose a symmetric rank-k update: half the work.
        if self.directions is None:
            self.second += pixels @ pixels.T
            self.first += pixels @ weight
        else:
            bands, last = self.bands, self.split.shape[0] - 1
            both = _split(pixels, self.directions, weight, work)
            if self._product.shape != self.split.shape:
                self._product = np.empty(self.split.shape, np.float32)
            np.matmul(both, both.T, out=self._product)
            self.split += self._product
            sums = self._product[last].astype(np.float64)
            self.first += sums[:bands] + self.directions.basis @ sums[bands:last]

    def merge(self, other: Sums) -> None:
        """Add the sums of another set of pixels."""
        if other.reference is None:
            return
        if self.reference is None:
            self.reference = other.reference
        e = other.reference - self.reference
        mixed = np.outer(e, other.first + 0.5 * other.n * e)
        self.n += other.n
        self.first += other.first + other.n * e
        self.second += other.second + (mixed + mixed.T)
        self.split += other.split

    def mean_and_covariance(self) -> tuple[Array, Array]:
        """Mean (B,) and unbiased covariance (B, B) of the pixels, n >= 2."""
        if self.reference is None or self.n < 2:
            raise UsageError(f"{self.n} pixels have no covariance", expected="two or more")
        # First to a whole number c beside the mean, which is exact for whole numbers, then the rest of the way.
        c = np.rint(self.first / self.n)
        mixed = np.outer(c, self.first - 0.5 * self.n * c)
        e = (self.first - self.n * c) / self.n
        central = self.second - (mixed + mixed.T) - self.n * np.outer(e, e)
        if self.directions is not None:
            back = np.hstack([np.eye(e.size), self.directions.basis.astype(np.float64)])  # z = (z - P y) + P y
            central += back @ self.split[:-1, :-1] @ back.T
        covariance = central / (self.n - 1)
        return self.reference + c + e, (covariance + covariance.T) / 2.0


def _split(
    pixels: npt.NDArray[Any],
    directions: Directions,
    weight: npt.NDArray[Any],
    work: npt.NDArray[Any] | None,
) -> npt.NDArray[Any]:
    """(B + K + 1, N): the rest z - P y, the coordinates y of each column z, and its weight."""
    basis, bands = directions.basis, pixels.shape[0]
    if not pixels.flags.c_contiguous:  # stored by pixel: the same with lines for columns
        both = np.empty((pixels.shape[1], directions.rows), np.float32) if work is None else work.T
        np.matmul(pixels.T, basis, out=both[:, bands:-1])
        np.matmul(both[:, bands:-1], basis.T, out=both[:, :bands])
        np.subtract(pixels.T, both[:, :bands], out=both[:, :bands])
        both[:, -1] = weight
        return both.T
    both = np.empty((directions.rows, pixels.shape[1]), np.float32) if work is None else work
    np.matmul(directions.forward, pixels[:: directions.every], out=both[bands:])
    np.matmul(basis, both[bands:-1], out=both[:bands])
    np.subtract(pixels, both[:bands], out=both[:bands])
    both[-1] = weight
    return both
