"""Configuration files: strict YAML into frozen pydantic models, errors with file and line."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator
from yaml.composer import Composer
from yaml.cyaml import CParser
from yaml.resolver import Resolver

from hyperval.errors import UsageError, did_you_mean, needed, package_table, reader, refusal, refuse
from hyperval.storage import content_of, installed_file, write_text
from hyperval.units import to_internal

MAX_BYTES = 1 << 20
MAX_DEPTH = 32
_MAX_DIGITS = 300  # a number of more is none that a calculation can hold
MAX_NODES = 40_000  # keys and values
MAX_MISTAKES = 20  # that are listed
# A value that begins so is one that the user has still to give: "FILL_IN: what it is".
FILL_IN = "FILL_IN"
UNITS, _EXPECTED, _GONE = (package_table("keys.yaml")[name] for name in ("units", "expected", "gone"))
_MEMBER = re.compile(r"[a-z-]*\[.*|\(.*\)|(?:constrained-)?(?:float|int|str)|bool")  # of a union, in its mistakes
_BRACKETS = re.compile(r" ?\[([^\]\[]{1,24})\]")


def _describe_fields(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Give each field of a JSON schema its title, its unit and its default.

    The unit stands in brackets in the description.  A default of no entries goes without saying.
    """
    fields = {info.alias or name: info for name, info in model.model_fields.items()}
    for name, field in schema.get("properties", {}).items():
        info = fields[name]
        if field.get("default") in ([], {}):
            del field["default"]
        ending = next((end for end in UNITS if name.endswith(end)), "")
        words = str(field.get("description", ""))
        stated = _BRACKETS.search(words)
        field["title"] = info.title or (name.removesuffix(ending) or name).replace("_", " ")
        if unit := stated[1] if stated else UNITS.get(ending):
            field["unit"] = unit
        if stated:
            field["description"] = _BRACKETS.sub("", words).strip()


# Words, of one entry after its key and a colon -> whether the entries of a model contradict each other so; a list holds
# what stands in the words where they do.
Refusal = Mapping[str, Callable[[Any], object]]


def twice(names: Iterable[Any]) -> list[Any]:
    """What stands more than once, in order."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def unknown(names: Iterable[str], valid: Iterable[str]) -> list[Any]:
    """The first name that is not known and, in words, those that are; nothing where all are known."""
    listed = list(valid)
    return next(([name, ", ".join(listed)] for name in names if name not in listed), [])


class Model(BaseModel):
    """Base of every configuration model: unknown keys, NaN and infinity are refused, and what contradicts itself."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, json_schema_extra=_describe_fields)
    refused: ClassVar[Refusal] = {}

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        for words, contradicts in self.refused.items():
            if found := contradicts(self):
                names = found if isinstance(found, list) else []
                raise ValueError(words.format(*names, names=", ".join(map(str, names))) if names else words)
        return self


class FileModel(Model):
    """What a whole file says, which begins with its name."""

    schema_version: Literal[1] = Field(1, alias="schema")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    title: str = ""
    description: str = ""
    _folder: Path | None = PrivateAttr(None)

    @property
    def folder(self) -> Path | None:
        """Folder of the file that it was read from, to which its references are relative."""
        return self._folder


class OneOf(Model):
    """Has entries of which exactly ``one_of`` or ``at_most_one_of`` is given, or which are given ``together``."""

    one_of: ClassVar[tuple[str, ...]] = ()
    at_most_one_of: ClassVar[tuple[str, ...]] = ()
    together: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        one, most, together = (
            [name for name in names if (value := getattr(self, name)) not in (None, [], ()) and value is not False]
            for names in (self.one_of, self.at_most_one_of, self.together)
        )
        if self.one_of and len(one) != 1:
            both = f": {' and '.join(one)} are given" if one else ""
            raise ValueError(f"give exactly one of {', '.join(self.one_of)}{both}")
        if len(most) > 1:
            raise ValueError(f"give {' or '.join(self.at_most_one_of)}, not both")
        if together and len(together) < len(self.together):
            raise ValueError(f"{' and '.join(self.together)} go together")
        return super()._is_consistent()  # type: ignore[operator, no-any-return]


