"""Other processes as tests see them: at work or at an end, and waited for by that, not by the clock."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
PATIENCE_S = 60.0  # for what hangs alone: nothing is asserted of a time


def is_at_work(process: int) -> bool:
    """One that has ended is not, though whoever inherits it may not have waited for it yet."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def awaited(condition: Callable[[], T]) -> T:
    """What the condition gives, as soon as it gives something."""
    end = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"nothing came in {PATIENCE_S:g} s")
        time.sleep(0.02)
    return value
