"""What uncertain inputs do to the products: along directions, by draws, and how the two ways compare.

Every row of an error is the change of a product by one standard uncertainty along one direction of one input.
Errors of the background's laws, where they were fitted to pixels of an image, come by leaving out its parts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.terms import InterpolatedTerms, interpolated_terms
from hyperval.data import LINEAR_DETECTORS
from hyperval.errors import UsageError
from hyperval.model.detection import Evaluation
from hyperval.model.inputs import UncertainInput, drawn_truths
from hyperval.model.intervals import Z95, jackknife_directions
from hyperval.model.radiance import Background, light_of, seen_classes
from hyperval.model.roc import WHOLE, ClassScores, curve_area, detection_at, false_alarm_grid, log_false_alarm
from hyperval.model.scores import class_scores
from hyperval.model.world import Origins, Truth, World, read, settled, state_entries, state_value, with_truths
from hyperval.products import ExceedanceCurve, PredictedProducts, RocCurve, SpectralEstimate
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.settings import with_settings
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Key = tuple[str, ...]
RocKey = tuple[str, str, str]
Change = tuple[Array, Array]  # by one standard uncertainty up, and down
_CURVES = 2048  # drawn for the limits of a ROC curve
DRAWN_SHIFT = 1.0  # standard deviations: beyond, even parts of directions moved alone do not add up to that of all
_SHIFT = 0.3  # of a standard deviation: 95 % intervals that are off by it hold 94 %, and ever fewer beyond
_SEEN = 1e-6  # of a probit: below it a change is rounding
_INNER = 3.0  # probits of P_D between which it is looked for


def combined(
    changes: Sequence[tuple[str, Array]], covariances: Mapping[str, Array], bands: int
) -> tuple[Array, dict[str, Array]]:
    """Error covariance (B, B) and budget from independent sources.

    Parameters
    ----------
    changes : sources with their (B,) changes per standard uncertainty, fully correlated between bands; a source of
        several directions stands once for each
    covariances : source -> (B, B)
    """
    budget: dict[str, Array] = {}
    if not changes and not covariances:
        return _nothing(bands), budget
    total = np.zeros((bands, bands))
    if changes:
        rows = np.nan_to_num(np.stack([change for _, change in changes]))
        total += rows.T @ rows
        for source, d in zip((name for name, _ in changes), rows, strict=True):
            budget[source] = np.hypot(budget[source], d) if source in budget else np.abs(d)
    for source, covariance in covariances.items():
        c = known(covariance)
        total += c
        budget[source] = np.sqrt(np.diag(c))
    return total, budget


def known(covariance: Array) -> Array:
    """The matrix with 0 where nothing is known; unchanged, and not copied, where all is."""
    return covariance if np.isfinite(np.sum(covariance)) else np.nan_to_num(covariance)


@lru_cache(maxsize=8)
def _nothing(bands: int) -> Array:
    """Zeros (B, B) that all estimates without an error share; not to be written to."""
    zero = np.zeros((bands, bands))
    zero.setflags(write=False)
    return zero


def with_bands(roc: Mapping[RocKey, RocCurve], changes: Mapping[RocKey, Sequence[Change]]) -> dict[RocKey, RocCurve]:
    """The curves with 95 % intervals of P_D from drawn curves.

    Each draw moves a whole curve along all directions of all inputs at once: by as many times the change that one
    standard uncertainty up or down makes of it, in probit.  A ROC curve rises with P_FA; a draw that does not,
    being extrapolated, is put in rising order, which brings it nearer to any curve that rises (Chernozhukov,
    Fernandez-Val & Galichon, Biometrika 96, 559, 2009), and so are the limits.

    Parameters
    ----------
    changes : key -> for each direction the changes (K,) of probit P_D by one standard uncertainty up and down
    """
    return {key: _with_limits(curve, changes.get(key, ())) for key, curve in roc.items()}


def mean_shifts(roc: Mapping[RocKey, RocCurve], changes: Mapping[RocKey, Sequence[Change]]) -> dict[RocKey, float]:
    """How far both signs of the errors move a curve the same way, in standard deviations of its probit, at most.

    Half the sum of the changes up and down, over all directions, is by how much the mean of draws would be off the
    stated curve if the directions did not hold each other back; it says how far one evaluation up and down of each
    can be trusted.
    """
    shifts = {}
    for key, pairs in changes.items():
        up, down = (np.array([pair[i] for pair in pairs]) for i in (0, 1))
        inner = np.abs(probit(roc[key].pd)) < _INNER
        sd = np.sqrt(((0.5 * (up - down)) ** 2).sum(axis=0))[inner] if pairs else np.zeros(0)
        if np.any(sd > _SEEN):
            shift = np.abs(0.5 * (up + down).sum(axis=0))[inner]
            shifts[key] = float(np.max(shift[sd > _SEEN] / sd[sd > _SEEN]))
    return shifts


def shift_notes(shifts: Mapping[RocKey, float], drawn: Collection[RocKey], samples: int) -> list[str]:
    """Words for intervals that shifts of the mean make rough, and for those that are drawn for it."""
    named = {key: f"{' '.join(key)} ({shift:.2g})" for key, shift in shifts.items() if shift > _SHIFT}
    rough = [name for key, name in named.items() if key not in drawn]
    notes = []
    if drawn:
        notes.append(
            f"P_D intervals from {samples} draws of the budget, as errors shift the mean by more than its standard "
            f"deviation, or would if each came alone: {', '.join(named[key] for key in drawn)}"
        )
    if rough:
        notes.append(
            "the errors shift the mean of P_D (in standard deviations of its probit, at most), which its interval "
            f"holds roughly: {', '.join(rough)}; draw the budget for more: uncertainty: {{method: both}}"
        )
    return notes


def _with_limits(curve: RocCurve, changes: Sequence[Change]) -> RocCurve:
    if not any(np.any(part) for pair in changes for part in pair):
        return curve
    up, down = (np.array([pair[i] for pair in changes]) for i in (0, 1))
    c = _normal_draws(len(changes))
    z, even = probit(curve.pd), 0.5 * (up - down)
    drawn = np.sort(z + np.maximum(c, 0.0) @ up + np.maximum(-c, 0.0) @ down, axis=1)
    # The even part has its limits in closed form: the draws say by how much the whole differs from it.
    half, plain = Z95 * np.sqrt((even**2).sum(axis=0)), z + c @ even
    (low, high), (even_low, even_high) = (np.quantile(x, [0.025, 0.975], axis=0) for x in (drawn, plain))
    low, high = (ndtr(np.sort(x)) for x in (low - even_low + z - half, high - even_high + z + half))
    return replace(curve, pd_lower=np.minimum(low, curve.pd), pd_upper=np.maximum(high, curve.pd))


@lru_cache(maxsize=8)
def _normal_draws(directions: int) -> Array:
    """(N, directions) standard normal numbers, evenly spread (Sobol, scrambled), the same for all curves."""
    from scipy.stats import qmc  # a quarter of a second with what it loads, which a certain scenario does not need

    draws = np.asarray(ndtri(qmc.Sobol(directions, seed=12).random(_CURVES)))
    draws.setflags(write=False)
    return draws


def probit(p: Array) -> Array:
    """Phi^-1 of probabilities, kept finite."""
    return np.asarray(ndtri(np.clip(p, 1e-300, 1.0 - 1e-16)))


Filter = tuple[str, str]


def worlds_without(scenario: Scenario, origins: Origins, truth: Truth) -> Iterable[Sequence[World]]:
    """For each region whose law is known from its pixels, the scenario as it truly is without each part of them."""
    if origins.left_out is None or not scenario.scene.targets or not _linear(scenario):
        return
    # A part may leave a mixture with fewer components than the class asks for.
    classes = [c.model_copy(update={"mixture": "auto"}) if c.has_mixture else c for c in scenario.scene.classes]
    free = scenario.model_copy(update={"scene": scenario.scene.model_copy(update={"classes": classes})})
    for region, without in origins.left_out():
        measured = origins.measured or {}
        parts = (read(free, replace(origins, measured={**measured, region: part})) for part in without)
        yield [settled(with_truths(world, [truth]))[0][1] for world in parts]


def law_directions(e: Evaluation, regions: Iterable[Sequence[World]]) -> dict[Filter, Array]:
    """(target, linear detector) -> (D, K) changes of ln P_FA (3.33) at the thresholds of its curve.

    One for each part of each region, independent of each other; the square root of the sum of their squares is the
    standard error that the pixels leave.  The filters stay: they look at both sides through the same weights.

    Parameters
    ----------
    e : the scenario as it truly is, its first truth
    """
    grid = e.scenario.processing.false_alarm_grid
    pfa = false_alarm_grid(grid.lowest, grid.per_decade)
    names = [(t, d) for t in e.targets for d in _linear(e.scenario)]
    thresholds = {(t.name, d): e.scores(t.populations[0].name, d).thresholds(pfa[None])[0] for t, d in names}
    directions: dict[Filter, list[Array]] = {key: [] for key in thresholds}
    for region in regions:
        values: dict[Filter, list[Array]] = {key: [] for key in thresholds}
        for world in region:
            laws = _law_scores(e, world)
            for key, x in thresholds.items():
                rows = laws[key].rows(np.zeros(x.size, int))
                values[key].append(log_false_alarm(x, rows)[0])
        for key, each in values.items():
            directions[key].append(jackknife_directions(each))
    return {key: np.concatenate(parts) for key, parts in directions.items() if parts}


def _law_scores(e: Evaluation, world: World) -> dict[Filter, ClassScores]:
    """Scores of the background's laws of another world by the filters of the first truth of an evaluation."""
    of = Background.of(world, e.bands)
    seen, own = seen_classes(light_of(world).at(e.bands), of), e.which[:1]
    fraction, dof = np.atleast_2d(world.law_fraction), np.atleast_2d(world.law_dof)
    return {
        key: ClassScores(fraction, *class_scores(of, seen, f.rows(own)), dof) for key, (f, _, _) in e.filters.items()
    }


