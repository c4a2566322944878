"""Names of what is kept beside a run to be drawn: other scripts draw other files, after an update too."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib import resources

_SCRIPTS = (("hyperval.report", "templates", "charts.js"), ("hyperval.web", "static", "map.js"))


def view_name(stem: str) -> str:
    """The name of a file that the scripts of this version draw."""
    return f"{stem}-{_scripts()}.json"


@lru_cache(maxsize=1)
def _scripts() -> str:
    digest = hashlib.sha256()
    for package, folder, name in _SCRIPTS:
        digest.update((resources.files(package) / folder / name).read_bytes())
    return digest.hexdigest()[:8]
