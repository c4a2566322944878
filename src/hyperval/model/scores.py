"""Filters of U truths (3.21-3.25) and the scores of classes (3.27, 3.29) and of target pixels (3.26, 3.28).

For each truth the background's covariance is put together packed, in memory that is used again, and factorised once;
everything that goes through matrices that truths share goes through them together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.model.classification import feature_covariance, features, minimum_noise_fraction, principal_components
from hyperval.model.filters import (
    MAX_CONDITION,
    LinearFilter,
    PositiveDefinite,
    add_products,
    condition_number,
    design_filter,
    diagonal_places,
    factor,
    near_singular,
    solved,
    solved_filter,
    unpacked,
)
from hyperval.model.radiance import (
    Background,
    Light,
    Seen,
    TwoPanelLine,
    of_truth,
    retrieved_reflectance,
    spread,
    target_pixel_reflectance,
    wide,
)
from hyperval.scenario import Processing

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Filters:
    """Linear detectors of U truths: score = weights . x - offset.

    ``weights`` (U, F), ``offset`` (U,); NaN where there is none.
    """

    weights: Array
    offset: Array

    def rows(self, index: Index) -> Filters:
        """Of some truths."""
        return Filters(self.weights[index], self.offset[index])


@dataclass(frozen=True, eq=False)
class Mixture:
    """The background of one truth, as its filter's covariance is put together.

    Sum w_k [D_A g_k Sigma_k D_A + kappa g_k D_B Sigma_ave D_B + N_k + (mu_k - mu)(mu_k - mu)^T] with everything
    divided by the gains of the empirical line (3.11, 3.16-3.21).  Over the slopes of D_A on both sides it is one
    matrix, Sigma_ave element by element under the sum of (e_k e_k^T), the sum of (d_k d_k^T), and a diagonal: what
    the sensor changes is the diagonal alone.

    Attributes
    ----------
    mean : (F,) mu
    reflectance : (P,) sum w_k g_k Sigma_k, packed
    surroundings : (P,) Sigma_ave, packed
    slope : (F,) D_A over the gain;  around, between : (K, F) e, d
    noise : (F,) sum w_k N_k over the square of the slope
    """

    mean: Array
    reflectance: Array
    surroundings: Array
    slope: Array
    around: Array
    between: Array
    noise: Array

    def without_noise(self, memory: Array) -> Array:
        """(P,) the covariance over the slopes but for the noise, packed, in ``memory``."""
        total = add_products(memory, self.around, fresh=True)
        total *= self.surroundings
        total += self.reflectance
        return add_products(total, self.between)

    def shares_light(self, other: Mixture) -> bool:
        """Whether the covariance differs from that of another by the noise alone."""
        return (
            self.reflectance is other.reflectance
            and self.surroundings is other.surroundings
            and np.array_equal(self.around, other.around)
            and np.array_equal(self.between, other.between)
        )

    def covariance(self) -> Array:
        """(F, F) whole."""
        inner = unpacked(self.without_noise(np.empty_like(self.reflectance)), self.mean.size)
        return (inner + np.diag(self.noise)) * np.outer(self.slope, self.slope)


@dataclass(frozen=True)
class FilterBase:
    """What filters of one truth are built on, in the features chosen (3.21-3.25).

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
        of_features = design_filter(detector, self.of(target), self.of(self.mean), self.factor)
        if self.psi is None:
            return of_features
        return replace(of_features, weights=of_features.weights @ self.psi)


