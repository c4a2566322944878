"""The state of the atmosphere, sun and sensor: what an atmosphere engine is asked about."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from hyperval.atmosphere import solar, visibility
from hyperval.config import Model
from hyperval.errors import UsageError

MAX_SOLAR_ZENITH_DEG = 85.0  # a plane-parallel solver is not valid for a lower sun
SPACE_KM = 100.0

AtmosphereModel = Literal[
    "tropical",
    "midlatitude-summer",
    "midlatitude-winter",
    "subarctic-summer",
    "subarctic-winter",
    "us-standard-1962",
]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class AerosolMix(Model):
    """Shares of the four basic aerosol components by volume; they sum to 1."""

    dust: Share = Field(0.0, description="dust-like particles, volume share 0-1")
    water_soluble: Share = Field(0.0, description="water-soluble particles, volume share 0-1")
    oceanic: Share = Field(0.0, description="oceanic particles, volume share 0-1")
    soot: Share = Field(0.0, description="soot, volume share 0-1")

    @model_validator(mode="after")
    def _sums_to_one(self) -> AerosolMix:
        total = self.dust + self.water_soluble + self.oceanic + self.soot
        if abs(total - 1.0) > 1e-6:
            raise ValueError(f"dust + water_soluble + oceanic + soot must be 1, not {total:g}")
        return self


# Tuned to the radiances that MODTRAN 6 gives with its rural aerosol.
RURAL_MIX = AerosolMix(dust=0.55, water_soluble=0.447, oceanic=0.0, soot=0.003)


class AtmosphericState(Model):
    """Atmosphere, sun and sensor of one collection or scenario.

    Exactly one of ``aot550`` and ``meteorological_range_km`` is given (neither with ``aerosol: none``).
    The sun stands either as angles, with ``day_of_year`` or ``earth_sun_distance_au``, or follows
    from ``latitude_deg``, ``longitude_deg`` and ``time_utc``.
    """

    engine: Literal["sixs", "modtran", "table"] = Field(
        "sixs",
        description="sixs: the embedded solver; modtran: the user's own, named by HYPERVAL_MODTRAN; "
        "table: computed before",
    )
    table: str | None = Field(
        None,
        description="with engine: table, its NetCDF file, or the run template (.json) of a folder of MODTRAN "
        "channel files",
    )
    model: AtmosphereModel = Field("midlatitude-summer", description="standard atmosphere")
    water_vapour_g_cm2: float | None = Field(
        None, ge=0.01, le=10.0, description="water column above the ground [g cm-2], 0.01-10; null: the model's own"
    )
    ozone_atm_cm: float | None = Field(
        None, ge=0.01, le=1.0, description="ozone column above the ground [atm cm], 0.01-1; null: the model's own"
    )
    aerosol: Literal["none", "rural", "continental", "maritime", "urban", "desert"] | AerosolMix = Field(
        "rural", description="aerosol type, or the volume shares of a mix"
    )
    aot550: float | None = Field(
        None, ge=0.0, le=5.0, description="vertical aerosol optical depth at 550 nm above the ground [1], 0-5"
    )
    angstrom_exponent: float | None = Field(
        None,
        ge=-1.0,
        le=3.0,
        description="optical depth goes from aot550 as wavelength to the power of minus this; null: as the type of "
        "aerosol has it, whose absorption and phase function stay (engine sixs)",
    )
    aerosol_share_below: float | None = Field(
        None,
        gt=0.0,
        le=1.0,
        description="share of the aerosol's depth between ground and an airborne sensor, 0-1; null: by the LOWTRAN "
        "vertical profile (engine sixs)",
    )
    meteorological_range_km: float | None = Field(
        None,
        ge=visibility.SHORTEST_KM,
        le=visibility.LONGEST_KM,
        description="meteorological range at the ground [km], 2-300, by the LOWTRAN rule",
    )
    ground_altitude_km: float = Field(0.0, ge=0.0, le=5.0, description="ground above sea level [km], 0-5")
    surroundings_altitude_km: float | None = Field(
        None,
        ge=0.0,
        le=5.0,
        description="ground of the surroundings above sea level [km], which stated amounts of aerosol and gases "
        "are above, too; null: as high as the site",
    )
    sensor_altitude_km: float = Field(
        ge=0.0, le=100_000.0, description="sensor above sea level [km]; 100 and more is space"
    )
    solar_zenith_deg: float | None = Field(None, ge=0.0, description="solar zenith angle [deg], 0 to less than 85")
    solar_azimuth_deg: float | None = Field(
        None, ge=-360.0, le=360.0, description="azimuth of the sun, east of north [deg]"
    )
    day_of_year: int | None = Field(None, ge=1, le=366, description="day of year, for the Earth-Sun distance")
    earth_sun_distance_au: float | None = Field(
        None, ge=0.98, le=1.02, description="Earth-Sun distance [au], 0.98-1.02"
    )
    latitude_deg: float | None = Field(None, ge=-90.0, le=90.0, description="latitude, north positive [deg]")
    longitude_deg: float | None = Field(None, ge=-180.0, le=180.0, description="longitude, east positive [deg]")
    time_utc: str | None = Field(None, description="time of collection, ISO 8601, UTC unless it has an offset")
    view_zenith_deg: float = Field(
        0.0, ge=0.0, le=70.0, description="zenith angle of the sensor seen from the ground [deg], 0-70; 0 is nadir"
    )
    view_azimuth_deg: float = Field(
        0.0, ge=-360.0, le=360.0, description="azimuth of the sensor seen from the ground, east of north [deg]"
    )
    solar_spectrum: Literal["tsis-1", "astm-g173", "kurucz"] = Field(
        "tsis-1", description="extraterrestrial solar spectrum"
    )

    @field_validator("time_utc")
    @classmethod
    def _is_a_time(cls, value: str | None) -> str | None:
        if value is not None:
            try:
                solar.parse_utc(value)
            except UsageError as error:
                raise ValueError(f"{error.what}; expected: {error.expected}") from error
        return value

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> AtmosphericState:
        if (self.engine == "table") != (self.table is not None):
            raise ValueError("engine: table needs the field table, and no other engine takes it")
        self._check_aerosol()
        self._check_sun()
        if not self.sensor_altitude_km > self.ground_altitude_km:
            raise ValueError(
                f"sensor_altitude_km ({self.sensor_altitude_km:g}) must lie above "
                f"ground_altitude_km ({self.ground_altitude_km:g})"
            )
        around = self.surroundings_altitude_km
        if around is not None and not self.sensor_altitude_km > around:
            raise ValueError(f"surroundings_altitude_km ({around:g}) must lie below sensor_altitude_km")
        return self

    def _check_aerosol(self) -> None:
        given = [n for n in ("aot550", "meteorological_range_km") if getattr(self, n) is not None]
        if self.aerosol == "none":
            if given:
                raise ValueError(f"aerosol: none takes no {' or '.join(given)}")
        elif len(given) != 1:
            state = "both are" if given else "neither is"
            raise ValueError(f"give exactly one of aot550 and meteorological_range_km: {state} given")

        if self.angstrom_exponent is not None:
            if self.aot550 is None:
                raise ValueError("angstrom_exponent needs aot550, the depth that it starts from")
            if self.engine != "sixs":
                raise ValueError("angstrom_exponent: the engine sixs alone takes it")
        if self.aerosol_share_below is not None:
            if self.aerosol == "none" or self.in_space:
                raise ValueError("aerosol_share_below is for a sensor within the air, over aerosol")
            if self.engine != "sixs":
                raise ValueError("aerosol_share_below: the engine sixs alone takes it")

    def _check_sun(self) -> None:
        angles = ("solar_zenith_deg", "solar_azimuth_deg")
        dates = ("day_of_year", "earth_sun_distance_au")
        place = ("latitude_deg", "longitude_deg", "time_utc")
        has = {n for n in (*angles, *dates, *place) if getattr(self, n) is not None}
        if has & {*angles, *dates}:
            clash = sorted(has & set(place))
            if clash:
                raise ValueError(f"the sun is given both by angles or date and by {', '.join(clash)}")
            for name in angles:
                if name not in has:
                    raise ValueError(f"{name} is missing: the sun needs both angles")
            if len(has & set(dates)) != 1:
                raise ValueError("give exactly one of day_of_year and earth_sun_distance_au with the solar angles")
        else:
            for name in place:
                if name not in has:
                    raise ValueError(
                        f"{name} is missing: the sun needs latitude_deg, longitude_deg and time_utc, "
                        "or solar_zenith_deg and solar_azimuth_deg"
                    )
        zenith, _ = self.sun
        if zenith >= MAX_SOLAR_ZENITH_DEG:
            field = "solar_zenith_deg" if "solar_zenith_deg" in has else "time_utc"
            where = "below the horizon" if zenith >= 90.0 else "too low for a plane-parallel atmosphere"
            raise ValueError(
                f"{field}: the sun is {where} (zenith {zenith:.2f} deg; limit {MAX_SOLAR_ZENITH_DEG:g} deg)"
            )

    @property
    def sun(self) -> tuple[float, float]:
        """Solar zenith and azimuth, east of north [deg]."""
        if self.solar_zenith_deg is not None and self.solar_azimuth_deg is not None:
            return self.solar_zenith_deg, self.solar_azimuth_deg
        assert self.latitude_deg is not None  # noqa: S101
        assert self.longitude_deg is not None  # noqa: S101
        assert self.time_utc is not None  # noqa: S101
        return solar.solar_position(self.latitude_deg, self.longitude_deg, solar.parse_utc(self.time_utc))

    @property
    def distance_au(self) -> float:
        """Earth-Sun distance [au]."""
        if self.earth_sun_distance_au is not None:
            return self.earth_sun_distance_au
        if self.day_of_year is not None:
            return solar.distance_on_day(self.day_of_year)
        assert self.time_utc is not None  # noqa: S101
        return solar.earth_sun_distance_au(solar.parse_utc(self.time_utc))

    @property
    def aerosol_optical_depth(self) -> float:
        """Vertical aerosol optical depth at 550 nm above the ground [1]."""
        if self.aerosol == "none":
            return 0.0
        if self.aot550 is not None:
            return self.aot550
        assert self.meteorological_range_km is not None  # noqa: S101
        return visibility.aot550_from_range(self.meteorological_range_km, self.ground_altitude_km)

    @property
    def aerosol_fraction_below(self) -> float:
        """Share of that optical depth between ground and sensor, as stated or by the LOWTRAN profile [1]."""
        depth = self.aerosol_optical_depth
        if depth == 0.0 or self.in_space:
            return 1.0
        if self.aerosol_share_below is not None:
            return self.aerosol_share_below
        return visibility.fraction_below(depth, self.ground_altitude_km, self.sensor_altitude_km)

    @property
    def in_space(self) -> bool:
        """True when the sensor is above the atmosphere."""
        return self.sensor_altitude_km >= SPACE_KM
