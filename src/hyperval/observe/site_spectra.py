"""Spectra of single sites, where no cube is held; their reflectance by each other, or as a network computed it.

Path radiance of a scenario: what its engine sees of black ground.

What is known of the error of collected spectra, and what they say of their own wavelengths.

The empirical line of a collection, with the errors of its panels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath

import numpy as np
import numpy.typing as npt

from hyperval.collection import (
    CalibrationUncertainty,
    CollectionSection,
    EmpiricalLineSource,
    PanelReference,
    PathRadiance,
)
from hyperval.collection_files import BandTableFile, RadCalNetSource
from hyperval.data import SampleStatistics
from hyperval.errors import InputError, UsageError, reader
from hyperval.imagery import Cube
from hyperval.model import Origins, Sources, band_error_covariance, correlation, predict
from hyperval.paths import checked_file
from hyperval.pixels import (
    EmpiricalLine,
    MeasuredPanel,
    Shift,
    darkest_pixel_panel,
    darkest_values,
    fit_elm,
    wavelength_shifts,
)
from hyperval.products import EstimatedPart, ObservedProducts, SpectralEstimate
from hyperval.scenario import SpectrumSource, Surface, Uncertainty, load_scenario
from hyperval.sensor.specification import Sensor, load_sensor
from hyperval.spectra import FieldSpectrum, number_table, read_spectrum
from hyperval.spectra.axis import SpectralAxis, band_average, fwhm_from_spacing
from hyperval.spectra.networks import TOP, read_radcalnet
from hyperval.units import RADIANCE_UNIT, wavelength_to_nm

BLACK = "black ground"


def path_estimate(source: PathRadiance, axis: SpectralAxis, resolve: Callable[[str], Path]) -> SpectralEstimate:
    """Path radiance of a scenario [uW cm-2 sr-1 nm-1] with its error by the scenario's ``uncertainty``.

    L_P = L_a + B rho_ave / (1 - S rho_ave) of (3.7): what the scenario predicts for a site of reflectance 0.

    Raises
    ------
    UsageError : a scenario without an atmosphere, or one that states no uncertainty.
    """
    path = resolve(source.scenario)
    scenario = load_scenario(path)
    if scenario.atmosphere is None or scenario.uncertainty == Uncertainty():
        lacks = "no atmosphere" if scenario.atmosphere is None else "no uncertainty"
        raise UsageError(
            f"path_radiance: the scenario states {lacks}",
            where=str(path),
            expected="an atmosphere, and the uncertainty of what its path radiance depends on",
        )
    black = Surface(name=BLACK, spectrum=SpectrumSource(constant=0.0))
    scene = scenario.scene.model_copy(update={"sites": [*scenario.scene.sites, black], "targets": []})

    def beside(reference: str) -> Path:  # references of a scenario are relative to its own file
        if ":" in reference:
            return resolve(reference)
        return resolve((PurePath(source.scenario).parent / reference).as_posix())

    bare = scenario.model_copy(update={"scene": scene})
    return predict(bare, Origins(axis, resolve=beside)).radiance[BLACK]


Array = npt.NDArray[np.float64]


def calibration_covariance(
    radiance: npt.ArrayLike, axis: SpectralAxis, calibration: CalibrationUncertainty, resolve: Callable[[str], Path]
) -> Array:
    """Error covariance (B, B) of a radiance (B,) whose calibration is known to a relative uncertainty."""
    level = np.asarray(radiance, dtype=float)
    if calibration.relative is not None:
        relative = np.full(len(axis), calibration.relative)
    else:
        table = read_spectrum(resolve(str(calibration.file)), quantity="other", wavelength_unit="nm")
        # The table is smooth; a band of the axis outside it takes the value at its end.
        relative = np.interp(axis.centre_nm, table.wavelength_nm, table.values)
    sigma = relative * level
    by_band = calibration.file is not None and calibration.correlation_nm is None
    shape = np.eye(len(axis)) if by_band else correlation(axis, calibration.correlation_nm)
    covariance = np.outer(sigma, sigma) * shape
    if calibration.uncorrelated is not None:
        covariance[np.diag_indices(len(axis))] += (calibration.uncorrelated * level) ** 2
    return np.asarray(covariance)


def detector_covariance(radiance: npt.ArrayLike, axis: SpectralAxis, sensor: Sensor, pixels: int) -> Array:
    """Error covariance (B, B) of a mean radiance (B,) over so many pixels, by the sensor's noise without C_R."""
    level = np.clip(np.asarray(radiance, dtype=float), 0.0, None)
    return np.diag(sensor.noise(axis).variance(level, calibration=False) / pixels)


