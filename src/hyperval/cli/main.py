"""From the command's arguments to its exit code."""

from __future__ import annotations

import errno
import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Sequence
from types import FrameType
from typing import Any, NoReturn

from typer.exceptions import Abort, TyperException

from hyperval import __version__
from hyperval.cli import commands  # noqa: F401  (adds the commands to the application)
from hyperval.cli.commands import app, settings
from hyperval.errors import HypervalError, UsageError, internal_error

INTERNAL_ERROR = 4
INTERRUPTED = 130
TERMINATED = 143
OUTPUT_CLOSED = 141
_FULL = (errno.ENOSPC, errno.EDQUOT)
# Files and folders that a command was told to use and that cannot be.
_PLACES = (errno.ENAMETOOLONG, errno.EACCES, errno.EROFS, errno.ENOTDIR, errno.EISDIR)


class _Terminated(BaseException):
    """SIGTERM came: unwinds like an interrupt, so that half-written files are removed."""


def _terminate(signum: int, frame: FrameType | None) -> NoReturn:
    raise _Terminated


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; every error becomes one message on standard error."""
    settings.quiet = settings.debug = False
    try:
        _check_date()
        code: Any = app(args=arguments, prog_name="hyperval", standalone_mode=False)
        sys.stdout.flush()
    except (KeyboardInterrupt, Abort):
        code = INTERRUPTED
    except _Terminated:
        code = TERMINATED
    except SystemExit as ended:
        # typer stops with 1 when the reader of our output went away (`hyperval ... | head`), but 1 would
        # mean that a comparison failed; with 0 once it has completed a word for a shell.
        return OUTPUT_CLOSED if ended.code else 0
    except BrokenPipeError:
        # The same, met at the last flush: nothing more can be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return OUTPUT_CLOSED
    except TyperException as error:
        return _usage(error)
    except HypervalError as error:
        if settings.debug:
            traceback.print_exc()
        _error(str(error))
        return error.exit_code
    except Exception as error:
        return _internal(error)
    if code in (INTERRUPTED, TERMINATED):
        _error("interrupted" if code == INTERRUPTED else "terminated")
    return code if isinstance(code, int) else 0


def _check_date() -> None:
    """Take an empty SOURCE_DATE_EPOCH as none: libraries read it as a number, whenever they come to be loaded."""
    text = os.environ.get("SOURCE_DATE_EPOCH", "0")
    if not text.strip():
        del os.environ["SOURCE_DATE_EPOCH"]
    elif not (text.isascii() and text.isdigit()):
        raise UsageError(f"SOURCE_DATE_EPOCH is {text[:100]!r}", expected="seconds since 1970")


def _usage(error: TyperException) -> int:
    context = getattr(error, "ctx", None)
    text = error.format_message().strip()
    if not text:  # no command given: typer raises with the help already printed
        return 2
    command = context.command_path if context is not None else "hyperval"
    if context is not None and hasattr(error, "param_type"):  # one is missing: the first of perhaps several
        missing = [p for p in context.command.params if p.required and p.name not in context.params]
        text = "missing: " + ", ".join(p.get_error_hint() for p in missing)
    _error(f"{text}\n  to fix it: see {command} --help")
    return 2


def _internal(error: Exception) -> int:
    what = internal_error(error)
    if settings.debug:
        traceback.print_exc()
        _error(what)
        return INTERNAL_ERROR
    if isinstance(error, OSError) and error.errno in _PLACES and error.filename:
        name = os.fsdecode(error.filename)[:300]
        _error(f"{name}: {error.strerror}\n  to fix it: name another file or folder")
        return UsageError.exit_code
    if isinstance(error, OSError) and error.errno in _FULL:
        _error(
            f"{error}\n  to fix it: free space there, or name another folder with --output; "
            f"temporary files are in {tempfile.gettempdir()} (TMPDIR)"
        )
        return INTERNAL_ERROR
    try:
        handle, name = tempfile.mkstemp(prefix="hyperval-", suffix=".log")
        with open(handle, "w", encoding="utf-8") as log:
            log.write(f"hyperval {__version__}, Python {sys.version}\n{' '.join(sys.argv)}\n")
            traceback.print_exception(error, file=log)
        _error(f"{what} (traceback in {name}, or repeat with: hyperval --debug ...)")
    except OSError:
        _error(f"{what} (repeat with: hyperval --debug ...)")
    return INTERNAL_ERROR


def _error(text: str) -> None:
    print(f"hyperval: {text}", file=sys.stderr)


def main() -> None:
    """Entry point of the command `hyperval`."""
    # One thread for each matrix product, set before the libraries load: the last digits of a solve depend on the
    # number of threads, and our own workers would fight for the processors with those of the library.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    signal.signal(signal.SIGTERM, _terminate)
    sys.exit(run())
