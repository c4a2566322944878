"""What all tests share, those below tests/ and those below validation/."""

from __future__ import annotations

import gc
import ipaddress
import os
import re
import socket
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

pytest_plugins = ["pytester"]
REQUIRED = "HYPERVAL_REQUIRE_DATA"
DATA_WORDS = re.compile(r"\bdata_dir\b|\bmark\.data\b")
# A limit by the clock says on a busy machine that tests fail as they stand; examples by chance fail a change that
# has nothing to do with them.  `pytest --hypothesis-seed=N` tries others.
settings.register_profile("same", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("same")


@pytest.fixture(scope="session", autouse=True)
def _nobody_else() -> Iterator[None]:
    """No test reaches another machine: those that fetch do so from servers of their own on this one."""
    right = socket.socket.connect

    def connect(self: socket.socket, address: Any) -> None:
        if self.family in (socket.AF_INET, socket.AF_INET6):
            host = str(address[0])
            if host != "localhost" and not ipaddress.ip_address(host).is_loopback:
                raise OSError(f"a test would have reached {host}")
        right(self, address)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", connect)
        yield


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


def pytest_sessionstart() -> None:
    """Nothing is garbage while tests are collected."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Thousands of tests stay to the end: they are not looked through for garbage again and again."""
    gc.enable()
    gc.freeze()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Asked for tests of real data alone, files that never speak of them are not read, which most do not."""
    if config.getoption("markexpr") != "data" or not collection_path.match("test_*.py"):
        return None
    return None if DATA_WORDS.search(collection_path.read_text("utf-8")) else True


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What asks for a file of a collection is a test of real data, by whatever way it asks.

    Files with slow tests come first: the last file of several processes runs alone, and had better be a short one.
    """
    for item in items:
        if "data_dir" in getattr(item, "fixturenames", ()):
            item.add_marker("data")
    slow = {item.path for item in items if item.get_closest_marker("slow") is not None}
    items.sort(key=lambda item: item.path not in slow)


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
