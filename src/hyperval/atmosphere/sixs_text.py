"""The input deck of 6S and its printed answer."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hyperval.atmosphere.profiles import Profile
from hyperval.errors import EngineError

Array = npt.NDArray[np.float64]

SPACE = -1000.0
_TOP_LEVEL = (99999.0, 0.0, 210.0, 0.0, 0.0)  # 6S wants a 34th level at infinity


@dataclass(frozen=True)
class Geometry:
    """Sun and view, rounded as they are printed in the deck [deg]."""

    solar_zenith: float
    view_zenith: float
    relative_azimuth: float

    def card(self) -> str:
        """Cards igeom = 0; the date only sets the Earth-Sun distance, which is applied elsewhere."""
        return f"0\n{self.solar_zenith:.4f} {self.relative_azimuth:.4f} {self.view_zenith:.4f} 0.0 1 1\n"


@dataclass(frozen=True)
class Aerosol:
    """Aerosol cards.

    Attributes
    ----------
    card : type card(s) of 6S
    depth_550 : optical depth at 550 nm above the ground
    depth_550_below : the part of it below the sensor
    """

    card: str
    depth_550: float
    depth_550_below: float


def gas_free_atmosphere() -> str:
    """Card idatm = 0: scattering only (US standard 1962 air)."""
    return "0\n"


def profile_atmosphere(profile: Profile) -> str:
    """Card idatm = 7 with the 34 levels: user columns in idatm = 8 go wrong over raised ground."""
    rows = zip(
        profile.altitude_km, profile.pressure_hpa, profile.temperature_k, profile.water_g_m3, profile.ozone_g_m3,
        strict=True,
    )  # fmt: skip
    lines = [" ".join(f"{v:.6e}" for v in row) for row in [*rows, _TOP_LEVEL]]
    return "7\n" + "\n".join(lines) + "\n"


def altitude_card(altitude_km: float) -> str:
    """Altitude as 6S wants it, negative; zero must not be written as -0."""
    text = f"{altitude_km:.5f}"
    return "0" if float(text) == 0.0 else f"-{text}"


def deck(
    geometry: Geometry,
    atmosphere: str,
    ground_km: float,
    height_km: float | None,
    spectral: str,
    aerosol: Aerosol | None = None,
    reflectance: float = 0.0,
) -> str:
    """A complete input deck over uniform Lambertian ground.

    Parameters
    ----------
    ground_km : ground above sea level [km]
    height_km : sensor above the ground [km]; None for space, 0 for a sensor on the ground
    spectral : "-1\\nWL" (one wavelength, um) or "-2\\nFROM TO" (table in steps of 2.5 nm)
    """
    parts = [geometry.card(), atmosphere]
    if aerosol is None:
        parts.append("0\n-1\n")
    else:
        parts.append(f"{aerosol.card}\n0\n{aerosol.depth_550:.6f}\n")
    parts.append(altitude_card(ground_km) + "\n")
    if height_km is None:
        parts.append(f"{SPACE:g}\n")
    elif height_km == 0.0:
        parts.append("0\n")
    else:
        below = 0.0 if aerosol is None else aerosol.depth_550_below
        parts.append(f"{altitude_card(height_km)}\n-1.0 -1.0\n{below:.6f}\n")
    parts.append(f"{spectral}\n0\n0\n0\n{reflectance:.6f}\n-1\n")
    return "".join(parts)


@dataclass(frozen=True)
class Monochromatic:
    """What one single-wavelength run says.

    Attributes
    ----------
    reflectance : apparent reflectance at the sensor (path reflectance over black ground) [1]
    down, up : scattering transmittances, direct and diffuse [1]
    spherical_albedo : [1]
    depth_rayleigh, depth_aerosol : optical depths between ground and sensor [1]
    gas : two-way gas transmittance [1]
    """

    reflectance: float
    down: float
    up: float
    spherical_albedo: float
    depth_rayleigh: float
    depth_aerosol: float
    gas: float


def parse_monochromatic(text: str) -> Monochromatic:
    """Read a single-wavelength run; raises EngineError when a number is missing, NaN or asterisks."""
    number = r"\s+(\S+)"
    reflectance = _one(text, r"apparent reflectance" + number)
    total = _all(text, r"total\s+sca\.\s+\"\s+:" + 3 * number)
    albedo = _all(text, r"spherical albedo\s+:" + 3 * number)
    plane = re.search(r"optical depth plane:" + 3 * number, text)
    depth = _numbers(plane.groups()) if plane else _all(text, r"optical depth total:" + 3 * number)
    gas = _all(text, r"global gas\. trans\. :" + 3 * number)
    return Monochromatic(reflectance, total[0], total[1], albedo[2], depth[0], depth[1], gas[2])


def parse_steps(text: str) -> tuple[Array, Array]:
    """Wavelength [nm] and two-way gas transmittance [1] of a step run."""
    rows = re.findall(r"^\*(\d\.\d{4})\s+(\S+)", text, flags=re.MULTILINE)
    if len(rows) < 2:
        raise EngineError("6S printed no spectral table", expected="rows in steps of 2.5 nm")
    table = np.array([_numbers(r) for r in rows])
    return np.round(table[:, 0] * 1e3, 1), np.clip(table[:, 1], 0.0, 1.0)


def _one(text: str, pattern: str) -> float:
    return _all(text, pattern)[0]


def _all(text: str, pattern: str) -> list[float]:
    match = re.search(pattern, text)
    if not match:
        raise EngineError(f"6S did not print what was looked for: {pattern!r}")
    return _numbers(match.groups())


def _numbers(words: tuple[str, ...]) -> list[float]:
    try:
        values = [float(w) for w in words]
    except ValueError:
        values = [np.nan]
    if not np.all(np.isfinite(values)):
        raise EngineError(f"6S printed {' '.join(words)} where numbers belong")
    return values
