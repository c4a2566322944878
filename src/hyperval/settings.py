"""Any entry of a configuration by its dotted path: read it, or make a copy in which it differs.

A path follows the keys of the YAML file; an item of a list goes by its ``name`` (or ``subject``, ``region``) or by its
number from 0: ``atmosphere.aot550``, ``scene.classes.grass.gain``, ``scene.targets.yellow.subjects.0.fill.fixed``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np
from pydantic import BaseModel

from hyperval.config import M, validate
from hyperval.errors import UsageError, did_you_mean, refusal, refuse

_LABELS = ("name", "subject", "region")


def setting(model: BaseModel, path: str) -> Any:
    """The value at a dotted path, defaults included.

    Raises
    ------
    UsageError : no such entry; the message names those that there are.
    """
    node: Any = model.model_dump(mode="python", by_alias=True)
    for i, part in enumerate(parts := path_parts(path)):
        refuse(node is None, "setting.none", path=path, at=".".join(parts[:i]))
        node = node[_key(node, part, path)]
    return node


def numbers_of(model: BaseModel) -> list[str]:
    """Dotted paths of all numbers, and lists of numbers, in a configuration, those at their defaults included."""
    out: list[str] = []

    def walk(node: Any, path: str) -> None:
        if isinstance(node, dict):
            for key, value in node.items():
                walk(value, f"{path}.{key}" if path else str(key))
        elif isinstance(node, list | tuple) and node and isinstance(node[0], dict):
            for number, item in enumerate(node):
                name = next((f"[{item[k]}]" for k in _LABELS if k in item), str(number))
                walk(item, f"{path}.{name}")
        elif node not in ((), []):
            each = node if isinstance(node, list | tuple) else [node]
            if all(isinstance(x, int | float) and not isinstance(x, bool) for x in each):
                out.append(path)

    walk(model.model_dump(mode="python", by_alias=True), "")
    return out


def with_settings(model: M, changes: Mapping[str, Any]) -> M:
    """A copy of a configuration in which the entries at some paths have other values, checked as a file is.

    Entries that do not stand in the file are made; ``None`` takes an entry back.  Private attributes, such as the
    folder of a scenario, are kept.

    Raises
    ------
    UsageError : a path that leads nowhere, or values that contradict the rest.
    """
    data = model.model_dump(mode="python", by_alias=True, exclude_unset=True)
    for path, value in changes.items():
        data = _changed(data, path_parts(path), value, path)
    changed = validate(type(model), data, {}, "settings " + ", ".join(changes))
    for name in model.__private_attributes__:
        setattr(changed, name, getattr(model, name))
    return changed


def _changed(node: Any, parts: list[str], value: Any, path: str) -> Any:
    """A part of a configuration with another value at the rest of the path."""
    if not parts:
        return _plain(value)
    holder, (part, *rest) = ".".join(path_parts(path)[: -len(parts)]), parts
    if node is None or isinstance(node, dict):  # missing parts are made; validation finds unknown keys
        entries = node or {}
        return {**entries, part: _changed(entries.get(part), rest, value, path)}
    is_whole = isinstance(node, tuple) and not all(isinstance(item, dict) for item in node)
    refuse(is_whole, "setting.whole", path=path, holder=holder)
    refuse(not isinstance(node, list | tuple), "setting.parts", path=path, holder=holder)
    number, items = _key(node, part, path), list(node)
    items[number] = _changed(items[number], rest, value, path)
    return items


def _plain(value: Any) -> Any:
    """A value as a file has it: paths are texts, and scalars of NumPy those of Python.

    >>> _plain({"files": [PurePath("a", "b.txt"), 1.5], "none": None, "is_on": np.bool_(True)})
    {'files': ['a/b.txt', 1.5], 'none': None, 'is_on': True}
    """
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, PurePath) else value.item() if isinstance(value, np.generic) else value


def path_parts(path: str) -> list[str]:
    """The path cut at its dots; a name that holds dots stands in square brackets: ``classes.[dark 0.5 m].gain``.

    >>> path_parts("scene.classes.[grass [dry]].gain"), path_parts("a.[b.c]")
    (['scene', 'classes', 'grass [dry]', 'gain'], ['a', 'b.c'])
    """
    parts: list[str] = []
    rest = path
    while rest:
        if rest.startswith("["):
            end = (rest + ".").find("].")  # a name may hold brackets
            refuse(end < 0, "setting.bracket", path=path)
            word, rest = rest[1:end], rest[end + 2 :]
        else:
            word, _, rest = rest.partition(".")
        parts.append(word)
    refuse(not parts or not all(parts) or path.endswith("."), "setting.path", path=path)
    return parts


def _key(node: Any, part: str, path: str) -> Any:
    if isinstance(node, dict):
        if part in node:
            return part
        what = f"setting {path!r}: no {part!r}{did_you_mean(part, node)}"
        raise UsageError(what, expected="one of " + ", ".join(map(str, node)))
    if isinstance(node, list | tuple):
        labels = ([item[k] for k in _LABELS if k in item] if isinstance(item, dict) else [] for item in node)
        return item_number([next(iter(names), None) for names in labels], part, path)
    raise UsageError(f"setting {path!r}: nothing lies below {part!r}")


def item_number(names: Sequence[Any], part: str, path: str) -> int:
    """Number of the item of a list that a part of a path names, by its name or by its number from 0.

    >>> item_number(["sand", "plank 0.5"], *"plank 0,a.plank 0.5".split(","))
    Traceback (most recent call last):
    hyperval.errors.UsageError: setting 'a.plank 0.5': no item 'plank 0'
      expected: a number below 2 or one of sand, [plank 0.5] (a name that holds dots stands in brackets)

    Raises
    ------
    UsageError : there is none.
    """
    if part in names:
        return names.index(part)
    if part.isdecimal() and int(part) < len(names):
        return int(part)
    listed = ", ".join(f"[{n}]" if "." in str(n) else str(n) for n in names if n is not None)
    brackets = " (a name that holds dots stands in brackets)" if "[" in listed else ""
    choices = f" or one of {listed}{brackets}" if listed else ""
    raise refusal("setting.item", path=path, part=part, count=len(names), known=choices)
