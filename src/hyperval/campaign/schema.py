"""The campaign file: the collection, its scenarios and the planned comparisons; the runs and files that it names.

A file of several runs, such as flight lines, is one text with words in braces that differ from run to run.  A scenario
may stand for every half hour of a RadCalNet day; its words in braces come from the day's file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePath
from typing import Annotated, Any, ClassVar, Literal

import scipy
from pydantic import Discriminator, Field, Tag

from hyperval.atmosphere.solar import reference_of
from hyperval.atmosphere.state import pressure_at, standard_profile
from hyperval.attribute.schema import AttributionOptions
from hyperval.collection import Classification, CollectionSection, Detection
from hyperval.compare.judge import Gate
from hyperval.config import FILL_IN, Location, Model, Placeholder, load_yaml, placeholders, texts_of, unfilled, validate
from hyperval.datasets import PREFIX, SIMULATED, owner_of, resolve
from hyperval.errors import HypervalError, InputError, UsageError, package_table, reader, refuse, told_of
from hyperval.results import grouped
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario, refuse_unknown
from hyperval.spectra.networks import SURFACE, read_radcalnet

MAX_RUNS = 100


def campaign_runs(data: Mapping[str, Any], lines: dict[Location, int], name: str) -> list[tuple[dict[str, str], Any]]:
    """The words and the content of every run of a campaign file; one without words where it lists none.

    ``runs`` is a list of mappings from a word to a text; ``{word}`` stands for the text wherever it occurs in the
    file and in its scenario files.

    Raises
    ------
    UsageError : runs that are no such list, or whose words differ or are not used.
    """
    if "runs" not in data:
        return [({}, data)]
    runs, rest = data["runs"], {key: value for key, value in data.items() if key != "runs"}
    good = isinstance(runs, list) and 0 < len(runs) <= MAX_RUNS and all(isinstance(run, dict) and run for run in runs)
    refuse(not good, "campaign.runs", f"{name}:{lines.get(('runs',), 1)}")
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
    times: list[str] = Field([], description="half hours, such as 04:00; empty: all with values")


def _source_tag(entry: Any) -> str:
    """Which of the three an entry of a campaign's list is; a mistake in it is told of that one alone."""
    if isinstance(entry, DayScenarios) or (isinstance(entry, Mapping) and {*DayScenarios.model_fields} & {*entry}):
        return "(day)"
    return "(scenario)" if isinstance(entry, Scenario | Mapping) else "(name)"


ScenarioSource = Annotated[
    Annotated[DayScenarios, Tag("(day)")] | Annotated[Scenario, Tag("(scenario)")] | Annotated[str, Tag("(name)")],
    Discriminator(_source_tag),
]


def load_scenarios(
    source: DayScenarios | Scenario | str, resolve: Callable[[str], Path], base: Path, words: Mapping[str, str]
) -> Iterator[tuple[Scenario, Path | None, dict[Location, int]]]:
    """The scenarios that one entry of a campaign stands for, each with its file and the lines of its entries there.

    ``base`` is the campaign's folder; a scenario that stands in the campaign, or goes by name, has no file here.

    Raises
    ------
    UsageError, InputError : mistakes in the scenario or in what it names.
    """
    if isinstance(source, Scenario):
        source._folder = base
        yield source, None, {}
    elif isinstance(source, str) and source in builtin_scenarios():
        yield load_scenario(source), None, {}
    else:
        path = resolve(source if isinstance(source, str) else source.scenario)
        data, lines = load_yaml(path)
        for of_time in [{}] if isinstance(source, str) else _words(source, resolve(source.radcalnet), data, path):
            made = validate(Scenario, with_words(with_words(data, words), of_time), lines, str(path))
            made._folder = path.resolve().parent
            yield made, path, lines


