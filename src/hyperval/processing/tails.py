"""Tails of the pixels about their mean: degrees of freedom of a multivariate t, from Mahalanobis distances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy
from scipy.special import chdtrc, fdtrc, gammaln, ndtr

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

# The search is over a = 1/nu; below the first value a t cannot be told from the normal by any sample, above the
# second the covariance is no longer finite.
_LEAST, _MOST = 1e-6, 0.499
_HALF_DROP = 1.920729410347062  # half the 0.95 quantile of chi-square with one degree of freedom
_SCALE_STEPS = 60
LEADING_SHARE = 0.99  # of the variance, in the leading components that tails are measured in as well
FEWEST_LEADING, MOST_LEADING = 2, 6
LEAST_DOF = 2.05  # only a very heavy tail has no covariance; such a fit is held just above it


@dataclass(frozen=True)
class TailFit:
    """Degrees of freedom of a multivariate t.

    Attributes
    ----------
    dof : maximum-likelihood nu; inf where the normal law is the most likely
    lower, upper : 95 % limits by profile likelihood; upper inf where the normal law is inside
    normality_p_value : probability of such a likelihood ratio if the pixels are normal
    n : distances behind it
    dimension : bands or components of which they are distances
    """

    dof: float
    lower: float
    upper: float
    normality_p_value: float
    n: int
    dimension: int


def tail_log_likelihood(inverse_dof: float, squared_distances: Array, dimension: int) -> float:
    """Greatest log likelihood of squared Mahalanobis distances (n,) under a multivariate t, whatever the scale.

    d^2 nu/(nu - 2)/(p s) follows F(p, nu), chi-square over p in the limit nu -> inf (Kotz & Nadarajah,
    Multivariate t Distributions, 2004, section 1.2).  The scale s is free: where tails are heavy the sample's own
    covariance misses it by more than the tail's shape allows.
    """
    d, p = squared_distances, dimension
    if inverse_dof < _LEAST:
        s = float(np.mean(d)) / p
        constant = -0.5 * p * np.log(2.0 * s) - gammaln(0.5 * p)
        return float(np.sum((0.5 * p - 1.0) * np.log(d) - 0.5 * d / s) + d.size * constant)
    nu = 1.0 / inverse_dof
    width = _t_width(d, p, nu)
    constant = gammaln(0.5 * (nu + p)) - gammaln(0.5 * nu) - gammaln(0.5 * p) - 0.5 * p * np.log(width)
    body = (0.5 * p - 1.0) * np.log(d) - 0.5 * (nu + p) * np.log1p(d / width)
    return float(np.sum(body) + d.size * constant)


def _t_width(d: Array, p: int, nu: float) -> float:
    """The width w = s (nu - 2) of greatest likelihood: mean of (nu + p)/p d/(w + d) is 1."""
    ratio = (nu + p) / p
    low, high = 1e-6 * float(np.median(d)) * nu / p, 1e6 * float(d.max()) * nu
    for _ in range(_SCALE_STEPS):
        middle = float(np.sqrt(low * high))
        if ratio * float(np.mean(d / (middle + d))) > 1.0:
            low = middle
        else:
            high = middle
        if high < low * (1.0 + 1e-9):
            break
    return float(np.sqrt(low * high))


def left_out_distances(squared_distances: npt.ArrayLike, pixels: float) -> Array:
    """Squared distances by mean and covariance of the other pixels, from those by the statistics of all.

    A far pixel stretches the covariance that it is measured by, so that no distance exceeds (n - 1)^2/n.  Removing
    the pixel (Sherman & Morrison) gives (n - 2) (n/(n - 1))^2 q/(1 - q n/(n - 1)) with q = d^2/(n - 1).
    """
    n = float(pixels)
    q = np.asarray(squared_distances, dtype=float) / (n - 1.0)
    # A pixel that alone spans a direction has no finite distance from the others.
    rest = np.maximum(1.0 - q * n / (n - 1.0), 1e-9)
    return np.asarray((n - 2.0) * (n / (n - 1.0)) ** 2 * q / rest)


def fit_tail_dof(
    squared_distances: npt.ArrayLike,
    dimension: int,
    *,
    estimated_on: int | None = None,
    independent: float | None = None,
) -> TailFit:
    """Maximum-likelihood degrees of freedom with profile-likelihood limits.

    Parameters
    ----------
    squared_distances : (n,) of pixels from their mean, by their covariance; those of 0 are left out
    dimension : bands p
    estimated_on : pixels that mean and covariance were estimated on, these among them; None where both are known.
        Distances are then taken from the other pixels; for normal pixels those follow T^2, which is a t with
        n - 1 - p degrees of freedom, and its inverse is taken off
    independent : of these distances, as many count as independent; the likelihood is taken to that power over n

    Raises
    ------
    UsageError : fewer than ten distances, or no more pixels than bands.
    """
    fit, at, top, end, d = _most_likely(squared_distances, dimension, estimated_on, independent)
    normal = fit(0.0)

    def drop(a: float) -> float:
        return top - fit(a) - _HALF_DROP

    high = end if drop(end) < 0 else float(scipy.optimize.brentq(drop, at, end))
    low = 0.0 if at == 0.0 or drop(0.0) <= 0 else float(scipy.optimize.brentq(drop, 0.0, at))
    # Twice the gain is half chi-square, half 0 when nu = inf is true, as that is the end of the range
    # (Self & Liang 1987).
    p_value = float(ndtr(-np.sqrt(2.0 * (top - normal)))) if top > normal else 1.0
    return TailFit(_inverse(at), _inverse(high), _inverse(low), p_value, int(d.size), dimension)


def dof_of_distances(squared_distances: npt.ArrayLike, dimension: int, *, estimated_on: int) -> float:
    """The degrees of freedom of :func:`fit_tail_dof` without their limits; at least 2.05, where a covariance is."""
    return max(_inverse(_most_likely(squared_distances, dimension, estimated_on, None)[1]), LEAST_DOF)


def _most_likely(
    squared_distances: npt.ArrayLike, dimension: int, estimated_on: int | None, independent: float | None
) -> tuple[Callable[[float], float], float, float, float, Array]:
    """Log likelihood of 1/nu, where it is greatest, how great, the end of its range, the distances that count."""
    d = np.asarray(squared_distances, dtype=float)
    d = d[np.isfinite(d) & (d > 0)]
    if d.size < 10:
        raise UsageError(f"{d.size} distances say nothing of tails", expected="ten or more")
    offset = 0.0
    if estimated_on is not None:
        if estimated_on <= dimension + 3:
            raise UsageError(f"{estimated_on} pixels for distances in {dimension} bands", expected="more pixels")
        d = left_out_distances(d, estimated_on)
        offset = 1.0 / (estimated_on - 1.0 - dimension)
    weight = 1.0 if independent is None else min(independent / d.size, 1.0)

    def fit(a: float) -> float:
        return weight * tail_log_likelihood(a + offset, d, dimension)

    best = scipy.optimize.minimize_scalar(
        lambda a: -fit(a), bounds=(0.0, _MOST - offset), method="bounded", options={"xatol": 1e-9}
    )
    at, top, normal = float(best.x), -float(best.fun), fit(0.0)
    if at <= 2.0 * _LEAST or top <= normal:
        at, top = 0.0, max(normal, top)
    return fit, at, top, _MOST - offset, d


def _inverse(a: float) -> float:
    return 1.0 / a if a > 0 else float("inf")


def exceedance_of_distance(squared_distance: npt.ArrayLike, dimension: int, dof: float) -> Array:
    """Probability that a pixel of a normal (dof inf) or t law lies farther out than this, of any shape."""
    d = np.asarray(squared_distance, dtype=float)
    if np.isinf(dof):
        return np.asarray(chdtrc(dimension, d))
    return np.asarray(fdtrc(dimension, dof, d * dof / (dof - 2.0) / dimension))


def leading_count(variances: Array, total: float) -> int:
    """How many leading components tails are measured in: those that hold 99 % of the ``total`` variance, 2 to 6."""
    count = int(np.searchsorted(np.cumsum(variances) / total, LEADING_SHARE)) + 1
    return min(max(count, FEWEST_LEADING), MOST_LEADING, variances.size)


def squared_mahalanobis(pixels: npt.ArrayLike, mean: npt.ArrayLike, vectors: Array, values: Array) -> Array:
    """Squared distances (n,) of pixels (n, B) from a mean, in the directions (B, P) with variances (P,)."""
    z = (np.asarray(pixels, dtype=float) - np.asarray(mean, dtype=float)) @ vectors
    return np.asarray(np.einsum("ij,ij->i", z / values, z))
