"""No function of the package is kept for tests alone: production calls it, or a page tells users of it."""

from __future__ import annotations

import ast
from pathlib import Path

from parsed import parsed
from test_every_equation_has_evidence import SOURCE, production

ROOT = Path(__file__).parents[2]
# The installed command; forms of our objects for other libraries; errors to be injected in a campaign.
ENTRANCES = {"main", "library_to_spy", "library_to_xarray", "injected_errors", "injected_prediction"}


def public_functions() -> dict[str, Path]:
    """Functions of modules by name, without those that a decorator hands to a registry."""
    return {
        node.name: path
        for path in SOURCE.rglob("*.py")
        for node in parsed(path).body
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not node.decorator_list
    }


def exported() -> set[str]:
    """Names that a package hands on in ``__all__``."""
    names: set[str] = set()
    for path in SOURCE.rglob("__init__.py"):
        for node in parsed(path).body:
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
                names |= set(ast.literal_eval(node.value))
    return names


def test_no_function_is_called_by_tests_alone():
    pages = "\n".join(p.read_text("utf-8") for p in [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"])
    known = production() | exported() | ENTRANCES
    lonely = {n for n in public_functions() if n not in known and n not in pages}
    assert sorted(lonely) == []


def test_no_method_is_called_by_tests_alone():
    pages = "\n".join(p.read_text("utf-8") for p in [*(ROOT / "docs").glob("*.md"), *SOURCE.rglob("*.j2")])
    read, methods = set(), set()
    for node in (n for path in SOURCE.rglob("*.py") for n in ast.walk(parsed(path))):
        if isinstance(node, ast.Attribute):
            read.add(node.attr)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            read.add(node.value)
        elif isinstance(node, ast.ClassDef):
            functions = (f for f in node.body if isinstance(f, ast.FunctionDef))
            methods |= {f.name for f in functions if not f.name.startswith("_")}
    assert len(methods) > 100  # PyYAML itself calls the one that is taken off
    assert sorted(name for name in methods - read - {"ignore_aliases"} if name not in pages) == []
