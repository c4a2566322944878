"""Detector scores: moments of the distributions, and their tails as false-alarm probabilities."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from hyperval.compare.rows import RowMaker, scientific
from hyperval.processing.exceedance import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import ExceedanceCurve, ScoreDistribution, background_of
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
    >>> rows = compare_scores(predicted, observed, subject="panel", method="cem")
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('score_mean_predicted', 1.0), ('score_mean_observed', 0.9), ('score_mean_difference', 0.1),
    ('score_sd_ratio', 0.8)]
    """
    make = RowMaker("scores", subject, method)

    def rows(predicted: ScoreDistribution, observed: ScoreDistribution) -> list[Result]:
        n = observed.n
        difference = predicted.mean - observed.mean
        known = n is not None and n >= 2
        half = stats.t.ppf(0.975, n - 1) * observed.sd / np.sqrt(n) if known and n is not None else np.nan
        out = [
            make.row("score_mean_predicted", predicted.mean, n=predicted.n),
            make.row("score_mean_observed", observed.mean, half=half, n=n),
            make.row("score_mean_difference", difference, half=half, n=n),
        ]
        if observed.sd > 0 and n is not None and n >= 2:
            interval = sd_ratio_interval(predicted.sd, observed.sd, n)
            out.append(make.row("score_sd_ratio", predicted.sd / observed.sd, interval=interval, n=n))
        else:
            why = "fewer than two observed scores, or no spread among them"
            out.append(make.skipped(Cause.FEW_PIXELS, why, "score_sd_ratio"))
        return out

    return make.compared(predicted, observed, rows)


LEVELS = (1e-1, 1e-2, 1e-3, 1e-4)


def compare_exceedance(
    predicted: ExceedanceCurve | None,
    observed: ExceedanceCurve | None,
    *,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows ``pfa_ratio@1e-3`` and the like: predicted over measured P_FA at the threshold that was measured for it.

    Beside it ``pfa_repeatability@1e-3``: the factor by which one half of the image misses the other half's P_FA
    at that threshold; what a model can be asked for ends there.

    The interval has that of the measured P_FA, from blocks of the image, and what the pixels leave open that the
    law was fitted to.  A level that expects fewer than 10 alarms gives a SKIPPED row, save that levels below 1e-3
    then give none.

    Parameters
    ----------
    subject : what is looked for; the rows stand under the name of its background
    """
    make = RowMaker("scores", background_of(subject), method)

    def rows(predicted: ExceedanceCurve, observed: ExceedanceCurve) -> list[Result]:
        out = []
        for level in LEVELS:
            name, expected = f"pfa_ratio@{scientific(level)}", level * (observed.n or 0)
            if expected < LEAST_EXPECTED_ALARMS:
                if level >= 1e-3:
                    why = f"{observed.n} background pixels expect {expected:.3g} alarms"
                    out.append(make.skipped(Cause.FEW_ALARMS, why, name))
                continue
            ratio = false_alarm_ratio(predicted, observed, level)
            at, model = ratio.at, ratio.predicted
            measured, threshold = float(observed.probability[at]), float(observed.threshold[at])
            beyond = threshold > predicted.threshold[predicted.probability > 0][-1]
            words = f"threshold {threshold:.4g}: predicted {'at most ' if beyond else ''}{model:.3g}, "
            words += f"measured {measured:.3g} ({observed.lower[at]:.2g} to {observed.upper[at]:.2g})"
            interval = ratio.lower, ratio.upper
            words += f"; its law is known to a factor of {ratio.law_factor:.2g}" if ratio.law_factor > 1.0 else ""
            factor = math.nan if observed.half_image is None else float(observed.half_image[at])
            if observed.half_image is not None:
                words += f"; one half of the image misses the other by a factor of {factor:.2g}"
            out.append(make.row(name, ratio.value, interval=interval, n=observed.n, reason=words))
            alarms = round(measured * (observed.n or 0))
            if np.isfinite(factor):
                name, why = f"pfa_repeatability@{scientific(level)}", "half of the random halves differ less"
                out.append(make.row(name, factor, n=observed.n, reason=f"of {alarms} alarms; {why}"))
        return out

    return make.compared(predicted, observed, rows)
