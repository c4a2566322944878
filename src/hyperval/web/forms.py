"""Forms of scenarios: the predefined ones, their fields from the JSON schema, and checks before anything runs.

Each field has its title, unit, limits, default and hint from the schema; one that is left blank is left out, so that
its default stands.  Predefined are the scenarios of the package, and scenes of public collections whose files are here.
"""

from __future__ import annotations

import re
from collections import ChainMap
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice, zip_longest
from typing import Any

import yaml
from pydantic import ValidationError

from hyperval.config import SCHEMA_LINE, parse_yaml, shipped
from hyperval.datasets import files_at_hand, how_to_get, missing, registry
from hyperval.errors import UsageError, package_table, refuse
from hyperval.scenario import MODEL_DETECTORS, Scenario, builtin_scenarios, load_scenario
from hyperval.sensor.specification import library_names
from hyperval.statistics_library import BUILTIN_NAMES
from hyperval.study.schema import StudyFile
from hyperval.web.refusal import MAX_MISTAKES, FieldMistake, Refusal, deny, mistakes_of, redact

Schema = Mapping[str, Any]
Given = Mapping[str, list[str]]  # name of a field -> what stands in it
MAX_ROWS = 40
# Names that may stand at a path; engines are those of which the server needs no file.
_NAMED = {"sensor": library_names(), "processing.detectors": MODEL_DETECTORS, "atmosphere.engine": ("sixs", "emulator")}
_LAYOUT = package_table("web/forms.yaml")
SURFACES = tuple(sorted((*(n for n in BUILTIN_NAMES if not n.endswith("NN")), *_LAYOUT["greys"])))
_LEFT_OUT, _MAIN, _ASIDE, _FOLDED = (
    re.compile("|".join(_LAYOUT[part])) for part in ("left_out", "main", "aside", "folded")
)
_SCHEMA = Scenario.model_json_schema(by_alias=True)
# What hints call entries by in a file is called in a form by its title there.
_ENTRIES = ChainMap(*(group.get("properties", {}) for group in _SCHEMA["$defs"].values()))
_TITLES = {name: entry["title"] for name, entry in _ENTRIES.items() if re.search(r"[_\d]", name)}
_MAX_MARKED = 5
_MAX_OPEN = 3  # rows that stand unfolded
_CAPITAL = re.compile(r"(?<!^)(?=[A-Z])")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True, eq=False)
class FormNode:
    """A part of a form.

    Attributes
    ----------
    kind : number, text, flag, choice, several, yaml; group, rows, variants
    path, title : dotted path, and what it is called
    is_changed : whether it holds something else than what the form began with, its children aside
    is_shown : whether it stands before the fold;  is_open : of a part with children, whether these are seen at once
    chosen : of variants, the number of the one that is taken, from 1; 0: the default
    """

    kind: str
    path: str
    title: str
    hint: str = ""
    unit: str = ""
    limits: str = ""
    default: str = ""
    value: Any = ""
    choices: tuple[str, ...] = ()
    is_needed: bool = False
    children: tuple[FormNode, ...] = ()
    is_open: bool = False
    is_shown: bool = True
    is_changed: bool = False
    chosen: int = 0

    @property
    def active_children(self) -> tuple[FormNode, ...]:
        """The children that count: of variants the chosen one alone."""
        return self.children[self.chosen - 1 : self.chosen] if self.kind == "variants" else self.children

    @property
    def changes(self) -> int:
        """Values in it that are not those that the form began with."""
        return sum(child.changes for child in self.active_children) or int(self.is_changed)

    @property
    def summary(self) -> str:
        """The values given in a folded part, in a few words."""
        stated = [f"{n.title} {', '.join(n.value) if n.kind == 'several' else n.value}" for n in self._filled_nodes()]
        return "; ".join(stated[:_MAX_MARKED]) + (" ..." if len(stated) > _MAX_MARKED else "")

    def _filled_nodes(self) -> Iterator[FormNode]:
        for child in self.active_children:
            yield from child._filled_nodes()
        if self.value and not self.path.endswith(".name"):
            yield self


