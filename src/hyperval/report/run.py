"""What a report is made from: one results table, the two sides, and where everything came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.products import Observation, Prediction
from hyperval.report.power import PowerTable
from hyperval.results import ResultTable

Mask = npt.NDArray[np.bool_]
WARNING = "warning: "  # what a note that warns begins with


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


@dataclass(frozen=True)
class RunReport:
    """One campaign's run, ready to be written.

    Attributes
    ----------
    campaign, title, description : name (also of the output folder), heading, a sentence or two
    simulated : True when the collection is simulated; every page and figure then says so
    computed : True when the reference is what another program computed, and no imagery
    table : every planned comparison, one row each
    prediction, observation : the two sides, None where a side was not run
    score_maps : "TARGET-DETECTOR" -> map
    quicklook : picture of the scene
    provenance : ``inputs`` is a list of mappings with the keys reference, sha256, licence, citation and,
        optionally, products (the products that use it); the other keys (versions, command, seed,
        formulation, ...) are shown as they are
    notes : assumptions made, what was left out
    references : literature
    eigenvalues : (subject, quantity) -> eigenvalues of both sides
    tails : subject -> tails of both sides
    chosen_after : (what, as it was before) of each range that was chosen after its data were seen
    power : which standard errors the campaign would see, None where that was not worked out
    remedy : how to get the collection of a run that was skipped for lack of it
    kind : what the page is: "Campaign" for both sides compared, else what it shows
    sentence : what the page says first where it compares something else than a model with a collection
    """

    campaign: str
    title: str
    description: str
    simulated: bool
    table: ResultTable
    prediction: Prediction | None = None
    observation: Observation | None = None
    score_maps: Mapping[str, ScoreMap] = field(default_factory=dict)
    quicklook: Quicklook | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[str] = ()
    references: Sequence[str] = ()
    eigenvalues: Mapping[tuple[str, str], EigenvalueSpectrum] = field(default_factory=dict)
    tails: Mapping[str, TailCurve] = field(default_factory=dict)
    chosen_after: Sequence[tuple[str, str]] = ()
    power: PowerTable | None = None
    kind: str = "Campaign"
    sentence: str = ""
    computed: bool = False
    remedy: str = ""

    @property
    def warnings(self) -> list[str]:
        """Those of the notes that warn."""
        return [note for note in self.notes if note.startswith(WARNING)]
