"""Write docs/reference/files.md: every key of the files that are read, from the models that read them.

python scripts/files_page.py            print it
python scripts/files_page.py --write    write it, as the documentation does when it is built
"""

from __future__ import annotations

import sys
import types
import typing
from pathlib import Path
from typing import Any

from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from hyperval.campaign import Campaign
from hyperval.scenario import Scenario
from hyperval.sensor import SensorSpecification
from hyperval.simulate.schema import SceneFile
from hyperval.study import StudyFile

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "files.md"
FILES: tuple[tuple[str, type[BaseModel], str], ...] = (
    ("Campaign", Campaign, "`hyperval validate`, `hyperval observe`"),
    ("Scenario", Scenario, "`hyperval predict`, and `scenarios` of a campaign"),
    ("Scene", SceneFile, "`hyperval simulate`, and `simulate` of a collection"),
    ("Study", StudyFile, "`hyperval study`"),
    ("Sensor", SensorSpecification, "`sensor` of a scenario or scene"),
)
HEAD = """# The files, key by key

Made by `scripts/files_page.py` from the models that read the files, when the documentation is built.
Files are YAML 1.2 with plain scalars only: no anchors, no tags, no second key of the same name. Unknown keys are
errors with file and line. A file reference is relative to the file that holds it; `data:SET/PATH` is a file of the
data directory (`HYPERVAL_DATA`, else the user's cache); in a campaign that simulates, `simulated:NAME` is a file of
the simulated collection. Complete examples: [campaigns/](../../campaigns),
[built-in scenarios](../../src/hyperval/scenarios), [sensors](../../src/hyperval/sensor/library).
"""


def type_text(annotation: Any) -> str:
    """A type in words: the names of models, the values of a choice, lists and mappings."""
    origin, parts = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return type_text(parts[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(type_text(p) for p in parts if p is not type(None))
    if origin is typing.Literal:
        return ", ".join(f"`{p}`" for p in parts)
    if origin in (list, tuple) and parts:
        inner = [type_text(p) for p in parts if p is not Ellipsis]
        if origin is tuple and Ellipsis not in parts:
            return "[" + ", ".join(inner) + "]"
        return f"list of {inner[0]}"
    if origin is dict:
        return f"mapping of {type_text(parts[0])} to {type_text(parts[1])}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"[{annotation.__name__}](#{annotation.__name__.lower()})"
    names = {str: "text", float: "number", int: "whole number", bool: "true or false", object: "anything"}
    return names.get(annotation, getattr(annotation, "__name__", str(annotation)))


def limits_text(info: FieldInfo) -> str:
    """The numeric limits of a field."""
    words = {Ge: "at least", Gt: "above", Le: "at most", Lt: "below"}
    found = [
        f"{text} {getattr(item, kind.__name__.lower()):g}"
        for item in info.metadata
        for kind, text in words.items()
        if isinstance(item, kind)
    ]
    return ", ".join(found)


def default_text(info: FieldInfo) -> str:
    """The default as it would be written, or that there is none."""
    if info.is_required():
        return "required"
    value = info.default
    if info.default_factory is not None:
        value = info.default_factory()  # type: ignore[call-arg]
    if value is None or value is PydanticUndefined:
        return ""
    if isinstance(value, BaseModel):
        return "its own defaults"
    if isinstance(value, list | dict | tuple) and not value:
        return "none"
    return f"`{value}`".replace("True", "true").replace("False", "false")


def models_of(model: type[BaseModel], seen: list[type[BaseModel]]) -> list[type[BaseModel]]:
    """A model and the models it holds, each once, outermost first."""
    if model in seen:
        return seen
    seen.append(model)

    def inside(annotation: Any) -> list[type[BaseModel]]:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            return [annotation]
        return [m for part in typing.get_args(annotation) for m in inside(part)]

    for info in model.model_fields.values():
        for inner in inside(info.annotation):
            models_of(inner, seen)
    return seen


def section(model: type[BaseModel], level: str) -> str:
    """Heading, what it is, and a table of its keys."""
    words = " ".join((model.__doc__ or "").split("Attributes")[0].split())
    rows = ["| key | value | default | meaning |", "| --- | --- | --- | --- |"]
    for name, info in model.model_fields.items():
        meaning = "; ".join(t for t in (info.description or "", limits_text(info)) if t).replace("|", "\\|")
        key = info.alias or name
        rows.append(f"| `{key}` | {type_text(info.annotation)} | {default_text(info)} | {meaning} |")
    return f"{level} {model.__name__}\n\n{words}\n\n" + "\n".join(rows) + "\n"


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    done: list[type[BaseModel]] = []
    for title, model, used in FILES:
        parts.append(f"## {title} file\n\nRead by {used}.\n")
        mine = [m for m in models_of(model, []) if m not in done]
        done += mine
        parts += [section(m, "###") for m in mine]
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
