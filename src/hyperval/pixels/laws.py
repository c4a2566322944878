"""Distributions of a region's pixels: tails, mixtures, and the jackknife over parts of the image.

Tails are the degrees of freedom of a multivariate t, from Mahalanobis distances.  A class such as "built-up" is roofs,
roads and cars, and no single law: mixtures of normal or t laws are fitted by expectation and maximisation in a few
leading components of standardised values and carried to all bands.  Since neighbouring pixels resemble each other, the
jackknife leaves out parts of the image, not pixels (Künsch, Ann. Stat. 17, 1217-1241, 1989).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy
from scipy.special import chdtrc, digamma, fdtrc, gammaln, ndtr

from hyperval.data import Array, Components, Index
from hyperval.errors import refuse
from hyperval.pixels.statistics import EigenDirections

MIN_DOF = 2.05  # of a t law: the covariance is finite; a heavier tail is held just above it
MAX_DOF = 200.0  # beyond, indistinguishable from the normal law
STEPS = 100
_TOLERANCE = 1e-4  # of the penalised log likelihood of one pixel
_LLOYD_STEPS = 10
_START_DOF = 10.0
TRIED_DOF = (None, 16.0, 8.0, 4.0)
FOLDS = 4  # of the cross-validation: parts of the image left out in turn


@dataclass(frozen=True, eq=False)
class MixtureFit:
    """K laws in P dimensions.

    Attributes
    ----------
    weights, means, scales : (K,), (K, P), (K, P, P); the covariance is the scale times dof/(dof - 2)
    dof : degrees of freedom common to all; inf: normal laws
    history : penalised log likelihood of a pixel at every step
    """

    weights: Array
    means: Array
    scales: Array
    dof: float
    history: tuple[float, ...] = ()

    @cached_property
    def inverse_roots(self) -> Array:
        """(K, P, P) inverses of the Cholesky factors of the scales."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.scales)))

    def log_densities(self, monomials: Array) -> tuple[Array, Array]:
        """log of weight times density, and the squared distance over the scale, (K, n) each, by :func:`_monomials`."""
        inverse, p = self.inverse_roots, self.means.shape[1]
        precision = inverse.transpose(0, 2, 1) @ inverse
        linear = np.einsum("kij,kj->ki", precision, self.means)
        square = np.einsum("ki,ki->k", linear, self.means)
        upper, lower = np.triu_indices(p)
        products = precision[:, upper, lower] * np.where(upper == lower, 1.0, 2.0)
        squares = np.concatenate([square[:, None], -2.0 * linear, products], axis=1) @ monomials
        np.maximum(squares, 0.0, out=squares)  # negative by rounding alone
        constant = np.log(self.weights) + np.log(np.einsum("kii->ki", inverse)).sum(axis=1)
        if np.isinf(self.dof):
            return (constant - 0.5 * p * np.log(2.0 * np.pi))[:, None] - 0.5 * squares, squares
        nu = self.dof
        constant += gammaln(0.5 * (nu + p)) - gammaln(0.5 * nu) - 0.5 * p * np.log(nu * np.pi)
        return constant[:, None] - 0.5 * (nu + p) * np.log1p(squares / nu), squares

    def log_density(self, x: Array) -> Array:
        """(n,) log density of values (n, P)."""
        return _log_sum_and_shares(self.log_densities(_monomials(x))[0])[0]

    def responsibilities(self, x: Array) -> tuple[Array, Array]:
        """(K, n) probability that a value belongs to a law, and the weight it has in the moments of that law.

        The weight is (dof + P)/(dof + d^2) of a t law (Peel & McLachlan, Stat. Comput. 10, 339-348, 2000), 1 of a
        normal one.
        """
        log_parts, squares = self.log_densities(_monomials(x))
        return _log_sum_and_shares(log_parts)[1], _tail_weight(squares, self.dof, x.shape[1])


