"""Array types; errors and samples of spectra, components of a mixture; names of detectors."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError, refusal, refuse

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]
Counts = npt.NDArray[np.int64]

LINEAR_DETECTORS = ("cem", "matched-filter", "smf", "cem-correlation")  # scores that are linear in the pixel
NUMERICAL_DETECTORS = ("ace",)  # scores whose law has no closed form
MAX_COMPONENTS = 64


def equals(stored: npt.NDArray[Any], ignore: float) -> Mask:
    """Where the stored values are the ignore value, compared in the stored type; nowhere where that cannot hold it.

    >>> [equals(np.array([of], kind), of).tolist() for of, kind in ((np.nan, "f4"), (-9999.1, "f4"), (-1.0, "i2"))]
    [[True], [True], [True]]
    >>> [equals(np.array([2**63 - 1, 7]), of).tolist() for of in (2.0**63, 2.0**64, 7.5)]
    [[True, False], [False, False], [False, False]]
    >>> [equals(np.array([3e38], "f4"), of).tolist() for of in (1e39, -1.79769313486e308)]
    [[False], [False]]
    """
    if np.isnan(ignore):
        return np.asarray(np.isnan(stored))
    kind: type[Any] = stored.dtype.type
    if stored.dtype.kind == "f":
        fits = np.isinf(ignore) or abs(ignore) <= 1.0000001 * float(np.finfo(kind).max)
        return np.asarray(stored == (kind(ignore) if fits else np.nan))
    least, most = np.iinfo(kind).min, np.iinfo(kind).max
    fits = ignore % 1.0 == 0.0 and least <= ignore <= float(most)  # of 64 bits the next power of two
    return np.asarray(stored == kind(min(int(ignore), most))) if fits else np.zeros(stored.shape, bool)


class Errors(NamedTuple):
    """Errors of a spectrum that have one source, as independent directions.

    Attributes
    ----------
    rows : (K, B) change by one standard uncertainty along each direction
    dof : degrees of freedom behind them, where they were estimated from samples
    size, unit : standard uncertainty of the input behind them, in its own unit; NaN where it has no single one
    draw : the occasion of which it is one draw, such as a day of the atmosphere; "": one draw for everything
    """

    rows: Array
    dof: float = np.inf
    size: float = np.nan
    unit: str = ""
    draw: str = ""

    @property
    def covariance(self) -> Array:
        """(B, B)."""
        return np.asarray(self.rows.T @ self.rows)

    @property
    def budget(self) -> Array:
        """(B,) standard uncertainty."""
        return np.asarray(np.sqrt((self.rows**2).sum(axis=0)))


def check_covariances(matrices: Array, what: str) -> None:
    """Refuse matrices (..., B, B) that are not symmetric or have eigenvalues below nought."""
    scale, bands = float(np.abs(matrices).max()) or 1.0, matrices.shape[-1]
    if float(np.abs(matrices - np.swapaxes(matrices, -1, -2)).max()) > 1e-9 * scale:
        raise UsageError(f"{what} is not symmetric")
    try:  # a Cholesky factor exists when no eigenvalue lies below -1e-9 scale bands: cheaper than they are
        np.linalg.cholesky(matrices + 1e-9 * scale * bands * np.eye(bands))
    except np.linalg.LinAlgError:
        raise UsageError(f"{what} is not positive semi-definite") from None


@dataclass(frozen=True, eq=False)
class Components:
    """K laws that together make the pixels of one class.

    Mean and covariance of the class are what the filters are built on; the components are what its scores are
    distributed as.

    Attributes
    ----------
    weights : (K,) parts of the class, sum 1
    offsets : (K, B) mean of each less that of the class [1]
    covariances : (K, B, B)
    dof : degrees of freedom of multivariate t laws, above 2; inf: normal laws
    """

    weights: Array
    offsets: Array
    covariances: Array
    dof: float = np.inf

    def __post_init__(self) -> None:
        arrays = self.weights, self.offsets, self.covariances
        weights, offsets, covariances = (np.asarray(array, dtype=float) for array in arrays)
        count, bands = offsets.shape if offsets.ndim == 2 else (0, 0)
        if weights.shape != (count,) or covariances.shape != (count, bands, bands) or not 0 < count <= MAX_COMPONENTS:
            shapes = {"weights": weights.shape, "offsets": offsets.shape, "covariances": covariances.shape}
            raise refusal("components.shapes", **shapes, most=MAX_COMPONENTS)
        refuse(not all(np.all(np.isfinite(x)) for x in (weights, offsets, covariances)), "components.finite")
        if np.any(weights <= 0) or abs(float(weights.sum()) - 1.0) > 1e-6:
            raise refusal("components.weights", weights=np.array2string(weights, precision=4))
        check_covariances(covariances, "the covariance of a component")
        refuse(not self.dof > 2, "components.dof", dof=self.dof)
        vars(self).update(weights=weights, offsets=offsets, covariances=covariances)

    def __len__(self) -> int:
        return self.weights.size

    def at(self, bands: Index) -> Components:
        """The components on some bands alone."""
        if bands.size == self.offsets.shape[1]:
            return self
        return self._replaced(self.offsets[:, bands], self.covariances[:, bands[:, None], bands])

    def through(self, weights: Array) -> Components:
        """The components of ``weights`` (C, B) times the spectra, such as those on other bands."""
        covariances = weights @ self.covariances @ weights.T
        return self._replaced(self.offsets @ weights.T, 0.5 * (covariances + covariances.transpose(0, 2, 1)))

    def stretched(self, gain: Array | float) -> Components:
        """The components of spectra times ``gain`` (B,), of which a single number is the root of a factor on the
        covariance of the class: it spreads the components as it spreads their pixels."""
        g = np.broadcast_to(np.asarray(gain, dtype=float), self.offsets.shape[1:])
        return self._replaced(self.offsets * g, self.covariances * np.outer(g, g))

    def _replaced(self, offsets: Array, covariances: Array) -> Components:
        """As many other components, without the checks that these have passed."""
        out = copy(self)
        vars(out).update(offsets=offsets, covariances=covariances)
        return out

    @property
    def covariance(self) -> Array:
        """(B, B) of all together: within the components and between them."""
        mean = self.weights @ self.offsets
        offset = self.offsets - mean
        return np.asarray(np.tensordot(self.weights, self.covariances, 1) + (offset * self.weights[:, None]).T @ offset)


@dataclass(frozen=True)
class SampleStatistics:
    """What a sample of pixels says of its population.

    Attributes
    ----------
    mean : (B,)
    covariance : (B, B) unbiased, divisor n - 1
    n : pixels used
    fourth : sum over pixels of |x - mean|^4, for the shrinkage intensity; NaN where it was not summed
    """

    mean: Array
    covariance: Array
    n: int
    fourth: float = 0.0

    @property
    def shrinkage(self) -> float:
        """Ledoit-Wolf intensity in [0, 1]: the part of the target mu I in the shrunk covariance.

        b^2/d^2 with S the covariance of divisor n, mu = tr S/B, d^2 = |S - mu I|^2 and
        b^2 = min(d^2, sum_k |x_k x_k^T - S|^2 / n^2), the sum being sum |x_k|^4 - n |S|^2.
        Source: Ledoit & Wolf, J. Multivariate Anal. 88, 365-411, 2004, section 3.
        """
        refuse(np.isnan(self.fourth), "sample.fourth")
        s = self.covariance * ((self.n - 1) / self.n)
        mu = np.trace(s) / s.shape[0]
        d2 = float(np.sum((s - mu * np.eye(s.shape[0])) ** 2))
        b2 = max(0.0, (self.fourth - self.n * float(np.sum(s**2))) / self.n**2)
        return min(1.0, b2 / d2) if d2 > 0.0 else 1.0

    def shrunk(self, intensity: float | None = None, bands: Mask | slice = slice(None)) -> SampleStatistics:
        """With the well-conditioned covariance (1 - a) S + a (tr S/B) I; a is :attr:`shrinkage` unless given.

        ``bands`` : that the trace is of
        """
        a, s = self.shrinkage if intensity is None else intensity, self.covariance
        level = float(np.trace(part := s[bands][:, bands])) / len(part)
        return replace(self, covariance=(1.0 - a) * s + a * level * np.eye(s.shape[0]))


def statistics_of(pixels: npt.ArrayLike) -> SampleStatistics:
    """Statistics of pixels (n, B) that are at hand at once; n >= 2, all finite.

    Pixels are taken relative to the first one and then to the mean, which keeps every digit on bright flat scenes.
    """
    x = np.asarray(pixels, dtype=float)
    refuse(x.ndim != 2 or x.shape[0] < 2 or not np.all(np.isfinite(x)), "sample.few", shape=x.shape)
    z = x - x[0]
    mean = z.mean(axis=0)
    z -= mean
    length = np.einsum("ij,ij->i", z, z)
    covariance = z.T @ z / (len(z) - 1)
    return SampleStatistics(x[0] + mean, (covariance + covariance.T) / 2.0, len(z), float(length @ length))
