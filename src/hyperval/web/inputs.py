"""Scenarios as pages and programs give them: predefined ones, what may stand where, what is refused beforehand.

Scenarios that go by name: those of the package, and scenes of public collections where their files are here.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache
from importlib import resources
from itertools import islice
from typing import Any

import yaml
from pydantic import ValidationError

from hyperval.config import SCHEMA_LINE, parse_yaml
from hyperval.datasets import files_at_hand, how_to_get, missing, registry
from hyperval.errors import UsageError
from hyperval.scenario import Scenario, builtin_scenarios, load_scenario
from hyperval.sensor.specification import library_names
from hyperval.web.forms import SURFACES, Form
from hyperval.web.refusal import FieldMistake, Refused, mistakes_of, said


@lru_cache(maxsize=1)
def predefined() -> dict[str, Scenario]:
    """Scenarios by name."""
    known = {name: load_scenario(name) for name in builtin_scenarios()}
    with resources.as_file(resources.files("hyperval.web") / "scenarios") as folder:
        scenes = [load_scenario(path) for path in sorted(folder.glob("*.yaml"))]
    return known | {scene.name: scene for scene in scenes}


@lru_cache(maxsize=1)
def known_files() -> frozenset[str]:
    """Files of data sets that the predefined scenarios name, and that anybody may name therefore."""
    return frozenset(
        surface.spectrum.file
        for scenario in predefined().values()
        for surface in scenario.scene.targets
        if surface.spectrum.file is not None
    )


def needs(source: object) -> dict[str, str]:
    """Data sets that a scenario or the text of a campaign names and this machine lacks -> how to get each."""
    lacking = {}
    for name in sorted(set(re.findall(r"data:([\w-]+)/", str(source))) & registry().keys()):
        entry = registry()[name]
        if missing(name) if entry.public else not files_at_hand(name):
            lacking[name] = f"hyperval data fetch {name}" if entry.public else how_to_get(entry)
    return lacking


_FILES = ("file", "files", "library", "table", "measured", "replicates")
_GREY = re.compile(r"grey-panel-\d\d")
_MOST_TEXT = 200
_MOST_DEPTH = 24
_MOST_ITEMS = 5000  # of a list of numbers
_MOST_ENTRIES = 100  # of a list of groups, which are checked one by one
_MOST_VALUES = 20_000
_MOST_MISTAKES = 40
_LARGEST = {"processing.samples": 20_000, "uncertainty.samples": 1_000}


@lru_cache(maxsize=1)
def scenario_form() -> Form:
    """The form of a scenario, whose schema is made once."""
    return Form()


def plain(scenario: Scenario) -> dict[str, Any]:
    """A scenario as a file has it: what is stated, and no defaults."""
    return scenario.model_dump(mode="json", by_alias=True, exclude_unset=True)


def checked_scenario(data: Mapping[str, Any], uploads: Collection[str] = ()) -> Scenario:
    """The scenario of plain data.

    Raises
    ------
    Refused : every mistake with its field.
    """
    refuse_excess(data)
    try:
        scenario = Scenario.model_validate(data)
    except ValidationError as error:
        raise Refused(422, mistakes_of(error, data)) from error
    mistakes = [*_of_names(scenario, uploads), *_of_files(data, uploads)] or list(_of_cost(scenario))
    if mistakes:
        raise Refused(422, mistakes)
    return scenario


def refuse_excess(data: Any, at: str = "") -> None:
    """Look at the size of data before it is checked entry by entry.

    Raises
    ------
    Refused : it holds too much, at which field.
    """
    place = (at,) if at else ()
    mistakes = list(islice(_too_much(data, place, [_MOST_VALUES]), _MOST_MISTAKES))
    if mistakes:
        raise Refused(422, mistakes)


def _too_much(data: Any, at: tuple[str, ...], left: list[int]) -> Iterator[FieldMistake]:
    """What there is too much of; ``left`` counts down the values that are still looked at."""
    left[0] -= 1
    if left[0] == 0:
        yield FieldMistake(".".join(at), f"with it there are more than {_MOST_VALUES:,} values")
    elif len(at) > _MOST_DEPTH:
        yield FieldMistake(".".join(at[:4]), "too deep")
    elif isinstance(data, Mapping | list | tuple):
        is_rows = isinstance(data, Mapping) or (len(data) > 0 and isinstance(data[0], Mapping))
        most = _MOST_ENTRIES if is_rows else _MOST_ITEMS
        if len(data) > most:
            yield FieldMistake(".".join(at), f"{len(data):,} entries; at most {most:,} are taken")
            return
        for key, value in data.items() if isinstance(data, Mapping) else enumerate(data):
            if left[0] <= 0:
                return
            yield from _too_much(value, (*at, str(key)[:60]), left)
    elif isinstance(data, str):
        longest = 2000 if at[-1:] == ("description",) else _MOST_TEXT
        if len(data) > longest:
            yield FieldMistake(".".join(at), f"longer than {longest} characters")
        elif not data.isprintable() and at[-1:] != ("description",):
            yield FieldMistake(".".join(at), "holds a character that cannot be printed")
    elif isinstance(data, int) and abs(data) > 1 << 62:
        yield FieldMistake(".".join(at), "a number of too many digits")


def _of_names(scenario: Scenario, uploads: Collection[str]) -> Iterator[FieldMistake]:
    if scenario.sensor is not None and scenario.sensor not in (*library_names(), *uploads):
        yield FieldMistake("sensor", f"no such sensor; one of {', '.join((*library_names(), *uploads))}")
    if scenario.atmosphere is not None and scenario.atmosphere.engine not in ("sixs", "emulator"):
        yield FieldMistake("atmosphere.engine", "this server has the engines sixs and emulator alone")
    for path, name in _leaves(plain(scenario), "builtin"):
        if name not in SURFACES and not _GREY.fullmatch(str(name)):
            yield FieldMistake(path, f"no such surface; one of {', '.join(SURFACES)}")


def _of_files(data: Mapping[str, Any], uploads: Collection[str]) -> Iterator[FieldMistake]:
    for key in _FILES:
        for path, value in _leaves(data, key):
            if value is None or (key == "file" and value in uploads):
                continue
            if key == "file" and value in known_files():
                yield from (FieldMistake(path, f"this server lacks the data set {name}") for name in needs(value))
            else:
                words = f"names no file that you have uploaded: {', '.join(uploads) or 'there is none'}"
                yield FieldMistake(path, words if key == "file" else "files of the server are not read")


def _of_cost(scenario: Scenario) -> Iterator[FieldMistake]:
    scene = scenario.scene
    subjects = len(scene.classes) + len(scene.panels) + len(scene.sites)
    populations = sum(len(t.populations) for t in scene.targets)
    if subjects + populations > 60:
        yield FieldMistake("scene", f"{subjects + populations} subjects; at most 60")
    for path, most in _LARGEST.items():
        group, name = path.split(".")
        value = getattr(getattr(scenario, group), name)
        if value > most and (group != "uncertainty" or scenario.uncertainty.method != "linear"):
            yield FieldMistake(path, f"{value:,}; this server draws at most {most:,}")


def _leaves(data: Any, key: str, at: str = "") -> Iterator[tuple[str, Any]]:
    """Path and value of every entry that goes by ``key``."""
    items = data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list | tuple) else ()
    for name, value in items:
        path = f"{at}.{name}" if at else str(name)
        if name == key:
            yield path, value
        yield from _leaves(value, key, path)


def marked(mistakes: Collection[FieldMistake], paths: Collection[str]) -> dict[str, list[str]]:
    """Field -> what is wrong there, each once: at the first field that it names, or the nearest that holds it."""
    out: dict[str, list[str]] = {}
    for mistake in mistakes:
        at = mistake.field
        named = [
            p
            for p in paths
            if p.rpartition(".")[0] == at and re.search(rf"\b{re.escape(p.rpartition('.')[2])}\b", mistake.message)
        ]
        while at and at not in paths:
            at = at.rpartition(".")[0]
        first = min(named, key=lambda p: mistake.message.find(p.rpartition(".")[2]), default=at)
        out.setdefault(first, []).append(mistake.message)
    return out


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Text that begins as a number stands in quotation marks: readers of YAML take it for different things."""


_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"[-+.]?\d"), list("-+.0123456789"))


def yaml_text(kind: str, data: Mapping[str, Any], note: str = "") -> str:
    """Plain data as YAML that the strict reader takes for the same; its first line names the schema of its kind."""
    text = str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110))
    if parse_yaml(text)[0] != data:
        raise UsageError("this cannot be written as YAML unchanged")
    return f"{SCHEMA_LINE}{kind}.schema.json\n{note}{text}"


def form_data(given: Mapping[str, list[str]]) -> dict[str, Any]:
    """The data of a filled form.

    Raises
    ------
    Refused : a field that is not of its form.
    """
    try:
        return scenario_form().data(given)
    except UsageError as error:
        raise Refused(422, [FieldMistake(error.where or "", said(error))]) from error
