"""Forms from a schema: each field with its unit, limits, default and hint; and the data of a filled form.

The JSON schema of a model is walked; nothing here knows what a scenario is.  A field that is left blank is left
out, so that the default of the schema stands.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel

from hyperval.config import parse_yaml
from hyperval.errors import UsageError

MOST_ROWS = 40
_MOST_MARKED = 5
_UNIT = re.compile(r"\[([^\]\[]{1,24})\]")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_UNITS = {
    "_deg": "deg", "_km": "km", "_nm": "nm", "_m": "m", "_percent": "%", "_au": "au", "_g_cm2": "g cm-2",
    "_atm_cm": "atm cm", "_pixels": "pixels",
}  # fmt: skip
Choices = Callable[[str], tuple[str, ...]]  # of a path, where the schema leaves them open


@dataclass(frozen=True)
class Node:
    """A part of a form.

    Attributes
    ----------
    kind : number, text, flag, choice, several, yaml; group, rows, variants
    path, title : dotted path, and its last part in words
    source : where the value is from
    is_shown : whether it stands before the fold: a value is given, needed, or asked of most people
    is_open : of a part that has something in it, whether that is seen at once
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
    children: tuple[Node, ...] = ()
    is_open: bool = False
    chosen: int = 0
    is_shown: bool = True
    source: str = ""

    @property
    def gist(self) -> str:
        """What is given in a part that is folded, in a few words."""
        given = [f"{n.title} {', '.join(n.value) if n.kind == 'several' else n.value}" for n in self._given()]
        return "; ".join(given[:_MOST_MARKED]) + (" ..." if len(given) > _MOST_MARKED else "")

    def _given(self) -> Iterator[Node]:
        if self.kind == "variants":
            yield from self.children[self.chosen - 1]._given() if self.chosen else ()
        elif self.children:
            for child in self.children:
                yield from child._given()
        elif self.value and not self.path.endswith(".name"):
            yield self


