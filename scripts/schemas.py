"""Write src/hyperval/schemas/KIND.json: the JSON Schema of each kind of file, from the models that read them.

python scripts/schemas.py            say which differ from what the models say
python scripts/schemas.py --write    write them
python scripts/schemas.py --unused   the keys that no YAML file of the repository uses

Each field says its unit, and the shipped file that shows it.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft202012Validator
from pydantic import BaseModel

from hyperval.campaign import Campaign
from hyperval.config import SCHEMA_LINE, load_yaml
from hyperval.scenario import Scenario
from hyperval.sensor import SensorSpecification
from hyperval.simulate.schema import SceneFile
from hyperval.study import StudyFile

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "src" / "hyperval" / "schemas"
KINDS: dict[str, type[BaseModel]] = {
    "campaign": Campaign,
    "scenario": Scenario,
    "scene": SceneFile,
    "study": StudyFile,
    "sensor": SensorSpecification,
}
SHIPPED = ("campaigns/*/*.yaml", "studies/*.yaml", "src/hyperval/**/scenarios/*.yaml", "src/hyperval/sensor/library/*")
# A value of one of several runs, or of a half hour of a day: a word in braces.
WORD = r"\{\w+\}"
REFUSED = re.compile("refus|mistake|broken_campaigns")  # in the names of files that hold mistakes
RUNS = {
    "description": "words in braces, such as {line}, and the text of each in every run of this file",
    "items": {"additionalProperties": {"type": "string"}, "type": "object"},
    "title": "runs",
    "type": "array",
}


def shipped() -> dict[Path, str]:
    """Each shipped file, and the kind that its first line says it is of."""
    files = [path for pattern in SHIPPED for path in sorted(ROOT.glob(pattern))]
    return {path: Path(path.read_text("utf-8").partition("\n")[0].removeprefix(SCHEMA_LINE)).stem for path in files}


def with_words(schema: Any) -> None:
    """Let a word in braces stand for a number or in a name."""
    if isinstance(schema, list):
        for part in schema:
            with_words(part)
    elif isinstance(schema, dict):
        if schema.get("type") in ("number", "integer"):
            schema |= {"type": [schema["type"], "string"], "pattern": WORD}
        elif schema.get("type") == "string" and "pattern" in schema:
            schema["pattern"] += "|" + WORD
        for part in schema.values():
            with_words(part)


def fields(schema: dict[str, Any], part: Any, data: Any, owner: str) -> Iterator[tuple[str, str]]:
    """The fields that data have something in: the model that each is of, and its name."""
    if not isinstance(part, dict):  # anything may stand there
        return
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        yield from fields(schema, schema["$defs"][name], data, name)
    for member in part.get("anyOf", part.get("oneOf", ())):
        if Draft202012Validator({**member, "$defs": schema["$defs"]}).is_valid(data):
            yield from fields(schema, member, data, owner)
    if isinstance(data, dict):
        further = part.get("additionalProperties") or {}
        for key, value in data.items():
            field = part.get("properties", {}).get(key)
            if field is not None:
                yield owner, key
            yield from fields(schema, field or further, value, owner)
    elif isinstance(data, list):
        for item in data:
            yield from fields(schema, part.get("items") or {}, item, owner)


def as_read(kind: str) -> dict[str, Any]:
    """The schema of what the reader takes for a file of this kind, words in braces among it."""
    schema = KINDS[kind].model_json_schema(by_alias=True)
    if kind in ("campaign", "scenario"):
        with_words(schema)
        schema["$defs"]["Replicates"] |= {"items": {"type": "string"}, "type": ["object", "string", "array"]}
    if kind == "campaign":
        schema["properties"]["runs"] = dict(RUNS)
    return schema


def published() -> dict[str, dict[str, Any]]:
    """The schema of each kind of file; a field's description ends with its unit and the first file that shows it."""
    schemas = {kind: as_read(kind) for kind in KINDS}
    shown: dict[tuple[str, str], str] = {}
    for path, kind in shipped().items():
        schema = schemas[kind]
        for field in fields(schema, schema, load_yaml(path)[0], schema["title"]):
            shown.setdefault(field, path.relative_to(ROOT).as_posix())
    for kind, schema in schemas.items():
        for owner, part in {**schema["$defs"], schema["title"]: schema}.items():
            for name, field in part.get("properties", {}).items():
                words = [field.get("description", ""), f"[{field['unit']}]" if "unit" in field else ""]
                words += [f"(as in {shown[owner, name]})" if (owner, name) in shown else ""]
                field["description"] = " ".join(filter(None, words)) or field["title"]
        schemas[kind] = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    return schemas


def used(schema: dict[str, Any], part: Any, data: Any, owner: str) -> Iterator[tuple[str, str]]:
    """The keys that a part of a file has, each with the model that it is of; an item of a list may go by its name."""
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


def unused() -> list[tuple[str, str]]:
    """Model and key that no YAML file of the repository uses; what is refused shows no use of a key."""
    schemas = [as_read(kind) for kind in KINDS]
    every = {
        (owner, key)
        for schema in schemas
        for owner, part in {**schema["$defs"], schema["title"]: schema}.items()
        for key in part.get("properties", {})
    }
    folders = (ROOT / name for name in ("campaigns", "studies", "src", "docs", "tests"))
    files = [path for folder in folders for path in sorted(folder.rglob("*.yaml")) if not REFUSED.search(path.stem)]
    for path in files:
        for part in parts(yaml.safe_load(path.read_text("utf-8"))):
            for schema in schemas:
                every -= set(used(schema, schema, part, schema["title"]))
    return sorted(every)


def main() -> int:
    """Write the schemas, or say which are not as the models have them; exit code 1 when there are any."""
    if "--unused" in sys.argv[1:]:
        keys = unused()
        print("\n".join(f"{owner}.{key}" for owner, key in keys))
        return bool(keys)
    changed = []
    for kind, schema in published().items():
        path, text = FOLDER / f"{kind}.json", json.dumps(schema, indent=1) + "\n"
        if not path.exists() or path.read_text("utf-8") != text:
            changed.append(kind)
            if "--write" in sys.argv[1:]:
                FOLDER.mkdir(exist_ok=True)
                path.write_text(text, "utf-8")
    if changed and "--write" not in sys.argv[1:]:
        print(f"not as the models have them: {', '.join(changed)}; python scripts/schemas.py --write")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
