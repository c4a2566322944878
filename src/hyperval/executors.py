"""Where independent pieces run: in this process, in others, or on the workers of a Dask scheduler.

:func:`workers` makes them, of any ``concurrent.futures.Executor``; :func:`in_order` hands the pieces out
and gives the results back in the order of the pieces, a bounded number on the way, so that what comes out does not
depend on where the pieces ran.  Every piece has one BLAS thread: workers share the processors, and the last digits
of a solve depend on the number of threads.

:class:`TaskPool` is the one place that knows of workers which die, take too long or too much memory, or are called off.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache, lru_cache, partial
from itertools import islice
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Full, SimpleQueue
from types import FrameType, SimpleNamespace
from typing import Any, NoReturn, Protocol

import scipy.linalg  # noqa: F401 - its BLAS is there before the libraries are counted
from threadpoolctl import ThreadpoolController

from hyperval.errors import HypervalError, R, T, refusal, refuse
from hyperval.progress import bars, set_listener, within
from hyperval.storage import scratch_folder

Perform = Callable[[Any, Any], Any]
Prepare = Callable[[], object]
_RENEWALS = 3  # of a process that died with a piece
_SCHEDULER_S = 20.0  # for a scheduler to answer
_CONNECT_S = 5.0  # a worker that is gone is not called for longer
_START_S = 600  # for a process to load what it needs: the first on a machine computes an atmosphere
_UNWIND_S = 5.0  # for a piece to remove its temporary files when its run has ended
_TICK_S = 0.1
NOTHING: tuple[str, Any] = ("", None)


class WorkersLostError(HypervalError):
    """Processes died again and again while they worked (exit code 4)."""


class TaskFailed(Exception):
    """A task that came to no result; the message is for who asked."""


class Cancelled(TaskFailed):
    """A task that was called off."""


class TaskLost(TaskFailed):
    """A task whose process died."""


@dataclass(eq=False)
class WorkerTask:
    """A task on its way: ``future`` gives what it returns, or raises its error or :class:`TaskFailed`."""

    task: Any
    arguments: Any
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


class Worker(Protocol):
    """What carries out one task after the other: a process, or a place on a scheduler."""

    def is_alive(self) -> bool:
        """Whether it can take a task."""

    def begin(self, task: WorkerTask) -> None:
        """Hand a task in."""

    def news(self) -> tuple[str, Any]:
        """What comes in a moment: ("progress", how far it is), ("result", value), ("error", exception) or NOTHING.

        The first progress tells that the task has begun.
        """

    def end(self) -> None:
        """End what is on its way, and whatever it started."""


class TaskPool:
    """Some workers that share a queue of tasks, each attended by a thread of this process while it has one.

    Parameters
    ----------
    start : makes a worker; called again for each that has ended
    count : of workers;  most : tasks that wait, 0: any number;  seconds : for a task;  renewals : of one that died
    """

    def __init__(
        self, start: Callable[[], Worker], count: int, *, most: int = 0, seconds: float = math.inf, renewals: int = 0
    ):
        self._start, self._seconds, self._renewals = start, seconds, renewals
        self._room = threading.Semaphore(count + most if most else sys.maxsize)
        self._threads = ThreadPoolExecutor(count)
        self._idle: SimpleQueue[Worker] = SimpleQueue()
        self._is_closed = False
        for _ in range(count):
            self._idle.put(start())

    def submit(self, task: WorkerTask) -> WorkerTask:
        """Take a task.

        Raises
        ------
        Full : as many as may wait do, or the pool is closed.
        """
        if self._is_closed or not self._room.acquire(blocking=False):
            raise Full
        task.future = self._threads.submit(self._carried_out, task)
        task.future.add_done_callback(lambda _: self._room.release())
        return task

    def close(self) -> None:
        """End every worker; tasks on their way are called off."""
        self._is_closed = True
        self._threads.shutdown(cancel_futures=True)
        while not self._idle.empty():
            self._idle.get().end()

    def _carried_out(self, task: WorkerTask) -> Any:
        """What a task returns, of another worker where the first died; a worker that ended has one in its place."""
        worker = self._idle.get()
        try:
            for renewals in reversed(range(self._renewals + 1)):
                worker = worker if worker.is_alive() else self._start()
                try:
                    return self._result(task, worker)
                except TaskLost:
                    worker.end()
                    if not renewals or self._is_closed:
                        raise
        finally:
            self._idle.put(worker if worker.is_alive() or self._is_closed else self._start())

    def _result(self, task: WorkerTask, worker: Worker) -> Any:
        if self._is_closed or task.is_cancelled:
            raise Cancelled("cancelled before it began")
        worker.begin(task)
        while not (self._is_closed or task.is_cancelled):
            if task.started and time.monotonic() - task.started > self._seconds:
                worker.end()
                raise TaskFailed(f"it took longer than {self._seconds:g} s, which is the limit of this server")
            what, value = worker.news()
            if what == "result":
                return value
            if what == "error":
                raise value
            if what == "progress":
                task.progress, task.started = value, task.started or time.monotonic()
        worker.end()
        raise Cancelled("the server was stopped" if self._is_closed else "cancelled")


class Process:
    """A process that carries out tasks, warm, and ends with the one that made it.

    Parameters
    ----------
    perform : called there with each task and its arguments
    prepare : called there first;  memory_bytes : that it may take
    """

    def __init__(self, perform: Perform, prepare: Prepare | None = None, memory_bytes: int | None = None):
        # Not forked from this process, which may hold threads of the linear-algebra library; those of a server, whose
        # memory is bounded, are forked from one that has loaded its tasks once for all.
        context: Any = multiprocessing.get_context("spawn" if memory_bytes is None else "forkserver")
        self._connection, other = context.Pipe()
        arguments = other, perform, prepare, memory_bytes
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        other.close()

    def is_alive(self) -> bool:
        """Whether the process runs."""
        return bool(self._process.is_alive())

    def begin(self, task: WorkerTask) -> None:
        """Hand a task in, which begins when the process has loaded what it needs."""
        try:
            self._connection.send((task.task, task.arguments))
        except OSError:
            raise TaskLost("its process was ended") from None

    def news(self) -> tuple[str, Any]:
        """What the process says in a moment."""
        try:
            return self._connection.recv() if self._connection.poll(_TICK_S) else NOTHING
        except (EOFError, OSError):
            raise TaskLost("its process was killed, probably for lack of memory") from None

    def end(self) -> None:
        """End the process, whose task unwinds first, and whatever it started."""
        self._process.terminate()
        self._process.join(_UNWIND_S)
        self._connection.close()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid or 0, signal.SIGKILL)
        self._process.join(_UNWIND_S)


def _serve(connection: Connection, perform: Perform, prepare: Prepare | None, memory_bytes: int | None) -> None:
    """In a process: carry out one task after the other until the other end of the pipe is closed."""
    with suppress(OSError):
        os.setpgid(0, 0)  # what it starts ends with it
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for the process that hands out the tasks
    signal.signal(signal.SIGTERM, _unwind)
    os.environ["HYPERVAL_WORKERS"] = "1"
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if memory_bytes is not None:
        import resource  # of the systems that a server runs on

        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    if prepare is not None:
        signal.alarm(_START_S)  # which ends this process
        prepare()
        signal.alarm(0)
    latest = [0.0]

    def report(what: str, done: int, total: int | None) -> None:
        if time.monotonic() - latest[0] > _TICK_S:
            latest[0] = time.monotonic()
            connection.send(("progress", (what, done, total)))

    set_listener(report)
    while True:
        try:
            connection.send(_answer(perform, connection))
        except OSError:
            return
        except Exception as error:  # it cannot be packed
            connection.send(("error", TypeError(f"{type(error).__name__}: {error}")))


def _answer(perform: Perform, connection: Connection) -> tuple[str, Any]:
    try:
        call = connection.recv()
        connection.send(("progress", ("", 0, None)))
        return "result", perform(*call)
    except Exception as error:
        error.add_note(traceback.format_exc())
        return "error", error
    finally:
        if _ended.is_set():  # also where what the piece called kept it from unwinding
            os._exit(1)


_ended = threading.Event()


def _unwind(signum: int, frame: FrameType | None) -> NoReturn:
    """End this process: a task unwinds first, so that its temporary files go."""
    _ended.set()
    raise SystemExit(1)


def _end_with_parent() -> None:
    """In a process: end it with the one that made it, however that came to its end."""
    multiprocessing.parent_process().join()  # type: ignore[union-attr]
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_UNWIND_S)
    os.killpg(0, signal.SIGKILL)


@dataclass
class Workers:
    """What runs pieces, and how many at a time.

    Attributes
    ----------
    executor : None: this process, each piece when its result is asked for
    losses : what a piece raises whose worker died
    """

    executor: Executor | TaskPool | None = None
    width: int = 1
    losses: tuple[type[Exception], ...] = (TaskLost,)

    def submit(self, function: Callable[[T], R], piece: T) -> Future[R]:
        """Hand a piece in, which has one BLAS thread."""
        assert self.executor is not None  # noqa: S101
        if isinstance(self.executor, TaskPool):
            return self.executor.submit(WorkerTask(function, piece)).future
        return self.executor.submit(_in_worker, function, piece, command_line())


# What all pieces need, packed: itself, or the file that processes of this machine read it from.
Parcel = bytes | Path


@lru_cache(maxsize=2)
def opened(packed: Parcel) -> Any:
    """What was packed, once in each process; the latest two stay open."""
    return pickle.loads(packed.read_bytes() if isinstance(packed, Path) else packed)  # noqa: S301 - of this program


@contextmanager
def parcel(where: Workers, value: Any) -> Iterator[Parcel]:
    """``value`` packed for the pieces that run inside the block.

    Pieces for a cluster carry it; processes of this machine read it from a file of their own, once each, since
    handing it to them piece by piece takes longer than the work does where the work is quick.
    """
    content = pickle.dumps(value, protocol=5)
    if isinstance(where.executor, TaskPool):
        with scratch_folder("parcel") as folder:
            (folder / "parcel").write_bytes(content)
            yield folder / "parcel"
    else:
        yield content


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def single_blas_thread() -> Iterator[bool]:
    """Give matrix products and factorisations one thread each inside the block; the numbers are set back after.

    Yields whether that holds: True where the libraries are known or the environment already says one thread.
    """
    stated = "1" in (os.environ.get(f"{name}_NUM_THREADS") for name in ("OMP", "OPENBLAS", "MKL"))
    with _blas().limit(limits=1):
        yield stated or bool(_blas().info())


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


def worker_count(pieces: int | None = None) -> int:
    """Processes to use: HYPERVAL_WORKERS, or one per processor; never more than there are pieces.

    Raises
    ------
    UsageError : HYPERVAL_WORKERS is no whole number of 1 or more.
    """
    text = os.environ.get("HYPERVAL_WORKERS", "")
    refuse(text and (not text.isdigit() or int(text) < 1), "workers.count", text=text)
    count = int(text) if text else available_cores()
    return max(1, count if pieces is None else min(pieces, count))


@contextmanager
def workers(count: int = 1, scheduler: str | None = None) -> Iterator[Workers]:
    """Workers for the block: this process (``count`` 1), processes, or those of a Dask scheduler.

    Parameters
    ----------
    scheduler : address of a Dask scheduler, such as tcp://node:8786; ``count`` then does not matter

    Raises
    ------
    UsageError : Dask is not installed, or no scheduler answers at the address.
    """
    if scheduler is not None:
        yield from _dask(scheduler)
    elif count <= 1:
        yield Workers()
    else:
        with closing(TaskPool(partial(Process, _in_worker), count, renewals=_RENEWALS)) as pool:
            yield Workers(pool, count)


def in_order(
    where: Workers, function: Callable[[T], R], pieces: Iterable[T], *, ahead: int | None = None
) -> Iterator[R]:
    """Results of ``function`` for every piece, in the order of the pieces, with one BLAS thread each.

    Parameters
    ----------
    ahead : pieces under way at once; default: two for each worker

    Raises
    ------
    WorkersLostError : processes died again and again.
    """
    if where.executor is None:
        yield from map(single_blas_thread()(function), pieces)
        return
    source, futures = iter(pieces), deque[Future[R]]()
    try:
        while True:
            try:  # handing a piece in can be what finds a pool broken
                free = (ahead or 2 * where.width) - len(futures)
                futures.extend(where.submit(function, piece) for piece in islice(source, free))
                if not futures:
                    return
                result = futures.popleft().result()
            except where.losses as error:
                mend = "give it more memory, or fewer workers"
                raise WorkersLostError(f"a worker process died: {error}", mend=mend) from error
            yield result
    finally:
        for future in futures:
            future.cancel()


@bars(False)
@single_blas_thread()
def _in_worker(function: Callable[[T], R], piece: T, command: Sequence[str] = ()) -> R:
    with within(_command, command or None):
        return function(piece)


_command: ContextVar[Sequence[str]] = ContextVar("command", default=())  # of a piece that another machine runs


def under_command(*words: str) -> AbstractContextManager[None]:
    """What the user typed, for runs within the block."""
    return within(_command, words)


def command_line() -> list[str]:
    """What the user typed, on whichever machine a piece of it runs.

    >>> _in_worker(lambda _: command_line(), None, ["hyperval", "validate"])
    ['hyperval', 'validate']
    """
    return list(_command.get() or sys.argv)


def _dask(address: str) -> Iterator[Workers]:
    try:
        import dask.config
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise refusal("workers.dask") from error
    with dask.config.set({"distributed.comm.timeouts.connect": f"{_CONNECT_S:g}s"}):
        try:
            client = Client(address, timeout=f"{_SCHEDULER_S:g}s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise refusal("workers.scheduler", address=address) from error
        with client:
            # Nothing is kept by its arguments, so that equal pieces run each for itself.  Not by the client's executor:
            # its futures mistake a result that is lost just as it arrives, with its worker, for an error.
            hands: Any = SimpleNamespace(submit=partial(client.submit, pure=False))
            yield Workers(hands, max(1, sum(client.ncores().values())), losses=(CancelledError, KilledWorker))