def _words(source: DayScenarios, file: Path, scenario: Mapping[str, Any], where: Path) -> Iterator[dict[str, Any]]:
    """The words of each half hour of a day; one that is a value by itself stands for a number.

    Words, besides those of the run: site, time, time_utc, latitude_deg, longitude_deg, station_km, file, the state
    (pressure_hpa, temperature_k, water_vapour_g_cm2, ozone_atm_cm, aot550, angstrom_exponent), its uncertainties
    (u_ and the same names), and ground_km: where the stated standard atmosphere has the rows pressure.

    Raises
    ------
    UsageError : mistakes of the scenario with file and line, a half hour without values.
    InputError : a day that is missing, corrupt, not of the surface, or without values.
    """
    day = read_radcalnet(file)
    refuse(day.quantity != SURFACE, "campaign.day", day.source)
    times = tuple(source.times) or day.valid
    refuse(not times, "campaign.weather", day.source)
    with told_of(f"{where}: atmosphere.model"):
        profile = standard_profile(str((scenario.get("atmosphere") or {}).get("model", "")))
    for time in times:
        i = day.column(time)
        state = day.at(time)
        pressure = state["pressure_hpa"]
        is_on_land = pressure_at(profile, HIGHEST_KM) < pressure <= pressure_at(profile, 0.0)
        refuse(not is_on_land, "campaign.pressure", day.source, pressure=pressure)
        ground = scipy.optimize.brentq(lambda z, p=pressure: pressure_at(profile, z) - p, 0.0, HIGHEST_KM, xtol=1e-6)
        yield {
            **state, "site": day.site, "time": time, "time_utc": f"{day.times[i]:%Y-%m-%dT%H:%M:%SZ}",
            "file": source.radcalnet, "latitude_deg": day.latitude_deg, "longitude_deg": day.longitude_deg,
            "ground_km": round(float(ground), 4), "station_km": day.altitude_m / 1e3,
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
        False, description="true: from the scene named by collection.simulate; dirsig: by DIRSIG, whose files are read"
    )
    references: list[str] = Field([])
    assumptions: list[str] = Field([], description="stated in the report")
    chosen_after: list[Choice] = Field(
        [], description="choices made after the data were seen, except those of comparisons, which state it themselves"
    )
    fitted_on: list[str] = Field(
        [],
        description="subjects that budget and settings were fitted on, names or patterns; the others count as unseen",
    )
    comparisons: list[Gate] = Field([], description="what validate compares; observe needs none")

    def all_choices(self) -> list[tuple[str, str]]:
        """What was set after the campaign's own data were seen, each with what it was before."""
        after = [g for g in self.comparisons if g.chosen_after]
        gates = [(f"{g.product} {g.metric} of {', '.join(g.subjects)}: {g.limit_text}", g.before) for g in after]
        return [*((choice.what, choice.before) for choice in self.chosen_after), *gates]


class Campaign(Outline):
    """One campaign: a collection, a model of it, the comparisons."""

    collection: CollectionSection
    detection: Detection | None = None
    classification: Classification | None = None
    equivalence_margin: float | None = Field(
        None, gt=0, lt=1, description="difference of P_D that is negligible for the purpose; adds pd_equivalence rows"
    )
    scenarios: list[ScenarioSource] = Field(
        [],
        description="scenario files, built-in names, scenarios written out, or those of a network's day; observe "
        "alone needs none",
    )

    attribution: AttributionOptions | None = Field(None, description="attribute the differences to causes")

    refused: ClassVar = {
        "simulated: dirsig reads DIRSIG's files: give collection.cube, and no simulate": lambda c: (
            c.simulated == "dirsig" and (c.collection.simulate or not c.collection.cube)
        ),
        "simulated: must be true, as collection.simulate is given": lambda c: c.collection.simulate and not c.simulated,
        "{}: needs a cube": lambda c: [
            key for key in ("detection", "classification") if getattr(c, key) and not c.collection.cube
        ],
        "collection.cube.by_number: atmospheric windows need wavelengths; set detection.bands to good or all":
            lambda c: (cube := c.collection.cube) and cube.by_number
            and (c.classification or (c.detection and c.detection.bands == "windows")),
        "comparisons: {} {} of {} is compared twice": lambda c: (
            named := [(g.product, g.metric, s, g.method, g.bands_nm) for g in c.comparisons for s in g.subjects]
        ) and next(([*one] for one in named if named.count(one) > 1), []),
    }  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """A file that is named: its key, the reference, the folder that it is relative to."""

    key: str
    text: str
    base: Path

    @property
    def path_or_problem(self) -> tuple[Path | None, str]:
        """Where the file is; None, and what to do about it, where it is not at hand."""
        try:
            return resolve(self.text, self.base), ""
        except UsageError as error:
            return None, "; ".join(filter(None, (error.what, error.expected)))
        except HypervalError as error:
            return None, error.mend or error.what

    @property
    def path(self) -> Path | None:
        """Where the file is, None when it is not at hand."""
        return self.path_or_problem[0]


