"""What the 6S engine lacks: absorption by colliding oxygen molecules, and its differences from MODTRAN 6.

Two molecules that meet absorb where one alone does not, in smooth bands at 1.27 and 1.06 um of which 6S knows the lines
alone.  The absorption coefficient goes with the product of two densities:

    k(nu) = K(nu) rho_O2 rho_air        tau = K(nu) integral of rho_O2 rho_air dz

Densities are in amagat (one at 273.15 K and 1013.25 hPa), K in cm-1 amagat-2, for air of 21 % oxygen.

The band model of 6S is off by a pattern that is the same in every state.  In each channel

    T_MODTRAN / T_6S = exp(-dry(nm) a - water(nm) u)

with a the air on the light's way [atm, slanted] and u the water on it [g cm-2, slanted].  Two further patterns belong
to the rural aerosol: its part in the path radiance, and in the spherical albedo, which the aerosol of the free
troposphere does not share.  The numbers (``engine_ratio.csv``) come from ``validation/atmosphere/engine_ratio.py``;
validation/atmosphere/README.md tells how well they predict states that they were not made from.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Final

import numpy as np
from scipy.special import expn

from hyperval.atmosphere import state as visibility
from hyperval.atmosphere.state import AtmosphericState, Profile, column_g_cm2, pressure_at
from hyperval.data import Array

FILE: Final = "engine_ratio.csv"
# Slanted amounts up to which the states of MODTRAN reach.  Beyond them absorption grows with the root of the
# amount, as that of strong lines does, with the slope it has there.
MAX_AIR_ATM, MAX_WATER_G_CM2 = 1.8, 4.6
# From this height on LOWTRAN's profile is the same for every haze: finer aerosol than the rural type.
FREE_TROPOSPHERE_KM = 5.0
# At most this part of what 6S absorbs is taken back: the absorption of strong lines grows with the root of their
# amount, so that with half of it left more water lets no more light through.
_MAX_SHARE_BACK = 0.5


@dataclass(frozen=True)
class EngineRatio:
    """Corrections by wavelength, (n,) each.

    Attributes
    ----------
    wavelength_nm : increasing [nm]
    dry : optical depth per slanted atmosphere of air [1]
    water : optical depth per slanted g cm-2 of water vapour [cm2 g-1]
    path : factor on the rural aerosol's part of the path radiance [1]
    albedo : factor on the rural aerosol's part of the spherical albedo [1]
    """

    wavelength_nm: Array
    dry: Array
    water: Array
    path: Array
    albedo: Array

    def at(self, wavelength_nm: Array) -> EngineRatio:
        """The ratio at (n,) wavelengths."""
        columns = (np.interp(wavelength_nm, self.wavelength_nm, getattr(self, f.name)) for f in fields(self)[1:])
        return EngineRatio(wavelength_nm, *columns)

    def gas(self, air_atm: float, water_g_cm2: float) -> Array:
        """(n,) factor on the transmittance of the gases over a way with so much air and water [1]."""
        air = _strong_line(air_atm, MAX_AIR_ATM)
        return np.asarray(np.exp(-(self.dry * air + self.water * _strong_line(water_g_cm2, MAX_WATER_G_CM2))))

    def within(self, way: Array, dry_depth: Array, water_depth: Array) -> EngineRatio:
        """The ratio of which neither part takes back more than half of the engine's depth (n,) on a way.

        What water has too much of in all states alike stands in ``dry``, so that both depths count for it.
        """
        air = _strong_line(way[0], MAX_AIR_ATM)
        water = _strong_line(way[1], MAX_WATER_G_CM2)
        dry = np.maximum(self.dry, -_MAX_SHARE_BACK * (dry_depth + water_depth) / air)
        return replace(self, dry=dry, water=np.maximum(self.water, -_MAX_SHARE_BACK * water_depth / water))

    def spherical_albedo(self, albedo: Array, molecules: Array, low_share: float) -> Array:
        """(n,) spherical albedo under rural aerosol, from the engine's ``own`` and that of the molecules alone [1].

        S = S_molecules + albedo * low_share * (S_own - S_molecules) with the share of the depth below the free
        troposphere (:func:`low_share`): the finer aerosol above sends next to nothing back.
        """
        return np.asarray(molecules + self.albedo * low_share * (albedo - molecules))


def low_share(state: AtmosphericState) -> float:
    """Share of the aerosol's depth below the free troposphere, by LOWTRAN's profile [1].

    Where more of the haze is stated to lie below an aircraft than the profile has, no more is above than it leaves.
    """
    depth, ground = state.aerosol_optical_depth, state.ground_altitude_km
    if depth == 0.0:
        return 1.0
    above = 1.0 - visibility.fraction_below(depth, ground, max(FREE_TROPOSPHERE_KM, ground + 1.0))
    if state.aerosol_share_below is not None:
        above = min(above, 1.0 - state.aerosol_share_below)
    return 1.0 - above


def molecular_albedo(depth: Array) -> Array:
    """(n,) spherical albedo of molecules of an optical depth (n,) [1].

    [3 t - (4 + 2 t) E3(t) + 2 exp(-t)] / (4 + 3 t).  Source: Vermote & Tanre, J. Quant. Spectrosc. Radiat. Transfer
    47, 305-314, 1992.

    Examples
    --------
    >>> molecular_albedo(np.array([0.01, 0.1])).round(4).tolist()
    [0.0097, 0.084]
    """
    t = np.asarray(depth, dtype=float)
    return np.asarray((3.0 * t - (4.0 + 2.0 * t) * expn(3, t) + 2.0 * np.exp(-t)) / (4.0 + 3.0 * t))


def amounts(state: AtmosphericState) -> tuple[Array, Array]:
    """(3, 2) of air [atm], water [g cm-2] and ozone [atm cm], and that weighted by pressure [atm].

    From the sun to the ground, and from there to the sensor as well.
    """
    profile = state.profile
    weighted = profile.water_g_m3 * profile.pressure_hpa / visibility.STP_HPA

    def above(km: float) -> Array:
        if km >= visibility.SPACE_KM:
            return np.zeros((3, 2))
        air = pressure_at(profile, km) / visibility.STP_HPA
        water, ozone = visibility.gas_columns(profile, km)
        return np.array([[air, 0.5 * air**2], [water, column_g_cm2(profile, weighted, km)], [ozone, ozone]])

    mu0, mu_v = np.cos(np.deg2rad([state.sun[0], state.view_zenith_deg]))
    ground = above(state.ground_altitude_km)
    return ground / mu0, ground / mu0 + (ground - above(state.sensor_altitude_km)) / mu_v


@cache
def engine_ratio() -> EngineRatio:
    """The numbers that the package ships."""
    return EngineRatio(*visibility.shipped_numbers(FILE).T)


def _strong_line(amount: float, greatest: float) -> float:
    """The amount, beyond the greatest one growing with its root and no jump in value or slope."""
    return amount if amount <= greatest else 2.0 * float(np.sqrt(amount * greatest)) - greatest


OXYGEN: Final = 0.2095  # mole fraction in dry air
_STEP_KM = 0.05
_CM_PER_KM = 1e5

_BAND_1270: Final = visibility.shipped_numbers("oxygen_1270.csv").T  # 1.27 um: wavenumber and K
# 1.06 um: two Lorentz profiles, damped below their centres, fitted to sunlight seen through the atmosphere by
# Mlawer et al., J. Geophys. Res. 103 (1998), 3859-3863, with the factor that MT_CKD puts to it.
# Centre [cm-1], half width [cm-1], strength [cm-1 per 1e20 molecules cm-2 and amagat].
_BAND_1060: Final = ((9375.0, 58.96, 1.166e-4), (9439.0, 45.04, 3.086e-5))
_DAMPING_CM, _FACTOR_1060 = 176.1, 1.054
_RANGE_1060_CM = (9100.0, 11000.0)
_LOSCHMIDT_1E20 = 0.268678  # molecules in a cubic centimetre at one amagat [1e20]


def binary_coefficient(wavenumber_cm: Array) -> Array:
    """Binary absorption coefficient K of oxygen in air [cm-1 amagat-2] at wavenumbers [cm-1].

    Zero outside 7550-8490 and 9100-11000 cm-1.  The values hold at 296 K and are used at every temperature.
    """
    nu = np.asarray(wavenumber_cm, dtype=np.float64)
    band, strength = _BAND_1270
    first = np.exp(np.interp(nu, band, np.log(strength * 1e-9)))
    first = np.where((nu >= band[0]) & (nu <= band[-1]), first, 0.0)
    second = np.zeros_like(nu)
    for centre, width, area in _BAND_1060:
        damping = np.exp(np.minimum(nu - centre, 0.0) / _DAMPING_CM)
        second += area * damping / (np.pi * width * (1.0 + ((nu - centre) / width) ** 2))
    inside = (nu >= _RANGE_1060_CM[0]) & (nu <= _RANGE_1060_CM[1])
    return np.asarray(first + np.where(inside, second * _FACTOR_1060 * _LOSCHMIDT_1E20, 0.0))


def collision_column(profile: Profile, bottom_km: float, top_km: float = np.inf) -> float:
    """Integral of rho_O2 rho_air over altitude [amagat2 cm], up to the top of the profile by default."""
    top = min(top_km, float(profile.altitude_km[-1]))
    z = np.linspace(bottom_km, top, int(np.ceil((top - bottom_km) / _STEP_KM)) + 1)
    temperature = np.interp(z, profile.altitude_km, profile.temperature_k)
    air = (pressure_at(profile, z) / visibility.STP_HPA) * (visibility.STP_K / temperature)  # amagat
    return float(OXYGEN * np.trapezoid(air**2, z) * _CM_PER_KM)


def continuum_depth(wavelength_nm: Array, profile: Profile, bottom_km: float, top_km: float = np.inf) -> Array:
    """Vertical optical depth of the collision-induced bands between two altitudes, (n,)."""
    return binary_coefficient(1e7 / wavelength_nm) * collision_column(profile, bottom_km, top_km)
