"""Campaigns that need not run again: finished before a run was ended, or whole in the output of an earlier one.

A campaign's folder bears a record (``.hyperval-made-of.json``) of what it was made of and of its own files.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import hyperval
from hyperval.campaign.job import Job
from hyperval.campaign.one import report_of
from hyperval.campaign.provenance import command_without_output, package_versions, source_revision
from hyperval.campaign.references import SIMULATED
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError
from hyperval.files import sha256_of, write_text
from hyperval.folders import RECORD
from hyperval.report import RunReport
from hyperval.report.power import accepted_table
from hyperval.report.stored import read_results
from hyperval.results import Outcome


class Finished:
    """The campaigns of a run that need not run again: finished before it was ended, or in an earlier run's output.

    Parameters
    ----------
    folder : holds a folder for each campaign until all of them are done
    earlier : output of an earlier run, with a folder for each campaign; None: nothing is taken from there
    """

    def __init__(self, folder: Path, earlier: Path | None = None):
        self.folder = folder / "campaigns"
        self.earlier = earlier

    def keep(self, job: Job, run: RunReport) -> None:
        """Remember that the folder of a campaign is whole; not where something was skipped or went wrong."""
        write_record(job, run, self.folder / job.campaign.name)

    def load(self, job: Job) -> RunReport | None:
        """The report of a campaign, without its arrays, where it is finished and would come out the same.

        What is left of one that is not, or that was made of other files, settings or programs, is removed.
        """
        own = self.folder / job.campaign.name
        run = as_before(job, own)
        if run is None:
            shutil.rmtree(own, ignore_errors=True)
            if self.earlier is not None:
                run = taken_over(job, self.earlier / job.campaign.name, own)
        return run

    def hand_over(self, names: Sequence[str], target: Path) -> None:
        """Move the folders of these campaigns into ``target``."""
        for name in names:
            os.rename(self.folder / name, target / name)

    def remove(self) -> None:
        """Remove what is kept: the output is whole."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            self.folder.parent.rmdir()


def write_record(job: Job, run: RunReport, folder: Path) -> None:
    """Write into a campaign's folder what it was made of; not where something was skipped or went wrong."""
    if any(row.outcome in (Outcome.SKIPPED, Outcome.ERROR) for row in run.table):
        return
    files = {i["reference"]: i["sha256"] for i in run.provenance["inputs"]}
    try:
        beside = _beside(job, files)
    except (OSError, HypervalError):  # a file of elsewhere, which the provenance names without its folder
        return
    record = {
        "identity": identity(job),
        "files": files,
        "beside": beside,
        "outputs": {name: sha256_of(folder / name) for name in _written(folder)},
    }
    write_text(folder / RECORD, json.dumps(record, indent=1, sort_keys=True) + "\n")


def as_before(job: Job, folder: Path) -> RunReport | None:
    """The report that stands whole in ``folder``, without its arrays, where it would come out the same."""
    with suppress(OSError, ValueError, KeyError, TypeError, AttributeError, HypervalError):
        record = json.loads((folder / RECORD).read_bytes())
        if (
            record["identity"] == identity(job)
            and _unchanged(job, record["files"])
            and record["beside"] == _beside(job, record["files"])
            and record["outputs"]
            and all(sha256_of(folder / name) == digest for name, digest in record["outputs"].items())
        ):
            return report_of(job.campaign, read_results(folder / "results.json"))
    return None


def taken_over(job: Job, source: Path, target: Path) -> RunReport | None:
    """Give ``target`` the files of the finished campaign in ``source`` where it would come out the same.

    Each file gets a second name; nothing is copied where the file system knows several names of a file.  What else
    stands in ``source`` stays there.
    """
    run = as_before(job, source)
    if run is None:
        return None
    for name in (*json.loads((source / RECORD).read_bytes())["outputs"], RECORD):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(source / name, target / name)
        except OSError:
            shutil.copyfile(source / name, target / name)
    return run


def identity(job: Job) -> str:
    """A digest of everything that a campaign's results follow from, but for the files that it reads."""
    inner: dict[str, Any] = {
        "campaign": job.campaign.model_dump(mode="json", by_alias=True),
        "command": command_without_output(),
        "program": _program(),
        "revision": source_revision(),
        "packages": package_versions(),
        "python": platform.python_version(),
        "power": repr(accepted_table(job.campaign.name)),
    }
    return hashlib.sha256(json.dumps(inner, sort_keys=True, default=str).encode()).hexdigest()


@cache
def _program() -> str:
    """A digest of the package's own files: a checkout may change under one version."""
    digest, root = hashlib.sha256(), Path(hyperval.__file__).parent
    for path in sorted(p for p in root.rglob("*") if p.is_file() and p.suffix != ".pyc"):
        digest.update(f"{path.relative_to(root).as_posix()} {sha256_of(path)}\n".encode())
    return digest.hexdigest()


def _unchanged(job: Job, files: dict[str, str]) -> bool:
    """Whether every file that was read is the same; simulated ones follow from the others."""
    log = InputLog(job.folder)
    read = {name: digest for name, digest in files.items() if not name.startswith(SIMULATED)}
    return all(sha256_of(log.resolve(name)) == digest for name, digest in read.items())


def _beside(job: Job, files: dict[str, str]) -> str:
    """A digest of the names of all files in the folders that were read from: a header or a grid may come later."""
    log = InputLog(job.folder)
    folders = {log.resolve(name).parent for name in files if not name.startswith(SIMULATED)}
    names = sorted(sorted(e.name for e in os.scandir(folder) if e.is_file()) for folder in folders)
    return hashlib.sha256(json.dumps(names).encode()).hexdigest()


def _written(folder: Path) -> list[str]:
    """The files below a campaign's folder, but for the record."""
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file() and p.name != RECORD)
