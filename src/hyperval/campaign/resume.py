"""Campaigns that a run finished before it was ended: kept beside its output until all of them are done."""

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
from hyperval.campaign.one import SIMULATED, Job
from hyperval.campaign.provenance import command_without_output, package_versions, source_revision
from hyperval.datasets import InputLog
from hyperval.errors import HypervalError
from hyperval.files import sha256_of, write_text
from hyperval.report import RunReport
from hyperval.report.power import accepted_table
from hyperval.report.stored import read_results
from hyperval.results import Outcome


class Finished:
    """The finished campaigns of runs into one output.

    Parameters
    ----------
    folder : holds a folder for each campaign, and beside it what it was made of
    """

    def __init__(self, folder: Path):
        self.folder = folder / "campaigns"

    def keep(self, job: Job, run: RunReport) -> None:
        """Remember that the folder of a campaign is whole; not where something was skipped or went wrong."""
        if any(row.outcome in (Outcome.SKIPPED, Outcome.ERROR) for row in run.table):
            return
        files = {i["reference"]: i["sha256"] for i in run.provenance["inputs"]}
        record = json.dumps({"identity": identity(job), "files": files}, indent=1, sort_keys=True)
        write_text(self._record(job), record + "\n")

    def load(self, job: Job) -> RunReport | None:
        """The report of a campaign, without its arrays, where it is finished and would come out the same.

        What is left of one that is not, or that was made of other files, settings or programs, is removed.
        """
        with suppress(OSError, ValueError, KeyError, TypeError, HypervalError):
            record = json.loads(self._record(job).read_bytes())
            if record["identity"] == identity(job) and _unchanged(job, record["files"]):
                campaign = job.campaign
                return RunReport(
                    campaign=campaign.name,
                    title=campaign.title,
                    description=campaign.description,
                    simulated=campaign.simulated,
                    computed=campaign.computed,
                    table=read_results(self.folder / campaign.name / "results.json"),
                )
        self._record(job).unlink(missing_ok=True)
        shutil.rmtree(self.folder / job.campaign.name, ignore_errors=True)
        return None

    def hand_over(self, names: Sequence[str], target: Path) -> None:
        """Move the folders of these campaigns into ``target``."""
        for name in names:
            os.rename(self.folder / name, target / name)

    def remove(self) -> None:
        """Remove what is kept: the output is whole."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            self.folder.parent.rmdir()

    def _record(self, job: Job) -> Path:
        return self.folder / f"{job.campaign.name}.json"


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
