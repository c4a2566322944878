"""The forward model: from a scenario to its products, with their errors, by statistics alone (3.7-3.33).

A row of an error is the change of a product by one standard uncertainty along one direction of one input; draws of the
inputs take its place where their effect is not linear.  Errors of a background's laws that were fitted to pixels of an
image come from leaving out its parts.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import lru_cache, partial
from itertools import chain, islice
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from hyperval.atmosphere import AtmosphericTerms
from hyperval.data import Array, Errors, Index
from hyperval.model import radiance
from hyperval.model.detection import Evaluation, RocKey, class_scores, detect, evaluations
from hyperval.model.inputs import UncertainInput, draw_truths, inputs_of_spectra, spectrum_errors, uncertain_inputs
from hyperval.model.intervals import Z95, jackknife_directions
from hyperval.model.objects import ROWS, Shares, expected_scores, object_scores, shares_of
from hyperval.model.roc import WHOLE, ClassScores, curve_area, detection_at, log_false_alarm, probit
from hyperval.model.stated import Origins, Stated, Truth, state_value
from hyperval.model.world import World, find_path, group_by_files, read_world, with_truths
from hyperval.products import SPECTRA, ExceedanceCurve, PixelDistribution, PredictedProducts, RocCurve, SpectralEstimate
from hyperval.progress import track
from hyperval.scenario import Scenario, Uncertainty
from hyperval.sensor import signal_to_noise
from hyperval.spectra.axis import SpectralAxis
from hyperval.units import RADIANCE_UNIT

Key = tuple[str, ...]
Changes = tuple[Array, Array]  # (D, K) by one standard uncertainty up, and down, along each direction
_CURVES = 2048  # drawn for the limits of a ROC curve
DRAWN_SHIFT = 1.0  # standard deviations: beyond, even parts of directions moved alone do not add up to that of all
_SHIFT = 0.3  # standard deviations by which a mean may be off: 95 % intervals then cover 94 %, and fewer beyond
_PROBIT_ROUNDING = 1e-6  # of a probit: below it a change is rounding
_INNER_PROBIT = 3.0  # shifts are measured within +- this probit of P_D
_EVERY = 16  # of ROWS objects that all truths share each draw of the budget takes every 16th, its neighbours others


def with_pd_limits(roc: Mapping[RocKey, RocCurve], changes: Mapping[Any, Changes]) -> dict[RocKey, RocCurve]:
    """The curves with 95 % intervals of P_D from drawn curves.

    Each draw moves the curve along all directions of all inputs at once, by multiples of its change, in probit, for
    one standard uncertainty up or down.  A ROC curve rises with P_FA; a draw that does not, being extrapolated, is
    sorted, which brings it nearer to any rising curve (Chernozhukov, Fernandez-Val & Galichon, Biometrika 96, 559,
    2009), and so are the limits.

    Parameters
    ----------
    changes : key -> changes (D, K) of probit P_D by one standard uncertainty up, and down, along each direction

    An input without effect, such as an error of another target, does not change the limits:

    >>> pfa, key = np.array([1e-3, 1e-2, 1e-1]), ("plank", "cem", "pixel")
    >>> curve, up = RocCurve(pfa, *(pfa**0.3,) * 3, pfa), np.array([[0.3, 0.2, 0.1], [0.1, 0.2, 0.2]])
    >>> beside = np.insert(up, 1, 1e-13, axis=0)
    >>> each = [with_pd_limits({key: curve}, {key: (moved, -0.5 * moved)})[key].pd_lower for moved in (up, beside)]
    >>> np.array_equal(*each)
    True
    """
    curves = dict(roc)
    for key, (plus, minus) in changes.items():
        if key not in roc or not (np.any(plus) or np.any(minus)):
            continue
        curve, z = roc[key], probit(roc[key].pd)
        size = (plus**2 + minus**2) @ np.exp(-(z**2))  # of the change of P_D
        plus, minus = (change[size >= _PROBIT_ROUNDING**2 * size.max()] for change in (plus, minus))
        c, even = _normal_draws(len(plus)), 0.5 * (plus - minus)
        drawn = np.sort(z + np.maximum(c, 0.0) @ plus + np.maximum(-c, 0.0) @ minus, axis=1)
        # The odd part has limits in closed form; the draws give the difference of all from it.
        half_width, even_draws = Z95 * np.sqrt((even**2).sum(axis=0)), z + c @ even
        (low, high), (even_low, even_high) = interval_limits(drawn), interval_limits(even_draws)
        low, high = (ndtr(np.sort(x)) for x in (low - even_low + z - half_width, high - even_high + z + half_width))
        curves[key] = drawn_curve(curve, (low, high))
    return curves


def mean_shifts(roc: Mapping[RocKey, RocCurve], changes: Mapping[Any, Changes]) -> dict[Any, float]:
    """Greatest shift of the mean of a curve by its errors to second order, in standard deviations of its probit, and
    likewise of the mean of a score.

    Half the sum of the changes up and down, over all directions, is the shift of the mean of draws from the stated
    curve if the effects of directions add up; it limits the validity of one evaluation up and down of each.
    """
    shifts = {}
    for key, (plus, minus) in changes.items():
        in_range = np.abs(probit(roc[key].pd)) < _INNER_PROBIT if key in roc else np.True_
        sd = np.sqrt(((0.5 * (plus - minus)) ** 2).sum(axis=0))
        shown = in_range & (sd > _PROBIT_ROUNDING)
        if shown.any():
            shifts[key] = float(np.max(np.abs(0.5 * (plus + minus).sum(axis=0))[shown] / sd[shown]))
    return shifts


def shift_notes(shifts: Mapping[Any, float], drawn: Collection[Any], samples: int) -> list[str]:
    """Notes on intervals and scores of objects that shifts of the mean make approximate, and on those drawn."""
    named = {key: f"{' '.join(key)} ({shift:.2g})" for key, shift in shifts.items() if shift > _SHIFT}
    by_draws, rough = (", ".join(named[key] for key in named if (key in drawn) is wanted) for wanted in (True, False))
    texts = {
        f"P_D intervals and scores of objects from {samples} draws of the budget, as errors shift the mean (by so many "
        f"standard deviations, if each acted alone): {by_draws}": by_draws,
        "the errors shift the mean of P_D (in standard deviations of its probit, at most) or of scores, which its "
        f"interval holds roughly: {rough}; draw the budget for more: uncertainty: {{method: both}}": rough,
    }
    return [words for words, curves in texts.items() if curves]


def drawn_curve(curve: RocCurve, interval: tuple[Array, Array]) -> RocCurve:
    """A curve with the limits (K,) of drawn curves, itself inside them."""
    low, high = interval
    return replace(curve, pd_lower=np.minimum(low, curve.pd), pd_upper=np.maximum(high, curve.pd))


def interval_limits(draws: Array) -> tuple[Array, Array]:
    """(n,) limits of the 95 % interval of draws (N, n), probabilistically symmetric (JCGM 101:2008, 7.7.2)."""
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return low, high


@lru_cache(maxsize=8)
def _normal_draws(directions: int) -> Array:
    """(N, directions) standard normal numbers, evenly spread (Sobol, scrambled), the same for all curves."""
    from scipy.stats import qmc  # a quarter of a second with what it loads, which a certain scenario does not need

    return np.asarray(ndtri(qmc.Sobol(directions, seed=12).random(_CURVES)))


def joined(parts: Iterable[tuple[Index, Mapping[Any, Array]]], size: int) -> dict[Any, Array]:
    """Values (U, ...) of all truths, in their order, from those (n or 1, ...) of parts of them."""
    values_of_all: dict[Any, Array] = {}
    for index, values in parts:
        for key, value in values.items():
            values_of_all.setdefault(key, np.empty((size, *value.shape[1:])))[index] = value
    return values_of_all


def with_law_errors(prediction: PredictedProducts, e: Evaluation, origins: Origins, truth: Truth) -> PredictedProducts:
    """The prediction with 95 % limits of P_FA where the law was fitted to pixels.

    By a jackknife over the parts of each region that a law was fitted to: ln P_FA (3.33) at the thresholds of the
    curve, (G, K), with the same filters.  The regions are independent: the squares of their directions add up.

    Parameters
    ----------
    e : the scenario as it truly is, its first truth
    """
    scenario, curves = e.scenario, dict(prediction.exceedance)
    if origins.left_out is None or not e.targets or not e.stated.linear_detectors:
        return prediction
    # A part may leave a mixture with fewer components than the class asks for.
    classes = [c.model_copy(update={"mixture": "auto"}) if c.has_mixture else c for c in scenario.scene.classes]
    free = scenario.model_copy(update={"scene": scenario.scene.model_copy(update={"classes": classes})})
    thresholds = {
        (t.name, d): e.scores(t.populations[0].name, d).thresholds(e.pfa[None])[0]
        for t in e.targets for d in e.stated.linear_detectors
    }  # fmt: skip
    log_pfa: dict[tuple[str, str], dict[str, Array]] = {key: {} for key in thresholds}
    for region, replicates in origins.left_out():
        parts = (replace(origins, measured={**(origins.measured or {}), region: part}) for part in replicates)
        worlds = [group_by_files(with_truths(read_world(free, part), [truth]))[0][1] for part in parts]
        laws = [(w.law_fraction, w.law_dof, radiance.retrieve(radiance.scene_light(w), w, e.bands)) for w in worlds]
        for key, x in thresholds.items():
            row, row_filter = np.zeros(x.size, int), e.filters[key][0].rows(e.light_index[:1])
            scores = [ClassScores(fraction, *class_scores(view, row_filter), dof) for fraction, dof, view in laws]
            log_pfa[key][region] = np.array([log_false_alarm(x, s.rows(row))[0] for s in scores])
    for key, regions in log_pfa.items():
        if regions:
            squares = sum((jackknife_directions(rates) ** 2).sum(axis=0) for rates in regions.values())
            half, p = Z95 * np.sqrt(squares)[::-1], curves[key].probability
            limits = p * np.exp(-half), np.minimum(p * np.exp(half), 1.0)
            rising = {region: rates[:, ::-1] for region, rates in regions.items()}
            curves[key] = replace(curves[key], lower=limits[0], upper=limits[1], left_out=rising)
    return replace(prediction, exceedance=curves)


def with_law_limits(curve: RocCurve, alarms: ExceedanceCurve) -> RocCurve:
    """The curve with the limits of P_FA at its thresholds included in those of P_D.

    Where the background has more alarms than the law predicts, the threshold of a P_FA is higher and P_D lower: the
    limits are the curve drawn against those of P_FA, in quadrature with the curve's own, in probit.
    """
    z, low, high = (probit(pd) for pd in (curve.pd, curve.pd_lower, curve.pd_upper))
    # Limits of P_FA rise with it, but need not far in the tail, where the law is uncertain.
    log_lower = np.maximum.accumulate(np.log(alarms.lower[::-1]))
    log_upper = np.minimum.accumulate(np.log(alarms.upper))[::-1]
    log_pfa = np.log(curve.pfa)
    upper = z + np.hypot(high - z, np.maximum(_extrapolate(log_pfa, log_lower, z) - z, 0.0))
    lower = z - np.hypot(z - low, np.maximum(z - _extrapolate(log_pfa, log_upper, z), 0.0))
    return replace(curve, pd_lower=ndtr(np.maximum.accumulate(lower)), pd_upper=ndtr(np.maximum.accumulate(upper)))


def _extrapolate(y: Array, x: Array, z: Array) -> Array:
    """A curve z over x, both rising, at ``y``; beyond its ends with the slope there."""
    low, high = (z[1] - z[0]) / (y[1] - y[0]), (z[-1] - z[-2]) / (y[-1] - y[-2])
    return np.asarray(np.interp(y, x, z) + low * np.minimum(y - x[0], 0.0) + high * np.maximum(y - x[-1], 0.0))


FALSE_ALARMS = (1e-2, 1e-3)  # where predicted P_D is compared
_PROBABILITIES = ("P_D", "AUC")


def product_values(p: PredictedProducts) -> dict[Key, Array]:
    """(product, subject, ...) -> (n,) numbers: bands of spectra, P_D at each of FALSE_ALARMS, scores and areas."""
    numbers: dict[Key, Array] = {}
    for product in SPECTRA:
        for subject, estimate in getattr(p, product).items():
            numbers[product, subject] = estimate.mean
    for (subject, detector), score in p.scores.items():
        numbers["score mean", subject, detector] = np.array([score.mean])
        numbers["score sd", subject, detector] = np.array([score.sd])
    for (subject, detector, unit), curve in p.roc.items():
        numbers["P_D", subject, detector, unit] = detection_at(curve, FALSE_ALARMS)
        numbers["AUC", subject, detector, unit] = np.array([curve_area(curve, WHOLE)])
    return numbers


def product_table(predictions: Iterable[PredictedProducts]) -> dict[Key, Array]:
    """(N, n) :func:`product_values` of N predictions, P_D of curves under ("curve", subject, detector, unit), and those
    of objects, others in each prediction, under ("object", subject, detector).
    """
    rows = [
        product_values(p) | {("curve", *key): curve.pd for key, curve in p.roc.items()}
        | {("object", *key): scores.values[0, n % _EVERY :: _EVERY] for key, scores in p.object_scores.items()}
        for n, p in enumerate(predictions)
    ]  # fmt: skip
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def linear_spread(key: Key, stated: PredictedProducts, moved: Array) -> Array:
    """(3, n) standard uncertainty and limits of the 95 % interval of a product, linearised (JCGM 100:2008, 5.1).

    Spectra have it in ``stated``, with every direction of every input.  For scores and curves it is made of central
    differences, of probabilities in probit.

    ``moved`` : (1 + 2 K, n) as stated, then one standard uncertainty up and down along each direction
    """
    probability = key[0] in _PROBABILITIES
    z = probit(moved) if probability else moved
    if key[0] in SPECTRA:
        sd = getattr(stated, key[0])[key[1]].standard_uncertainty
    else:
        sd = np.sqrt(np.sum(np.square(0.5 * (z[1::2] - z[2::2])), axis=0))
    low, high = z[0] - Z95 * sd, z[0] + Z95 * sd
    if probability:
        low, high = ndtr(low), ndtr(high)
        sd = (high - low) / (2.0 * Z95)
    return np.array([sd, low, high])


def limit_tolerance(u: Array, samples: int) -> Array:
    """(n,) tolerance of a limit: half a unit of the first significant digit of u (JCGM 101:2008, 7.9.2, one digit).

    To it come two standard errors that a 2.5 % quantile of ``samples`` normal draws has: sqrt(p (1 - p) / N) / phi.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        digit = 0.5 * 10.0 ** np.floor(np.log10(u))
    return np.asarray(digit + 2.0 * np.sqrt(0.025 * 0.975 / samples) / 0.058445 * u)


