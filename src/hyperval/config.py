"""Configuration files: strict YAML into frozen pydantic models, errors with file and line."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, model_validator
from yaml.composer import Composer
from yaml.cyaml import CParser
from yaml.resolver import Resolver

from hyperval.errors import UsageError, needed, reader, refusal, refuse
from hyperval.storage import content_of, installed_file, write_text
from hyperval.units import to_internal

MAX_BYTES = 1 << 20
MAX_DEPTH = 32
_MAX_DIGITS = 300  # a number of more is none that a calculation can hold
MAX_NODES = 40_000  # keys and values
MOST_MISTAKES = 20  # that are listed
# A value that begins so is one that the user has still to give: "FILL_IN: what it is".
FILL_IN = "FILL_IN"
# Keys of the version before that are gone, for one version: what stands in their place.
GONE = {
    "surroundings_altitude_km": "surroundings are as high as the site: ground_altitude_km",
    **dict.fromkeys(("filter_statistics", "scene_fraction"), "filters are made on the background alone: leave it out"),
    "nugget": "an error of its own in each band is an entry of its own with 'correlation: random'",
    "lags": "correlation_nm, the length over which the measured correlations fall off",
    "groups_nm": "correlation_nm, or 'correlation: arms' for the arms of the sensor",
    "distribution": "errors are normal: the standard uncertainty alone; of a uniform error, its half width over root 3",
    "totals": "each input has its own share of the variance: leave it out",
    "precision": "covariances are always summed in float64, as 'exact' did: leave it out",
}


# The unit that the end of a number's name says; longer ends first.
UNITS = {
    "_g_cm2": "g cm-2", "_atm_cm": "atm cm", "_percent": "%", "_pixels": "pixels", "cm2_sr": "cm2 sr", "_mrad": "mrad",
    "_deg": "deg", "_km": "km", "_nm": "nm", "_um": "um", "_au": "au", "_m": "m", "_s": "s", "_electrons": "electrons",
}  # fmt: skip
_BRACKETS = re.compile(r" ?\[([^\]\[]{1,24})\]")


def _told(schema: dict[str, Any], model: type[BaseModel]) -> None:
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


# Words -> whether the entries of a model contradict each other so; a list holds what stands in the words where they do.
Refused = Mapping[str, Callable[[Any], object]]


def twice(names: Iterable[Any]) -> list[Any]:
    """What stands more than once, in order."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def unknown(names: Iterable[str], known: Iterable[str]) -> list[Any]:
    """The first name that is not known and, in words, those that are; nothing where all are known."""
    listed = list(known)
    return next(([name, ", ".join(listed)] for name in names if name not in listed), [])


