"""The desk: takes orders of a session, hands them to the workers, and writes down what came of them."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Full
from types import MappingProxyType
from typing import Any

import hyperval
from hyperval.executors import Cancelled, TaskFailed, TaskPool, WorkerTask
from hyperval.web.refusal import Refused
from hyperval.web.store import COLLECTION, ENDED, RunStore, ServerSettings, WebRun
from hyperval.web.workers import WorkerPool

_TASKS = {"prediction": "predict", "study": "study", "validation": "campaign", "pipeline": "pipeline"}


class Desk:
    """Runs of one server, from order to result.

    Parameters
    ----------
    pools : what carries out quick tasks, and long ones; default: as the settings say
    """

    def __init__(self, settings: ServerSettings, store: RunStore, pools: tuple[TaskPool, TaskPool] | None = None):
        limits = settings.limits
        self.limits, self.store = limits, store

        def pool(count: int, seconds: float) -> TaskPool:
            return WorkerPool(count, limits.queue, seconds, limits.memory_bytes, settings.scheduler)

        self.quick, self.long = pools or (
            pool(limits.quick_workers, limits.quick_seconds), pool(limits.long_workers, limits.long_seconds)
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
