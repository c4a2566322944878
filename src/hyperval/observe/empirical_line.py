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
from hyperval.prediction.replicates import band_error_covariance
from hyperval.processing.elm import EmpiricalLine, PanelMeasurement, fit_elm
from hyperval.processing.elm_error import LineError, PanelErrors, contradiction, line_error
from hyperval.processing.elm_in_scene import darkest_pixel_panel, fit_gain
from hyperval.processing.region_statistics import darkest_values
from hyperval.processing.sample import SampleStatistics
from hyperval.products import EstimatedPart
from hyperval.spectra.axis import SpectralAxis

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_PIXELS_AT_ONCE = 10_000
FEWEST_USABLE = 0.8  # of the good bands
MOST_LEFT_OUT = 0.05  # reflectance that the other panels may be off by


def empirical_line(
    source: EmpiricalLineSource | None,
    measured: Mapping[str, SampleStatistics],
    sampling: Mapping[str, EstimatedPart],
    cube: Cube,
    resolve: Callable[[str], Path],
) -> LineError | None:
    """The line through the panels that a collection names; None without any.

    Parameters
    ----------
    sampling : region -> error of its mean radiance

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
        mean, covariance = field_reflectance(panel, cube.axis, resolve)
        sample = measured[panel.region]
        part = sampling[panel.region]
        error = part.covariance
        sd = np.sqrt(np.diag(covariance))
        panels.append(PanelMeasurement(panel.region, mean, sd, sample.mean, np.diag(error).copy(), sample.n))
        errors.append(PanelErrors(covariance, error, part if sample.n > 1 else None))
    if source.darkest_pixel is not None:
        dark = source.darkest_pixel
        noise = np.full(len(cube.axis), dark.radiance_noise**2)
        darkest = darkest_pixel_panel(darkest_values(cube), noise, dark.reflectance, dark.uncertainty)
        panels.append(darkest)
        # What the darkest surface truly reflects is one unknown for all bands; its noise is each band's own.
        u = darkest.reflectance_sd
        errors.append(PanelErrors(np.outer(u, u), np.diag(darkest.radiance_variance)))
    return line_error(fit_elm if source.intercept else fit_gain, panels, errors)


def refuse_saturated(source: EmpiricalLineSource | None, masks: Mapping[str, Mask], cube: Cube) -> None:
    """Raise UsageError for a panel with a pixel at which the detector, or the stored type, is full in a good band.

    Parameters
    ----------
    masks : (lines, samples) pixels behind the mean of each region
    """
    for panel in source.panels if source is not None else ():
        lines, samples = np.nonzero(masks.get(panel.region, np.zeros((1, 1), bool)))
        count, first = 0, cube.bands
        for some in range(0, lines.size, _PIXELS_AT_ONCE):
            at = slice(some, some + _PIXELS_AT_ONCE)
            values, valid = cube.marked_pixels((lines[at], samples[at]))
            full = np.zeros(values.shape, bool)
            if source is not None and source.saturation is not None:
                full |= values >= source.saturation
            if cube.dtype.kind in "iu":
                full |= values == cube.gain * float(np.iinfo(cube.dtype).max) + cube.offset
            full &= valid[:, None] & cube.axis.good
            count += int(full.any(axis=1).sum())
            first = min(first, *np.flatnonzero(full.any(axis=0)).tolist(), cube.bands)
        if count:
            raise UsageError(
                f"panel {panel.region!r} is saturated in {count} of {lines.size} pixels "
                f"(first: band {first + 1}, {cube.axis.centre_nm[first]:.4g} nm)",
                where="collection.empirical_line",
                mend="leave out the panel, those pixels of its region, or those bands (bad-band list)",
            )


def line_warnings(elm: EmpiricalLine, axis: SpectralAxis) -> list[str]:
    """Why a line is not to be relied on: bands lost, panels that do not lie on one line."""
    out = []
    good = int(axis.good.sum())
    usable = int((elm.usable & axis.good).sum())
    if usable < FEWEST_USABLE * good:
        out.append(f"the empirical line can be used in {usable} of {good} good bands only")
    if (chi2 := contradiction(elm)) > 1.0:
        out.append(
            "the panels of the empirical line do not lie on one line within their stated errors: reduced "
            f"chi-square {chi2:.3g} (median over bands), by which the line's variance is widened"
        )
    out += [
        f"the other panels of the empirical line give {name} a reflectance that is off by "
        f"{np.median(np.abs(known)):.2g} (median over bands)"
        for name, known in _left_out(elm, axis).items()
        if known.size and np.median(np.abs(known)) > MOST_LEFT_OUT
    ]
    return [f"warning: {line}" for line in out]


def _left_out(elm: EmpiricalLine, axis: SpectralAxis) -> dict[str, Array]:
    """Error of each panel's reflectance by the line through the others, where the line can be used and has one."""
    if elm.leave_one_out is None:
        return {}
    errors = elm.leave_one_out[:, elm.usable & axis.good]
    return {name: error[np.isfinite(error)] for name, error in zip(elm.panels, errors, strict=True)}


def line_notes(elm: EmpiricalLine, axis: SpectralAxis) -> list[str]:
    """What is to be said of a line: its panels, the bands it cannot be used in, how well its panels agree."""
    notes = [f"empirical line through {', '.join(elm.panels)}: usable in {int(elm.usable.sum())} bands"]
    if not elm.usable.all():
        lost = ", ".join(f"{w:.4g}" for w in axis.centre_nm[~elm.usable])
        notes[0] += f"; no gain at {lost} nm"
    if (elm.usable & axis.good).any() and (left_out := _left_out(elm, axis)):
        parts = []
        for name, known in left_out.items():
            if not known.size:
                parts.append(f"{name} unknown, the others do not fix a line")
                continue
            worst = known[np.abs(known).argmax()]
            parts.append(f"{name} {np.median(known):+.2g} (median over bands, at most {worst:+.2g})")
        notes.append(
            "leave-one-panel-out error of the empirical line, reflectance by the other panels less that measured "
            "on the ground: " + "; ".join(parts)
        )
    chi2 = elm.reduced_chi2[np.isfinite(elm.reduced_chi2)]
    if chi2.size:
        notes.append(f"empirical line: reduced chi-square of its panels {np.median(chi2):.3g} (median over bands)")
    return [*notes, *line_warnings(elm, axis)]


def field_reflectance(
    panel: PanelReference, axis: SpectralAxis, resolve: Callable[[str], Path]
) -> tuple[Array, Array]:
    """Reflectance (B,) of a panel as measured on the ground, and its error covariance (B, B).

    What replicate spectra say, or the standard error that the file carries, and the stated relative uncertainty;
    the latter two with the stated correlation length, common to all bands without one.  The file's standard error
    holds between its own samples, of which a band may average several.
    """
    field = Sources(axis, {}, resolve).spectrum(panel.spectrum, panel.region)
    stated, together = panel.relative_uncertainty * field.mean, correlation(axis, panel.correlation_nm)
    covariance = np.outer(stated, stated) * together
    n = 1 if panel.divisor == "spread" else field.n or 1
    if field.mean_error is not None:
        covariance = covariance + field.mean_error
    elif field.sampled_deviation is not None and panel.correlation_nm is not None:
        spread = band_error_covariance(*field.sampled_deviation, panel.correlation_nm, axis)
        covariance = covariance + spread / n
    elif field.standard_deviation is not None:
        spread = field.standard_deviation / np.sqrt(n)
        covariance = covariance + np.outer(spread, spread)
    return field.mean, covariance
