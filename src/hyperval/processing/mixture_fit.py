"""Mixtures of normal or t laws, fitted by expectation and maximisation in a few dimensions.

A class such as "built-up" is roofs, roads and cars: clusters, and no single law.  The fit is for standardised
values, of mean 0 and covariance 1 in all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy
from scipy.special import digamma, gammaln

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

LEAST_DOF, MOST_DOF = (
    2.05,
    200.0,
)  # of t laws: the covariance is finite; beyond, nobody tells it from the normal law
STEPS = 100
_TOLERANCE = 1e-4  # of the penalised log likelihood of one pixel
_LLOYD = 10
_FIRST_DOF = 10.0
TRIED_DOF = (None, 16.0, 8.0, 4.0)


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

    def log_densities(self, x: Array) -> tuple[Array, Array]:
        """log of weight times density, and the squared distance over the scale, (K, n) each, of values (n, P)."""
        return self._log_densities(_monomials(x))

    def _log_densities(self, monomials: Array) -> tuple[Array, Array]:
        inverse, p = self.inverse_roots, self.means.shape[1]
        precision = inverse.transpose(0, 2, 1) @ inverse
        towards = np.einsum("kij,kj->ki", precision, self.means)
        at_zero = np.einsum("ki,ki->k", towards, self.means)
        upper, lower = np.triu_indices(p)
        products = precision[:, upper, lower] * np.where(upper == lower, 1.0, 2.0)
        squares = np.concatenate([at_zero[:, None], -2.0 * towards, products], axis=1) @ monomials
        np.maximum(squares, 0.0, out=squares)  # rounding alone leaves it
        constant = np.log(self.weights) + np.log(np.einsum("kii->ki", inverse)).sum(axis=1)
        if np.isinf(self.dof):
            return (constant - 0.5 * p * np.log(2.0 * np.pi))[:, None] - 0.5 * squares, squares
        nu = self.dof
        constant += gammaln(0.5 * (nu + p)) - gammaln(0.5 * nu) - 0.5 * p * np.log(nu * np.pi)
        return constant[:, None] - 0.5 * (nu + p) * np.log1p(squares / nu), squares

    def log_density(self, x: Array) -> Array:
        """(n,) log density of values (n, P)."""
        return _total(self.log_densities(x)[0])[0]

    def shares(self, x: Array) -> tuple[Array, Array]:
        """(K, n) probability that a value belongs to a law, and the weight it has in the moments of that law.

        The weight is (dof + P)/(dof + d^2) of a t law (Peel & McLachlan, Stat. Comput. 10, 339-348, 2000), 1 of a
        normal one.
        """
        log_parts, squares = self.log_densities(x)
        return _total(log_parts)[1], _weight(squares, self.dof, x.shape[1])


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
    if count < 1 or n < 2 * count:
        raise UsageError(f"{count} components of {n} pixels", expected="two pixels or more for each component")
    prior = p + 1.0 if prior_pixels is None else prior_pixels
    fits = (
        _from_start(x, _nearest_of_centres(x, count, rng), dof, prior) for _ in range(starts if count > 1 else 1)
    )
    return max(fits, key=lambda fit: fit.history[-1])


def fit_again(values: Array, fit: MixtureFit) -> MixtureFit:
    """The fit to other values (n, P), from where it stands, with as many laws; degrees of freedom stay if chosen.

    What a sample without one of its parts makes of the mixture; a fresh start could end in another maximum.
    """
    chosen = np.isinf(fit.dof) or fit.dof in TRIED_DOF
    return _from_start(values, fit.shares(values)[0], fit.dof if chosen else None, values.shape[1] + 1.0)


def _from_start(x: Array, probability: Array, dof: float | None, prior: float) -> MixtureFit:
    """Expectation and maximisation from probabilities (K, n)."""
    n, p = x.shape
    count = probability.shape[0]
    ball = count ** (-2.0 / p)
    nu = _FIRST_DOF if dof is None else dof
    weight = np.ones_like(probability)
    monomials = _monomials(x)
    upper, lower = np.triu_indices(p)
    history: list[float] = []
    fit = None
    for _ in range(STEPS):
        size = probability.sum(axis=1)
        alive = size > 1e-8 * n  # a component that no pixel belongs to has no law
        if not alive.all():
            probability, weight, size = probability[alive], weight[alive], size[alive]
            ball *= (count / size.size) ** (2.0 / p)
            count = size.size
            history.clear()  # another mixture, with another likelihood
        both = probability * weight
        moments = both @ monomials.T
        total = moments[:, 0]
        means = moments[:, 1 : p + 1] / total[:, None]
        scales = np.empty((count, p, p))
        scatter = moments[:, p + 1 :] - total[:, None] * means[:, upper] * means[:, lower]
        scales[:, upper, lower] = scales[:, lower, upper] = scatter
        scales = (scales + prior * ball * np.eye(p)) / (size + prior)[:, None, None]
        if dof is None and history:
            nu = _better_dof(nu, p, probability, weight)
        fit = MixtureFit(size / size.sum(), means, scales, nu)
        log_parts, squares = fit._log_densities(monomials)
        log_density, probability = _total(log_parts)
        history.append(float(log_density.mean()) - _penalty(fit.inverse_roots, ball, prior) / n)
        weight = _weight(squares, nu, p)
        if len(history) > 1 and history[-1] - history[-2] < _TOLERANCE:
            break
    assert fit is not None  # noqa: S101 - STEPS is positive
    return replace(fit, history=tuple(history))


def _monomials(x: Array) -> Array:
    """(1 + P + P (P + 1)/2, n) the powers of values (n, P) up to the second: a square form is linear in them."""
    upper, lower = np.triu_indices(x.shape[1])
    columns = x.T
    return np.concatenate([np.ones((1, x.shape[0])), columns, columns[upper] * columns[lower]])


def _weight(squares: Array, dof: float, dimensions: int) -> Array:
    return np.ones_like(squares) if np.isinf(dof) else (dof + dimensions) / (dof + squares)


def _total(log_parts: Array) -> tuple[Array, Array]:
    """log of the sum (n,) of parts (K, n), and the share of each in it; scipy's logsumexp is thrice as slow."""
    top = log_parts.max(axis=0)
    parts = np.exp(log_parts - top)
    total = parts.sum(axis=0)
    parts /= total
    return top + np.log(total), parts


