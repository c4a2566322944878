"""Scores, objects, ROC, false alarms and target areas: predicted against measured."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
import scipy

from hyperval.compare.rows import Interval, named, row, said, short_label, skip_as, with_difference
from hyperval.compare.spectra import noncentrality
from hyperval.data import Array, Index, Mask
from hyperval.metrics import Evidence
from hyperval.model import Z95, clopper_pearson
from hyperval.model.roc import AREAS, RocArea, curve_area, detection_at, log10_false_alarm_at
from hyperval.pixels import LEAST_EXPECTED_ALARMS, false_alarm_ratio, nearest_point
from hyperval.products import Abundance, ClassificationError, ExceedanceCurve, ObjectScores, RocCurve, ScoreDistribution
from hyperval.results import Effect, Result

ROUNDING = 1e-9  # of a score's standard deviation; chance leaves a mean as small in one of a million images at most


def compare_scores(predicted: ScoreDistribution, observed: ScoreDistribution) -> Iterator[Result]:
    """Rows ``score_mean_predicted``, ``score_mean_observed``, ``score_mean_difference``, ``score_sd_ratio``.

    The difference (predicted - observed) has the interval of the observed mean, its stated error or s/sqrt(n) with
    Student's t, and in quadrature that of the predicted one; the bias of the observed mean is taken off.
    The ratio is predicted over observed, p/s: k s^2/sigma^2 follows chi-square with k = 1/(2 u^2), u the stated error
    of s as a part of it, or n - 1, so that p/sigma lies between p/s sqrt(chi2_a/k) and the same with chi2_(1 - a); the
    predicted error widens that in the logarithm.  Without stated errors give n as the number of independent pixels.
    A mean that is 0 to rounding is that of a matched filter on the pixels it was made of: it is 0 whatever they are,
    says nothing, and has no interval.

    Examples
    --------
    >>> rows = compare_scores(ScoreDistribution(1.0, 0.2), ScoreDistribution(0.9, 0.25, 50))
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('score_mean_predicted', 1.0), ('score_mean_observed', 0.9), ('score_mean_difference', 0.1),
    ('score_sd_ratio', 0.8)]
    """
    n, bias, (error, part) = observed.n, float(np.nan_to_num(observed.mean_bias)), observed.errors(predicted)
    half = float(scipy.stats.t.ppf(0.975, (n or 1) - 1)) * error
    half = half if abs(observed.mean) > ROUNDING * observed.sd else math.nan
    wide = Z95 * np.nan_to_num([predicted.mean_error, predicted.sd_error])
    yield row("score_mean_predicted", predicted.mean, half=Z95 * (predicted.mean_error or math.nan), n=predicted.n)
    yield row("score_mean_observed", observed.mean, half=half, n=n)
    yield row("score_mean_difference", predicted.mean - (observed.mean - bias), half=math.hypot(half, wide[0]), n=n)
    if observed.sd > 0 and part > 0:
        ratio, dof = predicted.sd / observed.sd, max(0.5 / part**2, 1.0)
        sides = np.hypot(0.5 * np.log(scipy.stats.chi2.ppf([0.025, 0.975], dof) / dof), wide[1])
        yield row("score_sd_ratio", ratio, (ratio * np.exp([-1.0, 1.0] * sides)).tolist(), n=n)
    else:
        yield from skip_as("few_pixels.scores", "score_sd_ratio")


LEVELS = (1e-1, 1e-2, 1e-3, 1e-4)


def compare_exceedance(predicted: ExceedanceCurve, observed: ExceedanceCurve) -> Iterator[Result]:
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
        label = short_label(level)
        if level * n < LEAST_EXPECTED_ALARMS:
            if level >= 1e-3:
                yield from skip_as("few_alarms.pfa", f"pfa_ratio@{label}", n=observed.n, alarms=level * n)
            continue
        k = nearest_point(observed, level)
        measured, threshold = float(observed.probability[k]), observed.threshold[k]
        if not 0.5 * level < measured < 2.0 * level:
            yield from skip_as("beyond_curve.ties", f"pfa_ratio@{label}", n=observed.n, share=measured, label=label)
            continue
        ratio = false_alarm_ratio(predicted, observed, k)
        extrapolated = threshold > predicted.threshold[predicted.probability > 0][-1]
        halves = math.nan if observed.half_image is None else float(observed.half_image[k])
        words = said("pfa_ratio", ratio=ratio, threshold=threshold, beyond=extrapolated, observed=observed, at=k)
        yield row(f"pfa_ratio@{label}", ratio.value, (ratio.lower, ratio.upper), n=observed.n, reason=words)
        yield from _ratio_without_part(f"pfa_ratio_without@{label}", ratio.value, threshold, predicted)
        if np.isfinite(halves):
            why = f"of {round(measured * n)} alarms; median over random halves"
            yield row(f"pfa_repeatability@{label}", halves, n=observed.n, reason=why)


def _ratio_without_part(metric: str, ratio: float, threshold: float, predicted: ExceedanceCurve) -> Iterator[Result]:
    """The ratio nearest to 1 of those without one part of the image, where they are known, and which part that is."""
    if (parts := predicted.influence) is None:
        return
    number, alarms = parts.number, parts.alarms[:, np.argmin(np.abs(parts.threshold - threshold))]
    pixels = np.bincount(number[number >= 0], minlength=alarms.size)
    ratios = np.where(pixels > 0, parts.at(threshold), np.inf)
    part = int(np.argmin(np.abs(np.log(ratios))))
    far, rest = abs(math.log(ratio)), abs(math.log(ratios[part]))
    responsible = far > 2.0 * rest or far < math.log(1.25)
    places, held = np.nonzero(number == part), 100.0 * alarms[part] / max(alarms.sum(), 1)
    numbers = {"places": places, "pixels": pixels, "held": held, "without": ratios[part], "ratio": ratio}
    words = said("pfa_ratio_without", part=part, responsible=responsible, **numbers)
    yield row(metric, float(ratios[part]), n=int(pixels[part]), reason=words)


def compare_classification(p: ClassificationError, o: ClassificationError) -> Iterator[Result]:
    """Rows of one set of classes in one set of features.

    ``error_predicted``, ``error_observed`` with their intervals; ``error_difference`` predicted - observed with the
    interval of Newcombe (1998); ``error_inside_interval`` 1 where that holds 0; ``error_approximation`` and
    ``error_bounds`` from the predicted Bhattacharyya distances (the bounds are the interval, the value their
    geometric mean); ``distance_predicted``, ``distance_observed`` of the two nearest classes.

    Examples
    --------
    >>> limits = {"bound_lower": 0.02, "bound_upper": 0.22}
    >>> predicted = ClassificationError(0.10, 0.09, 0.11, distance=0.8, approximation=0.1, **limits)
    >>> rows = compare_classification(predicted, ClassificationError(0.12, 0.10, 0.14, 400, 380.0, distance=0.7))
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('error_predicted', 0.1), ('error_observed', 0.12), ('error_difference', -0.02), ('error_inside_interval',
    1.0), ('error_approximation', 0.1), ('distance_predicted', 0.8), ('distance_observed', 0.7),
    ('error_bounds', 0.066)]
    """
    words = "" if o.effective_n is None else f"{o.effective_n:.0f} of {o.n} pixels count as independent"
    first = row("error_predicted", p.error, (p.lower, p.upper), n=p.n)
    second = row("error_observed", o.error, (o.lower, o.upper), n=o.n, reason=words)
    yield from (rows := with_difference("error_{}".format, first, second))
    yield _inside_row("error_inside_interval", rows[-1], second)
    yield row("error_approximation", p.approximation)
    yield row("distance_predicted", p.distance)
    yield row("distance_observed", o.distance, n=o.n)
    if p.bound_lower > 0:
        yield row("error_bounds", np.sqrt(p.bound_lower * p.bound_upper), (p.bound_lower, p.bound_upper))


EVERY_OBJECT = "all objects"
OF_ALL = ("objects_inside_95", "objects_inside_95_p_value", "pit_uniformity_p_value")
# Spread of the scores about their medians, over the predicted one, that the tests are asked about.
WIDTHS = (1.25, 1.5, 2.0, 3.0)
POWER_DRAWS = 1000
POWER_LEVEL, POWER = 0.01, 0.8
# Objects whose joint distribution the draws can tell: ten draws for each.
MAX_JOINED = 200
# Sets of objects drawn from the prediction, for what the model itself expects of them together.
REPLICATES = 4000
_SEED = 17
_DRAWS = "against draws of the model"


def probability_integral_transform(score: npt.ArrayLike, draws: npt.ArrayLike) -> Array:
    """(n,) share of the predicted draws (N,) below each measured score (n,), equal ones counted half.

    Over many objects, each with its own prediction, the values are uniform on (0, 1) when the predictions are
    right, so objects of different kinds are judged together.  Source: Rosenblatt, Ann. Math. Stat. 23, 470, 1952.
    The share is (below + 1/2) / (N + 1), so that no score is impossible to a finite number of draws.
    """
    # Scores in their order are found three times as fast.
    (scores, place), ordered = np.unique(score, return_inverse=True), np.sort(draws, axis=None)
    below = 0.5 * (np.searchsorted(ordered, scores, "left") + np.searchsorted(ordered, scores, "right"))
    return np.asarray((below + 0.5) / (ordered.size + 1.0))[place]


def distance_from_uniform(values: npt.ArrayLike) -> Array:
    """(...) Kolmogorov-Smirnov distance of values (..., n) from the uniform distribution on (0, 1)."""
    u = np.sort(np.asarray(values, dtype=float), axis=-1)
    n = u.shape[-1]
    step = np.arange(n + 1) / n
    return np.asarray(np.maximum((step[1:] - u).max(axis=-1), (u - step[:-1]).max(axis=-1)))


def judged_together(
    predicted: Mapping[str, ObjectScores], measured: Mapping[str, Array], note: str = ""
) -> Iterator[Result]:
    """Rows of transform values of all objects against what the model expects of them.

    Objects of one material share the error of its spectrum and all share the blur, so their values are not
    independent and the customary tests would reject right models.  The reference is therefore drawn from the
    prediction: one row of it (one draw of the inputs) for all objects, then each object within that row; the first half
    of the reference by the first half of the rows, the second by the others.  The same draws, spread about their
    medians, say which width the tests would have found.

    - ``objects_inside_95`` their share in their predicted 95 % intervals, with the exact interval if they were
      independent, and ``objects_inside_95_p_value`` that so few lie inside;
    - ``pit_uniformity_p_value`` of so large a distance of the transform values from uniformity;
    - ``joint_distance_p_value`` of the Mahalanobis distance of the normal scores, correlation counted, near 1 where
      the predicted spread is too wide; SKIPPED for too many objects;
    - ``pit_trend`` and ``pit_trend_p_value``: drift of the normal scores from the weakest expected object to the
      strongest; none where all are expected alike;
    - ``pit_spread_ratio`` of the normal scores about their mean, expected over measured; none of one object.

    Parameters
    ----------
    predicted, measured : by subject; (n,) scores of its objects
    note : what the reasons of the tests end in

    Examples
    --------
    >>> draws = np.random.default_rng(0).normal(size=(50, 80))
    >>> predicted = {name: ObjectScores(draws + i) for i, name in enumerate("abc")}
    >>> measured = {name: np.array([i + 0.5]) for i, name in enumerate("abc")}
    >>> [round(r.value, 2) for r in judged_together(predicted, measured) if r.metric.endswith("p_value")]
    [1.0, 0.06, 0.85, 1.0]
    >>> scattered = {name: np.array([i - 2.0, i, i + 2.0]) for i, name in enumerate("abc")}
    >>> *_, wide = judged_together(predicted, scattered)
    >>> [round(x, 2) for x in (wide.value, wide.lower, wide.upper)]
    [0.54, 0.28, 0.86]
    >>> known = predicted | {"d": ObjectScores(draws[:1] + 3.0)}  # of another scenario, whose inputs are known
    >>> [3.0 * next(judged_together(known, {s: np.array([3.5]) for s in names})).value for names in ("abd", "dba")]
    [1.0, 1.0]
    """
    if not measured:
        yield from skip_as("no_observation.objects", *OF_ALL)
        return
    rng, half, shared = np.random.default_rng(_SEED), REPLICATES // 2, dict[int, Index]()
    values, drawn, wider, strength = [], [], [], []
    for subject, scores in measured.items():
        draws = predicted[subject].values
        if (rows := len(draws)) not in shared:  # one scenario's errors are not in as many draws as another's
            halves = rng.integers(max(rows // 2, 1), size=half), rng.integers(rows // 2, rows, size=half)
            shared[rows] = np.concatenate(halves)[:, None]
        values.append(probability_integral_transform(scores, draws))
        median = float(np.median(draws))
        place = shared[rows], rng.integers(draws.shape[1], size=(REPLICATES, scores.size))
        spread = median + np.multiply.outer(WIDTHS, draws[place][-POWER_DRAWS:] - median)
        drawn.append(probability_integral_transform(draws, draws)[place])
        wider.append(probability_integral_transform(spread, draws))
        strength += [median] * scores.size
    u, reference, wide = np.concatenate(values), np.concatenate(drawn, axis=1), np.concatenate(wider, axis=2)
    z, x = scipy.special.ndtri(u), scipy.special.ndtri(reference)
    yield from _inside_rows(u, reference, wide, note)
    yield _uniformity_row(u, reference, wide, note)
    yield from _joint_distance(z, x, wide, note)
    yield from _drift_rows(z, x, np.array(strength), note)
    if z.size > 1 and (found := float(np.std(z, ddof=1))):
        low, middle, high = np.quantile(np.std(x, axis=-1, ddof=1), [0.025, 0.5, 0.975]) / found
        yield row("pit_spread_ratio", middle, (low, high), n=z.size, reason=f"normal scores about their mean, {_DRAWS}")


def _tail_share(statistic: float, reference: Array) -> float:
    """Share of the reference (R,) at or beyond the statistic."""
    return float((1 + np.sum(reference >= statistic)) / (1 + reference.size))


def _width_found(reference: Array, wide: Array, level: float = POWER_LEVEL) -> float:
    """The least of the widths whose draws (F, D) lie beyond the level of the reference (R,) in 80 % of cases."""
    power = np.mean(wide > np.quantile(reference, 1.0 - level), axis=1)
    return min((f for f, share in zip(WIDTHS, power, strict=True) if share >= POWER), default=math.nan)


def _inside_rows(u: Array, reference: Array, wide: Array, note: str) -> Iterator[Result]:
    inside, n, expected = int(np.sum(in_central_95(u))), u.size, in_central_95(reference).sum(axis=1)
    low, high = np.quantile(expected, [0.025, 0.975], method="nearest") / n
    lower, upper = map(float, clopper_pearson(inside, n))
    why = f"the model expects {low:.3g} to {high:.3g}; the interval treats objects as independent{note}"
    yield row(OF_ALL[0], inside / n, (lower, upper), n=n, reason=why)
    about = Effect(inside / n, lower, upper, partial(drawn_range, expected / n, 1.0, 0.0), decides=False)
    width, why = _width_found(-expected, -in_central_95(wide).sum(axis=2)), f"of so few inside, by the model{note}"
    yield row(OF_ALL[1], _tail_share(-inside, -expected), n=n, detectable=width, reason=why, about=about)


def _uniformity_row(u: Array, reference: Array, wide: Array, note: str) -> Result:
    distances, distance = distance_from_uniform(reference), float(distance_from_uniform(u))
    # No distance of two distributions differs from a third one's by more than that of the two.
    reach = float(np.quantile(distances, 0.95))
    ends = max(distance - reach, 0.0), min(distance + reach, 1.0)
    about = Effect(distance, *ends, partial(drawn_range, distances, 0.0, 1.0), decides=False)
    why = f"Kolmogorov-Smirnov distance, against sets of objects drawn from the model{note}"
    width = _width_found(distances, distance_from_uniform(wide))
    return row(OF_ALL[2], _tail_share(distance, distances), n=u.size, detectable=width, reason=why, about=about)


def _joint_distance(z: Array, x: Array, wide: Array, note: str) -> Iterator[Result]:
    """Mahalanobis distance of the normal scores; their covariance is that of one half of the draws.

    The other half, of other draws of the inputs, is what the distance is compared with: neither it nor the measured set
    had a part in the covariance.
    """
    half, n = x.shape[0] // 2, z.size
    if n > MAX_JOINED:
        yield from skip_as("few_pixels.draws", "joint_distance_p_value", n=n, most=MAX_JOINED)
        return
    inverse = np.linalg.pinv(np.atleast_2d(np.cov(x[:half], rowvar=False)))

    def distance(v: Array) -> Array:
        return np.asarray(np.sum((v @ inverse) * v, axis=-1))

    found, reference = float(distance(z)), distance(x[half:])
    size = math.sqrt(found / n)
    low, high = (math.sqrt(1.0 + noncentrality(found / n, n, math.inf, part) / n) for part in (0.975, 0.025))
    accepted = partial(drawn_range, np.sqrt(reference / n), 0.5, 0.5)
    width = _width_found(reference, distance(scipy.special.ndtri(wide)), POWER_LEVEL / 2.0)  # the other tail counts too
    about = Effect(size, min(low, size), max(high, size), accepted, (math.nan, width))
    why = f"Mahalanobis distance of the normal scores, {_DRAWS}{note}"
    yield row("joint_distance_p_value", _tail_share(found, reference), n=n, detectable=width, reason=why, about=about)


def _drift_rows(z: Array, drawn_scores: Array, strength: Array, note: str) -> Iterator[Result]:
    """Drift of the normal scores along the rank of the expected score."""
    place = scipy.stats.rankdata(strength, method="dense")
    if place.max() < 2:
        return
    x = (place - place.mean()) / (place.max() - 1.0)
    weight = x / float(x @ x)
    slope, drawn = float(z @ weight), drawn_scores @ weight
    low, high = (float(q) for q in np.quantile(drawn, [0.025, 0.975]))
    ends = slope - max(high, 0.0), slope - min(low, 0.0)
    found = float(np.quantile(np.abs(drawn), 1.0 - POWER_LEVEL) - np.quantile(drawn, 1.0 - POWER))
    accepted = partial(drawn_range, np.concatenate([drawn, -drawn]), 0.5, 0.5)
    yield row("pit_trend", slope, ends, n=z.size, reason=_DRAWS)
    p, about = _tail_share(abs(slope), np.abs(drawn)), Effect(slope, *ends, accepted, (-found, found))
    why = f"drift of the normal scores, {_DRAWS}{note}"
    yield row("pit_trend_p_value", p, n=z.size, detectable=found, reason=why, about=about)


def drawn_range(sizes: Array, below: float, above: float, level: float) -> Interval:
    """Range that draws of the model stay in: ``below`` and ``above`` times the level lie beyond its ends; 0: no end."""
    low, high = np.quantile(sizes, [below * level, 1.0 - above * level])
    return (float(low) if below else math.nan), (float(high) if above else math.nan)


def in_central_95(values: npt.ArrayLike) -> Mask:
    """True for transform values in the central 95 %."""
    return np.asarray((np.asarray(values) >= 0.025) & (np.asarray(values) <= 0.975))


def compare_object_scores(
    predicted: Mapping[str, ObjectScores], measured: Mapping[str, ObjectScores], *, method: str
) -> Iterator[Result]:
    """Every object's measured score against its predicted distribution, then all of them together.

    A subject of one object gives ``object_score_measured``, ``object_score_predicted`` (median and 95 % interval),
    ``object_score_pit`` and ``object_score_inside_95`` (1 or 0); a subject of several, and all objects together, the
    rows of :func:`judged_together`.  Subjects that were measured and not predicted are left out; one that was
    predicted and has no valid score gives SKIPPED rows and is named in the reason of the summary.

    Examples
    --------
    >>> draws = np.random.default_rng(0).normal(size=(50, 80))
    >>> predicted, measured = {"panel": ObjectScores(draws)}, {"panel": ObjectScores(np.array([1.0]), ("p1",))}
    >>> rows = compare_object_scores(predicted, measured, method="cem")
    >>> [(r.metric, round(r.value, 2)) for r in rows if r.metric.startswith("object_")]
    [('object_score_measured', 1.0), ('object_score_predicted', -0.03), ('object_score_pit', 0.84),
    ('object_score_inside_95', 1.0)]
    """
    found = {name: measured[name].values if name in measured else np.empty(0) for name in predicted}
    found = {name: scores[np.isfinite(scores)] for name, scores in found.items()}
    for name, scores in found.items():
        yield from named(_subject_rows(predicted[name], scores), "scores", name, method)
    lost = ", ".join(name for name, scores in found.items() if not scores.size)
    common = {name: scores for name, scores in found.items() if scores.size}
    note = f"; without {lost}" if lost else ""
    yield from named(judged_together(predicted, common, note), "scores", EVERY_OBJECT, method)


def _subject_rows(model: ObjectScores, scores: Array) -> Iterator[Result]:
    """Rows of the objects of one subject, with their finite scores."""
    if scores.size == 0:
        yield from skip_as("no_observation.score", "object_score_pit", "object_score_inside_95")
    elif scores.size > 1:
        yield from judged_together({"": model}, {"": scores})
    else:
        low, middle, high = (float(x) for x in np.quantile(model.values, [0.025, 0.5, 0.975]))
        (u,) = probability_integral_transform(scores, model.values)
        why, z = f"measured {scores[0]:.4g}, predicted {low:.4g} to {high:.4g}", float(scipy.special.ndtri(u))
        yield row("object_score_measured", scores[0], n=1)
        yield row("object_score_predicted", middle, (low, high))
        yield row("object_score_pit", u, n=1)
        yield row("object_score_inside_95", float(in_central_95(u)), n=1, reason=why, about=Effect(z))


def ratio_limits(a: float, ua: float, b: float, ub: float) -> Interval:
    """95 % limits of a / b of independent normal estimates with standard uncertainties: r with |a - r b| <= 1.96 u.

    NaN where b may be 0: nothing bounds the ratio then.  Source: Fieller, J. R. Stat. Soc. B 16, 175-185, 1954.

    Examples
    --------
    >>> [round(end, 3) for end in ratio_limits(1.0, 0.05, 1.0, 0.2)]
    [0.706, 1.657]
    """
    rest = b**2 - (Z95 * ub) ** 2
    if rest <= 0.0:
        return math.nan, math.nan
    root = math.sqrt(max((a * b) ** 2 - rest * (a**2 - (Z95 * ua) ** 2), 0.0))
    return (a * b - root) / rest, (a * b + root) / rest


def compare_abundance(predicted: Abundance, observed: Abundance) -> Iterator[Result]:
    """Rows ``area_predicted``, ``area_observed`` [m2], ``area_ratio`` (observed over predicted),
    ``area_difference_ratio``, ``area_z``, ``area_inside_95``.

    The ratio is (predicted - observed)/observed with :func:`ratio_limits` of both uncertainties; z is the difference
    over sqrt(u_p^2 + u_o^2).  Where neither side has an uncertainty, z and the verdict are SKIPPED.
    Where both sides estimate a nominal area: ``area_error_predicted`` and ``area_error_observed`` [m2], estimate
    less nominal area, ``area_nominal_ratio`` measured over nominal, and ``area_in_predicted_95``, 1 where the
    measured area lies in the predicted interval.

    Examples
    --------
    >>> rows = compare_abundance(Abundance(4.1, 0.2), Abundance(3.8, 0.3, 20, 4.0))
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('area_predicted', 4.1), ('area_observed', 3.8), ('area_ratio', 0.927), ('area_difference_ratio', 0.079),
    ('area_error_predicted', 0.1), ('area_error_observed', -0.2), ('area_nominal_ratio', 0.95),
    ('area_in_predicted_95', 1.0), ('area_z', 0.832), ('area_inside_95', 1.0)]
    """
    p, o, n = predicted.area_m2, observed.area_m2, observed.n
    up, uo = predicted.standard_uncertainty, observed.standard_uncertainty
    # Beside the truth's area the pipeline alone moves the row.
    evidence = None if predicted.modelled else Evidence.PIPELINE
    yield row("area_predicted", p, half=Z95 * up, n=predicted.n, evidence=evidence)
    yield row("area_observed", o, half=Z95 * uo, n=n)
    if p > 0:
        yield row("area_ratio", o / p, ratio_limits(o, uo, p, up), n=n, evidence=evidence)
    else:
        yield from skip_as("not_positive.area", "area_ratio", side="predicted")
    if o > 0:
        low, high = ratio_limits(p, up, o, uo)
        yield row("area_difference_ratio", p / o - 1.0, (low - 1.0, high - 1.0), n=n, evidence=evidence)
    else:
        yield from skip_as("not_positive.area", "area_difference_ratio", side="observed")
    if (nominal := observed.nominal_m2) is not None:
        yield row("area_error_predicted", p - nominal, half=Z95 * up, n=predicted.n)
        yield row("area_error_observed", o - nominal, half=Z95 * uo, n=n)
        if nominal > 0:
            yield row("area_nominal_ratio", o / nominal, half=Z95 * uo / nominal, n=n)
        else:
            yield from skip_as("not_positive.area", "area_nominal_ratio", side="nominal")
        yield row("area_in_predicted_95", abs(p - o) <= Z95 * up, n=n)
    if (u := float(np.hypot(up, uo))) > 0:
        yield row("area_z", (p - o) / u, evidence=evidence)
        yield row("area_inside_95", abs((p - o) / u) <= Z95, evidence=evidence)
    else:
        yield from skip_as("no_uncertainty.area", "area_z", "area_inside_95")


def compare_area_errors(
    predicted: Mapping[tuple[str, str], Abundance], observed: Mapping[tuple[str, str], Abundance]
) -> Iterator[Result]:
    """Rows by nominal area and method: ``area_bias_*`` and ``area_rmse_*`` [m2] of both sides over its targets.

    The bias has Student's interval, the root mean square error that of chi-square with the degrees of freedom of the
    noncentral law of normal errors with that bias: held in 0.95 to 0.96 of draws of 2 to 30 targets.  The predicted
    mean square is that of predicted biases and spreads.

    Examples
    --------
    >>> predicted = {("a", "fcls"): Abundance(1.1, 0.1), ("b", "fcls"): Abundance(1.1, 0.1)}
    >>> observed = {("a", "fcls"): Abundance(1.2, 0.1, 4, 1.0), ("b", "fcls"): Abundance(1.0, 0.1, 4, 1.0)}
    >>> rows = compare_area_errors(predicted, observed)
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('area_bias_observed', 0.1), ('area_bias_predicted', 0.1), ('area_rmse_observed', 0.141),
    ('area_rmse_predicted', 0.141)]
    """
    groups: dict[tuple[str, float], list[tuple[float, float, float]]] = {}
    for key, area in observed.items():
        if area.nominal_m2 is not None and (model := predicted.get(key)) is not None:
            nominal = round(area.nominal_m2, 6)
            errors = area.area_m2 - nominal, model.area_m2 - nominal, model.standard_uncertainty
            groups.setdefault((key[1], nominal), []).append(errors)
    for (method, nominal), found in groups.items():
        if len(found) > 1:
            yield from named(_area_errors(*np.array(found).T), "abundance", f"all targets of {nominal:g} m2", method)


def _area_errors(error: Array, model: Array, spread: Array) -> Iterator[Result]:
    """Bias and root mean square of measured errors (n,) and of predicted ones with their standard uncertainty."""
    n, rmse = error.size, float(np.sqrt(np.mean(error**2)))
    student, variance = float(scipy.stats.t.ppf(0.975, n - 1)), float(np.var(error, ddof=1))
    half = student * math.sqrt(variance / n)
    bias = max(float(error.mean()) ** 2 - variance / n, 0.0)
    # What the bias brings to the scatter of the mean square goes by Student's t, as the variance is known by n errors.
    scatter = max(variance + 2.0 * bias, 1e-300)
    dof, part = min(n * (variance + bias) ** 2 / max(variance * scatter, 1e-300), 1e9), 2.0 * bias / scatter
    low, high = (dof / scipy.stats.chi2.ppf([0.975, 0.025], dof)) ** (0.5 + 0.5 * part * (student / Z95 - 1.0))
    yield row("area_bias_observed", error.mean(), half=half, n=n)
    yield row("area_bias_predicted", model.mean(), half=Z95 * float(np.sqrt(np.sum(spread**2))) / n, n=n)
    yield row("area_rmse_observed", rmse, (rmse * low, rmse * high), n=n)
    yield row("area_rmse_predicted", np.sqrt(np.mean(model**2 + spread**2)), n=n)


def samples_per_km2(curve: RocCurve) -> float:
    """Background samples on a square kilometre; NaN when the area is not known."""
    return (curve.n_background or math.nan) / (curve.background_area_km2 or math.nan)


def alarm_rows(predicted: RocCurve | None, observed: RocCurve, pfa: float) -> Iterator[Result]:
    """False alarms at the threshold that the background sets for a P_FA; nothing where it expects fewer than 10.

    ``far_measured@1e-2``: alarms per km2.  The interval is that of Clopper & Pearson on the alarms, times the samples
    per km2; for rare alarms it is the exact Poisson interval.  The share of the background above its own (k + 1)-th
    greatest score follows a beta distribution whose quantiles lie inside it, so it holds although the threshold was
    set by the same background.  Alarms that come in clusters count as fewer: they and the samples are divided by the
    design effect of the curve.

    ``joint_pfa``, ``joint_pd`` and ``pd_inside_joint_region`` ``@1e-2``: the rectangle of the first two intervals
    holds the true (P_FA, P_D) of the measured threshold with 95 % probability: two independent statements at level
    sqrt(0.95) each (Kerekes, IEEE GRSL 5(2), 251-255, 2008).  The last row is 1 where the predicted curve passes
    through the rectangle, its own band and the rectangle's side taken in quadrature.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1])
    >>> pd, alarms = np.array([0.3, 0.6, 0.9]), np.array([10, 100, 1000])
    >>> curve = RocCurve(pfa, pd, pfa, pfa, -pfa, "pixel", 40, 10_000, 0.04, alarms)
    >>> [(r.metric, round(r.value, 3)) for r in alarm_rows(curve, curve, 1e-2)]
    [('far_measured@1e-2', 2500.0), ('joint_pfa@1e-2', 0.01), ('joint_pd@1e-2', 0.6),
    ('pd_inside_joint_region@1e-2', 1.0)]
    """
    i, m, n = np.flatnonzero(np.abs(observed.pfa - pfa) <= 1e-9 * pfa), observed.n_target, observed.n_background or 0
    if observed.alarms is None or pfa * n < LEAST_EXPECTED_ALARMS or not i.size:
        return
    label, alarms, density = short_label(pfa), int(observed.alarms[i[-1]]), samples_per_km2(observed)
    counted = np.array([alarms, n]) / (1.0 if observed.design_effect is None else observed.design_effect[i[-1]])
    if math.isnan(density):
        yield from skip_as("no_ground_area.background", f"far_measured@{label}")
    else:
        area = observed.background_area_km2 or math.nan
        ends = tuple(float(x) * density for x in clopper_pearson(*counted))
        yield row(f"far_measured@{label}", alarms / area, ends, n=n, reason=f"{alarms} alarms in {area:.4g} km2")
    if not m:
        return
    detected = round(float(observed.pd[i[-1]]) * m)
    both, level = (counted, (detected, m)), math.sqrt(0.95)
    span, (least, most) = (tuple(map(float, clopper_pearson(k, total, level))) for k, total in both)
    why = f"{detected} of {m} {observed.unit}s and {alarms} of {n} background samples; joint coverage 95 %"
    yield row(f"joint_pfa@{label}", alarms / n, span, n=n, reason=why)
    yield row(f"joint_pd@{label}", detected / m, (least, most), n=m, reason=why)
    if predicted is None:
        return
    name = f"pd_inside_joint_region@{label}"
    if most - least > WIDEST_INTERVAL:
        yield from skip_as("vacuous.region", name, n=m, unit=observed.unit)
        return
    first, last = float(predicted.pfa[0]), float(predicted.pfa[-1])
    lo, hi = (pd_at(predicted, x) if first <= x <= last else (float(x > last), (math.nan, math.nan)) for x in span)
    bands = np.nan_to_num([hi[1][1] - hi[0], lo[0] - lo[1][0]])
    below, above = np.hypot([detected / m - least, most - detected / m], bands)
    # A rising curve crosses the rectangle unless it lies below it at the right end or above it at the left end.
    yield row(name, hi[0] >= detected / m - below and lo[0] <= detected / m + above, n=m)


def far_at_detection_rows(predicted: RocCurve | None, observed: RocCurve) -> Iterator[Result]:
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
    >>> [(r.metric, round(r.value)) for r in far_at_detection_rows(predicted, observed)]
    [('far_predicted@pd0.5', 1252), ('far_measured@pd0.5', 1000), ('far_difference@pd0.5', 252)]
    """
    density = samples_per_km2(observed)
    for point in observed.at_detection:
        name = f"far_{{}}@pd{point.pd:g}".format
        if math.isnan(density):
            yield from skip_as("no_ground_area.background", name("measured"))
            continue
        at_most = float(clopper_pearson(0, n, 0.9)[1]) * density if (n := observed.n_background) else math.nan
        why = said("far_measured", point=point, observed=observed, density=density, at_most=at_most)
        ends = point.pfa_lower * density, point.pfa_upper * density
        measured = row(name("measured"), point.pfa * density, ends, n=observed.n_target, reason=why)
        first = _predicted_alarms(name("predicted"), predicted, point.pd, density) if predicted else None
        yield from with_difference(name, first, measured)


