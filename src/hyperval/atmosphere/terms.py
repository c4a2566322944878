"""What every atmosphere engine returns: the terms of equation 3.7."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import band_average

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class AtmosphericTerms:
    """Terms of L = path_radiance + (direct rho + adjacency rho_ave) / (1 - spherical_albedo rho_ave).

    All arrays have shape (n,), one value per wavelength.

    Attributes
    ----------
    wavelength_nm : sample or band-centre positions [nm]
    path_radiance : L_a, radiance over a black surface [uW cm-2 sr-1 nm-1]
    direct : A, radiance per unit reflectance of the viewed pixel [uW cm-2 sr-1 nm-1]
    adjacency : B, radiance per unit average reflectance scattered into the view [uW cm-2 sr-1 nm-1]
    spherical_albedo : S [1]
    ground_irradiance : global irradiance on a black ground [uW cm-2 nm-1]
    gas_transmittance : two-way (sun-ground-sensor) gas transmittance [1]; tells windows from absorption
    provenance : engine, version, solar spectrum, state
    """

    wavelength_nm: Array
    path_radiance: Array
    direct: Array
    adjacency: Array
    spherical_albedo: Array
    ground_irradiance: Array
    gas_transmittance: Array
    provenance: dict[str, Any] = field(default_factory=dict)

    def at_bands(self, axis: SpectralAxis) -> AtmosphericTerms:
        """The terms averaged over the band responses of ``axis``."""

        names = [f.name for f in fields(self) if f.name not in ("wavelength_nm", "provenance")]
        stack = np.stack([getattr(self, name) for name in names])
        bands = band_average(self.wavelength_nm, stack, axis)  # one set of weights for all terms
        return AtmosphericTerms(
            wavelength_nm=axis.centre_nm,
            **dict(zip(names, bands, strict=True)),
            provenance=self.provenance,
        )
