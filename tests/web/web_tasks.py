"""Tasks that show what the processes of a server do with them."""

import os
import time
from pathlib import Path

from hyperval.errors import UsageError
from hyperval.progress import track


def _wrong() -> None:
    raise UsageError("no such thing", where="/secret/place/file.yaml", expected="a thing of /secret/place")


def _unforeseen() -> None:
    raise RuntimeError("/secret/place")


def _write(path: str) -> None:
    while True:
        Path(path).write_text(str(time.time()))
        time.sleep(0.05)


def _count(folder: str, seconds: float) -> None:
    for _ in track(range(int(seconds / 0.02)), "counting", show=False):
        time.sleep(0.02)


TASKS = {
    "warm": dict,  # there is nothing to load
    "count": _count,
    "add": lambda a, b: a + b, "sleep": time.sleep, "wrong": _wrong,
    "die": lambda: os._exit(9), "hoard": lambda: len(bytearray(4_000_000_000)),
    "unforeseen": _unforeseen, "write": _write, "pid": os.getpid,
}  # fmt: skip
