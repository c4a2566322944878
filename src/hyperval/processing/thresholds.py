"""Scores of the background classes and the threshold of the image at a false-alarm probability (3.29, 3.30, 3.33).

One row for each evaluation.  Everything is in logarithms, valid at P_FA = 1e-9.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, log_ndtr, ndtri_exp, stdtr, stdtrit

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
SMALLEST_SD = 1e-12
_LOG_ROOT_2PI = 0.5 * np.log(2.0 * np.pi)
_STEPS = 80
_TOGETHER = 16_384  # numbers of one array on the way to thresholds: they stay in the processor's cache
# A step from nearer than this to the logarithm wanted is of third order: it ends within 1e-14 of it.
_NEAR, _STRAIGHT = 1e-5, 1e-4


@dataclass(frozen=True)
class ClassScores:
    """Scores of M classes in R evaluations.

    Attributes
    ----------
    fraction : (R, M) f_m
    mean, sd : (R, M) theta_m, sigma_m of (3.27), (3.29)
    dof : (R, M) degrees of freedom of the tail; infinity: Gaussian
    """

    fraction: Array
    mean: Array
    sd: Array
    dof: Array

    def rows(self, index: npt.NDArray[np.intp]) -> ClassScores:
        """The evaluations that ``index`` names."""
        return ClassScores(self.fraction[index], self.mean[index], self.sd[index], self.dof[index])


def false_alarm_grid(lowest: float = 1e-9, per_decade: int = 20) -> Array:
    """(K,) increasing, log-spaced false-alarm probabilities from ``lowest`` to 0.999 for (3.33)."""
    decades = -np.log10(lowest)
    grid = np.logspace(-decades, 0.0, round(decades * per_decade) + 1)
    grid[-1] = 0.999
    return grid


@dataclass(frozen=True)
class _Laws:
    """The same with the classes first, (M, n) each, so that sums over classes run along the memory.

    For a class with nu degrees of freedom the tail is 1 - F_t,nu((x - theta_m) / (sigma_m sqrt((nu-2)/nu))).

    Attributes
    ----------
    log_fraction, mean, scale : log f_m, theta_m, sigma_m or that of the t law
    log_peak : log of the density at its middle
    dof : of the t laws, NaN of Gaussian ones; None where all are
    """

    log_fraction: Array
    mean: Array
    scale: Array
    log_peak: Array
    dof: Array | None

    @staticmethod
    def of(scores: ClassScores) -> _Laws:
        """The laws of R evaluations."""
        fraction, mean, sd, nu = (np.ascontiguousarray(a.T) for a in vars(scores).values())
        scale = np.maximum(sd, SMALLEST_SD)
        with np.errstate(divide="ignore"):
            weight = np.log(fraction)
        gaussian = np.isinf(nu)
        if gaussian.all():
            return _Laws(weight, mean, scale, -_LOG_ROOT_2PI - np.log(scale), None)
        nu = np.where(gaussian, np.nan, nu)
        scale = np.where(gaussian, scale, scale * np.sqrt((nu - 2.0) / nu))
        norm = gammaln(0.5 * (nu + 1)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi)
        return _Laws(weight, mean, scale, np.where(gaussian, -_LOG_ROOT_2PI, norm) - np.log(scale), nu)

    def rows(self, index: npt.NDArray[Any]) -> _Laws:
        """The evaluations that ``index`` (numbers or a mask) names."""
        return _Laws(*(None if a is None else a[:, index] for a in vars(self).values()))  # type: ignore[arg-type]

    def log_tails(self, threshold: Array) -> tuple[Array, Array, Array]:
        """log P(score > x), log of the density, and the slope of that, (M, n) each, at x (n,)."""
        z = (self.mean - threshold) / self.scale
        density = self._log_density(z)
        if self.dof is None:
            return log_ndtr(z), density, z / self.scale
        gaussian, nu = np.isnan(self.dof), self.dof
        tail = np.empty_like(z)
        tail[gaussian] = log_ndtr(z[gaussian])
        with np.errstate(divide="ignore"):
            tail[~gaussian] = np.log(stdtr(nu[~gaussian], z[~gaussian]))
        slope = np.where(gaussian, z, (nu + 1) * z / (nu + z**2))
        return tail, density, slope / self.scale

    def log_density(self, score: Array) -> Array:
        """(M, n) at x (n,)."""
        return self._log_density((self.mean - score) / self.scale)

    def _log_density(self, z: Array) -> Array:
        if self.dof is None:
            return self.log_peak - 0.5 * z**2
        nu, gaussian = self.dof, np.isnan(self.dof)
        return self.log_peak + np.where(gaussian, -0.5 * z**2, -0.5 * (nu + 1) * np.log1p(z**2 / nu))

    def log_false_alarm(self, threshold: Array) -> tuple[Array, Array, Array]:
        """log P_FA(x) = log sum f_m P(score of class m > x) (3.33) and its two first derivatives (n,) at x (n,)."""
        tail, density, bend = self.log_tails(threshold)
        tail += self.log_fraction
        top = tail.max(axis=0)
        total = top + np.log(np.exp(tail - top).sum(axis=0))  # (3.33)
        part = np.exp(density + self.log_fraction - total)
        slope = -part.sum(axis=0)
        return total, slope, -(part * bend).sum(axis=0) - slope**2


def log_false_alarm(threshold: Array, scores: ClassScores) -> tuple[Array, Array]:
    """log P_FA(x) = log sum f_m P(score of class m > x) (3.33, one threshold for the image), and its derivative.

    Parameters
    ----------
    threshold : (R,) x, one for each row [1]

    Returns
    -------
    (R,) natural logarithms, and (R,) their derivatives by x
    """
    return _Laws.of(scores).log_false_alarm(threshold)[:2]


def greatest_class_false_alarm(threshold: Array, scores: ClassScores) -> Array:
    """(R,) max_m P(score of class m > x): the preset of (3.30) whose least P_D (3.32) has threshold x (R,).

    x = max_m x_m(P) is where the class with the longest tail gives P and all others less.  A curve drawn against P
    is the reading of (3.32) without (3.33): it counts the worst class as if it covered the image.
    """
    tail, _, _ = _Laws.of(scores).log_tails(threshold)
    return np.asarray(np.exp(np.where(scores.fraction.T > 0, tail, -np.inf).max(axis=0)))


def score_density(score: Array, scores: ClassScores) -> Array:
    """Density of the background's score at scores (R, K), sum f_m p_m(x) [per unit of score].

    The derivative of (3.33).
    """
    laws = _Laws.of(scores).rows(np.repeat(np.arange(score.shape[0]), score.shape[1]))
    density = np.exp(laws.log_density(score.ravel()) + laws.log_fraction)
    return np.asarray(density.sum(axis=0)).reshape(score.shape)


def thresholds_at(pfa: Array, scores: ClassScores) -> Array:
    """Thresholds (R, K) at which the whole background gives ``pfa`` (R, K) (inverse of 3.33).

    Bracketed in closed form: at max_m x_m(P) no class exceeds P; at the largest x_m(P / f_m) one class alone
    already gives P.  Inside by steps of third order, halved where they leave the bracket.

    Raises
    ------
    UsageError : no class has an area.
    """
    if not np.any(scores.fraction > 0, axis=1).all():
        raise UsageError("no background class has a positive fraction")
    roots = np.empty(pfa.shape)
    together = max(1, _TOGETHER // max(1, pfa.shape[1] * scores.fraction.shape[1]))
    for start in range(0, pfa.shape[0], together):
        rows = slice(start, start + together)
        roots[rows] = _thresholds(np.log(pfa[rows]), scores.rows(np.arange(pfa.shape[0])[rows]))
    return roots


def _thresholds(log_pfa: Array, scores: ClassScores) -> Array:
    low, high = (end.ravel() for end in _bracket(log_pfa, scores))
    laws = _Laws.of(scores).rows(np.repeat(np.arange(log_pfa.shape[0]), log_pfa.shape[1]))
    goal, x, roots = log_pfa.ravel(), low.copy(), low.copy()
    at = np.arange(goal.size)  # those not yet there
    for _ in range(_STEPS):
        value, slope, curve = laws.log_false_alarm(x)
        value -= goal
        low, high = np.where(value > 0, x, low), np.where(value > 0, high, x)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - 2.0 * value * slope / (2.0 * slope**2 - value * curve)
        inside = (step > low) & (step < high)  # False for NaN
        last = inside & (np.abs(value) < _NEAR) & (np.abs(value * curve) < _STRAIGHT * slope**2)
        roots[at] = np.where(last, step, x)
        open_ = ~last & (np.abs(value) > 1e-12) & (high - low > 1e-14 * np.maximum(1.0, np.abs(x)))
        if not open_.any():
            break
        x = np.where(inside, step, 0.5 * (low + high))[open_]
        at, low, high, goal = at[open_], low[open_], high[open_], goal[open_]
        laws = laws.rows(open_)
    return roots.reshape(log_pfa.shape)


def _bracket(log_pfa: Array, scores: ClassScores) -> tuple[Array, Array]:
    used = scores.fraction > 0
    rows, points = log_pfa.shape
    low, high = np.full((rows, points), np.inf), np.full((rows, points), -np.inf)
    share_low = np.full((rows, points), -np.inf)
    for m in range(scores.mean.shape[1]):
        here = used[:, m]
        if not here.any():
            continue
        one = scores.rows(np.flatnonzero(here))
        alone = class_threshold(np.minimum(log_pfa[here], 0.0), one, m)
        low[here], high[here] = np.minimum(low[here], alone), np.maximum(high[here], alone)
        share = log_pfa[here] - np.log(one.fraction[:, m, None])
        x = class_threshold(np.minimum(share, -1e-300), one, m)
        share_low[here] = np.maximum(share_low[here], np.where(share < 0, x, -np.inf))
    return np.minimum(np.maximum(low, share_low), high), high


def class_threshold(log_pfa: Array, scores: ClassScores, m: int) -> Array:
    """x_m = theta_m - sigma_m Phi^-1(P_FA) (R, K): threshold at which class m alone gives P_FA (R, K) (3.30).

    The printed form has the sign of Phi^-1 the other way round, which puts the threshold below the
    class mean for P_FA < 0.5.
    """
    mean, sd, nu = (a[:, m, None] for a in (scores.mean, scores.sd, scores.dof))
    # Most batches ask all rows for the same probabilities: the quantile is looked up once.
    one = log_pfa[:1] if np.all(log_pfa == log_pfa[:1]) else log_pfa
    gaussian = np.isinf(nu[:, 0])
    x = np.empty(log_pfa.shape)
    if gaussian.any():
        z = ndtri_exp(one if one.shape[0] == 1 else one[gaussian])
        x[gaussian] = mean[gaussian] - sd[gaussian] * z  # (3.30)
    if not gaussian.all():
        t = ~gaussian
        scale = sd[t] * np.sqrt((nu[t] - 2.0) / nu[t])
        x[t] = mean[t] - scale * stdtrit(nu[t], np.exp(one if one.shape[0] == 1 else one[t]))
    return x
