"""What MODTRAN 6 has over the embedded engine: gases by air mass and water, aerosol's path, spherical albedo.

The band model of 6S is off by a pattern that is the same in every state, so it is corrected.  In each channel

    T_MODTRAN / T_6S = exp(-dry(nm) a - water(nm) u)

with a the air on the light's way [atm, slanted] and u the water on it [g cm-2, slanted].  Two further
patterns belong to the rural aerosol: how much of it 6S sees in the path radiance, and its part in the spherical
albedo, which the aerosol of the free troposphere does not share.
The numbers (``engine_ratio.csv``) and their errors come from ``validation/atmosphere/engine_ratio.py``;
docs/atmosphere.md tells how well they predict states that they were not made from.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import expn

from hyperval.atmosphere import visibility
from hyperval.atmosphere.profiles import column_g_cm2, pressure_at, scaled_profile
from hyperval.atmosphere.state import AtmosphericState

Array = npt.NDArray[np.float64]

FILE: Final = "engine_ratio.csv"
# Slanted amounts up to which the states of MODTRAN reach.  Beyond them absorption grows with the root of the
# amount, as that of strong lines does, with the slope it has there.
GREATEST_AIR_ATM, GREATEST_WATER_G_CM2 = 1.8, 4.6
# From this height on LOWTRAN's profile is the same for every haze: finer aerosol than the rural type.
FREE_TROPOSPHERE_KM = 5.0
# At most this part of what 6S absorbs is taken back: the absorption of strong lines grows with the root of their
# amount, so that with half of it left more water lets no more light through.
_GREATEST_SHARE_BACK = 0.5
_STANDARD_HPA = 1013.25


@dataclass(frozen=True)
class Way:
    """Air [atm] and water [g cm-2] on a slanted way."""

    air_atm: float
    water_g_cm2: float


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

    def gas(self, wavelength_nm: Array, air_atm: float, water_g_cm2: float) -> Array:
        """(n,) factor on the transmittance of the gases over a way with so much air and water [1]."""
        air = _strong_line(air_atm, GREATEST_AIR_ATM)
        water = _strong_line(water_g_cm2, GREATEST_WATER_G_CM2)
        depth = self.dry * air + self.water * water
        return np.asarray(np.exp(-np.interp(wavelength_nm, self.wavelength_nm, depth)))

    def within(self, wavelength_nm: Array, way: Way, dry_depth: Array, water_depth: Array) -> EngineRatio:
        """The ratio at (n,) wavelengths; neither part takes back more than half of the engine's depth on a way.

        What water has too much of in all states alike stands in ``dry``, so that both depths count for it.
        """
        air = _strong_line(way.air_atm, GREATEST_AIR_ATM)
        water = _strong_line(way.water_g_cm2, GREATEST_WATER_G_CM2)
        at = [np.interp(wavelength_nm, self.wavelength_nm, getattr(self, f.name)) for f in fields(self)[1:]]
        at[0] = np.maximum(at[0], -_GREATEST_SHARE_BACK * (dry_depth + water_depth) / air)
        at[1] = np.maximum(at[1], -_GREATEST_SHARE_BACK * water_depth / water)
        return EngineRatio(wavelength_nm, *at)

    def aerosol_path(self, wavelength_nm: Array) -> Array:
        """(n,) factor on the path radiance of rural aerosol [1]."""
        return np.asarray(np.interp(wavelength_nm, self.wavelength_nm, self.path))

    def spherical_albedo(self, wavelength_nm: Array, own: Array, molecules: Array, low_share: float) -> Array:
        """(n,) spherical albedo under rural aerosol, from the engine's ``own`` and that of the molecules alone [1].

        S = S_molecules + albedo * low_share * (S_own - S_molecules) with the share of the depth below the free
        troposphere (:func:`low_share`): the finer aerosol above sends next to nothing back.
        """
        factor = np.interp(wavelength_nm, self.wavelength_nm, self.albedo)
        return np.asarray(molecules + factor * low_share * (own - molecules))


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


def ways(state: AtmosphericState) -> tuple[Way, Way]:
    """From the sun to the ground, and from there to the sensor as well."""
    ground, sensor = state.ground_altitude_km, state.sensor_altitude_km
    profile = scaled_profile(state.model, ground, state.water_vapour_g_cm2, state.ozone_atm_cm)
    mu0, mu_v = np.cos(np.deg2rad([state.sun[0], state.view_zenith_deg]))
    air = pressure_at(profile, ground) / _STANDARD_HPA
    water = column_g_cm2(profile, profile.water_g_m3, ground)
    above_air = above_water = 0.0
    if not state.in_space:
        above_air = pressure_at(profile, sensor) / _STANDARD_HPA
        above_water = column_g_cm2(profile, profile.water_g_m3, sensor)
    down = Way(float(air / mu0), float(water / mu0))
    return down, Way(
        float(down.air_atm + (air - above_air) / mu_v),
        float(down.water_g_cm2 + (water - above_water) / mu_v),
    )


@cache
def engine_ratio() -> EngineRatio:
    """The numbers that the package ships."""
    text = resources.files("hyperval.atmosphere").joinpath(FILE).read_text("utf-8")
    rows = csv.reader(line for line in text.splitlines() if not line.startswith("#"))
    next(rows)  # the heading
    return EngineRatio(*np.array([[float(x) for x in row] for row in rows]).T)


def _strong_line(amount: float, greatest: float) -> float:
    """The amount, beyond the greatest one growing with its root and no jump in value or slope."""
    return amount if amount <= greatest else 2.0 * float(np.sqrt(amount * greatest)) - greatest
