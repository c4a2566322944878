"""Propagation by draws of the inputs, with an emulator in place of the engine.

Every product of a prediction as numbers, drawn and linearised, and how the two ways of propagation compare.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms
from hyperval.atmosphere.terms import InterpolatedTerms, interpolated_terms
from hyperval.errors import UsageError
from hyperval.prediction.departure import Departure, state_value, true_scenario
from hyperval.prediction.input import UncertainInput, drawn_truths, one_at_a_time
from hyperval.processing.intervals import Z95
from hyperval.processing.roc import WHOLE, curve_area
from hyperval.processing.roc_model import detection_at
from hyperval.products import PredictedProducts, RocCurve, SpectralEstimate
from hyperval.progress import track
from hyperval.scenario import Scenario
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Key = tuple[str, ...]

FALSE_ALARMS = (1e-2, 1e-3)  # where predicted P_D is compared
SPECTRA = ("radiance", "reflectance", "snr", "toa_reflectance")
PROBABILITIES = ("P_D", "AUC")


def quantities(p: PredictedProducts) -> dict[Key, Array]:
    """(product, subject, ...) -> (n,) numbers: bands of spectra, P_D at each of FALSE_ALARMS, scores and areas."""
    out: dict[Key, Array] = {}
    for product in SPECTRA:
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
    curves: Mapping[Key, Array]
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
    curves: dict[Key, list[Array]] = {}
    count = 0
    for p in predictions:
        count += 1
        for key, numbers in quantities(p).items():
            values.setdefault(key, []).append(numbers)
        for name, curve in p.roc.items():
            curves.setdefault(name, []).append(curve.pd)
    whole, lines = ({k: np.stack(v) for k, v in each.items()} for each in (values, curves))
    return Draws(whole, lines, count, seed)


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
    predicted: Callable[[Iterable[Departure]], Iterator[PredictedProducts]],
) -> Linear:
    """Linearised propagation of all products (JCGM 100:2008, 5.1).

    Spectra have it in ``stated``, with every direction of every input.  For scores and curves it is made of central
    differences over one standard uncertainty along each direction.
    """
    base = quantities(next(predicted([Departure()])))
    variance = {key: np.zeros(values.shape) for key, values in base.items()}
    if any(key[0] not in SPECTRA for key in variance):
        steps = one_at_a_time(inputs)
        moved = (quantities(p) for p in predicted(truth for step in steps for truth in step.truths))
        for up, down in zip(moved, moved, strict=True):
            for key, total in variance.items():
                if key[0] not in SPECTRA:
                    total += (0.5 * (scaled(key, up[key]) - scaled(key, down[key]))) ** 2
    for product in SPECTRA:
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

    def run(at: Scenario) -> AtmosphericTerms:
        assert at.atmosphere is not None  # noqa: S101 - asked for where there is light
        terms = engine(at.atmosphere)
        return terms if axis is None else replace(terms.at_bands(axis), fwhm_nm=axis.fwhm_nm)

    stated = run(scenario)
    axes: dict[str, Array] = {}
    runs, moving = [stated], []
    for item in inputs:
        room, _, name = item.path.partition(".")
        if room != "atmosphere":
            continue
        assert scenario.atmosphere is not None  # noqa: S101 - inputs of the atmosphere
        values = [state_value(scenario.atmosphere, name)]
        for z in (-_NODE, _NODE):
            there = true_scenario(scenario, item.moved(z))
            assert there.atmosphere is not None  # noqa: S101
            value = _beside(name, values[0], state_value(there.atmosphere, name))
            # A node at the end of the range may be the stated value.
            if all(abs(value - v) > 1e-12 for v in values):
                values.append(value)
                runs.append(run(there))
        if len(values) > 1:
            axes[name] = np.array(values)
            moving.append(item)
    if not axes:
        return Emulator(None, stated, 1, (0.0, 0.0))
    fast = Emulator(interpolated_terms(axes, runs, star=True, bounded=False), stated, len(runs) + 1, (0.0, 0.0))
    off = scenario
    for item in moving:
        off = true_scenario(off, item.moved(1.0))
    assert off.atmosphere is not None  # noqa: S101
    return replace(fast, error=_error(fast(off.atmosphere), run(off)))


def _error(guess: AtmosphericTerms, truth: AtmosphericTerms) -> tuple[float, float]:
    """Greatest and median error of the radiance over a grey ground of reflectance 0.3, where there is light."""
    seen = [t.path_radiance + 0.3 * (t.direct + t.adjacency) / (1 - 0.3 * t.spherical_albedo) for t in (guess, truth)]
    lit = truth.direct > 1e-3 * truth.direct.max()
    relative = np.abs(seen[0] / seen[1] - 1.0)[lit]
    return float(relative.max()), float(np.median(relative))


Again = Callable[..., Iterator[PredictedProducts]]  # of departed truths, under ``stand_in`` as the engine


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
    stated : the prediction without a departure; None draws alone
    again : predictions, without a budget, of departed truths under an engine
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
    for product in SPECTRA:
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