def form_nodes(
    data: Mapping[str, Any] | None = None, begun: Mapping[str, Any] | None = None, sensors: tuple[str, ...] = ()
) -> tuple[FormNode, ...]:
    """The parts of the form of a scenario, filled in with ``data``; files that lie on the server are no part of it.

    Parameters
    ----------
    begun : data that the form began with
    sensors : names that may stand there besides those of the library
    """
    nodes = {node.path: node for node in _group(_SCHEMA, "", data, begun)}
    nodes["sensor"] = replace(nodes["sensor"], choices=tuple(dict.fromkeys((*nodes["sensor"].choices, *sensors))))
    sections = []
    for title, entries in _LAYOUT["sections"].items():
        first, *others = [nodes.pop(name) for name in entries]
        if first.kind != "group":
            first = FormNode("group", "", title, children=(first,))
        sections.append(replace(first, title=title, children=(*first.children, *others), is_open=_is_open(first.path)))
    return (*nodes.values(), *sections)


def _members(schema: Schema) -> list[Schema]:
    """What may stand there, ``null`` left out."""
    if "$ref" in schema:
        schema = {**_SCHEMA["$defs"][schema["$ref"].rsplit("/", 1)[-1]], **schema}
    if "anyOf" in schema:
        return [m for part in schema["anyOf"] for m in _members(part)]
    return [] if schema.get("type") == "null" else [schema]


def _entries(schema: Schema, path: str) -> Iterator[tuple[str, str, Schema]]:
    """Name, path and schema of every entry of a group."""
    for name, part in schema.get("properties", {}).items():
        field = f"{path}.{name}" if path else name
        if not _LEFT_OUT.fullmatch(field):
            yield name, field, part


# From schema and data to a form.


def _group(schema: Schema, path: str, data: Any, begun: Any) -> tuple[FormNode, ...]:
    data, begun = (one if isinstance(one, Mapping) else {} for one in (data, begun))
    needed = schema.get("required", ())
    nodes: list[FormNode] = []
    for name, field, part in _entries(schema, path):
        node = _node(part, field, data.get(name), begun.get(name), name in needed)
        if node.kind == "group" and field.endswith((".spectrum", ".fill")):  # what is shown joins its neighbours
            nodes += [child for child in node.children if child.is_shown]
            node = replace(node, children=tuple(c for c in node.children if not c.is_shown), is_shown=False)
        nodes.append(node)
    return tuple(nodes)


def _node(schema: Schema, path: str, value: Any, begun: Any, is_needed: bool = False, title: str = "") -> FormNode:
    """The part of an entry: a group, variants of which one counts, rows, or a field, with what is given.

    >>> _node({"title": "a", "description": "with relative_sd; None: not aot550"}, "a", None, None).hint
    'with relative standard deviation; blank: not aerosol optical depth'
    """
    members = _members(schema)
    kinds = [_field_kind(m, path) for m in members]
    about = schema.get("description") or (members[0].get("description") if kinds == ["group"] else "")
    hint = re.sub(r"\b(?:null|None)(?=:| or )", "blank", str(about or "").split("\n\n", 1)[0].replace("\n", " "))
    hint = re.sub(r"\w+", lambda word: _TITLES.get(word[0], word[0]), hint)
    is_main = bool(is_needed or _MAIN.fullmatch(path) or (value and not _ASIDE.fullmatch(path)))
    node = FormNode("group", path, title or schema["title"], hint, is_needed=is_needed, is_shown=is_main)
    if kinds == ["group"]:
        children = _group(members[0], path, value, begun)
        is_shown = is_main or any(child.is_shown for child in children)
        return replace(node, children=children, is_shown=is_shown, is_open=bool(value or is_needed) and _is_open(path))
    if "group" in kinds:
        chosen, earlier = (_matching_member(members, kinds, one) for one in (value, begun))
        variants = list[FormNode]()
        for number, (member, kind) in enumerate(zip(members, kinds, strict=True), start=1):
            held, was = value if number == chosen else None, begun if number == earlier else None
            called = _CAPITAL.sub(" ", str(member["title"])).lower() if kind == "group" else node.title
            variants.append(_node(member, path, held, was, title=called))
        return replace(node, kind="variants", children=tuple(variants), chosen=chosen, is_changed=chosen != earlier)
    if kinds == ["rows"]:
        rows, first = (list(one) if isinstance(one, list | tuple) else [] for one in (value, begun))
        pairs = zip_longest(rows[:MAX_ROWS], first[: min(len(rows), MAX_ROWS)])
        few, item = len(rows) <= _MAX_OPEN, members[0]["items"]
        children = tuple(_row(item, f"{path}.{i}", row, was, few) for i, (row, was) in enumerate(pairs))
        return replace(node, kind="rows", children=children, is_changed=len(rows) < len(first))
    kind = kinds[0] if len(kinds) == 1 else "yaml" if "yaml" in kinds else "text"
    stated = (str(c) for m in members for c in m.get("enum", [m["const"]] if "const" in m else []))
    choices = _choices(path) or tuple(stated)
    text: Any = "" if value is None else _field_text(value)
    if kind == "several":
        text = [str(v) for v in value] if isinstance(value, list | tuple) else []
    elif kind == "choice" and text and text not in choices:
        choices = (*choices, text)
    default = schema.get("default")
    return replace(
        node, kind=kind, value=text, choices=choices, unit=schema.get("unit", ""),
        limits=next((words for m in members if kind != "several" and (words := _limits(m))), ""),
        default="" if default is None or isinstance(default, dict) else _field_text(default),
        # Where nothing is said a form cannot tell it from a field that is left alone.
        is_changed=value != begun and not all(one in (None, "", [], (), {}) for one in (value, begun)),
    )  # fmt: skip


