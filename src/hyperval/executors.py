"""Where independent pieces run: in this process, in others, or on the workers of a Dask scheduler.

Callers take any ``concurrent.futures.Executor``.  :func:`workers` makes one; :func:`in_order` hands the pieces out
and gives the results back in the order of the pieces, a bounded number on the way, so that what comes out does not
depend on where the pieces ran.  Every piece has one BLAS thread: workers share the processors, and the last digits
of a solve depend on the number of threads.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import pickle
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, lru_cache
from itertools import islice
from multiprocessing.connection import Connection, wait
from pathlib import Path
from threading import Thread
from types import FrameType
from typing import Any, NoReturn, TypeVar

import scipy.linalg  # noqa: F401 - its BLAS is there before the libraries are counted
from threadpoolctl import ThreadpoolController

from hyperval.errors import HypervalError, UsageError
from hyperval.storage import scratch_folder

T = TypeVar("T")
R = TypeVar("R")
_RENEWALS = 3  # of a pool of processes that lost one
_START_S = 20.0  # for a scheduler to answer
_CONNECT_S = 5.0  # a worker that is gone is not called for longer
_UNWIND_S = 5.0  # for a piece to remove its temporary files when its run has ended


class WorkersLostError(HypervalError):
    """Processes died again and again while they worked (exit code 4)."""


class _RunEndedError(SystemExit):
    """The run that a piece works for has ended: unwinds the piece, so that its temporary files go."""


@dataclass
class Workers:
    """What runs pieces, how many at a time, and how to get another one when a process of it died.

    Attributes
    ----------
    executor : None: this process, each piece when its result is asked for
    renew : None where the executor looks after its workers itself, as a cluster's scheduler does
    losses : what a piece raises whose worker died
    """

    executor: Executor | None = None
    width: int = 1
    renew: Callable[[], Executor] | None = None
    losses: tuple[type[Exception], ...] = (BrokenExecutor, CancelledError)


@dataclass(frozen=True)
class Parcel:
    """What all pieces need, opened once in each process.

    Attributes
    ----------
    digest : by which parcels are told apart
    content : of the parcel itself, or None where processes of this machine read it from ``path``
    """

    digest: str
    content: bytes | None = field(default=None, compare=False, repr=False)
    path: Path | None = field(default=None, compare=False)

    def open(self) -> Any:
        """What was packed; the latest two stay open."""
        return _opened(self)


@lru_cache(maxsize=2)
def _opened(parcel: Parcel) -> Any:
    content = parcel.path.read_bytes() if parcel.path else parcel.content
    return pickle.loads(content or b"")  # noqa: S301 - made by this program a moment ago


@contextmanager
def parcel(where: Workers | Executor, value: Any) -> Iterator[Parcel]:
    """``value`` packed for the pieces that run inside the block.

    Pieces for a cluster carry it; processes of this machine read it from a file of their own, once each, since
    handing it to them piece by piece takes longer than the work does where the work is quick.
    """
    content = pickle.dumps(value, protocol=5)
    digest = hashlib.sha256(content).hexdigest()
    if not isinstance(where, Workers) or where.renew is None:
        yield Parcel(digest, content)
        return
    with scratch_folder("parcel") as folder:
        path = folder / "parcel"
        path.write_bytes(content)
        yield Parcel(digest, path=path)


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


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
        yield Workers()
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
    if at.executor is None:
        yield from (_single_threaded(function, piece) for piece in pieces)
        return
    left, most = _RENEWALS, ahead or 2 * at.width
    source = iter(pieces)
    waiting, futures = deque[T](), deque[Future[R]]()
    try:
        while True:
            waiting.extend(islice(source, most - len(waiting)))
            if not waiting:
                return
            try:  # handing a piece in can be what finds the pool broken
                futures.extend(
                    at.executor.submit(_single_threaded, function, piece)
                    for piece in islice(waiting, len(futures), None)
                )
                result = futures[0].result()
            except at.losses as error:
                if at.renew is None or left == 0:
                    raise WorkersLostError(
                        f"a worker process died: {error}", mend="give it more memory, or fewer workers"
                    ) from error
                left -= 1
                at.executor = at.renew()
                futures.clear()
                continue
            waiting.popleft()
            futures.popleft()
            yield result
    finally:
        for future in futures:
            future.cancel()


def _single_threaded(function: Callable[[T], R], piece: T) -> R:
    try:
        try:
            _signals.in_piece = True
            with single_blas_thread():
                return function(piece)
        finally:
            _signals.in_piece = False
            if _signals.ended:  # what the piece called kept it from unwinding
                os._exit(1)
    except _RunEndedError:
        os._exit(1)  # the pool would take it for the piece's result, and hand out the next one


def _processes(count: int) -> Iterator[Workers]:
    made: list[ProcessPoolExecutor] = []
    # Spawned, not forked: this process may hold threads of the linear-algebra library.
    context = multiprocessing.get_context("spawn")
    ended, end = context.Pipe(duplex=False)

    def pool() -> Executor:
        made.append(ProcessPoolExecutor(count, mp_context=context, initializer=_attend, initargs=(ended,)))
        return made[-1]

    try:
        yield Workers(pool(), count, pool)
        for each in made:
            each.shutdown()
    except BaseException:
        end.close()  # the workers see it; the pool would let them finish their pieces
        for each in made:
            each.shutdown(wait=False, cancel_futures=True)
        raise
    finally:
        end.close()
        ended.close()


def _attend(ended: Connection) -> None:
    """In a worker: leave interrupts to the process that hands out the pieces, and end when its run does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _unwind)
    Thread(target=_end_with_run, args=(ended,), daemon=True).start()


@dataclass
class _Signals:
    """In a worker: whether the main thread is in a piece, and whether the worker was told to end."""

    in_piece: bool = False
    ended: bool = False


_signals = _Signals()


def _unwind(signum: int, frame: FrameType | None) -> NoReturn:
    """End this worker: a piece unwinds first; outside one the pool would keep what is raised, and wait for ever."""
    _signals.ended = True
    if not _signals.in_piece:
        os._exit(1)
    raise _RunEndedError


def _end_with_run(ended: Connection) -> None:
    """Wait until the other end is closed, by the run or by the end of its process, however that came."""
    wait([ended])
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_UNWIND_S)
    os._exit(1)


def _dask(address: str) -> Iterator[Workers]:
    try:
        import dask.config
        from distributed import Client, KilledWorker
    except ImportError as error:
        raise UsageError(
            "--scheduler needs Dask, which is not installed", mend="install the extra: pip install 'hyperval[dask]'"
        ) from error
    with dask.config.set({"distributed.comm.timeouts.connect": f"{_CONNECT_S:g}s"}):
        try:
            client = Client(address, timeout=f"{_START_S:g}s", set_as_default=False)
        except (OSError, ValueError) as error:
            raise UsageError(
                f"no Dask scheduler answers at {address}", expected="an address such as tcp://node:8786"
            ) from error
        with client:
            # Nothing is kept by its arguments, so that equal pieces run each for itself.
            width = max(1, sum(client.ncores().values()))
            yield Workers(client.get_executor(pure=False), width, losses=(CancelledError, KilledWorker))
