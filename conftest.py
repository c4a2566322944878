"""What all tests share, those below tests/ and those below validation/."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from pathlib import Path

import pytest

pytest_plugins = ["pytester"]
REQUIRED = "HYPERVAL_REQUIRE_DATA"


@pytest.fixture
def data_dir() -> Callable[[str], Path]:
    """Locate a file of a real collection, or skip the test and name what is lacking."""

    def locate(relative: str) -> Path:
        root = os.environ.get("HYPERVAL_DATA")
        if not root:
            pytest.skip(f"HYPERVAL_DATA is not set: needs {relative}")
        path = Path(root) / relative
        if not path.exists():
            pytest.skip(f"not in HYPERVAL_DATA: {relative}")
        return path

    return locate


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What asks for a file of a collection is a test of real data, by whatever way it asks."""
    for item in items:
        if "data_dir" in getattr(item, "fixturenames", ()):
            item.add_marker("data")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With HYPERVAL_REQUIRE_DATA=1 a test of real data that is skipped, however, has failed."""
    report = yield
    wanted = item.get_closest_marker("data") is not None
    if report.skipped and wanted and os.environ.get(REQUIRED) == "1":
        report.outcome = "failed"
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr
        report.longrepr = f"{REQUIRED}=1, but the test was skipped: {reason}"
    return report
