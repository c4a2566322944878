"""Small changes of the program itself: python validation/robustness/code_mutants.py --each 20 [--room compare]

One operator, comparison, constant or condition of a function is exchanged at a time, and tests are run; at least
one has to fail.  First those that reach the line, where --reach names the folder that `room_coverage.py --output`
left, then all of their files.  A sample is drawn from each room, by a fixed seed.  Each runs in a process of its
own with a limit of processor time, which counts as seen: a loop that never ends is no result.
"""

from __future__ import annotations

import argparse
import ast
import importlib.abc
import importlib.util
import os
import random
import resource
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from reach import ROOMS, tests_by_line

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "hyperval"
SECONDS = 300  # of processor time; ten times as much by the clock, on which a busy machine has a say
WORDS_AND_DATA = ("scene/builtin.py",)  # made-up spectra
OTHER_ROOMS = {
    "campaign",
    "meta",
    "report",
    "scoreboard",
    "simulate",
    "study",
}  # whole runs: too long for each change
LARGE_LIBRARIES = (
    "numpy", "scipy.stats", "scipy.signal", "scipy.optimize", "scipy.ndimage", "pandas", "xarray", "h5netcdf",
    "h5py", "rasterio", "skimage.measure", "sklearn.metrics", "spectral", "pydantic",
)  # fmt: skip
EXCHANGES: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.MatMult: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


@dataclass(frozen=True)
class Change:
    """One change: the file, and which of the places in it that can be changed."""

    path: Path
    place: int

    @property
    def module(self) -> str:
        """Dotted name of the module."""
        parts = self.path.relative_to(SOURCE.parent).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def places(tree: ast.AST) -> list[ast.AST]:
    """Nodes inside functions that can be changed: what computes and decides, not words of errors or types."""
    out: list[ast.AST] = []

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):
            return
        if _can_change(node):
            out.append(node)
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "returns", "decorator_list", "type_params"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    visit(child)

    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            for statement in function.body:
                visit(statement)
    return list(dict.fromkeys(out))


def _can_change(node: ast.AST) -> bool:
    if isinstance(node, ast.BinOp | ast.AugAssign):
        return type(node.op) in EXCHANGES
    if isinstance(node, ast.Compare):
        return len(node.ops) == 1 and type(node.ops[0]) in EXCHANGES
    if isinstance(node, ast.UnaryOp):
        return not isinstance(node.op, ast.UAdd)
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float)
    return isinstance(node, ast.BoolOp | ast.If | ast.IfExp)


def changed(path: Path, place: int) -> tuple[ast.Module, int, str]:
    """The tree with one change, its line, and the statement as it then reads."""
    tree = ast.parse(path.read_text("utf-8"))
    node = places(tree)[place]
    before = ast.unparse(node)
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        node.op = EXCHANGES[type(node.op)]()  # type: ignore[assignment]
    elif isinstance(node, ast.Compare):
        node.ops = [EXCHANGES[type(node.ops[0])]()]  # type: ignore[list-item]
    elif isinstance(node, ast.If | ast.IfExp):
        node.test = ast.UnaryOp(ast.Not(), node.test)
        before = ast.unparse(node.test.operand)  # type: ignore[attr-defined]
    elif isinstance(node, ast.UnaryOp):
        node.op = ast.UAdd() if not isinstance(node.op, ast.Not) else ast.Not()
        if isinstance(node.op, ast.Not):
            node.operand = ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.Constant):
        value = node.value
        node.value = (
            not value if isinstance(value, bool) else value + 1 if isinstance(value, int) else 1.5 * value + 0.1
        )
    after = ast.unparse(node.test if isinstance(node, ast.If | ast.IfExp) else node)
    line: int = node.lineno  # type: ignore[attr-defined]
    return ast.fix_missing_locations(tree), line, f"{before.splitlines()[0]} -> {after.splitlines()[0]}"


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads one module as it is changed."""

    def __init__(self, module: str, path: Path, tree: ast.Module) -> None:
        self.module, self.path, self.tree = module, path, tree

    def find_spec(self, name: str, path: object = None, target: ModuleType | None = None):  # type: ignore[no-untyped-def]
        """The module's specification, with this loader."""
        if name != self.module:
            return None
        inside = [str(self.path.parent)] if self.path.name == "__init__.py" else None
        return importlib.util.spec_from_file_location(name, self.path, loader=self, submodule_search_locations=inside)

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        exec(compile(self.tree, str(self.path), "exec"), module.__dict__)  # noqa: S102 - the project's own code


