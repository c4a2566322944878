"""Sums of pixels and of their products about a reference, in batches.

Pixels are columns of arrays (B, N) of stored numbers.  Each batch is taken about a mean of its own, rounded to a
whole number where the stored numbers are whole: the differences and, in float64, their products are then
exact, and so is their sum while it stays below 2^53.

In single precision the products are not those of z itself.  A few directions, the brightest of a first
estimate, hold nearly all of the variance; rounding is relative to them and would drown the quiet directions that
a detector works in.  So z is split into its coordinates y = P^T z along those directions and the rest
z - P y, and the products of the two side by side are summed: each is rounded relative to its own size.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# A batch is taken about the mean of at least so many of its pixels.
CENTRED_ON = 64


@dataclass
class Sums:
    """Sums over one set of pixels.

    Attributes
    ----------
    bands : B
    whole : the stored numbers are whole
    basis : (B, K) float32 directions P of the split; with None the products are summed in float64
    reference : (B,) point that the sums are about: the mean of the first batch, so that a set of equal pixels
        has no variance, not even one of rounding
    n : pixels
    first : (B,) sum of x - reference
    second : (B, B) sum of products about the reference, without what ``split`` holds
    split : (B + K + 1, B + K + 1) sum of products of (z - P y, y, 1), with a basis
    """

    bands: int
    whole: bool
    basis: npt.NDArray[np.float32] | None = None
    reference: Array | None = None
    n: int = 0
    first: Array = field(init=False)
    second: Array = field(init=False)
    split: Array = field(init=False)
    _batches: list[tuple[int, Array, Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        bands = self.bands
        both = 0 if self.basis is None else sum(self.basis.shape) + 1
        self.first, self.second, self.split = np.zeros(bands), np.zeros((bands, bands)), np.zeros((both, both))

    def add(self, pixels: npt.NDArray[Any], keep: Mask | None = None, work: npt.NDArray[Any] | None = None) -> None:
        """Add a batch (B, N), float32 with a basis else float64; its content is lost.

        ``keep`` (N,) says which columns count; the others must be finite.  ``work`` (B + K + 1, N), used with a
        basis, has the order of memory of ``pixels``.
        """
        weight = np.ones(pixels.shape[1], pixels.dtype) if keep is None else keep.astype(pixels.dtype)
        count = pixels.shape[1] if keep is None else int(np.count_nonzero(keep))
        if count == 0:
            return
        # Any point near the pixels will do, since what is left of their sum is taken into account.
        step = max(1, count // CENTRED_ON)
        some = slice(None, None, step) if keep is None else np.flatnonzero(keep)[::step]
        centre = pixels[:, some].mean(axis=1)
        if self.whole:
            np.rint(centre, out=centre)
        pixels -= centre[:, None]
        if count < pixels.shape[1]:
            pixels[:, weight == 0] = 0
        # NumPy makes the product of an array and its transpose a symmetric rank-k update: half the work.
        if self.basis is None:
            self.second += pixels @ pixels.T
            rest = pixels @ weight
        else:
            bands, last = self.bands, self.split.shape[0] - 1
            both = _split(pixels, self.basis, weight, work)
            product = both @ both.T
            self.split += product
            sums = product[last].astype(np.float64)
            rest = sums[:bands] + self.basis @ sums[bands:last]
        self._batches.append((count, centre.astype(np.float64), rest.astype(np.float64)))

    def settle(self) -> None:
        """Move what was summed about the means of the batches to the reference.

        With e_k the mean of batch k less the reference, r_k the sum of its z and n_k its pixels,
        sum (z + e)(z + e)^T = sum z z^T + sum_k (e_k r_k^T + r_k e_k^T + n_k e_k e_k^T).
        """
        if not self._batches:
            return
        n = np.array([count for count, _, _ in self._batches], dtype=float)
        centre, r = (np.stack([batch[i] for batch in self._batches]) for i in (1, 2))
        if self.reference is None:
            self.reference = centre[0].copy()
        e = centre - self.reference
        self.n += int(n.sum())
        self.first += r.sum(axis=0) + n @ e
        mixed = e.T @ (r + 0.5 * n[:, None] * e)
        self.second += mixed + mixed.T
        self._batches.clear()

    def merge(self, other: Sums) -> None:
        """Add the settled sums of another set of pixels."""
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
        """Mean (B,) and unbiased covariance (B, B) of the settled sums, n >= 2."""
        if self.reference is None or self.n < 2:
            raise UsageError(f"{self.n} pixels have no covariance", expected="two or more")
        # First to a whole number c beside the mean, which is exact for whole numbers, then the rest of the way.
        c = np.rint(self.first / self.n)
        mixed = np.outer(c, self.first - 0.5 * self.n * c)
        e = (self.first - self.n * c) / self.n
        central = self.second - (mixed + mixed.T) - self.n * np.outer(e, e)
        if self.basis is not None:
            back = np.hstack([np.eye(e.size), self.basis.astype(np.float64)])  # z = (z - P y) + P y
            central += back @ self.split[:-1, :-1] @ back.T
        covariance = central / (self.n - 1)
        return self.reference + c + e, (covariance + covariance.T) / 2.0


def _split(
    pixels: npt.NDArray[Any],
    basis: npt.NDArray[np.float32],
    weight: npt.NDArray[Any],
    work: npt.NDArray[Any] | None,
) -> npt.NDArray[Any]:
    """(B + K + 1, N): the rest z - P y, the coordinates y = P^T z of each column z, and its weight."""
    bands, directions = basis.shape
    rows = bands + directions + 1
    if not pixels.flags.c_contiguous:  # stored by pixel: the same with lines for columns
        both = np.empty((pixels.shape[1], rows), np.float32) if work is None else work.T
        np.matmul(pixels.T, basis, out=both[:, bands:-1])
        np.matmul(both[:, bands:-1], basis.T, out=both[:, :bands])
        np.subtract(pixels.T, both[:, :bands], out=both[:, :bands])
        both[:, -1] = weight
        return both.T
    both = np.empty((rows, pixels.shape[1]), np.float32) if work is None else work
    np.matmul(basis.T, pixels, out=both[bands:-1])
    np.matmul(basis, both[bands:-1], out=both[:bands])
    np.subtract(pixels, both[:bands], out=both[:bands])
    both[-1] = weight
    return both
