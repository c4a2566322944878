"""Linear detectors, features and unmixing: one function of weights for the model and for pixels (3.21-3.25).

The names collide in the literature.  The source of the equations calls the filter of 3.22-3.25 "CEM" although it
removes the background mean and uses the background covariance; most of the field calls that the normalised
(unit-response) matched filter and keeps CEM for the form with the correlation matrix and no mean removal (Harsanyi
1993).  Both are here, under both names.  Features of spectra are F = Psi X (3.21); abundances of endmembers are by
fully constrained least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpftrf, dpftrs, dpocon, dtfttr

from hyperval.data import Array, Index
from hyperval.errors import UsageError, refusal, refuse
from hyperval.model.radiance import Retrieved, add_products, cached_matrix, pack, packed_diagonal, truth_row, unpack
from hyperval.model.stated import Stated

# Beyond this the float64 solve keeps fewer than about three correct digits.
MAX_CONDITION = 1e13
# Below this ratio of the squared pivots at unit diagonal a matrix can not be near that limit in practice; above it the
# condition number is estimated.
_SUSPECT = 1e8


class PositiveDefinite:
    """A covariance that (3.22-3.25) inverts: factorised once, used for every target.

    By Cholesky over scales on both sides, such as the standard deviations of the bands, whose ratios cause no loss of
    digits.

    Parameters
    ----------
    matrix : (F, F), or (P,) packed over ``scale``
    scale : (F,); None: the standard deviations
    bands : (F,) numbers from 0 of the bands where others were left out, for messages; None: all count

    Raises
    ------
    UsageError : singular, indefinite, or worse conditioned than float64 can carry; the message names
        the rank and the condition number.

    Examples
    --------
    >>> PositiveDefinite(np.diag([1.0, 0.0]), bands=np.array([3, 14]))
    Traceback (most recent call last):
    hyperval.errors.UsageError: the background matrix is singular: 1 of 2 bands have no variance (first: band 15)
      to fix it: drop those bands from the detector's bands
    """

    def __init__(self, matrix: npt.ArrayLike, scale: Array | None = None, bands: Index | None = None):
        values = np.asarray(matrix, dtype=float)
        if scale is None:
            scale = np.sqrt(np.maximum(np.diag(values), 0.0))
            with np.errstate(divide="ignore", invalid="ignore"):
                values = pack(values / scale[:, None] / scale)
        self.scale, self._values = scale, values
        diagonal = values[packed_diagonal(scale.size)]
        bad = (np.arange(scale.size) if bands is None else bands)[~(diagonal > 0)]
        refuse(bad.size, "background.flat", bad=bad.size, bands=scale.size, first=bad[:1] + 1)
        refuse(not np.isfinite(values.sum()), "background.finite")
        self._cholesky, failed = dpftrf(scale.size, values, uplo="L")
        pivots = self._cholesky[packed_diagonal(scale.size)] ** 2 / diagonal
        if failed or (pivots.max() > _SUSPECT * pivots.min() and not self.condition <= MAX_CONDITION):
            eigenvalues = np.linalg.eigvalsh(self._at_unit_diagonal)
            rank = int(np.sum(eigenvalues > eigenvalues[-1] * scale.size * np.finfo(float).eps))
            condition = np.inf if failed else self.condition
            raise refusal("background.singular", rank=rank, bands=scale.size, condition=condition)

    @property
    def matrix(self) -> Array:
        """(F, F)."""
        return unpack(self._values, self.scale.size) * np.outer(self.scale, self.scale)

    @property
    def _at_unit_diagonal(self) -> Array:
        unit = 1.0 / np.sqrt(self._values[packed_diagonal(self.scale.size)])
        return unpack(self._values, self.scale.size) * np.outer(unit, unit)

    @cached_property
    def _lower(self) -> Array:
        """(F, F) factor over the scales; above its diagonal the memory holds anything."""
        return np.asarray(dtfttr(self.scale.size, self._cholesky, uplo="L")[0])

    @cached_property
    def condition(self) -> float:
        """Estimated 1-norm condition number at unit diagonal."""
        unit = 1.0 / np.sqrt(self._values[packed_diagonal(self.scale.size)])
        lower = np.asfortranarray(self._lower * unit[:, None])
        reciprocal, _ = dpocon(lower, np.abs(self._at_unit_diagonal).sum(axis=0).max(), uplo="L")
        return float(1.0 / reciprocal) if reciprocal > 0 else float("inf")

    def solve(self, right: Array) -> Array:
        """x of matrix x = right, (F,) or (F, N)."""
        x, _ = dpftrs(self.scale.size, self._cholesky, (right.T / self.scale).T, uplo="L")
        return np.asarray((x.reshape(right.shape).T / self.scale).T)

    def whiten(self, x: Array) -> Array:
        """y (F, ...) of x (F, ...) such that y . y = x . matrix^-1 x."""
        return np.asarray(solve_triangular(self._lower, (x.T / self.scale).T, lower=True, check_finite=False))


class LinearFilter(NamedTuple):
    """Linear detectors: score = weights . x - offset.

    Attributes
    ----------
    weights : (..., B) per unit of the data
    offset : (...) what is subtracted from weights . x [1]; the score of the background mean is 0 for the
        matched filter, the offset is 0 for the correlation reading
    """

    weights: Array
    offset: Any

    def score(self, x: npt.ArrayLike) -> Array:
        """Scores (...) of pixels (..., B) by one filter."""
        return np.asarray(np.asarray(x, dtype=float) @ self.weights - self.offset)

    def rows(self, index: Index) -> LinearFilter:
        """Some of several filters."""
        return LinearFilter(self.weights[index], self.offset[index])


Covariance = npt.ArrayLike | PositiveDefinite


def matched_filter_weights(target: npt.ArrayLike, mean: npt.ArrayLike, covariance: Covariance) -> LinearFilter:
    """Unit-response matched filter, the "CEM" of the source (3.22-3.25).

    w = Sigma^-1 d / (d^T Sigma^-1 d) with d = target - mean, score = w (x - mean): the score is 1 at
    ``target``, 0 at ``mean``, and f at the mixture f target + (1 - f) mean.

    Parameters
    ----------
    target : (B,) spectrum sought
    mean : (B,) background mean
    covariance : (B, B) background covariance, as an array or factorised

    Raises
    ------
    UsageError : sizes differ, the covariance is singular or not positive definite, or the target is
        the background mean.
    """
    t, mu, sigma = _checked(target, mean, covariance)
    d = t - mu  # (3.22)
    solved = sigma.solve(d)
    w = solved / _target_energy(d, solved)  # (3.23), (3.24): the target itself scores 1
    return LinearFilter(w, float(w @ mu))  # (3.25)


def spectral_matched_filter(target: npt.ArrayLike, mean: npt.ArrayLike, covariance: Covariance) -> LinearFilter:
    """SMF: the matched filter scaled to unit variance over the background (variant of 3.22-3.25).

    w = Sigma^-1 d / sqrt(d^T Sigma^-1 d): :func:`matched_filter_weights` times sqrt(d^T Sigma^-1 d).  The score is
    in standard deviations of the background, so that one threshold gives one false-alarm rate for every target; a
    positive factor leaves the ROC curve as it is.

    Parameters and errors as :func:`matched_filter_weights`.
    """
    t, mu, sigma = _checked(target, mean, covariance)
    solved = sigma.solve(t - mu)
    w = solved / np.sqrt(_target_energy(t - mu, solved))
    return LinearFilter(w, float(w @ mu))


def cem_correlation_weights(target: npt.ArrayLike, mean: npt.ArrayLike, covariance: Covariance) -> LinearFilter:
    """Constrained energy minimisation with the correlation matrix and no mean removal (variant of 3.22-3.25).

    w = R^-1 t / (t^T R^-1 t) with R = covariance + mean mean^T, score = w x.  Of all filters with
    score 1 at ``target`` it has the least mean square score over the background.

    Parameters and errors as :func:`matched_filter_weights`.
    """
    t, mu, sigma = _checked(target, mean, covariance)
    inv_mu = sigma.solve(mu)
    solved = sigma.solve(t) - inv_mu * float(inv_mu @ t) / (1.0 + float(inv_mu @ mu))  # Sherman & Morrison 1950
    return LinearFilter(solved / _target_energy(t, solved), 0.0)


def _checked(
    target: npt.ArrayLike, mean: npt.ArrayLike, covariance: Covariance
) -> tuple[Array, Array, PositiveDefinite]:
    t, mu = np.asarray(target, dtype=float), np.asarray(mean, dtype=float)
    shape = 2 * covariance.scale.shape if isinstance(covariance, PositiveDefinite) else np.shape(covariance)
    if t.ndim != 1 or mu.shape != t.shape or shape != 2 * t.shape:
        raise UsageError(f"target {t.shape}, mean {mu.shape} and covariance {shape} do not fit each other")
    return t, mu, covariance if isinstance(covariance, PositiveDefinite) else PositiveDefinite(covariance)


def _target_energy(difference: Array, solved: Array) -> float:
    """d^T Sigma^-1 d."""
    energy = float(difference @ solved)
    refuse(not energy > 0, "filter.zero")
    return energy


# Each takes (target, background mean, background covariance).  "cem" and "matched-filter" are one
# filter under the name the source gives it and the name most of the field gives it; "smf" is the same filter in
# standard deviations of the background.
FILTERS: Mapping[str, Callable[[npt.ArrayLike, npt.ArrayLike, Any], LinearFilter]] = {
    "cem": matched_filter_weights,
    "matched-filter": matched_filter_weights,
    "smf": spectral_matched_filter,
    "cem-correlation": cem_correlation_weights,
}


def design_filter(detector: str, target: npt.ArrayLike, mean: npt.ArrayLike, covariance: Covariance) -> LinearFilter:
    """The filter that ``detector`` names in :data:`FILTERS` (3.22-3.25); UsageError when unknown."""
    refuse(detector not in FILTERS, "detector.unknown", name=detector, names=", ".join(FILTERS))
    return FILTERS[detector](target, mean, covariance)


def principal_components(covariance: npt.ArrayLike, count: int) -> Array:
    """Psi (count, B) whose rows are the leading eigenvectors of a covariance (B, B), largest first (3.21).

    Raises
    ------
    UsageError : more components than bands, or none.
    """
    cov = np.asarray(covariance, dtype=float)
    refuse(not 1 <= count <= cov.shape[0], "features.count", count=count, shape=cov.shape)
    vectors = np.linalg.eigh(cov)[1][:, ::-1][:, :count].T
    # The sign of an eigenvector is arbitrary: the largest entry is made positive, so that runs agree.
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=1)[:, None], axis=1)
    return np.asarray(vectors * np.sign(largest))


def features(psi: npt.ArrayLike, spectra: npt.ArrayLike) -> Array:
    """F = Psi X of spectra (..., B) -> (..., F) (3.21)."""
    return np.asarray(np.asarray(spectra, dtype=float) @ np.asarray(psi, dtype=float).T)


def feature_covariance(psi: npt.ArrayLike, covariance: npt.ArrayLike) -> Array:
    """Psi Sigma Psi^T, (F, F) (3.21)."""
    p = np.asarray(psi, dtype=float)
    return np.asarray(p @ np.asarray(covariance, dtype=float) @ p.T)


@dataclass(frozen=True)
class FilterBase:
    """Background statistics of the filters of one truth, in the chosen features (3.21-3.25).

    Attributes
    ----------
    mean : (F,) of the mixture
    psi : (K, F) features, None for the bands themselves
    factor : the covariance in the features
    """

    mean: Array
    psi: Array | None
    factor: PositiveDefinite

    def project(self, spectrum: Array) -> Array:
        """A spectrum (F,) in the features (3.21)."""
        return spectrum if self.psi is None else features(self.psi, spectrum)

    def project_covariance(self, covariance: Array) -> Array:
        """A covariance (F, F) in the features (3.21)."""
        return covariance if self.psi is None else feature_covariance(self.psi, covariance)

    def design(self, detector: str, target: Array) -> LinearFilter:
        """The filter, as weights of the bands: w Psi of the filter in the features (3.21-3.25)."""
        weights, offset = design_filter(detector, self.project(target), self.project(self.mean), self.factor)
        return LinearFilter(weights if self.psi is None else weights @ self.psi, offset)


def filter_base(stated: Stated, view: Retrieved, u: int, bands: Index) -> FilterBase:
    """Mean and covariance of the background that the filter of one truth is built on, factorised (3.8, 3.11).

    Sum w_k [D_A g_k Sigma_k D_A + kappa g_k D_B Sigma_ave D_B + N_k + (mu_k - mu)(mu_k - mu)^T] with everything
    divided by the gains of the empirical line (3.11, 3.16-3.21).  Over the slopes of D_A on both sides it is one
    matrix: Sigma_ave times the sum of (e_k e_k^T) element by element, plus the sum of (d_k d_k^T), plus a diagonal.
    The sensor changes the diagonal alone; the rest is cached for the next truth.

    Raises
    ------
    UsageError : a matrix that can not be inverted.
    """
    classes, names, space = view.classes, stated.scenario.processing.filter_classes, stated.scenario.processing.features
    f = np.where([not names or name in names for name in stated.classes], truth_row(classes.fraction, u), 0.0)
    f = f / f.sum() if names else f
    weights, used, slope = f * truth_row(classes.gain, u), f > 0.0, truth_row(view.slope, u)
    f, means, noise = f[used], truth_row(view.means, u)[used], truth_row(view.noise, u)[used]
    mean, scale = f @ means, np.sqrt(f)[:, None] / slope
    adjacency, between = scale * truth_row(view.adjacency, u)[used], scale * (means - mean)

    def noiseless() -> Array:
        """The covariance over the slopes, without noise."""
        inner = classes.within_class(weights, u)
        total = add_products(np.empty_like(inner), adjacency, fresh=True)
        total *= classes.packed_covariance(u)
        total += inner
        return add_products(total, between)

    key = b"".join([weights.tobytes(), adjacency.tobytes(), between.tobytes(), classes.cache_key(u)])
    values = np.array(cached_matrix(classes.cache, "noiseless", key, noiseless))
    values[packed_diagonal(slope.size)] += f @ noise / slope**2
    if space is None:
        return FilterBase(mean, None, PositiveDefinite(values, slope, bands))
    covariance = unpack(values, slope.size) * np.outer(slope, slope)
    psi = principal_components(covariance, space.pca)
    return FilterBase(mean, psi, PositiveDefinite(feature_covariance(psi, covariance)))


def own_mean_sampling(
    weights: Array, mean: Array, covariance: PositiveDefinite, pixels: Array, stratum: npt.NDArray[np.int32], n: int
) -> tuple[float, float]:
    """Standard error and bias of the mean score of the n pixels that a "cem-correlation" filter was made of.

    With y = w x, T = 1/(w R w), P = R^-1 - T w w^T and u = 1 - mean^T P x, a pixel moves the mean w mean by y u/n, and
    the second order is -x^T P x y u/n^2.  The variance is that of y u within strata, whose sizes are fixed, each over
    1 - x^T P x/n as a pixel has a part in its own filter.  Of normal pixels, with a = t^T C^-1 mean/s,
    s = t^T C^-1 t and p = mean^T C^-1 mean - a^2 s: the mean is a/(1 + p), n times its variance
    1/(s (1 + p)) + a^2 (2 p^2 + 4 p)/(1 + p)^4.

    Parameters
    ----------
    weights, mean, covariance : of the filter and its background, (F,) and (F, F)
    pixels : (m, F) some of the pixels, drawn at random
    stratum : (m,) class of each
    """
    solved, theta = covariance.solve(mean), float(weights @ mean)
    size = 1.0 + float(mean @ solved)
    energy = 1.0 / (float(weights @ covariance.matrix @ weights) + theta**2)
    y, v = pixels @ weights, pixels @ solved / size
    white = covariance.whiten(pixels.T)
    loss = 1.0 - (np.einsum("fm,fm->m", white, white) - size * v**2 - energy * y**2) / n
    u = 1.0 - v + energy * theta * y
    z = y * u / loss
    variance = bias = 0.0
    for number in np.unique(stratum):
        in_stratum = stratum == number
        fraction = float(np.mean(in_stratum))
        variance += fraction * float(np.var(z[in_stratum], ddof=1)) if np.sum(in_stratum) > 1 else 0.0
        bias += fraction * float(np.mean((loss[in_stratum] - 1.0) * z[in_stratum]))
        xy, xu = (np.mean(pixels[in_stratum] * q[in_stratum, None], axis=0) for q in (y, u))
        x_p_y = covariance.solve(xy) - solved * float(solved @ xy) / size - energy * weights * float(weights @ xy)
        bias += fraction * float(xu @ x_p_y) / n
    return float(np.sqrt(variance / n)), bias


def fully_constrained(
    spectra: npt.ArrayLike, endmembers: npt.ArrayLike, noise: PositiveDefinite | None = None
) -> Array:
    """Abundances (..., 2) of spectra (..., B): non-negative, sum 1, least (x - a E)^T C^-1 (x - a E).

    The point of the line between the two endmembers that is nearest, clipped to its ends (problem of Heinz & Chang,
    IEEE TGRS 39, 529-545, 2001).

    Parameters
    ----------
    endmembers : (2, B), or (..., 2, B) with a pair of its own for each spectrum
    noise : covariance C; None: equal weights

    Raises
    ------
    UsageError : shapes that do not fit, or numbers that are not finite.
    """
    x, e = np.asarray(spectra, dtype=float), np.asarray(endmembers, dtype=float)
    refuse(e.shape[-2:] != (2, *x.shape[-1:]), "unmixing.shapes", spectra=x.shape, endmembers=e.shape)
    refuse(not (np.all(np.isfinite(x)) and np.all(np.isfinite(e))), "unmixing.finite")
    d = e[..., 0, :] - e[..., 1, :]
    # The endmembers are weighted and not the spectra, of which there are many.
    weighted = d if noise is None else noise.solve(d.reshape(-1, d.shape[-1]).T).T.reshape(d.shape)
    length = np.einsum("...b,...b->...", d, weighted)
    projection = np.einsum("...b,...b->...", x, weighted) - np.einsum("...b,...b->...", e[..., 1, :], weighted)
    a = np.clip(projection / length, 0.0, 1.0)
    return np.stack([a, 1.0 - a], axis=-1)