def with_law_errors(
    exceedance: Mapping[Filter, ExceedanceCurve], directions: Mapping[Filter, Array]
) -> dict[Filter, ExceedanceCurve]:
    """The predicted curves, with 95 % limits where the law was fitted to pixels."""
    curves = dict(exceedance)
    for key, of_curve in directions.items():
        half, p = Z95 * np.sqrt((of_curve**2).sum(axis=0))[::-1], curves[key].probability
        curves[key] = replace(curves[key], lower=p * np.exp(-half), upper=np.minimum(p * np.exp(half), 1.0))
    return curves


def with_law_limits(curve: RocCurve, alarms: ExceedanceCurve) -> RocCurve:
    """The curve with the limits of P_FA at its thresholds taken into those of P_D.

    Where the background has more alarms than the law says, the threshold of a P_FA lies higher and P_D lower: the
    limits are the curve drawn against those of P_FA, in quadrature with the curve's own, in probit.
    """
    z, low, high = (probit(pd) for pd in (curve.pd, curve.pd_lower, curve.pd_upper))
    # Limits of P_FA rise with it; far out, where the law says little, they need not.
    less = np.maximum.accumulate(np.log(alarms.lower[::-1]))
    more = np.minimum.accumulate(np.log(alarms.upper))[::-1]
    at = np.log(curve.pfa)
    up = z + np.hypot(high - z, np.maximum(_read(at, less, z) - z, 0.0))
    down = z - np.hypot(z - low, np.maximum(z - _read(at, more, z), 0.0))
    return replace(curve, pd_lower=ndtr(np.maximum.accumulate(down)), pd_upper=ndtr(np.maximum.accumulate(up)))


