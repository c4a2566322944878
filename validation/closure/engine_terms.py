"""Atmospheric terms of the twin that shares nothing, by SASKTRAN2; no package of this project is imported.

    python validation/closure/engine_terms.py > campaigns/share2012-independent/terms.csv

needs sasktran2 (a development tool, in an environment of its own) and pvlib; the numbers are of version 2026.10.1.
Scalar, plane-parallel discrete ordinates of 16 streams over a Lambertian ground.

- Air: scattering depth by Hansen & Travis (Space Sci. Rev. 16, 527, 1974), density falling over 8 km.
- Aerosol: rural type of LOWTRAN at 70 % relative humidity (Shettle & Fenn, AFGL-TR-79-0214, 1979): extinction,
  absorption and asymmetry between the wavelengths of that table by the logarithm, phase function of Henyey &
  Greenstein, number falling over 2 km.
- Ozone: all above the sensor; water vapour: falling over 2 km; Bird & Riordan (SERI/TR-215-2436, 1984).

Terms over F = mu0 E0 / pi of an equal ground: L = path + total rho / (1 - S rho) at the sensor, and ground light
over pi F, from ground reflectances of 0, 0.3 and 0.6 and observers at the sensor and at the ground; direct = ground
light times the transmittance of the straight way up, adjacency = total - direct.
"""

from __future__ import annotations

import importlib

import numpy as np
import sasktran2 as sk

BIRD = importlib.import_module("pvlib.spectrum.spectrl2")  # the package has a function of that name

GROUND_KM, SENSOR_KM = 0.19, 0.954
PRESSURE_ATM = 0.978  # of the standard atmosphere at the ground
ZENITH_DEG = 42.5
DEPTH_550, WATER_G_CM2, OZONE_ATM_CM = 0.15, 1.4, 0.29
AIR_KM, AEROSOL_KM, WATER_KM = 8.0, 2.0, 2.0
STREAMS, MOMENTS = 16, 64
RURAL_UM = (0.2, 0.3, 0.3371, 0.55, 0.6943, 1.06, 1.536, 2.0)
RURAL_EXTINCTION = (2.09544, 1.74165, 1.59981, 1.0, 0.75316, 0.42171, 0.24323, 0.15108)
RURAL_ABSORPTION = (0.62968, 0.10816, 0.07671, 0.05380, 0.04684, 0.05335, 0.04614, 0.01829)
RURAL_ASYMMETRY = (0.7632, 0.6928, 0.6865, 0.6638, 0.6498, 0.6314, 0.6440, 0.7098)
WAVELENGTHS_NM = np.r_[400:691:10, 770:791:10, 850:891:10, 1030:1061:10, 1230:1251:10, 1600:1651:10].astype(float)
HEIGHT_KM = np.r_[np.arange(0.0, 3.0, 0.1), np.arange(3.0, 10.0, 0.5), np.arange(10.0, 61.0, 2.0)]
GROUNDS = (0.0, 0.3, 0.6)


def air_depth(wavelength_um: np.ndarray) -> np.ndarray:
    """Vertical scattering depth of the air above the ground."""
    w2 = wavelength_um**-2.0
    return 0.008569 * w2**2 * (1.0 + 0.0113 * w2 + 0.00013 * w2**2) * PRESSURE_ATM


def rural(table: tuple[float, ...], wavelength_um: np.ndarray) -> np.ndarray:
    """A row of the aerosol's table between its wavelengths."""
    return np.exp(np.interp(np.log(wavelength_um), np.log(RURAL_UM), np.log(table)))


def exponential(scale_km: float) -> np.ndarray:
    """(H,) depth per km of a unit column, exact on the layers to the trapezium of the engine."""
    profile = np.exp(-HEIGHT_KM / scale_km)
    return profile / np.trapezoid(profile, HEIGHT_KM)


def gas(name: str, wavelength_nm: np.ndarray) -> np.ndarray:
    """Absorption coefficient of Bird & Riordan."""
    table = BIRD._SPECTRL2_COEFFS
    return np.interp(wavelength_nm, table["wavelength"], table[name])


def water_transmittance(wavelength_nm: np.ndarray, amount: float) -> np.ndarray:
    """Of water vapour [g cm-2] (equation 2-8 of that report)."""
    aw = gas("water_vapor_absorption", wavelength_nm) * amount
    return np.exp(-0.2385 * aw / (1.0 + 20.07 * aw) ** 0.45)