def agreement(key: Key, stated: Array, linear: Array, drawn: Array, samples: int, at: float = np.nan) -> dict[str, Any]:
    """Both propagations compared for one product, ``stated`` (n,): :func:`linear_spread` and that of draws, (3, n).

    Of a spectrum the median over bands, of a ROC one P_FA, ``at``.  ``sd_ratio`` and ``interval_ratio`` are drawn over
    linearised; ``gap`` is the greater difference of the two limits in units of the tolerance: they agree up to 1.
    """
    valid = np.isfinite(linear[0]) & np.isfinite(drawn[0])
    valid &= np.maximum(linear[0], drawn[0]) > 1e-12 * np.abs(stated) + 1e-14
    names, numbers = ("linear_sd", "drawn_sd", "sd_ratio", "interval_ratio", "gap"), [0.0, 0.0, 1.0, 1.0, 0.0]
    if valid.any():
        (u, *linear_ends), (v, *drawn_ends) = linear[:, valid], drawn[:, valid]
        with np.errstate(divide="ignore", invalid="ignore"):
            gap = np.abs(np.subtract(linear_ends, drawn_ends)).max(axis=0) / limit_tolerance(np.maximum(u, v), samples)
            columns = [u, v, v / u, np.subtract(*drawn_ends) / np.subtract(*linear_ends), gap]
        numbers = np.median(columns, axis=1).tolist()
    return {"key": key, "at": at, **dict(zip(names, numbers, strict=True)), "agrees": numbers[-1] <= 1.0}


