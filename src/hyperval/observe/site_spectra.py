"""Collected spectra of single sites, where no cube is held."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hyperval.collection import Collection
from hyperval.collection_files import BandTable
from hyperval.errors import InputError, UsageError, reader
from hyperval.observe.site_line import site_reflectance, sites_of
from hyperval.observe.uncertainty import calibration_covariance, detector_covariance, spectral_estimate
from hyperval.observe.wavelengths import wavelength_notes
from hyperval.products import Observation, SpectralEstimate
from hyperval.sensor.specification import load_sensor
from hyperval.spectra.axis import SpectralAxis, fwhm_from_spacing
from hyperval.spectra.readers import FieldSpectrum, read_spectrum
from hyperval.spectra.response import band_average
from hyperval.units import RADIANCE_UNIT, wavelength_to_nm

Array = npt.NDArray[np.float64]
MAX_TABLE_BYTES = 10 << 20
SAME_BAND_NM = 0.5


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
    own: dict[str, Array] = {}
    common: dict[str, Array] = {}
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
            parts["calibration"] = common[site.subject] = calibration_covariance(
                mean, axis, collection.calibration, resolve
            )
        if detector is not None and site.pixels is not None:
            parts["detector noise"] = own[site.subject] = detector_covariance(mean, axis, detector, site.pixels)
        radiance[site.subject] = spectral_estimate(mean, parts, n=site.pixels)
    notes += wavelength_notes([estimate.mean for estimate in radiance.values()], axis, reflectance=False)
    reflectance: dict[str, SpectralEstimate] = {}
    if collection.empirical_line is not None:
        sites = sites_of(collection, {name: e.mean for name, e in radiance.items()}, own, common)
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
    if path.stat().st_size > MAX_TABLE_BYTES:
        raise InputError(f"larger than {MAX_TABLE_BYTES} bytes", where=str(path), expected="a table of bands")
    needed = max(table.centre_column, table.fwhm_column or 0)
    rows = []
    for number, line in enumerate(path.read_text("utf-8", errors="replace").splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            rows.append([float(w) for w in words])
        except ValueError as error:
            raise InputError(
                "not a row of numbers", where=f"{path}:{number}", expected="numbers; a heading begins with #"
            ) from error
        if len(words) <= needed:
            raise InputError(f"{len(words)} columns", where=f"{path}:{number}", expected=f"{needed + 1} or more")
    if not rows:
        raise InputError("holds no band", where=str(path), expected="a table of band centres and widths")
    factor = wavelength_to_nm(table.wavelength_unit)
    centre = np.array([row[table.centre_column] for row in rows]) * factor
    try:
        if table.fwhm_column is None:
            return SpectralAxis(centre, fwhm_from_spacing(centre))
        return SpectralAxis(centre, np.array([row[table.fwhm_column] for row in rows]) * factor)
    except UsageError as error:
        raise InputError(f"not a table of bands: {error.what}", where=str(path), expected=error.expected) from error
