"""Detector scores: moments of the distributions, and their tails as false-alarm probabilities.

Predicted against measured error of a Gaussian maximum-likelihood classifier.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from hyperval.compare.rows import RowMaker, scientific
from hyperval.processing.alarm_blocks import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import ClassificationError, ExceedanceCurve, ScoreDistribution, background_of
from hyperval.results import Cause, Result

ROUNDING = 1e-9  # of a score's standard deviation; chance leaves a mean as small in one of a million images at most


def sd_ratio_interval(predicted_sd: float, observed_sd: float, n: int) -> tuple[float, float]:
    """95 % interval of predicted over observed standard deviation, the latter from n independent normal scores.

    (n - 1) s^2/sigma^2 follows chi-square, so predicted/sigma lies between (predicted/s) sqrt(chi2_a/(n - 1)) and
    the same with chi2_(1 - a).
    """
    low, high = np.sqrt(scipy.stats.chi2.ppf([0.025, 0.975], n - 1) / (n - 1))
    return predicted_sd / observed_sd * float(low), predicted_sd / observed_sd * float(high)


def compare_scores(
    predicted: ScoreDistribution | None,
    observed: ScoreDistribution | None,
    *,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows ``score_mean_predicted``, ``score_mean_observed``, ``score_mean_difference``, ``score_sd_ratio``.

    The difference (predicted - observed) has the interval of the observed mean, s/sqrt(n) with Student's t, or its
    own error where the filter was made of the pixels it scores; their bias is taken off the observed mean there;
    the ratio is predicted over observed.  Scores of one object's pixels are correlated, and then both
    intervals are too narrow: give n as the number of independent pixels.  A mean that is 0 to rounding is that of
    a matched filter on the pixels it was made of: it is 0 whatever they are, says nothing, and has no interval.

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
        bias = 0.0 if math.isnan(observed.mean_bias) else observed.mean_bias
        difference = predicted.mean - (observed.mean - bias)
        half = math.nan
        if n is not None and n >= 2 and abs(observed.mean) > ROUNDING * observed.sd:
            error = observed.sd / math.sqrt(n) if math.isnan(observed.mean_error) else observed.mean_error
            half = float(scipy.stats.t.ppf(0.975, n - 1)) * error
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


def compare_classification(
    predicted: ClassificationError | None,
    observed: ClassificationError | None,
    *,
    subject: str,
    method: str,
) -> list[Result]:
    """Rows of one set of classes in one set of features.

    ``error_predicted``, ``error_observed`` with their intervals; ``error_difference`` predicted - observed with the
    interval of Newcombe (1998); ``error_inside_interval`` 1 where that holds 0; ``error_approximation`` and
    ``error_bounds`` from the predicted Bhattacharyya distances (the bounds are the interval, the value their
    geometric mean); ``distance_predicted``, ``distance_observed`` of the two nearest classes.

    Examples
    --------
    >>> limits = {"bound_lower": 0.02, "bound_upper": 0.22}
    >>> predicted = ClassificationError(0.10, 0.09, 0.11, distance=0.8, approximation=0.1, **limits)
    >>> observed = ClassificationError(0.12, 0.10, 0.14, 400, 380.0, distance=0.7)
    >>> rows = compare_classification(predicted, observed, subject="grass / soil", method="2 bands")
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('error_predicted', 0.1), ('error_observed', 0.12), ('error_difference', -0.02), ('error_inside_interval',
    1.0), ('error_approximation', 0.1), ('distance_predicted', 0.8), ('distance_observed', 0.7),
    ('error_bounds', 0.066)]
    """
    make = RowMaker("classification", subject, method)

    def rows(p: ClassificationError, o: ClassificationError) -> list[Result]:
        difference = p.error - o.error
        below = float(np.hypot(p.error - p.lower, o.upper - o.error))
        above = float(np.hypot(p.upper - p.error, o.error - o.lower))
        words = "" if o.effective_n is None else f"{o.effective_n:.0f} of {o.n} pixels count as independent"
        out = [
            make.row("error_predicted", p.error, interval=(p.lower, p.upper), n=p.n),
            make.row("error_observed", o.error, interval=(o.lower, o.upper), n=o.n, reason=words),
            make.row("error_difference", difference, interval=(difference - below, difference + above), n=o.n),
            make.row("error_inside_interval", float(difference - below <= 0.0 <= difference + above), n=o.n),
            make.row("error_approximation", p.approximation),
            make.row("distance_predicted", p.distance),
            make.row("distance_observed", o.distance, n=o.n),
        ]
        if p.bound_lower > 0:
            middle = float(np.sqrt(p.bound_lower * p.bound_upper))
            out.append(make.row("error_bounds", middle, interval=(p.bound_lower, p.bound_upper)))
        return out

    return make.compared(predicted, observed, rows)
