"""Processes of our own: a function whose memory is given back when it has returned; programs that end with us."""

from __future__ import annotations

import contextlib
import ctypes
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence, Set
from functools import cache
from pathlib import Path
from typing import NoReturn, TypeVar

from hyperval.errors import HypervalError

R = TypeVar("R")
_MMAP_THRESHOLD, _ARENA_MAX = -3, -8  # of malloc.h
_RETURNED_FROM = 1048576  # bytes
_PR_SET_PDEATHSIG = 1  # of sys/prctl.h
_LOOK_S = 0.02  # between two looks whether the other process has ended
_NOT_STARTED = (126, 127)  # exit codes of setpriv, as of a shell


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
    _give_back_arrays()  # here and in the copy
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        sys.stdout.flush()
        sys.stderr.flush()
        parent, child = os.getpid(), -1
        interrupts = signal.pthread_sigmask(signal.SIG_BLOCK, [])
        try:
            # One that comes between the copy's start and the wait for it would leave the copy behind.
            signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
            child = os.fork()
            if child == 0:
                _return(function, path, parent, interrupts)
            signal.pthread_sigmask(signal.SIG_SETMASK, interrupts)
            # Looked at again and again: an interrupt just before a wait without end is seen after it alone.
            while (ended := os.waitpid(child, os.WNOHANG)) == (0, 0):
                time.sleep(_LOOK_S)
            status = ended[1]
        except BaseException:
            signal.pthread_sigmask(signal.SIG_SETMASK, interrupts)
            if child > 0:
                with contextlib.suppress(ProcessLookupError, ChildProcessError):  # it has ended by itself
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


def ending_with_this_process(command: Sequence[str]) -> list[str]:
    """The command line by which a program ends with the process that starts it, killed ones too.

    It is the command itself where the system has no such way: there the program goes on until it is done.
    """
    return [*_tie(), *command]


def is_no_program(code: int) -> bool:
    """Whether a command that ends with this process ended with ``code`` since it could not be started."""
    return bool(_tie()) and code in _NOT_STARTED


@cache
def _tie() -> tuple[str, ...]:
    """The program that asks Linux for it and then becomes the command: nothing runs between fork and exec here."""
    tie = (shutil.which("setpriv") or "", "--pdeathsig", "KILL", "--")
    try:
        done = subprocess.run([*tie, "true"], capture_output=True, check=False)  # noqa: S603 - a program of the system
    except OSError:
        return ()
    return () if done.returncode else tie  # a small system's own setpriv may not know the option


def _end_with(parent: int) -> None:
    """Let the system end this process, as by ``kill``, when the one that made it ends; where it can."""
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    except (AttributeError, OSError, TypeError):  # another system than Linux
        return
    if os.getppid() != parent:  # it ended a moment ago
        os.kill(os.getpid(), signal.SIGTERM)


def give_back_freed() -> None:
    """Let the C library return to the system what is free between its arrays, after work that made many."""
    with contextlib.suppress(AttributeError, OSError, TypeError):  # another C library than GNU's
        ctypes.CDLL(None).malloc_trim(0)


def _return(
    function: Callable[[], object], path: Path, parent: int, interrupts: Set[signal.Signals | int]
) -> NoReturn:
    """Call with ``interrupts`` blocked, and leave what is returned or raised in a file; the process ends here."""
    code = 1
    _end_with(parent)
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, interrupts)
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
