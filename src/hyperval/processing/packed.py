"""Symmetric matrices (F, F) in LAPACK's rectangular full packed form: half the memory, the speed of whole ones.

What many settings of one scene put together, element by element, and factorise, is put together in vectors of
F (F + 1) / 2 numbers.  Their order is LAPACK's (transr N, uplo L) and nobody else's business.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dpftrf, dpftrs, dpocon, dsfrk, dtfttr, dtrttf

Array = npt.NDArray[np.float64]
# Below this ratio of the pivots at unit diagonal, squared, a matrix can not be near the limit of the condition
# number in practice; above it the condition number is estimated.
_SUSPECT = 1e8


def packed(matrix: Array) -> Array:
    """(P,) of a symmetric matrix (F, F)."""
    values, _ = dtrttf(matrix.T, uplo="L")  # the transpose of C order is Fortran's, and the matrix is symmetric
    return np.asarray(values)


def unpacked(values: Array, size: int) -> Array:
    """(F, F) the whole matrix."""
    lower = np.tril(_lower(values, size))
    return np.asarray(lower + np.tril(lower, -1).T)


@lru_cache(maxsize=32)
def diagonal_places(size: int) -> npt.NDArray[np.intp]:
    """(F,) where the diagonal stands."""
    return np.argsort(packed(np.diag(np.arange(1.0, size + 1.0))), kind="stable")[-size:]


def add_products(values: Array, rows: Array, *, fresh: bool = False) -> Array:
    """The matrix plus r^T r for rows r (K, F), in the memory of ``values``; ``fresh``: in place of the matrix."""
    count, size = rows.shape
    keep = 0.0 if fresh else 1.0
    return np.asarray(dsfrk(size, count, 1.0, rows.T, keep, values, uplo="L", overwrite_c=1))


def factor(values: Array, size: int) -> Array | None:
    """Cholesky factor in the memory of ``values``; None where the matrix is not positive definite."""
    cholesky, info = dpftrf(size, values, uplo="L", overwrite_a=1)
    return None if info else np.asarray(cholesky)


def solved(cholesky: Array, right: Array) -> Array:
    """x (F, K) of matrix x = right (F, K), from the factor of the matrix."""
    x, _ = dpftrs(right.shape[0], cholesky, right, uplo="L")
    return np.asarray(x)


def near_singular(diagonal: Array, cholesky: Array) -> bool:
    """Whether the condition number at unit diagonal may be large, by the pivots; ``diagonal`` (F,)."""
    pivots = cholesky[diagonal_places(diagonal.size)] / np.sqrt(diagonal)
    return bool((pivots.max() / pivots.min()) ** 2 > _SUSPECT)


def condition_number(values: Array, cholesky: Array, size: int) -> float:
    """Estimated 1-norm condition number at unit diagonal, from a matrix and its factor."""
    scale = 1.0 / np.sqrt(values[diagonal_places(size)])
    norm = np.abs(unpacked(values, size) * np.outer(scale, scale)).sum(axis=0).max()
    lower = np.asfortranarray(_lower(cholesky, size) * scale[:, None])
    reciprocal, _ = dpocon(lower, norm, uplo="L")
    return float(1.0 / reciprocal) if reciprocal > 0 else float("inf")


def _lower(values: Array, size: int) -> Array:
    """(F, F) the lower triangle; above it the memory holds anything."""
    triangle, _ = dtfttr(size, values, uplo="L")
    return np.asarray(triangle)