class Designer:
    """Filters of the truths for targets and detectors, the matrices of each truth factorised once.

    Parameters
    ----------
    chosen : (M,) which classes the filter is made of
    """

    def __init__(self, processing: Processing, chosen: npt.NDArray[np.bool_], size: int):
        self.processing, self._chosen, self._size = processing, chosen, size
        # Memory of two matrices: the covariance of the latest light without its noise, and one to factorise.
        self._still, self._matrix = np.empty((2, size * (size + 1) // 2))
        self._latest: Mixture | None = None

    def mixture(self, of: Background, seen: Seen, u: int) -> Mixture:
        """The background that the filter of one truth is built on (3.8, 3.11 of what is seen)."""
        fractions = np.where(self._chosen, of_truth(of.fraction, u), 0.0)
        used = fractions > 0.0
        if not self._chosen.all():
            fractions = fractions / fractions.sum()
        reflectance = of.packed(fractions * of_truth(of.gain, u), u)
        f, slope, means = fractions[used], of_truth(seen.slope, u), of_truth(seen.means, u)[used]
        mean, under = f @ means, np.sqrt(f)[:, None] / slope
        return Mixture(
            mean, reflectance, of.packed_surroundings(u), slope, under * of_truth(seen.around, u)[used],
            under * (means - mean), f @ of_truth(seen.noise, u)[used] / slope**2,
        )  # fmt: skip

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
        self, light: Light, of: Background, seen: Seen, truths: int, wanted: Sequence[tuple[str, Array]]
    ) -> tuple[list[Filters], dict[int, UsageError]]:
        """Filters for pairs of detector and spectrum as seen (U or 1, F); truth -> what is wrong with it."""
        each = [Filters(np.full((truths, self._size), np.nan), np.full(truths, np.nan)) for _ in wanted]
        problems: dict[int, UsageError] = {}
        for u in range(truths):
            spectra = [(detector, of_truth(spectrum, u)) for detector, spectrum in wanted]
            try:
                mixture = self.mixture(of, seen, u)
                if self.processing.features is None:
                    filters = self._solved(mixture, spectra)
                else:
                    base = self.base(mixture, lambda r, u=u: noise_of(light, seen, u, r))  # type: ignore[misc]
                    filters = [base.filter(detector, spectrum) for detector, spectrum in spectra]
            except UsageError as error:
                problems[u] = error
                continue
            for into, one in zip(each, filters, strict=True):
                into.weights[u], into.offset[u] = one.weights, one.offset
        return each, problems

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
                mean = mixture.mean / mixture.slope  # the parts of a mixture stand over the slopes
                matrix = replace(mixture, between=np.vstack([mixture.between, mean]))
            centre = np.zeros_like(mixture.mean) if correlation else mixture.mean
            differences = np.array([spectra[i][1] - centre for i in members])  # (3.22)
            for i, d, x in zip(members, differences, self._solutions(matrix, differences), strict=True):
                out[i] = solved_filter(spectra[i][0], d, x, mixture.mean)
        return [out[i] for i in range(len(spectra))]

    def _solutions(self, mixture: Mixture, right: Array) -> Array:
        """(K, F) solutions x of covariance x = right (K, F).

        Raises
        ------
        UsageError : as :class:`PositiveDefinite`.
        """
        if self._latest is None or not self._latest.shares_light(mixture):
            self._latest = None  # should anything go wrong below, the memory holds no covariance
            self._still = mixture.without_noise(self._still)
            self._latest = mixture
        matrix, places = self._matrix, diagonal_places(self._size)
        matrix[:] = self._still
        matrix[places] += mixture.noise
        diagonal = matrix[places]
        if not np.all(diagonal > 0) or not np.all(np.isfinite(diagonal)):
            raise _refusal(mixture)
        cholesky = factor(matrix, self._size)
        if cholesky is None:
            raise _refusal(mixture)
        if near_singular(diagonal, cholesky):
            values = self._still.copy()
            values[places] = diagonal
            if not condition_number(values, cholesky, self._size) <= MAX_CONDITION:
                raise _refusal(mixture)
        return solved(cholesky, (right / mixture.slope).T).T / mixture.slope


def _refusal(mixture: Mixture) -> UsageError:
    """What is wrong with a matrix that has no factor, in the words of :class:`PositiveDefinite`."""
    try:
        PositiveDefinite(mixture.covariance())
    except UsageError as error:
        return error
    return UsageError("the background matrix is singular to working precision")


def noise_of(light: Light, seen: Seen, u: int, reflectance: Array) -> Array:
    """Noise variance (F,) of a retrieved reflectance (F,) in one truth (3.16-3.19)."""
    gain, offset = (of_truth(x, u)[0] for x in (seen.gain, seen.offset))
    return np.asarray(light.row(u).noise_variance(offset + gain * reflectance) / gain**2)


def class_scores(of: Background, seen: Seen, filters: Filters) -> tuple[Array, Array]:
    """theta_m and sigma_m (U, J) of the laws that the background's classes are made of (3.27, 3.29).

    A component of a class lies off its mean and has a covariance of its own; noise and surroundings are those of
    the class.  A linear filter makes a normal law normal and a t law a t law: the scores have a closed form.
    """
    w, laws = filters.weights, of.laws
    owner, truths = np.array([law.owner for law in laws]), len(filters.weights)

    means = (np.einsum("uf,umf->um", w, wide(seen.means, truths)) - filters.offset[:, None])[:, owner]  # (3.27)
    variances = np.einsum("uf,umf->um", w**2, wide(seen.noise, truths))[:, owner]
    through = (w * seen.slope)[:, None, :]
    for j, law in enumerate(laws):
        gain, stretch = of.gain[:, law.owner], of.stretch[:, law.owner]
        variances[:, j] += gain * spread(through, law.covariance, stretch)[:, 0]
        if law.offset is not None:
            means[:, j] += np.sqrt(gain) * np.einsum("uf,uf->u", through[:, 0], wide(stretch * law.offset, truths))
    variances += of.surroundings(w[:, None, :] * seen.around)[:, owner]
    return means, np.sqrt(np.maximum(variances, 0.0))  # (3.29)


# Mean and variance of a score are at most quadratic in the fill, which a cubic spline carries exactly.
FILL_NODES = np.linspace(0.0, 1.0, 9)


@cache
def _spline() -> CubicSpline:
    from scipy.interpolate import CubicSpline  # a quarter of a second, which spectra alone do not need

    return CubicSpline(FILL_NODES, np.eye(FILL_NODES.size))


@dataclass(frozen=True)
class Responses:
    """Score moments against the fill, in R truths.

    Attributes
    ----------
    means : (R, 9) at FILL_NODES (3.26)
    own, host : (R,) score variance of a pixel full of target without its gain, and of host with it
    rest : (R, 9) surroundings and noise (3.28)
    error : (R,) standard deviation of the score of a full pixel by the error of the target's spectrum
    fine : (R,) part of ``own`` whose texture is finer than the target's part of a pixel
    """

    means: Array
    own: Array
    host: Array
    rest: Array
    error: Array
    fine: Array

    @staticmethod
    def weights(fills: Array) -> Array:
        """(..., 9) weights of the values at FILL_NODES in the value at fills (...)."""
        return np.asarray(_spline()(fills))

    def variances(self, target_gain: Array, rows: Index) -> Array:
        """(n, 9) at FILL_NODES, of n evaluations of given rows (3.28)."""
        f = FILL_NODES
        square = f**2 + self.fine[rows, None] * (f - f**2)
        own = square * (target_gain * self.own[rows])[:, None] + (1.0 - f) ** 2 * self.host[rows, None]
        return np.asarray(own + self.rest[rows])  # (3.28)

    def at(self, fills: Array, target_gain: Array, rows: Index, shift: Array | float = 0.0) -> tuple[Array, Array]:
        """Means and standard deviations (n, K) at fills (n, K) or (1, K), for n evaluations of given rows.

        ``shift`` (n,) : by how many standard deviations of the score the true target departs from its spectrum
        """
        variance, weights = self.variances(target_gain, rows), self.weights(fills)  # (n, 9), (n or 1, K, 9)
        means = (weights * self.means[rows][:, None, :]).sum(axis=2)
        means = means + (np.asarray(shift) * self.error[rows])[:, None] * fills
        return means, np.sqrt(np.clip((weights * variance[:, None, :]).sum(axis=2), 0.0, None))


@dataclass(frozen=True)
class Material:
    """A target, its host and its light, in U truths.

    Attributes
    ----------
    mean : (U or 1, F) its reflectance
    covariance, stretch : (F, F), and (U or 1, F or 1) factor on both sides of it
    fine_texture : (U or 1,) part of it whose texture is finer than the target's part of a pixel
    host : number of its host's class
    beam, sky : (U or 1,) parts of the light in the open that reach it
    error : (K, F) directions of the error of its spectrum; None where nothing is stated
    """

    mean: Array
    covariance: Array
    stretch: Array
    fine_texture: Array
    host: int
    beam: Array
    sky: Array
    error: Array | None = None


class TargetPixels(NamedTuple):
    """Pixels of which a target fills K parts f, as the detector sees them in U truths.

    Attributes
    ----------
    means, noise : (U or 1, K, F) retrieved reflectance, and its noise variance
    around : (U or 1, 1, F) D_B / k times the root of g_m kappa (3.11) of a pixel of host, and of one full of target
    factor : (U, 1, F) light on the target over that in the open, 1 without shade
    """

    means: Array
    noise: Array
    around: tuple[Array, Array]
    factor: Array | float


def target_pixels(light: Light, of: Background, seen: Seen, material: Material, fills: Array) -> TargetPixels:
    """Target pixels at fills (K,), each with its own mean, noise and adjacency (3.7-3.12)."""
    number = material.host
    lit, under_sky, factor = light.surface(material.mean, material.beam, material.sky)
    host = of.means[:, number : number + 1]
    level = light.level(target_pixel_reflectance(fills, lit, host))  # (3.9), (3.10)
    means = retrieved_reflectance(TwoPanelLine(seen.gain, seen.offset), level)
    weight = np.sqrt(of.gain[:, number, None, None] * light.kappa) / seen.gain
    around = light.adjacency_slope(host) * weight, light.adjacency_slope(under_sky) * weight
    return TargetPixels(means, light.noise_variance(level) / seen.gain**2, around, factor)


def target_scores(light: Light, of: Background, seen: Seen, filters: Filters, material: Material) -> Responses:
    """Score statistics of pixels of which the target fills f, at FILL_NODES (3.26, 3.28).

    Var(f) comes in by the average over the fill.
    """
    number, w, g = material.host, filters.weights, FILL_NODES
    truths, bands = w.shape
    pixels = target_pixels(light, of, seen, material, g)
    means = np.einsum("uf,ukf->uk", w, wide(pixels.means, truths)) - filters.offset[:, None]  # (3.26)
    rest = np.einsum("ukf,uf->uk", wide(pixels.noise, truths), w**2)  # noise of (3.28)
    # D_B is linear in the reflectance, so that its part of the variance is a square in the fill.
    v = w[:, None, :] * np.concatenate([np.broadcast_to(x, (truths, 1, bands)) for x in pixels.around], axis=1)
    parts = of.surroundings(np.concatenate([v, v[:, :1] + v[:, 1:]], axis=1))
    zero, one, both = parts[:, :1], parts[:, 1:2], parts[:, 2:]
    rest = rest + (1.0 - g) ** 2 * zero + g**2 * one + g * (1.0 - g) * (both - zero - one)
    through = (w * seen.slope)[:, None, :]
    lit_through, error = through * pixels.factor, np.zeros(truths)
    if material.error is not None:
        error = np.linalg.norm(lit_through[:, 0] @ material.error.T, axis=1)
    own = spread(lit_through, material.covariance, material.stretch)[:, 0]
    behind = spread(through, of.covariances[number], of.stretch[:, number])[:, 0]
    fine = np.broadcast_to(material.fine_texture, (truths,))
    return Responses(means, own, of.gain[:, number] * behind, rest, error, fine)
