"""Collected spectra of single sites, where no cube is held."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hyperval.collection import BandTable, Collection
from hyperval.errors import InputError, UsageError
from hyperval.observe.uncertainty import calibration_covariance, spectral_estimate
from hyperval.products import Observation
from hyperval.spectra.axis import SpectralAxis, fwhm_from_spacing
from hyperval.spectra.readers import read_spectrum
from hyperval.units import wavelength_to_nm

MAX_TABLE_BYTES = 10 << 20


def observe_spectra(collection: Collection, resolve: Callable[[str], Path]) -> Observation:
    """Radiance of every site with its calibration uncertainty.

    Raises
    ------
    InputError : files that are missing, malformed, or whose wavelengths are not those of the band table.
    """
    if collection.bands is None:
        raise UsageError("collected spectra need a band table")
    axis = read_band_table(resolve(collection.bands.path), collection.bands)
    radiance = {}
    for site in collection.spectra:
        path = resolve(site.path)
        read = read_spectrum(path, quantity="radiance", unit=site.unit, wavelength_unit=site.wavelength_unit)
        if read.wavelength_nm.size != len(axis) or np.any(np.abs(read.wavelength_nm - axis.centre_nm) > 0.5):
            raise InputError(
                f"{read.wavelength_nm.size} wavelengths that are not those of the band table ({len(axis)} bands)",
                where=str(path),
                expected="the same bands to 0.5 nm",
            )
        mean = read.values
        parts = {}
        if collection.calibration is not None:
            parts["calibration"] = calibration_covariance(mean, axis, collection.calibration, resolve)
        radiance[site.subject] = spectral_estimate(mean, parts, n=site.pixels)
    return Observation(axis=axis, radiance=radiance, provenance={"quantity": "radiance"})


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
            raise InputError("not a row of numbers", where=f"{path}:{number}") from error
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
