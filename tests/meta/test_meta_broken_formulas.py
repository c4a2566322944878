"""Every formula of the model, broken on purpose, turns the equations' evidence red; and this gate can fail."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def broken_formulas(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "validation/broken_formulas.py", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.mark.slow
def test_every_formula_turns_the_evidence_red():
    outcome = broken_formulas()
    assert [line for line in outcome.stdout.splitlines() if line.startswith("GREEN")] == []
    assert outcome.returncode == 0, outcome.stdout[-2000:] + outcome.stderr[-2000:]
    assert sum(line.startswith("red ") for line in outcome.stdout.splitlines()) >= 20


@pytest.mark.slow
def test_a_formula_that_nothing_looks_at_is_named():
    words = "--factor", "1.0", "--only", "sensor/response.py"  # broken by nothing
    outcome = broken_formulas(*words, "--evidence", "test_equations_sensor.py")
    assert outcome.returncode == 1
    assert outcome.stdout.count("GREEN src/hyperval/sensor/response.py") == 3
    assert "0 of 3 formulas" in outcome.stdout
