"""Ground truth spectra: the panels of the empirical line, sites without a cube, and the days of a network."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval import pixels as px
from hyperval.collection import (
    CalibrationUncertainty,
    CollectionSection,
    EmpiricalLineSource,
    PanelReference,
    PathRadiance,
    RadCalNetSource,
)
from hyperval.data import Array
from hyperval.errors import UsageError, needed, one_of, refusal, refuse
from hyperval.model import Origins, Sources, band_correlation, band_error_covariance, error_of_mean, predict
from hyperval.observe.open import Place, band_table_notes, read_band_table, said
from hyperval.paths import Resolve
from hyperval.pixels import EmpiricalLine, Labels, MeasuredPanel, fit_elm
from hyperval.products import EstimatedPart, ObservedProducts, SpectralEstimate
from hyperval.scenario import SpectrumSource, Surface, Uncertainty, load_scenario
from hyperval.sensor.specification import Sensor, sensor_named
from hyperval.spectra import TOP, FieldSpectrum, SpectralAxis, band_average, read_radcalnet, read_spectrum
from hyperval.units import RADIANCE_UNIT

BLACK = "black ground"
WHERE = "collection.empirical_line"
MIN_USABLE = 0.8  # of the good bands
MAX_LEFT_OUT = 0.05  # greatest error of a panel's reflectance by the line through the others
SAME_BAND_NM = 0.5
MIN_CONTRAST = 0.01  # between sites, which a scene offers as they are: the SNR of the gain decides
DECIMALS = 4  # of the values in a network's file
ROUNDING, NETWORK = "rounding", "as the network states"
NOISE, CALIBRATION = "detector noise", "calibration"


def spectral_estimate(mean: npt.ArrayLike, parts: Mapping[str, Array], **fields: Any) -> SpectralEstimate:
    """Estimate whose error covariance is the sum of independent ``parts`` (B, B), each named in the budget.

    ``fields``: other fields of the estimate, such as the parts that were estimated from samples.
    """
    mean = np.asarray(mean, dtype=float)
    total = sum(parts.values(), np.zeros((mean.size, mean.size)))
    budget = {name: np.sqrt(np.clip(np.diag(part), 0.0, None)) for name, part in parts.items()}
    return SpectralEstimate(mean, total, budget=budget, calibration=parts.get(CALIBRATION), **fields)


def calibration_covariance(
    radiance: npt.ArrayLike, axis: SpectralAxis, calibration: CalibrationUncertainty, resolve: Resolve
) -> Array:
    """Error covariance (B, B) of a radiance (B,) whose calibration is known to a relative uncertainty."""
    level = np.asarray(radiance, dtype=float)
    relative = np.full(len(axis), calibration.relative or 0.0)
    if calibration.file is not None:
        table = read_spectrum(resolve(calibration.file), quantity="other", wavelength_unit="nm")
        # The table is smooth; a band of the axis outside it takes the value at its end.
        relative = np.interp(axis.centre_nm, table.wavelength_nm, table.values)
    by_band = calibration.file is not None and calibration.correlation_nm is None
    shape = np.eye(len(axis)) if by_band else band_correlation(axis, calibration.correlation_nm)
    uncorrelated = np.diag(((calibration.uncorrelated or 0.0) * level) ** 2)
    return np.asarray(np.outer(relative * level, relative * level) * shape + uncorrelated)


def detector_covariance(radiance: npt.ArrayLike, axis: SpectralAxis, sensor: Sensor, pixels: int) -> Array:
    """Error covariance (B, B) of a mean radiance (B,) over so many pixels, by the sensor's noise without C_R."""
    level = np.clip(np.asarray(radiance, dtype=float), 0.0, None)
    return np.diag(sensor.noise(axis).variance(level, calibration=False) / pixels)


def rounding_variance(step: npt.ArrayLike, standard_deviation: npt.ArrayLike) -> Array:
    """Variance of the rounding error, of values stored in steps, that remains in a mean over any number of pixels.

    Noise of a step dithers the rounding away, a panel without noise keeps all of it: normal values about x with
    standard deviation s have the bias sum_k (-1)^k step/(pi k) sin(2 pi k x/step) exp(-2 pi^2 k^2 s^2/step^2),
    whose mean square over x is step^2/(2 pi^2) sum_k exp(-4 pi^2 k^2 s^2/step^2)/k^2, step^2/12 without noise.
    Source: Widrow, Kollar & Liu, IEEE Trans. Instrum. Meas. 45, 353-361, 1996.

    Parameters
    ----------
    step : of the stored values; standard_deviation : of the pixels, in the same unit
    """
    q, s = np.broadcast_arrays(np.asarray(step, dtype=float), np.asarray(standard_deviation, dtype=float))
    k = np.arange(1, 200)[:, None]
    with np.errstate(under="ignore"):
        terms = np.exp(-4.0 * np.pi**2 * k**2 * (s.ravel() / np.where(q.ravel() > 0.0, q.ravel(), 1.0)) ** 2) / k**2
    return np.asarray((q**2 / (2.0 * np.pi**2)) * terms.sum(axis=0).reshape(q.shape))


