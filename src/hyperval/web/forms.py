"""Forms from a schema: each field with its unit, limits, default and hint; and the data of a filled form.

The JSON schema of a model is walked; nothing here knows what a scenario is.  A field that is left blank is left
out, so that the default of the schema stands.

What a JSON schema says of one field: its kind, unit and limits; and how values are written in it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import BaseModel

from hyperval.config import parse_yaml
from hyperval.errors import UsageError


def kind_of(schema: Mapping[str, Any]) -> str:
    """The kind of field that a schema asks for."""
    kind = schema.get("type")
    if "enum" in schema or "const" in schema:
        return "choice"
    if kind == "object":
        return "group" if "properties" in schema else "yaml"
    if kind == "array":
        items = schema.get("items", {})
        return "rows" if "$ref" in items else "yaml"
    return {"number": "number", "integer": "integer", "boolean": "flag"}.get(str(kind), "text")


def one_kind(kinds: list[str]) -> str:
    """One kind of field for several kinds of values."""
    if len(set(kinds)) == 1:
        return {"integer": "number"}.get(kinds[0], kinds[0])
    return "yaml" if set(kinds) & {"yaml", "rows"} else "text"


def text_of(value: Any) -> str:
    """A value as it stands in its field."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}" if float(f"{value:g}") == value else repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(text_of, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {text_of(v)}" for k, v in value.items()) + "}"
    return str(value)


def limits_of(schema: Mapping[str, Any]) -> str:
    """The limits of a number, in words."""
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


def summary_of(schema: Mapping[str, Any]) -> str:
    """The first paragraph of a description."""
    return str(schema.get("description", "")).split("\n\n", 1)[0].replace("\n", " ")


MOST_ROWS = 40
_MOST_MARKED = 5
_MOST_OPEN = 3  # rows that stand unfolded
_MOST_KEPT = 2000
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
BEGUN, ENTERED, DEFAULT = "begun", "entered", "default"
Choices = Callable[[str], tuple[str, ...]]  # of a path, where the schema leaves them open