def fit_mixture(
    values: npt.ArrayLike,
    count: int,
    rng: np.random.Generator,
    *,
    dof: float | None = np.inf,
    prior_pixels: float | None = None,
    starts: int = 2,
) -> MixtureFit:
    """The mixture of greatest penalised likelihood, of some starts.

    A component of few pixels would shrink onto them: each scale has an inverse Wishart prior worth
    ``prior_pixels``, about a ball of the volume that is left to each of K components, K^(-2/P) (Fraley & Raftery,
    J. Classif. 24, 155-181, 2007).  Expectation and maximisation never lower the likelihood that is so penalised.

    Parameters
    ----------
    values : (n, P) standardised: mean 0 and covariance 1 in all
    count : K components
    dof : of t laws; inf: normal laws; None: fitted, one for all
    prior_pixels : None: P + 1

    Raises
    ------
    UsageError : fewer values than 2 K.
    """
    x = np.asarray(values, dtype=float)
    n, p = x.shape
    refuse(count < 1 or n < 2 * count, "mixture.pixels", count=count, n=n)
    prior = p + 1.0 if prior_pixels is None else prior_pixels
    fits = (_em_fit(x, _nearest_centres(x, count, rng), dof, prior) for _ in range(starts if count > 1 else 1))
    return max(fits, key=lambda fit: fit.history[-1])


def refit(values: Array, fit: MixtureFit) -> MixtureFit:
    """The fit to other values (n, P), started from ``fit``, with as many laws; degrees of freedom stay if chosen.

    For samples without one of their parts; a fresh start could end in another maximum.
    """
    chosen = np.isinf(fit.dof) or fit.dof in TRIED_DOF
    return _em_fit(values, fit.responsibilities(values)[0], fit.dof if chosen else None, values.shape[1] + 1.0)


def _em_fit(x: Array, probability: Array, dof: float | None, prior: float) -> MixtureFit:
    """Expectation and maximisation from probabilities (K, n)."""
    n, p = x.shape
    count = probability.shape[0]
    ball = count ** (-2.0 / p)
    nu = _START_DOF if dof is None else dof
    tail_weight = np.ones_like(probability)
    monomials = _monomials(x)
    upper, lower = np.triu_indices(p)
    history: list[float] = []
    for _ in range(STEPS):
        size = probability.sum(axis=1)
        occupied = size > 1e-8 * n  # a component that no pixel belongs to has no law
        if not occupied.all():
            probability, tail_weight, size = probability[occupied], tail_weight[occupied], size[occupied]
            ball *= (count / size.size) ** (2.0 / p)
            count = size.size
            history.clear()  # another mixture, with another likelihood
        weighted = probability * tail_weight
        moments = weighted @ monomials.T
        weight = moments[:, 0]
        means = moments[:, 1 : p + 1] / weight[:, None]
        scales = np.empty((count, p, p))
        scatter = moments[:, p + 1 :] - weight[:, None] * means[:, upper] * means[:, lower]
        scales[:, upper, lower] = scales[:, lower, upper] = scatter
        scales = (scales + prior * ball * np.eye(p)) / (size + prior)[:, None, None]
        if dof is None and history:
            nu = _updated_dof(nu, p, probability, tail_weight)
        fit = MixtureFit(size / size.sum(), means, scales, nu)
        log_parts, squares = fit.log_densities(monomials)
        log_density, probability = _log_sum_and_shares(log_parts)
        history.append(float(log_density.mean()) - _penalty(fit.inverse_roots, ball, prior) / n)
        tail_weight = _tail_weight(squares, nu, p)
        if len(history) > 1 and history[-1] - history[-2] < _TOLERANCE:
            break
    return replace(fit, history=tuple(history))


def _monomials(x: Array) -> Array:
    """(1 + P + P (P + 1)/2, n) the powers of values (n, P) up to the second: a square form is linear in them."""
    upper, lower = np.triu_indices(x.shape[1])
    columns = x.T
    return np.concatenate([np.ones((1, x.shape[0])), columns, columns[upper] * columns[lower]])


def _tail_weight(squares: Array, dof: float, dimensions: int) -> Array:
    return np.ones_like(squares) if np.isinf(dof) else (dof + dimensions) / (dof + squares)


def _log_sum_and_shares(log_parts: Array) -> tuple[Array, Array]:
    """log of the sum (n,) of parts (K, n), and the share of each; scipy's logsumexp is three times as slow."""
    greatest = log_parts.max(axis=0)
    parts = np.exp(log_parts - greatest)
    total = parts.sum(axis=0)
    parts /= total
    return greatest + np.log(total), parts


def _penalty(inverse_roots: Array, ball: float, prior: float) -> float:
    """Minus the log density of the prior of all scales about ``ball`` times the unit matrix, up to a constant."""
    log_det = -2.0 * np.log(np.einsum("kii->ki", inverse_roots)).sum()
    return float(0.5 * prior * (log_det + ball * np.sum(inverse_roots**2)))


