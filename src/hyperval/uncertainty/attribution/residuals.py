"""What is explained: the quantities that are compared, as one vector of residuals with its covariance.

Radiance of every subject in the windows of the atmosphere (reflectance where there is none), SNR, moments of the
scores, and the false-alarm rate at measured thresholds.  P_D is left out: it follows from the scores, and would
count them twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np
import numpy.typing as npt
from scipy import linalg, special

from hyperval.model.intervals import Z95
from hyperval.model.roc import detection_at
from hyperval.products import Products, RocCurve, ScoreDistribution, SpectralEstimate, background_of
from hyperval.spectra.axis import in_window

POINTS = (1e-2, 1e-3)


@dataclass(frozen=True, eq=False)
class ComparedQuantity:
    """One number of both sides.

    Attributes
    ----------
    product, subject, method, metric : as in the results table
    observed : what the collection says
    read : the same of a prediction
    """

    product: str
    subject: str
    method: str
    metric: str
    observed: float
    read: Callable[[Products], float]


def quantities(predicted: Products, observed: Products) -> list[ComparedQuantity]:
    """Predicted over observed mean in windows of radiance, reflectance and SNR; P_D at P_FA 1e-2 and 1e-3."""
    items: list[ComparedQuantity] = []
    for product in ("radiance", "reflectance", "snr", "toa_reflectance"):
        left, right = getattr(predicted, product), getattr(observed, product)
        for subject in right:
            if subject not in left:
                continue
            use = observed.axis.good & in_window(observed.axis.centre_nm)
            use &= np.isfinite(left[subject].mean) & np.isfinite(right[subject].mean)
            level = float(np.mean(right[subject].mean[use])) if use.any() else 0.0
            if level > 0:
                ratio = partial(_mean_over, level, product, subject, use)
                items.append(ComparedQuantity(product, subject, "", "ratio_windows", 1.0, ratio))
    for key, curve in observed.roc.items():
        there = predicted.roc.get(key)
        if there is None or key[2] != "pixel":
            continue
        for pfa in POINTS:
            if pfa < max(curve.pfa[0], there.pfa[0]):
                continue

            def pd(p: Products, key: tuple[str, str, str] = key, at: float = pfa) -> float:
                return float(detection_at(p.roc[key], at))

            name = f"pd@{pfa:.0e}".replace("e-0", "e-")
            items.append(ComparedQuantity("roc", key[0], f"{key[1]}/{key[2]}", name, pd(observed), pd))
    return items


def _mean_over(level: float, product: str, subject: str, use: npt.NDArray[np.bool_], p: Products) -> float:
    return float(np.mean(getattr(p, product)[subject].mean[use])) / level


Array = npt.NDArray[np.float64]

ENOUGH = 0.05  # p-value from which residuals count as explained
# Numerical error of the model itself: what interpolation and rounding may do.  It keeps well sampled quantities
# from deciding alone.
SPECTRUM_FLOOR = 1e-4  # of the value, each band by itself: what closure with simulated collections leaves
MOST_WIDENED = 20.0  # times a covariance that too few pixels know
SCORE_FLOOR = 5e-3  # of a score, on the scale where the target is 1
LOG_FLOOR = 0.02  # of the logarithm of a standard deviation
_SPECTRA = ("radiance", "reflectance", "toa_reflectance")
RATE_FLOOR = 0.1  # of the logarithm of a false-alarm rate
# A false-alarm rate says something of the tail where this many pixels lie above the threshold.
LEAST_ALARMS = 20


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """One compared quantity.

    Attributes
    ----------
    product, subject, method : as in the results table
    observed : (n,) what the collection says
    covariance : (n, n) of the error of ``observed``, the numerical floor of the model included
    read : the same (n,) from a prediction
    read_covariance : (n, n) error covariance that a prediction states for it, None where it states none
    bands : (n,) index of the band of each entry, None for what is no spectrum
    calibration : (B, B) relative error covariance that all spectra of the collection share, in all bands; None
        without
    """

    product: str
    subject: str
    method: str
    observed: Array
    covariance: Array
    read: Callable[[Products], Array]
    read_covariance: Callable[[Products], Array] | None = None
    bands: npt.NDArray[np.intp] | None = None
    calibration: Array | None = None


@dataclass(frozen=True, eq=False)
class Stack:
    """Several blocks as one vector."""

    blocks: tuple[ResidualBlock, ...]

    @property
    def observed(self) -> Array:
        """(n,) of all blocks."""
        return np.concatenate([b.observed for b in self.blocks])

    @property
    def covariance(self) -> Array:
        """(n, n): different blocks err independently of each other, but for the calibration that spectra share."""
        out = np.asarray(linalg.block_diag(*[b.covariance for b in self.blocks]))
        placed = list(zip(self.blocks, self.slices(), strict=True))
        for (a, rows), (b, columns) in permutations(placed, 2):
            if a.calibration is None or a.bands is None or b.calibration is None or b.bands is None:
                continue
            shared = a.calibration[np.ix_(a.bands, b.bands)]
            out[rows, columns] = np.outer(a.observed, b.observed) * shared
        return out

    def predicted(self, prediction: Products) -> Array:
        """(n,) what a prediction says of the same quantities."""
        return np.concatenate([b.read(prediction) for b in self.blocks])

    def stated_beyond(self, prediction: Products, budget: Array) -> Array:
        """(n, n) what a prediction's own error covariances hold beyond ``budget`` (n, n), each spectrum by itself.

        An input moves all spectra at once by its first directions alone; what they leave has its covariance from
        band to band still: counted as independent in each band it would be many times too wide.
        """
        out = np.zeros_like(budget)
        for block, place in zip(self.blocks, self.slices(), strict=True):
            if block.read_covariance is not None:
                values, vectors = np.linalg.eigh(block.read_covariance(prediction) - budget[place, place])
                out[place, place] = (vectors * np.clip(values, 0.0, None)) @ vectors.T
        return out

    def single_bands(self) -> Array:
        """(n, K) the spectra band by band: column k holds what all subjects show in one band, 0 elsewhere."""
        of_spectra = [b for b in self.blocks if b.bands is not None and b.product in _SPECTRA]
        if not of_spectra:
            return np.zeros((self.observed.size, 0))
        used = np.unique(np.concatenate([b.bands for b in of_spectra if b.bands is not None]))
        out = np.zeros((self.observed.size, used.size))
        for block, place in zip(self.blocks, self.slices(), strict=True):
            if block.bands is not None:
                rows = np.arange(place.start, place.stop)
                out[rows, np.searchsorted(used, block.bands)] = block.observed
        return out

    def common_bands(self) -> tuple[npt.NDArray[np.intp], Array]:
        """Entries (m,) of spectra in bands that two and more subjects show, and columns (m, K) of those bands.

        Column k holds what the subjects show in one band, 0 elsewhere: an error that is common to all of them.
        """
        columns = self.single_bands()
        shared = np.count_nonzero(columns, axis=0) > 1
        rows = np.flatnonzero(np.any(columns[:, shared] != 0.0, axis=1))
        return rows, columns[np.ix_(rows, np.flatnonzero(shared))]

    def slices(self) -> list[slice]:
        """Where each block stands."""
        ends = np.cumsum([b.observed.size for b in self.blocks])
        return [slice(int(e) - b.observed.size, int(e)) for b, e in zip(self.blocks, ends, strict=True)]

    def indices_of(self, subject: str) -> npt.NDArray[np.intp]:
        """Entries of one subject, with those of the background seen through its filter."""
        names, places = {subject, background_of(subject)}, zip(self.blocks, self.slices(), strict=True)
        return np.concatenate([np.arange(s.start, s.stop) for b, s in places if b.subject in names])


def stacked(predicted: Products, observed: Products) -> Stack:
    """Everything both sides hold, as far as both have values there."""
    blocks: list[ResidualBlock] = []
    # Pixels that a target fills in part are judged by their scores: their mean spectrum is that of their mean fill.
    mixed = {subject for subject, _ in predicted.scores}
    for name, estimate in observed.radiance.items():
        if name not in mixed:
            blocks += _spectrum("radiance", name, predicted, estimate)
    for name, estimate in observed.reflectance.items():
        if name not in mixed and (name not in observed.radiance or name not in predicted.radiance):
            blocks += _spectrum("reflectance", name, predicted, estimate)
    for name, estimate in observed.toa_reflectance.items():
        if name not in observed.radiance:
            blocks += _spectrum("toa_reflectance", name, predicted, estimate)
    for name, estimate in observed.snr.items():
        blocks += _snr(name, predicted, estimate)
    blocks += _scores(predicted, observed)
    blocks += _objects(predicted, observed)
    return Stack((*blocks, *_false_alarms(predicted, observed)))


def _spectrum(product: str, subject: str, predicted: Products, estimate: SpectralEstimate) -> list[ResidualBlock]:
    there = getattr(predicted, product).get(subject)
    if there is None:
        return []
    mean = there.mean
    use = predicted.axis.good & in_window(predicted.axis.centre_nm)
    use &= np.isfinite(mean) & np.isfinite(estimate.mean)
    use &= mean > 0.01 * np.nanmax(mean, initial=0.0)  # bands without light say nothing
    if not use.any():
        return []
    covariance = sampled_covariance(estimate, use, np.diag((SPECTRUM_FLOOR * mean[use]) ** 2))

    def read(p: Products) -> Array:
        return np.asarray(getattr(p, product)[subject].mean[use])

    def stated(p: Products) -> Array:
        return np.asarray(np.nan_to_num(getattr(p, product)[subject].error_covariance[np.ix_(use, use)]))

    relative = None
    if estimate.calibration is not None:
        level = np.where(estimate.mean == 0.0, np.inf, estimate.mean)
        relative = estimate.calibration / np.outer(level, level)
    return [
        ResidualBlock(product, subject, "", estimate.mean[use], covariance, read, stated, np.flatnonzero(use), relative)
    ]


def sampled_covariance(estimate: SpectralEstimate, use: npt.NDArray[np.bool_], floor: Array) -> Array:
    """(n, n) error covariance of a spectrum and ``floor`` in some bands, its estimated parts as wide as a test asks.

    r^T S^-1 r with an estimated S is larger than with the true covariance: the mean over n bands is nu/(nu - n - 1)
    for nu degrees of freedom (Hotelling), 1.9 for 36 pixels in 16 bands.  A part S is widened by f, the ratio of the
    95 % points of Hotelling's law and of chi-square in as many directions as it counts in, k = tr(P)^2 / tr(P^2) with
    P its share C^-1 S in the whole; less as its share there is less than all, f - 1 in proportion to tr(P)/k.  A
    model of few factors and independent bands, for pixels fewer than bands, is known as single bands are and stays.
    """
    out = np.nan_to_num(estimate.error_covariance[np.ix_(use, use)]) + floor
    whole = out
    for part in (p.bands(use).of_each(np.nan_to_num) for p in estimate.estimated):
        share = linalg.solve(whole, part.covariance)
        trace, squares = float(np.trace(share)), float(np.sum(share * share.T))
        if trace > 0.0 and not part.dof > part.sample_dof:
            factor = hotelling_factor(trace**2 / squares, max(part.dof, 1.0))
            out = out + (factor - 1.0) * squares / trace * part.covariance
    return out


def hotelling_factor(directions: float, dof: float) -> float:
    """95 % point of Hotelling's T^2 over that of chi-square, at most :data:`MOST_WIDENED`.

    Examples
    --------
    >>> round(hotelling_factor(1, 10.0), 2), round(hotelling_factor(16, 35.0), 2)
    (1.29, 2.33)
    """
    left = max(dof - directions + 1.0, 1.0)
    student = dof * directions / left * special.fdtri(directions, left, 1.0 - ENOUGH)
    return float(min(student / special.chdtri(directions, ENOUGH), MOST_WIDENED))


def _snr(subject: str, predicted: Products, estimate: SpectralEstimate) -> list[ResidualBlock]:
    there = predicted.snr.get(subject)
    if there is None:
        return []
    with np.errstate(invalid="ignore"):
        use = predicted.axis.good & (there.mean > 1.0) & (estimate.mean > 1.0)
    if not use.any():
        return []
    value = estimate.mean[use]
    covariance = estimate.error_covariance[np.ix_(use, use)] / np.outer(value, value)
    covariance = np.nan_to_num(covariance) + np.diag(np.full(value.size, LOG_FLOOR**2))

    def read(p: Products) -> Array:
        return np.asarray(np.log(np.maximum(p.snr[subject].mean[use], 1e-3)))

    return [ResidualBlock("snr", subject, "", np.log(value), covariance, read)]


def _scores(predicted: Products, observed: Products) -> list[ResidualBlock]:
    blocks: list[ResidualBlock] = []
    seen: set[tuple[float, float, str]] = set()
    for (subject, detector), score in observed.scores.items():
        there = predicted.scores.get((subject, detector))
        # Pixels of one object are not independent: the object counts.
        if there is None or not _usable(score) or not there.sd > 0 or few_objects(observed, subject, detector):
            continue
        same = (score.mean, score.sd, detector)
        if same in seen:  # one filter's background stands under each of its targets
            continue
        seen.add(same)
        blocks.append(_moments(subject, detector, score))
    return blocks


def _usable(score: ScoreDistribution) -> bool:
    return score.n is not None and score.n >= 3 and np.isfinite(score.mean) and score.sd > 0


def _moments(subject: str, detector: str, score: ScoreDistribution) -> ResidualBlock:
    """Mean and logarithm of the standard deviation, from n normal scores: variances s^2/n and 1/(2 (n - 1))."""
    n = score.n or 0
    variances = [score.sd**2 / n + SCORE_FLOOR**2, 0.5 / (n - 1) + LOG_FLOOR**2]

    def read(p: Products) -> Array:
        scores = p.scores[subject, detector]
        return np.array([scores.mean, np.log(scores.sd)])

    value = np.array([score.mean, np.log(score.sd)])
    return ResidualBlock("scores", subject, detector, value, np.diag(variances), read)


def few_objects(observed: Products, subject: str, detector: str) -> bool:
    """Whether a subject's scores are those of several pixels of fewer objects."""
    objects, score = observed.object_scores.get((subject, detector)), observed.scores.get((subject, detector))
    return objects is not None and score is not None and (score.n or 0) > objects.values.size


