"""tape5: the input deck of MODTRAN 4 and 5 for a state and a list of runs."""

from __future__ import annotations

from collections.abc import Sequence

from hyperval.atmosphere import modtran_case as case_module
from hyperval.atmosphere.modtran_cards import Value, format_card
from hyperval.atmosphere.modtran_case import Curve, ModtranCase, Run, modtran_case
from hyperval.atmosphere.state import AtmosphericState
from hyperval.errors import UsageError

ALBEDO_FILE = "albedos.dat"
_NO_RANGE = 0.0


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
    case = modtran_case(state)
    lines: list[str] = []
    curve = 0
    for number, run in enumerate(runs):
        lines += _cards(case, run, version, curve)
        curve += 2 if run.background is not None else 0
        lines.append(format_card(version, "5", {"IRPT": 1 if number + 1 < len(runs) else 0}))
    return "\n".join(lines) + "\n"


def albedo_curves(runs: Sequence[Run]) -> str:
    """The spectral albedo file for the runs with a background: for each, the target's curve and the scene's.

    The layout is that of MODTRAN's own ``spec_alb.dat``: a number and a name, then wavelength [um] and albedo.
    Empty when every run is over uniform ground.
    """
    lines: list[str] = []
    number = 0
    for run in runs:
        if run.background is None:
            continue
        target: Curve = ((0.2, run.albedo), (15.0, run.albedo))
        for name, curve in (("target", target), ("average scene", run.curve)):
            number += 1
            lines.append(f"{number:4d}   {name} {(number + 1) // 2}")
            lines += [f"{um:10.4f} {albedo:8.5f}" for um, albedo in curve]
    return "\n".join(lines) + "\n" if lines else ""


def _cards(case: ModtranCase, run: Run, version: int, curves_before: int) -> list[str]:
    model = case.model[0]
    uniform = run.background is None
    first: dict[str, Value] = {
        "MODTRN": "C", "SPEED": "M", "MODEL": model, "ITYPE": 2, "IEMSCT": 2, "IMULT": -1, "M1": 0, "M2": 0,
        "M3": 0, "M4": 0, "M5": 0, "M6": 0, "MDEF": 0, "I_RD2C": 0, "NOPRNT": 1, "TPTEMP": 0.0,
        "SURREF": f"{run.albedo:7.4f}" if uniform else "LAMBER",
    }  # fmt: skip
    second: dict[str, Value] = {
        "DIS": True, "DISAZM": True, "NSTR": case_module.STREAMS, "CO2MX": case_module.CO2_PPM,
        "H2OSTR": _amount("g", case.water_g_cm2), "O3STR": _amount("a", case.ozone_atm_cm),
        "LSUNFL": False, "LBMNAM": False, "LFLTNM": False, "H2OAER": False,
    }  # fmt: skip
    spectral: dict[str, Value] = {
        "V1": case_module.FIRST_CM, "V2": case_module.LAST_CM, "DV": case_module.STEP_CM,
        "FWHM": case_module.STEP_CM, "YFLAG": "R", "XFLAG": "W",
    }  # fmt: skip
    if version == 5:
        first["BINARY"] = False
        second |= {"DISALB": False, "CDTDIR": False}
        spectral |= {"MLFLX": 0, "VRFRAC": 0.0}
        aerosol = -case.aot550 if case.haze[0] else _NO_RANGE
    else:
        aerosol = case.range_km
    cards = [
        format_card(version, "1", first),
        format_card(version, "1A", second),
        format_card(
            version,
            "2",
            {
                "IHAZE": case.haze[0], "ISEASN": 0, "IVULCN": 0, "ICSTL": 0, "ICLD": 0, "IVSA": 0, "VIS": aerosol,
                "WSS": 0.0, "WHH": 0.0, "RAINRT": 0.0, "GNDALT": case.ground_km,
            },
        ),
        format_card(
            version,
            "3",
            {
                "H1": case.sensor_km, "H2": case.ground_km, "ANGLE": case.observer_zenith_deg, "RANGE": 0.0,
                "BETA": 0.0, "RO": 0.0, "LENN": 0, "PHI": 0.0,
            },
        ),
        format_card(version, "3A1", {"IPARM": 12, "IPH": 2, "IDAY": case.day_of_year, "ISOURC": 0}),
        format_card(
            version,
            "3A2",
            {
                "PARM1": case.relative_azimuth_deg, "PARM2": case.solar_zenith_deg, "PARM3": 0.0, "PARM4": 0.0,
                "TIME": 0.0, "PSIPO": 0.0, "ANGLEM": 0.0, "G": 0.0,
            },
        ),
        format_card(version, "4", spectral),
    ]  # fmt: skip
    if not uniform:
        cards += [
            format_card(version, "4A", {"NSURF": 2, "AATEMP": 0.0}),
            format_card(version, "4L1", {"SALBFL": ALBEDO_FILE}),
            format_card(version, "4L2", {"CSALB": str(curves_before + 1)}),
            format_card(version, "4L2", {"CSALB": str(curves_before + 2)}),
        ]
    return cards


def _amount(unit: str, value: float | None) -> str:
    """Ten columns: the unit's letter and the amount; blank keeps the model's own."""
    return " " * 10 if value is None else f"  {unit}{value:7.5f}"
