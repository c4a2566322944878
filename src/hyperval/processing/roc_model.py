"""Score statistics and the ROC of the model (3.26-3.33).

One threshold x serves the whole image: P_D(x) = Phi((theta_T - x)/sigma_T) and
P_FA(x) = sum f_m Phi((theta_m - x)/sigma_m).  Everything is in logarithms, valid at P_FA = 1e-9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, log_ndtr, ndtr, ndtri_exp, stdtr, stdtrit

from hyperval.errors import UsageError
from hyperval.processing.filters import LinearFilter
from hyperval.products import RocCurve
from hyperval.scene.fill import FillDistribution

Array = npt.NDArray[np.float64]
Unit = Literal["pixel", "object"]

_SMALLEST_SD = 1e-12


def false_alarm_grid(lowest: float = 1e-9, per_decade: int = 20) -> Array:
    """(K,) increasing, log-spaced false-alarm probabilities from ``lowest`` to 0.999 for (3.33)."""
    decades = -np.log10(lowest)
    grid = np.logspace(-decades, 0.0, round(decades * per_decade) + 1)
    grid[-1] = 0.999
    return grid


@dataclass(frozen=True)
class ClassScore:
    """Score of one background class.

    Attributes
    ----------
    fraction : f_m, its part of the background [1]
    mean, sd : theta_m, sigma_m [1]
    tail_dof : degrees of freedom of a t distribution of the same mean and sd; None = Gaussian
    """

    fraction: float
    mean: float
    sd: float
    tail_dof: float | None = None


@dataclass(frozen=True)
class TargetScore:
    """Score of target pixels: a mixture of Gaussians over the fill.

    Attributes
    ----------
    means, sds : (K,) theta_T and sigma_T at each fill
    weights : (K,) probabilities
    """

    means: Array
    sds: Array
    weights: Array

    @property
    def mean(self) -> float:
        """Mean over the fill."""
        return float(self.weights @ self.means)

    @property
    def sd(self) -> float:
        """Standard deviation, that of the mean score with the fill included."""
        return float(np.sqrt(self.weights @ (self.sds**2 + (self.means - self.mean) ** 2)))


def score_mean(detector: LinearFilter, mean: npt.ArrayLike) -> float:
    """theta = w (rho - mu_B) of a population with mean (B,) (3.26, 3.27) [1]."""
    return float(detector.score(mean))


def score_sd(detector: LinearFilter, covariance: npt.ArrayLike) -> float:
    """sigma = sqrt(w Sigma^ w^T) of a population with covariance (B, B) (3.28, 3.29) [1]."""
    return float(np.sqrt(max(detector.variance(covariance), 0.0)))


def target_score_moments(
    fill: FillDistribution, host_mean: float, target_variance: float, host_variance: float, noise_variance: float
) -> tuple[float, float]:
    """Mean and sd of the score of mixed pixels by moments (3.26, 3.28 with random fill).

    theta_T = f + (1 - f) theta_b; sigma_T^2 = E[f^2] a + E[(1-f)^2] b + n + Var(f)(1 - theta_b)^2 with a, b, n
    the score variances of target, host and noise.
    """
    f, v = fill.mean, fill.variance
    mean = f + (1.0 - f) * host_mean  # (3.26) of a mixed pixel
    variance = (f**2 + v) * target_variance + ((1.0 - f) ** 2 + v) * host_variance + noise_variance
    return mean, float(np.sqrt(variance + v * (1.0 - host_mean) ** 2))  # (3.28)


def log_false_alarm(threshold: npt.ArrayLike, classes: Sequence[ClassScore]) -> Array:
    """log P_FA(x) = log sum f_m P(score of class m > x) (3.33, one threshold for the image).

    For a class with nu degrees of freedom the tail is 1 - F_t,nu((x - theta_m) / (sigma_m sqrt((nu-2)/nu))).

    Parameters
    ----------
    threshold : (...,) x [1]

    Returns
    -------
    (...,) natural logarithms
    """
    x = np.asarray(threshold, dtype=float)
    held = [c for c in classes if c.fraction > 0]
    total = np.log(held[0].fraction) + _log_tail(x, held[0])
    for c in held[1:]:
        total = np.logaddexp(total, np.log(c.fraction) + _log_tail(x, c))
    return np.asarray(total)


def greatest_class_false_alarm(threshold: npt.ArrayLike, classes: Sequence[ClassScore]) -> Array:
    """(...,) max_m P(score of class m > x): the preset of (3.30) whose least P_D (3.32) has threshold x.

    x = max_m x_m(P) is where the class with the longest tail gives P and all others less.  A curve drawn against P
    is the reading of (3.32) without (3.33): it counts the worst class as if it covered the image.
    """
    x = np.asarray(threshold, dtype=float)
    return np.asarray(np.exp(np.max([_log_tail(x, c) for c in classes if c.fraction > 0], axis=0)))


def _log_tail(x: Array, c: ClassScore) -> Array:
    sd = max(c.sd, _SMALLEST_SD)
    if c.tail_dof is None:
        return np.asarray(log_ndtr((c.mean - x) / sd))
    z = (c.mean - x) / (sd * np.sqrt((c.tail_dof - 2.0) / c.tail_dof))
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(stdtr(c.tail_dof, z)))


def class_threshold(log_pfa: npt.ArrayLike, c: ClassScore) -> Array:
    """x_m = theta_m - sigma_m Phi^-1(P_FA): threshold at which class m alone gives P_FA (3.30).

    The printed form has the sign of Phi^-1 the other way round, which puts the threshold below the
    class mean for P_FA < 0.5.
    """
    lp = np.minimum(np.asarray(log_pfa, dtype=float), 0.0)
    if c.tail_dof is None:
        return np.asarray(c.mean - c.sd * ndtri_exp(lp))  # (3.30)
    scale = c.sd * np.sqrt((c.tail_dof - 2.0) / c.tail_dof)
    return np.asarray(c.mean - scale * stdtrit(c.tail_dof, np.exp(lp)))


def threshold_at(pfa: npt.ArrayLike, classes: Sequence[ClassScore]) -> Array:
    """The common threshold at which the whole background gives ``pfa`` (inverse of 3.33).

    Bracketed in closed form and bisected: at max_m x_m(P) no class exceeds P; at the largest
    x_m(P / f_m) one class alone already gives P.
    """
    lp = np.log(np.asarray(pfa, dtype=float))
    held = [c for c in classes if c.fraction > 0]
    if not held:
        raise UsageError("no background class has a positive fraction")
    alone = np.stack([class_threshold(lp, c) for c in held])
    high = alone.max(axis=0)
    low = alone.min(axis=0)
    for c in held:
        share = lp - np.log(c.fraction)
        low = np.where(share < 0, np.maximum(low, class_threshold(np.minimum(share, -1e-300), c)), low)
    low = np.minimum(low, high)
    # False position with the Illinois rule on log P_FA, which is smooth and concave: a dozen steps; bisection where
    # it does not narrow the bracket.
    at_low, at_high = log_false_alarm(low, held) - lp, log_false_alarm(high, held) - lp
    x, last = high, np.zeros(lp.shape)
    for step in range(80):
        width = high - low
        if np.max(width) <= 1e-13 * max(1.0, float(np.max(np.abs(high)))):
            break
        gap = at_low - at_high
        share = np.divide(at_low, gap, out=np.full_like(gap, 0.5), where=gap > 0)
        share = np.where(step % 8 == 7, 0.5, np.clip(share, 0.0, 1.0))
        x = low + width * share
        value = log_false_alarm(x, held) - lp
        above = value > 0
        at_high = np.where(above & (last > 0), 0.5 * at_high, at_high)
        at_low = np.where(~above & (last < 0), 0.5 * at_low, at_low)
        low, at_low = np.where(above, x, low), np.where(above, value, at_low)
        high, at_high = np.where(above, high, x), np.where(above, at_high, value)
        last = np.where(above, 1.0, -1.0)
        if np.max(np.abs(value)) <= 1e-12:
            return np.asarray(x)
    return np.asarray(0.5 * (low + high))


def detection_probability(threshold: npt.ArrayLike, target: TargetScore) -> Array:
    """P_D(x) = sum_k w_k Phi((theta_k - x) / sigma_k), (K,) (3.31 with 1/sigma_T, exact over the fill)."""
    x = np.asarray(threshold, dtype=float)
    z = (target.means - x[..., None]) / np.maximum(target.sds, _SMALLEST_SD)
    return np.asarray(ndtr(z) @ target.weights)


def score_density(score: npt.ArrayLike, classes: Sequence[ClassScore]) -> Array:
    """Probability density of the background's score, sum f_m p_m(x) (the derivative of 3.33) [per unit of score].

    Parameters
    ----------
    score : (...,) x [1]
    """
    x = np.asarray(score, dtype=float)
    total = np.zeros_like(x)
    for c in classes:
        sd = max(c.sd, _SMALLEST_SD)
        if c.tail_dof is None:
            total += c.fraction * np.exp(-0.5 * ((x - c.mean) / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
        else:
            nu = c.tail_dof
            scale = sd * np.sqrt((nu - 2.0) / nu)
            z = (x - c.mean) / scale
            norm = gammaln(0.5 * (nu + 1)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi) - np.log(scale)
            total += c.fraction * np.exp(norm - 0.5 * (nu + 1) * np.log1p(z**2 / nu))
    return total


def target_density(score: npt.ArrayLike, target: TargetScore) -> Array:
    """Probability density of the score of target pixels (the derivative of 3.31) [per unit of score]."""
    parts = [ClassScore(w, m, s) for w, m, s in zip(target.weights, target.means, target.sds, strict=True)]
    return score_density(score, parts)


def object_detection_probability(threshold: npt.ArrayLike, means: Array, sds: Array) -> Array:
    """Probability that at least one pixel of an object passes the threshold (3.31 for objects).

    1 - prod_j Phi((x - theta_j) / sigma_j), averaged over equally likely positions; the pixels are
    independent given their fills.

    Parameters
    ----------
    threshold : (T,)
    means, sds : (K, n) score statistics of the n pixels at K positions
    """
    x = np.asarray(threshold, dtype=float)
    missed = np.stack([log_ndtr((t - means) / np.maximum(sds, _SMALLEST_SD)).sum(axis=1) for t in x])
    return np.asarray(-np.expm1(missed).mean(axis=1))


def predicted_roc(
    target: TargetScore, classes: Sequence[ClassScore], pfa: npt.ArrayLike | None = None, unit: Unit = "pixel"
) -> RocCurve:
    """The ROC by a sweep of one common threshold (3.30-3.33, corrected); the interval equals the curve."""
    grid = false_alarm_grid() if pfa is None else np.asarray(pfa, dtype=float)
    x = threshold_at(grid, classes)
    pd = np.clip(detection_probability(x, target), 0.0, 1.0)
    return RocCurve(grid, pd, pd, pd, x, unit)


def class_by_class_roc(
    target_mean: float, target_sd: float, classes: Sequence[ClassScore], preset: npt.ArrayLike
) -> RocCurve:
    """The ROC by the printed procedure with its slips mended (3.30-3.33): the same curve as the sweep.

    x_m from a preset P_FA per class (3.30), P_D per class (3.31), the least of them (3.32), and the P_FA
    that the threshold behind it gives over all classes (3.33).
    """
    lp = np.log(np.asarray(preset, dtype=float))
    x_m = np.stack([class_threshold(lp, c) for c in classes if c.fraction > 0])  # (3.30)
    pd_m = ndtr((target_mean - x_m) / max(target_sd, _SMALLEST_SD))  # (3.31)
    # (3.32): the least P_D belongs to the highest threshold; where P_D is 1 to rounding the threshold decides.
    x = x_m.max(axis=0)
    pd = pd_m.min(axis=0)
    pfa = np.exp(log_false_alarm(x, classes))  # (3.33)
    order = np.argsort(pfa)
    return RocCurve(pfa[order], pd[order], pd[order], pd[order], x[order])