def _predicted_alarms(metric: str, curve: RocCurve, pd: float, density: float) -> Result:
    """Alarms per km2 where a predicted curve reaches P_D; its band bounds them."""
    p, low, high = (10.0 ** log10_false_alarm_at(curve, pd, y) for y in (curve.pd, curve.pd_upper, curve.pd_lower))
    if math.isnan(p):
        return skip_as("beyond_curve.pd", metric, pd=pd)[0]
    # Where a limit of the band lies wholly above or below that P_D, its end of the range bounds P_FA.
    ends = 0.0 if math.isnan(low) else min(low, p), 1.0 if math.isnan(high) else max(high, p)
    return row(metric, p * density, (ends[0] * density, ends[1] * density))


def _measured_area(metric: str, observed: RocCurve, full: str, area: RocArea) -> Result:
    """Area of a measured curve, and how its interval was made."""
    n, found = observed.n_background, observed.areas.get(full)
    if found is not None:
        return row(metric, found.value, (found.lower, found.upper), n=observed.n_target, reason=found.method)
    if observed.areas and area.logarithmic and n is not None:
        return skip_as("few_alarms.area", metric, n=n, name=full, low=area.low, least=LEAST_EXPECTED_ALARMS)[0]
    if math.isnan(value := curve_area(observed, area)):
        return skip_as("beyond_curve.measured_area", metric)[0]
    return row(metric, value, n=observed.n_target, reason="no interval: the scores behind the curve are not known")


