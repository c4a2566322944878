"""How much better the data would be understood if one input were less well known than stated.

The residual r of all compared quantities is normal with the covariance C of both sides' stated uncertainties.
An input moves the prediction by G z, z ~ N(0, 1) for each direction.  To free it is to add tau^2 G G^T to C, with
the tau that makes r most likely.  Twice the log-likelihood so gained ranks the inputs: an input whose pattern does
not look like r gains nothing, and one with many directions pays for them by the determinant.  (Variance components
by maximum likelihood: Patterson & Thompson, Biometrika 58, 545, 1971; with one direction it follows the pull of a
fit.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import linalg, optimize, stats

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

_GRID = np.geomspace(1e-4, 1e8, 97)


@dataclass(frozen=True)
class Explanation:
    """What freeing one input does.

    Attributes
    ----------
    gain : twice the log-likelihood gained; 0 when freeing it does not help
    tau : added standard deviation of each direction, in units of the directions given
    amplitudes : (k,) most likely size of each direction
    chi_square, dof : of the residual under the widened covariance
    limited : whether it would have to move farther than it can; then it is moved as far as it can, and the
        covariance stays
    """

    gain: float
    tau: float
    amplitudes: Array
    chi_square: float
    dof: int
    limited: bool = False

    @property
    def p_value(self) -> float:
        """Probability of a residual at least this large with the widened covariance."""
        return float(stats.chi2.sf(self.chi_square, self.dof))


class Whitened:
    """A residual in units of its stated uncertainty: C = L L^T, e = L^-1 r.

    Raises
    ------
    UsageError : values that are not finite, or a covariance that is not positive definite.

    Examples
    --------
    >>> data = Whitened([2.0, 1.0], np.eye(2))
    >>> data.chi_square / data.dof, round(data.p_value, 3)
    (2.5, 0.082)
    """

    def __init__(self, residual: npt.ArrayLike, covariance: npt.ArrayLike):
        r, c = np.asarray(residual, dtype=float), np.asarray(covariance, dtype=float)
        if r.size == 0 or not (np.isfinite(r).all() and np.isfinite(c).all()):
            raise UsageError("attribution needs finite residuals", mend="leave out what has no value")
        self._sd = np.sqrt(np.diag(c))
        if not np.all(self._sd > 0):
            raise UsageError("attribution needs an uncertainty for every residual")
        try:
            self._lower = linalg.cholesky(c / np.outer(self._sd, self._sd), lower=True)
        except linalg.LinAlgError as error:
            raise UsageError("the covariance of the residuals is not positive definite") from error
        self.residual = self.whiten(r)

    def whiten(self, columns: npt.ArrayLike) -> Array:
        """L^-1 times columns (n,) or (n, k)."""
        x = (np.asarray(columns, dtype=float).T / self._sd).T
        return np.asarray(linalg.solve_triangular(self._lower, x, lower=True))

    @property
    def chi_square(self) -> float:
        """r^T C^-1 r."""
        return float(self.residual @ self.residual)

    @property
    def dof(self) -> int:
        """Number of residuals."""
        return int(self.residual.size)

    @property
    def p_value(self) -> float:
        """Probability of a residual at least this large when the stated uncertainties hold."""
        return float(stats.chi2.sf(self.chi_square, self.dof))


def explanation(data: Whitened, columns: npt.ArrayLike, *, budgeted: bool, most: float = np.inf) -> Explanation:
    """Free one input and see what it gains.

    Parameters
    ----------
    columns : (n,) or (n, k) change of the compared quantities (prediction) per standard uncertainty
    budgeted : whether C holds these columns already; then tau comes on top of 1
    most : greatest tau, and greatest amplitude of any direction; an input that would have to move farther than it
        can is no reason

    Examples
    --------
    >>> why = explanation(Whitened([3.0, 0.1], np.eye(2)), [1.0, 0.0], budgeted=False)
    >>> round(why.gain, 2), round(why.tau, 2), round(why.chi_square, 2), round(why.p_value, 2)
    (5.8, 2.83, 1.01, 0.6)
    """
    w = data.whiten(columns)
    w = w[:, None] if w.ndim == 1 else w
    u, s, vt = linalg.svd(w, full_matrices=False)
    keep = s > 1e-12 * max(float(s[0]), 1e-300)
    if not np.any(s > 0):
        return Explanation(0.0, 0.0, np.zeros(w.shape[1]), data.chi_square, data.dof)
    u, s, vt = u[:, keep], s[keep], vt[keep]
    q = u.T @ data.residual

    t2 = _best_tau_squared(s, q, most**2)
    shrink = 1.0 / (1.0 + t2 * s**2)
    z = (t2 + float(budgeted)) * (vt.T @ (s * shrink * q))  # best linear unbiased prediction of z
    if np.max(np.abs(z)) > most:  # it goes as far as it can, and the rest stays
        z = np.clip(z, -most, most)
        left = data.residual - w @ z
        chi = float(left @ left)
        gain = data.chi_square - chi - float(np.sum(np.log1p(t2 * s**2)))
        return Explanation(max(gain, 0.0), most, z, chi, data.dof, True)
    gain = float(_gain(t2, s, q))
    chi = data.chi_square - float(np.sum((1.0 - shrink) * q**2))
    return Explanation(max(gain, 0.0), float(np.sqrt(t2)), z, chi, data.dof)


def _gain(t2: float, s: Array, q: Array) -> float:
    """2 ln L(tau) - 2 ln L(0): what the quadratic form falls by, less the logarithm of the determinant."""
    x = t2 * s**2
    return float(np.sum(x / (1.0 + x) * q**2 - np.log1p(x)))


def _best_tau_squared(s: Array, q: Array, most: float) -> float:
    if s.size == 1:  # d/dt2 = 0 at 1 + t2 s^2 = q^2
        return min(max(float(q[0] ** 2) - 1.0, 0.0) / float(s[0] ** 2), most)
    grid = np.minimum(_GRID / float(s[0] ** 2), most)
    values = np.array([_gain(t, s, q) for t in grid])
    best = int(np.argmax(values))
    if values[best] <= 0.0:
        return 0.0
    low, high = np.log(grid[max(best - 1, 0)]), np.log(grid[min(best + 1, grid.size - 1)])
    if not high > low:
        return float(grid[best])
    optimum = optimize.minimize_scalar(lambda t: -_gain(np.exp(t), s, q), bounds=(low, high), method="bounded")
    return float(np.exp(optimum.x))


def closing_change(gap: float, change_per_unit: float) -> float:
    """Units of an input that close the gap (observed - predicted) of one quantity; infinite where it moves nothing.

    Examples
    --------
    >>> closing_change(0.3, -0.1)
    -3.0
    """
    return round(gap / change_per_unit, 12) if change_per_unit else float("inf")