def rounding_variance(step: npt.ArrayLike, standard_deviation: npt.ArrayLike) -> Array:
    """Variance of the error that storing whole steps leaves in a mean over any number of pixels.

    Noise of a step smooths the rounding away, a panel without noise keeps all of it: normal values about x with
    standard deviation s are off by sum_k (-1)^k step/(pi k) sin(2 pi k x/step) exp(-2 pi^2 k^2 s^2/step^2) on
    average, whose mean square over x is step^2/(2 pi^2) sum_k exp(-4 pi^2 k^2 s^2/step^2)/k^2, step^2/12 without
    noise.  Source: Widrow, Kollar & Liu, IEEE Trans. Instrum. Meas. 45, 353-361, 1996.

    Parameters
    ----------
    step : of the stored values; standard_deviation : of the pixels, in the same unit
    """
    q, s = np.broadcast_arrays(np.asarray(step, dtype=float), np.asarray(standard_deviation, dtype=float))
    k = np.arange(1, 200)[:, None]
    with np.errstate(under="ignore"):
        terms = np.exp(-4.0 * np.pi**2 * k**2 * (s.ravel() / np.where(q.ravel() > 0.0, q.ravel(), 1.0)) ** 2) / k**2
    return np.asarray((q**2 / (2.0 * np.pi**2)) * terms.sum(axis=0).reshape(q.shape))


def spectral_estimate(
    mean: npt.ArrayLike,
    parts: Mapping[str, npt.NDArray[np.float64]],
    *,
    pixel_covariance: Array | None = None,
    n: int | None = None,
    estimated: Sequence[EstimatedPart] = (),
    circular: str = "",
    rounding: Array | float = 0.0,
) -> SpectralEstimate:
    """Estimate whose error covariance is the sum of independent ``parts`` (B, B), each named in the budget.

    ``estimated``: those of the parts that were estimated from samples; ``circular`` and ``rounding`` are those of
    the estimate.
    """
    mean = np.asarray(mean, dtype=float)
    total = sum(parts.values(), np.zeros((mean.size, mean.size)))
    budget = {name: np.sqrt(np.clip(np.diag(part), 0.0, None)) for name, part in parts.items()}
    return SpectralEstimate(
        mean, total, pixel_covariance, n, budget, tuple(estimated), circular, rounding=rounding,
        calibration=parts.get("calibration"),
    )  # fmt: skip


def collection_shifts(
    spectra: Iterable[npt.NDArray[np.float64]], axis: SpectralAxis, *, reflectance: bool
) -> list[tuple[Shift, int]]:
    """The median shift of every feature over spectra (B,) of one axis, and how many of them show it.

    The uncertainty is that of where the feature lies, which the spectra share: it is not divided by their number.
    Where it differs between spectra it is the median.
    """
    shifts: dict[str, list[Shift]] = {}
    for spectrum in spectra:
        for shift in wavelength_shifts(spectrum, axis, reflectance=reflectance):
            shifts.setdefault(shift.feature, []).append(shift)
    return [
        (
            Shift(name, *(float(np.median(x)) for x in ([s.nm for s in each], [s.uncertainty_nm for s in each]))),
            len(each),
        )
        for name, each in shifts.items()
    ]


def wavelength_notes(spectra: Iterable[npt.NDArray[np.float64]], axis: SpectralAxis, *, reflectance: bool) -> list[str]:
    """The shifts in words, a warning for each that is certain."""
    shifts = collection_shifts(spectra, axis, reflectance=reflectance)
    if not shifts:
        feature = "an absorption of oxygen or water vapour"
        if reflectance:
            feature = "a red edge of plants or a rest of the oxygen band"
        return [f"the wavelengths could not be checked: no spectrum shows {feature}"]
    parts = [
        f"{s.feature} {s.nm:+.1f} nm (standard uncertainty {s.uncertainty_nm:.1f}, {n} spectra)" for s, n in shifts
    ]
    notes = ["wavelengths as labelled less those of known features: " + "; ".join(parts)]
    notes += [
        f"warning: the {s.feature} lies {abs(s.nm):.1f} nm (standard uncertainty {s.uncertainty_nm:.1f}) "
        f"{'above' if s.nm > 0 else 'below'} its place: the wavelengths of the collection seem to be shifted"
        for s, _ in shifts
        if s.certain
    ]
    return notes


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
) -> EmpiricalLine | None:
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
    panels = []
    for panel in source.panels:
        name = panel.region
        if name not in measured:
            raise UsageError(f"empirical line: no region {name!r}", expected="one of " + ", ".join(measured))
        mean, covariance = field_reflectance(panel, cube.axis, resolve)
        sample, part = measured[name], sampling[name]
        known_by = part if sample.n > 1 else None
        panels.append(MeasuredPanel(name, mean, covariance, sample.mean, part.covariance, sample.n, known_by))
    if (dark := source.darkest_pixel) is not None:
        noise = np.full(len(cube.axis), dark.radiance_noise**2)
        panels.append(darkest_pixel_panel(darkest_values(cube), noise, dark.reflectance, dark.uncertainty))
    return fit_elm(panels, intercept=source.intercept)


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
    if (chi2 := elm.contradiction) > 1.0:
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
    return {name: error[np.isfinite(error)] for name, error in zip(elm.names, errors, strict=True)}


