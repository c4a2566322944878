"""Runs and what came of them: a folder each, whose run.json says how the run stands.

What one server takes on, and how long it keeps what came of it.

Names of what is kept beside a run to be drawn: other scripts draw other files, after an update too.
"""

from __future__ import annotations

import csv
import hashlib
import re
import secrets
import shutil
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from hyperval.errors import HypervalError
from hyperval.report import first_screen
from hyperval.run import CSV, Run, is_run, provenance_of
from hyperval.storage import size_of, write_text

MEGABYTE = 1_000_000
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


@dataclass(frozen=True)
class Limits:
    """Bounds of one server.

    Attributes
    ----------
    body_bytes, upload_bytes : of one request; of one that brings a file
    quick_seconds, long_seconds : of a prediction or chart; of a study, campaign or pipeline
    memory_bytes : of one worker
    quick_workers, long_workers : processes of either kind
    queue : runs that wait, of either kind; per_session : runs of one session that wait or run
    kept_bytes, kept_days : finished runs and uploads; the oldest go first
    points : of a study;  pixels : of an uploaded cube, times its bands
    """

    body_bytes: int = 300_000
    upload_bytes: int = 64 * MEGABYTE
    quick_seconds: float = 60.0
    long_seconds: float = 3600.0
    memory_bytes: int = 3_000 * MEGABYTE
    quick_workers: int = 2
    long_workers: int = 1
    queue: int = 64
    per_session: int = 8
    kept_bytes: int = 5_000 * MEGABYTE
    kept_days: float = 30.0
    points: int = 20_000
    samples: int = 100_000_000


@dataclass(frozen=True)
class ServerSettings:
    """How one server is run.

    Attributes
    ----------
    folder : runs and uploads;  campaigns : folder of campaigns that may be run, None: none
    data : folder whose cubes and regions may be named, None: none
    hosts : names under which browsers reach it
    secure : whether it is reached by HTTPS alone, through a proxy
    scheduler : address of a Dask scheduler whose workers carry the tasks out, None: processes of this machine
    """

    folder: Path
    campaigns: Path | None = None
    hosts: tuple[str, ...] = LOOPBACK
    secure: bool = False
    limits: Limits = field(default_factory=Limits)
    data: Path | None = None
    scheduler: str | None = None


ENDED = ("finished", "failed", "cancelled", "lost")
_ID = re.compile(r"[A-Za-z0-9_-]{16}")
_DAY_S = 86400.0
EVERYBODY = ""  # the owner of what commands wrote
MOST_LISTED = 40
_STUDY_COLUMNS = ("subject", "method", "metric", "value", "unit")
COLLECTION = "collection"  # folder of a run that keeps what its campaign simulates


class WebRun(BaseModel):
    """A run as its file has it.

    Attributes
    ----------
    id : of the folder;  owner : session that asked
    kind, name, title : what it is, and of what
    created, seconds : Unix time, and how long it took
    state, reason : how it stands, and why it has no results
    summary : what a list says of it
    """

    model_config = ConfigDict(frozen=True)
    id: str
    owner: str
    kind: str
    name: str
    title: str = ""
    created: float = Field(0.0, description="Unix time")
    seconds: float = 0.0
    state: Literal["waiting", "running", "finished", "failed", "cancelled", "lost"] = "waiting"
    reason: str = ""
    version: str = ""
    summary: dict[str, Any] = {}


