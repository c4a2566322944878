"""Area under the ROC: Mann-Whitney with ties, DeLong variance, and the part at low false-alarm rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import special

from hyperval.processing.intervals import clopper_pearson
from hyperval.processing.rank_counts import rank_counts
from hyperval.processing.roc import Nan, _valid_scores
from hyperval.processing.roc_areas import RocArea, area_variance, roc_area


@dataclass(frozen=True)
class AucEstimate:
    """Area under the ROC with its variance and interval."""

    auc: float
    variance: float
    lower: float
    upper: float
    n_target: int
    n_background: int


def auc_with_interval(
    target_scores: npt.ArrayLike, background_scores: npt.ArrayLike, *, level: float = 0.95, nan: Nan = "raise"
) -> AucEstimate:
    """Probability that a target outscores a background pixel, ties counted half, with DeLong's interval.

    With V_i the share of background below target i and V_j the share of targets above background j,
    AUC = mean V_i and var = s^2(V_i)/m + s^2(V_j)/n.  Source: DeLong, DeLong & Clarke-Pearson, Biometrics 44,
    837-845, 1988.  The interval is symmetric in logit(AUC), which keeps it inside (0, 1).  One score on a side
    has no spread to estimate: the bound AUC (1 - AUC)/min(m, n) of Birnbaum & Klose (Ann. Math. Stat. 28,
    933-945, 1957) stands in.  Where the samples are fully apart the variance is 0 and the limit is the exact
    binomial one of min(m, n) trials.
    """
    t = _valid_scores(target_scores, "target", nan)
    b = _valid_scores(background_scores, "background", nan)
    m, n = t.size, b.size
    counts = rank_counts(t, b)
    auc = roc_area(counts)
    variance = sum(area_variance(counts)) if min(m, n) > 1 else auc * (1.0 - auc) / min(m, n)
    if auc in (0.0, 1.0) or variance == 0.0:
        trials = min(m, n)
        low, high = (float(x) for x in clopper_pearson(round(auc * trials), trials, level))
        return AucEstimate(auc, variance, min(low, auc), max(high, auc), m, n)
    z = float(special.ndtri(0.5 + level / 2.0))
    half = z * np.sqrt(variance) / (auc * (1.0 - auc))
    centre = special.logit(auc)
    return AucEstimate(
        auc, variance, float(special.expit(centre - half)), float(special.expit(centre + half)), m, n
    )


def partial_auc(
    target_scores: npt.ArrayLike,
    background_scores: npt.ArrayLike,
    pfa_low: float,
    pfa_high: float,
    *,
    logarithmic: bool = False,
    nan: Nan = "raise",
) -> float:
    """Mean detection probability over ``pfa_low`` to ``pfa_high``, evenly in P_FA or in log P_FA, exact with ties.

    Raises
    ------
    UsageError : no such range, no scores on a side, or NaN.
    """
    counts = rank_counts(
        _valid_scores(target_scores, "target", nan), _valid_scores(background_scores, "background", nan)
    )
    return roc_area(counts, RocArea(pfa_low, pfa_high, logarithmic))
