"""Runs of a server: a folder each, whose ``run.json`` holds its state; the limits of the server, and its workers.

Workers are the server's own processes, or those of a Dask scheduler, which reach the server's folder under the same
path: a task reads and writes its run's folder, reports its progress there, and looks there whether it was cancelled.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import math
import os
import re
import secrets
import shutil
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from multiprocessing import set_forkserver_preload
from pathlib import Path
from queue import Full
from types import MappingProxyType
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

import hyperval
from hyperval.errors import HypervalError, internal_error, reader
from hyperval.executors import NOTHING, Cancelled, Process, TaskFailed, TaskPool, Worker, Workers, WorkerTask, workers
from hyperval.progress import set_listener
from hyperval.report import first_screen
from hyperval.run import Run, is_run, provenance_of
from hyperval.storage import installed_file, size_of, write_text
from hyperval.web.refusal import FieldMistake, Refusal, deny, error_text

MEGABYTE = 1_000_000
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


@dataclass(frozen=True)
class ServerSettings:
    """How one server is run, and its bounds.

    Attributes
    ----------
    folder : runs and uploads;  campaigns : folder of campaigns that may be run, None: none
    data : folder whose cubes and regions may be named, None: none
    hosts : names under which browsers reach it
    secure : whether it is reached by HTTPS alone, through a proxy
    scheduler : address of a Dask scheduler whose workers carry the tasks out, None: processes of this machine
    body_bytes, upload_bytes : of one request; of one that brings a file
    quick_seconds, long_seconds : of a prediction or chart; of a study, campaign or pipeline
    memory_bytes : of one worker
    quick_workers, long_workers : processes of either kind
    queue : runs that wait, of either kind; per_session : runs of one session that wait or run
    kept_bytes, kept_days : finished runs and uploads; the oldest go first
    points : of a study;  samples : pixels of an uploaded cube, times its bands
    """

    folder: Path
    campaigns: Path | None = None
    data: Path | None = None
    hosts: tuple[str, ...] = LOOPBACK
    secure: bool = False
    scheduler: str | None = None
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


ENDED = ("finished", "failed", "cancelled", "lost")
_ID = re.compile(r"[A-Za-z0-9_-]{16}")
EVERYBODY = ""  # the owner of what commands wrote
MAX_LISTED = 40
_COMMANDS = ("hyperval", "__main__.py")  # by which this program is started
_STUDY_COLUMNS = ("subject", "method", "metric", "value", "unit", "reason")
_DRAWING = installed_file("hyperval.figures", "charts.js"), installed_file("hyperval.web", "static", "map.js")
_SCRIPTS = hashlib.sha256(b"".join(file.read_bytes() for file in _DRAWING)).hexdigest()[:8]
COLLECTION = "collection"  # folder of a run that keeps what its campaign simulates
Files = Mapping[str, str | Path]  # name in the folder of a run -> its text, or the path of what is copied


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
    if run.id != path.parent.name:  # of a folder that was copied
        raise ValueError(run.id)
    return run


@reader
def _run_of_results(results: Path, record: Mapping[str, Any], **more: Any) -> WebRun:
    """The run of results that a command or script wrote, named by its campaign or scenario, else by its folder."""
    configuration: dict[str, Any] = dict(record.get("configuration") or {})
    about = next(filter(None, map(configuration.get, ("campaign", "study", "scenario"))), dict[str, Any]())
    program, *words = record.get("command") or ("",)
    verb = next((word for word in words if not word.startswith("-")), "") if program in _COMMANDS else ""
    kind = {"validate": "validation", "": "validation" if "campaign" in configuration else "results"}.get(verb, verb)
    name = str(about.get("name") or results.name)
    return WebRun(
        owner=EVERYBODY, kind=kind, name=name, title=str(about.get("title") or name), state="finished",
        version=str(record.get("hyperval", "")), summary=summary_of(kind, results), **more,
    )  # fmt: skip


def summary_of(kind: str, results: Path) -> dict[str, Any]:
    """What a list and a page say of a folder of results: the numbers of a study, the verdict of anything else."""
    rows = list(Run.open(results).table)
    if kind == "study":
        listed = [{name: getattr(row, name) for name in _STUDY_COLUMNS} for row in rows[:MAX_LISTED]]
        return {"rows": listed, "left_out": max(0, len(rows) - MAX_LISTED)}
    counts = Counter(str(row.outcome) for row in rows if row.planned)
    screen = first_screen(rows)
    texts = (f"{screen.head}. {screen.lead}", screen.words) if counts else ("One side alone: nothing is compared.",) * 2
    return {
        "tone": str(screen.outcome), "status": texts[0], "verdict": texts[1], "counts": dict(counts), "rows": len(rows),
    }  # fmt: skip


def view_name(stem: str) -> str:
    """The name of a file that the scripts of this version draw."""
    return f"{stem}-{_SCRIPTS}.json"


class Runs:
    """Runs of one server, from order to result: the folders below ``runs``, each of which says how its run stands.

    A run on its way is its task, one that has ended its file.  One whose file says that it waits when a server starts
    is lost: the server that had it has ended.  Results that commands wrote elsewhere below the server's folder are runs
    too, which every session sees.

    Parameters
    ----------
    pools : what carries out quick tasks, and long ones; default: as the settings say
    """

    def __init__(self, settings: ServerSettings, pools: tuple[TaskPool, TaskPool] | None = None):
        self.folder, self._settings = settings.folder, settings
        self.notices: list[str] = []
        self._tasks: dict[tuple[str, object], WorkerTask] = {}  # by owner and run, or by run and file
        self._changed = threading.Condition()
        self._unwritten: dict[str, WebRun] = {}  # runs that ended when the disk was full
        self._clearing, self._cleared = threading.Lock(), 0.0
        (self.folder / "runs").mkdir(parents=True, exist_ok=True)
        self._recover()
        self.clear()
        new = partial(WorkerPool, most=settings.queue, memory_bytes=settings.memory_bytes, scheduler=settings.scheduler)
        self.quick, self.long = pools or (
            new(settings.quick_workers, seconds=settings.quick_seconds),
            new(settings.long_workers, seconds=settings.long_seconds),
        )

    def _recover(self) -> None:
        runs = {run.id: run for run in self._all_runs()}
        unreadable = [p for p in (self.folder / "runs").iterdir() if _ID.fullmatch(p.name) and p.name not in runs]
        lost = [run for run in runs.values() if run.state not in ENDED]
        for place in unreadable:
            shutil.rmtree(place, ignore_errors=True)
        for run in lost:
            self._write_end(run, state="lost", reason="the server stopped before the run had finished")
        if lost:
            self.notices.append(f"{len(lost)} runs had not finished when the server stopped, and are lost.")
        if unreadable:
            self.notices.append(f"{len(unreadable)} folders of runs could not be read and were removed.")

    def place(self, run_id: str) -> Path:
        """The folder of a run."""
        return self.folder / "runs" / run_id

    def _current(self, place: Path) -> WebRun | None:
        """The current state of the run of a folder; None where the folder has no record of one."""
        run = self._unwritten.get(place.name) or _read(place)
        if run is None or run.state in ENDED:
            return run
        task = self._tasks.get((run.owner, run.id))
        return run.model_copy(update={"state": "running"}) if task is not None and task.started else run

    def _all_runs(self) -> list[WebRun]:
        """The runs of all sessions."""
        return [run for place in (self.folder / "runs").iterdir() if (run := self._current(place)) is not None]

    def run(self, run_id: str, owner: str) -> WebRun:
        """A run that a session sees.

        Raises
        ------
        Refusal : there is none by that name, or it is another session's.
        """
        run = self._current(self.place(run_id)) if _ID.fullmatch(run_id) else None
        if run is None or run.owner not in (owner, EVERYBODY):
            raise Refusal(404, "there is no such run in this session")
        return run

    def visible_to(self, owner: str, kind: str | None = None) -> list[WebRun]:
        """Runs that a session sees, the latest first."""
        self._register_results()
        some = [r for r in self._all_runs() if r.owner in (owner, EVERYBODY) and kind in (None, r.kind)]
        return sorted(some, key=lambda r: -r.created)

    def _register_results(self) -> None:
        """Give what commands wrote below the server's folder a run whose results are a link to it."""
        groups = [place for place in self.folder.iterdir() if place.name not in ("runs", "uploads", "cache")]
        folders = (path for group in groups for path in (group, *group.glob("*/")) if not path.name.startswith("."))
        for path in filter(is_run, folders):
            run_id = hashlib.sha256(str(path.relative_to(self.folder)).encode()).hexdigest()[:16]
            place = self.place(run_id)
            old = _read(place)
            with suppress(OSError, HypervalError):  # it is being written, or no page can tell of it
                written = path.stat().st_mtime
                if (old is None or old.created != written) and (record := provenance_of(path)):
                    run = _run_of_results(path, record, id=run_id, created=written)
                    place.mkdir(mode=0o700, exist_ok=True)
                    if not (place / "results").is_symlink():
                        (place / "results").symlink_to(path.resolve(), target_is_directory=True)
                    self._write(run)

    def _write(self, run: WebRun) -> None:
        write_text(self.place(run.id) / "run.json", run.model_dump_json(indent=1) + "\n")

    def _write_end(self, run: WebRun, **changes: Any) -> None:
        """Write how a run ended; where that cannot be stored, no more can its results."""
        run = run.model_copy(update=changes)
        try:
            self._write(run)
        except OSError as full:
            lost = {"state": "failed", "reason": f"its results could not be stored: {full.strerror}", "summary": {}}
            self._unwritten[run.id] = run.model_copy(update=lost)

    def remove(self, run_id: str) -> None:
        """Forget a run and what came of it."""
        self._unwritten.pop(run_id, None)
        shutil.rmtree(self.place(run_id), ignore_errors=True)

    def clear(self) -> None:
        """Remove runs that are too old, and the oldest while all together are too large; looked at once a minute."""
        now = time.time()
        with self._clearing:
            if now < self._cleared + 60.0:
                return
            self._cleared = now
            kept = [(path.stat().st_mtime, path) for path in (self.folder / "uploads").glob("*/*/*")]
            ended = [run for run in self._all_runs() if run.state in ENDED and run.owner != EVERYBODY]
            kept += [(run.created, self.place(run.id)) for run in ended]
            sizes = [size_of(path) for _, path in kept]
            total = sum(sizes)
            for (created, path), size in sorted(zip(kept, sizes, strict=True)):
                if now - created > self._settings.kept_days * 86400.0 or total > self._settings.kept_bytes:
                    total -= size
                    shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)

    def _submit(
        self, key: tuple[str, object], pool: TaskPool, task: WorkerTask, end: Callable[[], None] = lambda: None
    ) -> None:
        """Give a task to the workers; when it has its result and ``end`` is done, it is on its way no more."""
        self._tasks[key] = task
        try:
            pool.submit(task)
        except Full:
            del self._tasks[key]
            raise Refusal(503, "as many runs wait as may; try again soon", wait=5) from None

        def ended(_: Future[Any]) -> None:
            try:
                end()
            finally:
                with self._changed:
                    self._tasks.pop(key, None)
                    self._changed.notify_all()

        task.future.add_done_callback(ended)

    def order(
        self, owner: str, kind: str, name: str, title: str, files: Files = MappingProxyType({}), **arguments: Any
    ) -> WebRun:
        """Take an order: a run whose folder begins with ``files``, and the arguments of its task.

        Raises
        ------
        Refusal : 429, the session has as many runs on their way as it may; 503, the queue or the disk is full.
        """
        with self._changed:
            count = sum(holder == owner for holder, _ in list(self._tasks))
            words = f"{count} of your runs wait or run; more are taken when one has finished"
            deny(count >= self._settings.per_session, 429, words, wait=2)
            about = {"owner": owner, "kind": kind, "name": name, "title": title, "version": hyperval.__version__}
            run = WebRun(id=secrets.token_urlsafe(12), created=time.time(), **about)
            place = self.place(run.id)
            task = WorkerTask(kind, {"folder": str(place), **arguments})
            try:
                place.mkdir(mode=0o700)
                for file, source in files.items():
                    target = place / file
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(source, target) if isinstance(source, Path) else write_text(target, source)
                self._write(run)
                pool = self.quick if kind == "prediction" else self.long
                self._submit((owner, run.id), pool, task, partial(self._end, run, task))
            except (OSError, Refusal) as error:
                shutil.rmtree(place, ignore_errors=True)
                if isinstance(error, Refusal):
                    raise
                raise Refusal(503, f"nothing can be stored for now: {error.strerror}", wait=60) from error
        return run

    def _end(self, run: WebRun, task: WorkerTask) -> None:
        seconds = time.monotonic() - task.started if task.started else 0.0
        error = task.future.exception()
        state = "finished" if error is None else "cancelled" if isinstance(error, Cancelled) else "failed"
        reason = "" if error is None or str(error) == state else str(error)
        summary = task.future.result() if error is None else {}
        self._write_end(run, state=state, seconds=seconds, reason=reason, summary=summary)
        self.clear()

    def wait(self, run: WebRun, seconds: float) -> None:
        """Wait until a run has ended, or for some time."""
        with self._changed:
            self._changed.wait_for(lambda: (run.owner, run.id) not in self._tasks, seconds)

    def progress(self, run: WebRun) -> dict[str, Any]:
        """Where a run on its way is: stage, part that is done, seconds left."""
        task = self._tasks.get((run.owner, run.id))
        if task is None or run.state in ENDED:
            return {"stage": "", "done": 1.0 if run.state == "finished" else 0.0, "seconds_left": None}
        what, done, total = task.progress
        stage, seconds = what or ("working" if task.started else "waiting"), task.seconds_left
        seconds = None if seconds is None else math.ceil(seconds)
        return {"stage": stage, "done": done / total if total else 0.0, "seconds_left": seconds}

    def cancel(self, run: WebRun) -> None:
        """Call a run off."""
        if task := self._tasks.get((run.owner, run.id)):
            task.is_cancelled = True

    def view(self, run: WebRun, task: str, name: str, /, **arguments: Any) -> Path:
        """A file beside a finished run, made by a worker where it is not there yet.

        Raises
        ------
        Refusal : it cannot be made, or the run has no results.
        """
        deny(run.state != "finished", 409, f"this run has no results: {run.reason or run.state}")
        place, version = self.place(run.id), hyperval.__version__
        if (place / name).exists():
            return place / name
        if task in ("files", "draw") and run.version != version:  # the scenario would give other numbers
            raise Refusal(409, f"the run was made by version {run.version}, and this is {version}: run it again")
        with self._changed:
            job = self._tasks.get((run.id, name)) or WorkerTask(task, {"folder": str(place), **arguments})
            if (run.id, name) not in self._tasks:
                self._submit((run.id, name), self.long if task == COLLECTION else self.quick, job)
        self._result(job, self._settings.quick_seconds * 2)
        return place / name

    def ask(self, task: str, field: str = "", **arguments: Any) -> Any:
        """The result of a quick task that belongs to no run.

        Parameters
        ----------
        field : of the form, which has the mistake if the task fails

        Raises
        ------
        Refusal : it failed, or the queue is full.
        """
        job = WorkerTask(task, arguments)
        self._submit(("", job), self.quick, job)
        return self._result(job, self._settings.quick_seconds, field)

    def _result(self, task: WorkerTask, seconds: float, field: str = "") -> Any:
        try:
            return task.future.result(seconds)
        except TimeoutError:
            raise Refusal(503, "the server is busy; try again soon", wait=5) from None
        except TaskFailed as error:
            raise Refusal(422 if field else 409, [FieldMistake(field, str(error))]) from error

    def close(self) -> None:
        """End the workers."""
        for pool in (self.quick, self.long):
            pool.close()


