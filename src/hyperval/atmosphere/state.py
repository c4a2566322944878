"""The state of the atmosphere, sun and sensor: what an engine is asked about.

Standard atmospheres are those of McClatchey et al., AFCRL-72-0497 (1972), table 1, with water vapour and ozone scaled
to the columns of a state.

Meteorological range becomes aerosol optical depth by the rule of LOWTRAN and MODTRAN (Kneizys et al., Users Guide to
LOWTRAN 7, AFGL-TR-88-0177, 1988, section 3.3; Shettle & Fenn, AFGL-TR-79-0214, 1979): extinction at 550 nm is tabulated
at 0-2 km for a few ranges and is linear in 1/range between them; above lie a tropospheric haze to 10 km and a
background stratosphere, spring-summer, neither of which follows the range below 23 km.  Ground above sea level
compresses the lowest 6 km.  Extinction is exponential between levels, but linear where one aerosol type ends and the
next begins.

For a sensor inside such a layer LOWTRAN and MODTRAN split it and take the lower type as exponential down to what is
left of it, -p^2 / ln(1 - p) of the layer's lower value for the part p: this falls from p = 0.72 on and steps up to 1/2
at p = 1.  Here the straight line itself is integrated, p - p^2 / 2, which rises all the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib import resources
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationInfo, field_validator, model_validator

from hyperval.atmosphere import solar
from hyperval.config import Model
from hyperval.data import Array
from hyperval.errors import UsageError, refuse

_GRAVITY = 9.81  # m s-2
_AIR_DENSITY_STP = 1.2928  # kg m-3 at 273.15 K and 1013.25 hPa
STP_K, STP_HPA = 273.15, 1013.25
OZONE_G_CM2_PER_ATM_CM = 2.1415e-3  # 48.0 g mol-1 / 22414 cm3 mol-1


@dataclass(frozen=True)
class Profile:
    """One column of air, 33 levels from the sea to 100 km.

    Attributes
    ----------
    altitude_km, pressure_hpa, temperature_k : (33,) level, pressure, temperature
    water_g_m3, ozone_g_m3 : (33,) densities
    """

    altitude_km: Array
    pressure_hpa: Array
    temperature_k: Array
    water_g_m3: Array
    ozone_g_m3: Array

    def air_column(self, above_km: float) -> float:
        """Column of molecules above an altitude, as the integral of pressure / temperature [hPa K-1 km].

        The Rayleigh optical depth is proportional to it.
        """
        inside = self.altitude_km > above_km
        z = np.concatenate([[above_km], self.altitude_km[inside]])
        temperature = np.interp(z, self.altitude_km, self.temperature_k)
        return float(np.trapezoid(pressure_at(self, z) / temperature, z))

    def altitude_of_air_column(self, column: float) -> float:
        """Altitude above which there is a column of molecules [km]; not below 0."""
        if column >= self.air_column(0.0):
            return 0.0
        return root_between(lambda z: self.air_column(z) - column, 0.0, float(self.altitude_km[-1]))


@cache
def standard_profile(model: str) -> Profile:
    """The standard atmosphere named ``model``; raises UsageError for an unknown name."""
    refuse(model not in _MODELS, "state.model", model=model, known=", ".join(_MODELS))
    levels = shipped_numbers("standard_atmospheres.csv", usecols=range(1, 6)).reshape(len(_MODELS), -1, 5)
    return Profile(*levels[_MODELS.index(model)].T)


def column_g_cm2(profile: Profile, density_g_m3: Array, above_km: float) -> float:
    """Mass of a gas above an altitude [g cm-2]: (1/g) integral of its mixing ratio over pressure.

    The hydrostatic form is used, not the integral of the density over altitude, because the solver
    integrates absorption over pressure; the rounded table makes the two differ by about 1 %.
    """
    air = _AIR_DENSITY_STP * (profile.pressure_hpa / STP_HPA) * (STP_K / profile.temperature_k)  # kg m-3
    mixing = density_g_m3 * 1e-3 / air
    bottom_hpa = pressure_at(profile, above_km)
    inside = profile.altitude_km > above_km
    pressure = np.concatenate([[bottom_hpa], profile.pressure_hpa[inside]])
    ratio = np.concatenate([[np.interp(above_km, profile.altitude_km, mixing)], mixing[inside]])
    kg_m2 = -np.trapezoid(ratio, pressure) * 100.0 / _GRAVITY
    return float(kg_m2 * 0.1)


def gas_columns(profile: Profile, above_km: float) -> tuple[float, float]:
    """Water vapour [g cm-2] and ozone [atm cm] above an altitude."""
    water, ozone = (column_g_cm2(profile, gas, above_km) for gas in (profile.water_g_m3, profile.ozone_g_m3))
    return water, ozone / OZONE_G_CM2_PER_ATM_CM


def pressure_at(profile: Profile, altitude_km: npt.ArrayLike) -> Array:
    """Pressure at altitudes [hPa], logarithmic between levels."""
    altitude = np.asarray(altitude_km, dtype=float)
    return np.asarray(np.exp(np.interp(altitude, profile.altitude_km, np.log(profile.pressure_hpa))))


def root_between(falling: Callable[[float], float], low: float, high: float) -> float:
    """Where a falling function passes zero, to the last bit.

    Halving takes fifty calls, a hundredth of the time that SciPy's searches take to import.

    Examples
    --------
    >>> round(root_between(lambda x: 2.0 - x * x, 0.0, 2.0), 12)
    1.414213562373
    """
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if falling(middle) > 0.0 else (low, middle)
    return middle


def shipped_numbers(name: str, **columns: Any) -> Array:
    """The rows of a table that the package ships, lines with # aside."""
    text = resources.files("hyperval.atmosphere").joinpath(name).read_text("utf-8")
    return np.loadtxt(text.splitlines(), delimiter=",", **columns)