def _row(item: Schema, path: str, row: Any, begun: Any, is_few: bool) -> FormNode:
    name = row.get("name") if isinstance(row, Mapping) else None
    title = str(name or int(path.rpartition(".")[2]) + 1)
    return replace(_node(item, path, row, begun, title=title), is_open=not row or (is_few and _is_open(path)))


# From a filled form to data.


def form_data(texts: Given, schema: Schema = _SCHEMA, path: str = "") -> dict[str, Any]:
    """The nested data of a form as it was sent, or of a group of it."""
    read = {name: _read(_members(part), field, texts) for name, field, part in _entries(schema, path)}
    return {name: value for name, value in read.items() if value is not None}


def _read(members: list[Schema], path: str, texts: Given) -> Any:
    kinds = [_field_kind(m, path) for m in members]
    if kinds == ["group"]:
        return form_data(texts, members[0], path) or None
    if "group" in kinds:
        number = _row_count(texts, f"{path}?", len(members))
        if number and kinds[number - 1] == "group":  # which counts where nothing stands in it, too
            return form_data(texts, members[number - 1], path)
        return _read([members[number - 1]], path, texts) if number else None
    is_list = f"{path}#" in texts
    if kinds == ["rows"]:
        item = _members(members[0]["items"])[0]
        places = [f"{path}.{i}" for i in range(_row_count(texts, f"{path}#", MAX_ROWS))]
        rows = [form_data(texts, item, place) for place in places if f"{place}!" not in texts]
        return rows if is_list else None
    values = [v.strip() for v in texts.get(path, []) if v.strip()]
    if kinds == ["several"]:
        return values or ([] if is_list else None)
    return _parse_value(values[0], kinds) if values else None


def _is_open(path: str) -> bool:
    """Whether a part that something stands in is unfolded."""
    return _FOLDED.fullmatch(path) is None


def _choices(path: str) -> tuple[str, ...]:
    """Names that may stand at a path, where the schema leaves them open; empty: anything."""
    return _NAMED.get(path, SURFACES if path.endswith(".builtin") else ())


def _field_kind(schema: Schema, path: str) -> str:
    """The kind of field that a schema asks for at a path."""
    kind, is_named = schema.get("type"), bool(_choices(path))
    if "enum" in schema or "const" in schema:
        return "choice"
    if kind == "object":
        return "group" if "properties" in schema else "yaml"
    if kind == "array":
        return "rows" if "$ref" in schema.get("items", {}) else "several" if is_named else "yaml"
    return {"number": "number", "integer": "number", "boolean": "flag"}.get(str(kind), "choice" if is_named else "text")


