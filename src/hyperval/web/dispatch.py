"""The desk: takes orders of a session, hands them to the workers, and writes down what came of them.

Workers are the server's own processes, or those of a Dask scheduler.  There the folder of the server is reached under
the same path: a task reads and writes its run's folder, tells there how far it is, and looks there whether it is called
off.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing import set_forkserver_preload
from pathlib import Path
from queue import Full
from types import MappingProxyType
from typing import Any

import hyperval
from hyperval.errors import HypervalError, internal_error
from hyperval.executors import NOTHING, Cancelled, Process, TaskFailed, TaskPool, Worker, Workers, WorkerTask, workers
from hyperval.progress import set_listener
from hyperval.web.refusal import Refused, said
from hyperval.web.store import COLLECTION, ENDED, RunStore, ServerSettings, WebRun

_TASKS = {"prediction": "predict", "study": "study", "validation": "campaign", "pipeline": "pipeline"}


class Desk:
    """Runs of one server, from order to result.

    Parameters
    ----------
    pools : what carries out quick tasks, and long ones; default: as the settings say
    """

    def __init__(self, settings: ServerSettings, store: RunStore, pools: tuple[TaskPool, TaskPool] | None = None):
        limits = self.limits = settings.limits
        self.store = store
        of = partial(WorkerPool, most=limits.queue, memory_bytes=limits.memory_bytes, scheduler=settings.scheduler)
        self.quick, self.long = pools or (
            of(limits.quick_workers, seconds=limits.quick_seconds), of(limits.long_workers, seconds=limits.long_seconds)
        )  # fmt: skip
        self._jobs: dict[str, WorkerTask] = {}
        self._views: dict[tuple[str, ...], WorkerTask] = {}
        self._lock = threading.Lock()

    def order(
        self, owner: str, kind: str, name: str, title: str,
        files: Mapping[str, str | Path] = MappingProxyType({}), **arguments: Any,
    ) -> WebRun:  # fmt: skip
        """Take an order.

        Parameters
        ----------
        files : that the folder of the run begins with, as for :meth:`RunStore.new`
        arguments : of the task

        Raises
        ------
        Refused : 429, the session has as many runs on their way as it may; 503, the queue or the disk is full.
        """
        with self._lock:
            own = sum(self.store.known(run_id).owner == owner for run_id in list(self._jobs))
            if own >= self.limits.per_session:
                raise Refused(429, f"{own} of your runs wait or run; more are taken when one has finished", wait=2)
            try:
                run = self.store.new(owner, kind, name, title, hyperval.__version__, files)
            except OSError as error:
                raise Refused(503, f"nothing can be stored for now: {error.strerror}", wait=60) from error
            begun = partial(self._note, run.id, state="running")
            job = WorkerTask(_TASKS[kind], {"folder": str(self.store.place(run.id)), **arguments}, begun=begun)
            self._jobs[run.id] = job
            try:
                _submit(self.quick if kind == "prediction" else self.long, job)
            except Refused:
                del self._jobs[run.id]
                self.store.remove(run.id)
                raise
        job.future.add_done_callback(lambda future: self._end(run.id, job, future))
        return run

    def _note(self, run_id: str, **changes: Any) -> None:
        with suppress(OSError, KeyError):
            self.store.change(run_id, **changes)

    def _end(self, run_id: str, job: WorkerTask, future: Future[Any]) -> None:
        seconds = time.monotonic() - job.started if job.started else 0.0
        error = future.exception()
        try:
            if error is None:
                self.store.change(run_id, state="finished", seconds=seconds, summary=future.result())
            else:
                state = "cancelled" if isinstance(error, Cancelled) else "failed"
                self.store.change(run_id, state=state, seconds=seconds, reason=str(error))
        except OSError as full:
            self._note(run_id, state="failed", reason=f"its results could not be stored: {full.strerror}", summary={})
        except KeyError:
            pass  # removed meanwhile
        finally:
            self._jobs.pop(run_id, None)
        self.store.clear()

    def wait(self, run_id: str, seconds: float) -> None:
        """Wait until a run has ended, or for some time."""
        job = self._jobs.get(run_id)
        if job is None or not seconds:
            return
        ended = threading.Event()
        job.future.add_done_callback(lambda _: ended.set())
        end = time.monotonic() + min(seconds, 60.0)
        ended.wait(max(0.0, end - time.monotonic()))
        while run_id in self._jobs and time.monotonic() < end:  # what came of it is being written down
            time.sleep(0.002)

    def progress(self, run: WebRun) -> dict[str, Any]:
        """Where a run on its way is: stage, part that is done, seconds left."""
        job = self._jobs.get(run.id)
        if job is None or run.state in ENDED:
            return {"stage": "", "done": 1.0 if run.state == "finished" else 0.0, "seconds_left": None}
        what, done, total = job.progress
        left = job.seconds_left
        return {
            "stage": what or ("waiting" if not job.started else "working"),
            "done": done / total if total else 0.0,
            "seconds_left": None if left is None else math.ceil(left),
        }

    def cancel(self, run_id: str) -> None:
        """Call a run off."""
        job = self._jobs.get(run_id)
        if job is not None:
            job.is_cancelled = True

    def view(self, run: WebRun, task: str, name: str, /, **arguments: Any) -> Path:
        """A file beside a finished run, made by a worker where it is not there yet.

        Raises
        ------
        Refused : it cannot be made, or the run has no results.
        """
        if run.state != "finished":
            raise Refused(409, f"this run has no results: {run.reason or run.state}")
        path = self.store.place(run.id) / name
        if path.exists():
            return path
        if task in ("files", "draw") and run.version != hyperval.__version__:  # the scenario would give other numbers
            raise Refused(
                409, f"the run was made by version {run.version}, and this is {hyperval.__version__}: run it again"
            )
        key = (run.id, task, name)
        with self._lock:
            job = self._views.get(key)
            if job is None:
                job = WorkerTask(task, {"folder": str(self.store.place(run.id)), **arguments})
                _submit(self.long if task == COLLECTION else self.quick, job)
                self._views[key] = job
                job.future.add_done_callback(lambda _: self._views.pop(key, None))
        _result(job, self.limits.quick_seconds * 2)
        return path

    def ask(self, task: str, **arguments: Any) -> Any:
        """What a quick task returns that belongs to no run.

        Raises
        ------
        Refused : it came to nothing, or there is no room.
        """
        job = WorkerTask(task, arguments)
        _submit(self.quick, job)
        return _result(job, self.limits.quick_seconds)

    def close(self) -> None:
        """End the workers."""
        for pool in (self.quick, self.long):
            pool.close()


def _submit(pool: TaskPool, job: WorkerTask) -> None:
    try:
        pool.submit(job)
    except Full:
        raise Refused(503, "as many runs wait as may; try again soon", wait=5) from None


def _result(job: WorkerTask, seconds: float) -> Any:
    try:
        return job.future.result(seconds)
    except TimeoutError:
        raise Refused(503, "the server is busy; try again soon", wait=5) from None
    except TaskFailed as error:
        raise Refused(409, str(error)) from error


__all__ = ["Cancelled", "Full", "TaskFailed", "WorkerPool", "WorkerTask"]
TASKS = "hyperval.web.tasks"


class WorkerPool(TaskPool):
    """Some workers that share a bounded queue of tasks.

    Parameters
    ----------
    count : of processes;  most : tasks that wait;  seconds : for a task;  memory_bytes : of a process
    scheduler : address of a Dask scheduler, whose workers then take the place of processes and have limits of their own
    module : what holds the tasks: ``TASKS`` by name, and ``warm``, which loads what they need

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
        start: Callable[[], Worker] = partial(
            Process, partial(carried_out, module), partial(_warm, module), memory_bytes
        )
        if scheduler is not None:
            at = self._stack.enter_context(workers(scheduler=scheduler))
            start, count = partial(_Place, at, module), at.width
        super().__init__(start, count, most=most, seconds=seconds)

    def close(self) -> None:
        """Call off what is on its way, and end the workers or leave their scheduler."""
        super().close()
        self._stack.close()