def _updated_dof(nu: float, p: int, probability: Array, weight: Array) -> float:
    """Degrees of freedom of greatest expected likelihood, given shares and weights at ``nu`` (Peel & McLachlan)."""
    mean = float((probability * (np.log(weight) - weight)).sum() / probability.sum())
    mean += float(digamma(0.5 * (nu + p)) - np.log(0.5 * (nu + p)))

    def slope(v: float) -> float:
        return math.log(0.5 * v) - float(digamma(0.5 * v)) + 1.0 + mean

    if slope(MIN_DOF) <= 0.0:
        return MIN_DOF
    return MAX_DOF if slope(MAX_DOF) >= 0.0 else float(scipy.optimize.brentq(slope, MIN_DOF, MAX_DOF))


def _nearest_centres(x: Array, count: int, rng: np.random.Generator) -> Array:
    """(K, n) 1 for the nearest of K centres, by the iterations of Lloyd from spread-out pixels (k-means++)."""
    centres = x[rng.integers(x.shape[0])][None]
    squares = np.sum((x - centres[0]) ** 2, axis=1)
    for _ in range(count - 1):
        total = float(squares.sum())
        k = rng.choice(x.shape[0], p=squares / total) if total > 0.0 else rng.integers(x.shape[0])
        centres = np.vstack([centres, x[k]])
        squares = np.minimum(squares, np.sum((x - x[k]) ** 2, axis=1))
    nearest = np.zeros((count, x.shape[0]))
    for _ in range(_LLOYD_STEPS):
        nearest_index = np.argmin(np.sum(centres**2, axis=1)[:, None] - 2.0 * centres @ x.T, axis=0)
        nearest = (np.arange(count)[:, None] == nearest_index).astype(float)
        size = nearest.sum(axis=1)
        centres = np.where(size[:, None] > 0, (nearest @ x) / np.maximum(size, 1.0)[:, None], centres)
    return nearest


def chosen_count(
    values: npt.ArrayLike,
    block: npt.ArrayLike,
    counts: Sequence[int],
    rng: np.random.Generator,
    dof: float | None = np.inf,
) -> tuple[int, Array]:
    """The number of components that predicts other parts of the image best, and the score of each number.

    Cross-validation leaves out whole blocks of the image, as neighbouring pixels are correlated: a pixel would
    predict the one beside it with any number of components.  The score is the log density of the pixels left out.
    The smallest number whose score is within one standard error of the best, by blocks, is chosen (Breiman et al.,
    Classification and Regression Trees, 1984, 3.4.3).

    Parameters
    ----------
    values : (n, P) standardised
    block : (n,) number of the block of the image that each pixel lies in
    counts : numbers of components, increasing; those that the pixels do not carry are left out

    Returns
    -------
    number of components, and (len(counts),) mean log density of pixels left out; -inf of numbers not tried

    Raises
    ------
    UsageError : fewer than two blocks.
    """
    x = np.asarray(values, dtype=float)
    fold, group = _folds(block, rng)
    score, by_block = np.full(len(counts), -np.inf), []
    for i, count in enumerate(counts):
        # With fewer pixels for each component there is no covariance to estimate.
        if any(np.count_nonzero(fold != f) < count * (x.shape[1] + 1) for f in np.unique(fold)):
            break
        by_block.append(np.bincount(group, _validation_density(x, fold, count, dof, rng)))
        score[i] = by_block[-1].sum() / len(x)
        if i >= 2 and score[i] < score[i - 1] < score[i - 2]:
            break  # past the maximum
    best = int(np.argmax(score))
    losses = (by_block[best] - one for one in by_block[:best])
    comparable = (i for i, loss in enumerate(losses) if loss.sum() <= np.sqrt(loss.size) * loss.std(ddof=1))
    return int(counts[next(comparable, best)]), score


def chosen_dof(values: npt.ArrayLike, block: npt.ArrayLike, count: int, rng: np.random.Generator) -> float | None:
    """Degrees of freedom, of ``count`` t laws, that predict left-out blocks best; None: as fitted.

    The pixels of a sample lie nearer to its own clusters than those of another part of the image do.
    """
    x, fold = np.asarray(values, dtype=float), _folds(block, rng)[0]
    return max(TRIED_DOF, key=lambda dof: float(_validation_density(x, fold, count, dof, rng).sum()))


