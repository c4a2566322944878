"""Processes that do the work: warm, bounded in time and memory, ended and replaced where they exceed either.

Tasks on the workers of a Dask scheduler, for groups larger than one machine serves.

The folder of the server is reached by every worker under the same path: a task reads and writes its run's folder,
tells there how far it is, and looks there whether it is called off.
"""

from __future__ import annotations

import importlib
import json
import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from hyperval.errors import HypervalError
from hyperval.executors import workers
from hyperval.web.refusal import said

_TICK_S = 0.1
_START_S = 600.0  # the first on a machine computes an atmosphere
Task = Callable[..., Any]


class TaskFailed(Exception):
    """A task that came to no result; the message is for who asked."""


class Cancelled(TaskFailed):
    """A task that was called off."""


class Full(Exception):
    """No more tasks are taken for now."""


@dataclass(eq=False)
class WorkerTask:
    """A task on its way: ``future`` gives what it returns, or raises :class:`TaskFailed`."""

    task: str
    arguments: Mapping[str, Any]
    begun: Callable[[], None] | None = None
    future: Future[Any] = field(default_factory=Future)
    progress: tuple[str, int, int | None] = ("", 0, None)
    started: float = 0.0
    is_cancelled: bool = False

    @property
    def seconds_left(self) -> float | None:
        """How long the stage that it is at goes on at its pace so far; None where that is not known."""
        _, done, total = self.progress
        if not total or not done or not self.started:
            return None
        return (time.monotonic() - self.started) / done * (total - done)


class WorkerPool:
    """Some processes that share a bounded queue of tasks.

    Parameters
    ----------
    count : of processes;  most : tasks that wait;  seconds : for a task;  memory_bytes : of a process
    module : what holds the tasks: ``TASKS`` by name, and ``warm``, which loads what they need
    """

    def __init__(self, count: int, most: int, seconds: float, memory_bytes: int, module: str = "hyperval.web.tasks"):
        self._queue: queue.Queue[WorkerTask | None] = queue.Queue(most)
        self._seconds, self._memory, self._module = seconds, memory_bytes, module
        self._is_closed = False
        self._threads = [threading.Thread(target=self._run, daemon=True) for _ in range(count)]
        for thread in self._threads:
            thread.start()

    def submit(self, job: WorkerTask) -> WorkerTask:
        """Take a task.

        Raises
        ------
        Full : as many as may wait do.
        """
        try:
            self._queue.put_nowait(job)
        except queue.Full:
            raise Full from None
        return job

    @property
    def waiting(self) -> int:
        """Tasks that wait."""
        return self._queue.qsize()

    def close(self) -> None:
        """End every process; tasks on their way are called off."""
        self._is_closed = True
        for _ in self._threads:
            with suppress(queue.Full):
                self._queue.put_nowait(None)
        for thread in self._threads:
            thread.join(10.0)

    def _run(self) -> None:
        worker = _Worker(self._memory, self._module)
        while not self._is_closed:
            try:
                job = self._queue.get(timeout=_TICK_S * 5)
            except queue.Empty:
                if not worker.is_alive():
                    worker = _Worker(self._memory, self._module)
                continue
            if job is None:
                break
            if job.is_cancelled:
                job.future.set_exception(Cancelled("cancelled before it began"))
                continue
            if not worker.is_alive():
                worker = _Worker(self._memory, self._module)
            try:
                result = self._result(worker, job)
            except TaskFailed as error:
                job.future.set_exception(error)
            except Exception as error:  # a future that is never set would be waited for without end
                worker.end()
                job.future.set_exception(TaskFailed(f"the worker could not be reached ({type(error).__name__})"))
            else:
                job.future.set_result(result)
        worker.end()

    def _result(self, worker: _Worker, job: WorkerTask) -> Any:
        worker.wait_ready(lambda: self._is_closed or job.is_cancelled)
        job.started = time.monotonic()
        if job.begun is not None:
            job.begun()
        worker.connection.send((job.task, dict(job.arguments)))
        while True:
            if self._is_closed or job.is_cancelled:
                worker.end()
                raise Cancelled("the server was stopped" if self._is_closed else "cancelled")
            if time.monotonic() - job.started > self._seconds:
                worker.end()
                raise TaskFailed(f"it took longer than {self._seconds:g} s, which is the limit of this server")
            try:
                if not worker.connection.poll(_TICK_S):
                    continue
                what, value = worker.connection.recv()
            except (EOFError, OSError):
                worker.end()
                raise TaskFailed("its process was ended, most likely for want of memory") from None
            if what == "progress":
                job.progress = value
            elif what == "result":
                return value
            else:
                raise TaskFailed(value)


