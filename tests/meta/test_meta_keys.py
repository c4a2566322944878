"""A key that a file may have stands in a YAML file of the repository that uses it, or it goes."""

import re
import runpy
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "schemas.py"))
SCHEMAS = {kind: SCRIPT["as_read"](kind) for kind in SCRIPT["KINDS"]}
# What is refused shows no use of a key.
FILES = [
    path
    for folder in ("campaigns", "studies", "src", "docs", "tests")
    for path in sorted((ROOT / folder).rglob("*.yaml"))
    if not re.search("refus|mistake|broken_campaigns", path.stem)
]
PATH = re.compile(r"[a-z0-9_]+(\.(\[[^]]+\]|[\w* -]+))+")


def used(schema: dict[str, Any], part: Any, data: Any, owner: str) -> Iterator[tuple[str, str]]:
    """The keys that data have, each with the model that it is of; an item of a list may go by its name."""
    if not part or not isinstance(data, dict | list):
        return
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        yield from used(schema, schema["$defs"][name], data, name)
    for member in part.get("anyOf", part.get("oneOf", ())):
        yield from used(schema, member, data, owner)
    fields = part.get("properties", {})
    if fields and isinstance(data, dict):
        for key in data.keys() & fields.keys() if owner == schema["title"] or data.keys() <= fields.keys() else ():
            yield owner, key
            yield from used(schema, fields[key], data[key], owner)
    else:
        inner = part.get("items" if part.get("type") == "array" else "additionalProperties")
        for value in data.values() if isinstance(data, dict) else data:
            yield from used(schema, isinstance(inner, dict) and inner, value, owner)


def nested(path: str, value: Any) -> Any:
    keys = re.findall(r"\[[^]]+\]|[^.]+", path) if PATH.fullmatch(path) else [path]
    return reduce(lambda inner, key: {key: inner}, reversed(keys), value)


def joined(a: Any, b: Any) -> Any:
    both = isinstance(a, dict) and isinstance(b, dict)
    return {**a, **{key: joined(a.get(key), value) for key, value in b.items()}} if both else b


def parts(data: Any) -> Iterator[dict[str, Any]]:
    """Every mapping in data, dotted paths among its keys as keys below keys; and a path that stands as a text."""
    if isinstance(data, dict):
        yield reduce(joined, (nested(str(key), value) for key, value in data.items()), {})
    elif isinstance(data, str) and PATH.fullmatch(data):
        yield nested(data, 0)
    for item in data.values() if isinstance(data, dict) else data if isinstance(data, list) else ():
        yield from parts(item)


def test_each_key_of_a_file_stands_in_a_file_that_uses_it():
    every = {
        (owner, key)
        for schema in SCHEMAS.values()
        for owner, part in {**schema["$defs"], schema["title"]: schema}.items()
        for key in part.get("properties", {})
    }
    found = {
        use
        for path in FILES
        for part in parts(yaml.safe_load(path.read_text("utf-8")))
        for schema in SCHEMAS.values()
        for use in used(schema, schema, part, schema["title"])
    }
    assert sorted(every - found) == []