def path_estimate(source: PathRadiance, axis: SpectralAxis, resolve: Resolve) -> SpectralEstimate:
    """Path radiance of a scenario [uW cm-2 sr-1 nm-1] with its error by the scenario's ``uncertainty``.

    L_P = L_a + B rho_ave / (1 - S rho_ave) of (3.7): what the scenario predicts for a site of reflectance 0.

    Raises
    ------
    UsageError : a scenario without an atmosphere, or one that states no uncertainty.
    """
    path = resolve(source.scenario)
    scenario = load_scenario(path)
    if scenario.atmosphere is None or scenario.uncertainty == Uncertainty():
        raise refusal("path.states", str(path), lacking="atmosphere" if scenario.atmosphere is None else "uncertainty")
    black = Surface(name=BLACK, spectrum=SpectrumSource(constant=0.0))
    scene = scenario.scene.model_copy(update={"sites": [*scenario.scene.sites, black], "targets": []})

    def resolve_beside(reference: str) -> Path:  # references of a scenario are relative to its own file
        return resolve(reference if ":" in reference else (PurePath(source.scenario).parent / reference).as_posix())

    return predict(scenario.model_copy(update={"scene": scene}), Origins(axis, resolve=resolve_beside)).radiance[BLACK]


def field_reflectance(panel: PanelReference, axis: SpectralAxis, resolve: Resolve) -> tuple[Array, Array]:
    """Reflectance (B,) of a panel as measured on the ground, and its error covariance (B, B).

    By replicate spectra, or the standard error in the file (``divisor: spread``: the standard deviation of either),
    and the stated relative uncertainty; the latter two with the stated correlation length, common to all bands
    without one.
    """
    field = Sources(axis, {}, resolve).spectrum(panel.spectrum, panel.region)
    stated = panel.relative_uncertainty * field.mean
    covariance = np.outer(stated, stated) * band_correlation(axis, panel.correlation_nm)
    n, deviation = 1 if panel.divisor == "spread" else field.n or 1, field.sampled_deviation
    if deviation is not None and (field.mean_error is None or panel.divisor == "spread"):
        covariance = covariance + error_of_mean(band_error_covariance(*deviation, panel.correlation_nm, axis), n)
    elif field.mean_error is not None:
        covariance = covariance + field.mean_error
    return field.mean, covariance


def empirical_line(
    source: EmpiricalLineSource | None, place: Place, sampling: Mapping[str, EstimatedPart], resolve: Resolve
) -> EmpiricalLine | None:
    """The line through the panels that a collection names; None without any.

    Parameters
    ----------
    place : with the statistics of its regions
    sampling : region -> error of its mean radiance

    Raises
    ------
    UsageError : a panel that is no region, or panels that fix no line.
    """
    if source is None:
        return None
    cube, good, panels = place.cube, place.cube.axis.good, []
    for panel in source.panels:
        name = panel.region
        refuse(name not in place.statistics, "line.region", name=name, known=one_of(place.statistics))
        mean, covariance = field_reflectance(panel, cube.axis, resolve)
        sample, part = place.statistics[name], sampling[name]
        sampled = part if sample.n > 1 else None
        panels.append(MeasuredPanel(name, mean, covariance, sample.mean, part.covariance, sample.n, sampled))
    if (dark := source.darkest_pixel) is not None:
        noise = np.full(len(cube.axis), dark.radiance_noise**2)
        panels.append(px.darkest_pixel_panel(px.darkest_values(cube), noise, good, dark.reflectance, dark.uncertainty))
    return fit_elm(panels, good, intercept=source.intercept)


