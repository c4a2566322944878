"""The ROC of the model from score statistics (3.31-3.33), a row for each evaluation.

One threshold x serves the whole image: P_D(x) = Phi((theta_T - x)/sigma_T) and
P_FA(x) = sum f_m Phi((theta_m - x)/sigma_m).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv, ndtr, ndtri

from hyperval.processing.thresholds import (
    SMALLEST_SD,
    ClassScores,
    greatest_class_false_alarm,
    log_false_alarm,
    score_density,
    thresholds_at,
)

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
_QUADRATURE = np.polynomial.legendre.leggauss(64)


def detection_probability(threshold: Array, means: Array, sds: Array, weights: Array) -> Array:
    """P_D(x) = sum_k w_k Phi((theta_k - x) / sigma_k) (3.31 with 1/sigma_T, exact over the fill).

    Parameters
    ----------
    threshold : (n, K) x
    means, sds, weights : (n, J) score statistics at the fills, and their probabilities

    Returns
    -------
    (n, K)
    """
    pd = np.zeros(threshold.shape)
    for k in range(means.shape[1]):
        z = (means[:, k, None] - threshold) / np.maximum(sds[:, k, None], SMALLEST_SD)
        pd += weights[:, k, None] * ndtr(z)  # (3.31)
    return np.clip(pd, 0.0, 1.0)


def object_detection_probability(threshold: Array, means: Array, sds: Array) -> Array:
    """Probability that at least one pixel of an object passes the threshold (3.31 for objects).

    1 - prod_j (1 - Phi((theta_j - x) / sigma_j)), averaged over equally likely places; the pixels are
    independent given their fills.

    Parameters
    ----------
    threshold : (n, K)
    means, sds : (n, P, J) score statistics of the J pixels at P places

    Returns
    -------
    (n, K)
    """
    pd = np.empty(threshold.shape)
    inverse = 1.0 / np.maximum(np.ascontiguousarray(np.moveaxis(sds, 2, 0)), SMALLEST_SD)  # (J, n, P)
    reached = np.moveaxis(means, 2, 0) * inverse
    for k in range(threshold.shape[1]):
        passed, *others = ndtr(reached - threshold[:, k, None] * inverse)
        for other in others:
            passed += other * (1.0 - passed)  # small probabilities keep their digits
        pd[:, k] = passed.mean(axis=1)
    return pd


@dataclass(frozen=True)
class RocScores:
    """What the ROC of n evaluations needs.

    Attributes
    ----------
    classes : of the different backgrounds;  which (n,) of them each evaluation has
    means, sds, weights : (n, J) of the target pixels over their fills
    objects : (n, P, J) means and sds of the J pixels of an object at P places; None where a pixel is an object
    """

    classes: ClassScores
    which: Index
    means: Array
    sds: Array
    weights: Array
    objects: tuple[Array, Array] | None = None

    @property
    def mean(self) -> Array:
        """(n,) mean score of the target pixels."""
        return np.asarray((self.weights * self.means).sum(axis=1))

    @property
    def sd(self) -> Array:
        """(n,) standard deviation of that score, the spread of the fill included."""
        away = self.means - self.mean[:, None]
        return np.asarray(np.sqrt((self.weights * (self.sds**2 + away**2)).sum(axis=1)))

    def distinct(self) -> tuple[Index, Index]:
        """First of all evaluations whose pixels score the same, and which (n,) of these each evaluation is."""
        parts = [self.which[:, None], self.means, self.sds, self.weights]
        keys = [b"".join(np.ascontiguousarray(p[i]).tobytes() for p in parts) for i in range(self.which.size)]
        order = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        which = np.array([order[key] for key in keys])
        return np.unique(which, return_index=True)[1], which

    def rows(self, index: Index) -> RocScores:
        """The evaluations that ``index`` names."""
        objects = None if self.objects is None else (self.objects[0][index], self.objects[1][index])
        return RocScores(
            self.classes, self.which[index], self.means[index], self.sds[index], self.weights[index], objects
        )

    def thresholds(self, pfa: Array) -> Array:
        """(n, K) thresholds at ``pfa`` (n, K) or (1, K)."""
        if pfa.shape[0] == 1:
            rows = self.classes.mean.shape[0]
            threshold = _known(thresholds_at, np.broadcast_to(pfa, (rows, pfa.shape[1])), self.classes)
            return threshold[self.which]
        return _known(thresholds_at, pfa, self.classes.rows(self.which))

    def preset(self, thresholds: Array) -> Array:
        """(n, K) preset P_FA of (3.30) whose least P_D (3.32) has ``thresholds`` (n, K)."""
        rows = np.repeat(self.which, thresholds.shape[1])
        return greatest_class_false_alarm(thresholds.ravel(), self.classes.rows(rows)).reshape(thresholds.shape)

    def detection_above(self, thresholds: Array) -> Array:
        """P_D (n, K) above ``thresholds`` (n, K) (3.31)."""
        if self.objects is None:
            return detection_probability(thresholds, self.means, self.sds, self.weights)
        return object_detection_probability(thresholds, *self.objects)

    def detection(self, pfa: Array) -> Array:
        """P_D (n, K) at ``pfa`` (n, K) or (1, K) (3.31, 3.33)."""
        return self.detection_above(self.thresholds(pfa))

    def background_density(self, score: Array) -> Array:
        """Density of the background's score at ``score`` (n, K) (3.33) [per unit of score]."""
        return score_density(score, self.classes.rows(self.which))

    def target_density(self, score: Array) -> Array:
        """Density of the target pixels' score at ``score`` (n, K), the derivative of (3.31) [per unit of score]."""
        return score_density(
            score, ClassScores(self.weights, self.means, self.sds, np.full(self.means.shape, np.inf))
        )

    def log10_false_alarm(self, pd: Array) -> Array:
        """log10 P_FA (n,) at which P_D is ``pd`` (n,), pixels (3.31 solved for the threshold)."""
        sds = np.maximum(self.sds, SMALLEST_SD)
        x = self.means - sds * ndtri(pd)[:, None]
        low, high = x.min(axis=1), x.max(axis=1)
        for _ in range(60 if x.shape[1] > 1 else 0):
            middle = 0.5 * (low + high)
            above = (self.weights * ndtr((self.means - middle[:, None]) / sds)).sum(axis=1) > pd
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        log_pfa, _ = log_false_alarm(0.5 * (low + high), self.classes.rows(self.which))
        return np.asarray(np.minimum(log_pfa / np.log(10.0), 0.0))

    def auc(self) -> Array:
        """Area under the ROC (n,): the probability that a target pixel outscores a background pixel.

        Two Gaussians: Phi((theta_T - theta_m) / sqrt(sigma_T^2 + sigma_m^2)).  A t score is a Gaussian whose
        variance is divided by a chi-square over its degrees of freedom: 64 Gauss-Legendre nodes in its quantile.
        """
        c = self.classes.rows(self.which)
        total = np.zeros(self.which.size)
        for m in range(c.mean.shape[1]):
            total += c.fraction[:, m] * self._over_class(c.mean[:, m], c.sd[:, m], c.dof[:, m])
        return total

    def _over_class(self, mean: Array, sd: Array, dof: Array) -> Array:
        probability = np.empty(mean.shape)
        gaussian = np.isinf(dof)
        for rows, nodes in ((np.flatnonzero(gaussian), False), (np.flatnonzero(~gaussian), True)):
            if not rows.size:
                continue
            if nodes:
                x, weight = _QUADRATURE
                nu = dof[rows, None]
                factor, weight = (nu - 2.0) / (2.0 * gammaincinv(0.5 * nu, 0.5 * (x + 1.0))), 0.5 * weight
            else:
                factor, weight = np.ones((rows.size, 1)), np.ones(1)
            spread = self.sds[rows, :, None] ** 2 + (sd[rows] ** 2)[:, None, None] * factor[:, None, :]
            z = (self.means[rows] - mean[rows, None])[:, :, None] / np.sqrt(np.maximum(spread, SMALLEST_SD**2))
            probability[rows] = (self.weights[rows] * (ndtr(z) @ weight)).sum(axis=1)
        return probability


def _known(solve: Any, pfa: Array, classes: ClassScores) -> Array:
    """Thresholds of the evaluations that have scores; NaN elsewhere."""
    good = np.isfinite(classes.mean).all(axis=1) & np.isfinite(classes.sd).all(axis=1)
    good &= np.all((pfa > 0) & (pfa <= 1), axis=1)
    out = np.full(pfa.shape, np.nan)
    if good.any():
        out[good] = solve(pfa[good], classes.rows(np.flatnonzero(good)))
    return out
