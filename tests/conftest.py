"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest


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
