"""Position of the sun, Earth-Sun distance, and the extraterrestrial spectra to choose from."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from hyperval.data import Array
from hyperval.datasets import resolve
from hyperval.errors import MissingDataError, UsageError, refusal, refuse
from hyperval.paths import read_text
from hyperval.spectra.text import number_table
from hyperval.storage import installed_file
from hyperval.units import to_internal

TSIS_1 = "solar_tsis_1.csv"  # made by validation/atmosphere/solar_table.py
_KURUCZ = "data:sensors/kurudz_0.1nm.dat.gz"
SPECTRA = ("tsis-1", "astm-g173", "kurucz")
_MAX_BYTES = 64 << 20
_DELTA_T_S = 67.0  # terrestrial time minus UT1; a second of it moves the sun by 1e-5 deg
_FINE_NM = 0.1
_LINES_NM = 0.5  # sampling of the sunlight that bands are averaged over
_EXTENSION_NM = 210.0
_REACH_NM = 12.0  # how far the end value of a spectrum may be carried on


def reference_of(name: str) -> str | None:
    """The file reference of a solar spectrum; None for those that every installation has."""
    return _KURUCZ if name == "kurucz" else None


def source_samples(name: str) -> tuple[Array, Array]:
    """Wavelength [nm] and irradiance at 1 au [uW cm-2 nm-1] of a spectrum as its source samples it.

    Raises as :func:`extraterrestrial_irradiance`.
    """
    return _spectrum(name, os.environ.get("HYPERVAL_DATA", ""), os.environ.get("HYPERVAL_CACHE", ""))


def parse_utc(text: str) -> datetime:
    """Read an ISO 8601 time; without an offset it is UTC.  Raises UsageError."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise refusal("sun.time", text=text) from error
    return when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)


@lru_cache(maxsize=64)
def solar_position(latitude_deg: float, longitude_deg: float, when: datetime) -> tuple[float, float]:
    """True (not refracted) solar zenith and azimuth, east of north [deg]; longitude east positive."""
    # Pressure [mbar], temperature and refraction move the apparent zenith alone.
    angles = _algorithm().solar_position(
        np.array([when.timestamp()]), latitude_deg, longitude_deg, 0.0, 1013.25, 12.0, _DELTA_T_S, 0.5667
    )
    return float(angles[1][0]), float(angles[4][0])


def earth_sun_distance_au(when: datetime) -> float:
    """Distance of the Earth from the Sun [au]."""
    return float(_algorithm().earthsun_distance(np.array([when.timestamp()]), _DELTA_T_S, 1)[0])


@lru_cache(maxsize=1)
def _algorithm() -> Any:
    """The module of pvlib with the SPA algorithm, without the rest of the package.

    That loads pandas and twenty parts of SciPy, half of the time of a prediction.
    """
    loader = SourceFileLoader("pvlib.spa", str(installed_file("pvlib", "spa.py")))
    module = ModuleType(loader.name)
    loader.exec_module(module)
    return module


def distance_on_day(day_of_year: int) -> float:
    """Distance at noon UTC of a day of a common year [au]; it differs by 2e-4 from year to year."""
    return earth_sun_distance_au(datetime(2018, 1, 1, 12, tzinfo=UTC) + timedelta(days=day_of_year - 1))