def _unit_of(quantity: str) -> AfterValidator:
    """Refuses an unknown unit when the file is read, so that a dry run finds it, with its line."""

    def checked(unit: str) -> str:
        try:
            to_internal(unit, quantity)
        except UsageError as error:
            raise ValueError(f"{error.what}; {error.expected}") from None
        return unit

    return AfterValidator(checked)


RadianceUnit = Annotated[str, _unit_of("radiance")]
WavelengthUnit = Annotated[str, _unit_of("wavelength")]

M = TypeVar("M", bound=BaseModel)
Location = tuple[str | int, ...]


@dataclass(frozen=True)
class Placeholder:
    """A value that is still to be filled in: its key, ``file:line``, and what it is."""

    key: str
    where: str
    what: str


class _Loader(Composer, Resolver, CParser):  # type: ignore[misc]
    """YAML 1.2 core scalars only: no dates, no octals, no sexagesimals, no yes/no, no underscores.

    Aliases, anchors, tags and what is too deep or too large are refused while the tree is built: the parser's time
    grows with the square of the depth.
    """

    def __init__(self, text: str, name: str):
        CParser.__init__(self, text)
        Composer.__init__(self)
        Resolver.__init__(self)
        self._file, self._depth, self._entries = name, 0, 0

    def get_event(self) -> yaml.Event:
        """The next event, as the composer of the tree takes it."""
        event = super().get_event()
        self._depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        self._entries += isinstance(event, yaml.NodeEvent)
        tag, problem = getattr(event, "tag", None), None
        if self._depth > MAX_DEPTH or self._entries > MAX_NODES:
            problem = "too deep or too many entries"
        elif isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            problem = "anchors and aliases are not allowed"
        elif tag and tag != "!":
            problem = f"the tag {tag!r} is not allowed"
        if problem:
            raise UsageError(problem, where=f"{self._file}:{event.start_mark.line + 1}")
        return event


# Kind of a scalar -> what it looks like, and the value of its text.
_SCALARS: dict[str, tuple[str, Callable[[str], Any]]] = {
    "bool": (r"^(?:true|True|TRUE|false|False|FALSE)$", lambda text: text.lower() == "true"),
    "int": (r"^[-+]?(?:0|[1-9][0-9]*)$", int),
    "float": (
        r"^[-+]?(?:(?:\.[0-9]+|(?:0|[1-9][0-9]*)\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[1-9][0-9]*[eE][-+]?[0-9]+)$|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$",
        lambda text: float(text.lower().replace(".inf", "inf").replace(".nan", "nan")),
    ),
    "null": (r"^(?:~|null|Null|NULL|)$", lambda text: None),
}
_Loader.yaml_implicit_resolvers = {}
for _kind, (_pattern, _) in _SCALARS.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_pattern), None)


def shipped(package: str, folder: str) -> dict[str, Path]:
    """Name -> YAML file of all that ship in a folder of a package."""
    return {path.stem: path for path in sorted(installed_file(package, folder).glob("*.yaml"))}


def file_of(name_or_path: str | Path, library: Mapping[str, Path], kind: str) -> Path:
    """The file of what goes by its name or by its path; UsageError where it is neither.

    >>> file_of("place/casi-150", {"casi-1500": Path("casi-1500.yaml")}, "sensor")
    Traceback (most recent call last):
    hyperval.errors.UsageError: unknown sensor 'place/casi-150'; did you mean 'casi-1500'?
      expected: a YAML file or one of casi-1500
    >>> file_of("MINE.YAML", {}, "sensor").name  # which is not there says its reader
    'MINE.YAML'
    """
    path = library.get(str(name_or_path), Path(name_or_path))
    if path.suffix.lower() not in (".yaml", ".yml") and not path.exists():
        what = f"unknown {kind} {str(path)!r}{did_you_mean(path.name, library)}"
        raise UsageError(what, expected="a YAML file or one of " + ", ".join(library))
    return path


