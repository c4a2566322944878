"""The spread of a class from pixel to pixel: eigenvalues, directions, distance, tails."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import Any

import numpy as np

from hyperval import pixels
from hyperval.compare.rows import COMPARISON, row, said, skip_as
from hyperval.data import Array, Mask
from hyperval.errors import UsageError
from hyperval.model.classification import bhattacharyya_distance
from hyperval.model.intervals import Z95
from hyperval.products import PixelDistribution, Products, SpectralEstimate
from hyperval.results import Effect, Result
from hyperval.spectra.axis import SpectralAxis

EIGENVALUES = 5  # compared
MAX_EIGENVALUES = 30  # in figures
SPACES = (1, 2, 3)
MIN_PIXELS = 3
_FIGURE_DRAWS = 399  # of the eigenvalues that no row compares
_SEED = 20140501
_MAX_DRAWN = 64  # bands that are kept, of some 0.1 to 0.5 MB each


def compared_bands(predicted: SpectralEstimate, observed: SpectralEstimate, axis: SpectralAxis) -> Mask:
    """(B,) usable bands in the atmospheric windows in which both covariances say something.

    >>> by_number = SpectralAxis(np.arange(1.0, 4.0), 1.0, np.array([True, True, False]))
    >>> side = SpectralEstimate(np.ones(3), np.eye(3), np.diag([1.0, 0.0, 1.0]))
    >>> compared_bands(side, side, by_number)
    array([ True, False, False])
    """
    keep = axis.clear
    for side in (predicted, observed):
        variance = np.diag(np.asarray(side.pixel_covariance))
        keep = keep & np.isfinite(variance) & (variance > 0)
    return np.asarray(keep)


def independent_pixels(n: int, distribution: PixelDistribution | None, size: int) -> Array:
    """(P,) degrees of freedom behind the variance along each direction, the leading ones first.

    Directions beyond those whose correlation was measured take the last one's value.  A correlation that was found is
    known the worse the fewer pixels it leaves (:func:`~hyperval.pixels.small_sample_factor`).

    >>> independent_pixels(1600, PixelDistribution(n=1600, effective_n=np.array([70.0, 1600.0])), 3).round().tolist()
    [64.0, 1599.0, 1599.0]
    """
    if distribution is None or distribution.effective_n is None or not distribution.n:
        return np.full(size, n - 1.0)
    leading = np.asarray(distribution.effective_n, dtype=float)[:size]
    leading = np.where(leading < distribution.n, leading / pixels.small_sample_factor(leading), leading)
    return np.maximum(np.concatenate([leading, np.full(size - leading.size, leading[-1])]) - 1.0, 1.0)


def compare_covariance(predicted: Products, observed: Products, subject: str, quantity: str) -> Iterator[Result]:
    """Rows of one subject in radiance or reflectance.  There are none where a side has no spread.

    The measured covariance is compared with covariances drawn from the predicted one (sampling bands at 95 %):

    - ``eigenvalue_ratio@k`` predicted over measured, the predicted one being the mean of the draws;
      ``eigenvalues_inside_95`` the share of them in the band;
    - ``total_variance_ratio`` predicted over measured, by the trace;
    - ``subspace_angle@k`` [deg] largest principal angle of the first k eigenvectors, ``subspace_inside_95@k``;
    - ``bhattacharyya_distance`` of the two normal laws, and ``bhattacharyya_covariance_excess``: the covariance's
      part less what sampling alone gives, with its band.  SKIPPED with fewer than 3 pixels for each band;
    - ``noise_ratio`` predicted over measured standard deviation of the noise, of radiance, where the prediction says
      how much of the covariance is noise and the observation in how many columns it lies.

    Examples
    --------
    >>> axis = SpectralAxis(np.arange(500.0, 900.0, 50.0), 10.0)
    >>> texture = np.exp(-np.abs(np.subtract.outer(np.arange(8.0), np.arange(8.0))) / 4.0)
    >>> predicted = SpectralEstimate(np.ones(8), 1e-4 * np.eye(8), 0.012 * texture)
    >>> observed = SpectralEstimate(np.ones(8), 1e-4 * np.eye(8), 0.010 * texture, n=400)
    >>> sides = (Products(axis, radiance={"grass": side}) for side in (predicted, observed))
    >>> rows = list(compare_covariance(*sides, "grass", "radiance"))
    >>> [(r.metric, round(r.value, 2)) for r in rows if not r.metric.endswith(("@2", "@3", "@4", "@5"))]
    [('eigenvalue_ratio@1', 1.2), ('eigenvalues_inside_95', 0.0), ('total_variance_ratio', 1.2),
    ('subspace_angle@1', 0.0), ('subspace_inside_95@1', 1.0), ('bhattacharyya_distance', 0.02),
    ('bhattacharyya_covariance_excess', 0.0)]
    >>> [round(r.value, 9) for r in rows if r.metric == "total_variance_ratio"]  # of the traces, without draws
    [1.2]

    The excess is known the worse the heavier the tails that are predicted, and the fewer pixels are independent.

    >>> from dataclasses import replace
    >>> def width(tail_dof=np.inf, n=400, **stated):
    ...     pixels = {"grass": PixelDistribution(n=n, effective_n=np.full(20, 399.0), **stated)}
    ...     law = {"grass": PixelDistribution(tail_dof=tail_dof)}
    ...     sides = Products(axis, radiance={"grass": predicted}, distribution=law), Products(
    ...         axis, radiance={"grass": replace(observed, n=n)}, distribution=pixels)
    ...     (found,) = (r for r in compare_covariance(*sides, "grass", "radiance") if r.metric.endswith("excess"))
    ...     return found.upper - found.value, found.value - found.lower, found.upper
    >>> (normal, tails, larger) = (width(**law) for law in ({}, {"tail_dof": 6.0}, {"n": 4000}))
    >>> [bool(a > 1.02 * b) for a, b in zip(tails[:2] + larger[:2], normal[:2] * 2)]
    [True, True, True, True]
    >>> tails[2] == normal[2]  # at least as much is due to sampling as of normal pixels
    True
    >>> width(leading_tail_dof=6.0, leading_upper=9.0) == tails  # as the pixels show them themselves
    True

    Heavier tails leave no interval to compare with.

    >>> heavy = {"grass": PixelDistribution(leading_tail_dof=3.5, leading_upper=3.9)}
    >>> sides = Products(axis, radiance={"grass": predicted}), Products(
    ...     axis, radiance={"grass": observed}, distribution=heavy)
    >>> [(row.cause.name, row.reason[:41]) for row in compare_covariance(*sides, "grass", "radiance")]
    [('HEAVY_TAILS', 'measured tails of 3.5 degrees of freedom:')]
    """
    sample = sampled(predicted, observed, subject, quantity, EIGENVALUES)
    if isinstance(sample, list):
        yield from sample
    elif sample is not None:
        yield from _eigenvalue_rows(sample)
        yield from _space_rows(sample)
        law = observed.distribution.get(subject)
        noise = getattr(predicted, "noise", {}).get(subject) if quantity == "radiance" else None  # a prediction's alone
        if noise and law is not None and (law.samples or 0) > 1:
            yield from _noise_rows(sample, noise, law.samples or 0)
        yield from _distance_rows(sample)


@dataclass(frozen=True)
class Sampled:
    """A measured covariance beside those drawn from the predicted one.

    Attributes
    ----------
    sides : predicted and measured
    bands : (B,) compared
    covariances : (b, b) predicted and measured, in those bands
    measured, band : statistics of the measured covariance and of the drawn ones
    eigenvalues : (3, K) mean and limits of those that samples of the prediction have
    distance : measured; NaN where a sample is too small for its determinant
    directions, independent : of the prediction, and (P,) degrees of freedom along them
    errors : (2, K, b) of both spreads
    spaces : the k of the principal angles
    n : pixels
    kurtosis : of the predicted law, or of the measured pixels where their tails are heavier
    """

    sides: tuple[SpectralEstimate, SpectralEstimate]
    bands: Mask
    covariances: tuple[Array, Array]
    measured: pixels.CovarianceStatistics
    band: pixels.CovarianceStatistics
    eigenvalues: Array
    distance: float
    directions: pixels.EigenDirections
    independent: Array
    errors: Array
    spaces: tuple[int, ...]
    n: int
    kurtosis: float


def sampled(
    predicted: Products, observed: Products, subject: str, quantity: str, most: int
) -> Sampled | list[Result] | None:
    """The measured covariance and what chance alone makes of the predicted one, for at most ``most`` eigenvalues.

    None where a side has no spread; a row that says why where the two cannot be compared.
    """
    p, o = (getattr(side, quantity).get(subject) for side in (predicted, observed))
    if p is None or o is None or p.pixel_covariance is None or o.pixel_covariance is None or o.n is None:
        return None
    bands, n = compared_bands(p, o, observed.axis), o.n
    if n < MIN_PIXELS or not bands.any():
        return skip_as("few_pixels.covariance", COMPARISON, n=n, bands=int(bands.sum()))
    block = np.ix_(bands, bands)
    first, second = np.asarray(p.pixel_covariance)[block], np.asarray(o.pixel_covariance)[block]
    first = first + np.diag(_rounding_variances(o)[bands])
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        return skip_as("no_value.covariance", COMPARISON)
    # Pixels that have tails scatter by them, whatever law is predicted.
    tail, law = (side.distribution.get(subject, PixelDistribution()) for side in (observed, predicted))
    tails = law.tail_dof, tail.leading_tail_dof if math.isfinite(tail.leading_upper) else math.inf
    kurtosis = pixels.kurtosis_parameter(min(tails))
    if math.isinf(kurtosis):
        return skip_as("heavy_tails.covariance", COMPARISON, predicted=tails[0], measured=tails[1])
    directions = pixels.EigenDirections.from_covariance(first)
    size = directions.values.size
    independent = independent_pixels(n, observed.distribution.get(subject), size)
    factor = directions.whitened_factor(second)
    count = max(min(most, size, n - 1, int(independent.min()), factor.shape[1]), 1)
    spaces = tuple(k for k in SPACES if k <= count and k < size)
    measured = pixels.covariance_statistics(directions, factor, count, spaces)
    full, lacks = pixels.is_full_rank(independent, size), factor.shape[1] < size
    distance = math.nan if not full else math.inf if lacks else pixels.covariance_distance(factor @ factor.T)
    errors = _spread_errors((p, o), bands)
    drawn_by, few = partial(_sampling_band, directions, independent, errors, kurtosis=kurtosis), min(count, EIGENVALUES)
    band = drawn_by((few, spaces))
    further = drawn_by((count, ()), draws=_FIGURE_DRAWS) if count > few else band
    limits = [np.stack([x.eigenvalues.mean(axis=0), *pixels.band_limits(x.eigenvalues)]) for x in (band, further)]
    drawn = np.hstack([limits[0], limits[1][:, EIGENVALUES:]])
    both = (p, o), bands, (first, second)
    return Sampled(*both, measured, band, drawn, distance, directions, independent, errors, spaces, n, kurtosis)


_DRAWN: dict[tuple[Any, ...], pixels.CovarianceStatistics] = {}


def _sampling_band(
    directions: pixels.EigenDirections, dof: Array, errors: Array, asked: tuple[int, tuple[int, ...]], **more: Any
) -> pixels.CovarianceStatistics:
    """The draws that rows and figures of a subject share."""
    law = b"".join(x.tobytes() for x in (directions.vectors, directions.values, dof, errors))
    key, rng = (sha256(law).digest(), *asked, *more.values()), np.random.default_rng(_SEED)
    if len(_DRAWN) >= _MAX_DRAWN:
        _DRAWN.clear()
    if key not in _DRAWN:
        _DRAWN[key] = pixels.sampling_band(directions, dof, *asked, rng, errors=errors, **more)
    return _DRAWN[key]


def _rounding_variances(observed: SpectralEstimate) -> Array:
    return np.zeros(observed.mean.size) if observed.rounding is None else observed.rounding


def _spread_errors(sides: Iterable[SpectralEstimate], bands: Mask) -> Array:
    """(2, K, b) errors of both spreads: it is the same to the difference which side is off."""
    none = np.zeros((2, 0, np.count_nonzero(bands)))
    each = (side.spread_errors[..., bands] for side in sides if side.spread_errors is not None)
    return np.asarray(np.nan_to_num(np.concatenate([none, *each], axis=1)))


def _eigenvalue_rows(sample: Sampled) -> Iterator[Result]:
    measured, band, n = sample.measured, sample.band, sample.n
    expected, low, high = sample.eigenvalues
    for k, value in enumerate(measured.eigenvalues):
        reason = f"measured {value:.4g}, expected for {n} pixels of the prediction {expected[k]:.4g}"
        yield _row(f"eigenvalue_ratio@{k + 1}", expected[k] / value, (low[k] / value, high[k] / value), n, reason)
    inside = (measured.eigenvalues >= low) & (measured.eigenvalues <= high)
    yield row("eigenvalues_inside_95", float(np.mean(inside)), n=n)
    total = band.total / band.total.mean() * float(np.trace(sample.covariances[0]) / measured.total)
    yield _row("total_variance_ratio", float(total.mean()), pixels.band_limits(total), n)


def _space_rows(sample: Sampled) -> Iterator[Result]:
    for k, angle, drawn in zip(sample.spaces, sample.measured.angles_deg, sample.band.angles_deg.T, strict=False):
        # One-sided: only too large an angle tells against the prediction.
        most = float(np.sort(drawn)[-round(0.05 * (drawn.size + 1))])  # is exceeded with probability 0.05
        reason = f"sampling alone stays below {most:.3g} deg in 95 % of draws"
        yield row(f"subspace_angle@{k}", angle, n=sample.n, reason=reason)
        yield row(f"subspace_inside_95@{k}", float(angle <= most), n=sample.n, reason=reason)


def _distance_rows(sample: Sampled) -> Iterator[Result]:
    """The distance of the two normal laws, and what of it is the covariance's beyond sampling.

    What samples of heavy tails show lies between that of normal pixels and that of the law's kurtosis, which pixels
    by the thousand do not reach: the interval takes in both.
    """
    found, metrics = sample.distance, ("bhattacharyya_distance", "bhattacharyya_covariance_excess")
    if math.isnan(found):
        fewest, size = float(sample.independent.min()) + 1.0, sample.independent.size
        yield from skip_as("few_pixels.distance", *metrics, fewest=fewest, size=size)
        return
    (p, o), (first, second) = (side.mean[sample.bands] for side in sample.sides), sample.covariances
    try:
        distance = bhattacharyya_distance(p, first, o, second)
    except UsageError:
        distance = math.inf
    if math.isinf(found + distance):
        ranks = [pixels.EigenDirections.from_covariance(c).values.size for c in (first, second)]
        yield from skip_as("no_value.distance", *metrics, predicted=ranks[0], measured=ranks[1], bands=len(first))
        return
    n, rng = sample.independent, partial(np.random.default_rng, _SEED)
    law = partial(pixels.distance_band, sample.directions, n, errors=sample.errors)
    of_kurtosis = {kurtosis: law(rng(), kurtosis) for kurtosis in {0.0, sample.kurtosis}}
    (least, low, _), (expected, _, high) = of_kurtosis[0.0], of_kurtosis[sample.kurtosis]
    # The correlation of pixels is known as well as a variance from as many independent ones.
    unknown = Z95 * math.sqrt(float(np.mean(2.0 / n * np.maximum(1.0 - n / (sample.n - 1.0), 0.0))))
    low = least - math.hypot(least - low, unknown * least)
    high = expected + math.hypot(high - expected, unknown * expected)
    yield row("bhattacharyya_distance", distance, n=sample.n)
    reason = f"sampling alone gives {expected:.3g} ({low:.3g} to {high:.3g}), measured {found:.3g}"
    yield _row("bhattacharyya_covariance_excess", found - expected, (found - high, found - low), sample.n, reason)


def _noise_rows(sample: Sampled, sources: Mapping[str, Array], samples: int) -> Iterator[Result]:
    """The noise in the measured covariance; nothing where the model has none.

    The sources are those at the mean of the class, and the calibration error follows the mean square of its pixels.
    """
    (predicted, observed), total = sample.sides, np.sum(list(sources.values()), axis=0)
    bands = sample.bands & np.isfinite(total) & (total > 0)
    if not bands.any():
        return
    block = np.ix_(bands, bands)
    texture = np.asarray(predicted.pixel_covariance)[block] - np.diag(total[bands])
    calibration = sources.get("calibration", np.zeros_like(total))[bands]
    common = calibration * np.diag(texture) / predicted.mean[bands] ** 2  # (3.17) of L^2 + var L
    noise = total[bands] + common + _rounding_variances(observed)[bands]
    first, second = texture + np.diag(noise), np.asarray(observed.pixel_covariance)[block]
    columns = {"calibration": calibration + common, "samples": samples, "errors": _spread_errors(sample.sides, bands)}
    factor, uncertainty = pixels.noise_part(second, first, noise, sample.independent, sample.kurtosis, **columns)
    low, high = (factor + sign * Z95 * uncertainty for sign in (-1.0, 1.0))
    if factor <= 0.0:
        yield from skip_as("few_pixels.noise", "noise_ratio")
        return
    why = f"noise is {np.median(noise / np.diag(first)):.2g} of the predicted variance (median over bands)"
    # Open where noise is not seen for certain: the rows that remained without these had too much noise by chance.
    yield row("noise_ratio", factor**-0.5, (high**-0.5, low**-0.5 if low > 0.0 else math.inf), n=sample.n, reason=why)


def _row(metric: str, value: float, interval: tuple[Any, Any], n: int, reason: str = "") -> Result:
    """A row whose band is that of sampling; the mean of skewed draws may lie beyond an end of it."""
    return row(metric, value, (min(interval[0], value), max(interval[1], value)), n=n, reason=reason)


def compare_distribution(predicted: PixelDistribution | None, observed: PixelDistribution | None) -> Iterator[Result]:
    """Rows of the tails of one class; none where they were not measured.

    ``background_tail_dof`` and ``background_tail_dof_leading``: measured degrees of freedom of a multivariate t in
    all bands and in the few leading components, inf for normal pixels; ``tail_inverse_dof_difference``
    1/predicted - 1/measured in the leading components, which stays finite (left out where no law is predicted,
    or it was fitted to these very pixels); ``normality_p_value``;
    ``effective_pixels``: independent pixels behind the variance of the first component.

    Examples
    --------
    >>> measured = PixelDistribution(30.0, 20.0, 60.0, 0.3, 6, 25.0, 18.0, 50.0, 3, 400, np.array([300.0, 320.0]))
    >>> [(r.metric, round(r.value, 3)) for r in compare_distribution(PixelDistribution(20.0), measured)]
    [('background_tail_dof', 30.0), ('background_tail_dof_leading', 25.0), ('tail_inverse_dof_difference',
    0.01), ('normality_p_value', 0.3), ('effective_pixels', 300.0)]
    """
    if observed is None:
        return
    o, dof, ends = observed, observed.leading_tail_dof, (observed.leading_lower, observed.leading_upper)
    note = said("tails", law=predicted)
    why = f"{note}; in {o.dimension} bands" if o.dimension else "the law that is predicted"
    yield row("background_tail_dof", o.tail_dof, (o.tail_lower, o.tail_upper), n=o.n, reason=why)
    if not math.isnan(dof):
        why = f"{note}; in the {o.leading_dimension} leading components"
        yield row("background_tail_dof_leading", dof, ends, n=o.n, reason=why)
        if predicted is not None:
            least, value, most = (1.0 / predicted.tail_dof - 1.0 / x for x in (ends[0], dof, ends[1]))
            yield row("tail_inverse_dof_difference", value, (least, most), n=o.n, reason=note)
    about = Effect(1.0 / o.tail_dof, 1.0 / o.tail_upper, 1.0 / o.tail_lower)
    yield row("normality_p_value", o.normality_p_value, n=o.n, about=about)
    if o.effective_n is not None and o.effective_n.size:
        yield row("effective_pixels", o.effective_n[0], n=o.n)