class RunStore:
    """Runs of one server: the folders below ``runs``, each of which says how its run stands.

    A run whose file says that it waits or runs when a server starts is lost: the server that had it has ended.
    Results that commands wrote elsewhere below the server's folder are runs too, which every session sees.
    """

    def __init__(self, folder: Path, limits: Limits):
        self.folder, self.limits = folder, limits
        self.notices: list[str] = []
        self._lock = threading.RLock()
        self._unwritten: dict[str, WebRun] = {}  # what stands in no file: that a run has begun, or met a full disk
        self._cleared = 0.0
        (folder / "runs").mkdir(parents=True, exist_ok=True)
        self._settle()
        self.clear()

    def _settle(self) -> None:
        lost = unreadable = 0
        for place in (self.folder / "runs").iterdir():
            run = _read(place)
            if run is None and _ID.fullmatch(place.name):
                unreadable += 1
                shutil.rmtree(place, ignore_errors=True)
            elif run is not None and run.state not in ENDED:
                lost += 1
                with suppress(OSError):
                    self.change(run.id, state="lost", reason="the server stopped before the run had finished")
        if lost:
            self.notices.append(f"{lost} runs had not finished when the server stopped, and are lost.")
        if unreadable:
            self.notices.append(f"{unreadable} folders of runs could not be read and were removed.")

    def place(self, run_id: str) -> Path:
        """The folder of a run."""
        if not _ID.fullmatch(run_id):
            raise KeyError(run_id)
        return self.folder / "runs" / run_id

    def new(
        self, owner: str, kind: str, name: str, title: str, version: str,
        files: Mapping[str, str | Path] = MappingProxyType({}),
    ) -> WebRun:  # fmt: skip
        """A run that waits, with its folder.

        Parameters
        ----------
        files : that the folder begins with: name -> text, or the path of what is copied

        Raises
        ------
        OSError : it cannot be written.
        """
        run = WebRun(
            id=secrets.token_urlsafe(12), owner=owner, kind=kind, name=name, title=title, created=time.time(),
            version=version,
        )  # fmt: skip
        place = self.place(run.id)
        try:
            place.mkdir(mode=0o700)
            for file, source in files.items():
                (place / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source, place / file) if isinstance(source, Path) else write_text(place / file, source)
            self._write(run)
        except OSError:
            shutil.rmtree(place, ignore_errors=True)
            raise
        return run

    def _write(self, run: WebRun) -> None:
        write_text(self.place(run.id) / "run.json", run.model_dump_json(indent=1) + "\n")

    def known(self, run_id: str) -> WebRun:
        """A run of any session; KeyError where there is none."""
        run = self._unwritten.get(run_id) or _read(self.place(run_id))
        if run is None:
            raise KeyError(run_id)
        return run

    def run(self, run_id: str, owner: str) -> WebRun:
        """A run that a session sees.

        Raises
        ------
        KeyError : there is none, or it is another session's.
        """
        run = self.known(run_id)
        if run.owner not in (owner, EVERYBODY):
            raise KeyError(run_id)
        return run

    def runs(self, owner: str, kind: str | None = None) -> list[WebRun]:
        """Runs that a session sees, the latest first."""
        self._adopt()
        every = (self._unwritten.get(place.name) or _read(place) for place in (self.folder / "runs").iterdir())
        seen = [r for r in every if r is not None and r.owner in (owner, EVERYBODY) and kind in (None, r.kind)]
        return sorted(seen, key=lambda r: -r.created)

    def _adopt(self) -> None:
        """Give what commands wrote below the server's folder a run whose results are a link to it."""
        groups = [place for place in self.folder.iterdir() if place.name not in ("runs", "uploads", "cache")]
        for path in (path for group in groups for path in (group, *group.glob("*/")) if is_run(path)):
            run_id = hashlib.sha256(str(path.relative_to(self.folder)).encode()).hexdigest()[:16]
            place, written = self.place(run_id), path.stat().st_mtime
            old = _read(place)
            with suppress(OSError, HypervalError):  # it is being written, or no page can tell of it
                if (old is None or old.created != written) and (record := provenance_of(path)):
                    place.mkdir(mode=0o700, exist_ok=True)
                    if not (place / "results").is_symlink():
                        (place / "results").symlink_to(path.resolve(), target_is_directory=True)
                    self._write(_told_of(run_id, path, record, written))

    def change(self, run_id: str, **changes: Any) -> WebRun:
        """Set entries of a run; in memory even where the file cannot be written.

        That a run has begun stands in memory alone: after a restart it is lost as one that waited is.
        """
        with self._lock:
            run = self._unwritten[run_id] = self.known(run_id).model_copy(update=changes)
            if run.state != "running":
                self._write(run)
                del self._unwritten[run_id]
        return run

    def remove(self, run_id: str) -> None:
        """Forget a run and what came of it."""
        with self._lock:
            self._unwritten.pop(run_id, None)
            shutil.rmtree(self.place(run_id), ignore_errors=True)

    def clear(self) -> None:
        """Remove runs that are too old, and the oldest while all together are too large; looked at once a minute."""
        now = time.time()
        with self._lock:
            if now < self._cleared + 60.0:
                return
            self._cleared = now
            kept = [(path.stat().st_mtime, path) for path in (self.folder / "uploads").glob("*/*/*")]
            for place in (self.folder / "runs").iterdir():
                run = _read(place)
                if run is not None and run.state in ENDED and run.owner != EVERYBODY:
                    kept.append((run.created, place))
            sizes = [size_of(path) for _, path in kept]
            total = sum(sizes)
            for (created, path), size in sorted(zip(kept, sizes, strict=True)):
                if now - created > self.limits.kept_days * _DAY_S or total > self.limits.kept_bytes:
                    total -= size
                    shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)


