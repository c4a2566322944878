"""The JSON input of MODTRAN 6: written for the model's runs, and read back into the fields of a state."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from hyperval.atmosphere import modtran_case as case_module
from hyperval.atmosphere import solar
from hyperval.atmosphere.modtran_case import HAZES, MODELS, Run, modtran_case
from hyperval.atmosphere.state import AtmosphericState
from hyperval.errors import InputError, UsageError

_MAX_BYTES = 16 << 20
_COMMON_YEAR = 2018  # a common year: the input has a day of the year and no year


def modtran6_json(state: AtmosphericState, runs: Sequence[Run], name: str = "hyperval") -> str:
    """The input of MODTRAN 6: one case for each run, all under one name, so that they share one output file.

    Raises
    ------
    UsageError : no run, or a state that MODTRAN cannot be told.
    """
    if not runs:
        raise UsageError("no runs")
    cases = [{"MODTRANINPUT": _case(state, run, number, name)} for number, run in enumerate(runs)]
    return json.dumps({"MODTRAN": cases}, indent=2) + "\n"


def _case(state: AtmosphericState, run: Run, number: int, name: str) -> dict[str, Any]:
    case = modtran_case(state)
    atmosphere: dict[str, Any] = {"MODEL": case.model[1], "CO2MX": case_module.CO2_PPM}
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
            "IMULT": "RT_DISORT", "DISALB": False, "NSTR": case_module.STREAMS, "SOLCON": 0.0,
        },
        "ATMOSPHERE": atmosphere,
        "AEROSOLS": aerosols,
        "GEOMETRY": {
            "ITYPE": 3, "H1ALT": case.sensor_km, "OBSZEN": case.observer_zenith_deg, "IDAY": case.day_of_year,
            "IPARM": 12, "PARM1": case.relative_azimuth_deg, "PARM2": case.solar_zenith_deg,
        },
        "SURFACE": surface,
        "SPECTRAL": {
            "V1": case_module.FIRST_CM, "V2": case_module.LAST_CM, "DV": case_module.STEP_CM,
            "FWHM": case_module.STEP_CM, "YFLAG": "R", "XFLAG": "W", "FLAGS": "W      ", "BMNAME": "05_2013",
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


def read_modtran_json(path: Path) -> list[dict[str, Any]]:
    """The MODTRANINPUT of every case of a MODTRAN 6 JSON input file.

    Raises
    ------
    InputError : missing, too large, not JSON, or not MODTRAN input.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"larger than {_MAX_BYTES} bytes", where=str(path))
        document = json.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        raise InputError("no such file", where=str(path)) from error
    except json.JSONDecodeError as error:
        raise InputError(f"not JSON: {error.msg}", where=f"{path}:{error.lineno}") from error
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"cannot read: {error}", where=str(path)) from error
    cases = document.get("MODTRAN") if isinstance(document, dict) else None
    if not isinstance(cases, list) or not cases:
        raise InputError("no list MODTRAN", where=str(path), expected="MODTRAN 6 JSON input")
    found = []
    for number, case in enumerate(cases):
        inputs = case.get("MODTRANINPUT") if isinstance(case, dict) else None
        if not isinstance(inputs, dict):
            raise InputError("no MODTRANINPUT", where=f"{path}, case {number}", expected="MODTRAN 6 JSON input")
        found.append(inputs)
    return found


def stated_fields(inputs: dict[str, Any], where: str) -> dict[str, Any]:
    """Fields of :class:`AtmosphericState` that one case of MODTRAN 6 input states, and no others.

    A meteorological range stands as such, a negative one as ``aot550``; the sun by place and time is turned into
    angles (the year does not matter to 0.1 degree).

    Raises
    ------
    InputError : a value of the wrong kind.
    """
    found: dict[str, Any] = {}
    try:
        _atmosphere(inputs.get("ATMOSPHERE", {}), found)
        _aerosol(inputs.get("AEROSOLS", {}), found)
        geometry, surface = inputs.get("GEOMETRY", {}), inputs.get("SURFACE", {})
        if "GNDALT" in surface:
            found["ground_altitude_km"] = float(surface["GNDALT"])
        if "H1ALT" in geometry:
            found["sensor_altitude_km"] = float(geometry["H1ALT"])
        if geometry.get("OBSZEN", 180.0) in (0, 180.0):
            found["view_zenith_deg"] = 0.0
        _sun(geometry, found)
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"a value of the wrong kind: {error}", where=where, expected="MODTRAN 6 JSON input"
        ) from error
    return found


def stated_albedo(inputs: dict[str, Any]) -> float | None:
    """Ground reflectance of a case over uniform ground; None where it does not state one."""
    surface = inputs.get("SURFACE", {})
    if surface.get("SURFTYPE") == "REFL_CONSTANT" and isinstance(surface.get("SURREF"), int | float):
        return float(surface["SURREF"])
    name = str(surface.get("SURFP", {}).get("CSALB", ""))
    if surface.get("NSURF", 1) == 1 and name.startswith("LAMB_CONST_") and name.endswith("_PCT"):
        return int(name.removeprefix("LAMB_CONST_").removesuffix("_PCT")) / 100.0
    return None


def _atmosphere(section: dict[str, Any], found: dict[str, Any]) -> None:
    models = {name: state for state, (_, name) in MODELS.items()}
    if section.get("MODEL") in models:
        found["model"] = models[section["MODEL"]]
    if str(section.get("H2OUNIT", "")).lower() == "g":
        found["water_vapour_g_cm2"] = float(section["H2OSTR"])
    if str(section.get("O3UNIT", "")).lower() == "a":
        found["ozone_atm_cm"] = float(section["O3STR"])


def _aerosol(section: dict[str, Any], found: dict[str, Any]) -> None:
    hazes = {name: state for state, (_, name) in HAZES.items()}
    if section.get("IHAZE") in hazes:
        found["aerosol"] = hazes[section["IHAZE"]]
    if "VIS" in section and found.get("aerosol") != "none":
        amount = float(section["VIS"])
        if amount < 0.0:
            found["aot550"] = -amount
        elif amount > 0.0:
            found["meteorological_range_km"] = amount


def _sun(geometry: dict[str, Any], found: dict[str, Any]) -> None:
    day = int(geometry["IDAY"]) if geometry.get("IDAY") else None
    if day is not None:
        found["day_of_year"] = day
    parameters = geometry.get("IPARM")
    if parameters in (2, 12):
        found["solar_zenith_deg"] = float(geometry["PARM2"])
    elif parameters in (1, 11) and day is not None and "GMTIME" in geometry:
        when = datetime(_COMMON_YEAR, 1, 1, tzinfo=UTC) + timedelta(days=day - 1, hours=float(geometry["GMTIME"]))
        longitude = (-float(geometry["PARM2"]) + 180.0) % 360.0 - 180.0  # MODTRAN counts west
        zenith, azimuth = solar.solar_position(float(geometry["PARM1"]), longitude, when)
        found["solar_zenith_deg"], found["solar_azimuth_deg"] = zenith, azimuth
