"""The house does not grow, a name is that of one class, an equation is found by its number; these gates can fail."""

from __future__ import annotations

import ast
import importlib.util
import re
from collections import Counter
from pathlib import Path

import pytest
from parsed import parsed

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "hyperval"
_SPEC = importlib.util.spec_from_file_location("lines_of_code", ROOT / "scripts" / "lines_of_code.py")
assert _SPEC is not None
assert _SPEC.loader is not None
size = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(size)


def only_forwards(tree: ast.Module) -> bool:
    """Whether a module has nothing of its own: a docstring, imports, and names for what it imports."""
    return all(
        isinstance(node, ast.Import | ast.ImportFrom)
        or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        or (isinstance(node, ast.Assign) and isinstance(node.value, ast.Name | ast.Attribute | ast.List | ast.Tuple))
        for node in tree.body
    )


def test_nothing_outgrows_its_budget():
    budgets = size.flat((ROOT / "budgets.toml").read_text("utf-8"))
    assert size.over(size.measured(ROOT), budgets) == []


def test_growth_is_seen():
    budgets = {"model.lines": 10, "model.files": 1}
    assert size.over({"model.lines": 11, "model.files": 1}, budgets) == ["model.lines = 11, budget 10"]
    assert size.over({"model.lines": 10, "other.lines": 1}, budgets) == ["other.lines = 1 has no budget"]


@pytest.mark.parametrize(
    ("message", "unsaid"),
    [
        ("A commit that says nothing", ["model.lines"]),
        ("Budget: raises model.lines; lowers study.lines", []),
        ("Budget: raises model.lines; lowers web.lines", ["model.lines"]),  # which it does not lower
        ("Budget: raises web.lines; lowers study.lines", ["model.lines"]),
    ],
)
def test_a_raised_budget_names_what_is_lowered(message, unsaid):
    before = {"model.lines": 10, "study.lines": 10, "web.lines": 5}
    after = {"model.lines": 12, "study.lines": 7, "web.lines": 5, "new.lines": 1}
    assert size.raised_unsaid(before, after, message) == unsaid


def test_no_class_name_stands_for_two_classes():
    names = Counter(size.classes(SOURCE))
    assert {name for name, n in names.items() if n > 1} == set()


def test_no_module_only_forwards():
    paths = [path for path in SOURCE.rglob("*.py") if path.name not in {"__init__.py", "__main__.py"}]
    assert [path.name for path in paths if only_forwards(parsed(path))] == []


def test_a_module_that_only_forwards_is_seen():
    assert only_forwards(ast.parse('"""Old name."""\nfrom hyperval.model import predict\npredict_all = predict\n'))
    assert not only_forwards(ast.parse("from hyperval.model import predict\nLEAST = 3\n"))


@pytest.mark.parametrize("number", range(1, 34))
def test_each_equation_is_found_by_its_own_number(number):
    pattern = re.compile(rf"(?<![\d.])3\.{number}(?!\d)")
    assert any(pattern.search(path.read_text("utf-8")) for path in SOURCE.rglob("*.py"))
