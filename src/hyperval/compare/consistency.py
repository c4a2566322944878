"""Do two spectra agree within their uncertainties?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

# Directions whose variance, in the correlation matrix, is below this part of the greatest are rounding noise.
EIGENVALUE_CUT = 1e-9


@dataclass(frozen=True)
class ChiSquare:
    """A chi-square statistic with its degrees of freedom; ``p_value`` = P(at least this large | consistent)."""

    value: float
    dof: int

    @property
    def reduced(self) -> float:
        """Value over degrees of freedom; NaN without any."""
        return self.value / self.dof if self.dof > 0 else float("nan")

    @property
    def p_value(self) -> float:
        """Upper tail probability; NaN without degrees of freedom."""
        return float(stats.chi2.sf(self.value, self.dof)) if self.dof > 0 else float("nan")


def z_scores(difference: npt.ArrayLike, covariance: npt.ArrayLike) -> Array:
    """(B,) difference over its standard uncertainty, sqrt(u_p^2 + u_c^2); NaN where that is 0.

    Examples
    --------
    >>> z_scores([0.2, 0.0], [[0.01, 0], [0, 0.01]]).round(6).tolist()
    [2.0, 0.0]
    """
    d = np.asarray(difference, dtype=float)
    variance = np.diag(np.asarray(covariance, dtype=float))
    return np.where(variance > 0, d, np.nan) / np.sqrt(np.where(variance > 0, variance, 1.0))


def chi_square_diagonal(difference: npt.ArrayLike, covariance: npt.ArrayLike) -> ChiSquare:
    """Sum of squared z: blind to errors that are common to bands, so it accepts too much."""
    z = z_scores(difference, covariance)
    z = z[np.isfinite(z)]
    return ChiSquare(float(np.sum(z**2)), int(z.size))


def chi_square_full(difference: npt.ArrayLike, covariance: npt.ArrayLike) -> ChiSquare:
    """r^T C^-1 r with the whole covariance of both sides.

    C is scaled to unit diagonal and eigen-decomposed; directions with less than ``EIGENVALUE_CUT`` of the
    greatest eigenvalue are left out, and the degrees of freedom are the directions kept.
    """
    kept, projected = _whitened(difference, covariance)
    return ChiSquare(float(projected @ projected), int(kept))


@dataclass(frozen=True)
class BiasAndShape:
    """A residual split in a common factor and what that leaves.

    ``bias`` and ``bias_sd`` are the factor and its standard uncertainty [1]; ``shape`` is the chi-square
    of the rest, whose sum with (bias/bias_sd)^2 is the full chi-square.
    """

    bias: float
    bias_sd: float
    shape: ChiSquare


def bias_and_shape(difference: npt.ArrayLike, reference: npt.ArrayLike, covariance: npt.ArrayLike) -> BiasAndShape:
    """Split r into a multiple of the reference spectrum and a shape residual (generalised least squares).

    s = c^T C^-1 r/(c^T C^-1 c), sd(s) = (c^T C^-1 c)^-1/2, shape = r^T C^-1 r - (s/sd)^2.
    """
    kept, r = _whitened(difference, covariance)
    _, c = _whitened(reference, covariance)
    weight = float(c @ c)
    if weight <= 0.0:
        return BiasAndShape(float("nan"), float("nan"), ChiSquare(float(r @ r), int(kept)))
    s = float(c @ r) / weight
    rest = r - s * c
    return BiasAndShape(s, weight**-0.5, ChiSquare(float(rest @ rest), int(kept) - 1))


def spectral_angle_degrees(a: npt.ArrayLike, b: npt.ArrayLike) -> float:
    """Angle between two spectra [degrees], exact for small angles: 2 atan2(|u - v|, |u + v|) of unit vectors.

    Source of the measure: Kruse et al., Remote Sens. Environ. 44, 145-163, 1993; of the form: Kahan 2006.

    Examples
    --------
    >>> round(spectral_angle_degrees([1, 0], [1, 1]), 6)
    45.0
    """
    u, v = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    lengths = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    if min(lengths) == 0.0:
        return float("nan")
    u, v = u / lengths[0], v / lengths[1]
    return float(np.degrees(2.0 * np.arctan2(np.linalg.norm(u - v), np.linalg.norm(u + v))))


def _whitened(vector: npt.ArrayLike, covariance: npt.ArrayLike) -> tuple[int, Array]:
    """Directions kept, and the vector in units of its standard deviation along each of them."""
    x, cov = np.asarray(vector, dtype=float), np.asarray(covariance, dtype=float)
    sd = np.sqrt(np.diag(cov))
    if not (np.all(np.isfinite(cov)) and np.all(np.isfinite(x))):
        raise UsageError("a consistency test got NaN or infinity", mend="leave bands without a value out")
    some = sd > 0
    if not np.any(some):
        return 0, np.zeros(0)
    scaled = cov[np.ix_(some, some)] / np.outer(sd[some], sd[some])
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2.0)
    keep = values > EIGENVALUE_CUT * values[-1]
    return int(keep.sum()), (vectors[:, keep].T @ (x[some] / sd[some])) / np.sqrt(values[keep])