class Model(BaseModel):
    """Base of every configuration model: unknown keys, NaN and infinity are refused, and what contradicts itself."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, json_schema_extra=_told)
    refused: ClassVar[Refused] = {}

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
    """Refuses an unknown unit when the file is read, so that a dry run tells and the line is known."""

    def known(unit: str) -> str:
        try:
            to_internal(unit, quantity)
        except UsageError as error:
            raise ValueError(f"{error.what}; {error.expected}") from None
        return unit

    return AfterValidator(known)


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


# Kind of a scalar -> what it looks like, the letters that it begins with, and the value of its text.
_SCALARS: dict[str, tuple[str, str, Callable[[str], Any]]] = {
    "bool": (r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF", lambda text: text.lower() == "true"),
    "int": (r"^[-+]?(?:0|[1-9][0-9]*)$", "-+0123456789", int),
    "float": (
        r"^[-+]?(?:(?:\.[0-9]+|(?:0|[1-9][0-9]*)\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[1-9][0-9]*[eE][-+]?[0-9]+)$|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$",
        "-+.0123456789", lambda text: float(text.lower().replace(".inf", "inf").replace(".nan", "nan")),
    ),
    "null": (r"^(?:~|null|Null|NULL|)$", "~nN\0", lambda text: None),
}  # fmt: skip
_Loader.yaml_implicit_resolvers = {}
for _kind, (_pattern, _first, _) in _SCALARS.items():
    _letters = [*_first, *([""] if _kind == "null" else [])]
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(_pattern), _letters)


def shipped(package: str, folder: str) -> dict[str, Path]:
    """Name -> YAML file of all that ship in a folder of a package."""
    return {path.stem: path for path in sorted(installed_file(package, folder).glob("*.yaml"))}


def file_of(name_or_path: str | Path, known: Mapping[str, Path], kind: str) -> Path:
    """The file of what goes by its name or by its path; UsageError where it is neither.

    >>> file_of("place/casi-150", {"casi-1500": Path("casi-1500.yaml")}, "sensor")
    Traceback (most recent call last):
    hyperval.errors.UsageError: unknown sensor 'place/casi-150'; did you mean 'casi-1500'?
      expected: a YAML file or one of casi-1500
    """
    path = known.get(str(name_or_path), Path(name_or_path))
    if path.suffix not in (".yaml", ".yml") and not path.exists():
        hints = "".join(f"; did you mean {near!r}?" for near in difflib.get_close_matches(path.name, known, n=1))
        raise UsageError(f"unknown {kind} {str(path)!r}{hints}", expected="a YAML file or one of " + ", ".join(known))
    return path


@reader
def load_yaml(path: Path) -> tuple[Any, dict[Location, int]]:
    """Read a YAML file strictly.

    Returns the plain data and the line number (1-based) of every key and list item.

    Raises
    ------
    InputError : no such file, or it cannot be read.
    UsageError : not UTF-8, too large, too deep, duplicate keys, anchors, tags, or a syntax error.
    """
    path = Path(path)
    refuse(path.is_dir(), "file.folder", path, file=min(path.glob("*.y*ml"), default=path / "FILE.yaml"))
    content = content_of(path, ("file.none", "file.large"), most=MAX_BYTES)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UsageError("not UTF-8 text", where=str(path), expected="a YAML file in UTF-8") from error
    data, lines = parse_yaml(text, str(path))
    refuse(not isinstance(data, dict), "yaml.keys", f"{path}:1")
    return data, lines


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


def _construct(node: yaml.Node, at: Location, lines: dict[Location, int], name: str) -> Any:
    lines.setdefault(at, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            refuse(not isinstance(key_node, yaml.ScalarNode), "yaml.plain", f"{name}:{line}")
            key = str(key_node.value)
            if key in out:
                raise refusal("yaml.twice", f"{name}:{line}", key=key, first=lines[(*at, key)])
            lines[(*at, key)] = line
            out[key] = _construct(value_node, (*at, key), lines, name)
        return out
    if isinstance(node, yaml.SequenceNode):
        return [_construct(item, (*at, i), lines, name) for i, item in enumerate(node.value)]
    kind = node.tag.rpartition(":")[2]
    if kind == "int" and len(node.value) > _MAX_DIGITS:
        raise UsageError(f"a number of {len(node.value)} digits", where=f"{name}:{node.start_mark.line + 1}")
    return _SCALARS[kind][2](node.value) if kind in _SCALARS else node.value


def texts_of(data: Any, at: Location = ()) -> Iterator[tuple[Location, str]]:
    """Every text of plain data, in the order of the file, and where it stands."""
    if isinstance(data, str):
        yield at, data
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from texts_of(value, (*at, key))


def placeholders(data: Any, lines: dict[Location, int], name: str) -> list[Placeholder]:
    """Every value of ``data`` that is marked ``FILL_IN``, in the order of the file."""
    marked = [(at, text.removeprefix(FILL_IN)) for at, text in texts_of(data) if text.startswith(FILL_IN)]
    where = {at: f"{name}:{lines.get(at, 1)}" for at, _ in marked}
    return [Placeholder(".".join(map(str, at)), where[at], text.lstrip(": ") or "a value") for at, text in marked]


def unfilled(entries: list[Placeholder]) -> UsageError:
    """The error that names every value to be filled in."""
    listed = [f"{p.where}: {p.key}: {p.what}" for p in entries]
    return UsageError("\n  ".join([f"{len(entries)} values are still to be filled in", *listed]))


def validate(model: type[M], data: Any, lines: dict[Location, int], name: str) -> M:
    """Turn plain data into ``model``; every mistake is listed with its file and line at once.

    >>> class Ends(Model):
    ...     low: float
    ...     refused: ClassVar = {"low is 0 or more": lambda ends: ends.low < 0.0}
    >>> validate(Ends, {"low": -1.0}, {}, "a.yaml")
    Traceback (most recent call last):
    hyperval.errors.UsageError: a.yaml:1: low is 0 or more
    """
    to_fill_in = placeholders(data, lines, name)
    if to_fill_in:
        raise unfilled(to_fill_in)
    try:
        return model.model_validate(data)
    except ValidationError as error:
        problems: list[tuple[int, str]] = []
        for item in error.errors(include_url=False):
            # Locations of unions carry the name of the tried member, which is no key of the file.
            at: Location = ()
            for part in item["loc"]:
                if (*at, part) in lines:
                    at = (*at, part)
            line = lines.get(at, 1)
            key = ".".join(str(p) for p in item["loc"] if not str(p).endswith(("]", ")")))
            if item["type"] == "string_type" and item["loc"][-1] == "str" and isinstance(item["input"], dict):
                continue  # a name or the thing itself: it is the thing, and the rest tells its mistake
            text = item["msg"].removeprefix("Value error, ")
            if item["type"] == "string_pattern_mismatch":
                text = spelled(item["ctx"]["pattern"]) or text
            if item["type"] == "float_type" and isinstance(item["input"], dict) and "distribution" in item["input"]:
                text = f"a number; {GONE['distribution']}"
            if item["type"] == "extra_forbidden":
                few = len(problems) < MOST_MISTAKES  # what is looked for takes long beside what is listed
                own = str(item["loc"][-1])
                near = difflib.get_close_matches(own, _keys_of(model), n=1) if few else []
                hints = (" here; it belongs elsewhere" if k == own else f"; did you mean {k!r}?" for k in near)
                text = f"this key is gone; {GONE[own]}" if own in GONE else "".join(("unknown key", *hints))
            problems.append((line, ": ".join(filter(None, (f"{name}:{line}", key, text)))))
        problems.sort()
        if not problems:
            raise UsageError(f"{name}: {error}") from error
        first, *rest = [text for _, text in problems[:MOST_MISTAKES]]
        if len(problems) > MOST_MISTAKES:
            rest.append(f"and {len(problems) - MOST_MISTAKES} more")
        raise UsageError("\n  ".join([first, *rest])) from error


def spelled(pattern: str) -> str:
    """What a pattern of names allows, in words; empty for another pattern."""
    allowed = {
        "a-z0-9-": "small letters, digits and hyphens, a letter or digit first",
        "A-Za-z0-9_.-": "letters, digits and _ . -, a letter or digit first",
    }
    patterns = re.findall(r"\[([^\]]*)\]\*\$$", pattern)
    return f"a name of {allowed[patterns[0]]}" if patterns and patterns[0] in allowed else ""


# What editors that know the language server of YAML read of a file's first line.
SCHEMA_LINE = "# yaml-language-server: $schema="


def schema_text(kind: str) -> str:
    """The JSON Schema of a kind of file, by which editors complete, explain and mark errors."""
    return installed_file("hyperval", "schemas", f"{kind}.json").read_text("utf-8")


def unwritten(path: Path) -> Path:
    """The path of a draft; UsageError where something stands there."""
    refuse(path.exists(), "file.exists", str(path))
    return path


def write_draft(path: Path, kind: str, text: str) -> None:
    """Write the draft of a file and, beside it, the schema that its first line names: a path that holds anywhere."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path.with_name(f"{kind}.schema.json"), schema_text(kind))
    write_text(path, f"{SCHEMA_LINE}{kind}.schema.json\n{text}")


@reader
def load_model(model: type[M], path: Path) -> M:
    """Read ``path`` as strict YAML and validate it as ``model``."""
    data, lines = load_yaml(path)
    loaded = validate(model, data, lines, str(path))
    if isinstance(loaded, FileModel):
        loaded._folder = Path(path).resolve().parent
    return loaded


def _keys_of(model: type[BaseModel]) -> list[str]:
    """Every key that occurs in ``model`` or in the models it holds: candidates for "did you mean"."""
    schema = model.model_json_schema()
    return [key for each in (schema, *schema.get("$defs", {}).values()) for key in each.get("properties", {})]
