"""The empirical line of a collection, with the errors of its panels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import EmpiricalLineSource, PanelReference
from hyperval.errors import UsageError
from hyperval.imagery.cube import Cube
from hyperval.prediction.inputs import Sources, correlation
from hyperval.processing.elm import PanelMeasurement, fit_elm
from hyperval.processing.elm_error import LineError, PanelErrors, line_error
from hyperval.processing.elm_in_scene import darkest_pixel_panel, fit_gain
from hyperval.processing.region_statistics import darkest_values
from hyperval.processing.sample import SampleStatistics

Array = npt.NDArray[np.float64]


def empirical_line(
    source: EmpiricalLineSource | None,
    measured: Mapping[str, SampleStatistics],
    sampling: Mapping[str, Array],
    cube: Cube,
    resolve: Callable[[str], Path],
) -> LineError | None:
    """The line through the panels that a collection names; None without any.

    Parameters
    ----------
    sampling : region -> error covariance (B, B) of its mean radiance

    Raises
    ------
    UsageError : a panel that is no region, or panels that fix no line.
    """
    if source is None:
        return None
    panels, errors = [], []
    for panel in source.panels:
        if panel.region not in measured:
            raise UsageError(
                f"empirical line: no region {panel.region!r}", expected="one of " + ", ".join(measured)
            )
        mean, covariance = _field(panel, cube, resolve)
        sample = measured[panel.region]
        error = sampling[panel.region]
        sd = np.sqrt(np.diag(covariance))
        panels.append(PanelMeasurement(panel.region, mean, sd, sample.mean, np.diag(error).copy(), sample.n))
        errors.append(PanelErrors(covariance, error))
    if source.darkest_pixel is not None:
        dark = source.darkest_pixel
        noise = np.full(len(cube.axis), dark.radiance_noise**2)
        found = darkest_pixel_panel(darkest_values(cube), noise, dark.reflectance, dark.uncertainty)
        panels.append(found)
        # What the darkest surface truly reflects is one unknown for all bands; its noise is each band's own.
        u = found.reflectance_sd
        errors.append(PanelErrors(np.outer(u, u), np.diag(found.radiance_variance)))
    return line_error(fit_elm if source.intercept else fit_gain, panels, errors)


def _field(panel: PanelReference, cube: Cube, resolve: Callable[[str], Path]) -> tuple[Array, Array]:
    """Reflectance (B,) of a panel as measured on the ground, and its error covariance (B, B).

    What replicate spectra say, or the standard error that the file carries, and the stated relative uncertainty;
    the latter two with the stated correlation length, common to all bands without one.
    """
    field = Sources(cube.axis, {}, resolve).spectrum(panel.spectrum, panel.region)
    stated, together = panel.relative_uncertainty * field.mean, correlation(cube.axis, panel.correlation_nm)
    covariance = np.outer(stated, stated) * together
    if field.mean_error is not None:
        covariance = covariance + field.mean_error
    elif field.standard_deviation is not None:
        spread = field.standard_deviation / np.sqrt(field.n or 1)
        covariance = covariance + np.outer(spread, spread) * together
    return field.mean, covariance