class _Worker:
    """One process with a pipe to it."""

    def __init__(self, memory_bytes: int, module: str):
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self._process = context.Process(target=serve, args=(other, memory_bytes, module), daemon=True)
        self._process.start()
        other.close()
        self._is_ready = False

    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    def wait_ready(self, is_over: Callable[[], bool]) -> None:
        """Wait until the process has loaded what it needs."""
        end = time.monotonic() + _START_S
        while not self._is_ready:
            if is_over():
                raise Cancelled("cancelled before it began")
            if time.monotonic() > end or not (self.is_alive() or self.connection.poll()):
                self.end()
                raise TaskFailed("a worker could not be started")
            if self.connection.poll(_TICK_S):
                try:
                    self._is_ready = self.connection.recv() == ("ready", None)
                except (EOFError, OSError):
                    self.end()
                    raise TaskFailed("a worker could not be started") from None

    def end(self) -> None:
        """End the process and whatever it started."""
        if self._process.pid is not None and self._process.is_alive():
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
            with suppress(ProcessLookupError):
                os.kill(self._process.pid, signal.SIGKILL)
        self._process.join(5.0)
        self.connection.close()


def serve(connection: Connection, memory_bytes: int, module: str) -> None:
    """What a process does: load, say so, and carry out one task after the other until the pipe closes."""
    with suppress(OSError):
        os.setpgid(0, 0)  # what it starts ends with it
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, signal.SIG_IGN if name == signal.SIGINT else signal.SIG_DFL)
    os.environ["HYPERVAL_WORKERS"] = "1"
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    _bound_memory(memory_bytes)
    from hyperval.progress import set_listener

    tasks = importlib.import_module(module)
    tasks.warm()
    latest = [0.0]

    def report(what: str, done: int, total: int | None) -> None:
        if time.monotonic() - latest[0] > _TICK_S:
            latest[0] = time.monotonic()
            connection.send(("progress", (what, done, total)))

    set_listener(report)
    connection.send(("ready", None))
    while True:
        try:
            task, arguments = connection.recv()
        except (EOFError, OSError):
            return
        connection.send(outcome(tasks.TASKS[task], arguments))


def outcome(task: Task, arguments: Mapping[str, Any]) -> tuple[str, Any]:
    """What a task returns, or why it came to nothing, in words for who asked."""
    try:
        return "result", task(**arguments)
    except Cancelled:
        raise
    except HypervalError as error:
        return "failed", said(error)
    except MemoryError:
        return "failed", "it needs more memory than this server gives to one run"
    except OSError as error:
        print(f"hyperval serve: {error}", file=sys.stderr)
        return "failed", f"a file could not be written or read: {error.strerror}"
    except Exception as error:
        from hyperval.errors import internal_error

        print(f"hyperval serve: {internal_error(error)}", file=sys.stderr)
        return "failed", "an internal error; the server's log has it"


