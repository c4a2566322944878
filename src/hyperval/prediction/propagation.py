"""Every product of a prediction as numbers, drawn and linearised, and how the two ways of propagation compare."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from hyperval.prediction.departure import Departure
from hyperval.prediction.input import Input, one_at_a_time
from hyperval.processing.intervals import Z95
from hyperval.processing.roc_reading import detection_at
from hyperval.products import Prediction, RocCurve

Array = npt.NDArray[np.float64]
Key = tuple[str, ...]

FALSE_ALARMS = (1e-2, 1e-3)  # where predicted P_D is compared
SPECTRA = ("radiance", "reflectance", "snr", "toa_reflectance")
PROBABILITIES = ("P_D", "AUC")
# Directions of one input that the linearisation follows, the leading ones.
MOST_DIRECTIONS = 40


def auc_of(curve: RocCurve) -> float:
    """Mean P_D over all P_FA of a curve (3.33), by trapezoids; the curve is joined to (0, 0) and (1, 1) [1]."""
    x = np.concatenate([[0.0], curve.pfa, [1.0]])
    y = np.concatenate([[0.0], curve.pd, [1.0]])
    return float(np.trapezoid(y, x))


def quantities(p: Prediction) -> dict[Key, Array]:
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
        out["AUC", subject, detector, unit] = np.array([auc_of(curve)])
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


def draw_products(predictions: Iterable[Prediction], seed: int) -> Draws:
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
    stated: Prediction, inputs: Sequence[Input], predicted: Callable[[Iterable[Departure]], Iterator[Prediction]]
) -> Linear:
    """Linearised propagation of all products (JCGM 100:2008, 5.1).

    Spectra have it in ``stated``, with every direction of every input.  For scores and curves it is made of central
    differences over one standard uncertainty along each direction, the leading 40 of an input that has more.
    """
    base = quantities(next(predicted([Departure()])))
    variance = {key: np.zeros(values.shape) for key, values in base.items()}
    if any(key[0] not in SPECTRA for key in variance):
        steps = one_at_a_time(inputs, MOST_DIRECTIONS)
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
    live = (
        np.isfinite(lin)
        & np.isfinite(mc)
        & (np.maximum(lin, mc) > 1e-12 * np.abs(linear.stated[key][pick]) + 1e-14)
    )
    if not live.any():
        return Agreement(key, at, 0.0, 0.0, 1.0, 1.0, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        gap = np.maximum(np.abs(low - drawn_low), np.abs(high - drawn_high))[live]
        gap = gap / tolerance(np.maximum(lin, mc)[live], draws.samples)
        ratio, widths = mc[live] / lin[live], (drawn_high - drawn_low)[live] / (high - low)[live]

    def middle(x: Array) -> float:
        return float(np.median(x))

    return Agreement(key, at, middle(lin[live]), middle(mc[live]), middle(ratio), middle(widths), middle(gap))