def line_notes(elm: EmpiricalLine, axis: SpectralAxis) -> list[str]:
    """What is to be said of a line: its panels, the bands it cannot be used in, how well its panels agree."""
    notes = [f"empirical line through {', '.join(elm.names)}: usable in {int(elm.usable.sum())} bands"]
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


def field_reflectance(panel: PanelReference, axis: SpectralAxis, resolve: Callable[[str], Path]) -> tuple[Array, Array]:
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


MAX_TABLE_BYTES = 10 << 20
SAME_BAND_NM = 0.5

Resolve = Callable[[str], Path]
# Sites are what the scene has: the gain over its uncertainty decides, and this keeps equal sites from a line.
LEAST_CONTRAST = 0.01
DECIMALS = 4  # of the values in a file
ROUNDING, NETWORK = "rounding", "as the network states"


def observe_spectra(collection: CollectionSection, resolve: Callable[[str], Path]) -> ObservedProducts:
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
        notes.append("the band table's widths are not named (fwhm_column): band widths are taken as the band spacing")
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
    return ObservedProducts(
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
def read_band_table(path: Path, table: BandTableFile) -> SpectralAxis:
    """The spectral axis of a whitespace-separated text table."""
    checked_file(path, what="table of bands", most=MAX_TABLE_BYTES)
    needed = max(table.centre_column, table.fwhm_column or 0)
    lines = [line.split("#")[0] for line in path.read_text("utf-8", errors="replace").splitlines()]
    start = next((number for number, line in enumerate(lines, start=1) if line.strip()), None)
    if start is None:
        raise InputError("holds no band", where=str(path), expected="a table of band centres and widths")
    header, rows, first = number_table("\n".join(lines), path)
    if header:
        raise InputError("not a row of numbers", where=f"{path}:{start}", expected="numbers; a heading begins with #")
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
    panels: dict[str, MeasuredPanel] = {}
    for panel in source.panels:
        name = panel.region
        if name not in sites:
            raise UsageError(
                f"empirical line: no site {name!r}",
                where="collection.empirical_line",
                expected="one of " + ", ".join(sites),
            )
        site = sites[name]
        panels[name] = MeasuredPanel(name, *field_reflectance(panel, axis, resolve), site.mean, site.own, site.n or 1)
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
            lacks = "one other site makes a line only with its path_radiance" if others else "no other site is known"
            notes.append(f"{name}: no reflectance by other sites of its flight line: {lacks}")
            continue
        try:
            out[name], words = _by_line(source.intercept, site, others, axis)
        except UsageError as error:
            notes.append(f"{name}: no reflectance by other sites of its flight line: {error.what}")
            continue
        notes += [f"{name}: {text}" for text in (f"reflectance by the {how} through {words[0]}", *words[1:])]
    return out, notes


def _black(stated: PathRadiance, site: Site, axis: SpectralAxis, resolve: Resolve) -> MeasuredPanel:
    """The path radiance as a panel that reflects nothing."""
    black, zero = path_estimate(stated, axis, resolve), np.zeros(len(axis))
    # A common error of the calibration moves all sites and not the path: as if the path alone had moved.
    error = black.error_covariance + site.relative * np.outer(black.mean, black.mean)
    return MeasuredPanel("the path radiance of the engine", zero, zero, black.mean, error)


def _by_line(
    intercept: bool, site: Site, panels: Sequence[MeasuredPanel], axis: SpectralAxis
) -> tuple[SpectralEstimate, list[str]]:
    """Reflectance of a site by the line through panels, and notes, of which the first names the line.

    Raises
    ------
    UsageError : panels that fix no line.
    """
    known = np.all([np.isfinite(p.reflectance) for p in panels], axis=0)
    line = fit_elm([p.bands(known) for p in panels], intercept=intercept, minimum_contrast=LEAST_CONTRAST)
    level, at = site.mean[known], np.ix_(known, known)
    parts = {"empirical line": line.error_covariance(level)}
    if np.any(site.own):
        parts["detector noise"] = site.own[at] / np.outer(line.gain, line.gain)
    mean = np.full(known.size, np.nan)
    mean[known] = line.reflectance(level)
    whole = {name: np.full((known.size, known.size), np.nan) for name in parts}
    for name, part in parts.items():
        whole[name][at] = part
    words = f"{' and '.join(line.names)}, usable in {int(line.usable.sum())} of {known.size} bands"
    return spectral_estimate(mean, whole, n=site.n), [words, *line_warnings(line, axis.select(known))]


def observe_radcalnet(source: RadCalNetSource, resolve: Callable[[str], Path]) -> ObservedProducts:
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
        estimate = spectral_estimate(day.values[row, bands], errors)
        out[source.subject.format(site=day.site, time=time)] = replace(estimate, stated=stated)
    notes = [f"bands are taken as {source.fwhm_nm:g} nm wide: the network's file does not state their width"]
    if source.shared_inputs:
        notes.append("both sides start from the same surface and state: their errors are not in the difference")
    return ObservedProducts(axis=axis, toa_reflectance=out, notes=tuple(notes), provenance={"quantity": TOP})