def _objects(predicted: Products, observed: Products) -> list[ResidualBlock]:
    """Mean score of the objects of a subject; its variance is what the model itself gives single objects."""
    blocks: list[ResidualBlock] = []
    for (subject, detector), objects in observed.object_scores.items():
        there = predicted.object_scores.get((subject, detector))
        values = objects.values[np.isfinite(objects.values)]
        if there is None or not values.size or not few_objects(observed, subject, detector):
            continue
        variance = np.array([[np.var(there.values) / values.size + SCORE_FLOOR**2]])
        key = (subject, detector)

        def read(p: Products, key: tuple[str, str] = key) -> Array:
            return np.array([float(np.mean(p.object_scores[key].values))])

        blocks.append(ResidualBlock("scores", subject, detector, np.array([values.mean()]), variance, read))
    return blocks


def _false_alarms(predicted: Products, observed: Products) -> list[ResidualBlock]:
    """Logarithm of the false-alarm rate at the thresholds that the data reach 1e-2 and 1e-3 with."""
    blocks: list[ResidualBlock] = []
    seen: set[tuple[str, float]] = set()
    for (subject, detector, unit), curve in observed.roc.items():
        there = predicted.roc.get((subject, detector, unit))
        n = curve.n_background or 0
        if unit != "pixel" or there is None or not n:
            continue
        rates = np.array([p for p in (1e-2, 1e-3) if p * n >= LEAST_ALARMS and p >= curve.pfa[0]])
        if not rates.size:
            continue
        thresholds = np.interp(np.log(rates), np.log(curve.pfa), curve.threshold)
        if (detector, round(float(thresholds[0]), 9)) in seen or not np.isfinite(thresholds).all():
            continue
        seen.add((detector, round(float(thresholds[0]), 9)))
        variance = 1.0 / (rates * n) + RATE_FLOOR**2  # of ln of a count
        variance = np.maximum(variance, _clustered_variance(observed, subject, detector, thresholds))
        key = (subject, detector, unit)

        def read(p: Products, key: tuple[str, str, str] = key, at: Array = thresholds) -> Array:
            return log_false_alarm_rate(p.roc[key], at)

        blocks.append(ResidualBlock("roc", background_of(subject), detector, np.log(rates), np.diag(variance), read))
    return blocks


def _clustered_variance(observed: Products, subject: str, detector: str, threshold: Array) -> Array:
    """(K,) variance of ln P_FA from blocks of the image, as alarms come in clusters; 0 where it is not known."""
    for (name, method), curve in observed.exceedance.items():
        if method == detector and (subject == name or subject.startswith(f"{name} ")):
            with np.errstate(divide="ignore", invalid="ignore"):
                half = (np.log(curve.upper) - np.log(curve.lower)) / 2.0
            known = np.isfinite(half)
            if known.any():
                spread = np.interp(threshold, curve.threshold[known], half[known]) / Z95
                return np.asarray(spread**2)
    return np.zeros(threshold.size)


def log_false_alarm_rate(curve: RocCurve, threshold: Array) -> Array:
    """ln P_FA at scores (K,), interpolated on the curve; held at its ends."""
    rising = np.argsort(curve.threshold)
    return np.asarray(np.interp(threshold, curve.threshold[rising], np.log(curve.pfa)[rising]))