def _field_text(value: Any) -> str:
    """A value as it stands in its field."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_field_text, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_field_text(v)}" for k, v in value.items()) + "}"
    return str(value)


def _limits(schema: Schema) -> str:
    """The limits of a number, in words."""
    if schema.get("type") == "array" and not schema.get("enum"):
        return "such as [[450, 700]]" if schema.get("items", {}).get("type") == "array" else "such as [0.2, 0.5]"
    if schema.get("type") == "object" and "properties" not in schema:
        return "or such as {VNIR: 0.3}"
    low, high = schema.get("minimum"), schema.get("maximum")
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    words = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}
    return ", ".join(f"{text} {schema[key]:g}" for key, text in words.items() if key in schema)


def _matching_member(members: list[Schema], kinds: list[str], value: Any) -> int:
    """Number of the first member that a value may be one of, from 1; 0 where there is none."""
    keys = set(value) if isinstance(value, Mapping) else None
    for number, (member, kind) in enumerate(zip(members, kinds, strict=True), start=1):
        fits = kind != "group" if keys is None else kind == "group" and keys <= set(member["properties"])
        if fits and value is not None:
            return number
    return 0


def _parse_value(text: str, kinds: list[str]) -> Any:
    if "yaml" in kinds:
        with suppress(UsageError):  # what cannot be read is text, and refused at its field by the model
            return parse_yaml(text)[0]
    if "number" in kinds and _NUMBER.fullmatch(text):
        return int(text) if text.lstrip("+-").isdigit() and len(text) < 18 else float(text)
    if "flag" in kinds and text in ("true", "false"):
        return text == "true"
    return text


def _row_count(texts: Given, name: str, most: int) -> int:
    text = texts.get(name, ["0"])[0]
    return min(int(text), most) if text.isdecimal() and len(text) < 6 else 0


SCENES = shipped("hyperval.web", "scenarios")  # of public collections: their files by name


@lru_cache(maxsize=1)
def predefined() -> dict[str, Scenario]:
    """Scenarios by name."""
    return {name: load_scenario(SCENES.get(name, name)) for name in (*builtin_scenarios(), *SCENES)}


def needs(source: object) -> dict[str, str]:
    """Data sets that a scenario or the text of a campaign names and this machine lacks -> how to get each."""
    lacking = {}
    for name in sorted(set(re.findall(r"data:([\w-]+)/", str(source))) & registry().keys()):
        entry = registry()[name]
        if missing(name) if entry.public else not files_at_hand(name):
            lacking[name] = f"hyperval data fetch {name}" if entry.public else redact(how_to_get(entry))
    return lacking


_FILES = {"files", "library", "table", "measured", "replicates"}
_GREY = re.compile(r"grey-panel-\d\d")
_MAX_TEXT = 200
_MAX_DEPTH = 24
_MAX_ITEMS = 5000  # of a list of numbers
_MAX_ENTRIES = 100  # of a list of groups, which are checked one by one
_MAX_VALUES = 20_000


def dump(stated: Scenario | StudyFile) -> dict[str, Any]:
    """A scenario or study as plain data: what is stated, and no defaults."""
    return stated.model_dump(mode="json", by_alias=True, exclude_unset=True)


def checked_scenario(data: Mapping[str, Any], uploads: Collection[str] = ()) -> Scenario:
    """The scenario of plain data.

    Raises
    ------
    Refusal : every mistake with its field.
    """
    mistakes = list(_name_mistakes(check_size(data), uploads))
    try:
        scenario = Scenario.model_validate(data)
    except ValidationError as error:
        raise Refusal(422, [*mistakes_of(error.errors()), *mistakes][:MAX_MISTAKES]) from error
    deny(mistakes or list(_cost_mistakes(scenario)), 422)
    return scenario


def check_size(data: Any, field: str = "") -> Any:
    """The data, if its size is within bounds; checked before its entries are validated.

    Raises
    ------
    Refusal : it holds too much, at which field.
    """
    values = enumerate(islice(_values(data, (field,) if field else ()), _MAX_VALUES), start=1)
    many = f"with it there are more than {_MAX_VALUES:,} values"
    excess = ((place, many if number == _MAX_VALUES else _excess(place, value)) for number, (place, value) in values)
    mistakes = (FieldMistake(".".join(place), words) for place, words in excess if words)
    deny(list(islice(mistakes, MAX_MISTAKES)), 422)
    return data


def _values(data: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Path and value of everything in nested data, what holds others before these; nothing too deep."""
    yield path, data
    items = data.items() if isinstance(data, Mapping) else enumerate(data) if isinstance(data, list | tuple) else ()
    for key, value in items if len(path) <= _MAX_DEPTH else ():
        yield from _values(value, (*path, str(key)[:60]))


