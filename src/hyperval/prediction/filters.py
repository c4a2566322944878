"""Filters of many settings (3.21-3.25) and the scores of the classes (3.27, 3.29).

For each setting the background's covariance is put together in the form that one factorisation needs, in memory
that is used again; everything that goes through matrices that settings share goes through them together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dpocon, dpotrf, dpotrs

from hyperval.errors import UsageError
from hyperval.prediction.background import Ground, Seen, Settings
from hyperval.processing.features import (
    feature_covariance,
    features,
    minimum_noise_fraction,
    principal_components,
)
from hyperval.processing.filters import MAX_CONDITION, LinearFilter, PositiveDefinite, design_filter, solved_filter
from hyperval.scenario import Processing

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
# Below this ratio of the factor's diagonal, squared, a matrix can not be near the limit of the condition number in
# practice; above it the condition number is estimated.
_SUSPECT = 1e8
_BLOCK = 90  # columns


@dataclass(frozen=True)
class Filters:
    """Linear detectors of U settings: score = weights . x - offset.

    ``weights`` (U, F), ``offset`` (U,); NaN where there is none.
    """

    weights: Array
    offset: Array

    def rows(self, index: Index) -> Filters:
        """The settings that ``index`` names."""
        return Filters(self.weights[index], self.offset[index])


@dataclass(frozen=True)
class Population:
    """Target pixels in the statistics of a filter, as parts of the background are.

    Attributes
    ----------
    part : of the scene [1]
    covariance : (F, F) of reflectance, gains and light included (3.12)
    around, mean, noise : (F,) as those of a class in :class:`Seen`
    """

    part: float
    covariance: Array
    around: Array
    mean: Array
    noise: Array


PopulationsOf = Callable[[int], Sequence[Population]]


@dataclass(frozen=True)
class Mixture:
    """The background of one setting, as its filter's covariance is put together.

    Sum w_k [D_A g_k Sigma_k D_A + kappa g_k D_B Sigma_ave D_B + N_k + (mu_k - mu)(mu_k - mu)^T] with everything
    divided by the gains of the empirical line (3.11, 3.16-3.21): the first part is one matrix under (a a^T), the
    second Sigma_ave under the sum of (e_k e_k^T), element by element, the last the sum of (d_k d_k^T).

    Attributes
    ----------
    mean : (F,) mu
    reflectance : (F, F) sum w_k g_k Sigma_k
    surroundings : (F, F) Sigma_ave
    slope : (F,) a;  around, between : (K, F) e, d
    noise : (F,) sum w_k N_k
    """

    mean: Array
    reflectance: Array
    surroundings: Array
    slope: Array
    around: Array
    between: Array
    noise: Array

    def diagonal(self) -> Array:
        """(F,) variances."""
        found = (
            self.slope**2 * self.reflectance.diagonal()
            + (self.around**2).sum(axis=0) * self.surroundings.diagonal()
        )
        return np.asarray(found + (self.between**2).sum(axis=0) + self.noise)

    def lower(self, scale: Array, matrix: Array) -> Array:
        """Lower triangle of the covariance under (scale scale^T), without its diagonal, which is 1, in ``matrix``.

        In blocks that stay in the processor's cache; above the blocks' diagonal the memory holds anything.
        """
        a, e, d, size = self.slope * scale, self.around * scale, self.between * scale, scale.size
        for start in range(0, size, _BLOCK):
            rows, columns = slice(start, size), slice(start, min(start + _BLOCK, size))
            # Symmetric matrices in C order: the block of columns is taken as rows, so that memory runs along.
            part = np.multiply(a[columns, None], a[rows])
            part *= self.reflectance[columns, rows]
            around = e[:, columns].T @ e[:, rows]
            around *= self.surroundings[columns, rows]
            part += around
            part += d[:, columns].T @ d[:, rows]
            matrix.T[columns, rows] = part
        matrix.T.flat[:: size + 1] = 1.0
        return matrix

    def covariance(self) -> Array:
        """(F, F) whole."""
        lower = np.tril(self.lower(np.ones(self.mean.size), np.zeros((self.mean.size,) * 2, order="F")), -1)
        return np.asarray(lower + lower.T + np.diag(self.diagonal()))


@dataclass(frozen=True)
class FilterBase:
    """What filters of one setting are built on, in the features chosen (3.21-3.25).

    Attributes
    ----------
    mean : (F,) of the mixture
    psi : (K, F) features, None for the bands themselves
    factor : the covariance in the features
    """

    mean: Array
    psi: Array | None
    factor: PositiveDefinite

    def of(self, spectrum: Array) -> Array:
        """A spectrum (F,) in the features (3.21)."""
        return spectrum if self.psi is None else features(self.psi, spectrum)

    def spread(self, covariance: Array) -> Array:
        """A covariance (F, F) in the features (3.21)."""
        return covariance if self.psi is None else feature_covariance(self.psi, covariance)

    def filter(self, detector: str, target: Array) -> LinearFilter:
        """The filter, as weights of the bands: w Psi of the filter in the features (3.21-3.25)."""
        found = design_filter(detector, self.of(target), self.of(self.mean), self.factor)
        return found if self.psi is None else replace(found, weights=found.weights @ self.psi)


class Designer:
    """Filters of the settings for targets and detectors, the matrices of each setting factorised once.

    Parameters
    ----------
    processing : features, classes of the filter
    classes : names of the background classes
    size : F, number of the detector's bands
    """

    def __init__(self, processing: Processing, classes: Sequence[str], size: int):
        self.processing = processing
        names = processing.filter_classes
        self._chosen = np.array([not names or n in names for n in classes])
        self._matrix = np.zeros((size, size), order="F")
        self._mixed: tuple[tuple[object, ...], Array, tuple[Array, ...]] | None = None

    def mixture(self, at: Settings, seen: Seen, u: int, populations: Sequence[Population] = ()) -> Mixture:
        """The background that the filter of setting ``u`` is built on (3.8, 3.11 of what is seen)."""
        ground = at.grounds[at.which[u]]
        chosen = self._chosen & (at.fractions[u] > 0.0)
        fraction = at.fractions[u][chosen]
        parts = np.array([p.part for p in populations])
        fraction = (1.0 - parts.sum()) * fraction / (1.0 if chosen.all() else at.fractions[u][self._chosen].sum())
        weights = np.concatenate([fraction, parts])
        reflectance = self._reflectance(fraction * at.gains[u][chosen], np.flatnonzero(chosen), ground)
        around, means, noise = seen.around[u][chosen], seen.means[u][chosen], seen.noise[u][chosen]
        if populations:
            reflectance = reflectance + sum(p.part * p.covariance for p in populations)
            around = np.vstack([around, *(p.around for p in populations)])
            means = np.vstack([means, *(p.mean for p in populations)])
            noise = np.vstack([noise, *(p.noise for p in populations)])
        mean, root = weights @ means, np.sqrt(weights)[:, None]
        return Mixture(
            mean,
            reflectance,
            ground.covariance,
            seen.slope[u],
            root * around,
            root * (means - mean),
            weights @ noise,
        )

    def base(self, mixture: Mixture, noise_at: Callable[[Array], Array]) -> FilterBase:
        """The mixture in the features, factorised; ``noise_at`` gives the noise at a retrieved reflectance (F,).

        Raises
        ------
        UsageError : a matrix that can not be inverted.
        """
        covariance, choice, psi = mixture.covariance(), self.processing.features, None
        if choice is not None and choice.pca is not None:
            psi = principal_components(covariance, choice.pca)
        elif choice is not None and choice.mnf is not None:
            psi = minimum_noise_fraction(covariance, noise_at(mixture.mean), choice.mnf)
        return FilterBase(
            mixture.mean, psi, PositiveDefinite(covariance if psi is None else feature_covariance(psi, covariance))
        )

    def design(
        self,
        at: Settings,
        seen: Seen,
        wanted: Sequence[tuple[str, Array]],
        populations: PopulationsOf | None = None,
    ) -> tuple[list[Filters], dict[int, UsageError]]:
        """Filters for pairs of detector and spectrum as seen (U, F); setting -> what is wrong with it."""
        size = self._matrix.shape[0]
        found = [Filters(np.full((len(at), size), np.nan), np.full(len(at), np.nan)) for _ in wanted]
        problems: dict[int, UsageError] = {}
        for u in range(len(at)):
            mixture = self.mixture(at, seen, u, populations(u) if populations else ())
            spectra = [(detector, spectrum[u]) for detector, spectrum in wanted]
            try:
                if self.processing.features is None:
                    filters = self._solved(mixture, spectra)
                else:
                    base = self.base(mixture, lambda r, u=u: noise_of(at, seen, u, r))  # type: ignore[misc]
                    filters = [base.filter(detector, spectrum) for detector, spectrum in spectra]
            except UsageError as error:
                problems[u] = error
                continue
            for into, one in zip(found, filters, strict=True):
                into.weights[u], into.offset[u] = one.weights, one.offset
        return found, problems

    def _solved(self, mixture: Mixture, spectra: Sequence[tuple[str, Array]]) -> list[LinearFilter]:
        """Filters on the bands themselves, one factorisation for all that invert the same matrix."""
        out: dict[int, LinearFilter] = {}
        for correlation in (False, True):
            members = [i for i, (d, _) in enumerate(spectra) if (d == "cem-correlation") is correlation]
            if not members:
                continue
            # R = Sigma + mu mu^T in place of Sigma, and no mean taken off.
            matrix = mixture
            if correlation:
                matrix = replace(mixture, between=np.vstack([mixture.between, mixture.mean]))
            factor, scale = self._factor(matrix)
            centre = np.zeros_like(mixture.mean) if correlation else mixture.mean
            for i in members:
                d = spectra[i][1] - centre  # (3.22)
                solved, _ = dpotrs(factor, d * scale, lower=1)
                out[i] = solved_filter(spectra[i][0], d, solved * scale, mixture.mean)
        return [out[i] for i in range(len(spectra))]

    def _reflectance(self, weights: Array, chosen: Index, ground: Ground) -> Array:
        """Sum over classes of w_m Sigma_m; kept while weights and covariances stay."""
        covariances = ground.covariances
        key = (weights.tobytes(), chosen.tobytes(), *(id(c) for c in covariances))
        if self._mixed is None or self._mixed[0] != key:
            if ground.stack is not None:
                whole = np.zeros(len(covariances))
                whole[chosen] = weights
                total = (whole @ ground.stack.reshape(whole.size, -1)).reshape(self._matrix.shape)
            else:
                total = np.zeros(self._matrix.shape)
                for w, m in zip(weights, chosen, strict=True):
                    total += w * covariances[m]
            self._mixed = key, total, covariances  # those whose numbers the key holds stay in memory
        return self._mixed[1]

    def _factor(self, mixture: Mixture) -> tuple[Array, Array]:
        """Cholesky factor of the background matrix at unit diagonal, and its scale.

        Raises
        ------
        UsageError : as :class:`PositiveDefinite`.
        """
        diagonal = mixture.diagonal()
        if not np.all(diagonal > 0) or not np.all(np.isfinite(diagonal)):
            raise _refusal(mixture)
        scale = 1.0 / np.sqrt(diagonal)
        factor, info = dpotrf(mixture.lower(scale, self._matrix), lower=1, overwrite_a=1, clean=0)
        if info:
            raise _refusal(mixture)
        pivots = factor.diagonal()
        if (pivots.max() / pivots.min()) ** 2 > _SUSPECT:
            factor = factor.copy(order="F")
            lower = np.tril(mixture.lower(scale, self._matrix))
            norm = np.abs(lower + lower.T - np.eye(lower.shape[0])).sum(axis=0).max()
            reciprocal, _ = dpocon(factor, norm, uplo="L")
            if not reciprocal * MAX_CONDITION >= 1.0:
                raise _refusal(mixture)
        return factor, scale


def _refusal(mixture: Mixture) -> UsageError:
    """What is wrong with a matrix that has no factor, in the words of :class:`PositiveDefinite`."""
    try:
        PositiveDefinite(mixture.covariance())
    except UsageError as error:
        return error
    return UsageError("the background matrix is singular to working precision")


def noise_of(at: Settings, seen: Seen, u: int, reflectance: Array) -> Array:
    """Noise variance (F,) of a retrieved reflectance (F,) in setting ``u`` (3.16-3.19)."""
    gain, offset = seen.gain[u, 0], seen.offset[u, 0]
    return np.asarray(at.view.row(u).noise_variance(offset + gain * reflectance) / gain**2)


def class_scores(at: Settings, seen: Seen, filters: Filters) -> tuple[Array, Array]:
    """theta_m and sigma_m (U, M) of the background's classes (3.27, 3.29)."""
    w = filters.weights
    means = np.einsum("uf,umf->um", w, seen.means) - filters.offset[:, None]  # (3.27)
    variances = np.einsum("uf,umf->um", w**2, seen.noise)
    through = (w * seen.slope)[:, None, :]
    for m in range(seen.means.shape[1]):

        def covariance(ground: Ground, number: int = m) -> Array:
            return ground.covariances[number]

        variances[:, m] += at.gains[:, m] * at.spread(through, covariance)[:, 0]
    variances += at.spread(w[:, None, :] * seen.around, lambda g: g.covariance)
    return means, np.sqrt(np.maximum(variances, 0.0))  # (3.29)
