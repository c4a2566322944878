"""One BLAS thread while several Python threads work."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np

_NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads")


@contextmanager
def single_blas_thread() -> Iterator[bool]:
    """Give NumPy's matrix products one thread each inside the block; the number is set back afterwards.

    Yields whether that holds: True with the OpenBLAS that NumPy's wheels carry, or where the environment
    already says one thread; False with a BLAS that cannot be asked.
    """
    control = _openblas()
    if control is None:
        yield "1" in (os.environ.get(f"{name}_NUM_THREADS") for name in ("OMP", "OPENBLAS", "MKL"))
        return
    get, put = control
    before = int(get())
    put(1)
    try:
        yield True
    finally:
        put(before)


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _openblas() -> tuple[Callable[[], int], Callable[[int], None]] | None:
    package = Path(np.__file__).parent
    for folder in (package.parent / "numpy.libs", package / ".dylibs"):
        for path in sorted(folder.glob("*openblas*")):
            # The library is loaded already: opening it again gives the same one.
            try:
                library = ctypes.CDLL(str(path))
            except OSError:
                continue
            for name in _NAMES:
                get, put = (getattr(library, name.format(verb), None) for verb in ("get", "set"))
                if get is not None and put is not None:
                    get.restype, get.argtypes, put.argtypes = ctypes.c_int, [], [ctypes.c_int]
                    return get, put
    return None
