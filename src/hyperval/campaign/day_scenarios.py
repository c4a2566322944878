"""The scenarios that a campaign names, among them one for each half hour of a RadCalNet day.

For these, words in braces of one scenario file take what the day's file says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import scipy
from pydantic import Discriminator, Field, Tag

from hyperval.atmosphere.profiles import pressure_at, standard_profile
from hyperval.campaign.template import with_words
from hyperval.config import Model, load_yaml, validate
from hyperval.errors import InputError, UsageError
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.spectra.radcalnet import SURFACE, RadCalNetDay, read_radcalnet

HIGHEST_KM = 9.0


class DayScenarios(Model):
    """Scenarios of the half hours of one day."""

    scenario: str = Field(description='scenario file with words in braces, such as aot550: "{aot550}"')
    radcalnet: str = Field(description="daily file that ends in .input: surface and state")
    times: list[str] = Field(default_factory=list, description="half hours, such as 04:00; empty: all with values")


def _kind(entry: Any) -> str:
    """Which of the three an entry of a campaign's list is; a mistake in it is told of that one alone."""
    if isinstance(entry, DayScenarios) or (isinstance(entry, Mapping) and {*DayScenarios.model_fields} & {*entry}):
        return "(day)"
    return "(scenario)" if isinstance(entry, Scenario | Mapping) else "(name)"


ScenarioSource = Annotated[
    Annotated[DayScenarios, Tag("(day)")] | Annotated[Scenario, Tag("(scenario)")] | Annotated[str, Tag("(name)")],
    Discriminator(_kind),
]


def scenarios_of(
    source: DayScenarios | Scenario | str, resolve: Callable[[str], Path], base: Path, words: Mapping[str, str]
) -> list[Scenario]:
    """The scenarios that one entry of a campaign stands for; ``base`` is the campaign's folder.

    Raises
    ------
    UsageError, InputError : mistakes in the scenario or in what it names.
    """
    if isinstance(source, DayScenarios):
        return day_scenarios(source, resolve(source.scenario), resolve(source.radcalnet), words)
    if isinstance(source, Scenario):
        source._folder = base
        return [source]
    if source in builtin_scenarios():
        return [load_scenario(source)]
    path = resolve(source)
    data, lines = load_yaml(path)
    scenario = validate(Scenario, with_words(data, words), lines, str(path))
    scenario._folder = path.resolve().parent
    return [scenario]


def day_scenarios(source: DayScenarios, scenario: Path, day: Path, words: Mapping[str, str]) -> list[Scenario]:
    """The scenarios of a day; a word that is a value by itself stands for a number.

    Words, besides those of the run: site, time, time_utc, latitude_deg, longitude_deg, station_km, file, the state
    (pressure_hpa, temperature_k, water_vapour_g_cm2, ozone_atm_cm, aot550, angstrom_exponent), its uncertainties
    (u_ and the same names), and ground_km: where the stated standard atmosphere has the rows pressure.

    Raises
    ------
    UsageError : mistakes of the scenario with file and line, a half hour without values.
    InputError : a day that is missing, corrupt, not of the surface, or without values.
    """
    rows = read_radcalnet(day)
    if rows.quantity != SURFACE:
        raise InputError(
            "holds reflectance of the top of the atmosphere",
            where=rows.source,
            expected="a file that ends in .input",
        )
    times = tuple(source.times) or rows.valid
    if not times:
        raise InputError("no half hour has a value", where=rows.source, mend="take a day of better weather")
    text, lines = load_yaml(scenario)
    out = []
    for time in times:
        at = _words(rows, time, source.radcalnet, str((text.get("atmosphere") or {}).get("model", "")), scenario)
        made = validate(Scenario, _with_numbers(with_words(text, dict(words)), at), lines, str(scenario))
        made._folder = scenario.resolve().parent
        out.append(made)
    return out


def _words(day: RadCalNetDay, time: str, file: str, model: str, where: Path) -> dict[str, Any]:
    i = day.column(time)
    state = day.at(time)
    try:
        profile = standard_profile(model)
    except UsageError as error:
        raise UsageError(error.what, where=f"{where}: atmosphere.model", expected=error.expected) from None
    pressure = state["pressure_hpa"]
    if not pressure_at(profile, HIGHEST_KM) < pressure <= pressure_at(profile, 0.0):
        raise InputError(f"a pressure of {pressure:g} hPa", where=day.source, expected="that of a place on land")
    ground = float(scipy.optimize.brentq(lambda z: pressure_at(profile, z) - pressure, 0.0, HIGHEST_KM, xtol=1e-6))
    return {
        **state, "site": day.site, "time": time, "time_utc": f"{day.times[i]:%Y-%m-%dT%H:%M:%SZ}", "file": file,
        "latitude_deg": day.latitude_deg, "longitude_deg": day.longitude_deg, "ground_km": round(ground, 4),
        "station_km": day.altitude_m / 1e3,
    }  # fmt: skip


def _with_numbers(content: Any, words: Mapping[str, Any]) -> Any:
    if isinstance(content, dict):
        return {key: _with_numbers(value, words) for key, value in content.items()}
    if isinstance(content, list):
        return [_with_numbers(value, words) for value in content]
    if isinstance(content, str):
        if content[:1] == "{" and content[1:-1] in words:
            return words[content[1:-1]]
        return with_words(content, {name: str(value) for name, value in words.items()})
    return content
