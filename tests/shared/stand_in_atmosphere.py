"""Smooth terms of an atmosphere that stand in for the radiative-transfer engine."""

import numpy as np

from hyperval.atmosphere import AtmosphericTerms

WAVELENGTH_NM = np.arange(340.0, 2601.0, 10.0)


def blue_and_haze(optical_depth, w=WAVELENGTH_NM):
    """Rayleigh-like and haze-like falls over wavelength."""
    return (w / 550.0) ** -4, optical_depth * (w / 550.0) ** -1.3


def sunlight(w=WAVELENGTH_NM):
    """Irradiance that is greatest in the green."""
    return 60.0 * np.exp(-(((w - 480.0) / 500.0) ** 2)) + 1.0


def line(centre_nm, width_nm, w=WAVELENGTH_NM):
    """A Gaussian absorption."""
    return np.exp(-(((w - centre_nm) / width_nm) ** 2))


def smooth_terms(blue, haze, sun, direct, gas=1.0, *, path=(0.8, 0.5), w=WAVELENGTH_NM) -> AtmosphericTerms:
    """Terms from (B,) falls, irradiance, light on the way from the ground, and gas transmittance."""
    gas = np.broadcast_to(gas, w.shape).astype(float)
    return AtmosphericTerms(
        wavelength_nm=w,
        path_radiance=path[0] * blue + path[1] * haze,
        direct=direct,
        adjacency=direct * (0.1 * haze + 0.05 * blue),
        spherical_albedo=0.06 * blue + 0.15 * haze,
        ground_irradiance=sun * gas,
        gas_transmittance=gas,
        provenance={"engine": "stand-in"},
    )