SHORTEST_KM, LONGEST_KM = 2.0, 300.0

_RANGES_KM = np.array([2.0, 5.0, 10.0, 23.0, 50.0])
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
    absurd = not SHORTEST_KM <= range_km <= LONGEST_KM
    refuse(absurd, "haze.range", range=range_km, least=SHORTEST_KM, most=LONGEST_KM)
    level, extinction = _haze()
    top = level[-1] if below_km is None else min(below_km, float(level[-1]))
    squeeze = (_COMPRESSED_BELOW_KM - ground_km) / _COMPRESSED_BELOW_KM
    level = np.where(level <= _COMPRESSED_BELOW_KM, ground_km + level * squeeze, level)
    # Linear in 1/range, beyond 50 km on the last slope.
    inverse, x = 1.0 / _RANGES_KM, 1.0 / range_km
    i = int(np.clip(np.searchsorted(-inverse, -x) - 1, 0, inverse.size - 2))
    w = (x - inverse[i + 1]) / (inverse[i] - inverse[i + 1])
    profile = np.maximum(extinction[:, i + 1] + w * (extinction[:, i] - extinction[:, i + 1]), 1e-12)
    part, low, high = np.clip((top - level[:-1]) / np.diff(level), 0.0, 1.0), profile[:-1], profile[1:]
    rate = np.log(high / low)
    with np.errstate(invalid="ignore"):
        share = np.where(np.abs(rate) < 1e-9, part, np.expm1(rate * part) / rate) * low
    for k in _TYPE_ENDS:  # the lower type falls to zero, the upper one rises from zero
        share[k] = low[k] * (part[k] - 0.5 * part[k] ** 2) + high[k] * 0.5 * part[k] ** 2
    return float(np.sum(np.diff(level) * share))


@cache
def _haze() -> tuple[Array, Array]:
    """(33,) levels above the sea [km] and (33, 5) extinction there for each range [km-1]."""
    level, *extinction = shipped_numbers("lowtran_haze.csv").T
    return level, np.stack(extinction, axis=1)


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


