"""Detectors and engines of the user's own: Python files that register them."""

from __future__ import annotations

import runpy
from collections.abc import Iterable
from pathlib import Path

from hyperval.errors import HypervalError, InputError, UsageError

_LOADED: set[Path] = set()


def load_extensions(paths: Iterable[Path]) -> None:
    """Run each file once in this process; what it registers has rows from then on.

    The files are programs: run only what you trust.

    Raises
    ------
    InputError : no such file.
    UsageError : a file that fails.
    """
    for path in paths:
        place = Path(path).resolve()
        if place in _LOADED:
            continue
        if not place.is_file():
            raise InputError(
                "no such file", where=str(path), expected="a Python file that registers detectors or engines"
            )
        try:
            runpy.run_path(str(place))
        except HypervalError:
            raise
        except Exception as error:
            raise UsageError(
                f"the extension fails: {type(error).__name__}: {error}",
                where=str(path),
                expected="a Python file that calls register_detector or register_engine",
            ) from error
        _LOADED.add(place)
