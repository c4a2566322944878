"""Who carries out the tasks of a server: its own processes, or the workers of a Dask scheduler.

On a scheduler's workers the folder of the server is reached under the same path: a task reads and writes its run's
folder, tells there how far it is, and looks there whether it is called off.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing import set_forkserver_preload
from pathlib import Path
from queue import Full
from typing import Any

from hyperval.errors import HypervalError, internal_error
from hyperval.executors import NOTHING, Cancelled, Process, TaskFailed, TaskPool, Worker, Workers, WorkerTask, workers
from hyperval.progress import set_listener
from hyperval.web.refusal import said

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