def _warm(module: str) -> None:
    importlib.import_module(module).warm()


def carried_out(module: str, task: str, arguments: Mapping[str, Any]) -> Any:
    """What a task returns; why it came to nothing is told in words for who asked."""
    try:
        return importlib.import_module(module).TASKS[task](**arguments)
    except TaskFailed:
        raise
    except HypervalError as error:
        words = said(error)
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
_NEWS, _STOP = ".news.json", ".stop"
_alone = threading.Lock()  # a worker of several threads has one listener, and one library that draws


class _Place:
    """A place on a scheduler: its task tells in the run's folder how far it is."""

    def __init__(self, at: Workers, module: str):
        self._at, self._module = at, module
        self._folder: Path | None = None

    def is_alive(self) -> bool:
        """The scheduler looks after its workers."""
        return True

    def begin(self, task: WorkerTask, is_over: Callable[[], bool]) -> None:
        """Hand a task in, and wait until a worker has it."""
        self._folder = _folder(task.arguments)
        _clear(self._folder)
        self._future = self._at.submit(run, (self._module, task.task, dict(task.arguments)))
        while not (self._folder is None or self._future.done() or self._told()[0] or is_over()):
            time.sleep(_TICK_S)

    def news(self) -> tuple[str, Any]:
        """What has become of the task, or what it told last."""
        try:
            return "result", self._future.result(_TICK_S)
        except TimeoutError:
            return self._told()
        except TaskFailed as error:
            return "error", error
        except Exception as error:  # the scheduler or a worker has gone
            return "error", TaskFailed(f"the cluster could not carry it out ({type(error).__name__})")

    def _told(self) -> tuple[str, Any]:
        with suppress(OSError, ValueError):
            if self._folder is not None:
                return "progress", tuple(json.loads((self._folder / _NEWS).read_text("utf-8")))
        return NOTHING

    def end(self) -> None:
        """Call the task off."""
        self._future.cancel()
        with suppress(OSError):
            if self._folder is not None:
                (self._folder / _STOP).touch()


def _folder(arguments: Mapping[str, Any]) -> Path | None:
    return Path(arguments["folder"]) if "folder" in arguments else None


def _clear(folder: Path | None) -> None:
    for name in (_NEWS, _STOP):
        if folder is not None:
            (folder / name).unlink(missing_ok=True)


def run(call: tuple[str, str, Mapping[str, Any]]) -> Any:
    """On a worker: carry a task of a module out, with news of it in its folder."""
    module, task, arguments = call
    folder, latest = _folder(arguments), [0.0]

    def report(what: str, done: int, total: int | None) -> None:
        if folder is None or time.monotonic() - latest[0] < _TICK_S:
            return
        latest[0] = time.monotonic()
        if (folder / _STOP).exists():
            raise Cancelled("cancelled")
        part = folder / f"{_NEWS}.part"
        part.write_text(json.dumps([what, done, total]), "utf-8")
        part.replace(folder / _NEWS)

    with _alone:
        os.environ["HYPERVAL_WORKERS"] = "1"
        set_listener(report)
        try:
            report("working", 0, None)
            return carried_out(module, task, arguments)
        finally:
            set_listener(None)
            _clear(folder)
