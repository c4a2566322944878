"""The difference ratio of two sides and its error: of spectra by band, of areas."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.products import SpectralEstimate

Array = npt.NDArray[np.float64]


def difference_ratio(predicted: npt.ArrayLike, collected: npt.ArrayLike) -> Array:
    """(B,) (predicted - collected)/collected; NaN where ``collected`` is not positive.

    Examples
    --------
    >>> difference_ratio([1.1, 2.0], [1.0, 2.0]).round(3).tolist()
    [0.1, 0.0]
    """
    p, c = np.asarray(predicted, dtype=float), np.asarray(collected, dtype=float)
    return np.where(c > 0, p - c, np.nan) / np.where(c > 0, c, 1.0)


def difference_ratio_uncertainty(
    predicted: npt.ArrayLike, collected: npt.ArrayLike, u_predicted: npt.ArrayLike, u_collected: npt.ArrayLike
) -> Array:
    """(B,) standard uncertainty of the difference ratio, to first order: hypot(u_p, p/c u_c)/c.

    The root of the diagonal of :func:`difference_ratio_covariance`.  Source: JCGM 100:2008, 5.1.

    Examples
    --------
    >>> difference_ratio_uncertainty([1.0, 1.0], [1.0, 0.0], [0.03, 0.03], [0.04, 0.04]).round(3).tolist()
    [0.05, nan]
    """
    p, c = np.asarray(predicted, dtype=float), np.asarray(collected, dtype=float)
    c = np.where(c > 0, c, np.nan)
    return np.asarray(np.hypot(u_predicted, p / c * np.asarray(u_collected)) / c)


def difference_ratio_covariance(predicted: SpectralEstimate, collected: SpectralEstimate) -> Array:
    """(B, B) error covariance of the difference ratio, to first order.

    With r = p/c - 1, dr = dp/c - p dc/c^2, so C_r = D_1 C_p D_1 + D_2 C_c D_2 with D_1 = diag(1/c) and
    D_2 = diag(p/c^2); the two sides are independent.  Source: law of propagation, JCGM 100:2008, 5.2.
    """
    c = np.where(collected.mean > 0, collected.mean, np.nan)
    one, two = 1.0 / c, predicted.mean / c**2
    return predicted.error_covariance * np.outer(one, one) + collected.error_covariance * np.outer(two, two)
