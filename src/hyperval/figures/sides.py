"""What figures take from a run: its two sides, its maps and pictures, the spread of its pixels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.model.intervals import difference_ratio, difference_ratio_uncertainty
from hyperval.products import Products, SpectralEstimate
from hyperval.spectra.axis import SpectralAxis, in_window

Array = npt.NDArray[np.float64]
Sides = tuple[Products | None, Products | None]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ExpectedScores:
    """The score that the model expects of each pixel of which the collection says what lies there.

    Attributes
    ----------
    content : (lines, samples) number of what lies there, -1 where that is not known; maps of one scene share it
    scores : (K + 1,) of each number [1]; the last, which -1 finds, is NaN
    """

    content: npt.NDArray[np.int16]
    scores: npt.NDArray[np.float32]

    def of(self, part: tuple[slice, slice]) -> npt.NDArray[np.float32]:
        """Some lines and samples as a map [1]; NaN where nothing is expected."""
        return self.scores[self.content[part]]


@dataclass(frozen=True)
class ScoreMap:
    """A detector's score for every pixel.

    Attributes
    ----------
    values : (lines, samples) score [1]; NaN where there is none
    transform : affine pixel-to-map transform (six numbers a, b, c, d, e, f, or an object that yields them
        first), None for an image without georeference
    crs : coordinate reference system as text (EPSG:32618 or WKT), None when unknown
    outlines : name of a target -> (lines, samples) mask of its pixels
    pixel_size_m : ground sampling distance for the scale [m], None when unknown
    expected : what the model expects in its place, None where it says nothing
    """

    values: npt.NDArray[Any]
    transform: Sequence[float] | None = None
    crs: str | None = None
    outlines: Mapping[str, Mask] = field(default_factory=dict)
    pixel_size_m: float | None = None
    expected: ExpectedScores | None = None

    def to_xarray(self) -> Any:
        """As an array of xarray (line, sample) with its position."""
        from hyperval.imagery.interchange import map_to_xarray

        return map_to_xarray(self.values, self.transform, self.crs, "score")

    def to_spy(self) -> Any:
        """As an image of SPy with one band."""
        from hyperval.imagery.interchange import map_to_spy

        return map_to_spy(self.values, "score")


@dataclass(frozen=True)
class Quicklook:
    """A picture of the scene with its regions of interest.

    Attributes
    ----------
    rgb : (lines, samples, 3) uint8
    regions : name -> (lines, samples) mask
    band_nm : centres of the red, green and blue bands [nm]
    pixel_size_m : ground sampling distance for the scale [m], None when unknown
    """

    rgb: npt.NDArray[np.uint8]
    regions: Mapping[str, Mask] = field(default_factory=dict)
    band_nm: tuple[float, ...] = ()
    pixel_size_m: float | None = None


@dataclass(frozen=True)
class EigenvalueSpectrum:
    """Leading eigenvalues of one class's covariance from pixel to pixel, largest first.

    Attributes
    ----------
    measured : (K,) of the collection
    expected, lower, upper : (K,) mean and 95 % limits of those of as many pixels drawn from the prediction
    n : pixels
    """

    measured: npt.NDArray[np.float64]
    expected: npt.NDArray[np.float64]
    lower: npt.NDArray[np.float64]
    upper: npt.NDArray[np.float64]
    n: int


@dataclass(frozen=True)
class TailCurve:
    """Share of a class's pixels beyond a distance from its mean.

    Attributes
    ----------
    distance : (Q,) Mahalanobis distance [standard deviations]
    measured, lower, upper : (Q,) share of pixels beyond it and its 95 % limits
    predicted, normal, fitted : (Q,) probability under the predicted law, the normal one, and the fitted t; the
        first None where nothing was predicted
    predicted_dof, fitted_dof : degrees of freedom of these, inf for the normal law
    dimension : components in which the distance is taken
    n : pixels
    """

    distance: npt.NDArray[np.float64]
    measured: npt.NDArray[np.float64]
    lower: npt.NDArray[np.float64]
    upper: npt.NDArray[np.float64]
    predicted: npt.NDArray[np.float64] | None
    normal: npt.NDArray[np.float64]
    fitted: npt.NDArray[np.float64]
    predicted_dof: float | None
    fitted_dof: float
    dimension: int
    n: int


def of_side(side: Products | None, product: str) -> Mapping[Any, Any]:
    """A product of a side, empty where the side is absent."""
    return {} if side is None else getattr(side, product)


def both_first(predicted: Mapping[Any, Any], measured: Mapping[Any, Any]) -> list[Any]:
    """Keys of either side: those of both sides before those of one."""
    common = [key for key in predicted if key in measured]
    return common + [k for k in predicted if k not in measured] + [k for k in measured if k not in predicted]


def drawn_of(sides: Sides, product: str) -> tuple[list[Mapping[Any, Any]], list[Any], bool]:
    """A product of both sides, the keys that are drawn, and whether both sides hold these.

    Where anything can be compared, what only one side holds is left to products.nc.
    """
    both = [of_side(side, product) for side in sides]
    pairs = [key for key in both[0] if key in both[1]]
    return both, pairs or both_first(*both), bool(pairs)


def difference(predicted: SpectralEstimate, measured: SpectralEstimate, ratio: bool) -> tuple[Array, Array]:
    """(B,) predicted - measured, or that over measured, and its standard uncertainty, independent."""
    p, c, up, uc = predicted.mean, measured.mean, predicted.standard_uncertainty, measured.standard_uncertainty
    if ratio:
        return difference_ratio(p, c), difference_ratio_uncertainty(p, c, up, uc)
    return p - c, np.hypot(up, uc)


def in_windows(axis: SpectralAxis) -> npt.NDArray[np.bool_]:
    """Bands in the windows of the atmosphere; all, where none is."""
    keep = in_window(axis.centre_nm)
    return keep if keep.any() else np.ones(keep.shape, bool)
