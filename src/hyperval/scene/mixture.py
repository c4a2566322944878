"""Scene averages over the background classes (3.8)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]


def average_reflectance(fractions: npt.ArrayLike, means: npt.ArrayLike) -> Array:
    """Area-average reflectance rho_ave = sum f_m rho_m (3.8).

    Parameters
    ----------
    fractions : (M,) area fractions, sum 1
    means : (M, B) class means [1]

    Raises
    ------
    UsageError : negative fractions, or fractions that do not sum to 1.
    """
    f = _fractions(fractions)
    return np.asarray(f @ np.asarray(means, dtype=float))  # (3.8)


def mixture_covariance(
    fractions: npt.ArrayLike, means: npt.ArrayLike, covariances: Sequence[npt.ArrayLike] | Array
) -> Array:
    """Covariance of a pixel drawn from the whole scene, Sigma_ave of (3.11).

    sum f_m [Sigma_m + (rho_m - rho_ave)(rho_m - rho_ave)^T]: within-class and between-class spread.

    Parameters
    ----------
    fractions : (M,) area fractions, sum 1
    means : (M, B)
    covariances : M arrays (B, B)
    """
    f = _fractions(fractions)
    mu = np.asarray(means, dtype=float)
    d = mu - average_reflectance(f, mu)
    result = (d * f[:, None]).T @ d
    for part, covariance in zip(f, covariances, strict=True):
        result += part * np.asarray(covariance, dtype=float)
    return np.asarray(result)  # Sigma_ave of (3.11)


def _fractions(fractions: npt.ArrayLike) -> Array:
    f = np.asarray(fractions, dtype=float)
    if f.ndim != 1 or f.size == 0 or np.any(f < 0) or abs(float(f.sum()) - 1.0) > 1e-6:
        raise UsageError(
            f"the area fractions {np.array2string(f, precision=4)} are not a partition of the scene",
            expected="non-negative numbers that sum to 1",
        )
    return f