# Three nodes 0 and +-sqrt(3) standard deviations: those of Gauss and Hermite, exact for moments of a cubic.
_NODE = float(np.sqrt(3.0))


Cost = tuple[int, float, float]  # engine runs, greatest and median relative error of the radiance


def interpolated_world(world: World, inputs: Sequence[UncertainInput]) -> tuple[World, Cost | None]:
    """The world with the engine run at the nodes of every uncertain field of its atmosphere alone, and what it costs.

    Terms are then quadratic in each uncertain field, without cross terms.  The error is that of the radiance over a
    grey ground of reflectance 0.3, in bands with light and with all fields one standard uncertainty off [1]; None
    where nothing of the atmosphere is uncertain.
    """
    stated, nodes, step = world.stated, dict[str, list[float]](), dict[str, float]()
    state, engine = stated.scenario.atmosphere, stated.atmosphere
    for item in inputs:
        room, _, name = item.path.partition(".")
        if room == "atmosphere" and state is not None:
            value = state_value(state, name)
            ends = [float(item.perturbation_along(0, z)[item.path][0]) for z in (-_NODE, _NODE)]
            ends = [end for end in ends if abs(end - value) > 1e-12]  # a node at the end of the range may be the stated
            if ends:
                nodes[name], step[name] = [value, *ends], float(item.perturbation_along(0, 1.0)[item.path][0])
    if not nodes:
        return world, None
    star = replace(engine, nodes=nodes, star=True, cache={})
    guess, truth = star({f"atmosphere.{name}": np.array([x]) for name, x in step.items()}, 1), engine.run(step)
    totals = [t.path_radiance + 0.3 * (t.direct + t.adjacency) / (1 - 0.3 * t.spherical_albedo) for t in (guess, truth)]
    relative = np.abs(totals[0] / totals[1] - 1.0)[..., truth.direct > 1e-3 * truth.direct.max()]
    moved = replace(world, stated=replace(stated, atmosphere=star, cache={}))
    runs = 2 + sum(len(values) - 1 for values in nodes.values())
    return moved, (runs, float(relative.max()), float(np.median(relative)))


