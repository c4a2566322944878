"""A campaign's file: its runs, the files and values that each names, and why one has to wait for its collection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from hyperval.atmosphere.solar import reference_of
from hyperval.campaign.schema import Campaign, Outline, campaign_runs, with_words
from hyperval.config import FILL_IN, Location, Placeholder, load_yaml, placeholders, unfilled, validate
from hyperval.datasets import PREFIX, SIMULATED, describe, resolve, set_on_request
from hyperval.errors import HypervalError, UsageError, reader, refuse
from hyperval.scenario import builtin_scenarios

FILE_KEYS = frozenset({
    "path", "header", "file", "csv", "simulate", "size_classes", "library", "table", "glt", "image", "replicates",
    "radcalnet",
})  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """A file that is named: its key, the reference, the folder that it is relative to."""

    key: str
    text: str
    base: Path

    @property
    def error(self) -> HypervalError | None:
        """Why the file is not at hand, None where it is."""
        try:
            resolve(self.text, self.base)
        except HypervalError as error:
            return error
        return None

    @property
    def path(self) -> Path | None:
        """Where the file is, None when it is not at hand."""
        return None if self.error else resolve(self.text, self.base)

    @property
    def problem(self) -> str:
        """What to do about a file that is not at hand."""
        if isinstance(error := self.error, UsageError):
            return "; ".join(x for x in (error.what, error.expected) if x)
        return (error.mend or error.what) if error else ""


@dataclass(frozen=True)
class Job:
    """One run of a campaign's file as it is written, and what it names.

    Attributes
    ----------
    path, words : its file, and the words of the run that stand in braces there
    content, lines : of the file, and where its entries stand
    files, to_fill_in : that it and its scenarios name, and the values that are still to be given
    of_others : files that other runs of the file name alone
    """

    path: Path
    words: Mapping[str, str]
    content: Any
    lines: dict[Location, int]
    files: tuple[Reference, ...] = ()
    to_fill_in: tuple[Placeholder, ...] = ()
    of_others: tuple[Reference, ...] = ()

    @property
    def folder(self) -> Path:
        """Folder of the campaign file, which its references are relative to."""
        return self.path.resolve().parent

    @cached_property
    def campaign(self) -> Campaign:
        """The campaign; UsageError for mistakes and for values that are still to be filled in."""
        return validate(Campaign, self.content, self.lines, str(self.path))

    @cached_property
    def outline(self) -> Outline:
        """What it says of itself, which needs no value to be filled in; UsageError for mistakes in that."""
        if not self.to_fill_in:
            return self.campaign
        own = {info.alias or name for name, info in Outline.model_fields.items()}
        others = Campaign.model_fields.keys() - own
        # Unknown keys are left in, so that they are named.
        content = {k: v for k, v in self.content.items() if k not in others} if isinstance(self.content, dict) else None
        return validate(Outline, content, self.lines, str(self.path))

    @cached_property
    def waits(self) -> tuple[str, str] | None:
        """Why it cannot be tried here, and what to do: its collection is not public, and no file of it is at hand."""
        owners = {r: owner for r in self.files if (owner := set_on_request(r.text)) is not None}
        if not self.to_fill_in or not owners or any(r.path is not None for r in owners):
            return None
        first, owner = next(iter(owners.items()))
        more = f"{len(self.to_fill_in)} values are to be filled in then (hyperval validate --dry-run lists them)"
        return f"{owner.name} is not on this machine: {first.problem}; {more}", first.problem

    @property
    def missing_sets(self) -> list[str]:
        """Names of the registered data sets that files which are not at hand belong to."""
        owners = [describe(f.text)["dataset"] for f in self.files if f.text.startswith(PREFIX) and f.path is None]
        return list(dict.fromkeys(name for name in owners if name))

    def check(self, *, compares: bool) -> None:
        """Raise UsageError for what cannot run: a file that nobody knows, values to fill in, a side that lacks."""
        for one in self.files:
            if one.text.startswith(PREFIX) and isinstance(error := one.error, UsageError):
                where = f"{self.path}: {one.key}: {error.where or one.text}"
                raise UsageError(error.what, where=where, expected=error.expected, mend=error.mend)
        lacking = [key for key in ("scenarios", "comparisons") if not (self.content or {}).get(key)]
        refuse(compares and lacking, "campaign.lacking", self.path, keys=" and no ".join(lacking))
        if self.to_fill_in and self.waits is None:
            raise unfilled(list(self.to_fill_in))


def _named_in(path: Path, content: Any, lines: dict[Location, int], words: Mapping[str, str]) -> Job:
    """One run of a file with the files and values to fill in of its own text, then of its scenario files."""
    base = Path(path).resolve().parent
    files = _files(content, base)
    marks = placeholders(content, lines, str(path))
    scenarios = content.get("scenarios") if isinstance(content, dict) else None
    for entry in scenarios if isinstance(scenarios, list) else []:
        day = isinstance(entry, dict) and "radcalnet" in entry
        item = entry.get("scenario") if day else entry
        if not isinstance(item, str) or item in builtin_scenarios() or item.startswith(FILL_IN):
            continue
        files.append(Reference("scenarios", item, base))
        scenario_path = files[-1].path
        if scenario_path is None:
            continue
        inner, inner_lines = load_yaml(scenario_path)
        inner = with_words(inner, {**words, "file": str(entry["radcalnet"])} if day else words)
        files += _files(inner, scenario_path.resolve().parent)
        marks += placeholders(inner, inner_lines, item if item.startswith(PREFIX) else str(Path(path).parent / item))
    unique = {(r.text, r.base if not r.text.startswith(PREFIX) else None): r for r in reversed(files)}
    return Job(Path(path), words, content, lines, tuple(reversed(unique.values())), tuple(marks))


def _files(content: Any, base: Path, at: tuple[str, ...] = ()) -> list[Reference]:
    if isinstance(content, dict):
        return [r for key, value in content.items() for r in _files(value, base, (*at, str(key)))]
    if isinstance(content, list):
        return [r for value in content for r in _files(value, base, at)]
    if not isinstance(content, str) or content.startswith((SIMULATED, FILL_IN)):
        return []
    if at[-1] == "solar_spectrum":
        content = reference_of(content)
    is_file = (
        at[-1] in FILE_KEYS
        or at[-1] == "solar_spectrum"
        or "materials" in at
        or (at[-1] == "files" and "replicates" in at)
        or (at[-1] == "sensor" and content.endswith((".yaml", ".yml")))
        or content.startswith(PREFIX)
    )
    return [Reference(".".join(at), content, base)] if content and is_file else []


@reader
def read_jobs(path: Path) -> list[Job]:
    """Every run of a campaign file, before anything in it is checked.

    Raises
    ------
    InputError : no such file.
    UsageError : no YAML, or runs that are none.
    """
    data, lines = load_yaml(path)
    runs = [_named_in(path, content, lines, words) for words, content in campaign_runs(data, lines, str(path))]
    every = dict.fromkeys(file for job in runs for file in job.files)
    return [replace(job, of_others=tuple(file for file in every if file not in set(job.files))) for job in runs]


def job_of(path: Path) -> Job:
    """The campaign of a file of one run, which need not predict or compare.

    Raises
    ------
    InputError : no such file.
    UsageError : every mistake with its file and line; values that are still to be filled in; a file of several runs.
    """
    job, *more = read_jobs(path)
    refuse(more, "campaign.several", path, count=len(more) + 1)
    assert job.campaign  # noqa: S101 - read now, for its mistakes
    return job


def jobs_of(*paths: Path, compares: bool = True) -> list[Job]:
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
    jobs = [job for path in paths for job in read_jobs(path)]
    for job in jobs:
        job.check(compares=compares)
    names = [job.outline.name for job in jobs]
    twice = next((name for name in names if names.count(name) > 1), None)
    refuse(twice, "campaign.twice", name=twice)
    return jobs