class Form:
    """The form of a model.

    Parameters
    ----------
    choices : names that may stand at a path, where the schema leaves them open; empty: anything
    left_out : whether a path is no part of the form
    is_main : whether a field that nothing stands in is shown before the fold
    is_open : whether a part that something stands in is unfolded
    """

    def __init__(
        self,
        model: type[BaseModel],
        choices: Choices = lambda path: (),
        left_out: Callable[[str], bool] = lambda path: False,
        is_main: Callable[[str], bool] = lambda path: False,
        is_open: Callable[[str], bool] = lambda path: True,
    ):
        self.schema = model.model_json_schema(by_alias=True)
        self._definitions = self.schema.get("$defs", {})
        self._choices, self._left_out, self._is_main, self._is_open = choices, left_out, is_main, is_open

    def nodes(
        self,
        data: Mapping[str, Any] | None = None,
        source: tuple[str, Mapping[str, Any]] = ("", {}),
        more: Mapping[str, tuple[str, ...]] | None = None,
    ) -> tuple[Node, ...]:
        """The parts of the form, filled in with ``data``.

        Parameters
        ----------
        source : where values are from, and those that are; others were entered
        more : path -> names that may stand there besides
        """
        words, known = source
        values = {n.path: n.value for node in self._group(self.schema, "", known) for n in _leaves(node)}
        nodes = self._group(self.schema, "", data or {})
        return tuple(_finished(node, words, values, more or {}) for node in nodes)

    def data(self, given: Mapping[str, list[str]]) -> dict[str, Any]:
        """The nested data of a form as it was sent: name of a field -> what stands in it.

        Raises
        ------
        UsageError : a field of lists that is not of their form; ``where`` is its path.
        """
        return self._read_group(self.schema, "", given) or {}

    # From schema and data to a form.

    def _resolved(self, schema: Mapping[str, Any]) -> Mapping[str, Any]:
        if "$ref" in schema:
            named = self._definitions[schema["$ref"].rsplit("/", 1)[-1]]
            return {**named, **{k: v for k, v in schema.items() if k != "$ref"}}
        return schema

    def _members(self, schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """What may stand there, ``null`` left out."""
        schema = self._resolved(schema)
        members = [m for part in schema.get("anyOf", [schema]) for m in self._expanded(part)]
        return [m for m in members if m.get("type") != "null"]

    def _expanded(self, schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        resolved = self._resolved(schema)
        return (
            [m for part in resolved["anyOf"] for m in self._expanded(part)] if "anyOf" in resolved else [resolved]
        )

    def _group(self, schema: Mapping[str, Any], path: str, data: Mapping[str, Any]) -> tuple[Node, ...]:
        nodes = []
        for name, part in schema.get("properties", {}).items():
            own = f"{path}.{name}" if path else name
            if not self._left_out(own):
                nodes.append(self._node(part, own, data.get(name), name in schema.get("required", ())))
        return tuple(nodes)

    def _node(self, schema: Mapping[str, Any], path: str, value: Any, is_needed: bool) -> Node:
        members = self._members(schema)
        name = path.rsplit(".", 1)[-1]
        ending = _ending(name)
        title = name[: len(name) - len(ending)].replace("_", " ")
        hint = str(schema.get("description", "")).replace("null:", "blank:").replace("None:", "blank:")
        kinds = [_kind(m) for m in members]
        if "group" in kinds and len(members) > 1:
            return self._variants(members, kinds, path, title, hint, value)
        if kinds == ["group"]:
            given = value if isinstance(value, Mapping) else {}
            children = self._group(members[0], path, given)
            return Node(
                "group",
                path,
                title,
                hint or _summary(members[0]),
                children=children,
                is_needed=is_needed,
                is_open=(bool(given) or is_needed) and self._is_open(path),
                is_shown=bool(given) or is_needed or any(c.is_shown for c in children),
            )
        if kinds == ["rows"]:
            item = self._members(members[0]["items"])[0]
            rows = value if isinstance(value, list | tuple) else []
            children = tuple(self._row(item, f"{path}.{i}", row, i) for i, row in enumerate(rows[:MOST_ROWS]))
            is_shown = bool(rows) or is_needed or self._is_main(path)
            return Node("rows", path, title, hint, children=children, is_needed=is_needed, is_shown=is_shown)
        return self._field(schema, members, kinds, path, title, hint, value, is_needed)

    def _row(self, item: Mapping[str, Any], path: str, row: Any, number: int) -> Node:
        given = row if isinstance(row, Mapping) else {}
        title = str(given.get("name") or number + 1)
        is_open = self._is_open(path) or not given
        return Node("group", path, title, children=self._group(item, path, given), is_open=is_open)

    def _field(
        self, schema: Mapping[str, Any], members: list[Mapping[str, Any]], kinds: list[str], path: str, title: str,
        hint: str, value: Any, is_needed: bool,
    ) -> Node:  # fmt: skip
        kind = _together(kinds)
        choices = tuple(str(c) for m in members for c in m.get("enum", [m["const"]] if "const" in m else []))
        known = self._choices(path)
        if known and kind in ("text", "yaml"):
            kind, choices = ("choice" if kind == "text" else "several"), known
        unit = next(iter(_UNIT.findall(hint)), _unit_of(path))
        limits = next((words for m in members if (words := _limits(m))), "")
        default = schema.get("default")
        shown = "" if default is None or isinstance(default, dict) else _text(default)
        if kind == "several":
            value = [str(v) for v in value] if isinstance(value, list | tuple) else []
        else:
            value = "" if value is None else _text(value)
        if kind == "choice" and value and value not in choices:
            choices = (*choices, value)
        return Node(
            kind,
            path,
            title,
            _UNIT.sub("", hint).replace(" ,", ",").replace(" ;", ";").strip(),
            unit,
            limits,
            shown,
            value,
            choices,
            is_needed,
            is_shown=is_needed or bool(value) or self._is_main(path),
        )

    def _variants(
        self, members: list[Mapping[str, Any]], kinds: list[str], path: str, title: str, hint: str, value: Any
    ) -> Node:
        children, chosen = [], 0
        for number, (member, kind) in enumerate(zip(members, kinds, strict=True), start=1):
            fits = isinstance(value, Mapping) == (kind == "group") and value is not None
            fits = fits and (kind != "group" or set(value) <= set(member.get("properties", ())))
            chosen = number if fits and not chosen else chosen
            own = value if fits else None
            if kind == "group":
                inner = self._group(member, path, own or {})
                children.append(
                    Node(
                        "group",
                        path,
                        str(member.get("title", number)),
                        _summary(member),
                        children=inner,
                        is_open=True,
                    )
                )
            else:
                field = self._field(member, [member], [kind], path, title, "", own, False)
                children.append(field)
        is_shown = chosen > 0 or self._is_main(path)
        return Node("variants", path, title, hint, children=tuple(children), chosen=chosen, is_shown=is_shown)

    # From a filled form to data.

    def _read_group(self, schema: Mapping[str, Any], path: str, given: Mapping[str, list[str]]) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for name, part in schema.get("properties", {}).items():
            own = f"{path}.{name}" if path else name
            if self._left_out(own):
                continue
            value = self._read(self._members(part), own, given)
            if value is not None:
                data[name] = value
        return data

    def _read(self, members: list[Mapping[str, Any]], path: str, given: Mapping[str, list[str]]) -> Any:
        kinds = [_kind(m) for m in members]
        if "group" in kinds and len(members) > 1:
            number = _count(given, f"{path}?", len(members))
            if not number:
                return None
            members, kinds = [members[number - 1]], [kinds[number - 1]]
            if kinds == ["group"]:
                return self._read_group(members[0], path, given)
        if kinds == ["group"]:
            return self._read_group(members[0], path, given) or None
        if kinds == ["rows"]:
            count = _count(given, f"{path}#", MOST_ROWS)
            item = self._members(members[0]["items"])[0]
            rows = [
                self._read_group(item, f"{path}.{i}", given) for i in range(count) if f"{path}.{i}!" not in given
            ]
            return rows if f"{path}#" in given else None
        values = [v.strip() for v in given.get(path, []) if v.strip()]
        if self._choices(path) and _together(kinds) == "yaml":
            return values or ([] if f"{path}#" in given else None)
        if not values:
            return None
        return _value(values[0], kinds, path)


def _leaves(node: Node) -> Iterator[Node]:
    if not node.children:
        yield node
    for child in node.children:
        yield from _leaves(child)


def _finished(node: Node, source: str, values: Mapping[str, Any], more: Mapping[str, tuple[str, ...]]) -> Node:
    """A part with the source of its value, and with the names that may stand there besides."""
    if node.children:
        return replace(node, children=tuple(_finished(child, source, values, more) for child in node.children))
    if node.value:
        source = source if node.value == values.get(node.path) else "entered"
    else:
        source = "default of the model" if node.default else ""
    extra = tuple(name for name in more.get(node.path, ()) if name not in node.choices)
    return replace(node, source=source, choices=(*node.choices, *extra))


def _kind(schema: Mapping[str, Any]) -> str:
    kind = schema.get("type")
    if "enum" in schema or "const" in schema:
        return "choice"
    if kind == "object":
        return "group" if "properties" in schema else "yaml"
    if kind == "array":
        items = schema.get("items", {})
        return "rows" if "$ref" in items else "yaml"
    return {"number": "number", "integer": "integer", "boolean": "flag"}.get(str(kind), "text")


def _together(kinds: list[str]) -> str:
    """One kind of field for several kinds of values."""
    if len(set(kinds)) == 1:
        return {"integer": "number"}.get(kinds[0], kinds[0])
    return "yaml" if set(kinds) & {"yaml", "rows"} else "text"


def _value(text: str, kinds: list[str], path: str) -> Any:
    if "yaml" in kinds:
        try:
            return parse_yaml(text, path)[0]
        except UsageError as error:
            raise UsageError(error.what, where=path, expected="a list such as [1, 2] or {key: value}") from error
    if set(kinds) & {"number", "integer"} and _NUMBER.fullmatch(text):
        number = float(text)
        return int(text) if text.lstrip("+-").isdigit() and len(text) < 18 else number
    if "flag" in kinds and text in ("true", "false"):
        return text == "true"
    return text


def _count(given: Mapping[str, list[str]], name: str, most: int) -> int:
    text = given.get(name, ["0"])[0]
    return min(int(text), most) if text.isdecimal() and len(text) < 6 else 0


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_text, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_text(v)}" for k, v in value.items()) + "}"
    return str(value)


def _limits(schema: Mapping[str, Any]) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f"{low:g} to {high:g}"
    words = [
        f"{word} {value:g}"
        for word, value in (("at least", low), ("above", above), ("at most", high), ("below", below))
        if value is not None
    ]
    return ", ".join(words)


def _summary(schema: Mapping[str, Any]) -> str:
    return str(schema.get("description", "")).split("\n\n", 1)[0].replace("\n", " ")


def _unit_of(path: str) -> str:
    """The unit that the name of a number ends with."""
    return _UNITS.get(_ending(path), "")


def _ending(name: str) -> str:
    return next((end for end in sorted(_UNITS, key=len, reverse=True) if name.endswith(end)), "")