@dataclass(frozen=True)
class Job:
    """One run of a campaign's file as it is written, and what it names.

    Attributes
    ----------
    path, words : its file, and the words of the run that stand in braces there
    content, lines : of the file, and where its entries stand
    files, to_fill_in : that it and its scenarios name, and the values that are still to be given
    """

    path: Path
    words: Mapping[str, str]
    content: Mapping[str, Any]
    lines: dict[Location, int]
    files: tuple[Reference, ...] = ()
    to_fill_in: tuple[Placeholder, ...] = ()

    @property
    def folder(self) -> Path:
        """Folder of the campaign file, which its references are relative to."""
        return self.path.resolve().parent

    @cached_property
    def campaign(self) -> Campaign:
        """The campaign; UsageError for mistakes and for values that are still to be filled in."""
        return validate(Campaign, self.content, self.lines, str(self.path))

    @property
    def without_model(self) -> Job:
        """What is observed of it: without the model, where values are still to be filled in, which that may need."""
        content = {key: value for key, value in self.content.items() if key not in ("scenarios", "comparisons")}
        return _build_job(self.path, content, self.lines, self.words) if self.to_fill_in else self

    @cached_property
    def outline(self) -> Outline:
        """What it says of itself, which needs no value to be filled in; UsageError for mistakes in that."""
        if not self.to_fill_in:
            return self.campaign
        fields, whole = Outline.model_fields, Campaign.model_fields  # unknown keys are left in, so that they are named
        content = {key: value for key, value in self.content.items() if key in fields or key not in whole}
        return validate(Outline, content, self.lines, str(self.path))

    @cached_property
    def unavailable(self) -> tuple[str, str] | None:
        """Why it cannot be tried here, and what to do: its collection is not public, and no file of it is at hand."""
        owners = {r: owner for r in self.files if (owner := owner_of(r.text)) and not owner.public}
        if not self.to_fill_in or not owners or any(r.path is not None for r in owners):
            return None
        first, owner = next(iter(owners.items()))
        more = f"{len(self.to_fill_in)} values are to be filled in then (hyperval validate --dry-run lists them)"
        return f"{owner.name} is not on this machine: {first.path_or_problem[1]}; {more}", first.path_or_problem[1]

    @property
    def missing_keys(self) -> list[str]:
        """What it has not, without which a collection can only be observed."""
        return [key for key in ("scenarios", "comparisons") if not self.content.get(key)]

    def check(self, *, compares: bool) -> None:
        """Raise UsageError for what cannot run: a file that nobody knows, values to fill in, a side that lacks."""
        for one in (file for file in self.files if file.text.startswith(PREFIX)):
            with suppress(InputError), told_of(f"{self.path}: {one.key}", one.text):
                resolve(one.text)
        refuse(compares and self.missing_keys, "campaign.lacking", self.path, keys=" and no ".join(self.missing_keys))
        if self.to_fill_in and self.unavailable is None:
            raise unfilled(list(self.to_fill_in))


