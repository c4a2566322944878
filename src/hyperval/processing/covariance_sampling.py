"""How far a covariance measured on n pixels departs from the true one: eigenvalues, distance, subspaces.

Sample eigenvalues are biased (the great ones too great, the small ones too small) where n is not far above the
number of bands.  A prediction is therefore not compared with a measured eigenvalue itself, but with what n pixels
drawn from the predicted covariance would show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.executors import single_blas_thread

Array = npt.NDArray[np.float64]

# With m draws the r-th least and r-th greatest, r = 0.025 (m + 1), bound a further draw with probability 0.95,
# exactly.
DRAWS = 119
_RANK = 3
# Directions with less than this part of the greatest eigenvalue are rounding error.
SMALLEST_PART = 1e-12
# Fewer independent pixels for each direction than this: the determinant of the sample says little.
PIXELS_PER_DIRECTION = 3.0


@dataclass(frozen=True)
class Directions:
    """Eigenvectors (B, P) and eigenvalues (P,) of a covariance, largest first, without those that are rounding."""

    vectors: Array
    values: Array

    @classmethod
    def of(cls, covariance: npt.ArrayLike) -> Directions:
        """Of a symmetric (B, B); UsageError where it has no variance."""
        values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float))
        values, vectors = values[::-1], vectors[:, ::-1]
        keep = values > SMALLEST_PART * max(float(values[0]), 0.0)
        if not keep.any():
            raise UsageError("a covariance without variance has no eigenvalues to compare")
        return cls(np.ascontiguousarray(vectors[:, keep]), values[keep])

    def of_other(self, covariance: npt.ArrayLike) -> Array:
        """Another covariance (B, B) in these directions, scaled to the identity where it is the same: (P, P)."""
        scaled = self.vectors / np.sqrt(self.values)
        return np.asarray(scaled.T @ np.asarray(covariance, dtype=float) @ scaled)


@dataclass(frozen=True)
class Statistics:
    """What is compared of a covariance S with the predicted one, Sigma.

    Attributes
    ----------
    eigenvalues : (K,) leading eigenvalues of S
    total : trace of S
    distance : Bhattacharyya distance of two normal laws of equal mean with Sigma and S; NaN where S is of less
        than full rank
    overlap : (k, k) scalar products of the first predicted eigenvectors with those of S
    """

    eigenvalues: Array
    total: float
    distance: float
    overlap: Array


def statistics_of_covariance(
    directions: Directions, whitened: Array, count: int, most: int, *, full_rank: bool = True
) -> Statistics:
    """The statistics of S, given as W = D^-1/2 V^T S V D^-1/2 (P, P) in the predicted ``directions``.

    ``count`` leading eigenvalues, and the overlap of the first ``most`` eigenvectors.
    """
    root = np.sqrt(directions.values)
    covariance = whitened * root[:, None] * root
    values, vectors = (x[..., ::-1] for x in np.linalg.eigh(covariance))
    distance = covariance_distance(whitened) if full_rank else float("nan")
    return Statistics(values[:count], float(np.trace(covariance)), distance, vectors[:most, :most])


def statistics_of_factor(
    directions: Directions, factor: Array, count: int, most: int, *, full_rank: bool = True
) -> Statistics:
    """:func:`statistics_of_covariance` of W = F F^T with F (P, m).

    Of fewer pixels m than directions P, the m eigenvalues are those of the Gram matrix (m, m) of the scaled factor.
    """
    size, pixels = factor.shape
    if not max(count, most) <= pixels < size:
        return statistics_of_covariance(directions, factor @ factor.T, count, most, full_rank=full_rank)
    scaled = np.sqrt(directions.values)[:, None] * factor
    values, turned = (x[..., ::-1] for x in np.linalg.eigh(scaled.T @ scaled))
    overlap = scaled[:most] @ turned[:, :most] / np.sqrt(values[:most])
    distance = float("inf" if full_rank else "nan")
    return Statistics(values[:count], float(np.vdot(scaled, scaled)), distance, overlap)


def covariance_distance(whitened: npt.ArrayLike) -> float:
    """Covariance part of the Bhattacharyya distance from W = Sigma^-1/2 S Sigma^-1/2 (P, P).

    (1/2) ln(|(Sigma + S)/2| / sqrt(|Sigma| |S|)) = (1/2) sum ln((1 + w)/(2 sqrt(w))), w the eigenvalues of W
    (Fukunaga 1990, section 3.4).  The determinants are those of Cholesky factors.
    """
    w = np.asarray(whitened, dtype=float)
    try:
        both, alone = (np.diag(np.linalg.cholesky(m)) for m in (np.eye(len(w)) + w, w))
    except np.linalg.LinAlgError:
        return float("inf")
    return float(np.sum(np.log(both) - 0.5 * np.log(alone)) - 0.5 * len(w) * np.log(2.0))


def principal_angles_deg(overlap: npt.ArrayLike, spaces: tuple[int, ...]) -> Array:
    """(..., S) largest principal angle [deg] between the spaces of the first k of two orthonormal bases, by k.

    Its cosine is the least singular value of the bases' overlap A^T B, here (..., K, K) (Bjorck & Golub 1973).
    """
    m = np.asarray(overlap, dtype=float)
    least = [np.linalg.svd(m[..., :k, :k], compute_uv=False)[..., -1] for k in spaces]
    return np.degrees(np.arccos(np.minimum(np.reshape(least, (len(spaces), *m.shape[:-2])), 1.0))).T


def kurtosis_parameter(tail_dof: float) -> float:
    """kappa of an elliptical law: 2/(nu - 4) of a multivariate t, 0 of the normal; inf up to nu = 4.

    Source: Muirhead, Aspects of Multivariate Statistical Theory, 1982, section 1.6.
    """
    if np.isinf(tail_dof):
        return 0.0
    return 2.0 / (tail_dof - 4.0) if tail_dof > 4.0 else float("inf")


def drawn_factor(size: int, independent: npt.ArrayLike, rng: np.random.Generator, kurtosis: float = 0.0) -> Array:
    """F (P, m) of a sample covariance F F^T whose true covariance is the identity, m <= P.

    Of more pixels than directions it is Bartlett's decomposition of Wishart's law, else the pixels themselves.

    Parameters
    ----------
    size : P
    independent : degrees of freedom behind the variance of each direction: one number, or (P,)
    kurtosis : kappa of the pixels' law.  To second moments a sample covariance of an elliptical law is a normal one
        of n/(1 + kappa) pixels times a common factor of variance kappa/n, which gives an eigenvalue the relative
        variance (2 + 3 kappa)/n (Waternaux 1976).
    """
    n = np.broadcast_to(np.asarray(independent, dtype=float), (size,)) / (1.0 + kurtosis)
    least = float(n.min())
    common = 1.0
    if kurtosis > 0:
        common = float(np.exp(rng.normal(0.0, np.sqrt(kurtosis / (least * (1.0 + kurtosis))))))
    if least <= size:
        pixels = rng.standard_normal((max(round(least), 1), size))
        return np.asarray(np.sqrt(common / pixels.shape[0]) * pixels.T)
    # Fewest first: what two directions share is limited by the one with fewer independent pixels.
    order = np.argsort(n, kind="stable")
    lower = np.tril(rng.standard_normal((size, size)), -1)
    lower[np.diag_indices(size)] = np.sqrt(rng.chisquare(n[order] - np.arange(size)))
    lower /= np.sqrt(n[order])[:, None]
    drawn = np.empty((size, size))
    drawn[order] = lower
    return np.asarray(np.sqrt(common) * drawn)


@dataclass(frozen=True)
class SamplingBand:
    """Statistics of covariances drawn from the predicted one; rows are draws."""

    eigenvalues: Array
    total: Array
    distance: Array
    angles_deg: Array

    @staticmethod
    def limits(drawn: Array) -> tuple[Array, Array]:
        """Least and greatest value that a further draw keeps to with probability 0.95."""
        ordered = np.sort(drawn, axis=0)
        return ordered[_RANK - 1], ordered[-_RANK]


def sampling_band(
    directions: Directions,
    independent: npt.ArrayLike,
    count: int,
    spaces: tuple[int, ...],
    rng: np.random.Generator,
    *,
    kurtosis: float = 0.0,
    draws: int = DRAWS,
) -> SamplingBand:
    """What samples of the predicted covariance show by chance alone.

    Parameters
    ----------
    independent : degrees of freedom, one number or (P,) by direction
    count : leading eigenvalues K
    spaces : the k of the principal angles
    """
    size = directions.values.size
    full, most = full_rank(independent, size), max(spaces, default=0)
    with single_blas_thread():
        sampled = [
            statistics_of_factor(
                directions, drawn_factor(size, independent, rng, kurtosis), count, most, full_rank=full
            )
            for _ in range(draws)
        ]
    return SamplingBand(
        np.stack([f.eigenvalues for f in sampled]),
        np.array([f.total for f in sampled]),
        np.array([f.distance for f in sampled]),
        principal_angles_deg(np.stack([f.overlap for f in sampled]), spaces),
    )


def full_rank(independent: npt.ArrayLike, size: int) -> bool:
    """Whether the sample is large enough for its determinant to be compared."""
    return bool(np.min(independent) >= PIXELS_PER_DIRECTION * size)
