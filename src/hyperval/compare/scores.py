"""Detector scores: moments of the distributions, and each object against its prediction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy import special, stats

from hyperval.compare.difference import Z95
from hyperval.compare.rows import RowMaker
from hyperval.errors import UsageError
from hyperval.processing.intervals import clopper_pearson
from hyperval.products import ScoreDistribution
from hyperval.results import Result

Array = npt.NDArray[np.float64]


def probability_integral_transform(score: float, predicted: ScoreDistribution) -> float:
    """Probability that the predicted normal distribution gives a score below the measured one.

    Over many objects, each with its own prediction, the values are uniform on (0, 1) when the predictions are
    right, so objects of different kinds are judged together.  Source: Rosenblatt, Ann. Math. Stat. 23, 470, 1952.
    """
    if not predicted.sd > 0:
        return float("nan")
    return float(special.ndtr((score - predicted.mean) / predicted.sd))


def uniformity_p_value(values: npt.ArrayLike) -> float:
    """Exact two-sided Kolmogorov-Smirnov p-value of a sample against the uniform distribution on (0, 1)."""
    u = np.asarray(values, dtype=float)
    if u.size == 0 or not np.all((u >= 0) & (u <= 1)):
        raise UsageError("the uniformity test needs values between 0 and 1")
    return float(stats.kstest(u, "uniform", method="exact").pvalue)


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
            out.append(make.skipped("fewer than two observed scores, or no spread among them", "score_sd_ratio"))
        return out

    return make.compared(predicted, observed, rows)


def compare_object_scores(
    predicted: Mapping[str, ScoreDistribution],
    measured: Mapping[str, float],
    *,
    campaign: str,
    method: str,
    subject: str = "all objects",
) -> list[Result]:
    """Every object's measured score against its predicted distribution, then all of them together.

    Per object (the row's subject): ``object_score_pit`` and ``object_score_inside_95`` (1 or 0).  Together
    (``subject``): ``objects_inside_95`` the share inside with its Clopper-Pearson interval, and
    ``pit_uniformity_p_value``.  Objects with only one side, or without a valid score, give SKIPPED rows and are
    named in the reason of the summary.
    """
    out: list[Result] = []
    transforms: list[float] = []
    lost: list[str] = []
    for name in sorted({*predicted, *measured}):
        make = RowMaker(campaign, "scores", name, method)
        score, model = measured.get(name, float("nan")), predicted.get(name)
        if model is None or not model.sd > 0 or not np.isfinite(score):
            what = "no predicted distribution" if model is None or not model.sd > 0 else "no measured score"
            out += [make.skipped(what, m) for m in ("object_score_pit", "object_score_inside_95")]
            lost.append(name)
            continue
        u = probability_integral_transform(score, model)
        inside = abs(score - model.mean) <= Z95 * model.sd
        transforms.append(u)
        out.append(make.row("object_score_pit", u, n=1))
        out.append(
            make.row(
                "object_score_inside_95",
                float(inside),
                n=1,
                reason=f"measured {score:.4g}, predicted {model.mean:.4g} with sd {model.sd:.4g}",
            )
        )
    make = RowMaker(campaign, "scores", subject, method)
    if not transforms:
        return [
            *out,
            *(make.skipped("no object has both sides", m) for m in ("objects_inside_95", "pit_uniformity_p_value")),
        ]
    values = np.asarray(transforms)
    count = int(np.sum((values >= 0.025) & (values <= 0.975)))
    low, high = clopper_pearson(count, values.size)
    note = f"without {', '.join(lost)}" if lost else ""
    out.append(
        make.row(
            "objects_inside_95", count / values.size, interval=(float(low), float(high)), n=values.size, reason=note
        )
    )
    out.append(make.row("pit_uniformity_p_value", uniformity_p_value(values), n=values.size, reason=note))
    return out