def refuse_saturated(source: EmpiricalLineSource | None, masks: Labels, place: Place) -> None:
    """Raise UsageError for a panel with a pixel that saturates the detector, or the stored type, in a good band.

    Parameters
    ----------
    masks : (lines, samples) pixels behind the mean of each region
    """
    if source is None:
        return
    cube, good = place.cube, np.flatnonzero(place.cube.axis.good)
    greatest = float(np.iinfo(cube.dtype).max) if cube.dtype.kind in "iu" else np.nan
    full = (cube.gain * greatest + cube.offset)[good]
    limit = np.inf if source.saturation is None else source.saturation
    for region in (panel.region for panel in source.panels if panel.region in masks):
        lines, samples = np.nonzero(masks[region])
        count, bands = 0, np.zeros(good.size, bool)
        for values, _ in place.valid_pixels(lines, samples, good):
            saturated = (values == full) | (values >= limit)
            count += int(saturated.any(axis=1).sum())
            bands |= saturated.any(axis=0)
        if count:
            band = int(good[np.argmax(bands)])
            facts = {"count": count, "size": lines.size, "band": band + 1, "centre_nm": cube.axis.centre_nm[band]}
            raise refusal("panel.saturated", WHERE, region=region, **facts)


def line_notes(elm: EmpiricalLine, axis: SpectralAxis) -> list[str]:
    """Notes on a line: its panels, the bands it cannot be used in, how well its panels agree.

    A bad band, here the second, has no part in the medians:

    >>> error, axis = np.full(2, 1e-4), SpectralAxis(np.array([500.0, 600.0]), np.full(2, 10.0))
    >>> seen = {0.1: [1.0, 1.0], 0.3: [3.0, 3.0], 0.5: [5.1, 9.0]}
    >>> panels = [MeasuredPanel(str(r), np.full(2, r), error, np.array(light), error) for r, light in seen.items()]
    >>> line_notes(fit_elm(panels, np.array([True, False])), axis)[-1]
    'empirical line: reduced chi-square of its panels 0.157 (median over bands)'
    """
    notes = [f"empirical line through {', '.join(elm.names)}: usable in {int(elm.usable.sum())} bands"]
    if not elm.usable.all():
        notes[0] += f"; no gain at {', '.join(f'{w:.4g}' for w in axis.centre_nm[~elm.usable])} nm"
    if (elm.usable & elm.good).any() and (left_out := _leave_one_out_errors(elm)):
        parts = []
        for name, errors in left_out.items():
            if errors.size:
                worst = errors[np.abs(errors).argmax()]
                parts.append(said("line.error", name=name, median=np.median(errors), worst=worst))
            else:
                parts.append(f"{name} unknown, the others do not fix a line")
        notes.append(said("line.left_out", panels="; ".join(parts)))
    chi2 = elm.reduced_chi2[np.isfinite(elm.reduced_chi2) & elm.good]
    if chi2.size:
        notes.append(f"empirical line: reduced chi-square of its panels {np.median(chi2):.3g} (median over bands)")
    return [*notes, *line_warnings(elm)]


def line_warnings(elm: EmpiricalLine) -> Iterator[str]:
    """Why a line is not to be relied on: bands lost, panels that do not lie on one line."""
    good, usable = int(elm.good.sum()), int((elm.usable & elm.good).sum())
    if usable < MIN_USABLE * good:
        yield f"warning: the empirical line can be used in {usable} of {good} good bands only"
    if (factor := elm.birge_factor) > 1.0:
        yield said("line.contradiction", times=np.sqrt(factor))
    for name, errors in _leave_one_out_errors(elm).items():
        if errors.size and (error := np.median(np.abs(errors))) > MAX_LEFT_OUT:
            yield said("line.off", name=name, off=error)


def _leave_one_out_errors(elm: EmpiricalLine) -> dict[str, Array]:
    """Error of each panel's reflectance by the line through the others, where the line can be used and has one."""
    if len(elm.panels) <= 1 + elm.intercept:  # the others are too few
        return {}
    errors = elm.leave_one_out_errors[:, elm.usable & elm.good]
    return {name: error[np.isfinite(error)] for name, error in zip(elm.names, errors, strict=True)}


def wavelength_notes(spectra: Iterable[Array], axis: SpectralAxis, *, reflectance: bool) -> list[str]:
    """Wavelength shifts of features of spectra (B,), in words, with a warning for each that is significant."""
    found = px.common_shifts(spectra, axis, reflectance=reflectance)
    if not found:
        return [said("wavelengths.reflectance" if reflectance else "wavelengths.radiance")]
    parts, warnings = [], []
    for s, count in found:
        error = f"standard uncertainty {s.uncertainty_nm:.1f}"
        parts.append(f"{s.feature} {s.nm:+.1f} nm ({error}, shown by {count} of the spectra)")
        if s.is_significant:
            facts = {"feature": s.feature, "nm": abs(s.nm), "error": error, "side": "above" if s.nm > 0 else "below"}
            warnings.append(said("wavelengths.shifted", **facts))
    return [said("wavelengths", features="; ".join(parts)), *warnings]