def extraterrestrial_irradiance(name: str, wavelength_nm: Array, distance_au: float = 1.0) -> Array:
    """Solar irradiance outside the atmosphere [uW cm-2 nm-1], averaged onto a wavelength grid.

    Each value is the average over the two neighbouring grid steps with triangular weight, so that
    linear interpolation between the grid points keeps the energy of the Fraunhofer lines.

    Parameters
    ----------
    name : "tsis-1", "astm-g173" or "kurucz" (a file of the data directory)
    wavelength_nm : (n,) increasing, at least two
    distance_au : Earth-Sun distance; the spectra hold at 1 au

    Raises
    ------
    UsageError : unknown name, or the spectrum does not cover the grid.
    MissingDataError : the file is not at hand.
    """
    grid = np.asarray(wavelength_nm, dtype=float)
    source_nm, irradiance = _extended(*source_samples(name), grid)
    uncovered = grid[0] < source_nm[0] - _REACH_NM or grid[-1] > source_nm[-1] + _REACH_NM
    refuse(uncovered, "sun.short", name=name, covers=source_nm[[0, -1]], wanted=grid[[0, -1]])
    step = np.gradient(grid)
    count = int(np.ceil(2.0 * step.max() / _FINE_NM)) | 1
    offset = np.linspace(-1.0, 1.0, count)
    weight = 1.0 - np.abs(offset)
    values = np.interp(grid[:, None] + offset * step[:, None], source_nm, irradiance)
    return np.asarray(values @ weight / weight.sum()) / distance_au**2


def lines_between(name: str, wavelength_nm: Array) -> tuple[Array, Array]:
    """Finer wavelengths [nm], and there the irradiance over the straight line between its values on a grid [1].

    Values of the grid, and the finer ones every half nanometre, are those of :func:`extraterrestrial_irradiance`.
    Bands of 3 nm and more see the Fraunhofer lines through half a nanometre as through the source's own samples.
    Raises as that function.

    Parameters
    ----------
    wavelength_nm : (n,) increasing
    """
    fine_nm = np.arange(wavelength_nm[0], wavelength_nm[-1] + 1e-6, _LINES_NM)
    between = np.interp(fine_nm, wavelength_nm, extraterrestrial_irradiance(name, wavelength_nm))
    return fine_nm, extraterrestrial_irradiance(name, fine_nm) / between


def _extended(source_nm: Array, irradiance: Array, grid: Array) -> tuple[Array, Array]:
    """The spectrum continued to the ends of the grid with the shape of ASTM G173.

    At most ``_EXTENSION_NM``; the level is that of the two spectra's averages over the last 20 nm they share.
    """
    (wide_nm, wide), (first, last) = source_samples("astm-g173"), source_nm[[0, -1]]
    below, above = (first - grid[0], first, first + 20.0), (grid[-1] - last, last - 20.0, last)
    for (gap, low, high), more in ((below, wide_nm < first), (above, wide_nm > last)):
        if 0.0 < gap <= _EXTENSION_NM:
            level = np.mean(irradiance[(source_nm >= low) & (source_nm <= high)])
            level /= np.mean(np.interp(np.linspace(low, high, 41), wide_nm, wide))
            source_nm, irradiance = np.append(source_nm, wide_nm[more]), np.append(irradiance, wide[more] * level)
    order = np.argsort(source_nm)
    return source_nm[order], irradiance[order]


@lru_cache(maxsize=8)
def _spectrum(name: str, *places: str) -> tuple[Array, Array]:
    """The same; ``places`` tell one data directory from another."""
    if name == "tsis-1":
        nm, irradiance = np.loadtxt(Path(__file__).with_name(TSIS_1), delimiter=",", unpack=True)
        return nm, irradiance * to_internal("mW m-2 nm-1", "irradiance")
    if name == "astm-g173":
        table = np.loadtxt(installed_file("pvlib", "data", "ASTMG173.csv"), delimiter=",", skiprows=2, usecols=(0, 1))
        return table[:, 0], table[:, 1] * to_internal("W m-2 nm-1", "irradiance")
    refuse(name not in SPECTRA, "sun.spectrum", name=name, known=", ".join(SPECTRA))
    try:
        path = resolve(_KURUCZ)
    except (MissingDataError, UsageError) as error:  # no registered set has it
        words = refusal("sun.absent", name=name, mend=error.mend)
        raise MissingDataError(words.what, where=error.where, mend=words.mend) from error
    nm, irradiance = number_table(read_text(path, _MAX_BYTES), path)[1][:, :2].T
    return nm, irradiance * to_internal("mW m-2 nm-1", "irradiance")
