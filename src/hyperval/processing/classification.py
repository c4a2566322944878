"""How well two classes can be told apart: Bhattacharyya distance and the classification error it bounds.

The FASSP lineage of (3.26-3.33) uses it where the task is classification instead of detection.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from hyperval.processing.filters import PositiveDefinite


def bhattacharyya_distance(
    mean_1: npt.ArrayLike, covariance_1: npt.ArrayLike, mean_2: npt.ArrayLike, covariance_2: npt.ArrayLike
) -> float:
    """Distance of two Gaussian classes in the features of (3.21) [1].

    B = (1/8) d^T C^-1 d + (1/2) ln(|C| / sqrt(|C_1| |C_2|)), C = (C_1 + C_2) / 2 (Fukunaga 1990, section 3.4).

    Parameters
    ----------
    mean_1, mean_2 : (F,);  covariance_1, covariance_2 : (F, F)

    Raises
    ------
    UsageError : a covariance that cannot be inverted.
    """
    c1, c2 = np.asarray(covariance_1, dtype=float), np.asarray(covariance_2, dtype=float)
    d = np.asarray(mean_1, dtype=float) - np.asarray(mean_2, dtype=float)
    middle = PositiveDefinite(0.5 * (c1 + c2))
    logs = [np.linalg.slogdet(c)[1] for c in (middle.matrix, c1, c2)]
    for c in (c1, c2):
        PositiveDefinite(c)  # refuses what has no finite determinant
    return float(0.125 * d @ middle.solve(d) + 0.5 * (logs[0] - 0.5 * (logs[1] + logs[2])))


def classification_error(distance: float, prior_1: float = 0.5) -> tuple[float, float, float]:
    """Error of the best classifier of two Gaussian classes, from their distance B (lineage of 3.31-3.33).

    Returns
    -------
    estimate, lower bound, upper bound [1].  The estimate Phi(-sqrt(2 B)) is exact for equal covariances and equal
    priors; the bounds 1/2 - 1/2 sqrt(1 - 4 p1 p2 exp(-2B)) and sqrt(p1 p2) exp(-B) hold for any classes.
    """
    product = prior_1 * (1.0 - prior_1)
    lower = 0.5 - 0.5 * np.sqrt(max(1.0 - 4.0 * product * np.exp(-2.0 * distance), 0.0))
    upper = min(np.sqrt(product) * np.exp(-distance), prior_1, 1.0 - prior_1)
    return float(ndtr(-np.sqrt(2.0 * max(distance, 0.0)))), float(lower), float(upper)