def _read(at: Array, x: Array, z: Array) -> Array:
    """A curve z over x, both rising, at places ``at``; beyond its ends with the slope over ``at`` there."""
    below, above = (z[1] - z[0]) / (at[1] - at[0]), (z[-1] - z[-2]) / (at[-1] - at[-2])
    inside = np.interp(at, x, z)
    return np.asarray(inside + below * np.minimum(at - x[0], 0.0) + above * np.maximum(at - x[-1], 0.0))


def _linear(scenario: Scenario) -> list[str]:
    return [d for d in scenario.processing.detectors if d in LINEAR_DETECTORS]


FALSE_ALARMS = (1e-2, 1e-3)  # where predicted P_D is compared
_SPECTRA = ("radiance", "reflectance", "snr", "toa_reflectance")
PROBABILITIES = ("P_D", "AUC")


def quantities(p: PredictedProducts) -> dict[Key, Array]:
    """(product, subject, ...) -> (n,) numbers: bands of spectra, P_D at each of FALSE_ALARMS, scores and areas."""
    out: dict[Key, Array] = {}
    for product in _SPECTRA:
        for subject, estimate in getattr(p, product).items():
            out[product, subject] = estimate.mean
    for (subject, detector), score in p.scores.items():
        out["score mean", subject, detector] = np.array([score.mean])
        out["score sd", subject, detector] = np.array([score.sd])
    for (subject, detector, unit), curve in p.roc.items():
        out["P_D", subject, detector, unit] = detection_at(curve, FALSE_ALARMS)
        out["AUC", subject, detector, unit] = np.array([curve_area(curve, WHOLE)])
    return out


