"""What a run template of MODTRAN 6 (JSON input) states of the atmosphere, the sun and the ground."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from hyperval.atmosphere import solar
from hyperval.atmosphere.modtran_read import text_lines
from hyperval.atmosphere.modtran_write import HAZES, MODELS
from hyperval.errors import InputError, reader

_WHAT = "MODTRAN 6 JSON input"
_MAX_BYTES = 16 << 20
_MODELS = {name: state for state, (_, name) in MODELS.items()}
_HAZES = {name: state for state, (_, name) in HAZES.items()}
_COMMON_YEAR = 2018  # the input has a day of the year and no year


@reader
def read_modtran_json(path: Path) -> list[dict[str, Any]]:
    """The MODTRANINPUT of every case of a MODTRAN 6 JSON input file.

    Raises
    ------
    InputError : missing, too large, not JSON, or not MODTRAN input.
    """
    try:
        document = json.loads("\n".join(text_lines(path, _WHAT, _MAX_BYTES)))
    except json.JSONDecodeError as error:
        raise InputError(f"not JSON: {error.msg}", where=f"{path}:{error.lineno}") from error
    except RecursionError as error:
        raise InputError("not JSON: nested too deeply", where=str(path)) from error
    cases = document.get("MODTRAN") if isinstance(document, dict) else None
    if not isinstance(cases, list) or not cases:
        raise InputError("no list MODTRAN", where=str(path), expected=_WHAT)
    for number, case in enumerate(cases):
        if not isinstance(case, dict) or not isinstance(case.get("MODTRANINPUT"), dict):
            raise InputError("no MODTRANINPUT", where=f"{path}, case {number}", expected=_WHAT)
    return [case["MODTRANINPUT"] for case in cases]


def stated_fields(inputs: dict[str, Any], where: str) -> dict[str, Any]:
    """Fields of :class:`AtmosphericState` that one case of MODTRAN 6 input states, and no others.

    A meteorological range stands as such, a negative one as ``aot550``; the sun by place and time is turned into
    angles (the year does not matter to 0.1 degree).

    Raises
    ------
    InputError : a value of the wrong kind.
    """
    try:
        sections = [inputs.get(name, {}) for name in ("ATMOSPHERE", "AEROSOLS", "GEOMETRY", "SURFACE")]
        atmosphere, aerosols, geometry, surface = sections
        fields: dict[str, Any] = _air(atmosphere) | _haze(aerosols) | _sun(geometry)
        if "GNDALT" in surface:
            fields["ground_altitude_km"] = float(surface["GNDALT"])
        if "H1ALT" in geometry:
            fields["sensor_altitude_km"] = float(geometry["H1ALT"])
        if geometry.get("OBSZEN", 180.0) in (0, 180.0):
            fields["view_zenith_deg"] = 0.0
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"a value of the wrong kind: {error}", where=where, expected=_WHAT) from error
    return fields


def stated_albedo(inputs: dict[str, Any]) -> float | None:
    """Ground reflectance of a case over uniform ground; None where it does not state one."""
    surface = inputs.get("SURFACE", {})
    if surface.get("SURFTYPE") == "REFL_CONSTANT" and isinstance(surface.get("SURREF"), int | float):
        return float(surface["SURREF"])
    name = str(surface.get("SURFP", {}).get("CSALB", ""))
    if surface.get("NSURF", 1) == 1 and name.startswith("LAMB_CONST_") and name.endswith("_PCT"):
        return int(name.removeprefix("LAMB_CONST_").removesuffix("_PCT")) / 100.0
    return None


def _air(section: dict[str, Any]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    if section.get("MODEL") in _MODELS:
        fields["model"] = _MODELS[section["MODEL"]]
    if str(section.get("H2OUNIT", "")).lower() == "g":
        fields["water_vapour_g_cm2"] = float(section["H2OSTR"])
    if str(section.get("O3UNIT", "")).lower() == "a":
        fields["ozone_atm_cm"] = float(section["O3STR"])
    return fields


def _haze(section: dict[str, Any]) -> dict[str, Any]:
    fields: dict[str, Any] = {}
    if section.get("IHAZE") in _HAZES:
        fields["aerosol"] = _HAZES[section["IHAZE"]]
    amount = float(section.get("VIS", 0.0))
    if amount != 0.0 and fields.get("aerosol") != "none":
        fields |= {"aot550": -amount} if amount < 0.0 else {"meteorological_range_km": amount}
    return fields


def _sun(geometry: dict[str, Any]) -> dict[str, Any]:
    day = int(geometry["IDAY"]) if geometry.get("IDAY") else None
    fields: dict[str, Any] = {} if day is None else {"day_of_year": day}
    if geometry.get("IPARM") in (2, 12):
        fields["solar_zenith_deg"] = float(geometry["PARM2"])
    elif geometry.get("IPARM") in (1, 11) and day is not None and "GMTIME" in geometry:
        when = datetime(_COMMON_YEAR, 1, 1, tzinfo=UTC) + timedelta(days=day - 1, hours=float(geometry["GMTIME"]))
        longitude = (-float(geometry["PARM2"]) + 180.0) % 360.0 - 180.0  # MODTRAN counts west
        zenith, azimuth = solar.solar_position(float(geometry["PARM1"]), longitude, when)
        fields |= {"solar_zenith_deg": zenith, "solar_azimuth_deg": azimuth}
    return fields