def related_tests(module: str) -> list[str]:
    """Files of tests that import the module, by which most changes are seen, then those of its room."""
    files = [p for folder in ("tests", "validation/equations") for p in sorted((ROOT / folder).rglob("test_*.py"))]
    package, _, name = module.rpartition(".")
    words = f"{module} import", f"from {package} import {name}", f'"{module}.'
    room = [p for p in files if p.parent.name == module.split(".")[1]]
    near = [p for p in files if OTHER_ROOMS.isdisjoint(p.parts) and any(w in p.read_text("utf-8") for w in words)]
    return [str(p) for p in dict.fromkeys([*near, *room])]


def lines_of(change: Change) -> range:
    """Lines of the statement that is changed; of one with a body those of its head."""
    tree = ast.parse(change.path.read_text("utf-8"))
    node = places(tree)[change.place]
    statements = [s for s in ast.walk(tree) if isinstance(s, ast.stmt) and any(n is node for n in ast.walk(s))]
    one = max(statements, key=lambda s: (s.lineno, -(s.end_lineno or 0)))
    body = getattr(one, "body", None)
    return range(one.lineno, max(body[0].lineno, one.lineno + 1) if body else (one.end_lineno or one.lineno) + 1)


def rounds(change: Change, reach: Mapping[tuple[str, int], list[str]]) -> Iterator[list[str]]:
    """What is run one after the other: the tests that reach the change, then all of their files.

    Where it is not known what reaches it, those that import the module and those of its room.
    """
    reaching = {test for line in lines_of(change) for test in reach.get((str(change.path), line), ())}
    if not reaching:
        yield related_tests(change.module)
        return
    files = {test: test.partition("::")[0] for test in reaching}
    yield sorted(reaching, key=lambda test: (change.path.stem not in files[test], test))
    yield sorted(set(files.values()))


def exit_code(change: Change | None, tests: Sequence[str], seconds: float = SECONDS) -> int:
    """Pytest's exit code with the change, in another process; -1 when it took too long or crashed."""
    child = os.fork()
    if child == 0:
        code = 99
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (round(seconds), round(seconds) + 1))
            sink = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(sink, stream)
            if change is not None:
                tree, _, _ = changed(change.path, change.place)
                sys.meta_path.insert(0, Finder(change.module, change.path, tree))
            sys.dont_write_bytecode = True
            options = ["-q", "-x", "-p", "no:cacheprovider", "-m", "not slow and not data"]
            code = int(pytest.main([*options, *tests]))
        finally:
            os._exit(code)
    end = time.monotonic() + 10 * seconds
    while time.monotonic() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else -1
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return -1


def sample(room: str, count: int, seed: int) -> Iterator[Change]:
    """Places of a room, drawn without regard to what is in them."""
    every = [
        Change(path, i)
        for path in sorted((SOURCE / room).rglob("*.py"))
        if path.relative_to(SOURCE).as_posix() not in WORDS_AND_DATA
        for i in range(len(places(ast.parse(path.read_text("utf-8")))))
    ]
    random.Random(f"{room} {seed}").shuffle(every)  # noqa: S311 - repeatable, not secret
    yield from every[:count]


def main() -> int:
    """Print every change that no test sees; exit code 1 when there is one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=20, help="changes of each room")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", choices=ROOMS, action="append")
    parser.add_argument("--reach", type=Path, help="a folder of room_coverage.py --output")
    options = parser.parse_args()
    os.chdir(ROOT)
    reach = tests_by_line(options.reach / "data") if options.reach else {}
    for name in LARGE_LIBRARIES:
        importlib.import_module(name)
    survivors = 0
    for room in options.room or ROOMS:
        if not reach and exit_code(None, [str(ROOT / "tests" / room)]) != 0:
            parser.error(f"tests/{room} fails as it stands")
        seen = 0
        for change in sample(room, options.each, options.seed):
            _, line, words = changed(change.path, change.place)
            if any(exit_code(change, tests) not in (0, 5) for tests in rounds(change, reach)):
                seen += 1
                continue
            survivors += 1
            print(f"SURVIVES {change.path.relative_to(ROOT)}:{line} {words}", flush=True)
        print(f"{room}: {seen} of {options.each} seen", flush=True)
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