MAX_SOLAR_ZENITH_DEG = 85.0  # a plane-parallel solver is not valid for a lower sun
SPACE_KM = 100.0

AtmosphereModel = Literal[
    "tropical", "midlatitude-summer", "midlatitude-winter", "subarctic-summer", "subarctic-winter", "us-standard-1962"
]
_MODELS: tuple[str, ...] = get_args(AtmosphereModel)
Share = Annotated[float, Field(ge=0.0, le=1.0)]
# How the sun is stated: by angles and one date, or by place and time.
_ANGLES, _DATES = ("solar_zenith_deg", "solar_azimuth_deg"), ("day_of_year", "earth_sun_distance_au")
_PLACE = ("latitude_deg", "longitude_deg", "time_utc")


class AerosolMix(Model):
    """Shares of the four basic aerosol components by volume; they sum to 1."""

    dust: Share = Field(0.0, description="dust-like particles, volume share 0-1")
    water_soluble: Share = Field(0.0, description="water-soluble particles, volume share 0-1")
    oceanic: Share = Field(0.0, description="oceanic particles, volume share 0-1")
    soot: Share = Field(0.0, description="soot, volume share 0-1")

    refused: ClassVar = {
        "dust + water_soluble + oceanic + soot must be 1, not {:g}": lambda m: (
            abs((total := m.dust + m.water_soluble + m.oceanic + m.soot) - 1.0) > 1e-6 and [total]
        )
    }


def _number(description: str, **limits: Any) -> Any:
    """A number that may be left out."""
    return Field(None, description=description, **limits)


