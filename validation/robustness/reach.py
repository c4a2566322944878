"""Which lines each test reaches: python validation/robustness/reach.py DATA TESTS...

Runs the tests with coverage.py, every test a context of its own, what its fixtures do included.  What a fixture of
a module or a session does is under the first test that asks for it.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import coverage
import pytest

ROOMS = (
    "processing",
    "compare",
    "scene",
    "sensor",
    "atmosphere",
    "spectra",
    "prediction",
    "uncertainty",
    "observe",
)


class Contexts:
    """A plugin of pytest: each test is a context of the measurement."""

    def __init__(self, measurement: coverage.Coverage) -> None:
        self.measurement = measurement

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Setup, the test and what follows it."""
        self.measurement.switch_context(item.nodeid)
        result = yield
        self.measurement.switch_context("")
        return result  # type: ignore[misc]


def tests_by_line(data: Path) -> Mapping[tuple[str, int], list[str]]:
    """(file of the package, line) -> the tests that reach it, from what runs of this module have left."""
    read = coverage.CoverageData(str(data))
    read.read()
    out: dict[tuple[str, int], list[str]] = defaultdict(list)
    for path in read.measured_files():
        for line, tests in read.contexts_by_lineno(path).items():
            out[path, line] = sorted(test for test in tests if test)
    return out


def main() -> int:
    """Measure, and leave the data; pytest's exit code."""
    data, *tests = sys.argv[1:]
    packages = ["hyperval"]
    measurement = coverage.Coverage(data_file=data, data_suffix=True, branch=True, source_pkgs=packages)
    measurement.set_option("run:disable_warnings", ["module-not-imported"])
    measurement.start()
    options = ["-q", "-p", "no:cacheprovider", "-m", "not slow", *tests]
    code = pytest.main(options, plugins=[Contexts(measurement)])
    measurement.stop()
    measurement.save()
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
