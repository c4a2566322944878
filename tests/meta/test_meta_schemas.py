"""Published schemas are what the models read; every shipped file names its own and holds to it; mistakes are marked."""

import json
import re
import runpy
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import pytest
import yaml
from jsonschema import Draft202012Validator

from hyperval import cli
from hyperval.config import FILL_IN, SCHEMA_LINE, load_yaml

ROOT = Path(__file__).parents[2]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "schemas.py"))


def marked(path: Path, kind: str, data: object) -> list[str]:
    """What an editor marks in a file: by the schema that its first line names."""
    named = path.read_text("utf-8").partition("\n")[0].removeprefix(SCHEMA_LINE)
    schema = json.loads((path.parent / named).read_text("utf-8"))
    assert Path(named).name.partition(".")[0] == kind
    return [e.message for e in Draft202012Validator(schema).iter_errors(data) if FILL_IN not in str(e.instance)]


def test_published_schemas_are_as_the_models_have_them(capsys):
    assert SCRIPT["main"]() == 0, capsys.readouterr().out
    assert cli.run(["schema", "sensor"]) == 0
    Draft202012Validator.check_schema(schema := json.loads(capsys.readouterr().out))
    words = schema["$defs"]["RegularBands"]["properties"]["step_nm"]
    assert (words["title"], words["unit"], words["exclusiveMinimum"]) == ("step", "nm", 0)
    assert "(as in src/hyperval/sensor/library/" in words["description"]


@pytest.mark.parametrize(("path", "kind"), SCRIPT["shipped"]().items(), ids=lambda v: getattr(v, "stem", v))
def test_every_shipped_file_holds_to_the_schema_that_its_first_line_names(path, kind):
    assert marked(path, kind, load_yaml(path)[0]) == []


@pytest.mark.parametrize(
    ("file", "key", "value", "words"),
    [
        ("campaigns/hysu-2018/scenario.yaml", "scene.clases", [], "'clases' was unexpected"),
        ("src/hyperval/scenarios/panels.yaml", "processing.seed", -1, "-1 is less than the minimum of 0"),
        ("src/hyperval/scenarios/panels.yaml", "atmosphere.aot550", "0,1", "is not valid under any of the given"),
        ("studies/planks.yaml", "formulation", "better", "'better' is not one of ['corrected', 'thesis']"),
    ],
)
def test_a_mistake_is_marked(file, key, value, words):
    data = load_yaml(ROOT / file)[0]
    group, _, last = key.rpartition(".")
    (data[group] if group else data)[last] = value
    (message,) = marked(ROOT / file, "scenario", data)
    assert words in message


# A key that a file may have stands in a YAML file of the repository that uses it, or it goes.


SCHEMAS = {kind: SCRIPT["as_read"](kind) for kind in SCRIPT["KINDS"]}
# What is refused shows no use of a key.
FILES = [
    path
    for folder in ("campaigns", "studies", "src", "docs", "tests")
    for path in sorted((ROOT / folder).rglob("*.yaml"))
    if not re.search("refus|mistake|broken_campaigns", path.stem)
]


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


def parts(data: Any) -> Iterator[dict[str, Any]]:
    """Each key of every mapping in data with its value, a dotted path as keys below keys; and a path that is a text."""
    pairs = data.items() if isinstance(data, dict) else [(data, 0)] * (isinstance(data, str) and "." in data)
    for path, value in pairs:
        keys = re.findall(r"\[[^]]+\]|[^.]+", str(path))
        yield reduce(lambda inner, key: {key: inner}, reversed(keys), value)
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
