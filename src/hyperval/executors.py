"""One seam for everything that runs many independent pieces: here, in processes, or on the workers of a cluster.

Callers take any ``concurrent.futures.Executor``.  :func:`workers` makes one; :func:`in_order` hands the pieces out
and gives the results back in the order of the pieces, a bounded number on the way, so that what comes out does not
depend on where the pieces ran.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from hyperval.errors import HypervalError, UsageError
from hyperval.processing.blas import available_cores, single_blas_thread

T = TypeVar("T")
R = TypeVar("R")
_RENEWALS = 3  # of a pool of processes that lost one


class WorkersLostError(HypervalError):
    """Processes died again and again while they worked (exit code 4)."""


class SerialExecutor(Executor):
    """Runs every piece at once, here."""

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Run ``fn`` and return its result as a future that is done."""
        future: Future[R] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@dataclass
class Workers:
    """An executor, how many pieces it runs at a time, and how to get another one when a process of it died.

    Attributes
    ----------
    renew : None where the executor looks after its workers itself, as a cluster's scheduler does
    """

    executor: Executor
    width: int = 1
    renew: Callable[[], Executor] | None = None


def worker_count(pieces: int | None = None) -> int:
    """Processes to use: HYPERVAL_WORKERS, or one per processor; never more than there are pieces.

    Raises
    ------
    UsageError : HYPERVAL_WORKERS is no whole number of 1 or more.
    """
    text = os.environ.get("HYPERVAL_WORKERS", "")
    if text and (not text.isdigit() or int(text) < 1):
        raise UsageError(f"HYPERVAL_WORKERS is {text!r}", expected="a whole number of 1 or more")
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
        yield Workers(SerialExecutor())
    else:
        yield from _processes(count)


def in_order(
    where: Workers | Executor, function: Callable[[T], R], pieces: Iterable[T], *, ahead: int | None = None
) -> Iterator[R]:
    """Results of ``function`` for every piece, in the order of the pieces, with one BLAS thread each.

    Parameters
    ----------
    ahead : pieces under way at once; default: two for each worker

    Raises
    ------
    WorkersLostError : processes died again and again.
    """
    at = where if isinstance(where, Workers) else Workers(where, int(getattr(where, "_max_workers", 1)))
    waiting: deque[tuple[T, Future[R] | None]] = deque()
    left, most = _RENEWALS, ahead or (2 * at.width if at.width > 1 else 1)
    source = iter(pieces)
    try:
        while True:
            while len(waiting) < most and (piece := next(source, _END)) is not _END:
                waiting.append((piece, None))
            if not waiting:
                return
            try:  # handing a piece in can be what finds the pool broken
                for k, (piece, future) in enumerate(waiting):
                    if future is None:
                        waiting[k] = piece, at.executor.submit(_single_threaded, function, piece)
                first = waiting[0][1]
                assert first is not None  # noqa: S101 - handed in above
                result = first.result()
            except BrokenExecutor as error:
                if at.renew is None or left == 0:
                    raise WorkersLostError(
                        f"a worker process died: {error}", mend="give it more memory, or fewer workers"
                    ) from error
                left -= 1
                at.executor = at.renew()
                waiting = deque((p, None) for p, _ in waiting)
                continue
            waiting.popleft()
            yield result
    finally:
        for _, future in waiting:
            if future is not None:
                future.cancel()


_END: Any = object()


def _single_threaded(function: Callable[[T], R], piece: T) -> R:
    """The piece with one BLAS thread: workers share the processors, and the last digits depend on the threads."""
    with single_blas_thread():
        return function(piece)


def _processes(count: int) -> Iterator[Workers]:
    made: list[ProcessPoolExecutor] = []

    def pool() -> Executor:
        # Spawned, not forked: this process may hold threads of the linear-algebra library.
        context = multiprocessing.get_context("spawn")
        made.append(ProcessPoolExecutor(count, mp_context=context, initializer=_leave_interrupts))
        return made[-1]

    try:
        yield Workers(pool(), count, pool)
    except BaseException:
        for each in made:
            each.shutdown(wait=False, cancel_futures=True)
        raise
    for each in made:
        each.shutdown()


def _leave_interrupts() -> None:
    """An interrupt reaches every process: this one leaves it to the one that hands out the pieces."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _dask(address: str) -> Iterator[Workers]:
    try:
        from hyperval.executors_dask import DaskExecutor
    except ImportError as error:
        raise UsageError(
            "--scheduler needs Dask, which is not installed", mend="install the extra: pip install 'hyperval[dask]'"
        ) from error
    with DaskExecutor(address) as executor:
        yield Workers(executor, executor.cores)
