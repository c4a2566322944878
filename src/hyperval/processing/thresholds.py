"""Scores of the background classes and the threshold of the image at a false-alarm probability (3.29, 3.30, 3.33).

One row for each evaluation.  Everything is in logarithms, valid at P_FA = 1e-9.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, log_ndtr, ndtri_exp, stdtr, stdtrit

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
SMALLEST_SD = 1e-12
_LOG_ROOT_2PI = 0.5 * np.log(2.0 * np.pi)
_STEPS = 80


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


def _log_tails(threshold: Array, scores: ClassScores) -> tuple[Array, Array]:
    """log P(score of class m > x) (R, M) at one threshold (R,) for each row, and the log of its density at x.

    For a class with nu degrees of freedom the tail is 1 - F_t,nu((x - theta_m) / (sigma_m sqrt((nu-2)/nu))).
    """
    sd = np.maximum(scores.sd, SMALLEST_SD)
    gaussian = np.isinf(scores.dof)
    x = threshold[:, None]
    if gaussian.all():
        z = (scores.mean - x) / sd
        return log_ndtr(z), -0.5 * z**2 - _LOG_ROOT_2PI - np.log(sd)
    nu = np.where(gaussian, 3.0, scores.dof)
    scale = np.where(gaussian, sd, sd * np.sqrt((nu - 2.0) / nu))
    z = (scores.mean - x) / scale
    tail, density = np.empty_like(z), np.empty_like(z)
    z_g = z[gaussian]
    tail[gaussian], density[gaussian] = log_ndtr(z_g), -0.5 * z_g**2 - _LOG_ROOT_2PI
    z_t, nu_t = z[~gaussian], nu[~gaussian]
    with np.errstate(divide="ignore"):
        tail[~gaussian] = np.log(stdtr(nu_t, z_t))
    norm = gammaln(0.5 * (nu_t + 1)) - gammaln(0.5 * nu_t) - 0.5 * np.log(nu_t * np.pi)
    density[~gaussian] = norm - 0.5 * (nu_t + 1) * np.log1p(z_t**2 / nu_t)
    return tail, density - np.log(scale)


def log_false_alarm(threshold: Array, scores: ClassScores) -> tuple[Array, Array]:
    """log P_FA(x) = log sum f_m P(score of class m > x) (3.33, one threshold for the image), and its derivative.

    Parameters
    ----------
    threshold : (R,) x, one for each row [1]

    Returns
    -------
    (R,) natural logarithms, and (R,) their derivatives by x
    """
    tail, density = _log_tails(threshold, scores)
    with np.errstate(divide="ignore"):
        weight = np.log(scores.fraction)
    tail, density = tail + weight, density + weight
    top = tail.max(axis=1)
    total = top + np.log(np.exp(tail - top[:, None]).sum(axis=1))  # (3.33)
    return total, -np.exp(density - total[:, None]).sum(axis=1)


def greatest_class_false_alarm(threshold: Array, scores: ClassScores) -> Array:
    """(R,) max_m P(score of class m > x): the preset of (3.30) whose least P_D (3.32) has threshold x (R,).

    x = max_m x_m(P) is where the class with the longest tail gives P and all others less.  A curve drawn against P
    is the reading of (3.32) without (3.33): it counts the worst class as if it covered the image.
    """
    tail, _ = _log_tails(threshold, scores)
    return np.asarray(np.exp(np.where(scores.fraction > 0, tail, -np.inf).max(axis=1)))


def score_density(score: Array, scores: ClassScores) -> Array:
    """Density of the background's score at one score (R,) for each row, sum f_m p_m(x) [per unit of score].

    The derivative of (3.33).
    """
    return np.asarray((scores.fraction * np.exp(_log_tails(score, scores)[1])).sum(axis=1))


def thresholds_at(pfa: Array, scores: ClassScores) -> Array:
    """Thresholds (R, K) at which the whole background gives ``pfa`` (R, K) (inverse of 3.33).

    Bracketed in closed form: at max_m x_m(P) no class exceeds P; at the largest x_m(P / f_m) one class alone
    already gives P.  Inside by Newton's steps, halved where they leave the bracket.

    Raises
    ------
    UsageError : no class has an area.
    """
    if not np.any(scores.fraction > 0, axis=1).all():
        raise UsageError("no background class has a positive fraction")
    log_pfa = np.log(pfa)
    low, high = _bracket(log_pfa, scores)
    rows = np.repeat(np.arange(pfa.shape[0]), pfa.shape[1])
    lp, low, high = log_pfa.ravel(), low.ravel(), high.ravel()
    x, root = low.copy(), low.copy()
    at = np.arange(lp.size)  # those not yet found
    for _ in range(_STEPS):
        value, slope = log_false_alarm(x, scores.rows(rows[at]))
        value -= lp[at]
        low, high = np.where(value > 0, x, low), np.where(value > 0, high, x)
        root[at] = x
        width = high - low
        open_ = (np.abs(value) > 1e-12) & (width > 1e-14 * np.maximum(1.0, np.abs(x)))
        if not open_.any():
            break
        with np.errstate(divide="ignore", invalid="ignore"):
            step = x - value / slope
        inside = (step > low) & (step < high)  # False for NaN
        x = np.where(inside, step, 0.5 * (low + high))[open_]
        at, low, high = at[open_], low[open_], high[open_]
    return root.reshape(pfa.shape)


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
