"""Scores, objects, ROC, false alarms and target areas: predicted against measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
import scipy

from hyperval.compare.rows import Array, Interval, Lack, RowMaker, Valued, comparison, difference_interval, scientific
from hyperval.compare.spectra import noncentrality
from hyperval.errors import UsageError
from hyperval.metrics import Evidence
from hyperval.model.intervals import (
    Z95,
    clopper_pearson,
    difference_ratio,
    difference_ratio_uncertainty,
    joint_region,
    zero_count_upper_limit,
)
from hyperval.model.roc import AREAS, RocArea, curve_area, detection_at
from hyperval.pixels import LEAST_EXPECTED_ALARMS, false_alarm_ratio
from hyperval.products import Abundance, ClassificationError, ExceedanceCurve, ObjectScores, RocCurve, ScoreDistribution
from hyperval.results import Cause, Effect, Result

ROUNDING = 1e-9  # of a score's standard deviation; chance leaves a mean as small in one of a million images at most


def sd_ratio_interval(predicted_sd: float, observed_sd: float, n: int) -> Interval:
    """95 % interval of predicted over observed standard deviation, the latter from n independent normal scores.

    (n - 1) s^2/sigma^2 follows chi-square, so predicted/sigma lies between (predicted/s) sqrt(chi2_a/(n - 1)) and
    the same with chi2_(1 - a).
    """
    low, high = np.sqrt(scipy.stats.chi2.ppf([0.025, 0.975], n - 1) / (n - 1))
    return predicted_sd / observed_sd * float(low), predicted_sd / observed_sd * float(high)


@comparison("scores")
def compare_scores(make: RowMaker, predicted: ScoreDistribution, observed: ScoreDistribution) -> Iterator[Result]:
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
    n, half = observed.n, math.nan
    bias = 0.0 if math.isnan(observed.mean_bias) else observed.mean_bias
    if n is not None and n >= 2 and abs(observed.mean) > ROUNDING * observed.sd:
        error = observed.sd / math.sqrt(n) if math.isnan(observed.mean_error) else observed.mean_error
        half = float(scipy.stats.t.ppf(0.975, n - 1)) * error
    yield make.row("score_mean_predicted", predicted.mean, n=predicted.n)
    yield make.row("score_mean_observed", observed.mean, half=half, n=n)
    yield make.row("score_mean_difference", predicted.mean - (observed.mean - bias), half=half, n=n)
    if observed.sd > 0 and n is not None and n >= 2:
        interval = sd_ratio_interval(predicted.sd, observed.sd, n)
        yield make.row("score_sd_ratio", predicted.sd / observed.sd, interval, n=n)
    else:
        why = "fewer than two observed scores, or no spread among them"
        yield from make.skipped(Cause.FEW_PIXELS, why, "score_sd_ratio")


LEVELS = (1e-1, 1e-2, 1e-3, 1e-4)


@comparison("scores")
def compare_exceedance(make: RowMaker, predicted: ExceedanceCurve, observed: ExceedanceCurve) -> Iterator[Result]:
    """Rows ``pfa_ratio@1e-3`` and the like: predicted over measured P_FA at the threshold that was measured for it.

    Beside it ``pfa_repeatability@1e-3``: the factor by which one half of the image misses the other half's P_FA
    at that threshold; what a model can be asked for ends there.

    The interval has that of the measured P_FA, from blocks of the image, and what the pixels leave open that the
    law was fitted to.  A level that expects fewer than 10 alarms gives a SKIPPED row, save that levels below 1e-3
    then give none.

    The subject is the background (:func:`hyperval.products.background_of`) of what is looked for.
    """
    n = observed.n or 0
    for level in LEVELS:
        name = f"pfa_ratio@{scientific(level)}"
        if level * n < LEAST_EXPECTED_ALARMS:
            if level >= 1e-3:
                why = f"{observed.n} background pixels expect {level * n:.3g} alarms"
                yield from make.skipped(Cause.FEW_ALARMS, why, name)
            continue
        ratio = false_alarm_ratio(predicted, observed, level)
        at, measured, threshold = ratio.at, observed.probability[ratio.at], observed.threshold[ratio.at]
        beyond = threshold > predicted.threshold[predicted.probability > 0][-1]
        words = f"threshold {threshold:.4g}: predicted {'at most ' if beyond else ''}{ratio.predicted:.3g}, "
        words += f"measured {measured:.3g} ({observed.lower[at]:.2g} to {observed.upper[at]:.2g})"
        words += f"; its law is known to a factor of {ratio.law_factor:.2g}" if ratio.law_factor > 1.0 else ""
        factor = math.nan if observed.half_image is None else float(observed.half_image[at])
        if observed.half_image is not None:
            words += f"; one half of the image misses the other by a factor of {factor:.2g}"
        yield make.row(name, ratio.value, (ratio.lower, ratio.upper), n=observed.n, reason=words)
        if np.isfinite(factor):
            why = f"of {round(measured * n)} alarms; half of the random halves differ less"
            yield make.row(f"pfa_repeatability@{scientific(level)}", factor, n=observed.n, reason=why)


@comparison("classification")
def compare_classification(make: RowMaker, p: ClassificationError, o: ClassificationError) -> Iterator[Result]:
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
    words = "" if o.effective_n is None else f"{o.effective_n:.0f} of {o.n} pixels count as independent"
    yield make.row("error_predicted", p.error, (p.lower, p.upper), n=p.n)
    yield make.row("error_observed", o.error, (o.lower, o.upper), n=o.n, reason=words)
    difference = p.error - o.error
    low, high = difference_interval(p.error, (p.lower, p.upper), o.error, (o.lower, o.upper))
    yield make.row("error_difference", difference, (low, high), n=o.n)
    about = Effect(difference, low, high)
    yield make.row("error_inside_interval", float(low <= 0.0 <= high), n=o.n, about=about)
    yield make.row("error_approximation", p.approximation)
    yield make.row("distance_predicted", p.distance)
    yield make.row("distance_observed", o.distance, n=o.n)
    if p.bound_lower > 0:
        middle = float(np.sqrt(p.bound_lower * p.bound_upper))
        yield make.row("error_bounds", middle, (p.bound_lower, p.bound_upper))


EVERY_OBJECT = "all objects"
JOINT, TREND, SPREAD = "joint_distance_p_value", "pit_trend", "pit_spread_ratio"
OF_ONE = ("object_score_pit", "object_score_inside_95")
OF_ALL = ("objects_inside_95", "objects_inside_95_p_value", "pit_uniformity_p_value")
# Spread of the scores about their medians, over the predicted one, that the tests are asked about.
WIDTHS = (1.25, 1.5, 2.0, 3.0)
POWER_DRAWS = 1000
POWER_LEVEL, POWER = 0.01, 0.8
# Objects whose joint distribution the draws can tell: ten draws for each.
MOST_JOINED = 200
# Sets of objects drawn from the prediction, for what the model itself expects of them together.
REPLICATES = 4000
_SEED = 17


def probability_integral_transform(score: npt.ArrayLike, draws: npt.ArrayLike) -> Array:
    """(n,) share of the predicted draws (N,) below each measured score (n,), equal ones counted half.

    Over many objects, each with its own prediction, the values are uniform on (0, 1) when the predictions are
    right, so objects of different kinds are judged together.  Source: Rosenblatt, Ann. Math. Stat. 23, 470, 1952.
    The share is (below + 1/2) / (N + 1), so that no score is impossible to a finite number of draws.
    """
    at, ordered = np.asarray(score, dtype=float), np.sort(np.asarray(draws, dtype=float), axis=None)
    below = np.searchsorted(ordered, at, "left").astype(float)
    equal = ordered[np.minimum(below.astype(int), ordered.size - 1)] == at
    below[equal] = 0.5 * (below[equal] + np.searchsorted(ordered, at[equal], "right"))
    return np.asarray((below + 0.5) / (ordered.size + 1.0))


def transforms_of_draws(draws: npt.ArrayLike) -> Array:
    """(1 + F, ...) transform values of the draws (...), and of each F = ``WIDTHS`` times as far from the median.

    The values of a set of objects drawn from the prediction are among these.
    """
    values = np.asarray(draws, dtype=float)
    order = np.argsort(values, axis=None)
    ordered = values.ravel()[order]
    middle = np.median(ordered)
    out = np.empty((1 + len(WIDTHS), ordered.size))
    for row, factor in zip(out, (1.0, *WIDTHS), strict=True):
        moved = ordered if factor == 1.0 else middle + factor * (ordered - middle)
        row[order] = probability_integral_transform(moved, ordered)
    return out.reshape(-1, *values.shape)


def distance_from_uniform(values: npt.ArrayLike) -> Array:
    """(...) Kolmogorov-Smirnov distance of values (..., n) from the uniform distribution on (0, 1)."""
    u = np.sort(np.asarray(values, dtype=float), axis=-1)
    n = u.shape[-1]
    if n == 0 or not np.all((u >= 0) & (u <= 1)):
        raise UsageError("the uniformity test needs values between 0 and 1")
    step = np.arange(n + 1) / n
    return np.asarray(np.maximum((step[1:] - u).max(axis=-1), (u - step[:-1]).max(axis=-1)))


@dataclass(frozen=True)
class Test:
    """A test by draws of the model: ``p_value``, its effect, and the departure that it rejects in 80 % of draws."""

    p_value: float
    effect: Effect
    detectable: float = math.nan


@dataclass(frozen=True)
class Together:
    """Objects judged together.

    Attributes
    ----------
    expected : 95 % range of the part inside that the model expects, with what its objects have in common
    count : test of so few (or fewer) objects in their predicted 95 % intervals; its effect is their part, with the
        exact interval if they were independent
    uniformity : test of so large a distance of the transform values from uniformity
    joint : test of the Mahalanobis distance of the normal scores, correlation counted, near 1 where the predicted
        spread is too wide; None for too many objects
    drift : test of the drift of the normal scores from the weakest expected object to the strongest; None where
        all are expected alike
    spread : of the normal scores about their mean, expected over measured; None for one object
    """

    expected: tuple[float, float]
    count: Test
    uniformity: Test
    joint: Test | None
    drift: Test | None
    spread: Effect | None


def judged_together(predicted: Mapping[str, ObjectScores], measured: Mapping[str, Array]) -> Together:
    """Transform values of all objects against what the model expects of them.

    Objects of one material share the error of its spectrum and all share the blur, so their values are not
    independent and the customary tests would reject right models.  The reference is therefore drawn from the
    prediction: one row of it (one draw of the inputs) for all objects, then each object within that row.  The same
    draws, spread about their medians, say which width the tests would have found.

    Parameters
    ----------
    predicted, measured : by subject; (n,) scores of its objects

    Examples
    --------
    >>> draws = np.random.default_rng(0).normal(size=(50, 80))
    >>> predicted = {name: ObjectScores(draws + i) for i, name in enumerate("abc")}
    >>> measured = {name: np.array([i + 0.5]) for i, name in enumerate("abc")}
    >>> t = judged_together(predicted, measured)
    >>> [round(x.p_value, 2) for x in (t.count, t.uniformity, t.joint, t.drift)]
    [1.0, 0.06, 0.86, 1.0]
    >>> scattered = {name: np.array([i - 2.0, i, i + 2.0]) for i, name in enumerate("abc")}
    >>> wide = judged_together(predicted, scattered).spread
    >>> [round(x, 2) for x in (wide.value, wide.lower, wide.upper)]
    [0.54, 0.29, 0.85]
    """
    rng = np.random.default_rng(_SEED)
    rows = {predicted[s].values.shape[0] for s in measured}
    if len(rows) > 1:
        raise UsageError("the predicted scores of the subjects do not share their draws of the inputs")
    row = rng.integers(rows.pop(), size=REPLICATES)
    values, drawn, wider, strength = [], [], [], []
    for subject, scores in measured.items():
        draws = predicted[subject].values
        values.append(probability_integral_transform(scores, draws))
        own, *spread = transforms_of_draws(draws)
        column = rng.integers(draws.shape[1], size=(REPLICATES, scores.size))
        drawn.append(own[row[:, None], column])
        wider.append(np.stack([x[row[:POWER_DRAWS, None], column[:POWER_DRAWS]] for x in spread]))
        strength += [float(np.median(draws))] * scores.size
    u, reference, wide = np.concatenate(values), np.concatenate(drawn, axis=1), np.concatenate(wider, axis=2)
    inside, n = int(np.sum(central(u))), u.size
    expected = central(reference).sum(axis=1)
    low, high = map(float, clopper_pearson(inside, n))
    share = Effect(inside / n, low, high, partial(drawn_range, expected / n, 1.0, 0.0), decides=False)
    distances, distance = distance_from_uniform(reference), float(distance_from_uniform(u))
    # No distance of two distributions differs from a third one's by more than that of the two.
    reach = float(np.quantile(distances, 0.95))
    ends = max(distance - reach, 0.0), min(distance + reach, 1.0)
    apart = Effect(distance, *ends, partial(drawn_range, distances, 0.0, 1.0), decides=False)
    z, x = scipy.special.ndtri(u), scipy.special.ndtri(reference)
    low, high = np.quantile(expected, [0.025, 0.975], method="nearest") / n
    return Together(
        (float(low), float(high)),
        _test(-inside, -expected, -central(wide).sum(axis=2), share),
        _test(distance, distances, distance_from_uniform(wide), apart),
        _joint_test(z, x, wide),
        _drift_test(z, x, np.array(strength)),
        _spread(z, x),
    )


def _test(statistic: float, reference: Array, wide: Array, effect: Effect, both: bool = False) -> Test:
    """Share of the reference (R,) at or beyond the statistic, and the least of the widths that it would reject.

    Parameters
    ----------
    wide : (F, D) the statistic of draws of each width
    both : whether the other tail counts too, so that the level is halved
    """
    p = float((1 + np.sum(reference >= statistic)) / (1 + reference.size))
    limit = np.quantile(reference, 1.0 - (POWER_LEVEL / 2.0 if both else POWER_LEVEL))
    power = np.mean(wide > limit, axis=1)
    seen = [f for f, share in zip(WIDTHS, power, strict=True) if share >= POWER]
    return Test(p, effect, min(seen, default=math.nan))


def _joint_test(z: Array, x: Array, wide: Array) -> Test | None:
    """Mahalanobis distance of the normal scores; their covariance is that of one half of the draws.

    The other half is what the distance is compared with: neither it nor the measured set had a part in the
    covariance.
    """
    if z.size > MOST_JOINED:
        return None
    half, n = x.shape[0] // 2, z.size
    inverse = np.linalg.pinv(np.atleast_2d(np.cov(x[:half], rowvar=False)))

    def distance(v: Array) -> Array:
        return np.asarray(np.sum((v @ inverse) * v, axis=-1))

    found, reference = float(distance(z)), distance(x[half:])
    size = math.sqrt(found / n)
    low, high = (math.sqrt(1.0 + noncentrality(found / n, n, math.inf, part) / n) for part in (0.975, 0.025))
    accepted = partial(drawn_range, np.sqrt(reference / n), 0.5, 0.5)
    effect = Effect(size, min(low, size), max(high, size), accepted)
    test = _test(found, reference, distance(scipy.special.ndtri(wide)), effect, both=True)
    return replace(test, effect=replace(effect, detectable=(math.nan, test.detectable)))


def _drift_test(z: Array, drawn_scores: Array, strength: Array) -> Test | None:
    """Drift of the normal scores along the rank of the expected score."""
    place = scipy.stats.rankdata(strength, method="dense")
    if place.max() < 2:
        return None
    x = (place - place.mean()) / (place.max() - 1.0)
    weight = x / float(x @ x)
    slope, drawn = float(z @ weight), drawn_scores @ weight
    low, high = (float(q) for q in np.quantile(drawn, [0.025, 0.975]))
    p = float((1 + np.sum(np.abs(drawn) >= abs(slope))) / (1 + drawn.size))
    found = float(np.quantile(np.abs(drawn), 1.0 - POWER_LEVEL) - np.quantile(drawn, 1.0 - POWER))
    accepted = partial(drawn_range, np.concatenate([drawn, -drawn]), 0.5, 0.5)
    return Test(p, Effect(slope, slope - max(high, 0.0), slope - min(low, 0.0), accepted, (-found, found)), found)


def drawn_range(sizes: Array, below: float, above: float, level: float) -> Interval:
    """Range that draws of the model stay in: ``below`` and ``above`` times the level lie beyond its ends; 0: no end."""
    low, high = np.quantile(sizes, [below * level, 1.0 - above * level])
    return (float(low) if below else math.nan), (float(high) if above else math.nan)


def _spread(z: Array, drawn_scores: Array) -> Effect | None:
    """Standard deviation of the normal scores (n,) that draws of the model (R, n) have, over the measured one."""
    if z.size < 2 or not (measured := float(np.std(z, ddof=1))):
        return None
    low, middle, high = np.quantile(np.std(drawn_scores, axis=-1, ddof=1), [0.025, 0.5, 0.975]) / measured
    return Effect(float(middle), float(low), float(high))


def central(values: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """True for transform values in the central 95 %."""
    return np.asarray((np.asarray(values) >= 0.025) & (np.asarray(values) <= 0.975))


def compare_object_scores(
    predicted: Mapping[str, ObjectScores],
    measured: Mapping[str, ObjectScores],
    *,
    method: str,
    subject: str = EVERY_OBJECT,
) -> list[Result]:
    """Every object's measured score against its predicted distribution, then all of them together.

    A subject of one object gives ``object_score_measured``, ``object_score_predicted`` (median and 95 % interval),
    ``object_score_pit`` and ``object_score_inside_95`` (1 or 0); a subject of several gives the summary below for
    itself.  All together (``subject``): ``objects_inside_95`` the share inside with its Clopper-Pearson interval,
    and
    by :func:`judged_together` ``objects_inside_95_p_value``, ``pit_uniformity_p_value``,
    ``joint_distance_p_value``, ``pit_trend``, ``pit_trend_p_value`` and ``pit_spread_ratio``.  Subjects that
    were measured and not predicted are left out; one that was predicted and has no valid score gives SKIPPED rows
    and is named in the reason of the summary.

    Examples
    --------
    >>> draws = np.random.default_rng(0).normal(size=(50, 80))
    >>> predicted, measured = {"panel": ObjectScores(draws)}, {"panel": ObjectScores(np.array([1.0]), ("p1",))}
    >>> rows = compare_object_scores(predicted, measured, method="cem")
    >>> [(r.metric, round(r.value, 2)) for r in rows if r.metric.startswith("object_")]
    [('object_score_measured', 1.0), ('object_score_predicted', -0.03), ('object_score_pit', 0.84),
    ('object_score_inside_95', 1.0)]
    """
    out: list[Result] = []
    common: dict[str, Array] = {}
    lost: list[str] = []
    for name, model in predicted.items():
        make = RowMaker("scores", name, method)
        scores = measured[name].values if name in measured else np.empty(0)
        scores = scores[np.isfinite(scores)]
        if scores.size == 0:
            out += make.skipped(Cause.NO_OBSERVATION, "no measured score", *OF_ONE)
            lost.append(name)
            continue
        common[name] = scores
        if scores.size > 1:
            out += _together_rows(make, {name: model}, {name: scores}, "")
            continue
        low, middle, high = (float(x) for x in np.quantile(model.values, [0.025, 0.5, 0.975]))
        (u,) = probability_integral_transform(scores, model.values)
        why = f"measured {scores[0]:.4g}, predicted {low:.4g} to {high:.4g}"
        inside, about = float(central(u)), Effect(float(scipy.special.ndtri(u)))
        out.append(make.row("object_score_measured", scores[0], n=1))
        out.append(make.row("object_score_predicted", middle, (low, high)))
        out.append(make.row("object_score_pit", u, n=1))
        out.append(make.row("object_score_inside_95", inside, n=1, reason=why, about=about))
    make = RowMaker("scores", subject, method)
    if not common:
        return out + make.skipped(Cause.NO_OBSERVATION, "no object has both sides", *OF_ALL)
    return [*out, *_together_rows(make, predicted, common, f"; without {', '.join(lost)}" if lost else "")]


def _together_rows(
    make: RowMaker, predicted: Mapping[str, ObjectScores], scores: Mapping[str, Array], lost: str
) -> Iterator[Result]:
    sets, n = judged_together(predicted, scores), sum(x.size for x in scores.values())
    low, high = sets.expected
    expects = f"the model expects {low:.3g} to {high:.3g}; the interval takes objects for independent{lost}"
    draws = "against draws of the model"
    for metric, found, reason in (
        (OF_ALL[0], sets.count.effect, expects),
        (OF_ALL[1], sets.count, "that so few lie inside, by the model"),
        (OF_ALL[2], sets.uniformity, "Kolmogorov-Smirnov distance, against sets of objects drawn from the model"),
        (JOINT, sets.joint, f"Mahalanobis distance of the normal scores, {draws}"),
        (TREND, sets.drift and sets.drift.effect, draws),
        (f"{TREND}_p_value", sets.drift, f"drift of the normal scores, {draws}"),
        (SPREAD, sets.spread, f"normal scores about their mean, {draws}"),
    ):
        if isinstance(found, Effect):
            yield make.row(metric, found.value, (found.lower, found.upper), n=n, reason=reason)
        elif found is not None:
            why = f"{reason}{lost}"
            yield make.row(metric, found.p_value, n=n, detectable=found.detectable, reason=why, about=found.effect)
        elif metric == JOINT:
            why = f"{n} objects; the draws of the model tell the joint distribution of {MOST_JOINED}"
            yield from make.skipped(Cause.FEW_PIXELS, why, JOINT)


@comparison("abundance")
def compare_abundance(make: RowMaker, predicted: Abundance, observed: Abundance) -> Iterator[Result]:
    """Rows ``area_predicted``, ``area_observed`` [m2], ``area_ratio`` (observed over predicted),
    ``area_difference_ratio``, ``area_z``, ``area_inside_95``.

    The ratio is (predicted - observed)/observed with the first-order interval of both uncertainties; z is the
    difference over sqrt(u_p^2 + u_o^2).  Where neither side has an uncertainty, z and the verdict are SKIPPED.
    Where both sides estimate a nominal area: ``area_error_predicted`` and ``area_error_observed`` [m2], estimate
    less nominal area, ``area_nominal_ratio`` measured over nominal, and ``area_in_predicted_95``, 1 where the
    measured area lies in the predicted interval.

    Examples
    --------
    >>> predicted, observed = Abundance(4.1, 0.2), Abundance(3.8, 0.3, 20, 4.0)
    >>> rows = compare_abundance(predicted, observed, subject="panel", method="fcls")
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('area_predicted', 4.1), ('area_observed', 3.8), ('area_ratio', 0.927), ('area_difference_ratio', 0.079),
    ('area_error_predicted', 0.1), ('area_error_observed', -0.2), ('area_nominal_ratio', 0.95),
    ('area_in_predicted_95', 1.0), ('area_z', 0.832), ('area_inside_95', 1.0)]
    """
    p, o, n = predicted.area_m2, observed.area_m2, observed.n
    up, uo = predicted.standard_uncertainty, observed.standard_uncertainty
    # Beside the truth's area the pipeline alone moves the row.
    evidence = None if predicted.modelled else Evidence.PIPELINE
    yield make.row("area_predicted", p, half=Z95 * up, n=predicted.n, evidence=evidence)
    yield make.row("area_observed", o, half=Z95 * uo, n=n)
    if p > 0:
        half = Z95 * np.hypot(uo / p, o * up / p**2)
        yield make.row("area_ratio", o / p, half=half, n=n, evidence=evidence)
    else:
        yield from make.skipped(Cause.NOT_POSITIVE, "the predicted area is not positive", "area_ratio")
    if o > 0:
        half = Z95 * float(difference_ratio_uncertainty(p, o, up, uo))
        yield make.row("area_difference_ratio", float(difference_ratio(p, o)), half=half, n=n, evidence=evidence)
    else:
        yield from make.skipped(Cause.NOT_POSITIVE, "the observed area is not positive", "area_difference_ratio")
    if (nominal := observed.nominal_m2) is not None:
        yield make.row("area_error_predicted", p - nominal, half=Z95 * up, n=predicted.n)
        yield make.row("area_error_observed", o - nominal, half=Z95 * uo, n=n)
        yield make.row("area_nominal_ratio", o / nominal, half=Z95 * uo / nominal, n=n)
        yield make.row("area_in_predicted_95", float(abs(p - o) <= Z95 * up), n=n)
    if (u := float(np.hypot(up, uo))) > 0:
        yield make.row("area_z", (p - o) / u, evidence=evidence)
        yield make.row("area_inside_95", float(abs((p - o) / u) <= Z95), evidence=evidence)
    else:
        why = "neither side states an uncertainty"
        yield from make.skipped(Cause.NO_UNCERTAINTY, why, "area_z", "area_inside_95")


def compare_area_errors(
    predicted: Mapping[tuple[str, str], Abundance], observed: Mapping[tuple[str, str], Abundance]
) -> list[Result]:
    """Rows by nominal area and method: ``area_bias_*`` and ``area_rmse_*`` [m2] of both sides over its targets.

    The bias has Student's interval, the root mean square error that of chi-square with as many degrees of freedom
    as targets, as if errors were normal of mean 0.  The predicted mean square is that of predicted biases and
    spreads.

    Examples
    --------
    >>> predicted = {("a", "fcls"): Abundance(1.1, 0.1), ("b", "fcls"): Abundance(1.1, 0.1)}
    >>> observed = {("a", "fcls"): Abundance(1.2, 0.1, 4, 1.0), ("b", "fcls"): Abundance(1.0, 0.1, 4, 1.0)}
    >>> rows = compare_area_errors(predicted, observed)
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('area_bias_observed', 0.1), ('area_bias_predicted', 0.1), ('area_rmse_observed', 0.141),
    ('area_rmse_predicted', 0.141)]
    """
    groups: dict[tuple[str, float], list[tuple[str, str]]] = {}
    for key, area in observed.items():
        if area.nominal_m2 is not None and key in predicted:
            groups.setdefault((key[1], round(area.nominal_m2, 6)), []).append(key)
    rows: list[Result] = []
    for (method, nominal), keys in groups.items():
        if len(keys) < 2:
            continue
        make = RowMaker("abundance", f"all targets of {nominal:g} m2", method)
        error = np.array([observed[k].area_m2 - nominal for k in keys])
        model = np.array([predicted[k].area_m2 - nominal for k in keys])
        spread = np.array([predicted[k].standard_uncertainty for k in keys])
        n = len(keys)
        half = float(scipy.stats.t.ppf(0.975, n - 1) * np.std(error, ddof=1) / math.sqrt(n))
        bias, expected = float(error.mean()), float(model.mean())
        limits = Z95 * float(np.sqrt(np.sum(spread**2))) / n
        rmse = float(np.sqrt(np.mean(error**2)))
        low, high = np.sqrt(n / scipy.stats.chi2.ppf([0.975, 0.025], n))
        rows.append(make.row("area_bias_observed", bias, half=half, n=n))
        rows.append(make.row("area_bias_predicted", expected, half=limits, n=n))
        rows.append(make.row("area_rmse_observed", rmse, (rmse * low, rmse * high), n=n))
        rows.append(make.row("area_rmse_predicted", float(np.sqrt(np.mean(model**2 + spread**2))), n=n))
    return rows


AREA_UNKNOWN = "the ground area of the background is not known"


def samples_per_km2(curve: RocCurve) -> float:
    """Background samples on a square kilometre; NaN when the area is not known."""
    if not curve.background_area_km2 or not curve.n_background:
        return math.nan
    return curve.n_background / curve.background_area_km2


def counted(curve: RocCurve, pfa: float) -> tuple[int, int, float] | None:
    """Alarms, background samples and P_D at a point of a curve; None where it has no such point or no counts."""
    at = np.flatnonzero(np.abs(curve.pfa - pfa) <= 1e-9 * pfa)
    if curve.alarms is None or not curve.n_background or not at.size:
        return None
    return int(curve.alarms[at[-1]]), curve.n_background, float(curve.pd[at[-1]])


def far_row(make: RowMaker, observed: RocCurve, pfa: float) -> list[Result]:
    """``far_measured@1e-2``: alarms per km2 at the threshold that the background sets for a P_FA.

    The interval is that of Clopper & Pearson on the alarms, times the samples per km2; for rare alarms it is the
    exact Poisson interval.  The share of the background above its own (k + 1)-th greatest score follows a beta
    distribution whose quantiles lie inside it, so it holds although the threshold was set by the same background.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> alarms = np.array([10, 100, 1000])
    >>> curve = RocCurve(pfa, pfa**0.2, pfa**0.3, pfa**0.1, -pfa, "pixel", 40, 10_000, 0.04, alarms)
    >>> [(r.metric, r.value) for r in far_row(RowMaker("roc", "panel", "cem/pixel"), curve, 1e-2)]
    [('far_measured@1e-2', 2500.0)]
    """
    name, density = f"far_measured@{scientific(pfa)}", samples_per_km2(observed)
    if (found := counted(observed, pfa)) is None:
        return []
    if math.isnan(density):
        return make.skipped(Cause.NO_GROUND_AREA, AREA_UNKNOWN, name)
    (alarms, n, _), area = found, observed.background_area_km2 or math.nan
    low, high = (float(x) * density for x in clopper_pearson(alarms, n))
    return [make.row(name, alarms / area, (low, high), n=n, reason=f"{alarms} alarms on {area:.4g} km2")]


def far_at_detection_rows(make: RowMaker, predicted: RocCurve | None, observed: RocCurve) -> list[Result]:
    """``far_predicted``, ``far_measured`` and ``far_difference`` ``@pd0.5`` and the like.

    Alarms per km2 at the highest threshold that reaches the stated P_D.  The measured interval holds the sampling
    of targets and background (:func:`~hyperval.pixels.roc.alarms_at_detection`), the predicted one is where
    the band of the curve reaches that P_D.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from hyperval.products import AlarmsAtDetection
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> pd = np.array([0.3, 0.6, 0.9])
    >>> predicted = RocCurve(pfa, pd, pd - 0.1, pd + 0.1, -pfa)
    >>> point = AlarmsAtDetection(0.5, 0.7, 40, 4e-3, 1e-3, 1e-2, 3e-3, 5e-3)
    >>> counts = {"n_target": 40, "n_background": 10_000, "background_area_km2": 0.04}
    >>> observed = replace(predicted, **counts, at_detection=(point,))
    >>> rows = far_at_detection_rows(RowMaker("roc", "panel", "cem/pixel"), predicted, observed)
    >>> [(r.metric, round(r.value)) for r in rows]
    [('far_predicted@pd0.5', 1160), ('far_measured@pd0.5', 1000), ('far_difference@pd0.5', 160)]
    """
    density = samples_per_km2(observed)
    rows: list[Result] = []
    for point in observed.at_detection:
        names = [f"far_{side}@pd{point.pd:g}" for side in _SIDES]
        if math.isnan(density):
            rows += make.skipped(Cause.NO_GROUND_AREA, AREA_UNKNOWN, names[1])
            continue
        left: Valued | Lack | None = None
        if predicted is not None:
            why = f"the predicted curve does not pass P_D {point.pd:g} within its range of P_FA"
            left = Lack(Cause.BEYOND_CURVE, why)
            if not math.isnan(p := _pfa_at(predicted, predicted.pd, point.pd)):
                low, high = (_pfa_at(predicted, limit, point.pd) for limit in (predicted.pd_upper, predicted.pd_lower))
                # Where a limit of the band lies wholly above or below that P_D, its end of the range bounds P_FA.
                ends = 0.0 if math.isnan(low) else min(low, p), 1.0 if math.isnan(high) else max(high, p)
                ends = (p, p) if np.isnan(predicted.pd_lower).any() else ends
                left = Valued(p * density, (ends[0] * density, ends[1] * density))
        reason = f"{point.alarms} alarms on {observed.background_area_km2:.4g} km2; at this threshold as it stands "
        reason += f"{point.fixed_lower * density:.4g} to {point.fixed_upper * density:.4g}"
        if point.alarms == 0 and observed.n_background:
            reason += f" (at most {zero_count_upper_limit(observed.n_background) * density:.4g}, one-sided)"
        right = Valued(point.pfa * density, (point.pfa_lower * density, point.pfa_upper * density))
        rows += make.side_by_side(names, left, right, observed.n_target, reason)
    return rows


_SIDES = ("predicted", "measured", "difference")


def first_detection_rows(make: RowMaker, observed: RocCurve) -> list[Result]:
    """``alarms_before_first`` (:func:`~hyperval.pixels.roc.alarms_before_first`), where it was counted.

    Examples
    --------
    >>> pfa = np.array([1e-2, 1e-1])
    >>> curve = RocCurve(pfa, pfa, pfa, pfa, -pfa, "object", 7, 10_000, alarms_before_first=3)
    >>> [(r.metric, r.value) for r in first_detection_rows(RowMaker("roc", "panel", "cem/object"), curve)]
    [('alarms_before_first', 3.0)]
    """
    if observed.alarms_before_first is None:
        return []
    reason = f"of {observed.n_background} background pixels, up to the best pixel of {observed.n_target} objects; "
    reason += "favours targets of many pixels or pieces"
    count = observed.alarms_before_first
    return [make.row("alarms_before_first", float(count), n=observed.n_target, reason=reason)]


def joint_rows(make: RowMaker, predicted: RocCurve | None, observed: RocCurve, pfa: float) -> list[Result]:
    """``joint_pfa``, ``joint_pd`` and ``pd_inside_joint_region`` ``@1e-2``.

    The rectangle of the first two intervals holds the true (P_FA, P_D) of the measured threshold with 95 %
    probability: two independent statements at level sqrt(0.95) each.  That the background set the threshold does no
    harm, since its own share above it has a beta distribution that the exact interval holds, and the targets had no
    part in it.  The last row is 1 where the predicted curve (without its band) passes through the rectangle.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> pd, alarms = np.array([0.3, 0.6, 0.9]), np.array([10, 100, 1000])
    >>> curve = RocCurve(pfa, pd, pfa, pfa, -pfa, "pixel", 40, 10_000, None, alarms)
    >>> rows = joint_rows(RowMaker("roc", "panel", "cem/pixel"), curve, curve, 1e-2)
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('joint_pfa@1e-2', 0.01), ('joint_pd@1e-2', 0.6), ('pd_inside_joint_region@1e-2', 1.0)]
    """
    found, m, label = counted(observed, pfa), observed.n_target, scientific(pfa)
    if found is None or not m:
        return []
    alarms, n, pd = found
    detected = round(pd * m)
    region = joint_region(detected, m, alarms, n)
    reason = f"{detected} of {m} {observed.unit}s and {alarms} of {n} background samples; both at 95 % together"
    span = region.pfa_lower, region.pfa_upper
    rows = [
        make.row(f"joint_pfa@{label}", region.pfa, span, n=n, reason=reason),
        make.row(f"joint_pd@{label}", region.pd, (region.pd_lower, region.pd_upper), n=m, reason=reason),
    ]
    if predicted is None:
        return rows
    first, last = float(predicted.pfa[0]), float(predicted.pfa[-1])
    ends = [0.0 if x < first else 1.0 if x > last else float(detection_at(predicted, x)) for x in span]
    name = f"pd_inside_joint_region@{label}"
    if region.pd_upper - region.pd_lower > WIDEST_INTERVAL:
        why = f"the region of {m} {observed.unit}{'' if m == 1 else 's'} accepts nearly any prediction"
        return rows + make.skipped(Cause.VACUOUS, why, name)
    # A curve that rises passes the rectangle unless it is below it at its right end or above it at its left.
    inside = ends[1] >= region.pd_lower and ends[0] <= region.pd_upper
    return [*rows, make.row(name, float(inside), n=m)]


def _pfa_at(curve: RocCurve, values: np.ndarray, pd: float) -> float:
    """P_FA at which a rising curve reaches ``pd``, NaN where it does not on its range."""
    known = np.isfinite(values)
    pfa, value = np.append(curve.pfa[known], 1.0), np.append(values[known], 1.0)
    value = np.maximum.accumulate(value)
    reached = np.flatnonzero(value >= pd)
    if known.sum() == 0 or reached[0] == 0:
        return math.nan
    i = int(reached[0])
    step = value[i] - value[i - 1]
    part = (pd - value[i - 1]) / step
    return float(np.exp(np.log(pfa[i - 1]) + part * (np.log(pfa[i]) - np.log(pfa[i - 1]))))


def predicted_area(curve: RocCurve, area: RocArea) -> Valued:
    """Area of a predicted curve and of the limits of its band; without a band the interval is a point."""
    value = curve_area(curve, area)
    low, high = (curve_area(curve, area, limit) for limit in (curve.pd_lower, curve.pd_upper))
    known = not (math.isnan(low) or math.isnan(high))
    return Valued(value, (min(low, value), max(high, value)) if known else (value, value))


def _measured_area(observed: RocCurve, full: str, area: RocArea) -> tuple[Valued | Lack, int | None, str]:
    """Area of a measured curve, how many targets it is of, and how its interval was made."""
    n, found = observed.n_background, observed.areas.get(full)
    if found is not None:
        return Valued(found.value, (found.lower, found.upper)), observed.n_target, found.method
    if observed.areas and area.logarithmic and n is not None:
        words = f"{n} background samples expect {area.low * n:.3g} alarms at the low end of {full.partition('@')[2]}"
        return Lack(Cause.FEW_ALARMS, f"{words}; {LEAST_EXPECTED_ALARMS:g} are needed"), observed.n_target, ""
    if math.isnan(value := curve_area(observed, area)):
        return Lack(Cause.BEYOND_CURVE, "the measured curve does not reach its range of P_FA"), observed.n_target, ""
    return Valued(value, (math.nan, math.nan)), observed.n_target, "of the curve without its scores: no interval"


def area_rows(make: RowMaker, predicted: RocCurve | None, observed: RocCurve | None) -> list[Result]:
    """``auc_predicted``, ``auc_measured``, ``auc_difference`` and the same of the partial and log-weighted areas.

    The names of partial areas end in their range of P_FA.  The predicted interval is that of the curve's band, as
    if its errors went together over the whole curve; the measured one is explained in its reason.  The difference
    (predicted - measured) has the interval of :func:`~hyperval.compare.spectra.difference_interval`.

    Examples
    --------
    >>> import numpy as np
    >>> from hyperval.pixels.roc import empirical_roc, with_summary
    >>> rng = np.random.default_rng(0)
    >>> target, background = rng.normal(2.0, 1.0, 40), rng.normal(size=20_000)
    >>> measured = with_summary(empirical_roc(target, background), target, background)
    >>> rows = area_rows(RowMaker("roc", "panel", "cem/pixel"), measured, measured)
    >>> [(r.metric, round(r.value, 2)) for r in rows]
    [('auc_predicted', 0.94), ('auc_measured', 0.94), ('auc_difference', 0.0), ('partial_auc_predicted@0..1e-1',
    0.59), ('partial_auc_measured@0..1e-1', 0.59), ('partial_auc_difference@0..1e-1', -0.0),
    ('log_auc_predicted@1e-3..1e-1', 0.36), ('log_auc_measured@1e-3..1e-1', 0.36),
    ('log_auc_difference@1e-3..1e-1', 0.0)]
    """
    rows: list[Result] = []
    for full, area in AREAS.items():
        name, _, span = full.partition("@")
        names = [f"{name}_{side}" + (f"@{span}" if span else "") for side in _SIDES]
        left: Valued | Lack | None = None if predicted is None else predicted_area(predicted, area)
        if isinstance(left, Valued) and math.isnan(left.value):
            left = Lack(Cause.BEYOND_CURVE, f"the predicted curve does not reach the range P_FA {span or '0..1'}")
        right, n, reason = (None, None, "") if observed is None else _measured_area(observed, full, area)
        rows += make.side_by_side(names, left, right, n, reason)
    return rows


ALWAYS = (1e-1, 1e-2, 1e-3)
IF_BACKGROUND_ALLOWS = (1e-4, 1e-5, 1e-6)
# A measured interval wider than this accepts nearly any prediction: one target alone gives 0.975 or more.
WIDEST_INTERVAL = 0.9
METRICS = (
    "pd_predicted", "pd_measured", "pd_difference", "pd_inside_interval", "pd_inside_measured_interval",
)  # fmt: skip
VERDICTS = ("pd_equivalent", "pd_equivalence")
# The two readings of (3.30-3.33) are told apart where their P_D differ by more than this.
SAME_READING = 1e-3


def read_at(curve: RocCurve, pfa: float) -> Valued:
    """P_D at ``pfa`` with its 95 % limits; NaN outside the curve."""
    value, low, high = (float(detection_at(curve, pfa, y)) for y in (None, curve.pd_lower, curve.pd_upper))
    return Valued(value, (low, high))


def equivalent(interval: Interval, margin: float) -> bool:
    """Two one-sided tests: the whole 95 % interval of the difference lies inside +-``margin``.

    That rejects "the difference is at least the margin" on both sides at the 2.5 % level.  No difference
    found is not equivalence: a wide interval fails.  Source: Schuirmann, J. Pharmacokinet. Biopharm. 15, 657, 1987.
    """
    if not 0.0 < margin < 1.0:
        raise UsageError(f"equivalence margin {margin:g}", expected="a difference of probability between 0 and 1")
    return -margin < interval[0] and interval[1] < margin


def equivalence(interval: Interval, margin: float) -> tuple[float, str]:
    """The three outcomes of a comparison with a margin: 1 equivalent, -1 different, 0 undecided, and the word.

    Different is a 95 % interval of the difference that lies wholly beyond 0: with many targets a difference may be
    certain and yet within the margin, which is then equivalent for the purpose, and the word says both.
    """
    apart = interval[0] > 0.0 or interval[1] < 0.0
    if equivalent(interval, margin):
        return 1.0, "equivalent, though not the same" if apart else "equivalent"
    return (-1.0, "different") if apart else (0.0, "undecided")


@comparison("roc")
def compare_roc(
    make: RowMaker,
    predicted: RocCurve,
    observed: RocCurve,
    pfa: Sequence[float] | None = None,
    equivalence_margin: float | None = None,
) -> Iterator[Result]:
    """Rows at each false-alarm probability, named METRIC@1e-2 and the like.

    ``pd_predicted`` and ``pd_measured`` with their intervals, ``pd_difference`` (predicted - measured) with its
    interval, and 1 or 0 for

    - ``pd_inside_interval``: 0 lies in the 95 % interval of the difference, i.e. the predicted P_D lies in the
      measured interval widened by the predicted half-width *in quadrature*.  That the two intervals
      overlap (widths added) is not enough.  Where the predicted curve has no width it is the next rule;
    - ``pd_inside_measured_interval``: the predicted P_D lies in the measured interval as it stands;
    - ``pd_equivalent`` (with ``equivalence_margin``): two one-sided tests, :func:`equivalent`; and
      ``pd_equivalence``: 1 equivalent, -1 different, 0 undecided, :func:`equivalence`.

    ``pd_predicted_preset`` and ``pd_inside_interval_preset`` read the predicted curve at the preset P_FA of (3.30),
    that of the worst class alone, where that differs from the P_FA of the whole background (3.33).

    Default probabilities: 1e-1, 1e-2, 1e-3 always, and 1e-4 to 1e-6 where the background is large enough to
    expect 10 alarms.  A probability that the background or a curve does not reach gives SKIPPED rows.
    The verdicts (but not the values) are SKIPPED too where the measured interval is wider than 0.9, as with a
    single target object: a test that nothing can fail is no test.
    With what a measured curve knows beyond its points come the areas, false alarms per km2 and joint regions.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1, 1.0])
    >>> predicted = RocCurve(pfa, pfa**0.2, pfa**0.25, pfa**0.15, -pfa, preset_pfa=pfa / 2.0)
    >>> observed = RocCurve(pfa, pfa**0.3, pfa**0.4, pfa**0.25, -pfa, "pixel", 40, 10_000)
    >>> rows = compare_roc(predicted, observed, subject="panel", method="cem/pixel", pfa=[1e-2])
    >>> [(r.metric, round(r.value, 3)) for r in rows if r.metric.startswith("pd")]
    [('pd_predicted@1e-2', 0.398), ('pd_measured@1e-2', 0.251), ('pd_difference@1e-2', 0.147),
    ('pd_inside_interval@1e-2', 0.0), ('pd_inside_measured_interval@1e-2', 0.0), ('pd_predicted_preset@1e-2',
    0.46), ('pd_inside_interval_preset@1e-2', 0.0)]
    """
    if predicted.unit != observed.unit:
        what = f"{make.subject}: the predicted curve counts by {predicted.unit}, the measured by {observed.unit}"
        raise UsageError(what)
    background = observed.n_background
    rare = [x for x in IF_BACKGROUND_ALLOWS if background and x * background >= LEAST_EXPECTED_ALARMS]
    for level in pfa or (*ALWAYS, *rare):
        yield from _at(make, predicted, observed, level, equivalence_margin)
        if not background or level * background >= LEAST_EXPECTED_ALARMS:
            yield from far_row(make, observed, level)
            yield from joint_rows(make, predicted, observed, level)
    yield from far_at_detection_rows(make, predicted, observed)
    yield from first_detection_rows(make, observed)
    yield from area_rows(make, predicted, observed)


def _at(make: RowMaker, predicted: RocCurve, observed: RocCurve, pfa: float, margin: float | None) -> Iterator[Result]:
    label = scientific(pfa)
    names = [f"{m}@{label}" for m in (*METRICS, *(VERDICTS if margin is not None else ()))]
    n, background = observed.n_target, observed.n_background
    if background is not None and pfa * background < LEAST_EXPECTED_ALARMS:
        reason = f"{background} background samples expect {pfa * background:.3g} alarms at P_FA {label}; "
        reason += f"{LEAST_EXPECTED_ALARMS:g} are needed to place the threshold"
        yield from make.skipped(Cause.FEW_ALARMS, reason, *names)
        return
    p, o = read_at(predicted, pfa), read_at(observed, pfa)
    if math.isnan(p.value) or math.isnan(o.value):
        side = "predicted" if math.isnan(p.value) else "measured"
        yield from make.skipped(Cause.BEYOND_CURVE, f"the {side} curve has no point at P_FA {label}", *names)
        return
    if any(map(math.isnan, p.interval)):  # a curve without a band is a curve without width
        p = Valued(p.value, (p.value, p.value))
    yield from make.side_by_side(names, p, o, n)
    low, high = o.interval
    if high - low > WIDEST_INTERVAL:
        why = f"the measured interval {low:.2g} to {high:.2g}"
        why += f" from {n} {observed.unit}{'' if n == 1 else 's'}" if n is not None else ""
        yield from make.skipped(Cause.VACUOUS, f"{why} accepts nearly any prediction", *names[3:])
        return
    inside, about = _inside(p, o)
    # An unknown measured interval must not read as "outside": the verdict itself is unknown.
    known = math.nan if math.isnan(inside) else 1.0
    yield make.row(names[3], inside, n=n, about=about)
    yield make.row(names[4], known * (low <= p.value <= high), n=n)
    if margin is not None:
        ends, words = (about.lower, about.upper), f"margin {margin:g}"
        about = replace(about, accepted=partial(_within, margin))
        code, word = equivalence(ends, margin)
        yield make.row(names[5], known * equivalent(ends, margin), n=n, reason=words, about=about)
        yield make.row(names[6], known * code, n=n, reason=f"{word} by a {words}", about=about)
    yield from _preset_rows(make, predicted, pfa, p.value, o, n)


def _inside(p: Valued, o: Valued) -> tuple[float, Effect]:
    """1 or 0, whether the interval of the difference holds 0, NaN without a measured interval; and the difference."""
    low, high = difference_interval(*p, *o)
    known = math.nan if any(map(math.isnan, o.interval)) else 1.0
    return known * (low <= 0.0 <= high), Effect(p.value - o.value, low, high)


def _within(margin: float, level: float) -> Interval:
    """The range of a difference of P_D, whatever the level."""
    return -margin, margin


def _preset_rows(
    make: RowMaker, predicted: RocCurve, pfa: float, swept: float, measured: Valued, n: int | None
) -> Iterator[Result]:
    """P_D of (3.32) at the preset of (3.30) without (3.33), where that is another P_D.

    A class that gives ``pfa`` alone, at its part of the scene, gives less in all: the preset lies at a higher
    threshold and the P_D is lower.
    """
    if predicted.preset_pfa is None:
        return
    order = np.argsort(predicted.preset_pfa, kind="stable")
    axis = np.maximum(predicted.preset_pfa[order], 1e-300)
    if not axis[0] <= pfa <= axis[-1]:
        return
    pd, low, high = (y[order] for y in (predicted.pd, predicted.pd_lower, predicted.pd_upper))
    preset = read_at(replace(predicted, pfa=axis, pd=pd, pd_lower=low, pd_upper=high), pfa)
    if abs(preset.value - swept) >= SAME_READING:
        words = f"(3.32) at the preset, without (3.33): {swept:.3g} with it, measured {measured.value:.3g}"
        yield make.row(f"pd_predicted_preset@{scientific(pfa)}", *preset, reason=words)
        inside, about = _inside(preset, measured)
        yield make.row(f"pd_inside_interval_preset@{scientific(pfa)}", inside, n=n, reason=words, about=about)
