"""What a campaign file says: the collection, the model of it, and what is to be compared.

Campaigns of several runs, such as flight lines: one text, in which words in braces differ from run to run.

The scenarios that a campaign names, among them one for each half hour of a RadCalNet day.

For these, words in braces of one scenario file take what the day's file says.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import scipy
from pydantic import Discriminator, Field, Tag, model_validator

from hyperval.atmosphere.state import pressure_at, standard_profile
from hyperval.attribute.schema import AttributionOptions
from hyperval.collection import Classification, CollectionSection, Detection
from hyperval.compare.judge import Gate
from hyperval.config import Location, Model, load_yaml, validate
from hyperval.errors import UsageError, refuse
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.spectra.networks import SURFACE, RadCalNetDay, read_radcalnet

MAX_RUNS = 100


def campaign_runs(data: Any, lines: dict[Location, int], name: str) -> list[tuple[dict[str, str], Any]]:
    """The words and the content of every run of a campaign file; one without words where it lists none.

    ``runs`` is a list of mappings from a word to a text; ``{word}`` stands for the text wherever it occurs in the
    file and in its scenario files.

    Raises
    ------
    UsageError : runs that are no such list, or whose words differ or are not used.
    """
    if not isinstance(data, dict) or "runs" not in data:
        return [({}, data)]
    runs = data["runs"]
    rest = {key: value for key, value in data.items() if key != "runs"}
    where = f"{name}:{lines.get(('runs',), 1)}"
    good = isinstance(runs, list) and 0 < len(runs) <= MAX_RUNS
    refuse(not good or not all(isinstance(run, dict) and run for run in runs), "campaign.runs", where)
    for i, run in enumerate(runs):
        wrong = [key for key, text in run.items() if not re.fullmatch(r"\w+", key) or not isinstance(text, str)]
        has = ", ".join(wrong) or ("other words than the first" if run.keys() != runs[0].keys() else "")
        refuse(has, "campaign.words", f"{name}:{lines.get(('runs', i), 1)}", has=has)
    return [(dict(run), with_words(rest, run)) for run in runs]


def with_words(content: Any, words: Mapping[str, Any]) -> Any:
    """The content with ``{word}`` replaced in every text; other braces stay as they are.

    A word that is a text by itself may stand for a number.
    """
    if isinstance(content, dict):
        return {key: with_words(value, words) for key, value in content.items()}
    if isinstance(content, list):
        return [with_words(value, words) for value in content]
    if isinstance(content, str):
        if content[:1] == "{" and content[1:-1] in words:
            return words[content[1:-1]]
        for word, text in words.items():
            content = content.replace(f"{{{word}}}", str(text))
    return content


HIGHEST_KM = 9.0


class DayScenarios(Model):
    """Scenarios of the half hours of one day."""

    scenario: str = Field(description='scenario file with placeholders in braces, such as aot550: "{aot550}"')
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
    refuse(rows.quantity != SURFACE, "campaign.day", rows.source)
    times = tuple(source.times) or rows.valid
    refuse(not times, "campaign.weather", rows.source)
    text, lines = load_yaml(scenario)
    out = []
    for time in times:
        at = _words(rows, time, source.radcalnet, str((text.get("atmosphere") or {}).get("model", "")), scenario)
        made = validate(Scenario, with_words(with_words(text, words), at), lines, str(scenario))
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
    is_on_land = pressure_at(profile, HIGHEST_KM) < pressure <= pressure_at(profile, 0.0)
    refuse(not is_on_land, "campaign.pressure", day.source, pressure=pressure)
    ground = float(scipy.optimize.brentq(lambda z: pressure_at(profile, z) - pressure, 0.0, HIGHEST_KM, xtol=1e-6))
    return {
        **state, "site": day.site, "time": time, "time_utc": f"{day.times[i]:%Y-%m-%dT%H:%M:%SZ}", "file": file,
        "latitude_deg": day.latitude_deg, "longitude_deg": day.longitude_deg, "ground_km": round(ground, 4),
        "station_km": day.altitude_m / 1e3,
    }  # fmt: skip


class Choice(Model):
    """A budget, a fit or a range that was set after the data of its own campaign were seen."""

    what: str = Field(min_length=1, description="the choice, and its result")
    before: str = Field(min_length=1, description="the earlier choice, and its result")


class Outline(Model):
    """What a campaign says of itself: enough to list what it would compare."""

    schema_version: Literal[1] = Field(alias="schema")
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9-]*$")
    title: str
    description: str
    simulated: bool | Literal["dirsig"] = Field(
        False,
        description="true: from the scene named by collection.simulate; dirsig: by DIRSIG, whose files are read",
    )
    references: list[str] = Field(default_factory=list)
    assumptions: list[str] = Field(default_factory=list, description="stated in the report")
    chosen_after: list[Choice] = Field(
        default_factory=list,
        description="choices made after the data were seen, except those of comparisons, which state it themselves",
    )
    fitted_on: list[str] = Field(
        default_factory=list,
        description="subjects that budget and settings were fitted on, names or patterns; the others count as unseen",
    )
    comparisons: list[Gate] = Field(default_factory=list, description="what validate compares; observe needs none")

    @property
    def computed(self) -> bool:
        """Whether the reference is what another program computed, and no imagery."""
        return False

    def every_choice(self) -> list[tuple[str, str]]:
        """What was set after the campaign's own data were seen, each with what it was before."""
        stated = [(choice.what, choice.before) for choice in self.chosen_after]
        return stated + [
            (f"{g.product} {g.metric} of {', '.join(g.subjects)}: {g.limit_text}", g.before)
            for g in self.comparisons
            if g.chosen_after
        ]


class Campaign(Outline):
    """One campaign: a collection, a model of it, the comparisons."""

    collection: CollectionSection
    detection: Detection | None = None
    classification: Classification | None = None
    equivalence_margin: float | None = Field(
        None,
        gt=0,
        lt=1,
        description="difference of P_D that is negligible for the purpose; adds pd_equivalence rows",
    )
    scenarios: list[ScenarioSource] = Field(
        default_factory=list,
        description="scenario files, built-in names, scenarios written out, or those of a network's day; observe "
        "alone needs none",
    )

    attribution: AttributionOptions | None = Field(None, description="attribute the differences to causes")

    @property
    def computed(self) -> bool:
        """Whether the reference is what a network computed from its own measurements."""
        return self.collection.radcalnet is not None

    @model_validator(mode="after")
    def _consistent(self) -> Campaign:
        if self.simulated == "dirsig" and (self.collection.simulate or not self.collection.cube):
            raise ValueError("simulated: dirsig reads DIRSIG's files: give collection.cube, and no simulate")
        if self.collection.simulate and not self.simulated:
            raise ValueError("a campaign with a simulated collection says 'simulated: true'")
        if self.detection and not self.collection.cube:
            raise ValueError("detection needs a cube")
        by_number = self.collection.cube is not None and self.collection.cube.by_number
        if by_number and (self.classification or (self.detection and self.detection.bands == "windows")):
            raise ValueError("by_number: atmospheric windows need wavelengths; set detection.bands to good or all")
        if self.classification and not self.collection.cube:
            raise ValueError("classification needs a cube")
        named = [(g.product, g.metric, g.method, g.bands_nm, s) for g in self.comparisons for s in g.subjects]
        if twice := [name for name in named if named.count(name) > 1]:
            product, metric, *_, subject = twice[0]
            raise ValueError(f"comparisons: {product} {metric} of {subject} is compared twice")
        return self
