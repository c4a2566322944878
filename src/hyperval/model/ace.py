"""The adaptive coherence estimator on statistics: no closed form, so conditional Monte Carlo (after 3.22-3.33).

ACE(x) = (d^T Sigma^-1 (x - mu))^2 / [(d^T Sigma^-1 d) (x - mu)^T Sigma^-1 (x - mu)], the squared cosine of the
angle between pixel and target in whitened space (Kraut and Scharf 1999).  For a pixel y = m + G z in that space, z
standard normal, one direction of z is integrated exactly: along it ACE > eta is a quadratic inequality, whose
probability is a sum of normal distribution functions.  The other directions are drawn by importance sampling, in part
closer to the mean, where small probabilities come from.  So probabilities far below one over the number of draws have
a small error, which is stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp, ndtr

from hyperval.data import Array
from hyperval.errors import refuse
from hyperval.model.filters import PositiveDefinite

_BLOCK = 20_000  # draws times scores at once: what a cache holds
# Scores at which probabilities are evaluated: even in atanh of the cosine, which spreads both ends.
_SCORES = np.tanh(np.linspace(1e-3, 4.0, 240)) ** 2


@dataclass(frozen=True)
class AceSpace:
    """Whitened space of one background and one target: ``axis`` (F,) is the unit vector towards the target."""

    background: PositiveDefinite
    mean: Array
    axis: Array


@dataclass(frozen=True)
class Exceedance:
    """Probability that the score of a population exceeds each of a set of scores.

    Attributes
    ----------
    scores : (S,) increasing
    probability, standard_error : (S,); the error is that of the draws alone
    """

    scores: Array
    probability: Array
    standard_error: Array

    @property
    def moments(self) -> tuple[float, float]:
        """Mean and standard deviation of the score, from E[s] = int P ds and E[s^2] = int 2 s P ds."""
        s, p = np.concatenate([[0.0], self.scores, [1.0]]), np.concatenate([[1.0], self.probability, [0.0]])
        mean = float(np.trapezoid(p, s))
        return mean, float(np.sqrt(max(np.trapezoid(2.0 * s * p, s) - mean**2, 0.0)))


def ace_space(target: npt.ArrayLike, mean: npt.ArrayLike, covariance: npt.ArrayLike | PositiveDefinite) -> AceSpace:
    """The space in which ACE is a squared cosine (variant of 3.22-3.25).

    Raises
    ------
    UsageError : a singular covariance, or a target that is the background mean.
    """
    t, mu = np.asarray(target, dtype=float), np.asarray(mean, dtype=float)
    refuse(not np.any(t - mu), "target.background")
    factor = covariance if isinstance(covariance, PositiveDefinite) else PositiveDefinite(covariance)
    direction = factor.whiten(t - mu)
    return AceSpace(factor, mu, direction / np.linalg.norm(direction))


def ace_exceedance(
    space: AceSpace,
    mean: npt.ArrayLike,
    covariance: npt.ArrayLike,
    draws: int,
    rng: np.random.Generator,
    tail_dof: float | None = None,
    scores: npt.ArrayLike = _SCORES,
    decades: Sequence[float] = (0.0,),
    normal: npt.ArrayLike | None = None,
) -> Exceedance:
    """P(ACE > eta) of a population (in place of 3.26-3.29 and 3.31, 3.33).

    Parameters
    ----------
    mean, covariance : (F,), (F, F) of the population
    draws : random pixels
    tail_dof : degrees of freedom of a multivariate t with this mean and covariance; None: Gaussian
    scores : (S,) values eta in 0-1
    decades : -log10 of the probabilities of interest; the draws are shared out among them
    normal : (F, F) covariance of an added normal part, without the tails; None: none
    """
    eta = np.asarray(scores, dtype=float)
    cov = np.asarray(covariance, dtype=float)
    # A population without spread in some direction must have a Cholesky factor too.
    floor = 1e-12 * np.diag(space.background.matrix)
    roots = [np.linalg.cholesky(cov + np.diag(floor))]
    if normal is not None:
        values, vectors = np.linalg.eigh(np.asarray(normal, dtype=float))
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
    factors = [space.background.whiten(root) for root in roots]
    m = space.background.whiten(np.asarray(mean, dtype=float) - space.mean)
    z = rng.standard_normal((draws, m.size * len(factors)))
    scales = np.ones((len(factors), draws))  # of the parts of a draw: the t law scales all directions of its part
    if tail_dof is not None:
        scales[0] = np.sqrt((tail_dof - 2.0) / rng.chisquare(tail_dof, draws))
    gradients = [g.T @ space.axis for g in factors]
    length = np.sqrt(sum(s**2 * float(a @ a) for s, a in zip(scales, gradients, strict=True)))
    parts = np.split(z, len(factors), axis=1)  # views
    # The direction integrated exactly: y = y0 + xi step, along which the cosine rises most.
    projection = sum(s * (x @ a) for s, x, a in zip(scales, parts, gradients, strict=True)) / length
    for s, x, a in zip(scales, parts, gradients, strict=True):
        x -= (projection * s / length)[:, None] * a
    weight = _importance_weights(z, decades)
    y0 = m + sum(s[:, None] * (x @ g.T) for s, x, g in zip(scales, parts, factors, strict=True))
    images = np.array([g @ a for g, a in zip(factors, gradients, strict=True)])  # step = sum of s^2 / length of these
    coefficients = scales**2 / length
    # ACE > eta: (u.y)^2 - eta y.y = a xi^2 + b xi + c > 0
    u0 = y0 @ space.axis
    cross, square = np.einsum("pn,np->n", coefficients, y0 @ images.T), (y0**2).sum(axis=1)
    step = np.einsum("pn,pq,qn->n", coefficients, images @ images.T, coefficients)
    probability, error = np.empty((2, eta.size))
    for k in np.array_split(np.arange(eta.size), max(eta.size * draws // _BLOCK, 1)):
        e = eta[k, None]
        a, b, c = length**2 - e * step, 2.0 * (u0 * length - e * cross), u0**2 - e * square
        p = weight * _probability_positive(a, b, c)
        probability[k], error[k] = p.mean(axis=1), p.std(axis=1) / np.sqrt(draws)
    return Exceedance(eta, probability, error)


def ace_threshold(pfa: npt.ArrayLike, fractions: Sequence[float], classes: Sequence[Exceedance]) -> Array:
    """Scores at which the background gives ``pfa`` (inverse of 3.33): log P_FA is linear in atanh of the cosine."""
    total = np.asarray(sum(f * c.probability for f, c in zip(fractions, classes, strict=True)))
    used = total > 0
    position = np.arctanh(np.sqrt(classes[0].scores[used]))
    log_p = np.minimum.accumulate(np.log(total[used]))
    y = np.interp(-np.log(np.asarray(pfa, dtype=float)), -log_p, position)
    return np.asarray(np.tanh(y) ** 2)


def exceedance_at(threshold: npt.ArrayLike, population: Exceedance) -> Array:
    """P(ACE > threshold) of a population between the scores it was evaluated at (3.31)."""
    x = np.arctanh(np.sqrt(np.clip(np.asarray(threshold, dtype=float), 0.0, 1.0 - 1e-12)))
    log_p = np.log(np.maximum(population.probability, 1e-300))
    return np.asarray(np.exp(np.interp(x, np.arctanh(np.sqrt(population.scores)), log_p)))


def _importance_weights(z: Array, decades: Sequence[float]) -> Array:
    """Scale the draws ``z`` in place, by each decade in turn, and return their weights (balance heuristic, Veach 1995).

    For a pixel of the background itself P_FA is about E[exp(-t^2 r^2 / 2)] with r^2 of F - 1 degrees of freedom: it
    comes from draws whose variance is smaller by 1 + t^2 = P_FA^(-2 / (F - 1)).
    """
    d = max(z.shape[1] - 1, 1)
    scale = 10.0 ** (-np.asarray(decades, dtype=float) / d)
    z *= scale[np.arange(z.shape[0]) % scale.size][:, None]
    square = (z**2).sum(axis=1)
    log_density = -d * np.log(scale) - 0.5 * square[:, None] * (scale**-2.0 - 1.0)
    return np.asarray(np.exp(-logsumexp(log_density, axis=1, b=1.0 / scale.size)))


def _probability_positive(a: Array, b: Array, c: Array) -> Array:
    """P(a xi^2 + b xi + c > 0) for standard normal xi."""
    discriminant = b**2 - 4.0 * a * c
    probability, real = np.where(a >= 0, 1.0, 0.0), discriminant > 0
    a, b, c, root = a[real], b[real], c[real], np.sqrt(discriminant[real])
    outside = a >= 0  # of the roots, else between them
    # The stable pair of roots: q / a and c / q.
    q = -0.5 * (b + np.where(b >= 0, root, -root))
    a, q = np.where(np.abs(a) < 1e-300, 1e-300, a), np.where(np.abs(q) < 1e-300, 1e-300, q)
    low, high = np.minimum(q / a, c / q), np.maximum(q / a, c / q)
    # Between two roots on one side of zero, the difference is taken where it keeps its digits.
    flip = low > 0
    upper = ndtr(np.where(outside, low, np.where(flip, -low, high)))
    probability[real] = upper + np.where(outside, 1.0, -1.0) * ndtr(np.where(outside | flip, -high, low))
    return probability
