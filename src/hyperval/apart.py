"""A function in a process of its own, whose memory is given back when it has returned."""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn, TypeVar

from hyperval.errors import HypervalError

R = TypeVar("R")
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # of malloc.h
_RETURNED_FROM = 2 << 20  # bytes


class ProcessLostError(HypervalError):
    """A process that was ended before it returned (exit code 4)."""


def call_apart(function: Callable[[], R], scratch: Path) -> R:
    """What ``function`` returns, called in a process of its own.

    The process is a copy of this one, made before this one has loaded what takes memory; it hands its result over
    through a file in ``scratch``.  It is called here where the system cannot copy a process, and where this one
    has loaded NumPy already, and with it perhaps threads that a copy would lack.

    Raises
    ------
    ProcessLostError : the process was ended from outside, as for want of memory.
    Exception : what the function raises.
    """
    if not hasattr(os, "fork") or "numpy" in sys.modules:
        return function()
    path = scratch / "returned"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
    if child == 0:
        _return(function, path)
    try:
        _, status = os.waitpid(child, 0)
    except BaseException:
        os.kill(child, signal.SIGTERM)
        os.waitpid(child, 0)
        raise
    if status or not path.is_file():
        raise ProcessLostError(
            f"the process that did the work was ended ({os.waitstatus_to_exitcode(status)})",
            mend="give it more memory",
        )
    with path.open("rb") as file:
        returned, value = pickle.load(file)  # noqa: S301 - written by this program a moment ago
    path.unlink()
    if returned:
        result: R = value
        return result
    raise value


def _give_back_arrays() -> None:
    """Let the C library return arrays to the system as they are freed.

    Left to itself it raises the size from which it does so with every array that is freed, up to 32 MB, and keeps
    what lies below.
    """
    try:
        adjust = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library than GNU's
        return
    adjust(_MMAP_THRESHOLD, _RETURNED_FROM)
    adjust(_ARENA_MAX, 1)


def _return(function: Callable[[], object], path: Path) -> NoReturn:
    """Call, and leave what is returned or raised in a file; the process ends here."""
    code = 1
    _give_back_arrays()
    try:
        try:
            out: tuple[bool, object] = (True, function())
        except Exception as error:
            if not isinstance(error, HypervalError):
                error.add_note(traceback.format_exc())  # a traceback does not leave its process
            out = (False, error)
        with path.open("wb") as file:
            pickle.dump(out, file, protocol=5)
        code = 0
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
