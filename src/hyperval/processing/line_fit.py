"""A straight line with errors in both coordinates, for many bands at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]
_ITERATIONS = 100
_TOLERANCE = 1e-13


@dataclass(frozen=True)
class LineFit:
    """y = intercept + slope x for each of B problems of P points.

    ``slope``, ``intercept``, ``reduced_chi2`` are (B,), ``covariance`` of (slope, intercept) is (B, 2, 2),
    ``residuals`` y - intercept - slope x are (P, B).
    """

    slope: Array
    intercept: Array
    covariance: Array
    residuals: Array
    reduced_chi2: Array


def fit_line(x: Array, y: Array, x_variance: Array, y_variance: Array) -> LineFit:
    """Best line through points whose x and y both carry independent errors.

    York's iteration in the form of York, Evensen, Lopez Martinez & De Basabe Delgado, Am. J. Phys. 72,
    367-375, 2004 (their section III, r_i = 0); first given by York, Earth Planet. Sci. Lett. 5, 320-324, 1968.

    Parameters
    ----------
    x, y, x_variance, y_variance : (P, B); in a band either all points have an error or none has, and a band
        without errors is fitted with equal weights and a covariance of zero

    Raises
    ------
    UsageError : some points of a band have an error and others none.
    """
    points, bands = x.shape
    exact = (x_variance == 0) & (y_variance == 0)
    none = exact.all(axis=0)
    if np.any(exact.any(axis=0) & ~none):
        raise UsageError(
            "some panels have an error and others have none",
            mend="give every panel an uncertainty in reflectance or radiance, or none of them",
        )
    # Error-free bands: unit weights make the same iteration ordinary least squares.
    vx, vy = np.where(none, 0.0, x_variance), np.where(none, 1.0, y_variance)
    dx, dy = x - x.mean(axis=0), y - y.mean(axis=0)
    slope = np.sum(dx * dy, axis=0) / np.sum(dx * dx, axis=0)
    for _ in range(_ITERATIONS):
        w, x_bar, y_bar, beta = _york_step(x, y, vx, vy, slope)
        new = np.sum(w * beta * (y - y_bar), axis=0) / np.sum(w * beta * (x - x_bar), axis=0)
        done = np.all(np.abs(new - slope) <= _TOLERANCE * np.abs(new))
        slope = new
        if done:
            break
    w, x_bar, y_bar, beta = _york_step(x, y, vx, vy, slope)
    intercept = y_bar - slope * x_bar
    adjusted = x_bar + beta
    adjusted_bar = np.sum(w * adjusted, axis=0) / np.sum(w, axis=0)
    slope_var = 1.0 / np.sum(w * (adjusted - adjusted_bar) ** 2, axis=0)
    covariance = np.empty((bands, 2, 2))
    covariance[:, 0, 0] = slope_var
    covariance[:, 0, 1] = covariance[:, 1, 0] = -adjusted_bar * slope_var
    covariance[:, 1, 1] = 1.0 / np.sum(w, axis=0) + adjusted_bar**2 * slope_var
    covariance[none] = 0.0
    residuals = y - intercept - slope * x
    if points > 2:
        reduced = np.where(none, np.nan, np.sum(w * residuals**2, axis=0) / (points - 2))
    else:
        reduced = np.full(bands, np.nan)
    return LineFit(slope, intercept, covariance, residuals, reduced)


def _york_step(x: Array, y: Array, vx: Array, vy: Array, slope: Array) -> tuple[Array, Array, Array, Array]:
    w = 1.0 / (vy + slope**2 * vx)  # York et al. 2004, weights W_i with r_i = 0
    total = np.sum(w, axis=0)
    x_bar, y_bar = np.sum(w * x, axis=0) / total, np.sum(w * y, axis=0) / total
    beta = w * ((x - x_bar) * vy + slope * (y - y_bar) * vx)  # beta_i
    return w, x_bar, y_bar, beta
