"""Absorption bands and the windows between them.

Limits are rounded positions of the well known gas absorptions of the solar-reflective range
(Gao et al., Remote Sens. Environ. 113, 2009, S17-S24, discuss each); a comparison inside one of
them tests the gas amounts, not the sensor, and is reported apart.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

# (from nm, to nm, gas)
ABSORPTION_BANDS_NM: tuple[tuple[float, float, str], ...] = (
    (685.0, 693.0, "O2 B"),
    (715.0, 735.0, "H2O"),
    (756.0, 772.0, "O2 A"),
    (808.0, 838.0, "H2O"),
    (890.0, 992.0, "H2O"),
    (1080.0, 1180.0, "H2O"),
    (1255.0, 1285.0, "O2"),
    (1300.0, 1510.0, "H2O"),
    (1560.0, 1615.0, "CO2"),
    (1730.0, 2090.0, "H2O, CO2"),
    (2350.0, 2600.0, "H2O, CH4"),
)

# Named parts of the range for summaries, absorption bands left out of each.
SPECTRAL_REGIONS_NM: dict[str, tuple[float, float]] = {
    "VNIR": (400.0, 1000.0),
    "SWIR1": (1000.0, 1800.0),
    "SWIR2": (1800.0, 2500.0),
}


def in_window(wavelength_nm: npt.ArrayLike) -> npt.NDArray[np.bool_]:
    """True for wavelengths between 400 and 2500 nm that lie in no absorption band."""
    w = np.asarray(wavelength_nm, dtype=float)
    clear = (w >= 400.0) & (w <= 2500.0)
    for low, high, _ in ABSORPTION_BANDS_NM:
        clear &= ~((w >= low) & (w <= high))
    return clear
