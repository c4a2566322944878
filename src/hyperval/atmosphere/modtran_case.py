"""A state in MODTRAN's terms, and the runs that the model needs of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hyperval.atmosphere import solar, visibility
from hyperval.atmosphere.state import AerosolMix, AtmosphericState
from hyperval.errors import UsageError

# Spectral range and step of the runs: wider than 340-2600 nm; 5 cm-1 is 0.08 nm at 400 nm and 3 nm at 2.5 um.
FIRST_CM, LAST_CM, STEP_CM = 3800.0, 29500.0, 5.0
CO2_PPM = 400.0
STREAMS = 8
UNIFORM_ALBEDOS = (0.0, 0.1, 0.5, 1.0)
SOLVING_ALBEDOS = (0.0, 0.1, 0.5)  # enough for A, B, S and L_a
_EARTH_RADIUS_KM = 6371.23

MODELS = {
    "tropical": (1, "ATM_TROPICAL"),
    "midlatitude-summer": (2, "ATM_MIDLAT_SUMMER"),
    "midlatitude-winter": (3, "ATM_MIDLAT_WINTER"),
    "subarctic-summer": (4, "ATM_SUBARC_SUMMER"),
    "subarctic-winter": (5, "ATM_SUBARC_WINTER"),
    "us-standard-1962": (6, "ATM_US_STANDARD_1976"),  # MODTRAN has the one of 1976
}
HAZES = {
    "none": (0, "AER_NONE"),
    "rural": (1, "AER_RURAL"),
    "maritime": (4, "AER_MARITIME"),
    "urban": (5, "AER_URBAN"),
    "desert": (10, "AER_DESERT"),
}

Curve = tuple[tuple[float, float], ...]  # (wavelength [um], reflectance)


@dataclass(frozen=True)
class Run:
    """One run: the ground that is looked at, and what surrounds it.

    Attributes
    ----------
    albedo : reflectance of the viewed ground, 0-1
    background : reflectance of the surroundings, a number or (wavelength [um], reflectance) pairs; None: uniform
        ground.  With a background MODTRAN keeps two surfaces (NSURF = 2): the light scattered into the view comes
        from the average scene though the target is black.  Over uniform black ground that part would be lost.
    """

    albedo: float
    background: float | Curve | None = None

    def __post_init__(self) -> None:
        levels = [self.albedo, *(r for _, r in self.curve)]
        if not all(0.0 <= r <= 1.0 for r in levels):
            raise UsageError(f"ground reflectance {levels}", expected="0 to 1")
        um = [w for w, _ in self.curve]
        if any(b <= a for a, b in pairwise(um)):
            raise UsageError("the background's wavelengths do not increase", expected="increasing wavelengths [um]")

    @property
    def curve(self) -> Curve:
        """The background as pairs; empty for uniform ground."""
        if self.background is None:
            return ()
        if isinstance(self.background, int | float):
            return ((0.2, float(self.background)), (15.0, float(self.background)))
        return self.background


def uniform_runs(albedos: Sequence[float] = UNIFORM_ALBEDOS) -> list[Run]:
    """Runs over uniform ground, from which A, B, S and L_a are solved."""
    return [Run(float(a)) for a in albedos]


def model_runs(background: float | Curve) -> list[Run]:
    """Every run the model needs: uniform ground of 0, 0.1, 0.5 and 1, and black ground in the average scene."""
    return [*uniform_runs(), Run(0.0, background)]


@dataclass(frozen=True)
class ModtranCase:
    """A state as MODTRAN is told of it.

    Attributes
    ----------
    model, haze : numbers of the cards, and names of the JSON input
    water_g_cm2, ozone_atm_cm : columns above the ground; None: the model's own
    aot550, range_km : aerosol amount in both forms; 0 without aerosol
    ground_km, sensor_km : above sea level
    observer_zenith_deg : of the line of sight at the sensor; 180 is nadir
    solar_zenith_deg, relative_azimuth_deg : at the ground; azimuth of the sun less the sensor's, east of north
    day_of_year : gives the Earth-Sun distance
    """

    model: tuple[int, str]
    haze: tuple[int, str]
    water_g_cm2: float | None
    ozone_atm_cm: float | None
    aot550: float
    range_km: float
    ground_km: float
    sensor_km: float
    observer_zenith_deg: float
    solar_zenith_deg: float
    relative_azimuth_deg: float
    day_of_year: int


def modtran_case(state: AtmosphericState) -> ModtranCase:
    """The state in MODTRAN's terms.

    Raises
    ------
    UsageError : an aerosol that MODTRAN does not have.
    """
    if isinstance(state.aerosol, AerosolMix) or state.aerosol not in HAZES:
        name = "a mix" if isinstance(state.aerosol, AerosolMix) else state.aerosol
        raise UsageError(f"aerosol: MODTRAN has no {name}", expected="one of " + ", ".join(HAZES))
    zenith, azimuth = state.sun
    depth = state.aerosol_optical_depth
    # Straight line over a round Earth, without refraction.
    sine = np.sin(np.deg2rad(state.view_zenith_deg)) * (
        (_EARTH_RADIUS_KM + state.ground_altitude_km) / (_EARTH_RADIUS_KM + state.sensor_altitude_km)
    )
    return ModtranCase(
        model=MODELS[state.model],
        haze=HAZES[state.aerosol if depth > 0.0 else "none"],  # a range of 0 would be MODTRAN's default
        water_g_cm2=state.water_vapour_g_cm2,
        ozone_atm_cm=state.ozone_atm_cm,
        aot550=depth,
        range_km=visibility.range_from_aot550(depth, state.ground_altitude_km) if depth > 0.0 else 0.0,
        ground_km=state.ground_altitude_km,
        sensor_km=state.sensor_altitude_km,
        observer_zenith_deg=180.0 - float(np.rad2deg(np.arcsin(sine))),
        solar_zenith_deg=zenith,
        relative_azimuth_deg=(azimuth - state.view_azimuth_deg) % 360.0,
        day_of_year=_day(state),
    )


def _day(state: AtmosphericState) -> int:
    """Day of the year; for a stated distance the day of the first half-year that has it."""
    if state.day_of_year is not None:
        return state.day_of_year
    if state.time_utc is not None:
        return solar.parse_utc(state.time_utc).timetuple().tm_yday
    distance = state.distance_au
    return min(range(4, 186), key=lambda day: abs(solar.distance_on_day(day) - distance))
