"""False alarms at a stated detection probability, with everything that is uncertain about them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.processing.intervals import clopper_pearson
from hyperval.processing.rank_counts import RankCounts
from hyperval.products import AlarmsAtDetection

STATED_PD = (0.5, 0.9)


def alarms_before_first(target_scores: npt.ArrayLike, background_scores: npt.ArrayLike) -> int:
    """Background pixels that are declared before, or together with, the first pixel of any target.

    The rule of RIT's target detection self-test: the pixels by falling score are read until they meet the target.
    It favours targets of many pixels or pieces, since the luckiest stands for all, and says nothing of the others.
    Source: Snyder et al., IGARSS 2008, II-915.

    Examples
    --------
    >>> alarms_before_first([0.2, 0.7], [0.1, 0.7, 0.9, 0.6])
    2
    """
    best = np.nanmax(np.asarray(target_scores, dtype=float))
    return int(np.count_nonzero(np.asarray(background_scores, dtype=float) >= best))


def alarms_at_detection(
    counts: RankCounts, pd: Sequence[float] = STATED_PD, level: float = 0.95
) -> tuple[AlarmsAtDetection, ...]:
    """Alarms at the highest threshold that declares at least a share ``pd`` of the targets.

    At that threshold as it stands the number of alarms is binomial, and the exact interval of P_FA is that of
    Clopper & Pearson; no alarm at all gives an upper limit like any other number.  The threshold that truly detects
    ``pd`` is known only through the targets: the number of them above it is binomial, so it lies between two of
    their order statistics.  The alarms at these, with the outer limits of Clopper & Pearson, bound the true P_FA;
    both statements at level sqrt(``level``), so that together they hold at ``level`` or more whatever the
    distributions.

    Raises
    ------
    UsageError : a ``pd`` outside (0, 1].
    """
    m = int(counts.targets.sum())
    n = int(counts.ties.sum() + counts.between.sum())
    # Targets, and background scores, at or above each target score; background scores above it.
    reached = np.cumsum(counts.targets[::-1])[::-1]
    at_or_above = np.cumsum((counts.ties + counts.between[1:])[::-1])[::-1]
    above = at_or_above - counts.ties
    each = float(np.sqrt(level))
    tail = (1.0 - each) / 2.0

    def greatest(rank: int) -> int:
        """Place of the ``rank``-th greatest target among the different target scores."""
        return int(np.flatnonzero(reached >= rank)[-1])

    from scipy import stats  # 25 MB with what it loads, which runs without detection do not need

    out = []
    for q in pd:
        if not 0.0 < q <= 1.0:
            raise UsageError(f"a detection probability of {q:g}", expected="above 0, at most 1")
        at = greatest(int(np.ceil(q * m * (1.0 - 1e-12))))
        alarms = int(at_or_above[at])
        fixed = [float(x) for x in clopper_pearson(alarms, n, level)]
        # As for the background in hyperval.processing.roc.pd_at_pfa, with the sides exchanged.
        r, s = int(stats.binom.ppf(tail, m, q)), int(stats.binom.isf(tail, m, q)) + 1
        low = float(clopper_pearson(int(above[greatest(r)]), n, each)[0]) if r >= 1 else 0.0
        high = float(clopper_pearson(int(at_or_above[greatest(s)]), n, each)[1]) if s <= m else 1.0
        out.append(
            AlarmsAtDetection(
                q, float(counts.value[at]), alarms, alarms / n, min(low, fixed[0]), max(high, fixed[1]), *fixed
            )
        )
    return tuple(out)