def with_intervals(
    stated: PredictedProducts, world: World, inputs: Sequence[UncertainInput], draws: Mapping[Key, Array],
    cost: Cost | None,
) -> PredictedProducts:  # fmt: skip
    """The prediction with intervals from the draws: of P_D where linearisation disagrees, or everywhere.

    With ``method`` "monte-carlo" all curves take the limits of the draws, and the errors of a spectrum are the
    linearised ones times the median over bands of drawn over linearised: the covariance of a few hundred draws, or
    their standard deviation band by band, is too noisy to be inverted in a test.
    With "both" a curve takes the limits of the draws where P_D at 1e-2 or 1e-3 disagrees.
    """
    steps = [item.perturbation_along(k, z) for item in inputs for k in range(item.size) for z in (1.0, -1.0)]
    moved, table, u = product_table(_predictions(world, [{}, *steps])), [], world.stated.scenario.uncertainty
    everywhere = u.method == "monte-carlo"
    for key, values in product_values(stated).items():
        linear = linear_spread(key, stated, moved[key])
        drawn = np.array([draws[key].std(axis=0, ddof=1), *interval_limits(draws[key])])
        parts: Iterable[tuple[Any, float]] = [(slice(None), np.nan)]
        if key[0] == "P_D":  # a curve may begin above
            parts = [(slice(i, i + 1), pfa) for i, pfa in enumerate(FALSE_ALARMS) if np.isfinite(values[i])]
        table += [agreement(key, values[x], linear[:, x], drawn[:, x], u.samples, pfa) for x, pfa in parts]
    differs = {row["key"][1:] for row in table if row["key"][0] == "P_D" and not row["agrees"]}
    roc = {
        key: drawn_curve(curve, interval_limits(draws["curve", *key])) if everywhere or key in differs else curve
        for key, curve in stated.roc.items()
    }
    notes = [_comparison_note(table, u, cost)]
    if not everywhere and differs:
        which = ", ".join(sorted(map(" ".join, differs)))
        notes.append(f"P_D intervals from the draws, where linearisation differs by more than the tolerance: {which}")
    spectra: dict[str, Any] = {}
    for product in SPECTRA if everywhere else ():
        estimates = getattr(stated, product)
        spectra[product] = {s: _widened(e, draws[product, s].std(axis=0, ddof=1)) for s, e in estimates.items()}
    record = {"method": u.method, "samples": u.samples, "seed": u.seed, "agreements": table}
    provenance = {**stated.provenance, "propagation": record}
    return replace(stated, roc=roc, **spectra, notes=(*stated.notes, *notes), provenance=provenance)


def with_uncertainty(
    products: PredictedProducts, world: World, inputs: Sequence[UncertainInput], changes: Mapping[Any, Changes]
) -> PredictedProducts:
    """The prediction of a world with the intervals of its curves, and with scores of its objects: from its directions,
    or from draws of its inputs.

    Parameters
    ----------
    inputs : drawn where the scenario has draws, or where errors shift the mean of P_D, or of a score, by so much
        that the effects of directions do not add up
    changes : of probit P_D, as :func:`with_pd_limits` takes them, and of the mean score of objects' pixels
    """
    stated, u = world.stated, world.stated.scenario.uncertainty
    shifts, table, everything = mean_shifts(products.roc, changes), dict[Key, Array](), u.method != "linear"
    nonlinear = [key for key, shift in shifts.items() if shift > DRAWN_SHIFT]
    if inputs and (nonlinear or everything):
        star_world, cost = interpolated_world(world, inputs)
        truths = track(draw_truths(inputs, u.samples, u.seed), "draws of the budget")
        objects, curves = bool(products.object_scores), everything or any(key[-1] == "object" for key in nonlinear)
        table = product_table(_predictions(star_world, truths, objects * ROWS, curves, everything))
    drawn = {key: table["curve", *key] for key in nonlinear if ("curve", *key) in table and not everything}
    roc: dict[RocKey, RocCurve] = with_pd_limits(products.roc, changes)
    roc |= {key: drawn_curve(products.roc[key], interval_limits(pd)) for key, pd in drawn.items()}
    filters = {p.name: stated.targets[t].name for t, _, p in stated.populations}
    for (population, detector, unit), curve in roc.items():
        alarms = products.exceedance.get((filters[population], detector))
        if alarms is not None and np.any(alarms.upper > alarms.probability):
            roc[population, detector, unit] = with_law_limits(curve, alarms)
    stated_scores = products.object_scores if table else {}
    scores = {key: replace(one, values=table["object", *key]) for key, one in stated_scores.items()}
    notes = (*products.notes, *shift_notes({} if everything else shifts, {*drawn, *scores}, u.samples))
    limited = replace(products, roc=roc, object_scores=scores or products.object_scores, notes=notes)
    return with_intervals(limited, star_world, inputs, table, cost) if everything and inputs else limited


def _widened(estimate: SpectralEstimate, sd: Array) -> SpectralEstimate:
    linear = estimate.standard_uncertainty
    valid = (linear > 0) & np.isfinite(sd)
    factor = float(np.median(sd[valid] / linear[valid])) if valid.any() else 1.0
    budget = {k: v * factor for k, v in estimate.budget.items()}
    return replace(estimate, error_covariance=factor**2 * estimate.error_covariance, budget=budget)


def _comparison_note(table: Sequence[Mapping[str, Any]], u: Uncertainty, cost: Cost | None) -> str:
    ratios: dict[str, list[float]] = {}
    for row in table:
        if np.isfinite(row["sd_ratio"]):
            label = row["key"][0] + ("" if np.isnan(row["at"]) else f" at {row['at']:.0e}")
            ratios.setdefault(label, []).append(row["sd_ratio"])
    text = f"{u.samples} draws of the budget (seed {u.seed}): standard uncertainty over the linearised one: "
    text += ", ".join(f"{k} {min(v):.2f}-{max(v):.2f}" for k, v in ratios.items())
    if cost is not None:
        runs, greatest, median = cost
        text += (
            f"; atmosphere interpolated between {runs} engine runs, radiance within {100 * greatest:.2g} % "
            f"(median {100 * median:.2g} %) with every input of it one standard uncertainty off"
        )
    return text


SpectralErrors = Mapping[tuple[str, str], Mapping[str, Errors]]  # (product, subject) -> source -> its errors
_DIRECTIONS = 32  # directions whose spectra are in memory at once
_ROUNDING = 1e-9  # of an error: smaller effects are rounding
_NOT_IN_SPECTRA = ("dark", "bright", "line_gain", "line_offset", "spread", "tail", "fine_texture")


def without_calibration_error(subject: str) -> str:
    """Name under which ``snr`` holds a subject with C_R left out of (3.20)."""
    return f"{subject} (no calibration error)"


def combined(errors: Mapping[str, Errors], dense: Mapping[str, Array], bands: int) -> tuple[Array, dict[str, Array]]:
    """Error covariance (B, B) and budget from independent sources, some of them as covariances (B, B)."""
    full = {source: np.nan_to_num(c) for source, c in dense.items()}
    budget = {s: e.budget for s, e in errors.items()} | {s: np.sqrt(np.diag(c)) for s, c in full.items()}
    return sum((*(e.covariance for e in errors.values()), *full.values()), np.broadcast_to(0.0, 2 * (bands,))), budget