def _end_with(parent: int) -> None:
    """End this process, and what it started, when the server has been killed."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os.killpg(0, signal.SIGKILL)


def _bound_memory(bytes_: int) -> None:
    try:
        import resource
    except ImportError:  # another system
        return
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (bytes_, bytes_))


_SCHEDULER_TICK_S = 0.2
_NEWS, _STOP = ".news.json", ".stop"
_alone = threading.Lock()  # a worker of several threads has one listener, and one library that draws


class Cluster:
    """A bounded number of tasks on a scheduler's workers.

    Parameters
    ----------
    most : tasks that wait besides those that the workers can have at once
    seconds : for a task; memory is bounded by the workers themselves

    Raises
    ------
    UsageError : Dask is not installed, or no scheduler answers.
    """

    def __init__(self, address: str, most: int, seconds: float, module: str = "hyperval.web.tasks"):
        self._stack = ExitStack()
        at = self._stack.enter_context(workers(scheduler=address))
        assert at.executor is not None  # noqa: S101
        self._executor: Executor = at.executor
        self._places = threading.BoundedSemaphore(most + at.width)
        self._seconds, self._module = seconds, module
        self._is_closed = False

    def submit(self, job: WorkerTask) -> WorkerTask:
        """Take a task.

        Raises
        ------
        Full : as many as may are on their way.
        """
        if self._is_closed or not self._places.acquire(blocking=False):
            raise Full
        threading.Thread(target=self._attend, args=(job,), daemon=True).start()
        return job

    def close(self) -> None:
        """Call off what is on its way, and leave the scheduler."""
        self._is_closed = True
        self._stack.close()

    def _attend(self, job: WorkerTask) -> None:
        try:
            job.future.set_result(self._result(job))
        except TaskFailed as error:
            job.future.set_exception(error)
        except Exception as error:  # the scheduler or a worker has gone
            job.future.set_exception(TaskFailed(f"the cluster could not carry it out ({type(error).__name__})"))
        finally:
            self._places.release()

    def _result(self, job: WorkerTask) -> Any:
        folder = _folder(job.arguments)
        for name in (_NEWS, _STOP):
            if folder is not None:
                (folder / name).unlink(missing_ok=True)
        begin = time.monotonic()
        future = self._executor.submit(run, self._module, job.task, dict(job.arguments))
        while not future.done():
            with suppress(TimeoutError):
                future.exception(_SCHEDULER_TICK_S)
            self._read_news(job, folder)
            late = bool(job.started) and time.monotonic() - job.started > self._seconds
            if job.is_cancelled or self._is_closed or late:
                future.cancel()
                if folder is not None:
                    with suppress(OSError):
                        (folder / _STOP).touch()
                if late:
                    raise TaskFailed(f"it took longer than {self._seconds:g} s, which is the limit of this server")
                raise Cancelled("the server was stopped" if self._is_closed else "cancelled")
        job.started = job.started or begin
        what, value = future.result()
        if what != "result":
            raise TaskFailed(value)
        return value

    @staticmethod
    def _read_news(job: WorkerTask, folder: Path | None) -> None:
        if folder is None:
            return
        with suppress(OSError, ValueError):
            what, done, total = json.loads((folder / _NEWS).read_text("utf-8"))
            job.progress = (what, done, total)
            if not job.started:
                job.started = time.monotonic()
                if job.begun is not None:
                    job.begun()


def _folder(arguments: Mapping[str, Any]) -> Path | None:
    return Path(arguments["folder"]) if "folder" in arguments else None


def run(module: str, task: str, arguments: Mapping[str, Any]) -> tuple[str, Any]:
    """On a worker: carry a task out, with news of it in its folder."""
    import importlib

    from hyperval.progress import set_listener

    folder, latest = _folder(arguments), [0.0]

    def report(what: str, done: int, total: int | None) -> None:
        if folder is None or time.monotonic() - latest[0] < _SCHEDULER_TICK_S:
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
            return outcome(importlib.import_module(module).TASKS[task], arguments)
        except Cancelled as error:
            return "failed", str(error)
        finally:
            set_listener(None)
            if folder is not None:
                for name in (_NEWS, _STOP):
                    (folder / name).unlink(missing_ok=True)
