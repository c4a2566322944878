"""The products both sides of a comparison hold, under the same names on the same axis.

``predict`` fills them from statistics, ``observe`` from pixels; after that nothing knows which
side a product came from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


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
    """

    mean: Array
    error_covariance: Array
    pixel_covariance: Array | None = None
    n: int | None = None
    budget: Mapping[str, Array] = field(default_factory=dict)

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
    n : pixels behind them, None for a prediction
    grid, density : (G,) scores and the probability density at each [per unit of score]; None without
    """

    mean: float
    sd: float
    n: int | None = None
    grid: Array | None = field(default=None, compare=False, repr=False)
    density: Array | None = field(default=None, compare=False, repr=False)


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


@dataclass(frozen=True)
class Abundance:
    """Area of a target from the sum of its scores times the pixel area.

    Attributes
    ----------
    area_m2, standard_uncertainty : estimate and its standard uncertainty [m2]
    """

    area_m2: float
    standard_uncertainty: float
    n: int | None = None


def background_of(subject: str) -> str:
    """Name under which ``scores`` holds the background's score for the filter of a target subject."""
    return f"{subject} background"


@dataclass(frozen=True)
class Products:
    """Everything one side says of one scenario or collection.

    The keys of ``radiance``, ``snr``, ``reflectance`` are subjects (a class, panel or site); those of
    ``scores`` are (subject, detector), with the background seen through a target's filter under
    (:func:`background_of` (subject), detector); those of ``roc`` and ``abundance`` are (subject, detector) with
    the unit kept in the curve, so that (subject, detector, "pixel"|"object") names a curve.
    """

    axis: SpectralAxis
    radiance: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    snr: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    reflectance: Mapping[str, SpectralEstimate] = field(default_factory=dict)
    scores: Mapping[tuple[str, str], ScoreDistribution] = field(default_factory=dict)
    roc: Mapping[tuple[str, str, str], RocCurve] = field(default_factory=dict)
    abundance: Mapping[tuple[str, str], Abundance] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Prediction(Products):
    """The products as the model gives them, and what only a model knows.

    ``noise``: subject -> source of noise (shot, fixed, quantisation, bit_errors, calibration, fit) -> (B,) variance
    [(uW cm-2 sr-1 nm-1)^2]; ``full_scale``: subject -> (B,) mean radiance as a part of full scale, where the sensor
    file says where that is.
    """

    noise: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)
    full_scale: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Observation(Products):
    """The products as the collection gives them."""
