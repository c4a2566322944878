"""Covariance of pixels that are fewer than their bands.

A sample covariance of n pixels has no variance at all in B - n + 1 directions.  An error taken from it is nought
there, and a test that divides by it finds a difference in every spectrum.  What so few pixels do tell is the
variance of each band and the few common factors that stand out of chance; the rest is taken as independent from
band to band, as the noise of a sensor is.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

# With fewer the variance of a single band is hardly known, however many bands there are.
FEWEST_DOF = 10


def factor_covariance(covariance: npt.ArrayLike, n: int) -> tuple[Array, float]:
    """Covariance (B, B) of few factors and independent bands, and the degrees of freedom that it is known by.

    In units of the bands' standard deviations, eigenvectors of the sample covariance count as factors as long as
    their eigenvalue is above the edge of pure noise of the same total, s^2 (1 + sqrt(B/m))^2 with m = n - 1 less
    the factors already found and s^2 the rest of the trace over B.  Source: Marchenko & Pastur, Math. USSR Sb. 1,
    457-483, 1967, as a rule for the number of factors Johnstone, Ann. Stat. 29, 295-327, 2001.

    Of the factors F a Wishart matrix of n - 1 degrees of freedom is assumed, of the bands D independent variances:
    the sum of the variances of all elements is {tr(F^2) + tr(F)^2 + 2 tr(D^2)}/(n - 1), and the degrees of freedom
    are those of a Wishart matrix with the same.  They are n - 1 where that is below ten.

    Parameters
    ----------
    covariance : (B, B) unbiased sample covariance with positive diagonal
    n : pixels behind it, two or more

    Raises
    ------
    UsageError : fewer than two pixels, or a band without variance.
    """
    s = np.asarray(covariance, dtype=float)
    variance = np.diag(s)
    if n < 2 or not np.all(variance > 0):
        raise UsageError(f"a covariance of {n} pixels or with a band without variance has no factors")
    sd, m, bands = np.sqrt(variance), n - 1, s.shape[0]
    values, vectors = np.linalg.eigh(s / np.outer(sd, sd))
    values, vectors = np.clip(values[::-1], 0.0, None), vectors[:, ::-1]
    count = 0
    while count < m - 1:
        edge = values[count:].sum() / bands * (1.0 + np.sqrt(bands / (m - count))) ** 2
        if values[count] <= edge:
            break
        count += 1
    factors = (vectors[:, :count] * values[:count]) @ vectors[:, :count].T
    # Each factor fitted takes its part of the bands' own variance along.
    own = np.clip(1.0 - np.diag(factors), 0.0, None) * (m / (m - count))
    out = factors + np.diag(own)
    scatter = np.sum(factors**2) + np.trace(factors) ** 2 + 2.0 * np.sum(own**2)
    dof = m * (np.sum(out**2) + np.trace(out) ** 2) / scatter if m >= FEWEST_DOF else m
    return out * np.outer(sd, sd), float(dof)
