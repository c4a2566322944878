"""The errors a user can meet, each with the exit code of the command-line contract.

Every message says what is wrong, where, what was expected and how to mend it.  The
command line prints the message alone; the Python API raises the exception.
"""

from __future__ import annotations


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
