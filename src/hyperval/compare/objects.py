"""Every object's measured score against its predicted distribution, and all objects together.

Target area from the sum of scores against its prediction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy

from hyperval.compare.rows import RowMaker
from hyperval.errors import UsageError
from hyperval.metrics import Evidence
from hyperval.processing.intervals import Z95, clopper_pearson, difference_ratio, difference_ratio_uncertainty
from hyperval.products import Abundance, ObjectScores
from hyperval.results import Cause, Result

Array = npt.NDArray[np.float64]

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
    return _transform(np.asarray(score, dtype=float), np.sort(np.asarray(draws, dtype=float), axis=None))


def _transform(at: Array, ordered: Array) -> Array:
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
    spread = [ordered, *(middle + f * (ordered - middle) for f in WIDTHS)]
    out = np.empty((len(spread), ordered.size))
    out[:, order] = [_transform(x, ordered) for x in spread]
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
    """A test by draws of the model: ``p_value``, and the departure of its kind that it rejects in 80 % of draws."""

    p_value: float
    detectable: float = math.nan


@dataclass(frozen=True)
class Together:
    """Objects judged together.

    Attributes
    ----------
    inside : part of the objects in their predicted 95 % intervals
    interval : exact 95 % interval of that part if the objects were independent
    expected : 95 % range of it that the model expects, with what its objects have in common
    count : test of so few (or fewer) inside
    uniformity : test of so large a distance of the transform values from uniformity
    joint : test of the Mahalanobis distance of the normal scores, correlation counted, near 1 where the predicted
        spread is too wide; None for too many objects
    trend, trend_interval : drift of the normal scores from the weakest expected object to the strongest, and the
        95 % interval of that drift; None where all are expected alike
    drift : its test
    spread, spread_interval : of the normal scores about their mean, expected over measured, and its 95 % interval;
        NaN for one object
    """

    inside: float
    interval: tuple[float, float]
    expected: tuple[float, float]
    count: Test
    uniformity: Test
    joint: Test | None
    trend: float
    trend_interval: tuple[float, float]
    drift: Test | None
    spread: float
    spread_interval: tuple[float, float]


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
    >>> t.inside, round(t.trend, 2), [round(x.p_value, 2) for x in (t.count, t.uniformity, t.joint, t.drift)]
    (1.0, 0.0, [1.0, 0.06, 0.86, 1.0])
    >>> scattered = {name: np.array([i - 2.0, i, i + 2.0]) for i, name in enumerate("abc")}
    >>> wide = judged_together(predicted, scattered)
    >>> [round(x, 2) for x in (wide.spread, *wide.spread_interval)]
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
    count, n = int(np.sum(central(u))), u.size
    expected = central(reference).sum(axis=1)
    low, high = clopper_pearson(count, n)
    span = np.quantile(expected, [0.025, 0.975], method="nearest") / n
    outside = _test(-count, -expected, -central(wide).sum(axis=2))
    distance = distance_from_uniform(reference)
    z, x = scipy.special.ndtri(u), scipy.special.ndtri(reference)
    trend, interval, drift = _trend(z, x, np.array(strength))
    return Together(
        count / n,
        (float(low), float(high)),
        (float(span[0]), float(span[1])),
        outside,
        _test(float(distance_from_uniform(u)), distance, distance_from_uniform(wide)),
        _joint_test(z, x, wide),
        trend,
        interval,
        drift,
        *_spread(z, x),
    )


def _test(statistic: float, reference: Array, wide: Array, both: bool = False) -> Test:
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
    return Test(p, min(seen, default=math.nan))


def _joint_test(z: Array, x: Array, wide: Array) -> Test | None:
    """Mahalanobis distance of the normal scores; their covariance is that of one half of the draws.

    The other half is what the distance is compared with: neither it nor the measured set had a part in the
    covariance.
    """
    if z.size > MOST_JOINED:
        return None
    w = scipy.special.ndtri(wide)
    half = x.shape[0] // 2
    inverse = np.linalg.pinv(np.atleast_2d(np.cov(x[:half], rowvar=False)))

    def distance(v: Array) -> Array:
        return np.asarray(np.sum((v @ inverse) * v, axis=-1))

    return _test(float(distance(z)), distance(x[half:]), distance(w), both=True)


def _trend(z: Array, drawn_scores: Array, strength: Array) -> tuple[float, tuple[float, float], Test | None]:
    """Drift of the normal scores along the rank of the expected score, its interval and its test."""
    place = scipy.stats.rankdata(strength, method="dense")
    if place.max() < 2:
        return math.nan, (math.nan, math.nan), None
    x = (place - place.mean()) / (place.max() - 1.0)
    weight = x / float(x @ x)
    slope = float(z @ weight)
    drawn = drawn_scores @ weight
    low, high = (float(q) for q in np.quantile(drawn, [0.025, 0.975]))
    p = float((1 + np.sum(np.abs(drawn) >= abs(slope))) / (1 + drawn.size))
    detectable = float(np.quantile(np.abs(drawn), 1.0 - POWER_LEVEL) - np.quantile(drawn, 1.0 - POWER))
    return slope, (slope - max(high, 0.0), slope - min(low, 0.0)), Test(p, detectable)


def _spread(z: Array, drawn_scores: Array) -> tuple[float, tuple[float, float]]:
    """Standard deviation of the normal scores (n,) that draws of the model (R, n) have, over the measured one."""
    if z.size < 2 or not (measured := float(np.std(z, ddof=1))):
        return math.nan, (math.nan, math.nan)
    low, middle, high = np.quantile(np.std(drawn_scores, axis=-1, ddof=1), [0.025, 0.5, 0.975]) / measured
    return float(middle), (float(low), float(high))


def central(values: Array) -> npt.NDArray[np.bool_]:
    """True for transform values in the central 95 %."""
    return np.asarray((values >= 0.025) & (values <= 0.975))


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
            out += [make.skipped(Cause.NO_OBSERVATION, "no measured score", metric) for metric in OF_ONE]
            lost.append(name)
            continue
        common[name] = scores
        if scores.size > 1:
            out += _together_rows(make, {name: model}, {name: scores}, "")
            continue
        low, middle, high = (float(x) for x in np.quantile(model.values, [0.025, 0.5, 0.975]))
        u = float(probability_integral_transform(scores, model.values)[0])
        why = f"measured {scores[0]:.4g}, predicted {low:.4g} to {high:.4g}"
        out += [
            make.row("object_score_measured", float(scores[0]), n=1),
            make.row("object_score_predicted", middle, interval=(low, high)),
            make.row("object_score_pit", u, n=1),
            make.row("object_score_inside_95", float(central(np.array([u]))[0]), n=1, reason=why),
        ]
    make = RowMaker("scores", subject, method)
    if not common:
        return out + [make.skipped(Cause.NO_OBSERVATION, "no object has both sides", metric) for metric in OF_ALL]
    return [*out, *_together_rows(make, predicted, common, f"; without {', '.join(lost)}" if lost else "")]


def _together_rows(
    make: RowMaker, predicted: Mapping[str, ObjectScores], scores: Mapping[str, Array], lost: str
) -> list[Result]:
    sets, n = judged_together(predicted, scores), sum(x.size for x in scores.values())
    low, high = sets.expected
    words = f"the model expects {low:.3g} to {high:.3g}; the interval takes objects for independent{lost}"

    def test(metric: str, result: Test, reason: str) -> Result:
        return make.row(metric, result.p_value, n=n, detectable=result.detectable, reason=f"{reason}{lost}")

    rows = [
        make.row(OF_ALL[0], sets.inside, interval=sets.interval, n=n, reason=words),
        test(OF_ALL[1], sets.count, "that so few lie inside, by the model"),
        test(
            OF_ALL[2],
            sets.uniformity,
            "Kolmogorov-Smirnov distance, against sets of objects drawn from the model",
        ),
    ]
    if sets.joint is None:
        why = f"{n} objects; the draws of the model tell the joint distribution of {MOST_JOINED}"
        rows.append(make.skipped(Cause.FEW_PIXELS, why, JOINT))
    else:
        why = "Mahalanobis distance of the normal scores, against draws of the model"
        rows.append(test(JOINT, sets.joint, why))
    if sets.drift is not None:
        why = "against draws of the model"
        rows.append(make.row(TREND, sets.trend, interval=sets.trend_interval, n=n, reason=why))
        rows.append(test(f"{TREND}_p_value", sets.drift, "drift of the normal scores, against draws of the model"))
    if not math.isnan(sets.spread):
        why = "normal scores about their mean, against draws of the model"
        rows.append(make.row(SPREAD, sets.spread, interval=sets.spread_interval, n=n, reason=why))
    return rows


def compare_abundance(
    predicted: Abundance | None,
    observed: Abundance | None,
    *,
    subject: str,
    method: str,
) -> list[Result]:
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
    make = RowMaker("abundance", subject, method)

    def rows(predicted: Abundance, observed: Abundance) -> list[Result]:
        p, o = predicted.area_m2, observed.area_m2
        up, uo = predicted.standard_uncertainty, observed.standard_uncertainty
        # Beside the truth's area the pipeline alone moves the row.
        evidence = None if predicted.modelled else Evidence.PIPELINE
        out = [
            make.row("area_predicted", p, half=Z95 * up, unit="m2", n=predicted.n, evidence=evidence),
            make.row("area_observed", o, half=Z95 * uo, unit="m2", n=observed.n),
        ]
        if p > 0:
            half = Z95 * np.hypot(uo / p, o * up / p**2)
            out.append(make.row("area_ratio", o / p, half=half, n=observed.n, evidence=evidence))
        else:
            out.append(make.skipped(Cause.NOT_POSITIVE, "the predicted area is not positive", "area_ratio"))
        if o > 0:
            half = Z95 * float(difference_ratio_uncertainty(p, o, up, uo))
            ratio = float(difference_ratio(p, o))
            out.append(make.row("area_difference_ratio", ratio, half=half, n=observed.n, evidence=evidence))
        else:
            why = "the observed area is not positive"
            out.append(make.skipped(Cause.NOT_POSITIVE, why, "area_difference_ratio"))
        if observed.nominal_m2 is not None:
            for name, side, spread in (("predicted", predicted, up), ("observed", observed, uo)):
                error = side.area_m2 - observed.nominal_m2
                out.append(make.row(f"area_error_{name}", error, half=Z95 * spread, unit="m2", n=side.n))
            ratio, half = o / observed.nominal_m2, Z95 * uo / observed.nominal_m2
            out.append(make.row("area_nominal_ratio", ratio, half=half, n=observed.n))
            out.append(make.row("area_in_predicted_95", float(abs(p - o) <= Z95 * up), n=observed.n))
        u = float(np.hypot(up, uo))
        if not u > 0:
            why = "neither side states an uncertainty"
            return out + [make.skipped(Cause.NO_UNCERTAINTY, why, m) for m in ("area_z", "area_inside_95")]
        z = (p - o) / u
        return [
            *out,
            make.row("area_z", z, evidence=evidence),
            make.row("area_inside_95", float(abs(z) <= Z95), evidence=evidence),
        ]

    return make.compared(predicted, observed, rows)


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
        rows += [
            make.row("area_bias_observed", bias, half=half, unit="m2", n=n),
            make.row("area_bias_predicted", expected, half=limits, unit="m2", n=n),
            make.row("area_rmse_observed", rmse, interval=(rmse * low, rmse * high), unit="m2", n=n),
            make.row("area_rmse_predicted", float(np.sqrt(np.mean(model**2 + spread**2))), unit="m2", n=n),
        ]
    return rows