def _excess(path: tuple[str, ...], value: Any) -> str:
    """What there is too much of in a value, in words; empty: nothing."""
    is_long = path[-1:] == ("description",)
    if len(path) > _MAX_DEPTH:
        return "too deep"
    if isinstance(value, Mapping | list | tuple):
        is_rows = isinstance(value, Mapping) or (len(value) > 0 and isinstance(value[0], Mapping))
        most = _MAX_ENTRIES if is_rows else _MAX_ITEMS
        return f"{len(value):,} entries; at most {most:,} are taken" if len(value) > most else ""
    if isinstance(value, str):
        longest = 2000 if is_long else _MAX_TEXT
        unseen = "" if is_long or value.isprintable() else "holds a character that cannot be printed"
        return f"longer than {longest} characters" if len(value) > longest else unseen
    return "a number of too many digits" if isinstance(value, int) and abs(value) > 1 << 62 else ""


def _name_mistakes(data: Mapping[str, Any], uploads: Collection[str]) -> Iterator[FieldMistake]:
    """Mistakes of names that this server does not have, and of files of its own."""
    # What the predefined scenarios name of data sets, anybody may name.
    files = [target.spectrum.file for one in predefined().values() for target in one.scene.targets]
    for parts, value in _values(data):
        path, key = ".".join(parts), parts[-1] if parts else ""
        names = (*_choices(path), *(uploads if path == "sensor" else ()))
        if names and isinstance(value, str) and value not in names and not _GREY.fullmatch(value):
            yield FieldMistake(path, f"this server has nothing of that name; one of {', '.join(names)}")
        elif key == "file" and value in files:
            yield from (FieldMistake(path, f"this server lacks the data set {name}") for name in needs(value))
        elif key == "file" and value not in (None, *uploads):
            yield FieldMistake(path, f"names no file that you have uploaded: {', '.join(uploads) or 'there is none'}")
        elif key in _FILES and value is not None:
            yield FieldMistake(path, "files of the server are not read")


def _cost_mistakes(scenario: Scenario) -> Iterator[FieldMistake]:
    """Mistakes of what this server cannot compute, or not for everybody."""
    scene = scenario.scene
    if scenario.sensor is None:
        yield FieldMistake("sensor", "a sensor is needed, which gives the bands")
    subjects = [*scene.classes, *scene.panels, *scene.sites, *(p for t in scene.targets for p in t.populations)]
    if len(subjects) > 60:
        yield FieldMistake("scene", f"{len(subjects)} subjects; at most 60")
    draws = [("processing.samples", scenario.processing.samples, 20_000)]
    if scenario.uncertainty.method != "linear":
        draws.append(("uncertainty.samples", scenario.uncertainty.samples, 1_000))
    for path, count, most in draws:
        if count > most:
            yield FieldMistake(path, f"{count:,}; this server draws at most {most:,}")


def by_field(mistakes: Collection[FieldMistake], paths: Collection[str]) -> dict[str, list[str]]:
    """Field -> what is wrong there, each once: at the first field that it names, or the nearest that holds it.

    >>> mistake = FieldMistake("scene", "classes: their fractions sum to 0.9, not 1")
    >>> list(by_field([mistake], ["scene", "scene.fractions", "scene.classes"]))
    ['scene.classes']
    """
    out: dict[str, list[str]] = {}
    for mistake in mistakes:
        field = mistake.field
        names = {p: p.rpartition(".")[2] for p in paths if p.rpartition(".")[0] == field}
        named = [p for p, name in names.items() if re.search(rf"\b{re.escape(name)}\b", mistake.message)]
        while field and field not in paths:
            field = field.rpartition(".")[0]
        first = min(named, key=lambda p: mistake.message.find(names[p]), default=field)
        out.setdefault(first, []).append(mistake.message)
    return out


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Text that begins as a number stands in quotation marks: readers of YAML take it for different things."""


_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", re.compile(r"[-+.]?\d"), list("-+.0123456789"))


def yaml_text(kind: str, data: Mapping[str, Any], note: str = "") -> str:
    """Plain data as YAML that the strict reader takes for the same; its first line names the schema of its kind."""
    text = str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110))
    refuse(parse_yaml(text)[0] != data, "form.yaml")
    return f"{SCHEMA_LINE}{kind}.schema.json\n{note}{text}"
