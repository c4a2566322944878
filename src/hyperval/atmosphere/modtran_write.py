"""MODTRAN's input for a state: ``tape5`` of versions 4 and 5, JSON of version 6, for the runs that the model needs.

Columns follow the lists of cards in the user's manuals (MODTRAN4 v3r1, MODTRAN 5.2.2); column 51 of card 1A belongs
to SOLCON there, and real decks have a flag in it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

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

ALBEDO_FILE = "albedos.dat"


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


def tape5(state: AtmosphericState, runs: Sequence[Run], version: int = 5) -> str:
    """The deck: one case for each run, radiance with the sun, from the ground to the sensor.

    A run with a background names its curves in :func:`albedo_curves`, to be written beside the deck as
    ``albedos.dat``.

    Parameters
    ----------
    state : atmosphere, sun and sensor
    runs : ground of each case
    version : 4 or 5, which differ in cards 1, 1A and 4.  Version 4 takes the aerosol as meteorological range (the
        LOWTRAN rule), version 5 as optical depth at 550 nm

    Raises
    ------
    UsageError : no run, an unknown version, or a state that MODTRAN cannot be told.
    """
    if not runs:
        raise UsageError("no runs")
    if version not in (4, 5):
        raise UsageError(f"no cards of MODTRAN {version}", expected="version 4 or 5")
    case = modtran_case(state)
    lines: list[str] = []
    curve = 0
    for number, run in enumerate(runs):
        lines += _cards(case, run, version, curve)
        curve += 2 if run.background is not None else 0
        lines.append(f"{1 if number + 1 < len(runs) else 0:5d}")  # card 5: another case follows
    return "\n".join(lines) + "\n"


def albedo_curves(runs: Sequence[Run]) -> str:
    """The spectral albedo file for the runs with a background: for each, the target's curve and the scene's.

    The layout is that of MODTRAN's own ``spec_alb.dat``: a number and a name, then wavelength [um] and albedo.
    Empty when every run is over uniform ground.
    """
    lines: list[str] = []
    for pair, run in enumerate(r for r in runs if r.background is not None):
        target: Curve = ((0.2, run.albedo), (15.0, run.albedo))
        for number, name, curve in ((1, "target", target), (2, "average scene", run.curve)):
            lines.append(f"{2 * pair + number:4d}   {name} {pair + 1}")
            lines += [f"{um:10.4f} {albedo:8.5f}" for um, albedo in curve]
    return "\n".join(lines) + "\n" if lines else ""


def _cards(case: ModtranCase, run: Run, version: int, curves_before: int) -> list[str]:
    five, zero, none = version == 5, "     0.000", "    0"
    surface = f"{run.albedo:7.4f}" if run.background is None else "LAMBER"
    amount = (-case.aot550 if case.haze[0] else 0.0) if five else case.range_km
    gases = f"{CO2_PPM:10.3f}{_amount('g', case.water_g_cm2)}{_amount('a', case.ozone_atm_cm)}"
    end_1a = " F F F F F  0.000000" + 4 * zero + "         0" if five else " F F F F       0.000"
    cards = [
        # 1: MODTRN SPEED (BINARY LYMOLC) MODEL ITYPE IEMSCT IMULT M1-M6 MDEF I_RD2C NOPRNT TPTEMP SURREF
        f"CM{'F ' if five else '  '}{case.model[0]}    2    2   -1{8 * none}    1   0.000{surface}",
        # 1A: DIS DISAZM (DISALB) NSTR (SFWHM, or LSUN ISUN) CO2MX H2OSTR O3STR, flags, SOLCON and what follows it
        f"TT{'F' if five else ''}{STREAMS:3d}{'  0.' if five else 'F   0'}{gases}{end_1a}",
        # 2: IHAZE ISEASN IVULCN ICSTL ICLD IVSA VIS WSS WHH RAINRT GNDALT
        f"{case.haze[0]:5d}{5 * none}{amount:10.4f}{3 * zero}{case.ground_km:10.4f}",
        # 3: H1 H2 ANGLE RANGE BETA RO LENN PHI (CKRANG)
        f"{case.sensor_km:10.3f}{case.ground_km:10.3f}{case.observer_zenith_deg:10.3f}{3 * zero}{none}     {zero}"
        + (zero if five else ""),
        # 3A1: IPARM IPH IDAY ISOURC; 3A2: PARM1-PARM4 TIME PSIPO ANGLEM G
        f"   12    2{case.day_of_year:5d}{none}",
        f"{case.relative_azimuth_deg:10.4f}{case.solar_zenith_deg:10.4f}{2 * zero}    0.0000{3 * zero}",
        # 4: V1 V2 DV FWHM YFLAG XFLAG DLIMIT FLAGS (MLFLX VRFRAC)
        f"{FIRST_CM:10.3f}{LAST_CM:10.3f}{STEP_CM:10.3f}{STEP_CM:10.3f}RW" + (f"{'0':>18}{zero}" if five else ""),
    ]
    if run.background is not None:  # 4A: NSURF AATEMP; the file of the curves, and their numbers in it
        cards += ["2    0.000", ALBEDO_FILE, str(curves_before + 1), str(curves_before + 2)]
    return cards


def _amount(unit: str, value: float | None) -> str:
    """Ten columns: the unit's letter and the amount; blank keeps the model's own."""
    return " " * 10 if value is None else f"  {unit}{value:7.5f}"


def modtran6_json(state: AtmosphericState, runs: Sequence[Run], name: str = "hyperval") -> str:
    """The input of MODTRAN 6: one case for each run, all under one name, so that they share one output file.

    Raises
    ------
    UsageError : no run, or a state that MODTRAN cannot be told.
    """
    if not runs:
        raise UsageError("no runs")
    cases = [{"MODTRANINPUT": _json_case(state, run, number, name)} for number, run in enumerate(runs)]
    return json.dumps({"MODTRAN": cases}, indent=2) + "\n"


def _json_case(state: AtmosphericState, run: Run, number: int, name: str) -> dict[str, Any]:
    case = modtran_case(state)
    atmosphere: dict[str, Any] = {"MODEL": case.model[1], "CO2MX": CO2_PPM}
    if case.water_g_cm2 is not None:
        atmosphere |= {"H2OSTR": case.water_g_cm2, "H2OUNIT": "g"}
    if case.ozone_atm_cm is not None:
        atmosphere |= {"O3STR": case.ozone_atm_cm, "O3UNIT": "a"}
    aerosols: dict[str, Any] = {"IHAZE": case.haze[1]}
    if case.haze[0]:
        aerosols["VIS"] = -case.aot550  # negative: optical depth at 550 nm
    surface: dict[str, Any] = {"GNDALT": case.ground_km}
    if run.background is None:
        surface |= {"SURFTYPE": "REFL_CONSTANT", "NSURF": 1, "SURREF": run.albedo}
    else:
        surface |= {
            "SURFTYPE": "REFL_LAMBER_MODEL",
            "NSURF": 2,
            "SURFP": _curve([(0.2, run.albedo), (15.0, run.albedo)]),
            "SURFA": _curve(run.curve),
        }
    return {
        "NAME": name,
        "DESCRIPTION": "",
        "CASE": number,
        "RTOPTIONS": {
            "MODTRN": "RT_CORRK_FAST", "LYMOLC": False, "T_BEST": False, "IEMSCT": "RT_SOLAR_AND_THERMAL",
            "IMULT": "RT_DISORT", "DISALB": False, "NSTR": STREAMS, "SOLCON": 0.0,
        },
        "ATMOSPHERE": atmosphere,
        "AEROSOLS": aerosols,
        "GEOMETRY": {
            "ITYPE": 3, "H1ALT": case.sensor_km, "OBSZEN": case.observer_zenith_deg, "IDAY": case.day_of_year,
            "IPARM": 12, "PARM1": case.relative_azimuth_deg, "PARM2": case.solar_zenith_deg,
        },
        "SURFACE": surface,
        "SPECTRAL": {
            "V1": FIRST_CM, "V2": LAST_CM, "DV": STEP_CM,
            "FWHM": STEP_CM, "YFLAG": "R", "XFLAG": "W", "FLAGS": "W      ", "BMNAME": "05_2013",
        },
        "FILEOPTIONS": {"NOPRNT": 1, "CKPRNT": True},
    }  # fmt: skip


def _curve(pairs: Sequence[tuple[float, float]]) -> dict[str, Any]:
    return {
        "CSALB": "LAMB_MODEL_USER_DEF",
        "NWVSRF": len(pairs),
        "WVSURF": [um for um, _ in pairs],
        "UDSALB": [albedo for _, albedo in pairs],
    }
