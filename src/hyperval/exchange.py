"""Two folders that change places in one step of the file system, where it has such a step."""

from __future__ import annotations

import ctypes
import os
import re
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path

_AT_CWD = -100
_EXCHANGE = 2


@cache
def _renameat2() -> Callable[..., int] | None:
    try:
        function: Callable[..., int] = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):
        return None
    return function


def exchange(one: Path, other: Path) -> None:
    """Give each of two paths what stands at the other, at once; raises OSError where that cannot be."""
    function = _renameat2()
    if function is None:
        raise OSError("this system cannot exchange two folders")
    if function(_AT_CWD, os.fsencode(one), _AT_CWD, os.fsencode(other), ctypes.c_uint(_EXCHANGE)) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), str(one), None, str(other))


def can_exchange(folder: Path, prefix: str = ".trial-") -> bool:
    """Whether two folders in ``folder`` can be made and can change places, found by doing it."""
    made: list[Path] = []
    try:
        for _ in range(2):
            made.append(Path(tempfile.mkdtemp(prefix=prefix, dir=folder)))
        exchange(*made)
        return True
    except OSError:
        return False
    finally:
        for path in made:
            with suppress(OSError):
                path.rmdir()


def mount_points() -> set[Path]:
    """Where file systems are mounted, also those on the same device, which no number of a device tells."""
    try:
        with open("/proc/self/mountinfo", encoding="utf-8", errors="surrogateescape") as stream:
            fields = [line.split(" ")[4] for line in stream]
    except (OSError, IndexError):
        return set()
    return {Path(re.sub(r"\\([0-7]{3})", lambda m: chr(int(m[1], 8)), field)) for field in fields}