def observe_spectra(collection: CollectionSection, resolve: Resolve) -> ObservedProducts:
    """Radiance of every site with the uncertainty of its calibration and of its detector's noise.

    With an empirical line also its reflectance, by the line through the other known sites of its flight line.

    Raises
    ------
    InputError : files that are missing, malformed, or whose wavelengths are not those of the band table.
    """
    bands = needed(collection.bands, "site.table")
    axis = read_band_table(resolve(bands.path), bands)
    detector = None
    if (name := collection.detector) is not None:
        detector = sensor_named(name, resolve)
    notes = [*band_table_notes(bands, axis)]
    radiance: dict[str, SpectralEstimate] = {}
    for site in collection.spectra:
        spectrum = read_spectrum(
            resolve(site.path), record=site.record, quantity="radiance", unit=site.unit,
            unit_if_unstated=RADIANCE_UNIT, wavelength_unit=site.wavelength_unit,
        )  # fmt: skip
        mean, how = _band_radiance(spectrum, axis)
        notes += [f"{site.subject}: {note}" for note in (*spectrum.notes, *how)]
        parts = {}
        if collection.calibration is not None:
            parts[CALIBRATION] = calibration_covariance(mean, axis, collection.calibration, resolve)
        if detector is not None and site.pixels is not None:
            parts[NOISE] = detector_covariance(mean, axis, detector, site.pixels)
        radiance[site.subject] = spectral_estimate(mean, parts, n=site.pixels)
    notes += wavelength_notes([estimate.mean for estimate in radiance.values()], axis, reflectance=False)
    reflectance, line_notes = _site_reflectance(collection, radiance, axis, resolve)
    words, origin = (*notes, *line_notes), {"quantity": "radiance"}
    return ObservedProducts(axis=axis, radiance=radiance, reflectance=reflectance, notes=words, provenance=origin)


def _band_radiance(spectrum: FieldSpectrum, axis: SpectralAxis) -> tuple[Array, tuple[str, ...]]:
    """(B,) radiance in the bands of the table, and a note on the averaging.

    A spectrum at the bands' own centres is taken as it stands; one of a field spectrometer, which samples at most
    half a band width apart, is averaged over the bands.
    """
    nm, centre = spectrum.wavelength_nm, axis.centre_nm
    if nm.size == len(axis) and np.all(np.abs(nm - centre) <= SAME_BAND_NM):
        return spectrum.values, ()
    covered = centre[(centre >= nm[0]) & (centre <= nm[-1])]
    spacing = np.interp(centre, 0.5 * (nm[1:] + nm[:-1]), np.diff(nm)) if nm.size > 1 else np.inf
    if covered.size < len(axis) or np.any(spacing > 0.5 * axis.fwhm_nm):
        raise refusal("site.bands", spectrum.source, size=nm.size, count=len(axis), step=SAME_BAND_NM)
    mean = band_average(nm, spectrum.values, axis, outside="nan")
    if (gaps := centre[~np.isfinite(mean)]).size:
        raise refusal("site.cover", spectrum.source, size=gaps.size, first=gaps[0], low=centre[0], high=centre[-1])
    return mean, (f"{nm.size} samples averaged over the {len(axis)} bands",)


