"""What a sample of pixels says of its population: mean, covariance, rank, shrinkage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
SCENE = "scene"


@dataclass(frozen=True)
class SampleStatistics:
    """What a sample of pixels says of its population.

    Attributes
    ----------
    mean : (B,)
    covariance : (B, B) unbiased, divisor n - 1
    n : pixels used
    n_left_out : pixels of the region left out as invalid or not finite
    fourth : sum over pixels of |x - mean|^4, for the shrinkage intensity; NaN where it was not summed
    rounding : bound of the relative error of any variance that comes from sums in single precision; 0 without them
    """

    mean: Array
    covariance: Array
    n: int
    n_left_out: int = 0
    fourth: float = 0.0
    rounding: float = 0.0

    @property
    def rank(self) -> int:
        """Number of eigenvalues above rounding error."""
        values = np.linalg.eigvalsh(self.covariance)
        return int(np.sum(values > max(values[-1], 0.0) * values.size * np.finfo(float).eps))

    @property
    def shrinkage(self) -> float:
        """Ledoit-Wolf intensity in [0, 1]: the part of the target mu I in the shrunk covariance.

        b^2/d^2 with S the covariance of divisor n, mu = tr S/B, d^2 = |S - mu I|^2 and
        b^2 = min(d^2, sum_k |x_k x_k^T - S|^2 / n^2), the sum being sum |x_k|^4 - n |S|^2.
        Source: Ledoit & Wolf, J. Multivariate Anal. 88, 365-411, 2004, section 3.
        """
        if np.isnan(self.fourth):
            raise UsageError("the fourth moment was not summed", mend="take statistics_of the pixels themselves")
        s = self.covariance * ((self.n - 1) / self.n)
        mu = np.trace(s) / s.shape[0]
        d2 = float(np.sum((s - mu * np.eye(s.shape[0])) ** 2))
        if d2 <= 0.0:
            return 1.0
        b2 = max(0.0, (self.fourth - self.n * float(np.sum(s**2))) / self.n**2)
        return min(1.0, b2 / d2)

    @property
    def shrunk_covariance(self) -> Array:
        """(B, B) well-conditioned covariance: (1 - a) S + a (tr S/B) I with a = :attr:`shrinkage`."""
        a, s = self.shrinkage, self.covariance
        return np.asarray((1.0 - a) * s + a * np.trace(s) / s.shape[0] * np.eye(s.shape[0]))


def statistics_of(pixels: npt.ArrayLike, *, left_out: int = 0) -> SampleStatistics:
    """Statistics of pixels (n, B) that are at hand at once; n >= 2, all finite.

    Pixels are taken relative to the first one and then to the mean, which keeps every digit on bright flat scenes.
    """
    x = np.asarray(pixels, dtype=float)
    if x.ndim != 2 or x.shape[0] < 2 or not np.all(np.isfinite(x)):
        raise UsageError(f"statistics need two or more finite pixels (n, B), got an array of {x.shape}")
    z = x - x[0]
    mean = z.mean(axis=0)
    z -= mean
    length = np.einsum("ij,ij->i", z, z)
    covariance = z.T @ z / (len(z) - 1)
    return SampleStatistics(
        x[0] + mean, (covariance + covariance.T) / 2.0, len(z), left_out, float(length @ length)
    )