def _penalty(inverse_roots: Array, ball: float, prior: float) -> float:
    """Minus the log density of the prior of all scales about ``ball`` times the unit matrix, up to a constant."""
    log_det = -2.0 * np.log(np.einsum("kii->ki", inverse_roots)).sum()
    return float(0.5 * prior * (log_det + ball * np.sum(inverse_roots**2)))


def _better_dof(nu: float, p: int, probability: Array, weight: Array) -> float:
    """Degrees of freedom of greatest expected likelihood, given shares and weights at ``nu`` (Peel & McLachlan)."""
    known = float((probability * (np.log(weight) - weight)).sum() / probability.sum())
    known += float(digamma(0.5 * (nu + p)) - np.log(0.5 * (nu + p)))

    def slope(v: float) -> float:
        return math.log(0.5 * v) - float(digamma(0.5 * v)) + 1.0 + known

    if slope(LEAST_DOF) <= 0.0:
        return LEAST_DOF
    return MOST_DOF if slope(MOST_DOF) >= 0.0 else float(scipy.optimize.brentq(slope, LEAST_DOF, MOST_DOF))


def _nearest_of_centres(x: Array, count: int, rng: np.random.Generator) -> Array:
    """(K, n) 1 for the nearest of K centres, by the iterations of Lloyd from spread-out pixels (k-means++)."""
    centres = x[rng.integers(x.shape[0])][None]
    away = np.sum((x - centres[0]) ** 2, axis=1)
    for _ in range(count - 1):
        total = float(away.sum())
        at = rng.choice(x.shape[0], p=away / total) if total > 0.0 else rng.integers(x.shape[0])
        centres = np.vstack([centres, x[at]])
        away = np.minimum(away, np.sum((x - x[at]) ** 2, axis=1))
    nearest = np.zeros((count, x.shape[0]))
    for _ in range(_LLOYD):
        which = np.argmin(np.sum(centres**2, axis=1)[:, None] - 2.0 * centres @ x.T, axis=0)
        nearest = (np.arange(count)[:, None] == which).astype(float)
        size = nearest.sum(axis=1)
        centres = np.where(size[:, None] > 0, (nearest @ x) / np.maximum(size, 1.0)[:, None], centres)
    return nearest