__all__ = ["Cancelled", "Full", "TaskFailed", "WorkerPool", "WorkerTask"]
TASKS = "hyperval.web.tasks"


class WorkerPool(TaskPool):
    """Some workers that share a bounded queue of tasks.

    Parameters
    ----------
    count : of processes;  most : tasks that wait;  seconds : for a task;  memory_bytes : of a process
    scheduler : address of a Dask scheduler, whose workers then take the place of processes and have limits of their own
    module : what holds the tasks, ``TASKS`` by name, of which ``warm`` loads what the others need

    Raises
    ------
    UsageError : Dask is not installed, or no scheduler answers.
    """

    def __init__(
        self, count: int, most: int, seconds: float, memory_bytes: int, scheduler: str | None = None,
        module: str = TASKS,
    ):  # fmt: skip
        self._stack = ExitStack()
        set_forkserver_preload([module])
        perform = partial(perform_task, module)
        start: Callable[[], Worker] = partial(Process, perform, partial(perform, "warm", {}), memory_bytes)
        if scheduler is not None:
            places = self._stack.enter_context(workers(scheduler=scheduler))
            start, count = partial(_ClusterWorker, places, module), places.width
        super().__init__(start, count, most=most, seconds=seconds)

    def close(self) -> None:
        """Call off what is on its way, and end the workers or leave their scheduler."""
        super().close()
        self._stack.close()


