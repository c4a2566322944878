"""What the metrics of the table are, in a few words each, for readers of a page."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase

from hyperval.results import Result

# Pattern of a metric without what follows "@" -> words; the first that fits counts.
_WORDS = {
    "objects_inside_95_p_value": (
        "probability, were the model right, that as few objects lie inside their 95 % intervals"
    ),
    "objects_inside_95": "share of the objects whose score lies inside its predicted 95 % interval",
    "object_score_inside_95": "1 when the score of an object lies inside its predicted 95 % interval, else 0",
    "object_score_pit": (
        "probability that the model gives a lower score than was measured; uniform when the model is right"
    ),
    "pit_uniformity_p_value": (
        "probability, were the model right, of scores that lie as unevenly in their predicted distributions"
    ),
    "pfa_ratio": (
        "predicted over measured false-alarm probability at one threshold; the number after @ is the "
        "measured one aimed at"
    ),
    "pd_inside_interval*": (
        "1 when the detection probabilities agree (their difference has 0 in its 95 % interval), else 0 "
        "(_fraction: share of curves); after @ the false-alarm probability"
    ),
    "pd_*": "detection probability, or its difference or interval; after @ the false-alarm probability",
    "*auc_*": ("area under the ROC curve: mean detection probability over a range of false-alarm probabilities"),
    "far_*": "false alarms per km²",
    "area_nominal_ratio": "estimated over true area of a target",
    "area_ratio": "measured over predicted area of a target",
    "area_in_predicted_95*": (
        "1 when the measured area lies inside the predicted 95 % interval, else 0 (_fraction: share of targets)"
    ),
    "error_inside_interval": (
        "1 when the classification errors agree (their difference has 0 in its 95 % interval), else 0"
    ),
    "error_*": (
        "probability that a Gaussian classifier names the wrong class, or its difference (predicted − measured)"
    ),
    "bhattacharyya_covariance_excess": (
        "how far the two covariances are apart (Bhattacharyya distance) beyond what sampling makes; 0 is the same"
    ),
    "eigenvalue_ratio": (
        "predicted over measured variance along one principal direction; the number after @ counts "
        "directions, largest first"
    ),
    "total_variance_ratio": "predicted over measured variance, all bands together",
    "tail_inverse_dof_difference": (
        "1/ν of the t law, predicted − measured; 0 for equal tails, larger 1/ν for heavier ones"
    ),
    "median_abs_difference_ratio_*": (
        "median over bands of |predicted − collected| / collected; the ending names the bands"
    ),
    "max_abs_difference_ratio_*": (
        "largest over bands of |predicted − collected| / collected; the ending names the bands"
    ),
    "median_difference_ratio_*": (
        "median over bands of (predicted − collected) / collected; the ending names the bands"
    ),
    "p_value_full": (
        "probability, were both sides right, of a difference as large, all stated errors and their "
        "correlation counted"
    ),
    "chi2_reduced_full": (
        "squared difference in units of its uncertainty, per degree of freedom, correlation counted; "
        "about 1 when uncertainties explain it"
    ),
    "reduced_chi_square": (
        "the same over all products that the attribution joins (attribution, what-if), with the model's "
        "numerical error added: not the number of a single spectrum"
    ),
    "likelihood_gain": "twice the log-likelihood gained by letting one input be less well known",
    "score_*": "mean or spread of the detector score over a population of pixels",
    "bias_ratio": "mean over the windows of (predicted − collected) / collected",
    "median_*_difference_ratio": "median difference ratio after a what-if",
    "mean_pd_at_*": "mean difference of detection probability after a what-if",
}


def meaning(metric: str) -> str:
    """What ``metric`` is; empty for one that is not known."""
    base = metric.partition("@")[0]
    return next((words for pattern, words in _WORDS.items() if fnmatchcase(base, pattern)), "")


def explained(rows: Iterable[Result]) -> list[tuple[str, str]]:
    """(metric, what it is) of the rows' metrics that are known, each once, by name."""
    bases = sorted({row.metric.partition("@")[0] for row in rows})
    return [(base, meaning(base)) for base in bases if meaning(base)]
