"""Draws of the uncertain inputs that all objects share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from hyperval.prediction.batch import Batch
from hyperval.prediction.inputs import correlation, cut
from hyperval.scenario_uncertainty import Uncertainty

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

ROWS = 1600
# The blur's distribution stands on this many equally likely widths.
_WIDTHS = 5


@dataclass(frozen=True)
class InputDraws:
    """Draws of the uncertain inputs that all objects share.

    Attributes
    ----------
    spectra : target -> (S, F) departure of its reflectance from the field spectrum
    collected : target -> (S, F) departure of its reflectance as the collection holds it
    steps : (S, K) scalar inputs of the view, in standard uncertainties
    blur : (S,) width, in standard uncertainties, one of few values
    """

    spectra: Mapping[str, Array]
    collected: Mapping[str, Array]
    steps: Array
    blur: Array

    @property
    def rows(self) -> int:
        """S."""
        return int(self.blur.size)


def input_draws(batch: Batch, uncertainty: Uncertainty, bands: Index, steps: int) -> InputDraws:
    """Draws of what the scenario calls uncertain; one row of zeros when nothing is.

    Rows come in pairs of opposite sign, so that means carry no sampling error to first order.

    Parameters
    ----------
    bands : of the detector
    steps : scalar inputs of light and sensor
    """
    error = uncertainty.collected_reflectance
    spectrum_error = {t.name: cut(batch.errors[t.name], bands) for t in batch.targets if t.name in batch.errors}
    uncertain = steps or spectrum_error or error or uncertainty.psf_fwhm_pixels or uncertainty.position_m
    if not uncertain:
        return InputDraws({}, {}, np.zeros((1, 0)), np.zeros(1))
    rng = np.random.default_rng([batch.scenario.processing.seed, 7])
    spectra = {name: _normal(rng, covariance) for name, covariance in spectrum_error.items()}
    collected = {}
    if error is not None:
        shape = correlation(batch.axis.select(bands), error.correlation_nm)
        scaled, shifted = _normal(rng, shape), _normal(rng, shape)
        surfaces = batch.settings.grounds[0].surfaces
        collected = {
            t.name: error.relative * scaled * surfaces[t.name].mean[bands] + error.absolute * shifted
            for t in batch.targets
        }
    widths = ndtri((np.arange(_WIDTHS) + 0.5) / _WIDTHS)
    blur = rng.permutation(np.resize(widths / widths.std(), ROWS))
    if uncertainty.psf_fwhm_pixels is None:
        blur = np.zeros(ROWS)
    return InputDraws(spectra, collected, _pairs(rng, steps), blur)


def _pairs(rng: np.random.Generator, columns: int) -> Array:
    """(ROWS, columns) standard normal numbers in pairs of opposite sign."""
    half = rng.standard_normal((ROWS // 2, columns))
    return np.concatenate([half, -half])


def _normal(rng: np.random.Generator, covariance: Array) -> Array:
    """(ROWS, F) draws of a normal vector."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(_pairs(rng, values.size) @ (vectors * np.sqrt(np.clip(values, 0.0, None))).T)