def _read(place: Path) -> WebRun | None:
    """The run of a folder; None where it does not say, or what it links to has gone."""
    path = place / "run.json"
    try:
        state = path.stat()
        run = _parsed(path, state.st_ino, state.st_mtime_ns, state.st_size)
    except (OSError, ValueError):
        return None
    return run if run.owner != EVERYBODY or (place / "results").is_dir() else None


@lru_cache(maxsize=10_000)
def _parsed(path: Path, *_: int) -> WebRun:
    run = WebRun.model_validate_json(path.read_bytes())
    if run.id != path.parent.name:
        raise ValueError(run.id)
    return run


def _told_of(run_id: str, results: Path, record: Mapping[str, Any], written: float) -> WebRun:
    """The run of what a command wrote: of a validation the campaign's, of another the name of its folder."""
    verb = str((record.get("command") or ["", ""])[1])
    about = dict(record.get("configuration") or {}).get("campaign" if verb == "validate" else "scenario") or {}
    kind = {"validate": "validation"}.get(verb, verb)
    name = str(about.get("name") or results.name)
    return WebRun(
        id=run_id, owner=EVERYBODY, kind=kind, name=name, title=str(about.get("title") or name), created=written,
        state="finished", version=str(record.get("hyperval", "")), summary=summary_of(kind, results),
    )  # fmt: skip


def summary_of(kind: str, results: Path) -> dict[str, Any]:
    """What a list and a page say of a folder of results: the numbers of a study, the verdict of anything else."""
    if kind == "study":
        with (results / CSV).open(encoding="utf-8", newline="") as file:
            told = [{k: row[k] for k in _STUDY_COLUMNS} for row in csv.DictReader(file)]
        return {"rows": told[:MOST_LISTED], "left_out": max(0, len(told) - MOST_LISTED)}
    rows = list(Run.open(results).table)
    counts = Counter(str(row.outcome) for row in rows if row.planned)
    screen = first_screen(rows)
    said = (f"{screen.head}. {screen.lead}", screen.words) if counts else ("One side alone: nothing is compared.",) * 2
    return {
        "tone": str(screen.outcome), "status": said[0], "verdict": said[1], "counts": dict(counts), "rows": len(rows),
    }  # fmt: skip


_SCRIPTS = (("hyperval.figures", ".", "charts.js"), ("hyperval.web", "static", "map.js"))


def view_name(stem: str) -> str:
    """The name of a file that the scripts of this version draw."""
    return f"{stem}-{_scripts()}.json"


@lru_cache(maxsize=1)
def _scripts() -> str:
    digest = hashlib.sha256()
    for package, folder, name in _SCRIPTS:
        digest.update((resources.files(package) / folder / name).read_bytes())
    return digest.hexdigest()[:8]
