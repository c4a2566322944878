"""Runs and what came of them: a folder each, whose run.json says how the run stands.

What one server takes on, and how long it keeps what came of it.

Names of what is kept beside a run to be drawn: other scripts draw other files, after an update too.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import shutil
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Literal

from hyperval.storage import write_text

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
    """

    folder: Path
    campaigns: Path | None = None
    hosts: tuple[str, ...] = LOOPBACK
    secure: bool = False
    limits: Limits = field(default_factory=Limits)
    data: Path | None = None


State = Literal["waiting", "running", "finished", "failed", "cancelled", "lost"]
KINDS = ("prediction", "study", "validation", "pipeline")
ENDED = ("finished", "failed", "cancelled", "lost")
_ID = re.compile(r"[A-Za-z0-9_-]{16}")
_DAY_S = 86400.0
COLLECTION = "collection"  # folder of a run that keeps what its campaign simulates


@dataclass(frozen=True)
class WebRun:
    """A run as its file has it.

    Attributes
    ----------
    id : of the folder;  owner : session that asked
    kind, name, title : what it is, and of what
    created, seconds : Unix time, and how long it took
    state, reason : how it stands, and why it has no results
    summary : what a list says of it
    """

    id: str
    owner: str
    kind: str
    name: str
    title: str = ""
    created: float = 0.0
    seconds: float = 0.0
    state: State = "waiting"
    reason: str = ""
    version: str = ""
    summary: Mapping[str, Any] = field(default_factory=dict)


class RunStore:
    """Runs of one server.

    A run whose file says that it waits or runs when a server starts is lost: the server that had it has ended.
    """

    def __init__(self, folder: Path, limits: Limits):
        self.folder, self.limits = folder, limits
        self.notices: list[str] = []
        self._lock = threading.RLock()
        self._runs: dict[str, WebRun] = {}
        self._bytes: dict[str, int] = {}
        (folder / "runs").mkdir(parents=True, exist_ok=True)
        self._read_all()
        self.clear()

    def _read_all(self) -> None:
        lost = unreadable = 0
        with self._lock:
            for place in (self.folder / "runs").iterdir():
                try:
                    record = json.loads((place / "run.json").read_text("utf-8"))
                    run = WebRun(**record)
                    if run.id != place.name or run.state not in (*ENDED, "waiting", "running"):
                        raise ValueError(run.id)
                except (OSError, ValueError, TypeError):
                    unreadable += 1
                    shutil.rmtree(place, ignore_errors=True)
                    continue
                self._runs[run.id] = run
                self._measure(run.id)
                if run.state not in ENDED:
                    lost += 1
                    with suppress(OSError):
                        self.change(run.id, state="lost", reason="the server ended while it waited or ran")
        if lost:
            self.notices.append(f"{lost} runs had not finished when the server ended, and are lost.")
        if unreadable:
            self.notices.append(f"{unreadable} folders of runs could not be read and were removed.")

    def _measure(self, run_id: str) -> None:
        self._bytes[run_id] = sum(p.stat().st_size for p in self.place(run_id).rglob("*") if p.is_file())

    def place(self, run_id: str) -> Path:
        """The folder of a run."""
        if not _ID.fullmatch(run_id):
            raise KeyError(run_id)
        return self.folder / "runs" / run_id

    def new(self, owner: str, kind: str, name: str, title: str, version: str) -> WebRun:
        """A run that waits, with its folder.

        Raises
        ------
        OSError : it cannot be written.
        """
        run = WebRun(secrets.token_urlsafe(12), owner, kind, name, title, time.time(), version=version)
        place = self.place(run.id)
        try:
            place.mkdir(mode=0o700)
            self._write(run)
        except OSError:
            shutil.rmtree(place, ignore_errors=True)
            raise
        with self._lock:
            self._runs[run.id] = run
        return run

    def _write(self, run: WebRun) -> None:
        write_text(self.place(run.id) / "run.json", json.dumps(asdict(run), indent=1) + "\n")

    def run(self, run_id: str, owner: str) -> WebRun:
        """A run of a session.

        Raises
        ------
        KeyError : there is none, or it is another session's.
        """
        run = self._runs[run_id]
        if run.owner != owner:
            raise KeyError(run_id)
        return run

    def runs(self, owner: str, kind: str | None = None) -> list[WebRun]:
        """Runs of a session, the latest first."""
        own = [r for r in list(self._runs.values()) if r.owner == owner and kind in (None, r.kind)]
        return sorted(own, key=lambda r: -r.created)

    def change(self, run_id: str, **changes: Any) -> WebRun:
        """Set entries of a run; in memory even where the file cannot be written.

        That a run has begun stands in memory alone: after a restart it is lost as one that waited is.
        """
        with self._lock:
            run = replace(self._runs[run_id], **changes)
            self._runs[run_id] = run
            if run.state == "running":
                return run
            self._write(run)
            if run.state in ENDED:
                self._measure(run_id)
        return run

    def remove(self, run_id: str) -> None:
        """Forget a run and what came of it."""
        with self._lock:
            self._runs.pop(run_id, None)
            self._bytes.pop(run_id, None)
            shutil.rmtree(self.place(run_id), ignore_errors=True)

    def clear(self) -> None:
        """Remove runs that are too old, and the oldest while all together are too large."""
        now = time.time()
        with self._lock:
            oldest = sorted((r for r in self._runs.values() if r.state in ENDED), key=lambda r: r.created)
            total = sum(self._bytes.values())
            for run in oldest:
                if total <= self.limits.kept_bytes and now - run.created <= self.limits.kept_days * _DAY_S:
                    break
                total -= self._bytes.get(run.id, 0)
                self.remove(run.id)


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
