"""What is explained: the quantities that are compared, as one vector of residuals with its covariance.

Radiance of every subject in the windows of the atmosphere (reflectance where there is none), SNR, moments of the
scores, and the false-alarm rate at measured thresholds.  P_D is left out: it follows from the scores, and would
count them twice.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import numpy.typing as npt
from scipy import linalg, special

from hyperval.attribute.candidates import Candidate
from hyperval.compare.rows import short_label
from hyperval.data import Array, Index, Mask
from hyperval.model.roc import detection_at
from hyperval.products import ObjectScores, Products, SpectralEstimate, background_of

PIECES = 17  # smooth pieces of a spectrum
RADIOMETRIC = ("radiance", "toa_reflectance")
POINTS = (1e-2, 1e-3)  # false-alarm rates that are looked at
ENOUGH = 0.05  # p-value from which residuals count as explained
# Numerical error of the model itself: what interpolation and rounding may do.  It keeps well sampled quantities
# from deciding alone.
SPECTRUM_FLOOR = 1e-4  # of the value, each band by itself: what closure with simulated collections leaves
MAX_WIDENED = 20.0  # times a covariance that too few pixels know
SCORE_FLOOR = 5e-3  # of a score, on the scale where the target is 1
LOG_FLOOR = 0.02  # of the logarithm of a standard deviation
RATE_FLOOR = 0.1  # of the logarithm of a false-alarm rate
# A false-alarm rate says something of the tail where this many pixels lie above the threshold.
MIN_ALARMS = 20


Quantity = tuple[str, str, str, str]  # a number of both sides: product, subject, method, metric in the results table


def quantities(predicted: Products, observed: Products) -> dict[Quantity, float]:
    """Mean over the observed one in windows of radiance, reflectance and SNR; P_D at P_FA 1e-2 and 1e-3.

    >>> from hyperval.spectra import SpectralAxis
    >>> axis = SpectralAxis(np.array([500.0, 600.0, 700.0, 1400.0]), 10.0)  # the last absorbs
    >>> means = [2.0, 4.0, 9.0, 9.0], [1.0, 3.0, np.nan, 1.0]
    >>> predicted, measured = ({"lawn": SpectralEstimate(np.array(mean), np.eye(4))} for mean in means)
    >>> kinds = "radiance", "reflectance", "snr", "toa_reflectance"
    >>> found = quantities(*(Products(axis, **dict.fromkeys(kinds, side)) for side in (predicted, measured)))
    >>> [product for product, *_ in found] == [*kinds], set(found.values())
    (True, {1.5})

    No curve goes on before its first point.

    >>> from hyperval.products import RocCurve
    >>> def side(first, power=0.5):
    ...     pfa = np.array([1e-4, 1e-3, 1e-2, 0.1, 1.0])[first:]
    ...     return Products(axis, roc={("p", "cem", "pixel"): RocCurve(pfa, *3 * [pfa**power], -pfa)})
    >>> {metric: round(pd, 3) for (*_, metric), pd in quantities(side(1, 0.25), side(0)).items()}
    {'pd@1e-2': 0.316, 'pd@1e-3': 0.178}
    >>> [len(quantities(side(some), side(other))) for some, other in ((2, 0), (0, 2))]
    [1, 1]
    """
    found = dict[Quantity, float]()
    for product in ("radiance", "reflectance", "snr", "toa_reflectance"):
        for subject, estimate in getattr(observed, product).items():
            if (spectrum := getattr(predicted, product).get(subject)) is None:
                continue
            use = observed.axis.clear & np.isfinite(spectrum.mean) & np.isfinite(estimate.mean)
            level = float(np.mean(estimate.mean[use])) if use.any() else 0.0
            if level > 0:
                found[product, subject, "", "ratio_windows"] = float(np.mean(spectrum.mean[use])) / level
    for key, curve in observed.roc.items():
        for pfa in POINTS if key in predicted.roc and key[2] == "pixel" else ():
            if pfa >= max(curve.pfa[0], predicted.roc[key].pfa[0]):
                method = f"{key[1]}/{key[2]}"
                found["roc", key[0], method, f"pd@{short_label(pfa)}"] = float(detection_at(predicted.roc[key], pfa))
    return found


@dataclass(frozen=True, eq=False)
class ResidualBlock:
    """One compared quantity.

    Attributes
    ----------
    product, subject, method : as in the results table
    observed : (n,) what the collection says
    covariance : (n, n) of the error of ``observed`` but for its calibration, the numerical floor of the model included
    read : the same (n,) from a prediction
    bands : (n,) index of the band of each entry, None for what is no spectrum
    calibration : (B, B) relative error covariance that all spectra of the collection share, in all bands, and (n,) what
        was predicted, of which it is a part: of what was measured, which is noisy, the error would be less where the
        noise is negative, and a gain seem smaller than it is (Peelle's puzzle; Chiba & Smith 1991, ANL/NDM-121); None
        without
    """

    product: str
    subject: str
    method: str
    observed: Array
    covariance: Array
    read: Callable[[Products], Array]
    bands: Index | None = None
    calibration: tuple[Array, Array] | None = None

    @property
    def quantity(self) -> str:
        """Name of the quantity, the same in every run."""
        return f"{self.product} of {self.subject} {self.method}".strip()


@dataclass(frozen=True, eq=False)
class Stack:
    """Several blocks as one vector."""

    blocks: tuple[ResidualBlock, ...]

    @cached_property
    def bands(self) -> Index:
        """(n,) band of each entry; of what is no spectrum -1, -2, ..."""
        return np.concatenate([~np.arange(b.observed.size) if b.bands is None else b.bands for b in self.blocks])

    def entry_labels(self, what: str) -> npt.NDArray[np.str_]:
        """(n,) product or subject of each entry."""
        return np.repeat([getattr(b, what) for b in self.blocks], [b.observed.size for b in self.blocks])

    @property
    def observed(self) -> Array:
        """(n,) of all blocks."""
        return np.concatenate([b.observed for b in self.blocks])

    @property
    def covariance(self) -> Array:
        """(n, n): different blocks err independently of each other, but for the calibration that spectra share."""
        out = np.asarray(linalg.block_diag(*[b.covariance for b in self.blocks]))
        for (a, rows), (b, columns) in itertools.product(self.with_slices(), repeat=2):
            if a.calibration is not None and a.bands is not None and b.calibration is not None and b.bands is not None:
                (relative, level), (_, other) = a.calibration, b.calibration
                out[rows, columns] += np.outer(level, other) * relative[np.ix_(a.bands, b.bands)]
        return out

    def difference_from(self, other: Stack) -> Array:
        """(n,) observed here less observed in another measurement; 0 where that has no such entry.

        >>> def stack(**observed):
        ...     return Stack(tuple(ResidualBlock("scores", n, "", np.array(x), np.eye(len(x)), len)
        ...                        for n, x in observed.items()))
        >>> stack(red=[0.5, 0.1], green=[0.4]).difference_from(stack(grey=[9.0], red=[0.2])).round(9).tolist()
        [0.3, 0.0, 0.0]
        """
        out, places = np.zeros(self.observed.size), {block.quantity: part for block, part in other.with_slices()}
        for name, entries, index in self.shared_entries({name: other.bands[part] for name, part in places.items()}):
            out[entries] = self.observed[entries] - other.observed[places[name]][index]
        return out

    def shared_entries(self, bands: Mapping[str, npt.ArrayLike]) -> list[tuple[str, Index, Index]]:
        """Quantity, entries in this run and in another, of what both have; ``bands`` of the other as :attr:`bands`."""
        same = [(block.quantity, i) for block, i in self.with_slices() if block.quantity in bands]
        common = [(name, i, np.intersect1d(self.bands[i], bands[name], return_indices=True)) for name, i in same]
        return [(name, i.start + entries, other) for name, i, (_, entries, other) in common if entries.size]

    def predicted(self, prediction: Products) -> Array:
        """(n,) what a prediction says of the same quantities."""
        return np.concatenate([b.read(prediction) for b in self.blocks])

    def excess_covariance(self, prediction: Products, budget: Array) -> Array:
        """(n, n) what a prediction's own error covariances hold beyond ``budget`` (n, n), each spectrum by itself.

        An input moves all spectra at once by its first directions alone; what they leave has its covariance from
        band to band still: counted as independent in each band it would be many times too wide.
        """
        out = np.zeros_like(budget)
        for block, place in self.with_slices():
            if block.bands is not None:
                stated = getattr(prediction, block.product)[block.subject].error_covariance
                excess = np.nan_to_num(stated[np.ix_(block.bands, block.bands)]) - budget[place, place]
                values, vectors = np.linalg.eigh(excess)
                out[place, place] = (vectors * np.clip(values, 0.0, None)) @ vectors.T
        return out

    def single_bands(self, level: Array) -> Array:
        """(n, K) the spectra of ``level`` (n,) band by band: column k holds what all subjects show in one band.

        What a gain makes is in proportion to the prediction: with a gain on what was measured beside one on what was
        predicted the residual would explain itself.
        """
        return np.asarray(level[:, None] * (self.bands[:, None] == np.unique(self.bands[self.bands >= 0])))

    def pieces(self, level: Array, centre_nm: Array, knots_nm: Array, *, additive: bool) -> Array:
        """(n, K) radiance by smooth pieces over wavelength: column k is 1 at a knot and falls to 0 at its neighbours,
        times what each subject shows in ``level`` (n,) (a gain) or, ``additive``, what all of them show on average in a
        band (an offset).
        """
        lit = np.isin(self.entry_labels("product"), RADIOMETRIC)
        sums, counts = (np.bincount(self.bands[lit], x, centre_nm.size) for x in (level[lit], None))
        height = np.where(lit, (sums / np.maximum(counts, 1))[self.bands] if additive else level, 0.0)
        hats = [np.interp(centre_nm, knots_nm, one)[self.bands] for one in np.eye(len(knots_nm))]
        return np.transpose(hats) * height[:, None]

    def unstructured(self, level: Array) -> Array:
        """(n, K) what may happen to each block by itself: a tenth of a spectrum or an SNR by smooth pieces, a tenth of
        each score and each logarithm.
        """
        parts = []
        for block, part in self.with_slices():
            n = block.observed.size
            height = 0.1 * level[part] if block.bands is not None else np.full(n, 0.1)
            knots = np.linspace(0.0, n - 1.0, min(n, PIECES))
            parts.append(np.transpose([np.interp(np.arange(n), knots, one) * height for one in np.eye(knots.size)]))
        return np.asarray(linalg.block_diag(*parts))

    def class_mixing(self, level: Array, classes: Mapping[str, Mapping[str, Array]]) -> dict[str, Array]:
        """(n,) change of each subject's spectrum by a hundredth of a class's in its place: (B,) by product."""
        out = {}
        for block, part in self.with_slices():
            for name, other in classes.get(block.product, {}).items() if block.bands is not None else ():
                if name != block.subject:
                    out[f"region of {block.subject} with pixels of {name}"] = change = np.zeros(level.size)
                    change[part] = 0.01 * np.nan_to_num(other[block.bands] - level[part])
        return out

    def scene_mean(self, classes: Mapping[str, Mapping[str, Array]], area: Mapping[str, float], other: Array) -> Array:
        """(n,) radiance of the scene on average, by the area of its classes; ``other`` where none of them is known.

        >>> block = ResidualBlock("radiance", "panel", "", np.ones(3), np.eye(3), len, bands=np.arange(3))
        >>> each = {"grass": np.array([1.0, 1.0, np.nan]), "soil": np.array([5.0, np.nan, np.nan])}
        >>> Stack((block,)).scene_mean({"radiance": each}, {"grass": 0.75, "soil": 0.25}, np.full(3, 9.0)).tolist()
        [2.0, 1.0, 9.0]
        """
        out = other.copy()
        for block, part in self.with_slices():
            if block.product in RADIOMETRIC and (each := classes.get(block.product)):
                spectra = np.ma.masked_invalid([x[block.bands] for x in each.values()])
                average = np.ma.average(spectra, axis=0, weights=[area[n] for n in each])
                out[part] = np.where(np.ma.getmaskarray(average), other[part], average)
        return out

    def spectral_stray_light(self, level: Array) -> Array:
        """(n,) change of each radiance spectrum to its own mean over the bands."""
        out = np.zeros(level.size)
        for block, part in self.with_slices():
            if block.product in RADIOMETRIC:
                out[part] = np.mean(level[part]) - level[part]
        return out

    def subject_errors(self, level: Array) -> dict[Candidate, Array]:
        """Of what is measured, other light on one subject, or all that is more than the greatest value now cut off."""
        lit, subjects, out = self.bands >= 0, self.entry_labels("subject"), dict[Candidate, Array]()
        for name in dict.fromkeys(subjects[lit].tolist()):
            light = Candidate(f"light on {name}", "region", "5 %", False, sizes=(-10.0, 20.0))
            out[light] = np.outer(np.where(lit & (subjects == name), 0.05 * level, 0.0), light.sizes)
        greatest = np.max(self.observed, where=lit, initial=0.0)
        cut = np.where(lit, np.minimum(level, greatest) - level, 0.0)
        out[Candidate("saturation", "sensor", "", False, labels=(f"at {greatest:.4g}",))] = cut[:, None]
        return out

    def subject_bands(self, level: Array, subject: str) -> Array:
        """(n, K) a tenth of a subject's spectrum in each band by itself."""
        rows = np.flatnonzero((self.entry_labels("subject") == subject) & (self.bands >= 0))
        return np.asarray(0.1 * level[:, None] * (np.arange(level.size)[:, None] == rows))

    def common_bands(self, level: Array) -> tuple[Index, Array]:
        """Entries (m,) of spectra in bands that two and more subjects show, and columns (m, K) of those bands.

        Column k holds what the subjects show of ``level`` (n,) in one band, 0 elsewhere: an error that all share.
        """
        columns = self.single_bands(level)
        shared = np.count_nonzero(columns, axis=0) > 1
        rows = np.flatnonzero(np.any(columns[:, shared] != 0.0, axis=1))
        return rows, columns[np.ix_(rows, np.flatnonzero(shared))]

    def with_slices(self) -> list[tuple[ResidualBlock, slice]]:
        """Each block with its entries in the vector."""
        ends = np.cumsum([b.observed.size for b in self.blocks])
        return [(b, slice(int(e) - b.observed.size, int(e))) for b, e in zip(self.blocks, ends, strict=True)]


def stack_of(predicted: Products, observed: Products) -> Stack:
    """Everything both sides hold, as far as both have values there.

    An error of the calibration is a part of what is predicted, whatever the noise of what was measured.

    >>> from hyperval.products import PredictedProducts
    >>> from hyperval.spectra import SpectralAxis
    >>> axis, noisy = SpectralAxis(np.array([500.0, 600.0]), 5.0), np.array([0.8, 1.2])
    >>> error = 1e-4 * np.outer(noisy, noisy)
    >>> sides = [SpectralEstimate(np.ones(2), 0.0 * error), SpectralEstimate(noisy, error, calibration=error)]
    >>> stack_of(*(PredictedProducts(axis, radiance={"lawn": side}) for side in sides)).covariance.round(7).tolist()
    [[0.0001, 0.0001], [0.0001, 0.0001]]

    Of bands by number all count.

    >>> pair = [PredictedProducts(SpectralAxis([1.0, 2.0], 1.0), reflectance={"lawn": side}) for side in sides]
    >>> [block.observed.size for block in stack_of(*pair).blocks], len(quantities(*pair))
    ([2], 1)
    """
    return Stack(tuple(_blocks(predicted, observed)))


def _blocks(predicted: Products, observed: Products) -> Iterator[ResidualBlock]:
    # Pixels that a target fills in part are judged by their scores: their mean spectrum is that of their mean fill.
    mixed = {subject for subject, _ in predicted.scores}
    in_radiance = {name for name in observed.radiance if name in predicted.radiance}
    left_out = {"radiance": mixed, "reflectance": mixed | in_radiance, "toa_reflectance": set(observed.radiance)}
    for product, left_out_names in left_out.items():
        for name, estimate in getattr(observed, product).items():
            if name in getattr(predicted, product) and name not in left_out_names:
                yield from _spectrum(product, name, predicted, estimate)
    for name, estimate in observed.snr.items():
        if name in predicted.snr:
            yield from _snr(name, predicted, estimate)
    yield from _scores(predicted, observed)
    for key, objects in observed.object_scores.items():
        if key in predicted.object_scores and few_objects(observed, *key):
            yield from _objects(key, predicted.object_scores[key], objects)
    yield from _false_alarms(predicted, observed)


def _spectrum(product: str, subject: str, predicted: Products, estimate: SpectralEstimate) -> Iterator[ResidualBlock]:
    mean = getattr(predicted, product)[subject].mean
    use = predicted.axis.clear & np.isfinite(mean) & np.isfinite(estimate.mean)
    use &= mean > 0.01 * np.nanmax(mean, initial=0.0)  # bands without light say nothing
    if not use.any():
        return
    covariance, shared = sampled_covariance(estimate, use, np.diag((SPECTRUM_FLOOR * mean[use]) ** 2)), None
    if estimate.calibration is not None:
        level = np.where(estimate.mean == 0.0, np.inf, estimate.mean)
        shared = estimate.calibration / np.outer(level, level), mean[use]
        covariance -= np.nan_to_num(estimate.calibration[np.ix_(use, use)])
    yield ResidualBlock(
        product, subject, "", estimate.mean[use], covariance,
        lambda p: np.asarray(getattr(p, product)[subject].mean[use]), np.flatnonzero(use), shared,
    )  # fmt: skip


def sampled_covariance(estimate: SpectralEstimate, use: Mask, floor: Array) -> Array:
    """(n, n) error covariance of a spectrum and ``floor`` in some bands, its estimated parts as wide as a test asks.

    r^T S^-1 r with an estimated S is larger than with the true covariance: the mean over n bands is nu/(nu - n - 1)
    for nu degrees of freedom (Hotelling), 1.9 for 36 pixels in 16 bands.  A part S is widened by f, the ratio of the
    95 % points of Hotelling's law and of chi-square in as many directions as it counts in, k = tr(P)^2 / tr(P^2) with
    P its share C^-1 S in the whole; less as its share there is less than all, f - 1 in proportion to tr(P)/k.  This
    stands in place of what widens it in single bands.  A model of few factors and independent bands, for pixels fewer
    than bands, is known as these are and stays.
    """
    parts = (p.of_each(lambda c: np.nan_to_num(c[np.ix_(use, use)])) for p in estimate.estimated)
    modelled = [(p.covariance if p.model is None else p.model, p) for p in parts if not p.dof > p.sample_dof]
    out = np.nan_to_num(estimate.error_covariance[np.ix_(use, use)]) + floor
    out = whole = out + sum((model - part.covariance for model, part in modelled), np.zeros_like(out))
    for model, part in modelled:
        share = linalg.solve(whole, model)
        trace, squares = float(np.trace(share)), float(np.sum(share * share.T))
        if trace > 0.0:
            out = out + (hotelling_factor(trace**2 / squares, max(part.dof, 1.0)) - 1.0) * squares / trace * model
    return out


def hotelling_factor(directions: float, dof: float) -> float:
    """95 % point of Hotelling's T^2 over that of chi-square, at most :data:`MAX_WIDENED`.

    Examples
    --------
    >>> round(hotelling_factor(1, 10.0), 2), round(hotelling_factor(16, 35.0), 2)
    (1.29, 2.33)
    """
    freedom = max(dof - directions + 1.0, 1.0)
    student = dof * directions / freedom * special.fdtri(directions, freedom, 1.0 - ENOUGH)
    return float(min(student / special.chdtri(directions, ENOUGH), MAX_WIDENED))


def _snr(subject: str, predicted: Products, estimate: SpectralEstimate) -> Iterator[ResidualBlock]:
    with np.errstate(invalid="ignore"):
        use = predicted.axis.good & (predicted.snr[subject].mean > 1.0) & (estimate.mean > 1.0)
    if use.any():
        value = estimate.mean[use]
        errors = np.nan_to_num(estimate.error_covariance[np.ix_(use, use)] / np.outer(value, value))
        # Bands hang together by what the same few pixels say: weights of the inverse lean on that, and called a noise
        # that was right 4 % too large.  Each band counts by itself, as much less as the mean of all is known less.
        shared = max(float(errors.sum() / np.trace(errors)), 1.0)
        covariance = np.diag(shared * np.diag(errors) + LOG_FLOOR**2)
        yield ResidualBlock(
            "snr", subject, "", np.log(value), covariance,
            lambda p: np.asarray(np.log(np.maximum(p.snr[subject].mean[use], 1e-3))),
        )  # fmt: skip


def _scores(predicted: Products, observed: Products) -> Iterator[ResidualBlock]:
    counted: set[tuple[float, float, str]] = set()
    for key, score in observed.scores.items():
        law, same, n = predicted.scores.get(key), (score.mean, score.sd, key[1]), score.n or 0
        usable = n >= 3 and np.isfinite(score.mean) and score.sd > 0
        # Pixels of one object are not independent: the object counts.  One filter's background stands under each
        # of its targets.
        if law is not None and law.sd > 0 and usable and not few_objects(observed, *key) and same not in counted:
            counted.add(same)
            variances = score.errors(law) ** 2 + [SCORE_FLOOR**2, LOG_FLOOR**2]
            yield ResidualBlock("scores", *key, _moments(key, observed), np.diag(variances), partial(_moments, key))


def _moments(key: tuple[str, str], p: Products) -> Array:
    """Mean of scores, and logarithm of their standard deviation."""
    return np.array([p.scores[key].mean, np.log(p.scores[key].sd)])


def few_objects(observed: Products, subject: str, detector: str) -> bool:
    """Whether a subject's scores are those of several pixels of fewer objects."""
    objects, score = observed.object_scores.get((subject, detector)), observed.scores.get((subject, detector))
    return objects is not None and score is not None and (score.n or 0) > objects.values.size


def _objects(key: tuple[str, str], predicted: ObjectScores, measured: ObjectScores) -> Iterator[ResidualBlock]:
    """Mean score of the objects of a subject; its variance is what the model itself gives single objects."""
    values = measured.values[np.isfinite(measured.values)]
    if values.size:
        variance = np.array([[np.var(predicted.values) / values.size + SCORE_FLOOR**2]])
        yield ResidualBlock(
            "scores", *key, np.array([values.mean()]), variance,
            lambda p: np.array([float(np.mean(p.object_scores[key].values))]),
        )  # fmt: skip


def _false_alarms(predicted: Products, observed: Products) -> Iterator[ResidualBlock]:
    """Logarithm of the false-alarm rate at the thresholds that the data reach 1e-2 and 1e-3 with."""
    counted: set[tuple[str, float]] = set()
    for key, curve in observed.roc.items():
        (subject, detector, unit), n = key, curve.n_background or 0
        rates = np.array([p for p in POINTS if p * n >= MIN_ALARMS and p >= curve.pfa[0]])
        if unit != "pixel" or key not in predicted.roc or not rates.size:
            continue
        thresholds = np.interp(np.log(rates), np.log(curve.pfa), curve.threshold)
        same = (detector, round(float(thresholds[0]), 9))
        if same not in counted and np.isfinite(thresholds).all():
            counted.add(same)
            effect = 1.0  # alarms come in clusters
            if curve.design_effect is not None:
                effect = np.interp(np.log(rates), np.log(curve.pfa), curve.design_effect)
            variance = np.maximum(1.0 / (rates * n) + RATE_FLOOR**2, effect / (rates * n))
            yield ResidualBlock(
                "roc", background_of(subject), detector, np.log(rates), np.diag(variance),
                partial(log_false_alarm_rate, key, thresholds),
            )  # fmt: skip


def log_false_alarm_rate(key: tuple[str, str, str], threshold: Array, p: Products) -> Array:
    """ln P_FA of a curve of a prediction at scores (K,), interpolated; held at its ends."""
    curve = p.roc[key]
    rising = np.argsort(curve.threshold)
    return np.asarray(np.interp(threshold, curve.threshold[rising], np.log(curve.pfa)[rising]))
