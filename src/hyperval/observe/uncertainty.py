"""What is known of the error of collected spectra."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import CalibrationUncertainty
from hyperval.prediction.inputs import correlation
from hyperval.products import SpectralEstimate
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.readers import read_spectrum

Array = npt.NDArray[np.float64]


def calibration_covariance(
    radiance: npt.ArrayLike,
    axis: SpectralAxis,
    calibration: CalibrationUncertainty,
    resolve: Callable[[str], Path],
) -> Array:
    """Error covariance (B, B) of a radiance (B,) whose calibration is known to a relative uncertainty."""
    if calibration.relative is not None:
        relative = np.full(len(axis), calibration.relative)
    else:
        table = read_spectrum(resolve(str(calibration.file)), quantity="other", wavelength_unit="nm")
        # The table is smooth; a band of the axis outside it takes the value at its end.
        relative = np.interp(axis.centre_nm, table.wavelength_nm, table.values)
    sigma = relative * np.asarray(radiance, dtype=float)
    return np.outer(sigma, sigma) * correlation(axis, calibration.correlation_nm)


def spectral_estimate(
    mean: npt.ArrayLike,
    parts: Mapping[str, npt.NDArray[np.float64]],
    *,
    pixel_covariance: Array | None = None,
    n: int | None = None,
    dof: Mapping[str, float] | None = None,
) -> SpectralEstimate:
    """Estimate whose error covariance is the sum of independent ``parts`` (B, B), each named in the budget.

    ``dof``: degrees of freedom of the parts that were estimated from samples.
    """
    mean = np.asarray(mean, dtype=float)
    total = sum(parts.values(), np.zeros((mean.size, mean.size)))
    budget = {name: np.sqrt(np.clip(np.diag(part), 0.0, None)) for name, part in parts.items()}
    estimated = tuple((parts[name], v) for name, v in (dof or {}).items())
    return SpectralEstimate(mean, total, pixel_covariance, n, budget, estimated)
