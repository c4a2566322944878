"""Spectra of single sites, where no cube is held; their reflectance by each other, or as a network computed it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import Collection, EmpiricalLineSource, PathRadiance
from hyperval.collection_files import BandTable, RadCalNetSource
from hyperval.errors import InputError, UsageError, reader
from hyperval.observe.empirical_line import field_reflectance, line_warnings
from hyperval.observe.uncertainty import (
    calibration_covariance,
    detector_covariance,
    spectral_estimate,
    wavelength_notes,
)
from hyperval.paths import checked_file
from hyperval.prediction.inputs import correlation
from hyperval.processing.elm import PanelMeasurement, fit_elm
from hyperval.processing.elm_error import PanelErrors, line_error
from hyperval.processing.elm_in_scene import fit_gain
from hyperval.products import Observation, SpectralEstimate
from hyperval.sensor.specification import load_sensor
from hyperval.spectra.axis import SpectralAxis, fwhm_from_spacing
from hyperval.spectra.radcalnet import TOP, read_radcalnet
from hyperval.spectra.readers import FieldSpectrum, read_spectrum
from hyperval.spectra.readers_text import number_table
from hyperval.spectra.response import band_average
from hyperval.units import RADIANCE_UNIT, wavelength_to_nm

Array = npt.NDArray[np.float64]
MAX_TABLE_BYTES = 10 << 20
SAME_BAND_NM = 0.5
Mask = npt.NDArray[np.bool_]
Resolve = Callable[[str], Path]
# Sites are what the scene has: the gain over its uncertainty decides, and this keeps equal sites from a line.
LEAST_CONTRAST = 0.01
DECIMALS = 4  # of the values in a file
ROUNDING, NETWORK = "rounding", "as the network states"


def observe_spectra(collection: Collection, resolve: Callable[[str], Path]) -> Observation:
    """Radiance of every site with the uncertainty of its calibration and of its detector's noise.

    With an empirical line also its reflectance, by the line through the other known sites of its flight line.

    Raises
    ------
    InputError : files that are missing, malformed, or whose wavelengths are not those of the band table.
    """
    if collection.bands is None:
        raise UsageError("collected spectra need a band table")
    axis = read_band_table(resolve(collection.bands.path), collection.bands)
    radiance, notes = {}, []
    sites: dict[str, Site] = {}
    zero = np.zeros((len(axis), len(axis)))
    detector = None
    if (name := collection.detector) is not None:
        detector = load_sensor(resolve(name) if name.endswith((".yaml", ".yml")) else name)
    if collection.bands.fwhm_column is None:
        notes.append(
            "the band table's widths are not named (fwhm_column): band widths are taken as the band spacing"
        )
    for site in collection.spectra:
        path = resolve(site.path)
        read = read_spectrum(
            path,
            record=site.record,
            quantity="radiance",
            unit=site.unit,
            unit_if_unstated=RADIANCE_UNIT,
            wavelength_unit=site.wavelength_unit,
        )
        mean, how = in_bands(read, axis)
        notes += [f"{site.subject}: {note}" for note in (*read.notes, *how)]
        parts = {}
        if collection.calibration is not None:
            parts["calibration"] = calibration_covariance(mean, axis, collection.calibration, resolve)
        if detector is not None and site.pixels is not None:
            parts["detector noise"] = detector_covariance(mean, axis, detector, site.pixels)
        radiance[site.subject] = spectral_estimate(mean, parts, n=site.pixels)
        level = np.where(mean == 0.0, np.inf, mean)
        relative = parts.get("calibration", zero) / np.outer(level, level)
        sites[site.subject] = Site(mean, parts.get("detector noise", zero), relative, site.pixels, site.line)
    notes += wavelength_notes([estimate.mean for estimate in radiance.values()], axis, reflectance=False)
    reflectance: dict[str, SpectralEstimate] = {}
    if collection.empirical_line is not None:
        reflectance, more = site_reflectance(collection.empirical_line, sites, axis, resolve)
        notes += more
    return Observation(
        axis=axis,
        radiance=radiance,
        reflectance=reflectance,
        notes=tuple(notes),
        provenance={"quantity": "radiance"},
    )


def in_bands(read: FieldSpectrum, axis: SpectralAxis) -> tuple[Array, tuple[str, ...]]:
    """(B,) radiance in the bands of the table, and what was done.

    A spectrum at the bands' own centres is taken as it stands; one of a field spectrometer, which samples at most
    half a band width apart, is averaged over the bands.

    Raises
    ------
    InputError : other wavelengths, or bands that the spectrum does not cover.
    """
    at = read.wavelength_nm
    if at.size == len(axis) and np.all(np.abs(at - axis.centre_nm) <= SAME_BAND_NM):
        return read.values, ()
    inside = axis.centre_nm[(axis.centre_nm >= at[0]) & (axis.centre_nm <= at[-1])]
    spacing = np.interp(axis.centre_nm, 0.5 * (at[1:] + at[:-1]), np.diff(at)) if at.size > 1 else np.inf
    if inside.size < len(axis) or np.any(spacing > 0.5 * axis.fwhm_nm):
        raise InputError(
            f"{at.size} wavelengths that are not those of the band table ({len(axis)} bands)",
            where=read.source,
            expected=f"the same bands to {SAME_BAND_NM:g} nm, or samples at most half a band width apart",
        )
    mean = band_average(at, read.values, axis, outside="nan")
    if not np.all(np.isfinite(mean)):
        lost = axis.centre_nm[~np.isfinite(mean)]
        raise InputError(
            f"the spectrum does not cover {lost.size} bands, first {lost[0]:g} nm",
            where=read.source,
            expected=f"samples beyond both ends of the bands ({axis.centre_nm[0]:g} to {axis.centre_nm[-1]:g} nm)",
        )
    return mean, (f"{at.size} samples averaged over the {len(axis)} bands",)


@reader
def read_band_table(path: Path, table: BandTable) -> SpectralAxis:
    """The spectral axis of a whitespace-separated text table."""
    checked_file(path, what="table of bands", most=MAX_TABLE_BYTES)
    needed = max(table.centre_column, table.fwhm_column or 0)
    lines = [line.split("#")[0] for line in path.read_text("utf-8", errors="replace").splitlines()]
    start = next((number for number, line in enumerate(lines, start=1) if line.strip()), None)
    if start is None:
        raise InputError("holds no band", where=str(path), expected="a table of band centres and widths")
    header, rows, first = number_table("\n".join(lines), path)
    if header:
        raise InputError(
            "not a row of numbers", where=f"{path}:{start}", expected="numbers; a heading begins with #"
        )
    if rows.shape[1] <= needed:
        raise InputError(f"{rows.shape[1]} columns", where=f"{path}:{first}", expected=f"{needed + 1} or more")
    factor = wavelength_to_nm(table.wavelength_unit)
    centre = rows[:, table.centre_column] * factor
    try:
        if table.fwhm_column is None:
            return SpectralAxis(centre, fwhm_from_spacing(centre))
        return SpectralAxis(centre, rows[:, table.fwhm_column] * factor)
    except UsageError as error:
        raise InputError(f"not a table of bands: {error.what}", where=str(path), expected=error.expected) from error


@dataclass(frozen=True)
class Site:
    """A collected site.

    Attributes
    ----------
    mean : (B,) radiance [uW cm-2 sr-1 nm-1]
    own : (B, B) error covariance that no other site shares, its detector noise
    relative : (B, B) relative error covariance that all sites of a flight line share, the calibration's
    n : pixels averaged, None when unknown
    line : flight line
    """

    mean: Array
    own: Array
    relative: Array
    n: int | None
    line: str | None


@dataclass(frozen=True)
class _Panel:
    """A point of a line: reflectance (B,) and radiance (B,), each with its error covariance (B, B)."""

    name: str
    reflectance: Array
    reflectance_error: Array
    radiance: Array
    radiance_error: Array
    n: int = 1

    def measurement(self, use: Mask) -> tuple[PanelMeasurement, PanelErrors]:
        """The panel in some bands."""
        at = np.ix_(use, use)
        errors = PanelErrors(self.reflectance_error[at], self.radiance_error[at])
        sd, variance = np.sqrt(np.diag(errors.reflectance)), np.diag(errors.radiance).copy()
        return PanelMeasurement(self.name, self.reflectance[use], sd, self.radiance[use], variance, self.n), errors


def site_reflectance(
    source: EmpiricalLineSource, sites: Mapping[str, Site], axis: SpectralAxis, resolve: Resolve
) -> tuple[dict[str, SpectralEstimate], list[str]]:
    """Reflectance of every site by the line through the other panels of its flight line, and notes.

    A site is never on its own line, so that each reflectance is a prediction of what the ground has.  Two or more
    other panels make the line; a single one makes it with the path radiance that ``path_radiance`` states for the
    flight line, and the note marks it as a one-point line.  Sites of one flight share their calibration, which
    cancels, but for the part of it in which a stated path radiance has none.

    Raises
    ------
    UsageError : a panel that is no site, or a path radiance of a flight line without sites.
    """
    lines = {site.line for site in sites.values()}
    for entry in source.path_radiance:
        if entry.line not in lines:
            raise UsageError(
                f"path_radiance: no site of flight line {entry.line!r}",
                where="collection.empirical_line",
                expected="one of " + ", ".join(sorted(repr(line) for line in lines)),
            )
    panels: dict[str, _Panel] = {}
    for panel in source.panels:
        name = panel.region
        if name not in sites:
            raise UsageError(
                f"empirical line: no site {name!r}",
                where="collection.empirical_line",
                expected="one of " + ", ".join(sites),
            )
        site = sites[name]
        panels[name] = _Panel(name, *field_reflectance(panel, axis, resolve), site.mean, site.own, site.n or 1)
    out: dict[str, SpectralEstimate] = {}
    notes: list[str] = []
    for name, site in sites.items():
        others = [p for n, p in panels.items() if n != name and sites[n].line == site.line]
        stated = next((entry for entry in source.path_radiance if entry.line == site.line), None)
        how = "empirical line"
        if source.intercept and len(others) == 1 and stated is not None:
            others.append(_black(stated, site, axis, resolve))
            how = "one-point empirical line"
        if not others or (source.intercept and len(others) == 1):
            lacks = (
                "one other site makes a line only with its path_radiance" if others else "no other site is known"
            )
            notes.append(f"{name}: no reflectance by other sites of its flight line: {lacks}")
            continue
        try:
            out[name], words = _by_line(source.intercept, site, others, axis)
        except UsageError as error:
            notes.append(f"{name}: no reflectance by other sites of its flight line: {error.what}")
            continue
        notes += [f"{name}: {text}" for text in (f"reflectance by the {how} through {words[0]}", *words[1:])]
    return out, notes


def _black(stated: PathRadiance, site: Site, axis: SpectralAxis, resolve: Resolve) -> _Panel:
    """The path radiance as a panel that reflects nothing."""
    # Here, not above: few observations need the model, and it takes memory.
    from hyperval.observe.path_radiance import path_estimate

    black, zero = path_estimate(stated, axis, resolve), np.zeros(len(axis))
    # A common error of the calibration moves all sites and not the path: as if the path alone had moved.
    error = black.error_covariance + site.relative * np.outer(black.mean, black.mean)
    return _Panel("the path radiance of the engine", zero, np.zeros_like(error), black.mean, error)


def _by_line(
    intercept: bool, site: Site, panels: Sequence[_Panel], axis: SpectralAxis
) -> tuple[SpectralEstimate, list[str]]:
    """Reflectance of a site by the line through panels, and notes, of which the first names the line.

    Raises
    ------
    UsageError : panels that fix no line.
    """
    fit = partial(fit_elm, minimum_contrast=LEAST_CONTRAST) if intercept else fit_gain
    known = np.all([np.isfinite(p.reflectance) for p in panels], axis=0)
    measured, errors = zip(*(p.measurement(known) for p in panels), strict=True)
    by_line = line_error(fit, measured, errors)
    line, level, at = by_line.line, site.mean[known], np.ix_(known, known)
    parts = {"empirical line": by_line.covariance(level)}
    if np.any(site.own):
        parts["detector noise"] = site.own[at] / np.outer(line.gain, line.gain)
    mean = np.full(known.size, np.nan)
    mean[known] = line.reflectance(level)
    whole = {name: np.full((known.size, known.size), np.nan) for name in parts}
    for name, part in parts.items():
        whole[name][at] = part
    words = f"{' and '.join(line.panels)}, usable in {int(line.usable.sum())} of {known.size} bands"
    return spectral_estimate(mean, whole, n=site.n), [words, *line_warnings(line, axis.select(known))]


def observe_radcalnet(source: RadCalNetSource, resolve: Callable[[str], Path]) -> Observation:
    """The half hours of a day, each a subject.

    The bands are those in which any of them has a value.

    Raises
    ------
    InputError : a file that is missing or corrupt, of the surface, or without a value.
    UsageError : a half hour without values.
    """
    day = read_radcalnet(resolve(source.path))
    if day.quantity != TOP:
        raise InputError(
            "holds the reflectance of the surface", where=day.source, expected="the day's file that ends in .output"
        )
    times = tuple(source.times) or day.valid
    if not times:
        raise InputError("no half hour has a value", where=day.source, mend="take a day of better weather")
    rows = [day.column(time) for time in times]
    bands = np.isfinite(day.values[rows]).any(axis=0)
    nm = day.wavelength_nm[bands]
    axis = SpectralAxis(nm, np.full(nm.size, source.fwhm_nm))
    rounding = np.eye(nm.size) * 10.0 ** (-2 * DECIMALS) / 12.0
    out = {}
    for time, row in zip(times, rows, strict=True):
        stated = np.nan_to_num(day.uncertainty[row, bands])
        errors = {ROUNDING: rounding}
        if not source.shared_inputs:
            errors[NETWORK] = np.outer(stated, stated) * correlation(axis, source.correlation_nm)
        budget = {name: np.sqrt(np.diag(c)) for name, c in errors.items()}
        out[source.subject.format(site=day.site, time=time)] = SpectralEstimate(
            day.values[row, bands], np.sum(list(errors.values()), axis=0), budget=budget, stated=stated
        )
    notes = [f"bands are taken as {source.fwhm_nm:g} nm wide: the network's file does not state their width"]
    if source.shared_inputs:
        notes.append("both sides start from the same surface and state: their errors are not in the difference")
    return Observation(axis=axis, toa_reflectance=out, notes=tuple(notes), provenance={"quantity": TOP})
