"""A key that a file may have stands in a YAML file of the repository that uses it, or it goes."""

import re
import runpy
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
SCHEMAS = {k: m.model_json_schema() for k, m in runpy.run_path(str(ROOT / "scripts" / "schemas.py"))["KINDS"].items()}
# What is refused shows no use of it.
FILES = [
    path
    for folder in ("campaigns", "studies", "src", "docs", "tests")
    for path in sorted((ROOT / folder).rglob("*.yaml"))
    if not re.search("refus|mistake|broken_campaigns", path.stem)
]
A_PATH = re.compile(r"[a-z0-9_]+(\.(\[[^]]+\]|[\w* -]+))+")


def used(schema: dict[str, Any], part: Any, data: Any, owner: str) -> Iterator[tuple[str, str]]:
    """The keys that data have, each with the model that it is of; an item of a list may go by its name."""
    if not isinstance(part, dict) or not isinstance(data, dict | list):
        return
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        yield from used(schema, schema["$defs"][name], data, name)
    for member in part.get("anyOf", part.get("oneOf", ())):
        yield from used(schema, member, data, owner)
    fields, items = part.get("properties", {}), part.get("items")
    if isinstance(data, list) or items:
        for item in data if isinstance(data, list) else data.values():
            yield from used(schema, items, item, owner)
    elif not fields or data.keys() <= fields.keys():
        for key, value in data.items():
            if key in fields:
                yield owner, key
            yield from used(schema, fields.get(key) or part.get("additionalProperties"), value, owner)


def parts(data: Any) -> Iterator[dict[str, Any]]:
    """Every mapping in data, dotted paths among its keys as keys below keys; and a path that stands as a text."""
    if isinstance(data, dict):
        yield reduce(joined, (nested(str(key), value) for key, value in data.items()), {})
    elif isinstance(data, str) and A_PATH.fullmatch(data):
        yield nested(data, 0)
    for item in data.values() if isinstance(data, dict) else data if isinstance(data, list) else ():
        yield from parts(item)


def nested(path: str, value: Any) -> dict[str, Any]:
    keys = re.findall(r"\[[^]]+\]|[^.]+", path) if A_PATH.fullmatch(path) else [path]
    return {keys[0]: reduce(lambda inner, key: {key: inner}, reversed(keys[1:]), value)}


def joined(a: Any, b: Any) -> Any:
    both = isinstance(a, dict) and isinstance(b, dict)
    return {**a, **{k: joined(a[k], v) if k in a else v for k, v in b.items()}} if both else b


def test_each_key_of_a_file_stands_in_a_file_that_uses_it():
    found = {
        (kind, *use)
        for path in FILES
        for part in parts(yaml.safe_load(path.read_text("utf-8")))
        for kind, schema in SCHEMAS.items()
        if part.keys() <= {*schema["properties"], "runs"}
        for use in used(schema, schema, part, schema["title"])
    }
    every = {
        (kind, owner, key)
        for kind, schema in SCHEMAS.items()
        for owner, part in {**schema["$defs"], schema["title"]: schema}.items()
        for key in part.get("properties", {})
    }
    owned = {use[1:] for use in found}
    assert sorted({use[1:] for use in every} - owned) == []
