"""Texts of a page that are made once and kept on disk: models of charts, the packed script that draws them."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hyperval.atmosphere.cache import cache_folder, cache_key
from hyperval.files import whole_file


def text_of(kind: str, made_of: Mapping[str, Any], make: Callable[[], str]) -> str:
    """The text kept for ``made_of``, made and kept first where there is none.

    An entry whose content is not what was written counts as none; a folder that cannot be written is no error.
    """
    path = cache_folder() / kind / f"{cache_key(made_of)[:40]}.txt"
    try:
        digest, _, text = path.read_bytes().partition(b"\n")
        if hashlib.sha256(text).hexdigest().encode() == digest:
            return text.decode("utf-8")
    except (OSError, UnicodeDecodeError):
        pass
    made = make()
    content = made.encode("utf-8")
    try:
        with whole_file(path) as temporary:
            temporary.write_bytes(hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
    except OSError:
        pass
    return made


@lru_cache(maxsize=64)
def chart_models(kind: str, target: str, *arguments: Any) -> str:
    """The JSON of a chart's models, which hold no numbers of a run: kept on disk for charts built alike."""

    def build() -> str:
        from hyperval.report.bokeh_models import models_json  # a second, of which a kept text needs nothing

        return models_json(kind, target, *arguments)

    made_of = {
        "kind": kind, "target": target, "arguments": repr(arguments), "bokeh": version("bokeh"),
        "source": _source_hash("bokeh_models", "bokeh_base", "bokeh_plots", "charts_base", "plots", "style"),
    }  # fmt: skip
    return text_of("charts", made_of, build)


@cache
def _source_hash(*modules: str) -> str:
    """SHA-256 of the sources of modules of this room, which a kept text was made by."""
    folder = Path(__file__).parent
    return hashlib.sha256(b"".join((folder / f"{name}.py").read_bytes() for name in modules)).hexdigest()
