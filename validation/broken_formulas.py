"""Break every formula of the model, one at a time, and see whether the evidence of the equations turns red.

A formula is a statement, or an argument, on whose line a comment states its equation: ``# (3.28)``.  It is
broken by a tenth in the function that production calls, and the tests of validation/equations that call the
function are run again; at least one has to fail.

    python validation/broken_formulas.py [--factor 1.1] [--only TEXT] [--evidence FILE]

Exit code 1 when a formula was broken and nothing turned red.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import inspect
import re
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "hyperval"
# Rooms of the model.  Simulated truth is written apart from it; its evidence is tests/simulate and the closure.
ROOMS = ("atmosphere", "sensor", "pixels", "model", "observe", "study")
EQUATION = re.compile(r"#.*\((3\.(?:[7-9]|[12]\d|3[0-3]))\)")


@dataclass
class Formula:
    """One formula line: where it stands, and the function around it."""

    path: Path
    line: int
    equation: str
    function: str
    tests: dict[str, Callable[[], object]] = field(default_factory=dict)  # that call it, by their names in the run

    @property
    def place(self) -> str:
        """File, line, function and equation."""
        return f"{self.path.relative_to(ROOT)}:{self.line} {self.function} ({self.equation})"


def formulas(folder: Path = SOURCE, rooms: tuple[str, ...] = ROOMS) -> Iterator[Formula]:
    """Every formula line of the rooms."""
    for room in rooms:
        for path in sorted((folder / room).rglob("*.py")) if (folder / room).is_dir() else [folder / room]:
            text = path.read_text("utf-8")
            functions = list(_functions(ast.parse(text)))
            for number, line in enumerate(text.splitlines(), 1):
                match = EQUATION.search(line)
                around = [name for name, f in functions if f.lineno <= number <= (f.end_lineno or 0)]
                if match and around:
                    yield Formula(path, number, match[1], around[0])


def _functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions of the module and methods of its classes, by qualified name; inner functions belong to theirs."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from ((f"{node.name}.{n.name}", n) for n in node.body if isinstance(n, ast.FunctionDef))


def live_function(formula: Formula) -> types.FunctionType:
    """The function object behind the name in the module that production imports, without what is wrapped around it."""
    owner: Any = importlib.import_module(".".join(formula.path.relative_to(ROOT / "src").with_suffix("").parts))
    for part in formula.function.split("."):
        owner = inspect.getattr_static(owner, part)
    while not isinstance(owner, types.FunctionType):
        owner = next(getattr(owner, a) for a in ("__wrapped__", "__func__", "fget", "func") if hasattr(owner, a))
    return inspect.unwrap(owner)


def broken_code(formula: Formula) -> types.CodeType:
    """The function's code with the value of the formula handed through ``_broken``."""
    tree = ast.parse(formula.path.read_text("utf-8"))
    chosen = _formula_value(tree, formula.line)

    class Breaker(ast.NodeTransformer):
        def generic_visit(self, node: ast.AST) -> ast.AST:
            node = super().generic_visit(node)
            return ast.Call(ast.Name("_broken", ast.Load()), [node], []) if node is chosen else node

    tree = Breaker().visit(tree)
    code = compile(ast.fix_missing_locations(tree), str(formula.path), "exec", dont_inherit=True)
    for part in formula.function.split("."):
        code = next(c for c in code.co_consts if isinstance(c, types.CodeType) and c.co_name == part)
    return code


def _formula_value(tree: ast.AST, line: int) -> ast.expr:
    """What the statement or the argument that ends on the line gives; else the statement that follows."""
    nodes = list(ast.walk(tree))
    statements = [
        n for n in nodes if isinstance(n, ast.Assign | ast.AnnAssign | ast.AugAssign | ast.Return) and n.value
    ]
    values = [n.value for n in statements if n.end_lineno == line]
    if not values:
        calls = [n for n in nodes if isinstance(n, ast.Call)]
        arguments = [a for c in calls for a in (*c.args, *(k.value for k in c.keywords)) if a.end_lineno == line]
        following = [n.value for n in statements if n.lineno > line]
        values = arguments or following
    return min(values, key=lambda v: (v.lineno, v.col_offset))


def broken(factor: float) -> Callable[[Any], Any]:
    """What breaks a value: numbers and arrays of numbers are multiplied, tuples member by member."""

    def break_value(value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(break_value(v) for v in value)
        if isinstance(value, int | float | np.ndarray | np.generic) and not isinstance(value, bool):
            return value * factor
        return value

    return break_value


class Evidence:
    """A pytest plugin: which tests call which formula, and what they say when it is broken."""

    def __init__(self, chosen: list[Formula]):
        self.formulas = chosen
        self.by_code: dict[types.CodeType, list[Formula]] = {}
        for formula in chosen:
            self.by_code.setdefault(live_function(formula).__code__, []).append(formula)

    @pytest.hookimpl(wrapper=True)
    def pytest_pyfunc_call(self, pyfuncitem: pytest.Function) -> Iterator[None]:
        """Run the test once as it is, and remember it for every formula that it calls."""
        called: set[types.CodeType] = set()

        def watch(frame: types.FrameType, event: str, _: object) -> None:
            if event == "call" and frame.f_code in self.by_code:
                called.add(frame.f_code)

        sys.setprofile(watch)
        try:
            result = yield
        finally:
            sys.setprofile(None)
        arguments = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
        for formula in (f for code in called for f in self.by_code[code]):
            formula.tests[pyfuncitem.nodeid] = partial(pyfuncitem.obj, **arguments)
        return result


def red_test(formula: Formula, factor: float) -> str | None:
    """Break the formula and name the first test that fails; None when all stay green."""
    function = live_function(formula)
    right = function.__code__
    function.__globals__["_broken"] = broken(factor)
    function.__code__ = broken_code(formula)
    try:
        for name, test in formula.tests.items():
            _forget()
            try:
                test()
            except Exception:
                return name.partition("::")[2]
        return None
    finally:
        function.__code__ = right
        del function.__globals__["_broken"]
        _forget()


def _forget() -> None:
    """Empty every cache of the package: a value from before would hide what is broken."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "hyperval":
            for value in vars(module).values():
                if callable(getattr(value, "cache_clear", None)):
                    value.cache_clear()


def main(words: list[str] | None = None) -> int:
    """Print every formula with the test that turns red; 1 when one has none."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--factor", type=float, default=1.1)
    parser.add_argument("--only", default="", help="formulas whose place has this text")
    parser.add_argument("--evidence", default="", help="one file of validation/equations, in place of all")
    options = parser.parse_args(words)
    evidence = Evidence([f for f in formulas() if options.only in f.place])
    tests = ROOT / "validation" / "equations" / options.evidence
    code = pytest.main([str(tests), "-q", "-p", "no:cacheprovider"], plugins=[evidence])
    if code != 0 or not evidence.formulas:
        print("the evidence is red before anything is broken, or no formula is chosen")
        return 1
    green = 0
    for formula in evidence.formulas:
        red = red_test(formula, options.factor)
        green += red is None
        print(f"{'red  ' if red else 'GREEN'} {formula.place}: {red or f'{len(formula.tests)} tests call it'}")
    print(f"{len(evidence.formulas) - green} of {len(evidence.formulas)} formulas turn the evidence red")
    return 1 if green else 0


if __name__ == "__main__":
    sys.exit(main())
