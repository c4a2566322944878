"""Tasks on the workers of a Dask scheduler, for groups larger than one machine serves.

The folder of the server is reached by every worker under the same path: a task reads and writes its run's folder,
tells there how far it is, and looks there whether it is called off.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from hyperval.executors import workers
from hyperval.web.workers import Cancelled, Full, Job, TaskFailed, outcome

_TICK_S = 0.2
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

    def submit(self, job: Job) -> Job:
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

    def _attend(self, job: Job) -> None:
        try:
            job.future.set_result(self._result(job))
        except TaskFailed as error:
            job.future.set_exception(error)
        except Exception as error:  # the scheduler or a worker has gone
            job.future.set_exception(TaskFailed(f"the cluster could not carry it out ({type(error).__name__})"))
        finally:
            self._places.release()

    def _result(self, job: Job) -> Any:
        folder = _folder(job.arguments)
        for name in (_NEWS, _STOP):
            if folder is not None:
                (folder / name).unlink(missing_ok=True)
        begin = time.monotonic()
        future = self._executor.submit(run, self._module, job.task, dict(job.arguments))
        while not future.done():
            with suppress(TimeoutError):
                future.exception(_TICK_S)
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
    def _read_news(job: Job, folder: Path | None) -> None:
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
            return outcome(importlib.import_module(module).TASKS[task], arguments)
        except Cancelled as error:
            return "failed", str(error)
        finally:
            set_listener(None)
            if folder is not None:
                for name in (_NEWS, _STOP):
                    (folder / name).unlink(missing_ok=True)
