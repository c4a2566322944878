"""Absorption that oxygen owes to collisions: the smooth bands at 1.27 and 1.06 um.

Two molecules that meet absorb where one alone does not, so the absorption coefficient goes with the
product of two densities (binary absorption):

    k(nu) = K(nu) rho_O2 rho_air        tau = K(nu) integral of rho_O2 rho_air dz

Densities are in amagat (one at 273.15 K and 1013.25 hPa), K in cm-1 amagat-2, for air of 21 % oxygen.
The 6S engine knows the lines of these bands only.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.profiles import Profile, pressures_at

Array = npt.NDArray[np.float64]

OXYGEN: Final = 0.2095  # mole fraction in dry air
_STP_K, _STP_HPA = 273.15, 1013.25
_STEP_KM = 0.05
_CM_PER_KM = 1e5

# 1.27 um: wavenumber [cm-1] and K [1e-9 cm-1 amagat-2].  Maté et al., J. Geophys. Res. 104 (1999), 30585-30590, as
# taken up by the MT_CKD continuum (Mlawer et al., Phil. Trans. R. Soc. A 370, 2012, 2520-2556); O2-O2 and O2-N2
# together.  Least squares on its values every 10 cm-1, straight in the logarithm between: rms 0.2 %, at
# most 1.3 % of the peak; band strength 0.1 % smaller.
_BAND_1270: Final = np.array([
    (7550, 2.98), (7650, 12.2), (7700, 29.3), (7750, 66.7), (7800, 169), (7830, 319), (7850, 451), (7865, 613),
    (7880, 768), (7895, 802), (7910, 764), (7930, 599), (7950, 429), (7970, 321), (7990, 247), (8020, 175),
    (8060, 121), (8100, 85.1), (8150, 52.7), (8200, 29.1), (8260, 13.4), (8320, 5.28), (8400, 2.94), (8490, 1.99),
]).T  # fmt: skip

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
    at, strength = _BAND_1270
    first = np.exp(np.interp(nu, at, np.log(strength * 1e-9)))
    first = np.where((nu >= at[0]) & (nu <= at[-1]), first, 0.0)
    second = np.zeros_like(nu)
    for centre, width, area in _BAND_1060:
        damping = np.exp(np.minimum(nu - centre, 0.0) / _DAMPING_CM)
        second += area * damping / (np.pi * width * (1.0 + ((nu - centre) / width) ** 2))
    inside = (nu >= _RANGE_1060_CM[0]) & (nu <= _RANGE_1060_CM[1])
    return np.asarray(first + np.where(inside, second * _FACTOR_1060 * _LOSCHMIDT_1E20, 0.0))


def collision_column(profile: Profile, bottom_km: float, top_km: float | None = None) -> float:
    """Integral of rho_O2 rho_air over altitude [amagat2 cm], up to the top of the profile by default."""
    highest = float(profile.altitude_km[-1])
    top = highest if top_km is None else min(top_km, highest)
    if top <= bottom_km:
        return 0.0
    z = np.linspace(bottom_km, top, int(np.ceil((top - bottom_km) / _STEP_KM)) + 1)
    temperature = np.interp(z, profile.altitude_km, profile.temperature_k)
    air = (pressures_at(profile, z) / _STP_HPA) * (_STP_K / temperature)  # amagat
    return float(OXYGEN * np.trapezoid(air**2, z) * _CM_PER_KM)


def continuum_depth(wavelength_nm: Array, profile: Profile, bottom_km: float, top_km: float | None = None) -> Array:
    """Vertical optical depth of the collision-induced bands between two altitudes, (n,)."""
    return binary_coefficient(1e7 / wavelength_nm) * collision_column(profile, bottom_km, top_km)
