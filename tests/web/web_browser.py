"""A real browser for tests, and pages that fail a test by what they should not do."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
REQUIRED = os.environ.get("HYPERVAL_REQUIRE_BROWSER") == "1"
NEEDS_BROWSER = pytest.mark.skipif(BROWSER is None and not REQUIRED, reason="no chromium on this machine")
WIDER_THAN_SCREEN = "document.scrollingElement.scrollWidth - document.documentElement.clientWidth"
PICTURES = os.environ.get("HYPERVAL_SCREENSHOTS")  # a folder that screenshots go into


@contextmanager
def careful_page(context: Any, address: str) -> Iterator[Any]:
    """A page; a request to elsewhere or a word of the browser's about the policy fails its test."""
    one = context.new_page()
    amiss: list[str] = []
    one.on("console", lambda m: amiss.append(m.text) if "Content Security Policy" in m.text else None)
    one.on("pageerror", lambda e: amiss.append(str(e)))
    one.on("request", lambda r: None if r.url.startswith((address, "data:", "blob:")) else amiss.append(r.url))
    yield one
    one.close()
    assert amiss == []


def serious(page: Any) -> list[tuple[str, list[str]]]:
    """What axe finds serious or worse: the rule, and the first elements."""
    from axe_playwright_python.sync_playwright import Axe

    return [
        (item["id"], [node["html"][:120] for node in item["nodes"][:2]])
        for item in Axe().run(page).response["violations"]
        if item["impact"] in ("serious", "critical")
    ]


def picture(page: Any, name: str) -> None:
    """Keep a screenshot, where a folder for them is named."""
    if PICTURES:
        page.screenshot(path=Path(PICTURES) / f"{name}.png")