class AtmosphericState(Model):
    """Atmosphere, sun and sensor of one collection or scenario.

    Exactly one of ``aot550`` and ``meteorological_range_km`` is given (neither with ``aerosol: none``).
    The sun stands either as angles, with ``day_of_year`` or ``earth_sun_distance_au``, or follows
    from ``latitude_deg``, ``longitude_deg`` and ``time_utc``.
    """

    engine: Literal["sixs", "modtran", "table", "emulator"] = Field(
        "sixs",
        title="radiative-transfer engine",
        description="sixs: the embedded 6S; modtran: your own, named by HYPERVAL_MODTRAN; table: precomputed; "
        "emulator: fitted to runs of sixs, immediate, for nadir views over rural aerosol",
    )
    table: str | None = Field(
        None,
        description="with engine: table, its NetCDF file, or the run template (.json) of a folder of MODTRAN "
        "channel files",
    )
    model: AtmosphereModel = Field("midlatitude-summer", title="standard atmosphere", description="vertical profile")
    water_vapour_g_cm2: float | None = _number(
        "above the ground [g cm-2]; null: the standard atmosphere's", title="water vapour column", ge=0.01, le=10.0
    )
    ozone_atm_cm: float | None = _number(
        "above the ground [atm cm]; null: the standard atmosphere's", title="ozone column", ge=0.01, le=1.0
    )
    aerosol: Literal["none", "rural", "continental", "maritime", "urban", "desert"] | AerosolMix = Field(
        "rural", title="aerosol", description="type, or the volume shares of a mix"
    )
    aot550: float | None = _number("vertical, above the ground [1]", title="aerosol optical depth", ge=0.0, le=5.0)
    angstrom_exponent: float | None = _number(
        "optical depth goes from aot550 as wavelength to the power of minus this; null: as the type of "
        "aerosol has it, whose absorption and phase function stay (engine sixs)",
        title="Angstrom exponent", ge=-1.0, le=3.0,
    )  # fmt: skip
    aerosol_share_below: float | None = _number(
        "share of its optical depth between ground and an airborne sensor; null: by the LOWTRAN "
        "vertical profile (engine sixs)", title="aerosol below the sensor", gt=0.0, le=1.0,
    )  # fmt: skip
    meteorological_range_km: float | None = _number(
        "at the ground [km], by the LOWTRAN rule", title="meteorological range", ge=SHORTEST_KM, le=LONGEST_KM
    )
    ground_altitude_km: float = Field(0.0, title="ground altitude", ge=0.0, le=5.0, description="above sea level [km]")
    sensor_altitude_km: float = Field(
        title="sensor altitude", ge=0.0, le=100_000.0, description="above sea level [km]; 100 and more is space"
    )
    solar_zenith_deg: float | None = _number("[deg]", title="solar zenith angle", ge=0.0, lt=MAX_SOLAR_ZENITH_DEG)
    solar_azimuth_deg: float | None = _number("east of north [deg]", title="solar azimuth", ge=-360.0, le=360.0)
    day_of_year: int | None = _number("day of year, for the Earth-Sun distance", ge=1, le=366)
    earth_sun_distance_au: float | None = _number("[au]", title="Earth-Sun distance", ge=0.98, le=1.02)
    latitude_deg: float | None = _number("north positive [deg]", ge=-90.0, le=90.0)
    longitude_deg: float | None = _number("east positive [deg]", ge=-180.0, le=180.0)
    time_utc: str | None = Field(None, title="time", description="of collection, ISO 8601, UTC unless it has an offset")
    view_zenith_deg: float = Field(
        0.0, title="view zenith angle", ge=0.0, le=70.0, description="as seen from the ground [deg]; 0: nadir"
    )
    view_azimuth_deg: float = Field(
        0.0, title="view azimuth", ge=-360.0, le=360.0, description="as seen from the ground, east of north [deg]"
    )
    solar_spectrum: Literal["tsis-1", "astm-g173", "kurucz"] = Field(
        "tsis-1", description="extraterrestrial solar spectrum"
    )

    @field_validator("time_utc")
    @classmethod
    def _is_a_time(cls, value: str | None, info: ValidationInfo) -> str | None:
        """Of daylight, where the place is known: so a dark hour stands beside the other mistakes of a state."""
        north, east = (info.data.get(name) for name in _PLACE[:2])
        if value is not None:
            try:
                time = solar.parse_utc(value)
            except UsageError as error:
                raise ValueError(f"{error.what}; expected: {error.expected}") from error
            zenith = 0.0 if north is None or east is None else solar.solar_position(north, east, time)[0]
            if zenith >= MAX_SOLAR_ZENITH_DEG:
                where = "below the horizon" if zenith >= 90.0 else "too low for a plane-parallel atmosphere"
                raise ValueError(f"the sun is {where} (zenith {zenith:.2f} deg; limit {MAX_SOLAR_ZENITH_DEG:g} deg)")
        return value

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> AtmosphericState:
        has = {name for name in type(self).model_fields if getattr(self, name) is not None}
        amounts, dates = sorted(has & {"aot550", "meteorological_range_km"}), has & set(_DATES)
        by_angles = has & {*_ANGLES, *_DATES}
        lacking = [name for name in (_ANGLES if by_angles else _PLACE) if name not in has]
        needs = "both angles" if by_angles else f"{', '.join(_PLACE[:2])} and {_PLACE[2]}, or {' and '.join(_ANGLES)}"
        clear, tabled, clash = self.aerosol == "none", self.engine == "table", ", ".join(sorted(has & set(_PLACE)))
        ground, sensor, alone = self.ground_altitude_km, self.sensor_altitude_km, "only the engine sixs takes it"
        exponent, share, count = "angstrom_exponent", "aerosol_share_below", "both are" if amounts else "neither is"
        for wrong, message in (
            (tabled != ("table" in has), "engine: table needs the field table, and no other engine takes it"),
            (clear and amounts, f"aerosol: none takes no {' or '.join(amounts)}"),
            (not clear and len(amounts) != 1, f"give exactly one of aot550 and meteorological_range_km: {count} given"),
            (exponent in has and "aot550" not in has, f"{exponent} needs aot550, the depth that it starts from"),
            (exponent in has and self.engine != "sixs", f"{exponent}: {alone}"),
            (share in has and (clear or self.in_space), f"{share} is for an airborne sensor over aerosol"),
            (share in has and self.engine != "sixs", f"{share}: {alone}"),
            (by_angles and clash, f"the sun is given both by angles or date and by {clash}"),
            (lacking, f"{lacking[:1] and lacking[0]} is missing: the sun needs {needs}"),
            (by_angles and len(dates) != 1, f"give exactly one of {' and '.join(_DATES)} with the solar angles"),
            (sensor <= ground, f"sensor_altitude_km ({sensor:g}) must lie above ground_altitude_km ({ground:g})"),
        ):
            if wrong:
                raise ValueError(message)
        return self

    @property
    def sun(self) -> tuple[float, float]:
        """Solar zenith and azimuth, east of north [deg]."""
        if self.solar_zenith_deg is not None and self.solar_azimuth_deg is not None:
            return self.solar_zenith_deg, self.solar_azimuth_deg
        latitude, longitude, time = (getattr(self, name) for name in _PLACE)
        return solar.solar_position(latitude, longitude, solar.parse_utc(time))

    @property
    def profile(self) -> Profile:
        """The standard atmosphere with the columns above the ground that are stated.

        Where none is the model's own density at each altitude stays, so that high ground has less above it.
        """
        profile, stated = standard_profile(self.model), (self.water_vapour_g_cm2, self.ozone_atm_cm)
        columns = gas_columns(profile, self.ground_altitude_km)
        water, ozone = (1.0 if a is None else a / o for a, o in zip(stated, columns, strict=True))
        return replace(profile, water_g_m3=profile.water_g_m3 * water, ozone_g_m3=profile.ozone_g_m3 * ozone)

    @property
    def distance_au(self) -> float:
        """Earth-Sun distance [au]."""
        if self.earth_sun_distance_au is not None:
            return self.earth_sun_distance_au
        if self.day_of_year is not None:
            return solar.distance_on_day(self.day_of_year)
        return solar.earth_sun_distance_au(solar.parse_utc(str(self.time_utc)))

    @property
    def aerosol_optical_depth(self) -> float:
        """Vertical aerosol optical depth at 550 nm above the ground [1]."""
        if self.meteorological_range_km is None:
            return self.aot550 or 0.0  # with aerosol: none there is neither
        return aot550_from_range(self.meteorological_range_km, self.ground_altitude_km)

    @property
    def aerosol_fraction_below(self) -> float:
        """Share of that optical depth between ground and sensor, as stated or by the LOWTRAN profile [1]."""
        depth = self.aerosol_optical_depth
        if depth == 0.0 or self.in_space:
            return 1.0
        if self.aerosol_share_below is not None:
            return self.aerosol_share_below
        return fraction_below(depth, self.ground_altitude_km, self.sensor_altitude_km)

    @property
    def in_space(self) -> bool:
        """True when the sensor is above the atmosphere."""
        return self.sensor_altitude_km >= SPACE_KM


def coordinates(state: AtmosphericState) -> dict[str, float]:
    """Where a state lies on every axis that a table can have."""
    ground, (zenith, azimuth) = state.ground_altitude_km, state.sun
    water, ozone = gas_columns(state.profile, ground)
    return {
        "aot550": state.aerosol_optical_depth,
        "water_vapour_g_cm2": water,
        "ozone_atm_cm": ozone,
        "ground_altitude_km": ground,
        "sensor_altitude_km": min(state.sensor_altitude_km, SPACE_KM),
        "solar_zenith_deg": zenith,
        "view_zenith_deg": state.view_zenith_deg,
        "relative_azimuth_deg": abs((azimuth - state.view_azimuth_deg + 180.0) % 360.0 - 180.0),
    }
