"""Which files a campaign and its scenarios name, found without checking or reading the rest of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hyperval.atmosphere.solar import reference_of
from hyperval.campaign.template import with_words
from hyperval.config import FILL_IN, Placeholder, load_yaml, placeholders
from hyperval.datasets import PREFIX, describe, resolve
from hyperval.errors import HypervalError, UsageError
from hyperval.scenario import builtin_scenarios

FILE_KEYS = frozenset(
    {
        "path",
        "header",
        "file",
        "csv",
        "simulate",
        "size_classes",
        "library",
        "table",
        "glt",
        "image",
        "replicates",
        "radcalnet",
    }
)
SIMULATED = "simulated:"


@dataclass(frozen=True)
class Reference:
    """A file that is named: its key, the reference, the folder that it is relative to."""

    key: str
    text: str
    base: Path

    @property
    def path(self) -> Path | None:
        """Where the file is, None when it is not at hand."""
        try:
            return resolve(self.text, self.base)
        except HypervalError:
            return None

    @property
    def problem(self) -> str:
        """What to do about a file that is not at hand."""
        try:
            resolve(self.text, self.base)
        except HypervalError as error:
            if isinstance(error, UsageError):
                return "; ".join(x for x in (error.what, error.expected) if x)
            return error.mend or error.what
        return ""


@dataclass(frozen=True)
class Named:
    """What a campaign file and the scenarios it names refer to."""

    files: tuple[Reference, ...]
    to_fill_in: tuple[Placeholder, ...]


def check_names(path: Path, files: Sequence[Reference]) -> None:
    """Raise UsageError for a ``data:`` reference that no registry and no folder on this machine knows."""
    for reference in files:
        if not reference.text.startswith(PREFIX):
            continue
        try:
            resolve(reference.text, reference.base)
        except UsageError as error:
            where = f"{path}: {reference.key}: {error.where or reference.text}"
            raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend) from None
        except HypervalError:
            continue  # the registry knows it: it is only not at hand


def missing_sets(files: Sequence[Reference]) -> list[str]:
    """Names of the registered data sets that files which are not at hand belong to."""
    owners = [describe(f.text)["dataset"] for f in files if f.text.startswith(PREFIX) and f.path is None]
    return list(dict.fromkeys(name for name in owners if name))


def named_in(path: Path, content: Any, lines: dict[Any, int], words: Mapping[str, str]) -> Named:
    """Files and values to fill in of one run of a campaign: of its own text, then of its scenario files."""
    base = Path(path).resolve().parent
    files = _files(content, base)
    marks = placeholders(content, lines, str(path))
    scenarios = content.get("scenarios") if isinstance(content, dict) else None
    for entry in scenarios if isinstance(scenarios, list) else []:
        day = isinstance(entry, dict) and "radcalnet" in entry
        item = entry.get("scenario") if day else entry
        if not isinstance(item, str) or item in builtin_scenarios() or item.startswith(FILL_IN):
            continue
        reference = Reference("scenarios", item, base)
        files.append(reference)
        scenario_path = reference.path
        if scenario_path is None:
            continue
        inner, inner_lines = load_yaml(scenario_path)
        inner = with_words(inner, {**words, "file": str(entry["radcalnet"])} if day else words)
        files += _files(inner, scenario_path.resolve().parent)
        name = item if item.startswith(PREFIX) else str(Path(path).parent / item)
        marks += placeholders(inner, inner_lines, name)
    unique = {(r.text, r.base if not r.text.startswith(PREFIX) else None): r for r in reversed(files)}
    return Named(tuple(reversed(unique.values())), tuple(marks))


def _files(content: Any, base: Path, at: tuple[str, ...] = ()) -> list[Reference]:
    if isinstance(content, dict):
        return [r for key, value in content.items() for r in _files(value, base, (*at, str(key)))]
    if isinstance(content, list):
        return [r for value in content for r in _files(value, base, at)]
    if not isinstance(content, str) or content.startswith((SIMULATED, FILL_IN)):
        return []
    if at[-1] == "solar_spectrum":
        spectrum = reference_of(content)
        return [Reference(".".join(at), spectrum, base)] if spectrum else []
    is_file = (
        at[-1] in FILE_KEYS
        or "materials" in at
        or (at[-1] == "files" and "replicates" in at)
        or (at[-1] == "sensor" and content.endswith((".yaml", ".yml")))
    )
    return [Reference(".".join(at), content, base)] if is_file or content.startswith(PREFIX) else []
