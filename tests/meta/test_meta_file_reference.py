"""docs/files.md lists the keys that the models read, no others."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_reference_of_files_is_current():
    made = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "file_reference.py")], capture_output=True, text=True, check=True
    ).stdout
    kept = (ROOT / "docs" / "files.md").read_text("utf-8")
    assert made.rstrip("\n") == kept.rstrip("\n"), "renew it: python scripts/file_reference.py --write"