def _folds(block: npt.ArrayLike, rng: np.random.Generator) -> tuple[Index, Index]:
    """(n,) fold of each pixel, and its block counted from 0."""
    group = np.unique(np.asarray(block), return_inverse=True)[1].reshape(-1)
    blocks = int(group.max(initial=-1)) + 1
    refuse(blocks < 2, "mixture.one_block")
    return np.asarray((rng.permutation(blocks) % min(FOLDS, blocks))[group]), group


def _validation_density(x: Array, fold: Index, count: int, dof: float | None, rng: np.random.Generator) -> Array:
    """(n,) log density of each value by the mixture of the other folds."""
    density = np.empty(len(x))
    for f in np.unique(fold):
        fit = fit_mixture(x[fold != f], count, rng, dof=dof, starts=1)
        density[fold == f] = fit.log_density(x[fold == f])
    return density


COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)
DIMENSIONS = 6  # leading components of the class; clusters differ in what varies most
MIN_PIXELS = 200  # with fewer the clusters of one sample are not found in another
MAX_CHOOSING = 5000  # pixels, thinned evenly, that the number of clusters is chosen on


@dataclass(frozen=True, eq=False)
class ClassMixture:
    """The mixture of a class's pixels, in the leading components that it was fitted in.

    Attributes
    ----------
    mean : (B,) of the pixels
    lead : bands of the leading components
    directions : (bands of ``lead``, P) from a pixel's departure from the mean to its standardised values
    fit : of the standardised values
    """

    mean: Array
    lead: Index
    directions: Array
    fit: MixtureFit

    def components(self, pixels: Array) -> Components | None:
        """The laws in all bands, by the share that each pixel (n, B) has in each; None where only one remains."""
        return self._moments(pixels, self._standardised(pixels), self.fit)

    def components_without(self, pixels: Array, part: Index, number: int) -> Components | None:
        """The same without the pixels of one part of the image, refitted from the fit of all."""
        remaining = pixels[part != number]
        values = self._standardised(remaining)
        return self._moments(remaining, values, refit(values, self.fit))

    def _standardised(self, pixels: Array) -> Array:
        return np.asarray((pixels - self.mean)[:, self.lead] @ self.directions)

    def _moments(self, pixels: Array, values: Array, fit: MixtureFit) -> Components | None:
        centred = pixels - pixels.mean(axis=0)
        probability, weight = fit.responsibilities(values)
        size = probability.sum(axis=1)
        occupied = size > 1.0  # a law of less than one pixel has no covariance, and no alarms
        if np.count_nonzero(occupied) < 2:
            return None
        probability, weight, size = probability[occupied], weight[occupied], size[occupied]
        weighted = probability * weight
        offsets = (weighted @ centred) / weighted.sum(axis=1)[:, None]
        # The scale of a t law is the weighted scatter over the unweighted number; n/(n - 1) as for the class.
        n = pixels.shape[0]
        inflation = (1.0 if np.isinf(fit.dof) else fit.dof / (fit.dof - 2.0)) * n / max(n - 1, 1)
        covariances = np.empty((size.size, pixels.shape[1], pixels.shape[1]))
        for k in range(size.size):
            departures = centred - offsets[k]
            covariances[k] = inflation * (departures * weighted[k, :, None]).T @ departures / size[k]
        shrunk = shrunk_covariances(covariances, size)
        return Components(size / size.sum(), offsets, 0.5 * (shrunk + shrunk.transpose(0, 2, 1)), fit.dof)


