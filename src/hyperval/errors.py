"""The errors a user can meet, each with the exit code of the command-line contract.

Every message says what is wrong, where, what was expected and how to mend it.  The
command line prints the message alone; the Python API raises the exception.
"""

from __future__ import annotations

import traceback
from pathlib import Path

_OWN = Path(__file__).parent
_CALLS = 4


class HypervalError(Exception):
    """Base class: something the user can mend."""

    exit_code = 4

    def __init__(
        self, what: str, *, where: str | None = None, expected: str | None = None, mend: str | None = None
    ):
        self.what, self.where, self.expected, self.mend = what, where, expected, mend
        parts = [f"{where}: {what}" if where else what]
        if expected:
            parts.append(f"expected: {expected}")
        if mend:
            parts.append(f"to mend it: {mend}")
        super().__init__("\n  ".join(parts))


class UsageError(HypervalError):
    """A command, campaign or scenario that is not valid (exit code 2)."""

    exit_code = 2


class InputError(HypervalError):
    """An input file that is missing, corrupt or contradicts its description (exit code 3)."""

    exit_code = 3


class MissingDataError(InputError):
    """A data set that is not at hand; ``mend`` names the command that fetches it (exit code 3)."""


class EngineError(HypervalError):
    """An external engine (6S, MODTRAN) that is missing or failed (exit code 3)."""

    exit_code = 3


def internal_error(error: Exception) -> str:
    """Words for an error that nobody foresaw: what it is, and where it arose, the innermost place first."""
    places = []
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if path.is_relative_to(_OWN):
            places.append(f"{path.relative_to(_OWN.parent).as_posix()}:{frame.lineno}")
        elif not places:
            places.append(f"{path.name}:{frame.lineno}")
    where = f" (at {', called from '.join(places[:_CALLS])})" if places else ""
    return f"internal error: {type(error).__name__}: {error}{where}"