@reader
def load_yaml(path: Path, model: type[BaseModel] = BaseModel) -> tuple[Any, dict[Location, int]]:
    """Read a YAML file strictly; a file of another kind than ``model`` is refused, with the command that reads it.

    Returns the plain data and the line number (1-based) of every key and list item.

    Raises
    ------
    InputError : no such file, or it cannot be read.
    UsageError : not UTF-8, too large, too deep, duplicate keys, anchors, tags, or a syntax error.
    """
    path = Path(path)
    refuse(path.is_dir(), "file.folder", path, file=min(path.glob("*.y*ml"), default=path / "FILE.yaml"))
    try:
        text = content_of(path, ("file.none", "file.large"), most=MAX_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError("not UTF-8 text", where=str(path), expected="a YAML file in UTF-8") from error
    data, lines = parse_yaml(text, str(path))
    refuse(not isinstance(data, dict), "yaml.keys", f"{path}:1")
    fields = model.model_fields.keys()
    (wanted, _), (kind, command), (matching, _) = map(_kind_of, (fields, data, data.keys() & fields))
    command = command.format(file=shlex.quote(str(path)))
    refuse(wanted and kind and not matching, "file.kind", path, kind=kind, wanted=wanted, command=command)
    return data, lines


def _kind_of(keys: Iterable[str]) -> tuple[str, str]:
    """The kind of a file with these keys, and the command that reads it; empty where no kind fits."""
    marks = package_table("own_files.yaml")["yaml"].items()
    return next((entry for mark, entry in marks if any(re.match(mark, f"{key}:") for key in keys)), ("", ""))


def parse_yaml(text: str, name: str = "<text>") -> tuple[Any, dict[Location, int]]:
    """Parse YAML text by the rules of :func:`load_yaml`; ``name`` stands for the file in messages."""
    try:
        root = _Loader(text, name).get_single_node()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"{name}:{mark.line + 1}" if mark else name
        raise UsageError(f"not valid YAML: {getattr(error, 'problem', error)}", where=where) from error
    except UnicodeEncodeError as error:
        line = text.count("\n", 0, error.start) + 1
        raise UsageError("an unpaired UTF-16 surrogate", where=f"{name}:{line}") from error
    lines: dict[Location, int] = {}
    return _construct(needed(root, "yaml.empty", name), (), lines, name), lines


def _construct(node: yaml.Node, location: Location, lines: dict[Location, int], name: str) -> Any:
    lines.setdefault(location, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            refuse(not isinstance(key_node, yaml.ScalarNode), "yaml.plain", f"{name}:{line}")
            key = str(key_node.value)
            if key in out:
                raise refusal("yaml.twice", f"{name}:{line}", key=key, first=lines[(*location, key)])
            lines[(*location, key)] = line
            out[key] = _construct(value_node, (*location, key), lines, name)
        return out
    if isinstance(node, yaml.SequenceNode):
        return [_construct(item, (*location, i), lines, name) for i, item in enumerate(node.value)]
    kind = node.tag.rpartition(":")[2]
    if kind == "int" and len(node.value) > _MAX_DIGITS:
        raise UsageError(f"a number of {len(node.value)} digits", where=f"{name}:{node.start_mark.line + 1}")
    return _SCALARS[kind][1](node.value) if kind in _SCALARS else node.value


def texts_of(data: Any, location: Location = ()) -> Iterator[tuple[Location, str]]:
    """Every text of plain data, in the order of the file, and where it stands."""
    if isinstance(data, str):
        yield location, data
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from texts_of(value, (*location, key))


def placeholders(data: Any, lines: dict[Location, int], name: str) -> list[Placeholder]:
    """Every value of ``data`` that is marked ``FILL_IN``, in the order of the file."""
    marked = [(key, text.removeprefix(FILL_IN)) for key, text in texts_of(data) if text.startswith(FILL_IN)]
    where = {key: f"{name}:{lines.get(key, 1)}" for key, _ in marked}
    return [Placeholder(".".join(map(str, key)), where[key], text.lstrip(": ") or "a value") for key, text in marked]


def unfilled(entries: list[Placeholder]) -> UsageError:
    """The error that names every value to be filled in."""
    listed = [f"{p.where}: {p.key}: {p.what}" for p in entries]
    count = f"{len(entries)} values are" if len(entries) > 1 else "1 value is"
    return UsageError("\n  ".join([f"{count} still to be filled in", *listed]))


def validate(model: type[M], data: Any, lines: dict[Location, int], name: str) -> M:
    """Turn plain data into ``model``; every mistake is listed with its file and line at once.

    >>> class Ends(Model):
    ...     low: float
    ...     refused: ClassVar = {"low is 0 or more": lambda ends: ends.low < 0.0}
    >>> validate(Ends, {"low": -1.0}, {}, "a.yaml")
    Traceback (most recent call last):
    hyperval.errors.UsageError: a.yaml: low is 0 or more
    """
    if to_fill_in := placeholders(data, lines, name):
        raise unfilled(to_fill_in)
    cause: ValidationError | None = None
    try:
        loaded = model.model_validate(data)
        mistakes = list(misread(data, loaded.model_dump(by_alias=True)))
    except ValidationError as error:
        cause, mistakes = error, list(mistakes_in(error.errors(include_url=False), model))
    problems: list[tuple[int, str]] = []
    for location, text in mistakes:
        line = next((lines[location[:n]] for n in range(len(location), -1, -1) if location[:n] in lines), 1)
        where = f"{name}:{line}" if lines else name
        problems.append((line, ": ".join(filter(None, (where, ".".join(map(str, location)), text)))))
    if problems:
        listed, more = [text for _, text in sorted(problems)], len(problems) - MAX_MISTAKES
        raise UsageError("\n  ".join([*listed[:MAX_MISTAKES], *([f"and {more} more"] if more > 0 else [])])) from cause
    return loaded


def misread(data: Any, read: Any, location: Location = ()) -> Iterator[tuple[Location, str]]:
    """Where pydantic took true for a number, another value for true or false, or digits with underscores for a number.

    >>> data, read = {"zenith": True, "seed": "1_000", "bits": "12"}, {"zenith": 1.0, "seed": 1000, "bits": 12}
    >>> for _, words in misread([data, "no"], [read, False]):
    ...     print(words)
    expected a number, not True
    expected a number, not '1_000'
    expected true or false, not 'no'
    """
    is_odd = isinstance(read, bool) != isinstance(data, bool) or (isinstance(data, str) and "_" in data)
    stated, taken = (dict(enumerate(v)) if isinstance(v, list | tuple) else v for v in (data, read))
    if isinstance(read, int | float) and is_odd:
        yield location, f"expected {'true or false' if isinstance(read, bool) else 'a number'}, not {data!r}"
    elif isinstance(stated, dict) and isinstance(taken, dict):
        for key in filter(taken.__contains__, stated):
            yield from misread(stated[key], taken[key], (*location, key))


def mistakes_in(
    items: Sequence[Mapping[str, Any]], model: type[BaseModel] | None = None
) -> Iterator[tuple[Location, str]]:
    """Path and text of each mistake that pydantic finds in plain data; the types that one path may have as one.

    ``model`` : to suggest a key like an unknown one

    >>> made = type("Made", (Model,), {"__annotations__": {"heading_deg": float | Literal["random"]}})
    >>> try:
    ...     made(heading_deg="x", shape=1)
    ... except ValidationError as error:
    ...     [words for _, words in mistakes_in(error.errors())]
    ['unknown key', "expected a finite number, such as 0.5, or 'random'"]
    >>> [words for _, words in mistakes_in([{"type": "int_parsing_size", "loc": ("n",), "msg": "", "input": "9"}])]
    ['expected a whole number']
    """
    expected: dict[Location, list[str]] = {}
    for number, item in enumerate(fitting(items)):
        path = tuple(part for part in item["loc"] if not _MEMBER.fullmatch(str(part)))
        kind, words = item["type"].replace("_parsing", "_type"), str(item["msg"]).removeprefix("Value error, ")
        if kind == "float_type" and isinstance(item["input"], dict) and "distribution" in item["input"]:
            yield path, f"expected a number; {_GONE['distribution']}"
        elif kind in _EXPECTED:
            expected.setdefault(path, []).append(_EXPECTED[kind].format(**item.get("ctx", {})))
        elif kind == "extra_forbidden":  # a suggestion takes long: for the listed ones alone
            yield path, _unknown_key(path, model if number < MAX_MISTAKES else None)
        elif kind == "string_pattern_mismatch":
            first, letters = (re.findall(r"\w-\w|.", part) for part in re.findall(r"\[(.*?)\]", item["ctx"]["pattern"]))
            yield path, f"expected a name of {' '.join(letters)}, a letter {'or digit ' if '0-9' in first else ''}first"
        elif kind == "value_error" and (of_key := re.fullmatch(r"([a-z_0-9.]+): (.*)", words, re.DOTALL)):
            yield (*path, *of_key[1].split(".")), of_key[2]
        else:
            yield path, "is missing" if kind == "missing" else words.replace("Input should be", "expected a value")
    for path, nouns in expected.items():
        yield path, f"expected {', or '.join(dict.fromkeys(nouns))}"


def _unknown_key(place: Location, model: type[BaseModel] | None) -> str:
    key, *above = [part for part in reversed(place) if isinstance(part, str)]
    if gone := _GONE.get(key) or _GONE.get(".".join([*above[:1], key])):
        return f"this key is gone; {gone}"
    schema = model.model_json_schema() if model else {}
    every = [k for each in (schema, *schema.get("$defs", {}).values()) for k in each.get("properties", {})]
    return "unknown key" + (" here; it belongs elsewhere" if key in every else did_you_mean(key, every))


def fitting(items: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """What models found wrong; where something may be one of several, as that which it is nearest to.

    >>> wrong = [{"type": "literal_error", "loc": ("mix", "literal['a']")}]
    >>> wrong += [{"type": "float_type", "loc": ("mix", "function-after[f(), M]", "a")}]
    >>> wrong += [{"type": "missing", "loc": ("mix", "function-after[f(), N]", key)} for key in "bc"]
    >>> [item["loc"][-1] for item in fitting(wrong)]
    ['a']
    """
    members, costs = list[Location](), Counter[Location]()
    for kind, place in ((item["type"], tuple(item["loc"])) for item in items):
        number = next((i for i, part in enumerate(place) if _MEMBER.fullmatch(str(part))), -1)
        members.append(place[: number + 1])
        is_of_kind = number < len(place) - 1 or not kind.endswith(("_type", "_parsing", "literal_error"))
        costs[members[-1]] += 9 if not is_of_kind else 2 if kind in ("missing", "extra_forbidden") else 1
    least = {member[:-1]: costs[member] for member in sorted(costs, key=costs.__getitem__, reverse=True)}
    return [i for i, m in zip(items, members, strict=True) if not m or costs[m] == least[m[:-1]]]


# What editors that know the language server of YAML read of a file's first line.
SCHEMA_LINE = "# yaml-language-server: $schema="


def schema_text(kind: str) -> str:
    """The JSON Schema of a kind of file, by which editors complete, explain and mark errors."""
    return installed_file("hyperval", "schemas", f"{kind}.json").read_text("utf-8")


def write_draft(path: Path, kind: str, text: str) -> None:
    """Write a draft where nothing stands, and beside it the schema that its first line names, which holds anywhere."""
    refuse(path.exists(), "file.exists", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path.with_name(f"{kind}.schema.json"), schema_text(kind))
    write_text(path, f"{SCHEMA_LINE}{kind}.schema.json\n{text}")


@reader
def load_model(model: type[M], path: Path) -> M:
    """Read ``path`` as strict YAML and validate it as ``model``."""
    data, lines = load_yaml(path, model)
    loaded = validate(model, data, lines, str(path))
    if isinstance(loaded, FileModel):
        loaded._folder = Path(path).resolve().parent
    return loaded
