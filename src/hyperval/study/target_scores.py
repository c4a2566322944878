"""Scores of target pixels in many settings (3.26, 3.28), and what a ROC says of them (3.31-3.33)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.special import gammaincinv, log_ndtr, ndtr, ndtri

from hyperval.scene.radiance import illumination_factor
from hyperval.study.filters import Designer, Filters, SeenClasses
from hyperval.study.thresholds import ClassScores, log_false_alarm, thresholds_at
from hyperval.study.views import Views

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
FILL_NODES = np.linspace(0.0, 1.0, 9)  # those of `predict`
_SPLINE = CubicSpline(FILL_NODES, np.eye(FILL_NODES.size))
_SMALLEST_SD = 1e-12
_QUADRATURE = np.polynomial.legendre.leggauss(64)


@dataclass(frozen=True)
class Responses:
    """Score moments against the fill, for R settings of light and sensor.

    Attributes
    ----------
    means : (R, 9) at FILL_NODES (3.26)
    own, host : (R,) score variance of a pixel full of target without its gain, and of host with it
    rest : (R, 9) surroundings and noise (3.28)
    """

    means: Array
    own: Array
    host: Array
    rest: Array

    def at(self, fills: Array, target_gain: Array, rows: Index) -> tuple[Array, Array]:
        """Means and standard deviations (n, K) at fills (n, K) or (1, K), for n evaluations of given rows."""
        f = FILL_NODES
        variance = f**2 * (target_gain * self.own[rows])[:, None] + (1.0 - f) ** 2 * self.host[rows, None]
        variance = variance + self.rest[rows]
        weights = _SPLINE(fills)  # (n or 1, K, 9)
        means = (weights * self.means[rows][:, None, :]).sum(axis=2)
        return means, np.sqrt(np.clip((weights * variance[:, None, :]).sum(axis=2), 0.0, None))


def responses(
    designer: Designer,
    at: Views,
    seen: SeenClasses,
    filters: Filters,
    surfaces: tuple[Array, Array, Array, int],
    shade: tuple[Array, Array] | None,
) -> Responses:
    """Score statistics of pixels of which the target fills f, at FILL_NODES (3.26, 3.28).

    Parameters
    ----------
    surfaces : (F,) mean and (F, F) covariance of the target, (F,) mean of its host, number of the host's class
    shade : (U,) part of the beam and of the sky on the target; None in the open
    """
    own, covariance, host, number = surfaces
    view, f = at.view, FILL_NODES[:, None]
    lit, under_sky, factor = own[None, None, :], own, np.ones(1)
    if shade is not None and view.terms is not None:
        beam, sky = (s[:, None, None] for s in shade)
        factor = illumination_factor(view.terms, view.average, beam, sky)[:, 0]
        lit, under_sky = own * factor[:, None, :], own * sky
    level = view.level(f * lit + (1.0 - f) * host)  # (3.9), (3.10)
    level = np.broadcast_to(level, (len(at), *level.shape[1:]))
    w = filters.weights
    means = np.einsum("uf,ukf->uk", w, (level - seen.offset) / seen.gain) - filters.offset[:, None]  # (3.26)
    through = w * seen.slope
    lit_through = through * factor
    rest = np.einsum("ukf,uf->uk", view.noise_variance(level) / seen.gain**2, w**2)
    # D_B is linear in the reflectance, so that its part of the variance is a square in the fill.
    shape = (len(at), 1, host.size)
    ends = np.concatenate([np.broadcast_to(host, shape), np.broadcast_to(under_sky, shape)], axis=1)
    v = w[:, None, :] * view.adjacency_slope(ends) / seen.gain
    v = v * np.sqrt(at.gains[:, number, None, None] * view.adjacency_weight())
    parts = designer.around(at, np.concatenate([v, v[:, :1] + v[:, 1:]], axis=1))
    zero, one, both = parts[:, :1], parts[:, 1:2], parts[:, 2:]
    g = FILL_NODES
    rest = rest + (1.0 - g) ** 2 * zero + g**2 * one + g * (1.0 - g) * (both - zero - one)
    return Responses(
        means,
        np.einsum("uf,uf->u", lit_through @ covariance, lit_through),
        at.gains[:, number] * np.einsum("uf,uf->u", through @ designer.covariances[number], through),
        rest,
    )


@dataclass(frozen=True)
class PointScores:
    """What the ROC of n evaluations needs.

    Attributes
    ----------
    classes : of the different backgrounds;  which (n,) of them each evaluation has
    means, sds, weights : (n, K) of the target pixels over their fills
    objects : (n, P, J) means and sds of the J pixels of an object at P places; None where a pixel is an object
    """

    classes: ClassScores
    which: Index
    means: Array
    sds: Array
    weights: Array
    objects: tuple[Array, Array] | None = None

    def thresholds(self, pfa: Array) -> Array:
        """(n, K) thresholds at ``pfa`` (n, K) or (1, K)."""
        if pfa.shape[0] == 1:
            rows = self.classes.mean.shape[0]
            found = _known(thresholds_at, np.broadcast_to(pfa, (rows, pfa.shape[1])), self.classes)
            return found[self.which]
        return _known(thresholds_at, pfa, self.classes.rows(self.which))

    def detection(self, pfa: Array) -> Array:
        """P_D (n, K) at ``pfa`` (n, K) or (1, K) (3.31, 3.33)."""
        x = self.thresholds(pfa)
        if self.objects is None:
            found = np.zeros(x.shape)
            for k in range(self.means.shape[1]):
                z = (self.means[:, k, None] - x) / np.maximum(self.sds[:, k, None], _SMALLEST_SD)
                found += self.weights[:, k, None] * ndtr(z)
            return np.clip(found, 0.0, 1.0)
        means, sds = self.objects
        z = (x[:, None, None, :] - means[..., None]) / np.maximum(sds, _SMALLEST_SD)[..., None]
        return np.asarray(-np.expm1(log_ndtr(z).sum(axis=2)).mean(axis=1))

    def log10_false_alarm(self, pd: Array) -> Array:
        """log10 P_FA (n,) at which P_D is ``pd`` (n,), pixels (3.31 solved for the threshold)."""
        sds = np.maximum(self.sds, _SMALLEST_SD)
        x = self.means - sds * ndtri(pd)[:, None]
        low, high = x.min(axis=1), x.max(axis=1)
        for _ in range(60 if x.shape[1] > 1 else 0):
            middle = 0.5 * (low + high)
            above = (self.weights * ndtr((self.means - middle[:, None]) / sds)).sum(axis=1) > pd
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        log_pfa, _ = log_false_alarm(0.5 * (low + high), self.classes.rows(self.which))
        return np.minimum(log_pfa / np.log(10.0), 0.0)

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
        found = np.empty(mean.shape)
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
            z = (self.means[rows] - mean[rows, None])[:, :, None] / np.sqrt(np.maximum(spread, _SMALLEST_SD**2))
            found[rows] = (self.weights[rows] * (ndtr(z) @ weight)).sum(axis=1)
        return found


def _known(solve: Any, pfa: Array, classes: ClassScores) -> Array:
    """Thresholds of the evaluations that have scores; NaN elsewhere."""
    good = np.isfinite(classes.mean).all(axis=1) & np.isfinite(classes.sd).all(axis=1)
    good &= np.all((pfa > 0) & (pfa <= 1), axis=1)
    found = np.full(pfa.shape, np.nan)
    if good.any():
        found[good] = solve(pfa[good], classes.rows(np.flatnonzero(good)))
    return found
