"""Names of files: patterns such as ``grass*.asd``, and the names nearest to one that does not exist."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

MAX_MATCHES = 1000


def is_pattern(name: str) -> bool:
    """Whether the last part of a path stands for several files: it holds ``*``, ``?`` or ``[``."""
    return any(c in PurePosixPath(name).name for c in "*?[")


def matching(path: Path) -> list[Path]:
    """The files that a path names: itself, or all that match the pattern in its last part, sorted by name.

    A file whose name is the pattern itself comes first.  At most 1001 are listed.
    """
    if path.is_file():
        return [path]
    if not is_pattern(path.name) or not path.parent.is_dir():
        return []
    matches = (p for p in path.parent.iterdir() if fnmatchcase(p.name, path.name) and p.is_file())
    return sorted(matches)[: MAX_MATCHES + 1]


def nearest(name: str, known: Iterable[str], count: int = 3) -> list[str]:
    """The known names most like ``name``, case left aside; the best first."""
    by_lower: dict[str, str] = {}
    for one in known:
        by_lower.setdefault(one.lower(), one)
    return [by_lower[k] for k in difflib.get_close_matches(name.lower(), by_lower, count, 0.6)]