def _site_reflectance(
    collection: CollectionSection, sites: Mapping[str, SpectralEstimate], axis: SpectralAxis, resolve: Resolve
) -> tuple[dict[str, SpectralEstimate], list[str]]:
    """Reflectance of every site by the line through the other panels of its flight line, and notes; none without one.

    A site is never on its own line, so that each reflectance is an independent prediction.  Two or more other panels
    make the line; a single one makes it with the path radiance that ``path_radiance`` states for the flight line, and
    the note marks it as a one-point line.  Sites of one flight share their calibration error, which cancels except
    against a stated path radiance, which has none.
    """
    if (source := collection.empirical_line) is None:
        return {}, []
    flights = {site.subject: site.line for site in collection.spectra}
    paths = {entry.line: entry for entry in source.path_radiance}
    choices = one_of(sorted(map(repr, set(flights.values()))))
    for stated in paths:
        refuse(stated not in flights.values(), "path.line", WHERE, line=stated, known=choices)
    panels: dict[str, MeasuredPanel] = {}
    for panel in source.panels:
        name = panel.region
        refuse(name not in sites, "line.site", WHERE, name=name, known=one_of(sites))
        noise, n = sites[name].budget.get(NOISE, np.zeros(len(axis))), sites[name].n or 1
        panels[name] = MeasuredPanel(name, *field_reflectance(panel, axis, resolve), sites[name].mean, noise**2, n)
    reflectance: dict[str, SpectralEstimate] = {}
    notes: list[str] = []
    for name, site in sites.items():
        flight = flights[name]
        line_panels = [p for n, p in panels.items() if n != name and flights[n] == flight]
        method, reason = "empirical line", "no other site is known"
        if source.intercept and len(line_panels) == 1:
            reason = "one other site makes a line only with its path_radiance"
            if flight in paths:
                method = "one-point empirical line"
                line_panels.append(_path_panel(paths[flight], site, axis, resolve))
        try:
            if not line_panels or (source.intercept and len(line_panels) == 1):
                raise UsageError(reason)
            line = fit_elm(line_panels, intercept=source.intercept, minimum_contrast=MIN_CONTRAST)
        except UsageError as error:
            notes.append(f"{name}: no reflectance by other sites of its flight line: {error.what}")
            continue
        parts = {"empirical line": line.error_covariance(site.mean)}
        if NOISE in site.budget:
            parts[NOISE] = np.diag((site.budget[NOISE] / line.gain) ** 2)
        reflectance[name] = spectral_estimate(line.reflectance(site.mean), parts, n=site.n)
        usable = f"usable in {int(line.usable.sum())} of {len(axis)} bands"
        words = [f"reflectance by the {method} through {' and '.join(line.names)}, {usable}", *line_warnings(line)]
        notes += [f"{name}: {text}" for text in words]
    return reflectance, notes


def _path_panel(source: PathRadiance, site: SpectralEstimate, axis: SpectralAxis, resolve: Resolve) -> MeasuredPanel:
    """The path radiance as a panel of reflectance 0."""
    black, zero = path_estimate(source, axis, resolve), np.zeros(len(axis))
    # A calibration error common to all sites and not to the path is equivalent to one of the path alone.
    fraction = black.mean / np.where(site.mean == 0.0, np.inf, site.mean)
    calibration = 0.0 if site.calibration is None else site.calibration
    error = black.error_covariance + calibration * np.outer(fraction, fraction)
    return MeasuredPanel("the path radiance of the engine", zero, zero, black.mean, error)


def observe_radcalnet(source: RadCalNetSource, resolve: Resolve) -> ObservedProducts:
    """The half hours of a day, each a subject.

    The bands are those in which any of them has a value.

    Raises
    ------
    InputError : a file that is missing or corrupt, of the surface, or without a value.
    UsageError : a half hour without values.
    """
    day = read_radcalnet(resolve(source.path))
    refuse(day.quantity != TOP, "site.surface", day.source)
    times = tuple(source.times) or day.valid
    refuse(not times, "site.weather", day.source)
    rows = [day.column(time) for time in times]
    bands = np.isfinite(day.values[rows]).any(axis=0)
    nm = day.wavelength_nm[bands]
    fwhm, origin = source.fwhm_nm, "as stated"
    if fwhm is None:
        fwhm, origin = px.oxygen_band_width(nm, np.nanmean(day.values[rows][:, bands], axis=0)), "by the oxygen A band"
    if not np.isfinite(fwhm):
        fwhm, origin = float(np.diff(nm).min()), "as wide as their step"
    axis = SpectralAxis(nm, np.full(nm.size, fwhm))
    estimates = {}
    for time, row in zip(times, rows, strict=True):
        stated = np.nan_to_num(day.uncertainty[row, bands])
        errors = {ROUNDING: np.eye(nm.size) * 10.0 ** (-2 * DECIMALS) / 12.0}
        if not source.shared_inputs:
            errors[NETWORK] = np.outer(stated, stated) * band_correlation(axis, source.correlation_nm)
        estimate = spectral_estimate(day.values[row, bands], errors)
        estimates[source.subject.format(site=day.site, time=time)] = replace(estimate, stated=stated)
    notes = [f"bands are taken as {fwhm:g} nm wide ({origin}): the network's file does not state their width"]
    if source.shared_inputs:
        notes.append("both sides start from the same surface and state: their errors are not in the difference")
    return ObservedProducts(axis=axis, toa_reflectance=estimates, notes=tuple(notes), provenance={"quantity": TOP})
