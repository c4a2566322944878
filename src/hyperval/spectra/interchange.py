"""Spectra as a library of ``spectral`` (SPy) or an array of xarray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from spectral.io.envi import SpectralLibrary

from hyperval.errors import UsageError
from hyperval.spectra.readers_record import FieldSpectrum


def library_to_spy(spectra: Sequence[FieldSpectrum]) -> SpectralLibrary:
    """Spectra on one set of wavelengths as a library of SPy; :func:`read_records` takes it back.

    Raises
    ------
    UsageError : no spectrum, or different wavelengths.
    """
    _check(spectra)
    header = {
        "wavelength": spectra[0].wavelength_nm.tolist(),
        "wavelength units": "nm",
        "spectra names": [s.name for s in spectra],
    }
    return SpectralLibrary(np.stack([s.values for s in spectra]), header)


def library_to_xarray(spectra: Sequence[FieldSpectrum]) -> xr.DataArray:
    """Spectra on one set of wavelengths as an array (spectrum, wavelength); UsageError as for SPy."""
    _check(spectra)
    return xr.DataArray(
        np.stack([s.values for s in spectra]),
        dims=("spectrum", "wavelength"),
        coords={
            "spectrum": [s.name for s in spectra],
            "wavelength": ("wavelength", spectra[0].wavelength_nm, {"units": "nm"}),
        },
        name=spectra[0].quantity,
    )


def _check(spectra: Sequence[FieldSpectrum]) -> None:
    if not spectra or any(not np.array_equal(s.wavelength_nm, spectra[0].wavelength_nm) for s in spectra):
        raise UsageError("a library needs spectra on one set of wavelengths", mend="resample them first")