def area_rows(predicted: RocCurve | None, observed: RocCurve | None) -> Iterator[Result]:
    """``auc_predicted``, ``auc_measured``, ``auc_difference`` and the same of the partial and log-weighted areas.

    The names of partial areas end in their range of P_FA.  The predicted interval is that of the curve's band, as
    if its errors went together over the whole curve, a point without one; the measured one is explained in its reason.
    The difference (predicted - measured) has the interval of :func:`~hyperval.compare.difference_interval`.

    Examples
    --------
    >>> import numpy as np
    >>> from hyperval.pixels.roc import empirical_roc, with_areas_and_alarms
    >>> rng = np.random.default_rng(0)
    >>> target, background = rng.normal(2.0, 1.0, 40), rng.normal(size=20_000)
    >>> measured = with_areas_and_alarms(empirical_roc(target, background), target, background)
    >>> [(r.metric, round(r.value, 2)) for r in area_rows(measured, measured)]
    [('auc_predicted', 0.94), ('auc_measured', 0.94), ('auc_difference', 0.0), ('partial_auc_predicted@0..1e-1',
    0.59), ('partial_auc_measured@0..1e-1', 0.59), ('partial_auc_difference@0..1e-1', -0.0),
    ('log_auc_predicted@1e-3..1e-1', 0.36), ('log_auc_measured@1e-3..1e-1', 0.36),
    ('log_auc_difference@1e-3..1e-1', 0.0)]
    """
    for full, area in AREAS.items():
        base, sign, span = full.partition("@")
        name, first = f"{base}_{{}}{sign}{span}".format, None
        if predicted is not None:
            value, *limits = (curve_area(predicted, area, y) for y in (None, predicted.pd_lower, predicted.pd_upper))
            first = row(name("predicted"), value, (min(value, *limits), max(value, *limits)))
            if math.isnan(value):
                (first,) = skip_as("beyond_curve.area", first.metric, span=span)
        second = _measured_area(name("measured"), observed, full, area) if observed else None
        yield from with_difference(name, first, second)


