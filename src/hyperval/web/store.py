"""Runs and what came of them: a folder each, which is the truth, and an index of them that can be made again."""

from __future__ import annotations

import json
import re
import secrets
import shutil
import sqlite3
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from hyperval.files import write_text
from hyperval.web.limits import Limits

State = Literal["waiting", "running", "finished", "failed", "cancelled", "lost"]
KINDS = ("prediction", "study", "validation", "pipeline")
ENDED = ("finished", "failed", "cancelled", "lost")
_ID = re.compile(r"[A-Za-z0-9_-]{16}")
_DAY_S = 86400.0
COLLECTION = "collection"  # folder of a run that keeps what its campaign simulates
_COLUMNS = "id TEXT PRIMARY KEY, owner TEXT, created REAL, state TEXT, bytes INTEGER, record TEXT"


@dataclass(frozen=True)
class Run:
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


class Store:
    """Runs of one server.

    A run whose file says that it waits or runs when a server starts is lost: the server that had it has ended.
    """

    def __init__(self, folder: Path, limits: Limits):
        self.folder, self.limits = folder, limits
        self.notices: list[str] = []
        self._lock = threading.RLock()
        self._runs: dict[str, Run] = {}
        (folder / "runs").mkdir(parents=True, exist_ok=True)
        self._database = self._opened()
        self._read_all()
        self.clear()

    # The index: lists and sizes without a walk through the folders.

    def _opened(self) -> sqlite3.Connection:
        path = self.folder / "index.sqlite"
        try:
            database = _connect(path)
            if database.execute("PRAGMA quick_check").fetchone() != ("ok",):
                raise sqlite3.DatabaseError("damaged")
            database.execute(f"CREATE TABLE IF NOT EXISTS runs ({_COLUMNS})")
            database.execute("SELECT id, owner, created, state, bytes, record FROM runs LIMIT 1")
        except sqlite3.DatabaseError as error:
            for left in self.folder.glob("index.sqlite*"):
                left.replace(left.with_name(left.name.replace("index.", "damaged-index.")))
            self.notices.append(
                f"The index of runs was damaged ({error}) and was made again from the runs' own files."
            )
            database = _connect(path)
            database.execute(f"CREATE TABLE runs ({_COLUMNS})")
        return database

    def _read_all(self) -> None:
        lost = unreadable = 0
        with self._lock:
            for place in (self.folder / "runs").iterdir():
                try:
                    record = json.loads((place / "run.json").read_text("utf-8"))
                    run = Run(**record)
                    if run.id != place.name or run.state not in (*ENDED, "waiting", "running"):
                        raise ValueError(run.id)
                except (OSError, ValueError, TypeError):
                    unreadable += 1
                    shutil.rmtree(place, ignore_errors=True)
                    continue
                self._runs[run.id] = run
                if run.state not in ENDED:
                    lost += 1
                    with suppress(OSError):
                        self.change(run.id, state="lost", reason="the server ended while it waited or ran")
            with suppress(sqlite3.DatabaseError):
                self._database.execute("DELETE FROM runs")
                for run in self._runs.values():
                    self._index(run)
        if lost:
            self.notices.append(f"{lost} runs had not finished when the server ended, and are lost.")
        if unreadable:
            self.notices.append(f"{unreadable} folders of runs could not be read and were removed.")

    def _index(self, run: Run) -> None:
        size = sum(p.stat().st_size for p in self.place(run.id).rglob("*") if p.is_file())
        self._database.execute(
            "INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?)",
            (run.id, run.owner, run.created, run.state, size, json.dumps(asdict(run))),
        )

    # Runs.

    def place(self, run_id: str) -> Path:
        """The folder of a run."""
        if not _ID.fullmatch(run_id):
            raise KeyError(run_id)
        return self.folder / "runs" / run_id

    def new(self, owner: str, kind: str, name: str, title: str, version: str) -> Run:
        """A run that waits, with its folder.

        Raises
        ------
        OSError : it cannot be written.
        """
        run = Run(secrets.token_urlsafe(12), owner, kind, name, title, time.time(), version=version)
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

    def _write(self, run: Run) -> None:
        write_text(self.place(run.id) / "run.json", json.dumps(asdict(run), indent=1) + "\n")

    def run(self, run_id: str, owner: str) -> Run:
        """A run of a session.

        Raises
        ------
        KeyError : there is none, or it is another session's.
        """
        run = self._runs[run_id]
        if run.owner != owner:
            raise KeyError(run_id)
        return run

    def runs(self, owner: str, kind: str | None = None) -> list[Run]:
        """Runs of a session, the latest first."""
        own = [r for r in list(self._runs.values()) if r.owner == owner and kind in (None, r.kind)]
        return sorted(own, key=lambda r: -r.created)

    def change(self, run_id: str, **changes: Any) -> Run:
        """Set entries of a run; in memory even where the file cannot be written.

        That a run has begun stands in memory alone: after a restart it is lost as one that waited is.
        """
        with self._lock:
            run = replace(self._runs[run_id], **changes)
            self._runs[run_id] = run
            if run.state == "running":
                return run
            try:
                self._write(run)
                if run.state in ENDED:
                    self._index(run)
            except sqlite3.DatabaseError:
                self._remake()
        return run

    def _remake(self) -> None:
        """A new index, made from what is known, in place of one that was damaged while the server ran."""
        with suppress(sqlite3.DatabaseError, OSError):
            self._database.close()
            self._database = self._opened()
            for run in self._runs.values():
                self._index(run)

    def remove(self, run_id: str) -> None:
        """Forget a run and what came of it."""
        with self._lock:
            self._runs.pop(run_id, None)
            shutil.rmtree(self.place(run_id), ignore_errors=True)
            with suppress(sqlite3.DatabaseError):
                self._database.execute("DELETE FROM runs WHERE id = ?", (run_id,))

    def clear(self) -> None:
        """Remove runs that are too old, and the oldest while all together are too large."""
        now = time.time()
        with self._lock:
            try:
                sizes = dict(self._database.execute("SELECT id, bytes FROM runs").fetchall())
            except sqlite3.DatabaseError:
                return
            oldest = sorted((r for r in self._runs.values() if r.state in ENDED), key=lambda r: r.created)
            total = sum(sizes.values())
            for run in oldest:
                if total <= self.limits.kept_bytes and now - run.created <= self.limits.kept_days * _DAY_S:
                    break
                total -= sizes.get(run.id, 0)
                self.remove(run.id)

    def close(self) -> None:
        """Close the index."""
        self._database.close()


def _connect(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0)
    # Nobody waits for the disk: the folders of runs are the truth, and a damaged index is made again from them.
    database.execute("PRAGMA synchronous = OFF")
    return database
