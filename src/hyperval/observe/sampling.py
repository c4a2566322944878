"""Sampling error of the mean of a region, its neighbours resembling each other."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from hyperval.observe.place import Place
from hyperval.observe.spread import REACH, pixels_of_windows
from hyperval.processing.few_pixels import factor_covariance
from hyperval.processing.mean_error import (
    components,
    independent_pixels,
    mean_error_covariance,
    small_sample_factor,
)
from hyperval.processing.sample import SampleStatistics
from hyperval.processing.spatial_correlation import neighbour_shares
from hyperval.products import EstimatedPart

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

FEWEST_PIXELS = 50  # below it a correlation on the ground is not told from chance
_SEED = 37


def mean_error(place: Place, region: Mask, statistics: SampleStatistics) -> EstimatedPart:
    """Error covariance (B, B) of a region's mean, in the cube's values, and what it is known by.

    Correlation on the ground is measured along the leading components, and the rest together, in windows of the
    image, at lags of up to 24 pixels, and few independent pixels widen the error
    (:func:`~hyperval.processing.mean_error.small_sample_factor`); regions of fewer than 50 pixels count as
    independent ones.  Pixels that are fewer than the bands have few common factors and independent bands
    (:func:`~hyperval.processing.few_pixels.factor_covariance`); the samples' own covariance stands beside it, and
    both without the widening, which a test makes by its degrees of freedom.
    """
    n, covariance = statistics.n, statistics.covariance
    variance = np.diag(covariance)
    known = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    if known.size == 0:
        return EstimatedPart(covariance / n, float(n - 1))
    inner, known_by = covariance[np.ix_(known, known)], float(n - 1)
    if n <= known.size:
        inner, known_by = factor_covariance(inner, n)
    if n < FEWEST_PIXELS:
        out = covariance / n
        out[np.ix_(known, known)] = inner / n
        return EstimatedPart(out, known_by, sample=covariance / n, sample_dof=float(n - 1))
    mean = statistics.mean[known]
    rng = np.random.default_rng(_SEED)
    along = components(inner, rng)

    def windows() -> Iterator[tuple[Array, Mask]]:
        for pixels, inside in pixels_of_windows(place, region, known, rng):
            pixels[~inside] = mean
            pixels -= mean  # in place: a window of all bands is 9 MB
            scores = along.scores(pixels)
            del pixels  # before the next window is read
            yield scores, inside

    reach = min(REACH, max(*region.shape) - 1)
    independent, of_variance = independent_pixels(windows(), neighbour_shares(region, reach, rng), n, reach)
    counted = float(np.median(of_variance)) - 1.0

    def full(c: Array, by: Array) -> Array:
        out = covariance / n
        out[np.ix_(known, known)] = mean_error_covariance(c, along, by)
        return out

    return EstimatedPart(
        full(inner, independent / small_sample_factor(independent)),
        counted * known_by / (n - 1),
        full(inner, independent),
        full(covariance[np.ix_(known, known)], independent),
        counted,
    )
