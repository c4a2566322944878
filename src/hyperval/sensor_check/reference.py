"""Reference radiances: sunlit ground without an atmosphere, and the scenes that publications refer to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere import AtmosphericState, AtmosphericTerms, atmospheric_terms
from hyperval.atmosphere.solar import extraterrestrial_irradiance
from hyperval.sensor.published import PublishedSnr, ReferenceScene
from hyperval.spectra.axis import SpectralAxis
from hyperval.spectra.response import band_average

Array = npt.NDArray[np.float64]
Engine = Callable[[AtmosphericState], AtmosphericTerms]

DARK, MIDDLE, BRIGHT = 0.05, 0.25, 0.60
LEVELS = (DARK, MIDDLE, BRIGHT)
SUN_ZENITH_DEG = 45.0
_GRID_NM = np.arange(300.0, 2700.5, 1.0)


def sunlit_radiance(axis: SpectralAxis, reflectance: float) -> Array:
    """rho E0 cos(45 deg) / pi (B,) [uW cm-2 sr-1 nm-1]: a diffuse ground in the sun, no atmosphere.

    E0 is the extraterrestrial irradiance of ASTM G173 at 1 au, averaged over each band.
    """
    irradiance = band_average(_GRID_NM, extraterrestrial_irradiance("astm-g173", _GRID_NM), axis)
    return np.asarray(reflectance * irradiance * np.cos(np.radians(SUN_ZENITH_DEG)) / np.pi)


def scene_radiance(axis: SpectralAxis, scene: ReferenceScene, engine: Engine | None = None) -> Array:
    """Radiance (B,) [uW cm-2 sr-1 nm-1] of a uniform ground: L_a + (A + B) rho / (1 - S rho) (3.7)."""
    state = AtmosphericState.model_validate(
        {
            "model": scene.model,
            "aerosol": "rural",
            "meteorological_range_km": scene.meteorological_range_km,
            "ground_altitude_km": scene.ground_altitude_km,
            "sensor_altitude_km": scene.sensor_altitude_km,
            "solar_zenith_deg": scene.solar_zenith_deg,
            "solar_azimuth_deg": 180.0,
            "earth_sun_distance_au": 1.0,
        }
    )
    terms = (engine or atmospheric_terms)(state).at_bands(axis)
    rho = scene.reflectance
    return np.asarray(
        terms.path_radiance + (terms.direct + terms.adjacency) * rho / (1.0 - terms.spherical_albedo * rho)
    )


def published_radiance(axis: SpectralAxis, item: PublishedSnr, engine: Engine | None = None) -> Array:
    """Radiance (B,) that a published ratio refers to; that of ground of 0.25 where it does not say."""
    if item.radiance is not None:
        return item.radiance.at(axis.centre_nm)
    if item.scene is not None:
        return scene_radiance(axis, item.scene, engine)
    return sunlit_radiance(axis, MIDDLE)