@dataclass(frozen=True, eq=False)
class Node:
    """A part of a form; parts that hold the same are one object, so that what is drawn of it can be kept.

    Attributes
    ----------
    kind : number, text, flag, choice, several, yaml; group, rows, variants
    path, title : dotted path, and its last part in words
    source : where the value is from: what the form began with, somebody, or the model; empty without a value
    changes : values in it that are not those that the form began with
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
    changes: int = 0

    @property
    def gist(self) -> str:
        """What is given in a part that is folded, in a few words."""
        given = [f"{n.title} {', '.join(n.value) if n.kind == 'several' else n.value}" for n in self._given()]
        return "; ".join(given[:_MOST_MARKED]) + (" ..." if len(given) > _MOST_MARKED else "")

    @property
    def is_whole(self) -> bool:
        """Whether it is a section of the form whose rows are none of their own."""
        return self.kind == "group" and "." not in self.path and all(c.kind != "rows" for c in self.children)

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
        self._kept: dict[tuple[str, str], Node] = {}
        self._kept_members: dict[int, list[Mapping[str, Any]]] = {}

    def nodes(
        self,
        data: Mapping[str, Any] | None = None,
        begun: Mapping[str, Any] | None = None,
        more: Mapping[str, tuple[str, ...]] | None = None,
    ) -> tuple[Node, ...]:
        """The parts of the form, filled in with ``data``.

        Parameters
        ----------
        begun : data that the form began with
        more : entry -> names that may stand there besides
        """
        extra = more or {}
        return tuple(
            replace(n, choices=tuple(dict.fromkeys((*n.choices, *extra[n.path])))) if n.path in extra else n
            for n in self._group(self.schema, "", data or {}, begun or {})
        )

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
        members = self._kept_members.get(id(schema))
        if members is None:
            parts = self._resolved(schema)
            members = [m for part in parts.get("anyOf", [parts]) for m in self._expanded(part)]
            members = self._kept_members[id(schema)] = [m for m in members if m.get("type") != "null"]
        return members

    def _expanded(self, schema: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        resolved = self._resolved(schema)
        return [m for part in resolved["anyOf"] for m in self._expanded(part)] if "anyOf" in resolved else [resolved]

    def _group(self, schema: Mapping[str, Any], path: str, data: Any, begun: Any) -> tuple[Node, ...]:
        nodes = []
        data, begun = (one if isinstance(one, Mapping) else {} for one in (data, begun))
        for name, part in schema.get("properties", {}).items():
            own = f"{path}.{name}" if path else name
            if not self._left_out(own):
                is_needed = name in schema.get("required", ())
                value, first = data.get(name), begun.get(name)
                nodes.append(self._same((own, repr((value, first))), self._node, part, own, value, first, is_needed))
        return tuple(nodes)

    def _same(self, key: tuple[str, str], make: Callable[..., Node], /, *arguments: Any) -> Node:
        """The part of a form that was made before of the same; large ones, and those of rows, are worth it."""
        if key[0].count(".") > 2 and not key[0].rsplit(".", 1)[-1].isdigit():
            return make(*arguments)
        node = self._kept.get(key)
        if node is None:
            if len(self._kept) >= _MOST_KEPT:
                self._kept.clear()
            node = self._kept[key] = make(*arguments)
        return node

    def _node(self, schema: Mapping[str, Any], path: str, value: Any, begun: Any, is_needed: bool) -> Node:
        members = self._members(schema)
        title = schema["title"]
        hint = str(schema.get("description", "")).replace("null:", "blank:").replace("None:", "blank:")
        kinds = [kind_of(m) for m in members]
        if "group" in kinds and len(members) > 1:
            return self._variants(members, kinds, path, title, hint, value, begun)
        if kinds == ["group"]:
            children = self._group(members[0], path, value, begun)
            return Node(
                "group",
                path,
                title,
                hint or summary_of(members[0]),
                children=children,
                is_needed=is_needed,
                is_open=(bool(value) or is_needed) and self._is_open(path),
                is_shown=bool(value) or is_needed or any(c.is_shown for c in children),
                changes=sum(c.changes for c in children),
            )
        if kinds == ["rows"]:
            item = self._members(members[0]["items"])[0]
            rows, first = (one if isinstance(one, list | tuple) else [] for one in (value, begun))
            own = [(row, first[i] if i < len(first) else {}) for i, row in enumerate(rows[:MOST_ROWS])]
            is_few = len(own) <= _MOST_OPEN
            children = tuple(
                self._same((f"{path}.{i}", repr((pair, is_few))), self._row, item, f"{path}.{i}", *pair, is_few)
                for i, pair in enumerate(own)
            )
            is_shown = bool(rows) or is_needed or self._is_main(path)
            changes = sum(c.changes for c in children) + max(0, len(first) - len(own))
            return Node(
                "rows", path, title, hint,
                children=children, is_needed=is_needed, is_shown=is_shown, changes=changes,
            )  # fmt: skip
        return self._field(schema, members, kinds, path, title, hint, value, begun, is_needed)

    def _row(self, item: Mapping[str, Any], path: str, row: Any, begun: Any, is_few: bool) -> Node:
        given = row if isinstance(row, Mapping) else {}
        title = str(given.get("name") or int(path.rsplit(".", 1)[-1]) + 1)
        children = self._group(item, path, given, begun)
        is_open = (is_few and self._is_open(path)) or not given
        return Node("group", path, title, children=children, is_open=is_open, changes=sum(c.changes for c in children))

    def _field(
        self, schema: Mapping[str, Any], members: list[Mapping[str, Any]], kinds: list[str], path: str, title: str,
        hint: str, value: Any, begun: Any, is_needed: bool,
    ) -> Node:  # fmt: skip
        kind = one_kind(kinds)
        choices = tuple(str(c) for m in members for c in m.get("enum", [m["const"]] if "const" in m else []))
        known = self._choices(path)
        if known and kind in ("text", "yaml"):
            kind, choices = ("choice" if kind == "text" else "several"), known
        limits = next((words for m in members if (words := limits_of(m))), "")
        default = schema.get("default")
        shown = "" if default is None or isinstance(default, dict) else text_of(default)
        is_begun = value == begun or (_blank(value) and _blank(begun))
        if kind == "several":
            value = [str(v) for v in value] if isinstance(value, list | tuple) else []
        else:
            value = "" if value is None else text_of(value)
        source = (BEGUN if is_begun else ENTERED) if value else DEFAULT if shown else ""
        if kind == "choice" and value and value not in choices:
            choices = (*choices, value)
        return Node(
            kind,
            path,
            title,
            hint,
            schema.get("unit", ""),
            limits,
            shown,
            value,
            choices,
            is_needed,
            is_shown=is_needed or bool(value) or self._is_main(path),
            source=source,
            changes=int(not is_begun),
        )

    def _variants(
        self, members: list[Mapping[str, Any]], kinds: list[str], path: str, title: str, hint: str, value: Any,
        begun: Any,
    ) -> Node:  # fmt: skip
        children: list[Node] = []
        chosen, first = (_chosen(members, kinds, one) for one in (value, begun))
        for number, (member, kind) in enumerate(zip(members, kinds, strict=True), start=1):
            own, was = value if number == chosen else None, begun if number == first else None
            if kind == "group":
                inner = self._group(member, path, own, was)
                name = str(member.get("title", number))
                changes = sum(n.changes for n in inner)
                words = summary_of(member)
                children.append(Node("group", path, name, words, children=inner, is_open=True, changes=changes))
            else:
                children.append(self._field(member, [member], [kind], path, title, "", own, was, False))
        is_shown = chosen > 0 or self._is_main(path)
        changes = children[chosen - 1].changes if chosen else 0
        return Node(
            "variants", path, title, hint,
            children=tuple(children), chosen=chosen, is_shown=is_shown, changes=changes or int(chosen != first),
        )  # fmt: skip

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
        kinds = [kind_of(m) for m in members]
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
            rows = [self._read_group(item, f"{path}.{i}", given) for i in range(count) if f"{path}.{i}!" not in given]
            return rows if f"{path}#" in given else None
        values = [v.strip() for v in given.get(path, []) if v.strip()]
        if self._choices(path) and one_kind(kinds) == "yaml":
            return values or ([] if f"{path}#" in given else None)
        if not values:
            return None
        return _value(values[0], kinds, path)


def _blank(value: Any) -> bool:
    """Whether nothing is said: a form cannot tell it from a field that is left alone."""
    return value is None or (isinstance(value, str | list | tuple | Mapping) and not value)


def _chosen(members: list[Mapping[str, Any]], kinds: list[str], value: Any) -> int:
    """Number of the first member that a value may be one of, from 1; 0 where there is none."""
    if value is None:
        return 0
    for number, (member, kind) in enumerate(zip(members, kinds, strict=True), start=1):
        fits = isinstance(value, Mapping) == (kind == "group")
        if fits and (kind != "group" or set(value) <= set(member.get("properties", ()))):
            return number
    return 0


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
