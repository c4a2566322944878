"""Detector scores: moments of the distributions."""

from __future__ import annotations

import numpy as np
from scipy import stats

from hyperval.compare.rows import RowMaker
from hyperval.products import ScoreDistribution
from hyperval.results import Cause, Result


def sd_ratio_interval(predicted_sd: float, observed_sd: float, n: int) -> tuple[float, float]:
    """95 % interval of predicted over observed standard deviation, the latter from n independent normal scores.

    (n - 1) s^2/sigma^2 follows chi-square, so predicted/sigma lies between (predicted/s) sqrt(chi2_a/(n - 1)) and
    the same with chi2_(1 - a).
    """
    low, high = np.sqrt(stats.chi2.ppf([0.025, 0.975], n - 1) / (n - 1))
    return predicted_sd / observed_sd * float(low), predicted_sd / observed_sd * float(high)


def compare_scores(
    predicted: ScoreDistribution | None,
    observed: ScoreDistribution | None,
    *,
    campaign: str,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows ``score_mean_predicted``, ``score_mean_observed``, ``score_mean_difference``, ``score_sd_ratio``.

    The difference (predicted - observed) has the interval of the observed mean, s/sqrt(n) with Student's t;
    the ratio is predicted over observed.  Scores of one object's pixels are correlated, and then both
    intervals are too narrow: give n as the number of independent pixels.

    Examples
    --------
    >>> predicted, observed = ScoreDistribution(1.0, 0.2), ScoreDistribution(0.9, 0.25, 50)
    >>> rows = compare_scores(predicted, observed, campaign="c", subject="panel", method="cem")
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('score_mean_predicted', 1.0), ('score_mean_observed', 0.9), ('score_mean_difference', 0.1),
    ('score_sd_ratio', 0.8)]
    """
    make = RowMaker(campaign, "scores", subject, method)

    def rows(predicted: ScoreDistribution, observed: ScoreDistribution) -> list[Result]:
        n = observed.n
        difference = predicted.mean - observed.mean
        known = n is not None and n >= 2
        half = stats.t.ppf(0.975, n - 1) * observed.sd / np.sqrt(n) if known and n is not None else np.nan
        out = [
            make.row("score_mean_predicted", predicted.mean, n=predicted.n),
            make.row(
                "score_mean_observed", observed.mean, interval=(observed.mean - half, observed.mean + half), n=n
            ),
            make.row("score_mean_difference", difference, interval=(difference - half, difference + half), n=n),
        ]
        if observed.sd > 0 and n is not None and n >= 2:
            interval = sd_ratio_interval(predicted.sd, observed.sd, n)
            out.append(make.row("score_sd_ratio", predicted.sd / observed.sd, interval=interval, n=n))
        else:
            out.append(
                make.skipped(
                    Cause.FEW_PIXELS, "fewer than two observed scores, or no spread among them", "score_sd_ratio"
                )
            )
        return out

    return make.compared(predicted, observed, rows)