def _build_job(path: Path, content: Mapping[str, Any], lines: dict[Location, int], words: Mapping[str, str]) -> Job:
    """One run of a file with the files and values to fill in of its own text, then of its scenario files."""
    base, scenarios = Path(path).resolve().parent, content.get("scenarios")
    files, marks = [*_files(content, base)], placeholders(content, lines, str(path))
    for number, entry in enumerate(scenarios if isinstance(scenarios, list) else []):
        day = isinstance(entry, dict) and "radcalnet" in entry
        item = entry.get("scenario") if day else entry
        if not isinstance(item, str) or item in builtin_scenarios() or item.startswith(FILL_IN):
            continue
        with told_of(f"{path}:{lines.get(('scenarios', number), 1)}"):
            refuse_unknown(item, base)
        files.append(Reference("scenarios", item, base))
        if (scenario_path := files[-1].path) is None:
            continue
        inner, inner_lines = load_yaml(scenario_path)
        inner = with_words(inner, {**words, "file": str(entry["radcalnet"])} if day else words)
        files += _files(inner, scenario_path.resolve().parent)
        marks += placeholders(inner, inner_lines, item if item.startswith(PREFIX) else str(Path(path).parent / item))
    unique = {(r.text, r.base if not r.text.startswith(PREFIX) else None): r for r in reversed(files)}
    return Job(Path(path), words, content, lines, tuple(reversed(unique.values())), tuple(marks))


def _files(content: Any, base: Path) -> Iterator[Reference]:
    """The files that a campaign or scenario names.

    >>> line = {"path_radiance": [{"scenario": "day.yaml", "line": "3.1"}]}
    >>> content = {"collection": {"detector": "MINE.YML", "empirical_line": line}, "scenarios": [{"sensor": "hymap"}]}
    >>> [one.key for one in _files(content, Path())]
    ['collection.detector', 'collection.empirical_line.path_radiance.scenario']
    """
    keys_of_files = package_table("campaign/keys.yaml")["files"]
    for location, text in texts_of(content):
        keys = [part for part in location if isinstance(part, str)]  # not the number of an entry of a list
        key = keys[-1] if keys else ""
        name = (reference_of(text) or "") if key == "solar_spectrum" else text
        by_suffix = key in ("sensor", "detector") or keys[-2:] == ["path_radiance", "scenario"]  # else a name
        is_file = key in keys_of_files or "rasters" in keys or (by_suffix and PurePath(name).suffix)
        if name and (is_file or name.startswith(PREFIX)) and not text.startswith((SIMULATED, FILL_IN)):
            yield Reference(".".join(keys), name, base)


@reader
def read_jobs(path: Path) -> list[Job]:
    """Every run of a campaign file, before anything in it is checked.

    Raises
    ------
    InputError : no such file.
    UsageError : no YAML, or runs that are none.
    """
    data, lines = load_yaml(path, Campaign)
    return [_build_job(path, content, lines, words) for words, content in campaign_runs(data, lines, str(path))]


@reader
def load_job(path: Path, *, predicts: bool = True) -> Job:
    """The campaign of a file of one run, which need not predict or compare.

    ``predicts`` : whether it may, so that no value of the model is left to be filled in

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line; values that are still to be filled in; a file of several runs.
    """
    job, *more = read_jobs(path)
    refuse(more, "campaign.several", path, count=len(more) + 1)
    job = job if predicts else job.without_model
    assert job.campaign  # noqa: S101 - read now, for its mistakes
    return job


def load_jobs(*paths: Path, compares: bool = True) -> list[Job]:
    """The campaigns of files, one for each of their runs.

    ``compares``: there must be a scenario and a comparison, without which a collection can only be observed.

    A campaign with values that are still to be filled in waits where its collection is not public and no file of it
    is on this machine.

    Raises
    ------
    InputError : no such file.
    UsageError : mistakes, file names that no registry knows, values still to be filled in of a campaign that
        could run, or two campaigns of one name.
    """
    jobs = [job if compares else job.without_model for path in paths for job in read_jobs(path)]
    for job in jobs:
        job.check(compares=compares)
    for name, same in grouped(jobs, lambda job: job.outline.name).items():
        refuse(len(same) > 1, "campaign.twice", " and ".join(dict.fromkeys(str(job.path) for job in same)), name=name)
    return jobs