def scaled(key: Key, values: Array) -> Array:
    """Numbers on the scale on which they are taken to be linear: probabilities in probit."""
    return np.asarray(ndtri(np.clip(values, 1e-300, 1.0 - 1e-16))) if key[0] in PROBABILITIES else values


def unscaled(key: Key, values: Array) -> Array:
    """Back from the scale of :func:`scaled`."""
    return np.asarray(ndtr(values)) if key[0] in PROBABILITIES else values


@dataclass(frozen=True)
class Draws:
    """Products of N truths drawn from the budget.

    Attributes
    ----------
    values : key -> (N, n);  curves : (subject, detector, unit) -> (N, K) P_D of whole curves
    """

    values: Mapping[Key, Array]
    curves: Mapping[RocKey, Array]
    samples: int
    seed: int

    def sd(self, key: Key) -> Array:
        """(n,) standard uncertainty."""
        return np.asarray(self.values[key].std(axis=0, ddof=1))

    def interval(self, key: Key) -> tuple[Array, Array]:
        """(n,) limits of the 95 % interval."""
        return limits(self.values[key])


def limits(draws: Array) -> tuple[Array, Array]:
    """(n,) limits of the 95 % interval of draws (N, n), probabilistically symmetric (JCGM 101:2008, 7.7.2)."""
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    return low, high


def draw_products(predictions: Iterable[PredictedProducts], seed: int) -> Draws:
    """Products of predictions of drawn truths."""
    values: dict[Key, list[Array]] = {}
    curves: dict[RocKey, list[Array]] = {}
    count = 0
    for p in predictions:
        count += 1
        for key, numbers in quantities(p).items():
            values.setdefault(key, []).append(numbers)
        for name, curve in p.roc.items():
            curves.setdefault(name, []).append(curve.pd)
    lines = {k: np.stack(v) for k, v in curves.items()}
    return Draws({k: np.stack(v) for k, v in values.items()}, lines, count, seed)


@dataclass(frozen=True)
class Linear:
    """Linearised propagation: key -> (n,) products as stated, and variance on the scale of :func:`scaled`."""

    stated: Mapping[Key, Array]
    variance: Mapping[Key, Array]

    def sd(self, key: Key) -> Array:
        """(n,) standard uncertainty on the scale of the product, to first order."""
        low, high = self.interval(key)
        return np.asarray((high - low) / (2.0 * Z95)) if key[0] in PROBABILITIES else np.sqrt(self.variance[key])

    def interval(self, key: Key) -> tuple[Array, Array]:
        """(n,) limits of the 95 % interval."""
        centre, half = scaled(key, self.stated[key]), Z95 * np.sqrt(self.variance[key])
        return unscaled(key, centre - half), unscaled(key, centre + half)


def linearise(
    stated: PredictedProducts,
    inputs: Sequence[UncertainInput],
    predicted: Callable[[Iterable[Truth]], Iterator[PredictedProducts]],
) -> Linear:
    """Linearised propagation of all products (JCGM 100:2008, 5.1).

    Spectra have it in ``stated``, with every direction of every input.  For scores and curves it is made of central
    differences over one standard uncertainty along each direction.
    """
    base = quantities(next(predicted([{}])))
    variance = {key: np.zeros(values.shape) for key, values in base.items()}
    if any(key[0] not in _SPECTRA for key in variance):
        steps = (item.direction(k, z) for item in inputs for k in range(item.size) for z in (1.0, -1.0))
        moved = (quantities(p) for p in predicted(steps))
        for up, down in zip(moved, moved, strict=True):
            for key, total in variance.items():
                if key[0] not in _SPECTRA:
                    total += (0.5 * (scaled(key, up[key]) - scaled(key, down[key]))) ** 2
    for product in _SPECTRA:
        for subject, estimate in getattr(stated, product).items():
            variance[product, subject] = estimate.standard_uncertainty**2
    return Linear(base, variance)


