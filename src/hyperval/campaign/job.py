"""Campaigns with values still to be filled in: SKIPPED where the collection is not at hand, else refused.

Which files a campaign and its scenarios name, found without checking or reading the rest of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hyperval.atmosphere.solar import reference_of
from hyperval.campaign.schema import Campaign, Outline, campaign_runs, with_words
from hyperval.config import FILL_IN, Location, Placeholder, load_yaml, placeholders, unfilled, validate
from hyperval.datasets import PREFIX, describe, resolve, set_on_request
from hyperval.errors import HypervalError, UsageError, reader
from hyperval.scenario import builtin_scenarios

FILE_KEYS = frozenset({
    "path", "header", "file", "csv", "simulate", "size_classes", "library", "table", "glt", "image", "replicates",
    "radcalnet",
})  # fmt: skip
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


@dataclass(frozen=True)
class Waiting:
    """A campaign that waits for its collection: what it says of itself, its file, why it cannot run, what to do."""

    campaign: Outline
    path: Path
    reason: str
    remedy: str

    @property
    def folder(self) -> Path:
        """Folder of the campaign file."""
        return self.path.resolve().parent


@dataclass(frozen=True)
class Job:
    """A campaign that was read and checked, with its file and the files that it and its scenarios name."""

    campaign: Campaign
    path: Path
    files: tuple[Reference, ...] = ()
    of_others: tuple[Reference, ...] = ()  # named by other runs of the file alone

    @property
    def folder(self) -> Path:
        """Folder of the campaign file, which its references are relative to."""
        return self.path.resolve().parent


AnyJob = Job | Waiting


@dataclass(frozen=True)
class Text:
    """One run of a campaign file as it is written, and what it names."""

    path: Path
    words: Mapping[str, str]
    content: Any
    lines: dict[Location, int]
    named: Named

    def outline(self) -> Outline:
        """Name, words and comparisons; UsageError for mistakes in these."""
        keys = {info.alias or name for name, info in Outline.model_fields.items()}
        known = keys | set(Campaign.model_fields)
        if not isinstance(self.content, dict):
            return validate(Outline, self.content, self.lines, str(self.path))
        # Unknown keys are left in, so that they are named.
        own = {key: value for key, value in self.content.items() if key in keys or key not in known}
        return validate(Outline, own, self.lines, str(self.path))

    def campaign(self) -> Campaign:
        """The campaign; UsageError for mistakes and for values that are still to be filled in."""
        campaign = validate(Campaign, self.content, self.lines, str(self.path))
        campaign._run = self.words
        return campaign

    def check_two_sides(self) -> None:
        """Raise UsageError for a campaign that names no scenario or no comparison: it can only be observed."""
        lacking = [key for key in ("scenarios", "comparisons") if not (self.content or {}).get(key)]
        if lacking:
            raise UsageError(
                f"the campaign has no {' and no '.join(lacking)}",
                where=str(self.path),
                expected="a scenario to predict from, and what is to be compared",
                mend="hyperval observe needs neither",
            )

    def absent(self) -> tuple[str, str] | None:
        """Why the campaign cannot be tried here and what to do: not public, and not a file of it is at hand."""
        owners = {r: owner for r in self.named.files if (owner := set_on_request(r.text)) is not None}
        if not owners or any(r.path is not None for r in owners):
            return None
        first, owner = next(iter(owners.items()))
        left = len(self.named.to_fill_in)
        more = f"; {left} values are to be filled in then (hyperval validate --dry-run lists them)" if left else ""
        return f"{owner.name} is not on this machine: {first.problem}{more}", first.problem

    def unfilled(self) -> UsageError:
        """The error that names every value to be filled in."""
        return unfilled(list(self.named.to_fill_in))


@reader
def read_texts(path: Path) -> list[Text]:
    """Every run of a campaign file, before anything in it is checked."""
    data, lines = load_yaml(path)
    return [
        Text(Path(path), words, content, lines, named_in(Path(path), content, lines, words))
        for words, content in campaign_runs(data, lines, str(path))
    ]


def job_of(path: Path) -> Job:
    """The campaign of a file of one run, which need not predict or compare.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line; values that are still to be filled in; a file of several runs.
    """
    text, *more = read_texts(path)
    if more:
        raise UsageError(
            f"the file holds {len(more) + 1} runs",
            where=str(path),
            expected="a campaign of one run",
            mend="copy it with one entry under 'runs'; hyperval validate takes all of them",
        )
    return Job(text.campaign(), text.path, text.named.files)


def _apart(texts: Sequence[Text]) -> Iterator[tuple[Text, tuple[Reference, ...]]]:
    """Each run of a campaign file, and the files that other runs of it name alone."""
    every = dict.fromkeys(file for text in texts for file in text.named.files)
    for text in texts:
        named = set(text.named.files)
        yield text, tuple(file for file in every if file not in named)


def jobs_of(*paths: Path, compares: bool = True) -> list[AnyJob]:
    """The campaigns of files, one for each of their runs.

    ``compares``: there must be a scenario and a comparison, without which a collection can only be observed.

    A campaign with values that are still to be filled in waits where its collection is not public and no file of it
    is on this machine.

    Raises
    ------
    InputError : no such file.
    UsageError : mistakes, file names that no registry knows, values still to be filled in of a campaign that
        could run, or two campaigns of one name.
    """
    out: list[AnyJob] = []
    for text, of_others in (pair for path in paths for pair in _apart(read_texts(path))):
        check_names(text.path, text.named.files)
        if compares:
            text.check_two_sides()
        if not text.named.to_fill_in:
            out.append(Job(text.campaign(), text.path, text.named.files, of_others))
            continue
        absent = text.absent()
        if absent is None:
            raise text.unfilled()
        out.append(Waiting(text.outline(), text.path, *absent))
    names = [job.campaign.name for job in out]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"two campaigns are named {twice[0]!r}")
    return out
