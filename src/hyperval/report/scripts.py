"""The scripts that draw a page's charts: a kept library from its installed package, and a short one of our own."""

from __future__ import annotations

import base64
import functools
import gzip
import hashlib
import zlib
from importlib import resources

from hyperval.files import installed_file
from hyperval.report.text_cache import text_of


@functools.cache
def starter() -> str:
    """The script that unpacks the library and draws the charts."""
    return (resources.files("hyperval.report") / "templates" / "charts.js").read_text("utf-8")


@functools.cache
def _library() -> str:
    return installed_file("bokeh", "server", "static", "js", "bokeh.min.js").read_text("utf-8")


@functools.cache
def packed_library() -> str:
    """The library's script as base64 of gzip: 0.5 MB in place of 1.3 leave the figures room."""
    content = _library().encode("utf-8")
    made_of = {"library": hashlib.sha256(content).hexdigest(), "zlib": zlib.ZLIB_RUNTIME_VERSION}
    return text_of("charts", made_of, lambda: base64.b64encode(gzip.compress(content, mtime=0)).decode("ascii"))


@functools.cache
def script_hashes() -> str:
    """The scripts of a page with charts as sources of its policy: these texts, and no other, may run."""
    return " ".join(map(_source, (_library(), starter(), page_script())))


@functools.cache
def page_script() -> str:
    """The script of every page: sorting and filtering of tables, links to evidence."""
    return (resources.files("hyperval.report") / "templates" / "page.js").read_text("utf-8")


@functools.cache
def page_script_hash() -> str:
    """The script of every page as a source of its policy."""
    return _source(page_script())


def _source(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"
