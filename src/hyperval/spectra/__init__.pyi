"""Spectral axis, band responses, windows, and readers of field spectra and libraries."""

from .axis import (
    ABSORPTION_BANDS_NM,
    CUT_SIGMA,
    SIGMA_PER_FWHM,
    SPECTRAL_REGIONS_NM,
    SpectralAxis,
    band_average,
    band_weights,
    fwhm_from_spacing,
    in_window,
    spacing_note,
)
from .networks import SURFACE, TOP, RadCalNetDay, read_radcalnet
from .read import library_to_spy, library_to_xarray, read_records, read_spectrum
from .record import FieldSpectrum
from .text import number_table

__all__ = [
    "ABSORPTION_BANDS_NM", "CUT_SIGMA", "SIGMA_PER_FWHM", "SPECTRAL_REGIONS_NM", "SURFACE", "TOP", "FieldSpectrum",
    "RadCalNetDay", "SpectralAxis", "band_average", "band_weights", "fwhm_from_spacing", "in_window", "library_to_spy",
    "library_to_xarray", "number_table", "read_radcalnet", "read_records", "read_spectrum", "spacing_note",
]  # fmt: skip