def radiance(ground: float, observer_km: float) -> np.ndarray:
    """(W,) radiance straight down over F = mu0 E0 / pi."""
    um, mu0 = WAVELENGTHS_NM / 1e3, np.cos(np.radians(ZENITH_DEG))
    config = sk.Config()
    config.multiple_scatter_source = sk.MultipleScatterSource.DiscreteOrdinates
    config.single_scatter_source = sk.SingleScatterSource.DiscreteOrdinates
    config.num_streams, config.num_singlescatter_moments, config.delta_m_scaling = STREAMS, MOMENTS, True
    geometry = sk.Geometry1D(
        mu0, 0.0, 6371e3, HEIGHT_KM * 1e3, sk.InterpolationMethod.LinearInterpolation, sk.GeometryType.PlaneParallel
    )
    viewing = sk.ViewingGeometry()
    viewing.add_ray(sk.GroundViewingSolar(mu0, 0.0, 1.0, observer_km * 1e3))
    atmosphere = sk.Atmosphere(geometry, config, wavelengths_nm=WAVELENGTHS_NM, calculate_derivatives=False)
    air = np.outer(exponential(AIR_KM), air_depth(um))
    extinction = np.outer(exponential(AEROSOL_KM), DEPTH_550 * rural(RURAL_EXTINCTION, um))
    albedo = 1.0 - rural(RURAL_ABSORPTION, um) / rural(RURAL_EXTINCTION, um)
    high = np.where(HEIGHT_KM >= 15.0, np.exp(-((HEIGHT_KM - 22.0) ** 2) / 50.0), 0.0)
    ozone = np.outer(high / np.trapezoid(high, HEIGHT_KM), OZONE_ATM_CM * gas("ozone_absorption", WAVELENGTHS_NM))
    order = np.arange(MOMENTS)[:, None]
    moments = (2 * order + 1) * rural(RURAL_ASYMMETRY, um)[None] ** order
    isotropic = np.zeros((MOMENTS, um.size))
    isotropic[0], isotropic[2] = 1.0, 0.5
    for name, ext, ssa, phase in (
        ("air", air, np.ones_like(air), isotropic),
        ("aerosol", extinction, np.broadcast_to(albedo, extinction.shape), moments),
        ("ozone", ozone, np.zeros_like(ozone), isotropic),
    ):
        each = np.broadcast_to(phase[:, None, :], (MOMENTS, *ext.shape)).copy()
        atmosphere[name] = sk.constituent.Manual(ext.copy() / 1e3, ssa.copy(), each)
    atmosphere["ground"] = sk.constituent.LambertianSurface(ground)
    out = sk.Engine(config, geometry, viewing).calculate_radiance(atmosphere)
    return np.asarray(out["radiance"].values).reshape(WAVELENGTHS_NM.size) * np.pi / mu0


def terms_of(observer_km: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """path, total and S of L = path + total rho / (1 - S rho)."""
    black, one, two = (radiance(g, observer_km) for g in GROUNDS)
    y1, y2 = (one - black) / GROUNDS[1], (two - black) / GROUNDS[2]
    s = (y2 - y1) / (GROUNDS[2] * y2 - GROUNDS[1] * y1)
    return black, y1 * (1.0 - GROUNDS[1] * s), s


def main() -> None:
    path, total, s = terms_of(SENSOR_KM - GROUND_KM)
    _, light, s_ground = terms_of(1e-3)
    assert np.allclose(s, s_ground, rtol=0.02)
    um, up_km = WAVELENGTHS_NM / 1e3, SENSOR_KM - GROUND_KM
    below = {k: 1.0 - np.exp(-up_km / k) for k in (AIR_KM, AEROSOL_KM)}
    straight = np.exp(-below[AIR_KM] * air_depth(um) - below[AEROSOL_KM] * DEPTH_550 * rural(RURAL_EXTINCTION, um))
    down = WATER_G_CM2 / np.cos(np.radians(ZENITH_DEG))
    up = WATER_G_CM2 * (1.0 - np.exp(-up_km / WATER_KM))
    both = water_transmittance(WAVELENGTHS_NM, down + up)
    first = water_transmittance(WAVELENGTHS_NM, down)
    print("wavelength_nm,path,direct,adjacency,spherical_albedo,ground,water")
    for row in zip(WAVELENGTHS_NM, path * first, light * straight * both, (total - light * straight) * both, s,
                   light * first, both, strict=True):  # fmt: skip
        print(",".join(f"{v:.6g}" for v in row))


if __name__ == "__main__":
    main()
