"""docs/model.md and the code say the same: names, completeness, table of differences."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path

from test_every_equation_has_evidence import MODULES, public_functions

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
NAME = re.compile(r"`(hyperval(?:\.\w+)+)`")


def exists(name: str) -> bool:
    module, _, attribute = name.rpartition(".")
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError:
        return False


def test_every_function_named_exists():
    names = NAME.findall(DOCUMENT)
    assert len(names) > 40
    assert [n for n in names if not exists(n)] == []
    assert not exists("hyperval.model.radiance.no_such_function")


def test_every_function_of_the_physics_is_named():
    named = set(NAME.findall(DOCUMENT))
    every = {f"{module}.{name}" for module in MODULES for name in public_functions(module)}
    assert sorted(every - named) == []


def test_every_equation_has_a_row():
    numbers = set()
    for row in DOCUMENT.splitlines():
        if row.startswith("| 3."):
            cell = row.split("|")[1]
            for low, high in re.findall(r"3\.(\d+)(?:-3\.(\d+))?", cell):
                numbers |= set(range(int(low), int(high or low) + 1))
    assert numbers == set(range(7, 34))


def test_the_table_of_differences_is_what_the_script_gives():
    path = ROOT / "validation" / "equations" / "formulation_differences.py"
    spec = importlib.util.spec_from_file_location("formulation_differences", path)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    rows = [*script.radiometric_rows(), *script.sensor_rows()]
    assert len(rows) == 8
    assert [row for row in rows if row not in DOCUMENT] == []