def chosen_count(
    values: npt.ArrayLike,
    block: npt.ArrayLike,
    counts: Sequence[int],
    rng: np.random.Generator,
    *,
    dof: float | None = np.inf,
    folds: int = 4,
) -> tuple[int, Array]:
    """The number of components that predicts other parts of the image best, and what each number scored.

    Whole blocks of the image are left out in turns, as neighbours are alike: a pixel would predict the one beside
    it however many components there are.  The score is the log density of the pixels left out.  Of the numbers
    whose score is within one standard error of the best, by blocks, the smallest counts (Breiman et al.,
    Classification and Regression Trees, 1984, 3.4.3): what is beyond it may be chance.

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
    fold, at = _folds(block, folds, rng)
    score, each = np.full(len(counts), -np.inf), []
    for i, count in enumerate(counts):
        # Fewer pixels than that for each component of the smallest part, and it knows no covariance.
        if any(np.count_nonzero(fold != f) < count * (x.shape[1] + 1) for f in np.unique(fold)):
            break
        each.append(np.bincount(at, _left_out_density(x, fold, count, dof, rng)))
        score[i] = each[-1].sum() / len(x)
        if i >= 2 and score[i] < score[i - 1] < score[i - 2]:
            break  # past its top
    best = int(np.argmax(score))
    for i in range(best):
        behind = each[best] - each[i]
        if behind.sum() <= np.sqrt(behind.size) * behind.std(ddof=1):
            return int(counts[i]), score
    return int(counts[best]), score


def chosen_dof(
    values: npt.ArrayLike, block: npt.ArrayLike, count: int, rng: np.random.Generator, *, folds: int = 4
) -> float | None:
    """Degrees of freedom, of t laws in number ``count``, that predict left-out blocks best; None: as fitted.

    The pixels of a sample lie nearer to its own clusters than those of another part of the image do.
    """
    x, fold = np.asarray(values, dtype=float), _folds(block, folds, rng)[0]
    return max(TRIED_DOF, key=lambda dof: float(_left_out_density(x, fold, count, dof, rng).sum()))


def _folds(
    block: npt.ArrayLike, folds: int, rng: np.random.Generator
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """(n,) part of the image that a pixel is left out with, and its block counted from 0."""
    at = np.unique(np.asarray(block), return_inverse=True)[1].reshape(-1)
    blocks = int(at.max(initial=-1)) + 1
    if blocks < 2:
        raise UsageError(
            "the pixels lie in one block of the image: the number of components can not be chosen by leaving "
            "blocks out",
            mend="state it, such as mixture: 3",
        )
    return np.asarray((rng.permutation(blocks) % min(folds, blocks))[at]), at


def _left_out_density(
    x: Array, fold: npt.NDArray[np.intp], count: int, dof: float | None, rng: np.random.Generator
) -> Array:
    """(n,) log density of each value by the mixture of the other parts."""
    density = np.empty(len(x))
    for f in np.unique(fold):
        fit = fit_mixture(x[fold != f], count, rng, dof=dof, starts=1)
        density[fold == f] = fit.log_density(x[fold == f])
    return density