def reflectances(e: Evaluation) -> dict[str, tuple[Array, Array]]:
    """Subject -> (U or 1, 1, B) equivalent reflectance in the open, and reflectance times sky view, which enters D_B
    (3.10).
    """
    world, scene = e.world, e.scenario.scene
    shares = [object_shares(world, number) for number in range(len(e.stated.populations))]
    light = e.light.rows(e.light_index)
    means = {name: world.mean[:, number : number + 1] for number, name in enumerate(e.stated.names["surface"])}
    surfaces = {s.name: 2 * (means[s.name],) for s in (*scene.classes, *scene.panels, *scene.sites)}
    full = {t.name: radiance.target_light(world, light, number)[:2] for number, t in enumerate(scene.targets)}
    for (t, _, population), fills, placed in zip(e.stated.populations, world.pixel_fills, shares, strict=True):
        host = means[scene.targets[t].host]
        parts = {scene.targets[t].name: (fills.weights * fills.values).sum(axis=1)}
        if placed is not None:
            parts = {name: np.array([s.expected_share(name) for s in placed[0]])[placed[1]] for name in full}
        lit_parts = [(part[:, None, None], full[name]) for name, part in parts.items() if part.any()]
        pixel, sky = tuple(host + sum(f * (target[k] - host) for f, target in lit_parts) for k in (0, 1))  # (3.10)
        surfaces[population.name] = pixel, sky
    return surfaces


def object_shares(world: World, number: int) -> tuple[list[Shares], Index] | None:
    """The distinct shares of an object's pixels at its place, and the number (U,) of those of each truth; None without
    a place, or in the printed form.

    Its neighbours have the fills of the same truth, whatever truths are evaluated with it:

    >>> from hyperval.scenario import load_scenario
    >>> from hyperval.model import with_values
    >>> square = {"geometry": {"side_m": 1.0, "gsd_m": 1.0, "psf_fwhm_pixels": 1.0, "pixels": "ranked", "n": 9}}
    >>> two = [{"name": name, "position_m": [0.0, x], "fill": square} for name, x in (("one", 0.0), ("two", 1.5))]
    >>> world = read_world(load_scenario("yellow-planks-asphalt").with_values({"scene.targets.0.subjects": two}))
    >>> (alone,), _ = object_shares(with_values(world, {"fill.two": np.array([[0.3]])}), 0)
    >>> (_, beside), _ = object_shares(with_values(world, {"fill.two": np.array([[0.5], [0.3]])}), 0)
    >>> bool(np.all(alone.mean == beside.mean))
    True
    """
    stated, scenario = world.stated, world.stated.scenario
    population, position = stated.populations[number][2], scenario.uncertainty.position_m
    if scenario.formulation == "thesis" or population.fill.geometry is None or population.position_m is None:
        return None
    by_truth, which = world.populations
    return [shares_of(*subjects[number], subjects, position, scenario.processing.seed) for subjects in by_truth], which


def mean_spectra(e: Evaluation) -> dict[tuple[str, str], Array]:
    """(product, subject) -> (U or 1, B) mean spectra of all truths (3.7-3.20)."""
    names, spectra = e.stated.names, dict[tuple[str, str], Array]()
    without_c_r = {name: without_calibration_error(name) for name in names["surface"] if name not in names["target"]}
    surfaces, light = e.cached("reflectances", partial(reflectances, e)), e.light.rows(e.light_index)
    for name, (rho, _) in surfaces.items():
        level = light.signal(rho)
        if not light.radiant or light.elm is not None:
            # Errors of the empirical line belong to measured reflectance, not to the predicted one.
            spectra["reflectance", name] = radiance.retrieved_reflectance(light.library_line, level)[:, 0]
        if light.radiant:
            spectra["radiance", name] = level[:, 0]
            white = light.terms.diffuser_radiance
            if white is not None and e.stated.is_of_space:
                spectra["toa_reflectance", name] = radiance.toa_reflectance(level, white)[:, 0]
            if light.noise is not None and name in without_c_r:
                parts = e.cached(("noise", name), partial(light.noise.breakdown, level))
                for key, variance in ((name, parts.total), (without_c_r[name], parts.detector)):
                    spectra["snr", key] = signal_to_noise(level, variance)[:, 0]
    return spectra


def spread_scales(e: Evaluation) -> dict[tuple[str, str], Array]:
    """Scales of the spread from pixel to pixel, (U or 1, B): ("signal", product) -> logarithm of the change of the
    signal per reflectance (D_A of 3.11); ("noise", subject) -> noise as a variance of reflectance.

    Noise in covariances measured on the image does not change with the model's.
    """
    light, names, images = e.light.rows(e.light_index), e.stated.names["surface"], e.stated.of_pixels
    image_surfaces = {name for name, of_image in zip(names, images, strict=True) if of_image}
    hosts = {population.name: e.stated.targets[t].host for t, _, population in e.stated.populations}
    surfaces, slope = e.cached("reflectances", partial(reflectances, e)), light.direct_slope()
    with np.errstate(divide="ignore", invalid="ignore"):
        scales = {"radiance": slope, "reflectance": slope / light.library_line.gain}
        scales_by_key = {("signal", product): np.log(scale)[:, 0] for product, scale in scales.items()}
        for name, (rho, _) in surfaces.items():
            if light.noise is not None and hosts.get(name, name) not in image_surfaces:
                parts = e.cached(("noise", name), partial(light.noise.breakdown, light.signal(rho)))
                scales_by_key["noise", name] = (parts.total / slope**2)[:, 0]
    return scales_by_key