@dataclass(frozen=True)
class Agreement:
    """The two ways for one product of one subject; of a spectrum the median over bands, of a ROC one P_FA.

    Attributes
    ----------
    key : product, subject and so on
    at : what of it: a false-alarm probability; NaN where there is nothing to choose
    linear_sd, drawn_sd : standard uncertainties
    sd_ratio, interval_ratio : drawn over linearised
    gap : greater of the differences of the two limits, in units of the tolerance
    agrees : gap at most 1
    """

    key: Key
    at: float
    linear_sd: float
    drawn_sd: float
    sd_ratio: float
    interval_ratio: float
    gap: float

    @property
    def agrees(self) -> bool:
        """Whether both limits agree within the tolerance."""
        return self.gap <= 1.0


def tolerance(u: Array, samples: int) -> Array:
    """(n,) tolerance of a limit: half a unit of the first significant digit of u (JCGM 101:2008, 7.9.2, one digit).

    To it come two standard errors that a 2.5 % quantile of ``samples`` normal draws has: sqrt(p (1 - p) / N) / phi.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        digit = 0.5 * 10.0 ** np.floor(np.log10(u))
    quantile_error = np.sqrt(0.025 * 0.975 / samples) / 0.058445
    return np.asarray(digit + 2.0 * quantile_error * u)


def agreement(key: Key, linear: Linear, draws: Draws, index: int | None = None, at: float = np.nan) -> Agreement:
    """The two ways compared for one product; ``index`` picks one of its numbers."""
    pick = slice(None) if index is None else slice(index, index + 1)
    lin, mc = linear.sd(key)[pick], draws.sd(key)[pick]
    low, high = (x[pick] for x in linear.interval(key))
    drawn_low, drawn_high = (x[pick] for x in draws.interval(key))
    live = np.isfinite(lin) & np.isfinite(mc) & (np.maximum(lin, mc) > 1e-12 * np.abs(linear.stated[key][pick]) + 1e-14)
    if not live.any():
        return Agreement(key, at, 0.0, 0.0, 1.0, 1.0, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.maximum(np.abs(low - drawn_low), np.abs(high - drawn_high))[live]
        gap = gap / tolerance(np.maximum(lin, mc)[live], draws.samples)
        ratio, widths = mc[live] / lin[live], (drawn_high - drawn_low)[live] / (high - low)[live]

    def middle(x: Array) -> float:
        return float(np.median(x))

    return Agreement(key, at, middle(lin[live]), middle(mc[live]), middle(ratio), middle(widths), middle(gap))


Engine = Callable[[AtmosphericState], AtmosphericTerms]

# Three nodes 0 and +-sqrt(3) standard deviations: those of Gauss and Hermite, exact for moments of a cubic.
_NODE = float(np.sqrt(3.0))


@dataclass(frozen=True)
class Emulator:
    """Stands in for an engine near one state: quadratic in each uncertain field, without cross terms.

    Attributes
    ----------
    between : the runs, a star about the stated one; None where nothing of the atmosphere is uncertain
    stated : terms of the stated state
    runs : engine runs behind it
    error : greatest and median error of direct and path radiance against the engine, as a part of their sum, where
        all fields are one standard uncertainty off [1]; zeros where nothing is uncertain
    """

    between: InterpolatedTerms | None
    stated: AtmosphericTerms
    runs: int
    error: tuple[float, float]

    @property
    def axes(self) -> Mapping[str, Array]:
        """Field -> its values at the nodes, the stated one first."""
        return {} if self.between is None else self.between.axes

    def __call__(self, state: AtmosphericState) -> AtmosphericTerms:
        """The terms of a state that differs from the stated one in the uncertain fields alone."""
        if self.between is None:
            return self.stated
        at = {n: np.array([_beside(n, nodes[0], state_value(state, n))]) for n, nodes in self.axes.items()}
        terms = self.between(at)
        return replace(terms, **{n: getattr(terms, n)[0] for n in self.between.values})


def _beside(name: str, stated: float, value: float) -> float:
    """The value; an azimuth on the same turn as the stated one."""
    return stated + (value - stated + 180.0) % 360.0 - 180.0 if name.endswith("azimuth_deg") else value


def emulator(
    scenario: Scenario, inputs: Sequence[UncertainInput], engine: Engine, axis: SpectralAxis | None
) -> Emulator:
    """Run the engine at the nodes of every uncertain field of the atmosphere.

    Parameters
    ----------
    axis : bands over which the terms are averaged before they are interpolated; None keeps the engine's own
        sampling, for bands that move
    """

    state = scenario.atmosphere
    assert state is not None  # noqa: S101 - asked for where there is light

    def run(changes: Mapping[str, Any]) -> AtmosphericTerms:
        terms = engine(with_settings(state, state_entries(state, changes)))
        return terms if axis is None else replace(terms.at_bands(axis), fwhm_nm=axis.fwhm_nm)

    stated = run({})
    axes: dict[str, Array] = {}
    runs, moving = [stated], {}
    for item in inputs:
        room, _, name = item.path.partition(".")
        if room != "atmosphere":
            continue
        values = [state_value(state, name)]
        for z in (-_NODE, _NODE):
            value = float(item.moved(z)[item.path][0])
            # A node at the end of the range may be the stated value.
            if all(abs(value - v) > 1e-12 for v in values):
                values.append(value)
                runs.append(run({name: value}))
        if len(values) > 1:
            axes[name] = np.array(values)
            moving[name] = float(item.moved(1.0)[item.path][0])
    if not axes:
        return Emulator(None, stated, 1, (0.0, 0.0))
    fast = Emulator(interpolated_terms(axes, runs, star=True, bounded=False), stated, len(runs) + 1, (0.0, 0.0))
    off = with_settings(state, state_entries(state, moving))
    return replace(fast, error=_error(fast(off), run(moving)))


def _error(guess: AtmosphericTerms, truth: AtmosphericTerms) -> tuple[float, float]:
    """Greatest and median error of the radiance over a grey ground of reflectance 0.3, where there is light."""
    seen = [t.path_radiance + 0.3 * (t.direct + t.adjacency) / (1 - 0.3 * t.spherical_albedo) for t in (guess, truth)]
    lit = truth.direct > 1e-3 * truth.direct.max()
    relative = np.abs(seen[0] / seen[1] - 1.0)[lit]
    return float(relative.max()), float(np.median(relative))


Again = Callable[..., Iterator[PredictedProducts]]  # of other truths, under ``stand_in`` as the engine


@dataclass(frozen=True)
class Propagated:
    """Both ways of propagation.

    Attributes
    ----------
    linear, draws : the products each way
    agreements : for every product and subject; P_D at 1e-2 and 1e-3
    emulator : what stood for the engine; None without an atmosphere
    """

    linear: Linear
    draws: Draws
    agreements: tuple[Agreement, ...]
    emulator: Emulator | None


def propagate(
    scenario: Scenario,
    stated: PredictedProducts | None,
    inputs: Sequence[UncertainInput],
    again: Again,
    *,
    samples: int,
    seed: int,
    engine: Engine | None = None,
    axis: SpectralAxis | None = None,
    show_progress: bool | None = None,
) -> Propagated:
    """Draw ``samples`` truths from the budget, linearise, and compare.

    Parameters
    ----------
    stated : the prediction as stated; None draws alone
    again : predictions, without a budget, of other truths under an engine
    engine, axis : of the atmosphere; bands on which its terms are interpolated, None for the engine's own sampling

    Raises
    ------
    UsageError : fewer than 40 draws, which have no 95 % interval.
    """
    if samples < 40:
        raise UsageError(f"{samples} draws have no 95 % interval", expected="40 or more")
    stand_in = emulator(scenario, inputs, engine, axis) if engine is not None and scenario.atmosphere else None
    predicted = partial(again, stand_in=stand_in)
    truths = track(drawn_truths(inputs, samples, seed), "draws of the budget", show=show_progress)
    draws = draw_products(predicted(truths), seed)
    if stated is None:
        return Propagated(Linear({}, {}), draws, (), stand_in)
    linear = linearise(stated, inputs, predicted)
    rows = []
    for key, values in linear.stated.items():
        if key[0] != "P_D":
            rows.append(agreement(key, linear, draws))
            continue
        inside = [i for i, pd in enumerate(values) if np.isfinite(pd)]  # a curve may begin above
        rows += [agreement(key, linear, draws, i, FALSE_ALARMS[i]) for i in inside]
    return Propagated(linear, draws, tuple(rows), stand_in)


def with_intervals(stated: PredictedProducts, propagation: Propagated, method: str) -> PredictedProducts:
    """The prediction with intervals from the draws: of P_D where the two ways differ, or everywhere.

    With ``method`` "monte-carlo" all curves take the limits of the draws, and the errors of a spectrum are the
    linearised ones times the median over bands of drawn over linearised: the covariance of a few hundred draws, or
    their standard deviation band by band, is too noisy to be inverted in a test.
    With "both" a curve takes the limits of the draws where P_D at 1e-2 or 1e-3 disagrees.
    """
    differs = {a.key for a in propagation.agreements if a.key[0] == "P_D" and not a.agrees}
    roc = dict(stated.roc)
    for key, curve in stated.roc.items():
        name = ("P_D", *key)
        if method == "monte-carlo" or name in differs:
            roc[key] = drawn_curve(curve, limits(propagation.draws.curves[key]))
    notes = [_words(propagation)]
    if method == "both" and differs:
        which = ", ".join(sorted({" ".join(k[1:]) for k in differs}))
        notes.append(f"P_D intervals from the draws, where linearisation differs by more than the tolerance: {which}")
    spectra = {}
    for product in _SPECTRA:
        estimates = getattr(stated, product)
        if method == "monte-carlo":
            estimates = {s: _drawn_estimate(e, propagation.draws.sd((product, s))) for s, e in estimates.items()}
        spectra[product] = estimates
    table = [{**asdict(a), "agrees": a.agrees} for a in propagation.agreements]
    record = {
        "method": method,
        "samples": propagation.draws.samples,
        "seed": propagation.draws.seed,
        "agreements": table,
    }
    return replace(
        stated,
        roc=roc,
        **spectra,
        notes=(*stated.notes, *notes),
        provenance={**stated.provenance, "propagation": record},
    )


def drawn_curve(curve: RocCurve, interval: tuple[Array, Array]) -> RocCurve:
    """A curve with the limits (K,) of drawn curves, itself inside them."""
    low, high = interval
    return replace(curve, pd_lower=np.minimum(low, curve.pd), pd_upper=np.maximum(high, curve.pd))


def _drawn_estimate(estimate: SpectralEstimate, sd: Array) -> SpectralEstimate:
    linear = estimate.standard_uncertainty
    some = (linear > 0) & np.isfinite(sd)
    factor = float(np.median(sd[some] / linear[some])) if some.any() else 1.0
    budget = {k: v * factor for k, v in estimate.budget.items()}
    return replace(estimate, error_covariance=factor**2 * estimate.error_covariance, budget=budget)


def ratios(agreements: Sequence[Agreement]) -> Mapping[str, tuple[float, float, float]]:
    """Product -> (least, median, greatest) ratio of drawn to linearised standard uncertainty over its subjects."""
    out: dict[str, list[float]] = {}
    for a in agreements:
        label = a.key[0] if np.isnan(a.at) else f"{a.key[0]} at {a.at:.0e}"
        if np.isfinite(a.sd_ratio):
            out.setdefault(label, []).append(a.sd_ratio)
    return {k: (min(v), float(np.median(v)), max(v)) for k, v in out.items()}


def _words(propagation: Propagated) -> str:
    parts = [f"{k} {low:.2f}-{high:.2f}" for k, (low, _, high) in ratios(propagation.agreements).items()]
    text = f"{propagation.draws.samples} draws of the budget (seed {propagation.draws.seed}): "
    text += "standard uncertainty over the linearised one: " + ", ".join(parts)
    e = propagation.emulator
    if e is not None and e.axes:
        text += (
            f"; atmosphere interpolated between {e.runs} engine runs, radiance within {100 * e.error[0]:.2g} % "
            f"(median {100 * e.error[1]:.2g} %) with every input of it one standard uncertainty off"
        )
    return text