ALWAYS = (1e-1, 1e-2, 1e-3)
IF_BACKGROUND_ALLOWS = (1e-4, 1e-5, 1e-6)
# A measured interval wider than this accepts nearly any prediction: one target alone gives 0.975 or more.
WIDEST_INTERVAL = 0.9
METRICS = ("pd_predicted", "pd_measured", "pd_difference", "pd_inside_interval", "pd_inside_measured_interval")
# The two readings of (3.30-3.33) are told apart where their P_D differ by more than this.
SAME_READING = 1e-3


def pd_at(curve: RocCurve, pfa: float) -> tuple[float, Interval]:
    """P_D at ``pfa`` with its 95 % limits; NaN outside the curve."""
    value, low, high = (float(detection_at(curve, pfa, y)) for y in (None, curve.pd_lower, curve.pd_upper))
    return value, (low, high)


def equivalence(interval: Interval, margin: float) -> tuple[float, str]:
    """The three outcomes of a comparison with a margin: 1 equivalent, -1 different, 0 undecided, and the word.

    Equivalent by two one-sided tests: the whole 95 % interval of the difference lies inside +-``margin``, which rejects
    "the difference is at least the margin" on both sides at the 2.5 % level.  No difference found is not equivalence: a
    wide interval fails.  Source: Schuirmann, J. Pharmacokinet. Biopharm. 15, 657, 1987.  Different is an interval that
    lies wholly beyond 0: with many targets a difference may be certain and yet within the margin, which is then
    equivalent for the purpose, and the word says both.
    """
    significant = interval[0] > 0.0 or interval[1] < 0.0
    if -margin < interval[0] and interval[1] < margin:
        return 1.0, "equivalent, though significantly different" if significant else "equivalent"
    return (-1.0, "different") if significant else (0.0, "undecided")