def spectral_errors(world: World, inputs: Iterable[UncertainInput]) -> SpectralErrors:
    """Errors of the mean spectra of one truth, and of :func:`spread_scales`: half the difference of up and down along
    each direction of each input, the rest held.
    """
    errors: dict[tuple[str, str], dict[str, Errors]] = {}
    day = str(state.time_utc or "")[:10] if (state := world.stated.scenario.atmosphere) else ""
    for number, item in enumerate(inputs):
        if find_path(world.stated, item.path).field in _NOT_IN_SPECTRA:
            continue
        least = _ROUNDING * float(np.abs(item.rows).max(initial=0.0))
        source = "field spectrum" if item.subject and item.kind == "surface" else item.name
        size, unit = item.scale  # without light what is recorded is reflectance
        scale = size, unit if state else unit.replace(RADIANCE_UNIT, ""), day * item.path.startswith("atmosphere.")
        for start in range(0, len(item.rows), _DIRECTIONS):
            chunk = range(start, min(start + _DIRECTIONS, len(item.rows)))
            moved = with_truths(world, [item.perturbation_along(k, z) for z in (1.0, -1.0) for k in chunk])
            parts = ((index, Evaluation(part)) for index, part in group_by_files(moved))
            moved_values = joined(((index, mean_spectra(e) | spread_scales(e)) for index, e in parts), moved.size)
            for key, values in moved_values.items():
                rows = 0.5 * (values[: len(chunk)] - values[len(chunk) :])
                if item.kind == "engine" and key[0] == "reflectance":  # the empirical line cancels it
                    continue
                if item.subject and not np.nanmax(np.abs(rows), initial=0.0) > least:
                    continue
                by_source = errors.setdefault(key, {})
                # Signal and noise go by the same directions: those of one step have one name.
                name = source if key[0] in SPECTRA else f"{number:05} {start:05}"
                earlier = by_source[name].rows if name in by_source else rows[:0]
                by_source[name] = Errors(np.concatenate([earlier, np.nan_to_num(rows)]), np.inf, *scale)
    return {key: {name: e for name, e in by_source.items() if e.rows.any()} for key, by_source in errors.items()}


def spectral_prediction(e: Evaluation, u: int, errors: SpectralErrors | None) -> PredictedProducts:
    """All spectra of one truth with their errors (3.7-3.20); scores and curves come later (:func:`detect`).

    ``errors`` : None: mean spectra alone, whose matrices are 0
    """
    stated, world, v = e.stated, e.world.rows(np.array([u])), int(e.light_index[u])
    data: dict[str, Any] = {p: {} for p in ("radiance", "snr", "reflectance", "toa_reflectance", "noise", "full_scale")}
    bands, populations = len(e.axis), [p.name for _, _, p in stated.populations]
    means = {key: radiance.truth_row(values, u) for key, values in e.cached("spectra", lambda: mean_spectra(e)).items()}
    surfaces = e.cached("reflectances", partial(reflectances, e))
    light = e.light.row(v)
    terms = light.terms if light.radiant else None
    notes = [f"formulation: {e.scenario.formulation}", *(terms.notes if terms else ()), *stated.notes]
    if not e.scenario.uncertainty.model_dump(exclude_defaults=True):
        notes.append("the scenario states no uncertainty: intervals and tests contain little but the collection's own")
    levels = {name: light.signal(radiance.truth_row(rho, u)[0]) for name, (rho, _) in surfaces.items()}
    if light.radiant and light.noise is not None:
        if light.noise.full_scale is not None:
            data["full_scale"] = {name: light.noise.full_scale_fraction(level) for name, level in levels.items()}
        data["noise"] = {n: asdict(light.noise.breakdown(x)) for n, x in levels.items() if n not in populations}
        notes += saturation_notes(data["full_scale"], e.axis)
    data["distribution"] = {name: _distribution(world, m) for m, name in enumerate(stated.classes)}
    data |= {"notes": tuple(notes), "provenance": provenance_of(stated, terms)}
    spreads = {} if errors is None else pixel_spreads(e, u, levels)
    for (product, key), mean in means.items():
        pixel, shapes = spreads.get((product, key), (None, {}))
        sources = (errors or {}).get((product, key), {})
        total, budget = combined(sources, shapes, bands)
        if pixel is not None and np.isnan(np.sum(pixel)):  # the check is faster than a copy
            pixel = np.nan_to_num(pixel)
        sources = {} if product == "snr" else sources
        spread = spread_errors(errors, light, product, key) if errors and product in ("radiance", "reflectance") else []
        if (gain := sources.get("compensation (gain)")) is not None:  # of an image: it stretches the spread as the mean
            spread.append(np.stack([gain.rows / mean, 0.0 * gain.rows]))
        moved = np.concatenate(spread, axis=1) if spread else None
        data[product][key] = SpectralEstimate(mean, total, pixel, None, budget, errors=sources, spread_errors=moved)
    return PredictedProducts(e.axis, **data)


def spread_errors(errors: SpectralErrors, light: radiance.Light, product: str, subject: str) -> list[Array]:
    """(2, K, B) errors by each chunk of directions: relative ones of a band's standard deviation, and of its noise.

    >>> from hyperval.api import load_scenario
    >>> made = predict(load_scenario("green-planks-grass").with_values(
    ...     {"uncertainty.noise": {"relative": 0.1}, "atmosphere.engine": "emulator"}))
    >>> pair = made.radiance["grass"], made.reflectance["grass"]
    >>> ground, line = (side.spread_errors[1, 0] / np.diag(side.pixel_covariance) for side in pair)
    >>> bool(np.allclose(ground, line, rtol=1e-9) and np.median(np.abs(ground)) > 1e-4)
    True
    """
    pair = [errors.get(key, {}) for key in (("signal", product), ("noise", subject))]
    scale = light.direct_slope() / (1.0 if product == "radiance" else light.library_line.gain)
    steps = ([entries[step].rows if step in entries else 0.0 for entries in pair] for step in sorted(set(chain(*pair))))
    return [np.stack(np.broadcast_arrays(signal, noise * scale**2)) for signal, noise in steps]


Spread = tuple[Array, Mapping[str, Array]]
# Covariance (B, B) of pixels with its gain, the gain, errors (B, B) of the mean of one object at its place by source,
# and the surfaces in that covariance, with their factors.
Spreading = tuple[Array, float, Mapping[str, Array], Mapping[str, float]]


