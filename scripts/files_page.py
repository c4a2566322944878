"""Write docs/reference/files.md: every key of the files that are read, from their published schemas.

python scripts/files_page.py            print it
python scripts/files_page.py --write    write it, as the documentation does when it is built
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "files.md"
FILES = {
    "campaign": "`hyperval validate`, `hyperval observe`",
    "scenario": "`hyperval predict`, and `scenarios` of a campaign",
    "scene": "`hyperval simulate`, and `simulate` of a collection",
    "study": "`hyperval study`",
    "sensor": "`sensor` of a scenario or scene",
}
HEAD = """# The files, key by key

Made by `scripts/files_page.py` when the documentation is built, from the schemas that `hyperval schema` prints.
Files are YAML 1.2 with plain scalars only: no anchors, no tags, no second key of the same name. Unknown keys are
errors with file and line. A file reference is relative to the file that holds it; `data:SET/PATH` is a file of the
data directory (`HYPERVAL_DATA`, else the user's cache); in a campaign that simulates, `simulated:NAME` is a file of
the simulated collection. Complete examples: the [tutorial](../tutorial.md), the folders `campaigns`,
`src/hyperval/scenarios` and `src/hyperval/sensor/library`.
"""


NAMES = {"string": "text", "boolean": "true or false", "integer": "whole number", "object": "anything"}
LIMITS = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}


def members(field: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """What may stand in a field, nothing left out."""
    return [m for m in field.get("anyOf", field.get("oneOf", [field])) if m.get("type") != "null"]


def type_text(field: Mapping[str, Any]) -> str:
    """A type in words: the names of models, the values of a choice, lists and mappings."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in field or "oneOf" in field:
        return " or ".join(dict.fromkeys(map(type_text, members(field))))
    if "enum" in field or "const" in field:
        return ", ".join(f"`{value}`" for value in field.get("enum", [field.get("const")]))
    if "prefixItems" in field:
        return "[" + ", ".join(map(type_text, field["prefixItems"])) + "]"
    if "items" in field:
        return f"list of {type_text(field['items'])}"
    if isinstance(field.get("additionalProperties"), dict):
        return f"mapping of text to {type_text(field['additionalProperties'])}"
    kind = field.get("type", "object")
    return NAMES.get(kind, kind) if isinstance(kind, str) else NAMES.get(kind[0], kind[0])


def limits_text(field: Mapping[str, Any]) -> str:
    """The numeric limits of a field."""
    stated = dict.fromkeys(f"{text} {m[key]:g}" for m in members(field) for key, text in LIMITS.items() if key in m)
    return ", ".join(stated)


def default_text(field: Mapping[str, Any], is_required: bool) -> str:
    """The default as it would be written, or that there is none."""
    value = field.get("default")
    if is_required or value in (None, ""):
        return "required" if is_required else ""
    if isinstance(value, dict):
        return "its own defaults"
    return f"`{value}`".replace("True", "true").replace("False", "false")


def references(part: Any) -> Iterator[str]:
    """The names of the models that a part of a schema refers to."""
    if isinstance(part, dict):
        yield from (part["$ref"].rpartition("/")[2],) if "$ref" in part else ()
        for inner in part.values():
            yield from references(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from references(inner)


def models_of(name: str, schemas: Mapping[str, Any], seen: dict[str, Any]) -> dict[str, Any]:
    """A model and the models it holds, each once, outermost first."""
    if name not in seen:
        seen[name] = schemas[name]
        for inner in references({k: v for k, v in schemas[name].items() if k != "$defs"}):
            models_of(inner, schemas, seen)
    return seen


def section(name: str, schema: Mapping[str, Any]) -> str:
    """Heading, what it is, and a table of its keys."""
    words = " ".join(schema.get("description", "").split("Attributes")[0].split())
    rows = ["| key | value | default | meaning |", "| --- | --- | --- | --- |"]
    for key, field in schema.get("properties", {}).items():
        told = (field["title"], field["description"], limits_text(field))
        meaning = "; ".join(text for text in dict.fromkeys(told) if text).replace("|", "\\|").replace("; (as", " (as")
        default = default_text(field, key in schema.get("required", ()))
        rows.append(f"| `{key}` | {type_text(field)} | {default} | {meaning} |")
    return f"### {name}\n\n{words}\n\n" + "\n".join(rows) + "\n"


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    done: set[str] = set()
    for kind, used in FILES.items():
        schema = json.loads((ROOT / "src" / "hyperval" / "schemas" / f"{kind}.json").read_text("utf-8"))
        parts.append(f"## {kind.capitalize()} file\n\nRead by {used}.\n")
        models = models_of(schema["title"], {**schema["$defs"], schema["title"]: schema}, {})
        parts += [section(name, part) for name, part in models.items() if name not in done]
        done |= models.keys()
    return "\n".join(parts)


def main() -> None:
    """Print the page, or write it."""
    if "--write" in sys.argv[1:]:
        PAGE.parent.mkdir(exist_ok=True)
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page())


if __name__ == "__main__":
    main()
