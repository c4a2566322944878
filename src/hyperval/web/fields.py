"""What a JSON schema says of one field: its kind, unit and limits; and how values are written in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

_UNIT = re.compile(r"\[([^\]\[]{1,24})\]")
_UNITS = {
    "_deg": "deg", "_km": "km", "_nm": "nm", "_m": "m", "_percent": "%", "_au": "au", "_g_cm2": "g cm-2",
    "_atm_cm": "atm cm", "_pixels": "pixels",
}  # fmt: skip
_ENDINGS = tuple(sorted(_UNITS, key=len, reverse=True))


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


def unit_of(hint: str, path: str) -> str:
    """The unit that a hint states in brackets, or that the name of a number ends with."""
    return next(iter(_UNIT.findall(hint)), _UNITS.get(ending_of(path), ""))


def without_unit(hint: str) -> str:
    """A hint without the brackets of its unit."""
    return _UNIT.sub("", hint).replace(" ,", ",").replace(" ;", ";").strip()


def ending_of(name: str) -> str:
    """The end of a name that states a unit; empty where there is none."""
    return next((end for end in _ENDINGS if name.endswith(end)), "")