def class_mixture(
    pixels: npt.ArrayLike,
    block: npt.ArrayLike,
    count: int | Literal["auto"],
    *,
    tails: bool,
    lead: Index | None = None,
    seed: int = 0,
) -> ClassMixture | None:
    """The mixture of pixels (n, B) of a class; None where they show one law alone.

    The laws are fitted in the leading components of the class, where clusters differ; the moments of all bands
    follow from the share that each pixel has in each law, shrunk by :func:`shrunk_covariances`.

    Parameters
    ----------
    block : (n,) number of the block of the image that each pixel lies in, for the choice of the number
    count : K, or "auto" for the number that predicts left-out blocks best
    tails : t laws in place of normal ones, whose degrees of freedom are fitted, or chosen by blocks where the number
        is: a sample has few pixels in its tails
    lead : bands in which the leading components are taken; None: all

    Raises
    ------
    UsageError : too few pixels or blocks.
    """
    x = np.asarray(pixels, dtype=float)
    rng = np.random.default_rng(seed)
    mean = x.mean(axis=0)
    lead = np.arange(x.shape[1]) if lead is None else lead
    centred = (x - mean)[:, lead]
    eigen = EigenDirections.from_covariance(centred.T @ centred / max(x.shape[0] - 1, 1))
    dimensions = min(DIMENSIONS, eigen.values.size)
    if dimensions == 0 or (count == "auto" and x.shape[0] < MIN_PIXELS):
        return None
    # The sign of an eigenvector is arbitrary; the starts of the fit must not depend on it.
    vectors = eigen.vectors[:, :dimensions]
    vectors = vectors * np.sign(vectors[np.argmax(np.abs(vectors), axis=0), np.arange(dimensions)])
    directions = vectors / np.sqrt(eigen.values[:dimensions])
    leading = centred @ directions
    dof: float | None = None if tails else np.inf
    thin = slice(None, None, -(-x.shape[0] // MAX_CHOOSING))
    sample, sample_block = leading[thin], np.asarray(block)[thin]
    number = count if count != "auto" else chosen_count(sample, sample_block, COUNTS, rng, dof=dof)[0]
    if number == 1:
        return None
    if tails and count == "auto":
        dof = chosen_dof(sample, sample_block, number, rng)
    return ClassMixture(mean, lead, directions, fit_mixture(leading, number, rng, dof=dof))


def shrunk_covariances(covariances: Array, pixels: Array) -> Array:
    """Covariances (K, B, B) shrunk towards their pooled one, by how much they differ from it beyond chance.

    In a direction of the pooled covariance the variance of one component over the pooled one scatters by 2/n_k
    where all are equal.  The excess over that, t^2, averaged over directions and components, is how much they truly
    differ; the best linear estimate between its own variance and the pooled one gives the latter the weight
    (2/n_k)/(2/n_k + t^2) (empirical Bayes; Efron & Morris, J. Am. Stat. Assoc. 68, 117-130, 1973).

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> alike = np.array([np.cov(rng.standard_normal((20, 4)).T) for _ in range(50)])
    >>> shrunk = shrunk_covariances(alike, np.full(50, 20.0))
    >>> bool(np.abs(shrunk - np.eye(4)).mean() < 0.5 * np.abs(alike - np.eye(4)).mean())
    True
    """
    shares = pixels / pixels.sum()
    pooled = np.tensordot(shares, covariances, 1)
    eigen = EigenDirections.from_covariance(pooled)
    ratio = np.einsum("bp,kbc,cp->kp", eigen.vectors, covariances, eigen.vectors, optimize=True) / eigen.values
    chance = 2.0 / pixels
    excess = max(float(shares @ (np.mean((ratio - 1.0) ** 2, axis=1) - chance)), 0.0)
    weight = (chance / (chance + excess))[:, None, None]
    return np.asarray((1.0 - weight) * covariances + weight * pooled)


_MIN_INVERSE = 1e-6  # of the search over a = 1/nu: below it no sample tells a t from the normal
_HALF_DROP = 1.920729410347062  # half the 0.95 quantile of chi-square with one degree of freedom
LEADING_SHARE = 0.99  # of the variance, in the leading components that tails are measured in as well
MIN_LEADING, MAX_LEADING = 2, 6


@dataclass(frozen=True)
class TailFit:
    """Degrees of freedom of a multivariate t.

    Attributes
    ----------
    dof : maximum-likelihood nu, 2.05 or more; inf where the normal law is the most likely
    scale : most likely factor on the sample's covariance, which far pixels inflate beyond that of the bulk
    lower, upper : 95 % limits by profile likelihood; upper inf where the normal law is inside
    normality_p_value : probability of such a likelihood ratio if the pixels are normal
    n : distances fitted
    """

    dof: float
    scale: float
    lower: float
    upper: float
    normality_p_value: float
    n: int


def tail_log_likelihood(inverse_dof: float, squared_distances: Array, dimension: int) -> float:
    """Greatest log likelihood of squared Mahalanobis distances (n,) under a multivariate t, whatever the scale.

    d^2 nu/(nu - 2)/(p s) follows F(p, nu), chi-square over p in the limit nu -> inf (Kotz & Nadarajah,
    Multivariate t Distributions, 2004, section 1.2).  The scale s is free: where tails are heavy the sample's own
    covariance misses it by more than the tail's shape allows.
    """
    d, p = squared_distances, dimension
    if inverse_dof < _MIN_INVERSE:
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

    def excess(log_width: float) -> float:
        return (nu + p) / p * float(np.mean(d / (math.exp(log_width) + d))) - 1.0

    low, high = 1e-6 * max(float(d.min()), 1e-290) * nu / p, 1e6 * float(d.max()) * nu  # excess > 0 and < 0, whatever d
    return math.exp(scipy.optimize.brentq(excess, math.log(low), math.log(high), xtol=1e-9))


def left_out_distances(squared_distances: npt.ArrayLike, pixels: float) -> Array:
    """Squared distances by mean and covariance of the other pixels, from those by the statistics of all.

    A far pixel inflates the covariance that it is measured by, so that no distance exceeds (n - 1)^2/n.  Removing
    the pixel (Sherman & Morrison) gives (n - 2) (n/(n - 1))^2 q/(1 - q n/(n - 1)) with q = d^2/(n - 1).
    """
    n = float(pixels)
    q = np.asarray(squared_distances, dtype=float) / (n - 1.0)
    # A pixel that alone spans a direction has no finite distance from the others.
    remaining = np.maximum(1.0 - q * n / (n - 1.0), 1e-9)
    return np.asarray((n - 2.0) * (n / (n - 1.0)) ** 2 * q / remaining)


def fit_tail_dof(
    squared_distances: npt.ArrayLike,
    dimension: int,
    *,
    estimated_on: int | None = None,
    independent: float | None = None,
    within: tuple[float, float] = (MIN_DOF, math.inf),
) -> TailFit:
    """Maximum-likelihood degrees of freedom and scale, with profile-likelihood limits of the former.

    Parameters
    ----------
    squared_distances : (n,) of pixels from their mean, by their covariance; those of 0 are left out
    dimension : bands p
    estimated_on : pixels that mean and covariance were estimated on, these among them; None where both are known.
        Distances are then taken from the other pixels; for normal pixels those follow T^2, which is a t with
        n - 1 - p degrees of freedom, and its inverse is taken off
    independent : of these distances, as many count as independent; the likelihood is taken to that power over n
    within : least and greatest degrees of freedom, such as what all pixels can tell of those of a part of them

    Raises
    ------
    UsageError : fewer than ten distances, or no more pixels than bands.

    Examples
    --------
    >>> near = np.r_[np.full(400, 1e-14), np.random.default_rng(0).chisquare(5, 600)]  # 40 % hold the mean itself
    >>> round(fit_tail_dof(near, 5).dof, 2)
    2.05
    """
    d, offset = np.asarray(squared_distances, dtype=float), 0.0
    d = d[np.isfinite(d) & (d > 0)]
    refuse(d.size < 10, "tails.few", size=d.size)
    if estimated_on is not None:
        refuse(estimated_on <= dimension + 3, "tails.pixels", estimated_on=estimated_on, dimension=dimension)
        d, offset = left_out_distances(d, estimated_on), 1.0 / (estimated_on - 1.0 - dimension)
    weight = 1.0 if independent is None else min(independent / d.size, 1.0)

    def fit(a: float) -> float:
        return weight * tail_log_likelihood(a + offset, d, dimension)

    def drop(a: float) -> float:
        return top - fit(a) - _HALF_DROP

    end, normal = min(1.0 / within[0], 1.0 / MIN_DOF - offset), fit(0.0)
    start = min(1.0 / within[1], end)
    optimum = scipy.optimize.minimize_scalar(
        lambda a: -fit(a), bounds=(start, end), method="bounded", options={"xatol": 1e-8}
    )
    best, top = float(optimum.x), -float(optimum.fun)
    if start == 0.0 and (best <= 2.0 * _MIN_INVERSE or top <= normal):
        best, top = 0.0, max(normal, top)
    high = end if drop(end) < 0 else scipy.optimize.brentq(drop, best, end)
    low = start if best == start or drop(start) <= 0 else scipy.optimize.brentq(drop, start, best)
    a = best + offset
    scale = float(np.mean(d)) / dimension if a < _MIN_INVERSE else _t_width(d, dimension, 1.0 / a) / (1.0 / a - 2.0)
    # Where nu = inf is true, at the end of the range, twice the gain is half chi-square, half 0 (Self & Liang 1987).
    p_value = float(ndtr(-np.sqrt(2.0 * (top - normal)))) if top > normal else 1.0
    dof, lower, upper = (1.0 / a if a > 0 else math.inf for a in (best, high, low))
    return TailFit(dof, scale, lower, upper, p_value, int(d.size))


def distance_exceedance(squared_distance: npt.ArrayLike, dimension: int, dof: float) -> Array:
    """Probability that a pixel of a normal (dof inf) or t law lies beyond this distance, of any shape."""
    d = np.asarray(squared_distance, dtype=float)
    if np.isinf(dof):
        return np.asarray(chdtrc(dimension, d))
    return np.asarray(fdtrc(dimension, dof, d * dof / (dof - 2.0) / dimension))


def leading_count(variances: Array, total: float) -> int:
    """How many leading components tails are measured in: those that hold 99 % of the ``total`` variance, 2 to 6."""
    count = int(np.searchsorted(np.cumsum(variances) / total, LEADING_SHARE)) + 1
    return min(max(count, MIN_LEADING), MAX_LEADING, variances.size)


def squared_mahalanobis(pixels: npt.ArrayLike, mean: npt.ArrayLike, vectors: Array, values: Array) -> Array:
    """Squared distances (n,) of pixels (n, B) from a mean, in the directions (B, P) with variances (P,)."""
    z = (np.asarray(pixels, dtype=float) - np.asarray(mean, dtype=float)) @ vectors
    return np.asarray(np.einsum("ij,ij->i", z / values, z))


_HALVINGS = 4  # 16 parts
_FEWEST = 8  # pixels of a part


def compact_parts(lines: npt.ArrayLike, samples: npt.ArrayLike) -> Index:
    """(n,) number of the part that each pixel lies in: 16 parts of as many pixels, halved along their longer side.

    Fewer parts where they would have fewer than 8 pixels.

    Examples
    --------
    >>> lines, samples = np.indices((4, 16)).reshape(2, -1)
    >>> compact_parts(lines, samples).reshape(4, 16)[::2, ::2].tolist()
    [[0, 0, 2, 2, 4, 4, 6, 6], [1, 1, 3, 3, 5, 5, 7, 7]]
    """
    positions = np.stack([np.asarray(lines), np.asarray(samples)])
    n = positions.shape[1]
    part = np.zeros(n, np.intp)
    for _ in range(min(_HALVINGS, int(np.log2(max(n / _FEWEST, 1.0))))):
        upper_half = np.zeros(n, np.intp)
        for number in range(int(part.max()) + 1):
            index = np.flatnonzero(part == number)
            longer = int(np.argmax(np.ptp(positions[:, index], axis=1)))
            order = index[np.lexsort((positions[1 - longer, index], positions[longer, index]))]
            upper_half[order[order.size // 2 :]] = 1
        part = 2 * part + upper_half
    return part


def moments_without_each(pixels: Array, part: Index) -> Iterator[tuple[Array, Array]]:
    """Mean (B,) and covariance (B, B) of the pixels (n, B) without each of their parts; nothing for a single part."""
    centre = pixels.mean(axis=0)
    centred = [pixels[part == g] - centre for g in range(int(part.max(initial=0)) + 1)]
    products = [x.T @ x for x in centred]
    sums, total_product = [x.sum(axis=0) for x in centred], np.sum(products, axis=0)
    for x, product, part_sum in zip(centred, products, sums, strict=True) if len(centred) > 1 else ():
        n = pixels.shape[0] - x.shape[0]
        mean = -part_sum / n  # departures from the mean sum to 0
        yield centre + mean, (total_product - product - n * np.outer(mean, mean)) / max(n - 1, 1)


def fit_leading_tails(
    pixels: Array, mean: Array, covariance: Array, within: tuple[float, float] = (MIN_DOF, math.inf)
) -> TailFit:
    """The tails of pixels (n, B) in the leading components of their covariance, of degrees of freedom ``within``."""
    directions = EigenDirections.from_covariance(covariance)
    count = leading_count(directions.values, float(np.trace(covariance)))
    distances = squared_mahalanobis(pixels, mean, directions.vectors[:, :count], directions.values[:count])
    return fit_tail_dof(distances, count, estimated_on=pixels.shape[0], within=within)