def pixel_spreads(e: Evaluation, u: int, levels: Mapping[str, Array]) -> dict[tuple[str, str], Spread]:
    """(product, subject) -> covariance of the pixels of one truth (3.11, 3.12), and of the mean of an object at its
    place by source, (B, B) each.

    ``levels`` : subject -> (B,) mean signal
    """
    world, v, bands = e.world.rows(np.array([u])), int(e.light_index[u]), np.arange(len(e.axis))
    populations = [p.name for _, _, p in e.stated.populations]
    light, row = e.light.row(v), e.light.rows(np.array([v]))
    full = {o.name: radiance.target_light(world, row, i)[0][0, 0] for i, o in enumerate(e.stated.targets)}
    pixels = {
        name: _mixed(world, row, full, populations.index(name)) if name in populations else _spreading(world, name)
        for name in levels
    }
    pure = {**levels, **{name: light.signal(reflectance) for name, reflectance in full.items()}}
    average = radiance.Background.from_world(e.light_world, bands).covariance(v)
    spreads, line, slope = dict[tuple[str, str], Spread](), light.library_line, light.direct_slope()
    for name, (_, sky) in e.cached("reflectances", partial(reflectances, e)).items():
        covariance, gain, errors, parts = pixels[name]
        # The covariance of pixels of the image holds their noise.
        image = [s for s in parts if e.stated.of_pixels[world.surface_number(s)]]
        noise = light.noise_variance(levels[name]) - sum(parts[s] * light.noise_variance(pure[s]) for s in image)
        at_sensor = light.pixel_covariance(noise, radiance.truth_row(sky, u)[0], covariance, average, gain)  # (3.11)
        signal = {source: c * np.outer(slope, slope) for source, c in errors.items()}  # by the slope of the pixel
        retrieved = {source: radiance.retrieved_covariance(line, c) for source, c in signal.items()}
        spreads["radiance", name] = at_sensor, signal
        spreads["reflectance", name] = radiance.retrieved_covariance(line, at_sensor), retrieved
    return spreads


def _spreading(world: World, name: str) -> Spreading:
    """The spreading of a surface in one truth; its gain is g_m for a class, else 1."""
    classes, stretch = world.stated.classes, world.stretch[0, world.surface_number(name)]
    gain = float(world.column("class_gain")[0, classes.index(name)]) if name in classes else 1.0
    factor = gain * (stretch[0] ** 2 if stretch.size == 1 else np.outer(stretch, stretch))  # g_m of (3.11)
    covariance = world.stated.surfaces[name].covariance
    return covariance if np.all(factor == 1.0) else factor * covariance, gain, {}, {name: 1.0}


def _mixed(world: World, light: radiance.Light, full: Mapping[str, Array], number: int) -> Spreading:
    """The spreading of target pixels of one population (3.10, 3.12), with factors E[f^2] and E[(1 - f)^2]."""
    stated, t = world.stated, world.stated.populations[number][0]
    target = stated.targets[t]
    shade = radiance.target_light(world, light, t)[2].ravel()
    spread = _spreading(world, target.name)[0] * np.outer(shade, shade)
    host, (host_spread, gain, *_) = world.mean[0, world.surface_number(target.host)], _spreading(world, target.host)
    fills, fine = world.pixel_fills[number], world.column("fine_texture")[0, world.surface_number(target.name)]
    of_target, of_host = radiance.fill_squares(fills.mean, fills.variance, fine)
    covariance = radiance.target_pixel_covariance(
        fills.mean, fills.variance, full[target.name], spread, host, host_spread,
        target_gain=float(world.column("target_gain")[0, t]), fine_texture=fine,
    )  # fmt: skip
    errors = shares[0][shares[1][0]].errors(full, host, host_spread) if (shares := object_shares(world, number)) else {}
    return covariance, gain, errors, {target.host: of_host, target.name: of_target}


def saturation_notes(full_scale: Mapping[str, Array], axis: SpectralAxis) -> list[str]:
    """One note for each subject whose mean radiance passes full scale."""
    return [
        f"warning: SATURATION: {subject} passes full scale in {np.sum(part > 1.0)} bands, at most "
        f"{np.nanmax(part):.2f} of it at {axis.centre_nm[np.nanargmax(part)]:g} nm"
        for subject, part in full_scale.items() if np.any(part > 1.0)
    ]  # fmt: skip


def provenance_of(stated: Stated, terms: AtmosphericTerms | None) -> dict[str, object]:
    """Provenance of the numbers of a prediction."""
    scenario, sensor = stated.scenario, stated.sensor
    record: dict[str, object] = {
        "scenario": scenario.name,
        "formulation": scenario.formulation,
        "atmosphere": terms.provenance if terms else None,
        "sensor": {"name": sensor.name, "source": sensor.specification.source} if sensor else None,
        "spectra": {name: s.source for name, s in stated.surfaces.items()},
    }
    if scenario.atmosphere is not None and scenario.atmosphere.time_utc is not None:
        record["time_utc"] = scenario.atmosphere.time_utc
    stated_run = {"sensor_operation": scenario.sensor_operation, "sensor_changes": scenario.sensor_changes}
    return record | {name: part.model_dump(mode="json") for name, part in stated_run.items() if part is not None}


_BATCH = 16  # truths evaluated at once: their matrices and products are in memory together


def predict(
    scenario: Scenario,
    origins: Origins | None = None,
    *,
    truth: Truth | None = None,
    objects: bool | int = False,
    object_curves: bool = True,
) -> PredictedProducts:
    """Predict radiance, SNR, reflectance, detector scores and ROC of a scenario (3.7-3.33).

    Parameters
    ----------
    scenario : what to predict
    origins : bands, measured statistics, files, engine and sensor where they are not those of the scenario
    truth : dotted path -> true value (:data:`hyperval.model.PATHS`); None: all as stated
    objects : also draw the scores of whole objects, which takes a few seconds where there are many; a number is
        that of draws where no input is uncertain
    object_curves : also the ROC curves of whole objects, half of the time where there are many targets

    Returns
    -------
    Prediction.  Subjects of ``radiance`` and ``reflectance`` are classes, panels, sites and target
    populations; ``snr`` holds each class, panel and site twice, with C_R and under
    :func:`without_calibration_error`.  In the reflectance domain there is no radiance and no SNR.
    A shifted spectrometer is labelled by its nominal bands.

    Raises
    ------
    UsageError : a scenario that contradicts itself, or a covariance that cannot be inverted.
    InputError : a file that is missing or corrupt.
    EngineError : the atmosphere engine failed.
    """
    source = origins or Origins()
    world = group_by_files(with_truths(read_world(scenario, source), [truth or {}]))[0][1]
    world = replace(world, stated=replace(world.stated, reread_from=None))
    inputs = uncertain_inputs(world)
    of_spectra = spectral_errors(world, [*inputs, *inputs_of_spectra(world)])
    products, changes = _prediction(world, of_spectra, inputs, objects, object_curves, source, truth or {})
    return with_uncertainty(products, world, inputs if truth is None else [], changes)


