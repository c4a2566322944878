"""Tests of injected errors use the small scene of the tests of predictions."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "prediction"))