def compare_roc(predicted: RocCurve, observed: RocCurve, equivalence_margin: float | None = None) -> Iterator[Result]:
    """Rows at each false-alarm probability, named METRIC@1e-2 and the like.

    ``pd_predicted`` and ``pd_measured`` with their intervals, ``pd_difference`` (predicted - measured) with its
    interval, and 1 or 0 for

    - ``pd_inside_interval``: 0 lies in the 95 % interval of the difference, i.e. the predicted P_D lies in the
      measured interval widened by the predicted half-width *in quadrature*.  That the two intervals
      overlap (widths added) is not enough.  Where the predicted curve has no width it is the next rule;
    - ``pd_inside_measured_interval``: the predicted P_D lies in the measured interval as it stands;
    - ``pd_equivalence`` (with ``equivalence_margin``): 1 equivalent, -1 different, 0 undecided, :func:`equivalence`.

    ``pd_predicted_preset`` and ``pd_inside_interval_preset`` read the predicted curve at the preset P_FA of (3.30),
    that of the worst class alone, where that differs from the P_FA of the whole background (3.33).

    Probabilities: 1e-1, 1e-2, 1e-3 always, and 1e-4 to 1e-6 where the background is large enough to
    expect 10 alarms.  A probability that the background or a curve does not reach gives SKIPPED rows.
    The verdicts (but not the values) are SKIPPED too where the measured interval is wider than 0.9, as with a
    single target object: a test that nothing can fail is no test.
    With what a measured curve knows beyond its points come the areas, false alarms per km2 and joint regions.

    Examples
    --------
    >>> pfa = np.array([1e-3, 1e-2, 1e-1, 1.0])
    >>> predicted = RocCurve(pfa, pfa**0.2, pfa**0.25, pfa**0.15, -pfa, preset_pfa=pfa / 2.0)
    >>> observed = RocCurve(pfa, pfa**0.3, pfa**0.4, pfa**0.25, -pfa, "pixel", 40, 10_000)
    >>> rows = [r for r in compare_roc(predicted, observed) if r.metric.startswith("pd") and r.metric.endswith("@1e-2")]
    >>> [(r.metric, round(r.value, 3)) for r in rows]
    [('pd_predicted@1e-2', 0.398), ('pd_measured@1e-2', 0.251), ('pd_difference@1e-2', 0.147),
    ('pd_inside_interval@1e-2', 0.0), ('pd_inside_measured_interval@1e-2', 0.0), ('pd_predicted_preset@1e-2',
    0.46), ('pd_inside_interval_preset@1e-2', 0.0)]
    """
    rare = [x for x in IF_BACKGROUND_ALLOWS if x * (observed.n_background or 0) >= LEAST_EXPECTED_ALARMS]
    for level in (*ALWAYS, *rare):
        yield from _point_rows(predicted, observed, level, equivalence_margin)
        yield from alarm_rows(predicted, observed, level)
    yield from whole_curve_rows(predicted, observed)