def perform_task(module: str, task: str, arguments: Mapping[str, Any]) -> Any:
    """Run a task and return its result; an error becomes a TaskFailed in words for whoever asked."""
    try:
        return importlib.import_module(module).TASKS[task](**arguments)
    except TaskFailed:
        raise
    except HypervalError as error:
        words = error_text(error)
    except MemoryError:
        words = "it needs more memory than this server gives to one run"
    except OSError as error:
        print(f"hyperval serve: {error}", file=sys.stderr)
        words = f"a file could not be written or read: {error.strerror}"
    except Exception as error:
        print(f"hyperval serve: {internal_error(error)}", file=sys.stderr)
        words = "an internal error; the server's log has it"
    raise TaskFailed(words)


_TICK_S = 0.2
_NEWS, _STOP = ".news.json", ".stop"  # in the folder of a run
_NOWHERE = Path(os.devnull)  # of a task that has no folder: below it are no files
_alone = threading.Lock()  # a worker of several threads has one listener, and one library that draws


class _ClusterWorker:
    """A worker of a scheduler: its task writes its progress into the folder of the run."""

    def __init__(self, places: Workers, module: str):
        self._at, self._module = places, module
        self._future: Future[Any] = Future()  # of no task yet
        self._folder = _NOWHERE

    def is_alive(self) -> bool:
        """The scheduler looks after its workers."""
        return True

    def begin(self, task: WorkerTask) -> None:
        """Hand a task in."""
        self._folder = Path(task.arguments.get("folder", _NOWHERE))
        with suppress(NotADirectoryError):
            for name in (_NEWS, _STOP):
                (self._folder / name).unlink(missing_ok=True)
        self._future = self._at.submit(run, (self._module, task.task, dict(task.arguments)))

    def news(self) -> tuple[str, Any]:
        """What has become of the task, or what it told last."""
        try:
            return "result", self._future.result(_TICK_S)
        except TimeoutError:
            with suppress(OSError, ValueError):
                return "progress", tuple(json.loads((self._folder / _NEWS).read_text("utf-8")))
            return ("progress", ("", 0, None)) if self._folder == _NOWHERE else NOTHING
        except TaskFailed as error:
            return "error", error
        except Exception as error:  # the scheduler or a worker has gone
            return "error", TaskFailed(f"the cluster could not carry it out ({type(error).__name__})")

    def end(self) -> None:
        """Call the task off."""
        self._future.cancel()
        with suppress(OSError):
            (self._folder / _STOP).touch()


def run(call: tuple[str, str, Mapping[str, Any]]) -> Any:
    """On a worker: carry a task of a module out, with news of it in its folder."""
    module, task, arguments = call
    folder, latest = Path(arguments.get("folder", "")), 0.0

    def report(what: str, done: int, total: int | None) -> None:
        nonlocal latest
        if "folder" not in arguments or time.monotonic() - latest < _TICK_S:
            return
        latest = time.monotonic()
        if (folder / _STOP).exists():
            raise Cancelled("on request")
        write_text(folder / _NEWS, json.dumps([what, done, total]))

    with _alone:
        os.environ["HYPERVAL_WORKERS"] = "1"
        set_listener(report)
        try:
            report("working", 0, None)
            return perform_task(module, task, arguments)
        finally:
            set_listener(None)
