"""The workers of a Dask scheduler as an executor that outlives the loss of some of them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Executor, Future
from typing import Any, TypeVar

import dask.config
from distributed import Client

from hyperval.errors import UsageError
from hyperval.executors import WorkersLostError

R = TypeVar("R")
_START_S = 20.0  # for the scheduler to answer
# Between looks at a piece that is under way, and for a result that is there to come; doubled with each try, so that
# a slow network is no loss.
_PATIENCE_S = 4.0
_CONNECT_S = 5.0  # a worker that is gone is not called for longer
_TRIES = 5  # of a piece whose result was lost with its worker


class DaskExecutor(Executor):
    """Pieces on the workers of a scheduler.

    The scheduler runs a piece again when its worker dies.  What it can not see is a result that was there and can
    no longer be fetched: such a piece is handed in anew.

    Parameters
    ----------
    address : of the scheduler, such as tcp://node:8786

    Attributes
    ----------
    cores : threads of all workers at the start

    Raises
    ------
    UsageError : no scheduler answers.
    """

    def __init__(self, address: str):
        self._settings = dask.config.set({"distributed.comm.timeouts.connect": f"{_CONNECT_S:g}s"})
        self._settings.__enter__()
        try:
            self.client = Client(address, timeout=f"{_START_S:g}s", set_as_default=False)
        except (OSError, ValueError) as error:
            self._settings.__exit__(None, None, None)
            raise UsageError(
                f"no Dask scheduler answers at {address}", expected="an address such as tcp://node:8786"
            ) from error
        self.cores = max(1, sum(self.client.ncores().values()))

    def submit(self, fn: Callable[..., R], /, *args: Any, **kwargs: Any) -> Future[R]:
        """Hand a piece in; nothing is kept by its arguments, so that equal pieces run each for itself."""
        return _Piece(lambda: self.client.submit(fn, *args, pure=False, **kwargs))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the scheduler; its workers stay."""
        del wait, cancel_futures
        self.client.close()
        self._settings.__exit__(None, None, None)


class _Piece(Future[Any]):
    """A piece whose result is fetched when it is asked for."""

    def __init__(self, submit: Callable[[], Any]):
        super().__init__()
        self._submit, self._inner, self._tries = submit, submit(), 1

    def result(self, timeout: float | None = None) -> Any:
        """Wait for the result; ``timeout`` is not kept to.

        Raises
        ------
        Whatever the piece raised; WorkersLostError when its result was lost again and again.
        """
        while True:
            try:
                return self._inner.result(timeout=_PATIENCE_S * 2 ** (self._tries - 1))
            except TimeoutError as error:
                if self._inner.status != "finished":
                    continue  # still under way: pieces take as long as they take
                self._again(error)
            except (OSError, CancelledError) as error:
                if self._inner.status == "error":
                    raise  # the piece's own
                self._again(error)

    def _again(self, error: BaseException) -> None:
        if self._tries >= _TRIES:
            raise WorkersLostError(
                f"the result of a piece was lost {self._tries} times", mend="see the logs of the cluster's workers"
            ) from error
        self._tries += 1
        self._inner = self._submit()

    def cancel(self) -> bool:
        """Take the piece back."""
        self._inner.cancel()
        return True