def whole_curve_rows(predicted: RocCurve | None, observed: RocCurve) -> Iterator[Result]:
    """False alarms at detection probabilities and areas; ``alarms_before_first``
    (:func:`~hyperval.pixels.roc.alarms_before_first`), where it was counted.

    Examples
    --------
    >>> pfa = np.array([1e-2, 1e-1])
    >>> curve = RocCurve(pfa, pfa, pfa, pfa, -pfa, "object", 7, 10_000, alarms_before_first=3)
    >>> first, *_ = whole_curve_rows(None, curve)
    >>> first.metric, first.value
    ('alarms_before_first', 3.0)
    """
    yield from far_at_detection_rows(predicted, observed)
    if (first := observed.alarms_before_first) is not None:
        yield row("alarms_before_first", first, n=observed.n_target, reason=said("alarms_before_first", curve=observed))
    yield from area_rows(predicted, observed)


def _point_rows(predicted: RocCurve, observed: RocCurve, pfa: float, margin: float | None) -> Iterator[Result]:
    label = short_label(pfa)
    names = [f"{m}@{label}" for m in (*METRICS, *(["pd_equivalence"] if margin is not None else []))]
    n, background = observed.n_target, observed.n_background
    if background is not None and pfa * background < LEAST_EXPECTED_ALARMS:
        yield from skip_as("few_alarms.pd", *names, n=background, pfa=pfa, label=label, least=LEAST_EXPECTED_ALARMS)
        return
    (p, band), (o, (low, high)) = pd_at(predicted, pfa), pd_at(observed, pfa)
    if math.isnan(p) or math.isnan(o):
        yield from skip_as("beyond_curve.point", *names, side="predicted" if math.isnan(p) else "measured", label=label)
        return
    right = row(names[1], o, (low, high), n=n)
    yield from (rows := with_difference(f"pd_{{}}@{label}".format, row(names[0], p, band), right))
    if high - low > WIDEST_INTERVAL:
        yield from skip_as("vacuous.interval", *names[3:], low=low, high=high, curve=observed)
        return
    difference = rows[-1]
    yield _inside_row(names[3], difference, right)
    # With an unknown measured interval the verdict is unknown, not "outside".
    valid = math.nan if math.isnan(low + high) else 1.0
    yield row(names[4], valid * (low <= p <= high), n=n)
    if margin is not None:
        ends = difference.lower, difference.upper
        about = Effect(difference.value, *ends, lambda _: (-margin, margin))
        code, word = equivalence(ends, margin)
        yield row(names[5], valid * code, n=n, reason=f"{word} by a margin {margin:g}", about=about)
    yield from _preset_rows(predicted, pfa, p, right)


def _inside_row(metric: str, difference: Result, measured: Result, why: str = "") -> Result:
    """1 or 0, whether the interval of the difference holds 0; NaN without a measured interval."""
    valid = math.nan if math.isnan(measured.lower + measured.upper) else 1.0
    about = Effect(difference.value, difference.lower, difference.upper)
    return row(metric, valid * (about.lower <= 0.0 <= about.upper), n=measured.n, reason=why, about=about)


def _preset_rows(predicted: RocCurve, pfa: float, swept: float, measured: Result) -> Iterator[Result]:
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
    value, ends = pd_at(replace(predicted, pfa=axis, pd=pd, pd_lower=low, pd_upper=high), pfa)
    if abs(value - swept) >= SAME_READING:
        why = f"(3.32) at the preset, without (3.33): {swept:.3g} with it, measured {measured.value:.3g}"
        preset = row(f"pd_predicted_preset@{short_label(pfa)}", value, ends, reason=why)
        yield preset
        *_, difference = with_difference("pd_{}".format, preset, measured)
        yield _inside_row(f"pd_inside_interval_preset@{short_label(pfa)}", difference, measured, why)
