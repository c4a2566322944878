"""Errors of field spectra."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hyperval.errors import UsageError
from hyperval.prediction.forms import form_covariance
from hyperval.prediction.inputs import SurfaceStatistics
from hyperval.scenario_uncertainty import SpectrumUncertainty
from hyperval.sensor.specification import Sensor
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]


def spectrum_error_covariance(
    item: SpectrumUncertainty, surface: SurfaceStatistics, axis: SpectralAxis, sensor: Sensor | None = None
) -> Array:
    """Error covariance (B, B) of the field spectrum of one subject [1].

    Raises
    ------
    UsageError : as :func:`spectrum_error_sd`, or arms without a sensor.
    """
    return form_covariance(spectrum_error_sd(item, surface, axis), item, axis, sensor)


def spectrum_error_sd(item: SpectrumUncertainty, surface: SurfaceStatistics, axis: SpectralAxis) -> Array:
    """Standard uncertainty (B,) of the field spectrum of one subject [1].

    Raises
    ------
    UsageError : the file carries no standard deviation, or no n for a standard error.
    """
    if item.from_file:
        if surface.standard_deviation is None:
            raise UsageError(f"uncertainty of {item.subject!r}: its spectrum's file carries no standard deviation")
        sd = np.nan_to_num(surface.standard_deviation)
        if item.divisor == "standard_error":
            if not surface.n:
                raise UsageError(
                    f"uncertainty of {item.subject!r}: the file does not say how many spectra it averages",
                    mend="use divisor: spread",
                )
            sd = sd / np.sqrt(surface.n)
    else:
        sd = (
            np.full(len(axis), item.absolute)
            if item.absolute
            else (item.relative or 0.0) * np.nan_to_num(surface.mean)
        )
    return np.asarray(sd)