def predictions(
    scenario: Scenario,
    truths: Iterable[Truth],
    origins: Origins | None = None,
    *,
    objects: bool | int = False,
    object_curves: bool = True,
) -> Iterator[PredictedProducts]:
    """Predictions of perturbed truths, in their order, without error budgets.

    Spectra are read once; truths are evaluated together.  Mean spectra, moments of scores, and curves alone: densities
    of scores would take a good part of the time, matrices (B, B) most of it, and a hundred times the memory.

    Parameters
    ----------
    truths : dotted path -> true value (:data:`hyperval.model.PATHS`), of each
    """
    return _predictions(read_world(scenario, origins), truths, objects, object_curves)


def _predictions(
    world: World, truths: Iterable[Truth], objects: bool | int = False, object_curves: bool = True, spectra: bool = True
) -> Iterator[PredictedProducts]:
    position = world.stated.scenario.uncertainty.position_m  # in which each object differs, whatever the truth
    certain = world.stated.scenario.model_copy(update={"uncertainty": Uncertainty(position_m=position)})
    world, remaining = replace(world, stated=replace(world.stated, scenario=certain, cache={})), iter(truths)
    while batch := list(islice(remaining, _BATCH)):
        by_number: dict[int, PredictedProducts] = {}
        for index, e in evaluations(with_truths(world, batch)):
            of_spectra = [spectral_prediction(e, u, None) for u in range(len(e) if spectra else 0)]
            detected = detect(e, object_curves=object_curves, densities=False, points=range(len(e)), spectra=of_spectra)
            for u, (number, prediction) in enumerate(zip(index.tolist(), detected, strict=True)):
                if objects and prediction.roc:
                    arguments = e.world, [(np.arange(len(e)), e)], np.array([u])
                    scores = object_scores(*arguments, None if objects is True else objects)
                    prediction = replace(prediction, object_scores=scores)
                by_number[number] = prediction
        yield from (by_number[number] for number in range(len(batch)))


def _prediction(
    world: World, of_spectra: SpectralErrors, inputs: Sequence[UncertainInput], objects: bool | int,
    object_curves: bool, origins: Origins, truth: Truth,
) -> tuple[PredictedProducts, dict[Any, Changes]]:  # fmt: skip
    """One truth, and the changes of probit P_D, and of the mean score of objects' pixels, by one standard uncertainty
    up and down, for each direction of each input; of the targets' field spectra for the one along their filter.

    Errors of scores are to second order, as haze is not linear in visibility.

    >>> from hyperval.api import load_scenario
    >>> changes = {"atmosphere.engine": "emulator", "uncertainty.meteorological_range_km": 4.0}
    >>> hazy, key = load_scenario("green-planks-grass").with_values(changes), ("green plank 0.1", "cem")
    >>> truths = [{"atmosphere.meteorological_range_km": 23.0 + 4.0 * ndtri((i + 0.5) / 40)} for i in range(40)]
    >>> drawn = [p.scores[key].sd for p in predictions(hazy, truths, object_curves=False)]
    >>> stated = predict(hazy, object_curves=False).scores[key]
    >>> bool(abs(np.std(drawn) / (stated.sd_error * stated.sd) - 1.0) < 0.08)  # without that order 1.14
    True
    """
    stated, errors = world.stated, spectrum_errors(inputs)
    # Light comes first, then the direction along the filters: draws take their columns in the order of the inputs.
    is_lit = stated.scenario.atmosphere is not None
    light = [i for i in inputs if is_lit and i.is_light and i.kind != "engine"]
    # The empirical line cancels errors of the engine; those of a target's spectrum act along its filter.
    scene = [i for i in inputs if not (is_lit and i.is_light) and (i.subject in stated.classes or i.kind != "surface")]
    scene.sort(key=lambda i: not i.subject)
    light_moves, scene_moves = ([(i, k) for i in group for k in range(i.size)] for group in (light, scene))
    moves = [*light_moves, *([None] if any(t.name in errors for t in stated.targets) else []), *scene_moves]
    signed = [(move, z) for z in (1.0, -1.0) for move in moves]
    truths = [{}, *({} if move is None else move[0].perturbation_along(move[1], z) for move, z in signed)]
    worlds = with_truths(world, truths)
    parts = evaluations(worlds, errors, np.array([0.0, *(z * (move is None) for move, z in signed)]))
    e = parts[0][1]
    prediction = detect(e, object_curves=object_curves, spectra=[spectral_prediction(e, 0, of_spectra)])[0]
    for _, part in parts[1:]:
        detect(part, object_curves=object_curves)
    if prediction.roc:
        if objects:
            scores = object_scores(worlds, parts, np.arange(worlds.size), None if objects is True else objects)
            prediction = replace(prediction, object_scores=scores, expected_scores=expected_scores(e))
        prediction = with_law_errors(prediction, e, origins, truth)
    z: dict[Any, Array] = joined(((index, part.probits) for index, part in parts), worlds.size)
    plus, minus = slice(1, len(moves) + 1), slice(len(moves) + 1, None)
    moments = dict(prediction.scores)
    for key, x in joined(((index, part.moments) for index, part in parts if moves), worlds.size).items():
        odd, even = x[plus] - x[minus], x[plus] + x[minus] - 2.0 * x[0]
        mean, sd = np.sqrt((0.25 * odd**2 + 0.5 * even**2).sum(axis=0)).tolist()  # JCGM 100:2008, 5.1.2, note
        moments[key] = replace(moments[key], mean_error=mean, sd_error=sd / max(moments[key].sd, 1e-300))
        z |= {key: x[:, :1]} if key in prediction.object_scores else {}
    return replace(prediction, scores=moments), {key: (x[plus] - x[0], x[minus] - x[0]) for key, x in z.items()}


def _distribution(world: World, number: int) -> PixelDistribution:
    """Distribution of the pixels of a class about their mean."""
    stated = world.stated
    name, tail = stated.classes[number], float(world.column("tail")[0, number])
    parts = stated.surfaces[name].components
    if parts is None:
        return PixelDistribution(tail)
    stretch = world.stretch[0, world.surface_number(name)]
    clusters_of = parts.stretched(stretch * math.sqrt(float(world.column("class_gain")[0, number])))
    dof = [float(world.law_dof[0, j]) for j, law in enumerate(stated.laws) if law.owner == number]
    clusters = zip(clusters_of.weights.tolist(), clusters_of.offsets, clusters_of.covariances, dof, strict=True)
    return PixelDistribution(tail, clusters=tuple(clusters))
