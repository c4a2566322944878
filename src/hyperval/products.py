"""The products both sides of a comparison hold, under the same names on the same axis.

``predict`` fills them from statistics, ``observe`` from pixels; after that nothing knows which
side a product came from.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from hyperval.data import Array, Counts, Errors
from hyperval.spectra.axis import SpectralAxis


class EstimatedPart(NamedTuple):
    """A part of an error covariance that was estimated from samples.

    Attributes
    ----------
    covariance : (B, B) as it stands in the error covariance, widened where few samples know it
    dof : degrees of freedom behind ``model``
    model : (B, B) as estimated, all directions of it; None: ``covariance``
    sample : (B, B) of the samples themselves, where ``model`` is a model of it; None: ``model``
    sample_dof : degrees of freedom behind it
    factors : (B, B) part of ``model`` that few common factors make, where the rest is independent bands
    """

    covariance: Array
    dof: float
    model: Array | None = None
    sample: Array | None = None
    sample_dof: float = math.nan
    factors: Array | None = None

    def of_each(self, change: Callable[[Array], Array]) -> EstimatedPart:
        """With its covariances changed alike."""
        model, sample, factors = (None if c is None else change(c) for c in (self.model, self.sample, self.factors))
        return EstimatedPart(change(self.covariance), self.dof, model, sample, self.sample_dof, factors)


@dataclass(frozen=True)
class SpectralEstimate:
    """A spectrum of one subject with what is known of its error.

    Attributes
    ----------
    mean : (B,) the estimate; NaN where the band holds none
    error_covariance : (B, B) covariance of the error of ``mean``: sampling and everything systematic,
        with its correlation between bands
    pixel_covariance : (B, B) spread from pixel to pixel, None where there are no pixels
    n : number of samples behind the mean
    budget : standard uncertainty (B,) by source of error, for budget bars; the sources are
        independent of each other, so their squares sum to the diagonal of ``error_covariance``
    estimated : parts of ``error_covariance`` that were estimated from samples; the rest counts as known
    circular : why the estimate is no evidence, such as a panel that its own empirical line goes through; else empty
    stated : (B,) standard uncertainty that its source states, where ``error_covariance`` leaves out what the other
        side shares with it; None where that holds all
    rounding : (B,) variance that storing whole steps adds to that from pixel to pixel: step^2/12; None without
    calibration : (B, B) part of ``error_covariance`` that all spectra of the collection share; None without
    errors : of a prediction, by source: a direction of one source is the same draw in all of its spectra
    spread_errors : (2, K, B) errors of ``pixel_covariance`` along K independent directions: the part by which each
        band's standard deviation is off, and the variance beside; None where it counts as known
    """

    mean: Array
    error_covariance: Array
    pixel_covariance: Array | None = None
    n: int | None = None
    budget: Mapping[str, Array] = field(default_factory=dict)
    estimated: tuple[EstimatedPart, ...] = field(default=(), compare=False, repr=False)
    circular: str = ""
    stated: Array | None = field(default=None, compare=False, repr=False)
    rounding: Array | None = field(default=None, compare=False, repr=False)
    calibration: Array | None = field(default=None, compare=False, repr=False)
    errors: Mapping[str, Errors] = field(default_factory=dict, compare=False, repr=False)
    spread_errors: Array | None = field(default=None, compare=False, repr=False)

    @property
    def standard_uncertainty(self) -> Array:
        """(B,) square root of the diagonal of the error covariance."""
        return np.sqrt(np.clip(np.diag(self.error_covariance), 0.0, None))


@dataclass(frozen=True)
class ScoreDistribution:
    """Mean and spread of a detector's score over one population of pixels.

    Attributes
    ----------
    mean, sd : moments of the score [1]
    n : pixels behind them; of a prediction those of the image that its classes are measured on, None without
    grid, density : (G,) scores and the probability density at each [per unit of score]; None without
    greatest : (m,) the greatest scores of measured pixels, falling, all of them where they are few; None without
    mean_error, sd_error : standard uncertainties of the mean, and of sd as a part of it: of a prediction by its inputs,
        of a background by the clusters of its image; NaN where they are not stated
    shared : of a prediction's n pixels, how many are among those that it is compared with; None: as many as can be
    mean_bias : how far the mean lies from that of endless pixels, where those scored made the filter; else NaN
    """

    mean: float
    sd: float
    n: int | None = None
    grid: Array | None = field(default=None, compare=False, repr=False)
    density: Array | None = field(default=None, compare=False, repr=False)
    greatest: Array | None = field(default=None, compare=False, repr=False)
    mean_error: float = field(default=float("nan"), compare=False)
    mean_bias: float = field(default=float("nan"), compare=False)
    sd_error: float = field(default=float("nan"), compare=False)
    shared: int | None = field(default=None, compare=False)

    def errors(self, beside: ScoreDistribution | None = None) -> Array:
        """(2,) mean_error and sd_error, those of n independent normal pixels where they are not stated.

        Beside a prediction measured on m pixels, s of which are among these, their clusters count (1/n + 1/m - 2 s/nm)
        over 1/n as much: not at all where both are the same pixels.
        """
        n = self.n or 1
        free, part = n - 1.0 or math.nan, 1.0
        if beside is not None and beside.n:
            part += (n - 2.0 * min(n, beside.n, *(() if beside.shared is None else (beside.shared,)))) / beside.n
        plain, stated = np.array([[self.sd / math.sqrt(n), math.sqrt(0.5 / free)], [self.mean_error, self.sd_error]])
        parts = np.where([math.isnan(self.mean_bias), True], part, 1.0)
        return np.asarray(np.sqrt(np.maximum(plain**2 + parts * np.nan_to_num(stated**2 - plain**2), 0.0)))


@dataclass(frozen=True)
class AreaEstimate:
    """An area under a measured ROC with its 95 % interval.

    Attributes
    ----------
    value, lower, upper : mean detection probability over the range of false-alarm probabilities [1]
    method : how the interval was made, in a few words
    placements : (m,) the part that each target has in the value, which is their mean
    background_variance : sampling variance of the value that the background brings
    """

    value: float
    lower: float
    upper: float
    method: str = ""
    placements: Array | None = field(default=None, compare=False, repr=False)
    background_variance: float = 0.0


@dataclass(frozen=True)
class AlarmsAtDetection:
    """False alarms at the highest threshold that reaches a stated detection probability.

    Attributes
    ----------
    pd : the stated detection probability
    threshold : score from which on pixels are declared
    alarms : background samples declared
    pfa : ``alarms`` over the background samples
    pfa_lower, pfa_upper : 95 % interval of P_FA at the true P_D: background and targets both sampled
    fixed_lower, fixed_upper : exact interval of P_FA at this threshold as it stands
    """

    pd: float
    threshold: float
    alarms: int
    pfa: float
    pfa_lower: float
    pfa_upper: float
    fixed_lower: float
    fixed_upper: float


@dataclass(frozen=True)
class RocCurve:
    """Probability of detection against probability of false alarm, with intervals.

    Attributes
    ----------
    pfa : (K,) increasing false-alarm probabilities, log-spaced
    pd : (K,) detection probability at each
    pd_lower, pd_upper : (K,) 95 % interval of ``pd``
    threshold : (K,) detector score at which each point is reached
    unit : what ``pd`` counts: pixels or target objects
    n_target : pixels or objects counted, None for a prediction
    n_background : background pixels behind ``pfa``, None for a prediction
    background_area_km2 : ground area of the background pixels, for alarms per km2; None when unknown
    preset_pfa : (K,) greatest false-alarm probability of any one class at ``threshold``: the preset of (3.30) read
        as the curve's abscissa; None for a measurement
    alarms : (K,) background samples above the threshold; None for a prediction
    design_effect : (K,) how many times as large the variance of their number is as that of independent samples
    alarms_before_first : background pixels that score as high as the best target pixel or higher, where asked for
    """

    pfa: Array
    pd: Array
    pd_lower: Array
    pd_upper: Array
    threshold: Array
    unit: Literal["pixel", "object"] = "pixel"
    n_target: int | None = None
    n_background: int | None = None
    background_area_km2: float | None = None
    alarms: Counts | None = field(default=None, compare=False, repr=False)
    design_effect: Array | None = field(default=None, compare=False, repr=False)
    areas: Mapping[str, AreaEstimate] = field(default_factory=dict, compare=False)
    at_detection: tuple[AlarmsAtDetection, ...] = ()
    preset_pfa: Array | None = None
    alarms_before_first: int | None = None

    @property
    def has_limits(self) -> bool:
        """Whether an uncertainty is stated: without one the limits are P_D itself, and no interval.

        >>> p = np.array([0.1, 0.2, 0.3])
        >>> [RocCurve(p, p, p, p + above, p).has_limits for above in (0.0, np.array([np.nan, 0.0, 0.1]))]
        [False, True]
        """
        return bool(np.any(self.pd_upper - self.pd_lower > 1e-12))


@dataclass(frozen=True)
class ObjectScores:
    """Scores of the whole objects of one subject: the greatest over the pixels of each [1].

    Attributes
    ----------
    values : measured: (n,) one for each object.  Predicted: (S, R) draws of an object's score; a row shares one
        draw of the uncertain inputs, the same in that row of every subject; within a row objects are independent
    names : of the measured objects; empty for a prediction
    """

    values: Array = field(compare=False, repr=False)
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Influence:
    """What predicted over measured P_FA is without each of G parts of the image, left out of both sides.

    Attributes
    ----------
    number : (lines, samples) part of each pixel; -1 where none is counted
    alarms : (G, T) that each holds
    threshold : (T,) increasing
    ratio : (G, T)
    """

    number: npt.NDArray[Any]
    alarms: Array
    threshold: Array
    ratio: Array

    def at(self, threshold: float) -> Array:
        """(G,) ratios at a threshold, linear in their logarithm between those that are known."""
        return np.exp([np.interp(threshold, self.threshold, one) for one in np.log(self.ratio)])


@dataclass(frozen=True)
class ExceedanceCurve:
    """How often the background's score lies above a threshold.

    Attributes
    ----------
    threshold : (T,) increasing [1]
    probability : (T,) part of the background above it [1]
    lower, upper : (T,) 95 % interval, that of a measured curve by blocks of the image, of a predicted one by
        leaving parts of the image out of the law that was fitted to it; NaN where unknown
    n : background pixels, None for a prediction
    half_image : (T,) factor by which one half of the image misses the other half's; None for a prediction
    correlation : (T,) of a prediction's error with that of the measured share, where both are of the same pixels
    left_out : region -> (G, T) ln P of a prediction without each part of the pixels that its law was fitted to
    influence : the same of both sides
    """

    threshold: Array
    probability: Array
    lower: Array
    upper: Array
    n: int | None = None
    half_image: Array | None = None
    correlation: Array | None = None
    left_out: Mapping[str, Array] = field(default_factory=dict, compare=False, repr=False)
    influence: Influence | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class Abundance:
    """Area of a target from the sum of its scores times the pixel area.

    Attributes
    ----------
    area_m2, standard_uncertainty : estimate and its standard uncertainty [m2]
    n : pixels summed
    nominal_m2 : area that the truth states, where both sides estimate it; None where the prediction is that area
    modelled : False where the predicted area is the truth's, which no model moves
    """

    area_m2: float
    standard_uncertainty: float
    n: int | None = None
    nominal_m2: float | None = None
    modelled: bool = True


@dataclass(frozen=True)
class PixelDistribution:
    """How the pixels of a class are distributed about their mean, whatever their covariance.

    A linear change of the bands, such as an empirical line, leaves all of it as it is.

    Attributes
    ----------
    tail_dof : degrees of freedom of a multivariate t; inf for the normal law
    tail_lower, tail_upper : its 95 % interval; NaN for a definition
    normality_p_value : of the likelihood ratio of normal and t; NaN for a definition
    dimension : bands in which distances were taken, None for a definition
    leading_tail_dof, leading_lower, leading_upper : the same in the few leading components that hold nearly all
        variance, where noise does not dilute the surface's own tails
    leading_scale : factor on the covariance that goes with them
    leading_dimension : number of those
    n : pixels of the sample, None for a definition
    effective_n : (K,) independent pixels behind the variance along the leading components; None for a definition
    distance, exceedance : (Q,) squared Mahalanobis distances and the share of pixels beyond each
    samples : columns of the image that the pixels lie in, None for a definition
    clusters : part, offset (B,) from the mean, covariance (B, B) and degrees of freedom of the laws that together
        are a predicted class; none where it is one law
    """

    tail_dof: float = math.inf
    tail_lower: float = math.nan
    tail_upper: float = math.nan
    normality_p_value: float = math.nan
    dimension: int | None = None
    leading_tail_dof: float = math.nan
    leading_lower: float = math.nan
    leading_upper: float = math.nan
    leading_dimension: int | None = None
    n: int | None = None
    effective_n: Array | None = field(default=None, compare=False, repr=False)
    distance: Array | None = field(default=None, compare=False, repr=False)
    exceedance: Array | None = field(default=None, compare=False, repr=False)
    samples: int | None = None
    clusters: Sequence[tuple[float, Array, Array, float]] = field(default=(), compare=False, repr=False)
    leading_scale: float = 1.0


@dataclass(frozen=True)
class ClassificationError:
    """How often a Gaussian maximum-likelihood classifier takes pixels of some classes for another of them.

    Attributes
    ----------
    error : probability of error, classes equally likely [1]
    lower, upper : 95 % interval of ``error``
    n : pixels classified
    effective_n : of them, as many count as independent; None for a prediction
    distance : least Bhattacharyya distance of two of the classes
    approximation : error estimated from the distances, Phi(-sqrt(2 B)) of a pair (Kerekes & Landgrebe 1989)
    bound_lower, bound_upper : limits of the least error of normal classes with these distances
    """

    error: float
    lower: float
    upper: float
    n: int | None = None
    effective_n: float | None = None
    distance: float = math.nan
    approximation: float = math.nan
    bound_lower: float = math.nan
    bound_upper: float = math.nan


# Products that are spectra by band.
SPECTRA = ("radiance", "snr", "reflectance", "toa_reflectance")
ANOMALIES = "anomalies"  # the subject of scores of every pixel, where no target is looked for
# Name under which ``scores`` holds the background's score for the filter of a target subject.
background_of = "{} background".format


@dataclass(frozen=True, repr=False)
class Products:
    """Everything one side says of one scenario or collection.

    The keys of ``radiance``, ``snr``, ``reflectance`` and ``toa_reflectance`` (at the top of the atmosphere)
    are subjects (a class, panel or site); those of ``scores`` are (subject, detector), with the background seen
    through a target's filter under (:func:`background_of` (subject), detector); those of ``roc`` and
    ``abundance`` are (subject, detector) with the unit kept in the curve, so that (subject, detector,
    "pixel"|"object"|"object-by-pixel") names a curve; those of ``object_scores`` are (subject, detector), those
    of ``exceedance`` (what is looked for, detector). ``distribution`` goes by subject, ``classification`` by
    (classes, features), such as ("grass / asphalt", "2 bands").
    """

    axis: SpectralAxis
    radiance: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    snr: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    reflectance: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    scores: Mapping[tuple[str, str], ScoreDistribution] = field(default_factory=dict)
    roc: Mapping[tuple[str, str, str], RocCurve] = field(default_factory=dict)
    abundance: Mapping[tuple[str, str], Abundance] = field(default_factory=dict)
    object_scores: Mapping[tuple[str, str], ObjectScores] = field(default_factory=dict)
    exceedance: Mapping[tuple[str, str], ExceedanceCurve] = field(default_factory=dict)
    distribution: Mapping[str, PixelDistribution] = field(default_factory=dict)
    classification: Mapping[tuple[str, str], ClassificationError] = field(default_factory=dict)
    toa_reflectance: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Bands, and how much there is of each product: the arrays would fill a book.

        >>> Products(SpectralAxis([1.0, 2.0], 1.0), snr={"lawn": SpectralEstimate(np.ones(2), np.eye(2))})
        <Products of 2 bands by number: 1 snr>
        """
        held = [(f.name, getattr(self, f.name)) for f in fields(self)]
        counts = [f"{len(v)} {k}" for k, v in held if k not in ("axis", "notes", "provenance") and v]
        return f"<{type(self).__name__} of {self.axis.words}: {', '.join(counts)}>"


@dataclass(frozen=True, repr=False)
class PredictedProducts(Products):
    """The products as the model gives them, and what only a model knows.

    ``noise``: subject -> source of noise (shot, fixed, quantisation, bit_errors, calibration, fit) -> (B,) variance
    [(uW cm-2 sr-1 nm-1)^2]; ``full_scale``: subject -> (B,) mean radiance as a part of full scale, where the sensor
    file says where that is; ``expected_scores``: (what lies there, target, detector) -> mean score of such a pixel
    under the filter that looks for the target [1].
    """

    noise: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    full_scale: Mapping[str, Array] = field(default_factory=dict)
    expected_scores: Mapping[tuple[str, str, str], float] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class ObservedProducts(Products):
    """The products as the collection gives them."""
