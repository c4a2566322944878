"""One BLAS thread while several Python threads work."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import scipy.linalg

_NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads")


@contextmanager
def single_blas_thread() -> Iterator[bool]:
    """Give matrix products and factorisations one thread each inside the block; the numbers are set back after.

    Yields whether that holds: True with the OpenBLAS that the wheels of NumPy and SciPy carry, or where the
    environment already says one thread; False with a BLAS that cannot be asked.
    """
    controls = _openblas()
    before = [int(get()) for get, _ in controls]
    for _, put in controls:
        put(1)
    try:
        stated = "1" in (os.environ.get(f"{name}_NUM_THREADS") for name in ("OMP", "OPENBLAS", "MKL"))
        yield bool(controls) or stated
    finally:
        for (_, put), count in zip(controls, before, strict=True):
            put(count)


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _openblas() -> tuple[tuple[Callable[[], int], Callable[[int], None]], ...]:
    """How many threads, and set them: for NumPy's library first, without which there is nothing."""
    found = []
    for module in (np, scipy):
        package = Path(str(module.__file__)).parent
        folders = (package.parent / f"{package.name}.libs", package / ".dylibs")
        control = next(filter(None, (_control(p) for f in folders for p in sorted(f.glob("*openblas*")))), None)
        if control is None and module is np:
            return ()
        found += [control] if control is not None else []
    return tuple(found)


def _control(path: Path) -> tuple[Callable[[], int], Callable[[int], None]] | None:
    try:
        library = ctypes.CDLL(str(path))  # loaded already: opening it again gives the same one
    except OSError:
        return None
    for name in _NAMES:
        get, put = (getattr(library, name.format(verb), None) for verb in ("get", "set"))
        if get is not None and put is not None:
            get.restype, get.argtypes, put.argtypes = ctypes.c_int, [], [ctypes.c_int]
            return get, put
    return None
