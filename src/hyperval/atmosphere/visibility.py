"""Meteorological range to aerosol optical depth by the rule of LOWTRAN and MODTRAN.

The rule (Kneizys et al., Users Guide to LOWTRAN 7, AFGL-TR-88-0177, 1988, section 3.3; Shettle &
Fenn, AFGL-TR-79-0214, 1979): extinction at 550 nm is tabulated at 0-2 km for a few meteorological
ranges and is linear in 1/range between them; above lie a tropospheric haze to 10 km and a background
stratosphere, spring-summer, neither of which follows the range below 23 km.  Ground above sea level
compresses the lowest 6 km.  Extinction is exponential between levels, but linear where one
aerosol type ends and the next begins.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.profiles import root_between
from hyperval.errors import UsageError

Array = npt.NDArray[np.float64]

SHORTEST_KM, LONGEST_KM = 2.0, 300.0

_RANGES_KM = np.array([2.0, 5.0, 10.0, 23.0, 50.0])
# Extinction at 550 nm [km-1] at 0, 1, 2 km (rows) for those ranges (columns): boundary layer.
_BOUNDARY = np.array(
    [[1.94, 0.770, 0.379, 0.158, 0.0662], [1.94, 0.770, 0.379, 0.0991, 0.0415], [0.0621] * 4 + [0.0260]]
)
# At 3 ... 10 km for 23 km and for 50 km: troposphere, spring-summer.
_TROPOSPHERE = np.array(
    [
        [3.46e-2, 1.85e-2, 9.31e-3, 7.71e-3, 6.23e-3, 3.37e-3, 1.82e-3, 1.14e-3],
        [1.46e-2, 1.02e-2, 9.31e-3, 7.71e-3, 6.23e-3, 3.37e-3, 1.82e-3, 1.14e-3],
    ]
)
# At 11 ... 25 and 30 km: background stratosphere, spring-summer; above: meteoric dust, then nothing.
_STRATOSPHERE = np.array(
    [7.99e-4, 6.41e-4, 5.17e-4, 4.42e-4, 3.95e-4, 3.82e-4, 4.25e-4, 5.20e-4, 5.81e-4, 5.89e-4,
     5.02e-4, 4.20e-4, 3.00e-4, 1.98e-4, 1.31e-4, 3.32e-5]
)  # fmt: skip
_UPPER = np.array([1.64e-5, 7.99e-6, 4.01e-6, 2.10e-6, 1.60e-7, 9.31e-10])
_LEVELS_KM = np.concatenate([np.arange(26.0), [30.0, 35.0, 40.0, 45.0, 50.0, 70.0, 100.0]])
_TYPE_ENDS = (2, 10, 26)  # the last level of boundary layer, troposphere, stratosphere
_COMPRESSED_BELOW_KM = 6.0


def aot550_from_range(range_km: float, ground_km: float = 0.0, below_km: float | None = None) -> float:
    """Vertical aerosol optical depth at 550 nm above the ground, or between ground and ``below_km``.

    Parameters
    ----------
    range_km : meteorological range at the ground [km], 2-300
    ground_km : ground altitude above sea level [km]
    below_km : upper end [km above sea level]; None for the whole atmosphere

    Raises
    ------
    UsageError : the range lies outside 2-300 km.
    """
    if not SHORTEST_KM <= range_km <= LONGEST_KM:
        raise UsageError(f"meteorological range {range_km:g} km", expected=f"{SHORTEST_KM:g} to {LONGEST_KM:g} km")
    top = _LEVELS_KM[-1] if below_km is None else min(below_km, float(_LEVELS_KM[-1]))
    level = _levels_above_ground(ground_km)
    extinction = _extinction(range_km)
    total = 0.0
    for i in range(level.size - 1):
        if level[i] >= top:
            break
        part = min(1.0, (top - level[i]) / (level[i + 1] - level[i]))
        total += _layer(extinction[i], extinction[i + 1], level[i + 1] - level[i], part, i in _TYPE_ENDS)
    return total


@lru_cache(maxsize=256)
def range_from_aot550(aot550: float, ground_km: float = 0.0) -> float:
    """Meteorological range [km] that has this optical depth, held within 2-300 km."""
    low, high = aot550_from_range(SHORTEST_KM, ground_km), aot550_from_range(LONGEST_KM, ground_km)
    if aot550 >= low:
        return SHORTEST_KM
    if aot550 <= high:
        return LONGEST_KM
    return root_between(lambda km: aot550_from_range(km, ground_km) - aot550, SHORTEST_KM, LONGEST_KM)


def fraction_below(aot550: float, ground_km: float, sensor_km: float) -> float:
    """Share of the aerosol optical depth between the ground and the sensor, by the same rule."""
    range_km = range_from_aot550(aot550, ground_km)
    return aot550_from_range(range_km, ground_km, sensor_km) / aot550_from_range(range_km, ground_km)


def _extinction(range_km: float) -> Array:
    """Extinction at the levels [km-1]: linear in 1/range, beyond 50 km on the last slope."""
    inverse = 1.0 / _RANGES_KM[::-1]
    x = 1.0 / range_km
    i = int(np.clip(np.searchsorted(inverse, x) - 1, 0, inverse.size - 2))
    w = (x - inverse[i]) / (inverse[i + 1] - inverse[i])
    rows = _BOUNDARY[:, ::-1]
    boundary = rows[:, i] + w * (rows[:, i + 1] - rows[:, i])
    w23 = min(1.0, (x - 1 / 50.0) / (1 / 23.0 - 1 / 50.0))
    troposphere = _TROPOSPHERE[1] + w23 * (_TROPOSPHERE[0] - _TROPOSPHERE[1])
    return np.asarray(np.maximum(np.concatenate([boundary, troposphere, _STRATOSPHERE, _UPPER]), 1e-12))


def _levels_above_ground(ground_km: float) -> Array:
    low = _LEVELS_KM <= _COMPRESSED_BELOW_KM
    squeeze = (_COMPRESSED_BELOW_KM - ground_km) / _COMPRESSED_BELOW_KM
    return np.where(low, ground_km + _LEVELS_KM * squeeze, _LEVELS_KM)


def _layer(low: float, high: float, depth_km: float, part: float, linear: bool) -> float:
    """Optical depth of the lowest ``part`` of a layer whose extinction goes from ``low`` to ``high``."""
    if linear:  # the lower type falls to zero, the upper one rises from zero
        # A sensor inside the layer splits it, and the split lower type is taken as exponential again.
        lower = 0.5 if part >= 1.0 else -(part**2) / np.log1p(-part)
        return float(depth_km * (low * lower + high * 0.5 * part**2))
    rate = np.log(high / low)
    if abs(rate) < 1e-9:
        return depth_km * part * low
    return float(depth_km * low * np.expm1(rate * part) / rate)
